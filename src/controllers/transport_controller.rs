//! A load under drones on bars: position and attitude of the load are tracked.
//!
//! ```text
//! pose of the load ─▶ six-axis law ─▶ [F; M] ─▶ pull μ_j of each bar ─▶ direction of the bar ─▶ drone
//! ```
//!
//! **Pulls**, in the axes of the load, by [`NullSpaceAllocator`]: F = Σ μ_j, M = Σ r_j × μ_j with r_j the anchors, subject to
//!
//! ```text
//! ‖μ_j + m g e_z‖ ≤ 0.85 T_max      ∠(μ_j, e_z) ≤ [`TiltLimits::pull`]      e_z·μ_j ≥ [`TAUT`] of an even share
//! goal: the same pull on every bar, so that all lean alike and stand upright at hover
//! ```
//!
//! **Bars** pull along themselves (Lee, IEEE TCST 26(1) 2018, for cables; m a drone with half its bar, L the bar's length,
//! b its direction away from the load, a_j the acceleration that the pulls as they are give the anchor):
//!
//! ```text
//! F_j = (bᵀ μ_j) b + m (a_j + g e_z) − m L |ḃ|² b + m L (I − b bᵀ)(b̈_d + k_ḃ (ḃ_d − ḃ) + k_b (b_d − b)),   b_d = μ_j/‖μ_j‖
//! ```
//!
//! k_ḃ damps the swing. ḃ_d and b̈_d are those of the reference's jerk and snap. F_j is what the drone pushes with
//! (`gimballed`), its drag added; because forces turn late by T, the pull is taken along b + T ḃ and
//! a_j ahead by T of the reference. It is limited, height before direction, to [`TiltLimits::drone`] and 0.85 T_max: a drone that leaned
//! far to stop a swing would let its bar go.
//!
//! **Poles.** Across the bars an error e of the load obeys ë = −K_v ė − K_p e through bars that follow with k_b, k_ḃ: the
//! four poles of s⁴ + k_ḃ s³ + k_b s² + k_b K_v s + k_b K_p are those of Bessel's polynomial in s/c,
//! s⁴ + 10 s³ + 45 s² + 105 s + 105, which for the same k_ḃ answers in 1/c instead of the 1.6/c of four equal poles and
//! hardly overshoots; so for yaw. Height, roll and pitch need no lean: both poles at −q = −`UPRIGHT` c. c is the
//! bandwidth of the drones' attitude loops over `SEPARATION`.

use super::allocation::null_space::NullSpaceAllocator;
use super::allocation::problem::Rewrite;
use super::allocation::{Cone, Problem};
use super::attitude::Orientation;
use super::cascade::{RateDivisors, Rates};
use super::controller::{Controller, Measurement, Note, Target};
use super::gimballed::{Gimballed, MAX_THRUST_SHARE, Mount, liftable, mounts};
use super::kinematics::Kinematics;
use super::parameters::{BodyModel, CEILING, CommandLimits, ForceLimits, GainSet};
use super::reference::Setpoint;
use super::six_axis::{SixAxis, Wrench};
use super::velocity::{VelocityCommand, limit_force};
use autodiff::jet::Jet;
use autodiff::safe;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::Gains;
use dynamics::spatial::{Mat3, Vec3, add, axpy, cross, dot, inverse, mat_vec, rotate, scale, sub, transpose};
use dynamics::tree::{FrameKinematics, Model, Motion, Multibody, body_poses_into};
use nalgebra::{DMatrix, DVector, vector};

/// Bandwidth of the drones' attitude loops over c: k_ḃ = 10 c is then 1.25 times that bandwidth, a quarter of the filter's
/// that carries it out.
pub(crate) const SEPARATION: f64 = 8.0;
/// q over c.
pub(crate) const UPRIGHT: f64 = 2.5;
/// Least upward pull of a bar over an even share of the load's weight.
pub const TAUT: f64 = 0.15;
with_defaults! {
    /// Largest angles from the vertical, rad.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct TiltLimits {
        /// Of a bar's pull; (0, 1.4]. Default 0.6.
        pub pull: f64 = 0.6,
        /// Of the wanted force on the load; (0, 1.4]. Default 0.45.
        pub load: f64 = 0.45,
        /// Of the force that a drone is asked for; (0, 1.4]. Default 0.6.
        pub drone: f64 = 0.6,
    }
}

