//! Optimal control under hostile states, problems and numbers: it ends, within its bounds, and says truly how.
//!
//! What counts as solved is judged by walks of their own, in plain loops over matrices: they share no line with the solver.

use nalgebra::{DMatrix, DVector};
use omnidrones::autodiff::{Scalar, System, linearise};
use omnidrones::controllers::controller::{Controller, Measurement, Target};
use omnidrones::controllers::design::ErrorState;
use omnidrones::controllers::optimal::{
    Ilqr, IlqrSettings, IlqrStatus, Mpc, MpcSettings, OptimalCost, OptimalProblem, OptimalTrajectory, PlannedIndi,
    PlannedInput, PlannedPlant, QpSettings, QpSolver, QpStatus, SoftBound, StageInput, StageModel, StageQp, Terms,
    TrackingWeights,
};
use omnidrones::controllers::reference::{Circle, Ellipse, Hover, Reference, Waypoints};
use omnidrones::controllers::registry::{Setup, controller};
use omnidrones::controllers::{Rates, default_controller};
use omnidrones::dynamics::{Physics, Plant, vehicles};
use omnidrones::error::{Error, Result};
use omnidrones::rng::{Purpose, Stream};
use std::sync::Arc;

fn drawn(seed: u64) -> Stream {
    Stream::new(seed, 0, 0, Purpose::TASK)
}

/// Of a stage: slopes and curvatures by inputs, and how both go on to the stage before.
struct Walk {
    costate: DVector<f64>,
    cost_to_go: DMatrix<f64>,
}

impl Walk {
    /// The slopes and the diagonal of the curvature by the inputs `u`; those that no bound keeps are then taken for optimal.
    fn back(
        &mut self,
        [a, b]: [&DMatrix<f64>; 2],
        [q, s, r]: [&DMatrix<f64>; 3],
        [by_state, by_input]: [&DVector<f64>; 2],
        (u, lower, upper): (&[f64], &[f64], &[f64]),
    ) -> (DVector<f64>, Vec<f64>) {
        let slope = by_input + b.tr_mul(&self.costate);
        let p = &self.cost_to_go;
        let (rt, st) = (r + b.tr_mul(&(p * b)), s + b.tr_mul(&(p * a)));
        let mut qt = q + a.tr_mul(&(p * a));
        let mut costate = by_state + a.tr_mul(&self.costate);
        let is_free = |i: &usize| {
            let next = u[*i] - newton_step(slope[*i], rt[(*i, *i)]);
            [u[*i], next].iter().all(|u| lower[*i] < *u && *u < upper[*i])
        };
        let free: Vec<usize> = (0..u.len()).filter(is_free).collect();
        if !free.is_empty() {
            let rows = |m: &DMatrix<f64>| DMatrix::from_fn(free.len(), m.ncols(), |i, j| m[(free[i], j)]);
            let own = DMatrix::from_fn(free.len(), free.len(), |i, j| rt[(free[i], free[j])]);
            if let Some(factor) = own.cholesky() {
                qt -= rows(&st).tr_mul(&factor.solve(&rows(&st)));
                let pushed = DVector::from_fn(free.len(), |i, _| slope[free[i]]);
                costate -= rows(&st).tr_mul(&factor.solve(&pushed));
            }
        }
        self.costate = costate;
        self.cost_to_go = 0.5 * (&qt + qt.transpose());
        (slope, rt.diagonal().iter().copied().collect())
    }
}

/// g/d of one input.
fn newton_step(slope: f64, curvature: f64) -> f64 {
    if curvature > 0.0 { slope / curvature } else { slope }
}

/// u − P(u − g/d).
fn projected_step(u: f64, slope: f64, curvature: f64, [lower, upper]: [f64; 2]) -> f64 {
    u - (u - newton_step(slope, curvature)).max(lower).min(upper)
}

