//! Every change that a save makes to the disk goes through here, so a test can see and stop each.

use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Length and hash of a file.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Length.
    pub bytes: u64,
    /// SHA-256, 64 hexadecimal digits (FIPS 180-4).
    pub sha256: String,
}

/// Bytes as lower-case hexadecimal digits.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// A change of the file system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Change {
    Make,
    /// So many bytes.
    Write(usize),
    Sync,
    Rename,
    Remove,
}

/// The file system, as far as it is changed. Errors name the path.
#[derive(Debug, Default)]
pub(super) struct Disk {
    #[cfg(test)]
    pub fault: fault::DiskFault,
    #[cfg(test)]
    pub log: std::cell::RefCell<Vec<(Change, PathBuf)>>,
}

impl Disk {
    fn change<T>(&self, change: Change, path: &Path, make: impl FnOnce() -> io::Result<T>) -> Result<T> {
        #[cfg(test)]
        self.fault.before(change).map_err(|e| Error::file(path, e))?;
        #[cfg(test)]
        self.log.borrow_mut().push((change, path.to_path_buf()));
        let _ = change;
        make().map_err(|e| Error::file(path, e))
    }

    /// A folder that was not there.
    pub fn make_folder(&self, path: &Path) -> Result<()> {
        self.change(Change::Make, path, || fs::create_dir(path))
    }

    /// Makes a folder's entries outlive a loss of power. Nothing to do where folders cannot be opened.
    pub fn sync_folder(&self, path: &Path) -> Result<()> {
        self.change(Change::Sync, path, || if cfg!(unix) { File::open(path)?.sync_all() } else { Ok(()) })
    }

    /// `from` becomes `to`, at once; `to` must not be there.
    pub fn rename(&self, from: &Path, to: &Path) -> Result<()> {
        self.change(Change::Rename, to, || fs::rename(from, to))
    }

    /// Removes a folder of these files, if it is there. What else is in it stays, and the folder with it.
    pub fn remove_own(&self, path: &Path, files: &[&str]) -> Result<()> {
        match fs::symlink_metadata(path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
            _ => self.change(Change::Remove, path, || {
                for file in files {
                    match fs::remove_file(path.join(file)) {
                        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
                        _ => {}
                    }
                }
                fs::remove_dir(path)
            }),
        }
    }

    /// A new file, to be written once from start to end.
    pub fn create<'a>(&'a self, path: &Path) -> Result<Sink<'a>> {
        let file = self.change(Change::Make, path, || File::create_new(path))?;
        Ok(Sink { disk: self, path: path.to_path_buf(), file, bytes: 0, hash: Sha256::new() })
    }
}

/// A file being written, its length and hash so far.
#[derive(Debug)]
pub(super) struct Sink<'a> {
    disk: &'a Disk,
    path: PathBuf,
    file: File,
    bytes: u64,
    hash: Sha256,
}

impl Sink<'_> {
    /// Appends.
    pub fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.disk.change(Change::Write(bytes.len()), &self.path, || self.file.write_all(bytes))?;
        self.hash.update(bytes);
        self.bytes += bytes.len() as u64;
        Ok(())
    }

    /// Waits until the file is on the medium.
    pub fn finish(self) -> Result<Entry> {
        self.disk.change(Change::Sync, &self.path, || self.file.sync_all())?;
        Ok(Entry { bytes: self.bytes, sha256: hex(&self.hash.finalize()) })
    }
}

#[cfg(test)]
pub(super) mod fault {
    use super::Change;
    use std::cell::Cell;
    use std::io::{Error, ErrorKind, Result};

    /// What goes wrong, and when.
    #[derive(Debug, Default)]
    pub enum DiskFault {
        #[default]
        None,
        /// The process dies after so many changes: all later ones fail, the clearing up after a failure too.
        Killed { after: Cell<u64> },
        /// So many bytes are free: what needs more fails, everything else works.
        Full { free: Cell<u64> },
    }

    impl DiskFault {
        pub fn before(&self, change: Change) -> Result<()> {
            let (left, need, failure) = match (self, change) {
                (Self::Killed { after }, _) => (after, 1, Error::other("killed")),
                (Self::Full { free }, Change::Write(n)) => (free, n as u64, ErrorKind::StorageFull.into()),
                _ => return Ok(()),
            };
            left.set(left.get().checked_sub(need).ok_or(failure)?);
            Ok(())
        }
    }
}
