//! Tunes a tilting Omav through its bounded allocation: twelve six-axis gains, the null-space weight and the tilt horizon,
//! by gradients of whole flights in which thrusts and tilts come from a quadratic program. A small plan that takes seconds;
//! the defaults of `TiltingPlan` do better.
//!
//! `cargo run --release --example tune_through_allocation`

#[allow(dead_code)] // the tests use the rest
#[path = "../tests/controllers/tilting.rs"]
mod tilting;

use omnidrones::dynamics::configurations::Omav;
use omnidrones::dynamics::{Integrator, Physics};
use omnidrones::error::Result;
use tilting::{TiltingPlan, TiltingTuning, tilting, tune_tilting};

fn main() -> Result<()> {
    let physics = Physics { dt: 0.005, integrator: Integrator::SemiImplicit, ..Physics::default() };
    let system = tilting(&Omav::default(), physics)?;
    let plan = TiltingPlan { duration: 1.0, n_start: 2, n_held_out: 8, iterations: 8, ..TiltingPlan::default() };
    let tuning = tune_tilting(&system, system.law().nominal(), &plan, &mut |step| {
        println!("{:3}  root cost {:.4} m  gradient {:.4} m", step.iteration, step.rmse, step.gradient_norm);
    })?;
    for (name, flown) in [("before", tuning.before), ("after", tuning.after)] {
        println!(
            "{name:7} {} held-out starts: root cost {:.4} m, position {:.4} m, attitude {:.4} rad, {} lost",
            flown.n, flown.root_cost, flown.position, flown.attitude, flown.lost,
        );
    }
    let (gains, weight, horizon) = TiltingTuning::readable(&tuning.theta);
    for (name, k) in
        [("position", gains.position), ("velocity", gains.velocity), ("attitude", gains.attitude), ("rate", gains.rate)]
    {
        println!("{name:9} {:8.4} {:8.4} {:8.4}", k[0], k[1], k[2]);
    }
    println!("null-space weight {weight:.3e}, tilt horizon {:.1} ms", 1e3 * horizon);
    Ok(())
}
