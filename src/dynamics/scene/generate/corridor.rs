//! Two walls along a way with bends.

use super::draw::{block, count, range, stream};
use crate::scene::Scene;
use crate::shape::within;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// A corridor: straight pieces joined at bends, a wall on either side, open at both ends.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Corridor {
    /// Another seed, another corridor.
    pub seed: u64,
    /// Number of straight pieces.
    pub pieces: usize,
    /// Least and largest length of a piece, m.
    pub length: [f64; 2],
    /// Between the walls, m.
    pub width: f64,
    /// Of the walls, m.
    pub height: f64,
    /// Of the walls, m.
    pub thickness: f64,
    /// Largest bend between two pieces, degrees.
    pub bend: f64,
}

impl Default for Corridor {
    /// Six pieces of 4 to 7 m, 3 m wide and high, with bends of up to 50°.
    fn default() -> Self {
        Self { seed: 0, pieces: 6, length: [4.0, 7.0], width: 3.0, height: 3.0, thickness: 0.2, bend: 50.0 }
    }
}

/// Largest angle between a piece and the x axis, degrees: the way never comes back to itself.
const WIDEST: f64 = 60.0;

impl Corridor {
    /// The corridor of its seed; its middle line starts at the origin along +x.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn scene(&self) -> Result<Scene> {
        self.validate()?;
        let mut stream = stream(self.seed);
        let (mut at, mut heading) = ([0.0, 0.0], 0.0_f64);
        let (bend, widest) = (self.bend.to_radians(), WIDEST.to_radians());
        let mut scene = Scene::grounded();
        let mut turn_in = 0.0_f64;
        for piece in 0..self.pieces {
            let length = stream.uniform(self.length[0], self.length[1]);
            let next = stream.uniform((heading - bend).max(-widest), (heading + bend).min(widest));
            let turn_out = if piece + 1 < self.pieces { next - heading } else { 0.0 };
            let (s, c) = heading.sin_cos();
            for (side, name) in [(1.0, "left"), (-1.0, "right")] {
                // inner faces meet where the bend's bisector cuts them: shorter inside, longer outside
                let cut = |turn: f64| side * 0.5 * self.width * (0.5 * turn).tan();
                let (from, to) = (cut(turn_in), length - cut(turn_out));
                let (along, across) = (0.5 * (from + to), side * 0.5 * (self.width + self.thickness));
                let center = [at[0] + c * along - s * across, at[1] + s * along + c * across, 0.5 * self.height];
                let size = [to - from, self.thickness, self.height];
                scene.obstacles.push(block(format!("{name} wall {piece}"), center, size, heading));
            }
            at = [at[0] + c * length, at[1] + s * length];
            (turn_in, heading) = (turn_out, next);
        }
        Ok(scene)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] for a size out of range, and for pieces shorter than their bends need.
    pub fn validate(&self) -> Result<()> {
        count("corridor: pieces", 2 * self.pieces)?;
        range("corridor: length", self.length, 0.1, 1000.0)?;
        within("corridor: width", self.width, 0.1, 1000.0)?;
        within("corridor: height", self.height, 0.1, 1000.0)?;
        within("corridor: thickness", self.thickness, 0.001, 100.0)?;
        within("corridor: bend", self.bend, 0.0, 90.0)?;
        let least = self.width * (0.5 * self.bend.to_radians()).tan();
        if self.length[0] > least {
            return Ok(());
        }
        let limit =
            format!("above {least:.3} m, which two bends of {}° take of a wall at {} m width", self.bend, self.width);
        Err(Error::value("corridor: length[0]", self.length[0], limit, "Ask for longer pieces or smaller bends."))
    }
}
