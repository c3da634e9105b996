//! A curve through samples of a path, as a planner or a recording gives them.

use super::setpoint::Setpoint;
use super::trajectory::{Series, Trajectory, coordinates};
use super::waypoints::{Waypoint, unwrapped, validate};
use autodiff::jet::Jet;
use base::error::{Error, Result};
use nalgebra::{Matrix2, Matrix2x4};
use serde::{Deserialize, Serialize};

/// Most samples of one curve.
pub const MAX_SAMPLES: usize = 4000;
/// Coefficients of one segment: degree 5.
const TERMS: usize = 6;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    #[serde(default, skip_serializing_if = "is_zero")]
    start_velocity: [f64; 3],
    #[serde(default, skip_serializing_if = "is_zero")]
    end_velocity: [f64; 3],
    points: Vec<Waypoint>,
}

fn is_zero(velocity: &[f64; 3]) -> bool {
    *velocity == [0.0; 3]
}

/// The curve of least ∫ jerk² through many points: piecewise polynomials of degree 5 with four continuous derivatives, so that snap is
/// continuous too. Velocities at both ends are given, by default zero, and so is the jerk there; yaw begins and ends without a rate, and turns
/// as that of [`Waypoints`](super::Waypoints). Before and after, it rests at its ends: where one of them is in motion, velocity jumps there.
///
/// [`Waypoints`](super::Waypoints) are few and swing through each; this takes positions as close together as a planner gives them. Velocities
/// between the ends are not asked for: those of an integrator agree with its positions to its own error alone, which as snap is large.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Config", into = "Config")]
pub struct Sampled {
    points: Vec<Waypoint>,
    velocities: [[f64; 3]; 2],
    /// Per segment and power of t − tᵢ: x, y, z, yaw.
    segments: Vec<[[f64; 4]; TERMS]>,
}

impl TryFrom<Config> for Sampled {
    type Error = Error;
    fn try_from(config: Config) -> Result<Self> {
        Self::with_velocities(config.points, [config.start_velocity, config.end_velocity])
    }
}

impl From<Sampled> for Config {
    fn from(own: Sampled) -> Self {
        let [start_velocity, end_velocity] = own.velocities;
        Self { start_velocity, end_velocity, points: own.points }
    }
}

impl Sampled {
    /// From rest to rest through 2 to [`MAX_SAMPLES`] points.
    ///
    /// # Errors
    /// As [`Waypoints::new`](super::Waypoints::new), but for the number of points.
    pub fn new(points: Vec<Waypoint>) -> Result<Self> {
        Self::with_velocities(points, [[0.0; 3]; 2])
    }

    /// With velocities at the first and the last point, m/s, world.
    ///
    /// # Errors
    /// As [`Sampled::new`], and [`Error::Value`] for a velocity that is not finite or beyond 10⁶ m/s.
    pub fn with_velocities(points: Vec<Waypoint>, velocities: [[f64; 3]; 2]) -> Result<Self> {
        validate(&points, MAX_SAMPLES)?;
        coordinates("start_velocity", &velocities[0])?;
        coordinates("end_velocity", &velocities[1])?;
        let segments = solve(&points, &unwrapped(&points), velocities)?;
        Ok(Self { points, velocities, segments })
    }

    /// The points, as they were given.
    pub fn points(&self) -> &[Waypoint] {
        &self.points
    }

    /// Time of the last point, s.
    pub fn end(&self) -> f64 {
        self.points[self.points.len() - 1].time
    }

    /// Of a segment, `since` its start.
    fn at(&self, segment: usize, since: Jet<f64, 5>) -> Series {
        let of = |axis: usize| {
            let terms = self.segments[segment].iter().rev().map(|power| Jet::fixed(power[axis]));
            terms.fold(Jet::fixed(0.0), |sum, term| sum * since + term)
        };
        ([0, 1, 2].map(of), of(3))
    }
}

impl Trajectory for Sampled {
    fn name(&self) -> &'static str {
        "sampled"
    }

    fn description(&self) -> &'static str {
        "the curve of least jerk through samples of a path"
    }

    fn sample(&self, t: f64) -> Setpoint<f64> {
        let (position, yaw) = self.series(t);
        Setpoint::from_series(position, yaw)
    }

    fn series(&self, t: f64) -> Series {
        let last = self.points.len() - 2;
        match self.points.partition_point(|point| point.time <= t) {
            0 => self.at(0, Jet::fixed(0.0)),
            begun if begun > last + 1 => self.at(last, Jet::fixed(self.end() - self.points[last].time)),
            begun => self.at(begun - 1, Jet::variable(t - self.points[begun - 1].time)),
        }
    }

    fn duration(&self) -> Option<f64> {
        Some(self.end())
    }
}

