//! From an agent's numbers to rotor actions: spaces, clipping, and the cascade in the control modes. `phases` delays and steers by it.

use crate::config::{ActionSpace, EnvConfig};
use crate::robot::{DronePlace, Robot};
use autodiff::program::BLOCK;
use autodiff::{Mask, Scalar, Trace, safe};
use base::error::{Error, Result};
use controllers::action::ActionScale;
use controllers::attitude::AttitudeCommand;
use controllers::cascade::{CascadeMemory, CascadeModel, Level};
use controllers::kinematics::Kinematics;
use dynamics::GRAVITY;
use dynamics::frame::{FRAME, Frame};
use dynamics::rotor::{holding_action, thrust_action};
use dynamics::spatial::rotate_back;
use dynamics::vehicle::MAX_ROTORS;

/// How actions of a robot become inputs of its system.
#[derive(Debug, Clone)]
pub(crate) struct Control {
    level: Level,
    scale: ActionScale,
    space: ActionSpace,
    cascade: Option<Box<CascadeModel<f64, MAX_ROTORS>>>,
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
    pub(crate) fn new(config: &EnvConfig, robot: &Robot, n_agent: usize) -> Result<Self> {
        let level = config.control;
        let inputs = robot.drones().iter().map(|drone| drone.commands().collect()).collect();
        let mut own = Self {
            level,
            scale: config.action_scale,
            space: config.actions,
            cascade: None,
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
        if n_agent < own.n_command_of.len() {
            let limit = format!("at least {}, one for each drone", own.n_command_of.len());
            return Err(Error::value("agents of the task", n_agent, limit, "Let one of them command each drone."));
        }
        // an agent without a drone moves nothing
        own.n_command_of.resize(n_agent, 0);
        own.safe.resize(n_agent * own.n_command, 0.0);
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
        self.cascade = Some(Box::new(CascadeModel::new(vehicle, &vehicle.gains())?));
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

    /// Whether actions are numbers within [−1, 1], one for each command.
    pub(crate) fn is_continuous(&self) -> bool {
        self.space == ActionSpace::Continuous
    }

    /// Whole numbers of up to sixty-four environments, row-major, into command rows; returns how many of each environment's were
    /// changed. Lanes behind the last environment get zeros, not what another block left.
    pub(crate) fn decode(&self, levels: usize, actions: &[f32], command: &mut [[f32; BLOCK]]) -> [f32; BLOCK] {
        let n_agent = self.n_command_of.len();
        let (n, joint) = (n_agent * self.n_action(), self.n_action() == 1 && self.n_command > 1);
        let n_lane = (actions.len() / n).min(BLOCK);
        command.iter_mut().for_each(|column| column[n_lane..].fill(0.0));
        let mut changed = [0.0; BLOCK];
        for (lane, row) in actions.chunks_exact(n).enumerate() {
            for agent in 0..n_agent {
                let own = &row[agent * self.n_action()..(agent + 1) * self.n_action()];
                let out = &mut command[agent * self.n_command..(agent + 1) * self.n_command];
                changed[lane] += self.pick(agent, own, levels, joint, |k, x| out[k][lane] = x) as f32;
            }
        }
        changed
    }

    /// Levels of each command, where actions are whole numbers.
    pub(crate) fn levels(&self) -> Option<usize> {
        match self.space {
            ActionSpace::Continuous => None,
            ActionSpace::Discrete { levels } | ActionSpace::MultiDiscrete { levels } => Some(levels),
        }
    }

    /// Commands of one agent's whole numbers; returns how many were out of range.
    fn pick(&self, agent: usize, own: &[f32], levels: usize, joint: bool, mut put: impl FnMut(usize, f32)) -> usize {
        let safe = &self.safe[agent * self.n_command..];
        let most = if joint { levels.pow(self.n_command as u32) } else { levels } - 1;
        let level = |digit: usize| command_of(digit as f32, levels);
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

    /// As [`Control::decode`], recorded: commands of all agents, of their whole numbers.
    pub(crate) fn decoded(&self, levels: usize, actions: &[Trace]) -> Vec<Trace> {
        let (n, n_action) = (self.n_command, self.n_action());
        let mut commands = vec![Trace::zero(); n * self.n_command_of.len()];
        for (agent, own) in actions.chunks_exact(n_action).enumerate() {
            let n_own = self.n_command_of[agent];
            let per = if n_action == 1 { n } else { 1 };
            for (i, x) in own.iter().take(n_own.div_ceil(per)).enumerate() {
                let finite = safe::is_bounded(*x, f64::from(f32::MAX));
                for (k, digit) in digits(*x, levels, per).into_iter().enumerate() {
                    let place = agent * n + i * per + k;
                    let safe = Trace::constant(self.safe[place]);
                    commands[place] = Trace::select(finite, command_of(digit, levels), safe);
                }
            }
        }
        commands
    }

    /// Whether [`Control::steer`] reads frames.
    pub(crate) fn needs_frames(&self) -> bool {
        self.cascade.is_some()
    }

    /// Commands (clipped) of all agents to inputs, in the first computation of a step (`first` is 1) or a later one (0).
    pub(crate) fn steer(
        &self,
        robot: &Robot,
        first: Trace,
        frames: &[Trace],
        commands: &[Trace],
        held: &mut [Trace],
        input: &mut [Trace],
    ) {
        let n = self.n_command;
        for (agent, inputs) in self.inputs.iter().enumerate() {
            let own = &commands[agent * n..(agent + 1) * n];
            let Some(model) = &self.cascade else {
                inputs.iter().zip(own).for_each(|(place, command)| input[*place] = *command);
                continue;
            };
            let frame = Frame::read(&frames[robot.drones()[agent].frame * FRAME..]);
            let held = &mut held[agent * LATCHED_PER_AGENT..][..LATCHED_PER_AGENT];
            Trace::function(held, |held| {
                let before = CascadeMemory::read(held);
                let command = [own[0], own[1], own[2], own[3]];
                self.compute(&CascadeModel::constant(model), first, &frame, command, &before).write(held);
            });
            let rotors = CascadeMemory::<Trace, MAX_ROTORS>::read(held).rotors;
            inputs.iter().zip(rotors).for_each(|(place, rotor)| input[*place] = rotor);
        }
    }

    /// One computation of the cascade. Velocity and position are computed in the first of a step and held.
    fn compute(
        &self,
        model: &CascadeModel<Trace, MAX_ROTORS>,
        first: Trace,
        frame: &Frame<Trace>,
        command: [Trace; 4],
        held: &CascadeMemory<Trace, MAX_ROTORS>,
    ) -> CascadeMemory<Trace, MAX_ROTORS> {
        let state = model.own(&kinematics(frame));
        let one = Trace::one();
        let ticks = [first, one, one];
        let total = model.limits.thrust;
        match self.level {
            Level::Rotor | Level::Rate => model.rate(&state, held, &self.scale.rate(command, total), ticks),
            Level::Attitude => {
                // the heading of the command is that of the first computation
                let fresh = self.scale.attitude(command, total, state.attitude);
                let wanted = either(first, &fresh, &held.attitude);
                model.attitude(&state, held, &wanted, ticks)
            }
            Level::Velocity => model.velocity(&state, held, &self.scale.velocity(command), ticks),
            Level::Position => model.position(&state, held, &self.scale.position(command, state.position), ticks),
        }
    }
}

/// Digit d of `levels` that are evenly spaced over [−1, 1].
fn command_of<S: Scalar>(digit: S, levels: usize) -> S {
    S::constant(2.0) * digit / S::constant((levels - 1) as f64) - S::one()
}

/// The `n` digits of the nearest whole number to the base `levels`, the highest first; those of the least or largest where it is
/// beyond. By comparisons, as no scalar rounds.
fn digits(x: Trace, levels: usize, n: usize) -> Vec<Trace> {
    let mut rest = x;
    let of_place = |place: usize| {
        let unit = levels.pow(place as u32) as f64;
        let reached = |digit: usize| rest.lt(digit as f64 * unit - 0.5).not();
        let count = |sum, digit| sum + Trace::select(reached(digit), Trace::one(), Trace::zero());
        let digit = (1..levels).fold(Trace::zero(), count);
        rest -= digit * unit;
        digit
    };
    (0..n).rev().map(of_place).collect()
}

/// The one where `first` is 1, else the other. Where that is known nothing is recorded.
fn either(first: Trace, one: &AttitudeCommand<Trace>, other: &AttitudeCommand<Trace>) -> AttitudeCommand<Trace> {
    const DIM: usize = AttitudeCommand::<Trace>::DIM;
    if let Some(first) = first.known() {
        return if first > 0.5 { *one } else { *other };
    }
    let (mut a, mut b) = ([Trace::zero(); DIM], [Trace::zero(); DIM]);
    one.write(&mut a);
    other.write(&mut b);
    let first = first.gt(0.5);
    AttitudeCommand::read(&std::array::from_fn::<_, DIM, _>(|k| Trace::select(first, a[k], b[k])))
}

/// Numbers that the cascade of one drone holds within a step: attitude command, rate command, rotors.
pub(crate) const LATCHED_PER_AGENT: usize = 16 + 7 + MAX_ROTORS;

/// Most values of a joint discrete action: they are exact in `f32`.
const MAX_VALUES: f64 = 65_536.0;

fn kinematics(frame: &Frame<Trace>) -> Kinematics<Trace> {
    Kinematics {
        position: frame.position,
        velocity: frame.velocity,
        attitude: frame.attitude,
        angular_velocity: rotate_back(frame.attitude, frame.angular_velocity),
    }
}

/// A number within [−1, 1], or the safe one where it is not finite; and whether that changed it.
pub(crate) fn clipped(a: Trace, safe_command: f64) -> (Trace, <Trace as Scalar>::Mask) {
    let finite = safe::is_bounded(a, f64::from(f32::MAX));
    let used = Trace::select(finite, a.clamp(-Trace::one(), Trace::one()), Trace::constant(safe_command));
    (used, a.lt(used).or(used.lt(a)).or(finite.not()))
}
