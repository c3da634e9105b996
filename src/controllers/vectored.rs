//! Thrusters on tilting hinges: one controller for every system whose rotors all sit on servo-driven tilts.
//!
//! ```text
//! pose ─▶ six-axis law ─▶ wrench ─┬─▶ slow: second-order cone program over force vectors ─▶ tilt rates
//!                                 └─▶ fast: box allocation at the actual tilts            ─▶ rotor thrusts
//! ```
//!
//! **Thrusters.** Rotors on one body push together. One hinge across their axis (Omav) gives the force two components,
//! two hinges (Dragon) give it three; a pair can also push unequally, which twists. All columns are those of the true
//! geometry in the present shape: places, spins σ and reaction κ, about the instantaneous centre of mass.
//!
//! **Slow stage** (at the rate of the velocity level): min ‖Bf − w‖²_W + ρ‖f − f_pref‖² with ‖F‖ ± Δ ≤ T_max (cones), no
//! rotor pulling, and F within the tilts that the servo reaches: ±δ, δ = α̇_max/k, since a servo commanded by k (α* − α) cannot
//! be asked for more. f_pref is the last solution, which
//! returns to each thruster's share of the weight within a second: so ρ damps what the geometry can barely do (a weak
//! direction is learned over some ticks, never amplified) and biases nothing that lasts. An error counts as the
//! acceleration that it causes: W = diag(1, 1, 1, (mℓ/J_i)²), ℓ² = tr J/3m. So the weak axis of a straight chain is
//! weighed by its small inertia and nothing is inverted. Where a force nearly vanishes its direction is kept; where the window
//! leaves a thruster no force at all, it turns towards its share of the weight.
//!
//! **Fast stage** (at the rate of the rate level): thrusts within \[0, T_max\] for the same wrench at the tilts as they are,
//! near those of the slow stage; what thrusts alone can barely do (yaw of level rotors by κ) waits for the tilts.
//!
//! **Wrench.** The force is the law's, with drag of bodies and rotors at the reference's velocity fed forward. The moment
//! passes through the [inverse dynamics](dynamics::tree::inverse_dynamics) of the tree: gyroscopic moments of
//! rotors, drag, moving joints. The recoil of tilts that accelerate is left to feedback.
//!
//! **Bandwidths.** A servo of lag τ under k = 1/(2τ), with an integral of 10/k against loads, is a loop of damping 0.7; its tilts follow
//! like a lag of 1/k. Where
//! thrusters are a large share of the inertia, a tilt turns the carrier the other way (on the straight Dragon four fifths of
//! it), and the rotors must first undo that: k ≤ ω_m/share, ω_m = 1/(4τ) of the motors. Pose loops are placed (ζ = 1, K_R = J ω² at
//! the inertia of the present shape) at ω = k/4, as `gains` places them at a quarter of the motors'
//! 1/τ, and no faster than α̇_max/`SWING`, so that ordinary errors do not saturate the servos; position at half of it. Axes about
//! which thrusts at the present tilts have authority of their own need not wait for tilts: they go up to ω_m.
//!
//! Sources: Kamel et al. 2018 (arXiv 1801.04581) and Bodie et al. 2020 (arXiv 2003.09512) for force components of tilting
//! rotors; the reachable window as half-planes is ours.

use super::allocation::articulated::{
    at, attitude, composite_inertia, composite_inertia_at, put, resistance_at, wrench_matrix, wrench_matrix_into,
};
use super::allocation::problem::{Affine, Cone, Problem, WRENCH};
use super::allocation::{Allocator, Solver};
use super::attitude::rate_command;
use super::cascade::{RateDivisors, Rates};
use super::chain_shape::ChainRamp;
use super::controller::{Controller, Measurement, Note, Target};
use super::kinematics::Kinematics;
use super::parameters::{BodyModel, CommandLimits, ForceLimits, GainSet, validate_gains};
use super::position::velocity_command;
use super::rate::RateCommand;
use super::six_axis::{SixAxis, Wrench};
use base::error::{Error, Result};
use dynamics::gains::SATURATION_ANGLE;
use dynamics::rotor::{holding_action, thrust_action};
use dynamics::spatial::{Vec3, axpy, cross, dot, inverse, mat_vec, rotate_back, scale, sub};
use dynamics::tree::{
    FrameKinematics, Model, Motion, Multibody, body_poses, body_poses_into, center_of_mass, inverse_dynamics,
    mass_matrix, momentum, rest_state,
};
use dynamics::{GRAVITY, Gains};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::{PI, TAU};

/// Largest tilt error that pose loops may ask servos to follow, rad: ω ≤ α̇_max/SWING.
pub(crate) const SWING: f64 = 0.5;
/// Pose bandwidth over attitude bandwidth and tilt rate over pose bandwidth, see the [module](self).
const SEPARATION: [f64; 2] = [2.0, 4.0];
/// Time in which a tilt learns its load, times k: slow enough to cost its loop 6° of phase.
const PATIENCE: f64 = 10.0;
/// ρ of both stages: what a newton away from its preference costs, against a newton of force that is missing.
const NULL_SPACE: f64 = 0.1;
/// How fast preferred forces leave the last solution for each thruster's share of the weight, 1/s.
const RETURN: f64 = 1.0;
/// Share of a thruster's largest force below which its direction is not trusted.
const FAINT: f64 = 0.02;

