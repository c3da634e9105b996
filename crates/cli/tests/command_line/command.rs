//! The command line as a program that is started, for tests of commands.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};

/// The binary with these arguments, in a folder.
pub fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_omnidrones"));
    command.args(arguments).current_dir(folder).stdin(Stdio::null());
    command
}

/// Runs a command that must exit with `code`; its standard output and error.
pub fn exits(code: i32, folder: &Path, arguments: &[&str]) -> (String, String) {
    let output = command(folder, arguments).output().expect("the binary starts");
    let [out, err] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).expect("UTF-8"));
    assert_eq!(output.status.code(), Some(code), "{arguments:?}\n{out}\n{err}");
    (out, err)
}

/// The one JSON object that a command prints.
pub fn json(folder: &Path, arguments: &[&str]) -> Value {
    let (out, err) = exits(0, folder, &[arguments, &["--json"]].concat());
    assert_eq!(err, "", "{arguments:?}");
    serde_json::from_str(&out).unwrap_or_else(|e| panic!("{arguments:?}: {e}\n{out}"))
}

/// An empty folder.
pub fn temporary() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Bytes of a file, 0 if there is none.
pub fn size(folder: &Path, file: &str) -> u64 {
    std::fs::metadata(folder.join(file)).map_or(0, |m| m.len())
}

/// Characters of the longest line.
pub fn widest(text: &str) -> usize {
    text.lines().map(|l| l.chars().count()).max().unwrap_or(0)
}
