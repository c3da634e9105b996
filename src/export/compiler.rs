//! The C compiler of the machine, where there is one: modules are compiled and test themselves.

use super::module::CModule;
use base::error::{Error, Result};
use std::path::Path;
use std::process::Command;

/// Flags under which modules are silent.
pub const STRICT: [&str; 7] =
    ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"];

/// The command that compiles: `$CC`, or `cc`.
pub fn compiler() -> String {
    std::env::var("CC").unwrap_or_else(|_| "cc".into())
}

/// It with the options that its name brings: `gcc -m32`.
fn command() -> Command {
    let words = compiler();
    let mut words = words.split_whitespace();
    let mut command = Command::new(words.next().unwrap_or("cc"));
    command.args(words);
    command
}

/// Whether there is a C compiler.
pub fn has_compiler() -> bool {
    command().arg("--version").output().is_ok_and(|output| output.status.success())
}

/// Compiles the module in a folder of its own with its test, strictly, and runs that; what the test said.
///
/// # Errors
/// [`Error::Value`] with what compiler or test said, where one fails; [`Error::File`] where no program can be started.
pub fn checked(module: &CModule, flags: &[&str]) -> Result<String> {
    let folder = tempfile::tempdir().map_err(|source| Error::File { path: std::env::temp_dir(), source })?;
    module.write(folder.path(), true)?;
    let files = [".c", "_test.c"].map(|ending| format!("{}{ending}", module.name));
    compile(folder.path(), &files, "own", flags)?;
    let output = ran(&mut Command::new(folder.path().join("own")))?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    if output.status.success() {
        return Ok(said);
    }
    let wrong: Vec<&str> = said.lines().filter(|line| line.ends_with("WRONG")).collect();
    let value = if wrong.is_empty() { format!("it ended with {}", output.status) } else { wrong.join("; ") };
    let remedy = "Do not fly it. Tell the authors of omnidrones, with the compiler and its target.";
    Err(Error::value(format!("test of module '{}'", module.name), value, "within its bounds", remedy))
}

/// Compiles files of a folder to a program in it, strictly.
///
/// # Errors
/// As [`checked`].
pub fn compile(folder: &Path, files: &[String], program: &str, flags: &[&str]) -> Result<()> {
    let mut command = command();
    command.current_dir(folder).args(STRICT).args(flags).args(files).args(["-lm", "-o", program]);
    let output = ran(&mut command)?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let remedy = "Tell the authors of omnidrones, with the compiler and its target.";
    Err(Error::value(format!("compiler's answer to {}", files.join(" ")), said.trim(), "silence", remedy))
}

fn ran(command: &mut Command) -> Result<std::process::Output> {
    command.output().map_err(|source| Error::File { path: command.get_program().into(), source })
}
