//! What triangles must be for their outside to be told from their inside.

use super::{MAX_TRIANGLES, area};
use crate::spatial::{Vec3, dot, sub};
use base::error::{Error, Result, finite};

/// Largest coordinate, in units of the mesh: its square is far from the end of `f64`.
const FARTHEST: f64 = 1e9;

/// Vertices, and triangles by the numbers of their corners.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Triangles {
    pub vertices: Vec<Vec3<f64>>,
    pub triangles: Vec<[u32; 3]>,
}

/// Half an edge: of one triangle, with the lower of its ends first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Half {
    ends: [u32; 2],
    /// Whether its triangle passes it from the higher end to the lower.
    back: bool,
}

impl Triangles {
    /// The corners of triangle `k`.
    #[inline]
    pub fn corners(&self, k: u32) -> [Vec3<f64>; 3] {
        self.triangles[k as usize].map(|i| self.vertices[i as usize])
    }

    /// Middle of the box around all, and the farthest corner from there, and a little.
    pub fn ball(&self) -> (Vec3<f64>, f64) {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in &self.vertices {
            for k in 0..3 {
                (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
            }
        }
        let center = [0, 1, 2].map(|k| 0.5 * (low[k] + high[k]));
        let squared = |p: &Vec3<f64>| dot(sub(*p, center), sub(*p, center));
        (center, self.vertices.iter().map(squared).fold(0.0, f64::max).sqrt() * 1.000_001)
    }

    /// Checks all that there is to check.
    pub fn check(&self, what: &str) -> Result<()> {
        check_count(what, self.triangles.len())?;
        for (i, p) in self.vertices.iter().enumerate() {
            finite(&format!("{what}: vertex {i}"), p)?;
            if let Some(x) = p.iter().find(|x| x.abs() > FARTHEST) {
                let (limit, remedy) = (format!("within ±{FARTHEST:e}"), "Give the mesh in other units, and its scale.");
                return Err(Error::value(format!("{what}: vertex {i}"), x, limit, remedy));
            }
        }
        for (k, corners) in self.triangles.iter().enumerate() {
            self.check_corners(&format!("{what}: triangle {k}"), corners)?;
        }
        self.check_closed(what)?;
        self.check_outside(what)
    }

    fn check_corners(&self, what: &str, corners: &[u32; 3]) -> Result<()> {
        let n = self.vertices.len();
        if let Some(i) = corners.iter().find(|i| **i as usize >= n) {
            let limit = format!("below {n}, the number of vertices");
            return Err(Error::value(format!("{what}: corner"), i, limit, "Vertices count from 0."));
        }
        let [a, b, c] = corners.map(|i| self.vertices[i as usize]);
        let longest = [sub(b, a), sub(c, b), sub(a, c)].iter().map(|e| dot(*e, *e)).fold(0.0, f64::max);
        let twice = dot(area([a, b, c]), area([a, b, c])).sqrt();
        if twice > 1e-10 * longest {
            return Ok(());
        }
        let limit = "above 0: its corners are one, or on a line";
        let remedy = "Remove such triangles in the tool that made the mesh (merge vertices by distance).";
        Err(Error::value(format!("{what}: area"), format!("{:e}", 0.5 * twice), limit, remedy))
    }

    /// Every edge is that of two triangles, which pass it in opposite directions.
    fn check_closed(&self, what: &str) -> Result<()> {
        let mut halves: Vec<Half> = Vec::with_capacity(3 * self.triangles.len());
        for &[a, b, c] in &self.triangles {
            for [from, to] in [[a, b], [b, c], [c, a]] {
                halves.push(Half { ends: [from.min(to), from.max(to)], back: from > to });
            }
        }
        halves.sort_unstable();
        let paired = |edge: &[Half]| matches!(edge, [one, other] if one.back != other.back);
        let mut open = halves.chunk_by(|a, b| a.ends == b.ends).filter(|edge| !paired(edge));
        let Some(first) = open.next() else { return Ok(()) };
        let [from, to] = first[0].ends.map(|i| self.vertices[i as usize]);
        let n = 1 + open.count();
        let limit = "0: a closed mesh, each edge shared by exactly two triangles that pass it in opposite directions";
        let remedy = "Close its holes, make one vertex of those at the same place, and turn all outsides out.";
        Err(Error::value(
            format!("{what}: number of open edges"),
            format!("{n}, the first from {from:?} to {to:?}"),
            limit,
            remedy,
        ))
    }

    /// The volume within is above 0.
    fn check_outside(&self, what: &str) -> Result<()> {
        // about one of the vertices, so that a small mesh far away keeps its digits
        let origin = self.vertices[0];
        let part = |k: u32| {
            let corners = self.corners(k);
            dot(sub(corners[0], origin), area(corners)) / 6.0
        };
        let volume: f64 = (0..self.triangles.len() as u32).map(part).sum();
        if volume > 0.0 {
            return Ok(());
        }
        let limit = "above 0: corners go counter-clockwise seen from outside";
        Err(Error::value(format!("{what}: volume"), format!("{volume:e}"), limit, "Turn the triangles over."))
    }
}

/// That there are neither too few triangles for a solid nor too many.
pub(super) fn check_count(what: &str, n: usize) -> Result<()> {
    if (4..=MAX_TRIANGLES).contains(&n) {
        return Ok(());
    }
    let remedy = "A closed mesh has at least four; simplify one with too many, or split it into several.";
    Err(Error::limit(format!("{what}: number of triangles"), n, format!("4 to {MAX_TRIANGLES}"), remedy))
}
