//! A frame carried by drones on cardan joints, steered in six axes.
//!
//! ```text
//! pose ─▶ six-axis law ─▶ [F; M] ─▶ F_j, τ_j ─▶ drone j: thrust ‖F_j‖, z along F_j
//! ```
//!
//! **Plant.** The joints pass forces and, about c_j alone, a moment: what turns the frame is its own inertia, the drones
//! as points at their joints, and of each drone's inertia J_j what c_j feels,
//! I = I_frame + Σ m_j (|r_j|² − r_j r_jᵀ) + Σ c_j c_jᵀ/(c_jᵀ J_j⁻¹ c_j), about the centre of mass of all. The moment that the
//! joints' damping puts on the frame while the drones turn is fed forward.
//!
//! **Allocation**, in the axes of the frame (Su et al., arXiv 2207.09645), by [`NullSpaceAllocator`]:
//!
//! ```text
//! F = Σ F_j          M = Σ r_j × F_j + κ c_j Δ_j          Δ_j: newtons moved between drone j's rotors of either spin
//! ‖F_j‖ ≤ 0.85 T_max      ∠(F_j, e_z) ≤ reach      |Δ_j| ≤ 0.1 T_max      ∠(−F_j, r_i − r_j) ≥ wake  for all i ≠ j
//! goal: the same force on every drone
//! ```
//!
//! The last condition keeps each drone out of the others' wakes. It is not convex; the half-space that touches the
//! forbidden cone where the last solution is nearest to it is, and never allows what the cone forbids.
//!
//! **Bandwidths.** A force turns as fast as its drone: the drones' attitude loops must be `SEPARATION` times as fast as
//! the loops around the frame. Unless gains are given, all six axes have both poles at −ω_drone/`SEPARATION`.
//!
//! **Limits.** With two drones nothing turns the frame about the line through both: both forces and both c_j have no
//! moment about it. The direction is left out (it follows the drones through the joints' damping).

use super::allocation::null_space::NullSpaceAllocator;
use super::allocation::problem::Rewrite;
use super::allocation::{Axis, Cone, Problem};
use super::attitude::Orientation;
use super::cascade::{RateDivisors, Rates};
use super::controller::{Controller, Measurement, Note, Target};
use super::gimballed::{Gimballed, MAX_THRUST_SHARE, liftable, mounts};
use super::kinematics::Kinematics;
use super::parameters::{BodyModel, CommandLimits, ForceLimits, GainSet};
use super::position::velocity_command;
use super::reference::Setpoint;
use super::six_axis::{SixAxis, Wrench};
use super::velocity::VelocityCommand;
use autodiff::safe;
use base::error::{Error, Result};
use dynamics::Gains;
use dynamics::spatial::{Mat3, Vec3, add, axpy, cross, dot, inverse, mat_mul, mat_vec, scale, sub, transpose};
use dynamics::tree::{FrameKinematics, Model, Multibody, body_poses, body_poses_into, center_of_mass, momentum};
use nalgebra::DMatrix;

/// Bandwidth of the drones' attitude loops over that of the frame's.
pub(crate) const SEPARATION: f64 = 5.0;
/// Largest Δ_j over Σ T_max of a drone.
pub(crate) const TWIST_SHARE: f64 = 0.1;

/// Directions in which drones may push.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Directions {
    /// Most between a force and the frame's normal, rad; less where a joint's stops are nearer.
    pub reach: f64,
    /// Least between a wake's axis and the way to another drone, rad: half-angle of the wake and margin.
    pub wake: f64,
}

impl Default for Directions {
    /// 70° and 45°: on the edge of that cone downwash is at most exp(−½ 2²) = 14 % of
    /// the thrust.
    fn default() -> Self {
        Self { reach: 70_f64.to_radians(), wake: 45_f64.to_radians() }
    }
}

impl Directions {
    /// Checks the angles: a force across the frame has no attitude of a drone, a wake of 90° no direction left.
    ///
    /// # Errors
    /// [`Error::Value`] that names the angle.
    pub fn validate(&self) -> Result<()> {
        for (what, angle, least) in [("directions.reach", self.reach, 0.1), ("directions.wake", self.wake, 0.0)] {
            if !(least..=1.4).contains(&angle) {
                let rule = format!("within [{least}, 1.4] rad");
                return Err(Error::value(what, angle, rule, "Leave it at its default."));
            }
        }
        Ok(())
    }
}

