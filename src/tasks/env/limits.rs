//! Whether a batch fits into memory: found from sizes, before anything large is allocated.

use super::block::Sizes;
use crate::dynamics::batch::Plant;
use crate::error::{Error, Result};

/// Bytes that one environment keeps between steps.
pub(crate) fn bytes_per_env(plant: &Plant, s: &Sizes) -> usize {
    let numbers = if s.theta > 0 { plant.n_number() } else { 0 };
    let rows = plant.n_row() + numbers + s.episode_state() + s.goal + s.task_state + s.theta + s.air;
    (rows + s.delay * s.command + s.history) * size_of::<f32>() + 2 * size_of::<u64>()
}

/// Bytes of one environment's rows in [`Buffers`](super::Buffers).
pub(crate) fn out_bytes(s: &Sizes) -> usize {
    let floats = 2 * s.agent * s.observation + s.agent + 2 * s.central + s.theta + s.info() + s.action;
    floats * size_of::<f32>() + 2
}

/// Refuses what does not fit.
pub(crate) fn check_memory(n_env: usize, bytes: usize, limit: u64) -> Result<()> {
    let needed = n_env as u128 * bytes as u128;
    if n_env > 0 && needed <= u128::from(limit) {
        return Ok(());
    }
    let gib = |x: f64| x / f64::from(1 << 30);
    Err(Error::limit(
        "n_env",
        format!("{n_env} ({:.1} GiB)", gib(needed as f64)),
        format!("1 to {} ({:.1} GiB)", limit / bytes as u64, gib(limit as f64)),
        "Step fewer environments at once, or raise memory_limit.",
    ))
}
