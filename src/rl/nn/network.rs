//! What a network is to those that train it: numbers in, numbers out, one array of parameters, gradients by hand.
//!
//! A row goes in and a row comes out; rows have nothing to do with each other. Networks of networks are networks too, so
//! whoever descends a gradient needs to know none of them by name.

use super::aligned::Aligned;
use super::graph::{LayerGraph, ValueSpan};
use super::mlp::Mlp;
use super::product::padded;
use super::stack::Stack;
use base::error::{Error, Result};
use rng::Stream;
use std::fmt::Debug;
use std::sync::Arc;

/// Who gives the numbers of a tensor for its name and shape.
pub type Named<'a> = dyn FnMut(&str, &[usize]) -> Result<Vec<f32>> + 'a;

/// A function of rows with parameters, and its gradient.
///
/// A network with memory is a function of one step: the last [`n_state`](Network::n_state) numbers of an input row are the
/// state before it, and as many at the end of an output row the state behind it. Who flies it begins with zeros and hands
/// the state on; gradients through time are sums over such steps.
///
/// ```
/// # use omnidrones_rl::omnidrones;
/// use omnidrones::rl::nn::{Gru, Network};
/// use omnidrones::rng::{Purpose, Stream};
///
/// let gru = Gru::new(3, 8)?; // two steps of one row, from nothing remembered
/// let weights = gru.init(&mut Stream::new(7, 0, 0, Purpose::LEARNING));
/// let mut memory = gru.memory(1);
/// let (mut row, mut state) = (vec![0.5; 3 + 8], vec![0.0; 8]);
/// for _ in 0..2 {
///     row[3..].copy_from_slice(&state);
///     state.copy_from_slice(gru.forward(&weights, &row, 1, &mut memory).row(0));
/// }
/// assert!(state.iter().all(|h| h.abs() < 1.0));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
pub trait Network: Debug + Send + Sync {
    /// Numbers of an input row, those of the state included.
    fn n_input(&self) -> usize;

    /// Numbers of an output row, those of the state included.
    fn n_output(&self) -> usize;

    /// Numbers that it hands on from step to step.
    fn n_state(&self) -> usize {
        0
    }

    /// Numbers of the parameters, padding of rows included.
    fn n_parameter(&self) -> usize;

    /// Numbers that a forward pass keeps per row.
    fn n_activation(&self) -> usize;

    /// Where its named tensors stand among the parameters.
    fn slots(&self) -> Vec<Slot>;

    /// First parameters.
    fn init(&self, stream: &mut Stream) -> Vec<f32>;

    /// Memory for forward passes of up to `rows` rows at once.
    fn memory(&self, rows: usize) -> Memory;

    /// What backward passes of up to `rows` rows work in.
    fn scratch(&self, rows: usize) -> Scratch;

    /// Weights as [`Network::backward`] reads them: pack them once per update.
    fn transpose(&self, parameters: &[f32], transposed: &mut Transposed);

    /// Outputs of `rows` rows of `[rows, n_input]`; `memory` keeps what [`Network::backward`] needs.
    ///
    /// # Panics
    /// For more rows than the memory was made for, or an input of another length.
    fn forward<'m>(&self, parameters: &[f32], x: &[f32], rows: usize, memory: &'m mut Memory) -> Output<'m>;

    /// Adds to the gradient the one of Σ `grad_output` · output over the rows of the forward pass that `memory` and `x` are
    /// of, and writes that of the input; either may be empty and is then left out. `grad_output`: `[rows, n_output]`.
    ///
    /// # Panics
    /// As [`Network::forward`].
    fn backward(&self, net: Weights<'_>, x: &[f32], rows: usize, memory: &Memory, grad_output: &[f32], pass: Pass<'_>);

    /// Adds to `graph` what it makes of what is seen at `x` and remembered at `h`: where its outputs stand, and the state behind it.
    fn describe(&self, parameters: &[f32], graph: &mut LayerGraph, x: &ValueSpan, h: &ValueSpan) -> [ValueSpan; 2];

    /// The perceptron that it is, if it is nothing else.
    fn as_mlp(&self) -> Option<&Mlp> {
        None
    }

    /// The network of networks that it is, if it is one.
    fn as_stack(&self) -> Option<&Stack> {
        None
    }

    /// Share of the hidden units under tanh with |y| > `limit` in the memory's last forward pass; 0 where there are none.
    fn saturated(&self, _memory: &Memory, _rows: usize, _limit: f32) -> f64 {
        0.0
    }

    /// Sets of parameters, which rows take in turn: more than one where agents have networks of their own.
    fn n_set(&self) -> usize {
        1
    }

    /// The last bias at which an output is `y` where all weights are zero.
    fn bias_for(&self, y: f64) -> f64 {
        y
    }

    /// Numbers that are learnt.
    fn n_weight(&self) -> usize {
        self.slots().iter().map(|slot| slot.shape.iter().product::<usize>()).sum()
    }

    /// The named tensors of the parameters, as checkpoints hold them.
    fn parts(&self, parameters: &[f32]) -> Vec<NamedTensor> {
        self.slots().into_iter().map(|slot| slot.tensor(parameters)).collect()
    }

    /// The reverse of [`Network::parts`]: `part` is asked for each name and shape.
    ///
    /// # Errors
    /// What `part` says; [`Error::Value`] for another number of values or one that is not finite.
    #[expect(clippy::wrong_self_convention, reason = "the reverse of `parts`, by the name that it has in `Mlp`")]
    fn from_parts(&self, part: &mut Named<'_>) -> Result<Vec<f32>> {
        let mut parameters = vec![0.0; self.n_parameter()];
        for slot in self.slots() {
            slot.put(part(&slot.name, &slot.shape)?, &mut parameters)?;
        }
        Ok(parameters)
    }
}

