//! Files of the command line: read behind fences, written whole, folders tried before long work.

use omnidrones::error::{Error, Result};
use serde::de::DeserializeOwned;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest small configuration file (gains, reference), bytes.
const MAX_CONFIG_BYTES: u64 = 1 << 20;

/// Text of a regular file of at most `limit` bytes.
pub fn read_text(path: &Path, limit: u64) -> Result<String> {
    let name = path.display().to_string();
    let format = |rule: &str, remedy: &str| Error::Format {
        file: name.clone(),
        place: "the file".into(),
        rule: rule.into(),
        remedy: remedy.into(),
    };
    // before opening: a pipe or device has no size, and opening one may block
    let about = std::fs::metadata(path).map_err(|e| Error::file(path, e))?;
    if !about.is_file() {
        return Err(format("is not a regular file", "Give the path of a file, not of a folder or device."));
    }
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(|e| Error::file(path, e))?;
    file.take(limit + 1).read_to_end(&mut bytes).map_err(|e| Error::file(path, e))?;
    if bytes.len() as u64 > limit {
        let (size, limit) = (format!("{} bytes", about.len()), format!("{limit} bytes"));
        return Err(Error::limit(format!("size of {name}"), size, limit, "Check that this is the right file."));
    }
    String::from_utf8(bytes).map_err(|_| format("is not UTF-8 text", "Save the file as UTF-8."))
}

/// A TOML file as `T`; mistakes are named with line and column, unknown keys with the known ones.
pub fn read_toml<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = read_text(path, MAX_CONFIG_BYTES)?;
    toml::from_str(&text).map_err(|error| Error::of_toml(&error, &text, &path.display().to_string()))
}

/// Makes `folder` and tries to write into it, so that a flight is not flown in vain.
pub fn prepare_folder(folder: &Path) -> Result<()> {
    let refused = |e: std::io::Error| {
        Error::value(
            "output folder",
            format!("'{}' ({e})", folder.display()),
            "a folder that can be made and written to",
            "Name another one.",
        )
    };
    std::fs::create_dir_all(folder).map_err(refused)?;
    let probe = folder.join(format!(".omnidrones-{}", std::process::id()));
    std::fs::write(&probe, "").map_err(refused)?;
    std::fs::remove_file(&probe).map_err(refused)
}

/// Writes `text`; an existing file is kept unless `force`.
pub fn write_new(path: &Path, text: &str, force: bool) -> Result<()> {
    if !force && path.symlink_metadata().is_ok() {
        return Err(Error::value(
            "output file",
            format!("'{}', which exists", path.display()),
            "a new file",
            "Add --force to overwrite it, or name another place.",
        ));
    }
    if let Some(parent) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        prepare_folder(parent)?;
    }
    std::fs::write(path, text).map_err(|e| Error::file(path, e))
}

/// `out/NAME`, with whatever a vehicle file called itself reduced to one plain folder name.
pub fn default_folder(vehicle: &str) -> PathBuf {
    let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let name: String = vehicle.trim_start_matches('.').chars().take(64).map(plain).collect();
    Path::new("out").join(if name.is_empty() { "vehicle" } else { &name })
}

/// Paths as text for JSON.
pub fn names(paths: &[PathBuf]) -> Vec<String> {
    paths.iter().map(|p| p.display().to_string()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vehicle_cannot_name_its_way_out_of_the_output_folder() {
        for (name, folder) in [("../../etc", "_.._etc"), ("a b/c", "a_b_c"), ("", "vehicle"), ("x500", "x500")] {
            assert_eq!(default_folder(name), Path::new("out").join(folder));
        }
    }
}
