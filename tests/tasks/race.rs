//! Race: what a passage is, how it ends, and that sensors see the gates where they stand.

use omnidrones::dynamics::scene::Scene;
use omnidrones::dynamics::sensors::cast::{RangeLimits, RayCaster, RayScene, Rays};
use omnidrones::dynamics::shape::Pose;
use omnidrones::tasks::{Autoreset, Baseline, Buffers, Env, EnvConfig, evaluate};

/// One drone before the first gate, at `place` in its frame, which is along the world's axes; gates where the course says.
fn before_the_first(place: [f32; 3], text: &str) -> (Env, Buffers) {
    let place = place.map(|x| format!("[{x:.3}, {x:.3}]")).join(", ");
    let task = format!(
        "gate_offset = [0.0, 0.0, 0.0]\nstart_anywhere = 0.0\nstart_tilt = 0.0\nstart_yaw = [0.0, 0.0]\nstart_place = [{place}]"
    );
    let config =
        EnvConfig::from_toml(&format!("n_env = 1\nautoreset = 'disabled'\n[task]\n{task}\n{text}"), "test").unwrap();
    let mut env = Env::make("Race", &config).unwrap();
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    (env, out)
}

fn told(env: &Env, out: &Buffers, name: &str) -> f32 {
    out.info[env.spec().info_column(name).unwrap()]
}

/// Gives the drone this velocity along x and lets it drift, level, for `steps` steps or to its end: sum of the term gate.
fn drift(env: &mut Env, out: &mut Buffers, speed: f32, steps: usize) -> f32 {
    let mut state = env.state(0).unwrap();
    state[3..6].copy_from_slice(&[speed, 0.0, 0.0]);
    env.set_state(0, &state).unwrap();
    for _ in 0..steps {
        env.step(&[f32::NAN; 4], &mut out.out()).unwrap();
        if out.terminated[0] == 1 {
            break;
        }
    }
    told(env, out, "reward_gate")
}

fn reason(env: &Env, out: &Buffers) -> String {
    match told(env, out, "reason") as usize {
        0 => "none".into(),
        k => env.spec().ends[k - 1].name.clone(),
    }
}

#[test]
fn a_gate_counts_once_and_in_its_direction_only() {
    // 40 steps of 16 ms at 2 m/s, less what drag takes: 1.2 m
    let (mut env, mut out) = before_the_first([-0.6, 0.0, 0.0], "");
    let gate = env.spec().observation_range("gate").unwrap();
    assert!((out.observation[gate.start] - 0.6).abs() < 1e-6);
    assert_eq!(drift(&mut env, &mut out, 2.0, 40), 10.0);
    let x = env.state(0).unwrap()[0];
    assert!((out.observation[gate.start] - (4.8 - x)).abs() < 1e-5, "the second gate is the next");
    assert_eq!((told(&env, &out, "gates_passed"), told(&env, &out, "gates_left")), (1.0, 6.0));
    // back through it and once more: nothing is paid, nothing ends
    assert_eq!((drift(&mut env, &mut out, -2.0, 40), drift(&mut env, &mut out, 2.0, 40)), (10.0, 10.0));
    assert_eq!((told(&env, &out, "gates_passed"), reason(&env, &out).as_str()), (1.0, "none"));

    let (mut env, mut out) = before_the_first([0.6, 0.0, 0.0], "");
    assert_eq!(drift(&mut env, &mut out, -2.0, 40), 0.0);
    assert_eq!((told(&env, &out, "gates_passed"), reason(&env, &out).as_str()), (0.0, "none"));
    assert_eq!(drift(&mut env, &mut out, 2.0, 40), 10.0);
}

#[test]
fn who_misses_a_gate_or_touches_it_ends() {
    // the opening ends 0.616 m beside the middle and 0.561 m above it, a propeller reaches 0.27 m
    for (place, end) in [
        ([-0.4, 0.3, 0.0], "none"),
        ([-0.4, 0.4, 0.0], "contact"),
        ([-0.4, 0.0, 0.5], "contact"),
        ([-0.4, 1.5, 0.0], "missed"),
        ([-0.4, 0.0, 1.5], "missed"),
    ] {
        let (mut env, mut out) = before_the_first(place, "");
        let paid = drift(&mut env, &mut out, 2.0, 40);
        assert_eq!((reason(&env, &out).as_str(), paid > 0.0), (end, end == "none"), "{place:?}");
    }
}

