//! Six-axis gains, null-space weight and tilt horizon by gradients through a bounded allocation.
//!
//! ```text
//! pose ─▶ six-axis law ─▶ w ─▶ QP over (T, Δα) within bounds ─▶ rotors, tilt rates ─▶ articulated Omav ─▶ pose
//! ```
//!
//! **Plant.** The whole articulated [`Omav`]: seven bodies, twelve rotors with lag, six servos. Nothing is reduced.
//!
//! **Allocation**, in every step, at the shape α and the thrusts T₀ of now, about the centre of mass, body axes:
//!
//! ```text
//! w(α + Δα, T) ≈ B(α) T + D(α, T₀) Δα,   bⱼ = ∂w/∂Tⱼ,  dⱼ = T₀ⱼ ∂bⱼ/∂αⱼ
//! minimise   ½ ‖B T + D Δα − w‖²_W + ½ ρ (‖T − T*‖² + s² ‖Δα − Δα*‖²)
//! subject to 0 ≤ Tⱼ ≤ T_max,  |Δαⱼ| ≤ α̇_max h
//! ```
//!
//! Tⱼ (N) is what pair j pushes with, half from each rotor; tilts count as s = mg/6 newtons per radian. The preference is
//! the wrench's own force f, spread over the arms with the least sum of squares: λ = (Σ (I − eeᵀ))⁻¹ f for hinges e,
//! T* = ‖λ across eⱼ‖, and Δα* turns the thrust there. W is that of [`mod@vectored`]. Tilts are
//! told to turn at Δα/h.
//!
//! **θ**, logarithms: the twelve gains, ρ and h; so geometry, preference, ρ and two of the four bounds live, and the
//! implicit derivative of [`AllocationFunction`] carries all of them: an operation inside a law that is straight-line but for it. Where an input meets or leaves its bound the cost has
//! a kink, and the derivative is that of one side.
//!
//! **Cost** of a flight, m²: the mean over its steps of ‖p − p_d‖² + ℓ² ‖e_R‖² + effort, ℓ = [`LEVER`], effort =
//! [`EFFORT`] times the mean squares of thrusts over T_max and of tilt rates over α̇_max.
//!
//! **Measured** by `tuning_through_allocation.rs`, 32 held-out starts, root of the mean cost: 0.0862 → 0.0528 m with
//! servos of 10 rad/s, where gains do nearly all of it (0.0530 m without ρ and h); with servos of 2 rad/s from ρ = 1,
//! 0.2424 → 0.1715 m, of which the weight is worth 10 % (0.1915 m with ρ put back); there position gains at the price of
//! attitude (e_R 0.076 → 0.114).
//!
//! Drag is not fed forward and neither is the reaction of moving tilts: the gains have to deal with both.
//!
//! Sources: differential allocation of tilting rotors after Ryll, Bülthoff and Robuffo Giordano (2015); implicit
//! derivative of the program, [`gradient`](crate::controllers::allocation::gradient).

use nalgebra::DMatrix;
use omnidrones::autodiff::{Gradient, Objective, Rollout, Scalar, System, safe};
use omnidrones::controllers::allocation::problem::WRENCH;
use omnidrones::controllers::allocation::{AllocationFunction, Problem, composite_inertia};
use omnidrones::controllers::attitude::attitude_error;
use omnidrones::controllers::design::tune::{CRASH_DISTANCE, MAX_STARTS};
use omnidrones::controllers::design::{Descent, Iteration};
use omnidrones::controllers::parameters::{BodyModel, CommandLimits, ForceLimits, GainSet};
use omnidrones::controllers::reference::{Curve, Lemniscate};
use omnidrones::controllers::{
    AttitudeCommand, ClosedLoop, ControlLaw, Kinematics, LawController, LawInput, Orientation, Rates, Reference,
    Setpoint, SixAxis, Target, vectored,
};
use omnidrones::dynamics::configurations::Omav;
use omnidrones::dynamics::spatial::*;
use omnidrones::dynamics::tree::{Motion, Multibody, body_poses, center_of_mass};
use omnidrones::dynamics::{Disturbance, Gains, Physics, Rotor};
use omnidrones::error::{Error, Result};
use omnidrones::parallel::Threads;
use omnidrones::rng::{Purpose, Stream};

