//! A cascade that flies on with the rotors that are left.
//!
//! Until it is told of a failure it is the [`Cascade`](super::Cascade), bit for bit. Told, it changes two things:
//!
//! - **Allocation** becomes the bounded [`Problem`](super::allocation::Problem) with eᵢ T_max as upper bounds, roll and
//!   pitch before thrust before yaw before sideways force (`PRIORITIES`). The attainable lift replaces the nominal one
//!   in the limits.
//! - **Attitude**, where the rotors cannot hold yaw ([`Assessment`]), follows the direction of the thrust alone. With s
//!   the wanted direction in the body frame,
//!
//! ```text
//! ω_cmd = Rᵀω_n − (K_R/K_ω) (s × e_z)·(1, 1, 0),   ω_n the turn of the wanted direction, without twist
//! M     = K_ω (ω_cmd − ω) + ω × Jω + J (α_ff − ω_z e_z × ω)
//! ```
//!
//! Heading is nobody's wish any more; yaw is only damped, M_z = −K_ω ω_z, as far as the bounds allow. The last term keeps
//! the tilt error's decay steady in the *world* while the body spins under it. Motors that lag by τ deliver a moment
//! that is steady in the world late by the angle ω_z τ: the command leads by it, M − τ ω_z e_z × M. Horizontal position
//! and velocity gains are capped at a quarter of the attitude loop's bandwidth. Without the lead, without the term in
//! ω_z e_z × ω, or without the cap, Firefly or Neo11 with two rotors of one spin lost (13 rad/s) fall; with them
//! they hover within 4 cm of height (`tests/failure.rs`).
//!
//! A vehicle that must spin to stay up, a quadrotor on three rotors, is steered likewise, but about the axis n of its
//! [`Spin`](super::allocation::Spin) in place of e_z: ω_cmd has the turn ω_z n/n_z besides, n leans away from e_z with
//! ω_z² until the turn is as fast as it should be, yaw is left alone, and the thrust is what its mean along n must be. The moment
//! ω × Jω that the turn needs is steady in the body and not led.
//!
//! Source: the reduced attitude of Mueller and D'Andrea (2014); priorities after Sun et al. (2022).

use super::allocation::problem::WRENCH;
use super::allocation::{Allocator, Assessment, Capability, Counts, failure};
use super::attitude::{AttitudeCommand, rate_command};
use super::cascade::{CascadeMemory, CascadeModel, RateDivisors, Rates, hold_rate};
use super::controller::{Controller, Measurement, Target};
use super::kinematics::Kinematics;
use super::parameters::{CommandLimits, ForceLimits, GainSet};
use super::rate::RateCommand;
use super::reference::Setpoint;
use super::velocity::VelocityCommand;
use base::error::Result;
use dynamics::gains::SEPARATION;
use dynamics::rotor::thrust_action;
use dynamics::spatial::{Quat, Vec3, add, cross, dot, mat_mul, mat_vec, matrix, scale, sub, transpose};
use dynamics::{Gains, MAX_ROTORS, Vehicle};
use flight::Commanded;

/// Priority of each row, as a factor of its balanced weight: sideways forces, thrust, roll and pitch, yaw.
pub(crate) const PRIORITIES: [f64; WRENCH] = [1e-4, 1e-4, 1.0, 10.0, 10.0, 1e-3];
/// Largest tilt of the wanted thrust with a failure, rad: less lift, less haste.
const TILT: f64 = 0.6;

/// A [`Cascade`](super::Cascade) that flies on with what is left once [`tell`](Self::tell) names the failed rotors.
pub struct FaultTolerant {
    vehicle: Vehicle,
    model: CascadeModel<f64, MAX_ROTORS>,
    whole: CascadeModel<f64, MAX_ROTORS>,
    schedule: RateDivisors,
    held: CascadeMemory<f64, MAX_ROTORS>,
    step: u64,
    broken: Option<Broken>,
}

