//! A drone on a cardan joint that pushes its carrier with a wanted force.
//!
//! With z = F/‖F‖ and a the joint's first axis (fixed to the carrier), y = z × a/‖·‖, x = y × z, the drone's attitude is
//!
//! ```text
//! R_d = [x y z] Cᵀ        C: axes of the joint → those of the drone, at rest
//! ```
//!
//! the only one with this z that the joint allows: in the joint's frame on the carrier its angles are
//! α = atan2(−F_y, F_z), β = asin(F_x/‖F‖) (Su et al., arXiv 2207.09645). It is tracked by the drone's attitude and rate
//! levels. The joint holds the drone about one direction only, c = a × y: yaw gains are zero there, and a yaw moment of
//! the rotors goes straight to the carrier.
//!
//! F may jump. Its direction passes a critically damped filter (closed form, exact for any step)
//! F̈_f = ω_f² (F − F_f) − 2 ω_f Ḟ_f, whose Ḟ_f and F̈_f are fed forward as rates of R_d, so that the attitude loop's own
//! lag is not added; the thrust ‖F‖ does not wait for it.
//!
//! The joint's damping d acts on the drone as d (q̇_d − q̇) once d q̇_d is fed forward: it is a part of the wanted damping,
//! and comes without the motors' lag. K_ω is lowered by it, to no less than [`LEAST_RATE_GAIN`] of its value.

use super::attitude::{AttitudeCommand, Orientation};
use super::cascade::{Cascade, Rates};
use super::kinematics::Kinematics;
use super::parameters::BodyModel;
use autodiff::jet::Jet;
use autodiff::{Scalar, safe};
use base::error::{Error, Result};
use dynamics::spatial::{
    Mat3, Vec3, add, axpy, cross, dot, from_matrix, inverse, mat_mul, mat_vec, scale, sub, transpose,
};
use dynamics::tree::{FrameKinematics, Model, Motion, Multibody, carrier};
use dynamics::{Gains, Vehicle};

/// ω_f over the bandwidth of the drone's attitude loop.
pub(crate) const FILTER: f64 = 5.0;
/// See the [module](self).
pub(crate) const LEAST_RATE_GAIN: f64 = 0.4;
/// Largest wanted thrust over the most that the rotors give: the rest turns the drone.
pub(crate) const MAX_THRUST_SHARE: f64 = 0.85;
/// Least wanted thrust over the most that the rotors give: below it the rotors cannot turn the drone.
const MIN_THRUST_SHARE: f64 = 0.02;

/// Where a drone sits: a passive universal joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Mount {
    /// Number of the drone in the model.
    pub drone: usize,
    /// Number of its body.
    pub body: usize,
    /// Number of the body that carries the joint.
    pub carrier: usize,
    /// Of the joint, in the carrier's frame, m.
    pub place: Vec3<f64>,
    /// a: the first axis in the carrier's frame.
    pub axis: Vec3<f64>,
    /// C.
    pub turn: Mat3<f64>,
    /// d about the first and second axis, N m s/rad.
    pub damping: [f64; 2],
    /// How far each axis turns from rest, rad; infinite without stops.
    pub reach: f64,
}

impl Mount {
    /// Of the model's drone `number`, if it sits on two passive hinges across each other and across its thrust.
    pub fn of(model: &Model, number: usize) -> Option<Self> {
        let bodies = model.bodies();
        let body = model.drones()[number].body;
        let cross_body = bodies[body].parent?;
        let carrier = bodies[cross_body].parent?;
        let (first, second) = (&bodies[cross_body].joint, &bodies[body].joint);
        let (Motion::Revolute(a), Motion::Revolute(b)) = (first.motion, second.motion) else { return None };
        let passive = first.drive.is_none() && second.drive.is_none() && bodies[cross_body].mass == 0.0;
        let along = mat_vec(transpose(second.rotation), a);
        let up = cross(along, b);
        // cardan: axes square to each other and to the thrust
        let square = dot(along, b).abs() < 1e-9 && up[2].abs() > 1.0 - 1e-9 && second.position == [0.0; 3];
        if !passive || !square {
            return None;
        }
        let sign = up[2].signum();
        let (x, z) = (scale(sign, along), scale(sign, up));
        let limits = [first, second].into_iter().filter_map(|j| j.limits);
        Some(Self {
            drone: number,
            body,
            carrier,
            place: first.position,
            axis: scale(sign, mat_vec(first.rotation, a)),
            turn: [0, 1, 2].map(|k| [x[k], b[k], z[k]]),
            damping: [first.damping, second.damping],
            reach: limits.fold(f64::INFINITY, |least, l| least.min(l.upper).min(-l.lower)),
        })
    }

