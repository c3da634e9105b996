//! The key figures of a flight have closed forms, and its file reads back.

use omnidrones::controllers::velocity::desired_attitude;
use omnidrones::dynamics::spatial::{from_euler, from_matrix, multiply, up_axis};
use omnidrones::flight::{Commanded, FlightLog, FlightSample};

const LIMIT: f64 = 800.0;

/// Error (3, 4, 0)·t cm at t = 0, 1, … 9 s, tilt 0.1·t rad, half of the rotor commands at the limit.
fn log() -> FlightLog {
    let mut log = FlightLog::new("closed form", &[LIMIT; 2]);
    for i in 0..10 {
        let t = f64::from(i);
        let sample = FlightSample {
            time: t,
            position: [1.0 + 0.03 * t, 0.04 * t, 2.0],
            velocity: [0.0, t, 0.0],
            attitude: from_euler(0.1 * t, 0.0, 1.0),
            angular_velocity: [0.0; 3],
            reference_position: [1.0, 0.0, 2.0],
            reference_velocity: [0.0; 3],
            reference_acceleration: [9.81, 0.0, 0.0],
            reference_yaw: 0.0,
            rotor_speed: &[1.0, 2.0],
            rotor_command: &[LIMIT, 0.5 * LIMIT],
            thrust: &[0.1, 0.2],
            wind: [0.0; 3],
        };
        log.push(sample).unwrap();
    }
    log
}

#[test]
fn rmse_maxima_and_saturation_equal_their_closed_forms() {
    let log = log();
    // Errors 0.05·t: mean of squares over t = 2 … 9 is 0.05²·284/8.
    assert!((log.rmse(2.0).unwrap() - 0.05 * (284.0f64 / 8.0).sqrt()).abs() < 1e-14);
    assert!((log.max_error(0.0).unwrap() - 0.45).abs() < 1e-14);
    assert!((log.max_tilt().unwrap() - 0.9).abs() < 1e-14);
    assert_eq!((log.max_speed(), log.saturation_share()), (Some(9.0), Some(0.5)));
    assert_eq!(log.summary(2.0).duration, 9.0);
}

#[test]
fn the_headings_error_counts_no_full_turn_and_no_tilt() {
    for error in [0.0, 1e-8, 0.3, 3.1, -1e-8, -0.3, -3.1] {
        for (yaw, turns) in [(0.0, 0.0), (1.0, 1.0), (-2.0, -3.0), (3.0, 7.0)] {
            for tilt in [[0.0, 0.0], [0.8, -0.5], [-0.8, -0.5], [2.5, 0.2]] {
                let mut log = log();
                log.reference_yaw.fill(yaw + turns * std::f64::consts::TAU);
                // the force chose the attitude: turned about it, from the one that it asks for
                let force = up_axis(from_euler(tilt[0], tilt[1], yaw));
                let wanted = from_matrix(desired_attitude(force, yaw));
                log.attitude.fill(multiply(wanted, from_euler(0.0, 0.0, error)));
                assert_heading(&log, error);
                // roll and pitch were asked apart
                log.asked_angles = vec![[0.0; 3]; log.len()];
                log.attitude.fill(from_euler(tilt[0], tilt[1], yaw + error));
                assert_heading(&log, error);
            }
        }
    }
    // what has no heading has no error of it, and a broken sample has
    let mut log = log();
    log.asked_angles = vec![[0.0; 3]; log.len()];
    log.attitude.fill(from_euler(0.0, std::f64::consts::FRAC_PI_2, 0.0));
    assert_eq!(log.summary(2.0).max_heading_error, Some(0.0));
    log.attitude[5] = [f64::NAN; 4];
    assert_eq!(log.summary(2.0).heading_rmse, None);
}

fn assert_heading(log: &FlightLog, error: f64) {
    let off = log.heading_error().iter().map(|own| (own - error).abs()).fold(0.0, f64::max);
    // measured: 5e-15
    assert!(off < 1e-13, "{error}: {off:e}");
    let summary = log.summary(2.0);
    let [rmse, most] = [summary.heading_rmse, summary.max_heading_error].map(|v| v.unwrap() - error.abs());
    assert!(rmse.abs() < 1e-13 && most.abs() < 1e-13, "{error}: {rmse:e} {most:e}");
}

#[test]
fn the_reference_attitude_leans_towards_the_asked_acceleration() {
    let [roll, pitch, yaw] = log().reference_euler_angles()[0];
    assert!(roll.abs() < 1e-15 && (pitch - std::f64::consts::FRAC_PI_4).abs() < 1e-15 && yaw == 0.0);
}

#[test]
fn a_diverged_flight_has_no_rmse_and_says_how_many_samples_broke() {
    let mut log = log();
    log.position[5] = [f64::NAN; 3];
    let summary = log.summary(2.0);
    assert_eq!((summary.rmse, summary.non_finite_samples), (None, 1));
    assert!(summary.max_error.is_some() && log.rmse(6.0).is_some() && log.rmse(100.0).is_none());
}

