//! Problems as TOML: a vehicle, a start and a goal, weights, and what lies on the way.
//!
//! ```toml
//! vehicle = "hummingbird"     # built in, or a vehicle file beside this one; or configuration = "payload"
//! inputs = "speed"            # of rotors: shares of their largest speed with motor lag, or "thrust" in N without
//! steps = 60                  # stages
//! dt = 0.02                   # s each
//!
//! [start]                     # missing numbers are those of hover
//! position = [0.0, 0.0, 1.0]
//!
//! [goal]
//! position = [3.0, 0.0, 1.0]
//!
//! [stage]                     # weights per second
//! velocity = 0.1
//! input = 1.0
//!
//! [terminal]                  # weights of the end
//! position = 1000.0
//! velocity = 100.0
//! attitude = 100.0
//!
//! [[gate]]                    # passed at a time
//! time = 0.6
//! position = [1.5, 0.4, 1.2]
//! ```

use super::course::{CourseCost, CourseGate, CourseObstacle};
use super::ilqr::IlqrSettings;
use super::planned_plant::{PlannedInput, PlannedPlant};
use super::problem::{MAX_STAGES, OptimalProblem, OptimalTrajectory};
use super::stage_model::StageModel;
use super::state_bound::{StateBound, soft_bounds};
use super::tracking_cost::{TrackingCost, TrackingWeights};
use crate::kinematics::Kinematics;
use autodiff::System;
use base::error::{Error, Result, finite};
use base::reader;
use dynamics::integrate::Integrator;
use dynamics::spatial::from_euler;
use dynamics::{Effects, Physics, Plant, Vehicle, configurations, vehicles};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// Largest file, bytes.
const MAX_FILE_BYTES: u64 = 16 << 20;

/// Names of problems that are built in, each with what it is.
const BUILT_IN: [(&str, &str, &str); 4] = [
    ("flip", "a turn over the back, and hover again", include_str!("problems/flip.toml")),
    ("slalom", "between pillars, to a point", include_str!("problems/slalom.toml")),
    ("landing", "down onto the ground from flight, without touching it hard", include_str!("problems/landing.toml")),
    ("race", "through four gates, as they come", include_str!("problems/race.toml")),
];

/// One number for all axes, or one each.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum AxisWeights {
    /// For all.
    All(f64),
    /// For x, y, z.
    Each([f64; 3]),
}

impl AxisWeights {
    fn numbers(self) -> [f64; 3] {
        match self {
            Self::All(x) => [x; 3],
            Self::Each(x) => x,
        }
    }
}

/// Pose and velocities in a file; what is missing is that of hover at the origin.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PoseInFile {
    /// World, m.
    pub position: Option<[f64; 3]>,
    /// World, m/s.
    pub velocity: Option<[f64; 3]>,
    /// Body → world, `[w, x, y, z]`.
    pub attitude: Option<[f64; 4]>,
    /// In place of it: roll, pitch, yaw, degrees.
    pub euler_deg: Option<[f64; 3]>,
    /// Body, rad/s.
    pub angular_velocity: Option<[f64; 3]>,
}

/// Weights in a file; 0 where nothing is said.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WeightsInFile {
    /// 1/m².
    pub position: Option<AxisWeights>,
    /// s²/m².
    pub velocity: Option<AxisWeights>,
    /// 1/rad².
    pub attitude: Option<AxisWeights>,
    /// s²/rad².
    pub angular_velocity: Option<AxisWeights>,
    /// 1/rad² or 1/m².
    pub joint: f64,
    /// Of its rate.
    pub joint_rate: f64,
    /// Per square of the unit of the first input; of others alike in shares of their range.
    pub input: f64,
}

/// A pose to be at, at the stage nearest to a time: in place of the goal, with weights of its own.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WaypointInFile {
    /// When, s.
    pub time: f64,
    /// Where to be.
    pub pose: PoseInFile,
    /// How much it matters; not per second.
    pub weights: WeightsInFile,
}

/// Bounds of inputs in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum BoundsInFile {
    /// The same of every rotor.
    Same([f64; 2]),
    /// Of every input.
    Each(Vec<[f64; 2]>),
    /// `"free"`: none but what rotors and drives can.
    Word(NoBounds),
}

