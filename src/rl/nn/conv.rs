//! Convolutions over what is seen: along the steps of a history, over the pixels of an image.
//!
//! ```text
//! y[i, j, o] = f(b[o] + Σ_{p, q, c} w[o, p, q, c] x[s i + p, s j + q, c])
//! ```
//!
//! Numbers of a pixel stand together (height, width, channel), so a patch is whole runs of memory, and a layer the product of
//! its patches with its weights. A history is an image one pixel high. Nothing is added at the rim: a layer gives
//! ⌊(n − kernel)/stride⌋ + 1 pixels.

use super::activation::Activation;
use super::aligned::Aligned;
use super::elementwise::add_rows;
use super::graph::{ConvShape, LayerGraph, LayerKind, ValueSpan};
use super::init::Init;
use super::network::{Level, Memory, Network, Output, Pass, Scratch, Slot, Transposed, Weights};
use super::product::{Begin, Left, padded, product};
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A layer of a convolution, in TOML: `{ channels = 16, kernel = 3, stride = 2 }`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Filter {
    /// Numbers that it gives per pixel.
    pub channels: usize,
    /// Pixels that it sees along each axis.
    pub kernel: usize,
    /// Pixels from one patch to the next.
    #[serde(default = "one")]
    pub stride: usize,
}

fn one() -> usize {
    1
}

/// Most layers.
const MAX_LAYERS: usize = 16;
/// Most channels of a layer.
const MAX_CHANNELS: usize = 2048;
/// Most numbers into or out of a layer, and most of its weights.
const MAX_NUMBERS: usize = 1 << 22;
/// Numbers of patches that are laid out at once: they stay in the second-level cache.
const PATCHES: usize = 1 << 15;

/// Height, width and channels.
type Shape = [usize; 3];

/// The shape of a convolution: rows `[height, width, channels]` to rows of the same kind, all numbers of a pixel together.
#[derive(Debug, Clone, PartialEq)]
pub struct Conv {
    layers: Vec<Layer>,
    n_parameter: usize,
    init: Init,
    /// Axes of a kernel, for names of shapes.
    axes: usize,
}

#[derive(Debug, Clone, PartialEq)]
struct Layer {
    from: Shape,
    to: Shape,
    /// Pixels of a patch, down and across.
    kernel: [usize; 2],
    stride: usize,
    /// [numbers of a patch, padded channels].
    weight: Range<usize>,
    bias: Range<usize>,
    activation: Activation,
}

impl Layer {
    fn wide(&self) -> usize {
        padded(self.to[2])
    }

    /// Numbers of a patch.
    fn n_patch(&self) -> usize {
        self.kernel[0] * self.kernel[1] * self.from[2]
    }

    /// Pixels that it gives.
    fn n_pixel(&self) -> usize {
        self.to[0] * self.to[1]
    }

    /// Rows whose patches are laid out at once.
    fn group(&self, rows: usize) -> usize {
        (PATCHES / (self.n_pixel() * self.n_patch())).clamp(1, rows.max(1))
    }

    /// Calls `run` with the place of every run of a row's patches: among the patches, in the row, its length. Pixels of the row
    /// are `apart` numbers apart.
    fn runs(&self, apart: usize, mut run: impl FnMut(usize, usize, usize)) {
        let ([_, width, channels], [height, across, _]) = (self.from, self.to);
        let mut at = 0;
        for (i, j) in (0..height).flat_map(|i| (0..across).map(move |j| (i, j))) {
            for p in 0..self.kernel[0] {
                let first = ((i * self.stride + p) * width + j * self.stride) * apart;
                if apart == channels {
                    run(at, first, self.kernel[1] * channels);
                    at += self.kernel[1] * channels;
                } else {
                    for q in 0..self.kernel[1] {
                        run(at, first + q * apart, channels);
                        at += channels;
                    }
                }
            }
        }
    }

    /// The patches of rows `apart` numbers per pixel, [rows, pixels, patch].
    fn lay_out(&self, x: &[f32], apart: usize, rows: usize, patches: &mut [f32]) {
        let (row, all) = (self.from[0] * self.from[1] * apart, self.n_pixel() * self.n_patch());
        for (x, to) in x.chunks_exact(row).zip(patches.chunks_exact_mut(all)).take(rows) {
            self.runs(apart, |at, from, n| to[at..at + n].copy_from_slice(&x[from..from + n]));
        }
    }
}

