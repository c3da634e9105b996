//! The checkpoints of a run: the newest that is whole, and one writer at a time.

use super::disk::Disk;
use super::{Checkpoint, FILES, MAX_BYTES, Wanted, damaged, flies};
use base::error::{Error, Result};
use base::file_gate;
use std::collections::BTreeSet;
use std::fs::{File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};

/// Largest update that a folder's name holds.
const MAX_UPDATE: u64 = 999_999_999;
/// Being written.
const SAVING: &str = ".saving";
/// Being removed.
const REMOVING: &str = ".removing";
/// Held by who writes.
const LOCK: &str = ".lock";

/// The checkpoints of a run, to be read; needs no lock.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    max_bytes: u64,
}

/// A checkpoint, where it lay and what was passed over for it.
#[derive(Debug)]
pub struct LatestCheckpoint {
    /// The newest that passed every check.
    pub checkpoint: Checkpoint,
    /// Its folder.
    pub folder: PathBuf,
    /// Newer ones that did not, newest first.
    pub skipped: Vec<SkippedCheckpoint>,
}

/// A checkpoint that did not pass.
#[derive(Debug)]
pub struct SkippedCheckpoint {
    /// Its folder.
    pub folder: PathBuf,
    /// What is wrong with it.
    pub why: Error,
}

impl Store {
    /// The checkpoints in `run`/checkpoints.
    ///
    /// # Errors
    /// [`Error::File`] if there is no such folder.
    pub fn open(run: impl AsRef<Path>) -> Result<Self> {
        let folder = run.as_ref().join("checkpoints");
        std::fs::read_dir(&folder).map_err(|e| Error::file(&folder, e))?;
        Ok(Self { folder, max_bytes: MAX_BYTES })
    }

    /// The same, and the right to change them until the [`CheckpointWriter`] is dropped or its process ends. Makes the folders
    /// that are missing, and removes what a killed writer left half done. At least the `keep` newest checkpoints are
    /// kept.
    ///
    /// # Errors
    /// [`Error::Value`] if another writer is open or `keep` < 2, [`Error::File`] if the folder cannot be written.
    pub fn open_to_write(run: impl AsRef<Path>, keep: usize) -> Result<CheckpointWriter> {
        if keep < 2 {
            let remedy = "With one alone, a damaged file would end the run.";
            return Err(Error::value("number of checkpoints to keep", keep, "≥ 2", remedy));
        }
        // an empty path joins to this folder, but cannot be opened
        let run = if run.as_ref() == Path::new("") { Path::new(".") } else { run.as_ref() };
        let folder = run.join("checkpoints");
        // old checkpoints are removed here, and a link may lead to those of another run
        if std::fs::symlink_metadata(&folder).is_ok_and(|about| !about.is_dir()) {
            return Err(damaged(&folder, "the name", "it is no folder, or a link to one"));
        }
        std::fs::create_dir_all(&folder).map_err(|e| Error::file(&folder, e))?;
        let lock = lock(&folder)?;
        let (store, disk) = (Self { folder, max_bytes: MAX_BYTES }, Disk::default());
        disk.sync_folder(run)?;
        let writer =
            CheckpointWriter { store, keep, whole: BTreeSet::new(), spared: BTreeSet::new(), disk, _lock: lock };
        writer.clear()?;
        Ok(writer)
    }

    /// With another limit on a checkpoint's tensors than `MAX_BYTES`.
    pub fn with_max_bytes(self, max_bytes: u64) -> Self {
        Self { max_bytes, ..self }
    }

    /// Updates of the checkpoints there are, in rising order, whole or not. What is no folder is no checkpoint, whatever it is called.
    ///
    /// # Errors
    /// [`Error::File`] if the folder cannot be read.
    pub fn updates(&self) -> Result<Vec<u64>> {
        let mut updates = Vec::new();
        for entry in std::fs::read_dir(&self.folder).map_err(|e| Error::file(&self.folder, e))? {
            let entry = entry.map_err(|e| Error::file(&self.folder, e))?;
            if !entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                continue;
            }
            let name = entry.file_name();
            let Some(update) = name.to_str().and_then(|name| name.parse().ok()) else { continue };
            if name == *folder_name(update) {
                updates.push(update);
            }
        }
        updates.sort_unstable();
        Ok(updates)
    }

    /// Where the checkpoint of `update` is, or would be.
    pub fn path(&self, update: u64) -> PathBuf {
        self.folder.join(folder_name(update))
    }

    /// The checkpoint of `update`.
    ///
    /// # Errors
    /// As [`Checkpoint::load_within`], and [`Error::Format`] if it is of another update.
    pub fn load(&self, update: u64) -> Result<Checkpoint> {
        self.load_wanted(update, &|_| true)
    }

    fn load_wanted(&self, update: u64, wanted: Wanted<'_>) -> Result<Checkpoint> {
        let folder = self.path(update);
        let checkpoint = Checkpoint::load_wanted(&folder, self.max_bytes, wanted)?;
        match checkpoint.manifest.update {
            own if own == update => Ok(checkpoint),
            own => Err(damaged(&folder, "the name", format!("the checkpoint in it is of update {own}"))),
        }
    }

    /// The newest checkpoint that passes every check, and what was wrong with those passed over; `None` if there is no
    /// checkpoint.
    ///
    /// # Errors
    /// [`Error::Format`] if there are some but none passes, [`Error::File`] if the folder cannot be read.
    pub fn latest(&self) -> Result<Option<LatestCheckpoint>> {
        self.latest_of(&|_| true, || self.updates())
    }

    /// As [`Store::latest`], with what it takes to fly alone.
    ///
    /// # Errors
    /// As there.
    pub(crate) fn latest_to_fly(&self) -> Result<Option<LatestCheckpoint>> {
        self.latest_of(&flies, || self.updates())
    }

    fn latest_of(
        &self,
        wanted: Wanted<'_>,
        mut list: impl FnMut() -> Result<Vec<u64>>,
    ) -> Result<Option<LatestCheckpoint>> {
        let mut skipped: Vec<SkippedCheckpoint> = Vec::new();
        // a writer at work may have removed what was just listed: look again
        for _ in 0..3 {
            for update in list()?.into_iter().rev() {
                let folder = self.path(update);
                if skipped.iter().any(|s| s.folder == folder) {
                    continue;
                }
                match self.load_wanted(update, wanted) {
                    Err(why) => skipped.push(SkippedCheckpoint { folder, why }),
                    Ok(checkpoint) => {
                        skipped.retain(|s| s.folder.exists());
                        return Ok(Some(LatestCheckpoint { checkpoint, folder, skipped }));
                    }
                }
            }
        }
        let [first, ..] = &skipped[..] else { return Ok(None) };
        Err(Error::Format {
            file: self.folder.display().to_string(),
            place: format!("all checkpoints, {}", skipped.len()),
            rule: format!("none is whole; the newest: {}", first.why),
            remedy: "Start the run anew in another folder.".into(),
        })
    }
}

