//! What follows from physical numbers: inertias that are those of bodies, speeds that carry a weight.

use super::robot::{Inertial, Robot};
use super::start::StartScalar;
use autodiff::Mask;
use dynamics::Plant;
use dynamics::rigid::BODY_PARAMETERS;
use dynamics::rotor::{N_ROTOR_PARAMETER, at};
use dynamics::tree::{LINK_PARAMETERS, TreePlace};

/// One tree: what is weighed, and what carries it.
#[derive(Debug, Clone, Default)]
pub(crate) struct MassGroup {
    /// Places of the masses.
    masses: Vec<usize>,
    /// Per rotor: places of its thrust coefficient and largest speed among the numbers, of its speed in the state.
    rotors: Vec<[usize; 3]>,
}

impl MassGroup {
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
    fn share<S: StartScalar>(&self, numbers: &[S]) -> S {
        let mass = self.masses.iter().fold(S::zero(), |sum, k| sum + numbers[*k]);
        let lift = |[k_f, fastest, _]: &[usize; 3]| numbers[*k_f] * numbers[*fastest].square();
        mass * numbers[0] / self.rotors.iter().fold(S::zero(), |sum, rotor| sum + lift(rotor))
    }

    /// Rotors turn such that the tree carries its weight by these numbers.
    pub(crate) fn hover<S: StartScalar>(&self, rest: &[f64], nominal: &[f64], numbers: &[S], state: &mut [S]) {
        let (own, usual) = (self.share(numbers), self.share(nominal));
        if usual.is_nan() || usual <= 0.0 {
            return;
        }
        let (has_weight, factor) = (S::zero().lt(own), (own.max(S::zero()) * S::from(1.0 / usual)).sqrt());
        for [_, fastest, speed] in &self.rotors {
            let wanted = factor * numbers[*fastest] * S::from(rest[*speed] / nominal[*fastest]);
            state[*speed] = S::select(has_weight, wanted.min(numbers[*fastest]), state[*speed]);
        }
    }
}

/// Trees with rotors.
pub(crate) fn flocks(robot: &Robot) -> Vec<MassGroup> {
    let n = N_ROTOR_PARAMETER;
    match robot.plant() {
        Plant::Rigid(_) => {
            let rotors = robot.drone().rotors.iter().enumerate().map(|(i, r)| (BODY_PARAMETERS.len() + i * n, r.speed));
            vec![MassGroup::new(0..1, rotors)]
        }
        Plant::Tree(m) => {
            let (layout, first) = (m.layout(), 1 + robot.n_frame() * LINK_PARAMETERS.len());
            let rotor = |r: usize| (first + r * n, layout.rotor_speed[r]);
            let flock = |tree: &TreePlace| MassGroup::new(tree.bodies.clone(), tree.rotors.clone().map(rotor));
            layout.trees.iter().map(flock).filter(|f| !f.rotors.is_empty()).collect()
        }
    }
}

/// Makes principal moments and products of inertia (xx, yy, zz, xy, xz, yz) those of a body: no moment above the sum of
/// the others, about any axes. Moments are lowered, then products; what is physical keeps its bits.
pub(crate) fn settle<S: StartScalar>(inertia: &mut [S]) {
    for i in 0..3 {
        let others = inertia[(i + 1) % 3] + inertia[(i + 2) % 3];
        let is_more = (others * S::from(1.0 + SLACK)).lt(inertia[i]);
        inertia[i] = S::select(is_more, S::from(MOST_OF_OTHERS) * others, inertia[i]);
    }
    let stays = is_body(inertia, S::one());
    let mut low = S::zero();
    for k in 1..=HALVINGS {
        let middle = low + S::from(0.5_f64.powi(k));
        low = S::select(is_body(inertia, middle), middle, low);
    }
    inertia[3..].iter_mut().for_each(|product| *product = S::select(stays, *product, *product * low));
}

/// Steps in which the largest share of products is found, to 6e-8.
const HALVINGS: i32 = 24;

