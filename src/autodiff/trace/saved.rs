//! A recording as data: what was written once is kept in a file, and is checked before anything is made of it.
//!
//! | part | bytes |
//! |---|---|
//! | file | `omnirec`, version 1, callees behind their count, body |
//! | callee | 0: a custom operation: name and data, each behind its length; counts of inputs and results; or 1: a function: its body |
//! | body | counts of inputs and of written nodes; those nodes; results behind their count |
//! | node | its place in [`FORMS`]; the number of an input, the eight bytes of a constant, the number of a callee; operands |
//!
//! Counts and numbers are LEB128, operands and results say how far back their nodes stand. Results of a call are not written: they stand
//! behind it. A callee is written once, before whatever calls it, so nothing can call itself. Truths and numbers stand for each other, as
//! in a [`Walk`](super::Walk): a truth is 1 or 0, a number is true above 0.5. Constants may be infinite, which is how bounds say that there
//! is none, and not NaN, of which everything that reads it would be.

use super::Recording;
use super::function::Function;
use super::graph::{Arithmetic, Call, Callee, Node};
use crate::custom::{Operation, SavedFunction};
use crate::program::Tape;
use base::error::{Error, Result};
use std::collections::HashMap;
use std::mem::discriminant;
use std::sync::Arc;

/// Every file begins so; the last byte is the version.
const HEAD: &[u8; 8] = b"omnirec\x01";

/// What nodes can be, by the first byte of each.
const FORMS: [Node; 23] = {
    use Node::*;
    [
        Input(0),
        Constant(0),
        Call(0),
        Add(0, 0),
        Sub(0, 0),
        Mul(0, 0),
        Div(0, 0),
        Neg(0),
        Recip(0),
        Sqrt(0),
        Sin(0),
        Cos(0),
        Exp(0),
        Ln(0),
        Tanh(0),
        Atan2(0, 0),
        Less(0, 0),
        And(0, 0),
        Or(0, 0),
        Not(0),
        MulAdd(0, 0, 0),
        Select(0, 0, 0),
        Detach(0),
    ]
};

/// How much a file may ask for.
#[doc(hidden)]
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SavedLimits {
    /// Inputs, of the recording and of each of its functions.
    pub n_input: usize,
    /// Results, likewise.
    pub n_output: usize,
    /// Nodes of the file: operations, calls, results of calls. Functions count once.
    pub n_node: usize,
    /// What a walk does: nodes and operands of calls, those of functions as often as they are called.
    pub n_operation: usize,
    /// How many functions may be within each other.
    pub depth: usize,
    /// Inputs that joined in the course of recording ([`Trace::input`](super::Trace::input)) have numbers below this. Where it is 0 there
    /// are none, and [`Recording::evaluate`] may be called.
    pub n_late_input: usize,
}

impl Default for SavedLimits {
    fn default() -> Self {
        Self { n_input: 1 << 16, n_output: 1 << 16, n_node: 1 << 20, n_operation: 1 << 22, depth: 16, n_late_input: 0 }
    }
}

