//! Starts and events on the host: what is recorded of them as programs in `f64`, between draws that are made one after the other.

use super::phase::ViewSizes;
use super::start::{PadDraw, StartRecord};
use crate::start::Start;
use autodiff::trace::Walk;
use autodiff::{Program, Recording, Workspace};
use base::error::Result;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// A start or an event that runs on the host: with the bits of [`StartRecord::play`], many times as fast.
pub(super) struct HostProgram {
    /// What every draw depends on.
    operands: Vec<Operands>,
    /// The draws that are made again until they are accepted, how often at most, and whether they are.
    again: Option<(Range<usize>, usize, Program)>,
    results: Program,
    /// Memory of workers that rest.
    rested: Mutex<Vec<Memory>>,
}

/// What a draw depends on.
enum Operands {
    /// Numbers that were given or drawn, by place.
    Inputs(Vec<usize>),
    /// Numbers that are computed of those.
    Computed(Program),
}

/// Of one worker.
struct Memory {
    /// What is given, and what was drawn.
    inputs: Vec<f64>,
    /// Of one program.
    outputs: Vec<f64>,
    operands: Vec<Option<Workspace>>,
    accepted: Option<Workspace>,
    results: Workspace,
    /// The rest of many that were drawn at once, from behind.
    many: Vec<f64>,
}

impl Operands {
    fn workspace(&self) -> Option<Workspace> {
        match self {
            Self::Inputs(_) => None,
            Self::Computed(program) => Some(program.workspace()),
        }
    }

    fn read(&self, work: &mut Option<Workspace>, inputs: &[f64], numbers: &mut Vec<f64>) {
        match (self, work) {
            (Self::Computed(program), Some(work)) => {
                numbers.resize(program.n_output(), 0.0);
                program.evaluate(work, inputs, numbers);
            }
            (Self::Inputs(places), _) => {
                numbers.clear();
                numbers.extend(places.iter().map(|k| inputs[*k]));
            }
            _ => (),
        }
    }
}

impl HostProgram {
    /// # Errors
    /// As [`Program::compile`].
    pub(super) fn of(record: &StartRecord) -> Result<Self> {
        let recording = &record.recording;
        let program = |nodes: &[usize]| {
            let own = Recording::of(recording.n_input() + record.draws.len(), |inputs| {
                let mut walk = Walk::new(recording);
                walk.run(&mut |_, k| inputs[k]);
                nodes.iter().map(|node| walk.values.number(*node)).collect()
            });
            Program::compile(&own)
        };
        let operands = |(_, draw): &(usize, PadDraw)| {
            let nodes: &[usize] = match draw {
                PadDraw::One(_) | PadDraw::Next => &[],
                PadDraw::Other(_, nodes) | PadDraw::Many(_, nodes) => nodes,
            };
            match nodes.iter().map(|node| recording.input_of_node(*node)).collect() {
                Some(inputs) => Ok(Operands::Inputs(inputs)),
                None => program(nodes).map(Operands::Computed),
            }
        };
        let operands = record.draws.iter().map(operands).collect::<Result<_>>()?;
        let outputs: Vec<usize> = (0..recording.n_output()).map(|k| recording.output(k)).collect();
        let again = match &record.again {
            None => None,
            Some(again) => {
                let place = |k: usize| recording.node_of_input(recording.n_input() + k).unwrap_or(usize::MAX);
                let before = |end: usize| (0..record.draws.len()).take_while(|k| place(*k) < end).count();
                let range = before(again.begins)..before(again.ends);
                Some((range, again.most, program(&outputs[outputs.len() - 1..])?))
            }
        };
        Ok(Self { operands, again, results: program(&outputs)?, rested: Mutex::default() })
    }

    fn memory(&self) -> Memory {
        let rested = self.rested.lock().unwrap_or_else(PoisonError::into_inner).pop();
        rested.unwrap_or_else(|| Memory {
            inputs: Vec::new(),
            outputs: Vec::new(),
            operands: self.operands.iter().map(Operands::workspace).collect(),
            accepted: self.again.as_ref().map(|(.., accepted)| accepted.workspace()),
            results: self.results.workspace(),
            many: Vec::new(),
        })
    }

    /// Does it.
    pub(super) fn play(&self, record: &StartRecord, sizes: &ViewSizes, start: &mut Start<'_, f64>) {
        let mut memory = self.memory();
        memory.inputs.clear();
        record.given(sizes, start, &mut memory.inputs);
        let n_given = memory.inputs.len();
        memory.inputs.resize(n_given + record.draws.len(), 0.0);
        let mut left = 0..record.draws.len();
        if let Some((range, most, accepted)) = &self.again {
            self.draw(record, left.start..range.start, n_given, &mut memory, start);
            start.again(*most, |start| {
                self.draw(record, range.clone(), n_given, &mut memory, start);
                let mut holds = [0.0];
                let Memory { inputs, accepted: work, .. } = &mut memory;
                work.iter_mut().for_each(|work| accepted.evaluate(work, inputs, &mut holds));
                holds[0] > 0.5
            });
            left = range.end..left.end;
        }
        self.draw(record, left, n_given, &mut memory, start);
        let Memory { inputs, outputs, results, .. } = &mut memory;
        outputs.resize(self.results.n_output(), 0.0);
        self.results.evaluate(results, inputs, outputs);
        record.write(sizes, start, outputs.iter().copied());
        self.rested.lock().unwrap_or_else(PoisonError::into_inner).push(memory);
    }

    /// Makes some of the draws.
    fn draw(
        &self,
        record: &StartRecord,
        which: Range<usize>,
        n_given: usize,
        memory: &mut Memory,
        start: &mut Start<'_, f64>,
    ) {
        let Memory { inputs, outputs, operands, many, .. } = memory;
        for k in which {
            self.operands[k].read(&mut operands[k], inputs, outputs);
            let (stream, draw) = &record.draws[k];
            inputs[n_given + k] = match draw {
                PadDraw::One(drawing) => start.draw(*stream, *drawing),
                PadDraw::Other(n, _) => start.draw_other(*stream, *n, outputs),
                PadDraw::Many(drawing, _) => {
                    many.resize(drawing.n_drawn(), 0.0);
                    start.draw_many(*stream, drawing, outputs, many);
                    many.reverse();
                    many.pop().unwrap_or(0.0)
                }
                PadDraw::Next => many.pop().unwrap_or(0.0),
            };
        }
    }
}