impl TiltLimits {
    /// For paths that need accelerations beyond g: less is left when a start goes wrong.
    pub const STEEP: Self = Self { pull: 1.1, load: 0.9, drone: 1.2 };

    /// Checks the angles.
    ///
    /// # Errors
    /// [`Error::Value`] that names the one outside (0, 1.4] rad.
    pub fn validate(&self) -> Result<()> {
        for (what, angle) in [("leans.pull", self.pull), ("leans.load", self.load), ("leans.drone", self.drone)] {
            if !(angle > 0.0 && angle <= 1.4) {
                return Err(Error::value(what, angle, "within (0, 1.4] rad", "Leave it at its default."));
            }
        }
        Ok(())
    }
}

/// s⁴ + 10 s³ + 45 s² + 105 s + 105, the constant first: low frequencies are delayed alike, by 1 s.
const BESSEL: [f64; 4] = [105.0, 105.0, 45.0, 10.0];

/// A bar between load and drone.
#[derive(Debug, Clone, PartialEq)]
struct Bar {
    /// Number of its body.
    body: usize,
    /// Its joint in the load's frame, from the load's centre of mass, m.
    anchor: Vec3<f64>,
    /// From that joint to the drone's, in the bar's frame, a unit vector; and how far, m.
    along: Vec3<f64>,
    length: f64,
    /// Of a drone with half its bar, kg.
    mass: f64,
}

/// The load's six axes, through bars.
pub struct TransportController {
    system: Multibody,
    drones: Vec<Gimballed>,
    bars: Vec<Bar>,
    /// Of each drone, in its own axes, at its share of the weight, N s/m.
    drag: Vec<Vec3<f64>>,
    law: SixAxis<f64>,
    /// c, 1/s.
    pace: f64,
    tilt_limits: TiltLimits,
    built_for: (Option<Gains>, Rates),
    allocation: NullSpaceAllocator,
    schedule: RateDivisors,
    step: u64,
    /// Wanted pulls with two derivatives, world, N.
    pulls: Vec<[Vec3<f64>; 3]>,
    /// Jerk and snap of the reference, world.
    ahead: [Vec3<f64>; 2],
    poses: Vec<FrameKinematics<f64>>,
    /// Equal pulls for the wrench, and the pulls' derivatives, axes of the load.
    goal: Vec<f64>,
    rates: [DVector<f64>; 2],
}

/// Whether a model is a load without rotors under at least two drones, each on a cardan joint of a bar that stands on a
/// cardan joint of the load.
pub(crate) fn is_transport(model: &Model) -> bool {
    model.drones().len() >= 2 && bars(model).is_some() && model.rotors().iter().all(|r| r.body != 0)
}

fn bars(model: &Model) -> Option<Vec<Bar>> {
    let all = mounts(model).ok()?;
    let bodies = model.bodies();
    if bodies.len() != 1 + 4 * all.len() {
        return None;
    }
    let bar = |m: &Mount| {
        let middle = bodies[m.carrier].parent?;
        let hinge = |i: usize| matches!(bodies[i].joint.motion, Motion::Revolute(_)) && bodies[i].joint.drive.is_none();
        let stands = bodies[middle].parent == Some(0) && bodies[middle].mass == 0.0;
        let length = dot(m.place, m.place).sqrt();
        let upright = length > 0.0 && bodies[m.carrier].joint.position == [0.0; 3];
        (stands && upright && hinge(middle) && hinge(m.carrier)).then(|| Bar {
            body: m.carrier,
            anchor: sub(bodies[middle].joint.position, bodies[0].center_of_mass),
            along: scale(1.0 / length, m.place),
            length,
            mass: bodies[m.body].mass + 0.5 * bodies[m.carrier].mass,
        })
    };
    all.iter().map(bar).collect()
}

