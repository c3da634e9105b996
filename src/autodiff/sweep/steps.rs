//! Reverse sweeps along a rollout as machine code: weights of eight steps side by side, then one step after the other.

use super::Sweep;
use crate::columns::{LINE, Lines};
use crate::native::policy::MAX_SIDE_BY_SIDE;
use crate::native::{Code, Place, RowLayout, Rows, WhyInterpreted, code};
use crate::program::{Instruction, InstructionKind, Program, Source, Tape, Value, ValueForm};
use std::sync::Arc;

/// Machine code of a step's [x, u, θ], [λ⁺, 1] → [x̄, ū, θ̄].
#[derive(Debug)]
pub(crate) enum StepsCode {
    SideBySide {
        /// [x, u, θ] of eight steps → weights.
        weights: Code,
        n_weight: usize,
        /// Weights of a step, λ, sums, 0 and 1 → λ, ū, sums.
        pull: Code,
    },
    /// x, u, [θ, 0, 1], λ, sums → λ, ū, sums.
    OneByOne(Code),
}

/// Scratch of [`StepsCode`]; made once, reused without allocation.
#[derive(Debug, Clone)]
pub(crate) struct StepsCodeScratch {
    of: Arc<StepsCode>,
    weight_slots: Lines,
    slots: Lines,
    weights: Lines,
    /// θ, 0, 1.
    fixed: Vec<f64>,
}

/// λ of the state behind a step and then of that before it; ū; θ̄ is added to.
#[derive(Debug)]
pub(crate) struct Pulled<'a> {
    pub(crate) state: &'a mut [f64],
    pub(crate) input: &'a mut [f64],
    pub(crate) parameters: &'a mut [f64],
}

impl StepsCodeScratch {
    pub(crate) fn new(of: &Arc<StepsCode>, n_parameter: usize) -> Self {
        let mut fixed = vec![0.0; n_parameter];
        fixed.extend([0.0, 1.0]);
        let (weight_slots, slots, n_weight) = match &**of {
            StepsCode::SideBySide { weights, n_weight, pull } => (weights.slots(), pull.slots(), *n_weight),
            StepsCode::OneByOne(code) => (Lines::default(), code.slots(), 0),
        };
        Self { weight_slots, slots, weights: Lines::zeros(n_weight), fixed, of: of.clone() }
    }

    /// Whether it is that of `code`.
    pub(crate) fn is_of(&self, code: &Arc<StepsCode>) -> bool {
        Arc::ptr_eq(&self.of, code)
    }

    /// Numbers held.
    pub(crate) fn len(&self) -> usize {
        LINE * (self.weight_slots.len() + self.slots.len() + self.weights.len()) + self.fixed.len()
    }

    pub(crate) fn write_parameters(&mut self, theta: &[f64]) {
        self.fixed[..theta.len()].copy_from_slice(theta);
    }

    /// Whether weights of eight steps are made at once, by [`evaluate`](Self::evaluate).
    pub(crate) fn is_side_by_side(&self) -> bool {
        matches!(&*self.of, StepsCode::SideBySide { .. })
    }

    /// As [`Sweep::evaluate_steps`].
    pub(crate) fn evaluate(&mut self, points: &[[f64; LINE]]) {
        if let StepsCode::SideBySide { weights, .. } = &*self.of {
            let arrays = &mut [Rows::Read(points), Rows::Write(&mut self.weights)];
            assert!(weights.run(&mut self.weight_slots, arrays, LINE), "points of the steps");
        }
    }

    /// Through step `step` of those that were evaluated last, which went from x with u.
    pub(crate) fn pull(&mut self, step: usize, x: &[f64], u: &[f64], pulled: Pulled<'_>) {
        let Pulled { state, input, parameters } = pulled;
        let [state, input, parameters] = [state, input, parameters].map(Rows::Write);
        let fixed = Rows::Read(&self.fixed[..]);
        let is_run = match &*self.of {
            StepsCode::SideBySide { pull, .. } => {
                // number `step` of each row
                let weights = self.weights.as_flattened();
                let own = Rows::Read(&weights[(step % LINE).min(weights.len())..]);
                pull.run(&mut self.slots, &mut [own, fixed, parameters, state, input], 1)
            }
            StepsCode::OneByOne(code) => {
                let arrays = &mut [Rows::Read(x), fixed, parameters, state, input, Rows::Read(u)];
                code.run(&mut self.slots, arrays, 1)
            }
        };
        assert!(is_run, "lengths of a step");
    }
}

