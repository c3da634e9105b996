//! Actions that change what a controller commands.

use omnidrones::controllers::cascade::Level;
use omnidrones::parallel::Threads;
use omnidrones::tasks::{Autoreset, Baseline, Buffers, Delay, Env, EnvConfig, registry};

/// Six environments beside their controllers; numbers are those that the controllers know where there is a choice.
fn beside(residual: f64) -> EnvConfig {
    let task = "horizon = 40".parse().unwrap();
    EnvConfig { n_env: 6, residual, randomise: Some(Vec::new()), task, ..EnvConfig::default() }
}

/// Rewards and observations of `n` steps of random actions, scaled.
fn flown(env: &mut Env, n: u64, scale: f32) -> Vec<u32> {
    let mut buffers = Buffers::new(env.spec());
    let mut actions = vec![0.0; env.spec().n_env * env.spec().n_agent * env.spec().action.len()];
    let mut bits = Vec::new();
    for draw in 0..n {
        env.sample(draw, &mut actions);
        actions.iter_mut().for_each(|a| *a *= scale);
        env.step(&actions, &mut buffers.out()).unwrap();
        bits.extend(buffers.reward.iter().chain(&buffers.observation).map(|x| x.to_bits()));
    }
    bits
}

fn begun(task: &str, config: &EnvConfig) -> Env {
    let mut env = Env::make(task, config).unwrap();
    let mut buffers = Buffers::new(env.spec());
    env.reset(None, None, &mut buffers.out()).unwrap();
    env
}

/// Tasks that can be flown beside their controllers.
fn tasks() -> Vec<&'static str> {
    registry::REGISTRY.iter().filter(|e| e.env(&beside(0.2)).is_ok()).map(|e| e.name).collect()
}

#[test]
fn controllers_of_the_moment_can_stand_beside_actions() {
    let with = tasks();
    for task in ["Hover", "Track", "HoverRand", "TrackRand", "PayloadHover", "PayloadTrack", "Formation"] {
        assert!(with.contains(&task), "{task}");
    }
    for task in ["InvPendulumHover", "InvPendulumTrack"] {
        assert!(with.contains(&task), "{task}");
    }
    let refused = [
        ("FlyThrough", "residual is in FlyThrough, but it must be a task with a reference"),
        ("OverHover", "around one whose commands depend on the moment alone"),
    ];
    for (task, words) in refused {
        let error = Env::make(task, &beside(0.2)).unwrap_err().to_string();
        assert!(error.contains(words), "{task}: {error}");
    }
}

#[test]
fn zero_actions_beside_a_controller_fly_as_the_controller_alone() {
    let mut compared = Vec::new();
    for task in tasks() {
        let (mut env, mut plain) = (begun(task, &beside(0.2)), begun(task, &beside(0.0)));
        if !plain.spec().privileged.is_empty() {
            continue; // a controller alone knows the numbers of the episode
        }
        let mut own = Baseline::new(&plain).unwrap();
        let [mut here, mut there] = [Buffers::new(env.spec()), Buffers::new(plain.spec())];
        let nothing = vec![0.0; env.spec().n_env * env.spec().n_agent * env.spec().action.len()];
        let mut actions = nothing.clone();
        for step in 0..60 {
            own.act(&plain, &mut actions).unwrap();
            plain.step(&actions, &mut there.out()).unwrap();
            env.step(&nothing, &mut here.out()).unwrap();
            assert_eq!(here.reward, there.reward, "{task}, step {step}");
            assert_eq!(here.observation, there.observation, "{task}, step {step}");
            let ended = there.terminated.iter().zip(&there.truncated).map(|(a, b)| *a != 0 || *b != 0);
            ended.enumerate().filter(|(_, ended)| *ended).for_each(|(i, _)| own.forget(i));
        }
        compared.push(task);
    }
    println!("compared: {compared:?}");
    assert!(compared.contains(&"Hover") && compared.contains(&"Formation"), "{compared:?}");
}

