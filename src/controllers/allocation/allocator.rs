//! Wrench in, certified inputs out: the solvers behind one interface, and what happens when they fail.
//!
//! In order: the closed form where no bound is active; the [active set](super::active_set) for problems without cones;
//! [clarabel](super::conic) for everything. The first answer whose [residual](super::residual) is within tolerance is
//! taken. Where none is, or the wrench is not finite, the last good inputs are held (within the bounds of now), and
//! that is counted.

use super::active_set::{BoxProgram, FAR, Factor, Iterate, Precision};
use super::conic::Conic;
use super::gradient::Sensitivity;
use super::problem::{Problem, Scales, WRENCH, rate_window};
use super::residual::residual;
use super::variation::Variation;
use crate::error::{Error, Result, finite};

/// Most inputs of the fast path.
pub const MAX_FAST: usize = 24;
/// Most steps of the active set; the most seen over 10⁵ random problems is far below.
const MAX_STEPS: u32 = 100;

/// Most Newton steps on an interior point: each doubles its digits.
const POLISHES: usize = 3;

/// Who found an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Path {
    /// No bound acts: one matrix product.
    ClosedForm,
    /// Bounds act, exactly.
    ActiveSet,
    /// Cones, or the active set was not certified.
    Clarabel,
    /// Nobody: the last good inputs, within the bounds of now.
    Held,
}

impl Path {
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
pub enum Reason {
    /// The wrench holds NaN or an infinity.
    Wrench,
    /// Bounds are out of order or not numbers.
    Bounds,
    /// No solver's answer passed the certificate.
    Uncertified,
}

/// An allocation.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// u.
    pub inputs: Vec<f64>,
    /// Multipliers of each cone, head first; empty where there are none.
    pub duals: Vec<Vec<f64>>,
    /// Who found it.
    pub path: Path,
    /// Scaled KKT residual, recomputed.
    pub residual: f64,
    /// Steps of the active set or iterations of clarabel.
    pub steps: u32,
    /// Why inputs were held, if they were.
    pub reason: Option<Reason>,
}

/// How often each path was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// In the order of [`Path::ALL`].
    pub paths: [u64; 4],
    /// Answers of the closed form, the active set and clarabel that did not pass the certificate.
    pub refused: [u64; 3],
}

impl Counts {
    /// How often `path` was taken.
    pub fn of(&self, path: Path) -> u64 {
        self.paths[path as usize]
    }
}

/// What an allocator may use, and how exact an answer has to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Largest scaled KKT residual of an answer that moves a rotor.
    pub tolerance: f64,
    /// Whether the closed form and the active set are tried before clarabel.
    pub fast: bool,
    /// Whether the active set starts from the last one.
    pub warm: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self { tolerance: 1e-7, fast: true, warm: true }
    }
}

/// A [`Problem`] set up once, solved tick by tick.
pub struct Allocator {
    /// With the bounds of now.
    problem: Problem,
    /// Bounds before rates narrow them.
    lower: Vec<f64>,
    upper: Vec<f64>,
    settings: Settings,
    fast: Option<Box<Fast>>,
    conic: Option<Conic>,
    last: Solution,
    /// What a solver offers before it is certified.
    trial: Solution,
    /// The wrench of `last`, until a number of the problem changes.
    solved: Option<[f64; WRENCH]>,
    counts: Counts,
    gradient: Vec<f64>,
}

impl Allocator {
    /// With default [`Settings`].
    ///
    /// # Errors
    /// As [`Problem::validate`].
    pub fn new(problem: Problem) -> Result<Self> {
        Self::with_settings(problem, Settings::default())
    }

