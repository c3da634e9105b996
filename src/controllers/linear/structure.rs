//! What inputs do not move and outputs do not show, by rank.
//!
//! The staircase: the directions of B, then those that A makes of them and that are new, and so on, each set by singular values.
//! It ends with all that inputs reach. What stands upright on that moves on its own, whatever feedback does. Eigenvalues are not
//! asked: of one that comes several times rounding makes several, and none of them says how many directions are out of reach.
//! States and inputs are brought to comparable sizes before, so that units do not matter. Of outputs the same holds for Aᵀ and Cᵀ.
//!
//! Source: Rosenbrock 1970; Paige 1981 for the ranks.

pub use super::dense::ON_CIRCLE;
use super::dense::{ROUNDED, eigenvalues, svd};
use super::state_space::{Signal, StateSpace, beside};
use base::error::Result;
use nalgebra::{Complex, DMatrix};

/// A coupling below this share of the others counts as none. A feedback through it would need gains a billion times those of the
/// rest, and rounding of a linearised model (1e-15 of its numbers) lies far below.
pub const NO_COUPLING: f64 = 1e-9;

/// How far rounding moves poles off the unit circle that come from `n` integrators in a row: rate, angle, velocity, place are four.
pub(crate) fn rounding(n: usize) -> f64 {
    1e-12_f64.powf(1.0 / n.clamp(1, 4) as f64).max(ON_CIRCLE)
}

/// What inputs do not move, or outputs do not show.
#[derive(Debug, Clone, PartialEq)]
pub struct HiddenModes {
    /// Dimension of the rest: what inputs reach, or outputs show.
    pub reached: usize,
    /// Poles of what is hidden, largest modulus first.
    pub poles: Vec<Complex<f64>>,
    /// Combinations of states that are hidden, each of as few states as there can be: their numbers and factors, the first 1.
    pub directions: Vec<Vec<(usize, f64)>>,
}

impl HiddenModes {
    /// Each combination by the names of states, as `attitude_y − 0.43 attitude_z`.
    pub fn names(&self, states: &[Signal]) -> Vec<String> {
        self.directions.iter().map(|direction| named(direction, states)).collect()
    }
}

fn named(direction: &[(usize, f64)], states: &[Signal]) -> String {
    let mut text = String::new();
    for (k, (i, factor)) in direction.iter().enumerate() {
        let sign = match (k, *factor < 0.0) {
            (0, false) => "",
            (0, true) => "−",
            (_, false) => " + ",
            (_, true) => " − ",
        };
        let size = factor.abs();
        let size = match size {
            s if (s - 1.0).abs() < 5e-4 => String::new(),
            s if (1e-2..1e3).contains(&s) => format!("{} ", (s * 1e3).round() / 1e3),
            s => format!("{s:.2e} "),
        };
        text += &format!("{sign}{size}{}", states[*i].name);
    }
    text
}

/// What no input moves.
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) where singular values or eigenvalues are not found.
pub fn unreachable(system: &StateSpace) -> Result<HiddenModes> {
    Staircase::of(system.a(), system.b())?.hidden()
}

/// What no output shows.
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) where singular values or eigenvalues are not found.
pub fn unobservable(system: &StateSpace) -> Result<HiddenModes> {
    Staircase::of(&system.a().transpose(), &system.c().transpose())?.hidden()
}

/// A and B in coordinates of comparable sizes, and what is reached there.
pub(crate) struct Staircase {
    a: DMatrix<f64>,
    /// State i is this times its number in these coordinates.
    scale: Vec<f64>,
    /// Orthonormal: what is reached, and what stands upright on it.
    reached: DMatrix<f64>,
    rest: DMatrix<f64>,
}

impl Staircase {
    /// Of several ways to find comparable sizes that with which most is reached: a weak link, as a lean of 1e-10 rad makes it, can spoil
    /// the sizes of all, and so can a strong one that odd units hide. Bad sizes hide directions and invent none.
    pub fn of(a: &DMatrix<f64>, b: &DMatrix<f64>) -> Result<Self> {
        let mut best = Self::with_links(a, b, LINKS[0])?;
        for least in &LINKS[1..] {
            if best.reached.ncols() == a.nrows() {
                break;
            }
            let other = Self::with_links(a, b, *least)?;
            if other.reached.ncols() > best.reached.ncols() {
                best = other;
            }
        }
        Ok(best)
    }

    /// With sizes from links down to a share `least` of the others.
    fn with_links(a: &DMatrix<f64>, b: &DMatrix<f64>, least: f64) -> Result<Self> {
        let n = a.nrows();
        let (states, inputs) = comparable(a, b, least);
        let a = DMatrix::from_fn(n, n, |i, j| scaled(a[(i, j)], states[j] - states[i]));
        let b = DMatrix::from_fn(n, b.ncols(), |i, j| scaled(b[(i, j)], inputs[j] - states[i]));
        // A − μ I reaches the same; of a sampled system it is what happens within a sample
        let mean = if n > 0 { a.trace() / n as f64 } else { 0.0 };
        let within = &a - DMatrix::identity(n, n) * mean;
        let least = (NO_COUPLING * b.norm(), NO_COUPLING * within.norm() + ROUNDED * a.norm());
        let reached = span(&within, &b, least)?;
        let rest = if reached.ncols() == 0 {
            DMatrix::identity(n, n)
        } else {
            svd(&reached)?.0.columns(reached.ncols(), n - reached.ncols()).into_owned()
        };
        Ok(Self { a, scale: states.iter().map(|s| s.exp()).collect(), reached, rest })
    }

