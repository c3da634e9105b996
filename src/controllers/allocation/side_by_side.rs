//! Answers of the fast paths for eight wrenches of one problem side by side: recorded once for a number of inputs, run as machine code.
//!
//! The lines of the [active set](super::active_set), of the closed form and of the certificate are those of the answers one by one, in
//! the same order, so that the bits are theirs. A lane that is done stays as it is while its neighbours search on. What is not certified
//! here is left to the allocator.

use super::active_set::{BoxQp, FAR, Factor, Iterate, Tolerances};
use super::fast::{Fast, MAX_FAST, MAX_STEPS};
use super::problem::{LOOSE, Problem, WRENCH};
use autodiff::columns::{LINE, Lines};
use autodiff::native::{Executable, Place, RowLayout, Rows, WhyInterpreted, Work};
use autodiff::{Mask, Points, Program, Recording, Scalar, Trace};
use std::ops::Range;
use std::sync::Arc;

type Row = [f64; LINE];

/// The numbers of a problem and what is prepared of them.
pub(super) struct Numbers<'a, S> {
    pull: &'a [S],
    offset: &'a [S],
    gain: &'a [S],
    rest: &'a [S],
    geometry: &'a [S],
    weights: &'a [S],
    preference: &'a [S],
    lower: &'a [S],
    upper: &'a [S],
    hessian: &'a [S],
    /// ρ, the unit of H, what inputs are asked for at least, the same where nothing is asked for, the largest bound, the tolerance, and 0:
    /// sums begin with one that is not folded away, so that zeros have the signs that they have one by one.
    others: &'a [S],
}

const N_OTHER: usize = 7;

/// Rows of a problem of `n` inputs.
fn n_number(n: usize) -> usize {
    n * n + 3 * WRENCH * n + 5 * n + WRENCH + N_OTHER
}

impl<'a, S> Numbers<'a, S> {
    pub(super) fn of(n: usize, mut rows: &'a [S]) -> Self {
        let mut take = |n: usize| rows.split_off(..n).unwrap_or_default();
        Self {
            pull: take(WRENCH * n),
            offset: take(n),
            gain: take(WRENCH * n),
            rest: take(n),
            geometry: take(WRENCH * n),
            weights: take(WRENCH),
            preference: take(n),
            lower: take(n),
            upper: take(n),
            hessian: take(n * n),
            others: take(N_OTHER),
        }
    }
}

/// The numbers of a prepared problem, in the order of [`Numbers`].
pub(super) fn numbers<'a>(problem: &'a Problem, fast: &'a Fast, tolerance: f64) -> impl Iterator<Item = f64> + 'a {
    let n = problem.n_input();
    let limits = problem.limits();
    let hessian = (0..n).flat_map(move |i| &fast.program.hessian[i][..n]);
    let [asked, tightest, allowed] = [limits.asked, limits.tightest, limits.allowed];
    let others = [problem.regularisation, fast.cost, asked, tightest, allowed, tolerance.next_up(), 0.0];
    (fast.pull.iter().flatten().chain(&fast.offset))
        .chain(fast.gain.iter().flatten().chain(&fast.rest))
        .chain(problem.geometry.iter().chain(&problem.weights))
        .chain(problem.preference.iter().chain(&problem.lower).chain(&problem.upper))
        .chain(hessian)
        .copied()
        .chain(others)
}

/// Writes the numbers of a prepared problem, each into every lane.
fn write(problem: &Problem, fast: &Fast, tolerance: f64, rows: &mut [Row]) {
    rows.iter_mut().zip(numbers(problem, fast, tolerance)).for_each(|(row, x)| *row = [x; LINE]);
}

/// Places of what is known of an answer.
#[derive(Clone)]
pub(super) struct Places {
    /// Inputs and status in units, and whether it is done.
    pub(super) iterate: Range<usize>,
    /// −q, lower and upper bounds in units.
    pub(super) task: Range<usize>,
    /// The units of inputs and gradients.
    pub(super) units: Range<usize>,
    /// u, and 1 where it is certified, 0 where nobody can.
    pub(super) answer: Range<usize>,
}

