//! Gradients of a cost along a whole trajectory, backwards (adjoint) or forwards (duals).
//!
//! Reverse: λ_T = ∂c_T/∂x, then λₖ = ∂c/∂x + (∂f/∂x)ᵀ λₖ₊₁ with ∂J/∂uₖ = ∂c/∂u + (∂f/∂u)ᵀ λₖ₊₁, and likewise summed
//! for θ (Bryson and Ho 1975, section 2.2). What of a step does not depend on λ, its inner values and partial derivatives, is
//! computed for eight steps side by side; the chain rule over them is swept step by step. Where a custom function is called,
//! one derived [`Program`] does a step's part. Steps and sweeps are machine code once so many were asked for that making it pays;
//! no bit depends on it but signs of zeros, while numbers are finite. All states are kept up to 1 MiB. Beyond that they are
//! kept at every √T-th step only and recomputed within (Griewank 1992), so memory grows with √T and the rollout runs twice.

use super::columns::{LINE, Lines};
use super::native::policy::{Fallback, OnDemand};
use super::native::{Code, Place, RowLayout, Rows, WhyInterpreted, code};
use super::program::{Program, Workspace};
use super::sweep::{Pulled, StepsCode, StepsCodeScratch, StepsScratch, Sweep};
use super::system::{Objective, System};
use super::trace::chain::EdgeCost;
use super::trace::{Recording, Trace};
use super::{Scalar, trace};
use base::error::{Error, Result};
use num_dual::Dual64;
use std::sync::Arc;

/// The gradient of a rollout's cost.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gradient {
    /// ∂J/∂x₀, `[n]`.
    pub state: Vec<f64>,
    /// ∂J/∂u, row-major `[T, m]`; empty if not asked for.
    pub inputs: Vec<f64>,
    /// ∂J/∂θ, `[p]`.
    pub parameters: Vec<f64>,
}

/// A system and an objective with their derived adjoints, ready to differentiate rollouts.
///
/// With xₖ₊₁ = f(xₖ, uₖ, θ) for k = 0 … T − 1, n states, m inputs and p parameters, the cost is J = Σₖ c(xₖ, uₖ, θ) + c_T(x_T, θ).
/// Its gradient is found backwards: λ_T = ∂c_T/∂x, λₖ = ∂c/∂x + (∂f/∂x)ᵀ λₖ₊₁, ∂J/∂uₖ = ∂c/∂u + (∂f/∂u)ᵀ λₖ₊₁, summed likewise for
/// θ, and ∂J/∂x₀ = λ₀ (Bryson and Ho 1975, section 2.2). States are kept up to 1 MiB, beyond that every √T-th and the others
/// recomputed (Griewank 1992).
///
/// ```
/// # use omnidrones_autodiff::omnidrones;
/// use omnidrones::autodiff::{Objective, Rollout, Scalar, System};
///
/// /// A point mass pushed for 20 ms at a time.
/// struct Cart;
/// impl System for Cart {
///     fn n_state(&self) -> usize { 2 }
///     fn n_input(&self) -> usize { 1 }
///     fn step<S: Scalar>(&self, x: &[S], u: &[S], _: &[S], next: &mut [S]) {
///         let h = S::constant(0.02);
///         next[1] = h.mul_add(u[0], x[1]);
///         next[0] = h.mul_add(next[1], x[0]);
///     }
/// }
///
/// /// Distance from the origin at the end, and effort on the way.
/// struct Arrive;
/// impl Objective for Arrive {
///     fn stage<S: Scalar>(&self, _: &[S], u: &[S], _: &[S]) -> S { S::constant(1e-3) * u[0].square() }
///     fn terminal<S: Scalar>(&self, x: &[S], _: &[S]) -> S { x[0].square() + x[1].square() }
/// }
///
/// let rollout = Rollout::new(Cart, Arrive)?;
/// let (cost, gradient) = rollout.gradient(&[1.0, 0.0], &vec![0.0; 100], &[]);
/// assert_eq!(cost, 1.0);
/// assert!(gradient.inputs[0] > gradient.inputs[99]); // an early push moves the end further
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Rollout<F, C> {
    system: F,
    objective: C,
    step_adjoint: Adjoint,
    /// [x, θ, ρ] → [x̄, θ̄] of ρ·c_T.
    terminal_adjoint: Program,
    codes: Arc<Codes>,
}

/// Machine code of a step, and what it is made of.
#[derive(Debug)]
struct Codes {
    /// [x, u, θ] → [x⁺, c].
    step: Recording,
    forward: OnDemand<Code>,
    backward: OnDemand<Arc<StepsCode>>,
}

