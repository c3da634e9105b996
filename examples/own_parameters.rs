//! Plant parameters of your own, by name: a Hummingbird that is not what its controller believes, and how each number moves
//! the error of its flight, by one reverse sweep through the whole loop.
//!
//! `cargo run --release --example own_parameters`

use omnidrones::autodiff::Objective;
use omnidrones::controllers::start_on;
use omnidrones::error::Result;
use omnidrones::prelude::*;

/// Mean squared distance to the reference over 1000 steps, m².
struct Error;
impl Objective for Error {
    fn stage<S: Scalar>(&self, x: &[S], u: &[S], _: &[S]) -> S {
        S::constant(1e-3) * ((x[0] - u[0]).square() + (x[1] - u[1]).square() + (x[2] - u[2]).square())
    }
}

fn main() -> Result<()> {
    let vehicle = vehicles::by_name("hummingbird")?;
    let (physics, gains, rates) = (Physics::default(), vehicle.gains(), Rates::default());
    // commands act 4 ms late
    let system =
        ClosedLoop::of_vehicle(&vehicle, physics, &gains, &rates)?.with_latency(2)?.with_physics().with_gains();
    let reference = Reference::by_name("lemniscate")?;
    let start = system.initial_state(&start_on(system.plant(), system.controller(), &reference)?);
    let mut inputs = vec![0.0; 1000 * system.n_input()];
    for (k, row) in inputs.chunks_exact_mut(system.n_input()).enumerate() {
        system.write_input(k as u64, Target::level(&reference), &Disturbance::none(), row);
    }

    let believed = system.parameters();
    let mut own = believed.clone();
    for (name, factor) in [("mass", 1.15), ("rotor_0.thrust_coefficient", 0.9), ("inertia_xx", 1.2)] {
        own[system.parameter(name)?] *= factor;
    }
    let names = system.parameter_names();
    let rollout = Rollout::new(system, Error)?;
    for (what, theta) in [("as believed", &believed), ("as it is", &own)] {
        let (cost, gradient) = rollout.gradient(&start, &inputs, theta);
        println!("{what}: RMSE {:.1} mm over 2 s", 1e3 * cost.sqrt());
        // what 1 % more of a number changes
        let worth = |k: usize| 0.01 * theta[k] * gradient.parameters[k] / (2.0 * cost.sqrt());
        let mut order: Vec<usize> = (0..names.len()).collect();
        order.sort_by(|a, b| worth(*b).abs().total_cmp(&worth(*a).abs()));
        for k in &order[..4] {
            println!("  1 % more {:28} {:+.3} mm", names[*k], 1e3 * worth(*k));
        }
    }
    Ok(())
}
