//! A curve that is data: a function of time, recorded once.

use super::trajectory::Curve;
use autodiff::{Recording, Scalar, Trace};
use base::error::{Error, Result, finite};
use dynamics::spatial::Vec3;

/// Numbers of a curve: position, yaw, roll, pitch.
const DIM: usize = 6;

/// A curve of one's own as data: a closure, called once with a time that records. Its derivatives up to snap are exact.
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::autodiff::{Scalar, Trace};
/// use omnidrones::controllers::reference::{Reference, WrittenCurve};
/// use omnidrones::error::Error;
///
/// let bounce = WrittenCurve::new(None, |t: Trace| {
///     let height = 2.0 + 0.5 * t.sin_cos().0;
///     Ok::<_, Error>([Trace::zero(), Trace::zero(), height, Trace::zero(), Trace::zero(), Trace::zero()])
/// })?;
/// assert_eq!(Reference::own(bounce).sample(0.0).velocity, [0.0, 0.0, 0.5]);
/// # Ok::<(), Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct WrittenCurve {
    recording: Recording,
    duration: Option<f64>,
}

impl WrittenCurve {
    /// Records `curve`: from the time, s, to position (world, m), yaw, roll and pitch (rad, not wrapped). `duration` says when the motion
    /// is over, s; `None` without an end.
    ///
    /// # Errors
    /// That of `curve`; [`Error::Value`] for numbers that it kept from another recording, and for a duration that is not positive.
    pub fn new<E: From<Error>>(
        duration: Option<f64>,
        curve: impl FnOnce(Trace) -> std::result::Result<[Trace; DIM], E>,
    ) -> std::result::Result<Self, E> {
        if let Some(end) = duration.filter(|end| end.is_nan() || *end <= 0.0) {
            return Err(
                Error::value("duration of a reference", end, "> 0 s", "Leave it out for one without an end.").into()
            );
        }
        let mut failed = None;
        let recording = Recording::as_written(1, |time| match curve(time[0]) {
            Ok(numbers) if numbers.iter().all(|number| number.is_live()) => numbers.to_vec(),
            Ok(_) => {
                let remedy = "Compute it of the time that the function is given.";
                let error = Error::value("a number of a reference", "of another recording", "of this one", remedy);
                failed = Some(error.into());
                Vec::new()
            }
            Err(error) => {
                failed = Some(error);
                Vec::new()
            }
        });
        failed.map_or(Ok(Self { recording, duration }), Err)
    }

    fn at<S: Scalar>(&self, t: S) -> [S; DIM] {
        let mut numbers = [S::zero(); DIM];
        self.recording.evaluate(&[t], &mut numbers);
        numbers
    }
}

impl Curve for WrittenCurve {
    fn description(&self) -> &'static str {
        "a function of time of your own"
    }
    fn position<S: Scalar>(&self, t: S) -> Vec3<S> {
        let [x, y, z, ..] = self.at(t);
        [x, y, z]
    }
    fn yaw<S: Scalar>(&self, t: S) -> S {
        self.at(t)[3]
    }
    fn angles<S: Scalar>(&self, t: S) -> [S; 2] {
        let [.., roll, pitch] = self.at(t);
        [roll, pitch]
    }
    fn duration(&self) -> Option<f64> {
        self.duration
    }
    fn validate(&self) -> Result<()> {
        [0.0, 0.37, 1.0, 10.0].iter().try_for_each(|t| finite(&format!("reference at {t} s"), &self.at(*t)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Circle, Lemniscate, Reference};
    use super::*;

    fn written<C: Curve>(curve: &C) -> Reference {
        Reference::own(
            WrittenCurve::new(curve.duration(), |t| {
                let ([x, y, z], [roll, pitch]) = (curve.position(t), curve.angles(t));
                Ok::<_, Error>([x, y, z, curve.yaw(t), roll, pitch])
            })
            .unwrap(),
        )
    }

    #[test]
    fn a_curve_as_data_has_the_samples_of_the_curve_up_to_snap() {
        let (circle, lemniscate) = (Circle::default(), Lemniscate::default());
        let pairs =
            [(written(&circle), Reference::Circle(circle)), (written(&lemniscate), Reference::Lemniscate(lemniscate))];
        for (own, known) in pairs {
            own.validate().unwrap();
            for t in [-1.0, 0.0, 0.4, 1.9, 7.3] {
                assert_eq!(own.sample(t), known.sample(t), "{} at {t}", known.name());
                assert_eq!(own.yaw(t), known.yaw(t));
            }
            assert_eq!(own.recording().unwrap().n_output(), 18);
        }
    }

    #[test]
    fn a_curve_that_fails_or_is_no_number_is_refused() {
        let failed = WrittenCurve::new(None, |_| Err::<[Trace; DIM], _>(Error::value("it", 1, "2", "")));
        assert!(failed.unwrap_err().to_string().starts_with("it is 1"));
        let endless = WrittenCurve::new(None, |t| Ok::<_, Error>([t.ln(), t, t, t, t, t])).unwrap();
        assert!(endless.validate().unwrap_err().to_string().contains("reference at 0 s"));
        assert!(WrittenCurve::new(Some(0.0), |t| Ok::<_, Error>([t; DIM])).is_err());
    }
}
