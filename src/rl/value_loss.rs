//! Losses of values: Huber's, and the one of quantiles of the return (Dabney et al. 2018).
//!
//! A value is `n` numbers: quantiles of the return at the shares (i + ½)/n, or with n = 1 its mean. Its loss against a target of as
//! many is the mean over all pairs of Huber's, in which quantile i counts what it is below by (i + ½)/n and what it is above by the
//! rest.

/// Where errors of quantiles begin to count linearly, in deviations of the targets: wide ones would make expectiles of them.
const QUANTILE_KINK: f32 = 0.02;

/// An error's loss and its slope: Huber's, or nothing where it is not finite.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Huber {
    /// Weight · ½ e² within ± the limit, linear beyond.
    pub loss: f32,
    /// Its slope.
    pub slope: f32,
}

impl Huber {
    /// Of an error with a weight, linear beyond ±`huber`.
    pub fn of(error: f32, weight: f32, huber: f32) -> Self {
        if !error.is_finite() {
            return Self::default();
        }
        let bounded = error.clamp(-huber, huber);
        Self { loss: weight * bounded * (error - 0.5 * bounded), slope: weight * bounded }
    }
}

/// One quantile against all of a target, summed over these: the loss, its slope, and the errors themselves.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct QuantileLoss {
    /// Σ of losses.
    pub loss: f32,
    /// Of the loss by the quantile.
    pub slope: f32,
    /// Σ (own − yⱼ).
    pub error: f32,
}

/// Of quantile `i`, which says `own`, against as many of the target as there are; a mean alone by Huber's loss with its limit `huber`.
#[inline]
pub fn quantile_huber(own: f32, i: usize, target: &[f32], weight: f32, huber: f32) -> QuantileLoss {
    let n = target.len();
    let middle = (i as f32 + 0.5) / n as f32;
    let mut sum = QuantileLoss::default();
    for y in target {
        // of a mean alone both sides count alike
        let (side, kink, unit) = match n {
            1 => (1.0, huber, 1.0),
            _ => (if own > *y { 1.0 - middle } else { middle }, QUANTILE_KINK, QUANTILE_KINK),
        };
        let error = Huber::of(own - y, weight, kink);
        sum.loss += side * error.loss / unit;
        sum.slope += side * error.slope / unit;
        sum.error += own - y;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Down its slope the quantiles of five even numbers are found; of a single value it is Huber's.
    #[test]
    fn quantiles_come_to_lie_where_their_shares_of_the_target_end() {
        let target: Vec<f32> = (0..5).map(|k| k as f32).collect();
        let mut own = [0.0_f32; 5];
        for step in 0..4000 {
            let rate = 0.02 / (1.0 + 0.01 * step as f32);
            for (i, own) in own.iter_mut().enumerate() {
                *own -= rate * quantile_huber(*own, i, &target, 1.0, 1.0).slope;
            }
        }
        // the i-th of five lies at the i-th of five
        let off = own.iter().zip(&target).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        println!("{own:?}");
        assert!(off < 0.05, "{own:?}"); // measured 0.009
        let mean = quantile_huber(3.0, 0, &[1.0], 0.5, 10.0);
        assert_eq!((mean.slope, mean.loss, mean.error), (1.0, 1.0, 2.0));
    }

    #[test]
    fn slopes_are_those_of_differences() {
        let target = [0.3, -0.2, 1.4];
        for (own, i) in [(0.1_f32, 0), (0.31, 1), (2.0, 2)] {
            let h = 1e-3;
            let [up, down] = [own + h, own - h].map(|x| quantile_huber(x, i, &target, 0.7, 1.0).loss);
            let (slope, wanted) = (quantile_huber(own, i, &target, 0.7, 1.0).slope, (up - down) / (2.0 * h));
            assert!((slope - wanted).abs() < 2e-3, "{own}: {slope} {wanted}");
        }
    }
}
