//! Gradients of many rollouts at once, 64 to a block, in lanes.
//!
//! The same reverse sweep as [`Rollout`](super::Rollout), with the step itself, its costs and their adjoints all run by
//! the block interpreter in `f32`. The rollouts differ in their start; inputs and parameters are shared, and the
//! gradient with respect to the parameters is the mean over the rollouts that stayed finite.

use super::columns::{BLOCK, Columns};
use super::native::Place;
use super::program::{BlockWorkspace, InPlace, InPlaceWork, Program};
use super::rollout::record_step;
use super::system::{Objective, System};
use super::trace::Recording;
use base::error::{Error, Result};
use base::parallel::Threads;
use std::sync::Arc;

/// One number of each environment of a block.
type Row = [f32; BLOCK];

/// A system and an objective, compiled for many rollouts at once: gradients by the adjoint as of [`Rollout`](super::Rollout), 64 rollouts
/// to a block, in `f32` lanes. Rollouts differ in their start; inputs and parameters are shared.
#[derive(Debug, Clone)]
pub struct BatchRollout {
    n_state: usize,
    n_input: usize,
    n_parameter: usize,
    /// [x, u, θ] → [x⁺, c], x⁺ over x.
    step: Arc<InPlace>,
    /// [x, u, θ, λ⁺, ρ] → [x̄, θ̄], x̄ over λ⁺.
    step_adjoint: Arc<InPlace>,
    /// [x, θ] → c_T.
    terminal: Program,
    /// [x, θ, ρ] → [x̄, θ̄].
    terminal_adjoint: Program,
}

/// Costs of a batch of rollouts and the mean gradient.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchGradient {
    /// J of each rollout, `[N]`; not finite where it diverged.
    pub costs: Vec<f32>,
    /// Mean of ∂J/∂θ over the rollouts whose cost and gradient are finite, `[p]`; zeros without any.
    pub parameters: Vec<f64>,
    /// How many those are.
    pub n_finite: usize,
}

/// Costs and gradients of one block.
struct BlockResult {
    costs: Row,
    parameters: Vec<Row>,
}

impl BatchRollout {
    /// Records the step and the costs and compiles them with their adjoints.
    ///
    /// # Errors
    /// [`Error::Limit`] if a recording is too large to compile.
    pub fn new<F: System, C: Objective>(system: &F, objective: &C) -> Result<Self> {
        let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
        let step = record_step(system, objective);
        let terminal = Recording::of(n + p, |z| vec![objective.terminal(&z[..n], &z[n..])]);
        let mut step_adjoint = step.adjoint(0..n + m + p);
        step_adjoint.outputs.drain(n..n + m); // inputs are shared: nobody asks
        let over = |first: usize, n_behind: usize| {
            let own = (first..first + n).map(|row| Place { array: 0, row: row as u32 });
            own.chain((0..n_behind as u32).map(|row| Place { array: 1, row })).collect()
        };
        Ok(Self {
            n_state: n,
            n_input: m,
            n_parameter: p,
            step: Arc::new(InPlace::new(Program::compile(&step)?, over(0, 1))),
            step_adjoint: Arc::new(InPlace::new(Program::compile(&step_adjoint)?, over(n + m + p, p))),
            terminal: Program::compile(&terminal)?,
            terminal_adjoint: Program::compile(&terminal.adjoint(0..n + p))?,
        })
    }

    /// Costs J = Σₖ c(xₖ, uₖ, θ) + c_T(x_T, θ) and their mean gradient by θ. `states`: the starts x₀, row-major `[N, n]`; `inputs`:
    /// row-major `[T, m]`, shared; `parameters`: `[p]`.
    ///
    /// Results do not depend on the number of threads.
    ///
    /// # Errors
    /// [`Error::Value`] if a length does not fit, without a rollout or a step.
    pub fn gradient(
        &self,
        states: &[f32],
        inputs: &[f64],
        parameters: &[f64],
        threads: &Threads,
    ) -> Result<BatchGradient> {
        let n_rollout = self.check(states, inputs, parameters)?;
        let blocks = threads.map(n_rollout.div_ceil(BLOCK), |b| {
            let rows = &states[b * BLOCK * self.n_state..states.len().min((b + 1) * BLOCK * self.n_state)];
            Sweep::new(self, inputs.len() / self.n_input).run(rows, inputs, parameters)
        });
        let mut result = BatchGradient {
            costs: Vec::with_capacity(n_rollout),
            parameters: vec![0.0; self.n_parameter],
            n_finite: 0,
        };
        for (b, block) in blocks.iter().enumerate() {
            for lane in 0..BLOCK.min(n_rollout - b * BLOCK) {
                let cost = block.costs[lane];
                result.costs.push(cost);
                if !cost.is_finite() || block.parameters.iter().any(|row| !row[lane].is_finite()) {
                    continue;
                }
                result.n_finite += 1;
                for (sum, row) in result.parameters.iter_mut().zip(&block.parameters) {
                    *sum += f64::from(row[lane]);
                }
            }
        }
        let scale = 1.0 / result.n_finite.max(1) as f64;
        result.parameters.iter_mut().for_each(|g| *g *= scale);
        Ok(result)
    }

