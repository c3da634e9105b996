//! Draws of a block: those that a recorded start or event asks for, of many environments.

use super::draw_plan::Plan;
use super::mask::lanes_of;
use crate::start::STREAMS;
use autodiff::program::BLOCK;
use rng::{Words, blocks};

/// The streams of the environments of a block where something begins.
#[derive(Debug, Clone)]
pub(crate) struct BlockDraws {
    /// Those that the plan draws from, one lane after the other.
    words: Vec<Words>,
    /// How many of them are open.
    n: usize,
    /// Where the draws of the lane in hand end that may be made again.
    ends: Vec<u64>,
}

impl BlockDraws {
    pub(crate) fn new() -> Self {
        Self { words: vec![Words::restore([0; 4], 0); BLOCK * STREAMS], n: 0, ends: vec![0; STREAMS] }
    }

    /// Forgets all lanes.
    pub(crate) fn clear(&mut self) {
        self.n = 0;
    }

    /// The streams of the next lane, from these words on.
    pub(crate) fn open(&mut self, plan: &Plan, key_of: impl Fn(usize) -> [u64; 4], position: u64) {
        for stream in plan.streams() {
            self.words[self.n].restart(key_of(*stream), position);
            self.n += 1;
        }
    }

    /// Draws into rows for these of the lanes that were `opened`: everything the `first` time, then what is drawn again and what stands
    /// behind it.
    pub(crate) fn draw(&mut self, plan: &Plan, opened: u64, lanes: u64, is_first: bool, rows: &mut [[f32; BLOCK]]) {
        let (again, n) = (plan.again(), plan.draws.len());
        let first = if is_first { 0 } else { again.start };
        if is_first {
            blocks(&mut self.words[..self.n]);
        }
        let own = self.words[..self.n].chunks_exact_mut(plan.streams().len().max(1));
        for (lane, words) in lanes_of(opened).zip(own).filter(|(lane, _)| lanes >> lane & 1 == 1) {
            for k in first..n {
                if k == again.end {
                    self.ends.iter_mut().zip(&*words).for_each(|(end, words)| *end = words.position());
                }
                let (stream, drawing) = plan.draws[k];
                rows[k][lane] = drawing.rounded(|| words[stream].next_u64());
            }
            // what is drawn again goes on where it ended, whatever was drawn behind
            if again.end < n {
                words.iter_mut().zip(&self.ends).for_each(|(words, end)| words.go_to(*end));
            }
        }
    }
}
