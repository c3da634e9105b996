//! Functions that are not straight-line, called by kernels that are: solvers whose derivative is known in closed form.
//!
//! A quadratic program takes as many pivots as it takes, so it cannot be written over [`Scalar`]; the derivative of its
//! solution is one linear system (implicit differentiation). A [`CustomFunction`] says both in `f64`, and an
//! [`Operation`] made of it is called by kernels of any scalar:
//!
//! | scalar | a call |
//! |---|---|
//! | `f64` | the value |
//! | `f32`, lanes | the value, lane by lane through `f64`: right, and as slow as that many solves |
//! | duals | the value, and `forward` for each direction that is not zero |
//! | [`Jet`](super::jet::Jet) | the value, and `forward` for the series |
//! | [`Trace`](super::Trace) | one call in the [`Program`](super::Program); its adjoint is one call of `reverse` |
//!
//! Calls with equal arguments are made once, and calls that no result needs not at all. Second derivatives are not asked
//! for. Where one would be needed (a mixed part of a `HyperDual64`, an order above the first of a jet, the adjoint of an
//! adjoint) the result is NaN, so that what is missing is not taken for zero.

use super::emit::{CFunction, CText};
use super::scalar::Scalar;
use base::error::Result;
use std::fmt;
use std::hash::{Hash, Hasher};
use std::sync::{Arc, OnceLock};

/// A function y = f(x) in `f64` with its derivative J = ∂f/∂x, given by how it acts.
///
/// Equal arguments must give equal results: a program may make one call where a kernel makes two. Arguments may be
/// anything, also NaN where one environment of a batch diverged: report failure as NaN, do not panic. Scratch belongs on
/// the stack where evaluations shall not allocate.
///
/// ```
/// # use omnidrones_autodiff::omnidrones;
/// use omnidrones::autodiff::{CustomFunction, Operation, Scalar};
/// use num_dual::Dual64;
///
/// /// The real root of y³ + y = x, by as many Newton steps as it takes.
/// struct Root;
/// impl CustomFunction for Root {
///     fn n_input(&self) -> usize { 1 }
///     fn n_output(&self) -> usize { 1 }
///     fn value(&self, x: &[f64], y: &mut [f64]) {
///         y[0] = 0.0;
///         for _ in 0..100 {
///             let step = (y[0].powi(3) + y[0] - x[0]) / (3.0 * y[0] * y[0] + 1.0);
///             y[0] -= step;
///             if step.abs() < 1e-15 { return }
///         }
///     }
///     fn forward(&self, x: &[f64], dx: &[f64], dy: &mut [f64]) {
///         let mut y = [0.0];
///         self.value(x, &mut y);
///         dy[0] = dx[0] / (3.0 * y[0] * y[0] + 1.0);
///     }
///     fn reverse(&self, x: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
///         self.forward(x, y_bar, x_bar); // 1 × 1: its own transpose
///     }
/// }
///
/// let root = Operation::new(Root);
/// let mut y = [Dual64::from(0.0)];
/// root.call(&[Dual64::new(10.0, 1.0)], &mut y);
/// assert!((y[0].re - 2.0).abs() < 1e-12 && (y[0].eps - 1.0 / 13.0).abs() < 1e-12);
/// ```
pub trait CustomFunction: Send + Sync + 'static {
    /// Length of x.
    fn n_input(&self) -> usize;
    /// Length of y.
    fn n_output(&self) -> usize;
    /// `y` = f(`x`), with x `[n_input]` and y `[n_output]`.
    fn value(&self, x: &[f64], y: &mut [f64]);
    /// `dy` = J(`x`) `dx`, with dx `[n_input]` and dy `[n_output]`.
    fn forward(&self, x: &[f64], dx: &[f64], dy: &mut [f64]);
    /// `x_bar` = J(`x`)ᵀ `y_bar`, with y_bar `[n_output]` and x_bar `[n_input]`.
    fn reverse(&self, x: &[f64], y_bar: &[f64], x_bar: &mut [f64]);

    /// Adds `static void name(const real *x, real *y)` to C text, where x are the arguments that are not `known`, in order. `None`: it
    /// cannot be written in C, and what calls it is not exported.
    ///
    /// [`emit`](super::emit) has an example.
    ///
    /// # Errors
    /// What it says about the known arguments.
    fn c_function(&self, _text: &mut CText, _name: &str, _known: &[Option<f64>]) -> Result<Option<CFunction>> {
        Ok(None)
    }

    /// The name and data by which who reads a saved recording makes this function again. `None`: it cannot be saved, nor what calls it.
    #[doc(hidden)]
    fn saved(&self) -> Option<SavedFunction> {
        None
    }

    /// [`value`](Self::value) at points side by side, as blocks of environments have them. Here one by one; a function that answers
    /// many at once for less overrides it. The answer at a point may not depend on the other points.
    fn value_block(&self, points: &mut Points<'_>) {
        points.each(self.n_input(), |x, y| self.value(x, y));
    }

    /// [`reverse`](Self::reverse) at points side by side, arguments x and ȳ, one behind the other; as
    /// [`value_block`](Self::value_block).
    fn reverse_block(&self, points: &mut Points<'_>) {
        let n = self.n_input();
        points.each(n + self.n_output(), |z, x_bar| {
            reverse_at(z, n, x_bar, |x, y_bar, x_bar| self.reverse(x, y_bar, x_bar))
        });
    }
}

