//! The one bench harness: what a step, a derivative and a gradient cost here, as ratios within one run.
//!
//! Machines are noisy and shared, so each figure is the least of many short repeats, and each is set beside a plain
//! scalar loop measured in the same run. `cargo bench` and `omnidrones bench` both print these rows.

mod allocation;
mod articulated;
pub mod environment;
pub mod learning;

use num_dual::{Dual64, DualSVec64, HyperDual64};
use omnidrones::autodiff::program::BLOCK;
use omnidrones::autodiff::{JacobianScratch, Program, Scalar, System};
use omnidrones::dynamics::tree::Multibody;
use omnidrones::dynamics::{
    Disturbance, Effects, Integrator, Multirotor, Physics, RigidModel, RigidState, World, configurations, vehicles,
};
use omnidrones::error::Result;
use omnidrones::internals::{Timed, grid, step};
use omnidrones::parallel::Threads;
use serde::Serialize;
use std::hint::black_box;
use std::time::{Duration, Instant};

/// How long to measure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BenchPlan {
    /// Time per row.
    pub budget: Duration,
    /// Environments of the batch rows.
    pub n_env: usize,
    /// Most threads of the batch rows: 1, 2, 4 … up to this.
    pub threads: usize,
}

impl Default for BenchPlan {
    fn default() -> Self {
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
        Self { budget: Duration::from_millis(400), n_env: 4096, threads }
    }
}

/// One measured figure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchRow {
    /// What it belongs to: `step`, `batch`, `derivative`, `gradient`, `articulated`, `allocation`; of a task its control
    /// level and integrator.
    pub group: &'static str,
    /// What was measured.
    pub name: String,
    /// The figure.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// How many times the baseline: in speed for rates, in time for durations.
    pub ratio: Option<f64>,
    /// What the ratio is taken of; empty where there is none.
    pub baseline: &'static str,
}

/// Seconds per call: the least over repeats of about a millisecond within the budget.
fn seconds(budget: Duration, mut call: impl FnMut()) -> f64 {
    let first = Instant::now();
    call();
    let once = first.elapsed().as_secs_f64().max(1e-9);
    let per_repeat = ((1e-3 / once) as usize).clamp(1, 1_000_000);
    let (start, mut least) = (Instant::now(), f64::INFINITY);
    loop {
        let repeat = Instant::now();
        for _ in 0..per_repeat {
            call();
        }
        least = least.min(repeat.elapsed().as_secs_f64() / per_repeat as f64);
        if start.elapsed() > budget {
            return least;
        }
    }
}

/// Runs every row in order; `progress` sees each as it is done.
///
/// # Errors
/// [`Error`](omnidrones::error::Error) if `n_env` or `threads` is out of range.
pub fn run(plan: &BenchPlan, progress: &mut dyn FnMut(&BenchRow)) -> Result<Vec<BenchRow>> {
    let bench = Bench::new(plan)?;
    let mut rows = Vec::new();
    let mut add = |row: BenchRow| {
        progress(&row);
        rows.push(row);
    };
    let plain = bench.steps(&mut add);
    bench.batches(plain.f32, &mut add)?;
    bench.derivatives(plain.f64, &mut add)?;
    bench.gradients(&mut add)?;
    articulated::run(plan, &mut add)?;
    allocation::run(plan, &mut add)?;
    Ok(rows)
}

/// The subject of all rows: Hummingbird, RK4, 16 ms, linear drag.
struct Bench {
    plan: BenchPlan,
    system: Multirotor,
    state: Vec<f64>,
    input: Vec<f64>,
}

/// Seconds per plain step.
struct Plain {
    f64: f64,
    f32: f64,
}

const PHYSICS: Physics =
    Physics { dt: 0.016, substeps: 1, integrator: Integrator::RungeKutta4, effects: Effects::lean() };

