//! Claims about the caster, each with what was measured.

use super::normal::Slope;
use super::reference::{from_pose, gap, nearest};
use super::*;
use crate::autodiff::lanes::{Set, with_set};
use crate::dynamics::scene::{Element, Gate, Obstacle, Scene, Slide};
use crate::dynamics::shape::{Geometry, Shape};
use crate::dynamics::spatial::{add, exponential, from_euler, multiply, rotate, scale};
use crate::rng::{Purpose, Stream};

fn stream(which: u64) -> Stream {
    Stream::new(60, which, 0, Purpose::user(60))
}

fn vector(r: &mut Stream, low: [f64; 3], high: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| r.uniform(low[k], high[k]))
}

fn attitude(r: &mut Stream) -> [f64; 4] {
    unit([r.normal(), r.normal(), r.normal(), r.normal()])
}

/// 10 to the power of a uniform number.
fn decades(r: &mut Stream, low: f64, high: f64) -> f64 {
    10.0_f64.powf(r.uniform(low, high))
}

/// Up to forty capsules and balls, ten boxes, ground two times out of three.
fn any_world(r: &mut Stream) -> World {
    let mut world = World::default();
    if r.below(3) > 0 {
        world.fill(&Scene { ground: Some(r.uniform(-1.0, 0.5)), ..Scene::default() }, &[]).unwrap();
    }
    let room = decades(r, 0.0, 1.3);
    let at = |r: &mut Stream| vector(r, [-room, -room, -1.0], [room, room, 5.0]);
    for owner in 0..r.below(40) as u32 {
        let (a, length) = (at(r), if r.below(4) == 0 { 0.0 } else { decades(r, -1.0, 1.0) });
        let b = add(a, rotate(attitude(r), [0.0, 0.0, length]));
        let b = if r.below(4) == 0 { [a[0], a[1], a[2] + length] } else { b };
        world.push_capsule([a, b], decades(r, -2.0, 0.3), owner).unwrap();
    }
    for owner in 0..r.below(10) as u32 {
        let pose = Pose { position: at(r), attitude: attitude(r) };
        let size = [0, 1, 2].map(|_| decades(r, -1.3, 0.5));
        world.push_box(&pose, size, owner).unwrap();
    }
    world
}

/// Anywhere, or on, in and beside a surface.
fn any_eye(r: &mut Stream, world: &World) -> Pose<f64> {
    let mut position = vector(r, [-6.0, -6.0, -0.5], [6.0, 6.0, 4.0]);
    if r.below(3) == 0 {
        let d = rotate(attitude(r), [1.0, 0.0, 0.0]);
        let (t, _) = nearest(world, position, d);
        if t.is_finite() {
            let beside = decades(r, -8.0, 0.0) * [1.0, -1.0, 0.0][r.below(3) as usize];
            position = add(position, scale(t + beside, d));
        }
    }
    let level = from_euler(0.1 * r.normal(), 0.1 * r.normal(), r.uniform(-3.2, 3.2));
    Pose { position, attitude: if r.below(2) == 0 { level } else { attitude(r) } }
}

fn any_range(r: &mut Stream) -> Range {
    Range { least: if r.below(2) == 0 { 0.0 } else { r.uniform(0.0, 0.4) }, most: decades(r, 0.3, 1.7) }
}

fn any_camera(r: &mut Stream, largest: u64) -> Camera {
    let (width, height) = (1 + r.below(largest) as usize, 1 + r.below(largest) as usize);
    let flat = (height as f64 / width as f64).clamp(0.2, 5.0);
    Camera::new(width, height, 2.0 * (r.uniform(0.1, 3.0) / flat.max(1.0)).atan(), any_range(r))
        .unwrap_or_else(|_| Camera::new(width.max(4), 4, 1.2, any_range(r)).unwrap())
}

/// All around, within a narrow fan, or a lidar.
fn any_rays(r: &mut Stream) -> Rays {
    let range = any_range(r);
    let (n, spread) = (1 + r.below(100), decades(r, -2.0, 1.0));
    match r.below(3) {
        0 => Rays::lidar(n as usize, &[-0.2, 0.0, 0.3, 0.6], range),
        _ => {
            let aim = attitude(r);
            let one = |r: &mut Stream| rotate(aim, [1.0, spread * r.normal(), spread * r.normal()]);
            let directions: Vec<_> = (0..n).map(|_| one(r)).collect();
            Rays::new(&directions, range)
        }
    }
    .unwrap()
}

/// Bits of what an image or a scan holds.
#[derive(Debug, PartialEq)]
struct Seen {
    t: Vec<u32>,
    ids: Vec<u32>,
}

type Draw = fn(&mut Caster, &World, &Camera, &Pose<f64>, &mut [f32], &mut [u32]);
type Scan = fn(&mut Caster, &World, &Rays, &Pose<f64>, &mut [f32], &mut [u32]);

