//! Which functions are called, and which are computed where they are called. Bits do not depend on it: fusions were decided inside.

use super::value::{CallOf, Callee, Instruction, InstructionKind, Op, Value, ValueForm};
use crate::fast_hash::QuickMap;
use std::collections::HashMap;
use std::sync::Arc;

/// A function of fewer instructions is computed where it is called: equal terms of its neighbours are one then.
const LONG: usize = 400;

/// Most instructions of a program of the interpreter without calls: a call copies arguments and results.
const MOST: usize = 1 << 18;

/// The program as machine code is made of it: what is short or called once is no call.
pub(super) fn with_long_functions(form: &Arc<ValueForm>) -> Arc<ValueForm> {
    Arranger::new(form, LONG).form(form)
}

/// Of text that shall be short: a function is computed where it is called only if a call would be as long.
const SHORT: usize = 40;

/// The program as text is made of it: what is written twice is a function.
pub(super) fn with_short_functions(form: &Arc<ValueForm>) -> Arc<ValueForm> {
    Arranger::new(form, SHORT).form(form)
}

/// The program as it is interpreted: without calls, unless that made it huge.
pub(super) fn with_few_calls(form: &Arc<ValueForm>) -> Arc<ValueForm> {
    let shortest = if form.n_flat(&mut HashMap::new()) > MOST { LONG } else { usize::MAX };
    Arranger::new(form, shortest).form(form)
}

/// Functions as they are run, by their addresses, and whether they stay functions.
type Stays = HashMap<*const ValueForm, (Arc<ValueForm>, bool)>;

struct Arranger {
    /// Instructions of the shortest function that stays one.
    shortest: usize,
    /// In how many places each is called, of the program and of all functions.
    n_site: HashMap<*const ValueForm, usize>,
    stays: Stays,
}

impl Arranger {
    fn new(form: &Arc<ValueForm>, shortest: usize) -> Self {
        let mut n_site = HashMap::new();
        let functions = form.functions();
        for function in functions.iter().chain([form]).flat_map(|caller| caller.called()) {
            *n_site.entry(Arc::as_ptr(function)).or_default() += 1;
        }
        Self { shortest, n_site, stays: HashMap::new() }
    }

    fn form(&mut self, form: &Arc<ValueForm>) -> Arc<ValueForm> {
        if !form.has_functions() {
            return form.clone();
        }
        for function in form.called() {
            let at = Arc::as_ptr(function);
            if !self.stays.contains_key(&at) {
                let own = self.form(function);
                let is_called = own.instructions.len() >= self.shortest && self.n_site[&at] > 1;
                self.stays.insert(at, (own, is_called));
            }
        }
        Arc::new(Flat::of(form, &self.stays))
    }
}

/// A program whose functions are put in its place, with equal instructions made once.
struct Flat<'a> {
    stays: &'a Stays,
    form: ValueForm,
    constants: QuickMap<u64, Value>,
    known: QuickMap<InstructionKind, Value>,
    /// Comparisons by their truth values.
    comparisons: QuickMap<Value, InstructionKind>,
    called: HashMap<CallOf, Value>,
}

impl<'a> Flat<'a> {
    fn of(form: &ValueForm, stays: &'a Stays) -> ValueForm {
        let mut all: Vec<u64> = form.constants.clone();
        for function in form.called() {
            if let (own, false) = &stays[&Arc::as_ptr(function)] {
                all.extend(&own.constants);
            }
        }
        let mut constants = QuickMap::default();
        all.retain(|bits| {
            let next = Value((form.n_input + constants.len()) as u32);
            *constants.entry(*bits).or_insert(next) == next
        });
        let n_value = form.n_input + all.len();
        let own = ValueForm {
            n_input: form.n_input,
            constants: all,
            instructions: Vec::new(),
            calls: Vec::new(),
            results: Vec::new(),
            n_value,
            tape: form.tape,
        };
        let mut flat = Self {
            stays,
            form: own,
            constants,
            known: QuickMap::default(),
            comparisons: QuickMap::default(),
            called: HashMap::new(),
        };
        let inputs: Vec<Value> = (0..form.n_input as u32).map(Value).collect();
        flat.form.results = flat.add(form, &inputs);
        flat.form.without_dead()
    }

