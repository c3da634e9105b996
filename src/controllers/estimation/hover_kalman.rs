//! The steady Kalman filter of a vehicle about hover, driven by the commands that it is given: with `lqr`, LQG in flight.
//!
//! ```text
//! δ⁺ = A δ + B (u − u₀) + w        δ = x ⊖ hover, 12 numbers of the body and one per rotor; w ~ N(0, W)
//! y  = C δ + v                     v ~ N(0, V)
//!
//! W = Δt diag(0, σ_a², σ_ω², σ_α², 0)     σ_a m/s²/√Hz, σ_ω rad/s/√Hz, σ_α rad/s²/√Hz: what the model misses
//! ```
//!
//! A and B are the plant's about its hover trim ([`ErrorState::state_space`]). Place and velocity are taken about the own place along the own
//! heading: there hover looks the same wherever it is. What A makes of the attitude turns the own one, about its own axes: a rotation stays
//! one however far the body leans, and to first order nothing else is.
//!
//! C has what the sensors tell linearly there: position, velocity, attitude, heading, height, and of the inertial unit the gyroscope. An
//! accelerometer tells thrust and drag, and of the tilt nothing to first order: it is left out, and so is optical flow. Biases are not
//! estimated: their spread counts as noise. A barometer is set by its first reading to the height at which the flight begins.
//!
//! Sensors of several rates make the filter periodic. Every sample is taken in with the gain of its place in the period, which the
//! covariance comes to:
//!
//! ```text
//! P ← A P Aᵀ + W,   L = P Cᵀ (C P Cᵀ + V)⁻¹,   P ← (I − L C) P (I − L C)ᵀ + L V Lᵀ
//! ```
//!
//! It begins at the solution for sensors that come in every step with as many times their variance, which is the one where all do. What is
//! read late is taken in where it belongs: the filter goes back to that sample and comes forward with the commands since then.
//!
//! Source: Anderson and Moore 1990, chapter 8 (LQG); Bittanti and Colaneri 2009, section 9.2 (periodic filters).

use super::aiding::AidKind;
use super::estimator::body_error;
use super::fix::{FixKind, innovation};
use super::innovations::InnovationRecord;
use super::kalman::{corrected, steady_kalman, symmetric};
use super::noise::{BiasProcess, white_variance};
use super::sensor_filter::{ScheduledAid, SensorSchedule, USUAL, aids_about_the_body};
use crate::design::{ErrorState, TrimTarget, trim};
use crate::linear::{Signal, StateSpace};
use crate::period::common_period;
use autodiff::Array;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::sensors::{SensorConfig, SensorModel};
use dynamics::spatial::{
    Quat, Vec3, add, conjugate, cross, exponential, matrix, multiply, rotate, rotate_back, sub, unit,
};
use dynamics::{Frame, Plant};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Latest reading, steps.
const MOST_LATE: u64 = 10_000;
/// Longest period of all sensors, steps.
const MOST_PERIOD: usize = 2000;
/// Largest change of the covariance over a period, as a share of it, that counts as none.
const STEADY: f64 = 1e-8;
/// Most steps until then.
const MOST_STEPS: usize = 100_000;
/// Largest number that a sensor may read, in its unit: beyond, it is no reading.
const MOST_READ: f64 = 1e9;
/// Largest number of an estimate: a reading that takes it beyond is left out.
const MOST_STATE: f64 = 1e12;

with_defaults! {
    /// What a [`HoverKalman`] believes that its model misses.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct HoverKalmanSettings {
        /// Density of accelerations, m/s²/√Hz, per axis: gusts, drag, the tilt that is not that of hover.
        pub acceleration: f64 = 0.1,
        /// Density of angular accelerations, rad/s²/√Hz, per axis.
        pub angular_acceleration: f64 = 0.3,
        /// Density of angular velocities that are none, rad/s/√Hz: what a gyroscope's bias turns the attitude by.
        pub angular_velocity: f64 = 0.003,
    }
}