impl Places {
    pub(super) fn of(n: usize) -> Self {
        let ends = [2 * n + 1, 5 * n + 1, 5 * n + 3, 6 * n + 4];
        Self { iterate: 0..ends[0], task: ends[0]..ends[1], units: ends[1]..ends[2], answer: ends[2]..ends[3] }
    }
}

impl<S: Scalar> Numbers<'_, S> {
    fn zero(&self) -> S {
        self.others[6]
    }

    fn dot(&self, a: &[S], b: &[S]) -> S {
        a.iter().zip(b).fold(self.zero(), |sum, (a, b)| sum + *a * *b)
    }
}

fn flag<S: Scalar>(mask: S::Mask) -> S {
    S::select(mask, S::one(), S::zero())
}

/// From a wrench to all of [`Places`]: the closed form, which is done where it is certified.
pub(super) fn begin<S: Scalar>(n: usize, of: &Numbers<S>, wrench: &[S]) -> Vec<S> {
    let [_, cost, least, otherwise, allowed, ..]: [S; N_OTHER] = std::array::from_fn(|k| of.others[k]);
    let infinite = S::constant(f64::INFINITY);
    let pulled: Vec<S> = of.pull.chunks_exact(WRENCH).map(|row| of.dot(row, wrench)).collect();
    let largest = pulled.iter().fold(S::zero(), |most, pulled| most.max(pulled.abs()));
    let asked = (largest / cost).max(least);
    let asked = S::constant(LOOSE) * S::select(S::zero().lt(asked), asked, otherwise);
    let unit = allowed.min(asked).max(S::constant(1e-12));
    let steepness = (cost * unit).max(largest);
    let usable = wrench.iter().fold(steepness.lt(infinite), |all, w| all.and(w.abs().lt(infinite)));

    let mut task = vec![S::zero(); 3 * n];
    let mut program = BoxQp::<S, MAX_FAST>::empty();
    let (mut u, mut from) = (vec![S::zero(); n], [S::zero(); MAX_FAST]);
    let mut inside = usable;
    for j in 0..n {
        u[j] = of.dot(&of.gain[WRENCH * j..][..WRENCH], wrench) + of.rest[j];
        from[j] = u[j] / unit;
        inside = inside.and(of.lower[j].lt(of.upper[j])).and(u[j].lt(of.lower[j]).or(of.upper[j].lt(u[j])).not());
        program.lower[j] = (of.lower[j] / unit).clamp(S::constant(-FAR), S::constant(FAR));
        program.upper[j] = (of.upper[j] / unit).clamp(S::constant(-FAR), S::constant(FAR));
        task[j] = -(pulled[j] + of.offset[j]) / (cost * unit);
        (task[n + j], task[2 * n + j]) = (program.lower[j], program.upper[j]);
    }
    let good = flag::<S>(inside.and(certified(of, wrench, &u, unit, steepness)));
    let x = program.start(n, &from);
    let done = S::select(usable, good, S::one());
    // the closed form holds nothing
    let held = |status: &S| S::select(S::zero().lt(good), S::zero(), *status);
    (x.inputs[..n].iter().copied().chain(x.status[..n].iter().map(held)).chain([done]))
        .chain(task)
        .chain([unit, steepness])
        .chain(u)
        .chain([S::select(usable, good, S::constant(-1.0))])
        .collect()
}

/// Whether an answer is within all bounds and its [residual](super::residual) within the tolerance.
fn certified<S: Scalar>(of: &Numbers<S>, wrench: &[S], u: &[S], unit: S, steepness: S) -> S::Mask {
    let force: Vec<S> = miss(of, wrench, u).iter().zip(of.weights).map(|(miss, w)| *miss * *w).collect();
    let mut good = S::zero().lt(unit);
    for (j, u) in u.iter().enumerate() {
        let away = of.others[0] * (*u - of.preference[j]);
        let push = (of.dot(&of.geometry[WRENCH * j..][..WRENCH], &force) + away) / steepness;
        let room = S::select(S::zero().lt(push), *u - of.lower[j], of.upper[j] - *u);
        let room = S::select(room.abs().lt(S::constant(f64::INFINITY)), room / unit, S::one());
        let outside = u.lt(of.lower[j]).or(of.upper[j].lt(*u));
        good = good.and((push * room).abs().lt(of.others[5])).and(outside.not());
    }
    good
}

