//! A drone that balances a load on a bar above it: linear state feedback around its velocity level.
//!
//! With the load's lean r (its horizontal offset from the drone), the bar's length l and the drone's acceleration a:
//! r̈ = (g/l) r − a. All four poles of each axis are placed at −p by a = k₁ e + k₂ ė + k₃ ρ + k₄ ρ̇ + a_ref, where e is
//! the drone's offset from the reference and ρ = r − (l/g)(a_ref + (l/g) s_ref) the lean that is not wanted (s_ref the snap):
//!
//! ```text
//! k₁ = p⁴ l/g,   k₂ = 4 p³ l/g,   k₃ = 6 p² + k₁ + g/l,   k₄ = 4 p + k₂
//! ```
//!
//! The bar pushes back with m g r/l, which is fed forward.

use super::cascade::{Cascade, Rates};
use super::formation::{carrier, root};
use super::kinematics::Kinematics;
use super::pilot::{Command, Pilot};
use super::velocity::VelocityCommand;
use crate::dynamics::Gains;
use crate::dynamics::spatial::{add, cross, mat_vec, sub, up_axis};
use crate::dynamics::tree::{Body, Model, Motion, Multibody, body_poses};
use crate::error::{Error, Result};

/// p, 1/s: slower than the attitude loop that carries it out.
const POLE: f64 = 2.4;

/// State feedback of one drone with one load above it.
#[derive(Debug, Clone)]
pub struct Balance {
    system: Multibody,
    cascade: Cascade,
    actions: Vec<usize>,
    load: usize,
    /// k₁ to k₄.
    feedback: [f64; 4],
    length: f64,
    gravity: f64,
    /// Of the load over the whole.
    share: f64,
}

impl Balance {
    /// For a model with one drone and a load above it. Without `gains`, those derived from the drone.
    ///
    /// # Errors
    /// [`Error::Value`] for another model, or rates that do not divide 1/dt.
    pub fn new(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        let model = system.model();
        let Some((load, length)) = balanced(model) else {
            let what = format!("model '{}'", model.name());
            return Err(Error::value(what, "without it", "one drone with one load above it", "Use a Formation."));
        };
        let vehicle = carrier(model, 0)?;
        let gains = gains.copied().unwrap_or_else(|| vehicle.derived_gains());
        let mut cascade = Cascade::new(&vehicle, &gains, rates, system.physics().dt)?;
        cascade.model.body.mass = model.mass();
        cascade.reset();
        let gravity = model.parts().gravity;
        let (p, rate) = (POLE, gravity / length);
        let (k1, k2) = (p.powi(4) / rate, 4.0 * p.powi(3) / rate);
        Ok(Self {
            actions: model.drones()[0].rotors.iter().map(|r| system.layout().rotor_action[*r]).collect(),
            feedback: [k1, k2, 6.0 * p * p + k1 + rate, 4.0 * p + k2],
            share: model.bodies()[load].mass / model.mass(),
            system: system.clone(),
            cascade,
            load,
            length,
            gravity,
        })
    }
}

/// The body that stands on a universal joint above the one drone, and how far its centre of mass is from the joint, m.
pub fn balanced(model: &Model) -> Option<(usize, f64)> {
    let ([_, cross, load], [drone]) = (model.bodies(), model.drones()) else { return None };
    let hinge = |body: &Body| matches!(body.joint.motion, Motion::Revolute(_));
    let universal =
        cross.parent == Some(0) && load.parent == Some(1) && cross.mass == 0.0 && hinge(cross) && hinge(load);
    let height = load.center_of_mass[2];
    (drone.body == 0 && universal && height > 0.0).then_some((2, height))
}

impl Pilot for Balance {
    fn name(&self) -> &'static str {
        "balance"
    }

    fn description(&self) -> String {
        format!("linear feedback of the load's lean, four poles at -{POLE} 1/s per axis")
    }

    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        root(&self.system, state)
    }

    fn command(&mut self, moment: Command<'_>, input: &mut [f64]) {
        let (own, poses) = (self.tracked(moment.state), body_poses(&self.system, moment.state));
        let (pose, center) = (&poses[self.load], self.system.model().bodies()[self.load].center_of_mass);
        let lever = mat_vec(pose.rotation, center);
        let drift = cross(pose.angular_velocity, lever);
        let lean = sub(add(pose.position, lever), own.position);
        let leaning = sub(add(pose.velocity, drift), own.velocity);
        let wanted = moment.reference.sample(moment.time);
        let ([k1, k2, k3, k4], per) = (self.feedback, self.length / self.gravity);
        let up = up_axis(own.attitude);
        let mut command = VelocityCommand::constant(own.velocity, wanted.yaw);
        for i in 0..2 {
            let unwanted = lean[i] - per * (wanted.acceleration[i] + per * wanted.snap[i]);
            let drifting = leaning[i] - per * wanted.jerk[i];
            let a = wanted.acceleration[i]
                + k1 * (own.position[i] - wanted.position[i])
                + k2 * (own.velocity[i] - wanted.velocity[i])
                + k3 * unwanted
                + k4 * drifting;
            // its derivative, from the acceleration that the attitude gives now: the attitude then lags less
            let push = self.gravity * up[i] / up[2].max(0.3);
            let excess = (push - self.share * lean[i] / per) / (1.0 - self.share) - wanted.acceleration[i];
            let change = wanted.jerk[i]
                + k1 * (own.velocity[i] - wanted.velocity[i])
                + k2 * excess
                + k3 * drifting
                + k4 * (unwanted / per - excess);
            command.acceleration[i] = (1.0 - self.share) * a + self.share * lean[i] / per;
            command.jerk[i] = (1.0 - self.share) * change + self.share * leaning[i] / per;
        }
        let gains = &self.cascade.model.gains;
        command.acceleration[2] = wanted.acceleration[2]
            + gains.position[2] * (wanted.position[2] - own.position[2])
            + gains.velocity[2] * (wanted.velocity[2] - own.velocity[2]);
        let actions = self.cascade.velocity(&own, &command);
        for (at, action) in self.actions.iter().zip(actions) {
            input[*at] = action;
        }
    }
}
