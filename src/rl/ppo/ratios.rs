//! What the agents that learnt before change for those that learn after: π/π_old of every row, as it stands then.

use crate::nn::Memory;
use crate::policy::{Actor, ROWS};
use crate::rollout::RolloutBatch;
use base::parallel::Threads;

/// Largest ratio, and one over the least: one row must not outweigh all others in the turns behind.
const MOST: f32 = 10.0;

/// Ratios of one agent's rows.
#[derive(Default)]
pub(super) struct Ratios {
    /// Of the rows that were asked of last.
    pub all: Vec<f32>,
    workers: Vec<Worker>,
}

struct Worker {
    memory: Memory,
    x: Vec<f32>,
}

impl Ratios {
    /// Those of `rows` of the rollout, all of the agent of set `set` of the parameters as they are now.
    pub fn find(
        &mut self,
        threads: &Threads,
        (actor, parameters, set): (&Actor, &[f32], usize),
        rollout: &RolloutBatch,
        rows: &[u32],
    ) {
        let (n_in, n_action) = (actor.n_observation(), actor.n_action());
        let (head, (network, extra)) = (actor.head_of(set), actor.set(parameters, set));
        // no row depends on which others go with it: as many parts as threads
        let of_part = rows.len().div_ceil(threads.count()).max(1);
        let missing = rows.len().div_ceil(of_part).saturating_sub(self.workers.len());
        let fresh = |_| Worker { memory: actor.mlp.memory(ROWS), x: vec![0.0; ROWS * n_in] };
        self.workers.extend((0..missing).map(fresh));
        self.all.resize(rows.len(), 1.0);
        let parts = rows.chunks(of_part).zip(self.all.chunks_mut(of_part)).zip(&mut self.workers);
        let mut parts: Vec<_> = parts.collect();
        threads.for_each(&mut parts, |_, ((rows, ratios), Worker { memory, x })| {
            for (rows, ratios) in rows.chunks(ROWS).zip(ratios.chunks_mut(ROWS)) {
                for (to, row) in x.chunks_exact_mut(n_in).zip(rows) {
                    to.copy_from_slice(&rollout.observation[*row as usize * n_in..][..n_in]);
                }
                let output = actor.mlp.forward(network, x, rows.len(), memory);
                for (k, (ratio, row)) in ratios.iter_mut().zip(rows).enumerate() {
                    let action = &rollout.action[*row as usize * n_action..][..n_action];
                    let log_ratio = head.log_prob(output.row(k), extra, action) - rollout.log_prob[*row as usize];
                    *ratio = log_ratio.exp().clamp(1.0 / MOST, MOST);
                }
            }
        });
    }
}
