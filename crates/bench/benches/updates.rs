//! Gradient steps per second of SAC and DQN on all cores: `cargo bench -p omnidrones-bench --bench updates`. PyTorch's of the
//! same networks (layers without norms, values without an advantage apart) and batches, right before or after:
//! `python crates/bench/benches/torch_updates.py`.

use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::rl::dqn::DqnConfig;
use omnidrones::rl::nn::Layers;
use omnidrones::rl::replay::ReplayConfig;
use omnidrones::rl::sac::SacConfig;
use omnidrones::rl::{Algorithm, TrainConfig};

/// Steps that are kept, before the first is learnt from.
const KEPT: usize = 100_000;
/// Rows of a gradient step.
const BATCH: usize = 256;
/// Gradient steps of an update.
const STEPS: usize = 200;
/// Of which the fastest counts.
const ROUNDS: usize = 12;

fn sac(hidden: &[usize]) -> Box<dyn Algorithm> {
    let layers = |own: Layers| Layers { hidden: hidden.to_vec(), layer_norm: false, ..own };
    let usual = SacConfig::default();
    let (network, critic) = (layers(usual.network.clone()), layers(usual.critic.clone()));
    Box::new(SacConfig {
        n_env: 64,
        steps: 100,
        gradient_steps: STEPS,
        batch: BATCH,
        replay: replay(),
        network,
        critic,
        ..usual
    })
}

fn dqn(hidden: &[usize]) -> Box<dyn Algorithm> {
    let usual = DqnConfig::default();
    let network = Layers { hidden: hidden.to_vec(), layer_norm: false, ..usual.network.clone() };
    let own =
        DqnConfig { n_env: 64, steps: 100, gradient_steps: STEPS, batch: BATCH, replay: replay(), network, ..usual };
    Box::new(DqnConfig { duelling: false, ..own })
}

fn replay() -> ReplayConfig {
    ReplayConfig { capacity: KEPT, learning_starts: KEPT - 6400, ..ReplayConfig::default() }
}

fn rate(algorithm: Box<dyn Algorithm>) -> Result<f64> {
    let config = TrainConfig { task: "Hover".into(), algorithm, ..TrainConfig::default() };
    let mut learner = config.learner("Hover", &Threads::default())?;
    let mut best = f64::INFINITY;
    for _ in 0..KEPT / 6400 + ROUNDS {
        let told = learner.update()?;
        let learning = told.phases.iter().filter(|(name, _)| *name == "learn");
        // nothing is learnt while the replay fills
        if told.gradient_norm > 0.0 {
            best = best.min(learning.map(|(_, time)| time.as_secs_f64()).sum());
        }
    }
    Ok(STEPS as f64 / best)
}

fn main() -> Result<()> {
    println!("{:<6}{:>12}{:>20}", "", "hidden", "gradient steps/s");
    for hidden in [[256, 256], [64, 64]] {
        for (name, algorithm) in [("SAC", sac(&hidden)), ("DQN", dqn(&hidden))] {
            println!("{name:<6}{:>12}{:>20.0}", format!("{hidden:?}"), rate(algorithm)?);
        }
    }
    Ok(())
}
