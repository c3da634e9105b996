//! An allocation as a differentiable function: for rollouts, duals and programs.

use super::allocator::{Allocator, AllocatorSettings};
use super::c_text::allocation_text;
use super::fast::MAX_FAST;
use super::problem::{Problem, WRENCH};
use super::side_by_side::{Eight, SideBySide};
use super::variation::Variation;
use autodiff::columns::LINE;
use autodiff::custom::reverse_at;
use autodiff::emit::{CFunction, CText};
use autodiff::native::policy::{Fallback, OnDemand};
use autodiff::{CustomFunction, Operation, Points, Scalar};
use base::error::{Error, Result};
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

/// u*(x), where x are all numbers of a [`Problem`] with its wrench, in the order of [`Variation::numbers`]: wrench 6,
/// weights 6, ρ, geometry by columns, u_pref, lower, upper, then cone by cone, row by row, constant and coefficients.
///
/// The derivative is that of [`Allocator::forward`] and [`Allocator::reverse`]. An answer that cannot be certified is NaN, and so is one
/// whose cones have moved until the template's anchor is outside: choose the anchor with room. Every evaluation starts cold, so
/// that equal arguments have equal answers. After warm-up an evaluation allocates nothing,
/// unless it is left to clarabel: cones, or more inputs than the active set takes. Over blocks of environments that share all numbers but
/// the wrench, eight answers are found side by side by machine code, which is made when enough were asked for; their bits are the same.
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::autodiff::Scalar;
/// use omnidrones::controllers::allocation::{AllocationFunction, Problem};
/// use omnidrones::dynamics::vehicles;
/// use num_dual::Dual64;
///
/// let problem = Problem::of_vehicle(&vehicles::by_name("hummingbird")?)?;
/// let function = AllocationFunction::new(problem.clone())?;
/// // more thrust than there is: a newton more changes nothing
/// let wrench = [0.0, 0.0, 1e3, 0.0, 0.0, 0.0].map(|w| Dual64::new(w, 1.0));
/// let mut thrusts = [Dual64::from(0.0); 4];
/// function.call(&problem, &wrench, &mut thrusts);
/// assert_eq!((thrusts[0].re, thrusts[0].eps), (problem.upper[0], 0.0));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Clone)]
pub struct AllocationFunction {
    operation: Operation,
    n_number: usize,
}

/// Most numbers that a call keeps on the stack; the inputs of the active set have fewer.
const FEW: usize = 256;

/// Numbers in, inputs out.
struct Inner {
    template: Problem,
    n_number: usize,
    /// As many as have evaluated at once.
    idle: Mutex<Vec<Work>>,
    side_by_side: OnDemand<Arc<SideBySide>>,
}

/// What an evaluation needs.
struct Work {
    allocator: Allocator,
    /// The numbers asked for last.
    at: Variation,
    /// Whether they make a problem, which the allocator then holds.
    ready: bool,
    /// Whether its answer is certified.
    solved: bool,
    /// A direction, or a gradient.
    change: Variation,
    /// Those of the first point of a block.
    numbers: Vec<f64>,
    eight: Option<Eight>,
    /// Whether those have the numbers of the last time.
    eight_ready: bool,
}

impl AllocationFunction {
    /// For problems with the structure of `template`.
    ///
    /// # Errors
    /// As [`Problem::validate`].
    pub fn new(template: Problem) -> Result<Self> {
        template.validate()?;
        let n_number = Variation::zero(&template).numbers().count();
        let n = template.n_input();
        if n_number > u16::MAX as usize {
            return Err(Error::limit("allocation: numbers", n_number, u16::MAX, format!("{n} inputs are too many.")));
        }
        Ok(Self {
            operation: Operation::new(Inner {
                template,
                n_number,
                idle: Mutex::default(),
                side_by_side: OnDemand::default(),
            }),
            n_number,
        })
    }

    /// Length of x.
    pub fn n_number(&self) -> usize {
        self.n_number
    }

    /// u*, `[n_input]`, with a wrench (N, N m) over any scalar and all other numbers from `problem`; derivatives are with respect to
    /// the wrench.
    ///
    /// # Panics
    /// If `problem` has another structure than the template, or `inputs` not one slot per input.
    pub fn call<S: Scalar>(&self, problem: &Problem, wrench: &[S; WRENCH], inputs: &mut [S]) {
        assert_eq!(WRENCH + constants(problem).count(), self.n_number, "numbers of the problem and of the template");
        let (mut few, mut many) = ([S::zero(); FEW], Vec::new());
        let numbers = if self.n_number <= FEW {
            &mut few[..self.n_number]
        } else {
            many.resize(self.n_number, S::zero());
            &mut many[..]
        };
        let (first, rest) = numbers.split_at_mut(WRENCH);
        first.copy_from_slice(wrench);
        rest.iter_mut().zip(constants(problem)).for_each(|(to, x)| *to = S::constant(*x));
        self.operation.call(numbers, inputs);
    }

