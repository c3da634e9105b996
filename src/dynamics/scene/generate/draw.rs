//! What all generators draw with, and check.

use crate::scene::{MAX_ELEMENTS, Obstacle};
use crate::shape::{Geometry, Shape, within};
use crate::spatial::Vec3;
use base::error::{Error, Result};
use rng::{Purpose, Stream};

/// What a scene is drawn from.
pub(super) fn stream(seed: u64) -> Stream {
    Stream::new(seed, 0, 0, Purpose::TASK)
}

/// Checks that both ends of a range lie in [`least`, `most`] and are in order.
pub(super) fn range(what: &str, [lo, hi]: [f64; 2], least: f64, most: f64) -> Result<()> {
    within(&format!("{what}[0]"), lo, least, most)?;
    within(&format!("{what}[1]"), hi, least, most)?;
    if lo <= hi {
        return Ok(());
    }
    Err(Error::value(what, format!("[{lo}, {hi}]"), "[least, most]", "Swap the two."))
}

/// Checks a number of things.
pub(super) fn count(what: &str, n: usize) -> Result<()> {
    if (1..=MAX_ELEMENTS).contains(&n) {
        return Ok(());
    }
    Err(Error::limit(what, n, format!("1 to {MAX_ELEMENTS}"), "Leave out what no vehicle can reach."))
}

/// An upright block about a centre, turned by `yaw` about z.
pub(super) fn block(name: String, center: Vec3<f64>, size: Vec3<f64>, yaw: f64) -> Obstacle {
    let (s, c) = (0.5 * yaw).sin_cos();
    Obstacle { name, shape: Shape::new(Geometry::Box { size }).at(center).turned([c, 0.0, 0.0, s]) }
}
