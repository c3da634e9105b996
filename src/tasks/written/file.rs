//! Records in files: what they compute as checked recordings, what they say as JSON.
//!
//! `omnitask`, version 1, the length of the JSON (u32, little-endian), the JSON, then every recording behind its length. The JSON names
//! recordings by number.

use super::phase::{PhaseRecord, ViewSizes};
use super::robot::RobotSource;
use super::start::{Again, PadDraw, StartRecord};
use super::{Base, OwnTask, Phases, ReferenceRecord, TaskRecord};
use crate::settings::Setting;
use crate::suite::assignment;
use crate::task_spec::{Field, Success};
use autodiff::trace::SavedLimits;
use autodiff::{Operation, Recording};
use base::error::{Error, Result};
use dynamics::scene::Scene;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, OnceLock};

/// Every file begins so; the last byte is the version.
const HEAD: &[u8; 9] = b"omnitask\x01";
/// Longest file, bytes.
pub const MOST_BYTES: usize = 64 << 20;
/// Most numbers of a kind in a view.
const MOST_NUMBERS: usize = 1 << 16;
/// How often a start may be drawn again.
pub const MOST_AGAIN: usize = 100_000;

/// All of a record but its recordings, which stand by number.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TaskHead {
    name: String,
    description: String,
    defaults: toml::Table,
    /// Of a task of the registry.
    base: Option<String>,
    own: Option<OwnHead>,
    sizes: ViewSizes,
    shown: u64,
    phases: PhasesHead,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct OwnHead {
    robot: RobotSource,
    varied: Vec<usize>,
    about: String,
    horizon: usize,
    settings: Vec<Setting>,
    success_rule: Success,
    scene: Scene,
}

