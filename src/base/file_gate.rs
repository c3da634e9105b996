//! The one gate to the file system: what is read is a file of a size that was allowed, what is written appears whole.
//!
//! | | |
//! |---|---|
//! | reading | the type is asked for before the file is opened (a pipe would wait for ever), the size before it is read, and again while it is |
//! | writing | beside its place under a random name that nobody had, synchronised, then renamed |
//! | adding | to files of ours alone: a link leads elsewhere |
//!
//! What a process that is told to end had begun to write, [`remove_unfinished`] removes.

use crate::error::{Error, Result};
use std::collections::BTreeSet;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Largest log of a run that is read, bytes: a thousand times that of a long one.
pub const MAX_LOG: u64 = 1 << 30;

/// Refuses all but regular files.
fn regular(path: &Path, about: &Metadata) -> Result<()> {
    if about.is_file() {
        return Ok(());
    }
    let found = match about.file_type() {
        kind if kind.is_dir() => "a folder",
        kind if kind.is_symlink() => "a link",
        _ => "a pipe or a device",
    };
    Err(Error::value(path.display().to_string(), found, "a regular file", "Give the path of a file."))
}

/// Refuses a folder within a folder of ours that is a link: it leads to files of others.
///
/// # Errors
/// [`Error::Value`].
pub fn own_folder(path: &Path) -> Result<()> {
    if !std::fs::symlink_metadata(path).is_ok_and(|about| about.is_symlink()) {
        return Ok(());
    }
    let value = format!("'{}', a link", path.display());
    Err(Error::value("folder of a run", value, "a folder of its own", "Remove the link, or name another folder."))
}

/// A regular file, or a link to one, and its length.
///
/// # Errors
/// [`Error::File`] if there is none or it cannot be read, [`Error::Value`] for anything else of that name.
pub fn open(path: &Path) -> Result<(File, u64)> {
    let refused = |e| Error::file(path, e);
    regular(path, &std::fs::metadata(path).map_err(refused)?)?;
    let file = File::open(path).map_err(refused)?;
    let about = file.metadata().map_err(refused)?;
    regular(path, &about)?;
    Ok((file, about.len()))
}

/// A file of ours that is read or written in place: no link, which may lead anywhere.
///
/// # Errors
/// [`Error::Value`] if the name stands for anything but a regular file.
pub fn own(path: &Path) -> Result<()> {
    std::fs::symlink_metadata(path).map_or(Ok(()), |about| regular(path, &about))
}

/// All bytes of a file of at most `limit`.
///
/// # Errors
/// As [`open`]; [`Error::Limit`] for a larger one, of which no more is read.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let (file, length) = open(path)?;
    let too_large = |bytes: u64| {
        let what = format!("size of {}", path.display());
        Err(Error::limit(
            what,
            format!("{bytes} bytes"),
            format!("{limit} bytes"),
            "Check that this is the right file.",
        ))
    };
    if length > limit {
        return too_large(length);
    }
    let mut bytes = Vec::new();
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(|e| Error::file(path, e))?;
    if bytes.len() as u64 > limit { too_large(bytes.len() as u64) } else { Ok(bytes) }
}

/// The text of a file of at most `limit` bytes.
///
/// # Errors
/// [`Error::File`] if the disk refuses, [`Error::Value`] for what is no regular file, [`Error::Format`] for bytes that are no UTF-8,
/// [`Error::Limit`] above the limit.
pub fn read_text(path: &Path, limit: u64) -> Result<String> {
    String::from_utf8(read(path, limit)?).map_err(|error| Error::Format {
        file: path.display().to_string(),
        place: format!("byte {}", error.utf8_error().valid_up_to()),
        rule: "is not UTF-8 text".into(),
        remedy: "Save the file as UTF-8.".into(),
    })
}

/// As [`read`] of a file of ours; nothing where there is none.
///
/// # Errors
/// As there.
pub fn read_own(path: &Path, limit: u64) -> Result<Vec<u8>> {
    own(path)?;
    match std::fs::symlink_metadata(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(Vec::new()),
        _ => read(path, limit),
    }
}

/// What a file is, whatever it is called: two names of one have the same.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Identity {
    /// Device and number there.
    Number(u64, u64),
    /// Where the system has no such numbers, or there is no file.
    Name(PathBuf),
}

