//! Multi-layer perceptrons: forward into memory of the caller, hand-written backward into one arena of gradients.
//!
//! Every layer is y = f(norm(W x + b)), the last one without norm. All parameters of a network are one array, so that an
//! optimiser, a norm of the gradient or a sum over threads is one loop. A block of rows (64 or so) goes through the whole
//! network before the next one starts: its activations stay in cache.

use super::activation::Activation;
use super::aligned::Aligned;
use super::elementwise::{add_products, add_rows};
use super::encoder::{Encoder, Recurrence};
use super::graph::{LayerGraph, LayerKind, ValueSpan};
use super::init::Init;
use super::layer_norm;
use super::network::{Level, Memory, NamedTensor, Network, Output, Pass, Scratch, Slot, Transposed, Weights};
use super::product::{Begin, Left, PAD, padded, product};
use super::stack::Join;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};
use std::f64::consts::SQRT_2;
use std::ops::Range;

with_defaults! {
    /// What a network is made of.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Layers {
        /// Units of the hidden layers.
        pub hidden: Vec<usize> = vec![64, 64],
        /// Of the hidden layers.
        pub activation: Activation = Activation::Tanh,
        /// Whether hidden layers are normalised before their activation (Ba, Kiros and Hinton 2016).
        pub layer_norm: bool = false,
        /// First weights.
        pub init: Init = Init::default(),
        /// Networks that read groups of the observation before the hidden layers see them; of policies alone.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        pub encoder: Vec<Encoder> = Vec::new(),
        /// What becomes of the outputs of several encoders: `concat` or `sum`.
        #[serde(skip_serializing_if = "Join::is_concat")]
        pub join: Join = Join::Concat,
        /// What is remembered from step to step, before the hidden layers; of policies alone, where the algorithm learns it.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub memory: Option<Recurrence> = None,
    }
}

/// Most units of a layer.
const MAX_UNITS: usize = 8192;
/// Most weights of a network: 128 MiB.
const MAX_WEIGHTS: usize = 1 << 25;
/// Most hidden layers.
const MAX_LAYERS: usize = 32;

