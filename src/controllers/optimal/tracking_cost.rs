//! What it costs to be off a reference: squares of the errors of pose and velocities, of joints, and of inputs.
//!
//! ```text
//! ℓ = ½ dt (Σ w_p e_p² + w_v e_v² + w_R e_R² + w_ω e_ω² + w_j (q − q₀)² + w_j̇ q̇² + w_u (u − u_r)²)     e_R = log(q_r* ⊗ q)
//! ℓ_N = the same with weights of the end, without dt and inputs, + ½ (x ⊖ x_r)ᵀ P (x ⊖ x_r)
//! ```
//!
//! Position and velocity are those of the tracked body, in world axes; e_R and e_ω those of the root, in body axes. Joints are held
//! where hover has them. P, where there is one, is what the rest of an endless flight costs near hover: errors are turned into the
//! axes of the reference's heading, in which it was found.

use super::cost::{OptimalCost, StageInput, Terms};
use super::planned_plant::PlannedPlant;
use crate::design::ErrorState;
use crate::kinematics::Kinematics;
use autodiff::{Array, Scalar, System, safe};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::plant::RotorPlace;
use dynamics::spatial::{Quat, Vec3, conjugate, multiply, rotate, rotate_back, sub};
use nalgebra::DMatrix;
use num_dual::Dual64;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// Weights of [`TrackingCost`], each per second of the flight and per square of its unit; at the end not per second.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct TrackingWeights {
        /// Of the tracked position, world, 1/m².
        pub position: [f64; 3] = [600.0, 600.0, 1500.0],
        /// Of its velocity, world, s²/m².
        pub velocity: [f64; 3] = [5.0; 3],
        /// Of the root's attitude, body, 1/rad².
        pub attitude: [f64; 3] = [5.0, 5.0, 200.0],
        /// Of its angular velocity, body, s²/rad².
        pub angular_velocity: [f64; 3] = [1.0; 3],
        /// Of every joint's coordinate from where hover has it, 1/rad² or 1/m².
        pub joint: f64 = 0.0,
        /// Of its rate.
        pub joint_rate: f64 = 0.0,
        /// Of every input from that of the reference, in shares of its range.
        pub input: f64 = 2.0,
    }
}

impl TrackingWeights {
    /// Numbers in the flat form.
    pub const DIM: usize = 15;

    /// None at all.
    pub fn zero() -> Self {
        Self {
            position: [0.0; 3],
            velocity: [0.0; 3],
            attitude: [0.0; 3],
            angular_velocity: [0.0; 3],
            joint: 0.0,
            joint_rate: 0.0,
            input: 0.0,
        }
    }

    /// Writes the flat form: position, velocity, attitude, angular velocity, joint, joint rate, input.
    pub fn flat(&self) -> [f64; Self::DIM] {
        let mut all = [0.0; Self::DIM];
        let rows = [self.position, self.velocity, self.attitude, self.angular_velocity];
        rows.iter().enumerate().for_each(|(k, row)| all[3 * k..3 * k + 3].copy_from_slice(row));
        all[12..].copy_from_slice(&[self.joint, self.joint_rate, self.input]);
        all
    }

    /// The inverse of [`flat`](Self::flat).
    pub fn of_flat(all: &[f64; Self::DIM]) -> Self {
        let [position, velocity, attitude, angular_velocity] = [0, 3, 6, 9].map(|k| all.array(k));
        Self { position, velocity, attitude, angular_velocity, joint: all[12], joint_rate: all[13], input: all[14] }
    }

    /// Names of the flat form.
    pub fn names() -> Vec<String> {
        let levels = ["position", "velocity", "attitude", "angular_velocity"];
        let of = |level: &str| ["x", "y", "z"].map(|axis| format!("{level}_{axis}"));
        let mut names: Vec<String> = levels.into_iter().flat_map(of).collect();
        names.extend(["joint", "joint_rate", "input"].map(String::from));
        names
    }

    /// All of them times a factor.
    pub fn scaled(&self, factor: f64) -> Self {
        Self::of_flat(&self.flat().map(|w| w * factor))
    }

    /// Checks that all are ≥ 0 and finite.
    ///
    /// # Errors
    /// [`Error::Value`] that names the first that is not.
    pub fn validate(&self) -> Result<()> {
        match self.flat().iter().zip(Self::names()).find(|(w, _)| !(**w >= 0.0 && w.is_finite())) {
            None => Ok(()),
            Some((w, name)) => {
                Err(Error::value(format!("weights.{name}"), w, "≥ 0 and finite", "Weigh by 0 what does not matter."))
            }
        }
    }
}