/// Six axes of a frame under drones on cardan joints.
pub struct PlatformController {
    system: Multibody,
    drones: Vec<Gimballed>,
    /// Of each drone, in its own axes, at its share of the weight, N s/m.
    drag: Vec<Vec3<f64>>,
    law: SixAxis<f64>,
    /// Both poles of the rotation about each axis are at its negative, 1/s.
    turning: f64,
    directions: Directions,
    allocation: NullSpaceAllocator,
    built_for: (Option<Gains>, Rates),
    schedule: RateDivisors,
    step: u64,
    /// World, N; and about the drones' z, N m.
    forces: Vec<Vec3<f64>>,
    twists: Vec<f64>,
    poses: Vec<FrameKinematics<f64>>,
    /// Joints, held directions, last forces, axes of the frame; and the goal of the inputs.
    points: Vec<Vec3<f64>>,
    held: Vec<Vec3<f64>>,
    before: Vec<Vec3<f64>>,
    goal: Vec<f64>,
}

/// Whether a model is a frame without rotors under at least two drones, each on a cardan joint of the frame.
pub(crate) fn is_platform(model: &Model) -> bool {
    let n = model.drones().len();
    let drones = mounts(model).is_ok_and(|m| m.iter().all(|m| m.carrier == 0));
    n >= 2 && drones && model.bodies().len() == 1 + 2 * n && model.rotors().iter().all(|r| r.body != 0)
}

impl PlatformController {
    /// With default `Directions`. Of `gains`, position and velocity are the frame's (its rotation gets the same poles),
    /// attitude and rate each drone's; without, the drones' are derived and the frame's follow by pole placement.
    ///
    /// # Errors
    /// [`Error::Value`] for another model, gains without bandwidth separation, or rates that do not divide 1/dt.
    pub fn new(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        Self::with_directions(system, gains, rates, Directions::default())
    }

