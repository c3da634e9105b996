//! What the tasks of the transport group share: the rig with a box of any mass, its reward terms.

use super::team::{apart, squared_sum, team_mass};
use crate::autodiff::{Pen, Scalar, safe};
use crate::dynamics::configurations::{Configuration, Transport, TransportMap};
use crate::dynamics::contact::distance::plane_distance;
use crate::dynamics::frame::Frame;
use crate::dynamics::shape::{Geometry, Pose};
use crate::dynamics::spatial::{Vec3, constants, sub};
use crate::dynamics::{Effects, Integrator, Physics, Vehicle};
use crate::error::{Error, Result};
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::{smooth_norm, upright};
use crate::tasks::rig::{Inertial, Rig};
use crate::tasks::sheet::Term;
use crate::tasks::task::{Start, View};

/// The box: the root of the model.
pub const BOX: usize = 0;
/// Mass of the box as a share of the drones': uniform within.
const SHARE: [f64; 2] = [0.5, 0.8];
/// sep at which r_s reaches 1, m.
pub const APART: f64 = 0.5;

/// The group, its box of the mean mass that episodes give it (its damping, 0.1 1/s of build mass, is fixed with it).
///
/// # Errors
/// [`Error::Value`] unless there are 4 or 6 drones.
pub fn group(vehicle: &Vehicle, n_drone: usize, collides: bool) -> Result<Configuration<TransportMap>> {
    let shape = match n_drone {
        4 => Transport::four(),
        6 => Transport::six(),
        n => return Err(Error::value("task.n_drone", n, "4 or 6", "The benchmark's is 4.")),
    };
    let box_mass = 0.5 * (SHARE[0] + SHARE[1]) * team_mass(vehicle, n_drone);
    Transport { drone: vehicle.clone(), box_mass, collides, ..shape }.build()
}

/// Physics of a group: wakes, and semi-implicit always. Of 64 groups under random actions for 200 steps of 16 ms, RK4 lost 122
/// episodes of 216 to divergence, 8 of 192 with four substeps; this lost none of 196. Presumably a bar across a hinge,
/// which turns about its own axis there (2e-6 kg m² against 0.011 N m s/rad); the cause was not isolated.
pub fn stiff_physics(physics: Physics) -> Physics {
    let effects = Effects { downwash: true, ..physics.effects };
    Physics { integrator: Integrator::SemiImplicit, effects, ..physics }
}

/// The rig of Hover and Track: nothing to touch.
///
/// # Errors
/// As [`group`] and [`EnvConfig::vehicle`].
pub fn free_rig(config: &EnvConfig, vehicle: &str, n_drone: usize) -> Result<(Rig, Load)> {
    let vehicle = config.vehicle(vehicle)?;
    let built = group(&vehicle, n_drone, false)?;
    let rig = Rig::of_model(&built.model, stiff_physics(config.physics()), Some(&vehicle), |_| Vec::new())?;
    Ok((rig.varying_inertial(BOX), Load::new(&vehicle, &built)))
}

/// The box and what holds it.
#[derive(Debug, Clone)]
pub struct Load {
    /// Of all drones, kg.
    team_mass: f64,
    /// Angles of all bars' joints in the state.
    angles: Vec<usize>,
    /// 1/range² of those joints, 1/rad².
    weight: f64,
    /// The box.
    shape: Geometry,
}

impl Load {
    /// Of a group that was built with this vehicle.
    pub fn new(vehicle: &Vehicle, built: &Configuration<TransportMap>) -> Self {
        let shape = built.model.shapes().iter().find(|s| s.body == Some(BOX));
        let hinges = built.map.carriers.iter().flat_map(|c| c.anchor.into_iter().chain(c.hook));
        Self {
            team_mass: team_mass(vehicle, built.map.carriers.len()),
            angles: hinges.map(|h| built.model.layout().bodies[h].position).collect(),
            weight: Transport::four().range.powi(-2),
            shape: shape.map_or(Geometry::Sphere { radius: 0.0 }, |s| s.shape.geometry),
        }
    }

    /// Draws the mass of the box; its inertia follows.
    pub fn draw_mass(&self, start: &mut Start<'_>) {
        let mass = self.team_mass * start.task.uniform(SHARE[0], SHARE[1]);
        let own = Inertial::read(start.numbers, BOX);
        own.scaled(mass / own.mass).write(start.numbers, BOX);
    }

    /// Height of its lowest corner above z = 0, m.
    #[inline(always)]
    pub fn height<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let frame = view.frame(BOX);
        plane_distance(&self.shape, &Pose { position: frame.position, attitude: frame.attitude }, S::zero())
    }

    /// r_j = 0.5 mean(1 − q̂²) over all bars' joints, q̂ = angle/range.
    #[inline(always)]
    pub fn straight<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let mut sum = S::zero();
        for i in 0..self.angles.len() {
            sum += view.state.get(self.angles[i]).square();
        }
        S::constant(0.5) - sum * S::constant(0.5 * self.weight / self.angles.len() as f64)
    }
}

/// The terms of [`steady`].
pub fn steady_terms(pose: &str, effort: f64) -> Vec<Term> {
    vec![
        Term::piecewise("pose", format!("r_s r_p, r_p = {pose}"), 1.0),
        Term::piecewise("up", "r_s r_p ((u_z + 1)/2)²", 1.0),
        Term::piecewise("spin", "0.8 r_s r_p e^{−(|ω_x| + |ω_y| + |ω_z|)²}", 0.8),
        Term::piecewise("swing", "0.8 r_s r_p e^{−(|v_x| + |v_y| + |v_z|)²}", 0.8),
        Term::piecewise("joints", "0.5 r_s mean(1 − q̂²)", 0.5),
        Term::piecewise("effort", format!("{effort} r_s · mean e^{{−e_i}}"), effort),
    ]
}

/// The reward of Hover and Track.
#[inline(always)]
pub fn steady<S: Scalar>(view: &View<'_, S>, load: &Load, pose: S, effort: f64, terms: &mut Pen<'_, S>) {
    let (frame, near) = (view.frame(BOX), apart(view, APART));
    let (posed, calm) = (near * pose, S::constant(0.8));
    terms.number(posed);
    terms.number(posed * upright(frame.up()));
    terms.number(calm * posed * (-squared_sum(frame.angular_velocity)).exp());
    terms.number(calm * posed * (-squared_sum(frame.velocity)).exp());
    terms.number(near * load.straight(view));
    terms.number(near * S::constant(effort) * view.mean_effort_reward());
}

/// A smooth cost of the box being away (`error`, m), tilted and in motion relative to `velocity`.
#[inline(always)]
pub fn load_loss<S: Scalar>(frame: &Frame<S>, error: Vec3<S>, velocity: Vec3<S>) -> S {
    let tilt = sub(constants([0.0, 0.0, 1.0]), frame.up());
    let motion = S::constant(0.02) * safe::squared_norm(sub(velocity, frame.velocity));
    let turn = S::constant(0.005) * safe::squared_norm(frame.angular_velocity);
    smooth_norm(error, 0.1) + S::constant(0.3) * safe::squared_norm(tilt) + motion + turn
}
