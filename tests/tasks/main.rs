//! Every registered task keeps the contract of the batched environment.

mod baselines;
mod contract;
mod events;
mod gradients;
mod probes;
mod residual;
mod robustness;
mod sendable;
mod transforms;

use omnidrones::controllers::cascade::Level;
use omnidrones::tasks::{Env, EnvConfig, registry};

/// A configuration of `n_env` environments with episodes of at most `horizon` steps.
fn config(n_env: usize, horizon: usize) -> EnvConfig {
    let mut config = EnvConfig { n_env, ..EnvConfig::default() };
    config.task.insert("horizon".into(), (horizon as i64).into());
    config
}

/// `check(name, make, config)` for every task, and for every control mode where its drones have one.
fn everywhere(n_env: usize, horizon: usize, mut check: impl FnMut(&str, &dyn Fn(&EnvConfig) -> Env, &EnvConfig)) {
    for entry in registry::REGISTRY {
        for control in Level::ALL {
            let own = EnvConfig { control, ..config(n_env, horizon) };
            if entry.env(&EnvConfig { n_env: 1, ..own.clone() }).is_err() {
                assert_ne!(control, Level::Rotor, "{} has no rotor mode", entry.name);
                continue;
            }
            let name = format!("{} by {}", entry.name, control.name());
            check(&name, &|config| entry.env(config).unwrap(), &own);
        }
    }
}
