//! Flies a built-in vehicle along the lemniscate in still air and in gusts, and writes a figure of each flight.
//!
//! `cargo run --release --example fly_and_plot [VEHICLE] [FOLDER]`

use omnidrones::dynamics::aero::wind::{Dryden, Wind};
use omnidrones::error::{Error, Result};
use omnidrones::prelude::*;
use omnidrones_plot::flight::FlightFigures;
use std::path::PathBuf;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let vehicle = vehicles::by_name(&arguments.next().unwrap_or("firefly".into()))?;
    let folder = PathBuf::from(arguments.next().unwrap_or("flight".into()));
    std::fs::create_dir_all(&folder).map_err(|e| Error::file(&folder, e))?;

    let gusts = Dryden { mean: [4.0, 0.0, 0.0], wind_at_20_feet: 6.0, height: 6.0, airspeed: 4.0 };
    for (name, wind) in [("calm", Wind::Calm), ("gusts", Wind::Dryden(gusts))] {
        let plan = FlightPlan { wind, ..FlightPlan::default() };
        let flight = fly_vehicle(&vehicle, &vehicle.gains(), &plan, &mut |_| ())?;
        match (flight.diverged_at, flight.log.rmse(2.0)) {
            (None, Some(rmse)) => println!("{} in {name}: RMSE {:.1} mm after 2 s", vehicle.name, 1e3 * rmse),
            (at, _) => println!("{} in {name}: diverged at {at:?} s", vehicle.name),
        }
        let figures = FlightFigures::new(&flight.log, 2.0);
        let path = folder.join(format!("{name}.png"));
        figures.overview.save(&path)?;
        println!("wrote {}", path.display());
    }
    Ok(())
}