impl HoverKalmanSettings {
    /// Checks that all are > 0 and finite.
    ///
    /// # Errors
    /// [`Error::Value`] for the first that is not.
    pub fn validate(&self) -> Result<()> {
        let all = [
            ("acceleration", self.acceleration),
            ("angular_acceleration", self.angular_acceleration),
            ("angular_velocity", self.angular_velocity),
        ];
        match all.into_iter().find(|(_, x)| !(*x > 0.0 && *x <= 1e6)) {
            None => Ok(()),
            Some((name, x)) => {
                let remedy = "Leave it out for the default: a filter that trusts its model alone sees no sensor.";
                Err(Error::value(format!("estimator: {name}"), x, "> 0 and ≤ 1e6", remedy))
            }
        }
    }
}

/// How a reading is compared with the estimate.
#[derive(Debug, Clone, PartialEq)]
enum Compared {
    /// As a fix.
    Fix(Box<ScheduledAid>, FixKind),
    /// A gyroscope with these axes, mount → body.
    Rate(Quat<f64>),
}

/// What a sensor tells, as the filter takes it in.
#[derive(Debug, Clone)]
pub(crate) struct Told {
    compared: Compared,
    pub schedule: SensorSchedule,
    /// C, p × n, of the error about hover along its heading.
    pub rows: DMatrix<f64>,
    /// V, p × p.
    variance: DMatrix<f64>,
    /// L, n × p, and S⁻¹, one of each of its samples in a period.
    pub gains: Vec<DMatrix<f64>>,
    weights: Vec<DMatrix<f64>>,
}

impl Told {
    /// What it is called in tables.
    fn quantity(&self) -> &'static str {
        match &self.compared {
            Compared::Fix(own, _) => own.aid.kind.quantity(),
            Compared::Rate(_) => "gyroscope",
        }
    }

    /// Numbers that it tells.
    pub fn n(&self) -> usize {
        self.rows.nrows()
    }

    /// Names and units of them, after the sensor's.
    pub fn signals(&self) -> Vec<Signal> {
        let (names, unit) = match &self.compared {
            Compared::Fix(_, kind) => (kind.names(), kind.unit()),
            Compared::Rate(_) => (&["gyroscope_x", "gyroscope_y", "gyroscope_z"][..], "rad/s"),
        };
        names.iter().map(|name| Signal::new(format!("{}.{name}", self.schedule.name), unit)).collect()
    }

    /// Whether it is sampled in a step.
    pub fn is_due(&self, step: usize) -> bool {
        (step as u64).is_multiple_of(self.schedule.every)
    }

    /// L of its sample of a step.
    pub fn gain(&self, step: usize) -> &DMatrix<f64> {
        &self.gains[self.place(step)]
    }

    /// Whether its first reading says by how much it is off.
    fn is_set(&self) -> bool {
        matches!(&self.compared, Compared::Fix(own, _) if matches!(own.aid.kind, AidKind::Pressure(_)))
    }

    fn missing_height(&self, at: &Frame<f64>, numbers: &[f64]) -> f64 {
        match &self.compared {
            Compared::Fix(own, _) => innovation(&own.aid, at, numbers)[0],
            Compared::Rate(_) => 0.0,
        }
    }

    fn place(&self, step: usize) -> usize {
        (step / self.schedule.every as usize) % self.gains.len()
    }

    /// What it reads first, numbers that are there, and whether they are one that is lost.
    fn read(&self, readings: &[f64]) -> ([f64; 4], bool) {
        let first = self.schedule.first;
        let (n, valid) = match &self.compared {
            Compared::Fix(own, _) => (own.aid.kind.n_reading(), own.valid),
            Compared::Rate(_) => (3, None),
        };
        let mut numbers = [0.0; 4];
        numbers[..n].copy_from_slice(&readings[first..first + n]);
        (numbers, valid.is_some_and(|valid| readings[first + valid] != 1.0))
    }
}

/// A step: what was predicted and read, what is estimated, and what was commanded from then on.
#[derive(Debug, Clone, Default)]
struct Sample {
    predicted: Vec<f64>,
    state: Vec<f64>,
    command: Vec<f64>,
    /// Which sensor's, what it read, whether it counts in the records already.
    readings: Vec<(usize, [f64; 4], bool)>,
}