    /// A of what moves on its own.
    fn own(&self) -> DMatrix<f64> {
        self.rest.tr_mul(&(&self.a * &self.rest))
    }

    fn hidden(&self) -> Result<HiddenModes> {
        let poles = eigenvalues(&self.own())?;
        let directions = combinations(&self.in_own_units(&self.rest), &self.scale);
        Ok(HiddenModes { reached: self.reached.ncols(), poles, directions })
    }

    /// Columns that combine states of comparable size, as combinations of the states themselves.
    fn in_own_units(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(columns.nrows(), columns.ncols(), |i, j| columns[(i, j)] / self.scale[i])
    }

    /// What of a sampled system is not reached and does not decay; none where all of it does.
    pub fn lasting(&self) -> Result<Option<HiddenModes>> {
        let Some((poles, basis)) = self.lasting_basis()? else { return Ok(None) };
        let directions = combinations(&basis, &self.scale);
        Ok(Some(HiddenModes { reached: self.reached.ncols(), poles, directions }))
    }

    /// Its poles and a basis of its combinations of states.
    fn lasting_basis(&self) -> Result<Option<(Poles, DMatrix<f64>)>> {
        let own = self.own();
        let poles: Poles = eigenvalues(&own)?;
        if poles.first().is_none_or(|p| p.norm() < 1.0 - ON_CIRCLE) {
            return Ok(None);
        }
        // what is left of it after 2¹⁰ samples
        let mut power = own;
        for _ in 0..10 {
            power = &power * &power;
            power /= power.norm().max(f64::MIN_POSITIVE);
        }
        let (_, sizes, right) = svd(&power)?;
        let near = 1.0 - rounding(poles.len());
        let left = poles.iter().filter(|p| p.norm() >= near).count().min(sizes.len());
        let lasts = self.in_own_units(&(&self.rest * right.columns(0, left)));
        Ok(Some((poles.into_iter().take(left).collect(), lasts)))
    }
}

type Poles = Vec<Complex<f64>>;

/// Combinations of few states each that span the same as the columns of `basis`: each has one state that no other has. States
/// count by their factors times `weight`.
fn combinations(basis: &DMatrix<f64>, weight: &[f64]) -> Vec<Vec<(usize, f64)>> {
    let n = basis.nrows();
    let basis = DMatrix::from_fn(basis.ncols(), n, |i, j| basis[(j, i)] * weight[j]);
    if basis.is_empty() {
        return Vec::new();
    }
    let mut left = basis.clone();
    let mut pivots: Vec<usize> = Vec::new();
    for _ in 0..basis.nrows() {
        // of equal ones the first, whatever rounding made of them
        let size = |j: usize| (left.column(j).norm() * 1e6).round();
        let most = (0..n).reduce(|best, j| if size(j) > size(best) { j } else { best }).unwrap_or(0);
        let along = left.column(most).normalize();
        left -= &along * along.tr_mul(&left);
        pivots.push(most);
    }
    pivots.sort_unstable();
    let Some(rows) = basis.select_columns(&pivots).lu().solve(&basis) else { return Vec::new() };
    let combination = |k: usize| {
        let pivot = pivots[k];
        let mut parts: Vec<usize> = (0..n).filter(|j| *j == pivot || rows[(k, *j)].abs() > 1e-6).collect();
        parts.sort_by_key(|j| *j != pivot);
        parts.into_iter().map(|j| (j, rows[(k, j)] * weight[pivot] / weight[j])).collect()
    };
    (0..pivots.len()).map(combination).collect()
}

/// A sampled system, taken apart.
pub(crate) struct Parts {
    /// What does not decay and inputs do not move, then what else does not decay and outputs do not show.
    pub lasting: [Option<HiddenModes>; 2],
    /// To the coordinates of what is both reached and shown, and back to states.
    pub to: DMatrix<f64>,
    pub back: DMatrix<f64>,
}

impl Parts {
    pub fn of(system: &StateSpace) -> Result<Self> {
        let outer = Staircase::of(system.a(), system.b())?;
        let diagonal = |values: Vec<f64>| DMatrix::from_diagonal(&values.into());
        let inverse = |scale: &[f64]| diagonal(scale.iter().map(|s| 1.0 / s).collect());
        let (to, back) =
            (outer.reached.transpose() * inverse(&outer.scale), diagonal(outer.scale.clone()) * &outer.reached);
        let (a, c) = (&to * system.a() * &back, system.c() * &back);
        let inner = Staircase::of(&a.transpose(), &c.transpose())?;
        let unseen = inner.lasting_basis()?.map(|(poles, basis)| {
            let weight: Vec<f64> = outer.scale.iter().map(|s| 1.0 / s).collect();
            HiddenModes { reached: inner.reached.ncols(), poles, directions: combinations(&(&back * basis), &weight) }
        });
        Ok(Self {
            lasting: [outer.lasting()?, unseen],
            to: inner.reached.transpose() * diagonal(inner.scale.clone()) * to,
            back: back * inverse(&inner.scale) * &inner.reached,
        })
    }
}

