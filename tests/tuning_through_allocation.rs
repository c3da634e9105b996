//! Gradients put to use through a bounded allocation: six-axis gains, null-space weight and tilt horizon of an Omav.

use omnidrones::autodiff::{Rollout, System};
use omnidrones::controllers::allocation::wrench_matrix;
use omnidrones::controllers::design::tilting::{N_INPUT, N_PARAMETER, PoseError};
use omnidrones::controllers::design::{Tilting, TiltingPlan, TiltingTuning, tune_tilting};
use omnidrones::dynamics::configurations::Omav;
use omnidrones::dynamics::{Integrator, Physics};
use std::time::Instant;

/// 5 ms, semi-implicit.
fn system() -> Tilting {
    let physics = Physics { dt: 0.005, integrator: Integrator::SemiImplicit, ..Physics::default() };
    Tilting::new(&Omav::default(), physics).unwrap()
}

/// A short flight.
fn plan() -> TiltingPlan {
    TiltingPlan { duration: 1.5, n_start: 4, iterations: 12, ..TiltingPlan::default() }
}

/// A state in motion, its input, and θ.
fn moment(system: &Tilting) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let (plan, theta) = (plan(), system.nominal().to_vec());
    let (inputs, mut x) = (plan.inputs(system).unwrap(), plan.training(system).swap_remove(0));
    let mut next = x.clone();
    let rows: Vec<&[f64]> = inputs.chunks_exact(system.n_input()).collect();
    for u in &rows[..60] {
        system.step(&x, u, &theta, &mut next);
        std::mem::swap(&mut x, &mut next);
    }
    (x, rows[60].to_vec(), theta)
}

#[test]
fn the_columns_are_those_of_the_true_geometry_and_its_slope_over_every_tilt() {
    let system = system();
    let (x, _, _) = moment(&system);
    let (plant, columns) = (system.plant(), system.columns(&x));
    let rotors = plant.model().rotors();
    let thrusts = |x: &[f64]| {
        let speeds = plant.layout().rotor_speed.iter().zip(rotors);
        nalgebra::DVector::from_iterator(12, speeds.map(|(at, r)| r.rotor.thrust_coefficient * x[*at] * x[*at]))
    };
    let (h, share) = (1e-6, plant.model().mass() * plant.model().parts().gravity / 6.0);
    let (mut direct, mut slope, mut largest) = (0.0_f64, 0.0_f64, 0.0_f64);
    let matrix = wrench_matrix(plant, &x);
    let units: Vec<usize> = (0..6).map(|j| plant.model().body(&format!("unit_{j}")).unwrap()).collect();
    for (j, unit) in units.into_iter().enumerate() {
        let own: Vec<usize> = (0..12).filter(|r| rotors[*r].body == unit).collect();
        let at = plant.layout().bodies[unit].position;
        let turned = |by: f64| {
            let mut y = x.clone();
            y[at] += by;
            // equal thrusts of now
            let mean = own.iter().map(|r| thrusts(&x)[*r]).sum::<f64>() / 2.0;
            let matrix = wrench_matrix(plant, &y);
            (matrix.column(own[0]) + matrix.column(own[1])) * (mean / share)
        };
        let difference = (turned(h) - turned(-h)) / (2.0 * h);
        for k in 0..6 {
            direct = direct.max((columns[j][k] - 0.5 * (matrix[(k, own[0])] + matrix[(k, own[1])])).abs());
            slope = slope.max((columns[6 + j][k] - difference[k]).abs());
            largest = largest.max(difference[k].abs());
        }
    }
    println!("direct {direct:.1e}, slope {slope:.1e} of {largest:.2}");
    assert!(direct < 1e-12 && slope < 1e-8 && largest > 0.5, "{direct:e} {slope:e}");
}

#[test]
fn the_gradient_through_the_allocation_is_its_dual_gradient_and_that_of_central_differences() {
    let (system, plan) = (system(), plan());
    let (inputs, starts) = (plan.inputs(&system).unwrap(), plan.training(&system));
    let (m, theta) = (system.n_input(), system.nominal().to_vec());
    let inputs = &inputs[..120 * m];
    let rollout = Rollout::new(system.clone(), PoseError::over(&system, 120)).unwrap();
    let start = &starts[0];
    let states = rollout.trajectory(start, inputs, &theta);
    let (mut thrusts, mut tilts) = (0, 0);
    for (x, u) in states.chunks_exact(system.n_state()).zip(inputs.chunks_exact(m)) {
        let [a, b] = system.n_bound(x, u, &theta);
        (thrusts, tilts) = (thrusts + a, tilts + b);
    }
    let clock = Instant::now();
    let (cost, reverse) = rollout.gradient(start, inputs, &theta);
    let reverse_time = clock.elapsed();
    let (same, forward) = rollout.gradient_forward(start, inputs, &theta);
    let size = forward.parameters.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
    let gap = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let witness = gap(&reverse.parameters, &forward.parameters) / size;
    let h = 1e-5;
    let central: Vec<f64> = (0..N_PARAMETER)
        .map(|k| {
            let cost = |s: f64| {
                let mut moved = theta.clone();
                moved[k] += s * h;
                rollout.cost(start, inputs, &moved)
            };
            (cost(1.0) - cost(-1.0)) / (2.0 * h)
        })
        .collect();
    let difference = gap(&reverse.parameters, &central) / size;
    println!("adjoint {} instructions, {reverse_time:.1?} over 120 steps", rollout.adjoint_len());
    println!("on bounds: thrusts {thrusts}, tilts {tilts} of {}", 120 * N_INPUT / 2);
    println!("cost {cost:.4e}, reverse against forward {witness:.1e}, against differences {difference:.1e}");
    println!("gradient {:?}", reverse.parameters);
    assert_eq!(cost, same);
    assert!(witness < 1e-9 && difference < 1e-5, "{witness:e} {difference:e}");
}

fn report(tuning: &TiltingTuning, theta: &[f64]) {
    for (i, step) in tuning.history.iter().enumerate().step_by(4) {
        println!("{i:3}  root cost {:.4} m, gradient {:.4} m", step.rmse, step.gradient_norm);
    }
    println!("before {:?}\nafter  {:?}", tuning.before, tuning.after);
    println!("from {:?}\nto   {:?}", TiltingTuning::readable(theta), TiltingTuning::readable(&tuning.theta));
}

#[test]
fn a_short_descent_through_the_allocation_lowers_the_held_out_cost() {
    let (system, clock) = (system(), Instant::now());
    let tuning = tune_tilting(&system, &plan(), &mut |_| {}).unwrap();
    report(&tuning, system.nominal());
    println!("{:.1?}", clock.elapsed());
    assert_eq!((tuning.before.n, tuning.before.lost, tuning.after.lost), (32, 0, 0));
    assert!(tuning.after.root_cost < 0.9 * tuning.before.root_cost);
}

/// `cargo test --release --test tuning_through_allocation -- --ignored --nocapture`
#[test]
#[ignore = "minutes"]
fn a_long_descent_through_the_allocation_lowers_the_held_out_cost() {
    let (system, clock) = (system(), Instant::now());
    let tuning = tune_tilting(&system, &TiltingPlan::default(), &mut |_| {}).unwrap();
    report(&tuning, system.nominal());
    println!("{:.1?}", clock.elapsed());
    assert_eq!((tuning.after.n, tuning.after.lost), (32, 0));
    assert!(tuning.after.root_cost < 0.8 * tuning.before.root_cost);
}
