//! The gradient of a sum over sequences of experience, for policies with memory: back-propagation through time, truncated at
//! the window (Werbos 1990; Williams and Peng 1990).
//!
//! A rollout is cut into sequences of the window's steps, each of one agent. A sequence begins with what was remembered when
//! it was flown, a constant; where an episode begins within it, nothing is remembered and no gradient goes back. Up to
//! [`ROWS`] sequences go through the network together, step by step, then back. As with [`Minibatch`](super::minibatch::Minibatch)
//! parts have a size of their own and are folded in order: the bits are the same for any number of threads.

use super::minibatch::{BlockLoss, Sums, fold};
use super::nn::{Memory, Network, Output, Pass, Scratch, Weights};
use super::policy::ROWS;
use super::rollout::{RolloutBatch, RolloutShape};
use super::shards::within_memory;
use base::error::Result;
use base::parallel::Threads;

/// Rows of a rollout that follow each other in time: of one agent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sequence {
    /// The first one.
    pub first: u32,
    /// From each to the next.
    pub stride: u32,
    /// How many.
    pub len: u32,
}

impl Sequence {
    /// Its rows in order.
    pub fn rows(&self) -> impl Iterator<Item = usize> {
        let Self { first, stride, len } = *self;
        (0..len as usize).map(move |step| first as usize + step * stride as usize)
    }

    fn row(&self, step: usize) -> Option<usize> {
        (step < self.len as usize).then(|| self.first as usize + step * self.stride as usize)
    }
}

/// All sequences of up to `window` steps in rollouts of shards with so many environments each.
pub fn sequences(shape: RolloutShape, n_env: impl Iterator<Item = usize>, window: usize) -> Vec<Sequence> {
    let (mut all, mut base) = (Vec::new(), 0);
    for n_env in n_env {
        let rows = n_env * shape.n_agent;
        for begin in (0..shape.steps).step_by(window) {
            let len = window.min(shape.steps - begin) as u32;
            let own = |k: usize| Sequence { first: (base + begin * rows + k) as u32, stride: rows as u32, len };
            all.extend((0..rows).map(own));
        }
        // the last step holds what is seen behind the rollout
        base += rows * (shape.steps + 1);
    }
    all
}

/// Memory for minibatches of sequences of one network.
pub struct Sequences {
    parts: Vec<NamedTensor>,
    window: usize,
    /// The last one's: of the network, then of `n_extra` parameters more.
    pub gradient: Vec<f32>,
}

/// Up to [`ROWS`] sequences on one thread.
struct NamedTensor {
    /// Of every step.
    memory: Vec<Memory>,
    scratch: Scratch,
    /// Rows `[observation, state]` of every step.
    x: Vec<Vec<f32>>,
    /// What the last step remembered.
    state: Vec<f32>,
    /// Of the head's numbers and the state's, for one step.
    grad_output: Vec<f32>,
    /// Of the head's numbers at every step, `[window][ROWS, n_head]`.
    grad_head: Vec<Vec<f32>>,
    grad_input: Vec<f32>,
    /// Rows that take part in a step: their places, what the network gave for them, what the loss says of it.
    rows: Vec<u32>,
    places: Vec<u32>,
    given: Vec<f32>,
    grad_given: Vec<f32>,
    gradient: Vec<f32>,
    sums: Sums,
}

impl Sequences {
    /// For up to `n` sequences of `window` steps, outputs of which the first `n_head` are the head's.
    ///
    /// # Errors
    /// [`Error::Limit`](base::error::Error::Limit) for more than `limit` bytes: every part keeps all steps.
    pub fn new(
        mlp: &dyn Network,
        n_head: usize,
        n_extra: usize,
        (n, window): (usize, usize),
        limit: u64,
    ) -> Result<Self> {
        let n_gradient = mlp.n_parameter() + n_extra;
        let of_step = ROWS * (mlp.n_input() + mlp.n_activation() + n_head);
        let of_part = (n_gradient + window * of_step + ROWS * 2 * mlp.n_activation()) as u128;
        within_memory("sequences of a minibatch", n, 4 * of_part * n.div_ceil(ROWS) as u128, limit)?;
        let each = |n: usize| vec![vec![0.0; n]; window];
        let part = || NamedTensor {
            memory: (0..window).map(|_| mlp.memory(ROWS)).collect(),
            scratch: mlp.scratch(ROWS),
            x: each(ROWS * mlp.n_input()),
            state: vec![0.0; ROWS * mlp.n_state()],
            grad_output: vec![0.0; ROWS * mlp.n_output()],
            grad_head: each(ROWS * n_head),
            grad_input: vec![0.0; ROWS * mlp.n_input()],
            rows: Vec::with_capacity(ROWS),
            places: Vec::with_capacity(ROWS),
            given: vec![0.0; ROWS * n_head],
            grad_given: vec![0.0; ROWS * n_head],
            gradient: vec![0.0; n_gradient],
            sums: Sums::default(),
        };
        let parts = (0..n.div_ceil(ROWS)).map(|_| part()).collect();
        Ok(Self { parts, window, gradient: vec![0.0; n_gradient] })
    }

