//! Claims about the tasks of several drones and of the Dragon.

use omnidrones::tasks::{Buffers, Env, EnvConfig};

/// Name, size of one agent's observation, of the central state, agents.
const SIZES: [(&str, usize, usize, usize); 10] = [
    ("OverHover", 95, 137, 4),
    ("OverTrack", 101, 143, 4),
    ("OverFlyThrough", 101, 143, 4),
    ("TransportHover", 95, 134, 4),
    ("TransportTrack", 101, 140, 4),
    ("TransportFlyThrough", 96, 135, 4),
    ("Formation", 27 + 6 * 14, 7 * 23, 7),
    ("DragonHover", 108 + 14, 0, 1),
    ("Spread", 9 + 20 + 4 + 2 * 14, 3 * 29, 3),
    ("GateSwitch", 20 + 8 + 4 + 14, 2 * 28, 2),
];

fn config(n_env: usize, task: &str) -> EnvConfig {
    EnvConfig { n_env, task: toml::from_str(task).unwrap(), ..EnvConfig::default() }
}

/// Ready to step.
fn started(name: &str, n_env: usize, task: &str) -> (Env, Buffers) {
    let mut env = Env::make(name, &config(n_env, task)).unwrap();
    let mut buffers = Buffers::new(env.spec());
    env.reset(None, None, &mut buffers.out()).unwrap();
    (env, buffers)
}

/// All tasks of this file with what else they are built with.
fn cases() -> Vec<(&'static str, &'static str)> {
    let mut cases: Vec<_> = SIZES.iter().map(|(name, ..)| (*name, "")).collect();
    cases.extend([
        ("OverHover", "n_drone = 2"),
        ("OverTrack", "n_drone = 6"),
        ("OverFlyThrough", "reset_on_collision = true"),
        ("TransportHover", "n_drone = 6"),
        ("TransportFlyThrough", "n_drone = 6\nreset_on_collision = true"),
        ("Formation", "formation = 'tetragon'"),
        ("Formation", "formation = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [0.0, 2.0, 1.0]]"),
        ("Spread", "n_drone = 5\nobserve_place = true"),
        ("Race", ""),
        ("HoverRand", ""),
        ("TrackRand", ""),
        ("OmavHover", ""),
        ("OmavTrack", ""),
    ]);
    cases
}

#[test]
fn observations_and_central_states_have_the_sizes_that_are_told() {
    for (name, observation, central, agents) in SIZES {
        let env = Env::make(name, &config(1, "")).unwrap();
        let spec = env.spec();
        assert_eq!((spec.n_observation, spec.n_central, spec.n_agent), (observation, central, agents), "{name}");
        assert_eq!(env.task_spec().observation.iter().map(|field| field.size).sum::<usize>(), observation, "{name}");
    }
    assert_eq!(Env::make("DragonHover", &config(1, "")).unwrap().spec().action.len(), 22);
}

#[test]
fn random_actions_stay_finite_and_below_the_bound() {
    for (name, task) in cases() {
        let (mut env, mut buffers) = started(name, 128, task);
        let bound = env.spec().reward_bound as f32 + 1e-5;
        let n_end = env.task_spec().ends.len();
        let reason = env.spec().info_column("reason").unwrap();
        let mut actions = vec![0.0; 128 * env.spec().n_agent * env.spec().action.len()];
        let (mut ended, mut diverged) = (0, 0);
        for step in 0..500 {
            env.sample(step, &mut actions);
            env.step(&actions, &mut buffers.out()).unwrap();
            let numbers =
                buffers.observation.iter().chain(&buffers.central).chain(&buffers.info).chain(&buffers.reward);
            assert!(numbers.clone().all(|x| x.is_finite()), "{name} {task}: step {step}");
            assert!(buffers.reward.iter().all(|r| *r <= bound), "{name}: more than {bound}");
            for (i, row) in buffers.info.chunks_exact(env.spec().info.len()).enumerate() {
                ended += usize::from(buffers.terminated[i]);
                diverged += usize::from(buffers.terminated[i] == 1 && row[reason] as usize == n_end + 1);
            }
        }
        println!("{name} {task}: {ended} ended, {diverged} diverged");
        // a drone with a fortieth of its inertia spins faster than a step of 16 ms can follow: 2 of 1142 flights of HoverRand
        // and a group of six may lose one of its bars: 1 of 1115
        let most = if name.ends_with("Rand") || name == "TransportHover" { ended / 100 } else { 0 };
        assert!(diverged <= most, "{name} {task}: {diverged} of {ended} diverged");
    }
}

