//! Gates along a winding way.

use super::draw::{count, range, stream};
use crate::scene::{Gate, Scene};
use crate::shape::within;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// A course of gates, to be flown in order along each gate's local x.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Course {
    /// Another seed, another course.
    pub seed: u64,
    /// How many.
    pub gates: usize,
    /// Least and largest way from one gate's centre to the next, m; the first is as far from the origin.
    pub spacing: [f64; 2],
    /// Lowest and highest centre of an opening, m.
    pub height: [f64; 2],
    /// Largest change of height from one gate to the next, m.
    pub climb: f64,
    /// Largest change of direction from one gate to the next, degrees.
    pub bend: f64,
    /// Of the gates: a factor on the lengths of the default [`Gate`].
    pub scale: f64,
}

impl Default for Course {
    /// Ten gates 3 to 5 m apart at 1.2 to 2.5 m, bends of up to 50°.
    fn default() -> Self {
        Self { seed: 0, gates: 10, spacing: [3.0, 5.0], height: [1.2, 2.5], climb: 0.6, bend: 50.0, scale: 1.1 }
    }
}

/// Largest angle between the way and the x axis, degrees: it never comes back to itself.
const WIDEST: f64 = 60.0;

impl Course {
    /// The course of its seed: gates named `gate 0` and so on. A gate stands across the middle of the directions to it and on.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn scene(&self) -> Result<Scene> {
        self.validate()?;
        let mut stream = stream(self.seed);
        let (bend, widest) = (self.bend.to_radians(), WIDEST.to_radians());
        let mut at = [0.0, 0.0, stream.uniform(self.height[0], self.height[1])];
        let mut heading = 0.0_f64;
        let mut gates = Vec::with_capacity(self.gates);
        for i in 0..self.gates {
            let way = stream.uniform(self.spacing[0], self.spacing[1]);
            let climb = if i == 0 { 0.0 } else { self.climb };
            let z = stream.uniform((at[2] - climb).max(self.height[0]), (at[2] + climb).min(self.height[1]));
            let rise = z - at[2];
            let level = (way * way - rise * rise).sqrt();
            at = [at[0] + level * heading.cos(), at[1] + level * heading.sin(), z];
            let next = stream.uniform((heading - bend).max(-widest), (heading + bend).min(widest));
            let (s, c) = (0.25 * (heading + next)).sin_cos();
            let gate = Gate { name: format!("gate {i}"), position: at, rotation: [c, 0.0, 0.0, s], ..Gate::default() };
            gates.push(Gate { scale: self.scale, ..gate });
            heading = next;
        }
        Ok(Scene { gates, ..Scene::grounded() })
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] for a size out of range, and for gates that touch the ground or each other.
    pub fn validate(&self) -> Result<()> {
        count("gates: gates", self.gates)?;
        range("gates: spacing", self.spacing, 0.1, 1000.0)?;
        range("gates: height", self.height, 0.0, 1000.0)?;
        within("gates: climb", self.climb, 0.0, 1000.0)?;
        within("gates: bend", self.bend, 0.0, 90.0)?;
        within("gates: scale", self.scale, 0.01, 100.0)?;
        let [w, h, r] = Gate { scale: self.scale, ..Gate::default() }.lengths();
        if self.height[0] <= h + r {
            let limit = format!("above {:.3} m, where the lower bar touches the ground", h + r);
            return Err(Error::value("gates: height[0]", self.height[0], limit, "Raise it, or ask for smaller gates."));
        }
        // gates turned towards each other by the widest bend do not touch
        let least = 2.0 * (w + r) + self.climb;
        if self.spacing[0] <= least {
            let limit = format!("above {least:.3} m, a gate's width and the climb");
            return Err(Error::value(
                "gates: spacing[0]",
                self.spacing[0],
                limit,
                "Space them out or ask for smaller ones.",
            ));
        }
        Ok(())
    }
}
