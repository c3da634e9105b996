//! A network as a list of layers, without padding, packing and rows side by side: what text of other languages is written from.
//!
//! Every network describes itself ([`Network::describe`]). A graph has **values**, each an array that one node writes: value 0 is what
//! is seen, value 1 what is remembered, value k + 2 what node k gives. Nodes read **spans** of values, so that a slice costs nothing.
//!
//! [`LayerGraph::evaluate`] is the definition of what other languages compute, in plain order: a sum begins with the bias and goes over
//! inputs in order, and every product and every sum is rounded. [`Network::forward`] rounds otherwise.

use super::activation::{Activation, LEAK};
use super::network::Network;
use super::set::Pool;
use autodiff::{Mask, Scalar};
use std::ops::Range;

/// Some numbers of a value, one behind the other.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct ValueSpan {
    /// Which value.
    pub value: usize,
    /// Its numbers.
    pub columns: Range<usize>,
}

impl ValueSpan {
    /// Nothing.
    pub const NONE: Self = Self { value: SEEN, columns: 0..0 };

    /// Some of these numbers.
    pub fn part(&self, columns: Range<usize>) -> Self {
        Self { value: self.value, columns: self.columns.start + columns.start..self.columns.start + columns.end }
    }

    /// How many numbers.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }
}

/// The value that is seen.
pub const SEEN: usize = 0;
/// The value that is remembered.
pub const REMEMBERED: usize = 1;
/// The value of the first node.
pub const FIRST_NODE: usize = 2;

/// Sizes of a layer of a convolution. Shapes are height, width and channels; numbers of a pixel stand together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ConvShape {
    /// What it sees.
    pub from: [usize; 3],
    /// What it gives.
    pub to: [usize; 3],
    /// Pixels of a patch, down and across.
    pub kernel: [usize; 2],
    /// Pixels from one patch to the next.
    pub stride: usize,
}

/// What a node computes. Weights are row-major, `[out, in]`.
#[derive(Debug, Clone, PartialEq)]
pub enum LayerKind {
    /// b + W x of every row.
    Dense {
        /// W, `[out, in]`.
        weight: Vec<f32>,
        /// b.
        bias: Vec<f32>,
    },
    /// gain (x − mean)/√(variance + ε) + shift of every row.
    LayerNorm {
        /// Of each number.
        gain: Vec<f32>,
        /// Of each number.
        shift: Vec<f32>,
        /// ε.
        epsilon: f32,
    },
    /// f of every number.
    Activation(Activation),
    /// The state h′ of a gated recurrent unit behind x and h ([`Gru`](super::Gru)); gates in the order r, z, n.
    Gru {
        /// `[3 units, seen]`.
        weight_ih: Vec<f32>,
        /// `[3 units, units]`.
        weight_hh: Vec<f32>,
        /// `[3 units]`.
        bias_ih: Vec<f32>,
        /// `[3 units]`.
        bias_hh: Vec<f32>,
    },
    /// b + the sum of weights times pixels, of every patch ([`Conv`](super::Conv)).
    Conv {
        /// Sizes.
        shape: ConvShape,
        /// `[out, down, across, in]`.
        weight: Vec<f32>,
        /// b.
        bias: Vec<f32>,
    },
    /// Mean or largest of each number over the rows.
    Pool(Pool),
    /// All inputs one behind the other.
    Concat,
    /// The sum of all inputs, in order.
    Sum,
}

impl LayerKind {
    /// Numbers that were learnt, by name.
    pub fn weights(&self) -> Vec<(&'static str, &[f32])> {
        match self {
            Self::Dense { weight, bias } | Self::Conv { weight, bias, .. } => vec![("weight", weight), ("bias", bias)],
            Self::LayerNorm { gain, shift, .. } => vec![("gain", gain), ("shift", shift)],
            Self::Gru { weight_ih, weight_hh, bias_ih, bias_hh } => {
                vec![("weight_ih", weight_ih), ("weight_hh", weight_hh), ("bias_ih", bias_ih), ("bias_hh", bias_hh)]
            }
            Self::Activation(_) | Self::Pool(_) | Self::Concat | Self::Sum => Vec::new(),
        }
    }
}

/// One layer of a graph.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerNode {
    /// What it computes.
    pub kind: LayerKind,
    /// Rows that it reads, one behind the other, each by itself; more than one for members of a set.
    pub rows: usize,
    /// Numbers of a row that it gives.
    pub width: usize,
    /// What it reads.
    pub inputs: Vec<ValueSpan>,
}

