//! Gradients put to use: gains tuned by reverse-mode gradients through closed-loop flights beat the published ones.

use omnidrones::controllers::Rates;
use omnidrones::controllers::design::{FlightGrid, GridCell, MarginGate, TunePlan, tune};
use omnidrones::dynamics::{Physics, vehicles};
use omnidrones::parallel::Threads;
use std::ops::ControlFlow;

#[test]
fn tuned_gains_beat_the_published_ones_by_fifteen_percent_on_held_out_starts_without_a_crash() {
    // measured: hummingbird 0.1091 → 0.0599 m (45 %), firefly 0.0974 → 0.0710 m (27 %)
    for name in ["hummingbird", "firefly"] {
        let vehicle = vehicles::by_name(name).unwrap();
        let published = vehicle.published_gains.unwrap();
        let tuning = tune(&vehicle, &published, &TunePlan::default(), &mut |_| ControlFlow::Continue(())).unwrap();
        println!("{name}: {:?} → {:?}", tuning.before, tuning.after);
        assert_eq!((tuning.before.n, tuning.after.n), (256, 256));
        assert_eq!((tuning.before.crashed, tuning.after.crashed), (0, 0));
        assert!(tuning.after.rmse <= 0.85 * tuning.before.rmse, "{name}");
        assert!(tuning.history.len() == 60 && tuning.history[59].rmse < tuning.history[0].rmse);
    }
}

#[test]
fn tuning_repeats_bit_for_bit_and_says_what_it_cannot_tune() {
    let vehicle = vehicles::by_name("crazyflie").unwrap();
    let plan = TunePlan { n_start: 70, n_held_out: 8, iterations: 3, duration: 0.5, ..Default::default() };
    let run = || tune(&vehicle, &vehicle.gains(), &plan, &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(run(), run());
    let mut gains = vehicle.gains();
    gains.position[1] = 0.0;
    let text = tune(&vehicle, &gains, &plan, &mut |_| ControlFlow::Continue(())).unwrap_err().to_string();
    assert!(text.contains("gain 1") && text.contains("> 0"), "{text}");
}

/// Short of what `omnidrones tune hummingbird` does, long enough to lose margins.
fn short() -> TunePlan {
    TunePlan { n_held_out: 64, iterations: 40, duration: 4.0, ..TunePlan::default() }
}

#[test]
fn tuning_for_error_alone_fails_the_gate_and_says_which_margins_fell() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let tuning = tune(&vehicle, &vehicle.gains(), &short(), &mut |_| ControlFlow::Continue(())).unwrap();
    let judged = MarginGate::default().judge(
        &vehicle,
        &tuning.gains,
        &Physics::default(),
        &Rates::default(),
        &Threads::default(),
    );
    let judged = judged.unwrap();
    println!(
        "{:?} → {:?}; least {:.3}, delay {:.0} ms",
        tuning.margins[0].disk,
        tuning.margins[1].disk,
        judged.least(),
        1e3 * judged.delay
    );
    println!("{:?}", tuning.fallen());
    // measured: disk margin of all commands at hover 0.649 → 0.230, phase 36.8° → 17.8°, delay 42 → 16 ms
    let [before, after] = &tuning.margins;
    assert!(before.disk.alpha > 0.6 && after.disk.alpha < 0.4, "{} {}", before.disk.alpha, after.disk.alpha);
    assert!(!judged.passes && tuning.is_less_robust() && tuning.fallen().len() >= 3);
}

/// Tunes with a gate, from derived gains, and tells how it went.
fn with_gate(name: &str, plan: TunePlan) -> [f64; 3] {
    let vehicle = vehicles::by_name(name).unwrap();
    let clock = std::time::Instant::now();
    let tuning = tune(&vehicle, &vehicle.derived_gains(), &plan, &mut |_| ControlFlow::Continue(())).unwrap();
    let [before, after] = tuning.judged.as_ref().unwrap();
    println!(
        "{name}: {:.4} → {:.4} m; least disk margin {:.3} → {:.3} at {:?}, delay {:.0} → {:.0} ms, in {:.0} s\n{:?}",
        tuning.before.rmse,
        tuning.after.rmse,
        before.least(),
        after.least(),
        after.corners[after.worst].0,
        1e3 * before.delay,
        1e3 * after.delay,
        clock.elapsed().as_secs_f64(),
        tuning.gains
    );
    assert!(after.passes || tuning.gains == vehicle.derived_gains(), "what does not pass is not handed out");
    [tuning.before.rmse, tuning.after.rmse, after.least()]
}

