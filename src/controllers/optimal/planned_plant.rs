//! A plant as optimal control plans with it: inputs that its speeds or forces are smooth in, a step as long as a stage.

use super::problem::length;
use crate::design::ErrorState;
use autodiff::{Scalar, System, safe};
use base::error::{Error, Result};
use dynamics::plant::RotorPlace;
use dynamics::rotor::LEAST_THRUST;
use dynamics::{Disturbance, Plant};
use serde::{Deserialize, Serialize};

/// Largest acceleration of a plant that hovers, m/s².
const MOST_FALL: f64 = 0.05;

/// By how much bounds of inputs are within those of commands.
const WITHIN: f64 = 1e-9;

/// What a planned input of a rotor is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlannedInput {
    /// Commanded speed as a share of the largest, 0.01 to 1; rotor speeds follow with their lag and are states. Actions are 2u² − 1: the
    /// motor is linear in u, and the slope of the command is finite everywhere.
    #[default]
    Speed,
    /// Thrust, N, 10⁻⁴ T_max to T_max, as if motors had no lag; rotor speeds are no states.
    Thrust,
}

/// A plant whose inputs are planned: a [`System`] of states x, inputs u of its rotors and drives, and, where the effect
/// `disturbance` is on, nine parameters: wind, force and moment on each tree.
///
/// States are those of the plant, but rotor speeds as shares of their largest, so that all numbers are of one size; with thrusts as
/// inputs there are none. Drives keep their commands in [−1, 1].
#[derive(Debug, Clone)]
pub struct PlannedPlant {
    plant: Plant,
    input: PlannedInput,
    /// Numbers of the plant's state that are states here.
    kept: Vec<usize>,
    /// The unit of each, 1 but for rotor speeds.
    units: Vec<f64>,
    /// Numbers of the plant's input that are inputs here.
    commands: Vec<usize>,
    /// The rotor that each of them steers.
    rotors: Vec<Option<RotorPlace>>,
    /// T_max of that rotor, N.
    max_thrust: Vec<f64>,
    disturbances: Vec<usize>,
}

impl PlannedPlant {
    /// Of a plant, whose dt is the length of a stage.
    ///
    /// # Errors
    /// [`Error::Value`] for a plant without inputs.
    pub fn new(plant: Plant, input: PlannedInput) -> Result<Self> {
        let (places, disturbances) = (plant.rotor_places(), plant.disturbances());
        let outside = |k: &usize| disturbances.iter().any(|first| (*first..first + 9).contains(k));
        let commands: Vec<usize> = (0..plant.n_input()).filter(|k| !outside(k)).collect();
        if commands.is_empty() {
            let what = format!("inputs of '{}'", plant.name());
            return Err(Error::value(what, 0, "≥ 1", "Plan for something that is steered."));
        }
        let is_kept = |k: &usize| input == PlannedInput::Speed || places.iter().all(|rotor| rotor.speed != *k);
        let of = |k: &usize| places.iter().position(|rotor| rotor.action == *k);
        let thrusts: Vec<f64> = plant.rotors().iter().map(|rotor| rotor.max_thrust()).collect();
        let kept: Vec<usize> = (0..plant.n_state()).filter(is_kept).collect();
        let unit = |k: &usize| places.iter().find(|rotor| rotor.speed == *k).map_or(1.0, |rotor| rotor.max_speed);
        Ok(Self {
            units: kept.iter().map(unit).collect(),
            kept,
            rotors: commands.iter().map(|k| of(k).map(|i| places[i])).collect(),
            max_thrust: commands.iter().map(|k| of(k).map_or(0.0, |i| thrusts[i])).collect(),
            commands,
            disturbances,
            plant,
            input,
        })
    }

    /// The plant.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// What the inputs of its rotors are.
    pub fn input(&self) -> PlannedInput {
        self.input
    }

    /// Coordinates of errors of its states.
    ///
    /// # Errors
    /// As [`ErrorState::of_plant`].
    pub fn errors(&self) -> Result<ErrorState> {
        let all = ErrorState::of_plant(&self.plant)?;
        let turns: Vec<usize> = (0..self.kept.len()).filter(|k| all.turns_at(self.kept[*k])).collect();
        ErrorState::new(self.kept.len(), &turns)
    }

    /// Whether an input steers a rotor, and not a drive.
    #[doc(hidden)]
    pub fn is_rotor(&self, input: usize) -> bool {
        self.rotors[input].is_some()
    }

    /// Numbers of the plant's state that are states here, ascending.
    pub fn kept(&self) -> &[usize] {
        &self.kept
    }

