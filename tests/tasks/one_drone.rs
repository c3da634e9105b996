//! Claims about the tasks of one drone with a gate, a slung ball or an inverted pendulum.

use omnidrones::dynamics::vehicles;
use omnidrones::tasks::robot::RotorPlace;
use omnidrones::tasks::{Autoreset, Baseline, Buffers, Env, EnvConfig, evaluate};

/// Mass of a bar that is drawn, kg.
const DRAWN_BAR: [f64; 2] = [0.01, 0.04];
/// Mass of a bar that is not drawn, kg.
const LIGHT_BAR: [f64; 2] = [0.001; 2];

/// Name, numbers of an observation of the Hummingbird, reward ceiling.
const TASKS: [(&str, usize, f64); 7] = [
    ("FlyThrough", 33, 2.9),
    ("InvPendulumHover", 39, 4.1),
    ("InvPendulumTrack", 51, 1.1),
    ("InvPendulumFlyThrough", 43, 4.1),
    ("PayloadHover", 36, 2.1),
    ("PayloadTrack", 51, 2.1),
    ("PayloadFlyThrough", 40, 3.1),
];

fn config(n_env: usize, task: &str) -> EnvConfig {
    EnvConfig { n_env, seed: 3, task: task.parse().unwrap(), ..EnvConfig::default() }
}

fn started(name: &str, config: &EnvConfig) -> (Env, Buffers) {
    let mut env = Env::make(name, config).unwrap();
    let mut buffers = Buffers::new(env.spec());
    env.reset(None, None, &mut buffers.out()).unwrap();
    (env, buffers)
}

/// Actions that hold the rotors' speeds.
fn steady(env: &Env) -> Vec<f32> {
    let rotors = &env.robot().drone().rotors;
    let action = |state: &[f32], r: &RotorPlace| {
        let share = state[r.speed] / r.max_speed as f32;
        2.0 * share * share - 1.0
    };
    let states: Vec<Vec<f32>> = (0..env.spec().n_env).map(|i| env.state(i).unwrap()).collect();
    states.iter().flat_map(|state| rotors.iter().map(|r| action(state, r))).collect()
}

/// The numbers of one slice of an environment's observation.
fn observed(env: &Env, buffers: &Buffers, slice: &str, environment: usize) -> Vec<f32> {
    let range = env.spec().observation_range(slice).unwrap();
    buffers.observation[environment * env.spec().n_observation..][range].to_vec()
}

fn info(env: &Env, buffers: &Buffers, name: &str, environment: usize) -> f32 {
    buffers.info[environment * env.spec().info.len() + env.spec().info_column(name).unwrap()]
}

#[test]
fn observations_and_reward_ceilings_are_those_of_the_benchmark() {
    for (name, size, bound) in TASKS {
        let env = Env::make(name, &config(1, "")).unwrap();
        assert_eq!(env.spec().n_observation, size, "{name}");
        assert!((env.spec().reward_bound - bound).abs() < 1e-12, "{name}: {}", env.spec().reward_bound);
    }
}

#[test]
fn random_flights_stay_finite_and_below_the_bound() {
    for (name, _, bound) in TASKS {
        let (mut env, mut buffers) = started(name, &config(64, ""));
        let mut actions = vec![0.0; 64 * 4];
        let (mut ends, mut diverged, mut best) = (0, 0, f32::NEG_INFINITY);
        for step in 0..500 {
            env.sample(step, &mut actions);
            env.step(&actions, &mut buffers.out()).unwrap();
            let all = [&buffers.observation, &buffers.reward, &buffers.info];
            assert!(all.into_iter().flatten().all(|x| x.is_finite()), "{name}, step {step}");
            best = buffers.reward.iter().fold(best, |a, b| a.max(*b));
            let last = env.spec().ends.len() as f32 + 0.5;
            for i in (0..64).filter(|i| buffers.terminated[*i] == 1) {
                ends += 1;
                diverged += usize::from(info(&env, &buffers, "reason", i) > last);
            }
        }
        println!("{name}: {ends} ends, {diverged} diverged, best reward {best:.3}");
        assert!(f64::from(best) < bound && diverged == 0, "{name}: {best}, {diverged} diverged");
    }
}

