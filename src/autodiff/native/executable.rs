//! A program that works on rows where they are, by machine code or by the interpreter.

use super::layout::{RowLayout, Rows};
use super::lower::Element;
use super::{Code, WhyInterpreted, code};
use crate::columns::{BLOCK, LINE, Lines};
use crate::lanes::lane_width;
use crate::program::{BlockWorkspace, Program, Workspace};
use base::error::{Error, Result};
use std::marker::PhantomData;
use std::ops::Range;

/// Numbers of the widest register.
#[doc(hidden)]
pub const WIDEST: usize = 16;

/// A row of an array: a number of each environment of a block, one number, or a number of each of eight steps.
pub trait Row: sealed::Row {}

impl Row for [f32; BLOCK] {}
impl Row for f64 {}
impl Row for [f64; LINE] {}

mod sealed {
    use super::{Element, Interpreted};
    use crate::program::Program;
    use std::ops::Range;

    #[doc(hidden)]
    #[expect(private_interfaces, reason = "nobody outside implements or calls these")]
    pub trait Row: bytemuck::Pod {
        const ELEMENT: Element;
        /// Numbers of a row.
        const N: usize;
        /// What the interpreter needs.
        fn interpreted(program: &Program) -> Interpreted;
        /// outputs = f(inputs), for the first `n` numbers of each row.
        fn interpret(program: &Program, scratch: &mut Interpreted, inputs: &[Self], outputs: &mut [Self], n: usize);
        /// Writes the registers of these numbers.
        fn keep(&self, _numbers: &Range<usize>, row: &mut Self) {
            *row = *self;
        }
    }
}

/// Scratch of the interpreter.
#[derive(Debug, Clone)]
enum Interpreted {
    Block(BlockWorkspace),
    One(Workspace),
    Steps(Lines),
}

/// Scratch of an [`Executable`]; made once, reused without allocation.
#[derive(Debug, Clone)]
pub struct Work<R> {
    slots: Lines,
    interpreted: Option<(Interpreted, Vec<R>, Vec<R>)>,
}

/// A program for rows of one kind, whose arguments and results lie as a [`RowLayout`] says.
///
/// ```
/// # use omnidrones_autodiff::omnidrones;
/// use omnidrones::autodiff::native::{Executable, RowLayout, Place, Rows};
/// use omnidrones::autodiff::{Program, Recording, Scalar, Trace};
///
/// // (x, v) of a falling stone, in place: x += v·0.1, v −= 0.981
/// let c = Trace::constant;
/// let recording = Recording::of(2, |z| vec![z[0] + z[1] * c(0.1), z[1] - c(0.981)]);
/// let rows = vec![Place { array: 0, row: 0 }, Place { array: 0, row: 1 }];
/// let fall = Executable::new(&Program::compile(&recording)?, RowLayout::new(rows.clone(), rows)?)?;
/// let (mut state, mut work) = ([10.0, 0.0], fall.work());
/// for _ in 0..2 {
///     fall.run(&mut work, &mut [Rows::Write(&mut state)], 1)?;
/// }
/// assert_eq!(state, [10.0 - 0.981 * 0.1, -0.981 - 0.981]);
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Executable<R> {
    program: Program,
    layout: RowLayout,
    code: std::result::Result<Code, WhyInterpreted>,
    rows: PhantomData<R>,
}

impl<R: Row> Executable<R> {
    /// Makes machine code of a program, or has it interpreted where that cannot be.
    ///
    /// # Errors
    /// [`Error::Value`] for a layout of another number of arguments or results.
    pub fn new(program: &Program, layout: RowLayout) -> Result<Self> {
        let (n, m) = (layout.arguments().len(), layout.results().len());
        if (n, m) != (program.n_input(), program.n_output()) {
            let limit = format!("of {} and {}, as the program has", program.n_input(), program.n_output());
            let remedy = "Say where each argument and each result lies, in order.";
            return Err(Error::value("layout", format!("of {n} arguments and {m} results"), limit, remedy));
        }
        let code = code::<R>(program.arranged(), &layout);
        Ok(Self { program: program.clone(), layout, code, rows: PhantomData })
    }

    /// Whether it is machine code.
    pub fn is_native(&self) -> bool {
        self.code.is_ok()
    }

    /// Why it is interpreted; `None` where it is machine code.
    pub fn why_interpreted(&self) -> Option<WhyInterpreted> {
        self.code.as_ref().err().copied()
    }

    /// Bytes of memory that its code takes, 0 where it is interpreted.
    pub fn code_size(&self) -> usize {
        self.code.as_ref().map_or(0, |code| code.n_byte())
    }

    #[cfg(test)]
    pub(super) fn shares_code_with(&self, other: &Self) -> bool {
        matches!((&self.code, &other.code), (Ok(own), Ok(other)) if own.is_same(other))
    }

    /// Scratch for [`Executable::run`].
    pub fn work(&self) -> Work<R> {
        match &self.code {
            Ok(code) => Work { slots: code.slots(), interpreted: None },
            Err(_) => {
                let rows = |n| vec![R::zeroed(); n];
                let (inputs, outputs) = (rows(self.program.n_input()), rows(self.program.n_output()));
                let interpreted = Some((R::interpreted(&self.program), inputs, outputs));
                Work { slots: Lines::default(), interpreted }
            }
        }
    }