    /// u*, `[n_input]`, of all [`n_number`](Self::n_number) numbers, see [`AllocationFunction`] for their order.
    ///
    /// # Panics
    /// If a slice has another length.
    pub fn call_numbers<S: Scalar>(&self, numbers: &[S], inputs: &mut [S]) {
        self.operation.call(numbers, inputs);
    }
}

/// All numbers but the wrench, in the order of [`Variation::numbers`].
fn constants(problem: &Problem) -> impl Iterator<Item = &f64> {
    let rows = problem.cones.iter().flat_map(|cone| cone.rows());
    let rows = rows.flat_map(|row| std::iter::once(&row.constant).chain(row.terms.iter().map(|(_, a)| a)));
    (problem.weights.iter().chain(std::iter::once(&problem.regularisation)))
        .chain(problem.geometry.iter())
        .chain(&problem.preference)
        .chain(&problem.lower)
        .chain(&problem.upper)
        .chain(rows)
}

/// Gives a problem the numbers of `at`.
fn give(at: &Variation, problem: &mut Problem) {
    (problem.weights, problem.regularisation) = (at.weights, at.regularisation);
    problem.geometry.copy_from(&at.geometry);
    problem.preference.copy_from_slice(&at.preference);
    problem.lower.copy_from_slice(&at.lower);
    problem.upper.copy_from_slice(&at.upper);
    for (cone, rows) in problem.cones.iter_mut().zip(&at.cones) {
        for (row, by) in cone.rows_mut().zip(rows) {
            row.constant = by.constant;
            row.terms.iter_mut().zip(&by.terms).for_each(|((_, a), by)| *a = *by);
        }
    }
}

impl Work {
    fn new(template: &Problem) -> Result<Self> {
        let allocator = Allocator::with_settings(
            template.clone(),
            AllocatorSettings { warm: false, ..AllocatorSettings::default() },
        )?;
        let zero = Variation::zero(template);
        Ok(Self {
            allocator,
            at: zero.clone(),
            ready: false,
            solved: false,
            change: zero,
            numbers: Vec::new(),
            eight: None,
            eight_ready: false,
        })
    }

    /// Whether the numbers make a problem whose answer is certified; the allocator then holds it. Numbers that are those of the
    /// last time are not prepared again.
    fn solve(&mut self, x: &[f64]) -> bool {
        let known = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
        let has_task = self.at.wrench.iter().zip(x).all(known);
        let has_problem = self.ready && self.at.numbers().zip(x).skip(WRENCH).all(known);
        if self.solved && has_task && has_problem {
            return true;
        }
        self.at.numbers_mut().zip(x).for_each(|(to, x)| *to = *x);
        if has_problem {
            self.allocator.forget();
        } else {
            self.restart();
        }
        self.solved = self.ready && self.allocator.solve(&self.at.wrench).residual.is_finite();
        self.solved
    }

    /// Gives the allocator the problem of the numbers behind the wrench, if they make one.
    fn prepare(&mut self, x: &[f64]) {
        let known = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
        if !(self.ready && self.at.numbers().zip(x).skip(WRENCH).all(known)) {
            self.at.numbers_mut().zip(x).for_each(|(to, x)| *to = *x);
            self.restart();
            self.solved = false;
        }
    }

    fn restart(&mut self) {
        self.ready = self.allocator.restart(|problem| give(&self.at, problem)).is_ok();
        self.eight_ready = false;
    }

    /// The answer, NaN where there is none.
    fn value(&mut self, x: &[f64], y: &mut [f64]) {
        self.solve(x);
        self.write(y);
    }

    /// The answer to another wrench for the problem of the last time.
    fn value_of_wrench(&mut self, wrench: &[f64], y: &mut [f64]) {
        self.at.wrench.copy_from_slice(wrench);
        if self.ready {
            self.allocator.forget();
            self.solved = self.allocator.solve(&self.at.wrench).residual.is_finite();
        }
        self.write(y);
    }