/// Whether the second moments of mass, ½ tr(J) 1 − J, are positive semi-definite with `factor` times the products.
fn is_body<S: StartScalar>(j: &[S], factor: S) -> S::Mask {
    // as shares of ½ tr(J): products of three moments of a light body leave the range of f32
    let half = S::from(0.5) * (j[0] + j[1] + j[2]);
    let inverse = S::one() / half;
    let d = [0, 1, 2].map(|i| (half - j[i]) * inverse + S::from(SLACK));
    let [xy, xz, yz] = [j[3], j[4], j[5]].map(|x| -(factor * x * inverse));
    // by pivots: products of three would be lost in rounding where a body is flat or thin
    let first = d[0];
    let second = d[1] - xy * xy / first;
    let beside = yz - xy * xz / first;
    let third = d[2] - xz * xz / first - beside * beside / second;
    [first, second, third].into_iter().map(|pivot| S::zero().lt(pivot)).reduce(Mask::and).expect("three")
}

/// What rounding to `f32` makes of the second moments of a body that is flat or thin, as a share of ½ tr(J).
const SLACK: f64 = 1e-6;

/// Largest principal moment as a share of the sum of the others: just inside a flat plate's.
pub(crate) const MOST_OF_OTHERS: f64 = 0.999;

#[cfg(test)]
mod tests {
    use super::*;
    use autodiff::Recording;
    use nalgebra::{Matrix3, Rotation3, Vector3};
    use rng::{Purpose, Stream};

    /// By a recording in `f32`, as programs do.
    fn settled(recording: &Recording, inertia: [f64; 6]) -> ([f32; 6], [f32; 6]) {
        let (given, mut own) = (inertia.map(|x| x as f32), [0.0; 6]);
        recording.evaluate(&given, &mut own);
        (given, own)
    }

    /// Moments and products of second moments, turned.
    fn inertia(second: [f64; 3], turn: Rotation3<f64>) -> [f64; 6] {
        let m = turn.matrix() * Matrix3::from_diagonal(&Vector3::from(second)) * turn.matrix().transpose();
        let j = Matrix3::identity() * m.trace() - m;
        [j[(0, 0)], j[(1, 1)], j[(2, 2)], j[(0, 1)], j[(0, 2)], j[(1, 2)]]
    }

    fn recording() -> Recording {
        Recording::of(6, |z| {
            let mut own = z.to_vec();
            settle(&mut own);
            own
        })
    }

    #[test]
    fn bodies_however_flat_or_thin_keep_their_bits() {
        let (recording, mut draw) = (recording(), Stream::new(1, 2, 3, Purpose::user(9)));
        for thin in [0.0, 1e-6, 1e-5, 1e-4, 1e-2, 1.0] {
            for turned in [false, true] {
                for _ in 0..2000 {
                    let size = 1e-5 * (10.0 * draw.unit()).exp();
                    for second in [[1.0, thin, thin], [1.0, draw.unit(), thin], [draw.unit(), draw.unit(), draw.unit()]]
                    {
                        let [a, b, c] = [0; 3].map(|_| draw.uniform(-3.0, 3.0));
                        let turn = if turned { Rotation3::from_euler_angles(a, b, c) } else { Rotation3::identity() };
                        let (given, own) = settled(&recording, inertia(second.map(|x| size * x), turn));
                        assert_eq!(own, given, "{second:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn what_no_body_has_is_made_that_of_one() {
        let (recording, mut draw) = (recording(), Stream::new(1, 2, 4, Purpose::user(9)));
        let (mut worst, mut changed) = (0.0_f64, 0);
        for _ in 0..2000 {
            let mut drawn = [0; 6].map(|_| draw.uniform(0.1, 1.0));
            drawn[3..].iter_mut().for_each(|x| *x -= 0.5);
            let (given, own) = settled(&recording, drawn);
            changed += usize::from(own != given);
            let [xx, yy, zz, xy, xz, yz] = own.map(f64::from);
            let j = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
            let half = 0.5 * j.trace();
            let least = (Matrix3::identity() * half - j).symmetric_eigenvalues().min();
            worst = worst.max(-least / half);
        }
        // 1.1e-6
        assert!(worst < 1.5e-6 && changed > 1000, "{worst:e}, {changed}");
    }
}
