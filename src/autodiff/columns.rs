//! Numbers side by side as structure of arrays, of a block of environments or of eight steps, where registers do not straddle
//! lines of the cache.

use bytemuck::{Pod, Zeroable};
use std::ops::{Deref, DerefMut};

/// Environments per block of the lane evaluator.
pub const BLOCK: usize = 64;

/// Row k holds number k of [`BLOCK`] environments. Each begins at a line of the cache: a register that lies across two
/// costs two accesses.
#[derive(Debug, Clone, Default)]
pub struct Columns(Vec<Row>);

#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
struct Row([f32; BLOCK]);

impl Columns {
    /// `n` rows of zeros.
    #[doc(hidden)]
    pub fn zeros(n: usize) -> Self {
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

/// `f64` numbers of a line of the cache.
pub const LINE: usize = 8;

/// Rows of [`LINE`] numbers in `f64`, each a line of the cache: of as many steps, or of as many rows of a Jacobian.
#[derive(Debug, Clone, Default)]
pub struct Lines(Vec<Line>);

#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
struct Line([f64; LINE]);

impl Lines {
    /// `n` rows of zeros.
    #[doc(hidden)]
    pub fn zeros(n: usize) -> Self {
        Self(vec![Line([0.0; LINE]); n])
    }
}

impl Deref for Lines {
    type Target = [[f64; LINE]];
    #[inline(always)]
    fn deref(&self) -> &Self::Target {
        bytemuck::must_cast_slice(&self.0)
    }
}

impl DerefMut for Lines {
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
