//! One controller for each plant of a batch, all of them in one call, on all cores.
//!
//! For controllers with a solver inside, as [`Mpc`](super::optimal::Mpc), which do not run in lanes. Each row has a controller of its own
//! and no other sees it, so that results depend neither on threads nor on how many rows there are.

use super::controller::{Controller, Measurement, Target};
use autodiff::System;
use base::error::{Error, Result};
use base::parallel::Threads;
use dynamics::{Disturbance, Plant};

/// Controllers of n plants of one make, as those of a [`World`](dynamics::World).
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::controllers::optimal::{Mpc, MpcSettings};
/// use omnidrones::controllers::reference::{Hover, Reference};
/// use omnidrones::controllers::{ControllerBatch, Target};
/// use omnidrones::dynamics::{Physics, Plant, World, vehicles};
///
/// let (vehicle, physics, n) = (vehicles::by_name("hummingbird")?, Physics::default(), 3);
/// let plant = Plant::of_vehicle(&vehicle, physics)?;
/// let settings = MpcSettings { stages: 5, ..MpcSettings::for_plant(&plant) };
/// let mut crew = ControllerBatch::new(&plant, n, |_| Mpc::new(&plant, &settings))?;
/// let goals: Vec<Reference> =
///     (0..n).map(|i| Reference::Hover(Hover { position: [0.01 * i as f64, 0.0, 0.0], yaw: 0.0 })).collect();
///
/// let mut world = World::new(&vehicle, physics, n)?;
/// let mut states = vec![0.0; n * world.n_state()];
/// let mut actions = vec![0.0; n * world.n_action()];
/// for k in 0..10 {
///     world.read_states(&mut states)?;
///     crew.tick(k as f64 * physics.dt, &states, &|i| Target::level(&goals[i]), &mut actions)?;
///     world.step(&actions)?;
/// }
/// assert!(crew.controllers().all(|mpc| mpc.statistics().fallen_back == 0));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
pub struct ControllerBatch<C> {
    rows: Vec<Row<C>>,
    threads: Threads,
    n_state: usize,
    /// Of the plant's inputs those that a controller writes.
    commands: Vec<usize>,
}

struct Row<C> {
    controller: C,
    state: Vec<f64>,
    input: Vec<f64>,
}

/// One row in one call.
struct Work<'a, C> {
    own: &'a mut Row<C>,
    state: &'a [f32],
    actions: &'a mut [f32],
}

impl<C: Controller> ControllerBatch<C> {
    /// For `n` plants made like this one; `make` gives the controller of each row, on the threads that all share.
    ///
    /// # Errors
    /// The first of `make`, by row.
    pub fn new(plant: &Plant, n: usize, make: impl Fn(usize) -> Result<C> + Sync + Send) -> Result<Self> {
        let (state, input) = (vec![0.0; plant.n_state()], vec![0.0; plant.n_input()]);
        let pushes = plant.disturbances();
        let is_push = |k: &usize| pushes.iter().any(|first| (*first..first + Disturbance::<f64>::DIM).contains(k));
        let threads = Threads::default();
        let made = threads.map(n, |i| {
            let controller = make(i)?;
            Ok(Row { controller, state: state.clone(), input: input.clone() })
        });
        Ok(Self {
            rows: made.into_iter().collect::<Result<_>>()?,
            n_state: state.len(),
            commands: (0..input.len()).filter(|k| !is_push(k)).collect(),
            threads,
        })
    }

    /// Ticks on these threads from now on.
    pub fn set_threads(&mut self, threads: Threads) {
        self.threads = threads;
    }

    /// Rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Numbers per action: rotors and drives.
    pub fn n_action(&self) -> usize {
        self.commands.len()
    }

    /// The controllers, row by row.
    pub fn controllers(&self) -> impl ExactSizeIterator<Item = &C> {
        self.rows.iter().map(|row| &row.controller)
    }

    /// The controller of a row, to reset it or to tell it what is left of its rotors; `None` beyond the last.
    pub fn controller_mut(&mut self, row: usize) -> Option<&mut C> {
        self.rows.get_mut(row).map(|row| &mut row.controller)
    }

