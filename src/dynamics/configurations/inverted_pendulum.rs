//! A drone that balances a ball on a bar.
//!
//! ```text
//!   drone ──(swing: x, y)── bar ══ payload      the bar stands along +z
//! ```
//!
//! | constant | value | source |
//! |---|---|---|
//! | bar | capsule of 1 m, radius 0.01 m, 0.001 kg (tasks draw 0.01 to 0.04 kg) | OmniDrones `envs/inv_pendulum/utils.py` |
//! | payload | ball of 0.3 kg, radius 0.04 m as every task passes (its default is 0.06) | same |
//! | joint | at the drone's origin, no range, damping 2e-6 N m s per degree: 1.146e-4 N m s/rad | same |
//! | drone | Hummingbird | the paper's |
//!
//! DIFFERENCE: `InvPendulumHover` ignores its bar length (defect 23); here it is a parameter like any other.

use super::configuration::{Configuration, DroneMap, PER_DEGREE, pair};
use crate::assembly::{Assembly, JointKind, JointSpec, Solid};
use crate::vehicle::Vehicle;
use crate::vehicles::hummingbird;
use base::defaults::with_defaults;
use base::error::Result;

with_defaults! {
    /// Parameters; `Default` is the paper's.
    #[derive(Debug, Clone, PartialEq)]
    pub struct InvertedPendulum {
        /// What balances it.
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
        /// Per axis, N m s/rad.
        pub damping: f64 = 2e-6 * PER_DEGREE,
    }
}

/// Names as numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InvertedPendulumMap {
    /// The vehicle, root of the tree.
    pub drone: DroneMap,
    /// Body of bar and ball; the frames `bar` (its middle) and `payload` (the ball's centre) are on it.
    pub bar: usize,
    /// Hinges about x and y of the drone, `swing.x` and `swing.y`.
    pub swing: [usize; 2],
}

impl InvertedPendulum {
    /// The model `inverted_pendulum`.
    ///
    /// # Errors
    /// As [`Assembly::model`].
    pub fn build(&self) -> Result<Configuration<InvertedPendulumMap>> {
        let half = 0.5 * self.length;
        let mut robot = Assembly::new("inverted_pendulum");
        robot.part("drone", Solid::vehicle(&self.drone));
        robot.part("bar", Solid::capsule(self.bar_radius, self.length).mass(self.bar_mass));
        robot.part("payload", Solid::sphere(self.payload_radius).mass(self.payload_mass));
        robot.join(
            JointSpec::new("swing", JointKind::Universal([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]), "drone", "bar")
                .child_at([0.0, 0.0, -half])
                .damping(self.damping),
        );
        robot.join(JointSpec::new("knot", JointKind::Fixed, "bar", "payload").at([0.0, 0.0, half]));
        let model = robot.model()?;
        let map = InvertedPendulumMap {
            drone: DroneMap::find(&model, "drone")?,
            bar: model.body("bar")?,
            swing: pair(&model, "swing", ["x", "y"])?,
        };
        Ok(Configuration { model, map })
    }
}
