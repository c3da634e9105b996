//! A network that learns, with the target network that follows it (Mnih et al. 2015; by shares of the way, Lillicrap et al.
//! 2016).

use super::checkpoint::Tensors;
use super::nn::elementwise::{add, approach};
use super::nn::fold::OutputLayer;
use super::nn::{Adam, AdamConfig, Network, Transposed, Weights, clip_norm};
use super::state;
use base::error::{Error, Result};
use rng::Stream;

/// Weights that learn, and their copy that follows.
pub struct NetWithTarget {
    /// What learns.
    pub parameters: Vec<f32>,
    transposed: Transposed,
    adam: Adam,
    /// Its target network's; empty where there is none.
    pub following: Vec<f32>,
    gradient: Vec<f32>,
    output: OutputLayer,
    /// Of the last step, before it was clipped.
    pub gradient_norm: f64,
}

/// How far a step goes.
#[derive(Debug, Clone, Copy)]
pub struct Stride {
    /// Largest norm of the gradient.
    pub clip: f64,
    /// Learning rate.
    pub rate: f64,
    /// Share of the way to the weights that the target network goes.
    pub tau: f64,
}

/// Checks what learners with target networks have in common.
///
/// # Errors
/// [`Error::Value`] with the number, the rule and the remedy.
pub fn check_targets(discount: f64, tau: f64, max_grad_norm: f64, huber: f64) -> Result<()> {
    if !(0.0..1.0).contains(&discount) {
        return Err(Error::value("discount", discount, "within [0, 1)", "0.98 to 0.995 are usual."));
    }
    if !(tau > 0.0 && tau <= 1.0) {
        return Err(Error::value("tau", tau, "within (0, 1]", "0.002 to 0.05 are usual."));
    }
    for (what, x) in [("max_grad_norm", max_grad_norm), ("huber", huber)] {
        if x.is_nan() || x <= 0.0 {
            return Err(Error::value(what, x, "> 0", "10 is usual, inf is none."));
        }
    }
    Ok(())
}

impl NetWithTarget {
    /// From random weights; with a target network, if it `follows`.
    pub fn new(network: &dyn Network, adam: AdamConfig, follows: bool, stream: &mut Stream) -> Self {
        let mut net = Self {
            parameters: network.init(stream),
            transposed: Transposed::default(),
            adam: Adam::new(adam, network.n_parameter()),
            following: Vec::new(),
            gradient: vec![0.0; network.n_parameter()],
            output: OutputLayer::of(network),
            gradient_norm: 0.0,
        };
        if follows {
            net.following.clone_from(&net.parameters);
        }
        network.transpose(&net.parameters, &mut net.transposed);
        net
    }

    /// As backward passes take them.
    pub fn weights(&self) -> Weights<'_> {
        Weights { parameters: &self.parameters, transposed: &self.transposed }
    }

    /// Down the sum of `gradients`, folded in order; then the target network follows.
    pub fn descend<'a>(&mut self, network: &dyn Network, gradients: impl Iterator<Item = &'a [f32]>, stride: Stride) {
        self.gradient.fill(0.0);
        gradients.for_each(|own| add(&mut self.gradient, own));
        self.gradient_norm = clip_norm(&mut self.gradient, stride.clip);
        self.adam.descend(&mut self.parameters, &self.gradient, stride.rate);
        network.transpose(&self.parameters, &mut self.transposed);
        if !self.following.is_empty() {
            approach(&mut self.following, &self.parameters, stride.tau as f32);
        }
    }

    /// Begins with these weights.
    pub fn begin(&mut self, network: &dyn Network, parameters: Vec<f32>) {
        if !self.following.is_empty() {
            self.following.clone_from(&parameters);
        }
        self.parameters = parameters;
        network.transpose(&self.parameters, &mut self.transposed);
    }

    /// Says the same in other units, and its target network too.
    ///
    /// # Errors
    /// As [`OutputLayer::rescale`].
    pub fn rescale(&mut self, network: &dyn Network, of: impl Fn(usize) -> (f32, f32)) -> Result<()> {
        self.output.rescale(&mut self.parameters, &of)?;
        if !self.following.is_empty() {
            self.output.rescale(&mut self.following, &of)?;
        }
        network.transpose(&self.parameters, &mut self.transposed);
        Ok(())
    }

    /// As `<name>…`, `target.<name>…`.
    ///
    /// # Errors
    /// None for a name that is used once.
    pub fn save(&self, to: &mut Tensors, name: &str, network: &dyn Network) -> Result<()> {
        state::put_network(to, name, network, &self.parameters)?;
        if !self.following.is_empty() {
            state::put_network(to, &format!("target.{name}"), network, &self.following)?;
        }
        state::put_adam(to, name, &self.adam)
    }

    /// As saved.
    ///
    /// # Errors
    /// As [`Tensors::get`].
    pub fn load(&mut self, from: &Tensors, name: &str, network: &dyn Network) -> Result<()> {
        let parameters = state::network(from, name, network)?;
        if !self.following.is_empty() {
            self.following = state::network(from, &format!("target.{name}"), network)?;
        }
        self.adam = state::adam(from, name, self.adam.config, parameters.len())?;
        self.parameters = parameters;
        network.transpose(&self.parameters, &mut self.transposed);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Activation, Layers, Mlp};
    use rng::Purpose;

    /// θ̄ ← θ̄ + τ (θ − θ̄): what follows comes nearer, and what learns is not drawn to it.
    #[test]
    fn what_follows_goes_a_share_of_the_way_and_what_learns_stays() {
        let mlp = Mlp::new(2, &Layers { hidden: vec![], ..Layers::default() }, 1, Activation::Identity).unwrap();
        let mut stream = Stream::new(1, 0, 0, Purpose::LEARNING);
        let mut net = NetWithTarget::new(&mlp, AdamConfig::default(), true, &mut stream);
        assert_eq!(net.following, net.parameters);
        let n = mlp.n_parameter();
        let (learnt, nothing): (Vec<f32>, _) = ((0..n).map(|k| k as f32 - 20.0).collect(), vec![0.0; n]);
        net.parameters.clone_from(&learnt);
        net.following.fill(0.0);
        for share in [0.25, 0.4375] {
            net.descend(&mlp, [&nothing[..]].into_iter(), Stride { clip: 1.0, rate: 0.1, tau: 0.25 });
            assert_eq!(net.parameters, learnt);
            assert_eq!(net.following, learnt.iter().map(|x| share * x).collect::<Vec<f32>>());
        }
    }
}
