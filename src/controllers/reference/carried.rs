//! The way of a drone whose load follows a path.

use super::lemniscate::Lemniscate;
use super::setpoint::Setpoint;
use super::trajectory::{Curve, within};
use super::waypoints::Waypoints;
use autodiff::jet::Jet;
use autodiff::{Scalar, safe};
use base::error::Result;
use dynamics::GRAVITY;
use dynamics::spatial::{Vec3, add, axpy};
use serde::{Deserialize, Serialize};

/// p = q + l n with n = (q̈ + g e_z)/‖·‖, q the path of the load: along a massless bar of length |l| hinged at the drone, the
/// force on the load points from it to the drone (l > 0: the load hangs) or away from it (l < 0: it stands). Flatness of
/// the slung load after Sreenath, Lee and Kumar (2013).
///
/// Where q̈ jumps, as at the start of a lemniscate, p jumps too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Carried {
    /// Path of the load.
    pub path: LoadPath,
    /// l, m.
    pub lever: f64,
}

/// What a load can follow: paths with four continuous derivatives but for single moments.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum LoadPath {
    /// See [`Lemniscate`].
    Lemniscate(Lemniscate),
    /// See [`Waypoints`].
    Waypoints(Waypoints),
}

impl LoadPath {
    /// Position (world, m) and yaw (rad) at time t.
    #[inline]
    pub fn position_and_yaw<S: Scalar>(&self, t: S) -> (Vec3<S>, S) {
        match self {
            Self::Lemniscate(path) => (path.position(t), S::constant(path.yaw)),
            Self::Waypoints(path) => path.position_and_yaw(t),
        }
    }
}

impl Carried {
    /// n at time t, world: the direction of a bar that lets the load follow its path, upwards.
    pub fn bar<S: Scalar>(&self, t: S) -> Vec3<S> {
        let load = self.path.position_and_yaw(Jet::<S, 3>::variable(t)).0;
        let mut pull = [S::zero(); 3];
        for i in 0..3 {
            pull[i] = load[i].derivative(2);
        }
        safe::normalise(add(pull, [S::zero(), S::zero(), S::constant(GRAVITY)]))
    }

    /// Position, velocity, … of the drone, and its yaw, at time t, s.
    pub fn drone(&self, t: f64) -> Setpoint<f64> {
        let time = Jet::<f64, 5>::variable(t);
        Setpoint::from_series(self.position(time), self.yaw(time))
    }

    /// Position, velocity, … of the load, and its yaw, at time t, s.
    pub fn load(&self, t: f64) -> Setpoint<f64> {
        let (position, yaw) = self.path.position_and_yaw(Jet::<f64, 5>::variable(t));
        Setpoint::from_series(position, yaw)
    }
}

impl Curve for Carried {
    fn name(&self) -> &'static str {
        "carried"
    }

    fn description(&self) -> &'static str {
        "the way of a drone whose load follows a path"
    }

    fn validate(&self) -> Result<()> {
        if let LoadPath::Lemniscate(path) = &self.path {
            path.validate()?;
        }
        within("carried.lever", &[self.lever], -1e3, 1e3)
    }

    fn position<S: Scalar>(&self, t: S) -> Vec3<S> {
        let load = self.path.position_and_yaw(Jet::<S, 3>::variable(t)).0;
        let mut position = [S::zero(); 3];
        for i in 0..3 {
            position[i] = load[i].value();
        }
        axpy(position, S::constant(self.lever), self.bar(t))
    }

    #[inline]
    fn yaw<S: Scalar>(&self, t: S) -> S {
        self.path.position_and_yaw(t).1
    }
}

#[cfg(test)]
mod tests {
    use super::super::Reference;
    use super::*;

    #[test]
    fn the_load_of_the_drone_accelerates_along_its_bar() {
        let own = Carried { path: LoadPath::Lemniscate(Lemniscate::default()), lever: 0.8 };
        for t in [0.4, 1.7, 5.0] {
            let (drone, load) = (Reference::Carried(own.clone()).sample(t), own.load(t));
            let bar: Vec<f64> = (0..3).map(|i| drone.position[i] - load.position[i]).collect();
            let pull = [load.acceleration[0], load.acceleration[1], load.acceleration[2] + GRAVITY];
            let (mut cosine, mut norms) = (0.0, [0.0; 2]);
            for i in 0..3 {
                cosine += bar[i] * pull[i];
                norms = [norms[0] + bar[i] * bar[i], norms[1] + pull[i] * pull[i]];
            }
            assert!((norms[0].sqrt() - 0.8).abs() < 1e-12);
            assert!((cosine - (norms[0] * norms[1]).sqrt()).abs() < 1e-12);
        }
    }

    #[test]
    fn its_derivatives_are_those_of_differences() {
        let reference = Reference::Carried(Carried { path: LoadPath::Lemniscate(Lemniscate::default()), lever: -1.0 });
        let (h, t) = (1e-4, 2.3);
        let (a, b, c) = (reference.sample(t - h), reference.sample(t), reference.sample(t + h));
        for i in 0..3 {
            let speed = (c.position[i] - a.position[i]) / (2.0 * h);
            let jerk = (c.acceleration[i] - a.acceleration[i]) / (2.0 * h);
            assert!((speed - b.velocity[i]).abs() < 1e-6 && (jerk - b.jerk[i]).abs() < 1e-5);
        }
    }
}
