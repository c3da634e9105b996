//! Whether a state is a fair start, nothing inside of anything, and whether a step resolves what touches.

use super::analysis::separations;
use super::model::root_of;
use super::multibody::Multibody;
use crate::contact::ContactMaterial;
use base::error::{Error, Result};

/// Refuses a state in which shapes that push each other overlap by more than what rests may sink: its force would throw them
/// apart. Without the effect `contact` nothing pushes, and every state is fair.
///
/// # Errors
/// [`Error::Value`] that names the two shapes that overlap most, and by how much.
#[doc(hidden)]
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

/// Tells whether the substep resolves the stiffness of every cable. One that it does not resolve acts no stiffer than it does.
///
/// # Errors
/// [`Error::Value`] that names the first, its stiffness, and what acts in its place.
#[doc(hidden)]
pub fn check_cables(system: &Multibody) -> Result<()> {
    let most = system.topology().resolved.cables.iter().map(|most| most.stiffness);
    let stiff = system.model().cables().iter().zip(most).find(|(cable, most)| cable.stiffness > *most);
    let Some((cable, most)) = stiff else { return Ok(()) };
    let rule = format!("at most {most:.3e} to be resolved by substeps of {} s", system.physics().grid().substep);
    let remedy = "It acts as soft as that: take more substeps, or give it that stiffness.";
    Err(Error::value(
        format!("cable '{}': stiffness", cable.name),
        format!("{:.3e} N/m", cable.stiffness),
        rule,
        remedy,
    ))
}

/// Tells whether the substep resolves the stiffness of everything that may touch. What it does not resolve acts no stiffer
/// than it does, so that nothing gains energy, and sinks in deeper.
///
/// # Errors
/// [`Error::Value`] that names the two that are softened most, their stiffness, and what acts in its place.
#[doc(hidden)]
pub fn check_contact(system: &Multibody) -> Result<()> {
    let (t, parts) = (system.topology(), system.model().parts());
    if !t.effects.contact {
        return Ok(());
    }
    let usual = parts.contact.material;
    let stiffness = |own: &Option<ContactMaterial>| own.unwrap_or(usual).stiffness;
    let on_ground = t.on_ground.iter().zip(&t.resolved.on_ground);
    let on_ground = on_ground.map(|(touch, most)| (touch.what, None, stiffness(&touch.material), most.stiffness));
    let pairs = t.pairs.iter().zip(&t.resolved.pairs);
    let pairs = pairs
        .map(|(touch, most)| (touch.what.first, Some(touch.what.second), stiffness(&touch.material), most.stiffness));
    let softest = on_ground.chain(pairs).max_by(|a, b| (a.2 / a.3).total_cmp(&(b.2 / b.3)));
    let Some((first, second, wanted, most)) = softest.filter(|(_, _, wanted, most)| wanted > most) else {
        return Ok(());
    };
    let names: Vec<&String> = parts.shapes.iter().filter(|s| s.collides).map(|s| &s.part).collect();
    let second = second.map_or_else(|| "the ground".into(), |k| format!("'{}'", names[k]));
    Err(Error::value(
        format!("contact of '{}' with {second}: stiffness", names[first]),
        format!("{wanted:.3e} N/m^1.5"),
        format!("at most {most:.3e} to be resolved by substeps of {} s", system.physics().grid().substep),
        "It acts as soft as that: take more substeps, or give it that stiffness.",
    ))
}
