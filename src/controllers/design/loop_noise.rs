//! What noise of sensors does to a loop: deviations of its states and of its commands, by the Lyapunov equation and as flown.
//!
//! A sample of a sensor is wrong by white noise and is held until the next one. With the error x of the loop and the held noise h,
//!
//! ```text
//! h⁺ = h, or M w with w ~ N(0, I) where a sample is taken
//! x⁺ = A_k x + B_k E h⁺        u = C_k x + D_k E h⁺
//! ```
//!
//! over the steps k of a period of all rates. The steps of a period together are z⁺ = Φ z + v, v ~ N(0, Q), of z = [x, h], and
//! P = Φ P Φᵀ + Q is its covariance at the beginning of a period. Going on with P through the period gives that of every step; deviations
//! are roots of means over them. A and B are those of [`LoopModel`]: no command at its limit, and motors with the longer of their lags.
//!
//! What wanders, as a bias does, has no such covariance, and is left out.
//!
//! Source: Kwakernaak and Sivan 1972, section 6.2; Bittanti and Colaneri 2009, section 6.2 (lifting).

use super::error_state::quaternion;
use super::loop_model::{LoopModel, Step};
use super::{ErrorState, riccati};
use crate::closed_loop::{ClosedLoop, ExogenousInputs};
use crate::controller::{Controller, Target};
use crate::estimation::white_variance;
use crate::period::common_period;
use base::error::{Error, Result};
use dynamics::sensors::{ErrorModel, SensorConfig, SensorModel};
use dynamics::spatial::{exponential, matrix, multiply};
use dynamics::{Disturbance, Plant};
use nalgebra::{DMatrix, DVector};
use rng::{Purpose, Stream};
use serde::Serialize;

/// Most steps until all rates of loop and sensors come round.
const MOST_STEPS: u64 = 2000;

/// White noise that a sensor adds to three numbers of what a controller is given; held from one sample to the next.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeasurementNoise {
    /// Whose: `imu.gyroscope`.
    pub name: String,
    /// First of the three numbers of the error state: 0 position and 3 velocity (world), 6 rotation vector and 9 rate (body).
    pub place: usize,
    /// M, by rows: noise is M w with w ~ N(0, I). m, m/s, rad or rad/s.
    pub mix: [[f64; 3]; 3],
    /// Steps from one sample to the next.
    pub every: u64,
}

impl MeasurementNoise {
    /// Checks where it acts and how often, for a state with `n` numbers of the error.
    ///
    /// # Errors
    /// [`Error::Value`] that names it.
    fn validate(&self, n: usize) -> Result<()> {
        let is_finite = self.mix.iter().flatten().all(|x| x.is_finite());
        if [0, 3, 6, 9].contains(&self.place) && self.place + 3 <= n && self.every > 0 && is_finite {
            return Ok(());
        }
        let value = format!("at number {} of {n}, every {} steps, by {:?}", self.place, self.every, self.mix);
        let limit = "finite, at 0, 3, 6 or 9 of the error state, every step or more";
        Err(Error::value(format!("noise '{}'", self.name), value, limit, "See MeasurementNoise."))
    }

    /// What sensors tell a controller directly, in steps of `dt` seconds: an imu's gyroscope the rate, a motion capture position and
    /// attitude. White noise alone, with that of rounding: biases wander, and lost samples and latency are left out.
    ///
    /// # Errors
    /// [`Error::Value`] for other sensors, whose readings take a filter before a controller can fly on them, for those without white
    /// noise, and as [`SensorConfig::steps_between`].
    pub fn of_sensors(sensors: &[SensorConfig], dt: f64) -> Result<Vec<Self>> {
        let mut all = Vec::new();
        for sensor in sensors {
            let parts: &[(&str, usize, &ErrorModel)] = match &sensor.model {
                SensorModel::Imu(imu) => &[("gyroscope", 9, &imu.gyroscope)],
                SensorModel::MotionCapture(cameras) => {
                    &[("position", 0, &cameras.position_error), ("attitude", 6, &cameras.attitude_error)]
                }
                other => {
                    let remedy = "Leave it out here; 'fly' with an estimator takes it in.";
                    let limit = "imu or motion_capture: others tell no number that the controller takes as it is";
                    return Err(Error::value(sensor.place(), other.kind(), limit, remedy));
                }
            };
            let every = sensor.steps_between(dt)?;
            let before = all.len();
            for (name, place, model) in parts {
                let deviation = [0, 1, 2].map(|axis| white_variance(model, axis, every as f64 * dt, 0.0).sqrt());
                // positions are read along world axes, rates along those of the mount
                let turned = if *place == 0 { matrix([1.0, 0.0, 0.0, 0.0]) } else { matrix(sensor.rotation) };
                let mix = turned.map(|row| [0, 1, 2].map(|k| row[k] * deviation[k]));
                if deviation.iter().any(|d| *d > 0.0) {
                    all.push(Self { name: format!("{}.{name}", sensor.name), place: *place, mix, every });
                }
            }
            if all.len() == before {
                let remedy = "Name a preset, as imu:bmi088, or give it a density or a deviation.";
                return Err(Error::value(sensor.place(), "without white noise", "noise that can be followed", remedy));
            }
        }
        Ok(all)
    }

