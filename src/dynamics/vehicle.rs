//! A multirotor as plain data: its parts, rotors, drag and published gains.
//!
//! Total mass, centre of mass and inertia come from the parts, once ([`Vehicle::mass_properties`]); no other file may
//! state them again. Everything here is `f64` and serialisable; the kernels work on a
//! [`RigidModel`](super::rigid::RigidModel) built from it.

use super::domain::Domain;
use super::rotor::ROTOR_PARAMETERS;
use super::shape::Shape;
use base::error::{Error, Result, finite};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Most rotors of one rigid vehicle.
pub const MAX_ROTORS: usize = 16;
/// Most parts of one vehicle.
pub(crate) const MAX_PARTS: usize = 512;
/// Standard gravity of the library's defaults, m/s².
pub const GRAVITY: f64 = 9.81;

/// Symmetric inertia tensor about a body's own centre of mass, kg m², along the axes of the frame it is given in.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Inertia {
    /// ∫(y²+z²) dm.
    pub xx: f64,
    /// ∫(z²+x²) dm.
    pub yy: f64,
    /// ∫(x²+y²) dm.
    pub zz: f64,
    /// −∫xy dm.
    #[serde(default)]
    pub xy: f64,
    /// −∫xz dm.
    #[serde(default)]
    pub xz: f64,
    /// −∫yz dm.
    #[serde(default)]
    pub yz: f64,
}

impl Inertia {
    /// No products of inertia.
    pub const fn diagonal(xx: f64, yy: f64, zz: f64) -> Self {
        Self { xx, yy, zz, xy: 0.0, xz: 0.0, yz: 0.0 }
    }

    /// A point mass.
    pub const fn zero() -> Self {
        Self::diagonal(0.0, 0.0, 0.0)
    }

    /// As a symmetric 3×3 matrix, kg m².
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.xx, self.xy, self.xz, self.xy, self.yy, self.yz, self.xz, self.yz, self.zz)
    }

    /// From a symmetric matrix, kg m² (its upper triangle).
    pub fn from_matrix(m: &Matrix3<f64>) -> Self {
        Self { xx: m[(0, 0)], yy: m[(1, 1)], zz: m[(2, 2)], xy: m[(0, 1)], xz: m[(0, 2)], yz: m[(1, 2)] }
    }

    /// Checks that some mass distribution has this tensor: principal moments ≥ 0 and none larger than the sum of the
    /// other two (relative slack 1e-6, since files are rounded). `what` names the body in the error.
    ///
    /// # Errors
    /// [`Error::Value`], also for a number that is not finite.
    pub fn validate(&self, what: &str) -> Result<()> {
        finite(&format!("{what}: inertia"), &[self.xx, self.yy, self.zz, self.xy, self.xz, self.yz])?;
        let mut p: Vec<f64> = self.matrix().symmetric_eigenvalues().iter().copied().collect();
        p.sort_by(f64::total_cmp);
        let text = format!("a tensor of principal moments ({:.4e}, {:.4e}, {:.4e}) kg m²", p[0], p[1], p[2]);
        let slack = 1e-6 * p[2].abs();
        if p[0] < -slack {
            return Err(Error::value(
                format!("{what}: inertia"),
                text,
                "positive semi-definite",
                "Check the signs of the products of inertia and the units (kg m²).",
            ));
        }
        if p[2] > p[0] + p[1] + slack {
            return Err(Error::value(
                format!("{what}: inertia"),
                text,
                "such that no principal moment exceeds the sum of the other two (triangle inequality)",
                "No mass distribution has this tensor: recompute it from the geometry.",
            ));
        }
        Ok(())
    }
}

/// One rigid part: the airframe, a motor, a rotor, a payload bolted on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// Unique within the vehicle.
    pub name: String,
    /// kg, ≥ 0.
    pub mass: f64,
    /// Centre of mass of the part in the base frame, m.
    #[serde(default)]
    pub position: [f64; 3],
    /// About the part's own centre of mass, along the base axes.
    pub inertia: Inertia,
}

impl Part {
    /// A part of `mass` kg with its centre of mass at `position` (m, base frame); `inertia` as [`Part::inertia`].
    pub fn new(name: impl Into<String>, mass: f64, position: [f64; 3], inertia: Inertia) -> Self {
        Self { name: name.into(), mass, position, inertia }
    }
}

