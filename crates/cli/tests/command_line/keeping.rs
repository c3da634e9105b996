//! What runs and flights leave in folders: whose it is, what is kept of it, and what is believed of it.

use crate::command::{exits, json, size, temporary};
use omnidrones::rl::checkpoint::Store;
use omnidrones::rl::load_policy;
use serde_json::Value;
use std::fs;
use std::path::Path;
#[cfg(target_os = "linux")]
use std::process::{Command, Stdio};

const SMALL: [&str; 14] = [
    "--set",
    "apg.n_env=8",
    "--set",
    "apg.horizon=4",
    "--set",
    "apg.network.hidden=[8]",
    "--set",
    "env.task.horizon=10",
    "--set",
    "evaluate={every=0,envs=4}",
    "--no-plots",
    "--threads",
    "1",
    "--json",
];

/// A small training into `out`, which must exit with `code`; what it tells.
fn train(code: i32, folder: &Path, out: &str, more: &[&str]) -> String {
    let baseline = if more.contains(&"--seeds") { &[][..] } else { &["--no-baseline"] };
    let (told, err) = exits(code, folder, &[&["train", "Hover", "--out", out][..], &SMALL, baseline, more].concat());
    told + &err
}

/// Every file below a folder with its bytes; links by where they lead.
fn all(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let (path, kind) = (entry.path(), entry.file_type().unwrap());
        let name = path.display().to_string();
        if kind.is_dir() {
            found.extend(all(&path));
        } else if kind.is_symlink() {
            found.push((name, fs::read_link(&path).unwrap().display().to_string().into_bytes()));
        } else {
            found.push((name, fs::read(&path).unwrap()));
        }
    }
    found.sort();
    found
}

#[test]
fn a_forced_training_in_a_folder_of_others_takes_no_page_of_theirs() {
    let folder = temporary();
    let (folder, mine) = (folder.path(), folder.path().join("mine"));
    fs::create_dir(&mine).unwrap();
    let names = ["report.html", "replay.html", "notes.md"];
    names.iter().for_each(|name| fs::write(mine.join(name), "mine").unwrap());
    for updates in ["1", "2"] {
        train(0, folder, "mine", &["--updates", updates, "--force"]);
        for name in names {
            assert_eq!(fs::read_to_string(mine.join(name)).unwrap(), "mine", "{name}");
        }
    }
}