/// What a file holds of a custom function: equal ones are the same function.
#[doc(hidden)]
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct SavedFunction {
    /// In a table of those that can be read, which no file can extend.
    pub name: String,
    /// What the function is made of besides. Whoever makes it checks them.
    pub data: Vec<u8>,
}

/// Points side by side at which a function is evaluated: `f32` in, `f64` for the function, `f32` out.
///
/// Number k of point l stands at `k · width + l`. Points behind the first `n` are padding.
#[derive(Debug)]
pub struct Points<'a> {
    width: usize,
    n: usize,
    arguments: &'a [f32],
    results: &'a mut [f32],
}

impl<'a> Points<'a> {
    /// # Panics
    /// If rows are not of `width` or `n` is more than that.
    #[doc(hidden)]
    pub fn new(width: usize, n: usize, arguments: &'a [f32], results: &'a mut [f32]) -> Self {
        assert!(
            n <= width && arguments.len().is_multiple_of(width) && results.len().is_multiple_of(width),
            "rows of points"
        );
        Self { width, n, arguments, results }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.n
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// Argument `k` of every point, `[len]`.
    ///
    /// # Panics
    /// If there is no such argument.
    pub fn argument(&self, k: usize) -> &[f32] {
        &self.arguments[k * self.width..][..self.n]
    }

    /// Result `k` of every point.
    #[doc(hidden)]
    pub fn result_mut(&mut self, k: usize) -> &mut [f32] {
        &mut self.results[k * self.width..][..self.n]
    }

    /// Calls `f` with arguments, `[n_argument]`, and results of one point after the other.
    ///
    /// # Panics
    /// If points have fewer arguments.
    pub fn each(&mut self, n_argument: usize, f: impl FnMut(&[f64], &mut [f64])) {
        self.each_of(0..self.n, n_argument, f);
    }

    /// Likewise of these points.
    #[doc(hidden)]
    pub fn each_of(
        &mut self,
        points: impl IntoIterator<Item = usize>,
        n_argument: usize,
        mut f: impl FnMut(&[f64], &mut [f64]),
    ) {
        let Self { width, arguments, results, .. } = self;
        let (width, n_result) = (*width, results.len() / *width);
        let mut scratch = Scratch::<f64, 256>::new();
        let (x, y) = scratch.of(n_argument + n_result).split_at_mut(n_argument);
        for point in points {
            for k in 0..n_argument {
                x[k] = f64::from(arguments[k * width + point]);
            }
            f(x, y);
            for k in 0..n_result {
                results[k * width + point] = y[k] as f32;
            }
        }
    }
}

/// A custom function that any scalar can call. Clones are the same operation; two made apart are two, also of equal
/// functions.
#[derive(Clone)]
pub struct Operation(Arc<Inner>);

struct Inner {
    function: Arc<dyn CustomFunction>,
    /// Asked once: machine code counts on them.
    n_input: usize,
    n_output: usize,
    tangent: OnceLock<Operation>,
    adjoint: OnceLock<Operation>,
}

impl Operation {
    /// An operation of a function, whose lengths are asked once, here.
    pub fn new(function: impl CustomFunction) -> Self {
        Self::from(Arc::new(function) as Arc<dyn CustomFunction>)
    }

    /// `outputs` = f(`inputs`), with derivatives as far as the scalar carries them.
    ///
    /// # Panics
    /// If a slice does not have the function's length.
    #[inline(always)]
    pub fn call<S: Scalar>(&self, inputs: &[S], outputs: &mut [S]) {
        assert_eq!((inputs.len(), outputs.len()), (self.n_input(), self.n_output()), "lengths of a custom function");
        S::call(self, inputs, outputs);
    }

    /// The function itself.
    pub fn function(&self) -> &dyn CustomFunction {
        &*self.0.function
    }

    /// Length of the inputs.
    pub fn n_input(&self) -> usize {
        self.0.n_input
    }

    /// Length of the outputs.
    pub fn n_output(&self) -> usize {
        self.0.n_output
    }

    /// The operation [x; dx] → J(x) dx, of 2 n_input numbers.
    pub fn tangent(&self) -> &Self {
        self.0.tangent.get_or_init(|| Self::new(Tangent(self.0.function.clone())))
    }

    /// The operation [x; ȳ] → J(x)ᵀ ȳ, of n_input + n_output numbers.
    pub fn adjoint(&self) -> &Self {
        self.0.adjoint.get_or_init(|| Self::new(Adjoint(self.0.function.clone())))
    }

