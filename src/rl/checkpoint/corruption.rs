//! Random damage to the files of a checkpoint: no panic, no silent load, and the checkpoint before is found.

use super::disk::hex;
use super::tests::{same, sample};
use super::{Checkpoint, Entry, Files, MANIFEST, Manifest, POLICY, STATE, Store};
use rng::{Purpose, Stream};
use sha2::{Digest, Sha256};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// policy, state, manifest; `None` is no file.
type Contents = [Option<Vec<u8>>; 3];
const NAMES: [&str; 3] = [POLICY, STATE, MANIFEST];

fn contents(folder: &Path) -> Contents {
    NAMES.map(|name| std::fs::read(folder.join(name)).ok())
}

fn put(folder: &Path, contents: &Contents) {
    for (name, bytes) in NAMES.iter().zip(contents) {
        // some file systems wait for the medium when a file is written over, not when it is new
        let _ = std::fs::remove_file(folder.join(name));
        if let Some(bytes) = bytes {
            std::fs::write(folder.join(name), bytes).unwrap();
        }
    }
}

/// Makes the manifest right for the other two files, with `edit`.
fn reseal(contents: &mut Contents, edit: impl Fn(Manifest) -> Manifest) {
    let path = Path::new(MANIFEST);
    let [Some(policy), Some(state), Some(text)] = contents else { panic!("a file is missing") };
    let entry = |bytes: &[u8]| Entry { bytes: bytes.len() as u64, sha256: hex(&Sha256::digest(bytes)) };
    let files = Files { policy: entry(policy), state: entry(state) };
    let manifest = edit(Manifest { files, ..Manifest::unseal(text, path).unwrap() });
    *text = manifest.seal(path).unwrap().into_bytes();
}

fn swap_sections(bytes: &mut [u8], stream: &mut Stream) {
    let half = bytes.len() as u64 / 2;
    let size = 1 + stream.below(half.min(64)) as usize;
    let (a, b) = (stream.below(half + 1 - size as u64), half + stream.below(half + 1 - size as u64));
    (0..size).for_each(|i| bytes.swap(a as usize + i, b as usize + i));
}

const KINDS: [&str; 10] = [
    "flip a bit",
    "truncate",
    "append",
    "swap policy and state",
    "swap two sections",
    "overwrite a section",
    "take a file of another checkpoint",
    "lose a file",
    "another format, sealed",
    "a huge header, sealed",
];

fn corrupt(kind: usize, mut new: Contents, old: &Contents, stream: &mut Stream) -> Contents {
    let which = stream.below(3) as usize;
    let Some(bytes) = &mut new[which] else { panic!("a file is missing") };
    let n = bytes.len() as u64;
    match kind {
        0 => bytes[stream.below(n) as usize] ^= 1 << stream.below(8),
        1 => bytes.truncate(stream.below(n) as usize),
        2 => bytes.extend((0..=stream.below(64)).map(|_| stream.next_u64() as u8)),
        3 => new.swap(0, 1),
        4 => swap_sections(bytes, stream),
        5 => {
            let (start, size) = (stream.below(n) as usize, 1 + stream.below(512) as usize);
            let fill = if stream.below(2) == 0 { 0 } else { stream.next_u64() as u8 };
            bytes.iter_mut().skip(start).take(size).for_each(|b| *b = fill);
        }
        6 => new[which].clone_from(&old[which]),
        7 => new[which] = None,
        8 => {
            let format = if stream.below(2) == 0 { 0 } else { 2 + stream.next_u64() as u32 % 1000 };
            reseal(&mut new, |manifest| Manifest { format, ..manifest });
        }
        _ => {
            let length = [1 << 63, u64::MAX, stream.next_u64() | 1 << 21][stream.below(3) as usize];
            let Some(bytes) = &mut new[which % 2] else { panic!("a file is missing") };
            bytes[..8].copy_from_slice(&length.to_le_bytes());
            reseal(&mut new, |manifest| manifest);
        }
    }
    new
}

