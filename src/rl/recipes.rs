//! Settings that are known to train a task, one line each.
//!
//! A recipe is TOML over the defaults of [`TrainConfig`](super::config::TrainConfig); a user's file goes over the recipe.
//! The first recipe of a task is that of its usual algorithm; where a pair of task and algorithm has none, the defaults
//! hold.

use super::config::Algorithm;

/// SHAC over half a second with layers of 128 units: (updates, first rate).
macro_rules! wide {
    ($updates:literal, $rate:literal) => {
        concat!(
            "[shac]\nn_env = 64\nshard = 32\nhorizon = 32\ncritic_epochs = 1\nadjoint_clip = 30\n",
            "network.hidden = [128, 128]\ncritic.hidden = [128, 128]\n",
            "updates = ",
            $updates,
            "\nlearning_rate = { kind = 'cosine', from = ",
            $rate,
            ", to = 1e-4 }"
        )
    };
}

/// Task, algorithm, and what differs from the defaults.
pub static RECIPES: &[(&str, Algorithm, &str)] = &[
    ("Hover", Algorithm::Apg, ""),
    ("Hover", Algorithm::Ppo, ""),
    ("Track", Algorithm::Apg, "[apg]\nn_env = 128\nshard = 64\nhorizon = 64\nupdates = 800"),
    ("Track", Algorithm::Ppo, "[ppo]\nupdates = 150"),
    ("HoverRand", Algorithm::Apg, HOVER_RAND),
    ("TrackRand", Algorithm::Apg, TRACK_RAND),
    ("FlyThrough", Algorithm::Ppo, ""),
    ("FlyThrough", Algorithm::Apg, "[apg]\nn_env = 128\nshard = 64\nhorizon = 64\nupdates = 1000"),
    ("PayloadHover", Algorithm::Shac, PAYLOAD_HOVER),
    ("PayloadTrack", Algorithm::Apg, "[apg]\nn_env = 128\nshard = 64\nhorizon = 96\nupdates = 1500\nadjoint_clip = 30"),
    ("PayloadFlyThrough", Algorithm::Ppo, ""),
    (
        "InvPendulumHover",
        Algorithm::Apg,
        "[apg]\nn_env = 128\nshard = 64\nhorizon = 96\nupdates = 2000\nadjoint_clip = 30",
    ),
    ("InvPendulumTrack", Algorithm::Ppo, "[ppo]\nupdates = 110"),
    ("InvPendulumFlyThrough", Algorithm::Ppo, "[ppo]\nupdates = 110"),
    ("OmavHover", Algorithm::Apg, OMAV_HOVER),
    ("OmavTrack", Algorithm::Apg, OMAV_TRACK),
    ("DragonHover", Algorithm::Shac, DRAGON_HOVER),
    ("OverHover", Algorithm::Shac, OVER_HOVER),
    ("OverHover", Algorithm::Ppo, TEAM),
    ("OverTrack", Algorithm::Shac, OVER_TRACK),
    ("OverFlyThrough", Algorithm::Shac, TEAM_FLY_THROUGH),
    ("TransportHover", Algorithm::Shac, TRANSPORT_HOVER),
    ("TransportHover", Algorithm::Ppo, TEAM),
    ("TransportTrack", Algorithm::Shac, TRANSPORT_TRACK),
    ("TransportFlyThrough", Algorithm::Shac, TEAM_FLY_THROUGH),
    ("Formation", Algorithm::Shac, FORMATION),
    ("Formation", Algorithm::Ppo, TEAM),
];

/// Drones that tumble have gradients a million times as large as the others.
const HOVER_RAND: &str = "\
[apg]
n_env = 128
shard = 64
horizon = 64
updates = 3000
max_grad_norm = 0.05
adjoint_clip = 30
learning_rate = { kind = 'cosine', from = 0.005, to = 1e-4 }";

const TRACK_RAND: &str = "\
[apg]
n_env = 128
shard = 64
horizon = 64
updates = 2000
max_grad_norm = 0.05
adjoint_clip = 30
learning_rate = { kind = 'cosine', from = 0.004, to = 1e-4 }
network.hidden = [128, 128]";

/// The ball is pushed at random: beyond three quarters of a second a critic knows more than a gradient.
const PAYLOAD_HOVER: &str = "\
[shac]
horizon = 40
updates = 2000
discount = 0.98
adjoint_clip = 30
learning_rate = { kind = 'cosine', from = 0.003, to = 1e-4 }
network.hidden = [128, 128]
critic.hidden = [128, 128]";

/// Twelve rotors lift six times the weight: steps must be small.
const OMAV_HOVER: &str = "\
[apg]
n_env = 128
shard = 64
horizon = 48
updates = 1500
max_grad_norm = 0.05
adjoint_clip = 30
lasting = false
learning_rate = { kind = 'cosine', from = 0.003, to = 1e-4 }";

const OMAV_TRACK: &str = "\
[apg]
n_env = 128
shard = 64
horizon = 48
updates = 1500
max_grad_norm = 0.02
adjoint_clip = 30
lasting = false
learning_rate = { kind = 'cosine', from = 0.003, to = 1e-4 }";

/// Layers of 64 units reach half the success of these.
const DRAGON_HOVER: &str = wide!(2000, 0.002);

/// Four drones on bars: what a window does not see is long.
const OVER_HOVER: &str = wide!(1500, 0.003);

const OVER_TRACK: &str = wide!(1200, 0.003);

const TRANSPORT_HOVER: &str = "\
[shac]
horizon = 32
updates = 1500
critic_epochs = 1
adjoint_clip = 30
learning_rate = { kind = 'cosine', from = 0.004, to = 1e-4 }";

const TRANSPORT_TRACK: &str = wide!(1600, 0.004);

/// Four integrator steps per step of the policy: dear.
const TEAM_FLY_THROUGH: &str = wide!(800, 0.003);

const FORMATION: &str = wide!(800, 0.003);

/// Rows are drones: a batch of a team is as large as one of four times as many drones alone.
const TEAM: &str = "\
[ppo]
n_env = 256
shard = 64
updates = 60";

/// What differs from the defaults for a task under an algorithm, or under its usual one.
pub fn recipe(task: &str, algorithm: Option<Algorithm>) -> Option<(Algorithm, &'static str)> {
    let fits = |(_, own, _): &&(&str, Algorithm, &str)| algorithm.is_none_or(|wanted| wanted == *own);
    let of_task = RECIPES.iter().filter(|(name, ..)| name.eq_ignore_ascii_case(task));
    of_task.clone().find(fits).map(|(_, own, text)| (*own, *text))
}

/// Algorithms that have a recipe for a task, the usual one first; APG for a task without any.
pub fn recipes_of(task: &str) -> Vec<Algorithm> {
    let of_task = RECIPES.iter().filter(|(name, ..)| name.eq_ignore_ascii_case(task));
    let algorithms: Vec<Algorithm> = of_task.map(|(_, own, _)| *own).collect();
    if algorithms.is_empty() { vec![Algorithm::default()] } else { algorithms }
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
