//! The commands about learning as a stranger meets them: `train`, `eval`, `watch`; and runs that are killed.

use crate::command::{command, exits, json, size, temporary, widest};
use omnidrones::rl::checkpoint::{LatestCheckpoint, Store};
use omnidrones::rl::{load_policy, log};
use omnidrones::rng::{Purpose, Stream};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A run of a moment.
const TINY: [&str; 14] = [
    "train",
    "Hover",
    "--set",
    "apg.n_env=16",
    "--set",
    "apg.horizon=6",
    "--set",
    "apg.network.hidden=[8]",
    "--set",
    "env.task.horizon=30",
    "--set",
    "evaluate={every=10,envs=8}",
    "--updates",
    "20",
];

fn tiny(more: &[&'static str]) -> Vec<&'static str> {
    [&TINY[..], more].concat()
}

#[test]
fn the_files_for_forest_by_a_depth_camera_train_one_behind_the_other() {
    let folder = temporary();
    for (name, run) in [("forest_depth_apg", "Forest-apg-s0"), ("forest_depth_ppo", "Forest-ppo-s0")] {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../examples/{name}.toml"));
        let file = file.to_str().unwrap();
        let few = ["--updates", "1", "--set", "evaluate={every=0,envs=8}", "--no-plots", "--no-baseline"];
        let (page, _) = exits(0, folder.path(), &[&["train", "Forest", "--config", file], &few[..]].concat());
        // 192 depths behind what the task shows, 25 numbers
        assert!(page.contains("217 numbers in, 4 out"), "{page}");
        assert!(folder.path().join("runs").join(run).join("result.json").is_file(), "{name}");
    }
}

#[test]
fn a_run_is_trained_kept_flown_and_shown() {
    let folder = temporary();
    let folder = folder.path();
    let (page, err) = exits(0, folder, &tiny(&["--vehicle", "crazyflie"]));
    assert_eq!(err, "");
    for words in [
        "Hover · apg, seed 0, 20 updates",
        "trained in",
        "policy (apg)",
        "cascade",
        "share of bound",
        "Success, not crashed: position_error < 0.1 m and heading_alignment > 0.95 and",
        "omnidrones eval",
    ] {
        assert!(page.contains(words), "{words}\n{page}");
    }
    assert!(widest(&page) <= 120, "{page}");
    for file in
        ["curve.png", "curve.csv", "log.jsonl", "config.toml", "result.json", "checkpoints/000000020/manifest.json"]
    {
        assert!(size(folder, &format!("runs/Hover-crazyflie-apg-s0/{file}")) > 100, "{file}");
        assert!(page.contains(file.trim_end_matches("/manifest.json")), "{file}\n{page}");
    }
    let told: Value =
        serde_json::from_slice(&std::fs::read(folder.join("runs/Hover-crazyflie-apg-s0/result.json")).unwrap())
            .unwrap();
    assert_eq!((&told["updates"], &told["env_steps"]), (&20.into(), &(20 * 16 * 6).into()));
    let eval = json(folder, &["eval", "runs/Hover-crazyflie-apg-s0"]);
    assert_eq!(eval["evaluation"], told["evaluation"]);
    assert!(size(folder, "runs/Hover-crazyflie-apg-s0/eval/eval.png") > 1000);
    let certain = json(folder, &["eval", "runs/Hover-crazyflie-apg-s0/checkpoints/000000020", "--no-plots"]);
    assert_eq!(certain["evaluation"], told["evaluation"]);
    let other =
        json(folder, &["eval", "runs/Hover-crazyflie-apg-s0", "--vehicle", "hummingbird", "--no-plots", "--envs", "9"]);
    assert_eq!(other["evaluation"]["n_episode"], 9);
    let shown = json(folder, &["watch", "runs/Hover-crazyflie-apg-s0", "--envs", "2", "--out", "seen/fly.gif"]);
    assert!(shown["pictures"].as_u64().is_some_and(|n| n >= 10), "{shown}");
    for file in ["seen/fly.gif", "seen/fly.png", "seen/fly-errors.png"] {
        assert!(size(folder, file) > 1000, "{file}");
    }
    assert!(std::fs::read(folder.join("seen/fly.gif")).unwrap().starts_with(b"GIF89a"));
}

#[test]
fn the_printed_settings_make_the_same_run() {
    let folder = temporary();
    let folder = folder.path();
    let (toml, _) = exits(0, folder, &tiny(&["--control", "rate", "--seed", "3", "--toml"]));
    assert!(!folder.join("runs").exists());
    std::fs::write(folder.join("mine.toml"), &toml).expect("written");
    let plain = ["--no-plots", "--no-baseline"];
    let a = json(folder, &[&tiny(&["--control", "rate", "--seed", "3", "--out", "a"])[..], &plain].concat());
    let b = json(
        folder,
        &[&["train", "Hover", "--config", "mine.toml", "--out", "b", "--threads", "1"][..], &plain].concat(),
    );
    assert_eq!((&a["evaluation"], &a["config"], &a["seed"]), (&b["evaluation"], &b["config"], &3.into()));
    let kept: toml::Table = toml::from_str(a["config"].as_str().expect("settings")).expect("TOML");
    assert_eq!(kept, toml::from_str(&toml).expect("TOML"));
    let c = json(folder, &[&tiny(&["--control", "rate", "--seed", "4", "--out", "c"])[..], &plain].concat());
    assert_ne!(a["evaluation"], c["evaluation"]);
}

#[test]
fn a_folder_in_use_is_refused_and_resumed_on_demand() {
    let folder = temporary();
    let folder = folder.path();
    let plain = ["--no-plots", "--no-baseline"];
    json(folder, &[&tiny(&[])[..], &plain].concat());
    let (_, err) = exits(2, folder, &tiny(&[]));
    assert!(err.contains("'runs/Hover-apg-s0', which holds a run already") && err.contains("--resume"), "{err}");
    let longer = ["train", "hover", "--resume", "--updates", "30"];
    let told = json(folder, &[&longer[..], &plain].concat());
    assert_eq!((&told["updates"], &told["env_steps"]), (&30.into(), &(30 * 16 * 6).into()));
    let (_, err) = exits(2, folder, &["train", "Hover", "--resume", "--set", "apg.max_grad_norm=0.1"]);
    assert!(err.contains("those that it was begun with"), "{err}");
}

#[test]
fn files_of_others_are_kept_and_a_run_is_replaced_on_demand_alone() {
    let folder = temporary();
    let folder = folder.path();
    let plain = ["--no-plots", "--no-baseline"];
    std::fs::write(folder.join("config.toml"), "seed = 3").expect("written");
    for more in [&["--out", "."][..], &["--out", ".", "--resume"]] {
        let (_, err) = exits(2, folder, &[&tiny(&["--config", "config.toml"])[..], &plain, more].concat());
        assert!(err.contains("which holds other files (config.toml, …)") && err.contains("--force"), "{err}");
    }
    assert_eq!(std::fs::read_to_string(folder.join("config.toml")).expect("kept"), "seed = 3");
    let first = json(folder, &[&tiny(&[])[..], &plain].concat());
    let (_, err) = exits(2, folder, &[&tiny(&["--seed", "0"])[..], &plain].concat());
    assert!(err.contains("--resume") && err.contains("--force"), "{err}");
    let again = json(folder, &[&tiny(&["--force", "--set", "apg.learning_rate.from=0.02"])[..], &plain].concat());
    assert_eq!(again["was_over"], false);
    assert_ne!(first["evaluation"], again["evaluation"]);
    // a run below does not make a folder ours, and a folder of that name no run
    let (_, err) = exits(2, folder, &[&tiny(&["--out", "."])[..], &plain].concat());
    assert!(err.contains("which holds other files"), "{err}");
    std::fs::write(folder.join("drone.toml"), "mine").expect("written");
    let (_, err) = exits(2, folder, &["models", "hummingbird", "--urdf", "drone.toml"]);
    assert!(err.contains("which exists") || err.contains("drone.toml"), "{err}");
    assert_eq!(std::fs::read_to_string(folder.join("drone.toml")).expect("kept"), "mine");
    std::fs::create_dir_all(folder.join("theirs/checkpoints")).expect("made");
    std::fs::write(folder.join("theirs/checkpoints/model.pt"), "kept").expect("written");
    exits(0, folder, &[&tiny(&["--out", "theirs", "--force"])[..], &plain].concat());
    assert_eq!(std::fs::read_to_string(folder.join("theirs/checkpoints/model.pt")).expect("kept"), "kept");
    let rollout = ["rollout", "Hover", "--envs", "2", "--horizon", "3", "--out"];
    exits(0, folder, &[&rollout[..], &["new"]].concat());
    exits(0, folder, &[&rollout[..], &["new"]].concat());
    std::fs::create_dir(folder.join("mine")).expect("made");
    std::fs::write(folder.join("mine/rollout.png"), "a picture").expect("written");
    let (_, err) = exits(2, folder, &[&rollout[..], &["mine"]].concat());
    assert!(err.contains("new, empty or made by omnidrones"), "{err}");
    assert_eq!(size(folder, "mine/rollout.png"), 9);
    exits(0, folder, &[&rollout[..], &["mine", "--force"]].concat());
    assert!(size(folder, "mine/rollout.png") > 1000);
}

#[test]
fn a_run_with_a_vehicle_of_a_file_needs_the_file_no_more() {
    let folder = temporary();
    let folder = folder.path();
    let (own, _) = exits(0, folder, &["models", "crazyflie", "--toml"]);
    std::fs::write(folder.join("mine.toml"), own.replace("name = \"crazyflie\"", "name = \"mine\"")).expect("written");
    let plain = ["--no-plots", "--no-baseline"];
    let mine = json(folder, &[&tiny(&["--vehicle", "mine.toml"])[..], &plain].concat());
    let known = json(folder, &[&tiny(&["--vehicle", "crazyflie"])[..], &plain].concat());
    assert_eq!(mine["evaluation"], known["evaluation"], "the same numbers fly the same");
    exits(0, folder, &["rollout", "Hover", "--vehicle", "mine.toml", "--envs", "2", "--horizon", "3", "--no-plots"]);
    std::fs::remove_file(folder.join("mine.toml")).expect("removed");
    let run = "runs/Hover-mine-apg-s0";
    let eval = json(folder, &["eval", run, "--no-plots"]);
    assert_eq!(eval["evaluation"], mine["evaluation"]);
    let longer = json(folder, &[&["train", "Hover", "--resume", "--updates", "30", "--out", run][..], &plain].concat());
    assert_eq!(longer["updates"], 30);
}

#[test]
fn a_run_shorter_than_its_recipe_says_so_and_mappo_is_called_mappo() {
    let folder = temporary();
    let (page, _) = exits(0, folder.path(), &tiny(&["--no-plots", "--no-baseline"]));
    assert!(page.contains("The recipe trains for 1000 updates"), "{page}");
    let small = ["--set", "ppo.n_env=8", "--set", "ppo.steps=4", "--set", "ppo.minibatches=2", "--set", "horizon=10"];
    let rest = ["--set", "evaluate={every=0,envs=4}", "--updates", "1", "--no-plots", "--no-baseline"];
    let (page, _) = exits(0, folder.path(), &[&["train", "OverHover", "--algo", "mappo"][..], &small, &rest].concat());
    assert!(page.contains("OverHover · mappo") && page.contains("runs/OverHover-mappo-s0"), "{page}");
}

#[test]
fn a_run_that_is_over_says_so_and_goes_no_shorter() {
    let folder = temporary();
    let folder = folder.path();
    let plain = ["--no-plots", "--no-baseline"];
    let first = json(folder, &[&tiny(&[])[..], &plain].concat());
    let (page, _) = exits(0, folder, &[&tiny(&["--resume"])[..], &plain].concat());
    assert!(page.contains("This run was over: update 20 of 20. Nothing was trained"), "{page}");
    let again = json(folder, &[&["train", "Hover", "--resume"][..], &plain].concat());
    assert_eq!((&first["was_over"], &again["was_over"]), (&false.into(), &true.into()));
    assert_eq!(first["evaluation"], again["evaluation"]);
    for (more, words) in [
        (
            &["--resume", "--set", "apg.horizon=7", "--seed", "1", "--out", "runs/Hover-apg-s0"][..],
            "apg.horizon is 7, was 6",
        ),
        (&["--resume", "--seed", "1", "--out", "runs/Hover-apg-s0"], "begun with (seed is 1, was 0)"),
    ] {
        let (_, err) = exits(2, folder, &tiny(more));
        assert!(err.contains(words), "{more:?}: {err}");
    }
    let (_, err) = exits(2, folder, &["train", "Hover", "--resume", "--updates", "10"]);
    assert!(err.contains("number of updates is 10, but it must be ≥ 20"), "{err}");
    let (_, err) = exits(2, folder, &["train", "Track", "--resume", "--out", "runs/Hover-apg-s0"]);
    assert!(err.contains("task of the settings is Hover, but it must be Track"), "{err}");
}

#[test]
fn a_policy_that_does_not_fit_is_refused_by_what_differs_and_runs_that_exist_are_named() {
    let folder = temporary();
    let folder = folder.path();
    let (_, err) = exits(2, folder, &["eval", "nowhere"]);
    assert!(err.contains("which does not exist") && err.contains("Train one: omnidrones train TASK"), "{err}");
    json(folder, &tiny(&["--no-plots", "--no-baseline"]));
    for command in ["eval", "watch"] {
        let (_, err) = exits(2, folder, &[command, "Hover-apg-s0"]);
        assert!(
            err.contains("'Hover-apg-s0', which does not exist") && err.contains("There are runs/Hover-apg-s0"),
            "{err}"
        );
        for (options, words) in [
            ("--vehicle firefly", "32 numbers in an observation, not 30; 6 numbers in an action, not 4"),
            ("--vehicle firefly", "task.vehicle is \"firefly\", was the task's own"),
            ("--control rate", "control is \"rate\", was \"rotor\""),
            ("--dt 0.02", "steps of 0.02 s, not 0.016 s"),
            ("--config missing.toml", "make it: omnidrones tasks TASK --toml > missing.toml"),
        ] {
            let arguments: Vec<&str> = [command, "runs/Hover-apg-s0"].into_iter().chain(options.split(' ')).collect();
            let (_, err) = exits(2, folder, &arguments);
            assert!(err.contains(words) && !err.contains("hash"), "{arguments:?}: {err}");
        }
    }
    let (page, _) = exits(0, folder, &["eval", "runs/Hover-apg-s0", "--no-plots", "--envs", "4"]);
    assert!(page.contains("Success, not crashed: position_error < 0.1 m and heading_alignment > 0.95 and"), "{page}");
}

#[test]
fn a_policy_of_another_vehicle_or_another_mass_is_flown_with_a_warning() {
    let folder = temporary();
    let folder = folder.path();
    json(folder, &tiny(&["--no-plots", "--no-baseline"]));
    let (own, _) = exits(0, folder, &["models", "hummingbird", "--toml"]);
    let mass = own.lines().find(|line| line.starts_with("mass = ")).expect("a part with a mass");
    std::fs::write(folder.join("own.toml"), &own).expect("written");
    std::fs::write(folder.join("heavy.toml"), own.replacen(mass, "mass = 0.9", 1)).expect("written");
    let fly = |vehicle| {
        let short = ["--reference", "hover", "--duration", "0.3", "--no-plots"];
        [&["fly", vehicle, "--policy", "runs/Hover-apg-s0"][..], &short].concat()
    };
    for (vehicle, words) in [
        ("hummingbird", None),
        ("own.toml", None),
        ("crazyflie", Some("trained on 'hummingbird' of 0.716 kg; it flies 'crazyflie' of ")),
        ("heavy.toml", Some("trained on 'hummingbird' of 0.716 kg; it flies 'hummingbird' of ")),
    ] {
        let warnings = json(folder, &fly(vehicle))["warnings"].as_array().expect("a list").clone();
        assert_eq!(warnings.len(), words.iter().len(), "{vehicle}: {warnings:?}");
        let Some(words) = words else { continue };
        assert!(warnings[0].as_str().is_some_and(|told| told.contains(words)), "{vehicle}: {warnings:?}");
        let (page, _) = exits(0, folder, &fly(vehicle));
        assert!(page.contains("warning: the policy was trained on"), "{page}");
    }
}

#[test]
fn settings_that_nothing_reads_are_refused_as_options_and_warned_of_in_files() {
    let folder = temporary();
    let folder = folder.path();
    let (toml, _) = exits(0, folder, &["train", "Hover", "--toml"]);
    assert!(toml.contains("\ntask = \"Hover\"") && toml.contains("# Learning rate over the run"), "{toml}");
    std::fs::write(folder.join("hover.toml"), &toml).expect("written");
    let (environments, _) = exits(0, folder, &["tasks", "Hover", "--toml"]);
    std::fs::write(folder.join("environments.toml"), environments).expect("written");
    std::fs::write(folder.join("short.toml"), "task = 'Hover'\n[apg]\nhorizon = 9\n[env]\ndt = 0.016")
        .expect("written");
    for (arguments, words) in [
        ("train Track --config hover.toml", "hover.toml: task: the settings are for Hover, but the run is of Track"),
        ("rollout Track --config hover.toml", "hover.toml: task: the settings are for Hover, but the task is Track"),
        ("rollout Hover --set apg.horizon=3", "a setting of training"),
        ("train Hover --set ppo.updates=3", "--set ppo.updates is a setting of ppo, but it must be one of apg"),
        ("train Hover --config missing.toml", "make it: omnidrones train Hover --toml > missing.toml"),
    ] {
        let (_, err) = exits(2, folder, &arguments.split(' ').collect::<Vec<_>>());
        assert!(err.contains(words), "{arguments}: {err}");
    }
    for command in ["rollout", "tasks", "train"] {
        let rest = ["--toml"].into_iter().filter(|_| command != "rollout");
        let rest: Vec<&str> = rest
            .chain(["--no-plots", "--envs", "2", "--horizon", "3"].into_iter().filter(|_| command == "rollout"))
            .collect();
        for file in ["hover.toml", "environments.toml", "short.toml"] {
            exits(0, folder, &[&[command, "Hover", "--config", file][..], &rest].concat());
        }
    }
    let toml = |arguments: &str| {
        let list: Vec<&str> = arguments.split(' ').collect();
        exits(0, folder, &[&["train", "Hover", "--toml"][..], &list].concat()).0
    };
    let own = toml(
        "--set control=rate --set horizon=77 --set apg.learning_rate.from=0.005 --randomise mass:0.7:1.3 --dt 0.02 --envs 48",
    );
    for words in ["control = \"rate\"", "horizon = 77", "from = 0.005", "range = [0.7, 1.3]", "dt = 0.02", "n_env = 48"]
    {
        assert!(own.contains(words), "{words}\n{own}");
    }
    std::fs::write(folder.join("both.toml"), "[apg]\nhorizon = 9\n[ppo]\nupdates = 3").expect("written");
    let (toml, err) = exits(0, folder, &["train", "Hover", "--config", "both.toml", "--toml"]);
    assert!(toml.contains("horizon = 9") && !toml.contains("[ppo]"), "{toml}");
    assert!(err.contains("warning: both.toml: [ppo] is not used, for apg trains."), "{err}");
    let (toml, err) = exits(0, folder, &["train", "Hover", "--algo", "mappo", "--set", "ppo.updates=3", "--toml"]);
    assert!(toml.contains("algorithm = \"ppo\"") && toml.contains("updates = 3") && err.is_empty(), "{toml}{err}");
}

#[test]
fn every_task_tells_its_goal_its_success_its_loss_and_what_an_action_means() {
    let folder = temporary();
    for entry in omnidrones::tasks::registry::REGISTRY {
        let (page, _) = exits(0, folder.path(), &["tasks", entry.name]);
        for words in ["Start:", "Success:", "Loss:", "−1 … 1 means", "throttle: 0 … largest thrust"] {
            assert!(page.contains(words), "{}: {words}\n{page}", entry.name);
        }
        let told = json(folder.path(), &["tasks", entry.name]);
        let named = told["actions"].as_array().expect("a list").iter();
        let named: usize = named.map(|group| group["commands"].as_array().expect("names").len()).sum();
        assert_eq!(Some(named as u64), told["n_action"].as_u64(), "{}", entry.name);
    }
    for (level, words) in [
        ("rate", "-3.142 … 3.142 rad/s, body"),
        ("attitude", "-1.047 … 1.047 rad about the present heading"),
        ("velocity", "-1 … 1 m/s, world"),
        ("position", "-1 … 1 m from where the drone is, world"),
    ] {
        let (page, _) = exits(0, folder.path(), &["tasks", "Hover", "--control", level]);
        assert!(page.contains(words), "{level}: {words}\n{page}");
    }
}

#[test]
fn unusable_arguments_name_value_limit_and_remedy() {
    let folder = temporary();
    let folder = folder.path();
    std::fs::write(folder.join("bad.toml"), "[apg]\nhorizons = 3").expect("written");
    std::fs::create_dir(folder.join("empty")).expect("made");
    for (arguments, words) in [
        ("train Hove", "did you mean 'Hover'?"),
        (
            "train Hover --algo sacc",
            "[possible values: apg, shac, ppo, sac, td3, dqn, dagger, mappo, happo, ddpg, fasttd3, maddpg, matd3, rma, vdn, qmix]",
        ),
        ("train Hover --algo rma", "group 'parameters' is empty"),
        ("train Hover --config bad.toml", "bad.toml: line 2, column 1: unknown field `horizons`"),
        ("train Hover --config missing.toml", "missing.toml: No such file"),
        ("train Hover --set apg.horizons=3", "--set apg.horizons: apg"),
        ("train Hover --set apg.horizons=3", "Did you mean `horizon`?"),
        ("train Hover --set apg", "expected KEY=VALUE"),
        ("train Hover --set env.n_env=5", "Give n_env in the table of the algorithm"),
        ("train Hover --vehicle fierfly", "did you mean 'firefly'?"),
        ("train Hover --control rotr", "'rotor'"),
        ("train Hover --set apg.n_env=1000000000000", "over the limit of 1 to"),
        ("train Hover --set apg.network.hidden=[1000000000]", "over the limit"),
        ("train Hover --set env.task.horizon=1000000000000000", "over the limit of 1 to 16777216"),
        ("train Hover --threads 0", "number of threads is 0"),
        ("train Hover --seed 18446744073709551615", "over the limit of 9223372036854775807"),
        (
            "train Formation --algo ppo --set curriculum.good=return --set env.task.reward_shape=0 --set env.task.reward_place=0 \
             --set env.task.reward_heading=0 --set env.task.reward_center=0",
            "curriculum.good is return, up to 0",
        ),
        (
            "train Hover --set curriculum.from=0 --set curriculum.good=return --set env.truncate_after=50",
            "without env.truncate_after",
        ),
        ("train", "<TASK>"),
        ("eval nowhere", "nowhere"),
        ("eval empty", "empty"),
        ("watch nowhere", "nowhere"),
        ("watch nowhere --envs 0", "envs is 0, below the limit of 1 to 16"),
        ("watch nowhere --out a.mp4", "a name that ends in .gif"),
    ] {
        let list: Vec<&str> = arguments.split(' ').collect();
        let (out, err) = exits(2, folder, &list);
        assert!(out.is_empty() && err.contains(words) && !err.contains("panicked"), "{arguments}: {err}\n{out}");
    }
    assert!(!folder.join("runs").exists());
}

#[test]
fn seeds_train_side_by_side_and_one_that_fails_leaves_the_others() {
    let folder = temporary();
    let folder = folder.path();
    let (page, _) = exits(0, folder, &tiny(&["--seeds", "3", "--threads", "2"]));
    assert!(page.contains("3 seeds") && page.contains("mean") && widest(&page) <= 160, "{page}");
    let out = "runs/Hover-apg-s0-seeds";
    assert!(size(folder, &format!("{out}/curve.png")) > 1000);
    let parameters = |run: &str| load_policy(folder.join(run)).unwrap().policy.parameters().to_vec();
    exits(0, folder, &tiny(&["--seed", "1", "--threads", "1", "--no-baseline", "--no-plots"]));
    assert_eq!(parameters(&format!("{out}/s1")), parameters("runs/Hover-apg-s1"));
    let (_, err) = exits(2, folder, &tiny(&["--seeds", "3"]));
    assert!(err.contains("which holds a run already") && err.contains("--resume"), "{err}");
    // held-out starts have seed 5: a run of that seed is refused
    let (told, _) = exits(1, folder, &tiny(&["--seeds", "3", "--seed", "4", "--set", "evaluate.seed=5", "--json"]));
    let told: Value = serde_json::from_str(&told).unwrap();
    assert_eq!(
        (told["runs"].as_array().map(Vec::len), told["failed"][0]["seed"].as_u64()),
        (Some(2), Some(5)),
        "{told}"
    );
    assert!(told["success"]["half_width"].is_number());
}

#[test]
fn seeds_go_on_with_their_own_settings_and_a_refusal_loses_nothing() {
    let folder = temporary();
    let folder = folder.path();
    exits(0, folder, &tiny(&["--seeds", "2", "--threads", "1"]));
    let told = || fs::read_to_string(folder.join("runs/Hover-apg-s0-seeds/seeds.json")).unwrap();
    let before = told();
    let (_, err) = exits(2, folder, &tiny(&["--seeds", "2", "--resume", "--set", "apg.horizon=3"]));
    assert!(err.contains("apg.horizon"), "{err}");
    assert_eq!(told(), before);
    // without options the runs stay as long as they were
    exits(0, folder, &["train", "Hover", "--seeds", "2", "--resume", "--no-plots"]);
    let after: Value = serde_json::from_str(&told()).unwrap();
    let before: Value = serde_json::from_str(&before).unwrap();
    assert_eq!(after["runs"][0]["updates"], before["runs"][0]["updates"]);
    let (_, err) = exits(2, folder, &["train", "Hover", "--search", "seed=1,2"]);
    assert!(err.contains("--seeds"), "{err}");
}

#[test]
fn what_a_policy_does_not_know_is_refused_and_what_training_alone_wants_is_left_out() {
    let folder = temporary();
    let folder = folder.path();
    exits(0, folder, &tiny(&["--no-baseline", "--no-plots"]));
    let (_, err) = exits(2, folder, &["eval", "runs/Hover-apg-s0", "--set", "residual=0.3", "--envs", "4"]);
    assert!(err.contains("residual"), "{err}");
    let told = json(folder, &["eval", "runs/Hover-apg-s0", "--refine", "2", "--envs", "4", "--no-plots"]);
    let [flown, best] =
        ["/evaluation/return_mean", "/refined/return_mean"].map(|at| told.pointer(at).unwrap().as_f64().unwrap());
    assert!(best > flown && told["refined"]["best"].as_array().unwrap().len() == 4, "{told}");
    let (_, err) = exits(2, folder, &["eval", "runs/Hover-apg-s0", "--refine", "0", "--out", "none"]);
    assert!(err.contains("iterations is 0") && !folder.join("none").exists(), "{err}");
    let (file, _) = exits(0, folder, &["train", "Hover", "--toml"]);
    assert!(file.contains("stagger = true"));
    fs::write(folder.join("full.toml"), file).unwrap();
    let flown = |more: &[&str]| {
        let (told, _) =
            exits(0, folder, &[&["rollout", "Hover", "--envs", "8", "--no-plots", "--json"][..], more].concat());
        serde_json::from_str::<Value>(&told).unwrap()["evaluation"].clone()
    };
    let weight = ["--set", "throttle_change=3"]; // the recipe's, a part of the reward
    assert_eq!(flown(&["--config", "full.toml", "--seed", "0"]), flown(&[&weight[..], &["--seed", "0"]].concat()));
}

#[test]
fn a_search_finds_the_best_settings_goes_on_and_writes_them() {
    let folder = temporary();
    let folder = folder.path();
    let search =
        ["--search", "apg.learning_rate.from=0.01,1e-9", "--search", "apg.n_env=8,16", "--factor", "2", "--seeds", "2"];
    let (page, _) = exits(0, folder, &tiny(&search));
    for words in ["4 candidates, 2 seeds", "after 5", "after 20", "winner.toml", "apg.n_env=8"] {
        assert!(page.contains(words), "{words}\n{page}");
    }
    let out = folder.join("runs/Hover-apg-s0-search");
    assert!(out.join("search.png").exists() && out.join("search.json").exists());
    let known = std::fs::read(out.join("search.json")).unwrap();
    let (again, _) = exits(0, folder, &tiny(&[&search[..], &["--resume"]].concat()));
    assert_eq!((again, std::fs::read(out.join("search.json")).unwrap()), (page, known));
    exits(
        0,
        folder,
        &["train", "Hover", "--config", "runs/Hover-apg-s0-search/winner.toml", "--out", "best", "--no-plots"],
    );
    let (_, err) = exits(2, folder, &tiny(&["--search", "apg.n_env"]));
    assert!(err.contains("expected KEY=VALUE,VALUE"), "{err}");
    let (_, err) = exits(2, folder, &tiny(&["--search", "apg.n_envs=3,4", "--out", "other"]));
    assert!(err.contains("Did you mean `n_env`?"), "{err}");
}

#[test]
fn tasks_are_trained_together_and_a_table_that_was_stopped_goes_on() {
    let folder = temporary();
    let arguments = ["train-all", "--tasks", "Hover,Track", "--seeds", "2", "--budget", "0.002"];
    let told = json(folder.path(), &arguments);
    let tasks = told["tasks"].as_array().expect("tasks");
    let named: Vec<_> = tasks.iter().map(|t| (t["task"].as_str(), t["algorithm"].as_str())).collect();
    let by = |task, algorithm| (Some(task), Some(algorithm));
    let hover = ["apg", "shac", "ppo", "sac", "td3", "dqn", "qmix"].map(|algorithm| by("Hover", algorithm));
    assert_eq!(named, [&hover[..], &[by("Track", "apg"), by("Track", "ppo")]].concat());
    for task in tasks {
        assert_eq!(task["runs"].as_array().map(Vec::len), Some(2), "{task}");
        assert!(task["baseline"]["evaluation"]["success"].is_number());
    }
    assert!(size(folder.path(), "runs/all/curves.png") > 1000);
    let again = json(folder.path(), &arguments);
    let result = |told: &Value| told["tasks"][0]["runs"][1]["evaluation"].clone();
    assert_eq!(result(&told), result(&again), "runs that are over are not trained again");
    // a row alone is enough, and one of other physics is not
    let row = folder.path().join("runs/all/Hover-apg-u2.json");
    let text = std::fs::read_to_string(&row).expect("the row");
    let hash = told["tasks"][0]["hash"].as_str().expect("a hash").to_string();
    assert!(text.contains(&hash));
    std::fs::remove_dir_all(folder.path().join(format!("runs/all/Hover-apg-{hash}-s1"))).unwrap();
    assert_eq!(result(&json(folder.path(), &arguments)), result(&told));
    std::fs::write(&row, text.replace(&hash, "0123456789abcdef").replace("\"seed\": 1", "\"seed\": 7")).unwrap();
    assert_eq!(result(&json(folder.path(), &arguments)), result(&told));
    assert_eq!(std::fs::read_to_string(&row).unwrap().matches("\"seed\": 7").count(), 0, "a stale row is replaced");
    let (page, _) = exits(0, folder.path(), &arguments);
    assert!(page.contains("Hover") && page.contains("cascade") && widest(&page) <= 160, "{page}");
    let (_, error) = exits(2, folder.path(), &["train-all", "--tasks", "Hovr"]);
    assert!(error.contains("Hover"), "{error}");
    exits(2, folder.path(), &["train-all", "--budget", "-1"]);
}

#[test]
fn a_policy_in_the_loop_is_measured_beside_the_paper() {
    let folder = temporary();
    let told = json(folder.path(), &["bench", "--policy", "8", "--quick", "--no-plots"]);
    let rows = told["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 6);
    assert!(rows.iter().all(|row| row["ratio"].as_f64().is_some_and(|r| r > 0.0)));
}

#[test]
fn help_names_every_option_with_examples_that_are_real() {
    let folder = temporary();
    let train =
        ["--algo", "--vehicle", "--control", "--config", "--set", "--seed", "--updates", "--threads", "--resume"];
    let eval = ["--envs", "--seed", "--vehicle", "--randomise", "--csv", "--no-plots"];
    let watch = ["--envs", "--seed", "--out", "--no-plots"];
    for (command, options) in [("train", &train[..]), ("eval", &eval), ("watch", &watch)] {
        let (help, _) = exits(0, folder.path(), &[command, "--help"]);
        for words in options.iter().chain(&["--out", "--format", "--json", "Examples:", "Exit codes:"]) {
            assert!(help.contains(words), "{command}: {words}\n{help}");
        }
        assert!(command == "watch" || help.contains("Success is the share of episodes"), "{help}");
        assert!(widest(&help) <= 100, "{help}");
        let mut seen = 0;
        for line in help.lines().filter_map(|l| l.strip_prefix("  omnidrones ")) {
            let example = line.split("  ").next().unwrap_or(line);
            let mut arguments: Vec<&str> = example.split(' ').collect();
            arguments.push("--no-such-option");
            let (_, err) = exits(2, folder.path(), &arguments);
            assert!(err.contains("unexpected argument '--no-such-option'"), "{example}: {err}");
            seen += 1;
        }
        assert!(seen >= 5, "{command}: {seen}");
    }
}

/// Updates between two checkpoints of a run that is killed, and its updates.
const INTERVAL: u64 = 4;
const UPDATES: &str = "60";

fn long(folder: &Path, run: &str) -> Command {
    let set = |text: &'static str| ["--set", text];
    let own = [
        set("apg.n_env=16"),
        set("apg.horizon=6"),
        set("apg.network.hidden=[8]"),
        set("env.task.horizon=30"),
        set("evaluate={every=0,envs=4}"),
        set("checkpoint.every=4"),
        set("log_every=1"),
    ];
    let rest = ["--updates", UPDATES, "--resume", "--no-plots", "--no-baseline", "--threads", "1", "--out", run];
    let mut command = command(folder, &["train", "Hover"]);
    command.args(own.concat()).args(rest).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn newest(run: &Path) -> Option<LatestCheckpoint> {
    Store::open(run).ok()?.latest().unwrap_or_else(|e| panic!("no whole checkpoint after a kill: {e}"))
}

/// Whether it was still running.
fn kill(mut child: Child) -> bool {
    // SIGKILL on Unix
    child.kill().expect("killed");
    let output = child.wait_with_output().expect("it ends");
    assert!(output.status.code().is_none_or(|code| code == 0), "{}", String::from_utf8_lossy(&output.stderr));
    !output.status.success()
}

/// Kills runs at random moments and goes on with them until `n` were killed in all; every one must come to the same bits
/// as a run that nobody killed, and lose one interval at most each time.
fn killed(n: usize) {
    let folder = temporary();
    let folder = folder.path();
    let begun = Instant::now();
    assert!(long(folder, "whole").status().expect("it runs").success());
    let took = begun.elapsed();
    let whole = newest(&folder.join("whole")).expect("a checkpoint").checkpoint;
    let mut draw = Stream::new(3, 0, 0, Purpose::LEARNING);
    let (mut kills, mut run, mut between) = (0, 0, 0);
    while kills < n {
        run += 1;
        let name = format!("run-{run}");
        let path = folder.join(&name);
        loop {
            let before = newest(&path).map_or(0, |found| found.checkpoint.manifest.update);
            let child = long(folder, &name).spawn().expect("it starts");
            let share = draw.next_u64() as f64 / u64::MAX as f64;
            std::thread::sleep(Duration::from_secs_f64(share * 1.2 * took.as_secs_f64()));
            if !kill(child) {
                break;
            }
            kills += 1;
            let kept = newest(&path).map_or(0, |found| found.checkpoint.manifest.update);
            let done = log::read(&path).ok().and_then(|lines| lines.last()?.get("update")).unwrap_or(0.0) as u64;
            assert!(kept >= before, "a kill took a checkpoint away");
            assert!(kept.is_multiple_of(INTERVAL), "{kept}");
            assert!(done <= kept + INTERVAL, "more than an interval lost: {done} done, {kept} kept");
            between += usize::from(kept > before && kept < 60);
        }
        let own = newest(&path).expect("a checkpoint").checkpoint;
        assert!(own.policy == whole.policy && own.state == whole.state, "other bits");
        assert_eq!(log::read(&path).expect("a log").len(), 60);
        assert!(load_policy(&path).expect("it flies").skipped.is_empty());
    }
    assert!(between > n / 5, "only {between} of {kills} kills met a run at work"); // two thirds
}

#[test]
fn killed_runs_go_on_to_the_same_bits() {
    killed(30);
}

/// `cargo test --release -p omnidrones-cli --test command_line learning -- --ignored`
#[test]
#[ignore = "cargo test --release -p omnidrones-cli --test command_line learning -- --ignored: two minutes"]
fn two_hundred_killed_runs_go_on_to_the_same_bits() {
    killed(200);
}
