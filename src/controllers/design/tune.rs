//! Gains by gradient descent through closed-loop flights.
//!
//! θ = ln K, so gains stay positive and steps are relative. The cost of one flight is the mean squared position error
//! along the reference from a random start; its gradient comes backwards through every step of the closed loop, motor
//! lag, saturation and sampled controllers included ([`BatchRollout`], 64 flights to a block). Adam (Kingma and Ba
//! 2015) descends on the root of the mean over the starts. The best gains on the training starts are kept; held-out
//! starts judge, in `f64`.
//!
//! Without a [`MarginGate`] robustness is not part of the objective, and margins shrink while the error falls; they are measured
//! before and after. With one, while the least disk margin over its corners is short of 1.06 times what is asked, the descent
//! leaves out what lowers it and climbs it as well: its slope over ln K comes from differences at the corner that is worst, and the gains are the best of those
//! that passed.

use super::loop_model::LoopMargins;
use super::margin_constraint::Constraint;
use super::margin_gate::{Flown, Judgement, MarginGate};
use crate::autodiff::batch_rollout::BatchRollout;
use crate::autodiff::{Objective, Scalar, System};
use crate::controllers::cascade::Rates;
use crate::controllers::cascade_law::CascadeLaw;
use crate::controllers::closed_loop::{ClosedLoop, check_latency};
use crate::controllers::controller::Target;
use crate::controllers::law::Running;
use crate::controllers::monte_carlo::{MonteCarlo, MonteCarloDraw, MonteCarloResult};
use crate::controllers::parameters::{GainSet, validate_gains};
use crate::controllers::reference::Reference;
use crate::controllers::start::start_on;
use crate::dynamics::spatial::from_euler;
use crate::dynamics::{Disturbance, Gains, Physics, Vehicle};
use crate::error::{Error, Result};
use crate::parallel::Threads;
use crate::rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};

/// What to tune on, and for how long.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TunePlan {
    /// The reference of every flight.
    pub reference: Reference,
    /// Length of a flight, s.
    pub duration: f64,
    /// Time step, integrator, effects.
    pub physics: Physics,
    /// How often each control level computes.
    pub rates: Rates,
    /// Training starts.
    pub n_start: usize,
    /// Held-out starts, drawn from other streams.
    pub n_held_out: usize,
    /// Largest offset of a start from the reference, m per axis.
    pub position_spread: f64,
    /// Largest velocity of a start, m/s per axis.
    pub velocity_spread: f64,
    /// Largest roll and pitch of a start, rad; yaw spreads twice as far.
    pub tilt_spread: f64,
    /// Descent steps.
    pub iterations: usize,
    /// Relative change of a gain per step, at first; it falls to a tenth by the end.
    pub learning_rate: f64,
    /// Of the starts.
    pub seed: u64,
    /// Further references, of the same weight as the first.
    pub also: Vec<Reference>,
    /// Steps by which commands act late.
    pub latency: usize,
    /// What the gains have to bear.
    pub margins: Option<MarginGate>,
}

impl Default for TunePlan {
    /// Six seconds of the lemniscate from 64 starts within 0.3 m, 0.3 m/s and 0.2 rad, 60 descent steps.
    fn default() -> Self {
        Self {
            reference: Reference::Lemniscate(Default::default()),
            duration: 6.0,
            physics: Physics::default(),
            rates: Rates::default(),
            n_start: 64,
            n_held_out: 256,
            position_spread: 0.3,
            velocity_spread: 0.3,
            tilt_spread: 0.2,
            iterations: 60,
            learning_rate: 0.08,
            seed: 0,
            also: Vec::new(),
            latency: 0,
            margins: None,
        }
    }
}

/// Largest number of starts or held-out starts.
pub const MAX_STARTS: usize = 1 << 16;

impl TunePlan {
    /// All references.
    pub fn references(&self) -> impl Iterator<Item = &Reference> {
        std::iter::once(&self.reference).chain(&self.also)
    }

