//! All levels together: position → velocity → attitude → rate → rotors, each at its own rate.

use super::allocation::pseudo_inverse::fits;
use super::allocation::{Authority, Mixer, allocate_yaw_last, thrust_to_command};
use super::attitude::{AttitudeCommand, rate_command};
use super::hover_axes::HoverAxes;
use super::kinematics::Kinematics;
use super::parameters::{BodyModel, CommandLimits, ForceLimits, GainSet, LEAST_LIFT, validate_gains};
use super::position::{add_drag, velocity_command};
use super::rate::{RateCommand, moment};
use super::reference::Setpoint;
use super::velocity::{VelocityCommand, attitude_command};
use autodiff::Scalar;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::spatial::{add, from_matrix, mat_vec, rotate_back, sub};
use dynamics::{Gains, MAX_ROTORS, Vehicle};
use flight::Commanded;
use serde::{Deserialize, Serialize};

/// Where commands enter the cascade.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// One command in [−1, 1] per rotor.
    Rotor,
    /// Thrust and body rates.
    Rate,
    /// Thrust and attitude.
    Attitude,
    /// Velocity and yaw.
    Velocity,
    /// A [`Setpoint`] of a reference.
    Position,
}

impl Level {
    /// From the rotors up.
    pub const ALL: [Self; 5] = [Self::Rotor, Self::Rate, Self::Attitude, Self::Velocity, Self::Position];

    /// Lower case, as on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rotor => "rotor",
            Self::Rate => "rate",
            Self::Attitude => "attitude",
            Self::Velocity => "velocity",
            Self::Position => "position",
        }
    }

    /// The level called `name`.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the names there are.
    pub fn by_name(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|level| level.name() == name).ok_or_else(|| Error::Unknown {
            kind: "control level",
            name: name.into(),
            known: Self::ALL.map(|level| level.name().to_string()).into(),
        })
    }
}

with_defaults! {
    /// How often each level computes, Hz.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Rates {
        /// Rate level and allocation. Default 500.
        pub rate: f64 = 500.0,
        /// Attitude level. Default 250.
        pub attitude: f64 = 250.0,
        /// Velocity and position levels. Default 100.
        pub velocity: f64 = 100.0,
    }
}

impl Rates {
    /// Every level in every step of `dt` seconds.
    pub fn every_step(dt: f64) -> Self {
        Self { rate: 1.0 / dt, attitude: 1.0 / dt, velocity: 1.0 / dt }
    }
}

/// [`Rates`] in whole simulation steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RateDivisors {
    /// Steps between two computations of velocity and position, attitude, rate.
    pub every: [u64; 3],
}

impl RateDivisors {
    /// Most steps between two computations.
    const LONGEST: f64 = 1e6;

    /// For simulation steps of `dt` seconds, within (0, 1].
    ///
    /// # Errors
    /// [`Error::Value`] for another `dt`, or where a rate does not divide the simulation's own, 1/dt.
    pub fn new(rates: &Rates, dt: f64) -> Result<Self> {
        if !(dt > 0.0 && dt <= 1.0) {
            return Err(Error::value("dt", dt, "within (0, 1] s", "Give the simulation step in seconds."));
        }
        let rows = [("velocity", rates.velocity), ("attitude", rates.attitude), ("rate", rates.rate)];
        let mut every = [1; 3];
        for (steps, (level, rate)) in every.iter_mut().zip(rows) {
            let ratio = 1.0 / (dt * rate);
            let whole = ratio.round();
            let divides = (ratio - whole).abs() <= 1e-6 * whole;
            if !(rate > 0.0 && (1.0..=Self::LONGEST).contains(&whole) && divides) {
                return Err(Error::value(
                    format!("controller rate '{level}'"),
                    format!("{rate} Hz with dt = {dt} s"),
                    format!("{:.6} Hz divided by a whole number", 1.0 / dt),
                    "Change the rate or dt.",
                ));
            }
            *steps = whole as u64;
        }
        Ok(Self { every })
    }

    /// 1 for each level that computes in this step, else 0: velocity and position, attitude, rate. All do in step 0.
    pub fn ticks(&self, step: u64) -> [f64; 3] {
        self.every.map(|n| if step.is_multiple_of(n) { 1.0 } else { 0.0 })
    }
}

/// What each level said last: the memory of a cascade, held until the level computes again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CascadeMemory<S, const R: usize> {
    /// The last attitude command, of the velocity level.
    pub attitude: AttitudeCommand<S>,
    /// The last rate command, of the attitude level.
    pub rate: RateCommand<S>,
    /// Of the rate level and allocation: rotor actions in [−1, 1].
    pub rotors: [S; R],
}

