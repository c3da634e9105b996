//! One drone that carries swinging loads, steered by the state feedback of least cost around its lower levels.
//!
//! The plant of the design is the whole articulated system under the drone's velocity, attitude and rate levels: it takes an
//! acceleration command, with rotor lag, inner loops and the loads' motion inside. Linearised at hover on its
//! [error state](super::design::error_state) and held over the period T of the velocity level, it gets the optimal
//! feedback K of [`mod@super::design::lqr`]. With z = (p, v, a, j, s) of the reference, in the frame of the drone's heading:
//!
//! ```text
//! e = (x ⊖ hover) − Π z        a_cmd = Γ z − K e + Σⱼ Fⱼ Π (Φ zⱼ − zⱼ₊₁)
//! ```
//!
//! - Π z and Γ z are where the plant is, and what it is told, when it follows z exactly
//!   ([`mod@super::design::feed_forward`]): tilt, rates, rotor speeds and the loads' lean.
//! - The sum sees [`LqrWeights::preview`] ahead how far z departs from its Taylor series Φ z: it leans a load that stands before
//!   the drone turns, which no feedback of the present can. Loads that hang need none of it.
//! - Far from the reference the cost asks for more than tilt can give. d, the position from which the present tilt, lean and
//!   velocities cost least, is held within [`LqrWeights::reach`] of the target by moving the target towards it. Were it moved onto
//!   d in every period, the cost would still fall in every one, so the load stays up; a start far away only takes longer.
//!
//! Where the reference is [`Carried`] and the load a single one on a universal joint, Π z and Γ z give way to the state and
//! the force of [`LoadFlatness`], exact however far the load leans: then a_cmd = F/(m + m_q) − g e_z − K (x ⊖ x_flat), F ahead by
//! the rotors' lag, with its derivatives as jerk and snap. No preview is needed: that state obeys the dynamics.

use super::cascade::{Cascade, CascadeModel, RateDivisors, Rates};
use super::controller::{Controller, Measurement, Target};
use super::design::{ErrorState, FeedForward, Regulator, bryson, feed_forward, lqr_of};
use super::kinematics::Kinematics;
use super::linear::spectral_radius;
use super::load_flatness::LoadFlatness;
use super::reference::{Carried, Reference, Setpoint};
use super::velocity::VelocityCommand;
use autodiff::{Scalar, System, linearise, safe};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::rotor::commanded_speed;
use dynamics::spatial::{matrix, multiply, sub};
use dynamics::tree::{Model, Motion, Multibody, carrier};
use dynamics::{Gains, MAX_ROTORS, Plant};
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

/// Largest drift of the hover that the design starts from, SI units per second.
const STILL: f64 = 1e-6;

with_defaults! {
    /// What the feedback is to hold, as largest acceptable deviations for Bryson's rule.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct LqrWeights {
        /// Of the root from the reference, m. Default 0.2.
        pub position: f64 = 0.2,
        /// Of the rate of passive hinges from what the reference needs, rad/s (slides: m/s): smaller damps swinging more and
        /// tracks less. Default 4.
        pub swing: f64 = 4.0,
        /// Of the acceleration command, m/s². Default 3.
        pub acceleration: f64 = 3.0,
        /// How far ahead the reference is seen, s, up to 60; `None`, the default, for 4 s where a load falls without control,
        /// and 0 otherwise.
        pub preview: Option<f64> = None,
        /// Largest error of position that is acted upon at once, m. Default 0.2.
        pub reach: f64 = 0.2,
    }
}

impl LqrWeights {
    /// Checks the ranges given with the fields.
    ///
    /// # Errors
    /// [`Error::Value`] for the first that is outside. `swing` and `reach` may be ∞, which switches them off; `position` and
    /// `acceleration` are finite.
    pub fn validate(&self) -> Result<()> {
        let preview = self.preview.unwrap_or(0.0);
        let rows = [
            ("weights.position", self.position, self.position > 0.0 && self.position.is_finite(), "> 0 m"),
            ("weights.swing", self.swing, self.swing > 0.0, "> 0 rad/s"),
            (
                "weights.acceleration",
                self.acceleration,
                self.acceleration > 0.0 && self.acceleration.is_finite(),
                "> 0 m/s²",
            ),
            ("weights.preview", preview, (0.0..=60.0).contains(&preview), "within [0, 60] s"),
            ("weights.reach", self.reach, self.reach > 0.0, "> 0 m"),
        ];
        match rows.into_iter().find(|row| !row.2) {
            None => Ok(()),
            Some((what, value, _, rule)) => Err(Error::value(what, value, rule, "Leave it out for the default.")),
        }
    }
}

