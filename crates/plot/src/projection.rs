//! Parallel projection of space onto the page.

use super::axis::drawable;
use super::canvas::{Area, Point};
use nalgebra::Vector3;

/// A parallel projection fitted into a rectangle.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    right: Vector3<f64>,
    up: Vector3<f64>,
    /// From the scene to the viewer, of unit length.
    pub toward: Vector3<f64>,
    /// Figure units per metre.
    pub scale: f64,
    offset: Point,
    /// Of the box around the points.
    pub middle: Vector3<f64>,
}

impl View {
    /// Seen from `azimuth_deg` about z (counter-clockwise from +x) and `elevation_deg` above the horizon, such that all
    /// `points` lie in `room`; `None` where there is no room.
    pub fn fit(azimuth_deg: f64, elevation_deg: f64, points: &[[f64; 3]], room: Area) -> Option<Self> {
        let radians = |degrees: f64| if degrees.is_finite() { degrees.to_radians() } else { 0.0 };
        let ((sa, ca), (se, ce)) = (radians(azimuth_deg).sin_cos(), radians(elevation_deg).sin_cos());
        let mut view = Self {
            right: Vector3::new(-sa, ca, 0.0),
            up: Vector3::new(-ca * se, -sa * se, ce),
            toward: Vector3::new(ca * ce, sa * ce, se),
            scale: 1.0,
            offset: (0.0, 0.0),
            middle: middle(points),
        };
        let (mut lo, mut hi) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
        for p in points {
            let c = view.point(*p);
            lo = (lo.0.min(c.0), lo.1.min(c.1));
            hi = (hi.0.max(c.0), hi.1.max(c.1));
        }
        if room.width() < 20.0 || room.height() < 20.0 {
            return None;
        }
        view.scale = (room.width() / (hi.0 - lo.0)).min(room.height() / (hi.1 - lo.1));
        let centre = (0.5 * (lo.0 + hi.0) * view.scale, 0.5 * (lo.1 + hi.1) * view.scale);
        let target = (0.5 * (room.x0 + room.x1), 0.5 * (room.y0 + room.y1));
        view.offset = (target.0 - centre.0, target.1 - centre.1);
        (view.scale.is_finite() && view.scale > 0.0).then_some(view)
    }

    /// A point of space on the page; NaN for what cannot be drawn.
    pub fn point(&self, p: [f64; 3]) -> Point {
        if !p.iter().all(|v| drawable(*v, false)) {
            return (f64::NAN, f64::NAN);
        }
        let (x, y) = self.direction(Vector3::from(p) - self.middle);
        (self.offset.0 + self.scale * x, self.offset.1 + self.scale * y)
    }

    /// A direction of space on the page, per unit of its length.
    pub fn direction(&self, d: Vector3<f64>) -> Point {
        (d.dot(&self.right), -d.dot(&self.up))
    }

    /// How near the viewer a point is, m.
    pub fn depth(&self, p: [f64; 3]) -> f64 {
        (Vector3::from(p) - self.middle).dot(&self.toward)
    }
}

fn middle(points: &[[f64; 3]]) -> Vector3<f64> {
    let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in points {
        for i in 0..3 {
            (lo[i], hi[i]) = (lo[i].min(p[i]), hi[i].max(p[i]));
        }
    }
    0.5 * (Vector3::from(lo) + Vector3::from(hi))
}
