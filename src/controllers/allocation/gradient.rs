//! Exact derivatives of an allocation, by differentiating its optimality conditions.
//!
//! At the optimum u*, with c(u) = 0 the cones that act (c = head − ‖tail‖, or every row at an apex), μ their
//! multipliers, and the inputs F that no bound holds,
//!
//! ```text
//! g_F(u) − Σ μₖ ∇cₖ,F = 0,   c(u) = 0,   u_A = bound_A
//! ```
//!
//! The implicit function theorem gives du* from any change of the problem's numbers: with H̃ = ∇²f − Σ μₖ ∇²cₖ and
//! C = ∇c,
//!
//! ```text
//! | H̃_FF  −C_Fᵀ | |du_F|     | ∂(g − Σ μ ∇c)_F + H̃_FA du_A |
//! | C_F     0   | |dμ  | = − | ∂c + C_A du_A               |
//! ```
//!
//! and its transpose the gradient of any cost of u*: one solve for all numbers (Amos and Kolter 2017; Agrawal et al.
//! 2019 for cones). Where a constraint acts without force (slack and multiplier both zero) u* has a kink; the derivative
//! is then that of one side, and [`AllocationSensitivity::margin`] says how near that is.

use super::allocator::AllocationSolution;
use super::problem::{Cone, Problem, SWEEPS, Scales, WRENCH};
use super::variation::Variation;
use nalgebra::{DMatrix, DVector};

/// Below this [`AllocationSensitivity::margin`] a derivative counts as one-sided.
pub(crate) const DEGENERATE: f64 = 1e-9;
/// Rows of active constraints that keep less than this share of their length after those before them are dropped.
const INDEPENDENT: f64 = 1e-9;

/// What a constraint does at the optimum.
#[derive(Debug, Clone)]
enum Acting {
    /// ‖tail‖ = head > 0, or a half-space on its edge.
    Surface { cone: usize },
    /// One row of a cone at its apex.
    Row { cone: usize, row: usize },
}

/// One equation c = 0 that acts.
#[derive(Debug, Clone)]
struct Equation {
    acting: Acting,
    /// ∇c over all inputs.
    slope: DVector<f64>,
    /// μ.
    multiplier: f64,
}

/// The optimality conditions of one solution, factorised.
#[derive(Debug, Clone)]
pub struct AllocationSensitivity {
    problem: Problem,
    inputs: DVector<f64>,
    /// B u − w.
    miss: [f64; WRENCH],
    /// −1 at the lower bound, +1 at the upper, 0 free.
    status: Vec<i8>,
    free: Vec<usize>,
    equations: Vec<Equation>,
    /// Those that follow from the others: they carry force too.
    redundant: Vec<Equation>,
    /// H̃ over all inputs.
    curvature: DMatrix<f64>,
    system: Factored,
    margin: f64,
}

#[derive(Debug, Clone)]
enum Factored {
    /// No cone acts: H_FF = L Lᵀ.
    Cholesky(nalgebra::Cholesky<f64, nalgebra::Dyn>),
    /// The saddle-point matrix.
    Lu(nalgebra::LU<f64, nalgebra::Dyn, nalgebra::Dyn>),
    /// Pseudo-inverse, where that is singular.
    Inverse(DMatrix<f64>),
}

impl AllocationSensitivity {
    /// At a solution of `problem` for `wrench` whose residual is small; a held solution has no derivative: `None`.
    pub fn new(problem: &Problem, wrench: &[f64; WRENCH], solution: &AllocationSolution) -> Option<Self> {
        if !solution.residual.is_finite() {
            return None;
        }
        let (n, scales) = (problem.n_input(), problem.scales(wrench));
        let inputs = DVector::from_column_slice(&solution.inputs);
        let mut found = Found { scales, margin: f64::INFINITY, equations: Vec::new(), curvature: problem.hessian() };
        let mut gradient = vec![0.0; n];
        problem.gradient(wrench, &solution.inputs, &mut gradient);
        for (k, cone) in problem.cones.iter().enumerate() {
            let z = solution.duals.get(k).filter(|z| z.len() == cone.dim())?;
            found.cone(k, cone, z, &inputs, &mut gradient);
        }
        let status: Vec<i8> = (0..n).map(|i| found.bound(problem, i, inputs[i], gradient[i])).collect();
        let free: Vec<usize> = (0..n).filter(|i| status[*i] == 0).collect();
        let (equations, redundant) = independent(found.equations, &free);
        let system = factorise(&found.curvature, &free, &equations);
        let miss = problem.miss(wrench, &solution.inputs);
        // which of several dependent constraints gives way is decided by their order
        let margin = if redundant.is_empty() { found.margin } else { 0.0 };
        let curvature = found.curvature;
        Some(Self {
            problem: problem.clone(),
            inputs,
            miss,
            status,
            free,
            equations,
            redundant,
            curvature,
            system,
            margin,
        })
    }

