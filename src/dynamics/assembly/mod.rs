//! Vehicles and primitives joined into an articulated [`Model`].
//!
//! | file | what |
//! |---|---|
//! | `solid` | one rigid part: shapes with a mass or density, a vehicle, or given mass properties |
//! | `joint_spec` | how two parts are held together: joint, damping, spring, stops, servo |
//! | `placement` | where one frame stands in another |
//! | `connect` | parts and joints as a tree, or an error that names what is not one |
//! | `emit` | the tree as bodies: welded parts merged, universal joints split |
//! | `servo_gains` | gains of servos and stops from the inertia that a joint feels |
//! | [`group()`] | several models as one |
//!
//! ```
//! # use omnidrones_dynamics::omnidrones;
//! use omnidrones::dynamics::assembly::{Assembly, JointSpec, JointKind, Solid};
//! use omnidrones::dynamics::vehicles::hummingbird;
//!
//! let mut assembly = Assembly::new("slung_ball");
//! assembly.part("drone", Solid::vehicle(&hummingbird()));
//! assembly.part("rope", Solid::bar([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], 0.01).mass(0.01));
//! assembly.part("ball", Solid::sphere(0.04).mass(0.3));
//! assembly.join(JointSpec::new("swing", JointKind::Universal([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]), "drone", "rope").damping(1e-4));
//! assembly.join(JointSpec::new("knot", JointKind::Fixed, "rope", "ball").at([0.0, 0.0, -1.0]));
//! let model = assembly.model()?;
//! assert_eq!(model.bodies().len(), 3); // drone, the cross between the two axes, rope with ball
//! assert_eq!(model.frame("ball")?.position, [0.0, 0.0, -1.0]);
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

mod connect;
mod emit;
#[doc(hidden)]
pub mod group;
pub(crate) mod joint_spec;
pub(crate) mod placement;
mod servo_gains;
pub(crate) mod solid;

pub use group::{Member, group};
pub use joint_spec::{JointKind, JointSpec, STOP_DISSIPATION, STOP_RATE, Servo, Stops, WORLD};
pub use placement::Placement;
pub use solid::{Solid, rod};

use super::tree::{ContactSettings, Model};
use super::vehicle::{GRAVITY, Vehicle};
use base::error::{Error, Result, finite};

/// Parts and joints, collected in any order and checked by [`Assembly::model`].
#[derive(Debug, Clone, PartialEq)]
pub struct Assembly {
    name: String,
    gravity: f64,
    parts: Vec<(String, Solid)>,
    joins: Vec<JointSpec>,
    drones: Vec<Group>,
    rotor_order: Option<Vec<String>>,
    contact: ContactSettings,
}

/// A drone whose rotors sit on several parts.
#[derive(Debug, Clone, PartialEq)]
struct Group {
    name: String,
    part: String,
    position: [f64; 3],
    carriers: Vec<String>,
}

