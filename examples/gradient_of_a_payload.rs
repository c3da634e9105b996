//! Stops a swinging payload by gradient descent: rotor commands of 0.8 s, found with the gradient of the whole rollout of
//! drone, rope and ball. The cost looks up the rope's two hinges by name.
//!
//! `cargo run --release --example gradient_of_a_payload`

use omnidrones::autodiff::Objective;
use omnidrones::dynamics::configurations::Payload;
use omnidrones::dynamics::tree::{Model, Multibody};
use omnidrones::error::Result;
use omnidrones::prelude::*;

const STEPS: usize = 100;
const DT: f64 = 0.008;

/// Hang straight and still in the end, not far from the start; use little command on the way.
struct Calm {
    /// Places in the state of the hinges' angles and rates.
    angle: [usize; 2],
    rate: [usize; 2],
    hover: f64,
}

impl Calm {
    fn of(model: &Model, hover: f64) -> Result<Self> {
        let [x, y] = ["swing.x", "swing.y"].map(|name| model.joint(name).map(|joint| model.layout().bodies[joint]));
        let (x, y) = (x?, y?);
        Ok(Self { angle: [x.position, y.position], rate: [x.velocity, y.velocity], hover })
    }
}

impl Objective for Calm {
    fn stage<S: Scalar>(&self, _: &[S], input: &[S], _: &[S]) -> S {
        input.iter().fold(S::zero(), |sum, u| sum + S::constant(1e-4) * (*u - S::constant(self.hover)).square())
    }
    fn terminal<S: Scalar>(&self, x: &[S], _: &[S]) -> S {
        let mut cost = S::zero();
        for k in 0..2 {
            cost += x[self.angle[k]].square() + S::constant(0.1) * x[self.rate[k]].square();
        }
        for k in 0..6 {
            cost += S::constant(0.05) * x[k].square(); // position and velocity of the drone
        }
        cost
    }
}

fn main() -> Result<()> {
    let model = Payload::default().build()?.model;
    let lift: f64 = model.rotors().iter().map(|r| r.rotor.max_thrust()).sum();
    let share = model.mass() * model.parts().gravity / lift;
    let objective = Calm::of(&model, 2.0 * share - 1.0)?;
    let system = Multibody::new(&model, Physics { dt: DT, ..Physics::default() })?;

    // At hover, the rope 0.4 rad off.
    let mut start = system.rest_state();
    for (rotor, at) in model.rotors().iter().zip(&model.layout().rotor_speed) {
        start[*at] = rotor.rotor.max_speed * share.sqrt();
    }
    start[objective.angle[1]] = 0.4;
    let (angle, mut inputs) = (objective.angle, vec![objective.hover; STEPS * 4]);
    let rollout = Rollout::new(system, objective)?;

    let mut momentum = vec![0.0; inputs.len()];
    for iteration in 0..=90 {
        let (cost, gradient) = rollout.gradient(&start, &inputs, &[]);
        if iteration % 30 == 0 {
            let states = rollout.trajectory(&start, &inputs, &[]);
            let end = &states[states.len() - start.len()..];
            println!("{iteration:4}  cost {cost:.5}  rope at ({:+.3}, {:+.3}) rad", end[angle[0]], end[angle[1]]);
        }
        // steps of bounded length that shrink to nothing
        let step = 0.01 * (1.0 - f64::from(iteration) / 90.0);
        let length = gradient.inputs.iter().map(|g| g * g).sum::<f64>().sqrt().max(1e-3);
        for ((u, m), g) in inputs.iter_mut().zip(&mut momentum).zip(&gradient.inputs) {
            *m = 0.9 * *m - step * g / length;
            *u = (*u + *m).clamp(-1.0, 1.0);
        }
    }
    Ok(())
}
