//! How an episode begins and what an event does, written down: draws by kind, and what becomes of them.

use super::phase::ViewSizes;
use crate::declare::{Goal, Writer};
use crate::robot::Robot;
use crate::start::{Draw, Drawing, ManyDraw, Source, Start, StartOutput, StartScalar};
use crate::task_spec::Field;
use autodiff::trace::{Values, Walk};
use autodiff::{Recording, Trace, TraceMask};
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::sync::Arc;

/// A start or an event. Inputs are difficulty, step of the event, state, goal, task state, physical numbers, then the draws in
/// their order; results are step of the next event, state, goal, task state, physical numbers, then whether what was drawn is accepted.
#[derive(Debug, Clone, PartialEq)]
pub struct StartRecord {
    pub(super) recording: Arc<Recording>,
    /// The stream of each, and what it is.
    pub(super) draws: Vec<(usize, PadDraw)>,
    pub(super) again: Option<Again>,
    /// What the goal is, where an episode begins.
    pub(super) goal: Vec<Field>,
    /// Numbers of the goal before: none where an episode begins.
    pub(super) n_goal: usize,
}

/// A draw that is an input of a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum PadDraw {
    /// That depends on nothing.
    One(Drawing),
    /// A whole number below the first that is none of those at these nodes.
    Other(u64, Vec<usize>),
    /// The first of many, which depend on these nodes.
    Many(Box<ManyDraw>, Vec<usize>),
    /// The next of the many before.
    Next,
}

impl PadDraw {
    /// Whether it may be the input at node `at`: what it depends on stands before.
    ///
    /// # Errors
    /// As [`Drawing::check`].
    pub(super) fn fits(&self, at: usize) -> Result<bool> {
        let stand_before = |nodes: &[usize]| nodes.iter().all(|node| *node < at);
        Ok(match self {
            Self::One(drawing) => {
                drawing.check()?;
                true
            }
            Self::Other(n, taken) => {
                Drawing { draw: Draw::Below(*n), chance: None }.check()?;
                (taken.len() as u64) < *n && stand_before(taken)
            }
            Self::Many(drawing, operands) => operands.len() == drawing.n_operand() && stand_before(operands),
            Self::Next => true,
        })
    }
}

/// The part that is drawn again until it is accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Again {
    /// Its nodes.
    pub begins: usize,
    pub ends: usize,
    /// How often it is drawn at most.
    pub most: usize,
}

/// Draws that are inputs of the recording.
struct Pen {
    n_given: usize,
    draws: Vec<(usize, PadDraw)>,
    again: Option<Again>,
    accepted: Option<TraceMask>,
    is_twice: bool,
}

impl Pen {
    fn input(&mut self, stream: usize, draw: PadDraw) -> Trace {
        self.draws.push((stream, draw));
        Trace::input(self.n_given + self.draws.len() - 1)
    }
}

impl Source<Trace> for Pen {
    fn draw(&mut self, stream: usize, drawing: Drawing) -> Trace {
        self.input(stream, PadDraw::One(drawing))
    }

    fn draw_other(&mut self, stream: usize, n: u64, taken: &[Trace]) -> Trace {
        self.input(stream, PadDraw::Other(n, taken.iter().map(|own| own.place()).collect()))
    }

    fn draw_many(&mut self, stream: usize, drawing: &ManyDraw, operands: &[Trace], drawn: &mut [Trace]) {
        let places = operands.iter().map(|own| own.place()).collect();
        let mut first = Some(PadDraw::Many(Box::new(drawing.clone()), places));
        drawn.iter_mut().for_each(|own| *own = self.input(stream, first.take().unwrap_or(PadDraw::Next)));
    }

    fn begin_again(&mut self, most: usize) {
        self.is_twice |= self.again.is_some();
        let begins = Recording::place();
        self.again = Some(Again { begins, ends: begins, most });
    }

    fn stays(&mut self, accepted: TraceMask, _is_last: bool) -> bool {
        self.again.iter_mut().for_each(|again| again.ends = Recording::place());
        self.accepted = Some(accepted);
        true
    }
}