impl TransportController {
    /// Of `gains`, attitude and rate are each drone's; without, they are derived. All else follows by pole placement.
    ///
    /// # Errors
    /// [`Error::Value`] for another model, a load that the drones cannot lift, or rates that do not divide 1/dt.
    pub fn new(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        Self::with_tilt_limits(system, gains, rates, TiltLimits::default())
    }

    /// With given limits of the angles.
    ///
    /// # Errors
    /// As [`new`](Self::new) and [`TiltLimits::validate`].
    pub fn with_tilt_limits(
        system: &Multibody,
        gains: Option<&Gains>,
        rates: &Rates,
        tilt_limits: TiltLimits,
    ) -> Result<Self> {
        tilt_limits.validate()?;
        let model = system.model();
        let Some(bars) = bars(model).filter(|_| is_transport(model)) else {
            let what = format!("model '{}'", model.name());
            let rule = "a load under two or more drones on bars with cardan joints";
            return Err(Error::value(what, "of another make", rule, "Let controllers::default_controller choose."));
        };
        let drone = |m| Gimballed::new(system, m, gains, rates);
        let drones = mounts(model)?.into_iter().map(drone).collect::<Result<Vec<_>>>()?;
        let slowest = drones.iter().fold(f64::INFINITY, |least, d| least.min(d.bandwidth));
        let pace = slowest / SEPARATION;
        liftable(model, &drones)?;
        let share = model.mass() / drones.len() as f64;
        let law = law(model, &drones, &bars, pace, tilt_limits.load);
        let up = [0.0, 0.0, 1.0];
        let problem = problem(&drones, &bars, law.body.mass * law.body.gravity, law.body.gravity, up, tilt_limits.pull);
        Ok(Self {
            drag: drones.iter().map(|d| d.drag_at(share)).collect(),
            built_for: (gains.copied(), *rates),
            allocation: NullSpaceAllocator::new(problem)?,
            schedule: RateDivisors::new(rates, system.physics().dt)?,
            step: 0,
            pulls: vec![[[0.0; 3]; 3]; drones.len()],
            ahead: STILL,
            poses: Vec::new(),
            goal: vec![0.0; 3 * drones.len()],
            rates: [0, 1].map(|_| DVector::zeros(3 * drones.len())),
            system: system.clone(),
            drones,
            bars,
            law,
            pace,
            tilt_limits,
        })
    }

    /// What the allocation did so far.
    pub fn allocation(&self) -> &NullSpaceAllocator {
        &self.allocation
    }

    /// Pace c, with the poles of a bar those of s⁴ + 10 s³ + 45 s² + 105 s + 105 in s/c, and bandwidth of the slowest drone, rad/s.
    pub fn bandwidths(&self) -> [f64; 2] {
        [self.pace, self.pace * SEPARATION]
    }

    /// From commands to the wrench on the load.
    pub fn law(&self) -> &SixAxis<f64> {
        &self.law
    }

    /// Enters with a pose: a sample of a reference (its yaw plays no part) and an orientation. `state` is the plant's; the commands
    /// are written at their places in `input`.
    pub fn position(&mut self, state: &[f64], sample: &Setpoint<f64>, tilt: &Orientation<f64>, input: &mut [f64]) {
        let ahead = [sample.jerk, sample.snap];
        self.run(state, ahead, input, |law, own| law.position(own, sample, tilt));
    }

    /// Enters with a velocity (its yaw plays no part) and an orientation.
    pub fn velocity(
        &mut self,
        state: &[f64],
        command: &VelocityCommand<f64>,
        tilt: &Orientation<f64>,
        input: &mut [f64],
    ) {
        let ahead = [command.jerk, command.snap];
        self.run(state, ahead, input, |law, own| law.velocity(own, command, tilt));
    }

    /// Enters with a force (world, N) and an orientation.
    pub fn attitude(&mut self, state: &[f64], force: Vec3<f64>, tilt: &Orientation<f64>, input: &mut [f64]) {
        self.run(state, STILL, input, |law, own| law.attitude(own, force, tilt));
    }

    /// Enters with a wrench (N, N m) on the load about its centre of mass, axes of the load.
    pub fn wrench(&mut self, state: &[f64], wrench: &Wrench<f64>, input: &mut [f64]) {
        self.run(state, STILL, input, |_, _| *wrench);
    }

