//! States with unit quaternions, as errors without redundancy.
//!
//! A quaternion q = q₀ ⊗ exp(½ δθ) stands for a rotation vector δθ (R = R₀ exp(δθ^), axes of the body): four numbers of the
//! state, three of the error. All other numbers are their own errors. With E = ∂(x ⊕ δ)/∂δ at δ = 0 and E⁺ its
//! pseudo-inverse, a step x⁺ = f(x, u) becomes
//!
//! ```text
//! δ⁺ = E⁺(x⁺) A E(x) δ + E⁺(x⁺) B δu
//! ```
//!
//! Unreduced, A carries a direction per quaternion that its norm forbids, which no input reaches: a Riccati equation
//! has no use for it. For unit quaternions E⁺ = 4 Eᵀ in that block.

use crate::linear::{Signal, StateSpace};
use autodiff::{Linearisation, System, linearise};
use base::error::{Error, Result};
use dynamics::spatial::{Quat, conjugate, exponential, multiply};
use dynamics::tree::{Motion, Multibody};
use dynamics::{Plant, Quantity};
use nalgebra::{DMatrix, DVector};

/// Where unit quaternions stand in a state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ErrorState {
    n_state: usize,
    /// First number of each, ascending.
    quaternions: Vec<usize>,
}

impl ErrorState {
    /// For states of `n_state` numbers with quaternions that begin at the given places.
    ///
    /// # Errors
    /// [`Error::Value`] if the places are not ascending, overlap or do not fit.
    pub fn new(n_state: usize, quaternions: &[usize]) -> Result<Self> {
        let apart = quaternions.windows(2).all(|pair| pair[0] + 4 <= pair[1]);
        if !apart || quaternions.last().is_some_and(|at| at + 4 > n_state) {
            let rule = format!("ascending, four apart and within {n_state} numbers");
            let remedy = "Give the place of each quaternion's w in the state.";
            return Err(Error::value("places of quaternions", format!("{quaternions:?}"), rule, remedy));
        }
        Ok(Self { n_state, quaternions: quaternions.to_vec() })
    }

    /// For an articulated system: floating bodies and ball joints have quaternions.
    pub fn of(system: &Multibody) -> Self {
        let bodies = system.model().bodies().iter().zip(&system.layout().bodies);
        let mut quaternions: Vec<usize> = bodies
            .filter_map(|(body, place)| match body.joint.motion {
                Motion::Floating => Some(place.position + 6),
                Motion::Ball => Some(place.position),
                Motion::Revolute(_) | Motion::Prismatic(_) => None,
            })
            .collect();
        quaternions.sort_unstable();
        Self { n_state: system.n_state(), quaternions }
    }

    /// For a plant.
    ///
    /// # Errors
    /// As [`rigid`](Self::rigid).
    pub fn of_plant(plant: &Plant) -> Result<Self> {
        match plant {
            Plant::Rigid(m) => Self::rigid(m.n_state()),
            Plant::Tree(m) => Ok(Self::of(m)),
        }
    }

    /// For a state that begins with the 13 numbers of a rigid vehicle: a [`Multirotor`](dynamics::Multirotor), a
    /// [`ClosedLoop`](crate::ClosedLoop).
    ///
    /// # Errors
    /// [`Error::Value`] for fewer than ten numbers.
    pub fn rigid(n_state: usize) -> Result<Self> {
        Self::new(n_state, &[6])
    }

    /// The same in front of further numbers: a state that begins with this one.
    pub(crate) fn longer(self, n_state: usize) -> Self {
        Self { n_state, ..self }
    }

    /// Numbers of a state.
    pub fn n_state(&self) -> usize {
        self.n_state
    }

    /// Numbers of an error.
    pub fn n_error(&self) -> usize {
        self.n_state - self.quaternions.len()
    }

    /// Whether a quaternion begins at this number of the state.
    pub fn turns_at(&self, number: usize) -> bool {
        self.quaternions.contains(&number)
    }

    /// Place in the error of a number of the state; for the w of a quaternion that of its rotation vector.
    pub fn place(&self, number: usize) -> usize {
        number - self.quaternions.iter().filter(|at| **at + 3 <= number).count()
    }

