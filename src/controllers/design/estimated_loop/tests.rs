//! Linear models of loops with estimators against LQG, and against the loops as they fly.

use super::*;
use crate::cascade::Rates;
use crate::design::AnalysisPoint;
use crate::estimation::{ComplementarySettings, StateEstimatorSettings, lqg, steady_kalman};
use crate::hover_feedback::{HoverFeedback, HoverWeights};
use crate::law::{ControlLaw, LawController};
use crate::linear::margins::sensitivity;
use crate::linear::{StateSpace, multiloop_disk_margin};
use crate::reference::{Hover, Reference};
use crate::{CascadeLaw, ClosedLoop, Controller, ExogenousInputs, Target};
use dynamics::{Disturbance, Physics, Vehicle, vehicles};

/// Whose motors have one lag: a flight switches between two.
fn vehicle() -> Vehicle {
    let mut own = vehicles::by_name("hummingbird").unwrap();
    own.rotors.iter_mut().for_each(|rotor| rotor.time_constant_up = rotor.time_constant_down);
    own
}

fn hummingbird() -> Plant {
    Plant::of_vehicle(&vehicle(), Physics { dt: 0.002, ..Physics::default() }).unwrap()
}

fn hover() -> Reference {
    Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 })
}

fn cascade(plant: &Plant, rates: &Rates) -> LawController<CascadeLaw> {
    let vehicle = vehicle();
    CascadeLaw::new(&vehicle, plant.physics(), &vehicle.gains(), rates).unwrap().running()
}

fn lqr(plant: &Plant) -> LawController<HoverFeedback> {
    let rates = Rates::every_step(plant.physics().dt);
    LawController::of(HoverFeedback::lqr(plant, &rates, &HoverWeights::default()).unwrap())
}

fn model<L: ControlLaw>(plant: &Plant, law: LawController<L>, latency: usize) -> LoopModel {
    let start = trim(plant, &TrimTarget::hover()).unwrap().state;
    let closed = ClosedLoop::new(plant.clone(), law).unwrap().with_latency(latency).unwrap();
    LoopModel::new(closed, Target::level(&hover()), &Disturbance::none(), &start).unwrap()
}

fn sensors(list: &str) -> Vec<SensorConfig> {
    SensorConfig::parse_list(list).unwrap()
}

/// The same sensors, as often and as late, without errors.
fn exact(noisy: &[SensorConfig]) -> Vec<SensorConfig> {
    let bare = |own: &SensorConfig| sensors(own.model.kind()).remove(0).model;
    noisy.iter().map(|own| SensorConfig { model: bare(own), ..own.clone() }).collect()
}

fn timed(own: &mut SensorConfig, every: u64, latency: u64) {
    (own.every, own.rate, own.latency, own.delay) = (Some(every), None, Some(latency), None);
}

/// The defaults; of one that begins off the truth so little off that it is linear.
fn kind(name: &str) -> EstimatorSettings {
    match EstimatorSettings::by_name(name).unwrap() {
        EstimatorSettings::Ekf(own) => {
            EstimatorSettings::Ekf(StateEstimatorSettings { position: 1e-4, velocity: 1e-4, attitude: 1e-5, ..own })
        }
        other => other,
    }
}

/// Commands of a loop as it flies, row by row, `after` steps in hover: how they answer to what `poke` does to state and outside, by
/// differences of two flights. Innovations are nothing there, so that gains which change along the way change the answer by nothing: it
/// is that of the gains as they are then.
fn answer<C: Controller + Clone>(
    plant: &Plant,
    controller: &C,
    (noisy, estimator): (&[SensorConfig], Option<&EstimatorSettings>),
    (after, n): (usize, usize),
    poke: &dyn Fn(f64, &mut Vec<f64>, &mut ExogenousInputs),
) -> Vec<Vec<f64>> {
    let target = hover();
    let h = 1e-5;
    let flown = |by: f64| {
        let mut system =
            ClosedLoop::new(plant.clone(), controller.clone()).unwrap().with_sensors(&exact(noisy), 0).unwrap();
        if let Some(settings) = estimator {
            system = system.with_estimator(noisy, settings).unwrap();
        }
        let mut x = trim(plant, &TrimTarget::hover()).unwrap().state;
        let mut next = x.clone();
        let mut rows = Vec::new();
        for k in 0..after + n {
            let mut outside = ExogenousInputs::none();
            if k == after {
                poke(by, &mut x, &mut outside);
            }
            system.advance(&x, Target::level(&target), &outside, &mut next).unwrap();
            if k >= after {
                rows.push(system.applied().to_vec());
            }
            std::mem::swap(&mut x, &mut next);
        }
        rows
    };
    let (up, down) = (flown(h), flown(-h));
    let slope = |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| (a - b) / (2.0 * h)).collect();
    up.iter().zip(&down).map(slope).collect()
}

