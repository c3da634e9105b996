//! Attitude level: attitude command → rate command.

use super::parameters::GainSet;
use super::rate::RateCommand;
use autodiff::jet::Jet;
use autodiff::{Scalar, safe};
use dynamics::spatial::{Mat3, Quat, Vec3, cross, dot, from_euler, mat_mul, mat_vec, matrix, scale, sub, transpose};

/// Floor under rate gains the attitude level divides by, N m s/rad.
const GAIN_FLOOR: f64 = 1e-12;

/// What the attitude level is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeCommand<S> {
    /// Total thrust along body z, N.
    pub thrust: S,
    /// R_d, desired body → world.
    pub attitude: Mat3<S>,
    /// ω_d of the desired frame, in its own axes, rad/s.
    pub angular_velocity: Vec3<S>,
    /// ω̇_d of the desired frame, in its own axes, rad/s².
    pub angular_acceleration: Vec3<S>,
}

/// A desired frame and how it turns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orientation<S> {
    /// R_d, desired body → world.
    pub attitude: Mat3<S>,
    /// ω_d, in its own axes, rad/s.
    pub angular_velocity: Vec3<S>,
    /// ω̇_d, in its own axes, rad/s².
    pub angular_acceleration: Vec3<S>,
}

impl<S: Scalar> Orientation<S> {
    /// Constant.
    #[inline]
    pub fn at_rest(attitude: Mat3<S>) -> Self {
        Self { attitude, angular_velocity: [S::zero(); 3], angular_acceleration: [S::zero(); 3] }
    }

    /// From R_d(t) as a series in time: `R_dᵀṘ_d = [ω_d]×` gives ω_d = (b₃·ḃ₂, b₁·ḃ₃, b₂·ḃ₁) of its columns, and ω̇_d by the
    /// product rule.
    pub fn of_series(r: Mat3<Jet<S, 3>>) -> Self {
        // Columns b₁, b₂, b₃ with their first and second derivatives: d[k][j] is b_j⁽ᵏ⁾.
        let mut d = [[[S::zero(); 3]; 3]; 3];
        let mut attitude = [[S::zero(); 3]; 3];
        for row in 0..3 {
            for column in 0..3 {
                let entry = r[row][column];
                attitude[row][column] = entry.value();
                for k in 0..3 {
                    d[k][column][row] = entry.derivative(k);
                }
            }
        }
        let angular_velocity = [dot(d[0][2], d[1][1]), dot(d[0][0], d[1][2]), dot(d[0][1], d[1][0])];
        let angular_acceleration = [
            dot(d[0][2], d[2][1]) + dot(d[1][2], d[1][1]),
            dot(d[0][0], d[2][2]) + dot(d[1][0], d[1][2]),
            dot(d[0][1], d[2][0]) + dot(d[1][1], d[1][0]),
        ];
        Self { attitude, angular_velocity, angular_acceleration }
    }

    /// With a total thrust along body z, N.
    #[inline]
    pub fn with_thrust(self, thrust: S) -> AttitudeCommand<S> {
        let Self { attitude, angular_velocity, angular_acceleration } = self;
        AttitudeCommand { thrust, attitude, angular_velocity, angular_acceleration }
    }
}

impl<S: Scalar> AttitudeCommand<S> {
    /// Numbers in the flat form: thrust, R_d by rows, ω_d, ω̇_d.
    pub const DIM: usize = 16;

    /// Level, at rest, with the given thrust.
    #[inline]
    pub fn level(thrust: S) -> Self {
        let (o, i, zero) = (S::zero(), S::one(), [S::zero(); 3]);
        Self { thrust, attitude: [[i, o, o], [o, i, o], [o, o, i]], angular_velocity: zero, angular_acceleration: zero }
    }

    /// The paper's attitude mode: thrust, heading rate ψ̇, roll and pitch. The heading is the vehicle's own, so it
    /// drifts at ψ̇ without a yaw error: R_d = Rz(ψ) Ry(pitch) Rx(roll), ω_d = R_dᵀ (0, 0, ψ̇).
    ///
    /// The paper composes Rz Rx Ry and drops the yaw component of e_R; in that order the heading of R_d is not ψ when
    /// both tilts are set, and keeping the component would make it yaw. At one tilt at a time the two are the same.
    #[inline]
    pub fn from_tilt(thrust: S, yaw_rate: S, roll: S, pitch: S, attitude: Quat<S>) -> Self {
        let r = matrix(attitude);
        let heading = safe::atan2(r[1][0], r[0][0]);
        let desired = matrix(from_euler(roll, pitch, heading));
        let turn = [desired[2][0] * yaw_rate, desired[2][1] * yaw_rate, desired[2][2] * yaw_rate];
        Self { thrust, attitude: desired, angular_velocity: turn, angular_acceleration: [S::zero(); 3] }
    }

