//! Numbers: every scalar evaluates the same step, every gradient is right.

mod closed_forms;
#[path = "../common/mod.rs"]
mod common;
mod gradients;
mod multibody_gradients;
mod native;
mod one_source;
mod rng;

use crate::common::measure::larger;
use omnidrones::autodiff::{CertificateBounds, System, certify};

/// What our own systems keep, measured 7.5e-14, 8.9e-8, 0.020 and less; users are held to less.
const BOUNDS: CertificateBounds = CertificateBounds { adjoint: 5e-12, difference: 1e-7, taylor: 0.05 };

/// The worst of what certificates measured.
#[derive(Default)]
struct Worst {
    adjoint: f64,
    difference: f64,
    taylor: f64,
}

impl Worst {
    /// Certifies a point and remembers.
    fn certify<F: System>(&mut self, name: &str, system: &F, x: &[f64], u: &[f64], theta: &[f64]) {
        self.certify_within(BOUNDS, name, system, x, u, theta);
    }

    fn certify_within<F: System>(
        &mut self,
        bounds: CertificateBounds,
        name: &str,
        system: &F,
        x: &[f64],
        u: &[f64],
        theta: &[f64],
    ) {
        let c = certify(system, x, u, theta).unwrap();
        assert!(c.holds(bounds), "{name}: {c}");
        self.adjoint = larger(self.adjoint, c.adjoint_error);
        self.difference = larger(self.difference, c.difference_error);
        if let Some(order) = c.taylor_order {
            self.taylor = larger(self.taylor, (order - 2.0).abs());
        }
    }

    fn print(&self) {
        println!("adjoint {:.1e}, difference {:.1e}, Taylor off by {:.3}", self.adjoint, self.difference, self.taylor);
    }
}
