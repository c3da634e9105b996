//! Adam, with decoupled weight decay.

use super::product::PAD;
use autodiff::lanes::{Kernel, Lanes, dispatch};
use base::defaults::with_defaults;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// Numbers of the method; see `Adam`.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct AdamConfig {
        /// β₁, of the mean. Within [0, 1); default 0.9.
        pub beta1: f64 = 0.9,
        /// β₂, of the mean square. Within [0, 1); default 0.999.
        pub beta2: f64 = 0.999,
        /// ε, under the root's result. > 0; default 1e-8.
        pub epsilon: f64 = 1e-8,
        /// λ, decay of weights per step and learning rate. ≥ 0; default 0.
        pub weight_decay: f64 = 0.0,
    }
}

impl AdamConfig {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) with the number, the rule and the remedy.
    pub fn validate(&self) -> base::error::Result<()> {
        use base::error::Error;
        for (what, beta) in [("beta1", self.beta1), ("beta2", self.beta2)] {
            if !(0.0..1.0).contains(&beta) {
                return Err(Error::value(what, beta, "within [0, 1)", "0.9 and 0.999 are usual."));
            }
        }
        // below it 0/0 makes NaN of weights that have no gradient
        if !(self.epsilon.is_finite() && self.epsilon as f32 >= f32::MIN_POSITIVE) {
            return Err(Error::value("epsilon", self.epsilon, "finite and ≥ 1.2e-38", "1e-8 is usual."));
        }
        if !(self.weight_decay.is_finite() && self.weight_decay >= 0.0) {
            return Err(Error::value("weight_decay", self.weight_decay, "finite and ≥ 0", "Leave it out."));
        }
        Ok(())
    }
}

/// m ← β₁ m + (1 − β₁) g, v ← β₂ v + (1 − β₂) g², w ← w − α (m̂/(√v̂ + ε) + λ w) with m̂ = m/(1 − β₁ᵗ), v̂ = v/(1 − β₂ᵗ)
/// (Kingma and Ba 2015, algorithm 1; decay as in Loshchilov and Hutter 2019).
#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    /// β, ε, λ.
    pub config: AdamConfig,
    /// Mean of gradients.
    pub mean: Vec<f32>,
    /// Mean of their squares.
    pub square: Vec<f32>,
    /// t, steps done.
    pub step: u64,
}

impl Adam {
    /// For `n` parameters.
    pub fn new(config: AdamConfig, n: usize) -> Self {
        Self { config, mean: vec![0.0; n], square: vec![0.0; n], step: 0 }
    }

    /// One step with learning rate `rate`.
    pub fn descend(&mut self, parameters: &mut [f32], gradient: &[f32], rate: f64) {
        let AdamConfig { beta1, beta2, epsilon, weight_decay } = self.config;
        self.step = self.step.saturating_add(1);
        let power = self.step.min(1 << 30) as i32;
        let (mean_rate, square_scale) = (rate / (1.0 - beta1.powi(power)), 1.0 / (1.0 - beta2.powi(power)));
        let factors = Factors {
            beta: [beta1, beta2],
            rest: [1.0 - beta1, 1.0 - beta2],
            rate: mean_rate,
            square_scale,
            epsilon,
            keep: 1.0 - mean_rate * (1.0 - beta1.powi(power)) * weight_decay,
        };
        dispatch(Descend { factors, parameters, gradient, mean: &mut self.mean, square: &mut self.square });
    }
}

/// What one step multiplies with.
#[derive(Clone, Copy)]
struct Factors {
    beta: [f64; 2],
    rest: [f64; 2],
    rate: f64,
    square_scale: f64,
    epsilon: f64,
    keep: f64,
}

struct Descend<'a> {
    factors: Factors,
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    mean: &'a mut [f32],
    square: &'a mut [f32],
}

impl Kernel for Descend<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { factors, parameters, gradient, mean, square } = self;
        let (n, mut at) = (parameters.len(), 0);
        while at + L::WIDTH <= n {
            let own =
                [L::load(&parameters[at..]), L::load(&mean[at..]), L::load(&square[at..]), L::load(&gradient[at..])];
            let [w, m, v] = factors.step(own);
            w.store(&mut parameters[at..]);
            m.store(&mut mean[at..]);
            v.store(&mut square[at..]);
            at += L::WIDTH;
        }
        let (rest, mut last) = (at..n, [[0.0; PAD]; 4]);
        last[0][..rest.len()].copy_from_slice(&parameters[rest.clone()]);
        last[1][..rest.len()].copy_from_slice(&mean[rest.clone()]);
        last[2][..rest.len()].copy_from_slice(&square[rest.clone()]);
        last[3][..rest.len()].copy_from_slice(&gradient[rest.clone()]);
        let [w, m, v] = factors.step([L::load(&last[0]), L::load(&last[1]), L::load(&last[2]), L::load(&last[3])]);
        w.store(&mut last[0]);
        m.store(&mut last[1]);
        v.store(&mut last[2]);
        parameters[rest.clone()].copy_from_slice(&last[0][..rest.len()]);
        mean[rest.clone()].copy_from_slice(&last[1][..rest.len()]);
        square[rest.clone()].copy_from_slice(&last[2][..rest.len()]);
    }
}

impl Factors {
    /// New weight, mean and square of w, m, v and g, without fused operations: the same bits in lanes of any width.
    #[inline(always)]
    fn step<L: Lanes>(self, [w, m, v, g]: [L; 4]) -> [L; 3] {
        let c = L::constant;
        let m = c(self.beta[0]) * m + c(self.rest[0]) * g;
        let v = c(self.beta[1]) * v + c(self.rest[1]) * g * g;
        let w = c(self.keep) * w - c(self.rate) * m / ((v * c(self.square_scale)).sqrt() + c(self.epsilon));
        [w, m, v]
    }
}

/// Scales a gradient whose norm is above `most` down to it; gives the norm from before. A gradient that is not finite becomes
/// zero, and its norm is told as it was.
pub fn clip_norm(gradient: &mut [f32], most: f64) -> f64 {
    let mut lanes = [0.0_f64; 8];
    for eight in gradient.chunks(8) {
        lanes.iter_mut().zip(eight).for_each(|(sum, g)| *sum += f64::from(*g) * f64::from(*g));
    }
    let norm = lanes.iter().sum::<f64>().sqrt();
    if !norm.is_finite() {
        gradient.fill(0.0);
    } else if norm > most {
        let factor = (most / norm) as f32;
        gradient.iter_mut().for_each(|g| *g *= factor);
    }
    norm
}
