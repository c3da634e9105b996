//! How gains fare on flights that [`tune`](mod@super::tune) never saw: other starts and plants, other references, elsewhere.

use super::margin_gate::truth;
use super::tune_plan::TunePlan;
use super::tuned_loop::{HELD_OUT, LoopOf, MeanSquaredError, inputs, plant_of, starts};
use crate::cascade_law::CascadeLaw;
use crate::closed_loop::ClosedLoop;
use crate::controller::Target;
use crate::law::{ControlLaw, LawController};
use crate::monte_carlo::{MonteCarlo, MonteCarloDraw, MonteCarloResult};
use crate::reference::Reference;
use crate::start::start_on;
use autodiff::System;
use autodiff::rollout::{Forward, StepCode, advance};
use base::error::Result;
use base::parallel::Threads;
use dynamics::{Gains, Plant, Vehicle};
use rng::Stream;
use serde::Serialize;

/// Flights with one set of gains.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GainEvaluation {
    /// Mean over the flights of their RMSE, the start included, m; over those that did not crash, infinite where all did.
    pub rmse: f64,
    /// Largest of them; infinite where all crashed.
    pub worst: f64,
    /// Flights that diverged or left the reference by more than 5 m (`CRASH_DISTANCE`).
    pub crashed: usize,
    /// Flights.
    pub n: usize,
}

/// Distance from the reference at which a flight counts as crashed, m.
pub const CRASH_DISTANCE: f64 = 5.0;

impl GainEvaluation {
    /// Of RMSEs, none for a crash.
    fn of(errors: &[Option<f64>]) -> Self {
        let flown: Vec<f64> = errors.iter().flatten().copied().collect();
        Self {
            rmse: if flown.is_empty() { f64::INFINITY } else { flown.iter().sum::<f64>() / flown.len() as f64 },
            worst: flown.iter().copied().reduce(f64::max).unwrap_or(f64::INFINITY),
            crashed: errors.len() - flown.len(),
            n: errors.len(),
        }
    }

    /// Some evaluations as one, each counting as much as it has flights.
    pub(super) fn together<'a>(all: impl Iterator<Item = &'a Self>) -> Self {
        let none = Self { rmse: 0.0, worst: 0.0, crashed: 0, n: 0 };
        let (sum, flown) = all.fold((none, 0), |(sum, flown), one| {
            let own = one.n - one.crashed;
            let rmse = sum.rmse + if own > 0 { own as f64 * one.rmse } else { 0.0 };
            let worst = if own > 0 { sum.worst.max(one.worst) } else { sum.worst };
            (Self { rmse, worst, crashed: sum.crashed + one.crashed, n: sum.n + one.n }, flown + own)
        });
        // a flight that crashed has no error
        if flown == 0 {
            return Self { rmse: f64::INFINITY, worst: f64::INFINITY, ..sum };
        }
        Self { rmse: sum.rmse / flown as f64, ..sum }
    }
}

/// How much later commands act `elsewhere`, s.
const LATE: f64 = 0.01;

/// Flies given gains where they are not tuned: the first of circle, lemniscate and step that is no reference of the plan,
/// commands 10 ms later, and as many plants as the plan holds out, none as believed: mass and inertia 0.8 to 1.25 times, thrust
/// of each rotor 0.85 to 1.1 times, lag of each motor 0.7 to 1.5 times.
///
/// # Errors
/// As [`tune`](super::tune()).
pub fn elsewhere(vehicle: &Vehicle, gains: &Gains, plan: &TunePlan) -> Result<GainEvaluation> {
    plan.n_step()?;
    elsewhere_of(vehicle, ClosedLoop::of_vehicle(vehicle, plan.physics, gains, &plan.rates)?, plan)
}

/// The same of any law.
pub(super) fn elsewhere_of<L: ControlLaw>(
    vehicle: &Vehicle,
    loop_of: LoopOf<L>,
    plan: &TunePlan,
) -> Result<GainEvaluation> {
    let n_step = plan.n_step()? as u64;
    let tuned_on = |name: &str| plan.references().any(|r| r.name() == name);
    let other = ["circle", "lemniscate", "step"].into_iter().find(|name| !tuned_on(name)).unwrap_or("hover");
    let reference = Reference::by_name(other)?;
    let late = plan.latency + (LATE / plan.physics.dt).round() as usize;
    let system = loop_of.with_latency(late)?.with_physics();
    let body = [system.parameter("mass")?, system.parameter("inertia_xx")?];
    let of = |what: &str| -> Result<Vec<usize>> {
        vehicle.rotors.iter().map(|r| system.parameter(&format!("{}.{what}", r.name))).collect()
    };
    let [thrusts, ups, downs] = [of("thrust_coefficient")?, of("time_constant_up")?, of("time_constant_down")?];
    let draw = |stream: &mut Stream, one: &mut MonteCarloDraw| {
        one.parameters[body[0]] *= stream.uniform(0.8, 1.25);
        let inertia = stream.uniform(0.8, 1.25);
        one.parameters[body[1]..body[1] + 6].iter_mut().for_each(|j| *j *= inertia);
        for i in 0..thrusts.len() {
            one.parameters[thrusts[i]] *= stream.uniform(0.85, 1.1);
            let lag = stream.uniform(0.7, 1.5);
            one.parameters[ups[i]] *= lag;
            one.parameters[downs[i]] *= lag;
        }
    };
    let start = start_on(system.plant(), system.controller(), &reference)?;
    let many = MonteCarlo::new(&system)?.seeded(plan.seed);
    let size = (plan.n_held_out, n_step);
    let flown = many.fly(Target::level(&reference), &start, size, &draw, &Threads::default())?;
    let held = |o: &MonteCarloResult| o.lost_at.is_none() && o.worst < CRASH_DISTANCE;
    Ok(GainEvaluation::of(&flown.iter().map(|o| held(o).then_some(o.rmse)).collect::<Vec<_>>()))
}

