//! Whether a batch fits into memory: found from sizes, before anything large is allocated.

use super::block::Sizes;
use base::error::Result;
use base::memory::{Request, none_asked};
use dynamics::batch::{BatchPlant, RawBreach};

/// Bytes of what a controller tracks, about: the pieces of a path.
const REFERENCE: usize = 2048;

/// Bytes that one environment keeps between steps.
pub(crate) fn bytes_per_env(plant: &BatchPlant, s: &Sizes) -> usize {
    let numbers = if s.theta > 0 { plant.n_number() } else { 0 };
    let rows = plant.n_row() + numbers + s.episode_state() + s.goal + s.task_state + s.theta + s.air;
    let reference = if s.beginning > 0 { REFERENCE } else { 0 };
    let fixed = 2 * size_of::<u64>() + size_of::<Option<RawBreach>>();
    (rows + s.delay * s.command + s.history + s.agent * s.reading + s.estimate + s.beginning) * size_of::<f32>()
        + fixed
        + reference
}

/// Bytes of one environment's rows in [`Buffers`](super::Buffers).
pub(crate) fn out_bytes(s: &Sizes) -> usize {
    let floats = 2 * s.agent * s.observation + s.agent + 2 * s.central + s.theta + s.info + s.action;
    floats * size_of::<f32>() + 2
}

/// Refuses what does not fit.
pub(crate) fn check_memory(n_env: usize, bytes: usize, limit: u64) -> Result<()> {
    if n_env == 0 {
        return Err(none_asked(limit));
    }
    let needed = n_env as u128 * bytes as u128;
    let less = "Step fewer environments at once";
    let request = Request { what: "n_env", value: n_env, bytes: needed, limit, setting: "memory_limit", less };
    request.check(|limit| format!("1 to {}", limit / bytes as u64))
}
