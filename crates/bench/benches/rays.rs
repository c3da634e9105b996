//! Depth images and lidar scans per second of one core, and beside them those of peers in the same scenes, from the same eyes:
//!
//! ```sh
//! pip install numpy mujoco pybullet embreex
//! taskset -c 0 cargo bench -p omnidrones-bench --bench rays -- python
//! ```
//!
//! Without the name of a Python ours alone are measured. The scenes are those for which the caster was designed: a hundred
//! trunks that lean and ten boxes turned any way, on a square of 20 m (dense) or 40 m (sparse). An image has 64 × 48 pixels
//! of depth and what they belong to, over 1.57 rad, to 10 m; a scan 36 × 4 beams to 4 m. Peers tell how many of their
//! distances are ours within 1 cm.

use omnidrones::dynamics::scene::{Obstacle, Scene};
use omnidrones::dynamics::sensors::cast::{PinholeCamera, RangeLimits, RayCaster, RayScene, Rays};
use omnidrones::dynamics::shape::{Geometry, Pose, Shape};
use omnidrones::dynamics::spatial::exponential;
use omnidrones::error::{Error, Result};
use omnidrones::rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

const TRUNKS: usize = 100;
const SIZE: [usize; 2] = [64, 48];
const FIELD_OF_VIEW: f64 = 1.57;
const BEAMS: usize = 36;
const ELEVATIONS: [f64; 4] = [-0.17, 0.0, 0.17, 0.35];
/// Of images and of scans, m.
const FARTHEST: [f64; 2] = [10.0, 4.0];
/// Eyes in a scene.
const EYES: usize = 64;
/// Repetitions, of which the fastest counts: neighbours only take time.
const REPEATS: usize = 200;

/// A scene as peers are told of it, and what ours sees of it.
#[derive(Serialize)]
struct Told {
    name: &'static str,
    /// Ends and radius.
    capsules: Vec<Capsule>,
    /// Position, attitude and edges.
    boxes: Vec<Cuboid>,
    eyes: Vec<([f64; 3], [f64; 4])>,
    /// Directions in the eye's frame, of pixels (whose forward part is 1) and of beams.
    directions: [Vec<[f64; 3]>; 2],
    farthest: [f64; 2],
    size: [usize; 2],
    field_of_view: f64,
    /// Distances along the directions, of all eyes.
    distances: [Vec<f32>; 2],
}

/// A line of the script for peers.
#[derive(Deserialize)]
struct Peer {
    scene: String,
    what: String,
    who: String,
    per_second: f64,
    agree: f64,
}

fn main() -> Result<()> {
    let python = std::env::args().skip(1).find(|a| !a.starts_with('-'));
    println!("{:<8}{:<7}{:<34}{:>12}{:>10}{:>9}", "scene", "what", "who", "1/s", "ours is", "agree");
    for (name, side) in [("dense", 20.0), ("sparse", 40.0)] {
        let (told, rates) = ours(name, side)?;
        for (what, rate) in WHAT.iter().zip(rates) {
            println!("{name:<8}{what:<7}{:<34}{rate:>12.0}", "omnidrones");
        }
        let Some(python) = &python else { continue };
        for peer in peers(python, &told)? {
            let ours = rates[WHAT.iter().position(|what| *what == peer.what).unwrap_or(0)];
            let (ratio, agree) = (ours / peer.per_second, 100.0 * peer.agree);
            let Peer { scene, what, who, per_second, .. } = peer;
            println!("{scene:<8}{what:<7}{who:<34}{per_second:>12.0}{ratio:>8.1} ×{agree:>7.2} %");
        }
    }
    if python.is_none() {
        println!("Peers: not run. Name a Python that has numpy, mujoco, pybullet and embreex.");
    }
    Ok(())
}

const WHAT: [&str; 2] = ["image", "scan"];

