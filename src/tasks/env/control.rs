//! From an agent's numbers to rotor actions: spaces, clipping, delay, and the cascade in the control modes.

use super::block::{EnvBlock, Workspace, episode_state};
use crate::autodiff::lanes::{Lanes, RegisterKernel, each_register, to_columns};
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Mask, Scalar, StridedView, StridedViewMut, safe};
use crate::controllers::action::ActionScale;
use crate::controllers::attitude::AttitudeCommand;
use crate::controllers::cascade::{CascadeModel, Latched, Level};
use crate::controllers::kinematics::Kinematics;
use crate::controllers::rate::RateCommand;
use crate::dynamics::GRAVITY;
use crate::dynamics::batch::Plant;
use crate::dynamics::frame::{FRAME, Frame};
use crate::dynamics::rotor::{holding_action, thrust_action};
use crate::dynamics::spatial::rotate_back;
use crate::error::{Error, Result};
use crate::tasks::config::{ActionSpace, EnvConfig};
use crate::tasks::robot::{DronePlace, Robot};

/// Rotor slots of the compiled cascades.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "one per batch")]
enum Cascades {
    Four(CascadeModel<f64, 4>),
    Eight(CascadeModel<f64, 8>),
    Sixteen(CascadeModel<f64, 16>),
}

/// How actions of a robot become inputs of its system.
#[derive(Debug, Clone)]
pub(crate) struct Control {
    level: Level,
    scale: ActionScale,
    space: ActionSpace,
    cascades: Option<Cascades>,
    /// The same cascade for recordings, which come out alike for any number of slots.
    recorded: Option<Box<CascadeModel<f64, MAX_SLOTS>>>,
    /// Commands of the agent that has most.
    pub n_command: usize,
    /// Those of each agent; what stands behind them in its row moves nothing.
    pub n_command_of: Vec<usize>,
    /// What agents do where their action is not a number: a row for each.
    pub safe: Vec<f64>,
    /// Names of the commands of the agent that has most.
    pub names: Vec<String>,
    /// Per agent: places of its rotors, then drives, in the input.
    inputs: Vec<Vec<usize>>,
    /// Computations per step.
    pub steps: usize,
}

impl Control {
    pub(crate) fn new(config: &EnvConfig, robot: &Robot) -> Result<Self> {
        let level = config.control;
        let inputs = robot.drones().iter().map(|drone| drone.commands().collect()).collect();
        let mut own = Self {
            level,
            scale: config.action_scale,
            space: config.actions,
            cascades: None,
            recorded: None,
            n_command: 4,
            n_command_of: vec![4; robot.drones().len()],
            safe: Vec::new(),
            names: Vec::new(),
            inputs,
            steps: config.control_steps(),
        };
        match level {
            Level::Rotor => own.direct(robot, config.residual > 0.0)?,
            _ => own.cascaded(robot)?,
        }
        own.fits()?;
        Ok(own)
    }

    fn direct(&mut self, robot: &Robot, residual: bool) -> Result<()> {
        self.n_command_of = robot.drones().iter().map(DronePlace::n_action).collect();
        self.n_command = self.n_command_of.iter().copied().fold(0, usize::max);
        let widest = robot.drones().iter().find(|drone| drone.n_action() == self.n_command);
        let (rotors, drives) = widest.map_or((0, 0), |drone| (drone.rotors.len(), drone.drives.len()));
        self.names.extend((0..rotors).map(|i| format!("rotor_{i}")));
        self.names.extend((0..drives).map(|i| format!("drive_{i}")));
        for drone in robot.drones() {
            let first = self.safe.len();
            self.safe.extend(drone.rotors.iter().map(|r| holding_action(r.max_speed, robot.rest()[r.speed])));
            self.safe.resize(first + self.n_command, 0.0);
        }
        if residual {
            self.safe.fill(0.0);
        }
        Ok(())
    }