#[test]
fn runs_of_which_no_search_tells_are_refused_replaced_by_force_and_never_a_winner() {
    let folder = temporary();
    let folder = folder.path();
    let search = ["--updates", "2", "--search", "apg.max_grad_norm=0.4,0.5", "--factor", "2", "--seeds", "1"];
    let with = |more: &[&'static str]| [&search[..], more].concat();
    train(0, folder, "own", &search);
    fs::remove_file(folder.join("own/search.json")).unwrap();
    fs::remove_file(folder.join("own/winner.toml")).unwrap();
    let kept = all(&folder.join("own"));
    for more in [&[][..], &["--resume"]] {
        let told = train(2, folder, "own", &with(more));
        assert!(told.contains("no search.json tells of it") && told.contains("--force"), "{told}");
        assert!(all(&folder.join("own")) == kept, "{more:?}");
    }
    let manifest = || fs::read(folder.join("own/c0/s0/checkpoints/000000002/manifest.json")).unwrap();
    let before = manifest();
    train(0, folder, "own", &with(&["--force"]));
    assert!(folder.join("own/winner.toml").exists() && manifest() != before, "trained anew");
    // a file where each run is to have its folder
    for name in ["c0", "c1"] {
        fs::create_dir_all(folder.join("bad").join(name)).unwrap();
        fs::write(folder.join("bad").join(name).join("s0"), "mine").unwrap();
    }
    for _ in 0..2 {
        let told = train(2, folder, "bad", &with(&["--force"]));
        assert!(told.contains("candidates that were trained is none"), "{told}");
        assert!(!folder.join("bad/winner.toml").exists());
        assert_eq!(fs::read_to_string(folder.join("bad/c1/s0")).unwrap(), "mine");
    }
    let (page, _) = exits(0, folder, &["report", "bad"]);
    assert!(page.contains("report.html"), "{page}");
    let page = fs::read_to_string(folder.join("bad/report.html")).unwrap();
    assert!(
        page.contains("No candidate could be trained") && page.contains("A search over 2 candidates, 1 seed"),
        "{page}"
    );
}

#[cfg(unix)]
#[test]
fn a_run_that_goes_on_leaves_the_other_names_of_its_files_as_they_are() {
    let folder = temporary();
    let folder = folder.path();
    let saved = ["--set", "tensorboard=true", "--set", "log_every=1", "--set", "checkpoint.every=1"];
    train(0, folder, "own", &[&saved[..], &["--updates", "2"]].concat());
    let names = ["log.jsonl", "curve.csv", "events.out.tfevents.omnidrones", "config.toml", "result.json"];
    let linked = |name: &str| folder.join(format!("linked-{name}"));
    let own = |name: &str| fs::read(folder.join("own").join(name)).unwrap();
    names.iter().for_each(|name| fs::hard_link(folder.join("own").join(name), linked(name)).unwrap());
    let before = names.map(own);
    let old = folder.join("own/checkpoints/000000002/notes.txt");
    fs::write(&old, "mine").unwrap();
    for updates in ["4", "6"] {
        let told = train(0, folder, "own", &[&saved[..], &["--updates", updates, "--resume"]].concat());
        for (name, then) in names.iter().zip(&before) {
            assert!(fs::read(linked(name)).unwrap() == *then, "{name} was written to");
        }
        assert!(own("log.jsonl").starts_with(&before[0]) && own("log.jsonl").len() > before[0].len());
        assert_eq!(fs::read_to_string(&old).unwrap(), "mine");
        assert!(told.contains("000000002 is an old checkpoint and stays"), "{told}");
    }
}

#[cfg(unix)]
#[test]
fn a_forced_training_follows_no_link_and_leaves_what_is_of_others() {
    use std::os::unix::fs::symlink;
    let folder = temporary();
    let folder = folder.path();
    train(0, folder, "theirs", &["--updates", "3"]);
    let whole = folder.join("theirs");
    let before = all(&whole);
    let two = ["--updates", "2", "--force"];
    let seeds = [&two[..], &["--seeds", "2"]].concat();
    let search = [&two[..], &["--search", "apg.max_grad_norm=0.4,0.5", "--factor", "2", "--seeds", "2"]].concat();
    // a folder within a folder of ours: that of what a run began from, of a seed, of a candidate
    for (made, link, more) in [
        (&["--updates", "2"][..], "from", &two[..]),
        (&["--updates", "2"], "checkpoints", &two),
        (&["--updates", "2", "--seeds", "2"], "s0", &seeds),
        (&["--updates", "2", "--seeds", "2"], "s1", &seeds),
        (&["--updates", "2", "--seeds", "2"], "s0/from", &seeds),
        (&["--updates", "2", "--seeds", "2"], "s1/checkpoints", &seeds),
        (&search[..1], "c0", &search),
        (&search[..1], "c1/s0", &search),
        (&search[..1], "c0/s1/from", &search),
    ] {
        for target in ["theirs", "nowhere"] {
            let _ = fs::remove_dir_all(folder.join("own"));
            let begun: Vec<&str> = if made.len() == 1 {
                more.iter().filter(|word| **word != "--force").copied().collect()
            } else {
                made.to_vec()
            };
            train(0, folder, "own", &begun);
            let at = folder.join("own").join(link);
            let _ = fs::remove_dir_all(&at);
            symlink(folder.join(target), &at).unwrap();
            let kept = all(&folder.join("own"));
            let told = train(2, folder, "own", more);
            assert!(told.contains("link"), "{link}: {told}");
            assert!(all(&whole) == before, "{link} was followed");
            assert!(all(&folder.join("own")) == kept, "{link}: something was removed before it was refused");
            assert!(!folder.join("nowhere").exists(), "{link}");
        }
    }
    // what a user put among the files of a run stays
    fs::remove_dir_all(folder.join("own")).unwrap();
    train(0, folder, "own", &["--updates", "2"]);
    for mine in ["notes.txt", "checkpoints/notes.txt", "checkpoints/mine/weights.pt"] {
        let path = folder.join("own").join(mine);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "mine").unwrap();
    }
    train(0, folder, "own", &["--updates", "3", "--force"]);
    for mine in ["notes.txt", "checkpoints/notes.txt", "checkpoints/mine/weights.pt"] {
        assert_eq!(fs::read_to_string(folder.join("own").join(mine)).unwrap(), "mine");
    }
    assert_eq!(Store::open(folder.join("own")).unwrap().updates().unwrap(), [3]);
    let within = folder.join("own/checkpoints/000000003/mine.txt");
    fs::write(&within, "mine").unwrap();
    let told = train(2, folder, "own", &["--updates", "2", "--force"]);
    assert!(told.contains("mine.txt") && within.exists() && load_policy(folder.join("own")).is_ok(), "{told}");
}

