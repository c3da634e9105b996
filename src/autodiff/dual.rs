//! num-dual's numbers as [`Scalar`]s: exact first and second derivatives in `f64`.
//!
//! The door to num-dual. `Dual64` carries one direction, `DualSVec64<N>` N directions, `HyperDual64` two directions and
//! their mixed second derivative. Column by column with `Dual64` beats one pass of a wide `DualSVec64` on anything
//! larger than about six directions, because wide duals do not stay in registers.
//!
//! Real parts follow the same operations in the same order as plain `f64`, so values agree bit for bit, with one
//! exception: num-dual divides by multiplying with the reciprocal. Kernels therefore write
//! `a * b.recip()`, never `a / b`.

use super::custom::{Operation, Scratch, forward, unknown};
use super::scalar::Scalar;
use nalgebra::SVector;
use num_dual::{Dual64, DualNum, DualSVec64, HyperDual64};

macro_rules! scalar_from_num_dual {
    ([$($generics:tt)*] $type:ty $(, $once:ident)?) => {
        impl<$($generics)*> Scalar for $type {
            type Mask = bool;
            $(super::compiled_once::compiled_once!($once);)?
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
            fn call(operation: &Operation, inputs: &[Self], outputs: &mut [Self]) {
                call(operation, inputs, outputs);
            }
        }
    };
}

scalar_from_num_dual!([] Dual64, Dual);
scalar_from_num_dual!([const N: usize] DualSVec64<N>);
scalar_from_num_dual!([] HyperDual64);

/// A dual number as its value and its parts: first derivatives, then what moves with them.
trait Parts: Scalar {
    const N: usize;
    fn value(&self) -> f64;
    fn part(&self, k: usize) -> f64;
    fn set_part(&mut self, k: usize, part: f64);
    /// What second derivatives add to the parts of results, which are J times the inputs' parts so far.
    fn add_second(_inputs: &[Self], _outputs: &mut [Self]) {}
}

/// f of the values and J of each part.
fn call<D: Parts>(operation: &Operation, inputs: &[D], outputs: &mut [D]) {
    let (n, m) = (inputs.len(), outputs.len());
    let mut scratch = Scratch::<f64, 256>::new();
    let (x, rest) = scratch.of(2 * n + m).split_at_mut(n);
    let (dx, y) = rest.split_at_mut(n);
    for i in 0..n {
        x[i] = inputs[i].value();
    }
    operation.function().value(x, y);
    for i in 0..m {
        outputs[i] = D::constant(y[i]);
    }
    for k in 0..D::N {
        for i in 0..n {
            dx[i] = inputs[i].part(k);
        }
        forward(operation.function(), x, dx, y);
        for i in 0..m {
            outputs[i].set_part(k, y[i]);
        }
    }
    D::add_second(inputs, outputs);
}

impl Parts for Dual64 {
    const N: usize = 1;
    fn value(&self) -> f64 {
        self.re
    }
    fn part(&self, _: usize) -> f64 {
        self.eps
    }
    fn set_part(&mut self, _: usize, part: f64) {
        self.eps = part;
    }
}

impl<const N: usize> Parts for DualSVec64<N> {
    const N: usize = N;
    fn value(&self) -> f64 {
        self.re
    }
    fn part(&self, k: usize) -> f64 {
        self.eps.0.map_or(0.0, |eps| eps[k])
    }
    fn set_part(&mut self, k: usize, part: f64) {
        self.eps.0.get_or_insert_with(SVector::zeros)[k] = part;
    }
}

impl Parts for HyperDual64 {
    const N: usize = 3;
    fn value(&self) -> f64 {
        self.re
    }
    fn part(&self, k: usize) -> f64 {
        [self.eps1, self.eps2, self.eps1eps2][k]
    }
    fn set_part(&mut self, k: usize, part: f64) {
        *[&mut self.eps1, &mut self.eps2, &mut self.eps1eps2][k] = part;
    }
    fn add_second(inputs: &[Self], outputs: &mut [Self]) {
        let direction = |k: usize| inputs.iter().map(|x| x.part(k)).collect::<Vec<_>>();
        let bend = unknown(&direction(0), &direction(1));
        outputs.iter_mut().for_each(|y| y.eps1eps2 += bend);
    }
}
