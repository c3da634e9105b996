//! Registers for the values of a program: one pass forward, where the value whose next use is furthest away leaves (Belady 1966).
//!
//! A value has a home in memory (an argument, a constant, a result, a slot) or none yet. It is stored once, when it leaves a register
//! for the first time; what has a home leaves for nothing. A value in memory comes into a register only if something there is needed
//! later than it is, else the instruction reads it where it lies.

mod calls;

use self::calls::{Functions, Signature, reach};
use super::instruction::*;
use super::layout::{Place, RowLayout};
use super::lower::{Do, Lowered, Of, Operand, Step};
use std::collections::HashMap;
use std::ops::Range;

const NOWHERE: Reg = Reg::MAX;
const NEVER: u32 = u32::MAX;
const NOBODY: u32 = u32::MAX;
const N_MASK: usize = 6;

/// Half-steps that a value without a home must be needed later than one with, to leave instead: a store costs as much as waiting.
const WITH_HOME: u64 = 3;
const WITHOUT_HOME: u64 = 2;

/// A comparison that a register of masks holds: a < b, or not.
type Held = (u32, u32, bool);

struct Allocator<'a> {
    lowered: &'a Lowered,
    functions: Functions<'a>,
    target: Target,
    n_input: usize,
    first_step: usize,
    /// Values of constants that instructions read beside their operands: 1, and the lowest bit.
    one: usize,
    lowest_bit: usize,
    /// Times at which values are read, those of value v at `first[v]..first[v + 1]`.
    uses: Vec<u32>,
    first: Vec<u32>,
    /// The next of them, per value.
    cursor: Vec<u32>,
    register: Vec<Reg>,
    home: Vec<Option<Mem>>,
    /// The value that a register holds.
    holds: [u32; 32],
    /// Registers that the current step reads or writes.
    pinned: u32,
    now: u32,
    free_slots: Vec<u32>,
    /// Slots that are free behind the current step: it may read them still.
    ending: Vec<u32>,
    n_slot: u32,
    masks: [Option<Held>; N_MASK],
    next_mask: usize,
    /// The function that was called last, where it was none of the custom ones, and its tape.
    last_called: Option<(u32, Option<TapeAt>)>,
    /// Values that stand where a function left them.
    passed: Vec<usize>,
    out: Vec<Instruction>,
}

/// A result that is stored behind all steps.
struct Late {
    value: Operand,
    place: Mem,
}

/// Where arguments and results lie.
pub(super) struct Ends {
    arguments: Vec<Mem>,
    results: Vec<Mem>,
}

impl Ends {
    fn of_layout(layout: &RowLayout) -> Self {
        let rows = |places: &[Place]| places.iter().map(|place| Mem::Row(*place)).collect();
        Self { arguments: rows(layout.arguments()), results: rows(layout.results()) }
    }

    fn of_function(number: u32, lowered: &Lowered) -> Self {
        let n = (lowered.n_input - lowered.tape.n_input()) as u32;
        let all = lowered.n_passed() as u32;
        let places = |range: Range<u32>, n_tape: usize| {
            range.map(|k| Mem::Passed(number, k)).chain((0..n_tape as u32).map(Mem::Tape)).collect()
        };
        Self { arguments: places(0..n, lowered.tape.n_input()), results: places(n..all, lowered.tape.n_result()) }
    }
}

/// Gives registers to a program, whose arguments and results lie as `layout` says, and to its functions behind it.
pub(super) fn allocate(lowered: &mut [Lowered], layout: &RowLayout, target: Target) -> Vec<Allocated> {
    let signatures: Vec<Signature> = lowered[1..].iter().map(Signature::of).collect();
    let reach = reach(lowered);
    let all = lowered.iter_mut().zip(0_u32..);
    all.map(|(lowered, k)| {
        let ends = match k.checked_sub(1) {
            None => Ends::of_layout(layout),
            Some(number) => Ends::of_function(number, lowered),
        };
        protect_arguments(lowered, &ends);
        let (stores, late) = order_of_stores(lowered, &ends);
        let functions = Functions { signatures: &signatures, reach: &reach };
        Allocator::new(lowered, functions, &ends, target, &late).run(&stores, &late)
    })
    .collect()
}

