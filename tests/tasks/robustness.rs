//! Hostile actions, broken environments, impossible configurations, damaged bytes.

use crate::{config, everywhere};
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{Autoreset, Buffers, Env, EnvConfig, registry};
use std::time::Instant;

/// A number that no careful agent sends.
fn hostile(stream: &mut Stream) -> f32 {
    match stream.below(8) {
        0 => f32::NAN,
        1 => f32::INFINITY,
        2 => f32::NEG_INFINITY,
        3 => f32::MAX,
        4 => 1e-42,
        5 => f32::from_bits(stream.next_u64() as u32),
        6 => 1.0,
        _ => -1.0,
    }
}

#[test]
fn ten_million_hostile_steps_give_finite_numbers_and_every_clip_is_counted() {
    let mut steps = 0;
    everywhere(512, 200, |name, make, config| {
        let light = name.starts_with("Hover ") || name.starts_with("Track ");
        let rounds = if light { 2000 } else { 40 };
        let mut env = make(config);
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let n = env.spec().n_agent * env.spec().action.len();
        let mut stream = Stream::new(77, 0, 0, Purpose::user(77));
        let pool: Vec<f32> = (0..512 * n + 997).map(|_| hostile(&mut stream)).collect();
        let clipped = env.spec().info_column("clipped").unwrap();
        let width = env.spec().info.len();
        for t in 0..rounds {
            // chatter from a pool, and constant extremes
            let from = (t * 131) % 997;
            let actions = &pool[from..from + 512 * n];
            env.step(actions, &mut out.out()).unwrap();
            let arrays =
                [&out.observation, &out.reward, &out.central, &out.privileged, &out.info, &out.final_observation];
            assert!(arrays.iter().all(|a| a.iter().all(|x| x.is_finite())), "{name}, step {t}");
            for i in (0..512).step_by(41) {
                let wrong = actions[i * n..(i + 1) * n].iter().filter(|a| !(-1.0..=1.0).contains(*a)).count();
                assert_eq!(out.info[i * width + clipped] as usize, wrong, "{name}, step {t}, environment {i}");
            }
            steps += 512;
        }
    });
    println!("{steps} steps");
    assert!(steps >= 10_000_000);
}

#[test]
fn one_broken_environment_of_many_ends_alone() {
    for entry in registry::REGISTRY {
        let n = if ["Hover", "Track"].contains(&entry.name) { 4096 } else { 256 };
        let run = |poison: Option<usize>| {
            let mut env = entry.env(&config(n, 60)).unwrap();
            let mut out = Buffers::new(env.spec());
            env.reset(None, None, &mut out.out()).unwrap();
            let mut actions = vec![0.0; n * env.spec().n_agent * env.spec().action.len()];
            let mut told = Vec::new();
            for t in 0..12 {
                if let (Some(i), 7) = (poison, t) {
                    let mut state = env.state(i).unwrap();
                    state[3] = 1e18;
                    env.set_state(i, &state).unwrap();
                }
                env.sample(t, &mut actions);
                env.step(&actions, &mut out.out()).unwrap();
                told.push(out.clone());
            }
            (told, env.spec().clone())
        };
        let victim = n / 2 + 3;
        let ((clean, spec), (poisoned, _)) = (run(None), run(Some(victim)));
        let (row, width) = (spec.n_agent * spec.n_observation, spec.info.len());
        let reason = spec.info_column("reason").unwrap();
        for t in 0..12 {
            let (a, b) = (&clean[t], &poisoned[t]);
            assert!(
                b.observation.iter().chain(&b.info).chain(&b.final_observation).all(|x| x.is_finite()),
                "{}",
                entry.name
            );
            for i in (0..n).filter(|i| *i != victim) {
                let of = |o: &Buffers| {
                    (o.observation[i * row..(i + 1) * row].to_vec(), o.info[i * width..(i + 1) * width].to_vec())
                };
                assert!(of(a) == of(b), "{}: environment {i}, step {t}", entry.name);
            }
        }
        let ended = &poisoned[7];
        assert_eq!(ended.terminated[victim], 1, "{}", entry.name);
        assert_eq!(ended.info[victim * width + reason] as usize, spec.ends.len() + 1, "{}: diverged", entry.name);
    }
}