/// The polynomials. Half of the gradient of ∫ jerk² over a segment of length h, by its end's (v, a) and (v', a') with D = p' − p, is
///
/// ```text
/// v:   snap(0) = −360 D/h⁴ + 192 v/h³ + 168 v'/h³ + 36 a/h² − 24 a'/h²
/// a:  −jerk(0) =  −60 D/h³ +  36 v/h² +  24 v'/h² +  9 a/h  −  3 a'/h
/// v': −snap(h) = −360 D/h⁴ + 168 v/h³ + 192 v'/h³ + 24 a/h² − 36 a'/h²
/// a':  jerk(h) =   60 D/h³ −  24 v/h² −  36 v'/h² −  3 a/h  +  9 a'/h
/// ```
///
/// Their sums over both segments of a point are zero: a system for all (v, a) with blocks of two beside the diagonal, symmetric and positive
/// definite, which is eliminated from the first point to the last.
fn solve(points: &[Waypoint], yaws: &[f64], velocities: [[f64; 3]; 2]) -> Result<Vec<[[f64; 4]; TERMS]>> {
    let n = points.len();
    let value = |i: usize| with_yaw(points[i].position, yaws[i]);
    let length = |i: usize| points[i + 1].time - points[i].time;
    let coupling = |h: f64| Matrix2::new(168.0 / h.powi(3), -24.0 / h.powi(2), 24.0 / h.powi(2), -3.0 / h);
    let (mut diagonal, mut right) = (vec![Matrix2::zeros(); n], vec![Matrix2x4::zeros(); n]);
    let mut beside: Vec<Matrix2<f64>> = (0..n - 1).map(|i| coupling(length(i))).collect();
    for i in 0..n - 1 {
        let (h, [from, to]) = (length(i), [value(i), value(i + 1)]);
        let [vv, va, aa] = [192.0 / h.powi(3), 36.0 / h.powi(2), 9.0 / h];
        diagonal[i] += Matrix2::new(vv, va, va, aa);
        diagonal[i + 1] += Matrix2::new(vv, -va, -va, aa);
        for k in 0..4 {
            let way = to[k] - from[k];
            let [by_velocity, by_acceleration] = [360.0 * way / h.powi(4), 60.0 * way / h.powi(3)];
            right[i][(0, k)] += by_velocity;
            right[i][(1, k)] += by_acceleration;
            right[i + 1][(0, k)] += by_velocity;
            right[i + 1][(1, k)] -= by_acceleration;
        }
    }
    // velocities of the ends are known: they go to the right-hand sides
    for (end, velocity) in [(0, velocities[0]), (n - 1, velocities[1])] {
        let known = with_yaw(velocity, 0.0);
        for k in 0..4 {
            let own = diagonal[end][(1, 0)];
            right[end][(1, k)] -= own * known[k];
            right[end][(0, k)] = known[k];
            if n == 2 {
                continue;
            }
            let (neighbour, column) = if end == 0 {
                (1, beside[0].row(0).transpose())
            } else {
                (n - 2, beside[n - 2].column(0).into_owned())
            };
            right[neighbour][(0, k)] -= column[0] * known[k];
            right[neighbour][(1, k)] -= column[1] * known[k];
        }
        if n == 2 {
            // of the other end, whose velocity is known too
            let other = 1 - end;
            let by = if end == 0 { beside[0][(0, 1)] } else { beside[0][(1, 0)] };
            (0..4).for_each(|k| right[other][(1, k)] -= by * known[k]);
        }
        diagonal[end] = Matrix2::new(1.0, 0.0, 0.0, diagonal[end][(1, 1)]);
    }
    beside[0].row_mut(0).fill(0.0);
    beside[n - 2].column_mut(0).fill(0.0);
    let unsolved = || {
        let rule = "of moderate spread in time and space";
        Error::value("points", "a curve that could not be solved", rule, "Spread the times more evenly.")
    };
    for i in 1..n {
        let factor = beside[i - 1].transpose() * diagonal[i - 1].try_inverse().ok_or_else(unsolved)?;
        let (less, known) = (factor * beside[i - 1], factor * right[i - 1]);
        diagonal[i] -= less;
        right[i] -= known;
    }
    let mut found = vec![Matrix2x4::zeros(); n];
    for i in (0..n).rev() {
        let behind = if i + 1 < n { beside[i] * found[i + 1] } else { Matrix2x4::zeros() };
        found[i] = diagonal[i].try_inverse().ok_or_else(unsolved)? * (right[i] - behind);
    }
    let segments: Vec<_> =
        (0..n - 1).map(|i| segment(length(i), [value(i), value(i + 1)], [&found[i], &found[i + 1]])).collect();
    let is_finite = |own: &[[f64; 4]; TERMS]| own.as_flattened().iter().all(|term| term.is_finite());
    if segments.iter().all(is_finite) { Ok(segments) } else { Err(unsolved()) }
}

/// The polynomial of length h between two values, with (v, a) at both.
fn segment(h: f64, [from, to]: [[f64; 4]; 2], [before, after]: [&Matrix2x4<f64>; 2]) -> [[f64; 4]; TERMS] {
    let mut terms = [[0.0; 4]; TERMS];
    for k in 0..4 {
        let (p, v, a) = (from[k], before[(0, k)], before[(1, k)]);
        // what is left of position, velocity and acceleration at the end, each in the unit of a position
        let position = to[k] - p - h * (v + 0.5 * h * a);
        let velocity = h * (after[(0, k)] - v - h * a);
        let acceleration = h * h * (after[(1, k)] - a);
        let cubic = 10.0 * position - 4.0 * velocity + 0.5 * acceleration;
        let quartic = -15.0 * position + 7.0 * velocity - acceleration;
        let quintic = 6.0 * position - 3.0 * velocity + 0.5 * acceleration;
        let own = [p, v, 0.5 * a, cubic / h.powi(3), quartic / h.powi(4), quintic / h.powi(5)];
        own.into_iter().enumerate().for_each(|(power, term)| terms[power][k] = term);
    }
    terms
}

fn with_yaw([x, y, z]: [f64; 3], yaw: f64) -> [f64; 4] {
    [x, y, z, yaw]
}