/// How far a solution of a program is from its conditions of optimality: of its inputs in shares of their ranges, of its states in shares
/// of what the dynamics adds up. States are the solver's: rolled out anew from inputs alone, an unstable flight shows rounding times its
/// growth.
fn distance_of_program(qp: &StageQp, solver: &QpSolver) -> f64 {
    let stages = qp.n_stage();
    let of = |numbers: &[f64]| DVector::from_column_slice(numbers);
    let states: Vec<DVector<f64>> = (0..=stages).map(|k| of(solver.state(k))).collect();
    let input = |k: usize| of(solver.input(k));
    let mut worst: f64 = 0.0;
    for k in 0..stages {
        let (a, b, c) = qp.dynamics(k);
        let added = a.abs() * states[k].abs() + b.abs() * input(k).abs() + c.abs();
        let off = a * &states[k] + b * input(k) + c - &states[k + 1];
        let own = off.iter().zip(&added).map(|(off, added)| off.abs() / (1.0 + added));
        worst = own.fold(worst, |worst, own| if own <= worst { worst } else { own });
        assert!(qp.soft_bounds(k).is_empty());
    }
    let ([q, ..], [slope, _]) = qp.cost(stages);
    let mut walk = Walk { costate: &q * &states[stages] + slope, cost_to_go: q };
    for k in (0..stages).rev() {
        let ((a, b, _), ([q, s, r], [by_state, by_input]), (lower, upper)) = (qp.dynamics(k), qp.cost(k), qp.bounds(k));
        let (x, u) = (&states[k], input(k));
        let slopes = [&q * x + s.tr_mul(&u) + by_state, &s * x + &r * &u + by_input];
        let at = (u.as_slice(), lower, upper);
        let (slope, curvature) = walk.back([&a, &b], [&q, &s, &r], [&slopes[0], &slopes[1]], at);
        for i in 0..u.len() {
            assert!(lower[i] <= u[i] && u[i] <= upper[i], "{} within [{}, {}]", u[i], lower[i], upper[i]);
            let moved = projected_step(u[i], slope[i], curvature[i], [lower[i], upper[i]]).abs();
            let range = upper[i] - lower[i];
            let own = if range.is_finite() { moved / range.max(f64::MIN_POSITIVE) } else { moved };
            worst = if own <= worst { worst } else { own };
        }
    }
    worst
}

/// A state far from everything, now and then with numbers that are none.
fn hostile_state(draw: &mut Stream, max_speed: f64) -> Vec<f64> {
    let mut state: Vec<f64> = Vec::new();
    for half in [50.0, 20.0] {
        state.extend((0..3).map(|_| draw.uniform(-half, half)));
    }
    let turn: Vec<f64> = (0..4).map(|_| draw.normal()).collect();
    let length = turn.iter().map(|x| x * x).sum::<f64>().sqrt();
    state.extend(turn.iter().map(|x| x / length));
    state.extend((0..3).map(|_| draw.uniform(-30.0, 30.0)));
    state.extend((0..4).map(|_| draw.uniform(-0.5, 1.5) * max_speed));
    let at = draw.below(17) as usize;
    match draw.below(24) {
        0 => state[at] = f64::NAN,
        1 => state[at] = f64::INFINITY,
        2 => state[at] = f64::NEG_INFINITY,
        3 => state[at] = 1e300,
        4 => state[at] = -1e300,
        5 => state[6..10].fill(0.0),
        6 => state[6..10].iter_mut().for_each(|q| *q *= 10.0),
        _ => {}
    }
    state
}

fn hostile_reference(draw: &mut Stream) -> Reference {
    let mut place = || [0; 3].map(|_| draw.uniform(-50.0, 50.0));
    let (center, other) = (place(), place());
    match draw.below(5) {
        0 => Reference::Hover(Hover { position: center, ..Hover::default() }),
        1 => Reference::Circle(Circle::default()),
        // it ends behind 8 s
        2 => Reference::Waypoints(Waypoints::default()),
        _ => Reference::Ellipse(Ellipse {
            center,
            half_axes: [1.0 + other[0].abs(), 1.0 + other[1].abs()],
            rate: draw.uniform(0.1, 3.0),
            spin_up: 1.0,
            standing: draw.below(2) == 0,
            yaw: draw.uniform(-3.0, 3.0),
        }),
    }
}

#[derive(Debug, Default)]
struct Fared {
    ticks: u64,
    failed: u64,
    solved: u64,
    worst: f64,
}

/// Flies through so many ticks of hostile states, and judges each.
fn fly_through(mut mpc: Mpc, plant: &Plant, n_tick: usize, seed: u64) -> Fared {
    let mut draw = drawn(seed);
    let max_speed = plant.rotor_places()[0].max_speed;
    let mut reference = hostile_reference(&mut draw);
    let (mut state, mut time) = (plant.hover_state().unwrap(), 0.0);
    let mut commands = vec![0.0; plant.n_input()];
    let mut fared = Fared::default();
    for tick in 0..n_tick {
        if draw.below(2) == 0 || !state.iter().all(|x| x.abs() < 1e4) {
            state = hostile_state(&mut draw, max_speed);
        } else {
            let before = state.clone();
            plant.step(&before, &commands, &[], &mut state);
        }
        if draw.below(20) == 0 {
            reference = hostile_reference(&mut draw);
        }
        time = if draw.below(30) == 0 { draw.uniform(-10.0, 1e3) } else { time + plant.physics().dt };
        let before = mpc.statistics().recursions;
        mpc.tick(Measurement { time, state: &state, readings: &[] }, Target::level(&reference), &mut commands);
        assert!(commands.iter().all(|c| (-1.0..=1.0).contains(c)), "tick {tick}: {commands:?} from {state:?}");
        fared.ticks += 1;
        let own = mpc.statistics();
        let planned = own.recursions > before;
        let last = mpc.last().filter(|_| planned);
        if !last.is_some_and(|report| report.is_planned) {
            fared.failed += 1;
        }
        assert_eq!((own.ticks, own.kept + own.fallen_back), (fared.ticks, fared.failed), "tick {tick}: {last:?}");
        if last.is_some_and(|report| report.is_planned && report.qp.status == QpStatus::Solved) {
            fared.solved += 1;
            let left = distance_of_program(mpc.iteration().program(), mpc.iteration().solver());
            fared.worst = fared.worst.max(left);
            assert!(left <= 1e-6, "tick {tick}: {left:e}, told {:?}, from {state:?}", last.unwrap());
        }
    }
    fared
}