/// B u − w.
fn miss<S: Scalar>(of: &Numbers<S>, wrench: &[S], u: &[S]) -> Vec<S> {
    let row = |k: usize| {
        let made = of.geometry[k..].iter().step_by(WRENCH).zip(u);
        made.fold(of.zero(), |sum, (b, u)| sum + *b * *u) - wrench[k]
    };
    (0..WRENCH).map(row).collect()
}

/// The program of a task, and where its search stands.
fn program_of<S: Scalar>(n: usize, hessian: &[S], state: &[S]) -> (BoxQp<S, MAX_FAST>, Iterate<S, MAX_FAST>) {
    let (mut program, zero, at) = (BoxQp::empty(), [S::zero(); MAX_FAST], Places::of(n));
    let mut x = Iterate { inputs: zero, status: zero, residual: S::zero(), done: state[2 * n] };
    let task = &state[at.task];
    for i in 0..n {
        program.hessian[i][..n].copy_from_slice(&hessian[n * i..][..n]);
        (program.linear[i], program.lower[i], program.upper[i]) = (task[i], task[n + i], task[2 * n + i]);
        (x.inputs[i], x.status[i]) = (state[i], state[n + i]);
    }
    (program, x)
}

/// One step of the search, of those that are not done.
pub(super) fn step<S: Scalar>(n: usize, of: &Numbers<S>, state: &[S], many: bool, tolerances: Tolerances) -> Vec<S> {
    let (program, mut x) = program_of(n, of.hessian, state);
    let done = S::constant(0.5).lt(x.done);
    program.step(n, &mut x, &mut Factor::new(), many, tolerances);
    let now = x.inputs[..n].iter().chain(&x.status[..n]).chain([&x.done]);
    now.zip(state).map(|(now, before)| S::select(done, *before, *now)).collect()
}

/// The last step, the answer and whether it is certified, of those that are not yet.
pub(super) fn end<S: Scalar>(n: usize, of: &Numbers<S>, wrench: &[S], state: &[S], tolerances: Tolerances) -> Vec<S> {
    let (program, mut x) = program_of(n, of.hessian, state);
    program.step(n, &mut x, &mut Factor::new(), false, tolerances);
    let at = Places::of(n);
    let [unit, steepness] = [0, 1].map(|k| state[at.units.start + k]);
    let half = S::constant(0.5);
    let u: Vec<S> = (0..n)
        .map(|j| {
            let free = (x.inputs[j] * unit).max(of.lower[j]).min(of.upper[j]);
            let held = S::select(half.lt(x.status[j]), of.upper[j], free);
            S::select(x.status[j].lt(-half), of.lower[j], held)
        })
        .collect();
    let good = flag::<S>(half.lt(x.done).and(certified(of, wrench, &u, unit, steepness)));
    let earlier = &state[at.answer];
    let open = earlier[n].abs().lt(half);
    let answer = u.iter().chain([&good]).zip(earlier).map(|(now, earlier)| S::select(open, *now, *earlier));
    let status = x.status[..n].iter().zip(&state[n..]).map(|(now, earlier)| S::select(open, *now, *earlier));
    status.chain(answer).collect()
}

