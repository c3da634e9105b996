//! Gains by gradient descent through closed-loop flights.
//!
//! θ = ln K, so gains stay positive and steps are relative. The cost of one flight is the mean squared position error
//! along the reference from a random start; its gradient comes backwards through every step of the closed loop, motor
//! lag, saturation and sampled controllers included ([`BatchRollout`], 64 flights to a block). Adam (Kingma and Ba
//! 2015) descends on the root of the mean over the starts. The best gains on the training starts are kept; held-out
//! starts judge, in `f64`.
//!
//! Without a [`MarginGate`](super::MarginGate) robustness is not part of the objective, and margins shrink while the error falls; they
//! are measured before and after. With one, while the least disk margin over its corners is short of 1.06 times what is asked, the descent
//! leaves out what lowers it and climbs it as well: its slope over ln K comes from differences at the corner that is worst, and the gains
//! are the best of those that passed.

use super::gain_evaluation::evaluate_along;
pub use super::gain_evaluation::{CRASH_DISTANCE, GainEvaluation, elsewhere, evaluate};
use super::loop_model::LoopMargins;
use super::margin_constraint::Constraint;
use super::margin_gate::{Flown, MarginReport};
pub use super::tune_plan::{MAX_STARTS, TunePlan};
use super::tuned_loop::{LogGains, MeanSquaredError, TRAINING, gains_of, inputs, plant_of, starts};
use crate::cascade_law::CascadeLaw;
use crate::closed_loop::ClosedLoop;
use crate::law::{ControlLaw, LawController};
use crate::parameters::{GainSet, validate_gains};
use crate::reference::Reference;
use autodiff::batch_rollout::BatchRollout;
use base::error::{Error, Result};
use base::parallel::Threads;
use dynamics::{Gains, Plant, Vehicle};
use serde::Serialize;
use std::ops::ControlFlow;

/// One descent step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Iteration {
    /// From 0.
    pub iteration: usize,
    /// Root of the mean squared error over all training flights before the step, its mean over the references, m.
    pub rmse: f64,
    /// ‖∂/∂ln K‖ of it, m; with a gate, of where the descent goes.
    pub gradient_norm: f64,
}

/// Flights along one reference, from held-out starts and on held-out plants.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AlongReference {
    /// The reference.
    pub reference: Reference,
    /// Whether it was not tuned on.
    pub held_out: bool,
    /// With the gains that tuning started from.
    pub before: GainEvaluation,
    /// With the best gains.
    pub after: GainEvaluation,
}

/// The result of tuning.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tuning {
    /// The best gains.
    pub gains: Gains,
    /// The descent.
    pub history: Vec<Iteration>,
    /// Held-out flights, along the references that were tuned on, with the gains it started from.
    pub before: GainEvaluation,
    /// The same with the best gains.
    pub after: GainEvaluation,
    /// Flights along every reference, those tuned on before those held out.
    pub references: Vec<AlongReference>,
    /// Where references are held out: all flights along them with the gains it started from, and with the best.
    pub held_out: Option<[GainEvaluation; 2]>,
    /// `elsewhere` with the gains it started from.
    pub elsewhere_before: GainEvaluation,
    /// `elsewhere` with the best gains.
    pub elsewhere_after: GainEvaluation,
    /// Margins of all commands at hover with the gains it started from, and with the best.
    pub margins: [LoopMargins; 2],
    /// With a gate: how both fare there.
    pub judged: Option<[MarginReport; 2]>,
}

impl Tuning {
    /// Whether the tuned gains lose flights, or a larger error, where they were not tuned, or a margin falls.
    pub fn is_less_robust(&self) -> bool {
        self.is_worse_elsewhere() || self.is_worse_held_out() || !self.fallen().is_empty()
    }

    /// Whether the tuned gains lose more flights on the references that were held out, or as many and are less exact in the mean.
    pub fn is_worse_held_out(&self) -> bool {
        self.held_out.is_some_and(|[before, after]| {
            after.crashed > before.crashed || (after.crashed == before.crashed && after.rmse > before.rmse)
        })
    }

    /// Whether the tuned gains lose flights, or a larger error at the worst, where they were not tuned.
    pub fn is_worse_elsewhere(&self) -> bool {
        let [before, after] = [&self.elsewhere_before, &self.elsewhere_after];
        after.crashed > before.crashed || after.worst > before.worst
    }

    /// Margins of all commands at hover that fell by more than a tenth: name with its unit, before, after.
    pub fn fallen(&self) -> Vec<(&'static str, f64, f64)> {
        let [before, after] = &self.margins;
        let rows = [
            ("gain margin", before.gain_up, after.gain_up),
            ("phase margin [°]", before.phase.to_degrees(), after.phase.to_degrees()),
            ("delay margin [ms]", 1e3 * before.delay, 1e3 * after.delay),
            ("disk margin", before.disk.alpha, after.disk.alpha),
        ];
        rows.into_iter().filter(|(_, before, after)| *after < 0.9 * before).collect()
    }
}

