//! A course to fly: a tracking cost with gates to pass and obstacles to keep clear of.

use super::cost::{OptimalCost, StageInput, Terms};
use super::tracking_cost::TrackingCost;
use autodiff::{Array, Scalar};
use base::error::{Error, Result, finite};
use dynamics::spatial::{Vec3, constants, cross, dot, sub};
use serde::{Deserialize, Serialize};

/// An opening that is passed at a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CourseGate {
    /// When, s: at the stage nearest to it.
    pub time: f64,
    /// Its middle, world, m.
    pub position: [f64; 3],
    /// Heading that the opening stands across, rad; it may be passed either way.
    #[serde(default)]
    pub yaw: f64,
    /// Half of its width and of its height, less half of what flies, m.
    #[serde(default = "half_a_metre")]
    pub half_size: [f64; 2],
}

fn half_a_metre() -> [f64; 2] {
    [0.5; 2]
}

/// What is kept clear of.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CourseObstacle {
    /// Its middle, world, m.
    pub position: [f64; 3],
    /// With the radius of what flies, m.
    pub radius: f64,
    /// A pillar without end, not a ball.
    #[serde(default)]
    pub pillar: bool,
}

/// A tracking cost with gates and obstacles as conditions.
#[derive(Debug, Clone)]
pub struct CourseCost {
    tracking: TrackingCost,
    has_gates: bool,
    obstacles: Vec<CourseObstacle>,
}

impl CourseGate {
    /// Numbers in the flat form: whether it is there, middle, across, up, half sizes.
    const DIM: usize = 12;

    /// Checks that its numbers are finite, its time ≥ 0 and its sizes > 0.
    ///
    /// # Errors
    /// [`Error::Value`] for the first that is not.
    pub fn validate(&self) -> Result<()> {
        finite("gate: position", &self.position)?;
        finite("gate: yaw", &[self.yaw])?;
        if !(self.time >= 0.0 && self.time.is_finite()) {
            return Err(Error::value("gate: time", self.time, "≥ 0 s", "Say when it is passed."));
        }
        match self.half_size.iter().find(|half| !(**half > 0.0 && half.is_finite())) {
            None => Ok(()),
            Some(half) => Err(Error::value("gate: half_size", half, "> 0 m", "Leave it out for half a metre.")),
        }
    }

    fn write(&self, row: &mut [f64]) {
        let (s, c) = self.yaw.sin_cos();
        row[0] = 1.0;
        row[1..4].copy_from_slice(&self.position);
        row[4..7].copy_from_slice(&[-s, c, 0.0]);
        row[7..10].copy_from_slice(&[0.0, 0.0, 1.0]);
        row[10..12].copy_from_slice(&self.half_size);
    }
}

impl CourseCost {
    /// Of a tracking cost.
    ///
    /// # Errors
    /// [`Error::Value`] for an obstacle whose numbers are not finite or whose radius is not > 0.
    pub fn new(tracking: TrackingCost, has_gates: bool, obstacles: &[CourseObstacle]) -> Result<Self> {
        for obstacle in obstacles {
            finite("obstacle: position", &obstacle.position)?;
            if !(obstacle.radius > 0.0 && obstacle.radius.is_finite()) {
                return Err(Error::value("obstacle: radius", obstacle.radius, "> 0 m", "Leave the obstacle out."));
            }
        }
        Ok(Self { tracking, has_gates, obstacles: obstacles.to_vec() })
    }

    /// What it is without gates and obstacles.
    pub fn tracking(&self) -> &TrackingCost {
        &self.tracking
    }

    /// The last parameters of a stage: those of a gate, or of none.
    pub fn write_gate(&self, gate: Option<&CourseGate>, parameters: &mut [f64]) {
        if self.has_gates {
            let first = parameters.len() - CourseGate::DIM;
            parameters[first..].fill(0.0);
            gate.iter().for_each(|gate| gate.write(&mut parameters[first..]));
        }
    }

    fn conditions<S: Scalar>(&self, position: Vec3<S>, parameters: &[S], terms: &mut Terms<S>) {
        for obstacle in &self.obstacles {
            let away = sub(position, constants(obstacle.position));
            let away = if obstacle.pillar { [away[0], away[1], S::zero()] } else { away };
            let square = S::constant(1.0 / obstacle.radius.powi(2)) * dot(away, away);
            terms.at_most_zero(S::one() - square);
        }
        if self.has_gates {
            let gate = &parameters[parameters.len() - CourseGate::DIM..];
            let (there, middle) = (gate[0], gate.array::<3>(1));
            let (across, up) = (gate.array::<3>(4), gate.array::<3>(7));
            let away = sub(position, middle);
            for (axis, half) in [(across, gate[10]), (up, gate[11])] {
                let own = dot(axis, away);
                terms.at_most_zero(there * (own - half));
                terms.at_most_zero(there * (-own - half));
            }
            terms.zero(there * dot(cross(across, up), away));
        }
    }
}

impl OptimalCost for CourseCost {
    fn n_parameter(&self) -> usize {
        self.tracking.n_parameter() + if self.has_gates { CourseGate::DIM } else { 0 }
    }

    fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>) {
        let own = StageInput { parameters: &now.parameters[..self.tracking.n_parameter()], ..now };
        self.tracking.stage(own, terms);
        self.conditions(self.tracking.position(now.state), now.parameters, terms);
    }

    fn terminal<S: Scalar>(&self, end: StageInput<'_, S>, terms: &mut Terms<S>) {
        let own = StageInput { parameters: &end.parameters[..self.tracking.n_parameter()], ..end };
        self.tracking.terminal(own, terms);
        self.conditions(self.tracking.position(end.state), end.parameters, terms);
    }
}