    /// Writes the flat form into the first [`Self::DIM`] numbers of `out`.
    ///
    /// # Panics
    /// If `out` is shorter than that.
    pub fn write(&self, out: &mut [S]) {
        out[0] = self.thrust;
        for i in 0..3 {
            for j in 0..3 {
                out[1 + 3 * i + j] = self.attitude[i][j];
            }
            out[10 + i] = self.angular_velocity[i];
            out[13 + i] = self.angular_acceleration[i];
        }
    }

    /// The inverse of [`write`](Self::write).
    ///
    /// # Panics
    /// If `x` is shorter than [`Self::DIM`].
    pub fn read(x: &[S]) -> Self {
        Self {
            thrust: x[0],
            attitude: [[x[1], x[2], x[3]], [x[4], x[5], x[6]], [x[7], x[8], x[9]]],
            angular_velocity: [x[10], x[11], x[12]],
            angular_acceleration: [x[13], x[14], x[15]],
        }
    }
}

/// e_R = ½(R_dᵀR − RᵀR_d)^∨ of E = R_dᵀR, body, up to an angle of 90°: sin(angle) · axis. Beyond, where the sine falls again and
/// would let a vehicle hang upside down, the axis itself; at half a turn, where both senses are as good, one of them.
///
/// Continuous with its first derivatives, and finite with all of them, but for the choice of the sense at half a turn.
///
/// Source: Lee, Leok and McClamroch 2010, eq. 10, within 90°; the axis of a rotation: E + Eᵀ = 2 cos θ I + 2 (1 − cos θ) a aᵀ.
pub fn attitude_error<S: Scalar>(desired: Mat3<S>, actual: Mat3<S>) -> Vec3<S> {
    let e = mat_mul(transpose(desired), actual);
    let half = S::constant(0.5);
    let sine = [half * (e[2][1] - e[1][2]), half * (e[0][2] - e[2][0]), half * (e[1][0] - e[0][1])];
    let cosine = half * (e[0][0] + e[1][1] + e[2][2] - S::one());
    let far = cosine.lt(S::zero());
    let axis = turn_axis(&e, cosine, sine);
    let mut error = sine;
    for i in 0..3 {
        error[i] = S::select(far, axis[i], sine[i]);
    }
    error
}

/// The axis of a rotation beyond 90°: the largest column of (1 − cos θ) a aᵀ, in the sense of sin θ a.
fn turn_axis<S: Scalar>(e: &Mat3<S>, cosine: S, sine: Vec3<S>) -> Vec3<S> {
    let half = S::constant(0.5);
    let (xy, xz, yz) = (half * (e[0][1] + e[1][0]), half * (e[0][2] + e[2][0]), half * (e[1][2] + e[2][1]));
    let square = [e[0][0] - cosine, e[1][1] - cosine, e[2][2] - cosine];
    let (x_below_y, x_below_z) = (square[0].lt(square[1]), square[0].lt(square[2]));
    let y_below_z = square[1].lt(square[2]);
    let columns = [[square[0], xy, xz], [xy, square[1], yz], [xz, yz, square[2]]];
    let mut column = columns[0];
    for i in 0..3 {
        let of_y_or_z = S::select(y_below_z, columns[2][i], columns[1][i]);
        column[i] = S::select(x_below_y, of_y_or_z, S::select(x_below_z, columns[2][i], columns[0][i]));
    }
    let sense = S::select(dot(column, sine).lt(S::zero()), -S::one(), S::one());
    scale(sense, safe::normalise(column))
}

/// ω_cmd = RᵀR_d ω_d − (K_R/K_ω) e_R, α_ff = RᵀR_d ω̇_d − ω × RᵀR_d ω_d; body frame.
///
/// Source: the terms of Lee, Leok and McClamroch 2010, eq. 20, with K_ω drawn out for the rate level.
pub fn rate_command<S: Scalar>(
    gains: &GainSet<S>,
    command: &AttitudeCommand<S>,
    attitude: Quat<S>,
    angular_velocity: Vec3<S>,
) -> RateCommand<S> {
    let r = matrix(attitude);
    let error = attitude_error(command.attitude, r);
    let to_body = mat_mul(transpose(r), command.attitude);
    let turn = mat_vec(to_body, command.angular_velocity);
    let mut rate = turn;
    for i in 0..3 {
        rate[i] -= safe::div(gains.attitude[i], gains.rate[i], GAIN_FLOOR) * error[i];
    }
    let acceleration = sub(mat_vec(to_body, command.angular_acceleration), cross(angular_velocity, turn));
    RateCommand { thrust: command.thrust, angular_velocity: rate, angular_acceleration: acceleration }
}