impl Layers {
    /// ELU between layers; orthogonal weights, of gain √2 in hidden layers and `last` in the output.
    pub(crate) fn elu(last: f64) -> Self {
        let init = Init::Orthogonal { hidden: SQRT_2, last };
        Self { activation: Activation::Elu, init, ..Self::default() }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Limit`] with the limit, before anything is allocated.
    pub fn validate(&self) -> Result<()> {
        if self.hidden.len() > MAX_LAYERS {
            let limit = format!("{MAX_LAYERS} layers");
            return Err(Error::limit("hidden", self.hidden.len(), limit, "Two or three are usual."));
        }
        if let Some(n) = self.hidden.iter().find(|n| !(1..=MAX_UNITS).contains(*n)) {
            return Err(Error::limit("units of hidden", n, format!("1 to {MAX_UNITS}"), "32 to 256 are usual."));
        }
        self.encoder.iter().try_for_each(Encoder::validate)?;
        self.memory.iter().try_for_each(Recurrence::validate)?;
        self.init.validate()
    }

    /// Whether there are hidden layers and nothing before them.
    pub fn is_plain(&self) -> bool {
        self.encoder.is_empty() && self.memory.is_none()
    }

    /// The hidden layers alone.
    pub(crate) fn plain(&self) -> Self {
        Self { encoder: Vec::new(), memory: None, ..self.clone() }
    }
}

/// One layer's place in the parameters.
#[derive(Debug, Clone, PartialEq)]
struct Layer {
    n_in: usize,
    n_out: usize,
    /// [n_in, padded n_out], the transpose of what papers call W.
    weight: Range<usize>,
    /// [padded n_out].
    bias: Range<usize>,
    /// Gain and shift, [padded n_out] each.
    norm: Option<[Range<usize>; 2]>,
    activation: Activation,
}

impl Layer {
    fn wide(&self) -> usize {
        padded(self.n_out)
    }

    /// Takes the gradient `d` back through the norm, if there is one, and adds those of gain and shift unless `gradient` is
    /// empty.
    fn pull_norm(&self, level: &Level, parameters: &[f32], gradient: &mut [f32], d: &mut [f32]) {
        let Some([gain, shift]) = &self.norm else { return };
        let wide = self.wide();
        if !gradient.is_empty() {
            let of_gain = &mut gradient[gain.start..shift.end];
            let (of_gain, of_shift) = of_gain.split_at_mut(shift.start - gain.start);
            add_products(of_gain, d, &level.normal);
            add_rows(of_shift, d, d.len() / wide);
        }
        layer_norm::pull(d, &level.normal, &level.scale, (wide, self.n_out), &parameters[gain.clone()]);
    }

    /// weight ← weight + (dᵀ x)ᵀ for rows of `x` without gaps; `transposed` holds what is in the brackets.
    fn add_transposed(&self, x: &[f32], d: &[f32], transposed: &mut [f32], weight: &mut [f32]) {
        let (wide, tall) = (self.wide(), padded(self.n_in));
        product(Left::Columns(d, wide), x, Begin::Zero, transposed, (self.n_out, d.len() / wide, tall));
        for (i, row) in weight.chunks_exact_mut(wide).enumerate() {
            row[..self.n_out].iter_mut().zip(transposed[i..].iter().step_by(tall)).for_each(|(w, d)| *w += d);
        }
    }
}

/// The shape of a network; its parameters are an array of the caller.
///
/// ```
/// # use omnidrones_rl::omnidrones;
/// use omnidrones::rl::nn::{Activation, Layers, Mlp};
/// use omnidrones::rng::{Purpose, Stream};
///
/// let mlp = Mlp::new(26, &Layers::default(), 4, Activation::Tanh)?;
/// let weights = mlp.init(&mut Stream::new(7, 0, 0, Purpose::LEARNING));
/// let mut memory = mlp.memory(2);
/// let output = mlp.forward(&weights, &[0.1; 2 * 26], 2, &mut memory);
/// assert_eq!(output.row(0), output.row(1));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Mlp {
    layers: Vec<Layer>,
    n_parameter: usize,
    init: Init,
}

impl Mlp {
    /// A network from `n_in` numbers to `n_out`, the latter through `output`.
    ///
    /// # Errors
    /// As [`Layers::validate`]; [`Error::Limit`] for more than 2²⁵ numbers in, out or learnt; [`Error::Value`] for layers with
    /// encoders or a memory.
    pub fn new(n_in: usize, layers: &Layers, n_out: usize, output: Activation) -> Result<Self> {
        layers.validate()?;
        if !layers.is_plain() {
            let remedy = "Leave encoder and memory to the network of the policy.";
            return Err(Error::value("network", "with encoder or memory", "of hidden layers alone here", remedy));
        }
        let widest = n_in.max(n_out);
        if widest > MAX_WEIGHTS {
            let remedy = "Observations of a few hundred numbers are usual.";
            return Err(Error::limit("numbers into or out of a network", widest, MAX_WEIGHTS, remedy));
        }
        let mut at = 0;
        let mut take = |n: usize| {
            at += n;
            at - n..at
        };
        let widths: Vec<usize> = [n_in].into_iter().chain(layers.hidden.iter().copied()).chain([n_out]).collect();
        let own = widths.windows(2).enumerate().map(|(l, width)| {
            let (n_in, n_out, hidden) = (width[0], width[1], l < layers.hidden.len());
            let wide = padded(n_out);
            Layer {
                n_in,
                n_out,
                weight: take(n_in * wide),
                bias: take(wide),
                norm: (hidden && layers.layer_norm).then(|| [take(wide), take(wide)]),
                activation: if hidden { layers.activation } else { output },
            }
        });
        let layers_own = own.collect();
        if at > MAX_WEIGHTS {
            return Err(Error::limit(
                "weights of a network",
                at,
                MAX_WEIGHTS,
                "Two or three layers of 64 to 256 units are usual.",
            ));
        }
        Ok(Self { layers: layers_own, n_parameter: at, init: layers.init })
    }

    /// Numbers of the parameters, padding of rows included.
    pub fn n_parameter(&self) -> usize {
        self.n_parameter
    }

