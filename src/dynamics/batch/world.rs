//! N environments of one vehicle or articulated system, each with its own parameters, stepped in lanes over threads.

use super::breach::{Breach, RawBreach};
use super::kernel::{ALIVE, REPORTED, STOPPED};
use super::plant::{BatchPlant, PlantBlock, Rows, wrong_length};
use crate::assembly::single;
use crate::multirotor::{Multirotor, Physics};
use crate::rigid::{Disturbance, Effects};
use crate::tree::Model;
use crate::vehicle::Vehicle;
use autodiff::program::BLOCK;
use base::error::{Error, Result, finite};
use base::memory::{Request, none_asked};
use base::parallel::Threads;

/// Most memory of one world unless [`World::with_memory_limit`] says otherwise, bytes.
pub const DEFAULT_MEMORY_LIMIT: u64 = 8 << 30;

/// Blocks per task: enough work to pay for handing it to a thread.
const BLOCKS_PER_TASK: usize = 8;

/// Why an environment stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// Its action was not a number.
    NonFiniteAction,
    /// Its state left |x| < 1e8 or became not a number.
    Diverged,
}

/// An environment that stopped, and why. It keeps its last healthy state until [`World::set_state`] revives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stopped {
    /// Its number.
    pub environment: usize,
    /// Count of [`World::step`] calls before the one that failed.
    pub step: u64,
    /// Why.
    pub reason: StopReason,
}

/// N environments of one vehicle or one articulated [`Model`] in blocks of 64, one environment per SIMD lane.
///
/// The result of an environment depends on its own state, parameters and actions alone: it is bit-identical for any
/// number of threads, any batch size and any position in the batch, and between 8 and 16 lanes on processors with fused
/// multiply-add. Numbers are `f32`.
///
/// ```
/// # use omnidrones_dynamics::omnidrones;
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
    physics: Physics,
    plant: BatchPlant,
    blocks: Vec<PlantBlock>,
    failures: Vec<Stopped>,
    /// Likewise, what broke; and where a step leads that stops an environment.
    culprits: Vec<Option<RawBreach>>,
    after: Rows,
    n_step: u64,
    threads: Threads,
}

impl World {
    /// `n_env` copies of a vehicle in hover at the origin. With the effect `contact` it is stepped as an articulated
    /// system of one body.
    ///
    /// # Errors
    /// [`Error::Limit`] for no environment, and before any large allocation if the batch needs more than 8 GiB
    /// (`DEFAULT_MEMORY_LIMIT`); [`Error::Value`] if the vehicle or the physics are not valid.
    pub fn new(vehicle: &Vehicle, physics: Physics, n_env: usize) -> Result<Self> {
        Self::with_memory_limit(vehicle, physics, n_env, DEFAULT_MEMORY_LIMIT)
    }