#[test]
fn impossible_configurations_are_refused_at_once_with_the_limit_and_the_nearest_key() {
    let cases: &[(&str, &[&str])] = &[
        ("n_env = 1e12", &["n_env is 1000000000000", "over the limit of 1 to", "memory_limit"]),
        ("n_env = 1000000000000", &["n_env is 1000000000000", "over the limit"]),
        ("n_env = -5", &["n_env is -5", "whole number from 1 on"]),
        ("n_env = nan", &["n_env is NaN", "whole number"]),
        ("n_env = 0", &["n_env is 0", "whole number"]),
        ("n_env = 1.5", &["n_env is 1.5", "whole number"]),
        ("n_envs = 10", &["unknown field `n_envs`", "Did you mean `n_env`?"]),
        ("[task]\nhorizon = 1000000000000000", &["horizon is 1000000000000000", "1 to 10000000"]),
        ("[task]\nhorizonn = 10", &["unknown field `horizonn`", "Did you mean `horizon`?"]),
        ("[task]\nvehicle = 'humingbird'", &["did you mean 'hummingbird'?"]),
        ("control = 'rates'", &["rates", "rate"]),
        ("dt = nan", &["dt is NaN"]),
        ("dt = -0.01", &["dt is -0.01", "(0, 1]"]),
        ("delay = { min = 0, max = 1000000000 }", &["delay", "0 to 32 steps"]),
        ("substeps = 1000000000", &["substeps is 1000000000"]),
        ("actions = { kind = 'discrete', levels = 1000000 }", &["actions.levels is 1000000"]),
        ("actions = { kind = 'discrete', levels = 1000 }", &["discrete actions", "multi_discrete"]),
        ("observation = [{ kind = 'history', steps = 1000000000 }]", &["observation.history.steps", "2 to 256"]),
        ("observation = [{ kind = 'noise', std = inf }]", &["observation.noise.std is inf"]),
        ("observation = [{ kind = 'noise', std = 0.1, slices = ['velocty'] }]", &["did you mean 'velocity'?"]),
        ("[[randomise]]\nwhat = 'mass'\nrange = [2, 1]", &["ordered"]),
        ("[[randomise]]\nwhat = 'mass'\nrange = [-1, 1]", &["> 0"]),
        ("[[randomise]]\nwhat = { number = 'mas' }\nrange = [1, 2]", &["no physical number is called 'mas'", "'mass'"]),
    ];
    for (text, wanted) in cases {
        let began = Instant::now();
        let error =
            EnvConfig::from_toml(text, "bomb.toml").and_then(|c| Env::make("Hover", &c)).unwrap_err().to_string();
        let took = began.elapsed().as_millis();
        for part in *wanted {
            assert!(error.contains(part), "{text}: {error}");
        }
        assert!(took <= 10, "{text}: {took} ms");
    }
    let error = Env::make("Hovr", &EnvConfig::default()).unwrap_err().to_string();
    assert!(error.contains("did you mean 'Hover'?"), "{error}");
}

#[test]
fn a_history_that_would_not_fit_is_refused_before_it_is_allocated() {
    let text = "n_env = 10000000\nobservation = [{ kind = 'history', steps = 256 }]";
    let error = Env::make("Hover", &EnvConfig::from_toml(text, "big").unwrap()).unwrap_err().to_string();
    assert!(error.contains("n_env is 10000000") && error.contains("GiB"), "{error}");
}

#[test]
fn wrong_lengths_and_early_steps_are_errors() {
    let mut env = Env::make("Hover", &config(8, 50)).unwrap();
    let mut out = Buffers::new(env.spec());
    let early = env.step(&[0.0; 32], &mut out.out()).unwrap_err().to_string();
    assert!(early.contains("reset"), "{early}");
    env.reset(None, None, &mut out.out()).unwrap();
    assert!(env.step(&[0.0; 31], &mut out.out()).unwrap_err().to_string().contains("length of actions is 31"));
    let mut short = out.clone();
    short.reward.pop();
    assert!(env.step(&[0.0; 32], &mut short.out()).unwrap_err().to_string().contains("length of reward is 7"));
    let mut lean = out.clone();
    (lean.info, lean.final_observation) = (Vec::new(), Vec::new());
    env.step(&[0.0; 32], &mut lean.out()).unwrap();
    assert!(env.reset(Some(&[true; 3]), None, &mut out.out()).is_err());
    assert!(env.set_state(0, &[f32::NAN; 17]).is_err());
}

#[test]
fn damaged_or_foreign_bytes_are_refused_and_change_nothing() {
    let mut env = Env::make("Hover", &config(70, 50)).unwrap();
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let saved = env.save();
    let mut stream = Stream::new(3, 0, 0, Purpose::user(3));
    for _ in 0..200 {
        let mut bytes = saved.clone();
        let at = stream.below(bytes.len() as u64) as usize;
        bytes[at] ^= 1 << stream.below(8);
        assert!(env.load(&bytes).is_err());
        bytes.truncate(at);
        assert!(env.load(&bytes).is_err());
    }
    assert!(env.save() == saved);
    let mut other = Env::make("Hover", &EnvConfig { dt: 0.01, ..config(70, 50) }).unwrap();
    assert!(other.load(&saved).unwrap_err().to_string().contains("not of this configuration"));
    env.load(&saved).unwrap();
}

#[test]
fn a_staggered_batch_does_not_run_out_of_time_at_once() {
    let base = EnvConfig { stagger: true, autoreset: Autoreset::SameStep, ..config(512, 50) };
    let mut env = Env::make("Hover", &base).unwrap();
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let mut counts = Vec::new();
    for _ in 0..50 {
        env.step(&vec![f32::NAN; 2048], &mut out.out()).unwrap();
        counts.push(out.truncated.iter().filter(|t| **t == 1).count());
    }
    assert!(counts.iter().all(|n| *n < 60) && counts.iter().sum::<usize>() > 300, "{counts:?}");
}
