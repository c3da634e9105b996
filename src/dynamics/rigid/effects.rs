//! Which optional effects a model carries.

use serde::{Deserialize, Serialize};

/// Which optional effects a model carries. Switched off, they cost nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Effects {
    /// Linear and angular drag of the airframe: F = −D₁ v_a, M = −D_ω ω.
    pub body_drag: bool,
    /// Quadratic drag of the airframe: F = −C ‖v_a‖ v_a.
    pub quadratic_drag: bool,
    /// Rotor drag F = −Ω (k_d v⊥ + k_z v∥) at each hub (Martin and Salaün 2010; RotorS, Furrer et al. 2016).
    pub rotor_drag: bool,
    /// Rolling moment M = −σ Ω μ v⊥ at each hub. Not dissipative: it may feed rotation from translation.
    pub rolling_moment: bool,
    /// Angular momentum of the rotors: −Ḣ − ω × H.
    pub rotor_inertia: bool,
    /// Thrust gained near the ground (Cheeseman and Bennett 1955).
    pub ground_effect: bool,
    /// Wind, and force and moment from outside: [`Disturbance`](super::Disturbance).
    pub disturbance: bool,
    /// Wakes of the drones of one environment on each other (`downwash`); in a
    /// [`Multibody`](crate::tree::Multibody), or a [`Fleet`](crate::Fleet) through its own setting.
    pub downwash: bool,
    /// Wakes of drones on what they carry and on whatever else has shapes and no rotors, their own loads included: the far wake's
    /// dynamic pressure T/A on the area that faces it, of rotors that have a radius (`aero::downwash`); in a [`Multibody`](crate::tree::Multibody) only.
    pub load_downwash: bool,
    /// Forces between shapes that touch, and on the ground; in a [`Multibody`](crate::tree::Multibody) only.
    pub contact: bool,
    /// Set by [`RigidModel::effects_of`](super::RigidModel::effects_of) where a rotor is not along body z; ask for it where rotors of later
    /// vehicles of a batch may be tilted.
    #[serde(skip)]
    pub tilted_rotors: bool,
    /// Set by [`RigidModel::effects_of`](super::RigidModel::effects_of) where the inertia has products; ask for it where that of later vehicles of a
    /// batch may.
    #[serde(skip)]
    pub products_of_inertia: bool,
}

impl Default for Effects {
    /// Airframe drag, rotor drag and rotor inertia: what every real flight has, in still air away from the ground.
    fn default() -> Self {
        Self { body_drag: true, quadratic_drag: true, rotor_drag: true, rotor_inertia: true, ..Self::none() }
    }
}

impl Effects {
    /// Rotors, gravity and rigid body alone.
    pub const fn none() -> Self {
        Self {
            body_drag: false,
            quadratic_drag: false,
            rotor_drag: false,
            rolling_moment: false,
            rotor_inertia: false,
            ground_effect: false,
            disturbance: false,
            downwash: false,
            load_downwash: false,
            contact: false,
            tilted_rotors: false,
            products_of_inertia: false,
        }
    }

    /// Every effect but contact, which needs shapes.
    pub const fn all() -> Self {
        Self {
            body_drag: true,
            quadratic_drag: true,
            rotor_drag: true,
            rolling_moment: true,
            rotor_inertia: true,
            ground_effect: true,
            disturbance: true,
            downwash: true,
            load_downwash: true,
            contact: false,
            tilted_rotors: true,
            products_of_inertia: true,
        }
    }

    /// What most batches use: [`Effects::none`] with linear airframe drag.
    pub const fn lean() -> Self {
        Self { body_drag: true, ..Self::none() }
    }

    /// Whether any effect needs the air velocity at the rotors.
    #[inline]
    pub(crate) fn rotor_air(self) -> bool {
        self.rotor_drag || self.rolling_moment
    }
}