    /// With given settings.
    ///
    /// # Errors
    /// As [`Problem::validate`].
    pub fn with_settings(problem: Problem, settings: Settings) -> Result<Self> {
        problem.validate()?;
        let tolerance = settings.tolerance;
        if !(tolerance.is_finite() && tolerance > 0.0) {
            let remedy = "1e-7 is usual.";
            return Err(Error::value("allocation: settings.tolerance", tolerance, "> 0 and finite", remedy));
        }
        let n = problem.n_input();
        let mut inputs = if problem.cones.is_empty() { problem.preference.clone() } else { problem.anchor.clone() };
        problem.repair(&mut inputs, &[]);
        let last =
            Solution { inputs, duals: Vec::new(), path: Path::Held, residual: f64::INFINITY, steps: 0, reason: None };
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

    /// The problem again.
    pub fn into_problem(self) -> Problem {
        self.problem
    }

    /// The last answer; before the first, the preferred inputs.
    pub fn solution(&self) -> &Solution {
        &self.last
    }

    /// How often each path was taken.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// New bounds; does not allocate. Bounds out of order are met in [`solve`](Self::solve), by holding.
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

    /// The best inputs for a wrench.
    pub fn solve(&mut self, wrench: &[f64; WRENCH]) -> &Solution {
        let reason = match self.unusable(wrench) {
            Some(reason) => Some(reason),
            None if self.try_fast(wrench) || self.try_conic(wrench) => None,
            None => Some(Reason::Uncertified),
        };
        match reason {
            None => {
                std::mem::swap(&mut self.last, &mut self.trial);
                self.last.reason = None;
                self.solved = Some(*wrench);
            }
            Some(reason) => self.hold(reason),
        }
        self.counts.paths[self.last.path as usize] += 1;
        &self.last
    }

    /// The gradient of a cost with respect to every number of the problem, from `cotangent` = ∂cost/∂u* at the last
    /// answer; over the numbers of `out`. On the fast paths the factorisation of the answer is used again, and nothing is
    /// allocated. Returns the [`Sensitivity::margin`] to the next change of the active set: near 0 the derivative is
    /// one-sided. `None`, with NaN in `out`, where inputs were held or the problem has changed since.
    ///
    /// # Panics
    /// If `cotangent` or `out` do not have the sizes of the problem.
    pub fn reverse(&self, cotangent: &[f64], out: &mut Variation) -> Option<f64> {
        let margin = self.solved.and_then(|wrench| match (self.last.path, &self.fast) {
            (Path::ClosedForm | Path::ActiveSet, Some(fast)) => {
                let closed = self.last.path == Path::ClosedForm;
                Some(fast.reverse(&self.problem, &wrench, &self.last.inputs, closed, cotangent, out))
            }
            _ => {
                let at = Sensitivity::new(&self.problem, &wrench, &self.last)?;
                at.reverse_into(cotangent, out);
                Some(at.margin())
            }
        });
        if margin.is_none() {
            out.numbers_mut().for_each(|x| *x = f64::NAN);
        }
        margin
    }

    fn unusable(&self, wrench: &[f64; WRENCH]) -> Option<Reason> {
        let ordered = |(lo, hi): (&f64, &f64)| lo <= hi && *lo < f64::INFINITY && *hi > f64::NEG_INFINITY;
        if !self.problem.lower.iter().zip(&self.problem.upper).all(ordered) {
            return Some(Reason::Bounds);
        }
        let sane = wrench.iter().all(|w| w.is_finite()) && self.problem.scales(wrench).gradient.is_finite();
        (!sane).then_some(Reason::Wrench)
    }

    /// Closed form, then active set; the answer is in `trial`.
    fn try_fast(&mut self, wrench: &[f64; WRENCH]) -> bool {
        let Some(fast) = &mut self.fast else { return false };
        let (problem, trial, tolerance) = (&self.problem, &mut self.trial, self.settings.tolerance);
        let scales = fast.task(problem, wrench);
        if fast.free(problem, wrench, &mut trial.inputs) {
            if certify(problem, wrench, trial, scales, &mut self.gradient, tolerance) {
                (trial.path, trial.steps) = (Path::ClosedForm, 0);
                return true;
            }
            self.counts.refused[0] += 1;
        }
        let (steps, done) = fast.search(problem, self.settings.warm, &mut trial.inputs);
        let good = done && certify(problem, wrench, trial, scales, &mut self.gradient, tolerance);
        fast.warm = good;
        (trial.path, trial.steps) = (Path::ActiveSet, steps);
        self.counts.refused[1] += u64::from(!good);
        good
    }

    fn try_conic(&mut self, wrench: &[f64; WRENCH]) -> bool {
        let conic = match &mut self.conic {
            Some(conic) => Ok(conic),
            none => Conic::new(&self.problem).map(|conic| none.insert(conic)),
        };
        let Ok(offer) = conic.and_then(|conic| conic.solve(&self.problem, wrench)) else {
            self.counts.refused[2] += 1;
            return false;
        };
        let first = self.measured(wrench, offer.inputs, offer.duals);
        // all steps before the verdict: the first may leave the cones by more than the interior point stayed inside
        let mut trial = first.clone();
        for _ in 0..POLISHES {
            let Some(at) = Sensitivity::new(&self.problem, wrench, &trial) else { break };
            (trial.inputs, trial.duals) = at.polished(&trial.duals);
        }
        let polished = self.measured(wrench, trial.inputs, trial.duals);
        let best = if polished.residual < first.residual { polished } else { first };
        let good = best.residual <= self.settings.tolerance && self.problem.violation(&best.inputs) == 0.0;
        self.trial = Solution { steps: offer.iterations, ..best };
        self.counts.refused[2] += u64::from(!good);
        good
    }

    /// A point as clarabel's answer: within all limits, with its residual.
    fn measured(&mut self, wrench: &[f64; WRENCH], mut inputs: Vec<f64>, duals: Vec<Vec<f64>>) -> Solution {
        self.problem.repair(&mut inputs, &self.last.inputs);
        let scales = self.problem.scales(wrench);
        let residual = residual(&self.problem, wrench, &inputs, &duals, scales, &mut self.gradient);
        Solution { inputs, duals, path: Path::Clarabel, residual, steps: 0, reason: None }
    }

    /// The last good inputs, within the bounds of now where those are in order.
    fn hold(&mut self, reason: Reason) {
        self.problem.repair(&mut self.last.inputs, &[]);
        self.last.duals.clear();
        self.last.path = Path::Held;
        (self.last.reason, self.last.residual, self.last.steps) = (Some(reason), f64::INFINITY, 0);
        self.solved = None;
    }
}

/// Measures an answer and says whether it may move a rotor.
fn certify(
    problem: &Problem,
    wrench: &[f64; WRENCH],
    answer: &mut Solution,
    scales: Scales,
    gradient: &mut [f64],
    tolerance: f64,
) -> bool {
    answer.residual = residual(problem, wrench, &answer.inputs, &answer.duals, scales, gradient);
    answer.residual <= tolerance && problem.violation(&answer.inputs) == 0.0
}

/// What the fast path prepares: H and the closed form in units of inputs and gradients.
struct Fast {
    program: BoxProgram<f64, MAX_FAST>,
    /// BᵀW by rows of inputs, and ρ u_pref.
    pull: Vec<[f64; WRENCH]>,
    offset: Vec<f64>,
    /// u = K w + k where no bound acts.
    gain: Vec<[f64; WRENCH]>,
    rest: Vec<f64>,
    /// Of H whole: where no bound acts.
    whole: Factor<f64, MAX_FAST>,
    /// Of the active set of the last answer.
    factor: Factor<f64, MAX_FAST>,
    iterate: Iterate<f64, MAX_FAST>,
    /// Whether `iterate` is an answer to start from.
    warm: bool,
    /// Of H, and of inputs.
    cost: f64,
    unit: f64,
}

impl Fast {
    /// `None` for problems with cones, too many inputs, or settings that forbid it.
    fn of(problem: &Problem, settings: Settings) -> Option<Box<Self>> {
        let n = problem.n_input();
        if !settings.fast || !problem.cones.is_empty() || n > MAX_FAST {
            return None;
        }
        let program = BoxProgram::empty();
        let mut fast = Box::new(Self {
            iterate: program.start(n, &[0.0; MAX_FAST]),
            program,
            pull: vec![[0.0; WRENCH]; n],
            offset: vec![0.0; n],
            gain: vec![[0.0; WRENCH]; n],
            rest: vec![0.0; n],
            whole: Factor::new(),
            factor: Factor::new(),
            warm: false,
            cost: 1.0,
            unit: 1.0,
        });
        fast.prepare(problem);
        Some(fast)
    }

