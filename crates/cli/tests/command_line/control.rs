//! The commands of a control engineer: what they answer, and what they refuse.

use crate::command::{command, exits, json, size, temporary};

#[test]
fn recover_counts_starts_with_bounds_and_draws_the_map() {
    let folder = temporary();
    let small = ["recover", "iris", "--cells", "3,2", "--starts", "4", "--rate", "4", "--tilt", "90"];
    let told = json(folder.path(), &[&small[..], &["--plot", "map.svg"]].concat());
    assert!(size(folder.path(), "map.svg") > 1000);
    let (all, cells) = (&told["all"], told["map"]["cells"].as_array().expect("cells"));
    assert_eq!((cells.len(), all["n"].as_u64(), told["success"].as_bool()), (6, Some(24), Some(true)));
    let [low, high] = [0, 1].map(|k| all["bounds"][k].as_f64().expect("a bound"));
    let share = all["recovered"].as_f64().expect("a number") / 24.0;
    assert!(low <= share && share <= high && low > 0.5, "{low} {share} {high}");
    let (page, _) = exits(0, folder.path(), &small);
    assert!(page.contains("came back") && page.contains("height lost"), "{page}");
}

#[test]
fn optimal_feedback_flies_and_steps_are_measured() {
    let folder = temporary();
    let told = json(folder.path(), &["fly", "hummingbird", "--controller", "lqi", "--no-plots", "--reference", "step"]);
    let step = &told["step"];
    let [rise, overshoot] = ["rise_time", "overshoot"].map(|k| step[k].as_f64().expect("a figure"));
    println!("rise time {rise} s, overshoot {overshoot}");
    assert!(told["controller"] == "lqi" && rise > 0.1 && rise < 3.0 && overshoot < 0.5, "{step}");
    assert!(told["gains"].is_null(), "gains that do not fly are not told");
}

#[test]
fn linearise_writes_models_with_named_signals() {
    let folder = temporary();
    let told = json(folder.path(), &["linearise", "payload", "--save", "payload.json"]);
    let saved: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("payload.json")).expect("written"))
            .expect("JSON");
    assert_eq!(saved["A"].as_array().expect("rows").len(), 20);
    assert_eq!(told["model"], saved);
    let (page, _) = exits(0, folder.path(), &["linearise", "iris", "--velocity", "8,0,1", "--continuous"]);
    assert!(page.contains("continuous") && page.contains("Modes"), "{page}");
    assert!(page.contains("8, 0, 1 m/s") && page.contains("roll, pitch") && !page.contains("turns"), "{page}");
    let (page, _) = exits(0, folder.path(), &["linearise", "hummingbird", "--fail", "1"]);
    assert!(page.contains("a frame that turns with it"), "{page}");
}

#[test]
fn tune_tells_margins_and_holds_none_that_it_cannot() {
    let folder = temporary();
    let short = [
        "tune",
        "hummingbird",
        "--iterations",
        "1",
        "--starts",
        "4",
        "--held-out",
        "4",
        "--duration",
        "0.5",
        "--no-plots",
    ];
    let refused = [&short[..], &["--margins", "--disk", "1.5"]].concat();
    let (page, _) = exits(1, folder.path(), &refused);
    assert!(page.contains("disk margin at hover") && page.contains("FAILED: no gains on the way bear"), "{page}");
    assert!(page.contains("a disk margin of 1.5 is asked for") && page.contains("the gate does not ask"), "{page}");
    // gains of a tuning before are not written over by those that this one began with
    let gains = folder.path().join("out/hummingbird/gains.toml");
    assert!(!gains.exists());
    std::fs::write(&gains, "# better").expect("written");
    exits(1, folder.path(), &refused);
    assert_eq!(std::fs::read_to_string(&gains).expect("kept"), "# better");
}

#[test]
fn a_loop_that_is_not_stable_is_told_without_a_search_for_its_margins() {
    let folder = temporary();
    let begun = std::time::Instant::now();
    let (page, _) = exits(1, folder.path(), &["design", "iris", "--latency", "100"]);
    assert!(page.contains("FAILED: the loop is not stable"), "{page}");
    // measured 1.0 s; the search took longer than a minute
    assert!(begun.elapsed().as_secs() < 30, "{:?}", begun.elapsed());
}

#[test]
fn a_flight_with_late_commands_keeps_to_its_path_where_design_says_that_the_loop_is_stable() {
    let folder = temporary();
    // 12 mm off its path, and 1.6 m
    for (late, code) in [("20", 0), ("36", 1)] {
        exits(code, folder.path(), &["design", "iris", "--latency", late]);
        let (page, _) =
            exits(code, folder.path(), &["fly", "iris", "--latency", late, "--no-plots", "--max-rmse", "0.05"]);
        assert!(page.contains(&format!("{late} steps")) && page.contains("commands act"), "{page}");
        assert!(page.contains("fly without --latency"), "{page}");
        // a gradient through a loop that grows is as large as it has grown: 320 m for 10 % more of a gain, where it was told
        assert_eq!(page.contains("most felt"), code == 0, "{page}");
        assert_eq!(page.contains("about hover the loop is not stable (it grows by e in "), code == 1, "{page}");
    }
}

