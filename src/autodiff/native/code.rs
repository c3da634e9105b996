//! A program as machine code for rows of one kind, with its constants and what it calls.

use super::allocate::allocate;
use super::executable::Row;
use super::layout::{MAX_ROWS, RowLayout, Rows};
use super::lower::{Callee, Element, Lowered, lower};
use super::memory::{self, Needs, PerProcess};
use super::x86::{Encoded, Shape, encode};
use super::{MAX_STEPS, WhyInterpreted};
use crate::columns::Lines;
use crate::custom::{Operation, Points, Scratch};
use crate::lanes::instruction_set;
use crate::program::{Op, ValueForm};
use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// Machine code, constants and callees. It stays while somebody has it.
#[derive(Debug)]
struct Native {
    key: Key,
    code: memory::Code,
    callees: Vec<(Callee, usize)>,
    element: Element,
    /// The binary logarithm of the numbers of a register.
    lanes_log: u32,
    /// Bytes of calls and slots.
    n_slot_byte: usize,
}

/// A share in it.
#[derive(Debug, Clone)]
pub struct Code(Arc<Native>);

impl Code {
    /// Of a program for rows of a kind.
    pub(super) fn of<R: Row>(form: &Arc<ValueForm>, layout: &RowLayout) -> Result<Self, WhyInterpreted> {
        Native::of(form, layout, shape(R::ELEMENT, R::N == 1), size_of::<R>()).map(Self)
    }

    #[cfg(test)]
    pub(super) fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    /// Room for its slots.
    pub(crate) fn slots(&self) -> Lines {
        Lines::zeros(self.0.n_slot_byte.div_ceil(64))
    }

    /// Bytes of memory that it takes.
    pub(super) fn n_byte(&self) -> usize {
        self.0.code.n_byte()
    }

    /// Runs for the first `n` numbers of the rows; others of the last register are worked on as well. Whether it ran: not where slots
    /// or arrays are not what the code needs.
    #[must_use]
    pub(crate) fn run<R: Row>(&self, slots: &mut Lines, arrays: &mut [Rows<'_, R>], n: usize) -> bool {
        self.run_within(slots, arrays, 0..n)
    }

    /// As [`Code::run`] for numbers from the beginning of a register on.
    #[must_use]
    pub(super) fn run_within<R: Row>(
        &self,
        slots: &mut Lines,
        arrays: &mut [Rows<'_, R>],
        numbers: Range<usize>,
    ) -> bool {
        let native = &*self.0;
        let lanes = 1 << native.lanes_log;
        let registers = numbers.start >> native.lanes_log..(numbers.end + lanes - 1) >> native.lanes_log;
        let mut call = |number: u32, rows: &mut [u8], remaining: usize| {
            let begun = (registers.end - remaining) * lanes;
            let (callee, n_operand) = &native.callees[number as usize];
            call_lanes(callee, *n_operand, native.element, lanes, lanes.min(numbers.end - begun), rows);
        };
        native.code.run(slots, arrays, registers.clone(), &mut call)
    }
}

/// What two programs share code by.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    form: Arc<ValueForm>,
    layout: RowLayout,
    shape: Shape,
    stride: usize,
}

/// Code that somebody has, by the hash of its key.
type Cache = HashMap<u64, Vec<Weak<Native>>>;

static CACHE: PerProcess<Mutex<Cache>> = PerProcess::new();

fn cache() -> MutexGuard<'static, Cache> {
    CACHE.get().lock().unwrap_or_else(PoisonError::into_inner)
}

impl Key {
    fn hash(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        Hash::hash(self, &mut hasher);
        hasher.finish()
    }
}

impl Native {
    /// The code of a program, made now or found.
    fn of(form: &Arc<ValueForm>, layout: &RowLayout, shape: Shape, stride: usize) -> Result<Arc<Self>, WhyInterpreted> {
        let key = Key { form: form.clone(), layout: layout.clone(), shape, stride };
        let hash = key.hash();
        // compared, and let go, when the lock is free again: the last share takes the lock to be forgotten
        let alike: Vec<Arc<Self>> = cache().get(&hash).into_iter().flatten().filter_map(Weak::upgrade).collect();
        if let Some(found) = alike.into_iter().find(|code| code.key == key) {
            return Ok(found);
        }
        memory::refusal()?;
        let made = Arc::new(Self::made(key)?);
        let mut cache = cache();
        let alike = cache.entry(hash).or_default();
        // another thread may have been faster; shares are let go when the lock is free again, as above
        let others: Vec<Arc<Self>> = alike.iter().filter_map(Weak::upgrade).collect();
        let other = others.iter().find(|code| code.key == made.key).cloned();
        if other.is_none() {
            alike.push(Arc::downgrade(&made));
        }
        drop(cache);
        Ok(other.unwrap_or(made))
    }

