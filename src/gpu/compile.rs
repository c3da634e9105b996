//! Text to code: by NVRTC for a card, by the machine's C++ compiler where the host stands in. Code is kept by the hash of its text.

use crate::foreign::Driver;
use base::error::{Error, Result};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::process::Command;
use tasks::env::PRELUDE;
use tempfile::TempDir;

/// Code of a device, or a library of the host.
#[derive(Debug)]
pub(crate) enum Code {
    /// For a card.
    #[cfg(feature = "cuda")]
    Binary(Vec<u8>),
    /// A shared library, and the folder that it is in, if that goes when it is loaded.
    Library { path: PathBuf, _folder: Option<TempDir> },
}

/// Most bytes of code.
#[cfg(feature = "cuda")]
const MOST_CODE: u64 = 1 << 28;

/// Bytes of code that a folder keeps: the oldest goes first.
const MOST_KEPT: u64 = 512 << 20;

/// The variable that names a folder of compiled kernels.
const FOLDER: &str = "OMNIDRONES_KERNELS";

/// Where kernels are kept: `$OMNIDRONES_KERNELS`; those of cards otherwise in a folder of the user's cache.
fn folder(is_of_card: bool) -> Option<PathBuf> {
    let own = |name: &str| std::env::var_os(name).filter(|own| !own.is_empty()).map(PathBuf::from);
    let cache = || own("XDG_CACHE_HOME").or_else(|| own("HOME").map(|home| home.join(".cache")));
    let of_user = || cache().filter(|_| is_of_card).map(|cache| cache.join("omnidrones/kernels"));
    own(FOLDER).or_else(of_user)
}

/// Of all that code depends on.
fn hash(of: &[&str]) -> String {
    let mut hasher = Sha256::new();
    for part in of {
        hasher.update((part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Code with its hash behind it: a driver that is given half of it would read on.
#[cfg(feature = "cuda")]
fn sealed(binary: &[u8]) -> Vec<u8> {
    [binary, &Sha256::digest(binary)[..]].concat()
}

/// Code whose hash is right.
#[cfg(feature = "cuda")]
fn unsealed(mut bytes: Vec<u8>) -> Option<Vec<u8>> {
    let n = bytes.len().checked_sub(32)?;
    let is_whole = Sha256::digest(&bytes[..n])[..] == bytes[n..];
    bytes.truncate(n);
    is_whole.then_some(bytes)
}

/// Makes the code of kernels for a card that need not be here; its bytes.
#[cfg(feature = "cuda")]
pub(crate) fn ahead(text: &str, target: &str) -> Result<usize> {
    let whole = format!("{PRELUDE}\n{text}");
    let (binary, _) = crate::foreign::device_code(&whole, target)?;
    if let Some(folder) = folder(true) {
        keep(&folder.join(format!("{}.cubin", hash(&[&whole, target]))), |to| std::fs::write(to, sealed(&binary)));
    }
    Ok(binary.len())
}

/// The code of kernels for a driver, made or found.
pub(crate) fn compiled(driver: &Driver, text: &str) -> Result<Code> {
    let whole = format!("{PRELUDE}\n{text}");
    let (target, ending) = driver.target();
    let name = format!("{}.{ending}", hash(&[&whole, &target]));
    let kept = folder(!matches!(driver, Driver::Emulated)).map(|folder| folder.join(name));
    let found = kept.as_ref().filter(|path| path.is_file());
    match (driver, found) {
        (Driver::Emulated, Some(path)) => Ok(Code::Library { path: path.clone(), _folder: None }),
        (Driver::Emulated, None) => {
            let (made, folder) = library(&whole)?;
            if let Some(path) = kept {
                keep(&path, |to| std::fs::copy(&made, to).map(drop));
            }
            Ok(Code::Library { path: made, _folder: Some(folder) })
        }
        #[cfg(feature = "cuda")]
        (Driver::Cuda(_), found) => {
            if let Some(binary) = found.and_then(|path| unsealed(base::file_gate::read_own(path, MOST_CODE).ok()?)) {
                return Ok(Code::Binary(binary));
            }
            let (binary, _) = crate::foreign::device_code(&whole, &target)?;
            if let Some(path) = kept {
                keep(&path, |to| std::fs::write(to, sealed(&binary)));
            }
            Ok(Code::Binary(binary))
        }
    }
}

/// Writes a file beside and moves it into place: who finds half of one would believe it. That it cannot be kept is no fault.
fn keep(path: &Path, write: impl FnOnce(&Path) -> std::io::Result<()>) {
    let Some(folder) = path.parent() else { return };
    let _ = std::fs::create_dir_all(folder).and_then(|()| {
        let beside = tempfile::Builder::new().prefix(".making").tempfile_in(folder)?;
        write(beside.path())?;
        beside.persist(path).map_err(|error| error.error)?;
        forget_oldest(folder, path)
    });
}

/// Whether a file is named as code is kept: others in that folder are not ours.
fn is_own(name: &str) -> bool {
    let stem = name.strip_suffix(".cubin").or_else(|| name.strip_suffix(".so"));
    stem.is_some_and(|stem| stem.len() == 64 && stem.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

/// Takes code away that has been there longest, as long as there is too much.
fn forget_oldest(folder: &Path, own: &Path) -> std::io::Result<()> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let is_code = path.file_name().and_then(|name| name.to_str()).is_some_and(is_own);
        if let Ok(about) = path.metadata().and_then(|about| Ok((about.modified()?, about.len(), path.clone())))
            && is_code
        {
            all.push(about);
        }
    }
    all.sort();
    let mut bytes: u64 = all.iter().map(|(_, n, _): &(_, u64, PathBuf)| n).sum();
    for (_, n, path) in all.iter().filter(|(_, _, path)| path != own) {
        if bytes <= MOST_KEPT {
            break;
        }
        bytes -= n;
        std::fs::remove_file(path)?;
    }
    Ok(())
}

/// The C++ compiler: `$CXX`, or `c++`.
pub(crate) fn compiler() -> String {
    std::env::var("CXX").unwrap_or_else(|_| "c++".into())
}

/// Nothing is fused but what is written so. Without optimisation: the longest text takes seconds instead of a minute.
const FLAGS: [&str; 7] = ["-std=c++17", "-x", "c++", "-fPIC", "-shared", "-ffp-contract=off", "-DOD_HOST"];

/// A library of the host in a folder of its own.
fn library(text: &str) -> Result<(PathBuf, TempDir)> {
    let folder = tempfile::tempdir().map_err(|source| Error::File { path: std::env::temp_dir(), source })?;
    let (source, made) = (folder.path().join("kernels.cpp"), folder.path().join("kernels.so"));
    std::fs::write(&source, text).map_err(|error| Error::File { path: source.clone(), source: error })?;
    let mut command = Command::new(compiler());
    let fused: &[&str] = if cfg!(target_arch = "x86_64") { &["-mfma"] } else { &[] };
    command.args(FLAGS).args(fused).arg(&source).arg("-o").arg(&made);
    let output = command.output().map_err(|source| Error::File { path: command.get_program().into(), source })?;
    if output.status.success() {
        return Ok((made, folder));
    }
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let remedy = "Tell the authors of omnidrones, with the compiler.";
    Err(Error::value("C++ compiler's answer to kernels", said.trim(), "silence", remedy))
}
