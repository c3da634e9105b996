//! A complementary filter: an inertial unit for what is fast, other sensors for what lasts, with gains that stay.
//!
//! ```text
//! q̇ = q ⊗ (ω_y − b̂ + k ν)        ḃ̂ = −k k_b ν       ν: of the attitude, rad, axes of the unit
//! v̂̇ = R f_y + g + …                p̂̇ = v̂ + …
//! ```
//!
//! | what tells | ν | taken in over the time T since its last sample |
//! |---|---|---|
//! | accelerometer | f × Rᵀ e_z/\|f\| | 1 − exp(−k T) of it, in every sample |
//! | motion capture, magnetometer | the turn that is missing | likewise |
//! | position, height | what is missing, m | (1 − r²) ν of the place, (1 − r)² ν/T of the velocity, r = exp(−k T) |
//! | velocity | what is missing, m/s | 1 − exp(−k T) of it |
//!
//! k is a rate in 1/s, and 1/k the time constant: errors of attitude and velocity fade as exp(−k t), those of the place have both poles at
//! −k (an α-β filter without overshoot). k_b ≪ k is the rate at which a bias of the gyroscope is found.
//!
//! The accelerometer rights the tilt only where nothing tells the attitude. It takes the specific force for the vertical, which holds on
//! the ground and on average over long flights: a multirotor's specific force is its thrust, which stands on the body whatever the tilt.
//!
//! Where a barometer or a range finder tells the height, that of a satellite receiver does not count.
//!
//! A barometer is set by its first reading to the height at which the flight begins. What is late is compared with the estimate of then, from a short history; the difference is taken in now. Nothing is gated, and there is
//! no covariance: how good the estimate is, it does not know.
//!
//! Source: Mahony, Hamel and Pflimlin 2008 (the passive filter on SO(3), with bias); the gains of a place: Brookner 1998, section 1.2.6.

use super::aiding::AidKind;
use super::fix::{FixKind, innovation};
use super::sensor_filter::{SensorFilter, SensorSchedule};
use autodiff::{Array, Scalar};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::Frame;
use dynamics::sensors::{SensorConfig, SensorModel};
use dynamics::spatial::{
    Quat, Vec3, add, axpy, conjugate, cross, exponential, multiply, rotate, rotate_back, scale, sub, unit,
};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Largest number that a sensor may read, in its unit: beyond, it is no reading.
const MOST_READ: f64 = 1e9;
/// Largest of an inertial unit, m/s² and rad/s.
const MOST_FELT: f64 = 1e4;

with_defaults! {
    /// Gains of a [`ComplementaryFilter`], rates in 1/s; 0 leaves out what they are of.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ComplementarySettings {
        /// Of the tilt by the accelerometer's direction. Plays no part beside motion capture.
        pub accelerometer: f64 = 0.1,
        /// Of the attitude by motion capture.
        pub attitude: f64 = 10.0,
        /// Of the heading by a magnetometer.
        pub heading: f64 = 1.0,
        /// At which a bias of the gyroscope is found; far below the gains of the attitude.
        pub bias: f64 = 0.05,
        /// Of place and velocity by motion capture.
        pub motion_capture: f64 = 15.0,
        /// Of place and velocity by positions of a satellite receiver.
        pub gnss: f64 = 0.3,
        /// Of the velocity by velocities of a satellite receiver.
        pub gnss_velocity: f64 = 2.0,
        /// Of height and vertical velocity by barometer and range finder.
        pub height: f64 = 2.0,
    }
}

impl ComplementarySettings {
    /// Checks that all are within [0, 1000].
    ///
    /// # Errors
    /// [`Error::Value`] for the first that is not.
    pub fn validate(&self) -> Result<()> {
        let all = [
            ("accelerometer", self.accelerometer),
            ("attitude", self.attitude),
            ("heading", self.heading),
            ("bias", self.bias),
            ("motion_capture", self.motion_capture),
            ("gnss", self.gnss),
            ("gnss_velocity", self.gnss_velocity),
            ("height", self.height),
        ];
        match all.into_iter().find(|(_, x)| !(0.0..=100.0).contains(x)) {
            None => Ok(()),
            Some((name, x)) => {
                let remedy = "Leave it out for the default; 0 leaves out what it is of.";
                Err(Error::value(format!("estimator: {name}"), x, "within [0, 100] 1/s", remedy))
            }
        }
    }