    fn made(key: Key) -> Result<Self, WhyInterpreted> {
        let Key { form, layout, shape, stride } = &key;
        let (shape, stride) = (*shape, *stride);
        let functions = form.functions();
        let sizes = functions.iter().chain([form]).map(|form| {
            let called: usize = form.calls().iter().map(|call| call.operands.len() + call.callee.n_output()).sum();
            form.n_value().max(form.results().len()).max(called)
        });
        let n_most: usize = sizes.sum();
        if n_most > MAX_STEPS || (0..layout.n_array()).any(|k| layout.n_row(k) > MAX_ROWS) {
            return Err(WhyInterpreted::TooLarge);
        }
        let mut lowered = lower(form, shape.element).ok_or(WhyInterpreted::TooLarge)?;
        let allocated = allocate(&mut lowered, layout, shape.target());
        let passed: Vec<usize> = lowered[1..].iter().map(Lowered::n_passed).collect();
        let calls = lowered.into_iter().flat_map(|part| part.calls);
        let callees: Vec<_> = calls.map(|site| (site.callee, site.operands.len())).collect();
        let custom = callees.iter().filter(|(callee, _)| !matches!(callee, Callee::Function(..)));
        let call_rows = custom.map(|(callee, n)| callee.n_output().max(*n)).max().unwrap_or(0);
        let Encoded { bytes, pool, n_row } = encode(&allocated, shape, layout, stride, call_rows, &passed);
        let constants = constants(&pool, shape);
        let n_slot_byte = n_row * shape.width;
        let needs = Needs {
            constant_bias: shape.constant_bias(),
            calls: call_rows * shape.width,
            slots: n_slot_byte,
            slot_bias: shape.slot_bias(),
            arrays: (0..layout.n_array()).map(|k| (layout.n_row(k), layout.is_written(k))).collect(),
            row: stride,
            registers: stride / shape.width,
        };
        let code = memory::Code::new(&bytes, constants, needs)?;
        let lanes_log = (shape.width / shape.element_size()).ilog2();
        Ok(Self { key, code, callees, element: shape.element, lanes_log, n_slot_byte })
    }
}

/// The bytes of a program.
#[cfg(test)]
pub(super) fn bytes(form: &ValueForm, layout: &RowLayout, element: Element, is_single: bool) -> Vec<u8> {
    let shape = shape(element, is_single);
    let mut lowered = lower(form, element).unwrap();
    let allocated = allocate(&mut lowered, layout, shape.target());
    let passed: Vec<usize> = lowered[1..].iter().map(Lowered::n_passed).collect();
    encode(&allocated, shape, layout, shape.width, 3, &passed).bytes
}

impl Drop for Native {
    fn drop(&mut self) {
        let hash = self.key.hash();
        let mut cache = cache();
        if let Some(alike) = cache.get_mut(&hash) {
            alike.retain(|code| code.strong_count() > 0);
            if alike.is_empty() {
                cache.remove(&hash);
            }
        }
    }
}

/// The constants as code reads them.
fn constants(pool: &[u64], shape: Shape) -> Lines {
    let (size, element) = (shape.constant_size(), shape.element_size());
    let mut lines = Lines::zeros((pool.len() * size).div_ceil(64));
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut lines);
    for (place, bits) in bytes.chunks_exact_mut(size).zip(pool) {
        place.chunks_exact_mut(element).for_each(|number| number.copy_from_slice(&bits.to_le_bytes()[..element]));
    }
    lines
}

/// Makes a call for the first `n` of the `lanes` of a register; arguments are read from the rows, then results are written over them.
fn call_lanes(callee: &Callee, n_operand: usize, element: Element, lanes: usize, n: usize, rows: &mut [u8]) {
    match (callee, element) {
        // one list of numbers for all: elementary functions of `f32` are no calls
        (Callee::Elementary(op), _) => elementary(*op, bytemuck::cast_slice_mut(rows), lanes, n),
        (Callee::Custom(operation), Element::F32) => {
            let rows: &mut [f32] = bytemuck::cast_slice_mut(rows);
            let mut scratch = Scratch::<f32, 512>::new();
            let results = scratch.of(operation.n_output() * lanes);
            operation.function().value_block(&mut Points::new(lanes, n, &rows[..n_operand * lanes], results));
            rows[..results.len()].copy_from_slice(results);
        }
        (Callee::Custom(operation), Element::F64) => custom(operation, lanes, n, bytemuck::cast_slice_mut(rows)),
        // called by the code itself
        (Callee::Function(..), _) => {}
    }
}

/// Lane by lane.
fn custom(operation: &Operation, lanes: usize, n: usize, rows: &mut [f64]) {
    let n_operand = operation.n_input();
    let mut scratch = Scratch::<f64, 256>::new();
    let (x, y) = scratch.of(n_operand + operation.n_output()).split_at_mut(n_operand);
    for lane in 0..n {
        x.iter_mut().enumerate().for_each(|(k, x)| *x = rows[k * lanes + lane]);
        operation.function().value(x, y);
        y.iter().enumerate().for_each(|(k, y)| rows[k * lanes + lane] = *y);
    }
}

/// Results over arguments.
fn elementary(op: Op, rows: &mut [f64], lanes: usize, n: usize) {
    for lane in 0..n {
        let x = rows[lane];
        rows[lane] = match op {
            Op::SinCos => {
                let (sine, cosine) = x.sin_cos();
                rows[lanes + lane] = cosine;
                sine
            }
            Op::Exp => x.exp(),
            Op::Ln => x.ln(),
            Op::Tanh => x.tanh(),
            _ => x.atan2(rows[lanes + lane]),
        };
    }
}

/// How rows of this kind lie in registers of this processor.
pub(super) fn shape(element: Element, is_single: bool) -> Shape {
    let is_evex = instruction_set() == "avx512";
    let width = match (is_single, is_evex) {
        (true, _) => 8,
        (false, true) => 64,
        (false, false) => 32,
    };
    Shape { element, width, is_evex }
}
