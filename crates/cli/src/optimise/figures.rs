//! The figures of a planned trajectory: its path among gates and obstacles, its numbers over time, the descent to it.

use super::planned::Planned;
use crate::prelude::*;
use omnidrones::controllers::optimal::{CourseGate, IlqrIteration, PlannedInput};
use omnidrones_plot::flight::path_chart;
use omnidrones_plot::{Colour, Figure, Item, Panel, Path3d, Series};
use std::f64::consts::TAU;

/// Width over height of a view from above or from the side, so that both its axes have one scale.
const ASPECT: f64 = 1.52;
/// More inputs than these are not named.
const MANY: usize = 8;
/// Histories no longer than this have a mark at every step.
const FEW: usize = 40;
/// Of the bars of gates, m.
const BAR: f64 = 0.03;
/// Room around a view, as a share of it.
const ROOM: f64 = 0.06;

/// Outlines in a view, each with its colour and width.
type Outlines = Vec<(Vec<[f64; 2]>, Colour, f64)>;

impl Planned<'_> {
    /// Path, trajectory, descent.
    pub fn figures(&self) -> [Figure; 3] {
        [self.path_figure(), self.trajectory_figure(), self.descent_figure()]
    }

    fn figure(&self, what: &str) -> Figure {
        let f = &self.figures;
        let told = format!(
            "cost {}   ·   {} s   ·   {} iterations   ·   at the end {} from the goal, {} m/s   ·   inputs at a bound {}",
            short(f.cost, 4),
            short(f.duration, 4),
            f.iterations,
            length(f.end.distance),
            short(f.end.speed, 2),
            percent(f.at_bounds)
        );
        let not = if self.verdict().is_ok() { "" } else { " (not solved)" };
        Figure::new(format!("{}: {what}{not}", self.source.name)).subtitle(told)
    }

    /// In space, from above and from the side.
    fn path_figure(&self) -> Figure {
        let chart = path_chart(&self.log);
        let path = Path3d { title: "In space".into(), reference: Vec::new(), ..chart };
        let path = path.obstacles(self.things()).called("planned");
        self.figure("path")
            .size(1000.0, 600.0)
            .grid(&[1.5, 1.0], &[1.0, 1.0])
            .place((0, 0), (1, 2), path)
            .place((1, 0), (1, 1), self.view("From above", [0, 1]))
            .place((1, 1), (1, 1), self.view("From the side", [0, 2]))
    }

    /// Gates and obstacles as bars and balls.
    fn things(&self) -> Vec<Item> {
        let bar = |from, to| Item::Bar { from, to, radius: BAR, colour: Colour::ORANGE };
        let gates = self.problem.gates.iter().flat_map(|gate| {
            let corners = corners(gate);
            (0..4).map(move |k| bar(corners[k], corners[(k + 1) % 4]))
        });
        let [low, high] = self.heights();
        let obstacles = self.problem.obstacles.iter().map(|own| {
            let ([x, y, _], radius, colour) = (own.position, own.radius, Colour::GREY);
            if own.pillar {
                Item::Bar { from: [x, y, low], to: [x, y, high], radius, colour }
            } else {
                Item::Ball { at: own.position, radius, colour }
            }
        });
        gates.chain(obstacles).collect()
    }

    /// Along two axes of the world, with one scale.
    fn view(&self, title: &str, axes: [usize; 2]) -> Panel {
        let flat = |p: &[f64; 3]| axes.map(|axis| p[axis]);
        let path: Vec<[f64; 2]> = self.log.position.iter().map(flat).collect();
        let mut outlines: Outlines = Vec::new();
        for gate in &self.problem.gates {
            let corners = corners(gate);
            outlines.push(((0..5).map(|k| flat(&corners[k % 4])).collect(), Colour::ORANGE, 2.2));
        }
        let [low, high] = self.heights();
        for own in &self.problem.obstacles {
            let [x, y] = flat(&own.position);
            let outline = if own.pillar && axes[1] == 2 {
                let corner = |k: usize| {
                    [x + if k % 4 < 2 { own.radius } else { -own.radius }, if (k + 1) % 4 < 2 { low } else { high }]
                };
                (0..5).map(corner).collect()
            } else {
                let on = |k: usize| {
                    let (s, c) = (k as f64 * TAU / 48.0).sin_cos();
                    [x + own.radius * c, y + own.radius * s]
                };
                (0..=48).map(on).collect()
            };
            outlines.push((outline, Colour::GREY, 1.2));
        }
        let seen = path.iter().chain(outlines.iter().flat_map(|own| &own.0));
        let [x_range, y_range] = ranges(seen);
        let names = ["x [m]", "y [m]", "z [m]"];
        let panel = Panel::new(title, names[axes[0]], names[axes[1]])
            .x_range(x_range[0], x_range[1])
            .y_range(y_range[0], y_range[1]);
        let points = |own: &[[f64; 2]]| own.iter().map(|p| (p[0], p[1])).collect();
        let panel = outlines.iter().fold(panel, |panel, (own, colour, width)| {
            panel.series(Series::line("", points(own)).colour(*colour).width(*width))
        });
        panel.series(Series::line("", points(&path)).colour(Colour::BLUE).width(1.8))
    }

    /// Position, speed, attitude, rates, and inputs between their bounds.
    fn trajectory_figure(&self) -> Figure {
        let log = &self.log;
        let timed = |values: Vec<f64>| -> Vec<(f64, f64)> { log.time.iter().copied().zip(values).collect() };
        let three = |title: &str, label: &str, names: [&str; 3], rows: &[[f64; 3]], scale: f64| {
            let line = |k: usize| Series::line(names[k], timed(rows.iter().map(|row| scale * row[k]).collect()));
            (0..3).fold(Panel::new(title, "time [s]", label), |panel, k| panel.series(line(k).colour(Colour::nth(k))))
        };
        let passed = |panel: Panel| {
            let name = |i: usize| if i == 0 { "gate" } else { "" };
            let gates = self.problem.gates.iter().enumerate();
            gates.fold(panel, |panel, (i, gate)| panel.event(name(i), gate.time, Colour::ORANGE))
        };
        let position = passed(three("Position", "position [m]", ["x", "y", "z"], &log.position, 1.0));
        let degrees = 180.0 / std::f64::consts::PI;
        let mut attitude = three("Attitude", "angle [°]", ["roll", "pitch", "yaw"], &log.euler_angles(), degrees);
        attitude.series.iter_mut().for_each(|series| gap_turns(&mut series.points));
        let rates = three("Body rates", "rate [rad/s]", ["x", "y", "z"], &log.angular_velocity, 1.0);
        let speed = Panel::new("Speed", "time [s]", "speed [m/s]")
            .series(Series::line("", timed(log.speed())).colour(Colour::BLUE))
            .from_zero();
        let bare = |mut panel: Panel| {
            panel.x_label.clear();
            panel
        };
        self.figure("trajectory")
            .size(1000.0, 720.0)
            .grid(&[1.0, 1.0], &[1.0, 1.0, 1.1])
            .place((0, 0), (1, 1), bare(position))
            .place((1, 0), (1, 1), bare(passed(speed)))
            .place((0, 1), (1, 1), bare(attitude))
            .place((1, 1), (1, 1), bare(rates))
            .place((0, 2), (2, 1), self.input_panel())
    }

    /// Inputs as they are held, step by step.
    fn input_panel(&self) -> Panel {
        let names = self.problem.plant.input_names();
        let (m, dt) = (names.len(), self.source.file.dt);
        let (title, label) = match self.problem.plant.input() {
            PlannedInput::Speed => ("Inputs: commanded speeds as shares of the largest", "share [-]"),
            PlannedInput::Thrust => ("Inputs: thrusts", "thrust [N]"),
        };
        let mut panel = Panel::new(title, "time [s]", label);
        for (i, (name, _)) in names.iter().enumerate() {
            let held = |(k, u): (usize, &f64)| [(k as f64 * dt, *u), ((k + 1) as f64 * dt, *u)];
            let points = self.trajectory.inputs.iter().skip(i).step_by(m).enumerate().flat_map(held).collect();
            let short_name = name.split('.').next().unwrap_or(name).replace('_', " ");
            let line = Series::line(if m <= MANY { short_name.as_str() } else { "" }, points).width(1.2);
            panel = panel.series(if i < 7 { line } else { line.dashed() });
        }
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        for k in 0..self.source.file.steps {
            let (lower, upper) = self.problem.problem.bounds(k);
            least = lower.iter().fold(least, |low, own| low.min(*own));
            most = upper.iter().fold(most, |high, own| high.max(*own));
        }
        panel.level("bounds", least, Colour::GREY).level("", most, Colour::GREY)
    }

    /// Cost, and what was left to do, over the iterations.
    fn descent_figure(&self) -> Figure {
        let history = &self.report.iterations;
        let of = |value: fn(&IlqrIteration) -> f64| -> Vec<(f64, f64)> {
            history.iter().enumerate().map(|(n, step)| ((n + 1) as f64, value(step))).collect()
        };
        // a gap of rounding is none
        let closed = self.problem.settings.tolerance * self.trajectory.states.len() as f64;
        let mut gaps = of(|step| step.gap);
        gaps.iter_mut().filter(|(_, gap)| *gap <= closed).for_each(|(_, gap)| *gap = 0.0);
        let marked = |series: Series| if history.len() <= FEW { series.markers() } else { series };
        let rounds = |panel: Panel| {
            let begun = history.windows(2).enumerate().filter(|(_, pair)| pair[1].round > pair[0].round);
            begun.enumerate().fold(panel, |panel, (i, (n, _))| {
                panel.event(if i == 0 { "new multipliers" } else { "" }, n as f64 + 1.5, Colour::PALE)
            })
        };
        let cost = Panel::new("Cost, with squares of conditions", "iteration", "cost [-]")
            .series(marked(Series::line("", of(|step| step.cost)).colour(Colour::BLUE)))
            .log_y();
        let left = Panel::new("What was left", "iteration", "[-]")
            .series(marked(Series::line("gap to the dynamics", gaps).colour(Colour::VERMILLION)))
            .series(marked(
                Series::line("expected change of the cost", of(|step| step.expected.abs())).colour(Colour::GREEN),
            ))
            .log_y();
        let steps = Panel::new("Length of the step", "iteration", "α [-]")
            .series(marked(Series::line("", of(|step| step.step)).colour(Colour::INK)))
            .y_range(0.0, 1.05);
        let bare = |mut panel: Panel| {
            panel.x_label.clear();
            panel
        };
        self.figure("descent")
            .size(800.0, 640.0)
            .grid(&[1.0], &[1.0, 1.0, 0.6])
            .place((0, 0), (1, 1), bare(rounds(cost)))
            .place((0, 1), (1, 1), bare(rounds(left)))
            .place((0, 2), (1, 1), steps)
    }
}

