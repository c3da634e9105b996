//! Optimal state feedback of one rigid vehicle about hover: LQR, and LQI with integrators of position and yaw.
//!
//! The plant of the design is the vehicle with its motors, rotor commands in, linearised at hover on its
//! [error state](super::design::error_state) (12 numbers and one per rotor) and held over the period of the rate level. With the
//! reference's state x_ref and commands u_ref of the flatness map,
//!
//! ```text
//! u = u_ref − K (x ⊖ x_ref) − K_i z        z⁺ = z + T (p − p_ref, ψ − ψ_ref)
//! ```
//!
//! Position and velocity are taken in the frame of the reference's heading. Far errors are cut at what [`HoverWeights::reach`]
//! allows, and z waits while a rotor is at a limit or the position is far (a third of the reach), so that it does not wind up. The rotor
//! speeds are measured.

use super::cascade::{CascadeModel, RateDivisors, Rates};
use super::design::{ErrorState, Regulator, TrimTarget, bryson, lqi_of, lqr_of, trim};
use super::hover_axes::HoverAxes;
use super::kinematics::Kinematics;
use super::law::{ControlLaw, LawInput};
use super::position::add_drag;
use super::rate::{RateCommand, moment};
use super::velocity::{VelocityCommand, attitude_command};
use autodiff::{Scalar, System, linearise, safe};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::Plant;
use dynamics::spatial::{conjugate, from_matrix, mat_mul, mat_vec, matrix, multiply, sub, transpose};
use dynamics::vehicle::MAX_ROTORS;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// Largest acceptable deviations, for Bryson's rule; infinity weighs nothing.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct HoverWeights {
        /// m. Default 0.1.
        pub position: f64 = 0.1,
        /// m/s. Default 0.5.
        pub velocity: f64 = 0.5,
        /// Roll and pitch, rad. Default 0.3.
        pub tilt: f64 = 0.3,
        /// rad. Default 0.3.
        pub yaw: f64 = 0.3,
        /// Body rates, rad/s. Default 2.
        pub rate: f64 = 2.0,
        /// Of a command in [−1, 1]. Default 0.3.
        pub command: f64 = 0.3,
        /// Of the integral of position, m s. Default 0.3.
        pub integral: f64 = 0.3,
        /// Of the integral of yaw, rad s. Default 0.3.
        pub yaw_integral: f64 = 0.3,
        /// Position error that is acted upon at once, m; velocity errors at three times, yaw at half of it. Default 1.
        pub reach: f64 = 1.0,
    }
}

/// Numbers of the error state before the rotor speeds, and integrated ones.
const BODY: usize = 12;
const INTEGRATED: usize = 4;

/// LQR or LQI of a rigid vehicle.
///
/// - Target: a [`Setpoint`](super::Setpoint). Memory: of LQI the integrals of position (world) and yaw.
/// - Ticks at the rate of the rate level.
#[derive(Debug, Clone)]
pub struct HoverFeedback {
    model: CascadeModel<f64, MAX_ROTORS>,
    max_speed: Vec<f64>,
    regulator: Regulator,
    integrates: bool,
    reach: f64,
    period: f64,
    rate: Option<f64>,
}

impl HoverFeedback {
    /// LQR of the vehicle that a plant is believed to be.
    ///
    /// # Errors
    /// [`Error::Value`] for an articulated plant, one that cannot hover, rates that do not divide 1/dt, or weights that are not
    /// positive; as [`lqr`](fn@super::design::lqr).
    pub fn lqr(plant: &Plant, rates: &Rates, weights: &HoverWeights) -> Result<Self> {
        Self::new(plant, rates, weights, false)
    }

    /// LQI of the vehicle that a plant is believed to be.
    ///
    /// # Errors
    /// As [`lqr`](Self::lqr).
    pub fn lqi(plant: &Plant, rates: &Rates, weights: &HoverWeights) -> Result<Self> {
        Self::new(plant, rates, weights, true)
    }

