//! Tunes the gains of a Hummingbird by gradients through closed-loop flights: a small plan that takes seconds. The
//! defaults of `TunePlan` (six seconds, 64 starts, 60 steps) do better; `omnidrones tune` runs them.
//!
//! `cargo run --release --example tune_gains`

use omnidrones::controllers::design::{TunePlan, tune};
use omnidrones::dynamics::vehicles;
use omnidrones::error::Result;
use std::ops::ControlFlow;

fn main() -> Result<()> {
    let vehicle = vehicles::by_name("hummingbird")?;
    let plan = TunePlan { duration: 2.0, n_start: 16, n_held_out: 32, iterations: 12, ..TunePlan::default() };
    let tuning = tune(&vehicle, &vehicle.gains(), &plan, &mut |step| {
        println!("{:3}  RMSE {:.4} m  gradient {:.4} m", step.iteration, step.rmse, step.gradient_norm);
        ControlFlow::Continue(()) // Break judges the gains so far
    })?;
    println!(
        "{} held-out starts: {:.4} -> {:.4} m ({:+.1} %), {} crashed",
        tuning.after.n,
        tuning.before.rmse,
        tuning.after.rmse,
        100.0 * (tuning.after.rmse / tuning.before.rmse - 1.0),
        tuning.after.crashed,
    );
    let gains = tuning.gains;
    for (name, k) in
        [("position", gains.position), ("velocity", gains.velocity), ("attitude", gains.attitude), ("rate", gains.rate)]
    {
        println!("{name:9} {:8.4} {:8.4} {:8.4}", k[0], k[1], k[2]);
    }
    Ok(())
}
