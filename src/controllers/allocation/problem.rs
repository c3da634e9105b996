//! What an allocation is asked: the quadratic program, its cones, and the measure of a solution.
//!
//! ```text
//! minimise   ½ (B u − w)ᵀ W (B u − w) + ½ ρ ‖u − u_pref‖²
//! subject to lower ≤ u ≤ upper,  ‖tailₖ(u)‖ ≤ headₖ(u)  for every cone k
//! ```
//!
//! u are thrusts (N), one per rotor, or components of the force of a thruster that can turn. ρ > 0 makes the answer
//! unique, so that it has derivatives.

use super::characteristic_length;
use base::error::{Error, Result, finite};
use dynamics::Vehicle;
use nalgebra::{DMatrix, DVector};
use std::fmt::Display;

/// Rows of a wrench: force, moment.
pub const WRENCH: usize = 6;
/// Most inputs of one problem.
pub(crate) const MAX_INPUTS: usize = 48;
/// Bounds farther out than this many times what is asked for do not count as the size of the inputs.
pub(super) const LOOSE: f64 = 100.0;
/// Most sweeps for the singular values of one problem: some two are needed for each.
pub(super) const SWEEPS: usize = 10_000;
/// ρ of [`Problem::of_vehicle`] over the largest diagonal entry of BᵀWB: bias of the delivered wrench 1e-6 along a
/// direction as strong as one rotor.
pub(crate) const REGULARISATION: f64 = 1e-6;

/// c + Σ aᵢ u_{jᵢ}.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Affine {
    /// (j, a).
    pub terms: Vec<(usize, f64)>,
    /// c.
    pub constant: f64,
}

impl Affine {
    /// A number.
    pub fn constant(constant: f64) -> Self {
        Self { terms: Vec::new(), constant }
    }

    /// Σ aᵢ u_{jᵢ} without constant.
    pub fn linear(terms: impl IntoIterator<Item = (usize, f64)>) -> Self {
        Self { terms: terms.into_iter().collect(), constant: 0.0 }
    }

    /// Other numbers, in the memory of the old ones.
    fn set(&mut self, constant: f64, terms: impl IntoIterator<Item = (usize, f64)>) {
        self.constant = constant;
        self.terms.clear();
        self.terms.extend(terms);
    }

    /// Its value at u.
    ///
    /// # Panics
    /// If `u` lacks an input that it names.
    pub fn at(&self, u: &[f64]) -> f64 {
        self.terms.iter().fold(self.constant, |sum, (j, a)| sum + a * u[*j])
    }

    /// Its linear part along a direction of u, Σ aᵢ d_{jᵢ}.
    pub fn slope(&self, direction: &[f64]) -> f64 {
        self.terms.iter().map(|(j, a)| a * direction[*j]).sum()
    }
}

/// ‖tail(u)‖ ≤ head(u); without a tail, the half-space head(u) ≥ 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Cone {
    /// The larger side.
    pub head: Affine,
    /// The vector.
    pub tail: Vec<Affine>,
}

impl Cone {
    /// ‖(u_i)‖ ≤ `radius` over the given inputs: the most that a thruster can push.
    pub fn ball(inputs: impl IntoIterator<Item = usize>, radius: f64) -> Self {
        Self { head: Affine::constant(radius), tail: inputs.into_iter().map(|j| Affine::linear([(j, 1.0)])).collect() }
    }

    /// ‖F‖ cos θ ≤ `axis`·F for the force F in the given inputs: at most θ away from a unit axis, cos θ > 0.
    pub fn tilt<const N: usize>(inputs: [usize; N], axis: [f64; N], cosine: f64) -> Self {
        let head = Affine::linear(inputs.iter().zip(axis).map(|(j, a)| (*j, a)));
        Self { head, tail: inputs.iter().map(|j| Affine::linear([(*j, cosine)])).collect() }
    }