/// The steady Kalman filter of a vehicle about hover, over readings and commands; under `lqr` LQG in flight.
///
/// ```text
/// δ⁺ = A δ + B (u − u₀) + w,   y = C δ + v        δ = x ⊖ hover; w ~ N(0, W), v ~ N(0, V)
/// δ̂ ← δ̂ + L (y − C δ̂)                             L = P Cᵀ (C P Cᵀ + V)⁻¹, P periodic where sensors have several rates
/// W = Δt diag(0, σ_a², σ_ω², σ_α², 0)              of place, velocity, attitude, rate, rotor speeds: the densities of the settings
/// ```
///
/// y is what sensors tell linearly there: position, velocity, attitude, heading, height and angular velocity; neither an accelerometer nor
/// optical flow. Biases count as noise. What is late is taken in where it belongs.
///
/// Source: Anderson and Moore 1990, chapter 8; Bittanti and Colaneri 2009, section 9.2.
#[derive(Debug, Clone)]
pub struct HoverKalman {
    errors: ErrorState,
    /// At the origin, heading along x.
    hover: Vec<f64>,
    trimmed: DVector<f64>,
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    /// In the order in which those of one step are taken in: by their latency.
    told: Vec<Told>,
    period: usize,
    /// W.
    process: DMatrix<f64>,
    /// P of what is known in each step of a period, place, velocity and attitude, 9 × 9.
    known: Vec<DMatrix<f64>>,
    samples: VecDeque<Sample>,
    n_kept: usize,
    step: u64,
    records: Vec<InnovationRecord>,
    /// By how much each barometer is off, m, once it has been read.
    set: Vec<Option<f64>>,
}

impl HoverKalman {
    /// For a plant that carries these sensors.
    ///
    /// # Errors
    /// [`Error::Value`] for a plant that cannot hover, sensors without noise, and what no sensor shows; [`Error::Limit`] for rates that come
    /// round after more than 2000 steps; as [`HoverKalmanSettings::validate`] and [`steady_kalman`].
    pub fn new(plant: &Plant, configs: &[SensorConfig], settings: &HoverKalmanSettings) -> Result<Self> {
        settings.validate()?;
        let dt = plant.physics().dt;
        let trimmed = trim(plant, &TrimTarget::hover())?;
        let errors = ErrorState::of_plant(plant)?;
        let system = errors.state_space(plant, &trimmed.state, &trimmed.input, 0.0)?;
        let n_rotor = plant.rotor_places().len();
        let mut hover = trimmed.state.clone();
        hover[..3].fill(0.0);
        let told = told(configs, dt, &hover, system.n_state())?;
        if let Some(late) = told.iter().find(|own| own.schedule.latency > MOST_LATE) {
            let (what, value) =
                (format!("sensor '{}'", late.schedule.name), format!("{} steps late", late.schedule.latency));
            let limit = format!("{MOST_LATE} steps, for kalman");
            return Err(Error::limit(what, value, limit, "Read it sooner, or leave it out."));
        }
        let period = told.iter().fold(1_u64, |period, own| common_period(period, own.schedule.every));
        if period > MOST_PERIOD as u64 {
            let most = format!("{MOST_PERIOD} steps");
            let remedy = "Let the rates of the sensors be whole parts of one another.";
            return Err(Error::limit("estimator kalman: steps until all rates come round", period, most, remedy));
        }
        let records = told.iter().map(|own| InnovationRecord::new(&own.schedule.name, own.quantity(), own.n()));
        let latest = told.iter().map(|own| own.schedule.latency).max().unwrap_or(0) as usize;
        let mut filter = Self {
            records: records.collect(),
            set: vec![None; told.len()],
            errors,
            hover,
            trimmed: DVector::from_column_slice(&trimmed.input[..n_rotor]),
            a: system.a().clone(),
            b: system.b().columns(0, n_rotor).into_owned(),
            told,
            period: period as usize,
            process: process(settings, system.n_state(), dt),
            known: Vec::new(),
            samples: VecDeque::with_capacity(latest + 2),
            n_kept: latest + 1,
            step: 0,
        };
        filter.find_gains(dt)?;
        let start = filter.hover.clone();
        filter.begin(&start);
        Ok(filter)
    }

