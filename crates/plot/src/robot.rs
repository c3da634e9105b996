//! The figures of an articulated system in flight, and of its fall.

use super::drawing::{Drawing, Item};
use super::flight::{
    FlightFigures, LEAST_ANGLE, attitude_panel, beside, error_panel, key_figures, path_chart, position_panel,
    rotor_panel, wind_panel,
};
use super::model::{items, obstacles, rotor_ring, sticks};
use super::{Colour, Figure, Panel, Path3d, Series};
use omnidrones::dynamics::tree::{Motion, Multibody};
use omnidrones::error::Result;
use omnidrones::flight::FlightLog;
use std::path::{Path, PathBuf};

/// A joint's angle or way over time, the two hinges of a universal joint as one deflection.
#[derive(Debug, Clone, PartialEq)]
pub struct JointHistory {
    /// Without the letter of a universal joint's axis.
    pub name: String,
    /// Whether it turns.
    pub turns: bool,
    /// From rest, rad or m, one per sample; never negative for two hinges.
    pub values: Vec<f64>,
}

/// Histories of all hinges and slides, from states row by row.
pub fn joints(system: &Multibody, states: &[f64]) -> Vec<JointHistory> {
    let (layout, rest, n) = (system.layout(), system.rest_state(), system.rest_state().len());
    let mut groups: Vec<(String, bool, Vec<usize>)> = Vec::new();
    for (i, body) in system.model().bodies().iter().enumerate() {
        let turns = match body.joint.motion {
            Motion::Revolute(_) => true,
            Motion::Prismatic(_) => false,
            Motion::Floating | Motion::Ball => continue,
        };
        let (stem, at) = (body.joint.name.split('.').next().unwrap_or_default(), layout.bodies[i].position);
        match groups.iter_mut().find(|g| g.0 == stem) {
            Some(group) => group.2.push(at),
            None => groups.push((stem.into(), turns, vec![at])),
        }
    }
    let value = |row: &[f64], places: &[usize]| match places {
        [at] => row[*at] - rest[*at],
        _ => places.iter().map(|at| (row[*at] - rest[*at]).powi(2)).sum::<f64>().sqrt(),
    };
    let history = |(name, turns, places): (String, bool, Vec<usize>)| {
        let values = states.chunks_exact(n).map(|row| value(row, &places)).collect();
        JointHistory { name, turns, values }
    };
    groups.into_iter().map(history).collect()
}

/// The figures of a flight with those of its joints: `overview`, `path`, `error`, `rotors`, `attitude`, `rates`, `joints` where it has some.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotFigures {
    /// As of a single vehicle, the path with what hangs on it.
    pub flight: FlightFigures,
    /// Deflections over time; none of what has no joints, as a vehicle among obstacles.
    pub joints: Option<Figure>,
}

impl RobotFigures {
    /// From the log and the states behind it; key figures over t ≥ `after` (s).
    pub fn new(system: &Multibody, log: &FlightLog, states: &[f64], after: f64) -> Self {
        let numbers = key_figures(log, after);
        let figure = |what: &str| Figure::new(format!("{}: {what}", log.vehicle)).subtitle(&numbers);
        let moments = along(system, states);
        let path = Path3d { poses: Vec::new(), ..path_chart(log) }.obstacles(obstacles(system));
        let path = path
            .sticks(moments.iter().flat_map(|row| lines(system, row)).collect())
            .balls(moments.iter().flat_map(|row| balls(system, row)).collect());
        let tall = Path3d { elevation_deg: 32.0, azimuth_deg: -52.0, ..path.clone() };
        let panel = joint_panel(system, log, states);
        let mut flight = FlightFigures::new(log, after);
        let last = panel.clone().unwrap_or_else(|| attitude_panel(log));
        let panels = [position_panel(log), error_panel(log, after, true), rotor_panel(log), last];
        flight.overview = beside(figure("closed-loop flight"), tall, panels.into_iter().chain(wind_panel(log)));
        flight.path = figure("path").size(800.0, 560.0).chart(Path3d { title: String::new(), ..path });
        Self { flight, joints: panel.map(|panel| figure("joints").chart(panel)) }
    }

    /// Writes all of them into `folder`, as `png` or `svg`; returns their paths.
    pub fn save(&self, folder: impl AsRef<Path>, extension: &str) -> Result<Vec<PathBuf>> {
        let mut written = self.flight.save(&folder, extension)?;
        if let Some(joints) = &self.joints {
            let path = folder.as_ref().join(format!("joints.{extension}"));
            joints.save(&path)?;
            written.push(path);
        }
        Ok(written)
    }
}

/// Bars, boxes, arms and rings of the rotors.
fn lines(system: &Multibody, row: &[f64]) -> Vec<[[f64; 3]; 2]> {
    let ring = |item| match item {
        Item::Rotor { hub, axis, radius, .. } => rotor_ring(hub, axis, radius),
        _ => Vec::new(),
    };
    sticks(system, row).into_iter().chain(items(system, row).into_iter().flat_map(ring)).collect()
}

