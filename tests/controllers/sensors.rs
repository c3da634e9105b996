//! What sensors read along a flight: the truth where they have no errors, late and rarely as told, in columns of its file.

use omnidrones::controllers::{
    ClosedLoop, Controller, ExogenousInputs, Flight, FlightPlan, Measurement, Setup, Target, default_controller, fly,
    fly_vehicle,
};
use omnidrones::dynamics::sensors::{KINDS, OnboardSensors, SensorConfig, presets};
use omnidrones::dynamics::spatial::{rotate_back, up_axis};
use omnidrones::dynamics::{Physics, Plant, configurations, vehicles};
use std::iter;

fn flown(sensors: Vec<SensorConfig>, seed: u64) -> Flight {
    let hummingbird = vehicles::hummingbird();
    let plan = FlightPlan { duration: 2.0, sensors, seed, ..FlightPlan::default() };
    fly_vehicle(&hummingbird, &hummingbird.gains(), &plan, &mut |_| {}).unwrap()
}

/// One channel of a log, by its name without unit.
fn column(flight: &Flight, name: &str) -> Vec<f64> {
    let columns = flight.log.columns();
    let found = columns.into_iter().find(|(own, _)| own.split(' ').next() == Some(name));
    found.unwrap_or_else(|| panic!("no column {name}")).1
}

#[test]
fn sensors_without_errors_read_the_flight_as_it_was() {
    // a vehicle alone touches nothing
    let kinds = KINDS.iter().filter(|kind| kind.name != "contact");
    let list = kinds.map(|kind| SensorConfig::new(kind.name, kind.ideal())).collect();
    let flight = flown(list, 0);
    let log = &flight.log;
    let axes = |name: &str| ["x", "y", "z"].map(|axis| column(&flight, &format!("{name}_{axis}")));
    let (gyro, force, fix) = (axes("imu.gyroscope"), axes("imu.accelerometer"), axes("gnss.position"));
    let (mut rate_error, mut force_error, mut range_error) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (range, valid) = (column(&flight, "range.distance"), column(&flight, "range.valid"));
    for i in 1..log.len() {
        // mean of the specific force over the step before, from the log alone
        let mean = [0, 1, 2].map(|k| (log.velocity[i][k] - log.velocity[i - 1][k]) / 0.002);
        let want = rotate_back(log.attitude[i], [mean[0], mean[1], mean[2] + 9.81]);
        for k in 0..3 {
            rate_error = rate_error.max((gyro[k][i] - log.angular_velocity[i][k]).abs());
            // half a step of turning is between the two, of a force below 40 m/s²
            let turned = 0.5 * 0.002 * log.angular_velocity[i].iter().map(|w| w.abs()).sum::<f64>() * 40.0;
            force_error = force_error.max((force[k][i] - want[k]).abs() - turned);
            assert_eq!(fix[k][i], log.position[i][k]);
        }
        let distance = log.position[i][2] / up_axis(log.attitude[i])[2];
        range_error = range_error.max((range[i] - distance).abs());
        assert_eq!(valid[i], 1.0);
    }
    println!(
        "rates {rate_error:.1e} rad/s, force beyond half a step of turning {force_error:.1e}, range {range_error:.1e} m"
    );
    // measured 4.4e-16, 0, 0
    assert!(rate_error < 4e-14 && force_error < 1e-11 && range_error < 1e-11);
    // at rest on its reference: the first sample is of the dynamics, +g less what the first step already tilts
    assert!((force[2][0] - 9.81).abs() < 0.2, "{}", force[2][0]);
}

/// 65 536 columns of a flight take half a gigabyte.
fn is_small(sensor: &SensorConfig) -> bool {
    sensor.model.channels().len() <= 4096
}

