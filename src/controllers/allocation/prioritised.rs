//! Priorities without weights: each stage is met as well as the stages before it leave room.
//!
//! Stage s minimises its own rows of ‖W^½(Bu − w)‖² over the inputs that keep what the earlier stages have reached,
//! B₁u = B₁u*. Those equalities enter by the method of multipliers (Hestenes 1969, Powell 1969): their rows get a large
//! weight, and every pass asks again for what is still missing. Each pass is an ordinary bounded problem with the same
//! Hessian, so the fast solver serves, warm.

use super::allocator::{AllocationSolution, Allocator, HoldReason, Solver};
use super::problem::{Problem, WRENCH};
use base::error::{Error, Result};

/// Weight of rows that must be kept, over their own.
const FIRMNESS: f64 = 1e3;
/// Most passes of one stage.
const PASSES: usize = 60;
/// What may be missing of earlier stages, over the size of the wrench or the inputs.
const KEPT: f64 = 1e-9;

/// A problem whose rows are met in order.
pub struct PrioritisedAllocator {
    problem: Problem,
    stages: Vec<Stage>,
    last: Vec<f64>,
    counts: PrioritisedCounts,
}

/// How often answers were whole, stopped at an earlier stage, or held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PrioritisedCounts {
    /// All stages solved.
    pub whole: u64,
    /// A later stage could not be solved: the answer of the one before it stands.
    pub stopped: u64,
    /// The first stage could not: the last inputs were held.
    pub held: u64,
}

struct Stage {
    allocator: Allocator,
    /// Rows of this stage and of those before.
    own: [bool; WRENCH],
    kept: [bool; WRENCH],
}

/// The answer of the last stage, and how each went.
#[derive(Debug, Clone, PartialEq)]
pub struct PrioritisedSolution {
    /// Of the last stage; its residual is that of its last pass.
    pub solution: AllocationSolution,
    /// Largest change that later stages made to a kept row, over the size of the problem.
    pub disturbed: f64,
    /// Passes of every stage.
    pub passes: Vec<usize>,
}

impl PrioritisedAllocator {
    /// `rows[s]` are the rows of stage s, by their number in a wrench `[force; moment]`, 0 to 5. Rows in no stage are left out.
    ///
    /// # Errors
    /// [`Error::Value`] for no stage, a row twice or out of range, or a problem with cones; otherwise as
    /// [`Problem::validate`].
    pub fn new(problem: Problem, rows: &[&[usize]]) -> Result<Self> {
        let wrong = |value: String, rule: &str| {
            Err(Error::value("allocation: stages", value, rule, "Give every row to one stage: [[2, 3, 4], [5]]."))
        };
        let mut all: Vec<usize> = rows.iter().flat_map(|r| r.iter().copied()).collect();
        all.sort_unstable();
        if all.is_empty() || all.iter().any(|r| *r >= WRENCH) || all.windows(2).any(|w| w[0] == w[1]) {
            return wrong(format!("{rows:?}"), "rows 0 to 5, each at most once, at least one");
        }
        if !problem.cones.is_empty() {
            return wrong(format!("{} cones", problem.cones.len()), "without cones");
        }
        let mut kept = [false; WRENCH];
        let mut stages = Vec::new();
        for rows in rows {
            let mut own = [false; WRENCH];
            rows.iter().for_each(|r| own[*r] = true);
            let mut staged = problem.clone();
            for k in 0..WRENCH {
                staged.weights[k] *= if own[k] {
                    1.0
                } else if kept[k] {
                    FIRMNESS
                } else {
                    0.0
                };
            }
            stages.push(Stage { allocator: Allocator::new(staged)?, own, kept });
            (0..WRENCH).for_each(|k| kept[k] |= own[k]);
        }
        let mut last = problem.preference.clone();
        problem.repair(&mut last, &[]);
        Ok(Self { problem, stages, last, counts: PrioritisedCounts::default() })
    }

    /// The problem, with the bounds of now.
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// New bounds for all stages.
    ///
    /// # Panics
    /// If a slice does not have one number per input.
    pub fn set_bounds(&mut self, lower: &[f64], upper: &[f64]) {
        self.problem.lower.copy_from_slice(lower);
        self.problem.upper.copy_from_slice(upper);
        self.stages.iter_mut().for_each(|s| s.allocator.set_bounds(lower, upper));
    }

    /// How answers came about.
    pub fn counts(&self) -> PrioritisedCounts {
        self.counts
    }

    /// The best inputs for a wrench (N, N m), stage by stage. Where a stage cannot be solved, the answer of the one before it
    /// stands; where the first cannot, the last answer is held within the bounds of now.
    pub fn solve(&mut self, wrench: &[f64; WRENCH]) -> PrioritisedSolution {
        let size = self.problem.scales(wrench).input;
        let mut reached = [0.0; WRENCH];
        let mut kept = [false; WRENCH];
        let mut answer: Option<AllocationSolution> = None;
        let mut passes = Vec::new();
        let mut reason = None;
        for stage in &mut self.stages {
            let (fresh, n) = stage.solve(wrench, &reached, size, answer.is_none());
            passes.push(n);
            if fresh.solver == Solver::Held {
                reason = fresh.reason;
                break;
            }
            let delivered = self.problem.delivered(&fresh.inputs);
            for k in 0..WRENCH {
                reached[k] = if stage.own[k] { delivered[k] } else { reached[k] };
            }
            kept = stage.kept;
            answer = Some(fresh);
        }
        match (&answer, reason) {
            (Some(_), None) => self.counts.whole += 1,
            (Some(_), Some(_)) => self.counts.stopped += 1,
            (None, _) => self.counts.held += 1,
        }
        let solution = answer.unwrap_or_else(|| self.hold(reason));
        self.last.copy_from_slice(&solution.inputs);
        let last = self.problem.delivered(&solution.inputs);
        let disturbed =
            (0..WRENCH).filter(|k| kept[*k]).map(|k| (last[k] - reached[k]).abs() / size).fold(0.0, f64::max);
        PrioritisedSolution { solution, disturbed, passes }
    }

    fn hold(&self, reason: Option<HoldReason>) -> AllocationSolution {
        let mut inputs = self.last.clone();
        self.problem.repair(&mut inputs, &[]);
        AllocationSolution {
            inputs,
            duals: Vec::new(),
            solver: Solver::Held,
            residual: f64::INFINITY,
            steps: 0,
            reason,
        }
    }
}

impl Stage {
    /// Passes until nothing is missing of what must be kept; one in the first stage.
    fn solve(
        &mut self,
        wrench: &[f64; WRENCH],
        reached: &[f64; WRENCH],
        size: f64,
        first: bool,
    ) -> (AllocationSolution, usize) {
        let mut asked = *wrench;
        for k in (0..WRENCH).filter(|k| self.kept[*k]) {
            asked[k] = reached[k];
        }
        let mut solution = self.allocator.solve(&asked).clone();
        if first {
            return (solution, 1);
        }
        for pass in 1..PASSES {
            if solution.solver == Solver::Held {
                return (solution, pass);
            }
            let delivered = self.allocator.problem().delivered(&solution.inputs);
            let mut missing = 0.0_f64;
            for k in (0..WRENCH).filter(|k| self.kept[*k]) {
                missing = missing.max((reached[k] - delivered[k]).abs());
                asked[k] += reached[k] - delivered[k];
            }
            if missing <= KEPT * size {
                return (solution, pass);
            }
            solution = self.allocator.solve(&asked).clone();
        }
        (solution, PASSES)
    }
}
