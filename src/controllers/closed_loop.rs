//! A vehicle under its cascade as one [`System`]: the reference goes in, the gains are the parameters.

use super::cascade::{CascadeModel, Held, Rates, Schedule};
use super::kinematics::Kinematics;
use super::parameters::GainSet;
use super::reference::Sample;
use crate::autodiff::{Scalar, System};
use crate::dynamics::multirotor::MAX_PADDED;
use crate::dynamics::rigid::RIGID_DIM;
use crate::dynamics::{Disturbance, Effects, Gains, Multirotor, Physics, Vehicle};
use crate::error::Result;

/// A cascade for one of the compiled rotor counts.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "one per simulation, and read on every step")]
enum AnyCascade {
    Four(CascadeModel<f64, 4>),
    Sixteen(CascadeModel<f64, 16>),
}

/// A multirotor that tracks a reference with the full cascade.
///
/// - State: the vehicle's 13 + n numbers ([`RigidState`](crate::dynamics::RigidState)), then the cascade's memory
///   ([`Held`], 23 + n numbers).
/// - Input: a [`Sample`] (18), three ticks (1 where velocity and position, attitude, rate compute, else 0), then a
///   [`Disturbance`] (9) if that effect is on. [`ClosedLoop::write_input`] fills it.
/// - Parameters: none, or with [`ClosedLoop::with_gains`] the twelve of [`GainSet`].
#[derive(Debug, Clone)]
pub struct ClosedLoop {
    plant: Multirotor,
    cascade: AnyCascade,
    gains: Gains,
    schedule: Schedule,
    exposes_gains: bool,
}

impl ClosedLoop {
    /// A vehicle under `physics`, steered with `gains` at `rates`. The cascade feeds forward the drag that is simulated:
    /// none where its effect is off.
    ///
    /// # Errors
    /// [`Error::Value`](crate::error::Error::Value) if vehicle, physics or gains are not valid, or a rate does not
    /// divide 1/dt.
    pub fn new(vehicle: &Vehicle, physics: Physics, gains: &Gains, rates: &Rates) -> Result<Self> {
        let believed = with_drag_of(vehicle, physics.effects);
        let cascade = match vehicle.n_rotor() {
            0..=4 => AnyCascade::Four(CascadeModel::new(&believed, gains)?),
            _ => AnyCascade::Sixteen(CascadeModel::new(&believed, gains)?),
        };
        Ok(Self {
            plant: Multirotor::new(vehicle, physics)?,
            cascade,
            gains: *gains,
            schedule: Schedule::new(rates, physics.dt)?,
            exposes_gains: false,
        })
    }

    /// The same loop with its gains as θ; pass [`ClosedLoop::gains`] in flat form to `step`.
    pub fn with_gains(mut self) -> Self {
        self.exposes_gains = true;
        self
    }

    /// The vehicle and its physics.
    pub fn plant(&self) -> &Multirotor {
        &self.plant
    }

    /// The gains it was built with.
    pub fn gains(&self) -> &Gains {
        &self.gains
    }

    /// The gains as a parameter vector: K_p, K_v, K_R, K_ω.
    pub fn gain_vector(&self) -> Vec<f64> {
        let mut theta = vec![0.0; GainSet::<f64>::DIM];
        GainSet::constant(&self.gains).write(&mut theta);
        theta
    }

    /// Length of the vehicle's part of the state.
    pub fn n_plant_state(&self) -> usize {
        self.plant.n_state()
    }

    /// The whole state for a vehicle state, with the memory of level hover.
    pub fn initial_state(&self, vehicle_state: &[f64]) -> Vec<f64> {
        let mut x = vec![0.0; self.n_state()];
        let (plant, held) = x.split_at_mut(self.plant.n_state());
        plant.copy_from_slice(vehicle_state);
        match &self.cascade {
            AnyCascade::Four(c) => write_held(&c.initial(), held),
            AnyCascade::Sixteen(c) => write_held(&c.initial(), held),
        }
        x
    }