    /// `normal`·F ≥ `offset` over the given inputs.
    pub fn half_space<const N: usize>(inputs: [usize; N], normal: [f64; N], offset: f64) -> Self {
        let mut head = Affine::linear(inputs.iter().zip(normal).map(|(j, a)| (*j, a)));
        head.constant = -offset;
        Self { head, tail: Vec::new() }
    }

    /// head(u) − ‖tail(u)‖: how far inside.
    pub fn slack(&self, u: &[f64]) -> f64 {
        let squared: f64 = self.tail.iter().map(|t| t.at(u).powi(2)).sum();
        self.head.at(u) - squared.sqrt()
    }

    /// Head, then tail.
    pub fn rows(&self) -> impl Iterator<Item = &Affine> {
        std::iter::once(&self.head).chain(&self.tail)
    }

    /// Number of rows.
    pub fn dim(&self) -> usize {
        1 + self.tail.len()
    }

    pub(super) fn rows_mut(&mut self) -> impl Iterator<Item = &mut Affine> {
        std::iter::once(&mut self.head).chain(&mut self.tail)
    }
}

/// Writes cones over those of the tick before: where their sizes stay, nothing is allocated. Those that are not written over
/// go away with it.
pub(crate) struct Rewrite<'a> {
    cones: &'a mut Vec<Cone>,
    n: usize,
}

impl<'a> Rewrite<'a> {
    pub(crate) fn of(cones: &'a mut Vec<Cone>) -> Self {
        Self { cones, n: 0 }
    }

    /// ‖(u_i + offset_i)‖ ≤ `radius`.
    pub(crate) fn ball<const N: usize>(&mut self, inputs: [usize; N], offset: [f64; N], radius: f64) {
        let cone = self.next(N);
        cone.head.set(radius, []);
        for (row, (j, c)) in cone.tail.iter_mut().zip(inputs.into_iter().zip(offset)) {
            row.set(c, [(j, 1.0)]);
        }
    }

    /// As [`Cone::tilt`].
    pub(crate) fn tilt<const N: usize>(&mut self, inputs: [usize; N], axis: [f64; N], cosine: f64) {
        let cone = self.next(N);
        cone.head.set(0.0, inputs.into_iter().zip(axis));
        for (row, j) in cone.tail.iter_mut().zip(inputs) {
            row.set(0.0, [(j, cosine)]);
        }
    }

    /// As [`Cone::half_space`].
    pub(crate) fn half_space<const N: usize>(&mut self, inputs: [usize; N], normal: [f64; N], offset: f64) {
        self.next(0).head.set(-offset, inputs.into_iter().zip(normal));
    }

    fn next(&mut self, n_tail: usize) -> &mut Cone {
        if self.n == self.cones.len() {
            self.cones.push(Cone { head: Affine::default(), tail: Vec::new() });
        }
        self.n += 1;
        let cone = &mut self.cones[self.n - 1];
        cone.tail.resize_with(n_tail, Affine::default);
        cone
    }
}

impl Drop for Rewrite<'_> {
    fn drop(&mut self) {
        self.cones.truncate(self.n);
    }
}

/// The numbers of an allocation; all but the wanted wrench.
#[derive(Debug, Clone, PartialEq)]
pub struct Problem {
    /// B, 6 × n: wrench `[force; moment]` per unit of each input, N and N m.
    pub geometry: DMatrix<f64>,
    /// Diagonal of W: 1/N² for the force, 1/(N m)² for the moment, times any priority.
    pub weights: [f64; WRENCH],
    /// ρ, 1/N² if inputs are thrusts.
    pub regularisation: f64,
    /// u_pref, `[n_input]`: where inputs go that the wrench leaves free.
    pub preference: Vec<f64>,
    /// Lower bounds, `[n_input]`, in the unit of the inputs; −∞ where a cone bounds the input.
    pub lower: Vec<f64>,
    /// Upper bounds, `[n_input]`, likewise. A failed rotor has 0 here, a weakened one less than its maximum.
    pub upper: Vec<f64>,
    /// Thrust vectors, tilts, windows.
    pub cones: Vec<Cone>,
    /// Strictly inside all cones (not necessarily inside the bounds): where a solution that violates one by rounding is
    /// pulled to. Empty without cones.
    pub anchor: Vec<f64>,
}