    /// Results from arguments, for the first `n` numbers of each row. The others of a register of which some are among them are
    /// worked on as well; what lies in other registers stays.
    ///
    /// # Errors
    /// [`Error::Value`] where arrays are more, fewer, shorter or less writable than the layout says, or `n` is not 1 to the
    /// numbers of a row. No number is touched then.
    ///
    /// # Panics
    /// If `work` has too little room, or a custom function panics. That of another program gives wrong numbers where it is
    /// interpreted.
    pub fn run(&self, work: &mut Work<R>, arrays: &mut [Rows<'_, R>], n: usize) -> Result<()> {
        self.run_within(work, arrays, 0..n)
    }

    /// As [`Executable::run`] for these numbers of each row, which begin with a register of any processor.
    #[doc(hidden)]
    pub fn run_within(&self, work: &mut Work<R>, arrays: &mut [Rows<'_, R>], numbers: Range<usize>) -> Result<()> {
        let is_within = numbers.start.is_multiple_of(WIDEST) && numbers.start < numbers.end && numbers.end <= R::N;
        if let Ok(code) = &self.code {
            if is_within && code.run_within(&mut work.slots, arrays, numbers.clone()) {
                return Ok(());
            }
            self.check(arrays, &numbers)?;
            panic!("scratch of another program");
        }
        self.check(arrays, &numbers)?;
        self.interpret(work, arrays, numbers);
        Ok(())
    }

    #[cold]
    fn check(&self, arrays: &[Rows<'_, R>], numbers: &Range<usize>) -> Result<()> {
        let layout = &self.layout;
        if numbers.start >= numbers.end || numbers.end > R::N {
            let limit = format!("1 to {}", R::N);
            return Err(Error::value("numbers of a row", numbers.len(), limit, "Run blocks one after the other."));
        }
        if !numbers.start.is_multiple_of(WIDEST) {
            let limit = format!("a multiple of {WIDEST}");
            return Err(Error::value("first number of a row", numbers.start, limit, "Begin with a register."));
        }
        if arrays.len() != layout.n_array() {
            let limit = format!("{}, as the layout has", layout.n_array());
            return Err(Error::value(
                "number of arrays",
                arrays.len(),
                limit,
                "Pass the arrays in the order of the layout.",
            ));
        }
        for (k, array) in arrays.iter().enumerate() {
            let what = || format!("array {k}");
            if array.rows().len() < layout.n_row(k) {
                let (value, limit) =
                    (format!("of {} rows", array.rows().len()), format!("of {} or more", layout.n_row(k)));
                return Err(Error::value(what(), value, limit, "Pass all rows that the layout names."));
            }
            if layout.is_written(k) && matches!(array, Rows::Read(_)) {
                return Err(Error::value(
                    what(),
                    "read only",
                    "writable",
                    "Pass arrays with results as `Rows::Write`.",
                ));
            }
        }
        Ok(())
    }

    fn interpret(&self, work: &mut Work<R>, arrays: &mut [Rows<'_, R>], numbers: Range<usize>) {
        let Some((scratch, inputs, outputs)) = &mut work.interpreted else { panic!("scratch of another program") };
        for (input, place) in inputs.iter_mut().zip(self.layout.arguments()) {
            *input = arrays[usize::from(place.array)].rows()[place.row as usize];
        }
        R::interpret(&self.program, scratch, inputs, outputs, numbers.end);
        for (output, place) in outputs.iter().zip(self.layout.results()) {
            if let Rows::Write(rows) = &mut arrays[usize::from(place.array)] {
                output.keep(&numbers, &mut rows[place.row as usize]);
            }
        }
    }
}

#[expect(private_interfaces, reason = "sealed")]
impl sealed::Row for [f32; BLOCK] {
    const ELEMENT: Element = Element::F32;
    const N: usize = BLOCK;
    fn interpreted(program: &Program) -> Interpreted {
        Interpreted::Block(program.interpreter_block_workspace())
    }
    fn interpret(program: &Program, scratch: &mut Interpreted, inputs: &[Self], outputs: &mut [Self], n: usize) {
        if let Interpreted::Block(workspace) = scratch {
            program.evaluate_lanes(n, workspace, inputs, outputs);
        }
    }
    fn keep(&self, numbers: &Range<usize>, row: &mut Self) {
        let worked_on = numbers.start..numbers.end.next_multiple_of(lane_width());
        row[worked_on.clone()].copy_from_slice(&self[worked_on]);
    }
}

#[expect(private_interfaces, reason = "sealed")]
impl sealed::Row for f64 {
    const ELEMENT: Element = Element::F64;
    const N: usize = 1;
    fn interpreted(program: &Program) -> Interpreted {
        Interpreted::One(program.interpreter_workspace())
    }
    fn interpret(program: &Program, scratch: &mut Interpreted, inputs: &[Self], outputs: &mut [Self], _: usize) {
        if let Interpreted::One(workspace) = scratch {
            program.evaluate(workspace, inputs, outputs);
        }
    }
}

#[expect(private_interfaces, reason = "sealed")]
impl sealed::Row for [f64; LINE] {
    const ELEMENT: Element = Element::F64;
    const N: usize = LINE;
    fn interpreted(program: &Program) -> Interpreted {
        Interpreted::Steps(program.step_slots())
    }
    fn interpret(program: &Program, scratch: &mut Interpreted, inputs: &[Self], outputs: &mut [Self], n: usize) {
        if let Interpreted::Steps(slots) = scratch {
            program.evaluate_steps(n, slots, inputs);
            for (k, output) in outputs.iter_mut().enumerate() {
                *output = slots[program.place(k) as usize];
            }
        }
    }
}
