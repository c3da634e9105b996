//! What is told of flights into walls and hills, of vehicles that do not fly yet, and of numbers in other units.

use crate::command::{command, exits, temporary};
use omnidrones::dynamics::{Vehicle, vehicles};
use std::path::Path;

fn changed(name: &str, change: impl Fn(&mut Vehicle)) -> Vehicle {
    let mut vehicle = vehicles::by_name("hummingbird").expect("built in");
    vehicle.name = name.into();
    change(&mut vehicle);
    vehicle
}

fn write(folder: &Path, file: &str, text: &str) {
    std::fs::write(folder.join(file), text).expect("written");
}

/// With shapes, without, without radii of rotors, too.
fn vehicles_of_all_kinds() -> [Vehicle; 3] {
    [
        changed("whole", |_| ()),
        changed("bare", |v| v.shapes.clear()),
        changed("points", |v| {
            v.shapes.clear();
            v.rotors.iter_mut().for_each(|r| r.radius = 0.0);
        }),
    ]
}

fn fly<'a>(file: &'a str, scene: &'a str, reference: &'a str) -> Vec<&'a str> {
    let flight = ["fly", file, "--scene", scene, "--reference", reference];
    [&flight[..], &["--no-plots", "--duration", "2.5"]].concat()
}

#[test]
fn a_flight_through_a_wall_fails_whatever_shapes_the_vehicle_has() {
    let folder = temporary();
    write(
        folder.path(),
        "ahead.toml",
        "kind = \"waypoints\"\npoints = [{ time = 0, position = [-0.6, 0, 2] }, { time = 2, position = [1.4, 0, 2] }]\n",
    );
    // how far the wall's edge is beside the way of the origin, and whether rotors (hubs 0.12 to 0.17 m aside) reach into it
    let walls = [("wall", -1.0, true), ("door", 0.09, true), ("far side", 0.6, false)];
    for vehicle in vehicles_of_all_kinds() {
        let file = format!("{}.toml", vehicle.name);
        write(folder.path(), &file, &vehicle.to_toml().expect("valid"));
        for (name, edge, touches) in walls {
            let at = edge + 1.0;
            write(
                folder.path(),
                "scene.toml",
                &format!(
                    "[[obstacles]]\nname = \"{name}\"\n[obstacles.shape]\nposition = [0.5, {at}, 2.0]\nrotation = [1.0, 0.0, 0.0, \
                     0.0]\n[obstacles.shape.geometry.box]\nsize = [0.2, 2.0, 4.0]\n"
                ),
            );
            let (page, _) = exits(i32::from(touches), folder.path(), &fly(&file, "scene.toml", "ahead.toml"));
            if touches {
                assert!(page.contains(&format!("FAILED: it flew into '{name}'")) || page.contains("lost at"), "{page}");
                assert!(page.contains(&format!("touched '{name}' at ")), "{page}");
            } else {
                assert!(page.contains(&format!("from '{name}', at ")) && page.contains("nearest 0."), "{page}");
            }
        }
    }
}

#[test]
fn a_flight_below_hills_fails_whatever_shapes_the_vehicle_has() {
    let folder = temporary();
    for (begin, end, fails) in [(-2.0, -2.0, true), (3.0, -2.0, true), (3.0, 3.0, false)] {
        let points =
            format!("{{ time = 0, position = [0, 0, {begin:.1}] }}, {{ time = 2, position = [1, 0, {end:.1}] }}");
        write(folder.path(), "way.toml", &format!("kind = \"waypoints\"\npoints = [{points}]\n"));
        for vehicle in vehicles_of_all_kinds() {
            let file = format!("{}.toml", vehicle.name);
            write(folder.path(), &file, &vehicle.to_toml().expect("valid"));
            // what the ground pushes out does not begin there
            let buried = begin < 0.0 && !vehicle.shapes.is_empty();
            let code = if buried { 2 } else { i32::from(fails) };
            let (page, error) = exits(code, folder.path(), &fly(&file, "terrain:1", "way.toml"));
            assert!(!page.contains("– m") && buried == error.contains("It begins inside"), "{page}{error}");
            if fails && vehicle.shapes.is_empty() {
                assert!(page.contains("FAILED: it went below the ground at "), "{page}");
            }
        }
    }
}

