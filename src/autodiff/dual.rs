//! num-dual's numbers as [`Scalar`]s: exact first and second derivatives in `f64`.
//!
//! The door to num-dual. `Dual64` carries one direction, `DualSVec64<N>` N directions, `HyperDual64` two directions and
//! their mixed second derivative. Column by column with `Dual64` beats one pass of a wide `DualSVec64` on anything
//! larger than about six directions, because wide duals do not stay in registers.
//!
//! Real parts follow the same operations in the same order as plain `f64`, so values agree bit for bit, with one
//! exception: num-dual divides by multiplying with the reciprocal. Kernels of this crate therefore write
//! `a * b.recip()`, never `a / b`.

use super::scalar::Scalar;
use num_dual::{Dual64, DualNum, DualSVec64, HyperDual64};

macro_rules! scalar_from_num_dual {
    ([$($generics:tt)*] $type:ty) => {
        impl<$($generics)*> Scalar for $type {
            type Mask = bool;
            #[inline(always)]
            fn constant(x: f64) -> Self {
                <$type>::from_re(x)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                DualNum::sqrt(&self)
            }
            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                DualNum::sin_cos(&self)
            }
            #[inline(always)]
            fn exp(self) -> Self {
                DualNum::exp(&self)
            }
            #[inline(always)]
            fn ln(self) -> Self {
                DualNum::ln(&self)
            }
            #[inline(always)]
            fn tanh(self) -> Self {
                DualNum::tanh(&self)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                DualNum::atan2(&self, x)
            }
            #[inline(always)]
            fn recip(self) -> Self {
                DualNum::recip(&self)
            }
            #[inline(always)]
            fn lt(self, other: Self) -> bool {
                self.re < other.re
            }
            #[inline(always)]
            fn select(mask: bool, yes: Self, no: Self) -> Self {
                if mask { yes } else { no }
            }
            #[inline(always)]
            fn detach(self) -> Self {
                <$type>::from_re(self.re)
            }
        }
    };
}

scalar_from_num_dual!([] Dual64);
scalar_from_num_dual!([const N: usize] DualSVec64<N>);
scalar_from_num_dual!([] HyperDual64);
