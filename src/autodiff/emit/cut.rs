//! Long programs in parts: what compiles in seconds in pieces takes compilers of devices minutes in one.
//!
//! Parts run one behind the other. What one leaves to later ones stands in an array `m` between them.

use crate::program::{Source, Value, ValueForm};
use std::collections::HashMap;

/// Instructions of a program that stays one.
const LONG: usize = 2000;

/// Instructions of a part.
const MOST: usize = 1000;

/// A part, with where it reads and writes.
pub(super) struct Part {
    pub form: ValueForm,
    pub places: [Vec<String>; 2],
}

/// Parts, and numbers that stand between them.
pub(super) struct Parts {
    pub parts: Vec<Part>,
    pub n_between: usize,
}

/// A program in parts, if it is long.
pub(super) fn parts(form: &ValueForm, inputs: &[String], results: &[String]) -> Option<Parts> {
    let n = form.instructions().len();
    if n <= LONG {
        return None;
    }
    let n_part = n.div_ceil(MOST);
    let each = n.div_ceil(n_part);
    Some(Cutter::new(form, inputs, results, each, n_part).run())
}

struct Cutter<'a> {
    form: &'a ValueForm,
    inputs: &'a [String],
    results: &'a [String],
    each: usize,
    n_part: usize,
    /// Per value, in which part it is computed and in which it is read last.
    made: Vec<usize>,
    last: Vec<usize>,
    /// Places between parts of values that are alive there.
    between: HashMap<usize, usize>,
    free: Vec<usize>,
    n_between: usize,
}

impl<'a> Cutter<'a> {
    fn new(form: &'a ValueForm, inputs: &'a [String], results: &'a [String], each: usize, n_part: usize) -> Self {
        let (mut made, mut last) = (vec![0; form.n_value()], vec![0; form.n_value()]);
        for (k, instruction) in form.instructions().iter().enumerate() {
            let part = k / each;
            let first = instruction.first.index();
            made[first..first + form.n_result_of(instruction)].fill(part);
            form.operands(instruction).iter().for_each(|value| last[value.index()] = part);
        }
        // what is passed on as it is is written at the end
        for value in form.results() {
            if form.source(*value) != Source::Computed {
                last[value.index()] = n_part - 1;
            }
        }
        let (between, free) = (HashMap::new(), Vec::new());
        Self { form, inputs, results, each, n_part, made, last, between, free, n_between: 0 }
    }

    /// The part that writes a result.
    fn writer(&self, value: Value) -> usize {
        if self.form.source(value) == Source::Computed { self.made[value.index()] } else { self.n_part - 1 }
    }

    fn run(mut self) -> Parts {
        // inputs whose place is written before they are read for the last time
        let places: HashMap<&String, usize> = self.inputs.iter().zip(0..).collect();
        let mut kept: Vec<usize> = Vec::new();
        for (value, place) in self.form.results().iter().zip(self.results) {
            if let Some(input) = places.get(place).filter(|input| self.last[**input] > self.writer(*value)) {
                kept.push(*input);
            }
        }
        kept.sort_unstable();
        kept.dedup();
        let parts = (0..self.n_part).map(|part| self.part(part, &kept)).collect();
        Parts { parts, n_between: self.n_between }
    }

    fn part(&mut self, part: usize, kept: &[usize]) -> Part {
        let form = self.form;
        let all = form.instructions();
        let own = &all[part * self.each..all.len().min((part + 1) * self.each)];
        let place = |slot: &usize| format!("m[{slot}]");
        // what comes in, from others and from places that are written by now
        let mut given: Vec<usize> = self.between.keys().copied().filter(|value| *value >= form.n_input()).collect();
        given.sort_unstable();
        let mut reads: Vec<String> =
            (0..form.n_input()).map(|k| self.between.get(&k).map_or_else(|| self.inputs[k].clone(), place)).collect();
        reads.extend(given.iter().map(|value| place(&self.between[value])));
        let mut over: Vec<usize> = self.between.keys().copied().filter(|value| self.last[*value] <= part).collect();
        over.sort_unstable();
        let over: Vec<usize> = over.iter().filter_map(|value| self.between.remove(value)).collect();
        let (mut values, mut writes) = (Vec::new(), Vec::new());
        for (value, place) in form.results().iter().zip(self.results) {
            if self.writer(*value) == part {
                values.push(*value);
                writes.push(place.clone());
            }
        }
        let leave = |own: &mut Self, value: usize, slot: usize, values: &mut Vec<Value>, writes: &mut Vec<String>| {
            own.between.insert(value, slot);
            values.push(Value(value as u32));
            writes.push(format!("m[{slot}]"));
        };
        if part == 0 {
            for input in kept {
                let slot = self.slots(1);
                leave(self, *input, slot, &mut values, &mut writes);
            }
        }
        for instruction in own {
            let first = instruction.first.index();
            let later: Vec<usize> =
                (first..first + form.n_result_of(instruction)).filter(|value| self.last[*value] > part).collect();
            // one behind the other, so that a tape stays one
            if !later.is_empty() {
                let slot = self.slots(later.len());
                later
                    .into_iter()
                    .zip(slot..)
                    .for_each(|(value, slot)| leave(self, value, slot, &mut values, &mut writes));
            }
        }
        // who is read for the last time gives its place up
        self.free.extend(over);
        let given: Vec<Value> = given.into_iter().map(|value| Value(value as u32)).collect();
        Part { form: form.part(own, &given, &values), places: [reads, writes] }
    }

    /// The first of so many places one behind the other.
    fn slots(&mut self, n: usize) -> usize {
        if n == 1
            && let Some(slot) = self.free.pop()
        {
            return slot;
        }
        self.n_between += n;
        self.n_between - n
    }
}
