//! What the rotors of a vehicle can do: rank, weakest direction, lost axes.

use super::vehicle::Vehicle;
use base::error::{Error, Result};
use nalgebra::{DMatrix, DVector, SVD};

/// Singular values below this share of the largest count as zero. A direction is dropped rather than bought at more
/// than a thousand times the thrust of the strongest one.
pub const RANK_TOLERANCE: f64 = 1e-3;
/// Cosine between two axes from which on they count as tied; its square is what is lost of either. Rounding makes 1e-15.
const TIED: f64 = 3e-5;
/// The lateral forces join the allocation (all six rows) where the weakest of the six directions has at least this
/// share of the strongest; below, forcing them to zero would cost more thrust than they are worth.
pub(crate) const FULL_TOLERANCE: f64 = 2e-2;

/// A component of the wrench at the centre of mass, body axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Force along x.
    ForceX,
    /// Force along y.
    ForceY,
    /// Force along z: the thrust.
    Thrust,
    /// Moment about x.
    Roll,
    /// Moment about y.
    Pitch,
    /// Moment about z.
    Yaw,
}

impl Axis {
    /// In wrench order `[force; moment]`.
    pub const ALL: [Self; 6] = [Self::ForceX, Self::ForceY, Self::Thrust, Self::Roll, Self::Pitch, Self::Yaw];
    /// What every multirotor is steered by, in the order of a mixer's columns.
    pub const STEERED: [Self; 4] = [Self::Thrust, Self::Roll, Self::Pitch, Self::Yaw];

    /// Lower case, for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::ForceX => "force x",
            Self::ForceY => "force y",
            Self::Thrust => "thrust",
            Self::Roll => "roll",
            Self::Pitch => "pitch",
            Self::Yaw => "yaw",
        }
    }

    /// Whether it is a moment, which lengths scale.
    pub fn is_moment(self) -> bool {
        self as usize >= 3
    }
}

/// What an allocation can deliver.
#[derive(Debug, Clone, PartialEq)]
pub struct Authority {
    /// Independent directions of the full wrench, 0 to 6.
    pub full_rank: usize,
    /// Whether all six rows are allocated, with zero lateral force.
    pub full: bool,
    /// Independent directions among the allocated rows (4 or 6).
    pub rank: usize,
    /// Smallest singular value of the allocated rows, moments divided by [`length`](Self::length): the norm of the
    /// weakest wrench (N) that rotor thrusts of norm 1 N can make.
    pub smallest_singular_value: f64,
    /// Largest singular value, likewise.
    pub largest_singular_value: f64,
    /// Characteristic length: the root mean square lever of the rotors, m.
    pub length: f64,
    /// Steered axes that cannot be commanded on their own; the mixer answers them as nearly as the rotors can.
    pub dropped: Vec<Axis>,
    /// The same in groups: of one axis that no rotor moves, or of several that move only together.
    pub tied: Vec<Vec<Axis>>,
}

impl Authority {
    /// Whether thrust, roll, pitch and yaw are all independent.
    pub fn is_complete(&self) -> bool {
        self.dropped.is_empty()
    }

    /// What of the steered axes the rotors cannot do: "pitch not at all", "roll and yaw only together".
    pub fn shortcomings(&self) -> String {
        let words = |axes: &Vec<Axis>| match axes.as_slice() {
            [axis] => format!("{} not at all", axis.name()),
            [rest @ .., last] => {
                let rest: Vec<_> = rest.iter().map(|axis| axis.name()).collect();
                format!("{} and {} only together", rest.join(", "), last.name())
            }
            [] => String::new(),
        };
        self.tied.iter().map(words).collect::<Vec<_>>().join(", ")
    }
}

impl Vehicle {
    /// What its rotors can do, in the axes in which it hovers level.
    pub fn authority(&self) -> Authority {
        decompose(&self.upright()).1
    }

    /// Refuses a vehicle that cannot be steered: thrust, roll, pitch and yaw have to be commanded each apart from the others.
    ///
    /// # Errors
    /// [`Error::Value`] that names the axes.
    pub fn check_steerable(&self) -> Result<()> {
        self.upright().check_own_axes()
    }

    /// The same in the axes in which it is described.
    pub(super) fn check_own_axes(&self) -> Result<()> {
        let authority = decompose(self).1;
        if authority.is_complete() {
            return Ok(());
        }
        Err(Error::value(
            format!("vehicle '{}': steering", self.name),
            format!("incomplete (its rotors move {})", authority.shortcomings()),
            "of thrust, roll, pitch and yaw, each apart from the others",
            self.steering_remedy(&authority),
        ))
    }