/// One servo-driven hinge.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Hinge {
    /// Places in the state.
    angle: usize,
    rate: usize,
    /// Of its velocity vector.
    freedom: usize,
    /// Place in the input.
    drive: usize,
    /// α̇_max, rad/s.
    range: f64,
    /// Closed-loop lag of its rate at rest, at least two periods of the slow stage, s.
    lag: f64,
    /// k, 1/s.
    gain: f64,
}

/// Rotors that push together, on one hinge or two.
#[derive(Debug, Clone, PartialEq)]
struct Thruster {
    body: usize,
    rotors: Vec<usize>,
    /// What the first hinge hangs on.
    carrier: usize,
    /// From the carrier outwards.
    hinges: Vec<Hinge>,
    /// Directions of the force components in the carrier's axes, the thrust at zero angles last. One hinge: tangent,
    /// thrust. Two: first axis, second axis, thrust.
    frame: Vec<Vec3<f64>>,
    /// With two hinges: sign of (second axis × thrust) along the first axis.
    hand: f64,
    /// Mean place of its rotors and direction of thrust, in the body.
    hub: Vec3<f64>,
    axis: Vec3<f64>,
    /// Reaction torque along −axis per newton of equal thrusts, m.
    reaction: f64,
    /// Moment per newton by which a pair pushes unequally, in the body, m.
    twist: Option<Vec3<f64>>,
    /// Of all its rotors, N.
    max_thrust: f64,
}

impl Thruster {
    /// Components of its force.
    fn n_force(&self) -> usize {
        self.frame.len()
    }

    fn n_input(&self) -> usize {
        self.n_force() + usize::from(self.twist.is_some())
    }

    /// Components of the direction of thrust at given angles.
    fn direction(&self, angles: &[f64]) -> Vec<f64> {
        let (s, c) = angles[0].sin_cos();
        if self.hinges.len() == 1 {
            return vec![s, c];
        }
        let (s2, c2) = angles[1].sin_cos();
        vec![self.hand * s2, -self.hand * s * c2, c * c2]
    }

    /// Angles nearest to `now` at which it pushes along `force`; a faint part of a force that has no direction is that of now.
    fn angles(&self, force: &[f64], now: &[f64]) -> Vec<f64> {
        if self.hinges.len() == 1 {
            return vec![nearest(force[0].atan2(force[1]), now[0])];
        }
        let across = force[1].hypot(force[2]);
        let faint = FAINT * force[0].hypot(across);
        let (s, c) = now[0].sin_cos();
        let side = now[1].cos().signum();
        let first = (-self.hand * force[1] + faint * side * s).atan2(force[2] + faint * side * c);
        let second = (self.hand * force[0]).atan2(across);
        let options =
            [[first, second], [first + PI, PI - second]].map(|[a, b]| [nearest(a, now[0]), nearest(b, now[1])]);
        let way = |q: &[f64; 2]| (q[0] - now[0]).abs().max((q[1] - now[1]).abs());
        let [a, b] = options;
        if way(&b) < way(&a) { b.to_vec() } else { a.to_vec() }
    }
}

/// The angle equal to `angle` but for whole turns that is nearest to `to`.
fn nearest(angle: f64, to: f64) -> f64 {
    angle + TAU * ((to - angle) / TAU).round()
}

/// What is tracked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TrackedPoint {
    /// The centre of mass of all bodies.
    #[default]
    Center,
    /// The origin of the root.
    Root,
}

/// The controller.
pub struct Vectored {
    system: Multibody,
    thrusters: Vec<Thruster>,
    /// Of the shape: targets of position servos.
    chain: ChainRamp,
    point: TrackedPoint,
    law: SixAxis<f64>,
    /// Whether gains follow the inertia of the present shape.
    placed: Option<[f64; 2]>,
    built_for: (Option<Gains>, Rates),
    schedule: RateDivisors,
    /// Of the slow stage, s.
    period: f64,
    slow: Allocator,
    fast: Allocator,
    held: HeldCommands,
    /// Largest accepted residuals, slow and fast.
    residual: [f64; 2],
    /// Share of its largest thrust that each rotor is known to have.
    health: Vec<f64>,
    scratch: Scratch,
}

/// Memory of a tick.
#[derive(Default)]
struct Scratch {
    poses: Vec<FrameKinematics<f64>>,
    /// Of all rotors in the present shape.
    matrix: DMatrix<f64>,
    /// Accelerations of joints and the forces that they miss; inputs that hold the rotors' speeds.
    wanted: Vec<f64>,
    missing: Vec<f64>,
    still: Vec<f64>,
    /// Of all rotors, N, and the moment that they make, N m.
    thrusts: DVector<f64>,
    turning: DVector<f64>,
}

