//! Networks that say the same otherwise: with fewer outputs, each a sum of some of another's; or in other units.

use super::network::{NamedTensor, Network, Slot};
use base::error::{Error, Result};

/// The parameters of `narrow`, whose output k is Σ w · (output j of `wide`) over the `(j, w)` that `sums` gives for k. Both are
/// alike but for the number of outputs and what these pass through.
///
/// # Errors
/// As `Network::from_parts`, for networks that are not alike.
pub fn fold(
    (wide, parameters): (&dyn Network, &[f32]),
    narrow: &dyn Network,
    sums: impl Fn(usize) -> Vec<(usize, f32)>,
) -> Result<Vec<f32>> {
    let mut parts = wide.parts(parameters);
    let (n_wide, n_narrow) = (wide.n_output(), narrow.n_output());
    for part in last_layer(&mut parts) {
        let width = part.data.len() / n_wide;
        let mut data = vec![0.0; n_narrow * width];
        for (k, row) in data.chunks_exact_mut(width).enumerate() {
            for (j, w) in sums(k) {
                row.iter_mut().zip(&part.data[j * width..]).for_each(|(to, x)| *to += w * x);
            }
        }
        part.data = data;
    }
    joined(narrow, parts)
}

/// Weight, `[out, in]`, and bias of the layer that gives a network's outputs; of each network, where agents have their own.
#[derive(Debug, Clone)]
pub struct OutputLayer(Vec<[Slot; 2]>);

impl OutputLayer {
    /// The last two slots of a network, of each of several agents'.
    pub fn of(network: &dyn Network) -> Self {
        let slots = network.slots();
        let last = |own: &[Slot]| own.last_chunk().cloned();
        Self(slots.chunks((slots.len() / network.n_set()).max(1)).filter_map(last).collect())
    }

    /// Puts factor · y + shift in place of the output y number k, by the (factor, shift) of `of`(k).
    ///
    /// # Errors
    /// [`Error::Value`] for parameters that are not finite, be it before or behind.
    pub fn rescale(&self, parameters: &mut [f32], of: impl Fn(usize) -> (f32, f32)) -> Result<()> {
        for [weight, bias] in &self.0 {
            for k in 0..bias.shape[0] {
                let (factor, shift) = of(k);
                weight.row(k).for_each(|at| parameters[at] *= factor);
                bias.row(k).for_each(|at| parameters[at] = factor * parameters[at] + shift);
            }
        }
        match parameters.iter().find(|x| !x.is_finite()) {
            None => Ok(()),
            Some(x) => {
                let remedy = "Lower the learning rate, or go on from an earlier checkpoint.";
                Err(Error::value("a weight of a network of values", x, "finite", remedy))
            }
        }
    }
}

/// Weight, `[out, in]`, and bias of the layer that gives the outputs.
fn last_layer(parts: &mut [NamedTensor]) -> &mut [NamedTensor] {
    let n = parts.len();
    &mut parts[n - 2..]
}

fn joined(network: &dyn Network, parts: Vec<NamedTensor>) -> Result<Vec<f32>> {
    let mut parts = parts.into_iter();
    network.from_parts(&mut |_, _| Ok(parts.next().map_or(Vec::new(), |part| part.data)))
}

#[cfg(test)]
mod tests {
    use super::super::{Activation, Layers, Mlp};
    use super::*;
    use rng::{Purpose, Stream};

    #[test]
    fn outputs_that_are_folded_are_sums_of_outputs() {
        let layers = Layers { hidden: vec![7, 5], layer_norm: true, ..Layers::default() };
        let wide = Mlp::new(3, &layers, 6, Activation::Identity).unwrap();
        let narrow = Mlp::new(3, &layers, 2, Activation::Identity).unwrap();
        let mut stream = Stream::new(5, 0, 0, Purpose::LEARNING);
        let weights: Vec<f32> = wide.init(&mut stream).iter().map(|w| w + stream.unit() as f32).collect();
        let folded = fold((&wide, &weights), &narrow, |k| vec![(k, 1.0), (5, -0.5)]).unwrap();
        let x = [0.3, -0.2, 0.9];
        let (mut of_wide, mut of_narrow) = (wide.memory(1), narrow.memory(1));
        let all = wide.forward(&weights, &x, 1, &mut of_wide).row(0).to_vec();
        let own = narrow.forward(&folded, &x, 1, &mut of_narrow).row(0).to_vec();
        for k in 0..2 {
            // 2e-7 at most
            assert!((own[k] - (all[k] - 0.5 * all[5])).abs() < 1e-5, "{own:?} of {all:?}");
        }
    }

    #[test]
    fn outputs_in_other_units_say_the_same() {
        let layers = Layers { hidden: vec![6], ..Layers::default() };
        let mlp = Mlp::new(3, &layers, 2, Activation::Identity).unwrap();
        let weights: Vec<f32> = mlp.init(&mut Stream::new(5, 0, 0, Purpose::LEARNING));
        let (layer, mut other) = (OutputLayer::of(&mlp), weights.clone());
        layer.rescale(&mut other, |k| (2.0, k as f32)).unwrap();
        let mut memory = mlp.memory(1);
        let x = [0.3, -0.2, 0.9];
        let before = mlp.forward(&weights, &x, 1, &mut memory).row(0).to_vec();
        let after = mlp.forward(&other, &x, 1, &mut memory).row(0).to_vec();
        for k in 0..2 {
            assert!((after[k] - (2.0 * before[k] + k as f32)).abs() < 1e-6, "{before:?} {after:?}");
        }
        other[0] = f32::NAN;
        let told = layer.rescale(&mut other, |_| (1.0, 0.0)).unwrap_err().to_string();
        assert!(told.contains("a weight of a network of values is NaN"), "{told}");
    }
}