/// What follows the reference, and where the rest stands in hover.
#[derive(Debug, Clone)]
pub struct TrackingCost {
    plant: PlannedPlant,
    /// Body that is tracked.
    body: usize,
    errors: ErrorState,
    hover: Vec<f64>,
    /// From the root to the tracked body in hover at yaw 0, m.
    offset: Vec3<f64>,
    input_scale: Vec<f64>,
    /// L of P = LᵀL, by rows of the error.
    end: Option<DMatrix<f64>>,
    /// Kind of every number of the error behind the root's.
    rest: Vec<Rest>,
}

/// What a number of the error behind those of the root is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Rest {
    Joint,
    JointRate,
    /// At this number of the state, steered by this input.
    RotorSpeed {
        at: usize,
        input: usize,
    },
}

impl TrackingCost {
    /// For a plant whose body `body` follows; 0 is the root.
    ///
    /// # Errors
    /// [`Error::Value`] for no such body, or a plant that cannot hover.
    pub fn new(plant: &PlannedPlant, body: usize) -> Result<Self> {
        let n = plant.plant().n_frame();
        if body >= n {
            let what = format!("tracked body of '{}'", plant.plant().name());
            return Err(Error::value(what, body, format!("0 to {}", n - 1), "Number the bodies from 0."));
        }
        let (hover, input) = plant.hover()?;
        let whole = plant.plant_state(&hover, &input);
        let mut frames = vec![0.0; n * Kinematics::<f64>::DIM];
        let theta = plant.plant().parameters();
        plant.plant().write_frames(&theta, &whole, &mut frames);
        let place = |body: usize| frames.array::<3>(body * Kinematics::<f64>::DIM);
        let (lower, upper) = plant.bounds();
        let places = plant.plant().rotor_places();
        let quantities = plant.plant().state_quantities();
        let errors = plant.errors()?;
        let mut rest = Vec::new();
        errors.each(|at, _, turns| {
            let own = plant.kept()[at];
            let steers = |rotor: &RotorPlace| plant.commands().iter().position(|k| *k == rotor.action);
            let kind = match places.iter().find(|rotor| rotor.speed == own) {
                Some(rotor) => Rest::RotorSpeed { at, input: steers(rotor).unwrap_or(0) },
                None if quantities[own].unit.ends_with("/s") => Rest::JointRate,
                None => Rest::Joint,
            };
            let repeats = if turns { 3 } else { 1 };
            rest.extend(std::iter::repeat_n(kind, repeats));
        });
        if !errors.turns_at(6) {
            let what = format!("root of '{}'", plant.plant().name());
            let remedy = "Plan for something that flies.";
            return Err(Error::value(what, "fixed to the world", "free to move", remedy));
        }
        rest.drain(..12);
        Ok(Self {
            offset: sub(place(body), place(0)),
            input_scale: lower.iter().zip(upper).map(|(lower, upper)| 1.0 / (upper - lower)).collect(),
            errors,
            end: None,
            plant: plant.clone(),
            body,
            rest,
            hover,
        })
    }

    /// The same with P at the end, n_error × n_error, positive semidefinite.
    ///
    /// # Errors
    /// [`Error::Value`] for another size or a matrix that is not symmetric and positive semidefinite up to rounding.
    pub fn with_end(mut self, p: &DMatrix<f64>) -> Result<Self> {
        let n = self.errors.n_error();
        let fits = p.shape() == (n, n);
        let eigen = if fits { Some((0.5 * (p + p.transpose())).symmetric_eigen()) } else { None };
        let Some(eigen) = eigen.filter(|own| own.eigenvalues.min() >= -1e-9 * own.eigenvalues.max().max(1e-300)) else {
            let rule = format!("{n} × {n}, symmetric, positive semidefinite");
            return Err(Error::value("cost of the end", format!("{:?}", p.shape()), rule, "Take that of an LQR."));
        };
        let roots = eigen.eigenvalues.map(|e| e.max(0.0).sqrt());
        self.end = Some(DMatrix::from_diagonal(&roots) * eigen.eigenvectors.transpose());
        Ok(self)
    }

    /// The plant.
    pub fn plant(&self) -> &PlannedPlant {
        &self.plant
    }

    /// Hover, `[n_state]`.
    pub fn hover(&self) -> &[f64] {
        &self.hover
    }