/// Of the opening, around it.
fn corners(gate: &CourseGate) -> [[f64; 3]; 4] {
    let (s, c) = gate.yaw.sin_cos();
    let [half_width, half_height] = gate.half_size;
    [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]].map(|[across, up]| {
        let [x, y, z] = gate.position;
        [x - s * across * half_width, y + c * across * half_width, z + up * half_height]
    })
}

/// Around points, with one scale along both axes.
fn ranges<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> [[f64; 2]; 2] {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in points {
        for k in 0..2 {
            (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
        }
    }
    let middle = [0, 1].map(|k| 0.5 * (low[k] + high[k]));
    let wide = [0, 1].map(|k| (1.0 + 2.0 * ROOM) * (high[k] - low[k]));
    let height = wide[1].max(wide[0] / ASPECT).max(0.1);
    [
        [-1.0, 1.0].map(|side| middle[0] + 0.5 * side * height * ASPECT),
        [-1.0, 1.0].map(|side| middle[1] + 0.5 * side * height),
    ]
}

/// A jump by a full turn is a gap.
fn gap_turns(points: &mut [(f64, f64)]) {
    for i in 1..points.len() {
        if (points[i].1 - points[i - 1].1).abs() > 180.0 {
            points[i - 1].1 = f64::NAN;
        }
    }
}