/// Most things of one name that are put aside.
const MAX_ASIDE: usize = 1000;

/// Whether something bears a name that is no folder: a file, a pipe, a link.
fn is_foreign(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok_and(|about| !about.is_dir())
}

/// Removes the checkpoints of a run, so that another begins there; whatever else lies among them stays. Nothing is removed where
/// one of them holds more than a checkpoint does.
///
/// # Errors
/// [`Error::Value`] while another process writes there, and for files of others within a checkpoint; [`Error::File`] if the disk
/// refuses.
pub fn remove_checkpoints(run: &Path) -> Result<()> {
    let writer = Store::open_to_write(run, 2)?;
    let folder = &writer.store.folder;
    let own = own_checkpoints(folder)?;
    own.iter().try_for_each(|path| check_own(path))?;
    own.iter().try_for_each(|path| writer.disk.remove_own(path, &FILES))?;
    let folder = folder.clone();
    drop(writer);
    let lock = folder.join(LOCK);
    std::fs::remove_file(&lock).map_err(|e| Error::file(&lock, e))?;
    // what others put there stays
    let _ = std::fs::remove_dir(folder);
    Ok(())
}

/// Whether checkpoints of a run could be removed: see [`remove_checkpoints`].
///
/// # Errors
/// As there.
pub fn check_removable(run: &Path) -> Result<()> {
    let folder = run.join("checkpoints");
    file_gate::own_folder(&folder)?;
    if !folder.is_dir() {
        return Ok(());
    }
    own_checkpoints(&folder)?.iter().try_for_each(|path| check_own(path))
}

/// Folders of checkpoints, those put aside among them.
fn own_checkpoints(folder: &Path) -> Result<Vec<PathBuf>> {
    let refused = |e| Error::file(folder, e);
    let mut own = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(refused)? {
        let entry = entry.map_err(refused)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let digits = name.strip_suffix(".damaged").unwrap_or(&name);
        let numbered = digits.parse().is_ok_and(|update| digits == folder_name(update));
        if numbered && entry.file_type().map_err(refused)?.is_dir() {
            own.push(entry.path());
        }
    }
    Ok(own)
}

/// Refuses a folder of a checkpoint that holds more than its files.
fn check_own(checkpoint: &Path) -> Result<()> {
    let Some(path) = foreign_entry(checkpoint).map_err(|e| Error::file(checkpoint, e))? else { return Ok(()) };
    let remedy = "Move it elsewhere, or name another folder.";
    Err(Error::value("file in a checkpoint", format!("'{}'", path.display()), "one of the run", remedy))
}

/// The first entry of a folder that no checkpoint has.
fn foreign_entry(checkpoint: &Path) -> std::io::Result<Option<PathBuf>> {
    for entry in std::fs::read_dir(checkpoint)? {
        let entry = entry?;
        let named = FILES.iter().any(|own| entry.file_name() == *own);
        if !named || !entry.file_type()?.is_file() {
            return Ok(Some(entry.path()));
        }
    }
    Ok(None)
}

/// Whether a folder, no link to one, holds nothing but files of a checkpoint: whole, half written or half removed.
fn is_own(path: &Path) -> bool {
    !is_foreign(path) && matches!(foreign_entry(path), Ok(None))
}

fn folder_name(update: u64) -> String {
    format!("{update:09}")
}

/// The right to change a store. Given back explicitly: a child process that is just starting may hold the file open.
#[derive(Debug)]
struct Lock(File);

impl Drop for Lock {
    fn drop(&mut self) {
        let _ = self.0.unlock();
    }
}

