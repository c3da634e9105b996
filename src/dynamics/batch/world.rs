//! N environments of one vehicle type, each with its own parameters, stepped in lanes over threads.

use super::kernel::{ALIVE, LISTED, Rows, STOPPED, StepBlocks, pack};
use crate::autodiff::lanes::dispatch;
use crate::autodiff::program::BLOCK;
use crate::dynamics::integrate::Grid;
use crate::dynamics::multirotor::{AnyModel, Multirotor, Physics};
use crate::dynamics::rigid::{Disturbance, Effects, RIGID_DIM, RigidModel};
use crate::dynamics::vehicle::Vehicle;
use crate::error::{Error, Result, finite};
use crate::parallel::Threads;

/// Most memory of one world unless [`World::with_memory_limit`] says otherwise, bytes.
pub const DEFAULT_MEMORY_LIMIT: u64 = 8 << 30;

/// Blocks per task: enough work to pay for handing it to a thread.
const BLOCKS_PER_TASK: usize = 8;

/// Why an environment stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// Its action was not a number.
    NonFiniteAction,
    /// Its state left |x| < 1e8 or became not a number.
    Diverged,
}

/// An environment that stopped, and why. It keeps its last healthy state until [`World::set_state`] revives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Failure {
    /// Its number.
    pub environment: usize,
    /// Count of [`World::step`] calls before the one that failed.
    pub step: u64,
    /// Why.
    pub reason: Reason,
}

/// N environments of one vehicle type in blocks of 64, one environment per SIMD lane.
///
/// The result of an environment depends on its own state, parameters and actions alone: it is bit-identical for any
/// number of threads, any batch size and any position in the batch, and between 8 and 16 lanes on processors with fused
/// multiply-add. Numbers are `f32`.
///
/// ```
/// use omnidrones::dynamics::{Physics, World, vehicles};
/// let vehicle = vehicles::by_name("hummingbird")?;
/// let mut world = World::new(&vehicle, Physics::default(), 1000)?;
/// let actions = vec![0.1; 1000 * 4]; // row-major [environment, rotor]
/// world.step(&actions)?;
/// let mut states = vec![0.0; 1000 * world.n_state()]; // row-major [environment, 17]
/// world.read_states(&mut states)?;
/// assert!(world.failures().is_empty());
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct World {
    n_env: usize,
    n_rotor: usize,
    padded: usize,
    physics: Physics,
    effects: Effects,
    grid: Grid,
    rows: Rows,
    blocks: Vec<Vec<[f32; BLOCK]>>,
    failures: Vec<Failure>,
    n_step: u64,
    threads: Threads,
}

impl World {
    /// `n_env` copies of a vehicle in level hover at the origin.
    ///
    /// # Errors
    /// [`Error::Limit`] before any large allocation if the batch needs more than [`DEFAULT_MEMORY_LIMIT`];
    /// [`Error::Value`] if the vehicle or the physics are not valid.
    pub fn new(vehicle: &Vehicle, physics: Physics, n_env: usize) -> Result<Self> {
        Self::with_memory_limit(vehicle, physics, n_env, DEFAULT_MEMORY_LIMIT)
    }