#[test]
fn design_judges_a_box_of_plants_with_bounds_and_names_the_worst() {
    let folder = temporary();
    let asked = ["design", "hummingbird", "--spread", "0.2", "--samples", "8"];
    let found = &json(folder.path(), &asked)["plants"];
    let number = |path: &str| found.pointer(path).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN);
    assert!(number("/stable/hits") == 8.0 && number("/stable/bounds/0") < 1.0, "{found}");
    assert!(number("/worst/disk") <= number("/corner/disk") && number("/worst/plant/mass") <= 1.2, "{found}");
    let (page, _) = exits(0, folder.path(), &asked);
    assert!(page.contains("8 of 8 random plants") && page.contains("worst found"), "{page}");
    assert!(json(folder.path(), &["design", "hummingbird"])["plants"].is_null());
}

#[test]
fn tune_on_a_grid_judges_the_other_half_on_plants_of_its_own() {
    let folder = temporary();
    let grid = ["tune", "hummingbird", "--grid", "--accelerations", "2,4", "--speeds", "3,5", "--randomise", "0.2"];
    let sizes = ["--iterations", "2", "--starts", "4", "--held-out", "4", "--duration", "0.5", "--no-plots", "--json"];
    let out = command(folder.path(), &[&grid[..], &sizes].concat()).output().expect("run").stdout;
    let tuned: serde_json::Value = serde_json::from_slice(&out).expect("JSON");
    assert_eq!(tuned["grid"].as_array().expect("cells").len(), 4);
    assert_eq!((tuned["after"]["n"].as_u64(), tuned["held_out_after"]["n"].as_u64()), (Some(8), Some(8)));
    assert_eq!(tuned["references"].as_array().expect("references").len(), 4);
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let folder = temporary();
    let cases: [(&[&str], &str); 19] = [
        (&["design", "iris", "--latency", "1000"], "0 to 128 steps"),
        (&["design", "payload"], "articulated"),
        (&["linearise", "gate"], "with rotors"),
        (&["tune", "iris", "--iterations", "-3"], "invalid value '-3' for '--iterations"),
        (&["fly", "iris", "--seed", "-1"], "tip: it counts: no number below 0"),
        (&["fly", "iris", "--dt", "2ms"], "tip: leave the unit out"),
        (&["recover", "iris", "--tilt", "200"], "--tilt"),
        (&["recover", "iris", "--cells", "4"], "--cells"),
        (&["recover", "iris", "--cells", "1,10000000", "--starts", "1"], "intervals of body rate"),
        (&["recover", "iris", "--controller", "lqr", "--gains", "derived"], "--gains with --controller lqr"),
        (&["recover", "payload", "--effects", "contact"], "no ground"),
        (&["linearise", "iris", "--rates", "500,250,100"], "--rates"),
        (&["linearise", "iris", "--velocity", "1,2"], "--velocity"),
        (&["fly", "iris", "--controller", "lqx"], "lqr"),
        (&["tune", "iris", "--margins", "--disk", "0"], "margins.disk"),
        (&["tune", "iris", "--grid", "--speeds", "0"], "grid.speeds"),
        (&["tune", "iris", "--grid", "--accelerations", "90"], "cells that 'iris' can fly"),
        (&["tune", "iris", "--randomise", "2"], "plant_spread"),
        (&["design", "iris", "--spread", "1"], "spread"),
    ];
    for (arguments, word) in cases {
        let (out, err) = exits(2, folder.path(), arguments);
        assert!(out.is_empty() && err.contains(word), "{arguments:?}: {err}");
    }
}

#[test]
fn a_flight_is_compared_with_an_earlier_one() {
    let folder = temporary();
    let iris = ["fly", "iris", "--duration", "3"];
    let first = json(folder.path(), &[&iris[..], &["--csv", "--no-plots", "--out", "before"]].concat());
    let derived = [&iris[..], &["--gains", "derived", "--beside", "before/flight.csv", "--out", "after"]].concat();
    let told = json(folder.path(), &derived);
    let (new, old) = (&told["flight"], &told["beside"]["flight"]);
    for figure in ["samples", "rmse", "max_error", "max_tilt", "max_speed"] {
        assert_eq!(old[figure], first["flight"][figure], "{figure}");
        assert!(figure == "samples" || old[figure] != new[figure], "{figure}");
    }
    assert_eq!(told["beside"]["references_apart"], 0.0);
    assert!(old["saturation"].is_null(), "the file does not tell what the rotors can");
    assert!(size(folder.path(), "after/beside.png") > 10_000);
    let (page, _) = exits(0, folder.path(), &[&derived[..], &["--format", "svg"]].concat());
    assert!(page.contains("Beside an earlier flight") && page.contains("before/flight.csv"), "{page}");
    let drawn = std::fs::read_to_string(folder.path().join("after/beside.svg")).expect("drawn");
    assert!(drawn.contains("this flight") && drawn.contains("before/flight.csv"));
    let other =
        ["fly", "firefly", "--reference", "hover", "--duration", "3", "--no-plots", "--beside", "before/flight.csv"];
    let (page, _) = exits(0, folder.path(), &other);
    assert!(page.contains("their references differ, by up to"), "{page}");
}