/// Shared, so that whoever acts and whoever learns may hold the same one.
#[rustfmt::skip]
impl<N: Network + ?Sized> Network for Arc<N> {
    fn n_input(&self) -> usize { (**self).n_input() }
    fn n_output(&self) -> usize { (**self).n_output() }
    fn n_state(&self) -> usize { (**self).n_state() }
    fn n_parameter(&self) -> usize { (**self).n_parameter() }
    fn n_activation(&self) -> usize { (**self).n_activation() }
    fn slots(&self) -> Vec<Slot> { (**self).slots() }
    fn init(&self, stream: &mut Stream) -> Vec<f32> { (**self).init(stream) }
    fn memory(&self, rows: usize) -> Memory { (**self).memory(rows) }
    fn scratch(&self, rows: usize) -> Scratch { (**self).scratch(rows) }
    fn transpose(&self, parameters: &[f32], transposed: &mut Transposed) { (**self).transpose(parameters, transposed); }
    fn forward<'m>(&self, parameters: &[f32], x: &[f32], rows: usize, memory: &'m mut Memory) -> Output<'m> {
        (**self).forward(parameters, x, rows, memory)
    }
    fn backward(&self, net: Weights<'_>, x: &[f32], rows: usize, memory: &Memory, grad_output: &[f32], pass: Pass<'_>) {
        (**self).backward(net, x, rows, memory, grad_output, pass);
    }
    fn describe(&self, parameters: &[f32], graph: &mut LayerGraph, x: &ValueSpan, h: &ValueSpan) -> [ValueSpan; 2] {
        (**self).describe(parameters, graph, x, h)
    }
    fn as_mlp(&self) -> Option<&Mlp> { (**self).as_mlp() }
    fn as_stack(&self) -> Option<&Stack> { (**self).as_stack() }
    fn saturated(&self, memory: &Memory, rows: usize, limit: f32) -> f64 { (**self).saturated(memory, rows, limit) }
    fn n_set(&self) -> usize { (**self).n_set() }
    fn bias_for(&self, y: f64) -> f64 { (**self).bias_for(y) }
}

/// Where a named tensor stands among the parameters of a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Slot {
    /// `0.weight`, `memory.bias_hh`.
    pub name: String,
    /// `[out, …]` or `[out]`.
    pub shape: Vec<usize>,
    start: usize,
    /// Numbers out that stand together before padding follows.
    block: usize,
}

impl Slot {
    /// A matrix `[in, padded out]` for a tensor of `shape`, whose first axis is `out`. Where `out` is several blocks of
    /// `block`, each is padded.
    pub(crate) fn new(name: impl Into<String>, shape: Vec<usize>, start: usize, block: usize) -> Self {
        Self { name: name.into(), shape, start, block }
    }

    /// The same as part of a network: under `part`, `memory.` for one, with parameters from `offset` on.
    pub(crate) fn of(self, part: &str, offset: usize) -> Self {
        Self { name: part.to_string() + &self.name, start: self.start + offset, ..self }
    }

    /// Place of number `at` of the tensor, row-major.
    fn place(&self, at: usize) -> usize {
        let n_in = self.shape[1..].iter().product::<usize>();
        let (out, column) = (at / n_in, at % n_in);
        let width = self.shape[0].div_ceil(self.block) * padded(self.block);
        self.start + column * width + out / self.block * padded(self.block) + out % self.block
    }

    fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Places of the numbers of the tensor's row `k` among the parameters.
    pub(crate) fn row(&self, k: usize) -> impl Iterator<Item = usize> + '_ {
        let n = self.len() / self.shape[0];
        (k * n..(k + 1) * n).map(|at| self.place(at))
    }

    /// Writes numbers of the tensor, row-major.
    pub(crate) fn fill(&self, data: impl Iterator<Item = f32>, parameters: &mut [f32]) {
        data.enumerate().for_each(|(at, x)| parameters[self.place(at)] = x);
    }

    fn tensor(self, parameters: &[f32]) -> NamedTensor {
        let data = (0..self.len()).map(|at| parameters[self.place(at)]).collect();
        NamedTensor { name: self.name, shape: self.shape, data }
    }

    pub(crate) fn put(&self, data: Vec<f32>, parameters: &mut [f32]) -> Result<()> {
        if data.len() != self.len() {
            let (got, limit) = (data.len(), self.len().to_string());
            return Err(Error::value(format!("numbers of {}", self.name), got, limit, "Load another policy."));
        }
        if let Some(x) = data.iter().find(|x| !x.is_finite()) {
            return Err(Error::value(format!("a number of {}", self.name), x, "finite", "Load another policy."));
        }
        self.fill(data.into_iter(), parameters);
        Ok(())
    }
}

