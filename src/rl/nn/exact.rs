//! Networks against themselves in `f64`: what every network's tests share.

use super::network::{Network, Pass, Transposed, Weights};
use rng::{Purpose, Stream};

/// Standard normal numbers.
pub(crate) fn draw(n: usize, seed: u64) -> Vec<f32> {
    let mut stream = Stream::new(seed, 0, 0, Purpose::user(3));
    (0..n).map(|_| stream.normal() as f32).collect()
}

/// Named tensors in `f64`.
pub(crate) type Exact = [(String, Vec<f64>)];

/// Largest errors of the outputs and of all gradients, of parameters and inputs, against `exact` (tensors, an input row) and
/// its central differences: relative where numbers are above 1. Gradients are asked for twice, the second time without the
/// input's and with what stands there.
pub(crate) fn gradients_are_differences(
    net: &dyn Network,
    rows: usize,
    exact: &dyn Fn(&Exact, &[f64]) -> Vec<f64>,
) -> [f64; 2] {
    let (n_in, n_out) = (net.n_input(), net.n_output());
    // padding stays zero
    let shapes: Vec<usize> = net.slots().iter().map(|slot| slot.shape.iter().product()).collect();
    let mut seed = 10;
    let mut each = shapes.iter();
    let p = net
        .from_parts(&mut |_, _| {
            seed += 1;
            Ok(draw(*each.next().unwrap(), seed).iter().map(|x| 0.4 * x).collect())
        })
        .unwrap();
    let (x, up) = (draw(rows * n_in, 2), draw(rows * n_out, 3));
    let wide = |x: &[f32]| x.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    let (mut tensors, mut inputs): (Vec<(String, Vec<f64>)>, _) =
        (net.parts(&p).into_iter().map(|part| (part.name, wide(&part.data))).collect(), wide(&x));
    let value = |tensors: &Exact, x: &[f64]| -> f64 {
        let each = x.chunks_exact(n_in).zip(up.chunks_exact(n_out));
        each.map(|(x, up)| exact(tensors, x).iter().zip(up).map(|(y, u)| y * f64::from(*u)).sum::<f64>()).sum()
    };
    let far = |got: f32, want: f64| (f64::from(got) - want).abs() / want.abs().max(1.0);
    let mut worst = [0.0_f64; 2];
    let mut memory = net.memory(rows);
    let out = net.forward(&p, &x, rows, &mut memory);
    for (k, x) in inputs.chunks_exact(n_in).enumerate() {
        let want = exact(&tensors, x);
        assert_eq!(want.len(), out.row(k).len());
        worst[0] = out.row(k).iter().zip(want).map(|(got, want)| far(*got, want)).fold(worst[0], f64::max);
    }
    let (mut gradient, mut grad_input, mut transposed) =
        (vec![0.0; p.len()], vec![7.0; x.len()], Transposed::default());
    net.transpose(&p, &mut transposed);
    let (weights, mut scratch) = (Weights { parameters: &p, transposed: &transposed }, net.scratch(rows));
    for grad_input in [&mut grad_input[..], &mut []] {
        let pass = Pass { gradient: &mut gradient, grad_input, scratch: &mut scratch };
        net.backward(weights, &x, rows, &memory, &up, pass);
    }
    let twice = net.parts(&gradient);
    let h = 1e-5;
    for q in 0..tensors.len() {
        for at in (0..tensors[q].1.len()).step_by(1 + tensors[q].1.len() / 40) {
            let middle = tensors[q].1[at];
            let mut shifted = |h: f64| {
                tensors[q].1[at] = middle + h;
                value(&tensors, &inputs)
            };
            let want = (shifted(h) - shifted(-h)) / (2.0 * h);
            tensors[q].1[at] = middle;
            worst[1] = worst[1].max(far(0.5 * twice[q].data[at], want));
        }
    }
    for at in (0..inputs.len()).step_by(1 + inputs.len() / 60) {
        let middle = inputs[at];
        let mut shifted = |h: f64| {
            inputs[at] = middle + h;
            value(&tensors, &inputs)
        };
        let want = (shifted(h) - shifted(-h)) / (2.0 * h);
        inputs[at] = middle;
        worst[1] = worst[1].max(far(grad_input[at], want));
    }
    worst
}
