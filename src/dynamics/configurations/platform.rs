//! Drones on cardan joints at the ends of a frame's arms: an over-actuated platform.
//!
//! ```text
//!   frame ──(mount_j: along the arm, across it)── drone_j      arm j at 2πj/N, drone j with yaw −2πj/N
//! ```
//!
//! | constant | value | source |
//! |---|---|---|
//! | frame | N capsules from the centre outward, 0.85 m long, radius 0.02 of that, 0.2 kg together | OmniDrones `envs/platform/utils.py` |
//! | joints | at the drones' origins, no range, damping 0.001 N m s per degree: 0.0573 N m s/rad; Hover and Track use twice that | same |
//! | N | 4; 2 and 6 are tested too | same |
//! | drones | Hummingbird, with yaw −2πj/N: at 90° its x points inward | the paper's |
//! | frame inertia | the arms as solids of one density, overlap at the centre counted N times | our assumption (engine default there) |
//!
//! With four Hummingbirds 3.064 kg.
//!
//! With two drones the frame is a bar with 2.9e-5 kg m² about its own axis, which the two hinges along it damp at 4000 1/s:
//! stiff. RK4 takes joint damping explicitly and diverges there above 0.7 ms; `SemiImplicit` takes it implicitly.

use super::configuration::{Configuration, DroneMap, PER_DEGREE, pair};
use crate::assembly::{Assembly, JointKind, JointSpec, Placement, Solid, rod};
use crate::vehicle::Vehicle;
use crate::vehicles::hummingbird;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use std::f64::consts::TAU;

const Z: [f64; 3] = [0.0, 0.0, 1.0];

with_defaults! {
    /// Parameters; `Default` is the paper's with four drones.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Platform {
        /// What lifts it, at every arm.
        pub drone: Vehicle = hummingbird(),
        /// N, 2 to 12.
        pub n_drone: usize = 4,
        /// From the frame's centre to a drone's origin, m.
        pub arm_length: f64 = 0.85,
        /// Of all arms together, kg.
        pub frame_mass: f64 = 0.2,
        /// Per axis, N m s/rad.
        pub damping: f64 = 0.001 * PER_DEGREE,
        /// Whether drones have yaw −2πj/N, as the paper's, or all that of the frame.
        pub rotate_drones: bool = true,
    }
}

/// One drone of a platform.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlatformDrone {
    /// `drone_0` ….
    pub drone: DroneMap,
    /// Hinges along the arm (outwards) and across it, `mount_0.x` and `mount_0.y` ….
    pub mount: [usize; 2],
}

/// Names as numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlatformMap {
    /// The root.
    pub frame: usize,
    /// In the order of the arms.
    pub drones: Vec<PlatformDrone>,
}

impl Platform {
    /// The model `platform`, with its number of drones behind it unless that is four.
    ///
    /// # Errors
    /// [`Error::Value`] for a number of drones out of range; otherwise as [`Assembly::model`].
    pub fn build(&self) -> Result<Configuration<PlatformMap>> {
        let n = self.n_drone;
        if !(2..=12).contains(&n) {
            return Err(Error::value("platform: n_drone", n, "between 2 and 12", "Use a Fleet for single drones."));
        }
        let mut robot = Assembly::new(if n == 4 { "platform".into() } else { format!("platform_{n}") });
        robot.part("frame", self.frame());
        for j in 0..n {
            let angle = TAU * j as f64 / n as f64;
            let yaw = if self.rotate_drones { -angle } else { 0.0 };
            robot.part(format!("drone_{j}"), Solid::vehicle(&self.drone));
            robot.join(
                // the joint's x points outwards on both sides
                JointSpec::new(format!("mount_{j}"), CARDAN, "frame", format!("drone_{j}"))
                    .at(Placement::from(self.tip(j)).turned(Z, angle))
                    .child_at(Placement::IDENTITY.turned(Z, angle - yaw))
                    .damping(self.damping),
            );
        }
        let model = robot.model()?;
        let drones = (0..n).map(|j| {
            let drone = DroneMap::find(&model, &format!("drone_{j}"))?;
            Ok(PlatformDrone { drone, mount: pair(&model, &format!("mount_{j}"), ["x", "y"])? })
        });
        let map = PlatformMap { frame: model.body("frame")?, drones: drones.collect::<Result<_>>()? };
        Ok(Configuration { model, map })
    }

    /// All arms as one part.
    fn frame(&self) -> Solid {
        let arm = |j| rod([0.0; 3], self.tip(j), 0.02 * self.arm_length);
        Solid::of((0..self.n_drone).map(arm)).mass(self.frame_mass)
    }

    fn tip(&self, j: usize) -> [f64; 3] {
        let (sin, cos) = (TAU * j as f64 / self.n_drone as f64).sin_cos();
        [self.arm_length * cos, self.arm_length * sin, 0.0]
    }
}

const CARDAN: JointKind = JointKind::Universal([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