#[test]
fn readings_are_late_rare_and_repeatable_and_do_not_disturb_the_flight() {
    let list: Vec<SensorConfig> = presets::REGISTRY
        .iter()
        .map(|p| SensorConfig::of_preset(format!("{}.{}", p.kind, p.name), p))
        .filter(is_small)
        .collect();
    let (first, again, other) = (flown(list.clone(), 5), flown(list.clone(), 5), flown(list, 6));
    assert_eq!((&first.log.sensor_readings, &first.log.scans), (&again.log.sensor_readings, &again.log.scans));
    assert_ne!(first.log.sensor_readings, other.log.sensor_readings);
    let bare = flown(Vec::new(), 5);
    assert_eq!((&bare.states, &bare.log.thrust), (&first.states, &first.log.thrust));
    assert!(bare.log.sensor_channels.is_empty() && bare.log.csv_header().len() < first.log.csv_header().len());
    let fix = column(&first, "gnss.single_point.position_x");
    let changes: Vec<usize> = (1..fix.len()).filter(|i| fix[*i] != fix[i - 1]).collect();
    // 5 Hz are 100 steps of 2 ms, 0.12 s of latency 60: the sample of step 100 arrives in step 160
    assert_eq!(changes[..3], [160, 260, 360]);
}

#[test]
fn the_file_of_a_flight_has_a_column_per_channel_and_reads_back_without_them() {
    let list = SensorConfig::parse_list("imu:bmi088,barometer:px4").unwrap();
    let flight = flown(list, 1);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.csv");
    flight.log.write_csv(&path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let header = text.lines().next().unwrap();
    assert!(header.ends_with(",imu.gyroscope_z [rad/s],barometer.pressure [Pa]"), "{header}");
    assert!(text.lines().all(|line| line.split(',').count() == header.split(',').count()));
    let back = omnidrones::flight::FlightLog::read_csv(&path).unwrap();
    assert_eq!((back.len(), back.sensor_channels.len()), (flight.log.len(), 0));
    assert_eq!(back.position, flight.log.position);
}

#[test]
fn a_camera_has_a_row_per_reading_whatever_its_rate_and_delay() {
    for (every, latency) in [(1, 0), (7, 0), (50, 13), (50, 60)] {
        let eye = SensorConfig::parse_list("camera:diffphysdrone").unwrap().remove(0);
        let eye = SensorConfig { every: Some(every), rate: None, latency: Some(latency), delay: None, ..eye };
        let imu = SensorConfig::parse_list("imu").unwrap().remove(0);
        let flight = flown(vec![eye.clone(), imu.clone()], 3);
        let log = &flight.log;
        assert_eq!(log.sensor_channels.len(), imu.model.channels().len(), "no pixel is a column");
        assert_eq!(log.sensor_readings, flown(vec![imu], 3).log.sensor_readings);
        let [scans] = &log.scans[..] else { panic!("{} scans", log.scans.len()) };
        // the first sample is held from the start; each later one is read where its latency is over
        let later =
            (0..log.len()).filter(|k| *k > latency as usize && (k - latency as usize).is_multiple_of(every as usize));
        let want: Vec<f64> = [0].into_iter().chain(later).map(|k| log.time[k]).collect();
        assert_eq!(scans.time, want, "every {every}, late by {latency}");
        assert_eq!(scans.readings.len(), scans.len() * eye.model.channels().len());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("eye.csv");
        scans.write_csv(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text.lines().count(), 1 + scans.len());
        let head = text.lines().next().unwrap();
        assert!(head.starts_with("time [s],") && head.split(',').count() == 1 + scans.channels.len());
        let (size, told) = (text.len() as f64, scans.csv_size() as f64);
        assert!((told / size - 1.0).abs() < 0.2, "{told} bytes told, {size} written");
    }
}

#[test]
fn a_sensor_sits_on_any_body_of_a_configuration() {
    let model = configurations::by_name("payload").unwrap();
    let plant = Plant::of_model(&model, Physics::default()).unwrap();
    let load = plant.body_names().last().unwrap().clone();
    let gnss = SensorConfig::parse_list("gnss").unwrap().remove(0);
    let on = |name: &str, body: &str| SensorConfig { name: name.into(), on: Some(body.into()), ..gnss.clone() };
    let mut plan = FlightPlan { duration: 0.5, physics: *plant.physics(), ..FlightPlan::default() };
    // the bar's origin is its joint at the drone: half a metre down the bar
    let down = SensorConfig { position: [0.0, 0.0, -0.5], ..on("load", &load) };
    plan.sensors = vec![SensorConfig { name: "root".into(), ..gnss.clone() }, down];
    let mut controller = default_controller(&plant, &Setup::new(None, &plan.rates)).unwrap();
    let flight = fly(&plant, &mut controller, &plan, &mut |_| {}).unwrap();
    let [root, load] = ["root", "load"].map(|name| column(&flight, &format!("{name}.position_z")));
    println!("from the drone to half a metre down the bar: {} m", root[0] - load[0]);
    assert!(root.iter().zip(&load).all(|(root, load)| (root - load - 0.5).abs() < 0.05), "{} {}", root[0], load[0]);
    plan.sensors[1].on = Some("lood".into());
    let refused = fly(&plant, &mut controller, &plan, &mut |_| {}).map(drop).unwrap_err().to_string();
    assert!(refused.contains("body") && refused.contains("'lood'"), "{refused}");
}

/// A controller that is shown what sensors read in place of the state: position and attitude of motion capture, velocity of a
/// receiver, rates of a gyroscope.
struct Blindfold<C> {
    inside: C,
    state: Vec<f64>,
    /// Of the state's numbers, which reading each is.
    from: Vec<(usize, usize)>,
}

impl<C: Controller> Controller for Blindfold<C> {
    fn name(&self) -> &str {
        "blindfold"
    }
    fn reset(&mut self) {
        self.inside.reset();
    }
    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, commands: &mut [f64]) {
        self.from.iter().for_each(|(to, reading)| self.state[*to] = seen.readings[*reading]);
        self.inside.tick(Measurement { state: &self.state, ..seen }, target, commands);
    }
}