    /// As [`World::new`] with another limit on memory, in bytes.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn with_memory_limit(vehicle: &Vehicle, physics: Physics, n_env: usize, limit: u64) -> Result<Self> {
        let (plant, hover) = if physics.effects.contact {
            let (plant, _) = BatchPlant::tree(&single(vehicle)?, physics, true)?;
            let above = Effects { contact: false, ..physics.effects };
            let hover = Multirotor::new(vehicle, Physics { effects: above, ..physics })?.hover_state([0.0; 3])?;
            (plant, hover)
        } else {
            BatchPlant::rigid(vehicle, physics)?
        };
        Self::of_plant(plant, physics, n_env, limit, &hover)
    }

    /// `n_env` copies of an articulated system at rest ([`Multibody::rest_state`](crate::tree::Multibody)).
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn of_model(model: &Model, physics: Physics, n_env: usize) -> Result<Self> {
        Self::of_model_with_memory_limit(model, physics, n_env, DEFAULT_MEMORY_LIMIT)
    }

    /// As [`World::of_model`] with another limit on memory, in bytes.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn of_model_with_memory_limit(model: &Model, physics: Physics, n_env: usize, limit: u64) -> Result<Self> {
        let (plant, rest) = BatchPlant::tree(model, physics, false)?;
        Self::of_plant(plant, physics, n_env, limit, &rest)
    }

    /// As [`World::of_model`], prepared for environments whose numbers differ where the model's are zero (a centre of
    /// mass off the origin, products of inertia, drag, damping): a little slower, since nothing is left out.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn of_varied_model(model: &Model, physics: Physics, n_env: usize) -> Result<Self> {
        let (plant, rest) = BatchPlant::tree(model, physics, true)?;
        Self::of_plant(plant, physics, n_env, DEFAULT_MEMORY_LIMIT, &rest)
    }

    fn of_plant(plant: BatchPlant, physics: Physics, n_env: usize, limit: u64, state: &[f64]) -> Result<Self> {
        let n_block = n_env.div_ceil(BLOCK);
        let of_block = (plant.n_row() + plant.n_number()) * size_of::<[f32; BLOCK]>();
        let needed = n_block as u128 * of_block as u128;
        if n_env == 0 {
            return Err(none_asked(limit));
        }
        let setting = match plant {
            BatchPlant::Rigid(_) => "the limit with World::with_memory_limit",
            BatchPlant::Tree(_) => "the limit with World::of_model_with_memory_limit",
        };
        let less = "Step fewer environments at once";
        let request = Request { what: "n_env", value: n_env, bytes: needed, limit, setting, less };
        request.check(|limit| format!("1 to {}", (u128::from(limit) / of_block as u128) * BLOCK as u128))?;
        plant.program(false);
        Ok(Self {
            n_env,
            physics,
            blocks: (0..n_block).map(|b| plant.block(state, (n_env - b * BLOCK).min(BLOCK))).collect(),
            after: Rows::zeros(plant.n_row()),
            plant,
            failures: Vec::with_capacity(n_env),
            culprits: Vec::with_capacity(n_env),
            n_step: 0,
            threads: Threads::default(),
        })
    }

    /// Steps on these threads from now on.
    pub fn set_threads(&mut self, threads: Threads) {
        self.threads = threads;
    }

    /// Number of environments.
    pub fn n_env(&self) -> usize {
        self.n_env
    }

    /// Numbers per state, in SI units, ordered as in [`RigidState`](crate::RigidState) or
    /// [`Layout`](crate::tree::Layout).
    pub fn n_state(&self) -> usize {
        self.plant.n_state()
    }

    /// Numbers per action, each in [−1, 1]: rotors, then drives, tree by tree.
    pub fn n_action(&self) -> usize {
        self.plant.n_action()
    }

    /// Time step, integrator and effects.
    pub fn physics(&self) -> &Physics {
        &self.physics
    }

    /// Environments that stopped since they were last set, in the order of stopping, by number within one step.
    pub fn failures(&self) -> &[Stopped] {
        &self.failures
    }

    /// What stopped an environment: the number farthest beyond its limit in the step that it did not survive. `None` while it
    /// is stepped.
    ///
    /// ```
    /// # use omnidrones_dynamics::omnidrones;
    /// use omnidrones::dynamics::{Physics, World, vehicles};
    /// let mut world = World::new(&vehicles::by_name("hummingbird")?, Physics::default(), 2)?;
    /// let mut state = world.state(1)?;
    /// state[12] = 9e7;
    /// world.set_state(1, &state)?;
    /// while world.failures().is_empty() {
    ///     world.step(&[0.1; 8])?;
    /// }
    /// assert!(world.breach(1).unwrap().to_string().contains("of body 'hummingbird' is"));
    /// assert!(world.breach(0).is_none());
    /// # Ok::<(), omnidrones::error::Error>(())
    /// ```
    pub fn breach(&self, environment: usize) -> Option<Breach> {
        let at = self.failures.iter().position(|f| f.environment == environment)?;
        Some(self.culprits[at]?.in_words(self.plant.words()))
    }

    /// One step of every environment. `actions`: row-major `[n_env, n_action]`, each in [−1, 1] (clipped).
    ///
    /// An environment whose action is NaN or whose state diverges keeps its last healthy state, is listed in
    /// [`World::failures`], and stands still from then on; no other environment changes by a bit.
    ///
    /// # Errors
    /// [`Error::Value`] if `actions` has another length.
    pub fn step(&mut self, actions: &[f32]) -> Result<()> {
        let (plant, n) = (&self.plant, self.plant.n_action());
        self.check_length("actions", actions.len(), n)?;
        let per_task = BLOCKS_PER_TASK * BLOCK * n;
        self.threads.for_each_chunk(&mut self.blocks, BLOCKS_PER_TASK, |task, blocks| {
            let actions = &actions[(task * per_task).min(actions.len())..actions.len().min((task + 1) * per_task)];
            if n > 0 {
                for (block, actions) in blocks.iter_mut().zip(actions.chunks(BLOCK * n)) {
                    plant.write_actions(actions, &mut block.rows);
                }
            }
            plant.step(blocks);
        });
        self.collect_failures(actions);
        self.n_step += 1;
        Ok(())
    }

    /// Lists the environments that ceased to be alive in this step, and what broke in them.
    fn collect_failures(&mut self, actions: &[f32]) {
        let (n, alive_row) = (self.n_action(), self.plant.alive_row());
        for (b, block) in self.blocks.iter_mut().enumerate() {
            let alive = &mut block.rows[alive_row];
            // no early exit: this form is vectorised
            if alive.iter().fold(true, |all, a| all & (*a == ALIVE)) {
                continue;
            }
            let mut stopped = 0_u64;
            for (lane, alive) in alive.iter_mut().enumerate() {
                if *alive == STOPPED && b * BLOCK + lane < self.n_env {
                    *alive = REPORTED;
                    stopped |= 1 << lane;
                }
            }
            if stopped == 0 {
                continue;
            }
            self.plant.follow(block, stopped, &mut self.after);
            for lane in (0..BLOCK).filter(|lane| stopped >> lane & 1 == 1) {
                let environment = b * BLOCK + lane;
                let wrong = self.plant.wrong_action(&actions[environment * n..(environment + 1) * n]);
                let reason = if wrong.is_some() { StopReason::NonFiniteAction } else { StopReason::Diverged };
                self.failures.push(Stopped { environment, step: self.n_step, reason });
                self.culprits.push(wrong.or_else(|| self.plant.exploded(&block.rows, &self.after, lane)));
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
                    *value = block.rows[k][lane];
                }
            }
        }
        Ok(())
    }

    /// The state of one environment, `[n_state]`.
    ///
    /// # Errors
    /// [`Error::Limit`] if there is no such environment.
    pub fn state(&self, environment: usize) -> Result<Vec<f32>> {
        let (block, lane) = self.place(environment)?;
        Ok((0..self.n_state()).map(|k| self.blocks[block].rows[k][lane]).collect())
    }

    /// Sets the state of one environment, `[n_state]`, and revives it if it had stopped.
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
        for (row, value) in self.blocks[block].rows.iter_mut().zip(state) {
            row[lane] = *value;
        }
        self.blocks[block].rows[self.plant.alive_row()][lane] = ALIVE;
        if let Some(at) = self.failures.iter().position(|f| f.environment == environment) {
            self.failures.remove(at);
            self.culprits.remove(at);
        }
        Ok(())
    }

    /// Gives one environment a vehicle of its own: masses, inertias, rotor constants, drag.
    ///
    /// # Errors
    /// [`Error::Value`] if the vehicle is not valid, has another number of rotors or a geometry that the batch's compiled
    /// effects leave out; [`Error::Limit`] if there is no such environment.
    pub fn set_vehicle(&mut self, environment: usize, vehicle: &Vehicle) -> Result<()> {
        let (block, lane) = self.place(environment)?;
        self.plant.set_vehicle(&mut self.blocks[block], lane, vehicle)
    }

    /// Gives one environment of an articulated system numbers of its own: masses, inertias, lengths, drives, rotors.
    ///
    /// # Errors
    /// [`Error::Value`] if the batch is of single multirotors, or the model has another topology than the batch's;
    /// [`Error::Limit`] if there is no such environment.
    pub fn set_model(&mut self, environment: usize, model: &Model) -> Result<()> {
        let (block, lane) = self.place(environment)?;
        self.plant.set_model(&mut self.blocks[block], lane, model)
    }

    /// Sets wind, force and moment on every tree of one environment from now on; in a batch of single multirotors there
    /// is one. Needs the effect `disturbance`.
    ///
    /// # Errors
    /// [`Error::Value`] if that effect is off or a number is not finite; [`Error::Limit`] if there is no such
    /// environment.
    pub fn set_disturbance(&mut self, environment: usize, air: &Disturbance<f32>) -> Result<()> {
        for tree in 0..self.plant.disturbance_rows().len().max(1) {
            self.set_tree_disturbance(environment, tree, air)?;
        }
        Ok(())
    }

    /// As [`World::set_disturbance`] on one tree alone: wind on all its bodies, force and moment on its root.
    ///
    /// # Errors
    /// As [`World::set_disturbance`]; [`Error::Limit`] if there is no such tree.
    pub fn set_tree_disturbance(&mut self, environment: usize, tree: usize, air: &Disturbance<f32>) -> Result<()> {
        let (block, lane) = self.place(environment)?;
        let rows = self.plant.disturbance_rows();
        if rows.is_empty() {
            return Err(Error::value(
                "effects.disturbance",
                "off",
                "on for wind and outside forces",
                "Build the world with Effects { disturbance: true, .. }.",
            ));
        }
        let Some(first) = rows.get(tree) else {
            return Err(Error::limit("tree", tree, rows.len() - 1, "Trees count from 0."));
        };
        let numbers: Vec<f32> = air.wind.iter().chain(&air.force).chain(&air.moment).copied().collect();
        let wide: Vec<f64> = numbers.iter().map(|x| f64::from(*x)).collect();
        finite("disturbance", &wide)?;
        for (row, value) in self.blocks[block].rows[*first..].iter_mut().zip(numbers) {
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
