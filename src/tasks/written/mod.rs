//! Tasks as data: asked once for everything, and from then on a recording of each phase.
//!
//! Any [`Task`] can be written down; what flies by the record has the bits of the task itself, since the same operations are recorded
//! again into every program. So a task in another language is called once, and a run is evaluated where that language is not.
//!
//! | file | what |
//! |---|---|
//! | `mod` | [`TaskRecord`], and the task that it is |
//! | `phase` | what is said of a view |
//! | `start`, `host` | how episodes begin, what events do; on the host |
//! | `robot` | what flies |
//! | `file` | records as bytes, checked when they are read |
//! | `source` | records as tasks of the registry |

mod file;
mod host;
mod phase;
mod robot;
mod source;
mod start;
#[cfg(test)]
mod tests;

#[doc(hidden)]
pub use file::{MOST_AGAIN, operation};
pub use phase::{PhaseRecord, ViewSizes};
pub use robot::RobotSource;
pub use source::{keep_record, record_of, register_record};
pub use start::{PadParts, StartPad, StartRecord};

use self::host::HostProgram;
use self::phase::Answer;
use super::any_task::{MAX_TASK_STATE, n_task_state};
use super::config::EnvConfig;
use super::declare::{Ends, Loss, Writer};
use super::env::draw_plan::of_host;
use super::env::spec::fnv;
use super::registry::{self, TaskEntry};
use super::robot::Robot;
use super::settings::Setting;
use super::start::Start;
use super::task::{HostStart, Task, TaskReference, View};
use super::task_spec::Success;
use autodiff::{Recording, Scalar, Trace, TraceMask};
use base::error::{Error, Result};
use controllers::reference::{Reference, Tilt};
use dynamics::scene::Scene;
use serde::Deserialize;
use std::cell::Cell;
use std::sync::{Arc, OnceLock};

/// What a task is beside its phases.
#[derive(Debug, Clone)]
pub enum Base {
    /// A task of the registry, whose other phases stay as they are.
    Task(String),
    /// Nothing: all phases are written down.
    Own(Box<OwnTask>),
}

/// Whatever of a task is no computation.
#[derive(Debug, Clone, PartialEq)]
pub struct OwnTask {
    /// What flies.
    pub robot: RobotSource,
    /// Of [`robot`](Self::robot): which of its physical numbers differ between environments.
    pub varied: Vec<usize>,
    /// [`Task::about`].
    pub about: String,
    /// [`Task::horizon`].
    pub horizon: usize,
    /// [`Task::settings`], with the values that it was written down with.
    pub settings: Vec<Setting>,
    /// [`Task::success_rule`].
    pub success_rule: Success,
    /// [`Task::scene`].
    pub scene: Scene,
}

/// Phases that are written down; of the others the base has its own.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Phases {
    start: Option<StartRecord>,
    event: Option<StartRecord>,
    ideal: Option<StartRecord>,
    disturb: Option<Vec<PhaseRecord>>,
    remember: Option<PhaseRecord>,
    observe: Option<Vec<PhaseRecord>>,
    central: Option<PhaseRecord>,
    reward: Option<PhaseRecord>,
    ends: Option<PhaseRecord>,
    metrics: Option<PhaseRecord>,
    success: Option<PhaseRecord>,
    loss: Option<PhaseRecord>,
    place_scene: Option<Arc<Recording>>,
    reference: Option<ReferenceRecord>,
    /// Whether episodes begin in plain numbers, one environment after the other.
    on_host: bool,
}

/// What controllers track, as numbers of a view in the places of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceRecord {
    phase: PhaseRecord,
    /// In JSON, where `{"number": k}` stands for result k.
    template: serde_json::Value,
}

/// A task as data.
#[derive(Debug, Clone)]
pub struct TaskRecord {
    /// What users type.
    pub name: String,
    /// One line for tables.
    pub description: String,
    /// Its own defaults, as TOML of an [`EnvConfig`].
    pub defaults: toml::Table,
    base: Base,
    sizes: ViewSizes,
    /// See [`shown`].
    shown: u64,
    phases: Phases,
    id: OnceLock<String>,
}

