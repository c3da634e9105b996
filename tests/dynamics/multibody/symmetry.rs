//! Contract: no place, heading, speed or hand is special.
//!
//! Each law moves state and input, flies both, and compares; the ground is level, so it keeps turns about z.

use super::common::*;
use crate::common::measure::larger;
use crate::common::measure::relative;
use crate::common::tree::{everything, input, lower, state, stream};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use omnidrones::dynamics::tree::{Model, Motion, Multibody};
use omnidrones::dynamics::{Effects, Physics};

/// One for the dragon, whose saturated servos amplify rounding.
fn steps(name: &str) -> usize {
    if name == "dragon" { 1 } else { 100 }
}

const CASES: u64 = 5;

fn vector(x: &[f64], at: usize) -> Vector3<f64> {
    Vector3::new(x[at], x[at + 1], x[at + 2])
}

fn set(x: &mut [f64], at: usize, v: Vector3<f64>) {
    x[at..at + 3].copy_from_slice(v.as_slice());
}

/// Places of the floating roots in the state.
fn roots(model: &Model) -> Vec<usize> {
    let places = model.bodies().iter().zip(&model.layout().bodies);
    places.filter(|(b, _)| b.joint.motion == Motion::Floating).map(|(_, p)| p.position).collect()
}

fn winds(system: &Multibody) -> Vec<usize> {
    system.layout().trees.iter().filter_map(|t| t.disturbance).collect()
}

/// The state with attitudes in one of their two signs.
fn canonical(model: &Model, x: &[f64]) -> Vec<f64> {
    let mut x = x.to_vec();
    for p in roots(model) {
        let sign = if x[p + 6] < 0.0 { -1.0 } else { 1.0 };
        x[p + 6..p + 10].iter_mut().for_each(|q| *q *= sign);
    }
    x
}

/// Flies moved and unmoved, moves the end of the latter, compares.
fn compare(
    law: &str,
    effects: Effects,
    other: impl Fn(&Model) -> Model,
    moved: impl Fn(&Model, &[f64], f64) -> Vec<f64>,
    pushed: impl Fn(&Multibody, &mut [f64]),
    bound: f64,
) {
    for (config, (name, model)) in configurations().filter(|(_, model)| floats(model)).enumerate() {
        let physics = Physics { ..rk4(0.002, effects) };
        let system = Multibody::new(&model, physics).unwrap();
        let twin = Multibody::new(&other(&model), physics).unwrap();
        let mut worst = 0.0_f64;
        for case in 0..CASES {
            let mut r = stream(40 + config as u64, case);
            let mut x = state(&model, &mut r);
            if effects.contact && case % 2 == 0 {
                // into the ground
                lower(&system, &mut x, 0.001);
            }
            let u = input(&system, &mut r);
            let (mut y, mut w) = (moved(&model, &x, 0.0), u.clone());
            pushed(&system, &mut w);
            fly(&system, &mut x, &u, steps(name));
            fly(&twin, &mut y, &w, steps(name));
            let want = moved(&model, &x, steps(name) as f64 * 0.002);
            worst = larger(worst, relative(&canonical(&model, &y), &canonical(&model, &want)));
        }
        // measured 8.4e-13 turned, 4.1e-14 shifted, 6.2e-14 mirrored
        at_most(&format!("{name}: {law}"), worst, bound);
    }
}

#[test]
fn turning_and_moving_the_world_turns_and_moves_every_flight() {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 1.1);
    let offset = Vector3::new(5.0, -3.0, 0.0);
    compare(
        "yaw and translation",
        everything(),
        Clone::clone,
        |model, x, _| {
            let mut y = x.to_vec();
            for p in roots(model) {
                set(&mut y, p, turn * vector(x, p) + offset);
                set(&mut y, p + 3, turn * vector(x, p + 3));
                let q = turn.into_inner() * Quaternion::new(x[p + 6], x[p + 7], x[p + 8], x[p + 9]);
                y[p + 6..p + 10].copy_from_slice(&[q.w, q.i, q.j, q.k]);
            }
            y
        },
        |system, u| {
            for d in winds(system) {
                set(u, d, turn * vector(u, d));
                set(u, d + 3, turn * vector(u, d + 3));
            }
        },
        8e-11,
    );
}

