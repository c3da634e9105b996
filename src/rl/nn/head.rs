//! Distributions of actions over the outputs of a network: sample, log-probability, entropy and their gradients.
//!
//! One row at a time, without allocation: the caller loops over rows and owns every array. Numbers come and go as
//! `f32`; the mathematics is in `f64`, so that a ratio of probabilities e^(Δ log p) has the accuracy of its inputs.
//!
//! A row has the *output* that the network computed from the observation and the *extra* parameters that do not depend
//! on it: the log standard deviation of a plain Gaussian. Slices of another length than a head asks for are mistakes of
//! the program and panic. Numbers that are not finite give results that are not, and never a panic or an action of
//! whole numbers outside its range.

use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Least log standard deviation of a Gaussian.
pub(crate) const LOG_STD_MIN: f64 = -5.0;
/// Largest log standard deviation of a Gaussian.
pub(crate) const LOG_STD_MAX: f64 = 2.0;
/// Most outputs of a head: `f32` counts whole numbers exactly up to it.
pub(crate) const MAX_OUTPUT: usize = 1 << 24;

/// The kind of an action's distribution. In TOML: `kind = "gaussian"` and its sizes.
///
/// Log standard deviations are clamped to [−5, 2]; the derivative of the clamp is 1 from
/// limit to limit and 0 outside. Extra parameters that stepped outside would therefore stay there: learners call
/// [`clamp_extra`](Self::clamp_extra) after every step of theirs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Head {
    /// N(mean, e^(2 log std)) per number: output `[mean n]`, extra `[log std n]`. Not squashed: the environment clips.
    Gaussian {
        /// Numbers of an action.
        n: usize,
    },
    /// One whole number in 0 … n − 1: output `[logit n]`. A logit of −∞ rules a number out.
    Categorical {
        /// How many values.
        n: usize,
    },
    /// `n` independent whole numbers in 0 … levels − 1: output `[n, levels]` of logits.
    MultiCategorical {
        /// Numbers of an action.
        n: usize,
        /// Values of each.
        levels: usize,
    },
}

/// The two families behind the kinds.
enum Family {
    Normal(Normal),
    Choice(Choice),
}

impl Head {
    /// Checks the sizes.
    ///
    /// # Errors
    /// [`Error::Limit`] unless there are 1 to `MAX_OUTPUT` outputs.
    pub fn validate(&self) -> Result<()> {
        let (n, levels) = match *self {
            Self::Gaussian { n } | Self::Categorical { n } => (n, 1),
            Self::MultiCategorical { n, levels } => (n, levels),
        };
        let outputs = n.saturating_mul(levels);
        if (1..=MAX_OUTPUT).contains(&outputs) {
            return Ok(());
        }
        let remedy = "Give the sizes of the environment's actions, with fewer levels if need be.";
        Err(Error::limit("outputs of the head", outputs, format!("1 to {MAX_OUTPUT}"), remedy))
    }

    /// The same for the first `n` numbers of an action alone, where it has as many.
    pub fn of_first(self, n: usize) -> Self {
        match self {
            Self::Gaussian { n: all } => Self::Gaussian { n: all.min(n) },
            Self::Categorical { n } => Self::Categorical { n },
            Self::MultiCategorical { n: all, levels } => Self::MultiCategorical { n: all.min(n), levels },
        }
    }

    /// Numbers that the network gives per row.
    pub fn n_output(&self) -> usize {
        match self.family() {
            Family::Normal(x) => x.n,
            Family::Choice(x) => x.n * x.levels,
        }
    }

    /// Parameters that do not depend on the observation.
    pub fn n_extra(&self) -> usize {
        match self.family() {
            Family::Normal(x) => x.n,
            Family::Choice(_) => 0,
        }
    }

    /// Numbers of an action.
    pub fn n_action(&self) -> usize {
        match self.family() {
            Family::Normal(x) => x.n,
            Family::Choice(x) => x.n,
        }
    }

    /// Brings extra parameters back to where their gradient is not 0.
    pub fn clamp_extra(&self, extra: &mut [f32]) {
        extra.iter_mut().for_each(|x| *x = x.clamp(LOG_STD_MIN as f32, LOG_STD_MAX as f32));
    }

