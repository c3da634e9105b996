//! The state of a drone whose load follows a path, and the force that keeps it there: both are functions of the path.
//!
//! For one drone with one load on a universal joint at its origin, of masses m and m_q and lever l
//! ([`Carried`]):
//!
//! ```text
//! n = (q̈ + g e_z)/‖·‖      p = q + l n      F = m (p̈ + g e_z) + m_q (q̈ + g e_z)      R e_z = F/‖F‖
//! ```
//!
//! exactly, if all of the load is at its end. Attitude and its rate follow from F, Ḟ and the yaw; the joint's angles and
//! their rates from n and ṅ seen by the drone (flatness of the slung load: Sreenath, Lee and Kumar 2013).

use super::attitude::Orientation;
use super::reference::{Carried, Curve};
use super::velocity::desired_attitude;
use autodiff::jet::Jet;
use autodiff::{Scalar, safe};
use dynamics::spatial::{Vec3, from_matrix, mat_vec, transpose};
use dynamics::tree::{Model, Motion, Multibody};

/// Masses of a drone and its load, kg.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadFlatness {
    drone: f64,
    load: f64,
    gravity: f64,
    /// Σ T_max, N.
    lift: f64,
}

/// Specific force of the whole, F/(m + m_q), with its first two derivatives, world, m/s².
type Push = [Vec3<f64>; 3];

impl LoadFlatness {
    /// For a model of a drone, a massless body on a hinge along its x, and the load on a hinge along that one's y, both at the
    /// drone's origin.
    pub fn of(model: &Model) -> Option<Self> {
        let ([root, cross, load], [drone]) = (model.bodies(), model.drones()) else { return None };
        let hinge = |joint: &dynamics::tree::Joint, axis: Vec3<f64>| {
            let straight = joint.rotation == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            joint.motion == Motion::Revolute(axis) && straight && joint.position == [0.0; 3]
        };
        let universal = hinge(&cross.joint, [1.0, 0.0, 0.0]) && hinge(&load.joint, [0.0, 1.0, 0.0]);
        let chain = cross.parent == Some(0) && load.parent == Some(1) && cross.mass == 0.0;
        (drone.body == 0 && chain && universal).then(|| Self {
            drone: root.mass,
            load: load.mass,
            gravity: model.parts().gravity,
            lift: model.rotors().iter().map(|r| r.rotor.max_thrust()).sum(),
        })
    }

    /// F/(m + m_q) and its derivatives at time t, s.
    pub fn push(&self, way: &Carried, t: f64) -> Push {
        let (drone, load) = (way.drone(t), way.load(t));
        let share = self.drone / (self.drone + self.load);
        let mean = |a: Vec3<f64>, b: Vec3<f64>| [0, 1, 2].map(|i| share * a[i] + (1.0 - share) * b[i]);
        let mut force = mean(drone.acceleration, load.acceleration);
        force[2] += self.gravity;
        [force, mean(drone.jerk, load.jerk), mean(drone.snap, load.snap)]
    }

