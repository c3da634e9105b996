//! The kernels against each other, on models with every kind of joint.

use super::*;
use crate::rigid::Effects;
use crate::vehicle::{Drag, Inertia, Vehicle};
use crate::{Multirotor, Physics, vehicles};
use autodiff::System;
use rng::{Purpose, Stream};

/// A vehicle as one floating body.
pub(crate) fn one_body(vehicle: &Vehicle) -> Model {
    let total = vehicle.mass_properties();
    let body = Body {
        name: vehicle.name.clone(),
        parent: None,
        joint: Joint::new("base", Motion::Floating),
        mass: total.mass,
        center_of_mass: total.center_of_mass.into(),
        inertia: Inertia::from_matrix(&total.inertia),
        drag: vehicle.drag,
    };
    Model::new(ModelParts {
        name: vehicle.name.clone(),
        gravity: 9.81,
        bodies: vec![body],
        rotors: vehicle.rotors.iter().map(|r| MountedRotor { body: 0, rotor: r.clone() }).collect(),
        drones: vec![],
        frames: vec![],
        shapes: vec![],
        contact: ContactSettings::default(),
        mesh: vec![],
        pushed: vec![],
        cables: vec![],
    })
    .unwrap()
}

/// A tree with every kind of joint: a floating drone carries a massless hinge pair with a rod, a slide with a ball joint
/// on it, and a tilted hinge along a general axis.
fn menagerie() -> Model {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let mut parts = one_body(&vehicle).parts().clone();
    let rod = Inertia { xx: 0.02, yy: 0.021, zz: 0.006, xy: 1e-3, xz: -5e-4, yz: 2e-4 };
    let mut hang = |name: &str, parent: usize, motion: Motion, position: [f64; 3], mass: f64| {
        let mut joint = Joint::new(format!("{name}.joint"), motion);
        (joint.position, joint.damping) = (position, 0.003);
        let inertia = if mass > 0.0 { rod } else { Inertia::zero() };
        let drag = Drag { linear: [0.01 * mass; 3], quadratic: [0.02 * mass; 3], angular: [0.001 * mass; 3] };
        let center_of_mass = if mass > 0.0 { [0.02, -0.01, -0.3] } else { [0.0; 3] };
        parts.bodies.push(Body { name: name.into(), parent: Some(parent), joint, mass, center_of_mass, inertia, drag });
        parts.bodies.len() - 1
    };
    let cross = hang("cross", 0, Motion::Revolute([1.0, 0.0, 0.0]), [0.0, 0.0, -0.02], 0.0);
    hang("rod", cross, Motion::Revolute([0.0, 1.0, 0.0]), [0.0; 3], 0.2);
    let sled = hang("sled", 0, Motion::Prismatic([0.6, 0.0, 0.8]), [0.1, 0.0, 0.0], 0.15);
    hang("bob", sled, Motion::Ball, [0.0, 0.05, -0.1], 0.1);
    let arm = hang("arm", 0, Motion::Revolute([0.48, 0.6, 0.64]), [-0.1, 0.05, 0.0], 0.25);
    hang("hand", arm, Motion::Revolute([0.0, 0.0, 1.0]), [0.0, 0.1, -0.5], 0.1);
    parts.bodies[6].joint.rotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    parts.bodies[3].joint.stiffness = 3.0;
    parts.bodies[4].joint.stiffness = 0.7;
    Model::new(parts).unwrap()
}

fn random_state(model: &Model, seed: u64) -> Vec<f64> {
    let mut r = Stream::new(seed, 0, 0, Purpose::user(7));
    let mut x: Vec<f64> = (0..model.layout().n_state()).map(|_| r.uniform(-1.5, 1.5)).collect();
    for (body, place) in model.bodies().iter().zip(&model.layout().bodies) {
        let q = match body.joint.motion {
            Motion::Floating => place.position + 6,
            Motion::Ball => place.position,
            Motion::Revolute(_) | Motion::Prismatic(_) => continue,
        };
        let norm = x[q..q + 4].iter().map(|v| v * v).sum::<f64>().sqrt();
        x[q..q + 4].iter_mut().for_each(|v| *v /= norm);
    }
    for (at, rotor) in model.layout().rotor_speed.iter().zip(model.rotors()) {
        x[*at] = rotor.rotor.max_speed * r.uniform(0.1, 0.9);
    }
    x
}

fn relative(a: &[f64], b: &[f64]) -> f64 {
    let scale = a.iter().fold(1e-9_f64, |m, v| m.max(v.abs()));
    a.iter().zip(b).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs())) / scale
}

/// ν̇ out of ẋ.
fn velocity_rates(model: &Model, rate: &[f64]) -> Vec<f64> {
    let mut nu = vec![0.0; model.layout().n_velocity()];
    for (body, place) in model.bodies().iter().zip(&model.layout().bodies) {
        let to = &mut nu[place.freedom..place.freedom + place.n_freedom];
        if body.joint.motion == Motion::Floating {
            to[..3].copy_from_slice(&rate[place.velocity..place.velocity + 3]);
            to[3..].copy_from_slice(&rate[place.position + 10..place.position + 13]);
        } else {
            to.copy_from_slice(&rate[place.velocity..place.velocity + place.n_freedom]);
        }
    }
    nu
}

