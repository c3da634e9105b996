//! A recording as a function of arrays with names.

use crate::Recording;

/// Numbers of an emitted program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ExportPrecision {
    /// `float`, 32 bits: sums fuse their products where the processor can, as lanes do.
    Single,
    /// `double`, 64 bits: every product and every sum is rounded, as in `f64`.
    Double,
}

impl ExportPrecision {
    /// The type in C.
    pub fn c_type(self) -> &'static str {
        match self {
            Self::Single => "float",
            Self::Double => "double",
        }
    }

    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::Single => 4,
            Self::Double => 8,
        }
    }
}

/// What a function does with an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Access {
    /// It reads it.
    Read,
    /// It writes all of it.
    Write,
    /// It reads it and writes all of it.
    Update,
}

/// A number of an array.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct NamedNumber {
    /// As in files and tables: `velocity_x`, `rotor_0.speed`.
    pub name: String,
    /// Unit, with the frame where there is one: `m/s, world`; `-` for a pure number.
    pub unit: String,
}

/// An array of a function's arguments or results.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct NamedArray {
    /// An identifier: `state`.
    pub name: String,
    /// What it holds, in a few words.
    pub about: String,
    /// What the function does with it.
    pub access: Access,
    /// Its numbers.
    pub numbers: Vec<NamedNumber>,
}

/// A recorded function of named arrays.
///
/// Inputs of the recording are the numbers of all arrays that are read or updated, one array after the other; its results those of all
/// that are written or updated.
#[derive(Debug, Clone)]
pub struct NamedFunction {
    /// An identifier: `step`.
    pub name: String,
    /// What it computes, in a few words.
    pub about: String,
    /// Its arguments, in order.
    pub arrays: Vec<NamedArray>,
    /// What it computes.
    pub recording: Recording,
}
