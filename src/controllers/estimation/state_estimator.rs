//! An error-state Kalman filter of a vehicle's sensors, as it runs on board: sample by sample, with readings that come late.
//!
//! A sample of the inertial unit takes the state a step further. What another sensor read of an earlier sample is taken in where it belongs:
//! the filter goes back to that sample, takes it in, and comes forward again over the samples that it kept. The estimate is then what it
//! would have been had nothing been late.
//!
//! Innovations tell what is wrong: a reading beyond the gate is left out and counted; a sensor of which [`StateEstimatorSettings::patience`]
//! seconds are left out in a row is believed again, with the state uncertain enough for it. An inertial unit at its limits makes the state
//! uncertain.

use super::aiding::Agreement;
use super::innovations::{InertialSample, InnovationRecord, Trust};
use super::navigation_state::{NavigationState, begin_anew};
use super::sensor_filter::{ScheduledAid, SensorFilter};
use autodiff::{Array, Program, Workspace};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::Frame;
use dynamics::sensors::SensorConfig;
use dynamics::spatial::{add, exponential, multiply, rotate, scale, sub};
use nalgebra::DMatrix;
use rng::Stream;
use serde::{Deserialize, Serialize};

/// Latest reading, steps.
const MOST_LATE: u64 = 10_000;

with_defaults! {
    /// How a [`StateEstimator`] begins and what it believes.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct StateEstimatorSettings {
        /// Standard deviation of the place at the beginning, m.
        pub position: f64 = 0.1,
        /// Of the velocity, m/s.
        pub velocity: f64 = 0.1,
        /// Of the attitude, rad.
        pub attitude: f64 = 0.02,
        /// Largest squared innovation of a reading that is taken in, per number of it: 5.5 standard deviations of one.
        pub gate: f64 = 30.0,
        /// How long a sensor is left out before it is believed again, s.
        pub patience: f64 = 1.0,
        /// Standard deviation of what an accelerometer at its limit may miss, m/s².
        pub beyond_accelerometer: f64 = 50.0,
        /// Of what a gyroscope at its limit may miss, rad/s.
        pub beyond_gyroscope: f64 = 10.0,
    }
}

impl StateEstimatorSettings {
    /// Where a filter begins that knows a body to the deviations.
    pub fn drawn(&self, truth: &Frame<f64>, draw: &mut Stream) -> Frame<f64> {
        let mut off = |deviation: f64| [0, 1, 2].map(|_| deviation * draw.normal());
        let mut known = *truth;
        known.position = add(known.position, off(self.position));
        known.velocity = add(known.velocity, off(self.velocity));
        known.attitude = multiply(known.attitude, exponential(off(self.attitude)));
        known
    }

    /// Checks that all are > 0 and finite.
    ///
    /// # Errors
    /// [`Error::Value`] for the first that is not.
    pub fn validate(&self) -> Result<()> {
        let all = [
            ("position", self.position),
            ("velocity", self.velocity),
            ("attitude", self.attitude),
            ("gate", self.gate),
            ("patience", self.patience),
            ("beyond_accelerometer", self.beyond_accelerometer),
            ("beyond_gyroscope", self.beyond_gyroscope),
        ];
        match all.into_iter().find(|(_, x)| !(*x > 0.0 && *x <= 1e9)) {
            None => Ok(()),
            Some((name, x)) => {
                Err(Error::value(format!("estimator: {name}"), x, "> 0 and ≤ 1e9", "Leave it out for the default."))
            }
        }
    }
}

/// A reading that is yet to be taken in, or has been.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Reading {
    aid: usize,
    numbers: [f64; 4],
    gate: f64,
    /// By what P grows before it is taken in.
    fading: f64,
    /// Whether it counts in the records already.
    is_counted: bool,
}

/// A sample of the inertial unit, what was read at the same time, and the state then.
#[derive(Debug, Clone)]
struct Sample {
    inertial: InertialSample,
    readings: Vec<Reading>,
    state: Vec<f64>,
}

