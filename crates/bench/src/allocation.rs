//! Allocation: the fast paths beside clarabel's own solve of the same problem, and what derivatives cost.

use super::{BenchPlan, BenchRow, seconds};
use omnidrones::autodiff::program::BLOCK;
use omnidrones::autodiff::{Program, Recording, Scalar, Trace};
use omnidrones::controllers::allocation::conic::ConicSolver;
use omnidrones::controllers::allocation::problem::balanced_weights;
use omnidrones::controllers::allocation::{
    AllocationFunction, Allocator, AllocatorSettings, BatchAllocator, Cone, Problem, Solver, Variation,
};
use omnidrones::dynamics::vehicles;
use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::rng::{Purpose, Stream};
use std::hint::black_box;

/// Wrenches of a sequence of ticks.
const TICKS: usize = 512;
/// Environments of the lane row: they stay in the second-level cache.
const LANES: usize = 1024;

/// All rows.
pub(super) fn run(plan: &BenchPlan, add: &mut dyn FnMut(BenchRow)) -> Result<()> {
    let problem = twelve()?;
    let conic = clarabel(plan, &problem, &ticks(&problem, 0.6))?;
    add(row("box, 12 rotors: clarabel alone", conic * 1e6, "µs", None));
    boxes(plan, &problem, conic, add)?;
    lanes(plan, &problem, conic, add)?;
    recorded(plan, &problem, conic, add)?;
    cones(plan, add)
}

fn row(name: &str, value: f64, unit: &'static str, ratio: Option<f64>) -> BenchRow {
    BenchRow { group: "allocation", name: name.into(), value, unit, ratio, baseline: "of clarabel alone" }
}

/// Six arms at fixed tilts, a coaxial pair each: 12 rotors, six axes.
fn twelve() -> Result<Problem> {
    let mut vehicle = vehicles::by_name("omav")?;
    for (i, rotor) in vehicle.rotors.iter_mut().enumerate() {
        let tilt = if i % 2 == 0 { 0.3_f64 } else { -0.3 };
        let [x, y, _] = rotor.position;
        let reach = x.hypot(y);
        rotor.axis = [-y / reach * tilt.sin(), x / reach * tilt.sin(), tilt.cos()];
    }
    let mut problem = Problem::of_vehicle(&vehicle)?;
    problem.regularisation *= 1e3;
    Ok(problem)
}

/// A random walk of wrenches that often leaves what the rotors can do.
fn ticks(problem: &Problem, spread: f64) -> Vec<[f64; 6]> {
    let mut r = Stream::new(1, 0, 0, Purpose::user(41));
    let half: Vec<f64> = problem.upper.iter().map(|hi| 0.5 * hi).collect();
    let (center, size) = (problem.delivered(&half), half.iter().sum::<f64>());
    let mut away = [0.0; 6];
    let mut tick = |_| {
        std::array::from_fn(|k| {
            let lever = if k < 3 { 1.0 } else { 0.3 };
            away[k] = 0.97 * away[k] + 0.06 * r.uniform(-1.0, 1.0);
            center[k] + spread * 10.0 * lever * size * away[k] * 0.3
        })
    };
    (0..TICKS).map(&mut tick).collect()
}

/// Seconds of clarabel's update and solve.
fn clarabel(plan: &BenchPlan, problem: &Problem, wrenches: &[[f64; 6]]) -> Result<f64> {
    let mut conic = ConicSolver::new(problem)?;
    let mut k = 0;
    Ok(seconds(plan.budget, || {
        k = (k + 1) % TICKS;
        let _ = black_box(conic.solve(problem, &wrenches[k]));
    }))
}

fn boxes(plan: &BenchPlan, problem: &Problem, conic: f64, add: &mut dyn FnMut(BenchRow)) -> Result<()> {
    let mut out = Variation::zero(problem);
    let cotangent: Vec<f64> = (0..problem.n_input()).map(|j| 0.3 - 0.1 * j as f64).collect();
    for (name, spread, warm) in
        [("closed form", 0.02, true), ("active set, warm", 0.6, true), ("active set, cold", 0.6, false)]
    {
        let wrenches = ticks(problem, spread);
        let mut allocator =
            Allocator::with_settings(problem.clone(), AllocatorSettings { warm, ..AllocatorSettings::default() })?;
        let mut k = 0;
        let forward = seconds(plan.budget, || {
            k = (k + 1) % TICKS;
            black_box(allocator.solve(&wrenches[k]));
        });
        add(row(&format!("box, 12 rotors: {name}"), forward * 1e6, "µs", Some(forward / conic)));
        if !warm {
            continue;
        }
        let wanted = if spread < 0.1 { Solver::ClosedForm } else { Solver::ActiveSet };
        let share = allocator.counts().of(wanted) as f64 / allocator.counts().solvers.iter().sum::<u64>() as f64;
        add(row(&format!("  share of ticks by the {}", wanted.name()), 100.0 * share, "%", None));
        let mut tries = 0;
        while allocator.solve(&wrenches[k]).solver != wanted && tries < TICKS {
            (k, tries) = ((k + 1) % TICKS, tries + 1);
        }
        let backward = seconds(plan.budget, || {
            black_box(allocator.reverse(black_box(&cotangent), &mut out));
        });
        let mut gradient =
            row(&format!("  gradient by all numbers, {name}"), backward * 1e6, "µs", Some(backward / forward));
        gradient.baseline = "of its solve";
        add(gradient);
    }
    Ok(())
}

