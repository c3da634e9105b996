//! One step of an environment, written once over recorded numbers: [`Programs`](super::programs::Programs) run it in blocks,
//! gradients are taken of it.
//!
//! ```text
//! act -> disturb -> (steer -> physics) as often as controllers compute -> contain -> judge -> observe -> transform
//! ```
//!
//! Host code stands between where no recording can: controllers that actions correct, sensors, events, draws of noise.

use super::block::{episode_state, signal};
use super::control::clipped;
use super::core::Core;
use super::layout::{EnvLayout, Kept, Part, Working};
use crate::declare::{Ends, Writer};
use crate::observation::AgentArrays;
use crate::task::View;
use autodiff::{Mask, Scalar, Trace, TraceMask};
use base::error::Error;
use dynamics::batch::{ALIVE, STOPPED};

/// The numbers of one environment, by the arrays of [`EnvLayout`].
#[derive(Debug, Clone)]
pub(crate) struct Numbers {
    /// State, input, `alive`.
    pub plant: Vec<Trace>,
    pub kept: Vec<Trace>,
    pub work: Vec<Trace>,
    pub shared: Vec<Trace>,
    /// Of the model.
    pub model: Vec<Trace>,
}

impl Numbers {
    /// Zeros, of an environment that is alive and whose numbers that vary are these.
    pub(crate) fn blank(core: &Core, varied: &[Trace]) -> Self {
        let EnvLayout { kept, work, shared } = &core.layout;
        let zeros = |n: usize| vec![Trace::zero(); n];
        let mut own = Self {
            plant: zeros(core.plant.n_row()),
            kept: zeros(kept.count),
            work: zeros(work.count),
            shared: zeros(shared.count),
            model: core.plant.constant_numbers(),
        };
        own.plant[core.plant.alive_row()] = constant(f64::from(ALIVE));
        kept.theta.of_mut(&mut own.kept).copy_from_slice(varied);
        if !core.varied.is_empty() {
            let mut parameters: Vec<Trace> = core.nominal.iter().map(|x| constant(*x)).collect();
            core.varied.iter().zip(varied).for_each(|(k, value)| parameters[*k] = *value);
            own.model = core.plant.numbers_of(&parameters);
        }
        own
    }

    /// One array after the other, those of the model that vary last.
    pub(crate) fn all(&self, core: &Core) -> impl Iterator<Item = Trace> {
        let varying = core.varying.iter().map(|k| self.model[*k]);
        [&self.plant, &self.kept, &self.work, &self.shared].into_iter().flatten().copied().chain(varying)
    }
}

/// An environment in a step.
pub(crate) struct Step<'a> {
    pub core: &'a Core,
    layout: &'a EnvLayout,
    pub numbers: Numbers,
    /// Whether what explodes is stopped. Derivatives are taken of steps that went well.
    pub contains: bool,
    /// Whether what is observed is off by what estimates are off by. The state is an estimate itself where it is not.
    pub errs: bool,
    /// Whether it may go on beyond its horizon: the clock then stays where that of the last step is.
    pub is_endless: bool,
    /// The state that is shown: that at rest where an episode ends because it left its bounds.
    pub state: Vec<Trace>,
    pub frames: Vec<Trace>,
    /// What the task is shown as its goal, where that is another one than what is kept.
    pub goal: Vec<Trace>,
    pub terms: Vec<Trace>,
    /// What cascades hold within a step.
    pub latched: Vec<Trace>,
    /// Why it cannot be: a task answered otherwise than before.
    pub fault: Option<Error>,
}

fn constant(x: f64) -> Trace {
    Trace::constant(x)
}

/// 1 where the mask holds, else 0.
pub(crate) fn number(mask: TraceMask) -> Trace {
    Trace::select(mask, Trace::one(), Trace::zero())
}

/// Of numbers in order, from zero on.
pub(crate) fn sum(numbers: &[Trace]) -> Trace {
    numbers.iter().fold(Trace::zero(), |sum, x| sum + *x)
}

impl<'a> Step<'a> {
    /// Before anything is done.
    pub(crate) fn new(core: &'a Core, numbers: Numbers) -> Self {
        let (state, layout) = (numbers.plant[..core.plant.n_state()].to_vec(), &core.layout);
        let goal = layout.kept.goal.of(&numbers.kept).to_vec();
        let latched = vec![Trace::zero(); core.sizes.held];
        let (frames, terms) = (Vec::new(), Vec::new());
        Self {
            core,
            layout,
            numbers,
            contains: true,
            errs: true,
            is_endless: false,
            state,
            frames,
            goal,
            terms,
            latched,
            fault: None,
        }
    }

    pub(crate) fn kept(&self, part: impl Fn(&Kept) -> Part) -> &[Trace] {
        part(&self.layout.kept).of(&self.numbers.kept)
    }