fn lock(folder: &Path) -> Result<Lock> {
    let path = folder.join(LOCK);
    file_gate::own(&path)?;
    let open = OpenOptions::new().create(true).truncate(false).write(true).open(&path);
    let file = open.map_err(|e| Error::file(&path, e))?;
    match file.try_lock() {
        Ok(()) => Ok(Lock(file)),
        Err(TryLockError::Error(e)) => Err(Error::file(&path, e)),
        Err(TryLockError::WouldBlock) => {
            let remedy = "Wait for the other run or stop it, or train in another folder.";
            Err(Error::value(format!("writer of {}", folder.display()), "another process", "this one alone", remedy))
        }
    }
}

/// The only one that changes the checkpoints of a run.
#[derive(Debug)]
pub struct CheckpointWriter {
    store: Store,
    keep: usize,
    /// Updates whose checkpoints were saved or found whole by this writer.
    whole: BTreeSet<u64>,
    /// Folders that were to be removed and hold files of others.
    spared: BTreeSet<PathBuf>,
    disk: Disk,
    _lock: Lock,
}

impl CheckpointWriter {
    /// The checkpoints.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// With another limit on a checkpoint's tensors than `MAX_BYTES`.
    pub fn with_max_bytes(self, max_bytes: u64) -> Self {
        Self { store: self.store.with_max_bytes(max_bytes), ..self }
    }

    /// Folders that this writer had to remove and left with all that is in them, since files of others are there.
    pub fn spared(&self) -> impl Iterator<Item = &Path> {
        self.spared.iter().map(PathBuf::as_path)
    }

    /// As [`Store::latest`].
    ///
    /// # Errors
    /// As [`Store::latest`].
    pub fn latest(&mut self) -> Result<Option<LatestCheckpoint>> {
        let found = self.store.latest()?;
        self.whole.extend(found.as_ref().map(|f| f.checkpoint.manifest.update));
        Ok(found)
    }

    /// Saves a checkpoint newer than all others, then removes those older than the newest `keep` whole ones, but for folders
    /// with files of others ([`CheckpointWriter::spared`]). Damaged ones in its way, of the same or later updates, are put aside as
    /// `<update>.damaged`; so is what else bears its name, and stays there.
    ///
    /// # Errors
    /// [`Error::Value`] if a whole one is not older, or the policy is not `f32`; [`Error::Limit`] for what could not be
    /// loaded again; [`Error::File`] if the disk refuses. All leave the older checkpoints as they were; if only an old
    /// one could not be removed, the new one is in place.
    pub fn save(&mut self, checkpoint: &Checkpoint) -> Result<PathBuf> {
        let update = checkpoint.manifest.update;
        if update > MAX_UPDATE {
            return Err(Error::limit("update of a checkpoint", update, MAX_UPDATE, "Make fewer, larger updates."));
        }
        self.make_way(update)?;
        self.clear()?;
        let (temporary, folder) = (self.working(SAVING)?, self.store.path(update));
        let written = checkpoint.write(&temporary, &self.disk, self.store.max_bytes);
        if let Err(e) = written.and_then(|()| self.disk.rename(&temporary, &folder)) {
            // the first error is the one to tell; what stays is cleared by the next save
            let _ = self.disk.remove_own(&temporary, &FILES);
            return Err(e);
        }
        self.disk.sync_folder(&self.store.folder)?;
        self.whole.insert(update);
        self.prune()?;
        Ok(folder)
    }

    /// Removes all checkpoints later than `update`, to train on from there. Folders with files of others are put aside as
    /// `<update>.damaged` instead, with all that is in them.
    ///
    /// # Errors
    /// [`Error::File`] if one cannot be removed.
    pub fn discard_after(&mut self, update: u64) -> Result<()> {
        for later in self.store.updates()?.into_iter().rev().filter(|u| *u > update) {
            if self.remove(later)? {
                continue;
            }
            self.disk.rename(&self.store.path(later), &self.free(later)?)?;
            self.whole.remove(&later);
        }
        Ok(())
    }

    fn is_whole(&mut self, update: u64) -> bool {
        let whole = self.whole.contains(&update) || self.store.load_wanted(update, &|_| false).is_ok();
        if whole {
            self.whole.insert(update);
        }
        whole
    }

    fn make_way(&mut self, update: u64) -> Result<()> {
        for later in self.store.updates()?.into_iter().rev().filter(|u| *u >= update) {
            if self.is_whole(later) {
                let limit = format!("above {later}, the newest saved");
                let remedy = "Go on from that one, discard it with Writer::discard_after, or train in another folder.";
                return Err(Error::value("update of a checkpoint", update, limit, remedy));
            }
            let usual = self.aside(later, "");
            let aside = if is_own(&usual) { usual } else { self.free(later)? };
            self.disk.remove_own(&aside, &FILES)?;
            self.disk.rename(&self.store.path(later), &aside)?;
        }
        let path = self.store.path(update);
        if is_foreign(&path) {
            self.disk.rename(&path, &self.free(update)?)?;
        }
        Ok(())
    }

    fn aside(&self, update: u64, number: &str) -> PathBuf {
        self.store.folder.join(format!("{}.damaged{number}", folder_name(update)))
    }

    /// A name to put something aside by that nothing has.
    fn free(&self, update: u64) -> Result<PathBuf> {
        let names = numbered().map(|number| self.aside(update, &number));
        let mut free = names.filter(|path| std::fs::symlink_metadata(path).is_err());
        free.next().ok_or_else(|| self.crowded())
    }

