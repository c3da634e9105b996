use super::super::stage_qp::SoftBound;
use super::*;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use nalgebra::DVector;
use rng::{Purpose, Stream};

/// A program with its numbers in the open, for the witness.
struct Open {
    a: Vec<DMatrix<f64>>,
    b: Vec<DMatrix<f64>>,
    c: Vec<DVector<f64>>,
    /// [Q S; Sᵀ R] as factors Fᵀ F over [x; u].
    h: Vec<DMatrix<f64>>,
    slopes: Vec<DVector<f64>>,
    lower: Vec<Vec<f64>>,
    upper: Vec<Vec<f64>>,
    soft: Vec<Vec<SoftBound>>,
    start: Vec<f64>,
}

fn matrix(draw: &mut Stream, rows: usize, columns: usize, size: f64) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| size * draw.normal())
}

impl Open {
    /// Bounds of all kinds: wide, tight, one-sided, none, of a single value.
    fn drawn(draw: &mut Stream, most: [usize; 3]) -> Self {
        let [n, m, stages] = most.map(|most| 1 + draw.below(most as u64) as usize);
        let unstable = draw.uniform(0.5, 1.2);
        let of_stages = |draw: &mut Stream, f: &mut dyn FnMut(&mut Stream) -> DMatrix<f64>| -> Vec<_> {
            (0..stages).map(|_| f(draw)).collect()
        };
        let a = of_stages(draw, &mut |d| {
            DMatrix::identity(n, n) * 0.5 * unstable + matrix(d, n, n, 0.5 * unstable / (n as f64).sqrt())
        });
        let b = of_stages(draw, &mut |d| matrix(d, n, m, 1.0));
        let c = (0..stages).map(|_| DVector::from_fn(n, |_, _| 0.1 * draw.normal())).collect();
        let rank = 1 + draw.below((n + m) as u64) as usize;
        let h = (0..=stages)
            .map(|_| {
                let factor = matrix(draw, rank, n + m, 1.0);
                let mut h = factor.tr_mul(&factor);
                (n..n + m).for_each(|i| h[(i, i)] += 0.1);
                h
            })
            .collect();
        let slopes = (0..=stages).map(|_| DVector::from_fn(n + m, |_, _| 3.0 * draw.normal())).collect();
        let (mut lower, mut upper) = (Vec::new(), Vec::new());
        for _ in 0..stages {
            let row: Vec<[f64; 2]> = (0..m)
                .map(|_| {
                    let (middle, half) = (draw.normal(), draw.uniform(0.0, 2.0));
                    match draw.below(6) {
                        0 => [f64::NEG_INFINITY, f64::INFINITY],
                        1 => [middle, f64::INFINITY],
                        2 => [f64::NEG_INFINITY, middle],
                        3 => [middle, middle],
                        _ => [middle - half, middle + half],
                    }
                })
                .collect();
            lower.push(row.iter().map(|b| b[0]).collect());
            upper.push(row.iter().map(|b| b[1]).collect());
        }
        let is_soft = draw.below(2) == 0;
        let soft = (0..stages)
            .map(|_| {
                (0..n)
                    .filter(|_| is_soft)
                    .map(|state| {
                        let lower = draw.uniform(-1.0, 0.0);
                        let upper = if draw.below(3) == 0 { f64::INFINITY } else { draw.uniform(0.0, 1.0) };
                        SoftBound { state, lower, upper, weight: draw.uniform(0.0, 100.0) }
                    })
                    .collect()
            })
            .collect();
        let start = (0..n).map(|_| 2.0 * draw.normal()).collect();
        Self { a, b, c, h, slopes, lower, upper, soft, start }
    }

    fn sizes(&self) -> [usize; 3] {
        [self.a[0].nrows(), self.b[0].ncols(), self.a.len()]
    }

    fn program(&self) -> StageQp {
        let [n, m, stages] = self.sizes();
        let mut qp = StageQp::new(n, m, stages).unwrap();
        for k in 0..stages {
            qp.set_dynamics(k, &self.a[k], &self.b[k], &self.c[k]).unwrap();
            let h = &self.h[k];
            let [q, s, r] = [((0, 0), (n, n)), ((n, 0), (m, n)), ((n, n), (m, m))]
                .map(|(from, size)| h.view(from, size).into_owned());
            let slope = &self.slopes[k];
            let [of_x, of_u] = [slope.rows(0, n).into_owned(), slope.rows(n, m).into_owned()];
            qp.set_cost(k, [&q, &s, &r], [&of_x, &of_u]).unwrap();
            qp.set_bounds(k, &self.lower[k], &self.upper[k]).unwrap();
            qp.set_soft_bounds(k, &self.soft[k]).unwrap();
        }
        let (h, slope) = (&self.h[stages], &self.slopes[stages]);
        qp.set_terminal(&h.view((0, 0), (n, n)).into_owned(), &slope.rows(0, n).into_owned()).unwrap();
        qp
    }

