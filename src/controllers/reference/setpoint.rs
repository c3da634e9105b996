//! One instant of a reference.

use autodiff::Scalar;
use autodiff::jet::Jet;
use dynamics::spatial::{Vec3, constants};

/// Position and yaw with their time derivatives; world frame, SI, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setpoint<S> {
    /// m.
    pub position: Vec3<S>,
    /// m/s.
    pub velocity: Vec3<S>,
    /// m/s².
    pub acceleration: Vec3<S>,
    /// m/s³.
    pub jerk: Vec3<S>,
    /// m/s⁴.
    pub snap: Vec3<S>,
    /// rad.
    pub yaw: S,
    /// rad/s.
    pub yaw_rate: S,
    /// rad/s².
    pub yaw_acceleration: S,
}

impl<S: Scalar> Setpoint<S> {
    /// Numbers in the flat form: position, velocity, acceleration, jerk, snap, yaw, yaw rate, yaw acceleration.
    pub const DIM: usize = 18;

    /// Name and unit of each of them.
    #[doc(hidden)]
    pub const NUMBERS: [(&'static str, &'static str); 18] = [
        ("position_x", "m, world"),
        ("position_y", "m, world"),
        ("position_z", "m, world"),
        ("velocity_x", "m/s, world"),
        ("velocity_y", "m/s, world"),
        ("velocity_z", "m/s, world"),
        ("acceleration_x", "m/s^2, world"),
        ("acceleration_y", "m/s^2, world"),
        ("acceleration_z", "m/s^2, world"),
        ("jerk_x", "m/s^3, world"),
        ("jerk_y", "m/s^3, world"),
        ("jerk_z", "m/s^3, world"),
        ("snap_x", "m/s^4, world"),
        ("snap_y", "m/s^4, world"),
        ("snap_z", "m/s^4, world"),
        ("yaw", "rad"),
        ("yaw_rate", "rad/s"),
        ("yaw_acceleration", "rad/s^2"),
    ];

    /// Rest at a point.
    #[inline]
    pub fn at_rest(position: Vec3<S>, yaw: S) -> Self {
        let (o, zero) = (S::zero(), [S::zero(); 3]);
        let (velocity, acceleration, jerk, snap) = (zero, zero, zero, zero);
        Self { position, velocity, acceleration, jerk, snap, yaw, yaw_rate: o, yaw_acceleration: o }
    }

    /// From Taylor series in time.
    pub fn from_series(position: Vec3<Jet<S, 5>>, yaw: Jet<S, 5>) -> Self {
        let mut d = [[S::zero(); 3]; 5];
        for k in 0..5 {
            for i in 0..3 {
                d[k][i] = position[i].derivative(k);
            }
        }
        let [position, velocity, acceleration, jerk, snap] = d;
        let (yaw, yaw_rate, yaw_acceleration) = (yaw.value(), yaw.derivative(1), yaw.derivative(2));
        Self { position, velocity, acceleration, jerk, snap, yaw, yaw_rate, yaw_acceleration }
    }

    /// The same sample in every lane.
    pub fn constant(sample: &Setpoint<f64>) -> Self {
        Self {
            position: constants(sample.position),
            velocity: constants(sample.velocity),
            acceleration: constants(sample.acceleration),
            jerk: constants(sample.jerk),
            snap: constants(sample.snap),
            yaw: S::constant(sample.yaw),
            yaw_rate: S::constant(sample.yaw_rate),
            yaw_acceleration: S::constant(sample.yaw_acceleration),
        }
    }

    /// Writes the flat form into the first [`Self::DIM`] numbers of `out`.
    ///
    /// # Panics
    /// If `out` is shorter than that.
    pub fn write(&self, out: &mut [S]) {
        for i in 0..3 {
            out[i] = self.position[i];
            out[3 + i] = self.velocity[i];
            out[6 + i] = self.acceleration[i];
            out[9 + i] = self.jerk[i];
            out[12 + i] = self.snap[i];
        }
        out[15] = self.yaw;
        out[16] = self.yaw_rate;
        out[17] = self.yaw_acceleration;
    }

    /// The inverse of [`write`](Self::write).
    ///
    /// # Panics
    /// If `x` is shorter than [`Self::DIM`].
    pub fn read(x: &[S]) -> Self {
        Self {
            position: [x[0], x[1], x[2]],
            velocity: [x[3], x[4], x[5]],
            acceleration: [x[6], x[7], x[8]],
            jerk: [x[9], x[10], x[11]],
            snap: [x[12], x[13], x[14]],
            yaw: x[15],
            yaw_rate: x[16],
            yaw_acceleration: x[17],
        }
    }
}
