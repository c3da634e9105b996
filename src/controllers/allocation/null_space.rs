//! Of all inputs that make a wrench, those nearest to a goal: the closed form where it keeps every bound and cone, else
//! the cone program.
//!
//! ```text
//! u_pref = u_goal + B⁺ (w − B u_goal)         B⁺ in units of W^½, directions below [`WEAK`] left out
//! ```
//!
//! u_pref makes the wrench exactly, so where it is allowed it is the minimum of the [`Problem`] for any ρ, and ρ only says
//! what a limit costs: `GIVE` of the largest diagonal entry of BᵀWB lets the wrench miss about a thousandth of what
//! inputs have to give way.

use super::allocator::{Allocator, Counts, Solver};
use super::problem::{Problem, SWEEPS, WRENCH};
use crate::controller::Note;
use base::error::Result;
use nalgebra::{DMatrix, DVector, SVector};

/// Weakest direction of a wrench, over the strongest, that inputs are spent on.
pub const WEAK: f64 = 0.02;
/// ρ over the largest diagonal entry of BᵀWB.
pub(crate) const GIVE: f64 = 1e-3;

/// An [`Allocator`] whose preference follows the wrench: of all inputs that make it, those nearest to a goal,
/// `u = u_goal + B⁺ (w − B u_goal)`, or the bounded problem where that breaks a limit.
pub struct NullSpaceAllocator {
    problem: Problem,
    allocator: Allocator,
    /// Of this geometry.
    geometry: DMatrix<f64>,
    inverse: DMatrix<f64>,
    /// B⁺ times what a goal misses.
    step: DVector<f64>,
    inputs: Vec<f64>,
    free: u64,
}

impl NullSpaceAllocator {
    /// For a problem whose preference and ρ are set here.
    ///
    /// # Errors
    /// As [`Problem::validate`].
    pub fn new(mut problem: Problem) -> Result<Self> {
        let n = problem.n_input();
        problem.preference = vec![0.0; n];
        problem.regularisation = give(&problem);
        let allocator = Allocator::new(problem.clone())?;
        let inputs = if problem.cones.is_empty() { problem.preference.clone() } else { problem.anchor.clone() };
        let inverse = pseudo_inverse(&problem);
        let (geometry, step) = (problem.geometry.clone(), DVector::zeros(n));
        Ok(Self { problem, allocator, geometry, inverse, step, inputs, free: 0 })
    }

    /// B⁺, n × 6: the pseudo-inverse of the geometry weighed by W, directions weaker than 0.02 of the strongest left out.
    pub fn inverse(&self) -> &DMatrix<f64> {
        &self.inverse
    }

    /// How much of each axis of a wrench the closed form makes, 0 to 1: the diagonal of B B⁺.
    pub fn reached(&self) -> [f64; WRENCH] {
        let all = &self.problem.geometry * &self.inverse;
        std::array::from_fn(|k| all[(k, k)])
    }

    /// Changes geometry, bounds or cones. A problem that is then not valid is met in [`solve`](Self::solve), by holding.
    pub fn change(&mut self, change: impl FnOnce(&mut Problem)) {
        change(&mut self.problem);
        if self.problem.geometry != self.geometry {
            self.geometry.clone_from(&self.problem.geometry);
            self.inverse = pseudo_inverse(&self.problem);
            self.problem.regularisation = give(&self.problem);
        }
    }

    /// The last inputs.
    pub fn inputs(&self) -> &[f64] {
        &self.inputs
    }

    /// How often the closed form kept all limits, and what the allocator did otherwise.
    pub fn counts(&self) -> (u64, Counts) {
        (self.free, self.allocator.counts())
    }

    /// How often limits acted, for tables.
    pub fn note(&self) -> Note {
        let (free, counts) = self.counts();
        let held = counts.of(Solver::Held);
        let all = free + counts.solvers.iter().sum::<u64>();
        let share = 100.0 * (all - free) as f64 / all.max(1) as f64;
        Note::new(
            "forces at a limit",
            format!("{share:.1} %"),
            format!("of {all} allocations; {held} held for want of a certificate"),
        )
    }

    /// The inputs for a wrench `[force; moment]` (N, N m), nearest to `goal`, `[n_input]`. Where nothing is certified the last ones
    /// are held. Allocates where a limit acts: the cone
    /// program and clarabel do.
    pub fn solve(&mut self, wrench: &[f64; WRENCH], goal: &[f64]) -> &[f64] {
        let rest = self.problem.miss(wrench, goal);
        self.inverse.mul_to(&SVector::<f64, WRENCH>::from(rest), &mut self.step);
        for ((wish, g), c) in self.problem.preference.iter_mut().zip(goal).zip(&self.step) {
            *wish = g - c;
        }
        if self.problem.violation(&self.problem.preference) == 0.0 {
            self.free += 1;
            self.inputs.copy_from_slice(&self.problem.preference);
            return &self.inputs;
        }
        let now = self.problem.clone();
        if self.allocator.update(|p| *p = now).is_ok() {
            let fresh = self.allocator.solve(wrench);
            if fresh.reason.is_none() {
                self.inputs.copy_from_slice(&fresh.inputs);
            }
        }
        &self.inputs
    }
}

/// ρ of the present geometry; 1 for one of zeros.
fn give(problem: &Problem) -> f64 {
    let weight = |j| problem.geometry.column(j).iter().zip(&problem.weights).map(|(b, w)| w * b * b).sum();
    let largest = (0..problem.n_input()).map(weight).fold(0.0, f64::max);
    if largest > 0.0 { GIVE * largest } else { 1.0 }
}

/// B⁺ = (W^½ B)⁺ W^½ without the weak directions.
fn pseudo_inverse(problem: &Problem) -> DMatrix<f64> {
    let root = DMatrix::from_diagonal(&DVector::from_iterator(WRENCH, problem.weights.iter().map(|w| w.sqrt())));
    let svd = (&root * &problem.geometry).try_svd(true, true, 5.0 * f64::EPSILON, SWEEPS);
    let inverse = svd.and_then(|svd| {
        let tolerance = WEAK * svd.singular_values.max();
        svd.pseudo_inverse(tolerance).ok()
    });
    inverse.map_or_else(|| DMatrix::zeros(problem.n_input(), WRENCH), |inverse| inverse * root)
}
