//! Instructions of a processor, in terms that its encoder and a simulation of it share.

use super::layout::Place;
use super::lower::Do;

/// A register of numbers.
pub(super) type Reg = u8;

/// A place in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Mem {
    /// By its place in [`Allocated::constants`].
    Constant(u32),
    Slot(u32),
    /// Where arguments and results of calls of custom functions stand.
    Call(u32),
    /// Where arguments, then results of the function of the first number stand, but for those on a tape.
    Passed(u32, u32),
    /// Where a function has its tape.
    Tape(u32),
    Row(Place),
}

/// An operand that may lie in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rm {
    Reg(Reg),
    Mem(Mem),
}

/// What a fused multiply-add computes: ±(product) ± (addend).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fused {
    MulAdd,
    NegMulAdd,
    MulSub,
}

/// Which operands of a fused multiply-add are what: the target is the first, then `v`, then `rm`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// target·rm + v
    F132,
    /// v·target + rm
    F213,
    /// v·rm + target
    F231,
}

/// How two numbers are compared; a NaN is neither less nor greater.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Relation {
    Less,
    Greater,
    NotLess,
    NotGreater,
}

/// An instruction of the processor. `k` are registers of masks, `m` memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Instruction {
    Load {
        d: Reg,
        m: Mem,
    },
    Store {
        m: Mem,
        s: Reg,
    },
    Move {
        d: Reg,
        s: Reg,
    },
    /// Of the operations with two operands.
    Two {
        what: Do,
        d: Reg,
        a: Reg,
        b: Rm,
    },
    Sqrt {
        d: Reg,
        a: Rm,
    },
    Up {
        d: Reg,
        a: Reg,
        by: u8,
    },
    Down {
        d: Reg,
        a: Reg,
        by: u8,
    },
    Fused {
        what: Fused,
        form: Form,
        d: Reg,
        v: Reg,
        rm: Rm,
    },
    /// k = a ~ b
    Compare {
        k: Reg,
        a: Reg,
        b: Rm,
        relation: Relation,
    },
    /// k = whether a and b share a bit, or do not.
    Test {
        k: Reg,
        a: Reg,
        b: Rm,
        share: bool,
    },
    /// d = yes where k, else no.
    Blend {
        d: Reg,
        k: Reg,
        no: Reg,
        yes: Rm,
    },
    /// d = a constant where k, else 0.
    Where {
        d: Reg,
        k: Reg,
        m: Mem,
    },
    /// d ^= b & c
    Flip {
        d: Reg,
        b: Reg,
        c: Rm,
    },
    /// d = all bits where a ~ b, else none. Without registers of masks.
    CompareInto {
        d: Reg,
        a: Reg,
        b: Rm,
        relation: Relation,
    },
    /// d = yes where the highest bit of `by` is set, else no.
    BlendBy {
        d: Reg,
        by: Reg,
        no: Reg,
        yes: Rm,
    },
    /// A call of a custom function. Arguments and results stand where such calls have them.
    Call {
        number: u32,
    },
    /// A call of a function of the program, by its number.
    Invoke {
        function: u32,
        tape: Option<TapeAt>,
    },
}

/// Where a tape that a function is given begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TapeAt {
    /// At a slot of the caller.
    Slot(u32),
    /// At a number of the caller's own tape.
    Own(u32),
}

impl TapeAt {
    pub(super) fn mem(self, k: u32) -> Mem {
        match self {
            Self::Slot(first) => Mem::Slot(first + k),
            Self::Own(first) => Mem::Tape(first + k),
        }
    }

    /// Where a tape begins whose numbers lie so.
    pub(super) fn of(mut places: impl Iterator<Item = Option<Mem>>) -> Option<Self> {
        let first = match places.next()?? {
            Mem::Slot(first) => Self::Slot(first),
            Mem::Tape(first) => Self::Own(first),
            _ => return None,
        };
        places.zip(1..).all(|(place, k)| place == Some(first.mem(k))).then_some(first)
    }
}

/// What a processor has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Target {
    pub(super) n_register: usize,
    /// Registers of masks, and constants that fill a register from one number in memory.
    pub(super) has_masks: bool,
    /// One number a register instead of many.
    pub(super) is_single: bool,
}

/// A program in instructions of a processor.
#[derive(Debug, Clone)]
pub(super) struct Allocated {
    pub(super) instructions: Vec<Instruction>,
    /// Constants, and how often each is read.
    pub(super) constants: Vec<(u64, u32)>,
    pub(super) n_slot: usize,
    /// Calls, of whatever functions.
    pub(super) n_call: u32,
}