/// All phases, by name.
pub const PHASES: [&str; 12] = [
    "start", "event", "ideal", "disturb", "remember", "observe", "central", "reward", "ends", "metrics", "success",
    "loss",
];

/// Who writes a task down: the task itself, and what tasks in Rust compute in plain numbers.
pub trait TaskAuthor {
    /// What speaks against it.
    type Fault: From<Error>;

    /// What is asked.
    fn task(&self) -> &dyn Task;

    /// Whether a phase is to be written down.
    fn writes(&self, phase: &str) -> bool {
        PHASES.contains(&phase)
    }

    /// Writes a start, an event or the ideal, by name.
    fn begin(&self, phase: &str, mut pad: StartPad) -> StartPad {
        let task = self.task();
        pad.with(task.robot(), |start| match phase {
            "start" => task.start(start),
            "event" => task.event(start),
            _ => task.ideal(start),
        });
        pad
    }

    /// Where the last phase failed, why.
    fn fault(&self) -> Option<Self::Fault> {
        None
    }

    /// [`Task::place_scene`].
    fn place_scene(&self, _goal: &[Trace], _placement: &mut [Trace]) -> bool {
        false
    }

    /// [`Task::reference`]: a table in JSON, of which some numbers, `{"number": k}`, are those of the view.
    fn reference(&self, _view: &View) -> Option<(serde_json::Value, Vec<Trace>)> {
        None
    }

    /// Whether episodes begin in plain numbers.
    fn starts_on_host(&self) -> bool {
        false
    }
}

