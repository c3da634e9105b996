//! Truncated Taylor series as a number: the time derivatives of anything written over [`Scalar`], exactly.

// Kernels are index loops: iterators and slice copies cost lanes their speed.
#![allow(clippy::needless_range_loop, clippy::manual_memcpy)]

use super::custom::Operation;
use super::scalar::Scalar;
use super::unrolled::unrolled;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

/// x(t₀ + h) = Σ cₖ hᵏ, k < N: the k-th derivative is k!·cₖ.
///
/// `Jet<S, 2>` is a dual number, `Jet<f64, 5>` carries position, velocity, acceleration, jerk and snap of a reference.
/// Products and functions follow the usual recurrences for power series (Griewank and Walther, *Evaluating
/// Derivatives*, 2008, chapter 13). Comparisons look at c₀ alone; at a tie, `select` keeps the series of one side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jet<S, const N: usize> {
    /// Taylor coefficients, the value first.
    pub coefficients: [S; N],
}

impl<S: Scalar, const N: usize> Jet<S, N> {
    /// A value that does not change with the variable; N ≥ 1, here and below.
    #[inline(always)]
    pub fn fixed(value: S) -> Self {
        let mut c = [S::zero(); N];
        c[0] = value;
        Self { coefficients: c }
    }

    /// The variable itself, at `value`: slope 1.
    #[inline(always)]
    pub fn variable(value: S) -> Self {
        let mut c = [S::zero(); N];
        c[0] = value;
        if N > 1 {
            c[1] = S::one();
        }
        Self { coefficients: c }
    }

    /// c₀.
    #[inline(always)]
    pub fn value(&self) -> S {
        self.coefficients[0]
    }

    /// The k-th derivative for k = `order`, k!·cₖ; 0 ≤ k < N.
    ///
    /// # Panics
    /// If `order` is N or more.
    #[inline(always)]
    pub fn derivative(&self, order: usize) -> S {
        let mut factorial = 1.0;
        for k in 2..order + 1 {
            factorial *= k as f64;
        }
        if order < 2 { self.coefficients[order] } else { self.coefficients[order] * S::constant(factorial) }
    }

    /// From value and derivatives: cₖ = x⁽ᵏ⁾/k!.
    #[inline(always)]
    pub fn from_derivatives(derivatives: [S; N]) -> Self {
        let mut c = derivatives;
        let mut factorial = 1.0;
        for k in 2..N {
            factorial *= k as f64;
            c[k] = derivatives[k] * S::constant(1.0 / factorial);
        }
        Self { coefficients: c }
    }
}

/// Σᵢ i·aᵢ·b₍ₖ₋ᵢ₎ / k for i = 1 … k: coefficient k of ∫ a′ b.
#[inline(always)]
fn integral<S: Scalar, const N: usize>(a: &[S; N], b: &[S; N], k: usize) -> S {
    let mut sum = a[1] * b[k - 1];
    unrolled!(i in 1..N {
        if 1 < i && i <= k {
            sum = (S::constant(i as f64) * a[i]).mul_add(b[k - i], sum);
        }
    });
    if k == 1 { sum } else { sum * S::constant(1.0 / k as f64) }
}

impl<S: Scalar, const N: usize> Add for Jet<S, N> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl<S: Scalar, const N: usize> Sub for Jet<S, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        self -= other;
        self
    }
}

impl<S: Scalar, const N: usize> Mul for Jet<S, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let (a, b) = (&self.coefficients, &other.coefficients);
        let mut c = [S::zero(); N];
        unrolled!(k in 0..N {
            let mut sum = a[0] * b[k];
            unrolled!(i in 1..N {
                if i <= k {
                    sum = a[i].mul_add(b[k - i], sum);
                }
            });
            c[k] = sum;
        });
        Self { coefficients: c }
    }
}

impl<S: Scalar, const N: usize> Div for Jet<S, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (a, b) = (&self.coefficients, &other.coefficients);
        let mut c = [S::zero(); N];
        c[0] = a[0] / b[0];
        let scale = b[0].recip();
        unrolled!(k in 1..N {
            let mut rest = a[k] - c[0] * b[k];
            unrolled!(i in 1..N {
                if i < k {
                    rest -= c[i] * b[k - i];
                }
            });
            c[k] = rest * scale;
        });
        Self { coefficients: c }
    }
}

