//! How a program is run: instructions of one kind stand together, and nearly all are of one kind.
//!
//! A jump that depends on data costs more than the instruction behind it: processors forget where hundreds of them lead. Nine tenths
//! of a program are sums and products, and each of those is ±a·b + c·d for some constants 1, −1 and −0 among a to d, to the bit:
//! x·1 = x and x + (−0) = x. So one loop without a jump runs them all: in `f64` here, over eight steps side by side ([`LINE`]) in
//! lanes that round as `f64` does, and over blocks of environments in `block.rs`, where ±a·b is not rounded.

use super::{Op, Placed, Storage, apply};
use crate::columns::LINE;
use crate::lanes::{Kernel, Lanes, dispatch};
use std::hint::select_unpredictable;

/// Instructions in order, grouped.
#[derive(Debug, Clone)]
pub(super) enum Run {
    Sums(Vec<Sum>),
    /// `target` = c where a < b, else d.
    Selects(Vec<Placed>),
    Other(Placed),
}

/// `target` = ±a·b + c·d. Packed: loads are what the loop waits for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sum {
    /// Slots of a and b, of c and d, the first in the low half.
    products: [u64; 2],
    /// The sign bit for −, whether d is 1, and in the low half the slot of the result.
    target: u64,
}

/// Set in [`Sum::target`] where d is 1.
const SHORT: u64 = 1 << 32;

/// Slots of the constants that sums are filled up with, behind those of the program.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neutral {
    one: u32,
    minus_one: u32,
    /// −0: 0 would turn −0 into 0.
    zero: u32,
}

impl Neutral {
    pub(super) fn behind(n_slot: u32) -> Self {
        Self { one: n_slot, minus_one: n_slot + 1, zero: n_slot + 2 }
    }

    /// Slots with these.
    pub(super) fn n_slot(self) -> usize {
        self.zero as usize + 1
    }

    pub(super) fn values(self) -> [(u32, f64); 3] {
        [(self.one, 1.0), (self.minus_one, -1.0), (self.zero, -0.0)]
    }
}

impl Sum {
    fn of(i: &Placed, n: Neutral) -> Option<Self> {
        let Neutral { one, minus_one, zero } = n;
        let Placed { op, target, a, b, c, d } = *i;
        let (operands, is_minus) = match op {
            Op::Add => ([a, one, b, one], false),
            Op::Sub => ([b, one, a, one], true),
            Op::Mul => ([a, b, zero, one], false),
            Op::Neg => ([a, one, zero, one], true),
            Op::MulAdd => ([a, b, c, one], false),
            Op::NegMulAdd => ([a, b, c, one], true),
            Op::MulSub => ([a, b, c, minus_one], false),
            Op::TwoProducts => ([a, b, c, d], false),
            Op::ProductDifference => ([a, b, c, d], true),
            _ => return None,
        };
        let pair = |first: u32, second: u32| u64::from(first) | u64::from(second) << 32;
        let [a, b, c, d] = operands;
        let products = [pair(a, b), pair(c, d)];
        let short = if d == one { SHORT } else { 0 };
        Some(Self { products, target: u64::from(is_minus) << 63 | short | u64::from(target) })
    }

    /// The slot of operand `k`.
    #[inline(always)]
    pub(super) fn slot(self, k: usize) -> usize {
        (self.products[k / 2] >> (32 * (k % 2))) as u32 as usize
    }

    /// The slot of the result.
    #[inline(always)]
    pub(super) fn target(self) -> usize {
        self.target as u32 as usize
    }

    /// The sign bit, for −.
    #[inline(always)]
    fn sign(self) -> u64 {
        // a register of numbers takes it from memory: through others it would wait
        0.0_f64.copysign(f64::from_bits(self.target)).to_bits()
    }

    /// Whether it is ±a·b + c.
    #[inline(always)]
    pub(super) fn is_short(self) -> bool {
        self.target & SHORT != 0
    }

    /// ±1, as a·b has it.
    #[inline(always)]
    pub(super) fn factor(self) -> f64 {
        f64::from_bits(1.0_f64.to_bits() | self.sign())
    }
}

