//! Parts of learners as tensors of a checkpoint, and back.

use super::checkpoint::Tensors;
use super::nn::{Adam, AdamConfig, Mlp};
use super::shards::Shard;
use crate::error::Result;

/// The parts of a network, as `<name>.0.weight` and so on.
///
/// # Errors
/// None for a name that is used once, as all that put.
pub fn put_network(to: &mut Tensors, name: &str, mlp: &Mlp, parameters: &[f32]) -> Result<()> {
    mlp.parts(parameters).into_iter().try_for_each(|p| to.insert(format!("{name}.{}", p.name), &p.shape, p.data))
}

/// The network that [`put_network`] put there.
///
/// # Errors
/// As [`Tensors::get`], as all that get.
pub fn network(from: &Tensors, name: &str, mlp: &Mlp) -> Result<Vec<f32>> {
    mlp.from_parts(|part, shape| Ok(from.get::<f32>(&format!("{name}.{part}"), shape)?.to_vec()))
}

/// The state of an optimiser, as `<name>.adam.mean` and so on.
///
/// # Errors
/// As [`put_network`].
pub fn put_adam(to: &mut Tensors, name: &str, adam: &Adam) -> Result<()> {
    let n = adam.mean.len();
    to.insert(format!("{name}.adam.mean"), &[n], adam.mean.clone())?;
    to.insert(format!("{name}.adam.square"), &[n], adam.square.clone())?;
    to.insert(format!("{name}.adam.step"), &[1], vec![adam.step])
}

/// The optimiser of `n` parameters that [`put_adam`] put there.
///
/// # Errors
/// As [`network`].
pub fn adam(from: &Tensors, name: &str, config: AdamConfig, n: usize) -> Result<Adam> {
    let rows = |what: &str| Ok(from.get::<f32>(&format!("{name}.adam.{what}"), &[n])?.to_vec());
    let step = from.get::<u64>(&format!("{name}.adam.step"), &[1])?[0];
    Ok(Adam { config, mean: rows("mean")?, square: rows("square")?, step })
}

/// `N` whole numbers under one name.
///
/// # Errors
/// As [`put_network`].
pub fn put_counters<const N: usize>(to: &mut Tensors, counters: [u64; N]) -> Result<()> {
    to.insert("counters", &[N], counters.to_vec())
}

/// The numbers that [`put_counters`] put there.
///
/// # Errors
/// As [`network`].
pub fn counters<const N: usize>(from: &Tensors) -> Result<[u64; N]> {
    let mut counters = [0; N];
    counters.copy_from_slice(from.get::<u64>("counters", &[N])?);
    Ok(counters)
}

/// The environments of every shard, and what their policy sees next.
///
/// # Errors
/// As [`put_network`].
pub fn put_shards<'a>(to: &mut Tensors, shards: impl Iterator<Item = &'a Shard>) -> Result<()> {
    for (k, shard) in shards.enumerate() {
        let bytes = shard.env.save();
        to.insert(format!("shard.{k}.environments"), &[bytes.len()], bytes)?;
        let seen = shard.out.observation.clone();
        to.insert(format!("shard.{k}.observation"), &[seen.len()], seen)?;
        let central = shard.out.central.clone();
        to.insert(format!("shard.{k}.central"), &[central.len()], central)?;
        if !shard.out.privileged.is_empty() {
            let privileged = shard.out.privileged.clone();
            to.insert(format!("shard.{k}.privileged"), &[privileged.len()], privileged)?;
        }
    }
    Ok(())
}

/// Puts shards into the state that [`put_shards`] saved.
///
/// # Errors
/// As [`network`] and [`Env::load`](crate::tasks::Env::load).
pub fn load_shards<'a>(from: &Tensors, shards: impl Iterator<Item = &'a mut Shard>) -> Result<()> {
    for (k, shard) in shards.enumerate() {
        let name = format!("shard.{k}.environments");
        let n = from.tensor(&name)?.shape().iter().product();
        let n_seen = shard.out.observation.len();
        let seen = from.get::<f32>(&format!("shard.{k}.observation"), &[n_seen])?;
        let central = from.get::<f32>(&format!("shard.{k}.central"), &[shard.out.central.len()])?;
        let known = shard.out.privileged.len();
        // learners whose critics see none may go on without
        let privileged = from.get::<f32>(&format!("shard.{k}.privileged"), &[known]);
        shard.env.load(from.get::<u8>(&name, &[n])?)?;
        if let Ok(privileged) = privileged {
            shard.out.privileged.copy_from_slice(privileged);
        }
        shard.out.observation.copy_from_slice(seen);
        shard.out.central.copy_from_slice(central);
    }
    Ok(())
}