#[test]
fn a_flight_records_what_sensors_read() {
    let folder = temporary();
    let tables = "[[sensor]]\nname = \"imu\"\nkind = \"imu\"\npreset = \"bmi088\"\nposition = [0.02, 0.0, 0.0]\nevery = 2\n\
                  [[sensor]]\nname = \"gps\"\nkind = \"gnss\"\npreset = \"single_point\"\n";
    std::fs::write(folder.path().join("sensors.toml"), tables).expect("written");
    let iris = ["fly", "iris", "--duration", "2", "--no-plots", "--csv", "--sensors"];
    let told = json(folder.path(), &[&iris[..], &["sensors.toml"]].concat());
    assert_eq!(told["plan"]["sensors"][1]["name"], "gps");
    let text = std::fs::read_to_string(folder.path().join("out/iris/flight.csv")).expect("written");
    let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let place = |name: &str| lines[0].iter().position(|own| *own == name).expect(name);
    let (force, fix) = (place("imu.accelerometer_z [m/s^2]"), place("gps.position_x [m]"));
    let changes = |column: usize| lines[1..].windows(2).filter(|pair| pair[0][column] != pair[1][column]).count();
    // of 1000 steps every second, but for those that 16 bits do not tell apart; at 5 Hz after 0.12 s
    println!("{} and {} changes", changes(force), changes(fix));
    assert!((400..=500).contains(&changes(force)) && changes(fix) == 9); // 471
    let list = [&iris[..], &["imu:mpu6000,barometer:ms5611"]].concat();
    let (page, _) = exits(0, folder.path(), &list);
    assert!(page.contains("sensor 'barometer'") && page.contains("1 column of the log"), "{page}");
    std::fs::write(folder.path().join("lost.toml"), tables.replace("every", "on = \"load\"\nevery")).expect("written");
    for (given, word) in
        [("imu:mpu600", "mpu6000"), ("imi", "magnetometer"), ("none.toml", "none.toml"), ("lost.toml", "Known: iris")]
    {
        let (out, err) = exits(2, folder.path(), &[&iris[..], &[given, "--out", "refused"]].concat());
        assert!(out.is_empty() && err.contains(word), "{given}: {err}");
    }
    assert!(!folder.path().join("refused").exists());
    let seen =
        ["fly", "iris", "--duration", "0.1", "--no-plots", "--replay", "--out", "seen", "--sensors", "range:vl53l1x"];
    exits(0, folder.path(), &seen);
    let page = std::fs::read_to_string(folder.path().join("seen/replay.html")).expect("written");
    assert!(page.contains("\"reach\":4.0"), "where it looks");
    let (_, err) = exits(2, folder.path(), &["fly", "iris", "--no-plots", "--sensors", "imu"]);
    assert!(err.contains("--csv"), "{err}");
    let short = ["fly", "iris", "--duration", "0.1", "--out", "drawn", "--sensors", "imu,lidar:omnidrones"];
    let told = json(folder.path(), &short);
    let drawn = |name: &str| {
        told["files"].as_array().expect("a list").iter().any(|f| f.as_str().expect("a name").ends_with(name))
    };
    assert!(drawn("sensor_imu.png") && drawn("sensor_lidar.png"), "{}", told["files"]);
}

#[test]
fn kinds_and_presets_of_sensors_stand_in_the_help() {
    let (help, _) = exits(0, temporary().path(), &["fly", "--help"]);
    let kinds = omnidrones::dynamics::sensors::KINDS.iter().map(|kind| kind.name);
    let presets = omnidrones::dynamics::sensors::presets::REGISTRY.iter().map(|preset| preset.name);
    kinds.chain(presets).for_each(|name| assert!(help.contains(name), "{name}"));
}

#[test]
fn what_is_no_earlier_flight_is_refused_before_one_is_flown() {
    let folder = temporary();
    std::fs::write(folder.path().join("other.csv"), "a,b\n1,2\n").expect("written");
    std::fs::write(folder.path().join("cut.csv"), "time [s],position_x [m]\n0,1\n").expect("written");
    std::fs::write(folder.path().join("semicolon.csv"), "time [s];position_x [m]\n0,5;1,5\n").expect("written");
    std::fs::write(folder.path().join("flight.npz"), "PK\u{3}\u{4}").expect("written");
    for (file, word) in [
        ("semicolon.csv", "separates its columns by semicolons"),
        ("flight.npz", "is npz, not CSV. Name a flight.csv: omnidrones fly --csv writes what is read"),
        ("none.csv", "looked for from"),
        ("other.csv", "no column 'time [s]'"),
        ("cut.csv", "no column 'position_y [m]'"),
        (".", "regular file"),
    ] {
        let (out, err) = exits(2, folder.path(), &["fly", "iris", "--beside", file]);
        assert!(out.is_empty() && err.contains(word) && err.contains(file), "{file}: {err}");
    }
    exits(2, folder.path(), &["fly", "payload", "--drop", "--beside", "other.csv"]);
    assert!(!folder.path().join("out").exists());
}

