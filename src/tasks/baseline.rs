//! The controllers of the library as policies: what learners have to beat.
//!
//! Free drones are flown by a cascade each, all levels in every step; what is joined together by its
//! [`default_controller`](controllers::registry::default_controller). All see the true state, the true masses of their episode (a free
//! drone all its numbers) and what the task [tracks](super::Task::reference), and act on the rotors.

use super::baseline_controllers::{Asked, BaselineControllers};
use super::env::{Buffers, Env};
use super::robot::Robot;
use super::task::TaskReference;
use base::error::{Error, Result};
use controllers::cascade::Level;
use controllers::optimal::MpcSettings;
use controllers::{ControlLaw, WrittenLaw};

/// One controller per environment.
pub struct Baseline {
    /// From the first step of an episode on.
    seats: Vec<Option<Seat>>,
    failures: Vec<(usize, Error)>,
    name: String,
    asked: Option<Asked>,
    dt: f64,
    n_action: usize,
    /// Of the environment it was made for: what flies is numbered so.
    config_hash: u64,
}

struct Seat {
    crew: BaselineControllers,
    reference: TaskReference,
    input: Vec<f64>,
    step: u64,
}

impl Baseline {
    /// Controllers for every environment of a batch in rotor mode. They learn masses and references at the first call of
    /// [`Baseline::act`] after a reset: make a new one for new episodes.
    ///
    /// # Errors
    /// [`Error::Value`] if the environment is in another control mode or no reference says what the task tracks;
    /// otherwise as the controllers.
    pub fn new(env: &Env) -> Result<Self> {
        Self::made(env, None)
    }

    /// Likewise with a controller of the [registry](controllers::registry) by its name, as `mpc`, in place of the usual one; of one vehicle or
    /// of what is joined together.
    ///
    /// # Errors
    /// As [`new`](Self::new), and for a name that there is not or a robot that it is not made for.
    pub fn with_controller(env: &Env, name: &str) -> Result<Self> {
        Self::made(env, Some(Asked::Named { name: name.to_string(), mpc: None }))
    }

    /// Likewise with one that plans, `mpc` or `mpc_indi`, by these settings.
    ///
    /// # Errors
    /// As [`with_controller`](Self::with_controller), as [`MpcSettings::validate`], and [`Error::Value`] for a latency that the commands of the
    /// environment do not have.
    pub fn with_plans(env: &Env, name: &str, settings: &MpcSettings) -> Result<Self> {
        let delay = env.spec().config.delay;
        if settings.latency < delay.min || settings.latency > delay.max {
            let rule = format!("{} to {}, the delay of the environment's commands in steps", delay.min, delay.max);
            let remedy = "Leave `latency` out, or delay the commands of the task.";
            return Err(Error::value("mpc: latency", settings.latency, rule, remedy));
        }
        Self::made(env, Some(Asked::Named { name: name.to_string(), mpc: Some(Box::new(settings.clone())) }))
    }

    /// Likewise with a law that is data, recorded for the plant of the environment's [robot](Env::robot); it knows the nominal numbers, not
    /// those of an episode.
    ///
    /// # Errors
    /// As [`with_controller`](Self::with_controller); as [`ControlLaw::check_plant`], and [`Error::Value`] for a law that does not tick in
    /// every step.
    pub fn with_law(env: &Env, law: &WrittenLaw) -> Result<Self> {
        let dt = env.spec().dt;
        if law.rate().is_some_and(|rate| (rate * dt - 1.0).abs() > 1e-9) {
            let (what, rule) =
                (format!("rate of controller '{}'", law.name()), format!("{} Hz, a tick in each step", 1.0 / dt));
            let remedy = "Leave `rate` out, and give `levels` rates of their own.";
            return Err(Error::value(what, law.rate().unwrap_or(0.0), rule, remedy));
        }
        Self::made(env, Some(Asked::Written(Box::new(law.clone()))))
    }

    fn made(env: &Env, asked: Option<Asked>) -> Result<Self> {
        let spec = env.spec();
        if spec.config.control != Level::Rotor {
            let remedy = "Leave `control` out.";
            return Err(Error::value("control", spec.config.control.name(), "'rotor' for a controller", remedy));
        }
        if env.reference(0)?.is_none() {
            let what = format!("task {}: reference", spec.task);
            return Err(Error::value(what, "none", "one that a controller can track", "Try --controller random."));
        }
        let name =
            BaselineControllers::of(env.robot(), &env.parameters(0)?, spec.dt, asked.as_ref())?.name().to_string();
        let seats = (0..spec.n_env).map(|_| None).collect();
        let n_action = spec.n_agent * spec.action.len();
        Ok(Self { seats, failures: Vec::new(), name, asked, dt: spec.dt, n_action, config_hash: env.config_hash() })
    }

