//! Hover with SHAC: windows of half a second and a critic for what comes after them. What the critic learnt is printed
//! beside what the policy then pays.
//!
//! `cargo run --release --example learn_hover_shac`

use omnidrones::error::Result;
use omnidrones::prelude::*;
use omnidrones::rl::shac::{Shac, ShacConfig};
use omnidrones::rl::{Starts, evaluate};
use omnidrones::tasks::Column;

fn main() -> Result<()> {
    let (env, threads) = (EnvConfig { stagger: true, ..EnvConfig::default() }, Threads::default());
    let config = ShacConfig::default();
    let discount = config.discount as f32;
    let mut shac = Shac::new("Hover", &env, config, 7, threads.clone())?;
    while shac.n_update() < shac.budget() {
        shac.update()?;
    }
    let starts = Starts { n_env: 256, seed: 1_000_003 };
    let mut policy = shac.policy()?;
    let result = evaluate(&mut policy, "Hover", &env, starts, &threads, &mut |_| {})?;
    println!("{:.1} % within 0.1 m in the end, mean {:.3} m", 100.0 * result.success, result.final_error);

    let mut hover = Env::make("Hover", &EnvConfig { n_env: 5, seed: 1, ..EnvConfig::default() })?;
    let mut out = Buffers::new(hover.spec());
    hover.reset(None, None, &mut out.out())?;
    let expected = shac.cost_to_go(&out.observation);
    let (mut paid, mut actions, mut weight) = (vec![0.0; 5], vec![0.0; 20], 1.0);
    let (width, loss) = (hover.spec().info.len(), hover.spec().needed_column(Column::Loss)?);
    for _ in 0..300 {
        policy.act(&out.observation, &mut actions)?;
        hover.step(&actions, &mut out.out())?;
        paid.iter_mut().enumerate().for_each(|(i, sum)| *sum += weight * out.info[i * width + loss]);
        weight *= discount;
    }
    println!("cost to go, by the critic and as flown: {expected:.1?} {paid:.1?}");
    assert!(result.success > 0.9);
    Ok(())
}