    fn n_step(&self) -> Result<usize> {
        self.physics.validate()?;
        self.references().try_for_each(Reference::validate)?;
        check_latency(self.latency)?;
        self.margins.iter().try_for_each(MarginGate::validate)?;
        for (what, n, least, most) in [
            ("n_start", self.n_start, 1, MAX_STARTS),
            ("n_held_out", self.n_held_out, 1, MAX_STARTS),
            ("iterations", self.iterations, 1, 100_000),
        ] {
            if n < least || n > most {
                return Err(Error::limit(what, n, format!("{least} to {most}"), "The defaults are a good start."));
            }
        }
        for (what, value, most) in [
            ("position_spread", self.position_spread, 100.0),
            ("velocity_spread", self.velocity_spread, 100.0),
            ("tilt_spread", self.tilt_spread, 1.5),
            ("learning_rate", self.learning_rate, 1.0),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err(Error::value(what, value, format!("in [0, {most}]"), "Leave it out for the default."));
            }
        }
        let steps = (self.duration / self.physics.dt).round();
        if !(1.0..=100_000.0).contains(&steps) {
            let value = format!("{} s ({steps} steps of {} s)", self.duration, self.physics.dt);
            return Err(Error::limit("duration", value, "1 to 100000 steps", "Tune on a shorter flight."));
        }
        Ok(steps as usize)
    }
}

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

/// Flights with one set of gains.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Evaluation {
    /// Mean over the flights of their RMSE, the start included, m; over those that did not crash.
    pub rmse: f64,
    /// Largest of them.
    pub worst: f64,
    /// Flights that diverged or left the reference by more than [`CRASH_DISTANCE`].
    pub crashed: usize,
    /// Flights.
    pub n: usize,
}

/// Distance from the reference at which a flight counts as crashed, m.
pub const CRASH_DISTANCE: f64 = 5.0;

/// The result of tuning.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tuning {
    /// The best gains.
    pub gains: Gains,
    /// The descent.
    pub history: Vec<Iteration>,
    /// Held-out flights with the gains it started from.
    pub before: Evaluation,
    /// Held-out flights with the best gains.
    pub after: Evaluation,
    /// [`elsewhere`] with the gains it started from.
    pub elsewhere_before: Evaluation,
    /// [`elsewhere`] with the best gains.
    pub elsewhere_after: Evaluation,
    /// Margins of all commands at hover with the gains it started from, and with the best.
    pub margins: [LoopMargins; 2],
    /// With a gate: how both fare there.
    pub judged: Option<[Judgement; 2]>,
}

