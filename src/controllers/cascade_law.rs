//! The cascade of one vehicle as a law: sample and ticks in, rotor actions out, gains as parameters.

use super::cascade::{CascadeMemory, CascadeModel, RateDivisors, Rates};
use super::filter::{FilterRow, FilterSettings};
use super::integral::IntegralState;
use super::law::{ControlLaw, LawController, LawInput};
use super::nominal_body::NominalBody;
use super::parameters::GainSet;
use autodiff::Scalar;
use base::error::Result;
use dynamics::vehicle::MAX_ROTORS;
use dynamics::{Effects, Gains, Physics, Vehicle};
use flight::Commanded;

/// The full cascade of a multirotor.
///
/// - Target: a [`Setpoint`](super::Setpoint). Ticks: velocity and position, attitude, rate.
/// - Memory: [`CascadeMemory`], 23 + n numbers for n rotors; with integral action ([`Gains::integral`]) 13 more; with k
///   [filters](Self::with_filters) 4 + 6 k more.
/// - Parameters: the twelve of [`GainSet`], and with integral action its two rates.
#[derive(Debug, Clone)]
pub struct CascadeLaw {
    cascade: Box<CascadeModel<f64, MAX_ROTORS>>,
    gains: Gains,
    schedule: RateDivisors,
    n_rotor: usize,
    /// With integral action: what it compares with, and how often, s.
    believed: Option<NominalBody>,
    period: f64,
    /// Of the measured angular velocity.
    filters: FilterRow,
}

impl CascadeLaw {
    /// For the vehicle it believes to fly, under `physics`, with `gains` at `rates`. It feeds forward the drag that is
    /// simulated: none where its effect is off.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) if vehicle or gains are not valid, or a rate does not divide 1/dt.
    pub fn new(believed: &Vehicle, physics: &Physics, gains: &Gains, rates: &Rates) -> Result<Self> {
        let vehicle = with_drag_of(believed, physics.effects);
        let cascade = Box::new(CascadeModel::new(&vehicle, gains)?);
        let schedule = RateDivisors::new(rates, physics.dt)?;
        let believed = if gains.is_integral() { Some(NominalBody::new(&vehicle.upright())?) } else { None };
        let period = schedule.every[2] as f64 * physics.dt;
        let filters = FilterRow::default();
        Ok(Self { cascade, gains: *gains, schedule, n_rotor: vehicle.n_rotor(), believed, period, filters })
    }

    /// With filters of the measured angular velocity, first to last, in place of those it had. They take a sample where the rate level
    /// computes; all levels are given what they say. The law measures rates and differentiates none, so that it needs no other.
    ///
    /// # Errors
    /// As [`FilterSettings::validate_all`] at the rate of the rate level.
    pub fn with_filters(mut self, filters: &[FilterSettings]) -> Result<Self> {
        self.filters = FilterRow::new(filters, self.period)?;
        Ok(self)
    }

    /// As a controller, before its first tick.
    pub fn running(self) -> LawController<Self> {
        LawController::of(self)
    }

    /// What it believes, and its levels.
    #[doc(hidden)]
    pub fn model(&self) -> &CascadeModel<f64, MAX_ROTORS> {
        &self.cascade
    }

    /// L of force and of moment, 1/s.
    #[inline]
    fn integral_rates<S: Scalar>(&self, parameters: &[S]) -> [S; 2] {
        match parameters[..] {
            [.., force, moment] => [force, moment],
            _ => self.gains.integral.map(S::constant),
        }
    }

    /// Numbers of memory without integral action.
    fn n_latched(&self) -> usize {
        CascadeMemory::<f64, 0>::DIM + self.n_rotor
    }
}

impl ControlLaw for CascadeLaw {
    fn name(&self) -> &str {
        "cascade"
    }

    fn description(&self) -> String {
        "position, velocity, attitude and rate levels, each at its own rate".into()
    }

    fn schedule(&self) -> Option<RateDivisors> {
        Some(self.schedule)
    }

    fn filters(&self) -> &[FilterSettings] {
        self.filters.settings()
    }

    fn n_tick(&self) -> usize {
        3
    }

    fn write_ticks(&self, tick: u64, ticks: &mut [f64]) {
        ticks.copy_from_slice(&self.schedule.ticks(tick));
    }

