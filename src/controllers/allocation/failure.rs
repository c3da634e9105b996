//! Rotors that fail: what is left of a vehicle, rotor by rotor and pair by pair.
//!
//! A rotor that has lost effectiveness 1 − e has the upper bound e T_max; the geometry keeps its column. Hover is asked
//! for in the rows thrust, roll, pitch and yaw, then without yaw, which is the axis to give up first: a vehicle that
//! turns about its thrust still holds its place (Mueller and D'Andrea 2014). One that must spin *in order* to fly (a quadrotor on
//! three rotors, after the same source) is asked for a [`Spin`] that carries it.
//!
//! Where the margin with yaw is negative, hover leaves a yaw moment, and the vehicle spins up until drag holds it; how
//! fast is not part of the analysis.

use super::Axis;
use super::attainable_wrench::{AttainableWrenches, WrenchMargin};
use super::problem::{Problem, WRENCH};
use super::spin::{ROOM, Spin};
use base::error::{Error, Result};
pub use dynamics::plant::damaged;
use dynamics::{GRAVITY, Vehicle};
use serde::{Deserialize, Serialize};

/// Least margin that counts, as a share of the weight: published rotor positions are rounded by more.
pub const LEAST_MARGIN: f64 = 0.01;

/// A rotor that weakens or stops in flight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotorFailure {
    /// Index of the rotor, from 0.
    pub rotor: usize,
    /// When, s from the start of the flight.
    pub at: f64,
    /// What is left of its largest thrust, in [0, 1). Default 0.
    #[serde(default)]
    pub effectiveness: f64,
}

impl RotorFailure {
    /// A rotor that stops at a time, s.
    pub fn lost(rotor: usize, at: f64) -> Self {
        Self { rotor, at, effectiveness: 0.0 }
    }

    /// Checks the index and the ranges given with the fields.
    ///
    /// # Errors
    /// [`Error::Value`] that names the number.
    pub fn validate(&self, n_rotor: usize) -> Result<()> {
        if self.rotor >= n_rotor {
            let limit = format!("0 to {}", n_rotor.saturating_sub(1));
            return Err(Error::value("failure: rotor", self.rotor, limit, "Rotors count from 0."));
        }
        if !(self.at >= 0.0 && self.at.is_finite()) {
            return Err(Error::value("failure: at", self.at, "≥ 0 s", "Give the time in the flight."));
        }
        if !(0.0..1.0).contains(&self.effectiveness) {
            let remedy = "0 is a lost rotor, 0.6 one of which 60 % are left.";
            return Err(Error::value("failure: effectiveness", self.effectiveness, "in [0, 1)", remedy));
        }
        Ok(())
    }
}

/// Effectiveness of each rotor at a time, 1 for whole ones. Damage does not heal: of several failures of a rotor the
/// worst so far holds.
pub fn health(n_rotor: usize, failures: &[RotorFailure], time: f64) -> Vec<f64> {
    let mut health = vec![1.0_f64; n_rotor];
    for failure in failures.iter().filter(|f| f.at <= time) {
        if let Some(e) = health.get_mut(failure.rotor) {
            *e = e.min(failure.effectiveness);
        }
    }
    health
}

/// The allocation problem that is left: upper bounds eᵢ T_max.
///
/// # Errors
/// [`Error::Value`] if the vehicle is not valid, or `health` is not one number in [0, 1] per rotor.
pub fn problem(vehicle: &Vehicle, health: &[f64]) -> Result<Problem> {
    let n = vehicle.n_rotor();
    if health.len() != n || health.iter().any(|e| !(0.0..=1.0).contains(e)) {
        return Err(Error::value(
            "effectiveness of the rotors",
            format!("{health:?}"),
            format!("{n} numbers in [0, 1]"),
            "1 is a whole rotor, 0 a lost one.",
        ));
    }
    let mut problem = Problem::of_vehicle(vehicle)?;
    for (upper, e) in problem.upper.iter_mut().zip(health) {
        *upper *= e;
    }
    Ok(problem)
}

/// What a vehicle can hold at hover.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Capability {
    /// Thrust, roll, pitch and yaw.
    Full,
    /// Thrust, roll and pitch; it turns about its thrust.
    YawSacrificed,
    /// Thrust, roll and pitch while it turns fast enough about an axis beside its thrust: [`Spin`].
    Spinning,
    /// Not even those by more than `LEAST_MARGIN`, and no turn that carries it was found: turns about axes near a principal one are
    /// sought, so that there may be others.
    None,
}

impl Capability {
    /// From the best down.
    pub const ALL: [Self; 4] = [Self::Full, Self::YawSacrificed, Self::Spinning, Self::None];