impl TaskRecord {
    /// Asks for every phase, once.
    ///
    /// # Errors
    /// Those of the author; [`Error::Value`] for a part that is drawn again twice.
    pub fn of<A: TaskAuthor>(
        author: &A,
        name: &str,
        base: Base,
        config: &EnvConfig,
    ) -> std::result::Result<Self, A::Fault> {
        let task = author.task();
        let robot = task.robot();
        let asked = |what: &str| author.writes(what);
        let checked = || author.fault().map_or(Ok(()), Err);
        let mut phases = Phases { on_host: author.starts_on_host(), ..Phases::default() };
        let blank = ViewSizes::of(robot, task.n_agent(), 0, MAX_TASK_STATE);
        // the ideal goal has all numbers that goals have
        let ideal = StartRecord::of(&blank, 0, |pad| author.begin("ideal", pad))?;
        checked()?;
        let n_goal = ideal.n_goal(&blank);
        let n_kept = |n: usize| {
            let sizes = ViewSizes { goal: n_goal, task_state: n, ..blank };
            PhaseRecord::of(&sizes, robot, |view| written(|out| task.remember(view, out)))
        };
        let n_task_state = n_task_state(|n| n_kept(n).recording.n_output());
        checked()?;
        let n_task_state = n_task_state?;
        let sizes = ViewSizes { goal: n_goal, task_state: n_task_state, ..blank };
        let phase = |ask: &dyn Fn(&View) -> Answer| {
            let phase = PhaseRecord::of(&sizes, robot, ask);
            checked().map(|()| phase)
        };
        let begin = |phase: &str, n_goal: usize| -> std::result::Result<StartRecord, A::Fault> {
            let start = StartRecord::of(&sizes, n_goal, |pad| author.begin(phase, pad))?;
            checked()?;
            let n = start.n_goal(&sizes);
            if n != sizes.goal {
                let remedy = "Write as many always; events change goals by place.";
                let limit = format!("{}, as of the ideal", sizes.goal);
                return Err(Error::value(format!("numbers of the goal in the {phase}"), n, limit, remedy).into());
            }
            checked()?;
            if start.is_of_host() && !author.starts_on_host() && ["start", "event"].contains(&phase) {
                return Err(of_host(phase).into());
            }
            Ok(start)
        };
        let host = task.start_on_host().is_some();
        if asked("start") && !host {
            phases.start = Some(begin("start", 0)?);
        }
        if asked("event") && !host {
            phases.event = Some(begin("event", n_goal)?);
        }
        if asked("ideal") {
            phases.ideal = Some(begin("ideal", 0)?);
        }
        if asked("remember") {
            phases.remember = Some(phase(&|view| written(|out| task.remember(view, out)))?);
        }
        if asked("disturb") {
            let of = |tree| phase(&|view| Answer { numbers: task.disturb(view, tree).to_vec(), ..Answer::default() });
            phases.disturb = Some((0..sizes.trees).map(of).collect::<std::result::Result<_, _>>()?);
        }
        if asked("observe") {
            let of = |agent| phase(&|view| written(|out| task.observe(view, agent, out)));
            phases.observe = Some((0..sizes.agents).map(of).collect::<std::result::Result<_, _>>()?);
        }
        if asked("central") {
            phases.central = Some(phase(&|view| written(|out| task.central(view, out)))?);
        }
        if asked("reward") {
            phases.reward = Some(phase(&|view| written(|out| task.reward(view, out)))?);
        }
        if asked("ends") {
            phases.ends = Some(phase(&|view| {
                let mut own = Ends::default();
                task.ends(view, &mut own);
                let words = own.ends.into_iter().map(|end| [end.name, end.condition]).collect();
                Answer {
                    numbers: own.masks.into_iter().map(TraceMask::as_number).collect(),
                    words,
                    ..Answer::default()
                }
            })?);
        }
        if asked("metrics") {
            phases.metrics = Some(phase(&|view| written(|out| task.metrics(view, out)))?);
        }
        if asked("success") {
            let success = |view: &View| vec![task.success(view).as_number()];
            phases.success = Some(phase(&|view| Answer { numbers: success(view), ..Answer::default() })?);
        }
        if asked("loss") {
            phases.loss = Some(phase(&|view| {
                let mut own = Loss::default();
                task.loss(view, &mut own);
                let words = own.formulas.into_iter().map(|formula| [formula, String::new()]).collect();
                Answer { numbers: own.summands, words, ..Answer::default() }
            })?);
        }
        let template = Cell::new(None);
        let reference = phase(&|view| {
            let (own, numbers) = author.reference(view).unzip();
            template.set(own);
            Answer { numbers: numbers.unwrap_or_default(), ..Answer::default() }
        })?;
        phases.reference = template.take().map(|template| ReferenceRecord { phase: reference, template });
        let n_placement = task.scene().n_placement();
        let mut moves = false;
        let place_scene = Recording::as_written(n_goal, |goal| {
            let mut placement = vec![Trace::zero(); n_placement];
            moves = author.place_scene(goal, &mut placement);
            placement
        });
        checked()?;
        phases.place_scene = moves.then(|| Arc::new(place_scene));
        let (name, description) = (name.to_string(), String::new());
        let (defaults, shown) = (toml::Table::new(), shown(robot, config));
        Ok(Self { name, description, defaults, base, sizes, shown, phases, id: OnceLock::new() })
    }

    /// What it is, in sixteen hexadecimal digits: those of records that differ in a byte differ.
    ///
    /// # Errors
    /// As [`TaskRecord::to_bytes`].
    pub fn id(&self) -> Result<&str> {
        if let Some(id) = self.id.get() {
            return Ok(id);
        }
        let id = format!("{:016x}", fnv(&self.to_bytes()?));
        Ok(self.id.get_or_init(|| id))
    }

    /// Keys of the task's settings.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a base that is not there.
    pub fn setting_keys(&self) -> Result<Vec<String>> {
        match &self.base {
            Base::Task(name) => in_rust(name)?.setting_keys(),
            Base::Own(own) => Ok(own.settings.iter().map(|own| own.key.clone()).collect()),
        }
    }