impl Conv {
    /// Along the first axis of `[steps, n]`.
    ///
    /// # Errors
    /// [`Error::Limit`] or [`Error::Value`] for layers that are none, too many or too large, and for patches that do not fit.
    pub fn along(steps: usize, n: usize, filters: &[Filter], activation: Activation, init: Init) -> Result<Self> {
        Self::new([1, steps, n], filters, activation, init, 1)
    }

    /// Over the first two axes of `[height, width, channels]`.
    ///
    /// # Errors
    /// As `Conv::along`.
    pub fn over(image: [usize; 3], filters: &[Filter], activation: Activation, init: Init) -> Result<Self> {
        Self::new(image, filters, activation, init, 2)
    }

    fn new(image: Shape, filters: &[Filter], activation: Activation, init: Init, axes: usize) -> Result<Self> {
        init.validate()?;
        if !(1..=MAX_LAYERS).contains(&filters.len()) {
            let limit = format!("1 to {MAX_LAYERS}");
            return Err(Error::limit("layers of a convolution", filters.len(), limit, "Two or three are usual."));
        }
        let numbers = |shape: Shape| shape.into_iter().fold(1, usize::saturating_mul);
        if numbers(image) == 0 || numbers(image) > MAX_NUMBERS {
            let limit = format!("1 to {MAX_NUMBERS}");
            return Err(Error::limit("numbers into a convolution", numbers(image), limit, "Show it less."));
        }
        let (mut from, mut at, mut layers) = (image, 0, Vec::new());
        for filter in filters {
            let layer = layer(from, filter, axes, activation, at)?;
            (from, at) = (layer.to, layer.bias.end);
            layers.push(layer);
        }
        Ok(Self { layers, n_parameter: at, init, axes })
    }

    /// Height, width and channels of what it gives.
    pub fn shape(&self) -> [usize; 3] {
        self.last().to
    }

    fn last(&self) -> &Layer {
        &self.layers[self.layers.len() - 1]
    }

    /// What layer `l` takes, and numbers from pixel to pixel.
    fn input<'a>(&self, l: usize, x: &'a [f32], memory: &'a Memory) -> (&'a [f32], usize) {
        let channels = self.layers[l].from[2];
        if l == 0 { (x, channels) } else { (&memory.levels[l - 1].y, padded(channels)) }
    }

    /// Numbers of the patches that are laid out at once, with rows padded as gradients need them.
    fn n_patches(&self, rows: usize) -> usize {
        self.layers.iter().map(|l| l.group(rows) * l.n_pixel() * padded(l.n_patch())).max().unwrap_or(0)
    }
}

/// The layer of a filter on `from`, its parameters from `at` on.
fn layer(from: Shape, filter: &Filter, axes: usize, activation: Activation, at: usize) -> Result<Layer> {
    let Filter { channels, kernel, stride } = *filter;
    for (what, n, most) in [
        ("channels of a convolution", channels, MAX_CHANNELS),
        ("kernel of a convolution", kernel, MAX_NUMBERS),
        ("stride of a convolution", stride, MAX_NUMBERS),
    ] {
        if !(1..=most).contains(&n) {
            return Err(Error::limit(what, n, format!("1 to {most}"), "16, 3 and 1 are usual."));
        }
    }
    let kernels = if axes == 1 { [1, kernel] } else { [kernel; 2] };
    let fits = |axis: usize| from[axis].checked_sub(kernels[axis]).map(|rest| rest / stride + 1);
    let (Some(height), Some(width)) = (fits(0), fits(1)) else {
        let limit = match axes {
            1 => format!("at most {}, the steps that the layer sees", from[1]),
            _ => format!("at most {}, the pixels that the layer sees", from[0].min(from[1])),
        };
        let remedy = "Take a smaller kernel or fewer layers, or smaller strides before it.";
        return Err(Error::value("kernel of a convolution", kernel, limit, remedy));
    };
    let to = [height, width, channels];
    let n_patch = kernels[0].saturating_mul(kernels[1]).saturating_mul(from[2]);
    let (weights, given) = (n_patch.saturating_mul(padded(channels)), height * width * padded(channels));
    if weights.max(given) > MAX_NUMBERS {
        let what = "weights or numbers of a convolution's layer";
        return Err(Error::limit(what, weights.max(given), MAX_NUMBERS, "Take fewer channels or a larger stride."));
    }
    let (weight, bias) = (at..at + weights, at + weights..at + weights + padded(channels));
    Ok(Layer { from, to, kernel: kernels, stride, weight, bias, activation })
}