    /// Standard deviation of a sample per axis.
    pub fn deviation(&self) -> [f64; 3] {
        self.mix.map(|row| row.iter().map(|m| m * m).sum::<f64>().sqrt())
    }
}

/// Deviations of a loop under noise: root mean squares over all steps, of what is true and not of what is measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LoopDeviations {
    /// Of the plant's error state, in its order: of a rigid vehicle position, velocity (world), rotation vector, rate (body), then rotor
    /// speeds. m, m/s, rad, rad/s.
    pub states: Vec<f64>,
    /// Of the commands, in their order.
    pub commands: Vec<f64>,
}

/// The covariance of [x, h] at the beginning of a period, and how it goes on.
struct Propagated<'a> {
    model: &'a LoopModel,
    noise: &'a [MeasurementNoise],
    /// Steps until all rates come round.
    period: u64,
}

impl<'a> Propagated<'a> {
    fn new(model: &'a LoopModel, noise: &'a [MeasurementNoise]) -> Result<Self> {
        if !model.stability()?.is_stable() {
            let remedy = "Give gains of a loop that is stable: otherwise noise grows without end.";
            return Err(Error::value("loop under noise", "not stable", "stable", remedy));
        }
        noise.iter().try_for_each(|one| one.validate(model.measurements.len()))?;
        let period = noise.iter().fold(model.period() as u64, |all, one| common_period(all, one.every));
        if period > MOST_STEPS {
            let remedy = "Let rates of sensors and levels be whole parts of one another.";
            return Err(Error::limit("steps until loop and sensors come round", period, MOST_STEPS, remedy));
        }
        Ok(Self { model, noise, period })
    }

    fn n(&self) -> usize {
        self.model.n_state() + 3 * self.noise.len()
    }

    fn step(&self, k: u64) -> &Step {
        &self.model.steps[k as usize % self.model.period()]
    }

    /// What is left of [x, h] where samples are taken in step k, and what they add: K, and G with G w.
    fn sampled(&self, k: u64) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, first) = (self.n(), self.model.n_state());
        let (mut keep, mut drawn) = (DMatrix::identity(n, n), DMatrix::zeros(n, n - first));
        for (i, one) in self.noise.iter().enumerate().filter(|(_, one)| k.is_multiple_of(one.every)) {
            for row in 0..3 {
                keep[(first + 3 * i + row, first + 3 * i + row)] = 0.0;
                (0..3).for_each(|c| drawn[(first + 3 * i + row, 3 * i + c)] = one.mix[row][c]);
            }
        }
        (keep, drawn)
    }

    /// `of_measured`, whose columns are the numbers measured, times E, beside `of_state`.
    fn with_noise(&self, of_state: &DMatrix<f64>, of_measured: &DMatrix<f64>) -> DMatrix<f64> {
        let first = of_state.ncols();
        let mut all = DMatrix::zeros(of_state.nrows(), self.n());
        all.columns_mut(0, first).copy_from(of_state);
        for (i, one) in self.noise.iter().enumerate() {
            all.columns_mut(first + 3 * i, 3).copy_from(&of_measured.columns(one.place, 3));
        }
        all
    }

    /// [x, h] a step later, of what it is behind the samples of step k.
    fn moved(&self, k: u64) -> DMatrix<f64> {
        let (step, n, first) = (self.step(k), self.n(), self.model.n_state());
        let mut all = DMatrix::identity(n, n);
        all.rows_mut(0, first).copy_from(&self.with_noise(&step.a, &step.by_measurement));
        all
    }

    /// Numbers of interest of [x, h] behind the samples of step k: error state of the plant, then commands.
    fn told(&self, k: u64) -> DMatrix<f64> {
        let (step, own, n) = (self.step(k), self.model.measurements.len(), self.n());
        let commanded = &step.commanded;
        // what is measured reaches the commands as the state does
        let given = self.with_noise(commanded, &commanded.columns(0, own).into_owned());
        let mut all = DMatrix::zeros(own + commanded.nrows(), n);
        (0..own).for_each(|i| all[(i, i)] = 1.0);
        all.rows_mut(own, commanded.nrows()).copy_from(&given);
        all
    }

    /// Φ, and P at the beginning of a period, before its samples.
    fn steady(&self) -> Result<(DMatrix<f64>, DMatrix<f64>)> {
        let n = self.n();
        let (mut phi, mut q) = (DMatrix::identity(n, n), DMatrix::zeros(n, n));
        for k in 0..self.period {
            let ((keep, drawn), moved) = (self.sampled(k), self.moved(k));
            phi = &moved * &keep * phi;
            q = &moved * (&keep * q * &keep + &drawn * drawn.transpose()) * moved.transpose();
        }
        let q = (&q + q.transpose()) * 0.5;
        let p = riccati::lyapunov(&phi.transpose(), &q)?.matrix;
        Ok((phi, p))
    }
}