/// The gradient over all numbers at an answer, as [`Fast::reverse`].
fn reverse<S: Scalar>(n: usize, of: &Numbers<S>, wrench: &[S], state: &[S], cotangent: &[S]) -> Vec<S> {
    let [rho, cost, ..]: [S; N_OTHER] = std::array::from_fn(|k| of.others[k]);
    let (program, x) = program_of(n, of.hessian, state);
    let u = &state[Places::of(n).answer][..n];
    let mut y = [S::zero(); MAX_FAST];
    for i in 0..n {
        let free = x.status[i].abs().lt(S::constant(0.5));
        y[i] = S::select(free, cotangent[i] / cost, S::zero());
    }
    let mut factor = Factor::new();
    factor.of(n, &program.hessian, &x.status, Tolerances::DOUBLE);
    factor.solve(n, &mut y);
    let column = |j: usize| &of.geometry[WRENCH * j..][..WRENCH];
    let miss = miss(of, wrench, u);
    let force: Vec<S> = miss.iter().zip(of.weights).map(|(miss, w)| *miss * *w).collect();
    let pulled: Vec<S> = (0..WRENCH).map(|k| (0..n).fold(of.zero(), |sum, j| sum + column(j)[k] * y[j])).collect();
    let weights: Vec<S> = pulled.iter().zip(&miss).map(|(pulled, miss)| -*pulled * *miss).collect();
    let pulled: Vec<S> = pulled.iter().zip(of.weights).map(|(pulled, w)| *pulled * *w).collect();
    let regularisation = (0..n).fold(of.zero(), |sum, j| sum - y[j] * (u[j] - of.preference[j]));
    let places = (0..n).flat_map(|j| (0..WRENCH).map(move |k| (j, k)));
    let geometry: Vec<S> = places.map(|(j, k)| -(y[j] * force[k] + pulled[k] * u[j])).collect();
    let bounds: Vec<[S; 2]> = (0..n)
        .map(|j| {
            let through = column(j).iter().zip(&pulled).fold(cotangent[j], |sum, (b, pulled)| sum - *b * *pulled);
            // where both bounds are one, it is the bound that the gradient pushes to
            let push = of.dot(column(j), &force) + rho * (u[j] - of.preference[j]);
            let pushed = S::select(S::zero().lt(push), -S::one(), S::one());
            let status = S::select(of.lower[j].lt(of.upper[j]), x.status[j], pushed);
            let at = |held: S::Mask| S::select(held, through, S::zero());
            [at(status.lt(S::zero())), at(S::zero().lt(status))]
        })
        .collect();
    let preference = y[..n].iter().map(|y| rho * *y);
    (pulled.iter().copied().chain(weights).chain([regularisation]).chain(geometry).chain(preference))
        .chain((0..2).flat_map(|k| bounds.iter().map(move |bounds| bounds[k])))
        .collect()
}

/// Numbers of a problem of `n` inputs and its wrench, as an allocation function takes them.
fn n_argument(n: usize) -> usize {
    2 * WRENCH + 1 + (WRENCH + 3) * n
}

/// The recorded parts for a number of inputs.
pub(super) struct SideBySide {
    n: usize,
    begin: Executable<Row>,
    /// Frees many inputs at once, or one.
    steps: [Executable<Row>; 2],
    end: Executable<Row>,
    reverse: Executable<Row>,
}

impl SideBySide {
    /// # Errors
    /// Where no machine code can be made: one by one is faster than interpreted.
    pub(super) fn new(n: usize) -> Result<Arc<Self>, WhyInterpreted> {
        let (m, at) = (n_number(n), Places::of(n));
        let place = |array: u8, rows: Range<usize>| rows.map(move |row| Place { array, row: row as u32 });
        let problem = || place(0, 0..m).chain(place(1, 0..WRENCH));
        let all = at.answer.end;
        let begin = executable(m + WRENCH, problem().collect(), place(2, 0..all).collect(), |z| {
            begin(n, &Numbers::of(n, z), &z[m..])
        })?;
        let made = |many: bool| {
            let arguments = place(0, 0..m).chain(place(2, 0..all)).collect();
            executable(m + all, arguments, place(2, at.iterate.clone()).collect(), |z| {
                step(n, &Numbers::of(n, z), &z[m..], many, Tolerances::DOUBLE)
            })
        };
        let steps = [made(true)?, made(false)?];
        let results = place(2, n..2 * n).chain(place(2, at.answer.clone())).collect();
        let end = executable(m + WRENCH + all, problem().chain(place(2, 0..all)).collect(), results, |z| {
            end(n, &Numbers::of(n, z), &z[m..m + WRENCH], &z[m + WRENCH..], Tolerances::DOUBLE)
        })?;
        let arguments = problem().chain(place(2, 0..all)).chain(place(1, WRENCH..WRENCH + n)).collect();
        let gradient = place(3, 0..n_argument(n)).collect();
        let reverse = executable(m + WRENCH + all + n, arguments, gradient, |z| {
            let (state, cotangent) = z[m + WRENCH..].split_at(all);
            reverse(n, &Numbers::of(n, z), &z[m..m + WRENCH], state, cotangent)
        })?;
        Ok(Arc::new(Self { n, begin, steps, end, reverse }))
    }

