//! `omnidrones tune --grid`: circles of given accelerations and speeds, half to tune on, half to judge on.

use crate::prelude::*;
use omnidrones::controllers::design::{FlightGrid, GridCell, Tuning};
use omnidrones::dynamics::{Physics, Vehicle};

/// Which circles.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Grid")]
pub struct GridArguments {
    /// Tune on every other cell of a grid of accelerations and speeds, judge on the rest
    #[arg(long)]
    grid: bool,
    /// Accelerations of the circles [m/s²], separated by commas
    #[arg(long, value_name = "LIST", value_delimiter = ',', requires = "grid", default_values_t = FlightGrid::default().accelerations)]
    accelerations: Vec<f64>,
    /// Speeds of the circles [m/s], separated by commas
    #[arg(long, value_name = "LIST", value_delimiter = ',', requires = "grid", default_values_t = FlightGrid::default().speeds)]
    speeds: Vec<f64>,
}

impl GridArguments {
    /// The cells; none without `--grid`.
    pub fn cells(&self, vehicle: &Vehicle, physics: &Physics) -> Result<Vec<GridCell>> {
        if !self.grid {
            return Ok(Vec::new());
        }
        let (accelerations, speeds) = (self.accelerations.clone(), self.speeds.clone());
        FlightGrid { accelerations, speeds, ..FlightGrid::default() }.cells(vehicle, physics)
    }
}

/// Cell by cell: the error before and after, or why it was not flown.
pub fn table(cells: &[GridCell], tuning: &Tuning) -> Table {
    let mut table = Table::new(">a [m/s²] | >V [m/s] | >thrust | cell | >RMSE before | >after | >less | >lost");
    for cell in cells {
        let thrust = cell.thrust.map_or("none".into(), |share| format!("{:.0} %", 100.0 * share));
        let place = [short(cell.acceleration, 3), short(cell.speed, 3), thrust];
        let of = cell.reference();
        let flown = tuning.references.iter().find(|r| cell.flyable && r.reference == of && r.held_out == cell.held_out);
        let Some(flown) = flown else {
            table.row(place.into_iter().chain(["not flown".into()]));
            continue;
        };
        let (before, after) = (&flown.before, &flown.after);
        let half = if cell.held_out { "held out" } else { "tuned on" };
        table.row(place.into_iter().chain([
            half.into(),
            length(before.rmse),
            length(after.rmse),
            gained(before.rmse, after.rmse),
            format!("{} → {}", before.crashed, after.crashed),
        ]));
    }
    table
}

/// By how much an error fell; nothing to say where all flights of one side were lost.
fn gained(before: f64, after: f64) -> String {
    if before.is_finite() && after.is_finite() {
        format!("{:.0} %", 100.0 * (1.0 - after / before))
    } else {
        "–".into()
    }
}
