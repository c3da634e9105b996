//! The certified path: any [`Problem`] as a cone program for clarabel. The door to that crate.
//!
//! Goulart and Chen (2024), "Clarabel: an interior-point solver for conic programs with quadratic objectives". It has no
//! warm start; the structure is set up once and only numbers change from tick to tick.

use super::problem::{Problem, WRENCH};
use base::error::{Error, Result};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use std::collections::BTreeMap;

/// An interior point of a [`Problem`] that clarabel offers; not yet certified.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ConicSolution {
    /// u, N.
    pub inputs: Vec<f64>,
    /// Multipliers zₖ of each cone, head first, in the unit of ∇f.
    pub duals: Vec<Vec<f64>>,
    /// Interior-point iterations.
    pub iterations: u32,
    /// Whether clarabel calls it solved.
    pub solved: bool,
}

/// A problem's structure in clarabel.
pub struct ConicSolver {
    solver: DefaultSolver<f64>,
    shape: Shape,
    data: Data,
}

/// What has to stay the same between two solves.
#[derive(Debug, Clone, PartialEq)]
struct Shape {
    n_input: usize,
    /// Inputs with a finite lower bound, upper bound.
    lower: Vec<usize>,
    upper: Vec<usize>,
    /// Inputs of every row of every cone.
    cones: Vec<Vec<Vec<usize>>>,
}

impl Shape {
    fn of(problem: &Problem) -> Self {
        let finite = |v: &[f64]| (0..v.len()).filter(|i| v[*i].is_finite()).collect();
        let inputs = |row: &super::problem::Affine| row.terms.iter().map(|(j, _)| *j).collect();
        Self {
            n_input: problem.n_input(),
            lower: finite(&problem.lower),
            upper: finite(&problem.upper),
            cones: problem.cones.iter().map(|c| c.rows().map(inputs).collect()).collect(),
        }
    }

    fn n_bound(&self) -> usize {
        self.lower.len() + self.upper.len()
    }
}

/// ½ uᵀPu + qᵀu, s = b − A u in the cones; compressed columns.
#[derive(Debug, Clone, Default)]
struct Data {
    p: Vec<f64>,
    q: Vec<f64>,
    a: Vec<f64>,
    b: Vec<f64>,
    /// Place in `a` of every (row, input), row by row.
    places: BTreeMap<(usize, usize), usize>,
}

impl Data {
    /// All numbers, and the units they are in.
    fn fill(&mut self, problem: &Problem, wrench: &[f64; WRENCH], shape: &Shape) -> Unit {
        let (n, h) = (problem.n_input(), problem.hessian());
        let unit = Unit { input: problem.scales(wrench).input, cost: h.diagonal().max() };
        self.p.clear();
        for j in 0..n {
            self.p.extend((0..=j).map(|i| h[(i, j)] / unit.cost));
        }
        self.q.resize(n, 0.0);
        problem.gradient(wrench, &vec![0.0; n], &mut self.q);
        self.q.iter_mut().for_each(|q| *q /= unit.cost * unit.input);
        self.a.fill(0.0);
        self.b.clear();
        let mut row = 0;
        for (inputs, bounds, sign) in [(&shape.lower, &problem.lower, -1.0), (&shape.upper, &problem.upper, 1.0)] {
            for i in inputs {
                self.add(row, *i, sign);
                self.b.push(sign * bounds[*i] / unit.input);
                row += 1;
            }
        }
        for affine in problem.cones.iter().flat_map(|c| c.rows()) {
            for (j, a) in &affine.terms {
                self.add(row, *j, -a);
            }
            self.b.push(affine.constant / unit.input);
            row += 1;
        }
        unit
    }

    fn add(&mut self, row: usize, input: usize, value: f64) {
        if let Some(place) = self.places.get(&(input, row)) {
            self.a[*place] += value;
        }
    }

