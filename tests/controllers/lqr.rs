//! Riccati equations, error states and the optimal feedback of drones with swinging loads.

use nalgebra::{DMatrix, RealField, convert};
use num_dual::Dual64;
use omnidrones::autodiff::{System, linearise};
use omnidrones::controllers::design::{ErrorState, bryson, feed_forward, finite_horizon, lqi, lqr, riccati};
use omnidrones::controllers::linear::spectral_radius;
use omnidrones::controllers::reference::{Hover, Lemniscate, Step};
use omnidrones::controllers::{
    self, Controller, Flight, FlightPlan, FormationController, Lqr, Rates, Reference, Setup, default_controller,
};
use omnidrones::dynamics::spatial::from_euler;
use omnidrones::dynamics::tree::Multibody;
use omnidrones::dynamics::{Multirotor, Physics, configurations, vehicles};
use omnidrones::rng::{Purpose, Stream};

type Matrix = DMatrix<f64>;

/// Numbers in [−1, 1].
fn random(rows: usize, columns: usize, stream: &mut Stream) -> Matrix {
    DMatrix::from_fn(rows, columns, |_, _| 2.0 * stream.uniform(0.0, 1.0) - 1.0)
}

fn stream(episode: u64) -> Stream {
    Stream::new(7, 0, episode, Purpose::RESET)
}

fn double_integrator<T: RealField + Copy>(dt: f64) -> [DMatrix<T>; 2] {
    let rows = |values: &[f64], n| DMatrix::from_row_iterator(2, n, values.iter().map(|v| convert(*v)));
    [rows(&[1.0, dt, 0.0, 1.0], 2), rows(&[0.5 * dt * dt, dt], 1)]
}

#[test]
fn a_scalar_plant_has_the_closed_form() {
    let one = |v: f64| Matrix::from_element(1, 1, v);
    let (a, b, q, r) = (1.2_f64, 0.7, 2.0, 0.5);
    // b²x² + (r − a²r − qb²)x − qr = 0
    let p = r - a * a * r - q * b * b;
    let exact = (-p + (p * p + 4.0 * b * b * q * r).sqrt()) / (2.0 * b * b);
    let found = riccati::discrete(&one(a), &one(b), &one(q), &one(r)).expect("solved");
    assert!((found.matrix[0] / exact - 1.0).abs() < 1e-13, "{found:?}");
    // continuous: x = r (a + √(a² + b²q/r))/b²
    let exact = r * (a + (a * a + b * b * q / r).sqrt()) / (b * b);
    let found = riccati::continuous(&one(a), &one(b), &one(q), &one(r)).expect("solved");
    assert!((found.matrix[0] / exact - 1.0).abs() < 1e-13, "{found:?}");
    // x = q/(1 − a²)
    let found = riccati::lyapunov(&one(0.9), &one(q)).expect("solved");
    assert!((found.matrix[0] / (q / (1.0 - 0.81)) - 1.0).abs() < 1e-13, "{found:?}");
}

#[test]
fn a_long_horizon_ends_at_the_regulator_and_a_short_one_costs_what_it_says() {
    let [a, b] = double_integrator::<f64>(0.05);
    let (q, r) = (Matrix::from_diagonal(&vec![4.0, 0.3].into()), Matrix::from_element(1, 1, 0.2));
    let forever = lqr(&a, &b, &q, &r).unwrap();
    let long = finite_horizon(&a, &b, &q, &r, &q, 2000).unwrap();
    let off = (&long.gains[0] - &forever.gain).amax() / forever.gain.amax();
    assert!(off < 1e-12, "{off:e}"); // measured 2.0e-15
    // the cost of flying it, term by term
    let end = 10.0 * &q;
    let short = finite_horizon(&a, &b, &q, &r, &end, 30).unwrap();
    let start = nalgebra::DVector::from_vec(vec![1.0, -0.4]);
    let (mut x, mut cost) = (start.clone(), 0.0);
    for gain in &short.gains {
        let u = -gain * &x;
        cost += (x.transpose() * &q * &x + u.transpose() * &r * &u)[0];
        x = &a * x + &b * u;
    }
    cost += (x.transpose() * end * &x)[0];
    let said = (start.transpose() * &short.cost * &start)[0];
    assert!((cost / said - 1.0).abs() < 1e-12, "{cost} {said}");
}

