//! Files of the command line: read behind fences, written whole, folders tried before long work.

use omnidrones::error::{Error, Result};
use omnidrones::internals;
use serde::de::DeserializeOwned;
use std::fs::DirEntry;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Writes a file of a folder of ours, whole or not at all: what bears its name is replaced, and no link followed.
pub fn replace(path: &Path, text: &[u8]) -> Result<()> {
    internals::replace(path, text)
}

/// Files that the command has saved whole, for whoever ends it.
static SAVED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Notes a file that is saved.
pub fn note_saved(path: &Path) {
    SAVED.lock().unwrap_or_else(PoisonError::into_inner).push(path.to_path_buf());
}

/// What was saved when a command is ended before its end.
pub fn saved_so_far() -> String {
    let saved = SAVED.lock().unwrap_or_else(PoisonError::into_inner);
    let (first, rest) = (saved.iter().take(4), saved.len().saturating_sub(4));
    let names: Vec<String> = first.map(|path| path.display().to_string()).collect();
    let more = if rest > 0 { format!(" and {rest} more") } else { String::new() };
    match &names[..] {
        [] => "no result was saved, and no file is left half written".into(),
        names => format!("{}{more} saved; no other file is left half written", names.join(", ")),
    }
}

/// Largest configuration file (settings, gains, reference), bytes.
pub const MAX_CONFIG_BYTES: u64 = 1 << 20;

/// Text of a regular file of at most `limit` bytes.
pub fn read_text(path: &Path, limit: u64) -> Result<String> {
    check_there(path)?;
    internals::read_text(path, limit)
}

/// Refuses a file that is not there, and says where it was looked for.
pub fn check_there(path: &Path) -> Result<()> {
    std::fs::metadata(path).map(drop).map_err(|e| unreadable(path, e, "Correct its name or its folder."))
}

/// What the operating system says of a file that cannot be read; of one that is not there also where it was looked for.
fn unreadable(path: &Path, error: std::io::Error, remedy: &str) -> Error {
    if error.kind() != ErrorKind::NotFound {
        return Error::file(path, error);
    }
    let here = std::env::current_dir().map_or_else(|_| "this folder".into(), |here| here.display().to_string());
    Error::Format {
        file: path.display().to_string(),
        place: "No such file".into(),
        rule: format!("looked for from {here}"),
        remedy: remedy.into(),
    }
}

/// A path as one word of a command that may be copied into a shell.
pub fn word(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_alphanumeric() || "_-./+:,=@%".contains(c);
    if !text.is_empty() && text.chars().all(plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

/// Text of a file of settings; where there is none, `maker` is the command that prints one.
pub fn read_settings(path: &Path, maker: &str) -> Result<String> {
    if let Err(error) = std::fs::metadata(path) {
        let remedy = format!("Correct its name, or make it: {maker} > {}", word(path));
        return Err(unreadable(path, error, &remedy));
    }
    read_text(path, MAX_CONFIG_BYTES)
}

/// A CSV file: a header, then row by row; names in it are no formulas.
pub fn write_table(path: &Path, header: Vec<String>, rows: impl Iterator<Item = Vec<String>>) -> Result<()> {
    let mut text = csv::Writer::from_writer(Vec::new());
    let failed = |e: csv::Error| Error::file(path, std::io::Error::other(e));
    text.write_record(header.iter().map(|name| internals::cell(name))).map_err(failed)?;
    for row in rows {
        text.write_record(row.iter().map(|cell| internals::cell(cell))).map_err(failed)?;
    }
    let bytes = text.into_inner().map_err(|e| Error::file(path, std::io::Error::other(e.to_string())))?;
    replace(path, &bytes)
}

/// Folders of runs in `root`, and in the folders there, newest first.
pub fn runs(root: &Path) -> Vec<PathBuf> {
    let checkpoints = |folder: &Path| std::fs::metadata(folder.join("checkpoints")).ok().filter(|m| m.is_dir());
    let folders = |at: &Path| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(at).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).filter(|path| path.is_dir()).collect()
    };
    let outer = folders(root);
    let inner = outer.iter().filter(|folder| checkpoints(folder).is_none()).flat_map(|folder| folders(folder));
    let all: Vec<PathBuf> = inner.chain(outer.iter().cloned()).collect();
    let mut dated: Vec<_> =
        all.into_iter().filter_map(|path| Some((checkpoints(&path)?.modified().ok()?, path))).collect();
    dated.sort_by(|a, b| b.cmp(a));
    dated.into_iter().map(|(_, path)| path).collect()
}