#[test]
fn a_controller_may_fly_by_what_its_loop_s_sensors_read_alone() {
    let hummingbird = vehicles::hummingbird();
    let plan = FlightPlan::default();
    let plant = Plant::of_vehicle(&hummingbird, plan.physics).unwrap();
    let (gains, target) = (hummingbird.gains(), Target::level(&plan.reference));
    let cascade = || default_controller(&plant, &Setup::new(Some(&gains), &plan.rates)).unwrap();
    let sensors = SensorConfig::parse_list("motion_capture,gnss,imu").unwrap();
    let mut start = plant.hover_state().unwrap();
    start[..3].copy_from_slice(&[0.3, -0.2, 1.0]);
    let fly = |system: &mut dyn FnMut(&[f64], &mut [f64])| {
        let (mut x, mut next) = (start.clone(), start.clone());
        for _ in 0..1000 {
            system(&x, &mut next);
            std::mem::swap(&mut x, &mut next);
        }
        x
    };

    let mut open = ClosedLoop::new(plant.clone(), cascade()).unwrap();
    let seeing = fly(&mut |x, next| open.advance(x, target, &ExogenousInputs::none(), next).unwrap());
    let blind = |latency: u64| {
        let late = |sensor: &SensorConfig| SensorConfig { latency: Some(latency), ..sensor.clone() };
        let sensors: Vec<_> = sensors.iter().map(late).collect();
        let channels = OnboardSensors::new(&sensors, &plant).unwrap().channels();
        let first = |name: &str| channels.iter().position(|c| c.name == name).unwrap_or_else(|| panic!("no {name}"));
        let fields = [
            (0, 3, "motion_capture.position_x"),
            (3, 3, "gnss.velocity_x"),
            (6, 4, "motion_capture.attitude_w"),
            (10, 3, "imu.gyroscope_x"),
        ];
        let numbers =
            |(at, n, name): (usize, usize, &str)| (0..n).map(move |k| (at + k, k)).zip(iter::repeat(first(name)));
        let from = fields.into_iter().flat_map(numbers).map(|((to, k), first)| (to, first + k)).collect();
        let blindfold = Blindfold { inside: cascade(), state: vec![f64::NAN; start.len()], from };
        let mut closed = ClosedLoop::new(plant.clone(), blindfold).unwrap().with_sensors(&sensors, 0).unwrap();
        let end = fly(&mut |x, next| closed.advance(x, target, &ExogenousInputs::none(), next).unwrap());
        seeing.iter().zip(end).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    let (at_once, late) = (blind(0), blind(10));
    println!("{at_once:.1e} apart after two seconds, {late:.1e} when sensors are 20 ms late");
    // measured 1.1e-13, 8.2
    assert!(at_once < 1e-11 && late > 1.0);
}