#[test]
fn no_episode_begins_terminated() {
    for (name, task) in cases() {
        let (mut env, mut buffers) = started(name, 2048, task);
        let actions = vec![f32::NAN; 2048 * env.spec().n_agent * env.spec().action.len()];
        env.step(&actions, &mut buffers.out()).unwrap();
        let ended = buffers.terminated.iter().filter(|t| **t == 1).count();
        assert_eq!(ended, 0, "{name} {task}");
    }
}

#[test]
fn bounds_are_the_published_ones() {
    // of Spread one per target, of GateSwitch 1.4 + 1 + 1.3 · 1.5 + 0.1
    let wanted = [3.25, 3.25, 3.1, 4.3, 4.2, 2.7, 3.4, 1.5, 3.0, 4.45];
    for ((name, ..), bound) in SIZES.iter().zip(wanted) {
        let env = Env::make(name, &config(1, "")).unwrap();
        assert!((env.spec().reward_bound - bound).abs() < 1e-12, "{name}: {}", env.spec().reward_bound);
    }
}

#[test]
fn boxes_weigh_half_to_four_fifths_of_their_drones() {
    let (env, buffers) = started("TransportHover", 1024, "");
    let team = 4.0 * 0.716;
    let n = env.spec().privileged.len();
    assert_eq!(env.spec().privileged[0].0, "box.mass");
    let shares: Vec<f32> = buffers.privileged.chunks_exact(n).map(|row| row[0] / team).collect();
    let (least, most) = shares.iter().fold((f32::MAX, 0.0_f32), |(a, b), x| (a.min(*x), b.max(*x)));
    assert!((0.5..0.503).contains(&least) && (0.797..=0.8).contains(&most), "{least} to {most}");
    // a solid box of 1.5 × 1.0 × 0.4 m about z
    for row in buffers.privileged.chunks_exact(n) {
        assert!((row[6] / row[0] - (1.5 * 1.5 + 1.0) / 12.0).abs() < 1e-5, "inertia {} of {} kg", row[6], row[0]);
    }
}

#[test]
fn the_upper_beam_moves_in_physics_as_in_the_goal() {
    let (env, buffers) = started("TransportFlyThrough", 256, "");
    let names: Vec<&str> = env.spec().privileged.iter().map(|(name, _)| name.as_str()).collect();
    let heights: Vec<usize> = (0..names.len()).filter(|i| names[*i].ends_with("position_z")).collect();
    for (i, row) in buffers.privileged.chunks_exact(names.len()).enumerate() {
        let goal = env.goal(i).unwrap();
        let bars = [row[heights[0]], row[heights[1]]];
        assert!(bars == goal[3..5] && bars[0] == 1.2 && (2.2..=2.4).contains(&bars[1]), "{bars:?} against {goal:?}");
    }
}

/// What came of a team that was thrown along x.
struct Thrown {
    /// Least clearance, m.
    deepest: f32,
    /// Largest x of its root, m.
    farthest: f32,
    /// Largest speed of its root, m/s.
    fastest: f32,
    diverged: bool,
}

/// Throws the team of environment 0, joints at rest, from `position` at `speed` along x for `steps` steps of 16 ms with the
/// rotors' speeds held.
fn thrown(name: &str, task: &str, position: [f32; 3], yaw: f32, speed: f32, steps: usize) -> Thrown {
    let (mut env, mut buffers) = started(name, 1, task);
    let column = |name: &str| env.spec().info_column(name).unwrap();
    let (clearance, reason) = (column("clearance"), column("reason"));
    let mut state: Vec<f32> = env.robot().rest().iter().map(|x| *x as f32).collect();
    let (sin, cos) = (0.5 * yaw).sin_cos();
    state[..3].copy_from_slice(&position);
    state[3..10].copy_from_slice(&[speed, 0.0, 0.0, cos, 0.0, 0.0, sin]);
    env.set_state(0, &state).unwrap();
    let rotors = env.robot().drones().iter().flat_map(|d| &d.rotors);
    let shares = rotors.map(|r| state[r.speed] / r.max_speed as f32);
    let actions: Vec<f32> = shares.map(|s| 2.0 * s * s - 1.0).collect();
    let mut have = Thrown { deepest: f32::INFINITY, farthest: f32::NEG_INFINITY, fastest: 0.0, diverged: false };
    for _ in 0..steps {
        env.step(&actions, &mut buffers.out()).unwrap();
        if buffers.terminated[0] == 1 {
            have.diverged = buffers.info[reason] as usize > env.spec().ends.len();
            break;
        }
        let state = env.state(0).unwrap();
        have.deepest = have.deepest.min(buffers.info[clearance]);
        have.farthest = have.farthest.max(state[0]);
        have.fastest = have.fastest.max(state[3].hypot(state[4]).hypot(state[5]));
    }
    have
}