/// An error-state Kalman filter over readings; see the [module](self).
#[derive(Debug, Clone)]
pub struct StateEstimator {
    filter: SensorFilter,
    settings: StateEstimatorSettings,
    gravity: f64,
    prediction: Program,
    predictor: Workspace,
    corrections: Vec<(Program, Workspace)>,
    arguments: Vec<f64>,
    results: Vec<f64>,
    /// The last samples, sample j in slot j modulo their number.
    samples: Vec<Sample>,
    /// Steps and samples so far.
    step: u64,
    n_sample: u64,
    records: Vec<InnovationRecord>,
    trust: Vec<Trust>,
    /// Readings of samples that the unit is yet to tell.
    early: Vec<(u64, Reading)>,
    /// Largest variance of the newest P.
    largest: f64,
    /// Where the flight began.
    begun: Vec<f64>,
    saturated: u64,
    begun_anew: u64,
    dt: f64,
}

impl StateEstimator {
    /// For these sensors in steps of `dt` seconds under `gravity` (m/s², along −z), recorded once.
    ///
    /// # Errors
    /// As [`SensorFilter::new`] and [`StateEstimatorSettings::validate`]; [`Error::Limit`] where a recording is too large.
    pub fn new(configs: &[SensorConfig], settings: &StateEstimatorSettings, dt: f64, gravity: f64) -> Result<Self> {
        settings.validate()?;
        let filter = SensorFilter::new(configs, dt)?;
        filter.check(MOST_LATE)?;
        let n_flat = filter.n_flat();
        let prediction = Program::compile(&filter.recorded_prediction(gravity))?;
        let corrections = filter.aids.iter().map(|own| {
            let program = Program::compile(&filter.recorded_correction(&own.aid))?;
            let work = program.workspace();
            Ok((program, work))
        });
        let corrections = corrections.collect::<Result<Vec<_>>>()?;
        let late = |own: &ScheduledAid| own.schedule.latency.saturating_sub(filter.inertial.latency);
        let longest = filter.aids.iter().map(late).max().unwrap_or(0);
        let n_kept = longest as usize + 2;
        let most = filter.aids.len();
        let sample = Sample {
            inertial: InertialSample::default(),
            readings: Vec::with_capacity(most),
            state: vec![0.0; n_flat],
        };
        let mut estimator = Self {
            records: filter.aids.iter().map(InnovationRecord::of).collect(),
            trust: vec![Trust::default(); filter.aids.len()],
            early: Vec::with_capacity(filter.aids.len() * (filter.inertial.latency as usize + 1)),
            largest: 0.0,
            begun: vec![0.0; n_flat],
            predictor: prediction.workspace(),
            prediction,
            corrections,
            arguments: vec![0.0; n_flat + 8],
            results: vec![0.0; n_flat + 2],
            samples: vec![sample; n_kept],
            step: 0,
            n_sample: 0,
            saturated: 0,
            begun_anew: 0,
            gravity,
            settings: *settings,
            dt,
            filter,
        };
        estimator.begin(&Frame {
            position: [0.0; 3],
            velocity: [0.0; 3],
            attitude: [1.0, 0.0, 0.0, 0.0],
            angular_velocity: [0.0; 3],
        });
        Ok(estimator)
    }

    /// Begins a flight where the body is known to be, to the deviations of the settings: pose and velocity in the world, angular velocity in
    /// the world.
    pub fn begin(&mut self, known: &Frame<f64>) {
        (self.step, self.n_sample, self.saturated, self.begun_anew) = (0, 0, 0, 0);
        self.trust.fill(Trust::default());
        self.early.clear();
        self.samples.iter_mut().for_each(|sample| sample.readings.clear());
        self.filter.begin(known, &self.settings, &mut self.begun);
        self.samples[0].state.copy_from_slice(&self.begun);
        self.largest = self.largest_variance();
        self.records.iter_mut().for_each(InnovationRecord::clear);
    }

    /// One step of the simulation further: takes in what is new among all readings.
    ///
    /// # Panics
    /// For fewer readings than the sensors have.
    pub fn step(&mut self, readings: &[f64]) {
        let step = self.step;
        self.step += 1;
        let mut first_changed = None;
        if self.filter.inertial.sampled(step).is_some() {
            let own: [f64; 6] = readings.array(self.filter.inertial.first);
            first_changed = Some(self.next_sample(own));
        }
        for k in 0..self.filter.aids.len() {
            if let Some(at) = self.take(k, step, readings) {
                first_changed = Some(first_changed.map_or(at, |other: u64| other.min(at)));
            }
        }
        if let Some(first) = first_changed {
            (first..self.n_sample).for_each(|j| self.go_over(j));
            self.largest = self.largest_variance();
        }
    }

