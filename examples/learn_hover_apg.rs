//! Hover from random weights in a second or two: analytic policy gradients in plain library calls, then 256 starts that no
//! training saw.
//!
//! `cargo run --release --example learn_hover_apg`

use omnidrones::error::Result;
use omnidrones::prelude::*;
use omnidrones::rl::apg::{Apg, ApgConfig};
use omnidrones::rl::{Starts, evaluate};
use std::time::Instant;

fn main() -> Result<()> {
    let (env, threads) = (EnvConfig { stagger: true, ..EnvConfig::default() }, Threads::default());
    let begun = Instant::now();
    let mut apg = Apg::new("Hover", &env, ApgConfig::default(), 7, threads.clone())?;
    println!("update   loss  reward");
    while apg.n_update() < apg.budget() {
        let update = apg.update()?;
        if apg.n_update().is_multiple_of(100) {
            println!("{:6} {:6.3} {:7.3}", apg.n_update(), update.loss, update.reward);
        }
    }
    println!("{} steps of environments in {:.2} s", apg.env_steps(), begun.elapsed().as_secs_f64());

    let starts = Starts { n_env: 256, seed: 1_000_003 };
    let result = evaluate(&mut apg.policy()?, "Hover", &env, starts, &threads, &mut |_| {})?;
    println!("{:.1} % within 0.1 m in the end, mean {:.3} m", 100.0 * result.success, result.final_error);
    assert!(result.success > 0.97);
    Ok(())
}
