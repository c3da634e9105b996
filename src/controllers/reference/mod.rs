//! Where to be and when: reference trajectories with exact derivatives.
//!
//! Each shape is a [`Curve`]: it writes its position and yaw once, over [`Scalar`](autodiff::Scalar); evaluated on a fifth-order [`Jet`] in
//! time the same lines give velocity, acceleration, jerk and snap. Before t = 0 every shape here rests at its start. A
//! curve of your own is a reference too ([`Reference::own`]), as code or as data ([`WrittenCurve`]), and so is anything else that gives
//! samples ([`Trajectory`]).

mod carried;
mod circle;
mod ellipse;
mod hover;
mod lemniscate;
mod pointed;
mod sampled;
mod setpoint;
mod tilt;
mod trajectory;
mod waypoints;
mod written;

pub use carried::{Carried, LoadPath};
pub use circle::Circle;
pub use ellipse::Ellipse;
pub use hover::{Hover, Step};
pub use lemniscate::{Lemniscate, lemniscate_curve, lemniscate_phase};
pub use pointed::Pointed;
pub use sampled::{MAX_SAMPLES, Sampled};
pub use setpoint::Setpoint;
pub use tilt::Tilt;
pub use trajectory::{Curve, CustomTrajectory, Series, Trajectory};
pub use waypoints::{MAX_WAYPOINTS, Waypoint, Waypoints};
pub use written::WrittenCurve;

use autodiff::Recording;
use autodiff::jet::Jet;
use base::error::{Error, Result};
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
    /// Through samples of a path, with the least jerk. Not among [`Reference::NAMES`]: it needs samples.
    Sampled(Sampled),
    /// Where a drone must be for its load to follow a path. Not among [`Reference::NAMES`]: it needs a lever.
    Carried(Carried),
    /// Along a lemniscate with an axis that points at a place. Not among [`Reference::NAMES`]: it needs a place.
    Pointed(Pointed),
    /// Of your own: a value in a program, never in a file.
    #[serde(skip)]
    Own(CustomTrajectory),
}

impl Reference {
    /// The names [`by_name`](Self::by_name) knows.
    pub const NAMES: [&'static str; 6] = ["hover", "step", "circle", "ellipse", "lemniscate", "waypoints"];

    /// A shape with its default numbers.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the names there are.
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
        Self::Own(CustomTrajectory(Arc::new(trajectory)))
    }

    fn trajectory(&self) -> &dyn Trajectory {
        match self {
            Self::Hover(r) => r,
            Self::Step(r) => r,
            Self::Circle(r) => r,
            Self::Ellipse(r) => r,
            Self::Lemniscate(r) => r,
            Self::Waypoints(r) => r,
            Self::Sampled(r) => r,
            Self::Carried(r) => r,
            Self::Pointed(r) => r,
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
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] that names the number.
    pub fn validate(&self) -> Result<()> {
        self.trajectory().validate()
    }

    /// Everything the controllers use at time t (s), derivatives exact. Where a derivative jumps (see the shapes) the
    /// value is the right-hand one.
    pub fn sample(&self, t: f64) -> Setpoint<f64> {
        self.trajectory().sample(t)
    }

    /// From the time, s, to the numbers of a [`Setpoint`]; `None` where samples are looked up.
    #[doc(hidden)]
    pub fn recording(&self) -> Option<Recording> {
        self.trajectory().recording()
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

    /// Roll and pitch, rad, as Taylor series in time about t (s): zero unless [`Pointed`] or a trajectory of your own
    /// asks for more.
    pub fn angles(&self, t: f64) -> [Jet<f64, 3>; 2] {
        self.trajectory().angles(t)
    }

    /// When the motion is over, s; `None` for shapes without an end.
    pub fn duration(&self) -> Option<f64> {
        self.trajectory().duration()
    }
}
