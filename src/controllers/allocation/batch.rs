//! Many allocations at once: the active set in lanes, one environment per lane, for a bounded number of steps.
//!
//! All environments share a geometry; wrenches and bounds are their own. Answers are within their bounds to the bit after
//! any number of steps, exact once done. An environment stops when its own answer is exact, so that it does not depend on
//! its neighbours.

use super::active_set::{BoxQp, FAR, Factor, Iterate, Tolerances};
use super::problem::{Problem, WRENCH};
use autodiff::lanes::{Lanes, RegisterKernel, each_register};
use autodiff::safe;
use base::error::{Error, Result};
use base::memory::Request;
use base::parallel::Threads;

/// Environments per block.
const BLOCK: usize = 64;
/// Largest scaled KKT residual of an answer that counts as finished: what `f32` can tell.
pub(crate) const LANE_TOLERANCE: f64 = 1e-4;
/// Least ρ over the largest diagonal entry of H: below, rounding to `f32` decides what the preference should.
pub(crate) const LANE_REGULARISATION: f64 = 1e-5;
/// Most inputs.
pub(crate) const MAX_LANE_INPUTS: usize = 16;

/// Outcome of one batch call.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BatchReport {
    /// Environments whose wrench was not finite: their last inputs are held, within the bounds of now.
    pub held: usize,
    /// Environments whose answer is not certified: the scaled KKT residual, recomputed, is above `LANE_TOLERANCE` or steps
    /// ran out. They are within their bounds and no worse than where they started, perhaps not optimal.
    pub unfinished: usize,
}

/// An allocator for `n_env` environments with one geometry.
#[derive(Debug, Clone)]
pub struct BatchAllocator {
    shared: Shared,
    n_env: usize,
    blocks: Vec<Block>,
    threads: Threads,
}

/// What all environments have in common, in units of the largest input and the largest entry of H.
#[derive(Debug, Clone)]
struct Shared {
    n_input: usize,
    hessian: Vec<Vec<f64>>,
    /// −BᵀW and −ρ u_pref.
    pull: Vec<[f64; WRENCH]>,
    offset: Vec<f64>,
    /// u = K w + k where no bound acts.
    gain: Vec<[f64; WRENCH]>,
    rest: Vec<f64>,
    /// N, a power of two.
    unit: f64,
    steps: usize,
}

/// Bounds and memory of [`BLOCK`] environments, `[number][environment]`, in units.
#[derive(Debug, Clone)]
struct Block {
    lower: [[f32; BLOCK]; MAX_LANE_INPUTS],
    upper: [[f32; BLOCK]; MAX_LANE_INPUTS],
    inputs: [[f32; BLOCK]; MAX_LANE_INPUTS],
    status: [[f32; BLOCK]; MAX_LANE_INPUTS],
    wrench: [[f32; BLOCK]; WRENCH],
    finite: [f32; BLOCK],
    done: [f32; BLOCK],
}

