//! How the tracking error of one whole flight depends on each gain: one reverse sweep through every step of it.

use super::tuned_loop::{LogGains, MeanSquaredError, VehicleLoop};
use crate::closed_loop::ClosedLoop;
use crate::controller::Target;
use crate::flight::FlightPlan;
use crate::start::start_on;
use autodiff::{Gradient, Rollout, System};
use base::error::{Error, Result};
use dynamics::aero::wind::{Wind, WindState};
use dynamics::{Disturbance, Gains, Vehicle};
use rng::{Purpose, Stream};
use serde::Serialize;

/// Longest flight that is differentiated, in steps: its inputs are held in memory.
pub const MAX_STEPS: u64 = 200_000;

/// The gradient of a flight's RMSE.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GainSensitivity {
    /// RMSE over the whole flight, start included, m.
    pub rmse: f64,
    /// ∂RMSE/∂ln K per gain, m: times ln 2 it is what doubling the gain would change, to first order.
    pub gradient: Gains,
    /// Steps differentiated through.
    pub steps: u64,
}

/// Flies the plan and sweeps back through it.
///
/// # Errors
/// [`Error::Limit`] for more than `MAX_STEPS` steps or a step too large to record; [`Error::Value`] if vehicle, gains or
/// plan are not valid, a gain is 0 (its logarithm has no derivative), or a rotor fails (the control law switches).
pub fn gain_sensitivity(vehicle: &Vehicle, gains: &Gains, plan: &FlightPlan) -> Result<GainSensitivity> {
    let steps = plan.n_step()?;
    if !plan.failures.is_empty() {
        let (what, remedy) = ("plan: failures", "Differentiate the flight of the whole vehicle.");
        return Err(Error::value(what, plan.failures.len(), "none: the control law switches at a failure", remedy));
    }
    if steps > MAX_STEPS {
        return Err(Error::limit("steps to differentiate", steps, MAX_STEPS, "Fly shorter, or with a larger dt."));
    }
    let own = ClosedLoop::of_vehicle(vehicle, plan.air_physics(), gains, &plan.rates)?
        .with_filters(&plan.filters)?
        .with_latency(plan.latency)?;
    let system = LogGains::new(own);
    let theta: Vec<f64> = system.gains().iter().map(|k| k.ln()).collect();
    base::error::finite("logarithm of gain", &theta)?;
    let state =
        system.closed.initial_state(&start_on(system.closed.plant(), system.closed.controller(), &plan.reference)?);
    let inputs = inputs(&system.closed, plan, steps)?;

    let mut gradient =
        Gradient { state: vec![0.0; system.n_state()], inputs: Vec::new(), parameters: vec![0.0; theta.len()] };
    let rollout = Rollout::new(system, MeanSquaredError::over(steps as usize))?;
    let cost = rollout.gradient_into(&mut rollout.scratch(), &state, &inputs, &theta, &mut gradient);
    let rmse = cost.sqrt();
    let slopes: Vec<f64> = gradient.parameters.iter().map(|slope| slope / (2.0 * rmse)).collect();
    let gradient = Gains::from_flat(&slopes);
    Ok(GainSensitivity { rmse, gradient, steps })
}

/// Inputs of the closed loop along the plan, wind included, row-major `[steps, m]`.
fn inputs(system: &VehicleLoop, plan: &FlightPlan, steps: u64) -> Result<Vec<f64>> {
    let m = system.n_input();
    let dt = plan.physics.dt;
    let mut wind = WindState::new(plan.wind.clone(), Stream::new(plan.seed, 0, 0, Purpose::WIND))?;
    let mut air = Disturbance::none();
    let mut rows = vec![0.0; steps as usize * m];
    for (k, row) in rows.chunks_exact_mut(m).enumerate() {
        if plan.wind != Wind::Calm {
            air.wind = wind.sample(dt);
        }
        let target = Target { reference: &plan.reference, tilt: &plan.tilt };
        system.write_input(k as u64, target, &air, row);
    }
    Ok(rows)
}