    /// Numbers of the plant's input that are inputs here, ascending.
    pub fn commands(&self) -> &[usize] {
        &self.commands
    }

    /// The states of a state of the plant.
    ///
    /// # Errors
    /// [`Error::Value`] for another length.
    pub fn state_of(&self, plant_state: &[f64]) -> Result<Vec<f64>> {
        length("state of the plant", plant_state.len(), self.plant.n_state())?;
        Ok(self.states_of(plant_state))
    }

    /// Writes them, `[n_state]`.
    pub(super) fn write_state(&self, plant_state: &[f64], state: &mut [f64]) {
        for ((own, k), unit) in state.iter_mut().zip(&self.kept).zip(&self.units) {
            *own = if *unit == 1.0 { plant_state[*k] } else { plant_state[*k] * (1.0 / unit) };
        }
    }

    /// Likewise over any scalar.
    pub(super) fn states_of<S: Scalar>(&self, plant_state: &[S]) -> Vec<S> {
        let of = |(k, unit): (&usize, &f64)| {
            if *unit == 1.0 { plant_state[*k] } else { plant_state[*k] * S::constant(1.0 / unit) }
        };
        self.kept.iter().zip(&self.units).map(of).collect()
    }

    /// Least and largest inputs: those of rotors as [`PlannedInput`] says, −1 and 1 of drives; 10⁻⁹ of them within, where commands are not
    /// clipped and have a slope.
    pub fn bounds(&self) -> (Vec<f64>, Vec<f64>) {
        let of_rotors = |i: usize, share: f64| match self.input {
            PlannedInput::Speed => share.sqrt(),
            PlannedInput::Thrust => share * self.max_thrust[i],
        };
        let all = |share: f64, drive: f64| {
            let own = self.rotors.iter().enumerate();
            own.map(|(i, rotor)| if rotor.is_some() { of_rotors(i, share) } else { drive }).collect()
        };
        (all(LEAST_THRUST * (1.0 + WITHIN), WITHIN - 1.0), all(1.0 - WITHIN, 1.0 - WITHIN))
    }

    /// The inputs that hold the speeds of rotors in a state of the plant, and drives at rest.
    pub fn holding(&self, plant_state: &[f64]) -> Vec<f64> {
        let (lower, upper) = self.bounds();
        let own = self.rotors.iter().enumerate().map(|(i, rotor)| {
            let Some(rotor) = rotor else { return 0.0 };
            let share = plant_state[rotor.speed] / rotor.max_speed;
            let own = match self.input {
                PlannedInput::Speed => share,
                PlannedInput::Thrust => share * share * self.max_thrust[i],
            };
            own.max(lower[i]).min(upper[i])
        });
        own.collect()
    }

    /// Hover, `[n_state]`, and the inputs that hold it.
    ///
    /// # Errors
    /// As [`Plant::hover_state`].
    pub fn hover(&self) -> Result<(Vec<f64>, Vec<f64>)> {
        let state = self.plant.hover_state()?;
        let (own, inputs) = (self.state_of(&state)?, self.holding(&state));
        self.check_held(&own, &inputs)?;
        Ok((own, inputs))
    }

    /// Refuses a hover from which the plant falls: its rotors do not carry it.
    fn check_held(&self, state: &[f64], inputs: &[f64]) -> Result<()> {
        let mut next = vec![0.0; self.n_state()];
        self.step(state, inputs, &vec![0.0; self.n_parameter()], &mut next);
        let fall = (state[5] - next[5]) / self.plant.physics().dt;
        // hover of rotors that carry the weight holds it to rounding
        if fall.abs() <= MOST_FALL {
            return Ok(());
        }
        let what = format!("acceleration of '{}' downwards in hover", self.plant.name());
        Err(Error::value(what, format!("{fall:.3} m/s²"), "0", "Take weight off, or stronger rotors."))
    }

    /// Actions and drive commands of inputs, at their places in the plant's input.
    pub fn write_commands<S: Scalar>(&self, inputs: &[S], commands: &mut [S]) {
        for (i, k) in self.commands.iter().enumerate() {
            commands[*k] = self.command(i, inputs[i]);
        }
    }

    /// The command of one input.
    fn command<S: Scalar>(&self, i: usize, input: S) -> S {
        let two = S::constant(2.0);
        match (self.rotors[i], self.input) {
            (None, _) => input,
            (Some(_), PlannedInput::Speed) => two * input * input - S::one(),
            (Some(_), PlannedInput::Thrust) => S::constant(2.0 / self.max_thrust[i]) * input - S::one(),
        }
    }