/// One rotor: thrust T = k_f Ω² along `axis`, reaction torque −σ κ T about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rotor {
    /// Unique within the vehicle.
    pub name: String,
    /// Hub in the base frame, m.
    pub position: [f64; 3],
    /// Thrust direction in the base frame, a unit vector; tilted rotors are not along z.
    #[serde(default = "up")]
    pub axis: [f64; 3],
    /// σ: +1 turns counter-clockwise seen from +axis and pushes the body clockwise, −1 the opposite.
    pub spin: f64,
    /// k_f, N s²/rad².
    pub thrust_coefficient: f64,
    /// κ = k_m/k_f, m.
    pub moment_per_thrust: f64,
    /// Ω_max, rad/s.
    pub max_speed: f64,
    /// Motor time constant while speeding up, s.
    pub time_constant_up: f64,
    /// Motor time constant while slowing down, s.
    pub time_constant_down: f64,
    /// Moment of inertia of rotor and motor bell about the axis, kg m²; 0 leaves its torques out.
    #[serde(default)]
    pub inertia: f64,
    /// Blade tip radius, m; 0 leaves the ground effect out, and wakes on loads.
    #[serde(default)]
    pub radius: f64,
    /// Rotor drag across the axis: F = −Ω k_d v⊥, N s²/(m rad).
    #[serde(default)]
    pub drag_coefficient: f64,
    /// Rotor drag along the axis: F = −Ω k_z v∥, N s²/(m rad).
    #[serde(default)]
    pub axial_drag_coefficient: f64,
    /// Rolling moment: M = −σ Ω μ v⊥, N s²/rad.
    #[serde(default)]
    pub rolling_coefficient: f64,
}

fn up() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

impl Rotor {
    /// Largest thrust k_f Ω_max², N.
    pub fn max_thrust(&self) -> f64 {
        self.thrust_coefficient * self.max_speed * self.max_speed
    }

    /// Checks every number; `owner` begins the message: `vehicle 'x': `.
    pub(crate) fn validate(&self, owner: &str) -> Result<()> {
        let rotor = self;
        let at = |what: &str| format!("{owner}rotor '{}': {what}", rotor.name);
        finite(&at("position"), &rotor.position)?;
        finite(&at("axis"), &rotor.axis)?;
        let length = Vector3::from(rotor.axis).norm();
        if (length - 1.0).abs() > 1e-6 {
            return Err(Error::value(
                at("axis"),
                format!("of length {length}"),
                "a unit vector",
                "Divide it by its length.",
            ));
        }
        if rotor.spin.abs() != 1.0 {
            return Err(Error::value(
                at("spin"),
                rotor.spin,
                "+1 (counter-clockwise seen from +axis) or -1",
                "Swap the sign if the vehicle yaws away.",
            ));
        }
        for parameter in ROTOR_PARAMETERS.iter().filter(|p| p.domain == Domain::Positive) {
            let (what, value) = (at(parameter.name), (parameter.get)(rotor));
            finite(&what, &[value])?;
            if value <= 0.0 {
                let remedy = "Give the value of the real motor and propeller in SI units.";
                return Err(Error::value(what, value, Domain::Positive.rule(), remedy));
            }
        }
        within(&at("time_constant_up"), rotor.time_constant_up, 1e-6, 1e12)?;
        within(&at("time_constant_down"), rotor.time_constant_down, 1e-6, 1e12)?;
        within(&at("max_speed"), rotor.max_speed, 1e-6, 1e8)?;
        within(&at("largest thrust"), rotor.max_thrust(), 1e-30, 1e12)?;
        for coordinate in rotor.position {
            within(&at("distance from the base origin"), coordinate.abs(), 0.0, 1e4)?;
        }
        let losses = ROTOR_PARAMETERS.iter().filter(|p| p.domain == Domain::NonNegative);
        for (name, value) in losses.map(|p| (p.name, (p.get)(rotor))).chain([("radius", rotor.radius)]) {
            non_negative(&at(name), &[value])?;
            within(&at(name), value, 0.0, 1e6)?;
        }
        Ok(())
    }
}

/// Drag of the airframe. Velocities are relative to the air, in the body frame, at the centre of mass.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Drag {
    /// D₁ of F = −D₁ v (per axis), N s/m.
    pub linear: [f64; 3],
    /// C of F = −C ‖v‖ v (per axis), N s²/m².
    pub quadratic: [f64; 3],
    /// D_ω of M = −D_ω ω (per axis), N m s.
    pub angular: [f64; 3],
}

