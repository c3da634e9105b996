//! Every registered task keeps the contract of the batched environment.

mod baselines;
mod concurrency;
mod contract;
mod events;
mod gradients;
mod groups;
mod intervals;
mod one_drone;
mod own;
mod pinball;
mod probes;
mod race;
mod recordings;
mod records;
mod residual;
mod robustness;
mod rotors;
mod sendable;
mod sensing;
mod several_drones;
#[cfg(debug_assertions)] // products that wrap are told there alone
mod sizes;
mod starts;
mod tables;
mod teams;
mod transforms;

use omnidrones::controllers::cascade::Level;
use omnidrones::tasks::{Env, EnvConfig, registry};

/// A configuration of `n_env` environments with episodes of at most `horizon` steps.
fn config(n_env: usize, horizon: usize) -> EnvConfig {
    let mut config = EnvConfig { n_env, ..EnvConfig::default() };
    config.task.insert("horizon".into(), (horizon as i64).into());
    config
}

/// The variable of that name, for tests whose length is chosen.
fn count(name: &str, usual: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

/// Tasks whose drones tilt their rotors or are tilted by servos, so that no cascade steers them.
const ROTORS_ALONE: [&str; 3] = ["OmavHover", "OmavTrack", "DragonHover"];

/// `check(name, make, config)` for every task, and for every control mode where its drones have one.
fn everywhere(n_env: usize, horizon: usize, mut check: impl FnMut(&str, &dyn Fn(&EnvConfig) -> Env, &EnvConfig)) {
    for entry in registry::REGISTRY {
        for control in Level::ALL {
            let own = EnvConfig { control, ..config(n_env, horizon) };
            let flies = entry.env(&EnvConfig { n_env: 1, ..own.clone() }).is_ok();
            let has_mode = control == Level::Rotor || !ROTORS_ALONE.contains(&entry.name);
            assert_eq!(flies, has_mode, "{} by {}", entry.name, control.name());
            if !flies {
                continue;
            }
            let name = format!("{} by {}", entry.name, control.name());
            check(&name, &|config| entry.env(config).unwrap(), &own);
        }
    }
}