impl<S: Scalar, const N: usize> Neg for Jet<S, N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        let mut c = self.coefficients;
        unrolled!(k in 0..N {
            c[k] = -c[k];
        });
        Self { coefficients: c }
    }
}

impl<S: Scalar, const N: usize> AddAssign for Jet<S, N> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        unrolled!(k in 0..N {
            self.coefficients[k] += other.coefficients[k];
        });
    }
}

impl<S: Scalar, const N: usize> SubAssign for Jet<S, N> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        unrolled!(k in 0..N {
            self.coefficients[k] -= other.coefficients[k];
        });
    }
}

impl<S: Scalar, const N: usize> MulAssign for Jet<S, N> {
    #[inline(always)]
    fn mul_assign(&mut self, other: Self) {
        *self = *self * other;
    }
}

impl<S: Scalar, const N: usize> Scalar for Jet<S, N> {
    type Mask = S::Mask;

    #[inline(always)]
    fn constant(x: f64) -> Self {
        Self::fixed(S::constant(x))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let a = &self.coefficients;
        let mut c = [S::zero(); N];
        c[0] = a[0].sqrt();
        let scale = (c[0] + c[0]).recip();
        unrolled!(k in 1..N {
            let mut rest = a[k];
            unrolled!(i in 1..N {
                if i < k {
                    rest -= c[i] * c[k - i];
                }
            });
            c[k] = rest * scale;
        });
        Self { coefficients: c }
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let a = &self.coefficients;
        let (mut s, mut c) = ([S::zero(); N], [S::zero(); N]);
        (s[0], c[0]) = a[0].sin_cos();
        unrolled!(k in 1..N {
            s[k] = integral(a, &c, k);
            c[k] = -integral(a, &s, k);
        });
        (Self { coefficients: s }, Self { coefficients: c })
    }

    #[inline(always)]
    fn exp(self) -> Self {
        let a = &self.coefficients;
        let mut c = [S::zero(); N];
        c[0] = a[0].exp();
        unrolled!(k in 1..N {
            c[k] = integral(a, &c, k);
        });
        Self { coefficients: c }
    }

