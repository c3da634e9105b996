//! A step phase by phase, in plain numbers, for who wants to look inside.

use super::Env;
use super::block::signal;
use super::phases::{Numbers, Step};
use autodiff::program::BLOCK;
use autodiff::trace::on_constants;
use autodiff::{Scalar, Trace};
use base::error::{Error, Result};
use dynamics::frame::{FRAME, Frame};

/// A step of one environment in `f64`, done phase by phase: [`Env::inside_step`].
///
/// Phases are those that programs of environments and gradients are recorded of; [`StepPhases::finish`] says in which order. Events,
/// sensors, noise and controllers that actions correct stand outside.
pub struct StepPhases<'a> {
    step: Step<'a>,
    env: &'a Env,
    actions: Vec<Trace>,
}

impl Env {
    /// Lets `look` do a step of one environment as it stands, phase by phase, with the actions of its agents, `[A · action]`. The
    /// environment itself does not move.
    ///
    /// ```
    /// # use omnidrones_tasks::omnidrones;
    /// use omnidrones::tasks::{Buffers, Env, EnvConfig};
    ///
    /// let mut env = Env::make("Hover", &EnvConfig::from_toml("control = 'rate'", "text")?)?;
    /// env.reset(None, None, &mut Buffers::new(env.spec()).out())?;
    /// let rotors = env.inside_step(0, &[0.0, 0.0, 0.1, 0.3], |step| {
    ///     step.act();
    ///     step.disturb();
    ///     step.steer(0);
    ///     step.inputs() // what the cascade makes of the command, before anything has moved
    /// })?;
    /// assert!(rotors.len() == 4 && rotors.iter().all(|rotor| rotor.abs() < 1.0));
    /// # Ok::<(), omnidrones::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Env::state`]; [`Error::Value`] for an action of the wrong length, where actions are whole numbers, or where an environment
    /// was never reset.
    pub fn inside_step<R>(
        &self,
        environment: usize,
        action: &[f64],
        look: impl FnOnce(&mut StepPhases<'_>) -> R,
    ) -> Result<R> {
        self.check_environment(environment)?;
        self.check_started()?;
        let wanted = self.core.sizes.command;
        if action.len() != wanted || !self.core.control.is_continuous() {
            let remedy = "Give the actions of all agents, continuous.";
            return Err(Error::value("length of action", action.len(), wanted.to_string(), remedy));
        }
        Ok(on_constants(|| {
            let actions = action.iter().map(|x| Trace::constant(*x)).collect();
            let step = Step::new(&self.core, self.constants(environment));
            look(&mut StepPhases { step, env: self, actions })
        }))
    }

    /// What one environment holds, as constants of a recording.
    fn constants(&self, environment: usize) -> Numbers {
        let (core, block, lane) = (&self.core, &self.blocks[environment / BLOCK], environment % BLOCK);
        let row = |rows: &[[f32; BLOCK]]| rows.iter().map(|row| Trace::constant(f64::from(row[lane]))).collect();
        let mut work = vec![Trace::zero(); core.layout.work.count];
        core.layout.work.common.of_mut(&mut work)[0] = Trace::one();
        Numbers {
            plant: row(&block.plant.rows),
            kept: row(&block.kept),
            work,
            shared: row(&core.shared),
            model: match &block.plant.numbers {
                Some(own) => row(own),
                None => core.plant.constant_numbers(),
            },
        }
    }
}

/// Their values.
fn known(numbers: &[Trace]) -> Vec<f64> {
    numbers.iter().map(|x| x.known().unwrap_or(f64::NAN)).collect()
}

impl StepPhases<'_> {
    /// Actions to commands: clipped and delayed.
    pub fn act(&mut self) {
        self.step.clip(&self.actions);
        self.step.delay();
        self.step.keep_speeds();
    }

    /// Disturbances of the coming step, from the view before it.
    pub fn disturb(&mut self) {
        self.step.move_frames();
        self.step.disturb();
    }

    /// Computations of the controllers in a step: 1 where actions are those of rotors.
    pub fn n_computation(&self) -> usize {
        self.env.core.control.steps
    }

    /// Computation `k` of the controllers, which holds what an earlier one left.
    pub fn steer(&mut self, k: usize) {
        self.step.move_frames();
        self.step.steer(k);
    }

    /// The physics between one computation and the next.
    pub fn physics(&mut self) {
        self.step.physics();
    }

    /// Stops a vehicle that left its [`Bounds`](crate::Bounds); the state at rest is shown in its place.
    pub fn contain(&mut self) {
        self.step.contain();
    }

    /// Time, task state, reward, ends.
    pub fn judge(&mut self) {
        self.step.move_frames();
        self.step.judge();
    }

    /// Observations and the central state.
    pub fn observe(&mut self) {
        self.step.observe();
        self.step.read();
    }

    /// Observations through their stages.
    pub fn transform(&mut self) {
        self.step.transform();
    }

    /// All phases, in order.
    pub fn finish(&mut self) {
        self.act();
        self.disturb();
        for k in 0..self.n_computation() {
            self.steer(k);
            self.physics();
        }
        self.contain();
        self.judge();
        self.observe();
        self.transform();
    }

    /// The state that is shown, in the layout of the robot.
    pub fn state(&self) -> Vec<f64> {
        known(&self.step.state)
    }

    /// Commands of all agents within [−1, 1], clipped and delayed.
    pub fn commands(&self) -> Vec<f64> {
        known(self.env.core.layout.work.command.of(&self.step.numbers.work))
    }

    /// The input of the physics: rotors and drives, then disturbances where they have an effect.
    pub fn inputs(&self) -> Vec<f64> {
        let plant = &self.env.core.plant;
        known(&self.step.numbers.plant[plant.n_state()..plant.alive_row()])
    }

    /// Motion of a body along world axes, when frames were last asked for.
    ///
    /// # Panics
    /// If there is no such body, or no phase has asked for frames.
    pub fn frame(&self, body: usize) -> Frame<f64> {
        let numbers = known(&self.step.frames[body * FRAME..][..FRAME]);
        Frame::read(&numbers)
    }

    /// The terms of the reward.
    pub fn terms(&self) -> Vec<f64> {
        known(&self.step.terms)
    }

    /// Of the team, 0 where the step broke.
    pub fn reward(&self) -> f64 {
        self.signal(signal::REWARD)
    }

    /// Training loss of the step.
    pub fn loss(&self) -> f64 {
        self.signal(signal::LOSS)
    }

    /// Whether the task, or a number out of its bounds, ends the episode.
    pub fn is_terminated(&self) -> bool {
        self.signal(signal::TERMINATED) > 0.5
    }

    /// Whether its time is over.
    pub fn is_truncated(&self) -> bool {
        self.signal(signal::TRUNCATED) > 0.5
    }

    /// One agent's observation behind the stages.
    ///
    /// # Panics
    /// If there is no such agent.
    pub fn observation(&self, agent: usize) -> Vec<f64> {
        let n = self.env.core.sizes.observation;
        known(&self.env.core.layout.work.observation.of(&self.step.numbers.work)[agent * n..][..n])
    }

    fn signal(&self, which: usize) -> f64 {
        known(self.env.core.layout.work.signals.of(&self.step.numbers.work))[which]
    }
}

impl std::fmt::Debug for StepPhases<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "StepPhases({})", self.env.spec.task)
    }
}
