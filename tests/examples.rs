//! Every file in `examples/` runs as it stands; a new one is found by itself. `cargo test` builds them beside this test;
//! to run it alone, first `cargo build --examples --profile test`.

use omnidrones::controllers::registry::REGISTRY;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const LIMIT: Duration = Duration::from_secs(60);
/// Prints the tables of docs/which-controller.md: some hundred flights.
const COMPARISON: &str = "which_controller";
/// Of it, while the others run beside it.
const LONG: Duration = Duration::from_secs(300);

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

/// Runs one example in an empty folder: how long it took, and what it printed. The complaint if it fails or takes too long.
fn run(name: &str, limit: Duration) -> Result<(Duration, String), String> {
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
            None if start.elapsed() > limit => {
                child.kill().unwrap();
                child.wait().unwrap();
                return Err(format!("{name}: still running after {limit:?}"));
            }
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    let said = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    if !status.success() {
        return Err(format!("{name}: {status}\n{}", said("stderr")));
    }
    let printed = said("stdout");
    if printed.is_empty() {
        return Err(format!("{name}: printed nothing"));
    }
    Ok((start.elapsed(), printed))
}

#[test]
fn every_example_runs_to_its_end() {
    let mut names = names();
    assert!(names.len() >= 8, "{names:?}");
    // the longest: run below
    names.retain(|name| name != COMPARISON);
    let mut complaints = Vec::new();
    for name in &names {
        match run(name, LIMIT) {
            Ok((time, _)) => println!("{name}: {time:.2?}"),
            Err(complaint) => complaints.push(complaint),
        }
    }
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
}

/// The errors of a row in mm, and what stands beside them. The last cell is a time, which is left out.
fn row(line: &str) -> (Vec<f64>, Vec<&str>) {
    let mut cells: Vec<&str> = line.split('|').map(str::trim).collect();
    // behind the last bar is nothing
    cells.truncate(cells.len().saturating_sub(2));
    let error = |cell: &&str| cell.strip_suffix(" mm").and_then(|mm| mm.parse().ok());
    (cells.iter().filter_map(error).collect(), cells.into_iter().filter(|cell| error(cell).is_none()).collect())
}

#[test]
fn the_page_on_controllers_shows_every_one_with_the_errors_that_its_example_prints() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let page = std::fs::read_to_string(docs.join("which-controller.md")).expect("the page");
    let shown: Vec<_> = page.lines().filter(|line| line.contains(" mm |")).map(row).collect();
    let (_, printed) = run(COMPARISON, LONG).unwrap_or_else(|complaint| panic!("{complaint}"));
    let rows: Vec<_> = printed.lines().filter(|line| line.contains(" mm |")).map(row).collect();
    assert!(rows.len() > REGISTRY.len(), "{printed}");
    for (errors, beside) in rows {
        let own = shown.iter().find(|own| own.1 == beside && own.0.len() == errors.len());
        let Some((own, _)) = own else { panic!("no row of the page is {beside:?} {errors:?}") };
        println!("{beside:?}: {errors:?}");
        let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 0.1 * b + 0.2;
        assert!(errors.iter().zip(own).all(near), "{beside:?}: {errors:?}, on the page {own:?}");
    }
    for entry in &REGISTRY {
        assert!(page.contains(&format!("| `{}` |", entry.name)), "no row of {}", entry.name);
        assert!(page.contains(&format!("{}.svg)", entry.name)), "no figure of {}", entry.name);
    }
    let figures: Vec<&str> =
        page.split("](").filter_map(|rest| rest.split_once(".svg)")).map(|(path, _)| path).collect();
    for path in figures {
        let size = std::fs::metadata(docs.join(format!("{path}.svg"))).expect(path).len();
        assert!((1000..60_000).contains(&size), "{path}: {size} bytes");
    }
}
