//! Settings that are known to train a task, one line each.
//!
//! A recipe is TOML over the defaults of [`TrainConfig`](super::config::TrainConfig); a user's file goes over the recipe.
//! The first recipe of a task is that of its usual algorithm; where a pair of task and algorithm has none, the defaults
//! hold.

use super::config::Algorithm;

/// Task, algorithm, and what differs from the defaults.
pub static RECIPES: &[(&str, Algorithm, &str)] = &[
    ("Hover", Algorithm::Apg, ""),
    ("Track", Algorithm::Apg, "[apg]\nn_env = 128\nshard = 64\nwindow = 64\nupdates = 800"),
    ("HoverRand", Algorithm::Apg, HOVER_RAND),
    ("TrackRand", Algorithm::Apg, TRACK_RAND),
    ("FlyThrough", Algorithm::Apg, "[apg]\nn_env = 128\nshard = 64\nwindow = 64\nupdates = 1000"),
    ("PayloadHover", Algorithm::Shac, PAYLOAD_HOVER),
    ("PayloadTrack", Algorithm::Apg, "[apg]\nn_env = 128\nshard = 64\nwindow = 96\nupdates = 1500\ncarry_clip = 30"),
    (
        "InvPendulumHover",
        Algorithm::Apg,
        "[apg]\nn_env = 128\nshard = 64\nwindow = 96\nupdates = 2000\ncarry_clip = 30",
    ),
    ("OmavHover", Algorithm::Apg, OMAV_HOVER),
    ("OmavTrack", Algorithm::Apg, OMAV_TRACK),
    ("OverHover", Algorithm::Shac, OVER_HOVER),
    ("Track", Algorithm::Ppo, "[ppo]\nupdates = 150"),
    ("InvPendulumTrack", Algorithm::Ppo, ""),
    ("InvPendulumFlyThrough", Algorithm::Ppo, ""),
    ("PayloadFlyThrough", Algorithm::Ppo, ""),
    ("OverTrack", Algorithm::Ppo, TEAM),
    ("OverFlyThrough", Algorithm::Ppo, TEAM),
    ("TransportHover", Algorithm::Ppo, TEAM),
    ("TransportTrack", Algorithm::Ppo, TEAM),
    ("TransportFlyThrough", Algorithm::Ppo, TEAM),
    ("Formation", Algorithm::Ppo, TEAM),
    ("DragonHover", Algorithm::Ppo, "[ppo]\nupdates = 100"),
];

/// Drones that tumble have gradients a million times as large as the others.
const HOVER_RAND: &str = "\
[apg]
window = 64
updates = 3000
carry_clip = 30
rate = { kind = 'cosine', from = 0.005, to = 1e-4 }";

const TRACK_RAND: &str = "\
[apg]
n_env = 128
shard = 64
window = 64
updates = 2000
carry_clip = 30
rate = { kind = 'cosine', from = 0.004, to = 1e-4 }";

/// The ball is pushed at random: beyond three quarters of a second a critic knows more than a gradient.
const PAYLOAD_HOVER: &str = "\
[shac]
window = 40
updates = 2000
discount = 0.98
carry_clip = 30
rate = { kind = 'cosine', from = 0.005, to = 1e-4 }";

/// Twelve rotors lift six times the weight: steps must be small.
const OMAV_HOVER: &str = "\
[apg]
n_env = 128
shard = 64
window = 48
updates = 1500
clip = 0.05
carry_clip = 30
rate = { kind = 'cosine', from = 0.003, to = 1e-4 }";

const OMAV_TRACK: &str = "\
[apg]
n_env = 128
shard = 64
window = 48
updates = 1500
clip = 0.02
carry_clip = 30
rate = { kind = 'cosine', from = 0.003, to = 1e-4 }";

/// Rows are drones: a batch of a team is as large as one of four times as many drones alone.
const TEAM: &str = "\
[ppo]
n_env = 256
shard = 64
updates = 100";

/// Four drones on bars: what a window does not see is long.
const OVER_HOVER: &str = "\
[shac]
n_env = 64
shard = 32
window = 32
updates = 2000
critic_passes = 1
carry_clip = 30
rate = { kind = 'cosine', from = 0.005, to = 1e-4 }";

/// What differs from the defaults for a task under an algorithm, or under its usual one.
pub fn recipe(task: &str, algorithm: Option<Algorithm>) -> Option<(Algorithm, &'static str)> {
    let fits = |(_, own, _): &&(&str, Algorithm, &str)| algorithm.is_none_or(|wanted| wanted == *own);
    let of_task = RECIPES.iter().filter(|(name, ..)| name.eq_ignore_ascii_case(task));
    of_task.clone().find(fits).map(|(_, own, text)| (*own, *text))
}

#[cfg(test)]
mod tests {
    use super::super::config::TrainConfig;
    use super::*;
    use crate::tasks::registry;

    #[test]
    fn every_recipe_is_of_a_task_and_makes_a_configuration_that_its_own_text_makes_again() {
        for (task, algorithm, text) in RECIPES {
            let config = TrainConfig::for_task(task, Some(*algorithm), None).unwrap_or_else(|e| panic!("{text}\n{e}"));
            assert_eq!(registry::by_name(task).unwrap().name, *task);
            assert_eq!(config.algorithm, *algorithm);
            assert_eq!(TrainConfig::from_toml(&config.to_toml().unwrap(), task).unwrap(), config);
        }
    }

    #[test]
    fn a_pair_has_one_recipe() {
        for (i, (task, algorithm, _)) in RECIPES.iter().enumerate() {
            assert!(!RECIPES[..i].iter().any(|(t, a, _)| (t, a) == (task, algorithm)), "{task} {}", algorithm.name());
        }
    }
}
