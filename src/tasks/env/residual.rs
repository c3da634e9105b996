//! Actions as changes of what a controller commands: u = u_c + share · a, clipped (Johannink et al. 2019, "Residual
//! Reinforcement Learning for Robot Control").
//!
//! The controller is the task's own ([`BaselineControllers`]), as it is in [`Baseline`](crate::Baseline) but for one thing: it knows
//! the nominal numbers, not those of the episode. What differs is there to be learnt.

use super::block::take;
use super::block::{EnvBlock, episode_state};
use super::core::Core;
use super::layout::Kept;
use super::mask::lanes_of;
use super::transition;
use crate::baseline_controllers::BaselineControllers;
use crate::config::EnvConfig;
use crate::robot::{DronePlace, Robot};
use crate::task::TaskReference;
use autodiff::program::BLOCK;
use autodiff::{Scalar, Trace};
use base::error::{Error, Result};
use controllers::cascade::Level;

const WITHOUT: &str = "Leave it out: actions are then the commands themselves.";

/// How far actions reach beside the controller's commands.
#[derive(Debug, Clone)]
pub(crate) struct Residual {
    share: f32,
    /// Of all agents' commands in the input, in rows of the widest one's.
    places: Vec<Option<usize>>,
    dt: f64,
}

impl Residual {
    /// `None` where actions are all there is.
    ///
    /// # Errors
    /// [`Error::Value`] in a control mode, for a task without a controller, and for a controller whose commands depend on
    /// earlier steps: environments could not go on with the same bits from what they save.
    pub(crate) fn of(config: &EnvConfig, robot: &Robot) -> Result<Option<Self>> {
        let share = config.residual;
        if share == 0.0 {
            return Ok(None);
        }
        let refuse = |value: String, limit: &str| Err(Error::value("residual", value, limit, WITHOUT));
        if config.control != Level::Rotor {
            return refuse(format!("{share} with control '{}'", config.control.name()), "with control 'rotor'");
        }
        let widest = robot.drones().iter().map(DronePlace::n_action).fold(0, usize::max);
        let places = robot.command_places(widest).collect();
        let own = Self { share: share as f32, places, dt: config.dt };
        let crew = own.crew(robot)?;
        if crew.remembers() {
            let what = format!("{share} around the controller '{}'", crew.name());
            return refuse(what, "around one whose commands depend on the moment alone");
        }
        Ok(Some(own))
    }

    fn crew(&self, robot: &Robot) -> Result<BaselineControllers> {
        BaselineControllers::of(robot, &robot.parameters(), self.dt, None)
    }

    /// Adds inputs that controllers command to the commands of a recording.
    pub(crate) fn correct(&self, commanded: &[Trace], command: &mut [Trace]) {
        let share = Trace::constant(f64::from(self.share));
        for (action, place) in command.iter_mut().zip(&self.places) {
            place.iter().for_each(|place| *action = corrected(commanded[*place], share, *action));
        }
    }

    /// What one worker needs.
    pub(crate) fn lead(&self, robot: &Robot) -> BaseController {
        // it could be made when the environment was, of the same numbers
        let crew = self.crew(robot).unwrap_or(BaselineControllers::Nobody);
        BaseController { crew, state: vec![0.0; robot.n_state()], input: robot.hover_input() }
    }
}

/// The controllers of every environment, one after the other, for they remember nothing.
pub(crate) struct BaseController {
    crew: BaselineControllers,
    state: Vec<f64>,
    input: Vec<f64>,
}

impl BaseController {
    /// Adds what the controllers command to the commands of these lanes.
    pub(crate) fn add_to(&mut self, command: &mut [[f32; BLOCK]], core: &Core, block: &mut EnvBlock, lanes: u64) {
        let Some(own) = &core.residual else { return };
        for lane in lanes_of(lanes) {
            let reference = block.references[lane]
                .get_or_insert_with(|| Box::new(reference(core, core.layout.kept.beginning.of(&block.kept), lane)));
            let time = f64::from(block.kept[episode_state::STEP][lane]) * own.dt;
            take(&block.plant.rows, lane, &mut self.state);
            self.crew.fly(core.robot(), reference, time, &self.state, &mut self.input);
            for (row, place) in command.iter_mut().zip(&own.places) {
                let Some(place) = place else { continue };
                row[lane] = corrected(self.input[*place] as f32, own.share, row[lane]);
            }
        }
    }
}

/// u of u_c, share and a.
fn corrected<S: Scalar>(commanded: S, share: S, action: S) -> S {
    (commanded + share * action).clamp(-S::one(), S::one())
}

/// What controllers track in an episode that began so.
fn reference(core: &Core, beginning: &[[f32; BLOCK]], lane: usize) -> TaskReference {
    let numbers: Vec<f64> = beginning.iter().map(|row| f64::from(row[lane])).collect();
    let (state, goal) = numbers.split_at(core.robot().n_state());
    transition::reference(core, state, goal).unwrap_or(TaskReference::point([0.0; 3], 0.0))
}

/// Refuses a task that says nothing for controllers to track.
///
/// # Errors
/// [`Error::Value`].
pub(crate) fn check_reference(core: &Core, task: &str) -> Result<()> {
    let ideal = transition::ideal(core);
    if core.residual.is_none() || transition::reference(core, &ideal.state, &ideal.goal).is_some() {
        return Ok(());
    }
    let limit = "a task with a reference that controllers track";
    Err(Error::value("residual", format!("in {task}"), limit, WITHOUT))
}

impl EnvBlock {
    /// Keeps what the reference of a lane's new episode follows from.
    pub(crate) fn keep_beginning(&mut self, layout: &Kept, lane: usize) {
        let Some(own) = self.references.get_mut(lane) else { return };
        *own = None;
        let n_state = layout.beginning.len() - layout.goal.len();
        let from = self.plant.rows[..n_state].iter().chain(layout.goal.of(&self.kept));
        let now: Vec<f32> = from.map(|row| row[lane]).collect();
        layout.beginning.of_mut(&mut self.kept).iter_mut().zip(now).for_each(|(row, x)| row[lane] = x);
    }
}
