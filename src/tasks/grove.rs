//! A forest whose trunks stand elsewhere in every episode.

use base::error::{Error, Result};
use dynamics::scene::{Forest, Obstacle, Scene};
use dynamics::shape::Geometry;
use rng::Stream;
use serde::{Deserialize, Serialize};

/// Most trunks.
pub(crate) const MAX_TRUNKS: usize = 256;

/// A forest, with the scene in which its trunks stand where nothing is drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Forest", into = "Forest")]
pub struct Grove {
    forest: Forest,
    scene: Scene,
}

impl Grove {
    /// # Errors
    /// [`Error::Limit`] for more than 256 trunks; as [`Forest::validate`].
    pub fn new(forest: Forest) -> Result<Self> {
        if forest.trunks > MAX_TRUNKS {
            let remedy = "Take fewer trunks, or a wider gap.";
            return Err(Error::limit("task.trunks", forest.trunks, MAX_TRUNKS, remedy));
        }
        Ok(Self { forest, scene: forest.scene()? })
    }

    /// With its trunks and level ground.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Its trunks.
    pub fn trunks(&self) -> &[Obstacle] {
        &self.scene.obstacles
    }

    /// Radii of the trunks, m.
    pub fn radii(&self) -> Vec<f64> {
        let radius = |geometry: &Geometry| if let Geometry::Capsule { radius, .. } = geometry { *radius } else { 0.0 };
        self.trunks().iter().map(|trunk| radius(&trunk.shape.geometry)).collect()
    }

    /// Draws offsets of the trunks from their places in the scene, m, three of each, of which the first `standing` stand (the nearest
    /// whole number): [`Forest::place`]. Nothing is drawn where none stands.
    pub fn place(&self, standing: f64, stream: &mut Stream, offsets: &mut [f64]) {
        let standing = standing.round() as usize;
        if standing == 0 {
            offsets.fill(0.0);
        } else {
            self.forest.place(self.trunks(), standing, stream, offsets);
        }
    }
}

impl TryFrom<Forest> for Grove {
    type Error = Error;
    fn try_from(forest: Forest) -> Result<Self> {
        Self::new(forest)
    }
}

impl From<Grove> for Forest {
    fn from(grove: Grove) -> Self {
        grove.forest
    }
}