/// [x, u, θ], [λ⁺, ρ] → [x̄, ū, θ̄] of λ⁺·f + ρ·c.
#[derive(Debug, Clone)]
enum Adjoint {
    Chain(Box<Sweep>),
    /// With custom functions; of all at once.
    Program(Box<Program>),
}

/// Memory of a reverse sweep; made once, reused without allocation for horizons up to the longest seen, but for the one time that
/// machine code is made: after about 1500 steps of a rollout, whoever asked for them.
#[derive(Debug, Clone)]
pub struct RolloutScratch {
    /// States at the start of each segment.
    anchors: Vec<f64>,
    /// States within one segment.
    segment: Vec<f64>,
    /// Longest horizon seen: shorter ones take no more memory.
    longest: usize,
    arguments: Vec<f64>,
    results: Vec<f64>,
    forward: Option<Forward>,
    step: StepScratch,
    terminal: Workspace,
}

/// The step of a system as machine code, for flights that are judged and not differentiated.
#[derive(Debug)]
pub struct StepCode {
    codes: Arc<Codes>,
    sizes: [usize; 3],
}

impl StepCode {
    #[doc(hidden)]
    pub fn of<F: System, C: Objective>(system: &F, objective: &C) -> Self {
        let (forward, backward) = (OnDemand::default(), OnDemand::default());
        let codes = Arc::new(Codes { step: record_step(system, objective), forward, backward });
        Self { codes, sizes: [system.n_state(), system.n_input(), system.n_parameter()] }
    }

    /// Where so many steps, with those that were asked for before, are worth it.
    #[doc(hidden)]
    pub fn for_steps(&self, n_step: u64) -> Option<Forward> {
        self.codes.forward(self.sizes, n_step)
    }
}

/// Machine code of a step, with its slots.
#[derive(Debug, Clone)]
pub struct Forward {
    code: Code,
    slots: Lines,
    of: Arc<Codes>,
}

impl Forward {
    /// x⁺ behind x in `states`; returns c.
    #[inline]
    pub(crate) fn step(&mut self, states: &mut [f64], u: &[f64], theta: &[f64]) -> f64 {
        let mut cost = [0.0];
        let arrays = &mut [Rows::Write(states), Rows::Read(u), Rows::Read(theta), Rows::Write(&mut cost)];
        assert!(self.code.run(&mut self.slots, arrays, 1), "lengths of a step");
        cost[0]
    }
}

/// The first of two states becomes what follows it, by code of the step where there is some.
pub fn advance<F: System>(system: &F, code: &mut Option<Forward>, states: &mut [f64], input: &[f64], theta: &[f64]) {
    let n = system.n_state();
    if let Some(code) = code {
        code.step(states, input, theta);
    } else {
        let (x, next) = states.split_at_mut(n);
        system.step(x, input, theta, next);
    }
    states.copy_within(n.., 0);
}

#[derive(Debug, Clone)]
enum StepScratch {
    Chain {
        sweep: StepsScratch,
        /// [x, u, θ] of eight steps side by side.
        points: Vec<[f64; LINE]>,
    },
    Code {
        code: Box<StepsCodeScratch>,
        /// As above.
        points: Vec<[f64; LINE]>,
        /// ∂J/∂u of a step, where nobody asks for it.
        unread: Vec<f64>,
    },
    Program(Workspace),
}

/// Steps after which a sweep asks whether it goes on, a multiple of [`LINE`]; at the end of a segment besides.
const ASKED: usize = 256;

const LENGTHS: &str = "lengths of state, parameters, inputs";

/// Bytes of states up to which all are kept.
const KEPT: usize = 1 << 20;

/// Partial derivatives are multiplied for eight steps side by side, the sweep goes step by step.
const PRICE: EdgeCost = EdgeCost { product: 0.4, vertex: 2.0, few: 24 };

/// Steps per segment for a horizon of T and states of n numbers: all where they fit, else ⌈√T⌉.
fn segment_length(horizon: usize, n: usize) -> usize {
    let all = horizon.max(1);
    if all.saturating_mul(n * size_of::<f64>()) <= KEPT { all } else { root(all) }
}

/// ⌈√T⌉.
fn root(horizon: usize) -> usize {
    horizon.isqrt() + usize::from(horizon.isqrt().pow(2) < horizon)
}

impl RolloutScratch {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let numbers = self.anchors.capacity()
            + self.segment.capacity()
            + self.arguments.capacity()
            + self.results.capacity()
            + match &self.step {
                StepScratch::Chain { sweep, points } => sweep.len() + LINE * points.len(),
                StepScratch::Code { code, points, unread } => code.len() + LINE * points.len() + unread.len(),
                StepScratch::Program(workspace) => workspace.len(),
            }
            + self.forward.as_ref().map_or(0, |forward| LINE * forward.slots.len())
            + self.terminal.len();
        numbers * size_of::<f64>()
    }
}