    /// Σ over the rows of the sequences `chosen` that `counts` of ∂loss/∂parameters, into [`Sequences::gradient`].
    #[expect(clippy::too_many_arguments, reason = "a network, what it flew, which of it, and what that cost")]
    pub fn gradient(
        &mut self,
        threads: &Threads,
        mlp: &dyn Network,
        net: Weights<'_>,
        rollout: &RolloutBatch,
        chosen: &[Sequence],
        counts: &(dyn Fn(usize) -> bool + Sync),
        loss: &impl BlockLoss,
    ) -> Sums {
        let n_part = chosen.len().div_ceil(ROWS);
        let window = self.window;
        threads.for_each(&mut self.parts[..n_part], |k, part| {
            let own = &chosen[k * ROWS..chosen.len().min((k + 1) * ROWS)];
            part.gradient.fill(0.0);
            part.sums = Sums::default();
            let steps = own.iter().map(|sequence| sequence.len as usize).max().unwrap_or(0).min(window);
            for step in 0..steps {
                part.forward(mlp, net, rollout, own, step, counts, loss);
            }
            for step in (0..steps).rev() {
                part.backward(mlp, net, rollout, own, (step, step + 1 == steps));
            }
        });
        fold(&mut self.gradient, self.parts[..n_part].iter().map(|part| (&part.gradient[..], part.sums)))
    }
}

impl NamedTensor {
    /// One step of all sequences, and the loss of the rows that count.
    #[expect(clippy::too_many_arguments, reason = "those of Sequences::gradient, and the step")]
    fn forward(
        &mut self,
        mlp: &dyn Network,
        net: Weights<'_>,
        rollout: &RolloutBatch,
        own: &[Sequence],
        step: usize,
        counts: &(dyn Fn(usize) -> bool + Sync),
        loss: &impl BlockLoss,
    ) {
        let (n_in, n_state, n_seen) = (mlp.n_input(), mlp.n_state(), mlp.n_input() - mlp.n_state());
        let n_head = mlp.n_output() - n_state;
        let x = &mut self.x[step][..own.len() * n_in];
        self.rows.clear();
        self.places.clear();
        for (k, (to, sequence)) in x.chunks_exact_mut(n_in).zip(own).enumerate() {
            let Some(row) = sequence.row(step) else {
                to.fill(0.0);
                continue;
            };
            let seen = &rollout.observation[row * n_seen..][..n_seen];
            to[..n_seen].copy_from_slice(seen);
            if seen.iter().any(|x| !x.is_finite()) {
                // no product may see it: what follows has forgotten it
                to[..n_seen].fill(0.0);
            }
            let flown = step == 0 || rollout.begins[row] == 1;
            let state = if flown { &rollout.state[row * n_state..] } else { &self.state[k * n_state..] };
            to[n_seen..].copy_from_slice(&state[..n_state]);
            if counts(row) {
                self.rows.push(row as u32);
                self.places.push(k as u32);
            }
        }
        let output = mlp.forward(net.parameters, x, own.len(), &mut self.memory[step]);
        for (k, state) in self.state.chunks_exact_mut(n_state).enumerate().take(own.len()) {
            state.copy_from_slice(&output.row(k)[n_head..]);
        }
        let grad_head = &mut self.grad_head[step];
        grad_head.fill(0.0);
        if self.rows.is_empty() {
            return;
        }
        for (given, k) in self.given.chunks_exact_mut(n_head).zip(&self.places) {
            given.copy_from_slice(&output.row(*k as usize)[..n_head]);
        }
        let n = self.rows.len() * n_head;
        let grad_given = &mut self.grad_given[..n];
        grad_given.fill(0.0);
        let extra = &mut self.gradient[mlp.n_parameter()..];
        loss.block(&self.rows, Output::new(&self.given[..n], n_head, n_head), grad_given, extra, &mut self.sums);
        for (grad, k) in grad_given.chunks_exact(n_head).zip(&self.places) {
            grad_head[*k as usize * n_head..][..n_head].copy_from_slice(grad);
        }
    }

