//! What a batch steps: single multirotors in closed form, or articulated systems.

use super::kernel::{self, ALIVE, pack};
use super::step_program::{Numbers, StepProgram, recorded};
use crate::autodiff::columns::Columns;
use crate::autodiff::lanes::{Lanes, RegisterKernel, each_register_of, first_lanes, to_columns};
use crate::autodiff::once::made_once;
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Recording, Trace};
use crate::dynamics;
use crate::dynamics::frame::Frame;
use crate::dynamics::integrate::Grid;
use crate::dynamics::multirotor::{AnyModel, Multirotor, Physics};
use crate::dynamics::plant::Quantity;
use crate::dynamics::rigid::{Disturbance, Effects, RIGID_DIM, RigidModel, parameter_vector};
use crate::dynamics::tree::frames;
use crate::dynamics::tree::parameters::Source;
use crate::dynamics::tree::scratch::scratch_on_stack;
use crate::dynamics::tree::step::{self, Task};
use crate::dynamics::tree::topology::Topology;
use crate::dynamics::tree::{Model, Multibody, model_parameters};
use crate::dynamics::vehicle::Vehicle;
use crate::error::{Error, Result};
use std::sync::{Arc, OnceLock};

/// Rows of numbers, one column per environment.
pub(crate) type Rows = Columns;

/// Up to sixty-four environments: state, input, `alive`, and numbers of the model where they have their own.
#[derive(Debug, Clone)]
pub(crate) struct Block {
    /// Environments in it: the lanes behind them are padding, and registers of padding alone are not computed.
    pub occupied: usize,
    pub rows: Rows,
    pub numbers: Option<Rows>,
}

/// A kind of system with its kernel and the layout of its blocks: state first, then what the kernel needs.
#[derive(Debug, Clone)]
pub(crate) enum Plant {
    Rigid(RigidPlant),
    Tree(Box<TreePlant>),
}

/// A single multirotor in closed form. Numbers are those of [`pack`].
#[derive(Debug, Clone)]
pub(crate) struct RigidPlant {
    n_rotor: usize,
    padded: usize,
    physics: Physics,
    effects: Effects,
    rows: kernel::Rows,
    radii: Vec<f64>,
    shared: Rows,
    words: Vec<Quantity>,
    steps: Steps,
}

/// An articulated system. Numbers are those of [`model_parameters`].
#[derive(Debug, Clone)]
pub(crate) struct TreePlant {
    topology: Topology,
    grid: Grid,
    general: bool,
    /// Actions in order → rows of the block.
    action_rows: Vec<usize>,
    disturbance_rows: Vec<usize>,
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

impl Plant {
    /// With the state of hover.
    pub(crate) fn rigid(vehicle: &Vehicle, physics: Physics) -> Result<(Self, Vec<f64>)> {
        let system = Multirotor::new(vehicle, physics)?;
        let padded = padded_rotors(vehicle.n_rotor());
        let mut plant = RigidPlant {
            n_rotor: vehicle.n_rotor(),
            padded,
            physics,
            effects: AnyModel::new(vehicle, physics.grid().substep).effects_of(physics.effects),
            rows: kernel::Rows::of(padded),
            radii: vehicle.rotors.iter().map(|r| r.radius).collect(),
            shared: Rows::default(),
            words: Vec::new(),
            steps: Steps::default(),
        };
        let mut shared = Vec::new();
        plant.pack(&parameter_vector(vehicle), |x| shared.push([x as f32; BLOCK]));
        plant.shared = shared.into_iter().collect();
        let hover = system.hover_state([0.0; 3])?;
        plant.words = dynamics::Plant::from(system).numbers_in_words();
        Ok((Self::Rigid(plant), hover))
    }