/// A TOML file as `T`; mistakes are named with line and column, unknown keys with the known ones.
pub fn read_toml<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = read_text(path, MAX_CONFIG_BYTES)?;
    internals::of_toml(&text, &path.display().to_string())
}

/// What marks a folder as made by a command: what commands write there may be replaced.
const MARK: &str = ".omnidrones";

/// Whether what is in a folder came from a command: it bears the mark, or is a run that the library wrote.
fn is_ours(folder: &Path) -> bool {
    is_marked(folder) || folder.join("config.toml").is_file() && has_checkpoints(folder)
}

/// Whether a command made the folder: no name in it is a user's.
fn is_marked(folder: &Path) -> bool {
    folder.join(MARK).is_file()
}

/// Whether a folder holds checkpoints of ours, rather than a folder of that name.
fn has_checkpoints(folder: &Path) -> bool {
    let entries = std::fs::read_dir(folder.join("checkpoints")).into_iter().flatten().flatten();
    entries.into_iter().any(|entry| entry.path().join("manifest.json").is_file())
}

/// Whether it is unfinished: being written, or left by a process that was killed.
fn is_left_over(entry: &DirEntry) -> bool {
    entry.file_name().to_string_lossy().starts_with(internals::UNFINISHED_NAME)
}

/// Removes what nobody can be writing still.
fn remove_old(left_over: &DirEntry) {
    let age = left_over.metadata().and_then(|about| about.modified()).ok().and_then(|then| then.elapsed().ok());
    if age.is_some_and(|age| age.as_secs() > 3600) {
        let _ = std::fs::remove_file(left_over.path());
    }
}

/// Makes and marks `folder` for output, and tries to write into it, so that a flight is not flown in vain. One that holds
/// files of others is refused unless `force`: it then stays without the mark.
pub fn prepare(folder: &Path, force: bool) -> Result<()> {
    let entries: Vec<_> = std::fs::read_dir(folder).into_iter().flatten().flatten().collect();
    let (left_over, others): (Vec<_>, Vec<_>) = entries.into_iter().partition(is_left_over);
    left_over.iter().for_each(remove_old);
    let first = others.into_iter().next();
    let whole = first.is_none() || is_marked(folder);
    let Some(first) = first.filter(|_| !is_ours(folder)) else {
        make_folder(folder)?;
        if !whole {
            return Ok(()); // a run between a user's files, or one that the library wrote
        }
        return replace(&folder.join(MARK), b"Output of omnidrones: commands replace what they wrote here.\n");
    };
    if force {
        return make_folder(folder);
    }
    Err(Error::value(
        "output folder",
        format!("'{}', which holds other files ({}, …)", folder.display(), first.file_name().to_string_lossy()),
        "new, empty or made by omnidrones",
        "Name another one with --out, or add --force to replace files of the same names.",
    ))
}

/// Files of a run beside its checkpoints.
const OF_RUN: [&str; 5] = ["config.toml", "log.jsonl", "curve.csv", "result.json", "events.out.tfevents.omnidrones"];
/// Pages of what it flew, which go from a folder of ours alone: in one of the user's they may be anybody's.
const PAGES: [&str; 2] = [REPLAY, "report.html"];

/// Removes what a run keeps in its folder, so that another begins there; refused while a process writes to it. Links are not
/// followed, and what is of others stays: where it stands in the way nothing is removed.
pub fn remove_run(folder: &Path) -> Result<()> {
    check_removable(folder)?;
    if has_checkpoints(folder) {
        internals::remove_checkpoints(folder)?;
    }
    // what the run began from is part of it
    let earlier = folder.join("from");
    if has_checkpoints(&earlier) {
        remove_run(&earlier)?;
    }
    let pages = if is_marked(folder) { &PAGES[..] } else { &[] };
    for name in OF_RUN.iter().chain(pages) {
        let path = folder.join(name);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(Error::file(path, error)),
            _ => {}
        }
    }
    Ok(())
}

