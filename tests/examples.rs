//! Every file in `examples/` runs as it stands; a new one is found by itself. `cargo test` builds them beside this test;
//! to run it alone, first `cargo build --examples --profile test`.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const LIMIT: Duration = Duration::from_secs(60);

/// `target/<profile>/examples`, beside the folder of this test's own executable.
fn executables() -> PathBuf {
    let own = std::env::current_exe().expect("the path of this test");
    let profile = own.parent().and_then(Path::parent).expect("target/<profile>/deps");
    profile.join("examples")
}

fn names() -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    let files = std::fs::read_dir(folder).expect("examples/").map(|entry| entry.unwrap().path());
    let rust = files.filter(|path| path.extension().is_some_and(|e| e == "rs"));
    let mut names: Vec<String> = rust.map(|path| path.file_stem().unwrap().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// Runs one example in an empty folder; the complaint if it fails or takes too long.
fn run(name: &str) -> Result<Duration, String> {
    let folder = tempfile::tempdir().unwrap();
    let program = executables().join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    // into files: a full pipe would block the example
    let file = |name: &str| std::fs::File::create(folder.path().join(name)).unwrap();
    let start = Instant::now();
    let mut child = Command::new(&program)
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .stdout(file("stdout"))
        .stderr(file("stderr"))
        .spawn()
        .map_err(|e| format!("{name} does not start: {e}. Build it: cargo build --examples --profile test"))?;
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if start.elapsed() > LIMIT => {
                child.kill().unwrap();
                child.wait().unwrap();
                return Err(format!("{name}: still running after {LIMIT:?}"));
            }
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    let said = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    if !status.success() {
        return Err(format!("{name}: {status}\n{}", said("stderr")));
    }
    if said("stdout").is_empty() {
        return Err(format!("{name}: printed nothing"));
    }
    Ok(start.elapsed())
}

#[test]
fn every_example_runs_to_its_end() {
    let names = names();
    assert!(names.len() >= 8, "{names:?}");
    let mut complaints = Vec::new();
    for name in &names {
        match run(name) {
            Ok(time) => println!("{name}: {time:.2?}"),
            Err(complaint) => complaints.push(complaint),
        }
    }
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
}