impl<F: System, C: Objective> Rollout<F, C> {
    /// Records the step and the costs once and derives their adjoints.
    ///
    /// # Errors
    /// [`Error::Limit`] if a recording is too large to compile.
    pub fn new(system: F, objective: C) -> Result<Self> {
        let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
        let step = record_step(&system, &objective);
        let step_adjoint = match Sweep::of(&step, 0..n + m + p, PRICE)? {
            Some(sweep) => Adjoint::Chain(Box::new(sweep)),
            None => Adjoint::Program(Box::new(Program::compile_single(&step.adjoint(0..n + m + p))?)),
        };
        let terminal = Recording::of(n + p, |z| vec![objective.terminal(&z[..n], &z[n..])]).adjoint(0..n + p);
        let codes = Arc::new(Codes { step, forward: OnDemand::default(), backward: OnDemand::default() });
        Ok(Self { step_adjoint, terminal_adjoint: Program::compile_single(&terminal)?, system, objective, codes })
    }

    /// The system.
    pub fn system(&self) -> &F {
        &self.system
    }

    /// The objective.
    pub fn objective(&self) -> &C {
        &self.objective
    }

    /// Number of instructions and multiplications of a step's adjoint.
    pub fn adjoint_len(&self) -> usize {
        match &self.step_adjoint {
            Adjoint::Chain(sweep) => sweep.len(),
            Adjoint::Program(program) => program.len(),
        }
    }

    /// Memory for [`Rollout::gradient_into`].
    pub fn scratch(&self) -> RolloutScratch {
        let (n, m, p) = self.sizes();
        RolloutScratch {
            anchors: Vec::new(),
            segment: Vec::new(),
            longest: 0,
            arguments: vec![0.0; n + m + p + n + 1],
            results: vec![0.0; n + m + p],
            forward: None,
            step: match &self.step_adjoint {
                Adjoint::Chain(sweep) => {
                    StepScratch::Chain { sweep: sweep.steps_scratch(), points: vec![[0.0; LINE]; n + m + p] }
                }
                Adjoint::Program(program) => StepScratch::Program(program.interpreter_workspace()),
            },
            terminal: self.terminal_adjoint.interpreter_workspace(),
        }
    }

    fn sizes(&self) -> (usize, usize, usize) {
        (self.system.n_state(), self.system.n_input(), self.system.n_parameter())
    }

    /// The cost J alone. `state` is x₀, `[n]`; `inputs` row-major `[T, m]`; `parameters` `[p]`.
    ///
    /// # Panics
    /// If `state` or `parameters` does not have the system's length, or `inputs` no multiple of it.
    pub fn cost(&self, state: &[f64], inputs: &[f64], parameters: &[f64]) -> f64 {
        let (n, m, p) = self.sizes();
        let Some(mut forward) = self.codes.forward([n, m, p], (inputs.len() / m.max(1)) as u64) else {
            return self.cost_of(state.to_vec(), inputs, parameters);
        };
        assert_eq!((state.len(), parameters.len(), inputs.len() % m.max(1)), (n, p, 0), "{LENGTHS}");
        // a state and the one behind it, in turns
        let (mut states, mut total) = (vec![0.0; 2 * n], 0.0);
        states[n..].copy_from_slice(state);
        for u in inputs.chunks_exact(m.max(1)) {
            states.copy_within(n.., 0);
            total += forward.step(&mut states, u, parameters);
        }
        total + self.objective.terminal(&states[n..], parameters)
    }

    fn cost_of<S: Scalar>(&self, mut x: Vec<S>, inputs: &[f64], theta: &[S]) -> S {
        let (n, m, p) = self.sizes();
        assert_eq!((x.len(), theta.len(), inputs.len() % m.max(1)), (n, p, 0), "{LENGTHS}");
        let mut next = x.clone();
        let mut u = vec![S::zero(); m];
        let mut total = S::zero();
        for row in inputs.chunks_exact(m.max(1)) {
            for (u, value) in u.iter_mut().zip(row) {
                *u = S::constant(*value);
            }
            total += self.objective.stage(&x, &u, theta);
            self.system.step(&x, &u, theta, &mut next);
            std::mem::swap(&mut x, &mut next);
        }
        total + self.objective.terminal(&x, theta)
    }