#[test]
fn integrators_take_away_a_constant_push() {
    let [a, b] = double_integrator::<f64>(0.05);
    let (q, r) = (Matrix::from_diagonal(&vec![4.0, 0.3, 2.0].into()), Matrix::from_element(1, 1, 0.2));
    let position = Matrix::from_row_slice(1, 2, &[1.0, 0.0]);
    let found = lqi(&a, &b, &position, &q, &r, 0.05).unwrap();
    let push = Matrix::from_column_slice(2, 1, &[0.0, 0.03]);
    let (mut x, mut z) = (Matrix::zeros(2, 1), 0.0);
    for _ in 0..2000 {
        let u = -(found.gain.columns(0, 2) * &x)[0] - found.gain[2] * z;
        z += 0.05 * x[0];
        x = &a * x + &b * u + &push;
    }
    let poles = spectral_radius(&found.closed_loop).unwrap();
    println!("{:.1e} m left, radius {poles:.4}", x[0]);
    // measured: 1.4e-16
    assert!(x[0].abs() < 1e-14 && poles < 1.0);
    let wide = Matrix::zeros(1, 3);
    assert!(lqi(&a, &b, &wide, &q, &r, 0.05).unwrap_err().to_string().contains("columns of C"));
}

#[test]
fn value_iteration_ends_where_doubling_does() {
    let [a, b] = double_integrator::<f64>(0.05);
    let (q, r) = (Matrix::from_diagonal(&vec![4.0, 0.3].into()), Matrix::from_element(1, 1, 0.2));
    let found = lqr(&a, &b, &q, &r).expect("solved");
    let mut x = q.clone();
    for _ in 0..5_000 {
        let gain = (&r + b.transpose() * &x * &b).try_inverse().expect("positive") * b.transpose() * &x * &a;
        x = &q + a.transpose() * &x * (&a - &b * gain);
    }
    let error = (&found.cost - &x).norm() / x.norm();
    println!("against value iteration {error:.1e}, {} doublings", found.doublings);
    // measured: 5.6e-16
    assert!(error < 5e-14, "{error:e}");
    // continuous double integrator with unit weights: X = [[√3, 1], [1, √3]]
    let rows = |v: [f64; 4]| Matrix::from_row_slice(2, 2, &v);
    let (a, b) = (rows([0.0, 1.0, 0.0, 0.0]), Matrix::from_column_slice(2, 1, &[0.0, 1.0]));
    let root = 3.0_f64.sqrt();
    let found = riccati::continuous(&a, &b, &Matrix::identity(2, 2), &Matrix::identity(1, 1)).expect("solved");
    assert!((found.matrix - rows([root, 1.0, 1.0, root])).norm() < 1e-12);
}

#[test]
fn random_plants_are_stabilised_with_small_residuals() {
    let (mut worst, mut n_kind) = ([[0.0_f64; 4]; 2], [0; 2]);
    for episode in 0..100 {
        let mut stream = stream(episode);
        let (n, m) = (2 + episode as usize % 9, 1 + episode as usize % 3);
        // spectral radius up to about 2: the modes that grow are reached with probability one
        let (a, b) = (random(n, n, &mut stream), random(n, m, &mut stream));
        let half = random(n, n, &mut stream);
        let (q, r) = (&half * half.transpose(), Matrix::identity(m, m) * 0.3);
        let found = lqr(&a, &b, &q, &r).expect("stabilisable");
        let continuous = riccati::continuous(&a, &b, &q, &r).expect("stabilisable");
        let loop_cost = riccati::lyapunov(&found.closed_loop, &(&q + found.gain.transpose() * &r * &found.gain));
        let same = (loop_cost.expect("stable").matrix - &found.cost).norm() / found.cost.norm();
        let all = [found.residual, continuous.residual, found.poles[0].norm(), same];
        // one of the hundred is all but out of reach of its one input: ‖X‖ = 2.6e7, and rounding alone leaves 2.7e-9
        let kind = usize::from(found.cost.norm() > 1e6);
        n_kind[kind] += 1;
        worst[kind] = [0, 1, 2, 3].map(|k| worst[kind][k].max(all[k]));
    }
    println!("residual, continuous, radius, cost of the loop: {n_kind:?} {worst:?}");
    assert_eq!(n_kind, [99, 1]);
    // measured: 9.2e-13, 1.2e-10, 0.955, 7.9e-12
    assert!(worst[0][0] < 8e-11 && worst[0][1] < 1e-9 && worst[0][2] < 1.0 && worst[0][3] < 6e-10, "{worst:?}");
    // measured: 2.7e-9, 1.8e-15, 0.887
    assert!(worst[1][0] < 1e-8 && worst[1][1] < 2e-13 && worst[1][2] < 1.0, "{worst:?}");
}