    fn new(plant: &Plant, rates: &Rates, weights: &HoverWeights, integrates: bool) -> Result<Self> {
        let Plant::Rigid(multirotor) = plant else {
            let rule = "one rigid vehicle";
            return Err(Error::value(format!("plant '{}'", plant.name()), "articulated", rule, "Use 'lqr' of chains."));
        };
        let vehicle = super::cascade_law::with_drag_of(multirotor.vehicle(), plant.physics().effects);
        let model = CascadeModel::new(&vehicle, &vehicle.derived_gains())?;
        let axes = HoverAxes::of(&vehicle);
        let leaning = if axes.leans() { Some(Plant::of_vehicle(&vehicle.upright(), *plant.physics())?) } else { None };
        let plant = leaning.as_ref().unwrap_or(plant);
        let every = RateDivisors::new(rates, plant.physics().dt)?.every[2];
        let period = every as f64 * plant.physics().dt;
        let (a, b) = sampled(plant, vehicle.n_rotor(), every)?;
        let (q, r) = weights.costs(vehicle.n_rotor(), integrates)?;
        let states = ErrorState::of_plant(plant)?.signals(plant);
        let regulator = if integrates {
            lqi_of(&states, &a, &b, &integrated(a.nrows()), &q, &r, period)?
        } else {
            lqr_of(&states, &a, &b, &q, &r)?
        };
        Ok(Self {
            model,
            max_speed: vehicle.rotors.iter().map(|r| r.max_speed).collect(),
            regulator,
            integrates,
            reach: weights.reach,
            period,
            rate: (every > 1).then_some(rates.rate),
        })
    }

    /// The feedback over the error state and, of LQI, the integrals; its poles are per period.
    pub fn regulator(&self) -> &Regulator {
        &self.regulator
    }

    /// State, commands and frame of a reference, first those of the body, then of the rotors.
    fn flat<S: Scalar>(&self, state: &Kinematics<S>, now: &LawInput<'_, S>) -> Flat<S> {
        let model = CascadeModel::<S, MAX_ROTORS>::constant(&self.model);
        let sample = now.sample();
        let wanted = [sample.velocity, sample.acceleration, sample.jerk];
        let command = add_drag(&model.body, state, wanted, &VelocityCommand::along(&sample));
        // along its own trajectory: no error, and the attitude that is wanted
        let level = Kinematics { velocity: sample.velocity, ..Kinematics::at_rest(sample.position) };
        let attitude = attitude_command(&model.gains, &model.body, &model.limits, &command, &level);
        let upright = attitude.attitude[2][2].max(S::constant(0.1));
        let thrust = (attitude.thrust * upright.recip()).clamp(S::zero(), model.limits.thrust);
        let turn = RateCommand {
            thrust,
            angular_velocity: attitude.angular_velocity,
            angular_acceleration: attitude.angular_acceleration,
        };
        let m = moment(&model.gains, model.body.inertia, &turn, attitude.angular_velocity);
        let actions = model.actions([thrust, m[0], m[1], m[2]]);
        Flat { attitude: attitude.attitude, angular_velocity: attitude.angular_velocity, actions, yaw: sample.yaw }
    }

    /// (x ⊖ x_ref, then what is integrated now): position and velocity along the reference's heading.
    fn error<S: Scalar>(&self, state: &Kinematics<S>, now: &LawInput<'_, S>, flat: &Flat<S>) -> [S; BODY] {
        let sample = now.sample();
        let (s, c) = flat.yaw.sin_cos();
        let along = |v: [S; 3]| [c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]];
        let position = cut(along(sub(state.position, sample.position)), self.reach);
        let velocity = cut(along(sub(state.velocity, sample.velocity)), 3.0 * self.reach);
        let q = multiply(conjugate(from_matrix(flat.attitude)), state.attitude);
        let two = S::select(q[0].lt(S::zero()), S::constant(-2.0), S::constant(2.0));
        let most = S::constant(0.5 * self.reach);
        let turned = [two * q[1], two * q[2], (two * q[3]).clamp(-most, most)];
        let to_body = mat_mul(transpose(matrix(state.attitude)), flat.attitude);
        let rate = sub(state.angular_velocity, mat_vec(to_body, flat.angular_velocity));
        let mut error = [S::zero(); BODY];
        for k in 0..3 {
            (error[k], error[3 + k], error[6 + k], error[9 + k]) = (position[k], velocity[k], turned[k], rate[k]);
        }
        error
    }
}

/// A reference as the body and its rotors see it.
struct Flat<S> {
    attitude: [[S; 3]; 3],
    angular_velocity: [S; 3],
    actions: [S; MAX_ROTORS],
    yaw: S,
}

/// v, no longer than `most`.
#[inline]
fn cut<S: Scalar>(v: [S; 3], most: f64) -> [S; 3] {
    let most = S::constant(most);
    let share = most * safe::norm(v).max(most).recip();
    v.map(|x| x * share)
}

/// A and B of the error state over one period with held commands.
fn sampled(plant: &Plant, n_rotor: usize, every: u64) -> Result<(DMatrix<f64>, DMatrix<f64>)> {
    let hover = trim(plant, &TrimTarget::hover())?;
    let errors = ErrorState::of_plant(plant)?;
    let theta = if plant.n_parameter() > 0 { plant.parameters() } else { Vec::new() };
    let mut state = hover.state;
    plant.take_longer_lags(&mut state);
    let (a, b) = errors.reduce(&state, &linearise(plant, &state, &hover.input, &theta));
    let b = b.columns(0, n_rotor).into_owned();
    let (mut held, mut input) = (a.clone(), b.clone());
    for _ in 1..every {
        input = &a * input + &b;
        held = &a * held;
    }
    Ok((held, input))
}

