//! A trajectory that was planned: its states and figures, as files.

use super::Source;
use crate::arguments::Outputs;
use crate::npz::Npz;
use crate::prelude::*;
use omnidrones::autodiff::System;
use omnidrones::controllers::optimal::{CourseProblem, Ilqr, IlqrReport, IlqrStatus, OptimalTrajectory, PlannedPlant};
use omnidrones::controllers::{Flight, FlightPlan, HoverAxes, Reference, SmoothPoint};
use omnidrones::dynamics::assembly::Member;
use omnidrones::dynamics::configurations::environment;
use omnidrones::dynamics::configurations::environment::vehicle_in;
use omnidrones::dynamics::rotor::commanded_speed;
use omnidrones::dynamics::scene::{Gate, Obstacle, Scene};
use omnidrones::dynamics::shape::{Geometry, Shape};
use omnidrones::dynamics::spatial::{conjugate, from_euler, multiply, rotate};
use omnidrones::dynamics::{Frame, Plant};
use omnidrones::flight::{FlightLog, FlightSample};
use omnidrones_viewer::Measure;
use serde::Serialize;

/// How near a bound an input is at it, as a share of its range.
const AT_BOUND: f64 = 1e-6;
/// How far pillars are drawn beyond the path, m.
const BEYOND: f64 = 0.5;

/// A trajectory, and how it was found.
pub(super) struct Planned<'a> {
    pub source: &'a Source,
    pub problem: CourseProblem,
    pub trajectory: OptimalTrajectory,
    pub report: IlqrReport,
    /// Kₖ, row-major `[N, n_input, n_error]`.
    gains: Vec<f64>,
    /// Of the tracked body, with all rotors; its reference is the goal.
    pub log: FlightLog,
    /// Of the plant, row-major `[N + 1, number]`.
    pub states: Vec<f64>,
    pub figures: PlannedFigures,
}

/// Figures of a trajectory and of its search, SI.
#[derive(Debug, Clone, Serialize)]
pub(super) struct PlannedFigures {
    pub duration: f64,
    pub cost: f64,
    /// Σ of what its stages lack to the dynamics.
    pub gap: f64,
    pub violation: f64,
    pub iterations: usize,
    pub rounds: usize,
    pub newton_steps: usize,
    pub wall_time: f64,
    /// Share of all inputs.
    pub at_bounds: f64,
    /// Largest distance beyond a soft bound, in its unit; none without one.
    pub beyond_soft_bounds: Option<f64>,
    pub end: EndFigures,
    pub length: f64,
    pub max_speed: Option<f64>,
    pub max_tilt: Option<f64>,
}

/// Where it ends.
#[derive(Debug, Clone, Serialize)]
pub(super) struct EndFigures {
    /// From the goal, m.
    pub distance: f64,
    /// m/s.
    pub speed: f64,
    /// From the goal's attitude, rad.
    pub turned: f64,
}

impl<'a> Planned<'a> {
    pub fn new(
        source: &'a Source,
        problem: CourseProblem,
        search: &Ilqr,
        report: IlqrReport,
        wall_time: f64,
    ) -> Result<Self> {
        let trajectory = search.trajectory().clone();
        let gains: Vec<f64> = search.gains().iter().flat_map(|gain| gain.transpose().as_slice().to_vec()).collect();
        let tracked = source.file.tracked.as_deref();
        let (log, states) = logged(&problem, &trajectory, tracked)?;
        let figures = figures(&problem, &trajectory, &log, &report, wall_time);
        Ok(Self { source, problem, trajectory, report, gains, log, states, figures })
    }

    /// The largest violation of a condition, where it is beyond the tolerance.
    fn violated(&self) -> Option<String> {
        let left = self.report.violation;
        (left > self.problem.settings.condition_tolerance).then(|| short(left, 2))
    }

