//! Running normalisation of a critic's targets: the statistics of PopArt (van Hasselt et al. 2016) as MAPPO uses them
//! (Yu et al. 2022).
//!
//! The critic learns (target − mean)/std, whatever the scale of the rewards. Its numbers are denormalised before
//! anything is computed from them, with the statistics of the moment at which the network was asked; targets are
//! normalised after the update. PopArt also rewrites the critic's last layer so that its denormalised output stays: those of
//! kept experience do so ([`Unit::into_other`]), those of rollouts follow by learning.

use base::error::{Error, Result, finite};

/// Least variance to divide by.
const VARIANCE_FLOOR: f64 = 1e-2;

/// What a critic's numbers mean: y of it is y · std + mean of reward.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    /// Mean of the targets.
    pub mean: f32,
    /// Their standard deviation.
    pub std: f32,
}

impl Unit {
    /// In reward.
    pub fn denormalise(&self, y: f32) -> f32 {
        y * self.std + self.mean
    }

    /// From reward.
    pub fn normalise(&self, x: f32) -> f32 {
        (x - self.mean) / self.std
    }

    /// Factor and shift of a number of this unit that says the same in `other`.
    pub fn into_other(self, other: Self) -> (f32, f32) {
        (self.std / other.std, (self.mean - other.mean) / other.std)
    }
}

/// Exponential mean and mean square of targets, with the bias towards their start at 0 taken out.
///
/// An update with the mean m and mean square s of a slice is
///
/// ```text
/// a ← β a + (1 − β) m     b ← β b + (1 − β) s     w ← β w + (1 − β)
/// mean = a/w              variance = max(b/w − mean², 10⁻²)
/// ```
///
/// w = 1 − βᵏ behind k updates, so the first one gives the slice's own mean and variance. Before it, mean 0 and
/// variance 1.
#[derive(Debug, Clone, PartialEq)]
pub struct ValueNorm {
    beta: f64,
    mean: f64,
    mean_square: f64,
    weight: f64,
    ignored: u64,
}

impl ValueNorm {
    /// Of nothing yet. `beta` in [0, 1) is what an update leaves of the old statistics; 0.995 is usual for one per
    /// iteration.
    ///
    /// # Errors
    /// [`Error::Value`] outside that range.
    pub fn new(beta: f64) -> Result<Self> {
        finite("beta of the value norm", &[beta])?;
        if !(0.0..1.0).contains(&beta) {
            return Err(Error::value("beta of the value norm", beta, "in [0, 1)", "0.995 is usual."));
        }
        Ok(Self { beta, mean: 0.0, mean_square: 0.0, weight: 0.0, ignored: 0 })
    }

    /// Takes in the targets of an iteration, summed in their order in `f64`. Those that are not finite are left out and
    /// counted; a slice without a finite one changes nothing else.
    pub fn update(&mut self, targets: &[f32]) {
        self.take_in(targets.iter().copied());
    }

    fn take_in(&mut self, targets: impl Iterator<Item = f32>) {
        let (mut n, mut sum, mut squares) = (0_u64, 0.0, 0.0);
        for target in targets {
            if !target.is_finite() {
                self.ignored += 1;
                continue;
            }
            let target = f64::from(target);
            n += 1;
            sum += target;
            squares += target * target;
        }
        if n == 0 {
            return;
        }
        let share = 1.0 - self.beta;
        self.mean = self.beta * self.mean + share * sum / n as f64;
        self.mean_square = self.beta * self.mean_square + share * squares / n as f64;
        self.weight = self.beta * self.weight + share;
    }

    /// Mean of the targets.
    pub fn mean(&self) -> f64 {
        if self.weight > 0.0 { self.mean / self.weight } else { 0.0 }
    }

    /// Standard deviation to divide by, at least 0.1.
    pub fn std(&self) -> f64 {
        if self.weight > 0.0 {
            (self.mean_square / self.weight - self.mean().powi(2)).max(VARIANCE_FLOOR).sqrt()
        } else {
            1.0
        }
    }