#[test]
fn a_sample_with_the_wrong_number_of_rotors_is_refused() {
    let mut log = FlightLog::new("two", &[LIMIT; 2]);
    let sample = FlightSample {
        time: 0.0,
        position: [0.0; 3],
        velocity: [0.0; 3],
        attitude: [1.0, 0.0, 0.0, 0.0],
        angular_velocity: [0.0; 3],
        reference_position: [0.0; 3],
        reference_velocity: [0.0; 3],
        reference_acceleration: [0.0; 3],
        reference_yaw: 0.0,
        rotor_speed: &[1.0],
        rotor_command: &[1.0, 1.0],
        thrust: &[1.0, 1.0],
        wind: [0.0; 3],
    };
    let error = log.push(sample).unwrap_err().to_string();
    assert!(error.contains("rotor_speed is 1") && log.is_empty(), "{error}");
}

#[test]
fn the_csv_file_reads_back_to_the_same_bits_under_headers_with_units() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/run.csv");
    let mut log = log();
    log.wind[9] = [0.1, f64::NAN, f64::NEG_INFINITY];
    log.write_csv(&path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let mut lines = text.lines();
    assert!(lines.next().unwrap().starts_with("time [s],position_x [m],position_y [m]"));
    let rows: Vec<Vec<f64>> = lines.map(|l| l.split(',').map(|v| v.parse().unwrap()).collect()).collect();
    assert_eq!((rows.len(), rows[0].len()), (10, log.csv_header().len()));
    assert_eq!(rows[7][1].to_bits(), log.position[7][0].to_bits());
    assert!(rows[9].last() == Some(&f64::NEG_INFINITY) && rows[9][rows[9].len() - 2].is_nan());
}

#[test]
fn columns_of_rotors_count_from_0_as_their_names_do() {
    let header = log().csv_header();
    let of = |what: &str| header.iter().filter(|n| n.starts_with(what)).cloned().collect::<Vec<_>>();
    assert_eq!(of("rotor_speed"), ["rotor_speed_0 [rad/s]", "rotor_speed_1 [rad/s]"]);
    assert_eq!(of("rotor_command"), ["rotor_command_0 [rad/s]", "rotor_command_1 [rad/s]"]);
    assert_eq!(of("thrust"), ["thrust_0 [N]", "thrust_1 [N]"]);
}

#[test]
fn a_flight_reads_back_as_it_was_with_and_without_what_was_commanded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.csv");
    let mut written = log();
    for turn in 0..2 {
        written.write_csv(&path).unwrap();
        let read = FlightLog::read_csv(&path).unwrap();
        assert!(read.max_rotor_speed.iter().all(|most| most.is_nan()) && read.saturation_share().is_none());
        let told = FlightLog { vehicle: written.vehicle.clone(), max_rotor_speed: vec![LIMIT; 2], ..read };
        assert_eq!(told, written, "turn {turn}");
        let asked = |i: u32| Commanded {
            thrust: f64::from(i),
            attitude: from_euler(0.01 * f64::from(i), 0.0, 0.0),
            angular_velocity: [0.0, 0.1, f64::from(i)],
        };
        written.commanded = (0..10).map(asked).collect();
    }
}

#[test]
fn what_is_no_flight_is_refused_with_its_line_and_column() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.csv");
    log().write_csv(&path).unwrap();
    let whole = std::fs::read_to_string(&path).unwrap();
    let second = whole.lines().nth(1).unwrap();
    for (text, words) in [
        (String::new(), "no column 'time [s]'"),
        ("a,b\n1,2\n".into(), "no column 'time [s]'"),
        (whole.replacen("attitude_x [-]", "attitude_x [rad]", 1), "no column 'attitude_x [-]'"),
        (whole.replacen("rotor_command_1", "rotor_command_7", 1), "no column 'rotor_command_1 [rad/s]'"),
        (whole.replacen("\n1,", "\nfast,", 1), "line 3"),
        (format!("{whole}{second}\n"), "not after the last"),
        (format!("{whole}1,2\n"), "line 12"),
        (whole.lines().next().unwrap().to_string(), "no samples"),
        (whole.replace(',', ";"), "line 1: separates its columns by semicolons. Save it with commas"),
        (format!("\u{feff}{}", whole.replace(',', ";").replace('.', ",")), "separates its columns by semicolons"),
        (whole.replace(',', "\t"), "separates its columns by tabs"),
        (
            whole.replacen("\n1,", "\n\"1,0\",", 1),
            "has '1,0' as its time [s], with a decimal comma where a point must be",
        ),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = FlightLog::read_csv(&path).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("flight.csv"), "{words}: {error}");
    }
    assert!(FlightLog::read_csv(folder.path()).is_err());
    // what a spreadsheet puts first is no part of a name
    std::fs::write(&path, format!("\u{feff}{whole}")).unwrap();
    assert_eq!(FlightLog::read_csv(&path).unwrap().len(), 10);
}
