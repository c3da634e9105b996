//! What flies, and the scene it flies in, as one model: ground, gates and obstacles push back.
//!
//! A sliding gate is a tree of its own, with its frame's coordinate in the state; fixed gates and obstacles are shapes that
//! stand still in the world. Their places are numbers of the model, so that environments of a batch may differ in them
//! ([`World::set_model`](crate::World::set_model), [`write_placement`]). The scene itself still answers distances
//! ([`Scene::distance`]).

use super::SlidingGate;
use crate::Vehicle;
use crate::assembly::{Member, Placement, group, single};
use crate::contact::ContactMaterial;
use crate::scene::{self, Element, Scene};
use crate::shape::Shape;
use crate::tree::parameters::static_parameters;
use crate::tree::{BodyShape, CABLE_PARAMETERS, Model};
use base::error::Result;

/// `members`, then the scene's sliding gates in order under their names, with all that stands still.
///
/// # Errors
/// As [`Scene::validate`] and [`group`](crate::assembly::group()).
pub fn environment(name: impl Into<String>, members: &[Member], scene: &Scene) -> Result<Model> {
    scene.validate()?;
    let mut all = members.to_vec();
    for gate in &scene.gates {
        if let Some(slide) = gate.slide {
            all.push(Member::new(&gate.name, sliding(gate, slide).build()?.model, [0.0; 3]));
        }
    }
    let mut parts = group(name, &all)?.parts().clone();
    let contact = &mut parts.contact;
    (contact.ground, contact.relief) = (scene.ground, scene.relief.clone());
    contact.ground_material = scene.material(Element::Ground);
    for (i, gate) in scene.gates.iter().enumerate() {
        let material = scene.material(Element::Gate(i));
        if gate.slide.is_some() {
            let prefix = format!("{}/", gate.name);
            let own = parts.shapes.iter_mut().filter(|s| s.part.starts_with(&prefix));
            own.for_each(|shape| shape.material = material);
            continue;
        }
        let place = Placement { position: gate.position, rotation: gate.rotation };
        let frame = SlidingGate { place, ..resized(gate) };
        parts.shapes.extend(frame.still_bars().map(|shape| still(&gate.name, shape, material)));
    }
    let obstacles = scene.obstacles.iter().enumerate();
    parts.shapes.extend(obstacles.map(|(i, o)| still(&o.name, o.shape, scene.material(Element::Obstacle(i)))));
    parts.mesh.extend(scene.mesh.iter().cloned());
    Model::new(parts)
}

/// Writes where a placement of the scene puts what stands still into numbers of the model that [`environment`] made of it
/// ([`model_parameters`](crate::tree::model_parameters)): fixed gates and obstacles. Slides are coordinates of the state. Allocates nothing.
///
/// # Panics
/// On numbers or a placement of another length, and on a model that was not made of this scene.
pub fn write_placement(model: &Model, scene: &Scene, placement: &[f64], numbers: &mut [f64]) {
    assert_eq!(placement.len(), scene.n_placement(), "numbers of a placement");
    let n_still = model.shapes().iter().filter(|s| s.body.is_none()).count();
    let fixed = scene.gates.iter().filter(|g| g.slide.is_none()).count();
    let own = 4 * fixed + scene.obstacles.len();
    assert!(n_still >= own, "{n_still} still shapes of a model for {own} of a scene");
    let first = static_parameters(model.bodies().len(), model.rotors().len(), n_still - own);
    let cables = CABLE_PARAMETERS.len() * model.cables().len();
    assert_eq!(numbers.len(), first + 3 * own + cables, "numbers of a model");
    // still shapes stand last, those of the scene last of them, in its order
    let mut still = model.shapes().iter().filter(|s| s.body.is_none()).skip(n_still - own);
    let mut at = first;
    let mut write = |shape: &BodyShape, offset: &[f64]| {
        for k in 0..3 {
            numbers[at + k] = shape.shape.position[k] + offset[k];
        }
        at += 3;
    };
    for (i, gate) in scene.gates.iter().enumerate() {
        if gate.slide.is_none() {
            let from = scene.placement_index(Element::Gate(i)).unwrap_or(0);
            still.by_ref().take(4).for_each(|bar| write(bar, &placement[from..]));
        }
    }
    for (i, shape) in still.enumerate() {
        let from = scene.placement_index(Element::Obstacle(i)).unwrap_or(0);
        write(shape, &placement[from..]);
    }
}

/// A vehicle in a scene, as one body of its own name: state and input are those of the vehicle in closed form, and so are its
/// physics, but for the forces of what it touches.
///
/// # Errors
/// As [`environment`], and for a vehicle that is not valid.
pub fn vehicle_in(vehicle: &Vehicle, scene: &Scene) -> Result<Model> {
    environment(&vehicle.name, &[Member::new("", single(vehicle)?, [0.0; 3])], scene)
}

fn still(name: &str, shape: Shape, material: Option<ContactMaterial>) -> BodyShape {
    BodyShape { body: None, part: name.into(), shape, collides: true, material }
}

/// The scene's gate with the sizes of a configuration's.
fn resized(gate: &scene::Gate) -> SlidingGate {
    SlidingGate {
        half_width: gate.half_width,
        half_height: gate.half_height,
        radius: gate.radius,
        scale: gate.scale,
        ..SlidingGate::default()
    }
}

fn sliding(gate: &scene::Gate, slide: scene::GateSlide) -> SlidingGate {
    SlidingGate {
        place: Placement { position: gate.position, rotation: gate.rotation },
        mass: slide.mass,
        // a configuration scales its range, a scene states it as it is
        range: slide.range / gate.scale,
        stiffness: slide.stiffness,
        damping: slide.damping,
        ..resized(gate)
    }
}

#[cfg(test)]
mod tests;
