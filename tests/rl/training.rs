//! Training as a whole: runs that stop, go on, and come to the same bits.

use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::rl::apg::ApgConfig;
use omnidrones::rl::checkpoint::{Checkpoint, Store};
use omnidrones::rl::trainer::{TrainResult, Trainer};
use omnidrones::rl::{Starts, TrainConfig, evaluate, load_policy, log};
use omnidrones::tasks::EnvConfig;
use std::ops::ControlFlow;
use std::path::Path;

const ALGORITHMS: [&str; 5] = ["apg", "shac", "ppo", "dagger", "rma"];

/// Small enough for a second, large enough to have two shards, minibatches and ends of episodes.
fn tiny(algorithm: &str) -> TrainConfig {
    let own = match algorithm {
        "ppo" => "[ppo]\nn_env = 24\nshard = 16\nsteps = 6\nminibatches = 3\nupdates = 9\nnormalise_observation = true"
            .into(),
        "dagger" => "[dagger]\nn_env = 24\nshard = 16\nsteps = 6\nminibatches = 3\nupdates = 9".into(),
        "rma" => "env.randomise = [{ what = 'mass', range = [0.8, 1.2] }]\n\
                  from_settings.apg = { n_env = 16, horizon = 6, updates = 2 }\n\
                  [dagger]\nn_env = 24\nshard = 16\nsteps = 6\nminibatches = 3\nupdates = 9"
            .into(),
        other => format!("[{other}]\nn_env = 24\nshard = 16\nhorizon = 6\nupdates = 9"),
    };
    let text = format!(
        "seed = 4\nlog_every = 2\nevaluate = {{ every = 4, envs = 8, seed = 1 }}\ncheckpoint.every = 3\n\
         {own}\nnetwork.hidden = [12]\n[env.task]\nhorizon = 20"
    );
    TrainConfig::for_task("Hover", Some(algorithm), Some((&text, "tiny"))).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

fn trainer(config: TrainConfig, threads: usize) -> Trainer {
    Trainer::new("hover", config, Threads::new(threads).unwrap()).unwrap()
}

/// Trains until `stop` updates in all are done.
fn train(mut trainer: Trainer, stop: u64) -> Result<TrainResult> {
    trainer.run(&mut |p| if p.update >= stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
}

fn newest(run: &Path) -> Checkpoint {
    Store::open(run).unwrap().latest().unwrap().expect("a checkpoint").checkpoint
}

/// Everything in a log but times.
fn course(run: &Path) -> Vec<Vec<(String, Option<f64>)>> {
    let timed = |name: &str| name.starts_with("time_") || name.contains("second");
    let line = |line: &log::Line| {
        let names = line.iter().map(|(name, _)| name).filter(|name| !timed(name));
        names.map(|name| (name.to_string(), line.get(name))).collect()
    };
    log::read(run).unwrap().iter().map(line).collect()
}

#[test]
fn a_run_that_was_dropped_and_resumed_comes_to_the_same_bits() {
    for algorithm in ALGORITHMS {
        let folder = tempfile::tempdir().unwrap();
        let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
        let told = train(trainer(tiny(algorithm), 1).in_folder(&whole, false).unwrap(), u64::MAX).unwrap();
        assert_eq!((told.updates, told.stopped), (9, false));
        for (from, stop, threads) in [(0, 3, 1), (3, 5, 2), (5, u64::MAX, 2)] {
            let again = trainer(tiny(algorithm), threads).in_folder(&parts, true).unwrap();
            assert_eq!(again.update(), from);
            drop(train(again, stop).unwrap());
        }
        let (a, b) = (newest(&whole), newest(&parts));
        assert_eq!((a.manifest.update, a.manifest.env_steps), (b.manifest.update, b.manifest.env_steps));
        assert!(a.policy == b.policy && a.state == b.state, "{}: other bits", algorithm);
    }
}

/// A tiny run of Track that begins from the policy of a run and grows harder.
fn onwards(from: &str) -> TrainConfig {
    let text = format!(
        "seed = 4\nfrom = '{from}'\nlog_every = 1\nevaluate = {{ every = 0, envs = 8, seed = 1 }}\ncheckpoint.every = 2\n\
         curriculum = {{ from = 0.0, episodes = 10, step = 0.2, full = 1.0 }}\n\
         [apg]\nn_env = 24\nshard = 16\nhorizon = 6\nupdates = 9\n[env.task]\nhorizon = 20\nreset_ease = 3.0"
    );
    TrainConfig::for_task("Track", Some("apg"), Some((&text, "onwards"))).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

#[test]
fn a_run_begins_from_another_ones_policy_and_goes_on_with_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let [hover, whole, parts] = ["hover", "whole", "parts"].map(|name| folder.path().join(name));
    let mut config = tiny("apg");
    config.algorithm.get_mut::<ApgConfig>().unwrap().network.hidden = vec![64, 64];
    let first = train(trainer(config, 1).in_folder(&hover, false).unwrap(), u64::MAX).unwrap();
    let config = || onwards(&hover.display().to_string());
    let track = |threads| Trainer::new("Track", config(), Threads::new(threads).unwrap()).unwrap();
    let told = train(track(1).in_folder(&whole, false).unwrap(), u64::MAX).unwrap();
    for (stop, threads) in [(3, 1), (u64::MAX, 2)] {
        train(track(threads).in_folder(&parts, true).unwrap(), stop).unwrap();
    }
    let (a, b) = (newest(&whole), newest(&parts));
    assert!(a.policy == b.policy && a.state == b.state);
    assert_eq!(course(&whole), course(&parts));
    // nine small steps leave most weights of the first policy near where they were
    let behind = first.policy.actor().mlp.parts(first.policy.parameters());
    let ahead = told.policy.actor().mlp.parts(told.policy.parameters());
    let off = |k: usize| {
        let far = behind[k].data.iter().zip(&ahead[k].data).map(|(a, b)| (a - b).abs());
        far.sum::<f32>() / behind[k].data.len() as f32
    };
    assert!(off(2) < 0.05, "{}", off(2)); // measured below
    let random = train(trainer_of_track(), u64::MAX).unwrap();
    assert_ne!(random.policy.parameters(), told.policy.parameters());
    let safe = |name: &str, stop| {
        let run = Trainer::new("Track", onwards("safe_command"), Threads::new(1).unwrap()).unwrap();
        train(run.in_folder(folder.path().join(name), true).unwrap(), stop).unwrap()
    };
    let (at_once, _) = (safe("safe", u64::MAX), safe("safe-parts", 3));
    assert_eq!(at_once.policy.parameters(), safe("safe-parts", u64::MAX).policy.parameters());
    assert_ne!(random.policy.parameters(), at_once.policy.parameters());
    let difficulty: Vec<f64> = log::read(&whole).unwrap().iter().filter_map(|line| line.get("difficulty")).collect();
    assert!(difficulty.len() == 9 && difficulty.is_sorted() && difficulty[8] == 1.0, "{difficulty:?}");
}

fn trainer_of_track() -> Trainer {
    Trainer::new("Track", TrainConfig { from: String::new(), ..onwards("") }, Threads::new(1).unwrap()).unwrap()
}

#[test]
fn a_policy_to_begin_from_is_trained_first_where_no_run_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let track = Trainer::new("Track", onwards("Hover/apg"), Threads::default()).unwrap();
    let mut seen = Vec::new();
    let told = track.in_folder(&run, false).unwrap().run(&mut |p| {
        if seen.last() != Some(&p.config.task) {
            seen.push(p.config.task.clone());
        }
        ControlFlow::Continue(())
    });
    let told = told.unwrap();
    assert_eq!(seen, ["Hover", "Track"]);
    let first = newest(&run.join("from")).manifest;
    assert_eq!((first.task.as_str(), first.seed), ("Hover", 4));
    assert_eq!(told.env_steps, first.env_steps + 9 * 24 * 6);
    assert!(told.seconds > first.seconds);
    for (from, told) in
        [("Hovr", "did you mean 'Hover'?"), ("runs/nowhere/at-all", "the folder of a run, or Task/algorithm")]
    {
        let track = Trainer::new("Track", onwards(from), Threads::default()).unwrap();
        let other = folder.path().join("other");
        let error = track.in_folder(&other, false).err().expect("a refusal").to_string();
        assert!(error.contains(told) && !other.exists(), "{error}");
    }
}

#[test]
fn what_is_trained_first_takes_settings_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let [run, other] = ["run", "other"].map(|name| folder.path().join(name));
    let of = |from: &str| {
        let from_settings = toml::from_str("apg.updates = 2").unwrap();
        TrainConfig { from: from.into(), from_settings, ..onwards("Hover/apg") }
    };
    let track = |from: &str| Trainer::new("Track", of(from), Threads::default());
    track("Hover/apg").unwrap().in_folder(&run, false).unwrap().run(&mut |_| ControlFlow::Continue(())).unwrap();
    let first = run.join("from");
    assert_eq!(newest(&first).manifest.update, 2);
    let there = track(first.to_str().unwrap()).unwrap().in_folder(&other, false).err().unwrap().to_string();
    assert!(there.contains("Leave from_settings out"), "{there}");
    let nothing = track("").err().unwrap().to_string();
    assert!(nothing.contains("from is '', but it must be a task where there are from_settings"), "{nothing}");
}

