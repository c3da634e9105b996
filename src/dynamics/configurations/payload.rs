//! A drone with a ball on a stiff rope.
//!
//! ```text
//!   drone ──(swing: x, y)── bar ══ payload      the bar hangs along −z
//! ```
//!
//! | constant | value | source |
//! |---|---|---|
//! | bar | capsule of 1 m, radius 0.01 m, 0.001 kg | OmniDrones `envs/payload/utils.py` |
//! | payload | ball of radius 0.04 m, 0.3 kg (tasks draw their own) | same |
//! | joint | at the drone's origin, ±120°, damping 2e-6 N m s per degree: 1.146e-4 N m s/rad | same |
//! | drone | Hummingbird | the paper's |
//! | stops | natural rate 30 rad/s, dissipation 3 s/rad | our assumption |

use super::configuration::{Configuration, DroneMap, PER_DEGREE, pair};
use crate::assembly::{Assembly, JointKind, JointSpec, Solid};
use crate::vehicle::Vehicle;
use crate::vehicles::hummingbird;
use base::defaults::with_defaults;
use base::error::Result;
use std::f64::consts::PI;

with_defaults! {
    /// Parameters; `Default` is the paper's.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Payload {
        /// What carries it.
        pub drone: Vehicle = hummingbird(),
        /// Of the bar, from the drone's origin to the ball's centre, m.
        pub length: f64 = 1.0,
        /// m.
        pub bar_radius: f64 = 0.01,
        /// kg.
        pub bar_mass: f64 = 0.001,
        /// Of the ball, m.
        pub payload_radius: f64 = 0.04,
        /// kg.
        pub payload_mass: f64 = 0.3,
        /// Either way from hanging straight, rad.
        pub range: f64 = 2.0 / 3.0 * PI,
        /// Per axis, N m s/rad.
        pub damping: f64 = 2e-6 * PER_DEGREE,
    }
}

/// Names as numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PayloadMap {
    /// The vehicle, root of the tree.
    pub drone: DroneMap,
    /// Body of bar and ball; the frames `bar` (its middle) and `payload` (the ball's centre) are on it.
    pub bar: usize,
    /// Hinges about x and y of the drone, `swing.x` and `swing.y`.
    pub swing: [usize; 2],
}

impl Payload {
    /// The model `payload`.
    ///
    /// # Errors
    /// As [`Assembly::model`].
    pub fn build(&self) -> Result<Configuration<PayloadMap>> {
        let (half, end) = (0.5 * self.length, [0.0, 0.0, -0.5 * self.length]);
        let mut robot = Assembly::new("payload");
        robot.part("drone", Solid::vehicle(&self.drone));
        robot.part("bar", Solid::capsule(self.bar_radius, self.length).mass(self.bar_mass));
        robot.part("payload", Solid::sphere(self.payload_radius).mass(self.payload_mass));
        robot.join(
            JointSpec::new("swing", JointKind::Universal([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]), "drone", "bar")
                .child_at([0.0, 0.0, half])
                .range(-self.range, self.range)
                .damping(self.damping),
        );
        robot.join(JointSpec::new("knot", JointKind::Fixed, "bar", "payload").at(end));
        let model = robot.model()?;
        let map = PayloadMap {
            drone: DroneMap::find(&model, "drone")?,
            bar: model.body("bar")?,
            swing: pair(&model, "swing", ["x", "y"])?,
        };
        Ok(Configuration { model, map })
    }
}
