//! Blocks, tilted and half sunk: what is left of a wall.

use super::draw::{count, range, stream};
use crate::contact::plane_distance;
use crate::scene::{Obstacle, Scene};
use crate::shape::{Geometry, MAX_SIZE, Pose, Shape, within};
use crate::spatial::{from_euler, multiply};
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Blocks over a rectangle about the origin. They may lie in and on each other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rubble {
    /// Another seed, another heap.
    pub seed: u64,
    /// Along x and y, m.
    pub size: [f64; 2],
    /// How many.
    pub blocks: usize,
    /// Least and largest edge of a block, m.
    pub edge: [f64; 2],
    /// Largest tilt of a block, degrees.
    pub tilt: f64,
    /// Least and largest share of a block's height that is sunk into the ground, 0 to 1.
    pub sunk: [f64; 2],
    /// Radius about the origin without a block, m.
    pub clear: f64,
}

impl Default for Rubble {
    /// 80 blocks of 0.15 to 0.5 m over 4 m × 4 m, tilted by up to 25°, a third to two thirds sunk.
    fn default() -> Self {
        Self { seed: 0, size: [4.0; 2], blocks: 80, edge: [0.15, 0.5], tilt: 25.0, sunk: [0.33, 0.67], clear: 0.0 }
    }
}

impl Rubble {
    /// The heap of its seed: blocks named `block 0` and so on.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn scene(&self) -> Result<Scene> {
        self.validate()?;
        let mut stream = stream(self.seed);
        let reach = 0.5 * 3.0_f64.sqrt() * self.edge[1];
        let mut obstacles = Vec::with_capacity(self.blocks);
        for i in 0..self.blocks {
            let geometry = Geometry::Box { size: [(); 3].map(|()| stream.uniform(self.edge[0], self.edge[1])) };
            let (s, c) = (0.5 * stream.uniform(-PI, PI)).sin_cos();
            let tilt = self.tilt.to_radians();
            let lean = from_euler(stream.uniform(-tilt, tilt), stream.uniform(-tilt, tilt), 0.0);
            let rotation = multiply([c, 0.0, 0.0, s], lean);
            let mut position = [0.0; 3];
            // validate leaves more than a fifth of the area: a thousand misses in a row are 1e-102
            for _ in 0..1000 {
                let [x, y] = self.size.map(|size| stream.uniform(-0.5, 0.5) * size);
                position = [x, y, 0.0];
                if position[0].hypot(position[1]) >= self.clear + reach || self.clear == 0.0 {
                    break;
                }
            }
            let below = -plane_distance(&geometry, &Pose { position: [0.0; 3], attitude: rotation }, 0.0);
            position[2] = below * (1.0 - 2.0 * stream.uniform(self.sunk[0], self.sunk[1]));
            obstacles.push(Obstacle {
                name: format!("block {i}"),
                shape: Shape::new(geometry).at(position).turned(rotation),
            });
        }
        Ok(Scene { obstacles, ..Scene::grounded() })
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] for a size out of range, and for a free circle that leaves no room for blocks.
    pub fn validate(&self) -> Result<()> {
        for k in 0..2 {
            within(&format!("rubble: size[{k}]"), self.size[k], 0.1, MAX_SIZE)?;
        }
        count("rubble: blocks", self.blocks)?;
        range("rubble: edge", self.edge, 0.001, 100.0)?;
        within("rubble: tilt", self.tilt, 0.0, 180.0)?;
        range("rubble: sunk", self.sunk, 0.0, 1.0)?;
        within("rubble: clear", self.clear, 0.0, MAX_SIZE)?;
        let reach = 0.5 * 3.0_f64.sqrt() * self.edge[1];
        let least = self.size[0].min(self.size[1]);
        let most = 0.5 * least - reach;
        if self.clear > 0.0 && self.clear > most {
            let limit = format!("at most {most:.3} m for blocks of {} m on {least} m", self.edge[1]);
            return Err(Error::value("rubble: clear", self.clear, limit, "Ask for a smaller circle or a larger heap."));
        }
        Ok(())
    }
}