    /// x ⊖ x₀, `[n_error]`, rotations by the short way round.
    ///
    /// # Panics
    /// If a slice does not have the length of the state.
    pub fn difference(&self, x: &[f64], from: &[f64]) -> DVector<f64> {
        assert_eq!((x.len(), from.len()), (self.n_state, self.n_state), "lengths of the states");
        let mut error = DVector::zeros(self.n_error());
        self.write_difference(x, from, error.as_mut_slice());
        error
    }

    /// As [`difference`](Self::difference), into `error`.
    pub(crate) fn write_difference(&self, x: &[f64], from: &[f64], error: &mut [f64]) {
        self.each(|at, to, turns| {
            if turns {
                let turn = logarithm(multiply(conjugate(quaternion(from, at)), quaternion(x, at)));
                error[to..to + 3].copy_from_slice(&turn);
            } else {
                error[to] = x[at] - from[at];
            }
        });
    }

    /// x₀ ⊕ δ, `[n_state]`, the inverse of [`difference`](Self::difference).
    ///
    /// # Panics
    /// If a slice does not have the length of the state or of the error.
    pub fn moved(&self, from: &[f64], error: &[f64]) -> Vec<f64> {
        assert_eq!((from.len(), error.len()), (self.n_state, self.n_error()), "lengths of state and error");
        let mut x = from.to_vec();
        self.move_by(&mut x, error);
        x
    }

    /// Makes its quaternions unit ones.
    ///
    /// # Errors
    /// [`Error::Value`] for one of no length, which turns nowhere.
    pub(crate) fn unite(&self, x: &mut [f64]) -> Result<()> {
        for at in &self.quaternions {
            let own = &mut x[*at..*at + 4];
            let largest = own.iter().fold(0.0_f64, |most, q| most.max(q.abs()));
            if largest == 0.0 {
                let remedy = "Give it a direction: [1, 0, 0, 0] does not turn.";
                return Err(Error::value("quaternion of the state", "0", "of length one", remedy));
            }
            // by its largest number first, whose square may overflow
            own.iter_mut().for_each(|q| *q /= largest);
            let length = own.iter().map(|q| q * q).sum::<f64>().sqrt();
            own.iter_mut().for_each(|q| *q /= length);
        }
        Ok(())
    }

    /// x ⊕ δ in place of x.
    pub(crate) fn move_by(&self, x: &mut [f64], error: &[f64]) {
        self.each(|at, to, turns| {
            if turns {
                let turn = exponential([error[to], error[to + 1], error[to + 2]]);
                let moved = multiply(quaternion(x, at), turn);
                x[at..at + 4].copy_from_slice(&moved);
            } else {
                x[at] += error[to];
            }
        });
    }

    /// E = ∂(x ⊕ δ)/∂δ at x, `n_state` × [`n_error`](Self::n_error).
    pub fn tangent(&self, x: &[f64]) -> DMatrix<f64> {
        let mut e = DMatrix::zeros(self.n_state, self.n_error());
        self.each(|at, to, turns| {
            if !turns {
                e[(at, to)] = 1.0;
                return;
            }
            for k in 0..3 {
                let mut half = [0.0; 4];
                half[1 + k] = 0.5;
                let column = multiply(quaternion(x, at), half);
                e.view_mut((at, to + k), (4, 1)).copy_from_slice(&column);
            }
        });
        e
    }

    /// E⁺ at x, [`n_error`](Self::n_error) × `n_state`: E⁺ E = I, and what leaves the unit sphere is dropped.
    pub fn cotangent(&self, x: &[f64]) -> DMatrix<f64> {
        let mut back = self.tangent(x).transpose();
        for at in &self.quaternions {
            let mut rows = back.rows_mut(self.place(*at), 3);
            rows *= 4.0;
        }
        back
    }

    /// A and B of the error, n_error × n_error and n_error × n_input, of a step linearised at x: E⁺(x⁺) A E(x) and E⁺(x⁺) B.
    pub fn reduce(&self, x: &[f64], step: &Linearisation) -> (DMatrix<f64>, DMatrix<f64>) {
        let back = self.cotangent(step.next.as_slice());
        (&back * &step.state * self.tangent(x), back * &step.input)
    }

