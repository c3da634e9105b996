//! The shape of a chain: where its position servos go, and when.

use base::error::{Error, Result};
use dynamics::tree::{Model, Motion};
use std::f64::consts::FRAC_PI_2;

/// Fastest turn of a target, rad/s.
const FASTEST: f64 = 0.4;

/// A shape of a chain whose links are joined by position servos.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum ChainShape {
    /// All servos at their centres.
    #[default]
    Straight,
    /// Every hinge about z by the same angle, rad.
    Arc(f64),
    /// Hinges about z by an angle to either side in turn, rad.
    Zigzag(f64),
}

impl ChainShape {
    /// Angle of a bend unless told otherwise, rad.
    const USUAL: f64 = 0.6;

    /// `straight`, `arc`, `zigzag`, the latter two also with an angle in degrees behind a colon: `arc:40`.
    ///
    /// # Errors
    /// [`Error::Unknown`] for another name, [`Error::Value`] for an angle beyond ±90°.
    pub fn parse(text: &str) -> Result<Self> {
        let (name, angle) = text.split_once(':').map_or((text, None), |(name, angle)| (name, Some(angle)));
        let angle = match angle {
            None => Self::USUAL,
            Some(degrees) => degrees.trim().parse::<f64>().map_or(f64::NAN, f64::to_radians),
        };
        if angle.is_nan() || angle.abs() > FRAC_PI_2 {
            return Err(Error::value("shape", text, "an angle within ±90°, as in arc:40", "Leave it out for 34°."));
        }
        match name {
            "straight" => Ok(Self::Straight),
            "arc" => Ok(Self::Arc(angle)),
            "zigzag" => Ok(Self::Zigzag(angle)),
            _ => Err(Error::Unknown {
                kind: "shape",
                name: name.into(),
                known: ["straight", "arc", "zigzag"].map(String::from).into(),
            }),
        }
    }

    /// Of the n-th hinge about z, rad.
    fn angle(self, n: usize) -> f64 {
        match self {
            Self::Straight => 0.0,
            Self::Arc(a) => a,
            Self::Zigzag(a) if n.is_multiple_of(2) => a,
            Self::Zigzag(a) => -a,
        }
    }
}

/// Targets of all position servos of a model over time: from rest to a shape, smoothly and at most at 0.4 rad/s.
#[derive(Debug, Clone, PartialEq)]
pub struct ChainRamp {
    servos: Vec<Servo>,
    /// s.
    from: f64,
    ramp: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Servo {
    /// In the input, in the state.
    drive: usize,
    place: usize,
    center: f64,
    range: f64,
    target: f64,
}

impl ChainRamp {
    /// All servos at their centres.
    pub fn rest(model: &Model) -> Self {
        let servo = |i: usize| {
            let drive = model.bodies()[i].joint.drive.filter(|d| d.stiffness > 0.0)?;
            let (center, range) = (drive.center, drive.range);
            let place = model.layout().bodies[i].position;
            Some(Servo { drive: model.layout().drive[i]?, place, center, range, target: center })
        };
        Self { servos: (0..model.bodies().len()).filter_map(servo).collect(), from: 0.0, ramp: 0.0 }
    }

    /// From rest to `shape`, from the time `from` (s) on.
    ///
    /// # Errors
    /// [`Error::Value`] for a model without position servos about z, or for an angle that a servo does not reach.
    pub fn new(model: &Model, shape: ChainShape, from: f64) -> Result<Self> {
        let mut chain = Self { from, ..Self::rest(model) };
        let about_z = |i: usize| matches!(model.bodies()[i].joint.motion, Motion::Revolute(a) if a[2].abs() > 0.99);
        let mut largest = 0.0_f64;
        let mut n = 0;
        for i in (0..model.bodies().len()).filter(|i| about_z(*i)) {
            let place = model.layout().bodies[i].position;
            let Some(servo) = chain.servos.iter_mut().find(|s| s.place == place) else { continue };
            let angle = shape.angle(n);
            if (angle - servo.center).abs() > servo.range.abs() {
                let what = format!("angle of '{}'", model.bodies()[i].joint.name);
                return Err(Error::value(what, angle, format!("within ±{} rad", servo.range), "Bend it less."));
            }
            servo.target = angle;
            largest = largest.max((angle - servo.center).abs());
            n += 1;
        }
        if n == 0 && shape != ChainShape::Straight {
            let what = format!("model '{}': position servos about z", model.name());
            return Err(Error::value(what, 0, "≥ 1 to take a shape", "The dragon has some."));
        }
        // the steepest slope of the ramp is 15/8 of its mean
        chain.ramp = 1.875 * largest / FASTEST;
        Ok(chain)
    }

    /// When the shape is reached, s.
    pub fn reached(&self) -> f64 {
        self.from + self.ramp
    }

    /// (place in the state, wanted angle in rad) of every servo at a time, s.
    pub fn targets(&self, time: f64) -> impl Iterator<Item = (usize, f64)> {
        let share = self.share(time);
        self.servos.iter().map(move |s| (s.place, s.center + share * (s.target - s.center)))
    }

    fn share(&self, time: f64) -> f64 {
        let x = if self.ramp > 0.0 { ((time - self.from) / self.ramp).clamp(0.0, 1.0) } else { 1.0 };
        x * x * x * (x * (6.0 * x - 15.0) + 10.0)
    }

    /// Writes the servos' commands at a time, s, in [−1, 1], at their places in the plant's input.
    pub fn command(&self, time: f64, input: &mut [f64]) {
        let share = self.share(time);
        for s in &self.servos {
            input[s.drive] = share * (s.target - s.center) / s.range;
        }
    }
}