    /// Draws an action and returns [`log_prob`](Self::log_prob) of it as it was written, to the bit.
    ///
    /// Takes one normal (Gaussians) or one uniform number (whole numbers, by inversion) per number of the action.
    pub fn sample(&self, output: &[f32], extra: &[f32], stream: &mut Stream, action: &mut [f32]) -> f32 {
        match self.family() {
            Family::Normal(x) => x.sample(output, extra, stream, action),
            Family::Choice(x) => x.sample(output, stream, action),
        }
        self.log_prob(output, extra, action)
    }

    /// The action without exploration: the mean or the first of the largest logits.
    pub fn mode(&self, output: &[f32], extra: &[f32], action: &mut [f32]) {
        match self.family() {
            Family::Normal(x) => x.mode(output, extra, action),
            Family::Choice(x) => x.mode(output, action),
        }
    }

    /// log p(action), the density's or the probability's, summed over the numbers of the action.
    ///
    /// Whole numbers are rounded and clamped into their range, as environments do.
    pub fn log_prob(&self, output: &[f32], extra: &[f32], action: &[f32]) -> f32 {
        self.log_prob_of(output, extra, action) as f32
    }

    /// −E[log p], nats, summed over the numbers of the action.
    pub fn entropy(&self, output: &[f32], extra: &[f32]) -> f32 {
        self.entropy_of(output, extra) as f32
    }

    /// Adds the derivatives of `grad_log_prob` · log p(action) + `grad_entropy` · entropy to `d_output` and `d_extra`.
    #[expect(clippy::too_many_arguments, reason = "a row, what comes down to it and where that goes")]
    pub fn gradient(
        &self,
        output: &[f32],
        extra: &[f32],
        action: &[f32],
        grad_log_prob: f32,
        grad_entropy: f32,
        d_output: &mut [f32],
        d_extra: &mut [f32],
    ) {
        let grad_output = (f64::from(grad_log_prob), f64::from(grad_entropy));
        match self.family() {
            Family::Normal(x) => x.gradient(output, extra, action, grad_output, d_output, d_extra),
            Family::Choice(x) => x.gradient(output, action, grad_output, d_output),
        }
    }

    fn family(&self) -> Family {
        match *self {
            Self::Gaussian { n } => Family::Normal(Normal { n }),
            Self::Categorical { n } => Family::Choice(Choice { n: 1, levels: n }),
            Self::MultiCategorical { n, levels } => Family::Choice(Choice { n, levels }),
        }
    }

    fn log_prob_of<T: Copy + Into<f64>>(&self, output: &[T], extra: &[T], action: &[T]) -> f64 {
        match self.family() {
            Family::Normal(x) => x.log_prob(output, extra, action),
            Family::Choice(x) => x.log_prob(output, action),
        }
    }

    fn entropy_of<T: Copy + Into<f64>>(&self, output: &[T], extra: &[T]) -> f64 {
        match self.family() {
            Family::Normal(x) => x.entropy(output, extra),
            Family::Choice(x) => x.entropy(output),
        }
    }
}

/// `n` independent Gaussians.
struct Normal {
    n: usize,
}

/// One of the Gaussians.
struct Gaussian {
    mean: f64,
    log_std: f64,
    /// Derivative of the clamped log standard deviation by the given one.
    clamp_slope: f64,
}

impl Gaussian {
    /// log N(mean + std z).
    fn log_density(&self, z: f64) -> f64 {
        -0.5 * (z * z + TAU.ln()) - self.log_std
    }
}

impl Normal {
    fn gaussian<T: Copy + Into<f64>>(&self, output: &[T], extra: &[T], i: usize) -> Gaussian {
        assert!(output.len() >= self.n && extra.len() >= self.n, "lengths of output and extra");
        let given: f64 = extra[i].into();
        let clamp_slope = if (LOG_STD_MIN..=LOG_STD_MAX).contains(&given) { 1.0 } else { 0.0 };
        Gaussian { mean: output[i].into(), log_std: given.clamp(LOG_STD_MIN, LOG_STD_MAX), clamp_slope }
    }