/// Whether a run can be removed as [`remove_run`] does it.
pub fn check_removable(folder: &Path) -> Result<()> {
    internals::check_removable(folder)?;
    let earlier = folder.join("from");
    internals::own_folder(&earlier)?;
    if has_checkpoints(&earlier) { check_removable(&earlier) } else { Ok(()) }
}

/// The page of a flight.
pub const REPLAY: &str = "replay.html";

/// Removes files of such names that an earlier command wrote into a folder of ours, but for those of this one.
pub fn remove_stale(folder: &Path, written: &[PathBuf], is_stale: &dyn Fn(&str) -> bool) -> Result<()> {
    if !is_marked(folder) {
        return Ok(());
    }
    for entry in std::fs::read_dir(folder).map_err(|e| Error::file(folder, e))?.flatten() {
        let path = entry.path();
        let plain = entry.file_type().is_ok_and(|kind| kind.is_file());
        if plain && is_stale(&entry.file_name().to_string_lossy()) && !written.contains(&path) {
            std::fs::remove_file(&path).map_err(|e| Error::file(&path, e))?;
        }
    }
    Ok(())
}

/// Refuses a file that exists, but for one in a folder that a command made, unless `force`.
pub fn check_new(path: &Path, force: bool) -> Result<()> {
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // a device or pipe is written to, not replaced
    let device = path.metadata().is_ok_and(|about| !about.is_file());
    if force || device || is_ours(parent) || path.symlink_metadata().is_err() {
        return Ok(());
    }
    Err(Error::value(
        "output file",
        format!("'{}', which exists", path.display()),
        "a new file",
        "Add --force to overwrite it, or name another place.",
    ))
}

/// Makes the folder of a file.
pub fn make_parent(path: &Path) -> Result<()> {
    path.parent().filter(|p| !p.as_os_str().is_empty()).map_or(Ok(()), make_folder)
}

/// Makes `folder` and tries to write into it.
fn make_folder(folder: &Path) -> Result<()> {
    let refused = |e: std::io::Error| {
        Error::value(
            "output folder",
            format!("'{}' ({e})", folder.display()),
            "a folder that can be made and written to",
            "Name another one.",
        )
    };
    std::fs::create_dir_all(folder).map_err(refused)?;
    tempfile::tempfile_in(folder).map(drop).map_err(refused)
}

/// Writes `text` to a place that the user named, whole or not at all; an existing file is kept unless `force`. A link stays one and what it points to
/// is written; where that does not exist, the file takes the place of the link.
pub fn write_new(path: &Path, text: impl AsRef<[u8]>, force: bool) -> Result<()> {
    check_new(path, force)?;
    // a device or pipe must not be replaced by a file
    if path.metadata().is_ok_and(|about| !about.is_file()) {
        return std::fs::write(path, text).map_err(|e| Error::file(path, e));
    }
    make_parent(path)?;
    replace(&path.canonicalize().unwrap_or(path.to_path_buf()), text.as_ref())
}

/// `out/NAME`, with whatever a vehicle file called itself reduced to one plain folder name.
pub fn default_folder(vehicle: &str) -> PathBuf {
    let name = plain_name(vehicle);
    Path::new("out").join(if name.is_empty() { "vehicle" } else { &name })
}

/// Whatever a file or an option called something, as part of a file's name.
pub fn plain_name(name: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    name.trim_start_matches('.').chars().take(64).map(plain).collect()
}

/// A name by its letters and numbers, so that s2 stands before s10.
pub fn natural(name: &str) -> (String, u64, String) {
    let start = name.find(|c: char| c.is_ascii_digit()).unwrap_or(name.len());
    let end = name[start..].find(|c: char| !c.is_ascii_digit()).map_or(name.len(), |n| start + n);
    (name[..start].into(), name[start..end].parse().unwrap_or(0), name[end..].into())
}