/// Flies the held-out starts of a plan, along the references it tunes on, with given gains, in `f64`.
///
/// # Errors
/// As [`tune`](super::tune()).
pub fn evaluate(vehicle: &Vehicle, gains: &Gains, plan: &TunePlan) -> Result<GainEvaluation> {
    plan.n_step()?;
    let each: Vec<GainEvaluation> =
        (0..plan.references().count()).map(|of| evaluate_along(vehicle, gains, plan, of)).collect::<Result<_>>()?;
    Ok(GainEvaluation::together(each.iter()))
}

/// The same along one reference: a number among those tuned on, then those held out.
pub(super) fn evaluate_along(vehicle: &Vehicle, gains: &Gains, plan: &TunePlan, of: usize) -> Result<GainEvaluation> {
    along_with(vehicle, &CascadeLaw::new(vehicle, &plan.physics, gains, &plan.rates)?, plan, of)
}

/// The same of any law.
pub(super) fn along_with<L: ControlLaw + Clone>(
    vehicle: &Vehicle,
    law: &L,
    plan: &TunePlan,
    of: usize,
) -> Result<GainEvaluation> {
    let loop_of = |truth: &Vehicle| -> Result<LoopOf<L>> {
        let plant = Plant::of_vehicle(truth, plan.physics)?;
        ClosedLoop::new(plant, LawController::of(law.clone()))?.with_latency(plan.latency)
    };
    let believed = loop_of(vehicle)?;
    let reference = plan.all_references().nth(of).unwrap_or(&plan.reference);
    let inputs = inputs(&believed, reference, plan.n_step()?);
    let starts = starts(&believed, plan, reference, (HELD_OUT, of), plan.n_held_out)?;
    let code = StepCode::of(&believed, &MeanSquaredError::over(1));
    let flown = Threads::default().map(starts.len(), |i| -> Result<Option<f64>> {
        // as in lanes, where flights differ in their start alone
        let start: Vec<f64> = starts[i].iter().map(|v| f64::from(*v as f32)).collect();
        if plan.plant_spread == 0.0 {
            let n_step = (inputs.len() / believed.n_input()) as u64;
            return Ok(flight_rmse(&believed, code.for_steps(n_step), &start, &inputs));
        }
        let truth = loop_of(&truth(vehicle, &plant_of(plan, HELD_OUT, of, i)))?;
        Ok(flight_rmse(&truth, None, &start, &inputs))
    });
    Ok(GainEvaluation::of(&flown.into_iter().collect::<Result<Vec<_>>>()?))
}

/// RMSE of one flight, by code of its step where there is some; `None` if it crashed.
fn flight_rmse<L: ControlLaw>(
    system: &LoopOf<L>,
    mut code: Option<Forward>,
    start: &[f64],
    inputs: &[f64],
) -> Option<f64> {
    // a state and the one behind it, in turns
    let (mut states, mut sum) = ([start, start].concat(), 0.0);
    let steps = inputs.chunks_exact(system.n_input());
    let n_step = steps.len() as f64;
    for u in steps {
        let squared: f64 = (0..3).map(|i| (states[i] - u[i]).powi(2)).sum();
        if squared.is_nan() || squared >= CRASH_DISTANCE * CRASH_DISTANCE {
            return None;
        }
        sum += squared;
        advance(system, &mut code, &mut states, u, &[]);
    }
    Some((sum / n_step).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use autodiff::native::availability;
    use dynamics::vehicles;

    #[test]
    fn a_flight_has_the_same_error_to_the_bit_by_code_of_its_step() {
        for name in ["hummingbird", "firefly"] {
            let vehicle = vehicles::by_name(name).unwrap();
            let plan = TunePlan { n_held_out: 3, duration: 1.0, ..TunePlan::default() };
            let law = CascadeLaw::new(&vehicle, &plan.physics, &vehicle.gains(), &plan.rates).unwrap();
            let plant = Plant::of_vehicle(&vehicle, plan.physics).unwrap();
            let system = ClosedLoop::new(plant, law.running()).unwrap().with_latency(2).unwrap();
            let inputs = inputs(&system, &plan.reference, plan.n_step().unwrap());
            let code = StepCode::of(&system, &MeanSquaredError::over(1)).for_steps(u64::MAX);
            assert_eq!(code.is_some(), availability().is_ok());
            for start in starts(&system, &plan, &plan.reference, (HELD_OUT, 0), plan.n_held_out).unwrap() {
                let [by_code, alone] = [code.clone(), None].map(|code| flight_rmse(&system, code, &start, &inputs));
                assert!(alone.is_some() && by_code.map(f64::to_bits) == alone.map(f64::to_bits), "{name}: {alone:?}");
                let lost: Vec<f64> = start.iter().enumerate().map(|(k, x)| if k == 0 { x + 1e3 } else { *x }).collect();
                assert_eq!(flight_rmse(&system, code.clone(), &lost, &inputs), None);
            }
        }
    }
}