    /// As [`World::new`] with another limit on memory, in bytes.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn with_memory_limit(vehicle: &Vehicle, physics: Physics, n_env: usize, limit: u64) -> Result<Self> {
        let system = Multirotor::new(vehicle, physics)?;
        let padded = padded_rotors(vehicle.n_rotor());
        let rows = Rows::of(padded);
        let n_block = n_env.div_ceil(BLOCK);
        let needed = n_block as u128 * rows.count as u128 * size_of::<[f32; BLOCK]>() as u128;
        if n_env == 0 || needed > u128::from(limit) {
            let most = (u128::from(limit) / (rows.count * size_of::<[f32; BLOCK]>()) as u128) * BLOCK as u128;
            return Err(Error::limit(
                "n_env",
                format!("{n_env} ({:.1} GiB)", needed as f64 / f64::from(1 << 30)),
                format!("1 to {most} ({:.1} GiB)", limit as f64 / f64::from(1 << 30)),
                "Step fewer environments at once, or raise the limit with World::with_memory_limit.",
            ));
        }
        let hover = system.hover_state([0.0; 3])?;
        let mut block = vec![[0.0; BLOCK]; rows.count];
        write_column(&mut block, &hover, &packed(vehicle, &physics), rows);
        let world = Self {
            n_env,
            n_rotor: vehicle.n_rotor(),
            padded,
            physics,
            effects: AnyModel::new(vehicle, physics.grid().substep).effects_of(physics.effects),
            grid: physics.grid(),
            rows,
            blocks: vec![block; n_block],
            failures: Vec::with_capacity(n_env),
            n_step: 0,
            threads: Threads::default(),
        };
        Ok(world)
    }

    /// Steps on these threads from now on.
    pub fn set_threads(&mut self, threads: Threads) {
        self.threads = threads;
    }

    /// Number of environments.
    pub fn n_env(&self) -> usize {
        self.n_env
    }

    /// Numbers per state: 13 + rotors, ordered as in [`RigidState`](crate::dynamics::RigidState).
    pub fn n_state(&self) -> usize {
        RIGID_DIM + self.n_rotor
    }

    /// Rotors per vehicle: numbers per action.
    pub fn n_rotor(&self) -> usize {
        self.n_rotor
    }

    /// Time step, integrator and effects.
    pub fn physics(&self) -> &Physics {
        &self.physics
    }

    /// Environments that stopped since they were last set, in the order of stopping, by number within one step.
    pub fn failures(&self) -> &[Failure] {
        &self.failures
    }

    /// One step of every environment. `actions`: row-major `[n_env, n_rotor]`, each in [−1, 1] (clipped).
    ///
    /// An environment whose action is NaN or whose state diverges keeps its last healthy state, is listed in
    /// [`World::failures`], and stands still from then on; no other environment changes by a bit.
    ///
    /// # Errors
    /// [`Error::Value`] if `actions` has another length.
    pub fn step(&mut self, actions: &[f32]) -> Result<()> {
        self.check_length("actions", actions.len(), self.n_rotor)?;
        match self.padded {
            4 => self.step_padded::<4>(actions),
            6 => self.step_padded::<6>(actions),
            8 => self.step_padded::<8>(actions),
            _ => self.step_padded::<16>(actions),
        }
        self.collect_failures(actions);
        self.n_step += 1;
        Ok(())
    }

    fn step_padded<const R: usize>(&mut self, actions: &[f32]) {
        let (effects, grid, n, row) = (self.effects, self.grid, self.n_rotor, self.rows.action);
        let per_task = BLOCKS_PER_TASK * BLOCK * n;
        self.threads.for_each_chunk(&mut self.blocks, BLOCKS_PER_TASK, |task, blocks| {
            let actions = &actions[task * per_task..actions.len().min((task + 1) * per_task)];
            for (block, actions) in blocks.iter_mut().zip(actions.chunks(BLOCK * n)) {
                transpose_in(actions, n, &mut block[row..row + n]);
            }
            dispatch(StepBlocks::<R> { blocks, effects, grid });
        });
    }

    /// Lists the environments that ceased to be alive in this step.
    fn collect_failures(&mut self, actions: &[f32]) {
        let n = self.n_rotor;
        for (b, block) in self.blocks.iter_mut().enumerate() {
            let alive = &mut block[self.rows.alive];
            // no early exit: this form is vectorised
            if alive.iter().fold(true, |all, a| all & (*a == ALIVE)) {
                continue;
            }
            for (lane, alive) in alive.iter_mut().enumerate() {
                let environment = b * BLOCK + lane;
                if *alive != STOPPED || environment >= self.n_env {
                    continue;
                }
                *alive = LISTED;
                let row = &actions[environment * n..(environment + 1) * n];
                let non_finite = row.iter().any(|a| a.is_nan());
                let reason = if non_finite { Reason::NonFiniteAction } else { Reason::Diverged };
                self.failures.push(Failure { environment, step: self.n_step, reason });
            }
        }
    }

    /// Copies all states out, row-major `[n_env, n_state]`.
    ///
    /// # Errors
    /// [`Error::Value`] if `states` has another length.
    pub fn read_states(&self, states: &mut [f32]) -> Result<()> {
        let n = self.n_state();
        self.check_length("states", states.len(), n)?;
        for (block, rows) in self.blocks.iter().zip(states.chunks_mut(BLOCK * n)) {
            for (lane, row) in rows.chunks_mut(n).enumerate() {
                for (k, value) in row.iter_mut().enumerate() {
                    *value = block[k][lane];
                }
            }
        }
        Ok(())
    }

    /// The state of one environment.
    ///
    /// # Errors
    /// [`Error::Limit`] if there is no such environment.
    pub fn state(&self, environment: usize) -> Result<Vec<f32>> {
        let (block, lane) = self.place(environment)?;
        Ok((0..self.n_state()).map(|k| self.blocks[block][k][lane]).collect())
    }

    /// Sets the state of one environment and revives it if it had stopped.
    ///
    /// # Errors
    /// [`Error::Value`] for a wrong length or a number that is not finite; [`Error::Limit`] if there is no such
    /// environment.
    pub fn set_state(&mut self, environment: usize, state: &[f32]) -> Result<()> {
        let (block, lane) = self.place(environment)?;
        if state.len() != self.n_state() {
            return Err(wrong_length("state", state.len(), self.n_state()));
        }
        let wide: Vec<f64> = state.iter().map(|x| f64::from(*x)).collect();
        finite("state", &wide)?;
        for (row, value) in self.blocks[block].iter_mut().zip(state) {
            row[lane] = *value;
        }
        self.blocks[block][self.rows.alive][lane] = ALIVE;
        self.failures.retain(|f| f.environment != environment);
        Ok(())
    }

    /// Gives one environment a vehicle of its own: masses, inertias, rotor constants, drag.
    ///
    /// # Errors
    /// [`Error::Value`] if the vehicle is not valid, has another number of rotors or a geometry that the batch's compiled
    /// effects leave out; [`Error::Limit`] if there is no such environment.
    pub fn set_vehicle(&mut self, environment: usize, vehicle: &Vehicle) -> Result<()> {
        let (block, lane) = self.place(environment)?;
        vehicle.validate()?;
        if vehicle.n_rotor() != self.n_rotor {
            return Err(wrong_length("rotors of the vehicle", vehicle.n_rotor(), self.n_rotor));
        }
        let own = AnyModel::new(vehicle, self.grid.substep).effects_of(self.physics.effects);
        // switching them on now would change the rounding of every other environment where few effects are on
        for (effect, needed, have) in [
            ("tilted_rotors", own.tilted_rotors, self.effects.tilted_rotors),
            ("products_of_inertia", own.products_of_inertia, self.effects.products_of_inertia),
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
        for (row, value) in self.blocks[block][self.rows.model..].iter_mut().zip(packed(vehicle, &self.physics)) {
            row[lane] = value as f32;
        }
        Ok(())
    }

    /// Sets wind, force and moment on one environment from now on. Needs the effect `disturbance`.
    ///
    /// # Errors
    /// [`Error::Value`] if that effect is off or a number is not finite; [`Error::Limit`] if there is no such
    /// environment.
    pub fn set_disturbance(&mut self, environment: usize, air: &Disturbance<f32>) -> Result<()> {
        let (block, lane) = self.place(environment)?;
        if !self.effects.disturbance {
            return Err(Error::value(
                "effects.disturbance",
                "off",
                "on for wind and outside forces",
                "Build the world with Effects { disturbance: true, .. }.",
            ));
        }
        let numbers: Vec<f32> = air.wind.iter().chain(&air.force).chain(&air.moment).copied().collect();
        let wide: Vec<f64> = numbers.iter().map(|x| f64::from(*x)).collect();
        finite("disturbance", &wide)?;
        for (row, value) in self.blocks[block][self.rows.disturbance..].iter_mut().zip(numbers) {
            row[lane] = value;
        }
        Ok(())
    }

    fn place(&self, environment: usize) -> Result<(usize, usize)> {
        if environment >= self.n_env {
            let last = self.n_env - 1;
            return Err(Error::limit("environment", environment, last, "Environments count from 0."));
        }
        Ok((environment / BLOCK, environment % BLOCK))
    }

    fn check_length(&self, what: &str, got: usize, per_env: usize) -> Result<()> {
        if got == self.n_env * per_env { Ok(()) } else { Err(wrong_length(what, got, self.n_env * per_env)) }
    }
}