/// Instructions without calls, grouped as they stand.
pub(super) fn grouped(instructions: &[Placed], neutral: Neutral) -> Vec<Run> {
    let mut runs = Vec::new();
    for i in instructions {
        match (Sum::of(i, neutral), runs.last_mut()) {
            (Some(sum), Some(Run::Sums(list))) => list.push(sum),
            (Some(sum), _) => runs.push(Run::Sums(vec![sum])),
            (None, Some(Run::Selects(list))) if i.op == Op::SelectLess => list.push(*i),
            (None, _) if i.op == Op::SelectLess => runs.push(Run::Selects(vec![*i])),
            (None, _) => runs.push(Run::Other(*i)),
        }
    }
    runs
}

/// Runs in `f64`.
#[inline(never)]
pub(super) fn run(runs: &[Run], slots: &mut impl Storage) {
    for run in runs {
        match run {
            Run::Sums(list) => {
                for sum in list {
                    let x = |k: usize| slots.get(sum.slot(k) as u32);
                    let product = f64::from_bits((x(0) * x(1)).to_bits() ^ sum.sign());
                    let total = product + x(2) * x(3);
                    slots.set(sum.target() as u32, total);
                }
            }
            Run::Selects(list) => {
                for i in list {
                    let is_less = slots.get(i.a) < slots.get(i.b);
                    slots.set(i.target, select_unpredictable(is_less, slots.get(i.c), slots.get(i.d)));
                }
            }
            Run::Other(i) if i.op == Op::SinCos => {
                let (sine, cosine) = slots.get(i.a).sin_cos();
                slots.set(i.target, sine);
                slots.set(i.d, cosine);
            }
            Run::Other(i) => {
                let [a, b, c, d] = [i.a, i.b, i.c, i.d].map(|slot| slots.get(slot));
                slots.set(i.target, apply(i.op, a, b, c, d));
            }
        }
    }
}

/// Runs for eight steps side by side, each to the bits of [`run`].
pub(super) fn run_steps(runs: &[Run], slots: &mut [[f64; LINE]]) {
    dispatch(Steps { runs, slots });
}

struct Steps<'a> {
    runs: &'a [Run],
    slots: &'a mut [[f64; LINE]],
}

impl Kernel for Steps<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { runs, slots } = self;
        for run in runs {
            match run {
                Run::Sums(list) => {
                    for sum in list {
                        let [a, b, c, d] = [
                            L::wide(&slots[sum.slot(0)]),
                            L::wide(&slots[sum.slot(1)]),
                            L::wide(&slots[sum.slot(2)]),
                            L::wide(&slots[sum.slot(3)]),
                        ];
                        let mut result = [0.0; LINE];
                        let target = L::wide_mut(&mut result);
                        for r in 0..LINE / L::WIDE {
                            target[r] = L::two_products(a[r], b[r], sum.sign(), c[r], d[r]);
                        }
                        slots[sum.target()] = result;
                    }
                }
                Run::Selects(list) => {
                    for i in list {
                        let [a, b, c, d] = [
                            L::wide(&slots[i.a as usize]),
                            L::wide(&slots[i.b as usize]),
                            L::wide(&slots[i.c as usize]),
                            L::wide(&slots[i.d as usize]),
                        ];
                        let mut result = [0.0; LINE];
                        let target = L::wide_mut(&mut result);
                        for r in 0..LINE / L::WIDE {
                            target[r] = L::select_less(a[r], b[r], c[r], d[r]);
                        }
                        slots[i.target as usize] = result;
                    }
                }
                Run::Other(i) => one_by_one(i, slots),
            }
        }
    }
}

/// An operation that programs have few of, step by step.
#[inline(never)]
fn one_by_one(i: &Placed, slots: &mut [[f64; LINE]]) {
    let x = |slot: u32| slot as usize;
    let [a, b, c, d] = [slots[x(i.a)], slots[x(i.b)], slots[x(i.c)], slots[x(i.d)]];
    for k in 0..LINE {
        if i.op == Op::SinCos {
            (slots[x(i.target)][k], slots[x(i.d)][k]) = a[k].sin_cos();
        } else {
            slots[x(i.target)][k] = apply(i.op, a[k], b[k], c[k], d[k]);
        }
    }
}
