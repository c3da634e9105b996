//! Reverse sweeps over a [`Chain`]: all rows of a Jacobian side by side, or one weighted sum of them.
//!
//! The values come first, once, with the partial derivatives among them ([`Program`]); they depend on no seed. What is left is
//! linear: ȳ of a vertex is a sum of weights times ȳ of vertices behind it. There a lane is a row, and a vertex is swept for as
//! many rows as eight registers hold. Multiplication and addition are not fused, so every instruction set gives the
//! same bits.
//!
//! A small Jacobian is one machine code, where every lane has the same values and then a row of its own ([`whole`]): nothing is
//! decoded, and no weight leaves its register to be read again. Of a larger one the values alone are machine code. Its code would no
//! longer stay in the cache, and instructions that are read once per evaluation cost more than the loop that is here.

mod steps;
mod whole;

pub(crate) use self::steps::{Pulled, StepsCode, StepsCodeScratch};
use self::whole::Whole;
use super::columns::{LINE, Lines};
use super::lanes::{Kernel, Lanes, dispatch};
use super::program::{Instruction, InstructionKind, Op, Program, Source, Value, ValueForm, Workspace};
use super::trace::Recording;
use super::trace::chain::{Chain, EdgeCost, Head, Vertex};
use base::error::{Error, Result};
use std::ops::Range;

/// Most slots of values and of vertices: both numbers of an edge stand in one word.
const MAX_SLOTS: usize = 1 << 16;

/// Most registers that a vertex is swept for at once: sums of that many stay in registers.
const REGISTERS: usize = 8;

/// One part of a sum: the slot of the weight among the values, and the slot of what it multiplies, in one word.
#[derive(Debug, Clone, Copy)]
struct Edge(u32);

impl Edge {
    fn new(weight: u16, from: u16) -> Self {
        Self(u32::from(weight) << 16 | u32::from(from))
    }
    #[inline(always)]
    fn weight(self) -> usize {
        (self.0 >> 16) as usize
    }
    #[inline(always)]
    fn from(self) -> usize {
        (self.0 & 0xFFFF) as usize
    }
}

/// Of the next so many edges.
#[derive(Debug, Clone, Copy)]
struct Sum {
    n_edge: u32,
    target: u32,
}

/// Those of all sums, twice: weights by their slots in the interpreter, and by their numbers among its results.
#[derive(Debug, Clone, Default)]
struct Edges {
    by_slot: Vec<Edge>,
    by_number: Vec<Edge>,
}

/// An edge from an input to a result that no lane is swept for.
#[derive(Debug, Clone, Copy)]
struct Direct {
    input: u32,
    result: u32,
    /// Its number among the weights.
    weight: u16,
}

/// Weights where an evaluation left them.
#[derive(Clone, Copy)]
struct Weights<'a> {
    numbers: &'a [f64],
    /// As these numbers are placed.
    edges: &'a [Edge],
    /// Slots of the interpreter; nothing where they stand in order.
    program: Option<&'a Program>,
}

impl Weights<'_> {
    fn of(self, direct: &Direct) -> f64 {
        let number = usize::from(direct.weight);
        self.numbers[self.program.map_or(number, |program| program.place(number) as usize)]
    }
}

/// A chain, ready to be swept. Slots: one per swept result, one per input, then vertices by liveness.
#[derive(Debug, Clone)]
pub(crate) struct Sweep {
    /// x → weights.
    weights: Recording,
    values: Program,
    n_result: usize,
    n_input: usize,
    n_slot: usize,
    sums: Vec<Sum>,
    edges: Edges,
    /// Results that are swept for.
    rows: Vec<u32>,
    direct: Vec<Direct>,
}

/// Scratch of [`Sweep::jacobian`]; made once, reused without allocation.
#[derive(Debug, Clone)]
pub(crate) struct RowsScratch(By);

#[derive(Debug, Clone)]
enum By {
    Whole(Box<Whole>),
    Parts(Parts),
}

/// Values first, then the sweep.
#[derive(Debug, Clone)]
struct Parts {
    values: Workspace,
    /// As machine code writes them; the interpreter leaves them in its slots.
    weights: Vec<f64>,
    /// `[slot, lane]`.
    lanes: Lines,
    /// Lanes of a slot.
    width: usize,
}