/// Arguments that are results as they are, in a place that another result is written to, are copied first.
fn protect_arguments(lowered: &mut Lowered, ends: &Ends) {
    let written: HashMap<Mem, usize> = ends.results.iter().copied().zip(0..).collect();
    let mut copies: HashMap<usize, Operand> = HashMap::new();
    for k in 0..lowered.results.len() {
        if let Of::Input(input) = lowered.results[k].of()
            && written.get(&ends.arguments[input]).is_some_and(|by| *by != k)
        {
            let steps = &mut lowered.steps;
            lowered.results[k] = *copies.entry(input).or_insert_with(|| {
                steps.push(Step::new(Do::Copy, &[Operand::input(input)]));
                Operand::step(steps.len() - 1)
            });
        }
    }
}

/// Results by the step that they are stored behind, and those that wait for the end: what is no step, and what is written over an
/// argument that is read later.
fn order_of_stores(lowered: &Lowered, ends: &Ends) -> (HashMap<usize, Vec<Mem>>, Vec<Late>) {
    let mut read_last: HashMap<Mem, usize> = HashMap::new();
    for (time, step) in lowered.steps.iter().enumerate() {
        let called: &[Operand] =
            if let Do::Call(number) = step.what { &lowered.calls[number as usize].operands } else { &[] };
        for operand in step.operands().iter().chain(called) {
            if let Of::Input(k) = operand.of() {
                read_last.insert(ends.arguments[k], time);
            }
        }
    }
    let (mut stores, mut late) = (HashMap::<usize, Vec<Mem>>::new(), Vec::new());
    for (value, place) in lowered.results.iter().zip(&ends.results) {
        match value.of() {
            Of::Step(k) if read_last.get(place).is_none_or(|last| *last <= k) => {
                stores.entry(k).or_default().push(*place)
            }
            // as an argument in its own place
            Of::Input(k) if ends.arguments[k] == *place => {}
            _ => late.push(Late { value: *value, place: *place }),
        }
    }
    (stores, late)
}

impl<'a> Allocator<'a> {
    fn new(lowered: &'a Lowered, functions: Functions<'a>, ends: &Ends, target: Target, late: &[Late]) -> Self {
        let n_input = lowered.n_input;
        let first_step = n_input + lowered.constants.len();
        let n_value = first_step + lowered.steps.len();
        let mut allocator = Self {
            lowered,
            functions,
            target,
            n_input,
            first_step,
            one: n_input + lowered.one(),
            lowest_bit: n_input + lowered.lowest_bit(),
            uses: Vec::new(),
            first: vec![0; n_value + 1],
            cursor: Vec::new(),
            register: vec![NOWHERE; n_value],
            home: vec![None; n_value],
            holds: [NOBODY; 32],
            pinned: 0,
            now: 0,
            free_slots: Vec::new(),
            ending: Vec::new(),
            n_slot: 0,
            masks: [None; N_MASK],
            next_mask: 0,
            last_called: None,
            passed: Vec::new(),
            out: Vec::with_capacity(lowered.steps.len() * 5 / 4),
        };
        allocator.list_uses(late);
        for (home, place) in allocator.home.iter_mut().zip(&ends.arguments) {
            *home = Some(*place);
        }
        allocator
    }

    fn value(&self, operand: Operand) -> usize {
        match operand.of() {
            Of::Input(k) => k,
            Of::Constant(k) => self.n_input + k,
            Of::Step(k) => self.first_step + k,
        }
    }

    fn list_uses(&mut self, late: &[Late]) {
        let lowered = self.lowered;
        let mut reads = Vec::with_capacity(lowered.steps.len() * 2);
        for (time, step) in lowered.steps.iter().enumerate() {
            let called: &[Operand] =
                if let Do::Call(number) = step.what { &lowered.calls[number as usize].operands } else { &[] };
            reads
                .extend(step.operands().iter().chain(called).map(|operand| (self.value(*operand) as u32, time as u32)));
        }
        let behind = lowered.steps.len() as u32;
        reads.extend(late.iter().zip(behind..).map(|(late, time)| (self.value(late.value) as u32, time)));
        for (value, _) in &reads {
            self.first[*value as usize + 1] += 1;
        }
        for v in 0..self.first.len() - 1 {
            self.first[v + 1] += self.first[v];
        }
        let mut fill = self.first.clone();
        self.uses = vec![0; reads.len()];
        for (value, time) in reads {
            let at = &mut fill[value as usize];
            self.uses[*at as usize] = time;
            *at += 1;
        }
        self.cursor = self.first[..self.first.len() - 1].to_vec();
    }