    /// Name of the controller that flies, in one word.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Actions of all agents of all environments, `[E, A, action]` in [−1, 1], for the state as it is, computed on the threads of the
    /// environment, whose number changes no bit. An environment whose numbers no controller can fly keeps its rotors at hover speed: see
    /// [`Baseline::failures`].
    ///
    /// # Errors
    /// [`Error::Value`] for another environment than the one it was made for, or actions of the wrong length.
    pub fn act(&mut self, env: &Env, actions: &mut [f32]) -> Result<()> {
        if env.config_hash() != self.config_hash || env.spec().n_env != self.seats.len() {
            let (got, wanted) = (format!("{env:?}"), format!("one like that it was made for, of {}", self.seats.len()));
            return Err(Error::value("environment of a baseline", got, wanted, "Make a new one: Baseline::new(&env)."));
        }
        let wanted = self.seats.len() * self.n_action;
        if actions.len() != wanted {
            let remedy = "Rows are [environment, agent, action], row-major.";
            return Err(Error::value("length of actions", actions.len(), wanted.to_string(), remedy));
        }
        let Self { seats, asked, dt, n_action, failures, .. } = self;
        let mut rows: Vec<Row<'_>> = seats.iter_mut().zip(actions.chunks_mut(*n_action)).map(Row::new).collect();
        env.threads().for_each(&mut rows, |i, row| row.flown = row.fly(env, i, *dt, asked.as_ref()));
        for (i, row) in rows.into_iter().enumerate() {
            failures.extend(row.flown?.map(|error| (i, error)));
        }
        Ok(())
    }

    /// Makes a new controller for environment `environment` at the next [`Baseline::act`]: where an episode began.
    pub fn forget(&mut self, environment: usize) {
        if let Some(seat) = self.seats.get_mut(environment) {
            *seat = None;
        }
    }

    /// Environments whose numbers no controller could be made for, and why.
    pub fn failures(&self) -> &[(usize, Error)] {
        &self.failures
    }

    /// As a policy for [`evaluate`](super::evaluate()).
    pub fn policy(&mut self) -> impl FnMut(&Env, &Buffers, &mut [f32]) -> Result<()> + '_ {
        |env, _, actions| self.act(env, actions)
    }
}

/// One environment in one call.
struct Row<'a> {
    seat: &'a mut Option<Seat>,
    actions: &'a mut [f32],
    /// Why nobody flies from this call on.
    flown: Result<Option<Error>>,
}

impl<'a> Row<'a> {
    fn new((seat, actions): (&'a mut Option<Seat>, &'a mut [f32])) -> Self {
        Self { seat, actions, flown: Ok(None) }
    }

    fn fly(&mut self, env: &Env, environment: usize, dt: f64, asked: Option<&Asked>) -> Result<Option<Error>> {
        let robot = env.robot();
        let state: Vec<f64> = env.state(environment)?.iter().map(|x| f64::from(*x)).collect();
        let mut failure = None;
        if self.seat.is_none() {
            let (seat, error) = Seat::new(env, environment, dt, asked)?;
            (*self.seat, failure) = (Some(seat), error);
        }
        if let Some(seat) = self.seat {
            seat.fly(robot, &state, dt);
            let places = robot.command_places(env.spec().action.len()).zip(self.actions.iter_mut());
            places.for_each(|(place, a)| *a = place.map_or(0.0, |k| seat.input[k].clamp(-1.0, 1.0) as f32));
        }
        Ok(failure)
    }
}

impl Seat {
    /// With what kept a controller from being made.
    fn new(env: &Env, environment: usize, dt: f64, asked: Option<&Asked>) -> Result<(Self, Option<Error>)> {
        let robot = env.robot();
        let crew = BaselineControllers::of(robot, &env.parameters(environment)?, dt, asked);
        let (crew, failure) = match crew {
            Ok(crew) => (crew, None),
            Err(error) => (BaselineControllers::Nobody, Some(error)),
        };
        let reference = env.reference(environment)?.unwrap_or(TaskReference::point([0.0; 3], 0.0));
        Ok((Self { crew, reference, input: robot.hover_input(), step: 0 }, failure))
    }

    fn fly(&mut self, robot: &Robot, state: &[f64], dt: f64) {
        let time = self.step as f64 * dt;
        self.step += 1;
        self.crew.fly(robot, &self.reference, time, state, &mut self.input);
    }
}