fn hostile_ticks(n_tick: usize) {
    let plant =
        Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), Physics { dt: 0.01, ..Physics::default() });
    let plant = plant.unwrap();
    let alone = Mpc::new(&plant, &MpcSettings::default()).unwrap();
    let rates = Rates { rate: 100.0, attitude: 100.0, velocity: 50.0 };
    let fallback = default_controller(&plant, &Setup::new(None, &rates)).unwrap();
    let caught = Mpc::new(&plant, &MpcSettings::default()).unwrap().with_fallback(fallback);
    for (mpc, seed) in [(alone, 1), (caught, 2)] {
        let fared = fly_through(mpc, &plant, n_tick / 2, seed);
        println!("{fared:?}");
        assert!(fared.failed > 0 && 2 * fared.solved > fared.ticks, "{fared:?}");
    }
}

#[test]
fn inputs_stay_within_bounds_in_two_thousand_ticks_of_hostile_states() {
    hostile_ticks(2000);
}

#[test]
#[ignore = "a minute: cargo test --release --test controllers hundred_thousand_ticks -- --ignored --nocapture"]
fn inputs_stay_within_bounds_in_a_hundred_thousand_ticks_of_hostile_states() {
    hostile_ticks(100_000);
}

#[test]
fn commands_of_indi_behind_a_plan_stay_within_bounds_under_hostile_states() {
    let physics = Physics { dt: 0.01, ..Physics::default() };
    let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), physics).unwrap();
    let rates = Rates { rate: 100.0, attitude: 100.0, velocity: 50.0 };
    let mut own = controller("mpc_indi", &plant, &Setup::new(None, &rates)).unwrap();
    let mut draw = drawn(3);
    let (mut commands, max_speed) = (vec![0.0; plant.n_input()], plant.rotor_places()[0].max_speed);
    for tick in 0..1000 {
        let (state, reference) = (hostile_state(&mut draw, max_speed), hostile_reference(&mut draw));
        let seen = Measurement { time: 0.01 * f64::from(tick), state: &state, readings: &[] };
        own.tick(seen, Target::level(&reference), &mut commands);
        assert!(commands.iter().all(|c| (-1.0..=1.0).contains(c)), "tick {tick}: {commands:?} from {state:?}");
    }
}

/// x⁺ = A x + B u with A and B as parameters.
struct Linear {
    n: usize,
    m: usize,
}

impl System for Linear {
    fn n_state(&self) -> usize {
        self.n
    }
    fn n_input(&self) -> usize {
        self.m
    }
    fn n_parameter(&self) -> usize {
        self.n * (self.n + self.m)
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        for (row, next) in parameters.chunks_exact(self.n + self.m).zip(next) {
            let terms = row.iter().zip(state.iter().chain(input));
            *next = terms.fold(S::zero(), |sum, (a, z)| sum + *a * *z);
        }
    }
}

/// ½ Σ w (z − r)²: of states, then of inputs, all w, then all r.
struct Squares {
    n: usize,
    m: usize,
}

impl OptimalCost for Squares {
    fn n_parameter(&self) -> usize {
        2 * (self.n + self.m)
    }
    fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>) {
        let (weights, wanted) = now.parameters.split_at(self.n + self.m);
        for (k, z) in now.state.iter().chain(now.input).enumerate() {
            terms.square(weights[k], *z - wanted[k]);
        }
    }
    fn terminal<S: Scalar>(&self, end: StageInput<'_, S>, terms: &mut Terms<S>) {
        self.stage(end, terms);
    }
}

/// Over twelve decades, now and then none or negative.
fn hostile_weight(draw: &mut Stream) -> f64 {
    match draw.below(40) {
        0..4 => 0.0,
        4 => -10f64.powf(draw.uniform(-6.0, 6.0)),
        _ => 10f64.powf(draw.uniform(-6.0, 6.0)),
    }
}

/// A recorded model, and the bounds that its inputs must not leave.
struct Recorded<F> {
    system: F,
    model: Arc<StageModel>,
    bounds: Option<(Vec<f64>, Vec<f64>)>,
}

impl<F: System> Recorded<F> {
    fn new(system: F, errors: ErrorState, bounds: Option<(Vec<f64>, Vec<f64>)>) -> Self {
        let cost = Squares { n: system.n_state(), m: system.n_input() };
        let model = Arc::new(StageModel::new(&system, &cost, errors).unwrap());
        Self { system, model, bounds }
    }

