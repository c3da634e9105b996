//! Hover: the attitude and the thrusts at which force and moment vanish.
//!
//! With F and M the forces and the moments about the centre of mass of unit thrusts, body axes, hover is R and T with
//!
//! ```text
//! R F T = m g e_z      M T = 0      10⁻⁴ T_max ≤ T ≤ T_max
//! ```
//!
//! (a motor that is commanded to stand idles at a hundredth of its speed).
//!
//! A vehicle hovers level where it can without stopping rotors. A crooked rotor, props that are pitched forward or a base frame that is
//! not level make it lean: R turns d = F T/‖F T‖ upright, without a heading.
//!
//! Of many solutions the first of these is taken whose reserve is at least half of the largest: level with least ‖T‖; level with
//! the largest reserve; leaning with least ‖T‖, which is the strongest direction of F on the null space of M; leaning as with the
//! largest reserve, with least ‖T‖; leaning with the largest reserve. The reserve is the share of its T_max that the tightest rotor keeps
//! to either limit; half of it steers about as well, and a stopped rotor does not steer.

use super::authority::characteristic_length;
use super::rotor::LEAST_THRUST;
use super::spatial::{Quat, from_euler, identity};
use super::vehicle::{GRAVITY, Inertia, Vehicle};
use base::error::{Error, Result};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, SupportedConeT, ZeroConeT,
};
use nalgebra::{DMatrix, DVector, Dyn, SVD, Vector3};

/// What may be left of force and moment, as a share of the weight (moments over the rotors' lever): 1e-8 m/s², which a trim
/// counts as steady.
pub const BALANCED: f64 = 1e-9;
/// Directions of the rotors below this share of the strongest are rounding.
const RANK: f64 = 1e-9;
/// How far beyond a limit a linear program's answer may lie, as a share of T_max: its own accuracy.
const SLACK: f64 = 1e-9;
/// Share of the largest reserve that will do.
const ENOUGH: f64 = 0.5;
/// Most turns of the direction of the thrust: each takes the lean's square off what is left.
const TURNS: usize = 30;

/// Most steps of a decomposition; matrices of sixteen columns take a few dozen.
const MOST_STEPS: usize = 10_000;

/// A hover of a vehicle: an attitude and thrusts at which force and moment vanish.
#[derive(Debug, Clone, PartialEq)]
pub struct HoverTrim {
    /// Body → world, `[w, x, y, z]`, at yaw 0; exactly the identity where the vehicle hovers level.
    pub attitude: Quat<f64>,
    /// Thrust of each rotor, N, `[n_rotor]`.
    pub thrusts: Vec<f64>,
    /// Least share of its largest thrust that a rotor keeps to either limit, 0 to ½.
    pub reserve: f64,
    /// Number of the rotor that keeps it.
    pub tightest: usize,
    /// Σ T n over the weight, body axes: what points up.
    pub up: [f64; 3],
}

impl HoverTrim {
    /// Whether body z points up.
    pub fn is_level(&self) -> bool {
        self.attitude == identity::<f64>()
    }

    /// Angle between body z and the vertical, rad.
    pub fn lean(&self) -> f64 {
        if self.is_level() { 0.0 } else { self.up[0].hypot(self.up[1]).atan2(self.up[2]) }
    }
}

impl Vehicle {
    /// The hover of a vehicle: R and T with R F T = m g e_z, M T = 0 and 10⁻⁴ T_max ≤ T ≤ T_max, where F and M are the forces and the
    /// moments about the centre of mass of unit thrusts, body axes.
    ///
    /// Of many solutions the first of these is taken whose [reserve](HoverTrim::reserve) is at least half of the largest: level with
    /// least ‖T‖; level with the largest reserve; leaning with least ‖T‖; leaning as with the largest reserve, with least ‖T‖; leaning
    /// with the largest reserve.
    ///
    /// # Errors
    /// [`Error::Value`] if there is none: with the axes that its rotors do not turn apart, else with the row that cannot be met, and
    /// by how much.
    pub fn hover(&self) -> Result<HoverTrim> {
        if self.rotors.is_empty() {
            let what = format!("vehicle '{}': number of rotors", self.name);
            return Err(Error::value(what, 0, "≥ 1 to hover", "List the rotors under [[rotors]]."));
        }
        let balance = Balance::of(self);
        let least = balance.level_least();
        // nothing keeps more than a half
        if let Some(hover) = least.as_ref().filter(|hover| hover.reserve >= ENOUGH * 0.5) {
            return Ok(hover.clone());
        }
        let leaning = balance.leaning_least();
        let start = leaning.as_ref().map_or_else(|| balance.strongest(), |(up, _)| *up);
        let best = balance.leaning_best(start);
        // the same vehicle described in the axes of that hover has least thrusts of its own
        let along = best.as_ref().and_then(|best| balance.least_along(&best.up.into()));
        let found = [least, balance.level_best(), leaning.and_then(|(_, hover)| hover), along, best];
        let most = found.iter().flatten().map(|hover| hover.reserve).fold(f64::NEG_INFINITY, f64::max);
        match found.into_iter().flatten().find(|hover| hover.reserve >= ENOUGH * most) {
            Some(hover) => Ok(hover),
            None => {
                self.check_own_axes()?;
                Err(balance.missing(self, start))
            }
        }
    }