impl Scratch {
    fn of(system: &Multibody) -> Self {
        let (n, n_rotor) = (system.layout().n_velocity(), system.model().rotors().len());
        Self {
            poses: Vec::new(),
            matrix: DMatrix::zeros(WRENCH, n_rotor),
            wanted: vec![0.0; n],
            missing: vec![0.0; n],
            still: system.rest_input(),
            thrusts: DVector::zeros(n_rotor),
            turning: DVector::zeros(3),
        }
    }
}

/// What each level said last.
#[derive(Debug, Clone)]
struct HeldCommands {
    step: u64,
    /// World, N.
    force: Vec3<f64>,
    /// Last solution of the slow stage.
    inputs: Vec<f64>,
    rate: RateCommand<f64>,
    /// Wanted angles, thruster by thruster.
    angles: Vec<Vec<f64>>,
    /// Rates that hold against loads, likewise, rad/s.
    loads: Vec<Vec<f64>>,
    /// Of every rotor, N.
    preference: Vec<f64>,
}

impl Vectored {
    /// For a model whose rotors all sit on tilts. Without `gains`, poles are placed as the [module](self) says.
    ///
    /// # Errors
    /// [`Error::Value`] naming the rotor that is not on one or two rate servos across its axis, gains that are not valid, or
    /// rates that do not divide 1/dt.
    pub fn new(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        let (model, rest) = (system.model(), system.rest_state());
        let mut thrusters = thrusters(model)?;
        let schedule = RateDivisors::new(rates, system.physics().dt)?;
        if let Some(gains) = gains {
            validate_gains(gains)?;
        }
        let shares = recoil(system, &thrusters)?;
        let period = schedule.every[0] as f64 * system.physics().dt;
        let motors = motor_bandwidth(model);
        for (hinge, share) in thrusters.iter_mut().flat_map(|t| &mut t.hinges).zip(shares) {
            hinge.lag = hinge.lag.max(2.0 * period);
            hinge.gain = (0.5 / hinge.lag).min(motors / share);
        }
        let bandwidths = bandwidths(model, &thrusters);
        let lift: f64 = model.rotors().iter().map(|r| r.rotor.max_thrust()).sum();
        let mass = model.mass();
        let body = BodyModel {
            mass,
            inertia: composite_inertia(system, &rest),
            drag: [0.0; 3],
            drag_moment: [[0.0; 3]; 3],
            gravity: model.parts().gravity,
        };
        let given = gains.copied().unwrap_or_else(|| placed_gains([bandwidths[0]; 3], bandwidths[1], &body));
        let limits = ForceLimits::constant(&CommandLimits::default(), lift, mass * body.gravity);
        let law = SixAxis { body, gains: GainSet::constant(&given), limits };
        let share = mass * body.gravity.min(GRAVITY) / lift;
        let preference: Vec<f64> = model.rotors().iter().map(|r| share * r.rotor.max_thrust()).collect();
        let scene = Scene::of(system, &rest);
        let slow = slow_problem(&thrusters, &body, &scene, &rest);
        let held = HeldCommands {
            step: 0,
            inputs: slow.preference.clone(),
            force: [0.0, 0.0, mass * body.gravity],
            rate: RateCommand::constant(0.0, [0.0; 3]),
            loads: thrusters.iter().map(|t| vec![0.0; t.hinges.len()]).collect(),
            angles: thrusters.iter().map(|t| t.hinges.iter().map(|h| rest[h.angle]).collect()).collect(),
            preference,
        };
        let fast = fast_problem(system, &law.body, wrench_matrix(system, &rest), &held.preference)?;
        Ok(Self {
            system: system.clone(),
            built_for: (gains.copied(), *rates),
            chain: ChainRamp::rest(model),
            point: TrackedPoint::Center,
            placed: gains.is_none().then_some(bandwidths),
            slow: Allocator::new(slow)?,
            fast: Allocator::new(fast)?,
            residual: [0.0; 2],
            health: vec![1.0; model.rotors().len()],
            scratch: Scratch::of(system),
            period,
            thrusters,
            law,
            schedule,
            held,
        })
    }

    /// Bends the system while it flies.
    #[must_use]
    pub fn with_chain(mut self, chain: ChainRamp) -> Self {
        self.chain = chain;
        self
    }

    /// Tracks another point than the centre of mass.
    #[must_use]
    pub fn tracking(mut self, point: TrackedPoint) -> Self {
        self.point = point;
        self
    }

    /// Attitude and position bandwidth, rad/s, if they are placed.
    pub fn bandwidths(&self) -> Option<[f64; 2]> {
        self.placed
    }

    /// The slow stage's and the fast stage's allocators, for their counts.
    pub fn stages(&self) -> [&Allocator; 2] {
        [&self.slow, &self.fast]
    }

    /// Largest certified residual of each stage so far.
    pub fn residuals(&self) -> [f64; 2] {
        self.residual
    }

