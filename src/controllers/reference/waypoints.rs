//! A path through points with the least snap.

use super::trajectory::{Curve, coordinates, within};
use autodiff::Scalar;
use base::error::{Error, Result};
use dynamics::spatial::Vec3;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Most points of one path: the system to solve has eight rows per segment.
pub const MAX_WAYPOINTS: usize = 64;
/// Shortest time between two points, s.
const SHORTEST: f64 = 1e-3;
/// Largest ratio of the durations of neighbouring segments.
const LARGEST_RATIO: f64 = 100.0;
/// Coefficients of one segment: degree 7.
const TERMS: usize = 8;

/// A point to be passed at a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Waypoint {
    /// s, increasing along the path by at least 1 ms.
    pub time: f64,
    /// World, m.
    pub position: [f64; 3],
    /// rad. A path turns the short way to it, by half a turn at most, unless it counts full turns
    /// ([`Waypoints::with_turns`]). Default 0.
    #[serde(default)]
    pub yaw: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    points: Vec<Waypoint>,
    /// Whether yaw is taken as it is given, full turns included.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    turns: bool,
}

/// Piecewise polynomials of degree 7 through the points, at rest at both ends (velocity, acceleration and jerk zero)
/// and continuous up to the sixth derivative between: the path of least ∫ snap² for the given times (Mellinger and
/// Kumar 2011). Snap jumps at the two ends alone; before and after, the path rests.
///
/// A path may swing out between points that ask for sharp turns: add points, or time, where it must not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Config", into = "Config")]
pub struct Waypoints {
    points: Vec<Waypoint>,
    turns: bool,
    /// Per segment and power of s = (t − tᵢ)/(tᵢ₊₁ − tᵢ): x, y, z, yaw.
    segments: Vec<[[f64; 4]; TERMS]>,
}

impl TryFrom<Config> for Waypoints {
    type Error = Error;
    fn try_from(config: Config) -> Result<Self> {
        Self::solved(config.points, config.turns)
    }
}

impl From<Waypoints> for Config {
    fn from(w: Waypoints) -> Self {
        Self { points: w.points, turns: w.turns }
    }
}

impl Default for Waypoints {
    /// A square of 2 m that climbs and comes back, 2 s a side.
    fn default() -> Self {
        let corners = [[0.0, 0.0, 2.0], [2.0, 0.0, 2.4], [2.0, 2.0, 2.8], [0.0, 2.0, 2.4], [0.0, 0.0, 2.0]];
        let points = (0..5).map(|i| Waypoint { time: 2.0 * i as f64, position: corners[i], yaw: 0.0 }).collect();
        Self::new(points).expect("the default points are valid")
    }
}

impl Waypoints {
    /// Solves for the path through 2 to [`MAX_WAYPOINTS`] points that turns the short way from yaw to yaw: 3.1 and −3.1 rad
    /// are 5° apart.
    ///
    /// # Errors
    /// [`Error::Limit`] for fewer or more points; [`Error::Value`] for a number that is not finite, times that do not rise by 1 ms, or
    /// segments next to each other whose times differ by a factor of more than 100.
    pub fn new(points: Vec<Waypoint>) -> Result<Self> {
        Self::solved(points, false)
    }

    /// As [`Waypoints::new`], every yaw taken as it is given: from 0 to 2π is one full turn.
    ///
    /// # Errors
    /// As [`Waypoints::new`].
    pub fn with_turns(points: Vec<Waypoint>) -> Result<Self> {
        Self::solved(points, true)
    }

    fn solved(points: Vec<Waypoint>, turns: bool) -> Result<Self> {
        validate(&points, MAX_WAYPOINTS)?;
        let yaws = if turns { points.iter().map(|p| p.yaw).collect() } else { unwrapped(&points) };
        let segments = solve(&points, &yaws)?;
        Ok(Self { points, turns, segments })
    }

    /// The points, as they were given.
    pub fn points(&self) -> &[Waypoint] {
        &self.points
    }

    /// Time of the last point, s.
    pub fn end(&self) -> f64 {
        self.points[self.points.len() - 1].time
    }

    /// Position (world, m) and yaw (rad) at time t.
    pub(super) fn position_and_yaw<S: Scalar>(&self, t: S) -> (Vec3<S>, S) {
        let t = t.clamp(S::constant(self.points[0].time), S::constant(self.end()));
        let mut start = S::constant(self.points[0].time);
        let mut duration = S::constant(self.points[1].time) - start;
        let mut c = [[S::zero(); 4]; TERMS];
        for k in 0..TERMS {
            for axis in 0..4 {
                c[k][axis] = S::constant(self.segments[0][k][axis]);
            }
        }
        for i in 1..self.segments.len() {
            let from = S::constant(self.points[i].time);
            let before = t.lt(from);
            start = S::select(before, start, from);
            duration = S::select(before, duration, S::constant(self.points[i + 1].time) - from);
            for k in 0..TERMS {
                for axis in 0..4 {
                    c[k][axis] = S::select(before, c[k][axis], S::constant(self.segments[i][k][axis]));
                }
            }
        }
        let s = (t - start) / duration;
        let mut p = c[TERMS - 1];
        for k in 1..TERMS {
            for axis in 0..4 {
                p[axis] = s.mul_add(p[axis], c[TERMS - 1 - k][axis]);
            }
        }
        ([p[0], p[1], p[2]], p[3])
    }
}