/// ρ to start from: what a newton away from its preference costs, against a newton of force that is missing.
const NULL_SPACE: f64 = 1e-3;

/// Training and held-out starts come from streams that never meet.
const TRAINING: u64 = 0;
const HELD_OUT: u64 = 1;

/// Arms.
const N_ARM: usize = 6;
/// Inputs of the allocation: thrusts of pairs, then tilts.
pub const N_INPUT: usize = 2 * N_ARM;
/// Numbers of θ: twelve gains, ρ, h.
pub const N_PARAMETER: usize = GainSet::<f64>::DIM + 2;
/// ℓ, m: a radian of attitude counts as half a metre.
pub const LEVER: f64 = 0.5;
/// Weight of the effort, m².
pub const EFFORT: f64 = 1e-3;

/// A pair of rotors on its hinge.
#[derive(Debug, Clone)]
struct Arm {
    body: usize,
    /// Of the hinge, in the unit and in the core alike.
    axis: Vec3<f64>,
    rotors: [Rotor; 2],
    /// Places in the state.
    speeds: [usize; 2],
    rate: usize,
    /// Places in the input.
    actions: [usize; 2],
    drive: usize,
    /// α̇_max, rad/s.
    range: f64,
}

/// The loop: θ as the [module](self) says.
pub type Tilting = ClosedLoop<LawController<TiltingLaw>>;

/// Its law. Target: a [`Setpoint`] and an [`AttitudeCommand`], whose thrust plays no part.
pub struct TiltingLaw {
    plant: Multibody,
    law: SixAxis<f64>,
    arms: Vec<Arm>,
    /// (Σ (I − eeᵀ))⁻¹, core.
    spread: Mat3<f64>,
    /// W.
    weights: [f64; WRENCH],
    /// s, N.
    share: f64,
    /// Of a pair, N.
    max_thrust: f64,
    function: AllocationFunction,
    nominal: Vec<f64>,
}

/// An Omav under `physics` and the law for it.
///
/// # Errors
/// As [`TiltingLaw::new`].
pub fn tilting(omav: &Omav, physics: Physics) -> Result<Tilting> {
    let law = TiltingLaw::new(omav, physics)?;
    Ok(ClosedLoop::new(law.plant.clone().into(), LawController::of(law))?.with_gains())
}

impl TiltingLaw {
    /// For an Omav, computing in every step. [`nominal`](Self::nominal) are the gains of the [`mod@vectored`] controller, a
    /// null-space weight of 1e-3, and h = 2τ, the reciprocal of a tilt gain.
    ///
    /// # Errors
    /// As [`Omav::build`] and [`Multibody::new`].
    pub fn new(omav: &Omav, physics: Physics) -> Result<Self> {
        let robot = omav.build()?;
        let plant = Multibody::new(&robot.model, physics)?;
        let arms = robot.map.units.iter().map(|unit| arm(&plant, *unit)).collect::<Result<Vec<Arm>>>()?;
        let mut across = [[0.0; 3]; 3];
        for e in arms.iter().map(|a| a.in_core(&plant)) {
            (0..9).for_each(|k| across[k / 3][k % 3] += f64::from(u8::from(k / 3 == k % 3)) - e[k / 3] * e[k % 3]);
        }
        let body = BodyModel {
            mass: robot.model.mass(),
            inertia: composite_inertia(&plant, &plant.rest_state()),
            drag: [0.0; 3],
            drag_moment: [[0.0; 3]; 3],
            gravity: robot.model.parts().gravity,
        };
        let gains = vectored::placed(&plant, &Rates::every_step(physics.dt), &body)?;
        let max_thrust = 2.0 * arms[0].rotors[0].max_thrust();
        let weight = body.mass * body.gravity;
        let limits = ForceLimits::constant(&CommandLimits::default(), N_ARM as f64 * max_thrust, weight);
        let law = SixAxis { body, gains: GainSet::constant(&gains), limits };
        let (weights, share) = (vectored::weights(&body), weight / N_ARM as f64);
        let template = Problem::boxed(DMatrix::zeros(WRENCH, N_INPUT), weights, vec![max_thrust; N_INPUT])?;
        let function = AllocationFunction::new(template)?;
        let mut nominal = vec![0.0; GainSet::<f64>::DIM];
        law.gains.write(&mut nominal);
        nominal.extend([NULL_SPACE, 2.0 * omav.time_constant]);
        nominal.iter_mut().for_each(|k| *k = k.ln());
        Ok(Self { plant, law, arms, spread: inverse(across), weights, share, max_thrust, function, nominal })
    }