    fn check(&self, states: &[f32], inputs: &[f64], parameters: &[f64]) -> Result<usize> {
        for (what, got, row) in [("states", states.len(), self.n_state), ("inputs", inputs.len(), self.n_input)] {
            if got == 0 || !got.is_multiple_of(row.max(1)) {
                let rule = format!("a positive multiple of {row}");
                return Err(Error::value(
                    format!("length of {what}"),
                    got,
                    rule,
                    "Rows are rollouts or steps, row-major.",
                ));
            }
        }
        if parameters.len() != self.n_parameter {
            let wanted = self.n_parameter.to_string();
            return Err(Error::value("length of parameters", parameters.len(), wanted, "See System::n_parameter."));
        }
        Ok(states.len() / self.n_state)
    }
}

/// The memory of one block's sweep.
struct Sweep<'a> {
    of: &'a BatchRollout,
    /// [x, u, θ, λ, ρ].
    arguments: Columns,
    results: Columns,
    /// States at the start of each segment, and within one.
    anchors: Vec<Row>,
    segment: Vec<Row>,
    step: InPlaceWork,
    step_adjoint: InPlaceWork,
    terminal: BlockWorkspace,
    terminal_adjoint: BlockWorkspace,
}

impl<'a> Sweep<'a> {
    fn new(of: &'a BatchRollout, horizon: usize) -> Self {
        let (n, m, p) = (of.n_state, of.n_input, of.n_parameter);
        // forward, and once more within segments
        let (n_step, n_back) = (2 * horizon as u64, horizon as u64);
        Self {
            of,
            arguments: Columns::zeros(n + m + p + n + 1),
            results: Columns::zeros((n + 1).max(n + p)),
            anchors: Vec::new(),
            segment: Vec::new(),
            step: of.step.work_for(n_step),
            step_adjoint: of.step_adjoint.work_for(n_back),
            terminal: of.terminal.block_workspace_for(1),
            terminal_adjoint: of.terminal_adjoint.block_workspace_for(1),
        }
    }

    fn run(mut self, states: &[f32], inputs: &[f64], parameters: &[f64]) -> BlockResult {
        let (n, m, p) = (self.of.n_state, self.of.n_input, self.of.n_parameter);
        let horizon = inputs.len() / m;
        let length = horizon.isqrt().max(1);
        for (k, value) in parameters.iter().enumerate() {
            self.arguments[n + m + k] = [*value as f32; BLOCK];
        }
        self.arguments[n + m + p + n] = [1.0; BLOCK];
        self.load(states);

        let mut costs = [0.0; BLOCK];
        for (k, u) in inputs.chunks_exact(m).enumerate() {
            if k % length == 0 {
                self.anchors.extend_from_slice(&self.arguments[..n]);
            }
            self.step_forward(u);
            for (sum, cost) in costs.iter_mut().zip(&self.results[0]) {
                *sum += cost;
            }
        }
        let mut gradient = self.start_backward(&mut costs);
        for s in (0..self.anchors.len() / n).rev() {
            let (from, to) = (s * length, ((s + 1) * length).min(horizon));
            self.refill(s, &inputs[from * m..to * m]);
            for k in (from..to).rev() {
                self.step_backward(k - from, &inputs[k * m..(k + 1) * m], &mut gradient);
            }
        }
        BlockResult { costs, parameters: gradient }
    }

    /// Rows of starts into columns; lanes beyond them repeat the last start.
    fn load(&mut self, states: &[f32]) {
        let n = self.of.n_state;
        let last = states.len() / n - 1;
        for lane in 0..BLOCK {
            let row = &states[lane.min(last) * n..];
            for k in 0..n {
                self.arguments[k][lane] = row[k];
            }
        }
    }

    fn set_input(&mut self, u: &[f64]) {
        for (k, value) in u.iter().enumerate() {
            self.arguments[self.of.n_state + k] = [*value as f32; BLOCK];
        }
    }

    /// x ← f(x, u, θ); the cost of the step is left in `results[0]`.
    fn step_forward(&mut self, u: &[f64]) {
        self.set_input(u);
        self.of.step.evaluate(BLOCK, &mut self.step, &mut self.arguments, &mut self.results);
    }

    /// Adds c_T; λ_T into the arguments; returns ∂c_T/∂θ.
    fn start_backward(&mut self, costs: &mut Row) -> Vec<Row> {
        let (n, m, p) = (self.of.n_state, self.of.n_input, self.of.n_parameter);
        let mut z: Vec<Row> = self.arguments[..n].to_vec();
        z.extend_from_slice(&self.arguments[n + m..n + m + p]);
        self.of.terminal.evaluate_block(&mut self.terminal, &z, &mut self.results[..1]);
        for (sum, cost) in costs.iter_mut().zip(&self.results[0]) {
            *sum += cost;
        }
        z.push([1.0; BLOCK]);
        self.of.terminal_adjoint.evaluate_block(&mut self.terminal_adjoint, &z, &mut self.results[..n + p]);
        self.arguments[n + m + p..n + m + p + n].copy_from_slice(&self.results[..n]);
        self.results[n..n + p].to_vec()
    }