impl Assembly {
    /// Nothing yet, under gravity of 9.81 m/s².
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            gravity: GRAVITY,
            parts: Vec::new(),
            joins: Vec::new(),
            drones: Vec::new(),
            rotor_order: None,
            contact: ContactSettings::default(),
        }
    }

    /// Gravity, m/s², downwards; 9.81 unless given.
    pub fn gravity(&mut self, gravity: f64) -> &mut Self {
        self.gravity = gravity;
        self
    }

    /// Height of the ground, m, or none; z = 0 unless given.
    pub fn ground(&mut self, height: Option<f64>) -> &mut Self {
        self.contact.ground = height;
        self
    }

    /// Whether bodies touch each other, those joined to each other apart; not unless given.
    pub fn self_collision(&mut self, touches: bool) -> &mut Self {
        self.contact.self_collision = touches;
        self
    }

    /// Adds a part. Names are unique, and none is [`WORLD`].
    pub fn part(&mut self, name: impl Into<String>, solid: Solid) -> &mut Self {
        self.parts.push((name.into(), solid));
        self
    }

    /// Joins two parts, or one with the world.
    pub fn join(&mut self, join: JointSpec) -> &mut Self {
        self.joins.push(join);
        self
    }

    /// Declares the rotors on the parts `carriers` one drone: its wake starts and others push at `position` (m) in the
    /// frame of `part`. Vehicles are drones by themselves.
    pub fn drone(
        &mut self,
        name: impl Into<String>,
        part: impl Into<String>,
        position: [f64; 3],
        carriers: impl IntoIterator<Item = String>,
    ) -> &mut Self {
        let carriers = carriers.into_iter().collect();
        self.drones.push(Group { name: name.into(), part: part.into(), position, carriers });
        self
    }

    /// The order of rotor commands, all rotors by name; without it rotors follow the order of parts.
    pub fn rotor_order(&mut self, names: impl IntoIterator<Item = String>) -> &mut Self {
        self.rotor_order = Some(names.into_iter().collect());
        self
    }

    /// Gives a part another mass, kg: its inertia follows in proportion.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest part, [`Error::Value`] for a mass that is not ≥ 0.
    pub fn set_mass(&mut self, part: &str, mass: f64) -> Result<&mut Self> {
        finite(&format!("{}: mass of part '{part}'", self.label()), &[mass])?;
        let number = self.number(part)?;
        let (_, solid) = &mut self.parts[number];
        *solid = solid.clone().mass(mass);
        solid.validate(&format!("assembly '{}': part '{part}'", self.name))?;
        Ok(self)
    }

    /// Scales every length: shapes, places of joints and rotors, ranges of slides. Masses from a density follow the
    /// volume, given ones stay, see [`Solid::scaled`]. Damping, springs, servos and drag coefficients stay.
    ///
    /// # Errors
    /// [`Error::Value`] for a factor that is not > 0.
    pub fn scale(&mut self, factor: f64) -> Result<&mut Self> {
        if !(factor > 0.0 && factor.is_finite()) {
            let what = format!("{}: scale", self.label());
            return Err(Error::value(what, factor, "> 0 and finite", "1 keeps the size."));
        }
        for (_, solid) in &mut self.parts {
            *solid = solid.clone().scaled(factor);
        }
        for join in &mut self.joins {
            *join = join.clone().scaled(factor);
        }
        for drone in &mut self.drones {
            drone.position = drone.position.map(|x| factor * x);
        }
        Ok(self)
    }

    /// The checked model.
    ///
    /// The one part that hangs on no joint is the root and floats, unless a joint holds it to the world. Parents come
    /// before children, children in the order of their joints. Parts welded together become one body named after the
    /// part next to the joint that moves it; every part keeps its own frame by name ([`Model::frame`]). What is welded to
    /// the world keeps its shapes there, as obstacles. A body has the axes of the part it is named after and its origin
    /// at the joint. Drag of welded parts is summed along the body's axes; what a turn puts off the diagonal is left
    /// out (nothing, for quarter turns).
    ///
    /// # Errors
    /// [`Error::Unknown`] or [`Error::Value`] naming the part or joint: unknown or repeated names, two roots, a loop or
    /// cycle, no direction of an axis, no mass where something moves, ranges that cross, a servo without bound.
    pub fn model(&self) -> Result<Model> {
        let tree = connect::connect(self)?;
        let draft = emit::emit(self, &tree)?;
        servo_gains::tune(draft)
    }

    fn label(&self) -> String {
        format!("assembly '{}'", self.name)
    }

    fn number(&self, part: &str) -> Result<usize> {
        self.parts.iter().position(|(name, _)| name == part).ok_or_else(|| Error::Unknown {
            kind: "part",
            name: part.into(),
            known: self.parts.iter().map(|(name, _)| name.clone()).collect(),
        })
    }
}

/// A vehicle as a model of one floating body, with its rotors in their order and its shapes: what
/// [`Multirotor`](super::Multirotor) computes in closed form, able to touch the ground.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] when the vehicle is not valid.
pub fn single(vehicle: &Vehicle) -> Result<Model> {
    vehicle.validate()?;
    Assembly::new(&vehicle.name).part(&vehicle.name, Solid::vehicle(vehicle)).model()
}