    fn run(
        &mut self,
        state: &[f64],
        ahead: [Vec3<f64>; 2],
        input: &mut [f64],
        wanted: impl FnOnce(&SixAxis<f64>, &Kinematics<f64>) -> Wrench<f64>,
    ) {
        let mut poses = std::mem::take(&mut self.poses);
        body_poses_into(&self.system, state, &mut poses);
        if self.schedule.ticks(self.step)[0] > 0.5 {
            let wrench = wanted(&self.law, &self.tracked(state));
            self.ahead = ahead;
            self.allocate(&poses[0], &wrench, ahead);
        }
        self.step += 1;
        let (linear, angular) = self.motion(&poses);
        for j in 0..self.drones.len() {
            let force = self.push(&poses, j, linear, angular);
            self.drones[j].push(&poses, force, 0.0, input);
        }
        self.poses = poses;
    }

    /// Pulls for a wrench, and their derivatives for the reference's jerk and snap.
    fn allocate(&mut self, load: &FrameKinematics<f64>, wrench: &Wrench<f64>, ahead: [Vec3<f64>; 2]) {
        let (n, mass) = (self.drones.len(), self.law.body.mass);
        let up = load.rotation[2];
        let (drones, bars, gravity) = (&self.drones, &self.bars, self.law.body.gravity);
        let lean = self.tilt_limits.pull;
        self.allocation.change(|p| {
            cones(&mut p.cones, drones, bars, mass * gravity, gravity, up, lean);
            p.anchor.iter_mut().enumerate().for_each(|(i, u)| *u = even(n, mass * gravity, up, i));
        });
        self.goal.iter_mut().enumerate().for_each(|(i, u)| *u = wrench[i % 3] / n as f64);
        self.allocation.solve(wrench, &self.goal);
        for (rate, a) in self.rates.iter_mut().zip(ahead) {
            let f = mat_vec(transpose(load.rotation), scale(mass, a));
            self.allocation.inverse().mul_to(&vector![f[0], f[1], f[2], 0.0, 0.0, 0.0], rate);
        }
        let (inputs, rates) = (self.allocation.inputs(), &self.rates);
        let world = |u: &[f64]| mat_vec(load.rotation, [u[0], u[1], u[2]]);
        for (j, pull) in self.pulls.iter_mut().enumerate() {
            let of = |u: &[f64]| world(&u[3 * j..3 * j + 3]);
            *pull = [of(inputs), of(rates[0].as_slice()), of(rates[1].as_slice())];
        }
    }

    /// Direction of a bar away from the load, and its rate, world.
    fn direction(&self, poses: &[FrameKinematics<f64>], j: usize) -> [Vec3<f64>; 2] {
        let pose = &poses[self.bars[j].body];
        let b = mat_vec(pose.rotation, self.bars[j].along);
        [b, cross(pose.angular_velocity, b)]
    }

    /// Linear acceleration of the load's centre of mass and its angular acceleration under the pulls along the bars as
    /// they are, world.
    fn motion(&self, poses: &[FrameKinematics<f64>]) -> (Vec3<f64>, Vec3<f64>) {
        let (load, body) = (&poses[0], &self.law.body);
        let (mut force, mut moment) = ([0.0; 3], [0.0; 3]);
        for (j, bar) in self.bars.iter().enumerate() {
            let [b, _] = self.direction(poses, j);
            let pull = scale(dot(b, self.pulls[j][0]), b);
            force = add(force, pull);
            moment = add(moment, cross(mat_vec(load.rotation, bar.anchor), pull));
        }
        let local = mat_vec(transpose(load.rotation), moment);
        let w = mat_vec(transpose(load.rotation), load.angular_velocity);
        let local = sub(local, cross(w, mat_vec(body.inertia, w)));
        let angular = mat_vec(load.rotation, mat_vec(inverse(body.inertia), local));
        (sub(scale(1.0 / body.mass, force), [0.0, 0.0, body.gravity]), angular)
    }