    fn add(&self, i: usize, d_mean: f64, d_log_std: f64, d_output: &mut [f32], d_extra: &mut [f32]) {
        assert!(d_output.len() >= self.n && d_extra.len() >= self.n, "lengths of the gradients");
        d_output[i] += d_mean as f32;
        d_extra[i] += d_log_std as f32;
    }

    fn sample(&self, output: &[f32], extra: &[f32], stream: &mut Stream, action: &mut [f32]) {
        assert!(action.len() >= self.n, "length of the action");
        for i in 0..self.n {
            let gaussian = self.gaussian(output, extra, i);
            action[i] = (gaussian.mean + gaussian.log_std.exp() * stream.normal()) as f32;
        }
    }

    fn mode(&self, output: &[f32], extra: &[f32], action: &mut [f32]) {
        assert!(action.len() >= self.n, "length of the action");
        for i in 0..self.n {
            action[i] = self.gaussian(output, extra, i).mean as f32;
        }
    }

    fn log_prob<T: Copy + Into<f64>>(&self, output: &[T], extra: &[T], action: &[T]) -> f64 {
        assert!(action.len() >= self.n, "length of the action");
        let mut total = 0.0;
        for i in 0..self.n {
            let gaussian = self.gaussian(output, extra, i);
            let u: f64 = action[i].into();
            total += gaussian.log_density((u - gaussian.mean) * (-gaussian.log_std).exp());
        }
        total
    }

    fn entropy<T: Copy + Into<f64>>(&self, output: &[T], extra: &[T]) -> f64 {
        let mut total = 0.0;
        for i in 0..self.n {
            let gaussian = self.gaussian(output, extra, i);
            total += 0.5 * (1.0 + TAU.ln()) + gaussian.log_std;
        }
        total
    }

    fn gradient(
        &self,
        output: &[f32],
        extra: &[f32],
        action: &[f32],
        (grad_log_prob, grad_entropy): (f64, f64),
        d_output: &mut [f32],
        d_extra: &mut [f32],
    ) {
        assert!(action.len() >= self.n, "length of the action");
        for i in 0..self.n {
            let gaussian = self.gaussian(output, extra, i);
            let inverse_std = (-gaussian.log_std).exp();
            let z = (f64::from(action[i]) - gaussian.mean) * inverse_std;
            let d_mean = grad_log_prob * z * inverse_std;
            let d_log_std = grad_log_prob * (z * z - 1.0) + grad_entropy;
            self.add(i, d_mean, d_log_std * gaussian.clamp_slope, d_output, d_extra);
        }
    }
}

/// `n` independent choices among `levels` values.
struct Choice {
    n: usize,
    levels: usize,
}

/// Normaliser of one choice's logits x: ln pₖ = xₖ − `shift`.
struct Weights {
    shift: f64,
    entropy: f64,
}

