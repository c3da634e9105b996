//! OMAV of the Voliro family with its tilts free: six arms, each with a coaxial pair of rotors on a tilting unit.
//!
//! ```text
//!   core ──(tilt_j: about the arm, outwards)── unit_j with rotor_j above and rotor_(j+6) below
//! ```
//!
//! Masses, places and rotors are those of the rigid vehicle [`omav`], bound by name;
//! sources stand there.
//!
//! | constant | value | source |
//! |---|---|---|
//! | tilt joints | about the arms, no range | OmniDrones `omav.usd` |
//! | tilt rates | ±10 rad/s at full command | OmniDrones |
//! | tilt servos | closed-loop lag 20 ms, bound 1 N m | our assumption (there 5730 N m s/rad and 4800 N m: any rate within one step) |
//! | damping | every body slowed at 0.2 1/s in translation and rotation | OmniDrones, of all drone assets |
//!
//! DIFFERENCE: rotor commands come in the order of names, `rotor_0` … `rotor_11`, then the tilts in order. One `Drone`
//! for the whole vehicle, at its core.

use super::configuration::{Configuration, DroneMap};
use crate::assembly::{Assembly, JointKind, JointSpec, Placement, Servo, Solid};
use crate::vehicle::{Part, Vehicle};
use crate::vehicles::omav;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use nalgebra::{Rotation3, Vector3};

/// Number of tilting units.
const N_UNIT: usize = 6;

with_defaults! {
    /// Parameters; `Default` is the paper's, servos ours.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Omav {
        /// The rigid vehicle that is cut at its arms: parts `base_link` and `tilt_unit_j`, rotors and rotor parts
        /// `rotor_j` and `rotor_(j+6)`.
        pub vehicle: Vehicle = omav(),
        /// Lag of the tilt rates, s.
        pub time_constant: f64 = 0.02,
        /// N m.
        pub max_torque: f64 = 1.0,
        /// rad/s at full command.
        pub max_rate: f64 = 10.0,
        /// Rates of loss of speed and of rotation of every body, 1/s.
        pub damping: [f64; 2] = [0.2, 0.2],
    }
}

/// Names as numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OmavMap {
    /// The root `core`, with the rotors in the order of their names.
    pub drone: DroneMap,
    /// Bodies `unit_0` … `unit_5`, whose joints are `tilt_0` ….
    pub units: [usize; 6],
}

impl Omav {
    /// The model `omav_tilting`.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a vehicle without the parts or rotors named above; otherwise as [`Assembly::model`].
    pub fn build(&self) -> Result<Configuration<OmavMap>> {
        let mut robot = Assembly::new("omav_tilting");
        let base = self.piece("base_link")?;
        let core = Solid::explicit(base.mass, base.position, base.inertia);
        let core = self.vehicle.shapes.iter().fold(core, |solid, shape| solid.and(*shape));
        robot.part("core", self.damped(core));
        for j in 0..N_UNIT {
            self.unit(&mut robot, j)?;
        }
        robot.drone("core", "core", [0.0; 3], (0..2 * N_UNIT).map(|r| format!("blade_{r}")));
        robot.rotor_order((0..2 * N_UNIT).map(|r| format!("rotor_{r}")));
        let model = robot.model()?;
        let mut units = [0; N_UNIT];
        for (j, unit) in units.iter_mut().enumerate() {
            *unit = model.body(&format!("unit_{j}"))?;
        }
        let map = OmavMap { drone: DroneMap::find(&model, "core")?, units };
        Ok(Configuration { model, map })
    }

    /// Unit j with its two rotors, and its tilt about the arm. The unit's frame has x outwards, z up.
    fn unit(&self, robot: &mut Assembly, j: usize) -> Result<()> {
        let [x, y, z] = self.piece(&format!("tilt_unit_{j}"))?.position;
        let place = Placement::from([x, y, z]).turned([0.0, 0.0, 1.0], y.atan2(x));
        let name = format!("unit_{j}");
        robot.part(&name, self.local(&format!("tilt_unit_{j}"), &place)?);
        for r in [j, j + N_UNIT] {
            let rotor = format!("rotor_{r}");
            let blade = self.local(&rotor, &place)?;
            robot.part(format!("blade_{r}"), blade);
            robot.join(JointSpec::new(format!("shaft_{r}"), JointKind::Fixed, &name, format!("blade_{r}")));
        }
        let servo =
            Servo::Rate { time_constant: self.time_constant, max_torque: self.max_torque, range: self.max_rate };
        robot.join(
            JointSpec::new(format!("tilt_{j}"), JointKind::Revolute([1.0, 0.0, 0.0]), "core", &name)
                .at(place)
                .servo(servo),
        );
        Ok(())
    }

    /// A part of the vehicle in the frame of its unit, with the rotor of that name if there is one.
    fn local(&self, name: &str, unit: &Placement) -> Result<Solid> {
        let part = self.piece(name)?;
        let (back, turn) = (unit.inverse(), unit.isometry().rotation.inverse());
        let r: Rotation3<f64> = turn.to_rotation_matrix();
        let center = back.then(&part.position.into()).position;
        let inertia = r.matrix() * part.inertia.matrix() * r.matrix().transpose();
        let solid = Solid::explicit(part.mass, center, crate::Inertia::from_matrix(&inertia));
        let Some(rotor) = self.vehicle.rotors.iter().find(|rotor| rotor.name == name) else {
            return Ok(self.damped(solid));
        };
        let mut rotor = rotor.clone();
        rotor.position = back.then(&rotor.position.into()).position;
        rotor.axis = (turn * Vector3::from(rotor.axis)).into();
        Ok(self.damped(solid.rotor(rotor)))
    }

    fn damped(&self, solid: Solid) -> Solid {
        solid.damping(self.damping[0], self.damping[1])
    }

    fn piece(&self, name: &str) -> Result<&Part> {
        self.vehicle.parts.iter().find(|part| part.name == name).ok_or_else(|| Error::Unknown {
            kind: "part of the vehicle",
            name: name.into(),
            known: self.vehicle.parts.iter().map(|part| part.name.clone()).collect(),
        })
    }
}
