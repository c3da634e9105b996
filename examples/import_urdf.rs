//! Reads a URDF and the rotor file beside it, says what is odd and what had to be assumed, and flies the vehicle.
//!
//! `cargo run --release --example import_urdf [FILE.urdf]`

use omnidrones::dynamics::urdf::{ImportOptions, import_file};
use omnidrones::error::Result;
use omnidrones::prelude::*;

fn main() -> Result<()> {
    let sample = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/urdf/plain_x.urdf");
    let file = std::env::args().nth(1).unwrap_or(sample.into());

    let import = import_file(&file, &ImportOptions::default())?;
    for warning in &import.warnings {
        println!("odd: {warning}");
    }
    for assumption in &import.assumptions {
        println!("assumed: {assumption}");
    }
    let vehicle = import.vehicle;
    let mass = vehicle.mass_properties().mass;
    println!("{}: {mass:.3} kg, {} rotors, {} parts", vehicle.name, vehicle.n_rotor(), vehicle.parts.len());

    let flight = fly_vehicle(&vehicle, &vehicle.gains(), &FlightPlan::default(), &mut |_| ())?;
    println!("lemniscate: RMSE {:.4?} m after 2 s", flight.log.rmse(2.0));
    Ok(())
}