    /// Gains of a period, and what is known in each of its steps.
    fn find_gains(&mut self, dt: f64) -> Result<()> {
        let process = &self.process.clone();
        let n = self.a.nrows();
        let n_all: usize = self.told.iter().map(Told::n).sum();
        let (mut c, mut v) = (DMatrix::zeros(n_all, n), DMatrix::zeros(n_all, n_all));
        let mut at = 0;
        for own in &self.told {
            c.rows_mut(at, own.n()).copy_from(&own.rows);
            // as much is told in all, a little in every step
            let often = own.schedule.every as f64;
            v.view_mut((at, at), (own.n(), own.n())).copy_from(&(&own.variance * often));
            at += own.n();
        }
        let d = DMatrix::zeros(n_all, self.b.ncols());
        let names = self.state_signals();
        let inputs = Signal::numbered("u", self.b.ncols());
        let outputs = self.told.iter().flat_map(Told::signals).collect();
        let system = StateSpace::new(self.a.clone(), self.b.clone(), c, d, Some(dt))?.named(names, inputs, outputs)?;
        let mut p = steady_kalman(&system, process, &v).map_err(of_sensors)?.covariance;
        let mut steps = 0;
        loop {
            let before = p.clone();
            let after = self.over_a_period(&mut p, process)?;
            steps += self.period;
            let is_steady = (&p - &before).amax() <= STEADY * p.amax();
            if !is_steady && self.period > 1 && steps > MOST_STEPS {
                let value = format!("not steady after {steps} steps");
                let remedy = "Give sensors that tell all of the state, or the process more noise.";
                return Err(Error::value("estimator kalman: covariance", value, "steady", remedy));
            }
            if is_steady || self.period == 1 {
                self.known = (0..self.period).map(|k| self.known_in(k, &after, process)).collect();
                return Ok(());
            }
        }
    }

    /// One period further: P before the readings of its first step, and the gains along the way; P behind the readings of each.
    fn over_a_period(&mut self, p: &mut DMatrix<f64>, process: &DMatrix<f64>) -> Result<Vec<DMatrix<f64>>> {
        let mut after = Vec::with_capacity(self.period);
        for step in 0..self.period {
            for own in self.told.iter_mut().filter(|own| own.is_due(step)) {
                let seen = &own.rows * &*p;
                let spread = symmetric(&(&seen * own.rows.transpose() + &own.variance));
                let Some(weight) = spread.cholesky().map(|factor| factor.inverse()) else {
                    return Err(noiseless(&own.schedule.name));
                };
                let gain = seen.transpose() * &weight;
                *p = corrected(p, &gain, &own.rows, &own.variance);
                let place = own.place(step);
                (own.gains[place], own.weights[place]) = (gain, weight);
            }
            after.push(p.clone());
            *p = symmetric(&(&self.a * &*p * self.a.transpose() + process));
        }
        Ok(after)
    }

    /// P of place, velocity and attitude in a step of a period, by what was read until then.
    fn known_in(&self, step: usize, after: &[DMatrix<f64>], process: &DMatrix<f64>) -> DMatrix<f64> {
        let late = self.n_kept - 1;
        // as long ago all is read
        let now = step + late.div_ceil(self.period) * self.period;
        let mut p = after[(now - late) % self.period].clone();
        for at in now - late + 1..=now {
            p = symmetric(&(&self.a * p * self.a.transpose() + process));
            let is_read = |own: &&Told| own.is_due(at) && at + own.schedule.latency as usize <= now;
            for own in self.told.iter().filter(is_read) {
                p = corrected(&p, own.gain(at), &own.rows, &own.variance);
            }
        }
        p.view((0, 0), (9, 9)).into_owned()
    }