    /// The wrench for now: the law's force, and its moment through the inverse dynamics of the tree.
    fn wrench(&self, own: &Kinematics<f64>, state: &[f64], scratch: &mut Scratch) -> Wrench<f64> {
        let force = rotate_back(own.attitude, self.held.force);
        let wanted = self.law.rate(own, force, &self.held.rate);
        let (j, w) = (self.law.body.inertia, own.angular_velocity);
        let moment = sub([wanted[3], wanted[4], wanted[5]], cross(w, mat_vec(j, w)));
        let m = self.needed_moment(state, mat_vec(inverse(j), moment), scratch);
        [force[0], force[1], force[2], m[0], m[1], m[2]]
    }

    /// Moment of the rotors about the centre of mass, body axes, that turns the root with `acceleration` (rad/s²) while
    /// rotors and joints keep their speeds.
    fn needed_moment(&self, state: &[f64], acceleration: Vec3<f64>, scratch: &mut Scratch) -> Vec3<f64> {
        let (model, layout) = (self.system.model(), self.system.layout());
        let Scratch { matrix, wanted, missing, still, thrusts, turning, .. } = scratch;
        wanted[3..6].copy_from_slice(&acceleration);
        for (r, mounted) in model.rotors().iter().enumerate() {
            let (speed, rotor) = (state[layout.rotor_speed[r]], &mounted.rotor);
            still[layout.rotor_action[r]] = holding_action(rotor.max_speed, speed);
            thrusts[r] = rotor.thrust_coefficient * speed * speed;
        }
        inverse_dynamics(&self.system, state, still, wanted, missing);
        let root = layout.bodies[0].position;
        let lever = sub(center_of_mass(&self.system, state), [state[root], state[root + 1], state[root + 2]]);
        let attitude = attitude(&self.system, state);
        let force = rotate_back(attitude, [missing[0], missing[1], missing[2]]);
        let about = cross(rotate_back(attitude, lever), force);
        matrix.rows(3, 3).mul_to(thrusts, turning);
        // what thrusts do now was taken off
        [0, 1, 2].map(|k| missing[3 + k] - about[k] + turning[k])
    }

    /// Force vectors for a wrench: wanted tilts and thrusts.
    fn solve_slow(&mut self, state: &[f64], wrench: &Wrench<f64>) {
        let scene = Scene::of(&self.system, state);
        let mut problem = slow_problem(&self.thrusters, &self.law.body, &scene, state);
        let shares = problem.preference.clone();
        let leave = (RETURN * self.period).min(1.0);
        for (wish, last) in problem.preference.iter_mut().zip(&self.held.inputs) {
            *wish = last + leave * (*wish - last);
        }
        if self.slow.update(|p| *p = problem).is_err() {
            return;
        }
        let solution = self.slow.solve(wrench);
        if solution.solver == Solver::Held {
            return;
        }
        self.residual[0] = self.residual[0].max(solution.residual);
        self.held.inputs.clone_from(&solution.inputs);
        let mut first = 0;
        for (n, thruster) in self.thrusters.iter().enumerate() {
            let (force, rest) = self.held.inputs[first..first + thruster.n_input()].split_at(thruster.n_force());
            let now: Vec<f64> = thruster.hinges.iter().map(|h| state[h.angle]).collect();
            let size = norm(force);
            let share = &shares[first..first + thruster.n_force()];
            let lean = if size < FAINT * thruster.max_thrust { share } else { force };
            let kept = thruster.direction(&now);
            let aim: Vec<f64> = lean.iter().zip(&kept).map(|(f, d)| f + FAINT * thruster.max_thrust * d).collect();
            self.held.angles[n] = thruster.angles(&aim, &now);
            let twist = rest.first().copied().unwrap_or(0.0);
            for (k, r) in thruster.rotors.iter().enumerate() {
                let sign = if k == 0 { 1.0 } else { -1.0 };
                self.held.preference[*r] = (size + sign * twist) / thruster.rotors.len() as f64;
            }
            first += thruster.n_input();
        }
    }

    /// Thrusts for a wrench at the tilts as they are.
    fn solve_fast(&mut self, matrix: &DMatrix<f64>, wrench: &Wrench<f64>) {
        let (weights, preference) = (weights(&self.law.body), &self.held.preference);
        if self.fast.set_task(matrix.as_slice(), weights, preference).is_ok() {
            let solution = self.fast.solve(wrench);
            if solution.solver != Solver::Held {
                self.residual[1] = self.residual[1].max(solution.residual);
            }
        }
    }

    /// Rates that send tilts where they are wanted, rad/s: k (α* − α) and what its integral has learned about the load
    /// that drives the servo back, within the servo's range.
    fn turn(&mut self, state: &[f64], input: &mut [f64]) {
        let dt = self.system.physics().dt;
        for (n, thruster) in self.thrusters.iter().enumerate() {
            for (k, hinge) in thruster.hinges.iter().enumerate() {
                let error = self.held.angles[n][k] - state[hinge.angle];
                let load = &mut self.held.loads[n][k];
                let rate = (hinge.gain * error + *load).clamp(-hinge.range, hinge.range);
                if rate.abs() < hinge.range {
                    *load += hinge.gain * error * (hinge.gain / PATIENCE) * dt;
                }
                input[hinge.drive] = rate / hinge.range;
            }
        }
    }
}

