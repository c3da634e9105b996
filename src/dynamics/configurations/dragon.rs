//! A flying chain: links joined by cardan joints, each with two rotors on a gimbal.
//!
//! ```text
//!   link_i ──(gimbal_i: x)── ring_i ──(gimbal_i: y)── module_i with rotor_(2i), rotor_(2i+1)
//!     └──(bend_i: y, then z)── link_(i+1)                        link i + 1 is 0.3 m in front of link i
//! ```
//!
//! | constant | value | source |
//! |---|---|---|
//! | link | capsule along x of 0.3 m, radius 0.01 m, 0.2 kg | OmniDrones `robots/drone/dragon.py`, `dragon_link_0.usd` |
//! | ring | 0.2 kg, a solid ball of radius 0.04 m | mass same; shape our assumption (engine default there) |
//! | module | 0.2 kg: capsule along y of 0.2 m and two along z of 0.06 m at y = ±0.1 m, radius 0.01 m; 0.02 m above the link | same |
//! | rotors | 0.0065 kg at (0, ∓0.1, 0.06) m of the link, σ = +1, −1 | same |
//! | k_f, κ, Ω_max | 7.2e-6 N s²/rad², 0.015 m, 800 rad/s: 4.608 N each | OmniDrones |
//! | τ up / down | 0.0125 / 0.025 s | RotorS, of the Omav's like rotors |
//! | rotor inertia, radius | those of the Omav's blades, 0.1143 m | our assumption |
//! | gimbal rates | ±π/2 rad/s at full command | OmniDrones |
//! | gimbal servos | closed-loop lag 20 ms, bound 2 N m | our assumption (there 28.65 N m s/rad, no bound) |
//! | bends | ±90°, spring 1 and damping 0.5 per degree: 57.3 N m/rad, 28.65 N m s/rad; targets ±π/2 rad at full command | OmniDrones |
//! | bend bound | 7 N m | our assumption |
//! | bend armature | 0.01 kg m²: a servo of 7 N m has about 1e-7 kg m² behind a gear of 1:350 | our assumption (none there) |
//! | damping | every body slowed at 0.2 1/s in translation and rotation | OmniDrones, of all drone assets |
//!
//! A link has 0.613 kg, four 2.452 kg. DIFFERENCE: rotors' reaction torques act on the module that carries them, not on
//! the link; rotors are the links' own in order, and there is one `Drone` per module.

use super::configuration::{Configuration, DroneMap, PER_DEGREE, pair};
use crate::assembly::{Assembly, JointKind, JointSpec, Servo, Solid, rod};
use crate::vehicle::{Inertia, Rotor};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use std::f64::consts::FRAC_PI_2;

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

with_defaults! {
    /// Parameters; `Default` is the paper's with four links.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Dragon {
        /// 1 to 12.
        pub n_link: usize = 4,
        /// Between the joints at its ends, m.
        pub link_length: f64 = 0.3,
        /// kg.
        pub link_mass: f64 = 0.2,
        /// kg.
        pub ring_mass: f64 = 0.2,
        /// Of the ball that stands for the ring's inertia, m.
        pub ring_radius: f64 = 0.04,
        /// kg, without rotors.
        pub module_mass: f64 = 0.2,
        /// Of the module and its second hinge above the link, m.
        pub module_height: f64 = 0.02,
        /// Rotors at ±this along y, m.
        pub rotor_offset: f64 = 0.1,
        /// Of the rotors above the link, m.
        pub rotor_height: f64 = 0.06,
        /// Of a blade, kg.
        pub rotor_mass: f64 = 0.0065,
        /// Lag of the gimbal rates, s.
        pub gimbal_time_constant: f64 = 0.02,
        /// N m.
        pub gimbal_torque: f64 = 2.0,
        /// rad/s at full command.
        pub gimbal_rate: f64 = FRAC_PI_2,
        /// Of a bend's servo, N m/rad.
        pub bend_stiffness: f64 = PER_DEGREE,
        /// Of a bend's servo, N m s/rad.
        pub bend_damping: f64 = 0.5 * PER_DEGREE,
        /// N m.
        pub bend_torque: f64 = 7.0,
        /// Reflected inertia of a bend's motor, kg m².
        pub bend_armature: f64 = 0.01,
        /// Either way from straight, of targets and stops, rad.
        pub bend_range: f64 = FRAC_PI_2,
        /// Rates of loss of speed and of rotation of every body, 1/s.
        pub damping: [f64; 2] = [0.2, 0.2],
    }
}

/// One link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DragonLink {
    /// Body `link_0` …; the frame of that name is its middle.
    pub body: usize,
    /// Hinges between link and module about x and y, `gimbal_0.x` and `gimbal_0.y` …, rate servos. The first one's body
    /// is `ring_0`.
    pub gimbal: [usize; 2],
    /// The module `module_0` … with its two rotors.
    pub module: DroneMap,
    /// Hinges from this link to the next about y and z, `bend_0.y` and `bend_0.z` …; `None` at the last.
    pub bend: Option<[usize; 2]>,
}

/// Names as numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DragonMap {
    /// From the root on.
    pub links: Vec<DragonLink>,
}

