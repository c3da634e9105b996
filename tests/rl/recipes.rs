//! Recipes.

use omnidrones::rl::TrainConfig;
use omnidrones::rl::recipes::{RECIPES, recipe, recipes_of};
use omnidrones::tasks::registry::names;
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
        assert_eq!(config.algorithm.name(), omnidrones::rl::algorithm::base(algorithm));
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
