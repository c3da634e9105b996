#![no_main]
//! Command lines: every byte is a word. Of commands only those that write nothing, so that a fuzzer harms nobody's files.

use libfuzzer_sys::fuzz_target;
use omnidrones_cli::outcome;
use std::ffi::OsString;

const COMMANDS: &[&[&str]] = &[&["tasks"], &["models"], &["allocate"], &["show"], &["train", "--toml"], &["train-all", "--list"]];
const WORDS: &[&str] = &[
    "Hover", "TrackRand", "FlyThrough", "OverHover", "Formation", "OmavTrack", "hummingbird", "firefly", "omav", "dragon", "nobody", "",
    "--toml", "--json", "--markdown", "--list", "--set", "--seed", "--dt", "--horizon", "--envs", "--control", "--vehicle",
    "--randomise", "--integrator", "--algo", "--updates", "--seeds", "--threads", "--tilt", "--wrench", "--fail", "--failed",
    "--thrust", "--roll", "--pitch", "--yaw", "--force", "--torque", "--search", "--", "-", "-1", "0", "1", "1e300", "-1e300",
    "1e-300", "nan", "inf", "18446744073709551616", "0,0,0", "1,2", "1,2,3,4", "horizon=100", "apg.learning_rate.from=nan",
    "env.task.horizon=0", "mass:0.5:2", "mass:2:0.5", "wind:-1:1", "motor_constant:0:0", "ppo", "apg", "shac", "mappo", "dagger",
    "rate", "velocity", "attitude", "rk4", "\u{1b}[2J", "é∂", "=", ":",
];

fuzz_target!(|data: &[u8]| {
    let Some((command, words)) = data.split_first() else { return };
    let command = COMMANDS[usize::from(*command) % COMMANDS.len()].iter();
    let words = words.iter().take(12).map(|byte| &WORDS[usize::from(*byte) % WORDS.len()]);
    let line = ["omnidrones"].iter().chain(command).chain(words).map(OsString::from);
    let _ = outcome(line);
});
