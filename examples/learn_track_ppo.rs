//! The lemniscate with PPO, for a few updates of many environments: rewards alone, no gradient of the simulator.
//!
//! `cargo run --release --example learn_track_ppo` (more updates fly better: the recipe of `omnidrones train Track --algo
//! ppo` has them)

use omnidrones::error::Result;
use omnidrones::prelude::*;
use omnidrones::rl::ppo::{Ppo, PpoConfig};

const UPDATES: u64 = 30;

fn main() -> Result<()> {
    let recipe = TrainConfig::for_task("Track", Some("ppo"), None)?;
    let config = recipe.algorithm.get().cloned().unwrap_or_default();
    let config = PpoConfig { updates: UPDATES, ..config };
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    let mut ppo = Ppo::new("Track", &env, config, 7, Threads::default())?;
    println!("update  reward of a step  steps of an episode");
    let (mut first, mut last) = (0.0, 0.0);
    for _ in 0..UPDATES {
        let update = ppo.update()?;
        let length = update.episodes.total_length / update.episodes.count.max(1) as f64;
        if ppo.n_update().is_multiple_of(5) {
            println!("{:6} {:17.3} {length:20.1}", ppo.n_update(), update.reward);
        }
        if ppo.n_update() == 1 {
            first = length;
        }
        last = length;
    }
    println!("{} steps of environments", ppo.env_steps());
    assert!(last > first, "episodes have not become longer");
    Ok(())
}
