//! Colours of what a camera sees: no photographs, but things that can be told apart.

use super::cast::{RayTarget, Rays};
use super::context::SensorContext;
use crate::scene::Element;
use crate::shape::Pose;
use crate::spatial::{Vec3, axpy, dot};

/// Towards the sun, unit, world.
pub(crate) const SUN: Vec3<f64> = [0.36, 0.48, 0.8];
/// Beyond this nothing throws a shadow, m.
pub(crate) const FAR: f64 = 1e3;
/// What light comes from all around.
const AMBIENT: f64 = 0.35;

/// Of the sky in a direction with this height over its length.
pub(crate) fn sky(rise: f64, direction: Vec3<f64>) -> [f64; 3] {
    let height = (rise / dot(direction, direction).sqrt()).clamp(0.0, 1.0);
    [0.78 - 0.45 * height, 0.86 - 0.28 * height, 0.95 - 0.05 * height]
}

/// Of a thing's surface at a point (world, m) with this normal: Lambert's law.
pub(crate) fn surface(owner: Option<RayTarget>, point: Vec3<f64>, normal: Vec3<f64>, dark: bool) -> [f64; 3] {
    let sun = if dark { 0.0 } else { dot(normal, SUN).max(0.0) };
    let light = AMBIENT + (1.0 - AMBIENT) * sun;
    colour(owner, point).map(|c| c * light)
}

/// Whether something stands between a point of a surface and the sun.
pub(crate) fn is_dark(context: &mut SensorContext<'_>, sun: &Rays, point: Vec3<f64>, normal: Vec3<f64>) -> bool {
    // f32 about the eye: a millimetre out of the surface is out of it
    let eye = Pose { position: axpy(point, 1e-3, normal), attitude: [1.0, 0.0, 0.0, 0.0] };
    f64::from(context.rays(sun, &eye).ranges[0]) < FAR
}

/// Ground is a chequered field of metres; other things have hues of their own, a golden angle apart.
fn colour(owner: Option<RayTarget>, point: Vec3<f64>) -> [f64; 3] {
    let (family, number) = match owner {
        None | Some(RayTarget::Scene(Element::Ground)) => {
            let odd = (point[0].floor() + point[1].floor()).rem_euclid(2.0) > 0.5;
            return if odd { [0.52, 0.55, 0.50] } else { [0.62, 0.65, 0.60] };
        }
        Some(RayTarget::Scene(Element::Gate(i))) => (0.05, i),
        Some(RayTarget::Scene(Element::Obstacle(i))) => (0.30, i),
        Some(RayTarget::Scene(Element::Mesh(i))) => (0.80, i),
        Some(RayTarget::Moving(i)) => (0.60, i as usize),
    };
    hue((family + 0.618_033_988_749_895 * number as f64).fract())
}

/// Of a colour circle within 0 … 1, of one brightness.
fn hue(h: f64) -> [f64; 3] {
    let wave = |shift: f64| 0.6 + 0.35 * (std::f64::consts::TAU * (h - shift)).cos();
    [wave(0.0), wave(1.0 / 3.0), wave(2.0 / 3.0)]
}