#[test]
fn the_design_report_is_one_page_that_asks_for_nothing() {
    let folder = temporary();
    let (vehicle, _) = exits(0, folder.path(), &["models", "hummingbird", "--toml"]);
    let evil = vehicle.replacen("name = \"hummingbird\"", "name = \"<script>a&b\"", 1);
    assert_ne!(evil, vehicle);
    std::fs::write(folder.path().join("evil.toml"), evil).expect("written");
    let told = json(folder.path(), &["design", "evil.toml", "--report", "pages/evil.html"]);
    assert_eq!(told["files"], serde_json::json!(["pages/evil.html"]));
    let page = std::fs::read_to_string(folder.path().join("pages/evil.html")).expect("written");
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
    for words in [
        "Steady flight",
        "Modes of the",
        "Gains",
        "Margins",
        "Nyquist curves",
        "Poles of the",
        "A step of 1 m",
        "Sensitivity",
    ] {
        assert!(page.contains(words), "{words}");
    }
    assert!(page.contains("&lt;script&gt;a&amp;b"), "the name is there");
    for mark in ["<script", "href", "src=", "url(", "@import", "<link", "<img"] {
        assert!(!page.contains(mark), "{mark}");
    }
    assert_eq!((page.matches("<svg").count(), page.matches("<table").count()), (3, page.matches("</table>").count()));
}

#[test]
fn files_of_a_design_that_exist_are_kept_unless_forced() {
    let folder = temporary();
    for (option, file) in [("--report", "page.html"), ("--save", "model.json"), ("--plot", "loop.svg")] {
        let line = ["design", "iris", option, file];
        std::fs::write(folder.path().join(file), "theirs").expect("written");
        let (_, err) = exits(2, folder.path(), &line);
        assert!(err.contains("which exists") && size(folder.path(), file) == 6, "{err}");
        exits(0, folder.path(), &[&line[..], &["--force"]].concat());
        assert!(size(folder.path(), file) > 1000, "{file}");
    }
    let (_, err) = exits(2, folder.path(), &["design", "iris", "--force"]);
    assert!(err.contains("--save") && err.contains("--report"), "{err}");
    let (_, err) = exits(2, folder.path(), &["design", "iris", "--report", "page.pdf"]);
    assert!(err.contains("a file .html"), "{err}");
}

/// The rows of a CSV file, and where a column stands; empty cells are NaN.
fn table(folder: &std::path::Path, file: &str) -> (Vec<String>, Vec<Vec<f64>>) {
    let text = std::fs::read_to_string(folder.join(file)).expect("written");
    let mut lines = text.lines().map(|line| line.split(','));
    let header = lines.next().expect("a header").map(String::from).collect();
    (header, lines.map(|line| line.map(|cell| cell.parse().unwrap_or(f64::NAN)).collect()).collect())
}

#[test]
fn optimise_plans_a_slalom_that_is_flown_between_its_pillars() {
    let folder = temporary();
    let told = json(folder.path(), &["optimise", "slalom", "--replay"]);
    assert!(told["status"] == "solved" && told["success"] == true && told["history"].as_array().is_some(), "{told}");
    let figure = |path: &str| told.pointer(path).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN);
    assert!(figure("/figures/end/distance") < 0.001 && figure("/figures/violation") < 1e-6, "{told}");
    for file in [
        "trajectory.csv",
        "gains.npz",
        "problem.toml",
        "reference.toml",
        "path.png",
        "trajectory.png",
        "descent.png",
        "replay.html",
    ] {
        assert!(size(folder.path(), &format!("out/slalom/{file}")) > 500, "{file}");
    }
    let (header, rows) = table(folder.path(), "out/slalom/trajectory.csv");
    let place = |name: &str| header.iter().position(|own| own == name).expect(name);
    let (x, y) = (place("position_x [m]"), place("position_y [m]"));
    let inputs = place("rotor_0.speed [-]");
    assert_eq!((rows.len(), header.len(), inputs), (121, 22, 18));
    for (k, row) in rows.iter().enumerate() {
        for pillar in [1.6, 3.2, 4.8, 6.4] {
            assert!((row[x] - pillar).hypot(row[y]) > 0.6 - 1e-6, "{row:?}");
        }
        assert!((row[0] - 0.025 * k as f64).abs() < 1e-12);
        assert!(k == 120 || row[inputs..].iter().all(|u| (0.01..=1.0).contains(u)), "{row:?}");
    }
    // the problem as it was solved is one
    let again = json(folder.path(), &["optimise", "out/slalom/problem.toml", "--no-plots", "--out", "again"]);
    assert_eq!(again["figures"]["cost"], told["figures"]["cost"]);
    let fly = ["fly", "hummingbird", "--reference", "out/slalom/reference.toml", "--no-plots"];
    for (controller, most) in [("indi", 0.2), ("cascade", 0.8)] {
        let flown = json(folder.path(), &[&fly[..], &["--controller", controller]].concat());
        let farthest = flown["flight"]["max_error_overall"].as_f64().expect("a figure");
        println!("{controller}: {farthest} m from the plan");
        // measured: 0.150 and 0.632 m
        assert!(farthest < most, "{controller}: {farthest}");
    }
    let (page, _) = exits(0, folder.path(), &["optimise"]);
    assert!(["flip", "slalom", "landing", "race"].iter().all(|name| page.contains(name)), "{page}");
}