const OF_MASSES: &str = "env = { randomise = [{ what = 'mass', range = [0.8, 1.2] }], task.horizon = 20 }\n\
                         evaluate = { every = 0, envs = 8, seed = 1 }";

/// Three updates of a student of varied masses.
fn student(settings: &str) -> TrainConfig {
    let own = "n_env = 24\nshard = 16\nsteps = 6\nminibatches = 3\nupdates = 3\nnetwork.hidden = [12]";
    let text = format!("{settings}\n{OF_MASSES}\n[dagger]\n{own}");
    TrainConfig::for_task("Hover", Some("rma"), Some((&text, "student"))).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

#[test]
fn a_teacher_that_is_there_teaches_and_goes_on_only_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let [there, run] = ["there", "run"].map(|name| folder.path().join(name));
    let teacher = |seed: u64| {
        let own = "n_env = 16\nhorizon = 6\nupdates = 2\nnetwork.hidden = [12]\n\
                   network.encoder = [{ kind = 'mlp', group = 'parameters', units = [32, 8] }]";
        let text = format!("seed = {seed}\nobservation = [{{ kind = 'privileged' }}]\n{OF_MASSES}\n[apg]\n{own}");
        let config = TrainConfig::for_task("Hover", Some("apg"), Some((&text, "teacher"))).unwrap();
        train(trainer(config, 1).in_folder(&there, false).unwrap(), u64::MAX).unwrap();
    };
    teacher(4);
    let of = || trainer(student(&format!("from = '{}'", there.display())), 1);
    assert_eq!(train(of().in_folder(&run, false).unwrap(), 1).unwrap().updates, 1);
    std::fs::remove_dir_all(&there).unwrap();
    teacher(5);
    let other = of().in_folder(&run, true).err().unwrap().to_string();
    assert!(other.contains("the one that it was begun with"), "{other}");
    std::fs::remove_dir_all(&there).unwrap();
    teacher(4);
    assert_eq!(train(of().in_folder(&run, true).unwrap(), u64::MAX).unwrap().updates, 3);
    // who is done needs no teacher
    std::fs::remove_dir_all(&there).unwrap();
    assert!(load_policy(&run).is_ok());
}