impl LoopModel {
    /// Deviations that noise of measurements makes, by the Lyapunov equation over a period of all rates.
    ///
    /// # Errors
    /// [`Error::Value`] for a loop that is not stable and for noise of numbers that are not there; [`Error::Limit`] for sensors that come
    /// round with the loop after more than 2000 steps.
    pub fn deviations(&self, noise: &[MeasurementNoise]) -> Result<LoopDeviations> {
        let own = Propagated::new(self, noise)?;
        let (_, mut p) = own.steady()?;
        let mut squares = DVector::zeros(self.measurements.len() + self.commands.len());
        for k in 0..own.period {
            let (keep, drawn) = own.sampled(k);
            p = &keep * p * &keep + &drawn * drawn.transpose();
            let told = own.told(k);
            squares += (&told * &p * told.transpose()).diagonal();
            let moved = own.moved(k);
            p = &moved * p * moved.transpose();
        }
        let roots: Vec<f64> = squares.iter().map(|s| (s.max(0.0) / own.period as f64).sqrt()).collect();
        let (states, commands) = roots.split_at(self.measurements.len());
        Ok(LoopDeviations { states: states.to_vec(), commands: commands.to_vec() })
    }

    /// By how much deviations of a flight of `duration` seconds scatter about those of [`deviations`](Self::deviations), relative, one
    /// standard deviation: ½ √((2/n)(1 + 2 Σ (1 − j/n) ρⱼ²)) over its n periods, with the correlation ρⱼ over j of them. A little more
    /// than it is, for steps within a period tell something too.
    ///
    /// # Errors
    /// As [`deviations`](Self::deviations).
    pub fn scatter(&self, noise: &[MeasurementNoise], duration: f64) -> Result<LoopDeviations> {
        let own = Propagated::new(self, noise)?;
        let (phi, p) = own.steady()?;
        let ((keep, drawn), told) = (own.sampled(0), own.told(0));
        let here = &keep * &p * &keep + &drawn * drawn.transpose();
        let size = (&told * &here * told.transpose()).diagonal();
        // from behind the samples of a period to before those of the next
        let mut way = own.moved(0);
        for k in 1..own.period {
            way = own.moved(k) * own.sampled(k).0 * way;
        }
        let seen = &told * &keep;
        let mut later = way * here * told.transpose();
        let n = (duration / (self.dt * own.period as f64)).floor().max(1.0);
        let mut sums = DVector::from_element(size.len(), 1.0);
        for j in 1..n as u64 {
            let left = 1.0 - j as f64 / n;
            for i in 0..size.len() {
                if size[i] > 0.0 {
                    sums[i] += 2.0 * left * (seen.row(i).transpose().dot(&later.column(i)) / size[i]).powi(2);
                }
            }
            later = &phi * later;
        }
        let roots: Vec<f64> = sums.iter().map(|s| 0.5 * (2.0 * s / n).sqrt()).collect();
        let (states, commands) = roots.split_at(self.measurements.len());
        Ok(LoopDeviations { states: states.to_vec(), commands: commands.to_vec() })
    }
}

/// How noise is flown.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NoiseFlight {
    /// Before it counts, s: until a flight has forgotten where it began.
    pub settling: f64,
    /// What counts, s.
    pub duration: f64,
    /// Of the noise.
    pub seed: u64,
}

