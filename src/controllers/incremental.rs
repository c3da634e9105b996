//! What controllers by increments share: filters of equal lag, and thrusts within bounds, tilt before heading.

use super::allocation::AllocationFunction;
use super::allocation::problem::{Problem, WRENCH};
use super::filter::DigitalFilter;
use autodiff::Scalar;
use base::error::Result;
use dynamics::rotor::thrust_action;
use dynamics::{MAX_ROTORS, Vehicle};

/// Of the filters of moment and angular velocity, Hz.
pub const CUTOFF: f64 = 12.0;
/// Priority of each row, as a factor of its balanced weight: sideways forces, thrust, roll and pitch, yaw.
const PRIORITIES: [f64; WRENCH] = [1e-4, 1e-4, 1.0, 100.0, 100.0, 0.025];

/// The filter of both, of samples every `period` seconds; at a quarter of the sampling rate where that is less.
pub(super) fn equal_filter(period: f64) -> DigitalFilter {
    DigitalFilter::low_pass(CUTOFF.min(0.25 / period), period)
}

/// Filters of ω and of a moment, and what they said last.
#[derive(Debug, Clone)]
pub(super) struct EqualFilters<S> {
    filters: [[S; 2]; 6],
    last: [S; 6],
}

impl<S: Scalar> EqualFilters<S> {
    /// Numbers in the flat form.
    pub(super) const DIM: usize = 18;

    pub(super) fn zeros() -> Self {
        Self { filters: [[S::zero(); 2]; 6], last: [S::zero(); 6] }
    }

    #[inline]
    pub(super) fn read(x: &[S]) -> Self {
        let mut own = Self::zeros();
        for k in 0..6 {
            (own.filters[k], own.last[k]) = ([x[2 * k], x[2 * k + 1]], x[12 + k]);
        }
        own
    }

    #[inline]
    pub(super) fn write(&self, x: &mut [S]) {
        for k in 0..6 {
            (x[2 * k], x[2 * k + 1], x[12 + k]) = (self.filters[k][0], self.filters[k][1], self.last[k]);
        }
    }

    /// Filtered signals half a period ago, and their slopes, per second. In the `first` tick they rest at `now`.
    pub(super) fn filtered(
        &mut self,
        first: S::Mask,
        filter: &DigitalFilter,
        now: [S; 6],
        period: f64,
    ) -> ([S; 6], [S; 6]) {
        let (mut mean, mut slope) = (now, now);
        for k in 0..6 {
            let rest = filter.rest(now[k]);
            for j in 0..2 {
                self.filters[k][j] = S::select(first, rest[j], self.filters[k][j]);
            }
            let last = S::select(first, now[k], self.last[k]);
            let next = filter.next(&mut self.filters[k], now[k]);
            mean[k] = S::constant(0.5) * (next + last);
            slope[k] = S::constant(1.0 / period) * (next - last);
            self.last[k] = next;
        }
        (mean, slope)
    }
}

/// Rotors whose thrusts are within bounds: argmin ‖W^½ (B T − w)‖² over 0 ≤ T ≤ T_max, roll and pitch before thrust before yaw.
#[derive(Clone)]
pub(super) struct BoundedRotors {
    /// k_f and T_max of every rotor.
    coefficient: Vec<f64>,
    max_thrust: Vec<f64>,
    /// What is left of every rotor, 0 to 1.
    left: Vec<f64>,
    problem: Problem,
    allocation: AllocationFunction,
}

impl BoundedRotors {
    /// Of a vehicle.
    ///
    /// # Errors
    /// As [`Problem::of_vehicle`].
    pub(super) fn new(vehicle: &Vehicle) -> Result<Self> {
        let problem = Problem::of_vehicle(vehicle)?.with_priorities(&PRIORITIES);
        Ok(Self {
            coefficient: vehicle.rotors.iter().map(|r| r.thrust_coefficient).collect(),
            max_thrust: vehicle.rotors.iter().map(|r| r.max_thrust()).collect(),
            left: vec![1.0; vehicle.rotors.len()],
            allocation: AllocationFunction::new(problem.clone())?,
            problem,
        })
    }

    /// Learns what is left of every rotor: a weak one turns slower at the same command.
    pub(super) fn tell(&mut self, left: &[f64]) {
        for (i, left) in left.iter().enumerate() {
            self.left[i] = left.clamp(0.0, 1.0);
            self.problem.upper[i] = self.left[i] * self.max_thrust[i];
        }
    }

    /// Steady thrust of a rotor under an action, N.
    pub(super) fn thrust_of(&self, rotor: usize, action: f64) -> f64 {
        0.5 * (action + 1.0) * self.left[rotor] * self.max_thrust[rotor]
    }

    /// Thrust of a rotor at a measured speed, N.
    #[inline]
    pub(super) fn thrust_at<S: Scalar>(&self, rotor: usize, speed: S) -> S {
        S::constant(self.coefficient[rotor]) * speed * speed
    }

    /// The actions that give a wrench, as far as bounds allow.
    pub(super) fn write_actions<S: Scalar>(&self, wrench: &[S; WRENCH], actions: &mut [S]) {
        let n = self.max_thrust.len();
        let mut thrusts = [S::zero(); MAX_ROTORS];
        self.allocation.call(&self.problem, wrench, &mut thrusts[..n]);
        for i in 0..n {
            let most = self.left[i].max(1e-6) * self.max_thrust[i];
            let share = thrusts[i] * S::constant(1.0 / most);
            actions[i] = thrust_action(share).clamp(-S::one(), S::one());
        }
    }
}
