//! An actor that goes down exact gradients, and begins again where it fell off a cliff: what APG and SHAC share.
//!
//! Too high a learning rate saturates the network: its hidden units stand at ±1, gradients vanish, and it never recovers.
//! Where the share of such units passes a limit, the weights are drawn again and the rate is halved.

use super::checkpoint::Tensors;
use super::checks::check_positive;
use super::nn::{Adam, AdamConfig, Transposed, Weights, clip_norm};
use super::policy::{Actor, Policy};
use super::state;
use super::warm_start::WarmStart;
use base::error::{Error, Result};
use rng::{Purpose, Stream};
use tasks::Env;

/// Most times that a run begins again: where it saturates at a sixty-fourth of the rate, the rate is not the cause.
pub(crate) const MAX_RESTARTS: u64 = 6;

/// Name of the first weights in a checkpoint.
const START: &str = "actor.start";

/// Weights on their way down.
pub struct PolicyOptimiser {
    /// The policy's shape.
    pub actor: Actor,
    parameters: Vec<f32>,
    transposed: Transposed,
    adam: Adam,
    /// Of what is minimised, with respect to the parameters.
    pub gradient: Vec<f32>,
    seed: u64,
    /// First weights; empty for random ones.
    start: Vec<f32>,
    /// Times it began again.
    pub restarts: u64,
}

impl PolicyOptimiser {
    /// From random weights.
    pub fn new(actor: Actor, adam: AdamConfig, seed: u64) -> Self {
        let n = actor.n_parameter();
        let (parameters, transposed) = (Vec::new(), Transposed::default());
        let mut optimiser = Self {
            adam: Adam::new(adam, n),
            gradient: vec![0.0; n],
            actor,
            parameters,
            transposed,
            seed,
            start: Vec::new(),
            restarts: 0,
        };
        optimiser.begin();
        optimiser
    }

    /// Begins with other weights than random ones, also where it begins again.
    ///
    /// # Errors
    /// [`Error::Value`] for another number of weights.
    pub fn warm_start(&mut self, start: &WarmStart) -> Result<()> {
        start.check(&self.actor)?;
        self.start.clone_from(&start.parameters);
        self.start.resize(self.actor.n_parameter(), 0.0);
        self.begin();
        Ok(())
    }

    /// What a network of this run draws its weights from: number 0 is the actor's. Shuffles of minibatches have the streams
    /// of their updates, from number 2; those of restarts are counted from the top.
    pub fn stream(&self, network: u64) -> Stream {
        let number = if self.restarts == 0 { network } else { u64::MAX - 2 * self.restarts - network };
        Stream::new(self.seed, 0, number, Purpose::LEARNING)
    }

    fn begin(&mut self) {
        if self.start.is_empty() {
            self.parameters = self.actor.mlp.init(&mut self.stream(0));
            self.parameters.resize(self.actor.n_parameter(), 0.0);
        } else {
            self.parameters.clone_from(&self.start);
        }
        self.adam = Adam::new(self.adam.config, self.parameters.len());
        self.actor.mlp.transpose(&self.parameters, &mut self.transposed);
    }

    /// As networks take them.
    pub fn net(&self) -> Weights<'_> {
        Weights { parameters: &self.parameters, transposed: &self.transposed }
    }

    /// A learning rate, halved by every restart.
    pub fn rate(&self, scheduled: f64) -> f64 {
        scheduled * 0.5_f64.powi(self.restarts.min(60) as i32)
    }

    /// One step along the gradient, cut to the norm `max_grad_norm`; gives its norm from before.
    pub fn descend(&mut self, max_grad_norm: f64, rate: f64) -> f64 {
        let norm = clip_norm(&mut self.gradient, max_grad_norm);
        self.adam.descend(&mut self.parameters, &self.gradient, rate);
        self.actor.mlp.transpose(&self.parameters, &mut self.transposed);
        norm
    }

    /// Begins again if more than the share `limit` of hidden units is saturated; 1 for never. Gives whether it did.
    pub fn restart_if_saturated(&mut self, saturated: f64, limit: f64) -> bool {
        let restarts = saturated > limit && limit < 1.0 && self.restarts < MAX_RESTARTS;
        if restarts {
            self.restarts += 1;
            self.begin();
        }
        restarts
    }

    /// The policy as it is, behind the statistics of `env`.
    ///
    /// # Errors
    /// As [`Policy::new`].
    pub fn policy(&self, env: &Env) -> Result<Policy> {
        Policy::of(&self.actor, &self.parameters, env)
    }

    /// Weights into `policy`, what goes on into `out`.
    ///
    /// # Errors
    /// None for names that are used once.
    pub fn save(&self, policy: &mut Tensors, out: &mut Tensors) -> Result<()> {
        state::put_network(policy, "actor", &self.actor.mlp, &self.parameters)?;
        if !self.start.is_empty() {
            out.insert(START, &[self.start.len()], self.start.clone())?;
        }
        state::put_adam(out, "actor", &self.adam)
    }

    /// Whether it begins with the weights that a checkpoint's run began with.
    ///
    /// # Errors
    /// As [`Tensors::get`].
    pub fn begins_as(&self, from: &Tensors) -> Result<bool> {
        Ok(from.get::<f32>(START, &[self.start.len()])?[..] == self.start[..])
    }

    /// As saved; `restarts` is the caller's to count.
    ///
    /// # Errors
    /// As [`Tensors::get`].
    pub fn load(&mut self, policy: &Tensors, from: &Tensors, restarts: u64) -> Result<()> {
        let mut parameters = state::network(policy, "actor", &self.actor.mlp)?;
        parameters.resize(self.actor.n_parameter(), 0.0);
        self.adam = state::adam(from, "actor", self.adam.config, parameters.len())?;
        if from.tensor(START).is_ok() {
            self.start = from.get::<f32>(START, &[parameters.len()])?.to_vec();
        }
        (self.parameters, self.restarts) = (parameters, restarts);
        self.actor.mlp.transpose(&self.parameters, &mut self.transposed);
        Ok(())
    }
}

/// Checks what both have as settings.
///
/// # Errors
/// [`Error::Value`] with the number, the rule and the remedy.
pub(crate) fn check_optimiser(max_grad_norm: f64, decay: f32, clips: [f32; 2], saturation: f64) -> Result<()> {
    let numbers = [("max_grad_norm", max_grad_norm), ("decay", decay.into()), ("saturation", saturation)];
    check_positive(&numbers, "0.2, 1 and 0.25 are usual.")?;
    for (what, clip) in ["adjoint_clip", "action_clip"].into_iter().zip(clips) {
        if clip.is_nan() || clip <= 0.0 {
            return Err(Error::value(what, clip, "> 0", "10 to 1000 are usual, inf is none."));
        }
    }
    Ok(())
}
