//! A quadratic program over N stages that linear dynamics link, with bounds on every input.
//!
//! ```text
//! min  Σₖ ½ zₖᵀ Hₖ zₖ + hₖᵀ zₖ  +  ½ x_Nᵀ Q_N x_N + q_Nᵀ x_N  +  soft bounds of states,    zₖ = [uₖ; xₖ]
//! s.t. xₖ₊₁ = Aₖ xₖ + Bₖ uₖ + cₖ,   x₀ given,   lowerₖ ≤ uₖ ≤ upperₖ
//! ```
//!
//! A soft bound adds ½ w (x − upper)² above it and ½ w (lower − x)² below: the cost stays convex and smooth, and no state makes
//! the program infeasible.

use autodiff::columns::{LINE, Lines};
use base::error::{Error, Result, finite};
use nalgebra::{DMatrix, DVector};

/// How many numbers there are of each kind, and how they are padded to whole registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sizes {
    /// States.
    pub n: usize,
    /// Inputs.
    pub m: usize,
    /// Stages.
    pub stages: usize,
    /// n, padded.
    pub rows: usize,
    /// m, padded: where the states begin in z.
    pub first: usize,
    /// Of z, padded.
    pub all: usize,
}

impl Sizes {
    fn new(n: usize, m: usize, stages: usize) -> Self {
        let (rows, first) = (n.next_multiple_of(LINE), m.next_multiple_of(LINE));
        Self { n, m, stages, rows, first, all: first + rows }
    }
}

/// Most numbers of all Hessians: half a gibibyte; a program takes about four times that.
const MOST_NUMBERS: usize = 1 << 26;

/// Numbers of many stages, each beginning at a line of the cache.
#[derive(Debug, Clone)]
pub(super) struct Blocks {
    lines: Lines,
    /// Numbers of a block.
    each: usize,
}

impl Blocks {
    /// `count` blocks of `each` zeros.
    pub(super) fn zeros(count: usize, each: usize) -> Self {
        let each = each.next_multiple_of(LINE);
        Self { lines: Lines::zeros(count * each / LINE), each }
    }

    #[inline(always)]
    pub(super) fn of(&self, k: usize) -> &[f64] {
        &self.lines.as_flattened()[k * self.each..(k + 1) * self.each]
    }

    #[inline(always)]
    pub(super) fn of_mut(&mut self, k: usize) -> &mut [f64] {
        &mut self.lines.as_flattened_mut()[k * self.each..(k + 1) * self.each]
    }

    /// Block k and the one behind it.
    #[inline(always)]
    pub(super) fn pair_mut(&mut self, k: usize) -> (&mut [f64], &mut [f64]) {
        self.lines.as_flattened_mut()[k * self.each..(k + 2) * self.each].split_at_mut(self.each)
    }

    /// The numbers of others of the same size.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.lines.as_flattened_mut().copy_from_slice(other.lines.as_flattened());
    }

    /// Sets all numbers.
    pub(super) fn fill(&mut self, value: f64) {
        self.lines.as_flattened_mut().fill(value);
    }
}

/// A soft bound of one state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoftBound {
    /// Number of the state.
    pub state: usize,
    /// Least value that costs nothing; −∞ for none.
    pub lower: f64,
    /// Largest value that costs nothing; ∞ for none.
    pub upper: f64,
    /// w, ≥ 0.
    pub weight: f64,
}

impl SoftBound {
    /// By how much a value is beyond it: positive above, negative below, 0 within.
    pub(super) fn beyond(&self, value: f64) -> f64 {
        (value - self.upper).max(0.0) + (value - self.lower).min(0.0)
    }
}

/// The program; see the [module](self). All stages begin as zeros, without bounds.
#[derive(Debug, Clone)]
pub struct StageQp {
    pub(super) sizes: Sizes,
    /// [B A] of each stage by columns of z, padded.
    pub(super) columns: Blocks,
    /// Its rows.
    pub(super) by_rows: Blocks,
    /// c.
    pub(super) gaps: Blocks,
    /// H of each stage, then of the end, by columns.
    pub(super) hessians: Blocks,
    /// h, likewise.
    pub(super) slopes: Blocks,
    pub(super) lower: Blocks,
    pub(super) upper: Blocks,
    /// Of stages 1 to N.
    pub(super) soft: Vec<Vec<SoftBound>>,
}

