//! Gains of servos and stops from the inertia that a joint feels at the rest pose.

use super::emit::Draft;
use super::join::{Join, STOP_DISSIPATION, STOP_RATE, Servo, Stops};
use crate::dynamics::multirotor::Physics;
use crate::dynamics::tree::*;
use crate::error::{Error, Result};

/// Checks the draft, measures it, and sets what depends on inertia.
pub(super) fn tune(draft: Draft) -> Result<Model> {
    let Draft { mut parts, source } = draft;
    let needs = |join: &Option<Join>| join.as_ref().is_some_and(needs_inertia);
    for (body, join) in parts.bodies.iter_mut().zip(&source) {
        // any inertia will do for the checks
        set(&mut body.joint, join.as_ref(), 1.0);
    }
    let model = Model::new(parts)?;
    if !source.iter().any(needs) {
        return Ok(model);
    }
    let inertias = felt_inertias(&model)?;
    let mut parts = model.parts().clone();
    for ((body, join), inertia) in parts.bodies.iter_mut().zip(&source).zip(inertias) {
        set(&mut body.joint, join.as_ref(), inertia);
    }
    Model::new(parts)
}

fn needs_inertia(join: &Join) -> bool {
    matches!(join.servo, Some(Servo::Rate { .. })) || join.stops.is_some_and(|s| s.stiffness.is_none())
}

/// Drive and stops of a joint that feels `inertia`, kg m² or kg.
fn set(joint: &mut Joint, join: Option<&Join>, inertia: f64) {
    let Some(join) = join else { return };
    joint.limits = join.stops.map(|Stops { lower, upper, stiffness, dissipation }| JointLimits {
        lower,
        upper,
        stiffness: stiffness.unwrap_or(inertia * STOP_RATE * STOP_RATE),
        dissipation: dissipation.unwrap_or(STOP_DISSIPATION),
    });
    joint.drive = join.servo.map(|servo| match servo {
        Servo::Rate { time_constant, max_torque, range } => {
            Drive { stiffness: 0.0, damping: inertia / time_constant, max_torque, center: 0.0, range }
        }
        Servo::Position { stiffness, damping, max_torque, center, range } => {
            Drive { stiffness, damping, max_torque, center, range }
        }
    });
}

/// 1/(M⁻¹)ᵢᵢ of every hinge and slide at the rest pose, 0 for other joints: what a torque on that joint alone
/// accelerates, all other joints free.
pub(super) fn felt_inertias(model: &Model) -> Result<Vec<f64>> {
    let rest = Multibody::new(model, Physics::default())?.rest_state();
    let mass = mass_matrix(model, &rest)?;
    let inverse = mass.cholesky().map(|c| c.inverse()).ok_or_else(|| {
        let what = format!("model '{}': mass matrix at the rest pose", model.name());
        let remedy = "Give every moving part an extended mass.";
        Error::value(what, "singular", "positive definite", remedy)
    })?;
    let place = |i: usize| model.layout().bodies[i];
    let felt =
        |i: usize| if place(i).n_freedom == 1 { 1.0 / inverse[(place(i).freedom, place(i).freedom)] } else { 0.0 };
    Ok((0..model.bodies().len()).map(felt).collect())
}