    /// One step of all sequences on the way back; behind the last one nothing comes of the state.
    fn backward(
        &mut self,
        mlp: &dyn Network,
        net: Weights<'_>,
        rollout: &RolloutBatch,
        own: &[Sequence],
        (step, is_last): (usize, bool),
    ) {
        let (n_in, n_out, n_state) = (mlp.n_input(), mlp.n_output(), mlp.n_state());
        let (n_seen, n_head) = (n_in - n_state, n_out - n_state);
        for (k, (to, sequence)) in self.grad_output.chunks_exact_mut(n_out).zip(own).enumerate() {
            to[..n_head].copy_from_slice(&self.grad_head[step][k * n_head..][..n_head]);
            let next = sequence.row(step + 1).filter(|row| !is_last && rollout.begins[*row] == 0);
            match next {
                Some(_) => to[n_head..].copy_from_slice(&self.grad_input[k * n_in + n_seen..][..n_state]),
                None => to[n_head..].fill(0.0),
            }
        }
        let gradient = &mut self.gradient[..mlp.n_parameter()];
        let grad_input = &mut self.grad_input[..if step > 0 { own.len() * n_in } else { 0 }];
        let pass = Pass { gradient, grad_input, scratch: &mut self.scratch };
        let (x, grad_output) = (&self.x[step][..own.len() * n_in], &self.grad_output[..own.len() * n_out]);
        mlp.backward(net, x, own.len(), &self.memory[step], grad_output, pass);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Activation, Join, Layers, Mlp, Stack, Transposed};
    use rng::{Purpose, Stream};

    const SHAPE: RolloutShape = RolloutShape {
        steps: 7,
        n_agent: 2,
        n_value: 2,
        n_observation: 3,
        n_central: 0,
        n_privileged: 0,
        n_action: 2,
        n_state: 5,
    };

    fn network() -> Stack {
        let layers = Layers { hidden: vec![6], ..Layers::default() };
        Stack::new(3, Vec::new(), Join::Concat, Some(5), |n| Mlp::new(n, &layers, 2, Activation::Tanh)).unwrap()
    }

    fn draw(n: usize, seed: u64) -> Vec<f32> {
        let mut stream = Stream::new(seed, 0, 0, Purpose::LEARNING);
        (0..n).map(|_| 0.5 * stream.normal() as f32).collect()
    }

    /// What was seen, with an episode that begins within a window and one at the start of one.
    fn rollout() -> RolloutBatch {
        let mut rollout = RolloutBatch::new(SHAPE, 5);
        rollout.observation = draw(rollout.observation.len(), 1);
        rollout.action = draw(rollout.action.len(), 2);
        rollout.state = draw(rollout.state.len(), 3);
        // rows of the first shard, of 3 environments: step 2 of its row 1, step 4 of its row 0
        for row in [2 * 6 + 1, 4 * 6] {
            rollout.begins[row] = 1;
            rollout.state[row * 5..][..5].fill(0.0);
        }
        rollout
    }

    /// Σ ½‖y − a‖² over the rows that count, and its gradient.
    fn learn(
        rollout: &RolloutBatch,
        p: &[f32],
        threads: usize,
        counts: &(dyn Fn(usize) -> bool + Sync),
    ) -> (f64, Vec<f32>) {
        let net = network();
        let all = sequences(SHAPE, [3, 2].into_iter(), 4);
        let mut own = Sequences::new(&net, 2, 0, (all.len(), 4), 1 << 30).unwrap();
        let mut transposed = Transposed::default();
        net.transpose(p, &mut transposed);
        let loss = |row: usize, y: &[f32], grad: &mut [f32], _: &mut [f32], sums: &mut Sums| {
            for i in 0..2 {
                grad[i] = y[i] - rollout.action[2 * row + i];
                sums[0] += 0.5 * f64::from(grad[i]).powi(2);
            }
        };
        let weights = Weights { parameters: p, transposed: &transposed };
        let threads = Threads::new(threads).unwrap();
        let sums = own.gradient(&threads, &net, weights, rollout, &all, counts, &loss);
        (sums[0], own.gradient)
    }