/// Centre and radius of every ball.
fn balls(system: &Multibody, row: &[f64]) -> Vec<([f64; 3], f64)> {
    let ball = |item| match item {
        Item::Ball { at, radius, .. } => Some((at, radius)),
        _ => None,
    };
    items(system, row).into_iter().filter_map(ball).collect()
}

/// States at a few moments, in places far from each other.
fn along<'a>(system: &Multibody, states: &'a [f64]) -> Vec<&'a [f64]> {
    let (n, root) = (system.rest_state().len(), system.layout().bodies[0].position);
    let rows: Vec<&[f64]> =
        states.chunks_exact(n).step_by(20).filter(|row| row.iter().all(|v| v.is_finite())).collect();
    let apart = |a: &[f64], b: &[f64]| (root..root + 3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
    let moments = if system.model().rotors().len() > 8 { 3 } else { 6 };
    let mut picked: Vec<&[f64]> = rows.last().copied().into_iter().collect();
    while picked.len() < moments {
        // the one farthest from all picked ones
        let gap = |row: &&&[f64]| picked.iter().map(|p| apart(p, row)).fold(f64::INFINITY, f64::min);
        let Some(next) = rows.iter().max_by(|a, b| gap(a).total_cmp(&gap(b))) else { break };
        picked.push(*next);
    }
    picked
}

fn joint_panel(system: &Multibody, log: &FlightLog, states: &[f64]) -> Option<Panel> {
    let histories = joints(system, states);
    if histories.is_empty() {
        return None;
    }
    let turns = histories.iter().all(|h| h.turns);
    let unit = if turns { "angle [°]" } else { "angle [°] or way [cm]" };
    let mut panel = Panel::new("Joints", "time [s]", unit).least_span(LEAST_ANGLE);
    for (i, h) in histories.iter().enumerate() {
        let scale = if h.turns { 180.0 / std::f64::consts::PI } else { 100.0 };
        let points = log.time.iter().zip(&h.values).map(|(t, v)| (*t, scale * v)).collect();
        let line = Series::line(h.name.clone(), points).colour(Colour::nth(i)).width(1.2);
        panel = panel.series(if i < 7 { line } else { line.dashed() });
    }
    Some(panel)
}

/// What a fall is drawn from.
#[derive(Debug, Clone, Copy)]
pub struct Fall<'a> {
    /// Of every sample.
    pub log: &'a FlightLog,
    /// Row by row.
    pub states: &'a [f64],
    /// Least distance to the ground, m.
    pub clearance: &'a [f64],
    /// Kinetic and potential, J.
    pub energy: &'a [f64],
    /// Of the ground on everything, in weights.
    pub load: &'a [f64],
}

/// The system before and after, its clearance, load, energy and joints over time.
pub fn fall(system: &Multibody, fall: Fall<'_>) -> Figure {
    let n = system.rest_state().len();
    let ground = system.model().parts().contact.ground.unwrap_or(0.0);
    let rows: Vec<&[f64]> = fall.states.chunks_exact(n).collect();
    let drawing = |title: &str, row: Option<&&[f64]>| {
        Drawing::new(title, row.map_or_else(Vec::new, |row| items(system, row))).floor(ground)
    };
    let timed = |values: &[f64], scale: f64| -> Vec<(f64, f64)> {
        fall.log.time.iter().zip(values).map(|(t, v)| (*t, scale * v)).collect()
    };
    let panel = |title: &str, unit: &str, values: &[f64], scale: f64, colour| {
        let line = Series::line("", timed(values, scale)).colour(colour);
        Panel::new(title, "", unit).series(line)
    };
    let clearance = panel("Lowest point above the ground", "height [cm]", fall.clearance, 100.0, Colour::BLUE);
    let load = panel("Force of the ground", "force / weight [-]", fall.load, 1.0, Colour::VERMILLION);
    let mut energy = panel("Energy", "energy [J]", fall.energy, 1.0, Colour::GREEN);
    let title = format!("{}: drop", fall.log.vehicle);
    let figure = Figure::new(title).size(1000.0, 600.0);
    let Some(angles) = joint_panel(system, fall.log, fall.states) else {
        energy.x_label = "time [s]".into();
        let grid = figure.grid(&[1.0, 1.1], &[1.0; 6]);
        return grid
            .place((0, 0), (1, 3), drawing("at the start", rows.first()))
            .place((0, 3), (1, 3), drawing("at the end", rows.last()))
            .place((1, 0), (1, 2), clearance)
            .place((1, 2), (1, 2), load)
            .place((1, 4), (1, 2), energy);
    };
    figure
        .grid(&[1.0, 1.1], &[1.0; 4])
        .place((0, 0), (1, 2), drawing("at the start", rows.first()))
        .place((0, 2), (1, 2), drawing("at the end", rows.last()))
        .place((1, 0), (1, 1), clearance)
        .place((1, 1), (1, 1), load)
        .place((1, 2), (1, 1), energy)
        .place((1, 3), (1, 1), angles)
}