    /// A sample of the unit; its number.
    fn next_sample(&mut self, inertial: [f64; 6]) -> u64 {
        let j = self.n_sample;
        self.n_sample += 1;
        let before = if j > 0 { self.sample(j - 1).inertial } else { InertialSample::default() };
        let own = InertialSample::new(inertial, &before, &self.filter, &self.settings);
        self.saturated += u64::from(own.is_saturated());
        let sample = self.sample_mut(j);
        sample.inertial = own;
        sample.readings.clear();
        let slot = (j % self.samples.len() as u64) as usize;
        self.samples[slot].readings.extend(self.early.iter().filter(|(at, _)| *at == j).map(|(_, own)| *own));
        self.early.retain(|(at, _)| *at > j);
        j
    }

    /// Takes what a sensor reads anew in this step to the sample that it belongs to; its number.
    fn take(&mut self, aid: usize, step: u64, readings: &[f64]) -> Option<u64> {
        let own = &self.filter.aids[aid];
        let sampled = own.schedule.sampled(step)?;
        // the unit is read in every step: sample j is that of step j
        let j = sampled;
        // older than what is kept: only of what is later than its own schedule
        if j + self.samples.len() as u64 <= self.n_sample {
            return None;
        }
        let believed = (&self.settings, self.largest);
        let (read, record) = (&readings[own.schedule.first..], &mut self.records[aid]);
        let (numbers, [gate, fading]) = self.trust[aid].ask(own, believed, read, record)?;
        let reading = Reading { aid, numbers, gate, fading, is_counted: false };
        if j >= self.n_sample {
            // sooner than the unit's own sample of that time
            self.early.push((j, reading));
            return None;
        }
        self.sample_mut(j).readings.push(reading);
        Some(j)
    }

    /// Computes sample j anew from the one before.
    fn go_over(&mut self, j: u64) {
        let n_flat = self.filter.n_flat();
        let slots = self.samples.len() as u64;
        let (at, before) = ((j % slots) as usize, (j + slots - 1) as usize % slots as usize);
        if j == 0 {
            // begun where it is known: its sample says how it turns
            let rate: [f64; 3] = self.samples[at].inertial.numbers.array(3);
            self.results[..n_flat].copy_from_slice(&self.begun);
            self.results[10..13].copy_from_slice(&rate);
        } else {
            let Self { samples, arguments, prediction, predictor, results, .. } = self;
            arguments[..n_flat].copy_from_slice(&samples[before].state);
            arguments[n_flat..n_flat + 6].copy_from_slice(&samples[at].inertial.numbers);
            arguments[n_flat + 6..].copy_from_slice(&samples[at].inertial.added);
            prediction.evaluate(predictor, arguments, &mut results[..n_flat]);
        }
        for r in 0..self.samples[at].readings.len() {
            let reading = self.samples[at].readings[r];
            let n = self.filter.aids[reading.aid].aid.kind.n_reading();
            self.arguments[..n_flat].copy_from_slice(&self.results[..n_flat]);
            self.arguments[n_flat..n_flat + n].copy_from_slice(&reading.numbers[..n]);
            self.arguments[n_flat + n..n_flat + n + 2].copy_from_slice(&[reading.gate, reading.fading]);
            let (program, work) = &mut self.corrections[reading.aid];
            program.evaluate(work, &self.arguments[..n_flat + n + 2], &mut self.results);
            let [squared, is_taken] = self.results.array(n_flat);
            if !reading.is_counted {
                self.samples[at].readings[r].is_counted = true;
                let period = self.filter.aids[reading.aid].schedule.every as f64 * self.dt;
                let (told, record) = (Agreement { squared, is_taken }, &mut self.records[reading.aid]);
                self.trust[reading.aid].count(told, period, record);
            }
        }
        let is_anew = begin_anew(&mut self.results[..n_flat], &self.filter.bias_start);
        self.begun_anew += u64::from(is_anew && j + 1 == self.n_sample);
        self.samples[at].state.copy_from_slice(&self.results[..n_flat]);
    }
}

