//! A function that only an iteration gives, inside a kernel: the pull of a cable that hangs between two drones. Its
//! derivative comes from the implicit function theorem, stated in a `CustomFunction`.
//!
//! `cargo run --release --example custom_derivative`

use num_dual::Dual64;
use omnidrones::autodiff::{CustomFunction, Operation, Program, Recording, Scalar};
use omnidrones::error::Result;

/// Span d and length L > d of the cable to u with d sinh u = L u.
struct Catenary;

impl CustomFunction for Catenary {
    fn n_input(&self) -> usize {
        2
    }
    fn n_output(&self) -> usize {
        1
    }
    fn value(&self, x: &[f64], u: &mut [f64]) {
        u[0] = (6.0 * (x[1] / x[0] - 1.0)).sqrt();
        for _ in 0..50 {
            let step = (x[0] * u[0].sinh() - x[1] * u[0]) / (x[0] * u[0].cosh() - x[1]);
            u[0] -= step;
            if step.abs() < 1e-14 {
                return; // when it is done: a kernel could not
            }
        }
    }
    fn forward(&self, x: &[f64], dx: &[f64], du: &mut [f64]) {
        let mut slope = [0.0; 2];
        self.reverse(x, &[1.0], &mut slope);
        du[0] = slope[0] * dx[0] + slope[1] * dx[1];
    }
    fn reverse(&self, x: &[f64], u_bar: &[f64], x_bar: &mut [f64]) {
        let mut u = [0.0];
        self.value(x, &mut u);
        let over = u_bar[0] / (x[0] * u[0].cosh() - x[1]);
        x_bar.copy_from_slice(&[-u[0].sinh() * over, u[0] * over]);
    }
}

/// Horizontal pull on each drone, N: weight per length times d/2u.
fn pull<S: Scalar>(catenary: &Operation, weight: S, span: S, length: S) -> S {
    let mut u = [S::zero()];
    catenary.call(&[span, length], &mut u);
    weight * span * (u[0] + u[0]).recip()
}

fn main() -> Result<()> {
    let catenary = Operation::new(Catenary);
    let by_dual = pull(&catenary, Dual64::from(0.2), Dual64::new(2.0, 1.0), Dual64::from(2.5));
    let recording = Recording::of(3, |z| vec![pull(&catenary, z[0], z[1], z[2])]);
    let adjoint = Program::compile(&recording.adjoint(0..3))?;
    let mut gradient = [0.0; 3];
    adjoint.evaluate(&mut adjoint.workspace(), &[0.2, 2.0, 2.5, 1.0], &mut gradient);
    println!("pull {:.4} N; with span {:.4} N/m by duals, {:.4} by the adjoint", by_dual.re, by_dual.eps, gradient[1]);
    Ok(())
}
