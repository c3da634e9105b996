//! A controller of your own, written once over any scalar: flown on a Hummingbird and on one that carries a ball on a rope.
//! `examples/monte_carlo.rs` flies the same law on ten thousand randomised Hummingbirds.
//!
//! `cargo run --release --example own_controller`

use omnidrones::controllers::allocation::{Mixer, allocate_yaw_last, thrust_to_command};
use omnidrones::controllers::attitude::attitude_error;
use omnidrones::controllers::reference::Lemniscate;
use omnidrones::controllers::velocity::{desired_attitude, limit_force};
use omnidrones::dynamics::spatial::{dot, matrix, up_axis};
use omnidrones::error::Result;
use omnidrones::prelude::*;

/// Thrust along the wanted force, moments against errors of attitude and rate, at 250 Hz.
pub struct Own {
    mass: f64,
    inertia: [f64; 3],
    mixer: [[f64; 4]; 4],
    max_thrust: [f64; 4],
}

impl Own {
    /// For a quadrotor that carries `mass` (kg) in all.
    pub fn new(drone: &Vehicle, mass: f64) -> Result<Self> {
        let inertia = drone.mass_properties().inertia;
        let max_thrust = [0, 1, 2, 3].map(|i| drone.rotors[i].max_thrust());
        Ok(Self { mass, inertia: [0, 1, 2].map(|i| inertia[(i, i)]), mixer: Mixer::new(drone)?.padded()?, max_thrust })
    }
}

impl ControlLaw for Own {
    fn rate(&self) -> Option<f64> {
        Some(250.0)
    }

    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, _memory: &mut [S], commands: &mut [S]) {
        let (own, wanted, c) = (now.kinematics(), now.sample(), S::constant);
        let mut force = wanted.acceleration;
        for i in 0..3 {
            force[i] +=
                c(4.0) * (wanted.position[i] - own.position[i]) + c(3.5) * (wanted.velocity[i] - own.velocity[i]);
        }
        force[2] += c(9.81);
        let force = limit_force(force, c(1.0), [c(2.0), c(19.0)], c(20.0));
        let error = attitude_error(desired_attitude(force, wanted.yaw), matrix(own.attitude));
        let mut wrench = [c(self.mass) * dot(force, up_axis(own.attitude)); 4];
        for i in 0..3 {
            wrench[1 + i] = -c(self.inertia[i]) * (c(100.0) * error[i] + c(18.0) * own.angular_velocity[i]);
        }
        let (mixer, most) = (self.mixer.map(|row| row.map(c)), self.max_thrust.map(c));
        let actions = thrust_to_command(&allocate_yaw_last(&mixer, &most, wrench), &most);
        commands[..4].copy_from_slice(&actions);
    }
}

#[allow(dead_code)] // monte_carlo.rs has a main of its own
fn main() -> Result<()> {
    let (physics, drone) = (Physics::default(), vehicles::by_name("hummingbird")?);
    let payload = configurations::by_name("payload")?;
    let curve = Lemniscate { rate: 0.5, origin: [0.0, 0.0, 4.0], ..Lemniscate::default() };
    let plan = FlightPlan { reference: Reference::Lemniscate(curve), physics, ..FlightPlan::default() };
    let alone = (Plant::of_vehicle(&drone, physics)?, drone.mass_properties().mass);
    let laden = (Plant::of_model(&payload, physics)?, payload.mass());
    for (plant, mass) in [alone, laden] {
        let flight = fly(&plant, &mut LawController::of(Own::new(&drone, mass)?), &plan, &mut |_| {})?;
        println!("{}: RMSE {:.1} mm after 2 s", plant.name(), 1e3 * flight.log.rmse(2.0).unwrap_or(f64::NAN));
        assert_eq!(flight.lost(), None);
    }
    Ok(())
}
