//! A system of your own, and a certificate that its gradients are right before anything is built on them: a pendulum on
//! a motor, once written well and once with a corner left unguarded.
//!
//! `cargo run --release --example certify_your_system`

use omnidrones::autodiff::certificate::{CertificateBounds, require};
use omnidrones::error::Result;
use omnidrones::prelude::*;

/// State: angle, rate. Input: torque. Parameters: length, friction.
struct Pendulum {
    guarded: bool,
}

impl System for Pendulum {
    fn n_state(&self) -> usize {
        2
    }
    fn n_input(&self) -> usize {
        1
    }
    fn n_parameter(&self) -> usize {
        2
    }
    fn step<S: Scalar>(&self, x: &[S], u: &[S], theta: &[S], next: &mut [S]) {
        let (h, gravity) = (S::constant(0.01), S::constant(9.81));
        // Friction grows with the root of speed; the plain root has an infinite slope at rest.
        let squared = x[1].square();
        let root = if self.guarded { safe::sqrt(squared, 1e-6) } else { squared.sqrt() };
        let friction = theta[1] * root * x[1];
        let acceleration = u[0] - gravity * theta[0].recip() * x[0].sin_cos().0 - friction;
        next[1] = h.mul_add(acceleration, x[1]);
        next[0] = h.mul_add(next[1], x[0]);
    }
}

fn main() -> Result<()> {
    let (torque, theta) = ([0.2], [0.7, 0.1]);
    for guarded in [true, false] {
        for state in [[0.4, 1.5], [0.4, 0.0]] {
            let certificate = certify(&Pendulum { guarded }, &state, &torque, &theta)?;
            let verdict = match require(&certificate, CertificateBounds::default()) {
                Ok(()) => "holds",
                Err(_) => "is refused",
            };
            println!("guarded {guarded}, angle and rate {state:?}: the certificate {verdict}\n{certificate}\n");
        }
    }
    Ok(())
}
