//! The numbers of a controller as scalars: gains, body and limits.

use autodiff::Scalar;
use base::defaults::with_defaults;
use base::error::{Error, Result, finite};
use dynamics::spatial::{Mat3, Vec3, constants};
use dynamics::vehicle::Rotor;
use dynamics::{GRAVITY, Gains, Vehicle};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// [`Gains`] over any scalar, per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GainSet<S> {
    /// K_p, 1/s², world.
    pub position: Vec3<S>,
    /// K_v, 1/s, world.
    pub velocity: Vec3<S>,
    /// K_R, N m/rad, body.
    pub attitude: Vec3<S>,
    /// K_ω, N m s/rad, body.
    pub rate: Vec3<S>,
}

impl<S: Scalar> GainSet<S> {
    /// Numbers in the flat form: K_p, K_v, K_R, K_ω.
    pub const DIM: usize = 12;

    /// The same gains over another scalar.
    pub fn constant(gains: &Gains) -> Self {
        Self {
            position: constants(gains.position),
            velocity: constants(gains.velocity),
            attitude: constants(gains.attitude),
            rate: constants(gains.rate),
        }
    }

    /// Writes the flat form into the first [`Self::DIM`] numbers of `out`.
    ///
    /// # Panics
    /// If `out` is shorter than that.
    pub fn write(&self, out: &mut [S]) {
        for i in 0..3 {
            out[i] = self.position[i];
            out[3 + i] = self.velocity[i];
            out[6 + i] = self.attitude[i];
            out[9 + i] = self.rate[i];
        }
    }

    /// Names of the flat form, with something before each: `gains.position_x`.
    pub fn names(prefix: &str) -> Vec<String> {
        let levels = ["position", "velocity", "attitude", "rate"];
        let of = |level: &str| ["x", "y", "z"].map(|axis| format!("{prefix}gains.{level}_{axis}"));
        levels.into_iter().flat_map(of).collect()
    }

    /// The inverse of [`write`](Self::write).
    ///
    /// # Panics
    /// If `x` is shorter than [`Self::DIM`].
    pub fn read(x: &[S]) -> Self {
        Self {
            position: [x[0], x[1], x[2]],
            velocity: [x[3], x[4], x[5]],
            attitude: [x[6], x[7], x[8]],
            rate: [x[9], x[10], x[11]],
        }
    }
}

/// Checks gains before a cascade divides by them: finite, K_p and K_R ≥ 0, K_v and K_ω > 0.
pub(crate) fn validate_gains(gains: &Gains) -> Result<()> {
    let rows = [
        ("gains.position", gains.position, false),
        ("gains.velocity", gains.velocity, true),
        ("gains.attitude", gains.attitude, false),
        ("gains.rate", gains.rate, true),
        ("gains.integral", [gains.integral[0], gains.integral[1], 0.0], false),
    ];
    for (what, values, divides) in rows {
        finite(what, &values)?;
        for (i, value) in values.iter().enumerate() {
            if *value < 0.0 || (divides && *value == 0.0) {
                return Err(Error::value(
                    format!("{what}[{i}]"),
                    value,
                    if divides { "> 0" } else { "≥ 0" },
                    "The cascade divides position by velocity gains and attitude by rate gains.",
                ));
            }
        }
    }
    Ok(())
}

/// What a controller believes about the body it steers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyModel<S> {
    /// kg.
    pub mass: S,
    /// J about the centre of mass, body axes, kg m².
    pub inertia: Mat3<S>,
    /// Linear drag D of F = −D v, per body axis, N s/m: airframe plus rotors at hover speed. Zero switches the drag
    /// feed-forward off.
    pub drag: Vec3<S>,
    /// C of the moment M = −C v that rotor drag above or below the centre of mass makes, body axes, N s. Zero switches its
    /// compensation off.
    pub drag_moment: Mat3<S>,
    /// g, m/s².
    pub gravity: S,
}

impl BodyModel<f64> {
    /// Mass and inertia from the parts; drag linearised at hover: D = D₁ + Σ Ω_h (k_d (I − nnᵀ) + k_z nnᵀ), its
    /// diagonal; the moment of the rotors' part is C = Σ [r − c]× Ω_h (k_d (I − nnᵀ) + k_z nnᵀ). Ω_h is the speed at which the rotors, at
    /// equal shares of their largest thrust, carry the weight.
    pub fn of(vehicle: &Vehicle) -> Self {
        let total = vehicle.mass_properties();
        let mut drag = vehicle.drag.linear;
        let mut drag_moment = Matrix3::zeros();
        for (rotor, resistance) in rotor_resistances(vehicle) {
            let hub = Vector3::from(rotor.position) - total.center_of_mass;
            drag_moment += hub.cross_matrix() * resistance;
            for (k, d) in drag.iter_mut().enumerate() {
                *d += resistance[(k, k)];
            }
        }
        let rows = |m: Matrix3<f64>| [0, 1, 2].map(|row| [m[(row, 0)], m[(row, 1)], m[(row, 2)]]);
        Self { mass: total.mass, inertia: rows(total.inertia), drag, drag_moment: rows(drag_moment), gravity: GRAVITY }
    }
}

