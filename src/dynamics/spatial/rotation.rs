//! Unit quaternions `[w, x, y, z]`, Hamilton product, body → world.

use super::vector::{Mat3, Vec3, add, cross, dot, scale};
use autodiff::{Scalar, safe};

/// `[w, x, y, z]`.
pub type Quat<S> = [S; 4];

/// The identity rotation.
#[inline(always)]
pub fn identity<S: Scalar>() -> Quat<S> {
    [S::one(), S::zero(), S::zero(), S::zero()]
}

/// R(q) v: body → world.
#[inline(always)]
pub fn rotate<S: Scalar>(q: Quat<S>, v: Vec3<S>) -> Vec3<S> {
    let u = [q[1], q[2], q[3]];
    let t = cross(u, v);
    let t = add(t, t);
    let r = cross(u, t);
    [q[0].mul_add(t[0], v[0] + r[0]), q[0].mul_add(t[1], v[1] + r[1]), q[0].mul_add(t[2], v[2] + r[2])]
}

/// ‖q‖² R(q) v, for any q. Stages of an integrator leave the unit sphere by the order of the step; there [`rotate`]
/// mixes in (1 − ‖q‖²) v, which does not turn with the body, so that a flight would depend on its heading.
#[inline(always)]
pub fn rotate_scaled<S: Scalar>(q: Quat<S>, v: Vec3<S>) -> Vec3<S> {
    let u = [q[1], q[2], q[3]];
    let n = dot(q, q);
    let t = cross(u, v);
    let t = add(t, t);
    let r = cross(u, t);
    [
        q[0].mul_add(t[0], n.mul_add(v[0], r[0])),
        q[0].mul_add(t[1], n.mul_add(v[1], r[1])),
        q[0].mul_add(t[2], n.mul_add(v[2], r[2])),
    ]
}

/// R(q)ᵀ v: world → body.
#[inline(always)]
pub fn rotate_back<S: Scalar>(q: Quat<S>, v: Vec3<S>) -> Vec3<S> {
    rotate(conjugate(q), v)
}

/// q*, the opposite rotation of a unit quaternion.
#[inline(always)]
pub fn conjugate<S: Scalar>(q: Quat<S>) -> Quat<S> {
    [q[0], -q[1], -q[2], -q[3]]
}

/// a ⊗ b: first b, then a.
#[inline(always)]
pub fn multiply<S: Scalar>(a: Quat<S>, b: Quat<S>) -> Quat<S> {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// q/‖q‖, with the squared norm floored at 1e-12.
#[inline(always)]
pub fn unit<S: Scalar>(q: Quat<S>) -> Quat<S> {
    scale(safe::recip_sqrt(safe::squared_norm(q), 1e-12), q)
}

/// q̇ = ½ q ⊗ (0, ω), ω in the body frame.
#[inline(always)]
pub fn derivative<S: Scalar>(q: Quat<S>, w: Vec3<S>) -> Quat<S> {
    let h = scale(S::constant(0.5), w);
    [
        -(q[1].mul_add(h[0], q[2].mul_add(h[1], q[3] * h[2]))),
        q[0].mul_add(h[0], q[2].mul_add(h[2], -(q[3] * h[1]))),
        q[0].mul_add(h[1], q[3].mul_add(h[0], -(q[1] * h[2]))),
        q[0].mul_add(h[2], q[1].mul_add(h[1], -(q[2] * h[0]))),
    ]
}

/// exp of a rotation vector (axis · angle, rad): smooth through zero.
#[inline(always)]
pub fn exponential<S: Scalar>(v: Vec3<S>) -> Quat<S> {
    let half = scale(S::constant(0.5), v);
    let angle = safe::sqrt(safe::squared_norm(half), 1e-24);
    let s = safe::sinc(angle);
    [angle.sin_cos().1, s * half[0], s * half[1], s * half[2]]
}

/// The rotation matrix of a unit quaternion; its columns are the body axes in the world.
#[inline(always)]
pub fn matrix<S: Scalar>(q: Quat<S>) -> Mat3<S> {
    let [w, x, y, z] = q;
    let (one, two) = (S::one(), S::constant(2.0));
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, xz, yz) = (x * y, x * z, y * z);
    let (wx, wy, wz) = (w * x, w * y, w * z);
    [
        [one - two * (yy + zz), two * (xy - wz), two * (xz + wy)],
        [two * (xy + wz), one - two * (xx + zz), two * (yz - wx)],
        [two * (xz - wy), two * (yz + wx), one - two * (xx + yy)],
    ]
}

/// The third column of the rotation matrix: body z in the world.
#[inline(always)]
pub fn up_axis<S: Scalar>(q: Quat<S>) -> Vec3<S> {
    let [w, x, y, z] = q;
    let two = S::constant(2.0);
    [two * x.mul_add(z, w * y), two * y.mul_add(z, -(w * x)), S::one() - two * x.mul_add(x, y * y)]
}

/// Quaternion of intrinsic z-y-x angles: R = Rz(yaw) Ry(pitch) Rx(roll).
#[inline(always)]
pub fn from_euler<S: Scalar>(roll: S, pitch: S, yaw: S) -> Quat<S> {
    let h = S::constant(0.5);
    let o = S::zero();
    let (sr, cr) = (roll * h).sin_cos();
    let (sp, cp) = (pitch * h).sin_cos();
    let (sy, cy) = (yaw * h).sin_cos();
    multiply([cy, o, o, sy], multiply([cp, o, sp, o], [cr, sr, o, o]))
}

/// The horizontal unit vector at a yaw, (cos ψ, sin ψ, 0).
#[inline(always)]
pub fn yawed<S: Scalar>(yaw: S) -> Vec3<S> {
    let (s, c) = yaw.sin_cos();
    [c, s, S::zero()]
}

/// (roll, pitch, yaw) of R = Rz(yaw) Ry(pitch) Rx(roll); for plots and files, not for control.
#[inline(always)]
pub fn to_euler<S: Scalar>(q: Quat<S>) -> Vec3<S> {
    let r = matrix(q);
    [safe::atan2(r[2][1], r[2][2]), -safe::asin(r[2][0]), safe::atan2(r[1][0], r[0][0])]
}

/// The quaternion of a rotation matrix, w ≥ 0. Branch-free (Shepperd's four cases, the largest pivot selected), with
/// derivatives along rotations.
#[inline(always)]
pub fn from_matrix<S: Scalar>(m: Mat3<S>) -> Quat<S> {
    let one = S::one();
    let (a, b, c) = (m[0][0], m[1][1], m[2][2]);
    let (tw, tx, ty, tz) = (one + a + b + c, one + a - b - c, one - a + b - c, one - a - b + c);
    let (yz, zx, xy) = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]);
    let (sx, sy, sz) = (m[1][0] + m[0][1], m[2][0] + m[0][2], m[2][1] + m[1][2]);
    let mut best = tw;
    let mut q = [tw, yz, zx, xy];
    let rows = [(tx, [yz, tx, sx, sy]), (ty, [zx, sx, ty, sz]), (tz, [xy, sy, sz, tz])];
    for k in 0..3 {
        let (pivot, row) = rows[k];
        let better = best.lt(pivot);
        best = S::select(better, pivot, best);
        for i in 0..4 {
            q[i] = S::select(better, row[i], q[i]);
        }
    }
    let q = unit(q);
    let sign = S::select(q[0].lt(S::zero()), -one, one);
    scale(sign, q)
}
