use crate::autodiff::Scalar;
#[inline(always)]
pub fn factor<S: Scalar>(height: S, radius: S) -> S {
    let q = radius * (S::constant(4.0) * height.max(radius * S::constant(0.5)).max(S::constant(1e-6))).recip();
    (S::one() - q * q).recip()
}