/// No bounds beside those of the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoBounds {
    /// `"free"`.
    Free,
}

/// How a search begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FirstGuess {
    /// Inputs of hover, and the states that follow from them.
    Hover,
    /// Inputs of hover, and states along lines from start over gates and waypoints to the goal: they need not obey the dynamics.
    #[default]
    Line,
}

/// A problem in a file; see the [module](self).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProblemFile {
    /// A built-in vehicle, or a vehicle file.
    pub vehicle: Option<String>,
    /// In place of it: a built-in configuration.
    pub configuration: Option<String>,
    /// Body that follows; without it the root.
    pub tracked: Option<String>,
    /// What inputs of rotors are.
    #[serde(default)]
    pub inputs: PlannedInput,
    /// Number of stages.
    pub steps: usize,
    /// Of a stage, s.
    pub dt: f64,
    /// Steps of the integrator in a stage.
    #[serde(default = "one")]
    pub substeps: usize,
    /// How they are integrated.
    #[serde(default)]
    pub integrator: Integrator,
    /// Effects of the model.
    #[serde(default)]
    pub effects: Effects,
    /// Of inputs, within those of the vehicle.
    pub bounds: Option<BoundsInFile>,
    /// Inputs of rotors that cost nothing; without it those of hover.
    pub input_reference: Option<f64>,
    /// Whether motors speed up and slow down with different lags. Without, the longer one counts both ways: the motion is smooth then, and
    /// searches end ten times as fast.
    #[serde(default)]
    pub exact_lags: bool,
    /// How the search begins.
    #[serde(default)]
    pub guess: FirstGuess,
    /// Whether curvatures are exact, not those of squares alone: fewer iterations, each of them longer.
    #[serde(default = "yes")]
    pub exact: bool,
    /// Where it starts.
    #[serde(default)]
    pub start: PoseInFile,
    /// Where it ends.
    #[serde(default)]
    pub goal: PoseInFile,
    /// Weights on the way, per second.
    #[serde(default)]
    pub stage: WeightsInFile,
    /// Weights of the end.
    #[serde(default)]
    pub terminal: WeightsInFile,
    /// Poses on the way.
    #[serde(default, rename = "waypoint")]
    pub waypoints: Vec<WaypointInFile>,
    /// Gates on the way.
    #[serde(default, rename = "gate")]
    pub gates: Vec<CourseGate>,
    /// What is kept clear of.
    #[serde(default, rename = "obstacle")]
    pub obstacles: Vec<CourseObstacle>,
    /// Soft bounds of the state.
    #[serde(default, rename = "state_bound")]
    pub state_bounds: Vec<StateBound>,
    /// When the search ends.
    #[serde(default)]
    pub settings: IlqrSettings,
}

fn yes() -> bool {
    true
}

fn one() -> usize {
    1
}

/// A problem that is ready to be solved.
#[derive(Debug, Clone)]
pub struct CourseProblem {
    /// What is solved.
    pub problem: OptimalProblem,
    /// The plant it plans with.
    pub plant: PlannedPlant,
    /// Where a search begins.
    pub guess: OptimalTrajectory,
    /// How.
    pub first: FirstGuess,
    /// When it ends.
    pub settings: IlqrSettings,
    /// Its gates and obstacles.
    pub gates: Vec<CourseGate>,
    /// What is kept clear of.
    pub obstacles: Vec<CourseObstacle>,
    /// Where it ends, `[n_state]`.
    pub goal: Vec<f64>,
}

impl ProblemFile {
    /// Names of the problems that are built in, with what each is.
    pub fn built_in() -> impl Iterator<Item = (&'static str, &'static str)> {
        BUILT_IN.iter().map(|(name, what, _)| (*name, *what))
    }