    /// θ to start from.
    pub fn nominal(&self) -> &[f64] {
        &self.nominal
    }

    /// B and s⁻¹D by columns: wrench per newton of each pair's thrust, and per newton s Δα of each tilt.
    pub fn columns<S: Scalar>(&self, state: &[S]) -> [[S; WRENCH]; N_INPUT] {
        let poses = body_poses(&self.plant, state);
        let (center, core) = (center_of_mass(&self.plant, state), transpose(poses[0].rotation));
        let mut all = [[S::zero(); WRENCH]; N_INPUT];
        for (j, arm) in self.arms.iter().enumerate() {
            let pose = &poses[arm.body];
            let hinge = mat_vec(pose.rotation, constants(arm.axis));
            let per_unit = arm.thrust(state) * S::constant(0.5 / self.share);
            for rotor in &arm.rotors {
                let axis = mat_vec(pose.rotation, constants(rotor.axis));
                let lever = mat_vec(pose.rotation, constants(rotor.position));
                let place = sub(add(pose.position, lever), center);
                let reaction = S::constant(-rotor.spin * rotor.moment_per_thrust);
                let swing = cross(hinge, axis);
                let moment = axpy(cross(place, axis), reaction, axis);
                let turned = add(axpy(cross(place, swing), reaction, swing), cross(cross(hinge, lever), axis));
                for (column, size, vectors) in
                    [(j, S::constant(0.5), [axis, moment]), (N_ARM + j, per_unit, [swing, turned])]
                {
                    let [f, m] = vectors.map(|v| scale(size, mat_vec(core, v)));
                    all[column] = add(all[column], [f[0], f[1], f[2], m[0], m[1], m[2]]);
                }
            }
        }
        all
    }

    /// (T, s Δα): the allocation of one step.
    pub fn allocate<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S]) -> [S; N_INPUT] {
        let theta: [S; N_PARAMETER] = std::array::from_fn(|k| parameters[k].exp());
        let (sample, orientation) = input.split_at(Setpoint::<S>::DIM);
        let AttitudeCommand { attitude, angular_velocity, angular_acceleration, .. } =
            AttitudeCommand::read(orientation);
        let orientation = Orientation { attitude, angular_velocity, angular_acceleration };
        let law = SixAxis {
            body: BodyModel::constant(&self.law.body),
            gains: GainSet::read(&theta),
            limits: self.law.limits.cast(),
        };
        let wrench = law.position(&Kinematics::read(state), &Setpoint::read(sample), &orientation);
        let columns = self.columns(state);
        let preference = self.preference(&columns, [wrench[0], wrench[1], wrench[2]]);
        let [rho, horizon] = [theta[N_PARAMETER - 2], theta[N_PARAMETER - 1]];
        let reach = self.arms.iter().map(|arm| S::constant(self.share * arm.range) * horizon);
        let reach: Vec<S> = reach.collect();
        let most = [S::constant(self.max_thrust); N_ARM];

        // in the order of `Variation::numbers`
        let mut numbers = wrench.to_vec();
        numbers.extend(self.weights.map(S::constant));
        numbers.push(rho);
        numbers.extend(columns.iter().flatten());
        numbers.extend(preference);
        numbers.extend([S::zero(); N_ARM]);
        numbers.extend(reach.iter().map(|r| -*r));
        numbers.extend(most);
        numbers.extend(&reach);
        let mut inputs = [S::zero(); N_INPUT];
        self.function.call_numbers(&numbers, &mut inputs);
        inputs
    }

    /// (T*, s Δα*): the least sum of squares that makes this force.
    fn preference<S: Scalar>(&self, columns: &[[S; WRENCH]; N_INPUT], force: Vec3<S>) -> [S; N_INPUT] {
        let spread = [0, 1, 2].map(|k| constants(self.spread[k]));
        let lambda = mat_vec(spread, force);
        let mut wanted = [S::zero(); N_INPUT];
        for (j, arm) in self.arms.iter().enumerate() {
            let push = [columns[j][0], columns[j][1], columns[j][2]];
            let along = dot(push, lambda);
            let side = dot(cross(constants(arm.in_core(&self.plant)), push), lambda);
            wanted[j] = safe::norm([along, side]);
            wanted[N_ARM + j] = S::constant(self.share) * safe::atan2(side, along);
        }
        wanted
    }

    /// Number of thrusts and tilts on a bound in a state.
    pub fn n_bound(&self, state: &[f64], input: &[f64], parameters: &[f64]) -> [usize; 2] {
        let u = self.allocate(state, input, parameters);
        let horizon = parameters[N_PARAMETER - 1].exp();
        let thrusts = u[..N_ARM].iter().filter(|t| **t <= 0.0 || **t >= self.max_thrust);
        let reach = |j: usize| self.share * self.arms[j].range * horizon;
        let tilts = (0..N_ARM).filter(|j| u[N_ARM + j].abs() >= reach(*j) * (1.0 - 1e-12));
        [thrusts.count(), tilts.count()]
    }
}

