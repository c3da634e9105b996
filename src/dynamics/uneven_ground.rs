//! Uneven ground: a slope with waves on it, over any scalar.

use super::shape::within;
use super::spatial::Vec3;
use autodiff::{Scalar, safe};
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Most waves of one ground.
const MAX_WAVES: usize = 64;
/// Steepest ground, m per m.
const STEEPEST: f64 = 2.0;

/// What rises over level ground: h(x, y) = s·(x, y) + Σ a sin(k·(x, y) + φ), m.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UnevenGround {
    /// Rise per metre along x and along y; tan of the angle for ground that rises along an axis.
    pub slope: [f64; 2],
    /// Smooth hills and hollows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub waves: Vec<GroundWave>,
}

/// One wave of the ground.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroundWave {
    /// a, m.
    pub amplitude: f64,
    /// k, rad/m along x and y; its length is 2π over that of the wave.
    pub number: [f64; 2],
    /// φ, rad.
    #[serde(default)]
    pub phase: f64,
}

impl UnevenGround {
    /// Ground that rises by `angle` rad along +x.
    pub fn inclined(angle: f64) -> Self {
        Self { slope: [angle.tan(), 0.0], waves: Vec::new() }
    }

    /// h (m) at a place x, y (m, world), and its slopes ∂h/∂x and ∂h/∂y.
    pub fn rise<S: Scalar>(&self, x: S, y: S) -> (S, [S; 2]) {
        let (sx, sy) = (S::constant(self.slope[0]), S::constant(self.slope[1]));
        let (mut height, mut slope) = (sx.mul_add(x, sy * y), [sx, sy]);
        for i in 0..self.waves.len() {
            let GroundWave { amplitude, number, phase } = self.waves[i];
            let (kx, ky) = (S::constant(number[0]), S::constant(number[1]));
            let (s, c) = kx.mul_add(x, ky.mul_add(y, S::constant(phase))).sin_cos();
            let a = S::constant(amplitude);
            height = a.mul_add(s, height);
            slope = [(a * c).mul_add(kx, slope[0]), (a * c).mul_add(ky, slope[1])];
        }
        (height, slope)
    }

    /// Signed distance of a world point to the ground that rises over z = `height`, m, and the ground's unit normal below it:
    /// (z − height − h)/√(1 + ‖∇h‖²). Exact on a slope; with waves of curvature κ off by about κ/2 times the square of
    /// distance times slope. Its sign is right everywhere.
    #[inline]
    pub fn surface<S: Scalar>(&self, point: Vec3<S>, height: S) -> (S, Vec3<S>) {
        let (rise, [sx, sy]) = self.rise(point[0], point[1]);
        let recip = safe::recip_sqrt(sx.mul_add(sx, sy.mul_add(sy, S::one())), safe::SQUARED_NORM_FLOOR);
        ((point[2] - height - rise) * recip, [-(sx * recip), -(sy * recip), recip])
    }

    /// Checks every number; `what` names the ground in the error.
    ///
    /// # Errors
    /// [`Error::Value`] for what is not finite, and for ground steeper than 2 m per m somewhere; [`Error::Limit`] for more
    /// than 64 waves.
    pub fn validate(&self, what: &str) -> Result<()> {
        if self.waves.len() > MAX_WAVES {
            let remedy = "The longest of them make the hills: leave out the others.";
            return Err(Error::limit(format!("{what}: number of waves"), self.waves.len(), MAX_WAVES, remedy));
        }
        for k in 0..2 {
            within(&format!("{what}: slope[{k}]"), self.slope[k], -STEEPEST, STEEPEST)?;
        }
        let mut steepest = self.slope[0].hypot(self.slope[1]);
        for (i, wave) in self.waves.iter().enumerate() {
            let at = |name: &str| format!("{what}: waves[{i}]: {name}");
            within(&at("amplitude"), wave.amplitude, -1e3, 1e3)?;
            within(&at("number[0]"), wave.number[0], -1e3, 1e3)?;
            within(&at("number[1]"), wave.number[1], -1e3, 1e3)?;
            within(&at("phase"), wave.phase, -1e3, 1e3)?;
            steepest += wave.amplitude.abs() * wave.number[0].hypot(wave.number[1]);
        }
        if steepest <= STEEPEST {
            return Ok(());
        }
        let limit = format!("at most {STEEPEST} m per m where all waves add up");
        let remedy = "Flatten the slope, or make waves lower or longer.";
        Err(Error::value(format!("{what}: steepest place"), format!("{steepest:.3} m per m"), limit, remedy))
    }
}
