//! What flew here flies there: vehicles, controllers, policies and tasks as C99, policies as ONNX.
//!
//! | file | what |
//! |---|---|
//! | `module`: [`CModule`], [`ExportOptions`] | header, source, test and description of what is exported |
//! | `plant`: [`plant_as_c`] | a step of a vehicle |
//! | `controller`: [`controller_as_c`] | a tick of a straight-line law |
//! | `reference`: [`reference_as_c`] | a reference by time |
//! | `task`: [`task_as_c`], `episode` | what a task observes, rewards and ends |
//! | `policy`: [`policy_as_c`] | a policy with what it observes |
//! | [`network`] | a policy's network as C99 |
//! | [`onnx`] | a policy as ONNX |
//! | [`compiler`] | the C compiler of the machine |
//! | `golden` | numbers by which a module tests itself |
//! | `frames` | north, east, down |
//! | `identifier`, `words` | names of C, words of its comments |

#![warn(missing_docs)]

pub mod compiler;
mod controller;
mod episode;
mod frames;
mod golden;
mod identifier;
mod module;
#[doc(hidden)]
pub mod network;
pub mod onnx;
mod plant;
mod policy;
mod reference;
#[cfg(test)]
mod sample_policies;
mod task;
#[cfg(test)]
mod tests;
mod words;

pub use autodiff::emit::ExportPrecision;
pub use controller::controller_as_c;
pub use module::{CModule, ExportOptions, ExportedFunction};
pub use plant::plant_as_c;
pub use policy::{policy_as_c, saved_policy_as_c};
pub use reference::reference_as_c;
pub use task::task_as_c;

/// Examples of the documentation name things as users of `omnidrones` do.
#[doc(hidden)]
pub mod omnidrones {
    pub use crate as export;
    pub use {autodiff, base::error, controllers, dynamics, rl, tasks};
}
