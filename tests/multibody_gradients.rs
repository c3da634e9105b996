//! Gradients of articulated systems: every configuration, integrator and effect, in flight and on the ground.

mod common;

use common::stream;
use omnidrones::autodiff::{Bounds, Objective, Rollout, Scalar, System, certify};
use omnidrones::dynamics::tree::{Model, Motion, Multibody};
use omnidrones::dynamics::{Effects, Integrator, Physics, assembly, configurations, vehicles};
use omnidrones::rng::Stream;

/// A state in flight: joints within their ranges, rates of 1 rad/s, rotors at 10 to 95 %.
fn state(model: &Model, r: &mut Stream) -> Vec<f64> {
    let mut x: Vec<f64> = (0..model.layout().n_state()).map(|_| r.uniform(-1.0, 1.0)).collect();
    for (body, place) in model.bodies().iter().zip(&model.layout().bodies) {
        let q = place.position;
        let attitude = match body.joint.motion {
            Motion::Floating => {
                x[q + 2] += 5.0;
                q + 6
            }
            Motion::Ball => q,
            Motion::Revolute(_) | Motion::Prismatic(_) => {
                let range = body.joint.limits.map_or([-1.0, 1.0], |l| [0.8 * l.lower, 0.8 * l.upper]);
                x[q] = r.uniform(range[0].max(-1.0), range[1].min(1.0));
                continue;
            }
        };
        let norm = x[attitude..attitude + 4].iter().map(|v| v * v).sum::<f64>().sqrt();
        x[attitude..attitude + 4].iter_mut().for_each(|v| *v /= norm);
    }
    for (at, rotor) in model.layout().rotor_speed.iter().zip(model.rotors()) {
        x[*at] = rotor.rotor.max_speed * r.uniform(0.1, 0.95);
    }
    x
}

/// Everything but contact: in flight nothing touches.
fn effects() -> [(&'static str, Effects); 3] {
    [("none", Effects::none()), ("default", Effects::default()), ("all", Effects::all())]
}

#[test]
fn the_certificate_holds_for_every_configuration_integrator_and_effect() {
    let (mut adjoint, mut difference) = (0.0_f64, 0.0_f64);
    for (case, model) in configurations::all().unwrap().iter().enumerate() {
        for integrator in common::INTEGRATORS {
            for (name, effects) in effects() {
                let system = Multibody::new(model, Physics { integrator, effects, ..Physics::default() }).unwrap();
                let mut r = stream(40, case as u64);
                let x = state(model, &mut r);
                let u: Vec<f64> = (0..system.n_input()).map(|_| r.uniform(-0.9, 0.9)).collect();
                let c = certify(&system, &x, &u, &[]).unwrap();
                println!("{} {integrator:?} {name}: {:.1e} {:.1e}", model.name(), c.adjoint_error, c.difference_error);
                assert!(c.holds(Bounds::default()), "{} {integrator:?} effects {name}, seed 40: {c}", model.name());
                adjoint = adjoint.max(c.adjoint_error);
                difference = difference.max(c.difference_error);
            }
        }
    }
    println!("adjoint {adjoint:.1e}, difference {difference:.1e}");
}
