//! Configurations on the command line: shown, drawn, flown and dropped, every one of the registry.

use crate::command::{exits, json, temporary};
use omnidrones::dynamics::configurations;
use serde_json::Value;

#[test]
fn every_configuration_is_listed_shown_and_drawn() {
    let folder = temporary();
    let (list, _) = exits(0, folder.path(), &["show"]);
    for entry in configurations::REGISTRY {
        assert!(list.contains(entry.name) && list.contains(entry.description), "{list}");
        let model = (entry.build)().expect("built");
        let file = format!("{}.svg", entry.name);
        let (page, _) = exits(0, folder.path(), &["show", entry.name, "--plot", &file]);
        for body in model.bodies() {
            assert!(page.contains(&body.name) && page.contains(&body.joint.name), "{}\n{page}", body.name);
        }
        assert!(page.contains("└─") && page.contains("degrees of freedom") && !page.contains('\u{1b}'), "{page}");
        let svg = std::fs::read_to_string(folder.path().join(&file)).expect("written");
        assert!(svg.len() > 8_000 && svg.contains("from above") && !svg.contains("NaN"), "{}", entry.name);
        for body in model.bodies().iter().filter(|b| b.mass > 0.0) {
            assert!(svg.contains(&body.name), "{}: no label {}", entry.name, body.name);
        }
    }
}

#[test]
fn json_holds_the_parts_and_the_sizes() {
    let folder = temporary();
    let shown = json(folder.path(), &["show", "omav_tilting"]);
    assert_eq!(shown["n_input"], 18, "12 rotors and 6 tilts");
    assert_eq!(shown["model"]["bodies"].as_array().map(Vec::len), Some(7));
    let shown = json(folder.path(), &["show", "firefly"]);
    assert_eq!((&shown["n_state"], &shown["n_input"]), (&19.into(), &6.into()));
}

#[test]
fn every_configuration_flies_or_says_why_not() {
    let folder = temporary();
    // measured over the first 5 s: payload 26 mm, pendulum 127 mm, platforms 12 to 13 mm, transports 9 mm, omav 3 mm
    for entry in configurations::REGISTRY {
        match entry.name {
            "gate" => {
                let (_, err) = exits(2, folder.path(), &["fly", "gate"]);
                assert!(err.contains("fixed to the world"), "{err}");
            }
            name => {
                let arguments = ["fly", name, "--no-plots", "--duration", "5", "--dt", "0.004", "--max-rmse", "0.25"];
                let flown = json(folder.path(), &arguments);
                assert_eq!(flown["success"], true, "{name}");
                for joint in flown["joints"].as_array().expect("a list") {
                    assert!(joint["largest"].as_f64().expect("a number") < 0.5, "{name}: {joint}");
                }
            }
        }
    }
}

#[test]
fn an_omav_that_is_to_roll_flies_with_its_tilts_free() {
    let folder = temporary();
    let arguments = ["fly", "omav", "--roll", "30", "--reference", "hover", "--duration", "4", "--no-plots"];
    let flown = json(folder.path(), &arguments);
    assert_eq!((&flown["configuration"], &flown["controller"]), (&"omav_tilting".into(), &"vectored".into()));
    let number = |v: &Value| v.as_f64().expect("a number");
    // measured: 1.5 mm, 30°
    assert!(number(&flown["flight"]["rmse"]) < 0.005, "{flown:#}");
    assert!((number(&flown["flight"]["max_tilt"]).to_degrees() - 30.0).abs() < 1.0, "{flown:#}");
    assert!(flown["controller_notes"].as_array().is_some_and(|n| n.len() == 3), "{flown:#}");
}

