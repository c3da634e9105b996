//! One step of sixty-four environments: programs, and the host code between them; then ends and restarts.

use super::block::{EnvBlock, Workspace, episode_state, signal};
use super::buffers::StepOut;
use super::core::Core;
use super::gradient::TapeEntry;
use super::mask::lanes_of;
use super::transition::StepLayout;
use crate::config::Autoreset;
use autodiff::lanes::{first_lanes, ones, to_columns};
use autodiff::native::WIDEST;
use dynamics::batch::{RawBreach, STOPPED};
use std::ops::Range;

/// A block in the hands of a worker.
pub(crate) struct Stepper<'a> {
    pub core: &'a Core,
    pub block: &'a mut EnvBlock,
    pub work: &'a mut Workspace,
    /// Number of its first environment in the batch.
    pub first: usize,
    /// Of the coming step.
    pub actions: &'a [f32],
    /// Environments whose episode runs at the start of the step, and those of them where it ends in it.
    pub running: u64,
    pub ended: u64,
    /// Environments whose flags say so behind the step, also where their episode had ended before.
    pub terminated: u64,
    pub truncated: u64,
}

impl<'a> Stepper<'a> {
    pub(crate) fn new(
        core: &'a Core,
        block: &'a mut EnvBlock,
        work: &'a mut Workspace,
        first: usize,
        actions: &'a [f32],
    ) -> Self {
        Self { core, block, work, first, actions, running: 0, ended: 0, terminated: 0, truncated: 0 }
    }
}

impl Stepper<'_> {
    /// Environments that are real: those behind are padding.
    pub(crate) fn n(&self) -> usize {
        self.block.plant.occupied
    }

    /// One step of the block.
    pub(crate) fn step(&mut self, out: &mut StepOut<'_>, mut slot: Option<(&StepLayout, &mut TapeEntry)>) {
        let (core, real) = (self.core, first_lanes(self.n()));
        self.running = ones(&self.block.kept[episode_state::RUNNING]) & real;
        if let Some((layout, slot)) = &mut slot {
            slot.open(layout, core, self.block, self.running);
        }
        self.block.moved = if slot.is_some() { 0 } else { u64::MAX };
        self.keep_frames(slot.is_some());
        self.act();
        self.advance();
        if let Some((layout, slot)) = slot {
            slot.close(layout, core, self.block, self.work, self.ended, self.alive());
        }
        self.write_signals(out);
        lanes_of(self.ended).for_each(|lane| self.write_end(lane, out));
        let restarts = match core.mode {
            Autoreset::SameStep => self.ended,
            Autoreset::NextStep => !self.running & real,
            Autoreset::Disabled => 0,
        };
        if core.mode != Autoreset::SameStep {
            self.stop();
        }
        self.begin(restarts);
        if core.mode == Autoreset::NextStep {
            lanes_of(restarts).for_each(|lane| self.clear(lane, out));
        }
        self.write_observation(out);
    }

    /// Restarts the lanes of a mask with their next episode and shows them.
    pub(crate) fn reset(&mut self, which: u64, out: &mut StepOut<'_>) {
        let which = which & first_lanes(self.n());
        self.block.moved |= which;
        self.begin(which);
        lanes_of(which).for_each(|lane| self.write_start(lane, out));
    }

    /// Observations and central states of a block as it stands, into all rows.
    pub(crate) fn show(&mut self, out: &mut StepOut<'_>) {
        self.keep_speeds();
        self.look(u64::MAX);
        self.transformed(0, 0);
        self.write_observation(out);
    }

    /// Observations and central states of the registers of these lanes: what did not change keeps its bits.
    pub(crate) fn look(&mut self, lanes: u64) {
        let (core, n) = (self.core, self.n());
        for lanes in registers_of(lanes, n) {
            core.programs().observe.run(&mut self.work.scratch.observe, core, self.block, &mut self.work.rows, lanes);
        }
        self.show_readings();
    }

    /// Where the bodies of these lanes are, for sensors.
    pub(crate) fn find_frames(&mut self, lanes: u64) {
        let (core, n) = (self.core, self.n());
        let Some(program) = &core.programs().frames else { return };
        for lanes in registers_of(lanes, n) {
            program.run(&mut self.work.scratch.frames, core, self.block, &mut self.work.rows, lanes);
        }
    }

    /// What sensors read, behind what tasks show.
    pub(crate) fn show_readings(&mut self) {
        let (s, layout) = (&self.core.sizes, &self.core.layout);
        if s.reading == 0 {
            return;
        }
        let readings = layout.kept.readings.of(&self.block.kept).chunks_exact(s.reading);
        let shown = layout.work.raw.of_mut(&mut self.work.rows).chunks_exact_mut(s.raw);
        shown.zip(readings).for_each(|(shown, own)| shown[s.raw - s.reading..].copy_from_slice(own));
    }

    fn alive(&self) -> u64 {
        ones(&self.block.plant.rows[self.core.plant.alive_row()])
    }

    fn keep_speeds(&mut self) {
        let speeds = self.core.layout.work.speeds.of_mut(&mut self.work.rows);
        for (row, speed) in speeds.iter_mut().zip(&self.core.speed_rows) {
            *row = self.block.plant.rows[*speed];
        }
    }

    /// Keeps what broke in lanes that stopped; those that physics had `given_up` stand before their last step.
    fn record_breaches(&mut self, stopped: u64, given_up: u64) {
        let (plant, limits) = (&self.core.plant, &self.core.limits);
        let (block, after) = (&mut self.block.plant, &mut self.work.after);
        if given_up != 0 {
            plant.follow(block, given_up, after);
        }
        for lane in lanes_of(stopped) {
            let after = if given_up >> lane & 1 == 1 { &*after } else { &block.rows };
            let own = RawBreach::of(limits.iter().copied(), &block.rows, after, lane);
            self.block.broken[lane] = own.or_else(|| plant.exploded(&block.rows, after, lane));
        }
    }

    /// Environments stand still where their episode ended.
    fn stop(&mut self) {
        let alive = self.core.plant.alive_row();
        for lane in lanes_of(self.ended) {
            self.block.kept[episode_state::RUNNING][lane] = 0.0;
            self.block.plant.rows[alive][lane] = STOPPED;
        }
    }
}