fn largest(rows: &[Vec<f64>]) -> f64 {
    rows.iter().flatten().fold(0.0, |most: f64, x| most.max(x.abs()))
}

fn apart(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
}

#[test]
fn margins_with_the_steady_filter_are_those_of_lqg() {
    let plant = hummingbird();
    let mut list = sensors("imu:bmi088,motion_capture:optical");
    timed(&mut list[1], 1, 0);
    let filter = HoverKalman::new(&plant, &list, &Default::default()).unwrap();
    assert_eq!(filter.period(), 1);
    let truth = model(&plant, lqr(&plant), 0);
    let found = truth.with_estimator(&plant, &list, &kind("kalman"), 0).unwrap();

    let [a, b] = filter.model();
    let c = DMatrix::from_fn(9, a.nrows(), |i, j| filter.told()[i / 3].rows[(i % 3, j)]);
    let system = StateSpace::new(a.clone(), b.clone(), c, DMatrix::zeros(9, 4), Some(0.002)).unwrap();
    let [process, noise] = filter.noise();
    let steady = steady_kalman(&system, &process, &noise).unwrap();
    let law = lqr(&plant);
    let gain = law.law().regulator().gain.clone();
    let compensator = lqg(&system, &steady, &gain).unwrap();
    let cut = system.series(&compensator.scaled(-1.0)).unwrap();
    let wanted = sensitivity(&cut).unwrap();
    let omega: Vec<f64> = (0..60).map(|k| 0.5 * 1.14_f64.powi(k)).filter(|w| *w < 1500.0).collect();
    let mut worst: f64 = 0.0;
    for i in 0..4 {
        let response = found.response(AnalysisPoint::Command(i), &omega).unwrap();
        for (w, own) in omega.iter().zip(response) {
            worst = worst.max((own - wanted.at(wanted.on_axis(*w))[(i, i)]).norm());
        }
    }
    let [own, lqg] =
        [found.disk_margin(AnalysisPoint::Commands, 0.0).unwrap(), multiloop_disk_margin(&cut, 0.0).unwrap()];
    let regulator = truth.disk_margin(AnalysisPoint::Commands, 0.0).unwrap();
    println!(
        "sensitivities apart by {worst:.1e}; disk margin of all commands {:.6}, by lqg() {:.6}, on the true state {:.4}",
        own.alpha, lqg.alpha, regulator.alpha
    );
    assert!(worst < 1e-6 && (own.alpha - lqg.alpha).abs() < 1e-4);
    // Doyle 1978: with a filter in the loop there is less
    assert!(own.alpha < 0.9 * regulator.alpha);
}

/// What the linear model answers with to a state that is moved by `from`, of which the estimate, whose error begins at `at`, knows nothing
/// but what lies before `known`.
fn moved(model: &LoopModel, from: &[f64], (at, known): (usize, usize), n: usize) -> Vec<Vec<f64>> {
    let mut w = DMatrix::zeros(model.n_state(), 1);
    (0..from.len()).for_each(|k| w[(k, 0)] = from[k]);
    (known..from.len()).for_each(|k| w[(at + k - known, 0)] = -from[k]);
    let rows = (0..n).map(|k| {
        let step = &model.steps[k % model.steps.len()];
        let said = (&step.commanded * &w).as_slice().to_vec();
        w = &step.a * &w;
        said
    });
    rows.collect()
}

