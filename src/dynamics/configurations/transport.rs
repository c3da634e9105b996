//! Drones that carry a box on bars.
//!
//! ```text
//!   box ──(anchor_i: x, y)── bar_i ──(hook_i: x, y)── drone_i
//! ```
//!
//! | constant | four drones | six drones | source |
//! |---|---|---|---|
//! | box | 1.5 × 1.0 × 0.4 m | 2.0 × 1.0 × 0.4 m | OmniDrones `envs/transport/utils.py` (cube of side 2 scaled) |
//! | box | 2.0 kg, linear and angular damping 0.1 1/s | same | same |
//! | drones | at (±0.75, ±0.5), order (+,+) (+,−) (−,−) (−,+) | (1, ±.5), (0, ±.5), (−1, ∓.5) | same |
//! | anchors | 1.0 m below the drones, 0.1 m above the box's centre | same | same |
//! | bars | capsule of 1 m, radius 0.012 m, 0.03 kg | same | same |
//! | joints | ±120°, damping 2e-4 N m s per degree: 0.01146 N m s/rad | same | same |
//! | stops | natural rate 30 rad/s, dissipation 3 s/rad | same | our assumption |
//!
//! DIFFERENCE
//! - The anchors' balls (no mass given, no collision) are left out: the bars' joints sit on the box.
//! - Joints are found by name, so a task sees all 8 n angles; OmniDrones reads the first 16 (defect 24).

use super::configuration::{Configuration, DroneMap, PER_DEGREE, pair};
use crate::assembly::{Assembly, JointKind, JointSpec, Solid};
use crate::vehicle::Vehicle;
use crate::vehicles::hummingbird;
use base::error::Result;
use std::f64::consts::PI;

/// Parameters; `Default` is the paper's with four drones.
#[derive(Debug, Clone, PartialEq)]
pub struct Transport {
    /// What carries the box, at every bar.
    pub drone: Vehicle,
    /// Where the bars stand on the box in its plane, from its centre, m: one drone each.
    pub corners: Vec<[f64; 2]>,
    /// Full edge lengths, m.
    pub box_size: [f64; 3],
    /// kg; its inertia is that of a solid box.
    pub box_mass: f64,
    /// Rates of loss of speed and of rotation, 1/s: F = −d m v, M = −d J ω.
    pub box_damping: [f64; 2],
    /// Of the anchors above the box's centre, m.
    pub anchor_height: f64,
    /// From anchor to drone, m.
    pub bar_length: f64,
    /// m.
    pub bar_radius: f64,
    /// kg each.
    pub bar_mass: f64,
    /// Either way from upright, rad.
    pub range: f64,
    /// Per axis, N m s/rad.
    pub damping: f64,
    /// Whether box and bars touch: the paper's FlyThrough only.
    pub collides: bool,
}

impl Default for Transport {
    fn default() -> Self {
        Self::four()
    }
}

/// One drone with its bar.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Carrier {
    /// `drone_0` ….
    pub drone: DroneMap,
    /// Body `bar_0` …: its origin is at the anchor, the frame of that name at its middle.
    pub bar: usize,
    /// Hinges between box and bar, `anchor_0.x` and `anchor_0.y` ….
    pub anchor: [usize; 2],
    /// Hinges between bar and drone, `hook_0.x` and `hook_0.y` ….
    pub hook: [usize; 2],
}

/// Names as numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TransportMap {
    /// The root: the box, its origin at its centre.
    pub payload: usize,
    /// In the order of the corners.
    pub carriers: Vec<Carrier>,
}

impl Transport {
    /// The paper's with four drones.
    pub fn four() -> Self {
        Self {
            drone: hummingbird(),
            corners: vec![[0.75, 0.5], [0.75, -0.5], [-0.75, -0.5], [-0.75, 0.5]],
            box_size: [1.5, 1.0, 0.4],
            box_mass: 2.0,
            box_damping: [0.1, 0.1],
            anchor_height: 0.1,
            bar_length: 1.0,
            bar_radius: 0.012,
            bar_mass: 0.03,
            range: 2.0 / 3.0 * PI,
            damping: 2e-4 * PER_DEGREE,
            collides: false,
        }
    }

    /// The paper's with six drones.
    pub fn six() -> Self {
        Self {
            corners: vec![[1.0, 0.5], [1.0, -0.5], [0.0, 0.5], [0.0, -0.5], [-1.0, -0.5], [-1.0, 0.5]],
            box_size: [2.0, 1.0, 0.4],
            ..Self::four()
        }
    }

    /// The model `transport`, with its number of drones behind it unless that is four.
    ///
    /// # Errors
    /// As [`Assembly::model`].
    pub fn build(&self) -> Result<Configuration<TransportMap>> {
        let n = self.corners.len();
        let mut robot = Assembly::new(if n == 4 { "transport".into() } else { format!("transport_{n}") });
        let [linear, angular] = self.box_damping;
        robot.part("box", self.touching(Solid::cuboid(self.box_size).mass(self.box_mass).damping(linear, angular)));
        for (i, corner) in self.corners.iter().enumerate() {
            self.carrier(&mut robot, i, *corner);
        }
        let model = robot.model()?;
        let carriers = (0..n).map(|i| {
            Ok(Carrier {
                drone: DroneMap::find(&model, &format!("drone_{i}"))?,
                bar: model.body(&format!("bar_{i}"))?,
                anchor: pair(&model, &format!("anchor_{i}"), ["x", "y"])?,
                hook: pair(&model, &format!("hook_{i}"), ["x", "y"])?,
            })
        });
        let map = TransportMap { payload: model.body("box")?, carriers: carriers.collect::<Result<_>>()? };
        Ok(Configuration { model, map })
    }

    /// A bar on the box and a drone on the bar.
    fn carrier(&self, robot: &mut Assembly, i: usize, [x, y]: [f64; 2]) {
        let half = 0.5 * self.bar_length;
        let cardan = JointKind::Universal([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let (bar, drone) = (format!("bar_{i}"), format!("drone_{i}"));
        robot.part(&bar, self.touching(Solid::capsule(self.bar_radius, self.bar_length).mass(self.bar_mass)));
        robot.part(&drone, Solid::vehicle(&self.drone));
        let joint = |name: &str, parent: &str, child: &str| {
            JointSpec::new(format!("{name}_{i}"), cardan, parent, child)
                .range(-self.range, self.range)
                .damping(self.damping)
        };
        robot.join(joint("anchor", "box", &bar).at([x, y, self.anchor_height]).child_at([0.0, 0.0, -half]));
        robot.join(joint("hook", &bar, &drone).at([0.0, 0.0, half]));
    }

    fn touching(&self, solid: Solid) -> Solid {
        if self.collides { solid } else { solid.without_collision() }
    }
}
