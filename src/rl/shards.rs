//! A batch of environments, cut into shards that one thread each steps from update to update.
//!
//! Between two updates of a policy its environments have nothing to do with each other. So the unit of work is not a step
//! of all of them, after which all threads wait, but a whole window of some: a shard. Shards are cut by size alone and
//! folded in order, so that results are the same bits for any number of threads.

use super::learner::{Episodes, Make};
use base::error::{Error, Result};
use base::memory::Request;
use base::parallel::Threads;
use std::fmt::Display;
use tasks::env::PendingStatistics;
use tasks::{Autoreset, Buffers, Column, Env, EnvConfig, ObservationTransform, Spec, Statistics};

/// Most shards of a batch: each has tensors of its own in a checkpoint.
const MAX_SHARDS: usize = 2048;

/// Columns of the information that learners read.
const READ: [Column; 5] = [Column::Return, Column::Length, Column::Reason, Column::Success, Column::Loss];

/// Environments of one shard.
pub struct Shard {
    /// The environments.
    pub env: Env,
    /// What the last step or reset wrote.
    pub out: Buffers,
}

/// `config.n_env` environments in shards of at most `size`, all reset, with `config.autoreset` in the same step. They tell what
/// learners read (`return`, `length`, `reason`, `success`, `loss`) and what else `config.info` names.
///
/// # Errors
/// [`Error::Value`] for a size of 0, [`Error::Limit`] if all of them need too much memory; otherwise as `make`.
pub fn shards(make: &Make<'_>, config: &EnvConfig, size: usize) -> Result<Vec<Shard>> {
    shards_if(make, config, size, |_, _| Ok(()))
}

/// As [`shards`], once `fits` finds that the first of so many leaves room for what else is needed: a refusal takes one shard's
/// time and memory.
pub(crate) fn shards_if(
    make: &Make<'_>,
    config: &EnvConfig,
    size: usize,
    fits: impl FnOnce(&Env, usize) -> Result<()>,
) -> Result<Vec<Shard>> {
    if size == 0 {
        return Err(Error::value("shard", size, "≥ 1", "64 fits the blocks of environments."));
    }
    if config.n_env.div_ceil(size) > MAX_SHARDS {
        let n = config.n_env.div_ceil(size);
        return Err(Error::limit("shards, n_env/shard", n, MAX_SHARDS, "Take larger shards."));
    }
    let one = Threads::new(1)?;
    let mut info = config.info.clone().unwrap_or_default();
    info.extend(READ.map(|column| column.name().into()));
    let shard = |first: usize| {
        let own = EnvConfig {
            n_env: size.min(config.n_env - first),
            first_environment: config.first_environment.wrapping_add(first as u64),
            autoreset: Autoreset::SameStep,
            info: Some(info.clone()),
            ..config.clone()
        };
        let mut env = make(&own)?;
        env.set_threads(one.clone());
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out())?;
        Ok(Shard { env, out })
    };
    let n = config.n_env.div_ceil(size).max(1);
    let first = shard(0)?;
    let spec = first.env.spec();
    let bytes = spec.bytes_per_env as u128 * spec.n_env as u128 * n as u128;
    within_memory("n_env", config.n_env, bytes, config.memory_limit)?;
    fits(&first.env, n)?;
    std::iter::once(Ok(first)).chain((1..n).map(|k| shard(k * size))).collect()
}

/// Whether what is about to be made fits.
///
/// # Errors
/// [`Error::Limit`] if `bytes` are above `limit`.
pub(crate) fn within_memory(what: &str, value: impl Display, bytes: u128, limit: u64) -> Result<()> {
    let less = "Take fewer environments or steps";
    Request { what, value, bytes, limit, setting: "env.memory_limit", less }.check(|_| String::new())
}

/// Takes what all shards saw into their normalisers, in order; sums that are not finite are left out. Without a stage
/// `normalise` it does nothing.
///
/// # Errors
/// None for shards of one configuration.
pub fn normalise(shards: &mut [&mut Shard]) -> Result<()> {
    let Some(mut statistics) = shards.first().map(|shard| shard.env.statistics().clone()) else { return Ok(()) };
    if statistics.mean.is_empty() {
        return Ok(());
    }
    if let Some(PendingStatistics { count, sums, squares }) = &pending(shards)? {
        statistics.merge(*count, sums, squares);
    }
    for Shard { env, out } in shards {
        env.set_statistics(statistics.clone())?;
        env.set_collecting(true);
        env.observe(&mut out.out())?;
    }
    Ok(())
}

/// Takes out what all shards collected about their mean in force, in order; sums that are not finite are left out.
pub(crate) fn pending(shards: &mut [&mut Shard]) -> Result<Option<PendingStatistics>> {
    let mut all: Option<PendingStatistics> = None;
    for shard in shards.iter_mut() {
        let own = shard.env.take_pending();
        if !own.sums.iter().chain(&own.squares).all(|x| x.is_finite()) {
            continue;
        }
        match &mut all {
            Some(all) => all.add(&own)?,
            None => all = Some(own),
        }
    }
    Ok(all.filter(|all| all.count > 0.0))
}

/// The environments as a policy sees them: with a stage `normalise` behind all others, where `wanted` and there is none.
pub(crate) fn with_normaliser(env: &EnvConfig, wanted: bool) -> EnvConfig {
    let mut env = env.clone();
    if wanted && !env.observation.iter().any(|stage| matches!(stage, ObservationTransform::Normalise { .. })) {
        env.observation.push(ObservationTransform::Normalise { clip: 10.0 });
    }
    env
}

/// The difficulty of episodes that begin from now on.
///
/// # Errors
/// As [`Env::set_difficulty`].
pub(crate) fn set_difficulty<'a>(shards: impl Iterator<Item = &'a mut Shard>, share: f64) -> Result<()> {
    for shard in shards {
        shard.env.set_difficulty(share)?;
    }
    Ok(())
}

/// Statistics of a policy that was trained before, if it has some, for the stage `normalise` where there is one.
///
/// # Errors
/// As [`Env::set_statistics`].
pub(crate) fn begin_statistics<'a>(
    shards: impl Iterator<Item = &'a mut Shard>,
    known: Option<&Statistics>,
) -> Result<()> {
    let Some(statistics) = known else { return Ok(()) };
    for Shard { env, out } in shards {
        if !env.statistics().mean.is_empty() {
            env.set_statistics(statistics.clone())?;
            env.set_collecting(true);
            env.observe(&mut out.out())?;
        }
    }
    Ok(())
}

/// Figures of the episodes that ended in the step that wrote `out`.
///
/// # Errors
/// [`Error::Value`] for environments that leave out their returns, lengths or successes.
pub fn episodes(spec: &Spec, out: &Buffers) -> Result<Episodes> {
    let width = spec.info.len();
    let (total, length) = (spec.needed_column(Column::Return)?, spec.needed_column(Column::Length)?);
    let success = spec.needed_column(Column::Success)?;
    let mut seen = Episodes::default();
    for (i, info) in out.info.chunks_exact(width).enumerate() {
        if out.terminated[i] | out.truncated[i] == 1 {
            seen.count += 1;
            // a number that is not finite is one environment's, not the mean's
            seen.total_return += f64::from(if info[total].is_finite() { info[total] } else { 0.0 });
            seen.total_length += f64::from(info[length]);
            seen.crashed += u64::from(out.terminated[i]);
            seen.succeeded += u64::from(out.terminated[i] == 0 && info[success] > 0.5);
        }
    }
    Ok(seen)
}
