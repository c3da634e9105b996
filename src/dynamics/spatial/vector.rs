//! Vectors of fixed length as plain arrays.

use autodiff::Scalar;

/// Three components in one frame.
pub type Vec3<S> = [S; 3];
/// A 3×3 matrix by rows.
pub type Mat3<S> = [[S; 3]; 3];

/// Force and moment about one point, along one set of axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wrench<S> {
    pub force: Vec3<S>,
    pub moment: Vec3<S>,
}

impl<S: Scalar> Wrench<S> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { force: [S::zero(); 3], moment: [S::zero(); 3] }
    }
}

/// a + b.
#[inline(always)]
pub fn add<S: Scalar, const N: usize>(a: [S; N], b: [S; N]) -> [S; N] {
    let mut r = a;
    for i in 0..N {
        r[i] += b[i];
    }
    r
}

/// a − b.
#[inline(always)]
pub fn sub<S: Scalar, const N: usize>(a: [S; N], b: [S; N]) -> [S; N] {
    let mut r = a;
    for i in 0..N {
        r[i] -= b[i];
    }
    r
}

/// s · a.
#[inline(always)]
pub fn scale<S: Scalar, const N: usize>(s: S, a: [S; N]) -> [S; N] {
    let mut r = a;
    for i in 0..N {
        r[i] *= s;
    }
    r
}

/// Component by component product.
#[inline(always)]
pub fn hadamard<S: Scalar, const N: usize>(a: [S; N], b: [S; N]) -> [S; N] {
    let mut r = a;
    for i in 0..N {
        r[i] *= b[i];
    }
    r
}

/// −a.
#[inline(always)]
pub fn neg<S: Scalar, const N: usize>(a: [S; N]) -> [S; N] {
    let mut r = a;
    for i in 0..N {
        r[i] = -a[i];
    }
    r
}

/// a + h·b.
#[inline(always)]
pub fn axpy<S: Scalar, const N: usize>(a: [S; N], h: S, b: [S; N]) -> [S; N] {
    let mut r = a;
    for i in 0..N {
        r[i] = h.mul_add(b[i], a[i]);
    }
    r
}

/// a · b.
#[inline(always)]
pub fn dot<S: Scalar, const N: usize>(a: [S; N], b: [S; N]) -> S {
    let mut sum = a[0] * b[0];
    for i in 0..N {
        if i > 0 {
            sum = a[i].mul_add(b[i], sum);
        }
    }
    sum
}

/// a × b.
#[inline(always)]
pub fn cross<S: Scalar>(a: Vec3<S>, b: Vec3<S>) -> Vec3<S> {
    [a[1].mul_add(b[2], -(a[2] * b[1])), a[2].mul_add(b[0], -(a[0] * b[2])), a[0].mul_add(b[1], -(a[1] * b[0]))]
}

/// M v.
#[inline(always)]
pub fn mat_vec<S: Scalar>(m: Mat3<S>, v: Vec3<S>) -> Vec3<S> {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

/// A B.
#[inline(always)]
pub fn mat_mul<S: Scalar>(a: Mat3<S>, b: Mat3<S>) -> Mat3<S> {
    let bt = transpose(b);
    [
        [dot(a[0], bt[0]), dot(a[0], bt[1]), dot(a[0], bt[2])],
        [dot(a[1], bt[0]), dot(a[1], bt[1]), dot(a[1], bt[2])],
        [dot(a[2], bt[0]), dot(a[2], bt[1]), dot(a[2], bt[2])],
    ]
}

/// Mᵀ.
#[inline(always)]
pub fn transpose<S: Scalar>(m: Mat3<S>) -> Mat3<S> {
    [[m[0][0], m[1][0], m[2][0]], [m[0][1], m[1][1], m[2][1]], [m[0][2], m[1][2], m[2][2]]]
}

/// `[v]×`, the matrix with `[v]×` w = v × w.
#[inline(always)]
pub fn skew<S: Scalar>(v: Vec3<S>) -> Mat3<S> {
    let o = S::zero();
    [[o, -v[2], v[1]], [v[2], o, -v[0]], [-v[1], v[0], o]]
}

/// M⁻¹ by the adjugate; M must be regular.
#[inline(always)]
pub fn inverse<S: Scalar>(m: Mat3<S>) -> Mat3<S> {
    let (a, b, c) = (m[0], m[1], m[2]);
    let (bc, ca, ab) = (cross(b, c), cross(c, a), cross(a, b));
    let d = dot(a, bc).recip();
    transpose([scale(d, bc), scale(d, ca), scale(d, ab)])
}

/// The same constants in every lane.
#[inline(always)]
pub fn constants<S: Scalar, const N: usize>(x: [f64; N]) -> [S; N] {
    let mut r = [S::zero(); N];
    for i in 0..N {
        r[i] = S::constant(x[i]);
    }
    r
}
