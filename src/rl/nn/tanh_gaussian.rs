//! Gaussians behind tanh, drawn so that gradients pass: a = tanh(μ + σ ε), ε ~ N(0, 1) (Haarnoja et al. 2018, appendix C).
//!
//! A row of outputs is `[μ n, s n]`, of which an action has the first numbers of each half; ln σ = −5 + 3.5 (1 + tanh s) stays within
//! [−5, 2] and its slope never vanishes for good.

use super::head::{LOG_STD_MAX, LOG_STD_MIN};
use std::f64::consts::{LN_2, TAU};

/// Half the range of ln σ.
const HALF: f64 = 0.5 * (LOG_STD_MAX - LOG_STD_MIN);

/// ln σ of the number s.
fn log_std(s: f64) -> f64 {
    LOG_STD_MIN + HALF * (1.0 + s.tanh())
}

/// Writes the action of `noise`, and gives ln π of it, summed over its numbers.
pub fn draw(output: &[f32], noise: &[f32], action: &mut [f32]) -> f32 {
    let half = output.len() / 2;
    let mut total = 0.0;
    for i in 0..action.len() {
        let (mean, log_std, e) = (f64::from(output[i]), log_std(output[half + i].into()), f64::from(noise[i]));
        let u = mean + log_std.exp() * e;
        action[i] = u.tanh() as f32;
        // ln(1 − tanh² u), which tanh itself rounds to ln 0
        let slope = 2.0 * (LN_2 - u - softplus(-2.0 * u));
        total -= 0.5 * (e * e + TAU.ln()) + log_std + slope;
    }
    total as f32
}

/// ln(1 + eˣ).
fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// ∂/∂output of `alpha` · ln π(a) + Σ `grad_action` · a, along a = tanh(μ + σ ε) with ε held.
pub fn pull(output: &[f32], noise: &[f32], alpha: f64, grad_action: &[f32], grad_output: &mut [f32]) {
    let half = output.len() / 2;
    for i in 0..grad_action.len() {
        let (s, e) = (f64::from(output[half + i]), f64::from(noise[i]));
        let std = log_std(s).exp();
        let a = (f64::from(output[i]) + std * e).tanh();
        let grad_mean = 2.0 * alpha * a + f64::from(grad_action[i]) * (1.0 - a * a);
        let grad_log_std = grad_mean * std * e - alpha;
        let slope = HALF * (1.0 - s.tanh().powi(2));
        grad_output[i] = grad_mean as f32;
        grad_output[half + i] = (grad_log_std * slope) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::{Purpose, Stream};

    fn rows(stream: &mut Stream) -> ([f32; 6], [f32; 3], [f32; 3]) {
        let mut own = |to: &mut [f32], by: f64| to.iter_mut().for_each(|x| *x = (by * stream.normal()) as f32);
        let (mut output, mut noise, mut weight) = ([0.0; 6], [0.0; 3], [0.0; 3]);
        own(&mut output, 0.7);
        own(&mut noise, 1.0);
        own(&mut weight, 1.0);
        (output, noise, weight)
    }

    #[test]
    fn gradients_along_the_draw_are_those_of_differences() {
        let mut stream = Stream::new(3, 0, 0, Purpose::LEARNING);
        let mut worst: f64 = 0.0;
        for _ in 0..200 {
            let (output, noise, weight) = rows(&mut stream);
            let loss = |output: &[f32]| {
                let mut action = [0.0; 3];
                let log_prob = f64::from(draw(output, &noise, &mut action));
                0.3 * log_prob + (0..3).map(|i| f64::from(weight[i] * action[i])).sum::<f64>()
            };
            let mut gradient = [0.0; 6];
            pull(&output, &noise, 0.3, &weight, &mut gradient);
            for i in 0..6 {
                let (mut up, mut down) = (output, output);
                up[i] += 1e-2;
                down[i] -= 1e-2;
                let difference = (loss(&up) - loss(&down)) / f64::from(up[i] - down[i]);
                worst = worst.max((difference - f64::from(gradient[i])).abs() / (1.0 + difference.abs()));
            }
        }
        // of f32 sums over a step of 0.02
        assert!(worst < 2e-3, "{worst}");
    }

    /// ∫ π(a) da over (−1, 1) is 1, by the midpoints of 200 000 cells.
    #[test]
    fn densities_behind_tanh_integrate_to_one() {
        for (mean, s) in [(0.0, 0.3), (0.8, -0.2), (-1.5, 0.0)] {
            let (n, mut total) = (200_000, 0.0);
            for k in 0..n {
                let a = -1.0 + 2.0 * (f64::from(k) + 0.5) / f64::from(n);
                let noise = (a.atanh() - mean) / log_std(s).exp();
                let mut action = [0.0];
                let log_prob = draw(&[mean as f32, s as f32], &[noise as f32], &mut action);
                assert!((f64::from(action[0]) - a).abs() < 1e-5);
                total += f64::from(log_prob).exp() * 2.0 / f64::from(n);
            }
            // 2e-6 at most
            assert!((total - 1.0).abs() < 1e-4, "{total}");
        }
    }

    #[test]
    fn a_draw_far_out_has_a_finite_probability() {
        let mut action = [0.0];
        assert!(draw(&[40.0, 0.0], &[3.0], &mut action).is_finite() && action[0] == 1.0);
    }
}