#[test]
fn environments_beside_controllers_go_on_with_the_same_bits_from_what_they_save() {
    for task in tasks() {
        let mut env = begun(task, &beside(0.3));
        flown(&mut env, 25, 0.3);
        let saved = env.save();
        let straight = flown(&mut env, 30, 0.3);
        let mut other = Env::make(task, &beside(0.3)).unwrap();
        other.load(&saved).unwrap();
        other.set_threads(Threads::new(2).unwrap());
        assert_eq!(flown(&mut other, 30, 0.3), straight, "{task}");
    }
}

#[test]
fn controllers_beside_actions_give_the_same_bits_for_any_threads_in_every_mode() {
    let task: toml::Table = "horizon = 20".parse().unwrap();
    for (task_name, autoreset, delay) in [
        ("Hover", Autoreset::SameStep, 0),
        ("TrackRand", Autoreset::NextStep, 2),
        ("InvPendulumTrack", Autoreset::SameStep, 2),
        ("Formation", Autoreset::NextStep, 0),
    ] {
        let delay = Delay { min: 0, max: delay };
        let config =
            EnvConfig { n_env: 600, residual: 0.3, stagger: true, autoreset, delay, task: task.clone(), ..beside(0.3) };
        let config = EnvConfig { randomise: None, ..config };
        let (mut one, mut three) = (begun(task_name, &config), begun(task_name, &config));
        one.set_threads(Threads::new(1).unwrap());
        three.set_threads(Threads::new(3).unwrap());
        // one that explodes and is contained leaves the others alone
        let mut far = one.state(7).unwrap();
        far[0] = 1e6;
        [&mut one, &mut three].into_iter().for_each(|env| env.set_state(7, &far).unwrap());
        assert_eq!(flown(&mut one, 12, 0.4), flown(&mut three, 12, 0.4), "{task_name}");
        let mut again = Env::make(task_name, &config).unwrap();
        again.load(&three.save()).unwrap();
        again.set_threads(Threads::new(2).unwrap());
        assert_eq!(flown(&mut one, 30, 0.4), flown(&mut again, 30, 0.4), "{task_name}, loaded");
    }
}

#[test]
fn an_action_reaches_its_share_beside_the_controller_and_what_is_no_number_reaches_nothing() {
    let (mut env, mut other) = (begun("Hover", &beside(0.5)), begun("Hover", &beside(0.5)));
    let mut buffers = [Buffers::new(env.spec()), Buffers::new(env.spec())];
    env.step(&[0.0; 24], &mut buffers[0].out()).unwrap();
    other.step(&[f32::NAN; 24], &mut buffers[1].out()).unwrap();
    let [a, b] = &buffers;
    assert_eq!(a.observation, b.observation);
    assert!(env.safe_command().iter().all(|x| *x == 0.0));
    // a larger command turns a rotor faster; some saturate, so all are summed
    let places: Vec<usize> = env.robot().drones()[0].rotors.iter().map(|r| r.speed).collect();
    let speed = |env: &Env| {
        let of = |i| env.state(i).unwrap();
        (0..6).map(of).map(|state| places.iter().map(|place| state[*place]).sum::<f32>()).sum::<f32>()
    };
    let mut speeds = Vec::new();
    for action in [-0.2, 0.0, 0.2] {
        let mut env = begun("Hover", &beside(0.5));
        env.step(&[action; 24], &mut buffers[0].out()).unwrap();
        speeds.push(speed(&env));
    }
    assert!(speeds[0] < speeds[1] && speeds[1] < speeds[2], "{speeds:?}");
}

#[test]
fn gradients_and_control_modes_refuse_a_controller_beside_the_actions() {
    let env = begun("Hover", &beside(0.5));
    for error in [env.adjoint(false).err().unwrap(), env.jacobian(0, &[0.0; 4]).err().unwrap()] {
        assert!(error.to_string().starts_with("residual is 0.5, but it must be 0 for gradients"), "{error}");
    }
    let rate = EnvConfig { control: Level::Rate, ..beside(0.5) };
    let error = Env::make("Hover", &rate).unwrap_err().to_string();
    assert!(error.contains("with control 'rotor'"), "{error}");
    let error = Env::make("Hover", &beside(2.5)).unwrap_err().to_string();
    assert!(error.contains("within [0, 2]"), "{error}");
}