/// How it flies once something failed.
struct Broken {
    assessment: Assessment,
    allocator: Allocator,
    /// Mean time constant of the motors, s.
    lag: f64,
    /// Largest yaw moment worth asking for, N m: half the range of what is left. A wish far beyond it would outweigh
    /// its low priority. None is asked for of what must spin.
    yaw: f64,
}

impl Broken {
    fn new(vehicle: &Vehicle, assessment: Assessment) -> Result<Self> {
        let problem = failure::problem(vehicle, &assessment.health)?.with_priorities(&PRIORITIES);
        let yaw_row = problem.geometry.row(5);
        let reach = 0.5 * yaw_row.iter().zip(&problem.upper).map(|(b, most)| (b * most).abs()).sum::<f64>();
        let yaw = if assessment.spin.is_some() { 0.0 } else { reach };
        let constants = vehicle.rotors.iter().map(|r| 0.5 * (r.time_constant_up + r.time_constant_down));
        let lag = constants.sum::<f64>() / vehicle.n_rotor() as f64;
        Ok(Self { assessment, allocator: Allocator::new(problem)?, lag, yaw })
    }

    fn yaw_free(&self) -> bool {
        self.assessment.capability != Capability::Full
    }

    /// The axis it turns about at a rate about body z (rad/s), in body axes with z = 1: body z, unless it must spin to stay up; then
    /// it leans away with the square of the rate, as far as that of the steady turn.
    fn axis(&self, rate: f64) -> Vec3<f64> {
        let Some(spin) = &self.assessment.spin else { return [0.0, 0.0, 1.0] };
        let share = (rate / spin.rate).max(0.0).powi(2).min(1.0);
        [0, 1, 2].map(|k| if k < 2 { share * spin.axis[k] / spin.axis[2] } else { 1.0 })
    }

    /// Of the last allocation.
    fn actions(&self) -> [f64; MAX_ROTORS] {
        let (thrusts, most) = (&self.allocator.solution().inputs, &self.allocator.problem().upper);
        let mut actions = [-1.0; MAX_ROTORS];
        for ((action, thrust), most) in actions.iter_mut().zip(thrusts).zip(most).filter(|(_, most)| **most > 0.0) {
            *action = thrust_action(thrust / most);
        }
        actions
    }
}

impl FaultTolerant {
    /// For simulation steps of `dt` seconds, all rotors whole.
    ///
    /// # Errors
    /// As [`CascadeModel::new`] and [`RateDivisors::new`].
    pub fn new(vehicle: &Vehicle, gains: &Gains, rates: &Rates, dt: f64) -> Result<Self> {
        let model = CascadeModel::new(vehicle, gains)?;
        Ok(Self {
            vehicle: vehicle.upright(),
            model,
            whole: model,
            schedule: RateDivisors::new(rates, dt)?,
            held: model.initial(),
            step: 0,
            broken: None,
        })
    }

    /// From now on rotor i has effectiveness `health[i]`, 0 (stopped) to 1; all 1 is the nominal cascade again.
    ///
    /// # Errors
    /// As [`Assessment::of`]; the controller then flies on as before.
    pub fn tell(&mut self, health: &[f64]) -> Result<()> {
        let assessment = Assessment::of(&self.vehicle, health)?;
        if assessment.broken().is_empty() {
            (self.broken, self.model) = (None, self.whole);
            return Ok(());
        }
        let broken = Broken::new(&self.vehicle, assessment)?;
        self.model = self.whole;
        let body = &self.model.body;
        // moments come before thrust in the allocation, so nothing need be kept back for them
        let lift = broken.assessment.lift.max(1.1 * body.mass * body.gravity);
        let limits = CommandLimits { tilt: TILT, ..CommandLimits::default() };
        self.model.limits = ForceLimits { force: lift, ..ForceLimits::constant(&limits, lift, 0.0) };
        if broken.yaw_free() {
            self.model.gains = unhurried(&self.model);
        }
        self.broken = Some(broken);
        Ok(())
    }

