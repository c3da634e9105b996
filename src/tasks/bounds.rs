//! How far a simulation may go: beyond, it has exploded, and the episode ends as `diverged`.
//!
//! Integrators blow up within a few steps of a rate that a step of 16 ms cannot follow, and what comes before the numbers
//! overflow, 1e13 of loss, is as good as a poison. Healthy flights stay far within: our controllers reach 6 m/s, 12 rad/s and
//! 38 rad/s at joints, random ones 17 m/s, 150 and 180 rad/s.

use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::Plant;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// Largest magnitudes of what one environment is made of.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Bounds {
        /// Of a coordinate of a position, m, world. Default 200.
        pub distance: f64 = 200.0,
        /// Of a component of a velocity, m/s, world. Default 50.
        pub speed: f64 = 50.0,
        /// Of a component of an angular velocity and of the rate of a joint, rad/s. Default 300.
        pub rate: f64 = 300.0,
        /// Of the angle of a joint, rad. Default 100.
        pub angle: f64 = 100.0,
        /// Of the training loss of a step, which is cut there; the episode goes on. Default 300.
        pub loss: f64 = 300.0,
    }
}

impl Bounds {
    /// Checks that every bound is positive and finite.
    ///
    /// # Errors
    /// [`Error::Value`] that names the first that is not.
    pub fn validate(&self) -> Result<()> {
        let all = [
            ("distance", self.distance),
            ("speed", self.speed),
            ("rate", self.rate),
            ("angle", self.angle),
            ("loss", self.loss),
        ];
        match all.into_iter().find(|(_, bound)| !(*bound > 0.0 && bound.is_finite())) {
            None => Ok(()),
            Some((name, bound)) => {
                let remedy = "1e8 is as good as none.";
                Err(Error::value(format!("bounds.{name}"), bound, "> 0 and finite", remedy))
            }
        }
    }

    /// When an episode ends as `diverged`, in words.
    pub fn text(&self) -> String {
        let Self { distance, speed, rate, angle, .. } = self;
        format!("beyond ±{distance} m, ±{speed} m/s, ±{rate} rad/s or ±{angle} rad at a joint, or no number")
    }

    /// The rows of a plant's state that are bounded, with their bounds: all but attitudes and rotor speeds, whose lag holds
    /// them below the largest command.
    pub(crate) fn limits(&self, plant: &Plant) -> Vec<(usize, f32)> {
        let rotors: Vec<usize> = plant.rotor_places().iter().map(|r| r.speed).collect();
        let of = |(row, unit): (usize, &str)| match unit {
            _ if rotors.contains(&row) => None,
            "m" => Some((row, self.distance as f32)),
            "m/s" => Some((row, self.speed as f32)),
            "rad/s" => Some((row, self.rate as f32)),
            "rad" => Some((row, self.angle as f32)),
            _ => None,
        };
        plant.state_quantities().iter().map(|q| q.unit).enumerate().filter_map(of).collect()
    }
}