    /// Numbers that are learnt.
    pub fn n_weight(&self) -> usize {
        self.layers.iter().map(|l| (l.n_in + 1 + if l.norm.is_some() { 2 } else { 0 }) * l.n_out).sum()
    }

    /// Numbers of an input row.
    pub fn n_input(&self) -> usize {
        self.layers[0].n_in
    }

    /// Numbers of an output row.
    pub fn n_output(&self) -> usize {
        self.last().n_out
    }

    /// Numbers that a forward pass keeps per row.
    pub fn n_activation(&self) -> usize {
        self.layers.iter().map(Layer::wide).sum()
    }

    fn last(&self) -> &Layer {
        &self.layers[self.layers.len() - 1]
    }

    /// Of the hidden layers; of the output where there are none.
    pub(crate) fn activation(&self) -> Activation {
        self.layers[0].activation
    }

    /// Whether it has the same layers as `other`, whatever their first weights.
    pub(crate) fn has_layers_of(&self, other: &Self) -> bool {
        self.layers == other.layers
    }

    /// The last bias at which an output is `y` where all weights are zero; tanh at most at ±0.99.
    pub(crate) fn bias_for(&self, y: f64) -> f64 {
        if self.last().activation == Activation::Tanh { y.clamp(-0.99, 0.99).atanh() } else { y }
    }

    /// First parameters; biases are zero.
    pub fn init(&self, stream: &mut Stream) -> Vec<f32> {
        let mut parameters = vec![0.0; self.n_parameter];
        for (l, layer) in self.layers.iter().enumerate() {
            let (wide, is_last) = (layer.wide(), l + 1 == self.layers.len());
            let weights = self.init.draw(layer.n_out, layer.n_in, is_last, stream);
            for (at, w) in weights.into_iter().enumerate() {
                parameters[layer.weight.start + (at % layer.n_in) * wide + at / layer.n_in] = w;
            }
            if let Some([gain, _]) = &layer.norm {
                parameters[gain.start..][..layer.n_out].fill(1.0);
            }
        }
        parameters
    }

    /// Memory for up to `rows` rows at once.
    pub fn memory(&self, rows: usize) -> Memory {
        let level = |layer: &Layer| Level {
            y: Aligned::zeros(rows * layer.wide()),
            normal: Aligned::zeros(if layer.norm.is_some() { rows * layer.wide() } else { 0 }),
            scale: if layer.norm.is_some() { vec![0.0; rows] } else { Vec::new() },
        };
        Memory { levels: self.layers.iter().map(level).collect(), parts: Vec::new() }
    }

    /// What backward passes of up to `rows` rows work in.
    pub fn scratch(&self, rows: usize) -> Scratch {
        let widest = self.layers.iter().map(|l| l.wide().max(padded(l.n_in))).max().unwrap_or(0);
        let narrow = if self.is_narrow() { self.n_output() * padded(self.last().n_in) } else { 0 };
        let [d, before] = [(); 2].map(|()| Aligned::zeros(rows * widest));
        Scratch { d, before, transposed: Aligned::zeros(narrow), ..Scratch::default() }
    }

    /// Whether the last layer has so few outputs that its gradient costs less as the transposed, rows and columns exchanged:
    /// padding falls away.
    fn is_narrow(&self) -> bool {
        self.layers.len() > 1 && 2 * self.n_output() <= PAD
    }

