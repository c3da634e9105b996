//! One vehicle, all commands: whether it hovers and can be steered is told alike by everybody.

use crate::command::{exits, json, temporary};
use omnidrones::controllers::CascadeModel;
use omnidrones::dynamics::{MAX_ROTORS, Vehicle, vehicles};
use omnidrones::error::Error;
use std::path::Path;

#[path = "../../../../tests/common/geometry.rs"]
#[allow(dead_code)]
mod geometry;

/// Commands that need a vehicle that flies.
const FLYING: [&[&str]; 5] = [
    &["fly", "--no-plots", "--duration", "1", "--reference", "hover", "--out", "flown"],
    &["design"],
    &[
        "tune",
        "--no-plots",
        "--iterations",
        "1",
        "--starts",
        "2",
        "--held-out",
        "2",
        "--duration",
        "0.2",
        "--out",
        "tuned",
    ],
    &["recover", "--starts", "1", "--cells", "1,1"],
    &["fly", "--no-plots", "--duration", "1", "--reference", "hover", "--controller", "lqr", "--out", "regulated"],
];
/// Commands that tell of any vehicle.
const TELLING: [&[&str]; 3] = [&["models"], &["linearise"], &["allocate"]];

fn of<'a>(command: &[&'a str], file: &'a str) -> Vec<&'a str> {
    [&command[..1], &[file], &command[1..]].concat()
}

fn written(folder: &Path, vehicle: &Vehicle) -> String {
    let name = format!("{}.toml", vehicle.name);
    std::fs::write(folder.join(&name), vehicle.to_toml().expect("a valid vehicle")).expect("written");
    name
}

/// Hummingbird with changed rotors and load.
fn changed(name: &str, change: impl Fn(&mut Vehicle)) -> Vehicle {
    let mut vehicle = vehicles::by_name("hummingbird").expect("built in");
    vehicle.name = name.into();
    change(&mut vehicle);
    vehicle
}

#[test]
fn what_cannot_be_steered_is_told_in_the_same_words_by_every_command() {
    let folder = temporary();
    let spun = changed("spun", |v| v.rotors.iter_mut().zip([1.0, 1.0, -1.0, -1.0]).for_each(|(r, s)| r.spin = s));
    let alike = changed("alike", |v| v.rotors.iter_mut().for_each(|r| r.spin = 1.0));
    let two = changed("two", |v| drop(v.rotors.drain(2..)));
    for vehicle in [spun, alike, two] {
        let file = written(folder.path(), &vehicle);
        let words = vehicle.authority().shortcomings();
        assert!(words.contains("only together") || words.contains("not at all"), "{words}");
        for command in FLYING {
            let (_, error) = exits(2, folder.path(), &of(command, &file));
            assert!(error.contains(&words), "{command:?} {file}: {error}\n{words}");
        }
        let (page, _) = exits(0, folder.path(), &of(TELLING[0], &file));
        assert!(page.contains(&words), "models {file}: {page}");
    }
}

#[test]
fn what_does_not_balance_is_told_with_the_same_row_by_every_command() {
    let folder = temporary();
    let heavy = changed("heavy", |v| v.parts[0].mass += 3.0);
    let ahead = changed("ahead", |v| v.parts[0].position[0] += 0.3);
    let beside = changed("beside", |v| v.parts[0].position[1] -= 0.4);
    for (vehicle, row) in [(heavy, "short of lift"), (ahead, "pitch moment"), (beside, "roll moment")] {
        let file = written(folder.path(), &vehicle);
        for command in FLYING.iter().chain(&TELLING[1..2]) {
            let (_, error) = exits(2, folder.path(), &of(command, &file));
            // what flies asks for 5 % more than the weight
            let lift = row == "short of lift" && error.contains("thrust over weight");
            assert!(error.contains(row) || lift, "{command:?} {file}: {error}");
        }
        for command in [TELLING[0], TELLING[2]] {
            let (page, _) = exits(0, folder.path(), &of(command, &file));
            assert!(page.contains(row), "{command:?} {file}: {page}");
        }
    }
}

#[test]
fn what_leans_in_hover_is_flown_and_told_by_every_command() {
    let folder = temporary();
    let crooked = |degrees: f64| {
        changed("crooked", |v| {
            let (s, c) = degrees.to_radians().sin_cos();
            v.rotors[0].axis = [s, 0.0, c];
        })
    };
    for degrees in [0.05, 3.0] {
        let vehicle = crooked(degrees);
        let file = written(folder.path(), &vehicle);
        for command in FLYING.iter().chain(&TELLING) {
            let output =
                crate::command::command(folder.path(), &of(command, &file)).output().expect("the binary starts");
            // a tuning of one step may find nothing better
            let fine = output.status.success() || (command[0] == "tune" && output.status.code() == Some(1));
            assert!(fine, "{command:?}: {output:?}");
        }
        let told = json(folder.path(), &["models", &file]);
        let lean = told["hover_lean"].as_f64().or_else(|| told["model"]["hover_lean"].as_f64()).expect("a lean");
        let hover = vehicle.hover().expect("hovers");
        assert!((lean - hover.lean()).abs() < 1e-12 && lean > 0.0, "{lean}");
        let (page, _) = exits(0, folder.path(), &["tasks", "Hover", "--vehicle", &file]);
        assert!(page.contains("leans"), "{page}");
        exits(
            0,
            folder.path(),
            &["rollout", "Hover", "--vehicle", &file, "--envs", "2", "--horizon", "40", "--no-plots"],
        );
    }
}

