//! Certificate of reach: how far a wanted wrench lies inside what bounded inputs can deliver, exactly.
//!
//! In chosen rows of the wrench, moments divided by the characteristic length so that all are newtons, the attainable
//! wrenches {B u : lower ≤ u ≤ upper} are a zonotope: a centre c and one generator gᵢ = ½(upperᵢ − lowerᵢ) bᵢ per input.
//! Each facet is spanned by d − 1 independent generators, so its normal n is the direction orthogonal to them and
//!
//! ```text
//! n·y ≤ n·c + Σ |n·gᵢ|   for every attainable y
//! ```
//!
//! Enumerating the C(n, d − 1) choices gives every facet, and with them the distance of a wrench to the boundary and how
//! far it may go along a ray. A failed input has upper = lower: no generator. Where the generators span less than d
//! directions, the set is flat, and each direction across it is a facet with a margin of at most 0.
//!
//! Source: Du, Quan, Yang and Cai (2015), Journal of Guidance, Control, and Dynamics 38(8), the available control
//! authority index: the margin at hover over thrust, roll, pitch and yaw is positive if and only if the linearised
//! multirotor is controllable with its bounds. There moments are not divided by a length;
//! [`AttainableWrenches::with_length`] with 1 m gives their numbers.

use super::problem::{Problem, WRENCH};
use super::{Axis, characteristic_length};
use base::error::{Error, Result};
use dynamics::authority::AuthorityRows;
use std::fmt;

/// Most choices of generators that are enumerated: 26 inputs in six rows, 85 in four.
pub(crate) const MAX_CHOICES: usize = 100_000;
/// Generators closer to a plane than this share of their length count as in it.
const FLAT: f64 = 1e-9;

/// A vector over the chosen rows; what lies behind them is zero.
type Row = [f64; WRENCH];

/// One side of the attainable set: `normal`·y ≤ `offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facet {
    /// Outwards, of unit length, one number per chosen row.
    pub normal: Row,
    /// Distance from the origin, N; moments are divided by the [`length`](AttainableWrenches::length).
    pub offset: f64,
}

/// The attainable wrenches of a [`Problem`] within its bounds, as facets.
#[derive(Debug, Clone, PartialEq)]
pub struct AttainableWrenches {
    axes: Vec<Axis>,
    length: f64,
    generators: Vec<Row>,
    center: Row,
    facets: Vec<Facet>,
}

/// How far a wrench is from the boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margin {
    /// N, in rows whose moments are divided by the characteristic length. Inside (positive) the exact distance to the
    /// boundary; outside (negative) the largest violation of a facet, at most the distance in size.
    pub distance: f64,
    /// The way out: the normal of the facet that decides, one number per chosen row.
    pub direction: Row,
}

impl AttainableWrenches {
    /// Over `axes` (all six, or [`Axis::STEERED`], or some of them), with the
    /// [`characteristic_length`] of the geometry.
    ///
    /// # Errors
    /// [`Error::Value`] if the problem is not valid, has cones or bounds that are not finite, or an axis is named twice
    /// or none at all; [`Error::Limit`] if there are more than `MAX_CHOICES` facets to try.
    pub fn of(problem: &Problem, axes: &[Axis]) -> Result<Self> {
        Self::with_length(problem, axes, characteristic_length(&problem.geometry))
    }

    /// As [`of`](Self::of), moments divided by a given length, m.
    ///
    /// # Errors
    /// As [`of`](Self::of); [`Error::Value`] if the length is not positive.
    pub fn with_length(problem: &Problem, axes: &[Axis], length: f64) -> Result<Self> {
        check(problem, axes, length)?;
        let mut center = [0.0; WRENCH];
        let mut generators = Vec::new();
        for j in 0..problem.n_input() {
            let (lower, upper) = (problem.lower[j], problem.upper[j]);
            let mut generator = [0.0; WRENCH];
            for (k, axis) in axes.iter().enumerate() {
                let column = problem.geometry[(*axis as usize, j)] / scale(*axis, length);
                center[k] += 0.5 * (upper + lower) * column;
                generator[k] = 0.5 * (upper - lower) * column;
            }
            if norm(&generator) > 0.0 {
                generators.push(generator);
            }
        }
        let mut set = Self { axes: axes.to_vec(), length, generators, center, facets: Vec::new() };
        set.enumerate()?;
        Ok(set)
    }

    fn enumerate(&mut self) -> Result<()> {
        let d = self.axes.len();
        let across = complement(&self.generators, d);
        let (n, free) = (self.generators.len(), d - across.len());
        let choices = choose(n, free.saturating_sub(1));
        if choices > MAX_CHOICES {
            let remedy = "Ask for fewer rows, or for groups of inputs.";
            return Err(Error::limit("attainable wrenches: facets to try", choices, MAX_CHOICES, remedy));
        }
        for normal in &across {
            self.add(*normal);
        }
        if free > 0 {
            self.walk(0, &mut across.clone());
        }
        Ok(())
    }

