//! Bits that do not change unnoticed: hashes of rollouts, and of weights behind a few updates, whose gradients they carry.
//!
//! All instruction sets that fuse multiplication and addition come to the same hash, the one-lane fallback to another. A change
//! of a hash is a line in the changelog; the test prints the table as it is now.

use autodiff::lanes::{InstructionSet, with_set};
use base::parallel::Threads;
use rl::Learner;
use rl::apg::{Apg, ApgConfig};
use rl::ppo::{Ppo, PpoConfig};
use rl::shac::{Shac, ShacConfig};
use sha2::{Digest, Sha256};
use tasks::{Buffers, Env, EnvConfig};

/// Name, hash where operations are fused, hash of one lane.
const TABLE: &[(&str, &str, &str)] = &[
    ("Hover", "056381bcc99a3415", "1893eca20fac819c"),
    ("TrackRand", "f8059b86429b0587", "5626c9602b012559"),
    ("PayloadHover", "d95e8b56287f9ec0", "b54f82b590268821"),
    ("InvPendulumHover", "3cfa8ef13d21de8c", "ead3b763692b1c9d"),
    ("OmavHover", "1d9177ea3a60470b", "27b5db4b589676e2"),
    ("OverHover", "78d1a6a0d1eecb6e", "7c325c7c538df379"),
    ("Formation", "075130462ddddc33", "62ecead03b238d9f"),
    ("Hover by APG", "2145223f6c6a628a", "9957953b6fa1de4d"),
    ("PayloadHover by SHAC", "4db9c6ede85721b4", "b9c7bd153bcc28d4"),
    ("Hover by PPO", "e03e4483a24d80f8", "48016aeea6dfce0e"),
];

/// The first eight bytes of a hash of numbers by their bits.
fn hash(numbers: impl IntoIterator<Item = f32>) -> String {
    let mut all = Sha256::new();
    numbers.into_iter().for_each(|x| all.update(x.to_bits().to_le_bytes()));
    all.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

/// Rewards and observations of 70 environments over 40 steps of random actions.
fn flown(task: &str) -> String {
    let mut env = Env::make(task, &EnvConfig { n_env: 70, seed: 5, stagger: true, ..EnvConfig::default() }).unwrap();
    env.set_threads(Threads::new(1).unwrap());
    let mut buffers = Buffers::new(env.spec());
    env.reset(None, None, &mut buffers.out()).unwrap();
    let mut actions = vec![0.0; 70 * env.spec().n_agent * env.spec().action.len()];
    let mut seen = Vec::new();
    for draw in 0..40 {
        env.sample(draw, &mut actions);
        env.step(&actions, &mut buffers.out()).unwrap();
        seen.extend(buffers.reward.iter().chain(&buffers.observation));
    }
    hash(seen)
}

/// Weights behind two updates.
fn learnt(mut learner: impl Learner) -> String {
    for _ in 0..2 {
        learner.update().unwrap();
    }
    hash(learner.policy().unwrap().parameters().to_vec())
}

/// Three algorithms, by settings that no recipe changes.
fn runs() -> Vec<(String, String)> {
    let (env, one) = (EnvConfig::default(), || Threads::new(1).unwrap());
    let apg = ApgConfig { n_env: 64, shard: 64, horizon: 12, ..ApgConfig::default() };
    let shac = ShacConfig { n_env: 64, shard: 64, horizon: 8, ..ShacConfig::default() };
    let ppo = PpoConfig { n_env: 64, shard: 64, steps: 8, ..PpoConfig::default() };
    vec![
        ("Hover by APG".into(), learnt(Apg::new("Hover", &env, apg, 7, one()).unwrap())),
        ("PayloadHover by SHAC".into(), learnt(Shac::new("PayloadHover", &env, shac, 7, one()).unwrap())),
        ("Hover by PPO".into(), learnt(Ppo::new("Hover", &env, ppo, 7, one()).unwrap())),
    ]
}

/// What is hashed.
fn all() -> Vec<(String, String)> {
    let tasks = ["Hover", "TrackRand", "PayloadHover", "InvPendulumHover", "OmavHover", "OverHover", "Formation"];
    let flights = tasks.into_iter().map(|task| (task.to_string(), flown(task)));
    flights.chain(runs()).collect()
}

#[test]
fn bits_are_those_of_before_with_every_instruction_set() {
    let sets =
        [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane].into_iter().filter(|set| set.is_here());
    let found: Vec<_> = sets.map(|set| (set, with_set(set, all))).collect();
    for (set, hashes) in &found {
        for (name, hash) in hashes {
            println!("{set:?}: {name}: {hash}");
        }
    }
    for (set, hashes) in &found {
        for (name, hash) in hashes {
            let (_, fused, one) = TABLE.iter().find(|(known, ..)| known == name).unwrap_or_else(|| panic!("{name}"));
            let wanted = if *set == InstructionSet::OneLane { one } else { fused };
            assert_eq!(hash, wanted, "{name} with {set:?}: a line of the changelog, or a mistake");
        }
    }
}
