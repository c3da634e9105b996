//! What a batch steps: single multirotors in closed form, or articulated systems.

use super::kernel::{self, ALIVE, pack};
use super::step_program::{StepProgram, contained};
use crate::frame::{FRAME, Frame};
use crate::integrate::Grid;
use crate::multirotor::{AnyModel, Multirotor, Physics};
use crate::plant::Quantity;
use crate::rigid::{Disturbance, Effects, RIGID_DIM, RigidModel, parameter_vector};
use crate::tree::frames;
use crate::tree::parameters::Source;
use crate::tree::scratch::scratch_on_stack;
use crate::tree::step::{self, Task};
use crate::tree::topology::Topology;
use crate::tree::{Model, Multibody, model_parameters};
use crate::vehicle::Vehicle;
use autodiff::columns::Columns;
use autodiff::lanes::to_columns;
use autodiff::once::made_once;
use autodiff::program::BLOCK;
use autodiff::{Recording, Scalar, Trace};
use base::error::{Error, Result};
use std::sync::{Arc, OnceLock};

/// Rows of numbers, one column per environment.
pub(crate) type Rows = Columns;

/// Up to sixty-four environments: state, input, `alive`, and numbers of the model where they have their own.
#[derive(Debug, Clone)]
pub struct PlantBlock {
    /// Environments in it: the lanes behind them are padding, and registers of padding alone are not computed.
    pub occupied: usize,
    pub rows: Rows,
    pub numbers: Option<Rows>,
}

/// A kind of system with its step and the layout of its blocks: state first, then input and `alive`.
#[derive(Debug, Clone)]
#[doc(hidden)]
pub enum BatchPlant {
    Rigid(RigidPlant),
    Tree(Box<TreePlant>),
}

/// A single multirotor in closed form. Numbers are those of [`pack`].
#[derive(Debug, Clone)]
pub struct RigidPlant {
    n_rotor: usize,
    physics: Physics,
    effects: Effects,
    radii: Vec<f64>,
    nominal: Vec<f64>,
    shared: Rows,
    words: Vec<Quantity>,
    steps: Steps,
}

/// An articulated system. Numbers are those of `model_parameters`.
#[derive(Debug, Clone)]
pub struct TreePlant {
    topology: Topology,
    grid: Grid,
    general: bool,
    /// Actions in order → rows of the block.
    action_rows: Vec<usize>,
    disturbance_rows: Vec<usize>,
    nominal: Vec<f64>,
    shared: Rows,
    words: Vec<Quantity>,
    steps: Steps,
}

/// Programs of a step, made when they are first asked for.
#[derive(Debug, Clone, Default)]
struct Steps {
    /// For blocks that share their numbers, which are constants.
    shared: OnceLock<Arc<StepProgram>>,
    /// For blocks with numbers of their own.
    own: OnceLock<Arc<StepProgram>>,
}

impl BatchPlant {
    /// With the state of hover.
    #[doc(hidden)]
    pub fn rigid(vehicle: &Vehicle, physics: Physics) -> Result<(Self, Vec<f64>)> {
        let system = Multirotor::new(vehicle, physics)?;
        let mut plant = RigidPlant {
            n_rotor: vehicle.n_rotor(),
            physics,
            effects: AnyModel::new(vehicle, physics.grid().substep).effects_of(physics.effects),
            radii: vehicle.rotors.iter().map(|r| r.radius).collect(),
            nominal: Vec::new(),
            shared: Rows::default(),
            words: Vec::new(),
            steps: Steps::default(),
        };
        let mut nominal = Vec::new();
        plant.pack(&parameter_vector(vehicle), |x| nominal.push(x));
        plant.shared = rows_of(&nominal);
        plant.nominal = nominal;
        let hover = system.hover_state([0.0; 3])?;
        plant.words = crate::Plant::from(system).numbers_in_words();
        Ok((Self::Rigid(plant), hover))
    }

