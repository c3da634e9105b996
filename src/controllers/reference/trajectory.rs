//! What a reference is: samples over time, best written as a curve over any scalar.

use super::setpoint::Setpoint;
use autodiff::jet::Jet;
use autodiff::{Recording, Scalar, Trace};
use base::error::{Error, Result, finite};
use dynamics::spatial::Vec3;
use std::sync::Arc;

/// Position (world, m) and yaw (rad) as Taylor series in time.
pub type Series = (Vec3<Jet<f64, 5>>, Jet<f64, 5>);

/// Where to be and when, written once over any scalar: its derivatives up to snap come by themselves.
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::autodiff::Scalar;
/// use omnidrones::controllers::reference::{Curve, Reference};
///
/// struct Bounce;
/// impl Curve for Bounce {
///     fn position<S: Scalar>(&self, t: S) -> [S; 3] {
///         [S::zero(), S::zero(), S::constant(2.0) + S::constant(0.5) * t.sin_cos().0]
///     }
/// }
/// let reference = Reference::own(Bounce);
/// assert_eq!(reference.sample(0.0).velocity, [0.0, 0.0, 0.5]);
/// ```
pub trait Curve: Send + Sync {
    /// One word.
    fn name(&self) -> &'static str {
        "own"
    }
    /// One line for a list of shapes.
    fn description(&self) -> &'static str {
        ""
    }
    /// Position at time t (s), world, m.
    fn position<S: Scalar>(&self, t: S) -> Vec3<S>;
    /// Yaw at time t (s), rad, continuous (not wrapped); by default 0.
    fn yaw<S: Scalar>(&self, _t: S) -> S {
        S::zero()
    }
    /// Roll and pitch at time t (s), rad, for what holds them apart from its force; by default level.
    fn angles<S: Scalar>(&self, _t: S) -> [S; 2] {
        [S::zero(); 2]
    }
    /// When the motion is over, s; `None` without an end.
    fn duration(&self) -> Option<f64> {
        None
    }
    /// Checks every number.
    ///
    /// # Errors
    /// One that names the number.
    fn validate(&self) -> Result<()> {
        Ok(())
    }
}

/// Where to be and when, in `f64`: every [`Curve`] is one; tables and look-ups implement it themselves.
pub trait Trajectory: Send + Sync {
    /// One word.
    fn name(&self) -> &'static str {
        "own"
    }
    /// One line for a list of shapes.
    fn description(&self) -> &'static str {
        ""
    }
    /// Everything the controllers use at time t, s: world frame, SI, yaw not wrapped.
    fn sample(&self, t: f64) -> Setpoint<f64>;
    /// Position and yaw as series about t, s.
    fn series(&self, t: f64) -> Series {
        let s = self.sample(t);
        let axis = |i: usize| [s.position[i], s.velocity[i], s.acceleration[i], s.jerk[i], s.snap[i]];
        let yaw = Jet::from_derivatives([s.yaw, s.yaw_rate, s.yaw_acceleration, 0.0, 0.0]);
        ([0, 1, 2].map(|i| Jet::from_derivatives(axis(i))), yaw)
    }
    /// Roll and pitch as series about t, s, for what holds them apart from its force; by default level.
    fn angles(&self, _t: f64) -> [Jet<f64, 3>; 2] {
        [Jet::fixed(0.0); 2]
    }
    /// When the motion is over, s; `None` without an end.
    fn duration(&self) -> Option<f64> {
        None
    }
    /// From the time, s, to the numbers of a [`Setpoint`]; `None` where samples are looked up.
    #[doc(hidden)]
    fn recording(&self) -> Option<Recording> {
        None
    }
    /// Checks every number.
    ///
    /// # Errors
    /// One that names the number.
    fn validate(&self) -> Result<()> {
        Ok(())
    }
}

impl<C: Curve> Trajectory for C {
    fn name(&self) -> &'static str {
        Curve::name(self)
    }
    fn description(&self) -> &'static str {
        Curve::description(self)
    }
    fn sample(&self, t: f64) -> Setpoint<f64> {
        let (position, yaw) = Trajectory::series(self, t);
        Setpoint::from_series(position, yaw)
    }
    fn series(&self, t: f64) -> Series {
        let time = Jet::variable(t);
        (self.position(time), self.yaw(time))
    }
    fn angles(&self, t: f64) -> [Jet<f64, 3>; 2] {
        Curve::angles(self, Jet::variable(t))
    }
    fn duration(&self) -> Option<f64> {
        Curve::duration(self)
    }
    fn recording(&self) -> Option<Recording> {
        Some(Recording::of(1, |time| {
            let time = Jet::variable(time[0]);
            let mut out = vec![Trace::zero(); Setpoint::<f64>::DIM];
            Setpoint::from_series(self.position(time), self.yaw(time)).write(&mut out);
            out
        }))
    }
    fn validate(&self) -> Result<()> {
        Curve::validate(self)
    }
}

/// A trajectory of a user. Two are equal if they are the same value.
#[derive(Clone)]
pub struct CustomTrajectory(pub Arc<dyn Trajectory>);

impl PartialEq for CustomTrajectory {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl std::fmt::Debug for CustomTrajectory {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Own").field(&self.0.name()).finish()
    }
}

/// Largest coordinate of a reference, m, and largest yaw, rad.
const LARGEST: f64 = 1e6;

/// Finite and no larger than a map.
pub(super) fn coordinates(what: &str, values: &[f64]) -> Result<()> {
    within(what, values, -LARGEST, LARGEST)
}

/// Finite and within [`low`, `high`].
pub(super) fn within(what: &str, values: &[f64], low: f64, high: f64) -> Result<()> {
    finite(what, values)?;
    match values.iter().find(|v| **v < low || **v > high) {
        None => Ok(()),
        Some(v) => {
            Err(Error::value(what, v, format!("within [{low}, {high}]"), "Give it in metres, radians, seconds."))
        }
    }
}
