//! Shapes that rewards are made of.

use autodiff::{Scalar, safe};
use dynamics::spatial::Vec3;

/// 1/(1 + (a‖v‖)²) of a squared norm: smooth, also at zero.
pub fn rational_kernel<S: Scalar>(a: f64, squared: S) -> S {
    S::constant(a * a).mul_add(squared, S::one()).recip()
}

/// e^{−a‖v‖}: a tip at zero.
pub fn exponential_kernel<S: Scalar, const N: usize>(a: f64, v: [S; N]) -> S {
    exponential_kernel_of(a, safe::squared_norm(v))
}

/// Of ‖v‖².
#[doc(hidden)]
pub fn exponential_kernel_of<S: Scalar>(a: f64, squared: S) -> S {
    (S::constant(-a) * safe::sqrt(squared, safe::SQUARED_NORM_FLOOR)).exp()
}

/// ((u_z + 1)/2)².
pub fn upright<S: Scalar>(up: Vec3<S>) -> S {
    (S::constant(0.5) * (up[2] + S::one())).square()
}

/// 1/(1 + ω_z²), world. DIFFERENCE: the published code squares twice, ω_z⁴ (defect 14).
pub fn still<S: Scalar>(angular_velocity: Vec3<S>) -> S {
    rational_kernel(1.0, angular_velocity[2].square())
}

/// √(‖v‖² + δ²): a norm without a tip, for training losses.
pub fn smooth_norm<S: Scalar, const N: usize>(v: [S; N], delta: f64) -> S {
    smooth_norm_of(safe::squared_norm(v), delta)
}

/// Of ‖v‖².
#[doc(hidden)]
pub fn smooth_norm_of<S: Scalar>(squared: S, delta: f64) -> S {
    (squared + S::constant(delta * delta)).sqrt()
}

/// h_c(x) = 2‖x‖²/(1 + √(1 + ‖x‖²/c²)) = 2c² (√(1 + ‖x‖²/c²) − 1): ‖x‖² near 0, 2c‖x‖ far away, so that what tumbles does not
/// outweigh all else in a training loss (pseudo-Huber; Charbonnier et al. 1997).
pub fn pseudo_huber<S: Scalar, const N: usize>(x: [S; N], c: f64) -> S {
    pseudo_huber_of(safe::squared_norm(x), c)
}

/// Of ‖x‖².
#[doc(hidden)]
pub fn pseudo_huber_of<S: Scalar>(squared: S, c: f64) -> S {
    let root = S::constant(1.0 / (c * c)).mul_add(squared, S::one()).sqrt();
    S::constant(2.0) * squared / (S::one() + root)
}

/// Two vectors behind each other, for norms over both.
pub fn both<S: Scalar>(a: Vec3<S>, b: Vec3<S>) -> [S; 6] {
    [a[0], a[1], a[2], b[0], b[1], b[2]]
}
