//! What the tasks of the transport group share: the robot with a box of any mass, its reward terms.

use super::team::{CROWD, LoadNames, TeamSettings, apart, crowded, squared_sum, team_mass};
use super::{PoseLoss, rate_cost, speed_cost, squared, times};
use crate::config::EnvConfig;
use crate::declare::{Loss, Writer};
use crate::reward::{pseudo_huber, smooth_norm, upright};
use crate::robot::{Inertial, Robot};
use crate::settings;
use crate::start::{Start, StartScalar};
use crate::task::View;
use autodiff::{Scalar, Trace};
use base::error::{Error, Result};
use dynamics::configurations::{Configuration, Transport, TransportMap};
use dynamics::contact::distance::plane_distance;
use dynamics::shape::{Geometry, Pose};
use dynamics::spatial::{Vec3, constants, sub};
use dynamics::{Effects, Integrator, Physics, Vehicle};

/// The box: the root of the model.
pub const BOX: usize = 0;
/// What observations call the box's attitude and motion.
pub(crate) const BOX_NAMES: LoadNames =
    ["box_attitude", "box_velocity", "box_angular_velocity", "box_heading", "box_up"];

settings! {
    /// A team and the box that it carries.
    pub struct GroupSettings {
        team: TeamSettings = TeamSettings::default() => flat;
        box_share: [f64; 2] = [0.5, 0.8]
            => ("-", "mass of the box over the drones', lowest and highest", PositiveOrdered);
        separation: f64 = 0.5 => ("m", "least distance of two drones at which r_s reaches 1", Positive);
    }
}

settings! {
    /// Weights of the terms that all rewards of the group have.
    pub struct CarryReward {
        pose: f64 = 1.0 => ("-", "weight of the term pose", NotNegative);
        up: f64 = 1.0 => ("-", "weight of the term up", NotNegative);
        joints: f64 = 0.5 => ("-", "weight of the term joints", NotNegative);
        effort: f64 = 0.2 => ("-", "weight of the term effort", NotNegative);
    }
}

settings! {
    /// Weights of the rewards of Hover and Track.
    pub struct SteadyReward {
        carry: CarryReward = CarryReward::default() => flat;
        spin: f64 = 0.8 => ("-", "weight of the term spin", NotNegative);
        swing: f64 = 0.8 => ("-", "weight of the term swing", NotNegative);
    }
}

settings! {
    /// How training losses weigh the pose of the box, and what carries it.
    pub struct GroupLoss {
        pose: PoseLoss = PoseLoss::default() => flat;
        drone_rate: f64 = 0.005
            => ("m s²/rad²", "weight of the drones' angular velocities in the loss, their mean", NotNegative);
        joints: f64 = 0.2 => ("m", "weight of the angles of the bars' joints in the loss", NotNegative);
        crowd: f64 = 1.0 => ("m", "weight of drones too close to each other in the loss", NotNegative);
        separation: f64 = 0.8 => ("m", "least distance of two drones that costs nothing in the loss", Positive);
    }
}

/// The group, its box of the mean mass that episodes give it (its damping, 0.1 1/s of build mass, is fixed with it).
///
/// # Errors
/// [`Error::Value`] unless there are 4 or 6 drones.
pub fn group(vehicle: &Vehicle, own: &GroupSettings, collides: bool) -> Result<Configuration<TransportMap>> {
    let shape = match own.team.n_drone {
        4 => Transport::four(),
        6 => Transport::six(),
        n => return Err(Error::value("task.n_drone", n, "4 or 6", "The benchmark's is 4.")),
    };
    let box_mass = 0.5 * (own.box_share[0] + own.box_share[1]) * team_mass(vehicle, own.team.n_drone);
    Transport { drone: vehicle.clone(), box_mass, collides, ..shape }.build()
}

/// Physics of a group: wakes, and semi-implicit always. Of 64 groups under random actions for 200 steps of 16 ms, RK4 lost 122
/// episodes of 216 to divergence, 8 of 192 with four substeps; this lost none of 196. Presumably a bar across a hinge,
/// which turns about its own axis there (2e-6 kg m² against 0.011 N m s/rad); the cause was not isolated.
pub(crate) fn stiff_physics(physics: Physics) -> Physics {
    let effects = Effects { downwash: true, ..physics.effects };
    Physics { integrator: Integrator::SemiImplicit, effects, ..physics }
}

/// The robot of Hover and Track: nothing to touch.
///
/// # Errors
/// As [`group`] and [`EnvConfig::vehicle`].
pub(crate) fn free_robot(config: &EnvConfig, own: &GroupSettings) -> Result<(Robot, Load)> {
    let vehicle = config.vehicle(&own.team.vehicle)?;
    let built = group(&vehicle, own, false)?;
    let robot = Robot::of_model(&built.model, stiff_physics(config.physics()), Some(&vehicle), |_| Vec::new())?;
    Ok((robot.varying_inertial(BOX), Load::new(&vehicle, own, &built)))
}

/// The box and what holds it.
#[derive(Debug, Clone)]
pub struct Load {
    /// Of all drones, kg.
    team_mass: f64,
    /// Mass of the box over that, lowest and highest.
    share: [f64; 2],
    /// sep at which r_s reaches 1, m.
    separation: f64,
    /// Angles of all bars' joints in the state.
    angles: Vec<usize>,
    /// 1/range² of those joints, 1/rad².
    weight: f64,
    /// The box.
    shape: Geometry,
}