/// Each rotor with its Ω_h (k_d (I − nnᵀ) + k_z nnᵀ), N s/m, as in [`BodyModel::of`].
pub(super) fn rotor_resistances(vehicle: &Vehicle) -> impl Iterator<Item = (&Rotor, Matrix3<f64>)> {
    let weight = vehicle.mass_properties().mass * GRAVITY;
    let lift: f64 = vehicle.rotors.iter().map(|r| r.max_thrust() * r.axis[2]).sum();
    let fraction = if lift > 0.0 { (weight / lift).min(1.0) } else { 0.0 };
    vehicle.rotors.iter().map(move |rotor| {
        let axis = Vector3::from(rotor.axis);
        let along = axis * axis.transpose();
        let across = Matrix3::identity() - along;
        let speed = rotor.max_speed * fraction.sqrt();
        (rotor, (across * rotor.drag_coefficient + along * rotor.axial_drag_coefficient) * speed)
    })
}

impl<S: Scalar> BodyModel<S> {
    /// The same body over another scalar.
    pub fn constant(body: &BodyModel<f64>) -> Self {
        Self {
            mass: S::constant(body.mass),
            inertia: [constants(body.inertia[0]), constants(body.inertia[1]), constants(body.inertia[2])],
            drag: constants(body.drag),
            drag_moment: [
                constants(body.drag_moment[0]),
                constants(body.drag_moment[1]),
                constants(body.drag_moment[2]),
            ],
            gravity: S::constant(body.gravity),
        }
    }
}

with_defaults! {
    /// How far the velocity level may tilt and push.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct CommandLimits {
        /// Largest tilt of the wanted thrust from the vertical, rad; (0, 1.5]. Default 1.2 (69°).
        pub tilt: f64 = 1.2,
        /// Least vertical specific force as a fraction of g; (0, 1). Default 0.1: the vehicle falls at 0.9 g at most and
        /// never turns over, and the direction of the wanted force always exists.
        pub vertical: f64 = 0.1,
        /// Largest wanted force as a fraction of the rotors' total; (0, 1]. Default 0.9: the rest is left for moments. Exceeded
        /// where it would not carry the weight: see [`ForceLimits::constant`].
        pub thrust: f64 = 0.9,
    }
}

impl CommandLimits {
    /// Checks the ranges given with the fields.
    ///
    /// # Errors
    /// [`Error::Value`] that names the first outside.
    pub fn validate(&self) -> Result<()> {
        let rows = [
            ("limits.tilt", self.tilt, 1.5, "within (0, 1.5] rad"),
            ("limits.vertical", self.vertical, 0.999, "within (0, 0.999]"),
            ("limits.thrust", self.thrust, 1.0, "within (0, 1]"),
        ];
        for (what, value, most, rule) in rows {
            if !(value > 0.0 && value <= most) {
                return Err(Error::value(what, value, rule, "Leave it out for the default."));
            }
        }
        Ok(())
    }
}

/// Largest vertical part of the wanted force as a share of the whole: some is left to steer sideways.
pub(crate) const CEILING: f64 = 0.95;
/// What the wanted force may exceed the weight by at least, where half of what the rotors lift beyond it allows that.
const MARGIN: f64 = 0.05;
/// Least thrust over weight that is flown: below it, what keeps the height leaves nothing to steer with.
pub(crate) const LEAST_LIFT: f64 = 1.05;

/// [`CommandLimits`] in the units of the kernel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceLimits<S> {
    /// tan of the largest tilt.
    pub tilt_tangent: S,
    /// Least vertical specific force, m/s².
    pub vertical: S,
    /// Largest vertical part as a share of the largest norm.
    pub ceiling: S,
    /// Largest norm of the wanted force, N.
    pub force: S,
    /// Largest total thrust along body z, N.
    pub thrust: S,
}

impl ForceLimits<f64> {
    /// As constants of another scalar.
    pub fn cast<S: Scalar>(&self) -> ForceLimits<S> {
        ForceLimits {
            tilt_tangent: S::constant(self.tilt_tangent),
            vertical: S::constant(self.vertical),
            ceiling: S::constant(self.ceiling),
            force: S::constant(self.force),
            thrust: S::constant(self.thrust),
        }
    }
}

impl<S: Scalar> ForceLimits<S> {
    /// From the ratios of `limits`, the total thrust T along body z and the weight W, N.
    ///
    /// The vertical part is at most 0.95 · `limits.thrust` · T. Where that is less than W + min(0.05 W, (T − W)/2), it is
    /// that much, and as much of T as it takes: what holds the height comes before what is kept for moments.
    pub fn constant(limits: &CommandLimits, total_thrust: f64, weight: f64) -> Self {
        let usual = limits.thrust * total_thrust;
        let needed = weight + (MARGIN * weight).min(0.5 * (total_thrust - weight));
        let (force, ceiling) = if CEILING * usual >= needed {
            (usual, CEILING)
        } else {
            let force = usual.max((needed / CEILING).min(total_thrust));
            (force, (needed / force).min(1.0))
        };
        Self {
            tilt_tangent: S::constant(limits.tilt.tan()),
            vertical: S::constant(limits.vertical * GRAVITY),
            ceiling: S::constant(ceiling),
            force: S::constant(force),
            thrust: S::constant(total_thrust),
        }
    }
}
