use super::super::{FirstGuess, ProblemFile};
use super::*;

fn solved(course: &super::super::CourseProblem, guess: FirstGuess) -> (Ilqr, IlqrReport) {
    let mut search = Ilqr::new(&course.problem).unwrap();
    match guess {
        FirstGuess::Hover => search.start_from_inputs(&course.problem, &course.guess.inputs).unwrap(),
        FirstGuess::Line => search.start_from(&course.problem, &course.guess).unwrap(),
    }
    let report = search.solve(&course.problem, &course.settings, |_, _| {}).unwrap();
    (search, report)
}

#[test]
fn problems_that_are_built_in_are_solved_from_flights_and_from_lines_that_nobody_can_fly() {
    for (name, _) in ProblemFile::built_in() {
        let course = ProblemFile::by_name(name).unwrap();
        for guess in [FirstGuess::Hover, FirstGuess::Line] {
            let (search, report) = solved(&course, guess);
            let n = report.iterations.len();
            println!("{name} from {guess:?}: {n} iterations, {:.9}, violated by {:.1e}", report.cost, report.violation);
            assert_eq!(report.status, IlqrStatus::Solved, "{name}");
            assert!(report.gap < 1e-12 && report.violation <= 1e-6, "{name}: {report:?}");
            // measured: 25 at most, and 45 of a flip from hover, which does not find the full turn
            assert!(n <= 50, "{name}: {n} iterations");
            for k in 0..course.problem.n_stage() {
                let (lower, upper) = course.problem.bounds(k);
                let m = lower.len();
                let own = &search.trajectory().inputs[k * m..(k + 1) * m];
                assert!((0..m).all(|i| own[i] >= lower[i] && own[i] <= upper[i]), "{name}, stage {k}: {own:?}");
            }
        }
    }
}

#[test]
fn the_flip_turns_once_over() {
    let (search, _) = solved(&ProblemFile::by_name("flip").unwrap(), FirstGuess::Line);
    let attitudes: Vec<&[f64]> = search.trajectory().states.chunks_exact(17).map(|x| &x[6..10]).collect();
    let upright = attitudes.iter().map(|q| 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])).fold(1.0, f64::min);
    assert!(upright < -0.99, "{upright}");
    // the quaternion ends with the other sign: half of its full turn
    assert!(attitudes[0][0] * attitudes[attitudes.len() - 1][0] < -0.99);
}

/// Costs of the flights with bounded thrusts are those of CasADi with IPOPT and Newton's method on the active set, and those that crocoddyl
/// 3.2.1 comes to, rolled out by our step and cost: it weighs a stage at the nodes of its integrator. Without bounds but those of rotors, which
/// do not pull down.
#[test]
fn the_flight_from_point_to_point_costs_no_more_than_with_other_tools() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../crates/bench/rivals/problems/");
    for (name, optimum, other) in [
        ("point_to_point_bounded", Some(0.006657889760796726), 0.006665836966168678),
        ("point_to_point_bounded_50", Some(0.00670493460677288), 0.006712824611656561),
        ("point_to_point_free", None, 0.005458066824372495),
        ("point_to_point_free_50", None, 0.03898500159775757),
    ] {
        let course = ProblemFile::open(format!("{folder}{name}.toml")).unwrap();
        let (_, report) = solved(&course, FirstGuess::Line);
        let n = report.iterations.len();
        let off = optimum.map(|optimum| report.cost / optimum - 1.0);
        println!("{name}: {:?}, {:.10} after {n} iterations, off the optimum by {off:?}", report.status, report.cost);
        assert_eq!(report.status, IlqrStatus::Solved);
        assert!(report.cost < other && off.is_none_or(|off| off.abs() < 1e-6), "{name}: {}, {off:?}", report.cost);
        // measured: at most 8
        assert!(n <= 12, "{name}: {n}");
    }
}