/// What the library says of random geometries is what every command does: nothing is flown that does not hover or cannot be steered,
/// and nothing that does is refused. `design`, `tune` and `recover` take seconds each: of every fortieth.
#[test]
fn two_hundred_random_vehicles_are_flown_or_refused_alike_by_every_command() {
    let folder = temporary();
    let (mut flown, mut refused) = (0, 0);
    for seed in 0..200 {
        let vehicle = geometry::vehicle(seed);
        let file = written(folder.path(), &vehicle);
        let hover = vehicle.hover();
        // what steers asks for gains, and for a twentieth of the weight to spare
        let steered = vehicle.check_steerable().and_then(|()| vehicle.hover());
        let flies = steered.and_then(|_| CascadeModel::<f64, MAX_ROTORS>::new(&vehicle, &vehicle.gains()));
        let run = |command: &[&str]| {
            let output =
                crate::command::command(folder.path(), &of(command, &file)).output().expect("the binary starts");
            let [page, error] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).expect("text"));
            (output.status.code().expect("no signal"), page, error)
        };
        let rows = ["roll moment", "pitch moment", "yaw moment", "lift", "only together", "not at all"];
        let same_row =
            |told: &str, error: &Error| rows.iter().any(|row| told.contains(row) && error.to_string().contains(row));

        let (code, page, _) = run(&["models"]);
        assert_eq!(code, 0, "models {file}");
        let warned = flies.as_ref().err().is_none_or(|error| same_row(&page, error));
        assert!(warned, "models {file}: {page}\n{flies:?}");
        let (code, _, error) = run(&["linearise"]);
        assert_eq!(code, if hover.is_ok() { 0 } else { 2 }, "linearise {file}: {error}");
        assert!(hover.as_ref().err().is_none_or(|own| same_row(&error, own)), "linearise {file}: {error}");
        let (code, page, error) = run(&["allocate"]);
        assert_eq!(code, 0, "allocate {file}: {error}");
        assert!(hover.as_ref().err().is_none_or(|own| same_row(&page, own)), "allocate {file}: {page}");

        let quick: &[&str] =
            &["fly", "--no-plots", "--duration", "0.2", "--reference", "hover", "--out", "flown", "--force"];
        let slow = FLYING[1..4].iter().copied().filter(|_| seed % 40 == 0);
        for command in std::iter::once(quick).chain(slow) {
            let (code, _, error) = run(command);
            match &flies {
                // a tuning of one step may find nothing better, a start may be too much to recover
                Ok(_) => assert!(
                    code == 0 || (code == 1 && ["tune", "recover"].contains(&command[0])),
                    "{command:?} {file}: {error}"
                ),
                Err(own) => assert!(code == 2 && same_row(&error, own), "{command:?} {file}: {error}\n{own}"),
            }
        }
        *(if flies.is_ok() { &mut flown } else { &mut refused }) += 1;
    }
    println!("{flown} flown, {refused} refused");
    assert!(flown > 50 && refused > 20, "{flown} flown, {refused} refused");
}

#[test]
fn a_loop_that_never_comes_to_rest_fails_and_rates_that_hardly_come_round_are_refused() {
    let folder = temporary();
    let huge = "[1e300, 1e300, 1e300]";
    let gains = format!("position = {huge}\nvelocity = {huge}\nattitude = {huge}\nrate = {huge}\n");
    std::fs::write(folder.path().join("huge.toml"), gains).expect("written");
    let (page, _) = exits(1, folder.path(), &["design", "hummingbird", "--gains", "huge.toml"]);
    assert!(page.contains("FAILED") && page.contains("steady"), "{page}");
    let (page, _) = exits(1, folder.path(), &["design", "hummingbird", "--gains", "huge.toml", "--json"]);
    assert!(page.contains("\"stable\":false") || page.contains("\"stable\": false"), "{page}");
    let (_, error) = exits(2, folder.path(), &["design", "hummingbird", "--rates", "500,250,2"]);
    assert!(error.contains("250") && error.contains("128"), "{error}");
}

/// A motor that speeds up more slowly than it slows down: by 18 late steps the vehicle falls, by none it flies.
#[test]
fn design_judges_motors_by_the_longer_of_their_lags() {
    let folder = temporary();
    let lagging = |up: f64, down: f64| {
        let name = format!("up_{}_down_{}", 1e3 * up, 1e3 * down);
        let lags = |v: &mut Vehicle| {
            v.rotors.iter_mut().for_each(|r| (r.time_constant_up, r.time_constant_down) = (up, down));
        };
        written(folder.path(), &changed(&name, lags))
    };
    let published = ["design", "--gains", "published"];
    let (page, _) =
        exits(1, folder.path(), &[&of(&published, &lagging(0.05, 0.025))[..], &["--latency", "18"]].concat());
    assert!(page.contains("longer of the motors' lags"), "{page}");
    let (page, _) = exits(1, folder.path(), &of(&published, &lagging(0.01, 0.15)));
    assert!(page.contains("with the shorter it is stable"), "{page}");
    exits(0, folder.path(), &of(&published, &lagging(0.0125, 0.025)));
}
