//! Batches cut into shards.

use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::parts::shards;
use omnidrones::tasks::{Env, EnvConfig};
use std::cell::Cell;

/// A thousand shards would have been made and reset before the refusal.
#[test]
fn what_does_not_fit_beside_the_shards_is_refused_after_the_first() {
    for text in [
        "apg = { n_env = 64000, shard = 64, horizon = 65536 }",
        "algorithm = 'shac'\nshac = { n_env = 64000, shard = 64, horizon = 65536 }",
        "algorithm = 'ppo'\nppo = { n_env = 64000, shard = 64, steps = 65536 }",
        "algorithm = 'dagger'\ndagger = { n_env = 64000, shard = 64, steps = 65536 }",
    ] {
        let made = Cell::new(0);
        let make = |config: &EnvConfig| {
            made.set(made.get() + 1);
            Env::make("Hover", config)
        };
        let config = TrainConfig::for_task("Hover", None, Some((text, "large"))).unwrap();
        let threads = Threads::new(1).unwrap();
        let refused = config.algorithm.learner(&make, &config.env, 0, threads).map(drop).unwrap_err();
        assert!(refused.is_limit() && made.get() == 1, "{text}: {refused}, {} shards", made.get());
    }
}

#[test]
fn shards_tell_what_learners_read_and_what_else_is_asked_for() {
    let told = |info: Option<Vec<String>>| {
        let made =
            shards(&|config| Env::make("Hover", config), &EnvConfig { n_env: 3, info, ..EnvConfig::default() }, 2);
        let names = |shard: &omnidrones::rl::parts::Shard| {
            shard.env.spec().info.iter().map(|info| info.name.clone()).collect::<Vec<_>>()
        };
        made.map(|shards| shards.iter().map(names).collect::<Vec<_>>())
    };
    let read = ["return", "length", "reason", "success", "loss"];
    assert_eq!(told(None).unwrap(), [read, read]);
    assert_eq!(told(Some(vec!["position_error".into()])).unwrap()[1], [&read[..], &["position_error"]].concat());
    assert!(told(Some(vec!["position_eror".into()])).unwrap_err().is_unknown_name());
    let text = "[env]\ninfo = []";
    let refusal = TrainConfig::for_task("Hover", None, Some((text, "run.toml"))).unwrap_err().to_string();
    assert!(refusal.contains("training tells what learners read"), "{refusal}");
}
