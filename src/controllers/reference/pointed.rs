//! A path along which an axis points at a place.

use super::lemniscate::Lemniscate;
use super::trajectory::{Curve, coordinates, within};
use autodiff::{Scalar, safe};
use base::error::Result;
use dynamics::spatial::{Vec3, constants, sub};
use serde::{Deserialize, Serialize};

/// The path with roll and pitch beside it, for what holds them apart from its force: body z along u = (a − p)/‖a − p‖.
///
/// ```text
/// (x, y, z) = Rz(ψ)ᵀ u     z' = max(z, √(x² + y²)/tan most)     roll = −s atan2(y, √(x² + z'²))     pitch = s atan2(x, z')
/// s = k³(6k² − 15k + 10), k = t/ramp within [0, 1]
/// ```
///
/// Level at t = 0, and turned with two continuous derivatives. An axis that would leave the vertical by more than `most` leans by
/// `most` towards a; where that begins its rate jumps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pointed {
    /// The way p of the origin, with the yaw ψ.
    pub path: Lemniscate,
    /// a, m, world.
    pub place: [f64; 3],
    /// Until the axis points at it, s, ≥ 1e-3.
    pub ramp: f64,
    /// Most between axis and vertical, rad, within [1e-3, 1.5].
    pub most: f64,
}

impl Curve for Pointed {
    fn name(&self) -> &'static str {
        "pointed"
    }

    fn description(&self) -> &'static str {
        "a lemniscate along which an axis points at a place"
    }

    fn validate(&self) -> Result<()> {
        self.path.validate()?;
        coordinates("pointed.place", &self.place)?;
        within("pointed.ramp", &[self.ramp], 1e-3, 1e6)?;
        within("pointed.most", &[self.most], 1e-3, 1.5)
    }

    fn position<S: Scalar>(&self, t: S) -> Vec3<S> {
        self.path.position(t)
    }

    fn yaw<S: Scalar>(&self, t: S) -> S {
        self.path.yaw(t)
    }

    fn angles<S: Scalar>(&self, t: S) -> [S; 2] {
        let up = safe::normalise(sub(constants(self.place), self.position(t)));
        let (s, c) = self.yaw(t).sin_cos();
        let (x, y) = (c * up[0] + s * up[1], c * up[1] - s * up[0]);
        let z = up[2].max(safe::norm([x, y]) * S::constant(self.most.tan().recip()));
        let k = (t * S::constant(1.0 / self.ramp)).clamp(S::zero(), S::one());
        let inner = k.mul_add(S::constant(6.0), S::constant(-15.0)).mul_add(k, S::constant(10.0));
        let share = k * k * k * inner;
        [-(share * y.atan2(safe::norm([x, z]))), share * safe::atan2(x, z)]
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Reference, Tilt};
    use super::*;
    use crate::attitude::Orientation;
    use dynamics::spatial::{dot, mat_mul, transpose};

    const OWN: Pointed = Pointed {
        path: Lemniscate {
            rate: -0.9,
            scale: [2.6, 3.1, 1.3],
            vertical: 0.4,
            rotation: 0.7,
            origin: [0.0, 0.0, 2.0],
            yaw: 1.2,
            ahead: 0.0,
        },
        place: [0.8, -1.1, 4.7],
        ramp: 2.0,
        most: 1.5,
    };

    fn orientation(own: Pointed, t: f64) -> Orientation<f64> {
        Tilt::LEVEL.orientation(&Reference::Pointed(own), t)
    }

    fn axis(own: Pointed, t: f64) -> Vec3<f64> {
        orientation(own, t).attitude.map(|row| row[2])
    }

    #[test]
    fn its_axis_points_at_the_place_once_it_is_turned_and_is_level_at_the_start() {
        for t in [2.0, 3.7, 9.1] {
            let up = safe::normalise(sub(OWN.place, Reference::Pointed(OWN).sample(t).position));
            assert!((dot(axis(OWN, t), up) - 1.0).abs() < 1e-14, "{t}");
        }
        let start = orientation(OWN, 0.0);
        assert!((start.attitude[2][2] - 1.0).abs() < 1e-15 && start.angular_velocity == [0.0; 3]);
    }

    #[test]
    fn an_axis_that_would_lean_too_far_leans_as_far_as_it_may_towards_the_place() {
        let low = Pointed { place: [5.0, 4.0, 1.0], most: 0.8, ..OWN };
        for t in [2.5, 6.0] {
            let (up, to) = (axis(low, t), sub(low.place, Reference::Pointed(low).sample(t).position));
            assert!((up[2] - 0.8_f64.cos()).abs() < 1e-14, "{up:?}");
            assert!((up[0] * to[1] - up[1] * to[0]).abs() < 1e-13 && up[0] * to[0] + up[1] * to[1] > 0.0);
        }
    }

    #[test]
    fn its_rates_are_those_of_differences() {
        let h = 1e-4;
        for t in [0.6, 1.3, 5.2] {
            let [a, b, c] = [t - h, t, t + h].map(|t| orientation(OWN, t));
            let slope = |i: usize, j: usize| (c.attitude[i][j] - a.attitude[i][j]) / (2.0 * h);
            let turn = mat_mul(transpose(b.attitude), std::array::from_fn(|i| std::array::from_fn(|j| slope(i, j))));
            for (k, rate) in [turn[2][1], turn[0][2], turn[1][0]].into_iter().enumerate() {
                let change = (c.angular_velocity[k] - a.angular_velocity[k]) / (2.0 * h);
                assert!((rate - b.angular_velocity[k]).abs() < 1e-7, "{t}: {rate}");
                assert!((change - b.angular_acceleration[k]).abs() < 1e-6, "{t}: {change}");
            }
        }
    }

    #[test]
    fn numbers_beyond_their_ranges_are_named() {
        for (own, word) in [
            (Pointed { ramp: 0.0, ..OWN }, "ramp"),
            (Pointed { most: 1.6, ..OWN }, "most"),
            (Pointed { place: [f64::NAN; 3], ..OWN }, "place"),
        ] {
            assert!(Reference::Pointed(own).validate().unwrap_err().to_string().contains(word));
        }
    }
}
