//! Wakes of drones: on each other, and on what has shapes and no rotors.
//!
//! The law is that of `downwash`; here is who pushes whom. Wakes are held through a substep as commands are.

use super::scratch::{BodyScratch, RotorScratch};
use super::topology::{Load, Source, Topology};
use crate::aero::downwash;
use crate::spatial::*;
use autodiff::{Scalar, safe};

/// Finds the wakes of all drones on all others and on loads. Needs kinematics.
pub(super) fn hold<S: Scalar>(t: &Topology, bodies: &mut [BodyScratch<S>], rotors: &[RotorScratch<S>]) {
    let pushes_drones = t.effects.downwash && t.sources.len() > 1;
    if !pushes_drones && t.loads.is_empty() {
        return;
    }
    for s in 0..t.sources.len() {
        bodies[t.sources[s].body].wake = [S::zero(); 3];
    }
    for k in 0..t.loaded.len() {
        let body = &mut bodies[t.loaded[k]];
        (body.wake, body.wake_moment) = ([S::zero(); 3], [S::zero(); 3]);
    }
    for s in 0..t.sources.len() {
        let thrust = thrust_of(&t.sources[s], bodies, rotors, t);
        let from = source_position(&t.sources[s], bodies);
        if pushes_drones {
            push_drones(t, s, (from, thrust), bodies);
        }
        for k in 0..t.loads.len() {
            push_load(&t.loads[k], t.per_area[s], (from, thrust), bodies);
        }
    }
}

/// Adds what is held to the outside loads of bodies.
pub(super) fn apply<S: Scalar>(t: &Topology, bodies: &mut [BodyScratch<S>]) {
    if t.effects.downwash && t.sources.len() > 1 {
        for s in 0..t.sources.len() {
            let body = &mut bodies[t.sources[s].body];
            let lever = mat_vec(body.rotation, constants(t.sources[s].position));
            body.force = add(body.force, body.wake);
            body.moment = add(body.moment, cross(lever, body.wake));
        }
    }
    for k in 0..t.loaded.len() {
        let body = &mut bodies[t.loaded[k]];
        body.force = add(body.force, body.wake);
        body.moment = add(body.moment, body.wake_moment);
    }
}

/// Shape of the wakes, k_r and k_z.
#[inline]
fn cone<S: Scalar>() -> (S, S) {
    (S::constant(downwash::DEFAULT_RADIAL), S::constant(downwash::DEFAULT_AXIAL))
}

/// The wake of source `s`, with its place and thrust, on all other sources.
fn push_drones<S: Scalar>(t: &Topology, s: usize, (from, thrust): (Vec3<S>, Vec3<S>), bodies: &mut [BodyScratch<S>]) {
    let (k_r, k_z) = cone();
    for other in 0..t.sources.len() {
        if other != s {
            let to = source_position(&t.sources[other], bodies);
            let force = downwash::force(sub(from, to), thrust, k_r, k_z);
            let body = &mut bodies[t.sources[other].body];
            body.wake = add(body.wake, force);
        }
    }
}

/// −a T S(T̂)/A of a source at a place with thrust T and so much 1/A: S is the area of the load as the wake sees it, S/A at most 1.
fn push_load<S: Scalar>(load: &Load, per_area: f64, (from, thrust): (Vec3<S>, Vec3<S>), bodies: &mut [BodyScratch<S>]) {
    let (k_r, k_z) = cone();
    let body = &mut bodies[load.body];
    let lever = mat_vec(body.rotation, constants(load.center));
    let along = mat_vec(transpose(body.rotation), safe::normalise(thrust));
    let share = (facing(load, along) * S::constant(per_area)).min(S::one());
    let wake = downwash::force(sub(from, add(body.position, lever)), thrust, k_r, k_z);
    let force = scale(share, wake);
    body.wake = add(body.wake, force);
    body.wake_moment = add(body.wake_moment, cross(lever, force));
}

/// Area of a load seen along a unit vector of its body's frame, m².
fn facing<S: Scalar>(load: &Load, along: Vec3<S>) -> S {
    let mut area = S::constant(load.end);
    for k in 0..3 {
        let part = dot(constants(load.axes[k]), along);
        if load.faces[k] > 0.0 {
            area = S::constant(load.faces[k]).mul_add(part.abs(), area);
        }
        if k == 2 && load.side > 0.0 {
            let across = safe::sqrt((S::one() - part * part).max(S::zero()), 1e-6);
            area = S::constant(load.side).mul_add(across, area);
        }
    }
    area
}

#[inline]
fn source_position<S: Scalar>(source: &Source, bodies: &[BodyScratch<S>]) -> Vec3<S> {
    let body = &bodies[source.body];
    add(body.position, mat_vec(body.rotation, constants(source.position)))
}