impl Recording {
    /// The recording as bytes, the same in every process: for [`from_bytes`](Self::from_bytes).
    ///
    /// # Errors
    /// [`Error::Value`] for a recording that is not [`as_written`](Self::as_written), a constant that is NaN and a custom function that
    /// is not [`saved`](crate::CustomFunction::saved).
    #[doc(hidden)]
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let mut callees = Callees::default();
        let body = callees.body(self)?;
        let mut bytes = HEAD.to_vec();
        put(&mut bytes, callees.n);
        bytes.extend(callees.bytes);
        bytes.extend(body);
        Ok(bytes)
    }

    /// The recording of [`to_bytes`](Self::to_bytes), which nobody is trusted to have made: it is [`as_written`](Self::as_written), a walk
    /// over it finds whatever it reads, and it is no longer than the limits. `operations` gives the custom operation of a name and data,
    /// and refuses what it does not know.
    ///
    /// # Errors
    /// [`Error::Format`] for bytes that are no such recording, [`Error::Limit`] for one that is too large, and those of `operations`.
    #[doc(hidden)]
    pub fn from_bytes(
        bytes: &[u8],
        operations: &dyn Fn(&str, &[u8]) -> Result<Operation>,
        limits: &SavedLimits,
    ) -> Result<Self> {
        let mut reader = Reader { bytes, at: 0, operations, limits, known: Vec::new(), n_node: 0 };
        reader.head()?;
        for _ in 0..reader.count("callees")? {
            let callee = reader.callee()?;
            reader.known.push(callee);
        }
        let (recording, _) = reader.body(limits.n_late_input)?;
        if reader.at < bytes.len() {
            return Err(reader.wrong("bytes follow behind the end"));
        }
        Ok(recording)
    }
}