    fn state_signals(&self) -> Vec<Signal> {
        let names = ["position", "velocity", "attitude", "angular_velocity"];
        let body = names.iter().flat_map(|name| ["x", "y", "z"].map(|axis| Signal::new(format!("{name}_{axis}"), "")));
        body.chain((0..self.b.ncols()).map(|k| Signal::new(format!("speed of rotor {k}"), ""))).collect()
    }

    /// Begins a flight in a state of the plant.
    ///
    /// # Panics
    /// For a state of another length.
    pub fn begin(&mut self, state: &[f64]) {
        assert_eq!(state.len(), self.hover.len(), "length of the state");
        self.step = 0;
        self.samples.clear();
        self.set.fill(None);
        let command = self.trimmed.as_slice().to_vec();
        let (predicted, state) = (state.to_vec(), state.to_vec());
        self.samples.push_back(Sample { predicted, state, command, readings: Vec::new() });
        for record in &mut self.records {
            (record.n, record.left_out, record.lost, record.squared) = (0, 0, 0, 0.0);
        }
    }

    /// One step of the simulation further: takes in what is new among all readings.
    ///
    /// # Panics
    /// For fewer readings than the sensors have.
    pub fn step(&mut self, readings: &[f64]) {
        let step = self.step;
        self.step += 1;
        if step > 0 {
            let last = &self.samples[self.samples.len() - 1];
            let predicted = self.predicted(&last.state, &last.command);
            let command = last.command.clone();
            self.samples.push_back(Sample { state: predicted.clone(), predicted, command, readings: Vec::new() });
            if self.samples.len() > self.n_kept {
                self.samples.pop_front();
            }
        }
        let mut first = self.samples.len() - 1;
        for k in 0..self.told.len() {
            let Some(sampled) = self.told[k].schedule.sampled(step) else { continue };
            let (numbers, is_lost) = self.told[k].read(readings);
            let record = &mut self.records[k];
            record.n += 1;
            record.lost += u64::from(is_lost);
            if is_lost {
                continue;
            }
            if !numbers.iter().all(|x| x.abs() <= MOST_READ) {
                record.lost += 1;
                continue;
            }
            let Some(at) = (self.samples.len() - 1).checked_sub((step - sampled) as usize) else { continue };
            if self.told[k].is_set() && self.set[k].is_none() {
                let then = Frame::of_vehicle(&self.samples[at].state);
                self.set[k] = Some(self.told[k].missing_height(&then, &numbers));
            }
            self.samples[at].readings.push((k, numbers, false));
            first = first.min(at);
        }
        for at in first..self.samples.len() {
            self.go_over(at, step + 1 + at as u64 - self.samples.len() as u64);
        }
    }

    /// Computes a sample anew, of step `step`.
    fn go_over(&mut self, at: usize, step: u64) {
        if at > 0 {
            let before = &self.samples[at - 1];
            self.samples[at].predicted = self.predicted(&before.state, &before.command);
        }
        let mut sample = std::mem::take(&mut self.samples[at]);
        sample.readings.sort_by_key(|(k, ..)| *k);
        sample.state.clone_from(&sample.predicted);
        for (k, numbers, is_counted) in &mut sample.readings {
            let (next, squared) = self.taken(&sample.state, *k, numbers, step as usize % self.period);
            let is_sound = next.iter().all(|x| x.abs() <= MOST_STATE);
            if is_sound {
                sample.state = next;
            }
            if !std::mem::replace(is_counted, true) {
                let record = &mut self.records[*k];
                record.left_out += u64::from(!is_sound);
                record.squared += if is_sound { squared } else { 0.0 };
            }
        }
        self.samples[at] = sample;
    }

