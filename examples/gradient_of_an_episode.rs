//! Plans thrusts with the gradients of an environment: one second of Hover, from four starts at once. Recorded steps, one
//! reverse sweep, a step of descent; no policy and no feedback, so what falls is due to the gradient alone.
//!
//! `cargo run --release --example gradient_of_an_episode`

use omnidrones::error::Result;
use omnidrones::prelude::*;
use omnidrones::tasks::{Autoreset, Column, Cotangents, SweepOptions};

const N: usize = 4;
const STEPS: usize = 60;
const ITERATIONS: usize = 120;

fn main() -> Result<()> {
    let config = EnvConfig { n_env: N, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
    let mut env = Env::make("Hover", &config)?;
    let spec = env.spec().clone();
    let error = spec.info_column("position_error").unwrap();
    let (loss, width) = (spec.needed_column(Column::Loss)?, spec.info.len());

    // What a step is differentiated by, what is remembered of the steps, what walks back through them.
    let adjoint = env.adjoint(false)?;
    let mut tape = env.tape(STEPS)?;
    let mut sweep = adjoint.sweep(SweepOptions::default());
    println!("{} instructions per adjoint step, {} numbers carried", adjoint.n_instruction(), adjoint.n_carried());

    let n = N * spec.action.len();
    let mut actions = vec![vec![-0.415; n]; STEPS]; // about hover
    let (mut first, mut second) = (vec![vec![0.0; n]; STEPS], vec![vec![0.0; n]; STEPS]);
    let mut gradient = vec![0.0; n];
    let mut out = Buffers::new(&spec);
    for iteration in 0..=ITERATIONS {
        env.reset(None, Some(&[0; N]), &mut out.out())?; // the same four starts
        tape.clear();
        let mut cost = [0.0; N];
        for a in &actions {
            env.step_recorded(a, &mut out.out(), &mut tape)?;
            for i in 0..N {
                cost[i] += out.info[i * width + loss] / STEPS as f32;
            }
        }
        if iteration % 20 == 0 {
            let errors: Vec<f32> = (0..N).map(|i| out.info[i * width + error]).collect();
            println!("{iteration:4}  mean loss {cost:.3?}  last distance {errors:.3?} m");
        }
        sweep.restart();
        let ones = [1.0 / STEPS as f32; N];
        let rate = 0.03 * (1.0 - iteration as f32 / (ITERATIONS + 1) as f32);
        for t in (0..STEPS).rev() {
            sweep.pull(&tape, t, &Cotangents { loss: &ones, ..Cotangents::default() }, &mut gradient)?;
            for k in 0..n {
                // Adam (Kingma and Ba 2015) without its bias correction
                first[t][k] += 0.1 * (gradient[k] - first[t][k]);
                second[t][k] += 0.01 * (gradient[k] * gradient[k] - second[t][k]);
                let step = rate * first[t][k] / (second[t][k].sqrt() + 1e-8);
                actions[t][k] = (actions[t][k] - step).clamp(-1.0, 1.0);
            }
        }
    }
    println!("{} gradients were not finite", sweep.dropped());
    Ok(())
}