impl BatchAllocator {
    /// `n_env` environments with the numbers of `problem`, at most `steps` steps each per call (24 suit 12 inputs from
    /// cold; a warm tick takes a few).
    ///
    /// # Errors
    /// [`Error::Limit`] for more than `MAX_LANE_INPUTS` inputs, [`Error::Value`] for cones or a ρ below
    /// `LANE_REGULARISATION` of the largest entry of H, [`Error::Limit`] for more memory than is left; otherwise as [`Problem::validate`].
    pub fn new(problem: &Problem, n_env: usize, steps: usize, threads: Threads) -> Result<Self> {
        problem.validate()?;
        let n = problem.n_input();
        if n > MAX_LANE_INPUTS {
            return Err(Error::limit("allocation: inputs in lanes", n, MAX_LANE_INPUTS, "Use an Allocator each."));
        }
        if !problem.cones.is_empty() {
            let remedy = "Lanes take bounds alone: use an Allocator each.";
            return Err(Error::value("allocation: cones in lanes", problem.cones.len(), "0", remedy));
        }
        let (rho, least) = (problem.regularisation, LANE_REGULARISATION * problem.hessian().diagonal().max());
        if rho < least {
            let remedy = "Raise problem.regularisation: f32 cannot tell less from rounding.";
            return Err(Error::value("allocation: regularisation in lanes", rho, format!("≥ {least:.1e}"), remedy));
        }
        let bytes = n_env.div_ceil(BLOCK) as u128 * size_of::<Block>() as u128
            + (2 * n * size_of::<f32>()) as u128 * n_env as u128;
        let less = "Allocate for fewer environments at once";
        let request = Request { what: "allocation: n_env", value: n_env, bytes, limit: u64::MAX, setting: "it", less };
        request.check(|limit| format!("0 to {:.0}", n_env as f64 * (limit as f64 / bytes as f64)))?;
        let shared = Shared::of(problem, steps)?;
        let zero = [[0.0; BLOCK]; MAX_LANE_INPUTS];
        let block = Block {
            lower: zero,
            upper: zero,
            inputs: zero,
            status: zero,
            wrench: [[0.0; BLOCK]; WRENCH],
            finite: [1.0; BLOCK],
            done: [0.0; BLOCK],
        };
        let mut batch = Self { shared, n_env, blocks: vec![block; n_env.div_ceil(BLOCK)], threads };
        let rows = |v: &[f64]| (0..n_env).flat_map(|_| v.iter().map(|x| *x as f32)).collect::<Vec<_>>();
        batch.set_bounds(&rows(&problem.lower), &rows(&problem.upper));
        batch.forget();
        Ok(batch)
    }

    /// Number of environments.
    pub fn n_env(&self) -> usize {
        self.n_env
    }

    /// Bounds of every environment, `[environment, input]`, N. Where a lower bound is above the upper, the upper holds.
    ///
    /// # Panics
    /// If a slice is not of that size.
    pub fn set_bounds(&mut self, lower: &[f32], upper: &[f32]) {
        let (n, unit) = (self.shared.n_input, self.shared.unit as f32);
        assert_eq!((lower.len(), upper.len()), (self.n_env * n, self.n_env * n), "bounds of all environments");
        for (e, (lo, hi)) in lower.chunks(n).zip(upper.chunks(n)).enumerate() {
            let (block, lane) = (&mut self.blocks[e / BLOCK], e % BLOCK);
            for i in 0..n {
                let hi = (hi[i] / unit).clamp(-FAR as f32, FAR as f32);
                block.upper[i][lane] = if hi.is_nan() { 0.0 } else { hi };
                let lo = (lo[i] / unit).clamp(-FAR as f32, block.upper[i][lane]);
                block.lower[i][lane] = if lo.is_nan() { block.upper[i][lane].min(0.0) } else { lo };
            }
        }
    }

    /// Forgets the last answers: the next call starts cold.
    pub fn forget(&mut self) {
        for block in &mut self.blocks {
            block.done.fill(0.0);
        }
    }

    /// Whether the last answer of an environment is certified, or held after one that was.
    pub fn is_finished(&self, environment: usize) -> bool {
        self.blocks[environment / BLOCK].done[environment % BLOCK] > 0.5
    }

    /// Whether the last inputs of an environment were held, because its wrench was not finite.
    pub fn is_held(&self, environment: usize) -> bool {
        self.blocks[environment / BLOCK].finite[environment % BLOCK] < 0.5
    }

    /// The best inputs of every environment: `wrenches` `[environment, 6]` (N, N m) → `inputs` `[environment, input]`.
    /// No allocation.
    ///
    /// # Panics
    /// If a slice is not of that size.
    pub fn solve(&mut self, wrenches: &[f32], inputs: &mut [f32]) -> BatchReport {
        let n = self.shared.n_input;
        assert_eq!((wrenches.len(), inputs.len()), (self.n_env * WRENCH, self.n_env * n), "rows of all environments");
        for (e, w) in wrenches.chunks_exact(WRENCH).enumerate() {
            let (block, lane) = (&mut self.blocks[e / BLOCK], e % BLOCK);
            let fine = w.iter().all(|w| safe::is_bounded(f64::from(*w), FAR));
            block.finite[lane] = f32::from(u8::from(fine));
            for k in 0..WRENCH {
                block.wrench[k][lane] = if fine { w[k] } else { 0.0 };
            }
        }
        let shared = &self.shared;
        self.threads.for_each(&mut self.blocks, |_, block| shared.solve(block));
        let mut report = BatchReport::default();
        for (e, u) in inputs.chunks_exact_mut(n).enumerate() {
            let (block, lane) = (&self.blocks[e / BLOCK], e % BLOCK);
            for i in 0..n {
                u[i] = block.inputs[i][lane] * self.shared.unit as f32;
            }
            let held = block.finite[lane] < 0.5;
            report.held += usize::from(held);
            report.unfinished += usize::from(!held && block.done[lane] < 0.5);
        }
        report
    }
}