    /// What is left of the vehicle by the last [`tell`](Self::tell); `None` while whole.
    pub fn assessment(&self) -> Option<&Assessment> {
        self.broken.as_ref().map(|b| &b.assessment)
    }

    /// Which methods solved the allocations since the last [`tell`](Self::tell); `None` while whole.
    pub fn counts(&self) -> Option<Counts> {
        self.broken.as_ref().map(|b| b.allocator.counts())
    }

    /// What each level said last.
    pub fn latched(&self) -> &CascadeMemory<f64, MAX_ROTORS> {
        &self.held
    }

    /// One step towards a sample of a reference; returns rotor actions in [−1, 1], of a failed rotor −1, of a weakened
    /// one in its own range.
    pub fn position(&mut self, state: &Kinematics<f64>, sample: &Setpoint<f64>) -> [f64; MAX_ROTORS] {
        let (state, ticks) = (&self.model.own(state), self.schedule.ticks(self.step));
        let command = self.model.attitude_of_position(state, &self.held, sample, ticks);
        self.turned(state, &command)
    }

    /// One step of a velocity command.
    pub fn velocity(&mut self, state: &Kinematics<f64>, command: &VelocityCommand<f64>) -> [f64; MAX_ROTORS] {
        let (state, ticks) = (&self.model.own(state), self.schedule.ticks(self.step));
        let command = self.model.attitude_of_velocity(state, &self.held, command, ticks);
        self.turned(state, &command)
    }

    /// One step of an attitude command. Where yaw is lost, only the direction of its thrust counts.
    pub fn attitude(&mut self, state: &Kinematics<f64>, command: &AttitudeCommand<f64>) -> [f64; MAX_ROTORS] {
        self.turned(&self.model.own(state), command)
    }

    /// From the attitude level down, in the axes of the model.
    fn turned(&mut self, state: &Kinematics<f64>, command: &AttitudeCommand<f64>) -> [f64; MAX_ROTORS] {
        let ticks = self.schedule.ticks(self.step);
        let (q, w) = (state.attitude, state.angular_velocity);
        let fresh = match &self.broken {
            Some(broken) if broken.yaw_free() => self.rate_of_direction(command, q, broken.axis(w[2]), w[2]),
            _ => rate_command(&self.model.gains, command, q, w),
        };
        let command_of_rate = hold_rate(ticks[1], &fresh, &self.held.rate);
        self.held.attitude = *command;
        self.turning(state, &command_of_rate)
    }

    /// One step of a rate command. Where yaw is lost, its yaw rate is followed as far as the bounds allow.
    pub fn rate(&mut self, state: &Kinematics<f64>, command: &RateCommand<f64>) -> [f64; MAX_ROTORS] {
        self.turning(&self.model.own(state), command)
    }

    /// From the rate level down, in the axes of the model.
    fn turning(&mut self, state: &Kinematics<f64>, command: &RateCommand<f64>) -> [f64; MAX_ROTORS] {
        let ticks = self.schedule.ticks(self.step);
        self.step += 1;
        match &mut self.broken {
            None => self.held = self.model.rate(state, &self.held, command, ticks),
            Some(broken) => {
                self.held.rate = *command;
                if ticks[2] > 0.5 {
                    let spin = if broken.yaw_free() { state.angular_velocity[2] } else { 0.0 };
                    let turn = scale(spin, broken.axis(spin));
                    let [f, x, y, z] = spinning_wrench(&self.model, state, command, turn, broken.lag);
                    broken.allocator.solve(&[0.0, 0.0, f, x, y, z.clamp(-broken.yaw, broken.yaw)]);
                    self.held.rotors = broken.actions();
                }
            }
        }
        self.held.rotors
    }

