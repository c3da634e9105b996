//! What SAC and TD3 choose each for themselves.

use base::error::Result;
use rng::Stream;

/// What an algorithm of this kind chooses for itself.
pub trait Kind: Send + Sync {
    /// Numbers that the actor gives for an action of `n`; of the first n tanh is the action, or its middle.
    fn n_output(&self, n: usize) -> usize;

    /// An action to fly, of an agent of environment `environment`. Here and below an action may have fewer numbers than
    /// outputs are for, where agents are unlike: the first ones count.
    fn explore(&self, output: &[f32], environment: u64, noise: &mut Noise<'_>, action: &mut [f32]);

    /// An action to value, and what is added to its value.
    fn target_action(&self, output: &[f32], noise: &mut Noise<'_>, action: &mut [f32]) -> f32;

    /// An action to improve, and its ln π or 0.
    fn policy_action(&self, output: &[f32], noise: &[f32], action: &mut [f32]) -> f32;

    /// ∂/∂output of what is minimised, in units of `std`, where `grad_action` is that of −Q.
    fn output_gradient(&self, output: &[f32], noise: &[f32], std: f32, grad_action: &[f32], grad_output: &mut [f32]);

    /// How many of the critics the actor climbs, by the least of them.
    fn critics_of_actor(&self, critics: usize) -> usize;

    /// Most numbers of an action.
    fn most_action(&self) -> usize {
        usize::MAX
    }

    /// Whether values behind a step are those of an actor that follows slowly.
    fn has_target_actor(&self) -> bool;

    /// Behind a step of the actor whose mean ln π was `log_prob`.
    fn adapt(&mut self, _log_prob: f64) {}

    /// Figures for the log.
    fn figures(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    /// Numbers to go on from.
    fn save(&self) -> Vec<f64> {
        Vec::new()
    }

    /// As saved.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) for numbers that make no sense.
    fn load(&mut self, _saved: &[f64]) -> Result<()> {
        Ok(())
    }
}

/// Standard normal numbers.
pub struct Noise<'a> {
    pub(super) stream: &'a mut Stream,
    /// Numbers that stay the same for several steps, and ρ of what is drawn with them.
    pub(super) held: Option<(Stream, f64)>,
}

impl Noise<'_> {
    /// The next one: ξ, or √ρ ξ_held + √(1 − ρ) ξ.
    pub fn normal(&mut self) -> f32 {
        let own = self.stream.normal();
        let held = self.held.as_mut().map(|(held, rho)| rho.sqrt() * held.normal() + (1.0 - *rho).sqrt() * own);
        held.unwrap_or(own) as f32
    }
}
