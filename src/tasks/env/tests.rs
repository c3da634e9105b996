//! What only shows from inside.

use super::block::episode_state;
use super::episode_start::EpisodeStart;
use super::*;
use crate::config::{Autoreset, MAX_HORIZON};
use crate::registry::names;
use crate::start::Streams;
use autodiff::trace::on_constants;
use autodiff::{Scalar, Trace};

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

/// A start as its recording says it, on plain numbers.
fn start_in_plain_numbers(core: &Core, key: [u64; 3]) -> EpisodeStart {
    on_constants(|| {
        let (robot, difficulty) = (core.robot(), Trace::constant(core.difficulty));
        let mut draft = EpisodeStart::<Trace>::new(robot, core.sizes.goal, core.sizes.task_state);
        let source = Streams::of_start(key);
        draft.begin((robot, &core.randomiser), &source, difficulty, |start| core.task.start(start));
        draft.known()
    })
}

#[test]
fn starts_of_every_task_are_those_of_plain_numbers() {
    let changed = "seed = 5\ndifficulty = 0.7\n[[randomise]]\nwhat = 'mass'\nrange = [0.7, 1.3]\neach = true";
    let along = ["Track", "PayloadTrack", "InvPendulumTrack", "TransportTrack", "FlyThrough", "PayloadFlyThrough"];
    let along = along.map(|name| (name, "seed = 5\n[task]\nstart_along = 0.5"));
    let usual = names().into_iter().flat_map(|name| ["seed = 5", changed].map(|text| (name, text)));
    for (name, text) in usual.chain(along) {
        let config = EnvConfig { n_env: 70, ..EnvConfig::from_toml(text, "text").unwrap() };
        let mut env = Env::make(name, &config).unwrap();
        if env.core.task.start_on_host().is_some() {
            continue;
        }
        let mut out = Buffers::new(env.spec());
        // the second episode of each
        (0..2).for_each(|_| env.reset(None, None, &mut out.out()).unwrap());
        let (core, mut off) = (&env.core, 0.0_f64);
        for i in 0..70 {
            let (block, lane, own) =
                (&env.blocks[i / BLOCK], i % BLOCK, start_in_plain_numbers(core, [5, i as u64, 2]));
            let kept = &core.layout.kept;
            let theta: Vec<f64> = core.varied.iter().map(|k| own.numbers[*k]).collect();
            let pairs = [
                (&block.plant.rows[..core.plant.n_state()], &own.state),
                (kept.goal.of(&block.kept), &own.goal),
                (kept.task_state.of(&block.kept), &own.task_state),
                (kept.theta.of(&block.kept), &theta),
            ];
            for (row, x) in pairs.into_iter().flat_map(|(rows, numbers)| rows.iter().zip(numbers)) {
                off = off.max((f64::from(row[lane]) - x).abs() / x.abs().max(1.0));
            }
        }
        println!("{name}: {off:.1e}");
        // 5.4e-7; 6.7e-6 along a path, whose phase is several radians
        assert!(off < if text.contains("along") { 1e-5 } else { 1e-6 }, "{name} with {text}: {off:e}");
    }
}
/// Seventy environments that tell these columns.
fn telling(task: &str, info: Option<&[&str]>, more: &str) -> Env {
    let info = info.map(|names| names.iter().map(|name| (*name).into()).collect());
    let config = EnvConfig { info, ..EnvConfig::from_toml(more, "more").unwrap() };
    Env::make(task, &EnvConfig { n_env: 70, seed: 4, stagger: true, ..config }).unwrap()
}

/// A column by its name.
fn told(env: &Env, out: &Buffers, name: &str) -> Vec<u32> {
    let k = env.spec().info_column(name).unwrap();
    out.info.chunks_exact(env.spec().info.len()).map(|row| row[k].to_bits()).collect()
}

#[test]
fn columns_that_are_left_out_change_no_bit_of_what_is_told() {
    // a success that holds for a while, a state of the task, a team, actions that host code decodes
    let discrete = "actions = { kind = 'multi_discrete', levels = 3 }";
    for (task, more) in [("Hover", ""), ("Hover", discrete), ("Track", "delay = { max = 2 }"), ("Formation", "")] {
        let all = telling(task, None, more);
        let metric = all.spec().info.last().unwrap().name.clone();
        let term = all.spec().reward[0].column();
        for names in [&[][..], &["length"], &[&metric, "success"], &["loss", &term, "return", "clipped"], &["reason"]] {
            let (mut all, mut some) = (telling(task, None, more), telling(task, Some(names), more));
            let (mut a, mut b) = (Buffers::new(all.spec()), Buffers::new(some.spec()));
            all.reset(None, None, &mut a.out()).unwrap();
            some.reset(None, None, &mut b.out()).unwrap();
            let mut actions = vec![0.0; 70 * all.core.sizes.action];
            for t in 0..30 {
                all.sample(t, &mut actions);
                all.step(&actions, &mut a.out()).unwrap();
                some.step(&actions, &mut b.out()).unwrap();
                for name in names {
                    assert_eq!(told(&some, &b, name), told(&all, &a, name), "{task}, {name}, step {t}");
                }
                let b = Buffers { info: a.info.clone(), ..b.clone() };
                assert!(a == b, "{task} with {names:?} differs in step {t}");
            }
        }
    }
}

