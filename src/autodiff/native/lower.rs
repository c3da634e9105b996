//! From the operations of a program to those of a processor: elementary functions of `f32` become the polynomials of the lanes, those
//! of `f64` calls; minima and maxima are found in selections; equal terms are computed once, and what nobody reads not at all.

use super::MAX_STEPS;
use crate::custom::Operation;
use crate::fast_hash::QuickMap;
use crate::polynomials::*;
use crate::program::{self, InstructionKind, Op, Source, Tape, Value, ValueForm};
use std::f64::consts::{FRAC_2_PI, FRAC_PI_2, FRAC_PI_4, LOG2_E, PI};
use std::sync::Arc;

/// Numbers of a machine program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Element {
    F32,
    F64,
}

/// What a step reads: an input, a constant or an earlier step, and which.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Operand(u32);

const TAG: u32 = 3 << 30;
const CONSTANT: u32 = 1 << 30;
const STEP: u32 = 2 << 30;

/// An [`Operand`] taken apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Of {
    Input(usize),
    Constant(usize),
    Step(usize),
}

impl Operand {
    pub(super) fn input(k: usize) -> Self {
        Self(k as u32)
    }
    pub(super) fn step(k: usize) -> Self {
        Self(k as u32 | STEP)
    }
    fn constant(k: usize) -> Self {
        Self(k as u32 | CONSTANT)
    }
    pub(super) fn of(self) -> Of {
        let k = (self.0 & !TAG) as usize;
        match self.0 & TAG {
            0 => Of::Input(k),
            CONSTANT => Of::Constant(k),
            _ => Of::Step(k),
        }
    }
}

/// What a processor does to its operands a, b, c, d in one or two instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Do {
    Add,
    Sub,
    Mul,
    Div,
    /// a where a < b, else b.
    Min,
    /// a where a > b, else b.
    Max,
    Sqrt,
    /// a·b + c in one rounding.
    MulAdd,
    /// c − a·b in one rounding.
    NegMulAdd,
    /// a·b − c in one rounding.
    MulSub,
    /// The bits that differ.
    Xor,
    /// The bits that both have.
    And,
    /// Sum of the bits as integers.
    AddBits,
    /// Bits moved up.
    Up(u8),
    /// Bits moved down.
    Down(u8),
    /// 1 where a < b, else 0.
    Less,
    /// c where a < b, else d.
    SelectLess,
    /// b where the lowest bit of a is set, else c.
    SelectOdd,
    /// a with the bits changed that b and c both have.
    Flip,
    /// A copy, of an input that a result is written over.
    Copy,
    /// The call of this number is made; it reads its operands from the list of calls.
    Call(u32),
    /// A result of the last call.
    Result(u32),
}

impl Do {
    pub(super) const fn n_operand(self) -> usize {
        match self {
            Do::Call(_) | Do::Result(_) => 0,
            Do::Sqrt | Do::Up(_) | Do::Down(_) | Do::Copy => 1,
            Do::MulAdd | Do::NegMulAdd | Do::MulSub | Do::SelectOdd | Do::Flip => 3,
            Do::SelectLess => 4,
            _ => 2,
        }
    }
}

/// An operation on the first [`n_operand`](Do::n_operand) operands; the others are 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Step {
    pub(super) what: Do,
    operands: [Operand; 4],
}

impl Step {
    pub(super) fn new(what: Do, list: &[Operand]) -> Self {
        let mut operands = [Operand(0); 4];
        operands[..list.len()].copy_from_slice(list);
        Self { what, operands }
    }
    pub(super) fn operands(&self) -> &[Operand] {
        &self.operands[..self.what.n_operand()]
    }
}

/// What is called.
#[derive(Debug, Clone)]
pub(super) enum Callee {
    /// An elementary function of `f64`.
    Elementary(Op),
    Custom(Operation),
    /// A function of the program, by its number, and how many results it has.
    Function(u32, usize),
}

impl Callee {
    pub(super) fn n_output(&self) -> usize {
        match self {
            Self::Elementary(op) => op.n_result(),
            Self::Custom(operation) => operation.n_output(),
            Self::Function(_, n) => *n,
        }
    }
}

/// A call and what it reads.
#[derive(Debug, Clone)]
pub(super) struct CallSite {
    pub(super) callee: Callee,
    pub(super) operands: Vec<Operand>,
}