    /// The cost of inputs, and the slope by each of them: written anew, one number at a time.
    fn cost(&self, inputs: &[f64]) -> (f64, Vec<f64>) {
        let [n, m, stages] = self.sizes();
        let mut x = vec![DVector::from_column_slice(&self.start)];
        for k in 0..stages {
            let u = DVector::from_column_slice(&inputs[k * m..(k + 1) * m]);
            x.push(&self.a[k] * &x[k] + &self.b[k] * u + &self.c[k]);
        }
        let (mut cost, mut slope, mut costate) = (0.0, vec![0.0; stages * m], DVector::zeros(n));
        for k in (0..=stages).rev() {
            let size = if k < stages { n + m } else { n };
            let z = DVector::from_fn(size, |i, _| if i < n { x[k][i] } else { inputs[k * m + i - n] });
            let h = self.h[k].view((0, 0), (size, size));
            let mut w = h * &z + self.slopes[k].rows(0, size);
            cost += 0.5 * z.dot(&(h * &z)) + z.dot(&self.slopes[k].rows(0, size));
            if k > 0 {
                for bound in &self.soft[k - 1] {
                    let x = x[k][bound.state];
                    let beyond = if x > bound.upper { x - bound.upper } else { (x - bound.lower).min(0.0) };
                    cost += 0.5 * bound.weight * beyond * beyond;
                    w[bound.state] += bound.weight * beyond;
                }
            }
            if k < stages {
                let own = w.rows(n, m) + self.b[k].tr_mul(&costate);
                slope[k * m..(k + 1) * m].copy_from_slice(own.as_slice());
                costate = w.rows(0, n) + self.a[k].tr_mul(&costate);
            } else {
                costate = w;
            }
        }
        (cost, slope)
    }

    /// The cost that clarabel finds, over inputs, states and what is beyond soft bounds.
    fn witness(&self) -> Option<f64> {
        let [n, m, stages] = self.sizes();
        let soft: Vec<(usize, SoftBound)> =
            self.soft.iter().enumerate().flat_map(|(k, all)| all.iter().map(move |b| (k + 1, *b))).collect();
        let of_x = |k: usize, i: usize| k * (n + m) + i;
        let of_u = |k: usize, i: usize| k * (n + m) + n + i;
        let n_z = stages * (n + m) + n;
        let n_all = n_z + soft.len();
        let mut p = DMatrix::zeros(n_all, n_all);
        let mut q = vec![0.0; n_all];
        for k in 0..=stages {
            let size = if k < stages { n + m } else { n };
            p.view_mut((of_x(k, 0), of_x(k, 0)), (size, size)).copy_from(&self.h[k].view((0, 0), (size, size)));
            q[of_x(k, 0)..of_x(k, 0) + size].copy_from_slice(&self.slopes[k].as_slice()[..size]);
        }
        let (mut rows, mut right) = (Vec::new(), Vec::new());
        let mut push = |terms: &[(usize, f64)], b: f64| {
            let mut row = vec![0.0; n_all];
            terms.iter().for_each(|(at, value)| row[*at] += value);
            rows.push(row);
            right.push(b);
        };
        for i in 0..n {
            push(&[(of_x(0, i), 1.0)], self.start[i]);
        }
        for k in 0..stages {
            for i in 0..n {
                let mut terms = vec![(of_x(k + 1, i), -1.0)];
                terms.extend((0..n).map(|j| (of_x(k, j), self.a[k][(i, j)])));
                terms.extend((0..m).map(|j| (of_u(k, j), self.b[k][(i, j)])));
                push(&terms, -self.c[k][i]);
            }
        }
        let n_equal = n * (stages + 1);
        for k in 0..stages {
            for i in 0..m {
                if self.upper[k][i].is_finite() {
                    push(&[(of_u(k, i), 1.0)], self.upper[k][i]);
                }
                if self.lower[k][i].is_finite() {
                    push(&[(of_u(k, i), -1.0)], -self.lower[k][i]);
                }
            }
        }
        for (s, (k, bound)) in soft.iter().enumerate() {
            p[(n_z + s, n_z + s)] = bound.weight.max(1e-9);
            if bound.upper.is_finite() {
                push(&[(of_x(*k, bound.state), 1.0), (n_z + s, -1.0)], bound.upper);
            }
            push(&[(of_x(*k, bound.state), -1.0), (n_z + s, -1.0)], -bound.lower);
        }
        let n_row = rows.len();
        let a = DMatrix::from_fn(n_row, n_all, |i, j| rows[i][j]);
        let sparse = |dense: &DMatrix<f64>| {
            let columns: Vec<Vec<(usize, f64)>> = (0..dense.ncols())
                .map(|j| (0..dense.nrows()).map(|i| (i, dense[(i, j)])).filter(|e| e.1 != 0.0).collect())
                .collect();
            let mut starts = vec![0];
            columns.iter().for_each(|c| starts.push(starts[starts.len() - 1] + c.len()));
            let flat = || columns.iter().flatten();
            CscMatrix::new(
                dense.nrows(),
                dense.ncols(),
                starts,
                flat().map(|e| e.0).collect(),
                flat().map(|e| e.1).collect(),
            )
        };
        let cones = [SupportedConeT::ZeroConeT(n_equal), SupportedConeT::NonnegativeConeT(n_row - n_equal)];
        let settings = DefaultSettings { verbose: false, ..DefaultSettings::default() };
        let upper = DMatrix::from_fn(n_all, n_all, |i, j| if i <= j { p[(i, j)] } else { 0.0 });
        let mut solver = DefaultSolver::new(&sparse(&upper), &q, &sparse(&a), &right, &cones, settings).unwrap();
        solver.solve();
        (solver.solution.status == SolverStatus::Solved).then_some(solver.solution.obj_val)
    }
}