impl Bench {
    fn new(plan: &BenchPlan) -> Result<Self> {
        let system = Multirotor::new(&vehicles::by_name("hummingbird")?, PHYSICS)?;
        let mut state = system.hover_state([0.0, 0.0, 2.0])?;
        for (x, d) in state.iter_mut().zip([0.1, 0.2, 0.3, 1.0, -0.5, 0.2, 0.0, 0.05, -0.04, 0.02, 0.4, -0.3, 0.2]) {
            *x += d;
        }
        let input = system.hover_input()?;
        Ok(Self { plan: *plan, system, state, input })
    }

    fn seconds(&self, call: impl FnMut()) -> f64 {
        seconds(self.plan.budget, call)
    }

    fn step_time<S: Scalar>(&self, of: impl Fn(f64) -> S, step: impl Fn(&Multirotor, &[S], &[S], &mut [S])) -> f64 {
        let x: Vec<S> = self.state.iter().map(|v| of(*v)).collect();
        let u: Vec<S> = self.input.iter().map(|v| of(*v)).collect();
        let mut next = x.clone();
        self.seconds(|| {
            step(&self.system, black_box(&x), black_box(&u), &mut next);
            black_box(&next);
        })
    }

    /// The same of the model of four rotors alone: over scalars of this crate, which compiles them.
    fn model_time<S: Scalar>(&self, of: impl Fn(f64) -> S) -> f64 {
        let model = RigidModel::<f64, 4>::new(self.system.vehicle(), PHYSICS.dt).cast::<S>();
        let (grid, air) = (grid(&PHYSICS), Disturbance::none());
        self.step_time(of, |_, x, u, next| {
            step(&model, Effects::lean(), grid, &RigidState::read(x), &[0, 1, 2, 3].map(|i| u[i]), &air).write(next);
        })
    }

    fn steps(&self, add: &mut dyn FnMut(BenchRow)) -> Plain {
        let plain = Plain { f64: self.step_time(|v| v, Timed::step_f64), f32: 0.0 };
        let plain = Plain { f32: self.plain_loop(), ..plain };
        let mut row = |name: &str, time: f64| {
            let ratio = Some(time / plain.f64);
            add(BenchRow {
                group: "step",
                name: name.into(),
                value: time * 1e9,
                unit: "ns",
                ratio,
                baseline: "f64 step",
            });
        };
        row("f64", plain.f64);
        row("f32, RK4, 4096 vehicles in a plain loop, each", plain.f32);
        row("Dual64 (one direction)", self.step_time(Dual64::from, Timed::step_dual));
        row("DualSVec64<4> (four directions)", self.model_time(DualSVec64::<4>::from));
        row("HyperDual64 (second derivative)", self.model_time(HyperDual64::from));
        plain
    }

    /// Seconds per step of 4096 vehicles, one after the other in `f32`, as a compiler makes it from the kernel itself:
    /// what lanes are measured against.
    fn plain_loop(&self) -> f64 {
        const N: usize = 4096;
        let nominal = RigidModel::<f64, 4>::new(self.system.vehicle(), PHYSICS.dt);
        let state: Vec<f32> = self.state.iter().map(|v| *v as f32).collect();
        let mut states = vec![RigidState::<f32, 4>::read(&state); N];
        let actions = vec![[-0.41_f32; 4]; N];
        let models = vec![nominal.cast::<f32>(); N];
        let air = Disturbance::none();
        let time = self.seconds(|| {
            for ((x, action), model) in states.iter_mut().zip(black_box(&actions)).zip(&models) {
                *x = step(model, Effects::lean(), grid(&PHYSICS), x, action, &air);
            }
        });
        time / N as f64
    }