impl<S: Scalar, const R: usize> CascadeMemory<S, R> {
    /// Numbers in the flat form: attitude command, rate command, rotor actions.
    pub const DIM: usize = AttitudeCommand::<S>::DIM + RateCommand::<S>::DIM + R;

    /// Writes the flat form into the first [`Self::DIM`] numbers of `out`.
    ///
    /// # Panics
    /// If `out` is shorter than that.
    pub fn write(&self, out: &mut [S]) {
        let (attitude, rest) = out.split_at_mut(AttitudeCommand::<S>::DIM);
        let (rate, rotors) = rest.split_at_mut(RateCommand::<S>::DIM);
        self.attitude.write(attitude);
        self.rate.write(rate);
        for i in 0..R {
            rotors[i] = self.rotors[i];
        }
    }

    /// The inverse of [`write`](Self::write).
    ///
    /// # Panics
    /// If `x` is shorter than [`Self::DIM`].
    pub fn read(x: &[S]) -> Self {
        let (attitude, rest) = x.split_at(AttitudeCommand::<S>::DIM);
        let (rate, actions) = rest.split_at(RateCommand::<S>::DIM);
        let mut rotors = [S::zero(); R];
        for i in 0..R {
            rotors[i] = actions[i];
        }
        Self { attitude: AttitudeCommand::read(attitude), rate: RateCommand::read(rate), rotors }
    }
}

impl<const R: usize> CascadeMemory<f64, R> {
    /// For the record of a flight.
    pub fn commanded(&self) -> Commanded {
        Commanded {
            thrust: self.attitude.thrust,
            attitude: from_matrix(self.attitude.attitude),
            angular_velocity: self.rate.angular_velocity,
        }
    }
}

/// `fresh` where `tick` > ½, else `held`.
fn hold<S: Scalar, const N: usize>(tick: S, fresh: [S; N], held: [S; N]) -> [S; N] {
    let now = S::constant(0.5).lt(tick);
    let mut x = held;
    for i in 0..N {
        x[i] = S::select(now, fresh[i], held[i]);
    }
    x
}

#[inline]
fn hold_attitude<S: Scalar>(tick: S, fresh: &AttitudeCommand<S>, held: &AttitudeCommand<S>) -> AttitudeCommand<S> {
    let (mut a, mut b) = ([S::zero(); 16], [S::zero(); 16]);
    fresh.write(&mut a);
    held.write(&mut b);
    AttitudeCommand::read(&hold(tick, a, b))
}

#[inline]
pub(super) fn hold_rate<S: Scalar>(tick: S, fresh: &RateCommand<S>, held: &RateCommand<S>) -> RateCommand<S> {
    let (mut a, mut b) = ([S::zero(); 7], [S::zero(); 7]);
    fresh.write(&mut a);
    held.write(&mut b);
    RateCommand::read(&hold(tick, a, b))
}

/// The parameters of a cascade for `R` rotor slots, and its entry points.
///
/// Each entry maps (state, memory, command, ticks) to the new memory, whose `rotors` are the actions to apply; nothing
/// else is kept. Ticks are numbers (1 compute, 0 hold; velocity and position, attitude, rate), so that a whole closed
/// loop is one branch-free function that can be traced and differentiated. Slots behind the vehicle's own rotors have
/// zero mixer rows and T_max = 1: their action is −1. Attitude and rates, measured and commanded, are those of the axes in which the
/// vehicle hovers level ([`CascadeModel::own`]). A NaN command gives NaN actions, never a panic; it is out of the
/// memory as soon as every level has computed again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CascadeModel<S, const R: usize> {
    /// Mass, inertia, drag, gravity.
    pub body: BodyModel<S>,
    /// Per level and axis.
    pub gains: GainSet<S>,
    /// Limits of tilt and thrust.
    pub limits: ForceLimits<S>,
    /// Rotor thrusts (N) per [F_z, M_x, M_y, M_z], one row per rotor: –, 1/m, 1/m, 1/m.
    pub mixer: [[S; 4]; R],
    /// T_max per rotor, N.
    pub max_thrust: [S; R],
    /// In which it hovers level: the body's unless hover leans.
    pub axes: HoverAxes<S>,
}