    /// One tick of every controller at `time`, s, in the step that it is due in: states `[n, n_state]` in the plant's layout, what each
    /// row is to do, actions `[n, n_action]` in [−1, 1].
    ///
    /// # Errors
    /// [`Error::Value`] for slices of another length.
    pub fn tick<'t>(
        &mut self,
        time: f64,
        states: &[f32],
        target: &(dyn Fn(usize) -> Target<'t> + Sync),
        actions: &mut [f32],
    ) -> Result<()> {
        let (n, commands) = (self.rows.len(), &self.commands);
        for (what, got, each) in
            [("length of states", states.len(), self.n_state), ("length of actions", actions.len(), commands.len())]
        {
            if got != n * each {
                let wanted = format!("{}, {each} for each of {n}", n * each);
                return Err(Error::value(what, got, wanted, "Rows lie one behind the other."));
            }
        }
        let given = states.chunks(self.n_state.max(1)).zip(actions.chunks_mut(commands.len().max(1)));
        let work = self.rows.iter_mut().zip(given).map(|(own, (state, actions))| Work { own, state, actions });
        self.threads.for_each(&mut work.collect::<Vec<_>>(), |i, Work { own, state, actions }| {
            let Row { controller, state: wide, input } = &mut **own;
            wide.iter_mut().zip(*state).for_each(|(wide, x)| *wide = f64::from(*x));
            controller.tick(Measurement { time, state: wide, readings: &[] }, target(i), input);
            actions.iter_mut().zip(commands).for_each(|(a, k)| *a = input[*k].clamp(-1.0, 1.0) as f32);
        });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cascade::Rates;
    use crate::optimal::{Mpc, MpcSettings};
    use crate::reference::{Hover, Lemniscate, Reference};
    use crate::registry::{Setup, controller};
    use dynamics::{Effects, Physics, World, configurations, vehicles};

    /// Actions of all ticks, and how far each plant is from its reference in the end, m.
    fn flown<C: Controller>(
        plant: &Plant,
        mut world: World,
        threads: usize,
        ticks: u64,
        make: impl Fn(usize) -> Result<C> + Sync + Send,
    ) -> (Vec<f32>, Vec<f64>) {
        let n = world.n_env();
        let mut crew = ControllerBatch::new(plant, n, make).unwrap();
        crew.set_threads(Threads::new(threads).unwrap());
        let goal = |i: usize| Reference::Hover(Hover { position: [0.1 * i as f64, -0.1, 0.05], yaw: 0.0 });
        let goals: Vec<Reference> = (0..n).map(goal).collect();
        let (mut states, mut actions) = (vec![0.0; n * world.n_state()], vec![0.0; n * crew.n_action()]);
        assert_eq!(crew.n_action(), world.n_action());
        let mut all = Vec::new();
        for k in 0..ticks {
            world.read_states(&mut states).unwrap();
            let time = k as f64 * world.physics().dt;
            crew.tick(time, &states, &|i| Target::level(&goals[i]), &mut actions).unwrap();
            world.step(&actions).unwrap();
            all.extend_from_slice(&actions);
        }
        let off = |i: usize| {
            let (state, wanted) = (world.state(i).unwrap(), goals[i].sample(0.0).position);
            (0..3).map(|k| (f64::from(state[k]) - wanted[k]).powi(2)).sum::<f64>().sqrt()
        };
        (all, (0..n).map(off).collect())
    }

    #[test]
    fn plans_of_a_batch_do_not_depend_on_threads_and_reach_a_goal_each() {
        let effects = Effects { disturbance: true, ..Effects::default() };
        let physics = Physics { dt: 0.01, effects, ..Physics::default() };
        let vehicle = vehicles::by_name("hummingbird").unwrap();
        let plant = Plant::of_vehicle(&vehicle, physics).unwrap();
        let settings = MpcSettings { stages: 10, ..MpcSettings::for_plant(&plant) };
        let fly = |threads, n| {
            let world = World::new(&vehicle, physics, n).unwrap();
            flown(&plant, world, threads, 150, |_| Mpc::new(&plant, &settings))
        };
        let [(one, off), (two, _), (few, _)] = [fly(1, 3), fly(2, 3), fly(2, 1)];
        println!("off after 1.5 s: {off:.4?} m");
        assert!(one == two && off.iter().all(|d| *d < 0.02), "{off:?}");
        let n = plant.rotor_places().len();
        assert!(one.chunks(3 * n).zip(few.chunks(n)).all(|(all, own)| all[..n] == *own));
    }

    #[test]
    fn any_controller_of_the_table_flies_a_batch_of_trees() {
        let physics = Physics { dt: 0.01, ..Physics::default() };
        let model = configurations::by_name("payload").unwrap();
        let plant = Plant::of_model(&model, physics).unwrap();
        let rates = Rates::every_step(physics.dt);
        for name in ["lqr", "mpc"] {
            let world = World::of_model(&model, physics, 2).unwrap();
            let make = |_| controller(name, &plant, &Setup::new(None, &rates));
            let (actions, off) = flown(&plant, world, 2, 100, make);
            assert!(actions.iter().all(|a| (-1.0..=1.0).contains(a)) && off[0] < 0.3, "{name}: {off:?}");
        }
    }

    #[test]
    fn slices_of_another_length_are_refused_and_a_row_can_be_reset() {
        let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), Physics::default()).unwrap();
        let rates = Rates::default();
        let mut crew =
            ControllerBatch::new(&plant, 2, |_| controller("cascade", &plant, &Setup::new(None, &rates))).unwrap();
        let path = Reference::Lemniscate(Lemniscate::default());
        let target = |_: usize| Target::level(&path);
        let (states, mut actions) = (vec![0.0; 2 * plant.n_state()], vec![0.0; 8]);
        let refused = crew.tick(0.0, &states[1..], &target, &mut actions).unwrap_err().to_string();
        assert!(refused.contains("length of states is 33") && refused.contains("34, 17 for each of 2"), "{refused}");
        let refused = crew.tick(0.0, &states, &target, &mut actions[..7]).unwrap_err().to_string();
        assert!(refused.contains("length of actions is 7"), "{refused}");
        assert!(crew.controller_mut(1).is_some() && crew.controller_mut(2).is_none() && crew.controllers().len() == 2);
        let failed = ControllerBatch::new(&plant, 1, |_| controller("platform", &plant, &Setup::new(None, &rates)));
        assert!(failed.err().unwrap().to_string().contains("a frame under drones"));
    }
}