/// Scratch of [`Sweep::pull`]; made once, reused without allocation.
#[derive(Debug, Clone)]
pub(crate) struct StepsScratch {
    values: Lines,
    slots: Vec<f64>,
}

impl StepsScratch {
    /// Numbers held.
    pub(crate) fn len(&self) -> usize {
        LINE * self.values.len() + self.slots.len()
    }
}

impl Sweep {
    /// Of a recording with respect to some of its inputs; nothing where a custom function is called.
    ///
    /// # Errors
    /// [`Error::Limit`](base::error::Error::Limit) if the recording is too large.
    pub(crate) fn of(recording: &Recording, with_respect_to: Range<usize>, price: EdgeCost) -> Result<Option<Self>> {
        let n_input = with_respect_to.len();
        recording.chain(with_respect_to, price).map(|c| Self::of_chain(&c, recording.n_output(), n_input)).transpose()
    }

    /// The same, and scratch for its Jacobian.
    ///
    /// # Errors
    /// As [`Sweep::of`].
    pub(crate) fn with_rows(
        recording: &Recording,
        with_respect_to: Range<usize>,
        price: EdgeCost,
    ) -> Result<Option<(Self, RowsScratch)>> {
        let n_input = with_respect_to.len();
        let Some(chain) = recording.chain(with_respect_to, price) else { return Ok(None) };
        let sweep = Self::of_chain(&chain, recording.n_output(), n_input)?;
        let scratch = sweep.rows_scratch(&chain)?;
        Ok(Some((sweep, scratch)))
    }

    fn of_chain(chain: &Chain, n_result: usize, n_input: usize) -> Result<Self> {
        let mut weights = chain.values.clone();
        // nobody asks for the results themselves
        weights.outputs.drain(..n_result);
        let values = Program::compile_single(&weights)?;
        let mut is_swept = vec![false; n_result];
        for (head, _) in chain.vertices.iter().filter(|v| v.input.is_none()).flat_map(|v| &v.edges) {
            if let Head::Result(k) = head {
                is_swept[*k as usize] = true;
            }
        }
        let rows: Vec<u32> = (0..n_result as u32).filter(|k| is_swept[*k as usize]).collect();
        let mut lane = vec![None; n_result];
        rows.iter().zip(0..).for_each(|(k, own)| lane[*k as usize] = Some(own));
        let last_use = last_use(&chain.vertices);
        let (mut n_slot, mut free) = (rows.len() + n_input, Vec::new());
        let mut slots: Vec<u32> = Vec::with_capacity(chain.vertices.len());
        let (mut sums, mut edges, mut direct) = (Vec::new(), Edges::default(), Vec::new());
        for (at, vertex) in chain.vertices.iter().enumerate() {
            let before = edges.by_slot.len();
            for (head, weight) in &vertex.edges {
                let weight = *weight as usize - n_result;
                let from = match head {
                    Head::Vertex(v) => Some(slots[*v as usize]),
                    Head::Result(k) => lane[*k as usize],
                };
                match (from, head, vertex.input) {
                    (Some(from), ..) => {
                        edges.by_slot.push(Edge::new(values.place(weight) as u16, from as u16));
                        edges.by_number.push(Edge::new(weight as u16, from as u16));
                    }
                    (None, Head::Result(result), Some(input)) => {
                        direct.push(Direct { input, result: *result, weight: weight as u16 });
                    }
                    _ => {}
                }
            }
            let over = |head: &Head| if let Head::Vertex(v) = head { last_use[*v as usize] == at } else { false };
            free.extend(vertex.edges.iter().filter(|(head, _)| over(head)).map(|(head, _)| match head {
                Head::Vertex(v) => slots[*v as usize],
                Head::Result(_) => 0,
            }));
            let target = match vertex.input {
                Some(k) => rows.len() as u32 + k,
                None => free.pop().unwrap_or_else(|| {
                    n_slot += 1;
                    n_slot as u32 - 1
                }),
            };
            let n_alive = n_slot.max(values.n_slot()).max(values.n_output());
            if n_alive > MAX_SLOTS {
                let remedy = "Record a smaller function: one step instead of a rollout.";
                return Err(Error::limit("number of values alive at once in a derivative", n_alive, MAX_SLOTS, remedy));
            }
            slots.push(target);
            sums.push(Sum { n_edge: (edges.by_slot.len() - before) as u32, target });
        }
        Ok(Self { weights, values, n_result, n_input, n_slot, sums, edges, rows, direct })
    }