    /// Turns the `axis` (body, z = 1) that the body spins about towards the wanted direction the short way; see the [module](self).
    fn rate_of_direction(
        &self,
        command: &AttitudeCommand<f64>,
        attitude: Quat<f64>,
        axis: Vec3<f64>,
        spin: f64,
    ) -> RateCommand<f64> {
        let to_body = mat_mul(transpose(matrix(attitude)), command.attitude);
        let s = [to_body[0][2], to_body[1][2], to_body[2][2]];
        let length = dot(axis, axis).sqrt();
        let along = dot(s, axis) / length;
        let away = scale(length.recip(), cross(s, axis));
        // beyond 90° the sine of the angle would fade
        let grow = if along < 0.0 { dot(away, away).sqrt().max(1e-6).recip() } else { 1.0 };
        let untwisted = |turn: Vec3<f64>| mat_vec(to_body, [turn[0], turn[1], 0.0]);
        let mut rate = add(untwisted(command.angular_velocity), scale(spin, axis));
        for i in 0..2 {
            rate[i] -= self.model.gains.attitude[i] / self.model.gains.rate[i] * grow * away[i];
        }
        rate[2] = 0.0;
        // the force asked for is carried by the mean of a thrust that turns around the axis
        let mean = if s[2] > 0.2 { (length * along / s[2]).clamp(0.5, 2.0) } else { 1.0 };
        RateCommand {
            thrust: command.thrust * mean,
            angular_velocity: rate,
            angular_acceleration: untwisted(command.angular_acceleration),
        }
    }
}

impl Controller for FaultTolerant {
    fn name(&self) -> &str {
        "fault_tolerant"
    }

    fn why_no_law(&self) -> &'static str {
        "a controller that changes its allocation when it is told of a failure"
    }

    fn description(&self) -> String {
        "the cascade, and with the rotors that are left: roll and pitch before thrust before yaw".into()
    }

    fn schedule(&self) -> Option<RateDivisors> {
        Some(self.schedule)
    }

    fn reset(&mut self) {
        (self.broken, self.model, self.held, self.step) = (None, self.whole, self.whole.initial(), 0);
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, commands: &mut [f64]) {
        let actions = self.position(&Kinematics::read(seen.state), &target.sample(seen.time));
        let n = self.vehicle.n_rotor();
        commands[..n].copy_from_slice(&actions[..n]);
    }

    fn commanded(&self) -> Option<Commanded> {
        Some(self.model.axes.commanded(self.held.commanded()))
    }

    fn tell(&mut self, effectiveness: &[f64]) -> Result<()> {
        FaultTolerant::tell(self, effectiveness)
    }
}

/// [F_z, M_x, M_y, M_z] of the rate level for commands that are steady in the world while the body turns at `turn`, led by the
/// motors' lag; what the turn itself needs is steady in the body.
fn spinning_wrench(
    model: &CascadeModel<f64, MAX_ROTORS>,
    state: &Kinematics<f64>,
    command: &RateCommand<f64>,
    turn: Vec3<f64>,
    lag: f64,
) -> [f64; 4] {
    let (spin, beside) = (turn[2], sub(state.angular_velocity, turn));
    let mut command = *command;
    command.angular_acceleration = add(command.angular_acceleration, [spin * beside[1], -spin * beside[0], 0.0]);
    let [f, x, y, z] = model.wrench(state, &command);
    let steady = cross(turn, mat_vec(model.body.inertia, turn));
    let lead = lag * spin;
    [f, x + lead * (y - steady[1]), y - lead * (x - steady[0]), z]
}

/// Horizontal position and velocity gains no faster than [`SEPARATION`] allows beside the attitude loop ω = √(K_R/J):
/// K_p ≤ (ω/4)², K_v ≤ ω/2. In a spinning body an outer loop that does not wait turns its errors into coning.
fn unhurried(model: &CascadeModel<f64, MAX_ROTORS>) -> GainSet<f64> {
    let mut gains = model.gains;
    let bandwidth = |i: usize| (gains.attitude[i] / model.body.inertia[i][i]).sqrt();
    let outer = bandwidth(0).min(bandwidth(1)) / SEPARATION;
    for i in 0..2 {
        gains.position[i] = gains.position[i].min(outer * outer);
        gains.velocity[i] = gains.velocity[i].min(2.0 * outer);
    }
    gains
}