    fn steering_remedy(&self, authority: &Authority) -> &'static str {
        if self.n_rotor() < 4 {
            return "Four axes need four rotors; one that a servo tilts makes a system of bodies, as 'omnidrones show' lists them.";
        }
        let dragless = self.rotors.iter().all(|rotor| rotor.moment_per_thrust == 0.0);
        if dragless && authority.tied == [vec![Axis::Yaw]] {
            return "Give its rotors the moment of their drag: moment_per_thrust, m.";
        }
        "Set rotors around the centre of mass and let neighbours spin opposite ways: position, axis, spin."
    }
}

/// The decomposed rows of one choice of axes.
pub struct AuthorityRows {
    pub axes: Vec<Axis>,
    pub svd: SVD<f64, nalgebra::Dyn, nalgebra::Dyn>,
    /// What each row was divided by.
    pub scale: DVector<f64>,
}

impl AuthorityRows {
    /// Of a geometry of 6 × n, moments divided by `length`.
    pub fn new(geometry: &DMatrix<f64>, axes: &[Axis], length: f64) -> Self {
        let scale = DVector::from_fn(axes.len(), |i, _| if axes[i].is_moment() { length } else { 1.0 });
        let rows = DMatrix::from_fn(axes.len(), geometry.ncols(), |i, j| geometry[(axes[i] as usize, j)] / scale[i]);
        Self { axes: axes.to_vec(), svd: rows.svd(true, true), scale }
    }

    pub fn largest(&self) -> f64 {
        self.svd.singular_values.max()
    }

    /// The smallest over all rows: 0 where there are fewer rotors than rows.
    pub fn smallest(&self) -> f64 {
        if self.svd.singular_values.len() < self.axes.len() { 0.0 } else { self.svd.singular_values.min() }
    }

    pub fn rank(&self) -> usize {
        let floor = RANK_TOLERANCE * self.largest();
        self.svd.singular_values.iter().filter(|s| **s > floor).count()
    }

    /// Rows that cannot be commanded on their own.
    pub fn dropped(&self) -> Vec<Axis> {
        (0..self.axes.len()).filter(|row| self.reach(*row) < 1.0 - TIED * TIED).map(|row| self.axes[row]).collect()
    }

    /// The dropped rows among `steered` in groups that only move together: those tied by the projection onto what the rotors make.
    fn tied(&self, dropped: &[Axis]) -> Vec<Vec<Axis>> {
        let mut groups: Vec<Vec<Axis>> = Vec::new();
        let row = |axis: &Axis| self.axes.iter().position(|a| a == axis);
        for axis in dropped {
            let ties = |other: &Axis| match (row(axis), row(other)) {
                (Some(i), Some(j)) => self.projection(i, j).abs() > TIED,
                _ => false,
            };
            let (mut own, others): (Vec<_>, Vec<_>) =
                groups.into_iter().partition(|group: &Vec<Axis>| group.iter().any(ties));
            groups = others;
            let mut group = own.drain(..).flatten().collect::<Vec<_>>();
            group.push(*axis);
            groups.push(group);
        }
        groups.sort_by_key(|group| group[0] as usize);
        groups
    }

    /// Share of a unit wrench along `row` that the rotors can make: the squared length of its projection.
    fn reach(&self, row: usize) -> f64 {
        self.projection(row, row)
    }

    /// Entry of the projection onto the wrenches that the rotors can make.
    fn projection(&self, row: usize, column: usize) -> f64 {
        let floor = RANK_TOLERANCE * self.largest();
        let Some(u) = &self.svd.u else { return 0.0 };
        (0..self.svd.singular_values.len())
            .filter(|k| self.svd.singular_values[*k] > floor)
            .map(|k| u[(row, k)] * u[(column, k)])
            .sum()
    }
}

/// Root mean square lever of the rotors' unit thrusts about the centre of mass, m; 1 where all levers are zero.
///
/// `geometry` is 6 × n, a column per unit thrust.
pub fn characteristic_length(geometry: &DMatrix<f64>) -> f64 {
    let levers = geometry.rows(3, 3).norm_squared() / geometry.ncols().max(1) as f64;
    if levers > 0.0 { levers.sqrt() } else { 1.0 }
}

/// Chooses the rows to allocate: all six where the vehicle is well able to hold them, else thrust and moments.
pub fn decompose(vehicle: &Vehicle) -> (AuthorityRows, Authority) {
    let geometry = vehicle.allocation_matrix();
    let length = characteristic_length(&geometry);
    let six = AuthorityRows::new(&geometry, &Axis::ALL, length);
    let full_rank = six.rank();
    let full = six.smallest() > FULL_TOLERANCE * six.largest();
    let rows = if full { six } else { AuthorityRows::new(&geometry, &Axis::STEERED, length) };
    let dropped: Vec<Axis> = rows.dropped().into_iter().filter(|axis| Axis::STEERED.contains(axis)).collect();
    let authority = Authority {
        full_rank,
        full,
        rank: rows.rank(),
        smallest_singular_value: rows.smallest(),
        largest_singular_value: rows.largest(),
        length,
        tied: rows.tied(&dropped),
        dropped,
    };
    (rows, authority)
}
