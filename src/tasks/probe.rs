//! Tasks whose value is known in closed form: what learners are judged by.
//!
//! Time that runs out is not death. In [`Probe::forever`] every step pays 1 and episodes are cut after ten: the value of its one
//! state is 1/(1 − γ), 100 at γ = 0.99. Who takes the cut for an end learns 9.2 (one-step targets, 1/(1 − 0.9 γ)) or 5.3
//! (Monte-Carlo returns). In [`Probe::either_or`] whole episodes pay 0 or 1, and the observation says which: the value of either
//! kind of state is that of paying for ever, and the advantage of a step of one episode may not contain rewards of the next
//! (the trace of GAE runs on where only terminations cut it).

use crate::config::EnvConfig;
use crate::declare::{Ends, Writer};
use crate::robot::Robot;
use crate::start::Start;
use crate::task::{Task, View};
use autodiff::{Scalar, Trace, TraceMask};
use base::error::Result;
use dynamics::Effects;

/// Steps until both are cut.
pub const CUT: usize = 10;

/// A vehicle in free space that nothing is asked of.
fn idle(config: &EnvConfig) -> Result<Robot> {
    let physics = config.physics_with(|e| *e = Effects::none());
    Robot::of_vehicle(&config.vehicle("hummingbird")?, physics)
}

/// Episodes that pay their kind in every step, cut after `CUT`.
#[derive(Debug, Clone)]
pub struct Probe {
    robot: Robot,
    /// Whether kinds are drawn, 0 or 1, or always 1.
    drawn: bool,
}

impl Probe {
    /// One state, reward 1 for ever: its value is 1/(1 − γ).
    ///
    /// # Errors
    /// None for a valid configuration.
    pub fn forever(config: &EnvConfig) -> Result<Self> {
        Ok(Self { robot: idle(config)?, drawn: false })
    }

    /// Episodes of reward 0 or of reward 1, drawn at their start and observed.
    ///
    /// # Errors
    /// None for a valid configuration.
    pub fn either_or(config: &EnvConfig) -> Result<Self> {
        Ok(Self { robot: idle(config)?, drawn: true })
    }
}

impl Task for Probe {
    fn robot(&self) -> &Robot {
        &self.robot
    }

    fn horizon(&self) -> usize {
        CUT
    }

    fn start(&self, start: &mut Start<'_>) {
        let kind = if self.drawn { start.task.below(2) } else { Trace::one() };
        start.goal.field("kind", "-", "0 or 1").number(kind);
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("kind", "-", "0 or 1").within(0.0, 1.0).number(view.goal[0]);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        terms.term("pay", "kind", 1.0).number(view.goal[0]);
    }

    fn ends(&self, _: &View, _: &mut Ends) {}

    fn success(&self, _: &View) -> TraceMask {
        Trace::one().lt(Trace::zero())
    }

    fn ideal(&self, start: &mut Start<'_>) {
        start.goal.field("kind", "-", "0 or 1").number(1.0);
    }
}