#[test]
fn a_teacher_that_does_not_fit_is_refused_before_it_is_trained() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let refused = |config: TrainConfig| {
        let told = trainer(config, 1).in_folder(&run, false).err().unwrap().to_string();
        assert!(!run.exists(), "{told}");
        told
    };
    let told = |of: &str, network: &str| {
        let seen = "observation = [{ kind = 'privileged' }]";
        refused(student(&format!("from = '{of}'\nfrom_settings = {{ {seen}, apg.network = {{ {network} }} }}")))
    };
    let reads = |units: &str| format!("encoder = [{{ kind = 'mlp', group = 'parameters', units = [{units}] }}]");
    let elu = told("/apg", &format!("activation = 'elu', {}", reads("4, 8")));
    assert!(elu.contains("policy of the teacher is unlike the student's"), "{elu}");
    assert!(told("/apg", &reads("4, 7")).contains("policy of the teacher is unlike the student's"));
    assert!(told("/apg", "").contains("encoders of a policy whose latent is imitated is 0"));
    assert!(told("Track/apg", &reads("4, 8")).contains("task of the teacher is Track"));
    let same = TrainConfig::for_task("Hover", Some("rma"), Some(("", "none"))).unwrap();
    assert!(refused(same).contains("group 'parameters' is empty"));
    let decays = "[dagger]\nadam.weight_decay = 0.1";
    let decays = TrainConfig::for_task("HoverRand", Some("rma"), Some((decays, "decays"))).unwrap_err().to_string();
    assert!(decays.contains("adam.weight_decay is 0.1, but it must be 0 where a latent is imitated"), "{decays}");
}