/// Preview where a load falls without control, s.
const AHEAD: f64 = 4.0;
/// Modulus of a discrete eigenvalue above which a plant counts as falling; integrators stand at 1 but for rounding.
const FALLS: f64 = 1.0 + 1e-4;

/// Numbers of a reference that are fed forward: position, velocity, acceleration, jerk, snap.
const N_FORWARD: usize = 15;
/// What those of one instant add to the acceleration command, and to the position at which the rest costs least.
type Ahead = SMatrix<f64, 6, N_FORWARD>;

/// The state feedback of one drone with what hangs on it.
#[derive(Debug, Clone)]
pub struct Lqr {
    system: Multibody,
    errors: ErrorState,
    /// At the origin.
    hover: Vec<f64>,
    cascade: Cascade,
    actions: Vec<usize>,
    regulator: Regulator,
    following: FeedForward,
    ahead: Vec<Ahead>,
    /// 3 × n: from the slope of the cost to the position, from the target, at which the rest costs least.
    nearest: DMatrix<f64>,
    /// m.
    reach: f64,
    /// Of the velocity level, s.
    period: f64,
    step: u64,
    said: VelocityCommand<f64>,
    flat: Option<LoadFlatness>,
    /// By how much the rotors are late, s.
    lag: f64,
    scratch: Scratch,
}

/// Memory of a tick of the velocity level.
#[derive(Debug, Clone, Default)]
struct Scratch {
    /// The state about the reference.
    state: Vec<f64>,
    /// Of the size of the error: its slope, and what the reference asks for.
    slope: DVector<f64>,
    wanted: DVector<f64>,
    /// Of three numbers: the position at which the rest costs least, the command fed forward and fed back.
    away: DVector<f64>,
    forward: DVector<f64>,
    back: DVector<f64>,
}

impl Scratch {
    fn of(n_error: usize) -> Self {
        let [slope, wanted] = [0, 1].map(|_| DVector::zeros(n_error));
        let [away, forward, back] = [0, 1, 2].map(|_| DVector::zeros(3));
        Self { state: Vec::new(), slope, wanted, away, forward, back }
    }
}

impl Lqr {
    /// For a model with one drone on a floating root and loads on passive hinges or slides that hover can hold level.
    /// Without `gains`, those of the inner levels are derived from the drone.
    ///
    /// # Errors
    /// [`Error::Value`] for another model, a load that the drone cannot steer, or rates that do not divide 1/dt.
    pub fn new(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        Self::with_weights(system, gains, rates, &LqrWeights::default())
    }

    /// Likewise, with given weights.
    ///
    /// # Errors
    /// Likewise, and where a weight is not positive.
    pub fn with_weights(
        system: &Multibody,
        gains: Option<&Gains>,
        rates: &Rates,
        weights: &LqrWeights,
    ) -> Result<Self> {
        let model = system.model();
        fits(model)?;
        weights.validate()?;
        let vehicle = carrier(model, 0)?;
        let gains = gains.copied().unwrap_or_else(|| vehicle.derived_gains());
        let mut cascade = Cascade::new(&vehicle, &gains, rates, system.physics().dt)?;
        cascade.model.axes.refuse(&vehicle)?;
        cascade.model.body.mass = model.mass();
        cascade.reset();
        let actions = model.drones()[0].rotors.iter().map(|r| system.layout().rotor_action[*r]).collect();
        let plant = Inner { system, cascade: cascade.model, actions };
        let (errors, hover) = (ErrorState::of(system), plant.hover());
        let (a, b) = plant.linearised(&errors, &hover, cascade.schedule.every[0])?;
        let (q, r) = costs(system, &errors, weights)?;
        let regulator = lqr_of(&errors.signals(&Plant::Tree(system.clone())), &a, &b, &q, &r)?;
        let period = cascade.schedule.every[0] as f64 * system.physics().dt;
        let position = DMatrix::identity(3, errors.n_error());
        let following = feed_forward(&a, &b, &position, period, N_FORWARD / 3)?;
        let falls = spectral_radius(&a)? > FALLS;
        let preview = weights.preview.unwrap_or(if falls { AHEAD } else { 0.0 });
        let nearest = nearest(&regulator.cost)?;
        Ok(Self {
            ahead: ahead(&following, &regulator, &nearest, (preview / period).round() as usize),
            nearest,
            reach: weights.reach,
            actions: plant.actions,
            said: VelocityCommand::constant([0.0; 3], 0.0),
            flat: LoadFlatness::of(model),
            lag: vehicle.rotors.iter().map(|r| r.time_constant_up.max(r.time_constant_down)).fold(0.0, f64::max),
            system: system.clone(),
            step: 0,
            scratch: Scratch::of(errors.n_error()),
            errors,
            hover,
            cascade,
            regulator,
            following,
            period,
        })
    }

