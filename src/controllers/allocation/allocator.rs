//! Wrench in, certified inputs out: the solvers behind one interface, and what happens when they fail.
//!
//! In order: the closed form where no bound is active; the [active set](super::active_set) for problems without cones;
//! [clarabel](super::conic) for everything. The first answer whose [residual](super::residual) is within tolerance is
//! taken. Where none is, or the wrench is not finite, the last good inputs are held (within the bounds of now), and
//! that is counted.

use super::conic::ConicSolver;
use super::fast::Fast;
use super::gradient::AllocationSensitivity;
use super::problem::{Problem, Scales, WRENCH, rate_window};
use super::residual::residual;
use super::variation::Variation;
use base::defaults::with_defaults;
use base::error::{Error, Result, finite};

/// Most Newton steps on an interior point: each doubles its digits.
const POLISHES: usize = 3;

/// The method that found an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Solver {
    /// No bound acts: one matrix product.
    ClosedForm,
    /// Bounds act, exactly.
    ActiveSet,
    /// Cones, or the active set was not certified.
    Clarabel,
    /// None: the last good inputs are held, within the present bounds.
    Held,
}

impl Solver {
    /// In the order of preference.
    pub const ALL: [Self; 4] = [Self::ClosedForm, Self::ActiveSet, Self::Clarabel, Self::Held];

    /// For tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::ClosedForm => "closed form",
            Self::ActiveSet => "active set",
            Self::Clarabel => "clarabel",
            Self::Held => "held",
        }
    }
}

/// Why inputs were held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum HoldReason {
    /// The wrench holds NaN or an infinity.
    Wrench,
    /// Bounds are out of order or not numbers.
    Bounds,
    /// No solver's answer passed the certificate.
    Uncertified,
}

/// An allocation.
#[derive(Debug, Clone, PartialEq)]
pub struct AllocationSolution {
    /// u, `[n_input]`, in the unit of the inputs (N for thrusts).
    pub inputs: Vec<f64>,
    /// Multipliers of each cone, head first; empty where there are none.
    pub duals: Vec<Vec<f64>>,
    /// The method that found it.
    pub solver: Solver,
    /// Scaled KKT residual, without unit, recomputed from the conditions of optimality; see [`Problem::scales`].
    pub residual: f64,
    /// Steps of the active set or iterations of clarabel.
    pub steps: u32,
    /// Why inputs were held; `None` where they were not.
    pub reason: Option<HoldReason>,
}

/// How often each path was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Answers of each solver, in the order of [`Solver::ALL`].
    pub solvers: [u64; 4],
    /// Answers of the closed form, the active set and clarabel that did not pass the certificate.
    pub refused: [u64; 3],
}

impl Counts {
    /// How often `solver` found the answer.
    pub fn of(&self, solver: Solver) -> u64 {
        self.solvers[solver as usize]
    }
}

with_defaults! {
    /// What an allocator may use, and how exact an answer has to be.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct AllocatorSettings {
        /// Largest scaled KKT residual of an answer that moves a rotor. Default 1e-7.
        pub tolerance: f64 = 1e-7,
        /// Whether the closed form and the active set are tried before clarabel. Default true.
        pub fast: bool = true,
        /// Whether the active set starts from the last one. Default true.
        pub warm: bool = true,
    }
}

/// A [`Problem`] set up once, solved tick by tick.
pub struct Allocator {
    /// With the bounds of now.
    problem: Problem,
    /// Bounds before rates narrow them.
    lower: Vec<f64>,
    upper: Vec<f64>,
    settings: AllocatorSettings,
    fast: Option<Box<Fast>>,
    conic: Option<ConicSolver>,
    last: AllocationSolution,
    /// What a solver offers before it is certified.
    trial: AllocationSolution,
    /// The wrench of `last`, until a number of the problem changes.
    solved: Option<[f64; WRENCH]>,
    counts: Counts,
    gradient: Vec<f64>,
}

impl Allocator {
    /// With default [`AllocatorSettings`].
    ///
    /// # Errors
    /// As [`Problem::validate`].
    pub fn new(problem: Problem) -> Result<Self> {
        Self::with_settings(problem, AllocatorSettings::default())
    }