#[test]
fn work_since_the_last_checkpoint_is_done_again_and_the_log_tells_it_once() {
    for algorithm in ALGORITHMS {
        let folder = tempfile::tempdir().unwrap();
        let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
        train(trainer(tiny(algorithm), 2).in_folder(&whole, false).unwrap(), u64::MAX).unwrap();
        let mut lost = trainer(tiny(algorithm), 2).in_folder(&parts, false).unwrap();
        // as a kill: what comes behind the watched update never happens
        let killed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            lost.run(&mut |p| {
                if p.update == 5 { std::panic::resume_unwind(Box::new(())) } else { ControlFlow::Continue(()) }
            })
        }));
        assert!(killed.is_err());
        drop(lost);
        let again = trainer(tiny(algorithm), 1).in_folder(&parts, true).unwrap();
        assert_eq!(again.update(), 3);
        train(again, u64::MAX).unwrap();
        assert!(newest(&whole).state == newest(&parts).state, "{}", algorithm);
        assert_eq!(course(&whole), course(&parts), "{}", algorithm);
    }
}

#[test]
fn neither_folder_nor_threads_nor_evaluations_change_the_policy() {
    let plain = train(trainer(tiny("apg"), 1), u64::MAX).unwrap();
    let mut config = tiny("apg");
    (config.evaluate.every, config.log_every) = (0, 1);
    let folder = tempfile::tempdir().unwrap();
    let kept = train(trainer(config, 2).in_folder(folder.path().join("run"), false).unwrap(), u64::MAX).unwrap();
    assert_eq!(plain.policy.parameters(), kept.policy.parameters());
    assert_eq!(plain.evaluation, kept.evaluation);
    assert_eq!((plain.curve.len(), kept.curve.len()), (5, 9)); // 2, 4, 6, 8, 9 and 1 … 9
}

#[test]
fn json_and_table_of_a_run_tell_the_same() {
    let folder = tempfile::tempdir().unwrap();
    train(trainer(tiny("ppo"), 1).in_folder(folder.path(), false).unwrap(), u64::MAX).unwrap();
    let text = std::fs::read_to_string(folder.path().join(log::JSON)).unwrap();
    let lines: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let table = log::read(folder.path()).unwrap();
    assert_eq!((lines.len(), table.len()), (6, 6)); // 2, 3, 4, 6, 8, 9
    for (json, row) in lines.iter().zip(&table) {
        assert_eq!(json.as_object().unwrap().len(), row.iter().count());
        for (name, _) in row.iter() {
            assert_eq!(json[name].as_f64(), row.get(name), "{name}");
        }
        let phases: f64 = row.iter().filter(|(name, _)| name.starts_with("time_")).map(|(_, share)| share).sum();
        assert!((phases - 1.0).abs() < 1e-9);
    }
    let last = &lines[lines.len() - 1];
    assert!(last["update"] == 9 && last["eval_return"].is_number() && lines[0]["eval_return"].is_null(), "{last}");
}

#[test]
fn a_saved_policy_flies_as_the_trained_one() {
    for algorithm in ALGORITHMS {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path();
        let told = train(trainer(tiny(algorithm), 2).in_folder(run, false).unwrap(), u64::MAX).unwrap();
        for path in [run, &told.checkpoint.clone().unwrap()] {
            let mut saved = load_policy(path).unwrap();
            assert_eq!((saved.manifest.update, saved.skipped.len()), (9, 0));
            assert_eq!(saved.policy.parameters(), told.policy.parameters());
            let (starts, env) = (Starts { n_env: 8, seed: 1 }, saved.config.seen_env());
            let flown = evaluate(&mut saved.policy, "Hover", &env, starts, &Threads::default(), &mut |_| {}).unwrap();
            assert_eq!(flown, told.evaluation, "{}", algorithm);
        }
    }
}

#[test]
fn a_damaged_checkpoint_is_passed_over_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path();
    let told = train(trainer(tiny("apg"), 1).in_folder(run, false).unwrap(), u64::MAX).unwrap();
    let newest_state = told.checkpoint.unwrap().join("state.safetensors");
    let mut bytes = std::fs::read(&newest_state).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&newest_state, bytes).unwrap();
    let saved = load_policy(run).unwrap();
    assert_eq!((saved.manifest.update, saved.skipped.len()), (6, 1));
    assert!(saved.skipped[0].why.to_string().contains("SHA-256"), "{}", saved.skipped[0].why);
    let again = trainer(tiny("apg"), 1).in_folder(run, true).unwrap();
    assert_eq!((again.update(), again.skipped().len()), (6, 1));
    let twice = train(again, u64::MAX).unwrap();
    assert_eq!(twice.policy.parameters(), told.policy.parameters());
}

