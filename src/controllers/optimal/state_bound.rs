//! Soft bounds of numbers of the state, by their names.

use super::planned_plant::PlannedPlant;
use super::stage_qp::SoftBound;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// A soft bound of a number of the plant's state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StateBound {
    /// Its name, as `omnidrones models NAME` and logs have it: `velocity_x`.
    pub state: String,
    /// Least value that costs nothing; any without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lower: Option<f64>,
    /// Largest value that costs nothing; any without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub upper: Option<f64>,
    /// Of the square beyond, in every stage; 1000 unless given.
    #[serde(default = "thousand")]
    pub weight: f64,
}

fn thousand() -> f64 {
    1000.0
}

/// Those of a planned plant.
///
/// # Errors
/// [`Error::Unknown`] for a number that its state does not have; [`Error::Value`] for bounds out of order or without any.
pub(super) fn soft_bounds(plant: &PlannedPlant, bounds: &[StateBound]) -> Result<Vec<SoftBound>> {
    let all = plant.plant().state_quantities();
    let names: Vec<&str> = plant.kept().iter().map(|k| all[*k].name.as_str()).collect();
    let of = |bound: &StateBound| {
        let state = names.iter().position(|name| *name == bound.state).ok_or_else(|| Error::Unknown {
            kind: "number of the state",
            name: bound.state.clone(),
            known: names.iter().map(|name| name.to_string()).collect(),
        })?;
        let (lower, upper) = (bound.lower.unwrap_or(f64::NEG_INFINITY), bound.upper.unwrap_or(f64::INFINITY));
        if !(lower <= upper && (lower.is_finite() || upper.is_finite())) {
            let (what, value) = (format!("state_bound of {}", bound.state), format!("[{lower}, {upper}]"));
            return Err(Error::value(
                what,
                value,
                "lower ≤ upper, one of them given",
                "Give what costs nothing between.",
            ));
        }
        Ok(SoftBound { state, lower, upper, weight: bound.weight })
    };
    bounds.iter().map(of).collect()
}