#[test]
fn linear_models_with_late_sensors_of_several_rates_are_those_of_the_flight() {
    let plant = hummingbird();
    let rates = Rates { rate: 500.0, attitude: 250.0, velocity: 50.0 };
    let mut list = sensors("imu:bmi088,motion_capture:optical,barometer:px4,gnss:single_point,magnetometer:pegasus");
    timed(&mut list[0], 1, 1);
    timed(&mut list[1], 5, 7);
    timed(&mut list[2], 10, 3);
    timed(&mut list[3], 20, 12);
    timed(&mut list[4], 4, 0);
    let from: Vec<f64> = (0..16).map(|k| if k < 12 { [0.1, -0.07, 0.05][k % 3] } else { k as f64 - 13.0 }).collect();
    let errors = ErrorState::of_plant(&plant).unwrap();
    let poke = |by: f64, x: &mut Vec<f64>, _: &mut ExogenousInputs| {
        *x = errors.moved(x, &from.iter().map(|v| by * v).collect::<Vec<_>>());
    };
    let setting = kind("kalman");
    for named in ["cascade", "lqr"] {
        let (truth, flown) = if named == "cascade" {
            let law = cascade(&plant, &rates);
            (model(&plant, law.clone(), 0), answer(&plant, &law, (&list, Some(&setting)), (200, 300), &poke))
        } else {
            let law = lqr(&plant);
            (model(&plant, law.clone(), 0), answer(&plant, &law, (&list, Some(&setting)), (200, 300), &poke))
        };
        let found = truth.with_estimator(&plant, &list, &setting, 0).unwrap();
        let linear = moved(&found, &from, (truth.n_state(), 0), 300);
        let off = apart(&linear, &flown) / largest(&flown);
        println!("{named}: answers apart by {off:.1e} of the largest, period of {} steps", found.period());
        assert!(off < 1e-3, "{named}: {off}");
    }
}

/// 1/max |S| of the answer of a command to what is added to it, over frequency.
fn modulus(rows: &[Vec<f64>], command: usize, dt: f64) -> f64 {
    let omega: Vec<f64> = (0..150).map(|k| 1.0 * 1.045_f64.powi(k)).collect();
    let size = |w: &f64| {
        let terms = rows.iter().enumerate();
        let sum = terms.fold(nalgebra::Complex::new(0.0, 0.0), |sum, (k, row)| {
            sum + nalgebra::Complex::from_polar(row[command], -w * k as f64 * dt)
        });
        sum.norm()
    };
    1.0 / omega.iter().map(size).fold(0.0, f64::max)
}

#[test]
fn what_an_inertial_unit_drives_leaves_the_margins_of_the_true_state() {
    let plant = hummingbird();
    let rates = Rates::every_step(0.002);
    let law = cascade(&plant, &rates);
    let list = sensors("imu:bmi088,motion_capture:optical");
    let poke = |by: f64, _: &mut Vec<f64>, outside: &mut ExogenousInputs| outside.at_input = vec![by, 0.0, 0.0, 0.0];
    let n = 2500;
    let truth = answer(&plant, &law, (&list, None), (500, n), &poke);
    let borne = modulus(&truth, 0, 0.002);
    let linear = model(&plant, law.clone(), 0);
    let outside = sensors("imu:bmi088,gnss:single_point,magnetometer:pegasus,barometer:ms5611");
    for (name, list) in [("ekf", &list), ("ekf", &outside), ("complementary", &list)] {
        let own = answer(&plant, &law, (list, Some(&kind(name))), (500, n), &poke);
        let with = modulus(&own, 0, 0.002);
        let off = apart(&own, &truth);
        println!(
            "{name}: answers of commands apart by {off:.1e} of 1; modulus {with:.5}, on the true state {borne:.5}"
        );
        assert!(off < 2e-5 && (with / borne - 1.0).abs() < 1e-3, "{name}: {off} {with} {borne}");
        if std::ptr::eq(list, &outside) {
            continue;
        }
        // of the cascade, which does not look at rotor speeds, the linear model is the same too
        let found = linear.with_estimator(&plant, list, &kind(name), 0).unwrap();
        let [a, b] = [&found, &linear].map(|model| model.margins(AnalysisPoint::Command(0)).unwrap());
        assert!((a.disk.alpha - b.disk.alpha).abs() < 1e-6 && (a.phase - b.phase).abs() < 1e-6, "{a:?} {b:?}");
    }
    // a unit that is late costs what its latency is
    let mut late = list.clone();
    timed(&mut late[0], 1, 3);
    let own = answer(&plant, &law, (&late, Some(&kind("ekf"))), (500, n), &poke);
    let found = linear.with_estimator(&plant, &late, &kind("ekf"), 0).unwrap();
    let first = found.steps[0].a.nrows();
    let (mut w, mut added) = (DMatrix::zeros(first, 1), 1.0);
    let wanted: Vec<Vec<f64>> = (0..n)
        .map(|k| {
            let step = &found.steps[k % found.steps.len()];
            let mut said = (&step.commanded * &w).as_slice().to_vec();
            said[0] += added;
            w = &step.a * &w + step.by_command.columns(0, 1) * added;
            added = 0.0;
            said
        })
        .collect();
    let (off, with) = (apart(&own, &wanted), modulus(&own, 0, 0.002));
    println!(
        "6 ms late: answers apart from the linear model by {off:.1e} of 1; modulus {with:.4}, not late {borne:.4}"
    );
    assert!(off < 1e-4 && with < 0.97 * borne, "{off} {with} {borne}");
}

