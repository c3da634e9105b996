//! The figures of a flight: path, tracking error, rotors, attitude, and all of them on one page.

use super::{Colour, Figure, Panel, Path3d, Pose, Series};
use omnidrones::error::Result;
use omnidrones::flight::FlightLog;
use std::path::{Path, PathBuf};

/// Most vehicles drawn along a path.
const POSES: usize = 9;
/// Least ranges of axes, m, degrees and rad/s: what a steady hover is within is rounding.
pub(super) const LEAST_LENGTH: f64 = 1e-4;
pub(super) const LEAST_ANGLE: f64 = 0.01;
const LEAST_RATE: f64 = 1e-4;

/// The six figures of a flight, with the key figures over t ≥ `after` (s).
#[derive(Debug, Clone, PartialEq)]
pub struct FlightFigures {
    /// Everything on one page.
    pub overview: Figure,
    /// The path in space against its reference.
    pub path: Figure,
    /// Error per axis and its norm.
    pub error: Figure,
    /// Commands and speeds of the rotors.
    pub rotors: Figure,
    /// Roll, pitch, yaw.
    pub attitude: Figure,
    /// Body rates.
    pub rates: Figure,
}

impl FlightFigures {
    /// Makes the figures; the first `after` seconds are shaded and left out of the RMSE.
    pub fn new(log: &FlightLog, after: f64) -> Self {
        let name = if log.vehicle.is_empty() { "Flight" } else { log.vehicle.as_str() };
        let numbers = key_figures(log, after);
        let figure = |what: &str| Figure::new(format!("{name}: {what}")).subtitle(&numbers);
        let error_overview = error_panel(log, after, true);
        // The page gives the path a tall room: seen from higher up it fills it.
        let overview_path = Path3d { elevation_deg: 38.0, azimuth_deg: -52.0, ..path_chart(log) };
        let path = Path3d { title: String::new(), ..path_chart(log) };
        let panels = [position_panel(log), error_overview, rotor_panel(log), attitude_panel(log)];
        Self {
            overview: beside(figure("closed-loop flight"), overview_path, panels.into_iter().chain(wind_panel(log))),
            path: figure("path").size(800.0, 560.0).chart(path),
            error: figure("tracking error")
                .chart(without_x_label(error_panel(log, after, false)))
                .chart(axis_error_panel(log, after)),
            rotors: rotor_figure(figure("rotors"), log),
            attitude: stacked(figure("attitude"), angle_panels(log)),
            rates: stacked(figure("body rates"), rate_panels(log)),
        }
    }

    /// With an upright line at a time in every chart over time: a failure. An empty name stays out of the legends.
    pub fn event(mut self, name: &str, time: f64) -> Self {
        for figure in [&mut self.overview, &mut self.error, &mut self.rotors, &mut self.attitude, &mut self.rates] {
            figure.for_each_panel(|panel| {
                // legends of charts with a shaded start are full
                let name = if panel.bands.is_empty() { name } else { "" };
                *panel = std::mem::take(panel).event(name, time, Colour::VERMILLION);
            });
        }
        self
    }

