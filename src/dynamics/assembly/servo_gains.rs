//! Gains of servos and stops from the inertia that a joint feels at the rest pose.

use super::emit::UntunedModel;
use super::joint_spec::{JointSpec, STOP_DISSIPATION, STOP_RATE, Servo, Stops};
use crate::multirotor::Physics;
use crate::tree::*;
use base::error::{Error, Result};
use nalgebra::DMatrix;

/// Checks the draft, measures it, and sets what depends on inertia.
pub(super) fn tune(draft: UntunedModel) -> Result<Model> {
    let UntunedModel { mut parts, source } = draft;
    let needs = |join: &Option<JointSpec>| join.as_ref().is_some_and(needs_inertia);
    for (body, join) in parts.bodies.iter_mut().zip(&source) {
        // any inertia will do for the checks
        set(&mut body.joint, join.as_ref(), Felt { free: 1.0, held: 1.0 });
    }
    let model = Model::new(parts)?;
    if !source.iter().any(needs) {
        return Ok(model);
    }
    let inertias = felt_inertias(&model)?;
    let mut parts = model.parts().clone();
    for ((body, join), felt) in parts.bodies.iter_mut().zip(&source).zip(inertias) {
        set(&mut body.joint, join.as_ref(), felt);
    }
    Model::new(parts)
}

fn needs_inertia(join: &JointSpec) -> bool {
    matches!(join.servo, Some(Servo::Rate { .. })) || join.stops.is_some_and(|s| s.stiffness.is_none())
}

/// Drive and stops of a joint from what it feels.
fn set(joint: &mut Joint, join: Option<&JointSpec>, felt: Felt) {
    let Some(join) = join else { return };
    joint.limits = join.stops.map(|Stops { lower, upper, stiffness, dissipation }| JointLimits {
        lower,
        upper,
        stiffness: stiffness.unwrap_or(felt.free * STOP_RATE * STOP_RATE),
        dissipation: dissipation.unwrap_or(STOP_DISSIPATION),
    });
    joint.drive = join.servo.map(|servo| match servo {
        Servo::Rate { time_constant, max_torque, range } => {
            Drive { stiffness: 0.0, damping: felt.held / time_constant, max_torque, center: 0.0, range }
        }
        Servo::Position { stiffness, damping, max_torque, center, range } => {
            Drive { stiffness, damping, max_torque, center, range }
        }
    });
}

/// What a torque on one joint alone accelerates at the rest pose, kg m² or kg; 0 for other than hinges and slides.
#[derive(Clone, Copy)]
pub(super) struct Felt {
    /// All other joints free: 1/(M⁻¹)ᵢᵢ.
    pub free: f64,
    /// All other servos holding: the same of M without their rows.
    pub held: f64,
}

/// Of every joint.
pub(super) fn felt_inertias(model: &Model) -> Result<Vec<Felt>> {
    let rest = Multibody::new(model, Physics::default())?.rest_state();
    let mass = mass_matrix(model, &rest)?;
    let n = mass.nrows();
    let place = |i: usize| model.layout().bodies[i];
    let driven: Vec<usize> = (0..model.bodies().len()).filter(|i| model.bodies()[*i].joint.drive.is_some()).collect();
    let all: Vec<usize> = (0..n).collect();
    let inverse = inverse_of(model, &mass, &all)?;
    let mut list = Vec::with_capacity(model.bodies().len());
    for i in 0..model.bodies().len() {
        let at = place(i).freedom;
        let mut felt = Felt { free: 0.0, held: 0.0 };
        if place(i).n_freedom == 1 {
            felt.free = 1.0 / inverse[(at, at)];
            felt.held = felt.free;
        }
        if driven.contains(&i) && driven.len() > 1 {
            let moves = |k: &usize| *k == at || driven.iter().all(|d| place(*d).freedom != *k);
            let kept: Vec<usize> = all.iter().copied().filter(moves).collect();
            let own = kept.partition_point(|k| *k < at);
            felt.held = 1.0 / inverse_of(model, &mass, &kept)?[(own, own)];
        }
        list.push(felt);
    }
    Ok(list)
}

/// The inverse of some rows and columns of the mass matrix.
fn inverse_of(model: &Model, mass: &DMatrix<f64>, kept: &[usize]) -> Result<DMatrix<f64>> {
    let part = DMatrix::from_fn(kept.len(), kept.len(), |a, b| mass[(kept[a], kept[b])]);
    part.cholesky().map(|c| c.inverse()).ok_or_else(|| {
        let what = format!("model '{}': mass matrix at the rest pose", model.name());
        let remedy = "Give every moving part an extended mass.";
        Error::value(what, "singular", "positive definite", remedy)
    })
}