impl Tuning {
    /// Whether the tuned gains lose flights, or a larger error at the worst, where they were not tuned, or a margin falls.
    pub fn is_less_robust(&self) -> bool {
        self.is_worse_elsewhere() || !self.fallen().is_empty()
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

/// ‖p − p_ref‖²/T per step.
pub(super) struct MeanSquaredError {
    per_step: f64,
}

impl MeanSquaredError {
    pub(super) fn over(steps: usize) -> Self {
        Self { per_step: 1.0 / steps as f64 }
    }
}

impl Objective for MeanSquaredError {
    #[inline(always)]
    fn stage<S: Scalar>(&self, state: &[S], input: &[S], _: &[S]) -> S {
        let mut sum = S::zero();
        for i in 0..3 {
            sum += (state[i] - input[i]).square();
        }
        S::constant(self.per_step) * sum
    }
}

/// Gains of a cascade with integral action.
const MOST_GAINS: usize = GainSet::<f64>::DIM + 2;

/// A vehicle under its cascade.
pub(super) type VehicleLoop = ClosedLoop<Running<CascadeLaw>>;

/// The closed loop with θ = ln K.
pub(super) struct LogGains(pub(super) VehicleLoop);

impl System for LogGains {
    fn n_state(&self) -> usize {
        self.0.n_state()
    }
    fn n_input(&self) -> usize {
        self.0.n_input()
    }
    fn n_parameter(&self) -> usize {
        self.0.n_parameter()
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        let mut gains = [S::zero(); MOST_GAINS];
        for (gain, log) in gains.iter_mut().zip(parameters) {
            *gain = log.exp();
        }
        self.0.step(state, input, &gains[..parameters.len()], next);
    }
}

/// Tunes all gains of a vehicle's cascade from `gains`, those of integral action where it has some; `progress` sees each step.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] if vehicle, gains or plan are not valid; a gain of zero cannot be tuned, since
/// steps are relative.
pub fn tune(vehicle: &Vehicle, gains: &Gains, plan: &TunePlan, progress: &mut dyn FnMut(&Iteration)) -> Result<Tuning> {
    let n_step = plan.n_step()?;
    validate_gains(gains)?;
    let closed = ClosedLoop::of_vehicle(vehicle, plan.physics, gains, &plan.rates)?.with_latency(plan.latency)?;
    let system = LogGains(closed.with_gains());
    let mut theta = system.0.parameters();
    if let Some(i) = theta.iter().take(GainSet::<f64>::DIM).position(|k| *k <= 0.0) {
        return Err(Error::value(format!("gain {i}"), theta[i], "> 0", "Steps are relative: start from a small gain."));
    }
    theta.iter_mut().for_each(|k| *k = k.ln());

    let threads = Threads::default();
    let flights: Vec<Vec<f64>> = plan.references().map(|reference| inputs(&system.0, reference, n_step)).collect();
    let share = 1.0 / flights.len() as f64;
    let starts: Vec<Vec<f32>> =
        plan.references().map(|r| starts(&system.0, plan, r, plan.n_start, TRAINING)).collect::<Result<_>>()?;
    let batch = BatchRollout::new(&system, &MeanSquaredError::over(n_step))?;
    let mut descent = Descent::new(theta, plan.learning_rate, plan.iterations);
    let mut constraint = plan.margins.as_ref().map(|gate| Constraint::new(vehicle, gains, plan, gate)).transpose()?;
    for iteration in 0..plan.iterations {
        let (mut rmse, mut gradient) = (0.0, vec![0.0; descent.theta.len()]);
        for (inputs, starts) in flights.iter().zip(&starts) {
            let (error, slope) = root_mean_cost(&batch, starts, inputs, &descent.theta, &threads)?;
            rmse += share * error;
            gradient.iter_mut().zip(slope).for_each(|(sum, g)| *sum += share * g);
        }
        if let Some(constraint) = &mut constraint {
            constraint.lead(iteration, &descent.theta, rmse, &mut gradient, &threads)?;
        }
        let gradient_norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        let step = Iteration { iteration, rmse, gradient_norm };
        progress(&step);
        descent.step(step, &gradient);
    }
    let tuned = match &constraint {
        None => gains_of(&descent.best),
        Some(constraint) => constraint.best(&threads)?,
    };
    let both = [gains, &tuned];
    let judged = match &plan.margins {
        None => None,
        Some(gate) => {
            let [a, b] = both.map(|g| gate.judge(vehicle, g, &plan.physics, &plan.rates, &threads));
            Some([a?, b?])
        }
    };
    let [before, after] = both.map(|g| evaluate(vehicle, g, plan));
    let [elsewhere_before, elsewhere_after] = both.map(|g| elsewhere(vehicle, g, plan));
    let [first, last] =
        both.map(|gains| Flown { vehicle, gains, physics: &plan.physics, rates: &plan.rates }.hover_margins());
    Ok(Tuning {
        gains: tuned,
        history: descent.history,
        before: before?,
        after: after?,
        elsewhere_before: elsewhere_before?,
        elsewhere_after: elsewhere_after?,
        margins: [first?, last?],
        judged,
    })
}

/// How much later commands act [`elsewhere`], s.
const LATE: f64 = 0.01;

/// Flies given gains where they are not tuned: the first of circle, lemniscate and step that is no reference of the plan,
/// commands 10 ms later, and as many plants as the plan holds out, none as believed: mass and inertia 0.8 to 1.25 times, thrust
/// of each rotor 0.85 to 1.1 times, lag of each motor 0.7 to 1.5 times.
///
/// # Errors
/// As [`tune`].
pub fn elsewhere(vehicle: &Vehicle, gains: &Gains, plan: &TunePlan) -> Result<Evaluation> {
    let n_step = plan.n_step()? as u64;
    let tuned_on = |name: &str| plan.references().any(|r| r.name() == name);
    let other = ["circle", "lemniscate", "step"].into_iter().find(|name| !tuned_on(name)).unwrap_or("hover");
    let reference = Reference::by_name(other)?;
    let late = plan.latency + (LATE / plan.physics.dt).round() as usize;
    let loop_of = ClosedLoop::of_vehicle(vehicle, plan.physics, gains, &plan.rates)?;
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
    let held = |o: &&MonteCarloResult| o.lost_at.is_none() && o.worst < CRASH_DISTANCE;
    let (n, kept): (usize, Vec<&MonteCarloResult>) = (flown.len(), flown.iter().filter(held).collect());
    Ok(Evaluation {
        rmse: kept.iter().map(|o| o.rmse).sum::<f64>() / kept.len().max(1) as f64,
        worst: kept.iter().fold(0.0, |most, o| most.max(o.rmse)),
        crashed: n - kept.len(),
        n,
    })
}

/// Flies the held-out starts of a plan with given gains, in `f64`.
///
/// # Errors
/// As [`tune`].
pub fn evaluate(vehicle: &Vehicle, gains: &Gains, plan: &TunePlan) -> Result<Evaluation> {
    let n_step = plan.n_step()?;
    let system = ClosedLoop::of_vehicle(vehicle, plan.physics, gains, &plan.rates)?.with_latency(plan.latency)?;
    let mut errors = Vec::new();
    for reference in plan.references() {
        let inputs = inputs(&system, reference, n_step);
        let starts = starts(&system, plan, reference, plan.n_held_out, HELD_OUT)?;
        let flights: Vec<&[f32]> = starts.chunks(system.n_state()).collect();
        errors.extend(Threads::default().map(flights.len(), |i| {
            let start: Vec<f64> = flights[i].iter().map(|v| f64::from(*v)).collect();
            flight_rmse(&system, &start, &inputs)
        }));
    }
    let flown: Vec<f64> = errors.iter().flatten().copied().collect();
    let n = errors.len();
    Ok(Evaluation {
        rmse: flown.iter().sum::<f64>() / flown.len().max(1) as f64,
        worst: flown.iter().fold(0.0, |a: f64, b| a.max(*b)),
        crashed: n - flown.len(),
        n,
    })
}

/// RMSE of one flight; `None` if it crashed.
fn flight_rmse(system: &VehicleLoop, start: &[f64], inputs: &[f64]) -> Option<f64> {
    let mut x = start.to_vec();
    let mut next = x.clone();
    let mut sum = 0.0;
    let steps = inputs.chunks_exact(system.n_input());
    let n = steps.len() as f64;
    for u in steps {
        let squared: f64 = (0..3).map(|i| (x[i] - u[i]).powi(2)).sum();
        if squared.is_nan() || squared >= CRASH_DISTANCE * CRASH_DISTANCE {
            return None;
        }
        sum += squared;
        system.step(&x, u, &[], &mut next);
        std::mem::swap(&mut x, &mut next);
    }
    Some((sum / n).sqrt())
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
    /// Where it stands.
    pub theta: Vec<f64>,
    mean: Vec<f64>,
    square: Vec<f64>,
    /// Where the error was least.
    pub best: Vec<f64>,
    best_rmse: f64,
    /// Of all steps.
    pub history: Vec<Iteration>,
    rate: f64,
    n: usize,
}

impl Descent {
    /// `n` steps, the first of relative size `rate`.
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

    /// One step against a gradient; entries that are not finite move nothing.
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

/// Gains of their logarithms.
pub(super) fn gains_of(theta: &[f64]) -> Gains {
    Gains::from_flat(&theta.iter().map(|log| log.exp()).collect::<Vec<_>>())
}

/// Inputs of the closed loop along a reference, row-major `[T, m]`.
fn inputs(system: &VehicleLoop, reference: &Reference, n_step: usize) -> Vec<f64> {
    let m = system.n_input();
    let mut rows = vec![0.0; n_step * m];
    for (k, row) in rows.chunks_exact_mut(m).enumerate() {
        system.write_input(k as u64, Target::level(reference), &Disturbance::none(), row);
    }
    rows
}

/// Training and held-out starts come from streams that never meet.
const TRAINING: u64 = 0;
const HELD_OUT: u64 = 1;

/// Random starts around the reference's, row-major `[n, n_state]`.
fn starts(system: &VehicleLoop, plan: &TunePlan, reference: &Reference, n: usize, set: u64) -> Result<Vec<f32>> {
    let wanted = reference.sample(0.0);
    let hover = start_on(system.plant(), system.controller(), reference)?;
    let mut rows = Vec::with_capacity(n * system.n_state());
    for i in 0..n {
        let mut stream = Stream::new(plan.seed, i as u64, set, Purpose::RESET);
        let mut state = hover.clone();
        let mut draw = |spread: f64| if spread > 0.0 { stream.uniform(-spread, spread) } else { 0.0 };
        for k in 0..3 {
            state[k] += draw(plan.position_spread);
            state[3 + k] = wanted.velocity[k] + draw(plan.velocity_spread);
        }
        let (roll, pitch) = (draw(plan.tilt_spread), draw(plan.tilt_spread));
        let yaw = wanted.yaw + draw(2.0 * plan.tilt_spread);
        state[6..10].copy_from_slice(&from_euler(roll, pitch, yaw));
        rows.extend(system.initial_state(&state).iter().map(|v| *v as f32));
    }
    Ok(rows)
}