    /// With given settings.
    ///
    /// # Errors
    /// As [`Problem::validate`].
    pub fn with_settings(problem: Problem, settings: AllocatorSettings) -> Result<Self> {
        problem.validate()?;
        let tolerance = settings.tolerance;
        if !(tolerance.is_finite() && tolerance > 0.0) {
            let remedy = "1e-7 is usual.";
            return Err(Error::value("allocation: settings.tolerance", tolerance, "> 0 and finite", remedy));
        }
        let n = problem.n_input();
        let mut inputs = vec![0.0; n];
        problem.start(&mut inputs);
        let last = AllocationSolution {
            inputs,
            duals: Vec::new(),
            solver: Solver::Held,
            residual: f64::INFINITY,
            steps: 0,
            reason: None,
        };
        Ok(Self {
            lower: problem.lower.clone(),
            upper: problem.upper.clone(),
            fast: Fast::of(&problem, settings),
            trial: last.clone(),
            problem,
            settings,
            conic: None,
            last,
            solved: None,
            counts: Counts::default(),
            gradient: vec![0.0; n],
        })
    }

    /// The problem as it stands.
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// The last answer; before the first, the preferred inputs.
    pub fn solution(&self) -> &AllocationSolution {
        &self.last
    }

    /// How often each path was taken.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// New bounds, `[n_input]` each, in the unit of the inputs; does not allocate. Bounds out of order are met in
    /// [`solve`](Self::solve), by holding.
    ///
    /// # Panics
    /// If a slice does not have one number per input.
    pub fn set_bounds(&mut self, lower: &[f64], upper: &[f64]) {
        self.lower.copy_from_slice(lower);
        self.upper.copy_from_slice(upper);
        self.problem.lower.copy_from_slice(lower);
        self.problem.upper.copy_from_slice(upper);
        self.solved = None;
    }

    /// Narrows the bounds to what changes of at most `most` from `previous` reach, until they are set again; does not
    /// allocate. See [`rate_window`].
    ///
    /// # Panics
    /// If a slice does not have one number per input.
    pub fn limit_rates(&mut self, previous: &[f64], most: &[f64]) {
        assert_eq!((previous.len(), most.len()), (self.lower.len(), self.lower.len()), "one number per input");
        for i in 0..previous.len() {
            (self.problem.lower[i], self.problem.upper[i]) =
                rate_window(self.lower[i], self.upper[i], previous[i], most[i]);
        }
        self.solved = None;
    }

    /// New geometry (6 × n by columns), weights and preference; the active set is kept for the next start. Does not
    /// allocate on the fast path.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers that are not finite, weights below 0, or slices of another length; the allocator then
    /// keeps its old problem.
    pub fn set_task(&mut self, geometry: &[f64], weights: [f64; WRENCH], preference: &[f64]) -> Result<()> {
        let n = self.problem.n_input();
        if geometry.len() != WRENCH * n || preference.len() != n {
            let sizes = format!("{} and {}", geometry.len(), preference.len());
            let rule = format!("{} and {n}", WRENCH * n);
            return Err(Error::value(
                "allocation: lengths of geometry and preference",
                sizes,
                rule,
                "Give all inputs.",
            ));
        }
        finite("allocation: geometry", geometry)?;
        finite("allocation: preference", preference)?;
        finite("allocation: weights", &weights)?;
        if let Some(weight) = weights.iter().find(|w| **w < 0.0) {
            return Err(Error::value("allocation: weights", weight, "≥ 0", "0 leaves a row out."));
        }
        self.problem.geometry.as_mut_slice().copy_from_slice(geometry);
        self.problem.weights = weights;
        self.problem.preference.copy_from_slice(preference);
        if let Some(fast) = &mut self.fast {
            fast.prepare(&self.problem);
        }
        self.solved = None;
        Ok(())
    }

    /// Changes anything else; sets the fast path up again.
    ///
    /// # Errors
    /// As [`Problem::validate`]; the allocator then keeps its old problem.
    pub fn update(&mut self, change: impl FnOnce(&mut Problem)) -> Result<()> {
        let mut problem = self.problem.clone();
        change(&mut problem);
        problem.validate()?;
        if problem.n_input() != self.problem.n_input() {
            let (now, was) = (problem.n_input(), self.problem.n_input());
            return Err(Error::value("allocation: inputs", now, format!("{was} as before"), "Make a new allocator."));
        }
        self.lower.copy_from_slice(&problem.lower);
        self.upper.copy_from_slice(&problem.upper);
        self.problem = problem;
        self.fast = Fast::of(&self.problem, self.settings);
        self.last.duals.clear();
        self.trial.duals.clear();
        self.solved = None;
        Ok(())
    }

