//! Where to be and when: reference trajectories with exact derivatives.
//!
//! Each shape is a [`Curve`]: it writes its position and yaw once, over [`Scalar`](crate::autodiff::Scalar); evaluated on a fifth-order [`Jet`] in
//! time the same lines give velocity, acceleration, jerk and snap. Before t = 0 every shape here rests at its start. A
//! curve of your own is a reference too ([`Reference::own`]), and so is anything else that gives samples ([`Trajectory`]).

mod carried;
mod circle;
mod ellipse;
mod hover;
mod lemniscate;
mod setpoint;
mod tilt;
mod trajectory;
mod waypoints;

pub use carried::{Carried, LoadPath};
pub use circle::Circle;
pub use ellipse::Ellipse;
pub use hover::{Hover, Step};
pub use lemniscate::{Lemniscate, lemniscate_curve, lemniscate_phase};
pub use setpoint::Setpoint;
pub use tilt::Tilt;
pub use trajectory::{Curve, Own, Series, Trajectory};
pub use waypoints::{MAX_WAYPOINTS, Waypoint, Waypoints};

use crate::autodiff::jet::Jet;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A trajectory: its shape and numbers. In TOML: `kind = "lemniscate"` and the fields of the shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Reference {
    /// Stay at a point.
    Hover(Hover),
    /// Jump from one point to another.
    Step(Step),
    /// A horizontal circle with a smooth start.
    Circle(Circle),
    /// A level or standing ellipse with a smooth start.
    Ellipse(Ellipse),
    /// The lemniscate of the paper's Track tasks.
    Lemniscate(Lemniscate),
    /// Through points, with the least snap.
    Waypoints(Waypoints),
    /// Where a drone must be for its load to follow a path. Not among [`Reference::NAMES`]: it needs a lever.
    Carried(Carried),
    /// Of your own: a value in a program, never in a file.
    #[serde(skip)]
    Own(Own),
}

impl Reference {
    /// The names [`by_name`](Self::by_name) knows.
    pub const NAMES: [&'static str; 6] = ["hover", "step", "circle", "ellipse", "lemniscate", "waypoints"];

    /// A shape with its default numbers.
    pub fn by_name(name: &str) -> Result<Self> {
        match name {
            "hover" => Ok(Self::Hover(Hover::default())),
            "step" => Ok(Self::Step(Step::default())),
            "circle" => Ok(Self::Circle(Circle::default())),
            "ellipse" => Ok(Self::Ellipse(Ellipse::default())),
            "lemniscate" => Ok(Self::Lemniscate(Lemniscate::default())),
            "waypoints" => Ok(Self::Waypoints(Waypoints::default())),
            _ => Err(Error::Unknown {
                kind: "reference",
                name: name.into(),
                known: Self::NAMES.map(String::from).into(),
            }),
        }
    }

    /// The names [`by_name`](Self::by_name) knows.
    pub fn names() -> &'static [&'static str] {
        &Self::NAMES
    }

    /// A trajectory of your own.
    pub fn own(trajectory: impl Trajectory + 'static) -> Self {
        Self::Own(Own(Arc::new(trajectory)))
    }

    fn trajectory(&self) -> &dyn Trajectory {
        match self {
            Self::Hover(r) => r,
            Self::Step(r) => r,
            Self::Circle(r) => r,
            Self::Ellipse(r) => r,
            Self::Lemniscate(r) => r,
            Self::Waypoints(r) => r,
            Self::Carried(r) => r,
            Self::Own(r) => &*r.0,
        }
    }