impl Problem {
    /// The rotors of a rigid vehicle: B its [`allocation_matrix`](Vehicle::allocation_matrix), thrusts within
    /// [0, T_max], the least thrusts preferred.
    ///
    /// Weights are 1 for forces and 1/L² for moments, L the [`characteristic_length`], so that a newton is a newton.
    ///
    /// # Errors
    /// [`Error::Value`] if the vehicle is not valid.
    pub fn of_vehicle(vehicle: &Vehicle) -> Result<Self> {
        vehicle.validate()?;
        let length = characteristic_length(&vehicle.allocation_matrix());
        let upper = vehicle.rotors.iter().map(|r| r.max_thrust()).collect();
        Self::boxed(vehicle.allocation_matrix(), balanced_weights(length), upper)
    }

    /// Any geometry with inputs within [0, `upper`], the least preferred, ρ = `REGULARISATION` of the largest diagonal
    /// entry of BᵀWB.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn boxed(geometry: DMatrix<f64>, weights: [f64; WRENCH], upper: Vec<f64>) -> Result<Self> {
        let n = geometry.ncols();
        let largest = (0..n).map(|j| column_weight(&geometry, &weights, j)).fold(0.0, f64::max);
        let problem = Self {
            geometry,
            weights,
            regularisation: if largest > 0.0 { REGULARISATION * largest } else { REGULARISATION },
            preference: vec![0.0; n],
            lower: vec![0.0; n],
            upper,
            cones: Vec::new(),
            anchor: Vec::new(),
        };
        problem.validate()?;
        Ok(problem)
    }

    /// With every weight times its priority, and ρ far below that of the weakest row.
    #[must_use]
    pub(crate) fn with_priorities(mut self, priorities: &[f64; WRENCH]) -> Self {
        self.weights.iter_mut().zip(priorities).for_each(|(weight, priority)| *weight *= priority);
        self.regularisation = 1e-9 * self.hessian().diagonal().max();
        self
    }

    /// n, the number of inputs.
    pub fn n_input(&self) -> usize {
        self.geometry.ncols()
    }

    /// Checks sizes, finiteness, signs and order of bounds.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] that names the number.
    pub fn validate(&self) -> Result<()> {
        let n = self.n_input();
        if n > MAX_INPUTS {
            return Err(Error::limit("allocation: inputs", n, MAX_INPUTS, "Allocate in groups."));
        }
        check("allocation: inputs", n, n > 0, "≥ 1", "Give it a rotor.")?;
        check("allocation: rows of the geometry", self.geometry.nrows(), self.geometry.nrows() == WRENCH, "6", SIZE)?;
        for (name, v) in [("preference", &self.preference), ("lower", &self.lower), ("upper", &self.upper)] {
            let (what, rule) = (format_args!("allocation: length of {name}"), format_args!("{n}, one per input"));
            check(what, v.len(), v.len() == n, rule, SIZE)?;
        }
        finite("allocation: geometry", self.geometry.as_slice())?;
        finite("allocation: weights", &self.weights)?;
        finite("allocation: preference", &self.preference)?;
        for (i, weight) in self.weights.iter().enumerate() {
            check(format_args!("allocation: weights[{i}]"), weight, *weight >= 0.0, "≥ 0", "0 leaves a row out.")?;
        }
        let rho = self.regularisation;
        let remedy = "It makes the answer unique; 1e-6 of the largest entry of BᵀWB is a good start.";
        check("allocation: regularisation", rho, rho.is_finite() && rho > 0.0, "> 0 and finite", remedy)?;
        for i in 0..n {
            let (lo, hi) = (self.lower[i], self.upper[i]);
            let remedy = "A failed rotor is [0, 0].";
            check(
                format_args!("allocation: bounds of input {i}"),
                format_args!("[{lo}, {hi}]"),
                lo <= hi && lo < f64::INFINITY && hi > f64::NEG_INFINITY,
                "in order",
                remedy,
            )?;
        }
        self.validate_cones(n)
    }

    fn validate_cones(&self, n: usize) -> Result<()> {
        for (k, cone) in self.cones.iter().enumerate() {
            for row in cone.rows() {
                let known = row.terms.iter().all(|(j, a)| *j < n && a.is_finite()) && row.constant.is_finite();
                check(
                    format_args!("allocation: cone {k}"),
                    "a row with a number out of range",
                    known,
                    "finite, on inputs that exist",
                    SIZE,
                )?;
            }
        }
        if self.cones.is_empty() {
            return Ok(());
        }
        check("allocation: length of anchor", self.anchor.len(), self.anchor.len() == n, "one per input", SIZE)?;
        for (k, cone) in self.cones.iter().enumerate() {
            let slack = cone.slack(&self.anchor);
            let what = format_args!("allocation: slack of cone {k} at the anchor");
            check(what, slack, slack > 0.0, "> 0", "Choose the anchor strictly inside all cones.")?;
        }
        Ok(())
    }

    /// f(u) = ½ (Bu − w)ᵀ W (Bu − w) + ½ ρ ‖u − u_pref‖².
    pub fn objective(&self, wrench: &[f64; WRENCH], u: &[f64]) -> f64 {
        let miss: f64 = self.miss(wrench, u).iter().zip(&self.weights).map(|(e, w)| w * e * e).sum();
        let far: f64 = u.iter().zip(&self.preference).map(|(a, b)| (a - b).powi(2)).sum();
        0.5 * (miss + self.regularisation * far)
    }

    /// B u: the wrench `[force; moment]` that inputs make, N, N m.
    pub fn delivered(&self, u: &[f64]) -> [f64; WRENCH] {
        let b = self.geometry.as_slice();
        let mut w = [0.0; WRENCH];
        for (j, u) in u.iter().enumerate() {
            for i in 0..WRENCH {
                w[i] += b[WRENCH * j + i] * u;
            }
        }
        w
    }

    /// B u − w: what is made beyond the wanted wrench, N, N m.
    pub fn miss(&self, wrench: &[f64; WRENCH], u: &[f64]) -> [f64; WRENCH] {
        let mut e = self.delivered(u);
        for (e, w) in e.iter_mut().zip(wrench) {
            *e -= w;
        }
        e
    }

    /// ∇f(u) = Bᵀ W (Bu − w) + ρ (u − u_pref), into `gradient`, `[n_input]`.
    pub fn gradient(&self, wrench: &[f64; WRENCH], u: &[f64], gradient: &mut [f64]) {
        let mut e = self.miss(wrench, u);
        for (e, w) in e.iter_mut().zip(&self.weights) {
            *e *= w;
        }
        let b = self.geometry.as_slice();
        for (j, g) in gradient.iter_mut().enumerate() {
            let column = &b[WRENCH * j..WRENCH * (j + 1)];
            let pull: f64 = column.iter().zip(&e).map(|(b, e)| b * e).sum();
            *g = pull + self.regularisation * (u[j] - self.preference[j]);
        }
    }

    /// H = Bᵀ W B + ρ I, n × n.
    pub fn hessian(&self) -> DMatrix<f64> {
        let weighted = DMatrix::from_diagonal(&DVector::from_column_slice(&self.weights)) * &self.geometry;
        let mut h = self.geometry.transpose() * weighted;
        for i in 0..self.n_input() {
            h[(i, i)] += self.regularisation;
        }
        h
    }

    /// Sizes that residuals are measured by. Of inputs: the largest bound or constant of a cone, but not more than a
    /// hundred times what the wrench and the preference ask for, so that a loose bound does not make every residual
    /// small. Of gradients: H times that size, at least BᵀWw.
    pub fn scales(&self, wrench: &[f64; WRENCH]) -> Scales {
        let b = self.geometry.as_slice();
        let (mut steepest, mut pull) = (0.0_f64, 0.0_f64);
        for column in b.chunks_exact(WRENCH) {
            let (mut curve, mut own) = (0.0, 0.0);
            for k in 0..WRENCH {
                curve += self.weights[k] * column[k] * column[k];
                own += self.weights[k] * column[k] * wrench[k];
            }
            (steepest, pull) = (steepest.max(curve), pull.max(own.abs()));
        }
        self.scales_of(steepest + self.regularisation, pull)
    }

    /// [`scales`](Self::scales) from the largest diagonal entry of H and of BᵀWw.
    pub(super) fn scales_of(&self, steepest: f64, pull: f64) -> Scales {
        let limits = self.limits();
        let asked = if steepest > 0.0 { pull / steepest } else { 0.0 }.max(limits.asked);
        let asked = LOOSE * if asked > 0.0 { asked } else { limits.tightest };
        let input = limits.allowed.min(asked).max(1e-12);
        Scales { input, gradient: (steepest * input).max(pull) }
    }

    /// What scales depend on beside the wrench.
    pub(super) fn limits(&self) -> Limits {
        let (mut asked, mut allowed, mut tightest) = (0.0_f64, 0.0_f64, f64::INFINITY);
        for i in 0..self.n_input() {
            let (lower, upper) = (self.lower[i], self.upper[i]);
            // the input nearest to rest
            asked = asked.max(self.preference[i].abs()).max(lower).max(-upper);
            for bound in [lower.abs(), upper.abs()] {
                if bound > 0.0 && bound.is_finite() {
                    (allowed, tightest) = (allowed.max(bound), tightest.min(bound));
                }
            }
        }
        for row in self.cones.iter().flat_map(Cone::rows) {
            allowed = allowed.max(row.constant.abs());
        }
        Limits {
            asked,
            tightest: if tightest.is_infinite() { 0.0 } else { tightest },
            allowed: if allowed > 0.0 { allowed } else { f64::INFINITY },
        }
    }

    /// Largest violation of any bound or cone, in the unit of the inputs; 0 where all hold exactly.
    pub fn violation(&self, u: &[f64]) -> f64 {
        let outside = u.iter().zip(&self.lower).zip(&self.upper).map(|((u, lo), hi)| (lo - u).max(u - hi));
        let cones = self.cones.iter().map(|c| -c.slack(u));
        outside.chain(cones).fold(0.0, |m: f64, v| if v.is_nan() { f64::INFINITY } else { m.max(v) })
    }

    /// Where a solver without an earlier answer starts: the preference, or the anchor where there are cones, within all
    /// limits.
    pub(super) fn start(&self, u: &mut [f64]) {
        u.copy_from_slice(if self.cones.is_empty() { &self.preference } else { &self.anchor });
        self.repair(u, &[]);
    }

    /// Moves u to where every bound and cone holds exactly: clips it, then pulls it towards the clipped anchor (or, where
    /// that is outside a cone, towards a point between `good` and the anchor) as little as bisection finds. Bounds that are out of order
    /// or NaN are left out. Where neither point is inside, the clipped u remains; [`violation`](Self::violation) tells.
    pub fn repair(&self, u: &mut [f64], good: &[f64]) {
        self.clip(u);
        if !self.breaks_a_cone(u) || self.anchor.len() != u.len() {
            return;
        }
        let mut inside = self.anchor.clone();
        self.clip(&mut inside);
        if self.breaks_a_cone(&inside) && good.len() == u.len() {
            self.inwards(good, &mut inside);
        }
        if !self.breaks_a_cone(&inside) {
            self.pull(u, &inside);
        }
    }

    /// Half of the way from `good` towards the anchor that the bounds allow: inside the cones where `good` is not outside.
    fn inwards(&self, good: &[f64], inside: &mut [f64]) {
        inside.copy_from_slice(good);
        self.clip(inside);
        let mut share = 1.0_f64;
        for i in 0..inside.len() {
            let way = self.anchor[i] - inside[i];
            let room = if way > 0.0 { self.upper[i] - inside[i] } else { inside[i] - self.lower[i] };
            if way.abs() > room {
                share = share.min(room / way.abs());
            }
        }
        for i in 0..inside.len() {
            inside[i] += 0.5 * share * (self.anchor[i] - inside[i]);
        }
        self.clip(inside);
    }

    /// Each input within its own bounds, where those are in order; what is not a number becomes 0 first.
    fn clip(&self, u: &mut [f64]) {
        for ((u, lo), hi) in u.iter_mut().zip(&self.lower).zip(&self.upper) {
            if lo <= hi {
                *u = if u.is_finite() { *u } else { 0.0 }.max(*lo).min(*hi);
            }
        }
    }

    fn breaks_a_cone(&self, u: &[f64]) -> bool {
        !self.cones.iter().all(|c| c.slack(u) >= 0.0)
    }

    /// The least power of two of the way to `inside` that is enough, then halving.
    fn pull(&self, u: &mut [f64], inside: &[f64]) {
        let from = u.to_vec();
        let along = |t: f64, u: &mut [f64]| {
            for i in 0..u.len() {
                u[i] = from[i] + t * (inside[i] - from[i]);
            }
            self.clip(u);
        };
        let (mut low, mut high) = (0.0, 1e-16);
        along(high, u);
        while self.breaks_a_cone(u) && high < 1.0 {
            (low, high) = (high, (2.0 * high).min(1.0));
            along(high, u);
        }
        for _ in 0..8 {
            let middle = 0.5 * (low + high);
            along(middle, u);
            if self.breaks_a_cone(u) { low = middle } else { high = middle }
        }
        along(high, u);
    }
}