    /// k of what a sensor of a kind tells.
    fn rate(&self, sensor: &SensorModel, kind: FixKind) -> f64 {
        match (kind, sensor) {
            (FixKind::Position, SensorModel::Gnss(_)) => self.gnss,
            (FixKind::Position, _) => self.motion_capture,
            (FixKind::Velocity, _) => self.gnss_velocity,
            (FixKind::Attitude, _) => self.attitude,
            (FixKind::Heading, _) => self.heading,
            (FixKind::Height, _) => self.height,
        }
    }
}

/// Where an inertial unit is, over any scalar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComplementaryState<S> {
    /// p, m, world.
    pub position: Vec3<S>,
    /// v, m/s, world.
    pub velocity: Vec3<S>,
    /// q, axes of the unit → world.
    pub attitude: Quat<S>,
    /// ω as read last, rad/s, axes of the unit, with its bias.
    pub read_rate: Vec3<S>,
    /// b̂, rad/s.
    pub gyroscope_bias: Vec3<S>,
}

impl<S: Scalar> ComplementaryState<S> {
    /// ω without its bias, rad/s, axes of the unit.
    pub fn angular_velocity(&self) -> Vec3<S> {
        sub(self.read_rate, self.gyroscope_bias)
    }

    /// Its motion, angular velocity along world axes.
    pub fn frame(&self) -> Frame<S> {
        Frame {
            position: self.position,
            velocity: self.velocity,
            attitude: self.attitude,
            angular_velocity: rotate(self.attitude, self.angular_velocity()),
        }
    }

    /// One sample further: `f` the specific force (m/s²) and `rate` (rad/s) that the unit reads `dt` seconds after the last sample, gravity
    /// along −z in m/s². `leveling` (1/s) is the gain of the accelerometer's direction, `bias` (1/s) that of the bias.
    pub fn predict(&mut self, [f, rate]: [Vec3<S>; 2], [leveling, bias]: [f64; 2], [dt, gravity]: [f64; 2]) {
        let half = S::constant(0.5);
        let mean = sub(scale(half, add(self.read_rate, rate)), self.gyroscope_bias);
        let turn = scale(S::constant(dt), mean);
        let middle = multiply(self.attitude, exponential(scale(half, turn)));
        let push = add(rotate(middle, f), [S::zero(), S::zero(), S::constant(-gravity)]);
        let velocity = axpy(self.velocity, S::constant(dt), push);
        self.position = axpy(self.position, S::constant(0.5 * dt), add(self.velocity, velocity));
        self.velocity = velocity;
        self.attitude = unit(multiply(self.attitude, exponential(turn)));
        self.read_rate = rate;
        if leveling > 0.0 {
            let up = rotate_back(self.attitude, [S::zero(), S::zero(), S::one()]);
            let squared = f[0] * f[0] + f[1] * f[1] + f[2] * f[2];
            // free fall has no direction
            let length = squared.max(S::constant(1e-6)).sqrt();
            let missing = scale(length.recip(), cross(f, up));
            self.turn_by(rotate(self.attitude, missing), gain(leveling, dt), bias);
        }
    }

    /// Takes in what is missing (ν of [`fix`](super::fix)), `rate` (1/s) its gain, `dt` (s) the time since the sensor's last sample.
    pub(crate) fn correct(&mut self, kind: FixKind, missing: Vec3<S>, [rate, bias, dt]: [f64; 3]) {
        let once = gain(rate, dt);
        let r = (-rate * dt).exp();
        let [place, speed] = [1.0 - r * r, (1.0 - r).powi(2) / dt].map(S::constant);
        match kind {
            FixKind::Position => {
                self.position = axpy(self.position, place, missing);
                self.velocity = axpy(self.velocity, speed, missing);
            }
            FixKind::Velocity => self.velocity = axpy(self.velocity, S::constant(once), missing),
            FixKind::Attitude => self.turn_by(missing, once, bias),
            FixKind::Heading => self.turn_by([S::zero(), S::zero(), missing[0]], once, bias),
            FixKind::Height => {
                self.position[2] += place * missing[0];
                self.velocity[2] += speed * missing[0];
            }
        }
    }

    /// A share of a turn about world axes, rad, and of it a share for the bias.
    fn turn_by(&mut self, missing: Vec3<S>, share: f64, bias: f64) {
        let own = rotate_back(self.attitude, missing);
        self.gyroscope_bias = axpy(self.gyroscope_bias, S::constant(-share * bias), own);
        self.attitude = unit(multiply(self.attitude, exponential(scale(S::constant(share), own))));
    }
}

/// 1 − exp(−k T).
fn gain(rate: f64, dt: f64) -> f64 {
    -(-rate * dt).exp_m1()
}

