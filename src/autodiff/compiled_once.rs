//! Equations over the three scalars that every crate uses are compiled once, in their room, and called from elsewhere: a crate that calls
//! a generic function compiles it anew, with all that it is made of, and a step of a vehicle has 100 KiB of code.

use super::trace::Trace;
use num_dual::Dual64;

/// Arguments and result of f(x, u, θ).
#[derive(Debug)]
pub struct Arguments<'a, S> {
    /// x.
    pub state: &'a [S],
    /// u.
    pub input: &'a [S],
    /// θ.
    pub parameters: &'a [S],
    /// What f writes.
    pub result: &'a mut [S],
}

/// Arguments over a scalar of [`Scalar::IS_COMPILED_ONCE`](super::Scalar::IS_COMPILED_ONCE).
#[derive(Debug)]
pub enum CompiledOnce<'a> {
    /// Plain numbers.
    Plain(Arguments<'a, f64>),
    /// Numbers with a derivative.
    Dual(Arguments<'a, Dual64>),
    /// Recorded numbers.
    Trace(Arguments<'a, Trace>),
}

/// A scalar's part in it.
macro_rules! compiled_once {
    ($variant:ident) => {
        const IS_COMPILED_ONCE: bool = true;
        fn compiled_once(
            arguments: $crate::compiled_once::Arguments<'_, Self>,
        ) -> $crate::compiled_once::CompiledOnce<'_> {
            $crate::compiled_once::CompiledOnce::$variant(arguments)
        }
    };
}
pub(crate) use compiled_once;