impl Load {
    /// Of a group that was built with this vehicle.
    pub fn new(vehicle: &Vehicle, own: &GroupSettings, built: &Configuration<TransportMap>) -> Self {
        let shape = built.model.shapes().iter().find(|s| s.body == Some(BOX));
        let hinges = built.map.carriers.iter().flat_map(|c| c.anchor.into_iter().chain(c.hook));
        Self {
            team_mass: team_mass(vehicle, built.map.carriers.len()),
            share: own.box_share,
            separation: own.separation,
            angles: hinges.map(|h| built.model.layout().bodies[h].position).collect(),
            weight: Transport::four().range.powi(-2),
            shape: shape.map_or(Geometry::Sphere { radius: 0.0 }, |s| s.shape.geometry),
        }
    }

    /// Draws the mass of the box; its inertia follows.
    pub fn draw_mass<S: StartScalar>(&self, start: &mut Start<'_, S>) {
        let mass = start.task.uniform(self.share[0], self.share[1]) * S::from(self.team_mass);
        let own = Inertial::read(start.numbers, BOX);
        own.scaled(mass / own.mass).write(start.numbers, BOX);
    }

    /// Height of its lowest corner above z = 0, m.
    pub fn height<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let frame = view.frame(BOX);
        plane_distance(&self.shape, &Pose { position: frame.position, attitude: frame.attitude }, S::zero())
    }

    /// r_j = w mean(1 − min(q̂², 1)) over all bars' joints, q̂ = angle/range.
    pub fn straight<S: Scalar>(&self, weight: f64, view: &View<'_, S>) -> S {
        let mut sum = S::zero();
        for i in 0..self.angles.len() {
            sum += (view.state[self.angles[i]].square() * S::constant(self.weight)).min(S::one());
        }
        S::constant(weight) - sum * S::constant(weight / self.angles.len() as f64)
    }

    /// w mean h₁(q̂) over all bars' joints.
    pub fn askew<S: Scalar>(&self, weight: f64, view: &View<'_, S>) -> S {
        let (n, scale) = (self.angles.len(), S::constant(self.weight.sqrt()));
        let mut sum = S::zero();
        for i in 0..n {
            sum += pseudo_huber([view.state[self.angles[i]] * scale], 1.0);
        }
        times(weight / n as f64, sum)
    }

    /// r_s = min((sep/`separation`)², 1).
    pub fn apart<S: Scalar>(&self, view: &View<'_, S>) -> S {
        apart(view, self.separation)
    }

    /// The terms joints and effort.
    pub fn ease(&self, view: &View, near: Trace, w: &CarryReward, terms: &mut Writer) {
        terms.term("joints", "{×reward_joints}r_s mean(1 − min(q̂², 1))", w.joints).piecewise();
        terms.number(near * self.straight(w.joints, view));
        terms.term("effort", "{×reward_effort}r_s · mean e^{−e_i}", w.effort).piecewise();
        terms.number(near * Trace::constant(w.effort) * view.mean_effort_reward());
    }
}

/// The reward of Hover and Track, with the term of the pose r_p open.
pub fn steady(view: &View, load: &Load, pose: Trace, w: &SteadyReward, terms: &mut Writer) {
    let (frame, near) = (view.frame(BOX), load.apart(view));
    let posed = near * pose;
    terms.piecewise().number(times(w.carry.pose, posed));
    terms.term("up", "{×reward_up}r_s r_p ((u_z + 1)/2)²", w.carry.up).piecewise();
    terms.number(times(w.carry.up, posed) * upright(frame.up()));
    terms.term("spin", "{×reward_spin}r_s r_p e^{−(|ω_x| + |ω_y| + |ω_z|)²}", w.spin).piecewise();
    terms.number(times(w.spin, posed) * (-squared_sum(frame.angular_velocity)).exp());
    terms.term("swing", "{×reward_swing}r_s r_p e^{−(|v_x| + |v_y| + |v_z|)²}", w.swing).piecewise();
    terms.number(times(w.swing, posed) * (-squared_sum(frame.velocity)).exp());
    load.ease(view, near, &w.carry, terms);
}

/// A smooth cost of the box being away (`error`, m), tilted and in motion relative to a `velocity`, with its formula; and of
/// drones that turn, bars that hang askew and drones that crowd.
pub(crate) fn group_loss(
    (view, load): (&View, &Load),
    (distance, error): (&'static str, Vec3<Trace>),
    (motion, velocity): (&'static str, Vec3<Trace>),
    own: &GroupLoss,
    loss: &mut Loss,
) {
    let (frame, w, n) = (view.frame(BOX), &own.pose, view.robot.drones().len());
    loss.add(distance, smooth_norm(error, w.motion.radius));
    loss.add("{×loss_turn}‖e_z − u‖²", squared(w.turn, sub(constants([0.0, 0.0, 1.0]), frame.up())));
    loss.add(motion, speed_cost(w.motion.velocity, sub(velocity, frame.velocity)));
    loss.add("{×loss_rate}h₁₀(ω)", rate_cost(w.motion.rate, frame.angular_velocity));
    let mut turning = Trace::zero();
    for i in 0..n {
        turning += rate_cost(own.drone_rate / n as f64, view.drone(i).angular_velocity);
    }
    loss.add("{×loss_drone_rate}mean h₁₀(ω_i)", turning);
    loss.add("{×loss_joints}mean h₁(q̂)", load.askew(own.joints, view));
    loss.add(CROWD, crowded(own.crowd, view, own.separation));
}

/// Distance of a box from its target, and its motion.
pub(crate) const TO_TARGET: [&str; 2] = ["√(‖p_t − p‖² + {loss_radius}²)", "{×loss_velocity}h₅(v)"];