    /// Outputs of `rows` rows of `[rows, n_input]`; `memory` keeps what [`Mlp::backward`] needs.
    ///
    /// # Panics
    /// For more rows than the memory was made for, or an input of another length.
    pub fn forward<'m>(&self, parameters: &[f32], x: &[f32], rows: usize, memory: &'m mut Memory) -> Output<'m> {
        for l in 0..self.layers.len() {
            let layer = &self.layers[l];
            let (before, own) = memory.levels.split_at_mut(l);
            let (x, stride) = input(before, layer, x);
            let level = &mut own[0];
            let (k, wide) = (layer.n_in, layer.wide());
            let begin = Begin::With(&parameters[layer.bias.clone()]);
            let y = &mut level.y[..rows * wide];
            product(Left::Rows(x, stride), &parameters[layer.weight.clone()], begin, y, (rows, k, wide));
            if let Some([gain, shift]) = &layer.norm {
                let [gain, shift] = [&parameters[gain.clone()], &parameters[shift.clone()]];
                layer_norm::normalise(y, &mut level.normal, &mut level.scale, (wide, layer.n_out), (gain, shift));
            }
            layer.activation.apply(y);
        }
        let (n, wide) = (self.n_output(), self.last().wide());
        Output { data: &memory.levels[self.layers.len() - 1].y[..rows * wide], n, wide }
    }

    /// Adds to `gradient` the one of Σ `grad_output` · output over the rows of the forward pass that `memory` and `x` are of, and
    /// writes that of the input to `grad_input` (`[rows, n_input]`); either may be empty and is then left out. `grad_output`:
    /// `[rows, n_output]`.
    ///
    /// # Panics
    /// As [`Mlp::forward`].
    pub fn backward(
        &self,
        net: Weights<'_>,
        x: &[f32],
        rows: usize,
        memory: &Memory,
        grad_output: &[f32],
        pass: Pass<'_>,
    ) {
        let Scratch { d, before, transposed, .. } = pass.scratch;
        let (n_out, wide) = (self.n_output(), self.last().wide());
        for (row, own) in d.chunks_exact_mut(wide).zip(grad_output.chunks_exact(n_out)).take(rows) {
            row[..n_out].copy_from_slice(own);
            row[n_out..].fill(0.0);
        }
        for l in (0..self.layers.len()).rev() {
            let layer = &self.layers[l];
            let (level, x) = (&memory.levels[l], input(&memory.levels[..l], layer, x));
            let d_own = &mut d[..rows * layer.wide()];
            layer.activation.pull(&level.y[..d_own.len()], d_own);
            layer.pull_norm(level, net.parameters, pass.gradient, d_own);
            if !pass.gradient.is_empty() {
                add_rows(&mut pass.gradient[layer.bias.clone()], d_own, rows);
                let weight = &mut pass.gradient[layer.weight.clone()];
                if l > 0 && l + 1 == self.layers.len() && self.is_narrow() {
                    layer.add_transposed(x.0, d_own, transposed, weight);
                } else {
                    product(Left::Columns(x.0, x.1), d_own, Begin::Add, weight, (layer.n_in, rows, layer.wide()));
                }
            }
            if l == 0 && pass.grad_input.is_empty() {
                break;
            }
            let shape = (rows, layer.n_out, padded(layer.n_in));
            product(Left::Rows(d_own, layer.wide()), &net.transposed[l], Begin::Zero, before, shape);
            std::mem::swap(d, before);
        }
        if !pass.grad_input.is_empty() {
            let (n, wide) = (self.n_input(), padded(self.n_input()));
            for (own, row) in pass.grad_input.chunks_exact_mut(n).zip(d.chunks_exact(wide)).take(rows) {
                own.copy_from_slice(&row[..n]);
            }
        }
    }

    /// Weights as [`Mlp::backward`] reads them: pack them once per update.
    pub fn transpose(&self, parameters: &[f32], transposed: &mut Transposed) {
        for (l, layer) in self.layers.iter().enumerate() {
            let shape = (layer.n_in, layer.n_out, layer.wide());
            transposed.put(l, &parameters[layer.weight.clone()], shape, |o| o);
        }
    }

    /// Where its named tensors stand among the parameters: `0.weight` and `0.bias` of the first layer, `0.norm.weight` and
    /// `0.norm.bias` of its norm, and so on.
    pub fn slots(&self) -> Vec<Slot> {
        let mut slots = Vec::new();
        for (l, layer) in self.layers.iter().enumerate() {
            let n = layer.n_out;
            let mut slot = |name: &str, shape, at: &Range<usize>| {
                slots.push(Slot::new(format!("{l}.{name}"), shape, at.start, n));
            };
            slot("weight", vec![n, layer.n_in], &layer.weight);
            slot("bias", vec![n], &layer.bias);
            if let Some([gain, shift]) = &layer.norm {
                slot("norm.weight", vec![n], gain);
                slot("norm.bias", vec![n], shift);
            }
        }
        slots
    }

    /// Parameters by name.
    pub fn parts(&self, parameters: &[f32]) -> Vec<NamedTensor> {
        Network::parts(self, parameters)
    }

    /// The reverse of [`Mlp::parts`]: `part` is asked for each name and shape.
    ///
    /// # Errors
    /// What `part` says; [`Error::Value`] for another number of values or one that is not finite.
    pub fn from_parts(&self, mut part: impl FnMut(&str, &[usize]) -> Result<Vec<f32>>) -> Result<Vec<f32>> {
        Network::from_parts(self, &mut part)
    }

    /// Adds its layers to `graph`, each for `rows` rows at `x` one behind the other; where the outputs stand.
    pub(super) fn describe_rows(
        &self,
        parameters: &[f32],
        graph: &mut LayerGraph,
        rows: usize,
        x: &ValueSpan,
    ) -> ValueSpan {
        let mut tensors = self.parts(parameters).into_iter().map(|tensor| tensor.data);
        let mut take = || tensors.next().unwrap_or_default();
        let mut x = x.clone();
        for layer in &self.layers {
            let mut then = |kind, x: &ValueSpan| graph.add(kind, rows, layer.n_out, vec![x.clone()]);
            x = then(LayerKind::Dense { weight: take(), bias: take() }, &x);
            if layer.norm.is_some() {
                x = then(LayerKind::LayerNorm { gain: take(), shift: take(), epsilon: layer_norm::NORM_FLOOR }, &x);
            }
            if layer.activation != Activation::Identity {
                x = then(LayerKind::Activation(layer.activation), &x);
            }
        }
        x
    }

    /// Share of the hidden units under tanh with |y| > `limit` in the memory's last forward pass; 0 where there are none.
    /// Other activations do not saturate.
    pub fn saturated(&self, memory: &Memory, rows: usize, limit: f32) -> f64 {
        let (mut beyond, mut all) = (0, 0);
        let hidden = self.layers.iter().zip(&memory.levels).take(self.layers.len() - 1);
        for (layer, level) in hidden.filter(|(layer, _)| layer.activation == Activation::Tanh) {
            for row in level.y.chunks_exact(layer.wide()).take(rows) {
                beyond += row[..layer.n_out].iter().filter(|y| y.abs() > limit).count();
                all += layer.n_out;
            }
        }
        beyond as f64 / f64::from(all.max(1) as u32)
    }
}

