//! Where one frame stands in another.

use base::error::{Error, Result, finite};
use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Pose of an inner frame in an outer one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Placement {
    /// Origin of the inner frame, m, outer axes.
    pub position: [f64; 3],
    /// Unit quaternion `[w, x, y, z]`, inner → outer.
    pub rotation: [f64; 4],
}

impl Default for Placement {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl From<[f64; 3]> for Placement {
    /// Moved to a position, not turned.
    fn from(position: [f64; 3]) -> Self {
        Self { position, ..Self::IDENTITY }
    }
}

impl Placement {
    /// The same frame.
    pub const IDENTITY: Self = Self { position: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] };

    /// The same position, turned by `angle` (rad) about `axis` of the outer frame (any length but zero).
    #[must_use]
    pub fn turned(self, axis: [f64; 3], angle: f64) -> Self {
        let direction = Vector3::from(axis).normalize();
        let turn =
            UnitQuaternion::new_unchecked(Quaternion::from_parts((0.5 * angle).cos(), direction * (0.5 * angle).sin()));
        Self { rotation: wxyz(&(turn * self.isometry().rotation)), ..self }
    }

    /// The frame `inner`, given in this one, in the outer frame.
    #[must_use]
    pub fn then(&self, inner: &Self) -> Self {
        Self::of(&(self.isometry() * inner.isometry()))
    }

    /// The outer frame in the inner one.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self::of(&self.isometry().inverse())
    }

    /// Position times `factor`.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { position: self.position.map(|x| factor * x), ..self }
    }

    /// Checks that all numbers are finite and the quaternion of unit length (to 1e-6); `what` names the frame.
    ///
    /// # Errors
    /// [`Error::Value`].
    pub fn validate(&self, what: &str) -> Result<()> {
        finite(&format!("{what}: position"), &self.position)?;
        finite(&format!("{what}: rotation"), &self.rotation)?;
        let length = self.rotation.iter().map(|x| x * x).sum::<f64>().sqrt();
        if (length - 1.0).abs() <= 1e-6 {
            return Ok(());
        }
        let value = format!("a quaternion of length {length}");
        let remedy = "Divide it by its length; [1, 0, 0, 0] turns nothing.";
        Err(Error::value(format!("{what}: rotation"), value, "a unit quaternion [w, x, y, z]", remedy))
    }

    pub(crate) fn of(pose: &Isometry3<f64>) -> Self {
        Self { position: pose.translation.vector.into(), rotation: wxyz(&pose.rotation) }
    }

    /// For `f64` algebra; the quaternion is normalised.
    pub(crate) fn isometry(&self) -> Isometry3<f64> {
        let [w, x, y, z] = self.rotation;
        let rotation = match self.rotation {
            // normalising would cost these their exactness
            [1.0, 0.0, 0.0, 0.0] => UnitQuaternion::identity(),
            _ => UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)),
        };
        Isometry3::from_parts(Translation3::from(Vector3::from(self.position)), rotation)
    }
}

fn wxyz(q: &UnitQuaternion<f64>) -> [f64; 4] {
    [q.w, q.i, q.j, q.k]
}

/// Entries within rounding of 0 and ±1 made exactly so: kernels leave out what is exactly zero.
pub(crate) fn snap(x: f64) -> f64 {
    let nearest = x.round();
    if (x - nearest).abs() < 4e-16 && nearest.abs() <= 1.0 { nearest + 0.0 } else { x }
}

/// A rotation by rows.
pub(crate) fn rows(rotation: &UnitQuaternion<f64>) -> [[f64; 3]; 3] {
    let m: Matrix3<f64> = rotation.to_rotation_matrix().into_inner();
    std::array::from_fn(|i| std::array::from_fn(|j| snap(m[(i, j)])))
}

/// A vector whose rounding errors next to `scale` are made zero.
pub(crate) fn clean(v: Vector3<f64>, scale: f64) -> [f64; 3] {
    let least = 4e-16 * scale;
    std::array::from_fn(|i| if v[i].abs() <= least { 0.0 } else { v[i] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn a_frame_and_its_inverse_cancel() {
        let a = Placement::from([1.0, -2.0, 0.5]).turned([1.0, 2.0, 3.0], 0.7);
        let both = a.then(&a.inverse());
        for (got, wanted) in both.position.iter().chain(&both.rotation).zip([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) {
            assert!((got - wanted).abs() < 1e-15, "{both:?}");
        }
    }

    #[test]
    fn quarter_turns_give_exact_matrices() {
        for (quarter, wanted) in
            [(1.0, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]), (2.0, [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])]
        {
            let turn = Placement::IDENTITY.turned([0.0, 0.0, 2.0], quarter * FRAC_PI_2);
            assert_eq!(rows(&turn.isometry().rotation)[..2], wanted);
        }
        assert_eq!(rows(&Placement::IDENTITY.turned([0.0, 1.0, 0.0], PI).isometry().rotation)[2], [0.0, 0.0, -1.0]);
    }

    #[test]
    fn a_turn_about_no_axis_is_refused() {
        let error = Placement::IDENTITY.turned([0.0; 3], 1.0).validate("joint 'a'").unwrap_err().to_string();
        assert!(error.starts_with("joint 'a': rotation"), "{error}");
    }
}
