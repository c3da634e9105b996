//! A vehicle written in code: a small X-quadrotor from its parts, saved as TOML, read back, flown with derived gains.
//!
//! `cargo run --release --example own_vehicle`

use omnidrones::dynamics::{Drag, Inertia, Part, Rotor};
use omnidrones::error::Result;
use omnidrones::prelude::*;

fn my_drone() -> Vehicle {
    // Front left, back left, back right, front right; neighbours turn opposite ways.
    let corners = [(0.08, 0.08, -1.0), (-0.08, 0.08, 1.0), (-0.08, -0.08, -1.0), (0.08, -0.08, 1.0)];
    let rotor = |(i, &(x, y, spin)): (usize, &(f64, f64, f64))| Rotor {
        name: format!("rotor_{i}"),
        position: [x, y, 0.02],
        axis: [0.0, 0.0, 1.0],
        spin,
        thrust_coefficient: 1.2e-6,
        moment_per_thrust: 0.012,
        max_speed: 2000.0,
        time_constant_up: 0.02,
        time_constant_down: 0.03,
        inertia: 0.0,
        radius: 0.0635,
        drag_coefficient: 1e-5,
        axial_drag_coefficient: 0.0,
        rolling_coefficient: 0.0,
    };
    Vehicle {
        name: "my_drone".into(),
        source: "measured on the bench".into(),
        parts: vec![
            Part::new("frame", 0.35, [0.0; 3], Inertia::diagonal(1.2e-3, 1.3e-3, 2.2e-3)),
            Part::new("battery", 0.18, [-0.01, 0.0, -0.025], Inertia::diagonal(6e-5, 1.5e-4, 1.6e-4)),
        ],
        rotors: corners.iter().enumerate().map(rotor).collect(),
        drag: Drag { linear: [0.08, 0.08, 0.12], ..Drag::default() },
        shapes: vec![],
        published_gains: None,
    }
}

fn main() -> Result<()> {
    let text = my_drone().to_toml()?; // an invalid vehicle is refused here
    let vehicle = Vehicle::from_toml_str(&text, "my_drone.toml")?;
    assert_eq!(vehicle, my_drone());

    let total = vehicle.mass_properties();
    println!("{:.3} kg, centre of mass {:?} m", total.mass, total.center_of_mass.as_slice());
    println!("thrust to weight {:.2}", vehicle.thrust_to_weight());
    println!("hover thrusts {:.3?} N: the battery sits behind the middle", vehicle.hover()?.thrusts);
    println!("derived gains {:.4?}", vehicle.gains());
    let flight = fly_vehicle(&vehicle, &vehicle.gains(), &FlightPlan::default(), &mut |_| ())?;
    println!("lemniscate: RMSE {:.4?} m after 2 s", flight.log.rmse(2.0));
    Ok(())
}