#[test]
fn a_forged_search_is_refused_by_report_and_resume() {
    let folder = temporary();
    let folder = folder.path();
    let search = ["--updates", "4", "--search", "apg.max_grad_norm=0.3,0.4,0.5", "--factor", "3", "--seeds", "1"];
    train(0, folder, "own", &search);
    let path = folder.join("own/search.json");
    let sound: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    for (place, value) in [
        ("/failures", serde_json::json!([[99, 0, "x"]])),
        ("/trials/0/candidate", 7.into()),
        ("/trials/1/scores", serde_json::json!([])),
        ("/trials/3/rung", 99.into()),
        ("/seeds", serde_json::json!([])),
    ] {
        let mut forged = sound.clone();
        *forged.pointer_mut(place).unwrap() = value;
        fs::write(&path, forged.to_string()).unwrap();
        let (_, err) = exits(2, folder, &["report", "own", "--no-replay", "--no-baseline"]);
        assert!(err.contains("search.json") && err.lines().count() == 1, "{place}: {err}");
        let told = train(2, folder, "own", &[&search[..], &["--resume"]].concat());
        assert!(!told.contains("panicked"), "{place}: {told}");
    }
}

#[test]
fn a_folder_of_several_runs_is_told_with_the_runs_in_it() {
    let folder = temporary();
    let folder = folder.path();
    train(0, folder, "seeds", &["--updates", "2", "--seeds", "3"]);
    train(0, folder, "search", &["--updates", "2", "--search", "apg.max_grad_norm=0.4,0.5", "--seeds", "1"]);
    for command in ["eval", "replay", "watch", "view"] {
        let (_, err) = exits(2, folder, &[command, "seeds"]);
        assert!(err.contains("name one of seeds/s0, seeds/s1, seeds/s2. The best is seeds/s"), "{command}: {err}");
        let (_, err) = exits(2, folder, &[command, "search"]);
        assert!(err.contains("name one of search/c0/s0, search/c1/s0. The best is search/c"), "{command}: {err}");
    }
    exits(0, folder, &["eval", "seeds/s1", "--no-plots", "--envs", "2"]);
    for (words, told) in [
        (&["view", "hummingbird"][..], "'omnidrones fly hummingbird --replay'"),
        (&["replay", "Transport"], "'omnidrones fly Transport --replay'"),
        (&["replay", "nothing"], "which does not exist"),
    ] {
        let (_, err) = exits(2, folder, words);
        assert!(err.contains(told), "{words:?}: {err}");
    }
}

#[test]
fn rows_that_cannot_be_read_are_told() {
    let folder = temporary();
    let folder = folder.path();
    let all = [
        "train-all",
        "--tasks",
        "Hover",
        "--algo",
        "APG",
        "--seeds",
        "1",
        "--budget",
        "0.001",
        "--no-plots",
        "--out",
        "all",
    ];
    exits(0, folder, &all);
    let row = fs::read_dir(folder.join("all")).unwrap().flatten().map(|e| e.path());
    let row = row.into_iter().find(|path| path.to_string_lossy().contains("-u")).unwrap();
    let sound: Value = serde_json::from_str(&fs::read_to_string(&row).unwrap()).unwrap();
    for (place, value) in [
        ("/runs/0/seed", serde_json::json!(1e19)),
        ("/task", "../../Hover".into()),
        ("/algorithm", "../apg".into()),
        ("/hash", "../..".into()),
        ("/runs/0/seconds", (-1.0).into()),
        ("/runs", serde_json::json!([sound["runs"][0], sound["runs"][0]])),
        ("/runs", serde_json::json!({})),
    ] {
        let mut forged = sound.clone();
        *forged.pointer_mut(place).unwrap() = value;
        fs::write(folder.join("all/Track-apg-u7.json"), forged.to_string()).unwrap();
        let (_, err) = exits(0, folder, &["report", "all", "--no-replay", "--force"]);
        assert!(err.contains("Track-apg-u7.json"), "{place}: {err}");
        let page = fs::read_to_string(folder.join("all/report.html")).unwrap();
        assert!(page.contains("Could not be read") && page.contains("Track-apg-u7.json"), "{place}");
    }
    fs::remove_file(folder.join("all/Track-apg-u7.json")).unwrap();
    // trained anew, and told
    fs::write(&row, "{").unwrap();
    let (_, err) = exits(0, folder, &all);
    assert!(err.contains("It is trained anew"), "{err}");
    assert!(serde_json::from_str::<Value>(&fs::read_to_string(&row).unwrap()).is_ok());
}