impl Choice {
    fn logits<'a, T>(&self, output: &'a [T]) -> std::slice::ChunksExact<'a, T> {
        output[..self.n * self.levels].chunks_exact(self.levels)
    }

    /// The value that an action's number stands for.
    fn value<T: Into<f64>>(&self, action: T) -> usize {
        (action.into().round() as usize).min(self.levels - 1)
    }

    fn sample(&self, output: &[f32], stream: &mut Stream, action: &mut [f32]) {
        assert!(action.len() >= self.n, "length of the action");
        for (logits, action) in self.logits(output).zip(action) {
            *action = invert(logits, stream.unit()) as f32;
        }
    }

    fn mode(&self, output: &[f32], action: &mut [f32]) {
        assert!(action.len() >= self.n, "length of the action");
        for (logits, action) in self.logits(output).zip(action) {
            let mut best = 0;
            for k in 1..logits.len() {
                if logits[k] > logits[best] {
                    best = k;
                }
            }
            *action = best as f32;
        }
    }

    fn log_prob<T: Copy + Into<f64>>(&self, output: &[T], action: &[T]) -> f64 {
        assert!(action.len() >= self.n, "length of the action");
        self.logits(output).zip(action).map(|(x, a)| x[self.value(*a)].into() - weigh(x).shift).sum()
    }

    fn entropy<T: Copy + Into<f64>>(&self, output: &[T]) -> f64 {
        self.logits(output).map(|logits| weigh(logits).entropy).sum()
    }

    /// ∂ log p_a/∂xₖ = [k = a] − pₖ and ∂H/∂xₖ = −pₖ (ln pₖ + H).
    fn gradient(
        &self,
        output: &[f32],
        action: &[f32],
        (grad_log_prob, grad_entropy): (f64, f64),
        d_output: &mut [f32],
    ) {
        assert!(action.len() >= self.n && d_output.len() == output.len(), "lengths of action and gradient");
        let rows = d_output.chunks_exact_mut(self.levels);
        for ((logits, action), d_logits) in self.logits(output).zip(action).zip(rows) {
            let weights = weigh(logits);
            let chosen = self.value(*action);
            for (k, d) in d_logits.iter_mut().enumerate() {
                let log_p = f64::from(logits[k]) - weights.shift;
                let p = log_p.exp();
                let hit = if k == chosen { 1.0 } else { 0.0 };
                // p ln p is 0 at p = 0, whatever the arithmetic of infinities says
                let d_entropy = if p == 0.0 { 0.0 } else { -p * (log_p + weights.entropy) };
                *d += (grad_log_prob * (hit - p) + grad_entropy * d_entropy) as f32;
            }
        }
    }
}

/// The value at which the running sum of probabilities passes `unit` in [0, 1).
fn invert(logits: &[f32], unit: f64) -> usize {
    let shift = weigh(logits).shift;
    let (mut rest, mut chosen) = (unit, 0);
    for (k, x) in logits.iter().enumerate() {
        let p = (f64::from(*x) - shift).exp();
        // rounding may leave a rest behind the last value: it falls to the last possible one
        if p > 0.0 {
            chosen = k;
        }
        rest -= p;
        if rest < 0.0 {
            break;
        }
    }
    chosen
}