#[test]
fn no_episode_starts_terminated() {
    for (name, ..) in TASKS {
        let (mut env, mut buffers) = started(name, &config(4096, ""));
        let actions = steady(&env);
        env.step(&actions, &mut buffers.out()).unwrap();
        for i in 0..4096 {
            let reason = info(&env, &buffers, "reason", i);
            assert_eq!(buffers.terminated[i], 0, "{name}, environment {i}: reason {reason}");
        }
    }
}

#[test]
fn a_push_changes_the_balls_velocity_by_its_kick() {
    let (mut env, mut buffers) = started("PayloadHover", &config(64, ""));
    let (mut pushes, mut worst) = (0, 0.0_f32);
    for step in 1..100 {
        for i in 0..64 {
            // all hang straight, at rest
            let mut state = env.state(i).unwrap();
            state[..17].copy_from_slice(&[0.0; 17]);
            (state[2], state[6]) = (2.0, 1.0);
            env.set_state(i, &state).unwrap();
        }
        let actions = steady(&env);
        env.step(&actions, &mut buffers.out()).unwrap();
        for i in 0..64 {
            let (goal, velocity) = (env.goal(i).unwrap(), observed(&env, &buffers, "ball_velocity", i));
            // the goal may hold the push of the coming step already
            if goal[2] == step as f32 {
                continue;
            }
            let kick = if goal[2] == (step - 1) as f32 { [goal[3], goal[4]] } else { [0.0; 2] };
            pushes += usize::from(kick != [0.0; 2]);
            worst = worst.max((velocity[0] - kick[0]).hypot(velocity[1] - kick[1]) / kick[0].hypot(kick[1]).max(0.2));
        }
    }
    println!("{pushes} pushes, velocity off the kick by at most {worst:.3} of it");
    // 64 environments, 1.6 s, one push in 2 s each: 51 of Poisson's, σ 7
    assert!((30..73).contains(&pushes), "{pushes}");
    assert!(worst < 0.03, "{worst}");
}

#[test]
fn masses_are_drawn_within_range_and_inertia_follows() {
    let vehicle = config(1, "").vehicle("hummingbird").unwrap().mass_properties().mass;
    let cases =
        [("PayloadHover", LIGHT_BAR, -1.0), ("PayloadTrack", LIGHT_BAR, -1.0), ("InvPendulumHover", DRAWN_BAR, 1.0)];
    for (name, bar, sign) in cases {
        let (env, buffers) = started(name, &config(256, "length = [0.5, 1.5]"));
        let mut lengths = Vec::new();
        for i in 0..256 {
            let (goal, theta) = (env.goal(i).unwrap(), &buffers.privileged[10 * i..10 * i + 10]);
            let (l, ball, total) = (f64::from(goal[0]), f64::from(goal[1]), f64::from(theta[0]));
            let rod = total - ball;
            assert!((0.2..0.3).contains(&(ball / vehicle)), "{name}: ball {ball}");
            assert!((bar[0] - 1e-6..bar[1] + 1e-6).contains(&rod), "{name}: bar {rod}");
            // a thin rod and a ball about their common centre of mass
            let center = sign * l * (0.5 * rod + ball) / total;
            let across = rod * l * l / 12.0 + 0.4 * ball * 0.0016 + rod * ball / total * 0.25 * l * l;
            assert!((f64::from(theta[3]) - center).abs() < 1e-5, "{name}: centre {} for {center}", theta[3]);
            assert!((f64::from(theta[4]) / across - 1.0).abs() < 0.02, "{name}: {} for {across}", theta[4]);
            assert_eq!(theta[4], theta[5]);
            lengths.push(l);
        }
        let least = lengths.iter().copied().fold(f64::INFINITY, f64::min);
        let most = lengths.iter().copied().fold(0.0, f64::max);
        assert!((0.5..0.52).contains(&least) && (1.48..=1.5).contains(&most), "{name}: {least} to {most} m");
    }
}

#[test]
fn lengths_stay_through_episodes_and_masses_do_not() {
    let (mut env, mut buffers) = started("InvPendulumHover", &config(8, "length = [0.5, 1.5]"));
    let first: Vec<Vec<f32>> = (0..8).map(|i| env.goal(i).unwrap()).collect();
    env.reset(None, None, &mut buffers.out()).unwrap();
    for (i, goal) in first.iter().enumerate() {
        let now = env.goal(i).unwrap();
        assert!(now[0] == goal[0] && now[1] != goal[1], "{goal:?}, then {now:?}");
    }
}

