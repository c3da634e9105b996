//! A recording computed node by node, as it was recorded: the witness of programs, which share no line with it.

use super::Recording;
use super::graph::{Call, Callee, Node};
use crate::{Mask, Scalar};

/// What a node came to.
#[derive(Clone, Copy)]
enum Value<S: Scalar> {
    Number(S),
    Truth(S::Mask),
}

impl Recording {
    /// Results of inputs on any scalar, node by node: nothing is fused, moved or left out. Slow.
    ///
    /// # Panics
    /// For another number of inputs or outputs.
    pub fn evaluate<S: Scalar>(&self, inputs: &[S], outputs: &mut [S]) {
        let counts = (inputs.len(), outputs.len());
        assert_eq!(counts, (self.n_input(), self.n_output()), "inputs and outputs of the recording");
        let mut values: Vec<Value<S>> = Vec::with_capacity(self.nodes.len());
        let mut results = Vec::new();
        for node in &self.nodes {
            let value = match *node {
                Node::Call(number) => {
                    results = self.calls[number as usize].evaluated(&values);
                    Value::Number(S::zero()) // read by its results alone
                }
                Node::Result(_, k) => Value::Number(results[k as usize]),
                node => node.evaluated(inputs, &values),
            };
            values.push(value);
        }
        for (output, node) in outputs.iter_mut().zip(&self.outputs) {
            *output = number(&values, *node);
        }
    }
}

fn number<S: Scalar>(values: &[Value<S>], node: u32) -> S {
    match values[node as usize] {
        Value::Number(x) => x,
        Value::Truth(mask) => S::select(mask, S::one(), S::zero()),
    }
}

fn truth<S: Scalar>(values: &[Value<S>], node: u32) -> S::Mask {
    match values[node as usize] {
        Value::Number(x) => S::constant(0.5).lt(x),
        Value::Truth(mask) => mask,
    }
}

impl Node {
    fn evaluated<S: Scalar>(self, inputs: &[S], values: &[Value<S>]) -> Value<S> {
        use Node::*;
        let x = |node| number(values, node);
        let mask = |node| truth(values, node);
        Value::Number(match self {
            Input(k) => inputs[k as usize],
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
            Call(_) | Result(..) => unreachable!("of calls"),
        })
    }
}

impl Call {
    fn evaluated<S: Scalar>(&self, values: &[Value<S>]) -> Vec<S> {
        let operands: Vec<S> = self.operands.iter().map(|node| number(values, *node)).collect();
        let mut results = vec![S::zero(); self.callee.n_output()];
        match &self.callee {
            Callee::Custom(operation) => S::call(operation, &operands, &mut results),
            Callee::Function(function) => function.recording().evaluate(&operands, &mut results),
        }
        results
    }
}