impl LayerNode {
    /// Numbers that it gives.
    pub fn n_output(&self) -> usize {
        if matches!(self.kind, LayerKind::Pool(_)) { self.width } else { self.rows * self.width }
    }
}

/// A network with its weights, layer by layer.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerGraph {
    /// Numbers that it sees.
    pub n_input: usize,
    /// Numbers that it remembers.
    pub n_state: usize,
    /// In the order in which they are computed.
    pub nodes: Vec<LayerNode>,
    /// What it gives.
    pub output: ValueSpan,
    /// What is remembered next.
    pub state: ValueSpan,
    set: usize,
}

impl LayerGraph {
    /// Of a network with its parameters; of agent `set`, where agents have networks of their own.
    pub fn of(network: &dyn Network, parameters: &[f32], set: usize) -> Self {
        let n_state = network.n_state();
        let n_input = network.n_input() - n_state;
        let (output, state) = (ValueSpan::NONE, ValueSpan::NONE);
        let mut own = Self { n_input, n_state, nodes: Vec::new(), output, state, set };
        let seen = ValueSpan { value: SEEN, columns: 0..n_input };
        let remembered = ValueSpan { value: REMEMBERED, columns: 0..n_state };
        [own.output, own.state] = network.describe(parameters, &mut own, &seen, &remembered);
        own
    }

    /// Which agent's network it is.
    pub(super) fn set(&self) -> usize {
        self.set
    }

    /// Adds a node; what it gives.
    pub(super) fn add(&mut self, kind: LayerKind, rows: usize, width: usize, inputs: Vec<ValueSpan>) -> ValueSpan {
        let node = LayerNode { kind, rows, width, inputs };
        let columns = 0..node.n_output();
        self.nodes.push(node);
        ValueSpan { value: FIRST_NODE + self.nodes.len() - 1, columns }
    }

    /// Several spans one behind the other; a single one stays where it is.
    pub(super) fn concat(&mut self, mut inputs: Vec<ValueSpan>) -> ValueSpan {
        if inputs.len() == 1 {
            return inputs.remove(0);
        }
        let n = inputs.iter().map(ValueSpan::len).sum();
        self.add(LayerKind::Concat, 1, n, inputs)
    }

    /// Numbers of the output.
    pub fn n_output(&self) -> usize {
        self.output.len()
    }

    /// Numbers of value `value`.
    pub fn n_value(&self, value: usize) -> usize {
        match value {
            SEEN => self.n_input,
            REMEMBERED => self.n_state,
            node => self.nodes[node - FIRST_NODE].n_output(),
        }
    }

    /// Outputs for one input row; the state goes on. Where a number of the input or of the next state is not finite, the state becomes
    /// 0: one broken observation must not outlive its step.
    ///
    /// # Panics
    /// For slices of other lengths.
    pub fn evaluate<S: Scalar>(&self, input: &[S], state: &mut [S], output: &mut [S]) {
        assert_eq!([input.len(), state.len(), output.len()], [self.n_input, self.n_state, self.n_output()]);
        let mut values = vec![input.to_vec(), state.to_vec()];
        for node in &self.nodes {
            let inputs: Vec<&[S]> = node.inputs.iter().map(|span| &values[span.value][span.columns.clone()]).collect();
            values.push(node.evaluate(&inputs));
        }
        let at = |span: &ValueSpan| &values[span.value][span.columns.clone()];
        output.copy_from_slice(at(&self.output));
        for (h, next) in state.iter_mut().zip(at(&self.state)) {
            *h = *next;
        }
        if self.n_state > 0 {
            let finite = |x: S| (x * S::zero()).lt(S::one());
            let whole = state.iter().chain(input).fold(S::zero().lt(S::one()), |all, x| all.and(finite(*x)));
            state.iter_mut().for_each(|h| *h = S::select(whole, *h, S::zero()));
        }
    }
}

fn constant<S: Scalar>(x: f32) -> S {
    S::constant(f64::from(x))
}

/// bias + Σ weight · x, in order.
fn sum<S: Scalar>(bias: f32, weight: &[f32], x: &[S]) -> S {
    let mut sum = constant::<S>(bias);
    for (w, x) in weight.iter().zip(x) {
        sum += constant::<S>(*w) * *x;
    }
    sum
}

/// σ(x) = ½ + ½ tanh(x/2).
fn sigmoid<S: Scalar>(x: S) -> S {
    let half = S::constant(0.5);
    half + half * (half * x).tanh()
}

