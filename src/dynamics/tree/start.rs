//! Whether a state is a fair start: nothing is inside of anything.

use super::analysis::separations;
use super::model::root_of;
use super::multibody::Multibody;
use crate::error::{Error, Result};

/// Refuses a state in which shapes that push each other overlap by more than what rests may sink: its force would throw them
/// apart. Without the effect `contact` nothing pushes, and every state is fair.
///
/// # Errors
/// [`Error::Value`] that names the two shapes that overlap most, and by how much.
pub fn check_start(system: &Multibody, state: &[f64]) -> Result<()> {
    if !system.physics().effects.contact {
        return Ok(());
    }
    let model = system.model();
    let roots = root_of(model.bodies());
    let shape = |i: usize| &model.shapes()[i];
    let pushes = |first: usize, second: Option<usize>| match (shape(first).body, second.map(|j| shape(j).body)) {
        (Some(a), Some(Some(b))) => roots[a] != roots[b] || model.parts().contact.self_collision,
        _ => true,
    };
    let all = separations(system, state).into_iter().filter(|s| pushes(s.shapes.0, s.shapes.1));
    let Some(deepest) = all.min_by(|a, b| a.distance.total_cmp(&b.distance)) else { return Ok(()) };
    let sink = model.parts().contact.material.sink(model.mass().max(1e-6), 1);
    if deepest.distance >= -sink {
        return Ok(());
    }
    let (first, second) = (&shape(deepest.shapes.0).part, deepest.shapes.1.map(|j| &shape(j).part));
    let second = second.map_or_else(|| "the ground".into(), |name| format!("'{name}'"));
    Err(Error::value(
        format!("start: distance of '{first}' to {second}"),
        format!("{:.4} m", deepest.distance),
        format!("at least {:.4} m, what rests there sinks", -sink),
        "It begins inside: move the start, or what is in its way.",
    ))
}
