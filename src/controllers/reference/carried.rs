//! The way of a drone whose load follows a path.

use super::lemniscate::Lemniscate;
use crate::autodiff::jet::Jet;
use crate::autodiff::{Scalar, safe};
use crate::dynamics::GRAVITY;
use crate::dynamics::spatial::{Vec3, add, axpy};
use crate::error::Result;
use serde::{Deserialize, Serialize};

/// p = q + l n with n = (q̈ + g e_z)/‖·‖, q the path of the load: along a massless bar of length |l| hinged at the drone, the
/// force on the load points from it to the drone (l > 0: the load hangs) or away from it (l < 0: it stands). Flatness of
/// the slung load after Sreenath, Lee and Kumar (2013).
///
/// Where q̈ jumps, as at the start of a lemniscate, p jumps too.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Carried {
    /// Path of the load.
    pub path: Lemniscate,
    /// l, m.
    pub lever: f64,
}

impl Carried {
    pub(super) fn validate(&self) -> Result<()> {
        self.path.validate()?;
        super::within("carried.lever", &[self.lever], -1e3, 1e3)
    }

    #[inline(always)]
    pub(super) fn position<S: Scalar>(&self, t: S) -> Vec3<S> {
        let load = self.path.position(Jet::<S, 3>::variable(t));
        let (mut position, mut pull) = ([S::zero(); 3], [S::zero(); 3]);
        for i in 0..3 {
            position[i] = load[i].value();
            pull[i] = load[i].derivative(2);
        }
        let pull = add(pull, [S::zero(), S::zero(), S::constant(GRAVITY)]);
        axpy(position, S::constant(self.lever), safe::normalise(pull))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Reference;
    use super::*;

    #[test]
    fn the_load_of_the_drone_accelerates_along_its_bar() {
        let own = Carried { path: Lemniscate::default(), lever: 0.8 };
        for t in [0.4, 1.7, 5.0] {
            let (drone, load) = (Reference::Carried(own).sample(t), Reference::Lemniscate(own.path).sample(t));
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
        let reference = Reference::Carried(Carried { path: Lemniscate::default(), lever: -1.0 });
        let (h, t) = (1e-4, 2.3);
        let (a, b, c) = (reference.sample(t - h), reference.sample(t), reference.sample(t + h));
        for i in 0..3 {
            let speed = (c.position[i] - a.position[i]) / (2.0 * h);
            let jerk = (c.acceleration[i] - a.acceleration[i]) / (2.0 * h);
            assert!((speed - b.velocity[i]).abs() < 1e-6 && (jerk - b.jerk[i]).abs() < 1e-5);
        }
    }
}