#[test]
fn rotor_speeds_that_are_modelled_cost_a_law_that_looks_at_them() {
    let plant = hummingbird();
    let list = sensors("imu:bmi088,motion_capture:optical");
    let truth = model(&plant, lqr(&plant), 0);
    let found = truth.with_estimator(&plant, &list, &kind("ekf"), 0).unwrap();
    // rotors that are faster than the commands say: of these the estimate knows nothing
    let from: Vec<f64> = (0..16).map(|k| if k < 12 { 0.0 } else { k as f64 - 13.0 }).collect();
    let poke = |by: f64, x: &mut Vec<f64>, _: &mut ExogenousInputs| (13..17).for_each(|k| x[k] += by * from[k - 1]);
    let flown = answer(&plant, &lqr(&plant), (&list, Some(&kind("ekf"))), (500, 300), &poke);
    let off = apart(&moved(&found, &from, (truth.n_state(), 12), 300), &flown) / largest(&flown);
    println!("answers of lqr on an ekf to rotors that are faster apart by {off:.1e} of the largest");
    assert!(off < 1e-3);
    let [a, b] = [&truth, &found].map(|model| model.disk_margin(AnalysisPoint::Commands, 0.0).unwrap().alpha);
    println!("disk margin of all commands of lqr: {a:.4} with measured rotor speeds, {b:.4} with modelled ones");
    assert!(found.stability().unwrap().is_stable() && b < a);
}

#[test]
fn commands_that_are_late_are_late_for_the_filter_too() {
    let plant = hummingbird();
    let list = sensors("imu:bmi088,motion_capture:optical");
    for name in ["kalman", "ekf"] {
        let disk = |latency: usize| {
            let truth = model(&plant, cascade(&plant, &Rates::every_step(0.002)), latency);
            let found = truth.with_estimator(&plant, &list, &kind(name), latency).unwrap();
            assert!(found.stability().unwrap().is_stable());
            found.disk_margin(AnalysisPoint::Command(0), 0.0).unwrap().alpha
        };
        let all = [0, 1, 3].map(disk);
        println!("{name}: disk margins {all:.3?} with commands 0, 1 and 3 steps late");
        assert!(all[0] > all[1] && all[1] > all[2]);
    }
}

#[test]
fn what_has_no_such_model_is_refused_by_name() {
    let plant = hummingbird();
    let truth = model(&plant, cascade(&plant, &Rates::every_step(0.002)), 0);
    let outside = sensors("imu:bmi088,gnss:single_point,magnetometer:pegasus");
    let mut rare = sensors("imu:bmi088,motion_capture:optical");
    timed(&mut rare[0], 2, 0);
    let mut odd = sensors("imu:bmi088,motion_capture:optical");
    timed(&mut odd[1], 131, 0);
    for (list, name, words) in [
        (&outside, "complementary", "righted by the accelerometer"),
        (&rare, "ekf", "every 2 steps"),
        (&odd, "kalman", "131"),
    ] {
        let error = truth.with_estimator(&plant, list, &kind(name), 0).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
    let free = EstimatorSettings::Complementary(ComplementarySettings { accelerometer: 0.0, ..Default::default() });
    assert!(truth.with_estimator(&plant, &outside, &free, 0).is_ok());
}