    /// The input of one command: where [`write_commands`](Self::write_commands) had it from.
    #[doc(hidden)]
    pub fn input_of(&self, i: usize, command: f64) -> f64 {
        let share = 0.5 * (command.clamp(-1.0, 1.0) + 1.0);
        match (self.rotors[i], self.input) {
            (None, _) => command,
            (Some(_), PlannedInput::Speed) => share.max(LEAST_THRUST).sqrt(),
            (Some(_), PlannedInput::Thrust) => share.max(LEAST_THRUST) * self.max_thrust[i],
        }
    }

    /// Names and units of the inputs.
    pub fn input_names(&self) -> Vec<(String, &'static str)> {
        let names = self.plant.input_quantities();
        let own = self.commands.iter().zip(&self.rotors).map(|(k, rotor)| {
            let (name, unit) = match (rotor, self.input) {
                (None, _) => return (names[*k].name.clone(), "-"),
                (Some(_), PlannedInput::Speed) => ("speed", "-"),
                (Some(_), PlannedInput::Thrust) => ("thrust", "N"),
            };
            (names[*k].name.replace("action", name), unit)
        });
        own.collect()
    }

    /// Names and units of the states; speeds of rotors are shares.
    pub fn state_names(&self) -> Vec<(String, &'static str)> {
        let names = self.plant.state_quantities();
        let own = self.kept.iter().zip(&self.units);
        own.map(|(k, unit)| (names[*k].name.clone(), if *unit == 1.0 { names[*k].unit } else { "-" })).collect()
    }

    /// Names and units of the numbers of an error, which gains multiply; those of a rotation vector stand where its quaternion did.
    ///
    /// # Errors
    /// As [`errors`](Self::errors).
    pub fn error_names(&self) -> Result<Vec<(String, &'static str)>> {
        let (names, errors) = (self.state_names(), self.errors()?);
        let mut all = Vec::with_capacity(errors.n_error());
        errors.each(|at, _, turns| {
            let (name, unit) = &names[at];
            if turns {
                let stem = name.trim_end_matches("_w");
                all.extend(["x", "y", "z"].map(|axis| (format!("{stem}_{axis}"), "rad")));
            } else {
                all.push((name.clone(), *unit));
            }
        });
        Ok(all)
    }

    /// The whole state of the plant with rotors at the speeds that inputs command, where they are no states.
    pub fn plant_state(&self, state: &[f64], inputs: &[f64]) -> Vec<f64> {
        self.whole(state, inputs)
    }

    /// Writes the states at their places in the plant's.
    pub(super) fn write_whole<S: Scalar>(&self, state: &[S], whole: &mut [S]) {
        for ((k, unit), x) in self.kept.iter().zip(&self.units).zip(state) {
            whole[*k] = if *unit == 1.0 { *x } else { *x * S::constant(*unit) };
        }
    }

    fn whole<S: Scalar>(&self, state: &[S], input: &[S]) -> Vec<S> {
        let mut whole = vec![S::zero(); self.plant.n_state()];
        self.write_whole(state, &mut whole);
        if self.input == PlannedInput::Thrust {
            for (i, rotor) in self.rotors.iter().enumerate() {
                if let Some(rotor) = rotor {
                    let share = input[i] * S::constant(1.0 / self.max_thrust[i]);
                    whole[rotor.speed] = S::constant(rotor.max_speed) * safe::sqrt(share, LEAST_THRUST);
                }
            }
        }
        whole
    }
}

impl System for PlannedPlant {
    fn n_state(&self) -> usize {
        self.kept.len()
    }
    fn n_input(&self) -> usize {
        self.commands.len()
    }
    fn n_parameter(&self) -> usize {
        self.disturbances.len() * Disturbance::<f64>::DIM
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        let mut commands = vec![S::zero(); self.plant.n_input()];
        for (i, k) in self.commands.iter().enumerate() {
            commands[*k] = self.command(i, input[i]);
        }
        for (first, air) in self.disturbances.iter().zip(parameters.chunks_exact(Disturbance::<f64>::DIM)) {
            commands[*first..*first + air.len()].copy_from_slice(air);
        }
        let theta: Vec<S> = match self.plant.n_parameter() {
            0 => Vec::new(),
            _ => self.plant.parameters().into_iter().map(S::constant).collect(),
        };
        let mut whole = vec![S::zero(); self.plant.n_state()];
        self.plant.step(&self.whole(state, input), &commands, &theta, &mut whole);
        for ((next, k), unit) in next.iter_mut().zip(&self.kept).zip(&self.units) {
            *next = if *unit == 1.0 { whole[*k] } else { whole[*k] * S::constant(1.0 / unit) };
        }
    }
}
