//! Mutated files never panic, never overflow the stack, never hang: 1e5 of them by default.
//!
//! `FUZZ_N` and `FUZZ_SEED` choose count and seed; a failure prints the seed and case, which reproduce it.

use crate::urdf_diagnosis::files;
use omnidrones::dynamics::urdf::{ImportOptions, RotorFile, draft_rotors, export, import_text};
use omnidrones::dynamics::vehicles;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::panic::catch_unwind;
use std::time::{Duration, Instant};

const NUMBERS: [&str; 14] = [
    "NaN",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "-0",
    "0",
    "1e-320",
    "-1",
    "1e9",
    "999999999999999999999999999999",
    "0x10",
    "1e",
    "",
];
const WORDS: [&str; 24] = [
    "<link name='a'/>",
    "<joint name='j' type='fixed'>",
    "</joint>",
    "</link>",
    "</robot>",
    "<!--",
    "-->",
    "<![CDATA[",
    "]]>",
    "<!DOCTYPE a>",
    "&amp;",
    "&#0;",
    "&#x10FFFF;",
    "\"",
    "'",
    "<",
    ">",
    "/>",
    "=",
    "\u{0}",
    "\u{feff}",
    "é∂",
    "xmlns='x'",
    "[[rotors]]",
];

/// One corpus file with its rotor file.
struct Pair {
    urdf: String,
    rotors: Option<String>,
}

/// Files that import, our own and every vehicle as we write it; and files that are refused for one defect, drawn once in
/// four.
fn corpus() -> [Vec<Pair>; 2] {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let folders = ["assets/urdf", "tests/assets"].map(|folder| std::fs::read_dir(root.join(folder)).unwrap());
    let mut paths: Vec<_> = folders.into_iter().flatten().map(|e| e.unwrap().path()).collect();
    paths.retain(|p| p.extension().is_some_and(|e| e == "urdf"));
    paths.sort();
    let read = |p: &std::path::Path| std::fs::read_to_string(p);
    let own = paths.iter().map(|p| (read(p).unwrap(), read(&p.with_extension("rotors.toml")).ok()));
    let vehicles = vehicles::all();
    let written = vehicles.iter().map(|v| export(v).map(|(urdf, rotors)| (urdf, Some(rotors))).unwrap());
    let pair = |(urdf, rotors)| Pair { urdf, rotors };
    let corpus = [own.chain(written).map(pair).collect(), files().into_iter().map(pair).collect()];
    let n: usize = corpus.iter().map(Vec::len).sum();
    assert!(n >= 100, "{n} files");
    corpus
}

fn below(rng: &mut ChaCha8Rng, n: usize) -> usize {
    if n == 0 { 0 } else { rng.random_range(0..n) }
}

/// A stretch of at most `most` bytes.
fn stretch(rng: &mut ChaCha8Rng, text: &[u8], most: usize) -> std::ops::Range<usize> {
    let start = below(rng, text.len());
    start..(start + 1 + below(rng, most)).min(text.len())
}

/// Where words, quoted or not, lie: maximal runs without blanks, quotes, angles and equals signs.
fn tokens(text: &[u8], test: impl Fn(&[u8]) -> bool) -> Vec<std::ops::Range<usize>> {
    let cut = |b: u8| b.is_ascii_whitespace() || b"\"'<>=/,[]".contains(&b);
    let mut found = Vec::new();
    let mut start = 0;
    for i in 0..=text.len() {
        if i == text.len() || cut(text[i]) {
            if i > start && test(&text[start..i]) {
                found.push(start..i);
            }
            start = i + 1;
        }
    }
    found
}