    /// States of segment `s` again, from its anchor.
    fn refill(&mut self, s: usize, inputs: &[f64]) {
        let n = self.of.n_state;
        self.arguments[..n].copy_from_slice(&self.anchors[s * n..(s + 1) * n]);
        self.segment.clear();
        for u in inputs.chunks_exact(self.of.n_input) {
            self.segment.extend_from_slice(&self.arguments[..n]);
            self.step_forward(u);
        }
    }

    /// λ ← x̄ from the state `k` of the segment, and θ̄ added to `gradient`.
    fn step_backward(&mut self, k: usize, u: &[f64], gradient: &mut [Row]) {
        let n = self.of.n_state;
        self.arguments[..n].copy_from_slice(&self.segment[k * n..(k + 1) * n]);
        self.set_input(u);
        self.of.step_adjoint.evaluate(BLOCK, &mut self.step_adjoint, &mut self.arguments, &mut self.results);
        for (sum, row) in gradient.iter_mut().zip(&self.results[..self.of.n_parameter]) {
            for lane in 0..BLOCK {
                sum[lane] += row[lane];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Rollout, Scalar};

    /// A damped pendulum with stiffness and damping as parameters, pushed by u.
    struct Pendulum;
    impl System for Pendulum {
        fn n_state(&self) -> usize {
            2
        }
        fn n_input(&self) -> usize {
            1
        }
        fn n_parameter(&self) -> usize {
            2
        }
        fn step<S: Scalar>(&self, x: &[S], u: &[S], theta: &[S], next: &mut [S]) {
            let h = S::constant(0.05);
            let pull = theta[0] * x[0].sin_cos().0 + theta[1] * x[1];
            next[1] = x[1] + h * (u[0] - pull);
            next[0] = x[0] + h * next[1];
        }
    }
    struct Rest;
    impl Objective for Rest {
        fn stage<S: Scalar>(&self, x: &[S], _: &[S], theta: &[S]) -> S {
            x[0].square() + S::constant(0.01) * theta[1].square()
        }
        fn terminal<S: Scalar>(&self, x: &[S], theta: &[S]) -> S {
            x[1].square() * theta[0]
        }
    }

    #[test]
    fn a_batch_gives_each_rollouts_cost_and_the_mean_of_their_gradients() {
        let (theta, inputs) = ([2.0, 0.3], (0..90).map(|k| (f64::from(k) * 0.2).sin()).collect::<Vec<_>>());
        let states: Vec<f32> = (0..100).flat_map(|i| [0.01 * i as f32, 0.5 - 0.02 * i as f32]).collect();
        let batch = BatchRollout::new(&Pendulum, &Rest).unwrap();
        let got = batch.gradient(&states, &inputs, &theta, &Threads::default()).unwrap();
        let single = Rollout::new(Pendulum, Rest).unwrap();
        let mut mean = [0.0; 2];
        for (start, cost) in states.chunks(2).zip(&got.costs) {
            let x0 = [f64::from(start[0]), f64::from(start[1])];
            let (exact, gradient) = single.gradient(&x0, &inputs, &theta);
            assert!((f64::from(*cost) - exact).abs() <= 3e-6 * exact.abs().max(1.0)); // measured 7e-7
            mean[0] += gradient.parameters[0] / 100.0;
            mean[1] += gradient.parameters[1] / 100.0;
        }
        for (a, b) in got.parameters.iter().zip(mean) {
            assert!((a - b).abs() <= 2e-6 * b.abs().max(1.0), "{a} {b}"); // measured 2e-7
        }
        assert_eq!(got.n_finite, 100);
    }

    #[test]
    fn a_diverged_rollout_is_left_out_of_the_mean_and_changes_no_other() {
        let (theta, inputs) = ([2.0, 0.3], vec![0.1; 50]);
        let healthy: Vec<f32> = (0..70).flat_map(|i| [0.01 * i as f32, 0.0]).collect();
        let batch = BatchRollout::new(&Pendulum, &Rest).unwrap();
        let alone = batch.gradient(&healthy, &inputs, &theta, &Threads::default()).unwrap();
        let mut mixed = healthy.clone();
        mixed.extend([f32::MAX, f32::MAX]);
        let with = batch.gradient(&mixed, &inputs, &theta, &Threads::default()).unwrap();
        assert_eq!((with.n_finite, &with.costs[..70], &with.parameters), (70, &alone.costs[..], &alone.parameters));
        assert!(!with.costs[70].is_finite());
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let states: Vec<f32> = (0..300).flat_map(|i| [0.003 * i as f32, 0.1]).collect();
        let batch = BatchRollout::new(&Pendulum, &Rest).unwrap();
        let run = |n| batch.gradient(&states, &[0.2; 40], &[1.0, 0.1], &Threads::new(n).unwrap()).unwrap();
        assert_eq!(run(1), run(2));
        assert_eq!(run(1), run(8));
    }
}