impl Shared {
    fn of(problem: &Problem, steps: usize) -> Result<Self> {
        let (n, h) = (problem.n_input(), problem.hessian());
        let cost = h.diagonal().max();
        let bounds = problem.lower.iter().chain(&problem.upper).filter(|b| b.abs() < FAR);
        // a power of two: bounds change units without rounding
        let unit = bounds.fold(1e-12, |m: f64, b| m.max(b.abs())).log2().ceil().exp2();
        let Some(cholesky) = h.clone().cholesky() else {
            let remedy = "Raise its regularisation.";
            return Err(Error::value("allocation: Hessian", "not positive", "positive definite", remedy));
        };
        let pull = nalgebra::DMatrix::from_fn(n, WRENCH, |j, i| problem.geometry[(i, j)] * problem.weights[i]);
        let preferred = nalgebra::DVector::from_column_slice(&problem.preference) * problem.regularisation;
        let (gain, rest) = (cholesky.solve(&pull) / unit, cholesky.solve(&preferred) / unit);
        let rows = |m: &nalgebra::DMatrix<f64>, by: f64| {
            (0..n).map(|j| std::array::from_fn(|i| m[(j, i)] / by)).collect::<Vec<_>>()
        };
        Ok(Self {
            n_input: n,
            hessian: (0..n).map(|i| (0..n).map(|j| h[(i, j)] / cost).collect()).collect(),
            pull: rows(&pull, cost * unit),
            offset: preferred.iter().map(|p| p / (cost * unit)).collect(),
            gain: rows(&gain, 1.0),
            rest: rest.iter().copied().collect(),
            unit,
            steps,
        })
    }

    /// The kernel for the next larger compiled number of inputs.
    fn solve(&self, block: &mut Block) {
        match self.n_input {
            0..=4 => each_register(BLOCK, Solve::<4> { shared: self, block }),
            5..=8 => each_register(BLOCK, Solve::<8> { shared: self, block }),
            9..=12 => each_register(BLOCK, Solve::<12> { shared: self, block }),
            _ => each_register(BLOCK, Solve::<16> { shared: self, block }),
        }
    }
}

/// One block with N slots; slots behind the inputs are held at 0.
struct Solve<'a, const N: usize> {
    shared: &'a Shared,
    block: &'a mut Block,
}

impl<const N: usize> RegisterKernel for Solve<'_, N> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        run::<L, N>(self.shared, self.block, at);
    }
}

/// One register of environments.
#[inline(always)]
fn run<L: Lanes, const N: usize>(shared: &Shared, block: &mut Block, at: usize) {
    let (mut program, free) = load::<L, N>(shared, block, at);
    let mut x = start(&mut program, block, &free, at);
    let mut factor = Factor::new();
    let finite = L::load(&block.finite[at..]);
    let half = L::constant(0.5);
    let mut lanes = [0.0_f32; 16];
    for step in 0..shared.steps {
        let before = x;
        program.step(N, &mut x, &mut factor, step < shared.steps / 2, Tolerances::SINGLE);
        keep(&mut x, &before);
        // a lane without a finite wrench counts as done
        L::select(finite.lt(half), L::one(), x.done).store(&mut lanes);
        if all_done(&lanes, L::WIDTH) {
            break;
        }
    }
    store(block, &program, &x, at);
}

#[inline(always)]
fn all_done(lanes: &[f32; 16], width: usize) -> bool {
    let mut done = true;
    for i in 0..width {
        done &= lanes[i] > 0.5;
    }
    done
}