/// Σ k_f Ω² n of a drone's rotors, world.
fn thrust_of<S: Scalar>(
    source: &Source,
    bodies: &[BodyScratch<S>],
    rotors: &[RotorScratch<S>],
    t: &Topology,
) -> Vec3<S> {
    let mut thrust = [S::zero(); 3];
    for k in 0..source.rotors.len() {
        let r = source.rotors[k];
        let (rotor, body) = (&rotors[r], &bodies[t.rotor_body[r]]);
        let force = scale(rotor.speed * rotor.speed, rotor.model.force);
        thrust = add(thrust, mat_vec(body.rotation, force));
    }
    thrust
}

#[cfg(test)]
mod tests {
    use crate::configurations::{SlungLoad, by_name};
    use crate::tree::{Model, Multibody};
    use crate::{Effects, Integrator, Physics};
    use autodiff::certificate::CertificateBounds;
    use autodiff::{System, certify};
    use std::f64::consts::PI;

    fn system(model: &Model, load_downwash: bool, dt: f64) -> Multibody {
        let effects = Effects { load_downwash, ..Effects::none() };
        let physics = Physics { dt, substeps: 1, integrator: Integrator::SemiImplicit, effects };
        Multibody::new(model, physics).unwrap()
    }

    /// What wakes add to the velocity of the ball in a step, over the step, times its mass: N.
    fn force(load: &SlungLoad, place: [f64; 3]) -> [f64; 3] {
        let model = load.build().unwrap().model;
        let mut after = [[0.0; 3]; 2];
        for (on, after) in [false, true].into_iter().zip(&mut after) {
            let system = system(&model, on, 1e-6);
            let mut x = system.rest_state();
            x[17..20].copy_from_slice(&place);
            x[13..17].fill(500.0);
            let mut next = x.clone();
            system.step(&x, &[0.0; 4], &[], &mut next);
            after.copy_from_slice(&next[20..23]);
        }
        [0, 1, 2].map(|k| (after[1][k] - after[0][k]) / 1e-6 * load.payload_mass)
    }

    #[test]
    fn a_load_under_its_drone_is_pushed_by_the_pressure_of_the_wake_on_the_area_that_faces_it() {
        let load = SlungLoad::default();
        let rotors = &load.drone.rotors;
        let thrust: f64 = rotors.iter().map(|r| r.thrust_coefficient * 500.0 * 500.0).sum();
        let area: f64 = rotors.iter().map(|r| PI * r.radius * r.radius).sum();
        let want = thrust / 1.3_f64.powi(2) * PI * 0.04 * 0.04 / area;
        let got = force(&load, [0.0, 0.0, -1.0]);
        println!("pushed by {:.6} N of {want:.6} N, thrust {thrust:.3} N", -got[2]);
        // what rotors gain in the step, 1.5e-5
        assert!((got[2] + want).abs() < 1e-4 * want && got[0].abs() + got[1].abs() < 1e-9, "{got:?} against {want}");
        // beside the cone and above the drone nothing is felt
        let beside = force(&load, [0.99, 0.0, -0.05]);
        let above = force(&load, [0.0, 0.0, 0.5]);
        assert!(beside[2].abs() < 1e-9 && above == [0.0; 3], "{beside:?}, {above:?}");
        // rotors without a radius are unknown to wakes
        let mut unknown = load.clone();
        unknown.drone.rotors.iter_mut().for_each(|rotor| rotor.radius = 0.0);
        assert_eq!(force(&unknown, [0.0, 0.0, -1.0]), [0.0; 3]);
        // a load wider than the rotors takes no more than the thrust
        let wide = force(&SlungLoad { payload_radius: 0.5, ..load }, [0.0, 0.0, -1.0]);
        assert!((wide[2] + thrust / 1.69).abs() < 1e-4 * thrust, "{wide:?} against {thrust}");
    }

    #[test]
    fn wakes_on_balls_bars_and_boxes_pass_the_gradient_certificate() {
        let slung = SlungLoad::default().build().unwrap().model;
        let others = ["payload", "transport", "platform"].map(|name| by_name(name).unwrap());
        for model in [slung].into_iter().chain(others) {
            let name = model.name().to_string();
            let system = system(&model, true, 0.002);
            let mut x = system.rest_state();
            system.topology().rotor_speed.iter().for_each(|at| x[*at] = 400.0);
            x[3] = 0.2;
            if name == "slung_load" {
                // away from where the cable goes taut, where differences see both sides
                x[19] += 0.05;
            }
            let input = vec![0.1; system.n_input()];
            let pushed = system.topology().loads.len();
            let certificate = certify(&system, &x, &input, &[]).unwrap();
            println!("{name}: {pushed} shapes in the wakes");
            assert!(certificate.holds(CertificateBounds::default()), "{name}: {certificate:?}");
            assert!(pushed > 0, "{name}");
        }
    }
}
