//! A reference of your own: its position written once over any scalar, its derivatives up to snap come by themselves.
//!
//! `cargo run --release --example own_reference`

use omnidrones::controllers::reference::Curve;
use omnidrones::error::Result;
use omnidrones::prelude::*;

/// A helix that climbs as it turns, the nose along the path.
struct Helix {
    radius: f64,
    rate: f64,
    climb: f64,
}

impl Curve for Helix {
    fn name(&self) -> &'static str {
        "helix"
    }

    fn position<S: Scalar>(&self, t: S) -> [S; 3] {
        let (s, c) = (t * S::constant(self.rate)).sin_cos();
        let (r, z) = (S::constant(self.radius), S::constant(self.climb) * t);
        [r * c, r * s, z + S::constant(1.0)]
    }

    fn yaw<S: Scalar>(&self, t: S) -> S {
        t * S::constant(self.rate) + S::constant(std::f64::consts::FRAC_PI_2)
    }
}

fn main() -> Result<()> {
    let helix = Reference::own(Helix { radius: 1.5, rate: 1.2, climb: 0.3 });
    let start = helix.sample(0.0);
    println!("{}: starts at {:.2?} m with {:.2?} m/s", helix.name(), start.position, start.velocity);
    for name in ["hummingbird", "firefly"] {
        let vehicle = vehicles::by_name(name)?;
        let plan = FlightPlan { reference: helix.clone(), ..FlightPlan::default() };
        let flight = fly_vehicle(&vehicle, &vehicle.gains(), &plan, &mut |_| {})?;
        let rmse = flight.log.rmse(4.0).unwrap_or(f64::NAN);
        println!("{name}: RMSE {:.1} mm after 4 s", 1e3 * rmse);
        assert!(rmse < 0.2);
    }
    Ok(())
}