#[test]
fn a_folder_holds_one_run_with_one_set_of_settings() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path();
    train(trainer(tiny("apg"), 1).in_folder(run, false).unwrap(), 3).unwrap();
    let refused = |config: TrainConfig, resume| trainer(config, 1).in_folder(run, resume).err().unwrap().to_string();
    assert!(
        refused(tiny("apg"), false).contains("which holds a run already, but it must be new. Go on with it (--resume)")
    );
    for config in [tiny("ppo"), TrainConfig { seed: 5, ..tiny("apg") }] {
        assert!(refused(config, true).contains("those that it was begun with"));
    }
    let longer = TrainConfig { log_every: 1, ..tiny("apg") }.with_updates(12);
    let told = train(trainer(longer, 1).in_folder(run, true).unwrap(), u64::MAX).unwrap();
    assert_eq!((told.updates, newest(run).manifest.update), (12, 12));
}

#[test]
fn a_run_that_is_over_is_evaluated_again_and_nothing_more() {
    let folder = tempfile::tempdir().unwrap();
    let run = || trainer(tiny("shac"), 1).in_folder(folder.path(), true).unwrap();
    let first = train(run(), u64::MAX).unwrap();
    let lines = log::read(folder.path()).unwrap();
    let again = train(run(), u64::MAX).unwrap();
    assert_eq!((again.updates, &again.evaluation), (9, &first.evaluation));
    assert_eq!(log::read(folder.path()).unwrap(), lines);
    assert_eq!(again.curve, lines);
}

#[test]
fn a_stop_is_kept_and_evaluated() {
    let folder = tempfile::tempdir().unwrap();
    let told = train(trainer(tiny("apg"), 1).in_folder(folder.path(), false).unwrap(), 5).unwrap();
    assert_eq!((told.updates, told.stopped, newest(folder.path()).manifest.update), (5, true, 5));
    assert_eq!(told.curve.last().unwrap().get("update"), Some(5.0));
    assert_eq!(told.evaluation.n_episode, 8);
}

#[test]
fn a_run_is_not_made_shorter_than_it_is_and_not_of_another_task() {
    let folder = tempfile::tempdir().unwrap();
    train(trainer(tiny("apg"), 1).in_folder(folder.path(), false).unwrap(), u64::MAX).unwrap();
    let refused = |config: TrainConfig| trainer(config, 1).in_folder(folder.path(), true).err().unwrap().to_string();
    let shorter = refused(tiny("apg").with_updates(4));
    assert!(shorter.contains("number of updates is 4, but it must be ≥ 9"), "{shorter}");
    let other = refused(TrainConfig { seed: 5, ..tiny("apg") });
    assert!(other.contains("differ from those that it was begun with (seed is 5, was 4)"), "{other}");
    let again = trainer(tiny("apg"), 1).in_folder(folder.path(), true).unwrap();
    assert!(again.is_over() && !trainer(tiny("apg"), 1).is_over());
    let track = Trainer::new("Track", tiny("apg"), Threads::default()).err().unwrap().to_string();
    assert!(track.contains("task of the settings is Hover, but it must be Track"), "{track}");
}

#[test]
fn environments_that_a_policy_does_not_fit_are_refused_by_what_differs() {
    let folder = tempfile::tempdir().unwrap();
    train(trainer(tiny("apg"), 1).in_folder(folder.path(), false).unwrap(), 3).unwrap();
    let saved = load_policy(folder.path()).unwrap();
    let own = saved.config.seen_env();
    assert!(saved.check(&own).is_ok());
    let with = |text: &str| {
        let mut env = own.clone();
        let asked = EnvConfig::from_toml(text, "asked").unwrap();
        (env.control, env.dt) = (asked.control, asked.dt);
        env.task.extend(asked.task);
        saved.check(&env).err().map(|error| error.to_string())
    };
    assert_eq!(with("task.vehicle = 'crazyflie'"), None);
    for (text, words) in [
        ("task.vehicle = 'firefly'", "32 numbers in an observation, not 30; 6 numbers in an action, not 4"),
        ("task.vehicle = 'firefly'", "task.vehicle is \"firefly\", was the task's own"),
        ("control = 'rate'", "commands rate_x, rate_y, rate_z, thrust, not rotor_0"),
        ("control = 'rate'", "control is \"rate\", was \"rotor\""),
        ("dt = 0.02", "steps of 0.02 s, not 0.016 s"),
    ] {
        let refusal = with(text).unwrap();
        assert!(refusal.contains(words), "{text}: {refusal}");
    }
    let empty = tempfile::tempdir().unwrap();
    for (path, lack) in [
        (empty.path().to_path_buf(), "which holds no checkpoint"),
        (empty.path().join("nowhere"), "which does not exist"),
    ] {
        let refusal = load_policy(path).unwrap_err().to_string();
        assert!(refusal.contains(lack) && refusal.contains("Train one"), "{refusal}");
    }
}