    #[inline(always)]
    fn ln(self) -> Self {
        let a = &self.coefficients;
        let mut c = [S::zero(); N];
        c[0] = a[0].ln();
        let scale = a[0].recip();
        unrolled!(k in 1..N {
            let mut rest = a[k];
            unrolled!(i in 1..N {
                if i < k {
                    rest -= S::constant(i as f64 / k as f64) * c[i] * a[k - i];
                }
            });
            c[k] = rest * scale;
        });
        Self { coefficients: c }
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        let a = &self.coefficients;
        let (mut c, mut slope) = ([S::zero(); N], [S::zero(); N]);
        c[0] = a[0].tanh();
        slope[0] = S::one() - c[0] * c[0];
        unrolled!(k in 1..N {
            c[k] = integral(a, &slope, k);
            slope[k] -= c[0] * c[k];
            unrolled!(i in 1..N {
                if i <= k {
                    slope[k] -= c[i] * c[k - i];
                }
            });
        });
        Self { coefficients: c }
    }

    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        let (y, x) = (&self.coefficients, &x.coefficients);
        let mut angle = [S::zero(); N];
        angle[0] = y[0].atan2(x[0]);
        // θ′ r² = x y′ − y x′ with r² = x² + y²; `rate` holds the coefficients of θ′.
        let (mut r2, mut rate) = ([S::zero(); N], [S::zero(); N]);
        unrolled!(k in 0..N {
            r2[k] += x[0] * x[k] + y[0] * y[k];
            unrolled!(i in 1..N {
                if i <= k {
                    r2[k] += x[i] * x[k - i] + y[i] * y[k - i];
                }
            });
        });
        let scale = r2[0].recip();
        unrolled!(k in 1..N {
            let mut rest = S::zero();
            unrolled!(i in 1..N {
                if i <= k {
                    rest += S::constant(i as f64) * (x[k - i] * y[i] - y[k - i] * x[i]);
                }
            });
            unrolled!(i in 1..N {
                if i < k {
                    rest -= rate[i - 1] * r2[k - i];
                }
            });
            rate[k - 1] = rest * scale;
            angle[k] = rate[k - 1] * S::constant(1.0 / k as f64);
        });
        Self { coefficients: angle }
    }

    #[inline(always)]
    fn lt(self, other: Self) -> S::Mask {
        self.coefficients[0].lt(other.coefficients[0])
    }

    #[inline(always)]
    fn select(mask: S::Mask, yes: Self, no: Self) -> Self {
        let mut c = no.coefficients;
        unrolled!(k in 0..N {
            c[k] = S::select(mask, yes.coefficients[k], no.coefficients[k]);
        });
        Self { coefficients: c }
    }

    #[inline(always)]
    fn detach(self) -> Self {
        Self::fixed(self.coefficients[0].detach())
    }

    /// c₀ by the value, the others by the tangent. Those above c₁ are NaN where one below them is not zero: they would
    /// need second derivatives.
    fn call(operation: &Operation, inputs: &[Self], outputs: &mut [Self]) {
        let (n, m) = (inputs.len(), outputs.len());
        let (mut x, mut y) = (vec![S::zero(); 2 * n], vec![S::zero(); m]);
        let mut moved = S::zero();
        for k in 0..N {
            let order = if k == 0 { operation } else { operation.tangent() };
            for i in 0..n {
                x[if k == 0 { i } else { n + i }] = inputs[i].coefficients[k];
            }
            S::call(order, &x[..order.n_input()], &mut y);
            let unknown = S::select(S::zero().lt(moved), S::constant(f64::NAN), S::zero());
            for i in 0..m {
                outputs[i].coefficients[k] = y[i] + unknown;
            }
            for i in 0..if k == 0 { 0 } else { n } {
                moved += inputs[i].coefficients[k].abs();
            }
        }
    }

    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        let (x, y) = (&self.coefficients, &a.coefficients);
        let mut c = b.coefficients;
        unrolled!(k in 0..N {
            c[k] = x[0].mul_add(y[k], c[k]);
            unrolled!(i in 1..N {
                if i <= k {
                    c[k] = x[i].mul_add(y[k - i], c[k]);
                }
            });
        });
        Self { coefficients: c }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type J = Jet<f64, 5>;

    /// Every function at once, away from its singular points.
    fn composite<S: Scalar>(t: S) -> S {
        let (s, c) = (t * S::constant(1.3)).sin_cos();
        let a = (s + S::constant(2.0)).sqrt() / (c + S::constant(1.7));
        let b = (t * a).exp().ln() - a.tanh();
        a * b + s.atan2(c - S::constant(2.5)) + t.mul_add(a, b)
    }

    #[test]
    fn each_coefficient_agrees_with_central_differences_of_the_one_below() {
        let h = 1e-5;
        let mut worst = 0.0_f64;
        for t in [-1.1, -0.3, 0.4, 1.9] {
            let at = |t: f64| composite(J::variable(t));
            let (minus, here, plus) = (at(t - h), at(t), at(t + h));
            assert_eq!(here.value(), composite(t), "the value is the plain one, bit for bit");
            for k in 1..5 {
                let difference = (plus.derivative(k - 1) - minus.derivative(k - 1)) / (2.0 * h);
                worst = worst.max((difference - here.derivative(k)).abs() / (1.0 + difference.abs()));
            }
        }
        println!("worst {worst:.1e}");
        // measured: 8.7e-10
        assert!(worst < 1e-7, "{worst:e}");
    }

    #[test]
    fn a_polynomial_has_its_textbook_derivatives() {
        let t = J::variable(2.0);
        let p = t * t * t * t;
        let derivatives: Vec<f64> = (0..5).map(|k| p.derivative(k)).collect();
        assert_eq!(derivatives, [16.0, 32.0, 48.0, 48.0, 24.0]);
        assert_eq!(J::from_derivatives([16.0, 32.0, 48.0, 48.0, 24.0]), p);
    }

    #[test]
    fn a_jet_of_one_coefficient_is_the_plain_number() {
        assert_eq!(composite(Jet::<f64, 1>::variable(0.7)).value(), composite(0.7));
    }
}