/// A sensor, what it tells and how it is taken in.
#[derive(Debug, Clone, PartialEq)]
struct PlannedFix {
    /// Number among the aids.
    aid: usize,
    kind: FixKind,
    /// k, 1/s.
    rate: f64,
    /// Whether it tells the height too.
    is_high: bool,
    /// By how much a barometer is off, m, once it has been read.
    set: Option<f64>,
}

/// A complementary filter over readings: an inertial unit for what is fast, other sensors for what lasts.
///
/// ```text
/// q̇ = q ⊗ (ω_y − b̂ + k ν)        ḃ̂ = −k k_b ν        v̂̇ = R f_y + g,  p̂̇ = v̂ between fixes
/// ```
///
/// ν (rad) is the turn that motion capture, a magnetometer, or without them the accelerometer's direction misses; k (1/s) its gain, k_b that
/// of the gyroscope's bias b̂. Fixes of a place correct place and velocity so that both poles of the error are at −k, those of a velocity
/// as exp(−k t). What is late is compared with the estimate of then and taken in now.
///
/// Source: Mahony, Hamel and Pflimlin 2008.
#[derive(Debug, Clone)]
pub struct ComplementaryFilter {
    filter: SensorFilter,
    fixes: Vec<PlannedFix>,
    /// k of the accelerometer and of the bias.
    own: [f64; 2],
    gravity: f64,
    dt: f64,
    state: ComplementaryState<f64>,
    /// Of the last steps, newest first.
    history: VecDeque<ComplementaryState<f64>>,
    n_kept: usize,
    felt: [f64; 6],
    step: u64,
    is_begun: bool,
    saturated: u64,
}

impl ComplementaryFilter {
    /// For these sensors in steps of `dt` seconds under `gravity` (m/s², along −z).
    ///
    /// # Errors
    /// As [`SensorFilter::new`] and [`ComplementarySettings::validate`].
    pub fn new(configs: &[SensorConfig], settings: &ComplementarySettings, dt: f64, gravity: f64) -> Result<Self> {
        settings.validate()?;
        let filter = SensorFilter::new(configs, dt)?;
        let model =
            |own: &SensorSchedule| configs.iter().find(|config| config.name == own.name).map(|config| &config.model);
        let planned = filter.aids.iter().enumerate().filter_map(|(aid, own)| {
            let (kind, model) = (FixKind::of(&own.aid.kind)?, model(&own.schedule)?);
            let is_high = !matches!(model, SensorModel::Gnss(_));
            Some(PlannedFix { aid, kind, rate: settings.rate(model, kind), is_high, set: None })
        });
        let mut fixes: Vec<PlannedFix> = planned.filter(|fix| fix.rate > 0.0).collect();
        if fixes.iter().all(|fix| fix.kind != FixKind::Height) {
            fixes.iter_mut().for_each(|fix| fix.is_high = true);
        }
        let is_turned = fixes.iter().any(|fix| fix.kind == FixKind::Attitude);
        let late = |fix: &PlannedFix| filter.aids[fix.aid].schedule.latency.saturating_sub(filter.inertial.latency);
        let n_kept = fixes.iter().map(late).max().unwrap_or(0) as usize + 1;
        let still = ComplementaryState {
            position: [0.0; 3],
            velocity: [0.0; 3],
            attitude: [1.0, 0.0, 0.0, 0.0],
            read_rate: [0.0; 3],
            gyroscope_bias: [0.0; 3],
        };
        Ok(Self {
            own: [if is_turned { 0.0 } else { settings.accelerometer }, settings.bias],
            filter,
            fixes,
            gravity,
            dt,
            state: still,
            history: VecDeque::with_capacity(n_kept + 1),
            n_kept,
            felt: [0.0, 0.0, gravity, 0.0, 0.0, 0.0],
            step: 0,
            is_begun: false,
            saturated: 0,
        })
    }

    /// Begins a flight where the body is known to be: pose and velocity in the world, angular velocity in the world.
    pub fn begin(&mut self, known: &Frame<f64>) {
        let (lever, rotation) = self.filter.mount;
        let (position, velocity) = known.point(lever);
        let attitude = multiply(known.attitude, rotation);
        let read_rate = rotate_back(attitude, known.angular_velocity);
        self.state = ComplementaryState { position, velocity, attitude, read_rate, gyroscope_bias: [0.0; 3] };
        self.felt = [0.0; 6];
        self.felt[..3].copy_from_slice(&rotate_back(attitude, [0.0, 0.0, self.gravity]));
        self.felt[3..].copy_from_slice(&read_rate);
        (self.step, self.is_begun, self.saturated) = (0, false, 0);
        self.history.clear();
        self.fixes.iter_mut().for_each(|fix| fix.set = None);
    }

