//! An optimal control problem: what is recorded, and the numbers of its stages.

use super::stage_model::StageModel;
use super::stage_qp::{SoftBound, check_bounds, one_each};
use base::error::{Error, Result, finite};
use std::sync::Arc;

/// min Σₖ ℓ(xₖ, uₖ, pₖ) + ℓ_N(x_N, p_N) with xₖ₊₁ = f(xₖ, uₖ, pₖ), x₀ given, lower ≤ u ≤ upper, and the conditions of the cost.
#[derive(Debug, Clone)]
pub struct OptimalProblem {
    model: Arc<StageModel>,
    stages: usize,
    start: Vec<f64>,
    parameters: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    soft: Vec<SoftBound>,
}

/// States and inputs of all stages.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OptimalTrajectory {
    /// Row-major `[N + 1, n_state]`.
    pub states: Vec<f64>,
    /// Row-major `[N, n_input]`.
    pub inputs: Vec<f64>,
}

impl OptimalTrajectory {
    /// Takes the numbers of another into its own memory.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.states.clone_from(&other.states);
        self.inputs.clone_from(&other.inputs);
    }
}

/// Most stages of a problem.
pub const MAX_STAGES: usize = 100_000;

impl OptimalProblem {
    /// Of N stages from a start, `[n_state]`; parameters are zero and inputs free until they are said.
    ///
    /// # Errors
    /// [`Error::Value`] for a start of another length or that is not finite, or no stages; [`Error::Limit`] above [`MAX_STAGES`].
    pub fn new(model: Arc<StageModel>, stages: usize, start: &[f64]) -> Result<Self> {
        if stages == 0 {
            let remedy = "Give at least one stage; 20 of 50 ms are usual.";
            return Err(Error::value("stages of the horizon", 0, "≥ 1", remedy));
        }
        if stages > MAX_STAGES {
            return Err(Error::limit("stages of the horizon", stages, MAX_STAGES, "Take longer stages."));
        }
        let (m, p) = (model.n_input(), model.n_parameter());
        let mut own = Self {
            start: Vec::new(),
            parameters: vec![0.0; (stages + 1) * p],
            lower: vec![f64::NEG_INFINITY; stages * m],
            upper: vec![f64::INFINITY; stages * m],
            soft: Vec::new(),
            model,
            stages,
        };
        own.set_start(start)?;
        Ok(own)
    }

    /// What is recorded.
    pub fn model(&self) -> &Arc<StageModel> {
        &self.model
    }

    /// N.
    pub fn n_stage(&self) -> usize {
        self.stages
    }

    /// x₀.
    pub fn start(&self) -> &[f64] {
        &self.start
    }

    /// Another start, `[n_state]`; its quaternions are made unit ones.
    ///
    /// # Errors
    /// [`Error::Value`] for another length, a number that is not finite, or a quaternion of no length.
    pub fn set_start(&mut self, start: &[f64]) -> Result<()> {
        length("state of the start", start.len(), self.model.n_state())?;
        finite("start", start)?;
        let mut own = start.to_vec();
        self.model.errors.unite(&mut own)?;
        self.start = own;
        Ok(())
    }

    /// Parameters of a stage, 0 to N: θ of the system, then those of the cost, `[n_parameter]`.
    ///
    /// # Errors
    /// [`Error::Value`] for another length, no such stage, or a number that is not finite.
    pub fn set_parameters(&mut self, stage: usize, parameters: &[f64]) -> Result<()> {
        let p = self.model.n_parameter();
        self.within(stage, self.stages)?;
        length("parameters of a stage", parameters.len(), p)?;
        finite("parameters of a stage", parameters)?;
        self.parameters[stage * p..(stage + 1) * p].copy_from_slice(parameters);
        Ok(())
    }

    /// Parameters of a stage.
    ///
    /// # Panics
    /// For a stage beyond N.
    pub fn parameters(&self, stage: usize) -> &[f64] {
        let p = self.model.n_parameter();
        &self.parameters[stage * p..(stage + 1) * p]
    }

    /// The same bounds of the inputs in every stage, `[n_input]`; ±∞ for none.
    ///
    /// # Errors
    /// As [`set_bounds_of`](Self::set_bounds_of).
    pub fn set_bounds(&mut self, lower: &[f64], upper: &[f64]) -> Result<()> {
        (0..self.stages).try_for_each(|stage| self.set_bounds_of(stage, lower, upper))
    }

    /// Bounds of the inputs of a stage.
    ///
    /// # Errors
    /// [`Error::Value`] for other lengths, no such stage, NaN, or a lower bound above its upper one.
    pub fn set_bounds_of(&mut self, stage: usize, lower: &[f64], upper: &[f64]) -> Result<()> {
        let m = self.model.n_input();
        self.within(stage, self.stages - 1)?;
        length("lower bounds", lower.len(), m)?;
        length("upper bounds", upper.len(), m)?;
        check_bounds(lower, upper)?;
        self.lower[stage * m..(stage + 1) * m].copy_from_slice(lower);
        self.upper[stage * m..(stage + 1) * m].copy_from_slice(upper);
        Ok(())
    }

    /// Bounds of the inputs of a stage.
    ///
    /// # Panics
    /// For a stage beyond N − 1.
    pub fn bounds(&self, stage: usize) -> (&[f64], &[f64]) {
        let m = self.model.n_input();
        let own = stage * m..(stage + 1) * m;
        (&self.lower[own.clone()], &self.upper[own])
    }

    /// Soft bounds of states behind every stage, by their numbers in the state. A quaternion has none: bound its angle by a condition of the
    /// cost.
    ///
    /// # Errors
    /// [`Error::Value`] for no such state, a number of a quaternion, a lower bound above its upper one, or a weight that is negative or not
    /// finite.
    pub fn set_soft_bounds(&mut self, bounds: &[SoftBound]) -> Result<()> {
        let errors = &self.model.errors;
        one_each(bounds)?;
        for bound in bounds {
            let n = self.model.n_state();
            if bound.state >= n {
                let rule = format!("0 to {}", n - 1);
                return Err(Error::value("state of a soft bound", bound.state, rule, "Number the states from 0."));
            }
            if (bound.state.saturating_sub(3)..=bound.state).any(|at| errors.turns_at(at)) {
                let remedy = "Bound the attitude by Terms::at_most_zero.";
                return Err(Error::value("state of a soft bound", bound.state, "not of a quaternion", remedy));
            }
            check_bounds(&[bound.lower], &[bound.upper])?;
            if !(bound.weight >= 0.0 && bound.weight.is_finite()) {
                let remedy = "Leave the bound out where it is to cost nothing.";
                return Err(Error::value("weight of a soft bound", bound.weight, "≥ 0 and finite", remedy));
            }
        }
        self.soft = bounds.to_vec();
        Ok(())
    }

    /// Soft bounds of states.
    pub fn soft_bounds(&self) -> &[SoftBound] {
        &self.soft
    }

    fn within(&self, stage: usize, last: usize) -> Result<()> {
        if stage <= last {
            return Ok(());
        }
        Err(Error::value("stage", stage, format!("0 to {last}"), "Number the stages from 0."))
    }
}

/// Refuses another length.
pub(super) fn length(what: &str, own: usize, wanted: usize) -> Result<()> {
    if own == wanted {
        return Ok(());
    }
    Err(Error::value(format!("length of {what}"), own, wanted.to_string(), "Give as many numbers as the model has."))
}
