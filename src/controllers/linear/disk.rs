//! Disk margins: gain and phase of a loop may change together, in every loop at once.
//!
//! A loop whose gain is multiplied by any complex f of the disk with the diameter [(2 − α)/(2 + α), (2 + α)/(2 − α)] stays
//! stable, up to α = 1/‖S − ½‖∞ (the balanced disk; with skew σ, 1/‖S + ½(σ − 1)‖∞). With several loops each has an f of its
//! own: α = 1/sup μ(S + ½(σ − 1) I), μ for diagonal complex perturbations, here by its upper bound min over D of
//! σ_max(D M D⁻¹), which is μ for up to three loops and close to it beyond.
//!
//! Source: Seiler, Packard and Gahinet 2020; Safonov 1982 for the convexity in log D; Osborne 1960.

use super::dense::{Complexes, singular_values};
use super::margins::sensitivity;
use super::norms::{h_infinity, top};
use super::response::frequencies;
use super::state_space::StateSpace;
use super::swept::Swept;
use base::error::Result;
use nalgebra::{Complex, DMatrix, DVector};
use serde::Serialize;
use std::f64::consts::TAU;

/// What a loop, or all loops at once, bear.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DiskMargin {
    /// α: the loop bears every complex factor of the disk with the diameter [(2 − α)/(2 + α), (2 + α)/(2 − α)] (balanced, skew 0); 0 for
    /// a loop that is not stable.
    pub alpha: f64,
    /// Where the smallest perturbation acts, rad/s; NaN for a loop that is not stable.
    pub omega: f64,
    /// Least and largest factor on the gain alone.
    pub gain: (f64, f64),
    /// Phase alone, rad, either way.
    pub phase: f64,
}

impl DiskMargin {
    /// That of a loop that is not stable: no frequency, no room, by any skew.
    pub(crate) const NONE: Self = Self { alpha: 0.0, omega: f64::NAN, gain: (1.0, 1.0), phase: 0.0 };

    fn new(alpha: f64, omega: f64, skew: f64) -> Self {
        let low = (2.0 - alpha * (1.0 - skew)) / (2.0 + alpha * (1.0 + skew));
        let most = 2.0 - alpha * (1.0 + skew);
        let high = if most > 0.0 { (2.0 + alpha * (1.0 - skew)) / most } else { f64::INFINITY };
        let cosine = if high.is_finite() { (1.0 + low * high) / (low + high) } else { low };
        Self { alpha, omega, gain: (low, high), phase: cosine.clamp(-1.0, 1.0).acos() }
    }
}

/// The disk margin of one loop, closed with −1: α = 1/‖S + ½(σ − 1)‖∞, σ the `skew` (0: balanced).
///
/// # Errors
/// As [`margins`](super::margins()).
pub fn disk_margin(system: &StateSpace, skew: f64) -> Result<DiskMargin> {
    super::state_space::one_loop(system)?;
    disk_margin_of(&sensitivity(system)?, &[0], skew, true)
}

/// The disk margin of all loops at once: L of as many inputs as outputs, closed with −I, a factor of its own in each.
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) for another shape, or where eigenvalues are not found.
pub fn multiloop_disk_margin(system: &StateSpace, skew: f64) -> Result<DiskMargin> {
    let each: Vec<usize> = (0..system.n_input()).collect();
    disk_margin_of(&sensitivity(system)?, &each, skew, true)
}

/// α from S, where input and output k belong to loop `block[k]`, whose factor acts on all of them alike. Unless D is to be
/// `best`, it is Osborne's: α is then a few percent less than it might be, and found a hundred times faster.
pub(crate) fn disk_margin_of(sensitivity: &StateSpace, block: &[usize], skew: f64, best: bool) -> Result<DiskMargin> {
    let m = moved(sensitivity, skew)?;
    if !m.is_stable()? {
        return Ok(DiskMargin::NONE);
    }
    let n_block = block.iter().max().map_or(0, |most| most + 1);
    if n_block == 1 {
        let peak = h_infinity(&m)?;
        return Ok(DiskMargin::new(1.0 / peak.gain, peak.omega, skew));
    }
    let mut search = Scaling { block, n_block, searches: best, best: 0.0 };
    let swept = Swept::of(&m);
    let mut worst = 0.0;
    let mut grid = frequencies(&m, 300)?;
    grid.insert(0, 0.0);
    for omega in &grid {
        if search.exceeds(&swept.at(m.on_axis(*omega)), 1e-4) {
            worst = *omega;
        }
    }
    let mu = |omega: f64| search.upper_bound(&swept.at(m.on_axis(omega)), 1e-9);
    let at = grid.iter().position(|w| *w == worst).unwrap_or(0);
    let middle = top(&mu, (grid[at.saturating_sub(1)], grid[(at + 1).min(grid.len() - 1)]), 40);
    let (most, omega) =
        [worst, middle, 0.0].into_iter().map(|w| (mu(w), w)).fold((0.0, 0.0), |a, b| if b.0 > a.0 { b } else { a });
    Ok(DiskMargin::new(1.0 / most, omega, skew))
}

