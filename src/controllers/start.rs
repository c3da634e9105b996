//! Where flights and drops begin.

use super::controller::Controller;
use super::reference::Reference;
use base::error::{Error, Result};
use dynamics::spatial::{from_euler, from_matrix, multiply, rotate};
use dynamics::tree::{Model, Motion, Multibody, body_poses};
use dynamics::{Plant, contact, shape};
use rng::{Purpose, Stream};

/// The state in which the tracked point starts on the reference, at rest, in the attitude of hover turned to the reference's yaw, with
/// all joints at rest and rotors that carry the weight.
///
/// # Errors
/// As [`Plant::hover_state`].
pub fn start_on(plant: &Plant, controller: &dyn Controller, reference: &Reference) -> Result<Vec<f64>> {
    let (mut state, root) = (plant.hover_state()?, plant.roots()[0]);
    let (own, wanted) = (controller.tracked(&state), reference.sample(0.0));
    let (s, c) = (0.5 * wanted.yaw).sin_cos();
    let turn = [c, 0.0, 0.0, s];
    let hover = [6, 7, 8, 9].map(|k| state[root + k]);
    state[root + 6..root + 10].copy_from_slice(&multiply(turn, hover));
    // the root lies behind the tracked point, turned with it
    let offset = rotate(turn, [0, 1, 2].map(|k| state[root + k] - own.position[k]));
    for k in 0..3 {
        state[root + k] = wanted.position[k] + offset[k];
    }
    Ok(state)
}

/// A drop: level at rest with its lowest collision point `height` above the ground, joints disturbed a little by `seed`
/// so that nothing stands on an edge for ever.
///
/// # Errors
/// [`Error::Value`] for a model that is fixed to the world, or without shapes that touch the ground.
pub fn start_above(system: &Multibody, height: f64, seed: u64) -> Result<Vec<f64>> {
    let model = system.model();
    free(model)?;
    let layout = system.layout();
    let mut state = system.rest_state();
    let mut stream = Stream::new(seed, 0, 0, Purpose::RESET);
    let mut small = || 0.02 * (2.0 * stream.uniform(0.0, 1.0) - 1.0);
    let root = layout.bodies[0].position;
    let turn = from_euler(small(), small(), 0.0);
    state[root + 6..root + 10].copy_from_slice(&turn);
    for (i, body) in model.bodies().iter().enumerate() {
        if matches!(body.joint.motion, Motion::Revolute(_)) {
            state[layout.bodies[i].position] += small();
        }
    }
    let ground = model.parts().contact.ground.unwrap_or(0.0);
    let Some(gap) = clearance(system, &state) else {
        let what = format!("model '{}': shapes that touch", model.name());
        return Err(Error::value(what, 0, "≥ 1 to land on the ground", "Give its parts shapes."));
    };
    state[root + 2] += ground + height - gap;
    Ok(state)
}

/// Least distance of any colliding shape to the ground, m; `None` without such shapes.
pub fn clearance(system: &Multibody, state: &[f64]) -> Option<f64> {
    let (model, poses) = (system.model(), body_poses(system, state));
    let height = model.parts().contact.ground.unwrap_or(0.0);
    let own = model.shapes().iter().filter(|s| s.collides);
    let gaps = own.filter_map(|s| {
        let carrier = &poses[s.body?];
        let attitude = from_matrix(carrier.rotation);
        let pose = s.shape.pose(&shape::Pose { position: carrier.position, attitude });
        Some(match &model.parts().contact.relief {
            None => contact::plane_distance(&s.shape.geometry, &pose, height),
            Some(relief) => contact::ground_distance(&s.shape.geometry, &pose, height, relief),
        })
    });
    gaps.min_by(f64::total_cmp)
}

/// Refuses models that cannot move as one whole.
pub(super) fn free(model: &Model) -> Result<()> {
    let n_tree = model.layout().trees.len();
    if n_tree != 1 {
        let what = format!("model '{}': number of trees", model.name());
        return Err(Error::value(what, n_tree, "1 to be flown or dropped", "Give each tree a controller of its own."));
    }
    if model.bodies()[0].joint.motion == Motion::Floating {
        return Ok(());
    }
    let what = format!("model '{}': root '{}'", model.name(), model.bodies()[0].name);
    Err(Error::value(what, "fixed to the world", "free to move", "It can be shown, not flown or dropped."))
}