#[test]
fn our_controller_flies_the_course_from_every_gate() {
    let config = EnvConfig { n_env: 64, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
    let mut env = Env::make("Race", &config).unwrap();
    let mut own = Baseline::new(&env).unwrap();
    let told = evaluate(&mut env, &mut own.policy(), &mut |_| ()).unwrap();
    println!("{:.1} % of 64 starts: {:?}, gates left {:.2}", 100.0 * told.success, told.ends, told.final_error);
    assert!(told.success >= 0.9, "{told:?}");
}

#[test]
fn the_difficulty_displaces_the_gates() {
    let course = [[-0.6, 0.75, 1.2], [4.8, 3.75, 1.2], [4.8, -1.875, 1.2]];
    for (difficulty, share) in [(0.0, 0.2), (0.5, 0.6), (1.0, 1.0)] {
        let text = format!("n_env = 512\ndifficulty = {difficulty}\n[task]\ngate_ease = 0.2");
        let mut env = Env::make("Race", &EnvConfig::from_toml(&text, "test").unwrap()).unwrap();
        env.reset(None, None, &mut Buffers::new(env.spec()).out()).unwrap();
        let mut most = [0.0_f32; 3];
        for i in 0..512 {
            let goal = env.goal(i).unwrap();
            for (gate, at) in course.iter().zip(goal.chunks(3)) {
                (0..3).for_each(|k| most[k] = most[k].max((at[k] - gate[k]).abs()));
            }
        }
        for (k, largest) in [0.5, 0.5, 0.1].into_iter().enumerate() {
            assert!(most[k] <= share * largest + 1e-5 && most[k] > 0.95 * share * largest, "{difficulty}: {most:?}");
        }
    }
}

#[test]
fn a_lidar_and_a_camera_see_the_gates_where_the_goal_says_that_they_stand() {
    let sensors = "[[sensor]]\nname = 'lidar'\nkind = 'lidar'\npreset = 'omnidrones'\n\
                   [[sensor]]\nname = 'depth'\nkind = 'camera'\nsize = [16, 16]\n";
    let mut env = Env::make("Race", &EnvConfig::from_toml(&format!("n_env = 16\n{sensors}"), "test").unwrap()).unwrap();
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let (lidar, width) = (env.spec().group("lidar").unwrap().columns.clone(), env.spec().n_observation);
    assert_eq!(env.spec().group("depth").unwrap().shape[..2], [16, 16]);
    let elevations = [-10.0_f64, 0.0, 10.0, 20.0].map(f64::to_radians);
    let rays = Rays::lidar(36, &elevations, RangeLimits { least: 0.0, most: 4.0 }).unwrap();
    let yaws = [0.0_f64, -15.0, 225.0, 180.0, 0.0, 85.0, 195.0].map(f64::to_radians);
    let (mut caster, mut ranges, mut ids) = (RayCaster::new(), vec![0.0; 144], vec![0; 144]);
    let mut seen = 0;
    for i in 0..16 {
        let (state, goal) = (env.state(i).unwrap(), env.goal(i).unwrap());
        let mut world = RayScene::default();
        world.fill(&Scene::grounded(), &[]).unwrap();
        for (at, yaw) in goal.chunks_exact(3).zip(yaws) {
            let corner = |y: f64, z: f64| {
                let (y, z) = (0.66 * y, 0.605 * z);
                [f64::from(at[0]) - y * yaw.sin(), f64::from(at[1]) + y * yaw.cos(), f64::from(at[2]) + z]
            };
            let [a, b, c, d] = [corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, 1.0), corner(-1.0, -1.0)];
            for bar in [[a, b], [c, d], [a, c], [b, d]] {
                world.push_capsule(bar, 0.044, 0).unwrap();
            }
        }
        let exact = |k: usize| f64::from(state[k]);
        let pose = Pose { position: [0, 1, 2].map(exact), attitude: [6, 7, 8, 9].map(exact) };
        caster.rays(&world, &rays, &pose, &mut ranges, &mut ids);
        for (told, range) in out.observation[i * width..][lidar.clone()].iter().zip(&ranges) {
            let proximity = if range.is_finite() { 4.0 - range.min(4.0) } else { 0.0 };
            assert!((told - proximity).abs() < 1e-3, "{told} of {range}");
            seen += usize::from(*told > 0.0);
        }
    }
    assert!(seen > 100, "{seen}");
}

#[test]
fn a_course_of_ones_own_is_flown_and_an_unfit_one_is_refused() {
    let of = |gates: &str| {
        let text = format!("n_env = 1\n[task]\ngates = {gates}");
        Env::make("Race", &EnvConfig::from_toml(&text, "test").unwrap())
    };
    let env = of("[[0.0, 0.0, 1.5, 0.0], [3.0, 3.0, 1.5, 1.5], [0.0, 3.0, 1.5, 3.0]]").unwrap();
    assert_eq!(env.task_spec().goal[0].size, 9);
    let error = of("[[0.0, 0.0, 1.5, 0.0]]").unwrap_err().to_string();
    assert!(error.contains("task.gates is 1") && error.contains("2 to 30 gates"), "{error}");
    let error = of("[[0.0, 0.0, 1.5, 0.0], [15.0, 0.0, 1.5, 0.0]]").unwrap_err().to_string();
    assert!(error.contains("from gate 0 to the next is up to 16.43 m") && error.contains("max_distance"), "{error}");
    let error = of("[[0.0, 0.0, 0.6, 0.0], [3.0, 0.0, 1.5, 0.0]]").unwrap_err().to_string();
    assert!(error.contains("starts before gate 0 is 0.20 to 1.00 m"), "{error}");
    let error = of("[[0.0, 0.0, nan, 0.0], [3.0, 0.0, 1.5, 0.0]]").unwrap_err().to_string();
    assert!(error.contains("gates"), "{error}");
    let error = of("[[0.0, 0.0, 1.5]]").unwrap_err().to_string();
    assert!(error.contains("gates"), "{error}");
}
