//! Claims about rays at uneven ground.

use super::tests::{any_camera, any_rays, attitude, decades, image, scan, stream, vector};
use super::*;
use crate::scene::{Generator, Scene};
use crate::spatial::{axpy, rotate};
use crate::uneven_ground::{GroundWave, UnevenGround};
use autodiff::lanes::{InstructionSet, with_set};
use rng::Stream;

fn any_relief(r: &mut Stream) -> UnevenGround {
    let mut relief = UnevenGround { slope: [r.uniform(-0.4, 0.4), r.uniform(-0.4, 0.4)], waves: Vec::new() };
    for _ in 0..1 + r.below(5) {
        let number = [decades(r, -1.0, 0.5), decades(r, -1.0, 0.5) * r.uniform(-1.0, 1.0)];
        let amplitude = r.uniform(-0.25, 0.25) / number[0].hypot(number[1]);
        relief.waves.push(GroundWave { amplitude, number, phase: r.uniform(-3.0, 3.0) });
    }
    relief.validate("relief").unwrap();
    relief
}

fn over(relief: &UnevenGround, height: f64, p: [f64; 3]) -> f64 {
    p[2] - height - relief.rise(p[0], p[1]).0
}

/// By steps of a centimetre and bisection; infinite for none before `most`.
fn scanned(relief: &UnevenGround, height: f64, o: [f64; 3], d: [f64; 3], most: f64) -> f64 {
    let (step, f) = (0.01, |t: f64| over(relief, height, axpy(o, t, d)));
    let mut t = 0.0;
    while t < most {
        if f(t + step) <= 0.0 {
            let (mut low, mut high) = (t, t + step);
            for _ in 0..40 {
                let middle = 0.5 * (low + high);
                if f(middle) > 0.0 { low = middle } else { high = middle }
            }
            return high;
        }
        t += step;
    }
    f64::INFINITY
}

#[test]
fn ranges_of_hills_are_those_of_a_fine_scan_and_hits_lie_on_the_ground() {
    let (mut caster, mut world) = (RayCaster::new(), RayScene::default());
    let (mut rays_in_all, mut apart, mut hits) = (0, 0, 0);
    let (mut worst, mut off) = (0.0_f64, 0.0_f64);
    for which in 0..if cfg!(miri) { 1 } else { 100 } {
        let mut r = stream(200_000 + which);
        let (relief, height) = (any_relief(&mut r), r.uniform(-1.0, 1.0));
        let scene = Scene { ground: Some(height), relief: Some(relief.clone()), ..Scene::default() };
        world.fill(&scene, &[]).unwrap();
        let mut position = vector(&mut r, [-20.0, -20.0, 0.0], [20.0, 20.0, 0.0]);
        position[2] = height + relief.rise(position[0], position[1]).0 + decades(&mut r, -1.0, 0.6);
        let pose = Pose { position, attitude: attitude(&mut r) };
        let directions: Vec<_> = (0..100).map(|_| rotate(attitude(&mut r), [1.0, 0.0, 0.0])).collect();
        let most = 12.0;
        let rays = Rays::new(&directions, RangeLimits { least: 0.0, most }).unwrap();
        let (mut t, mut ids) = (vec![0.0; 100], vec![0; 100]);
        caster.rays(&world, &rays, &pose, &mut t, &mut ids);
        for i in 0..100 {
            let d = rotate(unit(pose.attitude), rays.direction(i));
            let want = scanned(&relief, height, position, d, most);
            let have = f64::from(t[i]);
            let error = (have - want.min(most)).abs() / (1.0 + have);
            rays_in_all += 1;
            if error > 1e-3 {
                apart += 1
            } else {
                worst = worst.max(error)
            }
            if ids[i] == GROUND {
                hits += 1;
                off = off.max(over(&relief, height, axpy(position, have, d)).abs() / (1.0 + have));
            }
        }
    }
    println!("{hits} of {rays_in_all} hit, off the ground by {off:.1e} (1 + t); ranges by {worst:.1e}, {apart} apart");
    assert!(off < 1e-4, "{off:e}");
    // what a scan in centimetres steps over
    assert!(apart <= 3 && (cfg!(miri) || hits > 3_000), "{apart} {hits}");
}