impl StepsCode {
    /// Of the sweep of a step whose results are n states and a cost, and whose inputs are as many states, commands, parameters.
    pub(crate) fn new(sweep: &Sweep, sizes: [usize; 3]) -> Result<Arc<Self>, WhyInterpreted> {
        let [n, m, p] = sizes;
        assert_eq!((sweep.n_result, sweep.n_input), (n + 1, n + m + p), "results and inputs of a step");
        let made = if sweep.len() > MAX_SIDE_BY_SIDE { one_by_one(sweep, sizes) } else { side_by_side(sweep, sizes) };
        made.map(Arc::new)
    }
}

fn rows(array: u8, n: usize) -> impl Iterator<Item = Place> {
    (0..n as u32).map(move |row| Place { array, row })
}

/// Array 2 has the sums over θ, 3 is λ, 4 is ū.
fn layout(arguments: impl Iterator<Item = Place>, [n, m, p]: [usize; 3]) -> Result<RowLayout, WhyInterpreted> {
    let results = rows(3, n).chain(rows(4, m)).chain(rows(2, p));
    let layout = RowLayout::new(arguments.collect(), results.collect()).map_err(|_| WhyInterpreted::TooLarge)?;
    Ok(layout)
}

fn one_by_one(sweep: &Sweep, sizes: [usize; 3]) -> Result<StepsCode, WhyInterpreted> {
    let [n, m, p] = sizes;
    let mut recording = sweep.weights.clone();
    let first = recording.n_input;
    recording.n_input += n + p + 2;
    let mut form = Program::code_form(&recording).map_err(|_| WhyInterpreted::TooLarge)?;
    let weights = std::mem::take(&mut form.results);
    let n_before = form.instructions.len();
    append_sweep(sweep, &mut form, &weights, Ends::from(first, n, p));
    let form = as_late_as_possible(form, n_before);
    let point = rows(0, n).chain(rows(5, m)).chain(rows(1, p));
    let constants = (p..p + 2).map(|row| Place { array: 1, row: row as u32 });
    let layout = layout(point.chain(rows(3, n)).chain(rows(2, p)).chain(constants), sizes)?;
    Ok(StepsCode::OneByOne(code::<f64>(&Arc::new(form), &layout)?))
}

fn side_by_side(sweep: &Sweep, sizes: [usize; 3]) -> Result<StepsCode, WhyInterpreted> {
    let [n, _, p] = sizes;
    let mut weights = sweep.values.value_form().clone();
    // constants among the weights are known to both codes
    let (mut varying, mut constants) = (Vec::new(), Vec::new());
    let places: Vec<Result<usize, usize>> = (weights.results().iter())
        .map(|weight| match weights.source(*weight) {
            Source::Constant(constant) => {
                constants.push(constant.to_bits());
                Err(constants.len() - 1)
            }
            _ => {
                varying.push(*weight);
                Ok(varying.len() - 1)
            }
        })
        .collect();
    let n_weight = varying.len();
    let (n_input, n_constant) = (n_weight + n + p + 2, constants.len());
    let place = |weight: &Result<usize, usize>| Value(weight.map_or_else(|k| n_input + k, |row| row) as u32);
    let places: Vec<Value> = places.iter().map(place).collect();
    let n_value = n_input + n_constant;
    let (instructions, calls, results) = (Vec::new(), Vec::new(), Vec::new());
    let mut pull = ValueForm { n_input, constants, instructions, calls, results, n_value, tape: Tape::None };
    append_sweep(sweep, &mut pull, &places, Ends::from(n_weight, n, p));
    weights.results = varying;
    let own = (0..n_weight).map(|row| Place { array: 0, row: (LINE * row) as u32 });
    let constants = (p..p + 2).map(|row| Place { array: 1, row: row as u32 });
    let layout = layout(own.chain(rows(3, n)).chain(rows(2, p)).chain(constants), sizes)?;
    let apart = RowLayout::apart(weights.n_input, n_weight);
    let weights = code::<[f64; LINE]>(&Arc::new(weights), &apart)?;
    Ok(StepsCode::SideBySide { weights, n_weight, pull: code::<f64>(&Arc::new(pull), &layout)? })
}