impl Controller for Vectored {
    fn name(&self) -> &str {
        "vectored"
    }

    fn why_no_law(&self) -> &'static str {
        "a controller with a second-order cone program inside"
    }

    fn description(&self) -> String {
        let two = self.thrusters.iter().filter(|t| t.hinges.len() == 2).count();
        let axes = if two == 0 { "one axis" } else { "two axes" };
        format!(
            "six axes; {} thrusters that tilt about {axes}, then all rotors at the actual tilts",
            self.thrusters.len()
        )
    }

    fn schedule(&self) -> Option<RateDivisors> {
        Some(self.schedule)
    }

    fn reset(&mut self) {
        let (gains, rates) = self.built_for;
        if let Ok(fresh) = Self::new(&self.system, gains.as_ref(), &rates) {
            let own = std::mem::replace(self, fresh);
            (self.chain, self.point) = (own.chain, own.point);
        }
    }

    /// Both stages allocate within what is left; a thruster with a rotor lost is asked for next to nothing.
    fn tell(&mut self, effectiveness: &[f64]) -> Result<()> {
        let rotors = self.system.model().rotors();
        let left = |r: usize| effectiveness[r] * rotors[r].rotor.max_thrust();
        for thruster in &mut self.thrusters {
            let least =
                |of: &dyn Fn(usize) -> f64| thruster.rotors.iter().map(|r| of(*r)).fold(f64::INFINITY, f64::min);
            let whole = least(&|r| rotors[r].rotor.max_thrust());
            thruster.max_thrust = thruster.rotors.len() as f64 * least(&left).max(FAINT * whole);
        }
        self.fast.update(|p| p.upper = (0..rotors.len()).map(left).collect())?;
        self.health = effectiveness.to_vec();
        Ok(())
    }

    fn holds_tilt(&self) -> bool {
        true
    }

    fn notes(&self) -> Vec<Note> {
        let mut notes = Vec::new();
        if let Some([attitude, position]) = self.placed {
            let tilts = self.thrusters.iter().flat_map(|t| &t.hinges).map(|h| h.gain).fold(f64::INFINITY, f64::min);
            let note = format!("attitude; position {position:.2}, tilts follow at {tilts:.1} rad/s");
            notes.push(Note::new("bandwidth", format!("{attitude:.3} rad/s"), note));
        }
        for ((stage, name), worst) in self.stages().into_iter().zip(["tilt", "thrust"]).zip(self.residual) {
            let counts = stage.counts();
            let ways =
                Solver::ALL.iter().filter(|p| counts.of(**p) > 0).map(|p| format!("{} {}", counts.of(*p), p.name()));
            let ways: Vec<String> = ways.collect();
            let note = format!("largest residual accepted; {}", ways.join(", "));
            notes.push(Note::new(format!("{name} allocation"), format!("{worst:.1e}"), note));
        }
        notes
    }

    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        let own = super::formation::root(&self.system, state);
        match self.point {
            TrackedPoint::Root => own,
            TrackedPoint::Center => {
                let velocity = scale(1.0 / self.law.body.mass, momentum(&self.system, state).linear);
                Kinematics { position: center_of_mass(&self.system, state), velocity, ..own }
            }
        }
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, input: &mut [f64]) {
        let Measurement { time, state, .. } = seen;
        let own = self.tracked(state);
        let [velocity, attitude, rate] = self.schedule.ticks(self.held.step).map(|tick| tick > 0.5);
        self.held.step += 1;
        let mut scratch = std::mem::take(&mut self.scratch);
        if velocity || rate {
            body_poses_into(&self.system, state, &mut scratch.poses);
            wrench_matrix_into(&self.system, state, &scratch.poses, &mut scratch.matrix);
        }
        if velocity {
            self.law.body.inertia = composite_inertia_at(&self.system, state, &scratch.poses);
            if let Some([tilts, position]) = self.placed {
                let axes = axis_bandwidths(self.system.model(), &scratch.matrix, &self.law.body, tilts);
                self.law.gains = GainSet::constant(&placed_gains(axes, position, &self.law.body));
            }
            let wanted = target.sample(time);
            let mut command = velocity_command(&self.law.gains, &wanted, &own);
            let drag = mat_vec(resistance_at(&self.system, state, &scratch.poses), wanted.velocity);
            command.acceleration = axpy(command.acceleration, 1.0 / self.law.body.mass, drag);
            self.held.force = self.law.force(&own, &command);
        }
        if attitude {
            let wanted = target.orientation(time).with_thrust(0.0);
            self.held.rate = rate_command(&self.law.gains, &wanted, own.attitude, own.angular_velocity);
        }
        if velocity || rate {
            let wrench = self.wrench(&own, state, &mut scratch);
            if velocity {
                self.solve_slow(state, &wrench);
            }
            if rate {
                self.solve_fast(&scratch.matrix, &wrench);
            }
        }
        self.scratch = scratch;
        self.turn(state, input);
        for (r, thrust) in self.fast.solution().inputs.iter().enumerate() {
            let most = self.health[r] * self.system.model().rotors()[r].rotor.max_thrust();
            input[self.system.layout().rotor_action[r]] = if most > 0.0 { thrust_action(thrust / most) } else { -1.0 };
        }
        self.chain.command(time, input);
    }
}