    fn cascaded(&mut self, robot: &Robot) -> Result<()> {
        let Some(vehicle) = &robot.vehicle else {
            let remedy = "Use control = 'rotor', or a vehicle with fixed rotors.";
            return Err(Error::value("control", self.level.name(), "'rotor' for drones with tilting rotors", remedy));
        };
        let gains = vehicle.gains();
        self.cascades = Some(match vehicle.n_rotor() {
            0..=4 => Cascades::Four(CascadeModel::new(vehicle, &gains)?),
            5..=8 => Cascades::Eight(CascadeModel::new(vehicle, &gains)?),
            _ => Cascades::Sixteen(CascadeModel::new(vehicle, &gains)?),
        });
        self.recorded = Some(Box::new(CascadeModel::new(vehicle, &gains)?));
        let weight = vehicle.mass_properties().mass * GRAVITY;
        let lift: f64 = vehicle.upright().rotors.iter().map(|r| r.max_thrust() * r.axis[2]).sum();
        let hover = thrust_action(weight / lift);
        let (names, safe) = match self.level {
            Level::Rate => (["rate_x", "rate_y", "rate_z", "thrust"], [0.0, 0.0, 0.0, hover]),
            Level::Attitude => (["thrust", "yaw_rate", "roll", "pitch"], [hover, 0.0, 0.0, 0.0]),
            Level::Velocity => (["velocity_x", "velocity_y", "velocity_z", "yaw"], [0.0; 4]),
            _ => (["offset_x", "offset_y", "offset_z", "yaw"], [0.0; 4]),
        };
        self.names = names.map(String::from).to_vec();
        self.safe = safe.repeat(self.inputs.len());
        Ok(())
    }

    /// Joint discretisation grows with the power of the commands.
    fn fits(&self) -> Result<()> {
        if let ActionSpace::Discrete { levels } = self.space {
            let values = (levels as f64).powi(self.n_command as i32);
            if values > MAX_VALUES {
                let value = format!("{levels} levels of {} commands, {values:.0} values", self.n_command);
                let remedy = "Use actions = { kind = 'multi_discrete', levels = .. }.";
                return Err(Error::limit("discrete actions", value, format!("{MAX_VALUES} values"), remedy));
            }
            if self.n_command_of.iter().any(|n| *n != self.n_command) {
                let value = format!("one choice for {:?} commands of the agents", self.n_command_of);
                let remedy = "Use actions = { kind = 'multi_discrete', levels = .. }.";
                return Err(Error::value("discrete actions", value, "agents with equally many commands", remedy));
            }
        }
        Ok(())
    }

    /// Numbers of one agent's action.
    pub(crate) fn n_action(&self) -> usize {
        if matches!(self.space, ActionSpace::Discrete { .. }) { 1 } else { self.n_command }
    }

    /// Row-major actions of up to sixty-four environments into command rows, and how many of each were changed. Lanes
    /// behind the last environment get zeros, not what another block left.
    pub(crate) fn decode(&self, actions: &[f32], work: &mut Workspace, episode: &mut [[f32; BLOCK]]) {
        let n_agent = self.inputs.len();
        let n = n_agent * self.n_action();
        match self.space {
            ActionSpace::Continuous => {
                to_columns(actions, &mut work.action);
                let n_lane = (actions.len() / n).min(BLOCK);
                work.action.iter_mut().for_each(|column| column[n_lane..].fill(0.0));
                let clip = Clip { control: self, action: &work.action, command: &mut work.command, episode };
                each_register(n_lane, clip);
                // behind the last register stands what another block left, and it would be saved
                work.command.iter_mut().for_each(|column| column[n_lane..].fill(0.0));
            }
            ActionSpace::Discrete { levels } | ActionSpace::MultiDiscrete { levels } => {
                let joint = self.n_action() == 1 && self.n_command > 1;
                let n_lane = (actions.len() / n).min(BLOCK);
                work.command.iter_mut().for_each(|column| column[n_lane..].fill(0.0));
                for (lane, row) in actions.chunks_exact(n).enumerate() {
                    let mut changed = 0;
                    for agent in 0..n_agent {
                        let own = &row[agent * self.n_action()..(agent + 1) * self.n_action()];
                        let out = &mut work.command[agent * self.n_command..(agent + 1) * self.n_command];
                        changed += self.pick(agent, own, levels, joint, |k, x| out[k][lane] = x);
                    }
                    episode[episode_state::CLIPPED][lane] = changed as f32;
                }
            }
        }
    }