    fn drawn_bounds(&self, draw: &mut Stream) -> (Vec<f64>, Vec<f64>) {
        let mut of = |i: usize| {
            if let Some((lower, upper)) = &self.bounds {
                let [a, b] = [0; 2].map(|_| draw.uniform(lower[i], upper[i]));
                return match draw.below(4) {
                    0 => [a, a],
                    1 => [a.min(b), a.max(b)],
                    _ => [lower[i], upper[i]],
                };
            }
            let (middle, half) = (3.0 * draw.normal(), 10f64.powf(draw.uniform(-6.0, 3.0)));
            match draw.below(6) {
                0 => [f64::NEG_INFINITY, f64::INFINITY],
                1 => [middle, f64::INFINITY],
                2 => [f64::NEG_INFINITY, middle],
                3 => [middle, middle],
                _ => [middle - half, middle + half],
            }
        };
        (0..self.system.n_input()).map(|i| of(i).into()).map(|(a, b): (f64, f64)| (a, b)).unzip()
    }

    fn drawn(
        &self,
        draw: &mut Stream,
        start: &[f64],
        mut theta: impl FnMut(&mut Stream) -> Vec<f64>,
    ) -> OptimalProblem {
        let stages = 1 + draw.below(60) as usize;
        let mut problem = OptimalProblem::new(self.model.clone(), stages, start).unwrap();
        let n_z = self.system.n_state() + self.system.n_input();
        let varies = draw.below(2) == 0;
        let mut row = Vec::new();
        for stage in 0..=stages {
            if stage == 0 || varies {
                row = theta(draw);
                row.extend((0..n_z).map(|_| hostile_weight(draw)));
                row.extend((0..n_z).map(|_| 3.0 * draw.normal()));
            }
            problem.set_parameters(stage, &row).unwrap();
            if stage < stages {
                let (lower, upper) = self.drawn_bounds(draw);
                problem.set_bounds_of(stage, &lower, &upper).unwrap();
            }
        }
        problem
    }

    /// Cost of a trajectory, Σ |gaps| and Σ |g (u − P(u − g/d))| with later inputs optimal: what a step would gain to first order.
    fn judged(&self, problem: &OptimalProblem, at: &OptimalTrajectory) -> [f64; 3] {
        let (n, m, n_theta) = (self.system.n_state(), self.system.n_input(), self.system.n_parameter());
        let stages = problem.n_stage();
        let (mut cost, mut gap, mut gain) = (0.0, 0.0, 0.0);
        let mut walk = Walk { costate: DVector::zeros(n), cost_to_go: DMatrix::zeros(n, n) };
        for k in (0..=stages).rev() {
            let (theta, rest) = problem.parameters(k).split_at(n_theta);
            let (weights, wanted) = rest.split_at(n + m);
            let x = &at.states[k * n..(k + 1) * n];
            let u = if k < stages { &at.inputs[k * m..(k + 1) * m] } else { &[][..] };
            let off: Vec<f64> = x.iter().chain(u).zip(wanted).map(|(z, r)| z - r).collect();
            cost += off.iter().zip(weights).map(|(e, w)| 0.5 * w * e * e).sum::<f64>();
            let slope = DVector::from_fn(off.len(), |i, _| weights[i] * off[i]);
            let q = DMatrix::from_diagonal(&DVector::from_column_slice(&weights[..n]));
            if k == stages {
                (walk.costate, walk.cost_to_go) = (slope, q);
                continue;
            }
            let mut next = vec![0.0; n];
            self.system.step(x, u, theta, &mut next);
            gap += next.iter().zip(&at.states[(k + 1) * n..]).map(|(a, b)| (a - b).abs()).sum::<f64>();
            let own = linearise(&self.system, x, u, theta);
            let r = DMatrix::from_diagonal(&DVector::from_column_slice(&weights[n..]));
            let (by_state, by_input) = (slope.rows(0, n).into_owned(), slope.rows(n, m).into_owned());
            let (lower, upper) = problem.bounds(k);
            let at = (u, lower, upper);
            let costs = [&q, &DMatrix::zeros(m, n), &r];
            let (slope, curvature) = walk.back([&own.state, &own.input], costs, [&by_state, &by_input], at);
            for i in 0..m {
                gain += (slope[i] * projected_step(u[i], slope[i], curvature[i], [lower[i], upper[i]])).abs();
            }
        }
        [cost, gap, gain]
    }