impl ControlLaw for TiltingLaw {
    fn is_batched(&self) -> bool {
        false
    }
    fn n_target(&self) -> usize {
        Setpoint::<f64>::DIM + AttitudeCommand::<f64>::DIM
    }
    fn write_target(&self, target: Target<'_>, time: f64, row: &mut [f64]) {
        target.sample(time).write(&mut row[..Setpoint::<f64>::DIM]);
        target.orientation(time).with_thrust(0.0).write(&mut row[Setpoint::<f64>::DIM..]);
    }
    fn parameters(&self) -> Vec<f64> {
        self.nominal.clone()
    }
    fn parameter_names(&self) -> Vec<String> {
        let more = ["null_space", "horizon"].map(String::from);
        GainSet::<f64>::names("").into_iter().chain(more).map(|name| format!("ln {name}")).collect()
    }
    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, _memory: &mut [S], commands: &mut [S]) {
        let nominal = self.nominal.iter().map(|k| S::constant(*k)).collect();
        let theta: Vec<S> = if now.parameters.is_empty() { nominal } else { now.parameters.to_vec() };
        let allocated = self.allocate(now.state, now.target, &theta);
        let per_radian = S::constant(self.share) * theta[N_PARAMETER - 1].exp();
        for (j, arm) in self.arms.iter().enumerate() {
            for at in arm.actions {
                commands[at] = allocated[j].mul_add(S::constant(2.0 / self.max_thrust), -S::one());
            }
            commands[arm.drive] = allocated[N_ARM + j] * (per_radian * S::constant(arm.range)).recip();
        }
    }
}

impl Arm {
    /// The hinge in the core.
    fn in_core(&self, plant: &Multibody) -> Vec3<f64> {
        mat_vec(plant.model().bodies()[self.body].joint.rotation, self.axis)
    }

    /// What the pair pushes with now, N.
    fn thrust<S: Scalar>(&self, state: &[S]) -> S {
        let own = |k: usize| S::constant(self.rotors[k].thrust_coefficient) * state[self.speeds[k]].square();
        own(0) + own(1)
    }
}

/// The pair on a body.
fn arm(plant: &Multibody, body: usize) -> Result<Arm> {
    let (model, layout) = (plant.model(), plant.layout());
    let mounted: Vec<usize> = (0..model.rotors().len()).filter(|r| model.rotors()[*r].body == body).collect();
    let joint = &model.bodies()[body].joint;
    let refuse = || {
        let what = format!("unit '{}'", model.bodies()[body].name);
        Error::value(what, mounted.len(), "two rotors on a servo-driven hinge", "Build it with Omav::default().")
    };
    let (Motion::Revolute(axis), Some(drive), Some(at), [a, b]) =
        (joint.motion, joint.drive, layout.drive[body], &mounted[..])
    else {
        return Err(refuse());
    };
    Ok(Arm {
        body,
        axis,
        rotors: [*a, *b].map(|r| model.rotors()[r].rotor.clone()),
        speeds: [*a, *b].map(|r| layout.rotor_speed[r]),
        rate: layout.bodies[body].velocity,
        actions: [*a, *b].map(|r| layout.rotor_action[r]),
        drive: at,
        range: drive.range,
    })
}

