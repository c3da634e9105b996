//! Cameras: depth with the noise and holes of stereo, what is seen, surfaces, colours.

use super::cast::{self, NOTHING, RangeLimits, RayScene, RayTarget, Rays};
use super::context::{Readings, SensorContext};
use super::device::{Channel, Device, KindSettings, ReadingLayout};
use super::gradient::ReadingRay;
use super::lidar::MAX_BEAMS;
use super::limits::within;
use super::mount::Motion;
use super::reading::{DistanceEncoding, MOST_LOST, check_count, is_lost};
use super::sample_noise::SampleNoise;
use super::shade;
use crate::scene::Element;
use crate::shape::Pose;
use crate::spatial::rotate_back;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What a camera shows of every pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageType {
    /// Planar depth, m, encoded as `form` says.
    #[default]
    Depth,
    /// 0 nothing in range, 1 ground, 2 a gate, 3 an obstacle or a mesh, 4 another body.
    Segmentation,
    /// Outward unit normal of the surface along the axes of the camera (x forward, y left, z up); zeros for nothing.
    Normals,
    /// Red, green and blue within 0 … 1: a colour of its own for each thing, under a sun.
    Rgb,
}

impl ImageType {
    /// Numbers of a pixel.
    fn channels(self) -> usize {
        match self {
            Self::Depth | Self::Segmentation => 1,
            Self::Normals | Self::Rgb => 3,
        }
    }
}

/// How a pair of imagers measures depth: z = f B/(disparity), the disparity with noise and in steps. So σ_z = s z²/(f B).
///
/// What the right imager, B to the right, cannot see because something nearer hides it, has no depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stereo {
    /// f of the imagers, in pixels of theirs.
    pub focal: f64,
    /// B, m.
    pub baseline: f64,
    /// s, standard deviation of the disparity, pixels.
    pub deviation: f64,
    /// Step of the disparity, pixels; 0 for none.
    pub resolution: f64,
}

impl Stereo {
    fn validate(&self, what: &str) -> Result<()> {
        within(&format!("{what}.focal"), self.focal, 1.0, 1e6)?;
        within(&format!("{what}.baseline"), self.baseline, 1e-4, 100.0)?;
        within(&format!("{what}.deviation"), self.deviation, 0.0, 1e3)?;
        within(&format!("{what}.resolution"), self.resolution, 0.0, 1e3)
    }

    /// Depth as measured, with the normal draw `n`.
    fn measured(&self, z: f64, n: f64) -> f64 {
        let product = self.focal * self.baseline;
        let disparity = product / z + self.deviation * n;
        let steps = if self.resolution > 0.0 { self.resolution } else { f64::MIN_POSITIVE };
        let disparity = if self.resolution > 0.0 { (disparity / steps).round() * steps } else { disparity };
        if disparity > 0.0 { product / disparity } else { f64::INFINITY }
    }
}

with_defaults! {
    /// A pinhole camera that looks along x of its mount; columns run to the right, rows down.
    ///
    /// A pixel that sees nothing in range, is lost, or lies in the shadow of stereo, reads as `farthest`.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct Camera {
        /// Columns and rows.
        pub size: [usize; 2] = [64, 48],
        /// From the left to the right edge, rad.
        pub field_of_view: f64 = 1.5,
        /// What of every pixel.
        pub show: ImageType = ImageType::Depth,
        /// Least planar depth, m: what is nearer hides what is behind it.
        pub nearest: f64 = 0.0,
        /// Largest planar depth, m.
        pub farthest: f64 = 10.0,
        /// How depth is encoded.
        pub form: DistanceEncoding = DistanceEncoding::Distance,
        /// Pixels of an edge of the squares of which the nearest depth is read: 4 makes 16 × 12 numbers of 64 × 48 pixels.
        pub pool: usize = 1,
        /// How depth is measured; exactly without.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub stereo: Option<Stereo> = None,
        /// Share of pixels that are lost, each on its own.
        pub dropout: f64 = 0.0,
        /// Whether things throw shadows on a coloured picture, at a ray per pixel.
        pub shadows: bool = false,
    }
}

impl Camera {
    fn range(&self) -> RangeLimits {
        RangeLimits { least: self.nearest, most: self.farthest }
    }

    /// Derivative of the reading of a pixel at depth t, measured as z: noise and steps are those of the disparity.
    fn slope(&self, t: f64, z: f64) -> f64 {
        let measured = if self.stereo.is_some() { (z / t).powi(2) } else { 1.0 };
        measured * self.form.slope(z)
    }