impl LayerNode {
    fn evaluate<S: Scalar>(&self, inputs: &[&[S]]) -> Vec<S> {
        let x = inputs[0];
        let rows = || x.chunks_exact(x.len() / self.rows);
        match &self.kind {
            LayerKind::Dense { weight, bias } => {
                let of = |x| dense(weight, bias, x);
                rows().flat_map(of).collect()
            }
            LayerKind::LayerNorm { gain, shift, epsilon } => {
                let of = |x| layer_norm(gain, shift, *epsilon, x);
                rows().flat_map(of).collect()
            }
            LayerKind::Activation(kind) => x.iter().map(|x| activation(*kind, *x)).collect(),
            LayerKind::Gru { weight_ih, weight_hh, bias_ih, bias_hh } => {
                let h = inputs[1];
                let n = h.len();
                let (own, of_state) = (dense(weight_ih, bias_ih, x), dense(weight_hh, bias_hh, h));
                let unit = |o: usize| {
                    let reset = sigmoid(own[o] + of_state[o]);
                    let keep = sigmoid(own[n + o] + of_state[n + o]);
                    let new = (own[2 * n + o] + reset * of_state[2 * n + o]).tanh();
                    new + keep * (h[o] - new)
                };
                (0..n).map(unit).collect()
            }
            LayerKind::Conv { shape, weight, bias } => shape.evaluate(weight, bias, x),
            LayerKind::Pool(kind) => {
                let mut all = rows();
                let mut y = all.next().map_or_else(Vec::new, <[S]>::to_vec);
                for row in all {
                    for (y, x) in y.iter_mut().zip(row) {
                        *y = match kind {
                            Pool::Mean => *y + *x,
                            Pool::Max => S::select(y.lt(*x), *x, *y),
                        };
                    }
                }
                if *kind == Pool::Mean {
                    y.iter_mut().for_each(|y| *y = *y / S::constant(self.rows as f64));
                }
                y
            }
            LayerKind::Concat => inputs.concat(),
            LayerKind::Sum => {
                let mut y = x.to_vec();
                for x in &inputs[1..] {
                    y.iter_mut().zip(*x).for_each(|(y, x)| *y += *x);
                }
                y
            }
        }
    }
}

fn dense<S: Scalar>(weight: &[f32], bias: &[f32], x: &[S]) -> Vec<S> {
    bias.iter().zip(weight.chunks_exact(x.len())).map(|(b, w)| sum(*b, w, x)).collect()
}

fn layer_norm<S: Scalar>(gain: &[f32], shift: &[f32], epsilon: f32, x: &[S]) -> Vec<S> {
    let n = S::constant(x.len() as f64);
    let mut mean = S::zero();
    x.iter().for_each(|x| mean += *x);
    mean = mean / n;
    let mut variance = S::zero();
    x.iter().for_each(|x| variance += (*x - mean) * (*x - mean));
    let scale = S::one() / (variance / n + constant(epsilon)).sqrt();
    let each = x.iter().zip(gain).zip(shift);
    each.map(|((x, gain), shift)| constant::<S>(*gain) * ((*x - mean) * scale) + constant(*shift)).collect()
}

/// What is no number stays so.
fn activation<S: Scalar>(kind: Activation, x: S) -> S {
    let zero = S::zero();
    match kind {
        Activation::Tanh => x.tanh(),
        // what is not selected stays finite, so that slopes do
        Activation::Elu => S::select(x.lt(zero), x.min(zero).exp() - S::one(), x),
        Activation::Relu => S::select(x.lt(zero), zero, x),
        Activation::LeakyRelu => S::select(x.lt(zero), S::constant(LEAK) * x, x),
        Activation::Identity => x,
    }
}

impl ConvShape {
    /// Weights of one channel.
    pub fn n_patch(&self) -> usize {
        self.kernel[0] * self.kernel[1] * self.from[2]
    }

    fn evaluate<S: Scalar>(&self, weight: &[f32], bias: &[f32], x: &[S]) -> Vec<S> {
        let [_, width, channels] = self.from;
        let mut y = Vec::with_capacity(self.to.iter().product());
        for (i, j) in (0..self.to[0]).flat_map(|i| (0..self.to[1]).map(move |j| (i, j))) {
            for (b, w) in bias.iter().zip(weight.chunks_exact(self.n_patch())) {
                let mut total = constant::<S>(*b);
                for (p, w) in w.chunks_exact(self.kernel[1] * channels).enumerate() {
                    let first = ((i * self.stride + p) * width + j * self.stride) * channels;
                    for (w, x) in w.iter().zip(&x[first..]) {
                        total += constant::<S>(*w) * *x;
                    }
                }
                y.push(total);
            }
        }
        y
    }
}

