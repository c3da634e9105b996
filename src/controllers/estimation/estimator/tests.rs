//! Every estimator in the loop.

use super::*;
use crate::cascade::Rates;
use crate::reference::{Hover, Lemniscate, Reference};
use crate::registry::{REGISTRY, Setup, controller};
use crate::{Flight, FlightPlan, fly};
use dynamics::{Physics, vehicles};
use rng::{Purpose, Stream};

const OPTICAL: &str = "imu:bmi088,motion_capture:optical";
const OUTSIDE: &str = "imu:bmi088,gnss:single_point,magnetometer:pegasus,barometer:ms5611";

fn sensors(text: &str) -> Vec<SensorConfig> {
    SensorConfig::parse_list(text).unwrap()
}

fn hummingbird() -> Plant {
    let physics = Physics { dt: 0.002, ..Physics::default() };
    Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), physics).unwrap()
}

fn flown(name: &str, list: &str, reference: Reference, duration: f64, estimator: Option<EstimatorSettings>) -> Flight {
    let plant = hummingbird();
    let rates = Rates::every_step(plant.physics().dt);
    let mut own = controller(name, &plant, &Setup::new(None, &rates)).unwrap();
    let (physics, sensors) = (*plant.physics(), sensors(list));
    let plan = FlightPlan { physics, rates, reference, duration, sensors, estimator, seed: 3, ..FlightPlan::default() };
    fly(&plant, &mut own, &plan, &mut |_| {}).unwrap()
}

fn lemniscate() -> Reference {
    Reference::Lemniscate(Lemniscate { origin: [0.0, 0.0, 1.5], ..Lemniscate::default() })
}

fn hover(yaw: f64) -> Reference {
    Reference::Hover(Hover { position: [0.0, 0.0, 1.5], yaw })
}

#[test]
fn every_estimator_flies_every_controller_of_a_single_vehicle_on_optical_fixes() {
    let plant = hummingbird();
    for entry in REGISTRY.iter().filter(|entry| entry.suits(&plant)) {
        let truth = flown(entry.name, OPTICAL, lemniscate(), 3.0, None).log.rmse(2.0).unwrap();
        for kind in &ESTIMATORS {
            let flight = flown(entry.name, OPTICAL, lemniscate(), 3.0, Some((kind.settings)()));
            let found = flight.estimates.as_ref().unwrap();
            let rmse = flight.log.rmse(2.0).unwrap_or(f64::NAN);
            println!(
                "{} on {}: {rmse:.4} m, {truth:.4} m on the truth; estimate off by {:.4?}, NEES {:.2}, {:.2} within",
                entry.name,
                kind.name,
                found.tally.rms(),
                found.tally.mean(),
                found.tally.share_within()
            );
            assert!(flight.diverged_at.is_none() && flight.lost().is_none(), "{} on {}", entry.name, kind.name);
            // the steady filter knows hover alone: up to 25 mm more
            assert!(rmse < 1.1 * truth + 0.03, "{} on {}: {rmse} {truth}", entry.name, kind.name);
            // 7.5 to 8.9
            let is_consistent = (5.0..15.0).contains(&found.tally.mean());
            assert_eq!(is_consistent, kind.has_covariance, "{} on {}: {:?}", entry.name, kind.name, found.tally);
        }
    }
}

#[test]
fn every_built_in_vehicle_hovers_on_every_estimator() {
    let physics = Physics { dt: 0.002, ..Physics::default() };
    let rates = Rates::every_step(physics.dt);
    for name in vehicles::names() {
        let plant = Plant::of_vehicle(&vehicles::by_name(name).unwrap(), physics).unwrap();
        for kind in &ESTIMATORS {
            let mut own = controller("cascade", &plant, &Setup::new(None, &rates)).unwrap();
            let (sensors, estimator) = (sensors(OPTICAL), Some((kind.settings)()));
            let reference = hover(0.7);
            let plan = FlightPlan {
                physics,
                rates,
                reference,
                duration: 4.0,
                sensors,
                estimator,
                seed: 3,
                ..FlightPlan::default()
            };
            let flight = fly(&plant, &mut own, &plan, &mut |_| {}).unwrap();
            let rmse = flight.log.rmse(2.5).unwrap_or(f64::NAN);
            let found = flight.estimates.unwrap();
            println!("{name} on {}: {:.1} mm, NEES {:.2}", kind.name, 1e3 * rmse, found.tally.mean());
            assert!(rmse < 0.02, "{name} on {}: {rmse}", kind.name);
        }
    }
}

