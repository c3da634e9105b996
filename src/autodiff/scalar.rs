//! The number under every equation of the library.
//!
//! Physics, controllers and rewards are written once over [`Scalar`] and evaluated as plain floats, as dual numbers
//! (derivatives), as SIMD lanes (one environment per lane) or as a recording ([`Trace`](super::Trace)) from which the
//! adjoint is derived. For all of them to run the same lines, a kernel may not branch on a value: comparisons return
//! a [`Mask`] and [`Scalar::select`] picks between two results that are both computed.

use super::compiled_once::{Arguments, CompiledOnce, compiled_once};
use super::custom::{Operation, Scratch};
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

/// The truth value of a comparison: a `bool` for single numbers, one bit per lane for lanes.
pub trait Mask: Copy {
    /// Where both hold.
    fn and(self, other: Self) -> Self;
    /// Where at least one holds.
    fn or(self, other: Self) -> Self;
    /// Where it does not hold.
    fn not(self) -> Self;
}

impl Mask for bool {
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self & other
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        self | other
    }
    #[inline(always)]
    fn not(self) -> Self {
        !self
    }
}

/// A real number, or several side by side.
///
/// There is deliberately no `PartialOrd`: a kernel that could branch on a value would neither trace nor run in lanes.
/// Kernels call the functions of [`safe`](super::safe) where an argument may reach a singular point (norms, square
/// roots, angles): a reverse sweep multiplies a masked zero by the infinite slope otherwise.
pub trait Scalar:
    Copy
    + Debug
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
{
    /// What a comparison returns.
    type Mask: Mask;

    /// Whether equations over it are compiled once, in their room: see [`CompiledOnce`](super::compiled_once::CompiledOnce).
    #[doc(hidden)]
    const IS_COMPILED_ONCE: bool = false;
    /// Arguments as those of what is compiled once.
    #[doc(hidden)]
    fn compiled_once(_: Arguments<'_, Self>) -> CompiledOnce<'_> {
        unreachable!("equations over this scalar are compiled where they are used")
    }

    /// A constant: the same in every lane, with zero derivative.
    fn constant(x: f64) -> Self;
    /// √x. Slope infinite at 0: see [`safe::sqrt`](super::safe::sqrt).
    fn sqrt(self) -> Self;
    /// (sin x, cos x), x in rad; of lanes for |x| < 10⁴.
    fn sin_cos(self) -> (Self, Self);
    /// eˣ; of lanes, x is held within [−87.3, 88.3].
    fn exp(self) -> Self;
    /// Natural logarithm of x > 0; of lanes NaN for any other x.
    fn ln(self) -> Self;
    /// Hyperbolic tangent.
    fn tanh(self) -> Self;
    /// The angle of the point (`x`, `self`), rad, in (−π, π]. Undefined slope at the origin: see
    /// [`safe::atan2`](super::safe::atan2).
    fn atan2(self, x: Self) -> Self;
    /// `self < other`, lane by lane; derivatives play no part.
    fn lt(self, other: Self) -> Self::Mask;
    /// Lane by lane: `yes` where `mask` holds, else `no`. Both are already computed.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// The same value with derivative zero: a number that was found, not computed.
    ///
    /// An iteration that solves r(y, x) = 0 need not be differentiated. Run it on detached numbers, then take one Newton
    /// step y − (∂r/∂y)⁻¹ r(y, x) with y and ∂r/∂y detached and x alive: the value stays, and the derivative is the exact
    /// −(∂r/∂y)⁻¹ ∂r/∂x of the implicit function theorem, to the accuracy of the solution. Second derivatives of
    /// such a step are not those of the solution.
    ///
    /// ```
    /// # use omnidrones_autodiff::omnidrones;
    /// use omnidrones::autodiff::Scalar;
    /// use num_dual::Dual64;
    ///
    /// /// √a by iteration: y − (y² − a)/2y.
    /// fn root<S: Scalar>(a: S) -> S {
    ///     let step = |y: S, a: S| y - (y.square() - a) * (y + y).detach().recip();
    ///     let mut y = S::one();
    ///     for _ in 0..8 {
    ///         y = step(y, a.detach());
    ///     }
    ///     step(y.detach(), a)
    /// }
    ///
    /// assert_eq!(root(Dual64::new(4.0, 1.0)), Dual64::new(2.0, 0.25));
    /// ```
    fn detach(self) -> Self;
    /// `outputs` = f(`inputs`) of a custom function; slices have its lengths. Kernels write [`Operation::call`], which
    /// checks them.
    fn call(operation: &Operation, inputs: &[Self], outputs: &mut [Self]);

    /// `outputs` = what `body` makes of them. In a recording it becomes a function: parts of a kernel that do the same to as many
    /// numbers are recorded once and called, so a program of many bodies, stages or steps stays small. Nothing else changes but
    /// the order in which adjoints are summed, and which products are fused in lanes: fusions are decided inside.
    ///
    /// ```
    /// # use omnidrones_autodiff::omnidrones;
    /// use omnidrones::autodiff::{Program, Recording, Scalar};
    ///
    /// fn oscillation<S: Scalar>(x: &[S]) -> Vec<S> {
    ///     let mut state = x.to_vec();
    ///     for _ in 0..1000 {
    ///         S::function(&mut state, |state| {
    ///             for _ in 0..10 {
    ///                 state[1] = state[1] - state[0].sin_cos().0 * S::constant(1e-3);
    ///                 state[0] = state[0] + state[1] * S::constant(1e-3);
    ///             }
    ///         });
    ///     }
    ///     state
    /// }
    /// assert_eq!(Program::compile(&Recording::of(2, oscillation))?.value_form().calls().len(), 1000);
    /// # Ok::<(), omnidrones::error::Error>(())
    /// ```
    fn function(outputs: &mut [Self], body: impl FnOnce(&mut [Self])) {
        Self::begin_function();
        body(outputs);
        Self::end_function(outputs);
    }
    /// What follows, up to [`end_function`](Self::end_function), becomes a function of a recording, as in
    /// [`function`](Self::function). Kernels of lanes are written so: a closure costs them their instructions.
    #[inline(always)]
    fn begin_function() {}
    /// The function that was begun last ends here: `outputs` are its results. Other numbers made in it may not be read.
    #[inline(always)]
    fn end_function(_outputs: &mut [Self]) {}
    /// `self · a + b`: fused in lanes where the processor has it, two roundings elsewhere.
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        self * a + b
    }
    /// 0.
    #[inline(always)]
    fn zero() -> Self {
        Self::constant(0.0)
    }
    /// 1.
    #[inline(always)]
    fn one() -> Self {
        Self::constant(1.0)
    }
    /// 1/x.
    #[inline(always)]
    fn recip(self) -> Self {
        Self::one() / self
    }
    /// The larger; at a tie, `self` and its derivative.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::select(self.lt(other), other, self)
    }
    /// The smaller; at a tie, `self` and its derivative.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::select(other.lt(self), other, self)
    }
    /// `self` held within [`lo`, `hi`]; derivative 1 on the closed interval, 0 outside.
    #[inline(always)]
    fn clamp(self, lo: Self, hi: Self) -> Self {
        self.max(lo).min(hi)
    }
    /// |x|; derivative +1 at 0.
    #[inline(always)]
    fn abs(self) -> Self {
        Self::select(self.lt(Self::zero()), -self, self)
    }
    /// x².
    #[inline(always)]
    fn square(self) -> Self {
        self * self
    }
}