/// Gains of the cascade position → velocity → attitude → rate, per axis (x, y, z).
///
/// a = a_ref + K_p (p_ref − p) + K_v (v_ref − v) − d̂_a; M = −K_R e_R − K_ω (ω − ω_ref) + ω × Jω − J d̂_ω, with d̂ what
/// integral action has learnt.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    /// K_p, 1/s².
    pub position: [f64; 3],
    /// K_v, 1/s.
    pub velocity: [f64; 3],
    /// K_R, N m/rad.
    pub attitude: [f64; 3],
    /// K_ω, N m s/rad.
    pub rate: [f64; 3],
    /// L of force and of moment, 1/s: how fast the cascade of one rigid vehicle learns the acceleration and the angular
    /// acceleration that its model misses (wind, mass, a shifted centre of mass), to take them off. Both zero, the default in
    /// files: no integral action.
    #[serde(default)]
    pub integral: [f64; 2],
}

impl Gains {
    /// K_p, K_v, K_R, K_ω, three each, and, with integral action, L of force and moment: 12 or 14 numbers.
    pub fn flat(&self) -> Vec<f64> {
        let levels = [self.position, self.velocity, self.attitude, self.rate];
        let more = if self.is_integral() { &self.integral[..] } else { &[] };
        [levels.as_flattened(), more].concat()
    }

    /// The inverse of [`flat`](Self::flat); without a 13th and 14th number no integral action.
    ///
    /// # Panics
    /// With fewer than twelve numbers.
    pub fn from_flat(numbers: &[f64]) -> Self {
        let three = |at: usize| [numbers[at], numbers[at + 1], numbers[at + 2]];
        let integral = if let [force, moment] = numbers[12..] { [force, moment] } else { [0.0; 2] };
        Self { position: three(0), velocity: three(3), attitude: three(6), rate: three(9), integral }
    }

    /// Whether there is integral action.
    pub fn is_integral(&self) -> bool {
        self.integral != [0.0; 2]
    }
}

/// A rigid multirotor with its rotors at fixed tilts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vehicle {
    /// Lower case, as in the registry and on the command line.
    pub name: String,
    /// Where the numbers come from.
    #[serde(default)]
    pub source: String,
    /// Rigid parts; rotors count as parts too where their mass matters.
    pub parts: Vec<Part>,
    /// 1 to [`MAX_ROTORS`] rotors.
    pub rotors: Vec<Rotor>,
    /// Drag of the airframe.
    #[serde(default)]
    pub drag: Drag,
    /// What collides, in the base frame; none passes through everything.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shapes: Vec<Shape>,
    /// Published gains; without them [`Vehicle::gains`] derives some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published_gains: Option<Gains>,
}

/// Mass, centre of mass and inertia of a whole vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MassProperties {
    /// kg.
    pub mass: f64,
    /// In the base frame, m.
    pub center_of_mass: Vector3<f64>,
    /// About the centre of mass, along the base axes, kg m².
    pub inertia: Matrix3<f64>,
}

impl Vehicle {
    /// Sums the parts: m = Σmᵢ, c = Σmᵢrᵢ/m, J = Σ(Jᵢ + mᵢ(‖dᵢ‖²I − dᵢdᵢᵀ)) with dᵢ = rᵢ − c (Huygens–Steiner).
    pub fn mass_properties(&self) -> MassProperties {
        let mass: f64 = self.parts.iter().map(|p| p.mass).sum();
        let center_of_mass = self.parts.iter().map(|p| Vector3::from(p.position) * p.mass).sum::<Vector3<f64>>() / mass;
        let inertia = self
            .parts
            .iter()
            .map(|p| {
                let d = Vector3::from(p.position) - center_of_mass;
                p.inertia.matrix() + (Matrix3::identity() * d.norm_squared() - d * d.transpose()) * p.mass
            })
            .sum();
        MassProperties { mass, center_of_mass, inertia }
    }

    /// Number of rotors.
    pub fn n_rotor(&self) -> usize {
        self.rotors.len()
    }

    /// Sum of the rotors' largest thrusts, N.
    pub fn max_thrust(&self) -> f64 {
        self.rotors.iter().map(Rotor::max_thrust).sum()
    }

    /// Σ T_max/(m g), g = 9.81 m/s².
    pub fn thrust_to_weight(&self) -> f64 {
        self.max_thrust() / (self.mass_properties().mass * GRAVITY)
    }