    fn memory(&self) -> Vec<f64> {
        let mut memory = vec![0.0; self.n_latched()];
        write_latched(&self.cascade.initial(), &mut memory);
        let learnt = if self.believed.is_some() { IntegralState::<f64>::DIM } else { 0 };
        memory.resize(memory.len() + learnt + self.filters.n_memory(), 0.0);
        memory
    }

    fn commanded(&self, memory: &[f64]) -> Option<Commanded> {
        let commanded = read_latched::<f64, MAX_ROTORS>(&memory[..self.n_latched()]).commanded();
        Some(self.cascade.axes.commanded(commanded))
    }

    fn parameters(&self) -> Vec<f64> {
        self.gains.flat()
    }

    fn parameter_names(&self) -> Vec<String> {
        let more: &[&str] =
            if self.believed.is_some() { &["gains.integral_force", "gains.integral_moment"] } else { &[] };
        GainSet::<f64>::names("").into_iter().chain(more.iter().map(|name| name.to_string())).collect()
    }

    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, memory: &mut [S], commands: &mut [S]) {
        let mut cascade = CascadeModel::<S, MAX_ROTORS>::constant(&self.cascade);
        if !now.parameters.is_empty() {
            cascade.gains = GainSet::read(now.parameters);
        }
        let ticks = [now.ticks[0], now.ticks[1], now.ticks[2]];
        let (mut state, sample) = (cascade.own(&now.kinematics()), now.sample());
        let (memory, passed) = memory.split_at_mut(memory.len() - self.filters.n_memory());
        if !self.filters.is_empty() {
            state.angular_velocity = self.filters.filtered(ticks[2], passed, state.angular_velocity);
        }
        let (latched, learnt) = memory.split_at_mut(self.n_latched());
        let held = read_latched(latched);
        let new = match &self.believed {
            None => cascade.position(&state, &held, &sample, ticks),
            Some(believed) => {
                let mut missing = IntegralState::read(learnt);
                missing.observe(ticks[2], &state, self.integral_rates(now.parameters), self.period);
                let attitude = cascade.attitude_without(&state, &held, &sample, missing.acceleration(), ticks);
                let new = cascade.rotors_without(&state, &held, &attitude, missing.angular_acceleration(), ticks);
                let rotors = believed.wrench_of_actions(&new.rotors[..self.n_rotor]);
                missing.expect(ticks[2], &state, believed, rotors, self.period);
                missing.write(learnt);
                new
            }
        };
        commands[..self.n_rotor].copy_from_slice(&new.rotors[..self.n_rotor]);
        write_latched(&new, latched);
    }
}

/// The vehicle with the drag that `effects` simulate.
pub(super) fn with_drag_of(vehicle: &Vehicle, effects: Effects) -> Vehicle {
    let mut vehicle = vehicle.clone();
    if !effects.body_drag {
        (vehicle.drag.linear, vehicle.drag.angular) = ([0.0; 3], [0.0; 3]);
    }
    if !effects.rotor_drag {
        for rotor in &mut vehicle.rotors {
            (rotor.drag_coefficient, rotor.axial_drag_coefficient) = (0.0, 0.0);
        }
    }
    vehicle
}

/// Numbers of a memory padded to sixteen rotors.
const MAX_LATCHED: usize = CascadeMemory::<f64, MAX_ROTORS>::DIM;

/// Writes a memory of R rotors without those that the vehicle does not have.
#[inline]
pub(super) fn write_latched<S: Scalar, const R: usize>(held: &CascadeMemory<S, R>, out: &mut [S]) {
    let mut padded = [S::zero(); MAX_LATCHED];
    held.write(&mut padded[..CascadeMemory::<S, R>::DIM]);
    out.copy_from_slice(&padded[..out.len()]);
}

/// The inverse of [`write_latched`]; missing rotors rest at −1.
#[inline]
pub(super) fn read_latched<S: Scalar, const R: usize>(x: &[S]) -> CascadeMemory<S, R> {
    let mut padded = [-S::one(); MAX_LATCHED];
    padded[..x.len()].copy_from_slice(x);
    CascadeMemory::read(&padded[..CascadeMemory::<S, R>::DIM])
}

#[cfg(test)]
mod tests;
