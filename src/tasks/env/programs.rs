//! The phases of a step as programs, in place over the rows of a block of environments.

use super::block::{EnvBlock, beginning};
use super::core::Core;
use super::layout::{EnvLayout, Part};
use super::phases::{Numbers, Step};
use crate::observation::AgentArrays;
use autodiff::native::{Executable, PerProcess, Place, RowLayout, Rows, Work};
use autodiff::program::{BLOCK, ValueForm};
use autodiff::{Program, Recording, Trace};
use base::error::Result;
use dynamics::batch::PlantBlock;
use std::collections::BTreeMap;
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// What environments run.
#[derive(Debug)]
pub(crate) struct Programs {
    /// Actions to commands, where controllers stand behind.
    pub act: Option<RowProgram>,
    /// From actions, or from commands, to what is judged and observed.
    pub step: RowProgram,
    /// What is observed, of the state as it is.
    pub observe: RowProgram,
    /// One agent's observation through the stages, if there are any.
    pub transform: Option<StageProgram>,
    /// Where all bodies are, where sensors ask.
    pub frames: Option<RowProgram>,
    /// Episodes that begin, and what is observed there.
    pub start: RowProgram,
    /// What an event does, where there may be one, and what is observed behind it.
    pub event: Option<RowProgram>,
}

/// Phases that work on rows.
pub(crate) struct RowProgram {
    made: Arc<Made>,
    /// Rows of work that it reads.
    reads: Vec<usize>,
}

/// What was recorded, and what was made of it.
struct Made {
    recording: Recording,
    layout: RowLayout,
    executable: Executable<[f32; BLOCK]>,
}

type Known = BTreeMap<u64, Vec<Weak<Made>>>;

/// What somebody has, by its hash: environments of a kind share their programs.
static KNOWN: PerProcess<Mutex<Known>> = PerProcess::new();

fn known() -> MutexGuard<'static, Known> {
    KNOWN.get().lock().unwrap_or_else(PoisonError::into_inner)
}

impl Made {
    /// Of what somebody has already, or made now.
    fn of(recording: Recording, layout: RowLayout) -> Result<Arc<Self>> {
        let mut hasher = DefaultHasher::new();
        (&recording, &layout).hash(&mut hasher);
        let hash = hasher.finish();
        let find = |known: &Known| {
            let alike = known.get(&hash).into_iter().flatten().filter_map(Weak::upgrade);
            alike.into_iter().find(|made: &Arc<Self>| made.recording == recording && made.layout == layout)
        };
        let found = find(&known());
        if let Some(made) = found {
            return Ok(made);
        }
        let executable = Executable::new(&Program::compile(&recording)?, layout.clone())?;
        let mut known = known();
        // another thread may have made the same meanwhile
        if let Some(made) = find(&known) {
            return Ok(made);
        }
        let made = Arc::new(Self { recording, layout, executable });
        known.retain(|_, alike| {
            alike.retain(|made| made.strong_count() > 0);
            !alike.is_empty()
        });
        known.entry(hash).or_default().push(Arc::downgrade(&made));
        Ok(made)
    }
}

/// Scratch of a worker, a program each.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scratch {
    pub act: Option<Work<[f32; BLOCK]>>,
    pub step: Option<Work<[f32; BLOCK]>>,
    pub observe: Option<Work<[f32; BLOCK]>>,
    pub transform: Option<Work<[f32; BLOCK]>>,
    pub frames: Option<Work<[f32; BLOCK]>>,
    pub start: Option<Work<[f32; BLOCK]>>,
    pub event: Option<Work<[f32; BLOCK]>>,
}

/// The arrays of what is kept and of work, behind that of physics, before what all share and what varies of the model: see
/// [`Numbers`].
pub(super) const KEPT: u8 = 1;
pub(super) const WORK: u8 = 2;
const SHARED: u8 = 3;