    /// The states x₀ … x_T, row-major `[T + 1, n]`.
    ///
    /// # Panics
    /// As [`Rollout::cost`], and for a system without inputs.
    pub fn trajectory(&self, state: &[f64], inputs: &[f64], parameters: &[f64]) -> Vec<f64> {
        let (n, m, p) = self.sizes();
        let mut states = state.to_vec();
        if let Some(mut forward) = self.codes.forward([n, m, p], (inputs.len() / m) as u64) {
            assert_eq!((states.len(), inputs.len() % m), (n, 0), "{LENGTHS}");
            states.resize(n * (inputs.len() / m + 1), 0.0);
            for (k, u) in inputs.chunks_exact(m).enumerate() {
                forward.step(&mut states[k * n..(k + 2) * n], u, parameters);
            }
            return states;
        }
        let mut next = vec![0.0; n];
        for u in inputs.chunks_exact(m) {
            let x = &states[states.len() - n..];
            self.system.step(x, u, parameters, &mut next);
            states.extend_from_slice(&next);
        }
        states
    }

    /// Cost and full gradient by the adjoint. `inputs` is row-major `[T, m]`.
    ///
    /// # Panics
    /// As [`Rollout::cost`], and for a system without inputs.
    pub fn gradient(&self, state: &[f64], inputs: &[f64], parameters: &[f64]) -> (f64, Gradient) {
        let (n, _, p) = self.sizes();
        let mut gradient = Gradient { state: vec![0.0; n], inputs: vec![0.0; inputs.len()], parameters: vec![0.0; p] };
        let cost = self.gradient_into(&mut self.scratch(), state, inputs, parameters, &mut gradient);
        (cost, gradient)
    }

    /// As [`Rollout::gradient`] into buffers of the caller, `[n]`, `[T, m]` and `[p]`, and the cost; leaves out ∂J/∂u if
    /// `gradient.inputs` is empty.
    ///
    /// # Panics
    /// As [`Rollout::gradient`], and if a buffer has the wrong length.
    pub fn gradient_into(
        &self,
        scratch: &mut RolloutScratch,
        state: &[f64],
        inputs: &[f64],
        parameters: &[f64],
        gradient: &mut Gradient,
    ) -> f64 {
        self.gradient_while(scratch, state, inputs, parameters, gradient, &mut || true).unwrap_or(f64::NAN)
    }