    /// All that depends on geometry, weights, ρ and preference. No allocation.
    fn prepare(&mut self, problem: &Problem) {
        let n = problem.n_input();
        let b = problem.geometry.as_slice();
        for j in 0..n {
            self.pull[j] = std::array::from_fn(|k| b[WRENCH * j + k] * problem.weights[k]);
            self.offset[j] = problem.regularisation * problem.preference[j];
        }
        let column = |j: usize| std::array::from_fn::<f64, WRENCH, _>(|k| b[WRENCH * j + k]);
        self.cost = (0..n).map(|j| dot(&self.pull[j], &column(j))).fold(0.0, f64::max) + problem.regularisation;
        for i in 0..n {
            for j in 0..n {
                let own = if i == j { problem.regularisation } else { 0.0 };
                self.program.hessian[i][j] = (dot(&self.pull[i], &column(j)) + own) / self.cost;
            }
        }
        self.whole.of(n, &self.program.hessian, &[0.0; MAX_FAST], Precision::DOUBLE);
        for k in 0..=WRENCH {
            let mut column = [0.0; MAX_FAST];
            for j in 0..n {
                column[j] = if k < WRENCH { self.pull[j][k] } else { self.offset[j] } / self.cost;
            }
            self.whole.solve(n, &mut column);
            for j in 0..n {
                *(if k < WRENCH { &mut self.gain[j][k] } else { &mut self.rest[j] }) = column[j];
            }
        }
    }