    /// For tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full control",
            Self::YawSacrificed => "yaw sacrificed",
            Self::Spinning => "could fly while it spins",
            Self::None => "no steered hover found",
        }
    }
}

/// What is left of a vehicle with some rotors weakened or lost.
#[derive(Debug, Clone, PartialEq)]
pub struct Assessment {
    /// Effectiveness of each rotor, `[n_rotor]`: the share of its largest thrust that is left, 0 to 1.
    pub health: Vec<f64>,
    /// What it can hold.
    pub capability: Capability,
    /// Hover over thrust, roll, pitch and yaw.
    pub steered: WrenchMargin,
    /// Hover over thrust, roll and pitch.
    pub without_yaw: WrenchMargin,
    /// The turn that carries it, where its capability is [`Capability::Spinning`].
    pub spin: Option<Spin>,
    /// Most thrust along body z without roll and pitch moment, N; 0 where not even the weight is attainable.
    pub lift: f64,
}

impl Assessment {
    /// Of a vehicle whose rotor i has effectiveness `health[i]`, 0 (stopped) to 1 (whole).
    ///
    /// # Errors
    /// As `problem` and [`AttainableWrenches::of`].
    pub fn of(vehicle: &Vehicle, health: &[f64]) -> Result<Self> {
        let vehicle = &vehicle.upright();
        let problem = problem(vehicle, health)?;
        let hover = hover(vehicle);
        let weight = hover[2];
        let steered = WrenchMargin::of(&problem, &Axis::STEERED, &hover)?;
        let three = AttainableWrenches::of(&problem, &Axis::STEERED[..3])?;
        let without_yaw = WrenchMargin::within(&problem, &three, &hover)?;
        let more = three.farthest(&hover, &[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        let least = LEAST_MARGIN * weight;
        let enough = |reach: &WrenchMargin| reach.margin.distance > least;
        let inertia = vehicle.mass_properties().inertia;
        // upright it spins up and needs as much room as in a turn about another axis; where it has less, that turn is the better one
        let roomy = enough(&steered) || without_yaw.margin.distance > ROOM * weight;
        let spin = if roomy { None } else { Spin::of(&problem, &three, &hover, &inertia, least)? };
        let capability = match () {
            () if enough(&steered) => Capability::Full,
            () if spin.is_some() => Capability::Spinning,
            () if enough(&without_yaw) => Capability::YawSacrificed,
            () => Capability::None,
        };
        let lift = more.map_or(0.0, |more| weight + more);
        Ok(Self { health: health.to_vec(), capability, steered, without_yaw, spin, lift })
    }

    /// Rotors that are not whole.
    pub fn broken(&self) -> Vec<usize> {
        (0..self.health.len()).filter(|i| self.health[*i] < 1.0).collect()
    }
}

/// Every single and double loss of a vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct FailureTable {
    /// Nothing lost.
    pub whole: Assessment,
    /// Rotor i lost, by i.
    pub single: Vec<Assessment>,
    /// Rotors i < j lost, by i, then j.
    pub double: Vec<Assessment>,
}

impl FailureTable {
    /// Assesses every one of them.
    ///
    /// # Errors
    /// As [`Assessment::of`].
    pub fn of(vehicle: &Vehicle) -> Result<Self> {
        let n = vehicle.n_rotor();
        let without = |lost: &[usize]| {
            let health: Vec<f64> = (0..n).map(|i| if lost.contains(&i) { 0.0 } else { 1.0 }).collect();
            Assessment::of(vehicle, &health)
        };
        let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| [i, j]));
        Ok(Self {
            whole: without(&[])?,
            single: (0..n).map(|i| without(&[i])).collect::<Result<_>>()?,
            double: pairs.map(|pair| without(&pair)).collect::<Result<_>>()?,
        })
    }

    /// How many losses of a list end in each of [`Capability::ALL`].
    pub fn counts(losses: &[Assessment]) -> [usize; 4] {
        Capability::ALL.map(|capability| losses.iter().filter(|a| a.capability == capability).count())
    }
}

/// The wrench that holds a vehicle in [`Vehicle::hover`], N, body axes: its weight along body z where it hovers level, or not at all.
pub fn hover(vehicle: &Vehicle) -> [f64; WRENCH] {
    let weight = vehicle.mass_properties().mass * GRAVITY;
    match vehicle.hover() {
        Ok(hover) if !hover.is_level() => {
            let [x, y, z] = hover.up;
            [x * weight, y * weight, z * weight, 0.0, 0.0, 0.0]
        }
        _ => [0.0, 0.0, weight, 0.0, 0.0, 0.0],
    }
}