impl StageQp {
    /// Of n states, m inputs and N stages.
    ///
    /// # Errors
    /// [`Error::Value`] where one of them is 0, [`Error::Limit`] for more than 1024 numbers of a stage or 100 000 stages.
    pub fn new(n: usize, m: usize, stages: usize) -> Result<Self> {
        for (what, value) in [("states", n), ("inputs", m), ("stages", stages)] {
            if value == 0 {
                let remedy = "Give a problem that has something to decide.";
                return Err(Error::value(format!("number of {what} of a program"), 0, "≥ 1", remedy));
            }
        }
        if n + m > 1024 {
            return Err(Error::limit("states and inputs of a stage", n + m, 1024, "Take a smaller model."));
        }
        if stages > 100_000 {
            return Err(Error::limit("number of stages", stages, 100_000, "Take longer stages."));
        }
        let sizes = Sizes::new(n, m, stages);
        let numbers = (stages + 1).saturating_mul(sizes.all * sizes.all);
        if numbers > MOST_NUMBERS {
            let what = format!("numbers of the Hessians of {stages} stages");
            return Err(Error::limit(what, numbers, MOST_NUMBERS, "Take fewer stages, or a smaller model."));
        }
        let mut own = Self {
            columns: Blocks::zeros(stages, sizes.all * sizes.rows),
            by_rows: Blocks::zeros(stages, sizes.all * n),
            gaps: Blocks::zeros(stages, sizes.rows),
            hessians: Blocks::zeros(stages + 1, sizes.all * sizes.all),
            slopes: Blocks::zeros(stages + 1, sizes.all),
            lower: Blocks::zeros(stages, sizes.first),
            upper: Blocks::zeros(stages, sizes.first),
            soft: vec![Vec::new(); stages],
            sizes,
        };
        for k in 0..stages {
            own.lower.of_mut(k)[..m].fill(f64::NEG_INFINITY);
            own.upper.of_mut(k)[..m].fill(f64::INFINITY);
        }
        Ok(own)
    }

    /// n.
    pub fn n_state(&self) -> usize {
        self.sizes.n
    }

    /// m.
    pub fn n_input(&self) -> usize {
        self.sizes.m
    }

    /// N.
    pub fn n_stage(&self) -> usize {
        self.sizes.stages
    }

    /// A, B, c of a stage.
    ///
    /// # Errors
    /// [`Error::Value`] for other sizes, numbers that are not finite, or no such stage.
    pub fn set_dynamics(&mut self, stage: usize, a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DVector<f64>) -> Result<()> {
        let Sizes { n, m, stages, .. } = self.sizes;
        let fits = stage < stages && a.shape() == (n, n) && b.shape() == (n, m) && c.len() == n;
        self.fits(fits, stage)?;
        finite("A", a.as_slice())?;
        finite("B", b.as_slice())?;
        finite("c", c.as_slice())?;
        self.write_dynamics(stage, |row, column| a[(row, column)], |row, column| b[(row, column)]);
        self.gaps.of_mut(stage)[..n].copy_from_slice(c.as_slice());
        Ok(())
    }

    pub(super) fn write_dynamics(
        &mut self,
        stage: usize,
        a: impl Fn(usize, usize) -> f64,
        b: impl Fn(usize, usize) -> f64,
    ) {
        let Sizes { n, m, rows, first, all, .. } = self.sizes;
        let (columns, by_rows) = (self.columns.of_mut(stage), self.by_rows.of_mut(stage));
        let mut put = |row: usize, z: usize, value: f64| {
            columns[z * rows + row] = value;
            by_rows[row * all + z] = value;
        };
        for row in 0..n {
            (0..m).for_each(|j| put(row, j, b(row, j)));
            (0..n).for_each(|j| put(row, first + j, a(row, j)));
        }
    }