    /// Adds the two facets of every normal that is orthogonal to `span` and to generators from `first` on.
    fn walk(&mut self, first: usize, span: &mut Vec<Row>) {
        let d = self.axes.len();
        if span.len() == d - 1 {
            if let Some(normal) = complement(span, d).first() {
                self.add(*normal);
            }
            return;
        }
        for j in first..self.generators.len() {
            if let Some(next) = orthogonal(&self.generators[j], span) {
                span.push(next);
                self.walk(j + 1, span);
                span.pop();
            }
        }
    }

    fn add(&mut self, normal: Row) {
        let middle = dot(&normal, &self.center);
        let half: f64 = self.generators.iter().map(|g| dot(&normal, g).abs()).sum();
        self.facets.push(Facet { normal, offset: half + middle });
        self.facets.push(Facet { normal: normal.map(|n| -n), offset: half - middle });
    }

    /// The chosen rows, in order.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// What moments are divided by, m.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Every facet at least once.
    pub fn facets(&self) -> &[Facet] {
        &self.facets
    }

    /// A wrench `[force; moment]` (N, N m) in the chosen rows, N: moments divided by the [`length`](Self::length). Behind the chosen
    /// rows, zeros.
    pub fn scaled(&self, wrench: &[f64; WRENCH]) -> [f64; WRENCH] {
        let mut row = [0.0; WRENCH];
        for (slot, axis) in row.iter_mut().zip(&self.axes) {
            *slot = wrench[*axis as usize] / scale(*axis, self.length);
        }
        row
    }

    /// Distance of a wrench (N, N m) to the boundary; see [`Margin`].
    pub fn margin(&self, wrench: &[f64; WRENCH]) -> Margin {
        let y = self.scaled(wrench);
        let slack = |f: &Facet| f.offset - dot(&f.normal, &y);
        let start = Margin { distance: f64::INFINITY, direction: [0.0; WRENCH] };
        self.facets.iter().fold(start, |least, f| {
            if slack(f) < least.distance { Margin { distance: slack(f), direction: f.normal } } else { least }
        })
    }

    /// Largest t ≥ 0 for which `from` + t `along` (N, N m) is attainable; `None` if `from` is not, or there is no end.
    pub fn farthest(&self, from: &[f64; WRENCH], along: &[f64; WRENCH]) -> Option<f64> {
        let (y, way) = (self.scaled(from), self.scaled(along));
        // what rounding leaves of a wrench on the boundary
        let tolerance = 1e-9 * self.generators.iter().map(norm).sum::<f64>();
        let mut farthest = f64::INFINITY;
        for facet in &self.facets {
            let (slack, speed) = (facet.offset - dot(&facet.normal, &y), dot(&facet.normal, &way));
            if slack < -tolerance {
                return None;
            }
            if speed > 1e-12 * norm(&way) {
                farthest = farthest.min(slack.max(0.0) / speed);
            }
        }
        farthest.is_finite().then_some(farthest)
    }
}

/// What bounded inputs can do about one wanted wrench.
#[derive(Debug, Clone, PartialEq)]
pub struct WrenchMargin {
    /// The rows asked about.
    pub axes: Vec<Axis>,
    /// What moments are divided by, m.
    pub length: f64,
    /// Independent directions among the rows, of inputs that have room; tolerance
    /// `RANK_TOLERANCE`.
    pub rank: usize,
    /// Of the scaled rows: the norm of the weakest wrench (N) that inputs of norm 1 N make; 0 below full rank.
    pub smallest_singular_value: f64,
    /// Likewise, of the strongest wrench.
    pub largest_singular_value: f64,
    /// Rows that cannot be commanded on their own.
    pub dropped: Vec<Axis>,
    /// Distance of the wanted wrench to the boundary.
    pub margin: Margin,
}

impl WrenchMargin {
    /// Certifies `wrench` (N, N m, body, about the centre of mass) over `axes`.
    ///
    /// # Errors
    /// As [`AttainableWrenches::of`]; [`Error::Value`] if the wrench is not finite.
    pub fn of(problem: &Problem, axes: &[Axis], wrench: &[f64; WRENCH]) -> Result<Self> {
        Self::within(problem, &AttainableWrenches::of(problem, axes)?, wrench)
    }

