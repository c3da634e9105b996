//! What follows from physical numbers: inertias that are those of bodies, speeds that carry a weight.

use super::robot::{Inertial, Robot};
use crate::dynamics::Plant;
use crate::dynamics::rigid::BODY_PARAMETERS;
use crate::dynamics::rotor::{N_ROTOR_PARAMETER, at};
use crate::dynamics::tree::{LINK_PARAMETERS, TreePlace};

/// One tree: what is weighed, and what carries it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Flock {
    /// Places of the masses.
    masses: Vec<usize>,
    /// Per rotor: places of its thrust coefficient and largest speed among the numbers, of its speed in the state.
    rotors: Vec<[usize; 3]>,
}

impl Flock {
    /// Of these bodies; per rotor where its numbers begin, and the place of its speed.
    fn new(bodies: impl Iterator<Item = usize>, rotors: impl Iterator<Item = (usize, usize)>) -> Self {
        Self {
            masses: bodies.map(Inertial::place).collect(),
            rotors: rotors
                .map(|(first, speed)| [first + at::thrust_coefficient, first + at::max_speed, speed])
                .collect(),
        }
    }

    /// Whether its weight or its lift depends on number k.
    pub(crate) fn depends_on(&self, k: usize) -> bool {
        k == 0 || self.masses.contains(&k) || self.rotors.iter().any(|[k_f, fastest, _]| k == *k_f || k == *fastest)
    }

    /// Weight over largest thrust.
    fn share(&self, numbers: &[f64]) -> f64 {
        let mass: f64 = self.masses.iter().map(|k| numbers[*k]).sum();
        let lift: f64 = self.rotors.iter().map(|[k_f, fastest, _]| numbers[*k_f] * numbers[*fastest].powi(2)).sum();
        mass * numbers[0] / lift
    }

    /// Rotors turn such that the tree carries its weight by these numbers.
    pub(crate) fn hover(&self, rest: &[f64], nominal: &[f64], numbers: &[f64], state: &mut [f64]) {
        let (own, usual) = (self.share(numbers), self.share(nominal));
        if !(own > 0.0 && usual > 0.0) {
            return;
        }
        let factor = (own / usual).sqrt();
        for [_, fastest, speed] in &self.rotors {
            let wanted = rest[*speed] * factor * numbers[*fastest] / nominal[*fastest];
            state[*speed] = wanted.min(numbers[*fastest]);
        }
    }
}

/// Trees with rotors.
pub(crate) fn flocks(robot: &Robot) -> Vec<Flock> {
    let n = N_ROTOR_PARAMETER;
    match robot.plant() {
        Plant::Rigid(_) => {
            let rotors = robot.drone().rotors.iter().enumerate().map(|(i, r)| (BODY_PARAMETERS.len() + i * n, r.speed));
            vec![Flock::new(0..1, rotors)]
        }
        Plant::Tree(m) => {
            let (layout, first) = (m.layout(), 1 + robot.n_frame() * LINK_PARAMETERS.len());
            let rotor = |r: usize| (first + r * n, layout.rotor_speed[r]);
            let flock = |tree: &TreePlace| Flock::new(tree.bodies.clone(), tree.rotors.clone().map(rotor));
            layout.trees.iter().map(flock).filter(|f| !f.rotors.is_empty()).collect()
        }
    }
}

/// Makes principal moments and products of inertia (xx, yy, zz, xy, xz, yz) those of a body: no moment above the sum of
/// the others, about any axes. Moments are lowered, then products; what is physical keeps its bits.
pub(crate) fn settle(inertia: &mut [f64]) {
    for i in 0..3 {
        let others = inertia[(i + 1) % 3] + inertia[(i + 2) % 3];
        if inertia[i] > others {
            inertia[i] = MOST_OF_OTHERS * others;
        }
    }
    if is_body(inertia, 1.0) {
        return;
    }
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if is_body(inertia, middle) { low = middle } else { high = middle }
    }
    inertia[3..].iter_mut().for_each(|product| *product *= low);
}

/// Whether the second moments of mass, ½ tr(J) 1 − J, are positive semi-definite with `factor` times the products.
fn is_body(j: &[f64], factor: f64) -> bool {
    let half = 0.5 * (j[0] + j[1] + j[2]);
    let d = [half - j[0], half - j[1], half - j[2]];
    let [xy, xz, yz] = [j[3], j[4], j[5]].map(|x| -factor * x);
    // rounding of bodies that are flat or thin
    let slack = 1e-9 * half;
    let minor = |a: f64, b: f64, c: f64| a * b - c * c >= -slack * slack;
    let determinant = d[0] * (d[1] * d[2] - yz * yz) - xy * (xy * d[2] - yz * xz) + xz * (xy * yz - d[1] * xz);
    d.iter().all(|x| *x >= -slack)
        && minor(d[0], d[1], xy)
        && minor(d[0], d[2], xz)
        && minor(d[1], d[2], yz)
        && determinant >= -slack * slack * slack
}

/// Largest principal moment as a share of the sum of the others: just inside a flat plate's.
pub(crate) const MOST_OF_OTHERS: f64 = 0.999;
