//! Wrench in, certified inputs out: the solvers behind one interface, and what happens when they fail.
//!
//! In order: the closed form where no bound is active; the [active set](super::active_set) for problems without cones;
//! [clarabel](super::conic) for everything. The first answer whose [residual](super::residual) is within tolerance is
//! taken. Where none is, or the wrench is not finite, the last good inputs are held (within the bounds of now), and
//! that is counted.

use super::active_set::{BoxProgram, FAR, Factor, Iterate, Precision};
use super::conic::Conic;
use super::gradient::Sensitivity;
use super::problem::{Problem, Scales, WRENCH};
use super::residual::residual;
use super::variation::Variation;
use crate::error::{Error, Result};
use nalgebra::DMatrix;

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
    /// Answers that did not pass the certificate and were passed on to the next solver.
    pub refused: u64,
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
    problem: Problem,
    settings: Settings,
    fast: Option<Box<Fast>>,
    conic: Option<Conic>,
    last: Solution,
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
        let n = problem.n_input();
        let mut inputs = if problem.cones.is_empty() { problem.preference.clone() } else { problem.anchor.clone() };
        problem.repair(&mut inputs);
        let last =
            Solution { inputs, duals: Vec::new(), path: Path::Held, residual: f64::INFINITY, steps: 0, reason: None };
        let (fast, gradient) = (Fast::of(&problem, settings), vec![0.0; n]);
        Ok(Self { problem, settings, fast, conic: None, last, counts: Counts::default(), gradient })
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
        self.problem.lower.copy_from_slice(lower);
        self.problem.upper.copy_from_slice(upper);
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
        self.problem = problem;
        self.fast = Fast::of(&self.problem, self.settings);
        Ok(())
    }

    /// The best inputs for a wrench.
    pub fn solve(&mut self, wrench: &[f64; WRENCH]) -> &Solution {
        let reason = match self.unusable(wrench) {
            Some(reason) => Some(reason),
            None if self.try_fast(wrench) || self.try_conic(wrench) => None,
            None => Some(Reason::Uncertified),
        };
        if reason.is_some() {
            self.hold(reason);
        }
        self.counts.paths[self.last.path as usize] += 1;
        &self.last
    }

    /// The gradient of a cost with respect to every number of the problem, from `cotangent` = ∂cost/∂u* at the last answer
    /// for `wrench`; over the numbers of `out`. On the fast paths the factorisation of the answer is used again, and
    /// nothing is allocated. Returns the [`Sensitivity::margin`] to the next change of the active set: near 0 the
    /// derivative is one-sided. `None`, with NaN in `out`, where inputs were held.
    ///
    /// # Panics
    /// If `cotangent` or `out` do not have the sizes of the problem.
    pub fn reverse(&self, wrench: &[f64; WRENCH], cotangent: &[f64], out: &mut Variation) -> Option<f64> {
        match (self.last.path, &self.fast) {
            (Path::ClosedForm | Path::ActiveSet, Some(fast)) => {
                let closed = self.last.path == Path::ClosedForm;
                Some(fast.reverse(&self.problem, wrench, &self.last.inputs, closed, cotangent, out))
            }
            (Path::Clarabel, _) => {
                let at = Sensitivity::new(&self.problem, wrench, &self.last)?;
                at.reverse_into(cotangent, out);
                Some(at.margin())
            }
            _ => {
                out.numbers_mut().for_each(|x| *x = f64::NAN);
                None
            }
        }
    }

    fn unusable(&self, wrench: &[f64; WRENCH]) -> Option<Reason> {
        if wrench.iter().any(|w| !w.is_finite()) {
            return Some(Reason::Wrench);
        }
        let ordered = |(lo, hi): (&f64, &f64)| lo <= hi && *lo < f64::INFINITY && *hi > f64::NEG_INFINITY;
        let fine = self.problem.lower.iter().zip(&self.problem.upper).all(ordered);
        (!fine).then_some(Reason::Bounds)
    }

    /// Closed form, then active set.
    fn try_fast(&mut self, wrench: &[f64; WRENCH]) -> bool {
        let Some(fast) = &mut self.fast else { return false };
        let scales = fast.prepare(&self.problem, wrench);
        if fast.free(&self.problem, wrench, &mut self.last.inputs)
            && certify(&self.problem, wrench, &mut self.last, scales, &mut self.gradient, self.settings.tolerance)
        {
            (self.last.path, self.last.steps, self.last.reason) = (Path::ClosedForm, 0, None);
            return true;
        }
        self.last.steps = fast.search(&self.problem, self.settings.warm, &mut self.last.inputs);
        let good = certify(&self.problem, wrench, &mut self.last, scales, &mut self.gradient, self.settings.tolerance);
        fast.warm = good;
        if good {
            (self.last.path, self.last.reason) = (Path::ActiveSet, None);
        } else {
            self.counts.refused += 1;
        }
        good
    }

    fn try_conic(&mut self, wrench: &[f64; WRENCH]) -> bool {
        let conic = match &mut self.conic {
            Some(conic) => conic,
            none => match Conic::new(&self.problem) {
                Ok(conic) => none.insert(conic),
                Err(_) => return false,
            },
        };
        let Ok(offer) = conic.solve(&self.problem, wrench) else { return false };
        let mut best = self.measured(wrench, offer.inputs, offer.duals);
        // all steps before the verdict: the first may leave the cones by more than the interior point stayed inside
        let mut trial = best.clone();
        for _ in 0..POLISHES {
            let Some(at) = Sensitivity::new(&self.problem, wrench, &trial) else { break };
            (trial.inputs, trial.duals) = at.polished(&trial.duals);
        }
        let polished = self.measured(wrench, trial.inputs, trial.duals);
        if polished.residual < best.residual {
            best = polished;
        }
        let good = best.residual <= self.settings.tolerance;
        if good {
            self.last = Solution { steps: offer.iterations, ..best };
        } else {
            self.counts.refused += 1;
        }
        good
    }

    /// A point as clarabel's answer: within all limits, with its residual.
    fn measured(&mut self, wrench: &[f64; WRENCH], mut inputs: Vec<f64>, duals: Vec<Vec<f64>>) -> Solution {
        self.problem.repair(&mut inputs);
        let scales = self.problem.scales(wrench);
        let residual = residual(&self.problem, wrench, &inputs, &duals, scales, &mut self.gradient);
        Solution { inputs, duals, path: Path::Clarabel, residual, steps: 0, reason: None }
    }

    fn hold(&mut self, reason: Option<Reason>) {
        if reason != Some(Reason::Bounds) {
            self.problem.repair(&mut self.last.inputs);
        }
        self.last.path = Path::Held;
        (self.last.reason, self.last.residual, self.last.steps) = (reason, f64::INFINITY, 0);
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
    /// −BᵀW by rows of inputs, and −ρ u_pref.
    pull: Vec<[f64; WRENCH]>,
    offset: Vec<f64>,
    /// u = K w + k where no bound acts.
    gain: Vec<[f64; WRENCH]>,
    rest: Vec<f64>,
    factor: Factor<f64, MAX_FAST>,
    /// H⁻¹ in units of the cost: where no bound acts.
    inverse: Vec<f64>,
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
        let hessian = problem.hessian();
        let cost = hessian.diagonal().max();
        let pull = DMatrix::from_fn(n, WRENCH, |j, i| problem.geometry[(i, j)] * problem.weights[i]);
        let cholesky = hessian.clone().cholesky()?;
        let gain = cholesky.solve(&pull);
        let preferred = nalgebra::DVector::from_column_slice(&problem.preference) * problem.regularisation;
        let rest = cholesky.solve(&preferred);
        let mut program = BoxProgram::empty();
        for i in 0..n {
            for j in 0..n {
                program.hessian[i][j] = hessian[(i, j)] / cost;
            }
        }
        let rows = |m: &DMatrix<f64>| (0..n).map(|j| std::array::from_fn(|i| m[(j, i)])).collect::<Vec<_>>();
        let iterate = program.start(n, &[0.0; MAX_FAST]);
        Some(Box::new(Self {
            program,
            pull: rows(&pull),
            offset: preferred.iter().copied().collect(),
            gain: rows(&gain),
            rest: rest.iter().copied().collect(),
            factor: Factor::new(),
            inverse: (cholesky.inverse() * cost).iter().copied().collect(),
            iterate,
            warm: false,
            cost,
            unit: 1.0,
        }))
    }

    /// Bounds and q of now, in units of the largest input; returns the scales of residuals.
    fn prepare(&mut self, problem: &Problem, wrench: &[f64; WRENCH]) -> Scales {
        let n = problem.n_input();
        let bounds = problem.lower.iter().chain(&problem.upper).chain(&problem.preference);
        let input = bounds.filter(|b| b.is_finite()).fold(1e-12, |m: f64, b| m.max(b.abs()));
        let mut largest = 0.0_f64;
        for j in 0..n {
            let pulled = dot(&self.pull[j], wrench);
            largest = largest.max(pulled.abs());
            self.program.linear[j] = -(pulled + self.offset[j]) / (self.cost * input);
            self.program.lower[j] = (problem.lower[j] / input).max(-FAR);
            self.program.upper[j] = (problem.upper[j] / input).min(FAR);
        }
        self.unit = input;
        Scales { input, gradient: (self.cost * input).max(largest) }
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
        if closed {
            for (row, y) in self.inverse.chunks_exact(n).zip(&mut y) {
                *y = row.iter().zip(cotangent).map(|(h, c)| h * c).sum::<f64>() / self.cost;
            }
        } else {
            for i in 0..n {
                y[i] = if self.iterate.status[i] == 0.0 { cotangent[i] / self.cost } else { 0.0 };
            }
            self.factor.solve(n, &mut y);
        }
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

    /// The closed form; whether it is within all bounds.
    fn free(&self, problem: &Problem, wrench: &[f64; WRENCH], inputs: &mut [f64]) -> bool {
        let mut inside = true;
        for (j, u) in inputs.iter_mut().enumerate() {
            *u = dot(&self.gain[j], wrench) + self.rest[j];
            inside &= problem.lower[j] <= *u && *u <= problem.upper[j];
        }
        inside
    }

    /// The active set from the last one, else from the clipped closed form in `inputs`; returns the number of steps.
    fn search(&mut self, problem: &Problem, warm: bool, inputs: &mut [f64]) -> u32 {
        let n = inputs.len();
        let unit = self.unit;
        self.iterate = if warm && self.warm {
            self.program.restart(n, &self.iterate)
        } else {
            let mut from = [0.0; MAX_FAST];
            for (slot, u) in from.iter_mut().zip(&*inputs) {
                *slot = u / unit;
            }
            self.program.start(n, &from)
        };
        let mut steps = 0;
        while steps < MAX_STEPS && (steps == 0 || self.iterate.done < 0.5) {
            let many = steps < MAX_STEPS / 4;
            self.program.step(n, &mut self.iterate, &mut self.factor, many, Precision::DOUBLE);
            steps += 1;
        }
        for (j, u) in inputs.iter_mut().enumerate() {
            // a held input is its bound to the bit
            *u = match self.iterate.status[j] {
                s if s < -0.5 => problem.lower[j],
                s if s > 0.5 => problem.upper[j],
                _ => (self.iterate.inputs[j] * unit).clamp(problem.lower[j], problem.upper[j]),
            };
        }
        steps
    }
}

fn dot(a: &[f64; WRENCH], b: &[f64; WRENCH]) -> f64 {
    let mut sum = 0.0;
    for i in 0..WRENCH {
        sum += a[i] * b[i];
    }
    sum
}