    /// Instructions and multiplications of a sweep.
    pub(crate) fn len(&self) -> usize {
        self.values.len() + self.edges.by_slot.len() + self.direct.len()
    }

    /// Scratch for [`Sweep::jacobian`], with machine code where it may be made; `chain` is what this is of.
    pub(crate) fn rows_scratch(&self, chain: &Chain) -> Result<RowsScratch> {
        Ok(match Whole::of(self, chain)? {
            Some(whole) => RowsScratch(By::Whole(Box::new(whole))),
            None => self.rows_in_parts(self.values.workspace()),
        })
    }

    /// The values by machine code and then the sweep, or interpreted.
    #[cfg(test)]
    fn rows_by(&self, is_native: bool) -> RowsScratch {
        self.rows_in_parts(if is_native { self.values.workspace() } else { self.values.roomy_workspace() })
    }

    fn rows_in_parts(&self, values: Workspace) -> RowsScratch {
        struct Width;
        impl Kernel for Width {
            type Output = usize;
            #[inline(always)]
            fn run<L: Lanes>(self) -> usize {
                L::WIDE
            }
        }
        let register = dispatch(Width);
        let width = register * self.rows.len().div_ceil(register).clamp(1, REGISTERS);
        let mut lanes = Lines::zeros((self.n_slot * width).div_ceil(LINE));
        seed(&mut lanes.as_flattened_mut()[..self.rows.len() * width], 0, width);
        let (values, weights) = if values.is_native() {
            (values, vec![0.0; self.values.n_output()])
        } else {
            (self.values.roomy_workspace(), Vec::new())
        };
        RowsScratch(By::Parts(Parts { values, weights, lanes, width }))
    }

    /// The Jacobian at x, column-major results × inputs.
    ///
    /// # Panics
    /// If a length is not the recording's.
    pub(crate) fn jacobian(&self, scratch: &mut RowsScratch, x: &[f64], jacobian: &mut [f64]) {
        assert_eq!(jacobian.len(), self.n_result * self.n_input, "length of the jacobian");
        let Parts { values, weights, lanes, width } = match &mut scratch.0 {
            By::Whole(whole) => return whole.jacobian(x, jacobian),
            By::Parts(parts) => parts,
        };
        let Edges { by_slot, by_number } = &self.edges;
        let weights = if values.is_native() {
            self.values.evaluate(values, x, weights);
            Weights { numbers: weights, edges: by_number, program: None }
        } else {
            Weights { numbers: self.values.evaluate_inside(values, x), edges: by_slot, program: Some(&self.values) }
        };
        let lanes = lanes.as_flattened_mut();
        dispatch(Rows { sweep: self, weights, lanes, width: *width, jacobian });
    }

    /// Scratch for [`Sweep::evaluate_steps`] and [`Sweep::pull`].
    pub(crate) fn steps_scratch(&self) -> StepsScratch {
        StepsScratch { values: self.values.step_slots(), slots: vec![0.0; self.n_slot] }
    }

    /// Values and weights at eight points x side by side, `points[k]` holding number k of each.
    pub(crate) fn evaluate_steps(&self, scratch: &mut StepsScratch, points: &[[f64; LINE]]) {
        self.values.evaluate_steps(LINE, &mut scratch.values, points);
    }

    /// x̄ = Jᵀ `seeds` at point `step` of the eight of [`evaluate_steps`](Self::evaluate_steps).
    ///
    /// # Panics
    /// If a length is not the recording's.
    pub(crate) fn pull(&self, scratch: &mut StepsScratch, step: usize, seeds: &[f64], inputs: &mut [f64]) {
        assert_eq!((seeds.len(), inputs.len()), (self.n_result, self.n_input), "results and inputs");
        let StepsScratch { values, slots } = scratch;
        for (slot, row) in slots.iter_mut().zip(&self.rows) {
            *slot = seeds[*row as usize];
        }
        let mut edges = &self.edges.by_slot[..];
        for sum in &self.sums {
            let (own, rest) = edges.split_at(sum.n_edge as usize);
            let mut total = 0.0;
            for edge in own {
                total += values[edge.weight()][step % LINE] * slots[edge.from()];
            }
            slots[sum.target as usize] = total;
            edges = rest;
        }
        inputs.copy_from_slice(&slots[self.rows.len()..self.rows.len() + self.n_input]);
        for d in &self.direct {
            inputs[d.input as usize] +=
                values[self.values.place(d.weight.into()) as usize][step % LINE] * seeds[d.result as usize];
        }
    }
}

