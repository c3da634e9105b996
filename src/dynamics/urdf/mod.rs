//! URDF import and export: a file becomes a [`Vehicle`], with everything that had to be guessed said aloud.
//!
//! | file | idea |
//! |---|---|
//! | `input_limits.rs` | sizes and depth, counted before any recursive parser sees the text |
//! | `schema.rs` | which elements, attributes and numbers URDF has |
//! | `diagnose.rs` | the text against the schema, with line numbers |
//! | `tree.rs` | links and joints: duplicates, dangling names, two roots, cycles |
//! | `bodies.rs` | every link's frame, mass and inertia in the base frame |
//! | `rotors.rs` | the TOML beside the file: what URDF cannot say about rotors |
//! | `resolve.rs` | rotor entries placed on the bodies |
//! | `properties.rs` | the `<properties>` element of the gym-pybullet-drones family |
//! | `recognise.rs` | which links look like rotors, and how they would spin |
//! | `draft.rs` | a first rotor file for a URDF that has none |
//! | `export.rs` | a vehicle written back as URDF and TOML |
//! | `options.rs`, `import.rs` | how to import; the steps above in order |
//! | `fault.rs` | what is said of a file |
//! | `articulated.rs` | the same links and joints through the assembly, as a model that moves |
//!
//! ```
//! # use omnidrones_dynamics::omnidrones;
//! use omnidrones::dynamics::urdf::{ImportOptions, import_file};
//!
//! let file = "plain_x.urdf";
//! # let file = "../../assets/urdf/plain_x.urdf";
//! let import = import_file(file, &ImportOptions::default())?; // reads plain_x.rotors.toml too
//! assert_eq!(import.vehicle.n_rotor(), 4);
//! for warning in &import.warnings {
//!     println!("{warning}");
//! }
//! # Ok::<(), omnidrones::error::Error>(())
//! ```
//!
//! An import starts no process, opens no file but the two it is given, loads no mesh, and resolves `package://` only
//! through [`ImportOptions::packages`]. [`import_file`] merges all links into one rigid vehicle; [`import_model_file`] keeps
//! the joints that move.

#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing))]

mod articulated;
mod bodies;
mod diagnose;
mod draft;
mod export;
mod fault;
mod import;
mod input_limits;
mod options;
mod properties;
mod recognise;
mod resolve;
mod rotors;
mod schema;
mod tree;

pub use articulated::{ModelImport, import_model_file, import_model_text};
pub use draft::{Draft, draft_rotors};
pub use export::export;
pub use import::{Import, import_file, import_text, rotor_file_beside};
pub use input_limits::InputLimits;
pub use options::ImportOptions;
pub use rotors::{RotorEntry, RotorFile};

use super::VehicleWarning;
use super::vehicle::Vehicle;

/// Something in the file that was understood, but is probably not what its author meant.
#[derive(Debug, Clone, PartialEq)]
pub struct Warning {
    /// The file, or `<text>`.
    pub file: String,
    /// 1-based line of the first occurrence, where there is one.
    pub line: Option<u32>,
    /// The element concerned: `<inertia iyx>`, `link 'arm_motor_0'`.
    pub element: String,
    /// What is odd, with the value or the count.
    pub rule: String,
    /// What was done about it, or what to do.
    pub remedy: String,
}

impl std::fmt::Display for Warning {
    /// One line: `file:line: element: rule. remedy`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        write!(f, ": {}: {}. {}", self.element, self.rule, self.remedy)
    }
}

impl Warning {
    /// What is odd about the vehicle as a whole.
    fn of(odd: VehicleWarning, file: &str) -> Self {
        let VehicleWarning { what, rule, remedy } = odd;
        Self { file: file.to_string(), line: None, element: what, rule, remedy }
    }
}

#[cfg(test)]
mod tests {
    use super::fault::clean;
    use super::*;

    #[test]
    fn a_warning_is_one_line_with_file_line_element_rule_and_remedy() {
        let warning = Warning {
            file: "a.urdf".into(),
            line: Some(7),
            element: "<inertia iyx>".into(),
            rule: "unknown attribute".into(),
            remedy: "Ignored.".into(),
        };
        assert_eq!(warning.to_string(), "a.urdf:7: <inertia iyx>: unknown attribute. Ignored.");
    }

    #[test]
    fn names_from_a_file_cannot_break_the_line() {
        assert_eq!(clean("a\nb"), "a b");
        assert_eq!(clean(&"x".repeat(100)).chars().count(), 65);
    }
}