/// A program in operations of a processor.
#[derive(Debug, Clone)]
pub(super) struct Lowered {
    pub(super) element: Element,
    pub(super) n_input: usize,
    /// Bits; of `f32` in the low half.
    pub(super) constants: Vec<u64>,
    pub(super) steps: Vec<Step>,
    pub(super) calls: Vec<CallSite>,
    pub(super) results: Vec<Operand>,
    pub(super) tape: Tape,
}

/// Lowers a program and the functions that it calls, behind it by their numbers; unless they have more than `MAX_STEPS`.
pub(super) fn lower(form: &ValueForm, element: Element) -> Option<Vec<Lowered>> {
    let functions = form.functions();
    let mut n_step = 0;
    let all = [form].into_iter().chain(functions.iter().map(|function| &**function));
    all.map(|form| {
        let lowered = lower_one(form, &functions, element, MAX_STEPS - n_step)?;
        n_step += lowered.steps.len();
        (n_step <= MAX_STEPS).then_some(lowered)
    })
    .collect()
}

fn lower_one(form: &ValueForm, functions: &[Arc<ValueForm>], element: Element, n_most: usize) -> Option<Lowered> {
    let lowered = Lowered {
        element,
        n_input: form.n_input(),
        constants: Vec::new(),
        steps: Vec::with_capacity(form.instructions().len() * 5 / 4),
        calls: Vec::new(),
        results: Vec::new(),
        tape: form.tape,
    };
    let mut lowering = Lowering {
        to: lowered,
        functions,
        numbers: QuickMap::default(),
        known: QuickMap::default(),
        is_less: QuickMap::default(),
    };
    lowering.run(form, n_most)?;
    Some(lowering.to.without_dead_steps())
}

struct Lowering<'a> {
    to: Lowered,
    functions: &'a [Arc<ValueForm>],
    /// Constants by their bits.
    numbers: QuickMap<u64, Operand>,
    /// Steps without side effects.
    known: QuickMap<Step, Operand>,
    /// (a, b) of the truth values that say whether a < b.
    is_less: QuickMap<Operand, (Operand, Operand)>,
}