    /// Bounds and q of now, in units of the size of the inputs; returns the scales of residuals.
    fn task(&mut self, problem: &Problem, wrench: &[f64; WRENCH]) -> Scales {
        let mut largest = 0.0_f64;
        let n = problem.n_input();
        for j in 0..n {
            let pulled = dot(&self.pull[j], wrench);
            largest = largest.max(pulled.abs());
            self.program.linear[j] = -(pulled + self.offset[j]);
        }
        let scales = problem.scales_of(self.cost, largest);
        let change = self.unit / scales.input;
        self.iterate.inputs.iter_mut().for_each(|u| *u *= change);
        self.unit = scales.input;
        for j in 0..n {
            self.program.linear[j] /= self.cost * self.unit;
            self.program.lower[j] = (problem.lower[j] / self.unit).clamp(-FAR, FAR);
            self.program.upper[j] = (problem.upper[j] / self.unit).clamp(-FAR, FAR);
        }
        scales
    }

    /// The closed form; whether it is within all bounds, with room.
    fn free(&self, problem: &Problem, wrench: &[f64; WRENCH], inputs: &mut [f64]) -> bool {
        let mut inside = true;
        for (j, u) in inputs.iter_mut().enumerate() {
            *u = dot(&self.gain[j], wrench) + self.rest[j];
            let (lower, upper) = (problem.lower[j], problem.upper[j]);
            inside &= lower < upper && lower <= *u && *u <= upper;
        }
        inside
    }

    /// The active set from the last one, else from the clipped closed form in `inputs`: the number of steps, and whether
    /// the last one changed nothing.
    fn search(&mut self, problem: &Problem, warm: bool, inputs: &mut [f64]) -> (u32, bool) {
        let n = inputs.len();
        let near = warm && self.warm;
        self.iterate = if near {
            self.program.restart(n, &self.iterate)
        } else {
            let mut from = [0.0; MAX_FAST];
            for (slot, u) in from.iter_mut().zip(&*inputs) {
                *slot = u / self.unit;
            }
            self.program.start(n, &from)
        };
        let mut steps = 0;
        while steps < MAX_STEPS && (steps == 0 || self.iterate.done < 0.5) {
            let many = steps < MAX_STEPS / 4;
            self.program.step(n, &mut self.iterate, &mut self.factor, many, Precision::DOUBLE);
            steps += 1;
        }
        if !near {
            // from afar the last step is long, and so is its rounding
            self.program.step(n, &mut self.iterate, &mut self.factor, false, Precision::DOUBLE);
            steps += 1;
        }
        for (j, u) in inputs.iter_mut().enumerate() {
            // a held input is its bound to the bit
            *u = match self.iterate.status[j] {
                s if s < -0.5 => problem.lower[j],
                s if s > 0.5 => problem.upper[j],
                _ => (self.iterate.inputs[j] * self.unit).max(problem.lower[j]).min(problem.upper[j]),
            };
        }
        (steps, self.iterate.done > 0.5)
    }

