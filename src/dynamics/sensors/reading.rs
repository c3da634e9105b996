//! How distances are encoded, and what goes wrong with them.

use super::sample_noise::SampleNoise;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// How a distance d becomes a reading. What sees nothing in range counts as `farthest`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DistanceEncoding {
    /// d, m.
    #[default]
    Distance,
    /// `farthest` − d, m: 0 where nothing is near, as OmniDrones' Forest shows its lidar.
    Proximity,
    /// 3/d − 0.6 with d in m held within 0.3 … 24: −0.5 far away, 9.4 close by (DiffPhysDrone).
    Inverse,
}

impl DistanceEncoding {
    /// Of a distance within `farthest`.
    pub(crate) fn of(self, d: f64, farthest: f64) -> f64 {
        match self {
            Self::Distance => d,
            Self::Proximity => farthest - d,
            Self::Inverse => 3.0 / d.clamp(0.3, 24.0) - 0.6,
        }
    }

    /// Least and largest reading of distances from `nearest` to `farthest`.
    pub(crate) fn bounds(self, nearest: f64, farthest: f64) -> [f64; 2] {
        let [a, b] = [nearest, farthest].map(|d| self.of(d, farthest));
        [a.min(b), a.max(b)]
    }

    /// Derivative of [`DistanceEncoding::of`].
    pub(crate) fn slope(self, d: f64) -> f64 {
        match self {
            Self::Distance => 1.0,
            Self::Proximity => -1.0,
            Self::Inverse if (0.3..=24.0).contains(&d) => -3.0 / (d * d),
            Self::Inverse => 0.0,
        }
    }

    /// Unit of readings.
    pub(crate) fn unit(self) -> &'static str {
        match self {
            Self::Distance | Self::Proximity => "m",
            Self::Inverse => "-",
        }
    }
}

/// Largest share of readings that may be lost.
pub(crate) const MOST_LOST: f64 = 0.9;

/// Lost readings see nothing: number `i` with the chance `share`.
pub(crate) fn is_lost(grain: SampleNoise, i: usize, share: f64) -> bool {
    share > 0.0 && grain.unit(i) < share
}

/// Refuses a number of readings that nobody can hold.
pub(crate) fn check_count(what: &str, n: usize, most: usize, remedy: &str) -> Result<()> {
    if (1..=most).contains(&n) { Ok(()) } else { Err(Error::limit(what, n, format!("1 to {most}"), remedy)) }
}