#[rustfmt::skip]
impl Network for Mlp {
    fn n_input(&self) -> usize { Self::n_input(self) }
    fn n_output(&self) -> usize { Self::n_output(self) }
    fn n_parameter(&self) -> usize { self.n_parameter }
    fn n_activation(&self) -> usize { Self::n_activation(self) }
    fn slots(&self) -> Vec<Slot> { Self::slots(self) }
    fn init(&self, stream: &mut Stream) -> Vec<f32> { Self::init(self, stream) }
    fn memory(&self, rows: usize) -> Memory { Self::memory(self, rows) }
    fn scratch(&self, rows: usize) -> Scratch { Self::scratch(self, rows) }
    fn transpose(&self, parameters: &[f32], transposed: &mut Transposed) { Self::transpose(self, parameters, transposed); }
    fn forward<'m>(&self, parameters: &[f32], x: &[f32], rows: usize, memory: &'m mut Memory) -> Output<'m> {
        Self::forward(self, parameters, x, rows, memory)
    }
    fn backward(&self, net: Weights<'_>, x: &[f32], rows: usize, memory: &Memory, grad_output: &[f32], pass: Pass<'_>) {
        Self::backward(self, net, x, rows, memory, grad_output, pass);
    }
    fn describe(&self, parameters: &[f32], graph: &mut LayerGraph, x: &ValueSpan, _: &ValueSpan) -> [ValueSpan; 2] {
        [self.describe_rows(parameters, graph, 1, x), ValueSpan::NONE]
    }
    fn as_mlp(&self) -> Option<&Mlp> { Some(self) }
    fn saturated(&self, memory: &Memory, rows: usize, limit: f32) -> f64 { Self::saturated(self, memory, rows, limit) }
    fn bias_for(&self, y: f64) -> f64 { Self::bias_for(self, y) }
}

