//! Two flights over each other.

use super::flight::{LEAST_ANGLE, LEAST_LENGTH, degrees, timed, without_x_label};
use super::{Colour, Figure, Panel, Series};
use omnidrones::flight::FlightLog;

/// A flight and what the legend calls it.
#[derive(Debug, Clone, Copy)]
pub struct Named<'a> {
    /// Short.
    pub name: &'a str,
    /// What was flown.
    pub log: &'a FlightLog,
}

/// Of the flight that is compared.
const NEW: Colour = Colour::BLUE;
/// Of the one that it is compared with.
const EARLIER: Colour = Colour::VERMILLION;

/// Position, distance to the reference, attitude and tilt of a flight over those of an earlier one. The reference is that of
/// the first.
pub fn beside(flight: Named<'_>, earlier: Named<'_>) -> Figure {
    let both = [(earlier, EARLIER), (flight, NEW)];
    let title = format!("{}: two flights", flight.log.vehicle);
    let figure = Figure::new(title).subtitle(format!("{} over {}", flight.name, earlier.name));
    let figure = figure.size(1000.0, 760.0).grid(&[1.0, 1.0], &[1.0; 4]);
    let overlaid = |mut panel: Panel, of: &dyn Fn(&FlightLog) -> Vec<(f64, f64)>| {
        for (Named { name, log }, colour) in both {
            panel = panel.series(Series::line(name, of(log)).colour(colour).width(1.2));
        }
        panel
    };
    let chart = |title: &str, unit: &str| Panel::new(title, "time [s]", unit);
    let axis = |k: usize| {
        let of = |rows: &[[f64; 3]], log: &FlightLog| timed(log, rows.iter().map(|row| row[k]));
        let wanted = of(&flight.log.reference_position, flight.log);
        let wanted = Series::line("reference", wanted).colour(Colour::INK).dashed().width(0.8);
        let panel = chart(["x", "y", "z"][k], "position [m]").least_span(LEAST_LENGTH).series(wanted);
        overlaid(panel, &|log| of(&log.position, log))
    };
    let angle = |k: usize| {
        let panel = chart(["Roll", "Pitch", "Yaw"][k], "angle [°]").least_span(LEAST_ANGLE);
        overlaid(panel, &|log| degrees(log, &log.euler_angles(), k))
    };
    let distance = chart("Distance to the reference", "error [cm]").least_span(100.0 * LEAST_LENGTH).from_zero();
    let distance = overlaid(distance, &|log| timed(log, log.error_norm().into_iter().map(|e| 100.0 * e)));
    let tilt = overlaid(chart("Tilt", "angle [°]").least_span(LEAST_ANGLE).from_zero(), &|log| {
        timed(log, log.tilt().into_iter().map(f64::to_degrees))
    });
    let figure = (0..3).fold(figure, |figure, k| {
        figure.place((0, k), (1, 1), without_x_label(axis(k))).place((1, k), (1, 1), without_x_label(angle(k)))
    });
    figure.place((0, 3), (1, 1), distance).place((1, 3), (1, 1), tilt)
}
