//! What only shows from inside.

use super::block::episode_state;
use super::*;
use crate::tasks::config::MAX_HORIZON;

fn hover(n_env: usize, horizon: usize) -> Env {
    let mut config = EnvConfig { n_env, ..EnvConfig::default() };
    config.task.insert("horizon".into(), (horizon as i64).into());
    Env::make("Hover", &config).unwrap()
}

#[test]
fn the_longest_episodes_are_cut_at_their_last_step() {
    for horizon in [500, 2_000_001, 10_000_000, MAX_HORIZON - 1, MAX_HORIZON] {
        let mut env = hover(1, horizon);
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let block = &mut env.blocks[0];
        assert_eq!(block.kept[episode_state::LAST][0], horizon as f32);
        block.kept[episode_state::STEP][0] = (horizon - 3) as f32;
        let cut: Vec<u8> = (0..3)
            .map(|_| {
                env.step(&[f32::NAN; 4], &mut out.out()).unwrap();
                out.truncated[0]
            })
            .collect();
        assert_eq!(cut, [0, 0, 1], "{horizon}");
    }
}

#[test]
fn episodes_truncated_at_random_have_their_mean_and_the_horizon_as_their_limit() {
    let level = "n_env = 512\nseed = 3\ntruncate_after = 20\n[task]\nhorizon = 60\nstart_tilt = 0.0";
    let truncated = EnvConfig::from_toml(level, "level starts").unwrap();
    for (config, least, mean, most) in [
        (truncated.clone(), 1, 20.0 * (1.0 - 0.95_f64.powi(60)), 60), // Σ (1 − 1/m)^k over k < T
        (EnvConfig { truncate_after: 1, ..truncated.clone() }, 1, 1.0, 1),
        (truncated.whole_episodes(), 60, 60.0, 60),
    ] {
        let mut env = Env::make("Hover", &config).unwrap();
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let (mut lengths, mut steps) = (Vec::new(), vec![0; 512]);
        let actions = vec![f32::NAN; 4 * 512];
        for _ in 0..600 {
            env.step(&actions, &mut out.out()).unwrap();
            for (i, step) in steps.iter_mut().enumerate() {
                *step += 1;
                if out.truncated[i] == 1 {
                    lengths.push(*step);
                }
                if out.truncated[i] == 1 || out.terminated[i] == 1 {
                    *step = 0;
                }
            }
        }
        assert!(lengths.iter().min() == Some(&least) && lengths.iter().max() == Some(&most), "{lengths:?}");
        let measured = lengths.iter().sum::<i32>() as f64 / lengths.len() as f64;
        assert!((measured / mean - 1.0).abs() < 0.03, "{measured} of {mean}"); // 16 000 lengths: a standard error of 0.8 %
    }
}

#[test]
fn every_thread_has_its_workspace_before_the_first_step() {
    let mut env = hover(1024, 50);
    for (threads, wanted) in [(1, 1), (2, 2), (3, 3), (1, 1), (8, 4)] {
        env.set_threads(Threads::new(threads).unwrap());
        assert_eq!(env.pool.lock().unwrap().len(), wanted);
    }
}

#[test]
fn a_state_that_another_version_saved_is_refused_by_its_format() {
    let mut env = hover(3, 50);
    env.reset(None, None, &mut Buffers::new(env.spec()).out()).unwrap();
    for format in ["1", "4", "9"] {
        let mut saved = env.save();
        saved[7] = format.as_bytes()[0];
        let refusal = env.load(&saved).unwrap_err().to_string();
        let wanted = format!("are of format {format} of another version, and this one reads format 5");
        assert!(refusal.contains(&wanted), "{refusal}");
    }
    for short in ["", "omni", "omnienv", "omnienv4"] {
        assert!(env.load(short.as_bytes()).is_err(), "{short}");
    }
}

#[test]
fn environments_of_a_kind_share_their_programs_and_others_do_not() {
    let (first, second, other) = (hover(1, 50), hover(70, 50), hover(1, 51));
    let shares = |other: &Env| first.core.programs().step.is_same(&other.core.programs().step);
    assert!(shares(&second) && !shares(&other)); // the clock is a share of the horizon
}
