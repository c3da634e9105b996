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
    let (page, _) = exits(1, folder.path(), &[&short[..], &["--margins", "--disk", "1.5"]].concat());
    assert!(page.contains("disk margin at hover") && page.contains("FAILED: no gains on the way bear"), "{page}");
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
    let cases: [(&[&str], &str); 13] = [
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
