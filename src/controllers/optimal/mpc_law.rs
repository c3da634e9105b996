//! Model predictive control as a straight-line law: converged in every tick, a function of what it is told alone.
//!
//! A tick solves its problem from the reference on, to convergence, so that equal arguments have equal answers; its derivative is that of
//! the solution ([`SolutionSensitivity`]), exact in state, reference and weights. So a loop around it is one differentiable
//! [`System`]: gradients of flights by weights, closed loops in batches. [`Mpc`](super::Mpc) is what flies: it keeps its plan, takes
//! one program a tick and estimates disturbances.

use super::flat_motion::{FlatMotion, Push};
use super::mpc::MpcSettings;
use super::planned_plant::PlannedPlant;
use super::problem::OptimalTrajectory;
use super::real_time::RealTimeIteration;
use super::sensitivity::SolutionSensitivity;
use super::tracking_cost::{TrackingCost, TrackingWeights};
use crate::controller::Target;
use crate::kinematics::Kinematics;
use crate::law::{ControlLaw, LawInput};
use autodiff::{CustomFunction, Operation, Scalar, System};
use base::error::{Error, Result};
use dynamics::Plant;
use std::sync::{Arc, Mutex, PoisonError};

/// Most programs of a tick.
const MOST_PROGRAMS: usize = 60;

/// Largest step of the last one.
const CONVERGED: f64 = 1e-11;

/// Model predictive control of one vehicle or one floating tree, as a law.
///
/// - Target: of each of N + 1 instants position, velocity, attitude and angular velocity of the reference, and its inputs.
/// - Parameters: [`TrackingWeights`]; the cost of an endless flight at the end stays that of the weights it was made with. No memory; no disturbance estimate; latency is not answered for.
/// - An answer that does not converge is NaN.
#[derive(Clone)]
pub struct MpcLaw {
    operation: Operation,
    inner: Arc<Inner>,
    rate: Option<f64>,
}

/// [state, targets, weights] → first inputs.
struct Inner {
    planned: PlannedPlant,
    flat: FlatMotion,
    cost: TrackingCost,
    settings: MpcSettings,
    template: RealTimeIteration,
    /// As many as have evaluated at once.
    idle: Mutex<Vec<RealTimeIteration>>,
}

impl MpcLaw {
    /// Of a plant that is believed to be so. `latency`, `estimate` and `iterations` of the settings play no part.
    ///
    /// # Errors
    /// As [`Mpc::new`](super::Mpc::new).
    pub fn new(plant: &Plant, settings: &MpcSettings) -> Result<Self> {
        let (planned, cost, problem, inputs) = settings.problem(plant, true)?;
        let dt = plant.physics().dt;
        let every = settings.ticks_every(dt)?;
        let inner = Arc::new(Inner {
            flat: FlatMotion::new(&planned)?,
            template: RealTimeIteration::new(problem, &inputs)?,
            settings: settings.clone(),
            idle: Mutex::default(),
            planned,
            cost,
        });
        let rate = (every > 1).then(|| 1.0 / (every as f64 * dt));
        Ok(Self { operation: Operation::new(Shared(inner.clone())), inner, rate })
    }
}

impl Inner {
    /// Numbers of the reference at one instant.
    fn n_instant(&self) -> usize {
        Kinematics::<f64>::DIM + self.planned.n_input()
    }

    fn n_target(&self) -> usize {
        (self.settings.stages + 1) * self.n_instant()
    }

    /// The problem that the numbers describe, solved; nothing where it does not converge.
    fn solved(&self, x: &[f64]) -> Option<RealTimeIteration> {
        let idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut own = idle.unwrap_or_else(|| self.template.clone());
        let is_solved = self.solve(&mut own, x).is_ok();
        is_solved.then_some(own)
    }