/// What sweeps are made of.
impl ValueForm {
    /// sum + weight·from, to the bit but for the sign of zeros.
    fn add_product(&mut self, sum: Option<Value>, weight: Value, from: Value) -> Value {
        let [w, f] = [weight, from].map(|value| match self.source(value) {
            Source::Constant(number) if number.abs() == 1.0 => number,
            _ => 0.0,
        });
        let (sign, factor) = if f == 1.0 { (f, weight) } else { (w, from) };
        match (sum, sign) {
            (None, 1.0) => factor,
            (None, -1.0) => self.op(Op::Neg, [factor; 4]),
            (None, _) => self.op(Op::Mul, [weight, from, from, from]),
            (Some(sum), 1.0) => self.sum(sum, factor),
            (Some(sum), -1.0) => self.op(Op::Sub, [sum, factor, factor, factor]),
            (Some(sum), _) => self.op(Op::MulAdd, [weight, from, sum, sum]),
        }
    }

    fn sum(&mut self, a: Value, b: Value) -> Value {
        self.op(Op::Add, [a, b, b, b])
    }

    fn op(&mut self, op: Op, operands: [Value; 4]) -> Value {
        let first = self.next(1);
        self.instructions.push(Instruction { action: InstructionKind::Op(op, operands), first });
        first
    }
}

/// The last vertex that reads each one.
fn last_use(vertices: &[Vertex]) -> Vec<usize> {
    let mut last = vec![usize::MAX; vertices.len()];
    for (at, vertex) in vertices.iter().enumerate() {
        for (head, _) in &vertex.edges {
            if let Head::Vertex(v) = head {
                last[*v as usize] = at;
            }
        }
    }
    last
}

struct Rows<'a> {
    sweep: &'a Sweep,
    weights: Weights<'a>,
    lanes: &'a mut [f64],
    width: usize,
    jacobian: &'a mut [f64],
}

impl Kernel for Rows<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { sweep, weights, lanes, width, jacobian } = self;
        let n_row = sweep.rows.len();
        if n_row > width || n_row == 0 {
            jacobian.fill(0.0);
        }
        let mut first = 0;
        while first < n_row {
            if n_row > width {
                seed(&mut lanes[..n_row * width], first, width);
            }
            match width / L::WIDE {
                1 => Pass::<1> { sweep, weights, lanes }.outlined::<L>(),
                2 => Pass::<2> { sweep, weights, lanes }.outlined::<L>(),
                3 => Pass::<3> { sweep, weights, lanes }.outlined::<L>(),
                4 => Pass::<4> { sweep, weights, lanes }.outlined::<L>(),
                5 => Pass::<5> { sweep, weights, lanes }.outlined::<L>(),
                6 => Pass::<6> { sweep, weights, lanes }.outlined::<L>(),
                7 => Pass::<7> { sweep, weights, lanes }.outlined::<L>(),
                _ => Pass::<REGISTERS> { sweep, weights, lanes }.outlined::<L>(),
            }
            Columns { sweep, lanes: &lanes[n_row * width..], first, width, jacobian }.outlined::<L>();
            first += width;
        }
        for d in &sweep.direct {
            jacobian[d.input as usize * sweep.n_result + d.result as usize] += weights.of(d);
        }
    }
}

/// Row i of the identity is the seed of lane i, for results from `first` on.
fn seed(lanes: &mut [f64], first: usize, width: usize) {
    lanes.fill(0.0);
    for (lane, row) in lanes.chunks_exact_mut(width).skip(first).take(width).enumerate() {
        row[lane] = 1.0;
    }
}

/// All sums for `K` registers of rows.
struct Pass<'a, const K: usize> {
    sweep: &'a Sweep,
    weights: Weights<'a>,
    lanes: &'a mut [f64],
}

impl<const K: usize> Kernel for Pass<'_, K> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { sweep, weights: Weights { numbers, edges, .. }, lanes } = self;
        let slots = L::wide_mut(lanes).as_chunks_mut::<K>().0;
        let mut at = 0;
        for sum in &sweep.sums {
            let end = at + sum.n_edge as usize;
            let mut total = [L::splat(0.0); K];
            for edge in &edges[at..end] {
                let weight = L::splat(numbers[edge.weight()]);
                let from = &slots[edge.from()];
                for r in 0..K {
                    total[r] = L::add_product(total[r], weight, from[r]);
                }
            }
            slots[sum.target as usize] = total;
            at = end;
        }
    }
}