    /// c in the world: about this direction the joint holds the drone to its carrier.
    pub fn held(&self, poses: &[FrameKinematics<f64>]) -> Vec3<f64> {
        let a = mat_vec(poses[self.carrier].rotation, self.axis);
        let y = mat_vec(poses[self.body].rotation, [0, 1, 2].map(|k| self.turn[k][1]));
        cross(a, y)
    }
}

/// The attitude whose z is along `force` and whose y is square to `axis`: [x y z] of the [module](self), undefined where
/// the two are parallel.
fn attitude_across<S: Scalar>(force: Vec3<S>, axis: Vec3<S>) -> Mat3<S> {
    let z = safe::normalise(force);
    let y = safe::normalise(cross(z, axis));
    let x = cross(y, z);
    [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]]
}

/// A vector that follows another: value, rate, acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Filter {
    value: Vec3<f64>,
    rate: Vec3<f64>,
}

impl Filter {
    /// One step of `h` seconds towards `wanted`; the acceleration at its end.
    fn step(&mut self, wanted: Vec3<f64>, pace: f64, h: f64) -> Vec3<f64> {
        let fade = (-pace * h).exp();
        let mut acceleration = [0.0; 3];
        for i in 0..3 {
            let (e, v) = (self.value[i] - wanted[i], self.rate[i]);
            let drift = v + pace * e;
            self.value[i] = wanted[i] + (e + drift * h) * fade;
            self.rate[i] = (v - pace * drift * h) * fade;
            acceleration[i] = pace * (pace * (wanted[i] - self.value[i]) - 2.0 * self.rate[i]);
        }
        acceleration
    }
}

/// A drone on its [`Mount`], with its own attitude and rate levels.
#[derive(Debug, Clone)]
pub struct Gimballed {
    /// Where it sits.
    pub mount: Mount,
    /// What its cascade believes to fly.
    pub vehicle: Vehicle,
    /// Of roll and pitch, the slower, rad/s: √(K_R/J).
    pub bandwidth: f64,
    /// Σ T_max, N.
    pub max_thrust: f64,
    cascade: Cascade,
    actions: Vec<usize>,
    inverse_inertia: Mat3<f64>,
    dt: f64,
    filter: Option<Filter>,
    reaction: Vec3<f64>,
}

impl Gimballed {
    /// The drone of a mount with the attitude and rate gains given, else those derived from the drone; yaw is left out.
    ///
    /// # Errors
    /// As [`Cascade::new`]; [`Error::Value`] for a drone that leans in hover.
    pub fn new(system: &Multibody, mount: Mount, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        let vehicle = carrier(system.model(), mount.drone)?;
        let mut gains = gains.copied().unwrap_or_else(|| vehicle.derived_gains());
        let inertia = vehicle.mass_properties().inertia;
        let bandwidth = [0, 1].map(|k| (gains.attitude[k] / inertia[(k, k)]).sqrt());
        let damping = mount.damping[0].min(mount.damping[1]);
        for k in 0..2 {
            gains.rate[k] = (gains.rate[k] - damping).max(LEAST_RATE_GAIN * gains.rate[k]);
        }
        let dt = system.physics().dt;
        let mut cascade = Cascade::new(&vehicle, &gains, rates, dt)?;
        cascade.model.axes.refuse(&vehicle)?;
        (cascade.model.gains.attitude[2], cascade.model.gains.rate[2]) = (0.0, 0.0);
        cascade.reset();
        Ok(Self {
            actions: system.model().drones()[mount.drone]
                .rotors
                .iter()
                .map(|r| system.layout().rotor_action[*r])
                .collect(),
            bandwidth: bandwidth[0].min(bandwidth[1]),
            max_thrust: vehicle.rotors.iter().map(|r| r.max_thrust() * r.axis[2]).sum(),
            inverse_inertia: inverse(cascade.model.body.inertia),
            mount,
            vehicle,
            cascade,
            dt,
            filter: None,
            reaction: [0.0; 3],
        })
    }

    /// Moment (world, N m) that the joint's damping puts on the carrier while the drone turns as last commanded.
    pub fn reaction(&self) -> Vec3<f64> {
        self.reaction
    }

    /// The thrust coefficient κ of its yaw: N m per newton moved between rotors of either spin.
    pub fn yaw_per_thrust(&self) -> f64 {
        let n = self.vehicle.rotors.len().max(1) as f64;
        self.vehicle.rotors.iter().map(|r| r.moment_per_thrust.abs()).sum::<f64>() / n
    }

    /// By how much the direction of its force is late, s: the filter's delay 2/ω_f.
    pub fn delay(&self) -> f64 {
        2.0 / (FILTER * self.bandwidth)
    }

    /// Linear drag in its own axes while it lifts `mass`, N s/m.
    pub fn drag_at(&self, mass: f64) -> Vec3<f64> {
        let mut loaded = self.vehicle.clone();
        loaded.parts.iter_mut().for_each(|p| p.mass *= mass / self.cascade.model.body.mass);
        BodyModel::of(&loaded).drag
    }

