//! The state of a training run on disk: whole or absent, verified before use, readable by others.
//!
//! ```text
//! <run>/checkpoints/000000120/manifest.json        what it is: task, configuration, update; sizes and hashes
//!                             policy.safetensors   the weights that fly, f32
//!                             state.safetensors    what else it takes to go on to the same bits
//! ```
//!
//! A checkpoint is tensors with names, and a [`Manifest`]. What the names mean is the business of whoever saves; the
//! convention is `<network>.<layer>.weight` of shape `[out, in]` and `<network>.<layer>.bias` of shape `[out]`,
//! row-major, layers counted from 0. So PyTorch flies a policy of APG or SHAC in five lines (PPO's
//! has ELU between its layers and none behind the last; its `normaliser.mean` and `normaliser.variance` in the same file go
//! before the first; where every agent has its own, names begin with `actor.agent0`, `actor.agent1` and so on):
//!
//! ```python
//! from safetensors.torch import load_file
//! from torch.nn.functional import linear
//! w, y = load_file("run/checkpoints/000000120/policy.safetensors"), observation
//! for l in range(3):
//!     y = linear(y, w[f"actor.{l}.weight"], w[f"actor.{l}.bias"]).tanh()
//! ```
//!
//! **Killed is not lost.** [`CheckpointWriter::save`] writes and syncs all files in a folder aside, renames that folder into
//! place and syncs its parent, so a crash at any instant leaves the checkpoints of before, or those and the new one.
//! Older ones are removed only then, and never the last that are known to be whole.
//!
//! **A file is data.** Loading opens the three files above and no other, runs no code, and allocates no more than the
//! files are long: lengths are compared and limited before. Every byte stands under a SHA-256: that of the tensors is
//! in the manifest, that of the manifest in its last line. The hashes find damage; they are no signature, and who can
//! write the files can forge them.
//!
//! ```
//! # use omnidrones_rl::omnidrones;
//! use omnidrones::rl::checkpoint::{Checkpoint, Manifest, Store, Tensors};
//! # let run = tempfile::tempdir().unwrap();
//! # let run = run.path();
//! let mut policy = Tensors::new();
//! policy.insert("actor.0.weight", &[1, 2], vec![0.5f32, -0.5])?;
//! let manifest = Manifest { task: "hover".into(), update: 120, ..Manifest::default() };
//! let mut writer = Store::open_to_write(run, 2)?;
//! writer.save(&Checkpoint { manifest, policy, state: Tensors::new() })?;
//!
//! let found = Store::open(run)?.latest()?.expect("one was saved");
//! assert_eq!(found.checkpoint.policy.get::<f32>("actor.0.weight", &[1, 2])?, [0.5, -0.5]);
//! assert!(found.skipped.is_empty());
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

#[cfg(test)]
mod corruption;
mod disk;
mod file;
mod manifest;
pub mod store;
mod tensor;

pub use disk::Entry;
pub use manifest::{FORMAT, Files, Manifest};
pub use store::{CheckpointWriter, LatestCheckpoint, SkippedCheckpoint, Store};
pub use tensor::{Data, Tensor, TensorElement, Tensors};

use base::error::{Error, Result};
use base::file_gate;
use disk::Disk;
use file::Layout;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longest manifest and longest header of a file of tensors, bytes.
pub(crate) const MAX_HEADER: u64 = 1 << 20;
/// Both files of tensors together, bytes, unless another limit is given.
pub(crate) const MAX_BYTES: u64 = 8 << 30;

/// Which tensors of a checkpoint are wanted, by their names.
pub(crate) type Wanted<'a> = &'a dyn Fn(&str) -> bool;

/// What it takes to fly: all but the steps that are kept to be learnt from, which may be a thousand times as large.
pub(crate) fn flies(tensor: &str) -> bool {
    !tensor.starts_with(super::replay::KEPT)
}

const MANIFEST: &str = "manifest.json";
const POLICY: &str = "policy.safetensors";
const STATE: &str = "state.safetensors";
/// All files of a checkpoint.
const FILES: [&str; 3] = [POLICY, STATE, MANIFEST];

/// Everything that a run needs to go on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Checkpoint {
    /// What it is of.
    pub manifest: Manifest,
    /// What one needs to fly: weights, `f32` alone.
    pub policy: Tensors,
    /// What one needs besides to go on to the same bits.
    pub state: Tensors,
}

impl Checkpoint {
    /// The checkpoint in `folder`, of at most `MAX_BYTES`.
    ///
    /// # Errors
    /// As [`load_within`](Self::load_within).
    pub fn load(folder: impl AsRef<Path>) -> Result<Self> {
        Self::load_within(folder, MAX_BYTES)
    }

