//! Two walls along a way with bends.

use super::draw::{block, count, range, stream};
use crate::dynamics::scene::Scene;
use crate::dynamics::shape::within;
use crate::error::{Error, Result};
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of the middle line, found from the walls: half way between the two of each piece.
    fn middles(scene: &Scene) -> Vec<[f64; 3]> {
        let pairs = scene.obstacles.chunks_exact(2);
        pairs.map(|w| std::array::from_fn(|k| 0.5 * (w[0].shape.position[k] + w[1].shape.position[k]))).collect()
    }

    #[test]
    fn the_way_is_free_and_its_walls_have_no_holes() {
        for seed in 0..50 {
            let corridor = Corridor { seed, ..Corridor::default() };
            let scene = corridor.scene().unwrap();
            let placement = scene.nominal_placement();
            let middles = middles(&scene);
            for p in &middles {
                let gap = scene.distance(&placement, [p[0], p[1], 1.4]);
                assert!(gap > 0.8, "seed {seed}: {gap} m");
            }
            // around a bend the outer faces touch: walking along them, a wall is always within a millimetre
            for side in 0..2 {
                for k in 0..corridor.pieces - 1 {
                    let (a, b) = (&scene.obstacles[2 * k + side].shape, &scene.obstacles[2 * k + 2 + side].shape);
                    let gap = crate::dynamics::contact::distance(
                        &a.geometry,
                        &crate::dynamics::shape::Pose { position: a.position, attitude: a.rotation },
                        &b.geometry,
                        &crate::dynamics::shape::Pose { position: b.position, attitude: b.rotation },
                    );
                    assert!(gap < 1e-9, "seed {seed}: a hole of {gap} m");
                }
            }
        }
    }

    #[test]
    fn bends_that_eat_a_wall_are_refused() {
        let text = Corridor { length: [1.0, 2.0], bend: 60.0, ..Corridor::default() }.scene().unwrap_err().to_string();
        assert!(text.starts_with("corridor: length[0] is 1, but it must be above 1.732 m"), "{text}");
    }
}
