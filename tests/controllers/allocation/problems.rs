//! Random allocation problems: every vehicle, every kind of trouble; and thrusters that turn, in cones.

use nalgebra::DMatrix;
use omnidrones::controllers::allocation::{Cone, Problem, problem::balanced_weights};
use omnidrones::dynamics::vehicles;
use omnidrones::rng::{Purpose, Stream};

pub fn stream(seed: u64, case: u64) -> Stream {
    Stream::new(seed, case, 0, Purpose::user(40))
}

/// One kind of trouble.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    Reachable,
    Unreachable,
    FarOut,
    Vertex,
    Failed,
    Weakened,
    RateLimited,
    Preferred,
    Weighted,
    NotFinite,
}

impl Kind {
    pub const ALL: [Self; 10] = [
        Self::Reachable,
        Self::Unreachable,
        Self::FarOut,
        Self::Vertex,
        Self::Failed,
        Self::Weakened,
        Self::RateLimited,
        Self::Preferred,
        Self::Weighted,
        Self::NotFinite,
    ];
}

/// A problem of every vehicle of the registry, with its name.
pub fn vehicles() -> Vec<(String, Problem)> {
    vehicles::all().iter().map(|v| (v.name.clone(), Problem::of_vehicle(v).unwrap())).collect()
}

/// `base` in trouble, and the wanted wrench.
pub fn trouble(base: &Problem, kind: Kind, r: &mut Stream) -> (Problem, [f64; 6]) {
    let mut problem = base.clone();
    let n = problem.n_input();
    let thrusts: Vec<f64> = problem.upper.iter().map(|hi| r.uniform(0.0, *hi)).collect();
    let mut wrench = problem.delivered(&thrusts);
    let size: f64 = problem.upper.iter().sum();
    match kind {
        Kind::Reachable => {}
        Kind::Unreachable => wrench.iter_mut().for_each(|w| *w += size * r.uniform(-1.0, 1.0)),
        Kind::FarOut => wrench.iter_mut().for_each(|w| *w = 1e3 * size * r.uniform(-1.0, 1.0)),
        Kind::Vertex => {
            let corner: Vec<f64> = problem.upper.iter().map(|hi| if r.below(2) == 0 { 0.0 } else { *hi }).collect();
            wrench = problem.delivered(&corner);
        }
        Kind::Failed => {
            for _ in 0..=r.below(2) {
                problem.upper[r.below(n as u64) as usize] = 0.0;
            }
        }
        Kind::Weakened => problem.upper.iter_mut().for_each(|hi| *hi *= r.uniform(0.0, 1.0)),
        Kind::RateLimited => {
            for i in 0..n {
                let most = 0.05 * base.upper[i];
                let previous = r.uniform(0.0, base.upper[i]);
                (problem.lower[i], problem.upper[i]) = omnidrones::controllers::allocation::problem::rate_window(
                    base.lower[i],
                    base.upper[i],
                    previous,
                    most,
                );
            }
        }
        Kind::Preferred => {
            problem.preference = problem.upper.iter().map(|hi| r.uniform(-0.5, 1.5) * hi).collect();
            problem.regularisation *= 10f64.powf(r.uniform(0.0, 5.0));
        }
        Kind::Weighted => problem.weights.iter_mut().for_each(|w| *w *= 10f64.powf(r.uniform(-2.0, 2.0))),
        Kind::NotFinite => {
            wrench[r.below(6) as usize] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][r.below(3) as usize]
        }
    }
    (problem, wrench)
}

/// An Omav in split forces: per arm a lateral and a vertical component, a largest thrust, a window of tilts around where
/// the arm stands.
pub fn tilting(r: &mut Stream) -> Problem {
    let (arm, most, drag) = (0.3, 20.0, 0.02);
    let mut geometry = DMatrix::zeros(6, 12);
    let (mut cones, mut anchor) = (Vec::new(), vec![0.0; 12]);
    for i in 0..6 {
        let azimuth = std::f64::consts::FRAC_PI_3 * i as f64;
        let (s, c) = azimuth.sin_cos();
        let (place, spin) = ([arm * c, arm * s, 0.0], if i % 2 == 0 { 1.0 } else { -1.0 });
        for (k, axis) in [[-s, c, 0.0], [0.0, 0.0, 1.0]].into_iter().enumerate() {
            force_column(&mut geometry, 2 * i + k, place, axis, -spin * drag);
        }
        let tilt = r.uniform(-1.0, 1.0);
        let pair = [2 * i, 2 * i + 1];
        cones.push(Cone::ball(pair, most * r.uniform(0.5, 1.0)));
        for (edge, sign) in [(tilt - 0.2, 1.0), (tilt + 0.2, -1.0)] {
            // right of the left edge, left of the right one
            cones.push(Cone::half_space(pair, [sign * f64::cos(edge), -sign * f64::sin(edge)], 0.0));
        }
        (anchor[2 * i], anchor[2 * i + 1]) = (0.2 * most * tilt.sin(), 0.2 * most * tilt.cos());
    }
    with_cones(geometry, cones, anchor)
}

/// A platform of four drones on gimbals: a force in space each, a largest thrust, a cone of tilts.
pub fn gimballed(r: &mut Stream) -> Problem {
    let (arm, most) = (0.85, 20.0);
    let mut geometry = DMatrix::zeros(6, 12);
    let (mut cones, mut anchor) = (Vec::new(), vec![0.0; 12]);
    for i in 0..4 {
        let (s, c) = (std::f64::consts::FRAC_PI_2 * i as f64).sin_cos();
        for (k, axis) in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].into_iter().enumerate() {
            force_column(&mut geometry, 3 * i + k, [arm * c, arm * s, 0.0], axis, 0.0);
        }
        let forces = [3 * i, 3 * i + 1, 3 * i + 2];
        cones.push(Cone::ball(forces, most * r.uniform(0.5, 1.0)));
        cones.push(Cone::tilt(forces, [0.0, 0.0, 1.0], r.uniform(0.5, 0.95)));
        anchor[3 * i + 2] = 0.3 * most;
    }
    with_cones(geometry, cones, anchor)
}

fn with_cones(geometry: DMatrix<f64>, cones: Vec<Cone>, anchor: Vec<f64>) -> Problem {
    let n = geometry.ncols();
    let mut problem = Problem::boxed(geometry, balanced_weights(0.3), vec![f64::INFINITY; n]).unwrap();
    problem.lower = vec![f64::NEG_INFINITY; n];
    problem.regularisation = 1e-4;
    (problem.cones, problem.anchor) = (cones, anchor);
    problem.validate().unwrap();
    problem
}

/// Unit force along `axis` at `place`, with a drag torque of `twist` along it.
fn force_column(geometry: &mut DMatrix<f64>, column: usize, place: [f64; 3], axis: [f64; 3], twist: f64) {
    let [x, y, z] = place;
    let [a, b, c] = axis;
    let moment = [y * c - z * b, z * a - x * c, x * b - y * a];
    for k in 0..3 {
        geometry[(k, column)] = axis[k];
        geometry[(3 + k, column)] = moment[k] + twist * axis[k];
    }
}

/// A wrench around what the problem can deliver, at times beyond.
pub fn wanted(problem: &Problem, reach: f64, r: &mut Stream) -> [f64; 6] {
    let near = problem.delivered(&problem.anchor);
    let size = near[2].abs();
    std::array::from_fn(|i| near[i] + reach * size * r.uniform(-1.0, 1.0) * if i < 3 { 1.0 } else { 0.3 })
}