/// α of one signal from its S over a period of `period` steps, inputs and outputs step by step, where the factor is that of a filter:
/// of the frequencies that sampling folds onto one, w + 2πn/(period dt), each has a factor of its own, and Osborne's D. (One full
/// factor over the steps of a period could move what it meets between frequencies, as no change of gain or phase does.)
pub(crate) fn folded_disk_margin_of(sensitivity: &StateSpace, period: usize, skew: f64) -> Result<DiskMargin> {
    if !sensitivity.is_stable()? {
        return Ok(DiskMargin::NONE);
    }
    let every = sensitivity.dt().unwrap_or(1.0);
    let (base, dt) = (TAU / every, every / period as f64);
    let even = 1.0 / (period as f64).sqrt();
    let swept = Swept::of(sensitivity);
    let folded = |omega: f64| {
        let wave = |k: usize, n: usize| Complex::from_polar(even, (omega + n as f64 * base) * k as f64 * dt);
        let waves = Complexes::from_fn(period, period, wave);
        waves.adjoint() * swept.driven(sensitivity.on_axis(omega), &waves)
    };
    let mu = |omega: f64| bound_at(folded(omega), skew);
    let mut grid = frequencies(sensitivity, 300)?;
    grid.insert(0, 0.0);
    let sizes: Vec<f64> = grid.iter().map(|omega| mu(*omega)).collect();
    let at = (0..grid.len()).fold(0, |best, k| if sizes[k] > sizes[best] { k } else { best });
    let middle = top(&mu, (grid[at.saturating_sub(1)], grid[(at + 1).min(grid.len() - 1)]), 40);
    let (most, omega) = if mu(middle) > sizes[at] { (mu(middle), middle) } else { (sizes[at], grid[at]) };
    // of the folded frequencies the one that answers most
    let m = folded(omega);
    let size = |n: usize| (m[(n, n)] - 0.5 * (1.0 - skew)).norm();
    let n = (0..period).fold(0, |best, n| if size(n) > size(best) { n } else { best });
    let alias = if 2 * n >= period { n as f64 - period as f64 } else { n as f64 };
    Ok(DiskMargin::new(1.0 / most, (omega + alias * base).abs(), skew))
}

/// The bound 1/α of a loop of several factors at one frequency, from its S there, with Osborne's D.
pub(crate) fn bound_at(mut sensitivity: Complexes, skew: f64) -> f64 {
    let n = sensitivity.nrows();
    for k in 0..n {
        sensitivity[(k, k)] += 0.5 * (skew - 1.0);
    }
    let block: Vec<usize> = (0..n).collect();
    let search = Scaling { block: &block, n_block: n, searches: false, best: 0.0 };
    search.size(&sensitivity, &search.balanced(&sensitivity))
}

/// S + ½(σ − 1) I.
fn moved(s: &StateSpace, skew: f64) -> Result<StateSpace> {
    let n = s.n_output();
    s.parallel(&StateSpace::gain(DMatrix::identity(n, n) * (0.5 * (skew - 1.0)), s.dt())?)
}

/// The search for D = diag(exp d), one number per loop.
struct Scaling<'a> {
    /// The loop of each signal.
    block: &'a [usize],
    n_block: usize,
    /// Whether D is searched for, or Osborne's.
    searches: bool,
    /// The largest bound so far.
    best: f64,
}

