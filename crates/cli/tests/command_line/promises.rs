//! Every command line in the help texts, in the README and in `docs/` does what it says: it exits with 0, and a flight that it
//! flies is held. A line of Markdown is a command line if it begins with `omnidrones` or `cargo run --release --`, or stands in
//! backticks that do.
//!
//! Rule for what takes long: the line is run as it stands but for sizes, by [`SMALLER`]. `bench` measures, so it is run
//! with one thread and batches of 64. Files that the lines name are made first: a URDF of the corpus with its rotor data,
//! a vehicle file, the run of Hover.

use crate::command::{command, exits, temporary};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// Command, option and the value it is given instead of its own or the default one.
const SMALLER: &[(&str, &str, &str)] = &[
    ("rollout", "--envs", "4"),
    ("rollout", "--horizon", "20"),
    ("eval", "--envs", "4"),
    ("replay", "--envs", "2"),
    ("replay", "--horizon", "20"),
    ("view", "--envs", "2"),
    ("view", "--horizon", "20"),
    ("view", "--duration", "0.2"),
    ("watch", "--envs", "2"),
    ("watch", "--horizon", "20"),
    ("train", "--updates", "2"),
    ("train", "--envs", "8"),
    ("train", "--horizon", "20"),
    ("train-all", "--tasks", "Hover"),
    ("train-all", "--seeds", "1"),
    ("train-all", "--budget", "0.002"),
    ("study", "--tasks", "Hover"),
    ("study", "--algos", "dqn"),
    ("study", "--seeds", "1"),
    ("study", "--budget", "0.002"),
    ("recover", "--cells", "3,2"),
    ("recover", "--starts", "2"),
    ("tune", "--iterations", "2"),
    ("tune", "--starts", "4"),
    ("tune", "--held-out", "4"),
    ("tune", "--duration", "1"),
    ("bench", "--envs", "64"),
    ("bench", "--threads", "1"),
];

/// Flights farther from their reference than this are lost, m.
const LOST: f64 = 10.0;

const COMMANDS: [&str; 23] = [
    "fly",
    "show",
    "models",
    "import",
    "allocate",
    "design",
    "linearise",
    "recover",
    "tune",
    "optimise",
    "tasks",
    "rollout",
    "train",
    "train-all",
    "study",
    "eval",
    "report",
    "replay",
    "view",
    "watch",
    "bench",
    "benchmark",
    "export",
];

/// The words of a command line, up to its remark or what a shell does with it.
fn words(line: &str) -> Option<Vec<String>> {
    let line = line.split("  ").next()?.split(['#', '>', '`', '&', '|']).next()?.trim();
    let rest = line.strip_prefix("omnidrones ").or_else(|| line.strip_prefix("cargo run --release -- "))?;
    let words: Vec<String> = rest.split_whitespace().map(String::from).collect();
    let known = words.first().is_some_and(|first| COMMANDS.contains(&first.as_str()));
    // a placeholder in capitals is no command line
    let real = words.iter().all(|w| w.len() < 2 || w.chars().any(|c| !c.is_ascii_uppercase()) || w.contains('='));
    (known && real).then_some(words)
}

/// The README and the files of `docs/`, as text.
fn documents() -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let pages = std::fs::read_dir(root.join("docs")).expect("docs").map(|entry| entry.expect("listed").path());
    let pages = pages.filter(|path| path.extension().is_some_and(|e| e == "md"));
    let texts = pages.chain([root.join("README.md")]).map(|path| std::fs::read_to_string(path).expect("read"));
    texts.collect()
}

/// Every command line that the help texts and the documents show, once.
fn promised(folder: &Path) -> BTreeSet<Vec<String>> {
    let mut all = BTreeSet::new();
    let helps = std::iter::once(vec!["--help"]).chain(COMMANDS.map(|command| vec![command, "--help"]));
    let helps = helps.chain([vec!["export", "c", "--help"], vec!["export", "onnx", "--help"]]);
    for help in helps {
        let (text, _) = exits(0, folder, &help);
        all.extend(text.lines().filter_map(|line| words(line.strip_prefix("  ")?)));
    }
    for text in documents() {
        all.extend(text.lines().filter_map(words));
        // what stands between backticks; the text beside them begins with no command,
        // and a command's bare name among prose is no line
        all.extend(text.split('`').filter_map(words).filter(|line| line.len() > 1));
    }
    all
}

/// With sizes that take no time.
fn smaller(line: &[String]) -> Vec<String> {
    let mut line = line.to_vec();
    let given = |line: &[String], option: &str| line.iter().position(|word| word == option);
    let all_tasks = given(&line, "--all").is_some();
    let of_task = line.get(1).is_some_and(|word| !word.starts_with('-'));
    for (command, option, value) in SMALLER {
        let without_task = *command == "bench" && !of_task && *option == "--envs" && given(&line, "--policy").is_some();
        if line[0] != *command || given(&line, "--toml").is_some() && line[0] == "train" || without_task {
            continue;
        }
        let value = if all_tasks && *option == "--envs" { "1" } else { value };
        match given(&line, option) {
            Some(at) => line[at + 1] = value.to_string(),
            None => line.extend([option.to_string(), value.to_string()]),
        }
    }
    if given(&line, "--margins").is_some() {
        // two steps do not climb to a margin of 0.5
        line.extend(["--disk".into(), "0.1".into()]);
    }
    let quick = ["bench", "benchmark"].contains(&line[0].as_str()) && given(&line, "--quick").is_none();
    line.extend(quick.then(|| "--quick".to_string()));
    if line[0] == "train" && given(&line, "--resume").is_some() {
        // what is gone on with is the run of another line: its settings are its own, and its end
        for option in ["--envs", "--horizon", "--updates"] {
            let at = given(&line, option).expect("given above");
            line.drain(at..at + 2);
        }
    }
    line
}