    /// Instructions in about, for `n` inputs.
    pub(super) fn n_instruction(n: usize) -> usize {
        n * n * n + 200 * n
    }
}

/// A recorded part as machine code.
fn executable(
    n_argument: usize,
    arguments: Vec<Place>,
    results: Vec<Place>,
    part: impl FnOnce(&[Trace]) -> Vec<Trace>,
) -> Result<Executable<Row>, WhyInterpreted> {
    let program = Program::compile(&Recording::of(n_argument, part)).map_err(|_| WhyInterpreted::TooLarge)?;
    let layout = RowLayout::new(arguments, results).map_err(|_| WhyInterpreted::TooLarge)?;
    let executable = Executable::new(&program, layout).map_err(|_| WhyInterpreted::TooLarge)?;
    executable.why_interpreted().map_or(Ok(executable), Err)
}

/// Eight answers, with the room that they take.
pub(super) struct Eight {
    of: Arc<SideBySide>,
    problem: Lines,
    /// w, and behind it cotangents.
    wrench: Lines,
    state: Lines,
    gradient: Lines,
    begin: Work<Row>,
    steps: [Work<Row>; 2],
    end: Work<Row>,
    reverse: Work<Row>,
}

impl Eight {
    pub(super) fn of(of: &Arc<SideBySide>) -> Self {
        Self {
            problem: Lines::zeros(n_number(of.n)),
            wrench: Lines::zeros(WRENCH + of.n),
            state: Lines::zeros(Places::of(of.n).answer.end),
            gradient: Lines::zeros(n_argument(of.n)),
            begin: of.begin.work(),
            steps: [0, 1].map(|k| of.steps[k].work()),
            end: of.end.work(),
            reverse: of.reverse.work(),
            of: of.clone(),
        }
    }

    /// The problem of the answers that follow.
    pub(super) fn set_problem(&mut self, problem: &Problem, fast: &Fast, tolerance: f64) {
        write(problem, fast, tolerance, &mut self.problem);
    }

    /// Answers the wrenches of some points, eight at most; bits of those that are certified, from the first on.
    pub(super) fn answer(&mut self, points: &mut Points<'_>, own: Range<usize>) -> u32 {
        for (k, row) in self.wrench[..WRENCH].iter_mut().enumerate() {
            row.iter_mut().zip(&points.argument(k)[own.clone()]).for_each(|(w, x)| *w = f64::from(*x));
        }
        let n_input = self.of.n;
        let answer = self.solve(own.len());
        for (k, row) in answer[..n_input].iter().enumerate() {
            points.result_mut(k)[own.clone()].iter_mut().zip(row).for_each(|(y, u)| *y = *u as f32);
        }
        certified_of(&answer[n_input], own.len())
    }

    /// Likewise the gradients, of cotangents that stand behind the numbers of a point; without any where cotangents are zeros.
    pub(super) fn reverse(&mut self, points: &mut Points<'_>, own: Range<usize>) -> u32 {
        let (n, n_argument) = (own.len(), self.gradient.len());
        for (k, row) in self.wrench.iter_mut().enumerate() {
            let k = if k < WRENCH { k } else { n_argument + k - WRENCH };
            row.iter_mut().zip(&points.argument(k)[own.clone()]).for_each(|(w, x)| *w = f64::from(*x));
        }
        let n_input = self.of.n;
        let certified = certified_of(&self.solve(n)[n_input], n);
        let Self { of, problem, wrench, state, gradient, reverse, .. } = self;
        let arrays = &mut [Rows::Read(problem), Rows::Read(wrench), Rows::Read(state), Rows::Write(gradient)];
        assert!(of.reverse.run(reverse, arrays, n).is_ok(), "rows of gradients side by side");
        let moves: Row =
            std::array::from_fn(|lane| f64::from(u8::from(wrench[WRENCH..].iter().any(|row| row[lane] != 0.0))));
        for (k, row) in gradient.iter().enumerate() {
            let to = points.result_mut(k)[own.clone()].iter_mut();
            to.zip(row.iter().zip(&moves))
                .for_each(|(to, (x, moves))| *to = if *moves > 0.5 { *x as f32 } else { 0.0 });
        }
        certified | certified_of(&moves.map(|moves| 1.0 - moves), n)
    }