#[test]
fn pages_and_pictures_of_an_earlier_flight_do_not_stay_beside_those_of_a_later_one() {
    let folder = temporary();
    let folder = folder.path();
    let fly = |name: &str, more: &[&str]| {
        exits(0, folder, &[&["fly", name, "--duration", "0.2", "--out", "st"][..], more].concat());
    };
    let there = |name: &str| folder.join("st").join(name).exists();
    fly("iris", &["--replay", "--csv"]);
    fs::write(folder.join("st/mine.html"), "mine").unwrap();
    fs::write(folder.join("st/mine.png"), "mine").unwrap();
    fly("firefly", &["--format", "svg"]);
    assert!(!there("replay.html") && !there("overview.png") && there("overview.svg") && there("flight.csv"));
    assert!(there("mine.html") && there("mine.png"));
    fly("iris", &["--replay", "--no-plots"]);
    assert!(there("replay.html") && !there("overview.svg") && there("mine.png"));
    // nothing is written: nothing goes
    fly("firefly", &["--no-plots"]);
    assert!(there("replay.html"));
    // in a folder of others the names alone are replaced
    fs::create_dir(folder.join("theirs")).unwrap();
    for name in ["replay.html", "overview.svg", "notes"] {
        fs::write(folder.join("theirs").join(name), "mine").unwrap();
    }
    exits(0, folder, &["fly", "iris", "--duration", "0.2", "--out", "theirs", "--force"]);
    assert_eq!(
        size(folder, "theirs/replay.html") + size(folder, "theirs/overview.svg") + size(folder, "theirs/notes"),
        12
    );
}

#[test]
fn names_win_over_files_and_folders_that_are_called_so() {
    let folder = temporary();
    let folder = folder.path();
    for name in ["hover", "Hover", "hummingbird", "published", "forest", "forest:3", "imu", "circle"] {
        fs::create_dir(folder.join(name)).unwrap();
    }
    for words in [
        &["fly", "hummingbird", "--reference", "hover", "--gains", "published"][..],
        &["fly", "hummingbird", "--reference", "circle"],
        &["fly", "hummingbird", "--reference", "hover", "--scene", "forest:3"],
        &["fly", "hummingbird", "--reference", "hover", "--sensors", "imu", "--npz"],
        &["rollout", "Hover", "--vehicle", "hummingbird", "--envs", "2", "--horizon", "3"],
    ] {
        let mut line = words.to_vec();
        line.push("--no-plots");
        if words[0] == "fly" {
            line.extend(["--duration", "0.2"]);
        }
        exits(0, folder, &line);
    }
    exits(0, folder, &["replay", "hover", "--envs", "1", "--horizon", "3", "--out", "page.html"]);
    let (_, err) = exits(2, folder, &["fly", "hummingbird", "--reference", "./hover", "--no-plots"]);
    assert!(err.contains("./hover is a folder, but it must be a regular file"), "{err}");
}

#[test]
fn names_of_files_steer_no_terminal_and_no_spreadsheet() {
    let folder = temporary();
    let folder = folder.path();
    let (own, _) = exits(0, folder, &["models", "hummingbird", "--toml"]);
    for evil in ["=cmd|' /C calc'!A0", "+1+1", "@sum(1)", "-a\\nerror: b", "a\\u202Eb\\u2066", "a\\u2028b\\u0085c"] {
        let mine = own.replacen("name = \"hummingbird\"", &format!("name = \"{evil}\""), 1);
        let mine = mine.replacen("name = \"rotor_0\"", &format!("name = \"{evil}0\""), 1);
        fs::write(folder.join("mine.toml"), &mine).unwrap();
        for words in [
            &["fly", "mine.toml", "--duration", "0.2", "--no-plots"][..],
            &["linearise", "mine.toml", "--save", "model.csv", "--force"],
            &["allocate", "mine.toml", "--fail", "9"],
            &["models", "mine.toml"],
        ] {
            let output = crate::command::command(folder, words).output().unwrap();
            let told = String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap();
            assert!(!told.contains(['\u{202e}', '\u{2066}', '\u{2028}', '\u{85}']), "{words:?}: {told}");
            assert!(told.lines().all(|line| !line.starts_with("error: b")), "{words:?}: {told}");
        }
        let table = fs::read_to_string(folder.join("model.csv")).unwrap();
        for cell in table.lines().flat_map(|line| line.split(',')) {
            let harmless = !cell.trim_start_matches('"').starts_with(['=', '+', '@', '\t'])
                && (!cell.starts_with('-') || cell.parse::<f64>().is_ok());
            assert!(harmless, "{evil}: {cell}");
        }
    }
    let (page, _) = exits(0, folder, &["allocate", "firefly", "--wrench", "1e308,0,1e308,0,0,0"]);
    assert!(crate::command::widest(&page) < 160, "{page}");
}