    /// Whether it is solved, or why not, and what to try.
    pub fn verdict(&self) -> std::result::Result<(), String> {
        let report = &self.report;
        let n = report.iterations.len();
        match report.status {
            IlqrStatus::Solved => Ok(()),
            IlqrStatus::OutOfIterations if n < self.problem.settings.max_iterations => Err(format!(
                "no step brings it nearer to the dynamics, from which its stages are {} away: try --guess hover, or another guess on the way",
                short(report.gap, 2)
            )),
            IlqrStatus::OutOfIterations => Err(format!(
                "it ran out of {n} iterations{}: try --iterations {}, longer steps, or weights that differ less",
                self.violated().map_or_else(String::new, |left| format!(
                    " with a gate or an obstacle violated by {left}, which more time or gates further apart may mend"
                )),
                2 * n
            )),
            IlqrStatus::Violated => Err(format!(
                "a gate or an obstacle stays violated by {}: give it more time, move gates apart, or weigh the goal less",
                short(report.violation, 2)
            )),
            IlqrStatus::NoStep => Err(format!(
                "after {} no step lowers the cost any more, which is not flat to {} of it: try another --guess, or weights that differ less",
                counted(n, "iteration"),
                short(self.problem.settings.tolerance, 1)
            )),
        }
    }

    /// Writes tables of states, inputs and gains. The table has the state of the plant; gains stand beside the states that they multiply
    /// errors of.
    pub fn write(&self, outputs: &mut Outputs) -> Result<()> {
        let (time, inputs) = (self.times(), self.input_columns());
        let whole: Vec<String> = self
            .problem
            .plant
            .plant()
            .state_quantities()
            .iter()
            .map(|own| format!("{} [{}]", own.name, own.unit))
            .collect();
        let header: Vec<String> =
            ["time [s]".to_string()].into_iter().chain(whole.iter().chain(&inputs).cloned()).collect();
        let (n, m) = (whole.len(), inputs.len());
        let row = |k: usize| {
            let state = &self.states[k * n..(k + 1) * n];
            let input = self.trajectory.inputs.get(k * m..(k + 1) * m).unwrap_or(&[]);
            let mut row: Vec<String> =
                std::iter::once(&time[k]).chain(state).chain(input).map(f64::to_string).collect();
            row.resize(1 + n + m, String::new());
            row
        };
        outputs.put("trajectory.csv", |path| files::write_table(path, header.clone(), (0..time.len()).map(row)))?;
        let (states, errors) = (self.state_columns(), self.error_names()?);
        outputs.put("gains.npz", |path| {
            Npz::write(path, |npz| {
                let stages = time.len() - 1;
                npz.numbers("time", &[stages + 1], &time)?;
                npz.numbers("states", &[stages + 1, states.len()], &self.trajectory.states)?;
                npz.numbers("inputs", &[stages, m], &self.trajectory.inputs)?;
                npz.numbers("gains", &[stages, m, errors.len()], &self.gains)?;
                npz.texts("state_columns", &[states.len()], &states)?;
                npz.texts("input_columns", &[m], &inputs)?;
                npz.texts("error_columns", &[errors.len()], &errors)
            })
        })
    }

    /// s, of every stage and of the end.
    pub fn times(&self) -> Vec<f64> {
        (0..=self.source.file.steps).map(|k| k as f64 * self.source.file.dt).collect()
    }

    /// Names and units of the states that are planned: speeds of rotors are shares of their largest.
    fn state_columns(&self) -> Vec<String> {
        self.planned_names().into_iter().map(|(name, unit)| format!("{name} [{unit}]")).collect()
    }

    fn planned_names(&self) -> Vec<(String, &'static str)> {
        let plant = &self.problem.plant;
        let (all, rotors) = (plant.plant().state_quantities(), plant.plant().rotor_places());
        let unit = |k: usize| if rotors.iter().any(|rotor| rotor.speed == k) { "-" } else { all[k].unit };
        plant.kept().iter().map(|k| (all[*k].name.clone(), unit(*k))).collect()
    }

    fn input_columns(&self) -> Vec<String> {
        self.problem.plant.input_names().into_iter().map(|(name, unit)| format!("{name} [{unit}]")).collect()
    }

    /// Of the errors that gains multiply: a rotation vector stands where its quaternion did.
    fn error_names(&self) -> Result<Vec<String>> {
        let (errors, all) = (self.problem.plant.errors()?, self.planned_names());
        let (mut names, mut at) = (Vec::new(), 0);
        while at < all.len() {
            let (name, unit) = &all[at];
            if errors.turns_at(at) {
                let stem = name.trim_end_matches("_w");
                names.extend(["x", "y", "z"].map(|axis| format!("{stem}_{axis} [rad]")));
                at += 4;
            } else {
                names.push(format!("{name} [{unit}]"));
                at += 1;
            }
        }
        Ok(names)
    }

