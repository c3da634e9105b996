//! Optimal feedback for a drone with a ball on a rope and for one that balances it: designed on the linearised articulated
//! system, flown against the drone's cascade alone.
//!
//! `cargo run --release --example lqr_payload`

use omnidrones::controllers::reference::Lemniscate;
use omnidrones::controllers::{Controller, FlightPlan, FormationController, Lqr, Rates, Reference, fly};
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

        let simple = FormationController::new(&system, None, &rates)?;
        let mut pair: [Box<dyn Controller>; 2] = [Box::new(simple), Box::new(best)];
        for controller in &mut pair {
            let flight = fly(&system.clone().into(), controller, &plan, &mut |_| {})?;
            let rmse = flight.log.rmse(2.0).unwrap_or(f64::NAN);
            println!("  {:8} tracking RMSE {:5.1} mm", controller.name(), 1e3 * rmse);
        }
    }
    Ok(())
}