#[test]
fn the_derivative_of_the_solution_by_duals_meets_differences() {
    let (q, r) = ([4.0, 0.3], Matrix::from_element(1, 1, 0.2));
    let [a, b] = double_integrator::<f64>(0.05);
    let solve = |first: f64| {
        let q = Matrix::from_diagonal(&vec![first, q[1]].into());
        riccati::discrete(&a, &b, &q, &r).expect("solved").matrix
    };
    let difference = (solve(q[0] + 1e-4) - solve(q[0] - 1e-4)) / 2e-4;
    let [a, b] = double_integrator::<Dual64>(0.05);
    let mut weight = DMatrix::from_diagonal(&vec![q[0], q[1]].into()).map(Dual64::from);
    weight[(0, 0)].eps = 1.0;
    let exact = riccati::discrete(&a, &b, &weight, &r.map(Dual64::from)).expect("solved").matrix.map(|v| v.eps);
    let error = (&exact - &difference).norm() / difference.norm();
    println!("dX/dQ against differences {error:.1e}");
    // measured: 1.9e-11
    assert!(error < 1e-9, "{error:e}");
}

#[test]
fn what_cannot_be_stabilised_is_named_with_a_remedy() {
    let diagonal = |v: &[f64]| Matrix::from_diagonal(&v.to_vec().into());
    let b = Matrix::from_column_slice(2, 1, &[0.0, 1.0]);
    let one = Matrix::identity(1, 1);
    let says = |a: &Matrix, q: &Matrix, r: &Matrix| lqr(a, &b, q, r).expect_err("refused").to_string();
    let (unit, stable) = (Matrix::identity(2, 2), diagonal(&[0.5, 0.5]));
    for (text, words) in [
        (says(&diagonal(&[1.1, 0.5]), &unit, &one), "reached by an input"),
        (says(&diagonal(&[0.5, 1.1]), &diagonal(&[1.0, 0.0]), &one), "seen by Q"),
        (says(&stable, &diagonal(&[1.0, -1.0]), &one), "positive semi-definite"),
        (says(&stable, &unit, &-&one), "positive definite"),
        (says(&stable, &diagonal(&[1.0, f64::NAN]), &one), "finite"),
        (says(&stable, &Matrix::identity(3, 3), &one), "2 × 2"),
        (bryson(&[1.0, 0.0]).expect_err("refused").to_string(), "infinity"),
    ] {
        assert!(text.contains(words), "{text}");
    }
}

#[test]
fn following_a_polynomial_needs_no_feedback() {
    let [a, b] = double_integrator::<f64>(0.1);
    let found = feed_forward(&a, &b, &Matrix::from_row_slice(1, 2, &[1.0, 0.0]), 0.1, 3).expect("followed");
    let mut z = Matrix::from_column_slice(3, 1, &[0.3, -0.2, 0.5]);
    let mut x = &found.state * &z;
    for _ in 0..100 {
        x = &a * x + &b * (&found.input * &z);
        z = &found.advance * z;
        assert!((x[0] - z[0]).abs() < 1e-11 * z[0].abs().max(1.0));
    }
}