#[test]
fn tuning_with_margins_holds_them_at_every_corner() {
    let gate = MarginGate { speeds: vec![0.0], ..MarginGate::default() };
    let plan = TunePlan { n_held_out: 16, iterations: 20, duration: 2.0, margins: Some(gate), ..TunePlan::default() };
    let [before, after, least] = with_gate("hummingbird", plan);
    // measured: 0.2144 → 0.1901 m while the least margin rises from 0.406 to 0.516, in 14 s
    assert!(least >= 0.5 && after < before, "{before} → {after} m, {least}");
}

/// Minutes: `cargo test --release --test controllers whole_gate -- --ignored --nocapture`.
#[test]
#[ignore = "cargo test --release --test controllers whole_gate -- --ignored --nocapture: minutes"]
fn tuning_through_the_whole_gate_holds_margins_to_ten_metres_a_second() {
    let name = "hummingbird";
    let (vehicle, gate) = (vehicles::by_name(name).unwrap(), MarginGate::default());
    let plan =
        TunePlan { iterations: 20, n_held_out: 4, margins: Some(gate), ..on_a_grid(name, &FlightGrid::default()) };
    let tuning = tune(&vehicle, &vehicle.derived_gains(), &plan, &mut |_| ControlFlow::Continue(())).unwrap();
    let [before, after] = tuning.held_out.unwrap();
    let [first, last] = tuning.judged.as_ref().unwrap();
    println!(
        "held-out cells {:.4} → {:.4} m; least disk margin {:.3} → {:.3} at {:?}, delay {:.0} → {:.0} ms",
        before.rmse,
        after.rmse,
        first.least(),
        last.least(),
        last.corners[last.worst].0,
        1e3 * first.delay,
        1e3 * last.delay
    );
    // measured: cells that were not tuned on 0.1730 → 0.1581 m (8.6 %; published gains 0.1754 m, a margin of 0.206), least margin
    // 0.341 → 0.508 at 10 m/s with 0.7 of the mass and 1.3 of inertia and lag, delay 38 → 32 ms; 71 s of processor time. What
    // is asked of the bench, 20 % less than published gains and 50 ms, is not met with a margin of 0.5.
    assert!(last.passes && last.least() >= 0.5, "{}", last.least());
    assert!(after.crashed == 0 && after.rmse <= 0.93 * before.rmse, "{before:?} {after:?}");
}

/// Tuned on half of a grid, on random plants; judged on the other half and on other plants.
fn on_a_grid(name: &str, grid: &FlightGrid) -> TunePlan {
    let cells = grid.cells(&vehicles::by_name(name).unwrap(), &Physics::default()).unwrap();
    let of = |half| cells.iter().filter(move |c| c.flyable && c.held_out == half).map(GridCell::reference);
    let mut tuned_on: Vec<_> = of(false).collect();
    TunePlan {
        reference: tuned_on.remove(0),
        also: tuned_on,
        held_out: of(true).collect(),
        plant_spread: 0.3,
        duration: 3.0,
        n_held_out: 8,
        ..TunePlan::default()
    }
}

#[test]
fn gains_tuned_on_half_of_a_grid_and_random_plants_are_better_on_the_other_half_and_other_plants() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let grid = FlightGrid { accelerations: vec![2.0, 6.0], speeds: vec![3.0, 6.0], ..FlightGrid::default() };
    let plan = TunePlan { n_start: 16, iterations: 10, duration: 1.5, ..on_a_grid("hummingbird", &grid) };
    let run = || tune(&vehicle, &vehicle.gains(), &plan, &mut |_| ControlFlow::Continue(())).unwrap();
    let tuning = run();
    println!("{:?} → {:?}; held out {:?}", tuning.before, tuning.after, tuning.held_out);
    let [before, after] = tuning.held_out.unwrap();
    assert_eq!((tuning.references.len(), tuning.after.n, after.n, after.crashed), (4, 16, 16, 0));
    assert!(after.rmse < 0.95 * before.rmse && !tuning.is_worse_held_out());
    assert_eq!(tuning, run());
}

#[test]
fn a_grid_names_the_cells_that_leave_too_little_thrust() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let grid = FlightGrid { accelerations: vec![2.0, 40.0], ..FlightGrid::default() };
    let cells = grid.cells(&vehicle, &Physics::default()).unwrap();
    println!("{cells:?}");
    assert!(cells.iter().all(|c| c.flyable == (c.acceleration == 2.0)));
    let none = FlightGrid { accelerations: vec![40.0], ..FlightGrid::default() };
    let text = none.cells(&vehicle, &Physics::default()).unwrap_err().to_string();
    assert!(text.contains("cells that 'hummingbird' can fly") && text.contains("lower"), "{text}");
}
