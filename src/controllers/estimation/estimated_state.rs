//! The state that a controller is given in place of the truth: what a filter makes of readings, and rotor speeds as they follow commands.

use super::estimator::{Estimator, EstimatorSettings};
use autodiff::System;
use base::error::{Error, Result};
use dynamics::Frame;
use dynamics::Plant;
use dynamics::sensors::SensorConfig;
use dynamics::spatial::rotate_back;
use rng::{Purpose, Stream};
use std::collections::VecDeque;

/// An estimate of the state of one rigid vehicle.
///
/// Place, attitude and velocities are an [`Estimator`]'s. Nothing measures rotors: their speeds are the estimator's where it has them, else
/// those that the plant's motors come to under the commands that were applied.
#[derive(Debug, Clone)]
pub struct EstimatedState {
    filter: Estimator,
    plant: Plant,
    parameters: Vec<f64>,
    state: Vec<f64>,
    next: Vec<f64>,
    tally: EstimateTally,
    begins: bool,
    seed: u64,
    /// Those that the estimate is yet to be judged by.
    truths: VecDeque<Frame<f64>>,
}

/// How an estimate compared with the truth.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EstimateTally {
    /// Steps.
    pub n: u64,
    /// Of those, judged by the covariance.
    pub n_judged: u64,
    /// Sums of the squares of the errors: place (m²), velocity (m²/s²), attitude (rad²).
    pub squares: [f64; 3],
    /// Sum of the squared errors eᵀ P⁻¹ e over nine numbers (NEES): 9 a step on average where the filter is consistent; no number of one
    /// without a covariance.
    pub normalised: f64,
    /// Steps of which it was within the 95 % bounds of χ² with nine degrees of freedom, 2.70 to 19.02.
    pub within: u64,
}

/// Of what an estimate errs by where a flight begins.
const BEGINS: Purpose = Purpose::user(0xe571);

/// 2.5 and 97.5 % of χ² with nine degrees of freedom.
const WITHIN: [f64; 2] = [2.7004, 19.0228];

impl EstimateTally {
    /// Root mean square errors of place (m), velocity (m/s) and attitude (rad).
    pub fn rms(&self) -> [f64; 3] {
        self.squares.map(|s| (s / self.n as f64).sqrt())
    }

    /// Mean squared error by its covariance; 9 where the filter is consistent.
    pub fn mean(&self) -> f64 {
        self.normalised / self.n_judged as f64
    }

    /// Share of steps within the 95 % bounds.
    pub fn share_within(&self) -> f64 {
        self.within as f64 / self.n_judged as f64
    }
}

impl EstimatedState {
    /// For a plant that carries these sensors.
    ///
    /// # Errors
    /// [`Error::Value`] for a system of bodies, whose joints no sensor here tells; as [`Estimator::new`].
    pub fn new(plant: &Plant, sensors: &[SensorConfig], settings: &EstimatorSettings) -> Result<Self> {
        if plant.tree().is_some() {
            let what = format!("estimator of '{}'", plant.name());
            let remedy = "Fly it on the true state; or leave out --scene, which makes a vehicle one of several bodies.";
            return Err(Error::value(what, "a system of bodies", "one rigid vehicle", remedy));
        }
        let parameters = plant.parameters();
        let filter = Estimator::new(plant, sensors, settings)?;
        let n = plant.n_state();
        let own = if plant.n_parameter() > 0 { parameters } else { Vec::new() };
        Ok(Self {
            filter,
            plant: plant.clone(),
            parameters: own,
            state: vec![0.0; n],
            next: vec![0.0; n],
            tally: EstimateTally::default(),
            begins: true,
            seed: 0,
            truths: VecDeque::new(),
        })
    }

    /// The next step is the first, of a flight with this seed.
    pub fn reset(&mut self, seed: u64) {
        (self.begins, self.tally) = (true, EstimateTally::default());
        self.seed = seed;
        self.truths.clear();
    }

    /// Takes in what was read in this step, `truth` the state of the plant: it begins there, and is judged by it from then on.
    pub fn take(&mut self, truth: &[f64], readings: &[f64]) {
        let known = Frame::of_vehicle(truth);
        if std::mem::take(&mut self.begins) {
            self.filter.begin(truth, &mut Stream::new(self.seed, 0, 0, BEGINS));
            self.state.copy_from_slice(truth);
        }
        self.filter.step(readings);
        let own = self.filter.estimate();
        self.state[..3].copy_from_slice(&own.position);
        self.state[3..6].copy_from_slice(&own.velocity);
        self.state[6..10].copy_from_slice(&own.attitude);
        let rate = rotate_back(own.attitude, own.angular_velocity);
        self.state[10..13].copy_from_slice(&rate);
        if let Some(speeds) = self.filter.rotor_speeds() {
            self.state[13..].copy_from_slice(speeds);
        }
        let e = self.filter.error(&known);
        (0..9).for_each(|k| self.tally.squares[k / 3] += e[k] * e[k]);
        self.tally.n += 1;
        self.truths.push_back(known);
        if self.truths.len() <= self.filter.late() {
            return;
        }
        let Some(then) = self.truths.pop_front() else { return };
        let Some(squared) = self.filter.squared_error(&then).filter(|squared| squared.is_finite()) else { return };
        self.tally.n_judged += 1;
        self.tally.normalised += squared;
        self.tally.within += u64::from((WITHIN[0]..=WITHIN[1]).contains(&squared));
    }

    /// Goes on under the input that the plant was given.
    pub fn apply(&mut self, input: &[f64]) {
        self.filter.apply(input);
        if self.filter.rotor_speeds().is_some() {
            return;
        }
        self.plant.step(&self.state, input, &self.parameters, &mut self.next);
        self.state[13..].copy_from_slice(&self.next[13..]);
    }

    /// The state as it is estimated, in the plant's layout.
    pub fn state(&self) -> &[f64] {
        &self.state
    }

    /// The estimator.
    pub fn filter(&self) -> &Estimator {
        &self.filter
    }

    /// How it compared with the truth.
    pub fn tally(&self) -> &EstimateTally {
        &self.tally
    }
}