    /// The task, with what flies made from a configuration.
    ///
    /// # Errors
    /// [`Error::Value`] for settings that it was not written down with, and for something else that flies.
    pub fn task(self: &Arc<Self>, config: &EnvConfig) -> Result<WrittenTask> {
        let base: Box<dyn Task> = match &self.base {
            Base::Task(name) => in_rust(name)?.task(&EnvConfig { task_record: String::new(), ..config.clone() })?,
            Base::Own(own) => {
                own.check_settings(&self.name, config)?;
                let robot = own.robot.robot(config)?;
                let (n, limit) = (robot.parameters().len(), own.varied.iter().max().copied().unwrap_or(0));
                if limit >= n {
                    return Err(Error::limit(
                        "physical number that varies",
                        limit,
                        n.saturating_sub(1),
                        "Name another.",
                    ));
                }
                Box::new(OwnBase { own: own.clone(), robot: robot.varying(own.varied.iter().copied()) })
            }
        };
        self.sizes.check(base.robot(), base.n_agent())?;
        let shown = shown(base.robot(), config);
        if shown != self.shown {
            let told = format!("other numbers, or another step than {} s", config.dt);
            let limit = format!("those that {} was written down with", self.name);
            let remedy = "Write it down anew with what flies: its numbers are constants of what was recorded.";
            return Err(Error::value("what flies", told, limit, remedy));
        }
        let task = WrittenTask { record: self.clone(), base, start: OnceLock::new(), event: OnceLock::new() };
        if matches!(self.base, Base::Task(_)) {
            let blank = StartRecord::of(&self.sizes_of_base(&task), 0, |mut pad| {
                pad.with(task.base.robot(), |start| task.base.ideal(start));
                pad
            })?;
            let goal = blank.n_goal(&self.sizes_of_base(&task));
            let kept = |n| {
                let sizes = ViewSizes { goal, task_state: n, ..self.sizes };
                PhaseRecord::of(&sizes, task.base.robot(), |view| written(|out| task.base.remember(view, out)))
                    .recording
                    .n_output()
            };
            let own = self.phases.ideal.as_ref().map_or(goal, |own| own.n_goal(&self.sizes));
            let kept = if self.phases.remember.is_some() { self.sizes.task_state } else { n_task_state(kept)? };
            if own != self.sizes.goal || kept != self.sizes.task_state {
                let told = format!("{own} and {kept}");
                let limit = format!("{} and {}, as written down", self.sizes.goal, self.sizes.task_state);
                return Err(Error::value(
                    "numbers of the goal and of the task state",
                    told,
                    limit,
                    "Write it down anew.",
                ));
            }
        }
        Ok(task)
    }

    fn sizes_of_base(&self, task: &WrittenTask) -> ViewSizes {
        ViewSizes::of(task.base.robot(), task.base.n_agent(), 0, MAX_TASK_STATE)
    }
}

/// A task that is one of Rust: what records build on.
fn in_rust(name: &str) -> Result<&'static TaskEntry> {
    let entry = registry::by_name(name)?;
    if entry.is_in_rust() {
        return Ok(entry);
    }
    let limit = "one of the library, or registered in Rust";
    Err(Error::value("the task that a record builds on", name, limit, "Write all of it down."))
}

/// What of things that fly, and of time, a task that is written down may have made constants of.
fn shown(robot: &Robot, config: &EnvConfig) -> u64 {
    // the last digits may differ between machines
    let numbers = robot.parameters().into_iter().chain(robot.rest().iter().copied()).chain([config.dt]);
    let speeds = robot.drones().iter().flat_map(|drone| drone.rotors.iter().map(|rotor| rotor.max_speed));
    let text = numbers.chain(speeds).map(|x| format!("{x:.9e} ")).collect::<String>();
    fnv(text.as_bytes())
}

impl OwnTask {
    /// Refuses other settings than those that phases were written down with.
    fn check_settings(&self, name: &str, config: &EnvConfig) -> Result<()> {
        let known = || self.settings.iter().map(|own| own.key.clone()).collect::<Vec<_>>();
        if let Some(key) = config.task.keys().find(|key| self.settings.iter().all(|own| own.key != **key)) {
            return Err(Error::unknown_key("[task]", key, &known()));
        }
        for own in &self.settings {
            let value = config.task.get(&own.key).unwrap_or(&own.default);
            if !is_same(&own.value, value) {
                let limit = format!("{}, with which {name} was written down", own.value);
                let remedy = "Make it anew where it is written: its numbers are constants of what was recorded.";
                return Err(Error::value(format!("task.{}", own.key), value, limit, remedy));
            }
        }
        Ok(())
    }
}

/// Whether values are alike, whole numbers and others too.
fn is_same(a: &toml::Value, b: &toml::Value) -> bool {
    let number = |x: &toml::Value| x.as_float().or(x.as_integer().map(|x| x as f64));
    match (a, b) {
        (toml::Value::Array(a), toml::Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same(a, b))
        }
        _ => a == b || number(a).is_some_and(|x| number(b) == Some(x)),
    }
}