    /// Q, n_error × n_error, and R, n_input × n_input, of a stage at hover.
    pub fn hessian_at_hover(&self, weights: &TrackingWeights) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, m, dt) = (self.errors.n_error(), self.plant.n_input(), self.plant.plant().physics().dt);
        let (w, body) = (weights.flat(), self.body);
        let mut q = DMatrix::zeros(n, n);
        (0..12).filter(|k| body == 0 || *k >= 6).for_each(|k| q[(k, k)] = dt * w[k]);
        if body != 0 {
            self.add_tracked(&w, dt, &mut q);
        }
        for (k, kind) in self.rest.iter().enumerate() {
            q[(12 + k, 12 + k)] += match kind {
                Rest::Joint => dt * w[12],
                Rest::JointRate => dt * w[13],
                Rest::RotorSpeed { .. } => 0.0,
            };
        }
        let r = DMatrix::from_fn(m, m, |i, j| if i == j { dt * w[14] * self.input_scale[i].powi(2) } else { 0.0 });
        (q, r)
    }

    /// Squares of position and velocity of a tracked body that is not the root.
    fn add_tracked(&self, w: &[f64], dt: f64, q: &mut DMatrix<f64>) {
        let n = self.hover.len();
        let mut by_state = DMatrix::zeros(6, n);
        for j in 0..n {
            let state: Vec<Dual64> =
                self.hover.iter().enumerate().map(|(k, x)| Dual64::new(*x, if k == j { 1.0 } else { 0.0 })).collect();
            let own = self.tracked(&state);
            for k in 0..3 {
                by_state[(k, j)] = own.position[k].eps;
                by_state[(3 + k, j)] = own.velocity[k].eps;
            }
        }
        let by_error = by_state * self.errors.tangent(&self.hover);
        for k in 0..6 {
            let row = by_error.row(k);
            *q += dt * w[k] * row.transpose() * row;
        }
    }

    /// Parameters of a stage: position, velocity, attitude (4) and angular velocity of the reference, its inputs, then
    /// [`TrackingWeights`] in the flat form.
    pub fn write_parameters(
        &self,
        motion: &Kinematics<f64>,
        inputs: &[f64],
        weights: &TrackingWeights,
        parameters: &mut [f64],
    ) {
        let (target, rest) = parameters.split_at_mut(Kinematics::<f64>::DIM);
        motion.write(target);
        let (own, rest) = rest.split_at_mut(inputs.len());
        own.copy_from_slice(inputs);
        rest.copy_from_slice(&weights.flat());
    }

    fn read<'a, S: Scalar>(&self, parameters: &'a [S]) -> (Kinematics<S>, &'a [S], &'a [S]) {
        let (target, rest) = parameters.split_at(Kinematics::<S>::DIM);
        let (inputs, weights) = rest.split_at(self.plant.n_input());
        (Kinematics::read(target), inputs, weights)
    }

    /// Squares of the errors of a state, times `by`.
    fn track<S: Scalar>(&self, state: &[S], target: &Kinematics<S>, w: &[S], by: S, terms: &mut Terms<S>) {
        let own = Kinematics::read(state);
        let Kinematics { position, velocity, .. } = self.tracked(state);
        let turned = logarithm(multiply(conjugate(target.attitude), own.attitude));
        let rows = [
            sub(position, target.position),
            sub(velocity, target.velocity),
            turned,
            sub(own.angular_velocity, target.angular_velocity),
        ];
        for (k, error) in rows.as_flattened().iter().enumerate() {
            terms.square(by * w[k], *error);
        }
        let rest = self.rest_errors(state);
        for (kind, error) in self.rest.iter().zip(rest) {
            match kind {
                Rest::Joint => terms.square(by * w[12], error),
                Rest::JointRate => terms.square(by * w[13], error),
                Rest::RotorSpeed { .. } => {}
            }
        }
    }

    /// Position of the tracked body, world, m.
    pub(super) fn position<S: Scalar>(&self, state: &[S]) -> Vec3<S> {
        self.tracked(state).position
    }

    /// Motion of the tracked body.
    pub(super) fn tracked<S: Scalar>(&self, state: &[S]) -> Kinematics<S> {
        if self.body == 0 {
            return Kinematics::read(state);
        }
        let plant = self.plant.plant();
        let mut whole = vec![S::zero(); plant.n_state()];
        self.plant.write_whole(state, &mut whole);
        let theta: Vec<S> = plant.parameters().into_iter().map(S::constant).collect();
        let mut frames = vec![S::zero(); plant.n_frame() * Kinematics::<S>::DIM];
        plant.write_frames(&theta, &whole, &mut frames);
        Kinematics::read(&frames[self.body * Kinematics::<S>::DIM..])
    }

    /// Errors from hover of what stands behind the root.
    fn rest_errors<S: Scalar>(&self, state: &[S]) -> Vec<S> {
        let mut all = Vec::new();
        self.errors.each(|at, _, turns| {
            if at < Kinematics::<S>::DIM {
                return;
            }
            if turns {
                let hover: Quat<S> = self.hover.array::<4>(at).map(S::constant);
                all.extend(logarithm(multiply(conjugate(hover), state.array::<4>(at))));
            } else {
                all.push(state[at] - S::constant(self.hover[at]));
            }
        });
        all
    }

    /// x ⊖ x_r in the axes of the reference's heading, `[n_error]`.
    fn errors_from<S: Scalar>(&self, state: &[S], target: &Kinematics<S>, inputs: &[S]) -> Vec<S> {
        let own = Kinematics::read(state);
        // the part of the target's attitude about the vertical
        let [w, _, _, z] = target.attitude;
        let length = safe::recip_sqrt(w * w + z * z, 1e-12);
        let heading = [w * length, S::zero(), S::zero(), z * length];
        let offset = rotate(heading, self.offset.map(S::constant));
        let root = sub(target.position, offset);
        let turned = logarithm(multiply(conjugate(target.attitude), own.attitude));
        let mut all = Vec::with_capacity(self.errors.n_error());
        all.extend(rotate_back(heading, sub(own.position, root)));
        all.extend(rotate_back(heading, sub(own.velocity, target.velocity)));
        all.extend(turned);
        all.extend(sub(own.angular_velocity, target.angular_velocity));
        for (kind, error) in self.rest.iter().zip(self.rest_errors(state)) {
            all.push(match kind {
                // from the speeds that the reference asks for
                Rest::RotorSpeed { at, input } => state[*at] - inputs[*input],
                _ => error,
            });
        }
        all
    }
}