    fn run(mut self, stores: &HashMap<usize, Vec<Mem>>, late: &[Late]) -> Allocated {
        let constants = self.place_constants();
        for (k, step) in self.lowered.steps.iter().enumerate() {
            self.now = k as u32;
            let value = self.first_step + k;
            let made = self.step(step, value, stores);
            if let Some(d) = made {
                self.hold(d, value);
            }
            for place in stores.get(&k).into_iter().flatten() {
                if self.home[value] == Some(*place) {
                    continue; // on a tape, where the function that was called has put it
                }
                let s = self.ensure(value);
                self.out.push(Instruction::Store { m: *place, s });
                self.home[value] = Some(*place);
            }
            if self.next_use(value) == NEVER {
                self.forget(value);
            }
            self.pinned = 0;
            self.free_slots.append(&mut self.ending);
        }
        for (late, time) in late.iter().zip(self.lowered.steps.len() as u32..) {
            self.now = time;
            let value = self.value(late.value);
            let s = self.ensure(value);
            self.out.push(Instruction::Store { m: late.place, s });
            self.release(&[value]);
            self.pinned = 0;
        }
        let n_call = self.lowered.calls.len() as u32;
        Allocated { instructions: self.out, constants, n_slot: self.n_slot as usize, n_call }
    }

    fn place_constants(&mut self) -> Vec<(u64, u32)> {
        let constants = self.lowered.constants.iter().zip(self.n_input..);
        let constants = constants.map(|(bits, value)| (*bits, self.first[value + 1] - self.first[value])).collect();
        for k in 0..self.lowered.constants.len() {
            self.home[self.n_input + k] = Some(Mem::Constant(k as u32));
        }
        constants
    }

    /// The next use of a value behind the current step.
    fn next_use(&mut self, value: usize) -> u32 {
        let end = self.first[value + 1];
        let cursor = &mut self.cursor[value];
        while *cursor < end && self.uses[*cursor as usize] <= self.now {
            *cursor += 1;
        }
        if *cursor < end { self.uses[*cursor as usize] } else { NEVER }
    }

    /// How far away the next use of a value is, weighted by what it costs to have it in memory.
    fn distance(&mut self, value: usize) -> u64 {
        let weight = if self.home[value].is_some() { WITH_HOME } else { WITHOUT_HOME };
        u64::from(self.next_use(value) - self.now) * weight
    }

    /// The register that may be taken best, and how far away what it holds is needed.
    fn best(&mut self) -> (Reg, u64) {
        let mut best = (NOWHERE, 0);
        for r in 0..self.target.n_register as Reg {
            if self.pinned >> r & 1 == 1 {
                continue;
            }
            let value = self.holds[usize::from(r)];
            if value == NOBODY {
                return (r, u64::MAX);
            }
            let distance = self.distance(value as usize);
            if distance > best.1 {
                best = (r, distance);
            }
        }
        best
    }

    /// A register for something new; what it held goes home.
    fn take(&mut self) -> Reg {
        let (r, _) = self.best();
        let value = self.holds[usize::from(r)];
        if value != NOBODY {
            self.send_home(value as usize);
            self.forget(value as usize);
        }
        self.pinned |= 1 << r;
        r
    }

    fn send_home(&mut self, value: usize) {
        if self.home[value].is_none() {
            let slot = self.free_slots.pop().unwrap_or_else(|| {
                self.n_slot += 1;
                self.n_slot - 1
            });
            let m = Mem::Slot(slot);
            self.home[value] = Some(m);
            self.out.push(Instruction::Store { m, s: self.register[value] });
        }
    }

    fn hold(&mut self, r: Reg, value: usize) {
        self.register[value] = r;
        self.holds[usize::from(r)] = value as u32;
        self.pinned |= 1 << r;
    }

    fn forget(&mut self, value: usize) {
        let r = std::mem::replace(&mut self.register[value], NOWHERE);
        if r != NOWHERE {
            self.holds[usize::from(r)] = NOBODY;
            self.pinned &= !(1 << r);
        }
    }

    fn memory(&self, value: usize) -> Mem {
        // a value outside registers went home when it left them
        self.home[value].unwrap_or(Mem::Slot(0))
    }

