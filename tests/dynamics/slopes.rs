//! Claims about slopes of readings: those of differences, and refused where nobody carries them.

use omnidrones::dynamics::scene::Scene;
use omnidrones::dynamics::sensors::cast::RayScene;
use omnidrones::dynamics::sensors::{
    GroundTruth, KINDS, RangeJacobian, RayScratch, Sensor, SensorConfig, SensorContext,
};
use omnidrones::dynamics::spatial::{Quat, Vec3, add, exponential, multiply};
use omnidrones::dynamics::{Frame, GroundWave, UnevenGround};
use omnidrones::rng::{Purpose, Stream};

fn config(text: &str) -> SensorConfig {
    toml::from_str(&format!("name = 'a'\n{text}")).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

/// Ground, a wall, a ball and a trunk, all large: readings are smooth over centimetres.
fn room() -> RayScene {
    let text = "ground = 0.0\n\
        [[obstacles]]\nname = 'wall'\nshape = { geometry = { box = { size = [0.2, 9, 9] } }, position = [5, 0, 3], \
        rotation = [0.9689124, 0, 0, 0.2474040] }\n\
        [[obstacles]]\nname = 'ball'\nshape = { geometry = { sphere = { radius = 1.0 } }, position = [-2.5, 0.5, 2] }\n\
        [[obstacles]]\nname = 'trunk'\nshape = { geometry = { capsule = { radius = 0.6, length = 8.0 } }, position = [0.5, 3, 2] }\n";
    let scene: Scene = toml::from_str(text).unwrap_or_else(|e| panic!("{e}\n{text}"));
    let mut world = RayScene::default();
    world.fill(&scene, &scene.nominal_placement()).unwrap();
    world
}

/// The same on a slope with waves.
fn hills() -> RayScene {
    let mut scene = Scene::grounded();
    let wave = GroundWave { amplitude: 0.15, number: [0.9, 0.5], phase: 0.4 };
    scene.relief = Some(UnevenGround { slope: [0.3, -0.2], waves: vec![wave] });
    let mut world = RayScene::default();
    world.fill(&scene, &scene.nominal_placement()).unwrap();
    world
}

struct Looking {
    sensor: Sensor,
    world: RayScene,
    eyes: RayScratch,
}

impl Looking {
    /// The first sample of an episode: the same draws wherever it is taken.
    fn at(&mut self, position: Vec3<f64>, attitude: Quat<f64>) -> Vec<f64> {
        let frame = Frame { position, velocity: [0.0; 3], attitude, angular_velocity: [0.0; 3] };
        self.sensor.reset(3, 1, 4);
        let truth = GroundTruth::at(&frame, [0.0; 3], [0.0; 3], 9.81);
        self.sensor.step(&truth, &mut SensorContext::new(&mut self.world, &[], &mut self.eyes)).to_vec()
    }

    /// Differences of fourth order along one of six axes; NaN where the reading is not smooth within two steps.
    fn differences(&mut self, position: Vec3<f64>, attitude: Quat<f64>, axis: usize) -> Vec<f64> {
        const STEP: f64 = 0.01;
        let mut at = |steps: f64| {
            let mut change = [0.0; 3];
            change[axis % 3] = steps * STEP;
            match axis {
                0..3 => self.at(add(position, change), attitude),
                _ => self.at(position, multiply(attitude, exponential(change))),
            }
        };
        let [a, b, c, d, e] = [-2.0, -1.0, 0.0, 1.0, 2.0].map(&mut at);
        let one = |i: usize| {
            let (near, far) = ((d[i] - b[i]) / (2.0 * STEP), (e[i] - a[i]) / (4.0 * STEP));
            // where another pixel or ray becomes the nearest there is a kink: bends that do not grow with the square of the step
            let (bend, wide) = (d[i] + b[i] - 2.0 * c[i], e[i] + a[i] - 2.0 * c[i]);
            let is_smooth = (near - far).abs() < 2e-3 && (wide - 4.0 * bend).abs() < 1e-4;
            if is_smooth { (4.0 * near - far) / 3.0 } else { f64::NAN }
        };
        (0..c.len()).map(one).collect()
    }
}

#[test]
fn slopes_of_readings_are_those_of_differences_off_silhouettes() {
    let mount = "gradient = 'pose'\nposition = [0.1, -0.05, 0.08]\nrotation = [0.9, 0.1, 0.3, -0.3]";
    let lidar = "kind = 'lidar'\nbeams = 24\nelevations = [-0.5, 0.0, 0.4]\nfarthest = 12.0";
    let camera = "kind = 'camera'\nsize = [16, 12]\nfarthest = 12.0";
    let down = "kind = 'range'\ngradient = 'pose'\nposition = [0.1, -0.05, 0.08]";
    let low = "kind = 'lidar'\nbeams = 24\nelevations = [-1.2, -0.9, -0.7]\nfarthest = 12.0";
    for (what, text) in [
        ("lidar", format!("{lidar}\n{mount}")),
        ("lidar on hills", format!("{low}\n{mount}")),
        ("camera on hills", format!("{camera}\n{mount}")),
        ("range on hills", format!("{down}\ncone = 0.0")),
        ("lidar, noise, lost", format!("{lidar}\n{mount}\nnoise = [0.02, 0, 0]\ndropout = 0.1\nnearest = 0.5")),
        ("lidar, proximity", format!("{lidar}\n{mount}\nform = 'proximity'")),
        ("lidar, inverse", format!("{lidar}\n{mount}\nform = 'inverse'")),
        ("lidar, scattered", format!("{lidar}\n{mount}\npattern = 'scatter'")),
        ("camera", format!("{camera}\n{mount}")),
        ("camera, pooled", format!("{camera}\n{mount}\npool = 2\nform = 'inverse'")),
        (
            "camera, stereo",
            format!(
                "{camera}\n{mount}\nstereo = {{ focal = 447.0, baseline = 0.05, deviation = 0.05, resolution = 0.0 }}"
            ),
        ),
        ("range", format!("{down}\nerror = {{ scale = 0.05, offset = 0.1 }}")),
        ("range, cone", format!("{down}\ncone = 0.3")),
    ] {
        let sensor = Sensor::new(&config(&text), 0.01, &["drone".into()]).unwrap();
        let world = if what.ends_with("hills") { hills() } else { room() };
        let mut looking = Looking { sensor, world, eyes: RayScratch::default() };
        let mut draws = Stream::new(7, 0, 0, Purpose::LEARNING);
        let (mut worst, mut compared, mut sloped) = (0.0_f64, 0, 0);
        for _ in 0..if cfg!(miri) { 1 } else { 12 } {
            let place = [0.3, 0.0, 1.5].map(|x| x + 0.3 * draws.normal().clamp(-1.5, 1.5));
            let attitude = exponential([0.0; 3].map(|x: f64| x + 0.25 * draws.normal()));
            looking.at(place, attitude);
            let slopes: Vec<[f64; 6]> = looking.sensor.slopes().iter().map(numbers).collect();
            for axis in 0..6 {
                let differences = looking.differences(place, attitude, axis);
                assert_eq!(differences.len(), slopes.len());
                for (slope, want) in slopes.iter().zip(&differences) {
                    // guarded or steep: where a ray grazes what it meets
                    let steep = slope.iter().any(|x| x.abs() > 3.0);
                    if want.is_nan() || steep {
                        continue;
                    }
                    worst = worst.max((slope[axis] - want).abs() / (1.0 + want.abs()));
                    (compared, sloped) = (compared + 1, sloped + usize::from(slope[axis] != 0.0));
                }
            }
        }
        println!("{what}: {compared} slopes, {sloped} of them not nought: {worst:.1e}");
        // readings are cast in f32
        assert!(worst < 1e-3, "{what}: {worst:e}"); // measured at most 2.0e-4, of pooled squares
        assert!(
            cfg!(miri) || sloped > if what.starts_with("range") { 40 } else { 500 },
            "{what}: {sloped} of {compared}"
        );
    }
}

fn numbers(slope: &RangeJacobian) -> [f64; 6] {
    let ([a, b, c], [d, e, f]) = (slope.position, slope.attitude);
    [a, b, c, d, e, f]
}

#[test]
fn what_is_lost_clipped_or_out_of_range_has_no_slope_and_rounding_is_taken_for_the_identity() {
    let level = [1.0, 0.0, 0.0, 0.0];
    let look = |text: &str| {
        let sensor = Sensor::new(&config(&format!("gradient = 'pose'\n{text}")), 0.01, &["drone".into()]).unwrap();
        let mut looking = Looking { sensor, world: RayScene::default(), eyes: RayScratch::default() };
        looking.world.fill(&Scene::grounded(), &[]).unwrap();
        let read = looking.at([0.0, 0.0, 2.0], level);
        (read, looking.sensor.slopes().iter().map(|slope| slope.position[2]).collect::<Vec<_>>())
    };
    let down = "kind = 'lidar'\nbeams = 1\nelevations = [-1.5707963267948966, 0.0]\n";
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
    let (read, slopes) = look(&format!("{down}farthest = 4.0"));
    assert!(near(read[0], 2.0) && near(slopes[0], 1.0) && slopes[1] == 0.0, "{read:?} {slopes:?}");
    assert_eq!(look(&format!("{down}farthest = 1.5")).1, [0.0, 0.0]);
    assert_eq!(look(&format!("{down}farthest = 1.5\nform = 'proximity'")).1, [0.0, 0.0]);
    let range = "kind = 'range'\n";
    let all = |text: &str| look(&format!("{range}{text}")).1;
    assert_eq!(all("farthest = 4.0"), [1.0, 0.0]);
    assert_eq!(all("farthest = 4.0\nerror = { resolution = 0.3 }"), [1.0, 0.0]);
    assert_eq!(all("farthest = 1.0"), [0.0, 0.0]);
    assert_eq!(all("farthest = 4.0\nerror = { limits = [0.0, 1.0] }"), [0.0, 0.0]);
}

#[test]
fn slopes_are_told_only_where_they_are_asked_for_and_change_no_reading() {
    let lidar = "kind = 'lidar'\nbeams = 24\nelevations = [-0.5]\nnoise = [0.01, 0, 0]";
    let read = |text: &str, without: bool| {
        let mut sensor = Sensor::new(&config(text), 0.01, &["drone".into()]).unwrap();
        let (mut world, mut eyes) = (room(), RayScratch::default());
        let frame = Frame {
            position: [0.0, 0.0, 1.0],
            velocity: [0.0; 3],
            attitude: [1.0, 0.0, 0.0, 0.0],
            angular_velocity: [0.0; 3],
        };
        let mut context = SensorContext::new(&mut world, &[], &mut eyes);
        if without {
            context = context.without_slopes();
        }
        let reading = sensor.step(&GroundTruth::at(&frame, [0.0; 3], [0.0; 3], 9.81), &mut context).to_vec();
        (reading, sensor.slopes().to_vec())
    };
    let (plain, none) = read(lidar, false);
    let asked = format!("{lidar}\ngradient = 'pose'");
    let (same, slopes) = read(&asked, false);
    let (still, noughts) = read(&asked, true);
    assert!(plain == same && plain == still);
    assert!(none.is_empty() && slopes.len() == 24 && slopes.iter().any(|slope| *slope != RangeJacobian::default()));
    assert!(noughts.iter().all(|slope| *slope == RangeJacobian::default()));
}

#[test]
fn who_has_no_slopes_refuses_them_and_says_who_has() {
    let said = |text: &str| {
        let made = Sensor::new(&config(text), 0.01, &["drone".into()]);
        made.expect_err(text).to_string()
    };
    for kind in KINDS.iter().filter(|kind| !kind.ideal().has_slopes()) {
        let error = said(&format!("kind = '{}'\ngradient = 'pose'", kind.name));
        assert!(["'a'", "gradient", "pose", "lidar", "range", "depth"].iter().all(|x| error.contains(x)), "{error}");
    }
    for show in ["segmentation", "normals", "rgb"] {
        let error = said(&format!("kind = 'camera'\nshow = '{show}'\ngradient = 'pose'"));
        assert!(error.contains("depth") && error.contains("camera"), "{error}");
    }
    for late in ["latency = 2", "delay = 0.03", "every = 3", "rate = 25.0"] {
        let error = said(&format!("kind = 'lidar'\ngradient = 'pose'\n{late}"));
        assert!(["gradient", "every = 1", "latency = 0"].iter().all(|x| error.contains(x)), "{error}");
    }
    let unknown =
        toml::from_str::<SensorConfig>("name = 'a'\nkind = 'lidar'\ngradient = 'poses'").unwrap_err().to_string();
    assert!(unknown.contains("poses") && unknown.contains("`pose`"), "{unknown}");
    // what says nothing of gradients is written as ever, what does is read back
    let plain = toml::to_string(&config("kind = 'lidar'")).unwrap();
    assert!(!plain.contains("gradient"), "{plain}");
    let asked = config("kind = 'lidar'\ngradient = 'pose'");
    assert_eq!(toml::from_str::<SensorConfig>(&toml::to_string(&asked).unwrap()).unwrap(), asked);
}