    /// Text of a problem that is built in.
    pub fn text_of(name: &str) -> Option<&'static str> {
        BUILT_IN.iter().find(|own| own.0 == name).map(|own| own.2)
    }

    /// From TOML text; `file` is for messages.
    ///
    /// # Errors
    /// [`Error::Format`] with line and column for text that is no TOML, and for an unknown key with the nearest one.
    pub fn from_toml_str(text: &str, file: &str) -> Result<Self> {
        reader::of_toml(text, file)
    }

    /// From a file of at most 16 MiB; its problem, with a vehicle file found beside it.
    ///
    /// # Errors
    /// [`Error::File`] where it cannot be read; as [`from_toml_str`](Self::from_toml_str) and [`problem`](Self::problem).
    pub fn open(path: impl AsRef<Path>) -> Result<CourseProblem> {
        let path = path.as_ref();
        let text = base::file_gate::read_text(path, MAX_FILE_BYTES)?;
        Self::from_toml_str(&text, &path.display().to_string())?.problem(path.parent())
    }

    /// The problem that a name stands for.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest name.
    pub fn by_name(name: &str) -> Result<CourseProblem> {
        let Some(text) = Self::text_of(name) else {
            let known = Self::built_in().map(|(name, _)| name.to_string()).collect();
            return Err(Error::Unknown { kind: "problem", name: name.into(), known });
        };
        Self::from_toml_str(text, name)?.problem(None)
    }

    fn plant(&self, folder: Option<&Path>) -> Result<Plant> {
        let Self { dt, substeps, integrator, effects, .. } = *self;
        let physics = Physics { dt, substeps, integrator, effects };
        match (&self.vehicle, &self.configuration) {
            _ if !self.exact_lags => {
                let exact = Self { exact_lags: true, ..self.clone() };
                exact.plant(folder)?.with_longer_lags()
            }
            (Some(name), None) => {
                let is_file = name.ends_with(".toml");
                let vehicle = match folder {
                    Some(folder) if is_file => Vehicle::from_toml_file(folder.join(name))?,
                    _ if is_file => Vehicle::from_toml_file(name)?,
                    _ => vehicles::by_name(name)?,
                };
                Plant::of_vehicle(&vehicle, physics)
            }
            (None, Some(name)) => Plant::of_model(&configurations::by_name(name)?, physics),
            (vehicle, _) => {
                let value = if vehicle.is_some() { "both" } else { "neither" };
                let remedy = "Name a built-in vehicle or a vehicle file, or a built-in configuration.";
                Err(Error::value("vehicle and configuration", value, "one of the two", remedy))
            }
        }
    }

    /// The stage of a time on the way.
    fn stage_of(&self, what: &str, time: f64) -> Result<usize> {
        let (stage, last) = ((time / self.dt).round(), self.steps as f64);
        if stage >= 0.0 && stage <= last {
            return Ok(stage as usize);
        }
        let rule = format!("within [0, {}] s", last * self.dt);
        Err(Error::value(format!("{what}: time"), time, rule, "Give more steps, or an earlier time."))
    }

    /// What it describes; a vehicle file is sought in `folder`.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] that names the key; as the vehicle's file.
    pub fn problem(&self, folder: Option<&Path>) -> Result<CourseProblem> {
        if self.steps == 0 {
            return Err(Error::value("steps", 0, "≥ 1", "50 of 20 ms are a second."));
        }
        if self.steps > MAX_STAGES {
            return Err(Error::limit("steps", self.steps, MAX_STAGES, "Take longer steps."));
        }
        self.settings.validate()?;
        let plant = PlannedPlant::new(self.plant(folder)?, self.inputs)?;
        let tracked = match &self.tracked {
            None => 0,
            Some(name) => {
                let known = plant.plant().body_names();
                let found = known.iter().position(|own| own == name);
                found.ok_or_else(|| Error::Unknown { kind: "body", name: name.clone(), known })?
            }
        };
        let tracking = TrackingCost::new(&plant, tracked)?;
        let (lower, upper) = self.bounds(&plant)?;
        let cost = CourseCost::new(tracking, !self.gates.is_empty(), &self.obstacles)?;
        let mut model = StageModel::new(&plant, &cost, plant.errors()?)?;
        if self.exact {
            model = model.with_curvature(&plant, &cost)?;
        }
        let (hover, holding) = plant.hover()?;
        let start = self.start.state("start", &hover)?;
        let goal = self.goal.state("goal", &hover)?;
        let mut problem = OptimalProblem::new(Arc::new(model), self.steps, &start)?;
        problem.set_bounds(&lower, &upper)?;
        problem.set_soft_bounds(&soft_bounds(&plant, &self.state_bounds)?)?;
        let reference = match self.input_reference {
            None => holding.clone(),
            Some(same) => {
                finite("input_reference", &[same])?;
                holding.iter().enumerate().map(|(i, own)| if plant.is_rotor(i) { same } else { *own }).collect()
            }
        };
        let mut marks = vec![(0, start.clone()), (self.steps, goal.clone())];
        let mut row = vec![0.0; problem.model().n_parameter()];
        let first = plant.n_parameter();
        let scale = squared_range(&plant);
        for stage in 0..=self.steps {
            let is_end = stage == self.steps;
            let weights = if is_end { self.terminal } else { self.stage };
            let own = weights.weights(if is_end { "terminal" } else { "stage" }, scale)?;
            row[first..].fill(0.0);
            let n = cost.tracking().plant().n_input();
            let until = first + Kinematics::<f64>::DIM + n + TrackingWeights::DIM;
            cost.tracking().write_parameters(&Kinematics::read(&goal), &reference, &own, &mut row[first..until]);
            problem.set_parameters(stage, &row)?;
        }
        let mut waypoint_stages = Vec::new();
        for waypoint in &self.waypoints {
            let stage = self.stage_of("waypoint", waypoint.time)?;
            if waypoint_stages.contains(&stage) {
                let rule = "of a stage of its own";
                return Err(Error::value(
                    "waypoint: time",
                    waypoint.time,
                    rule,
                    "Times are those of stages: give another.",
                ));
            }
            waypoint_stages.push(stage);
            let own = waypoint.pose.state("waypoint", &hover)?;
            let by = if stage == self.steps { 1.0 } else { 1.0 / self.dt };
            let mut weights = waypoint.weights.weights("waypoint", scale)?.scaled(by);
            weights.input = self.stage.weights("stage", scale)?.input;
            row.copy_from_slice(problem.parameters(stage));
            let until = first + Kinematics::<f64>::DIM + plant.n_input() + TrackingWeights::DIM;
            cost.tracking().write_parameters(&Kinematics::read(&own), &reference, &weights, &mut row[first..until]);
            problem.set_parameters(stage, &row)?;
            if waypoint.pose.position.is_some() {
                marks.push((stage, own));
            }
        }
        let mut taken = Vec::new();
        for gate in &self.gates {
            gate.validate()?;
            let stage = self.stage_of("gate", gate.time)?;
            if stage == 0 || taken.contains(&stage) {
                let rule = "of a stage of its own, behind the start";
                return Err(Error::value("gate: time", gate.time, rule, "Times are those of stages: give another."));
            }
            taken.push(stage);
            row.copy_from_slice(problem.parameters(stage));
            cost.write_gate(Some(gate), &mut row);
            problem.set_parameters(stage, &row)?;
            let mut own = hover.clone();
            own[..3].copy_from_slice(&gate.position);
            marks.push((stage, own));
        }
        let guess = OptimalTrajectory {
            states: self.along_lines(&mut marks),
            inputs: (0..self.steps).flat_map(|_| holding.clone()).collect(),
        };
        Ok(CourseProblem {
            problem,
            guess,
            first: self.guess,
            settings: self.settings,
            gates: self.gates.clone(),
            obstacles: self.obstacles.clone(),
            goal,
            plant,
        })
    }

    /// States on lines between marks, turned as the next mark.
    fn along_lines(&self, marks: &mut [(usize, Vec<f64>)]) -> Vec<f64> {
        marks.sort_by_key(|mark| mark.0);
        let mut states = Vec::new();
        for stage in 0..=self.steps {
            let next = marks.iter().position(|mark| mark.0 >= stage).unwrap_or(marks.len() - 1);
            let (after, before) = (&marks[next], &marks[next.saturating_sub(1)]);
            let mut own = after.1.clone();
            let length = (after.0 - before.0).max(1) as f64;
            let share = (stage - before.0.min(stage)) as f64 / length;
            for k in 0..3 {
                own[k] = before.1[k] + share.min(1.0) * (after.1[k] - before.1[k]);
            }
            states.extend(own);
        }
        states
    }

    fn bounds(&self, plant: &PlannedPlant) -> Result<(Vec<f64>, Vec<f64>)> {
        let (mut lower, mut upper) = plant.bounds();
        let n = lower.len();
        let own = match &self.bounds {
            None | Some(BoundsInFile::Word(NoBounds::Free)) => return Ok((lower, upper)),
            Some(BoundsInFile::Same(own)) => {
                let of = |i: usize| if plant.is_rotor(i) { *own } else { [lower[i], upper[i]] };
                (0..n).map(of).collect()
            }
            Some(BoundsInFile::Each(own)) if own.len() == n => own.clone(),
            Some(BoundsInFile::Each(own)) => {
                let rule = format!("{n}, one pair per input");
                return Err(Error::value("bounds", own.len(), rule, "Give one pair for all, or a pair for each."));
            }
        };
        for (i, [low, high]) in own.into_iter().enumerate() {
            if low.is_nan() || high.is_nan() || low > high {
                let value = format!("[{low}, {high}]");
                return Err(Error::value(
                    format!("bounds of input {i}"),
                    value,
                    "lower ≤ upper",
                    "Give the smaller first.",
                ));
            }
            if low > upper[i] || high < lower[i] {
                let (value, rule) = (format!("[{low}, {high}]"), format!("within [{}, {}]", lower[i], upper[i]));
                return Err(Error::value(
                    format!("bounds of input {i}"),
                    value,
                    rule,
                    "The vehicle has no such inputs.",
                ));
            }
            (lower[i], upper[i]) = (low.max(lower[i]), high.min(upper[i]));
        }
        Ok((lower, upper))
    }
}