    /// The figures with their file names (without extension).
    pub fn named(&self) -> [(&'static str, &Figure); 6] {
        [
            ("overview", &self.overview),
            ("path", &self.path),
            ("error", &self.error),
            ("rotors", &self.rotors),
            ("attitude", &self.attitude),
            ("rates", &self.rates),
        ]
    }

    /// Writes all six into `folder`, as `png` or `svg`; returns their paths.
    pub fn save(&self, folder: impl AsRef<Path>, extension: &str) -> Result<Vec<PathBuf>> {
        let mut written = Vec::new();
        for (name, figure) in self.named() {
            let path = folder.as_ref().join(format!("{name}.{extension}"));
            figure.save(&path)?;
            written.push(path);
        }
        Ok(written)
    }
}

/// Three charts over time below each other.
fn stacked(figure: Figure, [first, second, third]: [Panel; 3]) -> Figure {
    figure.size(800.0, 560.0).chart(without_x_label(first)).chart(without_x_label(second)).chart(third)
}

/// A path at the left, panels over time below each other at its right.
pub(super) fn beside(figure: Figure, path: Path3d, panels: impl Iterator<Item = Panel>) -> Figure {
    let panels: Vec<Panel> = panels.collect();
    let n = panels.len();
    let figure = figure.size(1000.0, 60.0 + 160.0 * n as f64).grid(&[1.06, 1.0], &vec![1.0; n]);
    panels.into_iter().enumerate().fold(figure.place((0, 0), (1, n), path), |figure, (i, panel)| {
        figure.place((1, i), (1, 1), if i + 1 < n { without_x_label(panel) } else { panel })
    })
}

/// Where it was and where it should have been, per axis.
pub(super) fn position_panel(log: &FlightLog) -> Panel {
    let of = |rows: &[[f64; 3]], k: usize| timed(log, rows.iter().map(|p| p[k]));
    let mut panel = Panel::new("Position", "time [s]", "position [m]").least_span(LEAST_LENGTH);
    for (k, name) in ["x", "y", "z"].into_iter().enumerate() {
        panel = panel.series(Series::line(name, of(&log.position, k)).colour(Colour::nth(k)).width(1.2));
    }
    for k in 0..3 {
        panel = panel
            .series(Series::line("reference", of(&log.reference_position, k)).colour(Colour::INK).dashed().width(0.8));
    }
    panel
}

/// The air, where it moved.
pub(super) fn wind_panel(log: &FlightLog) -> Option<Panel> {
    if log.wind.iter().flatten().all(|v| *v == 0.0) {
        return None;
    }
    let axis = |(k, name): (usize, &str)| {
        Series::line(name, timed(log, log.wind.iter().map(|w| w[k]))).colour(Colour::nth(k)).width(1.1)
    };
    let mut panel = Panel::new("Wind", "time [s]", "speed [m/s]");
    panel.series = ["x", "y", "z"].into_iter().enumerate().map(axis).collect();
    Some(panel)
}

/// One line: RMSE, largest error, speed and tilt, saturation, broken samples.
pub(super) fn key_figures(log: &FlightLog, after: f64) -> String {
    let s = log.summary(after);
    let from = if after > 0.0 { format!(" after {after} s") } else { String::new() };
    let mut parts = vec![match s.rmse {
        Some(v) => format!("tracking RMSE {}{from}", length(v)),
        None => "tracking RMSE undefined".to_string(),
    }];
    parts.extend(s.max_error.map(|v| format!("max error {}", length(v))));
    parts.extend(s.max_speed.map(|v| format!("max speed {v:.2} m/s")));
    parts.extend(s.max_tilt.map(|v| format!("max tilt {:.1}°", v.to_degrees())));
    parts.extend(s.saturation.map(|v| format!("rotors saturated {:.1} % of the time", 100.0 * v)));
    if s.non_finite_samples > 0 {
        parts.push(format!("{} samples not finite", s.non_finite_samples));
    }
    parts.join("   ·   ")
}

/// Millimetres below a decimetre, else metres.
fn length(metres: f64) -> String {
    if metres < 0.1 { format!("{:.1} mm", 1e3 * metres) } else { super::axis::short(metres) + " m" }
}

pub(super) fn without_x_label(mut panel: Panel) -> Panel {
    panel.x_label.clear();
    panel
}

/// Flown path coloured by speed, dashed reference, up to nine vehicles at equal distances along the path.
pub fn path_chart(log: &FlightLog) -> Path3d {
    Path3d::new("Path", log.position.clone())
        .reference(log.reference_position.clone())
        .heat("speed [m/s]", log.speed())
        .poses(poses(log))
        .rotors(log.n_rotor())
}

/// Poses at equal distances along the last lap, fewer where the path comes close to itself.
pub(super) fn poses(log: &FlightLog) -> Vec<Pose> {
    let p = &log.position;
    let step = |i: usize| {
        let d = (0..3).map(|k| (p[i][k] - p[i - 1][k]).powi(2)).sum::<f64>().sqrt();
        if d.is_finite() { d } else { 0.0 }
    };
    let total: f64 = (1..p.len()).map(step).sum();
    if !(total > 1e-6 && total.is_finite()) {
        // who stands is drawn once
        let stands = total.is_finite() && p.last().is_some_and(|at| at.iter().all(|v| v.is_finite()));
        let last = p.last().zip(log.attitude.last()).filter(|_| stands);
        return last
            .map(|(position, attitude)| Pose { position: *position, attitude: *attitude })
            .into_iter()
            .collect();
    }
    let lap = last_lap(log);
    let lap_length: f64 = (lap.start + 1..lap.end).map(step).sum();
    let spacing = lap_length / POSES as f64;
    let (mut out, mut travelled): (Vec<Pose>, f64) = (Vec::new(), 0.5 * spacing);
    for (i, here) in p.iter().enumerate().take(lap.end).skip(lap.start + 1) {
        travelled += step(i);
        if travelled >= spacing {
            travelled -= spacing;
            let apart = |q: &Pose| (0..3).map(|k| (here[k] - q.position[k]).powi(2)).sum::<f64>().sqrt();
            if out.iter().all(|q| apart(q) > 0.5 * spacing) {
                out.push(Pose { position: *here, attitude: log.attitude[i] });
            }
        }
    }
    out
}

/// The samples since the reference last stood where it ends (with the same direction of motion): one lap of a periodic
/// reference, the whole flight otherwise.
fn last_lap(log: &FlightLog) -> std::ops::Range<usize> {
    let (r, v) = (&log.reference_position, &log.reference_velocity);
    let n = r.len();
    let Some(last) = n.checked_sub(1) else { return 0..0 };
    let distance = |i: usize| (0..3).map(|k| (r[i][k] - r[last][k]).powi(2)).sum::<f64>().sqrt();
    let along = |i: usize| (0..3).map(|k| v[i][k] * v[last][k]).sum::<f64>() > 0.0;
    let size = (0..n).map(distance).filter(|d| d.is_finite()).fold(0.0, f64::max);
    let mut left = false;
    for i in (0..n).rev() {
        left |= distance(i) > 0.25 * size;
        if left && distance(i) < 0.02 * size && along(i) {
            return i..n;
        }
    }
    0..n
}

pub(super) fn timed(log: &FlightLog, values: impl Iterator<Item = f64>) -> Vec<(f64, f64)> {
    log.time.iter().copied().zip(values).collect()
}

fn excluded(panel: Panel, log: &FlightLog, after: f64) -> Panel {
    match log.time.first() {
        Some(first) if after > *first => {
            panel.x_band(format!("first {after} s, not counted"), *first, after, Colour::PALE)
        }
        _ => panel,
    }
}

/// ‖p − p_ref‖ over time with its RMSE, in centimetres; with the axes too when `with_axes`.
pub(super) fn error_panel(log: &FlightLog, after: f64, with_axes: bool) -> Panel {
    let title = if with_axes { "Tracking error" } else { "Distance to the reference" };
    let unit = Unit::of(log);
    let mut panel = Panel::new(title, "time [s]", unit.label).least_span(unit.scale * LEAST_LENGTH);
    if with_axes {
        panel.series = axis_errors(log, unit);
    } else {
        panel = panel.from_zero();
    }
    let norm = timed(log, log.error_norm().into_iter().map(|e| unit.scale * e));
    panel = panel.series(Series::line("norm", norm).colour(Colour::INK).width(1.6));
    if let Some(rmse) = log.rmse(after) {
        if !with_axes {
            panel = panel.y_band("", 0.0, unit.scale * rmse, Colour::ORANGE);
        }
        panel = panel.level(format!("RMSE {}", length(rmse)), unit.scale * rmse, Colour::VERMILLION);
    }
    cut_transient(excluded(panel, log, after), log, after)
}

/// What an error is drawn in: centimetres, or metres where the flight went far.
#[derive(Debug, Clone, Copy)]
struct Unit {
    label: &'static str,
    name: &'static str,
    scale: f64,
}

impl Unit {
    fn of(log: &FlightLog) -> Self {
        if log.max_error(f64::NEG_INFINITY).is_some_and(|most| most > FAR) {
            Self { label: "error [m]", name: "m", scale: 1.0 }
        } else {
            Self { label: "error [cm]", name: "cm", scale: 100.0 }
        }
    }
}

/// Errors beyond this are drawn in metres, m.
const FAR: f64 = 2.0;

/// Fits y to what happens from `after` on when the flight began more than three times farther away, and says so in the
/// title: a far start would press the errors that count into a flat line. What the reference does later, a step, stays.
fn cut_transient(mut panel: Panel, log: &FlightLog, after: f64) -> Panel {
    let unit = Unit::of(log);
    if let (Some(late), Some(first)) = (log.max_error(after), log.error_norm().first().copied())
        && late > 0.0
        && first > 3.0 * late.max(LEAST_LENGTH)
    {
        let most = 1.5 * unit.scale * late.max(LEAST_LENGTH);
        panel.y_range = Some((if panel.from_zero { 0.0 } else { -most }, most));
        panel.title += &format!(" (start cut off, {} {})", super::axis::short(unit.scale * first), unit.name);
    }
    panel
}

fn axis_errors(log: &FlightLog, unit: Unit) -> Vec<Series> {
    let errors = log.tracking_error();
    let axis = |k: usize, name: &str| {
        Series::line(name, timed(log, errors.iter().map(|e| unit.scale * e[k]))).colour(Colour::nth(k)).width(1.2)
    };
    vec![axis(0, "x"), axis(1, "y"), axis(2, "z")]
}

fn axis_error_panel(log: &FlightLog, after: f64) -> Panel {
    let unit = Unit::of(log);
    let mut panel = Panel::new("Error per axis", "time [s]", unit.label).least_span(unit.scale * LEAST_LENGTH);
    panel.series = axis_errors(log, unit);
    cut_transient(excluded(panel, log, after), log, after)
}

/// More rotors than this are a knot of curves.
const MANY: usize = 8;
/// Rotors of a panel where they are many: those of one drone, mostly.
const GROUP: usize = 4;

/// Speeds and commands, all rotors in one panel each; of many rotors, a panel for every few.
fn rotor_figure(figure: Figure, log: &FlightLog) -> Figure {
    let n = log.n_rotor();
    if n <= MANY {
        return figure.chart(without_x_label(command_panel(log))).chart(speed_panel(log));
    }
    let groups = n.div_ceil(GROUP);
    let rows = groups.div_ceil(2);
    let figure = figure.size(1000.0, 60.0 + 190.0 * rows as f64).grid(&[1.0, 1.0], &vec![1.0; rows]);
    (0..groups).fold(figure, |figure, g| {
        let own = g * GROUP..((g + 1) * GROUP).min(n);
        let title = format!("Speed of rotors {} to {}", own.start, own.end - 1);
        let mut panel = Panel::new(title, "time [s]", "speed [rad/s]").from_zero();
        for i in own {
            panel = panel.series(Series::line(i.to_string(), log.rotor_history(&log.rotor_speed, i)).width(1.1));
        }
        let limit = log.max_rotor_speed[g * GROUP];
        let panel = panel.level("limit", limit, Colour::GREY);
        figure.place((g % 2, g / 2), (1, 1), if g / 2 + 1 < rows { without_x_label(panel) } else { panel })
    })
}

/// Least, mean and most of all rotors.
fn rotor_spread(log: &FlightLog, column: &[f64], title: &str) -> Panel {
    let n = log.n_rotor();
    let over = |fold: fn(&[f64]) -> f64| timed(log, column.chunks_exact(n).map(fold));
    let least = |row: &[f64]| row.iter().copied().fold(f64::INFINITY, f64::min);
    let most = |row: &[f64]| row.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mean = |row: &[f64]| row.iter().sum::<f64>() / row.len() as f64;
    let spread = over(least).into_iter().zip(over(most)).map(|((t, lo), (_, hi))| (t, lo, hi)).collect();
    let limit = most(&log.max_rotor_speed);
    Panel::new(format!("{title} of {n} rotors"), "time [s]", "speed [rad/s]")
        .from_zero()
        .ribbon("least to most", spread, Colour::BLUE)
        .series(Series::line("mean", over(mean)).colour(Colour::BLUE).width(1.4))
        .level("limit", limit, Colour::GREY)
}

/// One line per rotor of a row-major rotor column, with the limits.
fn rotor_lines(log: &FlightLog, column: &[f64], title: &str, width: f64) -> Panel {
    let mut panel = Panel::new(title, "time [s]", "speed [rad/s]").from_zero();
    for i in 0..log.n_rotor() {
        let line = Series::line(i.to_string(), log.rotor_history(column, i)).width(width);
        // The palette repeats after seven: the rest is dashed.
        panel = panel.series(if i < 7 { line } else { line.dashed() });
    }
    let mut limits = log.max_rotor_speed.clone();
    limits.sort_by(f64::total_cmp);
    limits.dedup();
    for limit in limits {
        panel = panel.level("limit", limit, Colour::GREY);
    }
    panel
}

pub(super) fn rotor_panel(log: &FlightLog) -> Panel {
    if log.n_rotor() > MANY {
        return rotor_spread(log, &log.rotor_speed, "Speeds");
    }
    rotor_lines(log, &log.rotor_speed, "Rotor speeds", 1.1)
}

fn command_panel(log: &FlightLog) -> Panel {
    rotor_lines(log, &log.rotor_command, "Commanded speed of each rotor", 1.2)
}

fn speed_panel(log: &FlightLog) -> Panel {
    rotor_lines(log, &log.rotor_speed, "Speed of each rotor", 1.2)
}

/// Angles in degrees; jumps by a full turn become gaps.
pub(super) fn degrees(log: &FlightLog, angles: &[[f64; 3]], k: usize) -> Vec<(f64, f64)> {
    let mut points = timed(log, angles.iter().map(|a| a[k].to_degrees()));
    for i in 1..points.len() {
        if (points[i].1 - points[i - 1].1).abs() > 180.0 {
            points[i - 1].1 = f64::NAN;
        }
    }
    points
}

const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];