    /// One step of the simulation further: takes in what is new among all readings.
    ///
    /// # Panics
    /// For fewer readings than the sensors have.
    pub fn step(&mut self, readings: &[f64]) {
        let step = self.step;
        self.step += 1;
        if self.filter.inertial.sampled(step).is_some() {
            self.feel(readings.array(self.filter.inertial.first));
        }
        self.history.push_front(self.state);
        self.history.truncate(self.n_kept);
        for k in 0..self.fixes.len() {
            let fix = &self.fixes[k];
            let own = &self.filter.aids[fix.aid];
            let Some(sampled) = own.schedule.sampled(step) else { continue };
            let (first, n) = (own.schedule.first, own.aid.kind.n_reading());
            let is_lost = own.valid.is_some_and(|valid| readings[first + valid] != 1.0);
            let numbers = &readings[first..first + n];
            if is_lost || !numbers.iter().all(|x| x.abs() <= MOST_READ) {
                continue;
            }
            let ago = (step - sampled).saturating_sub(self.filter.inertial.latency) as usize;
            let then = self.history[ago.min(self.history.len() - 1)].frame();
            let mut missing = innovation(&own.aid, &then, numbers);
            if matches!(own.aid.kind, AidKind::Pressure(_)) {
                missing[0] -= *self.fixes[k].set.get_or_insert(missing[0]);
            }
            let fix = &self.fixes[k];
            if fix.kind == FixKind::Position && !fix.is_high {
                missing[2] = 0.0;
            }
            let between = own.schedule.every as f64 * self.dt;
            self.state.correct(fix.kind, missing, [fix.rate, self.own[1], between]);
        }
        // what was taken in now is known from now on
        self.history[0] = self.state;
    }

    /// A sample of the unit; numbers that no unit reads are held.
    fn feel(&mut self, inertial: [f64; 6]) {
        let is_read = |x: f64| x.abs() <= MOST_FELT;
        let is_beyond = |k: usize| !is_read(inertial[k]) || self.filter.is_at_limit(k / 3, inertial[k]);
        self.saturated += u64::from((0..6).any(is_beyond));
        for (own, x) in self.felt.iter_mut().zip(inertial) {
            *own = if is_read(x) { x } else { *own };
        }
        let [f, rate]: [Vec3<f64>; 2] = [self.felt[..].array(0), self.felt[..].array(3)];
        if std::mem::replace(&mut self.is_begun, true) {
            self.state.predict([f, rate], self.own, [self.filter.between, self.gravity]);
        } else {
            // begun where it is known: its sample says how it turns
            self.state.read_rate = rate;
        }
    }

    /// Pose and velocities of the body, velocity and angular velocity in the world: of the newest sample of the inertial unit, and, where
    /// that is read late, as it goes on with what was read last.
    pub fn estimate(&self) -> Frame<f64> {
        let mut own = self.state;
        let late = self.filter.inertial.latency as f64 * self.dt;
        if late > 0.0 {
            let push = add(rotate(own.attitude, self.felt[..].array(0)), [0.0, 0.0, -self.gravity]);
            own.position = add(own.position, add(scale(late, own.velocity), scale(0.5 * late * late, push)));
            own.velocity = add(own.velocity, scale(late, push));
            own.attitude = multiply(own.attitude, exponential(scale(late, own.angular_velocity())));
        }
        let (lever, rotation) = self.filter.mount;
        let unit = own.frame();
        let attitude = multiply(unit.attitude, conjugate(rotation));
        let arm = rotate(attitude, lever);
        Frame {
            position: sub(unit.position, arm),
            velocity: sub(unit.velocity, cross(unit.angular_velocity, arm)),
            attitude,
            angular_velocity: unit.angular_velocity,
        }
    }

    /// Where the unit is by its newest sample.
    pub fn newest(&self) -> &ComplementaryState<f64> {
        &self.state
    }

    /// Whether the accelerometer rights the tilt: where no sensor tells the attitude.
    pub fn is_levelled(&self) -> bool {
        self.own[0] > 0.0
    }

    /// Samples of the inertial unit at a limit or no numbers.
    pub fn saturated(&self) -> u64 {
        self.saturated
    }
}

#[cfg(test)]
mod tests;
