//! Parts of learners as tensors of a checkpoint, and back.

use super::checkpoint::{Data, Tensors};
use super::nn::{Adam, AdamConfig, Network};
use super::policy::Actor;
use super::recall::Recall;
use super::shards::Shard;
use super::value_norm::ValueNorm;
use base::error::{Error, Result};

/// Most that a counter of a run can have come to: whole numbers that `f64` still counts.
const MOST: u64 = 1 << 53;

/// Beginnings of the names of what the built-in learners keep.
const OURS: [&str; 10] = [
    "actor.",
    "critic.",
    "learner.",
    "mixer.",
    "target.",
    "start",
    "value_norm",
    "rate_scale",
    "counters",
    "earlier_steps",
];

/// Refuses numbers that no run can have come to, whoever wrote them under a hash that fits: what is not finite, negative
/// squares, a rate's factor of nought or less, counters that would wrap. What environments look like is left to them: a
/// broken one is contained in its next step; and what algorithms from outside keep is left to those.
///
/// # Errors
/// [`Error::Value`] with the tensor, the number and the rule.
pub fn check_sense(tensors: &Tensors, file: &str) -> Result<()> {
    let ours = |name: &str| OURS.iter().any(|own| name.starts_with(own));
    for (name, tensor) in tensors.iter().filter(|(name, _)| ours(name)) {
        let positive = name == "rate_scale";
        let square = name.ends_with(".square") || name.ends_with(".variance");
        let senseless = |x: &f64| !x.is_finite() || square && *x < 0.0 || positive && *x <= 0.0;
        let found = match tensor.data() {
            Data::F32(values) => values.iter().map(|x| f64::from(*x)).find(senseless).map(|x| x.to_string()),
            Data::F64(values) => values.iter().copied().find(senseless).map(|x| x.to_string()),
            Data::U64(values) => values.iter().find(|x| **x > MOST).map(u64::to_string),
            Data::Bytes(_) => None,
        };
        if let Some(value) = found {
            let limit = match (positive, square, tensor.data()) {
                (.., Data::U64(_)) => "a count below 2^53",
                (true, ..) => "finite and > 0",
                (_, true, _) => "finite and ≥ 0",
                _ => "finite",
            };
            let remedy = "The checkpoint is damaged or forged: go on from an earlier one.";
            return Err(Error::value(format!("{file}: tensor {name}"), value, limit, remedy));
        }
    }
    Ok(())
}

/// The parts of a network, as `<name>.0.weight` and so on.
///
/// # Errors
/// None for a name that is used once, as all that put.
pub fn put_network(to: &mut Tensors, name: &str, mlp: &dyn Network, parameters: &[f32]) -> Result<()> {
    mlp.parts(parameters).into_iter().try_for_each(|p| to.insert(format!("{name}.{}", p.name), &p.shape, p.data))
}

/// The network that [`put_network`] put there.
///
/// # Errors
/// As [`Tensors::get`], as all that get.
pub fn network(from: &Tensors, name: &str, mlp: &dyn Network) -> Result<Vec<f32>> {
    mlp.from_parts(&mut |part, shape| Ok(from.get::<f32>(&format!("{name}.{part}"), shape)?.to_vec()))
}

/// The parameters of an actor: of each set the network, and `<name>.log_std` of its head.
///
/// # Errors
/// As [`put_network`].
pub fn put_actor(to: &mut Tensors, actor: &Actor, parameters: &[f32]) -> Result<()> {
    (0..actor.n_set()).try_for_each(|k| {
        let (name, (network, head)) = (actor.set_name(k), actor.set(parameters, k));
        put_network(to, &name, &actor.mlp, network)?;
        if head.is_empty() { Ok(()) } else { to.insert(format!("{name}.log_std"), &[head.len()], head.to_vec()) }
    })
}

/// The parameters that [`put_actor`] put there.
///
/// # Errors
/// As [`network`].
pub fn actor(from: &Tensors, actor: &Actor) -> Result<Vec<f32>> {
    let n_head = actor.head.n_extra();
    let mut parameters = Vec::with_capacity(actor.n_parameter());
    for name in (0..actor.n_set()).map(|k| actor.set_name(k)) {
        parameters.extend(network(from, &name, &actor.mlp)?);
        if n_head > 0 {
            parameters.extend_from_slice(from.get::<f32>(&format!("{name}.log_std"), &[n_head])?);
        }
    }
    Ok(parameters)
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

/// The scale of a critic.
///
/// # Errors
/// As [`put_network`].
pub fn put_value_norm(to: &mut Tensors, norm: &ValueNorm) -> Result<()> {
    to.insert("value_norm", &[4], norm.save().to_vec())
}

/// As [`put_value_norm`] saved it.
///
/// # Errors
/// As [`network`] and [`ValueNorm::load`].
pub fn load_value_norm(from: &Tensors, norm: &mut ValueNorm) -> Result<()> {
    let mut saved = [0.0; 4];
    saved.copy_from_slice(from.get::<f64>("value_norm", &[4])?);
    norm.load(saved)
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

/// What a policy remembers of the environments of every shard; nothing without memory.
///
/// # Errors
/// As [`put_network`].
pub fn put_recalls<'a>(to: &mut Tensors, recalls: impl Iterator<Item = &'a Recall>) -> Result<()> {
    for (k, recall) in recalls.enumerate().filter(|(_, recall)| !recall.state.is_empty()) {
        to.insert(format!("shard.{k}.memory"), &[recall.state.len()], recall.state.clone())?;
        to.insert(format!("shard.{k}.begins"), &[recall.begins.len()], recall.begins.clone())?;
    }
    Ok(())
}

/// Puts memories into the state that [`put_recalls`] saved.
///
/// # Errors
/// As [`network`].
pub fn load_recalls<'a>(from: &Tensors, recalls: impl Iterator<Item = &'a mut Recall>) -> Result<()> {
    for (k, recall) in recalls.enumerate().filter(|(_, recall)| !recall.state.is_empty()) {
        let state = from.get::<f32>(&format!("shard.{k}.memory"), &[recall.state.len()])?;
        let begins = from.get::<u8>(&format!("shard.{k}.begins"), &[recall.begins.len()])?;
        recall.state.copy_from_slice(state);
        recall.begins.copy_from_slice(begins);
    }
    Ok(())
}

/// Puts shards into the state that [`put_shards`] saved.
///
/// # Errors
/// As [`network`] and [`Env::load`](tasks::Env::load).
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