/// Deviations of a flight of a rigid vehicle under noise that is added to what its controller is given: root mean squares of what is
/// different in the same flight without noise. Limits of rotors, both lags of motors and all else that a linear model leaves out are in it.
///
/// # Errors
/// [`Error::Value`] for an articulated plant, for a state that is not of the plant, and for a flight that diverges.
pub fn flown_deviations<C: Controller + Clone>(
    closed: &ClosedLoop<C>,
    (target, air): (Target<'_>, &Disturbance<f64>),
    start: &[f64],
    noise: &[MeasurementNoise],
    flight: &NoiseFlight,
) -> Result<LoopDeviations> {
    let plant = closed.plant();
    plant.check_state(start)?;
    if let Plant::Tree(_) = plant {
        let remedy = "Take a vehicle.";
        return Err(Error::value(format!("plant '{}'", plant.name()), "articulated", "one rigid vehicle", remedy));
    }
    let (errors, m, dt) = (ErrorState::of_plant(plant)?, closed.n_command(), plant.physics().dt);
    noise.iter().try_for_each(|one| one.validate(errors.n_error()))?;
    if !(flight.duration >= dt && flight.duration <= 1e5 && (0.0..=1e5).contains(&flight.settling)) {
        let value = format!("{} s after {} s", flight.duration, flight.settling);
        return Err(Error::value("flight under noise", value, "a step to 1e5 s, after 0 to 1e5 s", "Give seconds."));
    }
    let (mut calm, mut noisy) = (closed.clone(), closed.clone());
    calm.reset();
    noisy.reset();
    let (mut x, mut y) = ([start.to_vec(), start.to_vec()], [start.to_vec(), start.to_vec()]);
    let quiet = ExogenousInputs::air(*air);
    let mut loud = ExogenousInputs { at_output: vec![0.0; start.len()], ..quiet.clone() };
    let mut streams: Vec<Stream> =
        (0..noise.len()).map(|i| Stream::new(flight.seed, i as u64, 0, Purpose::SENSORS)).collect();
    let mut held = vec![[0.0; 3]; noise.len()];
    let mut error = vec![0.0; errors.n_error()];
    let mut squares = vec![0.0; errors.n_error() + m];
    let [settling, counted] = [flight.settling, flight.duration].map(|time| (time / dt).round() as u64);
    for k in 0..settling + counted {
        let mut turn = [0.0; 3];
        loud.at_output.fill(0.0);
        for ((one, stream), held) in noise.iter().zip(&mut streams).zip(&mut held) {
            if k.is_multiple_of(one.every) {
                let w = [0; 3].map(|_| stream.normal());
                *held = one.mix.map(|row| (0..3).map(|c| row[c] * w[c]).sum());
            }
            // behind the attitude a number of the error stands one place later in the state
            let at = if one.place > 6 { one.place + 1 } else { one.place };
            let into = if one.place == 6 { &mut turn[..] } else { &mut loud.at_output[at..at + 3] };
            into.iter_mut().zip(&*held).for_each(|(sum, part)| *sum += part);
        }
        let attitude = quaternion(&y[0], 6);
        let measured = multiply(attitude, exponential(turn));
        (0..4).for_each(|i| loud.at_output[6 + i] = measured[i] - attitude[i]);
        let ([now, next], [own, own_next]) = (&mut x, &mut y);
        calm.advance(now, target, &quiet, next)?;
        noisy.advance(own, target, &loud, own_next)?;
        if k >= settling {
            errors.write_difference(own, now, &mut error);
            let commands = noisy.applied()[..m].iter().zip(calm.applied()).map(|(a, b)| a - b);
            error.iter().copied().chain(commands).zip(&mut squares).for_each(|(e, sum)| *sum += e * e);
        }
        std::mem::swap(now, next);
        std::mem::swap(own, own_next);
    }
    if squares.iter().any(|s| !s.is_finite()) {
        let remedy = "Take less noise, or gains of a loop with more margin.";
        return Err(Error::value("flight under noise", "diverged", "bounded", remedy));
    }
    let roots: Vec<f64> = squares.iter().map(|s| (s / counted as f64).sqrt()).collect();
    let (states, commands) = roots.split_at(errors.n_error());
    Ok(LoopDeviations { states: states.to_vec(), commands: commands.to_vec() })
}

#[cfg(test)]
mod tests;
