//! The adjoint of a recording: what each operation passes back to its operands.
//!
//! The adjoint of y = f(x) maps (x, ȳ) to x̄ = (∂f/∂x)ᵀ ȳ. It is another [`Recording`], made by walking the graph
//! backwards once (Griewank and Walther 2008, chapter 3) with ordinary `Trace` arithmetic, so it is simplified, compiled
//! and evaluated like any other.

use super::{Call, Node, Recording, Trace, TraceMask, push, push_call, record};
use crate::autodiff::scalar::Scalar;
use std::ops::Range;

impl Recording {
    /// The adjoint with respect to the inputs in `with_respect_to`: inputs `[x; ȳ]` (those of this recording, then one
    /// seed per result), results x̄ over that range.
    pub fn adjoint(&self, with_respect_to: Range<usize>) -> Self {
        self.adjoint_of(|_| true, with_respect_to)
    }

    /// As [`Recording::adjoint`] where the seeds of other results than `seeded` are zero: they stay inputs, and what only
    /// they need falls away.
    pub(crate) fn adjoint_of(&self, seeded: impl Fn(usize) -> bool, with_respect_to: Range<usize>) -> Self {
        let n_seed = self.outputs.len();
        record(self.graph(), self.n_input + n_seed, || {
            let seeds: Vec<Trace> = (0..n_seed).map(|k| push(Node::Input((self.n_input + k) as u32))).collect();
            let inputs = input_nodes(with_respect_to);
            let all = self.outputs.iter().copied().zip(seeds).enumerate();
            let own: Vec<(u32, Trace)> = all.filter(|(k, _)| seeded(*k)).map(|(_, seed)| seed).collect();
            self.reverse_sweep(&own, &inputs)
        })
    }

    /// The Jacobian with respect to the inputs in `with_respect_to`, column by column: one reverse sweep per result, all on
    /// one graph. What is zero by structure costs nothing, and what the sweeps share is computed once.
    pub fn jacobian(&self, with_respect_to: Range<usize>) -> Self {
        record(self.graph(), self.n_input, || {
            let inputs = input_nodes(with_respect_to);
            let rows: Vec<Vec<Trace>> =
                self.outputs.iter().map(|o| self.reverse_sweep(&[(*o, Trace::one())], &inputs)).collect();
            (0..inputs.len()).flat_map(|k| rows.iter().map(move |row| row[k])).collect()
        })
    }

    fn reverse_sweep(&self, seeds: &[(u32, Trace)], inputs: &[u32]) -> Vec<Trace> {
        let mut adjoint: Vec<Option<Trace>> = vec![None; self.nodes.len()];
        let accumulate = |adjoint: &mut Vec<Option<Trace>>, i: u32, value: Trace| {
            let sum = &mut adjoint[i as usize];
            *sum = Some(sum.map_or(value, |s| s + value));
        };
        for (output, seed) in seeds {
            accumulate(&mut adjoint, *output, *seed);
        }
        for i in (0..self.nodes.len()).rev() {
            if let Node::Call(number) = self.nodes[i] {
                for (operand, value) in pull_back_call(&self.calls[number as usize], &adjoint[i + 1..]) {
                    accumulate(&mut adjoint, operand, value);
                }
            }
            let Some(g) = adjoint[i] else { continue };
            for (operand, value) in pull_back(self.nodes[i], Trace(i as u32), g).into_iter().flatten() {
                accumulate(&mut adjoint, operand, value);
            }
        }
        inputs.iter().map(|i| adjoint.get(*i as usize).copied().flatten().unwrap_or_else(Trace::zero)).collect()
    }
}

pub(super) fn input_nodes(range: Range<usize>) -> Vec<u32> {
    range.map(|k| push(Node::Input(k as u32)).0).collect()
}

/// What a call passes to its operands when its results' adjoints are the first of `behind`: its transposed, once; nothing
/// where they are all zero.
fn pull_back_call(call: &Call, behind: &[Option<Trace>]) -> Vec<(u32, Trace)> {
    let zero = Trace::zero();
    let seeds = behind.iter().take(call.operation.n_output()).map(|g| g.unwrap_or(zero));
    if seeds.clone().all(|g| g == zero) {
        return Vec::new();
    }
    let inputs: Vec<Trace> = call.operands.iter().map(|i| Trace(*i)).chain(seeds).collect();
    call.operands.iter().copied().zip(push_call(call.operation.adjoint(), &inputs)).collect()
}

/// What `node` (whose value is `y`) passes to its operands when its own adjoint is `g`.
pub(super) fn pull_back(node: Node, y: Trace, g: Trace) -> [Option<(u32, Trace)>; 2] {
    use Node::*;
    let zero = Trace::zero;
    match node {
        Input(_) | Constant(_) | Less(..) | And(..) | Or(..) | Not(_) | Detach(_) | Call(_) | Result(..) => {
            [None, None]
        }
        Add(a, b) => [Some((a, g)), Some((b, g))],
        Sub(a, b) => [Some((a, g)), Some((b, -g))],
        Mul(a, b) => [Some((a, g * Trace(b))), Some((b, g * Trace(a)))],
        Div(a, b) => {
            let over = g * Trace(b).recip();
            [Some((a, over)), Some((b, -(over * y)))]
        }
        Neg(a) => [Some((a, -g)), None],
        Recip(a) => [Some((a, -(g * (y * y)))), None],
        Sqrt(a) => [Some((a, g * (Trace::constant(0.5) * y.recip()))), None],
        Sin(a) => [Some((a, g * push(Cos(a)))), None],
        Cos(a) => [Some((a, -(g * push(Sin(a))))), None],
        Exp(a) => [Some((a, g * y)), None],
        Ln(a) => [Some((a, g * Trace(a).recip())), None],
        Tanh(a) => [Some((a, g * (Trace::one() - y * y))), None],
        Atan2(a, b) => {
            let (ty, tx) = (Trace(a), Trace(b));
            let over = g * (tx * tx + ty * ty).recip();
            [Some((a, over * tx)), Some((b, -(over * ty)))]
        }
        Select(m, a, b) => {
            [Some((a, Trace::select(TraceMask(m), g, zero()))), Some((b, Trace::select(TraceMask(m), zero(), g)))]
        }
    }
}