    /// The largest lift without a moment, as a multiple of the weight: of all thrusts within their limits that push where those of hover
    /// do. It is [`thrust_to_weight`](Self::thrust_to_weight) where all rotors push up and reach their limit together, less else.
    ///
    /// # Errors
    /// As [`hover`](Self::hover).
    pub fn balanced_lift(&self) -> Result<f64> {
        let hover = self.hover()?;
        let balance = Balance::of(self);
        // what carries the weight is scaled to the limit where no program finds more
        let fullest = hover.thrusts.iter().zip(&balance.most).map(|(t, most)| t / most).fold(0.0, f64::max);
        Ok(balance.most_lift(&hover.up.into()).unwrap_or(0.0).max(1.0 / fullest))
    }

    /// The same vehicle described in the axes in which it hovers level: itself where it does, or where it does not hover.
    pub fn upright(&self) -> Self {
        match self.hover() {
            Ok(hover) if !hover.is_level() => self.turned(hover.attitude),
            _ => self.clone(),
        }
    }

    /// The same vehicle described in other axes through its base origin; `turn` takes what was written in the old ones to the new.
    /// Drag of the airframe stays per axis: of the turned matrix its diagonal.
    pub fn turned(&self, turn: Quat<f64>) -> Self {
        let [w, x, y, z] = turn;
        let r = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        let matrix = *r.to_rotation_matrix().matrix();
        let point = |v: &mut [f64; 3]| *v = (matrix * Vector3::from(*v)).into();
        let squared = matrix.component_mul(&matrix);
        let per_axis = |v: &mut [f64; 3]| *v = (squared * Vector3::from(*v)).into();
        let mut vehicle = self.clone();
        for part in &mut vehicle.parts {
            point(&mut part.position);
            part.inertia = Inertia::from_matrix(&(matrix * part.inertia.matrix() * matrix.transpose()));
        }
        for rotor in &mut vehicle.rotors {
            point(&mut rotor.position);
            point(&mut rotor.axis);
        }
        let drag = &mut vehicle.drag;
        [&mut drag.linear, &mut drag.quadratic, &mut drag.angular].into_iter().for_each(per_axis);
        for shape in &mut vehicle.shapes {
            point(&mut shape.position);
            shape.rotation = super::spatial::multiply(turn, shape.rotation);
        }
        vehicle
    }
}

/// Force and moment of a vehicle's rotors against its weight.
struct Balance {
    /// 6 × n, N and N m per newton.
    matrix: DMatrix<f64>,
    /// N.
    weight: f64,
    /// Lever of the rotors, m.
    length: f64,
    /// T_max, N.
    most: DVector<f64>,
}

impl Balance {
    fn of(vehicle: &Vehicle) -> Self {
        let matrix = vehicle.allocation_matrix();
        Self {
            weight: vehicle.mass_properties().mass * GRAVITY,
            length: characteristic_length(&matrix),
            most: DVector::from_iterator(matrix.ncols(), vehicle.rotors.iter().map(|r| r.max_thrust())),
            matrix,
        }
    }

    fn n(&self) -> usize {
        self.matrix.ncols()
    }

    fn force(&self, thrusts: &DVector<f64>) -> Vector3<f64> {
        (self.matrix.rows(0, 3) * thrusts).fixed_rows::<3>(0).into_owned()
    }

    fn moments(&self) -> DMatrix<f64> {
        self.matrix.rows(3, 3).into_owned()
    }