    /// The checkpoint in `folder`, if its files of tensors have `max_bytes` at most together.
    ///
    /// # Errors
    /// [`Error::File`] if a file cannot be read, [`Error::Limit`] if one is too long, [`Error::Format`] if one is
    /// damaged or of another format.
    pub fn load_within(folder: impl AsRef<Path>, max_bytes: u64) -> Result<Self> {
        Self::load_wanted(folder.as_ref(), max_bytes, &|_| true)
    }

    /// As [`load_within`](Self::load_within), with those tensors alone that are wanted; checked is all.
    pub(crate) fn load_wanted(folder: &Path, max_bytes: u64, wanted: Wanted<'_>) -> Result<Self> {
        let path = folder.join(MANIFEST);
        let manifest = Manifest::unseal(&read_text(&path)?, &path)?;
        let Files { policy, state } = &manifest.files;
        check_total(folder, policy.bytes.saturating_add(state.bytes), max_bytes)?;
        let policy = file::read(&folder.join(POLICY), policy, wanted)?;
        check_policy(&policy)?;
        let state = file::read(&folder.join(STATE), state, wanted)?;
        Ok(Self { manifest, policy, state })
    }

    /// Writes the three files into a new `folder`, down to the medium.
    fn write(&self, folder: &Path, disk: &Disk, max_bytes: u64) -> Result<()> {
        check_policy(&self.policy)?;
        let paths = FILES.map(|name| folder.join(name));
        let (policy, state) = (Layout::new(&self.policy, &paths[0])?, Layout::new(&self.state, &paths[1])?);
        check_total(folder, policy.bytes.saturating_add(state.bytes), max_bytes)?;
        disk.make_folder(folder)?;
        let files = Files { policy: policy.write(&paths[0], disk)?, state: state.write(&paths[1], disk)? };
        let Manifest { version, instructions, .. } = Manifest::default();
        let manifest = Manifest { files, format: FORMAT, version, instructions, ..self.manifest.clone() };
        let text = manifest.seal(&paths[2])?;
        check_text(&paths[2], text.len() as u64)?;
        // what could not be read again shall not replace what can
        Manifest::unseal(text.as_bytes(), &paths[2])?;
        let mut sink = disk.create(&paths[2])?;
        sink.write(text.as_bytes())?;
        sink.finish()?;
        disk.sync_folder(folder)
    }
}

/// Refuses a run in `folder` whose checkpoints, of at least `bytes` each, could not be loaded again or of which the disk cannot hold
/// `copies` more.
///
/// # Errors
/// [`Error::Limit`].
pub(crate) fn check_room(folder: &Path, bytes: u64, copies: usize) -> Result<()> {
    let what = "bytes of steps that a checkpoint keeps";
    if bytes > MAX_BYTES {
        return Err(Error::limit(what, bytes, MAX_BYTES, "Keep fewer steps: replay.capacity."));
    }
    let need = bytes.saturating_mul(copies as u64);
    match file_gate::left(folder) {
        Some(left) if need > left => {
            let what = format!("{what}, times {copies} at once,");
            let limit = format!("{left}, which the disk of {} has left", folder.display());
            let remedy = "Make room, train in another folder, or keep fewer steps: replay.capacity.";
            Err(Error::limit(what, need, limit, remedy))
        }
        _ => Ok(()),
    }
}

fn check_policy(policy: &Tensors) -> Result<()> {
    match policy.iter().find(|(_, tensor)| !matches!(tensor.data(), Data::F32(_))) {
        None => Ok(()),
        Some((name, _)) => {
            let remedy = "Keep other kinds in the state.";
            Err(Error::value(format!("tensor {name} of the policy"), "of another kind", "f32", remedy))
        }
    }
}

fn check_total(folder: &Path, bytes: u64, max_bytes: u64) -> Result<()> {
    if bytes <= max_bytes {
        return Ok(());
    }
    let what = format!("{}: bytes of tensors", folder.display());
    Err(Error::limit(what, bytes, max_bytes, "Raise the limit of the store, or keep less in the checkpoint."))
}

fn check_text(path: &Path, bytes: u64) -> Result<()> {
    if bytes <= MAX_HEADER {
        return Ok(());
    }
    let what = format!("{}: length of the text", path.display());
    Err(Error::limit(what, bytes, MAX_HEADER, "Keep less in `config` and `extra`."))
}

/// A file and its length. Only a plain file: no link to elsewhere, no pipe that never ends.
fn open(path: &Path) -> Result<(File, u64)> {
    file_gate::own(path).map_err(|_| damaged(path, "the file", "it is a folder, a link or a device"))?;
    file_gate::open(path)
}