#[cfg(test)]
mod tests {
    use super::super::encoder::{Encoder, Recurrence};
    use super::super::exact::draw;
    use super::super::mlp::{Layers, Mlp};
    use super::super::per_agent::PerAgent;
    use super::super::stack::{Encoded, Join, Stack};
    use super::super::{Conv, Filter, Gru};
    use super::*;
    use std::sync::Arc;

    const ROWS: usize = 6;

    fn layers(activation: Activation, layer_norm: bool) -> Layers {
        Layers { hidden: vec![20, 33], activation, layer_norm, ..Layers::default() }
    }

    /// All of them: who adds one adds it here.
    fn activations() -> [Activation; 5] {
        use Activation::*;
        let all = [Tanh, Elu, Relu, LeakyRelu, Identity];
        all.map(|kind| match kind {
            Tanh | Elu | Relu | LeakyRelu | Identity => kind,
        })
    }

    /// One of each kind, and the shape of what it reads: who adds one adds it here.
    fn encoders() -> Vec<(Encoder, Vec<usize>)> {
        let group = String::new;
        let (fine, coarse) =
            (Filter { channels: 5, kernel: 3, stride: 1 }, Filter { channels: 2, kernel: 2, stride: 2 });
        let filters = vec![fine, coarse];
        let pools = [Pool::Mean, Pool::Max].map(|pool| match pool {
            Pool::Mean | Pool::Max => (Encoder::Set { group: group(), units: vec![9, 6], pool }, vec![4, 5]),
        });
        let own = vec![
            (Encoder::Mlp { group: group(), units: vec![9, 6] }, vec![7]),
            (Encoder::Conv1d { group: group(), layers: filters.clone() }, vec![8, 3]),
            (Encoder::Conv2d { group: group(), layers: filters }, vec![7, 6, 2]),
        ];
        let all: Vec<_> = own.into_iter().chain(pools).collect();
        all.iter().for_each(|(kind, _)| match kind {
            Encoder::Mlp { .. } | Encoder::Conv1d { .. } | Encoder::Conv2d { .. } | Encoder::Set { .. } => (),
        });
        all
    }

    /// A perceptron behind encoders of a row of which four numbers are read by none, with a memory or without.
    fn stack(read: &[(Encoder, Vec<usize>)], layers: &Layers, join: Join, memory: Option<Recurrence>) -> Stack {
        let mut at = 2;
        let encoded = read.iter().map(|(encoder, shape)| {
            let network = encoder.network(shape, layers).unwrap();
            at += network.n_input();
            Encoded { columns: at - network.n_input()..at, network }
        });
        let encoded = encoded.collect();
        let units = memory.as_ref().map(Recurrence::units);
        Stack::new(at + 2, encoded, join, units, |n| Mlp::new(n, layers, 3, Activation::Tanh)).unwrap()
    }

