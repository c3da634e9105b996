//! A value function: a network from what is seen to one number, fitted to targets.

use super::checkpoint::Tensors;
use super::input_scale::InputScale;
use super::minibatch::{BlockLoss, Minibatch, Sums};
use super::nn::{
    Activation, Adam, AdamConfig, Layers, Memory, Mlp, Output, Pass, Scratch, Transposed, Weights, clip_norm,
};
use super::policy::ROWS;
use super::state;
use base::error::Result;
use base::parallel::Threads;
use rng::Stream;

/// V(x), with its optimiser.
pub struct Critic {
    /// From what is seen to one number.
    pub mlp: Mlp,
    /// Of the network.
    pub parameters: Vec<f32>,
    /// Its optimiser.
    pub adam: Adam,
    /// Of what it sees, where the environment does not normalise that.
    pub(crate) inputs: Option<InputScale>,
    transposed: Transposed,
    batch: Minibatch,
    memory: Vec<Memory>,
}

impl Critic {
    /// From `n_in` numbers, for minibatches of up to `rows` rows within `limit` bytes.
    ///
    /// # Errors
    /// As `Mlp::new` and [`Minibatch::new`].
    pub fn new(
        n_in: usize,
        layers: &Layers,
        adam: AdamConfig,
        (rows, limit): (usize, u64),
        stream: &mut Stream,
    ) -> Result<Self> {
        let mlp = Mlp::new(n_in, layers, 1, Activation::Identity)?;
        let parameters = mlp.init(stream);
        let mut critic = Self {
            adam: Adam::new(adam, parameters.len()),
            inputs: None,
            transposed: Transposed::default(),
            batch: Minibatch::new(&mlp, 0, rows, limit)?,
            memory: Vec::new(),
            mlp,
            parameters,
        };
        critic.set_parameters_changed();
        Ok(critic)
    }

    /// With weights `by` times as large, for tests in which V must not vanish.
    #[cfg(test)]
    pub fn scale_for_test(&mut self, by: f32) {
        self.parameters.iter_mut().for_each(|x| *x *= by);
        self.set_parameters_changed();
    }

    fn set_parameters_changed(&mut self) {
        self.mlp.transpose(&self.parameters, &mut self.transposed);
    }

    /// Begins again from random weights.
    pub fn begin(&mut self, stream: &mut Stream) {
        self.parameters = self.mlp.init(stream);
        self.adam = Adam::new(self.adam.config, self.parameters.len());
        self.set_parameters_changed();
    }

    /// Weights and optimiser, as `critic…`.
    ///
    /// # Errors
    /// None for names that are used once.
    pub fn save(&self, out: &mut Tensors) -> Result<()> {
        state::put_network(out, "critic", &self.mlp, &self.parameters)?;
        self.inputs.iter().try_for_each(|inputs| inputs.save(out))?;
        state::put_adam(out, "critic", &self.adam)
    }

    /// As saved.
    ///
    /// # Errors
    /// As [`Tensors::get`].
    pub fn load(&mut self, from: &Tensors) -> Result<()> {
        let parameters = state::network(from, "critic", &self.mlp)?;
        self.adam = state::adam(from, "critic", self.adam.config, parameters.len())?;
        self.inputs.iter_mut().try_for_each(|inputs| inputs.load(from))?;
        self.parameters = parameters;
        self.set_parameters_changed();
        Ok(())
    }

    /// V of every row of `x`.
    pub fn values(&mut self, threads: &Threads, x: &[f32], values: &mut [f32]) {
        let n_in = self.mlp.n_input();
        let missing = values.len().div_ceil(ROWS).min(64).saturating_sub(self.memory.len());
        self.memory.extend((0..missing).map(|_| self.mlp.memory(ROWS)));
        // as many parts as there is memory for, each of whole blocks
        let each = values.len().div_ceil(ROWS).div_ceil(self.memory.len().max(1)) * ROWS;
        let (mlp, parameters) = (&self.mlp, &self.parameters);
        let parts = x.chunks(each.max(1) * n_in).zip(values.chunks_mut(each.max(1))).zip(&mut self.memory);
        let mut parts: Vec<_> = parts.collect();
        threads.for_each(&mut parts, |_, ((x, values), memory)| {
            for (x, values) in x.chunks(ROWS * n_in).zip(values.chunks_mut(ROWS)) {
                mlp.forward(parameters, x, values.len(), memory).write(values);
            }
        });
    }

    /// ∂/∂x of Σ up · V(x), rows of `[rows, n_in]`; `rows` at most what `memory` and `scratch` were made for.
    pub fn pull(
        &self,
        x: &[f32],
        grad_output: &[f32],
        (memory, scratch): (&mut Memory, &mut Scratch),
        grad_input: &mut [f32],
    ) {
        let net = Weights { parameters: &self.parameters, transposed: &self.transposed };
        self.mlp.forward(&self.parameters, x, grad_output.len(), memory);
        let pass = Pass { gradient: &mut [], grad_input, scratch };
        self.mlp.backward(net, x, grad_output.len(), memory, grad_output, pass);
    }

    /// One step down the mean of ½(V − target)² over the rows `chosen`; gives that mean from before. With `huber`, errors
    /// beyond it count linearly (Huber 1964). Rows whose target is not finite do not count.
    pub fn fit(&mut self, threads: &Threads, x: &[f32], target: &[f32], chosen: &[u32], step: Fit) -> f64 {
        if chosen.is_empty() {
            return 0.0;
        }
        let net = Weights { parameters: &self.parameters, transposed: &self.transposed };
        let share = 1.0 / chosen.len() as f32;
        let loss = Loss { target, share, huber: step.huber };
        let sums = self.batch.gradient(threads, &self.mlp, net, x, chosen, &loss);
        clip_norm(&mut self.batch.gradient, step.clip);
        self.adam.descend(&mut self.parameters, &self.batch.gradient, step.rate);
        self.set_parameters_changed();
        sums[0] * f64::from(share)
    }
}

/// The critic's loss over a minibatch.
struct Loss<'a> {
    target: &'a [f32],
    /// 1/rows of the minibatch.
    share: f32,
    huber: f32,
}

impl BlockLoss for Loss<'_> {
    fn block(&self, rows: &[u32], v: Output<'_>, grad_output: &mut [f32], _: &mut [f32], sums: &mut Sums) {
        for (k, (grad_output, row)) in grad_output.iter_mut().zip(rows).enumerate() {
            let error = v.row(k)[0] - self.target[*row as usize];
            if error.is_finite() {
                let bounded = error.clamp(-self.huber, self.huber);
                *grad_output = self.share * bounded;
                sums[0] += f64::from(bounded * (error - 0.5 * bounded));
            }
        }
    }
}

/// How far a critic steps.
#[derive(Debug, Clone, Copy)]
pub struct Fit {
    /// Learning rate.
    pub rate: f64,
    /// Largest norm of the gradient.
    pub clip: f64,
    /// Where errors begin to count linearly; infinite for never.
    pub huber: f32,
}

/// 0 … n − 1 in random order (Fisher and Yates 1938).
pub fn shuffle(order: &mut Vec<u32>, n: usize, stream: &mut Stream) {
    order.clear();
    order.extend(0..n as u32);
    for i in (1..n).rev() {
        order.swap(i, stream.below(i as u64 + 1) as usize);
    }
}