#[test]
fn an_optimisation_that_is_not_solved_says_why_exits_with_1_and_writes_where_it_ended() {
    let folder = temporary();
    let (page, _) = exits(1, folder.path(), &["optimise", "slalom", "--iterations", "2", "--no-plots"]);
    assert!(page.contains("FAILED: it ran out of 2 iterations with a gate or an obstacle violated by"), "{page}");
    assert!(page.contains("try --iterations 4"), "{page}");
    assert!(page.contains("What is written is where the search ended") && !page.contains("Fly it"), "{page}");
    assert!(size(folder.path(), "out/slalom/trajectory.csv") > 500);
    let solved = std::fs::read_to_string(folder.path().join("out/slalom/problem.toml")).expect("written");
    assert!(solved.contains("max_iterations = 2"), "{solved}");
    // from within an obstacle nothing leads away in time
    let (landing, _) = exits(0, folder.path(), &["optimise", "landing", "--toml"]);
    let inside = "\n[[obstacle]]\nposition = [-5.0, 1.0, 4.0]\nradius = 0.5\n\n[settings]\nmax_rounds = 3\n";
    std::fs::write(folder.path().join("inside.toml"), landing + inside).expect("written");
    let output = command(folder.path(), &["optimise", "inside.toml", "--no-plots", "--json"]).output().expect("run");
    let told: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((output.status.code(), &told["status"]), (Some(1), &serde_json::json!("violated")), "{told}");
    assert!(told["failure"].as_str().is_some_and(|why| why.contains("stays violated")), "{told}");
}

#[test]
fn gates_left_to_the_penalty_are_told_as_violated() {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut problem, _) = exits(0, folder.path(), &["optimise", "slalom", "--toml"]);
    problem = problem.replace("max_rounds = 25\n", "");
    if problem.contains("[settings]") {
        problem = problem.replacen("[settings]", "[settings]\nmax_rounds = 1", 1);
    } else {
        problem.push_str("\n[settings]\nmax_rounds = 1\n");
    }
    std::fs::write(folder.path().join("s.toml"), problem).expect("written");
    let (out, _) = exits(1, folder.path(), &["optimise", "s.toml", "--out", "s"]);
    assert!(out.contains("stays violated by"), "{out}");
}

#[test]
fn a_problem_that_is_none_is_refused_by_what_is_wrong_with_it() {
    let folder = temporary();
    let (landing, _) = exits(0, folder.path(), &["optimise", "landing", "--toml"]);
    let gate = |more: &str| format!("{landing}\n[[gate]]\n{more}\n");
    let with = |from: &str, to: &str| {
        assert!(landing.contains(from), "{from}");
        landing.replacen(from, to, 1)
    };
    let cases = [
        (with("steps = 100", "steps = 0"), "steps is 0"),
        (with("steps = 100", "steps = 1000000000"), "over the limit of 100000"),
        (with("steps = 100", "steps = -3"), "a whole number from 0"),
        (with("steps = 100", "stepz = 100"), "Did you mean `steps`?"),
        (with("dt = 0.025", "dt = 0.0"), "dt is 0"),
        (with("dt = 0.025", "dt = nan"), "dt is NaN"),
        (with("[5.0, 0.0, 0.0]", "[inf, 0.0, 0.0]"), "start.velocity[0] is inf"),
        (with("[0.0, 0.0, 0.1]", "[nan, 0.0, 0.1]"), "goal.position[0] is NaN"),
        (with("[0.0, 0.0, 0.1]", "[1e300, 0.0, 0.1]"), "cost of the first guess is inf"),
        (with("\"hummingbird\"", "\"hummingbirb\""), "did you mean 'hummingbird'?"),
        (with("\"hummingbird\"", "\"none.toml\""), "none.toml"),
        (with("steps", "bounds = [2.0, 3.0]\nsteps"), "The vehicle has no such inputs"),
        (with("steps", "bounds = [0.9, 0.1]\nsteps"), "lower ≤ upper"),
        (with("steps", "bounds = [nan, 0.9]\nsteps"), "lower ≤ upper"),
        (with("input = 1.0", "input = -1.0"), "≥ 0 and finite"),
        (with("\"position_z\"", "\"position_zz\""), "did you mean 'position_z'?"),
        (with("lower = 0.08", "lower = 5.0\nupper = 1.0"), "lower ≤ upper"),
        (gate("time = 99.0\nposition = [0, 0, 1]"), "within [0, 2.5] s"),
        (gate("time = 1.0\nposition = [0, 0, 1]\nhalf_size = [0.0, 1.0]"), "half_size is 0"),
        ("vehicle = ".into(), "bad.toml: line 1"),
    ];
    for (text, words) in cases {
        std::fs::write(folder.path().join("bad.toml"), &text).expect("written");
        let (out, err) = exits(2, folder.path(), &["optimise", "bad.toml"]);
        assert!(out.is_empty() && err.contains(words), "{words}: {err}");
    }
    for (line, words) in [
        (&["optimise", "slalon"][..], "did you mean 'slalom'?"),
        (&["optimise", "missing.toml"], "looked for from"),
        (&["optimise", "slalom", "--iterations", "0"], "max_iterations is 0"),
        (&["optimise", "slalom", "--guess", "nowhere"], "[possible values: hover, line]"),
        (&["optimise", "--replay"], "required arguments"),
        (&["optimise", "slalom", "--out", "bad.toml/x"], "a folder that can be made"),
    ] {
        let (out, err) = exits(2, folder.path(), line);
        assert!(out.is_empty() && err.contains(words), "{line:?}: {err}");
    }
}

