//! Filters of the rate loop: their lag in its margins, and the law with them over any scalar.

use crate::cascade::Rates;
use crate::closed_loop::{ClosedLoop, ExogenousInputs};
use crate::controller::{Controller, Target};
use crate::design::{AnalysisPoint, LoopModel, TrimTarget, trim};
use crate::filter::{DigitalFilter, FilterSettings};
use crate::law::LawController;
use crate::reference::{Hover, Reference};
use crate::{FlightPlan, fly};
use dynamics::{Disturbance, Physics, Vehicle, vehicles};
use nalgebra::Complex;
use std::f64::consts::PI;

use super::CascadeLaw;

const DT: f64 = 0.002;
const HOVER: Reference = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
/// The rate about body y, measured.
const PITCH_RATE: AnalysisPoint = AnalysisPoint::Measurement(10);

fn looped(vehicle: &Vehicle, rates: &Rates, filters: &str) -> ClosedLoop<LawController<CascadeLaw>> {
    let filters = if filters.is_empty() { Vec::new() } else { FilterSettings::parse_list(filters).unwrap() };
    let closed = ClosedLoop::of_vehicle(vehicle, Physics::default(), &vehicle.gains(), rates).unwrap();
    closed.with_filters(&filters).unwrap()
}

fn model(vehicle: &Vehicle, rates: &Rates, filters: &str) -> LoopModel {
    let closed = looped(vehicle, rates, filters);
    let start = trim(closed.plant(), &TrimTarget::hover()).unwrap().state;
    LoopModel::new(closed, Target::level(&HOVER), &Disturbance::none(), &start).unwrap()
}

/// The loop broken at the measured pitch rate, L = 1/S − 1.
fn broken(model: &LoopModel, omega: f64) -> Complex<f64> {
    model.response(PITCH_RATE, &[omega]).unwrap()[0].inv() - 1.0
}

/// Where |L| falls through 1, rad/s.
fn crossing(of: &dyn Fn(f64) -> Complex<f64>) -> f64 {
    let (mut low, mut high) = (5.0_f64, 400.0_f64);
    for _ in 0..60 {
        let middle = (low * high).sqrt();
        if of(middle).norm() > 1.0 { low = middle } else { high = middle }
    }
    low
}

#[test]
fn the_phase_margin_of_the_rate_loop_falls_by_the_phase_of_its_filters_at_the_crossing() {
    let (vehicle, rates) = (vehicles::by_name("hummingbird").unwrap(), Rates::every_step(DT));
    let row = [DigitalFilter::low_pass(80.0, DT), DigitalFilter::notch(150.0, 30.0, DT)];
    let closed_form = |omega: f64| row.iter().map(|f| f.response(omega, DT)).product::<Complex<f64>>();
    let [bare, filtered] = ["", "low_pass:80,notch:150:30"].map(|filters| model(&vehicle, &rates, filters));

    // L with the filters is L without them times their response
    let mut worst = 0.0_f64;
    for omega in [1.0, 8.0, 20.0, 60.0, 300.0, 900.0, 1400.0] {
        let (with, times) = (broken(&filtered, omega), broken(&bare, omega) * closed_form(omega));
        worst = worst.max((with - times).norm() / times.norm());
    }
    println!("L with filters against L times their response: worst {worst:.1e}");
    // measured: 8.6e-11
    assert!(worst < 1e-8);

    // margins found by turning the loop, against that product where it crosses 1
    let [before, after] = [&bare, &filtered].map(|model| model.margins(PITCH_RATE).unwrap());
    let at = crossing(&|omega| broken(&bare, omega) * closed_form(omega));
    let expected = PI + (broken(&bare, at) * closed_form(at)).arg();
    let lag = -closed_form(at).arg();
    let fallen = before.phase - after.phase;
    println!(
        "crosses at {at:.2} rad/s; phase margin {:.3}° to {:.3}° (closed form {:.3}°): {:.3}° less, filters there {:.3}°",
        before.phase.to_degrees(),
        after.phase.to_degrees(),
        expected.to_degrees(),
        fallen.to_degrees(),
        lag.to_degrees()
    );
    // measured: 42.582° to 39.514°, as the closed form; 3.068° both
    assert!((after.phase - expected).abs() < 1e-6);
    assert!((fallen - lag).abs() < 0.01 * lag);
    // and the delay that ends stability by about what the filters are late by
    let late = FilterSettings::delay_of(&FilterSettings::parse_list("low_pass:80,notch:150:30").unwrap(), DT);
    println!("delay margin {} s to {} s, filters late by {late:.5} s", before.delay, after.delay);
    assert!(before.delay > after.delay && (before.delay - after.delay - late).abs() < 1.5 * DT);
}

