//! Claims about sensors that look: what they see, and what goes wrong with it.

use super::cast::RayScene;
use super::*;
use crate::configurations;
use crate::plant::Plant;
use crate::scene::Scene;
use crate::shape::{Geometry, Pose};
use crate::spatial::{Vec3, dot};
use crate::{Frame, Physics};
use autodiff::System;

const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

fn resting(position: Vec3<f64>, attitude: [f64; 4]) -> GroundTruth {
    let frame = Frame { position, velocity: [0.0; 3], attitude, angular_velocity: [0.0; 3] };
    GroundTruth::at(&frame, [0.0; 3], [0.0; 3], 9.81)
}

fn made(text: &str) -> Sensor {
    let config: SensorConfig = toml::from_str(text).unwrap();
    Sensor::new(&config, 0.01, &["drone".to_string()]).unwrap()
}

/// Reads at rest, 1 m up, with what `fill` puts into the world.
fn look(sensor: &mut Sensor, fill: impl FnOnce(&mut RayScene)) -> Vec<f64> {
    let (mut world, mut eyes) = (RayScene::default(), RayScratch::default());
    fill(&mut world);
    sensor.step(&resting([0.0, 0.0, 1.0], UPRIGHT), &mut SensorContext::new(&mut world, &[], &mut eyes)).to_vec()
}

