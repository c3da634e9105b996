//! Stripped models, random states, bounds that print what was measured.

use crate::common::measure::larger;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use omnidrones::dynamics::tree::{Model, ModelParts, Motion, Multibody};
use omnidrones::dynamics::{Effects, Physics};
use omnidrones::rng::{Purpose, Stream};

pub use crate::common::measure::at_most;

/// Bodies, joints with damping and springs, rotors and gravity alone: no drives, limits, drag or other effects.
pub fn bare(model: &Model) -> Multibody {
    let mut parts: ModelParts = model.parts().clone();
    for body in &mut parts.bodies {
        (body.joint.drive, body.joint.limits) = (None, None);
    }
    let physics = Physics { effects: Effects::none(), ..Physics::default() };
    Multibody::new(&Model::new(parts).unwrap(), physics).unwrap()
}

pub fn derivative(system: &Multibody, x: &[f64]) -> Vec<f64> {
    let mut rate = vec![0.0; x.len()];
    system.derivative::<f64>(x, &system.rest_input(), &[], &mut rate);
    rate
}

/// d/dt of all velocities, body by body, out of d/dt of a state.
pub fn accelerations(system: &Multibody, rate: &[f64]) -> Vec<f64> {
    let mut out = Vec::with_capacity(system.layout().n_velocity());
    for (body, place) in system.model().bodies().iter().zip(&system.layout().bodies) {
        match body.joint.motion {
            Motion::Floating => {
                out.extend(&rate[place.velocity..place.velocity + 3]);
                out.extend(&rate[place.position + 10..place.position + 13]);
            }
            _ => out.extend(&rate[place.velocity..place.velocity + place.n_freedom]),
        }
    }
    out
}

/// Largest difference over the largest acceleration of the state.
pub fn gap(got: &[f64], wanted: &[f64]) -> f64 {
    let scale = wanted.iter().fold(0.0_f64, |m, a| m.max(a.abs()));
    got.iter().zip(wanted).map(|(a, b)| (a - b).abs()).fold(0.0, larger) / scale
}

/// Any attitude, ±2 m, ±3 m/s, ±3 rad/s, hinges ±π, slides ±0.5 m, rotors up to full speed.
pub fn random_state(system: &Multibody, stream: &mut Stream) -> Vec<f64> {
    let mut x = system.rest_state();
    let fill =
        |x: &mut [f64], most: f64, stream: &mut Stream| x.iter_mut().for_each(|v| *v = stream.uniform(-most, most));
    for (body, place) in system.model().bodies().iter().zip(&system.layout().bodies) {
        let (p, v) = (place.position, place.velocity);
        match body.joint.motion {
            Motion::Floating => {
                fill(&mut x[p..p + 3], 2.0, stream);
                fill(&mut x[p + 3..p + 6], 3.0, stream);
                attitude(&mut x[p + 6..p + 10], stream);
                fill(&mut x[p + 10..p + 13], 3.0, stream);
            }
            Motion::Ball => {
                attitude(&mut x[p..p + 4], stream);
                fill(&mut x[v..v + 3], 3.0, stream);
            }
            Motion::Revolute(_) | Motion::Prismatic(_) => {
                let turns = matches!(body.joint.motion, Motion::Revolute(_));
                x[p] = stream.uniform(-1.0, 1.0) * if turns { std::f64::consts::PI } else { 0.5 };
                x[v] = stream.uniform(-3.0, 3.0);
            }
        }
    }
    for (mounted, at) in system.model().rotors().iter().zip(&system.layout().rotor_speed) {
        x[*at] = mounted.rotor.max_speed * stream.unit();
    }
    x
}

fn attitude(q: &mut [f64], stream: &mut Stream) {
    let random = Quaternion::new(stream.normal(), stream.normal(), stream.normal(), stream.normal());
    let unit = UnitQuaternion::new_normalize(random);
    q.copy_from_slice(&[unit.w, unit.i, unit.j, unit.k]);
}

/// Of the quaternion at `at` of a state.
pub fn quaternion(x: &[f64], at: usize) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(Quaternion::new(x[at], x[at + 1], x[at + 2], x[at + 3]))
}

pub fn vector(x: &[f64], at: usize) -> Vector3<f64> {
    Vector3::new(x[at], x[at + 1], x[at + 2])
}

/// A stream of this test binary, apart from the library's own uses.
pub fn stream(seed: u64) -> Stream {
    Stream::new(seed, 0, 0, Purpose(0x7265_6574))
}
