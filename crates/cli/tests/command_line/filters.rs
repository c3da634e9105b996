//! Filters of body rates and noise of sensors: what `fly` and `design` make of them, and what they refuse.

use crate::command::{exits, json, size, temporary};
use serde_json::Value;

const ROW: &str = "low_pass:80,notch:150:30";
const FILE: &str = "[[filter]]\nkind = \"low_pass\"\nfrequency = 80\n\n[[filter]]\nkind = \"notch\"\nfrequency = 150\nbandwidth = 30\n";

/// The phase margin with the loop broken at a measurement, rad.
fn phase(told: &Value, at: &str) -> f64 {
    let rows = told["margins"].as_array().expect("margins");
    rows.iter().find(|row| row["at"] == at).and_then(|row| row["phase"].as_f64()).expect("a phase")
}

#[test]
fn filters_are_flown_and_told_and_their_lag_is_in_the_margins() {
    let folder = temporary();
    let told = json(folder.path(), &["fly", "hummingbird", "--filters", ROW, "--no-plots", "--duration", "4"]);
    assert_eq!(told["plan"]["filters"][1]["bandwidth"], 30.0, "{}", told["plan"]);
    let certified = told["derivatives"].as_array().expect("certificates");
    assert!(certified.iter().all(|row| row["holds"] == true) && certified.len() == 2, "{certified:?}");
    assert!(told["sensitivity"]["rmse"].as_f64().is_some_and(|rmse| rmse > 0.0), "{}", told["sensitivity"]);

    let [bare, filtered] = [&["design", "hummingbird"][..], &["design", "hummingbird", "--filters", ROW]]
        .map(|line| json(folder.path(), line));
    let lost = phase(&bare, "angular_velocity_x") - phase(&filtered, "angular_velocity_x");
    println!("phase margin of the roll rate: {:.2}° less", lost.to_degrees());
    // measured: 3.06°
    assert!((1.0..6.0).contains(&lost.to_degrees()));
    let (page, _) = exits(0, folder.path(), &["design", "hummingbird", "--filters", ROW]);
    assert!(page.contains("low-pass at 80 Hz; notch at 150 Hz, 30 Hz wide") && page.contains("2.86 ms late"), "{page}");

    // the same from a file, and on plants that are not as believed
    std::fs::write(folder.path().join("row.toml"), FILE).expect("written");
    let line = ["design", "hummingbird", "--filters", "row.toml", "--spread", "0.2", "--samples", "2"];
    let mut from_file = json(folder.path(), &line);
    let [of_plants, of_loop] = [&from_file["plants"]["nominal"]["disk"], &filtered["all_commands"]["alpha"]];
    let [of_plants, of_loop] = [of_plants, of_loop].map(|alpha| alpha.as_f64().expect("a margin"));
    assert!((of_plants / of_loop - 1.0).abs() < 1e-6, "{of_plants} {of_loop}");
    from_file["plants"] = Value::Null;
    assert_eq!(from_file, filtered);
}

#[test]
fn noise_of_sensors_is_told_of_the_linear_loop_beside_a_flight() {
    let folder = temporary();
    let line = ["design", "crazyflie", "--sensors", "imu:bmi088,motion_capture:optical"];
    let told = json(folder.path(), &line);
    let noise = &told["noise"];
    assert_eq!(noise["sources"].as_array().map(Vec::len), Some(3), "{noise}");
    for row in noise["deviations"].as_array().expect("rows") {
        let of = |key: &str| row[key].as_f64();
        if let Some(scatter) = of("scatter") {
            let off = of("flown").expect("flown") / of("linear").expect("linear") - 1.0;
            println!("{}: {off:+.3}, scatter {scatter:.3}", row["of"]);
            assert!(off.abs() < 4.0 * scatter + 0.1, "{row}");
        }
    }
    let (page, _) = exits(0, folder.path(), &[&line[..], &["--report", "page.html"]].concat());
    assert!(page.contains("Noise of sensors in hover") && page.contains("imu.gyroscope"), "{page}");
    assert!(size(folder.path(), "page.html") > 10_000);
    let html = std::fs::read_to_string(folder.path().join("page.html")).expect("written");
    assert!(html.contains("Noise of sensors in hover"));
    // noise of a loop that is not stable grows without end
    let (page, _) = exits(1, folder.path(), &["design", "iris", "--sensors", "imu:bmi088", "--filters", "low_pass:2"]);
    assert!(page.contains("FAILED") && !page.contains("Noise"), "{page}");
}

#[test]
fn filters_and_noise_that_nobody_has_are_refused_by_name() {
    let folder = temporary();
    std::fs::write(folder.path().join("typo.toml"), "[[filter]]\nkind = 'notch'\nfrequency = 80\nwidth = 3\n")
        .expect("written");
    for (line, words) in [
        (&["design", "iris", "--filters", "low_pass:300"][..], "below 250 Hz, half the rate of its samples"),
        (
            &["fly", "iris", "--filters", "low_pass:80,notch:260:9", "--no-plots"],
            "filter 2 (notch): frequency is 260 Hz",
        ),
        (&["fly", "iris", "--rates", "250,250,50", "--filters", "low_pass:130", "--no-plots"], "below 125 Hz"),
        (&["design", "iris", "--filters", "low_pas:3.5"], "did you mean 'low_pass'"),
        (&["design", "iris", "--filters", "notch:40"], "notch:FREQUENCY:BANDWIDTH"),
        (&["design", "iris", "--filters", "typo.toml"], "typo.toml"),
        (&["design", "iris", "--filters", "none.toml"], "none.toml"),
        (&["fly", "iris", "--filters", "low_pass:80", "--controller", "indi", "--no-plots"], "controller 'indi'"),
        (&["fly", "iris", "--filters", "low_pass:80", "--fail", "0", "--no-plots"], "controller 'fault_tolerant'"),
        (&["fly", "payload", "--filters", "low_pass:80", "--no-plots"], "--filters with a configuration"),
        (&["fly", "--filters", "low_pass:80", "--drop"], "--filters with --drop"),
        (&["design", "iris", "--controller", "mpc", "--filters", "low_pass:80"], "--filters with --controller mpc"),
        (&["design", "iris", "--controller", "mpc", "--sensors", "imu:bmi088"], "--sensors with --controller mpc"),
        (&["design", "iris", "--sensors", "imu"], "without white noise"),
        (&["design", "iris", "--sensors", "barometer:ms5611"], "imu or motion_capture"),
        (&["design", "iris", "--sensors", "imu:bmi08"], "did you mean 'bmi088'"),
    ] {
        let (out, err) = exits(2, folder.path(), line);
        assert!(out.is_empty() && err.contains(words), "{line:?}: {err}");
    }
}
