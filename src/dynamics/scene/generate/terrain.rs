//! Smooth hills and hollows.

use super::draw::{range, stream};
use crate::scene::Scene;
use crate::shape::within;
use crate::uneven_ground::{GroundWave, UnevenGround};
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Hills as a sum of waves in random directions: height at the origin 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Terrain {
    /// Another seed, other hills.
    pub seed: u64,
    /// Number of waves.
    pub waves: usize,
    /// Shortest and longest wave, m.
    pub length: [f64; 2],
    /// Largest slope where all waves add up, degrees: each has an equal share of it.
    pub steepness: f64,
    /// Of the ground as a whole, rising along +x, degrees.
    pub incline: f64,
}

impl Default for Terrain {
    /// Eight waves of 2 to 10 m, 25° at most, on level ground.
    fn default() -> Self {
        Self { seed: 0, waves: 8, length: [2.0, 10.0], steepness: 25.0, incline: 0.0 }
    }
}

impl Terrain {
    /// The hills of its seed.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn scene(&self) -> Result<Scene> {
        self.validate()?;
        let mut stream = stream(self.seed);
        let share = self.steepness.to_radians().tan() / self.waves.max(1) as f64;
        let wave = |_| {
            let number = TAU / stream.uniform(self.length[0], self.length[1]);
            let (s, c) = stream.uniform(0.0, TAU).sin_cos();
            GroundWave { amplitude: share / number, number: [number * c, number * s], phase: stream.uniform(0.0, TAU) }
        };
        let slope = [self.incline.to_radians().tan(), 0.0];
        let relief = UnevenGround { slope, waves: (0..self.waves).map(wave).collect() };
        let ground = -relief.rise(0.0, 0.0).0;
        let scene = Scene { ground: Some(ground), relief: Some(relief), ..Scene::default() };
        scene.validate()?;
        Ok(scene)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] for a size out of range.
    pub fn validate(&self) -> Result<()> {
        if self.waves > 64 {
            return Err(Error::limit("terrain: waves", self.waves, 64, "Ask for fewer and longer ones."));
        }
        range("terrain: length", self.length, 0.1, 1e4)?;
        within("terrain: steepness", self.steepness, 0.0, 60.0)?;
        within("terrain: incline", self.incline, -60.0, 60.0)
    }
}