    /// With given directions.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_directions(
        system: &Multibody,
        gains: Option<&Gains>,
        rates: &Rates,
        directions: Directions,
    ) -> Result<Self> {
        let model = system.model();
        if !is_platform(model) {
            let what = format!("model '{}'", model.name());
            let rule = "a frame under two or more drones on cardan joints";
            return Err(Error::value(what, "of another make", rule, "Let controllers::default_controller choose."));
        }
        directions.validate()?;
        let mounts = mounts(model)?;
        let reach = mounts.iter().fold(directions.reach, |least, m| least.min(m.reach));
        let drones = mounts.into_iter().map(|m| Gimballed::new(system, m, gains, rates)).collect::<Result<Vec<_>>>()?;
        let slowest = drones.iter().fold(f64::INFINITY, |least, d| least.min(d.bandwidth));
        liftable(model, &drones)?;
        let turning = separated(model.name(), gains, slowest)?;
        let n = drones.len();
        let share = model.mass() / n as f64;
        let directions = Directions { reach, ..directions };
        let places: Vec<_> = drones.iter().map(|d| d.mount.place).collect();
        let mut problem = problem(&drones, &places);
        cones(&mut problem.cones, &drones, directions, &places, &vec![[0.0, 0.0, 1.0]; n]);
        let mut own = Self {
            drag: drones.iter().map(|d| d.drag_at(share)).collect(),
            law: law(model, &drones, gains, turning),
            directions,
            built_for: (gains.copied(), *rates),
            allocation: NullSpaceAllocator::new(problem)?,
            schedule: RateDivisors::new(rates, system.physics().dt)?,
            step: 0,
            forces: vec![[0.0; 3]; n],
            twists: vec![0.0; n],
            poses: Vec::new(),
            points: Vec::new(),
            held: Vec::new(),
            before: Vec::new(),
            goal: Vec::new(),
            system: system.clone(),
            turning,
            drones,
        };
        let rest = system.rest_state();
        let poses = body_poses(system, &rest);
        own.renew(&rest, &poses);
        Ok(own)
    }

    /// What the allocation did so far.
    pub fn allocation(&self) -> &NullSpaceAllocator {
        &self.allocation
    }

    /// Force that each drone is asked to push with, world, N.
    pub fn forces(&self) -> &[Vec3<f64>] {
        &self.forces
    }

    /// Poles of the frame's rotation, and bandwidth of the slowest drone, rad/s.
    pub fn bandwidths(&self) -> [f64; 2] {
        [self.turning, self.drones.iter().fold(f64::INFINITY, |least, d| least.min(d.bandwidth))]
    }

    /// From commands to the wrench; of the shape that the last command met.
    pub fn law(&self) -> &SixAxis<f64> {
        &self.law
    }

    /// Axes of the frame about which or along which nothing acts: with drones in one line, that line.
    pub fn lost(&self) -> Vec<Axis> {
        let reached = self.allocation.reached();
        Axis::ALL.into_iter().zip(reached).filter(|(_, share)| *share < 0.5).map(|(axis, _)| axis).collect()
    }

    /// Enters with a pose: a sample of a reference (its yaw plays no part) and an orientation. `state` is the plant's; the commands
    /// are written at their places in `input`.
    pub fn position(&mut self, state: &[f64], sample: &Setpoint<f64>, tilt: &Orientation<f64>, input: &mut [f64]) {
        let own = self.tracked(state);
        self.velocity(state, &velocity_command(&self.law.gains, sample, &own), tilt, input);
    }

    /// Enters with a velocity and an orientation; [`early`](Self::early).
    pub fn velocity(
        &mut self,
        state: &[f64],
        command: &VelocityCommand<f64>,
        tilt: &Orientation<f64>,
        input: &mut [f64],
    ) {
        let early = self.early(command);
        self.run(state, input, |law, own| law.velocity(own, &early, tilt));
    }

    /// Enters with a force (world, N) and an orientation.
    pub fn attitude(&mut self, state: &[f64], force: Vec3<f64>, tilt: &Orientation<f64>, input: &mut [f64]) {
        self.run(state, input, |law, own| law.attitude(own, force, tilt));
    }

    /// Enters with a wrench (N, N m) about the centre of mass of all, axes of the frame.
    pub fn wrench(&mut self, state: &[f64], wrench: &Wrench<f64>, input: &mut [f64]) {
        self.run(state, input, |_, _| *wrench);
    }

    /// A command whose acceleration is ahead by the delay t with which forces turn: a + j t + ½ s t².
    pub fn early(&self, command: &VelocityCommand<f64>) -> VelocityCommand<f64> {
        let t = self.drones.iter().fold(0.0_f64, |most, d| most.max(d.delay()));
        let acceleration = axpy(axpy(command.acceleration, t, command.jerk), 0.5 * t * t, command.snap);
        VelocityCommand { acceleration, ..*command }
    }

    fn run(
        &mut self,
        state: &[f64],
        input: &mut [f64],
        wanted: impl FnOnce(&SixAxis<f64>, &Kinematics<f64>) -> Wrench<f64>,
    ) {
        let mut poses = std::mem::take(&mut self.poses);
        body_poses_into(&self.system, state, &mut poses);
        if self.schedule.ticks(self.step)[0] > 0.5 {
            self.renew(state, &poses);
            let wrench = wanted(&self.law, &self.tracked(state));
            self.allocate(&poses, wrench);
        }
        self.step += 1;
        for (j, drone) in self.drones.iter_mut().enumerate() {
            drone.push(&poses, self.forces[j], self.twists[j], input);
        }
        self.poses = poses;
    }

    /// Inertia, drag, geometry and cones of the present shape.
    fn renew(&mut self, state: &[f64], poses: &[FrameKinematics<f64>]) {
        let (center, frame) = (center_of_mass(&self.system, state), &poses[0]);
        let back = transpose(frame.rotation);
        let body = &mut self.law.body;
        body.inertia = inertia(self.system.model(), &self.drones, poses, center);
        body.drag = self.system.model().bodies()[0].drag.linear;
        for (drone, drag) in self.drones.iter().zip(&self.drag) {
            let turn = mat_mul(back, poses[drone.mount.body].rotation);
            body.drag = add(body.drag, [0, 1, 2].map(|k| (0..3).map(|i| turn[k][i] * turn[k][i] * drag[i]).sum()));
        }
        for k in 0..3 {
            self.law.gains.attitude[k] = body.inertia[k][k] * self.turning * self.turning;
            self.law.gains.rate[k] = 2.0 * body.inertia[k][k] * self.turning;
        }
        let Self { drones, directions, points, held, before, .. } = self;
        [&mut *points, held, before].into_iter().for_each(Vec::clear);
        points.extend(drones.iter().map(|d| mat_vec(back, sub(place(d, poses), center))));
        held.extend(drones.iter().map(|d| mat_vec(back, d.mount.held(poses))));
        before.extend(self.allocation.inputs().chunks_exact(INPUTS).map(|u| [u[0], u[1], u[2]]));
        self.allocation.change(|p| {
            fill(&mut p.geometry, drones, points, held);
            cones(&mut p.cones, drones, *directions, points, before);
        });
    }

    fn allocate(&mut self, poses: &[FrameKinematics<f64>], mut wrench: Wrench<f64>) {
        let frame = poses[0].rotation;
        let damping = self.drones.iter().fold([0.0; 3], |sum, d| add(sum, d.reaction()));
        let damping = mat_vec(transpose(frame), damping);
        (0..3).for_each(|k| wrench[3 + k] -= damping[k]);
        let n = self.drones.len() as f64;
        self.goal.clear();
        self.goal.extend(self.drones.iter().flat_map(|_| [wrench[0] / n, wrench[1] / n, wrench[2] / n, 0.0]));
        let inputs = self.allocation.solve(&wrench, &self.goal);
        for (j, u) in inputs.chunks_exact(INPUTS).enumerate() {
            self.forces[j] = mat_vec(frame, [u[0], u[1], u[2]]);
            self.twists[j] = self.drones[j].yaw_per_thrust() * u[3];
        }
    }
}