/// `n` corruptions of the newer of two checkpoints.
fn corruptions(n: u64, seed: u64) {
    let run = tempfile::tempdir().unwrap();
    let mut writer = Store::open_to_write(run.path(), 2).unwrap();
    let folders = [1, 2].map(|update| writer.save(&sample(update, 20)).unwrap());
    let [old, new] = [0, 1].map(|i| contents(&folders[i]));
    let mut counts = [0; KINDS.len()];
    for case in 0..n {
        let kind = (case % KINDS.len() as u64) as usize;
        let mut stream = Stream::new(seed, case, 0, Purpose::TASK);
        let damaged = corrupt(kind, new.clone(), &old, &mut stream);
        // equal sections swapped, zeros overwritten by zeros
        if damaged == new {
            continue;
        }
        put(&folders[1], &damaged);
        let place = format!("FUZZ_SEED={seed}, case {case} ({})", KINDS[kind]);
        let Ok(outcome) = catch_unwind(AssertUnwindSafe(|| writer.store().latest())) else { panic!("{place}: panic") };
        let Ok(Some(found)) = outcome else { panic!("{place}: {outcome:?}") };
        assert!(found.skipped.len() == 1 && found.skipped[0].folder == folders[1], "{place}: {:?}", found.skipped);
        assert!(same(&found.checkpoint, &sample(1, 20)), "{place}: not the checkpoint before");
        counts[kind] += 1;
    }
    put(&folders[1], &new);
    assert!(same(&Checkpoint::load(&folders[1]).unwrap(), &sample(2, 20)));
    println!("corruptions caught: {:?}", KINDS.iter().zip(counts).collect::<Vec<_>>());
    assert!(counts.iter().all(|c| *c * 11 > n / KINDS.len() as u64 * 10), "{counts:?}");
}

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |n| n.parse().unwrap())
}

#[test]
fn no_corruption_is_loaded_and_the_checkpoint_before_is_found() {
    corruptions(2_000, number("FUZZ_SEED", 1));
}

/// FUZZ_N=100000 FUZZ_SEED=2 cargo test --release -p omnidrones-rl --lib checkpoint::corruption -- --ignored
#[test]
#[ignore = "FUZZ_N=100000 cargo test --release -p omnidrones-rl --lib no_corruption_of_many -- --ignored --nocapture: 20 s"]
fn no_corruption_of_many_is_loaded() {
    corruptions(number("FUZZ_N", 100_000), number("FUZZ_SEED", 2));
}

/// Headers changed at random (FUZZ_N=100000 for more), with hashes and seals that are right: they may say something
/// else, but do no harm.
#[test]
fn forged_headers_load_as_something_or_give_an_error() {
    let run = tempfile::tempdir().unwrap();
    let mut writer = Store::open_to_write(run.path(), 2).unwrap();
    let folder = writer.save(&sample(1, 3)).unwrap();
    let (pristine, seed) = (contents(&folder), number("FUZZ_SEED", 1));
    let (mut loaded, n) = (0, number("FUZZ_N", 1_000));
    for case in 0..n {
        let mut stream = Stream::new(seed, case, 1, Purpose::TASK);
        let mut forged = pristine.clone();
        let Some(bytes) = &mut forged[stream.below(2) as usize] else { panic!("a file is missing") };
        let end = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap());
        for _ in 0..=stream.below(3) {
            let at = 8 + stream.below(end - 8) as usize;
            let digits = bytes[at].is_ascii_digit();
            bytes[at] = if digits { b'0' + stream.below(10) as u8 } else { 32 + stream.below(95) as u8 };
        }
        if stream.below(4) == 0 {
            let digit = 8 + bytes[8..end as usize].iter().position(u8::is_ascii_digit).unwrap();
            bytes.splice(digit..digit + 1, *b"18446744073709551615");
            bytes[..8].copy_from_slice(&(end - 8 + 19).to_le_bytes());
        }
        reseal(&mut forged, |manifest| manifest);
        put(&folder, &forged);
        let outcome = catch_unwind(|| Checkpoint::load(&folder));
        let Ok(outcome) = outcome else { panic!("FUZZ_SEED={seed}, case {case}: panic") };
        loaded += u64::from(outcome.is_ok());
    }
    assert!(0 < loaded && loaded < n, "{loaded} of {n} loaded"); // measured 84 of 1 000
}
