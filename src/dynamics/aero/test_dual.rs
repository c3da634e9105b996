//! The smallest dual number, (value, slope): a test of guards must see derivatives go through masked branches.

use autodiff::{Operation, Scalar};
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

/// A value and its derivative along one direction.
#[derive(Debug, Clone, Copy)]
pub struct TestDual(pub f64, pub f64);

impl Add for TestDual {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self(self.0 + o.0, self.1 + o.1)
    }
}
impl Sub for TestDual {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self(self.0 - o.0, self.1 - o.1)
    }
}
impl Mul for TestDual {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self(self.0 * o.0, self.1 * o.0 + self.0 * o.1)
    }
}
impl Div for TestDual {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        Self(self.0 / o.0, (self.1 - self.0 / o.0 * o.1) / o.0)
    }
}
impl Neg for TestDual {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0, -self.1)
    }
}
impl AddAssign for TestDual {
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl SubAssign for TestDual {
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}
impl MulAssign for TestDual {
    fn mul_assign(&mut self, o: Self) {
        *self = *self * o;
    }
}

impl Scalar for TestDual {
    type Mask = bool;
    fn constant(x: f64) -> Self {
        Self(x, 0.0)
    }
    fn sqrt(self) -> Self {
        let r = self.0.sqrt();
        Self(r, self.1 * 0.5 / r)
    }
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = self.0.sin_cos();
        (Self(s, self.1 * c), Self(c, -self.1 * s))
    }
    fn exp(self) -> Self {
        let e = self.0.exp();
        Self(e, self.1 * e)
    }
    fn ln(self) -> Self {
        Self(self.0.ln(), self.1 / self.0)
    }
    fn tanh(self) -> Self {
        let t = self.0.tanh();
        Self(t, self.1 * (1.0 - t * t))
    }
    fn atan2(self, x: Self) -> Self {
        let r2 = self.0 * self.0 + x.0 * x.0;
        Self(self.0.atan2(x.0), (self.1 * x.0 - self.0 * x.1) / r2)
    }
    fn lt(self, o: Self) -> bool {
        self.0 < o.0
    }
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
    fn detach(self) -> Self {
        Self(self.0, 0.0)
    }
    fn call(operation: &Operation, inputs: &[Self], outputs: &mut [Self]) {
        let (x, dx): (Vec<f64>, Vec<f64>) = inputs.iter().map(|x| (x.0, x.1)).unzip();
        let (mut y, mut dy) = (vec![0.0; outputs.len()], vec![0.0; outputs.len()]);
        operation.function().value(&x, &mut y);
        operation.function().forward(&x, &dx, &mut dy);
        for (output, (y, dy)) in outputs.iter_mut().zip(y.into_iter().zip(dy)) {
            *output = Self(y, dy);
        }
    }
}