/// Slots of the inputs into columns of the Jacobian.
struct Columns<'a> {
    sweep: &'a Sweep,
    lanes: &'a [f64],
    first: usize,
    width: usize,
    jacobian: &'a mut [f64],
}

impl Kernel for Columns<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { sweep, lanes, first, width, jacobian } = self;
        let n = sweep.n_result;
        let rows = &sweep.rows[first..sweep.rows.len().min(first + width)];
        let from = rows[0] as usize;
        let mut k = 0;
        // whole registers where they fit: lanes without a row are zeros, which the next column is written over
        if sweep.rows.len() <= width && rows[rows.len() - 1] as usize - from + 1 == rows.len() {
            while k < sweep.n_input && k * n + from + width <= jacobian.len() {
                let source = L::wide(&lanes[k * width..(k + 1) * width]);
                let target = L::wide_mut(&mut jacobian[k * n + from..k * n + from + width]);
                for r in 0..source.len() {
                    target[r] = source[r];
                }
                // results that no lane is swept for
                for i in 0..from {
                    jacobian[k * n + i] = 0.0;
                }
                for i in from + rows.len()..n {
                    jacobian[k * n + i] = 0.0;
                }
                k += 1;
            }
        }
        if k < sweep.n_input && sweep.rows.len() < n && sweep.rows.len() <= width {
            jacobian[k * n..].fill(0.0);
        }
        while k < sweep.n_input {
            for i in 0..rows.len() {
                jacobian[k * n + rows[i] as usize] = lanes[k * width + i];
            }
            k += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::Quadrotor;
    use crate::lanes::{InstructionSet, with_set};
    use crate::{Scalar, System, Trace};

    const PRICES: [EdgeCost; 3] = [
        EdgeCost { product: f64::INFINITY, vertex: 0.0, few: 0 },
        EdgeCost { product: 0.7, vertex: 1.5, few: 24 },
        EdgeCost { product: 0.0, vertex: 100.0, few: 0 },
    ];

    fn recording_of(system: &impl System) -> Recording {
        let (n, m) = (system.n_state(), system.n_input());
        Recording::of(n + m, |z| {
            let mut next = vec![Trace::zero(); n];
            system.step(&z[..n], &z[n..], &[], &mut next);
            next
        })
    }

    /// Jacobians at some points around `at`, by one code, by code for the values alone, and interpreted.
    fn has_equal_bits_however_it_runs(system: &impl System, at: &[f64]) {
        let (n, m) = (system.n_state(), system.n_input());
        let recording = recording_of(system);
        let chain = recording.chain(0..n + m, PRICES[1]).unwrap();
        let sweep = Sweep::of_chain(&chain, n, n + m).unwrap();
        let whole = Whole::of(&sweep, &chain).unwrap();
        let mut ways = vec![sweep.rows_by(false), sweep.rows_by(true)];
        assert_eq!(whole.is_some(), sweep.values.is_native() && sweep.len() < 6_000);
        ways.extend(whole.map(|whole| RowsScratch(By::Whole(Box::new(whole)))));
        for round in 0..20 {
            let z: Vec<f64> = (0..n + m)
                .map(|k| at.get(k).map_or(0.1, |x| *x) + 0.1 * f64::from(round) * (1.0 + (k * 7 + 3) as f64).sin())
                .collect();
            let mut jacobians = ways.iter_mut().map(|scratch| {
                let mut own = vec![f64::NAN; n * (n + m)];
                sweep.jacobian(scratch, &z, &mut own);
                own.into_iter().map(f64::to_bits).collect::<Vec<_>>()
            });
            let first = jacobians.next().unwrap();
            assert!(jacobians.all(|own| own == first), "round {round}");
        }
    }

    #[test]
    fn a_jacobian_has_equal_bits_in_one_code_in_two_parts_and_interpreted() {
        for is_loaded in [false, true] {
            let system = Quadrotor { is_loaded };
            // zeros of either sign too
            has_equal_bits_however_it_runs(&system, &system.rest());
        }
    }

    /// Five states of which three are swept for, in two groups, and one is constant.
    struct Scattered;
    impl System for Scattered {
        fn n_state(&self) -> usize {
            5
        }
        fn n_input(&self) -> usize {
            2
        }
        fn step<S: Scalar>(&self, x: &[S], u: &[S], _: &[S], next: &mut [S]) {
            let mut y = x[0];
            for k in 0..20 {
                y = (y * x[2] + u[k % 2]).sin_cos().0 - x[4] * y;
            }
            next[0] = y * y - x[0];
            next[1] = x[1] + S::constant(0.5) * u[0];
            next[2] = y * u[1];
            next[3] = S::constant(2.0);
            next[4] = -y;
        }
    }

    #[test]
    fn rows_that_do_not_follow_each_other_come_to_their_places() {
        has_equal_bits_however_it_runs(&Scattered, &[0.3, 0.1, -0.2, 0.0, 0.5]);
        let mut compiled = crate::CompiledJacobian::new(&Scattered).unwrap();
        let mut own = vec![f64::NAN; 35];
        compiled.evaluate(&[0.3, 0.1, -0.2, 0.0, 0.5], &[0.4, -0.1], &[], &mut own);
        let mut want = vec![f64::NAN; 35];
        let mut scratch = crate::JacobianScratch::new(&Scattered);
        crate::jacobian(&Scattered, &[0.3, 0.1, -0.2, 0.0, 0.5], &[0.4, -0.1], &[], &mut scratch, &mut want);
        assert!(own.iter().zip(&want).all(|(a, b)| (a - b).abs() <= 1e-12)); // measured 3e-16
    }

    #[test]
    fn a_sweep_has_the_same_bits_with_every_instruction_set_and_the_same_jacobian_at_every_price() {
        let system = Quadrotor { is_loaded: true };
        let (n, m) = (system.n_state(), system.n_input());
        let recording = recording_of(&system);
        let z: Vec<f64> = system.rest().iter().chain(&vec![0.1; m]).map(|x| x + 0.01).collect();
        let mut first = Vec::new();
        let mut counts = Vec::new();
        for price in PRICES {
            let sweep = Sweep::of(&recording, 0..n + m, price).unwrap().unwrap();
            counts.push((sweep.values.len(), sweep.sums.len()));
            let mut bits = Vec::new();
            for set in [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane]
                .into_iter()
                .filter(|set| set.is_here())
            {
                with_set(set, || {
                    let mut own = vec![f64::NAN; n * (n + m)];
                    let mut scratch = sweep.rows_by(false);
                    for _ in 0..2 {
                        sweep.jacobian(&mut scratch, &z, &mut own);
                    }
                    bits.push(own);
                });
            }
            assert!(bits.windows(2).all(|two| two[0] == two[1]));
            let own = bits.swap_remove(0);
            // one weighted sum of rows is that of the rows
            let seeds: Vec<f64> = (0..n).map(|i| 1.0 - 0.1 * i as f64).collect();
            let (mut scratch, mut pulled) = (sweep.steps_scratch(), vec![0.0; n + m]);
            sweep.evaluate_steps(&mut scratch, &z.iter().map(|x| [*x; LINE]).collect::<Vec<_>>());
            sweep.pull(&mut scratch, 5, &seeds, &mut pulled);
            for (k, got) in pulled.iter().enumerate() {
                let want: f64 = own[k * n..(k + 1) * n].iter().zip(&seeds).map(|(j, s)| j * s).sum();
                assert!((got - want).abs() <= 1e-12 * want.abs().max(1.0), "{k}: {got:e} against {want:e}"); // measured 3e-14
            }
            if first.is_empty() {
                first = own;
            } else {
                let worst = first.iter().zip(&own).map(|(a, b)| (a - b).abs() / a.abs().max(1.0)).fold(0.0, f64::max);
                println!("{price:?}: {worst:.1e}");
                assert!(worst <= 1e-12, "{price:?}: {worst:.1e}"); // measured 3.3e-16
            }
        }
        // from every vertex kept to hardly any but the 25 inputs: measured (3759, 1800), (5033, 1092), (53 978, 28)
        println!("instructions and sums: {counts:?}");
        assert!(counts.windows(2).all(|two| two[0].0 < two[1].0 && two[0].1 > two[1].1));
        assert!(counts[2].1 < 2 * (n + m));
    }
}