    /// The whole state at time t, s, in the layout of `system`.
    pub fn state(&self, system: &Multibody, way: &Carried, t: f64) -> Vec<f64> {
        let (layout, model) = (system.layout(), system.model());
        let mut state = system.rest_state();
        let drone = way.drone(t);
        let push = self.push(way, t);
        let series = [0, 1, 2].map(|i| Jet::<f64, 3>::from_derivatives([push[0][i], push[1][i], push[2][i]]));
        let time = Jet::<f64, 3>::variable(t);
        let attitude = desired_attitude(series, way.yaw(time));
        let turn = Orientation::of_series(attitude);
        // the bar in the drone's axes is Rx(α) Ry(β) e_z
        let [x, y, z] = mat_vec(transpose(attitude), way.bar(time));
        let angles = [safe::atan2(-y, z), safe::atan2(x, (y * y + z * z).sqrt())];
        let root = layout.bodies[0].position;
        state[root..root + 3].copy_from_slice(&drone.position);
        state[root + 3..root + 6].copy_from_slice(&drone.velocity);
        state[root + 6..root + 10].copy_from_slice(&from_matrix(turn.attitude));
        state[root + 10..root + 13].copy_from_slice(&turn.angular_velocity);
        for (place, angle) in layout.bodies[1..].iter().zip(angles) {
            (state[place.position], state[place.velocity]) = (angle.value(), angle.derivative(1));
        }
        let share = (self.drone + self.load) * safe::norm(push[0]) / self.lift;
        for (rotor, at) in model.rotors().iter().zip(&layout.rotor_speed) {
            state[*at] = rotor.rotor.max_speed * share.min(1.0).sqrt();
        }
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cascade::Rates;
    use crate::controller::{Controller as _, Measurement, Target};
    use crate::reference::{Lemniscate, LoadPath, Reference};
    use crate::state_feedback::{Lqr, LqrWeights};
    use autodiff::System as _;
    use dynamics::configurations::{InvertedPendulum, Payload};
    use dynamics::{Effects, Physics};

    /// Largest distance of the load's centre from its path, m, through 8 s from the flat state on.
    fn flown(model: &Model, lever: f64) -> f64 {
        let physics = Physics { dt: 0.004, effects: Effects::lean(), ..Physics::default() };
        let system = Multibody::new(model, physics).unwrap();
        let rates = Rates::every_step(0.004);
        let mut lqr = Lqr::with_weights(&system, None, &rates, &LqrWeights::default()).unwrap();
        let path = Lemniscate { rate: 0.8, scale: [2.5, 2.5, 1.0], vertical: 0.5, ..Lemniscate::default() };
        let way = Carried { path: LoadPath::Lemniscate(path), lever };
        let reference = Reference::Carried(way.clone());
        let flat = LoadFlatness::of(model).unwrap();
        let (mut x, mut input) = (flat.state(&system, &way, 0.0), vec![0.0; system.n_input()]);
        let (mut next, mut worst) = (x.clone(), 0.0_f64);
        for k in 0..2000 {
            let time = 0.004 * k as f64;
            let poses = dynamics::tree::body_poses(&system, &x);
            let bar = [0, 1, 2].map(|i| -lever * poses[2].rotation[i][2]);
            let wanted = way.load(time).position;
            worst = worst.max(safe::norm([0, 1, 2].map(|i| x[i] + bar[i] - wanted[i])));
            lqr.tick(Measurement { time, state: &x, readings: &[] }, Target::level(&reference), &mut input);
            system.step(&x, &input, &[], &mut next);
            std::mem::swap(&mut x, &mut next);
        }
        worst
    }

    #[test]
    fn loads_that_hang_or_stand_follow_a_path_of_half_a_g() {
        let hanging = Payload::default().build().unwrap().model;
        let standing = InvertedPendulum::default().build().unwrap().model;
        let lever = |model: &Model| LoadFlatness::of(model).map(|_| -model.bodies()[2].center_of_mass[2]).unwrap();
        for (name, model) in [("payload", hanging), ("pendulum", standing)] {
            let worst = flown(&model, lever(&model));
            println!("{name}: {worst:.4} m");
            // measured 0.0216 m hanging, 0.0246 m standing
            assert!(worst < 0.1, "{name}: {worst}");
        }
    }

    #[test]
    fn the_flat_rates_are_those_of_the_flat_state() {
        let model = Payload::default().build().unwrap().model;
        let system = Multibody::new(&model, Physics::default()).unwrap();
        let way = Carried { path: LoadPath::Lemniscate(Lemniscate::default()), lever: 1.0 };
        let flat = LoadFlatness::of(&model).unwrap();
        let (h, t) = (1e-5, 2.3);
        let [a, b, c] = [t - h, t, t + h].map(|t| flat.state(&system, &way, t));
        let layout = system.layout();
        let pairs = [0, 1, 2].map(|k| (k, 3 + k));
        let hinges = [1, 2].map(|i| (layout.bodies[i].position, layout.bodies[i].velocity));
        for (place, rate) in pairs.into_iter().chain(hinges) {
            assert!(((c[place] - a[place]) / (2.0 * h) - b[rate]).abs() < 1e-7, "{place}");
        }
    }
}