/// See [`Problem::scales`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// N.
    pub input: f64,
    /// 1/N.
    pub gradient: f64,
}

/// What [`Scales`] depend on beside the wrench.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// The largest input that the preference and the bounds ask for.
    pub asked: f64,
    /// The least bound: where nothing is asked for, the size of what could be; 0 without one.
    pub tightest: f64,
    /// The largest bound or constant of a cone; infinite without one.
    pub allowed: f64,
}

const SIZE: &str = "Build it with Problem::boxed or Problem::of_vehicle.";

/// Writes its texts only where it fails, since every evaluation of an allocation is checked.
fn check(what: impl Display, value: impl Display, holds: bool, limit: impl Display, remedy: &str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::value(what.to_string(), value, limit.to_string(), remedy)) }
}

/// bⱼᵀ W bⱼ.
fn column_weight(geometry: &DMatrix<f64>, weights: &[f64; WRENCH], j: usize) -> f64 {
    geometry.column(j).iter().zip(weights).map(|(b, w)| w * b * b).sum()
}

/// 1 per force row, 1/L² per moment row.
pub fn balanced_weights(length: f64) -> [f64; WRENCH] {
    let m = 1.0 / (length * length);
    [1.0, 1.0, 1.0, m, m, m]
}

/// Bounds of a tick: `lower` and `upper`, narrowed to what a change of at most `most` from `previous` reaches. Where
/// they conflict (a rotor that has just failed) the absolute bounds win. A NaN bound stays one.
pub fn rate_window(lower: f64, upper: f64, previous: f64, most: f64) -> (f64, f64) {
    if !(lower <= upper && previous.is_finite() && most >= 0.0) {
        return (lower, upper);
    }
    ((previous - most).max(lower).min(upper), (previous + most).max(lower).min(upper))
}