fn read_text(path: &Path) -> Result<Vec<u8>> {
    let (file, length) = open(path)?;
    check_text(path, length)?;
    let mut text = Vec::with_capacity(length as usize);
    file.take(length).read_to_end(&mut text).map_err(|e| Error::file(path, e))?;
    Ok(text)
}

fn damaged(path: &Path, place: impl Into<String>, rule: impl Into<String>) -> Error {
    // a foreign file may have put anything into these words
    let tame = |text: String| text.chars().filter(|c| !c.is_control()).take(400).collect();
    Error::Format {
        file: path.display().to_string(),
        place: tame(place.into()),
        rule: tame(rule.into()),
        remedy: "The file is damaged or foreign: load another checkpoint.".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::{Purpose, Stream};

    /// Every kind of tensor, with numbers that only bits tell apart; `n` scales the size, `update` changes all numbers.
    pub fn sample(update: u64, n: usize) -> Checkpoint {
        let mut stream = Stream::new(11, update, 0, Purpose::LEARNING);
        let mut bits = |n: usize| (0..n).map(|_| stream.next_u64()).collect::<Vec<_>>();
        // any bits at all: quiet and signalling NaN, infinities, subnormals
        let strange32 = [0x7f80_0001, 0x7fc0_0000, 0xffff_ffff, 0x7f80_0000, 0x8000_0000, 1].map(f32::from_bits);
        let strange64 = [0x7ff0_0000_0000_0001, u64::MAX, 0xfff0_0000_0000_0000, 1 << 63, 1].map(f64::from_bits);
        let (mut policy, mut state) = (Tensors::new(), Tensors::new());
        let weights = bits(5 * n).into_iter().map(|b| f32::from_bits(b as u32)).collect();
        policy.insert("actor.0.weight", &[n, 5], weights).unwrap();
        policy.insert("actor.0.bias", &[6], strange32.to_vec()).unwrap();
        policy.insert("actor.log_std", &[], vec![-0.5f32]).unwrap();
        policy.insert("nobody", &[3, 0], Vec::<f32>::new()).unwrap();
        state.insert("adam.m", &[3], vec![1.0f32, -0.0, 0.0]).unwrap();
        let moments = bits(3 * n).into_iter().map(f64::from_bits).collect();
        state.insert("normaliser.mean", &[3 * n], moments).unwrap();
        state.insert("normaliser.strange", &[5], strange64.to_vec()).unwrap();
        state.insert("counters", &[2, 2], bits(4)).unwrap();
        state.insert("env.3", &[7 * n], bits(7 * n).into_iter().map(|b| b as u8).collect()).unwrap();
        state.insert("none", &[0], Vec::<u64>::new()).unwrap();
        let manifest = Manifest {
            algorithm: "ppo".into(),
            task: "hover".into(),
            spec_hash: 0x00f1_e2d3_c4b5_a697,
            config: "[env]\nn_env = 64\n".into(),
            update,
            env_steps: 4096 * update,
            seconds: 0.25,
            ..Manifest::default()
        };
        Checkpoint { manifest, policy, state }
    }

    /// The same contents: the manifest without what saving fills in, and every bit of the tensors.
    pub fn same(a: &Checkpoint, b: &Checkpoint) -> bool {
        let files = |c: &Checkpoint| Manifest { files: Files::default(), ..c.manifest.clone() };
        files(a) == files(b) && a.policy == b.policy && a.state == b.state
    }

    #[test]
    fn what_was_saved_comes_back_to_the_bit() {
        let run = tempfile::tempdir().unwrap();
        // 70 000 bytes: more than one chunk, and not a whole number of them
        for (i, n) in [0, 1, 3, 10_000].into_iter().enumerate() {
            let (folder, saved) = (run.path().join(i.to_string()), sample(i as u64, n));
            saved.write(&folder, &Disk::default(), MAX_BYTES).unwrap();
            let loaded = Checkpoint::load(&folder).unwrap();
            assert!(same(&loaded, &saved), "n = {n}");
            assert_eq!(loaded.manifest.version, env!("CARGO_PKG_VERSION"));
            let length = std::fs::metadata(folder.join(STATE)).unwrap().len();
            assert_eq!(loaded.manifest.files.state.bytes, length);
        }
    }

    #[test]
    fn equal_checkpoints_are_equal_files() {
        let run = tempfile::tempdir().unwrap();
        let texts = ["a", "b"].map(|name| {
            sample(1, 9).write(&run.path().join(name), &Disk::default(), MAX_BYTES).unwrap();
            [POLICY, STATE, MANIFEST].map(|file| std::fs::read(run.path().join(name).join(file)).unwrap())
        });
        assert_eq!(texts[0], texts[1]);
    }

    #[test]
    fn what_could_not_be_loaded_is_not_saved() {
        let run = tempfile::tempdir().unwrap();
        let folder = run.path().join("x");
        let refused = |checkpoint: &Checkpoint, max_bytes: u64| {
            let _ = std::fs::remove_dir_all(&folder);
            checkpoint.write(&folder, &Disk::default(), max_bytes).unwrap_err().to_string()
        };
        let long = Manifest { config: "x".repeat(1 << 20), ..Manifest::default() };
        assert!(refused(&Checkpoint { manifest: long, ..sample(1, 1) }, MAX_BYTES).contains("limit of 1048576"));
        let text = serde_json::from_str(&format!("{}{}", "[".repeat(125), "]".repeat(125))).unwrap();
        let mut deep = sample(1, 1);
        deep.manifest.extra.insert("deep".into(), serde_json::Value::Array(vec![text, 1.into()]));
        assert!(refused(&deep, MAX_BYTES).contains("recursion limit"));
        let mut mixed = sample(1, 1);
        mixed.policy.insert("mean", &[1], vec![1.0f64]).unwrap();
        assert!(refused(&mixed, MAX_BYTES).starts_with("tensor mean of the policy is of another kind"));
        let mut many = sample(1, 1);
        (0..4200).for_each(|i| many.state.insert(format!("{i:0250}"), &[], vec![1u8]).unwrap());
        assert!(refused(&many, MAX_BYTES).contains("length of the header"));
        let n_byte = (Layout::new(&sample(1, 1).policy, &folder).unwrap().bytes)
            + Layout::new(&sample(1, 1).state, &folder).unwrap().bytes;
        assert!(refused(&sample(1, 1), n_byte - 1).contains("over the limit"));
        let _ = std::fs::remove_dir_all(&folder);
        sample(1, 1).write(&folder, &Disk::default(), n_byte).unwrap();
        Checkpoint::load_within(&folder, n_byte).unwrap();
        assert!(Checkpoint::load_within(&folder, n_byte - 1).unwrap_err().to_string().contains("over the limit"));
    }

    #[test]
    fn what_the_disk_cannot_hold_is_refused_before_it_is_written() {
        let run = tempfile::tempdir().unwrap();
        let folder = run.path().join("new/run");
        check_room(&folder, 1 << 10, 3).unwrap();
        let refused = |bytes, copies| check_room(&folder, bytes, copies).unwrap_err().to_string();
        let too_long = refused(MAX_BYTES + 1, 3);
        assert!(too_long.contains("limit of 8589934592") && too_long.contains("replay.capacity"), "{too_long}");
        if cfg!(unix) {
            let full = refused(MAX_BYTES, usize::MAX);
            assert!(full.contains("has left. Make room, train in another folder, or keep fewer steps"), "{full}");
        }
        assert!(!folder.exists());
    }

    #[test]
    fn what_could_not_be_saved_is_not_loaded() {
        let run = tempfile::tempdir().unwrap();
        let (disk, path) = (Disk::default(), |name: &str| run.path().join(name));
        let tensors = [sample(1, 1).state, sample(1, 1).policy];
        let [policy, state] = [0, 1].map(|i| {
            let path = path([POLICY, STATE][i]);
            Layout::new(&tensors[i], &path).unwrap().write(&path, &disk).unwrap()
        });
        let mut manifest = Manifest { files: Files { policy, state }, ..Manifest::default() };
        std::fs::write(path(MANIFEST), manifest.seal(&path(MANIFEST)).unwrap()).unwrap();
        let text = Checkpoint::load(run.path()).unwrap_err().to_string();
        assert!(text.starts_with("tensor counters of the policy is of another kind"), "{text}");
        manifest.config = "x".repeat(1 << 20);
        std::fs::write(path(MANIFEST), manifest.seal(&path(MANIFEST)).unwrap()).unwrap();
        assert!(Checkpoint::load(run.path()).unwrap_err().to_string().contains("length of the text"));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_not_followed() {
        let run = tempfile::tempdir().unwrap();
        let (folder, elsewhere) = (run.path().join("x"), run.path().join("elsewhere"));
        sample(1, 1).write(&folder, &Disk::default(), MAX_BYTES).unwrap();
        std::fs::rename(folder.join(STATE), &elsewhere).unwrap();
        std::os::unix::fs::symlink(&elsewhere, folder.join(STATE)).unwrap();
        assert!(Checkpoint::load(&folder).unwrap_err().to_string().contains("a link"));
    }
}
