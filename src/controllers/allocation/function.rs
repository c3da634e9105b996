//! An allocation as a differentiable function: for rollouts, duals and programs.

use super::allocator::{Allocator, Settings, Solution};
use super::gradient::Sensitivity;
use super::problem::{Problem, WRENCH};
use super::variation::Variation;
use crate::autodiff::{CustomFunction, Operation, Scalar};
use crate::error::{Error, Result};

/// u*(x), where x are all numbers of a [`Problem`] with its wrench, in the order of [`Variation::numbers`]: wrench 6,
/// weights 6, ρ, geometry by columns, u_pref, lower, upper, then cone by cone, row by row, constant and coefficients.
///
/// The derivative is that of [`Sensitivity`]. An answer that cannot be certified is NaN, and so is one whose cones have
/// moved until the template's anchor is outside: choose the anchor with room. Every evaluation starts cold, so
/// that equal arguments have equal answers.
///
/// ```
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

/// Numbers in, inputs out.
struct Inner {
    template: Problem,
    n_number: usize,
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
        Ok(Self { operation: Operation::new(Inner { template, n_number }), n_number })
    }

    /// Length of x.
    pub fn n_number(&self) -> usize {
        self.n_number
    }

    /// u* with a wrench that lives and all other numbers from `problem`.
    ///
    /// # Panics
    /// If `problem` has another structure than the template, or `inputs` not one slot per input.
    pub fn call<S: Scalar>(&self, problem: &Problem, wrench: &[S; WRENCH], inputs: &mut [S]) {
        let mut numbers: Vec<S> = flat(problem, &[0.0; WRENCH]).into_iter().map(S::constant).collect();
        numbers[..WRENCH].copy_from_slice(wrench);
        self.operation.call(&numbers, inputs);
    }

    /// u* of all numbers, see [`AllocationFunction`] for their order.
    ///
    /// # Panics
    /// If a slice has another length.
    pub fn call_numbers<S: Scalar>(&self, numbers: &[S], inputs: &mut [S]) {
        self.operation.call(numbers, inputs);
    }
}

/// All numbers in the order of [`Variation::numbers`].
pub fn flat(problem: &Problem, wrench: &[f64; WRENCH]) -> Vec<f64> {
    let mut all = Variation::zero(problem);
    (all.wrench, all.weights, all.regularisation) = (*wrench, problem.weights, problem.regularisation);
    all.geometry.copy_from(&problem.geometry);
    all.preference.copy_from_slice(&problem.preference);
    all.lower.copy_from_slice(&problem.lower);
    all.upper.copy_from_slice(&problem.upper);
    for (cone, rows) in problem.cones.iter().zip(&mut all.cones) {
        for (row, to) in cone.rows().zip(rows) {
            to.constant = row.constant;
            to.terms.iter_mut().zip(&row.terms).for_each(|(to, (_, a))| *to = *a);
        }
    }
    all.numbers().copied().collect()
}

impl Inner {
    /// The problem of these numbers.
    fn problem(&self, x: &[f64]) -> (Problem, [f64; WRENCH]) {
        let mut numbers = Variation::zero(&self.template);
        numbers.numbers_mut().zip(x).for_each(|(to, x)| *to = *x);
        let mut problem = self.template.clone();
        (problem.weights, problem.regularisation) = (numbers.weights, numbers.regularisation);
        problem.geometry.copy_from(&numbers.geometry);
        problem.preference.copy_from_slice(&numbers.preference);
        problem.lower.copy_from_slice(&numbers.lower);
        problem.upper.copy_from_slice(&numbers.upper);
        for (cone, rows) in problem.cones.iter_mut().zip(&numbers.cones) {
            for (row, by) in cone.rows_mut().zip(rows) {
                row.constant = by.constant;
                row.terms.iter_mut().zip(&by.terms).for_each(|((_, a), by)| *a = *by);
            }
        }
        (problem, numbers.wrench)
    }

    /// `None` where the numbers make no problem or its answer is not certified.
    fn solve(&self, x: &[f64]) -> Option<(Problem, [f64; WRENCH], Solution)> {
        let (problem, wrench) = self.problem(x);
        let mut allocator = Allocator::with_settings(problem, Settings { warm: false, ..Settings::default() }).ok()?;
        let solution = allocator.solve(&wrench).clone();
        let problem = allocator.into_problem();
        solution.residual.is_finite().then_some((problem, wrench, solution))
    }

    fn sensitivity(&self, x: &[f64]) -> Option<Sensitivity> {
        let (problem, wrench, solution) = self.solve(x)?;
        Sensitivity::new(&problem, &wrench, &solution)
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
        match self.solve(x) {
            Some((_, _, solution)) => y.copy_from_slice(&solution.inputs),
            None => y.fill(f64::NAN),
        }
    }
    fn forward(&self, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        let mut change = Variation::zero(&self.template);
        change.numbers_mut().zip(dx).for_each(|(to, dx)| *to = *dx);
        match self.sensitivity(x) {
            Some(at) => dy.copy_from_slice(&at.forward(&change)),
            None => dy.fill(f64::NAN),
        }
    }
    fn reverse(&self, x: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
        match self.sensitivity(x) {
            Some(at) => x_bar.iter_mut().zip(at.reverse(y_bar).numbers()).for_each(|(to, x)| *to = *x),
            None => x_bar.fill(f64::NAN),
        }
    }
}
