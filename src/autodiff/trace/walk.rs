//! A recording computed node by node, as it was recorded: the witness of programs, which share no line with it; and how what was
//! written once is written again.

use super::Recording;
use super::graph::{Call, Callee, Node};
use crate::{Mask, Scalar};

/// What a node came to.
#[derive(Clone, Copy)]
enum Value<S: Scalar> {
    Number(S),
    Truth(S::Mask),
}

/// What nodes came to so far.
#[doc(hidden)]
pub struct Values<S: Scalar>(Vec<Value<S>>);

impl<S: Scalar> Values<S> {
    /// Of a node that was come to.
    pub fn number(&self, node: usize) -> S {
        match self.0[node] {
            Value::Number(x) => x,
            Value::Truth(mask) => S::select(mask, S::one(), S::zero()),
        }
    }

    /// Likewise, of one that is a truth.
    pub fn truth(&self, node: usize) -> S::Mask {
        match self.0[node] {
            Value::Number(x) => S::constant(0.5).lt(x),
            Value::Truth(mask) => mask,
        }
    }
}

/// A recording in the course of being computed, in its order.
#[doc(hidden)]
pub struct Walk<'a, S: Scalar> {
    recording: &'a Recording,
    /// What nodes came to so far.
    pub values: Values<S>,
    /// Of the last call.
    results: Vec<S>,
}

impl<'a, S: Scalar> Walk<'a, S> {
    /// Before the first node.
    pub fn new(recording: &'a Recording) -> Self {
        Self { recording, values: Values(Vec::with_capacity(recording.nodes.len())), results: Vec::new() }
    }

    /// Computes the nodes before `end`. `input` gives the inputs, each when it is come to.
    pub fn run_to(&mut self, end: usize, input: &mut dyn FnMut(&Values<S>, usize) -> S) {
        let from = self.values.0.len();
        for node in &self.recording.nodes[from..end] {
            let values = &self.values;
            let value = match *node {
                Node::Input(k) => Value::Number(input(values, k as usize)),
                Node::Call(number) => {
                    self.results = self.recording.calls[number as usize].evaluated(values);
                    // read by its results alone; a zero would be one node more
                    Value::Number(self.results.first().copied().unwrap_or_else(S::zero))
                }
                Node::Result(_, k) => Value::Number(self.results[k as usize]),
                node => node.evaluated(values),
            };
            self.values.0.push(value);
        }
    }

    /// Computes the rest.
    pub fn run(&mut self, input: &mut dyn FnMut(&Values<S>, usize) -> S) {
        self.run_to(self.recording.nodes.len(), input);
    }

    /// Forgets what was computed from node `end` on.
    pub fn back_to(&mut self, end: usize) {
        self.values.0.truncate(end);
    }

    /// A result.
    pub fn output(&self, k: usize) -> S {
        self.values.number(self.recording.outputs[k] as usize)
    }

    /// A result that is a truth.
    pub fn truth(&self, k: usize) -> S::Mask {
        self.values.truth(self.recording.outputs[k] as usize)
    }
}

impl Recording {
    /// Results of inputs on any scalar, node by node: nothing is fused, moved or left out. Slow.
    ///
    /// # Panics
    /// For another number of inputs or outputs.
    pub fn evaluate<S: Scalar>(&self, inputs: &[S], outputs: &mut [S]) {
        let counts = (inputs.len(), outputs.len());
        assert_eq!(counts, (self.n_input(), self.n_output()), "inputs and outputs of the recording");
        let mut walk = Walk::new(self);
        walk.run(&mut |_, k| inputs[k]);
        for (k, output) in outputs.iter_mut().enumerate() {
            *output = walk.output(k);
        }
    }
}

impl Node {
    fn evaluated<S: Scalar>(self, values: &Values<S>) -> Value<S> {
        use Node::*;
        let x = |node: u32| values.number(node as usize);
        let mask = |node: u32| values.truth(node as usize);
        Value::Number(match self {
            Constant(bits) => S::constant(f64::from_bits(bits)),
            Add(a, b) => x(a) + x(b),
            Sub(a, b) => x(a) - x(b),
            Mul(a, b) => x(a) * x(b),
            Div(a, b) => x(a) / x(b),
            Neg(a) => -x(a),
            Recip(a) => x(a).recip(),
            Sqrt(a) => x(a).sqrt(),
            Sin(a) => x(a).sin_cos().0,
            Cos(a) => x(a).sin_cos().1,
            Exp(a) => x(a).exp(),
            Ln(a) => x(a).ln(),
            Tanh(a) => x(a).tanh(),
            Atan2(y, z) => x(y).atan2(x(z)),
            MulAdd(a, b, c) => x(a).mul_add(x(b), x(c)),
            Select(which, yes, no) => S::select(mask(which), x(yes), x(no)),
            Detach(a) => x(a).detach(),
            Less(a, b) => return Value::Truth(x(a).lt(x(b))),
            And(a, b) => return Value::Truth(mask(a).and(mask(b))),
            Or(a, b) => return Value::Truth(mask(a).or(mask(b))),
            Not(a) => return Value::Truth(mask(a).not()),
            Input(_) | Call(_) | Result(..) => unreachable!("of walks"),
        })
    }
}

impl Call {
    fn evaluated<S: Scalar>(&self, values: &Values<S>) -> Vec<S> {
        let operands: Vec<S> = self.operands.iter().map(|node| values.number(*node as usize)).collect();
        let blank = operands.first().copied().unwrap_or_else(S::zero);
        let mut results = vec![blank; self.callee.n_output()];
        match &self.callee {
            Callee::Custom(operation) => S::call(operation, &operands, &mut results),
            // where calls are recorded, a function again
            Callee::Function(function) => {
                S::begin_function();
                function.recording().evaluate(&operands, &mut results);
                S::end_function(&mut results);
            }
        }
        results
    }
}

#[cfg(test)]
mod tests;