/// What the lines name.
fn furnish(folder: &Path) {
    let asset = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/urdf").join(name);
    for (from, to) in [
        ("plain_x.urdf", "drone.urdf"),
        ("plain_x.rotors.toml", "drone.rotors.toml"),
        ("plain_x.rotors.toml", "mine.toml"),
    ] {
        std::fs::copy(asset(from), folder.join(to)).expect("copied");
    }
    let (vehicle, _) = exits(0, folder, &["models", "hummingbird", "--toml"]);
    for name in ["my_drone.toml", "my.toml"] {
        std::fs::write(folder.join(name), &vehicle).expect("written");
    }
    let (task, _) = exits(0, folder, &["tasks", "Hover", "--toml"]);
    std::fs::write(folder.join("hover.toml"), task).expect("written");
    std::fs::write(folder.join("plans.toml"), "latency = 10\nstages = 25\n").expect("written");
    std::fs::write(folder.join("fast.toml"), "kind = \"lemniscate\"\nrate = 1.5\n").expect("written");
    let gains =
        "position = [4, 4, 4]\nvelocity = [2.2, 2.2, 2.2]\nattitude = [1.0, 1.0, 0.1]\nrate = [0.2, 0.2, 0.05]\n";
    std::fs::create_dir_all(folder.join("out")).expect("made");
    std::fs::write(folder.join("out/gains.toml"), gains).expect("written");
    // flights come before what they fly along: lines are in the order of letters
    exits(0, folder, &["optimise", "slalom", "--no-plots"]);
    // the whole of it: what is shown of a policy is flown by one that can fly
    let run = ["--no-plots", "--no-baseline", "--set", "checkpoint.keep=100", "--set", "evaluate.every=0"];
    exits(0, folder, &[&["train", "Hover"][..], &run].concat());
}

/// Files of a line that are not the ones made above.
fn refit(line: &mut [String]) {
    let drone = line.iter().any(|word| word == "drone.urdf");
    for at in 0..line.len() {
        let before = at.checked_sub(1).map(|k| line[k].clone()).unwrap_or_default();
        match line[at].as_str() {
            "drone.toml" if before == "--rotors" => line[at] = "drone.rotors.toml".into(),
            "drone.toml" if before == "--to" => line[at] = "made/drone.toml".into(),
            "drone.toml" if !drone => line[at] = "my_drone.toml".into(),
            "out/firefly/gains.toml" => line[at] = "out/gains.toml".into(),
            // a run of Python's, in whose place any will do
            "runs/beacon" => line[at] = "runs/Hover-apg-s0".into(),
            _ => {}
        }
    }
}

/// Whether the lines of a command take minutes.
fn is_long(line: &[String]) -> bool {
    ["bench", "benchmark", "train-all", "study", "tune"].contains(&line[0].as_str())
        || line.iter().any(|word| word == "--all")
}

/// Runs a line; what it broke of its promise.
fn broken(folder: &Path, promised: &[String]) -> Option<String> {
    let mut line = smaller(promised);
    refit(&mut line);
    if line[0] == "train" && !line.iter().any(|word| ["--resume", "--toml", "--out"].contains(&word.as_str())) {
        // the run that is there stays
        line.extend(["--out".into(), format!("runs/{}", promised.join("_").replace('/', "_"))]);
    }
    let is_left_out = |word: &String| word.starts_with("--drop") || word == "--fail" || word == "--help";
    let flies = line[0] == "fly" && !line.iter().any(is_left_out);
    if flies && !line.iter().any(|word| word == "--json") {
        line.push("--json".into());
    }
    let arguments: Vec<&str> = line.iter().map(String::as_str).collect();
    let output = command(folder, &arguments).output().expect("the binary starts");
    let told = format!("omnidrones {}", line.join(" "));
    if output.status.code() != Some(0) {
        return Some(format!("{told}: {:?}: {}", output.status.code(), String::from_utf8_lossy(&output.stderr)));
    }
    if flies {
        let Ok(flown) = serde_json::from_slice::<Value>(&output.stdout) else {
            return Some(format!("{told}: prints no JSON"));
        };
        let farthest = flown["flight"]["max_error_overall"].as_f64();
        if farthest.is_none_or(|metres| metres > LOST) {
            return Some(format!("{told}: {farthest:?} m from its reference, and exits with 0"));
        }
    }
    None
}

fn kept(which: impl Fn(&[String]) -> bool) {
    let folder = temporary();
    let lines = promised(folder.path());
    assert!(lines.len() > 60, "{}", lines.len());
    furnish(folder.path());
    let broken: Vec<String> =
        lines.iter().filter(|line| which(line)).filter_map(|line| broken(folder.path(), line)).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn every_command_line_of_help_and_documents_does_what_it_says() {
    kept(|line| !is_long(line));
}

/// `cargo test --release -p omnidrones-cli --test command_line promises -- --ignored`
#[test]
#[ignore = "cargo test --release -p omnidrones-cli --test command_line promises -- --ignored: minutes"]
fn every_long_command_line_of_help_and_documents_does_what_it_says() {
    kept(is_long);
}

#[test]
fn help_that_cannot_be_written_fails() {
    let folder = temporary();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full");
    let Ok(full) = full else { return };
    for arguments in [&["--help"][..], &["fly", "--help"], &["--version"]] {
        let mut own = command(folder.path(), arguments);
        let status = own.stdout(full.try_clone().expect("cloned")).status().expect("the binary starts");
        assert_eq!(status.code(), Some(2), "{arguments:?}");
    }
}