    /// The state after a reading, and νᵀ S⁻¹ ν.
    fn taken(&self, state: &[f64], k: usize, numbers: &[f64; 4], step: usize) -> (Vec<f64>, f64) {
        let own = &self.told[k];
        let psi = self.heading(state);
        let missing = match &own.compared {
            Compared::Rate(mount) => sub(rotate(*mount, numbers[..].array(0)), state.array(10)),
            Compared::Fix(aid, kind) => {
                let nu = innovation(&aid.aid, &Frame::of_vehicle(state), numbers);
                match kind {
                    FixKind::Position | FixKind::Velocity => turned(nu, -psi),
                    // about the axes of the body, wherever they lean
                    FixKind::Attitude => rotate(self.hover[..].array(6), rotate_back(state.array(6), nu)),
                    FixKind::Heading => nu,
                    FixKind::Height => [nu[0] - self.set[k].unwrap_or(0.0), 0.0, 0.0],
                }
            }
        };
        let nu = DVector::from_column_slice(&missing[..own.n()]);
        let move_by = own.gain(step) * &nu;
        let squared = nu.dot(&(&own.weights[own.place(step)] * &nu));
        let mut next = state.to_vec();
        let mut along = move_by;
        for first in [0, 3] {
            let own = turned([along[first], along[first + 1], along[first + 2]], psi);
            along.as_mut_slice()[first..first + 3].copy_from_slice(&own);
        }
        self.errors.move_by(&mut next, along.as_slice());
        upright(&mut next);
        (next, squared)
    }

    /// The state a step later under a command.
    fn predicted(&self, state: &[f64], command: &[f64]) -> Vec<f64> {
        let psi = self.heading(state);
        let mut own = state.to_vec();
        own[..3].fill(0.0);
        own[3..6].copy_from_slice(&turned(state.array(3), -psi));
        own[6..10].copy_from_slice(&multiply(about_vertical(-psi), state.array(6)));
        let error = self.errors.difference(&own, &self.hover);
        let asked = DVector::from_iterator(command.len(), command.iter().map(|u| u.clamp(-1.0, 1.0))) - &self.trimmed;
        let mut after = &self.a * &error + &self.b * asked;
        let turn = [6, 7, 8].map(|k| after[k] - error[k]);
        (0..3).for_each(|k| after[6 + k] = 0.0);
        let mut next = self.errors.moved(&self.hover, after.as_slice());
        let gone = turned(next[..].array(0), psi);
        next[..3].copy_from_slice(&add(state.array(0), gone));
        let velocity = turned(next[..].array(3), psi);
        next[3..6].copy_from_slice(&velocity);
        let attitude = multiply(state.array(6), exponential(turn));
        next[6..10].copy_from_slice(&attitude);
        upright(&mut next);
        next
    }

    /// By how much it is turned about the vertical from hover, rad.
    fn heading(&self, state: &[f64]) -> f64 {
        let turn = matrix(multiply(state.array(6), conjugate(self.hover[..].array(6))));
        turn[1][0].atan2(turn[0][0])
    }

    /// Goes on under the commands of the rotors.
    pub fn apply(&mut self, commands: &[f64]) {
        let n = self.trimmed.len();
        if let Some(last) = self.samples.back_mut() {
            // what is no command leaves the rotors where they hover
            let kept = last.command.iter_mut().zip(&commands[..n]).zip(self.trimmed.iter());
            kept.for_each(|((own, x), hover)| *own = if x.is_finite() { *x } else { *hover });
        }
    }

    /// The state as it is estimated, in the plant's layout.
    pub fn state(&self) -> &[f64] {
        &self.samples[self.samples.len() - 1].state
    }

    /// P of place and velocity (m, m/s, along the heading) and attitude (rad, body axes), 9 × 9, by what has been read.
    pub fn covariance(&self) -> &DMatrix<f64> {
        &self.known[self.step.saturating_sub(1) as usize % self.period]
    }

    /// eᵀ P⁻¹ e over place, velocity and attitude (NEES): 9 on average where the estimate is consistent.
    pub fn squared_error(&self, truth: &Frame<f64>) -> f64 {
        let e = body_error(&Frame::of_vehicle(self.state()), truth);
        let psi = self.heading(self.state());
        let along = [turned(e.array(0), -psi), turned(e.array(3), -psi), e.array(6)];
        let e = DVector::from_column_slice(along.as_flattened());
        self.covariance().clone().cholesky().map_or(f64::NAN, |factor| e.dot(&factor.solve(&e)))
    }

