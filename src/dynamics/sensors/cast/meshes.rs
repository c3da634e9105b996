//! Triangle meshes, put behind all that lanes have seen: ray by ray, in `f64`.

use super::cull::key;
use super::pattern::Pattern;
use super::pieces::seen;
use super::ray_scene::{self, LANES, Placed};
use super::{Eye, Tile, splat};
use autodiff::lanes::Lanes;

/// Below all readings of a mesh, from the ball around it; ∞ where the view does not reach that.
#[inline(always)]
pub(super) fn nearness<L: Lanes, V: Pattern, const ALL: bool>(pattern: &V, placed: &Placed, eye: &Eye) -> f32 {
    let (center, radius) = placed.mesh.ball();
    let none = [L::zero(); 3];
    // rounded up, with what its centre loses
    let rounding = 1.2e-7 * center.iter().map(|x| x.abs()).sum::<f64>();
    let radius = splat::<L>((radius + rounding) as f32 * 1.000_001 + f32::MIN_POSITIVE);
    let center = seen(eye, [splat(center[0] as f32), splat(center[1] as f32), splat(center[2] as f32)]);
    let mut lanes = [0.0; LANES];
    key::<L, V, ALL>(pattern, center, none, L::zero(), radius).store(&mut lanes);
    lanes[0]
}

/// Puts a mesh into all tiles whose farthest range is beyond `near`.
pub(super) fn put<V: Pattern, const ALL: bool>(pattern: &V, placed: &Placed, eye: &Eye, near: f32, tiles: &mut [Tile]) {
    let mesh = &placed.mesh;
    let origin = mesh.local_point(eye.position.map(f64::from));
    for (i, tile) in tiles.iter_mut().enumerate() {
        if !ALL && tile.range.iter().all(|range| *range <= near) {
            continue;
        }
        for lane in 0..LANES {
            let direction = mesh.local_direction(eye.outward(pattern.direction_of(i, lane)));
            let most = f64::from(tile.range[lane]);
            let met = if ALL { mesh.nearest_of_all(origin, direction) } else { mesh.nearest(origin, direction, most) };
            let Some((t, k)) = met.map(|(t, k)| (t as f32, k)).filter(|(t, _)| *t < tile.range[lane]) else { continue };
            tile.range[lane] = t;
            tile.id[lane] = ray_scene::number(placed.first + k);
        }
    }
}