    /// F_j, world, N.
    fn push(&self, poses: &[FrameKinematics<f64>], j: usize, linear: Vec3<f64>, angular: Vec3<f64>) -> Vec3<f64> {
        let (bar, load) = (&self.bars[j], &poses[0]);
        let lever = mat_vec(load.rotation, bar.anchor);
        let w = load.angular_velocity;
        let anchor = add(linear, add(cross(angular, lever), cross(w, cross(w, lever))));
        let (t, [jerk, snap]) = (self.drones[j].delay(), self.ahead);
        let lift = add(anchor, [0.0, 0.0, self.law.body.gravity]);
        let lift = axpy(axpy(lift, t, jerk), 0.5 * t * t, snap);
        let [b, turning] = self.direction(poses, j);
        let pull = scale(dot(b, self.pulls[j][0]), axpy(b, t, turning));
        let force = axpy(pull, bar.mass, axpy(lift, bar.length, self.swing(j, b, turning)));
        let force = add(force, self.resistance(poses, j));
        let most = MAX_THRUST_SHARE * self.drones[j].max_thrust;
        let vertical = [TAUT * bar.mass * self.law.body.gravity, CEILING * most];
        limit_force(force, self.tilt_limits.drone.tan(), vertical, most)
    }

    /// Wanted b̈ of a bar, 1/s²: across it towards b_d, along it what turning needs.
    fn swing(&self, j: usize, b: Vec3<f64>, turning: Vec3<f64>) -> Vec3<f64> {
        let [mu, rate, change] = self.pulls[j];
        let wanted = safe::normalise([0, 1, 2].map(|i| Jet::<f64, 3>::from_derivatives([mu[i], rate[i], change[i]])));
        let d = [0, 1, 2].map(|k| wanted.map(|x| x.derivative(k)));
        let c = self.pace;
        let swing = axpy(axpy(d[2], BESSEL[3] * c, sub(d[1], turning)), BESSEL[2] * c * c, sub(d[0], b));
        axpy(axpy(swing, -dot(swing, b), b), -dot(turning, turning), b)
    }

    /// What balances the drag of a drone as it moves, world, N.
    fn resistance(&self, poses: &[FrameKinematics<f64>], j: usize) -> Vec3<f64> {
        let pose = &poses[self.drones[j].mount.body];
        let local = mat_vec(transpose(pose.rotation), pose.velocity);
        mat_vec(pose.rotation, [0, 1, 2].map(|k| self.drag[j][k] * local[k]))
    }
}

/// A reference that neither jerks nor snaps.
const STILL: [Vec3<f64>; 2] = [[0.0; 3]; 2];

/// Load with the lower halves of its bars; gains by pole placement.
fn law(model: &Model, drones: &[Gimballed], bars: &[Bar], c: f64, lean: f64) -> SixAxis<f64> {
    let load = &model.bodies()[0];
    let own = load.inertia.matrix();
    let mut inertia: Mat3<f64> = [0, 1, 2].map(|i| [0, 1, 2].map(|k| own[(i, k)]));
    let mut mass = load.mass;
    for bar in bars {
        let (half, r) = (0.5 * model.bodies()[bar.body].mass, bar.anchor);
        mass += half;
        for i in 0..3 {
            inertia[i][i] += half * dot(r, r);
            (0..3).for_each(|k| inertia[i][k] -= half * r[i] * r[k]);
        }
    }
    let q = UPRIGHT * c;
    let (slow, fast) = ([BESSEL[0] / BESSEL[2] * c * c, BESSEL[1] / BESSEL[2] * c], [q * q, 2.0 * q]);
    let gains = Gains {
        position: [slow[0], slow[0], fast[0]],
        velocity: [slow[1], slow[1], fast[1]],
        attitude: [inertia[0][0] * fast[0], inertia[1][1] * fast[0], inertia[2][2] * slow[0]],
        rate: [inertia[0][0] * fast[1], inertia[1][1] * fast[1], inertia[2][2] * slow[1]],
        integral: [0.0; 2],
    };
    let gravity = model.parts().gravity;
    // what is left of the drones' thrust once they carry themselves
    let lift: f64 = drones.iter().zip(bars).map(|(d, b)| MAX_THRUST_SHARE * d.max_thrust - b.mass * gravity).sum();
    SixAxis {
        body: BodyModel { mass, inertia, drag: load.drag.linear, drag_moment: [[0.0; 3]; 3], gravity },
        gains: GainSet::constant(&gains),
        limits: ForceLimits::constant(
            &CommandLimits { tilt: lean, vertical: 0.3, thrust: 1.0 },
            lift.max(0.0),
            mass * gravity,
        ),
    }
}

