//! Files appear whole or not at all: written beside their final place, then renamed.

use crate::error::{Error, Result};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Calls `write` with a temporary path in the folder of `path` (same extension), then renames it to `path`. Missing
/// folders are made. After an error the temporary file is removed and an older `path` is untouched.
///
/// # Errors
/// [`Error::Value`] unless the path ends in a file name, [`Error::File`] if the disk refuses; otherwise those of `write`.
pub fn replace_with(path: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let Some(name) = path.file_name() else {
        return Err(Error::value(
            "output file",
            path.display(),
            "a path that ends in a file name",
            "Add one, as in out/fly.png.",
        ));
    };
    if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, e))?;
    }
    let unique = format!(".{}-{}-", std::process::id(), COUNTER.fetch_add(1, Ordering::Relaxed));
    let mut temporary_name = std::ffi::OsString::from(unique);
    temporary_name.push(name);
    let temporary: PathBuf = path.with_file_name(temporary_name);
    let outcome = write(&temporary).and_then(|()| std::fs::rename(&temporary, path).map_err(|e| Error::file(path, e)));
    if outcome.is_err() {
        let _ = std::fs::remove_file(&temporary);
    }
    outcome
}