    /// Appends what `form` does to `inputs`; its results.
    fn add(&mut self, form: &ValueForm, inputs: &[Value]) -> Vec<Value> {
        let mut place: Vec<Value> = Vec::with_capacity(form.n_value);
        place.extend(inputs);
        place.extend(form.constants.iter().map(|bits| self.constants[bits]));
        for instruction in &form.instructions {
            match instruction.action {
                InstructionKind::Op(op, operands) => {
                    let mut operands = operands.map(|value| place[value.index()]);
                    // what is not read does not tell instructions apart
                    let first = operands[0];
                    operands[op.n_operand()..].fill(first);
                    let action = self.without_truth(op, operands);
                    let n = op.n_result() as u32;
                    let first = self.known.get(&action).copied().unwrap_or_else(|| {
                        let first = self.form.next(n);
                        self.form.instructions.push(Instruction { action, first });
                        self.known.insert(action, first);
                        if op == Op::Less {
                            self.comparisons.insert(first, action);
                        }
                        first
                    });
                    place.extend((0..n).map(|k| Value(first.0 + k)));
                }
                InstructionKind::Call(number) => {
                    let CallOf { callee, operands } = &form.calls[number];
                    let operands: Vec<Value> = operands.iter().map(|value| place[value.index()]).collect();
                    let results = self.call(callee, operands);
                    place.extend(results);
                }
            }
        }
        form.results.iter().map(|value| place[value.index()]).collect()
    }

    /// A choice by a comparison is one instruction, to the same bits.
    fn without_truth(&self, op: Op, operands: [Value; 4]) -> InstructionKind {
        if op == Op::Select
            && let Some(InstructionKind::Op(Op::Less, [x, y, ..])) = self.comparisons.get(&operands[2])
        {
            return InstructionKind::Op(Op::SelectLess, [*x, *y, operands[0], operands[1]]);
        }
        InstructionKind::Op(op, operands)
    }

    fn call(&mut self, callee: &Callee, operands: Vec<Value>) -> Vec<Value> {
        let callee = match callee {
            Callee::Custom(_) => callee.clone(),
            Callee::Function(function) => match self.stays.get(&Arc::as_ptr(function)) {
                Some((own, false)) => return self.add(&own.clone(), &operands),
                Some((own, true)) => Callee::Function(own.clone()),
                // of a function that was put here: it is as it is run already
                None => callee.clone(),
            },
        };
        let n = callee.n_output() as u32;
        let call = CallOf { callee, operands };
        let first = self.called.get(&call).copied().unwrap_or_else(|| {
            let first = self.form.next(n);
            self.form.instructions.push(Instruction { action: InstructionKind::Call(self.form.calls.len()), first });
            self.form.calls.push(call.clone());
            self.called.insert(call, first);
            first
        });
        (0..n).map(|k| Value(first.0 + k)).collect()
    }
}

impl ValueForm {
    /// Recorded functions, a call each.
    fn called(&self) -> impl Iterator<Item = &Arc<Self>> {
        self.calls.iter().filter_map(|call| if let Callee::Function(form) = &call.callee { Some(form) } else { None })
    }

    fn has_functions(&self) -> bool {
        self.called().next().is_some()
    }

    /// Instructions without calls of functions.
    fn n_flat(&self, known: &mut HashMap<*const Self, usize>) -> usize {
        let mut n = self.instructions.len();
        for function in self.called() {
            let at = Arc::as_ptr(function);
            let own = known.get(&at).copied().unwrap_or_else(|| function.n_flat(known));
            known.insert(at, own);
            n = n.saturating_add(own);
        }
        n
    }

    /// The same results without what nobody reads.
    fn without_dead(&self) -> Self {
        let mut is_read = vec![false; self.n_value];
        self.results.iter().for_each(|value| is_read[value.index()] = true);
        let mut kept = Vec::new();
        for instruction in self.instructions.iter().rev() {
            let first = instruction.first.index();
            if is_read[first..first + self.n_result_of(instruction)].contains(&true) {
                self.operands(instruction).iter().for_each(|value| is_read[value.index()] = true);
                kept.push(*instruction);
            }
        }
        kept.reverse();
        Self { tape: self.tape, ..self.part(&kept, &[], &self.results) }
    }
}