impl Programs {
    pub(crate) fn of(core: &Core) -> Result<Self> {
        let work = &core.layout.work;
        let decodes = core.control.is_continuous();
        let senses = core.sensing.is_some();
        let observe = RowProgram::of(core, &[work.raw.range(), work.central.range()], |step| {
            step.show();
        })?;
        let mut told = vec![work.raw.range(), work.central.range(), work.metrics.range(), work.signals.range()];
        told.extend(observe.reads.iter().map(|row| *row..row + 1));
        if senses {
            told.push(work.frames.range());
        }
        let is_led = core.residual.is_some();
        let accepted = work.beginning.range().start + beginning::ACCEPTED;
        let begun = [accepted..accepted + 1, work.speeds.range(), work.raw.range(), work.central.range()];
        let act = |step: &mut Step<'_>| {
            if decodes {
                step.clip(&step.actions());
            }
            step.delay();
        };
        let mut has_events = true;
        let start = RowProgram::of(core, &begun, |step| {
            has_events = step.begin();
            step.show();
        })?;
        let event = if has_events {
            Some(RowProgram::of(core, &begun, |step| {
                step.event();
                step.show();
            })?)
        } else {
            None
        };
        Ok(Self {
            act: if is_led && (decodes || core.sizes.delay > 0) {
                Some(RowProgram::of(core, &[work.command.range()], act)?)
            } else {
                None
            },
            step: RowProgram::of(core, &told, |step| {
                if !is_led {
                    act(step);
                }
                step.fly();
                step.observe();
                if senses {
                    step.tell_frames();
                }
            })?,
            observe,
            transform: if core.pipeline.is_empty() { None } else { Some(StageProgram::of(core)?) },
            frames: if senses {
                Some(RowProgram::of(core, &[work.frames.range()], |step| {
                    step.move_frames();
                    step.tell_frames();
                })?)
            } else {
                None
            },
            start,
            event,
        })
    }

    /// Printed, by name.
    pub(super) fn printed(&self) -> Vec<(&'static str, String)> {
        let own = [
            ("act", self.act.as_ref()),
            ("step", Some(&self.step)),
            ("observe", Some(&self.observe)),
            ("frames", self.frames.as_ref()),
            ("start", Some(&self.start)),
            ("event", self.event.as_ref()),
        ];
        let printed = |(name, program): (&'static str, Option<&RowProgram>)| {
            program.map(|own| (name, ValueForm::of(&own.made.recording).to_string()))
        };
        own.into_iter().filter_map(printed).collect()
    }

    /// Whether all are those of others, in memory.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        let alike = |a: &Option<RowProgram>, b: &Option<RowProgram>| match (a, b) {
            (Some(a), Some(b)) => a.is_same(b),
            (a, b) => a.is_none() && b.is_none(),
        };
        let transform = match (&self.transform, &other.transform) {
            (Some(a), Some(b)) => Arc::ptr_eq(&a.0, &b.0),
            (a, b) => a.is_none() && b.is_none(),
        };
        alike(&self.act, &other.act)
            && self.step.is_same(&other.step)
            && self.observe.is_same(&other.observe)
            && alike(&self.frames, &other.frames)
            && self.start.is_same(&other.start)
            && alike(&self.event, &other.event)
            && transform
    }

    /// For one worker.
    pub(crate) fn scratch(&self) -> Scratch {
        let of = |program: &Option<RowProgram>| program.as_ref().map(RowProgram::scratch);
        Scratch {
            act: of(&self.act),
            step: Some(self.step.scratch()),
            observe: Some(self.observe.scratch()),
            transform: self.transform.as_ref().map(|program| program.0.executable.work()),
            frames: of(&self.frames),
            start: Some(self.start.scratch()),
            event: of(&self.event),
        }
    }
}

