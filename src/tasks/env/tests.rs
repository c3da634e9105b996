//! What only shows from inside.

use super::block::episode_state;
use super::*;
use crate::speed_gate::{Measured, keeps};
use crate::tasks::config::MAX_HORIZON;

fn hover(n_env: usize, horizon: usize) -> Env {
    let mut config = EnvConfig { n_env, ..EnvConfig::default() };
    config.task.insert("horizon".into(), (horizon as i64).into());
    Env::make("Hover", &config).unwrap()
}

#[test]
fn the_longest_episodes_are_cut_at_their_last_step() {
    for horizon in [500, 2_000_001, 10_000_000, MAX_HORIZON - 1, MAX_HORIZON] {
        let mut env = hover(1, horizon);
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        env.blocks[0].episode_state[episode_state::OFFSET][0] = (horizon - 3) as f32;
        let cut: Vec<u8> = (0..3)
            .map(|_| {
                env.step(&[f32::NAN; 4], &mut out.out()).unwrap();
                out.truncated[0]
            })
            .collect();
        assert_eq!(cut, [0, 0, 1], "{horizon}");
    }
}

#[test]
fn every_thread_has_its_workspace_before_the_first_step() {
    let mut env = hover(1024, 50);
    for (threads, wanted) in [(1, 1), (2, 2), (3, 3), (1, 1), (8, 4)] {
        env.set_threads(Threads::new(threads).unwrap());
        assert_eq!(env.pool.lock().unwrap().len(), wanted);
    }
}

#[test]
fn judging_and_observing_in_lanes_keep_their_speed() {
    let mut env = hover(BLOCK, 500);
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let (core, block, mut work) = (&env.core, &mut env.blocks[0], env.core.workspace());
    core.plant.frames(&block.plant, u64::MAX, &mut work.frames);
    let measured = Measured { avx512: 10.4, avx2: 6.83 };
    keeps("Hover judged", &measured, || core.engine.evaluate_step(core, block, &mut work));
    let measured = Measured { avx512: 9.6, avx2: 4.99 };
    keeps("Hover observed", &measured, || core.engine.observe(&core.sizes, block, &mut work, u64::MAX));
}
