//! Sensors that look down: range finder and optical flow.
//!
//! Both look along −z of their mount: with the rotation [1, 0, 0, 0] straight down from a level body. They see the plane z =
//! `ground`, in closed form; a range finder also what stands in its way, and uneven ground where there is some.

use super::cast::{self, GROUND, Rays};
use super::chain::{ErrorModel, Errors};
use super::context::{Readings, SensorContext};
use super::device::{Device, KindSettings};
use super::gradient::ReadingRay;
use super::limits::{MAX_DISTANCE, within};
use super::mount::Motion;
use crate::shape::{MAX_SIZE, Pose};
use crate::spatial::{Vec3, rotate_back, up_axis};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;

/// White noise that grows with distance: by 1 + factor^((d − from)/(until − from)).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseGrowth {
    /// Where it has doubled, m.
    pub from: f64,
    /// Where it is 1 + `factor` times as strong, m.
    pub until: f64,
    /// At least 1.
    pub factor: f64,
}

impl NoiseGrowth {
    /// At distance d, m; beyond `until` as there.
    fn share(&self, d: f64) -> f64 {
        1.0 + self.factor.powf(((d - self.from) / (self.until - self.from)).min(1.0))
    }

    fn validate(&self, what: &str) -> Result<()> {
        within(&format!("{what}.from"), self.from, 0.0, MAX_DISTANCE)?;
        within(&format!("{what}.factor"), self.factor, 1.0, 1e6)?;
        if self.until - self.from >= 1e-3 && self.until <= MAX_DISTANCE {
            return Ok(());
        }
        let limit = format!("between {} m, 1 mm beyond from, and {MAX_DISTANCE:e} m", self.from + 1e-3);
        Err(Error::value(
            format!("{what}.until"),
            self.until,
            limit,
            "Leave growth out, and a preset that has one, for the same noise everywhere.",
        ))
    }
}

with_defaults! {
    /// Distance to the ground along −z of the mount, of a cone the nearest: h/cos(max(θ − α, 0)), θ the angle between the axis and
    /// the vertical, α half of `cone`. What else stands in the cone is met by seven rays of it, by one where it has no angle; so is ground that is uneven. Out of range, by itself or by its noise, it reads
    /// `farthest`, and `valid` is 0.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct Range {
        /// Height of the ground, m, world.
        pub ground: f64 = 0.0,
        /// Full angle of the cone that it sees, rad; 0 for a ray.
        pub cone: f64 = 0.0,
        /// Least distance that it measures, m.
        pub nearest: f64 = 0.0,
        /// Largest distance that it measures, m.
        pub farthest: f64 = 40.0,
        /// How the white noise of `error` grows; without it, not at all.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub growth: Option<NoiseGrowth> = None,
        /// u is m.
        pub error: ErrorModel = ErrorModel::default(),
    }
}