impl RowProgram {
    /// Records phases. Rows of what is kept are written where they change, those of work where they are `told`,
    /// neither where the configuration leaves them out of the information.
    fn of(core: &Core, told: &[Range<usize>], phases: impl FnOnce(&mut Step<'_>)) -> Result<Self> {
        let places = core.places();
        let left_out = core.told.left_out(&core.sizes, &core.layout);
        let is_told = |place: &Place| match place.array {
            _ if left_out.contains(place) => false,
            WORK => told.iter().any(|rows| rows.contains(&(place.row as usize))),
            array => array != SHARED,
        };
        let (mut results, mut fault) = (Vec::new(), None);
        let recording = Recording::of_lanes(places.len(), |z| {
            let mut step = Step::new(core, core.numbers(z));
            phases(&mut step);
            fault = step.fault.take();
            let changed = places.iter().zip(z).zip(step.numbers.all(core));
            let changed = changed.filter(|((place, before), after)| !before.is(*after) && is_told(place));
            let (own, values) = changed.map(|((place, _), after)| (*place, after)).unzip();
            results = own;
            values
        });
        if let Some(fault) = fault {
            return Err(fault);
        }
        let (recording, used) = recording.of_used_inputs();
        let arguments: Vec<Place> = used.iter().map(|k| places[*k]).collect();
        let reads = arguments.iter().filter(|place| place.array == WORK).map(|place| place.row as usize).collect();
        Ok(Self { made: Made::of(recording, RowLayout::new(arguments, results)?)?, reads })
    }

    pub(super) fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.made, &other.made)
    }

    /// Operations, and rows that are written.
    #[cfg(test)]
    pub(super) fn size(&self) -> (usize, usize) {
        (self.made.recording.n_operation(), self.made.layout.results().len())
    }

    /// What was recorded, and where its numbers stand.
    pub(super) fn recorded(&self) -> (&Recording, &RowLayout) {
        (&self.made.recording, &self.made.layout)
    }

    fn scratch(&self) -> Work<[f32; BLOCK]> {
        self.made.executable.work()
    }

    /// Runs for these lanes of a block and those beside them in a register.
    pub(crate) fn run(
        &self,
        scratch: &mut Option<Work<[f32; BLOCK]>>,
        core: &Core,
        block: &mut EnvBlock,
        work: &mut [[f32; BLOCK]],
        lanes: Range<usize>,
    ) {
        let scratch = scratch.get_or_insert_with(|| self.scratch());
        let EnvBlock { plant: PlantBlock { rows, numbers, .. }, kept, .. } = block;
        let model = numbers.as_mut().map_or(&mut [][..], |rows| rows);
        let mut arrays =
            [Rows::Write(rows), Rows::Write(kept), Rows::Write(work), Rows::Read(&core.shared), Rows::Write(model)];
        let n = self.made.layout.n_array();
        self.made.executable.run_within(scratch, &mut arrays[..n], lanes).expect("rows of the environment");
    }
}

/// The stages of one agent's observation: all agents run it, each over rows of its own.
pub(crate) struct StageProgram(Arc<Made>);

impl StageProgram {
    /// What was recorded, and where its numbers stand.
    pub(super) fn recorded(&self) -> (&Recording, &RowLayout) {
        (&self.0.recording, &self.0.layout)
    }

    /// Arrays are the observation, memory, what a normaliser sees, noise, then what all agents share: whether lanes moved on and begin,
    /// numbers that vary, statistics.
    fn of(core: &Core) -> Result<Self> {
        let (s, pipeline) = (&core.sizes, &core.pipeline);
        let sizes = [s.observation, pipeline.memory, s.normalised, s.noise, 2 + s.theta, 2 * s.normalised];
        let places: Vec<Place> = places(&sizes);
        let mut results = Vec::new();
        let recording = Recording::of_lanes(places.len(), |z| {
            let mut arrays = Vec::new();
            let mut rest = z;
            for n in sizes {
                let (own, behind) = rest.split_at(n);
                arrays.push(own.to_vec());
                rest = behind;
            }
            let [observation, memory, seen, noise, common, statistics] = &mut arrays[..] else { return Vec::new() };
            pipeline.run(AgentArrays { observation, memory, seen, noise, common, statistics });
            let changed = places.iter().zip(z).zip(arrays.iter().flatten());
            let changed = changed.filter(|((_, before), after)| !before.is(**after));
            let (own, values) = changed.map(|((place, _), after)| (*place, *after)).unzip();
            results = own;
            values
        });
        let (recording, used) = recording.of_used_inputs();
        let arguments = used.iter().map(|k| places[*k]).collect();
        Ok(Self(Made::of(recording, RowLayout::new(arguments, results)?)?))
    }