impl Dragon {
    /// The model `dragon`, with its number of links behind it unless that is four.
    ///
    /// # Errors
    /// [`Error::Value`] for a number of links out of range; otherwise as [`Assembly::model`].
    pub fn build(&self) -> Result<Configuration<DragonMap>> {
        let n = self.n_link;
        if !(1..=12).contains(&n) {
            return Err(Error::value("dragon: n_link", n, "between 1 and 12", "Each link adds five bodies."));
        }
        let mut robot = Assembly::new(if n == 4 { "dragon".into() } else { format!("dragon_{n}") });
        for i in 0..n {
            self.link(&mut robot, i);
            if i > 0 {
                self.bend(&mut robot, i - 1);
            }
        }
        let model = robot.model()?;
        let links = (0..n).map(|i| {
            Ok(DragonLink {
                body: model.body(&format!("link_{i}"))?,
                gimbal: [model.joint(&format!("gimbal_{i}.x"))?, model.joint(&format!("gimbal_{i}.y"))?],
                module: DroneMap::find(&model, &format!("module_{i}"))?,
                bend: if i + 1 < n { Some(pair(&model, &format!("bend_{i}"), ["y", "z"])?) } else { None },
            })
        });
        let map = DragonMap { links: links.collect::<Result<_>>()? };
        Ok(Configuration { model, map })
    }

    /// Link i with its gimbal.
    fn link(&self, robot: &mut Assembly, i: usize) {
        let (link, ring, module) = (format!("link_{i}"), format!("ring_{i}"), format!("module_{i}"));
        let half = 0.5 * self.link_length;
        robot.part(&link, self.damped(Solid::bar([-half, 0.0, 0.0], [half, 0.0, 0.0], 0.01).mass(self.link_mass)));
        let ball = 0.4 * self.ring_mass * self.ring_radius * self.ring_radius;
        robot.part(&ring, self.damped(Solid::explicit(self.ring_mass, [0.0; 3], Inertia::diagonal(ball, ball, ball))));
        robot.part(&module, self.module(i));
        for (r, y) in [(2 * i, -self.rotor_offset), (2 * i + 1, self.rotor_offset)] {
            let blade = format!("blade_{r}");
            robot.part(&blade, self.blade());
            let at = [0.0, y, self.rotor_height - self.module_height];
            robot.join(JointSpec::new(format!("shaft_{r}"), JointKind::Fixed, &module, blade).at(at));
        }
        let servo = Servo::Rate {
            time_constant: self.gimbal_time_constant,
            max_torque: self.gimbal_torque,
            range: self.gimbal_rate,
        };
        robot.join(JointSpec::new(format!("gimbal_{i}.x"), JointKind::Revolute(X), link, &ring).servo(servo));
        let second = JointSpec::new(format!("gimbal_{i}.y"), JointKind::Revolute(Y), ring, &module);
        robot.join(second.at([0.0, 0.0, self.module_height]).servo(servo));
        robot.drone(&module, &module, [0.0, 0.0, self.rotor_height - self.module_height], [module.clone()]);
    }

    /// The joint from link i to the next.
    fn bend(&self, robot: &mut Assembly, i: usize) {
        let half = 0.5 * self.link_length;
        let servo = Servo::Position {
            stiffness: self.bend_stiffness,
            damping: self.bend_damping,
            max_torque: self.bend_torque,
            center: 0.0,
            range: self.bend_range,
        };
        robot.join(
            JointSpec::new(
                format!("bend_{i}"),
                JointKind::Universal(Y, Z),
                format!("link_{i}"),
                format!("link_{}", i + 1),
            )
            .at([half, 0.0, 0.0])
            .child_at([-half, 0.0, 0.0])
            .range(-self.bend_range, self.bend_range)
            .armature(self.bend_armature)
            .servo(servo),
        );
    }

    /// The beam between the motors, the motors, and the rotors on them.
    fn module(&self, i: usize) -> Solid {
        let (y, up) = (self.rotor_offset, self.rotor_height - self.module_height);
        let mut solid = Solid::of([
            rod([0.0, -y, 0.0], [0.0, y, 0.0], 0.01),
            rod([0.0, -y, -0.03], [0.0, -y, 0.03], 0.01),
            rod([0.0, y, -0.03], [0.0, y, 0.03], 0.01),
        ])
        .mass(self.module_mass);
        for (r, y, spin) in [(2 * i, -y, 1.0), (2 * i + 1, y, -1.0)] {
            solid = solid.rotor(self.rotor(r, [0.0, y, up], spin));
        }
        self.damped(solid)
    }

    fn rotor(&self, number: usize, position: [f64; 3], spin: f64) -> Rotor {
        Rotor {
            name: format!("rotor_{number}"),
            position,
            axis: Z,
            spin,
            thrust_coefficient: 7.2e-6,
            moment_per_thrust: 0.015,
            max_speed: 800.0,
            time_constant_up: 0.0125,
            time_constant_down: 0.025,
            inertia: self.blade_moments()[1],
            radius: 0.1143,
            drag_coefficient: 0.0,
            axial_drag_coefficient: 0.0,
            rolling_coefficient: 0.0,
        }
    }

    /// The Omav's blade, a box of 0.1143 × 0.02 × 0.003 m, across and along its axis, kg m².
    fn blade_moments(&self) -> [f64; 2] {
        let (length, chord, thickness) = (0.1143_f64, 0.02_f64, 0.003_f64);
        let across = self.rotor_mass / 24.0 * (length.powi(2) + chord.powi(2) + 2.0 * thickness.powi(2));
        [across, self.rotor_mass / 12.0 * (length.powi(2) + chord.powi(2))]
    }

    /// A blade at its hub, averaged over a turn.
    fn blade(&self) -> Solid {
        let [across, axial] = self.blade_moments();
        self.damped(Solid::explicit(self.rotor_mass, [0.0; 3], Inertia::diagonal(across, across, axial)))
    }

    fn damped(&self, solid: Solid) -> Solid {
        solid.damping(self.damping[0], self.damping[1])
    }
}