#[test]
fn what_rotors_that_are_left_could_do_is_not_told_as_what_the_flight_did() {
    let folder = temporary();
    for (rotor, controller) in [("0", None), ("3", None), ("1", Some("cascade"))] {
        let flight = ["fly", "hummingbird", "--reference", "hover", "--fail", rotor, "--no-plots", "--duration", "6"];
        let by = controller.map_or(vec![], |name| vec!["--controller", name]);
        let output = command(folder.path(), &[&flight[..], &by].concat()).output().expect("starts");
        let page = String::from_utf8(output.stdout).expect("text");
        for wrong in ["flies while it spins", "flies on as it does"] {
            assert!(!page.contains(wrong), "{page}");
        }
        assert!(page.contains("could fly while it spins") && page.contains("could carry it while it spins"), "{page}");
    }
}

/// Four rotors on links of a URDF, under a root of this name, with what is added to it.
fn urdf(root: Option<&str>, more: &str) -> String {
    let mut text = String::from("<robot name=\"made\">\n");
    if let Some(root) = root {
        text += &format!(
            "<link name=\"{root}\"/><joint name=\"tie\" type=\"fixed\"><parent link=\"{root}\"/><child link=\"base\"/></joint>\n"
        );
    }
    text += "<link name=\"base\"><inertial><mass value=\"1\"/><inertia ixx=\"0.01\" ixy=\"0\" ixz=\"0\" iyy=\"0.01\" iyz=\"0\" \
             izz=\"0.018\"/></inertial></link>\n";
    for (i, [x, y]) in [[0.14, 0.14], [-0.14, 0.14], [-0.14, -0.14], [0.14, -0.14]].into_iter().enumerate() {
        text += &format!(
            "<link name=\"rotor_{i}\"><inertial><mass value=\"0.01\"/><inertia ixx=\"1e-6\" ixy=\"0\" ixz=\"0\" iyy=\"1e-6\" \
             iyz=\"0\" izz=\"2e-6\"/></inertial></link><joint name=\"j{i}\" type=\"continuous\"><origin xyz=\"{x} {y} 0\"/><parent \
             link=\"base\"/><child link=\"rotor_{i}\"/><axis xyz=\"0 0 1\"/></joint>\n"
        );
    }
    text + more + "</robot>\n"
}

#[test]
fn a_root_called_world_stands_still_however_it_is_written() {
    let folder = temporary();
    for root in ["world", "World", "WORLD", "worLd"] {
        write(folder.path(), "tied.urdf", &urdf(Some(root), ""));
        let (page, _) = exits(0, folder.path(), &["import", "tied.urdf", "--draft", "--force"]);
        let words = format!("ties link 'base' to the root '{root}', which stands still");
        assert!(page.contains(&words) && !page.contains("without mass"), "{page}");
    }
}

#[test]
fn a_joint_whose_limits_exclude_where_it_is_held_is_told_with_them() {
    let folder = temporary();
    for (kind, lower, upper, words) in [
        ("revolute", 1.2, 1.6, Some("is held at zero, which its limits of 1.2 to 1.6 rad exclude")),
        ("prismatic", -0.3, -0.1, Some("is held at zero, which its limits of -0.3 to -0.1 m exclude")),
        ("revolute", -0.5, 0.5, None),
        ("revolute", 0.0, 0.5, None),
    ] {
        let arm = format!(
            "<link name=\"arm\"><inertial><origin xyz=\"0 0 -0.1\"/><mass value=\"0.1\"/><inertia ixx=\"1e-4\" ixy=\"0\" ixz=\"0\" \
             iyy=\"1e-4\" iyz=\"0\" izz=\"1e-4\"/></inertial></link><joint name=\"elbow\" type=\"{kind}\"><parent \
             link=\"base\"/><child link=\"arm\"/><axis xyz=\"0 1 0\"/><limit lower=\"{lower}\" upper=\"{upper}\" effort=\"1\" \
             velocity=\"1\"/></joint>\n"
        );
        write(folder.path(), "arm.urdf", &urdf(None, &arm));
        let (page, _) = exits(0, folder.path(), &["import", "arm.urdf", "--draft", "--force"]);
        assert!(page.contains("is held at zero"), "{page}");
        match words {
            Some(words) => assert!(page.contains(words), "{words}\n{page}"),
            None => assert!(!page.contains("exclude"), "{page}"),
        }
    }
}