/// What a layer behind these levels takes in, and from row to row; `x` is what the network does.
fn input<'a>(before: &'a [Level], layer: &Layer, x: &'a [f32]) -> (&'a [f32], usize) {
    match before.last() {
        None => (x, layer.n_in),
        Some(level) => (&level.y, padded(layer.n_in)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::Purpose;

    fn stream() -> Stream {
        Stream::new(3, 0, 0, Purpose::user(3))
    }

    fn layers(activation: Activation, layer_norm: bool) -> Layers {
        Layers { hidden: vec![20, 33], activation, layer_norm, ..Layers::default() }
    }

    /// The network in f64, from its named parts.
    fn exact(mlp: &Mlp, parameters: &[f32], nudge: &dyn Fn(usize, usize) -> f64, x: &[f64]) -> Vec<f64> {
        let parts = mlp.parts(parameters);
        let mut x = x.to_vec();
        for (l, layer) in mlp.layers.iter().enumerate() {
            let of = |name: &str| parts.iter().position(|p| p.name == format!("{l}.{name}"));
            let number = |p: usize, at: usize| f64::from(parts[p].data[at]) + nudge(p, at);
            let (w, b) = (of("weight").unwrap(), of("bias").unwrap());
            let mut z: Vec<f64> = (0..layer.n_out)
                .map(|o| number(b, o) + (0..layer.n_in).map(|i| number(w, o * layer.n_in + i) * x[i]).sum::<f64>())
                .collect();
            if let (Some(gain), Some(shift)) = (of("norm.weight"), of("norm.bias")) {
                let mean = z.iter().sum::<f64>() / z.len() as f64;
                let variance = z.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / z.len() as f64;
                let scale = 1.0 / (variance + f64::from(layer_norm::NORM_FLOOR)).sqrt();
                z = z
                    .iter()
                    .enumerate()
                    .map(|(o, z)| number(gain, o) * (z - mean) * scale + number(shift, o))
                    .collect();
            }
            x = z
                .into_iter()
                .map(|z| match layer.activation {
                    Activation::Tanh => z.tanh(),
                    Activation::Elu => {
                        if z > 0.0 {
                            z
                        } else {
                            z.exp_m1()
                        }
                    }
                    Activation::Relu => z.max(0.0),
                    Activation::LeakyRelu => {
                        if z > 0.0 {
                            z
                        } else {
                            0.01 * z
                        }
                    }
                    Activation::Identity => z,
                })
                .collect();
        }
        x
    }

    #[test]
    fn gradients_are_differences_of_the_same_network_in_f64() {
        let (n_in, n_out, rows) = (7, 3, 5);
        for (activation, norm) in [
            (Activation::Tanh, false),
            (Activation::Elu, true),
            (Activation::LeakyRelu, true),
            (Activation::Relu, false),
        ] {
            let mlp = Mlp::new(n_in, &layers(activation, norm), n_out, Activation::Tanh).unwrap();
            let mut s = stream();
            let mut p = mlp.init(&mut s);
            let named = mlp.parts(&p);
            p = mlp
                .from_parts(|name, _| {
                    let part = named.iter().find(|part| part.name == name).unwrap();
                    Ok(part.data.iter().map(|x| x + 0.3 * s.normal() as f32).collect())
                })
                .unwrap();
            let x: Vec<f32> = (0..rows * n_in).map(|_| s.normal() as f32).collect();
            let grad_output: Vec<f32> = (0..rows * n_out).map(|_| s.normal() as f32).collect();
            let mut memory = mlp.memory(rows);
            let out = mlp.forward(&p, &x, rows, &mut memory);
            let value = |nudge: &dyn Fn(usize, usize) -> f64, move_x: &dyn Fn(usize) -> f64| {
                let each = (0..rows).map(|r| {
                    let x: Vec<f64> = (0..n_in).map(|i| f64::from(x[r * n_in + i]) + move_x(r * n_in + i)).collect();
                    let y = exact(&mlp, &p, nudge, &x);
                    y.iter().zip(&grad_output[r * n_out..]).map(|(y, u)| y * f64::from(*u)).sum::<f64>()
                });
                each.sum::<f64>()
            };
            for r in 0..rows {
                let x: Vec<f64> = x[r * n_in..][..n_in].iter().map(|x| f64::from(*x)).collect();
                for (got, want) in out.row(r).iter().zip(exact(&mlp, &p, &|_, _| 0.0, &x)) {
                    assert!((f64::from(*got) - want).abs() < 3e-6, "{activation:?}: {got} {want}"); // measured 4e-7
                }
            }
            let (mut gradient, mut grad_input, mut transposed) =
                (vec![0.0; p.len()], vec![0.0; x.len()], Transposed::default());
            mlp.transpose(&p, &mut transposed);
            let net = Weights { parameters: &p, transposed: &transposed };
            let mut scratch = mlp.scratch(rows);
            let pass = Pass { gradient: &mut gradient, grad_input: &mut grad_input, scratch: &mut scratch };
            mlp.backward(net, &x, rows, &memory, &grad_output, pass);
            let mut worst: f64 = 0.0;
            let h = 1e-5;
            for (q, part) in mlp.parts(&gradient).iter().enumerate() {
                for (at, got) in part.data.iter().enumerate().step_by(3) {
                    let shifted = |h: f64| value(&|p, a| if (p, a) == (q, at) { h } else { 0.0 }, &|_| 0.0);
                    let want = (shifted(h) - shifted(-h)) / (2.0 * h);
                    worst = worst.max((f64::from(*got) - want).abs() / want.abs().max(1.0));
                }
            }
            for (at, got) in grad_input.iter().enumerate() {
                let shifted = |h: f64| value(&|_, _| 0.0, &|a| if a == at { h } else { 0.0 });
                let want = (shifted(h) - shifted(-h)) / (2.0 * h);
                worst = worst.max((f64::from(*got) - want).abs() / want.abs().max(1.0));
            }
            println!("{activation:?} {norm}: {worst:.1e}");
            assert!(worst < 2e-5, "{activation:?}: {worst:e}"); // measured at most 3e-6
        }
    }

    #[test]
    fn parts_and_parameters_are_one_to_one_and_padding_is_zero() {
        let mlp = Mlp::new(5, &layers(Activation::Elu, true), 2, Activation::Identity).unwrap();
        let p = mlp.init(&mut stream());
        let parts = mlp.parts(&p);
        assert_eq!(parts.iter().map(|p| p.data.len()).sum::<usize>(), mlp.n_weight());
        let back = mlp.from_parts(|name, _| Ok(parts.iter().find(|p| p.name == name).unwrap().data.clone())).unwrap();
        assert_eq!(back, p);
        assert_eq!(parts[0].shape, [20, 5]);
        assert!(mlp.from_parts(|_, shape| Ok(vec![f32::NAN; shape.iter().product()])).is_err());
    }

    #[test]
    fn rows_do_not_depend_on_their_number() {
        let mlp = Mlp::new(9, &layers(Activation::Tanh, true), 4, Activation::Tanh).unwrap();
        let mut s = stream();
        let p = mlp.init(&mut s);
        let x: Vec<f32> = (0..64 * 9).map(|_| s.normal() as f32).collect();
        let mut memory = mlp.memory(64);
        let mut all = vec![0.0; 64 * 4];
        mlp.forward(&p, &x, 64, &mut memory).write(&mut all);
        for r in 0..64 {
            let one = mlp.forward(&p, &x[r * 9..][..9], 1, &mut memory);
            assert_eq!(one.row(0), &all[r * 4..][..4], "row {r}");
        }
    }

    #[test]
    fn bombs_are_refused_before_any_allocation() {
        for hidden in [vec![1_000_000_000], vec![0], vec![64; 1000]] {
            let layers = Layers { hidden, ..Layers::default() };
            assert!(Mlp::new(10, &layers, 4, Activation::Tanh).is_err());
        }
    }
}