    fn batches(&self, plain: f64, add: &mut dyn FnMut(BenchRow)) -> Result<()> {
        let n = self.plan.n_env;
        let semi = Physics { integrator: Integrator::SemiImplicit, substeps: 2, ..PHYSICS };
        let default = Physics { effects: Effects::default(), ..PHYSICS };
        let mut threads = 1;
        while threads <= self.plan.threads.max(1) {
            for (name, physics) in
                [("RK4", PHYSICS), ("semi-implicit, 2 substeps", semi), ("RK4, default effects", default)]
            {
                let mut world = World::new(self.system.vehicle(), physics, n)?;
                world.set_threads(Threads::new(threads)?);
                let actions: Vec<f32> = self.input.iter().map(|u| *u as f32).collect::<Vec<_>>().repeat(n);
                let mut outcome = Ok(());
                let time = self.seconds(|| {
                    if outcome.is_ok() {
                        outcome = world.step(black_box(&actions));
                    }
                });
                outcome?;
                let per_step = time / n as f64;
                add(BenchRow {
                    group: "batch",
                    name: format!("{name}, {n} environments, {threads} thread{}", if threads == 1 { "" } else { "s" }),
                    value: 1e-6 / per_step,
                    unit: "M steps/s",
                    ratio: Some(plain / per_step),
                    baseline: "plain f32 RK4 loop",
                });
            }
            threads *= 2;
        }
        Ok(())
    }

    fn derivatives(&self, plain: f64, add: &mut dyn FnMut(BenchRow)) -> Result<()> {
        let (n, m) = (self.system.n_state(), self.system.n_input());
        let plain = plain.min(self.step_time(|v| v, Timed::step_f64));
        let mut scratch = JacobianScratch::new(&self.system);
        let mut columns = vec![0.0; n * (n + m)];
        let time = self.seconds(|| {
            self.system.jacobian(black_box(&self.state), &self.input, &mut scratch, &mut columns);
            black_box(&columns);
        });
        let row = |name: String, value: f64, unit, ratio: f64| BenchRow {
            group: "derivative",
            name,
            value,
            unit,
            ratio: Some(ratio),
            baseline: "f64 step",
        };
        add(row(format!("{n}×{} Jacobian, Dual64 columns", n + m), time * 1e6, "µs", time / plain));

        let mut compiled = self.system.compiled_jacobian()?;
        let time = self.seconds(|| {
            compiled.evaluate(black_box(&self.state), &self.input, &[], &mut columns);
            black_box(&columns);
        });
        let size = format!("{} operations", compiled.len());
        add(row(format!("{n}×{} Jacobian, compiled ({size})", n + m), time * 1e6, "µs", time / plain));
        for name in ["payload", "platform", "dragon"] {
            add(self.articulated_jacobian(name)?);
        }

        let recording = self.system.recording();
        let adjoint = recording.adjoint(0..n + m);
        for (what, recording) in [("step", recording), ("adjoint", adjoint)] {
            let program = Program::compile(&recording)?;
            let mut arguments: Vec<f64> = self.state.iter().chain(&self.input).copied().collect();
            arguments.resize(program.n_input(), 0.3);
            let size = format!("{} instructions", program.len());
            let how = if program.is_native() {
                ["machine code", "interpreted"]
            } else {
                ["interpreted", "interpreted again"]
            };
            let (single, block) = self.program_times(&program, &arguments);
            for (how, time) in how.into_iter().zip(single) {
                add(row(format!("{what} as program, f64, {how} ({size})"), time * 1e9, "ns", time / plain));
            }
            for (how, time) in how.into_iter().zip(block) {
                let per_env = time / BLOCK as f64;
                add(row(format!("{what} as program, lanes, one core, {how}"), 1e-6 / per_env, "M/s", plain / per_env));
            }
        }
        Ok(())
    }

    /// Seconds of an evaluation in `f64` and over a block: as the program runs here, then interpreted. The two take turns.
    fn program_times(&self, program: &Program, arguments: &[f64]) -> ([f64; 2], [f64; 2]) {
        let mut results = vec![0.0; program.n_output()];
        let block: Vec<[f32; BLOCK]> = arguments.iter().map(|v| [*v as f32; BLOCK]).collect();
        let mut block_results = vec![[0.0; BLOCK]; program.n_output()];
        let mut single = [program.workspace(), program.interpreter_workspace()];
        let mut blocks = [program.block_workspace(), program.interpreter_block_workspace()];
        let mut times = ([f64::INFINITY; 2], [f64::INFINITY; 2]);
        for k in [0, 1, 0, 1] {
            let time = seconds(self.plan.budget / 4, || {
                program.evaluate(&mut single[k], black_box(arguments), &mut results);
                black_box(&results);
            });
            times.0[k] = times.0[k].min(time);
            let time = seconds(self.plan.budget / 4, || {
                program.evaluate_block(&mut blocks[k], black_box(&block), &mut block_results);
                black_box(&block_results);
            });
            times.1[k] = times.1[k].min(time);
        }
        times
    }