/// A wall across x at a distance, this wide to either side.
fn wall(distance: f64, half_width: f64) -> impl FnOnce(&mut RayScene) {
    let text = format!(
        "[[obstacles]]\nname = 'wall'\nshape = {{ geometry = {{ box = {{ size = [0.2, {}, 40] }} }}, position = [{}, 0, 0] }}",
        2.0 * half_width,
        distance + 0.1
    );
    move |world| {
        let scene: Scene = toml::from_str(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
        world.fill(&scene, &scene.nominal_placement()).unwrap();
    }
}

#[test]
fn a_lidar_tells_distances_as_its_form_says_and_farthest_where_nothing_is() {
    let grid = "name = 'a'\nkind = 'lidar'\nbeams = 4\nelevations = [0.0, -1.5707963267948966]\nfarthest = 5.0\n";
    // beams ahead, left, behind and right, each level and straight down
    let told = look(&mut made(grid), |world| world.fill(&Scene::grounded(), &[]).unwrap());
    assert_eq!(told.len(), 8);
    for i in 0..4 {
        assert!((told[2 * i + 1] - 1.0).abs() < 1e-6 && told[2 * i] == 5.0, "{told:?}");
    }
    let near = look(&mut made(&format!("{grid}form = 'proximity'")), wall(3.0, 1.0));
    assert!((near[0] - 2.0).abs() < 1e-5 && near[2..].iter().all(|x| *x == 0.0), "{near:?}");
    let inverse = look(&mut made(&format!("{grid}form = 'inverse'")), wall(3.0, 1.0));
    assert!((inverse[0] - 0.4).abs() < 1e-5 && inverse[2] == 0.0, "{inverse:?}");
}

#[test]
fn noise_of_a_lidar_is_a_polynomial_of_the_distance_and_lost_beams_see_nothing() {
    let text = "name = 'a'\nkind = 'lidar'\nbeams = 30000\nelevations = [0.0]\nfarthest = 9.0\nnoise = [0.01, 0.002, 0.0005]\n\
                dropout = 0.1";
    let mut sensor = made(text);
    sensor.reset(5, 0, 0);
    let pose = Pose { position: [4.5, 0.0, 1.0], attitude: UPRIGHT };
    let wall = [PosedShape { body: 1, geometry: Geometry::Box { size: [1.0, 400.0, 2.0] }, pose }];
    let (mut world, mut eyes) = (RayScene::default(), RayScratch::default());
    let mut context = SensorContext::new(&mut world, &wall, &mut eyes);
    let told = sensor.step(&resting([0.0, 0.0, 1.0], UPRIGHT), &mut context);
    let (mut sum, mut n, mut lost, mut met) = (0.0, 0.0, 0.0, 0.0);
    for (i, d) in told.iter().enumerate() {
        let truth = 4.0 / (std::f64::consts::TAU * i as f64 / told.len() as f64).cos();
        if !(0.0..8.5).contains(&truth) {
            continue;
        }
        met += 1.0;
        if *d == 9.0 {
            lost += 1.0;
            continue;
        }
        let sigma = 0.01 + 0.002 * truth + 0.0005 * truth * truth;
        sum += ((d - truth) / sigma).powi(2);
        n += 1.0;
    }
    // of 10 thousand beams: 1.00 and 0.100 within three standard errors
    assert!(
        n > 9000.0 && (sum / n - 1.0).abs() < 0.04 && (lost / met - 0.1_f64).abs() < 0.01,
        "{} {}",
        sum / n,
        lost / met
    );
}

#[test]
fn scattered_beams_do_not_repeat_cover_their_band_evenly_and_go_on_after_a_restore() {
    let text =
        "name = 'a'\nkind = 'lidar'\npattern = 'scatter'\nbeams = 500\nelevations = [-0.2, 0.9]\nfarthest = 50.0";
    let ground = |world: &mut RayScene| world.fill(&Scene::grounded(), &[]).unwrap();
    let mut sensor = made(text);
    sensor.reset(1, 2, 3);
    let (a, b) = (look(&mut sensor, ground), look(&mut sensor, ground));
    assert!(a.iter().zip(&b).all(|(a, b)| a != b || *a == 50.0));
    // beams are as dense everywhere on the sphere: below the horizon sin 0.2 of sin 0.2 + sin 0.9
    let share = |told: &[f64]| told.iter().filter(|d| **d < 50.0).count() as f64 / told.len() as f64;
    let want = (0.2_f64.sin() - 0.02) / (0.2_f64.sin() + 0.9_f64.sin());
    assert!((share(&a) - want).abs() < 5e-3 && (share(&b) - want).abs() < 5e-3, "{} {} {want}", share(&a), share(&b));
    let mut saved = vec![0.0; sensor.n_saved()];
    sensor.save(&mut saved);
    let mut other = made(text);
    other.restore(&saved).unwrap();
    assert_eq!(look(&mut sensor, ground), look(&mut other, ground));
}

const STEREO: &str = "stereo = { focal = 447.0, baseline = 0.05, deviation = 0.08, resolution = 0.0 }";

#[test]
fn the_depth_noise_of_stereo_grows_with_the_square_of_the_distance() {
    for z in [1.0, 3.0, 6.0] {
        let text =
            format!("name = 'a'\nkind = 'camera'\nsize = [128, 96]\nfield_of_view = 1.0\nfarthest = 20.0\n{STEREO}");
        let told = look(&mut made(&text), wall(z, 20.0));
        let mean = told.iter().sum::<f64>() / told.len() as f64;
        let spread = (told.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / told.len() as f64).sqrt();
        let want = 0.08 * z * z / (447.0 * 0.05);
        // 12 288 pixels: 0.6 % of a standard deviation; the quotient's own curvature is below 1 % here
        assert!((spread / want - 1.0).abs() < 0.03, "{z}: {spread} {want}");
    }
    let text =
        "name = 'a'\nkind = 'camera'\nstereo = { focal = 447, baseline = 0.05, deviation = 0, resolution = 0.03125 }";
    let told = look(&mut made(text), wall(4.0, 20.0));
    let disparity = 447.0 * 0.05 / told[0];
    assert!((disparity / 0.03125 - (disparity / 0.03125).round()).abs() < 1e-9);
}

#[test]
fn beside_what_is_near_stereo_sees_nothing_as_wide_as_the_difference_of_disparities() {
    let text = format!(
        "name = 'a'\nkind = 'camera'\nsize = [400, 2]\nfield_of_view = 1.2\nfarthest = 20.0\n{}",
        STEREO.replace("0.08", "0.0").replace("baseline = 0.05", "baseline = 0.2")
    );
    let two = |world: &mut RayScene| {
        let text = "[[obstacles]]\nname = 'far'\nshape = { geometry = { box = { size = [0.2, 60, 40] } }, position = [8.1, 0, 0] }\n\
                    [[obstacles]]\nname = 'near'\nshape = { geometry = { box = { size = [0.2, 0.8, 40] } }, position = [2.1, 0, 0] }";
        let scene: Scene = toml::from_str(text).unwrap();
        world.fill(&scene, &scene.nominal_placement()).unwrap();
    };
    let row = &look(&mut made(&text), two)[..400];
    let first = row.iter().position(|z| *z < 3.0).unwrap();
    let holes: Vec<usize> = (0..400).filter(|x| row[*x] == 20.0).collect();
    let focal = 200.0 / 0.6_f64.tan();
    let width = focal * 0.2 * (1.0 / 2.0 - 1.0 / 8.0);
    // left of it, and nowhere else
    assert_eq!(holes.last(), Some(&(first - 1)), "{holes:?} {first}");
    assert!((holes.len() as f64 - width).abs() <= 1.0, "{} {width}", holes.len());
}

#[test]
fn a_pooled_image_tells_the_nearest_pixel_of_every_square() {
    let text = "name = 'a'\nkind = 'camera'\nsize = [16, 8]\nfield_of_view = 1.5\nfarthest = 20.0\n";
    let pooled = look(&mut made(&format!("{text}pool = 4")), wall(5.0, 0.4));
    let all = look(&mut made(text), wall(5.0, 0.4));
    assert_eq!(pooled.len(), 8);
    for (k, least) in pooled.iter().enumerate() {
        let (row, column) = (k / 4, k % 4);
        let square = (0..16).map(|i| all[(4 * row + i / 4) * 16 + 4 * column + i % 4]);
        assert_eq!(*least, square.fold(20.0, f64::min));
    }
}

#[test]
fn a_camera_tells_classes_unit_normals_and_colours_with_shadows() {
    let base = "name = 'a'\nkind = 'camera'\nsize = [32, 24]\nfield_of_view = 1.2\nfarthest = 30.0\n";
    let scene = |world: &mut RayScene| {
        let text = "ground = 0.0\n[[obstacles]]\nname = 'p'\nshape = { geometry = { capsule = { radius = 0.3, length = 3 } }, position = [4, 0, 0] }";
        let scene: Scene = toml::from_str(text).unwrap();
        world.fill(&scene, &scene.nominal_placement()).unwrap();
    };
    let class = look(&mut made(&format!("{base}show = 'segmentation'")), scene);
    assert_eq!((class[0], class[12 * 32 + 16], class[23 * 32]), (0.0, 3.0, 1.0));
    let normals = look(&mut made(&format!("{base}show = 'normals'")), scene);
    for (i, n) in normals.chunks_exact(3).enumerate() {
        let n: Vec3<f64> = n.try_into().unwrap();
        let want = if class[i] == 0.0 { 0.0 } else { 1.0 };
        assert!((dot(n, n) - want).abs() < 1e-9);
        // it faces the camera; the ground's points up
        assert!(class[i] != 3.0 || n[0] < 0.0);
        assert!(class[i] != 1.0 || (n[2] - 1.0).abs() < 1e-9);
    }
    let lit = look(&mut made(&format!("{base}show = 'rgb'")), scene);
    let shaded = look(&mut made(&format!("{base}show = 'rgb'\nshadows = true")), scene);
    assert!(lit.iter().chain(&shaded).all(|c| (0.0..=1.0).contains(c)));
    let darker = lit.iter().zip(&shaded).filter(|(a, b)| b < a).count();
    assert!(lit.iter().zip(&shaded).all(|(a, b)| b <= a) && darker > 0, "{darker}");
}

#[test]
fn a_range_finder_meets_what_stands_between_it_and_the_ground() {
    let mut sensor = made("name = 'a'\nkind = 'range'\nfarthest = 4.0\ncone = 0.4");
    let over = |world: &mut RayScene| {
        let text = "ground = 0.0\n[[obstacles]]\nname = 'p'\nshape = { geometry = { box = { size = [1, 1, 0.4] } }, position = [0, 0, 0.2] }";
        let scene: Scene = toml::from_str(text).unwrap();
        world.fill(&scene, &scene.nominal_placement()).unwrap();
    };
    let told = look(&mut sensor, over);
    assert!((told[0] - 0.6).abs() < 1e-6 && told[1] == 1.0, "{told:?}");
}

#[test]
fn a_sensor_sees_other_bodies_of_its_plant_and_not_its_own() {
    let robot = configurations::by_name("payload").unwrap();
    let plant = Plant::of_model(&robot, Physics::default()).unwrap();
    let text = "name = 'a'\nkind = 'range'\nfarthest = 4.0\nground = -50.0";
    let config: SensorConfig = toml::from_str(text).unwrap();
    let mut aboard = OnboardSensors::new(&[config], &plant).unwrap();
    let mut state = plant.hover_state().unwrap();
    state[2] += 30.0;
    let told = aboard.read(&state, &state).to_vec();
    // a ball on a bar hangs straight below; the ground is out of range
    assert!(told[1] == 1.0 && told[0] < 4.0, "{told:?}");
}

#[test]
fn sensors_that_look_refuse_what_nothing_can_see() {
    let refused = |text: &str, words: &[&str]| {
        let said = match toml::from_str::<SensorConfig>(text) {
            Err(error) => error.to_string(),
            Ok(config) => Sensor::new(&config, 0.01, &["drone".into()]).map(|_| ()).expect_err(text).to_string(),
        };
        assert!(words.iter().all(|word| said.contains(word)), "{text}: {said}");
    };
    refused("name = 'a'\nkind = 'camera'\nsize = [0, 48]", &["size", "0", "1 to 65536", "smaller image"]);
    refused("name = 'a'\nkind = 'camera'\nfarthest = 0.0", &["range", "0 to 0", "metres"]);
    refused("name = 'a'\nkind = 'camera'\nsize = [640, 480]", &["size", "307200", "65536"]);
    refused("name = 'a'\nkind = 'camera'\nsize = [10, 10]\npool = 4", &["pool", "4", "divisor"]);
    refused("name = 'a'\nkind = 'camera'\nshow = 'rgb'\npool = 2", &["show", "depth"]);
    refused("name = 'a'\nkind = 'camera'\nshow = 'heat'", &["heat"]);
    refused("name = 'a'\nkind = 'lidar'\nbeams = 1000000", &["beams", "4000000", "65536", "several sensors"]);
    refused("name = 'a'\nkind = 'lidar'\nbeams = 0", &["beams", "0"]);
    refused("name = 'a'\nkind = 'lidar'\nfarthest = 0.0", &["range", "metres"]);
    refused("name = 'a'\nkind = 'lidar'\nelevations = [2.0]", &["elevations", "2"]);
    refused("name = 'a'\nkind = 'lidar'\npattern = 'scatter'\nelevations = [0.1]", &["elevations", "band"]);
    refused("name = 'a'\nkind = 'lidar'\non = 'drome'", &["body", "'drome'", "drone"]);
}

#[test]
fn at_rest_forces_of_contact_sum_to_the_weight() {
    let mut config = SensorConfig::new("feet", SensorModel::Contact(Contact::default()));
    let vehicle = crate::vehicles::by_name("hummingbird").unwrap();
    let mut physics = Physics { dt: 0.002, ..Physics::default() };
    let lone = Plant::of_vehicle(&vehicle, physics).unwrap();
    let said = OnboardSensors::new(&[config.clone()], &lone).map(|_| ()).unwrap_err().to_string();
    assert!(said.contains("'feet'") && said.contains("effect contact"), "{said}");

    physics.effects.contact = true;
    let model = configurations::environment::vehicle_in(&vehicle, &Scene::grounded()).unwrap();
    let plant = Plant::of_model(&model, physics).unwrap();
    config.rotation = [0.0, 1.0, 0.0, 0.0];
    let mut aboard = OnboardSensors::new(&[config], &plant).unwrap();
    let mut state = plant.hover_state().unwrap();
    for rotor in plant.rotor_places() {
        state[rotor.speed] = 0.0;
    }
    state[2] = 0.07;
    let mut input = vec![0.0; plant.n_input()];
    plant.rotor_places().iter().for_each(|rotor| input[rotor.action] = -1.0);
    let mut next = state.clone();
    for _ in 0..1500 {
        plant.step(&state, &input, &[], &mut next);
        std::mem::swap(&mut state, &mut next);
    }
    // what has fallen bobs on for long: the mean of a second
    let mut sum = [0.0; 4];
    for _ in 0..500 {
        plant.step(&state, &input, &[], &mut next);
        std::mem::swap(&mut state, &mut next);
        let read = aboard.read(&state, &state);
        sum.iter_mut().zip(read).for_each(|(sum, x)| *sum += x / 500.0);
    }
    let weight = vehicle.mass_properties().mass * 9.81;
    // turned by half a turn about x, its z axis looks down; idle rotors still lift a little
    assert!((sum[2] / -weight - 1.0).abs() < 0.01 && sum[3] > 0.999, "{sum:?} {weight}");
    state[2] += 1.0;
    assert_eq!(aboard.read(&state, &state), [0.0, 0.0, 0.0, 0.0]);
}
