//! What a task says about itself: it writes everything once, in its ideal state.

use super::declare::{Ends, Goal, Loss, Writer};
use super::env::episode_start::EpisodeStart;
use super::robot::Robot;
use super::settings::{Setting, filled};
use super::start::{Start, StartOutput, StartScalar, Streams};
use super::task::{Task, View};
use super::task_spec::{Field, Metric, TaskSpec, Term, total};
use autodiff::trace::on_constants;
use autodiff::{Scalar, Trace};
use base::error::{Error, Result};
use dynamics::Plant;
use dynamics::frame::FRAME;

/// The numbers of a view of one environment.
pub(crate) struct Snapshot<S> {
    pub state: Vec<S>,
    pub frames: Vec<S>,
    pub speeds: Vec<S>,
    pub goal: Vec<S>,
    pub task_state: Vec<S>,
}

impl Snapshot<f64> {
    /// Where an episode begins so.
    pub(crate) fn of(
        robot: &Robot,
        plant: &Plant,
        numbers: &[f64],
        state: &[f64],
        goal: &[f64],
        task_state: Vec<f64>,
    ) -> Self {
        let mut frames = vec![0.0; robot.n_frame() * FRAME];
        plant.write_frames(numbers, state, &mut frames);
        let rotors = robot.drones().iter().flat_map(|d| &d.rotors);
        let speeds = rotors.map(|r| state[r.speed]).collect();
        Self { state: state.to_vec(), frames, speeds, goal: goal.to_vec(), task_state }
    }

    /// As constants of a recording.
    fn recorded(&self) -> Snapshot<Trace> {
        let constants = |x: &[f64]| x.iter().map(|x| Trace::constant(*x)).collect();
        Snapshot {
            state: constants(&self.state),
            frames: constants(&self.frames),
            speeds: constants(&self.speeds),
            goal: constants(&self.goal),
            task_state: constants(&self.task_state),
        }
    }