#[test]
fn a_slope_is_a_plane_and_one_of_nothing_is_level_ground_bit_for_bit() {
    let mut caster = RayCaster::new();
    let (mut level, mut flat, mut tilted) = (RayScene::default(), RayScene::default(), RayScene::default());
    level.fill(&Scene::grounded(), &[]).unwrap();
    flat.fill(&Scene { relief: Some(UnevenGround::default()), ..Scene::grounded() }, &[]).unwrap();
    let slope = [0.3, -0.2];
    tilted.fill(&Scene { relief: Some(UnevenGround { slope, waves: vec![] }), ..Scene::grounded() }, &[]).unwrap();
    let mut worst = 0.0_f64;
    for which in 0..if cfg!(miri) { 1 } else { 200 } {
        let mut r = stream(210_000 + which);
        let pose = Pose { position: vector(&mut r, [-3.0, -3.0, -1.0], [3.0, 3.0, 4.0]), attitude: attitude(&mut r) };
        let (camera, rays) = (any_camera(&mut r, 30), any_rays(&mut r));
        assert_eq!(
            image(&mut caster, RayCaster::image, &level, &camera, &pose),
            image(&mut caster, RayCaster::image, &flat, &camera, &pose)
        );
        let seen = scan(&mut caster, RayCaster::rays, &tilted, &rays, &pose);
        let height = pose.position[2] - slope[0] * pose.position[0] - slope[1] * pose.position[1];
        for i in 0..rays.n_ray() {
            let d = rotate(unit(pose.attitude), rays.direction(i));
            let want = -height / (d[2] - slope[0] * d[0] - slope[1] * d[1]);
            if seen.ids[i] == GROUND {
                worst = worst.max((f64::from(f32::from_bits(seen.t[i])) - want).abs() / (1.0 + want));
            } else {
                let RangeLimits { least, most } = rays.range();
                let sees = height > 1e-6 && want > 0.0 && want < most - 1e-3 && want > least + 1e-3;
                assert!(!sees, "scene {which}: {want}");
            }
        }
    }
    println!("ranges of a slope are off by at most {worst:.1e} (1 + t)");
    assert!(worst < 1e-4, "{worst:e}");
}

#[test]
fn hills_with_solids_are_the_same_bits_culled_or_not_and_with_every_instruction_set() {
    let mut caster = RayCaster::new();
    for which in 0..if cfg!(miri) { 1 } else { 150 } {
        let mut r = stream(220_000 + which);
        let mut world = RayScene::default();
        world.fill(&Scene { relief: Some(any_relief(&mut r)), ..Scene::grounded() }, &[]).unwrap();
        for owner in 0..12 {
            let a = vector(&mut r, [-6.0, -6.0, -1.0], [6.0, 6.0, 2.0]);
            world.push_capsule([a, add_up(a, 2.0)], decades(&mut r, -1.5, 0.0), owner).unwrap();
        }
        let pose = Pose { position: vector(&mut r, [-6.0, -6.0, 0.0], [6.0, 6.0, 4.0]), attitude: attitude(&mut r) };
        let (camera, rays) = (any_camera(&mut r, 24), any_rays(&mut r));
        let want = image(&mut caster, RayCaster::image_of_all, &world, &camera, &pose);
        let scanned = scan(&mut caster, RayCaster::rays_of_all, &world, &rays, &pose);
        for set in [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane]
            .into_iter()
            .filter(|set| set.is_here())
        {
            let (a, b) = with_set(set, || {
                (
                    image(&mut caster, RayCaster::image, &world, &camera, &pose),
                    scan(&mut caster, RayCaster::rays, &world, &rays, &pose),
                )
            });
            assert!(a == want && b == scanned, "scene {which}");
        }
    }
}

fn add_up(a: [f64; 3], by: f64) -> [f64; 3] {
    [a[0], a[1], a[2] + by]
}

#[test]
fn normals_and_slopes_of_hills_are_those_of_the_ground() {
    let mut r = stream(230_000);
    let relief = any_relief(&mut r);
    let mut world = RayScene::default();
    world.fill(&Scene { relief: Some(relief.clone()), ..Scene::grounded() }, &[]).unwrap();
    let foot = [0.7, -1.3];
    let (rise, [sx, sy]) = relief.rise(foot[0], foot[1]);
    let normal = world.normal(GROUND, [foot[0], foot[1], rise]).unwrap();
    let length = (1.0 + sx * sx + sy * sy).sqrt();
    for (have, want) in normal.iter().zip([-sx, -sy, 1.0]) {
        assert!((have - want / length).abs() < 1e-12);
    }
    // straight down, a metre to the side changes the distance by the slope
    let here = Pose { position: [0.0; 3], attitude: [1.0, 0.0, 0.0, 0.0] };
    let body = Pose { position: [foot[0], foot[1], rise + 2.0], ..here };
    let slope = world.slope(GROUND, 2.0, [0.0, 0.0, -1.0], &here, &body);
    for (have, want) in slope.position.iter().zip([-sx, -sy, 1.0]) {
        assert!((have - want).abs() < 1e-9, "{slope:?}");
    }
}

#[test]
#[ignore = "a measurement: cargo test --workspace --lib images_of_hills_per_second -- --ignored --nocapture"]
fn images_of_hills_per_second() {
    let scene = Generator::parse("terrain:2").unwrap().scene().unwrap();
    let (mut caster, mut world) = (RayCaster::new(), RayScene::default());
    world.fill(&scene, &scene.nominal_placement()).unwrap();
    let camera = PinholeCamera::new(64, 48, 1.5, RangeLimits { least: 0.0, most: 20.0 }).unwrap();
    let (mut t, mut ids) = (vec![0.0; 64 * 48], vec![0; 64 * 48]);
    let pose = Pose { position: [0.0, 0.0, 2.0], attitude: [1.0, 0.0, 0.0, 0.0] };
    let begun = std::time::Instant::now();
    for _ in 0..200 {
        caster.image(&world, &camera, &pose, &mut t, &mut ids);
    }
    let waves = scene.relief.map_or(0, |relief| relief.waves.len());
    println!("{:.0} images/s of 64 x 48 over {waves} waves", 200.0 / begun.elapsed().as_secs_f64());
}