    /// Q, S, R, q, r of a stage, of ½ xᵀQx + uᵀSx + ½ uᵀRu + qᵀx + rᵀu. Q and R are taken for symmetric: their upper triangles are read.
    ///
    /// # Errors
    /// As [`set_dynamics`](Self::set_dynamics).
    pub fn set_cost(
        &mut self,
        stage: usize,
        [q, s, r]: [&DMatrix<f64>; 3],
        [q_slope, r_slope]: [&DVector<f64>; 2],
    ) -> Result<()> {
        let Sizes { n, m, stages, first, all, .. } = self.sizes;
        let fits = stage < stages && q.shape() == (n, n) && s.shape() == (m, n) && r.shape() == (m, m);
        self.fits(fits && q_slope.len() == n && r_slope.len() == m, stage)?;
        for (what, numbers) in [("Q", q.as_slice()), ("S", s.as_slice()), ("R", r.as_slice())] {
            finite(what, numbers)?;
        }
        finite("q", q_slope.as_slice())?;
        finite("r", r_slope.as_slice())?;
        let hessian = self.hessians.of_mut(stage);
        for j in 0..n {
            (0..n).for_each(|i| hessian[(first + j) * all + first + i] = q[(i.min(j), i.max(j))]);
            for i in 0..m {
                hessian[(first + j) * all + i] = s[(i, j)];
                hessian[i * all + first + j] = s[(i, j)];
            }
        }
        for j in 0..m {
            (0..m).for_each(|i| hessian[j * all + i] = r[(i.min(j), i.max(j))]);
        }
        let slope = self.slopes.of_mut(stage);
        slope[..m].copy_from_slice(r_slope.as_slice());
        slope[first..first + n].copy_from_slice(q_slope.as_slice());
        Ok(())
    }

    /// Q_N and q_N.
    ///
    /// # Errors
    /// As [`set_dynamics`](Self::set_dynamics).
    pub fn set_terminal(&mut self, q: &DMatrix<f64>, slope: &DVector<f64>) -> Result<()> {
        let Sizes { n, stages, first, all, .. } = self.sizes;
        self.fits(q.shape() == (n, n) && slope.len() == n, stages)?;
        finite("Q_N", q.as_slice())?;
        finite("q_N", slope.as_slice())?;
        let hessian = self.hessians.of_mut(stages);
        for j in 0..n {
            (0..n).for_each(|i| hessian[(first + j) * all + first + i] = q[(i.min(j), i.max(j))]);
        }
        self.slopes.of_mut(stages)[first..first + n].copy_from_slice(slope.as_slice());
        Ok(())
    }

    /// Bounds of the inputs of a stage; ±∞ for none.
    ///
    /// # Errors
    /// [`Error::Value`] for other lengths, no such stage, NaN, or a lower bound above its upper one.
    pub fn set_bounds(&mut self, stage: usize, lower: &[f64], upper: &[f64]) -> Result<()> {
        let Sizes { m, stages, .. } = self.sizes;
        self.fits(stage < stages && lower.len() == m && upper.len() == m, stage)?;
        check_bounds(lower, upper)?;
        self.lower.of_mut(stage)[..m].copy_from_slice(lower);
        self.upper.of_mut(stage)[..m].copy_from_slice(upper);
        Ok(())
    }

    /// Soft bounds of the states behind a stage: of xₖ₊₁.
    ///
    /// # Errors
    /// [`Error::Value`] for no such stage or state, a lower bound above its upper one, or a weight that is negative or not finite.
    pub fn set_soft_bounds(&mut self, stage: usize, bounds: &[SoftBound]) -> Result<()> {
        let Sizes { n, stages, .. } = self.sizes;
        self.fits(stage < stages, stage)?;
        one_each(bounds)?;
        for bound in bounds {
            if bound.state >= n {
                let rule = format!("0 to {}", n - 1);
                return Err(Error::value("state of a soft bound", bound.state, rule, "Number the states from 0."));
            }
            check_bounds(&[bound.lower], &[bound.upper])?;
            if !(bound.weight >= 0.0 && bound.weight.is_finite()) {
                let remedy = "Leave the bound out where it is to cost nothing.";
                return Err(Error::value("weight of a soft bound", bound.weight, "≥ 0 and finite", remedy));
            }
        }
        self.soft[stage].clear();
        self.soft[stage].extend_from_slice(bounds);
        Ok(())
    }