/// The problem of `crates/bench/rivals/problems/hummingbird_speed_equal_lags.toml`; its optimum is that of CasADi with IPOPT and of Newton's
/// method on the active set, both with a model of their own, to 1e-13.
#[test]
fn the_optimum_is_that_of_a_solver_with_a_model_of_its_own() {
    let text = r#"
        vehicle = "hummingbird"
        steps = 20
        dt = 0.05
        [start]
        position = [0.6, -0.64, 0.48]
        velocity = [1.0, -0.5, 0.3]
        attitude = [0.9659258262890683, 0.15529142706151244, 0.2070552360820166, 0.0]
        angular_velocity = [0.5, -0.3, 0.2]
        [stage]
        position = 200.0
        velocity = 1.0
        attitude = [5.0, 5.0, 200.0]
        angular_velocity = 1.0
        input = 6.0
        [terminal]
        position = 2000.0
        velocity = 10.0
        attitude = [50.0, 50.0, 2000.0]
        angular_velocity = 10.0
    "#;
    let course = ProblemFile::from_toml_str(text, "equal lags").unwrap().problem(None).unwrap();
    let (_, report) = solved(&course, FirstGuess::Line);
    let error = report.cost / 84.06195720762548 - 1.0;
    println!("{:?}, off by {error:.1e} after {} iterations", report.status, report.iterations.len());
    assert_eq!(report.status, IlqrStatus::Solved);
    // measured: 1.7e-10, and 8 iterations
    assert!(error.abs() < 1e-8 && report.iterations.len() <= 12);
}

/// One step x₁ = x₀ + u with ½u² and a soft bound x₁ ≥ 1 of weight 1000 from x₀ = 0: u = 1000/1001.
#[test]
fn a_soft_bound_that_acts_is_weighed_against_what_it_costs() {
    use super::super::{OptimalCost, SoftBound, StageInput, StageModel, Terms};
    use autodiff::{Scalar, System};
    struct Move;
    impl System for Move {
        fn n_state(&self) -> usize {
            1
        }
        fn n_input(&self) -> usize {
            1
        }
        fn step<S: Scalar>(&self, x: &[S], u: &[S], _: &[S], next: &mut [S]) {
            next[0] = x[0] + u[0];
        }
    }
    struct Effort;
    impl OptimalCost for Effort {
        fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>) {
            terms.square(S::one(), now.input[0]);
        }
    }
    let errors = crate::design::ErrorState::new(1, &[]).unwrap();
    let model = StageModel::new(&Move, &Effort, errors).unwrap();
    let mut problem = OptimalProblem::new(std::sync::Arc::new(model), 1, &[0.0]).unwrap();
    let bound = SoftBound { state: 0, lower: 1.0, upper: f64::INFINITY, weight: 1000.0 };
    problem.set_soft_bounds(&[bound]).unwrap();
    let twice = problem.set_soft_bounds(&[bound, bound]).unwrap_err().to_string();
    assert!(twice.contains("bounded once"), "{twice}");
    let mut search = Ilqr::new(&problem).unwrap();
    for guess in [0.0, 5.0, -3.0] {
        search.start_from_inputs(&problem, &[guess]).unwrap();
        let report = search.solve(&problem, &IlqrSettings::default(), |_, _| {}).unwrap();
        let u = search.trajectory().inputs[0];
        println!("from {guess}: {u} after {} iterations", report.iterations.len());
        assert!(report.status == IlqrStatus::Solved && (u - 1000.0 / 1001.0).abs() < 1e-9, "{report:?}");
    }
}

#[test]
fn gains_along_a_trajectory_bring_deviations_back() {
    let course = ProblemFile::by_name("slalom").unwrap();
    let (search, _) = solved(&course, FirstGuess::Line);
    let (problem, gains, plan) = (&course.problem, search.gains(), search.trajectory());
    let (n, m, errors) = (problem.model().n_state(), problem.model().n_input(), problem.model().errors());
    let mut expansion = StageExpansion::new(problem).unwrap();
    let mut fly = |feedback: f64| {
        let mut state = plan.states[..n].to_vec();
        (state[0], state[1]) = (state[0] + 0.05, state[1] - 0.05);
        for k in 0..problem.n_stage() {
            let error = errors.difference(&state, &plan.states[k * n..(k + 1) * n]);
            let turn = &gains[k] * error * feedback;
            let input: Vec<f64> = (0..m).map(|i| plan.inputs[k * m + i] + turn[i]).collect();
            expansion.evaluate(problem, k, &state, &input);
            state.copy_from_slice(&expansion.work.single_results[..n]);
        }
        errors.difference(&state, &plan.states[plan.states.len() - n..]).rows(0, 3).norm()
    };
    let (with, without) = (fly(1.0), fly(0.0));
    println!("{with:.1e} m off at the end with feedback, {without:.1e} m without");
    assert!(with < 1e-3 && without > 0.03);
}