    /// A page on which it flies among its gates and obstacles, towards its goal.
    pub fn replay(&self) -> Result<String> {
        let own = self.problem.plant.plant();
        let plant = self.surrounded(own).unwrap_or_else(|_| own.clone());
        let nowhere = Vec::new;
        let smoothest = SmoothPoint {
            step: 0,
            state: nowhere(),
            input: nowhere(),
            air: omnidrones::dynamics::Disturbance::none(),
            margin: -1.0,
        };
        let flight = Flight {
            log: self.log.clone(),
            states: self.states.clone(),
            diverged_at: None,
            smoothest,
            estimates: None,
        };
        let plan = FlightPlan {
            reference: Reference::Hover(Default::default()),
            duration: self.figures.duration,
            physics: *own.physics(),
            ..FlightPlan::default()
        };
        let mut recording = omnidrones_viewer::flight(&plant, &flight, &plan);
        recording.title = format!("{}: {}", own.name(), self.source.name);
        recording.remark = format!("planned, {} s", short(self.figures.duration, 4));
        recording.facts = crate::page::plain_facts(&self.facts());
        let unit = "m".into();
        recording.actors.iter_mut().for_each(|actor| {
            actor.error = Some(Measure { name: "distance to the goal".into(), unit: String::clone(&unit) })
        });
        Ok(omnidrones_viewer::page(&recording.title.clone(), &[recording]))
    }

    /// The plant with what stands on the way.
    fn surrounded(&self, plant: &Plant) -> Result<Plant> {
        let scene = self.scene();
        if scene.gates.is_empty() && scene.obstacles.is_empty() {
            return Ok(plant.clone());
        }
        let model = match plant {
            Plant::Rigid(rigid) => vehicle_in(rigid.vehicle(), &scene)?,
            Plant::Tree(tree) => {
                let model = tree.model().clone();
                let name = model.name().to_string();
                environment::environment(name, &[Member::new("", model, [0.0; 3])], &scene)?
            }
        };
        Plant::of_model(&model, *plant.physics())
    }

    /// Gates and obstacles as things.
    fn scene(&self) -> Scene {
        let gate = |(i, gate): (usize, &omnidrones::controllers::optimal::CourseGate)| {
            let own = Gate::default();
            let [width, height] = gate.half_size.map(|half| half + own.radius);
            Gate {
                name: format!("gate_{i}"),
                position: gate.position,
                rotation: from_euler(0.0, 0.0, gate.yaw),
                half_width: width,
                half_height: height,
                scale: 1.0,
                ..own
            }
        };
        let [low, high] = self.heights();
        let obstacle = |(i, own): (usize, &omnidrones::controllers::optimal::CourseObstacle)| {
            let shape = if own.pillar {
                let length = high - low;
                let middle = [own.position[0], own.position[1], 0.5 * (low + high)];
                Shape::new(Geometry::Capsule { radius: own.radius, length }).at(middle)
            } else {
                Shape::new(Geometry::Sphere { radius: own.radius }).at(own.position)
            };
            Obstacle { name: format!("obstacle_{i}"), shape }
        };
        Scene {
            gates: self.problem.gates.iter().enumerate().map(gate).collect(),
            obstacles: self.problem.obstacles.iter().enumerate().map(obstacle).collect(),
            ..Scene::default()
        }
    }

    /// Between which heights pillars are drawn, m.
    pub fn heights(&self) -> [f64; 2] {
        let heights = self.log.position.iter().map(|p| p[2]);
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
        [if low > 0.0 { 0.0 } else { low - BEYOND }, high + BEYOND]
    }
}