    /// Rows and columns of readings.
    fn extent(&self) -> [usize; 2] {
        [self.size[1] / self.pool.max(1), self.size[0] / self.pool.max(1)]
    }
}

impl KindSettings for Camera {
    const OPTIONAL: &[&'static str] = &["stereo"];

    fn channels(&self) -> Vec<Channel> {
        let [rows, columns] = self.extent();
        let (names, unit): (&[&str], _) = match self.show {
            ImageType::Depth => (&["depth"], self.form.unit()),
            ImageType::Segmentation => (&["class"], "-"),
            ImageType::Normals => (&["normal_x", "normal_y", "normal_z"], "-"),
            ImageType::Rgb => (&["red", "green", "blue"], "-"),
        };
        let pixels = (0..rows).flat_map(|i| (0..columns).map(move |j| (i, j)));
        pixels.flat_map(|(i, j)| names.iter().map(move |name| (format!("{name}_{i}_{j}").into(), unit))).collect()
    }

    fn layout(&self) -> ReadingLayout {
        let [height, width] = self.extent();
        ReadingLayout::Image { height, width, channels: self.show.channels() }
    }

    fn bounds(&self) -> [f64; 2] {
        match self.show {
            ImageType::Depth => self.form.bounds(self.nearest, self.farthest),
            ImageType::Segmentation => [0.0, 4.0],
            ImageType::Normals => [-1.0, 1.0],
            ImageType::Rgb => [0.0, 1.0],
        }
    }

    fn validate(&self, what: &str) -> Result<()> {
        let [width, height] = self.size;
        let numbers = width.saturating_mul(height).saturating_mul(self.show.channels());
        let remedy = "Take a smaller image, or dynamics::sensors::cast for single pictures.";
        check_count(&format!("{what}: numbers of size"), numbers, MAX_BEAMS, remedy)?;
        cast::PinholeCamera::new(width, height, self.field_of_view, self.range())?;
        if self.pool == 0 || !width.is_multiple_of(self.pool) || !height.is_multiple_of(self.pool) {
            let limit = format!("a divisor of {width} and {height}");
            return Err(Error::value(format!("{what}: pool"), self.pool, limit, "1 tells every pixel."));
        }
        if self.show != ImageType::Depth && (self.pool > 1 || self.stereo.is_some()) {
            let remedy = "Leave pool and stereo out, or show depth.";
            return Err(Error::value(
                format!("{what}: show"),
                format!("{:?}", self.show),
                "depth with pool or stereo",
                remedy,
            ));
        }
        self.stereo.map_or(Ok(()), |stereo| stereo.validate(&format!("{what}: stereo")))?;
        within(&format!("{what}: dropout"), self.dropout, 0.0, MOST_LOST)
    }
}

#[derive(Debug, Clone)]
pub(crate) struct CameraDevice {
    settings: Camera,
    /// Shared by all sensors of these settings.
    camera: Arc<cast::PinholeCamera>,
    /// Towards the sun.
    sun: Arc<Rays>,
    /// Of a picture whose shadows are to be found.
    depth: Vec<f32>,
    ids: Vec<u32>,
}

impl CameraDevice {
    pub(crate) fn new(settings: &Camera, _: f64) -> Result<Self> {
        let [width, height] = settings.size;
        let camera = cast::PinholeCamera::new(width, height, settings.field_of_view, settings.range())?;
        let n = if settings.show == ImageType::Rgb { width * height } else { 0 };
        let sun = Rays::new(&[shade::SUN], RangeLimits { least: 0.0, most: shade::FAR })?;
        let (camera, sun) = (Arc::new(camera), Arc::new(sun));
        Ok(Self { settings: settings.clone(), camera, sun, depth: vec![0.0; n], ids: vec![0; n] })
    }

    fn show_depth(&self, pose: &Pose<f64>, context: &mut SensorContext<'_>, grain: SampleNoise, out: &mut [f64]) {
        let own = &self.settings;
        let ([width, _], [_, columns]) = (own.size, own.extent());
        let Readings { ranges: depth, ids, mut met, .. } = context.image(&self.camera, pose);
        if let Some(stereo) = &own.stereo {
            let focal = 0.5 * width as f64 / (0.5 * own.field_of_view).tan();
            depth.chunks_exact_mut(width).for_each(|row| hide_shadows(row, focal * stereo.baseline, own.farthest));
        }
        out.fill(own.farthest);
        if let Some(met) = &mut met {
            met.resize(out.len(), ReadingRay::NOTHING);
        }
        let lost = grain.other();
        // as rays tell it
        let farthest = f64::from(own.farthest as f32);
        for (i, t) in depth.iter().enumerate() {
            let t = f64::from(*t);
            if t >= farthest || is_lost(lost, i, own.dropout) {
                continue;
            }
            let z = own.stereo.as_ref().map_or(t, |stereo| stereo.measured(t, grain.normal(i)));
            let square = i / width / own.pool * columns + i % width / own.pool;
            if let Some(met) = met.as_mut().filter(|_| z < out[square]) {
                let factor = if z < own.nearest { 0.0 } else { own.slope(t, z) };
                met[square] = ReadingRay { id: ids[i], t, direction: self.camera.direction(i), factor };
            }
            out[square] = out[square].min(z.max(own.nearest));
        }
        out.iter_mut().for_each(|z| *z = own.form.of(*z, own.farthest));
    }