#[test]
fn a_flight_writes_its_figures_and_tables() {
    let folder = temporary();
    let arguments = ["fly", "payload", "--reference", "hover", "--duration", "1", "--csv", "--format", "svg"];
    let flown = json(folder.path(), &arguments);
    let files: Vec<&str> = flown["files"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    assert_eq!(files.len(), 9, "{files:?}");
    for file in files {
        let size = std::fs::metadata(folder.path().join(file)).expect("written").len();
        assert!(size > 2_000, "{file}: {size} bytes");
    }
    let csv = std::fs::read_to_string(folder.path().join("out/payload/joints.csv")).expect("read");
    assert!(csv.starts_with("time [s],swing.x [rad],swing.x rate [rad/s],swing.y [rad]"), "{csv:.80}");
}

#[test]
fn what_is_dropped_lands_and_loses_its_energy() {
    let folder = temporary();
    for name in ["payload", "hummingbird"] {
        let fallen = json(folder.path(), &["fly", name, "--drop=0.4", "--duration", "3", "--format", "svg"]);
        let number = |key: &str| fallen[key].as_f64().expect("a number");
        // free fall over 0.4 m takes 0.286 s
        assert!((number("first_touch") - 0.286).abs() < 0.02, "{name}: {fallen:#}");
        assert!(number("energy_end") < 0.5 * number("energy_start"), "{name}: {fallen:#}");
        assert!(number("deepest") < 0.05, "{name}: {fallen:#}");
        assert!(folder.path().join(format!("out/{name}/drop.svg")).exists());
    }
}

#[test]
fn mistakes_are_answered_with_value_limit_and_remedy() {
    let folder = temporary();
    for (arguments, words) in [
        (&["show", "paylod"][..], "did you mean 'payload'?"),
        (&["fly", "transprt"], "did you mean 'transport'?"),
        (&["show", "payload", "--plot", "robot.pdf"], "png or svg"),
        (&["fly", "payload", "--gains", "published"], "nobody published gains"),
        (&["fly", "payload", "--rotors", "x.toml"], "Leave it out"),
        (&["fly", "payload", "--drop=-1"], "0 to 1000 m"),
        (&["fly", "iris", "--drop", "--max-rmse", "1"], "nothing is controlled"),
        (&["fly", "iris", "--effects", "contact"], "Drop it with --drop."),
        (&["fly", "gate", "--drop"], "fixed to the world"),
        (&["fly", "iris", "--roll", "10"], "omav_tilting, dragon and platform hold a tilt"),
        (&["fly", "payload", "--shape", "arc"], "dragon takes a shape"),
        (&["fly", "omav", "--roll", "200"], "within ±180"),
        (&["fly", "dragon", "--shape", "ark"], "did you mean 'arc'?"),
        (&["fly", "omav_tilting", "--shape", "arc"], "position servos about z"),
    ] {
        let (out, err) = exits(2, folder.path(), arguments);
        assert!(out.is_empty() && err.contains(words), "{arguments:?}: {err}");
    }
    assert!(!folder.path().join("out").exists(), "a mistake leaves no folder");
}

/// Flies what must fail: why it did, of its JSON and of its page.
fn fails(folder: &std::path::Path, arguments: &[&str]) -> (Value, String) {
    let quick = [&["fly"][..], arguments, &["--no-plots"]].concat();
    let (out, _) = exits(1, folder, &[&quick[..], &["--json"]].concat());
    let told: Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(told["success"], false, "{arguments:?}");
    let (page, _) = exits(1, folder, &quick);
    let reason = page.lines().find_map(|line| line.strip_prefix("FAILED: ")).unwrap_or_else(|| panic!("{page}"));
    assert_eq!(told["failure"], reason, "{arguments:?}");
    (told, page)
}

#[test]
fn a_flight_into_the_ground_has_failed_unless_the_ground_is_left_out() {
    let folder = temporary();
    let falls = ["hummingbird", "--fail", "0"];
    let (told, page) = fails(folder.path(), &falls);
    // measured: 3.4 m under it
    assert!(told["lowest"].as_f64().is_some_and(|lowest| lowest < -1.0), "{told:#}");
    assert!(
        page.contains("FAILED: it went below the ground at ") && page.contains("(rotor 'rotor_0' was lost at 3 s)"),
        "{page}"
    );
    let (page, _) = exits(0, folder.path(), &[&["fly"][..], &falls, &["--no-ground", "--no-plots"]].concat());
    assert!(page.contains("lowest point") && page.contains("the ground is left out"), "{page}");
    // a configuration whose model has the ground taken out of it
    let hung = ["payload", "--reference", "low.toml", "--duration", "1"];
    std::fs::write(folder.path().join("low.toml"), "kind = \"hover\"\nposition = [0, 0, 0.5]").expect("written");
    let (_, page) = fails(folder.path(), &hung);
    assert!(page.contains("the reference leads it below the ground") && page.contains("--no-ground"), "{page}");
    for more in [&[][..], &["--effects", "contact"]] {
        json(folder.path(), &[&["fly"][..], &hung, &["--no-ground", "--no-plots"], more].concat());
    }
    let (_, err) = exits(2, folder.path(), &["fly", "iris", "--no-ground", "--scene", "forest"]);
    assert!(err.contains("--no-ground") && err.contains("--scene"), "{err}");
}

#[test]
fn a_reference_may_touch_the_ground_and_not_lead_below_it() {
    let folder = temporary();
    let hover = |name: &str, height: f64| {
        let file = format!("{name}_{height}.toml");
        std::fs::write(folder.path().join(&file), format!("kind = \"hover\"\nposition = [0, 0, {height}]"))
            .expect("written");
        file
    };
    for vehicle in ["crazyflie", "hummingbird", "omav"] {
        for height in [0.0, 0.02, 1.0] {
            let file = hover(vehicle, height);
            json(folder.path(), &["fly", vehicle, "--reference", &file, "--duration", "1", "--no-plots"]);
        }
        for height in [-0.01, -5.0] {
            let file = hover(vehicle, height);
            let (told, page) = fails(folder.path(), &[vehicle, "--reference", &file, "--duration", "1"]);
            assert_eq!(told["mishaps"][0]["kind"], "reference_below_ground");
            assert!(page.contains("raise it, or leave the ground out by --no-ground"), "{page}");
        }
    }
}

#[test]
fn a_flight_into_what_stands_around_has_failed_by_name_and_depth() {
    let folder = temporary();
    let (told, page) = fails(folder.path(), &["hummingbird", "--scene", "forest:3"]);
    let nearest = &told["scene"]["nearest"];
    assert!(nearest["distance"].as_f64().is_some_and(|d| d < 0.0), "{nearest}");
    let part = nearest["part"].as_str().expect("a name");
    assert!(page.contains(&format!("FAILED: it flew into '{part}', ")) && page.contains("m deep at "), "{page}");
}

#[test]
fn a_load_that_turned_over_and_a_rotor_that_failed_are_told() {
    let folder = temporary();
    let (told, page) = fails(folder.path(), &["transport", "--fail", "0"]);
    // measured: rolled by 108°
    let kinds: Vec<&str> =
        told["mishaps"].as_array().expect("a list").iter().filter_map(|m| m["kind"].as_str()).collect();
    assert!(kinds.contains(&"turned_over") && page.contains("was lost at 3 s"), "{told:#}");
    let (_, page) = fails(folder.path(), &["payload", "--fail", "0"]);
    assert!(page.contains("was lost at 3 s") && page.contains("leave out --fail"), "{page}");
    assert!(!page.contains("--roll") && !page.contains("--shape"), "{page}");
}

#[test]
fn waypoints_turn_the_short_way_and_the_headings_error_is_told() {
    let folder = temporary();
    let path = |side: f64, turns: &str| {
        let [a, b, c, d] = [3.0, 3.1, -3.1, -3.0].map(|yaw| side * yaw);
        let text = format!(
            "kind = \"waypoints\"\n{turns}\npoints = [{{ time = 1, position = [0, 0, 1], yaw = {a} }}, \
             {{ time = 2.5, position = [1, 0, 1], yaw = {b} }}, {{ time = 4, position = [2, 0, 1], yaw = {c} }}, \
             {{ time = 6.5, position = [3, 0, 1], yaw = {d} }}]"
        );
        std::fs::write(folder.path().join("path.toml"), text).expect("written");
        let fly = ["fly", "firefly", "--reference", "path.toml", "--no-plots"];
        json(folder.path(), &fly)["flight"]["max_heading_error"].as_f64().expect("a number").to_degrees()
    };
    for side in [1.0, -1.0] {
        let [short, long] = ["", "turns = true"].map(|turns| path(side, turns));
        println!("short way {short:.2}°, as given {long:.0}°");
        // measured: 0.6° and 117°
        assert!(short < 2.0 && long > 60.0, "{short} {long}");
    }
    let (page, _) = exits(0, folder.path(), &["fly", "firefly", "--reference", "path.toml", "--no-plots"]);
    assert!(page.contains("heading error"), "{page}");
}

#[test]
fn a_scene_stands_around_what_flies_and_what_begins_inside_of_it_is_refused() {
    let folder = temporary();
    let quick = ["--no-plots", "--duration", "2", "--reference", "hover"];
    let fly = |named: &'static str| [&["fly", "hummingbird", "--scene", named], &quick[..]].concat();
    let flown = json(folder.path(), &fly("forest:3"));
    assert_eq!(flown["success"], true);
    let nearest = &flown["scene"]["nearest"];
    assert!(nearest["part"].as_str().is_some_and(|part| part.starts_with("trunk ")), "{nearest}");
    assert!(nearest["distance"].as_f64().is_some_and(|d| d > 1.0), "{nearest}");
    let (page, _) = exits(0, folder.path(), &fly("gates:1"));
    assert!(page.contains("gates:1") && page.contains("10 gates; nearest"), "{page}");
    // what has no joints has no figure of them
    let drawn =
        ["fly", "hummingbird", "--scene", "gates:1", "--duration", "2", "--reference", "hover", "--out", "drawn"];
    exits(0, folder.path(), &drawn);
    assert!(
        ["overview.png", "joints.png"].map(|name| folder.path().join("drawn").join(name).exists()) == [true, false]
    );
    let (_, err) = exits(2, folder.path(), &fly("forrest"));
    assert!(err.contains("did you mean 'forest'?"), "{err}");
    let block = "[[obstacles]]\nname = 'block'\nshape = { geometry = { box = { size = [4.0, 4.0, 4.0] } } }";
    std::fs::write(folder.path().join("block.toml"), block).expect("written");
    let (_, err) = exits(2, folder.path(), &fly("block.toml"));
    assert!(
        err.contains("start: distance of 'hummingbird' to 'block' is -") && err.contains("move the start"),
        "{err}"
    );
    let text = "[[generate]]\nkind = 'forest'\ntrunks = 500";
    std::fs::write(folder.path().join("dense.toml"), text).expect("written");
    let (_, err) = exits(2, folder.path(), &fly("dense.toml"));
    assert!(err.contains("forest: trunks: is 500, over the limit of 135") && err.contains("fewer trunks"), "{err}");
}

#[test]
fn what_falls_onto_blocks_and_hills_rests_there() {
    let folder = temporary();
    for scene in ["rubble:1", "terrain:2"] {
        let fallen = json(folder.path(), &["fly", "crazyflie", "--scene", scene, "--drop", "--no-plots"]);
        assert_eq!(fallen["success"], true, "{scene}: {fallen}");
    }
}