    /// Solves a problem, and judges what is told; `None` where it was refused.
    fn solve(&self, draw: &mut Stream, problem: &OptimalProblem, name: &str) -> Option<(IlqrStatus, f64)> {
        let (n, m, stages) = (self.system.n_state(), self.system.n_input(), problem.n_stage());
        let mut ilqr = Ilqr::new(problem).unwrap();
        let inputs: Vec<f64> = match &self.bounds {
            Some((lower, upper)) => (0..stages * m).map(|i| draw.uniform(lower[i % m], upper[i % m])).collect(),
            None => (0..stages * m).map(|_| draw.normal()).collect(),
        };
        let begun = if draw.below(2) == 0 {
            let states = problem.start().repeat(stages + 1);
            debug_assert_eq!(states.len(), (stages + 1) * n);
            ilqr.start_from(problem, &OptimalTrajectory { states, inputs })
        } else {
            ilqr.start_from_inputs(problem, &inputs)
        };
        let settings = IlqrSettings { max_iterations: 60, ..IlqrSettings::default() };
        let found = begun.and_then(|()| ilqr.solve(problem, &settings, |_, _| {}));
        let at = ilqr.trajectory();
        for k in 0..stages {
            let (lower, upper) = problem.bounds(k);
            for (i, u) in at.inputs[k * m..(k + 1) * m].iter().enumerate() {
                assert!(lower[i] <= *u && *u <= upper[i], "{name}: {u} within [{}, {}]", lower[i], upper[i]);
            }
        }
        let report = match found {
            Ok(report) => report,
            Err(error) => {
                assert_complete(&error);
                return None;
            }
        };
        let [cost, gap, gain] = self.judged(problem, at);
        let size = 1.0 + cost.abs();
        assert!((report.cost - cost).abs() <= 1e-9 * size, "{name}: cost {} told, {cost} found", report.cost);
        let left = f64::max(gain / size, gap / (1.0 + at.states.iter().map(|x| x.abs()).sum::<f64>()));
        if report.status == IlqrStatus::Solved {
            let last = report.iterations.last();
            assert!(left <= 1e-6, "{name}: solved with {left:e} left, N = {stages}, cost {cost:e}, {last:?}");
        }
        Some((report.status, left))
    }
}

/// Names value, limit and remedy.
fn assert_complete(error: &Error) {
    let told = error.to_string();
    let parts = [" is ", "but it must be", "."];
    assert!(parts.iter().all(|part| told.contains(part)) && told.ends_with('.'), "{told}");
}

fn random_problems(count: usize) {
    let mut draw = drawn(7);
    let linear: Vec<Recorded<Linear>> = [[1, 1], [2, 1], [4, 2], [7, 3]]
        .into_iter()
        .map(|[n, m]| Recorded::new(Linear { n, m }, ErrorState::new(n, &[]).unwrap(), None))
        .collect();
    let physics = Physics { dt: 0.05, ..Physics::default() };
    let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), physics).unwrap();
    let planned = PlannedPlant::new(plant, PlannedInput::Speed).unwrap();
    let (errors, bounds) = (planned.errors().unwrap(), planned.bounds());
    let hummingbird = Recorded::new(planned, errors, Some(bounds));
    let (mut refused, mut told, mut worst) = (0, Vec::new(), [0.0_f64; 2]);
    for i in 0..count {
        let is_linear = i % 5 != 0;
        let found = if is_linear {
            let own = &linear[draw.below(4) as usize];
            let (n, m) = (own.system.n, own.system.m);
            let far = 10f64.powf(draw.uniform(-1.0, 4.0));
            let start: Vec<f64> = (0..n).map(|_| far * draw.normal()).collect();
            let unstable = draw.uniform(0.3, 1.2);
            let problem = own.drawn(&mut draw, &start, |d| {
                let of = |at: usize, d: &mut Stream| {
                    let (row, column) = (at / (n + m), at % (n + m));
                    if column >= n {
                        return d.normal();
                    }
                    let diagonal = if row == column { 0.5 } else { 0.0 };
                    unstable * (diagonal + 0.5 * d.normal() / (n as f64).sqrt())
                };
                (0..n * (n + m)).map(|at| of(at, d)).collect()
            });
            own.solve(&mut draw, &problem, &format!("linear problem {i}"))
        } else {
            let mut start = hostile_state(&mut draw, 1.0);
            while !start.iter().all(|x| x.abs() < 1e3) || start[6..10].iter().all(|q| *q == 0.0) {
                start = hostile_state(&mut draw, 1.0);
            }
            let problem = hummingbird.drawn(&mut draw, &start, |_| Vec::new());
            hummingbird.solve(&mut draw, &problem, &format!("hummingbird {i}"))
        };
        match found {
            None => refused += 1,
            Some((status, left)) => {
                if status == IlqrStatus::Solved {
                    let own = &mut worst[usize::from(!is_linear)];
                    *own = own.max(left);
                }
                told.push((is_linear, status));
            }
        }
    }
    let counted = |linear, status| told.iter().filter(|own| **own == (linear, status)).count();
    for is_linear in [true, false] {
        use IlqrStatus::{NoStep, OutOfIterations, Solved, Violated};
        let of = [Solved, OutOfIterations, NoStep, Violated].map(|status| (status, counted(is_linear, status)));
        println!("linear {is_linear}: {of:?}");
    }
    println!("refused {refused} of {count}, worst of the solved {:.1e} and {:.1e}", worst[0], worst[1]);
    assert!(counted(true, IlqrStatus::Solved) * 2 > count);
}