impl<const R: usize> CascadeModel<f64, R> {
    /// For a vehicle with its own mass, inertia, geometry and drag, and default [`CommandLimits`].
    ///
    /// # Errors
    /// As [`with_limits`](Self::with_limits).
    pub fn new(vehicle: &Vehicle, gains: &Gains) -> Result<Self> {
        Self::with_limits(vehicle, gains, &CommandLimits::default())
    }

    /// Likewise, with given limits.
    ///
    /// # Errors
    /// [`Error::Value`] for axes that its rotors do not turn apart, for less than 1.05 of the weight in thrust or in lift without a
    /// moment, and for a vehicle, gains or limits that are not valid.
    pub fn with_limits(vehicle: &Vehicle, gains: &Gains, limits: &CommandLimits) -> Result<Self> {
        vehicle.validate()?;
        vehicle.check_steerable()?;
        validate_gains(gains)?;
        limits.validate()?;
        fits(vehicle.n_rotor(), R)?;
        let axes = HoverAxes::of(vehicle);
        let vehicle = &vehicle.upright();
        let mixer = Mixer::new(vehicle)?;
        let mut max_thrust = [1.0; R];
        for (slot, rotor) in max_thrust.iter_mut().zip(&vehicle.rotors) {
            *slot = rotor.max_thrust();
        }
        let lift: f64 = vehicle.rotors.iter().map(|r| r.max_thrust() * r.axis[2]).sum();
        if lift <= 0.0 {
            let what = format!("vehicle '{}': thrust along body z", vehicle.name);
            return Err(Error::value(what, format!("{lift:.3} N"), "> 0 N", "Turn the rotor axes upwards."));
        }
        let body = BodyModel::of(vehicle);
        let weight = body.mass * body.gravity;
        if lift < LEAST_LIFT * weight {
            return Err(Error::value(
                format!("vehicle '{}': thrust over weight", vehicle.name),
                format!("{:.3} ({lift:.2} N over {weight:.2} N)", lift / weight),
                format!("≥ {LEAST_LIFT}, to hold its height and steer"),
                "Take mass off, or give it stronger rotors: max_speed or thrust_coefficient.",
            ));
        }
        check_balanced_lift(vehicle)?;
        Ok(Self {
            gains: GainSet::constant(gains),
            limits: ForceLimits::constant(limits, lift, weight),
            body,
            mixer: mixer.carrying(vehicle).padded()?,
            max_thrust,
            axes,
        })
    }
}

/// Refuses a vehicle that carries no more than its weight without a moment, however much all its rotors push together.
fn check_balanced_lift(vehicle: &Vehicle) -> Result<()> {
    let Ok(hover) = vehicle.hover() else { return Ok(()) };
    let fullest =
        hover.thrusts.iter().zip(&vehicle.rotors).map(|(t, rotor)| t / rotor.max_thrust()).fold(0.0, f64::max);
    if fullest * LEAST_LIFT <= 1.0 {
        return Ok(());
    }
    let lift = vehicle.balanced_lift()?;
    if lift >= LEAST_LIFT {
        return Ok(());
    }
    Err(Error::value(
        format!("vehicle '{}': lift without a moment over weight", vehicle.name),
        format!("{lift:.3}, of a thrust over weight of {:.3}", vehicle.thrust_to_weight()),
        format!("≥ {LEAST_LIFT}, to hold its height and steer"),
        "Move the centre of mass between the rotors, take mass off, or give it stronger rotors: max_speed or thrust_coefficient.",
    ))
}

impl<S: Scalar, const R: usize> CascadeModel<S, R> {
    /// The same parameters over another scalar.
    pub fn constant(model: &CascadeModel<f64, R>) -> Self {
        let limits = &model.limits;
        let gains = &model.gains;
        let plain = Gains {
            position: gains.position,
            velocity: gains.velocity,
            attitude: gains.attitude,
            rate: gains.rate,
            integral: [0.0; 2],
        };
        let (mut mixer, mut max_thrust) = ([[S::zero(); 4]; R], [S::zero(); R]);
        for i in 0..R {
            for k in 0..4 {
                mixer[i][k] = S::constant(model.mixer[i][k]);
            }
            max_thrust[i] = S::constant(model.max_thrust[i]);
        }
        Self {
            body: BodyModel::constant(&model.body),
            gains: GainSet::constant(&plain),
            limits: limits.cast(),
            mixer,
            max_thrust,
            axes: HoverAxes::constant(&model.axes),
        }
    }

    /// A measured motion with attitude and rates of the axes in which the vehicle hovers level: what the levels take.
    #[inline]
    pub fn own(&self, body: &Kinematics<S>) -> Kinematics<S> {
        self.axes.kinematics(body)
    }