    /// With the state at rest.
    #[doc(hidden)]
    pub fn tree(model: &Model, physics: Physics, general: bool) -> Result<(Self, Vec<f64>)> {
        let system = Multibody::new(model, physics)?;
        let topology = Topology::new(model, physics.effects, physics.grid(), general);
        let disturbances: Vec<usize> = topology.layout.trees.iter().filter_map(|t| t.disturbance).collect();
        let is_action = |k: &usize| !disturbances.iter().any(|d| (*d..*d + Disturbance::<f64>::DIM).contains(k));
        let mut plant = TreePlant {
            grid: physics.grid(),
            general,
            action_rows: (0..topology.n_input).filter(is_action).map(|k| topology.n_state + k).collect(),
            disturbance_rows: disturbances.iter().map(|d| topology.n_state + d).collect(),
            shared: rows_of(&model_parameters(model)),
            nominal: model_parameters(model),
            topology,
            words: Vec::new(),
            steps: Steps::default(),
        };
        let rest = system.rest_state();
        plant.words = crate::Plant::from(system).numbers_in_words();
        Ok((Self::Tree(Box::new(plant)), rest))
    }

    /// The numbers of a state and the actions behind them, in words.
    #[doc(hidden)]
    pub fn words(&self) -> &[Quantity] {
        match self {
            Self::Rigid(p) => &p.words,
            Self::Tree(p) => &p.words,
        }
    }

    /// Numbers of one state.
    #[doc(hidden)]
    pub fn n_state(&self) -> usize {
        match self {
            Self::Rigid(p) => RIGID_DIM + p.n_rotor,
            Self::Tree(p) => p.topology.n_state,
        }
    }

    /// Numbers of one action.
    pub(crate) fn n_action(&self) -> usize {
        match self {
            Self::Rigid(p) => p.n_rotor,
            Self::Tree(p) => p.action_rows.len(),
        }
    }

    /// Numbers of one input: actions, then disturbances where they have an effect.
    #[doc(hidden)]
    pub fn n_input(&self) -> usize {
        match self {
            Self::Rigid(p) if p.effects.disturbance => p.n_rotor + Disturbance::<f64>::DIM,
            Self::Rigid(p) => p.n_rotor,
            Self::Tree(p) => p.topology.n_input,
        }
    }

    /// Row that tells whether an environment is alive.
    #[doc(hidden)]
    pub fn alive_row(&self) -> usize {
        self.n_state() + self.n_input()
    }

    /// Rows of one block.
    #[doc(hidden)]
    pub fn n_row(&self) -> usize {
        self.alive_row() + 1
    }

    /// Rows of the model's numbers, shared or a block's own.
    #[doc(hidden)]
    pub fn n_number(&self) -> usize {
        self.shared().len()
    }

    fn shared(&self) -> &Rows {
        match self {
            Self::Rigid(p) => &p.shared,
            Self::Tree(p) => &p.shared,
        }
    }

    /// Row of number k of the input: rotor actions, drives, disturbances as in the system's own.
    #[doc(hidden)]
    pub fn input_row(&self, k: usize) -> usize {
        self.n_state() + k
    }

    /// First row of the nine numbers of each tree's disturbance; none without that effect.
    pub(crate) fn disturbance_rows(&self) -> Vec<usize> {
        match self {
            Self::Rigid(p) if p.effects.disturbance => vec![RIGID_DIM + 2 * p.n_rotor],
            Self::Rigid(_) => Vec::new(),
            Self::Tree(p) => p.disturbance_rows.clone(),
        }
    }

    /// A block of `occupied` environments, every column the same, alive, with the shared numbers.
    #[doc(hidden)]
    pub fn block(&self, state: &[f64], occupied: usize) -> PlantBlock {
        let mut rows = Rows::zeros(self.n_row());
        for (row, value) in rows.iter_mut().zip(state) {
            *row = [*value as f32; BLOCK];
        }
        rows[self.alive_row()] = [ALIVE; BLOCK];
        PlantBlock { occupied, rows, numbers: None }
    }

    /// Gives a block numbers of its own, the shared ones at first.
    #[doc(hidden)]
    pub fn give_parameters(&self, block: &mut PlantBlock) {
        self.own(block);
    }

