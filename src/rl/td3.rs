//! TD3: twin delayed deterministic policy gradients (Fujimoto et al. 2018); with one critic, no delay and no smoothing DDPG
//! (Lillicrap et al. 2016), for teams with a central critic MATD3 and MADDPG (Lowe et al. 2017).
//!
//! The policy is tanh of the network's outputs. It is flown with noise, of another scale in every environment (Seo et al. 2025), and
//! valued with noise that is cut: values of neighbouring actions are to be alike.
//!
//! The loop is that of [`ActorCritic`]. What TD3 chooses in it stands below, in the order in which the loop asks:
//! 1. it explores with tanh π(o) and noise;
//! 2. targets value tanh π̄(o') of the slowly following actor and cut noise (`target_action`); the actor goes down −Q₁(o, tanh π(o))
//!    (`policy_action`, `output_gradient`).

use super::actor_critic::{ActorCritic, ActorCriticConfig, Exploration, Kind, Noise};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Settings.
pub type Td3Config = ActorCriticConfig<ActionNoise>;

/// Twin delayed deterministic policy gradients, in the middle of a run.
pub type Td3 = ActorCritic<ActionNoise>;

with_defaults! {
    /// Noise on actions, which are within ±1.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ActionNoise {
        /// Least and largest standard deviation σ of the noise on flown actions; environments lie evenly between them. Each
        /// within [0, 10]; default 0.05 and 0.3.
        pub noise: [f64; 2] = [0.05, 0.3],
        /// σ of the noise on the action whose value a target takes. Within [0, 10]; default 0.2.
        pub target_noise: f64 = 0.2,
        /// Largest size of that noise. Within [0, 10]; default 0.5.
        pub noise_clip: f64 = 0.5,
    }
}

impl Exploration for ActionNoise {
    type Kind = Self;
    const NAME: &'static str = "td3";
    const ACTOR_DELAY: usize = 2;
    // critics that know nothing yet drive the actor into a corner of its range, from which tanh leaves no way; where this is not
    // enough, `saturation_penalty` is
    const WARM_UP: f64 = 0.1;

    fn validate(&self) -> Result<()> {
        let all = [
            ("exploration.noise", self.noise[0]),
            ("exploration.noise", self.noise[1]),
            ("exploration.target_noise", self.target_noise),
            ("exploration.noise_clip", self.noise_clip),
        ];
        for (what, x) in all {
            if !(0.0..=10.0).contains(&x) {
                return Err(Error::value(what, x, "within [0, 10]", "[0.05, 0.3], 0.2 and 0.5 are usual."));
            }
        }
        if self.noise[0] > self.noise[1] {
            let value = format!("{:?}", self.noise);
            return Err(Error::value("exploration.noise", value, "the lesser one first", "Exchange them."));
        }
        Ok(())
    }

    fn kind(&self, _: f64) -> Self {
        self.clone()
    }
}

/// Its multiples lie evenly between whole numbers.
const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;

impl Kind for ActionNoise {
    fn n_output(&self, n: usize) -> usize {
        n
    }

    fn explore(&self, output: &[f32], environment: u64, noise: &mut Noise<'_>, action: &mut [f32]) {
        let [least, most] = self.noise;
        let scale = (least + (most - least) * (environment as f64 * GOLDEN_RATIO).fract()) as f32;
        for (a, y) in action.iter_mut().zip(output) {
            *a = (y.tanh() + scale * noise.normal()).clamp(-1.0, 1.0);
        }
    }

    fn target_action(&self, output: &[f32], noise: &mut Noise<'_>, action: &mut [f32]) -> f32 {
        let (scale, cut) = (self.target_noise as f32, self.noise_clip as f32);
        for (a, y) in action.iter_mut().zip(output) {
            *a = (y.tanh() + (scale * noise.normal()).clamp(-cut, cut)).clamp(-1.0, 1.0);
        }
        0.0
    }

    fn policy_action(&self, output: &[f32], _: &[f32], action: &mut [f32]) -> f32 {
        action.iter_mut().zip(output).for_each(|(a, y)| *a = y.tanh());
        0.0
    }

    fn output_gradient(&self, output: &[f32], _: &[f32], _: f32, grad_action: &[f32], grad_output: &mut [f32]) {
        for ((own, slope), y) in grad_output.iter_mut().zip(grad_action).zip(output) {
            *own = slope * (1.0 - y.tanh().powi(2));
        }
    }

    fn critics_of_actor(&self, _: usize) -> usize {
        1
    }

    fn has_target_actor(&self) -> bool {
        true
    }
}