    /// Memory before the first step: level, hovering.
    pub fn initial(&self) -> CascadeMemory<S, R> {
        let weight = self.body.mass * self.body.gravity;
        let o = S::zero();
        CascadeMemory {
            attitude: AttitudeCommand::level(weight),
            rate: RateCommand::constant(weight, [o; 3]),
            rotors: self.actions([weight, o, o, o]),
        }
    }

    /// Enters at the position level with a sample of a reference.
    pub fn position(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        sample: &Setpoint<S>,
        ticks: [S; 3],
    ) -> CascadeMemory<S, R> {
        self.attitude(state, held, &self.attitude_of_position(state, held, sample, ticks), ticks)
    }

    /// Enters at the velocity level.
    pub fn velocity(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        command: &VelocityCommand<S>,
        ticks: [S; 3],
    ) -> CascadeMemory<S, R> {
        self.attitude(state, held, &self.attitude_of_velocity(state, held, command, ticks), ticks)
    }

    /// What the position and velocity levels ask of the attitude level.
    pub(super) fn attitude_of_position(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        sample: &Setpoint<S>,
        ticks: [S; 3],
    ) -> AttitudeCommand<S> {
        self.attitude_of_force(state, held, &self.force_of_position(state, sample), ticks)
    }

    /// Likewise, with an acceleration taken off that the body has beside its thrust, m/s²: not of the motion, so drag does not follow it.
    pub(super) fn attitude_without(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        sample: &Setpoint<S>,
        surplus: [S; 3],
        ticks: [S; 3],
    ) -> AttitudeCommand<S> {
        let mut command = self.force_of_position(state, sample);
        command.acceleration = sub(command.acceleration, surplus);
        self.attitude_of_force(state, held, &command, ticks)
    }

    /// Velocity command of a sample, with the drag of its motion fed forward.
    #[inline]
    fn force_of_position(&self, state: &Kinematics<S>, sample: &Setpoint<S>) -> VelocityCommand<S> {
        let wanted = [sample.velocity, sample.acceleration, sample.jerk];
        add_drag(&self.body, state, wanted, &velocity_command(&self.gains, sample, state))
    }

    /// What the velocity level asks of the attitude level.
    pub(super) fn attitude_of_velocity(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        command: &VelocityCommand<S>,
        ticks: [S; 3],
    ) -> AttitudeCommand<S> {
        let wanted = [command.velocity, command.acceleration, command.jerk];
        self.attitude_of_force(state, held, &add_drag(&self.body, state, wanted, command), ticks)
    }

    fn attitude_of_force(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        command: &VelocityCommand<S>,
        ticks: [S; 3],
    ) -> AttitudeCommand<S> {
        let fresh = attitude_command(&self.gains, &self.body, &self.limits, command, state);
        hold_attitude(ticks[0], &fresh, &held.attitude)
    }

    /// Enters at the attitude level. The command is remembered as it is; the first tick plays no part.
    pub fn attitude(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        command: &AttitudeCommand<S>,
        ticks: [S; 3],
    ) -> CascadeMemory<S, R> {
        let rate = self.rate_of_attitude(state, held, command, ticks);
        CascadeMemory { attitude: *command, ..self.rate(state, held, &rate, ticks) }
    }

    /// What the attitude level asks of the rate level.
    fn rate_of_attitude(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        command: &AttitudeCommand<S>,
        ticks: [S; 3],
    ) -> RateCommand<S> {
        let fresh = rate_command(&self.gains, command, state.attitude, state.angular_velocity);
        hold_rate(ticks[1], &fresh, &held.rate)
    }

    /// Enters at the attitude level, with an angular acceleration taken off that the body has beside its moments, rad/s².
    pub(super) fn rotors_without(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        command: &AttitudeCommand<S>,
        surplus: [S; 3],
        ticks: [S; 3],
    ) -> CascadeMemory<S, R> {
        let rate = self.rate_of_attitude(state, held, command, ticks);
        let mut asked = rate;
        asked.angular_acceleration = sub(rate.angular_acceleration, surplus);
        CascadeMemory { attitude: *command, rate, rotors: self.rate(state, held, &asked, ticks).rotors }
    }