#[derive(Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct PhasesHead {
    start: Option<StartHead>,
    event: Option<StartHead>,
    ideal: Option<StartHead>,
    disturb: Option<Vec<PhaseHead>>,
    remember: Option<PhaseHead>,
    observe: Option<Vec<PhaseHead>>,
    central: Option<PhaseHead>,
    reward: Option<PhaseHead>,
    ends: Option<PhaseHead>,
    metrics: Option<PhaseHead>,
    success: Option<PhaseHead>,
    loss: Option<PhaseHead>,
    place_scene: Option<usize>,
    reference: Option<ReferenceHead>,
    on_host: bool,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PhaseHead {
    recording: usize,
    fields: Vec<Field>,
    words: Vec<[String; 2]>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StartHead {
    recording: usize,
    draws: Vec<(usize, PadDraw)>,
    again: Option<Again>,
    goal: Vec<Field>,
    n_goal: usize,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ReferenceHead {
    phase: PhaseHead,
    template: serde_json::Value,
}

/// Recordings as they are written.
#[derive(Default)]
struct Blobs(Vec<Vec<u8>>);

impl Blobs {
    fn put(&mut self, recording: &Recording) -> Result<usize> {
        self.0.push(recording.to_bytes()?);
        Ok(self.0.len() - 1)
    }

    fn phase(&mut self, phase: &PhaseRecord) -> Result<PhaseHead> {
        let PhaseRecord { recording, fields, words } = phase;
        Ok(PhaseHead { recording: self.put(recording)?, fields: fields.clone(), words: words.clone() })
    }

    fn phases(&mut self, phases: &[PhaseRecord]) -> Result<Vec<PhaseHead>> {
        phases.iter().map(|phase| self.phase(phase)).collect()
    }

    fn start(&mut self, start: &StartRecord) -> Result<StartHead> {
        let StartRecord { recording, draws, again, goal, n_goal } = start;
        let (recording, draws, goal) = (self.put(recording)?, draws.clone(), goal.clone());
        Ok(StartHead { recording, draws, again: *again, goal, n_goal: *n_goal })
    }
}

impl TaskRecord {
    /// As bytes, the same in every process.
    ///
    /// # Errors
    /// [`Error::Value`] for a phase that calls a function which cannot be saved.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let mut blobs = Blobs::default();
        let p = &self.phases;
        let phases = PhasesHead {
            start: p.start.as_ref().map(|own| blobs.start(own)).transpose()?,
            event: p.event.as_ref().map(|own| blobs.start(own)).transpose()?,
            ideal: p.ideal.as_ref().map(|own| blobs.start(own)).transpose()?,
            disturb: p.disturb.as_ref().map(|own| blobs.phases(own)).transpose()?,
            remember: p.remember.as_ref().map(|own| blobs.phase(own)).transpose()?,
            observe: p.observe.as_ref().map(|own| blobs.phases(own)).transpose()?,
            central: p.central.as_ref().map(|own| blobs.phase(own)).transpose()?,
            reward: p.reward.as_ref().map(|own| blobs.phase(own)).transpose()?,
            ends: p.ends.as_ref().map(|own| blobs.phase(own)).transpose()?,
            metrics: p.metrics.as_ref().map(|own| blobs.phase(own)).transpose()?,
            success: p.success.as_ref().map(|own| blobs.phase(own)).transpose()?,
            loss: p.loss.as_ref().map(|own| blobs.phase(own)).transpose()?,
            place_scene: p.place_scene.as_ref().map(|own| blobs.put(own)).transpose()?,
            reference: match &p.reference {
                Some(own) => Some(ReferenceHead { phase: blobs.phase(&own.phase)?, template: own.template.clone() }),
                None => None,
            },
            on_host: p.on_host,
        };
        let (base, own) = match &self.base {
            Base::Task(name) => (Some(name.clone()), None),
            Base::Own(own) => {
                let OwnTask { robot, varied, about, horizon, settings, success_rule, scene } = (**own).clone();
                (None, Some(OwnHead { robot, varied, about, horizon, settings, success_rule, scene }))
            }
        };
        let (name, description, defaults) = (self.name.clone(), self.description.clone(), self.defaults.clone());
        let (sizes, shown) = (self.sizes, self.shown);
        let head = TaskHead { name, description, defaults, base, own, sizes, shown, phases };
        let json = serde_json::to_vec(&head).map_err(|e| wrong(&e.to_string()))?;
        let mut bytes = HEAD.to_vec();
        for part in std::iter::once(&json).chain(&blobs.0) {
            bytes.extend((part.len() as u32).to_le_bytes());
            bytes.extend(part);
        }
        if bytes.len() > MOST_BYTES {
            let remedy = "Record less: loops are written out, step by step.";
            return Err(Error::limit("bytes of the task's record", bytes.len(), MOST_BYTES, remedy));
        }
        Ok(bytes)
    }

    /// The record of [`to_bytes`](Self::to_bytes), which nobody is trusted to have made: sizes are held against each other, and recordings
    /// are checked before anything is made of them.
    ///
    /// # Errors
    /// [`Error::Format`] for bytes that are none, [`Error::Limit`] for too many.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        if bytes.len() > MOST_BYTES {
            return Err(Error::limit("bytes of a task's record", bytes.len(), MOST_BYTES, "Take another file."));
        }
        let Some(mut rest) = bytes.strip_prefix(HEAD) else {
            return Err(wrong("it is none, or one of another version"));
        };
        let mut parts = Vec::new();
        while !rest.is_empty() {
            let (n, behind) = rest.split_at_checked(4).ok_or_else(|| wrong("it ends early"))?;
            let n = u32::from_le_bytes([n[0], n[1], n[2], n[3]]) as usize;
            let (part, behind) = behind.split_at_checked(n).ok_or_else(|| wrong("it ends early"))?;
            parts.push(part);
            rest = behind;
        }
        let Some((json, blobs)) = parts.split_first() else { return Err(wrong("it ends early")) };
        let head: TaskHead = serde_json::from_slice(json).map_err(|e| wrong(&e.to_string()))?;
        let sizes = head.sizes;
        if sizes.all().into_iter().any(|n| n > MOST_NUMBERS) {
            return Err(wrong(&format!("views of more than {MOST_NUMBERS} numbers of a kind")));
        }
        let base = match (head.base, head.own) {
            (Some(name), None) => Base::Task(name),
            (None, Some(OwnHead { robot, varied, about, horizon, settings, success_rule, scene })) => {
                Base::Own(Box::new(OwnTask { robot, varied, about, horizon, settings, success_rule, scene }))
            }
            _ => return Err(wrong("it is of a task of the library, or a whole one")),
        };
        let n_placement = if let Base::Own(own) = &base { own.scene.n_placement() } else { 0 };
        let is_whole = matches!(base, Base::Own(_));
        let phases = Reader { blobs, sizes: &sizes, n_placement }.phases(head.phases, is_whole)?;
        let (name, description, defaults) = (head.name, head.description, head.defaults);
        Ok(Self { name, description, defaults, base, sizes, shown: head.shown, phases, id: OnceLock::new() })
    }
}