#[test]
fn plans_fly_nearer_to_a_reference_than_the_cascade_and_take_their_settings_from_a_file() {
    let folder = temporary();
    let rmse = |more: &[&str]| {
        let line = [&["fly", "hummingbird", "--duration", "5", "--no-plots"], more].concat();
        json(folder.path(), &line)["flight"]["rmse"].as_f64().expect("a number")
    };
    let [planned, cascade] = [&["--controller", "mpc"][..], &[]].map(rmse);
    // measured: 0.9 mm and 13 mm
    assert!(planned < 0.2 * cascade, "{planned} and {cascade}");
    std::fs::write(folder.path().join("plans.toml"), "stages = 12\n[weights]\nposition = [100, 100, 100]\n")
        .expect("written");
    let gentle = rmse(&["--controller", "mpc", "--mpc", "plans.toml"]);
    assert!(gentle > 1.2 * planned && gentle < cascade, "{gentle} and {planned}");
    for (text, words) in [
        ("stages = 0", "mpc: stages is 0"),
        ("stagess = 3", "Did you mean `stages`?"),
        ("[weights]\ninput = -1.0", "weights.input is -1"),
        ("[[state_bound]]\nstate = \"velocity\"\nlower = -1\nupper = 1", "velocity_x"),
        ("[[state_bound]]\nstate = \"velocity_x\"\nlower = 3\nupper = 1", "state_bound of velocity_x is [3, 1]"),
        ("[[state_bound]]\nstate = \"velocity_x\"", "one of them given"),
    ] {
        std::fs::write(folder.path().join("bad.toml"), text).expect("written");
        let (_, err) = exits(2, folder.path(), &["fly", "hummingbird", "--controller", "mpc", "--mpc", "bad.toml"]);
        assert!(err.contains(words), "{words}: {err}");
    }
    std::fs::write(folder.path().join("late.toml"), "latency = 10\n").expect("written");
    let late = ["fly", "hummingbird", "--duration", "1", "--no-plots", "--controller"];
    let (out, _) = exits(0, folder.path(), &[&late[..], &["mpc", "--mpc", "late.toml"]].concat());
    assert!(out.contains("tells a latency of 10 steps, and commands act 0 steps late"), "{out}");
    let (_, err) =
        exits(2, folder.path(), &[&late[..], &["mpc_indi", "--mpc", "late.toml", "--latency", "10"]].concat());
    assert!(err.contains("mpc_indi: latency is 10") && err.contains("Take 'mpc'"), "{err}");
    let (_, err) = exits(2, folder.path(), &[&late[..], &["mpc", "--rates", "500,250,100"]].concat());
    assert!(err.contains("--rates with --controller mpc is 500,250,100"), "{err}");
    let (_, err) = exits(2, folder.path(), &["fly", "hummingbird", "--mpc", "plans.toml"]);
    assert!(err.contains("given with --controller mpc"), "{err}");
}