/// See [`Identity`]. A link is what it leads to.
pub fn identity(path: &Path) -> Identity {
    #[cfg(unix)]
    if let Ok(about) = std::fs::metadata(path) {
        use std::os::unix::fs::MetadataExt;
        return Identity::Number(about.dev(), about.ino());
    }
    Identity::Name(path.canonicalize().unwrap_or_else(|_| path.to_path_buf()))
}

/// A file of ours, made if it is not there, for lines at its end. One that has other names too is copied first: what stands under
/// those stays as it is.
///
/// # Errors
/// [`Error::File`] if the disk refuses, [`Error::Value`] for a link or a device.
pub fn append(path: &Path) -> Result<File> {
    own(path)?;
    let refused = |e| Error::file(path, e);
    let open = || OpenOptions::new().create(true).append(true).open(path).map_err(refused);
    let file = open()?;
    if names(&file.metadata().map_err(refused)?) < 2 {
        return Ok(file);
    }
    let (mut from, _) = self::open(path)?;
    replace_with(path, |copy| std::io::copy(&mut from, copy).map(drop).map_err(refused))?;
    open()
}

/// How many names a file has, as far as the system tells.
fn names(about: &Metadata) -> u64 {
    #[cfg(unix)]
    return std::os::unix::fs::MetadataExt::nlink(about);
    #[cfg(not(unix))]
    {
        let _ = about;
        1
    }
}

/// Bytes that are left for this user where `folder` is or will be; `None` where the system does not tell.
pub fn left(folder: &Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let named = |own: &Path| if own.as_os_str().is_empty() { PathBuf::from(".") } else { own.to_path_buf() };
        let about = folder.ancestors().find_map(|own| rustix::fs::statvfs(named(own)).ok())?;
        Some(about.f_bavail.saturating_mul(about.f_frsize))
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
}

/// Beginning of the names of files that are being written.
pub const UNFINISHED_NAME: &str = ".omnidrones-";

/// Files that are being written, under their random names.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> std::sync::MutexGuard<'static, BTreeSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes what this process had begun to write: for one that is told to end. While the result lives nothing else is begun.
pub fn remove_unfinished() -> std::sync::MutexGuard<'static, BTreeSet<PathBuf>> {
    let mut all = unfinished();
    remove(&mut all);
    all
}

fn remove(all: &mut BTreeSet<PathBuf>) {
    for path in std::mem::take(all) {
        let _ = std::fs::remove_file(path);
    }
}

/// Where a file lies.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// What is written before it has its name.
struct Unfinished(tempfile::NamedTempFile);

impl Unfinished {
    fn beside(path: &Path) -> Result<Self> {
        let folder = folder_of(path);
        std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, e))?;
        let mut with = tempfile::Builder::new();
        with.prefix(UNFINISHED_NAME);
        #[cfg(unix)]
        {
            // as any file that a program makes: what the user's mask leaves of it
            use std::os::unix::fs::PermissionsExt;
            with.permissions(std::fs::Permissions::from_mode(0o666));
        }
        // one that is told to end meanwhile knows of it, or it is not there yet
        let mut all = unfinished();
        let file = with.tempfile_in(folder).map_err(|e| Error::file(folder, e))?;
        all.insert(file.path().to_path_buf());
        Ok(Self(file))
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        unfinished().remove(self.0.path());
    }
}

/// Calls `write` with a new file beside `path`, then gives it that name. Missing folders are made. After an error the new
/// file is removed and an older `path` is untouched.
///
/// # Errors
/// [`Error::Value`] unless the path ends in a file name, [`Error::File`] if the disk refuses; otherwise those of `write`.
pub fn replace_with(path: &Path, write: impl FnOnce(&mut File) -> Result<()>) -> Result<()> {
    if path.file_name().is_none() {
        let remedy = "Add one, as in out/fly.png.";
        return Err(Error::value("output file", path.display(), "a path that ends in a file name", remedy));
    }
    let refused = |e| Error::file(path, e);
    let mut new = Unfinished::beside(path)?;
    write(new.0.as_file_mut())?;
    new.0.as_file().sync_all().map_err(refused)?;
    std::fs::rename(new.0.path(), path).map_err(refused)?;
    if cfg!(unix) {
        // a name that is lost with the power was none; some file systems of others cannot do it, and lose nothing by that
        let _ = File::open(folder_of(path)).and_then(|folder| folder.sync_all());
    }
    Ok(())
}