fn mutate(rng: &mut ChaCha8Rng, text: &mut Vec<u8>) {
    match below(rng, 10) {
        0 => {
            let at = below(rng, text.len());
            if let Some(byte) = text.get_mut(at) {
                *byte ^= 1 << below(rng, 8);
            }
        }
        1 => drop(text.drain(stretch(rng, text, 40))),
        2 => drop(text.drain(stretch(rng, text, 400))),
        3 => {
            let piece = text[stretch(rng, text, 300)].to_vec();
            let at = below(rng, text.len());
            text.splice(at..at, piece);
        }
        4 => {
            let words = tokens(text, |_| true);
            let (a, b) = (below(rng, words.len()), below(rng, words.len()));
            if let (Some(a), Some(b)) = (words.get(a), words.get(b)) {
                let word = text[b.clone()].to_vec();
                text.splice(a.clone(), word);
            }
        }
        5..=7 => {
            let numbers = tokens(text, |w| std::str::from_utf8(w).is_ok_and(|w| w.parse::<f64>().is_ok()));
            if let Some(at) = numbers.get(below(rng, numbers.len())) {
                text.splice(at.clone(), NUMBERS[below(rng, NUMBERS.len())].bytes());
            }
        }
        8 => {
            let (at, depth) = (below(rng, text.len()), 1 + below(rng, 90));
            let nest = "<link>".repeat(depth) + &"</link>".repeat(below(rng, depth + 1));
            text.splice(at..at, nest.bytes());
        }
        _ => {
            let at = below(rng, text.len());
            text.splice(at..at, WORDS[below(rng, WORDS.len())].bytes());
        }
    }
}

fn mutated(rng: &mut ChaCha8Rng, text: &str) -> String {
    let mut bytes = text.as_bytes().to_vec();
    // Mostly one defect, so that many files get past the parser to the physics.
    let rounds = if below(rng, 3) == 0 { 2 + below(rng, 4) } else { 1 };
    for _ in 0..rounds {
        mutate(rng, &mut bytes);
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Imports; whatever comes out must be sound enough to be written and read again.
fn attempt(urdf: &str, rotors: Option<&str>) -> bool {
    let options = ImportOptions::default();
    let file = match rotors.map(|text| RotorFile::parse(text, "f.rotors.toml")).transpose() {
        Ok(file) => file,
        Err(error) => return error.to_string().contains('\n').then(|| panic!("two lines: {error}")).is_some(),
    };
    match import_text(urdf, "f.urdf", file.as_ref(), &options) {
        Err(error) => {
            assert!(!error.to_string().contains('\n'), "two lines: {error}");
            false
        }
        Ok(import) => {
            import.vehicle.validate().unwrap();
            assert!(import.warnings.iter().all(|w| !w.to_string().contains('\n')));
            let _ = export(&import.vehicle);
            let _ = draft_rotors(urdf, "f.urdf", &options);
            true
        }
    }
}

fn case(seed: u64, index: u64, corpus: &[Vec<Pair>; 2]) -> (String, Option<String>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    let pairs = &corpus[below(&mut rng, 4) / 3];
    let pair = &pairs[below(&mut rng, pairs.len())];
    if pair.rotors.is_some() && rng.next_u32() % 5 == 0 {
        return (pair.urdf.clone(), pair.rotors.as_ref().map(|text| mutated(&mut rng, text)));
    }
    (mutated(&mut rng, &pair.urdf), pair.rotors.clone())
}

#[test]
fn a_hundred_thousand_mutated_files_give_an_error_or_a_sound_vehicle_and_never_a_panic() {
    let number = |name: &str, default: u64| std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default);
    let (count, seed) = (number("FUZZ_N", 100_000), number("FUZZ_SEED", 20_260_101));
    let corpus = corpus();
    let start = Instant::now();
    let run = |first: u64| {
        let (mut accepted, mut slowest) = (0u64, Duration::ZERO);
        for index in (first..count).step_by(2) {
            let (urdf, rotors) = case(seed, index, &corpus);
            let begin = Instant::now();
            match catch_unwind(|| attempt(&urdf, rotors.as_deref())) {
                Ok(fine) => accepted += u64::from(fine),
                Err(_) => panic!("case {index} of seed {seed} (FUZZ_SEED={seed}) panicked on:\n{urdf}\n{rotors:?}"),
            }
            slowest = slowest.max(begin.elapsed());
        }
        (accepted, slowest)
    };
    let ((a, s), (b, t)) = std::thread::scope(|scope| {
        let other = scope.spawn(|| run(1));
        (run(0), other.join().unwrap_or_else(|_| panic!("see the other thread")))
    });
    println!("{count} files, {} accepted, slowest {:?}, {:?} in all", a + b, s.max(t), start.elapsed());
    assert!(a + b > count / 20, "too few mutants reach the physics: {}", a + b);
    assert!(s.max(t) < Duration::from_secs(1));
}
