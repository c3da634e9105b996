//! The command line as a stranger meets it: the built binary, its pages, JSON, errors and exit codes.

use crate::command::{command, exits, size, temporary};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn run(folder: &Path, arguments: &[&str]) -> Output {
    command(folder, arguments).output().expect("the binary starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

/// The one JSON object that a command prints.
fn json(code: i32, folder: &Path, arguments: &[&str]) -> Value {
    let (out, err) = exits(code, folder, arguments);
    assert_eq!(err, "", "{arguments:?}");
    serde_json::from_str(&out).unwrap_or_else(|e| panic!("{arguments:?}: {e}\n{out}"))
}

fn asset(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/urdf").join(name).display().to_string()
}

/// Copies a URDF of the corpus, and its rotor file if `with_rotors`.
fn copy(folder: &Path, stem: &str, with_rotors: bool) -> PathBuf {
    let urdf = folder.join(format!("{stem}.urdf"));
    std::fs::copy(asset(&format!("{stem}.urdf")), &urdf).expect("copied");
    if with_rotors {
        let name = format!("{stem}.rotors.toml");
        std::fs::copy(asset(&name), folder.join(name)).expect("copied");
    }
    urdf
}

fn is_file(path: PathBuf) -> bool {
    std::fs::metadata(path).is_ok_and(|m| m.is_file() && m.len() > 0)
}

#[test]
fn without_a_vehicle_a_urdf_is_flown_within_a_decimetre_and_drawn() {
    let folder = temporary();
    let (out, err) = exits(0, folder.path(), &["fly"]);
    assert_eq!(err, "");
    for words in
        ["plain_x · URDF", "thrust / weight", "hover", "tracking RMSE", "× real time", "one step of the closed loop"]
    {
        assert!(out.contains(words), "{words}\n{out}");
    }
    assert!(!out.contains('\u{1b}') && !out.contains("NOT HELD") && !out.contains("FAILED"), "{out}");
    assert_eq!(out.matches("certified").count(), 2, "{out}");
    for name in ["overview", "path", "error", "rotors", "attitude"] {
        assert!(is_file(folder.path().join(format!("out/plain_x/{name}.png"))), "{name}");
    }
    let flown = json(0, folder.path(), &["fly", "--json", "--no-plots", "--max-rmse", "0.1"]);
    let rmse = flown["flight"]["rmse"].as_f64().expect("a number");
    // measured: 0.0167 m
    assert!(rmse < 0.03, "{rmse}");
}

#[test]
fn every_vehicle_flies_with_certified_derivatives() {
    let folder = temporary();
    let models = json(0, folder.path(), &["models", "--json"]);
    let models = models["models"].as_array().expect("a list");
    assert!(models.len() >= 6);
    for model in models {
        let name = model["name"].as_str().expect("a name");
        let flown = json(0, folder.path(), &["fly", name, "--json", "--no-plots", "--max-rmse", "0.1"]);
        assert_eq!(flown["success"], true, "{name}");
        for derivative in flown["derivatives"].as_array().expect("a list") {
            assert_eq!(derivative["holds"], true, "{name}: {derivative}");
        }
    }
    assert!(!folder.path().join("out").exists(), "--no-plots writes nothing");
}

#[test]
fn derivatives_are_certified_along_every_reference_and_a_kink_is_named() {
    let folder = temporary();
    for model in omnidrones::dynamics::vehicles::all() {
        for reference in omnidrones::controllers::Reference::names() {
            let arguments = ["fly", &model.name, "--reference", reference, "--duration", "3", "--no-plots"];
            let flown = json(0, folder.path(), &[&arguments[..], &["--json"]].concat());
            let rows = flown["derivatives"].as_array().expect("a list");
            assert_eq!(rows.len(), 2, "{} {reference}: {}", model.name, flown["left_out"]);
            for row in rows {
                assert_eq!(
                    (&row["holds"], &row["kinks"]),
                    (&true.into(), &0.into()),
                    "{} {reference}: {row}",
                    model.name
                );
            }
            // motors that run as they are commanded are on a kink where they slow down otherwise than they speed up
            let alike = model.rotors.iter().all(|r| r.time_constant_up == r.time_constant_down);
            if *reference == "hover" && !alike {
                assert_eq!(rows[0]["beside_kink"], true, "{}", model.name);
            }
        }
    }
    let (page, _) = exits(0, folder.path(), &["fly", "iris", "--reference", "hover", "--no-plots", "--duration", "3"]);
    assert!(page.contains("the flown step lies on a kink: motors") && page.matches("certified").count() == 2, "{page}");
    assert!(!page.contains("a derivative is wrong"), "{page}");
}

#[test]
fn a_flight_writes_svg_and_csv_where_it_is_told() {
    let folder = temporary();
    let arguments =
        ["fly", "iris", "--duration", "3", "--format", "svg", "--csv", "--out", "a/b", "--wind", "dryden:5", "--json"];
    let flown = json(0, folder.path(), &arguments);
    let files: Vec<&str> = flown["files"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    assert_eq!(files.len(), 7, "{files:?}");
    for file in files {
        assert!(is_file(folder.path().join(file)), "{file}");
    }
    let csv = std::fs::read_to_string(folder.path().join("a/b/flight.csv")).expect("read");
    assert!(csv.starts_with("time [s],position_x [m]"), "{}", &csv[..80]);
    assert_eq!(csv.lines().count(), 1502);
    assert!(csv.lines().next().is_some_and(|header| header.ends_with(",commanded_angular_velocity_z [rad/s]")));
    assert_eq!(flown["plan"]["wind"]["kind"], "dryden");
}

#[test]
fn the_same_arguments_give_the_same_flight_and_another_seed_another_wind() {
    let folder = temporary();
    let fly = |seed: &str| {
        let arguments = ["fly", "--wind", "dryden:10", "--duration", "4", "--seed", seed, "--json", "--no-plots"];
        json(0, folder.path(), &arguments)["flight"].clone()
    };
    assert_eq!(fly("1"), fly("1"));
    assert_ne!(fly("1"), fly("2"));
}

#[test]
fn a_flight_that_fails_exits_with_1_and_says_why() {
    let folder = temporary();
    let (out, _) = exits(1, folder.path(), &["fly", "iris", "--max-rmse", "0.0001", "--no-plots", "--duration", "3"]);
    assert!(out.contains("FAILED: the tracking RMSE of"), "{out}");
    let gains = "position = [9e5,9e5,9e5]\nvelocity = [1e4,1e4,1e4]\nattitude = [9e9,9e9,9e9]\nrate = [9e9,9e9,9e9]\n";
    std::fs::write(folder.path().join("wild.toml"), gains).expect("written");
    let output = run(folder.path(), &["fly", "--gains", "wild.toml", "--json", "--no-plots", "--max-rmse", "1"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let value: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(value["success"], false);
    assert!(value["failure"].is_string());
    // drifts away in a wind that its thrust cannot hold against
    let blown = ["fly", "hummingbird", "--wind", "200,0,0", "--duration", "6", "--no-plots"];
    let (out, _) = exits(1, folder.path(), &blown);
    assert!(out.contains("FAILED: the vehicle was lost at "), "{out}");
}

#[test]
fn rates_follow_a_coarser_step_unless_they_were_given() {
    let folder = temporary();
    let flown = json(0, folder.path(), &["fly", "--dt", "0.004", "--duration", "3", "--json", "--no-plots"]);
    assert_eq!(flown["plan"]["rates"]["rate"], 250.0);
    let (_, err) = exits(2, folder.path(), &["fly", "--dt", "0.004", "--rates", "500,250,100", "--no-plots"]);
    assert!(err.contains("controller rate 'velocity' is 100 Hz with dt = 0.004 s"), "{err}");
}

#[test]
fn models_prints_lists_sheets_toml_and_urdf_that_read_back() {
    let folder = temporary();
    let (list, _) = exits(0, folder.path(), &["models"]);
    let (sheet, _) = exits(0, folder.path(), &["models", "neo11"]);
    for words in ["crazyflie", "omav", "hover command", "numbers from"] {
        assert!(list.contains(words), "{list}");
    }
    for words in ["Parts", "Rotors", "Allocation matrix", "Gains", "attitude bandwidth", "k_f", "counter-clockwise"] {
        assert!(sheet.contains(words), "{words}\n{sheet}");
    }
    let widest = list.lines().chain(sheet.lines()).map(|l| l.chars().count()).max().unwrap_or(0);
    assert!(widest <= 120, "{widest}\n{list}\n{sheet}");
    let (toml, _) = exits(0, folder.path(), &["models", "firefly", "--toml"]);
    std::fs::write(folder.path().join("mine.toml"), toml).expect("written");
    exits(0, folder.path(), &["models", "firefly", "--urdf", "export"]);
    let mass = |arguments: &[&str]| json(0, folder.path(), arguments)["mass"].as_f64().expect("a mass");
    let built_in = mass(&["models", "firefly", "--json"]);
    assert_eq!(mass(&["models", "mine.toml", "--json"]), built_in);
    assert!((mass(&["models", "export/firefly.urdf", "--json"]) - built_in).abs() < 1e-12);
    let (_, err) = exits(2, folder.path(), &["models", "firefly", "--urdf", "export"]);
    assert!(err.contains("which exists") && err.contains("--force"), "{err}");
    exits(0, folder.path(), &["models", "firefly", "--urdf", "export", "--force"]);
}

#[test]
fn import_drafts_rotor_data_once_and_says_what_it_assumed() {
    let folder = temporary();
    copy(folder.path(), "plain_x", false);
    let (_, err) = exits(2, folder.path(), &["fly", "plain_x.urdf"]);
    assert!(err.contains("plain_x.rotors.toml") && err.contains("omnidrones import"), "{err}");
    let (out, err) = exits(0, folder.path(), &["import", "plain_x.urdf"]);
    assert_eq!(err, "writing plain_x.rotors.toml: a draft of its rotors\n", "said before");
    for words in [
        "The cylinders (1) in the collision geometry of 'body' touch by what fits into them",
        "DRAFT",
        "Assumed, not read",
        "thrust_coefficient",
        "Written",
        "omnidrones fly plain_x.urdf",
    ] {
        assert!(out.contains(words), "{words}\n{out}");
    }
    assert!(is_file(folder.path().join("plain_x.rotors.toml")));
    exits(0, folder.path(), &["fly", "plain_x.urdf", "--no-plots"]);

    let (again, _) = exits(0, folder.path(), &["import", "plain_x.urdf"]);
    assert!(!again.contains("DRAFT") && again.contains("drafted from names"), "{again}");
    assert!(again.contains("are marked '# assumed'"), "{again}");
    let (_, err) = exits(2, folder.path(), &["import", "plain_x.urdf", "--draft"]);
    assert!(err.contains("which exists") && err.contains("--force"), "{err}");
    let (out, _) = exits(0, folder.path(), &["import", "plain_x.urdf", "--draft", "--out", "new"]);
    assert!(out.contains("omnidrones fly plain_x.urdf --rotors new/plain_x.rotors.toml"), "{out}");
    exits(0, folder.path(), &["import", "plain_x.urdf", "--draft", "--force"]);
}

#[test]
fn import_prints_a_command_that_a_shell_takes() {
    let folder = temporary();
    let name = "quad ä's.urdf";
    std::fs::copy(asset("pocket.urdf"), folder.path().join(name)).expect("copied");
    let (out, _) = exits(0, folder.path(), &["import", name]);
    let printed = out.lines().find_map(|line| line.strip_prefix("Fly it: omnidrones fly ")).expect("a command");
    let echoed = Command::new("sh").args(["-c", &format!("printf %s {printed}")]).output().expect("a shell");
    assert_eq!(text(&echoed.stdout), name, "{printed}");
    let (out, _) = exits(0, folder.path(), &["import", &asset("plain_x.urdf"), "--out", "new", "--draft"]);
    assert!(out.contains("plain_x.urdf --rotors new/plain_x.rotors.toml"), "{out}");
}

#[test]
fn units_that_make_no_sense_are_told_by_every_command_before_it_flies() {
    let folder = temporary();
    let (toml, _) = exits(0, folder.path(), &["models", "hummingbird", "--toml"]);
    let grams = toml.replace("mass = 0.68", "mass = 680.0").replace("mass = 0.009", "mass = 9.0");
    assert!(grams != toml);
    std::fs::write(folder.path().join("grams.toml"), grams).expect("written");
    let told = "mass: 716 kg on arms of 0.17 m make 146000 kg/m³ over the cube of the arm, above 8000 (steel). \
                Read as grams, 0.716 kg. Write kilograms and metres.";
    let (page, _) = exits(0, folder.path(), &["models", "grams.toml"]);
    assert!(page.contains(&format!("warning {told}")), "{page}");
    // it cannot hover, which is told after what is the matter
    let (_, err) = exits(2, folder.path(), &["fly", "grams.toml", "--no-plots", "--duration", "1"]);
    assert!(err.starts_with(&format!("warning: {told}\n")) && err.contains("error"), "{err}");

    // of a URDF whose rotors are drafted from the same mass, which flies
    copy(folder.path(), "plain_x", false);
    let urdf = std::fs::read_to_string(folder.path().join("plain_x.urdf")).expect("read");
    let heavy = urdf.replace("mass value=\"0.62\"", "mass value=\"620\"").replace("value=\"0.012\"", "value=\"12\"");
    assert!(heavy != urdf);
    std::fs::write(folder.path().join("plain_x.urdf"), heavy).expect("written");
    let (page, _) = exits(0, folder.path(), &["import", "plain_x.urdf"]);
    assert!(page.contains("- plain_x.urdf: mass: ") && page.contains("Read as grams, "), "{page}");
    let (page, err) = exits(0, folder.path(), &["fly", "plain_x.urdf", "--no-plots", "--duration", "1"]);
    assert!(err.starts_with("warning: mass: ") && page.contains("warning plain_x.urdf: mass: "), "{err}\n{page}");
    let flown = json(0, folder.path(), &["fly", "plain_x.urdf", "--no-plots", "--duration", "1", "--json"]);
    let warnings = flown["source"]["warnings"].as_array().expect("a list");
    assert!(warnings.iter().any(|w| w.as_str().is_some_and(|w| w.contains("Read as grams"))), "{flown}");

    // and nothing of those that are built in
    for name in omnidrones::dynamics::vehicles::names() {
        let (page, err) = exits(0, folder.path(), &["models", name]);
        assert!(!page.contains("warning") && err.is_empty(), "{page}\n{err}");
    }
}

#[test]
fn import_writes_one_vehicle_file_that_flies_the_same() {
    let folder = temporary();
    copy(folder.path(), "pocket", false);
    let imported = json(0, folder.path(), &["import", "pocket.urdf", "--to", "pocket.toml", "--json"]);
    assert_eq!(imported["rotors_from"], "its <properties>");
    assert!(!imported["assumptions"].as_array().expect("a list").is_empty());
    let flight = |file: &str| json(0, folder.path(), &["fly", file, "--no-plots", "--json"])["flight"].clone();
    assert_eq!(flight("pocket.urdf"), flight("pocket.toml"));
    let (_, err) = exits(2, folder.path(), &["import", "pocket.urdf", "--to", "pocket.txt"]);
    assert!(err.contains("ends in .toml"), "{err}");
}

#[test]
fn tune_writes_gains_that_fly_better() {
    let folder = temporary();
    let arguments =
        ["tune", "hummingbird", "--iterations", "3", "--starts", "16", "--held-out", "16", "--duration", "2", "--json"];
    let tuned = json(0, folder.path(), &arguments);
    assert!(tuned["improvement"].as_f64().expect("a number") > 0.0, "{tuned}");
    assert_eq!(tuned["history"].as_array().expect("a list").len(), 3);
    let margins = ["margins_before", "margins_after"].map(|k| tuned[k]["disk"]["alpha"].as_f64().expect("a number"));
    assert!(margins.iter().all(|alpha| *alpha > 0.0) && tuned["warnings"].is_array(), "{tuned}");
    assert!(is_file(folder.path().join("out/hummingbird/tune.png")));
    let rmse = |more: &[&str]| {
        let arguments = [&["fly", "hummingbird", "--no-plots", "--json"], more].concat();
        json(0, folder.path(), &arguments)["flight"]["rmse"].as_f64().expect("a number")
    };
    assert!(rmse(&["--gains", "out/hummingbird/gains.toml"]) < rmse(&[]));
    let (out, _) = exits(0, folder.path(), &arguments[..arguments.len() - 1]);
    assert!(out.contains("held-out RMSE after") && out.contains("--gains out/hummingbird/gains.toml"), "{out}");
}

#[test]
fn bench_measures_every_group() {
    let folder = temporary();
    let measured = json(0, folder.path(), &["bench", "--quick", "--threads", "1", "--envs", "256", "--json"]);
    let rows = measured["rows"].as_array().expect("a list");
    assert!(rows.len() > 5);
    assert_eq!(measured["instructions"], omnidrones::autodiff::native::instructions());
    assert!(rows.iter().all(|r| r["value"].as_f64().is_some_and(|v| v > 0.0)), "{measured}");
    // a step that takes longer than the plain one is dear, and one of many in lanes is cheap: rates and times alike
    let in_lanes: Vec<_> = rows.iter().filter(|r| r["group"] == "derivative" && r["unit"] == "M/s").collect();
    // a step and its adjoint, each as machine code where it is made, and interpreted
    assert_eq!(in_lanes.len(), 4, "{measured}");
    for row in in_lanes {
        let faster = 1e-3 * row["value"].as_f64().unwrap() * rows[0]["value"].as_f64().unwrap();
        // the plain step may have been slower when it was measured first
        assert!((0.3..1.01).contains(&(row["ratio"].as_f64().unwrap() / faster)), "{row}: {faster} times as fast");
    }
    assert!(is_file(folder.path().join("out/bench/bench.png")));
}

#[test]
fn an_unknown_name_suggests_the_nearest() {
    let folder = temporary();
    for (arguments, words) in [
        (["fly", "humingbird"], "did you mean 'hummingbird'?"),
        (["models", "fireflie"], "did you mean 'firefly'?"),
        (["fly", "--reference=lemniscat"], "did you mean 'lemniscate'?"),
        (["fli", "iris"], "'fly'"),
        (["fly", "--durration=3"], "'--duration'"),
        (["fly", "--effects=rotor-drg"], "rotor-drag"),
    ] {
        let (out, err) = exits(2, folder.path(), &arguments);
        assert!(out.is_empty() && err.contains(words), "{arguments:?}: {err}");
    }
}

#[test]
fn unusable_input_names_value_limit_and_remedy_and_exits_with_2() {
    let folder = temporary();
    std::fs::write(folder.path().join("empty.toml"), "").expect("written");
    std::fs::write(folder.path().join("bad.toml"), "kind = 'circle'\nradios = 3").expect("written");
    std::fs::write(folder.path().join("binary.toml"), [0xff, 0xfe, 0x00]).expect("written");
    std::fs::write(folder.path().join("not.urdf"), "<robot").expect("written");
    std::fs::write(folder.path().join("drone.xacro"), "<robot/>").expect("written");
    std::fs::write(folder.path().join("x.rotors.toml"), "").expect("written");
    std::fs::create_dir(folder.path().join("folder.toml")).expect("made");
    for (arguments, words) in [
        ("fly --dt 0", "dt is 0, but it must be in (0, 1] s. 2 ms suits"),
        ("fly --dt -1", "dt is -1"),
        ("fly --dt 1e-320", "but it must be at least 1e-9 s"),
        ("models iris --urdf /dev/null", "a folder that can be made"),
        ("fly --dt nan", "dt is NaN"),
        ("fly --dt inf", "dt is inf"),
        ("fly --dt abc", "invalid value 'abc' for '--dt <SECONDS>'"),
        ("fly --duration 1e12", "1000000000000 s"),
        ("fly --duration 0", "duration is 0 s"),
        ("fly --duration nan", "duration is NaN s"),
        ("fly --duration 1e-9", "duration is"),
        ("fly --substeps 0", "substeps is 0, below the limit of 1 to 1000"),
        ("fly --substeps 1001", "substeps is 1001"),
        ("fly --rates 500,250", "expected 3 numbers RATE,ATTITUDE,VELOCITY in Hz, got 2"),
        ("fly --rates 0,0,0", "0 Hz"),
        ("fly --rates -500,250,100", "-500 Hz"),
        ("fly --wind storm", "expected none, X,Y,Z (m/s), dryden:W20"),
        ("fly --wind 1,2,inf", "inf is not finite"),
        ("fly --wind dryden:-3", "it must be ≥ 0 m/s"),
        ("fly --integrator euler", "[possible values: rk4, semi-implicit]"),
        ("fly --effects none", "[possible values: body-drag"),
        ("fly --effects body-drag --no-effects", "cannot be used with"),
        ("fly --gains missing.toml", "missing.toml: No such file"),
        ("fly --gains empty.toml", "empty.toml: line 1, column 1: missing field `position`"),
        ("fly --gains folder.toml", "folder.toml is a folder, but it must be a regular file"),
        ("fly --gains binary.toml", "is not UTF-8 text"),
        ("fly crazyflie --gains published", "nobody published gains for 'crazyflie'"),
        ("fly --reference bad.toml", "unknown field `radios`"),
        ("fly --max-rmse -1", "--max-rmse is -1"),
        ("fly missing.urdf", "missing.urdf: No such file: looked for from"),
        ("fly missing.toml", "missing.toml: No such file: looked for from"),
        ("fly not.urdf --rotors missing.toml", "missing.toml: No such file: looked for from"),
        ("import not.urdf --rotors missing.toml", "missing.toml: No such file: looked for from"),
        ("fly folder.toml", "folder.toml is a folder, but it must be a regular file"),
        ("fly empty.toml", "missing field"),
        ("fly not.urdf", "not.urdf: line 1"),
        ("fly drone.xacro", "Expand it first: xacro"),
        ("fly x.rotors.toml", "Name the URDF beside it"),
        ("fly some.obj", "ends in .toml or .urdf"),
        ("fly iris --rotors x.rotors.toml", "used with a URDF"),
        ("fly --package robots", "expected NAME=DIR"),
        ("fly --out empty.toml/x", "Name another one"),
        ("fly --format gif", "[possible values: png, svg]"),
        ("models iris --toml --json", "cannot be used with"),
        ("models --toml", "required arguments"),
        ("import", "<FILE.urdf>"),
        ("import missing.urdf", "missing.urdf: No such file"),
        ("import folder.toml", "must be a regular file"),
        ("tune", "<VEHICLE|FILE>"),
        ("tune iris --iterations 0", "iterations is 0, below the limit of 1 to 100000"),
        ("tune iris --starts 0", "n_start is 0"),
        ("tune iris --held-out 99999999", "n_held_out is 99999999"),
        ("tune iris --learning-rate nan", "learning_rate is NaN"),
        ("tune iris --duration 1e9", "duration is 1000000000 s"),
        ("bench --threads 0", "--threads is 0, below the limit of 1 to 1024"),
        ("bench --envs 0 --quick", "environments"),
        ("bench --envs 1000000000000 --quick", "1000000000000"),
    ] {
        let list: Vec<&str> = arguments.split(' ').collect();
        let (out, err) = exits(2, folder.path(), &list);
        assert_eq!(out.is_empty(), !list.contains(&"--json"), "{arguments}: {out}");
        assert!(err.contains(words), "{arguments}: {err}");
        assert!(!err.contains("panicked"), "{arguments}: {err}");
    }
    let left: Vec<String> = std::fs::read_dir(folder.path())
        .expect("read")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .filter(|name| name == "out" && is_file(folder.path().join("out/plain_x/overview.png")))
        .collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn no_argument_list_makes_it_panic_or_hang() {
    let folder = temporary();
    std::fs::write(folder.path().join("noise.urdf"), "<robot name='x'>".repeat(20_000)).expect("written");
    std::fs::write(folder.path().join("deep.toml"), format!("parts = {}", "[".repeat(100_000))).expect("written");
    let long = "x".repeat(100_000);
    let lists: Vec<Vec<&str>> = vec![
        vec![],
        vec![""],
        vec!["--"],
        vec!["-"],
        vec!["-h", "-h"],
        vec!["--json"],
        vec!["help", "nothing"],
        vec!["\u{0}x"; 0],
        vec!["💥"],
        vec![&long],
        vec!["fly", ""],
        vec!["fly", "-"],
        vec!["fly", "--"],
        vec!["fly", "."],
        vec!["fly", ".."],
        vec!["fly", "/"],
        vec!["fly", "/dev/null"],
        vec!["fly", "/dev/zero"],
        vec!["fly", "/dev/stdin.urdf"],
        vec!["fly", &long],
        vec!["fly", "💥.urdf"],
        vec!["fly", "noise.urdf"],
        vec!["fly", "deep.toml"],
        vec!["fly", "a", "b"],
        vec!["fly", "--dt"],
        vec!["fly", "--dt", ""],
        vec!["fly", "--dt", "1e-320"],
        vec!["fly", "--dt", "1e308"],
        vec!["fly", "--dt", "1e-300", "--duration", "1e300"],
        vec!["fly", "--duration", "-0"],
        vec!["fly", "--duration", "inf"],
        vec!["fly", "--substeps", "18446744073709551616"],
        vec!["fly", "--substeps", "-1"],
        vec!["fly", "--seed", "-1"],
        vec!["fly", "--seed", "99999999999999999999999"],
        vec!["fly", "--rates", ","],
        vec!["fly", "--rates", "1e308,1e308,1e308"],
        vec!["fly", "--rates", "1e-308,1e-308,1e-308"],
        vec!["fly", "--wind", ""],
        vec!["fly", "--wind", "dryden:::"],
        vec!["fly", "--wind", "dryden:1e308", "--duration", "0.1", "--no-plots"],
        vec!["fly", "--wind", "1e308,1e308,1e308", "--duration", "0.1", "--no-plots"],
        vec!["fly", "--effects", ""],
        vec!["fly", "--effects", ",,,"],
        vec!["fly", "--gains", ""],
        vec!["fly", "--gains", "."],
        vec!["fly", "--gains", &long],
        vec!["fly", "--reference", ""],
        vec!["fly", "--reference", "/dev/zero"],
        vec!["fly", "--rotors", "."],
        vec!["fly", "--out", ""],
        vec!["fly", "--out", "/dev/null/x"],
        vec!["fly", "--out", &long],
        vec!["fly", "--max-rmse", "nan"],
        vec!["models", ""],
        vec!["models", "--urdf"],
        vec!["models", "iris", "--urdf", "/dev/null"],
        vec!["import", ""],
        vec!["import", "."],
        vec!["import", "/dev/zero"],
        vec!["import", "noise.urdf", "--draft"],
        vec!["import", "noise.urdf", "--to", ".toml"],
        vec!["import", "noise.urdf", "--rotors", "/dev/null"],
        vec!["tune", ""],
        vec!["tune", "iris", "--starts", "18446744073709551615"],
        vec!["tune", "iris", "--dt", "1e-9"],
        vec!["bench", "--threads", "18446744073709551615"],
        vec!["bench", "--envs", "18446744073709551615", "--quick"],
    ];
    assert!(lists.len() >= 60);
    for list in &lists {
        let shown: Vec<String> = list.iter().map(|a| a.chars().take(40).collect()).collect();
        let output = run(folder.path(), list);
        let err = text(&output.stderr);
        assert!(matches!(output.status.code(), Some(0..=2)), "{shown:?}: {:?} {err:.500}", output.status);
        assert!(!err.contains("panicked") && !err.contains("overflow"), "{shown:?}: {err:.500}");
        assert!(output.status.code() == Some(0) || !(err.is_empty() && output.stdout.is_empty()), "{shown:?}: silent");
    }
}

#[test]
fn a_flight_goes_into_a_folder_of_others_on_demand_alone() {
    let folder = temporary();
    std::fs::create_dir(folder.path().join("mine")).expect("made");
    std::fs::write(folder.path().join("mine/notes.txt"), "kept").expect("written");
    let fly = ["fly", "hummingbird", "--duration", "0.1", "--no-plots", "--csv", "--out", "mine"];
    let (_, err) = exits(2, folder.path(), &fly);
    assert!(err.contains("notes.txt") && err.contains("--force"), "{err}");
    exits(0, folder.path(), &[&fly[..], &["--force"]].concat());
    assert_eq!(std::fs::read_to_string(folder.path().join("mine/notes.txt")).expect("kept"), "kept");
    assert!(size(folder.path(), "mine/flight.csv") > 1000);
}

#[test]
fn help_of_every_command_names_every_option_with_examples_and_exit_codes() {
    let folder = temporary();
    let vehicle = ["--rotors", "--package"];
    let flight =
        ["--reference", "--dt", "--substeps", "--integrator", "--effects", "--no-effects", "--rates", "--gains"];
    let fly = ["--duration", "--wind", "--seed", "--max-rmse", "--out", "--format", "--no-plots", "--csv", "--json"];
    let tune = ["--duration", "--iterations", "--starts", "--held-out", "--learning-rate", "--seed", "--out", "--json"];
    for (command, options) in [
        ("fly", [&vehicle[..], &flight, &fly].concat()),
        ("tune", [&vehicle[..], &flight, &tune].concat()),
        (
            "optimise",
            vec![
                "--iterations",
                "--guess",
                "--toml",
                "--out",
                "--force",
                "--format",
                "--no-plots",
                "--json",
                "--replay",
            ],
        ),
        ("models", [&vehicle[..], &["--json", "--toml", "--urdf", "--force"]].concat()),
        ("import", [&vehicle[..], &["--draft", "--out", "--to", "--force", "--json"]].concat()),
        ("bench", vec!["--quick", "--threads", "--envs", "--out", "--format", "--no-plots", "--json"]),
    ] {
        let (help, _) = exits(0, folder.path(), &[command, "--help"]);
        let about = if command == "fly" { "certificate" } else { "" };
        for words in options.iter().chain(&["Examples:", "Exit codes:", about, &format!("omnidrones {command}")]) {
            assert!(help.contains(words), "{command}: {words}\n{help}");
        }
        let width = help.lines().map(|l| l.chars().count()).max().unwrap_or(0);
        assert!(width <= 100, "{command}: {width} columns\n{help}");
        let (short, _) = exits(0, folder.path(), &[command, "-h"]);
        assert!(short.len() < help.len());
    }
    let (help, _) = exits(0, folder.path(), &["--help"]);
    for words in ["fly", "models", "import", "tune", "bench", "Examples:", "Exit codes:"] {
        assert!(help.contains(words), "{words}\n{help}");
    }
    let (version, _) = exits(0, folder.path(), &["--version"]);
    assert_eq!(version.trim(), concat!("omnidrones ", env!("CARGO_PKG_VERSION")));
}

/// Every command of the examples in the help texts is one that clap accepts.
#[test]
fn examples_in_the_help_are_real_commands() {
    let folder = temporary();
    let mut seen = 0;
    for command in ["fly", "models", "import", "tune", "optimise", "bench"] {
        let (help, _) = exits(0, folder.path(), &[command, "--help"]);
        for line in help.lines().filter_map(|l| l.strip_prefix("  omnidrones ")) {
            let example = line.split("  ").next().unwrap_or(line);
            let arguments: Vec<&str> = example.split(' ').take_while(|word| *word != ">").collect();
            let with_help = [arguments.as_slice(), &["--no-such-option"]].concat();
            let (_, err) = exits(2, folder.path(), &with_help);
            // clap stops at the first unusable argument: it must be the one added here
            assert!(err.contains("unexpected argument '--no-such-option'"), "{example}: {err}");
            seen += 1;
        }
    }
    assert!(seen >= 20, "{seen}");
}

#[test]
fn a_failure_behind_the_end_of_a_flight_is_refused_and_derivatives_are_of_the_cascade_alone() {
    let folder = temporary();
    let (_, err) = exits(2, folder.path(), &["fly", "hummingbird", "--fail", "1", "--at", "20"]);
    assert!(err.contains("--at is 20 s") && err.contains("--duration"), "{err}");
    let (_, err) = exits(2, folder.path(), &["fly", "hummingbird", "--duration", "0"]);
    assert!(err.contains("duration is 0 s") && !err.contains("shorter"), "{err}");
    let (page, _) =
        exits(0, folder.path(), &["fly", "hummingbird", "--controller", "indi", "--no-plots", "--duration", "3"]);
    assert!(!page.contains("Derivatives"), "{page}");
}

#[cfg(unix)]
#[test]
fn a_reader_that_leaves_is_no_failure_and_a_full_disk_is_one() {
    let folder = temporary();
    for arguments in [&["models"][..], &["--help"], &["fly", "--json", "--no-plots"]] {
        let mut child =
            command(folder.path(), arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts");
        drop(child.stdout.take());
        let output = child.wait_with_output().expect("ends");
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        assert_eq!(text(&output.stderr), "");
    }
    if let Ok(full) = std::fs::File::options().write(true).open("/dev/full") {
        let output = command(folder.path(), &["models"]).stdout(full).output().expect("starts");
        assert_eq!(output.status.code(), Some(2));
        assert!(text(&output.stderr).contains("standard output"), "{}", text(&output.stderr));
    }
}

/// A disk that fills is played by a limit on the size of files, in 512 bytes, whose signal is ignored: a write fails midway.
#[cfg(unix)]
#[test]
fn a_disk_that_fills_under_flights_and_reports_is_a_failure_that_leaves_every_file_whole() {
    let folder = temporary();
    let fly = ["fly", "hummingbird", "--reference", "hover", "--csv", "--no-plots", "--out", "flight", "--force"];
    let study = ["study", "paper", "--no-train", "--out", "study", "--force"];
    for (arguments, named) in [(&fly[..], "flight"), (&study, "study")] {
        exits(0, folder.path(), arguments);
        let whole = contents(&folder.path().join(named));
        for limit in [0, 1, 16] {
            let output = within_files_of(limit, folder.path(), arguments);
            let told = text(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{arguments:?} at {limit}: {told}");
            assert!(told.contains(named) && told.contains("too large"), "{arguments:?} at {limit}: {told}");
            let left = contents(&folder.path().join(named));
            assert!(left.keys().eq(whole.keys()), "{arguments:?} at {limit}: {:?}", left.keys());
            let cut = left.iter().find(|(path, bytes)| bytes.len() < whole[*path].len());
            assert!(cut.is_none(), "{arguments:?} at {limit}: {:?} is cut", cut.map(|(path, _)| path));
        }
    }
}

#[test]
#[cfg(unix)]
fn a_disk_that_fills_under_a_table_of_trainings_keeps_the_rows_that_were_there() {
    let folder = temporary();
    let row = ["train-all", "--tasks", "Hover", "--algo", "apg", "--budget", "0.002", "--no-plots", "--out", "rows"];
    let seeds = |n: &'static str| [&row[..], &["--seeds", n]].concat();
    let kept = || -> serde_json::Value {
        let bytes = std::fs::read(folder.path().join("rows/Hover-apg-u2.json")).expect("a row");
        serde_json::from_slice(&bytes).expect("whole")
    };
    exits(0, folder.path(), &seeds("1"));
    let was = kept();
    // the second seed's run fits neither, its failure fits the row of the larger one
    for limit in [1, 8] {
        let output = within_files_of(limit, folder.path(), &seeds("2"));
        let told = text(&output.stdout) + &text(&output.stderr);
        assert!(matches!(output.status.code(), Some(1 | 2)) && told.contains("too large"), "{limit}: {told}");
        assert_eq!(kept()["runs"][0], was["runs"][0], "{limit}: {told}");
    }
    exits(0, folder.path(), &seeds("2"));
    let both = kept();
    assert_eq!(both["runs"].as_array().map(Vec::len), Some(2), "{both}");
}

/// Runs a command none of whose files may become larger than so many blocks of 512 bytes.
#[cfg(unix)]
fn within_files_of(limit: u32, folder: &Path, arguments: &[&str]) -> std::process::Output {
    Command::new("sh")
        .args(["-c", &format!("trap '' XFSZ; ulimit -f {limit}; exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_omnidrones")])
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("a shell")
}

/// All files of a folder.
#[cfg(unix)]
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let paths = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    paths.map(|path| (path.clone(), std::fs::read(&path).expect("a file"))).collect()
}

#[test]
fn threads_that_cannot_be_had_are_no_failure() {
    let folder = temporary();
    let arguments =
        ["rollout", "Hover", "--controller", "random", "--envs", "300", "--horizon", "5", "--no-plots", "--csv"];
    let told = |key: &str, value: &str| {
        let mut command = command(folder.path(), &arguments);
        let output = command.env(key, value).args(["--out", key]).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{key}={value}: {}", text(&output.stderr));
        std::fs::read_to_string(folder.path().join(key).join("steps.csv")).unwrap()
    };
    // no machine has stacks of an exabyte, and none has so many cores
    let [refused, absurd] = [("RUST_MIN_STACK", (1_u64 << 60).to_string()), ("RAYON_NUM_THREADS", "20000".into())];
    assert_eq!(told(refused.0, &refused.1), told(absurd.0, &absurd.1));
}

#[test]
fn a_failed_rotor_is_explained_and_flown_with() {
    let folder = temporary();
    let hover = ["fly", "firefly", "--reference", "hover", "--no-plots"];
    let with = |more: &[&'static str]| [&hover[..], more].concat();
    let flown = json(0, folder.path(), &with(&["--fail", "1", "--at", "1", "--duration", "5", "--json"]));
    let stage = &flown["failures"]["stages"][0];
    assert_eq!((stage["capability"].as_str(), stage["at"].as_f64()), (Some("yaw_sacrificed"), Some(1.0)));
    assert!(flown["failures"]["largest_height_error"].as_f64().is_some_and(|e| e < 0.1));
    let (page, _) = exits(0, folder.path(), &with(&["--fail", "rotor_2:0.5", "--fail", "3", "--at", "4", "--at", "6"]));
    for words in
        ["50 % left at 4 s", "curve 2 of the plots", "lost at 6 s", "curve 3 of", "full control", "yaw sacrificed"]
    {
        assert!(page.contains(words), "'{words}' in\n{page}");
    }
    let (page, _) = exits(1, folder.path(), &["fly", "iris", "--reference", "hover", "--fail", "0", "--no-plots"]);
    assert!(page.contains("no steered hover found") && page.contains("FAILED: the vehicle was lost"), "{page}");
    for (arguments, words) in [
        (with(&["--fail", "9"]), "no rotor is called '9'"),
        (with(&["--fail", "1:2"]), "in [0, 1)"),
        (with(&["--fail", "1:half"]), "'half'"),
        (with(&["--fail", "1", "--at", "1", "--at", "2"]), "--at: number of times is 2"),
        (with(&["--at", "1"]), "--fail"),
        (with(&["--fail", "1", "--detection", "-1"]), "detection_delay"),
    ] {
        let (_, error) = exits(2, folder.path(), &arguments);
        assert!(error.contains(words), "{arguments:?}: {error}");
    }
    // a rotor fails on every plant, and a flight that is lost is a failure on every plant
    let (page, _) = exits(1, folder.path(), &["fly", "payload", "--fail", "1", "--duration", "8", "--no-plots"]);
    assert!(page.contains("lost at 3 s") && page.contains("FAILED: the vehicle was lost at "), "{page}");
    let (sheet, _) = exits(0, folder.path(), &["models", "omav"]);
    assert!(sheet.contains("When a rotor is lost") && sheet.contains("of 66 pairs lost together"), "{sheet}");
}

#[test]
fn allocate_explains_what_a_lost_rotor_leaves() {
    let folder = temporary();
    let whole = json(0, folder.path(), &["allocate", "firefly", "--json"]);
    assert_eq!((whole["path"].as_str(), whole["rank"].as_u64()), (Some("closed form"), Some(4)));
    assert!(whole["missing"].as_f64().unwrap() < 1e-4 && whole["margin"].as_f64().unwrap() > 1.0, "{whole}");
    let lost = json(0, folder.path(), &["allocate", "firefly", "--fail", "2", "--json"]);
    assert_eq!((lost["state"][2].as_str(), lost["thrusts"][2].as_f64()), (Some("lost"), Some(0.0)));
    assert!(lost["margin"].as_f64().unwrap().abs() < 1e-6, "an alternating hexarotor is on the edge: {lost}");
    assert!(lost["kkt_residual"].as_f64().unwrap() < 1e-7);
    let weak = json(0, folder.path(), &["allocate", "firefly", "--fail", "rotor_2:0.5", "--json"]);
    assert!(weak["margin"].as_f64().unwrap() > 0.1, "{weak}");
    // beyond the limits the answer misses less than the clipped pseudo-inverse
    let far = ["allocate", "firefly", "--wrench", "0,0,25,3,0,1", "--json"];
    let far = json(0, folder.path(), &far);
    let miss = |name: &str| far[name].as_f64().unwrap();
    assert!(miss("missing") < 0.9 * miss("missing_by_clipped_pseudo_inverse"), "{far}");
    assert!(miss("share_of_the_way_from_hover") < 1.0);
    let page = exits(0, folder.path(), &["allocate", "platform", "--plot", "p.svg", "--gradient"]).0;
    assert!(page.contains("rank") && page.contains("drone_0/rotor_0"), "{page}");
    assert!(is_file(folder.path().join("p.svg")));
    for (arguments, message) in [
        (&["allocate", "firefly", "--fail", "9"][..], "no rotor is called '9'"),
        (&["allocate", "firefly", "--wrench", "1,2"], "expected 6 numbers"),
        (&["allocate", "gate"], "rotors"),
    ] {
        let (_, error) = exits(2, folder.path(), arguments);
        assert!(error.contains(message), "{arguments:?}: {error}");
    }
}