    /// The block's own numbers, from now on.
    fn own<'a>(&self, block: &'a mut PlantBlock) -> &'a mut Rows {
        self.program(true);
        block.numbers.get_or_insert_with(|| self.shared().clone())
    }

    /// Row-major actions of up to [`BLOCK`] environments into their rows.
    #[inline]
    pub(crate) fn write_actions(&self, actions: &[f32], block: &mut [[f32; BLOCK]]) {
        match self {
            Self::Rigid(p) => to_columns(actions, &mut block[RIGID_DIM + p.n_rotor..][..p.n_rotor]),
            Self::Tree(p) => {
                for (lane, row) in actions.chunks_exact(p.action_rows.len()).enumerate() {
                    for (at, value) in p.action_rows.iter().zip(row) {
                        block[*at][lane] = *value;
                    }
                }
            }
        }
    }

    /// One step of every block. Whose numbers are shared and whose are a block's own makes no difference to a bit but the sign of a
    /// zero, while numbers are finite: a shared zero is left out of products and sums.
    pub(crate) fn step(&self, blocks: &mut [PlantBlock]) {
        for own in [false, true] {
            let mut alike = blocks.iter_mut().filter(|block| block.numbers.is_some() == own).peekable();
            if alike.peek().is_some() {
                self.program(own).run(alike);
            }
        }
    }

    /// The program for blocks with numbers of their `own` or shared ones. Made when it is first asked for.
    pub(crate) fn program(&self, own: bool) -> &StepProgram {
        let steps = match self {
            Self::Rigid(p) => &p.steps,
            Self::Tree(p) => &p.steps,
        };
        let cell = if own { &steps.own } else { &steps.shared };
        let program: &Arc<StepProgram> = made_once(cell, || {
            let made = StepProgram::of(&self.recording(own), self.n_row());
            Arc::new(made.expect("a step is no larger than a program may be"))
        });
        program
    }

    /// A step with numbers of the block's `own` or with the shared ones: a recording of rows, of which the last results are the state
    /// and `alive`. Its bits are those of a kernel compiled for lanes.
    pub(super) fn recording(&self, own: bool) -> Recording {
        let (n_state, alive_row, n_row) = (self.n_state(), self.alive_row(), self.n_row());
        Recording::of_lanes(n_row + if own { self.n_number() } else { 0 }, |z| {
            let numbers = if own { z[n_row..].to_vec() } else { self.constant_numbers() };
            let (state, input) = (&z[..n_state], &z[n_state..alive_row]);
            self.contained_step(state, input, z[alive_row], &numbers)
        })
    }

    /// The model's numbers as constants of a recording.
    #[doc(hidden)]
    pub fn constant_numbers(&self) -> Vec<Trace> {
        let nominal = match self {
            Self::Rigid(p) => &p.nominal,
            Self::Tree(p) => &p.nominal,
        };
        nominal.iter().map(|x| Trace::constant(*x)).collect()
    }

    /// The model's numbers of those of the system's vector, recorded.
    #[doc(hidden)]
    pub fn numbers_of(&self, parameters: &[Trace]) -> Vec<Trace> {
        match self {
            Self::Rigid(p) => {
                let mut numbers = Vec::new();
                p.pack(parameters, |x| numbers.push(x));
                numbers
            }
            Self::Tree(_) => parameters.to_vec(),
        }
    }

    /// Which of the model's numbers change with these of the system's vector.
    #[doc(hidden)]
    pub fn varying(&self, nominal: &[f64], varied: &[usize]) -> Vec<usize> {
        let mut varying = Vec::new();
        Recording::of(varied.len(), |z| {
            let mut parameters: Vec<Trace> = nominal.iter().map(|x| Trace::constant(*x)).collect();
            varied.iter().zip(z).for_each(|(k, own)| parameters[*k] = *own);
            let numbers = self.numbers_of(&parameters);
            varying.extend((0..numbers.len()).filter(|k| numbers[*k].known().is_none()));
            Vec::new()
        });
        varying
    }

    /// The next state of state, input and the model's numbers.
    #[doc(hidden)]
    pub fn next_state(&self, state: &[Trace], input: &[Trace], numbers: &[Trace]) -> Vec<Trace> {
        match self {
            Self::Rigid(p) => kernel::next_state(p.n_rotor, p.effects, p.physics.grid(), (state, input, numbers)),
            Self::Tree(p) => next_state_of_tree(&p.topology, p.grid, (state, input, numbers)),
        }
    }

    /// As [`BatchPlant::next_state`], and `alive` behind it, where what explodes stops: see [`contained`].
    #[doc(hidden)]
    pub fn contained_step(&self, state: &[Trace], input: &[Trace], alive: Trace, numbers: &[Trace]) -> Vec<Trace> {
        let n_state = state.len();
        let actions: Vec<Trace> = match self {
            Self::Rigid(p) => input[..p.n_rotor].to_vec(),
            Self::Tree(p) => p.action_rows.iter().map(|row| input[row - n_state]).collect(),
        };
        contained(state, &actions, alive, self.next_state(state, input, numbers))
    }

    /// Motion of every body, [`FRAME`](crate::frame::FRAME) numbers each.
    #[doc(hidden)]
    pub fn frames_of(&self, state: &[Trace], numbers: &[Trace]) -> Vec<Trace> {
        let n_body = match self {
            Self::Rigid(_) => 1,
            Self::Tree(p) => p.topology.n_body(),
        };
        let mut frames = vec![Trace::zero(); n_body * FRAME];
        match self {
            Self::Rigid(_) => Frame::of_vehicle(state).write(&mut frames),
            Self::Tree(p) => frames::write(&p.topology, Source::Values(numbers), state, &mut frames),
        }
        frames
    }

    /// The numbers of one environment from a vehicle of its own.
    pub(crate) fn set_vehicle(&self, block: &mut PlantBlock, lane: usize, vehicle: &Vehicle) -> Result<()> {
        let Self::Rigid(p) = self else {
            return Err(Error::value(
                "the batch",
                "of articulated systems",
                "one of single multirotors without contact",
                "Give the environment a model with World::set_model.",
            ));
        };
        vehicle.validate()?;
        if vehicle.n_rotor() != p.n_rotor {
            return Err(wrong_length("rotors of the vehicle", vehicle.n_rotor(), p.n_rotor));
        }
        let own = AnyModel::new(vehicle, p.physics.grid().substep).effects_of(p.physics.effects);
        // switching them on now would change the rounding of every other environment where few effects are on
        for (effect, needed, have) in [
            ("tilted_rotors", own.tilted_rotors, p.effects.tilted_rotors),
            ("products_of_inertia", own.products_of_inertia, p.effects.products_of_inertia),
        ] {
            if needed && !have {
                return Err(Error::value(
                    format!("effects.{effect} of the batch"),
                    "off",
                    format!("on for the geometry of vehicle '{}'", vehicle.name),
                    format!("Build the world with Effects {{ {effect}: true, .. }}."),
                ));
            }
        }
        let mut rows = self.own(block).iter_mut();
        p.pack(&parameter_vector(vehicle), |x| {
            if let Some(row) = rows.next() {
                row[lane] = x as f32;
            }
        });
        Ok(())
    }

    /// The numbers of one environment from a model of its own, with the same topology.
    pub(crate) fn set_model(&self, block: &mut PlantBlock, lane: usize, model: &Model) -> Result<()> {
        let Self::Tree(p) = self else {
            return Err(Error::value(
                "the batch",
                "of single multirotors",
                "one of articulated systems",
                "Give the environment a vehicle with World::set_vehicle, or build the world with World::of_model.",
            ));
        };
        if let Some(difference) = p.topology.difference(model, p.general) {
            return Err(Error::value(
                format!("model '{}'", model.name()),
                difference,
                "as in the model of the batch",
                "Vary numbers alone, or build the world with World::of_varied_model.",
            ));
        }
        for (row, value) in self.own(block).iter_mut().zip(model_parameters(model)) {
            row[lane] = value as f32;
        }
        Ok(())
    }
}

impl RigidPlant {
    /// The model's numbers of a vector of `parameter_vector`, one by one; allocates nothing.
    fn pack<S: Scalar>(&self, parameters: &[S], put: impl FnMut(S)) {
        pack(&RigidModel::from_parameters(parameters, &self.radii, self.physics.grid().substep), put);
    }
}

/// The next state of an articulated system, of state, input and numbers as rows have them.
fn next_state_of_tree(t: &Topology, grid: Grid, (state, input, numbers): (&[Trace], &[Trace], &[Trace])) -> Vec<Trace> {
    scratch_on_stack!(scratch, t, Trace);
    scratch.end[..t.n_state].copy_from_slice(state);
    scratch.input[..t.n_input].copy_from_slice(input);
    step::run(t, Source::Values(numbers), Task::Step(grid), &mut scratch);
    scratch.end[..t.n_state].to_vec()
}

/// Rows of equal numbers.
fn rows_of(numbers: &[f64]) -> Rows {
    numbers.iter().map(|x| [*x as f32; BLOCK]).collect()
}

pub(crate) fn wrong_length(what: &str, got: usize, wanted: usize) -> Error {
    Error::value(format!("length of {what}"), got, wanted.to_string(), "Rows are [environment, number], row-major.")
}