    /// One step: rotor actions for the force (world, N) and the moment about the drone's z (N m) that reach the carrier.
    pub fn push(&mut self, poses: &[FrameKinematics<f64>], force: Vec3<f64>, yaw_moment: f64, input: &mut [f64]) {
        let (own, base) = (&poses[self.mount.body], &poses[self.mount.carrier]);
        let up = [own.rotation[0][2], own.rotation[1][2], own.rotation[2][2]];
        let thrust = dot(force, up).clamp(MIN_THRUST_SHARE * self.max_thrust, MAX_THRUST_SHARE * self.max_thrust);
        let filter = self.filter.get_or_insert(Filter { value: force, rate: [0.0; 3] });
        let acceleration = filter.step(force, FILTER * self.bandwidth, self.dt);
        let series = [0, 1, 2].map(|i| Jet::from_derivatives([filter.value[i], filter.rate[i], acceleration[i]]));
        // the carrier's axis as it turns: its angular acceleration is not known
        let (a, w) = (mat_vec(base.rotation, self.mount.axis), base.angular_velocity);
        let turning = [a, cross(w, a), cross(w, cross(w, a))];
        let axis = [0, 1, 2].map(|i| Jet::from_derivatives([turning[0][i], turning[1][i], turning[2][i]]));
        let joint = Orientation::of_series(attitude_across(series, axis)).with_thrust(thrust);
        let mut command = self.in_drone(&joint);
        let damped = self.damped(&joint, a, w);
        let moment = mat_vec(transpose(command.attitude), damped);
        self.reaction = damped;
        let lift = mat_vec(self.inverse_inertia, [moment[0], moment[1], 0.0]);
        command.angular_acceleration = add(command.angular_acceleration, lift);
        command.angular_acceleration[2] = yaw_moment * self.inverse_inertia[2][2];
        let actions = self.cascade.attitude(&kinematics(own), &command);
        for (at, action) in self.actions.iter().zip(actions) {
            input[*at] = action;
        }
    }

    /// From the joint's axes to the drone's.
    fn in_drone(&self, joint: &AttitudeCommand<f64>) -> AttitudeCommand<f64> {
        let turn = self.mount.turn;
        AttitudeCommand {
            thrust: joint.thrust,
            attitude: mat_mul(joint.attitude, transpose(turn)),
            angular_velocity: mat_vec(turn, joint.angular_velocity),
            angular_acceleration: mat_vec(turn, joint.angular_acceleration),
        }
    }

    /// Σ dᵢ q̇ᵢ along the joint's axes, at the wanted rates, world, N m.
    fn damped(&self, joint: &AttitudeCommand<f64>, first: Vec3<f64>, carrier_rate: Vec3<f64>) -> Vec3<f64> {
        let relative = sub(mat_vec(joint.attitude, joint.angular_velocity), carrier_rate);
        let second = [0, 1, 2].map(|k| joint.attitude[k][1]);
        let [d1, d2] = self.mount.damping;
        axpy(scale(d1 * dot(relative, first), first), d2 * dot(relative, second), second)
    }
}

/// A body as a controller sees it.
pub fn kinematics(pose: &FrameKinematics<f64>) -> Kinematics<f64> {
    Kinematics {
        position: pose.position,
        velocity: pose.velocity,
        attitude: from_matrix(pose.rotation),
        angular_velocity: mat_vec(transpose(pose.rotation), pose.angular_velocity),
    }
}

/// Refuses a model that its drones cannot hold up with [`MAX_THRUST_SHARE`] of their thrust.
///
/// # Errors
/// [`Error::Value`] with weight and thrust.
pub(crate) fn liftable(model: &Model, drones: &[Gimballed]) -> Result<()> {
    let (weight, n) = (model.mass() * model.parts().gravity, drones.len() as f64);
    let least = drones.iter().fold(f64::INFINITY, |least, d| least.min(MAX_THRUST_SHARE * d.max_thrust));
    if weight < n * least {
        return Ok(());
    }
    let what = format!("model '{}': weight per drone", model.name());
    let limit = format!("below {least:.2} N, {} % of its thrust", 100.0 * MAX_THRUST_SHARE);
    Err(Error::value(what, format!("{:.2} N", weight / n), limit, "Lighten the load or add drones."))
}

/// All drones of a model on their mounts.
///
/// # Errors
/// [`Error::Value`] that names a drone on no such joint.
pub(crate) fn mounts(model: &Model) -> Result<Vec<Mount>> {
    let mount = |number: usize| {
        Mount::of(model, number).ok_or_else(|| {
            Error::value(
                format!("model '{}': joint of drone '{}'", model.name(), model.drones()[number].name),
                "of another kind",
                "a passive universal joint across its thrust",
                "Fly it with a Formation.",
            )
        })
    };
    (0..model.drones().len()).map(mount).collect()
}
