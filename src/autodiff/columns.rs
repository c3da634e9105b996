//! Numbers of a block of environments as structure of arrays, where registers do not straddle lines of the cache.

use super::program::BLOCK;
use bytemuck::{Pod, Zeroable};
use std::ops::{Deref, DerefMut};

/// Row k holds number k of [`BLOCK`] environments. Each begins at a line of the cache: a register that lies across two
/// costs two accesses.
#[derive(Debug, Clone, Default)]
pub(crate) struct Columns(Vec<Row>);

#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
struct Row([f32; BLOCK]);

impl Columns {
    /// `n` rows of zeros.
    pub(crate) fn zeros(n: usize) -> Self {
        Self(vec![Row([0.0; BLOCK]); n])
    }
}

impl FromIterator<[f32; BLOCK]> for Columns {
    fn from_iter<I: IntoIterator<Item = [f32; BLOCK]>>(rows: I) -> Self {
        Self(rows.into_iter().map(Row).collect())
    }
}

impl Deref for Columns {
    type Target = [[f32; BLOCK]];
    #[inline(always)]
    fn deref(&self) -> &Self::Target {
        bytemuck::must_cast_slice(&self.0)
    }
}

impl DerefMut for Columns {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut Self::Target {
        bytemuck::must_cast_slice_mut(&mut self.0)
    }
}

impl<'a> IntoIterator for &'a Columns {
    type Item = &'a [f32; BLOCK];
    type IntoIter = std::slice::Iter<'a, [f32; BLOCK]>;
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<'a> IntoIterator for &'a mut Columns {
    type Item = &'a mut [f32; BLOCK];
    type IntoIter = std::slice::IterMut<'a, [f32; BLOCK]>;
    fn into_iter(self) -> Self::IntoIter {
        self.iter_mut()
    }
}
