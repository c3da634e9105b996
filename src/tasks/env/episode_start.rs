//! How an episode begins and what an event does, over recorded numbers and the draws of the host: phases of [`Step`].

use super::block::{beginning, episode_state};
use super::core::Core;
use super::draw_plan::{Plan, Planner};
use super::phases::{Numbers, Step, number};
use crate::declare::Goal;
use crate::randomise::Randomiser;
use crate::robot::Robot;
use crate::start::{Draws, EVERY_EPISODE, ONCE, Source, Start, StartOutput, StartScalar, Streams};
use crate::task::Task;
use autodiff::trace::on_constants;
use autodiff::{Mask, Scalar, Trace, TraceMask};
use base::error::{Error, Result};
use dynamics::batch::ALIVE;
use std::cell::RefCell;

/// One environment where an episode begins or a goal changes.
#[derive(Debug, Clone)]
pub(crate) struct EpisodeStart<S = f64> {
    pub state: Vec<S>,
    pub goal: Vec<S>,
    pub task_state: Vec<S>,
    pub numbers: Vec<S>,
    pub wind: [S; 3],
    /// Step of the next event.
    pub event_at: S,
}

impl<S: StartScalar> EpisodeStart<S> {
    /// At rest, with nominal numbers and nothing else.
    pub(crate) fn new(robot: &Robot, goal: usize, task_state: usize) -> Self {
        let numbers = |x: &[f64]| x.iter().map(|x| S::from(*x)).collect();
        Self {
            state: numbers(robot.rest()),
            goal: vec![S::zero(); goal],
            task_state: vec![S::zero(); task_state],
            numbers: numbers(&robot.parameters()),
            wind: [S::zero(); 3],
            event_at: S::from(f64::INFINITY),
        }
    }

    /// For a task to change.
    pub(crate) fn with<'a>(
        &'a mut self,
        robot: &'a Robot,
        source: &'a RefCell<dyn Source<S> + 'a>,
        difficulty: S,
        change: impl FnOnce(&mut Start<'_, S>),
    ) {
        let Self { state, goal, task_state, numbers, event_at, .. } = self;
        let own = StartOutput { robot, state, goal: Goal::over(goal), task_state, numbers };
        let mut start = Start::new(own, source, *event_at, difficulty);
        change(&mut start);
        *event_at = start.event_at;
    }

    /// As an episode begins: by the task, then by what is randomised; rotors hover with these numbers.
    pub(crate) fn begin(
        &mut self,
        (robot, randomiser): (&Robot, &Randomiser),
        source: &RefCell<dyn Source<S> + '_>,
        difficulty: S,
        start: impl FnOnce(&mut Start<'_, S>),
    ) {
        self.with(robot, source, difficulty, start);
        let draws = [EVERY_EPISODE, ONCE].map(|stream| Draws::new(source, stream));
        randomiser.apply(draws, difficulty, &mut self.numbers, &mut self.wind);
        randomiser.hover(robot.rest(), &self.numbers, &mut self.state);
    }

    /// All that an environment keeps of it.
    pub(crate) fn all<'a>(&'a mut self, varied: &'a [usize]) -> impl Iterator<Item = &'a mut S> {
        let Self { state, goal, task_state, numbers, wind, event_at } = self;
        let kept = state.iter_mut().chain(goal).chain(task_state).chain(wind).chain(std::iter::once(event_at));
        kept.chain(numbers.iter_mut().enumerate().filter(|(k, _)| varied.binary_search(k).is_ok()).map(|(_, x)| x))
    }
}

impl EpisodeStart {
    /// What a task calls ideal.
    pub(crate) fn ideal(task: &dyn Task, goal: usize, task_state: usize) -> Self {
        on_constants(|| {
            let mut own = EpisodeStart::<Trace>::new(task.robot(), goal, task_state);
            let source = Streams::of_start([0; 3]);
            own.with(task.robot(), &source, Trace::one(), |start| task.ideal(start));
            own.known()
        })
    }
}

impl EpisodeStart<Trace> {
    /// Of constants.
    pub(crate) fn known(&self) -> EpisodeStart {
        let known = |x: &Trace| x.known().unwrap_or(f64::NAN);
        let all = |x: &[Trace]| x.iter().map(known).collect();
        EpisodeStart {
            state: all(&self.state),
            goal: all(&self.goal),
            task_state: all(&self.task_state),
            numbers: all(&self.numbers),
            wind: self.wind.each_ref().map(known),
            event_at: known(&self.event_at),
        }
    }
}

/// What the host draws where an episode begins and in an event.
#[derive(Debug, Clone, Default)]
pub(crate) struct Plans {
    pub start: Plan,
    pub event: Plan,
    /// Most draws of either; of a task that begins on the host, the numbers of a draft.
    pub n_draw: usize,
}

impl Plans {
    /// Of a task.
    ///
    /// # Errors
    /// As [`Plan::checked_event`].
    pub(crate) fn of(
        task: &dyn Task,
        randomiser: &Randomiser,
        varied: &[usize],
        [goal, task_state]: [usize; 2],
    ) -> Result<Self> {
        let robot = task.robot();
        if task.start_on_host().is_some() {
            let n_draw = EpisodeStart::<f64>::new(robot, goal, task_state).all(varied).count();
            return Ok(Self { n_draw, ..Self::default() });
        }
        on_constants(|| {
            let mut draft = EpisodeStart::new(robot, goal, task_state);
            let source = RefCell::new(Planner::new(None));
            draft.begin((robot, randomiser), &source, Trace::one(), |start| task.start(start));
            let start = source.into_inner().plan.checked("start")?;
            let source = RefCell::new(Planner::new(None));
            draft.with(robot, &source, Trace::one(), |start| task.event(start));
            let event = source.into_inner().plan.checked_event()?;
            let n_draw = start.draws.len().max(event.draws.len());
            Ok(Self { start, event, n_draw })
        })
    }
}

/// The step of an event as it is kept: finite ones below this, which stands for never.
const NEVER: f64 = f32::MAX as f64;

impl Step<'_> {
    fn beginning(&self, row: usize) -> Trace {
        self.work(|work| work.beginning)[row]
    }