    /// A, B, c of a stage.
    ///
    /// # Panics
    /// For a stage beyond N − 1.
    #[doc(hidden)]
    pub fn dynamics(&self, stage: usize) -> (DMatrix<f64>, DMatrix<f64>, DVector<f64>) {
        let Sizes { n, m, rows, first, .. } = self.sizes;
        let columns = self.columns.of(stage);
        let of = |row: usize, z: usize| columns[z * rows + row];
        let (a, b) = (DMatrix::from_fn(n, n, |i, j| of(i, first + j)), DMatrix::from_fn(n, m, of));
        (a, b, DVector::from_column_slice(&self.gaps.of(stage)[..n]))
    }

    /// Q, S, R and q, r of a stage; of stage N those of the end, with zeros for inputs.
    ///
    /// # Panics
    /// For a stage beyond N.
    #[doc(hidden)]
    pub fn cost(&self, stage: usize) -> ([DMatrix<f64>; 3], [DVector<f64>; 2]) {
        let Sizes { n, m, stages, first, all, .. } = self.sizes;
        let (hessian, slope) = (self.hessians.of(stage), self.slopes.of(stage));
        let steers = stage < stages;
        let of = |row: usize, column: usize| hessian[column * all + row];
        let of_input = |row: usize, column: usize| if steers { of(row, column) } else { 0.0 };
        let q = DMatrix::from_fn(n, n, |i, j| of(first + i, first + j));
        let s = DMatrix::from_fn(m, n, |i, j| of_input(i, first + j));
        let r = DMatrix::from_fn(m, m, of_input);
        let inputs = DVector::from_fn(m, |i, _| if steers { slope[i] } else { 0.0 });
        ([q, s, r], [DVector::from_column_slice(&slope[first..first + n]), inputs])
    }

    /// Bounds of the inputs of a stage.
    ///
    /// # Panics
    /// For a stage beyond N − 1.
    #[doc(hidden)]
    pub fn bounds(&self, stage: usize) -> (&[f64], &[f64]) {
        let m = self.sizes.m;
        (&self.lower.of(stage)[..m], &self.upper.of(stage)[..m])
    }

    /// Soft bounds of the states behind a stage.
    ///
    /// # Panics
    /// For a stage beyond N − 1.
    #[doc(hidden)]
    pub fn soft_bounds(&self, stage: usize) -> &[SoftBound] {
        &self.soft[stage]
    }

    fn fits(&self, fits: bool, stage: usize) -> Result<()> {
        if fits {
            return Ok(());
        }
        let Sizes { n, m, stages, .. } = self.sizes;
        let rule = format!("of {n} states and {m} inputs, within {stages} stages");
        Err(Error::value(format!("numbers of stage {stage}"), "of other sizes", rule, "Give all of a stage's numbers."))
    }
}

/// Refuses two bounds of one state.
pub(super) fn one_each(bounds: &[SoftBound]) -> Result<()> {
    for (i, bound) in bounds.iter().enumerate() {
        if bounds[..i].iter().any(|other| other.state == bound.state) {
            let remedy = "Give its lower and upper limit together.";
            return Err(Error::value("state of a soft bound", bound.state, "bounded once", remedy));
        }
    }
    Ok(())
}

/// Refuses bounds that nothing lies within.
pub(super) fn check_bounds(lower: &[f64], upper: &[f64]) -> Result<()> {
    match lower.iter().zip(upper).position(|(l, u)| !(l <= u && *l < f64::INFINITY && *u > f64::NEG_INFINITY)) {
        None => Ok(()),
        Some(i) => {
            let value = format!("[{}, {}]", lower[i], upper[i]);
            Err(Error::value(format!("bounds {i}"), value, "lower ≤ upper", "Give the smaller one first."))
        }
    }
}