fn lanes(plan: &BenchPlan, problem: &Problem, conic: f64, add: &mut dyn FnMut(BenchRow)) -> Result<()> {
    let wrenches = ticks(problem, 0.6);
    let n = problem.n_input();
    let rows = |shift: usize| -> Vec<f32> {
        (0..LANES).flat_map(|e| wrenches[(e * 7 + shift) % TICKS].map(|w| w as f32)).collect()
    };
    let sequence: Vec<Vec<f32>> = (0..32).map(rows).collect();
    let mut batch = BatchAllocator::new(problem, LANES, 24, Threads::new(1)?)?;
    let mut inputs = vec![0.0; LANES * n];
    for (name, cold) in [("lanes, 12 inputs, warm, one core", false), ("lanes, 12 inputs, cold, one core", true)] {
        let mut k = 0;
        let each = seconds(plan.budget, || {
            k = (k + 1) % sequence.len();
            if cold {
                batch.forget();
            }
            black_box(batch.solve(&sequence[k], &mut inputs));
        }) / LANES as f64;
        add(row(name, 1e-6 / each, "M/s", Some(conic / each)));
    }
    Ok(())
}

/// Calls of a recorded loop, over blocks of environments.
fn recorded(plan: &BenchPlan, problem: &Problem, conic: f64, add: &mut dyn FnMut(BenchRow)) -> Result<()> {
    let function = AllocationFunction::new(problem.clone())?;
    let recording = Recording::of(6, |wrench| {
        let mut inputs = vec![Trace::zero(); problem.n_input()];
        function.call(problem, &std::array::from_fn(|k| wrench[k]), &mut inputs);
        inputs
    });
    let program = Program::compile(&recording)?;
    let (mut work, mut inputs) = (program.block_workspace(), vec![[0.0; BLOCK]; program.n_output()]);
    for (name, spread) in [("closed form", 0.02), ("active set", 0.6)] {
        let wrenches = ticks(problem, spread);
        let block = |k: usize| -> Vec<[f32; BLOCK]> {
            (0..6).map(|row| std::array::from_fn(|lane| wrenches[(k + lane) % TICKS][row] as f32)).collect()
        };
        let blocks: Vec<_> = (0..TICKS / BLOCK).map(|k| block(k * BLOCK)).collect();
        let mut k = 0;
        let each = seconds(plan.budget, || {
            k = (k + 1) % blocks.len();
            program.evaluate_block(&mut work, black_box(&blocks[k]), &mut inputs);
        }) / BLOCK as f64;
        add(row(&format!("called from a program, {name}"), each * 1e6, "µs", Some(each / conic)));
    }
    Ok(())
}

/// An Omav in split forces: six arms, two components each, largest thrusts and windows of tilts.
fn omav() -> Result<(Problem, Vec<[f64; 6]>)> {
    let (arm, most, drag) = (0.3, 20.0, 0.02);
    let mut geometry = nalgebra::DMatrix::zeros(6, 12);
    let (mut cones, mut anchor) = (Vec::new(), vec![0.0; 12]);
    for i in 0..6 {
        let (s, c) = (std::f64::consts::FRAC_PI_3 * i as f64).sin_cos();
        let spin = if i % 2 == 0 { 1.0 } else { -1.0 };
        let (across, up) = (2 * i, 2 * i + 1);
        for (row, value) in [(0, -s), (1, c), (5, arm), (3, spin * drag * s), (4, -spin * drag * c)] {
            geometry[(row, across)] = value;
        }
        for (row, value) in [(2, 1.0), (3, arm * s), (4, -arm * c), (5, -spin * drag)] {
            geometry[(row, up)] = value;
        }
        cones.push(Cone::ball([across, up], most));
        cones.push(Cone::half_space([across, up], [f64::cos(0.2), f64::sin(0.2)], 0.0));
        cones.push(Cone::half_space([across, up], [-f64::cos(0.2), f64::sin(0.2)], 0.0));
        anchor[up] = 0.3 * most;
    }
    let mut problem = Problem::boxed(geometry, balanced_weights(arm), vec![f64::INFINITY; 12])?;
    problem.lower = vec![f64::NEG_INFINITY; 12];
    problem.regularisation = 1e-3;
    (problem.cones, problem.anchor) = (cones, anchor.clone());
    let mut r = Stream::new(2, 0, 0, Purpose::user(41));
    let center = problem.delivered(&anchor);
    let draw = |_| std::array::from_fn(|k| center[k] + r.uniform(-1.0, 1.0) * if k < 3 { 15.0 } else { 3.0 });
    let wrenches = (0..TICKS).map(draw).collect();
    Ok((problem, wrenches))
}

fn cones(plan: &BenchPlan, add: &mut dyn FnMut(BenchRow)) -> Result<()> {
    let (problem, wrenches) = omav()?;
    let conic = clarabel(plan, &problem, &wrenches)?;
    add(row("cones, Omav, 18 of them: clarabel alone", conic * 1e6, "µs", None));
    let mut allocator = Allocator::new(problem.clone())?;
    let mut k = 0;
    let forward = seconds(plan.budget, || {
        k = (k + 1) % TICKS;
        black_box(allocator.solve(&wrenches[k]));
    });
    add(row("cones, Omav: polished and certified", forward * 1e6, "µs", Some(forward / conic)));
    let mut out = Variation::zero(&problem);
    let backward = seconds(plan.budget, || {
        black_box(allocator.reverse(&[0.5; 12], &mut out));
    });
    let mut gradient = row("  gradient by all numbers, cones", backward * 1e6, "µs", Some(backward / forward));
    gradient.baseline = "of its solve";
    add(gradient);
    Ok(())
}