    /// Runs for all agents and the first `n` environments of a block.
    pub(crate) fn run(
        &self,
        scratch: &mut Option<Work<[f32; BLOCK]>>,
        core: &Core,
        block: &mut EnvBlock,
        work: &mut [[f32; BLOCK]],
        n: usize,
    ) {
        let (s, layout) = (&core.sizes, &core.layout);
        let scratch = scratch.get_or_insert_with(|| self.0.executable.work());
        layout.work.common.of_mut(work)[2..].copy_from_slice(layout.kept.theta.of(&block.kept));
        let history = layout.kept.history.of_mut(&mut block.kept);
        let part = |part: Part, agent: usize, n: usize| {
            let first = part.range().start + agent * n;
            first..first + n
        };
        for agent in 0..s.agent {
            let own = part(layout.work.observation, agent, s.observation);
            work.copy_within(part(layout.work.raw, agent, s.raw), own.start);
            let parts = [
                own,
                part(layout.work.seen, agent, s.normalised),
                part(layout.work.noise, agent, s.noise),
                layout.work.common.range(),
            ];
            let [observation, seen, noise, common] = work.get_disjoint_mut(parts).expect("parts lie apart");
            let memory = &mut history[agent * core.pipeline.memory..][..core.pipeline.memory];
            let mut arrays = [
                Rows::Write(observation),
                Rows::Write(memory),
                Rows::Write(seen),
                Rows::Read(noise),
                Rows::Read(common),
                Rows::Read(&core.shared),
            ];
            let n_array = self.0.layout.n_array();
            self.0.executable.run(scratch, &mut arrays[..n_array], n).expect("rows of the stages");
        }
    }
}

impl fmt::Debug for StageProgram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "StageProgram({:?})", self.0.executable.why_interpreted())
    }
}

/// Every row of arrays of these sizes.
fn places(sizes: &[usize]) -> Vec<Place> {
    let rows = |(array, n): (usize, &usize)| (0..*n).map(move |row| Place { array: array as u8, row: row as u32 });
    sizes.iter().enumerate().flat_map(rows).collect()
}

impl fmt::Debug for RowProgram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "RowProgram({:?})", self.made.executable.why_interpreted())
    }
}

impl Core {
    /// Where each number stands: those of [`Numbers::all`] in their order, then those of the model that vary.
    fn places(&self) -> Vec<Place> {
        let EnvLayout { kept, work, shared } = &self.layout;
        let sizes = [self.plant.n_row(), kept.count, work.count, shared.count];
        let varying = self.varying.iter().map(|row| Place { array: sizes.len() as u8, row: *row as u32 });
        places(&sizes).into_iter().chain(varying).collect()
    }

    /// The numbers of these inputs of a recording, one for each of [`Core::places`].
    fn numbers(&self, z: &[Trace]) -> Numbers {
        let EnvLayout { kept, work, shared } = &self.layout;
        let (plant, z) = z.split_at(self.plant.n_row());
        let (kept, z) = z.split_at(kept.count);
        let (work, z) = z.split_at(work.count);
        let (shared, varying) = z.split_at(shared.count);
        let mut model = self.plant.constant_numbers();
        self.varying.iter().zip(varying).for_each(|(k, own)| model[*k] = *own);
        Numbers { plant: plant.to_vec(), kept: kept.to_vec(), work: work.to_vec(), shared: shared.to_vec(), model }
    }
}