impl Lowering<'_> {
    fn run(&mut self, form: &ValueForm, n_most: usize) -> Option<()> {
        let mut place: Vec<Operand> = Vec::with_capacity(form.n_value());
        place.extend((0..form.n_input()).map(Operand::input));
        for value in (form.n_input()..form.first_computed()).map(|k| Value(k as u32)) {
            let Source::Constant(number) = form.source(value) else { continue };
            place.push(self.number(number));
        }
        for instruction in form.instructions() {
            if self.to.steps.len() > n_most {
                return None;
            }
            match instruction.action {
                InstructionKind::Op(op, operands) => {
                    let operands = operands.map(|value| place[value.index()]);
                    self.op(op, operands, &mut place);
                }
                InstructionKind::Call(number) => {
                    let call = &form.calls()[number];
                    let operands = call.operands.iter().map(|value| place[value.index()]).collect();
                    let callee = match &call.callee {
                        program::Callee::Custom(operation) => Callee::Custom(operation.clone()),
                        program::Callee::Function(form) => {
                            let number = self.functions.iter().position(|own| Arc::ptr_eq(own, form))?;
                            Callee::Function(number as u32, form.results().len())
                        }
                    };
                    self.call(callee, operands, &mut place);
                }
            }
        }
        self.to.results = form.results().iter().map(|value| place[value.index()]).collect();
        Some(())
    }

    /// Makes a call and appends its results.
    fn call(&mut self, callee: Callee, operands: Vec<Operand>, place: &mut Vec<Operand>) {
        let n = callee.n_output() as u32;
        self.append(Step::new(Do::Call(self.to.calls.len() as u32), &[]));
        self.to.calls.push(CallSite { callee, operands });
        place.extend((0..n).map(|k| self.append(Step::new(Do::Result(k), &[]))));
    }

    fn append(&mut self, step: Step) -> Operand {
        self.to.steps.push(step);
        Operand::step(self.to.steps.len() - 1)
    }

    /// The step, or the one before that computes the same.
    fn step(&mut self, what: Do, operands: &[Operand]) -> Operand {
        let step = Step::new(what, operands);
        let next = Operand::step(self.to.steps.len());
        let found = *self.known.entry(step).or_insert(next);
        if found == next {
            self.to.steps.push(step);
        }
        found
    }

    fn bits(&mut self, bits: u64) -> Operand {
        let next = Operand::constant(self.to.constants.len());
        let found = *self.numbers.entry(bits).or_insert(next);
        if found == next {
            self.to.constants.push(bits);
        }
        found
    }

    fn number(&mut self, number: f64) -> Operand {
        self.bits(match self.to.element {
            Element::F32 => u64::from((number as f32).to_bits()),
            Element::F64 => number.to_bits(),
        })
    }

    fn add(&mut self, a: Operand, b: Operand) -> Operand {
        self.step(Do::Add, &[a, b])
    }
    fn sub(&mut self, a: Operand, b: Operand) -> Operand {
        self.step(Do::Sub, &[a, b])
    }
    fn mul(&mut self, a: Operand, b: Operand) -> Operand {
        self.step(Do::Mul, &[a, b])
    }

    /// −0 − a, which is −a also for zeros.
    fn neg(&mut self, a: Operand) -> Operand {
        let zero = self.number(-0.0);
        self.sub(zero, a)
    }

    /// a·b + c: fused in `f32` alone, as in lanes.
    fn mul_add(&mut self, a: Operand, b: Operand, c: Operand) -> Operand {
        self.product_and(Do::MulAdd, a, b, c)
    }

    /// c − a·b
    fn neg_mul_add(&mut self, a: Operand, b: Operand, c: Operand) -> Operand {
        self.product_and(Do::NegMulAdd, a, b, c)
    }

    fn product_and(&mut self, what: Do, a: Operand, b: Operand, c: Operand) -> Operand {
        if self.to.element == Element::F32 {
            return self.step(what, &[a, b, c]);
        }
        let product = self.mul(a, b);
        match what {
            Do::MulAdd => self.add(product, c),
            Do::MulSub => self.sub(product, c),
            _ => self.sub(c, product),
        }
    }

    /// c where a < b, else d.
    fn select_less(&mut self, a: Operand, b: Operand, c: Operand, d: Operand) -> Operand {
        if (c, d) == (a, b) {
            self.step(Do::Min, &[a, b])
        } else if (c, d) == (b, a) {
            self.step(Do::Max, &[b, a])
        } else {
            self.step(Do::SelectLess, &[a, b, c, d])
        }
    }

    /// a where the truth value holds, else b.
    fn select(&mut self, truth: Operand, a: Operand, b: Operand) -> Operand {
        if let Some((x, y)) = self.is_less.get(&truth).copied() {
            return self.select_less(x, y, a, b);
        }
        let half = self.number(0.5);
        self.select_less(half, truth, a, b)
    }

    fn polynomial(&mut self, x: Operand, coefficients: &[f64]) -> Operand {
        let mut sum = self.number(coefficients[0]);
        for coefficient in &coefficients[1..] {
            let coefficient = self.number(*coefficient);
            sum = self.mul_add(sum, x, coefficient);
        }
        sum
    }

    fn abs(&mut self, x: Operand) -> Operand {
        let mask = self.bits(0x7FFF_FFFF);
        self.step(Do::And, &[x, mask])
    }

    /// Appends the results of an operation.
    fn op(&mut self, op: Op, [a, b, c, d]: [Operand; 4], place: &mut Vec<Operand>) {
        let one = |lowering: &mut Self| lowering.number(1.0);
        let result = match op {
            Op::Add => self.add(a, b),
            Op::Sub => self.sub(a, b),
            Op::Mul | Op::And => self.mul(a, b),
            Op::Div => self.step(Do::Div, &[a, b]),
            Op::Neg => self.neg(a),
            Op::Recip => {
                let one = one(self);
                self.step(Do::Div, &[one, a])
            }
            Op::Sqrt => self.step(Do::Sqrt, &[a]),
            Op::MulAdd => self.mul_add(a, b, c),
            Op::NegMulAdd => self.neg_mul_add(a, b, c),
            Op::MulSub => self.product_and(Do::MulSub, a, b, c),
            Op::TwoProducts => {
                let second = self.mul(c, d);
                self.mul_add(a, b, second)
            }
            Op::ProductDifference => {
                let second = self.mul(c, d);
                self.neg_mul_add(a, b, second)
            }
            Op::Less => {
                one(self); // read by the instruction
                let truth = self.step(Do::Less, &[a, b]);
                self.is_less.insert(truth, (a, b));
                truth
            }
            Op::Or => self.select_less(a, b, b, a),
            Op::Not => {
                let one = one(self);
                self.sub(one, a)
            }
            Op::Select => self.select(c, a, b),
            Op::SelectLess => self.select_less(a, b, c, d),
            Op::SinCos | Op::Exp | Op::Ln | Op::Tanh | Op::Atan2 if self.to.element == Element::F64 => {
                return self.call(Callee::Elementary(op), [a, b][..op.n_operand()].to_vec(), place);
            }
            Op::SinCos => return place.extend(self.sin_cos(a)),
            Op::Exp => self.exp(a),
            Op::Ln => self.ln(a),
            Op::Tanh => self.tanh(a),
            Op::Atan2 => self.atan2(a, b),
        };
        place.push(result);
    }

    fn sin_cos(&mut self, x: Operand) -> [Operand; 2] {
        let (scale, round) = (self.number(FRAC_2_PI), self.number(ROUND));
        let quotient = self.mul(x, scale);
        let shifted = self.add(quotient, round);
        let k = self.sub(shifted, round);
        let r = self.reduced(x, k, HALF_PI);
        let z = self.mul(r, r);
        let (s, rz) = (self.polynomial(z, &SINE), self.mul(r, z));
        let s = self.mul_add(rz, s, r);
        let (q, zz) = (self.polynomial(z, &COSINE), self.mul(z, z));
        let (half, one) = (self.number(0.5), self.number(1.0));
        let rest = self.neg_mul_add(z, half, one);
        let q = self.mul_add(zz, q, rest);
        let sine = self.step(Do::SelectOdd, &[shifted, q, s]);
        let cosine = self.step(Do::SelectOdd, &[shifted, s, q]);
        let (least, top) = (self.bits(1), self.bits(1 << 31));
        let next = self.step(Do::AddBits, &[shifted, least]);
        let (sine_sign, cosine_sign) = (self.step(Do::Up(30), &[shifted]), self.step(Do::Up(30), &[next]));
        [self.step(Do::Flip, &[sine, sine_sign, top]), self.step(Do::Flip, &[cosine, cosine_sign, top])]
    }

    /// x − k·period, the period in two parts.
    fn reduced(&mut self, x: Operand, k: Operand, period: [f64; 2]) -> Operand {
        let [coarse, fine] = period.map(|part| self.number(part));
        let r = self.neg_mul_add(k, coarse, x);
        self.neg_mul_add(k, fine, r)
    }

    fn exp(&mut self, x: Operand) -> Operand {
        let [low, high] = EXP_RANGE.map(|end| self.number(end));
        let x = self.select_less(x, low, low, x);
        let x = self.select_less(high, x, high, x);
        let (scale, round) = (self.number(LOG2_E), self.number(ROUND));
        let shifted = self.mul_add(x, scale, round);
        let k = self.sub(shifted, round);
        let r = self.reduced(x, k, LN_2);
        let (p, rr) = (self.polynomial(r, &EXP), self.mul(r, r));
        let (p, one) = (self.mul_add(rr, p, r), self.number(1.0));
        let p = self.add(p, one);
        let (power, bias) = (self.step(Do::Up(23), &[shifted]), self.bits(0x3F80_0000));
        let power = self.step(Do::AddBits, &[power, bias]);
        self.mul(p, power)
    }

    fn ln(&mut self, number: Operand) -> Operand {
        let to_root = self.bits(u64::from(0x3F80_0000 - SQRT_HALF));
        let shifted = self.step(Do::AddBits, &[number, to_root]);
        let (exponent, round) = (self.step(Do::Down(23), &[shifted]), self.bits(0x4B40_0000));
        let exponent = self.step(Do::AddBits, &[exponent, round]);
        let bias = self.number(ROUND + 127.0);
        let exponent = self.sub(exponent, bias);
        let (mantissa, root) = (self.bits(0x007F_FFFF), self.bits(u64::from(SQRT_HALF)));
        let mantissa = self.step(Do::And, &[shifted, mantissa]);
        let mantissa = self.step(Do::AddBits, &[mantissa, root]);
        let one = self.number(1.0);
        let x = self.sub(mantissa, one);
        let (p, z) = (self.polynomial(x, &LN), self.mul(x, x));
        let (xz, fine) = (self.mul(x, z), self.number(LN_2[1]));
        let fine = self.mul(exponent, fine);
        let (y, minus_half) = (self.mul_add(xz, p, fine), self.number(-0.5));
        let y = self.mul_add(z, minus_half, y);
        let (sum, coarse) = (self.add(x, y), self.number(LN_2[0]));
        let logarithm = self.mul_add(exponent, coarse, sum);
        let (zero, nan) = (self.number(0.0), self.number(f64::NAN));
        self.select_less(zero, number, logarithm, nan)
    }

    fn tanh(&mut self, x: Operand) -> Operand {
        let z = self.mul(x, x);
        let (p, xz) = (self.polynomial(z, &TANH), self.mul(x, z));
        let (small, size) = (self.mul_add(xz, p, x), self.abs(x));
        let (zero, one, two) = (self.number(0.0), self.number(1.0), self.number(2.0));
        let twice = self.add(size, size);
        let power = self.exp(twice);
        let power = self.add(power, one);
        let inverse = self.step(Do::Div, &[one, power]);
        let inverse = self.mul(two, inverse);
        let large = self.sub(one, inverse);
        let negative = self.neg(large);
        let (large, limit) = (self.select_less(x, zero, negative, large), self.number(TANH_SMALL));
        self.select_less(size, limit, small, large)
    }

    fn atan2(&mut self, y: Operand, x: Operand) -> Operand {
        let (ay, ax) = (self.abs(y), self.abs(x));
        let low = self.select_less(ax, ay, ax, ay);
        let high = self.select_less(ax, ay, ay, ax);
        let (least, zero, one) = (self.number(ATAN_LEAST), self.number(0.0), self.number(1.0));
        let high = self.select_less(high, least, least, high);
        let inverse = self.step(Do::Div, &[one, high]);
        let (t, fold) = (self.mul(low, inverse), self.number(ATAN_FOLD));
        let (below, above) = (self.sub(t, one), self.add(t, one));
        let inverse = self.step(Do::Div, &[one, above]);
        let folded = self.mul(below, inverse);
        let r = self.select_less(fold, t, folded, t);
        let z = self.mul(r, r);
        let (p, rz) = (self.polynomial(z, &ATAN), self.mul(r, z));
        let (angle, eighth) = (self.mul_add(rz, p, r), self.number(FRAC_PI_4));
        let unfolded = self.add(angle, eighth);
        let (angle, quarter) = (self.select_less(fold, t, unfolded, angle), self.number(FRAC_PI_2));
        let steep = self.sub(quarter, angle);
        let (angle, half) = (self.select_less(ax, ay, steep, angle), self.number(PI));
        let backward = self.sub(half, angle);
        let angle = self.select_less(x, zero, backward, angle);
        let negative = self.neg(angle);
        self.select_less(y, zero, negative, angle)
    }
}

