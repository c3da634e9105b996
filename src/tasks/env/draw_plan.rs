//! What the host draws for a recorded start or event, and in which order.

use crate::start::{Drawing, ManyDraw, Source, WORDS_OF_EVENT};
use autodiff::{Mask, Scalar, Trace, TraceMask};
use base::error::{Error, Result};
use std::ops::Range;

/// The draws of a recording: those made once, those that are made again until they are accepted, and those behind.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Plan {
    /// The stream of each by its place among those drawn from, and what it is.
    pub draws: Vec<(usize, Drawing)>,
    /// Those drawn from.
    streams: Vec<usize>,
    /// Those that may be drawn again.
    again: Option<Range<usize>>,
    /// How often they are drawn at most.
    pub most: usize,
    is_twice: bool,
    /// Whether it has draws that are made on the host alone.
    is_of_host: bool,
}

impl Plan {
    /// Those drawn again; all where none is.
    pub(crate) fn again(&self) -> Range<usize> {
        self.again.clone().unwrap_or(0..self.draws.len())
    }

    /// The streams drawn from.
    pub(crate) fn streams(&self) -> &[usize] {
        &self.streams
    }

    fn add(&mut self, stream: usize, drawing: Drawing) {
        let place = self.streams.iter().position(|own| *own == stream).unwrap_or_else(|| {
            self.streams.push(stream);
            self.streams.len() - 1
        });
        self.draws.push((place, drawing));
    }

    /// Words of a stream that are drawn at most, but for numbers that are drawn again by themselves.
    fn words(&self, stream: usize) -> u64 {
        let again = self.again();
        let own = self.draws.iter().enumerate().filter(|(_, draw)| draw.0 == stream);
        own.map(|(k, (_, draw))| draw.words() * if again.contains(&k) { self.most as u64 } else { 1 }).sum()
    }

    /// The plan of `what`.
    ///
    /// # Errors
    /// [`Error::Value`] where two parts are drawn again, and for distributions that are none.
    pub(crate) fn checked(self, what: &str) -> Result<Self> {
        if self.is_twice {
            let remedy = "Ask for all of it in one part.";
            return Err(Error::value(
                format!("what is drawn again in the {what}"),
                "in several parts",
                "one part",
                remedy,
            ));
        }
        if self.is_of_host {
            return Err(of_host(what));
        }
        self.draws.iter().try_for_each(|(_, drawing)| drawing.check())?;
        Ok(self)
    }

    /// The plan of an event.
    ///
    /// # Errors
    /// As [`Plan::checked`]; [`Error::Limit`] where it would draw what belongs to the next step.
    pub(crate) fn checked_event(self) -> Result<Self> {
        let own = self.checked("event")?;
        let words = (0..own.streams.len()).map(|stream| own.words(stream)).max().unwrap_or(0);
        if words > WORDS_OF_EVENT {
            let remedy = "Draw less, or less often again: a uniform number takes two words, a normal one four.";
            return Err(Error::limit("words of a stream that an event draws", words, WORDS_OF_EVENT, remedy));
        }
        Ok(own)
    }
}

/// Refuses draws that no recording can hold.
pub(crate) fn of_host(what: &str) -> Error {
    let remedy = "Begin episodes on the host: HostStart, in Python start_on_host = True.";
    Error::value(format!("a draw of the {what}"), "one that depends on drawn numbers", "one that does not", remedy)
}

/// Makes the plan of what it records: a draw is an input.
pub(crate) struct Planner {
    /// None while it is only asked what is drawn.
    inputs: Option<Vec<Trace>>,
    pub plan: Plan,
    pub accepted: TraceMask,
}

impl Planner {
    /// Over these inputs; without any, constants stand for them.
    pub(crate) fn new(inputs: Option<Vec<Trace>>) -> Self {
        let accepted = Trace::zero().lt(Trace::one());
        Self { inputs, plan: Plan { most: 1, ..Plan::default() }, accepted }
    }
}

impl Source<Trace> for Planner {
    fn draw(&mut self, stream: usize, drawing: Drawing) -> Trace {
        let k = self.plan.draws.len();
        self.plan.add(stream, drawing);
        // who draws more than before is found by its plan
        self.inputs.as_ref().and_then(|inputs| inputs.get(k).copied()).unwrap_or(Trace::constant(0.5))
    }

    fn draw_other(&mut self, _stream: usize, _n: u64, _taken: &[Trace]) -> Trace {
        self.plan.is_of_host = true;
        Trace::zero()
    }

    fn draw_many(&mut self, _stream: usize, _drawing: &ManyDraw, _operands: &[Trace], drawn: &mut [Trace]) {
        self.plan.is_of_host = true;
        drawn.fill(Trace::zero());
    }

    fn begin_again(&mut self, most: usize) {
        self.plan.is_twice |= self.plan.again.is_some();
        self.plan.again = Some(self.plan.draws.len()..0);
        self.plan.most = most.max(1);
    }

    fn stays(&mut self, accepted: TraceMask, _is_last: bool) -> bool {
        let end = self.plan.draws.len();
        self.plan.again.iter_mut().for_each(|again| again.end = end);
        self.accepted = self.accepted.and(accepted);
        true
    }
}