#[test]
fn nothing_flies_through_a_bar() {
    let eighth = std::f32::consts::FRAC_PI_4;
    // the box against the lower beam, of four and of six; an arm's drone against the middle pole, and two arms about it
    let cases = [
        ("TransportFlyThrough", "", [-1.2, 0.0, 1.2], 0.0, -0.7),
        ("TransportFlyThrough", "n_drone = 6", [-1.45, 0.0, 1.2], 0.0, -0.95),
        ("OverFlyThrough", "", [-1.3, 0.0, 2.0], 0.0, -0.85),
        ("OverFlyThrough", "", [-0.6, 0.0, 2.0], eighth, 0.0),
        ("OverFlyThrough", "n_drone = 6", [-1.3, 0.0, 2.0], 0.0, -0.85),
    ];
    let have: Vec<Thrown> = cases.iter().map(|(name, task, p, yaw, _)| thrown(name, task, *p, *yaw, 3.0, 30)).collect();
    for ((name, task, ..), t) in cases.iter().zip(&have) {
        println!("{name} {task}: {:.1} mm deep, up to x = {:.3} m", -1000.0 * t.deepest, t.farthest);
    }
    for ((name, task, .., beyond), t) in cases.iter().zip(&have) {
        assert!(t.deepest < 0.0 && t.deepest > -0.048, "{name} {task}: clearance {}", t.deepest);
        assert!(t.farthest < *beyond, "{name} {task}: reaches x = {}", t.farthest);
    }
}

#[test]
fn a_team_that_hits_something_anywhere_neither_sinks_in_nor_flies_apart() {
    for (name, task, start) in [
        ("TransportFlyThrough", "", [-1.2, 0.3]),
        ("TransportFlyThrough", "n_drone = 6", [-1.5, 0.3]),
        ("OverFlyThrough", "", [-1.1, 1.0]),
        ("OverFlyThrough", "n_drone = 2", [-1.1, 1.0]),
    ] {
        let (mut deepest, mut fastest, mut diverged, mut through) = (0.0_f32, 0.0_f32, 0, 0);
        for case in 0..48 {
            let (height, yaw) = (start[1] + 0.22 * (case % 8) as f32, 0.26 * (case / 8 % 3) as f32);
            let position = [start[0], 0.05 * (case % 5) as f32, height.max(0.5)];
            let t = thrown(name, task, position, yaw, if case < 24 { 1.5 } else { 3.0 }, 60);
            (deepest, fastest) = (deepest.min(t.deepest), fastest.max(t.fastest));
            diverged += usize::from(t.diverged);
            through += usize::from(t.farthest > 0.9);
        }
        println!("{name} {task}: {:.1} mm deep, {fastest:.2} m/s, {through} of 48 past", -1000.0 * deepest);
        // a fall of 2 m on top of the throw, and thrust the wrong way, make no more than this
        assert!(diverged == 0 && fastest < 12.0, "{name} {task}: {diverged} diverged, {fastest} m/s");
        assert!(deepest > -0.05, "{name} {task}: clearance {deepest}");
    }
}

#[test]
fn starts_are_clear_of_what_stands_in_the_way() {
    for (name, task) in
        [("TransportFlyThrough", "n_drone = 6\nvehicle = 'iris'"), ("OverFlyThrough", "vehicle = 'omav'")]
    {
        let task = format!("{task}\nreset_on_collision = true");
        let (mut env, mut buffers) = started(name, 512, &task);
        let actions = vec![f32::NAN; 512 * env.spec().n_agent * env.spec().action.len()];
        env.step(&actions, &mut buffers.out()).unwrap();
        let (columns, clearance) = (env.spec().info.len(), env.spec().info_column("clearance").unwrap());
        let least = buffers.info.chunks_exact(columns).fold(f32::INFINITY, |c, row| c.min(row[clearance]));
        println!("{name}: clear by {least:.3} m");
        assert!(least > 0.0 && buffers.terminated.iter().all(|t| *t == 0), "{name}: {least}");
    }
}

#[test]
fn a_box_on_the_ground_ends_transport_hover() {
    let (mut env, mut buffers) = started("TransportHover", 2, "");
    for (environment, height) in [(0, 0.25), (1, 0.15)] {
        let mut state: Vec<f32> = env.robot().rest().iter().map(|x| *x as f32).collect();
        (state[2], state[6]) = (height, 1.0);
        env.set_state(environment, &state).unwrap();
    }
    let actions = vec![f32::NAN; 2 * env.spec().n_agent * env.spec().action.len()];
    env.step(&actions, &mut buffers.out()).unwrap();
    let reason = buffers.info[env.spec().info.len() + env.spec().info_column("reason").unwrap()] as usize;
    assert_eq!((buffers.terminated[0], buffers.terminated[1]), (0, 1));
    assert_eq!(env.spec().ends[reason - 1].name, "grounded");
}