    /// Has the value in a register.
    fn ensure(&mut self, value: usize) -> Reg {
        if self.register[value] == NOWHERE {
            let d = self.take();
            self.out.push(Instruction::Load { d, m: self.memory(value) });
            self.hold(d, value);
        }
        self.pinned |= 1 << self.register[value];
        self.register[value]
    }

    /// Brings a value into a register if it is needed again before something there.
    fn want(&mut self, value: usize) {
        if self.register[value] == NOWHERE && self.next_use(value) != NEVER && self.best().1 > self.distance(value) {
            self.ensure(value);
        }
    }

    /// Where the value is.
    fn rm(&self, value: usize) -> Rm {
        match self.register[value] {
            NOWHERE => Rm::Mem(self.memory(value)),
            r => Rm::Reg(r),
        }
    }

    fn is_here(&self, value: usize) -> bool {
        self.register[value] != NOWHERE
    }

    /// Gives back registers and slots of operands that end here.
    fn release(&mut self, values: &[usize]) {
        for &value in values {
            if self.next_use(value) == NEVER {
                self.forget(value);
                if let Some(Mem::Slot(slot)) = self.home[value] {
                    self.ending.push(slot);
                    self.home[value] = None;
                }
            }
        }
    }

    /// Emits what the step that makes `value` does; its result is in the register returned, or stands where a function left it.
    fn step(&mut self, step: &Step, value: usize, stores: &HashMap<usize, Vec<Mem>>) -> Option<Reg> {
        match step.what {
            Do::Call(number) => {
                self.call(number, stores);
                return None;
            }
            Do::Result(result) if let Some((function, tape)) = self.last_called => {
                let Signature { n_argument, n_result, .. } = self.functions.signatures[function as usize];
                let home = match (result.checked_sub(n_result as u32), tape) {
                    (Some(k), Some(tape)) => tape.mem(k),
                    _ => Mem::Passed(function, n_argument as u32 + result),
                };
                self.home[value] = Some(home);
                self.passed.push(value);
                return None;
            }
            _ => {}
        }
        let mut values = [0; 4];
        for (value, operand) in values.iter_mut().zip(step.operands()) {
            *value = self.value(*operand);
        }
        let values = &values[..step.operands().len()];
        for &value in values {
            if self.is_here(value) {
                self.pinned |= 1 << self.register[value];
            }
        }
        values.iter().for_each(|value| self.want(*value));
        Some(match (step.what, values) {
            (Do::Result(k), _) => self.result(k),
            (Do::Copy, [a]) => self.copy(*a),
            (Do::Sqrt, [a]) => self.sqrt(*a),
            (Do::Up(by), [a]) => self.shift(*a, |d, a| Instruction::Up { d, a, by }),
            (Do::Down(by), [a]) => self.shift(*a, |d, a| Instruction::Down { d, a, by }),
            (Do::MulAdd, [a, b, c]) => self.fused(Fused::MulAdd, [*a, *b, *c]),
            (Do::NegMulAdd, [a, b, c]) => self.fused(Fused::NegMulAdd, [*a, *b, *c]),
            (Do::MulSub, [a, b, c]) => self.fused(Fused::MulSub, [*a, *b, *c]),
            (Do::Less, [a, b]) => self.less(*a, *b),
            (Do::SelectLess, [a, b, c, d]) => self.select_less([*a, *b, *c, *d]),
            (Do::SelectOdd, [a, b, c]) => self.select_odd(*a, *b, *c),
            (Do::Flip, [a, b, c]) => self.flip(*a, *b, *c),
            (what, [a, b]) => self.two(what, *a, *b),
            (what, _) => unreachable!("operands of {what:?}"),
        })
    }

    fn result(&mut self, k: u32) -> Reg {
        let d = self.take();
        self.out.push(Instruction::Load { d, m: Mem::Call(k) });
        d
    }

    fn copy(&mut self, a: usize) -> Reg {
        let d = self.take();
        self.out.push(match self.rm(a) {
            Rm::Reg(s) => Instruction::Move { d, s },
            Rm::Mem(m) => Instruction::Load { d, m },
        });
        self.release(&[a]);
        d
    }

    fn two(&mut self, what: Do, mut a: usize, mut b: usize) -> Reg {
        let commutes = matches!(what, Do::Add | Do::Mul | Do::Xor | Do::And | Do::AddBits);
        if commutes && !self.is_here(a) && self.is_here(b) {
            (a, b) = (b, a);
        }
        let (first, second) = (self.ensure(a), self.rm(b));
        self.release(&[a, b]);
        let d = self.take();
        self.out.push(Instruction::Two { what, d, a: first, b: second });
        d
    }