    /// With the state at rest.
    pub(crate) fn tree(model: &Model, physics: Physics, general: bool) -> Result<(Self, Vec<f64>)> {
        let system = Multibody::new(model, physics)?;
        let topology = Topology::new(model, physics.effects, physics.grid(), general);
        let disturbances: Vec<usize> = topology.layout.trees.iter().filter_map(|t| t.disturbance).collect();
        let is_action = |k: &usize| !disturbances.iter().any(|d| (*d..*d + Disturbance::<f64>::DIM).contains(k));
        let mut plant = TreePlant {
            grid: physics.grid(),
            general,
            action_rows: (0..topology.n_input).filter(is_action).map(|k| topology.n_state + k).collect(),
            disturbance_rows: disturbances.iter().map(|d| topology.n_state + d).collect(),
            shared: model_parameters(model).iter().map(|v| [*v as f32; BLOCK]).collect(),
            topology,
            words: Vec::new(),
            steps: Steps::default(),
        };
        let rest = system.rest_state();
        plant.words = dynamics::Plant::from(system).numbers_in_words();
        Ok((Self::Tree(Box::new(plant)), rest))
    }

    /// The numbers of a state and the actions behind them, in words.
    pub(crate) fn words(&self) -> &[Quantity] {
        match self {
            Self::Rigid(p) => &p.words,
            Self::Tree(p) => &p.words,
        }
    }

    /// Numbers of one state.
    pub(crate) fn n_state(&self) -> usize {
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

    /// Row that tells whether an environment is alive.
    pub(crate) fn alive_row(&self) -> usize {
        match self {
            Self::Rigid(p) => p.rows.alive,
            Self::Tree(p) => p.topology.n_state + p.topology.n_input,
        }
    }

    /// Rows of one block.
    pub(crate) fn n_row(&self) -> usize {
        match self {
            Self::Rigid(p) => p.rows.count,
            Self::Tree(_) => self.alive_row() + 1,
        }
    }

    /// Rows of the model's numbers, shared or a block's own.
    pub(crate) fn n_number(&self) -> usize {
        self.shared().len()
    }

    fn shared(&self) -> &Rows {
        match self {
            Self::Rigid(p) => &p.shared,
            Self::Tree(p) => &p.shared,
        }
    }

    /// Row of number k of the input: rotor actions, drives, disturbances as in the system's own.
    pub(crate) fn input_row(&self, k: usize) -> usize {
        match self {
            Self::Rigid(p) if k < p.n_rotor => p.rows.action + k,
            Self::Rigid(p) => p.rows.disturbance + k - p.n_rotor,
            Self::Tree(p) => p.topology.n_state + k,
        }
    }

    /// Gives one environment of a block numbers of its own, those of the system's vector at `which`. Allocates in a
    /// block's first call only.
    pub(crate) fn set_numbers(&self, block: &mut Block, lane: usize, numbers: &[f64], which: &[usize]) {
        let rows = self.own(block);
        match self {
            Self::Rigid(p) => {
                let mut rows = rows.iter_mut();
                p.pack(numbers, |x| {
                    if let Some(row) = rows.next() {
                        row[lane] = x as f32;
                    }
                });
            }
            Self::Tree(_) => which.iter().for_each(|k| rows[*k][lane] = numbers[*k] as f32),
        }
    }

    /// Writes the frames of all bodies of these environments of a block, [`FRAME`](crate::dynamics::frame::FRAME) rows
    /// each.
    pub(crate) fn frames(&self, block: &Block, lanes: u64, out: &mut [[f32; BLOCK]]) {
        each_register_of(lanes & first_lanes(block.occupied), WriteFrames { plant: self, block, out });
    }

    /// First row of the nine numbers of each tree's disturbance; none without that effect.
    pub(crate) fn disturbance_rows(&self) -> Vec<usize> {
        match self {
            Self::Rigid(p) if p.effects.disturbance => vec![p.rows.disturbance],
            Self::Rigid(_) => Vec::new(),
            Self::Tree(p) => p.disturbance_rows.clone(),
        }
    }

    /// A block of `occupied` environments, every column the same, alive, with the shared numbers.
    pub(crate) fn block(&self, state: &[f64], occupied: usize) -> Block {
        let mut rows = Rows::zeros(self.n_row());
        for (row, value) in rows.iter_mut().zip(state) {
            *row = [*value as f32; BLOCK];
        }
        rows[self.alive_row()] = [ALIVE; BLOCK];
        Block { occupied, rows, numbers: None }
    }

    /// Gives a block numbers of its own, the shared ones at first.
    pub(crate) fn give_parameters(&self, block: &mut Block) {
        self.own(block);
    }

    /// The block's own numbers, from now on.
    fn own<'a>(&self, block: &'a mut Block) -> &'a mut Rows {
        self.program(true);
        block.numbers.get_or_insert_with(|| self.shared().clone())
    }