    /// The compiled Jacobian of a configuration's step, against duals column by column. The two take turns.
    fn articulated_jacobian(&self, name: &str) -> Result<BenchRow> {
        let system = Multibody::new(&configurations::by_name(name)?, PHYSICS)?;
        let (x, u) = (articulated::aloft(&system), vec![-0.2; system.n_input()]);
        let (n, m) = (x.len(), u.len());
        let (mut scratch, mut compiled) = (JacobianScratch::new(&system), system.compiled_jacobian()?);
        let mut columns = vec![0.0; n * (n + m)];
        let (mut slow, mut fast) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..4 {
            slow = slow.min(seconds(self.plan.budget / 8, || {
                system.jacobian(black_box(&x), &u, &mut scratch, &mut columns);
                black_box(&columns);
            }));
            fast = fast.min(seconds(self.plan.budget / 8, || {
                compiled.evaluate(black_box(&x), &u, &[], &mut columns);
                black_box(&columns);
            }));
        }
        Ok(BenchRow {
            group: "derivative",
            name: format!("{n}×{} Jacobian of {name}, compiled", n + m),
            value: fast * 1e6,
            unit: "µs",
            ratio: Some(fast / slow),
            baseline: "Dual64 columns",
        })
    }

    fn gradients(&self, add: &mut dyn FnMut(BenchRow)) -> Result<()> {
        self.gradient("", &self.system, &self.state, &self.input, add)?;
        let payload = Multibody::new(&configurations::by_name("payload")?, PHYSICS)?;
        let (state, input) = (articulated::aloft(&payload), vec![-0.2; payload.n_input()]);
        self.gradient("payload, ", &payload, &state, &input, add)
    }

    /// A rollout and its gradient, which take turns.
    fn gradient<F: Timed>(
        &self,
        of: &str,
        system: &F,
        state: &[f64],
        input: &[f64],
        add: &mut dyn FnMut(BenchRow),
    ) -> Result<()> {
        let horizon = 500;
        let mut rollout = system.to_origin()?;
        let inputs = input.repeat(horizon);
        rollout.gradient(state, &inputs);
        let (mut forward, mut backward) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..4 {
            forward = forward.min(seconds(self.plan.budget / 4, || {
                black_box(rollout.cost(black_box(state), &inputs));
            }));
            backward = backward.min(seconds(self.plan.budget / 4, || {
                black_box(rollout.gradient(black_box(state), &inputs));
            }));
        }
        let row = |name: String, time: f64| BenchRow {
            group: "gradient",
            name,
            value: time * 1e3,
            unit: "ms",
            ratio: Some(time / forward),
            baseline: "500-step rollout",
        };
        add(row(format!("{of}{horizon}-step rollout, f64"), forward));
        add(row(format!("{of}gradient over its {} controls, adjoint", inputs.len()), backward));
        Ok(())
    }
}

/// The rows as aligned text.
pub fn text(rows: &[BenchRow]) -> String {
    let width = rows.iter().map(|r| r.name.chars().count()).max().unwrap_or(0);
    rows.iter()
        .map(|r| {
            let ratio = r.ratio.map_or(String::new(), |x| format!("{:>8} × {}", three_digits(x), r.baseline));
            let pad = width - r.name.chars().count();
            format!("{:10} {}{} {:10.2} {:10} {ratio}\n", r.group, r.name, " ".repeat(pad), r.value, r.unit)
        })
        .collect()
}

/// A ratio to three digits, however small.
fn three_digits(x: f64) -> String {
    let decimals = (2.0 - x.abs().max(1e-6).log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{x:.decimals$}")
}