#[test]
fn columns_that_are_left_out_are_neither_computed_nor_written() {
    let size = |info: Option<&[&str]>| telling("Hover", info, "").core.programs().step.size();
    let names: Vec<String> = telling("Hover", None, "").spec().info.iter().map(|info| info.name.clone()).collect();
    let all: Vec<&str> = names.iter().map(String::as_str).collect();
    let (whole, none) = (size(None), size(Some(&[])));
    // steps are counted and reasons are kept, whoever is told of them
    assert_eq!(whole.1 - none.1, all.len() - 2);
    assert!(none.0 + 60 < whole.0, "{none:?} of {whole:?}");
    for k in 0..all.len() {
        let others: Vec<&str> = all.iter().copied().filter(|name| *name != all[k]).collect();
        let left = size(Some(&others));
        assert!(
            left.0 <= whole.0 && left.1 + usize::from(!["length", "reason"].contains(&all[k])) == whole.1,
            "{}",
            all[k]
        );
    }
    assert_eq!(size(Some(&all)), whole);
}

#[test]
fn columns_stand_in_their_order_and_one_that_there_is_not_is_told_with_those_that_there_are() {
    let env = telling("Hover", Some(&["position_error", "success", "return", "success"]), "");
    let names: Vec<&str> = env.spec().info.iter().map(|info| info.name.as_str()).collect();
    assert_eq!(names, ["return", "success", "position_error"]);
    assert_eq!((env.spec().term_columns(), env.spec().metric_columns()), (2..2, 2..3));
    assert_eq!(env.spec().column(Column::Success), Some(1));
    let refusal = env.spec().needed_column(Column::Loss).unwrap_err().to_string();
    assert_eq!(
        refusal,
        "info is [return, success, position_error], but it must be with 'loss' here. Name it in `info`, or leave `info` out for all columns."
    );
    let config = EnvConfig { info: Some(vec!["returns".into()]), ..EnvConfig::default() };
    let refusal = Env::make("Hover", &config).unwrap_err().to_string();
    assert!(
        refusal.starts_with("no column of the information is called 'returns' (did you mean 'return'?)"),
        "{refusal}"
    );
    assert!(refusal.contains("position_error"), "{refusal}");
}

#[test]
fn a_state_goes_on_where_other_columns_are_told() {
    let (mut all, mut none) = (telling("Hover", None, ""), telling("Hover", Some(&[]), ""));
    let (mut a, mut b) = (Buffers::new(all.spec()), Buffers::new(none.spec()));
    all.reset(None, None, &mut a.out()).unwrap();
    none.reset(None, None, &mut b.out()).unwrap();
    let actions = vec![0.1; 4 * 70];
    for _ in 0..5 {
        all.step(&actions, &mut a.out()).unwrap();
    }
    none.load(&all.save()).unwrap();
    for _ in 0..5 {
        all.step(&actions, &mut a.out()).unwrap();
        none.step(&actions, &mut b.out()).unwrap();
        assert!(a.observation == b.observation && a.reward == b.reward);
    }
    all.load(&none.save()).unwrap();
    assert!(b.info.is_empty());
}

#[test]
fn evaluations_ask_for_all_columns() {
    let config = EnvConfig { n_env: 2, autoreset: Autoreset::Disabled, info: Some(Vec::new()), ..EnvConfig::default() };
    let fly = |config: &EnvConfig| {
        let mut env = Env::make("Hover", config).unwrap();
        let safe = &mut |_: &Env, _: &Buffers, actions: &mut [f32]| {
            actions.fill(f32::NAN);
            Ok(())
        };
        crate::evaluate(&mut env, safe, &mut |_| {})
    };
    let refusal = fly(&config).unwrap_err().to_string();
    assert_eq!(refusal, "info is [], but it must be all columns here. Leave `info` out.");
    assert!(fly(&config.whole_episodes()).is_ok());
}
