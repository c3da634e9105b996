//! temporary
use crate::error::Result;
use serde::{Deserialize, Serialize};
/// temporary
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Geometry {
    /// s
    Sphere {
        /// r
        radius: f64,
    },
    /// c
    Capsule {
        /// r
        radius: f64,
        /// l
        length: f64,
    },
    /// b
    Box {
        /// s
        size: [f64; 3],
    },
}
/// temporary
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Shape {
    /// g
    pub geometry: Geometry,
    /// p
    pub position: [f64; 3],
    /// r
    pub rotation: [f64; 4],
}
impl Shape {
    /// v
    pub fn validate(&self, _: &str) -> Result<()> {
        Ok(())
    }
}