    /// The hover of thrusts within their limits; `None` for others.
    fn within(&self, mut thrusts: DVector<f64>, level: bool) -> Option<HoverTrim> {
        let shares = thrusts.component_div(&self.most);
        if shares.is_empty() || !shares.iter().all(|share| (LEAST_THRUST - SLACK..=1.0 + SLACK).contains(share)) {
            return None;
        }
        let room = shares.map(|share| share.min(1.0 - share));
        let tightest = room.imin();
        thrusts.iter_mut().zip(&self.most).for_each(|(t, most)| *t = t.clamp(LEAST_THRUST * most, *most));
        let up = self.force(&thrusts) / self.weight;
        // Rᵀ e_z of roll and pitch at yaw 0
        let [x, y, z] = (up / up.norm()).into();
        let attitude = if level { identity() } else { from_euler(y.atan2(z), -x.clamp(-1.0, 1.0).asin(), 0.0) };
        let thrusts = thrusts.iter().copied().collect();
        Some(HoverTrim { attitude, thrusts, reserve: room[tightest].max(0.0), tightest, up: up.into() })
    }

    fn level_wrench(&self) -> DVector<f64> {
        DVector::from_vec(vec![0.0, 0.0, self.weight, 0.0, 0.0, 0.0])
    }

    /// Whether force and moment are those of level hover.
    fn is_level(&self, thrusts: &DVector<f64>) -> bool {
        let mut left = &self.matrix * thrusts - self.level_wrench();
        left.rows_mut(3, 3).unscale_mut(self.length);
        left.norm() <= BALANCED * self.weight
    }

    /// The least-norm solution of B T = (0, 0, m g, 0, 0, 0). Rows of upright rotors' horizontal forces are zero and drop out; tilted
    /// rotors balance theirs.
    fn level_least(&self) -> Option<HoverTrim> {
        let svd = decomposed(self.matrix.clone())?;
        let thrusts = svd.solve(&self.level_wrench(), RANK * svd.singular_values.max()).ok()?;
        if self.is_level(&thrusts) { self.within(thrusts, true) } else { None }
    }

    fn level_best(&self) -> Option<HoverTrim> {
        let scale = DVector::from_fn(6, |row, _| self.weight * if row < 3 { 1.0 } else { self.length });
        let rows = DMatrix::from_fn(6, self.n(), |i, j| self.matrix[(i, j)] / scale[i]);
        let thrusts = self.roomiest(&rows, &self.level_wrench().component_div(&scale))?;
        // an interior point meets the rows to a part in 10⁸: the rest by the least change
        let svd = decomposed(self.matrix.clone())?;
        let left = self.level_wrench() - &self.matrix * &thrusts;
        let thrusts = thrusts + svd.solve(&left, RANK * svd.singular_values.max()).ok()?;
        if self.is_level(&thrusts) { self.within(thrusts, true) } else { None }
    }

    /// Of all thrusts without moment, those of least norm that carry the weight, and what they push along; and their hover where they are
    /// within the limits.
    fn leaning_least(&self) -> Option<(Vector3<f64>, Option<HoverTrim>)> {
        let (forces, free) = (self.matrix.rows(0, 3), null_space(&self.moments()));
        if free.ncols() == 0 {
            return None;
        }
        let svd = decomposed(forces * &free)?;
        let strongest = svd.singular_values.imax();
        let most = svd.singular_values[strongest];
        if most <= RANK {
            return None;
        }
        let thrusts = &free * svd.v_t?.row(strongest).transpose() * (self.weight / most);
        let sign = if thrusts.component_div(&self.most).sum() < 0.0 { -1.0 } else { 1.0 };
        let thrusts = thrusts * sign;
        Some((self.force(&thrusts) / self.weight, self.within(thrusts, false)))
    }

    /// What all rotors together push along.
    fn strongest(&self) -> Vector3<f64> {
        self.force(&self.most).try_normalize(f64::MIN_POSITIVE).unwrap_or(Vector3::z())
    }

    /// The least-norm solution of F T = m g `up`, M T = 0.
    fn least_along(&self, up: &Vector3<f64>) -> Option<HoverTrim> {
        let mut wrench = DVector::zeros(6);
        wrench.rows_mut(0, 3).copy_from(&(up.normalize() * self.weight));
        let svd = decomposed(self.matrix.clone())?;
        let thrusts = svd.solve(&wrench, RANK * svd.singular_values.max()).ok()?;
        let mut left = &self.matrix * &thrusts - wrench;
        left.rows_mut(3, 3).unscale_mut(self.length);
        if left.norm() <= BALANCED * self.weight { self.within(thrusts, false) } else { None }
    }

