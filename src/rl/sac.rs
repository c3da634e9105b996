//! SAC: soft actor-critic (Haarnoja et al. 2018), its temperature held by an entropy (their "Applications", section 5).
//!
//! The policy is a Gaussian behind tanh and maximises Σ γᵗ (r + α H(π)). ln α goes down ln α · (H − H̄): it falls where the policy
//! is more random than H̄ asks for. What flies is the middle of the distribution, tanh μ.
//!
//! The loop is that of [`ActorCritic`]. What SAC chooses in it stands below, in the order in which the loop asks:
//! 1. it explores with a draw from π(·|o);
//! 2. targets value a draw a' from π(·|o') and add −α ln π(a'|o') (`target_action`); the actor goes down α ln π(a|o) − minᵢ Qᵢ(o, a)
//!    with a = tanh(μ + σ ε) (`policy_action`, `output_gradient`); α follows the entropy (`adapt`).

use super::actor_critic::{ActorCritic, ActorCriticConfig, Exploration, Kind, Noise};
use super::nn::tanh_gaussian::{draw, pull};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Settings.
pub type SacConfig = ActorCriticConfig<Entropy>;

/// Soft actor-critic, in the middle of a run.
pub type Sac = ActorCritic<Entropy>;

with_defaults! {
    /// How random the policy is.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Entropy {
        /// H̄ for each number of an action, nats: −1 leaves a deviation of about 0.09, e^H̄/√(2πe). Default −1.
        pub target: f64 = -1.0,
        /// α at the start, the weight of entropy against reward. Default 0.1.
        pub temperature: f64 = 0.1,
        /// Learning rate of ln α; 0 leaves it as it is. ≥ 0; default 1e-3.
        pub learning_rate: f64 = 1e-3,
    }
}

impl Exploration for Entropy {
    type Kind = Temperature;
    const NAME: &'static str = "sac";
    const ACTOR_DELAY: usize = 1;
    const WARM_UP: f64 = 0.0;

    fn validate(&self) -> Result<()> {
        if !self.target.is_finite() {
            return Err(Error::value("exploration.target", self.target, "finite", "-1 is usual."));
        }
        let (least, most) = RANGE;
        if !(least.exp()..=most.exp()).contains(&self.temperature) {
            let limit = format!("within [{:.1e}, {:.0}]", least.exp(), most.exp());
            return Err(Error::value("exploration.temperature", self.temperature, limit, "0.01 to 1 are usual."));
        }
        if !(self.learning_rate.is_finite() && self.learning_rate >= 0.0) {
            let rate = self.learning_rate;
            return Err(Error::value("exploration.learning_rate", rate, "finite and ≥ 0", "1e-3 is usual."));
        }
        Ok(())
    }

    fn kind(&self, n: f64) -> Temperature {
        Temperature {
            log_alpha: self.temperature.ln(),
            target: self.target * n,
            rate: self.learning_rate,
            entropy: 0.0,
        }
    }
}

/// Of ln α.
const RANGE: (f64, f64) = (-14.0, 5.0);

/// α, which weighs randomness against reward.
#[derive(Debug, Clone, PartialEq)]
pub struct Temperature {
    log_alpha: f64,
    /// H̄, summed over an action's numbers.
    target: f64,
    rate: f64,
    /// H of the last batch.
    entropy: f64,
}

impl Temperature {
    /// α, at present.
    pub fn alpha(&self) -> f64 {
        self.log_alpha.exp()
    }
}

/// Standard normal numbers for `action`.
fn normal<'a>(noise: &mut Noise<'_>, of: &'a mut [f32; MAX_ACTION], n: usize) -> &'a [f32] {
    of[..n].iter_mut().for_each(|e| *e = noise.normal());
    &of[..n]
}

/// Numbers of an action whose noise stands on the stack.
const MAX_ACTION: usize = 64;

impl Kind for Temperature {
    fn n_output(&self, n: usize) -> usize {
        2 * n
    }

    fn most_action(&self) -> usize {
        MAX_ACTION
    }

    fn explore(&self, output: &[f32], _: u64, noise: &mut Noise<'_>, action: &mut [f32]) {
        let mut own = [0.0; MAX_ACTION];
        let n = action.len();
        draw(output, normal(noise, &mut own, n), action);
    }

    fn target_action(&self, output: &[f32], noise: &mut Noise<'_>, action: &mut [f32]) -> f32 {
        let mut own = [0.0; MAX_ACTION];
        let n = action.len();
        -(self.alpha() as f32) * draw(output, normal(noise, &mut own, n), action)
    }

    fn policy_action(&self, output: &[f32], noise: &[f32], action: &mut [f32]) -> f32 {
        draw(output, noise, action)
    }

    fn output_gradient(&self, output: &[f32], noise: &[f32], std: f32, grad_action: &[f32], grad_output: &mut [f32]) {
        pull(output, noise, self.alpha() / f64::from(std), grad_action, grad_output);
    }

    fn critics_of_actor(&self, critics: usize) -> usize {
        critics
    }

    fn has_target_actor(&self) -> bool {
        false
    }

    fn adapt(&mut self, log_prob: f64) {
        if log_prob.is_finite() {
            self.entropy = -log_prob;
            let down = self.log_alpha - self.rate * (self.entropy - self.target).clamp(-10.0, 10.0);
            self.log_alpha = down.clamp(RANGE.0, RANGE.1);
        }
    }

    fn figures(&self) -> Vec<(&'static str, f64)> {
        vec![("temperature", self.alpha()), ("entropy", self.entropy)]
    }

    fn save(&self) -> Vec<f64> {
        vec![self.log_alpha, self.entropy]
    }

    fn load(&mut self, saved: &[f64]) -> Result<()> {
        let [log_alpha, entropy] = [saved[0], saved[1]];
        if !((RANGE.0..=RANGE.1).contains(&log_alpha) && entropy.is_finite()) {
            let remedy = "The checkpoint is damaged or forged: go on from an earlier one.";
            return Err(Error::value("ln temperature", log_alpha, format!("within {RANGE:?}"), remedy));
        }
        (self.log_alpha, self.entropy) = (log_alpha, entropy);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ln α goes down ln α · (H − H̄), by its rate times the entropy that is too much.
    #[test]
    fn the_temperature_falls_where_the_policy_is_more_random_than_asked_and_rises_where_less() {
        let exploration = Entropy { target: -1.0, temperature: 0.2, learning_rate: 0.01 };
        for (log_prob, too_much) in [(-0.5, 2.5), (2.0, 0.0), (3.0, -1.0)] {
            let mut own = exploration.kind(2.0);
            own.adapt(log_prob);
            let wanted = 0.2 * f64::exp(-0.01 * too_much);
            assert!((own.alpha() - wanted).abs() < 1e-12, "{log_prob}: {} {wanted}", own.alpha());
        }
        let mut own = exploration.kind(2.0);
        own.adapt(f64::NAN);
        assert_eq!(own, exploration.kind(2.0), "what is not finite moves nothing");
    }
}