fn inputs_of(solver: &QpSolver) -> Vec<f64> {
    (0..solver.sizes.stages).flat_map(|k| solver.input(k).to_vec()).collect()
}

/// Largest distance of inputs from a projected step along the slope, the slope found anew.
fn distance(open: &Open, inputs: &[f64], slope: &[f64]) -> f64 {
    let bounds = open.lower.iter().flatten().zip(open.upper.iter().flatten());
    let moved = inputs.iter().zip(slope).zip(bounds).map(|((u, g), (lower, upper))| {
        assert!(u >= lower && u <= upper, "{u} within [{lower}, {upper}]");
        u - (u - g).clamp(*lower, *upper)
    });
    moved.fold(0.0, |worst: f64, d| worst.max(d.abs()))
}

#[test]
fn random_programs_are_solved_to_rounding_within_their_bounds() {
    let mut draw = Stream::new(1, 0, 0, Purpose::TASK);
    let (mut worst, mut most, mut total) = (0.0_f64, 0, 0);
    for _ in 0..1000 {
        let open = Open::drawn(&mut draw, [12, 5, 20]);
        let qp = open.program();
        let mut solver = QpSolver::new(&qp);
        let report = solver.solve(&qp, &open.start, &QpSettings::default());
        assert_eq!(report.status, QpStatus::Solved, "{report:?} of {:?}", open.sizes());
        let inputs = inputs_of(&solver);
        let (cost, slope) = open.cost(&inputs);
        assert!((cost - solver.cost(&qp)).abs() <= 1e-9 * (1.0 + cost.abs()), "{cost}, {}", solver.cost(&qp));
        let size = slope.iter().fold(1.0_f64, |size, g| size.max(g.abs()));
        worst = worst.max(distance(&open, &inputs, &slope) / size);
        most = most.max(report.iterations);
        total += report.iterations;
    }
    println!("worst residual {worst:.1e}, {most} iterations at most, {} on average", total as f64 / 1000.0);
    assert!(worst <= 1e-7, "{worst}");
}

#[test]
fn multipliers_are_slopes_of_the_cost_by_inputs_with_what_follows_from_them() {
    let mut draw = Stream::new(3, 0, 0, Purpose::TASK);
    for _ in 0..100 {
        let open = Open::drawn(&mut draw, [8, 4, 12]);
        let qp = open.program();
        let mut solver = QpSolver::new(&qp);
        solver.solve(&qp, &open.start, &QpSettings::default());
        let (_, slope) = open.cost(&inputs_of(&solver));
        let size = slope.iter().fold(1.0_f64, |size, g| size.max(g.abs()));
        let own: Vec<f64> = (0..qp.n_stage()).flat_map(|k| solver.multiplier(k).to_vec()).collect();
        let worst = own.iter().zip(&slope).map(|(own, g)| (own - g).abs()).fold(0.0, f64::max);
        assert!(worst <= 1e-7 * size, "{worst} of {size}, {:?}", open.sizes());
    }
}

#[test]
fn costs_are_those_of_clarabel() {
    let mut draw = Stream::new(2, 0, 0, Purpose::TASK);
    let mut n_solved = 0;
    for _ in 0..60 {
        let open = Open::drawn(&mut draw, [6, 3, 10]);
        let qp = open.program();
        let mut solver = QpSolver::new(&qp);
        assert_eq!(solver.solve(&qp, &open.start, &QpSettings::default()).status, QpStatus::Solved);
        let Some(wanted) = open.witness() else { continue };
        n_solved += 1;
        let own = solver.cost(&qp);
        assert!((own - wanted).abs() <= 1e-6 * (1.0 + wanted.abs()), "{own}, {wanted}");
    }
    assert!(n_solved > 50, "{n_solved}");
}
