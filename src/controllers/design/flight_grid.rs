//! Circles on a grid of acceleration and speed: gains tuned on half of the cells, as on a chessboard, are judged on the other half.
//!
//! A level circle flown at speed V under the acceleration a has the radius V²/a and turns at a/V. It begins at full speed, so that
//! a cell asks for its own acceleration alone. A cell counts as one that the vehicle can fly where its steady turn exists, drag
//! included and with the heading along the path, of the vehicle as believed, with the asked share of every rotor's thrust to spare; it is
//! flown with a fixed heading.

use super::trim::{TrimTarget, trim};
use crate::reference::{Circle, Reference};
use base::error::{Error, Result};
use dynamics::{Physics, Plant, Vehicle};
use serde::{Deserialize, Serialize};

/// Which circles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlightGrid {
    /// Accelerations of the circles, towards their centres, m/s²; within [0.1, 100], each once. Default 2, 4, 6, 8.
    pub accelerations: Vec<f64>,
    /// Speeds along the circles, m/s; within [0.1, 100], each once. Default 2.5, 5, 7.5, 10.
    pub speeds: Vec<f64>,
    /// Share of its largest thrust that every rotor keeps in the steady turn of a cell that can be flown; within [0, 0.9].
    /// Default 0.2.
    pub spare: f64,
}

impl Default for FlightGrid {
    /// 2, 4, 6 and 8 m/s² at 2.5, 5, 7.5 and 10 m/s, a fifth of the thrust to spare.
    fn default() -> Self {
        Self { accelerations: vec![2.0, 4.0, 6.0, 8.0], speeds: vec![2.5, 5.0, 7.5, 10.0], spare: 0.2 }
    }
}

/// One circle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GridCell {
    /// Towards the centre, m/s².
    pub acceleration: f64,
    /// Along the circle, m/s.
    pub speed: f64,
    /// Whether it is of the half that is not tuned on.
    pub held_out: bool,
    /// Largest share of its thrust that a rotor gives in the steady turn; `None` where there is no such turn.
    pub thrust: Option<f64>,
    /// Whether that leaves what is asked to spare.
    pub flyable: bool,
}

impl GridCell {
    /// The circle, flown from the first instant at its speed.
    pub fn reference(&self) -> Reference {
        let spin_up = Circle::default().spin_up;
        Reference::Circle(Circle {
            radius: self.speed * self.speed / self.acceleration,
            rate: self.acceleration / self.speed,
            spin_up,
            ahead: spin_up,
            ..Circle::default()
        })
    }
}

/// Most cells of a grid.
pub const MAX_CELLS: usize = 256;

impl FlightGrid {
    /// Checks the ranges given with the fields, and that there are at most 256 cells.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] that names the number.
    pub fn validate(&self) -> Result<()> {
        for (what, values) in [("grid.accelerations", &self.accelerations), ("grid.speeds", &self.speeds)] {
            if values.is_empty() || values.iter().any(|v| !(0.1..=100.0).contains(v)) {
                let rule = "one or more within [0.1, 100]";
                return Err(Error::value(what, format!("{values:?}"), rule, "As [2, 4, 6, 8]."));
            }
            if (1..values.len()).any(|k| values[..k].contains(&values[k])) {
                let remedy = "A circle that is tuned on would be judged on, too.";
                return Err(Error::value(what, format!("{values:?}"), "each once", remedy));
            }
        }
        if !(0.0..=0.9).contains(&self.spare) {
            return Err(Error::value("grid.spare", self.spare, "within [0, 0.9]", "Leave it out for the default."));
        }
        let n = self.accelerations.len() * self.speeds.len();
        if n > MAX_CELLS {
            return Err(Error::limit("cells of the grid", n, MAX_CELLS, "Name fewer accelerations or speeds."));
        }
        Ok(())
    }

    /// All cells, those of an acceleration together.
    ///
    /// # Errors
    /// As [`validate`](Self::validate); [`Error::Value`] unless the vehicle can fly a cell of either half.
    pub fn cells(&self, vehicle: &Vehicle, physics: &Physics) -> Result<Vec<GridCell>> {
        self.validate()?;
        let plant = Plant::of_vehicle(vehicle, *physics)?;
        let mut cells = Vec::new();
        for (row, acceleration) in self.accelerations.iter().enumerate() {
            for (column, speed) in self.speeds.iter().enumerate() {
                let thrust = thrust_in_turn(&plant, *acceleration, *speed);
                let flyable = thrust.is_some_and(|share| share <= 1.0 - self.spare);
                let held_out = (row + column) % 2 == 1;
                cells.push(GridCell { acceleration: *acceleration, speed: *speed, held_out, thrust, flyable });
            }
        }
        let n_of = |half: bool| cells.iter().filter(|c| c.flyable && c.held_out == half).count();
        if n_of(false) == 0 || n_of(true) == 0 {
            let value = format!("{} to tune on, {} to judge on", n_of(false), n_of(true));
            let remedy = "Name lower accelerations and speeds, or more of them.";
            return Err(Error::value(format!("cells that '{}' can fly", vehicle.name), value, "one of each", remedy));
        }
        Ok(cells)
    }
}

/// The largest share of its thrust that a rotor gives in a steady turn, the heading along the path.
fn thrust_in_turn(plant: &Plant, acceleration: f64, speed: f64) -> Option<f64> {
    let turn = TrimTarget { yaw_rate: acceleration / speed, ..TrimTarget::at_velocity([speed, 0.0, 0.0]) };
    let steady = trim(plant, &turn).ok()?;
    let shares = plant.rotor_places().into_iter().map(|r| 0.5 * (steady.input[r.action] + 1.0));
    Some(shares.fold(0.0, f64::max))
}