/// Levels of three rates, integral action, a first state that turns: what is recorded is what runs.
#[test]
fn a_law_with_filters_runs_as_it_is_recorded() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let rates = Rates { rate: 250.0, attitude: 250.0, velocity: 50.0 };
    let mut closed = looped(&vehicle, &rates, "low_pass:60:1,notch:90:20");
    let recorded = closed.controller().recorded(closed.plant()).unwrap().unwrap();
    let mut again = ClosedLoop::new(closed.plant().clone(), LawController::of(recorded)).unwrap();
    let mut x = trim(closed.plant(), &TrimTarget::hover()).unwrap().state;
    (x[0], x[10], x[12]) = (0.3, 2.0, -1.0);
    let (mut y, mut worst) = (x.clone(), 0.0_f64);
    let (mut next, mut other) = (x.clone(), x.clone());
    for _ in 0..400 {
        closed.advance(&x, Target::level(&HOVER), &ExogenousInputs::none(), &mut next).unwrap();
        again.advance(&y, Target::level(&HOVER), &ExogenousInputs::none(), &mut other).unwrap();
        (x, y) = (next.clone(), other.clone());
        worst = x.iter().zip(&y).map(|(a, b)| (a - b).abs()).fold(worst, f64::max);
    }
    println!("worst {worst:.1e}; ends at {:?}", &x[..3]);
    // measured: 0
    assert!(worst < 1e-9 && x[..3].iter().all(|p| p.abs() < 0.3));
}

#[test]
fn filters_begin_again_with_the_flight() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let mut closed = looped(&vehicle, &Rates::default(), "low_pass:30");
    let start = trim(closed.plant(), &TrimTarget::hover()).unwrap().state;
    let mut turning = start.clone();
    turning[11] = 3.0;
    let fly = |closed: &mut ClosedLoop<_>| {
        let (mut x, mut next) = (turning.clone(), start.clone());
        for _ in 0..50 {
            closed.advance(&x, Target::level(&HOVER), &ExogenousInputs::none(), &mut next).unwrap();
            std::mem::swap(&mut x, &mut next);
        }
        x
    };
    let first = fly(&mut closed);
    assert_ne!(fly(&mut closed), first);
    closed.reset();
    assert_eq!(fly(&mut closed), first);
}

#[test]
fn filters_remember_two_numbers_per_axis_each_and_what_they_said_last() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let n = |filters: &str| looped(&vehicle, &Rates::default(), filters).controller().memory().len();
    // latched 27, learnt 13 where it integrates
    let bare = 27 + if vehicle.gains().is_integral() { 13 } else { 0 };
    assert_eq!([n(""), n("low_pass:80"), n("low_pass:80,notch:150:30")], [bare, bare + 10, bare + 16]);
}

#[test]
fn a_plan_of_other_filters_than_the_controllers_is_refused() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let closed = looped(&vehicle, &Rates::default(), "low_pass:80");
    let (plant, law) = (closed.plant(), closed.law());
    let plan = |filters: &str| FlightPlan {
        filters: if filters.is_empty() { Vec::new() } else { FilterSettings::parse_list(filters).unwrap() },
        duration: 0.1,
        ..FlightPlan::default()
    };
    let flown = |filters: &str| fly(plant, &mut law.clone().running(), &plan(filters), &mut |_| {});
    assert!(flown("low_pass:80").is_ok());
    for other in ["", "low_pass:81", "low_pass:80:1"] {
        let refusal = flown(other).unwrap_err().to_string();
        assert!(refusal.contains("plan.filters") && refusal.contains("'cascade' was built with"), "{refusal}");
    }
}

#[test]
fn filters_faster_than_the_rate_level_are_refused_with_its_rate() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let rates = Rates { rate: 250.0, attitude: 250.0, velocity: 50.0 };
    let closed = ClosedLoop::of_vehicle(&vehicle, Physics::default(), &vehicle.gains(), &rates).unwrap();
    let refusal = closed.with_filters(&FilterSettings::parse_list("low_pass:130").unwrap()).unwrap_err().to_string();
    assert!(refusal.contains("130 Hz") && refusal.contains("below 125 Hz") && refusal.contains("250 Hz"), "{refusal}");
}
