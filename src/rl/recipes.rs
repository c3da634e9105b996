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

#[cfg(test)]
mod tests {
    use super::super::config::TrainConfig;
    use super::*;
    use crate::tasks::registry::names;
    use std::path::Path;

    /// `HoverRand` as in a file's name: `hover_rand`.
    fn snake(task: &str) -> String {
        let parts = task.chars().enumerate().map(|(i, c)| match c {
            c if c.is_uppercase() && i > 0 => format!("_{}", c.to_lowercase()),
            c => c.to_lowercase().to_string(),
        });
        parts.collect()
    }

    #[test]
    fn every_recipe_is_of_a_task_and_makes_a_configuration_that_its_own_text_makes_again() {
        for (name, text) in RECIPES {
            let (task, algorithm) = name.split_once('.').unwrap();
            let task = names().into_iter().find(|own| snake(own) == task).unwrap_or_else(|| panic!("{name}"));
            let config = TrainConfig::for_task(task, Some(algorithm), None).unwrap_or_else(|e| panic!("{text}\n{e}"));
            assert_eq!(config.algorithm.name(), crate::rl::algorithm::base(algorithm));
            assert_eq!(TrainConfig::from_toml(&config.to_toml().unwrap(), task).unwrap(), config);
            let tables: toml::Table = toml::from_str(text).unwrap();
            assert!(config.unused(&tables).is_empty(), "{name}");
        }
    }

    /// What a recipe sets a file can take back, setting by setting: a text that says all says it under a recipe too. Of a task's own
    /// settings a text says those that were set.
    #[test]
    fn the_text_of_a_configuration_makes_it_again_over_every_recipe() {
        for (name, _) in RECIPES {
            let (task, algorithm) = name.split_once('.').unwrap();
            let task = names().into_iter().find(|own| snake(own) == task).unwrap();
            let usual = format!("task = '{task}'\nalgorithm = '{algorithm}'");
            let usual = TrainConfig::from_toml(&usual, "usual").unwrap();
            let text = usual.to_toml().unwrap();
            let mut again = TrainConfig::for_task(task, Some(algorithm), Some((&text, "text"))).unwrap();
            again.env.task.clone_from(&usual.env.task);
            assert_eq!(again.to_toml().unwrap(), text, "{name}");
        }
    }

    #[test]
    fn every_file_of_the_folder_is_listed_once_and_begins_with_why() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/rl/recipes");
        let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut files: Vec<String> = files.collect();
        let mut listed: Vec<String> = RECIPES.iter().map(|(name, _)| format!("{name}.toml")).collect();
        files.sort();
        listed.sort();
        assert_eq!(files, listed);
        assert!(RECIPES.iter().all(|(_, text)| text.starts_with("# ")));
    }

    #[test]
    fn the_first_recipe_of_a_task_is_its_usual_one() {
        assert_eq!(recipes_of("OverHover"), ["shac", "ppo", "td3"]);
        assert_eq!(recipe("overhover", None).unwrap().0, "shac");
        assert_eq!(recipe("OverHover", Some("apg")), None);
        assert_eq!(recipes_of("Own"), ["apg"]);
    }
}
