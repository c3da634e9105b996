//! Optimal feedback for a drone with a ball on a rope and for one that balances it: designed on the linearised articulated
//! system, flown against the simple pilots.
//!
//! `cargo run --release --example lqr_payload`

use omnidrones::controllers::pilot::start_on;
use omnidrones::controllers::reference::Lemniscate;
use omnidrones::controllers::{Balance, FlightPlan, Formation, Lqr, Pilot, Rates, Reference, fly_rig};
use omnidrones::dynamics::tree::Multibody;
use omnidrones::dynamics::{Physics, configurations};
use omnidrones::error::Result;

fn main() -> Result<()> {
    let rates = Rates::default();
    let curve = Lemniscate { rate: 0.5, origin: [0.0, 0.0, 4.0], ..Lemniscate::default() };
    let plan = FlightPlan { reference: Reference::Lemniscate(curve), ..FlightPlan::default() };
    for name in ["payload", "inverted_pendulum"] {
        let system = Multibody::new(&configurations::by_name(name)?, Physics::default())?;
        let best = Lqr::new(&system, None, &rates)?;
        let feedback = best.regulator();
        let slowest: Vec<String> = feedback.poles.iter().take(3).map(|p| format!("{:.4}", p.norm())).collect();
        println!("{name}: {} doublings, residual {:.0e}", feedback.doublings, feedback.residual);
        println!("  {} feedback gains, largest poles {}", feedback.gain.len(), slowest.join(", "));

        let simple: Box<dyn Pilot> = match name {
            "payload" => Box::new(Formation::new(&system, None, &rates)?),
            _ => Box::new(Balance::new(&system, None, &rates)?),
        };
        for mut pilot in [simple, Box::new(best)] {
            let start = start_on(&system, pilot.as_ref(), &plan.reference);
            let flight = fly_rig(&system, pilot.as_mut(), &plan, &start, &mut |_| {})?;
            let rmse = flight.log.rmse(2.0).unwrap_or(f64::NAN);
            println!("  {:8} tracking RMSE {:5.1} mm", pilot.name(), 1e3 * rmse);
        }
    }
    Ok(())
}