/// Square of the range of the first input, in its unit.
fn squared_range(plant: &PlannedPlant) -> f64 {
    let (lower, upper) = plant.bounds();
    (upper[0] - lower[0]).powi(2)
}

impl PoseInFile {
    /// A state with these numbers in place of those of hover.
    fn state(&self, what: &str, hover: &[f64]) -> Result<Vec<f64>> {
        let mut state = hover.to_vec();
        if let Some(x) = self.position {
            finite(&format!("{what}.position"), &x)?;
            state[..3].copy_from_slice(&x);
        }
        if let Some(x) = self.velocity {
            finite(&format!("{what}.velocity"), &x)?;
            state[3..6].copy_from_slice(&x);
        }
        let attitude = match (self.attitude, self.euler_deg) {
            (Some(_), Some(_)) => {
                let what = format!("{what}.attitude and {what}.euler_deg");
                return Err(Error::value(what, "both", "one of the two", "Leave one of them out."));
            }
            (Some(q), None) => {
                let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
                if norm.is_nan() || (norm - 1.0).abs() > 1e-6 {
                    let remedy = "Divide it by its norm.";
                    return Err(Error::value(format!("{what}.attitude: norm"), norm, "1 to 1e-6", remedy));
                }
                Some(q.map(|x| x / norm))
            }
            (None, Some(angles)) => {
                finite(&format!("{what}.euler_deg"), &angles)?;
                let [roll, pitch, yaw] = angles.map(f64::to_radians);
                Some(from_euler(roll, pitch, yaw))
            }
            (None, None) => None,
        };
        if let Some(q) = attitude {
            state[6..10].copy_from_slice(&q);
        }
        if let Some(x) = self.angular_velocity {
            finite(&format!("{what}.angular_velocity"), &x)?;
            state[10..13].copy_from_slice(&x);
        }
        Ok(state)
    }
}

impl WeightsInFile {
    /// As [`TrackingWeights`], whose weight of inputs is of shares of their range: `scale` is the range squared.
    fn weights(&self, what: &str, scale: f64) -> Result<TrackingWeights> {
        let of = |own: Option<AxisWeights>| own.map_or([0.0; 3], AxisWeights::numbers);
        let own = TrackingWeights {
            position: of(self.position),
            velocity: of(self.velocity),
            attitude: of(self.attitude),
            angular_velocity: of(self.angular_velocity),
            joint: self.joint,
            joint_rate: self.joint_rate,
            input: self.input * scale,
        };
        own.validate().map_err(|error| match error {
            Error::Value { what: own, value, limit, remedy } => {
                Error::value(own.replace("weights", what), value, limit, remedy)
            }
            other => other,
        })?;
        Ok(own)
    }
}
