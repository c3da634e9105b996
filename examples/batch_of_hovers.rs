//! Many Hovers at once, commanded by velocities: a hand-written policy against random actions. Episodes restart by
//! themselves; the information of the step that ends one holds its return.
//!
//! `cargo run --release --example batch_of_hovers`

use omnidrones::controllers::cascade::Level;
use omnidrones::error::Result;
use omnidrones::prelude::*;
use omnidrones::tasks::Column;
use std::f32::consts::PI;
use std::time::Instant;

const N: usize = 128;
const STEPS: usize = 1000;

/// Straight to the target at up to 1 m/s, turning as the task wants it: [v_x, v_y, v_z, yaw] in [−1, 1].
fn fly_straight(env: &Env, out: &Buffers, actions: &mut [f32]) {
    let place = |name: &str| env.spec().observation_range(name).expect("a slice of Hover").start;
    let (target, heading, error) = (place("target"), place("heading"), place("heading_error"));
    for (seen, action) in out.observation.chunks(env.spec().n_observation).zip(actions.chunks_mut(4)) {
        for i in 0..3 {
            action[i] = (1.5 * seen[target + i]).clamp(-1.0, 1.0);
        }
        let h = [seen[heading], seen[heading + 1]];
        let wanted = [h[0] + seen[error], h[1] + seen[error + 1]];
        let turn = (h[0] * wanted[1] - h[1] * wanted[0]).atan2(h[0] * wanted[0] + h[1] * wanted[1]);
        // a turn by half a circle at once would cost too much height
        let yaw = h[1].atan2(h[0]) + turn.clamp(-0.5, 0.5);
        action[3] = ((yaw + PI).rem_euclid(2.0 * PI) - PI) / PI;
    }
}

/// Steps the batch with a policy; prints what came of it.
fn roll_out(name: &str, env: &mut Env, policy: &mut dyn FnMut(&Env, &Buffers, &mut [f32])) -> Result<()> {
    let spec = env.spec().clone();
    let (total, success) = (spec.needed_column(Column::Return)?, spec.needed_column(Column::Success)?);
    let mut out = Buffers::new(&spec);
    let mut actions = vec![0.0; N * spec.n_agent * spec.action.len()];
    env.reset(None, None, &mut out.out())?;
    let (mut episodes, mut returns, mut successes, mut crashes) = (0.0, 0.0, 0.0, 0.0);
    let start = Instant::now();
    for _ in 0..STEPS {
        policy(env, &out, &mut actions);
        env.step(&actions, &mut out.out())?;
        for (i, info) in out.info.chunks(spec.info.len()).enumerate() {
            if out.terminated[i] | out.truncated[i] == 1 {
                episodes += 1.0;
                returns += info[total];
                successes += info[success] * f32::from(1 - out.terminated[i]);
                crashes += f32::from(out.terminated[i]);
            }
        }
    }
    let speed = (N * STEPS) as f64 / start.elapsed().as_secs_f64();
    let [mean, at, lost] = [returns, 100.0 * successes, 100.0 * crashes].map(|sum| sum / episodes);
    print!("{name:<9} {episodes} episodes: mean return {mean:.0}, at the target {at:.0} %, ");
    println!("lost {lost:.0} %; {speed:.1e} steps per second");
    Ok(())
}

fn main() -> Result<()> {
    let config = EnvConfig { n_env: N, control: Level::Velocity, ..EnvConfig::default() };
    let mut env = Env::make("Hover", &config)?;
    println!("{env:?}: at most {:.1} per step, {} steps", env.spec().reward_bound, env.spec().horizon);
    let mut draws = 0..;
    roll_out("random", &mut env, &mut |env, _, actions| env.sample(draws.next().unwrap_or(0), actions))?;
    roll_out("straight", &mut env, &mut fly_straight)
}