    /// Changes any number of the problem and forgets what was solved, so that the next answer is that of a new allocator.
    /// Does not allocate where the problem has no cones.
    ///
    /// # Errors
    /// As [`Problem::validate`]; nothing may then be solved before another start that is none.
    pub(super) fn restart(&mut self, change: impl FnOnce(&mut Problem)) -> Result<()> {
        change(&mut self.problem);
        self.problem.validate()?;
        self.lower.copy_from_slice(&self.problem.lower);
        self.upper.copy_from_slice(&self.problem.upper);
        if let Some(fast) = &mut self.fast {
            fast.prepare(&self.problem);
        }
        self.forget();
        Ok(())
    }

    /// Forgets what was solved: the next answer is that of a new allocator.
    pub(super) fn forget(&mut self) {
        if let Some(fast) = &mut self.fast {
            fast.warm = false;
        }
        self.problem.start(&mut self.last.inputs);
        self.last.duals.clear();
        self.trial.duals.clear();
        (self.conic, self.solved) = (None, None);
    }

    /// The best inputs for a wrench `[force; moment]` (N, N m, in the axes and about the point of the geometry): the least
    /// [`Problem::objective`] within all bounds and cones. Without a certified answer the last good inputs are held, and
    /// [`AllocationSolution::reason`] says why.
    pub fn solve(&mut self, wrench: &[f64; WRENCH]) -> &AllocationSolution {
        let reason = match self.unusable(wrench) {
            Some(reason) => Some(reason),
            None if self.try_fast(wrench) || self.try_conic(wrench) => None,
            None => Some(HoldReason::Uncertified),
        };
        match reason {
            None => {
                std::mem::swap(&mut self.last, &mut self.trial);
                self.last.reason = None;
                self.solved = Some(*wrench);
            }
            Some(reason) => self.hold(reason),
        }
        self.counts.solvers[self.last.solver as usize] += 1;
        &self.last
    }

    /// The gradient of a cost with respect to every number of the problem, from `cotangent` = ∂cost/∂u*, `[n_input]`, at the last
    /// answer; over the numbers of `out`. On the fast paths the factorisation of the answer is used again, and nothing is
    /// allocated. Returns the [`AllocationSensitivity::margin`] to the next change of the active set: near 0 the derivative is
    /// one-sided. `None`, with NaN in `out`, where inputs were held or the problem has changed since.
    ///
    /// # Panics
    /// If `cotangent` or `out` do not have the sizes of the problem.
    pub fn reverse(&self, cotangent: &[f64], out: &mut Variation) -> Option<f64> {
        let margin = self.solved.and_then(|wrench| match (self.last.solver, &self.fast) {
            (Solver::ClosedForm | Solver::ActiveSet, Some(fast)) => {
                let closed = self.last.solver == Solver::ClosedForm;
                Some(fast.reverse(&self.problem, &wrench, &self.last.inputs, closed, cotangent, out))
            }
            _ => {
                let at = AllocationSensitivity::new(&self.problem, &wrench, &self.last)?;
                at.reverse_into(cotangent, out);
                Some(at.margin())
            }
        });
        if margin.is_none() {
            out.numbers_mut().for_each(|x| *x = f64::NAN);
        }
        margin
    }

    /// The change of the last answer with a change of the problem's numbers, du*, into `out`, `[n_input]`: the transpose of
    /// [`reverse`](Self::reverse), likewise without allocation on the fast paths. Returns the same margin, or `None`.
    ///
    /// # Panics
    /// If `change` or `out` do not have the sizes of the problem.
    pub fn forward(&self, change: &Variation, out: &mut [f64]) -> Option<f64> {
        let margin = self.solved.and_then(|wrench| match (self.last.solver, &self.fast) {
            (Solver::ClosedForm | Solver::ActiveSet, Some(fast)) => {
                let closed = self.last.solver == Solver::ClosedForm;
                Some(fast.forward(&self.problem, &wrench, &self.last.inputs, closed, change, out))
            }
            _ => {
                let at = AllocationSensitivity::new(&self.problem, &wrench, &self.last)?;
                out.copy_from_slice(&at.forward(change));
                Some(at.margin())
            }
        });
        if margin.is_none() {
            out.fill(f64::NAN);
        }
        margin
    }