    /// Commands of one agent's whole numbers; returns how many were out of range.
    fn pick(&self, agent: usize, own: &[f32], levels: usize, joint: bool, mut put: impl FnMut(usize, f32)) -> usize {
        let safe = &self.safe[agent * self.n_command..];
        let most = if joint { levels.pow(self.n_command as u32) } else { levels } - 1;
        let level = |digit: usize| 2.0 * digit as f32 / (levels - 1) as f32 - 1.0;
        let mut changed = 0;
        for (i, number) in own.iter().take(self.n_command_of[agent]).enumerate() {
            let whole = number.round().clamp(0.0, most as f32);
            changed += usize::from(*number != whole);
            let mut rest = whole as usize;
            if !number.is_finite() {
                let which = if joint { 0..self.n_command } else { i..i + 1 };
                which.for_each(|k| put(k, safe[k] as f32));
            } else if joint {
                for k in (0..self.n_command).rev() {
                    put(k, level(rest % levels));
                    rest /= levels;
                }
            } else {
                put(i, level(rest));
            }
        }
        changed
    }

    /// Input rows of computation `step` of this step. Needs frames in all modes but rotor.
    pub(crate) fn steer(&self, robot: &Robot, plant: &Plant, step: usize, block: &mut EnvBlock, work: &mut Workspace) {
        match &self.cascades {
            None if step > 0 => {}
            None => {
                for (agent, inputs) in self.inputs.iter().enumerate() {
                    for (k, input) in inputs.iter().enumerate() {
                        block.plant.rows[plant.input_row(*input)] = work.command[agent * self.n_command + k];
                    }
                }
            }
            Some(Cascades::Four(model)) => self.cascade(model, robot, plant, step, block, work),
            Some(Cascades::Eight(model)) => self.cascade(model, robot, plant, step, block, work),
            Some(Cascades::Sixteen(model)) => self.cascade(model, robot, plant, step, block, work),
        }
    }

    fn cascade<const R: usize>(
        &self,
        model: &CascadeModel<f64, R>,
        robot: &Robot,
        plant: &Plant,
        step: usize,
        block: &mut EnvBlock,
        work: &mut Workspace,
    ) {
        each_register(block.plant.occupied, Steer { control: self, model, robot, plant, step, block, work });
    }

    /// Whether [`Control::steer`] reads frames.
    pub(crate) fn needs_frames(&self) -> bool {
        self.cascades.is_some()
    }

    /// As [`Control::steer`] for one environment over any scalar: commands (clipped) of all agents to inputs.
    pub(crate) fn steer_one<S: Scalar>(
        &self,
        robot: &Robot,
        step: usize,
        frames: &StridedView<'_, S>,
        commands: &[S],
        held: &mut [S],
        input: &mut [S],
    ) {
        let n = self.n_command;
        for agent in 0..self.inputs.len() {
            let own = &commands[agent * n..(agent + 1) * n];
            let frame = Frame::read(&frames.from(robot.drones()[agent].frame * FRAME));
            let first = agent * LATCHED_PER_AGENT;
            let held = &mut held[first..first + LATCHED_PER_AGENT];
            let out = &mut input[..];
            match &self.recorded {
                None => {
                    for (k, place) in self.inputs[agent].iter().enumerate() {
                        out[*place] = own[k];
                    }
                }
                Some(model) => {
                    let model = CascadeModel::<S, MAX_SLOTS>::constant(model);
                    S::function(held, |held| {
                        let before = Latched::read(held);
                        self.compute(&model, step, &frame, [own[0], own[1], own[2], own[3]], &before).write(held);
                    });
                    let rotors = Latched::<S, MAX_SLOTS>::read(held).rotors;
                    for (k, place) in self.inputs[agent].iter().enumerate() {
                        out[*place] = rotors[k];
                    }
                }
            }
        }
    }

    /// One computation of the cascade. Velocity and position are computed in the first of a step and held.
    #[inline(always)]
    fn compute<S: Scalar, const R: usize>(
        &self,
        model: &CascadeModel<S, R>,
        step: usize,
        frame: &Frame<S>,
        command: [S; 4],
        held: &Latched<S, R>,
    ) -> Latched<S, R> {
        let state = model.own(&kinematics(frame));
        let one = S::one();
        let first = if step == 0 { one } else { S::zero() };
        let ticks = [first, one, one];
        let total = model.limits.thrust;
        match self.level {
            Level::Rotor | Level::Rate => model.rate(&state, held, &self.scale.rate(command, total), ticks),
            Level::Attitude => {
                // the heading of the command is that of the first computation
                let fresh = self.scale.attitude(command, total, state.attitude);
                let wanted = if step == 0 { fresh } else { held.attitude };
                model.attitude(&state, held, &wanted, ticks)
            }
            Level::Velocity => model.velocity(&state, held, &self.scale.velocity(command), ticks),
            Level::Position => model.position(&state, held, &self.scale.position(command, state.position), ticks),
        }
    }
}

