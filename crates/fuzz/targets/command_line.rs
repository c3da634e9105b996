#![no_main]
//! Command lines: every byte is a word. Of commands only those that write nothing, so that a fuzzer harms nobody's files.

use libfuzzer_sys::fuzz_target;
use omnidrones_cli::outcome;
use std::ffi::OsString;

const COMMANDS: &[&[&str]] = &[&["tasks"], &["models"], &["allocate"], &["show"], &["train", "--toml"]];
const WORDS: &[&str] = &[
    "", "\u{1b}[2J", "é∂", "Hover", "TrackRand", "FlyThrough", "OverHover", "Formation", "OmavTrack", "hummingbird",
    "firefly", "omav", "dragon", "nobody", "--toml", "--json", "--set", "--seed", "--dt", "--horizon", "--envs",
    "--control", "--vehicle", "--config", "--randomise", "--integrator", "--algo", "--updates", "--seeds",
    "--threads", "--search", "--factor", "--no-baseline", "--rotors", "--package", "--wrench", "--fail", "--yaw-last",
    "--gradient", "--help", "--", "-", "-1", "0", "1", "2:0.5", "1e300", "-1e300", "1e-300", "nan", "inf",
    "18446744073709551616", "0,0,0,0,0,0", "0,0,9.81,0,0,0.01", "nan,0,0,0,0,0", "horizon=100", "horizon=0",
    "a=/dev/zero", "apg.learning_rate.from=nan", "apg.hidden=[1000000000]", "env.n_env=1000000000000",
    "from=/dev/zero", "mass:0.5:2", "mass:2:0.5", "wind:-1:1", "delay:0:nan", "ppo", "apg", "shac", "mappo", "happo", "dagger", "rma", "sac", "td3", "qmix",
    "rate", "velocity", "attitude", "rk4", "/dev/zero", "/nowhere", ".", "=", ":",
];

fuzz_target!(|data: &[u8]| {
    let Some((command, words)) = data.split_first() else { return };
    let command = COMMANDS[usize::from(*command) % COMMANDS.len()].iter();
    let words = words.iter().take(12).map(|byte| &WORDS[usize::from(*byte) % WORDS.len()]);
    let line = ["omnidrones"].iter().chain(command).chain(words).map(OsString::from);
    let _ = outcome(line);
});