#[test]
fn an_import_ends_with_how_to_fly_what_flies_alone() {
    let folder = temporary();
    // a load beside the rotors that no thrust balances, one too heavy, and none
    for (x, mass, flies) in [(0.0, 0.01, true), (2.0, 3.0, false), (0.0, 900.0, false)] {
        let load = format!(
            "<link name=\"load\"><inertial><mass value=\"{mass}\"/><inertia ixx=\"1e-2\" ixy=\"0\" ixz=\"0\" iyy=\"1e-2\" iyz=\"0\" \
             izz=\"1e-2\"/></inertial></link><joint name=\"hook\" type=\"fixed\"><origin xyz=\"{x} 0 0\"/><parent \
             link=\"base\"/><child link=\"load\"/></joint>\n"
        );
        write(folder.path(), "one.urdf", &urdf(None, ""));
        exits(0, folder.path(), &["import", "one.urdf", "--draft", "--force"]);
        write(folder.path(), "two.urdf", &urdf(None, &load));
        // the rotors of the one without a load
        let (page, _) = exits(0, folder.path(), &["import", "two.urdf", "--rotors", "one.rotors.toml"]);
        let hover =
            ["fly", "two.urdf", "--rotors", "one.rotors.toml", "--reference", "hover", "--no-plots", "--duration"];
        exits(if flies { 0 } else { 2 }, folder.path(), &[&hover[..], &["1"]].concat());
        assert_eq!(page.contains("Fly it: omnidrones fly two.urdf"), flies, "{page}");
        let told = page.lines().find_map(|line| line.strip_prefix("It does not fly yet: "));
        assert_eq!(told.is_some_and(|reason| page.matches(reason).count() == 2), !flies, "{page}");
    }
}

#[test]
fn yaw_that_was_meant_in_degrees_gets_a_hint() {
    let folder = temporary();
    for (text, words) in [
        ("kind = \"hover\"\nyaw = 90", Some("yaw = 90: an angle beyond 2π: angles are radians")),
        ("kind = \"hover\"\nyaw = -45", Some("(-45° are -0.7854 rad)")),
        (
            "kind = \"waypoints\"\npoints = [{ time = 0, position = [0, 0, 2] }, { time = 1, position = [0.1, 0, 2], yaw = 180 \
             }, { time = 2, position = [0.1, 0.1, 2], yaw = 270 }]",
            Some("points[1].yaw = 180: an angle beyond 2π, and 1 more: angles are radians"),
        ),
        ("kind = \"hover\"\nyaw = 5", None),
        ("kind = \"hover\"\nyaw = 7.25", None),
        ("kind = \"hover\"\nyaw = -3.14", None),
    ] {
        write(folder.path(), "yaw.toml", text);
        let flight = ["fly", "hummingbird", "--reference", "yaw.toml", "--no-plots", "--duration", "0.5"];
        let output = command(folder.path(), &flight).output().expect("starts");
        let page = String::from_utf8(output.stdout).expect("text").split_whitespace().collect::<Vec<_>>().join(" ");
        match words {
            Some(words) => assert!(page.contains(words) && page.contains("Read as radians."), "{words}\n{page}"),
            None => assert!(!page.contains("beyond 2π"), "{page}"),
        }
    }
}

#[test]
fn a_lean_that_keeps_a_hover_from_being_a_success_is_told() {
    let folder = temporary();
    // both pairs of arms lean alike: the vehicle hovers beside level by as much
    for (degrees, keeps) in [(5.0_f64, false), (25.0, true), (30.0, true)] {
        let vehicle = changed("leaning", |v| {
            let (s, c) = degrees.to_radians().sin_cos();
            v.rotors.iter_mut().for_each(|r| r.axis = [s, 0.0, c]);
        });
        write(folder.path(), "leaning.toml", &vehicle.to_toml().expect("valid"));
        let rollout = ["rollout", "Hover", "--vehicle", "leaning.toml", "--envs", "2", "--horizon", "10", "--no-plots"];
        for told in [&["tasks", "Hover", "--vehicle", "leaning.toml"][..], &rollout] {
            let (page, _) = exits(0, folder.path(), told);
            let page = page.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(page.contains("leans"), "{page}");
            assert_eq!(page.contains("a success asks for an uprightness above 0.95"), keeps, "{told:?} {page}");
        }
    }
}

#[test]
fn a_tuning_whose_flights_were_all_lost_tells_no_error() {
    let folder = temporary();
    for weak in [5e-4, 2e-3] {
        // turns too slowly to be held
        let vehicle = changed("slow", |v| {
            let j = &mut v.parts[0].inertia;
            (j.xx, j.yy, j.zz) = (j.xx / weak, j.yy / weak, j.zz / weak);
        });
        write(folder.path(), "slow.toml", &vehicle.to_toml().expect("valid"));
        let tune = ["tune", "slow.toml", "--iterations", "1", "--starts", "4", "--held-out", "4", "--no-plots"];
        let output = command(folder.path(), &tune).output().expect("starts");
        let page = String::from_utf8(output.stdout).expect("text");
        assert_eq!(output.status.code(), Some(1), "{page}");
        assert!(page.contains("all 4 lost") && !page.contains("worst 0.0 mm") && !page.contains("crash"), "{page}");
    }
}