    fn sqrt(&mut self, a: usize) -> Reg {
        let rm = self.rm(a);
        self.release(&[a]);
        let d = self.take();
        self.out.push(Instruction::Sqrt { d, a: rm });
        d
    }

    fn shift(&mut self, a: usize, make: impl Fn(Reg, Reg) -> Instruction) -> Reg {
        let s = self.ensure(a);
        self.release(&[a]);
        let d = self.take();
        self.out.push(make(d, s));
        d
    }

    /// Overwrites an operand that ends here, else a copy of one.
    fn fused(&mut self, what: Fused, values: [usize; 3]) -> Reg {
        self.all_but_one(&values);
        let rms = values.map(|value| self.rm(value));
        let ends = values.map(|value| self.is_here(value) && self.next_use(value) == NEVER);
        self.release(&values);
        let (form, d, v, rm) = match (rms, ends) {
            ([Rm::Reg(v), rm, Rm::Reg(d)] | [rm, Rm::Reg(v), Rm::Reg(d)], [_, _, true]) => (Form::F231, d, v, rm),
            ([Rm::Reg(d), Rm::Reg(v), rm], [true, ..]) | ([Rm::Reg(v), Rm::Reg(d), rm], [_, true, _]) => {
                (Form::F213, d, v, rm)
            }
            ([Rm::Reg(d), rm, Rm::Reg(v)], [true, ..]) | ([rm, Rm::Reg(d), Rm::Reg(v)], [_, true, _]) => {
                (Form::F132, d, v, rm)
            }
            ([Rm::Mem(m), Rm::Reg(v), rm] | [Rm::Reg(v), Rm::Mem(m), rm], _) => (Form::F213, self.loaded(m), v, rm),
            ([Rm::Reg(v), rm, Rm::Mem(m)], _) => (Form::F231, self.loaded(m), v, rm),
            ([Rm::Reg(v), rm, Rm::Reg(s)], _) => {
                let d = self.take();
                self.out.push(Instruction::Move { d, s });
                (Form::F231, d, v, rm)
            }
            _ => unreachable!("two operands of a fused product in memory"),
        };
        self.pinned |= 1 << d;
        self.out.push(Instruction::Fused { what, form, d, v, rm });
        d
    }

    fn loaded(&mut self, m: Mem) -> Reg {
        let d = self.take();
        self.out.push(Instruction::Load { d, m });
        d
    }

    /// Leaves at most one operand in memory, and that once.
    fn all_but_one(&mut self, values: &[usize]) {
        let mut kept = None;
        for (k, &value) in values.iter().enumerate().rev() {
            let is_repeated = values[..k].contains(&value) || values[k + 1..].contains(&value);
            if !self.is_here(value) && (is_repeated || kept.is_some_and(|kept| kept != value)) {
                self.ensure(value);
            } else if !self.is_here(value) {
                kept = Some(value);
            }
        }
    }

    /// The comparison a < b in a register of masks, or that it does not hold.
    fn mask(&mut self, a: usize, b: usize, is_inverse: bool) -> Reg {
        let held = Some((a as u32, b as u32, is_inverse));
        if let Some(k) = self.masks.iter().position(|mask| *mask == held) {
            return k as Reg + 1;
        }
        let k = self.next_mask as Reg + 1;
        self.masks[self.next_mask] = held;
        self.next_mask = (self.next_mask + 1) % N_MASK;
        let (a, b, relation) = self.compared(a, b, is_inverse);
        self.out.push(Instruction::Compare { k, a, b, relation });
        k
    }

    /// The operands of a comparison, the first in a register.
    fn compared(&mut self, a: usize, b: usize, is_inverse: bool) -> (Reg, Rm, Relation) {
        let is_swapped = !self.is_here(a) && self.is_here(b);
        let (first, second) = if is_swapped { (b, a) } else { (a, b) };
        let relation = match (is_swapped, is_inverse) {
            (false, false) => Relation::Less,
            (true, false) => Relation::Greater,
            (false, true) => Relation::NotLess,
            (true, true) => Relation::NotGreater,
        };
        (self.ensure(first), self.rm(second), relation)
    }