fn wrong(rule: &str) -> Error {
    Error::Format {
        file: "record of a task".into(),
        place: String::new(),
        rule: rule.into(),
        remedy: "Write the task down anew with this version.".into(),
    }
}

/// Numbers of fields; none for too many.
fn sum(fields: &[Field]) -> Option<usize> {
    fields.iter().try_fold(0usize, |n, own| n.checked_add(own.size)).filter(|n| *n <= 1 << 20)
}

/// Makes phases of what a file says.
struct Reader<'a> {
    blobs: &'a [&'a [u8]],
    sizes: &'a ViewSizes,
    n_placement: usize,
}

/// How many results a phase must have, by what stands beside them.
#[derive(Clone, Copy)]
enum Results {
    Named,
    Words,
    Exactly(usize),
}

impl Reader<'_> {
    fn recording(&self, number: usize, n_input: usize, n_late: usize) -> Result<Arc<Recording>> {
        let blob = self.blobs.get(number).ok_or_else(|| wrong(&format!("there is no recording {number}")))?;
        let limits = SavedLimits { n_late_input: n_late, n_input: 1 << 20, ..SavedLimits::default() };
        let own = Recording::from_bytes(blob, &operation, &limits)?;
        if own.n_input() != n_input {
            return Err(wrong(&format!("a phase of {} numbers, of {n_input} that it is shown", own.n_input())));
        }
        Ok(Arc::new(own))
    }

    fn phase(&self, head: PhaseHead, results: Results) -> Result<PhaseRecord> {
        let recording = self.recording(head.recording, self.sizes.n_view(), 0)?;
        let n = match results {
            Results::Named => sum(&head.fields).unwrap_or(usize::MAX),
            Results::Words => head.words.len(),
            Results::Exactly(n) => n,
        };
        if recording.n_output() != n {
            return Err(wrong(&format!("a phase of {} results, which are said to be {n}", recording.n_output())));
        }
        Ok(PhaseRecord { recording, fields: head.fields, words: head.words })
    }

    fn start(&self, head: StartHead, begins: bool) -> Result<StartRecord> {
        let (s, StartHead { draws, again, goal, n_goal, .. }) = (self.sizes, &head);
        if *n_goal != if begins { 0 } else { s.goal } {
            return Err(wrong("a goal of other numbers than those of the view"));
        }
        let n_given = 2 + s.state + n_goal + s.task_state + s.parameters;
        let recording = self.recording(head.recording, n_given, n_given + draws.len())?;
        let n_result = 1 + s.state + s.goal + s.task_state + s.parameters + usize::from(again.is_some());
        for (k, (_, draw)) in draws.iter().enumerate() {
            // one that nothing reads is never drawn
            let at = recording.node_of_input(n_given + k).unwrap_or(0);
            if !draw.fits(at)? {
                return Err(wrong(&format!("draw {k} of a start does not fit what it depends on")));
            }
        }
        if recording.n_output() != n_result || draws.iter().any(|(stream, _)| *stream > 2) {
            return Err(wrong("a start or an event whose parts do not fit each other"));
        }
        if let Some(again) = again {
            let accepted = recording.output(n_result - 1);
            let is_part = again.begins <= again.ends && again.ends <= recording.n_node();
            // a part begins and ends between calls with their results
            let is_whole = [again.begins, again.ends].into_iter().all(|at| !recording.is_result(at));
            if !is_part || !is_whole || accepted >= again.ends.max(1) || !(1..=MOST_AGAIN).contains(&again.most) {
                return Err(wrong(&format!("a part of a start that is drawn again, 1 to {MOST_AGAIN} times, is none")));
            }
        }
        if begins && sum(goal) != Some(s.goal) {
            return Err(wrong("fields of a goal of other sizes than the goal"));
        }
        let StartHead { draws, again, goal, n_goal, .. } = head;
        Ok(StartRecord { recording, draws, again, goal, n_goal })
    }

    fn phases(&self, head: PhasesHead, is_whole: bool) -> Result<Phases> {
        use Results::{Exactly, Named, Words};
        let s = self.sizes;
        let many = |own: Vec<PhaseHead>, n: usize, results: Results| {
            if own.len() != n {
                return Err(wrong(&format!("{} phases of {n}", own.len())));
            }
            own.into_iter().map(|own| self.phase(own, results)).collect::<Result<Vec<_>>>()
        };
        let one = |own: Option<PhaseHead>, results: Results| own.map(|own| self.phase(own, results)).transpose();
        let n_disturb = head.disturb.as_ref().map_or(0, |own| if own.is_empty() { 0 } else { s.trees });
        let reference = |own: ReferenceHead| {
            let n = self.blobs.get(own.phase.recording).map_or(0, |_| MOST_NUMBERS);
            let phase = PhaseHead { fields: Vec::new(), words: Vec::new(), ..own.phase };
            let recording = self.recording(phase.recording, s.n_view(), 0)?;
            if recording.n_output() > n {
                return Err(wrong("a reference of too many numbers"));
            }
            let phase = PhaseRecord { recording, fields: phase.fields, words: phase.words };
            Ok(ReferenceRecord { phase, template: own.template })
        };
        let place_scene = match head.place_scene {
            None => None,
            Some(number) => Some(self.recording(number, s.goal, 0)?).filter(|own| own.n_output() == self.n_placement),
        };
        let phases = Phases {
            start: head.start.map(|own| self.start(own, true)).transpose()?,
            event: head.event.map(|own| self.start(own, false)).transpose()?,
            ideal: head.ideal.map(|own| self.start(own, true)).transpose()?,
            disturb: head.disturb.map(|own| many(own, n_disturb, Exactly(9))).transpose()?,
            remember: one(head.remember, Named)?,
            observe: head.observe.map(|own| many(own, s.agents, Named)).transpose()?,
            central: one(head.central, Named)?,
            reward: one(head.reward, Named)?,
            ends: one(head.ends, Words)?,
            metrics: one(head.metrics, Named)?,
            success: one(head.success, Exactly(1))?,
            loss: one(head.loss, Words)?,
            place_scene,
            reference: head.reference.map(reference).transpose()?,
            on_host: head.on_host,
        };
        let has_all =
            [phases.start.is_some(), phases.ideal.is_some(), phases.observe.is_some(), phases.reward.is_some()];
        let kept = phases.remember.as_ref().map(|own| own.recording.n_output());
        if is_whole && kept.unwrap_or(0) != s.task_state || kept.is_some_and(|n| n != s.task_state) {
            return Err(wrong("a task state of other numbers than those that the task keeps"));
        }
        let terms = phases.reward.iter().flat_map(|own| &own.fields);
        if terms.into_iter().any(|own| !(own.low <= own.high && own.low.is_finite() && own.high.is_finite())) {
            return Err(wrong("a summand of the reward without bounds"));
        }
        if is_whole && !(has_all.into_iter().all(|has| has) && phases.ends.is_some() && phases.success.is_some()) {
            return Err(wrong("a whole task has a start, an ideal, an observation, a reward, ends and a success"));
        }
        Ok(phases)
    }
}

/// Functions that records may call, by name and data.
///
/// # Errors
/// [`Error::Unknown`] for others.
#[doc(hidden)]
pub fn operation(name: &str, data: &[u8]) -> Result<Operation> {
    let own = autodiff::saved_operation(name, data).or_else(|| assignment::saved_operation(name, data));
    own.ok_or_else(|| {
        let known = ["floor", "assignment"].map(String::from).to_vec();
        Error::Unknown { kind: "function of a record", name: name.into(), known }
    })
}