    /// A name of ours to work under: what an earlier writer left there is removed, what is of others stays and keeps its name.
    fn working(&self, name: &str) -> Result<PathBuf> {
        let names = numbered().map(|number| self.store.folder.join(format!("{name}{number}")));
        let mut ours = names.filter(|path| std::fs::symlink_metadata(path).is_err() || is_own(path));
        let path = ours.next().ok_or_else(|| self.crowded())?;
        self.disk.remove_own(&path, &FILES)?;
        Ok(path)
    }

    fn crowded(&self) -> Error {
        let what = format!("{}: things in the way of a checkpoint", self.store.folder.display());
        Error::limit(
            what,
            MAX_ASIDE + 1,
            MAX_ASIDE,
            "Move those that end in .damaged elsewhere, or train in another folder.",
        )
    }

    fn prune(&mut self) -> Result<()> {
        let mut kept = 0;
        for update in self.store.updates()?.into_iter().rev() {
            if kept == self.keep {
                self.remove(update)?; // or it is spared
            } else if self.is_whole(update) {
                kept += 1;
            }
        }
        Ok(())
    }

    /// Whether it could go: a folder with files of others stays. Renamed first: a half removed checkpoint is none.
    fn remove(&mut self, update: u64) -> Result<bool> {
        let path = self.store.path(update);
        if !is_own(&path) {
            self.spared.insert(path);
            return Ok(false);
        }
        let removing = self.working(REMOVING)?;
        self.disk.rename(&path, &removing)?;
        self.whole.remove(&update);
        self.disk.remove_own(&removing, &FILES)?;
        Ok(true)
    }

    /// What a killed writer left half done.
    fn clear(&self) -> Result<()> {
        [SAVING, REMOVING].iter().try_for_each(|name| self.working(name).map(drop))
    }
}

/// Ends of names that one thing may bear: none, then `.1` and so on.
fn numbered() -> impl Iterator<Item = String> {
    (0..MAX_ASIDE).map(|k| if k == 0 { String::new() } else { format!(".{k}") })
}

#[cfg(test)]
mod tests {
    use super::super::disk::{Change, fault::DiskFault};
    use super::super::tests::{same, sample};
    use super::*;
    use rng::{Purpose, Stream};
    use std::cell::Cell;
    use std::time::Duration;

    /// A writer that keeps two, after saving these updates.
    fn store_with(run: &Path, updates: &[u64]) -> CheckpointWriter {
        let mut writer = Store::open_to_write(run, 2).unwrap();
        updates.iter().for_each(|u| drop(writer.save(&sample(*u, 20)).unwrap()));
        writer
    }