/// Name of the curves of what a cascade's levels asked.
const COMMANDED: &str = "commanded";

/// Dashed, behind what came of it.
fn asked_series(name: &str, points: Vec<(f64, f64)>, width: f64) -> Series {
    Series::line(name, points).colour(Colour::INK).dashed().width(width)
}

/// Roll, pitch and yaw, each with what was commanded (dashed) and what the reference asks: pale, where both are there.
fn angle_panels(log: &FlightLog) -> [Panel; 3] {
    let (actual, asked, commanded) = (log.euler_angles(), log.reference_euler_angles(), log.commanded_euler_angles());
    [0, 1, 2].map(|k| {
        let name = ANGLES[k];
        let title = name[..1].to_uppercase() + &name[1..];
        let panel = Panel::new(title, "time [s]", format!("{name} [°]")).least_span(LEAST_ANGLE);
        let wanted = degrees(log, &asked, k);
        let panel = if commanded.is_empty() {
            panel.series(asked_series(BY_REFERENCE, wanted, 1.0))
        } else {
            panel.series(Series::line(BY_REFERENCE, wanted).colour(Colour::SHADOW).width(2.6)).series(asked_series(
                COMMANDED,
                degrees(log, &commanded, k),
                1.0,
            ))
        };
        panel.series(Series::line("flown", degrees(log, &actual, k)).colour(Colour::nth(k)))
    })
}