fn image(caster: &mut Caster, draw: Draw, world: &World, camera: &Camera, pose: &Pose<f64>) -> Seen {
    let n = camera.size()[0] * camera.size()[1];
    let (mut t, mut ids) = (vec![-1.0; n], vec![u32::MAX; n]);
    draw(caster, world, camera, pose, &mut t, &mut ids);
    Seen { t: t.into_iter().map(f32::to_bits).collect(), ids }
}

fn scan(caster: &mut Caster, scan: Scan, world: &World, rays: &Rays, pose: &Pose<f64>) -> Seen {
    let (mut t, mut ids) = (vec![-1.0; rays.n_ray()], vec![u32::MAX; rays.n_ray()]);
    scan(caster, world, rays, pose, &mut t, &mut ids);
    Seen { t: t.into_iter().map(f32::to_bits).collect(), ids }
}

#[test]
fn an_image_is_that_of_all_solids_at_all_pixels_bit_for_bit() {
    let mut caster = Caster::new();
    let (mut hits, mut pixels) = (0, 0);
    for which in 0..if cfg!(miri) { 2 } else { 10_000 } {
        let mut r = stream(which);
        let world = any_world(&mut r);
        let (pose, camera) = (any_eye(&mut r, &world), any_camera(&mut r, 40));
        let want = image(&mut caster, Caster::image_of_all, &world, &camera, &pose);
        let have = image(&mut caster, Caster::image, &world, &camera, &pose);
        let wrong = (0..have.ids.len()).filter(|i| have.ids[*i] != want.ids[*i] || have.t[*i] != want.t[*i]);
        let wrong: Vec<_> = wrong.map(|i| (i, have.ids[i], want.ids[i], f32::from_bits(want.t[i]))).collect();
        assert!(wrong.is_empty(), "scene {which}, {:?}: {wrong:?}", camera.size());
        hits += want.ids.iter().filter(|id| **id > GROUND).count();
        pixels += want.ids.len();
    }
    println!("{hits} of {pixels} pixels see a solid");
    assert!(hits > pixels / 20 && hits < pixels, "{hits} of {pixels}");
}

#[test]
fn a_scan_is_that_of_all_solids_on_all_rays_bit_for_bit() {
    let mut caster = Caster::new();
    let (mut hits, mut all) = (0, 0);
    for which in 0..if cfg!(miri) { 2 } else { 10_000 } {
        let mut r = stream(20_000 + which);
        let world = any_world(&mut r);
        let (pose, rays) = (any_eye(&mut r, &world), any_rays(&mut r));
        let want = scan(&mut caster, Caster::rays_of_all, &world, &rays, &pose);
        let have = scan(&mut caster, Caster::rays, &world, &rays, &pose);
        assert_eq!(have, want, "scene {which}");
        hits += want.ids.iter().filter(|id| **id > GROUND).count();
        all += want.ids.len();
    }
    println!("{hits} of {all} rays meet a solid");
    assert!(hits > all / 40, "{hits} of {all}");
}

#[test]
fn images_and_scans_are_the_same_bits_with_every_instruction_set() {
    let mut caster = Caster::new();
    for which in 0..if cfg!(miri) { 1 } else { 500 } {
        let mut r = stream(40_000 + which);
        let world = any_world(&mut r);
        let pose = any_eye(&mut r, &world);
        let (camera, rays) = (any_camera(&mut r, 40), any_rays(&mut r));
        let mut all = [Set::Avx512, Set::Avx2, Set::OneLane].into_iter().filter(|set| set.is_here()).map(|set| {
            with_set(set, || {
                (
                    image(&mut caster, Caster::image, &world, &camera, &pose),
                    scan(&mut caster, Caster::rays, &world, &rays, &pose),
                )
            })
        });
        let first = all.next().unwrap();
        for other in all {
            assert_eq!(first, other, "scene {which}");
        }
    }
}

/// Shares of readings that differ from the reference by more than 10⁻³ (1 + t), and the largest difference of the others.
#[derive(Debug, Default)]
struct Compared {
    readings: usize,
    apart: usize,
    worst: f64,
    ids: usize,
}

impl Compared {
    fn add(&mut self, range: Range, (want, want_id): (f64, u32), have: f32, id: u32) {
        let sees = (range.least..range.most).contains(&want);
        let (want, want_id) = if sees { (want, want_id) } else { (range.most, NOTHING) };
        self.readings += 1;
        let error = (f64::from(have) - want).abs() / (1.0 + want);
        if error > 1e-3 {
            self.apart += 1;
        } else {
            self.worst = self.worst.max(error);
            self.ids += usize::from(id != want_id);
        }
    }
}