    /// Strict complementarity: over all constraints, the least of max(slack/s_u, multiplier/s_g). At 0 some constraint
    /// touches without force, and the derivative is one-sided. Also 0 where acting constraints depend on each other, as at
    /// the apex of a cone: moving one of them alone has no derivative.
    pub fn margin(&self) -> f64 {
        self.margin
    }

    /// Whether the derivative may be that of one side only: [`margin`](Self::margin) below `DEGENERATE`.
    pub fn is_one_sided(&self) -> bool {
        self.margin < DEGENERATE
    }

    /// One Newton step on the optimality conditions from the inputs and multipliers this was made from: an interior point
    /// becomes exact to rounding where its active set is right. `duals` are those of the solution; returns inputs `[n_input]`, and
    /// multipliers of each cone.
    pub fn polished(&self, duals: &[Vec<f64>]) -> (Vec<f64>, Vec<Vec<f64>>) {
        let (p, n) = (&self.problem, self.problem.n_input());
        let mut u = self.inputs.clone();
        for i in 0..n {
            u[i] = match self.status[i] {
                -1 => p.lower[i],
                1 => p.upper[i],
                _ => u[i],
            };
        }
        let wrench: [f64; WRENCH] = {
            let delivered = p.delivered(self.inputs.as_slice());
            std::array::from_fn(|k| delivered[k] - self.miss[k])
        };
        let mut right = vec![0.0; n];
        p.gradient(&wrench, u.as_slice(), &mut right);
        let mut shifts = Vec::with_capacity(self.equations.len());
        for equation in self.equations.iter().chain(&self.redundant) {
            for j in 0..n {
                right[j] -= equation.multiplier * equation.slope[j];
            }
        }
        for equation in &self.equations {
            shifts.push(match equation.acting {
                Acting::Row { cone, row } => row_of(&p.cones[cone], row).at(u.as_slice()),
                Acting::Surface { cone } => p.cones[cone].slack(u.as_slice()),
            });
        }
        let (f, m) = (self.free.len(), self.equations.len());
        let stacked = DVector::from_fn(f + m, |i, _| if i < f { -right[self.free[i]] } else { -shifts[i - f] });
        let solved = self.system.solve(&stacked);
        for (k, i) in self.free.iter().enumerate() {
            u[*i] += solved[k];
        }
        let mut z: Vec<Vec<f64>> = duals.iter().map(|z| vec![0.0; z.len()]).collect();
        for (k, equation) in self.equations.iter().chain(&self.redundant).enumerate() {
            let force = equation.multiplier + if k < m { solved[f + k] } else { 0.0 };
            match equation.acting {
                Acting::Row { cone, row } => z[cone][row] = force,
                Acting::Surface { cone } => {
                    let (unit, _) = direction(&p.cones[cone], u.as_slice());
                    z[cone][0] = force;
                    z[cone][1..].iter_mut().zip(unit).for_each(|(z, t)| *z = -force * t);
                }
            }
        }
        (u.iter().copied().collect(), z)
    }

    /// du*, `[n_input]`, for a change of the problem's numbers.
    ///
    /// # Panics
    /// If `change` does not have the sizes of the problem.
    pub fn forward(&self, change: &Variation) -> Vec<f64> {
        let n = self.problem.n_input();
        let mut du = DVector::zeros(n);
        for i in 0..n {
            du[i] = match self.status[i] {
                -1 => change.lower[i],
                1 => change.upper[i],
                _ => 0.0,
            };
        }
        let mut right = self.gradient_change(change) + &self.curvature * &du;
        let mut shifts = Vec::with_capacity(self.equations.len());
        for equation in &self.equations {
            shifts.push(self.equation_change(equation, change, &mut right) + equation.slope.dot(&du));
        }
        let (f, m) = (self.free.len(), self.equations.len());
        let stacked = DVector::from_fn(f + m, |i, _| if i < f { -right[self.free[i]] } else { -shifts[i - f] });
        let solved = self.system.solve(&stacked);
        for (k, i) in self.free.iter().enumerate() {
            du[*i] = solved[k];
        }
        du.iter().copied().collect()
    }