#[test]
fn a_constant_speed_in_a_wind_of_that_speed_changes_nothing() {
    let speed = Vector3::new(2.0, -1.0, 0.5);
    let effects = Effects { ground_effect: false, ..Effects::all() };
    compare(
        "Galilean shift",
        effects,
        Clone::clone,
        |model, x, t| {
            let mut y = x.to_vec();
            for p in roots(model) {
                set(&mut y, p, vector(x, p) + t * speed);
                set(&mut y, p + 3, vector(x, p + 3) + speed);
            }
            y
        },
        |system, u| winds(system).into_iter().for_each(|d| set(u, d, vector(u, d) + speed)),
        4e-12,
    );
}

/// y → −y: vectors turn their y, axes of rotation their x and z.
fn flip(v: [f64; 3]) -> [f64; 3] {
    [v[0], -v[1], v[2]]
}

fn flip_axis(v: [f64; 3]) -> [f64; 3] {
    [-v[0], v[1], -v[2]]
}

/// The model in a mirror.
fn mirrored(model: &Model) -> Model {
    changed(model, |parts| {
        for body in &mut parts.bodies {
            let joint = &mut body.joint;
            joint.motion = match joint.motion {
                Motion::Revolute(a) => Motion::Revolute(flip_axis(a)),
                Motion::Prismatic(a) => Motion::Prismatic(flip(a)),
                other => other,
            };
            joint.position = flip(joint.position);
            for (i, row) in joint.rotation.iter_mut().enumerate() {
                for (j, entry) in row.iter_mut().enumerate() {
                    *entry *= if (i == 1) != (j == 1) { -1.0 } else { 1.0 };
                }
            }
            body.center_of_mass = flip(body.center_of_mass);
            (body.inertia.xy, body.inertia.yz) = (-body.inertia.xy, -body.inertia.yz);
        }
        for rotor in &mut parts.rotors {
            let r = &mut rotor.rotor;
            (r.position, r.axis, r.spin) = (flip(r.position), flip(r.axis), -r.spin);
        }
        parts.drones.iter_mut().for_each(|d| d.position = flip(d.position));
        for shape in &mut parts.shapes {
            shape.shape.position = flip(shape.shape.position);
            let [w, x, y, z] = shape.shape.rotation;
            shape.shape.rotation = [w, -x, y, -z];
        }
    })
}

#[test]
fn a_mirrored_model_flies_the_mirrored_flight() {
    compare(
        "mirror",
        everything(),
        mirrored,
        |model, x, _| {
            let mut y = x.to_vec();
            for p in roots(model) {
                for at in [p + 1, p + 4, p + 7, p + 9, p + 10, p + 12] {
                    y[at] = -x[at];
                }
            }
            y
        },
        |system, u| {
            for d in winds(system) {
                for at in [d + 1, d + 4, d + 6, d + 8] {
                    u[at] = -u[at];
                }
            }
        },
        6e-12,
    );
}

#[test]
fn a_rotor_that_spins_the_wrong_way_would_be_seen_in_the_mirror() {
    // twin: the mirror without turning the spins
    let model = configuration("payload");
    let wrong = changed(&mirrored(&model), |parts| parts.rotors.iter_mut().for_each(|r| r.rotor.spin *= -1.0));
    let fly_with = |model: &Model| {
        let system = Multibody::new(model, rk4(0.002, Effects::none())).unwrap();
        let (mut x, mut u) = (system.rest_state(), system.rest_input());
        u[0] = 0.5;
        fly(&system, &mut x, &u, 100);
        x
    };
    let (right, wrong) = (fly_with(&mirrored(&model)), fly_with(&wrong));
    assert!(relative(&right, &wrong) > 1e-3, "{right:?} and {wrong:?}");
}
