//! The linear model of a flown loop: its margins are where flights lose stability, and those of the loop as one rate sees it.

use nalgebra::Complex;
use omnidrones::controllers::cascade::Rates;
use omnidrones::controllers::design::{AnalysisPoint, LoopModel, TrimTarget, trim};
use omnidrones::controllers::linear::{disk_margin, margins};
use omnidrones::controllers::reference::{Hover, Reference};
use omnidrones::controllers::{ClosedLoop, Target};
use omnidrones::dynamics::{Disturbance, Gains, Physics, Plant, Vehicle, vehicles};
use omnidrones::error::Result;

const ONE_RATE: Rates = Rates { rate: 500.0, attitude: 500.0, velocity: 500.0 };

fn model(vehicle: &Vehicle, gains: &Gains, rates: &Rates, latency: usize) -> Result<LoopModel> {
    let physics = Physics::default();
    let state = trim(&Plant::of_vehicle(vehicle, physics)?, &TrimTarget::hover())?.state;
    let closed = ClosedLoop::of_vehicle(vehicle, physics, gains, rates)?.with_latency(latency)?;
    let there = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
    LoopModel::new(closed, Target::level(&there), &Disturbance::none(), &state)
}

fn radius(model: &LoopModel) -> f64 {
    model.poles().unwrap()[0].norm()
}

#[test]
fn a_loop_that_is_not_stable_bears_nothing() {
    let vehicle = vehicles::by_name("iris").unwrap();
    let late = model(&vehicle, &vehicle.gains(), &ONE_RATE, 100).unwrap();
    assert!(radius(&late) > 1.0);
    let told = late.margins(AnalysisPoint::Command(0)).unwrap();
    assert!(!told.stable && (told.gain_up, told.gain_down) == (1.0, 1.0), "{told:?}");
    assert!((told.phase, told.delay, told.disk.alpha) == (0.0, 0.0, 0.0), "{told:?}");
}

#[test]
fn at_one_rate_margins_are_those_of_the_plain_loop() {
    for name in vehicles::names() {
        let vehicle = vehicles::by_name(name).unwrap();
        let model = model(&vehicle, &vehicle.gains(), &ONE_RATE, 0).unwrap();
        assert_eq!(model.period(), 1);
        let (lifted, open) =
            (model.margins(AnalysisPoint::Command(0)).unwrap(), model.open(AnalysisPoint::Command(0)).unwrap());
        let plain = margins(&open).unwrap();
        let steps = (plain.delay / model.dt).ceil() * model.dt;
        assert!(plain.stable && lifted.stable);
        // the lifted search ends at 100
        let up = if plain.gain_up < 100.0 { plain.gain_up } else { f64::INFINITY };
        assert!(
            lifted.gain_up == up || (lifted.gain_up / up - 1.0).abs() < 1e-6,
            "{name}: {} {}",
            lifted.gain_up,
            plain.gain_up
        );
        let alike = lifted.phase == plain.phase || (lifted.phase - plain.phase).abs() < 1e-6;
        assert!(alike, "{name}: {} {}", lifted.phase, plain.phase);
        // and this one at 128 steps
        assert!(
            (lifted.delay - steps).abs() < 1e-9 || (lifted.delay.is_infinite() && steps > 128.0 * model.dt),
            "{name}: {} {}",
            lifted.delay,
            plain.delay
        );
        assert!((lifted.disk.alpha / disk_margin(&open, 0.0).unwrap().alpha - 1.0).abs() < 1e-6, "{name}");
        let omega = [0.5, 7.0, 60.0, 400.0];
        let response = model.response(AnalysisPoint::Command(0), &omega).unwrap();
        for (w, s) in omega.iter().zip(response) {
            let l = open.at(open.on_axis(*w))[(0, 0)];
            assert!((s * (l + 1.0) - Complex::new(1.0, 0.0)).norm() < 1e-8, "{name} at {w}");
        }
    }
}

#[test]
fn poles_say_whether_a_loop_of_several_rates_with_more_latency_holds() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let usual = model(&vehicle, &vehicle.gains(), &Rates::default(), 0).unwrap();
    assert_eq!(usual.period(), 10);
    // all commands late by the same: the largest latency with which a flight still settles, by flying
    let settles =
        |steps: usize| model(&vehicle, &vehicle.gains(), &Rates::default(), steps).is_ok_and(|m| radius(&m) < 1.0);
    let last = (1..60).take_while(|k| settles(*k)).last().unwrap();
    println!("radius {:.6}, latency up to {last} steps", radius(&usual));
    assert!(!settles(last + 1));
    // the model before the edge is nearly marginal
    let near = model(&vehicle, &vehicle.gains(), &Rates::default(), last).unwrap();
    assert!((0.97..1.0).contains(&radius(&near)), "{}", radius(&near));
}

#[test]
fn a_disk_margin_of_all_commands_is_at_most_that_of_each() {
    for name in ["hummingbird", "firefly"] {
        let vehicle = vehicles::by_name(name).unwrap();
        let model = model(&vehicle, &vehicle.gains(), &Rates::default(), 0).unwrap();
        let all = model.disk_margin(AnalysisPoint::Commands, 0.0).unwrap();
        let each = (0..model.commands.len()).map(|i| model.disk_margin(AnalysisPoint::Command(i), 0.0).unwrap().alpha);
        let least = each.fold(f64::INFINITY, f64::min);
        println!("{name}: all {all:?}, least of one {least:.4}");
        assert!(0.0 < all.alpha && all.alpha <= least * (1.0 + 1e-6), "{name}: {} of {least}", all.alpha);
    }
}

/// A factor of the disk is a gain and phase like any other: so no margin that is searched for is smaller. And a slow level that
/// runs more often than it must changes little.
#[test]
fn disk_margins_of_a_loop_of_several_rates_are_within_its_gain_and_phase_and_near_those_of_one_rate() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let of = |rates: &Rates| model(&vehicle, &vehicle.gains(), rates, 0).unwrap();
    let (several, one) = (of(&Rates::default()), of(&ONE_RATE));
    assert!(several.period() > 1);
    for i in 0..12 {
        let (m, single) = (
            several.margins(AnalysisPoint::Measurement(i)).unwrap(),
            one.margins(AnalysisPoint::Measurement(i)).unwrap(),
        );
        let (name, ratio) = (&several.measurements[i].name, m.disk.alpha / single.disk.alpha);
        println!(
            "{name}: {:.3} of {:.3}, at {:.2} and {:.2} rad/s",
            m.disk.alpha, single.disk.alpha, m.disk.omega, single.disk.omega
        );
        assert!(m.disk.gain.1 <= m.gain_up * (1.0 + 1e-6) && m.disk.gain.0 >= m.gain_down * (1.0 - 1e-6), "{name}");
        assert!(m.disk.phase <= m.phase + 1e-6, "{name}");
        assert!((0.7..1.1).contains(&ratio), "{name}: {ratio}");
    }
}

#[test]
fn a_moving_target_is_refused() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let closed = ClosedLoop::of_vehicle(&vehicle, Physics::default(), &vehicle.gains(), &ONE_RATE).unwrap();
    let state = closed.plant().hover_state().unwrap();
    let circle = Reference::by_name("circle").unwrap();
    let error = LoopModel::new(closed, Target::level(&circle), &Disturbance::none(), &state).unwrap_err();
    assert!(error.to_string().contains("constant"), "{error}");
}