    /// Likewise, with the attainable set of the problem at hand; the axes are those of `set`.
    ///
    /// # Errors
    /// [`Error::Value`] if the wrench is not finite.
    pub fn within(problem: &Problem, set: &AttainableWrenches, wrench: &[f64; WRENCH]) -> Result<Self> {
        base::error::finite("reach: wrench", wrench)?;
        let mut geometry = problem.geometry.clone();
        for j in 0..problem.n_input() {
            if problem.upper[j] <= problem.lower[j] {
                geometry.column_mut(j).fill(0.0);
            }
        }
        let rows = AuthorityRows::new(&geometry, set.axes(), set.length());
        Ok(Self {
            axes: set.axes().to_vec(),
            length: set.length(),
            rank: rows.rank(),
            smallest_singular_value: rows.smallest(),
            largest_singular_value: rows.largest(),
            dropped: rows.dropped(),
            margin: set.margin(wrench),
        })
    }

    /// Whether the wrench can be delivered with room all around it.
    pub fn is_inside(&self) -> bool {
        self.margin.distance > 0.0
    }

    /// The way to the nearest limit in words, strongest first: `+yaw`, or `+roll 0.87 −yaw 0.50`.
    pub fn weakest(&self) -> String {
        let mut parts: Vec<(f64, Axis)> =
            self.margin.direction.iter().copied().zip(self.axes.iter().copied()).collect();
        parts.retain(|(n, _)| n.abs() > 0.05);
        parts.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
        let sign = |n: f64| if n < 0.0 { "−" } else { "+" };
        match parts.as_slice() {
            [(n, axis)] => format!("{}{}", sign(*n), axis.name()),
            several => several
                .iter()
                .map(|(n, axis)| format!("{}{} {:.2}", sign(*n), axis.name(), n.abs()))
                .collect::<Vec<_>>()
                .join(" "),
        }
    }
}

impl fmt::Display for WrenchMargin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "rank {} of {}, margin {:.3} N, nearest limit {}",
            self.rank,
            self.axes.len(),
            self.margin.distance,
            self.weakest()
        )
    }
}

fn check(problem: &Problem, axes: &[Axis], length: f64) -> Result<()> {
    problem.validate()?;
    let value = |what: &str, value: String, limit: &str, remedy: &str| Err(Error::value(what, value, limit, remedy));
    if !(length > 0.0 && length.is_finite()) {
        return value("reach: length", length.to_string(), "> 0 m", "Take the arm of the vehicle.");
    }
    if axes.is_empty() || (1..axes.len()).any(|i| axes[..i].contains(&axes[i])) {
        return value("reach: axes", format!("{axes:?}"), "one to six different ones", "Axis::STEERED is usual.");
    }
    if !problem.cones.is_empty() {
        let remedy = "Only inputs within bounds have a polytope: bound the components of each thruster.";
        return value("reach: cones", problem.cones.len().to_string(), "0", remedy);
    }
    for (j, (lower, upper)) in problem.lower.iter().zip(&problem.upper).enumerate() {
        if !(lower.is_finite() && upper.is_finite()) {
            let what = format!("reach: bounds of input {j}");
            return value(&what, format!("[{lower}, {upper}]"), "finite", "Without bounds there is no margin.");
        }
    }
    Ok(())
}

fn scale(axis: Axis, length: f64) -> f64 {
    if axis.is_moment() { length } else { 1.0 }
}

fn dot(a: &Row, b: &Row) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &Row) -> f64 {
    dot(a, a).sqrt()
}

/// The part of v orthogonal to an orthonormal `span`, of unit length; `None` where v lies in it.
fn orthogonal(v: &Row, span: &[Row]) -> Option<Row> {
    let length = norm(v);
    let mut rest = v.map(|x| x / length);
    // twice is enough (Giraud and Langou 2005)
    for _ in 0..2 {
        for s in span {
            let along = dot(&rest, s);
            for k in 0..WRENCH {
                rest[k] -= along * s[k];
            }
        }
    }
    let left = norm(&rest);
    (left > FLAT).then(|| rest.map(|x| x / left))
}

/// An orthonormal basis of what `vectors` leave of the first d dimensions.
fn complement(vectors: &[Row], d: usize) -> Vec<Row> {
    let mut basis: Vec<Row> = Vec::with_capacity(d);
    let longest = |from: &[Row], basis: &[Row]| {
        let rest = from.iter().filter_map(|v| orthogonal(v, basis).map(|o| (dot(v, &o).abs(), o)));
        rest.max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let size = vectors.iter().map(norm).fold(0.0, f64::max);
    while basis.len() < d {
        match longest(vectors, &basis) {
            Some((left, next)) if left > FLAT * size => basis.push(next),
            _ => break,
        }
    }
    let spanned = basis.len();
    let units: Vec<Row> = (0..d).map(|k| std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 })).collect();
    while basis.len() < d {
        match longest(&units, &basis) {
            Some((_, next)) => basis.push(next),
            None => break,
        }
    }
    basis.split_off(spanned)
}

/// n over k, or the largest number there is.
fn choose(n: usize, k: usize) -> usize {
    if k > n {
        return 0;
    }
    (0..k).try_fold(1usize, |c, i| Some(c.checked_mul(n - i)? / (i + 1))).unwrap_or(usize::MAX)
}
