//! Tasks in Python.
//!
//! | file | what |
//! |---|---|
//! | `shown` | what a task sees |
//! | `out` | what it writes |
//! | `begin` | where episodes begin |
//! | `robot` | what flies |
//! | `blocks` | paths, gates, forests |
//! | `source` | the task of a class: asked once, a record from then on |

mod begin;
mod blocks;
mod out;
mod robot;
mod shown;
mod source;

pub use begin::{Draws, Goal, Part, Start};
pub use blocks::{Forest, Gate, TrackPath};
pub use out::{Ends, Loss, Writer};
pub use robot::PyRobot;
pub use shown::{Motion, View};
pub use source::{
    _carried, _register, _register_record, _setting_keys, _task_name, _task_spec, entry_of, pinned, record_of,
};
