//! Independent Gaussians of a block of rows: [`Head::Gaussian`] number by number for all rows at once, in `f32`.
//!
//! What does not depend on the row is computed once. Arrays hold one number per row of the block; those behind the last row
//! mean nothing.

use super::elementwise::sum;
use super::head::{Head, LOG_STD_MAX, LOG_STD_MIN};
use super::network::Output;
use autodiff::program::BLOCK;
use std::f64::consts::TAU;

/// The Gaussians of a head, with deviations as they were last set.
#[derive(Debug, Clone)]
pub(crate) struct Gaussians {
    std: Vec<f64>,
    inverse_std: Vec<f32>,
    /// Derivative of the clamped log standard deviation by the given one.
    clamp_slope: Vec<f32>,
    /// log p of the means.
    most: f32,
    /// Nats, the same in every row.
    pub entropy: f64,
}

impl Gaussians {
    /// Those of a head, if it has any.
    pub fn of(head: Head) -> Option<Self> {
        let Head::Gaussian { n } = head else { return None };
        let (std, ones) = (vec![1.0; n], vec![1.0; n]);
        let mut gaussians = Self { std, inverse_std: ones.clone(), clamp_slope: ones, most: 0.0, entropy: 0.0 };
        gaussians.set(&vec![0.0; n]);
        Some(gaussians)
    }

    /// Takes over log standard deviations.
    pub fn set(&mut self, extra: &[f32]) {
        let extra = &extra[..self.std.len()];
        let mut total = 0.0;
        for (i, given) in extra.iter().map(|x| f64::from(*x)).enumerate() {
            let log_std = given.clamp(LOG_STD_MIN, LOG_STD_MAX);
            self.clamp_slope[i] = if given == log_std { 1.0 } else { 0.0 };
            (self.std[i], self.inverse_std[i]) = (log_std.exp(), (-log_std).exp() as f32);
            total += log_std;
        }
        let n = extra.len() as f64;
        self.most = (-0.5 * n * TAU.ln() - total) as f32;
        self.entropy = 0.5 * n * (1.0 + TAU.ln()) + total;
    }

    /// Numbers of an action.
    pub fn n(&self) -> usize {
        self.std.len()
    }

    /// The action of one row, by a standard normal number for each of its own.
    pub fn sample(&self, output: &[f32], noise: &[f64], action: &mut [f32]) {
        for (i, (std, noise)) in self.std.iter().zip(noise).enumerate() {
            action[i] = (f64::from(output[i]) + std * noise) as f32;
        }
    }

    /// Number i of the first `n` rows in deviations from its mean.
    fn deviations<'a>(
        &self,
        i: usize,
        n: usize,
        output: Output<'_>,
        action: &impl Fn(usize) -> &'a [f32],
    ) -> [f32; BLOCK] {
        let mut z = [0.0; BLOCK];
        for (k, z) in z[..n].iter_mut().enumerate() {
            *z = (action(k)[i] - output.row(k)[i]) * self.inverse_std[i];
        }
        z
    }

    /// log p(action k) of the first `n` rows.
    pub fn log_probs<'a>(&self, n: usize, output: Output<'_>, action: &impl Fn(usize) -> &'a [f32]) -> [f32; BLOCK] {
        let mut squares = [0.0; BLOCK];
        for i in 0..self.std.len() {
            let z = self.deviations(i, n, output, action);
            squares.iter_mut().zip(z).for_each(|(sum, z)| *sum += z * z);
        }
        squares.map(|sum| self.most - 0.5 * sum)
    }

    /// Writes ∂/∂output of Σ `weight` · log p as far as there are Gaussians, and adds ∂/∂extra of it and of `grad_entropy` · entropy to
    /// `d_extra`; of the first `n` rows.
    pub fn gradient<'a>(
        &self,
        n: usize,
        output: Output<'_>,
        action: &impl Fn(usize) -> &'a [f32],
        (weight, grad_entropy): (&[f32; BLOCK], f32),
        (d_output, d_extra): (&mut [f32], &mut [f32]),
    ) {
        for i in 0..self.std.len() {
            let z = self.deviations(i, n, output, action);
            let mut d_log_std = [0.0; BLOCK];
            for (k, d) in d_output[i..].iter_mut().step_by(output.n).take(n).enumerate() {
                *d = weight[k] * z[k] * self.inverse_std[i];
            }
            for k in 0..n {
                d_log_std[k] = weight[k] * (z[k] * z[k] - 1.0);
            }
            d_extra[i] += self.clamp_slope[i] * (sum(&d_log_std) + grad_entropy);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Activation, Layers, Mlp};
    use rng::{Purpose, Stream};

    #[test]
    fn a_block_of_rows_agrees_with_its_rows_in_f64() {
        let head = Head::Gaussian { n: 3 };
        // one beyond each limit of the clamp
        for extra in [[-0.7, 0.3, -1.5], [2.5, -6.0, 0.0]] {
            let mut stream = Stream::new(12, 0, 0, Purpose::POLICY);
            let mlp = Mlp::new(4, &Layers::default(), 3, Activation::Identity).unwrap();
            let (parameters, mut memory) = (mlp.init(&mut stream), mlp.memory(BLOCK));
            let n = 37;
            let x: Vec<f32> = (0..n * 4).map(|_| stream.normal() as f32).collect();
            let output = mlp.forward(&parameters, &x, n, &mut memory);
            let mut gaussians = Gaussians::of(head).unwrap();
            gaussians.set(&extra);
            let mut actions = vec![0.0; n * 3];
            let mut twin = stream.clone();
            for (k, action) in actions.chunks_mut(3).enumerate() {
                let noise = [0; 3].map(|_| stream.normal());
                gaussians.sample(output.row(k), &noise, action);
                let mut other = [0.0; 3];
                head.sample(output.row(k), &extra, &mut twin, &mut other);
                assert_eq!(action, other);
            }
            let action = |k: usize| &actions[k * 3..][..3];
            let mut weight = [0.0; BLOCK];
            weight.iter_mut().for_each(|w| *w = stream.normal() as f32);
            let log_probs = gaussians.log_probs(n, output, &action);
            let (mut d_output, mut d_extra) = (vec![0.0; n * 3], vec![0.5; 3]);
            gaussians.gradient(n, output, &action, (&weight, 0.25), (&mut d_output, &mut d_extra));
            let (mut want_output, mut want_extra, mut worst) = (vec![0.0; n * 3], vec![0.5; 3], 0.0_f32);
            for k in 0..n {
                let d = &mut want_output[k * 3..][..3];
                let share = if k == 0 { 0.25 } else { 0.0 };
                head.gradient(output.row(k), &extra, action(k), weight[k], share, d, &mut want_extra);
                let want = head.log_prob(output.row(k), &extra, action(k));
                worst = worst.max((log_probs[k] - want).abs() / want.abs().max(1.0));
            }
            for (got, want) in d_output.iter().chain(&d_extra).zip(want_output.iter().chain(&want_extra)) {
                worst = worst.max((got - want).abs() / want.abs().max(1.0));
            }
            println!("{worst:.1e}");
            assert!(worst < 1e-5, "{worst:e}"); // measured 5.4e-7
            assert!((gaussians.entropy - f64::from(head.entropy(output.row(0), &extra))).abs() < 1e-6); // 2e-7
        }
    }
}
