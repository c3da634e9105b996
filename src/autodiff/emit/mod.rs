//! Recorded functions as text of other languages.
//!
//! | file | what |
//! |---|---|
//! | `function`: [`NamedFunction`] | a recording whose arguments and results are named arrays |
//! | `text`: [`CText`] | C99 or CUDA of such functions, with what they call |
//! | `cut` | long programs in parts, for compilers of devices |
//! | `elementary`: [`Elementary`] | sines and exponentials of that text |
//!
//! A custom function that a recording calls is written in C by whoever made it:
//!
//! ```
//! # use omnidrones_autodiff::omnidrones;
//! use omnidrones::autodiff::emit::{CFunction, CText, ExportPrecision, literal};
//! use omnidrones::autodiff::CustomFunction;
//! use omnidrones::error::Result;
//!
//! /// y = 2x
//! struct Twice;
//! impl CustomFunction for Twice {
//!     fn n_input(&self) -> usize { 1 }
//!     fn n_output(&self) -> usize { 1 }
//!     fn value(&self, x: &[f64], y: &mut [f64]) { y[0] = 2.0 * x[0]; }
//!     fn forward(&self, _: &[f64], dx: &[f64], dy: &mut [f64]) { dy[0] = 2.0 * dx[0]; }
//!     fn reverse(&self, _: &[f64], y_bar: &[f64], x_bar: &mut [f64]) { x_bar[0] = 2.0 * y_bar[0]; }
//!     fn c_function(&self, text: &mut CText, name: &str, known: &[Option<f64>]) -> Result<Option<CFunction>> {
//!         let (real, two) = (text.precision().c_type(), literal(2.0, text.precision()));
//!         let x = known[0].map_or("x[0]".into(), |x| format!("({})", literal(x, text.precision())));
//!         let prototype = format!("{}void {name}(const {real} *x, {real} *y)", text.dialect().own());
//!         text.add(&format!("{prototype}\n{{\n    (void)x;\n    y[0] = {two} * {x};\n}}\n"));
//!         Ok(Some(CFunction { name: name.into(), prototype, stack: 32, n_instruction: 1, n_most: 1 }))
//!     }
//! }
//!
//! let mut text = CText::new("own", ExportPrecision::Single);
//! let function = Twice.c_function(&mut text, "own_twice", &[None])?.expect("it has text");
//! assert!(function.prototype.starts_with("static void own_twice") && text.finished().contains("y[0] = 2.0f * x[0];"));
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

mod cut;
mod elementary;
mod function;
mod text;

pub use elementary::Elementary;
pub use function::{Access, ExportPrecision, NamedArray, NamedFunction, NamedNumber};
pub use text::{CFunction, CText, Dialect, Linkage, literal};