impl Stepper<'_> {
    /// Actions into rows; into commands, where those are whole numbers or controllers stand behind.
    fn act(&mut self) {
        let (core, n, layout) = (self.core, self.n(), &self.core.layout);
        match core.control.levels() {
            None => {
                let rows = layout.work.action.of_mut(&mut self.work.rows);
                to_columns(self.actions, rows);
                // padding gets zeros, not what another block left
                rows.iter_mut().for_each(|column| column[n..].fill(0.0));
            }
            Some(levels) => {
                let command = layout.work.command.of_mut(&mut self.work.rows);
                self.block.kept[episode_state::CLIPPED] = core.control.decode(levels, self.actions, command);
            }
        }
        let Workspace { rows, scratch, lead, .. } = &mut *self.work;
        if let Some(act) = &core.programs().act {
            act.run(&mut scratch.act, core, self.block, rows, 0..n);
        }
        if let Some(lead) = lead {
            lead.add_to(layout.work.command.of_mut(rows), core, self.block, self.running);
        }
    }

    /// From commands to observations.
    fn advance(&mut self) {
        let (core, n) = (self.core, self.n());
        core.programs().step.run(&mut self.work.scratch.step, core, self.block, &mut self.work.rows, 0..n);
        self.settle();
        self.sense_after(self.running);
        let signals = core.layout.work.signals.of(&self.work.rows);
        let real = first_lanes(n);
        self.terminated = ones(&signals[signal::TERMINATED]) & real;
        self.truncated = ones(&signals[signal::TRUNCATED]) & real;
        self.ended = (self.terminated | self.truncated) & self.running;
        let due = ones(&signals[signal::DUE]) & self.running & !self.ended;
        // the reward was for the old goal, the next action is for the new one
        if due != 0 {
            self.happen(due);
        } else {
            self.show_readings();
        }
        self.transformed(self.running, 0);
    }

    /// Puts what has exploded to rest, as it was shown.
    fn settle(&mut self) {
        let (core, stopped) = (self.core, !self.alive() & self.running);
        if stopped == 0 {
            return;
        }
        let given_up = ones(&core.layout.work.signals.of(&self.work.rows)[signal::GAVE_UP]) & stopped;
        self.record_breaches(stopped, given_up);
        for lane in lanes_of(stopped) {
            self.block.plant.rows.iter_mut().zip(core.robot().rest()).for_each(|(row, x)| row[lane] = *x as f32);
        }
    }
}

/// The registers that hold any of these lanes, of `n` that are real.
pub(crate) fn registers_of(lanes: u64, n: usize) -> impl Iterator<Item = Range<usize>> {
    let lanes = lanes & first_lanes(n);
    let holds = move |first: &usize| lanes >> first & u64::from(u16::MAX) != 0;
    (0..n).step_by(WIDEST).filter(holds).map(move |first| first..n.min(first + WIDEST))
}