/// Name of the curves of the attitude that a vehicle without drag would need.
const BY_REFERENCE: &str = "asked by the reference";

/// Body rates, each with what was commanded (dashed).
fn rate_panels(log: &FlightLog) -> [Panel; 3] {
    [0, 1, 2].map(|k| {
        let axis = ["x", "y", "z"][k];
        let mut panel =
            Panel::new(format!("Rate about body {axis}"), "time [s]", "rate [rad/s]").least_span(LEAST_RATE);
        if !log.commanded.is_empty() {
            let asked = timed(log, log.commanded.iter().map(|c| c.angular_velocity[k]));
            panel = panel.series(asked_series(COMMANDED, asked, 1.0));
        }
        let flown = timed(log, log.angular_velocity.iter().map(|w| w[k]));
        panel.series(Series::line("flown", flown).colour(Colour::nth(k)))
    })
}

/// All angles, behind them what was commanded, or what the reference asks where nothing is known of commands.
pub(super) fn attitude_panel(log: &FlightLog) -> Panel {
    let (actual, commanded) = (log.euler_angles(), log.commanded_euler_angles());
    let (name, asked) =
        if commanded.is_empty() { ("reference", log.reference_euler_angles()) } else { (COMMANDED, commanded) };
    let mut panel = Panel::new("Attitude", "time [s]", "angle [°]").least_span(LEAST_ANGLE);
    for k in 0..3 {
        panel = panel.series(asked_series(name, degrees(log, &asked, k), 0.8));
    }
    for (k, name) in ANGLES.iter().enumerate() {
        panel = panel.series(Series::line(*name, degrees(log, &actual, k)).colour(Colour::nth(k)));
    }
    panel
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_drawn_flat_and_what_is_larger_over_its_own_range() {
        let span = |size: f64| {
            let points = (0..9).map(|i| (f64::from(i), 2.0 + size * f64::from(i % 2))).collect();
            let panel = Panel::new("", "", "").least_span(LEAST_LENGTH).series(Series::line("", points));
            let axis = panel.y_axis(200.0);
            size / (axis.unit(2.0 + size) - axis.unit(2.0))
        };
        // measured: 1.12e-4 for 1e-14 and 1e-7, 1.12 times the range beyond
        for (size, whole) in [(1e-12, LEAST_LENGTH), (1e-7, LEAST_LENGTH), (1e-3, 1e-3), (1.0, 1.0)] {
            assert!((span(size) / whole - 1.12).abs() < 0.02, "{size}: {}", span(size));
        }
    }

    #[test]
    fn who_stands_is_drawn_once_and_who_has_no_place_is_not() {
        let mut log = FlightLog::new("four", &[800.0; 4]);
        assert!(poses(&log).is_empty());
        (log.position, log.attitude) = (vec![[0.0, 0.0, 2.0]; 9], vec![[1.0, 0.0, 0.0, 0.0]; 9]);
        assert_eq!(poses(&log), [Pose { position: [0.0, 0.0, 2.0], attitude: [1.0, 0.0, 0.0, 0.0] }]);
        log.position = vec![[f64::NAN; 3]; 9];
        assert!(poses(&log).is_empty());
    }

    #[test]
    fn curves_of_rotors_count_from_0() {
        let panel = rotor_panel(&FlightLog::new("four", &[800.0; 4]));
        assert_eq!(panel.series.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["0", "1", "2", "3"]);
    }
}