    /// Takes targets in the unit of now into the statistics; gives factor and shift by which numbers say the same in the new one.
    pub fn move_unit(&mut self, targets: impl Iterator<Item = f32>) -> (f32, f32) {
        let before = self.unit();
        self.take_in(targets.map(|y| before.denormalise(y)));
        before.into_other(self.unit())
    }

    /// Of the critic's numbers as they are now.
    pub fn unit(&self) -> Unit {
        Unit { mean: self.mean() as f32, std: self.std() as f32 }
    }

    /// Every x becomes (x − mean)/std.
    pub fn normalise(&self, values: &mut [f32]) {
        let (mean, inverse) = (self.mean(), 1.0 / self.std());
        values.iter_mut().for_each(|x| *x = ((f64::from(*x) - mean) * inverse) as f32);
    }

    /// Every y becomes y · std + mean.
    pub fn denormalise(&self, values: &mut [f32]) {
        let (mean, std) = (self.mean(), self.std());
        values.iter_mut().for_each(|y| *y = (f64::from(*y) * std + mean) as f32);
    }

    /// All that changes: a, b, w, number ignored.
    pub fn save(&self) -> [f64; 4] {
        [self.mean, self.mean_square, self.weight, self.ignored as f64]
    }

    /// Goes on from saved numbers; β stays its own.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers that no update gives; nothing changes then.
    pub fn load(&mut self, saved: [f64; 4]) -> Result<()> {
        finite("saved value norm", &saved)?;
        let [mean, mean_square, weight, ignored] = saved;
        let remedy = "Take the numbers from ValueNorm::save.";
        if !(0.0..=1.0).contains(&weight) {
            return Err(Error::value("weight of the saved value norm", weight, "in [0, 1]", remedy));
        }
        for (what, x) in [("mean square", mean_square), ("number ignored", ignored)] {
            if x < 0.0 {
                return Err(Error::value(format!("{what} of the saved value norm"), x, "≥ 0", remedy));
            }
        }
        (self.mean, self.mean_square, self.weight, self.ignored) = (mean, mean_square, weight, ignored as u64);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::{Purpose, Stream};

    fn targets(seed: u64, n: usize) -> Vec<f32> {
        let mut s = Stream::new(seed, 0, 0, Purpose::LEARNING);
        (0..n).map(|_| (80.0 + 6.0 * s.normal()) as f32).collect()
    }

    fn moments(x: &[f32]) -> (f64, f64) {
        let mean = x.iter().map(|x| f64::from(*x)).sum::<f64>() / x.len() as f64;
        (mean, (x.iter().map(|x| (f64::from(*x) - mean).powi(2)).sum::<f64>() / x.len() as f64).sqrt())
    }

    #[test]
    fn the_first_update_gives_the_moments_of_its_slice_whatever_beta() {
        for beta in [0.0, 0.9, 0.995, 0.99999] {
            let (x, mut norm) = (targets(1, 1000), ValueNorm::new(beta).unwrap());
            norm.update(&x);
            let (mean, std) = moments(&x);
            // 1e-12: differences of squares of 80
            assert!((norm.mean() - mean).abs() < 1e-9 && (norm.std() - std).abs() < 1e-8, "beta {beta}: {norm:?}");
            let mut normalised = x.clone();
            norm.normalise(&mut normalised);
            let (mean, std) = moments(&normalised);
            assert!(mean.abs() < 1e-6 && (std - 1.0).abs() < 1e-6, "beta {beta}: {mean:e} {std}"); // 6e-10
        }
    }

    #[test]
    fn later_updates_weigh_slices_by_powers_of_beta() {
        let (beta, mut norm) = (0.9_f64, ValueNorm::new(0.9).unwrap());
        let (mut sums, mut square) = ([0.0; 2], 0.0);
        for k in 0..30 {
            let x = targets(k, 50);
            norm.update(&x);
            let weight = beta.powi(29 - k as i32);
            let (mean, std) = moments(&x);
            sums = [sums[0] + weight * mean, sums[1] + weight];
            square += weight * (std * std + mean * mean);
        }
        let mean = sums[0] / sums[1];
        let std = (square / sums[1] - mean * mean).sqrt();
        // 4e-13 both
        assert!((norm.mean() - mean).abs() < 1e-11 && (norm.std() - std).abs() < 1e-10, "{mean} {std} {norm:?}");
    }

    #[test]
    fn normalise_and_denormalise_are_inverse() {
        let mut norm = ValueNorm::new(0.995).unwrap();
        let identity = |norm: &ValueNorm, tolerance: f32| {
            let x = [-300.0_f32, -1.0, 0.0, 0.3, 80.0, 1e4];
            let mut y = x;
            norm.normalise(&mut y);
            norm.denormalise(&mut y);
            for (x, y) in x.iter().zip(y) {
                assert!((x - y).abs() <= tolerance * x.abs().max(80.0), "{x} {y}");
            }
        };
        identity(&norm, 0.0);
        norm.update(&targets(2, 400));
        identity(&norm, 2e-7); // 2e-8
        // all targets equal: the floor
        let mut norm = ValueNorm::new(0.5).unwrap();
        norm.update(&[3.0; 10]);
        assert_eq!((norm.mean(), norm.std()), (3.0, 0.1));
        identity(&norm, 2e-7);
    }

    #[test]
    fn targets_that_are_not_finite_are_left_out_and_counted() {
        let clean = targets(3, 100);
        let mut dirty = clean.clone();
        for (place, bad) in [(100, f32::NAN), (50, f32::INFINITY), (0, f32::NEG_INFINITY)] {
            dirty.insert(place, bad);
        }
        let (mut a, mut b) = (ValueNorm::new(0.9).unwrap(), ValueNorm::new(0.9).unwrap());
        a.update(&clean);
        b.update(&dirty);
        b.update(&[f32::NAN; 4]);
        b.update(&[]);
        assert_eq!((a.mean().to_bits(), a.std().to_bits()), (b.mean().to_bits(), b.std().to_bits()));
        assert_eq!((a.ignored, b.ignored), (0, 7));
        b.update(&[f32::MAX; 3]);
        assert!(b.mean().is_finite() && b.std().is_finite());
    }

    #[test]
    fn saved_numbers_continue_with_the_same_bits() {
        let mut norm = ValueNorm::new(0.99).unwrap();
        norm.update(&targets(4, 64));
        norm.update(&[f32::NAN, 3.0]);
        let mut back = ValueNorm::new(0.99).unwrap();
        back.load(norm.save()).unwrap();
        assert_eq!(back, norm);
        norm.update(&targets(5, 64));
        back.update(&targets(5, 64));
        assert_eq!(back, norm);
    }

    #[test]
    fn numbers_that_no_update_gives_are_refused_and_change_nothing() {
        for bad in [1.0, -0.1, f64::NAN] {
            let text = ValueNorm::new(bad).unwrap_err().to_string();
            assert!(text.starts_with("beta of the value norm is"), "{text}");
        }
        let mut norm = ValueNorm::new(0.9).unwrap();
        norm.update(&[1.0, 2.0]);
        let before = norm.clone();
        for (saved, told) in [
            ([f64::NAN, 1.0, 0.5, 0.0], "saved value norm[0] is NaN"),
            ([0.0, -1.0, 0.5, 0.0], "mean square of the saved value norm is -1"),
            ([0.0, 1.0, 1.5, 0.0], "weight of the saved value norm is 1.5"),
            ([0.0, 1.0, 0.5, -2.0], "number ignored of the saved value norm is -2"),
        ] {
            let text = norm.load(saved).unwrap_err().to_string();
            assert!(text.starts_with(told), "{text}");
            assert_eq!(norm, before);
        }
    }
}
