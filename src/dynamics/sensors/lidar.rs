//! Lidars: distances along beams, in a grid or scattered.

use super::cast::{RangeLimits, Rays};
use super::context::{Readings, SensorContext};
use super::device::{Channel, Device, KindSettings, ReadingLayout};
use super::gradient::ReadingRay;
use super::limits::within;
use super::mount::Motion;
use super::reading::{DistanceEncoding, MOST_LOST, check_count, is_lost};
use super::sample_noise::SampleNoise;
use crate::shape::Pose;
use crate::spatial::Vec3;
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;

/// Most beams: more than any latency could hold back.
pub(crate) const MAX_BEAMS: usize = 1 << 16;

/// Where beams point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pattern {
    /// Evenly around z, at each of the elevations: the same in every sample.
    #[default]
    Grid,
    /// Spread over the band between the lowest and the highest elevation by the sequence R₂ (Roberts 2018), which goes on from
    /// sample to sample and does not repeat.
    Scatter,
}

/// Distances along beams from the mount, about its z axis: `beams` by the number of `elevations`, the first straight ahead,
/// then to the left.
///
/// White noise of standard deviation a + b d + c d²; a beam that is lost, or meets nothing within range, reads as `farthest`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Lidar {
    /// Around z.
    pub beams: usize,
    /// Above the plane of x and y, rad.
    pub elevations: Vec<f64>,
    /// Where beams point.
    pub pattern: Pattern,
    /// Least distance that it measures, m: what is nearer hides what is behind it.
    pub nearest: f64,
    /// Largest distance that it measures, m.
    pub farthest: f64,
    /// How distances are encoded.
    pub form: DistanceEncoding,
    /// a, m, b and c, 1/m.
    pub noise: [f64; 3],
    /// Share of beams that are lost, each on its own.
    pub dropout: f64,
}

impl Default for Lidar {
    /// That of OmniDrones' Forest: 36 × 4 beams of 4 m.
    fn default() -> Self {
        Self {
            beams: 36,
            elevations: [-10.0, 0.0, 10.0, 20.0].map(f64::to_radians).to_vec(),
            pattern: Pattern::Grid,
            nearest: 0.0,
            farthest: 4.0,
            form: DistanceEncoding::Distance,
            noise: [0.0; 3],
            dropout: 0.0,
        }
    }
}

impl Lidar {
    fn count(&self) -> usize {
        self.beams.saturating_mul(self.elevations.len())
    }

    fn range(&self) -> RangeLimits {
        RangeLimits { least: self.nearest, most: self.farthest }
    }

    /// Lowest and highest elevation, rad.
    fn band(&self) -> [f64; 2] {
        self.elevations.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(*x), high.max(*x)])
    }
}

impl KindSettings for Lidar {
    fn channels(&self) -> Vec<Channel> {
        (0..self.count()).map(|i| (format!("range_{i}").into(), self.form.unit())).collect()
    }

    fn layout(&self) -> ReadingLayout {
        ReadingLayout::Lidar { rows: self.beams, columns: self.elevations.len() }
    }

    fn bounds(&self) -> [f64; 2] {
        self.form.bounds(self.nearest, self.farthest)
    }

    fn validate(&self, what: &str) -> Result<()> {
        let remedy = "Split them into several sensors, or take fewer at a higher rate.";
        check_count(&format!("{what}: beams times elevations"), self.count(), MAX_BEAMS, remedy)?;
        for x in &self.elevations {
            within(&format!("{what}: elevations"), *x, -FRAC_PI_2, FRAC_PI_2)?;
        }
        let [low, high] = self.band();
        if self.pattern == Pattern::Scatter && high - low < 1e-3 {
            let remedy = "Give the lowest and the highest, or take the pattern grid.";
            return Err(Error::value(format!("{what}: elevations"), low, "a band of 0.001 rad or more", remedy));
        }
        self.range().validate(what)?;
        self.noise.iter().try_for_each(|x| within(&format!("{what}: noise"), *x, -1e3, 1e3))?;
        within(&format!("{what}: dropout"), self.dropout, 0.0, MOST_LOST)
    }
}

#[derive(Debug, Clone)]
pub(crate) struct LidarDevice {
    settings: Lidar,
    /// Shared by all sensors of these settings, unless beams scatter.
    rays: Arc<Rays>,
    directions: Vec<Vec3<f64>>,
    /// Beams so far.
    count: f64,
}

impl LidarDevice {
    pub(crate) fn new(settings: &Lidar, _: f64) -> Result<Self> {
        let rays = Arc::new(Rays::lidar(settings.beams, &settings.elevations, settings.range())?);
        let n = if settings.pattern == Pattern::Scatter { settings.count() } else { 0 };
        Ok(Self { settings: settings.clone(), rays, directions: vec![[0.0; 3]; n], count: 0.0 })
    }

    /// The next beams of the sequence: azimuth, and height on the unit sphere, so that they are as dense everywhere.
    fn scatter(&mut self) {
        let [low, high] = self.settings.band().map(f64::sin);
        for direction in &mut self.directions {
            let [u, w] = R2.map(|step| (0.5 + step * self.count).fract());
            let rise = low + (high - low) * w;
            let flat = (1.0 - rise * rise).max(0.0).sqrt();
            let (sin, cos) = (TAU * u).sin_cos();
            *direction = [flat * cos, flat * sin, rise];
            self.count += 1.0;
        }
        // as many as there were, of unit length: nothing to refuse
        let _ = Arc::make_mut(&mut self.rays).aim(&self.directions);
    }
}

/// 1/φ and 1/φ² of the plastic number φ = φ³ − 1.
const R2: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];

impl Device for LidarDevice {
    fn draw(&mut self, stream: &mut Stream) {
        // each episode begins elsewhere in the sequence
        self.count = stream.below(1 << 24) as f64;
    }

    fn sample(&mut self, at: &Motion, context: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        if self.settings.pattern == Pattern::Scatter {
            self.scatter();
        }
        let (own, grain) = (&self.settings, SampleNoise::new(stream.next_u64()));
        let (lost, [a, b, c]) = (grain.other(), own.noise);
        // as rays tell it
        let farthest = f64::from(own.farthest as f32);
        let noisy = own.noise != [0.0; 3];
        let seen = context.rays(&self.rays, &Pose { position: at.position, attitude: at.attitude });
        let Readings { ranges, ids, mut met, .. } = seen;
        for (i, (reading, range)) in out.iter_mut().zip(ranges).enumerate() {
            let t = f64::from(*range);
            let mut d = t;
            let seen = d < farthest && !is_lost(lost, i, own.dropout);
            if noisy && seen {
                d += (a + d * (b + d * c)).max(0.0) * grain.normal(i);
            }
            if let Some(met) = &mut met {
                let free = seen && (own.nearest..own.farthest).contains(&d);
                let factor = if free { own.form.slope(d) } else { 0.0 };
                met.push(ReadingRay { id: ids[i], t, direction: self.rays.direction(i), factor });
            }
            let d = if seen { d.clamp(own.nearest, own.farthest) } else { own.farthest };
            *reading = own.form.of(d, own.farthest);
        }
    }

    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit(&mut self.count);
    }
}
