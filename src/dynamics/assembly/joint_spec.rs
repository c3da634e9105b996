//! How two parts are held together.

use super::placement::Placement;

/// Name of the world as a parent.
pub const WORLD: &str = "world";

/// Motions of a joint, along axes given in the joint's frame, of any length but zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JointKind {
    /// None: the two parts become one body.
    Fixed,
    /// All; only on the world, placed where the part starts.
    Floating,
    /// About an axis.
    Revolute([f64; 3]),
    /// Along an axis.
    Prismatic([f64; 3]),
    /// About a first axis that stays with the parent, then about a second one that stays with the child: a cardan
    /// joint. Each is a hinge of its own, named after its letter (`swing.x`, `swing.y`), or `.a` and `.b` where the axis
    /// is not one of the frame's.
    Universal([f64; 3], [f64; 3]),
    /// About the joint's origin.
    Ball,
}

/// A motor on a joint; its bound is required. On a universal joint both axes get one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Servo {
    /// Follows q̇ = `range` · command with a first-order lag.
    ///
    /// Its gain is d = I/T with the inertia I that the joint feels at the rest pose while all other servos hold and
    /// joints without one are free: 1/(M⁻¹)ᵢᵢ of the mass matrix without the rows of the other servos.
    Rate {
        /// T, s.
        time_constant: f64,
        /// N m or N.
        max_torque: f64,
        /// Rate at full command, rad/s or m/s.
        range: f64,
    },
    /// Holds q = `center` + `range` · command like a spring with a damper.
    Position {
        /// N m/rad or N/m.
        stiffness: f64,
        /// N m s/rad or N s/m.
        damping: f64,
        /// N m or N.
        max_torque: f64,
        /// Target at no command, rad or m.
        center: f64,
        /// Change of the target at full command, rad or m.
        range: f64,
    },
}

/// Soft stops at the ends of a joint's range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stops {
    /// rad or m.
    pub lower: f64,
    /// rad or m.
    pub upper: f64,
    /// N m/rad or N/m; without it I ω² with ω = [`STOP_RATE`] and the inertia I that the joint feels at the rest pose.
    pub stiffness: Option<f64>,
    /// s/rad or s/m; without it [`STOP_DISSIPATION`].
    pub dissipation: Option<f64>,
}

/// Natural rate of a joint against its default stops, rad/s: a contact of a tenth of a second, and six steps of 16 ms.
pub const STOP_RATE: f64 = 30.0;
/// Dissipation of default stops, s/rad or s/m: of an impact at 1 rad/s (1 m/s) 91 % of the energy is lost, of faster
/// ones more (what leaves is never faster than 1/3 rad/s); of one at 0.1 rad/s 31 %.
pub const STOP_DISSIPATION: f64 = 3.0;

/// A joint between two parts: its frame is placed on either, and the two placements coincide at q = 0.
#[derive(Debug, Clone, PartialEq)]
pub struct JointSpec {
    pub(crate) name: String,
    pub(crate) kind: JointKind,
    pub(crate) parent: String,
    pub(crate) at: Placement,
    pub(crate) child: String,
    pub(crate) child_at: Placement,
    pub(crate) damping: f64,
    pub(crate) stiffness: f64,
    pub(crate) rest: f64,
    pub(crate) armature: f64,
    pub(crate) stops: Option<Stops>,
    pub(crate) servo: Option<Servo>,
}

impl JointSpec {
    /// A free joint at the origins of both parts: no damping, spring, armature, stops or servo. `parent` may be [`WORLD`].
    pub fn new(name: impl Into<String>, kind: JointKind, parent: impl Into<String>, child: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            kind,
            parent: parent.into(),
            at: Placement::IDENTITY,
            child: child.into(),
            child_at: Placement::IDENTITY,
            damping: 0.0,
            stiffness: 0.0,
            rest: 0.0,
            armature: 0.0,
            stops: None,
            servo: None,
        }
    }

    /// Where the joint's frame stands in the parent.
    #[must_use]
    pub fn at(mut self, place: impl Into<Placement>) -> Self {
        self.at = place.into();
        self
    }

    /// Where the joint's frame stands in the child.
    #[must_use]
    pub fn child_at(mut self, place: impl Into<Placement>) -> Self {
        self.child_at = place.into();
        self
    }

    /// Viscous damping per axis, N m s/rad or N s/m.
    #[must_use]
    pub fn damping(mut self, damping: f64) -> Self {
        self.damping = damping;
        self
    }

    /// Inertia of a geared motor per axis, as the joint feels it, kg m² or kg.
    #[must_use]
    pub fn armature(mut self, armature: f64) -> Self {
        self.armature = armature;
        self
    }

    /// A spring per axis, N m/rad or N/m, relaxed at `rest` (rad or m).
    #[must_use]
    pub fn spring(mut self, stiffness: f64, rest: f64) -> Self {
        (self.stiffness, self.rest) = (stiffness, rest);
        self
    }

    /// Default stops at both ends of a range (of each axis), rad or m.
    #[must_use]
    pub fn range(self, lower: f64, upper: f64) -> Self {
        self.stops(Stops { lower, upper, stiffness: None, dissipation: None })
    }

    /// Stops of given stiffness.
    #[must_use]
    pub fn stops(mut self, stops: Stops) -> Self {
        self.stops = Some(stops);
        self
    }

    /// A motor.
    #[must_use]
    pub fn servo(mut self, servo: Servo) -> Self {
        self.servo = Some(servo);
        self
    }

    /// Positions, and ranges of a slide, times `factor`.
    pub(crate) fn scaled(mut self, factor: f64) -> Self {
        (self.at, self.child_at) = (self.at.scaled(factor), self.child_at.scaled(factor));
        if matches!(self.kind, JointKind::Prismatic(_)) {
            self.rest *= factor;
            if let Some(stops) = &mut self.stops {
                (stops.lower, stops.upper) = (factor * stops.lower, factor * stops.upper);
            }
            match &mut self.servo {
                Some(Servo::Position { center, range, .. }) => (*center, *range) = (factor * *center, factor * *range),
                Some(Servo::Rate { range, .. }) => *range *= factor,
                None => {}
            }
        }
        self
    }
}