    /// The wrench of unit thrusts about the centre of mass, 6 rows `[force; moment]` × n rotors, base axes:
    /// column i = [nᵢ; (rᵢ − c) × nᵢ − σᵢ κᵢ nᵢ].
    pub fn allocation_matrix(&self) -> nalgebra::DMatrix<f64> {
        let c = self.mass_properties().center_of_mass;
        nalgebra::DMatrix::from_fn(6, self.n_rotor(), |row, i| {
            let rotor = &self.rotors[i];
            let n = Vector3::from(rotor.axis);
            let moment = (Vector3::from(rotor.position) - c).cross(&n) - n * (rotor.spin * rotor.moment_per_thrust);
            if row < 3 { n[row] } else { moment[row - 3] }
        })
    }

    /// Checks every number: finite, physical, within limits. Kernels built from a valid vehicle cannot divide by zero.
    ///
    /// # Errors
    /// [`Error::Limit`] for no part or rotor or too many ([`MAX_ROTORS`]); [`Error::Value`] that names the number, the rule and what to do
    /// for all else.
    pub fn validate(&self) -> Result<()> {
        let at = |what: &str| format!("vehicle '{}': {what}", self.name);
        if self.parts.is_empty() || self.parts.len() > MAX_PARTS {
            return Err(Error::limit(
                at("number of parts"),
                self.parts.len(),
                format!("1 to {MAX_PARTS}"),
                "Give at least the airframe; merge parts that move together.",
            ));
        }
        if self.rotors.is_empty() || self.rotors.len() > MAX_ROTORS {
            return Err(Error::limit(
                at("number of rotors"),
                self.rotors.len(),
                format!("1 to {MAX_ROTORS}"),
                "List the rotors under [[rotors]].",
            ));
        }
        for part in &self.parts {
            self.validate_part(part)?;
        }
        let total = self.mass_properties();
        if total.mass <= 0.0 {
            return Err(Error::value(at("total mass"), total.mass, "> 0 kg", "Give the airframe its mass."));
        }
        within(&at("total mass"), total.mass, 1e-9, 1e6)?;
        let total_inertia = Inertia::from_matrix(&total.inertia);
        total_inertia.validate(&at("whole vehicle"))?;
        if total.inertia.symmetric_eigenvalues().min() <= 0.0 {
            return Err(Error::value(
                at("whole vehicle: inertia"),
                format!("{:.3e} about one axis", total.inertia.symmetric_eigenvalues().min()),
                "> 0 kg m² about every axis",
                "Give the airframe an inertia tensor.",
            ));
        }
        for moment in total.inertia.symmetric_eigenvalues().iter() {
            within(&at("whole vehicle: principal moment of inertia"), *moment, 1e-18, 1e9)?;
        }
        for rotor in &self.rotors {
            rotor.validate(&format!("vehicle '{}': ", self.name))?;
        }
        for (i, shape) in self.shapes.iter().enumerate() {
            shape.validate(&at(&format!("shapes[{i}]")))?;
        }
        let drag = &self.drag;
        for (name, values) in
            [("drag.linear", drag.linear), ("drag.quadratic", drag.quadratic), ("drag.angular", drag.angular)]
        {
            non_negative(&at(name), &values)?;
        }
        if let Some(gains) = &self.published_gains {
            for (name, values) in [
                ("gains.position", gains.position),
                ("gains.velocity", gains.velocity),
                ("gains.attitude", gains.attitude),
                ("gains.rate", gains.rate),
                ("gains.integral", [gains.integral[0], gains.integral[1], 0.0]),
            ] {
                non_negative(&at(name), &values)?;
            }
        }
        Ok(())
    }

    fn validate_part(&self, part: &Part) -> Result<()> {
        let at = |what: &str| format!("vehicle '{}': part '{}': {what}", self.name, part.name);
        finite(&at("position"), &part.position)?;
        non_negative(&at("mass"), &[part.mass])?;
        part.inertia.validate(&format!("vehicle '{}': part '{}'", self.name, part.name))
    }
}

/// Sizes beyond which reciprocals and squares leave the range of `f32` lanes.
fn within(what: &str, value: f64, least: f64, most: f64) -> Result<()> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    let limit = format!("between {least:e} and {most:e} in SI units");
    Err(Error::value(what, value, limit, "Check the units; no multirotor is that small or large."))
}

fn non_negative(what: &str, values: &[f64]) -> Result<()> {
    finite(what, values)?;
    match values.iter().find(|v| **v < 0.0) {
        None => Ok(()),
        Some(v) => Err(Error::value(what, v, "≥ 0", "It has no negative values: check the sign.")),
    }
}