/// Lanes that were done stay as they were.
#[inline(always)]
fn keep<L: Lanes, const N: usize>(x: &mut Iterate<L, N>, before: &Iterate<L, N>) {
    let done = L::constant(0.5).lt(before.done);
    for i in 0..N {
        x.inputs[i] = L::select(done, before.inputs[i], x.inputs[i]);
        x.status[i] = L::select(done, before.status[i], x.status[i]);
    }
    x.done = L::select(done, before.done, x.done);
}

/// The programs of one register, and their answers without bounds.
#[inline(always)]
fn load<L: Lanes, const N: usize>(shared: &Shared, block: &Block, at: usize) -> (BoxQp<L, N>, [L; N]) {
    let mut program = BoxQp::empty();
    let mut free = [L::zero(); N];
    let mut w = [L::zero(); WRENCH];
    for k in 0..WRENCH {
        w[k] = L::load(&block.wrench[k][at..]);
    }
    for i in 0..N {
        program.hessian[i][i] = L::one();
    }
    for i in 0..shared.n_input {
        for j in 0..shared.n_input {
            program.hessian[i][j] = L::constant(shared.hessian[i][j]);
        }
        let mut q = L::constant(-shared.offset[i]);
        let mut u = L::constant(shared.rest[i]);
        for k in 0..WRENCH {
            q = L::constant(-shared.pull[i][k]).mul_add(w[k], q);
            u = L::constant(shared.gain[i][k]).mul_add(w[k], u);
        }
        (program.linear[i], free[i]) = (q, u);
        program.lower[i] = L::load(&block.lower[i][at..]);
        program.upper[i] = L::load(&block.upper[i][at..]);
    }
    (program, free)
}

/// From the last answer where that was exact, else from the clipped closed form.
#[inline(always)]
fn start<L: Lanes, const N: usize>(
    program: &mut BoxQp<L, N>,
    block: &Block,
    free: &[L; N],
    at: usize,
) -> Iterate<L, N> {
    let cold = program.start(N, free);
    let mut earlier = cold;
    for i in 0..N {
        earlier.inputs[i] = L::load(&block.inputs[i][at..]);
        earlier.status[i] = L::load(&block.status[i][at..]);
    }
    let mut x = program.restart(N, &earlier);
    let warm = L::constant(0.5).lt(L::load(&block.done[at..]));
    for i in 0..N {
        x.inputs[i] = L::select(warm, x.inputs[i], cold.inputs[i]);
        x.status[i] = L::select(warm, x.status[i], cold.status[i]);
    }
    x
}

/// Answers back to the block; a lane without a finite wrench keeps its last inputs, within the bounds of now.
#[inline(always)]
fn store<L: Lanes, const N: usize>(block: &mut Block, program: &BoxQp<L, N>, x: &Iterate<L, N>, at: usize) {
    let fine = L::constant(0.5).lt(L::load(&block.finite[at..]));
    for i in 0..N {
        let last = L::load(&block.inputs[i][at..]).clamp(program.lower[i], program.upper[i]);
        let held = L::load(&block.status[i][at..]);
        L::select(fine, x.inputs[i], last).store(&mut block.inputs[i][at..]);
        L::select(fine, x.status[i], held).store(&mut block.status[i][at..]);
    }
    let certified = residual(program, x).lt(L::constant(LANE_TOLERANCE));
    let finished = L::select(certified, x.done, L::zero());
    let done = L::load(&block.done[at..]);
    L::select(fine, finished, done).store(&mut block.done[at..]);
}

/// Scaled KKT residual as in [`residual`](super::residual), recomputed from the program: |gᵢ| δᵢ over max(1, ‖q‖∞). NaN
/// counts as large.
#[inline(always)]
fn residual<L: Lanes, const N: usize>(program: &BoxQp<L, N>, x: &Iterate<L, N>) -> L {
    let g = program.gradient(N, &x.inputs);
    let (mut worst, mut size) = (L::zero(), L::one());
    for i in 0..N {
        size = size.max(program.linear[i].abs());
        let down = L::zero().lt(g[i]);
        let room = L::select(down, x.inputs[i] - program.lower[i], program.upper[i] - x.inputs[i]);
        worst = worst.max(g[i].abs() * room.min(L::one()));
        // what `max` would drop
        size += g[i] * L::zero();
    }
    worst * size.recip()
}