    /// Thrusts without moment and with the largest reserve: each linear program has the direction of the thrust from the one before.
    fn leaning_best(&self, mut up: Vector3<f64>) -> Option<HoverTrim> {
        let free = null_space(&self.moments());
        let mut best = None;
        for _ in 0..TURNS {
            let (rows, right) = self.along(&up);
            let thrusts = self.roomiest(&rows, &right)?;
            let thrusts = &free * free.tr_mul(&thrusts);
            let force = self.force(&thrusts);
            let thrusts = thrusts * (self.weight / force.norm());
            let turned = (force.normalize() - up).norm();
            up = force.normalize();
            best = self.within(thrusts, false);
            if turned <= BALANCED {
                break;
            }
        }
        best
    }

    /// Rows of lift along `up` and of the moments, over weight and lever, and what they are at hover.
    fn along(&self, up: &Vector3<f64>) -> (DMatrix<f64>, DVector<f64>) {
        let mut rows = DMatrix::zeros(4, self.n());
        rows.row_mut(0).copy_from(&((up.transpose() * self.matrix.fixed_rows::<3>(0)) / self.weight));
        rows.rows_mut(1, 3).copy_from(&(self.moments() / (self.weight * self.length)));
        (rows, DVector::from_vec(vec![1.0, 0.0, 0.0, 0.0]))
    }

    /// Thrusts T with `rows` T = `right` and the largest t for which t T_max ≤ T ≤ (1 − t) T_max; t < 0 is beyond the limits.
    fn roomiest(&self, rows: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
        let (n, m) = (self.n(), rows.nrows());
        // unknowns: shares of T_max, then t
        let mut a = DMatrix::zeros(m + 2 * n, n + 1);
        let mut b = DVector::zeros(m + 2 * n);
        for i in 0..n {
            (0..m).for_each(|k| a[(k, i)] = rows[(k, i)] * self.most[i]);
            (a[(m + i, i)], a[(m + i, n)]) = (-1.0, 1.0);
            (a[(m + n + i, i)], a[(m + n + i, n)], b[m + n + i]) = (1.0, 1.0, 1.0);
        }
        b.rows_mut(0, m).copy_from(right);
        let mut cost = vec![0.0; n + 1];
        cost[n] = -1.0;
        let shares = solved(&DMatrix::zeros(n + 1, n + 1), &cost, &a, &b, m)?;
        Some(DVector::from_fn(n, |i, _| shares[i] * self.most[i]))
    }

    /// The largest λ with F T = λ m g `up` and M T = 0 within the limits.
    fn most_lift(&self, up: &Vector3<f64>) -> Option<f64> {
        let n = self.n();
        let scale = DVector::from_fn(6, |row, _| self.weight * if row < 3 { 1.0 } else { self.length });
        let mut a = DMatrix::zeros(6 + 2 * n, n + 1);
        (0..n).for_each(|i| (0..6).for_each(|k| a[(k, i)] = self.matrix[(k, i)] * self.most[i] / scale[k]));
        (0..3).for_each(|k| a[(k, n)] = -up[k]);
        let mut b = DVector::zeros(6 + 2 * n);
        self.limit(&mut a, &mut b, 6);
        let mut cost = vec![0.0; n + 1];
        cost[n] = -1.0;
        solved(&DMatrix::zeros(n + 1, n + 1), &cost, &a, &b, 6).map(|x| x[n])
    }

    /// Rows from `first` on that keep shares of T_max, the first columns, within their limits.
    fn limit(&self, a: &mut DMatrix<f64>, b: &mut DVector<f64>, first: usize) {
        let n = self.n();
        for i in 0..n {
            let (low, high) = (first + i, first + n + i);
            (a[(low, i)], b[low], a[(high, i)], b[high]) = (-1.0, -LEAST_THRUST, 1.0, 1.0);
        }
    }