/// Flies environment 0 from `position` at 3 m/s along x for 1 s with the rotors' speeds held; deepest clearance, and farthest x.
fn thrown(name: &str, position: [f32; 3]) -> (f32, f32) {
    let (mut env, mut buffers) = started(name, &config(1, ""));
    let mut state = env.state(0).unwrap();
    let first_rotor = env.robot().drone().rotors[0].speed;
    state[..13].copy_from_slice(&[0.0; 13]);
    state[..3].copy_from_slice(&position);
    (state[3], state[6]) = (3.0, 1.0);
    state[13..first_rotor].fill(0.0);
    if name == "FlyThrough" {
        // the gate's slide and its rate stand behind the rotors
        let n = state.len();
        state[n - 2..].fill(0.0);
    }
    env.set_state(0, &state).unwrap();
    let (mut deepest, mut farthest) = (f32::INFINITY, f32::NEG_INFINITY);
    for _ in 0..60 {
        let actions = steady(&env);
        env.step(&actions, &mut buffers.out()).unwrap();
        if buffers.terminated[0] == 1 {
            break;
        }
        let clearance = info(&env, &buffers, "clearance", 0);
        deepest = deepest.min(clearance);
        farthest = farthest.max(env.state(0).unwrap()[0]);
        if name != "FlyThrough" {
            assert_eq!(clearance < 0.0, buffers.reward[0] == 0.0, "{name}: reward is lost in touch alone");
        }
    }
    (deepest, farthest)
}

#[test]
fn nothing_flies_through_a_bar() {
    // into the gate's left upright; into the upper bar; past both with the slung bar against the lower one
    for (name, position) in [
        ("FlyThrough", [-0.6, 0.66, 2.0]),
        ("InvPendulumFlyThrough", [-0.6, 0.0, 1.2]),
        ("PayloadFlyThrough", [-0.6, 0.0, 2.05]),
    ] {
        let (deepest, farthest) = thrown(name, position);
        println!("{name}: {:.1} mm deep, up to x = {farthest:.2} m", -1000.0 * deepest);
        assert!(deepest < 0.0 && deepest > -0.045, "{name}: clearance {deepest}");
        assert!(farthest < 0.0, "{name}: reaches x = {farthest}");
    }
    let (deepest, _) = thrown("PayloadFlyThrough", [-0.6, 0.0, 1.65]);
    println!("slung bar: {:.1} mm deep", -1000.0 * deepest);
    assert!(deepest < 0.0 && deepest > -0.045, "slung bar: clearance {deepest}");
}

#[test]
fn touch_ends_the_episode_where_asked() {
    for (name, position) in [("FlyThrough", [0.0, 0.66, 2.0]), ("PayloadFlyThrough", [0.0, 0.0, 1.2])] {
        for (task, reason) in [("reset_on_collision = true", "contact"), ("", "")] {
            let (mut env, mut buffers) = started(name, &config(1, task));
            let mut state = env.state(0).unwrap();
            state[..3].copy_from_slice(&position);
            state[0] = -0.05;
            if name == "FlyThrough" {
                let n = state.len();
                state[n - 2..].fill(0.0);
            }
            env.set_state(0, &state).unwrap();
            env.step(&steady(&env), &mut buffers.out()).unwrap();
            let number = info(&env, &buffers, "reason", 0) as usize;
            let have = if number == 0 { "" } else { env.spec().ends[number - 1].name.as_str() };
            assert_eq!(have, reason, "{name}");
        }
    }
}

#[test]
fn every_vehicle_flies_every_task() {
    for vehicle in vehicles::names() {
        for (name, ..) in TASKS {
            let (mut env, mut buffers) = started(name, &config(8, &format!("vehicle = '{vehicle}'")));
            for _ in 0..20 {
                let actions = steady(&env);
                env.step(&actions, &mut buffers.out()).unwrap();
                assert!(buffers.observation.iter().all(|x| x.is_finite()), "{name} with {vehicle}");
            }
        }
    }
}