    /// What begins: recorded by `record`, or as the host wrote it; true where it is written.
    fn drafted(
        &mut self,
        mut draft: EpisodeStart<Trace>,
        (what, plan): (&str, &Plan),
        record: impl FnOnce(&mut EpisodeStart<Trace>, &RefCell<dyn Source<Trace> + '_>),
    ) -> (EpisodeStart<Trace>, TraceMask) {
        let core = self.core;
        let rows = self.work(|work| work.draws).to_vec();
        let which = self.beginning(beginning::WHERE);
        if core.task.start_on_host().is_some() {
            draft.all(&core.varied).zip(rows).for_each(|(x, row)| *x = row);
            return (draft, which.gt(0.5));
        }
        let source = RefCell::new(Planner::new(Some(rows)));
        record(&mut draft, &source);
        let Planner { plan: own, accepted, .. } = source.into_inner();
        if own != *plan {
            let remedy = "A task is asked several times: let it depend on its settings alone.";
            self.fault =
                Some(Error::value(format!("draws of the {what}"), "others", "those of the first time", remedy));
        }
        self.fault = self.fault.take().or_else(|| core.refused(what, &draft));
        draft.goal.resize(core.sizes.goal, Trace::zero());
        self.work_mut(|work| work.beginning)[beginning::ACCEPTED] = number(accepted);
        (draft, which.gt(1.5).or(which.gt(0.5).and(accepted)))
    }

    /// Begins episodes, and tells whether they may have events. What is drawn in whole numbers of steps (offset, delay, last step) the
    /// host writes, and what is long and zero.
    pub(crate) fn begin(&mut self) -> bool {
        let (core, sizes) = (self.core, &self.core.sizes);
        let (robot, difficulty) = (core.robot(), self.beginning(beginning::DIFFICULTY));
        let blank = EpisodeStart::new(robot, sizes.goal, sizes.task_state);
        let (draft, mask) = self.drafted(blank, ("start", &core.plans.start), |draft, source| {
            draft.begin((robot, &core.randomiser), source, difficulty, |start| core.task.start(start));
        });

        let before = self.numbers.clone();
        let plant = &mut self.numbers.plant;
        plant[..draft.state.len()].copy_from_slice(&draft.state);
        plant[core.plant.alive_row()] = Trace::constant(f64::from(ALIVE));
        let of_host = [episode_state::OFFSET, episode_state::LAST, episode_state::DELAY];
        for (row, number) in self.kept_mut(|kept| kept.episode_state).iter_mut().enumerate() {
            if !of_host.contains(&row) {
                *number = Trace::zero();
            }
        }
        self.set_episode(episode_state::RUNNING, Trace::one());
        for (k, command) in self.kept_mut(|kept| kept.line).iter_mut().enumerate() {
            *command = Trace::constant(core.control.safe[k % core.control.safe.len()]);
        }
        self.kept_mut(|kept| kept.air).iter_mut().zip(draft.wind).for_each(|(row, wind)| *row = wind);
        self.keep_speeds();
        self.keep(&draft, (-NEVER).into());
        self.vary(&draft.numbers);
        self.numbers.choose(mask, &before);
        draft.event_at.known().is_none_or(f64::is_finite)
    }

    /// Does what an event does.
    pub(crate) fn event(&mut self) {
        let core = self.core;
        let (difficulty, step) = (self.beginning(beginning::DIFFICULTY), self.episode(episode_state::STEP));
        let mut now = EpisodeStart::new(core.robot(), 0, 0);
        now.state.copy_from_slice(&self.numbers.plant[..core.plant.n_state()]);
        now.goal = self.kept(|kept| kept.goal).to_vec();
        now.task_state = self.kept(|kept| kept.task_state).to_vec();
        for (k, theta) in core.varied.iter().zip(self.kept(|kept| kept.theta)) {
            now.numbers[*k] = *theta;
        }
        // the step count, for tasks that say when the next one comes
        now.event_at = step;
        let (draft, mask) = self.drafted(now, ("event", &core.plans.event), |draft, source| {
            draft.with(core.robot(), source, difficulty, |start| core.task.event(start));
        });

        let before = self.numbers.clone();
        // numbers that the task left keep their bits, and so does what follows from them
        let theta = core.layout.kept.theta.of(&before.kept);
        let pairs = core.varied.iter().map(|k| draft.numbers[*k]).zip(theta).filter(|(new, old)| !new.is(**old));
        if let Some(changed) = pairs.map(|(new, old)| new.lt(*old).or(old.lt(new))).reduce(Mask::or) {
            self.vary(&draft.numbers);
            self.numbers.choose(changed, &before);
        }
        self.keep(&draft, step);
        self.numbers.choose(mask, &before);
    }

    /// Keeps what starts and events change: the next event behind step `now`, goal, task state.
    fn keep(&mut self, draft: &EpisodeStart<Trace>, now: Trace) {
        let next = draft.event_at;
        let comes = next.lt(NEVER).and(now.lt(next));
        self.set_episode(episode_state::EVENT, Trace::select(comes, next, NEVER.into()));
        self.kept_mut(|kept| kept.goal).copy_from_slice(&draft.goal);
        self.kept_mut(|kept| kept.task_state).copy_from_slice(&draft.task_state);
    }

    /// Keeps the numbers that vary, and those of the model that follow from them.
    fn vary(&mut self, numbers: &[Trace]) {
        let core = self.core;
        if core.varied.is_empty() {
            return;
        }
        for (row, k) in self.kept_mut(|kept| kept.theta).iter_mut().zip(&core.varied) {
            *row = numbers[*k];
        }
        let model = core.plant.numbers_of(numbers);
        core.varying.iter().for_each(|k| self.numbers.model[*k] = model[*k]);
    }
}

impl Core {
    /// Why a start or an event cannot be: a goal of another length, a number that does not vary.
    fn refused(&self, what: &str, draft: &EpisodeStart<Trace>) -> Option<Error> {
        if draft.goal.len() != self.sizes.goal {
            let (own, limit) = (draft.goal.len(), format!("{}, as of the ideal", self.sizes.goal));
            let remedy = "Write as many always; events change goals by place.";
            return Some(Error::value(format!("numbers of the goal in the {what}"), own, limit, remedy));
        }
        let changed = |k: usize, nominal: f64| {
            // constants are those of f32
            let is_nominal = |x: f64| (x - nominal).abs() <= 1e-6 * nominal.abs();
            !draft.numbers[k].known().is_some_and(is_nominal) && self.varied.binary_search(&k).is_err()
        };
        let changed = self.nominal.iter().enumerate().find(|(k, nominal)| changed(*k, **nominal))?;
        let name = &self.robot().parameter_names()[changed.0];
        let remedy = "Name it in Robot::varying, or leave it.";
        Some(Error::value(format!("the number {name} in the {what}"), "another one", "one that varies", remedy))
    }
}

impl Numbers {
    /// What was before where the mask does not hold.
    fn choose(&mut self, mask: TraceMask, before: &Self) {
        let Self { plant, kept, work, model, .. } = self;
        for (new, old) in [(plant, &before.plant), (kept, &before.kept), (work, &before.work), (model, &before.model)] {
            for (new, old) in new.iter_mut().zip(old).filter(|(new, old)| !new.is(**old)) {
                *new = Trace::select(mask, *new, *old);
            }
        }
    }
}