impl Network for Conv {
    fn n_input(&self) -> usize {
        self.layers[0].from.iter().product()
    }

    fn n_output(&self) -> usize {
        self.shape().iter().product()
    }

    fn n_parameter(&self) -> usize {
        self.n_parameter
    }

    fn n_activation(&self) -> usize {
        self.layers.iter().map(|l| l.n_pixel() * l.wide()).sum::<usize>() + padded(self.n_output())
    }

    /// Weights `[out, (down,) across, in]`.
    fn slots(&self) -> Vec<Slot> {
        let each = self.layers.iter().enumerate().flat_map(|(l, layer)| {
            let (n, [down, across]) = (layer.to[2], layer.kernel);
            let shape = match self.axes {
                1 => vec![n, across, layer.from[2]],
                _ => vec![n, down, across, layer.from[2]],
            };
            [
                Slot::new(format!("{l}.weight"), shape, layer.weight.start, n),
                Slot::new(format!("{l}.bias"), vec![n], layer.bias.start, n),
            ]
        });
        each.collect()
    }

    fn init(&self, stream: &mut Stream) -> Vec<f32> {
        let mut parameters = vec![0.0; self.n_parameter];
        for (slot, layer) in self.slots().iter().step_by(2).zip(&self.layers) {
            let weights = self.init.draw(layer.to[2], layer.n_patch(), false, stream);
            slot.fill(weights.into_iter(), &mut parameters);
        }
        parameters
    }

    fn memory(&self, rows: usize) -> Memory {
        let mut levels: Vec<Level> = self.layers.iter().map(|l| Level::of(rows * l.n_pixel() * l.wide())).collect();
        // patches, then the output without gaps
        levels.extend([self.n_patches(rows), rows * padded(self.n_output())].map(Level::of));
        Memory { levels, parts: Vec::new() }
    }

    fn scratch(&self, rows: usize) -> Scratch {
        let largest = |l: &Layer| (l.n_pixel() * l.wide()).max(l.from[0] * l.from[1] * padded(l.from[2]));
        let n = rows * self.layers.iter().map(largest).max().unwrap_or(0);
        let patches = [(); 2].map(|()| Aligned::zeros(self.n_patches(rows)));
        Scratch { d: Aligned::zeros(n), before: Aligned::zeros(n), more: patches.into(), ..Scratch::default() }
    }

    fn transpose(&self, parameters: &[f32], transposed: &mut Transposed) {
        for (l, layer) in self.layers.iter().enumerate() {
            let shape = (layer.n_patch(), layer.to[2], layer.wide());
            transposed.put(l, &parameters[layer.weight.clone()], shape, |o| o);
        }
    }

    fn describe(&self, parameters: &[f32], graph: &mut LayerGraph, x: &ValueSpan, _: &ValueSpan) -> [ValueSpan; 2] {
        let mut tensors = self.parts(parameters).into_iter().map(|tensor| tensor.data);
        let mut x = x.clone();
        for &Layer { from, to, kernel, stride, activation, .. } in &self.layers {
            let [weight, bias] = [(); 2].map(|()| tensors.next().unwrap_or_default());
            let n = to.iter().product();
            let kind = LayerKind::Conv { shape: ConvShape { from, to, kernel, stride }, weight, bias };
            x = graph.add(kind, 1, n, vec![x]);
            if activation != Activation::Identity {
                x = graph.add(LayerKind::Activation(activation), 1, n, vec![x]);
            }
        }
        [x, ValueSpan::NONE]
    }