impl Lowered {
    /// Numbers that a function takes and gives, but for those on tapes.
    pub(super) fn n_passed(&self) -> usize {
        self.n_input + self.results.len() - self.tape.n_input() - self.tape.n_result()
    }

    /// The constant of these bits. What reads one has put it there.
    fn constant(&self, bits: u64) -> usize {
        self.constants.iter().position(|own| *own == bits).unwrap_or(0)
    }

    /// The constant 1.
    pub(super) fn one(&self) -> usize {
        self.constant(match self.element {
            Element::F32 => u64::from(1.0_f32.to_bits()),
            Element::F64 => 1.0_f64.to_bits(),
        })
    }

    /// The constant whose lowest bit alone is set.
    pub(super) fn lowest_bit(&self) -> usize {
        self.constant(1)
    }

    fn without_dead_steps(mut self) -> Self {
        let mut needed = vec![false; self.steps.len()];
        let mark = |needed: &mut [bool], operands: &[Operand]| {
            for operand in operands {
                if let Of::Step(k) = operand.of() {
                    needed[k] = true;
                }
            }
        };
        mark(&mut needed, &self.results);
        for k in (0..self.steps.len()).rev() {
            if let Do::Call(number) = self.steps[k].what {
                needed[k] = true;
                mark(&mut needed, &self.calls[number as usize].operands);
            } else if needed[k] {
                mark(&mut needed, self.steps[k].operands());
            }
        }
        let mut place = vec![Operand(0); self.steps.len()];
        let renamed =
            |place: &[Operand], operand: Operand| if let Of::Step(k) = operand.of() { place[k] } else { operand };
        let mut kept = 0;
        for k in (0..self.steps.len()).filter(|k| needed[*k]) {
            let Step { what, operands } = self.steps[k];
            place[k] = Operand::step(kept);
            self.steps[kept] = Step { what, operands: operands.map(|operand| renamed(&place, operand)) };
            kept += 1;
        }
        self.steps.truncate(kept);
        self.calls
            .iter_mut()
            .flat_map(|call| &mut call.operands)
            .for_each(|operand| *operand = renamed(&place, *operand));
        self.results.iter_mut().for_each(|operand| *operand = renamed(&place, *operand));
        self
    }
}