#[test]
fn what_was_trained_first_is_told_with_its_share() {
    let folder = temporary();
    let folder = folder.path();
    let first =
        ["--updates", "2", "--set", "from=Hover/apg", "--set", "from_settings={apg={updates=3,n_env=8,horizon=4}}"];
    let told: Value = serde_json::from_str(&train(0, folder, "own", &first)).unwrap();
    let own = &told["trained_first"];
    assert_eq!((own["updates"].as_u64(), own["env_steps"].as_u64()), (Some(3), Some(3 * 8 * 4)), "{told}");
    let share = own["share_of_env_steps"].as_f64().unwrap();
    assert!((share - 96.0 / told["env_steps"].as_f64().unwrap()).abs() < 1e-12 && share < 1.0, "{told}");
    let plain: Value = serde_json::from_str(&train(0, folder, "plain", &["--updates", "2"])).unwrap();
    assert!(plain["trained_first"].is_null());
    assert!(json(folder, &["eval", "own", "--no-plots", "--envs", "2"])["evaluation"].is_object());
}

#[cfg(target_os = "linux")]
#[test]
fn a_training_that_is_stopped_is_saved_where_it_was_and_goes_on_to_the_same_bits() {
    let folder = temporary();
    let folder = folder.path();
    let never =
        ["--set", "checkpoint.every=0", "--set", "checkpoint.seconds=0", "--set", "log_every=1", "--updates", "400"];
    train(0, folder, "whole", &never);
    let whole = load_policy(folder.join("whole")).unwrap();
    // while it is young, and later; by every signal that ends a process
    for (round, signal) in ["INT", "TERM", "HUP"].into_iter().enumerate() {
        let out = format!("run-{round}");
        let line = [&["train", "Hover", "--out", &out, "--no-baseline", "--resume"][..], &SMALL, &never].concat();
        let mut own = Command::new("env");
        own.args(["--default-signal=INT,HUP,TERM", env!("CARGO_BIN_EXE_omnidrones")]).args(line).current_dir(folder);
        let mut child = own.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let lines = || fs::read_to_string(folder.join(&out).join("log.jsonl")).map_or(0, |text| text.lines().count());
        while lines() < 1 + 20 * round && child.try_wait().unwrap().is_none() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        assert!(
            Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status().unwrap().success()
        );
        let output = child.wait_with_output().unwrap();
        let err = String::from_utf8(output.stderr).unwrap();
        let updates = Store::open(folder.join(&out)).unwrap().updates().unwrap();
        if output.status.code() == Some(130) {
            let [at] = updates[..] else { panic!("{updates:?}: {err}") };
            assert!(err.contains(&format!("{out} is saved at update {at}")), "{err}");
            assert!(at < 400, "{at}");
        }
        train(0, folder, &out, &[&never[..], &["--resume"]].concat());
        let own = load_policy(folder.join(&out)).unwrap();
        assert_eq!(own.policy.parameters(), whole.policy.parameters(), "{signal}");
    }
}

#[test]
fn a_training_is_saved_by_the_clock_too_and_comes_to_the_same_bits() {
    let folder = temporary();
    let folder = folder.path();
    let (long, every) = (["--updates", "600"], ["--set", "checkpoint.every=0", "--set", "checkpoint.keep=1000"]);
    train(0, folder, "clock", &[&long[..], &every, &["--set", "checkpoint.seconds=1"]].concat());
    train(0, folder, "never", &[&long[..], &every, &["--set", "checkpoint.seconds=0"]].concat());
    let updates = |name: &str| Store::open(folder.join(name)).unwrap().updates().unwrap();
    assert_eq!((updates("never").len(), updates("never").last()), (1, updates("clock").last()));
    let took: Value = serde_json::from_str(&fs::read_to_string(folder.join("clock/result.json")).unwrap()).unwrap();
    let seconds = took["seconds"].as_f64().unwrap();
    println!("{seconds} s: {:?}", updates("clock"));
    assert!(updates("clock").len() > 1 || seconds < 2.0, "{seconds} s: {:?}", updates("clock"));
    let [a, b] = ["clock", "never"].map(|name| load_policy(folder.join(name)).unwrap());
    assert_eq!(a.policy.parameters(), b.policy.parameters());
    // a setting at its default names no other row
    let config = |name: &str| fs::read_to_string(folder.join(name).join("config.toml")).unwrap();
    assert!(config("clock").contains("seconds = 1"));
}