    fn less(&mut self, a: usize, b: usize) -> Reg {
        if self.target.has_masks {
            let k = self.mask(a, b, false);
            self.release(&[a, b]);
            let d = self.take();
            self.out.push(Instruction::Where { d, k, m: self.memory(self.one) });
            return d;
        }
        let one = self.ensure(self.one);
        let (a_in, b_in, relation) = self.compared(a, b, false);
        self.release(&[a, b]);
        self.pinned |= 1 << one;
        let d = self.take();
        self.out.push(Instruction::CompareInto { d, a: a_in, b: b_in, relation });
        self.out.push(Instruction::Two { what: Do::And, d, a: d, b: Rm::Reg(one) });
        d
    }

    fn select_less(&mut self, [a, b, yes, no]: [usize; 4]) -> Reg {
        let all = [a, b, yes, no];
        if self.target.has_masks {
            let is_inverse = !self.is_here(no) && self.is_here(yes);
            let (yes, no) = if is_inverse { (no, yes) } else { (yes, no) };
            let k = self.mask(a, b, is_inverse);
            return self.blend(k, yes, no, &all);
        }
        let (no_in, yes_in) = self.blended(yes, no);
        let (a_in, b_in, relation) = self.compared(a, b, false);
        let d = self.target_beside(no_in, yes_in, &all);
        self.out.push(Instruction::CompareInto { d, a: a_in, b: b_in, relation });
        self.out.push(Instruction::BlendBy { d, by: d, no: no_in, yes: yes_in });
        d
    }

    fn select_odd(&mut self, a: usize, yes: usize, no: usize) -> Reg {
        let all = [a, yes, no];
        let s = self.ensure(a);
        if self.target.has_masks {
            let is_inverse = !self.is_here(no) && self.is_here(yes);
            let (yes, no) = if is_inverse { (no, yes) } else { (yes, no) };
            let k = N_MASK as Reg + 1;
            self.out.push(Instruction::Test { k, a: s, b: self.rm(self.lowest_bit), share: !is_inverse });
            return self.blend(k, yes, no, &all);
        }
        let (no_in, yes_in) = self.blended(yes, no);
        let d = self.target_beside(no_in, yes_in, &all);
        // the lowest bit becomes the highest
        self.out.push(Instruction::Up { d, a: s, by: 31 });
        self.out.push(Instruction::BlendBy { d, by: d, no: no_in, yes: yes_in });
        d
    }

    fn blend(&mut self, k: Reg, yes: usize, no: usize, all: &[usize]) -> Reg {
        let (no_in, yes_in) = self.blended(yes, no);
        self.release(all);
        let d = self.take();
        self.out.push(Instruction::Blend { d, k, no: no_in, yes: yes_in });
        d
    }

    /// The operands of a choice: the second one may lie in memory where an instruction reads no more than a number of it.
    fn blended(&mut self, yes: usize, no: usize) -> (Reg, Rm) {
        if self.target.is_single && !self.target.has_masks {
            self.ensure(yes);
        }
        (self.ensure(no), self.rm(yes))
    }

    /// A target that is none of the operands of a choice, while others may end.
    fn target_beside(&mut self, no: Reg, yes: Rm, all: &[usize]) -> Reg {
        self.release(all);
        self.pinned |= 1 << no;
        if let Rm::Reg(r) = yes {
            self.pinned |= 1 << r;
        }
        self.take()
    }

    fn flip(&mut self, a: usize, b: usize, c: usize) -> Reg {
        let (a_in, b_in, c_in) = (self.ensure(a), self.ensure(b), self.rm(c));
        let ends = self.next_use(a) == NEVER;
        self.release(&[a, b, c]);
        self.pinned |= 1 << a_in;
        if self.target.has_masks {
            if ends && a_in != b_in {
                self.out.push(Instruction::Flip { d: a_in, b: b_in, c: c_in });
                return a_in;
            }
            self.pinned |= 1 << b_in;
            if let Rm::Reg(r) = c_in {
                self.pinned |= 1 << r;
            }
            let d = self.take();
            self.out.push(Instruction::Move { d, s: a_in });
            self.out.push(Instruction::Flip { d, b: b_in, c: c_in });
            return d;
        }
        let d = self.take();
        self.out.push(Instruction::Two { what: Do::And, d, a: b_in, b: c_in });
        self.out.push(Instruction::Two { what: Do::Xor, d, a: d, b: Rm::Reg(a_in) });
        d
    }
}