    /// ∂ of ∇f at fixed u.
    fn gradient_change(&self, change: &Variation) -> DVector<f64> {
        let (p, n) = (&self.problem, self.problem.n_input());
        let (b, db) = (&p.geometry, &change.geometry);
        let mut weighted = [0.0; WRENCH];
        let mut weighted_change = [0.0; WRENCH];
        for k in 0..WRENCH {
            let de = (0..n).map(|j| db[(k, j)] * self.inputs[j]).sum::<f64>() - change.wrench[k];
            weighted[k] = p.weights[k] * self.miss[k];
            weighted_change[k] = change.weights[k] * self.miss[k] + p.weights[k] * de;
        }
        DVector::from_fn(n, |j, _| {
            let pull: f64 = (0..WRENCH).map(|k| b[(k, j)] * weighted_change[k] + db[(k, j)] * weighted[k]).sum();
            let away = self.inputs[j] - p.preference[j];
            pull + change.regularisation * away - p.regularisation * change.preference[j]
        })
    }

    /// ∂c at fixed u; takes μ ∂∇c off `right`.
    fn equation_change(&self, equation: &Equation, change: &Variation, right: &mut DVector<f64>) -> f64 {
        let moved = |k: usize, r: usize| {
            let (row, by) = (row_of(&self.problem.cones[k], r), &change.cones[k][r]);
            by.constant + row.terms.iter().zip(&by.terms).map(|((j, _), a)| a * self.inputs[*j]).sum::<f64>()
        };
        match equation.acting {
            Acting::Row { cone, row } => {
                for ((j, _), a) in
                    row_of(&self.problem.cones[cone], row).terms.iter().zip(&change.cones[cone][row].terms)
                {
                    right[*j] -= equation.multiplier * a;
                }
                moved(cone, row)
            }
            Acting::Surface { cone } => {
                let (own, by) = (&self.problem.cones[cone], &change.cones[cone]);
                let (unit, length) = direction(own, self.inputs.as_slice());
                let shifts: Vec<f64> = (1..own.dim()).map(|r| moved(cone, r)).collect();
                let along: f64 = unit.iter().zip(&shifts).map(|(t, s)| t * s).sum();
                for ((j, _), a) in own.head.terms.iter().zip(&by[0].terms) {
                    right[*j] -= equation.multiplier * a;
                }
                for (i, row) in own.tail.iter().enumerate() {
                    let turn = (shifts[i] - unit[i] * along) / length;
                    for ((j, a), da) in row.terms.iter().zip(&by[i + 1].terms) {
                        right[*j] += equation.multiplier * (da * unit[i] + a * turn);
                    }
                }
                moved(cone, 0) - along
            }
        }
    }

    /// The gradient of a cost with respect to every number, from `cotangent` = ∂cost/∂u*, `[n_input]`: the transpose of
    /// [`forward`](Self::forward).
    ///
    /// # Panics
    /// If `cotangent` is shorter.
    pub fn reverse(&self, cotangent: &[f64]) -> Variation {
        let mut out = Variation::zero(&self.problem);
        self.reverse_into(cotangent, &mut out);
        out
    }

    /// Likewise, over the numbers of `out`.
    ///
    /// # Panics
    /// If `cotangent` or `out` do not have the sizes of the problem.
    pub fn reverse_into(&self, cotangent: &[f64], out: &mut Variation) {
        let (p, n) = (&self.problem, self.problem.n_input());
        let (f, m) = (self.free.len(), self.equations.len());
        let stacked = DVector::from_fn(f + m, |i, _| if i < f { cotangent[self.free[i]] } else { 0.0 });
        let solved = self.system.solve_transposed(&stacked);
        let mut y = DVector::zeros(n);
        for (k, i) in self.free.iter().enumerate() {
            y[*i] = solved[k];
        }
        let by = &p.geometry * &y;
        for k in 0..WRENCH {
            out.wrench[k] = p.weights[k] * by[k];
            out.weights[k] = -by[k] * self.miss[k];
            for j in 0..n {
                out.geometry[(k, j)] = -(y[j] * p.weights[k] * self.miss[k] + p.weights[k] * by[k] * self.inputs[j]);
            }
        }
        out.regularisation = -(0..n).map(|j| y[j] * (self.inputs[j] - p.preference[j])).sum::<f64>();
        let pulled = &self.curvature * &y;
        for j in 0..n {
            out.preference[j] = p.regularisation * y[j];
            let held: f64 = (0..m).map(|k| self.equations[k].slope[j] * solved[f + k]).sum();
            let through = cotangent[j] - pulled[j] - held;
            out.lower[j] = if self.status[j] == -1 { through } else { 0.0 };
            out.upper[j] = if self.status[j] == 1 { through } else { 0.0 };
        }
        for row in out.cones.iter_mut().flatten() {
            row.constant = 0.0;
            row.terms.fill(0.0);
        }
        for (equation, nu) in self.equations.iter().zip(&solved.as_slice()[f..]) {
            self.reverse_equation(equation, *nu, &y, out);
        }
    }