/// Where everything is, for the columns of force vectors.
struct Scene {
    poses: Vec<FrameKinematics<f64>>,
    center: Vec3<f64>,
    root: [f64; 4],
}

impl Scene {
    fn of(system: &Multibody, state: &[f64]) -> Self {
        Self { poses: body_poses(system, state), center: center_of_mass(system, state), root: attitude(system, state) }
    }
}

/// Attitude and position bandwidth, rad/s.
fn bandwidths(model: &Model, thrusters: &[Thruster]) -> [f64; 2] {
    let hinges = thrusters.iter().flat_map(|t| &t.hinges);
    let tilts = hinges.map(|h| (h.gain / SEPARATION[1]).min(h.range / SWING)).fold(f64::INFINITY, f64::min);
    let attitude = motor_bandwidth(model).min(tilts);
    [attitude, attitude / SEPARATION[0]]
}

/// A quarter of the slowest motor's 1/τ, rad/s.
fn motor_bandwidth(model: &Model) -> f64 {
    let slowest = |m: f64, r: &dynamics::Rotor| m.max(r.time_constant_up).max(r.time_constant_down);
    0.25 / model.rotors().iter().map(|r| &r.rotor).fold(f64::MIN_POSITIVE, slowest)
}

/// How much of a turn of each hinge the rest of the system makes the other way: inertia of all that turns about hinges like
/// it, over that of the whole about the same axis at rest.
fn recoil(system: &Multibody, thrusters: &[Thruster]) -> Result<Vec<f64>> {
    let (rest, model) = (system.rest_state(), system.model());
    let (poses, root, whole) = (body_poses(system, &rest), attitude(system, &rest), composite_inertia(system, &rest));
    let matrix = mass_matrix(model, &rest)?;
    let n = thrusters.len() as f64;
    let of = |(thruster, hinge): (&Thruster, usize)| {
        let own = thruster.hinges[hinge];
        // with one hinge the axis is tangent × thrust turned back: thrust × tangent
        let axis = match thruster.hinges.len() {
            1 => cross(thruster.frame[1], thruster.frame[0]),
            _ => thruster.frame[hinge],
        };
        let a = rotate_back(root, mat_vec(poses[thruster.carrier].rotation, axis));
        (n * matrix[(own.freedom, own.freedom)] / dot(a, mat_vec(whole, a))).min(1.0)
    };
    Ok(thrusters.iter().flat_map(|t| (0..t.hinges.len()).map(move |h| (t, h))).map(of).collect())
}

/// Bandwidth about each axis of the body: what the motors carry where thrusts at the present tilts have the authority (an
/// error of a radian asks for no more moment than they can add to an even share of the weight), else what the tilts carry.
fn axis_bandwidths(model: &Model, matrix: &DMatrix<f64>, body: &BodyModel<f64>, tilts: f64) -> Vec3<f64> {
    let lift: f64 = model.rotors().iter().map(|r| r.rotor.max_thrust()).sum();
    let share = body.mass * body.gravity / lift;
    [0, 1, 2].map(|axis| {
        let margin = |(j, r): (usize, &dynamics::tree::MountedRotor)| {
            matrix[(3 + axis, j)].abs() * r.rotor.max_thrust() * share.min(1.0 - share).max(0.05)
        };
        let authority: f64 = model.rotors().iter().enumerate().map(margin).sum();
        (authority / (body.inertia[axis][axis] * SATURATION_ANGLE)).sqrt().min(motor_bandwidth(model)).max(tilts)
    })
}

/// K_p = ω_p², K_v = 2 ω_p, K_R = J ω², K_ω = 2 J ω.
fn placed_gains(attitude: Vec3<f64>, position: f64, body: &BodyModel<f64>) -> Gains {
    let j = [0, 1, 2].map(|i| body.inertia[i][i]);
    Gains {
        position: [position * position; 3],
        velocity: [2.0 * position; 3],
        attitude: [0, 1, 2].map(|i| j[i] * attitude[i] * attitude[i]),
        rate: [0, 1, 2].map(|i| 2.0 * j[i] * attitude[i]),
        integral: [0.0; 2],
    }
}

/// Gains at the bandwidths that a system is flown with where none are given.
///
/// # Errors
/// As [`Vectored::new`].
pub fn placed(system: &Multibody, rates: &Rates, body: &BodyModel<f64>) -> Result<Gains> {
    let own = Vectored::new(system, None, rates)?;
    let [attitude, position] = own.bandwidths().unwrap_or([1.0, 0.5]);
    Ok(placed_gains([attitude; 3], position, body))
}