fn weigh<T: Copy + Into<f64>>(logits: &[T]) -> Weights {
    let most = logits.iter().fold(f64::NEG_INFINITY, |most, x| most.max((*x).into()));
    let (mut total, mut moment) = (0.0, 0.0);
    for x in logits {
        let x: f64 = (*x).into() - most;
        let weight = x.exp();
        total += weight;
        // a value ruled out has no part in the entropy, not 0 · ∞
        if weight != 0.0 {
            moment += weight * x;
        }
    }
    Weights { shift: most + total.ln(), entropy: total.ln() - moment / total }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::Purpose;
    use tasks::Space;

    const HEADS: [Head; 3] =
        [Head::Gaussian { n: 3 }, Head::Categorical { n: 5 }, Head::MultiCategorical { n: 3, levels: 4 }];

    fn stream(n: u64) -> Stream {
        Stream::new(11, n, 0, Purpose::POLICY)
    }

    fn wide(x: &[f32]) -> Vec<f64> {
        x.iter().map(|x| f64::from(*x)).collect()
    }

    /// A random row: output, extra and an action of it; log standard deviations in −1.5 … 0.5.
    fn row(head: Head, s: &mut Stream) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
        let output: Vec<f32> = (0..head.n_output()).map(|_| s.uniform(-1.5, 0.5) as f32).collect();
        let extra: Vec<f32> = (0..head.n_extra()).map(|_| s.uniform(-1.5, 0.5) as f32).collect();
        let mut action = vec![0.0; head.n_action()];
        head.sample(&output, &extra, s, &mut action);
        (output, extra, action)
    }

    /// Largest difference of `got` from the central differences of `f(output, extra)` in f64.
    fn worst_difference(
        (output, extra): (&[f32], &[f32]),
        (d_output, d_extra): (&[f32], &[f32]),
        f: impl Fn(&[f64], &[f64]) -> f64,
    ) -> f64 {
        let h = 1e-5;
        let n = output.len();
        let x = [wide(output), wide(extra)].concat();
        let at = |i: usize, by: f64| {
            let mut x = x.clone();
            x[i] += by;
            f(&x[..n], &x[n..])
        };
        let got = [d_output, d_extra].concat();
        (0..x.len()).map(|i| ((at(i, h) - at(i, -h)) / (2.0 * h) - f64::from(got[i])).abs()).fold(0.0, f64::max)
    }

    /// ∫ f over [lo, hi] by the midpoint rule.
    fn integral(lo: f64, hi: f64, n: usize, f: impl Fn(f64) -> f64) -> f64 {
        let h = (hi - lo) / n as f64;
        (0..n).map(|i| f(lo + (i as f64 + 0.5) * h) * h).sum()
    }

    #[test]
    fn gaussian_log_prob_and_entropy_are_the_closed_forms() {
        let head = Head::Gaussian { n: 2 };
        let (mean, log_std, action) = ([0.3_f64, -1.2], [-0.7_f64, 0.4], [0.9_f64, -2.0]);
        let mut want = (0.0, 0.0);
        for i in 0..2 {
            let variance = (2.0 * log_std[i]).exp();
            want.0 -= (action[i] - mean[i]).powi(2) / (2.0 * variance) + 0.5 * (TAU * variance).ln();
            want.1 += 0.5 * (TAU * std::f64::consts::E * variance).ln();
        }
        let got = (head.log_prob_of(&mean, &log_std, &action), head.entropy_of(&mean, &log_std));
        assert!((got.0 - want.0).abs() < 1e-14 && (got.1 - want.1).abs() < 1e-14, "{got:?} {want:?}"); // 0
    }

    #[test]
    fn densities_integrate_to_one_and_their_mean_logarithm_to_the_entropy() {
        let (mean, log_std) = (0.3_f64, -0.6_f64);
        let gaussian = |a: f64| Head::Gaussian { n: 1 }.log_prob_of(&[mean], &[log_std], &[a]);
        let moment = |lo: f64, f: &dyn Fn(f64) -> f64| {
            let n = 40_000;
            (integral(lo, -lo, n, |a| f(a).exp()), -integral(lo, -lo, n, |a| f(a).exp() * f(a)))
        };
        let (one, entropy) = moment(-8.0, &gaussian);
        let want = Head::Gaussian { n: 1 }.entropy_of(&[mean], &[log_std]);
        assert!((one - 1.0).abs() < 1e-12 && (entropy - want).abs() < 1e-12, "{one} {entropy} {want}"); // 8e-15
    }

    #[test]
    fn gradients_agree_with_central_differences() {
        for head in HEADS {
            let mut s = stream(1);
            for _ in 0..20 {
                let (output, extra, action) = row(head, &mut s);
                let (grad_log_prob, grad_entropy) = (s.uniform(-1.0, 1.0) as f32, s.uniform(-1.0, 1.0) as f32);
                let (mut d_output, mut d_extra) = (vec![0.0; head.n_output()], vec![0.0; head.n_extra()]);
                head.gradient(&output, &extra, &action, grad_log_prob, grad_entropy, &mut d_output, &mut d_extra);
                let value = |output: &[f64], extra: &[f64]| {
                    f64::from(grad_log_prob) * head.log_prob_of(output, extra, &wide(&action))
                        + f64::from(grad_entropy) * head.entropy_of(output, extra)
                };
                let worst = worst_difference((&output, &extra), (&d_output, &d_extra), value);
                assert!(worst < 2e-6, "{head:?}: {worst:e}"); // 2e-7 of gradients up to 7 in f32
            }
        }
    }

    #[test]
    fn gradients_are_added_and_scale_with_what_comes_down() {
        for head in HEADS {
            let (output, extra, action) = row(head, &mut stream(2));
            let run = |grad_output: (f32, f32), start: f32| {
                let (mut d_output, mut d_extra) = (vec![start; head.n_output()], vec![start; head.n_extra()]);
                head.gradient(&output, &extra, &action, grad_output.0, grad_output.1, &mut d_output, &mut d_extra);
                [d_output, d_extra].concat()
            };
            let (one, both) = (run((2.0, 0.0), 0.0), run((2.0, -1.0), 3.0));
            for (i, entropy) in run((0.0, -1.0), 0.0).iter().enumerate() {
                assert!((one[i] + entropy + 3.0 - both[i]).abs() < 2e-6, "{head:?} {i}"); // 5e-7
            }
        }
    }

    #[test]
    fn a_log_std_outside_its_limits_counts_as_the_limit_and_has_no_gradient() {
        let at = |log_std: f32| {
            let (mut d_output, mut d_extra) = ([0.0], [0.0]);
            let head = Head::Gaussian { n: 1 };
            head.gradient(&[0.1], &[log_std], &[0.4], 1.0, 0.5, &mut d_output, &mut d_extra);
            (head.log_prob(&[0.1], &[log_std], &[0.4]), head.entropy(&[0.1], &[log_std]), d_output[0], d_extra[0])
        };
        for (limit, outside) in [(LOG_STD_MIN as f32, -7.0), (LOG_STD_MAX as f32, 2.5)] {
            let (inside, outside) = (at(limit), at(outside));
            assert_eq!((inside.0, inside.1, inside.2), (outside.0, outside.1, outside.2));
            assert!(inside.3 != 0.0 && outside.3 == 0.0, "{inside:?} {outside:?}");
        }
        let mut extra = [-7.0, 0.3, 2.5];
        Head::Gaussian { n: 3 }.clamp_extra(&mut extra);
        assert_eq!(extra, [-5.0, 0.3, 2.0]);
    }

    #[test]
    fn whole_numbers_are_drawn_as_often_as_their_probability_says() {
        let head = Head::MultiCategorical { n: 2, levels: 3 };
        let space = Space::MultiDiscrete { n: 2, levels: 3 };
        // a value that is ruled out, and one shifted far: probabilities do not depend on the shift
        let p: [[f32; 3]; 2] = [[0.2, 0.5, 0.3], [0.75, 0.0, 0.25]];
        let output: Vec<f32> = p.iter().zip([0.0, 50.0]).flat_map(|(p, by)| p.map(|p| p.ln() + by)).collect();
        let n = 100_000;
        let (mut s, mut action, mut counts) = (stream(5), [0.0; 2], [[0.0; 3]; 2]);
        for _ in 0..n {
            let log_prob = head.sample(&output, &[], &mut s, &mut action);
            assert!(space.contains(&action));
            let of = [p[0][action[0] as usize], p[1][action[1] as usize]];
            assert!((log_prob - (of[0] * of[1]).ln()).abs() < 1e-5); // 1e-6, logits of 50 in f32
            (0..2).for_each(|i| counts[i][action[i] as usize] += 1.0 / n as f32);
        }
        assert_eq!(s.position(), 2 * 2 * n);
        for (share, p) in counts.as_flattened().iter().zip(p.as_flattened()) {
            let bound = 4.0 * (p * (1.0 - p) / n as f32).sqrt() + 1e-6;
            assert!((share - p).abs() < bound, "{counts:?}");
        }
        let entropy = -(0.2_f32.ln() * 0.2 - 0.5 * 2.0_f32.ln() + 0.3_f32.ln() * 0.3 + 0.75_f32.ln() * 0.75)
            + 0.25 * 4.0_f32.ln();
        assert!((head.entropy(&output, &[]) - entropy).abs() < 1e-5); // 4e-7
        let mut d_output = [0.0; 6];
        head.gradient(&output, &[], &[1.0, 0.0], 1.0, 1.0, &mut d_output, &mut []);
        assert!(d_output.iter().all(|d| d.is_finite()) && d_output[4] == 0.0, "{d_output:?}");
    }

    #[test]
    fn a_rest_left_by_rounding_falls_to_the_last_possible_value() {
        let logits = [0.1, f32::NEG_INFINITY, 0.7, f32::NEG_INFINITY];
        assert_eq!([0.0, 0.3, 0.4, 1.0 + 1e-9].map(|unit| invert(&logits, unit)), [0, 0, 2, 2]);
    }

    #[test]
    fn samples_of_gaussians_have_their_moments_and_entropy() {
        let (head, output, extra) = (Head::Gaussian { n: 1 }, [0.4], [-0.5]);
        let n = 100_000;
        let (mut s, mut action, mut m) = (stream(6), [0.0], [0.0; 3]);
        for _ in 0..n {
            let log_prob = head.sample(&output, &extra, &mut s, &mut action);
            let z = (f64::from(action[0]) - 0.4) * 0.5_f64.exp();
            [z, z * z, -f64::from(log_prob)].iter().zip(&mut m).for_each(|(x, m)| *m += x / n as f64);
        }
        // four deviations: 1, √2 and about 1 over √100000; 0.0023, 0.0006 here
        assert!(m[0].abs() < 0.0127 && (m[1] - 1.0).abs() < 0.018, "{m:?}");
        assert!((m[2] - f64::from(head.entropy(&output, &extra))).abs() < 0.0127, "{m:?}");
    }

    #[test]
    fn a_sample_returns_the_log_prob_of_the_written_action_to_the_bit() {
        for head in HEADS {
            let mut s = stream(7);
            for _ in 0..50 {
                let (output, extra, mut action) = row(head, &mut s);
                let got = head.sample(&output, &extra, &mut s, &mut action);
                assert_eq!(got.to_bits(), head.log_prob(&output, &extra, &action).to_bits());
            }
        }
    }

    #[test]
    fn the_mode_is_the_mean_or_the_first_of_the_largest_logits() {
        let mode = |head: Head, output: &[f32], extra: &[f32]| {
            let mut action = vec![f32::NAN; head.n_action()];
            head.mode(output, extra, &mut action);
            action
        };
        assert_eq!(mode(Head::Gaussian { n: 2 }, &[3.0, -0.5], &[0.0, 0.0]), [3.0, -0.5]);
        assert_eq!(mode(Head::Categorical { n: 4 }, &[0.0, 2.0, -1.0, 2.0], &[]), [1.0]);
        assert_eq!(mode(Head::MultiCategorical { n: 2, levels: 2 }, &[0.0, 1.0, 5.0, 4.0], &[]), [1.0, 0.0]);
    }

    #[test]
    fn numbers_that_are_not_finite_neither_panic_nor_leave_the_range() {
        for (head, space) in
            [(HEADS[1], Space::Discrete { n: 5 }), (HEADS[2], Space::MultiDiscrete { n: 3, levels: 4 })]
        {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let (output, mut action) = (vec![bad; head.n_output()], vec![0.0; head.n_action()]);
                assert!(head.sample(&output, &[], &mut stream(8), &mut action).is_nan());
                assert!(space.contains(&action));
                head.mode(&output, &[], &mut action);
                assert!(space.contains(&action));
                // actions out of range count as the nearest value
                assert!(head.log_prob(&vec![0.0; head.n_output()], &[], &vec![bad; head.n_action()]).is_finite());
            }
        }
        let (mut action, nan) = ([0.0; 3], [f32::NAN; 3]);
        assert!(HEADS[0].sample(&nan, &nan, &mut stream(9), &mut action).is_nan());
    }

    #[test]
    fn heads_are_read_from_tables_and_checked() {
        let head: Head = toml::from_str("kind = 'multi_categorical'\nn = 4\nlevels = 5").unwrap();
        assert_eq!(
            (head, head.n_output(), head.n_extra(), head.n_action()),
            (Head::MultiCategorical { n: 4, levels: 5 }, 20, 0, 4)
        );
        assert_eq!(toml::from_str::<Head>(&toml::to_string(&head).unwrap()).unwrap(), head);
        assert!(toml::from_str::<Head>("kind = 'gaussian'\nn = 4\nlevels = 5").is_err());
        assert!(HEADS.iter().all(|head| head.validate().is_ok()));
        for bad in [Head::Gaussian { n: 0 }, Head::MultiCategorical { n: usize::MAX, levels: 2 }] {
            let text = bad.validate().unwrap_err().to_string();
            assert!(text.starts_with("outputs of the head is") && text.contains("1 to 16777216"), "{text}");
        }
    }
}
