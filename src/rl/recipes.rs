//! Settings that are known to train a task: one file per task and algorithm in `recipes/`, with a line of why.
//!
//! A recipe is TOML over the defaults of [`TrainConfig`](super::config::TrainConfig); a user's file goes over the recipe. That
//! of a [variant](super::algorithm::VARIANTS) goes over the variant's settings, which go over the recipe of its algorithm.
//! Where a pair of task and algorithm has none, the defaults hold.

/// A recipe by the name of its file: task and algorithm, `hover.apg`.
macro_rules! file {
    ($name:literal) => {
        ($name, include_str!(concat!("recipes/", $name, ".toml")))
    };
}

/// Names and texts of all files. The first of a task is that of its usual algorithm.
pub static RECIPES: &[(&str, &str)] = &[
    file!("hover.apg"),
    file!("hover.shac"),
    file!("hover.ppo"),
    file!("hover.sac"),
    file!("hover.td3"),
    file!("hover.dqn"),
    file!("hover.qmix"),
    file!("track.apg"),
    file!("track.ppo"),
    file!("hover_rand.apg"),
    file!("hover_rand.rma"),
    file!("track_rand.apg"),
    file!("track_rand.rma"),
    file!("fly_through.ppo"),
    file!("fly_through.apg"),
    file!("payload_hover.ppo"),
    file!("payload_hover.shac"),
    file!("payload_hover.sac"),
    file!("payload_hover.td3"),
    file!("payload_hover.dqn"),
    file!("payload_track.apg"),
    file!("payload_fly_through.ppo"),
    file!("inv_pendulum_hover.apg"),
    file!("inv_pendulum_track.ppo"),
    file!("inv_pendulum_track.apg"),
    file!("inv_pendulum_fly_through.ppo"),
    file!("inv_pendulum_fly_through.apg"),
    file!("omav_hover.apg"),
    file!("omav_track.apg"),
    file!("dragon_hover.shac"),
    file!("over_hover.shac"),
    file!("over_hover.ppo"),
    file!("over_hover.td3"),
    file!("over_track.shac"),
    file!("over_fly_through.shac"),
    file!("transport_hover.shac"),
    file!("transport_hover.ppo"),
    file!("transport_track.shac"),
    file!("transport_fly_through.shac"),
    file!("forest.ppo"),
    file!("forest.apg"),
    file!("race.ppo"),
    file!("pinball.apg"),
    file!("formation.apg"),
    file!("formation.shac"),
    file!("formation.ppo"),
];

/// The algorithm of a task without recipes.
pub(super) const USUAL: &str = "apg";

/// Algorithm and text of a task's recipes, its usual one first.
fn of_task(task: &str) -> impl Iterator<Item = (&'static str, &'static str)> {
    RECIPES.iter().filter_map(move |(name, text)| {
        let (own, algorithm) = name.split_once('.')?;
        own.replace('_', "").eq_ignore_ascii_case(task).then_some((algorithm, *text))
    })
}

/// Algorithm and text of what differs from the defaults for a task under an algorithm, or under its usual one.
pub fn recipe(task: &str, algorithm: Option<&str>) -> Option<(&'static str, &'static str)> {
    of_task(task).find(|(own, _)| algorithm.is_none_or(|wanted| wanted.eq_ignore_ascii_case(own)))
}

/// Algorithms that have a recipe for a task, the usual one first; APG for a task without any.
pub fn recipes_of(task: &str) -> Vec<&'static str> {
    let algorithms: Vec<&str> = of_task(task).map(|(own, _)| own).collect();
    if algorithms.is_empty() { vec![USUAL] } else { algorithms }
}
