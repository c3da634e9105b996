//! What a policy with memory remembers of several rows, from one act to the next.

use super::nn::{Memory, Output};
use super::policy::Actor;

/// The states of some rows; of a policy without memory nothing.
///
/// A state that is no number any more is forgotten, as if an episode began: one broken observation must not outlive its step.
#[derive(Debug, Clone)]
pub struct Recall {
    /// `[rows, n_state]`.
    pub state: Vec<f32>,
    /// 1 for each row that remembers nothing: whose episode began, or whose state was no number.
    pub begins: Vec<u8>,
    /// Rows as the network takes them.
    joined: Vec<f32>,
}

impl Recall {
    /// For `rows` rows that remember nothing, of which `at_once` act together.
    pub fn new(actor: &Actor, rows: usize, at_once: usize) -> Self {
        let n = actor.mlp.n_state();
        let joined = if n > 0 { at_once * actor.mlp.n_input() } else { 0 };
        Self { state: vec![0.0; rows * n], begins: vec![1; rows], joined: vec![0.0; joined] }
    }

    /// Numbers of a row's state.
    fn n_state(&self) -> usize {
        self.state.len() / self.begins.len().max(1)
    }

    /// This row begins anew.
    pub fn forget(&mut self, row: usize) {
        let n = self.n_state();
        self.state[row * n..(row + 1) * n].fill(0.0);
        self.begins[row] = 1;
    }

    /// All rows begin anew.
    pub fn forget_all(&mut self) {
        self.state.fill(0.0);
        self.begins.fill(1);
    }

    /// Outputs of the head for rows `x` of observations, the first of which is row `first` here; their states go on.
    pub fn forward<'m>(
        &mut self,
        actor: &Actor,
        network: &[f32],
        x: &[f32],
        first: usize,
        memory: &'m mut Memory,
    ) -> Output<'m> {
        let (n_seen, n, n_out) = (actor.n_observation(), actor.mlp.n_state(), actor.head.n_output());
        let rows = x.len() / n_seen;
        if n == 0 {
            return actor.mlp.forward(network, x, rows, memory);
        }
        let state = &mut self.state[first * n..][..rows * n];
        join(x, state, [n_seen, n], &mut self.joined);
        let output = actor.mlp.forward(network, &self.joined[..rows * (n_seen + n)], rows, memory);
        for (k, state) in state.chunks_exact_mut(n).enumerate() {
            state.copy_from_slice(&output.row(k)[n_out..]);
            // gates that are saturated by what is not finite may leave a state that is
            let seen = &x[k * n_seen..][..n_seen];
            let lost = state.iter().chain(seen).any(|h| !h.is_finite());
            if lost {
                state.fill(0.0);
            }
            self.begins[first + k] = u8::from(lost);
        }
        output.first(n_out)
    }
}

/// Rows `[x, h]` of rows of `x` and of `h`, so many numbers each.
fn join(x: &[f32], state: &[f32], [n_seen, n]: [usize; 2], to: &mut [f32]) {
    for ((to, x), state) in to.chunks_exact_mut(n_seen + n).zip(x.chunks_exact(n_seen)).zip(state.chunks_exact(n)) {
        to[..n_seen].copy_from_slice(x);
        to[n_seen..].copy_from_slice(state);
    }
}