    /// What `ask` makes of the view as constants.
    pub(crate) fn ask<R>(&self, robot: &Robot, ask: impl FnOnce(&View<'_, Trace>) -> R) -> R {
        on_constants(|| ask(&self.recorded().view(robot)))
    }
}

impl<S: Scalar> Snapshot<S> {
    /// In the first step.
    pub(crate) fn view<'a>(&'a self, robot: &'a Robot) -> View<'a, S> {
        View {
            robot,
            state: &self.state[..],
            frames: &self.frames[..],
            speeds_before: &self.speeds[..],
            goal: &self.goal[..],
            task_state: &self.task_state[..],
            step: S::zero(),
            clock: S::zero(),
        }
    }
}

/// Most numbers that a task keeps from step to step.
pub(crate) const MAX_TASK_STATE: usize = 256;

/// How a task begins an episode, and the names in its goal.
fn named_draft<S: StartScalar>(robot: &Robot, begin: impl FnOnce(&mut Start<'_, S>)) -> (EpisodeStart<S>, Vec<Field>) {
    let mut draft = EpisodeStart::new(robot, 0, MAX_TASK_STATE);
    let source = Streams::of_start([0; 3]);
    let EpisodeStart { state, numbers, goal, task_state, event_at, .. } = &mut draft;
    let own = StartOutput { robot, state, goal: Goal::named(goal), task_state, numbers };
    let mut start = Start::new(own, &source, *event_at, S::one());
    begin(&mut start);
    let fields = start.goal.fields();
    (draft, fields)
}

/// As recorded.
fn recorded(robot: &Robot, begin: impl FnOnce(&mut Start<'_>)) -> (EpisodeStart, Vec<Field>) {
    on_constants(|| {
        let (draft, fields) = named_draft(robot, begin);
        (draft.known(), fields)
    })
}

/// Lets a task write everything once, in its ideal state, and keeps what it said.
///
/// # Errors
/// [`Error::Value`] for numbers without a name or under a name twice, for a summand or figure of more than one number, for
/// goals that starts and the ideal write differently, for a success by a figure that is none; [`Error::Limit`] above
/// [`MAX_TASK_STATE`].
pub(crate) fn declare(task: &dyn Task) -> Result<TaskSpec> {
    let robot = task.robot();
    let started = match task.start_on_host() {
        Some(host) => named_draft(robot, |start| host.start(start)).1,
        None => recorded(robot, |start| task.start(start)).1,
    };
    let (ideal, fields) = recorded(robot, |start| task.ideal(start));
    if started != fields {
        let names =
            |fields: &[Field]| fields.iter().map(|f| format!("{} ({})", f.name, f.size)).collect::<Vec<_>>().join(", ");
        let (own, other) = (names(&started), names(&fields));
        return Err(Error::value("goal of a start", own, format!("that of the ideal: {other}"), "Write both alike."));
    }
    let EpisodeStart { state, numbers, goal, .. } = ideal;
    let with = |n: usize| Snapshot::of(robot, robot.plant(), &numbers, &state, &goal, vec![0.0; n]);
    let n_kept = |n| with(n).ask(robot, |view| Writer::written(|out| task.remember(view, out)).numbers().len());
    let n = n_task_state(n_kept)?;
    with(n).ask(robot, |view| declared(task, view, fields))
}

/// How many numbers a task keeps, where it keeps `n_kept` if it is shown so many.
///
/// # Errors
/// [`Error::Limit`] above [`MAX_TASK_STATE`]; [`Error::Value`] where it keeps others of fewer.
pub(crate) fn n_task_state(n_kept: impl Fn(usize) -> usize) -> Result<usize> {
    let n = n_kept(MAX_TASK_STATE);
    if n > MAX_TASK_STATE {
        return Err(Error::limit("numbers of the task state", n, MAX_TASK_STATE, "Keep fewer."));
    }
    if n_kept(n) != n {
        let limit = format!("{n}, whatever the view shows of them");
        return Err(Error::value("numbers of the task state", n_kept(n), limit, "Keep equally many in every step."));
    }
    Ok(n)
}

fn declared(task: &dyn Task, view: &View<'_, Trace>, goal: Vec<Field>) -> Result<TaskSpec> {
    let settings = task.settings();
    let list = |what: &str, write: &dyn Fn(&mut Writer)| named(what, Writer::written(write).fields(), &settings);
    let kept = list("task state", &|out| task.remember(view, out))?;
    let metrics = single("figure", list("figure", &|out| task.metrics(view, out))?)?;
    let metrics: Vec<Metric> = metrics.into_iter().map(|f| Metric { name: f.name, unit: f.unit }).collect();
    let term =
        |f: Field| Term { name: f.name, formula: f.meaning, low: f.low, bound: f.high, smoothness: f.smoothness };
    let reward = single("summand of the reward", list("summand of the reward", &|out| task.reward(view, out))?)?;
    let (mut ends, mut loss) = (Ends::default(), Loss::default());
    task.ends(view, &mut ends);
    task.loss(view, &mut loss);
    let (mut ends, mut loss) = (ends.ends, loss.formulas);
    ends.iter_mut().for_each(|end| end.condition = filled(&end.condition, &settings));
    loss.iter_mut().for_each(|formula| *formula = filled(formula, &settings));
    let mut success = task.success_rule();
    success.also = filled(&success.also, &settings);
    for limit in &mut success.limits {
        let metric = metrics.iter().find(|m| m.name == limit.metric).ok_or_else(|| Error::Unknown {
            kind: "figure of the task",
            name: limit.metric.clone(),
            known: metrics.iter().map(|m| m.name.clone()).collect(),
        })?;
        limit.unit.clone_from(&metric.unit);
    }
    let seen = (0..task.n_agent().max(1)).map(|agent| list("observation", &|out| task.observe(view, agent, out)));
    let seen = seen.collect::<Result<Vec<_>>>()?;
    let observation_of: Vec<usize> = seen.iter().map(|fields| total(fields)).collect();
    let widest = observation_of.iter().copied().fold(0, usize::max);
    let observation = seen.into_iter().find(|fields| total(fields) == widest).unwrap_or_default();
    Ok(TaskSpec {
        about: filled(task.about(), &settings),
        observation,
        observation_of,
        central: list("central state", &|out| task.central(view, out))?,
        reward: reward.into_iter().map(term).collect(),
        ends,
        metrics,
        success,
        loss,
        goal: named("goal", goal, &settings)?,
        task_state: kept,
        settings,
    })
}

/// Fields with the values of settings in their meanings, each with a name of its own.
fn named(what: &str, mut fields: Vec<Field>, settings: &[Setting]) -> Result<Vec<Field>> {
    for i in 0..fields.len() {
        let name = &fields[i].name;
        if name.is_empty() || fields[..i].iter().any(|f| f.name == *name) {
            let remedy = "Call field(name, unit, meaning) before its numbers, once.";
            return Err(Error::value(format!("name of a {what}"), format!("'{name}'"), "one of its own", remedy));
        }
        let Field { name, size, layout, .. } = &fields[i];
        let shape = layout.shape(*size);
        if shape.iter().try_fold(1_usize, |n, own| n.checked_mul(*own)) != Some(*size) {
            let (what, limit) = (format!("shape of {what} '{name}'"), format!("of its {size} numbers"));
            return Err(Error::value(what, format!("{shape:?}"), limit, "Write as many numbers as the shape has."));
        }
        fields[i].meaning = filled(&fields[i].meaning, settings);
    }
    Ok(fields)
}

/// Refuses fields of more than one number.
fn single(what: &str, fields: Vec<Field>) -> Result<Vec<Field>> {
    match fields.iter().find(|f| f.size != 1) {
        None => Ok(fields),
        Some(f) => Err(Error::value(format!("numbers of {what} '{}'", f.name), f.size, "1", "Name each number.")),
    }
}