/// The cost of the [module](self).
#[derive(Debug, Clone)]
pub struct PoseError {
    per_step: f64,
    /// Places of rotor speeds and tilt rates in the state, with what each is divided by.
    speeds: Vec<(usize, f64)>,
    rates: Vec<(usize, f64)>,
}

impl PoseError {
    /// Over a flight of so many steps.
    pub fn over(system: &Tilting, steps: usize) -> Self {
        let speeds = |a: &Arm| [0, 1].map(|k| (a.speeds[k], a.rotors[k].max_speed));
        Self {
            per_step: 1.0 / steps as f64,
            speeds: system.law().arms.iter().flat_map(speeds).collect(),
            rates: system.law().arms.iter().map(|a| (a.rate, a.range)).collect(),
        }
    }
}

/// p − p_d (world, m) and e_R (body).
fn errors<S: Scalar>(state: &[S], input: &[S]) -> [Vec3<S>; 2] {
    let seen = Kinematics::read(state);
    let wanted = AttitudeCommand::read(&input[Setpoint::<S>::DIM..]).attitude;
    [sub(seen.position, [input[0], input[1], input[2]]), attitude_error(wanted, matrix(seen.attitude))]
}

impl Objective for PoseError {
    fn stage<S: Scalar>(&self, state: &[S], input: &[S], _: &[S]) -> S {
        let [position, attitude] = errors(state, input);
        let mut effort = S::zero();
        for (at, most) in &self.speeds {
            effort += (state[*at] * S::constant(1.0 / most)).square().square()
                * S::constant(EFFORT / self.speeds.len() as f64);
        }
        for (at, most) in &self.rates {
            effort += (state[*at] * S::constant(1.0 / most)).square() * S::constant(EFFORT / self.rates.len() as f64);
        }
        let pose = dot(position, position) + S::constant(LEVER * LEVER) * dot(attitude, attitude);
        S::constant(self.per_step) * (pose + effort)
    }
}

/// The lemniscate, swaying: R_d = Rz(ψ) Ry(0.3 sin ωt/2) Rx(0.5 sin ωt), ω = 2 rad/s.
struct Swaying;

impl Curve for Swaying {
    fn position<S: Scalar>(&self, t: S) -> [S; 3] {
        Lemniscate::default().position(t)
    }
    fn angles<S: Scalar>(&self, t: S) -> [S; 2] {
        let sine = |size: f64, rate: f64| (t * S::constant(rate)).sin_cos().0 * S::constant(size);
        [sine(0.5, 2.0), sine(0.3, 1.0)]
    }
}

/// What to tune on, and for how long.
#[derive(Debug, Clone, PartialEq)]
pub struct TiltingPlan {
    /// Of the pose.
    pub reference: Reference,
    /// Length of a flight, s.
    pub duration: f64,
    /// Training starts.
    pub n_start: usize,
    /// Held-out starts, drawn from other streams.
    pub n_held_out: usize,
    /// Largest offset of a start: position (m) and velocity (m/s) per axis, rotation vector (rad) per axis.
    pub spread: [f64; 3],
    /// Descent steps.
    pub iterations: usize,
    /// Relative change of a parameter per step, at first; it falls to a tenth by the end.
    pub learning_rate: f64,
    /// Of the starts.
    pub seed: u64,
}

impl Default for TiltingPlan {
    /// Three seconds of the lemniscate, rolling ±0.5 rad and pitching ±0.3 rad, from 8 starts within 0.2 m, 0.2 m/s and
    /// 0.2 rad, 40 descent steps, judged on 32.
    fn default() -> Self {
        Self {
            reference: Reference::own(Swaying),
            duration: 3.0,
            n_start: 8,
            n_held_out: 32,
            spread: [0.2; 3],
            iterations: 40,
            learning_rate: 0.1,
            seed: 0,
        }
    }
}

