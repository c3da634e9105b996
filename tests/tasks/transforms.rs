//! Distributions and curricula.

use crate::config;
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{Buffers, Distribution, Env, EnvConfig, Randomisation, RandomisedQuantity};

fn stepped(mut env: Env, steps: usize) -> (Env, Buffers) {
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let mut actions = vec![0.0; env.spec().n_env * 4];
    for t in 0..steps {
        env.sample(t as u64, &mut actions);
        env.step(&actions, &mut out.out()).unwrap();
    }
    (env, out)
}

/// Masses over nominal ones in 4 000 first episodes.
fn masses(distribution: Distribution, difficulty: f64) -> Vec<f64> {
    let change = Randomisation { distribution, ..Randomisation::scale(RandomisedQuantity::Mass, 0.5, 2.0) };
    let config = EnvConfig { n_env: 4000, randomise: Some(vec![change]), ..EnvConfig::default() };
    let mut env = Env::make("Hover", &config).unwrap();
    env.set_difficulty(difficulty).unwrap();
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let nominal = env.robot().parameters()[1];
    (0..4000).map(|i| env.parameters(i).unwrap()[1] / nominal).collect()
}

#[test]
fn distributions_have_the_moments_they_promise() {
    let moments = |x: &[f64]| {
        let mean = x.iter().sum::<f64>() / x.len() as f64;
        (mean, (x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / x.len() as f64).sqrt())
    };
    // a normal draw within ±2σ has 0.8796 σ
    let ln2 = 2.0_f64.ln();
    for (distribution, mean, deviation) in [
        (Distribution::Uniform, 1.25, 1.5 / 12.0_f64.sqrt()),
        (Distribution::Normal, 1.25, 0.375 * 0.8796),
        (Distribution::LogUniform, 1.5 / (2.0 * ln2), 0.4247),
    ] {
        let x = masses(distribution, 1.0);
        assert!(x.iter().all(|x| (0.5..=2.0 + 1e-6).contains(x)));
        let (m, d) = moments(&x);
        println!("{distribution:?}: mean {m:.4} of {mean:.4}, deviation {d:.4} of {deviation:.4}");
        // four standard errors of 4 000 draws, at most 0.027
        assert!((m - mean).abs() < 0.028 && (d - deviation).abs() < 0.02, "{distribution:?}: {m}, {d}");
    }
}

#[test]
fn difficulty_takes_its_share_of_every_change() {
    let (none, half, all) =
        (masses(Distribution::Uniform, 0.0), masses(Distribution::Uniform, 0.5), masses(Distribution::Uniform, 1.0));
    assert!(none.iter().all(|x| (x - 1.0).abs() < 1e-6));
    for (h, a) in half.iter().zip(&all) {
        assert!((h - (1.0 + 0.5 * (a - 1.0))).abs() < 1e-6);
    }
}

#[test]
fn difficulty_is_part_of_the_saved_state() {
    let change = Randomisation::scale(RandomisedQuantity::Mass, 0.5, 2.0);
    let config = EnvConfig { randomise: Some(vec![change]), ..config(64, 10) };
    let (mut env, _) = stepped(Env::make("Hover", &config).unwrap(), 3);
    env.set_difficulty(0.25).unwrap();
    let saved = env.save();
    let go_on = |mut env: Env| {
        let mut out = Buffers::new(env.spec());
        for _ in 0..30 {
            env.step(&[0.0; 256], &mut out.out()).unwrap();
        }
        out.privileged
    };
    let mut other = Env::make("Hover", &config).unwrap();
    other.load(&saved).unwrap();
    assert_eq!(go_on(env), go_on(other));
    assert!(Env::make("Hover", &config).unwrap().set_difficulty(1.5).is_err());
}

