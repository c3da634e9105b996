//! What stands in place of trees and files where the feature `mesh` is off.

use super::check::Triangles;
use crate::spatial::Vec3;
use base::error::{Error, Result};

/// There is none.
#[derive(Debug)]
pub(super) enum Tree {}

/// That there are no meshes.
pub(super) fn ready() -> Result<()> {
    let (limit, remedy) = ("on where a scene has triangle meshes or height fields", "Build with --features mesh.");
    Err(Error::value("the feature `mesh`", "off", limit, remedy))
}

impl Tree {
    pub(super) fn new(_: &Triangles, _: Vec3<f64>, _: f64) -> Result<Self> {
        ready().map(|()| unreachable!("ready refuses"))
    }

    pub(super) fn nearest(&self, _: &Triangles, _: Vec3<f64>, _: f64, _: [Vec3<f64>; 2], _: f64) -> Option<(f64, u32)> {
        match *self {}
    }
}

/// Corners of triangles, one after the other.
pub(super) fn corners_of_stl(_: Vec<u8>, _: &mut dyn FnMut([[f32; 3]; 3]) -> Result<()>) -> Result<Option<String>> {
    ready().map(|()| None)
}