    /// The feedback, its poles per period of the velocity level.
    pub fn regulator(&self) -> &Regulator {
        &self.regulator
    }

    /// Order of the error state that the feedback multiplies.
    pub fn errors(&self) -> &ErrorState {
        &self.errors
    }

    /// Of the way of a load: a_cmd and its first two derivatives, world.
    fn carried(
        &self,
        seen: Measurement<'_>,
        own: &Kinematics<f64>,
        flat: &LoadFlatness,
        way: &Carried,
    ) -> [[f64; 3]; 3] {
        let heading = heading(own);
        let wanted = along(heading, &flat.state(&self.system, way, seen.time));
        let mut error = self.errors.difference(&along(heading, seen.state), &wanted);
        let away = &self.nearest * (&self.regulator.cost * &error);
        self.within_reach(&mut error, &away);
        let feedback = &self.regulator.gain * error;
        let [mut push, jerk, snap] = flat.push(way, seen.time + self.lag);
        let feedback = turned([feedback[0], feedback[1], feedback[2]], heading);
        for k in 0..3 {
            push[k] -= feedback[k];
        }
        push[2] -= self.system.model().parts().gravity;
        [push, jerk, snap]
    }

    /// Moves the target towards the position `away` from it at which the rest costs least.
    fn within_reach(&self, error: &mut DVector<f64>, away: &DVector<f64>) {
        let beyond = 1.0 - (self.reach / away.norm().max(f64::MIN_POSITIVE)).min(1.0);
        for k in 0..3 {
            error[k] -= beyond * away[k];
        }
    }

    /// a_cmd, world, m/s².
    fn acceleration(
        &self,
        seen: Measurement<'_>,
        target: Target<'_>,
        wanted: &Setpoint<f64>,
        scratch: &mut Scratch,
    ) -> [f64; 3] {
        let Scratch { state, slope, wanted: asked, away, forward: command, back } = scratch;
        let own = &self.tracked(seen.state);
        let heading = heading(own);
        let z = |time: f64| {
            let then = target.sample(time);
            let from_here = sub(then.position, wanted.position);
            let rows = [from_here, then.velocity, then.acceleration, then.jerk, then.snap];
            SVector::<f64, N_FORWARD>::from_column_slice(rows.map(|v| turned(v, -heading)).as_flattened())
        };
        state.clear();
        state.extend_from_slice(seen.state);
        let (s, c) = (-0.5 * heading).sin_cos();
        state[..3].copy_from_slice(&turned(sub(own.position, wanted.position), -heading));
        state[3..6].copy_from_slice(&turned(own.velocity, -heading));
        state[6..10].copy_from_slice(&multiply([c, 0.0, 0.0, s], own.attitude));
        let mut error = self.errors.difference(state, &self.hover);
        let now = z(seen.time);
        self.following.state.mul_to(&now, asked);
        error -= &*asked;
        let mut forward = SVector::<f64, 6>::zeros();
        for (j, gain) in self.ahead.iter().enumerate() {
            forward += gain * z(seen.time + j as f64 * self.period);
        }
        self.regulator.cost.mul_to(&error, slope);
        self.nearest.mul_to(slope, away);
        *away += forward.rows(3, 3);
        self.within_reach(&mut error, away);
        self.following.input.mul_to(&now, command);
        *command += forward.rows(0, 3);
        self.regulator.gain.mul_to(&error, back);
        *command -= &*back;
        turned([command[0], command[1], command[2]], heading)
    }
}

impl Controller for Lqr {
    fn name(&self) -> &str {
        "lqr"
    }