/// Per drone: force and Δ.
const INPUTS: usize = 4;

/// The poles of the frame, rad/s, if its drones are fast enough.
fn separated(name: &str, gains: Option<&Gains>, drones: f64) -> Result<f64> {
    let Some(gains) = gains else { return Ok(drones / SEPARATION) };
    let frame = gains.position.iter().fold(0.0_f64, |most, k| most.max(k.max(0.0).sqrt()));
    if drones >= SEPARATION * frame {
        return Ok(if frame > 0.0 { frame } else { drones / SEPARATION });
    }
    Err(Error::value(
        format!("platform '{name}': bandwidth of the drones over that of the frame"),
        format!("{:.2} ({drones:.2} over {frame:.2} rad/s)", drones / frame),
        format!("≥ {SEPARATION}"),
        "Lower gains.position (ω = √K_p), or raise gains.attitude of the drones.",
    ))
}

fn law(model: &Model, drones: &[Gimballed], gains: Option<&Gains>, pole: f64) -> SixAxis<f64> {
    let lift: f64 = drones.iter().map(|d| d.max_thrust).sum();
    let own = Gains {
        position: gains.map_or([pole * pole; 3], |g| g.position),
        velocity: gains.map_or([2.0 * pole; 3], |g| g.velocity),
        attitude: [0.0; 3],
        rate: [1.0; 3],
        integral: [0.0; 2],
    };
    let zero = [[0.0; 3]; 3];
    let (mass, gravity) = (model.mass(), model.parts().gravity);
    SixAxis {
        body: BodyModel { mass, inertia: zero, drag: [0.0; 3], drag_moment: zero, gravity },
        gains: GainSet::constant(&own),
        limits: ForceLimits::constant(
            &CommandLimits { thrust: MAX_THRUST_SHARE, ..CommandLimits::default() },
            lift,
            mass * gravity,
        ),
    }
}

/// Where a drone's joint is, world, m.
fn place(drone: &Gimballed, poses: &[FrameKinematics<f64>]) -> Vec3<f64> {
    poses[drone.mount.body].position
}

/// What the frame feels when it turns: I of the [module](self), in its axes.
fn inertia(model: &Model, drones: &[Gimballed], poses: &[FrameKinematics<f64>], center: Vec3<f64>) -> Mat3<f64> {
    let frame = &model.bodies()[0];
    let back = transpose(poses[0].rotation);
    let own = frame.inertia.matrix();
    let mut total = [0, 1, 2].map(|i| [0, 1, 2].map(|k| own[(i, k)]));
    let mut point = |mass: f64, at: Vec3<f64>| {
        let r = mat_vec(back, sub(at, center));
        for i in 0..3 {
            total[i][i] += mass * dot(r, r);
            (0..3).for_each(|k| total[i][k] -= mass * r[i] * r[k]);
        }
    };
    point(frame.mass, add(poses[0].position, mat_vec(poses[0].rotation, frame.center_of_mass)));
    for drone in drones {
        point(model.bodies()[drone.mount.body].mass, place(drone, poses));
    }
    for drone in drones {
        let own = model.bodies()[drone.mount.body].inertia.matrix();
        let light = inverse([0, 1, 2].map(|i| [0, 1, 2].map(|k| own[(i, k)])));
        let held = drone.mount.held(poses);
        let local = mat_vec(transpose(poses[drone.mount.body].rotation), held);
        let (felt, c) = (1.0 / dot(local, mat_vec(light, local)), mat_vec(back, held));
        for i in 0..3 {
            total[i] = axpy(total[i], felt * c[i], c);
        }
    }
    total
}