#[test]
fn privileged_numbers_are_of_the_order_of_one() {
    for task in ["HoverRand", "TrackRand"] {
        for vehicle in ["hummingbird", "crazyflie", "firefly"] {
            let text = "observation = [{ kind = 'privileged' }]";
            let mut own = EnvConfig { n_env: 256, ..EnvConfig::from_toml(text, "seen").unwrap() };
            own.task.insert("vehicle".into(), vehicle.into());
            let mut env = Env::make(task, &own).unwrap();
            let mut out = Buffers::new(env.spec());
            env.reset(None, None, &mut out.out()).unwrap();
            let (n, names) = (env.spec().n_observation, &env.spec().privileged);
            for row in out.observation.chunks(n) {
                for (x, (name, nominal)) in row[n - names.len()..].iter().zip(names) {
                    // a hidden box of 10 cm on a Crazyflie: 20.5
                    assert!(x.abs() < 30.0, "{task}, {vehicle}: {name} is {x}, nominally {nominal}");
                }
            }
            let slices = &env.spec().observation;
            assert!(slices.iter().any(|s| s.name == "mass" && s.unit == "ratio to nominal"));
            assert!(slices.iter().any(|s| s.name == "center_of_mass_x" && s.unit == "as it is"));
        }
    }
}

#[test]
fn inertias_that_are_drawn_are_those_of_bodies() {
    let text = "
        n_env = 4000
        [[randomise]]
        what = 'inertia'
        range = [0.026, 1.974]
        each = true
        [[randomise]]
        what = { number = 'inertia_zz' }
        range = [0.1, 10.0]
        [[randomise]]
        what = { number = 'inertia_xy' }
        by = 'add'
        range = [-0.01, 0.01]
    ";
    let mut env = Env::make("Hover", &EnvConfig::from_toml(text, "bodies").unwrap()).unwrap();
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    for i in 0..4000 {
        let p = env.parameters(i).unwrap();
        let j = nalgebra::Matrix3::new(p[5], p[8], p[9], p[8], p[6], p[10], p[9], p[10], p[7]);
        let mut moments: Vec<f64> = j.symmetric_eigenvalues().iter().copied().collect();
        moments.sort_by(f64::total_cmp);
        assert!(moments[0] > 0.0 && moments[2] <= (moments[0] + moments[1]) * (1.0 + 1e-5), "{i}: {moments:?}");
    }
}

#[test]
fn rotors_start_at_the_speed_that_carries_the_weight_drawn() {
    let text = "
        n_env = 500
        [[randomise]]
        what = 'mass'
        range = [0.6, 1.4]
        [[randomise]]
        what = 'thrust'
        range = [0.8, 1.2]
        each = true
    ";
    for task in ["Hover", "PayloadHover", "TransportHover"] {
        let mut env = Env::make(task, &EnvConfig::from_toml(text, "hover").unwrap()).unwrap();
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let names = env.robot().parameter_names();
        let ends = |end: &'static str| names.iter().enumerate().filter(move |(_, n)| n.rsplit('.').next() == Some(end));
        for i in 0..500 {
            let (p, x) = (env.parameters(i).unwrap(), env.state(i).unwrap());
            let weight: f64 = p[0] * ends("mass").map(|(k, _)| p[k]).sum::<f64>();
            let speeds = env.robot().drones().iter().flat_map(|d| d.rotors.iter().map(|r| f64::from(x[r.speed])));
            let lift: f64 = ends("thrust_coefficient").zip(speeds.clone()).map(|((k, _), s)| p[k] * s * s).sum();
            let fastest = ends("max_speed").zip(speeds).all(|((k, _), s)| s <= p[k] * (1.0 + 1e-6));
            assert!(fastest && (lift / weight - 1.0).abs() < 1e-4, "{task} {i}: {lift} N for {weight} N");
        }
    }
}

#[test]
fn every_setting_of_an_entry_is_a_default_that_a_configuration_may_change() {
    let seen = |text: &str| {
        let own = EnvConfig::from_toml(text, "own").unwrap();
        Env::make("TrackRand", &EnvConfig { n_env: 1, ..own }).unwrap().spec().config.clone()
    };
    let plain = seen("");
    assert_eq!(plain.task["reset_distance"].as_float(), Some(0.6));
    assert!(plain.changes().len() > 5);
    let own = seen("dt = 0.01\n[[randomise]]\nwhat = 'mass'\nrange = [0.9, 1.1]\n[task]\nreset_distance = 0.7");
    // a list replaces the list
    assert_eq!((own.dt, own.changes().len(), own.task["reset_distance"].as_float()), (0.01, 1, Some(0.7)));
}