/// What is estimated.
impl StateEstimator {
    /// Pose and velocities of the body, velocity and angular velocity in the world: of the newest sample of the inertial unit, and, where
    /// that is read late, as it goes on with what was read last.
    pub fn estimate(&self) -> Frame<f64> {
        let mut own = self.mean();
        let late = self.filter.inertial.latency as f64 * self.dt;
        if late > 0.0 && self.n_sample > 0 {
            let f: [f64; 3] = self.sample(self.n_sample - 1).inertial.numbers.array(0);
            let push = rotate(own.attitude, sub(f, own.accelerometer_bias));
            let push = add(push, [0.0, 0.0, -self.gravity]);
            own.position = add(own.position, add(scale(late, own.velocity), scale(0.5 * late * late, push)));
            own.velocity = add(own.velocity, scale(late, push));
            own.attitude = multiply(own.attitude, exponential(scale(late, own.angular_velocity())));
        }
        self.filter.body(&own)
    }

    /// Place, velocity (world) and attitude of the inertial unit, and biases, with their covariance: of its newest sample.
    pub fn newest(&self) -> NavigationState<f64> {
        NavigationState::read(&self.sample(self.n_sample.saturating_sub(1)).state, self.filter.n_bias())
    }

    /// P, n × n: of place (m, world), velocity (m/s, world) and attitude (rad, about the unit's axes), then of biases.
    pub fn covariance(&self) -> DMatrix<f64> {
        let n = self.filter.n_error();
        DMatrix::from_row_slice(n, n, self.flat_covariance())
    }

    /// Standard deviations of place (m), velocity (m/s) and attitude (rad): the first of √diag P.
    pub fn deviations(&self) -> [f64; 9] {
        std::array::from_fn(|k| self.flat_covariance()[k * (self.filter.n_error() + 1)].max(0.0).sqrt())
    }

    fn mean(&self) -> NavigationState<f64> {
        let flat = &self.sample(self.n_sample.saturating_sub(1)).state;
        NavigationState::mean(|k| flat[k])
    }

    fn flat_covariance(&self) -> &[f64] {
        let flat = &self.sample(self.n_sample.saturating_sub(1)).state;
        &flat[flat.len() - self.filter.n_error().pow(2)..]
    }

    /// Steps that [`newest`](Self::newest) stands behind the present: those that the unit is late.
    pub fn late(&self) -> usize {
        self.filter.inertial.latency as usize
    }

    /// Its settings.
    pub fn settings(&self) -> &StateEstimatorSettings {
        &self.settings
    }

    /// By how much a body that was at `truth` when the newest sample was taken differs: place (m, world), velocity (m/s, world), attitude (rad, about the unit's axes), `[9]`.
    pub fn error(&self, truth: &Frame<f64>) -> [f64; 9] {
        self.filter.error(&self.mean(), truth)
    }

    /// eᵀ P⁻¹ e over place, velocity and attitude (NEES): χ² with nine degrees of freedom where the estimate is consistent.
    ///
    /// # Errors
    /// [`Error::Value`] where P is not positive definite.
    pub fn squared_error(&self, truth: &Frame<f64>) -> Result<f64> {
        self.filter.squared_error(&self.mean(), self.flat_covariance(), truth)
    }

    /// How readings agreed with what was expected, sensor by sensor.
    pub fn records(&self) -> &[InnovationRecord] {
        &self.records
    }

    /// Samples of the inertial unit at a limit or no numbers.
    pub fn saturated(&self) -> u64 {
        self.saturated
    }

    /// How often it began anew, knowing nothing, as what it knew had become no covariance: after readings that made no sense for long.
    pub fn begun_anew(&self) -> u64 {
        self.begun_anew
    }

    /// What it knows of the sensors.
    pub fn filter(&self) -> &SensorFilter {
        &self.filter
    }

    fn largest_variance(&self) -> f64 {
        self.flat_covariance().iter().step_by(self.filter.n_error() + 1).copied().fold(f64::MIN_POSITIVE, f64::max)
    }

    fn sample(&self, j: u64) -> &Sample {
        &self.samples[(j % self.samples.len() as u64) as usize]
    }

    fn sample_mut(&mut self, j: u64) -> &mut Sample {
        let slot = (j % self.samples.len() as u64) as usize;
        &mut self.samples[slot]
    }
}