fn wrong_length(what: &str, got: usize, wanted: usize) -> Error {
    Error::value(format!("length of {what}"), got, wanted.to_string(), "Rows are [environment, number], row-major.")
}

fn padded_rotors(n: usize) -> usize {
    match n {
        0..=4 => 4,
        5..=6 => 6,
        7..=8 => 8,
        _ => 16,
    }
}

fn packed(vehicle: &Vehicle, physics: &Physics) -> Vec<f64> {
    let substep = physics.grid().substep;
    match padded_rotors(vehicle.n_rotor()) {
        4 => pack(&RigidModel::<f64, 4>::new(vehicle, substep)),
        6 => pack(&RigidModel::<f64, 6>::new(vehicle, substep)),
        8 => pack(&RigidModel::<f64, 8>::new(vehicle, substep)),
        _ => pack(&RigidModel::<f64, 16>::new(vehicle, substep)),
    }
}

/// The same state, parameters and life in every lane.
fn write_column(block: &mut [[f32; BLOCK]], state: &[f64], model: &[f64], rows: Rows) {
    for (row, value) in block.iter_mut().zip(state) {
        *row = [*value as f32; BLOCK];
    }
    block[rows.alive] = [ALIVE; BLOCK];
    for (row, value) in block[rows.model..].iter_mut().zip(model) {
        *row = [*value as f32; BLOCK];
    }
}

/// Rows of up to [`BLOCK`] environments into columns.
#[inline]
fn transpose_in(rows: &[f32], n: usize, columns: &mut [[f32; BLOCK]]) {
    for (lane, row) in rows.chunks_exact(n).enumerate() {
        for (column, value) in columns.iter_mut().zip(row) {
            column[lane] = *value;
        }
    }
}
