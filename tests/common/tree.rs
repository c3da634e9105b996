//! Random states and inputs of articulated systems, from seeds that failures print.
#![allow(dead_code)] // each test file uses its part

use omnidrones::dynamics::Effects;
use omnidrones::dynamics::tree::{Model, Motion, Multibody, separations};
use omnidrones::rng::{Purpose, Stream};

pub fn stream(seed: u64, case: u64) -> Stream {
    Stream::new(seed, case, 0, Purpose::user(78))
}

/// Every effect, contact included.
pub fn everything() -> Effects {
    Effects { contact: true, ..Effects::all() }
}

pub fn attitude(r: &mut Stream) -> [f64; 4] {
    let q: [f64; 4] = std::array::from_fn(|_| r.normal());
    let norm = q.iter().map(|q| q * q).sum::<f64>().sqrt();
    q.map(|q| q / norm)
}

/// Roots within 3 m of where they start and 4 to 6 m above the ground at up to 2 m/s and 2 rad/s, hinges within 0.6 rad and
/// 1 rad/s, rotors at 10 to 95 %.
pub fn state(model: &Model, r: &mut Stream) -> Vec<f64> {
    let layout = model.layout();
    let mut x = vec![0.0; layout.n_state()];
    for (body, place) in model.bodies().iter().zip(&layout.bodies) {
        let (p, v) = (place.position, place.velocity);
        match body.joint.motion {
            Motion::Floating => {
                let [a, b, c] = body.joint.position;
                x[p] = a + r.uniform(-3.0, 3.0);
                x[p + 1] = b + r.uniform(-3.0, 3.0);
                x[p + 2] = c + r.uniform(4.0, 6.0);
                x[p + 3..p + 6].fill_with(|| r.uniform(-2.0, 2.0));
                x[p + 6..p + 10].copy_from_slice(&attitude(r));
                x[p + 10..p + 13].fill_with(|| r.uniform(-2.0, 2.0));
            }
            Motion::Ball => {
                x[p..p + 4].copy_from_slice(&attitude(r));
                x[v..v + 3].fill_with(|| r.uniform(-1.0, 1.0));
            }
            Motion::Revolute(_) | Motion::Prismatic(_) => {
                x[p] = r.uniform(-0.6, 0.6);
                x[v] = r.uniform(-1.0, 1.0);
            }
        }
    }
    for (at, rotor) in layout.rotor_speed.iter().zip(model.rotors()) {
        x[*at] = rotor.rotor.max_speed * r.uniform(0.1, 0.95);
    }
    x
}

/// Lowers a floating root until the deepest point is `depth` m in the ground.
pub fn lower(system: &Multibody, x: &mut [f64], depth: f64) {
    if system.model().bodies()[0].joint.motion == Motion::Floating {
        let list = separations(system, x);
        let gaps = list.iter().filter(|s| s.shapes.1.is_none()).map(|s| s.distance);
        let gap = gaps.fold(f64::INFINITY, f64::min);
        x[2] -= if gap.is_finite() { gap + depth } else { 0.0 };
    }
}

/// Commands within ±0.95; wind up to 3 m/s, forces up to 2 m/s² of the whole and moments up to 0.05 N m where asked for.
pub fn input(system: &Multibody, r: &mut Stream) -> Vec<f64> {
    let mut u: Vec<f64> = (0..system.layout().n_input()).map(|_| r.uniform(-0.95, 0.95)).collect();
    let mass = system.model().mass();
    for d in system.layout().trees.iter().filter_map(|t| t.disturbance) {
        u[d..d + 3].fill_with(|| r.uniform(-3.0, 3.0));
        u[d + 3..d + 6].fill_with(|| r.uniform(-2.0, 2.0) * mass);
        u[d + 6..d + 9].fill_with(|| r.uniform(-0.05, 0.05));
    }
    u
}