    /// The transpose of [`equation_change`](Self::equation_change).
    fn reverse_equation(&self, equation: &Equation, nu: f64, y: &DVector<f64>, out: &mut Variation) {
        let (u, mu) = (&self.inputs, equation.multiplier);
        match equation.acting {
            Acting::Row { cone, row } => {
                let by = &mut out.cones[cone][row];
                by.constant -= nu;
                for ((j, _), a) in row_of(&self.problem.cones[cone], row).terms.iter().zip(&mut by.terms) {
                    *a += mu * y[*j] - nu * u[*j];
                }
            }
            Acting::Surface { cone } => {
                let (own, by) = (&self.problem.cones[cone], &mut out.cones[cone]);
                let (unit, length) = direction(own, u.as_slice());
                by[0].constant -= nu;
                for ((j, _), a) in own.head.terms.iter().zip(&mut by[0].terms) {
                    *a += mu * y[*j] - nu * u[*j];
                }
                let slopes: Vec<f64> = own.tail.iter().map(|r| r.slope(y.as_slice())).collect();
                let along: f64 = unit.iter().zip(&slopes).map(|(t, s)| t * s).sum();
                for (i, row) in own.tail.iter().enumerate() {
                    let shift = nu * unit[i] - mu * (slopes[i] - unit[i] * along) / length;
                    by[i + 1].constant += shift;
                    for ((j, _), a) in row.terms.iter().zip(&mut by[i + 1].terms) {
                        *a += shift * u[*j] - mu * unit[i] * y[*j];
                    }
                }
            }
        }
    }
}

fn row_of(cone: &Cone, row: usize) -> &super::Affine {
    if row == 0 { &cone.head } else { &cone.tail[row - 1] }
}

/// t/‖t‖ and ‖t‖ of a cone's tail.
fn direction(cone: &Cone, u: &[f64]) -> (Vec<f64>, f64) {
    let tail: Vec<f64> = cone.tail.iter().map(|r| r.at(u)).collect();
    let length = tail.iter().map(|t| t * t).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    (tail.iter().map(|t| t / length).collect(), length)
}

/// What acts, as it is found.
struct Found {
    scales: Scales,
    margin: f64,
    equations: Vec<Equation>,
    curvature: DMatrix<f64>,
}

impl Found {
    /// Whether `slack` or `force` decides; remembers how clearly.
    fn acts(&mut self, slack: f64, force: f64) -> bool {
        let (slack, force) = (slack / self.scales.input, force / self.scales.gradient);
        self.margin = self.margin.min(slack.max(force));
        slack < force
    }

    fn bound(&mut self, problem: &Problem, i: usize, u: f64, gradient: f64) -> i8 {
        let (lower, upper) = (problem.lower[i], problem.upper[i]);
        if lower == upper {
            return if gradient > 0.0 { -1 } else { 1 };
        }
        if u - lower < upper - u {
            return if self.acts(u - lower, gradient) { -1 } else { 0 };
        }
        if upper.is_finite() && self.acts(upper - u, -gradient) { 1 } else { 0 }
    }