/// A task of which nothing is left but what is no computation.
struct OwnBase {
    own: Box<OwnTask>,
    robot: Robot,
}

impl Task for OwnBase {
    fn robot(&self) -> &Robot {
        &self.robot
    }
    fn horizon(&self) -> usize {
        self.own.horizon
    }
    fn settings(&self) -> Vec<Setting> {
        self.own.settings.clone()
    }
    fn about(&self) -> &str {
        &self.own.about
    }
    fn scene(&self) -> Scene {
        self.own.scene.clone()
    }
    fn start(&self, _: &mut Start<'_>) {}
    fn observe(&self, _: &View, _: usize, _: &mut Writer) {}
    fn reward(&self, _: &View, _: &mut Writer) {}
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, _: &View) -> TraceMask {
        Trace::one().lt(Trace::zero())
    }
    fn success_rule(&self) -> Success {
        self.own.success_rule.clone()
    }
    fn ideal(&self, _: &mut Start<'_>) {}
}

/// A task of a record.
pub struct WrittenTask {
    record: Arc<TaskRecord>,
    base: Box<dyn Task>,
    /// Compiled when they are first asked for.
    start: OnceLock<Option<HostProgram>>,
    event: OnceLock<Option<HostProgram>>,
}

/// The phase of a record, or that of the base.
macro_rules! phase_or_base {
    ($own:ident.$phase:ident($($argument:expr),*), $record:ident => $written:expr) => {
        match &$own.record.phases.$phase {
            Some($record) => $written,
            None => $own.base.$phase($($argument),*),
        }
    };
}

impl WrittenTask {
    fn sizes(&self) -> &ViewSizes {
        &self.record.sizes
    }

    /// Does a start or an event on the host.
    fn play(&self, program: &OnceLock<Option<HostProgram>>, record: Option<&StartRecord>, start: &mut Start<'_, f64>) {
        let Some(record) = record else { return };
        match program.get_or_init(|| HostProgram::of(record).ok()) {
            Some(program) => program.play(record, self.sizes(), start),
            None => record.play(self.sizes(), start),
        }
    }