    /// The value for each of `width` lanes: `rows` holds the inputs, then the outputs, `width` numbers each.
    #[inline(never)]
    pub(crate) fn call_rows(&self, width: usize, rows: &mut [f32]) {
        let (inputs, outputs) = rows.split_at_mut(self.n_input() * width);
        self.function().value_block(&mut Points::new(width, width, inputs, outputs));
    }
}

impl From<Arc<dyn CustomFunction>> for Operation {
    fn from(function: Arc<dyn CustomFunction>) -> Self {
        let (n_input, n_output) = (function.n_input(), function.n_output());
        Self(Arc::new(Inner { function, n_input, n_output, tangent: OnceLock::new(), adjoint: OnceLock::new() }))
    }
}

impl PartialEq for Operation {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Eq for Operation {}

impl Hash for Operation {
    fn hash<H: Hasher>(&self, state: &mut H) {
        Arc::as_ptr(&self.0).hash(state);
    }
}

impl fmt::Debug for Operation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Operation({} -> {})", self.n_input(), self.n_output())
    }
}

/// Whether any number differs from zero.
pub(crate) fn moves(direction: &[f64]) -> bool {
    direction.iter().any(|d| *d != 0.0)
}

/// J dx, without a call where dx = 0.
pub(crate) fn forward(function: &dyn CustomFunction, x: &[f64], dx: &[f64], dy: &mut [f64]) {
    if moves(dx) { function.forward(x, dx, dy) } else { dy.fill(0.0) }
}

/// Jᵀ ȳ, without a call where ȳ = 0.
fn reverse(function: &dyn CustomFunction, x: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
    if moves(y_bar) { function.reverse(x, y_bar, x_bar) } else { x_bar.fill(0.0) }
}

/// Likewise, of x and ȳ one behind the other.
pub fn reverse_at(z: &[f64], n: usize, x_bar: &mut [f64], f: impl FnOnce(&[f64], &[f64], &mut [f64])) {
    let (x, y_bar) = z.split_at(n);
    if moves(y_bar) { f(x, y_bar, x_bar) } else { x_bar.fill(0.0) }
}

/// What the unknown second derivative along two directions contributes: nothing if either is zero.
pub(crate) fn unknown(a: &[f64], b: &[f64]) -> f64 {
    if moves(a) && moves(b) { f64::NAN } else { 0.0 }
}

/// [x; dx] → J(x) dx, linear in dx.
struct Tangent(Arc<dyn CustomFunction>);

impl CustomFunction for Tangent {
    fn n_input(&self) -> usize {
        2 * self.0.n_input()
    }
    fn n_output(&self) -> usize {
        self.0.n_output()
    }
    fn value(&self, z: &[f64], y: &mut [f64]) {
        let (x, dx) = z.split_at(self.0.n_input());
        forward(&*self.0, x, dx, y);
    }
    fn forward(&self, z: &[f64], dz: &[f64], dy: &mut [f64]) {
        let n = self.0.n_input();
        forward(&*self.0, &z[..n], &dz[n..], dy);
        let bend = unknown(&z[n..], &dz[..n]);
        dy.iter_mut().for_each(|d| *d += bend);
    }
    fn reverse(&self, z: &[f64], y_bar: &[f64], z_bar: &mut [f64]) {
        let n = self.0.n_input();
        z_bar[..n].fill(unknown(&z[n..], y_bar));
        reverse(&*self.0, &z[..n], y_bar, &mut z_bar[n..]);
    }
}

/// [x; ȳ] → J(x)ᵀ ȳ, linear in ȳ.
struct Adjoint(Arc<dyn CustomFunction>);

impl CustomFunction for Adjoint {
    fn n_input(&self) -> usize {
        self.0.n_input() + self.0.n_output()
    }
    fn n_output(&self) -> usize {
        self.0.n_input()
    }
    fn value(&self, z: &[f64], x_bar: &mut [f64]) {
        let (x, y_bar) = z.split_at(self.0.n_input());
        reverse(&*self.0, x, y_bar, x_bar);
    }
    fn value_block(&self, points: &mut Points<'_>) {
        self.0.reverse_block(points);
    }
    fn forward(&self, z: &[f64], dz: &[f64], dx_bar: &mut [f64]) {
        let n = self.0.n_input();
        reverse(&*self.0, &z[..n], &dz[n..], dx_bar);
        let bend = unknown(&z[n..], &dz[..n]);
        dx_bar.iter_mut().for_each(|d| *d += bend);
    }
    fn reverse(&self, z: &[f64], seed: &[f64], z_bar: &mut [f64]) {
        let n = self.0.n_input();
        z_bar[..n].fill(unknown(&z[n..], seed));
        forward(&*self.0, &z[..n], seed, &mut z_bar[n..]);
    }
}

/// Numbers for the length of a call: on the stack, unless they are more than `FEW`.
pub(crate) struct Scratch<T, const FEW: usize> {
    few: [T; FEW],
    many: Vec<T>,
}

impl<T: Copy + Default, const FEW: usize> Scratch<T, FEW> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self { few: [T::default(); FEW], many: Vec::new() }
    }

    /// The first `n` of them.
    #[inline(always)]
    pub(crate) fn of(&mut self, n: usize) -> &mut [T] {
        if n <= FEW {
            return &mut self.few[..n];
        }
        self.many.resize(n, T::default());
        &mut self.many
    }
}

#[cfg(test)]
mod tests;