#[test]
fn design_reports_feedback_poles_margins_and_ticks_of_a_plan() {
    let folder = temporary();
    let asked = ["design", "hummingbird", "--controller", "mpc"];
    let files = ["--save", "plant.json", "--report", "mpc.html", "--plot", "loop.svg"];
    let told = json(folder.path(), &[&asked[..], &files].concat());
    let number = |path: &str| told.pointer(path).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN);
    let list = |path: &str| told.pointer(path).and_then(serde_json::Value::as_array).cloned().unwrap_or_default();
    assert!(told["stable"] == true && number("/tick") == 0.01 && number("/settings/stages") == 20.0, "{told}");
    let (gain, errors) = (list("/feedback/gain"), list("/feedback/errors"));
    assert_eq!((gain.len(), errors.len(), list("/poles").len()), (4, 16, 16));
    assert_eq!((&errors[0], &errors[6]), (&"position_x".into(), &"attitude_x".into()));
    // too low: all rotors are told to turn faster
    assert!(gain.iter().all(|row| row[2].as_f64().is_some_and(|k| k < -0.1)), "{gain:?}");
    let poles = list("/poles");
    assert!(poles.iter().all(|pole| pole[0].as_f64().unwrap().hypot(pole[1].as_f64().unwrap()) < 1.0), "{poles:?}");
    for row in list("/margins") {
        let of = |key: &str| row[key].as_f64().unwrap_or(f64::NAN);
        println!("{}: gain up {}, delay {} s, modulus {}", row["at"], of("gain_up"), of("delay"), of("modulus"));
        assert!(
            of("gain_down") == 0.0
                && of("gain_up") > 1.5
                && of("modulus") > 0.4
                && of("phase") > 0.5
                && of("delay") > 0.01,
            "{row}"
        );
        assert!(row["disk"]["alpha"].as_f64() > told["all_commands"]["alpha"].as_f64(), "{row}");
    }
    assert!(number("/all_commands/alpha") > 0.1 && list("/margins").len() == 4, "{told}");
    // 5 s at 100 Hz, both ends included
    assert!(
        number("/ticks/n") == 501.0 && number("/ticks/fallen_back") == 0.0 && number("/ticks/rmse") < 0.01,
        "{told}"
    );
    assert!(number("/ticks/median") > 0.0 && number("/ticks/median") <= number("/ticks/within_99"), "{told}");
    let saved = std::fs::read_to_string(folder.path().join("plant.json")).expect("written");
    let saved: serde_json::Value = serde_json::from_str(&saved).expect("JSON");
    assert!(saved["A"].as_array().is_some_and(|a| a.len() == 16) && saved["dt"] == 0.01, "{saved}");
    let page = std::fs::read_to_string(folder.path().join("mpc.html")).expect("written");
    for words in ["Feedback about hover", "Nyquist curves", "Poles of the", "A step of 1 m", "Sensitivity"] {
        assert!(page.contains(words), "{words}");
    }
    assert!(size(folder.path(), "loop.svg") > 1000);
}

#[test]
fn a_plan_of_other_settings_or_of_a_drone_with_a_load_is_reported_too() {
    let folder = temporary();
    std::fs::write(
        folder.path().join("plans.toml"),
        "stages = 12\nlatency = 3\n[weights]\nposition = [100, 100, 100]\n",
    )
    .expect("written");
    let (page, _) = exits(0, folder.path(), &["design", "firefly", "--controller", "mpc", "--mpc", "plans.toml"]);
    for words in ["12 of 50 ms", "3 steps", "position 100, 100, 100", "The first 4 of 6 commands", "disk margin, all"] {
        assert!(page.contains(words), "{words}: {page}");
    }
    assert!(page.contains("time of a tick") && page.contains("recursions"), "{page}");
    let load = json(folder.path(), &["design", "payload", "--controller", "mpc"]);
    let errors = load["feedback"]["errors"].as_array().expect("names");
    assert!(load["stable"] == true && errors.len() > 16, "{load}");
    let cascade = json(folder.path(), &["design", "hummingbird"]);
    assert_eq!(json(folder.path(), &["design", "hummingbird", "--controller", "cascade"]), cascade);
}

#[test]
fn what_does_not_bear_on_a_plan_about_hover_is_refused_by_name() {
    let folder = temporary();
    std::fs::write(folder.path().join("plans.toml"), "stages = 12\n").expect("written");
    let planned = ["design", "iris", "--controller", "mpc"];
    for (more, words) in [
        (&["--wind", "8,0,0"][..], "--wind with --controller mpc"),
        (&["--latency", "5"], "--latency with --controller mpc"),
        (&["--spread", "0.3"], "--spread with --controller mpc"),
        (&["--rates", "500,250,100"], "--rates with --controller mpc"),
        (&["--gains", "derived"], "--gains with --controller mpc"),
        (&["--reference", "hover"], "--reference"),
        (&["--mpc", "none.toml"], "none.toml"),
    ] {
        let (out, err) = exits(2, folder.path(), &[&planned[..], more].concat());
        assert!(out.is_empty() && err.contains(words), "{more:?}: {err}");
    }
    for (line, words) in [
        (&["--controller", "mpc_indi"][..], "cascade or mpc in 'design'"),
        (&["--controller", "lqi"], "cascade or mpc in 'design'"),
        (&["--controller", "mcp"], "Known: cascade, mpc"),
        (&["--mpc", "plans.toml"], "given with --controller mpc"),
    ] {
        let (out, err) = exits(2, folder.path(), &[&["design", "iris"], line].concat());
        assert!(out.is_empty() && err.contains(words), "{line:?}: {err}");
    }
}