    /// The input of step `k`: the reference now, which levels compute, and the air. `air` is left out where the effect
    /// `disturbance` is off.
    pub fn write_input(&self, k: u64, sample: &Sample<f64>, air: &Disturbance<f64>, input: &mut [f64]) {
        sample.write(&mut input[..Sample::<f64>::DIM]);
        let at = Sample::<f64>::DIM;
        input[at..at + 3].copy_from_slice(&self.schedule.ticks(k));
        air.write(&mut input[at + 3..]);
    }

    /// Whether every level computes in step `k`.
    pub fn computes_all(&self, k: u64) -> bool {
        self.schedule.ticks(k) == [1.0; 3]
    }

    /// Rotor actions that the cascade holds in a state.
    pub fn rotor_actions<'a>(&self, state: &'a [f64]) -> &'a [f64] {
        let at = self.plant.n_state() + Held::<f64, 0>::DIM;
        &state[at..at + self.plant.vehicle().n_rotor()]
    }

    #[inline(always)]
    fn step_with<S: Scalar, const R: usize>(
        &self,
        nominal: &CascadeModel<f64, R>,
        state: &[S],
        input: &[S],
        parameters: &[S],
        next: &mut [S],
    ) {
        let mut cascade = CascadeModel::<S, R>::constant(nominal);
        if self.exposes_gains {
            cascade.gains = GainSet::read(parameters);
        }
        let n_plant = self.plant.n_state();
        let (plant, held) = state.split_at(n_plant);
        let (sample, rest) = input.split_at(Sample::<S>::DIM);
        let ticks = [rest[0], rest[1], rest[2]];
        let seen = Kinematics::read(plant);
        let held = cascade.position(&seen, &read_held::<S, R>(held), &Sample::read(sample), ticks);

        let n = self.plant.vehicle().n_rotor();
        let mut plant_input = [S::zero(); MAX_PADDED + Disturbance::<f64>::DIM];
        for i in 0..n {
            plant_input[i] = held.rotors[i];
        }
        let n_input = self.plant.n_input();
        for i in n..n_input {
            plant_input[i] = rest[3 + i - n];
        }
        let (next_plant, next_held) = next.split_at_mut(n_plant);
        self.plant.step(plant, &plant_input[..n_input], &[], next_plant);
        write_held(&held, next_held);
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
const MAX_HELD: usize = Held::<f64, MAX_PADDED>::DIM;

/// Writes a memory of R rotors without those that the vehicle does not have.
#[inline(always)]
fn write_held<S: Scalar, const R: usize>(held: &Held<S, R>, out: &mut [S]) {
    let mut padded = [S::zero(); MAX_HELD];
    held.write(&mut padded[..Held::<S, R>::DIM]);
    out.copy_from_slice(&padded[..out.len()]);
}

/// The inverse of [`write_held`]; missing rotors rest at −1.
#[inline(always)]
fn read_held<S: Scalar, const R: usize>(x: &[S]) -> Held<S, R> {
    let mut padded = [-S::one(); MAX_HELD];
    padded[..x.len()].copy_from_slice(x);
    Held::read(&padded[..Held::<S, R>::DIM])
}

impl System for ClosedLoop {
    fn n_state(&self) -> usize {
        self.plant.n_state() + Held::<f64, 0>::DIM + self.plant.vehicle().n_rotor()
    }
    fn n_input(&self) -> usize {
        Sample::<f64>::DIM + 3 + self.plant.n_input() - (self.plant.n_state() - RIGID_DIM)
    }
    fn n_parameter(&self) -> usize {
        if self.exposes_gains { GainSet::<f64>::DIM } else { 0 }
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        match &self.cascade {
            AnyCascade::Four(c) => self.step_with(c, state, input, parameters, next),
            AnyCascade::Sixteen(c) => self.step_with(c, state, input, parameters, next),
        }
    }
}