    /// y = H_FF⁻¹ ū_F and what follows from it, see [`super::gradient`]; the margin.
    fn reverse(
        &self,
        problem: &Problem,
        wrench: &[f64; WRENCH],
        inputs: &[f64],
        closed: bool,
        cotangent: &[f64],
        out: &mut Variation,
    ) -> f64 {
        let n = inputs.len();
        let mut y = [0.0; MAX_FAST];
        for i in 0..n {
            let free = closed || self.iterate.status[i] == 0.0;
            y[i] = if free { cotangent[i] / self.cost } else { 0.0 };
        }
        if closed { &self.whole } else { &self.factor }.solve(n, &mut y);
        let b = problem.geometry.as_slice();
        let miss = problem.miss(wrench, inputs);
        let (mut pulled, mut force) = ([0.0; WRENCH], [0.0; WRENCH]);
        for j in 0..n {
            for k in 0..WRENCH {
                pulled[k] += b[WRENCH * j + k] * y[j];
            }
        }
        for k in 0..WRENCH {
            out.weights[k] = -pulled[k] * miss[k];
            pulled[k] *= problem.weights[k];
            force[k] = problem.weights[k] * miss[k];
            out.wrench[k] = pulled[k];
        }
        out.regularisation = 0.0;
        let geometry = out.geometry.as_mut_slice();
        for j in 0..n {
            for k in 0..WRENCH {
                geometry[WRENCH * j + k] = -(y[j] * force[k] + pulled[k] * inputs[j]);
            }
            out.regularisation -= y[j] * (inputs[j] - problem.preference[j]);
            out.preference[j] = problem.regularisation * y[j];
            // a held input has y = 0, so that H y there is Bᵀ W B y alone
            let mut through = cotangent[j];
            for k in 0..WRENCH {
                through -= b[WRENCH * j + k] * pulled[k];
            }
            let mut status = if closed { 0.0 } else { self.iterate.status[j] };
            if problem.lower[j] == problem.upper[j] {
                // both bounds hold it: the one that the gradient pushes to counts
                let push: f64 = (0..WRENCH).map(|k| b[WRENCH * j + k] * force[k]).sum();
                let push = push + problem.regularisation * (inputs[j] - problem.preference[j]);
                status = if push > 0.0 { -1.0 } else { 1.0 };
            }
            out.lower[j] = if status < 0.0 { through } else { 0.0 };
            out.upper[j] = if status > 0.0 { through } else { 0.0 };
        }
        self.margin(problem, inputs, closed)
    }

    /// Least of max(slack, multiplier) over all bounds, scaled as in [`Sensitivity::margin`].
    fn margin(&self, problem: &Problem, inputs: &[f64], closed: bool) -> f64 {
        let mut margin = f64::INFINITY;
        for j in 0..inputs.len() {
            let (lower, upper) = (problem.lower[j], problem.upper[j]);
            if lower == upper {
                continue;
            }
            let room = (inputs[j] - lower).min(upper - inputs[j]) / self.unit;
            let held = !closed && self.iterate.status[j] != 0.0;
            margin = margin.min(if held { self.push(problem, j) } else { room });
        }
        margin
    }

    /// Size of the multiplier that holds input j, over that of gradients.
    fn push(&self, problem: &Problem, j: usize) -> f64 {
        let n = problem.n_input();
        let mut g = self.program.linear[j];
        let mut size = 1.0_f64;
        for i in 0..n {
            g += self.program.hessian[j][i] * self.iterate.inputs[i];
            size = size.max(self.program.linear[i].abs());
        }
        g.abs() / size
    }
}

fn dot(a: &[f64; WRENCH], b: &[f64; WRENCH]) -> f64 {
    let mut sum = 0.0;
    for i in 0..WRENCH {
        sum += a[i] * b[i];
    }
    sum
}