    fn why_no_law(&self) -> &'static str {
        "a feedback that reads the reference seconds ahead, not one target"
    }

    fn description(&self) -> String {
        let slowest = self.regulator.poles.first().map_or(0.0, |p| p.norm().ln() / self.period);
        format!("optimal feedback of the whole state, slowest pole at {slowest:.2} 1/s")
    }

    fn schedule(&self) -> Option<RateDivisors> {
        Some(self.cascade.schedule)
    }

    /// Not with all levels in every tick.
    fn remembers(&self) -> bool {
        self.cascade.schedule.every != [1; 3]
    }

    fn reset(&mut self) {
        self.cascade.reset();
        (self.step, self.said) = (0, VelocityCommand::constant([0.0; 3], 0.0));
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, input: &mut [f64]) {
        let own = self.tracked(seen.state);
        if self.step.is_multiple_of(self.cascade.schedule.every[0]) {
            let wanted = target.sample(seen.time);
            let [acceleration, jerk, snap] = match (&self.flat, target.reference) {
                (Some(flat), Reference::Carried(way)) => self.carried(seen, &own, flat, way),
                _ => {
                    let mut scratch = std::mem::take(&mut self.scratch);
                    let acceleration = self.acceleration(seen, target, &wanted, &mut scratch);
                    self.scratch = scratch;
                    [acceleration, [0.0; 3], [0.0; 3]]
                }
            };
            self.said = VelocityCommand {
                acceleration,
                jerk,
                snap,
                yaw_rate: wanted.yaw_rate,
                yaw_acceleration: wanted.yaw_acceleration,
                ..VelocityCommand::constant(own.velocity, wanted.yaw)
            };
        }
        self.step += 1;
        let actions = self.cascade.velocity(&own, &self.said);
        for (at, action) in self.actions.iter().zip(actions) {
            input[*at] = action;
        }
    }
}

/// Yaw of the root's x axis, rad.
fn heading(own: &Kinematics<f64>) -> f64 {
    let r = matrix(own.attitude);
    safe::atan2(r[1][0], r[0][0])
}

/// A state turned about the world's origin so that this heading becomes 0.
fn along(heading: f64, state: &[f64]) -> Vec<f64> {
    let mut state = state.to_vec();
    let (s, c) = (-0.5 * heading).sin_cos();
    let attitude = multiply([c, 0.0, 0.0, s], [state[6], state[7], state[8], state[9]]);
    for first in [0, 3] {
        let v = turned([state[first], state[first + 1], state[first + 2]], -heading);
        state[first..first + 3].copy_from_slice(&v);
    }
    state[6..10].copy_from_slice(&attitude);
    state
}

/// v turned about the vertical.
fn turned([x, y, z]: [f64; 3], angle: f64) -> [f64; 3] {
    let (s, c) = angle.sin_cos();
    [c * x - s * y, s * x + c * y, z]
}

/// Whether [`Lqr`] can take a model, and all that moves on the drone is one chain: its swings are then of different rates.
pub fn suits(model: &Model) -> bool {
    carries(model) && model.bodies().iter().enumerate().skip(1).all(|(i, b)| b.parent == Some(i - 1))
}

/// Whether [`Lqr`] can take a model: one drone on a floating root, and something passive that moves on it.
pub fn carries(model: &Model) -> bool {
    let passive = |motion: &Motion| matches!(motion, Motion::Revolute(_) | Motion::Prismatic(_));
    let [root, moved @ ..] = model.bodies() else { return false };
    let [drone] = model.drones() else { return false };
    root.joint.motion == Motion::Floating
        && drone.body == 0
        && !moved.is_empty()
        && moved.iter().all(|b| b.joint.drive.is_none() && passive(&b.joint.motion))
}

fn fits(model: &Model) -> Result<()> {
    if carries(model) {
        return Ok(());
    }
    let what = format!("model '{}'", model.name());
    let rule = "one drone on a floating root with passive hinges or slides on it";
    Err(Error::value(what, "of another make", rule, "Ask controllers::default_controller."))
}

/// The articulated system under the drone's levels, every one in every step: an acceleration command in, world axes, m/s².
struct Inner<'a> {
    system: &'a Multibody,
    cascade: CascadeModel<f64, MAX_ROTORS>,
    actions: Vec<usize>,
}

