//! The whole number below: a step, which no arithmetic of [`Scalar`] has.

use crate::custom::{CustomFunction, Operation, SavedFunction};
use crate::emit::{CFunction, CText, ExportPrecision, literal};
use crate::scalar::Scalar;
use base::error::Result;
use std::sync::LazyLock;

/// By which files call it.
const NAME: &str = "floor";

struct Floor;

impl CustomFunction for Floor {
    fn n_input(&self) -> usize {
        1
    }
    fn n_output(&self) -> usize {
        1
    }
    fn value(&self, x: &[f64], y: &mut [f64]) {
        y[0] = x[0].floor();
    }
    fn forward(&self, _x: &[f64], _dx: &[f64], dy: &mut [f64]) {
        dy[0] = 0.0;
    }
    fn reverse(&self, _x: &[f64], _y_bar: &[f64], x_bar: &mut [f64]) {
        x_bar[0] = 0.0;
    }
    fn saved(&self) -> Option<SavedFunction> {
        Some(SavedFunction { name: NAME.into(), data: Vec::new() })
    }
    fn c_function(&self, text: &mut CText, name: &str, known: &[Option<f64>]) -> Result<Option<CFunction>> {
        let precision = text.precision();
        let real = precision.c_type();
        let x = known[0].map_or("x[0]".into(), |x| format!("({})", literal(x, precision)));
        // beyond this every number is whole; a conversion is exact below, and NaN stays what it is
        let (most, integer) = match precision {
            ExportPrecision::Single => (literal(8388608.0, precision), "long"),
            ExportPrecision::Double => (literal(4503599627370496.0, precision), "long long"),
        };
        let prototype = format!("{}void {name}(const {real} *x, {real} *y)", text.dialect().own());
        let one = literal(1.0, precision);
        text.add(&format!(
            "{prototype}\n{{\n    {real} a = {x}, whole;\n    (void)x;\n    if (!(a > -{most} && a < {most})) {{\n        \
             y[0] = a;\n        return;\n    }}\n    whole = ({real})({integer})a;\n    y[0] = whole > a ? whole - {one} : whole;\n}}\n"
        ));
        Ok(Some(CFunction { name: name.into(), prototype, stack: 32, n_instruction: 6, n_most: 6 }))
    }
}

/// One in a process: equal arguments then are one call.
static FLOOR: LazyLock<Operation> = LazyLock::new(|| Operation::new(Floor));

/// The operation of this crate that a file calls by this name and data.
#[doc(hidden)]
pub fn saved_operation(name: &str, data: &[u8]) -> Option<Operation> {
    (name == NAME && data.is_empty()).then(|| FLOOR.clone())
}

/// The largest whole number that is no more than x, with derivative 0. Lane by lane where lanes are: slower than arithmetic.
///
/// ```
/// # use omnidrones_autodiff::omnidrones;
/// assert_eq!([2.5, -2.5].map(omnidrones::autodiff::floor), [2.0, -3.0]);
/// ```
pub fn floor<S: Scalar>(x: S) -> S {
    let mut whole = [x];
    // detached, so that second derivatives are 0 too
    FLOOR.call(&[x.detach()], &mut whole);
    whole[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Recording;
    use crate::jet::Jet;
    use num_dual::HyperDual64;

    #[test]
    fn a_floor_is_the_same_of_every_scalar_and_has_no_derivative() {
        let recording = Recording::of(1, |x| vec![floor(x[0]), floor(x[0])]);
        for (x, whole) in [(2.5, 2.0), (-2.5, -3.0), (3.0, 3.0), (-0.25, -1.0), (1e20, 1e20)] {
            assert_eq!((floor(x), f64::from(floor(x as f32))), (whole, f64::from(whole as f32)));
            let mut results = [0.0; 2];
            recording.evaluate(&[x], &mut results);
            assert_eq!(results, [whole; 2]);
            let y = floor(HyperDual64::new(x, 1.0, 1.0, 0.0));
            assert_eq!((y.re, y.eps1, y.eps2, y.eps1eps2), (whole, 0.0, 0.0, 0.0));
            let y = floor(Jet::<f64, 3>::variable(x));
            assert_eq!((y.value(), y.derivative(1), y.derivative(2)), (whole, 0.0, 0.0));
        }
        assert!(floor(f64::NAN).is_nan());
        assert_eq!(recording.calls.len(), 1, "equal ones are made once");
    }
}