#[test]
fn outside_on_slow_fixes_each_hovers_at_any_heading() {
    for kind in &ESTIMATORS {
        let yaw: f64 = 2.5;
        let flight = flown("cascade", OUTSIDE, hover(yaw), 10.0, Some((kind.settings)()));
        let found = flight.estimates.as_ref().unwrap();
        let rmse = flight.log.rmse(2.0).unwrap_or(f64::NAN);
        println!(
            "{} at {yaw} rad: {rmse:.3} m, estimate off by {:.3?}, NEES {:.2}",
            kind.name,
            found.tally.rms(),
            found.tally.mean()
        );
        for record in &found.records {
            println!("   {} {:.3}", record.name, record.mean());
        }
        // a receiver is off by metres
        assert!(flight.lost().is_none() && rmse < 3.0, "{}: {rmse}", kind.name);
        assert!(found.tally.rms()[1] < 0.2 && found.tally.rms()[2] < 0.02, "{}: {:?}", kind.name, found.tally);
    }
}

#[test]
fn settings_come_back_from_their_text_and_name_what_they_do_not_know() {
    for entry in &ESTIMATORS {
        let settings = (entry.settings)();
        assert_eq!((settings.kind(), EstimatorSettings::by_name(entry.name).unwrap()), (entry.name, settings.clone()));
        let text = toml::to_string(&settings).unwrap();
        let table: toml::Table = toml::from_str(&text).unwrap();
        assert_eq!(EstimatorSettings::of(table, "own.toml").unwrap(), settings, "{text}");
    }
    let of = |text: &str| EstimatorSettings::of(toml::from_str(text).unwrap(), "own.toml");
    assert_eq!(of("gate = 9.0").unwrap().kind(), "ekf");
    for (text, words) in [
        ("kind = 'kalmann'", "kalman"),
        ("kind = 3", "kind"),
        ("kind = 'kalman'\ngate = 9.0", "gate"),
        ("kind = 'complementary'\nattitude = 'high'", "attitude"),
    ] {
        let error = of(text).unwrap_err().to_string();
        assert!(error.contains(words), "{text}: {error}");
    }
}

#[test]
fn hostile_readings_leave_an_estimate_that_is_a_number() {
    let plant = hummingbird();
    let configs = sensors(
        "imu:bmi088,motion_capture:optical,gnss:single_point,barometer:ms5611,range:vl53l1x,flow:pmw3901,magnetometer:pegasus",
    );
    let n = configs.iter().map(|config| config.model.channels().len()).sum();
    for entry in ESTIMATORS.iter().filter(|entry| entry.name != "ekf") {
        let mut estimator = Estimator::new(&plant, &configs, &(entry.settings)()).unwrap();
        estimator.begin(&plant.hover_state().unwrap(), &mut Stream::new(1, 0, 0, Purpose::TASK));
        let mut draw = Stream::new(9, 0, 0, Purpose::TASK);
        let mut readings: Vec<f64> = vec![0.0; n];
        for k in 0..3000 {
            for x in &mut readings {
                *x = match draw.below(12) {
                    0 => f64::NAN,
                    1 => f64::INFINITY,
                    2 => 1e300 * draw.normal(),
                    3 => 1e6 * draw.normal(),
                    4 => 1.0,
                    5 => 0.0,
                    _ => 10.0 * draw.normal(),
                };
            }
            estimator.step(&readings);
            let own = estimator.estimate();
            let numbers = own.position.iter().chain(&own.velocity).chain(&own.attitude).chain(&own.angular_velocity);
            assert!(numbers.copied().all(f64::is_finite), "{}, step {k}: {own:?}", entry.name);
        }
    }
}