#[test]
fn one_floating_body_accelerates_as_the_closed_form_says() {
    let mut worst = 0.0_f64;
    for vehicle in vehicles::all() {
        for effects in [Effects::none(), Effects::lean(), Effects::default(), Effects::all()] {
            let physics = Physics { effects, ..Physics::default() };
            let (tree, closed) =
                (Multibody::new(&one_body(&vehicle), physics).unwrap(), Multirotor::new(&vehicle, physics).unwrap());
            assert_eq!((tree.n_state(), tree.n_input()), (closed.n_state(), closed.n_input()));
            for seed in 0..20 {
                let x = random_state(tree.model(), seed);
                let u: Vec<f64> = (0..tree.n_input()).map(|k| (0.3 * k as f64 + seed as f64).sin()).collect();
                let (mut a, mut b) = (vec![0.0; x.len()], vec![0.0; x.len()]);
                tree.derivative(&x, &u, &[], &mut a);
                closed.derivative(&x, &u, &[], &mut b);
                worst = worst.max(relative(&b, &a));
            }
        }
    }
    println!("tree against closed form: {worst:.1e}");
    assert!(worst < 1e-12);
}

#[test]
fn inverse_dynamics_undoes_forward_dynamics() {
    let model = menagerie();
    let system = Multibody::new(&model, Physics { effects: Effects::all(), ..Physics::default() }).unwrap();
    let mut worst = 0.0_f64;
    for seed in 0..200 {
        let x = random_state(&model, seed);
        let u: Vec<f64> = (0..system.n_input()).map(|k| (0.7 * k as f64 + seed as f64).sin()).collect();
        let mut rate = vec![0.0; x.len()];
        system.derivative(&x, &u, &[], &mut rate);
        let nu = velocity_rates(&model, &rate);
        let mut force = vec![0.0; nu.len()];
        inverse_dynamics(&system, &x, &u, &nu, &mut force);
        // what joints supply: damping and springs
        let mut want = vec![0.0; nu.len()];
        for (body, place) in model.bodies().iter().zip(&model.layout().bodies).skip(1) {
            let (j, q, v) = (&body.joint, place.position, place.velocity);
            if j.motion == Motion::Ball {
                for k in 0..3 {
                    want[place.freedom + k] = -j.damping * x[v + k] - 2.0 * j.stiffness * x[q] * x[q + 1 + k];
                }
            } else {
                want[place.freedom] = -j.damping * x[v] - j.stiffness * x[q];
            }
        }
        let scale = (mass_matrix(&model, &x).unwrap() * nalgebra::DVector::from_vec(nu)).amax();
        let error = want.iter().zip(&force).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
        worst = worst.max(error / scale);
    }
    println!("RNEA of ABA: {worst:.1e}");
    assert!(worst < 1e-12);
}

#[test]
fn kinetic_energy_is_half_the_quadratic_form_of_the_mass_matrix() {
    let model = menagerie();
    let system = Multibody::new(&model, Physics::default()).unwrap();
    let mut worst = 0.0_f64;
    for seed in 0..50 {
        let x = random_state(&model, seed);
        // velocities stand where their rates do
        let nu = nalgebra::DVector::from_vec(velocity_rates(&model, &x));
        let m = mass_matrix(&model, &x).unwrap();
        let want = 0.5 * nu.dot(&(m * &nu));
        worst = worst.max((kinetic_energy(&system, &x) - want).abs() / want);
    }
    assert!(worst < 1e-13, "{worst:.1e}");
}

#[test]
fn energy_and_momentum_are_kept_where_nothing_dissipates() {
    let mut parts = menagerie().parts().clone();
    parts.gravity = 0.0;
    parts.bodies.iter_mut().for_each(|b| b.joint.damping = 0.0);
    parts.rotors.clear();
    let model = Model::new(parts).unwrap();
    let physics = Physics { dt: 0.001, effects: Effects::none(), ..Physics::default() };
    let system = Multibody::new(&model, physics).unwrap();
    let mut x = random_state(&model, 3);
    let energy = |x: &[f64]| kinetic_energy(&system, x) + potential_energy(&system, x);
    let (before, start) = (energy(&x), momentum(&system, &x));
    let mut next = x.clone();
    for _ in 0..2000 {
        system.step(&x, &[], &[], &mut next);
        std::mem::swap(&mut x, &mut next);
    }
    let (after, end) = (energy(&x), momentum(&system, &x));
    let drift = (after - before).abs() / before;
    let turned = relative(&start.angular, &end.angular);
    println!("energy {drift:.1e}, linear {:.1e}, angular {turned:.1e}", relative(&start.linear, &end.linear));
    assert!(drift < 1e-7 && turned < 1e-8 && relative(&start.linear, &end.linear) < 1e-8);
}

#[test]
fn a_frames_jacobian_gives_its_velocity() {
    let model = menagerie();
    let system = Multibody::new(&model, Physics::default()).unwrap();
    let mut worst = 0.0_f64;
    for seed in 0..20 {
        let x = random_state(&model, seed);
        let nu = nalgebra::DVector::from_vec(velocity_rates(&model, &x));
        for body in 0..model.bodies().len() {
            let frame = NamedFrame { name: "probe".into(), body, position: [0.1, -0.2, 0.3], rotation: IDENTITY };
            let got = frame_jacobian(&model, &x, &frame).unwrap() * &nu;
            let pose = frame_pose(&system, &x, &frame);
            let wanted: Vec<f64> = pose.velocity.into_iter().chain(pose.angular_velocity).collect();
            worst = worst.max(relative(&wanted, got.as_slice()));
        }
    }
    assert!(worst < 1e-13, "{worst:.1e}");
}