impl TiltingPlan {
    fn n_step(&self, dt: f64) -> Result<usize> {
        self.reference.validate()?;
        for (what, n, most) in [
            ("n_start", self.n_start, MAX_STARTS),
            ("n_held_out", self.n_held_out, MAX_STARTS),
            ("iterations", self.iterations, 100_000),
            ("steps", (self.duration / dt).round() as usize, 100_000),
        ] {
            if n < 1 || n > most {
                return Err(Error::limit(what, n, format!("1 to {most}"), "The defaults are a good start."));
            }
        }
        Ok((self.duration / dt).round() as usize)
    }

    /// Inputs of the loop, row-major `[T, m]`.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] where the plan is not valid.
    pub fn inputs(&self, system: &Tilting) -> Result<Vec<f64>> {
        let (dt, m) = (system.plant().physics().dt, system.n_input());
        let mut rows = vec![0.0; self.n_step(dt)? * m];
        for (k, row) in rows.chunks_exact_mut(m).enumerate() {
            system.write_input(k as u64, Target::level(&self.reference), &Disturbance::none(), row);
        }
        Ok(rows)
    }

    /// Random starts around the reference's, at level tilts and hovering thrusts.
    fn starts(&self, system: &Tilting, n: usize, set: u64) -> Vec<Vec<f64>> {
        let target = Target::level(&self.reference);
        let (sample, wanted) = (target.sample(0.0), target.orientation(0.0));
        let mut rest = system.law().plant.rest_state();
        for arm in &system.law().arms {
            for (at, rotor) in arm.speeds.iter().zip(&arm.rotors) {
                rest[*at] = (0.5 * system.law().share / rotor.thrust_coefficient).sqrt();
            }
        }
        let start = |i: usize| {
            let mut stream = Stream::new(self.seed, i as u64, set, Purpose::RESET);
            let [p, v, r] = self.spread.map(|s| [0.0; 3].map(|_: f64| s * stream.uniform(-1.0, 1.0)));
            let own = Kinematics {
                position: add(sample.position, p),
                velocity: add(sample.velocity, v),
                attitude: multiply(from_matrix(wanted.attitude), exponential(r)),
                angular_velocity: wanted.angular_velocity,
            };
            let mut state = rest.clone();
            own.write(&mut state);
            state
        };
        (0..n).map(start).collect()
    }

    /// The training starts.
    pub fn training(&self, system: &Tilting) -> Vec<Vec<f64>> {
        self.starts(system, self.n_start, TRAINING)
    }
}

/// Held-out flights with one θ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiltingEvaluation {
    /// Root of the mean cost over the flights that were not lost, m.
    pub root_cost: f64,
    /// Root mean squares over those flights, the start included: position, m.
    pub position: f64,
    /// e_R, which is the sine of the angle.
    pub attitude: f64,
    /// Flights that diverged or left the reference by more than [`CRASH_DISTANCE`].
    pub lost: usize,
    /// Flights.
    pub n: usize,
}

/// The result of tuning.
#[derive(Debug, Clone, PartialEq)]
pub struct TiltingTuning {
    /// The best θ on the training starts.
    pub theta: Vec<f64>,
    /// The descent; `rmse` is the root of the mean cost, m.
    pub history: Vec<Iteration>,
    /// Held-out flights with the θ it started from.
    pub before: TiltingEvaluation,
    /// Held-out flights with the best θ.
    pub after: TiltingEvaluation,
}

impl TiltingTuning {
    /// Gains, ρ and h (s) of θ.
    pub fn readable(theta: &[f64]) -> (Gains, f64, f64) {
        let three = |at: usize| [theta[at].exp(), theta[at + 1].exp(), theta[at + 2].exp()];
        let gains =
            Gains { position: three(0), velocity: three(3), attitude: three(6), rate: three(9), integral: [0.0; 2] };
        (gains, theta[12].exp(), theta[13].exp())
    }
}