/// The tracked body along a trajectory, with the speeds of all rotors, and the states of the plant.
fn logged(
    problem: &CourseProblem,
    trajectory: &OptimalTrajectory,
    tracked: Option<&str>,
) -> Result<(FlightLog, Vec<f64>)> {
    let planned = &problem.plant;
    let plant = planned.plant();
    let (n, m) = (planned.n_state(), planned.n_input());
    let (rotors, places) = (plant.rotors(), plant.rotor_places());
    let body = tracked.and_then(|name| plant.body_names().iter().position(|own| own == name)).unwrap_or(0);
    let speeds: Vec<f64> = rotors.iter().map(|rotor| rotor.max_speed).collect();
    let mut log = FlightLog::new(plant.name(), &speeds);
    log.hover_attitude = HoverAxes::of_plant(plant).attitude_in_hover();
    let (mut states, mut frames) = (Vec::new(), vec![0.0; plant.n_frame() * 13]);
    let (parameters, mut commands) = (plant.parameters(), vec![0.0; plant.n_input()]);
    let stages = trajectory.inputs.len() / m;
    let goal: [f64; 3] = [0, 1, 2].map(|k| problem.goal[k]);
    for k in 0..=stages {
        let at = k.min(stages - 1);
        let inputs = &trajectory.inputs[at * m..(at + 1) * m];
        let state = planned.plant_state(&trajectory.states[k * n..(k + 1) * n], inputs);
        planned.write_commands(inputs, &mut commands);
        plant.write_frames(&parameters, &state, &mut frames);
        let frame = Frame::<f64>::read(&frames[13 * body..]);
        let speed: Vec<f64> = places.iter().map(|place| state[place.speed]).collect();
        let thrust: Vec<f64> = rotors.iter().zip(&speed).map(|(r, s)| r.thrust_coefficient * s * s).collect();
        let command: Vec<f64> =
            places.iter().map(|place| commanded_speed(place.max_speed, commands[place.action])).collect();
        log.push(FlightSample {
            time: k as f64 * plant.physics().dt,
            position: frame.position,
            velocity: frame.velocity,
            attitude: frame.attitude,
            angular_velocity: rotate(conjugate(frame.attitude), frame.angular_velocity),
            reference_position: goal,
            reference_velocity: [0.0; 3],
            reference_acceleration: [0.0; 3],
            reference_yaw: 0.0,
            rotor_speed: &speed,
            rotor_command: &command,
            thrust: &thrust,
            wind: [0.0; 3],
        })?;
        states.extend(state);
    }
    Ok((log, states))
}

fn figures(
    problem: &CourseProblem,
    trajectory: &OptimalTrajectory,
    log: &FlightLog,
    report: &IlqrReport,
    wall_time: f64,
) -> PlannedFigures {
    let distance = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let last = log.len() - 1;
    let goal: [f64; 4] = [6, 7, 8, 9].map(|k| problem.goal[k]);
    let apart = multiply(conjugate(goal), log.attitude[last]);
    let tilted = apart[1].hypot(apart[2]).hypot(apart[3]);
    let n = problem.problem.model().n_state();
    let beyond = |bound: &omnidrones::controllers::optimal::SoftBound| {
        let own = trajectory.states.chunks_exact(n).skip(1).map(|state| state[bound.state]);
        own.map(|x| (bound.lower - x).max(x - bound.upper)).fold(0.0, f64::max)
    };
    let soft = problem.problem.soft_bounds();
    PlannedFigures {
        duration: log.time[last],
        cost: report.cost,
        gap: report.gap,
        violation: report.violation,
        iterations: report.iterations.len(),
        rounds: report.iterations.last().map_or(0, |step| step.round + 1),
        newton_steps: report.iterations.iter().map(|step| step.newton_steps).sum(),
        wall_time,
        at_bounds: at_bounds(problem, trajectory),
        beyond_soft_bounds: (!soft.is_empty()).then(|| soft.iter().map(beyond).fold(0.0, f64::max)),
        end: EndFigures {
            distance: distance(&log.position[last], &log.reference_position[last]),
            speed: distance(&log.velocity[last], &[0.0; 3]),
            turned: 2.0 * tilted.atan2(apart[0].abs()),
        },
        length: log.position.windows(2).map(|pair| distance(&pair[0], &pair[1])).sum(),
        max_speed: log.max_speed(),
        max_tilt: log.max_tilt(),
    }
}

/// Share of the inputs that are at a bound.
fn at_bounds(problem: &CourseProblem, trajectory: &OptimalTrajectory) -> f64 {
    let m = PlannedPlant::n_input(&problem.plant);
    let at = trajectory.inputs.chunks_exact(m).enumerate().map(|(k, inputs)| {
        let (lower, upper) = problem.problem.bounds(k);
        let near = |(u, (low, high)): (&f64, (&f64, &f64))| (u - low).min(high - u) <= AT_BOUND * (high - low);
        inputs.iter().zip(lower.iter().zip(upper)).filter(|own| near(*own)).count()
    });
    at.sum::<usize>() as f64 / trajectory.inputs.len() as f64
}
