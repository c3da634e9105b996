//! The cascade of one vehicle as a law: sample and ticks in, rotor actions out, gains as parameters.

use super::cascade::{CascadeModel, Latched, Rates, Schedule};
use super::law::{ControlLaw, Moment, Running};
use super::parameters::GainSet;
use crate::autodiff::Scalar;
use crate::dynamics::multirotor::MAX_PADDED;
use crate::dynamics::{Effects, Gains, Physics, Vehicle};
use crate::error::Result;

/// A cascade for one of the compiled rotor counts.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "one per simulation, and read on every step")]
enum AnyCascade {
    Four(CascadeModel<f64, 4>),
    Sixteen(CascadeModel<f64, 16>),
}

/// The full cascade of a multirotor.
///
/// - Target: a [`Setpoint`](super::Setpoint). Ticks: velocity and position, attitude, rate.
/// - Memory: [`Latched`], 23 + n numbers for n rotors.
/// - Parameters: the twelve of [`GainSet`].
#[derive(Debug, Clone)]
pub struct CascadeLaw {
    cascade: AnyCascade,
    gains: Gains,
    schedule: Schedule,
    n_rotor: usize,
}

impl CascadeLaw {
    /// For the vehicle it believes to fly, under `physics`, with `gains` at `rates`. It feeds forward the drag that is
    /// simulated: none where its effect is off.
    ///
    /// # Errors
    /// [`Error::Value`](crate::error::Error::Value) if vehicle or gains are not valid, or a rate does not divide 1/dt.
    pub fn new(believed: &Vehicle, physics: &Physics, gains: &Gains, rates: &Rates) -> Result<Self> {
        let vehicle = with_drag_of(believed, physics.effects);
        let cascade = match vehicle.n_rotor() {
            0..=4 => AnyCascade::Four(CascadeModel::new(&vehicle, gains)?),
            _ => AnyCascade::Sixteen(CascadeModel::new(&vehicle, gains)?),
        };
        let schedule = Schedule::new(rates, physics.dt)?;
        Ok(Self { cascade, gains: *gains, schedule, n_rotor: vehicle.n_rotor() })
    }

    /// As a controller, before its first tick.
    pub fn running(self) -> Running<Self> {
        Running::of(self)
    }

    #[inline(always)]
    fn tick_with<S: Scalar, const R: usize>(
        &self,
        nominal: &CascadeModel<f64, R>,
        now: &Moment<'_, S>,
        memory: &mut [S],
        commands: &mut [S],
    ) {
        let mut cascade = CascadeModel::<S, R>::constant(nominal);
        if !now.parameters.is_empty() {
            cascade.gains = GainSet::read(now.parameters);
        }
        let ticks = [now.ticks[0], now.ticks[1], now.ticks[2]];
        let held = cascade.position(&now.kinematics(), &read_latched::<S, R>(memory), &now.sample(), ticks);
        for i in 0..self.n_rotor {
            commands[i] = held.rotors[i];
        }
        write_latched(&held, memory);
    }
}

impl ControlLaw for CascadeLaw {
    fn name(&self) -> &str {
        "cascade"
    }

    fn description(&self) -> String {
        "position, velocity, attitude and rate levels, each at its own rate".into()
    }

    fn schedule(&self) -> Option<Schedule> {
        Some(self.schedule)
    }

    fn n_tick(&self) -> usize {
        3
    }

    fn write_ticks(&self, tick: u64, ticks: &mut [f64]) {
        ticks.copy_from_slice(&self.schedule.ticks(tick));
    }

    fn memory(&self) -> Vec<f64> {
        let mut memory = vec![0.0; Latched::<f64, 0>::DIM + self.n_rotor];
        match &self.cascade {
            AnyCascade::Four(c) => write_latched(&c.initial(), &mut memory),
            AnyCascade::Sixteen(c) => write_latched(&c.initial(), &mut memory),
        }
        memory
    }

    fn parameters(&self) -> Vec<f64> {
        let mut theta = vec![0.0; GainSet::<f64>::DIM];
        GainSet::constant(&self.gains).write(&mut theta);
        theta
    }

    fn parameter_names(&self) -> Vec<String> {
        GainSet::<f64>::names("")
    }

    fn tick<S: Scalar>(&self, now: &Moment<'_, S>, memory: &mut [S], commands: &mut [S]) {
        match &self.cascade {
            AnyCascade::Four(c) => self.tick_with(c, now, memory, commands),
            AnyCascade::Sixteen(c) => self.tick_with(c, now, memory, commands),
        }
    }
}

/// The vehicle with the drag that `effects` simulate.
pub(super) fn with_drag_of(vehicle: &Vehicle, effects: Effects) -> Vehicle {
    let mut vehicle = vehicle.clone();
    if !effects.body_drag {
        vehicle.drag.linear = [0.0; 3];
    }
    if !effects.rotor_drag {
        for rotor in &mut vehicle.rotors {
            (rotor.drag_coefficient, rotor.axial_drag_coefficient) = (0.0, 0.0);
        }
    }
    vehicle
}

/// Numbers of a memory padded to sixteen rotors.
const MAX_LATCHED: usize = Latched::<f64, MAX_PADDED>::DIM;

/// Writes a memory of R rotors without those that the vehicle does not have.
#[inline(always)]
pub(super) fn write_latched<S: Scalar, const R: usize>(held: &Latched<S, R>, out: &mut [S]) {
    let mut padded = [S::zero(); MAX_LATCHED];
    held.write(&mut padded[..Latched::<S, R>::DIM]);
    out.copy_from_slice(&padded[..out.len()]);
}

/// The inverse of [`write_held`]; missing rotors rest at −1.
#[inline(always)]
pub(super) fn read_latched<S: Scalar, const R: usize>(x: &[S]) -> Latched<S, R> {
    let mut padded = [-S::one(); MAX_LATCHED];
    padded[..x.len()].copy_from_slice(x);
    Latched::read(&padded[..Latched::<S, R>::DIM])
}