/// W = diag(1, 1, 1, (mℓ/J_i)²), ℓ² = tr J/3m.
pub fn weights(body: &BodyModel<f64>) -> [f64; WRENCH] {
    let j = [0, 1, 2].map(|i| body.inertia[i][i]);
    let length = ((j[0] + j[1] + j[2]) / (3.0 * body.mass)).sqrt();
    let [x, y, z] = j.map(|j| (body.mass * length / j).powi(2));
    [1.0, 1.0, 1.0, x, y, z]
}

fn fast_problem(
    system: &Multibody,
    body: &BodyModel<f64>,
    matrix: DMatrix<f64>,
    preference: &[f64],
) -> Result<Problem> {
    let upper = system.model().rotors().iter().map(|r| r.rotor.max_thrust()).collect();
    let problem = Problem::boxed(matrix, weights(body), upper)?;
    Ok(Problem { regularisation: NULL_SPACE, preference: preference.to_vec(), ..problem })
}

/// The program of the slow stage for the present shape.
fn slow_problem(thrusters: &[Thruster], body: &BodyModel<f64>, scene: &Scene, state: &[f64]) -> Problem {
    let n: usize = thrusters.iter().map(Thruster::n_input).sum();
    let mut problem = Problem {
        geometry: DMatrix::zeros(WRENCH, n),
        weights: weights(body),
        regularisation: NULL_SPACE,
        preference: vec![0.0; n],
        lower: vec![f64::NEG_INFINITY; n],
        upper: vec![f64::INFINITY; n],
        cones: Vec::new(),
        anchor: vec![0.0; n],
    };
    let lift: f64 = thrusters.iter().map(|t| t.max_thrust).sum();
    let mut first = 0;
    for thruster in thrusters {
        let share = body.mass * body.gravity * thruster.max_thrust / lift;
        columns(thruster, scene, first, share, &mut problem);
        let angles: Vec<f64> = thruster.hinges.iter().map(|h| state[h.angle]).collect();
        let now = thruster.direction(&angles);
        for (k, d) in now.iter().enumerate() {
            problem.anchor[first + k] = 0.5 * thruster.max_thrust * d;
        }
        cones(thruster, first, &angles, &now, &mut problem.cones);
        first += thruster.n_input();
    }
    problem
}

/// What a thruster's force components and its twist do, and its share of the weight.
fn columns(thruster: &Thruster, scene: &Scene, first: usize, share: f64, problem: &mut Problem) {
    let (carrier, pose) = (&scene.poses[thruster.carrier], &scene.poses[thruster.body]);
    let lever = sub(at(pose, thruster.hub), scene.center);
    for (k, direction) in thruster.frame.iter().enumerate() {
        let e = mat_vec(carrier.rotation, *direction);
        let moment = axpy(cross(lever, e), -thruster.reaction, e);
        put(&mut problem.geometry, first + k, rotate_back(scene.root, e), rotate_back(scene.root, moment));
        problem.preference[first + k] = share * e[2];
    }
    if let Some(twist) = thruster.twist {
        let moment = rotate_back(scene.root, mat_vec(pose.rotation, twist));
        put(&mut problem.geometry, first + thruster.n_force(), [0.0; 3], moment);
    }
}

