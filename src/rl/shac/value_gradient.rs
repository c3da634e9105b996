//! The value behind a window and its gradient: how its costs weigh, and what the critic says of where it ends.

use crate::critic::Critic;
use crate::nn::{Memory, Scratch};
use crate::window::Window;

/// How parts of a window's cost weigh.
#[derive(Clone, Copy)]
pub(super) struct CostWeights {
    /// Of the first step: 1/(E·H).
    pub loss_scale: f32,
    /// γ.
    pub discount: f32,
    /// w.
    pub critic: f32,
    /// Whether an end by the task costs its last cost for ever.
    pub lasting: bool,
}

/// What SHAC keeps beside a window.
pub(super) struct WindowValue {
    /// γ^k of the next step of every environment.
    discount: Vec<f32>,
    gradient: ValueGradient,
    grad_output: Vec<f32>,
    /// ∂L/∂(the observation behind the window).
    pub d_last: Vec<f32>,
    /// `[H + 1, E, privileged]`: the numbers that only the critic sees, about the nominal ones; the last of the state behind the
    /// window.
    pub privileged: Vec<f32>,
}

impl WindowValue {
    pub fn new(window: &Window, critic: &Critic) -> Self {
        Self {
            discount: vec![1.0; window.shard.env.spec().n_env],
            gradient: ValueGradient::new(critic, window.rows()),
            grad_output: vec![0.0; window.rows()],
            d_last: vec![0.0; window.shard.out.observation.len()],
            privileged: Vec::new(),
        }
    }

    /// What only the critic sees, step by step; nothing where windows do not keep it.
    pub fn see_privileged(&mut self, window: &Window) {
        let Window { steps, shard, .. } = window;
        let mut rows: Vec<f32> = steps.iter().flat_map(|step| step.privileged.iter().copied()).collect();
        if !rows.is_empty() {
            rows.extend(&shard.out.privileged);
        }
        shard.env.spec().deviations(&rows, &mut self.privileged);
    }

    /// Step 2: ∂L/∂cost of every step, ∂L/∂o of what was seen last in episodes that ran out of time, and of what stands behind the
    /// window.
    pub fn weigh_costs(&mut self, window: &mut Window, critic: &Critic, weights: CostWeights) {
        let Self { discount, gradient, grad_output, d_last, privileged } = self;
        let n_env = discount.len();
        let n_agent = grad_output.len() / n_env;
        let beyond = 1.0 / (1.0 - weights.discount);
        discount.fill(weights.loss_scale);
        let n_step = window.steps.len();
        let of_step = |privileged: &'_ [f32], t: usize| {
            let n = privileged.len() / (n_step + 1);
            t * n..(t + 1) * n
        };
        for (t, step) in window.steps.iter_mut().enumerate() {
            step.d_final.clear();
            let timed_out = |i: usize| step.truncated[i] == 1 && step.terminated[i] == 0;
            if weights.critic > 0.0 && (0..n_env).any(timed_out) {
                for (k, grad_output) in grad_output.iter_mut().enumerate() {
                    let i = k / n_agent;
                    let own = discount[i] * weights.discount * weights.critic * beyond / n_agent as f32;
                    *grad_output = if timed_out(i) { own } else { 0.0 };
                }
                step.d_final.resize(step.observation.len(), 0.0);
                let privileged = &privileged[of_step(privileged, t)];
                gradient.pull(critic, (&step.final_observation, privileged), grad_output, &mut step.d_final);
            }
            // γ^(k + 1) of the last cost lie behind the window
            let behind = weights.discount.powi((n_step - t) as i32);
            let lasting = 1.0 + (weights.discount - (1.0 - weights.critic) * behind) * beyond;
            for i in 0..n_env {
                let lost = step.terminated[i] == 1;
                step.weight[i] = discount[i] * if lost && weights.lasting { lasting } else { 1.0 };
                let ended = lost || step.truncated[i] == 1;
                discount[i] = if ended { weights.loss_scale } else { discount[i] * weights.discount };
            }
        }
        d_last.fill(0.0);
        if weights.critic > 0.0 {
            for (k, grad_output) in grad_output.iter_mut().enumerate() {
                *grad_output = discount[k / n_agent] * weights.critic * beyond / n_agent as f32;
            }
            let privileged = &privileged[of_step(privileged, n_step)];
            gradient.pull(critic, (&window.shard.out.observation, privileged), grad_output, d_last);
        }
    }
}

/// What pulling back through the critic needs.
struct ValueGradient {
    memory: Memory,
    scratch: Scratch,
    /// Rows of the critic, and its gradient with respect to them.
    x: Vec<f32>,
    d_x: Vec<f32>,
}

impl ValueGradient {
    fn new(critic: &Critic, rows: usize) -> Self {
        let (memory, scratch) = (critic.mlp.memory(rows), critic.mlp.scratch(rows));
        Self { memory, scratch, x: Vec::new(), d_x: Vec::new() }
    }

    /// Adds ∂/∂o of Σ up · V(o, θ) to `d_seen`, for observations `[E, A, observation]` and the privileged numbers of each environment.
    fn pull(&mut self, critic: &Critic, (seen, privileged): (&[f32], &[f32]), up: &[f32], d_seen: &mut [f32]) {
        let memory = (&mut self.memory, &mut self.scratch);
        if privileged.is_empty() {
            return critic.pull(seen, up, memory, d_seen);
        }
        let n = seen.len() / up.len();
        let n_privileged = critic.mlp.n_input() - n;
        let n_agent = up.len() * n_privileged / privileged.len();
        self.x.clear();
        for (row, seen) in seen.chunks_exact(n).enumerate() {
            self.x.extend(seen);
            self.x.extend(&privileged[row / n_agent * n_privileged..][..n_privileged]);
        }
        self.d_x.clear();
        self.d_x.resize(self.x.len(), 0.0);
        critic.pull(&self.x, up, memory, &mut self.d_x);
        for (to, from) in d_seen.chunks_exact_mut(n).zip(self.d_x.chunks_exact(n + n_privileged)) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
    }
}