#[test]
fn a_share_of_the_episodes_is_easier_in_all_that_difficulty_moves() {
    let text = "n_env = 4000\ntask.start_ease = 0.0\ntask.max_distance = 99.0\nrandomise = [{ what = 'mass', range = [1.5, 2.0] }]";
    let usual = EnvConfig::from_toml(text, "starts and masses").unwrap();
    // how far environments start from the middle, and how much heavier they are than nominal
    let begun = |config: EnvConfig, resets: usize| -> Vec<[f64; 2]> {
        let mut env = Env::make("Hover", &config).unwrap();
        let mut out = Buffers::new(env.spec());
        (0..resets).for_each(|_| env.reset(None, None, &mut out.out()).unwrap());
        let nominal = env.robot().parameters()[1];
        (0..4000)
            .map(|i| [f64::from(env.state(i).unwrap()[0]), env.parameters(i).unwrap()[1] / nominal - 1.0])
            .collect()
    };
    let mixed = EnvConfig { difficulty: 0.8, easier: 0.4, ..usual.clone() };
    let shares = |resets: usize| -> Vec<f64> {
        let both = begun(mixed.clone(), resets).into_iter().zip(begun(usual.clone(), resets));
        both.map(|([own, mass], [full, full_mass])| {
            let share = mass / full_mass;
            // of 2.5 m, in f32: what is near the middle is no more exact
            assert!((own - share * full).abs() < 1e-6, "{own} m of {full} m, {share} of the mass"); // 7.2e-7
            share
        })
        .collect()
    };
    let first = shares(1);
    assert!(first.iter().all(|s| (0.0..0.8 + 1e-5).contains(s)));
    let easier: Vec<f64> = first.iter().copied().filter(|s| *s < 0.8 - 1e-5).collect();
    let (share, mean) = (easier.len() as f64 / 4000.0, easier.iter().sum::<f64>() / easier.len() as f64);
    println!("{share:.3} of 0.4 are easier, by {mean:.3} of 0.4");
    assert!((share - 0.4).abs() < 0.031 && (mean - 0.4).abs() < 0.024); // four standard errors
    assert!(first != shares(2), "every episode draws its own");
    assert!(begun(mixed.clone().whole_episodes(), 1) == begun(EnvConfig { easier: 0.0, ..mixed }, 1));
    let refused = Env::make("Hover", &EnvConfig { easier: 1.5, ..usual }).err().unwrap().to_string();
    assert!(refused.starts_with("easier is 1.5, but it must be within [0, 1]"), "{refused}");
}

#[test]
fn noise_of_observations_is_what_the_stream_of_each_environment_gives() {
    let (n_env, std) = (70, 0.5);
    let make = |observation: &str| {
        let mut env =
            Env::make("Hover", &EnvConfig { n_env, seed: 9, ..EnvConfig::from_toml(observation, "noise").unwrap() })
                .unwrap();
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        (env, out)
    };
    let (mut clean, mut truth) = make("");
    let (mut noisy, mut shown) = make("observation = [{ kind = 'noise', std = 0.5 }]");
    let n = clean.spec().n_observation;
    let (mut actions, mut at) = (vec![0.0; n_env * 4], vec![(1_u64, 0_u64); n_env]);
    let mut compared = [0; 2];
    for t in 0..120 {
        for (i, (episode, step)) in at.iter_mut().enumerate() {
            let key = [9, i as u64, *episode, Purpose::SENSORS.0];
            let mut stream = Stream::restore(key, 4 * n as u64 * *step);
            for k in i * n..(i + 1) * n {
                let wanted = f64::from(truth.observation[k]) + std * stream.normal();
                let off = (f64::from(shown.observation[k]) - wanted).abs();
                assert!(off < 1e-6 * (1.0 + wanted.abs()), "environment {i}, episode {episode}, step {step}: {off:e}");
            }
            compared[usize::from(*episode > 1)] += 1;
        }
        clean.sample(t, &mut actions);
        clean.step(&actions, &mut truth.out()).unwrap();
        noisy.step(&actions, &mut shown.out()).unwrap();
        for (i, (episode, step)) in at.iter_mut().enumerate() {
            let ended = truth.terminated[i] | truth.truncated[i] == 1;
            (*episode, *step) = if ended { (*episode + 1, 0) } else { (*episode, *step + 1) };
        }
    }
    // some have begun anew, others have not
    assert!(compared.iter().all(|n| *n > 100), "{compared:?}");
}
