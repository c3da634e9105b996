//! A batch of environments, cut into shards that one thread each steps from update to update.
//!
//! Between two updates of a policy its environments have nothing to do with each other. So the unit of work is not a step
//! of all of them, after which all threads wait, but a whole window of some: a [`Shard`]. Shards are cut by size alone and
//! folded in order, so that results are the same bits for any number of threads.

use super::learner::Episodes;
use crate::error::{Error, Result};
use crate::parallel::Threads;
use crate::tasks::{Autoreset, Buffers, Env, EnvConfig, Spec};

/// Makes environments of a configuration: of a built-in task `|config| Env::make("Hover", config)`, or of one's own
/// `|config| Env::of(Climb::new(config)?, "Climb", config)`.
pub type Make<'a> = dyn Fn(&EnvConfig) -> Result<Env> + 'a;

/// Environments of one shard.
pub(crate) struct Shard {
    pub env: Env,
    /// What the last step or reset wrote.
    pub out: Buffers,
}

/// `config.n_env` environments in shards of at most `size`, all reset, with `config.autoreset` in the same step.
///
/// # Errors
/// [`Error::Value`] for a size of 0; otherwise as `make`.
pub(crate) fn shards(make: &Make<'_>, config: &EnvConfig, size: usize) -> Result<Vec<Shard>> {
    if size == 0 {
        return Err(Error::value("shard", size, "≥ 1", "64 fits the blocks of environments."));
    }
    let one = Threads::new(1)?;
    let shard = |first: usize| {
        let own = EnvConfig {
            n_env: size.min(config.n_env - first),
            first_environment: config.first_environment + first as u64,
            autoreset: Autoreset::SameStep,
            ..config.clone()
        };
        let mut env = make(&own)?;
        env.set_threads(one.clone());
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out())?;
        Ok(Shard { env, out })
    };
    (0..config.n_env).step_by(size).map(shard).collect()
}

/// Figures of the episodes that ended in the step that wrote `out`.
pub(crate) fn episodes(spec: &Spec, out: &Buffers) -> Episodes {
    let column = |name: &str| spec.info_column(name).unwrap_or(0);
    let (width, total, length) = (spec.info.len(), column("return"), column("length"));
    let mut seen = Episodes::default();
    for (i, info) in out.info.chunks_exact(width).enumerate() {
        if out.terminated[i] | out.truncated[i] == 1 {
            seen.count += 1;
            seen.total_return += f64::from(info[total]);
            seen.total_length += f64::from(info[length]);
            seen.crashed += u64::from(out.terminated[i]);
        }
    }
    seen
}