impl OptimalCost for TrackingCost {
    fn n_parameter(&self) -> usize {
        Kinematics::<f64>::DIM + self.plant.n_input() + TrackingWeights::DIM
    }

    fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>) {
        let (target, inputs, w) = self.read(now.parameters);
        let dt = S::constant(self.plant.plant().physics().dt);
        self.track(now.state, &target, w, dt, terms);
        for (i, (own, wanted)) in now.input.iter().zip(inputs).enumerate() {
            terms.square(dt * w[14], (*own - *wanted) * S::constant(self.input_scale[i]));
        }
    }

    fn terminal<S: Scalar>(&self, end: StageInput<'_, S>, terms: &mut Terms<S>) {
        let (target, inputs, w) = self.read(end.parameters);
        self.track(end.state, &target, w, S::one(), terms);
        if let Some(root) = &self.end {
            let errors = self.errors_from(end.state, &target, inputs);
            for row in 0..root.nrows() {
                let own = errors.iter().enumerate().map(|(k, e)| S::constant(root[(row, k)]) * *e);
                let sum = own.fold(S::zero(), |sum, term| sum + term);
                terms.square(S::one(), sum);
            }
        }
    }
}

/// The rotation vector of a unit quaternion, |θ| ≤ π, the short way round.
pub(crate) fn logarithm<S: Scalar>(q: Quat<S>) -> Vec3<S> {
    let sign = S::select(q[0].lt(S::zero()), -S::one(), S::one());
    let (w, v) = (sign * q[0], [sign * q[1], sign * q[2], sign * q[3]]);
    let square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    let near = square.lt(S::constant(1e-6));
    // 2 atan2(s, w)/s = 2/w (1 − s²/3w² + s⁴/5w⁴ …)
    let sine = safe::sqrt(S::select(near, S::constant(1e-6), square), 1e-12);
    let exact = S::constant(2.0) * safe::atan2(sine, w) / sine;
    let tangent = square / (w * w).max(S::constant(0.25));
    let series = S::constant(2.0) / w.max(S::constant(0.5))
        * (S::one() - tangent * (S::constant(1.0 / 3.0) - tangent * S::constant(0.2)));
    let factor = S::select(near, series, exact);
    [factor * v[0], factor * v[1], factor * v[2]]
}