    /// Names and units of the numbers of an error; those of a rotation vector stand where its quaternion did.
    pub fn signals(&self, plant: &Plant) -> Vec<Signal> {
        let names = plant.state_quantities();
        let mut all = Vec::with_capacity(self.n_error());
        self.each(|at, _, turns| {
            let Quantity { name, unit } = &names[at];
            if turns {
                let stem = name.trim_end_matches("_w");
                all.extend(["x", "y", "z"].map(|axis| Signal::new(format!("{stem}_{axis}"), "rad")));
            } else {
                all.push(Signal::new(name.clone(), *unit));
            }
        });
        all
    }

    /// One step of a plant about a steady flight that turns at `yaw_rate` (rad/s), sampled at its dt: the error state from itself and
    /// all inputs, seen whole. Motors answer with the longer of their lags, up or down: their speeds are taken 10⁻⁷ beside the steady
    /// ones, which moves no entry by more than 3·10⁻⁷ of the largest of its row. Places and velocities of roots, and what acts on them from
    /// outside, are in axes that turn with the flight: seen so, every step is the same, R_z(−r dt) A and R_z(−r dt) B.
    ///
    /// # Errors
    /// [`Error::Value`] where the linearisation is not finite.
    pub fn state_space(&self, plant: &Plant, state: &[f64], input: &[f64], yaw_rate: f64) -> Result<StateSpace> {
        let theta = if plant.n_parameter() > 0 { plant.parameters() } else { Vec::new() };
        let mut state = state.to_vec();
        plant.take_longer_lags(&mut state);
        let (a, b) = self.reduce(&state, &linearise(plant, &state, input, &theta));
        let back = self.turned_back(plant, yaw_rate * plant.physics().dt);
        let (a, b) = (&back * a, back * b);
        let (n, m, signals) = (a.nrows(), b.ncols(), self.signals(plant));
        let inputs = plant.input_quantities().into_iter().map(|q| Signal::new(q.name, q.unit)).collect();
        StateSpace::new(a, b, DMatrix::identity(n, n), DMatrix::zeros(n, m), Some(plant.physics().dt))?.named(
            signals.clone(),
            inputs,
            signals,
        )
    }

    /// R_z(−angle) on places and velocities of roots that float.
    fn turned_back(&self, plant: &Plant, angle: f64) -> DMatrix<f64> {
        let (s, c) = angle.sin_cos();
        let mut back = DMatrix::identity(self.n_error(), self.n_error());
        for root in plant.roots().into_iter().filter(|root| self.turns_at(root + 6)) {
            for at in [self.place(root), self.place(root + 3)] {
                (back[(at, at)], back[(at, at + 1)]) = (c, s);
                (back[(at + 1, at)], back[(at + 1, at + 1)]) = (-s, c);
            }
        }
        back
    }

    /// Calls with (place in the state, place in the error, whether a quaternion begins there) for all of them.
    pub(crate) fn each(&self, mut visit: impl FnMut(usize, usize, bool)) {
        let (mut at, mut to) = (0, 0);
        while at < self.n_state {
            let turns = self.turns_at(at);
            visit(at, to, turns);
            (at, to) = if turns { (at + 4, to + 3) } else { (at + 1, to + 1) };
        }
    }
}

pub(super) fn quaternion(x: &[f64], at: usize) -> Quat<f64> {
    [x[at], x[at + 1], x[at + 2], x[at + 3]]
}

/// The rotation vector of a unit quaternion, |δθ| ≤ π.
fn logarithm(q: Quat<f64>) -> [f64; 3] {
    let q = if q[0] < 0.0 { q.map(|v| -v) } else { q };
    let sine = q[1].hypot(q[2]).hypot(q[3]);
    // 2 atan(s/w)/s → 2/w
    let factor = if sine > 1e-9 { 2.0 * sine.atan2(q[0]) / sine } else { 2.0 / q[0] };
    [1, 2, 3].map(|k| factor * q[k])
}