#[test]
fn two_hundred_random_problems_end_with_a_report() {
    random_problems(200);
}

#[test]
#[ignore = "two minutes: cargo test --release --test controllers ten_thousand_random_problems -- --ignored --nocapture"]
fn ten_thousand_random_problems_end_with_a_report() {
    random_problems(10_000);
}

/// A cost of one state and one input, given by a function of both.
struct Given<C>(C);

/// Costs that are no numbers, or bend the wrong way.
#[derive(Clone, Copy)]
enum Bad {
    Reciprocal,
    Root,
    Concave,
}

impl OptimalCost for Given<Bad> {
    fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>) {
        let (x, u) = (now.state[0], now.input[0]);
        match self.0 {
            Bad::Reciprocal => terms.add(x.recip()),
            Bad::Root => terms.add(x.sqrt()),
            Bad::Concave => terms.add(-(u * u)),
        }
        if !matches!(self.0, Bad::Concave) {
            terms.square(S::one(), u);
        }
    }
}

struct Still;

impl System for Still {
    fn n_state(&self) -> usize {
        1
    }
    fn n_input(&self) -> usize {
        1
    }
    fn n_parameter(&self) -> usize {
        0
    }
    fn step<S: Scalar>(&self, state: &[S], _input: &[S], _parameters: &[S], next: &mut [S]) {
        next[0] = state[0];
    }
}

fn bad_problem(bad: Bad, stages: usize) -> Result<OptimalProblem> {
    let model = StageModel::new(&Still, &Given(bad), ErrorState::new(1, &[])?)?;
    OptimalProblem::new(Arc::new(model), stages, &[0.0])
}

fn solved(bad: Bad) -> Result<IlqrStatus> {
    let problem = bad_problem(bad, 3)?;
    let mut ilqr = Ilqr::new(&problem)?;
    ilqr.start_from_inputs(&problem, &[0.5; 3])?;
    Ok(ilqr.solve(&problem, &IlqrSettings::default(), |_, _| {})?.status)
}

#[test]
fn what_cannot_be_solved_is_refused_with_value_limit_and_remedy() {
    let of = |change: fn(&mut OptimalProblem) -> Result<()>| change(&mut bad_problem(Bad::Root, 3).unwrap());
    let guess = |states: usize, inputs: usize| {
        let problem = bad_problem(Bad::Root, 3).unwrap();
        let guess = OptimalTrajectory { states: vec![1.0; states], inputs: vec![0.0; inputs] };
        Ilqr::new(&problem).unwrap().start_from(&problem, &guess)
    };
    let soft = |state, lower, weight| SoftBound { state, lower, upper: 1.0, weight };
    let rows: Vec<(&str, Result<()>, [&str; 3])> = vec![
        ("no stage", bad_problem(Bad::Root, 0).map(drop), ["is 0", "≥ 1", "at least one stage"]),
        (
            "bounds out of order",
            of(|p| p.set_bounds(&[1.0], &[0.5])),
            ["[1, 0.5]", "lower ≤ upper", "smaller one first"],
        ),
        ("bounds of NaN", of(|p| p.set_bounds(&[f64::NAN], &[0.5])), ["[NaN, 0.5]", "lower ≤ upper", "Give"]),
        ("no bound left", of(|p| p.set_bounds(&[f64::INFINITY], &[f64::INFINITY])), ["[inf, inf]", "lower", "Give"]),
        ("two bounds", of(|p| p.set_bounds(&[0.0; 2], &[1.0; 2])), ["is 2", "be 1", "as the model has"]),
        ("no such stage", of(|p| p.set_bounds_of(3, &[0.0], &[1.0])), ["is 3", "0 to 2", "from 0"]),
        ("two states", of(|p| p.set_start(&[0.0; 2])), ["is 2", "be 1", "as the model has"]),
        ("start of NaN", of(|p| p.set_start(&[f64::NAN])), ["NaN", "finite", "."]),
        ("parameters", of(|p| p.set_parameters(0, &[1.0])), ["is 1", "be 0", "as the model has"]),
        ("states of a guess", guess(3, 3), ["is 3", "be 4", "as the model has"]),
        ("inputs of a guess", guess(4, 2), ["is 2", "be 3", "as the model has"]),
        (
            "soft state",
            bad_problem(Bad::Root, 3).and_then(|mut p| p.set_soft_bounds(&[soft(1, 0.0, 1.0)])),
            ["is 1", "0 to 0", "from 0"],
        ),
        (
            "soft bounds",
            bad_problem(Bad::Root, 3).and_then(|mut p| p.set_soft_bounds(&[soft(0, 2.0, 1.0)])),
            ["[2, 1]", "lower", "Give"],
        ),
        (
            "soft weight",
            bad_problem(Bad::Root, 3).and_then(|mut p| p.set_soft_bounds(&[soft(0, 0.0, -1.0)])),
            ["-1", "≥ 0", "Leave"],
        ),
        ("cost of infinity", solved(Bad::Reciprocal).map(drop), ["inf", "finite", "another guess"]),
        ("slope of infinity", solved(Bad::Root).map(drop), ["NaN", "finite", "away from zero"]),
        ("stages of mpc", MpcSettings { stages: 0, ..MpcSettings::default() }.validate(), ["is 0", "≥ 1", "default"]),
        (
            "stage of mpc",
            MpcSettings { stage: f64::NAN, ..MpcSettings::default() }.validate(),
            ["NaN", "(0, 1] s", "default"],
        ),
        (
            "estimate",
            MpcSettings { estimate: -1.0, ..MpcSettings::default() }.validate(),
            ["-1", "within [0", "default"],
        ),
    ];
    for (name, result, parts) in rows {
        let told = result.expect_err(name).to_string();
        println!("{name}: {told}");
        assert!(parts.iter().all(|part| told.contains(part)), "{name}: {told}");
    }
    for (k, own) in TrackingWeights::names().iter().enumerate() {
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            let mut flat = TrackingWeights::default().flat();
            flat[k] = bad;
            let settings = MpcSettings { weights: TrackingWeights::of_flat(&flat), ..MpcSettings::default() };
            let told = settings.validate().expect_err(own).to_string();
            assert!([own, "≥ 0", "Weigh"].iter().all(|part| told.contains(part)), "{own}: {told}");
        }
    }
}