    /// The name of this shape.
    pub fn name(&self) -> &'static str {
        self.trajectory().name()
    }

    /// One line for a list of shapes.
    pub fn description(&self) -> &'static str {
        self.trajectory().description()
    }

    /// Checks every number. A valid reference gives finite samples at every finite time.
    pub fn validate(&self) -> Result<()> {
        self.trajectory().validate()
    }

    /// Everything the controllers use at time t (s), derivatives exact. Where a derivative jumps (see the shapes) the
    /// value is the right-hand one.
    pub fn sample(&self, t: f64) -> Setpoint<f64> {
        self.trajectory().sample(t)
    }

    /// Position and yaw as Taylor series in time about t (s).
    pub fn series(&self, t: f64) -> Series {
        self.trajectory().series(t)
    }

    /// Yaw as a Taylor series in time about t (s), rad.
    pub fn yaw(&self, t: f64) -> Jet<f64, 3> {
        let [value, rate, change, ..] = self.series(t).1.coefficients;
        Jet { coefficients: [value, rate, change] }
    }

    /// Roll and pitch as Taylor series in time about t (s): zero unless a trajectory of your own asks for more.
    pub fn angles(&self, t: f64) -> [Jet<f64, 3>; 2] {
        self.trajectory().angles(t)
    }

    /// When the motion is over, s; `None` for shapes without an end.
    pub fn duration(&self) -> Option<f64> {
        self.trajectory().duration()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_derivative_agrees_with_central_differences() {
        let h = 1e-4;
        for name in Reference::names() {
            let reference = Reference::by_name(name).unwrap();
            reference.validate().unwrap();
            assert_eq!(reference.name(), *name);
            let mut worst = 0.0_f64;
            for t in [0.3, 0.777, 1.5, 2.9, 5.21, 7.3] {
                let (a, b, c) = (reference.sample(t - h), reference.sample(t), reference.sample(t + h));
                let series = |s: &Setpoint<f64>| [s.position, s.velocity, s.acceleration, s.jerk, s.snap];
                let (a, exact, c) = (series(&a), series(&b), series(&c));
                for k in 0..4 {
                    for i in 0..3 {
                        let difference = (c[k][i] - a[k][i]) / (2.0 * h);
                        worst = worst.max((difference - exact[k + 1][i]).abs() / (1.0 + difference.abs()));
                    }
                }
            }
            println!("worst {name} {worst:.1e}");
            // measured: 1.5e-7 (lemniscate)
            assert!(worst < 1e-6, "{name}: {worst:e}");
        }
    }

    #[test]
    fn before_its_start_every_shape_rests_at_its_start() {
        for name in Reference::names() {
            let reference = Reference::by_name(name).unwrap();
            let s = reference.sample(-0.5);
            assert_eq!(s.position, reference.sample(0.0).position);
            assert_eq!((s.velocity, s.acceleration, s.jerk, s.snap), ([0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]));
        }
    }

    #[test]
    fn a_misspelt_name_is_answered_with_the_nearest() {
        let text = Reference::by_name("lemniscat").unwrap_err().to_string();
        assert!(text.starts_with("no reference is called 'lemniscat' (did you mean 'lemniscate'?)"), "{text}");
    }

    #[test]
    fn references_survive_toml_and_unknown_keys_do_not() {
        for name in Reference::names() {
            let reference = Reference::by_name(name).unwrap();
            let text = toml::to_string(&reference).unwrap();
            assert_eq!(toml::from_str::<Reference>(&text).unwrap(), reference, "{text}");
        }
        let short: Reference = toml::from_str("kind = 'circle'\nradius = 3.0").unwrap();
        assert_eq!(short, Reference::Circle(Circle { radius: 3.0, ..Circle::default() }));
        assert!(toml::from_str::<Reference>("kind = 'circle'\nradios = 3.0").is_err());
    }

    #[test]
    fn bad_numbers_are_named() {
        let bad = Reference::Circle(Circle { radius: f64::NAN, ..Circle::default() });
        assert!(bad.validate().unwrap_err().to_string().starts_with("circle.radius is NaN"));
        let bad = Reference::Lemniscate(Lemniscate { rate: 1e9, ..Lemniscate::default() });
        assert!(bad.validate().unwrap_err().to_string().starts_with("lemniscate.rate is 1000000000"));
    }
}