/// A number of the processor.
macro_rules! plain {
    ($t:ident, $call:ident $(, $once:ident)?) => {
        impl Scalar for $t {
            type Mask = bool;
            $(compiled_once!($once);)?
            #[inline(always)]
            fn constant(x: f64) -> Self {
                x as $t
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $t::sqrt(self)
            }
            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                $t::sin_cos(self)
            }
            #[inline(always)]
            fn exp(self) -> Self {
                $t::exp(self)
            }
            #[inline(always)]
            fn ln(self) -> Self {
                $t::ln(self)
            }
            #[inline(always)]
            fn tanh(self) -> Self {
                $t::tanh(self)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                $t::atan2(self, x)
            }
            #[inline(always)]
            fn lt(self, other: Self) -> bool {
                self < other
            }
            #[inline(always)]
            fn select(mask: bool, yes: Self, no: Self) -> Self {
                if mask { yes } else { no }
            }
            #[inline(always)]
            fn detach(self) -> Self {
                self
            }
            #[inline(always)]
            fn call(operation: &Operation, inputs: &[Self], outputs: &mut [Self]) {
                $call(operation, inputs, outputs);
            }
        }
    };
}

plain!(f64, call_exactly, Plain);
plain!(f32, call_rounded);

#[inline(always)]
fn call_exactly(operation: &Operation, inputs: &[f64], outputs: &mut [f64]) {
    operation.function().value(inputs, outputs);
}

fn call_rounded(operation: &Operation, inputs: &[f32], outputs: &mut [f32]) {
    let mut scratch = Scratch::<f32, 256>::new();
    let rows = scratch.of(inputs.len() + outputs.len());
    rows[..inputs.len()].copy_from_slice(inputs);
    operation.call_rows(1, rows);
    outputs.copy_from_slice(&rows[inputs.len()..]);
}