/// Tunes from `theta`, for one [`TiltingLaw::nominal`], by Adam on the root of the mean cost over the training starts;
/// `progress` sees each step.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] where θ or the plan is not valid.
pub fn tune_tilting(
    system: &Tilting,
    theta: &[f64],
    plan: &TiltingPlan,
    progress: &mut dyn FnMut(&Iteration),
) -> Result<TiltingTuning> {
    let (inputs, starts) = (plan.inputs(system)?, plan.training(system));
    let objective = PoseError::over(system, inputs.len() / system.n_input());
    let rollout = Rollout::new(system.clone(), objective)?;
    let before = evaluate_tilting(system, theta, plan)?;
    let mut descent = Descent::new(theta.to_vec(), plan.learning_rate, plan.iterations);
    for iteration in 0..plan.iterations {
        let (rmse, gradient) = root_mean_cost(&rollout, &starts, &inputs, &descent.theta);
        let gradient_norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        let step = Iteration { iteration, rmse, gradient_norm };
        progress(&step);
        descent.step(step, &gradient);
    }
    let after = evaluate_tilting(system, &descent.best, plan)?;
    Ok(TiltingTuning { theta: descent.best, history: descent.history, before, after })
}

/// √J̄ over the starts that stayed finite, and its gradient; a lost start costs 10 m over their number.
fn root_mean_cost(
    rollout: &Rollout<Tilting, PoseError>,
    starts: &[Vec<f64>],
    inputs: &[f64],
    theta: &[f64],
) -> (f64, Vec<f64>) {
    let parts = Threads::default().map(starts.len(), |i| {
        let mut gradient =
            Gradient { state: vec![0.0; starts[i].len()], inputs: Vec::new(), parameters: vec![0.0; N_PARAMETER] };
        let cost = rollout.gradient_into(&mut rollout.scratch(), &starts[i], inputs, theta, &mut gradient);
        let known = cost.is_finite() && gradient.parameters.iter().all(|g| g.is_finite());
        known.then_some((cost, gradient.parameters))
    });
    let known: Vec<_> = parts.iter().flatten().collect();
    let n = known.len().max(1) as f64;
    let root = (known.iter().map(|(cost, _)| cost).sum::<f64>() / n).sqrt();
    let each = |k: usize| known.iter().map(|(_, g)| g[k]).sum::<f64>() / (2.0 * n * root.max(1e-9));
    let lost = (parts.len() - known.len()) as f64 / parts.len() as f64;
    (root + 10.0 * lost, (0..N_PARAMETER).map(each).collect())
}

/// Flies the held-out starts of a plan.
///
/// # Errors
/// As [`tune_tilting`].
pub fn evaluate_tilting(system: &Tilting, theta: &[f64], plan: &TiltingPlan) -> Result<TiltingEvaluation> {
    let inputs = plan.inputs(system)?;
    let objective = PoseError::over(system, inputs.len() / system.n_input());
    let starts = plan.starts(system, plan.n_held_out, HELD_OUT);
    let flights = Threads::default().map(starts.len(), |i| fly(system, &objective, starts[i].clone(), &inputs, theta));
    let flown: Vec<_> = flights.iter().flatten().collect();
    let root = |k: usize| (flown.iter().map(|f| f[k]).sum::<f64>() / flown.len().max(1) as f64).sqrt();
    let [root_cost, position, attitude] = [0, 1, 2].map(root);
    Ok(TiltingEvaluation { root_cost, position, attitude, lost: flights.len() - flown.len(), n: flights.len() })
}

/// Cost, mean squared position error and mean squared e_R of one flight; `None` if it was lost.
fn fly(system: &Tilting, objective: &PoseError, mut x: Vec<f64>, inputs: &[f64], theta: &[f64]) -> Option<[f64; 3]> {
    let (mut next, mut sums) = (x.clone(), [0.0; 3]);
    for u in inputs.chunks_exact(system.n_input()) {
        let [p, e] = errors(&x, u).map(|e| dot(e, e));
        if p.is_nan() || p >= CRASH_DISTANCE * CRASH_DISTANCE {
            return None;
        }
        let now = [objective.stage(&x, u, theta), objective.per_step * p, objective.per_step * e];
        sums = add(sums, now);
        system.step(&x, u, theta, &mut next);
        std::mem::swap(&mut x, &mut next);
    }
    sums.iter().all(|s| s.is_finite()).then_some(sums)
}