#[test]
fn starts_widen_with_the_difficulty_where_asked() {
    let starts = |difficulty: f64, task: &str| -> Vec<Vec<f32>> {
        let (env, _) = started("Hover", &EnvConfig { difficulty, ..config(64, task) });
        (0..64).map(|i| env.state(i).unwrap()[..10].to_vec()).collect()
    };
    let usual = starts(1.0, "");
    assert_eq!(starts(1.0, "start_ease = 0.0"), usual);
    assert_eq!(starts(0.0, ""), usual);
    assert!(starts(0.0, "start_ease = 0.0").iter().all(|s| s[..3] == [0.0, 0.0, 1.75]));
    assert!(starts(0.5, "start_ease = 0.0").iter().all(|s| s[0].abs() <= 1.25 && (s[2] - 1.75).abs() <= 0.375));
}

#[test]
fn a_weight_scales_its_term_and_no_other() {
    let told = |task: &str| {
        let (mut env, mut buffers) = started("Hover", &config(8, task));
        env.step(&steady(&env), &mut buffers.out()).unwrap();
        let terms = ["reward_pose", "reward_up", "reward_spin", "reward_effort", "loss"];
        terms.map(|name| info(&env, &buffers, name, 5))
    };
    let (usual, more) = (told(""), told("reward_up = 4.0\nloss_velocity = 0.0"));
    assert_eq!((more[0], more[1], more[2], more[3]), (usual[0], 4.0 * usual[1], usual[2], usual[3]));
    assert!(more[4] < usual[4]);
}

#[test]
fn a_target_may_be_anywhere() {
    for (name, task) in [("Hover", "target = [1.0, 0.0, 2.0]"), ("OverHover", "target_position = [1.0, 0.0, 2.25]")] {
        let there = Env::make(name, &config(1, task)).unwrap();
        let here = Env::make(name, &config(1, "")).unwrap();
        assert_eq!(there.ideal_terms(), here.ideal_terms(), "{name}");
    }
}

/// Mean of a figure over the environments after `n` steps with the rotors' speeds held.
fn after(name: &str, task: &str, n: usize, figure: &str) -> f32 {
    let (mut env, mut buffers) = started(name, &config(256, task));
    let actions = steady(&env);
    for _ in 0..n {
        env.step(&actions, &mut buffers.out()).unwrap();
        assert!(buffers.terminated.iter().all(|t| *t == 0), "{name} {task}");
    }
    (0..256).map(|i| info(&env, &buffers, figure, i)).sum::<f32>() / 256.0
}

#[test]
fn starts_along_the_path_move_and_lean_as_it_asks() {
    // the mean error after 0.16 s without any control, m: measured 0.0050, 0.0055 and 0.0049; from rest 0.03
    for (name, most) in [("Track", 0.01), ("PayloadTrack", 0.01), ("InvPendulumTrack", 0.01)] {
        let usual = "start_tilt = 0.0\nreset_distance = 3.0";
        let along = after(name, &format!("{usual}\nstart_along = 1.0"), 10, "position_error");
        println!("{name}: {along:.4} m along the path");
        assert!(along < most, "{name}: {along}");
        // at rest where a path begins, the first steps are the same
        assert!(after(name, usual, 1, "position_error") < 0.01, "{name}");
    }
}

#[test]
fn our_controllers_fly_on_where_a_start_is_along_the_path() {
    for name in ["Track", "PayloadTrack"] {
        let config = EnvConfig { autoreset: Autoreset::Disabled, ..config(32, "start_along = 1.0\nhorizon = 200") };
        let mut env = Env::make(name, &config).unwrap();
        let mut own = Baseline::new(&env).unwrap();
        let e = evaluate(&mut env, &mut own.policy(), &mut |_| ()).unwrap();
        println!("{name}: {:.3} m, crashed {}", e.mean_error, e.crashed);
        // measured 0.015 and 0.020 m; a reference that began at rest would be left behind by metres
        assert!(e.crashed == 0.0 && e.mean_error < 0.03, "{name}: {e:?}");
    }
}