#[test]
fn teams_fly_in_their_wakes() {
    for (name, ..) in SIZES.iter().filter(|(.., agents)| *agents > 1) {
        let env = Env::make(name, &config(1, "")).unwrap();
        assert!(env.robot().physics().effects.downwash, "{name}");
    }
}

#[test]
fn formations_start_in_different_cells() {
    let (env, _) = started("Formation", 512, "");
    for environment in 0..512 {
        let state = env.state(environment).unwrap();
        let place = |i: usize| {
            let at = env.robot().model().unwrap().layout().trees[i].state.start;
            [state[at], state[at + 1], state[at + 2]]
        };
        for i in 1..7 {
            for j in 0..i {
                assert_ne!(place(i), place(j));
            }
        }
    }
}

#[test]
fn poles_stand_where_the_difficulty_wants_them() {
    for (difficulty, spacing) in [(0.0, 1.5), (0.5, 1.25), (1.0, 1.0)] {
        let config = EnvConfig { difficulty, ..config(4, "spacing_ease = 1.5") };
        let mut env = Env::make("OverFlyThrough", &config).unwrap();
        let mut buffers = Buffers::new(env.spec());
        env.reset(None, None, &mut buffers.out()).unwrap();
        let goal = env.goal(0).unwrap();
        assert_eq!(goal[6], spacing, "{goal:?}");
        let names: Vec<&str> = env.spec().privileged.iter().map(|(name, _)| name.as_str()).collect();
        let row = &buffers.privileged[..names.len()];
        assert!(names.iter().all(|name| name.ends_with("position_y")) && row == [-spacing, 0.0, spacing], "{row:?}");
        let seen = &buffers.observation[env.spec().observation_range("poles").unwrap()];
        assert!((seen[5] - seen[3] - spacing).abs() < 1e-6 && (seen[3] - seen[1] - spacing).abs() < 1e-6, "{seen:?}");
    }
}

#[test]
fn every_drone_of_a_formation_has_a_point_of_its_own_and_sees_it_where_asked() {
    let (env, buffers) = started("Formation", 64, "observe_place = true");
    let place = env.spec().observation_range("place").unwrap();
    assert_eq!((place.len(), env.spec().n_observation), (3, 27 + 6 * 14 + 3));
    for environment in 0..64 {
        let (goal, state) = (env.goal(environment).unwrap(), env.state(environment).unwrap());
        for i in 0..7 {
            let (own, at) = (&goal[3 * i..3 * i + 3], env.robot().model().unwrap().layout().trees[i].state.start);
            assert!((0..i).all(|j| goal[3 * j..3 * j + 3] != *own), "{goal:?}");
            let seen = &buffers.observation[(7 * environment + i) * env.spec().n_observation..][place.clone()];
            let way = [own[0] - state[at], own[1] - state[at + 1], own[2] + 1.5 - state[at + 2]];
            assert!((0..3).all(|k| (seen[k] - way[k]).abs() < 1e-5), "{seen:?} for {way:?}");
            let n_own = env.spec().n_central / 7;
            let told = &buffers.central[(7 * environment + i + 1) * n_own - 3..][..3];
            assert_eq!(
                told, seen,
                "a critic of all that is not told who takes which point fits distances it cannot see"
            );
        }
    }
}

#[test]
fn drones_of_a_figure_start_as_near_their_places_as_the_difficulty_wants_them() {
    for task in ["Formation", "Spread"] {
        let ways = |difficulty: f64, text: &str| {
            let config = EnvConfig { difficulty, ..config(8, &format!("observe_place = true\n{text}")) };
            let mut env = Env::make(task, &config).unwrap();
            let mut buffers = Buffers::new(env.spec());
            env.reset(None, None, &mut buffers.out()).unwrap();
            let (place, n) = (env.spec().observation_range("place").unwrap(), env.spec().n_observation);
            let rows = buffers.observation.chunks_exact(n).map(|row| row[place.clone()].to_vec());
            rows.collect::<Vec<_>>().concat()
        };
        let usual = ways(1.0, "");
        assert_eq!(ways(0.0, ""), usual);
        assert_eq!(ways(1.0, "start_way_ease = 0.0"), usual);
        for (difficulty, ease, share) in [(0.0, 0.0, 0.0), (0.5, 0.0, 0.5), (0.0, 0.25, 0.25)] {
            let eased = ways(difficulty, &format!("start_way_ease = {ease}"));
            let gap = eased.iter().zip(&usual).map(|(own, usual)| (own - share * usual).abs()).fold(0.0, f32::max);
            assert!(gap < 1e-6, "{task} {difficulty} {ease}: {gap}");
        }
    }
}