/// Pulls as inputs; a newton metre counts as a newton at the mean arm.
fn problem(drones: &[Gimballed], bars: &[Bar], weight: f64, gravity: f64, up: Vec3<f64>, lean: f64) -> Problem {
    let n = 3 * bars.len();
    let arm = bars.iter().map(|b| dot(b.anchor, b.anchor).sqrt()).sum::<f64>() / bars.len() as f64;
    let mut geometry = DMatrix::zeros(6, n);
    for (j, bar) in bars.iter().enumerate() {
        for k in 0..3 {
            let mut unit = [0.0; 3];
            unit[k] = 1.0;
            let moment = cross(bar.anchor, unit);
            (0..3).for_each(|i| geometry[(i, 3 * j + k)] = unit[i]);
            (0..3).for_each(|i| geometry[(3 + i, 3 * j + k)] = moment[i]);
        }
    }
    let mut all = Vec::new();
    cones(&mut all, drones, bars, weight, gravity, up, lean);
    Problem {
        geometry,
        weights: [1.0, 1.0, 1.0, arm.powi(-2), arm.powi(-2), arm.powi(-2)],
        regularisation: 1.0,
        preference: vec![0.0; n],
        lower: vec![f64::NEG_INFINITY; n],
        upper: vec![f64::INFINITY; n],
        cones: all,
        anchor: (0..n).map(|i| even(bars.len(), weight, up, i)).collect(),
    }
}

/// Input i of upright pulls that share a weight.
fn even(n: usize, weight: f64, up: Vec3<f64>, i: usize) -> f64 {
    up[i % 3] * weight / n as f64
}

/// Thrust, lean and least pull of every bar; `up` in the axes of the load.
fn cones(
    list: &mut Vec<Cone>,
    drones: &[Gimballed],
    bars: &[Bar],
    weight: f64,
    gravity: f64,
    up: Vec3<f64>,
    lean: f64,
) {
    let mut list = Rewrite::of(list);
    for (j, (drone, bar)) in drones.iter().zip(bars).enumerate() {
        let inputs = [0, 1, 2].map(|k| 3 * j + k);
        list.ball(inputs, up.map(|up| bar.mass * gravity * up), MAX_THRUST_SHARE * drone.max_thrust);
        list.tilt(inputs, up, lean.cos());
        list.half_space(inputs, up, TAUT * weight / bars.len() as f64);
    }
}

impl Controller for TransportController {
    fn name(&self) -> &str {
        "transport"
    }

    fn why_no_law(&self) -> &'static str {
        "a controller with an allocation over cones inside"
    }

    fn description(&self) -> String {
        let [pace, drones] = self.bandwidths();
        format!("pose of the load through {} bars, {:.1} s late; drones {drones:.1} rad/s", self.bars.len(), 1.0 / pace)
    }

    fn schedule(&self) -> Option<RateDivisors> {
        Some(self.schedule)
    }

    fn reset(&mut self) {
        let (gains, rates) = self.built_for;
        if let Ok(fresh) = Self::with_tilt_limits(&self.system, gains.as_ref(), &rates, self.tilt_limits) {
            *self = fresh;
        }
    }

    fn notes(&self) -> Vec<Note> {
        vec![self.allocation.note()]
    }

    /// The load at its centre of mass.
    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        let own = Kinematics::read(&state[self.system.layout().bodies[0].position..]);
        let lever = self.system.model().bodies()[0].center_of_mass;
        let drift = rotate(own.attitude, cross(own.angular_velocity, lever));
        let position = add(own.position, rotate(own.attitude, lever));
        Kinematics { position, velocity: add(own.velocity, drift), ..own }
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, input: &mut [f64]) {
        let tilt = target.orientation(seen.time);
        self.position(seen.state, &target.sample(seen.time), &tilt, input);
    }
}