/// Inputs of a form behind its own: λ, sums over θ, 0, 1.
struct Ends {
    state: u32,
    parameters: u32,
    zero: Value,
    one: Value,
}

impl Ends {
    fn from(first: usize, n: usize, p: usize) -> Self {
        let at = |k: usize| (first + k) as u32;
        Self { state: at(0), parameters: at(n), zero: Value(at(n + p)), one: Value(at(n + p + 1)) }
    }

    /// Of a step's result: λ of a state, 1 of the cost.
    fn seed(&self, result: u32) -> Value {
        let state = Value(self.state + result);
        if state.0 < self.parameters { state } else { self.one }
    }
}

/// The sweep behind the instructions of `form`, whose results become x̄, ū and sums with θ̄.
fn append_sweep(sweep: &Sweep, form: &mut ValueForm, weights: &[Value], ends: Ends) {
    let mut slots: Vec<Option<Value>> = vec![None; sweep.n_slot];
    slots.iter_mut().zip(&sweep.rows).for_each(|(slot, row)| *slot = Some(ends.seed(*row)));
    let mut edges = sweep.edges.by_number.iter();
    for sum in &sweep.sums {
        let mut total = None;
        for edge in edges.by_ref().take(sum.n_edge as usize) {
            if let Some(from) = slots[edge.from()] {
                total = Some(form.add_product(total, weights[edge.weight()], from));
            }
        }
        slots[sum.target as usize] = total;
    }
    let mut inputs = slots[sweep.rows.len()..sweep.rows.len() + sweep.n_input].to_vec();
    for d in &sweep.direct {
        let total = &mut inputs[d.input as usize];
        *total = Some(form.add_product(*total, weights[usize::from(d.weight)], ends.seed(d.result)));
    }
    let n_before = sweep.n_input - (ends.zero.0 - ends.parameters) as usize;
    for (k, total) in inputs.into_iter().enumerate() {
        // sums of the sweep begin with 0, which turns −0 into 0
        let own = total.map_or(ends.zero, |total| form.sum(total, ends.zero));
        let parameter = k.checked_sub(n_before).map(|k| Value(ends.parameters + k as u32));
        let result = parameter.map_or(own, |sum| form.sum(sum, own));
        form.results.push(result);
    }
}

/// With instructions up to `n_before` moved to just before the first behind those that needs them: a weight then waits in a register.
fn as_late_as_possible(form: ValueForm, n_before: usize) -> ValueForm {
    let mut order: Vec<u32> = Vec::with_capacity(form.instructions.len());
    let mut maker = vec![None; form.n_value];
    for (k, instruction) in form.instructions.iter().enumerate() {
        let first = instruction.first.index();
        maker[first..first + form.n_result_of(instruction)].fill(Some(k as u32));
    }
    let mut is_done = vec![false; form.instructions.len()];
    // instructions, and how many of their operands are made
    let mut open: Vec<(u32, usize)> = Vec::new();
    for last in n_before..form.instructions.len() {
        open.push((last as u32, 0));
        while let Some((k, n_made)) = open.pop() {
            if is_done[k as usize] {
                continue;
            }
            match form.operands(&form.instructions[k as usize]).get(n_made) {
                Some(operand) => {
                    open.push((k, n_made + 1));
                    open.extend(maker[operand.index()].map(|made| (made, 0)));
                }
                None => {
                    is_done[k as usize] = true;
                    order.push(k);
                }
            }
        }
    }
    in_order(form, &order)
}

/// Some of the instructions, in this order.
fn in_order(form: ValueForm, order: &[u32]) -> ValueForm {
    let mut place: Vec<Value> = (0..form.n_value as u32).map(Value).collect();
    let mut moved =
        ValueForm { instructions: Vec::with_capacity(order.len()), n_value: form.first_computed(), ..form.clone() };
    for k in order {
        let Instruction { action: InstructionKind::Op(op, operands), first } = form.instructions[*k as usize] else {
            return form; // a sweep calls nothing
        };
        let n = op.n_result() as u32;
        let own = moved.next(n);
        (0..n).for_each(|k| place[first.index() + k as usize] = Value(own.0 + k));
        let operands = operands.map(|value| place[value.index()]);
        moved.instructions.push(Instruction { action: InstructionKind::Op(op, operands), first: own });
    }
    moved.results.iter_mut().for_each(|result| *result = place[result.index()]);
    moved
}