fn robot(name: &str) -> Multibody {
    Multibody::new(&configurations::by_name(name).expect("known"), Physics::default()).expect("valid")
}

#[test]
fn the_error_state_goes_there_and_back_and_linearises_as_differences_say() {
    let system = robot("payload");
    let errors = ErrorState::of(&system);
    assert_eq!((errors.n_error(), errors.place(6), errors.place(9), errors.place(10)), (20, 6, 8, 9));
    let mut stream = stream(0);
    let mut state = system.rest_state();
    state[6..10].copy_from_slice(&from_euler(0.3, -0.2, 0.9));
    let error = random(20, 1, &mut stream);
    let moved = errors.moved(&state, error.as_slice());
    assert!((errors.difference(&moved, &state) - error.column(0)).norm() < 1e-13);
    let round = errors.cotangent(&state) * errors.tangent(&state);
    assert!((round - Matrix::identity(20, 20)).norm() < 1e-14);

    let input = vec![0.2; system.n_input()];
    let (a, _) = errors.reduce(&state, &linearise(&system, &state, &input, &[]));
    let step = |delta: &[f64]| {
        let mut next = state.clone();
        system.step(&errors.moved(&state, delta), &input, &[], &mut next);
        next
    };
    let (base, h) = (step(&[0.0; 20]), 1e-6);
    let column = |k: usize| {
        let mut delta = [0.0; 20];
        delta[k] = h;
        let ahead = errors.difference(&step(&delta), &base);
        delta[k] = -h;
        (ahead - errors.difference(&step(&delta), &base)) / (2.0 * h)
    };
    let worst = (0..20).map(|k| (a.column(k) - column(k)).norm()).fold(0.0, f64::max);
    println!("A of the error against differences {worst:.1e}");
    // per column, SI units; measured: 6.1e-8
    assert!(worst < 3e-7, "{worst:e}");
}

#[test]
fn every_vehicle_has_a_feedback_of_its_rotors() {
    let physics = Physics::default();
    let mut worst = [0.0_f64; 2];
    for vehicle in vehicles::all() {
        let plant = Multirotor::new(&vehicle, physics).expect("valid");
        let (state, input) = (plant.hover_state([0.0; 3]).expect("hovers"), plant.hover_input().expect("hovers"));
        let errors = ErrorState::rigid(plant.n_state()).expect("rigid");
        let (a, b) = errors.reduce(&state, &linearise(&plant, &state, &input, &[]));
        let mut most = vec![f64::INFINITY; errors.n_error()];
        most[..3].fill(0.1);
        most[8] = 0.2;
        let r = bryson(&vec![0.5; b.ncols()]).expect("positive");
        let found =
            lqr(&a, &b, &bryson(&most).expect("positive"), &r).unwrap_or_else(|e| panic!("{}: {e}", vehicle.name));
        worst = [worst[0].max(found.residual), worst[1].max(found.poles[0].norm())];
    }
    println!("worst residual {:.1e}, radius {:.5}", worst[0], worst[1]);
    // measured: 8.0e-15, 0.998
    assert!(worst[0] < 8e-13 && worst[1] < 1.0, "{worst:?}");
}

fn start_on(system: &Multibody, controller: &dyn Controller, reference: &Reference) -> Vec<f64> {
    controllers::start_on(&system.clone().into(), controller, reference).unwrap()
}

fn controller_for(system: &Multibody, rates: &Rates) -> Box<dyn Controller> {
    default_controller(&system.clone().into(), &Setup::new(None, rates)).unwrap()
}

fn flown(
    system: &Multibody,
    controller: &mut dyn Controller,
    reference: Reference,
    duration: f64,
    start: &[f64],
) -> Flight {
    let plan = FlightPlan { reference, duration, physics: *system.physics(), ..FlightPlan::default() };
    controllers::fly_from(&system.clone().into(), controller, &plan, start, &mut |_| {}).expect("a valid plan")
}