    fn forward<'m>(&self, parameters: &[f32], x: &[f32], rows: usize, memory: &'m mut Memory) -> Output<'m> {
        let n_layer = self.layers.len();
        let (levels, own) = memory.levels.split_at_mut(n_layer);
        let [patches, out] = own else { unreachable!("the memory of another network") };
        for (l, layer) in self.layers.iter().enumerate() {
            let (before, own) = levels.split_at_mut(l);
            let channels = layer.from[2];
            let (x, apart) = before.last().map_or((x, channels), |level| (&level.y[..], padded(channels)));
            let (seen, pixels, k) = (layer.from[0] * layer.from[1] * apart, layer.n_pixel(), layer.n_patch());
            let group = layer.group(rows);
            let y = &mut own[0].y[..rows * pixels * layer.wide()];
            for (x, y) in x[..rows * seen].chunks(group * seen).zip(y.chunks_mut(group * pixels * layer.wide())) {
                let n = x.len() / seen;
                layer.lay_out(x, apart, n, &mut patches.y);
                let begin = Begin::With(&parameters[layer.bias.clone()]);
                let shape = (n * pixels, k, layer.wide());
                product(Left::Rows(&patches.y, k), &parameters[layer.weight.clone()], begin, y, shape);
            }
            layer.activation.apply(y);
        }
        let (n, wide, channels) = (self.n_output(), padded(self.n_output()), self.last().to[2]);
        let given = levels[n_layer - 1].y.chunks_exact(self.last().n_pixel() * self.last().wide());
        for (to, own) in out.y.chunks_exact_mut(wide).zip(given).take(rows) {
            let pixels = to.chunks_exact_mut(channels).zip(own.chunks_exact(self.last().wide()));
            pixels.for_each(|(to, own)| to.copy_from_slice(&own[..channels]));
        }
        Output::new(&memory.levels[n_layer + 1].y[..rows * wide], n, wide)
    }

    fn backward(&self, net: Weights<'_>, x: &[f32], rows: usize, memory: &Memory, grad_output: &[f32], pass: Pass<'_>) {
        let Scratch { d, before, more, .. } = pass.scratch;
        let [patches, grad_patches] = &mut more[..] else { unreachable!("the scratch of another network") };
        let channels = self.last().to[2];
        for (to, own) in d.chunks_exact_mut(self.last().wide()).zip(grad_output.chunks_exact(channels)) {
            to[..channels].copy_from_slice(own);
            to[channels..].fill(0.0);
        }
        for (l, layer) in self.layers.iter().enumerate().rev() {
            let (x, apart) = self.input(l, x, memory);
            let (pixels, k, wide, tall) = (layer.n_pixel(), layer.n_patch(), layer.wide(), padded(layer.n_patch()));
            let seen = layer.from[0] * layer.from[1] * apart;
            let own = &mut d[..rows * pixels * wide];
            layer.activation.pull(&memory.levels[l].y[..own.len()], own);
            if !pass.gradient.is_empty() {
                add_rows(&mut pass.gradient[layer.bias.clone()], own, rows * pixels);
            }
            let goes_on = l > 0 || !pass.grad_input.is_empty();
            if goes_on {
                before[..rows * seen].fill(0.0);
            }
            let group = layer.group(rows);
            let groups = own.chunks(group * pixels * wide).zip(x[..rows * seen].chunks(group * seen));
            for ((d, x), before) in groups.zip(before[..rows * seen].chunks_mut(group * seen)) {
                let n = x.len() / seen;
                if !pass.gradient.is_empty() {
                    layer.lay_out(x, apart, n, patches);
                    let weight = &mut pass.gradient[layer.weight.clone()];
                    product(Left::Columns(patches, k), d, Begin::Add, weight, (k, n * pixels, wide));
                }
                if goes_on {
                    let shape = (n * pixels, layer.to[2], tall);
                    product(Left::Rows(d, wide), &net.transposed[l], Begin::Zero, grad_patches, shape);
                    for (before, d) in before.chunks_exact_mut(seen).zip(grad_patches.chunks_exact(pixels * tall)) {
                        layer.runs(apart, |at, to, n| {
                            let from = at / k * tall + at % k;
                            before[to..to + n].iter_mut().zip(&d[from..from + n]).for_each(|(x, d)| *x += d);
                        });
                    }
                }
            }
            std::mem::swap(d, before);
        }
        if !pass.grad_input.is_empty() {
            let n = pass.grad_input.len().min(rows * self.n_input());
            pass.grad_input[..n].copy_from_slice(&d[..n]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::exact::{Exact, draw, gradients_are_differences};
    use super::*;

    fn filters(all: &[[usize; 3]]) -> Vec<Filter> {
        all.iter()
            .map(|[channels, kernel, stride]| Filter { channels: *channels, kernel: *kernel, stride: *stride })
            .collect()
    }

    /// The sum of the file's head, layer by layer, in f64.
    fn exact(conv: &Conv, parts: &Exact, x: &[f64]) -> Vec<f64> {
        let mut x = x.to_vec();
        for (l, layer) in conv.layers.iter().enumerate() {
            let (w, b) = (&parts[2 * l].1, &parts[2 * l + 1].1);
            let ([_, width, n], [height, across, channels]) = (layer.from, layer.to);
            let [down, along] = layer.kernel;
            let mut y = Vec::new();
            for (i, j, o) in (0..height * across * channels)
                .map(|at| (at / channels / across, at / channels % across, at % channels))
            {
                let mut sum = b[o];
                for (p, q, c) in (0..down * along * n).map(|at| (at / n / along, at / n % along, at % n)) {
                    let seen = x[((i * layer.stride + p) * width + j * layer.stride + q) * n + c];
                    sum += w[((o * down + p) * along + q) * n + c] * seen;
                }
                y.push(sum.tanh());
            }
            x = y;
        }
        x
    }

    #[test]
    fn gradients_are_differences_of_the_same_sums_in_f64() {
        let init = Init::default();
        let tanh = Activation::Tanh;
        for conv in [
            Conv::along(9, 5, &filters(&[[7, 3, 2], [4, 2, 1]]), tanh, init).unwrap(),
            Conv::along(12, 1, &filters(&[[18, 4, 1]]), tanh, init).unwrap(),
            Conv::over([7, 9, 3], &filters(&[[5, 3, 2], [6, 2, 1]]), tanh, init).unwrap(),
            Conv::over([8, 8, 16], &filters(&[[16, 2, 2], [3, 1, 1], [2, 3, 3]]), tanh, init).unwrap(),
        ] {
            let worst = gradients_are_differences(&conv, 3, &|parts, x| exact(&conv, parts, x));
            println!("{:?}: {worst:?}", conv.shape());
            assert!(worst[0] < 1e-6 && worst[1] < 5e-6, "{worst:?}"); // measured at most 4.1e-7, 1.5e-6
        }
    }

    #[test]
    fn rows_do_not_depend_on_their_number_nor_on_how_many_are_laid_out_at_once() {
        let conv =
            Conv::over([12, 12, 3], &filters(&[[8, 5, 1], [4, 3, 2]]), Activation::Relu, Init::default()).unwrap();
        assert!((2..9).contains(&conv.layers[0].group(64)), "several at once, and not all");
        let (rows, n) = (9, conv.n_input());
        let (p, x) = (draw(conv.n_parameter(), 1), draw(rows * n, 2));
        let mut memory = conv.memory(rows);
        let mut all = vec![0.0; rows * conv.n_output()];
        conv.forward(&p, &x, rows, &mut memory).write(&mut all);
        for (r, want) in all.chunks_exact(conv.n_output()).enumerate() {
            assert_eq!(conv.forward(&p, &x[r * n..][..n], 1, &mut memory).row(0), want, "row {r}");
        }
    }

    #[test]
    fn tensors_have_the_shapes_of_their_axes() {
        let init = Init::default();
        let shapes = |conv: Conv| conv.slots().into_iter().map(|slot| slot.shape).collect::<Vec<_>>();
        let along = Conv::along(9, 5, &filters(&[[7, 3, 2]]), Activation::Elu, init).unwrap();
        let over = Conv::over([9, 9, 5], &filters(&[[7, 3, 2]]), Activation::Elu, init).unwrap();
        assert_eq!((along.shape(), over.shape()), ([1, 4, 7], [4, 4, 7]));
        assert_eq!((shapes(along), shapes(over)), (vec![vec![7, 3, 5], vec![7]], vec![vec![7, 3, 3, 5], vec![7]]));
    }

    #[test]
    fn what_does_not_fit_is_named_with_the_remedy() {
        let of = |all: &[[usize; 3]]| {
            Conv::along(8, 4, &filters(all), Activation::Elu, Init::default()).unwrap_err().to_string()
        };
        assert!(of(&[]).starts_with("layers of a convolution is 0"), "{}", of(&[]));
        let told = of(&[[4, 3, 2], [4, 4, 1]]);
        assert!(told.starts_with("kernel of a convolution is 4, but it must be at most 3, the steps"), "{told}");
        for bad in [[0, 3, 1], [4, 0, 1], [4, 3, 0], [1 << 40, 3, 1], [4, 1 << 40, 1]] {
            assert!(of(&[bad]).contains("of a convolution is"), "{}", of(&[bad]));
        }
        let bomb = Conv::over([1 << 20, 1 << 20, 3], &filters(&[[4, 3, 1]]), Activation::Elu, Init::default());
        assert!(bomb.unwrap_err().to_string().starts_with("numbers into a convolution"));
    }
}
