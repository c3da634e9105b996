//! A batch read from a configuration file: other masses and rotors in every episode, wind, late actions, noisy normalised
//! observations with memory; and a curriculum that widens the ranges.
//!
//! `cargo run --release --example randomised_batch`

use omnidrones::error::Result;
use omnidrones::prelude::*;
use omnidrones::tasks::Spread;

/// As `omnidrones tasks Hover --toml` writes it, shortened: what is left out has its default.
const FILE: &str = r#"
n_env = 256
seed = 7
delay = { min = 0, max = 2 }     # steps, drawn for every episode
difficulty = 0.0                 # where the curriculum begins
observation = [                  # in this order
    { kind = "noise", std = 0.01, slices = ["target", "velocity"] },
    { kind = "normalise" },
    { kind = "history", steps = 2 },
    { kind = "privileged" },
]

[task]
vehicle = "crazyflie"
horizon = 20

[[randomise]]
what = "mass"
range = [0.7, 1.4]
distribution = "log_uniform"

[[randomise]]
what = "thrust"                  # k_f of every rotor
range = [0.9, 1.1]
each = true                      # a draw per rotor

[[randomise]]
what = "wind"
range = [-2.0, 2.0]              # m/s per axis, world
by = "set"
when = "startup"                 # once per environment
"#;

fn main() -> Result<()> {
    let mut env = Env::make("Hover", &EnvConfig::from_toml(FILE, "hover.toml")?)?;
    let spec = env.spec().clone();
    println!("{} numbers seen, {} of them physical numbers of the drone", spec.n_observation, spec.privileged.len());
    let mut out = Buffers::new(&spec);
    env.reset(None, None, &mut out.out())?;
    let mut actions = vec![0.0; spec.n_env * spec.action.len()];
    for stage in 0..5 {
        env.set_difficulty(f64::from(stage) / 4.0)?; // counts for episodes that begin from now on
        for draw in 0..2 * spec.horizon {
            env.sample(draw as u64, &mut actions);
            env.step(&actions, &mut out.out())?;
        }
        env.update_normaliser();
        let mut masses: Vec<f32> = out.privileged.chunks(spec.privileged.len()).map(|row| 1e3 * row[0]).collect();
        let mass = Spread::of(&mut masses);
        let std = env.statistics().variance[2].sqrt();
        print!("difficulty {:.2}: mass {:.1} g, ", f64::from(stage) / 4.0, mass.median);
        println!("80 % within {:.1} to {:.1} g; height error ± {std:.2} m", mass.low, mass.high);
    }
    // The exact state, random streams and statistics included: the copy goes on with the same bits.
    let saved = env.save();
    let mut copy = Env::make("Hover", &spec.config)?;
    copy.load(&saved)?;
    println!("saved {} kB; the copy is the same: {}", saved.len() / 1000, copy.save() == saved);
    Ok(())
}