/// Paths as text for JSON.
pub fn names(paths: &[PathBuf]) -> Vec<String> {
    paths.iter().map(|p| p.display().to_string()).collect()
}

/// A file that a linear model is to be written into, and whether as JSON; refused before any work where it cannot be.
pub fn model_file(file: Option<&Path>, force: bool) -> Result<Option<(&Path, bool)>> {
    let Some(file) = file else { return Ok(None) };
    let known = file.extension().and_then(|e| e.to_str()).filter(|e| ["json", "csv"].contains(e));
    let Some(kind) = known else {
        return Err(Error::value("--save", file.display(), "a file .json or .csv", "Name it so."));
    };
    check_new(file, force)?;
    make_parent(file)?;
    Ok(Some((file, kind == "json")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_its_links_stay_and_devices_are_written_to() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a/file");
        write_new(&file, "old", false).unwrap();
        assert!(write_new(&file, "new", false).is_err());
        #[cfg(target_os = "linux")]
        {
            let link = folder.path().join("link");
            std::os::unix::fs::symlink(&file, &link).unwrap();
            write_new(&link, "new", true).unwrap();
            assert!(link.symlink_metadata().unwrap().is_symlink());
            assert_eq!(std::fs::read_to_string(&file).unwrap(), "new");
            assert!(
                write_new(Path::new("/dev/full"), "text", true).is_err_and(|e| e.to_string().contains("/dev/full"))
            );
            assert!(!Path::new("/dev/full").is_file());
        }
        assert_eq!(std::fs::read_dir(folder.path().join("a")).unwrap().count(), 1, "nothing is left beside it");
    }

    #[test]
    fn who_ends_a_command_is_told_what_it_saved() {
        for n in [1, 4, 7] {
            SAVED.lock().unwrap().splice(.., (0..n).map(|i| PathBuf::from(format!("out/{i}.csv"))));
            let told = saved_so_far();
            assert!(told.starts_with("out/0.csv") && told.contains("saved;"), "{told}");
            assert_eq!(told.matches(".csv").count(), n.min(4), "{told}");
            assert_eq!(told.contains("and 3 more"), n == 7, "{told}");
        }
        SAVED.lock().unwrap().clear();
        assert!(saved_so_far().starts_with("no result was saved"));
    }

    #[test]
    fn what_a_killed_process_left_makes_no_folder_foreign() {
        let folder = tempfile::tempdir().unwrap();
        let left = folder.path().join(format!("{}abc", internals::UNFINISHED_NAME));
        std::fs::write(&left, "half").unwrap();
        prepare(folder.path(), false).unwrap();
        assert!(left.exists() && is_ours(folder.path()), "it may be written still");
        let hours = std::time::Duration::from_secs(7200);
        let file = std::fs::File::options().write(true).open(&left).unwrap();
        file.set_modified(std::time::SystemTime::now() - hours).unwrap();
        prepare(folder.path(), false).unwrap();
        assert!(!left.exists());
        let foreign = tempfile::tempdir().unwrap();
        std::fs::write(foreign.path().join("theirs"), "").unwrap();
        assert!(prepare(foreign.path(), false).is_err());
    }

    #[test]
    fn runs_are_found_one_folder_down_newest_first() {
        let root = tempfile::tempdir().unwrap();
        for name in ["a", "all/b", "c"] {
            std::fs::create_dir_all(root.path().join(name).join("checkpoints")).unwrap();
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        std::fs::create_dir(root.path().join("none")).unwrap();
        assert_eq!(runs(root.path()), ["c", "all/b", "a"].map(|name| root.path().join(name)));
        assert!(runs(&root.path().join("nowhere")).is_empty());
    }

    #[test]
    fn a_vehicle_cannot_name_its_way_out_of_the_output_folder() {
        for (name, folder) in [("../../etc", "_.._etc"), ("a b/c", "a_b_c"), ("", "vehicle"), ("x500", "x500")] {
            assert_eq!(default_folder(name), Path::new("out").join(folder));
        }
    }
}