    /// How readings agreed with what was expected, sensor by sensor.
    pub fn records(&self) -> &[InnovationRecord] {
        &self.records
    }

    /// A and B about hover along its heading.
    pub fn model(&self) -> [&DMatrix<f64>; 2] {
        [&self.a, &self.b]
    }

    /// Steps until all sensors come round.
    pub fn period(&self) -> usize {
        self.period
    }

    /// W, and V of all that is told in one step.
    #[cfg(test)]
    pub(crate) fn noise(&self) -> [DMatrix<f64>; 2] {
        let n = self.told.iter().map(Told::n).sum();
        let (mut v, mut at) = (DMatrix::zeros(n, n), 0);
        for own in &self.told {
            v.view_mut((at, at), (own.n(), own.n())).copy_from(&own.variance);
            at += own.n();
        }
        [self.process.clone(), v]
    }

    /// What is taken in, in that order in a step.
    pub(crate) fn told(&self) -> &[Told] {
        &self.told
    }
}

/// W.
fn process(settings: &HoverKalmanSettings, n: usize, dt: f64) -> DMatrix<f64> {
    let mut w = DMatrix::zeros(n, n);
    let densities = [settings.acceleration, settings.angular_velocity, settings.angular_acceleration];
    for (first, density) in [3, 6, 9].into_iter().zip(densities) {
        (first..first + 3).for_each(|k| w[(k, k)] = density * density * dt);
    }
    w
}

/// What sensors tell about hover, those of the least latency first.
fn told(configs: &[SensorConfig], dt: f64, hover: &[f64], n: usize) -> Result<Vec<Told>> {
    let (aids, biases) = aids_about_the_body(configs, dt)?;
    let mut all = Vec::new();
    let mut first = 0;
    for config in configs {
        if let SensorModel::Imu(imu) = &config.model {
            let (every, latency) = (config.steps_between(dt)?, config.steps_late(dt)?);
            let between = every as f64 * dt;
            let variance = [0, 1, 2].map(|axis| {
                let spread = BiasProcess::of(&imu.gyroscope, axis, between).spread();
                white_variance(&imu.gyroscope, axis, between, USUAL[1]) + spread
            });
            let mut rows = DMatrix::zeros(3, n);
            (0..3).for_each(|k| rows[(k, 9 + k)] = 1.0);
            // its numbers are behind those of the accelerometer
            let schedule = SensorSchedule { name: config.name.clone(), first: first + 3, every, latency };
            let variance = about(config.rotation, &variance);
            all.push((Compared::Rate(config.rotation), schedule, rows, variance));
        }
        first += config.model.channels().len();
    }
    for own in aids {
        let Some(kind) = FixKind::of(&own.aid.kind) else { continue };
        let (rows, variance) = linear(&own, kind, &biases, hover, n);
        let schedule = own.schedule.clone();
        all.push((Compared::Fix(Box::new(own), kind), schedule, rows, variance));
    }
    all.sort_by_key(|(_, schedule, ..)| schedule.latency);
    if all.is_empty() {
        let remedy = "Add motion_capture:optical, or an imu with gnss and magnetometer.";
        return Err(Error::value("sensors of estimator kalman", "none that it takes in", "one or more", remedy));
    }
    let period = all.iter().fold(1_u64, |period, (_, schedule, ..)| common_period(period, schedule.every));
    let told = all.into_iter().map(|(compared, schedule, rows, variance)| {
        if (0..rows.nrows()).any(|k| variance[(k, k)] <= 0.0) {
            return Err(noiseless(&schedule.name));
        }
        let n_sample = (period.min(MOST_PERIOD as u64) / schedule.every).max(1) as usize;
        let [gains, weights] = [0, 1].map(|_| vec![DMatrix::zeros(0, 0); n_sample]);
        Ok(Told { compared, schedule, rows, variance, gains, weights })
    });
    told.collect()
}