/// Tunes all gains of a vehicle's cascade from `gains`, those of integral action where it has some; `watch` sees each step, and
/// may break behind it: the best gains so far are then judged.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] if vehicle, gains or plan are not valid; a gain of zero cannot be tuned, since
/// steps are relative.
pub fn tune(
    vehicle: &Vehicle,
    gains: &Gains,
    plan: &TunePlan,
    watch: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Tuning> {
    vehicle.check_steerable()?;
    validate_gains(gains)?;
    let threads = Threads::default();
    let law = CascadeLaw::new(vehicle, &plan.physics, gains, &plan.rates)?;
    let training = Training::new(vehicle, law, plan)?;
    let batch = BatchRollout::new(&training.system, &MeanSquaredError::over(plan.n_step()?))?;
    let mut descent = Descent::new(training.theta()?, plan.learning_rate, plan.iterations);
    let mut constraint = plan.margins.as_ref().map(|gate| Constraint::new(vehicle, gains, plan, gate)).transpose()?;
    for iteration in 0..plan.iterations {
        let (rmse, mut gradient) = training.cost(&batch, &descent.theta, &threads)?;
        if let Some(constraint) = &mut constraint {
            constraint.lead(iteration, &descent.theta, rmse, &mut gradient, &threads)?;
        }
        let gradient_norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        let step = Iteration { iteration, rmse, gradient_norm };
        let stopped = watch(&step).is_break();
        descent.step(step, &gradient);
        if stopped {
            break;
        }
    }
    let tuned = match &constraint {
        None => gains_of(&descent.best),
        Some(constraint) => constraint.best(&threads)?,
    };
    judged(vehicle, [gains, &tuned], plan, descent.history, &threads)
}

/// The gains that tuning started from and those it came to, side by side.
fn judged(
    vehicle: &Vehicle,
    both: [&Gains; 2],
    plan: &TunePlan,
    history: Vec<Iteration>,
    threads: &Threads,
) -> Result<Tuning> {
    let judged = match &plan.margins {
        None => None,
        Some(gate) => {
            let [a, b] = both.map(|g| gate.judge(vehicle, g, &plan.physics, &plan.rates, threads));
            Some([a?, b?])
        }
    };
    let n_tuned_on = plan.references().count();
    let along = |(of, reference): (usize, &Reference)| -> Result<AlongReference> {
        let [before, after] = both.map(|g| evaluate_along(vehicle, g, plan, of));
        let held_out = of >= n_tuned_on;
        Ok(AlongReference { reference: reference.clone(), held_out, before: before?, after: after? })
    };
    let references: Vec<AlongReference> = plan.all_references().enumerate().map(along).collect::<Result<_>>()?;
    let of = |held_out: bool, after: bool| {
        let own = references.iter().filter(|r| r.held_out == held_out);
        GainEvaluation::together(own.map(|r| if after { &r.after } else { &r.before }))
    };
    let [elsewhere_before, elsewhere_after] = both.map(|g| elsewhere(vehicle, g, plan));
    let [first, last] = both.map(|g| {
        let still = Flown::in_still_air(vehicle, g, &plan.physics, &plan.rates);
        Flown { latency: plan.latency, ..still }.hover_margins()
    });
    Ok(Tuning {
        gains: *both[1],
        history,
        before: of(false, false),
        after: of(false, true),
        held_out: (!plan.held_out.is_empty()).then(|| [of(true, false), of(true, true)]),
        references,
        elsewhere_before: elsewhere_before?,
        elsewhere_after: elsewhere_after?,
        margins: [first?, last?],
        judged,
    })
}

/// What is flown in every step of the descent.
pub(super) struct Training<L> {
    pub system: LogGains<L>,
    /// Per reference: inputs `[T, m]` and starts `[n_start, n_state]`.
    flights: Vec<(Vec<f64>, Vec<f32>)>,
}

impl<L: ControlLaw> Training<L> {
    pub fn new(vehicle: &Vehicle, law: L, plan: &TunePlan) -> Result<Self> {
        let (n_step, plant) = (plan.n_step()?, Plant::of_vehicle(vehicle, plan.physics)?);
        let closed = ClosedLoop::new(plant, LawController::of(law))?.with_latency(plan.latency)?;
        let drawn = plan.plant_spread > 0.0;
        let system = if drawn { LogGains::of_drawn_plants(closed, vehicle)? } else { LogGains::new(closed) };
        let flights = |(of, reference): (usize, &Reference)| -> Result<(Vec<f64>, Vec<f32>)> {
            let mut starts = starts(&system.closed, plan, reference, (TRAINING, of), plan.n_start)?;
            for (i, start) in starts.iter_mut().enumerate().filter(|_| drawn) {
                let plant = plant_of(plan, TRAINING, of, i);
                start.extend([plant.mass, plant.inertia, plant.lag]);
            }
            Ok((inputs(&system.closed, reference, n_step), starts.concat().into_iter().map(|v| v as f32).collect()))
        };
        let flights = plan.references().enumerate().map(flights).collect::<Result<_>>()?;
        Ok(Self { system, flights })
    }

    /// ln K to begin with.
    pub fn theta(&self) -> Result<Vec<f64>> {
        let mut theta = self.system.gains();
        if let Some(i) = theta.iter().take(GainSet::<f64>::DIM).position(|k| *k <= 0.0) {
            let remedy = "Steps are relative: start from a small gain.";
            return Err(Error::value(format!("gain {i}"), theta[i], "> 0", remedy));
        }
        theta.iter_mut().for_each(|k| *k = k.ln());
        Ok(theta)
    }

    /// The root of the mean squared error, its mean over the references, and its gradient.
    pub fn cost(&self, batch: &BatchRollout, theta: &[f64], threads: &Threads) -> Result<(f64, Vec<f64>)> {
        let share = 1.0 / self.flights.len() as f64;
        let each = threads.map(self.flights.len(), |of| {
            let (inputs, starts) = &self.flights[of];
            root_mean_cost(batch, starts, inputs, theta, threads)
        });
        let (mut rmse, mut gradient) = (0.0, vec![0.0; theta.len()]);
        for one in each {
            let (error, slope) = one?;
            rmse += share * error;
            gradient.iter_mut().zip(slope).for_each(|(sum, g)| *sum += share * g);
        }
        Ok((rmse, gradient))
    }
}

/// √J̄ over the starts that stayed finite, and its gradient ∂J̄/(2√J̄).
fn root_mean_cost(
    batch: &BatchRollout,
    starts: &[f32],
    inputs: &[f64],
    theta: &[f64],
    threads: &Threads,
) -> Result<(f64, Vec<f64>)> {
    let result = batch.gradient(starts, inputs, theta, threads)?;
    let finite = result.costs.iter().map(|c| f64::from(*c)).filter(|c| c.is_finite());
    let mean = finite.sum::<f64>() / result.n_finite.max(1) as f64;
    let rmse = mean.sqrt();
    // starts that diverge make gains unwelcome without a gradient
    let lost = (result.costs.len() - result.n_finite) as f64 / result.costs.len() as f64;
    let gradient = result.parameters.iter().map(|g| g / (2.0 * rmse.max(1e-9))).collect();
    Ok((rmse + 10.0 * lost, gradient))
}

/// Adam with a falling rate, and the best point seen.
pub struct Descent {
    /// Parameters now; of [`tune`] the logarithms of the gains.
    pub theta: Vec<f64>,
    mean: Vec<f64>,
    square: Vec<f64>,
    /// The parameters whose error was least.
    pub best: Vec<f64>,
    best_rmse: f64,
    /// Of all steps.
    pub history: Vec<Iteration>,
    rate: f64,
    n: usize,
}

impl Descent {
    /// For `n` steps from `theta`; the step size falls linearly from `rate` to a tenth of it.
    pub fn new(theta: Vec<f64>, rate: f64, n: usize) -> Self {
        let zero = vec![0.0; theta.len()];
        Self {
            best: theta.clone(),
            theta,
            mean: zero.clone(),
            square: zero,
            best_rmse: f64::INFINITY,
            history: Vec::with_capacity(n),
            rate,
            n,
        }
    }

    /// One step θ⁺ = θ − rate m̂/(√v̂ + 1e-8) against a gradient of the length of θ, with the means m̂ (decay 0.9) and v̂ (0.99) of
    /// Adam; `iteration` belongs to the point before the step. Entries that are not finite move nothing.
    pub fn step(&mut self, iteration: Iteration, gradient: &[f64]) {
        self.history.push(iteration);
        if iteration.rmse < self.best_rmse {
            self.best_rmse = iteration.rmse;
            self.best.copy_from_slice(&self.theta);
        }
        const DECAY: (f64, f64) = (0.9, 0.99);
        let t = self.history.len() as i32;
        let progress = f64::from(t) / self.n as f64;
        let rate = self.rate * (1.0 - 0.9 * progress);
        for (i, g) in gradient.iter().enumerate().filter(|(_, g)| g.is_finite()) {
            self.mean[i] += (1.0 - DECAY.0) * (g - self.mean[i]);
            self.square[i] += (1.0 - DECAY.1) * (g * g - self.square[i]);
            let mean = self.mean[i] / (1.0 - DECAY.0.powi(t));
            let square = self.square[i] / (1.0 - DECAY.1.powi(t));
            self.theta[i] -= rate * mean / (square.sqrt() + 1e-8);
        }
    }
}
