//! One step of sixty-four environments in lanes: the phases, then ends and restarts.

use super::block::{EnvBlock, Workspace, episode_state, signal};
use super::buffers::StepOut;
use super::core::Core;
use super::gradient::Slot;
use super::mask::lanes_of;
use super::step::{Phases, step};
use super::transform::Shift;
use super::transition::StepLayout;
use crate::autodiff::lanes::{each_register, first_lanes, ones};
use crate::dynamics::batch::{Culprit, STOPPED};
use crate::tasks::bounds::Contain;
use crate::tasks::config::Autoreset;

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
}

impl Stepper<'_> {
    /// Environments that are real: those behind are padding.
    pub(crate) fn n(&self) -> usize {
        self.block.plant.occupied
    }

    /// One step of the block.
    pub(crate) fn step(&mut self, out: &mut StepOut<'_>, mut slot: Option<(&StepLayout, &mut Slot)>) {
        let (core, real) = (self.core, first_lanes(self.n()));
        self.running = ones(&self.block.episode_state[episode_state::RUNNING]) & real;
        if let Some((layout, slot)) = &mut slot {
            slot.open(layout, self.block, self.running);
        }
        self.block.moved = if slot.is_some() { 0 } else { u64::MAX };
        self.keep_frames(slot.is_some());
        step(core, self);
        if let Some((layout, slot)) = slot {
            slot.close(layout, self.block, self.work, self.ended, self.alive());
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

    /// Frames, observations and central states of the registers of these lanes: what did not change keeps its bits.
    pub(crate) fn look(&mut self, lanes: u64) {
        self.core.plant.frames(&self.block.plant, lanes, &mut self.work.frames);
        self.show_all(lanes);
    }

    /// What tasks show, and behind it what sensors read.
    fn show_all(&mut self, lanes: u64) {
        let s = &self.core.sizes;
        self.core.engine.observe_lanes(s, self.block, self.work, lanes);
        for agent in 0..s.agent {
            let rows = &mut self.work.raw[agent * s.raw..][s.raw - s.reading..s.raw];
            rows.copy_from_slice(&self.block.readings[agent * s.reading..][..s.reading]);
        }
    }

    fn alive(&self) -> u64 {
        ones(&self.block.plant.rows[self.core.plant.alive_row()])
    }

    fn keep_speeds(&mut self) {
        for (row, speed) in self.work.speeds.iter_mut().zip(&self.core.speed_rows) {
            *row = self.block.plant.rows[*speed];
        }
    }

    /// Keeps what broke in lanes that stopped; those that physics had `given_up` stand before their last step.
    fn blame(&mut self, stopped: u64, given_up: u64) {
        let (plant, limits) = (&self.core.plant, &self.core.limits);
        let (block, after) = (&mut self.block.plant, &mut self.work.after);
        if given_up != 0 {
            plant.follow(block, given_up, after);
        }
        for lane in lanes_of(stopped) {
            let after = if given_up >> lane & 1 == 1 { &*after } else { &block.rows };
            let own = Culprit::of(limits.iter().copied(), &block.rows, after, lane);
            self.block.broken[lane] = own.or_else(|| plant.exploded(&block.rows, after, lane));
        }
    }

    /// Environments stand still where their episode ended.
    fn stop(&mut self) {
        let alive = self.core.plant.alive_row();
        for lane in lanes_of(self.ended) {
            self.block.episode_state[episode_state::RUNNING][lane] = 0.0;
            self.block.plant.rows[alive][lane] = STOPPED;
        }
    }
}

impl Phases for Stepper<'_> {
    fn command(&mut self) {
        let (core, block) = (self.core, &mut *self.block);
        core.control.decode(self.actions, self.work, &mut block.episode_state);
        if core.sizes.delay > 0 {
            let (slots, n) = (core.sizes.delay, core.sizes.command);
            each_register(block.plant.occupied, Shift { slots, n, block, command: &mut self.work.command });
        }
        if let Some(lead) = &mut self.work.lead {
            lead.add_to(&mut self.work.command, core, self.block, self.running);
        }
        self.keep_speeds();
    }

    fn frames(&mut self) {
        self.core.plant.frames(&self.block.plant, u64::MAX, &mut self.work.frames);
    }

    fn disturb(&mut self) {
        self.core.engine.disturb_lanes(self.block, self.work, &self.core.disturbance_rows);
    }

    fn steer(&mut self, k: usize) {
        self.core.control.steer(self.core.robot(), &self.core.plant, k, self.block, self.work);
    }

    fn physics(&mut self) {
        self.core.plant.step(std::slice::from_mut(&mut self.block.plant));
    }

    /// What has exploded stops. A state of any size would reach the observation that its episode ends with.
    fn contain(&mut self) {
        let given_up = !self.alive() & self.running;
        let (limits, alive, plant) = (&self.core.limits, self.core.plant.alive_row(), &mut self.block.plant);
        each_register(plant.occupied, Contain { limits, alive, rows: &mut plant.rows });
        let stopped = !self.alive() & self.running;
        if stopped != 0 {
            self.blame(stopped, given_up);
        }
        for lane in lanes_of(stopped) {
            self.block.plant.rows.iter_mut().zip(self.core.robot().rest()).for_each(|(row, x)| row[lane] = *x as f32);
        }
    }

    fn sense(&mut self) {
        self.sense_after(self.running);
    }

    fn evaluate_step(&mut self) {
        self.core.engine.evaluate_lanes(self.core, self.block, self.work);
        let signals = &self.work.signals;
        self.ended = (ones(&signals[signal::TERMINATED]) | ones(&signals[signal::TRUNCATED])) & self.running;
    }

    fn change_goals(&mut self) {
        let due = ones(&self.work.signals[signal::DUE]) & self.running & !self.ended;
        if due != 0 {
            lanes_of(due).for_each(|lane| self.event(lane));
            // numbers that changed may move bodies
            self.frames();
        }
    }

    fn observe(&mut self) {
        self.show_all(u64::MAX);
    }

    fn transform(&mut self) {
        self.transformed(self.running, 0);
    }
}