    /// The row that cannot be met within the limits: lift, or with the lift the moment of which most is left where the least
    /// ‖moment‖ is.
    fn missing(&self, vehicle: &Vehicle, up: Vector3<f64>) -> Error {
        let what = format!("vehicle '{}': hover", vehicle.name);
        let rule = "a balance of weight and moments within the rotors' limits";
        let lift = self.force(&self.most).dot(&up.normalize());
        if lift < self.weight {
            let value = format!("short of lift: {lift:.3} N at most for a weight of {:.3} N", self.weight);
            return Error::value(
                what,
                value,
                rule,
                "Take mass off, or give it stronger rotors: max_speed or thrust_coefficient.",
            );
        }
        let idle = LEAST_THRUST * lift;
        if idle > self.weight {
            let value = format!("too light: rotors at idle lift {idle:.3e} N of a weight of {:.3e} N", self.weight);
            return Error::value(what, value, rule, "Check the units of the mass and of thrust_coefficient.");
        }
        let n = self.n();
        let (rows, right) = self.along(&up.normalize());
        let scaled = DMatrix::from_fn(4, n, |k, i| rows[(k, i)] * self.most[i]);
        let mut a = DMatrix::zeros(1 + 2 * n, n);
        let mut b = DVector::zeros(1 + 2 * n);
        a.row_mut(0).copy_from(&scaled.row(0));
        b[0] = right[0];
        self.limit(&mut a, &mut b, 1);
        let cost = scaled.rows(1, 3).tr_mul(&scaled.rows(1, 3));
        let left = solved(&cost, &vec![0.0; n], &a, &b, 1)
            .map(|shares| scaled.rows(1, 3) * DVector::from_vec(shares) * (self.weight * self.length));
        let Some(left) = left else {
            return Error::value(
                what,
                "without a solution",
                rule,
                "Check rotor positions, spins, thrust coefficients and the mass.",
            );
        };
        let row = left.iamax();
        let c = vehicle.mass_properties().center_of_mass;
        let remedy = if row == 2 {
            "Let rotors that spin one way balance those that spin the other: spin, moment_per_thrust, thrust_coefficient, max_speed, axis.".into()
        } else {
            format!("Move the centre of mass, now at ({:.3}, {:.3}, {:.3}) m, between the rotors.", c.x, c.y, c.z)
        };
        let value = format!("off balance: at least {:.3e} N m of {} moment are left", left[row].abs(), MOMENTS[row]);
        Error::value(what, value, rule, remedy)
    }
}

/// Moments about body x, y, z.
const MOMENTS: [&str; 3] = ["roll", "pitch", "yaw"];

/// Singular values with their vectors; `None` where they are not found in a bounded number of steps.
fn decomposed(matrix: DMatrix<f64>) -> Option<SVD<f64, Dyn, Dyn>> {
    matrix.try_svd(true, true, 5.0 * f64::EPSILON, MOST_STEPS)
}

/// An orthonormal basis of all x with A x = 0.
fn null_space(a: &DMatrix<f64>) -> DMatrix<f64> {
    let n = a.ncols();
    // a square matrix has all right vectors in its decomposition
    let mut square = DMatrix::zeros(n.max(a.nrows()), n);
    square.rows_mut(0, a.nrows()).copy_from(a);
    let Some(svd) = decomposed(square) else { return DMatrix::zeros(n, 0) };
    let floor = RANK * svd.singular_values.max();
    let Some(right) = svd.v_t else { return DMatrix::zeros(n, 0) };
    let free: Vec<_> = (0..n).filter(|k| svd.singular_values[*k] <= floor).map(|k| right.row(k).transpose()).collect();
    if free.is_empty() { DMatrix::zeros(n, 0) } else { DMatrix::from_columns(&free) }
}

/// argmin ½ xᵀPx + qᵀx over rows of A x = b, `equal` of them, then A x ≤ b.
fn solved(p: &DMatrix<f64>, q: &[f64], a: &DMatrix<f64>, b: &DVector<f64>, equal: usize) -> Option<Vec<f64>> {
    let cones: [SupportedConeT<f64>; 2] = [ZeroConeT(equal), NonnegativeConeT(a.nrows() - equal)];
    let settings = DefaultSettings { verbose: false, ..DefaultSettings::default() };
    let mut solver =
        DefaultSolver::new(&compressed(&p.upper_triangle()), q, &compressed(a), b.as_slice(), &cones, settings).ok()?;
    solver.solve();
    let solved = matches!(solver.solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
    (solved && solver.solution.x.iter().all(|x| x.is_finite())).then(|| solver.solution.x.clone())
}

/// The entries of a matrix that are not zero, by columns.
fn compressed(matrix: &DMatrix<f64>) -> CscMatrix<f64> {
    let (mut starts, mut rows, mut values) = (vec![0], Vec::new(), Vec::new());
    for column in matrix.column_iter() {
        for (row, value) in column.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            rows.push(row);
            values.push(*value);
        }
        starts.push(rows.len());
    }
    CscMatrix::new(matrix.nrows(), matrix.ncols(), starts, rows, values)
}
