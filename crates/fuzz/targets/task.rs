//! Any file of a task's record is refused, or is a task: environments of it step, or cannot be made.
#![no_main]

use libfuzzer_sys::fuzz_target;
use omnidrones::tasks::written::TaskRecord;
use omnidrones::tasks::{Buffers, Env, EnvConfig};
use std::sync::Arc;

fuzz_target!(|bytes: &[u8]| {
    let Ok(record) = TaskRecord::from_bytes(bytes) else { return };
    let config = EnvConfig { n_env: 2, memory_limit: 256 << 20, ..EnvConfig::default() };
    let Ok(task) = Arc::new(record).task(&config) else { return };
    let Ok(mut env) = Env::of(task, "Fuzzed", &config) else { return };
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let actions = vec![0.1; 2 * env.spec().n_agent * env.spec().action.len()];
    for _ in 0..3 {
        env.step(&actions, &mut out.out()).unwrap();
    }
});