/// C of what is integrated: position and yaw.
fn integrated(n: usize) -> DMatrix<f64> {
    let mut c = DMatrix::zeros(INTEGRATED, n);
    [0, 1, 2, 8].iter().enumerate().for_each(|(row, column)| c[(row, *column)] = 1.0);
    c
}

impl HoverWeights {
    fn costs(&self, n_rotor: usize, integrates: bool) -> Result<(DMatrix<f64>, DMatrix<f64>)> {
        let rows = [
            ("weights.position", self.position),
            ("weights.velocity", self.velocity),
            ("weights.tilt", self.tilt),
            ("weights.yaw", self.yaw),
            ("weights.rate", self.rate),
            ("weights.command", self.command),
            ("weights.integral", self.integral),
            ("weights.yaw_integral", self.yaw_integral),
        ];
        if let Some((what, value)) = rows.into_iter().find(|(_, v)| v.is_nan() || *v <= 0.0) {
            return Err(Error::value(what, value, "> 0", "Leave it out for the default; infinity weighs nothing."));
        }
        if !(self.reach > 0.0 && self.reach <= 1e3) {
            return Err(Error::value("weights.reach", self.reach, "within (0, 1000] m", "Leave it out for 1 m."));
        }
        let three = |v: f64| [v; 3];
        let mut most =
            [three(self.position), three(self.velocity), [self.tilt, self.tilt, self.yaw], three(self.rate)].concat();
        most.extend(vec![f64::INFINITY; n_rotor]);
        if integrates {
            most.extend([self.integral, self.integral, self.integral, self.yaw_integral]);
        }
        Ok((bryson(&most)?, bryson(&vec![self.command; n_rotor])?))
    }
}

impl ControlLaw for HoverFeedback {
    fn name(&self) -> &str {
        if self.integrates { "lqi" } else { "lqr" }
    }

    fn description(&self) -> String {
        let slowest = self.regulator.poles.first().map_or(0.0, |p| p.norm().ln() / self.period);
        let kind = if self.integrates { "with integrals of position and yaw, " } else { "" };
        format!("optimal feedback of body and rotors about hover, {kind}slowest pole at {slowest:.2} 1/s")
    }

    fn rate(&self) -> Option<f64> {
        self.rate
    }

    fn memory(&self) -> Vec<f64> {
        vec![0.0; if self.integrates { INTEGRATED } else { 0 }]
    }

    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, memory: &mut [S], commands: &mut [S]) {
        let state = HoverAxes::constant(&self.model.axes).kinematics(&now.kinematics());
        let flat = self.flat(&state, now);
        let error = self.error(&state, now, &flat);
        let (s, c) = flat.yaw.sin_cos();
        let n = self.max_speed.len();
        let half = S::constant(0.5);
        let mut at_limit = S::zero();
        for i in 0..n {
            let row = self.regulator.gain.row(i);
            let mut sum = S::zero();
            for k in 0..BODY {
                sum = S::constant(row[k]).mul_add(error[k], sum);
            }
            for r in 0..n {
                let share = (half * (flat.actions[r] + S::one())).clamp(S::zero(), S::one());
                let wanted = S::constant(self.max_speed[r]) * safe::sqrt(share, safe::SQUARED_NORM_FLOOR);
                sum = S::constant(row[BODY + r]).mul_add(now.state[13 + r] - wanted, sum);
            }
            if self.integrates {
                let z = [c * memory[0] + s * memory[1], c * memory[1] - s * memory[0], memory[2], memory[3]];
                for k in 0..INTEGRATED {
                    sum = S::constant(row[BODY + n + k]).mul_add(z[k], sum);
                }
            }
            let free = flat.actions[i] - sum;
            commands[i] = free.clamp(-S::one(), S::one());
            at_limit = S::select(S::one().lt(free.abs()), S::one(), at_limit);
        }
        if self.integrates {
            // back along the world's axes
            let fresh = [c * error[0] - s * error[1], s * error[0] + c * error[1], error[2], error[8]];
            let far = S::constant(self.reach / 3.0).lt(safe::norm([error[0], error[1], error[2]]));
            let step = S::select(far, S::zero(), S::constant(self.period) * (S::one() - at_limit));
            for k in 0..INTEGRATED {
                memory[k] = step.mul_add(fresh[k], memory[k]);
            }
        }
    }
}