/// A start or an event in the course of being written down. Whoever writes it has it whole, may keep it between two calls, and gives it
/// back.
pub struct StartPad {
    state: Vec<Trace>,
    goal: Vec<Trace>,
    goal_at: usize,
    names: Option<Writer>,
    task_state: Vec<Trace>,
    numbers: Vec<Trace>,
    event_at: Trace,
    difficulty: Trace,
    pen: RefCell<Pen>,
}

impl StartPad {
    /// Does something of a [`Start`] but for [`Start::again`].
    pub fn with<R>(&mut self, robot: &Robot, write: impl FnOnce(&mut Start<'_>) -> R) -> R {
        let Self { state, goal, goal_at, names, task_state, numbers, event_at, difficulty, pen } = self;
        let goal = Goal::going_on(goal, *goal_at, names.take());
        let own = StartOutput { robot, state, goal, task_state, numbers };
        let mut start = Start::new(own, &*pen, *event_at, *difficulty);
        let result = write(&mut start);
        *event_at = start.event_at;
        (*goal_at, *names) = start.goal.left();
        result
    }

    /// What follows may be drawn again, `most` times at most, until [`accept`](Self::accept) says that it stays: [`Start::again`].
    pub fn begin_again(&mut self, most: usize) {
        self.pen.get_mut().begin_again(most);
    }

    /// Ends what may be drawn again.
    pub fn accept(&mut self, accepted: TraceMask) {
        self.pen.get_mut().stays(accepted, false);
    }

    /// What the goal is so far.
    pub fn fields(&self) -> Vec<Field> {
        self.names.as_ref().map(Writer::named).unwrap_or_default()
    }

    /// Changes the parts that a start may write by place.
    pub fn parts(&mut self) -> PadParts<'_> {
        let Self { state, goal, task_state, numbers, event_at, difficulty, .. } = self;
        PadParts { state, goal, task_state, numbers, event_at, difficulty: *difficulty }
    }
}

/// The parts of a [`StartPad`], as those of a [`Start`].
pub struct PadParts<'a> {
    /// Of the physics.
    pub state: &'a mut [Trace],
    /// So far; in events all of it.
    pub goal: &'a mut [Trace],
    /// What the task keeps.
    pub task_state: &'a mut [Trace],
    /// Physical numbers.
    pub numbers: &'a mut [Trace],
    /// Step of the event.
    pub event_at: &'a mut Trace,
    /// Of the curriculum.
    pub difficulty: Trace,
}

impl StartRecord {
    /// What `begin` does where an episode begins, or in an event, where the goal has numbers already.
    ///
    /// # Errors
    /// [`Error::Value`] where two parts are drawn again.
    pub(super) fn of(sizes: &ViewSizes, n_goal: usize, begin: impl FnOnce(StartPad) -> StartPad) -> Result<Self> {
        let n_given = 2 + sizes.state + n_goal + sizes.task_state + sizes.parameters;
        let mut told = None;
        let recording = Recording::as_written(n_given, |z| {
            let (state, rest) = z[2..].split_at(sizes.state);
            let (goal, rest) = rest.split_at(n_goal);
            let (task_state, numbers) = rest.split_at(sizes.task_state);
            let pen = Pen { n_given, draws: Vec::new(), again: None, accepted: None, is_twice: false };
            let pad = begin(StartPad {
                state: state.to_vec(),
                goal: goal.to_vec(),
                goal_at: 0,
                names: (n_goal == 0).then(Writer::default),
                task_state: task_state.to_vec(),
                numbers: numbers.to_vec(),
                event_at: z[1],
                difficulty: z[0],
                pen: RefCell::new(pen),
            });
            let mut results = vec![pad.event_at];
            for part in [&pad.state, &pad.goal, &pad.task_state, &pad.numbers] {
                results.extend_from_slice(part);
            }
            let pen = pad.pen.into_inner();
            results.extend(pen.accepted.map(TraceMask::as_number));
            told = Some((pen, pad.names.unwrap_or_default().fields()));
            results
        });
        let Some((Pen { draws, again, is_twice, .. }, goal)) = told else {
            return Err(Error::value("a start", "lost", "written down", "Report this."));
        };
        if is_twice {
            let remedy = "Ask for all of it in one part.";
            return Err(Error::value(
                "what is drawn again in a start or an event",
                "in several parts",
                "one part",
                remedy,
            ));
        }
        Ok(Self { recording: Arc::new(recording), draws, again, goal, n_goal })
    }