    /// The pattern of A by columns; also finds the places.
    fn pattern(&mut self, shape: &Shape) -> (Vec<usize>, Vec<usize>) {
        let bounds = shape.lower.iter().chain(&shape.upper).map(|i| vec![*i]);
        let rows: Vec<Vec<usize>> = bounds.chain(shape.cones.iter().flatten().cloned()).collect();
        for (row, inputs) in rows.iter().enumerate() {
            for input in inputs {
                self.places.insert((*input, row), 0);
            }
        }
        let (mut starts, mut of_rows) = (vec![0; shape.n_input + 1], Vec::new());
        for (place, ((input, row), value)) in self.places.iter_mut().enumerate() {
            *value = place;
            of_rows.push(*row);
            starts[input + 1] += 1;
        }
        for j in 0..shape.n_input {
            starts[j + 1] += starts[j];
        }
        self.a = vec![0.0; of_rows.len()];
        (starts, of_rows)
    }
}

/// Of inputs, and of the diagonal of H.
#[derive(Debug, Clone, Copy)]
struct Unit {
    input: f64,
    cost: f64,
}

impl ConicSolver {
    /// Sets the structure up.
    ///
    /// # Errors
    /// [`Error::Value`] if the problem is not valid or clarabel refuses it.
    pub fn new(problem: &Problem) -> Result<Self> {
        problem.validate()?;
        let (shape, mut data) = (Shape::of(problem), Data::default());
        let (starts, of_rows) = data.pattern(&shape);
        let wrench = [0.0; WRENCH];
        data.fill(problem, &wrench, &shape);
        let n = shape.n_input;
        let triangle = (0..=n).map(|j| j * (j + 1) / 2).collect();
        let p = CscMatrix::new(n, n, triangle, (0..n).flat_map(|j| 0..=j).collect(), data.p.clone());
        let a = CscMatrix::new(data.b.len(), n, starts, of_rows, data.a.clone());
        let bounds = (shape.n_bound() > 0).then_some(SupportedConeT::NonnegativeConeT(shape.n_bound()));
        let mut cones: Vec<_> = bounds.into_iter().collect();
        cones.extend(shape.cones.iter().map(|rows| match rows.len() {
            1 => SupportedConeT::NonnegativeConeT(1),
            dim => SupportedConeT::SecondOrderConeT(dim),
        }));
        let settings = DefaultSettings {
            verbose: false,
            presolve_enable: false,
            max_iter: 60,
            tol_gap_abs: 1e-10,
            tol_gap_rel: 1e-10,
            tol_feas: 1e-9,
            ..DefaultSettings::default()
        };
        let refused =
            |why: String| Error::value("allocation: problem", why, "one that clarabel takes", "Check its numbers.");
        let solver =
            DefaultSolver::new(&p, &data.q, &a, &data.b, &cones, settings).map_err(|e| refused(e.to_string()))?;
        Ok(Self { solver, shape, data })
    }

    /// Solves for a wrench. The problem may have other numbers than the one it was set up with; where it has another
    /// structure (another set of finite bounds, other cones) it is set up again.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn solve(&mut self, problem: &Problem, wrench: &[f64; WRENCH]) -> Result<ConicSolution> {
        if Shape::of(problem) != self.shape {
            *self = Self::new(problem)?;
        }
        let unit = self.data.fill(problem, wrench, &self.shape);
        let data = &self.data;
        if let Err(why) = self.solver.update_data(&data.p, &data.q, &data.a, &data.b) {
            return Err(Error::value(
                "allocation: numbers",
                why,
                "an update of the same structure",
                "Set it up again.",
            ));
        }
        self.solver.solve();
        let solution = &self.solver.solution;
        let (z, mut row) = (&solution.z, self.shape.n_bound());
        let mut duals = Vec::with_capacity(problem.cones.len());
        for cone in &problem.cones {
            duals.push(z[row..row + cone.dim()].iter().map(|z| z * unit.cost * unit.input).collect());
            row += cone.dim();
        }
        Ok(ConicSolution {
            inputs: solution.x.iter().map(|x| x * unit.input).collect(),
            duals,
            iterations: solution.iterations,
            solved: matches!(solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved),
        })
    }
}