    /// As [`Rollout::gradient_into`], given up where `goes_on`, which is asked every 256 steps, returns false: `None` then, and
    /// `gradient` holds nothing of use.
    ///
    /// # Panics
    /// As [`Rollout::gradient_into`].
    pub fn gradient_while(
        &self,
        scratch: &mut RolloutScratch,
        state: &[f64],
        inputs: &[f64],
        parameters: &[f64],
        gradient: &mut Gradient,
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Option<f64> {
        let (n, m, _) = self.sizes();
        let horizon = inputs.len() / m.max(1);
        let mut segment = segment_length(horizon, n);
        // a horizon shorter than the longest seen takes no more memory
        if horizon <= scratch.longest && (segment + 1) * n > scratch.segment.capacity() {
            segment = root(horizon.max(1));
        }
        scratch.longest = scratch.longest.max(horizon);
        self.gradient_by(segment, scratch, (state, inputs, parameters), gradient, goes_on)
    }

    /// With so many states kept at a time.
    fn gradient_by(
        &self,
        segment: usize,
        scratch: &mut RolloutScratch,
        (state, inputs, parameters): (&[f64], &[f64], &[f64]),
        gradient: &mut Gradient,
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Option<f64> {
        let (n, m, p) = self.sizes();
        assert_eq!((state.len(), parameters.len()), (n, p), "lengths of state and parameters");
        assert!(m > 0 && inputs.len().is_multiple_of(m), "inputs are rows of {m} numbers, not {} in all", inputs.len());
        assert_eq!((gradient.state.len(), gradient.parameters.len()), (n, p), "lengths of the gradient");
        let horizon = inputs.len() / m;
        self.ask_for_code(scratch, horizon as u64);
        scratch.segment.resize((segment + 1) * n, 0.0);
        let mut cost = self.sweep_forward(scratch, segment, (state, inputs, parameters), goes_on)?;
        cost += self.start_backward(scratch, parameters, gradient);
        for s in (0..scratch.anchors.len() / n).rev() {
            let (from, to) = (s * segment, ((s + 1) * segment).min(horizon));
            if to < horizon {
                self.refill(scratch, s, &inputs[from * m..to * m], parameters);
            }
            self.write_parameters(scratch, parameters);
            for first in (from..to).step_by(LINE).rev() {
                if (first - from).is_multiple_of(ASKED) && !goes_on() {
                    return None;
                }
                let steps = first..to.min(first + LINE);
                self.prepare(scratch, &inputs[first * m..steps.end * m], (first - from) * n);
                for k in steps.rev() {
                    let x = (k - from) * n;
                    self.step_backward(scratch, x, &inputs[k * m..(k + 1) * m], parameters, gradient, k);
                }
            }
        }
        Some(cost)
    }

    /// Runs the rollout, keeps the start of each segment and the whole of the last; returns Σ c.
    fn sweep_forward(
        &self,
        w: &mut RolloutScratch,
        segment: usize,
        (state, inputs, theta): (&[f64], &[f64], &[f64]),
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Option<f64> {
        let (n, m, _) = self.sizes();
        let mut cost = 0.0;
        w.anchors.clear();
        w.segment[..n].copy_from_slice(state);
        w.results[..n].copy_from_slice(state);
        for (k, u) in inputs.chunks_exact(m).enumerate() {
            if k.is_multiple_of(ASKED) && !goes_on() {
                return None;
            }
            let at = (k % segment) * n;
            if at == 0 {
                w.anchors.extend_from_slice(&w.results[..n]);
                w.segment[..n].copy_from_slice(&w.results[..n]);
            }
            cost += self.step_forward(w, at, u, theta);
            w.results[..n].copy_from_slice(&w.segment[at + n..at + 2 * n]);
        }
        Some(cost)
    }

    /// From the state at `x` in the segment the one behind it; returns c.
    fn step_forward(&self, w: &mut RolloutScratch, x: usize, u: &[f64], theta: &[f64]) -> f64 {
        let n = self.system.n_state();
        let states = &mut w.segment[x..x + 2 * n];
        if let Some(forward) = &mut w.forward {
            return forward.step(states, u, theta);
        }
        let (x, next) = states.split_at_mut(n);
        self.system.step(x, u, theta, next);
        self.objective.stage(x, u, theta)
    }

    /// Machine code into `scratch`, where so many steps, with those that were asked for before, are worth it.
    fn ask_for_code(&self, w: &mut RolloutScratch, n_step: u64) {
        let sizes @ [n, m, p] = self.sizes().into();
        if w.forward.as_ref().is_none_or(|forward| !Arc::ptr_eq(&forward.of, &self.codes)) {
            w.forward = self.codes.forward(sizes, n_step);
        }
        match (&self.step_adjoint, &mut w.step) {
            (Adjoint::Program(program), StepScratch::Program(workspace)) if !workspace.is_native() => {
                if let Some(native) = program.native_workspace_for(n_step) {
                    *workspace = native;
                }
            }
            (Adjoint::Chain(sweep), step) => {
                let make = || StepsCode::new(sweep, sizes);
                let Some(made) = self.codes.backward.ask(Fallback::Swept, sweep.len(), n_step, make) else {
                    assert!(!matches!(step, StepScratch::Code { .. }), "scratch of the rollout");
                    return;
                };
                if !matches!(step, StepScratch::Code { code, .. } if code.is_of(&made)) {
                    let code = Box::new(StepsCodeScratch::new(&made, p));
                    *step = StepScratch::Code { code, points: vec![[0.0; LINE]; n + m + p], unread: vec![0.0; m] };
                }
            }
            _ => {}
        }
    }

    /// λ_T into `gradient.state`, ∂c_T/∂θ into `gradient.parameters`; returns c_T.
    fn start_backward(&self, w: &mut RolloutScratch, theta: &[f64], gradient: &mut Gradient) -> f64 {
        let (n, _, p) = self.sizes();
        let cost = self.objective.terminal(&w.results[..n], theta);
        w.arguments[..n].copy_from_slice(&w.results[..n]);
        w.arguments[n..n + p].copy_from_slice(theta);
        w.arguments[n + p] = 1.0;
        self.terminal_adjoint.evaluate(&mut w.terminal, &w.arguments[..n + p + 1], &mut w.results[..n + p]);
        gradient.state.copy_from_slice(&w.results[..n]);
        gradient.parameters.copy_from_slice(&w.results[n..n + p]);
        cost
    }

    /// States of segment `s` again, from its anchor.
    fn refill(&self, w: &mut RolloutScratch, s: usize, inputs: &[f64], theta: &[f64]) {
        let (n, m, _) = self.sizes();
        w.segment[..n].copy_from_slice(&w.anchors[s * n..(s + 1) * n]);
        for (k, u) in inputs.chunks_exact(m).enumerate() {
            self.step_forward(w, k * n, u, theta);
        }
    }

    /// θ into the points of all steps.
    fn write_parameters(&self, w: &mut RolloutScratch, theta: &[f64]) {
        if let StepScratch::Chain { points, .. } | StepScratch::Code { points, .. } = &mut w.step {
            let from = points.len() - theta.len();
            points[from..].iter_mut().zip(theta).for_each(|(row, value)| *row = [*value; LINE]);
        }
        if let StepScratch::Code { code, .. } = &mut w.step {
            code.write_parameters(theta);
        }
    }

    /// Values and partial derivatives of up to eight steps, from the states at `x` … in the segment. Where there are fewer, what
    /// stands in the other lanes is left open.
    fn prepare(&self, w: &mut RolloutScratch, inputs: &[f64], x: usize) {
        let (n, m, _) = self.sizes();
        let points = match &mut w.step {
            StepScratch::Code { code, points, .. } if code.is_side_by_side() => points,
            StepScratch::Chain { points, .. } => points,
            _ => return,
        };
        let (states, commands) = points.split_at_mut(n);
        for (lane, u) in inputs.chunks_exact(m).enumerate() {
            let own = &w.segment[x + lane * n..x + (lane + 1) * n];
            states.iter_mut().zip(own).for_each(|(row, value)| row[lane] = *value);
            commands.iter_mut().zip(u).for_each(|(row, value)| row[lane] = *value);
        }
        match (&self.step_adjoint, &mut w.step) {
            (_, StepScratch::Code { code, points, .. }) => code.evaluate(points),
            (Adjoint::Chain(sweep), StepScratch::Chain { sweep: scratch, points }) => {
                sweep.evaluate_steps(scratch, points);
            }
            _ => {}
        }
    }

    /// One step of λ, from the state at `x` in the segment.
    fn step_backward(
        &self,
        w: &mut RolloutScratch,
        x: usize,
        u: &[f64],
        theta: &[f64],
        gradient: &mut Gradient,
        k: usize,
    ) {
        let (n, m, p) = self.sizes();
        let (a, b, c) = (n, n + m, n + m + p);
        if let StepScratch::Code { code, unread, .. } = &mut w.step {
            let Gradient { state, inputs, parameters } = gradient;
            let input = if inputs.is_empty() { &mut unread[..] } else { &mut inputs[k * m..(k + 1) * m] };
            return code.pull(x / n.max(1), &w.segment[x..x + n], u, Pulled { state, input, parameters });
        }
        w.arguments[c..c + n].copy_from_slice(&gradient.state);
        w.arguments[c + n] = 1.0;
        match (&self.step_adjoint, &mut w.step) {
            (Adjoint::Chain(sweep), StepScratch::Chain { sweep: scratch, .. }) => {
                sweep.pull(scratch, x / n.max(1) % LINE, &w.arguments[c..], &mut w.results[..c]);
            }
            (Adjoint::Program(program), StepScratch::Program(workspace)) => {
                w.arguments[..a].copy_from_slice(&w.segment[x..x + n]);
                w.arguments[a..b].copy_from_slice(u);
                w.arguments[b..c].copy_from_slice(theta);
                program.evaluate(workspace, &w.arguments, &mut w.results);
            }
            _ => unreachable!("scratch of another rollout"),
        }
        gradient.state.copy_from_slice(&w.results[..a]);
        if !gradient.inputs.is_empty() {
            gradient.inputs[k * m..(k + 1) * m].copy_from_slice(&w.results[a..b]);
        }
        for (sum, part) in gradient.parameters.iter_mut().zip(&w.results[b..c]) {
            *sum += part;
        }
    }

    /// Cost and gradient with respect to x₀ and θ by duals, one rollout per direction: the witness of
    /// [`Rollout::gradient`], and the better choice for a handful of parameters. `inputs` of the result stay empty.
    ///
    /// # Panics
    /// As [`Rollout::cost`].
    pub fn gradient_forward(&self, state: &[f64], inputs: &[f64], parameters: &[f64]) -> (f64, Gradient) {
        let (n, _, p) = self.sizes();
        let mut gradient = vec![0.0; n + p];
        let mut cost = 0.0;
        for (k, entry) in gradient.iter_mut().enumerate() {
            let seed = |(i, v): (usize, &f64)| Dual64::new(*v, if i == k { 1.0 } else { 0.0 });
            let lifted: Vec<Dual64> = state.iter().chain(parameters).enumerate().map(seed).collect();
            let result = self.cost_of(lifted[..n].to_vec(), inputs, &lifted[n..]);
            (cost, *entry) = (result.re, result.eps);
        }
        let parameters = gradient.split_off(n);
        (cost, Gradient { state: gradient, inputs: Vec::new(), parameters })
    }
}

impl Codes {
    /// Machine code of a step, where so many, with those that were asked for before, are worth it.
    fn forward(self: &Arc<Self>, sizes: [usize; 3], n_step: u64) -> Option<Forward> {
        let make = || forward_code(&self.step, sizes);
        let code = self.forward.ask(Fallback::Compiled, self.step.n_operation(), n_step, make)?;
        Some(Forward { slots: code.slots(), code, of: self.clone() })
    }
}

/// Of [x, u, θ] → [x⁺, c], where x⁺ lies behind x.
fn forward_code(step: &Recording, [n, m, p]: [usize; 3]) -> std::result::Result<Code, WhyInterpreted> {
    let form = Program::code_form(step).map_err(|_| WhyInterpreted::TooLarge)?;
    let rows = |array: u8, rows: std::ops::Range<usize>| rows.map(move |row| Place { array, row: row as u32 });
    let arguments = rows(0, 0..n).chain(rows(1, 0..m)).chain(rows(2, 0..p));
    let results = rows(0, n..2 * n).chain(rows(3, 0..1));
    let layout = RowLayout::new(arguments.collect(), results.collect()).map_err(|_| WhyInterpreted::TooLarge)?;
    code::<f64>(&Arc::new(form), &layout)
}

/// [x, u, θ] → [f(x, u, θ), c(x, u, θ)].
pub(crate) fn record_step<F: System, C: Objective>(system: &F, objective: &C) -> Recording {
    let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
    trace::Recording::of(n + m + p, |z| {
        let (x, rest) = z.split_at(n);
        let (u, theta) = rest.split_at(m);
        let mut results = vec![Trace::zero(); n + 1];
        system.step(x, u, theta, &mut results[..n]);
        results[n] = objective.stage(x, u, theta);
        results
    })
}

/// Checks what [`Rollout`] asserts, for callers whose lengths come from data.
///
/// # Errors
/// [`Error::Value`] naming the wrong length.
pub(crate) fn check_lengths<F: System>(system: &F, state: &[f64], inputs: &[f64], parameters: &[f64]) -> Result<()> {
    let m = system.n_input();
    for (what, got, wanted) in [
        ("state", state.len(), system.n_state()),
        ("parameters", parameters.len(), system.n_parameter()),
        ("inputs modulo n_input", if m == 0 { inputs.len() } else { inputs.len() % m }, 0),
    ] {
        if got != wanted {
            return Err(Error::value(
                format!("length of {what}"),
                got,
                wanted.to_string(),
                "See System::n_state and n_input.",
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::Quadrotor;

    struct Distance;
    impl Objective for Distance {
        fn stage<S: Scalar>(&self, x: &[S], u: &[S], _: &[S]) -> S {
            x[0].square() + x[2].square() + u[0].square()
        }
        fn terminal<S: Scalar>(&self, x: &[S], _: &[S]) -> S {
            x[1].square()
        }
    }

    /// Inputs of a quadrotor, each of two scaled by a parameter.
    #[derive(Clone)]
    struct Parametric(Quadrotor);
    impl System for Parametric {
        fn n_state(&self) -> usize {
            self.0.n_state()
        }
        fn n_input(&self) -> usize {
            self.0.n_input()
        }
        fn n_parameter(&self) -> usize {
            2
        }
        fn step<S: Scalar>(&self, x: &[S], u: &[S], theta: &[S], next: &mut [S]) {
            self.0.step(x, &[u[0] * theta[0], u[1] * theta[1], u[2], u[3]], &[], next);
        }
    }

    #[test]
    fn a_gradient_has_the_same_bits_however_many_states_are_kept() {
        let system = Parametric(Quadrotor { is_loaded: false });
        let (x, theta) = (system.0.rest(), vec![1.1, 0.9]);
        let inputs: Vec<f64> = (0..101 * 4).map(|k| -0.2 + 0.3 * (k as f64).sin()).collect();
        let rollout = Rollout::new(system, Distance).unwrap();
        let (cost, whole) = rollout.gradient(&x, &inputs, &theta);
        for segment in [1, 7, 8, 11, 101] {
            let mut own = whole.clone();
            let again =
                rollout.gradient_by(segment, &mut rollout.scratch(), (&x, &inputs, &theta), &mut own, &mut || true);
            assert_eq!((Some(cost), &whole), (again, &own), "{segment} states at a time");
        }
        assert_eq!(segment_length(500, 17), 500);
        assert_eq!(segment_length(10_000, 17), 100);
    }

    /// Costs and gradients over several horizons by machine code, against those of the interpreter and of compiled steps.
    fn has_equal_bits_by_machine_code<F: System + Clone>(system: F, x: &[f64], is_side_by_side: bool) {
        let (m, theta) = (system.n_input(), vec![1.0; system.n_parameter()]);
        let rollout = Rollout::new(system.clone(), Distance).unwrap();
        let (mut interpreted, mut scratch) = (rollout.scratch(), rollout.scratch());
        rollout.ask_for_code(&mut scratch, u64::MAX);
        let is_native = crate::native::availability().is_ok();
        assert_eq!(scratch.forward.is_some(), is_native);
        match &scratch.step {
            StepScratch::Code { code, .. } => assert_eq!((is_native, code.is_side_by_side()), (true, is_side_by_side)),
            StepScratch::Program(workspace) => assert_eq!(workspace.is_native(), is_native),
            StepScratch::Chain { .. } => assert!(!is_native),
        }
        let bits = |(cost, g): (f64, &Gradient)| -> Vec<u64> {
            let numbers = [cost].into_iter().chain(g.state.iter().chain(&g.inputs).chain(&g.parameters).copied());
            numbers.map(f64::to_bits).collect()
        };
        for horizon in [0, 1, 7, 8, 9, 30] {
            let inputs: Vec<f64> = (0..horizon * m).map(|k| -0.2 + 0.3 * (k as f64).sin()).collect();
            for (segment, with_inputs) in [(horizon.max(1), true), (5, true), (5, false)] {
                let own = |rollout: &Rollout<F, Distance>, scratch: &mut RolloutScratch| {
                    let inputs_gradient = vec![0.0; if with_inputs { inputs.len() } else { 0 }];
                    let mut gradient = Gradient {
                        state: vec![0.0; x.len()],
                        inputs: inputs_gradient,
                        parameters: vec![0.0; theta.len()],
                    };
                    let at = (x, &inputs[..], &theta[..]);
                    let cost = rollout.gradient_by(segment, scratch, at, &mut gradient, &mut || true).unwrap();
                    bits((cost, &gradient))
                };
                let by_code = own(&rollout, &mut scratch);
                // of which nobody has asked for so many
                let fresh = Rollout::new(system.clone(), Distance).unwrap();
                assert_eq!(by_code, own(&fresh, &mut interpreted), "{horizon} steps, {segment} at a time");
                assert!(interpreted.forward.is_none() && !matches!(interpreted.step, StepScratch::Code { .. }));
                let cost = rollout.cost(x, &inputs, &theta);
                assert_eq!(cost.to_bits(), by_code[0]);
                assert_eq!(cost.to_bits(), fresh.cost(x, &inputs, &theta).to_bits());
                let [a, b] = [&rollout, &fresh].map(|rollout| rollout.trajectory(x, &inputs, &theta));
                assert!(a.iter().zip(&b).all(|(a, b)| a.to_bits() == b.to_bits()) && a.len() == b.len());
            }
        }
    }

    #[test]
    fn a_gradient_has_the_same_bits_by_machine_code_eight_steps_side_by_side() {
        let system = Quadrotor { is_loaded: false };
        let x = system.rest();
        has_equal_bits_by_machine_code(system, &x, true);
    }

    /// A spring with two parameters that are multiplied into a chain of functions, long enough to be swept step by step.
    #[derive(Clone)]
    struct Chained(usize);
    impl System for Chained {
        fn n_state(&self) -> usize {
            3
        }
        fn n_input(&self) -> usize {
            1
        }
        fn n_parameter(&self) -> usize {
            2
        }
        fn step<S: Scalar>(&self, x: &[S], u: &[S], theta: &[S], next: &mut [S]) {
            let mut y = x[0];
            for k in 0..self.0 {
                let (s, c) = (S::constant(0.5) * y * theta[k % 2]).sin_cos();
                y = s * x[1] + c * u[0] + S::select(y.lt(c), s, -y);
            }
            next[0] = x[0] + S::constant(0.1) * x[1];
            next[1] = y;
            next[2] = S::constant(0.9) * x[2];
        }
    }

    #[test]
    fn a_gradient_has_the_same_bits_by_machine_code_one_step_after_the_other() {
        has_equal_bits_by_machine_code(Chained(600), &[0.3, -0.2, 0.1], false);
        has_equal_bits_by_machine_code(Chained(3), &[0.3, -0.2, 0.1], true);
        has_equal_bits_by_machine_code(Chained(3), &[0.0, -0.0, -0.0], true);
    }

    #[test]
    fn a_gradient_is_given_up_at_whichever_question_is_answered_no_and_has_its_bits_otherwise() {
        let system = Quadrotor { is_loaded: false };
        let (x, inputs) = (system.rest(), vec![-0.2; 4 * 1000]);
        let rollout = Rollout::new(system, Distance).unwrap();
        let (cost, whole) = rollout.gradient(&x, &inputs, &[]);
        let mut own = whole.clone();
        for segment in [90, 1000] {
            let asked_until = |last: usize, own: &mut Gradient| {
                let mut asked = 0;
                let mut goes_on = || {
                    asked += 1;
                    asked <= last
                };
                let by = rollout.gradient_by(segment, &mut rollout.scratch(), (&x, &inputs, &[]), own, &mut goes_on);
                (by, asked)
            };
            let (by, asked) = asked_until(usize::MAX, &mut own);
            assert_eq!((by, &own), (Some(cost), &whole));
            // forward over 1000 steps, and once per segment or every 256 steps backward
            assert!(asked >= 2 * 1000 / ASKED, "{asked}");
            for last in 0..asked {
                assert_eq!(asked_until(last, &mut own), (None, last + 1));
            }
        }
    }
}
