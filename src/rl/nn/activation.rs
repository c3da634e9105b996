//! What stands between the layers of a network.

use super::product::PAD;
use autodiff::lanes::{Kernel, Lanes, dispatch};
use serde::{Deserialize, Serialize};

/// A function of one number, applied to each; all have f(0) = 0, so padding stays zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// tanh x: smooth, for gradients through physics.
    #[default]
    Tanh,
    /// x above zero, eˣ − 1 below (Clevert, Unterthiner and Hochreiter 2016).
    Elu,
    /// max(x, 0).
    Relu,
    /// x above zero, 0.01 x below (Maas, Hannun and Ng 2013).
    LeakyRelu,
    /// x.
    Identity,
}

impl Activation {
    /// f of every number, in place; a multiple of [`PAD`] of them.
    pub(crate) fn apply(self, x: &mut [f32]) {
        debug_assert!(x.len().is_multiple_of(PAD));
        if self != Self::Identity {
            dispatch(Apply { kind: self, x });
        }
    }

    /// d ← d · f′, told from y = f(x).
    pub(crate) fn pull(self, y: &[f32], d: &mut [f32]) {
        debug_assert!(y.len() == d.len() && d.len().is_multiple_of(PAD));
        if self != Self::Identity {
            dispatch(Pull { kind: self, y, d });
        }
    }
}

struct Apply<'a> {
    kind: Activation,
    x: &'a mut [f32],
}

impl Kernel for Apply<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        for x in self.x.chunks_exact_mut(L::WIDTH) {
            let value = L::load(x);
            let zero = L::zero();
            let result = match self.kind {
                Activation::Tanh => tanh(value),
                Activation::Elu => value.max(zero) + (value.min(zero).exp() - L::one()),
                Activation::Relu => value.max(zero),
                Activation::LeakyRelu => value.max(zero) + L::constant(LEAK) * value.min(zero),
                Activation::Identity => value,
            };
            result.store(x);
        }
    }
}

struct Pull<'a> {
    kind: Activation,
    y: &'a [f32],
    d: &'a mut [f32],
}

impl Kernel for Pull<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let w = L::WIDTH;
        for (d, y) in self.d.chunks_exact_mut(w).zip(self.y.chunks_exact(w)) {
            let (grad_output, y, zero, one) = (L::load(d), L::load(y), L::zero(), L::one());
            let slope = match self.kind {
                Activation::Tanh => (-y).mul_add(y, one),
                Activation::Elu => one + y.min(zero),
                Activation::Relu => L::select(zero.lt(y), one, zero),
                Activation::LeakyRelu => L::select(y.lt(zero), L::constant(LEAK), one),
                Activation::Identity => one,
            };
            (grad_output * slope).store(d);
        }
    }
}

pub(super) const LEAK: f64 = 0.01;

/// x p(x²)/q(x²) with degrees 13 and 6, for |x| ≤ 7.9 where tanh rounds to ±1: one division, half the cost of the
/// function by exponentials. Coefficients of the minimax fraction in Eigen (Guennebaud, Jacob et al. 2010).
#[inline(always)]
pub(super) fn tanh<L: Lanes>(x: L) -> L {
    let c = L::constant;
    let x = x.clamp(c(-LARGEST), c(LARGEST));
    let z = x * x;
    let mut p = c(NUMERATOR[0]);
    for i in 1..NUMERATOR.len() {
        p = p.mul_add(z, c(NUMERATOR[i]));
    }
    let mut q = c(DENOMINATOR[0]);
    for i in 1..DENOMINATOR.len() {
        q = q.mul_add(z, c(DENOMINATOR[i]));
    }
    x * p / q
}

const LARGEST: f64 = 7.905_311_107_635_498;
const NUMERATOR: [f64; 7] = [
    -2.760_768_477_423_55e-16,
    2.000_187_904_824_77e-13,
    -8.604_671_522_137_35e-11,
    5.122_297_090_371_14e-8,
    1.485_722_357_179_79e-5,
    6.372_619_288_754_36e-4,
    4.893_524_558_917_86e-3,
];
const DENOMINATOR: [f64; 4] =
    [1.198_258_394_667_02e-6, 1.185_347_056_866_54e-4, 2.268_434_632_439e-3, 4.893_525_185_543_85e-3];

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Activation; 5] =
        [Activation::Tanh, Activation::Elu, Activation::Relu, Activation::LeakyRelu, Activation::Identity];

    fn exact(kind: Activation, x: f64) -> f64 {
        match kind {
            Activation::Tanh => x.tanh(),
            Activation::Elu => {
                if x > 0.0 {
                    x
                } else {
                    x.exp_m1()
                }
            }
            Activation::Relu => x.max(0.0),
            Activation::LeakyRelu => {
                if x > 0.0 {
                    x
                } else {
                    0.01 * x
                }
            }
            Activation::Identity => x,
        }
    }

    fn grid() -> Vec<f32> {
        (0..16_000).map(|i| (i as f32 - 8_000.3) * 0.00125).collect()
    }

    #[test]
    fn values_are_those_of_the_library_to_rounding() {
        for kind in ALL {
            let mut y = grid();
            kind.apply(&mut y);
            let error =
                |(x, y): (f32, &f32)| (f64::from(*y) - exact(kind, f64::from(x))).abs() / f64::from(x).abs().max(1.0);
            let worst = grid().into_iter().zip(&y).map(error).fold(0.0, f64::max);
            println!("{kind:?} {worst:.1e}");
            assert!(worst < 5e-7, "{kind:?}: {worst:e}"); // measured: tanh 3.6e-7, elu 9.0e-8, leaky 3e-8, others 0
        }
    }

    #[test]
    fn slopes_are_central_differences() {
        for kind in ALL {
            let mut y = grid();
            kind.apply(&mut y);
            let mut d = vec![1.0; y.len()];
            kind.pull(&y, &mut d);
            for (x, d) in grid().into_iter().map(f64::from).zip(&d) {
                let slope = (exact(kind, x + 1e-6) - exact(kind, x - 1e-6)) / 2e-6;
                assert!((f64::from(*d) - slope).abs() < 2e-6, "{kind:?} at {x}: {d} against {slope}"); // measured 8e-7
            }
        }
    }
}