    /// Enters at the rate level. The first two ticks play no part.
    pub fn rate(
        &self,
        state: &Kinematics<S>,
        held: &CascadeMemory<S, R>,
        command: &RateCommand<S>,
        ticks: [S; 3],
    ) -> CascadeMemory<S, R> {
        let fresh = self.actions(self.wrench(state, command));
        CascadeMemory { attitude: held.attitude, rate: *command, rotors: hold(ticks[2], fresh, held.rotors) }
    }

    /// [F_z, M_x, M_y, M_z] that the rate level asks of the rotors.
    #[inline]
    pub(super) fn wrench(&self, state: &Kinematics<S>, command: &RateCommand<S>) -> [S; 4] {
        let m = moment(&self.gains, self.body.inertia, command, state.angular_velocity);
        // what rotor drag off the centre of mass will take away in still air
        let m = add(m, mat_vec(self.body.drag_moment, rotate_back(state.attitude, state.velocity)));
        [command.thrust, m[0], m[1], m[2]]
    }

    /// Enters at the rotors: actions clipped to [−1, 1].
    #[inline]
    pub fn rotor(&self, held: &CascadeMemory<S, R>, actions: &[S; R]) -> CascadeMemory<S, R> {
        let mut new = *held;
        for i in 0..R {
            new.rotors[i] = actions[i].clamp(-S::one(), S::one());
        }
        new
    }

    /// Rotor actions for a wrench [F_z, M_x, M_y, M_z] (N, N m; body, about the centre of mass); yaw gives way first.
    #[inline]
    pub fn actions(&self, wrench: [S; 4]) -> [S; R] {
        thrust_to_command(&allocate_yaw_last(&self.mixer, &self.max_thrust, wrench), &self.max_thrust)
    }
}

/// A cascade for one vehicle in plain `f64`: parameters, schedule, memory and step count together.
#[derive(Debug, Clone)]
pub struct Cascade<const R: usize = MAX_ROTORS> {
    /// Parameters.
    pub model: CascadeModel<f64, R>,
    /// When each level computes.
    pub schedule: RateDivisors,
    /// What the vehicle's rotors can and cannot do.
    pub authority: Authority,
    held: CascadeMemory<f64, R>,
    step: u64,
}

impl<const R: usize> Cascade<R> {
    /// For simulation steps of `dt` seconds, with default [`CommandLimits`].
    ///
    /// # Errors
    /// As [`CascadeModel::new`] and [`RateDivisors::new`].
    pub fn new(vehicle: &Vehicle, gains: &Gains, rates: &Rates, dt: f64) -> Result<Self> {
        let model = CascadeModel::new(vehicle, gains)?;
        let authority = Mixer::new(vehicle)?.authority;
        Ok(Self { model, schedule: RateDivisors::new(rates, dt)?, authority, held: model.initial(), step: 0 })
    }

    /// Forgets: the next step is step 0, from hover.
    pub fn reset(&mut self) {
        self.held = self.model.initial();
        self.step = 0;
    }

    /// What each level said last.
    pub fn latched(&self) -> &CascadeMemory<f64, R> {
        &self.held
    }

    /// One step towards a sample of a reference; returns rotor actions in [−1, 1].
    pub fn position(&mut self, state: &Kinematics<f64>, sample: &Setpoint<f64>) -> [f64; R] {
        let ticks = self.tick();
        self.held = self.model.position(&self.model.own(state), &self.held, sample, ticks);
        self.held.rotors
    }

    /// One step of a velocity command; returns rotor actions in [−1, 1].
    pub fn velocity(&mut self, state: &Kinematics<f64>, command: &VelocityCommand<f64>) -> [f64; R] {
        let ticks = self.tick();
        self.held = self.model.velocity(&self.model.own(state), &self.held, command, ticks);
        self.held.rotors
    }

    /// One step of an attitude command; returns rotor actions in [−1, 1].
    pub fn attitude(&mut self, state: &Kinematics<f64>, command: &AttitudeCommand<f64>) -> [f64; R] {
        let ticks = self.tick();
        self.held = self.model.attitude(&self.model.own(state), &self.held, command, ticks);
        self.held.rotors
    }

    /// One step of a rate command; returns rotor actions in [−1, 1].
    pub fn rate(&mut self, state: &Kinematics<f64>, command: &RateCommand<f64>) -> [f64; R] {
        let ticks = self.tick();
        self.held = self.model.rate(&self.model.own(state), &self.held, command, ticks);
        self.held.rotors
    }

    fn tick(&mut self) -> [f64; 3] {
        let ticks = self.schedule.ticks(self.step);
        self.step += 1;
        ticks
    }
}

#[cfg(test)]
pub(crate) mod tests;