#[test]
fn a_cost_that_bends_downwards_is_never_called_solved() {
    // without bounds it has no least value
    let status = solved(Bad::Concave);
    println!("{status:?}");
    assert!(!matches!(status, Ok(IlqrStatus::Solved)), "{status:?}");
    let mut qp = StageQp::new(1, 1, 2).unwrap();
    let [one, none] = [1.0, 0.0].map(|x| DMatrix::from_element(1, 1, x));
    let zero = DVector::zeros(1);
    for (stage, curvature) in [(0, 1.0), (1, -1.0)] {
        qp.set_dynamics(stage, &one, &none, &zero).unwrap();
        qp.set_cost(stage, [&one, &none, &DMatrix::from_element(1, 1, curvature)], [&zero, &zero]).unwrap();
    }
    let report = QpSolver::new(&qp).solve(&qp, &[1.0], &QpSettings::default());
    assert_eq!(report.status, QpStatus::NotConvex(1));
}

#[test]
fn an_input_that_a_bound_holds_may_have_a_cost_that_bends_downwards() {
    // cost −u²/2 − 2u within [−1, 1]: least at 1, where the slope is −3
    let mut qp = StageQp::new(1, 1, 1).unwrap();
    let [one, none] = [1.0, 0.0].map(|x| DMatrix::from_element(1, 1, x));
    let zero = DVector::zeros(1);
    qp.set_dynamics(0, &one, &none, &zero).unwrap();
    qp.set_bounds(0, &[-1.0], &[1.0]).unwrap();
    let mut solver = QpSolver::new(&qp);
    // a set that holds it is known from a convex program
    qp.set_cost(0, [&one, &none, &one], [&zero, &DVector::from_element(1, -2.0)]).unwrap();
    assert_eq!(solver.solve(&qp, &[1.0], &QpSettings::default()).status, QpStatus::Solved);
    qp.set_cost(0, [&one, &none, &-&one], [&zero, &DVector::from_element(1, -2.0)]).unwrap();
    let report = solver.solve(&qp, &[1.0], &QpSettings::default());
    assert_eq!((report.status, report.residual, solver.input(0)[0]), (QpStatus::Solved, 0.0, 1.0));
}

#[test]
fn indi_behind_a_plan_refuses_what_is_not_one_rigid_vehicle_by_name() {
    let model = omnidrones::dynamics::configurations::by_name("payload").unwrap();
    let plant = Plant::of_model(&model, Physics::default()).unwrap();
    let told = PlannedIndi::new(&plant, &MpcSettings::default(), &Rates::default()).err().unwrap().to_string();
    println!("{told}");
    assert!(["payload", "one rigid vehicle", "without INDI"].iter().all(|part| told.contains(part)), "{told}");
}

/// x⁺ = x + u, in one stage, with an end whose cost is least at ±1 and flat at 0.
struct Integrator;

impl System for Integrator {
    fn n_state(&self) -> usize {
        1
    }
    fn n_input(&self) -> usize {
        1
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], _parameters: &[S], next: &mut [S]) {
        next[0] = state[0] + input[0];
    }
}

struct TwoWells;

impl OptimalCost for TwoWells {
    fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>) {
        terms.square(S::constant(0.01), now.input[0]);
    }
    fn terminal<S: Scalar>(&self, end: StageInput<'_, S>, terms: &mut Terms<S>) {
        let x = end.state[0];
        terms.add(S::constant(0.5) * (x * x - S::one()).square());
    }
}