/// RMSE from 2 s on along a reference, m.
fn rmse(system: &Multibody, mut controller: Box<dyn Controller>, reference: &Reference) -> f64 {
    let start = start_on(system, controller.as_ref(), reference);
    let flight = flown(system, controller.as_mut(), reference.clone(), 15.0, &start);
    flight.log.rmse(2.0).filter(|_| flight.diverged_at.is_none()).unwrap_or(f64::INFINITY)
}

/// The drone's cascade alone, and the optimal feedback.
fn pilots(system: &Multibody) -> [Box<dyn Controller>; 2] {
    let rates = Rates::default();
    let new = controller_for(system, &rates);
    assert_eq!(new.name(), "lqr");
    [Box::new(FormationController::new(system, None, &rates).expect("flies")), new]
}

#[test]
fn optimal_feedback_tracks_closer_than_the_cascade_alone() {
    let lemniscate =
        |rate| Reference::Lemniscate(Lemniscate { rate, origin: [0.0, 0.0, 4.0], ..Lemniscate::default() });
    let step = Reference::Step(Step { from: [0.0, 0.0, 4.0], to: [1.0, 0.0, 4.0], time: 5.0, ..Step::default() });
    for (name, reference, limit) in [
        // measured: 26.3 → 12.7 mm
        ("payload", lemniscate(0.5), 0.015),
        // measured: 109 → 9.3 mm
        ("inverted_pendulum", lemniscate(0.5), 0.011),
        // measured: 216 → 154 mm
        ("payload", lemniscate(1.0), 0.18),
        // measured: 227 → 131 mm
        ("inverted_pendulum", lemniscate(1.0), 0.16),
        // measured: 247 → 73 mm: the step is seen ahead
        ("inverted_pendulum", step, 0.09),
    ] {
        let system = robot(name);
        let [old, new] = pilots(&system).map(|controller| rmse(&system, controller, &reference));
        println!("{name} {}: {old:.4} → {new:.4} m", reference.name());
        assert!(new < limit && (new < old || !old.is_finite()), "{name}: {old} → {new}");
    }
}

#[test]
fn loads_come_to_rest_from_fifty_random_starts() {
    let point = [0.0, 0.0, 4.0];
    let reference = Reference::Hover(Hover { position: point, yaw: 0.0 });
    // measured: 5.8 mm and less than 0.05 mm after 8 s, 1.43 m at the farthest
    for (name, limit) in [("payload", 0.02), ("inverted_pendulum", 1e-4)] {
        let system = robot(name);
        let controller = Lqr::new(&system, None, &Rates::default()).expect("designed");
        assert!(controller.regulator().residual < 1e-10 && controller.regulator().poles[0].norm() < 1.0);
        assert!(spectral_radius(&controller.regulator().closed_loop).expect("finite") < 1.0);
        let rest = start_on(&system, &controller, &reference);
        let swing = system.layout().bodies[1].position;
        let (mut worst, mut farthest) = (0.0_f64, 0.0_f64);
        for episode in 0..50 {
            let mut stream = stream(episode);
            let mut within = |most: f64| most * (2.0 * stream.uniform(0.0, 1.0) - 1.0);
            let mut start = rest.clone();
            for k in 0..3 {
                start[k] += within(0.5);
                start[3 + k] += within(0.3);
            }
            // the whole robot leans, and the load up to 4° more
            let (lean, more) = (10_f64.to_radians(), 4_f64.to_radians());
            start[6..10].copy_from_slice(&from_euler(within(lean), within(lean), within(lean)));
            start[swing] += within(more);
            start[swing + 1] += within(more);
            let flight = flown(&system, &mut controller.clone(), reference.clone(), 8.0, &start);
            assert_eq!(flight.diverged_at, None, "{name} {episode}");
            let off = |x: &[f64]| (x[0] - point[0]).hypot(x[1] - point[1]).hypot(x[2] - point[2]);
            worst = worst.max(off(&flight.states[flight.states.len() - rest.len()..]));
            farthest = flight.states.chunks_exact(rest.len()).map(off).fold(farthest, f64::max);
        }
        println!("{name}: after 8 s within {worst:.4} m, farthest {farthest:.2} m");
        assert!(worst < limit && farthest < 2.0, "{name}: {worst} {farthest}");
    }
}