    /// What points of the problem of the last time ask for: eight side by side, and one by one what is not certified then.
    fn of_points(
        &mut self,
        points: &mut Points<'_>,
        side_by_side: Option<&Arc<SideBySide>>,
        eight_at_once: impl Fn(&mut Eight, &mut Points<'_>, Range<usize>) -> u32,
        one: impl Fn(&mut Self, &mut Points<'_>, usize),
    ) {
        let mut eight = self.eight.take().or_else(|| side_by_side.map(Eight::of));
        for first in (0..points.len()).step_by(LINE) {
            let own = first..points.len().min(first + LINE);
            let mut certified = 0_u32;
            let prepared = self.allocator.fast_paths().filter(|_| self.ready);
            if let Some((eight, (problem, fast, tolerance))) = eight.as_mut().zip(prepared) {
                if !std::mem::replace(&mut self.eight_ready, true) {
                    eight.set_problem(problem, fast, tolerance);
                }
                certified = eight_at_once(eight, points, own.clone());
            }
            own.filter(|point| certified >> (point - first) & 1 == 0).for_each(|point| one(self, points, point));
        }
        self.eight = eight;
    }

    fn write(&self, y: &mut [f64]) {
        if self.solved {
            y.copy_from_slice(&self.allocator.solution().inputs);
        } else {
            y.fill(f64::NAN);
        }
    }

    /// Its gradient with `y_bar`, NaN where there is none.
    fn reverse(&mut self, x: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
        if self.solve(x) && self.allocator.reverse(y_bar, &mut self.change).is_some() {
            x_bar.iter_mut().zip(self.change.numbers()).for_each(|(to, x)| *to = *x);
        } else {
            x_bar.fill(f64::NAN);
        }
    }
}

impl Inner {
    /// Runs `work` on a workspace that is not in use; `None` without one.
    fn with<R>(&self, work: impl FnOnce(&mut Work) -> R) -> Option<R> {
        let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = idle().pop();
        let mut own = taken.or_else(|| Work::new(&self.template).ok())?;
        let result = work(&mut own);
        idle().push(own);
        Some(result)
    }
}

impl Inner {
    /// Whether all points ask for one problem, which the allocator then holds: it is looked at once.
    fn prepare(&self, work: &mut Work, points: &Points<'_>) -> bool {
        let is_same = |row: &[f32]| row.iter().all(|x| x.to_bits() == row[0].to_bits());
        if points.is_empty() || !(WRENCH..self.n_number).all(|k| is_same(points.argument(k))) {
            return false;
        }
        let mut first = std::mem::take(&mut work.numbers);
        first.clear();
        first.extend((0..self.n_number).map(|k| f64::from(points.argument(k)[0])));
        work.prepare(&first);
        work.numbers = first;
        true
    }

    /// What answers eight at once, where it pays for so many more points.
    fn side_by_side(&self, n_point: usize) -> Option<Arc<SideBySide>> {
        let n = self.template.n_input();
        if !self.template.cones.is_empty() || n > MAX_FAST {
            return None;
        }
        let n_instruction = SideBySide::n_instruction(n);
        self.side_by_side.ask(Fallback::Compiled, n_instruction, n_point as u64, || SideBySide::new(n))
    }
}

impl CustomFunction for Inner {
    fn n_input(&self) -> usize {
        self.n_number
    }
    fn n_output(&self) -> usize {
        self.template.n_input()
    }
    fn value(&self, x: &[f64], y: &mut [f64]) {
        if self.with(|work| work.value(x, y)).is_none() {
            y.fill(f64::NAN);
        }
    }
    /// Of one problem: all numbers but the wrench are known.
    fn c_function(&self, text: &mut CText, name: &str, known: &[Option<f64>]) -> Result<Option<CFunction>> {
        let (wrench, rest) = known.split_at(WRENCH);
        let Some(rest) = rest.iter().copied().collect::<Option<Vec<f64>>>() else { return Ok(None) };
        let mut at = Variation::zero(&self.template);
        at.numbers_mut().zip([0.0; WRENCH].iter().chain(&rest)).for_each(|(to, x)| *to = *x);
        let mut problem = self.template.clone();
        give(&at, &mut problem);
        allocation_text(text, name, problem, wrench)
    }
    fn forward(&self, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        let good = self.with(|work| {
            work.change.numbers_mut().zip(dx).for_each(|(to, dx)| *to = *dx);
            work.solve(x) && work.allocator.forward(&work.change, dy).is_some()
        });
        if good != Some(true) {
            dy.fill(f64::NAN);
        }
    }
    fn reverse(&self, x: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
        if self.with(|work| work.reverse(x, y_bar, x_bar)).is_none() {
            x_bar.fill(f64::NAN);
        }
    }
    fn value_block(&self, points: &mut Points<'_>) {
        let n = self.n_number;
        let run = |work: &mut Work| {
            if !self.prepare(work, points) {
                return points.each(n, |x, y| work.value(x, y));
            }
            let one = |work: &mut Work, points: &mut Points<'_>, point| {
                points.each_of([point], WRENCH, |wrench, y| work.value_of_wrench(wrench, y));
            };
            work.of_points(points, self.side_by_side(points.len()).as_ref(), Eight::answer, one);
        };
        if self.with(run).is_none() {
            points.each(n, |_, y| y.fill(f64::NAN));
        }
    }
    fn reverse_block(&self, points: &mut Points<'_>) {
        let n = self.n_number;
        let all = n + self.n_output();
        let run = |work: &mut Work| {
            let one = |work: &mut Work, points: &mut Points<'_>, point| {
                points.each_of([point], all, |z, x_bar| {
                    reverse_at(z, n, x_bar, |x, y_bar, x_bar| work.reverse(x, y_bar, x_bar));
                });
            };
            if self.prepare(work, points) {
                work.of_points(points, self.side_by_side(points.len()).as_ref(), Eight::reverse, one);
            } else {
                (0..points.len()).for_each(|point| one(work, points, point));
            }
        };
        if self.with(run).is_none() {
            points.each(all, |_, x_bar| x_bar.fill(f64::NAN));
        }
    }
}