fn scaled(value: f64, power: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value * power.exp() }
}

/// Weakest links that sizes are found from, as shares of the strongest of their row and column.
const LINKS: [f64; 3] = [ROUNDED, NO_COUPLING, 1e-6];

/// Logarithms of sizes for states and inputs with which the largest number of each state's row equals that of its column, and
/// that of each input's column is as usual (Osborne 1960). Numbers below the share `least` of their row or their column are left out.
fn comparable(a: &DMatrix<f64>, b: &DMatrix<f64>, least: f64) -> (Vec<f64>, Vec<f64>) {
    let (n, m) = (a.nrows(), a.nrows() + b.ncols());
    let size = |i: usize, j: usize| if j < n { a[(i, j)] } else { b[(i, j - n)] };
    // logarithms: none overflows; what a state does to itself has no unit
    let logs = DMatrix::from_fn(n, m, |i, j| if i == j { f64::NEG_INFINITY } else { size(i, j).abs().ln() });
    let mut sizes = vec![0.0; m];
    for _ in 0..200 {
        let at = |i: usize, j: usize| logs[(i, j)] + sizes[j] - sizes[i];
        let most = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::NEG_INFINITY, f64::max);
        let rows: Vec<f64> = (0..n).map(|i| most(&mut (0..m).map(|j| at(i, j)))).collect();
        let columns: Vec<f64> = (0..m).map(|j| most(&mut (0..n).map(|i| at(i, j)))).collect();
        let counts = |i: usize, j: usize| at(i, j) >= least.ln() + rows[i].max(columns[j]);
        let row: Vec<f64> = (0..n).map(|i| most(&mut (0..m).filter(|j| counts(i, *j)).map(|j| at(i, j)))).collect();
        let column: Vec<f64> = (0..m).map(|j| most(&mut (0..n).filter(|i| counts(*i, j)).map(|i| at(i, j)))).collect();
        let both: Vec<f64> = (0..n).map(|i| 0.5 * (row[i] + column[i])).filter(|v| v.is_finite()).collect();
        let usual = if both.is_empty() { 0.0 } else { both.iter().sum::<f64>() / both.len() as f64 };
        let mut change = 0.0_f64;
        for j in 0..m {
            let enters = if j < n && row[j].is_finite() { row[j] } else { usual };
            let leaves = if column[j].is_finite() { column[j] } else { usual };
            let either = column[j].is_finite() || (j < n && row[j].is_finite());
            // half of it: neighbours move too
            let step = if either { 0.25 * (enters - leaves) } else { 0.0 };
            sizes[j] += step;
            change = change.max(step.abs());
        }
        if change < 0.1 {
            break;
        }
    }
    let inputs = sizes.split_off(n);
    (sizes, inputs)
}

/// The part that inputs reach and outputs show: the same response with the fewest states. Directions weaker than `tolerance`
/// (1e-9 is usual) of the matrices' size count as none.
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) where singular values are not found.
pub fn minimal(system: &StateSpace, tolerance: f64) -> Result<StateSpace> {
    let least = |a: &DMatrix<f64>, b: &DMatrix<f64>| (tolerance * b.norm(), tolerance * a.norm());
    let reached = span(system.a(), system.b(), least(system.a(), system.b()))?;
    let (a, b, c) = (reached.tr_mul(&(system.a() * &reached)), reached.tr_mul(system.b()), system.c() * &reached);
    let (back, seen) = (a.transpose(), c.transpose());
    let shown = span(&back, &seen, least(&back, &seen))?;
    let (a, b, c) = (shown.tr_mul(&(&a * &shown)), shown.tr_mul(&b), c * shown);
    if a.nrows() == system.n_state() {
        return Ok(system.clone());
    }
    system.with(a, b, c, system.d().clone(), system.dt())
}

/// An orthonormal basis of the span of B, A B, A² B, …: the new directions of each power, from those of the one before. The least
/// size of what counts is that of B's directions, then that of what A makes of unit vectors.
fn span(a: &DMatrix<f64>, b: &DMatrix<f64>, (of_b, of_a): (f64, f64)) -> Result<DMatrix<f64>> {
    let n = a.nrows();
    let mut basis = DMatrix::zeros(n, 0);
    let (mut new, mut least) = (b.clone(), of_b);
    while new.ncols() > 0 && basis.ncols() < n {
        // twice is enough (Parlett)
        for _ in 0..2 {
            let along = basis.tr_mul(&new);
            new -= &basis * along;
        }
        let (left, values, _) = svd(&new)?;
        let rank = values.iter().filter(|v| **v > least).count();
        let fresh = left.columns(0, rank).into_owned();
        basis = beside(&basis, &fresh);
        (new, least) = (a * fresh, of_a);
    }
    Ok(basis)
}