    /// Writes what a phase wrote.
    fn write(&self, phase: &PhaseRecord, view: &View, out: &mut Writer) {
        out.write(&phase.fields, phase.numbers(self.sizes(), view));
    }
}

impl HostStart for WrittenTask {
    fn start(&self, start: &mut Start<'_, f64>) {
        self.play(&self.start, self.record.phases.start.as_ref(), start);
    }
    fn event(&self, start: &mut Start<'_, f64>) {
        self.play(&self.event, self.record.phases.event.as_ref(), start);
    }
}

impl Task for WrittenTask {
    fn robot(&self) -> &Robot {
        self.base.robot()
    }
    fn horizon(&self) -> usize {
        self.base.horizon()
    }
    fn n_agent(&self) -> usize {
        self.base.n_agent()
    }
    fn settings(&self) -> Vec<Setting> {
        self.base.settings()
    }
    fn about(&self) -> &str {
        self.base.about()
    }
    fn scene(&self) -> Scene {
        self.base.scene()
    }
    fn place_scene(&self, goal: &[f64], placement: &mut [f64]) {
        phase_or_base!(self.place_scene(goal, placement), own => own.evaluate(goal, placement));
    }
    fn start(&self, start: &mut Start<'_>) {
        phase_or_base!(self.start(start), own => own.play(self.sizes(), start));
    }
    fn event(&self, start: &mut Start<'_>) {
        phase_or_base!(self.event(start), own => own.play(self.sizes(), start));
    }
    fn start_on_host(&self) -> Option<&dyn HostStart> {
        match &self.record.phases.start {
            Some(_) => self.record.phases.on_host.then_some(self),
            None => self.base.start_on_host(),
        }
    }
    fn disturb(&self, view: &View, tree: usize) -> [Trace; 9] {
        phase_or_base!(self.disturb(view, tree), own => match own.get(tree) {
            None => [Trace::zero(); 9],
            Some(own) => {
                let numbers = own.numbers(self.sizes(), view);
                std::array::from_fn(|k| numbers[k])
            }
        })
    }
    fn remember(&self, view: &View, task_state: &mut Writer) {
        phase_or_base!(self.remember(view, task_state), own => self.write(own, view, task_state));
    }
    fn observe(&self, view: &View, agent: usize, out: &mut Writer) {
        phase_or_base!(self.observe(view, agent, out), own => self.write(&own[agent], view, out));
    }
    fn central(&self, view: &View, out: &mut Writer) {
        phase_or_base!(self.central(view, out), own => self.write(own, view, out));
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        phase_or_base!(self.reward(view, terms), own => self.write(own, view, terms));
    }
    fn ends(&self, view: &View, ends: &mut Ends) {
        phase_or_base!(self.ends(view, ends), own => {
            let masks = own.truths(self.sizes(), view);
            own.words.iter().zip(masks).for_each(|([name, condition], mask)| ends.when(name, condition, mask));
        });
    }
    fn metrics(&self, view: &View, out: &mut Writer) {
        phase_or_base!(self.metrics(view, out), own => self.write(own, view, out));
    }
    fn success(&self, view: &View) -> TraceMask {
        phase_or_base!(self.success(view), own => own.truths(self.sizes(), view)[0])
    }
    fn success_rule(&self) -> Success {
        self.base.success_rule()
    }
    fn loss(&self, view: &View, loss: &mut Loss) {
        phase_or_base!(self.loss(view, loss), own => {
            let numbers = own.numbers(self.sizes(), view);
            own.words.iter().zip(numbers).for_each(|([formula, _], number)| loss.add(formula, number));
        });
    }
    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        phase_or_base!(self.reference(view), own => own.on(self.sizes(), view))
    }
    fn ideal(&self, start: &mut Start<'_>) {
        phase_or_base!(self.ideal(start), own => own.play(self.sizes(), start));
    }
}

impl ReferenceRecord {
    /// What is tracked in an episode that begins so; `None` for numbers that are none.
    fn on(&self, sizes: &ViewSizes, view: &View<'_, f64>) -> Option<TaskReference> {
        let numbers = self.phase.numbers(sizes, view);
        let told: ReferenceTable = serde_json::from_value(filled(&self.template, &numbers)?).ok()?;
        let Some(way) = told.way else {
            let references = told.references;
            references.iter().all(|own| own.validate().is_ok()).then_some(())?;
            return Some(TaskReference { references, tilt: Tilt::LEVEL, follower: told.follower });
        };
        Some(TaskReference::way(&view.drone(0), way.position, way.yaw, way.slowness))
    }
}

/// A table with numbers in their places.
fn filled(template: &serde_json::Value, numbers: &[f64]) -> Option<serde_json::Value> {
    use serde_json::Value;
    Some(match template {
        Value::Object(all) if all.len() == 1 && all.contains_key("number") => {
            let k = usize::try_from(all["number"].as_u64()?).ok()?;
            Value::from(*numbers.get(k).filter(|x| x.is_finite())?)
        }
        Value::Object(all) => {
            let own = all.iter().map(|(key, own)| Some((key.clone(), filled(own, numbers)?)));
            Value::Object(own.collect::<Option<_>>()?)
        }
        Value::Array(all) => Value::Array(all.iter().map(|own| filled(own, numbers)).collect::<Option<_>>()?),
        other => other.clone(),
    })
}

/// What a reference says.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ReferenceTable {
    /// One for the whole, or one per drone.
    #[serde(default)]
    references: Vec<Reference>,
    /// From where drone 0 is.
    #[serde(default)]
    way: Option<Way>,
    /// See [`TaskReference::follower`].
    #[serde(default)]
    follower: Option<[f64; 3]>,
}

/// As [`TaskReference::way`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Way {
    position: [f64; 3],
    yaw: f64,
    slowness: f64,
}

/// What a phase writes.
fn written(write: impl FnOnce(&mut Writer)) -> Answer {
    let (numbers, fields) = Writer::written(write).parts();
    Answer { numbers, fields, ..Answer::default() }
}