    /// Largest distances of outputs and states of the graph, in `f64` and in `f32`, from those of the network.
    fn far(network: &dyn Network) -> [f64; 2] {
        let mut seed = 0;
        let mut parameter = |_: &str, shape: &[usize]| {
            seed += 1;
            Ok(draw(shape.iter().product(), seed).iter().map(|x| 0.4 * x).collect())
        };
        let parameters = network.from_parts(&mut parameter).unwrap();
        let (n, n_state) = (network.n_input(), network.n_state());
        let rows = ROWS * network.n_set();
        let x = draw(rows * n, 99);
        let mut memory = network.memory(rows);
        let out = network.forward(&parameters, &x, rows, &mut memory);
        let mut worst = [0.0_f64; 2];
        for (k, x) in x.chunks_exact(n).enumerate() {
            let graph = LayerGraph::of(network, &parameters, k % network.n_set());
            let want = out.row(k);
            let wide = row(&graph, &x.iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
            let single: Vec<f64> = row(&graph, x).into_iter().map(f64::from).collect();
            assert!(wide.len() == want.len() && single.len() == want.len() && graph.n_state == n_state);
            for (worst, got) in worst.iter_mut().zip([wide, single]) {
                let each = got.iter().zip(want).map(|(got, want)| (got - f64::from(*want)).abs());
                *worst = each.fold(*worst, f64::max);
            }
        }
        worst
    }

    /// A row `[x, h]` to `[y, h′]`.
    fn row<S: Scalar>(graph: &LayerGraph, x: &[S]) -> Vec<S> {
        let (seen, state) = x.split_at(graph.n_input);
        let (mut output, mut state) = (vec![S::zero(); graph.n_output()], state.to_vec());
        graph.evaluate(seen, &mut state, &mut output);
        [output, state].concat()
    }

    #[test]
    fn graphs_of_perceptrons_are_their_networks_to_rounding_for_every_activation() {
        for kind in activations() {
            for norm in [false, true] {
                let worst = far(&Mlp::new(11, &layers(kind, norm), 4, kind).unwrap());
                println!("{kind:?} {norm}: {worst:?}");
                assert!(worst.iter().all(|far| *far < 2e-5), "{kind:?} {norm}: {worst:?}"); // measured at most 1.8e-6, 2.9e-6
            }
        }
    }

    #[test]
    fn graphs_of_encoders_with_every_join_and_memory_are_their_networks_to_rounding() {
        let gru = Recurrence::Gru { units: 10, window: 4 };
        for memory in [None, Some(gru)] {
            for join in [Join::Concat, Join::Sum].map(|join| match join {
                Join::Concat | Join::Sum => join,
            }) {
                let sums = |n: usize| join == Join::Concat || n == 6;
                let all = encoders().into_iter().filter(|(own, shape)| {
                    let layers = layers(Activation::Elu, true);
                    sums(own.network(shape, &layers).unwrap().n_output())
                });
                let all: Vec<_> = all.collect();
                for read in all.iter().map(std::slice::from_ref).chain([&all[..], &[]]) {
                    let own = stack(read, &layers(Activation::Elu, true), join, memory.clone());
                    let worst = far(&own);
                    println!("{} encoders, {join:?}, {memory:?}: {worst:?}", read.len());
                    assert!(worst.iter().all(|far| *far < 4e-6), "{read:?} {join:?} {memory:?}: {worst:?}"); // measured at most 4.0e-7, 5.2e-7
                }
            }
        }
    }

    #[test]
    fn graphs_of_memories_convolutions_and_teams_are_their_networks_to_rounding() {
        let filters = [Filter { channels: 5, kernel: 3, stride: 2 }, Filter { channels: 2, kernel: 2, stride: 1 }];
        let init = Layers::default().init;
        let mlp: Arc<dyn Network> =
            Arc::new(Mlp::new(5, &layers(Activation::Relu, false), 3, Activation::Tanh).unwrap());
        let all: [Arc<dyn Network>; 4] = [
            Arc::new(Gru::new(7, 9).unwrap()),
            Arc::new(Conv::along(9, 4, &filters, Activation::Tanh, init).unwrap()),
            Arc::new(Conv::over([9, 8, 2], &filters, Activation::Identity, init).unwrap()),
            Arc::new(PerAgent::new(mlp, 3).unwrap()),
        ];
        for network in all {
            let worst = far(&network);
            println!("{worst:?}");
            assert!(worst.iter().all(|far| *far < 1e-5), "{network:?}: {worst:?}"); // measured at most 1.3e-6, 1.5e-6
        }
    }

    #[test]
    fn a_graph_reads_slices_where_they_stand_and_gives_the_widths_that_it_says() {
        let own = stack(&encoders(), &layers(Activation::Tanh, false), Join::Concat, None);
        let graph = LayerGraph::of(&own, &vec![0.0; own.n_parameter()], 0);
        let read: Vec<_> = graph.nodes.iter().flat_map(|node| &node.inputs).collect();
        assert!(read.iter().all(|span| span.columns.end <= graph.n_value(span.value)));
        assert!(read.iter().filter(|span| span.value == SEEN && span.len() < graph.n_input).count() > 5);
        let concats = graph.nodes.iter().filter(|node| node.kind == LayerKind::Concat).count();
        assert_eq!((concats, graph.n_output()), (1, 3));
    }

    #[test]
    fn a_state_that_meets_what_is_not_finite_is_forgotten() {
        let gru = Gru::new(2, 3).unwrap();
        let graph = LayerGraph::of(&gru, &draw(gru.n_parameter(), 1), 0);
        for (x, lost) in [(0.5, false), (f64::NAN, true), (f64::INFINITY, true)] {
            let mut state = [0.1, 0.2, 0.3];
            graph.evaluate(&[0.1, x], &mut state, &mut []);
            assert_eq!(state == [0.0; 3], lost, "{x}: {state:?}");
        }
    }
}