impl KindSettings for Range {
    const OPTIONAL: &[&'static str] = &["growth"];
    const CHANNELS: &[(&'static str, &'static str)] = &[("distance", "m"), ("valid", "-")];

    fn validate(&self, what: &str) -> Result<()> {
        within(&format!("{what}: cone"), self.cone, 0.0, PI)?;
        seen(what, self.ground, self.nearest, self.farthest)?;
        self.growth.map_or(Ok(()), |growth| growth.validate(&format!("{what}: growth")))?;
        self.error.validate(&format!("{what}: error"), 1)
    }
}

/// Refuses what nothing can see.
fn seen(what: &str, ground: f64, nearest: f64, farthest: f64) -> Result<()> {
    within(&format!("{what}: ground"), ground, -MAX_DISTANCE, MAX_DISTANCE)?;
    within(&format!("{what}: nearest"), nearest, 0.0, MAX_DISTANCE)?;
    within(&format!("{what}: farthest"), farthest, 0.0, MAX_DISTANCE)?;
    if nearest < farthest {
        return Ok(());
    }
    let limit = format!("> {nearest} m, the nearest");
    Err(Error::value(format!("{what}: farthest"), farthest, limit, "Give nearest < farthest in metres."))
}

#[derive(Debug, Clone)]
pub(crate) struct RangeDevice {
    settings: Range,
    /// Its axis, and six on the rim of its cone.
    rays: Arc<Rays>,
    errors: Errors<1>,
}

impl RangeDevice {
    pub(crate) fn new(settings: &Range, between: f64) -> Result<Self> {
        let (sin, cos) = (0.5 * settings.cone).sin_cos();
        let rim = (0..6).map(|k| {
            let (side, ahead) = (TAU / 6.0 * f64::from(k)).sin_cos();
            [sin * ahead, sin * side, -cos]
        });
        let n = if settings.cone > 0.0 { 6 } else { 0 };
        let directions: Vec<_> = std::iter::once([0.0, 0.0, -1.0]).chain(rim.take(n)).collect();
        let range = cast::RangeLimits { least: 0.0, most: settings.farthest.min(MAX_SIZE) };
        let rays = Arc::new(Rays::new(&directions, range)?);
        Ok(Self { settings: settings.clone(), rays, errors: Errors::new(&settings.error, between) })
    }

    /// The nearest of all that is in the cone, m; infinite where there is nothing. With the ray that met it, where slopes are
    /// told.
    fn nearest(&self, at: &Motion, context: &mut SensorContext<'_>) -> f64 {
        let pose = Pose { position: at.position, attitude: at.attitude };
        let Readings { ranges, ids, met, world, .. } = context.rays(&self.rays, &pose);
        let angle = self.angle(at);
        // level ground is known in closed form
        let (first, ground) =
            if world.is_uneven() { (GROUND, f64::INFINITY) } else { (GROUND + 1, self.distance(at, angle)) };
        let solid = ranges.iter().zip(ids).enumerate().filter(|(_, (_, id))| **id >= first);
        let of_ray = |(i, (d, _)): (usize, (&f32, _))| (f64::from(*d), Some(i));
        let least = |a: (f64, _), b: (f64, _)| if b.0 < a.0 { b } else { a };
        let (distance, ray) = solid.map(of_ray).fold((ground, None), least);
        if let Some(met) = met {
            let (id, direction) = match ray {
                Some(i) => (ids[i], self.rays.direction(i)),
                None => (GROUND, towards_ground(at, angle)),
            };
            met.push(ReadingRay { id, t: distance, direction, factor: 1.0 });
        }
        distance
    }

    /// Between the vertical and the nearest ray of the cone to it, rad.
    fn angle(&self, at: &Motion) -> f64 {
        let tilt = up_axis(at.attitude)[2].clamp(-1.0, 1.0).acos();
        (tilt - 0.5 * self.settings.cone).max(0.0)
    }

    /// The ground along a ray at this angle to the vertical, m; infinite where there is none.
    fn distance(&self, at: &Motion, angle: f64) -> f64 {
        let height = at.position[2] - self.settings.ground;
        if height >= 0.0 && angle < FRAC_PI_2 { height / angle.cos() } else { f64::INFINITY }
    }
}

/// The ray of a cone that meets the ground first, in the mount's frame, `angle` off the vertical. While the cone turns it stays
/// with the body, to first order: where the cone holds the vertical it is at the least distance, else at the rim.
fn towards_ground(at: &Motion, angle: f64) -> Vec3<f64> {
    let up = up_axis(at.attitude);
    let flat = [-up[0], -up[1], 0.0];
    let length = flat[0].hypot(flat[1]).max(f64::MIN_POSITIVE);
    let (sin, cos) = angle.sin_cos();
    rotate_back(at.attitude, [sin * flat[0] / length, sin * flat[1] / length, -cos])
}

impl Device for RangeDevice {
    fn draw(&mut self, stream: &mut Stream) {
        self.errors.draw(stream);
    }

