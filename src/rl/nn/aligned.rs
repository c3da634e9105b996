//! Numbers of networks in memory where registers do not straddle lines of the cache.

use super::product::PAD;
use bytemuck::{Pod, Zeroable};
use std::ops::{Deref, DerefMut};

/// Whole rows of [`PAD`] numbers, the first at a line of the cache: a register that lies across two costs two accesses, and
/// products of matrices a tenth of their speed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Aligned(Vec<Line>);

#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
struct Line([f32; PAD]);

impl Aligned {
    /// At least `n` zeros.
    #[doc(hidden)]
    pub fn zeros(n: usize) -> Self {
        Self(vec![Line([0.0; PAD]); n.div_ceil(PAD)])
    }
}

impl Deref for Aligned {
    type Target = [f32];
    #[inline(always)]
    fn deref(&self) -> &Self::Target {
        bytemuck::must_cast_slice(&self.0)
    }
}

impl DerefMut for Aligned {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut Self::Target {
        bytemuck::must_cast_slice_mut(&mut self.0)
    }
}
