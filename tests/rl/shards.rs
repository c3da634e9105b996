//! Batches cut into shards.

use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
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