#[test]
fn a_flight_on_estimates_tells_how_good_and_how_consistent_they_are() {
    let folder = temporary();
    let both = "imu:bmi088,motion_capture:optical";
    let fly = ["fly", "hummingbird", "--duration", "4", "--sensors", both, "--estimator", "ekf"];
    let told = json(folder.path(), &[&fly[..], &["--no-plots"]].concat());
    let estimate = &told["estimate"];
    let number = |key: &str| estimate[key].as_f64().expect("a number");
    assert!((4.0..16.0).contains(&number("nees")) && number("within") > 0.8, "{estimate}");
    assert!(number("position") < 2e-3 && number("attitude") < 2e-3, "{estimate}");
    assert_eq!(estimate["innovations"].as_array().map(Vec::len), Some(2), "{estimate}");
    let (page, _) = exits(0, folder.path(), &[&fly[..], &["--csv"]].concat());
    assert!(page.contains("NEES") && page.contains("Innovations"), "{page}");
    assert!(size(folder.path(), "out/hummingbird/estimate.csv") > 100_000);
    assert!(size(folder.path(), "out/hummingbird/estimate.png") > 10_000);
    std::fs::write(folder.path().join("bad.toml"), "gates = 3\n").expect("written");
    std::fs::write(folder.path().join("none.toml"), "patience = 0\n").expect("written");
    for (line, words) in [
        (&["hummingbird", "--estimator", "ekf"][..], "given with --sensors"),
        (&["hummingbird", "--sensors", both, "--estimator", "kalmann"], "Known: ekf, complementary, kalman, FILE.toml"),
        (&["hummingbird", "--sensors", "gnss:single_point", "--estimator", "ekf"], "one imu among them"),
        (&["payload", "--sensors", both, "--estimator", "ekf"], "one rigid vehicle"),
        (&["hummingbird", "--sensors", both, "--estimator", "bad.toml"], "gate"),
        (&["hummingbird", "--sensors", both, "--estimator", "none.toml"], "estimator: patience is 0"),
    ] {
        let (_, err) = exits(2, folder.path(), &[&["fly"], line].concat());
        assert!(err.contains(words), "{line:?}: {err}");
    }
}

#[test]
fn every_estimator_flies_and_design_tells_what_it_costs_the_loop() {
    let folder = temporary();
    let both = ["--sensors", "imu:bmi088,motion_capture:optical"];
    for (name, controller) in [("complementary", "cascade"), ("kalman", "lqr")] {
        let fly =
            ["fly", "hummingbird", "--duration", "4", "--estimator", name, "--controller", controller, "--no-plots"];
        let told = json(folder.path(), &[&fly[..], &both].concat());
        let estimate = &told["estimate"];
        assert_eq!(estimate["kind"], name, "{estimate}");
        assert!(estimate["position"].as_f64().is_some_and(|off| off < 5e-3), "{estimate}");
        // only a filter with a covariance says how good it is
        let is_told = name == "kalman";
        assert_eq!((estimate["nees"].is_number(), estimate["within"].is_number()), (is_told, is_told), "{estimate}");
        let (page, _) = exits(0, folder.path(), &[&fly[..], &both].concat());
        assert_eq!((page.contains("NEES"), page.contains("Innovations")), (is_told, is_told), "{page}");
    }
    let design = |line: &[&str]| json(folder.path(), &[&["design", "hummingbird"], line, &both].concat());
    let disks = |told: &serde_json::Value| {
        ["all_commands", "all_commands_on_the_true_state"].map(|key| told[key]["alpha"].as_f64().expect("a number"))
    };
    // Doyle 1978: the filter is driven by the commands
    let [with, without] = disks(&design(&["--controller", "lqr", "--estimator", "kalman"]));
    assert!(with < 0.9 * without, "{with} {without}");
    // the inertial unit feels what commands do
    let [with, without] = disks(&design(&["--estimator", "ekf"]));
    assert!((with / without - 1.0).abs() < 1e-6, "{with} {without}");
    let (page, _) = exits(0, folder.path(), &[&["design", "iris", "--estimator", "kalman"], &both[..]].concat());
    assert!(page.contains("motion_capture.attitude_x") && page.contains("on the true state"), "{page}");
    let outside = ["--sensors", "imu:bmi088,gnss:single_point,magnetometer:pegasus"];
    for (line, words) in [
        (&[&["--estimator", "ekf", "--controller", "indi"], &both[..]].concat()[..], "cascade, lqr, lqi"),
        (&[&["--estimator", "ekf", "--wind", "1,0,0"], &both[..]].concat(), "hover in still air"),
        (&[&["--estimator", "complementary"], &outside[..]].concat(), "righted by the accelerometer"),
    ] {
        let (_, err) = exits(2, folder.path(), &[&["design", "hummingbird"], line].concat());
        assert!(err.contains(words), "{line:?}: {err}");
    }
}
