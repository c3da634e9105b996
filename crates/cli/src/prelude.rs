//! What every command speaks of: pages and tables, numbers in words, files, errors, JSON.

pub use super::Report;
pub use super::page::{Fact, Page};
pub use super::table::{Align, Table, number};
pub use super::words::{count, counted, duration, length, percent, share_of, short, shown};
pub(crate) use super::{files, progress};
pub use omnidrones::error::{Error, Result};
pub use serde_json::{Value, json};
pub use std::path::{Path, PathBuf};