#[test]
fn depths_ranges_and_ids_are_those_of_f64_but_on_silhouettes() {
    let (mut caster, mut of_images, mut of_scans) = (Caster::new(), Compared::default(), Compared::default());
    for which in 0..if cfg!(miri) { 1 } else { 1_500 } {
        let mut r = stream(60_000 + which);
        let world = any_world(&mut r);
        let pose = any_eye(&mut r, &world);
        let (camera, rays) = (any_camera(&mut r, 40), any_rays(&mut r));
        // whether the eye is in a solid is decided in f32
        if gap(&world, pose.position) < 1e-3 {
            continue;
        }
        let n = camera.size()[0] * camera.size()[1];
        let (mut t, mut ids) = (vec![0.0; n.max(rays.n_ray())], vec![0; n.max(rays.n_ray())]);
        caster.image(&world, &camera, &pose, &mut t[..n], &mut ids[..n]);
        for i in 0..n {
            of_images.add(camera.range(), from_pose(&world, &pose, camera.direction(i)), t[i], ids[i]);
        }
        let n = rays.n_ray();
        caster.rays(&world, &rays, &pose, &mut t[..n], &mut ids[..n]);
        for i in 0..n {
            of_scans.add(rays.range(), from_pose(&world, &pose, rays.direction(i)), t[i], ids[i]);
        }
    }
    println!("{of_images:?} {of_scans:?}");
    for all in [of_images, of_scans] {
        let share = all.apart as f64 / all.readings as f64;
        assert!(share < 1e-4, "{share:e}");
        assert!((all.ids as f64) < 1e-4 * all.readings as f64, "{} ids", all.ids);
    }
}

fn forest(r: &mut Stream, side: f64, n: usize) -> World {
    let mut scene = Scene::grounded();
    for i in 0..n + n / 10 {
        let at = vector(r, [-0.5 * side, -0.5 * side, 0.0], [0.5 * side, 0.5 * side, 0.0]);
        let shape = if i < n {
            let (radius, length) = (r.uniform(0.1, 0.3), r.uniform(2.0, 4.0));
            let lean = from_euler(0.1 * r.normal(), 0.1 * r.normal(), 0.0);
            Shape::new(Geometry::Capsule { radius, length }).at(add(at, [0.0, 0.0, 0.5 * length])).turned(lean)
        } else {
            let size = vector(r, [0.5; 3], [1.5; 3]);
            Shape::new(Geometry::Box { size }).at(add(at, [0.0, 0.0, 0.5])).turned(attitude(r))
        };
        scene.obstacles.push(Obstacle { name: format!("{i}"), shape });
    }
    let mut world = World::default();
    world.fill(&scene, &scene.nominal_placement()).unwrap();
    world
}

/// Frames and scans per second of one core: `cargo test --release -- --ignored --nocapture casts_per_second`.
#[test]
#[ignore = "a measurement"]
fn casts_per_second() {
    for (name, side) in [("dense, 20 m", 20.0), ("sparse, 40 m", 40.0)] {
        let mut r = stream(1);
        let world = forest(&mut r, side, 100);
        let poses: Vec<_> = (0..64)
            .map(|_| {
                loop {
                    let position = vector(&mut r, [-0.3 * side, -0.3 * side, 1.0], [0.3 * side, 0.3 * side, 2.0]);
                    let attitude = from_euler(0.1 * r.normal(), 0.1 * r.normal(), r.uniform(-3.1, 3.1));
                    if gap(&world, position) > 0.3 {
                        return Pose { position, attitude };
                    }
                }
            })
            .collect();
        for set in [Set::Avx512, Set::Avx2].into_iter().filter(|set| set.is_here()) {
            for most in [10.0, 20.0] {
                let camera = Camera::new(64, 48, 1.57, Range { least: 0.0, most }).unwrap();
                let (mut depth, mut ids) = (vec![0.0; 64 * 48], vec![0; 64 * 48]);
                let mut caster = Caster::new();
                let mut covered = 0;
                let time = best(|| {
                    with_set(set, || {
                        covered = 0;
                        for pose in &poses {
                            caster.image(&world, &camera, pose, &mut depth, &mut ids);
                        }
                    });
                }) / poses.len() as f64;
                for pose in &poses {
                    caster.image(&world, &camera, pose, &mut depth, &mut ids);
                    covered += ids.iter().filter(|id| **id > GROUND).count();
                }
                let share = covered as f64 / (64.0 * 48.0 * poses.len() as f64);
                println!(
                    "{name}, to {most} m, {set:?}: image {:.1} µs, {:.1} k/s, {:.0} % covered",
                    time * 1e6,
                    1e-3 / time,
                    100.0 * share
                );
            }
            let rays = Rays::lidar(36, &[-0.17, 0.0, 0.17, 0.35], Range { least: 0.0, most: 4.0 }).unwrap();
            let (mut ranges, mut ids) = (vec![0.0; 144], vec![0; 144]);
            let mut caster = Caster::new();
            let time = best(|| {
                with_set(set, || {
                    for pose in &poses {
                        caster.rays(&world, &rays, pose, &mut ranges, &mut ids);
                    }
                });
            }) / poses.len() as f64;
            println!("{name}, {set:?}: lidar {:.2} µs, {:.2} M/s", time * 1e6, 1e-6 / time);
        }
    }
}

fn best(mut work: impl FnMut()) -> f64 {
    let mut least = f64::INFINITY;
    for _ in 0..200 {
        let start = std::time::Instant::now();
        work();
        least = least.min(start.elapsed().as_secs_f64());
    }
    least
}
