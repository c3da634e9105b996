//! What a sensor tells of the motion of a body itself: by how much that differs from an estimate.
//!
//! Filters with fixed gains take readings in this form. At r from the body's origin, with axes M (mount → body):
//!
//! | sensor | what it tells | ν |
//! |---|---|---|
//! | position | p, m, world | y − p − R r |
//! | velocity | v, m/s, world | y − v − ω × R r |
//! | attitude | rotation vector, rad, world axes | R 2 vec(q* ⊗ y ⊗ q_M*) |
//! | rate | ω, rad/s, body | M y − Rᵀ ω |
//! | field | heading, rad, about the world's z | angle from R M y to B, both seen from above |
//! | pressure | height, m | (y − p(z))/(dp/dz) |
//! | distance | height, m | y cos(max(θ − α, 0)) − z |
//!
//! Optical flow tells velocity over height, no number of the motion alone: it is left out.

use super::aiding::{Aid, AidKind};
use autodiff::{Array, Scalar, safe};
use dynamics::Frame;
use dynamics::spatial::{Quat, Vec3, conjugate, constants, multiply, rotate, sub};

/// What a fix is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FixKind {
    Position,
    Velocity,
    Attitude,
    Heading,
    Height,
}

impl FixKind {
    /// Of what a sensor tells; none of optical flow.
    pub fn of(kind: &AidKind) -> Option<Self> {
        Some(match kind {
            AidKind::Position => Self::Position,
            AidKind::Velocity => Self::Velocity,
            AidKind::Attitude => Self::Attitude,
            AidKind::Field(_) => Self::Heading,
            AidKind::Pressure(_) | AidKind::Distance { .. } => Self::Height,
            AidKind::Flow { .. } => return None,
        })
    }

    /// Numbers that it has.
    pub fn n(self) -> usize {
        match self {
            Self::Position | Self::Velocity | Self::Attitude => 3,
            Self::Heading | Self::Height => 1,
        }
    }

    /// Their names.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Self::Position => &["position_x", "position_y", "position_z"],
            Self::Velocity => &["velocity_x", "velocity_y", "velocity_z"],
            Self::Attitude => &["attitude_x", "attitude_y", "attitude_z"],
            Self::Heading => &["heading"],
            Self::Height => &["height"],
        }
    }

    /// Their unit.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Position | Self::Height => "m",
            Self::Velocity => "m/s",
            Self::Attitude | Self::Heading => "rad",
        }
    }
}

/// cos of the steepest lean at which a distance is believed to be one of height.
const FLATTEST: f64 = 0.2;

/// ν of a reading about the estimate `at` of what carries the sensor; heading and height are its first number, the others are 0 then.
pub(crate) fn innovation<S: Scalar>(aid: &Aid, at: &Frame<S>, reading: &[S]) -> Vec3<S> {
    let (place, swift) = at.point(constants(aid.lever));
    let mount: Quat<S> = aid.rotation.map(S::constant);
    let one = |x: S| [x, S::zero(), S::zero()];
    match &aid.kind {
        AidKind::Position => sub(reading.array(0), place),
        AidKind::Velocity => sub(reading.array(0), swift),
        AidKind::Attitude => {
            let told = multiply(reading.array(0), conjugate(mount));
            let off = multiply(conjugate(at.attitude), told);
            // on the shorter way: the sine of half the turn, twice
            let side = S::select(off[0].lt(S::zero()), S::constant(-2.0), S::constant(2.0));
            rotate(at.attitude, [side * off[1], side * off[2], side * off[3]])
        }
        AidKind::Field(field) => {
            let seen: Vec3<S> = rotate(at.attitude, rotate(mount, reading.array(0)));
            let [bx, by] = [S::constant(field[0]), S::constant(field[1])];
            let (across, along) = (seen[0] * by - seen[1] * bx, seen[0] * bx + seen[1] * by);
            one(across.atan2(along))
        }
        AidKind::Pressure(barometer) => {
            let [pressure, slope] = barometer.pressure_at(place[2]);
            one((reading[0] - pressure) * slope.recip())
        }
        AidKind::Distance { ground, half_cone, .. } => {
            let axis = rotate(mount, [S::zero(), S::zero(), S::one()]);
            let c = rotate(at.attitude, axis)[2];
            let (sin, cos) = half_cone.sin_cos();
            let s = safe::sqrt(S::one() - c * c, 1e-6);
            let leaned = c * S::constant(cos) + s * S::constant(sin);
            let leaned = leaned.clamp(S::constant(FLATTEST), S::one());
            let share = S::select(S::constant(cos).lt(c), S::one(), leaned);
            one(reading[0] * share + S::constant(*ground) - place[2])
        }
        AidKind::Flow { .. } => [S::zero(); 3],
    }
}