impl Curve for Waypoints {
    fn name(&self) -> &'static str {
        "waypoints"
    }

    fn description(&self) -> &'static str {
        "a minimum-snap path through points, rest to rest"
    }

    #[inline]
    fn position<S: Scalar>(&self, t: S) -> Vec3<S> {
        self.position_and_yaw(t).0
    }

    #[inline]
    fn yaw<S: Scalar>(&self, t: S) -> S {
        self.position_and_yaw(t).1
    }

    fn duration(&self) -> Option<f64> {
        Some(self.end())
    }
}

/// Each yaw within half a turn of the one before; a yaw half a turn away stays on the side where it was given.
pub(super) fn unwrapped(points: &[Waypoint]) -> Vec<f64> {
    let (mut yaws, mut turns) = (vec![points[0].yaw], 0.0);
    for pair in points.windows(2) {
        let change = pair[1].yaw - pair[0].yaw;
        // rounding makes no turn of half a one
        turns += change.signum() * ((change.abs() - PI) / TAU - 1e-9).ceil().max(0.0);
        yaws.push(pair[1].yaw - TAU * turns);
    }
    yaws
}

/// Refuses fewer than 2 points or more than `most`, and numbers and times of which no path is made.
pub(super) fn validate(points: &[Waypoint], most: usize) -> Result<()> {
    if points.len() < 2 || points.len() > most {
        return Err(Error::limit(
            "number of waypoints",
            points.len(),
            format!("2 to {most}"),
            "For one point use the hover reference; split longer paths.",
        ));
    }
    for (i, point) in points.iter().enumerate() {
        within(&format!("waypoint {i}: time"), &[point.time], 0.0, 1e6)?;
        coordinates(&format!("waypoint {i}: position"), &point.position)?;
        coordinates(&format!("waypoint {i}: yaw"), &[point.yaw])?;
    }
    for i in 1..points.len() {
        let gap = points[i].time - points[i - 1].time;
        if gap < SHORTEST {
            return Err(Error::value(
                format!("waypoint {i}: time"),
                points[i].time,
                format!("at least {SHORTEST} s after waypoint {} at {} s", i - 1, points[i - 1].time),
                "Times must increase along the path.",
            ));
        }
        if i >= 2 {
            let last = points[i - 1].time - points[i - 2].time;
            if gap / last > LARGEST_RATIO || last / gap > LARGEST_RATIO {
                return Err(Error::value(
                    format!("waypoint {i}: time"),
                    format!("{gap} s after a segment of {last} s"),
                    format!("within a factor of {LARGEST_RATIO} of the segment before"),
                    "Spread the times more evenly.",
                ));
            }
        }
    }
    Ok(())
}

/// The 8n conditions on n segments: ends of every segment, rest at both ends of the path, and continuity of
/// derivatives 1 to 6 at the inner points. With s ∈ [0, 1] on each segment, derivative k over k! at s = 1 is
/// Σⱼ C(j, k) cⱼ, and at s = 0 it is c_k.
fn solve(points: &[Waypoint], yaws: &[f64]) -> Result<Vec<[[f64; 4]; TERMS]>> {
    let n = points.len() - 1;
    let target = |i: usize| [points[i].position[0], points[i].position[1], points[i].position[2], yaws[i]];
    let duration = |i: usize| points[i + 1].time - points[i].time;
    let mut a = DMatrix::zeros(TERMS * n, TERMS * n);
    let mut b = DMatrix::zeros(TERMS * n, 4);
    let mut row = 0;
    for i in 0..n {
        a[(row, TERMS * i)] = 1.0;
        for j in 0..TERMS {
            a[(row + 1, TERMS * i + j)] = 1.0;
        }
        for axis in 0..4 {
            b[(row, axis)] = target(i)[axis];
            b[(row + 1, axis)] = target(i + 1)[axis];
        }
        row += 2;
    }
    for k in 1..4 {
        a[(row, k)] = 1.0;
        for j in k..TERMS {
            a[(row + 1, TERMS * (n - 1) + j)] = binomial(j, k);
        }
        row += 2;
    }
    for i in 0..n - 1 {
        let ratio = duration(i) / duration(i + 1);
        for k in 1..7 {
            // Both sides times (Tᵢ or Tᵢ₊₁)ᵏ, whichever keeps the row of order one.
            let power = ratio.powi(k as i32);
            let (left, right) = if power > 1.0 { (1.0 / power, 1.0) } else { (1.0, power) };
            for j in k..TERMS {
                a[(row, TERMS * i + j)] = left * binomial(j, k);
            }
            a[(row, TERMS * (i + 1) + k)] = -right;
            row += 1;
        }
    }
    let unsolved = || {
        Error::value(
            "waypoints",
            "a path that could not be solved to 1e-6",
            "of moderate spread in time and space",
            "Spread the times more evenly.",
        )
    };
    let x = a.clone().lu().solve(&b).ok_or_else(unsolved)?;
    let residual = (a * &x - &b).amax();
    if !residual.is_finite() || residual > 1e-6 * (1.0 + b.amax()) {
        return Err(unsolved());
    }
    let mut segments = vec![[[0.0; 4]; TERMS]; n];
    for (i, segment) in segments.iter_mut().enumerate() {
        for (k, coefficients) in segment.iter_mut().enumerate() {
            for (axis, c) in coefficients.iter_mut().enumerate() {
                *c = x[(TERMS * i + k, axis)];
            }
        }
    }
    Ok(segments)
}

fn binomial(n: usize, k: usize) -> f64 {
    (0..k).fold(1.0, |c, i| c * (n - i) as f64 / (i + 1) as f64)
}
