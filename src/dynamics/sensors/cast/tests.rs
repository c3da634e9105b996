//! Claims about the caster, each with what was measured.

use super::normal::RangeJacobian;
use super::reference::{from_pose, gap, nearest};
use super::*;
use crate::scene::{Element, Gate, GateSlide, Obstacle, Scene};
use crate::shape::{Geometry, Shape};
use crate::spatial::{add, exponential, from_euler, multiply, rotate, scale};
use autodiff::lanes::{InstructionSet, with_set};
use rng::{Purpose, Stream};

pub(super) fn stream(which: u64) -> Stream {
    Stream::new(60, which, 0, Purpose::user(60))
}

pub(super) fn vector(r: &mut Stream, low: [f64; 3], high: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| r.uniform(low[k], high[k]))
}

pub(super) fn attitude(r: &mut Stream) -> [f64; 4] {
    unit([r.normal(), r.normal(), r.normal(), r.normal()])
}

/// 10 to the power of a uniform number.
pub(super) fn decades(r: &mut Stream, low: f64, high: f64) -> f64 {
    10.0_f64.powf(r.uniform(low, high))
}

/// Up to forty capsules and balls, ten boxes, ground two times out of three.
fn any_world(r: &mut Stream) -> RayScene {
    let mut world = RayScene::default();
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
fn any_eye(r: &mut Stream, world: &RayScene) -> Pose<f64> {
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

fn any_range(r: &mut Stream) -> RangeLimits {
    RangeLimits { least: if r.below(2) == 0 { 0.0 } else { r.uniform(0.0, 0.4) }, most: decades(r, 0.3, 1.7) }
}

pub(super) fn any_camera(r: &mut Stream, largest: u64) -> PinholeCamera {
    let (width, height) = (1 + r.below(largest) as usize, 1 + r.below(largest) as usize);
    let flat = (height as f64 / width as f64).clamp(0.2, 5.0);
    PinholeCamera::new(width, height, 2.0 * (r.uniform(0.1, 3.0) / flat.max(1.0)).atan(), any_range(r))
        .unwrap_or_else(|_| PinholeCamera::new(width.max(4), 4, 1.2, any_range(r)).unwrap())
}

/// All around, within a narrow fan, or a lidar.
pub(super) fn any_rays(r: &mut Stream) -> Rays {
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
pub(super) struct Seen {
    pub t: Vec<u32>,
    pub ids: Vec<u32>,
}

pub(super) type Draw = fn(&mut RayCaster, &RayScene, &PinholeCamera, &Pose<f64>, &mut [f32], &mut [u32]);
pub(super) type Scan = fn(&mut RayCaster, &RayScene, &Rays, &Pose<f64>, &mut [f32], &mut [u32]);

pub(super) fn image(
    caster: &mut RayCaster,
    draw: Draw,
    world: &RayScene,
    camera: &PinholeCamera,
    pose: &Pose<f64>,
) -> Seen {
    let n = camera.size()[0] * camera.size()[1];
    let (mut t, mut ids) = (vec![-1.0; n], vec![u32::MAX; n]);
    draw(caster, world, camera, pose, &mut t, &mut ids);
    Seen { t: t.into_iter().map(f32::to_bits).collect(), ids }
}

pub(super) fn scan(caster: &mut RayCaster, scan: Scan, world: &RayScene, rays: &Rays, pose: &Pose<f64>) -> Seen {
    let (mut t, mut ids) = (vec![-1.0; rays.n_ray()], vec![u32::MAX; rays.n_ray()]);
    scan(caster, world, rays, pose, &mut t, &mut ids);
    Seen { t: t.into_iter().map(f32::to_bits).collect(), ids }
}

#[test]
fn an_image_is_that_of_all_solids_at_all_pixels_bit_for_bit() {
    let mut caster = RayCaster::new();
    let (mut hits, mut pixels) = (0, 0);
    for which in 0..if cfg!(miri) { 2 } else { 10_000 } {
        let mut r = stream(which);
        let world = any_world(&mut r);
        let (pose, camera) = (any_eye(&mut r, &world), any_camera(&mut r, 40));
        let want = image(&mut caster, RayCaster::image_of_all, &world, &camera, &pose);
        let have = image(&mut caster, RayCaster::image, &world, &camera, &pose);
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
    let mut caster = RayCaster::new();
    let (mut hits, mut all) = (0, 0);
    for which in 0..if cfg!(miri) { 2 } else { 10_000 } {
        let mut r = stream(20_000 + which);
        let world = any_world(&mut r);
        let (pose, rays) = (any_eye(&mut r, &world), any_rays(&mut r));
        let want = scan(&mut caster, RayCaster::rays_of_all, &world, &rays, &pose);
        let have = scan(&mut caster, RayCaster::rays, &world, &rays, &pose);
        assert_eq!(have, want, "scene {which}");
        hits += want.ids.iter().filter(|id| **id > GROUND).count();
        all += want.ids.len();
    }
    println!("{hits} of {all} rays meet a solid");
    assert!(hits > all / 40, "{hits} of {all}");
}

#[test]
fn images_and_scans_are_the_same_bits_with_every_instruction_set() {
    let mut caster = RayCaster::new();
    for which in 0..if cfg!(miri) { 1 } else { 500 } {
        let mut r = stream(40_000 + which);
        let world = any_world(&mut r);
        let pose = any_eye(&mut r, &world);
        let (camera, rays) = (any_camera(&mut r, 40), any_rays(&mut r));
        let mut all = [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane]
            .into_iter()
            .filter(|set| set.is_here())
            .map(|set| {
                with_set(set, || {
                    (
                        image(&mut caster, RayCaster::image, &world, &camera, &pose),
                        scan(&mut caster, RayCaster::rays, &world, &rays, &pose),
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
    fn add(&mut self, range: RangeLimits, (want, want_id): (f64, u32), have: f32, id: u32) {
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
    let (mut caster, mut of_images, mut of_scans) = (RayCaster::new(), Compared::default(), Compared::default());
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

/// Gates, one of them sliding, and obstacles of every kind above the ground, none touching another.
fn furnished(r: &mut Stream) -> (Scene, Vec<f64>) {
    let mut scene = Scene::grounded();
    let mut place = |x: i32, y: i32| {
        vector(&mut *r, [-0.3, -0.3, 1.6], [0.3, 0.3, 2.4])
            .into_iter()
            .zip([4.0 * f64::from(x), 4.0 * f64::from(y), 0.0])
            .map(|(a, b)| a + b)
            .collect::<Vec<_>>()
    };
    let mut spots = Vec::new();
    for x in -2..=2 {
        for y in -2..=2 {
            let p = place(x, y);
            spots.push([p[0], p[1], p[2]]);
        }
    }
    for (i, position) in spots.into_iter().enumerate() {
        let rotation = attitude(r);
        let name = format!("{i}");
        let geometry = match i % 5 {
            0 => Geometry::Sphere { radius: r.uniform(0.1, 0.8) },
            1 => Geometry::Capsule { radius: r.uniform(0.05, 0.3), length: r.uniform(0.1, 1.0) },
            2 => Geometry::Box { size: vector(r, [0.1; 3], [0.8; 3]) },
            3 => {
                scene.gates.push(Gate { name, position, rotation, ..Gate::default() });
                continue;
            }
            _ => {
                scene.gates.push(Gate {
                    name,
                    position,
                    rotation,
                    slide: Some(GateSlide::default()),
                    ..Gate::default()
                });
                continue;
            }
        };
        scene.obstacles.push(Obstacle { name, shape: Shape::new(geometry).at(position).turned(rotation) });
    }
    scene.validate().unwrap();
    let placement = (0..scene.n_placement()).map(|_| r.uniform(-0.1, 0.1)).collect();
    (scene, placement)
}

#[test]
fn a_hit_lies_on_the_scenes_own_surface_and_names_what_owns_it() {
    let (mut caster, mut world) = (RayCaster::new(), RayScene::default());
    let (mut worst, mut hits, mut met) = (0.0_f64, 0, std::collections::HashSet::new());
    for which in 0..if cfg!(miri) { 1 } else { 100 } {
        let mut r = stream(80_000 + which);
        let (scene, placement) = furnished(&mut r);
        world.fill(&scene, &placement).unwrap();
        let mut position = vector(&mut r, [-8.0, -8.0, 0.3], [8.0, 8.0, 3.0]);
        while scene.distance(&placement, position) < 0.05 {
            position = vector(&mut r, [-8.0, -8.0, 0.3], [8.0, 8.0, 3.0]);
        }
        let pose = Pose { position, attitude: from_euler(0.2 * r.normal(), 0.2 * r.normal(), r.uniform(-3.1, 3.1)) };
        let range = RangeLimits { least: 0.0, most: 30.0 };
        let camera = PinholeCamera::new(48, 32, 1.5, range).unwrap();
        let (mut t, mut ids) = (vec![0.0; 48 * 32], vec![0; 48 * 32]);
        caster.image(&world, &camera, &pose, &mut t, &mut ids);
        for i in 0..t.len() {
            let Some(owner) = world.owner(ids[i]) else {
                assert_eq!((ids[i], t[i]), (NOTHING, 30.0));
                continue;
            };
            let depth = f64::from(t[i]);
            let point = pose.point(scale(depth, camera.direction(i)));
            let (element, distance) = scene.nearest(&placement, point).unwrap();
            worst = worst.max(distance.abs() / (1.0 + depth));
            assert_eq!(owner, RayTarget::Scene(element), "scene {which}, pixel {i} at {depth} m");
            met.insert(std::mem::discriminant(&element));
            hits += usize::from(element != Element::Ground);
        }
    }
    println!("{hits} pixels on solids, off their surface by {worst:.1e} (1 + t) m");
    assert!(worst < 1e-4, "{worst:e}"); // measured 4.5e-7
    assert!(cfg!(miri) || (hits > 5_000 && met.len() == 3), "{hits} hits");
}

/// As the slope, by differences of the reference of fourth order; `None` where a silhouette is near.
fn differences(
    world: &RayScene,
    id: u32,
    direction: [f64; 3],
    mount: &Pose<f64>,
    body: &Pose<f64>,
) -> Option<RangeJacobian> {
    const STEP: f64 = 1e-6;
    let at = |axis: usize, step: f64| {
        let (mut moved, mut change) = (*body, [0.0; 3]);
        change[axis % 3] = step;
        if axis < 3 {
            moved.position = add(body.position, change);
        } else {
            moved.attitude = multiply(body.attitude, exponential(change));
        }
        let (t, found) = from_pose(world, &moved.then(mount), direction);
        (found == id).then_some(t)
    };
    let mut slope = [0.0; 6];
    for (axis, slope) in slope.iter_mut().enumerate() {
        let one = at(axis, STEP)? - at(axis, -STEP)?;
        let two = at(axis, 2.0 * STEP)? - at(axis, -2.0 * STEP)?;
        *slope = (8.0 * one - two) / (12.0 * STEP);
    }
    let [a, b, c, d, e, f] = slope;
    Some(RangeJacobian { position: [a, b, c], attitude: [d, e, f] })
}

fn apart(a: &RangeJacobian, b: &RangeJacobian) -> f64 {
    let all = |s: &RangeJacobian| [s.position, s.attitude].concat();
    all(a).iter().zip(all(b)).map(|(a, b)| (a - b).abs() / (1.0 + b.abs())).fold(0.0, f64::max)
}

#[test]
fn slopes_in_the_pose_are_those_of_differences_off_silhouettes() {
    let (mut caster, mut exact, mut cast, mut compared) = (RayCaster::new(), 0.0_f64, 0.0_f64, 0);
    for which in 0..if cfg!(miri) { 1 } else { 150 } {
        let mut r = stream(90_000 + which);
        let (scene, placement) = furnished(&mut r);
        let mut world = RayScene::default();
        world.fill(&scene, &placement).unwrap();
        let body = Pose { position: vector(&mut r, [-8.0, -8.0, 0.5], [8.0, 8.0, 3.0]), attitude: attitude(&mut r) };
        let mount = Pose { position: vector(&mut r, [-0.2; 3], [0.2; 3]), attitude: attitude(&mut r) };
        if gap(&world, body.then(&mount).position) < 0.1 {
            continue;
        }
        let camera = PinholeCamera::new(16, 12, 1.2, RangeLimits { least: 0.0, most: 30.0 }).unwrap();
        let (mut t, mut ids) = (vec![0.0; 192], vec![0; 192]);
        caster.image(&world, &camera, &body.then(&mount), &mut t, &mut ids);
        for i in 0..t.len() {
            let direction = camera.direction(i);
            let (depth, id) = from_pose(&world, &body.then(&mount), direction);
            let d = rotate(body.attitude, rotate(mount.attitude, direction));
            let Some(n) = world.normal(id, add(body.then(&mount).position, scale(depth, d))) else { continue };
            let facing = -crate::spatial::dot(n, d) / crate::spatial::dot(d, d).sqrt();
            if depth > 15.0 || facing < 0.25 || ids[i] != id {
                continue;
            }
            let Some(want) = differences(&world, id, direction, &mount, &body) else { continue };
            exact = exact.max(apart(&world.slope(id, depth, direction, &mount, &body), &want));
            cast = cast.max(apart(&world.slope(id, f64::from(t[i]), direction, &mount, &body), &want));
            compared += 1;
        }
    }
    println!("{compared} slopes: of f64 ranges {exact:.1e}, of the caster's {cast:.1e}");
    assert!(exact < 1e-6, "{exact:e}"); // measured 7.3e-9
    assert!(cast < 1e-2, "{cast:e}"); // measured 1.9e-4: the normal of a bar of 4 cm turns with 1e-6 m
    assert!(cfg!(miri) || compared > 1_000, "{compared}");
}

#[test]
fn a_grazing_ray_has_a_bounded_slope_and_a_miss_none() {
    let mut world = RayScene::default();
    world.fill(&Scene::grounded(), &[]).unwrap();
    let body = Pose { position: [0.0, 0.0, 1.0], attitude: [1.0, 0.0, 0.0, 0.0] };
    let mount = Pose { position: [0.0; 3], attitude: [1.0, 0.0, 0.0, 0.0] };
    // −n/(n·d) with n·d = −0.01 would be 100
    let d = [(1.0_f64 - 1e-4).sqrt(), 0.0, -0.01];
    let slope = world.slope(GROUND, 100.0, d, &mount, &body);
    assert!((slope.position[2] - 10.0).abs() < 1e-9, "{slope:?}");
    assert_eq!(world.slope(NOTHING, 30.0, d, &mount, &body), RangeJacobian::default());
    assert_eq!(world.slope(12, 30.0, d, &mount, &body), RangeJacobian::default());
    assert_eq!(world.slope(GROUND, f64::NAN, d, &mount, &body), RangeJacobian::default());
    // straight down: a metre up is a metre more
    let down = world.slope(GROUND, 1.0, [0.0, 0.0, -1.0], &mount, &body);
    assert_eq!(down, RangeJacobian { position: [0.0, 0.0, 1.0], attitude: [0.0; 3] });
}

#[test]
fn readings_begin_at_the_least_range_and_what_is_nearer_hides_what_is_behind() {
    let mut world = RayScene::default();
    let (near, far) = ([[1.0, 0.0, 0.0]; 2], [[5.0, 0.0, 0.0]; 2]);
    let ids = [world.push_capsule(near, 0.1, 0).unwrap(), world.push_capsule(far, 0.5, 1).unwrap()];
    let pose = Pose { position: [0.0; 3], attitude: [1.0, 0.0, 0.0, 0.0] };
    let mut caster = RayCaster::new();
    let mut look = |least, most| {
        let (mut t, mut id) = ([0.0], [9]);
        let rays = Rays::new(&[[2.0, 0.0, 0.0]], RangeLimits { least, most }).unwrap();
        caster.rays(&world, &rays, &pose, &mut t, &mut id);
        let of_ray = (t[0], id[0]);
        let camera = PinholeCamera::new(1, 1, 0.5, RangeLimits { least, most }).unwrap();
        caster.image(&world, &camera, &pose, &mut t, &mut id);
        assert_eq!(of_ray, (t[0], id[0]), "one pixel looks ahead");
        of_ray
    };
    assert_eq!(look(0.0, 10.0), (0.9, ids[0]));
    assert_eq!(look(0.95, 10.0), (10.0, NOTHING));
    assert_eq!(look(0.0, 0.5), (0.5, NOTHING));
    let beside = Pose { position: [1.0, 0.05, 0.0], ..pose };
    let (mut t, mut id) = ([0.0], [9]);
    let rays = Rays::new(&[[1.0, 0.0, 0.0]], RangeLimits { least: 0.0, most: 10.0 }).unwrap();
    caster.rays(&world, &rays, &beside, &mut t, &mut id);
    assert_eq!(id[0], ids[1], "from inside a ball it is not seen");
}

#[test]
fn what_moves_is_taken_away_and_the_scene_stays() {
    let mut r = stream(3);
    let (scene, placement) = furnished(&mut r);
    let mut world = RayScene::default();
    world.fill(&scene, &placement).unwrap();
    let n = world.n_solid();
    assert_eq!(n, 4 * scene.gates.len() + scene.obstacles.len());
    let pose = Pose { position: [0.0, 0.0, 1.0], attitude: [1.0, 0.0, 0.0, 0.0] };
    let camera = PinholeCamera::new(32, 24, 1.2, RangeLimits { least: 0.0, most: 20.0 }).unwrap();
    let mut caster = RayCaster::new();
    let before = image(&mut caster, RayCaster::image, &world, &camera, &pose);
    for round in 0..3 {
        let ball =
            world.push(&Geometry::Sphere { radius: 0.3 }, &Pose { position: [1.0, 0.0, 1.0], ..pose }, 5).unwrap();
        let block = world.push_box(&Pose { position: [1.0, 0.5, 1.0], ..pose }, [0.2; 3], 6 + round).unwrap();
        assert_eq!(
            (world.owner(ball), world.owner(block)),
            (Some(RayTarget::Moving(5)), Some(RayTarget::Moving(6 + round)))
        );
        let during = image(&mut caster, RayCaster::image, &world, &camera, &pose);
        assert!(during.ids.contains(&ball) && during.ids.contains(&block));
        world.clear_moving();
        assert_eq!((world.owner(ball), world.owner(block), world.n_solid()), (None, None, n));
        assert_eq!(image(&mut caster, RayCaster::image, &world, &camera, &pose), before);
    }
    world.fill(&Scene::default(), &[]).unwrap();
    assert_eq!((world.n_solid(), world.owner(GROUND)), (0, None));
}

#[test]
fn what_was_cast_once_is_cast_again_without_allocation() {
    let mut r = stream(4);
    let (scene, placement) = furnished(&mut r);
    let (mut world, mut caster) = (RayScene::default(), RayCaster::new());
    world.fill(&scene, &placement).unwrap();
    let range = RangeLimits { least: 0.2, most: 20.0 };
    let camera = PinholeCamera::new(40, 30, 1.2, range).unwrap();
    let mut rays = Rays::lidar(36, &[-0.2, 0.0, 0.2, 0.4], range).unwrap();
    // from far above nothing is seen: room is made for all that there is
    let above = Pose { position: [0.0, 0.0, 500.0], attitude: [1.0, 0.0, 0.0, 0.0] };
    image(&mut caster, RayCaster::image, &world, &camera, &above);
    scan(&mut caster, RayCaster::rays, &world, &rays, &above);
    let room = |caster: &RayCaster, world: &RayScene, rays: &Rays| {
        (caster.kept.room(), caster.tiles.capacity(), caster.far.capacity(), world.room(), rays.room())
    };
    let before = room(&caster, &world, &rays);
    for _ in 0..100 {
        world.fill(&scene, &placement).unwrap();
        let pose = any_eye(&mut r, &world);
        image(&mut caster, RayCaster::image, &world, &camera, &pose);
        scan(&mut caster, RayCaster::rays, &world, &rays, &pose);
        let directions: Vec<_> = (0..144).map(|_| rotate(attitude(&mut r), [1.0, 0.0, 0.0])).collect();
        rays.aim(&directions).unwrap();
    }
    assert_eq!(room(&caster, &world, &rays), before);
}

#[test]
fn numbers_that_are_none_are_misses_and_never_panic() {
    let bad =
        [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 1e20, 1e7, 0.0, -0.0, 1e-300, 1e-30, -1.0, 1.0];
    let (mut caster, mut missed) = (RayCaster::new(), 0);
    for which in 0..if cfg!(miri) { 3 } else { 3_000 } {
        let mut r = stream(100_000 + which);
        let any = |r: &mut Stream| bad[r.below(bad.len() as u64) as usize];
        let mut world = RayScene::default();
        world.fill(&Scene { ground: Some(any(&mut r)), ..Scene::default() }, &[]).unwrap();
        for owner in 0..20 {
            let mut three = || [any(&mut r), any(&mut r), any(&mut r)];
            let (a, b, size) = (three(), three(), three());
            world.push_capsule([a, b], size[0], owner).unwrap();
            let pose = Pose { position: a, attitude: [b[0], b[1], b[2], size[0]] };
            world.push_box(&pose, size, owner).unwrap();
        }
        let mut three = || [any(&mut r), any(&mut r), any(&mut r)];
        let (position, v) = (three(), three());
        let pose = Pose { position, attitude: [v[0], v[1], v[2], any(&mut r)] };
        let sound = position.iter().chain(&pose.attitude).all(|x| x.is_finite());
        let (camera, rays) = (any_camera(&mut r, 20), any_rays(&mut r));
        let all = [
            (image(&mut caster, RayCaster::image, &world, &camera, &pose), camera.range()),
            (scan(&mut caster, RayCaster::rays, &world, &rays, &pose), rays.range()),
        ];
        for (seen, range) in all {
            for (t, id) in seen.t.iter().zip(&seen.ids) {
                let t = f32::from_bits(*t);
                assert!(t >= 0.0 && t <= range.most as f32, "{t}");
                assert!(*id == NOTHING || (sound && world.owner(*id).is_some()), "{id} from {pose:?}");
                missed += usize::from(*id == NOTHING);
            }
        }
        let want = image(&mut caster, RayCaster::image_of_all, &world, &camera, &pose);
        assert_eq!(want, image(&mut caster, RayCaster::image, &world, &camera, &pose), "scene {which}");
    }
    assert!(missed > 0);
}

#[test]
fn limits_name_value_limit_and_remedy() {
    let range = RangeLimits { least: 0.0, most: 10.0 };
    for (error, start) in [
        (PinholeCamera::new(0, 48, 1.5, range).unwrap_err(), "camera: pixels is 0, below the limit of 1 to 4194304."),
        (PinholeCamera::new(1 << 40, 1 << 40, 1.5, range).unwrap_err(), "camera: pixels is 1"),
        (
            PinholeCamera::new(64, 48, 3.2, range).unwrap_err(),
            "camera: field_of_view is 3.2, but it must be within 0.001",
        ),
        (PinholeCamera::new(64, 48, f64::NAN, range).unwrap_err(), "camera: field_of_view is NaN"),
        (PinholeCamera::new(1, 64, 1.5, range).unwrap_err(), "camera: field_of_view is 1.5"),
        (
            PinholeCamera::new(64, 48, 1.5, RangeLimits { least: 1.0, most: 1.0 }).unwrap_err(),
            "camera: range is 1 to 1",
        ),
        (Rays::new(&[], range).unwrap_err(), "rays: number of directions is 0, below the limit"),
        (Rays::new(&[[0.0; 3]], range).unwrap_err(), "rays: length of direction 0 is 0"),
        (Rays::new(&[[1.0, f64::NAN, 0.0]], range).unwrap_err(), "rays: direction 0[1] is NaN"),
        (Rays::lidar(usize::MAX, &[0.0; 2], range).unwrap_err(), "rays: number of directions is 1"),
        (Rays::new(&[[1.0; 3]], RangeLimits { least: 0.0, most: 1e5 }).unwrap_err(), "rays: range is 0 to 100000"),
    ] {
        let text = error.to_string();
        assert!(text.starts_with(start), "{text}");
        assert!(error.is_limit() || error.is_value(), "{text}");
    }
    let mut world = RayScene::default();
    for _ in 0..ray_scene::MAX_SOLIDS {
        world.push_capsule([[0.0; 3]; 2], 1.0, 0).unwrap();
    }
    let error = world.push_capsule([[0.0; 3]; 2], 1.0, 0).unwrap_err();
    assert!(error.is_limit() && error.to_string().contains("65537"), "{error}");
}