/// Bounds and weights; a newton metre counts as a newton at the mean arm.
fn problem(drones: &[Gimballed], points: &[Vec3<f64>]) -> Problem {
    let n = INPUTS * drones.len();
    let arm = points.iter().map(|p| dot(*p, *p).sqrt()).sum::<f64>() / drones.len() as f64;
    let twist = |sign: f64, open: f64| -> Vec<f64> {
        drones.iter().flat_map(|d| [open, open, open, sign * TWIST_SHARE * d.max_thrust]).collect()
    };
    Problem {
        geometry: DMatrix::zeros(6, n),
        weights: [1.0, 1.0, 1.0, arm.powi(-2), arm.powi(-2), arm.powi(-2)],
        regularisation: 1.0,
        preference: vec![0.0; n],
        lower: twist(-1.0, f64::NEG_INFINITY),
        upper: twist(1.0, f64::INFINITY),
        cones: Vec::new(),
        anchor: drones.iter().flat_map(|d| [0.0, 0.0, 0.4 * d.max_thrust, 0.0]).collect(),
    }
}

/// B: points and held directions from the centre of mass, axes of the frame.
fn fill(geometry: &mut DMatrix<f64>, drones: &[Gimballed], points: &[Vec3<f64>], held: &[Vec3<f64>]) {
    for (j, drone) in drones.iter().enumerate() {
        for k in 0..3 {
            let mut unit = [0.0; 3];
            unit[k] = 1.0;
            let moment = cross(points[j], unit);
            (0..3).for_each(|i| geometry[(i, INPUTS * j + k)] = unit[i]);
            (0..3).for_each(|i| geometry[(3 + i, INPUTS * j + k)] = moment[i]);
            geometry[(3 + k, INPUTS * j + 3)] = drone.yaw_per_thrust() * held[j][k];
        }
    }
}

/// Thrust, reach and wakes.
fn cones(
    list: &mut Vec<Cone>,
    drones: &[Gimballed],
    directions: Directions,
    points: &[Vec3<f64>],
    before: &[Vec3<f64>],
) {
    let mut list = Rewrite::of(list);
    for (j, drone) in drones.iter().enumerate() {
        let inputs = [0, 1, 2].map(|k| INPUTS * j + k);
        list.ball(inputs, [0.0; 3], MAX_THRUST_SHARE * drone.max_thrust);
        list.tilt(inputs, [0.0, 0.0, 1.0], directions.reach.cos());
        for i in (0..drones.len()).filter(|i| *i != j) {
            let way = safe::normalise(sub(points[i], points[j]));
            list.half_space(inputs, clear(way, before[j], directions.wake), 0.0);
        }
    }
}

/// Normal of the half-space of forces that touches the cone of those whose wake is closer than `angle` to `way`, on the
/// side of the force `before`.
pub fn clear(way: Vec3<f64>, before: Vec3<f64>, angle: f64) -> Vec3<f64> {
    let side = safe::normalise(axpy(before, -dot(before, way), way));
    let (s, c) = angle.sin_cos();
    axpy(scale(c, side), s, way)
}

impl Controller for PlatformController {
    fn name(&self) -> &str {
        "platform"
    }

    fn why_no_law(&self) -> &'static str {
        "a controller with an allocation over cones inside"
    }

    fn description(&self) -> String {
        let ([frame, drones], n, lost) = (self.bandwidths(), self.drones.len(), self.lost());
        let axes = if lost.is_empty() {
            "six axes of the frame".into()
        } else {
            let names: Vec<_> = lost.iter().map(|axis| format!("{axis:?}").to_lowercase()).collect();
            format!("all axes of the frame but {}, which nothing turns", names.join(" and "))
        };
        format!("{axes} by {n} force vectors; poles at -{frame:.2} 1/s, drones {drones:.1} rad/s")
    }

    fn schedule(&self) -> Option<RateDivisors> {
        Some(self.schedule)
    }

    fn reset(&mut self) {
        let (gains, rates) = self.built_for;
        if let Ok(fresh) = Self::with_directions(&self.system, gains.as_ref(), &rates, self.directions) {
            *self = fresh;
        }
    }

    fn holds_tilt(&self) -> bool {
        true
    }

    fn notes(&self) -> Vec<Note> {
        vec![self.allocation.note()]
    }

    /// The centre of mass of all, with the frame's attitude.
    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        let own = Kinematics::read(&state[self.system.layout().bodies[0].position..]);
        let velocity = scale(1.0 / self.system.model().mass(), momentum(&self.system, state).linear);
        Kinematics { position: center_of_mass(&self.system, state), velocity, ..own }
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, input: &mut [f64]) {
        let tilt = target.orientation(seen.time);
        self.position(seen.state, &target.sample(seen.time), &tilt, input);
    }
}