#[test]
fn reset_distances_and_offsets_follow_the_difficulty() {
    for (difficulty, ends) in [(0.0, 0), (0.4, 0), (1.0, 1)] {
        for (name, task) in [
            ("Track", "reset_ease = 3.0"),
            ("InvPendulumHover", "max_distance_ease = 2.0\nmax_distance = 0.5\nmin_balance = -2.0"),
        ] {
            let (mut env, mut buffers) = started(name, &EnvConfig { difficulty, ..config(4, task) });
            let target = if name == "Track" { [0.0; 3] } else { [0.0, 0.0, 1.5] };
            for i in 0..4 {
                let mut state = env.state(i).unwrap();
                if name == "Track" {
                    state[0] += 0.7;
                } else {
                    state[..3].copy_from_slice(&[0.7, 0.0, target[2]]);
                    state[6..10].copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
                }
                env.set_state(i, &state).unwrap();
            }
            let actions = steady(&env);
            env.step(&actions, &mut buffers.out()).unwrap();
            assert!(buffers.terminated.iter().all(|t| *t == ends), "{name} at {difficulty}: {:?}", buffers.terminated);
        }
        let (env, _) = started("Track", &EnvConfig { difficulty, ..config(64, "rate_ease = 0.2") });
        let most = (0..64).map(|i| env.goal(i).unwrap()[4].abs()).fold(0.0, f32::max);
        let factor = (0.2 + 0.8 * difficulty) as f32;
        assert!(most <= 1.1 * factor && most >= 1.0 * factor, "{most} at {difficulty}");
        let (env, _) = started("FlyThrough", &EnvConfig { difficulty, ..config(64, "gate_ease = 0.0") });
        let state = env.state(0).unwrap();
        let most = (0..64).map(|i| env.state(i).unwrap()[state.len() - 2].abs()).fold(0.0, f32::max);
        assert!(most <= difficulty as f32 && most >= 0.9 * difficulty as f32, "{most} at {difficulty}");
    }
}

#[test]
fn starts_along_the_course_are_on_both_sides_and_touch_nothing() {
    for name in ["FlyThrough", "PayloadFlyThrough", "InvPendulumFlyThrough", "TransportFlyThrough", "OverFlyThrough"] {
        let (mut env, mut buffers) = started(name, &config(512, "start_along = 0.5\nreset_on_collision = true"));
        let states: Vec<Vec<f32>> = (0..512).map(|i| env.state(i).unwrap()).collect();
        let behind = states.iter().filter(|state| state[0] > 0.0).count();
        let actions = vec![f32::NAN; 512 * env.spec().n_agent * env.spec().action.len()];
        env.step(&actions, &mut buffers.out()).unwrap();
        println!("{name}: {behind} of 512 begin behind");
        assert!((40..256).contains(&behind), "{name}: {behind}");
        for i in 0..512 {
            let (reason, x) = (info(&env, &buffers, "reason", i), states[i][0]);
            assert_eq!(buffers.terminated[i], 0, "{name}, environment {i} at x = {x}: reason {reason}");
        }
    }
}

#[test]
fn a_ball_that_is_pushed_is_judged_where_it_was_longest_left_alone() {
    let (mut env, mut buffers) = started("PayloadHover", &config(64, ""));
    let (mut longest, mut judged) = ([0.0_f32; 64], [0.0_f32; 64]);
    let mut last = [-1.0_f32; 64];
    for step in 1..300 {
        for (i, last) in last.iter_mut().enumerate() {
            let mut state = env.state(i).unwrap();
            state[..17].copy_from_slice(&[0.0; 17]);
            (state[0], state[2], state[6]) = (0.001 * step as f32, 2.0, 1.0);
            env.set_state(i, &state).unwrap();
            *last = env.goal(i).unwrap()[2];
        }
        let actions = steady(&env);
        env.step(&actions, &mut buffers.out()).unwrap();
        for i in 0..64 {
            let quiet = step as f32 - last[i].max(125.0);
            if quiet >= longest[i] || step < 125 {
                (longest[i], judged[i]) = (quiet.max(0.0), info(&env, &buffers, "position_error", i));
            }
            let told = info(&env, &buffers, "quiet_error", i);
            assert_eq!((told, info(&env, &buffers, "success", i) > 0.5), (judged[i], judged[i] < 0.1), "{step}, {i}");
        }
    }
}