/// As [`replace_with`], with these bytes.
///
/// # Errors
/// As there.
pub fn replace(path: &Path, bytes: impl AsRef<[u8]>) -> Result<()> {
    replace_with(path, |file| file.write_all(bytes.as_ref()).map_err(|e| Error::file(path, e)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    #[test]
    fn a_file_appears_whole_or_not_at_all_and_nothing_is_left_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b");
        replace(&path, "old").unwrap();
        let refused = replace_with(&path, |file| {
            file.write_all(b"half").unwrap();
            assert_eq!(unfinished().iter().filter(|p| p.starts_with(folder.path())).count(), 1);
            Err(Error::value("disk", "full", "room", "Make some."))
        });
        assert!(refused.is_err());
        assert_eq!(read_text(&path, 3).unwrap(), "old");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
        assert!(!unfinished().iter().any(|p| p.starts_with(folder.path())));
        let text = read(&path, 2).unwrap_err().to_string();
        assert!(text.contains("3 bytes"), "{text}");
    }

    #[test]
    fn two_names_are_never_alike_and_a_planted_link_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let name = || {
            let mut name = PathBuf::new();
            let seen = replace_with(&path, |_| {
                name = unfinished().iter().find(|p| p.starts_with(folder.path())).cloned().unwrap();
                Ok(())
            });
            seen.unwrap();
            name
        };
        let (a, b) = (name(), name());
        assert!(a != b && !a.to_string_lossy().contains(&std::process::id().to_string()), "{a:?} {b:?}");
        #[cfg(unix)]
        {
            let foreign = folder.path().join("foreign");
            std::fs::write(&foreign, "theirs").unwrap();
            std::fs::remove_file(&path).unwrap();
            std::os::unix::fs::symlink(&foreign, &path).unwrap();
            for refused in [append(&path).map(drop), read_own(&path, 100).map(drop)] {
                assert!(refused.unwrap_err().to_string().contains("but it must be a regular file"));
            }
            replace(&path, "ours").unwrap();
            assert_eq!(std::fs::read_to_string(&foreign).unwrap(), "theirs");
        }
    }

    #[cfg(unix)]
    #[test]
    fn what_is_added_to_a_file_does_not_reach_its_other_names() {
        let folder = tempfile::tempdir().unwrap();
        for (k, text) in ["", "old\n", "old\nolder\n"].into_iter().enumerate() {
            for n in 0..3 {
                let own = folder.path().join(format!("own{k}{n}"));
                std::fs::write(&own, text).unwrap();
                let others: Vec<_> = (0..n).map(|i| folder.path().join(format!("other{k}{n}{i}"))).collect();
                others.iter().for_each(|other| std::fs::hard_link(&own, other).unwrap());
                for line in ["a\n", "b\n"] {
                    append(&own).unwrap().write_all(line.as_bytes()).unwrap();
                }
                assert_eq!(std::fs::read_to_string(&own).unwrap(), format!("{text}a\nb\n"));
                others.iter().for_each(|other| assert_eq!(std::fs::read_to_string(other).unwrap(), text));
                assert!(n == 0 || identity(&own) != identity(&others[0]));
                assert!(n < 2 || identity(&others[0]) == identity(&others[1]));
            }
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn pipes_and_devices_are_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let begun = Instant::now();
        for path in [pipe.as_path(), Path::new("/dev/zero"), folder.path()] {
            for refused in [read(path, 10).map(drop), append(path).map(drop), own(path)] {
                assert!(refused.unwrap_err().to_string().contains("but it must be a regular file"), "{path:?}");
            }
        }
        assert!(begun.elapsed() < Duration::from_secs(1)); // measured 0.1 ms
    }

    #[test]
    fn what_is_unfinished_goes_when_a_process_is_told_to_end() {
        let folder = tempfile::tempdir().unwrap();
        let new = Unfinished::beside(&folder.path().join("x")).unwrap();
        let path = new.0.path().to_path_buf();
        assert!(path.exists());
        assert!(unfinished().contains(&path));
        // others are written meanwhile, in other tests
        remove(&mut BTreeSet::from([path.clone()]));
        assert!(!path.exists());
    }
}