    /// Takes the cone's force off `gradient`; notes its equations.
    fn cone(&mut self, k: usize, cone: &Cone, z: &[f64], u: &DVector<f64>, gradient: &mut [f64]) {
        for (row, z) in cone.rows().zip(z) {
            for (j, a) in &row.terms {
                gradient[*j] -= a * z;
            }
        }
        let (head, tail): (f64, f64) = (z[0], z[1..].iter().map(|z| z * z).sum::<f64>().sqrt());
        if !self.acts(cone.slack(u.as_slice()), head) {
            return;
        }
        if !cone.tail.is_empty() && self.acts(cone.head.at(u.as_slice()), head - tail) {
            for row in 0..cone.dim() {
                let slope = dense(u.len(), row_of(cone, row).terms.iter().copied());
                self.equations.push(Equation { acting: Acting::Row { cone: k, row }, slope, multiplier: z[row] });
            }
            return;
        }
        let (unit, length) = direction(cone, u.as_slice());
        let mut slope = dense(u.len(), cone.head.terms.iter().copied());
        let rows: Vec<_> = cone.tail.iter().map(|r| dense(u.len(), r.terms.iter().copied())).collect();
        for (t, row) in unit.iter().zip(&rows) {
            slope -= row * *t;
        }
        // −μ ∇²c = μ Aᵀ (I − t̂t̂ᵀ) A / ‖t‖
        let along = rows.iter().zip(&unit).fold(DVector::zeros(u.len()), |sum, (row, t)| sum + row * *t);
        for row in &rows {
            self.curvature += row * row.transpose() * (head / length);
        }
        self.curvature -= &along * along.transpose() * (head / length);
        self.equations.push(Equation { acting: Acting::Surface { cone: k }, slope, multiplier: head });
    }
}

fn dense(n: usize, terms: impl Iterator<Item = (usize, f64)>) -> DVector<f64> {
    let mut v = DVector::zeros(n);
    for (j, a) in terms {
        v[j] += a;
    }
    v
}

/// The equations whose slopes over the free inputs do not follow from those before them (Gram and Schmidt), and the rest.
fn independent(equations: Vec<Equation>, free: &[usize]) -> (Vec<Equation>, Vec<Equation>) {
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let (mut kept, mut redundant) = (Vec::new(), Vec::new());
    for equation in equations {
        let own = DVector::from_fn(free.len(), |i, _| equation.slope[free[i]]);
        let mut rest = own.clone();
        for b in basis.iter().chain(&basis) {
            rest -= b * b.dot(&rest);
        }
        if rest.norm() > INDEPENDENT * own.norm().max(f64::MIN_POSITIVE) {
            basis.push(rest.normalize());
            kept.push(equation);
        } else {
            redundant.push(equation);
        }
    }
    (kept, redundant)
}

fn factorise(curvature: &DMatrix<f64>, free: &[usize], equations: &[Equation]) -> Factored {
    let (f, m) = (free.len(), equations.len());
    let block = DMatrix::from_fn(f, f, |i, j| curvature[(free[i], free[j])]);
    if m == 0
        && let Some(cholesky) = block.clone().cholesky()
    {
        return Factored::Cholesky(cholesky);
    }
    let mut saddle = DMatrix::zeros(f + m, f + m);
    saddle.view_mut((0, 0), (f, f)).copy_from(&block);
    for (k, equation) in equations.iter().enumerate() {
        for (i, input) in free.iter().enumerate() {
            saddle[(i, f + k)] = -equation.slope[*input];
            saddle[(f + k, i)] = equation.slope[*input];
        }
    }
    let lu = saddle.clone().lu();
    if lu.is_invertible() {
        return Factored::Lu(lu);
    }
    let empty = DMatrix::zeros(f + m, f + m);
    let svd = saddle.try_svd(true, true, 5.0 * f64::EPSILON, SWEEPS);
    Factored::Inverse(svd.and_then(|svd| svd.pseudo_inverse(1e-12).ok()).unwrap_or(empty))
}

impl Factored {
    fn solve(&self, b: &DVector<f64>) -> DVector<f64> {
        match self {
            Self::Cholesky(c) => c.solve(b),
            Self::Lu(lu) => lu.solve(b).unwrap_or_else(|| DVector::zeros(b.len())),
            Self::Inverse(inverse) => inverse * b,
        }
    }

    /// The saddle matrix is symmetric but for the signs of its second row and column of blocks.
    fn solve_transposed(&self, b: &DVector<f64>) -> DVector<f64> {
        match self {
            Self::Cholesky(c) => c.solve(b),
            Self::Lu(lu) => {
                let mut x = b.clone();
                lu_transposed(lu, &mut x);
                x
            }
            Self::Inverse(inverse) => inverse.transpose() * b,
        }
    }
}

/// x ← A⁻ᵀ x from P A = L U: Uᵀ z = x, Lᵀ w = z, A⁻ᵀ x = Pᵀ w.
fn lu_transposed(lu: &nalgebra::LU<f64, nalgebra::Dyn, nalgebra::Dyn>, x: &mut DVector<f64>) {
    lu.u().tr_solve_upper_triangular_mut(x);
    lu.l().tr_solve_lower_triangular_mut(x);
    lu.p().inv_permute_rows(x);
}