impl Scaling<'_> {
    /// Whether the bound at `m` is above the best so far, which it then becomes. Most frequencies are settled by any D.
    fn exceeds(&mut self, m: &Complexes, tolerance: f64) -> bool {
        if self.size(m, &self.balanced(m)) <= self.best {
            return false;
        }
        let bound = self.upper_bound(m, tolerance);
        let higher = bound > self.best;
        self.best = self.best.max(bound);
        higher
    }

    /// min over d of σ_max(exp(d) M exp(−d)) to a relative `tolerance`, by the ellipsoid method: the function is convex and has
    /// edges where singular values meet, which stop descent.
    fn upper_bound(&self, m: &Complexes, tolerance: f64) -> f64 {
        // the last number stays: D and its multiples are one
        let n = self.n_block - 1;
        let start = self.balanced(m);
        if !self.searches {
            return self.size(m, &start);
        }
        let (mut best, slope) = self.value(m, &start);
        let reduced = |slope: &DVector<f64>| slope.rows(0, n).into_owned();
        let (mut center, mut shape) = (reduced(&start), DMatrix::identity(n, n) * 4.0);
        let (mut g, mut depth) = (reduced(&slope), 0.0);
        let count = n as f64;
        for _ in 0..(400 * n * n) {
            let pg = &shape * &g;
            let length = g.dot(&pg).max(0.0).sqrt();
            if length - depth <= tolerance * best || length == 0.0 {
                break;
            }
            // a deep cut: the centre lies above the best value by `depth`
            let cut = (depth / length).min(0.99);
            center -= &pg * ((1.0 + count * cut) / (count + 1.0) / length);
            if n == 1 {
                shape *= ((1.0 - cut) / 2.0).powi(2);
            } else {
                let shrink = count * count * (1.0 - cut * cut) / (count * count - 1.0);
                let along = 2.0 * (1.0 + count * cut) / ((count + 1.0) * (1.0 + cut));
                shape = (&shape - &pg * pg.transpose() * (along / (length * length))) * shrink;
            }
            let (f, slope) = self.value(m, &center.clone().resize_vertically(n + 1, start[n]));
            best = best.min(f);
            (g, depth) = (reduced(&slope), f - best);
        }
        best
    }

    /// exp(d) M exp(−d).
    fn scaled(&self, m: &Complexes, d: &DVector<f64>) -> Complexes {
        let factor = |i: usize, j: usize| Complex::new((d[self.block[i]] - d[self.block[j]]).exp(), 0.0);
        Complexes::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)] * factor(i, j))
    }

    /// σ_max of it.
    fn size(&self, m: &Complexes, d: &DVector<f64>) -> f64 {
        singular_values(&self.scaled(m, d))[0]
    }

    /// σ_max(exp(d) M exp(−d)) and its gradient, σ (|uᵢ|² − |vᵢ|²) summed over each loop.
    fn value(&self, m: &Complexes, d: &DVector<f64>) -> (f64, DVector<f64>) {
        let mut slope = DVector::zeros(self.n_block);
        let bound = 100 * m.nrows();
        let Some(svd) = self.scaled(m, d).try_svd(true, true, f64::EPSILON, bound) else { return (f64::NAN, slope) };
        let (Some(u), Some(vt)) = (&svd.u, &svd.v_t) else { return (f64::NAN, slope) };
        let top = svd.singular_values.imax();
        let sigma = svd.singular_values[top];
        for (i, block) in self.block.iter().enumerate() {
            slope[*block] += sigma * (u[(i, top)].norm_sqr() - vt[(top, i)].norm_sqr());
        }
        (sigma, slope)
    }

    /// Osborne's balance: what enters a loop and what leaves it of equal size.
    fn balanced(&self, m: &Complexes) -> DVector<f64> {
        let mut size: DMatrix<f64> = DMatrix::zeros(self.n_block, self.n_block);
        for i in 0..m.nrows() {
            for j in 0..m.ncols() {
                size[(self.block[i], self.block[j])] += m[(i, j)].norm_sqr();
            }
        }
        let mut d = DVector::zeros(self.n_block);
        for _ in 0..20 {
            for i in 0..self.n_block {
                let others = || (0..self.n_block).filter(|j| *j != i);
                let row: f64 = others().map(|j| size[(i, j)] * f64::exp(2.0 * (d[i] - d[j]))).sum();
                let column: f64 = others().map(|j| size[(j, i)] * f64::exp(2.0 * (d[j] - d[i]))).sum();
                if row > 0.0 && column > 0.0 {
                    d[i] += 0.25 * f64::ln(column / row);
                }
            }
        }
        d
    }
}