#[test]
fn a_flat_place_that_is_no_minimum_is_not_called_solved() {
    let errors = ErrorState::new(1, &[]).unwrap();
    let model = StageModel::new(&Integrator, &TwoWells, errors).unwrap();
    let model = model.with_curvature(&Integrator, &TwoWells).unwrap();
    let problem = OptimalProblem::new(Arc::new(model), 1, &[0.0]).unwrap();
    for (guess, least) in [(0.0, None), (0.3, Some(0.005)), (-2.0, Some(0.005))] {
        let mut search = Ilqr::new(&problem).unwrap();
        search.start_from_inputs(&problem, &[guess]).unwrap();
        let found = search.solve(&problem, &IlqrSettings::default(), |_, _| {});
        let solved = found.as_ref().is_ok_and(|report| report.status == IlqrStatus::Solved);
        println!("from {guess}: {found:?}");
        assert_eq!(solved, least.is_some(), "from {guess}");
        if let (Ok(report), Some(least)) = (found, least) {
            // least near ±1, where its input costs 0.005
            assert!((report.cost - least).abs() < 1e-4, "{}", report.cost);
        }
    }
}

#[test]
fn what_is_left_of_rotors_is_checked_before_anything_is_taken_from_it() {
    let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), Physics::default()).unwrap();
    let settings = MpcSettings { stages: 5, ..MpcSettings::default() };
    let reference = Reference::Hover(Hover { position: [0.1, 0.0, 0.0], yaw: 0.0 });
    let state = plant.hover_state().unwrap();
    let flies: [Box<dyn Fn() -> Box<dyn Controller>>; 2] = [
        Box::new(|| Box::new(Mpc::new(&plant, &settings).unwrap())),
        Box::new(|| Box::new(PlannedIndi::new(&plant, &settings, &Rates::default()).unwrap())),
    ];
    for make in flies {
        let tick = |own: &mut dyn Controller| {
            let mut commands = vec![0.0; 4];
            own.tick(Measurement { time: 0.0, state: &state, readings: &[] }, Target::level(&reference), &mut commands);
            commands
        };
        let (mut told, mut untold) = (make(), make());
        for bad in [&[1.0; 5][..], &[1.0; 3], &[f64::NAN, 1.0, 1.0, 1.0], &[1.0, -0.1, 1.0, 1.0], &[1.0, 1.0, 1.0, 1.1]]
        {
            let error = told.tell(bad).expect_err("refused");
            assert_complete(&error);
        }
        assert_eq!(tick(&mut *told), tick(&mut *untold));
    }
}

#[test]
fn the_last_tick_is_told_and_none_before_it() {
    let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), Physics::default()).unwrap();
    let mut mpc = Mpc::new(&plant, &MpcSettings { rate: 1000.0, stages: 5, ..MpcSettings::default() }).unwrap();
    let reference = Reference::Hover(Hover { position: [0.1, 0.0, 0.0], yaw: 0.0 });
    let (good, mut commands) = (plant.hover_state().unwrap(), vec![0.0; 4]);
    let bad: Vec<f64> = good.iter().map(|_| f64::NAN).collect();
    for (state, is_told) in [(&good, true), (&bad, false), (&good, true)] {
        mpc.tick(Measurement { time: 0.0, state, readings: &[] }, Target::level(&reference), &mut commands);
        assert_eq!(mpc.last().is_some_and(|report| report.is_planned), is_told);
    }
}

#[test]
fn a_linear_plan_is_about_hover_of_what_is_tracked() {
    let model = omnidrones::dynamics::configurations::by_name("payload").unwrap();
    let plant = Plant::of_model(&model, Physics::default()).unwrap();
    let names = plant.body_names();
    let load = names.last().unwrap().clone();
    let settings = MpcSettings { tracked: Some(load), ..MpcSettings::for_plant(&plant) };
    let linear = Mpc::new(&plant, &settings).unwrap().linear().unwrap();
    println!("slowest pole {:?}", linear.poles[0]);
    assert!(linear.poles[0].norm() < 1.0 && linear.gain.row_iter().all(|row| row.amax() > 0.0));
}

#[test]
fn a_load_that_rotors_do_not_carry_is_refused() {
    let model = omnidrones::dynamics::configurations::by_name("payload").unwrap();
    let mut parts = model.parts().clone();
    let last = parts.bodies.len() - 1;
    parts.bodies[last].mass *= 100.0;
    let heavy = omnidrones::dynamics::tree::Model::new(parts).unwrap();
    let plant = Plant::of_model(&heavy, Physics::default()).unwrap();
    let error = Mpc::new(&plant, &MpcSettings::for_plant(&plant)).err().expect("refused");
    println!("{error}");
    assert!(error.to_string().contains("downwards in hover"), "{error}");
}