    /// The problem with what its fast paths prepared, and the largest residual; `None` without them.
    pub(super) fn fast_paths(&self) -> Option<(&Problem, &Fast, f64)> {
        Some((&self.problem, self.fast.as_deref()?, self.settings.tolerance))
    }

    fn unusable(&self, wrench: &[f64; WRENCH]) -> Option<HoldReason> {
        let ordered = |(lo, hi): (&f64, &f64)| lo <= hi && *lo < f64::INFINITY && *hi > f64::NEG_INFINITY;
        if !self.problem.lower.iter().zip(&self.problem.upper).all(ordered) {
            return Some(HoldReason::Bounds);
        }
        let sane = wrench.iter().all(|w| w.is_finite()) && self.problem.scales(wrench).gradient.is_finite();
        (!sane).then_some(HoldReason::Wrench)
    }

    /// Closed form, then active set; the answer is in `trial`.
    fn try_fast(&mut self, wrench: &[f64; WRENCH]) -> bool {
        let Some(fast) = &mut self.fast else { return false };
        let (problem, trial, tolerance) = (&self.problem, &mut self.trial, self.settings.tolerance);
        let scales = fast.task(problem, wrench);
        if fast.free(problem, wrench, &mut trial.inputs) {
            if certify(problem, wrench, trial, scales, &mut self.gradient, tolerance) {
                (trial.solver, trial.steps) = (Solver::ClosedForm, 0);
                return true;
            }
            self.counts.refused[0] += 1;
        }
        let (steps, done) = fast.search(problem, self.settings.warm, &mut trial.inputs);
        let good = done && certify(problem, wrench, trial, scales, &mut self.gradient, tolerance);
        fast.warm = good;
        (trial.solver, trial.steps) = (Solver::ActiveSet, steps);
        self.counts.refused[1] += u64::from(!good);
        good
    }

    fn try_conic(&mut self, wrench: &[f64; WRENCH]) -> bool {
        let conic = match &mut self.conic {
            Some(conic) => Ok(conic),
            none => ConicSolver::new(&self.problem).map(|conic| none.insert(conic)),
        };
        let Ok(offer) = conic.and_then(|conic| conic.solve(&self.problem, wrench)) else {
            self.counts.refused[2] += 1;
            return false;
        };
        let first = self.measured(wrench, offer.inputs, offer.duals);
        // all steps before the verdict: the first may leave the cones by more than the interior point stayed inside
        let mut trial = first.clone();
        for _ in 0..POLISHES {
            let Some(at) = AllocationSensitivity::new(&self.problem, wrench, &trial) else { break };
            (trial.inputs, trial.duals) = at.polished(&trial.duals);
        }
        let polished = self.measured(wrench, trial.inputs, trial.duals);
        let best = if polished.residual < first.residual { polished } else { first };
        let good = best.residual <= self.settings.tolerance && self.problem.violation(&best.inputs) == 0.0;
        self.trial = AllocationSolution { steps: offer.iterations, ..best };
        self.counts.refused[2] += u64::from(!good);
        good
    }

    /// A point as clarabel's answer: within all limits, with its residual.
    fn measured(&mut self, wrench: &[f64; WRENCH], mut inputs: Vec<f64>, duals: Vec<Vec<f64>>) -> AllocationSolution {
        self.problem.repair(&mut inputs, &self.last.inputs);
        let scales = self.problem.scales(wrench);
        let residual = residual(&self.problem, wrench, &inputs, &duals, scales, &mut self.gradient);
        AllocationSolution { inputs, duals, solver: Solver::Clarabel, residual, steps: 0, reason: None }
    }

    /// The last good inputs, within the bounds of now where those are in order.
    fn hold(&mut self, reason: HoldReason) {
        self.problem.repair(&mut self.last.inputs, &[]);
        self.last.duals.clear();
        self.last.solver = Solver::Held;
        (self.last.reason, self.last.residual, self.last.steps) = (Some(reason), f64::INFINITY, 0);
        self.solved = None;
    }
}

/// Measures an answer and says whether it may move a rotor.
fn certify(
    problem: &Problem,
    wrench: &[f64; WRENCH],
    answer: &mut AllocationSolution,
    scales: Scales,
    gradient: &mut [f64],
    tolerance: f64,
) -> bool {
    answer.residual = residual(problem, wrench, &answer.inputs, &answer.duals, scales, gradient);
    answer.residual <= tolerance && problem.violation(&answer.inputs) == 0.0
}