    /// The same sum in `f64`, step by step by the formulas of the unit, from named tensors.
    fn exact(rollout: &RolloutBatch, parts: &[(String, Vec<f64>)]) -> f64 {
        let of = |name: &str| &parts.iter().find(|part| part.0 == name).unwrap().1[..];
        let dot = |w: &[f64], o: usize, x: &[f64]| (0..x.len()).map(|i| w[o * x.len() + i] * x[i]).sum::<f64>();
        let layer = |l: usize, x: &[f64]| -> Vec<f64> {
            let (w, b) = (of(&format!("{l}.weight")), of(&format!("{l}.bias")));
            (0..b.len()).map(|o| (b[o] + dot(w, o, x)).tanh()).collect()
        };
        let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
        let wide = |x: &[f32]| x.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
        let mut total = 0.0;
        for sequence in sequences(SHAPE, [3, 2].into_iter(), 4) {
            let mut h = Vec::new();
            for step in 0..sequence.len as usize {
                let row = sequence.row(step).unwrap();
                if step == 0 || rollout.begins[row] == 1 {
                    h = wide(&rollout.state[row * 5..][..5]);
                }
                let x = wide(&rollout.observation[row * 3..][..3]);
                let own = |o: usize| dot(of("memory.weight_ih"), o, &x) + of("memory.bias_ih")[o];
                let kept = |o: usize| dot(of("memory.weight_hh"), o, &h) + of("memory.bias_hh")[o];
                let next = |i: usize| {
                    let (r, z) = (sigmoid(own(i) + kept(i)), sigmoid(own(5 + i) + kept(5 + i)));
                    (1.0 - z) * (own(10 + i) + r * kept(10 + i)).tanh() + z * h[i]
                };
                let next: Vec<f64> = (0..5).map(next).collect();
                h = next;
                let y = layer(1, &layer(0, &[&x[..], &h].concat()));
                let far = |i: usize| (y[i] - f64::from(rollout.action[2 * row + i])).powi(2);
                total += 0.5 * (far(0) + far(1));
            }
        }
        total
    }

    #[test]
    fn the_gradient_through_windows_and_resets_is_that_of_differences_in_f64() {
        let (rollout, p) = (rollout(), draw(network().n_parameter(), 4));
        // padding has no part in it
        let named = network().parts(&p);
        let p = network()
            .from_parts(&mut |name, _| Ok(named.iter().find(|part| part.name == name).unwrap().data.clone()))
            .unwrap();
        let mut parts: Vec<(String, Vec<f64>)> = network()
            .parts(&p)
            .into_iter()
            .map(|part| (part.name, part.data.iter().map(|x| f64::from(*x)).collect()))
            .collect();
        let (value, gradient) = learn(&rollout, &p, 1, &|_| true);
        let want = exact(&rollout, &parts);
        assert!((value - want).abs() < 1e-6 * want, "{value} {want}"); // measured 2.1e-8 of it
        let gradient = network().parts(&gradient);
        let (mut worst, h) = (0.0_f64, 1e-5);
        for q in 0..parts.len() {
            for at in 0..parts[q].1.len() {
                let middle = parts[q].1[at];
                let mut shifted = |h: f64| {
                    parts[q].1[at] = middle + h;
                    exact(&rollout, &parts)
                };
                let want = (shifted(h) - shifted(-h)) / (2.0 * h);
                parts[q].1[at] = middle;
                worst = worst.max((f64::from(gradient[q].data[at]) - want).abs() / want.abs().max(1.0));
            }
        }
        println!("value {:.1e}, gradient {worst:.1e}", (value - want).abs() / want);
        assert!(worst < 3e-6, "{worst:e}"); // measured 4.5e-7
    }

    #[test]
    fn the_bits_are_the_same_for_any_number_of_threads() {
        let (rollout, p) = (rollout(), draw(network().n_parameter(), 4));
        let one = learn(&rollout, &p, 1, &|_| true);
        assert!(one == learn(&rollout, &p, 2, &|_| true) && one == learn(&rollout, &p, 3, &|_| true));
    }

    #[test]
    fn rows_that_do_not_count_and_what_was_no_number_leave_the_others_alone() {
        let p = draw(network().n_parameter(), 4);
        let (mut broken, mut cut) = (rollout(), rollout());
        // row 3 of the first shard at step 1 shows what is no number; its state is lost behind it
        let (bad, next) = (6 + 3, 2 * 6 + 3);
        for rollout in [&mut broken, &mut cut] {
            rollout.begins[next] = 1;
            rollout.state[next * 5..][..5].fill(0.0);
        }
        broken.observation[bad * 3 + 1] = f32::NAN;
        let counts = |row: usize| row != bad;
        let (value, gradient) = learn(&broken, &p, 1, &counts);
        assert!((value, gradient.clone()) == learn(&cut, &p, 1, &counts) && gradient.iter().all(|x| x.is_finite()));
        assert!(gradient != learn(&cut, &p, 1, &|_| true).1);
    }

    #[test]
    fn sequences_hold_every_row_once_but_those_behind_the_rollout() {
        let all = sequences(SHAPE, [3, 2].into_iter(), 4);
        let mut rows: Vec<usize> = all.iter().flat_map(Sequence::rows).collect();
        rows.sort_unstable();
        let want: Vec<usize> = (0..7 * 6).chain(8 * 6..8 * 6 + 7 * 4).collect();
        assert_eq!(rows, want);
        assert_eq!(
            (all.len(), all[0], all[6]),
            (20, Sequence { first: 0, stride: 6, len: 4 }, Sequence { first: 24, stride: 6, len: 3 })
        );
    }
}