    fn give_back(&self, own: RealTimeIteration) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(own);
    }

    /// Solves the problem that the numbers describe, and hands on what takes adjoints of the first inputs to those of the numbers; nothing
    /// where it does not converge or its solution has no derivative.
    fn about(&self, x: &[f64], each: impl FnOnce(&mut dyn FnMut(&[f64], &mut [f64]))) {
        let Some(own) = self.solved(x) else { return };
        if let Ok(mut sensitivity) = SolutionSensitivity::new(own.problem(), own.plan()) {
            each(&mut |y_bar, x_bar| self.write_adjoint(&own, &mut sensitivity, y_bar, x_bar));
        }
        self.give_back(own);
    }

    fn write_adjoint(
        &self,
        own: &RealTimeIteration,
        sensitivity: &mut SolutionSensitivity,
        y_bar: &[f64],
        x_bar: &mut [f64],
    ) {
        let mut inputs = vec![0.0; own.plan().inputs.len()];
        inputs[..y_bar.len()].copy_from_slice(y_bar);
        let adjoint = sensitivity.reverse(own.problem(), &inputs, &[]);
        let (state, rest) = x_bar.split_at_mut(adjoint.start.len());
        let (targets, weights) = rest.split_at_mut(self.n_target());
        state.copy_from_slice(&adjoint.start);
        weights.fill(0.0);
        let (n, first) = (self.n_instant(), self.planned.n_parameter());
        let n_parameter = own.problem().model().n_parameter();
        for (stage, row) in adjoint.parameters.chunks_exact(n_parameter).enumerate() {
            targets[stage * n..(stage + 1) * n].copy_from_slice(&row[first..first + n]);
            if stage < self.settings.stages || !self.settings.endless {
                weights.iter_mut().zip(&row[first + n..]).for_each(|(sum, own)| *sum += own);
            }
        }
    }

    fn solve(&self, own: &mut RealTimeIteration, x: &[f64]) -> Result<()> {
        base::error::finite("arguments of a tick", x)?;
        let (state, rest) = x.split_at(self.planned.n_state());
        let (targets, weights) = rest.split_at(self.n_target());
        let mut plan = OptimalTrajectory::default();
        let mut row = vec![0.0; own.problem().model().n_parameter()];
        let first = self.planned.n_parameter();
        for (stage, target) in targets.chunks_exact(self.n_instant()).enumerate() {
            let is_end = stage == self.settings.stages;
            row[first..first + target.len()].copy_from_slice(target);
            let own_weights = &mut row[first + target.len()..];
            own_weights.copy_from_slice(weights);
            if is_end && self.settings.endless {
                own_weights.fill(0.0);
            }
            own.problem_mut().set_parameters(stage, &row)?;
            let mut along = self.cost.hover().to_vec();
            along[..Kinematics::<f64>::DIM].copy_from_slice(&target[..Kinematics::<f64>::DIM]);
            plan.states.extend(along);
            if !is_end {
                plan.inputs.extend_from_slice(&target[Kinematics::<f64>::DIM..]);
            }
        }
        plan.states[..state.len()].copy_from_slice(state);
        // lengths of quaternions mean nothing, but a plan keeps those that it begins with
        for row in plan.states.chunks_exact_mut(state.len()) {
            own.problem().model().errors.unite(row)?;
        }
        let state = &plan.states[..state.len()];
        own.problem_mut().set_start(state)?;
        own.begin_with(&plan)?;
        let report = own.tick(state, MOST_PROGRAMS, CONVERGED);
        if report.step <= 1e-7 {
            return Ok(());
        }
        Err(Error::value("last step of a tick", report.step, "below 1e-7", "Start nearer to the reference."))
    }
}

/// The function of a tick.
struct Shared(Arc<Inner>);

impl CustomFunction for Shared {
    fn n_input(&self) -> usize {
        self.0.planned.n_state() + self.0.n_target() + TrackingWeights::DIM
    }

    fn n_output(&self) -> usize {
        self.0.planned.n_input()
    }

    fn value(&self, x: &[f64], y: &mut [f64]) {
        match self.0.solved(x) {
            None => y.fill(f64::NAN),
            Some(own) => {
                y.copy_from_slice(own.input(0));
                self.0.give_back(own);
            }
        }
    }

    fn forward(&self, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        dy.fill(f64::NAN);
        self.0.about(x, |adjoint| {
            // few outputs, many inputs: by rows
            let (mut seed, mut row) = (vec![0.0; dy.len()], vec![0.0; dx.len()]);
            for i in 0..dy.len() {
                seed[i] = 1.0;
                adjoint(&seed, &mut row);
                seed[i] = 0.0;
                dy[i] = row.iter().zip(dx).map(|(a, b)| a * b).sum();
            }
        });
    }

    fn reverse(&self, x: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
        x_bar.fill(f64::NAN);
        self.0.about(x, |adjoint| adjoint(y_bar, x_bar));
    }
}

impl ControlLaw for MpcLaw {
    fn name(&self) -> &str {
        "mpc"
    }
    fn description(&self) -> String {
        let MpcSettings { stages, stage, .. } = &self.inner.settings;
        format!("plans {stages} stages of {:.0} ms, to convergence", 1e3 * stage)
    }
    fn rate(&self) -> Option<f64> {
        self.rate
    }
    fn is_batched(&self) -> bool {
        false
    }
    fn n_target(&self) -> usize {
        self.inner.n_target()
    }
    fn write_target(&self, target: Target<'_>, time: f64, row: &mut [f64]) {
        let inner = &self.inner;
        let mut before = None;
        for (stage, row) in row.chunks_exact_mut(inner.n_instant()).enumerate() {
            let (motion, inputs) = row.split_at_mut(Kinematics::<f64>::DIM);
            let own =
                inner.flat.at(target, time + stage as f64 * inner.settings.stage, &Push::default(), before, inputs);
            before = Some(own.attitude);
            own.write(motion);
        }
    }
    fn parameters(&self) -> Vec<f64> {
        self.inner.settings.weights.flat().to_vec()
    }
    fn parameter_names(&self) -> Vec<String> {
        TrackingWeights::names().into_iter().map(|name| format!("weights.{name}")).collect()
    }
    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, _: &mut [S], commands: &mut [S]) {
        let planned = &self.inner.planned;
        let mut arguments = planned.states_of(now.state);
        arguments.extend_from_slice(now.target);
        if now.parameters.is_empty() {
            arguments.extend(self.inner.settings.weights.flat().map(S::constant));
        } else {
            arguments.extend_from_slice(now.parameters);
        }
        let mut inputs = vec![S::zero(); planned.n_input()];
        self.operation.call(&arguments, &mut inputs);
        planned.write_commands(&inputs, commands);
    }
}

#[cfg(test)]
mod tests;