    pub(crate) fn kept_mut(&mut self, part: impl Fn(&Kept) -> Part) -> &mut [Trace] {
        part(&self.layout.kept).of_mut(&mut self.numbers.kept)
    }

    pub(crate) fn work(&self, part: impl Fn(&Working) -> Part) -> &[Trace] {
        part(&self.layout.work).of(&self.numbers.work)
    }

    pub(crate) fn work_mut(&mut self, part: impl Fn(&Working) -> Part) -> &mut [Trace] {
        part(&self.layout.work).of_mut(&mut self.numbers.work)
    }

    pub(crate) fn episode(&self, row: usize) -> Trace {
        self.kept(|kept| kept.episode_state)[row]
    }

    pub(crate) fn set_episode(&mut self, row: usize, value: Trace) {
        self.kept_mut(|kept| kept.episode_state)[row] = value;
    }

    fn alive(&self) -> Trace {
        self.numbers.plant[self.core.plant.alive_row()]
    }

    /// Whether the episode runs.
    fn running(&self) -> TraceMask {
        constant(0.5).lt(self.episode(episode_state::RUNNING))
    }

    /// What the task sees now.
    pub(crate) fn view(&self) -> View<'_> {
        let step = self.episode(episode_state::STEP);
        let horizon = self.core.task.horizon() as f64;
        let mut time = step + self.episode(episode_state::OFFSET);
        if self.is_endless {
            time = time.min(constant(horizon - 1.0));
        }
        View {
            robot: self.core.robot(),
            state: &self.state[..],
            frames: &self.frames[..],
            speeds_before: self.work(|work| work.speeds),
            goal: &self.goal[..],
            task_state: self.kept(|kept| kept.task_state),
            step,
            clock: time * constant(1.0 / horizon),
        }
    }

    /// Actions of the caller to commands within [−1, 1]: what is not finite is the safe one. Counts what it changed.
    pub(crate) fn clip(&mut self, actions: &[Trace]) {
        let control = &self.core.control;
        let (n, mut changed) = (control.n_command, Trace::zero());
        for (k, action) in actions.iter().enumerate() {
            let command = if k % n < control.n_command_of[k / n] {
                let (used, differs) = clipped(*action, control.safe[k]);
                changed += number(differs);
                used
            } else {
                Trace::zero()
            };
            self.work_mut(|work| work.command)[k] = command;
        }
        self.set_episode(episode_state::CLIPPED, changed);
    }

    /// Actions of the caller as they are in its rows.
    pub(crate) fn actions(&self) -> Vec<Trace> {
        self.work(|work| work.action).to_vec()
    }

    /// Commands into the delay line, and those that are due out of it.
    pub(crate) fn delay(&mut self) {
        let (slots, n) = (self.core.sizes.delay, self.core.sizes.command);
        if slots == 0 {
            return;
        }
        let delay = self.episode(episode_state::DELAY);
        let mut line = self.work(|work| work.command).to_vec();
        line.extend_from_slice(&self.kept(|kept| kept.line)[..(slots - 1) * n]);
        for slot in 1..slots {
            let due = constant(slot as f64 - 0.5).lt(delay);
            for k in 0..n {
                let command = &mut self.work_mut(|work| work.command)[k];
                *command = Trace::select(due, line[slot * n + k], *command);
            }
        }
        self.kept_mut(|kept| kept.line).copy_from_slice(&line);
    }

    /// Rotor speeds for the views behind the step.
    pub(crate) fn keep_speeds(&mut self) {
        let speeds: Vec<Trace> = self.core.speed_rows.iter().map(|k| self.numbers.plant[*k]).collect();
        self.work_mut(|work| work.speeds).copy_from_slice(&speeds);
    }

    /// Where all bodies are now.
    pub(crate) fn move_frames(&mut self) {
        self.frames = self.core.plant.frames_of(&self.state, &self.numbers.model);
    }

    /// Tells where bodies are.
    pub(crate) fn tell_frames(&mut self) {
        let frames = self.frames.clone();
        self.work_mut(|work| work.frames).copy_from_slice(&frames);
    }

    /// Disturbances of the coming step, from the view before it.
    pub(crate) fn disturb(&mut self) {
        for (tree, first) in self.core.robot().disturbances().into_iter().enumerate() {
            let mut own = self.core.task.disturb(&self.view(), tree);
            own.iter_mut().zip(self.kept(|kept| kept.air)).for_each(|(own, air)| *own += *air);
            let row = self.core.plant.input_row(first);
            self.numbers.plant[row..row + own.len()].copy_from_slice(&own);
        }
    }

    /// Computation `k` of the controllers.
    pub(crate) fn steer(&mut self, k: usize) {
        self.steer_by(if k == 0 { Trace::one() } else { Trace::zero() });
    }

    /// A computation of the controllers; `first` is 1 if it is that of a step, else 0.
    pub(crate) fn steer_by(&mut self, first: Trace) {
        let (core, frames) = (self.core, &self.frames[..]);
        let Numbers { plant, work, .. } = &mut self.numbers;
        let (commands, input) = (self.layout.work.command.of(work), &mut plant[core.plant.n_state()..]);
        core.control.steer(core.robot(), first, frames, commands, &mut self.latched, input);
    }

    /// The physics that follow it.
    pub(crate) fn physics(&mut self) {
        let (own, n_state) = (&self.core.plant, self.core.plant.n_state());
        let Numbers { plant, model, .. } = &mut self.numbers;
        let (state, rest) = plant.split_at_mut(n_state);
        let (input, alive) = rest.split_at_mut(own.n_input());
        if self.contains {
            let next = own.contained_step(state, input, alive[0], model);
            state.copy_from_slice(&next[..n_state]);
            alive[0] = next[n_state];
        } else {
            state.copy_from_slice(&own.next_state(state, input, model));
        }
        self.state.copy_from_slice(state);
    }

    /// What left its bounds stops, and the state at rest is shown in its place: one of any size would reach the observation that
    /// the episode ends with.
    pub(crate) fn contain(&mut self) {
        let mut within = Trace::zero().lt(Trace::one());
        for (row, limit) in &self.core.limits {
            within = within.and(self.state[*row].abs().lt(constant(f64::from(*limit))));
        }
        let alive = self.alive();
        let gave_up = number(self.running().and(alive.lt(0.5)));
        self.work_mut(|work| work.signals)[signal::GAVE_UP] = gave_up;
        let alive = Trace::select(within, alive, alive.min(constant(f64::from(STOPPED))));
        self.numbers.plant[self.core.plant.alive_row()] = alive;
        let stopped = self.running().and(alive.lt(constant(0.5)));
        let rest = self.core.robot().rest().iter().map(|x| constant(*x));
        self.state.iter_mut().zip(rest).for_each(|(x, rest)| *x = Trace::select(stopped, rest, *x));
    }

    /// Time, task state, reward, ends.
    pub(crate) fn judge(&mut self) {
        let (core, running) = (self.core, self.running());
        let (zero, half) = (Trace::zero(), constant(0.5));
        let time = self.episode(episode_state::STEP) + self.episode(episode_state::RUNNING);
        self.set_episode(episode_state::STEP, time);
        self.remember(running);

        let view = self.view();
        let terms = core.reward(&view);
        let metrics = Writer::written(|out| core.task.metrics(&view, out)).numbers();
        let mut success = core.task.success(&view);
        let loss = core.loss(&view);
        let mut reasons = Ends::default();
        core.task.ends(&view, &mut reasons);
        let reasons = reasons.masks;
        let diverged = self.alive().lt(constant(f64::from(ALIVE) - 0.5));
        let mut reason = zero;
        for (k, holds) in reasons.iter().enumerate().rev() {
            reason = Trace::select(*holds, constant((k + 1) as f64), reason);
        }
        let reason = Trace::select(diverged, constant((reasons.len() + 1) as f64), reason);
        // in counts, which are exact up to MAX_HORIZON; shares of the time are not
        let over = time.lt(self.episode(episode_state::LAST)).not();
        let counts = running.and(diverged.not());
        let reward = Trace::select(counts, sum(&terms), zero);

        for (k, term) in terms.iter().enumerate() {
            let row = episode_state::TERMS + k;
            self.set_episode(row, self.episode(row) + Trace::select(counts, *term, zero));
        }
        self.set_episode(episode_state::RETURN, self.episode(episode_state::RETURN) + reward);
        let reason = Trace::select(running, reason, self.episode(episode_state::REASON));
        self.set_episode(episode_state::REASON, reason);
        let truncated = Trace::select(running, number(over), self.episode(episode_state::TRUNCATED));
        self.set_episode(episode_state::TRUNCATED, truncated);
        let due = time.lt(self.episode(episode_state::EVENT)).not().and(running);

        if core.sizes.hold > 0 {
            let row = core.sizes.held_row();
            let held = Trace::select(success.and(counts), self.episode(row) + Trace::one(), zero);
            self.set_episode(row, held);
            success = constant(core.sizes.hold as f64 - 0.5).lt(held);
        }
        let signals = self.work_mut(|work| work.signals);
        signals[signal::REWARD] = reward;
        // a diverged state is the rest state, which stands in for it: it is worth nothing
        signals[signal::SUCCESS] = Trace::select(diverged, zero, number(success));
        signals[signal::LOSS] = Trace::select(counts, loss, zero);
        signals[signal::DUE] = number(due);
        signals[signal::TERMINATED] = number(half.lt(reason));
        signals[signal::TRUNCATED] = truncated;
        self.work_mut(|work| work.metrics).copy_from_slice(&metrics);
        self.terms = terms;
    }

    /// What the task keeps.
    fn remember(&mut self, running: TraceMask) {
        if self.layout.kept.task_state.len() == 0 {
            return;
        }
        let view = self.view();
        let new = Writer::written(|out| self.core.task.remember(&view, out)).numbers();
        for (kept, new) in self.kept_mut(|kept| kept.task_state).iter_mut().zip(new) {
            *kept = Trace::select(running, new, *kept);
        }
    }

    /// Observations before the transforms but for what sensors read, of estimates where they are asked for, and the central state, of the
    /// truth.
    pub(crate) fn observe(&mut self) {
        let n = self.core.sizes.raw;
        let truth = self.frames.clone();
        if let Some(estimating) = self.core.estimating.as_ref().filter(|_| self.errs) {
            let off = self.kept(|kept| kept.estimate).to_vec();
            estimating.seen(&off, &mut self.frames);
        }
        for agent in 0..self.core.sizes.agent {
            let view = self.view();
            let own = Writer::written(|out| self.core.task.observe(&view, agent, out)).numbers();
            self.work_mut(|work| work.raw)[agent * n..][..own.len()].copy_from_slice(&own);
        }
        self.frames = truth;
        let view = self.view();
        let central = Writer::written(|out| self.core.task.central(&view, out)).numbers();
        self.work_mut(|work| work.central).copy_from_slice(&central);
    }

    /// What is observed of the environment as it stands.
    pub(crate) fn show(&mut self) {
        self.state.copy_from_slice(&self.numbers.plant[..self.core.plant.n_state()]);
        self.goal = self.kept(|kept| kept.goal).to_vec();
        self.move_frames();
        self.observe();
    }

    /// What sensors read, behind what the task shows.
    pub(crate) fn read(&mut self) {
        let (n, own) = (self.core.sizes.raw, self.core.sizes.reading);
        let readings = self.kept(|kept| kept.readings).to_vec();
        for agent in 0..self.core.sizes.agent {
            let row = &mut self.work_mut(|work| work.raw)[agent * n..][n - own..n];
            row.copy_from_slice(&readings[agent * own..][..own]);
        }
    }

    /// Observations as they leave.
    pub(crate) fn transform(&mut self) {
        let (pipeline, s, layout) = (&self.core.pipeline, &self.core.sizes, self.layout);
        let Numbers { kept, work, shared, .. } = &mut self.numbers;
        layout.work.common.of_mut(work)[2..].copy_from_slice(layout.kept.theta.of(kept));
        let [noise, raw, common] =
            [layout.work.noise, layout.work.raw, layout.work.common].map(|part| part.of(work).to_vec());
        for agent in 0..s.agent {
            let own = &mut layout.work.observation.of_mut(work)[agent * s.observation..][..s.observation];
            own[..s.raw].copy_from_slice(&raw[agent * s.raw..][..s.raw]);
            pipeline.run(AgentArrays {
                observation: own,
                memory: &mut layout.kept.history.of_mut(kept)[agent * pipeline.memory..][..pipeline.memory],
                seen: &mut [],
                noise: &noise[agent * s.noise..][..s.noise],
                common: &common,
                statistics: layout.shared.statistics.of(shared),
            });
        }
    }

    /// Everything between commands and transforms. Computations behind the first are one function, called.
    pub(crate) fn fly(&mut self) {
        self.keep_speeds();
        if !self.core.robot().disturbances().is_empty() {
            self.move_frames();
            self.disturb();
        }
        for k in 0..self.core.control.steps {
            if k == 0 {
                self.compute(k);
                continue;
            }
            let mut results: Vec<Trace> = self.numbers.plant.iter().chain(&self.latched).copied().collect();
            Trace::function(&mut results, |results| {
                self.compute(k);
                let all = self.numbers.plant.iter().chain(&self.latched);
                results.iter_mut().zip(all).for_each(|(result, x)| *result = *x);
            });
            let (plant, latched) = results.split_at(self.numbers.plant.len());
            self.numbers.plant.copy_from_slice(plant);
            self.latched.copy_from_slice(latched);
        }
        self.state.copy_from_slice(&self.numbers.plant[..self.core.plant.n_state()]);
        if self.contains {
            self.contain();
        }
        self.move_frames();
        self.judge();
    }

    /// Computation `k` of the controllers and the physics behind it.
    fn compute(&mut self, k: usize) {
        self.state.copy_from_slice(&self.numbers.plant[..self.core.plant.n_state()]);
        if self.core.control.needs_frames() {
            self.move_frames();
        }
        self.steer(k);
        self.physics();
    }
}