    /// Answers the wrenches of the first `n` lanes: u by rows of inputs, then 1 where it is certified.
    fn solve(&mut self, n: usize) -> &[Row] {
        let Self { of, problem, wrench, state, begin, steps, end, .. } = self;
        let at = Places::of(of.n);
        let arrays = &mut [Rows::Read(problem), Rows::Read(wrench), Rows::Write(state)];
        let mut ran = of.begin.run(begin, arrays, n).is_ok();
        let is_done = |arrays: &[Rows<Row>; 3]| {
            let Rows::Write(state) = &arrays[2] else { return true };
            state[at.iterate.end - 1][..n].iter().all(|done| *done > 0.5)
        };
        if !is_done(arrays) {
            for k in 0..MAX_STEPS {
                let which = usize::from(k >= MAX_STEPS / 4);
                ran &= of.steps[which].run(&mut steps[which], arrays, n).is_ok();
                if is_done(arrays) {
                    break;
                }
            }
            ran &= of.end.run(end, arrays, n).is_ok();
        }
        assert!(ran, "rows of answers side by side");
        &state[at.answer]
    }
}

/// A bit for each of the first `n` lanes whose number is above a half.
fn certified_of(flags: &Row, n: usize) -> u32 {
    (0..n).filter(|lane| flags[*lane] > 0.5).fold(0, |bits, lane| bits | 1 << lane)
}

#[cfg(test)]
mod tests {
    use super::super::allocator::{Allocator, AllocatorSettings};
    use super::super::function::AllocationFunction;
    use super::super::variation::Variation;
    use super::*;
    use autodiff::native::availability;
    use autodiff::program::BLOCK;
    use dynamics::vehicles;
    use rng::{Purpose, Stream};

    /// Wrenches of all sizes, some not finite, around what half of all thrusts deliver.
    fn wrenches(problem: &Problem, stream: &mut Stream) -> [[f32; BLOCK]; WRENCH] {
        let half: Vec<f64> = problem.upper.iter().map(|x| 0.5 * x.min(6.0)).collect();
        let (size, center) = (half.iter().sum::<f64>(), problem.delivered(&half));
        let mut rows = [[0.0; BLOCK]; WRENCH];
        for lane in 0..BLOCK {
            let spread = size * [0.0, 0.02, 0.3, 3.0, 1e6][stream.below(5) as usize];
            for k in 0..WRENCH {
                rows[k][lane] = (center[k] + spread * stream.uniform(-1.0, 1.0)) as f32;
            }
            if stream.below(40) == 0 {
                rows[stream.below(6) as usize][lane] =
                    [f32::NAN, f32::INFINITY, f32::MAX, -0.0][stream.below(4) as usize];
            }
        }
        rows
    }

    fn problems() -> Vec<Problem> {
        let mut all: Vec<Problem> =
            vehicles::all().iter().filter_map(|vehicle| Problem::of_vehicle(vehicle).ok()).collect();
        let mut lame = all[0].clone();
        (lame.lower[1], lame.upper[1]) = (0.0, 0.0);
        lame.preference[2] = 0.3 * lame.upper[2];
        let mut open = all[1].clone();
        open.lower.fill(f64::NEG_INFINITY);
        open.upper[0] = f64::INFINITY;
        all.extend([lame, open]);
        // as blocks of `f32` bring them
        for problem in &mut all {
            let lists = [&mut problem.preference, &mut problem.lower, &mut problem.upper];
            let numbers = problem.geometry.iter_mut().chain(&mut problem.weights).chain(lists.into_iter().flatten());
            numbers.chain([&mut problem.regularisation]).for_each(|x| *x = f64::from(*x as f32));
        }
        all
    }