    /// Whether it draws what only starts on the host do.
    pub(super) fn is_of_host(&self) -> bool {
        self.draws.iter().any(|(_, draw)| !matches!(draw, PadDraw::One(_)))
    }

    /// Numbers of the goal behind it.
    pub(super) fn n_goal(&self, sizes: &ViewSizes) -> usize {
        let accepted = usize::from(self.again.is_some());
        (self.recording.n_output() - accepted).saturating_sub(1 + sizes.state + sizes.task_state + sizes.parameters)
    }

    /// Does it.
    pub(super) fn play<S: StartScalar>(&self, sizes: &ViewSizes, start: &mut Start<'_, S>) {
        let mut given = Vec::new();
        self.given(sizes, start, &mut given);
        let mut many = Vec::new();
        let mut input = |start: &mut Start<'_, S>, values: &Values<S>, k: usize| {
            if let Some(x) = given.get(k) {
                return *x;
            }
            let (stream, draw) = &self.draws[k - given.len()];
            let numbers = |nodes: &[usize]| nodes.iter().map(|node| values.number(*node)).collect::<Vec<S>>();
            match draw {
                PadDraw::One(drawing) => start.draw(*stream, *drawing),
                PadDraw::Other(n, taken) => start.draw_other(*stream, *n, &numbers(taken)),
                PadDraw::Many(drawing, operands) => {
                    many = vec![S::zero(); drawing.n_drawn()];
                    start.draw_many(*stream, drawing, &numbers(operands), &mut many);
                    // from behind, so that the next is the last
                    many.reverse();
                    many.pop().unwrap_or(S::zero())
                }
                PadDraw::Next => many.pop().unwrap_or(S::zero()),
            }
        };
        let mut walk = Walk::new(&self.recording);
        if let Some(again) = self.again {
            walk.run_to(again.begins, &mut |values, k| input(start, values, k));
            let accepted = self.recording.output(self.recording.n_output() - 1);
            start.again(again.most, |start| {
                walk.back_to(again.begins);
                walk.run_to(again.ends.max(accepted + 1), &mut |values, k| input(start, values, k));
                walk.values.truth(accepted)
            });
        }
        walk.run(&mut |values, k| input(start, values, k));
        self.write(sizes, start, (0..self.recording.n_output()).map(|k| walk.output(k)));
    }

    /// What a start or an event is given, without draws.
    pub(super) fn given<S: StartScalar>(&self, sizes: &ViewSizes, start: &Start<'_, S>, given: &mut Vec<S>) {
        given.extend([start.difficulty, start.event_at]);
        given.extend_from_slice(start.state);
        given.extend_from_slice(&start.goal[..self.n_goal]);
        given.extend_from_slice(&start.task_state[..sizes.task_state]);
        given.extend_from_slice(start.numbers);
    }

    /// Writes results where they go.
    pub(super) fn write<S: StartScalar>(
        &self,
        sizes: &ViewSizes,
        start: &mut Start<'_, S>,
        mut results: impl Iterator<Item = S>,
    ) {
        let mut next = || results.next().unwrap_or(S::zero());
        start.event_at = next();
        start.state.iter_mut().for_each(|x| *x = next());
        let goal: Vec<S> = (0..self.n_goal(sizes)).map(|_| next()).collect();
        if self.n_goal == 0 {
            start.goal.write(&self.goal, goal);
        } else {
            start.goal[..goal.len()].copy_from_slice(&goal);
        }
        start.task_state[..sizes.task_state].iter_mut().for_each(|x| *x = next());
        start.numbers.iter_mut().for_each(|x| *x = next());
    }
}