    /// Row-major actions of up to [`BLOCK`] environments into their rows.
    #[inline]
    pub(crate) fn write_actions(&self, actions: &[f32], block: &mut [[f32; BLOCK]]) {
        match self {
            Self::Rigid(p) => to_columns(actions, &mut block[p.rows.action..p.rows.action + p.n_rotor]),
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
    pub(crate) fn step(&self, blocks: &mut [Block]) {
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

    /// A step with numbers of the block's `own` or with the shared ones.
    pub(super) fn recording(&self, own: bool) -> Recording {
        let numbers = if own { Numbers::Own(self.n_number()) } else { Numbers::Shared(self.shared()) };
        let n_input = self.n_input_row();
        let n_state = self.alive_row() - n_input;
        match self {
            Self::Rigid(p) => {
                let actions: Vec<usize> = (p.rows.action..p.rows.action + p.n_rotor).collect();
                recorded(n_state, n_input, numbers, &actions, |x, u, numbers| {
                    kernel::next_state(p.padded, p.effects, p.physics.grid(), (x, u, numbers))
                })
            }
            Self::Tree(p) => recorded(n_state, n_input, numbers, &p.action_rows, |x, u, numbers| {
                next_state_of_tree(&p.topology, p.grid, (x, u, numbers))
            }),
        }
    }

    /// Rows of one input.
    fn n_input_row(&self) -> usize {
        match self {
            Self::Rigid(p) => p.rows.alive - p.rows.action,
            Self::Tree(p) => p.topology.n_input,
        }
    }

    /// The numbers of one environment from a vehicle of its own.
    pub(crate) fn set_vehicle(&self, block: &mut Block, lane: usize, vehicle: &Vehicle) -> Result<()> {
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
    pub(crate) fn set_model(&self, block: &mut Block, lane: usize, model: &Model) -> Result<()> {
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
    /// The kernel's numbers of a vector of [`parameter_vector`], one by one; allocates nothing.
    fn pack(&self, parameters: &[f64], put: impl FnMut(f64)) {
        let (radii, substep) = (&self.radii, self.physics.grid().substep);
        match self.padded {
            4 => pack(&RigidModel::<f64, 4>::from_parameters(parameters, radii, substep), put),
            8 => pack(&RigidModel::<f64, 8>::from_parameters(parameters, radii, substep), put),
            _ => pack(&RigidModel::<f64, 16>::from_parameters(parameters, radii, substep), put),
        }
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

pub(crate) fn wrong_length(what: &str, got: usize, wanted: usize) -> Error {
    Error::value(format!("length of {what}"), got, wanted.to_string(), "Rows are [environment, number], row-major.")
}

fn padded_rotors(n: usize) -> usize {
    match n {
        0..=4 => 4,
        5..=8 => 8,
        _ => 16,
    }
}

/// Frames of a block, for the dispatcher.
struct WriteFrames<'a> {
    plant: &'a Plant,
    block: &'a Block,
    out: &'a mut [[f32; BLOCK]],
}

impl RegisterKernel for WriteFrames<'_> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let state = L::rows(&self.block.rows, at);
        match self.plant {
            Plant::Rigid(_) => Frame::of_vehicle(&state).write(&mut L::rows_mut(self.out, at).writer(0)),
            Plant::Tree(p) => {
                let numbers = match &self.block.numbers {
                    Some(own) => L::rows(own, at),
                    None => L::rows(&p.shared, 0),
                };
                frames::write(&p.topology, numbers, &state, &mut L::rows_mut(self.out, at));
            }
        }
    }
}