    #[test]
    fn answers_side_by_side_are_those_one_by_one_to_the_bit() {
        let mut stream = Stream::new(3, 0, 0, Purpose::user(59));
        for problem in problems() {
            let function = AllocationFunction::new(problem.clone()).unwrap();
            let n = problem.n_input();
            let recording = Recording::of(WRENCH, |w| {
                let mut u = vec![Trace::zero(); n];
                function.call(&problem, &std::array::from_fn(|k| w[k]), &mut u);
                u
            });
            let program = Program::compile(&recording).unwrap();
            let back = Program::compile(&recording.adjoint(0..WRENCH)).unwrap();
            let (mut workspace, mut back_workspace) = (program.block_workspace(), back.block_workspace());
            let (mut change, mut gradient) = (Variation::zero(&problem), vec![[0.0; BLOCK]; WRENCH]);
            let settings = AllocatorSettings { warm: false, ..AllocatorSettings::default() };
            let mut alone = Allocator::with_settings(problem.clone(), settings).unwrap();
            let mut answers = vec![[0.0; BLOCK]; n];
            let mut held = 0;
            for _ in 0..60 {
                let rows = wrenches(&problem, &mut stream);
                program.evaluate_block(&mut workspace, &rows, &mut answers);
                let up =
                    |k: usize| std::array::from_fn(|l| if l % 7 == 0 { 0.0 } else { (k * 5 + l) as f32 * 0.1 - 3.0 });
                let seeded: Vec<[f32; BLOCK]> = rows.into_iter().chain((0..n).map(up)).collect();
                back.evaluate_block(&mut back_workspace, &seeded, &mut gradient);
                for lane in 0..BLOCK {
                    let wrench = std::array::from_fn(|k| f64::from(rows[k][lane]));
                    alone.forget();
                    let solution = alone.solve(&wrench).clone();
                    held += usize::from(!solution.residual.is_finite());
                    let seed: Vec<f64> = seeded[WRENCH..].iter().map(|row| f64::from(row[lane])).collect();
                    let moves = seed.iter().any(|x| *x != 0.0);
                    let is_same = |a: f32, b: f32| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan();
                    let known = alone.reverse(&seed, &mut change).is_some();
                    for k in 0..WRENCH {
                        let expected = if known { change.wrench[k] as f32 } else { f32::NAN };
                        let (expected, got) = (if moves { expected } else { 0.0 }, gradient[k][lane]);
                        assert!(is_same(got, expected), "gradient {k} at {wrench:?}: {got} for {expected}");
                    }
                    for k in 0..n {
                        let expected = if solution.residual.is_finite() { solution.inputs[k] as f32 } else { f32::NAN };
                        assert!(is_same(answers[k][lane], expected), "{wrench:?}: {} for {expected}", answers[k][lane]);
                    }
                }
            }
            assert!((1..600).contains(&held), "{held} were held");
        }
    }

    #[test]
    fn most_answers_are_certified_side_by_side() {
        let mut stream = Stream::new(4, 0, 0, Purpose::user(59));
        for problem in problems().into_iter().filter(|_| availability().is_ok()) {
            let of = SideBySide::new(problem.n_input()).unwrap();
            let allocator = Allocator::new(problem.clone()).unwrap();
            let (_, fast, tolerance) = allocator.fast_paths().unwrap();
            let mut eight = Eight::of(&of);
            eight.set_problem(&problem, fast, tolerance);
            let rows = wrenches(&problem, &mut stream).concat();
            let mut results = vec![0.0; problem.n_input() * BLOCK];
            let mut points = Points::new(BLOCK, BLOCK, &rows, &mut results);
            let certified: u32 =
                (0..BLOCK).step_by(LINE).map(|first| eight.answer(&mut points, first..first + LINE).count_ones()).sum();
            assert!(certified >= 50, "{certified} of 64 for {problem:?}");
        }
    }
}
