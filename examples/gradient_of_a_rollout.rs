//! Plans thrusts by gradient descent: half a second of rotor commands that carry a Hummingbird to a point, found with
//! the gradient of the whole rollout, all four rotors and every step at once.
//!
//! `cargo run --release --example gradient_of_a_rollout`

use omnidrones::autodiff::Objective;
use omnidrones::error::Result;
use omnidrones::prelude::*;

const TARGET: [f64; 3] = [0.3, 0.0, 1.2];
const STEPS: usize = 250;

/// Be at the target in the end, slowly and not spinning; use little command on the way.
struct Arrive {
    hover: f64,
}

impl Objective for Arrive {
    fn stage<S: Scalar>(&self, _: &[S], input: &[S], _: &[S]) -> S {
        let mut effort = S::zero();
        for u in input {
            effort += (*u - S::constant(self.hover)).square();
        }
        S::constant(1e-5) * effort
    }
    fn terminal<S: Scalar>(&self, x: &[S], _: &[S]) -> S {
        let mut cost = S::zero();
        for i in 0..3 {
            cost += (x[i] - S::constant(TARGET[i])).square();
            cost += S::constant(0.01) * x[3 + i].square() + S::constant(0.001) * x[10 + i].square();
        }
        cost
    }
}

fn main() -> Result<()> {
    let system = Multirotor::new(&vehicles::by_name("hummingbird")?, Physics::default())?;
    let start = system.hover_state([0.0, 0.0, 1.0])?;
    let hover = system.hover_input()?;
    let mut inputs = hover.repeat(STEPS);
    let rollout = Rollout::new(system, Arrive { hover: hover[0] })?;

    // Descent with momentum, the step limited in length.
    let mut momentum = vec![0.0; inputs.len()];
    for iteration in 0..=300 {
        let (cost, gradient) = rollout.gradient(&start, &inputs, &[]);
        if iteration % 50 == 0 {
            let states = rollout.trajectory(&start, &inputs, &[]);
            let end = &states[states.len() - start.len()..];
            println!("{iteration:4}  cost {cost:.6}  ends at ({:.3}, {:.3}, {:.3}) m", end[0], end[1], end[2]);
        }
        let length = gradient.inputs.iter().map(|g| g * g).sum::<f64>().sqrt();
        for ((u, m), g) in inputs.iter_mut().zip(&mut momentum).zip(&gradient.inputs) {
            *m = 0.9 * *m - 0.02 * g / length.max(1e-3);
            *u = (*u + *m).clamp(-1.0, 1.0);
        }
    }
    Ok(())
}
