//! Files of settings and vehicles, mutated: a clear error or sound settings, never a panic. `FUZZ_N` and `FUZZ_SEED` choose count
//! and seed.

use omnidrones::dynamics::{Vehicle, vehicles};
use omnidrones::rl::TrainConfig;
use omnidrones::rl::recipes::recipes_of;
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{EnvConfig, registry};
use std::time::{Duration, Instant};

const NUMBERS: &[&str] = &[
    "0",
    "-1",
    "1e300",
    "-1e300",
    "1e-320",
    "nan",
    "inf",
    "-inf",
    "9223372036854775807",
    "-9223372036854775808",
    "0.5",
    "1e12",
    "3",
    "true",
    "''",
    "[]",
    "{}",
    "1_000",
    "0x10",
    "1979-05-27",
];

/// Files as they are written, by kind.
fn corpus() -> Vec<(&'static str, String)> {
    let mut all: Vec<_> =
        vehicles::names().iter().map(|name| ("vehicle", vehicles::by_name(name).unwrap().to_toml().unwrap())).collect();
    for entry in registry::REGISTRY {
        for algorithm in recipes_of(entry.name) {
            let config = TrainConfig::for_task(entry.name, Some(algorithm), None).unwrap();
            all.push(("run", config.to_toml().unwrap()));
            all.push(("environment", toml::to_string(&config.env).unwrap()));
        }
    }
    all
}

/// The places of words between blanks and punctuation.
fn words(text: &str) -> Vec<std::ops::Range<usize>> {
    let cut = |c: char| c.is_whitespace() || "=,[]{}'\"".contains(c);
    let mut found = Vec::new();
    let mut start = 0;
    for (i, c) in text.char_indices().chain([(text.len(), ' ')]) {
        if cut(c) {
            if i > start {
                found.push(start..i);
            }
            start = i + c.len_utf8();
        }
    }
    found
}

fn mutate(draws: &mut Stream, text: &str) -> String {
    let words = words(text);
    let mut below = |n: usize| draws.below(n.max(1) as u64) as usize;
    let Some(at) = words.get(below(words.len())).cloned() else { return text.into() };
    let mut text = text.to_string();
    let line = |text: &str, k: usize| text.split_inclusive('\n').nth(k).unwrap_or_default().to_string();
    match below(7) {
        0..=2 => {
            let numbers: Vec<_> = words.into_iter().filter(|w| text[w.clone()].parse::<f64>().is_ok()).collect();
            let at = numbers.get(below(numbers.len())).cloned().unwrap_or(at);
            text.replace_range(at, NUMBERS[below(NUMBERS.len())]);
        }
        3 => text.replace_range(at, ""),
        4 => {
            let other = words.get(below(words.len())).cloned().unwrap_or(0..0);
            let word = text[other].to_string();
            text.replace_range(at, &word);
        }
        5 => {
            let (n, k) = (text.lines().count(), below(usize::MAX));
            text = text.replacen(&line(&text, k % n.max(1)), "", 1);
        }
        _ => {
            let mut bytes = text.into_bytes();
            let at = below(bytes.len());
            bytes[at] ^= 1 << below(8);
            text = String::from_utf8_lossy(&bytes).into_owned();
        }
    }
    text
}

/// Reads it as what it was; whether it is taken.
fn attempt(kind: &str, text: &str) -> Result<(), omnidrones::error::Error> {
    match kind {
        "vehicle" => Vehicle::from_toml_str(text, "f.toml").and_then(|v| v.to_toml()).map(drop),
        "run" => {
            let config = TrainConfig::from_toml(text, "f.toml")?;
            config.validate()?;
            config.to_toml().map(drop)
        }
        _ => EnvConfig::from_toml(text, "f.toml").and_then(|config| config.validate()),
    }
}

#[test]
fn mutated_settings_and_vehicles_give_an_error_of_one_line_or_are_sound() {
    let number = |name: &str, default: u64| std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default);
    let (count, seed) = (number("FUZZ_N", 3_000), number("FUZZ_SEED", 20_260_102));
    let corpus = corpus();
    let (mut taken, mut slowest) = (0, Duration::ZERO);
    for index in 0..count {
        let mut draws = Stream::new(seed, index, 0, Purpose::LEARNING);
        let (kind, text) = &corpus[draws.below(corpus.len() as u64) as usize];
        let mut text = text.clone();
        for _ in 0..1 + draws.below(3) {
            text = mutate(&mut draws, &text);
        }
        let begun = Instant::now();
        match std::panic::catch_unwind(|| attempt(kind, &text)) {
            Ok(Ok(())) => taken += 1,
            Ok(Err(error)) => {
                let told = error.to_string();
                assert!(told.lines().count() == 1 && told.len() < 4000, "case {index} of seed {seed}: {told}");
            }
            Err(_) => panic!("case {index} of seed {seed} ({kind}) panicked on:\n{text}"),
        }
        slowest = slowest.max(begun.elapsed());
    }
    println!("{count} files, {taken} taken, the slowest {slowest:?}");
    assert!(taken > count / 50 && taken < count - count / 50, "{taken} of {count}: these mutations test nothing");
    assert!(slowest < Duration::from_secs(1), "{slowest:?}"); // measured: a few ms
}