/// The error of a filter, told of the sensors.
fn of_sensors(error: Error) -> Error {
    match error {
        Error::Value { what, value, limit, .. } => {
            let remedy = "Give it sensors that tell them: motion_capture, or an imu with gnss and magnetometer.";
            Error::value(format!("estimator kalman: {what}"), value, limit, remedy)
        }
        other => other,
    }
}

fn noiseless(name: &str) -> Error {
    let remedy = "Give it noise: a preset, or a density. A steady filter believes what has none without end.";
    Error::value(format!("sensor '{name}': noise"), 0, "> 0 for estimator kalman", remedy)
}

/// C and V of a fix about hover.
fn linear(
    own: &ScheduledAid,
    kind: FixKind,
    biases: &[BiasProcess],
    hover: &[f64],
    n: usize,
) -> (DMatrix<f64>, DMatrix<f64>) {
    let aid = &own.aid;
    let q: Quat<f64> = hover.array(6);
    let turned = matrix(q);
    // set by its first reading, whose noise stays
    let is_set = matches!(aid.kind, AidKind::Pressure(_));
    let more = |k: usize, v: f64| if is_set { v } else { spread(aid.bias, k, biases) };
    let variance: Vec<f64> = aid.variance.iter().enumerate().map(|(k, v)| v + more(k, *v)).collect();
    // −R [r]ₓ: what a turn, or a rate, about body axes makes of the place, or velocity, of the mount
    let swung = |j: usize| rotate(q, cross([0, 1, 2].map(|k| f64::from(u8::from(k == j))), aid.lever));
    let mut rows = DMatrix::zeros(kind.n(), n);
    let v = match kind {
        FixKind::Position | FixKind::Velocity => {
            let (first, by) = if kind == FixKind::Position { (0, 6) } else { (3, 9) };
            for j in 0..3 {
                rows[(j, first + j)] = 1.0;
                (0..3).for_each(|i| rows[(i, by + j)] = swung(j)[i]);
            }
            DMatrix::from_diagonal(&variance.into())
        }
        FixKind::Attitude => {
            (0..3).for_each(|i| (0..3).for_each(|j| rows[(i, 6 + j)] = turned[i][j]));
            about(multiply(q, aid.rotation), &[variance[0], variance[1], variance[2]])
        }
        FixKind::Heading => {
            (0..3).for_each(|j| rows[(0, 6 + j)] = turned[2][j]);
            let field = match &aid.kind {
                AidKind::Field(field) => field[0].hypot(field[1]),
                _ => 1.0,
            };
            DMatrix::from_element(1, 1, variance.iter().sum::<f64>() / 3.0 / (field * field))
        }
        FixKind::Height => {
            rows[(0, 2)] = 1.0;
            (0..3).for_each(|j| rows[(0, 6 + j)] = swung(j)[2]);
            let slope = match &aid.kind {
                AidKind::Pressure(barometer) => barometer.pressure_at(0.0)[1],
                _ => 1.0,
            };
            DMatrix::from_element(1, 1, variance[0] / (slope * slope))
        }
    };
    (rows, v)
}

fn spread(first: Option<usize>, channel: usize, biases: &[BiasProcess]) -> f64 {
    first.and_then(|first| biases.get(first + channel)).map_or(0.0, BiasProcess::spread)
}

/// M diag(σ²) Mᵀ.
fn about(mount: Quat<f64>, variance: &[f64; 3]) -> DMatrix<f64> {
    let m = matrix(mount);
    DMatrix::from_fn(3, 3, |i, j| (0..3).map(|k| m[i][k] * variance[k] * m[j][k]).sum())
}

/// About the vertical by an angle, rad.
fn turned(v: Vec3<f64>, angle: f64) -> Vec3<f64> {
    let (s, c) = angle.sin_cos();
    [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]]
}

fn about_vertical(angle: f64) -> Quat<f64> {
    let (s, c) = (0.5 * angle).sin_cos();
    [c, 0.0, 0.0, s]
}

/// Makes the attitude a unit quaternion.
fn upright(state: &mut [f64]) {
    let q = unit(state.array(6));
    state[6..10].copy_from_slice(&q);
}

#[cfg(test)]
mod tests;
