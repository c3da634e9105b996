//! One controller on ten thousand Hummingbirds that are not what it believes: masses, rotors, centres of mass, winds, all
//! drawn; a table of the worst. The law is that of `examples/own_controller.rs`.
//!
//! `cargo run --release --example monte_carlo`

#[path = "own_controller.rs"]
mod own_controller;

use omnidrones::controllers::{MonteCarlo, MonteCarloDraw, MonteCarloSummary};
use omnidrones::dynamics::Effects;
use omnidrones::error::Result;
use omnidrones::prelude::*;
use std::time::Instant;

fn main() -> Result<()> {
    let effects = Effects { disturbance: true, ..Effects::default() };
    let physics = Physics { dt: 0.004, effects, ..Physics::default() };
    let drone = vehicles::by_name("hummingbird")?;
    let plant = Plant::of_vehicle(&drone, physics)?;
    let own = LawController::of(own_controller::Own::new(&drone, drone.mass_properties().mass)?);
    let system = ClosedLoop::new(plant, own)?.with_latency(2)?.with_physics();
    let [mass, center] = [system.parameter("mass")?, system.parameter("center_of_mass_x")?];
    let lift: Vec<usize> = drone
        .rotors
        .iter()
        .map(|r| system.parameter(&format!("{}.thrust_coefficient", r.name)))
        .collect::<Result<_>>()?;
    let draw = |stream: &mut Stream, one: &mut MonteCarloDraw| {
        one.parameters[mass] *= stream.uniform(0.8, 1.25);
        one.parameters[center..center + 2].iter_mut().for_each(|c| *c += stream.uniform(-0.01, 0.01));
        lift.iter().for_each(|k| one.parameters[*k] *= stream.uniform(0.85, 1.1));
        (0..2).for_each(|k| one.air.wind[k] = stream.uniform(-6.0, 6.0));
        (0..3).for_each(|k| one.start[k] += stream.uniform(-0.5, 0.5));
    };

    let reference = Reference::by_name("lemniscate")?;
    let mut start = system.plant().hover_state()?;
    start[..3].copy_from_slice(&reference.sample(0.0).position);
    let many = MonteCarlo::new(&system)?.after(2.0);
    let clock = Instant::now();
    let mut flown = many.fly(Target::level(&reference), &start, (10_000, 1000), &draw, &Threads::default())?;
    let time = clock.elapsed().as_secs_f64();
    let all = MonteCarloSummary::of(&flown, 0.95);
    println!(
        "{} flights of 4 s in {time:.1} s, {} instructions a step of {} numbers; {} lost: with 95 % confidence {:.2} to {:.2} %",
        flown.len(),
        many.len(),
        system.n_state(),
        all.lost.hits,
        100.0 * all.lost.bounds[0],
        100.0 * all.lost.bounds[1]
    );

    flown.sort_by(|a, b| b.worst.total_cmp(&a.worst));
    println!(
        "median RMSE {:.3} m, with 95 % confidence {:.3} to {:.3} m; the worst five:\n flight   RMSE [m]  largest [m]  tilt [°]  lost [s]",
        all.median.value, all.median.bounds[0], all.median.bounds[1]
    );
    for o in &flown[..5] {
        let lost = o.lost_at.map_or("-".into(), |t| format!("{t:.2}"));
        println!("{:7} {:10.3} {:12.3} {:9.1} {lost:>9}", o.flight, o.rmse, o.worst, o.tilt.to_degrees());
    }
    assert!(time < 60.0 && all.median.value < 1.0);
    Ok(())
}