    fn sample(&mut self, at: &Motion, context: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        let (distance, farthest) = (self.nearest(at, context), self.settings.farthest);
        let measures = |d: f64| (self.settings.nearest..=farthest).contains(&d);
        let shown = if measures(distance) { distance } else { farthest };
        let share = self.settings.growth.map_or(1.0, |growth| growth.share(shown));
        let [measured] = self.errors.apply_with([shown], share, stream);
        let valid = measures(distance) && measures(measured);
        context.finish(|met| {
            let slope = self.errors.slope()[0][0];
            met.iter_mut().for_each(|met| met.factor *= if valid { slope } else { 0.0 });
            met.push(ReadingRay::NOTHING); // `valid` is a step
        });
        out.copy_from_slice(&if valid { [measured, 1.0] } else { [farthest, 0.0] });
    }

    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.errors.each(visit);
    }
}

/// Pixels by which the ground moves through the picture between two samples, counted as the sensor's own motion:
///
/// ```text
/// n_x = Δt (N/θ)(v_x/d − ω_y)        n_y = Δt (N/θ)(v_y/d + ω_x)
/// ```
///
/// v and ω along mount axes, d the distance to the ground along −z, N `pixels` over the angle θ `aperture`: the model of the
/// Crazyflie's estimator. Where no ground is in range both read 0, and `valid` is 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Flow {
    /// Height of the ground, m, world.
    pub ground: f64,
    /// N, across the picture.
    pub pixels: f64,
    /// θ, of the picture, rad.
    pub aperture: f64,
    /// Least distance at which it sees texture, m.
    pub nearest: f64,
    /// Largest distance at which it does, m.
    pub farthest: f64,
    /// u is a pixel.
    pub error: ErrorModel,
}

impl Default for Flow {
    fn default() -> Self {
        let error = ErrorModel::default();
        Self { ground: 0.0, pixels: 35.0, aperture: 0.717, nearest: 0.08, farthest: MAX_DISTANCE, error }
    }
}

impl KindSettings for Flow {
    const CHANNELS: &[(&'static str, &'static str)] = &[("pixels_x", "-"), ("pixels_y", "-"), ("valid", "-")];

    fn validate(&self, what: &str) -> Result<()> {
        seen(what, self.ground, self.nearest, self.farthest)?;
        within(&format!("{what}: pixels"), self.pixels, 1.0, 1e5)?;
        within(&format!("{what}: aperture"), self.aperture, 1e-3, PI)?;
        self.error.validate(&format!("{what}: error"), 2)
    }
}

#[derive(Debug, Clone)]
pub(crate) struct FlowDevice {
    settings: Flow,
    /// Δt N/θ, pixels per rad/s.
    gain: f64,
    errors: Errors<2>,
}

impl FlowDevice {
    pub(crate) fn new(settings: &Flow, between: f64) -> Result<Self> {
        let gain = between * settings.pixels / settings.aperture;
        Ok(Self { settings: settings.clone(), gain, errors: Errors::new(&settings.error, between) })
    }
}

impl Device for FlowDevice {
    fn draw(&mut self, stream: &mut Stream) {
        self.errors.draw(stream);
    }

    fn sample(&mut self, at: &Motion, _: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        let cosine = up_axis(at.attitude)[2];
        let distance = if cosine > 0.0 { (at.position[2] - self.settings.ground) / cosine } else { f64::INFINITY };
        let valid = distance > 0.0 && (self.settings.nearest..=self.settings.farthest).contains(&distance);
        let (v, w) = (rotate_back(at.attitude, at.velocity), at.angular_velocity);
        let pixels = [v[0] / distance - w[1], v[1] / distance + w[0]].map(|rate| self.gain * rate);
        // drawn in any case: the noise of later samples does not depend on what was seen
        let [x, y] = self.errors.apply(if valid { pixels } else { [0.0; 2] }, stream);
        out.copy_from_slice(&if valid { [x, y, 1.0] } else { [0.0; 3] });
    }

    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.errors.each(visit);
    }
}