/// A named part of the parameters, as checkpoints hold it.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedTensor {
    /// `0.weight`, `0.bias`, `0.norm.weight`, `0.norm.bias`.
    pub name: String,
    /// `[out, in]` or `[out]`.
    pub shape: Vec<usize>,
    /// Row-major.
    pub data: Vec<f32>,
}

/// A network's numbers for a backward pass.
#[derive(Debug, Clone, Copy)]
pub struct Weights<'a> {
    /// As the forward pass used them.
    pub parameters: &'a [f32],
    /// Of the same, by [`Network::transpose`].
    pub transposed: &'a Transposed,
}

/// Where a backward pass writes.
#[derive(Debug)]
pub struct Pass<'a> {
    /// Added to; as long as the parameters, or empty.
    pub gradient: &'a mut [f32],
    /// `[rows, n_input]`, or empty.
    pub grad_input: &'a mut [f32],
    /// Of the same network.
    pub scratch: &'a mut Scratch,
}

/// What a backward pass works in: one for all that follow each other, so that it stays in cache.
#[derive(Debug, Clone, Default)]
pub struct Scratch {
    /// Gradients of what a layer gives, and of what it takes.
    pub(super) d: Aligned,
    pub(super) before: Aligned,
    /// Gradient of a narrow last layer's weights, [n_out, padded n_in].
    pub(super) transposed: Aligned,
    /// What else a network needs.
    pub(super) more: Vec<Aligned>,
    /// Of the networks within.
    pub(super) parts: Vec<Scratch>,
}

/// Transposed weights, layer by layer.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Transposed {
    pub(super) layers: Vec<Aligned>,
    /// Of the networks within.
    pub(super) parts: Vec<Transposed>,
}

impl Transposed {
    /// Takes over weights `[n_in, wide]` of layer `l` as `[n_out, padded n_in]`; `column` says where a number out stands in a
    /// row.
    pub(super) fn put(
        &mut self,
        l: usize,
        weight: &[f32],
        (n_in, n_out, wide): (usize, usize, usize),
        column: impl Fn(usize) -> usize,
    ) {
        let tall = padded(n_in);
        if self.layers.len() <= l {
            self.layers.resize(l + 1, Aligned::default());
        }
        let out = &mut self.layers[l];
        if out.len() != n_out * tall {
            *out = Aligned::zeros(n_out * tall);
        }
        for (o, row) in out.chunks_exact_mut(tall).enumerate().take(n_out) {
            let weight = &weight[column(o)..];
            row.iter_mut().zip(weight.iter().step_by(wide)).take(n_in).for_each(|(t, w)| *t = *w);
        }
    }
}

impl std::ops::Index<usize> for Transposed {
    type Output = [f32];
    fn index(&self, layer: usize) -> &[f32] {
        &self.layers[layer]
    }
}

#[derive(Debug, Clone, Default)]
pub(super) struct Level {
    /// What the layer gave, [rows, wide].
    pub y: Aligned,
    /// (z − mean)/deviation, where the layer is normalised.
    pub normal: Aligned,
    /// 1/deviation of every row.
    pub scale: Vec<f32>,
}

impl Level {
    /// For so many numbers without a norm.
    pub(super) fn of(n: usize) -> Self {
        Self { y: Aligned::zeros(n), ..Self::default() }
    }
}

/// What one forward pass leaves for the backward pass.
#[derive(Debug, Clone, Default)]
pub struct Memory {
    pub(super) levels: Vec<Level>,
    /// Of the networks within.
    pub(super) parts: Vec<Memory>,
}

/// Rows that a network gave.
#[derive(Debug, Clone, Copy)]
pub struct Output<'m> {
    pub(super) data: &'m [f32],
    pub(super) n: usize,
    pub(super) wide: usize,
}

impl<'m> Output<'m> {
    /// Rows of `n` numbers each, `wide` apart.
    pub(crate) fn new(data: &'m [f32], n: usize, wide: usize) -> Self {
        Self { data, n, wide }
    }

    /// One row.
    pub fn row(&self, row: usize) -> &'m [f32] {
        &self.data[row * self.wide..][..self.n]
    }

    /// The first `n` numbers of every row.
    pub fn first(self, n: usize) -> Self {
        Self { n: n.min(self.n), ..self }
    }

    /// All rows without padding.
    pub fn write(&self, rows: &mut [f32]) {
        for (own, row) in rows.chunks_exact_mut(self.n).zip(self.data.chunks_exact(self.wide)) {
            own.copy_from_slice(&row[..self.n]);
        }
    }
}