/// Most rotor slots.
const MAX_SLOTS: usize = 16;
/// Numbers that the cascade of one drone holds within a step: attitude command, rate command, rotors.
const LATCHED: usize = 16 + 7;
pub(crate) const LATCHED_PER_AGENT: usize = LATCHED + MAX_SLOTS;

/// Most values of a joint discrete action: they are exact in `f32`.
const MAX_VALUES: f64 = 65_536.0;

#[inline(always)]
fn kinematics<S: Scalar>(frame: &Frame<S>) -> Kinematics<S> {
    Kinematics {
        position: frame.position,
        velocity: frame.velocity,
        attitude: frame.attitude,
        angular_velocity: rotate_back(frame.attitude, frame.angular_velocity),
    }
}

/// A number within [−1, 1], or the safe one where it is not finite; and whether that changed it.
#[inline(always)]
pub(crate) fn clipped<S: Scalar>(a: S, safe_command: f64) -> (S, S::Mask) {
    let finite = safe::is_bounded(a, f64::from(f32::MAX));
    let used = S::select(finite, a.clamp(-S::one(), S::one()), S::constant(safe_command));
    (used, a.lt(used).or(used.lt(a)).or(finite.not()))
}

/// Clips a block's actions.
struct Clip<'a> {
    control: &'a Control,
    action: &'a [[f32; BLOCK]],
    command: &'a mut [[f32; BLOCK]],
    episode: &'a mut [[f32; BLOCK]],
}

impl RegisterKernel for Clip<'_> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let n = self.control.n_command;
        let actions = L::rows(self.action, at);
        let mut commands = L::rows_mut(self.command, at);
        let mut changed = L::zero();
        for agent in 0..self.control.inputs.len() {
            for k in 0..self.control.n_command_of[agent] {
                let (used, differs) = clipped(actions.get(agent * n + k), self.control.safe[agent * n + k]);
                commands.set(agent * n + k, used);
                changed += L::select(differs, L::one(), L::zero());
            }
            for k in self.control.n_command_of[agent]..n {
                commands.set(agent * n + k, L::zero());
            }
        }
        L::rows_mut(self.episode, at).set(episode_state::CLIPPED, changed);
    }
}

/// One computation of the cascades of a block.
struct Steer<'a, const R: usize> {
    control: &'a Control,
    model: &'a CascadeModel<f64, R>,
    robot: &'a Robot,
    plant: &'a Plant,
    step: usize,
    block: &'a mut EnvBlock,
    work: &'a mut Workspace,
}

impl<const R: usize> RegisterKernel for Steer<'_, R> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let control = self.control;
        let model = CascadeModel::<L, R>::constant(self.model);
        for agent in 0..control.inputs.len() {
            let frames = L::rows(&self.work.frames, at);
            let frame = Frame::read(&frames.from(self.robot.drones()[agent].frame * FRAME));
            let command = L::rows(&self.work.command, at).array(agent * 4);
            let mut held = L::rows_mut(&mut self.work.held, at);
            let first = agent * LATCHED_PER_AGENT;
            let new = control.compute(&model, self.step, &frame, command, &read_latched(&held.rows().from(first)));
            write_latched(&new, &mut held, first);
            let mut input = L::rows_mut(&mut self.block.plant.rows, at);
            for k in 0..control.inputs[agent].len() {
                input.set(self.plant.input_row(control.inputs[agent][k]), new.rotors[k]);
            }
        }
    }
}

#[inline(always)]
fn read_latched<S: Scalar, const R: usize>(rows: &StridedView<'_, S>) -> Latched<S, R> {
    Latched {
        attitude: AttitudeCommand::read(&rows.array::<16>(0)),
        rate: RateCommand::read(&rows.array::<7>(16)),
        rotors: rows.array(LATCHED),
    }
}

#[inline(always)]
fn write_latched<S: Scalar, const R: usize>(held: &Latched<S, R>, rows: &mut StridedViewMut<'_, S>, first: usize) {
    let (mut attitude, mut rate) = ([S::zero(); 16], [S::zero(); 7]);
    held.attitude.write(&mut attitude);
    held.rate.write(&mut rate);
    let mut writer = rows.writer(first);
    writer.array(attitude);
    writer.array(rate);
    writer.array(held.rotors);
}