/// LEB128.
fn put(bytes: &mut Vec<u8>, mut number: u32) {
    while number > 0x7F {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

fn put_text(bytes: &mut Vec<u8>, text: &[u8]) {
    put(bytes, text.len() as u32);
    bytes.extend(text);
}

/// What is called, written once each.
#[derive(Default)]
struct Callees {
    n: u32,
    bytes: Vec<u8>,
    operations: HashMap<SavedFunction, u32>,
    functions: HashMap<Function, u32>,
}

impl Callees {
    fn body(&mut self, recording: &Recording) -> Result<Vec<u8>> {
        if recording.arithmetic != Arithmetic::Written {
            let remedy = "Save what `Recording::as_written` records.";
            return Err(Error::value("a recording to be saved", "folded", "one as it was written", remedy));
        }
        let written = || (0..).zip(&recording.nodes).filter(|(_, node)| !matches!(node, Node::Result(..)));
        let mut bytes = Vec::new();
        put(&mut bytes, recording.n_input as u32);
        put(&mut bytes, written().count() as u32);
        for (at, node) in written() {
            let form = FORMS.iter().position(|form| discriminant(form) == discriminant(node));
            bytes.push(form.unwrap_or(FORMS.len()) as u8);
            match *node {
                Node::Input(k) => put(&mut bytes, k),
                Node::Constant(bits) if f64::from_bits(bits).is_nan() => {
                    let remedy = "Find what was undefined when it was recorded.";
                    return Err(Error::value(format!("the constant of node {at}"), "NaN", "a number", remedy));
                }
                Node::Constant(bits) => bytes.extend(bits.to_le_bytes()),
                Node::Call(number) => put(&mut bytes, self.number(&recording.calls[number as usize].callee, at)?),
                _ => {}
            }
            node.operands(&recording.calls).for_each(|operand| put(&mut bytes, at - operand));
        }
        put(&mut bytes, recording.outputs.len() as u32);
        let end = recording.nodes.len() as u32;
        recording.outputs.iter().for_each(|output| put(&mut bytes, end - output));
        Ok(bytes)
    }

    /// Of what the node `at` calls.
    fn number(&mut self, callee: &Callee, at: u32) -> Result<u32> {
        match callee {
            Callee::Custom(operation) => {
                let lengths = [operation.n_input(), operation.n_output()];
                let saved = operation.function().saved().ok_or_else(|| {
                    let [n, m] = lengths;
                    let what = format!("the custom function called by node {at}");
                    let value = format!("one of {n} inputs and {m} results that has no name to be saved by");
                    Error::value(what, value, "known by name", "Implement `CustomFunction::saved` for it.")
                })?;
                if let Some(number) = self.operations.get(&saved) {
                    return Ok(*number);
                }
                self.bytes.push(0);
                put_text(&mut self.bytes, saved.name.as_bytes());
                put_text(&mut self.bytes, &saved.data);
                lengths.iter().for_each(|n| put(&mut self.bytes, *n as u32));
                self.operations.insert(saved, self.n);
            }
            Callee::Function(function) => {
                if let Some(number) = self.functions.get(function) {
                    return Ok(*number);
                }
                let body = self.body(function.recording())?;
                self.bytes.push(1);
                self.bytes.extend(body);
                self.functions.insert(function.clone(), self.n);
            }
        }
        self.n += 1;
        Ok(self.n - 1)
    }
}

/// A callee that was read.
struct Known {
    callee: Callee,
    n_input: usize,
    size: Size,
}

/// Of a recording with its functions.
#[derive(Default, Clone, Copy)]
struct Size {
    n_operation: usize,
    depth: usize,
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    operations: &'a dyn Fn(&str, &[u8]) -> Result<Operation>,
    limits: &'a SavedLimits,
    known: Vec<Known>,
    /// So far.
    n_node: usize,
}

impl<'a> Reader<'a> {
    fn wrong(&self, rule: impl Into<String>) -> Error {
        Error::Format {
            file: "<recording>".into(),
            place: format!("byte {}", self.at),
            rule: rule.into(),
            remedy: "Record and save it again.".into(),
        }
    }

    fn within(what: &str, value: usize, limit: usize) -> Result<()> {
        let remedy = "Record a smaller function, or raise the limit if the file is your own.";
        if value > limit {
            Err(Error::limit(format!("{what} of a saved recording"), value, limit, remedy))
        } else {
            Ok(())
        }
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8]> {
        let left = &self.bytes[self.at..];
        let taken =
            left.get(..n).ok_or_else(|| self.wrong(format!("{n} bytes should follow, and {} do", left.len())))?;
        self.at += n;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8> {
        Ok(self.take(1)?[0])
    }

    fn number(&mut self) -> Result<u32> {
        let mut number = 0;
        for shift in [0, 7, 14, 21, 28] {
            let byte = self.byte()?;
            let part = u32::from(byte & 0x7F);
            if part << shift >> shift != part {
                break;
            }
            number |= part << shift;
            if byte < 0x80 {
                return Ok(number);
            }
        }
        Err(self.wrong("a number of more than 32 bits"))
    }

    /// Of what takes a byte each, at least.
    fn count(&mut self, what: &str) -> Result<usize> {
        let (n, left) = (self.number()? as usize, self.bytes.len() - self.at);
        if n > left { Err(self.wrong(format!("{n} {what} should follow in {left} bytes"))) } else { Ok(n) }
    }

    fn text(&mut self, what: &str) -> Result<&'a [u8]> {
        let n = self.count(what)?;
        self.take(n)
    }

    fn head(&mut self) -> Result<()> {
        let head = self.take(HEAD.len())?;
        let ([name @ .., version], [own_name @ .., own_version]) = (head, HEAD) else { return Ok(()) };
        if name != own_name {
            return Err(self.wrong("it does not begin as a saved recording"));
        }
        if version != own_version {
            return Err(self.wrong(format!("version {version} of the format, and this reads {own_version}")));
        }
        Ok(())
    }

    fn callee(&mut self) -> Result<Known> {
        match self.byte()? {
            0 => {
                let Ok(name) = std::str::from_utf8(self.text("bytes of a name")?) else {
                    return Err(self.wrong("the name of an operation is no text"));
                };
                let data = self.text("bytes of data")?;
                let said = (self.number()? as usize, self.number()? as usize);
                let operation = (self.operations)(name, data)?;
                let own = (operation.n_input(), operation.n_output());
                if own != said {
                    let counts = |(n, m)| format!("{n} inputs and {m} results");
                    return Err(self.wrong(format!("operation {name} has {}, and here {}", counts(own), counts(said))));
                }
                let size = Size { n_operation: 1, depth: 0 };
                Ok(Known { n_input: own.0, callee: Callee::Custom(operation), size })
            }
            1 => {
                let (recording, mut size) = self.body(0)?;
                size.depth += 1;
                Self::within("depth of functions", size.depth, self.limits.depth)?;
                let n_input = recording.n_input;
                Ok(Known { n_input, callee: Callee::Function(Function::of(recording, Tape::None)), size })
            }
            kind => Err(self.wrong(format!("a callee is an operation (0) or a function (1), and not {kind}"))),
        }
    }

    /// A node that stands `nodes.len()` minus a number, and is no call: those are read by their results.
    fn operand(&mut self, nodes: &[Node]) -> Result<u32> {
        let back = self.number()? as usize;
        let node = nodes
            .len()
            .checked_sub(back)
            .filter(|node| nodes.get(*node).is_some_and(|node| !matches!(node, Node::Call(_))));
        node.map(|node| node as u32)
            .ok_or_else(|| self.wrong(format!("nothing to read stands {back} before node {}", nodes.len())))
    }

    fn body(&mut self, n_late_input: usize) -> Result<(Recording, Size)> {
        let limits = self.limits;
        let n_input = self.number()? as usize;
        Self::within("number of inputs", n_input, limits.n_input)?;
        let n_written = self.count("nodes")?;
        Self::within("number of nodes", n_written, limits.n_node)?;
        let (mut nodes, mut calls, mut size) = (Vec::with_capacity(n_written), Vec::new(), Size::default());
        for _ in 0..n_written {
            let form = self.byte()?;
            let mut node =
                *FORMS.get(usize::from(form)).ok_or_else(|| self.wrong(format!("no node has the form {form}")))?;
            let mut n_result = 0;
            match &mut node {
                Node::Input(k) => {
                    *k = self.number()?;
                    if *k as usize >= n_input.max(n_late_input) {
                        return Err(self.wrong(format!("there is no input {k} of {n_input}")));
                    }
                }
                Node::Constant(bits) => {
                    let bytes = self.take(8)?.iter().rev();
                    *bits = bytes.fold(0, |bits, byte| bits << 8 | u64::from(*byte));
                    if f64::from_bits(*bits).is_nan() {
                        return Err(self.wrong("a constant is NaN"));
                    }
                }
                Node::Call(number) => {
                    let callee = self.number()?;
                    let Some(Known { callee, n_input, size: own }) = self.known.get(callee as usize) else {
                        return Err(self.wrong(format!("nothing that is called has number {callee}")));
                    };
                    let (callee, n_input) = (callee.clone(), *n_input);
                    size.depth = size.depth.max(own.depth);
                    size.n_operation = size.n_operation.saturating_add(own.n_operation).saturating_add(n_input);
                    n_result = callee.n_output();
                    let operands = (0..n_input).map(|_| self.operand(&nodes)).collect::<Result<Arc<[u32]>>>()?;
                    *number = calls.len() as u32;
                    calls.push(Call { callee, operands });
                }
                node => {
                    for operand in node.operands_mut().into_iter().flatten() {
                        *operand = self.operand(&nodes)?;
                    }
                }
            }
            self.n_node = self.n_node.saturating_add(n_result).saturating_add(1);
            Self::within("number of nodes", self.n_node, limits.n_node.min(u32::MAX as usize))?;
            let at = nodes.len() as u32;
            nodes.push(node);
            nodes.extend((0..n_result as u32).map(|k| Node::Result(at, k)));
        }
        size.n_operation = size.n_operation.saturating_add(nodes.len());
        Self::within("number of operations", size.n_operation, limits.n_operation)?;
        let n_output = self.count("results")?;
        Self::within("number of results", n_output, limits.n_output)?;
        let outputs = (0..n_output).map(|_| self.operand(&nodes)).collect::<Result<Vec<u32>>>()?;
        Ok((Recording { nodes, calls, n_input, outputs, arithmetic: Arithmetic::Written }, size))
    }
}

#[cfg(test)]
mod tests;