impl System for Inner<'_> {
    fn n_state(&self) -> usize {
        self.system.n_state()
    }
    fn n_input(&self) -> usize {
        3
    }
    fn n_parameter(&self) -> usize {
        0
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], _: &[S], next: &mut [S]) {
        let cascade = CascadeModel::<S, MAX_ROTORS>::constant(&self.cascade);
        let own = cascade.own(&Kinematics::read(state));
        let mut command = VelocityCommand::constant(own.velocity, S::zero());
        command.acceleration = [input[0], input[1], input[2]];
        let held = cascade.velocity(&own, &cascade.initial(), &command, [S::one(); 3]);
        let mut actions = vec![S::zero(); self.system.n_input()];
        for (at, action) in self.actions.iter().zip(held.rotors) {
            actions[*at] = action;
        }
        self.system.step(state, &actions, &[], next);
    }
}

impl Inner<'_> {
    /// Everything at rest at the origin, rotors at the speed that carries the weight.
    fn hover(&self) -> Vec<f64> {
        let (model, layout) = (self.system.model(), self.system.layout());
        let mut state = self.system.rest_state();
        state[..10].copy_from_slice(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        let carried = self.cascade.initial().rotors;
        for (r, action) in model.drones()[0].rotors.iter().zip(carried) {
            state[layout.rotor_speed[*r]] = commanded_speed(model.rotors()[*r].rotor.max_speed, action);
        }
        state
    }

    /// A and B over `steps` steps with one command, on the error state about hover.
    fn linearised(&self, errors: &ErrorState, hover: &[f64], steps: u64) -> Result<(DMatrix<f64>, DMatrix<f64>)> {
        let one = linearise(self, hover, &[0.0; 3], &[]);
        let drift = errors.difference(one.next.as_slice(), hover).amax() / self.system.physics().dt;
        if drift.is_nan() || drift > STILL {
            let what = format!("model '{}': drift of the level hover", self.system.model().name());
            let remedy = "Hang the load below or above the drone's centre of mass, or fly it with a Formation.";
            return Err(Error::value(what, drift, format!("≤ {STILL} (SI units per second)"), remedy));
        }
        let (a, b) = errors.reduce(hover, &one);
        let (mut state, mut input) = (a.clone(), b.clone());
        for _ in 1..steps {
            input = &a * input + &b;
            state = &a * state;
        }
        Ok((state, input))
    }
}

/// Q and R by Bryson's rule.
fn costs(system: &Multibody, errors: &ErrorState, weights: &LqrWeights) -> Result<(DMatrix<f64>, DMatrix<f64>)> {
    let mut most = vec![f64::INFINITY; errors.n_error()];
    most[..3].fill(weights.position);
    for place in &system.layout().bodies[1..] {
        most[errors.place(place.velocity)] = weights.swing;
    }
    Ok((bryson(&most)?, bryson(&[weights.acceleration; 3])?))
}

/// (Eᵀ X E)⁻¹ Eᵀ, E the columns of the position: where the slope Xe + g of the cost has no part along the position.
fn nearest(cost: &DMatrix<f64>) -> Result<DMatrix<f64>> {
    let Some(inverse) = cost.view((0, 0), (3, 3)).into_owned().try_inverse() else {
        let remedy = "Lower weights.position.";
        return Err(Error::value("weight of the position", "lost to rounding", "of weight in the cost", remedy));
    };
    Ok(inverse * DMatrix::identity(3, cost.nrows()))
}

/// The error from x = Π z is disturbed by w = Π (Φ z − z⁺); per instant, what that adds to command and nearest position.
/// The cost from e on is eᵀXe + 2eᵀg + …, g = Σ (A_cᵀ)ʲ⁺¹ X wⱼ, so X⁻¹g counts as error where positions are compared.
fn ahead(following: &FeedForward, regulator: &Regulator, nearest: &DMatrix<f64>, n: usize) -> Vec<Ahead> {
    let size = regulator.cost.nrows();
    let mut left = DMatrix::zeros(6, size);
    left.rows_mut(0, 3).copy_from(&-&regulator.push);
    left.rows_mut(3, 3).copy_from(&(nearest * regulator.closed_loop.transpose()));
    let mut before = DMatrix::zeros(6, N_FORWARD);
    let row = |f: DMatrix<f64>| {
        let now = f * &following.state;
        let gain = &now * &following.advance - std::mem::replace(&mut before, now);
        Ahead::from_column_slice(gain.as_slice())
    };
    regulator.preview(&left, n).into_iter().map(row).collect()
}
