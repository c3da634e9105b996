//! How to import.

use super::input_limits::InputLimits;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// How to import.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImportOptions {
    /// Largest sizes that are accepted.
    pub limits: InputLimits,
    /// Folders of `package://name/…` paths. Nothing is resolved without them, and no mesh is opened in any case.
    pub packages: BTreeMap<String, PathBuf>,
    /// The rotor file, or a folder that holds `<stem>.rotors.toml`; it wins over the one beside the URDF.
    pub rotors: Option<PathBuf>,
}