/// Most thrust, no pull, reachable tilts.
fn cones(thruster: &Thruster, first: usize, angles: &[f64], now: &[f64], cones: &mut Vec<Cone>) {
    let n = thruster.n_force();
    let along = |v: &[f64], more: Option<f64>| {
        let own = v.iter().enumerate().map(|(k, a)| (first + k, *a));
        Affine::linear(own.chain(more.map(|a| (first + n, a))))
    };
    let signs: &[f64] = if thruster.twist.is_some() { &[-1.0, 1.0] } else { &[] };
    for sign in signs {
        let mut most = Cone::ball(first..first + n, thruster.max_thrust);
        most.head.terms.push((first + n, *sign));
        cones.extend([most, Cone { head: along(now, Some(*sign)), tail: Vec::new() }]);
    }
    if thruster.twist.is_none() {
        cones.push(Cone::ball(first..first + n, thruster.max_thrust));
    }
    let reach = thruster.hinges.iter().map(|h| h.range / h.gain).fold(f64::INFINITY, f64::min).min(1.5);
    let (s, c) = reach.sin_cos();
    if n == 2 {
        let side = [now[1], -now[0]];
        for sign in [-1.0, 1.0] {
            let normal = [s * now[0] + sign * c * side[0], s * now[1] + sign * c * side[1]];
            cones.push(Cone { head: along(&normal, None), tail: Vec::new() });
        }
        return;
    }
    // directions in which the two hinges turn the thrust
    let quarter = std::f64::consts::FRAC_PI_2;
    let across = thruster.direction(&[angles[0], angles[1] + quarter]);
    let (a, b) = ([now[0], now[1], now[2]], [across[0], across[1], across[2]]);
    let tail = vec![along(&b, None), along(&cross(a, b), None)];
    cones.push(Cone { head: along(&scale(s / c, a), None), tail });
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Whether every rotor of a model sits on tilts that [`Vectored`] can steer.
pub fn vectored(model: &Model) -> bool {
    !model.rotors().is_empty() && thrusters(model).is_ok()
}

/// Groups the rotors of a model by body and finds their hinges.
fn thrusters(model: &Model) -> Result<Vec<Thruster>> {
    let mut bodies: Vec<usize> = model.rotors().iter().map(|r| r.body).collect();
    bodies.sort_unstable();
    bodies.dedup();
    let lags = lags(model);
    bodies.into_iter().map(|body| thruster(model, body, &lags)).collect()
}

/// Closed-loop lag of every rate servo at rest, I/d with I what the joint feels, s.
fn lags(model: &Model) -> Vec<f64> {
    let matrix = mass_matrix(model, &rest_state(model)).ok().and_then(|m| m.try_inverse());
    let lag = |i: usize| {
        let freedom = model.layout().bodies[i].freedom;
        let damping = model.bodies()[i].joint.drive.map_or(0.0, |d| d.damping);
        matrix.as_ref().map_or(f64::NAN, |m| 1.0 / (m[(freedom, freedom)] * damping))
    };
    (0..model.bodies().len()).map(lag).collect()
}

fn thruster(model: &Model, body: usize, lags: &[f64]) -> Result<Thruster> {
    let rotors: Vec<usize> = (0..model.rotors().len()).filter(|r| model.rotors()[*r].body == body).collect();
    let own = |r: usize| &model.rotors()[r].rotor;
    let refuse = |value: &str, limit: &str| {
        let what = format!("model '{}': rotor '{}'", model.name(), own(rotors[0]).name);
        Err(Error::value(what, value, limit, "Other controllers fly rotors that do not tilt."))
    };
    let axis = own(rotors[0]).axis;
    if rotors.iter().any(|r| dot(own(*r).axis, axis) < 1.0 - 1e-9) {
        return refuse("beside one with another axis", "parallel to those on the same body");
    }
    let (mut hinges, mut joints, mut next) = (Vec::new(), Vec::new(), Some(body));
    let mut carrier = body;
    while let Some(i) = next {
        let joint = &model.bodies()[i].joint;
        let (Motion::Revolute(turn), Some(drive)) = (joint.motion, joint.drive) else { break };
        let (Some(input), true) = (model.layout().drive[i], drive.stiffness == 0.0) else { break };
        let place = model.layout().bodies[i];
        let (angle, rate, freedom) = (place.position, place.velocity, place.freedom);
        hinges.insert(0, Hinge { angle, rate, freedom, drive: input, range: drive.range, lag: lags[i], gain: 0.0 });
        joints.insert(0, (joint.rotation, turn));
        next = model.bodies()[i].parent;
        carrier = next.unwrap_or(i);
    }
    if !(1..=2).contains(&hinges.len()) || next.is_none() {
        return refuse(&format!("on {} rate servos", hinges.len()), "one or two between it and the rest");
    }
    // axes of the hinges and of the thrust at zero angles, in the carrier
    let mut thrust = axis;
    let mut axes: Vec<Vec3<f64>> = Vec::new();
    for (rotation, turn) in joints.iter().rev() {
        axes.iter_mut().for_each(|a| *a = mat_vec(*rotation, *a));
        axes.insert(0, mat_vec(*rotation, *turn));
        thrust = mat_vec(*rotation, thrust);
    }
    let level =
        axes.iter().all(|a| dot(*a, thrust).abs() < 1e-6) && axes.windows(2).all(|p| dot(p[0], p[1]).abs() < 1e-6);
    if !level || hinges.iter().any(|h| !(h.lag.is_finite() && h.lag > 0.0)) {
        return refuse("on servos that are not square to it", "across the thrust, and across each other");
    }
    let hand = axes.get(1).map_or(1.0, |b| dot(cross(*b, thrust), axes[0]).signum());
    let frame = if axes.len() == 1 { vec![cross(axes[0], thrust), thrust] } else { vec![axes[0], axes[1], thrust] };
    let n = rotors.len() as f64;
    let hub = rotors.iter().fold([0.0; 3], |sum, r| axpy(sum, 1.0 / n, own(*r).position));
    let turning = |r: usize| own(r).spin * own(r).moment_per_thrust;
    let reaction = rotors.iter().map(|r| turning(*r)).sum::<f64>() / n;
    let twist = (rotors.len() == 2).then(|| {
        let column = |r: usize| axpy(cross(sub(own(r).position, hub), axis), -turning(r), axis);
        scale(0.5, sub(column(rotors[0]), column(rotors[1])))
    });
    let least = rotors.iter().map(|r| own(*r).max_thrust()).fold(f64::INFINITY, f64::min);
    Ok(Thruster { body, rotors, carrier, hinges, frame, hand, hub, axis, reaction, twist, max_thrust: n * least })
}