    fn show_classes(&self, pose: &Pose<f64>, context: &mut SensorContext<'_>, lost: SampleNoise, out: &mut [f64]) {
        let Readings { ids, world, .. } = context.image(&self.camera, pose);
        for (i, (class, id)) in out.iter_mut().zip(ids).enumerate() {
            *class = if is_lost(lost, i, self.settings.dropout) { 0.0 } else { class_of(world, *id) };
        }
    }

    fn show_normals(&self, pose: &Pose<f64>, context: &mut SensorContext<'_>, lost: SampleNoise, out: &mut [f64]) {
        let Readings { ranges: depth, ids, world, .. } = context.image(&self.camera, pose);
        for (i, normal) in out.chunks_exact_mut(3).enumerate() {
            let point = pose.point(self.camera.direction(i).map(|d| f64::from(depth[i]) * d));
            let seen = world.normal(ids[i], point).filter(|_| !is_lost(lost, i, self.settings.dropout));
            normal.copy_from_slice(&seen.map_or([0.0; 3], |n| rotate_back(pose.attitude, n)));
        }
    }

    fn show_colours(&mut self, pose: &Pose<f64>, context: &mut SensorContext<'_>, lost: SampleNoise, out: &mut [f64]) {
        let seen = context.image(&self.camera, pose);
        self.depth.copy_from_slice(seen.ranges);
        self.ids.copy_from_slice(seen.ids);
        for (i, colour) in out.chunks_exact_mut(3).enumerate() {
            let direction = self.camera.direction(i);
            let point = pose.point(direction.map(|d| f64::from(self.depth[i]) * d));
            let lit = match context.world().normal(self.ids[i], point) {
                None => shade::sky(pose.point(direction)[2] - pose.position[2], direction),
                Some(normal) => {
                    let dark = self.settings.shadows && shade::is_dark(context, &self.sun, point, normal);
                    shade::surface(context.world().owner(self.ids[i]), point, normal, dark)
                }
            };
            colour.copy_from_slice(&if is_lost(lost, i, self.settings.dropout) { [0.0; 3] } else { lit });
        }
    }
}

/// What stereo cannot see in a row, right of which places x − d(x) of the right imager are taken by what is nearer: it becomes
/// as far as nothing. `product` is f B in pixels of the row and metres.
fn hide_shadows(row: &mut [f32], product: f64, farthest: f64) {
    let mut taken = f64::INFINITY;
    for (x, z) in row.iter_mut().enumerate().rev() {
        let place = x as f64 - product / f64::from(*z).max(1e-9);
        if place < taken {
            taken = place;
        } else {
            *z = farthest as f32;
        }
    }
}

/// As [`ImageType::Segmentation`] says.
fn class_of(world: &RayScene, id: u32) -> f64 {
    match world.owner(id).filter(|_| id != NOTHING) {
        None => 0.0,
        Some(RayTarget::Scene(Element::Ground)) => 1.0,
        Some(RayTarget::Scene(Element::Gate(_))) => 2.0,
        Some(RayTarget::Scene(Element::Obstacle(_) | Element::Mesh(_))) => 3.0,
        Some(RayTarget::Moving(_)) => 4.0,
    }
}

impl Device for CameraDevice {
    fn draw(&mut self, _: &mut Stream) {}

    fn sample(&mut self, at: &Motion, context: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        let (pose, grain) =
            (Pose { position: at.position, attitude: at.attitude }, SampleNoise::new(stream.next_u64()));
        match self.settings.show {
            ImageType::Depth => self.show_depth(&pose, context, grain, out),
            ImageType::Segmentation => self.show_classes(&pose, context, grain.other(), out),
            ImageType::Normals => self.show_normals(&pose, context, grain.other(), out),
            ImageType::Rgb => self.show_colours(&pose, context, grain.other(), out),
        }
    }

    fn each(&mut self, _: &mut dyn FnMut(&mut f64)) {}
}