/// A scene, what we see in it, and how many images and scans a second.
fn ours(name: &'static str, side: f64) -> Result<(Told, [f64; 2])> {
    let mut r = Stream::new(1, 0, 0, Purpose(0));
    let (scene, capsules, boxes) = forest(&mut r, side);
    let mut world = RayScene::default();
    world.fill(&scene, &scene.nominal_placement())?;
    let mut caster = RayCaster::new();
    let eyes = eyes(&mut r, side, &scene);
    let range = |k: usize| RangeLimits { least: 0.0, most: FARTHEST[k] };
    let camera = PinholeCamera::new(SIZE[0], SIZE[1], FIELD_OF_VIEW, range(0))?;
    let rays = Rays::lidar(BEAMS, &ELEVATIONS, range(1))?;
    let n = [SIZE[0] * SIZE[1], rays.n_ray()];
    let mut distances = n.map(|n| vec![0.0; n * eyes.len()]);
    let mut ids = vec![0; n[0]];
    let mut fastest = [f64::INFINITY; 2];
    for _ in 0..REPEATS {
        let mut look = |k: usize, cast: &mut dyn FnMut(&Pose<f64>, &mut [f32])| {
            let begun = Instant::now();
            eyes.iter().zip(distances[k].chunks_exact_mut(n[k])).for_each(|(eye, out)| cast(eye, out));
            fastest[k] = fastest[k].min(begun.elapsed().as_secs_f64());
        };
        look(0, &mut |eye, out| caster.image(&world, &camera, eye, out, &mut ids));
        look(1, &mut |eye, out| caster.rays(&world, &rays, eye, out, &mut ids[..n[1]]));
    }
    let directions = [(0..n[0]).map(|i| camera.direction(i)).collect(), (0..n[1]).map(|i| rays.direction(i)).collect()];
    let eyes: Vec<_> = eyes.iter().map(|eye| (eye.position, eye.attitude)).collect();
    let rates = fastest.map(|time| eyes.len() as f64 / time);
    let told = Told {
        name,
        capsules,
        boxes,
        eyes,
        directions,
        farthest: FARTHEST,
        size: SIZE,
        field_of_view: FIELD_OF_VIEW,
        distances,
    };
    Ok((told, rates))
}

type Capsule = ([[f64; 3]; 2], f64);
type Cuboid = ([f64; 3], [f64; 4], [f64; 3]);

/// Trunks that lean a little and a tenth as many boxes, on a square about the origin.
fn forest(r: &mut Stream, side: f64) -> (Scene, Vec<Capsule>, Vec<Cuboid>) {
    let (mut scene, mut capsules, mut boxes) = (Scene::grounded(), Vec::new(), Vec::new());
    for i in 0..TRUNKS + TRUNKS / 10 {
        let [x, y] = [0; 2].map(|_| r.uniform(-0.5 * side, 0.5 * side));
        let shape = if i < TRUNKS {
            let (radius, length) = (r.uniform(0.1, 0.3), r.uniform(2.0, 4.0));
            let position = [x, y, 0.5 * length];
            let attitude = exponential([0.1 * r.normal(), 0.1 * r.normal(), 0.0]);
            let pose = Pose { position, attitude };
            capsules.push(([-0.5, 0.5].map(|share| pose.point([0.0, 0.0, share * length])), radius));
            Shape::new(Geometry::Capsule { radius, length }).at(position).turned(attitude)
        } else {
            let size = [0; 3].map(|_| r.uniform(0.5, 1.5));
            let (position, attitude) =
                ([x, y, 1.0], exponential([r.uniform(-3.0, 3.0), r.uniform(-3.0, 3.0), r.uniform(-3.0, 3.0)]));
            boxes.push((position, attitude, size));
            Shape::new(Geometry::Box { size }).at(position).turned(attitude)
        };
        scene.obstacles.push(Obstacle { name: format!("{i}"), shape });
    }
    (scene, capsules, boxes)
}

/// Eyes at the height of a flight, with nothing nearer than 0.3 m.
fn eyes(r: &mut Stream, side: f64, scene: &Scene) -> Vec<Pose<f64>> {
    let (placement, mut eyes) = (scene.nominal_placement(), Vec::with_capacity(EYES));
    while eyes.len() < EYES {
        let [x, y] = [0; 2].map(|_| r.uniform(-0.3 * side, 0.3 * side));
        let tilt = [0.1 * r.normal(), 0.1 * r.normal(), r.uniform(-3.1, 3.1)];
        let eye = Pose { position: [x, y, r.uniform(1.0, 2.0)], attitude: exponential(tilt) };
        if scene.distance(&placement, eye.position) > 0.3 {
            eyes.push(eye);
        }
    }
    eyes
}

/// What peers take for the same, in their own process on the same core.
fn peers(python: &str, told: &Told) -> Result<Vec<Peer>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/tmp");
    let file: PathBuf = folder.join(format!("rays-{}.json", told.name));
    let text = serde_json::to_string(told).map_err(|e| failed("writing the scene", &e))?;
    std::fs::create_dir_all(&folder)
        .and_then(|()| std::fs::write(&file, text))
        .map_err(|e| failed("writing the scene", &e))?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/rays_of_peers.py");
    let output = Command::new(python).arg(script).arg(file).output().map_err(|e| failed(python, &e))?;
    if !output.status.success() {
        return Err(failed(python, &String::from_utf8_lossy(&output.stderr)));
    }
    let lines = String::from_utf8_lossy(&output.stdout).into_owned();
    lines.lines().map(|line| serde_json::from_str(line).map_err(|e| failed(line, &e))).collect()
}

fn failed(what: &str, why: &dyn std::fmt::Display) -> Error {
    Error::value(what, why, "to go well", "pip install numpy mujoco pybullet embreex, and name that Python.")
}