    fn names(run: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(run.join("checkpoints")).unwrap();
        let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn damage(store: &Store, update: u64) {
        let path = store.path(update).join("state.safetensors");
        let mut bytes = std::fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(path, bytes).unwrap();
    }

    #[test]
    fn the_newest_is_found_and_only_the_newest_are_kept() {
        let run = tempfile::tempdir().unwrap();
        let mut writer = Store::open_to_write(run.path(), 3).unwrap();
        assert!(writer.latest().unwrap().is_none());
        for update in [0, 1, 5, 10, 999_999_999] {
            let folder = writer.save(&sample(update, 3)).unwrap();
            let found = Store::open(run.path()).unwrap().latest().unwrap().unwrap();
            assert_eq!((found.folder, found.skipped.len()), (folder, 0));
            assert!(same(&found.checkpoint, &sample(update, 3)));
        }
        assert_eq!(names(run.path()), [".lock", "000000005", "000000010", "999999999"]);
        assert!(writer.save(&sample(1_000_000_000, 3)).unwrap_err().to_string().contains("over the limit"));
        assert!(Store::open_to_write(tempfile::tempdir().unwrap().path(), 1).is_err());
        assert!(Store::open(run.path().join("nowhere")).unwrap_err().to_string().contains("nowhere"));
    }

    #[test]
    fn a_damaged_checkpoint_is_passed_over_and_said_so() {
        let run = tempfile::tempdir().unwrap();
        let mut writer = store_with(run.path(), &[1, 2]);
        damage(writer.store(), 2);
        let found = writer.latest().unwrap().unwrap();
        assert!(same(&found.checkpoint, &sample(1, 20)));
        let [skipped] = &found.skipped[..] else { panic!("{:?}", found.skipped) };
        assert_eq!(skipped.folder, writer.store().path(2));
        assert!(skipped.why.to_string().contains("state.safetensors: the whole file: its SHA-256"), "{}", skipped.why);
        damage(writer.store(), 1);
        assert!(writer.latest().unwrap_err().to_string().contains("none is whole"));
    }

    #[test]
    fn damaged_checkpoints_do_not_push_out_the_last_whole_one() {
        let run = tempfile::tempdir().unwrap();
        drop(store_with(run.path(), &[1, 2]));
        let mut writer = Store::open_to_write(run.path(), 2).unwrap();
        damage(writer.store(), 2);
        writer.save(&sample(3, 20)).unwrap();
        assert_eq!(writer.store().updates().unwrap(), [1, 2, 3]);
        writer.save(&sample(4, 20)).unwrap();
        assert_eq!(writer.store().updates().unwrap(), [3, 4]);
    }

    #[test]
    fn a_run_goes_on_over_a_damaged_checkpoint_but_not_over_a_whole_one() {
        let run = tempfile::tempdir().unwrap();
        drop(store_with(run.path(), &[1, 4, 6]));
        let mut writer = Store::open_to_write(run.path(), 2).unwrap();
        for update in [5, 6] {
            let text = writer.save(&sample(update, 20)).unwrap_err().to_string();
            assert!(text.contains("must be above 6, the newest saved"), "{text}");
        }
        damage(writer.store(), 6);
        // known as whole from the check above: what this writer has seen whole it does not read again
        drop(writer);
        let mut writer = Store::open_to_write(run.path(), 2).unwrap();
        writer.save(&sample(6, 20)).unwrap();
        assert_eq!(names(run.path()), [".lock", "000000004", "000000006", "000000006.damaged"]);
        assert!(same(&writer.latest().unwrap().unwrap().checkpoint, &sample(6, 20)));
        writer.discard_after(4).unwrap();
        writer.save(&sample(5, 20)).unwrap();
        assert_eq!(writer.store().updates().unwrap(), [4, 5]);
    }

    #[test]
    fn a_checkpoint_under_another_update_s_name_is_not_it() {
        let run = tempfile::tempdir().unwrap();
        let writer = store_with(run.path(), &[1, 2]);
        std::fs::rename(writer.store().path(1), writer.store().path(3)).unwrap();
        let found = writer.store().latest().unwrap().unwrap();
        assert!(same(&found.checkpoint, &sample(2, 20)));
        assert!(found.skipped[0].why.to_string().contains("is of update 1"));
    }

    #[test]
    fn who_flies_reads_no_steps_that_are_kept_but_finds_damage_in_them() {
        let run = tempfile::tempdir().unwrap();
        let mut writer = Store::open_to_write(run.path(), 2).unwrap();
        for update in [1, 2] {
            let mut kept = sample(update, 20);
            kept.state.insert("replay.0.reward", &[1 << 16], vec![0.5f32; 1 << 16]).unwrap();
            writer.save(&kept).unwrap();
        }
        let found = writer.store().latest_to_fly().unwrap().unwrap().checkpoint;
        assert!(same(&found, &sample(2, 20)));
        damage(writer.store(), 2);
        let found = writer.store().latest_to_fly().unwrap().unwrap();
        assert!(same(&found.checkpoint, &sample(1, 20)) && found.skipped.len() == 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_to_the_checkpoints_of_another_run_is_refused() {
        let runs = tempfile::tempdir().unwrap();
        let [own, other] = ["own", "other"].map(|name| runs.path().join(name));
        drop(store_with(&other, &[1, 2]));
        std::fs::create_dir(&own).unwrap();
        std::os::unix::fs::symlink(other.join("checkpoints"), own.join("checkpoints")).unwrap();
        let refused = Store::open_to_write(&own, 2).unwrap_err().to_string();
        assert!(refused.contains("a link"), "{refused}");
        assert_eq!(names(&other), [".lock", "000000001", "000000002"]);
    }

    #[test]
    fn other_names_are_no_checkpoints() {
        let run = tempfile::tempdir().unwrap();
        let writer = store_with(run.path(), &[1, 2]);
        let folder = |name: &str| run.path().join("checkpoints").join(name);
        for name in ["3", "+00000003", "0000000003", "000000003 ", "00000000x", "999999999999999999999", ".000000003"] {
            std::fs::create_dir(folder(name)).unwrap();
        }
        assert_eq!(writer.store().updates().unwrap(), [1, 2]);
    }

    #[test]
    fn a_reader_behind_a_writer_looks_again() {
        let run = tempfile::tempdir().unwrap();
        let writer = store_with(run.path(), &[1, 2, 3, 4]);
        let mut lists = [vec![1, 2], vec![3, 4]].into_iter();
        let found = writer.store().latest_of(&|_| true, || Ok(lists.next().unwrap())).unwrap().unwrap();
        assert!(same(&found.checkpoint, &sample(4, 20)) && found.skipped.is_empty());
    }

    #[test]
    fn what_a_killed_or_failed_writer_left_is_removed() {
        let run = tempfile::tempdir().unwrap();
        drop(store_with(run.path(), &[1]));
        let leave = |name: &&str| {
            let folder = run.path().join("checkpoints").join(name);
            std::fs::create_dir(&folder).unwrap();
            std::fs::write(folder.join("policy.safetensors"), "half").unwrap();
        };
        [SAVING, REMOVING].iter().for_each(leave);
        let mut writer = Store::open_to_write(run.path(), 2).unwrap();
        assert_eq!(names(run.path()), [".lock", "000000001"]);
        [SAVING, REMOVING].iter().for_each(leave);
        writer.save(&sample(2, 20)).unwrap();
        assert_eq!(names(run.path()), [".lock", "000000001", "000000002"]);
    }

    #[test]
    fn only_one_writes_and_anyone_reads() {
        let run = tempfile::tempdir().unwrap();
        let first = store_with(run.path(), &[1]);
        let text = Store::open_to_write(run.path(), 2).unwrap_err().to_string();
        assert!(text.contains("is another process, but it must be this one alone. Wait for"), "{text}");
        assert!(Store::open(run.path()).unwrap().latest().unwrap().is_some());
        let inherited = first._lock.0.try_clone().unwrap();
        drop(first);
        Store::open_to_write(run.path(), 2).unwrap();
        drop(inherited);
    }

    /// Saves update 3 after 1 and 2 with this fault; the run's folder, and whether it was saved.
    fn save_with(fault: DiskFault) -> (tempfile::TempDir, Result<PathBuf>) {
        let run = tempfile::tempdir().unwrap();
        let mut writer = store_with(run.path(), &[1, 2]);
        writer.disk.fault = fault;
        let outcome = writer.save(&sample(3, 20));
        (run, outcome)
    }

    #[test]
    fn a_crash_after_any_file_operation_leaves_the_old_or_the_new_checkpoint_whole() {
        let (mut n_old, mut n_new) = (0, 0);
        for after in 0.. {
            let (run, outcome) = save_with(DiskFault::Killed { after: Cell::new(after) });
            let found = Store::open(run.path()).unwrap().latest().unwrap().unwrap();
            assert!(found.skipped.is_empty(), "after {after}: {:?}", found.skipped);
            let update = found.checkpoint.manifest.update;
            assert!(same(&found.checkpoint, &sample(update, 20)), "after {after}");
            match (outcome.is_ok(), update) {
                (true, 3) => break,
                (false, 3) => n_new += 1,
                (false, 2) => n_old += 1,
                _ => panic!("after {after}: update {update}, {outcome:?}"),
            }
            let mut writer = Store::open_to_write(run.path(), 2).unwrap();
            writer.save(&sample(4, 20)).unwrap();
            let kept = if update == 3 { "000000003" } else { "000000002" };
            assert_eq!(names(run.path()), [".lock", kept, "000000004"], "after {after}");
        }
        assert!(n_old > 15 && n_new >= 3, "{n_old}, {n_new}"); // measured 22, 3
    }

    #[test]
    fn everything_is_on_the_medium_before_it_gets_its_name() {
        let run = tempfile::tempdir().unwrap();
        let mut writer = store_with(run.path(), &[1, 2]);
        writer.disk.log.take();
        writer.save(&sample(3, 20)).unwrap();
        let mut log = writer.disk.log.take();
        log.retain(|(change, _)| !matches!(change, Change::Write(_)));
        let place = |path: &Path| path.strip_prefix(writer.store().folder.clone()).unwrap().display().to_string();
        let log: Vec<_> = log.iter().map(|(change, path)| (*change, place(path))).collect();
        let wanted = [
            (Change::Make, ".saving"),
            (Change::Make, ".saving/policy.safetensors"),
            (Change::Sync, ".saving/policy.safetensors"),
            (Change::Make, ".saving/state.safetensors"),
            (Change::Sync, ".saving/state.safetensors"),
            (Change::Make, ".saving/manifest.json"),
            (Change::Sync, ".saving/manifest.json"),
            (Change::Sync, ".saving"),
            (Change::Rename, "000000003"),
            (Change::Sync, ""),
            (Change::Rename, ".removing"),
            (Change::Remove, ".removing"),
        ];
        assert_eq!(log, wanted.map(|(change, path)| (change, path.to_string())));
    }

    #[test]
    fn a_checkpoint_written_in_place_would_tear() {
        let run = tempfile::tempdir().unwrap();
        let mut writer = store_with(run.path(), &[1, 2]);
        writer.disk.fault = DiskFault::Killed { after: Cell::new(8) };
        sample(3, 20).write(&writer.store.path(3), &writer.disk, MAX_BYTES).unwrap_err();
        assert_eq!(writer.store().latest().unwrap().unwrap().skipped.len(), 1);
    }

    #[test]
    fn a_full_disk_is_an_error_with_path_and_leaves_the_older_checkpoints() {
        let mut n_refused = 0;
        for free in (0..).step_by(97) {
            let (run, outcome) = save_with(DiskFault::Full { free: Cell::new(free) });
            let Err(e) = outcome else { break };
            n_refused += 1;
            let Error::File { path, source } = e else { panic!("{e}") };
            assert_eq!(source.kind(), std::io::ErrorKind::StorageFull);
            assert!(path.starts_with(run.path().join("checkpoints")), "{}", path.display());
            assert_eq!(names(run.path()), [".lock", "000000001", "000000002"]);
            let mut writer = Store::open_to_write(run.path(), 2).unwrap();
            assert!(same(&writer.latest().unwrap().unwrap().checkpoint, &sample(2, 20)));
            writer.save(&sample(3, 20)).unwrap();
        }
        assert!(n_refused > 20, "{n_refused}"); // measured 25
    }

    #[cfg(unix)]
    #[test]
    fn a_read_only_folder_is_an_error_with_path_and_can_be_read() {
        use std::os::unix::fs::PermissionsExt;
        let run = tempfile::tempdir().unwrap();
        let folder = run.path().join("checkpoints");
        let mut writer = store_with(run.path(), &[1, 2]);
        let allow = |mode| std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(mode)).unwrap();
        allow(0o555);
        if std::fs::write(folder.join("probe"), "").is_ok() {
            eprintln!("not run: this user may write into read-only folders");
            return allow(0o755);
        }
        refuses(&mut writer, "checkpoints", "denied");
        allow(0o755);
        writer.save(&sample(3, 20)).unwrap();
    }

    /// Makes a file, a pipe, a link to nothing, a link to a folder or an empty folder.
    #[cfg(unix)]
    fn put(kind: usize, at: &Path) {
        match kind {
            0 => std::fs::write(at, "theirs").unwrap(),
            1 => assert!(std::process::Command::new("mkfifo").arg(at).status().unwrap().success()),
            2 => std::os::unix::fs::symlink("nowhere", at).unwrap(),
            3 => std::os::unix::fs::symlink(std::env::temp_dir(), at).unwrap(),
            _ => std::fs::create_dir(at).unwrap(),
        }
    }

    #[cfg(unix)]
    #[test]
    fn what_bears_the_name_of_a_checkpoint_and_is_none_stops_no_run_and_stays() {
        for kind in 0..5 {
            // the oldest, one between, the next to be saved, one beyond, those of a writer itself
            for name in
                ["000000000", "000000002", "000000003", "000000007", "notes", SAVING, REMOVING, "000000003.damaged"]
            {
                let run = tempfile::tempdir().unwrap();
                drop(store_with(run.path(), &[1]));
                let at = run.path().join("checkpoints").join(name);
                put(kind, &at);
                let told = format!("{name} of kind {kind}");
                // whole ones may be removed; an empty folder of a later update is a damaged one
                let mut writer = Store::open_to_write(run.path(), 2).unwrap_or_else(|e| panic!("{told}: {e}"));
                assert_eq!(writer.latest().unwrap().unwrap().checkpoint.manifest.update, 1, "{told}");
                for update in 2..6 {
                    writer.save(&sample(update, 20)).unwrap_or_else(|e| panic!("{told}: {e}"));
                }
                let found = writer.latest().unwrap().unwrap();
                assert!(same(&found.checkpoint, &sample(5, 20)) && found.skipped.len() <= 1, "{told}");
                let theirs = kind < 4;
                let there = names(run.path()).iter().any(|own| own == name || *own == format!("{name}.damaged"));
                assert!(there || !theirs, "{told}: {:?}", names(run.path()));
            }
        }
    }

    /// Everything below a folder: names and texts.
    fn all_below(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
        let of = |entry: std::fs::DirEntry| match entry.file_type().unwrap().is_dir() {
            true => all_below(&entry.path()),
            false => vec![(entry.path(), std::fs::read(entry.path()).unwrap())],
        };
        entries.flat_map(of).collect()
    }

    #[test]
    fn an_old_checkpoint_with_files_of_others_stays_and_is_told() {
        // beside our files, in a folder, in place of one of our files
        for own in ["notes.txt", "plots/a.png", "state.safetensors/mine"] {
            for whole in [true, false] {
                let run = tempfile::tempdir().unwrap();
                let mut writer = store_with(run.path(), &[1, 2]);
                let old = writer.store().path(1);
                if !whole || own.starts_with("state") {
                    std::fs::remove_file(old.join("state.safetensors")).unwrap();
                }
                let mine = old.join(own);
                std::fs::create_dir_all(mine.parent().unwrap()).unwrap();
                std::fs::write(&mine, "theirs").unwrap();
                for update in 3..6 {
                    writer.save(&sample(update, 20)).unwrap();
                }
                assert_eq!(std::fs::read_to_string(&mine).unwrap(), "theirs");
                assert_eq!(names(run.path()), [".lock", "000000001", "000000004", "000000005"], "{own}");
                assert_eq!(writer.spared().collect::<Vec<_>>(), [old.as_path()]);
                writer.discard_after(0).unwrap();
                assert_eq!(names(run.path()), [".lock", "000000001.damaged"], "{own}");
                assert!(all_below(run.path()).iter().any(|(path, text)| path.ends_with(own) && text == b"theirs"));
                writer.save(&sample(1, 20)).unwrap();
            }
        }
    }

    #[test]
    fn what_is_of_others_stays_under_the_names_of_a_writer_s_own_work() {
        for name in [SAVING, REMOVING, "000000003.damaged", "000000002.damaged"] {
            for own in ["notes.txt", "a/b", "manifest.json/c"] {
                let run = tempfile::tempdir().unwrap();
                drop(store_with(run.path(), &[1, 2]));
                let mine = run.path().join("checkpoints").join(name).join(own);
                std::fs::create_dir_all(mine.parent().unwrap()).unwrap();
                std::fs::write(&mine, "theirs").unwrap();
                damage(&Store::open(run.path()).unwrap(), 2);
                let mut writer = Store::open_to_write(run.path(), 2).unwrap();
                for update in 2..6 {
                    writer.save(&sample(update, 20)).unwrap();
                }
                assert_eq!(std::fs::read_to_string(&mine).unwrap(), "theirs", "{name}/{own}");
                assert!(same(&writer.latest().unwrap().unwrap().checkpoint, &sample(5, 20)));
                let left = names(run.path());
                assert!(!left.iter().any(|n| n.starts_with('.') && n != name && n != ".lock"), "{left:?}");
            }
        }
    }

    #[cfg(unix)]
    #[test]
    fn checkpoints_are_removed_and_nothing_of_others_is() {
        let elsewhere = tempfile::tempdir().unwrap();
        drop(store_with(elsewhere.path(), &[7]));
        let theirs = elsewhere.path().join("checkpoints/000000007");
        for kind in 0..5 {
            let run = tempfile::tempdir().unwrap();
            drop(store_with(run.path(), &[1, 2]));
            let folder = run.path().join("checkpoints");
            std::os::unix::fs::symlink(&theirs, folder.join("000000009")).unwrap();
            put(kind, &folder.join("mine"));
            // within a checkpoint: refused, and nothing is removed
            let own = folder.join("000000001").join(["mine", "policy.pt", "a", "b", "c"][kind]);
            put(kind, &own);
            let text = remove_checkpoints(run.path()).unwrap_err().to_string();
            assert!(text.contains("file in a checkpoint") && check_removable(run.path()).is_err(), "{text}");
            assert!(Store::open(run.path()).unwrap().latest().unwrap().unwrap().folder.ends_with("000000002"));
            if kind == 4 {
                std::fs::remove_dir(own).unwrap()
            } else {
                std::fs::remove_file(own).unwrap()
            }
            remove_checkpoints(run.path()).unwrap();
            assert_eq!(names(run.path()), ["000000009", "mine"], "{kind}");
        }
        assert_eq!(std::fs::read_dir(&theirs).unwrap().count(), 3);
        let run = tempfile::tempdir().unwrap();
        drop(store_with(run.path(), &[1, 2]));
        let writer = Store::open_to_write(run.path(), 2).unwrap();
        assert!(remove_checkpoints(run.path()).unwrap_err().to_string().contains("another process"));
        drop(writer);
        remove_checkpoints(run.path()).unwrap();
        assert!(!run.path().join("checkpoints").exists());
    }

    /// No right of a user's makes a folder of it, not even root's.
    #[test]
    fn a_file_in_place_of_the_folder_is_an_error_with_path_and_a_run_goes_on_without_it() {
        let run = tempfile::tempdir().unwrap();
        let mut writer = store_with(run.path(), &[1, 2]);
        let (folder, aside) = (run.path().join("checkpoints"), run.path().join("aside"));
        std::fs::rename(&folder, &aside).unwrap();
        std::fs::write(&folder, "").unwrap();
        let text = writer.save(&sample(3, 20)).unwrap_err().to_string();
        assert!(text.contains("checkpoints") && text.contains("ot a directory"), "{text}");
        std::fs::remove_file(&folder).unwrap();
        std::fs::rename(&aside, &folder).unwrap();
        assert!(same(&writer.store().latest().unwrap().unwrap().checkpoint, &sample(2, 20)));
        writer.save(&sample(3, 20)).unwrap();
    }

    /// The third checkpoint is refused with these words, and the second is still the newest.
    fn refuses(writer: &mut CheckpointWriter, place: &str, why: &str) {
        let text = writer.save(&sample(3, 20)).unwrap_err().to_string();
        assert!(text.contains(place) && text.contains(why), "{text}");
        assert!(same(&writer.store().latest().unwrap().unwrap().checkpoint, &sample(2, 20)));
    }

    const RUN: &str = "CHECKPOINT_TEST_RUN";

    /// The numbers of two large checkpoints, taken in turn by updates.
    struct Large([Checkpoint; 2]);

    impl Large {
        fn new() -> Self {
            Self([0, 1].map(|i| sample(i, 100_000)))
        }

        fn of(&mut self, update: u64) -> &Checkpoint {
            let own = &mut self.0[update as usize % 2];
            own.manifest.update = update;
            own
        }
    }

    #[test]
    #[ignore = "cargo test -p omnidrones-rl --lib a_writer_killed_at_any_instant: this is the child that it starts and kills"]
    fn saves_for_ever() {
        let Ok(run) = std::env::var(RUN) else { return };
        let (mut writer, mut large) = (Store::open_to_write(run, 2).unwrap(), Large::new());
        let first = writer.latest().unwrap().map_or(0, |found| found.checkpoint.manifest.update + 1);
        for update in first.. {
            writer.save(large.of(update)).unwrap();
        }
    }

    /// KILLS=200 cargo test --release -p omnidrones-rl --lib a_writer_killed: the nightly number.
    #[test]
    fn a_writer_killed_at_any_instant_leaves_a_whole_checkpoint() {
        let n: u64 = std::env::var("KILLS").map_or(10, |n| n.parse().unwrap());
        let child = format!("{}::saves_for_ever", module_path!().split_once("::").unwrap().1);
        let (run, mut large) = (tempfile::tempdir().unwrap(), Large::new());
        let (mut stream, mut n_torn, mut last) = (Stream::new(1, 0, 0, Purpose::TASK), 0, 0);
        let mut kill = 0;
        // on and on until one hit a save, or the test would show nothing
        while kill < n || (n_torn == 0 && kill < 20 * n) {
            kill += 1;
            let mut process = std::process::Command::new(std::env::current_exe().unwrap())
                .args(["--exact", &child, "--ignored", "--nocapture"])
                .env(RUN, run.path())
                .stdout(std::process::Stdio::null())
                .spawn()
                .unwrap();
            let newest = || Store::open(run.path()).and_then(|s| s.updates()).unwrap_or_default().last().copied();
            let before = newest();
            while newest() == before {
                assert!(process.try_wait().unwrap().is_none(), "the child ended by itself");
                std::thread::sleep(Duration::from_millis(1));
            }
            std::thread::sleep(Duration::from_micros(stream.below(30_000)));
            process.kill().unwrap();
            process.wait().unwrap();
            n_torn += usize::from(run.path().join("checkpoints").join(SAVING).exists());
            let found = Store::open(run.path()).unwrap().latest().unwrap().unwrap();
            let update = found.checkpoint.manifest.update;
            assert!(found.skipped.is_empty(), "kill {kill}: {:?}", found.skipped);
            assert!(update >= last && same(&found.checkpoint, large.of(update)), "kill {kill}: update {update}");
            last = update;
        }
        println!("{kill} kills, {n_torn} of them while a checkpoint was half written; {last} updates");
        assert!(n_torn > 0, "no kill hit a save"); // measured 18 of 40
    }
}
