//! The axes in which a vehicle hovers level: what a controller of rigid vehicles calls the body's.
//!
//! Where hover leans ([`HoverTrim`]), a controller is built for the vehicle [`upright`](dynamics::Vehicle::upright), and sees its
//! motion in those axes: q_h = q ⊗ q*_hover, ω_h = R_hover ω. Position and velocity are those of the base origin as ever. Of a
//! vehicle that hovers level they are the body's axes, and nothing is computed.

use super::kinematics::Kinematics;
use autodiff::Scalar;
use base::error::{Error, Result};
use dynamics::spatial::{Quat, Vec3, conjugate, identity, multiply, rotate, rotate_back, up_axis};
use dynamics::{HoverTrim, Plant, Vehicle};
use flight::Commanded;

/// From body axes to those in which a vehicle hovers level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HoverAxes<S> {
    leans: bool,
    /// Body → hover axes.
    turn: Quat<S>,
}

impl HoverAxes<f64> {
    /// Of a vehicle; those of the body where it does not hover.
    pub fn of(vehicle: &Vehicle) -> Self {
        vehicle.hover().map_or(Self { leans: false, turn: identity() }, |hover| Self::at(&hover))
    }

    /// Of the vehicle that a plant is; those of the body of an articulated one.
    pub fn of_plant(plant: &Plant) -> Self {
        match plant {
            Plant::Rigid(m) => Self::of(m.vehicle()),
            Plant::Tree(_) => Self { leans: false, turn: identity() },
        }
    }

    /// Of a hover trim.
    pub fn at(hover: &HoverTrim) -> Self {
        Self { leans: !hover.is_level(), turn: hover.attitude }
    }

    /// Whether hover leans: its axes are not those of the body.
    pub fn leans(&self) -> bool {
        self.leans
    }

    /// Body → world in hover at yaw 0, `[w, x, y, z]`; `None` where it is level.
    pub fn attitude_in_hover(&self) -> Option<Quat<f64>> {
        self.leans.then_some(self.turn)
    }

    /// Refuses a vehicle that leans, for controllers that hold their drone level.
    pub(super) fn refuse(&self, vehicle: &Vehicle) -> Result<()> {
        if !self.leans {
            return Ok(());
        }
        let lean = up_axis(self.turn)[2].clamp(-1.0, 1.0).acos().to_degrees();
        let remedy = "Stand its rotors upright, or fly it without what it carries.";
        let (what, value) = (format!("drone '{}': hover", vehicle.name), format!("leaning by {lean:.3} °"));
        Err(Error::value(what, value, "level, to carry something on joints", remedy))
    }

    /// Commands of the levels, given in hover axes, in body axes.
    pub fn commanded(&self, of_hover_axes: Commanded) -> Commanded {
        let attitude = self.attitude(of_hover_axes.attitude);
        Commanded { attitude, angular_velocity: self.to_body(of_hover_axes.angular_velocity), ..of_hover_axes }
    }
}

impl<S: Scalar> HoverAxes<S> {
    /// The same over another scalar.
    #[inline]
    pub fn constant(axes: &HoverAxes<f64>) -> Self {
        Self { leans: axes.leans, turn: axes.turn.map(S::constant) }
    }

    /// The motion of the body, attitude and rates of its hover axes.
    pub fn kinematics(&self, body: &Kinematics<S>) -> Kinematics<S> {
        if !self.leans {
            return *body;
        }
        Kinematics {
            attitude: multiply(body.attitude, conjugate(self.turn)),
            angular_velocity: rotate(self.turn, body.angular_velocity),
            ..*body
        }
    }

    /// The body's attitude, `[w, x, y, z]`, for one of the hover axes.
    #[inline]
    pub fn attitude(&self, of_hover_axes: Quat<S>) -> Quat<S> {
        if self.leans { multiply(of_hover_axes, self.turn) } else { of_hover_axes }
    }

    /// A vector of hover axes in body axes.
    #[inline]
    pub fn to_body(&self, of_hover_axes: Vec3<S>) -> Vec3<S> {
        if self.leans { rotate_back(self.turn, of_hover_axes) } else { of_hover_axes }
    }
}
