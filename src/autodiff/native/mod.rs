//! Machine code from a recording, made at run time: the bits of the interpreter at a multiple of its speed.
//!
//! | file | what |
//! |---|---|
//! | `lower` | operations of a program to those of a processor |
//! | `instruction`, `allocate` | what a processor does, with registers by furthest next use |
//! | `x86` | the encoder |
//! | `memory` | executable memory, and the call into it |
//! | [`layout`](RowLayout) | where arguments and results lie |
//! | `policy` | when code is made |
//!
//! An [`Executable`] works on rows where they are. Where code may not be made it interprets, with the same bits, and
//! [says why](Executable::why_interpreted).

mod layout;
#[cfg_attr(
    not(all(target_arch = "x86_64", target_os = "linux", not(miri))),
    allow(dead_code, reason = "no code is made there")
)]
mod lower;

#[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
mod allocate;
#[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
mod code;
mod executable;
#[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
mod instruction;
#[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
mod memory;
#[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
mod x86;

#[doc(hidden)]
pub use executable::WIDEST;
pub use executable::{Executable, Row, Work};
pub use layout::{MAX_ARRAYS, MAX_ROWS, Place, RowLayout, Rows};

#[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
#[doc(hidden)]
pub use memory::{PerProcess, in_standard_modes};

#[cfg(not(all(target_arch = "x86_64", target_os = "linux", not(miri))))]
mod elsewhere;
#[cfg(not(all(target_arch = "x86_64", target_os = "linux", not(miri))))]
use elsewhere as code;
#[cfg(not(all(target_arch = "x86_64", target_os = "linux", not(miri))))]
#[doc(hidden)]
pub use elsewhere::{PerProcess, in_standard_modes};

pub(crate) use code::Code;
#[doc(hidden)]
pub mod policy;

use super::program::{Program, ValueForm};
use super::trace::Recording;
use std::fmt;
use std::sync::{Arc, OnceLock};

/// Most values of a program that becomes machine code, elementary functions counted as what they are made of.
#[doc(hidden)]
pub const MAX_STEPS: usize = 1 << 20;

/// Most bytes of code of a process, in whole pages.
#[doc(hidden)]
pub const MAX_CODE: usize = 512 << 20;

/// Why a program is interpreted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum WhyInterpreted {
    /// `OMNIDRONES_NATIVE=off`.
    Off,
    /// Code is made on Linux and x86-64 alone, and not under Miri.
    System,
    /// The processor has no AVX2 with FMA.
    Processor,
    /// The system gave no executable memory.
    #[cfg(target_os = "linux")]
    Refused(rustix::io::Errno),
    /// More than 2²⁰ values, numbers of calls or results, or than 2²² rows (`MAX_STEPS`, `MAX_ROWS`).
    TooLarge,
    /// Code of this process takes 512 MiB (`MAX_CODE`).
    Full,
}

impl fmt::Display for WhyInterpreted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("switched off by OMNIDRONES_NATIVE=off"),
            Self::System => f.write_str("machine code is made on Linux and x86-64 alone"),
            Self::Processor => f.write_str("the processor has no AVX2 with FMA"),
            #[cfg(target_os = "linux")]
            Self::Refused(refusal) => write!(f, "the system gives no executable memory: {refusal}"),
            Self::TooLarge => {
                write!(
                    f,
                    "the program has more than {MAX_STEPS} values, numbers of calls or results, or rows beyond {MAX_ROWS}"
                )
            }
            Self::Full => write!(f, "{} MiB of machine code are in use", MAX_CODE >> 20),
        }
    }
}

/// Whether machine code may be made here, as far as that is known without making any.
///
/// # Errors
/// [`Off`](WhyInterpreted::Off), [`System`](WhyInterpreted::System) or [`Processor`](WhyInterpreted::Processor).
pub fn availability() -> Result<(), WhyInterpreted> {
    static SWITCH: OnceLock<bool> = OnceLock::new();
    let is_off = *SWITCH.get_or_init(|| {
        std::env::var_os("OMNIDRONES_NATIVE").is_some_and(|value| value.eq_ignore_ascii_case("off") || value == "0")
    });
    match (is_off, crate::lanes::instruction_set()) {
        (true, _) => Err(WhyInterpreted::Off),
        _ if !cfg!(all(target_arch = "x86_64", target_os = "linux", not(miri))) => Err(WhyInterpreted::System),
        (_, "avx512" | "avx2") => Ok(()),
        _ => Err(WhyInterpreted::Processor),
    }
}

/// What computes here, in words: the [instruction set](crate::instruction_set), and whether programs run as machine code or
/// are interpreted and why, as `avx2 (machine code)`. A little code is made to find out, since a system may refuse it.
pub fn instructions() -> String {
    let sum = Recording::of(2, |x| vec![x[0] + x[1]]);
    let why = availability().err().or_else(|| Program::compile(&sum).ok()?.why_interpreted());
    let how = why.map_or_else(|| "machine code".into(), |why| format!("interpreted: {why}"));
    format!("{} ({how})", crate::lanes::instruction_set())
}

/// Machine code of a program for rows of a kind, made now or found.
pub(crate) fn code<R: Row>(form: &Arc<ValueForm>, layout: &RowLayout) -> Result<Code, WhyInterpreted> {
    availability()?;
    // constants are rounded here
    in_standard_modes(|| Code::of::<R>(form, layout))
}

#[cfg(all(test, target_arch = "x86_64", target_os = "linux", not(miri)))]
pub(crate) mod tests;
