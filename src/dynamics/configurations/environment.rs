//! What flies, and the scene it flies in, as one model: ground, gates and obstacles push back.
//!
//! A sliding gate is a tree of its own, with its frame's coordinate in the state; fixed gates and obstacles are shapes that
//! stand still in the world. Their places are numbers of the model, so that environments of a batch may differ in them
//! ([`World::set_model`](crate::dynamics::World::set_model)). The scene itself still answers distances
//! ([`Scene::distance`]).

use super::Gate;
use crate::dynamics::Vehicle;
use crate::dynamics::assembly::{Member, Placement, group, single};
use crate::dynamics::contact::ContactMaterial;
use crate::dynamics::scene::{self, Scene};
use crate::dynamics::shape::Shape;
use crate::dynamics::tree::{BodyShape, Model};
use crate::error::Result;

/// How deep a vehicle sinks that rests on four points, m: RK4 at 2 ms resolves it.
const SINK: f64 = 5e-4;

/// `members`, then the scene's sliding gates in order under their names, with all that stands still.
///
/// # Errors
/// As [`Scene::validate`] and [`group`](crate::dynamics::assembly::group()).
pub fn environment(name: impl Into<String>, members: &[Member], scene: &Scene) -> Result<Model> {
    scene.validate()?;
    let mut all = members.to_vec();
    for gate in &scene.gates {
        if let Some(slide) = gate.slide {
            all.push(Member::new(&gate.name, sliding(gate, slide).build()?.model, [0.0; 3]));
        }
    }
    let mut parts = group(name, &all)?.parts().clone();
    parts.contact.ground = scene.ground;
    for gate in scene.gates.iter().filter(|g| g.slide.is_none()) {
        let place = Placement { position: gate.position, rotation: gate.rotation };
        let frame = Gate { place, ..resized(gate) };
        parts.shapes.extend(frame.still_bars().map(|shape| still(&gate.name, shape)));
    }
    parts.shapes.extend(scene.obstacles.iter().map(|o| still(&o.name, o.shape)));
    Model::new(parts)
}

/// A vehicle in a scene, as one body of its own name: state and input are those of the vehicle in closed form, and so are its
/// physics, but for the forces of what it touches, which are as stiff as lets it rest 0.5 mm deep on four points.
///
/// # Errors
/// As [`environment`], and for a vehicle that is not valid.
pub fn vehicle_in(vehicle: &Vehicle, scene: &Scene) -> Result<Model> {
    let mut parts = single(vehicle)?.parts().clone();
    parts.contact.material = ContactMaterial::resting(vehicle.mass_properties().mass, 4, SINK);
    environment(&vehicle.name, &[Member::new("", Model::new(parts)?, [0.0; 3])], scene)
}

fn still(name: &str, shape: Shape) -> BodyShape {
    BodyShape { body: None, part: name.into(), shape, collides: true }
}

/// The scene's gate with the sizes of a configuration's.
fn resized(gate: &scene::Gate) -> Gate {
    Gate {
        half_width: gate.half_width,
        half_height: gate.half_height,
        radius: gate.radius,
        scale: gate.scale,
        ..Gate::default()
    }
}

fn sliding(gate: &scene::Gate, slide: scene::Slide) -> Gate {
    Gate {
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
mod tests {
    use super::*;
    use crate::autodiff::System;
    use crate::dynamics::assembly::{Assembly, Solid};
    use crate::dynamics::shape::Geometry;
    use crate::dynamics::tree::{Multibody, separations};
    use crate::dynamics::{Effects, Physics};

    fn scene() -> Scene {
        let gate = |name: &str, x: f64, slide| scene::Gate {
            name: name.into(),
            position: [x, 0.0, 1.5],
            slide,
            ..scene::Gate::default()
        };
        let post = Shape::new(Geometry::Capsule { radius: 0.1, length: 2.0 }).at([6.0, 0.3, 1.0]);
        Scene {
            gates: vec![gate("fixed", 2.0, None), gate("sliding", 4.0, Some(scene::Slide::default()))],
            obstacles: vec![scene::Obstacle { name: "post".into(), shape: post }],
            ..Scene::grounded()
        }
    }

    fn ball_in_scene() -> Model {
        let ball = Assembly::new("ball").part("ball", Solid::sphere(0.1).mass(0.3)).model().unwrap();
        environment("range", &[Member::new("a", ball, [0.0, 0.0, 1.5])], &scene()).unwrap()
    }

    #[test]
    fn the_models_separations_are_the_scenes_distances() {
        let (model, scene) = (ball_in_scene(), scene());
        let system = Multibody::new(&model, Physics::default()).unwrap();
        let mut placement = scene.nominal_placement();
        for (p, slide) in
            [([2.0, 0.2, 1.9], 0.0), ([4.0, 0.9, 1.3], 0.4), ([6.0, -0.2, 0.6], -0.7), ([0.0, 0.0, 0.3], 0.0)]
        {
            let mut x = system.rest_state();
            x[..3].copy_from_slice(&p);
            x[13] = slide;
            placement[6] = slide;
            let of_ball = separations(&system, &x).into_iter().filter(|s| s.shapes.0 == 0);
            let nearest = of_ball.map(|s| s.distance).fold(f64::INFINITY, f64::min);
            let wanted = scene.distance(&placement, p) - 0.1;
            assert!((nearest - wanted).abs() < 1e-12, "{p:?}: {nearest} against {wanted}");
        }
    }

    #[test]
    fn a_ball_pushes_a_sliding_gate_and_bounces_off_a_post() {
        let model = ball_in_scene();
        let effects = Effects { contact: true, ..Effects::none() };
        let system = Multibody::new(&model, Physics { effects, dt: 0.001, ..Physics::default() }).unwrap();
        let run = |position: [f64; 3], velocity: [f64; 3]| {
            let mut x = system.rest_state();
            x[..3].copy_from_slice(&position);
            x[3..6].copy_from_slice(&velocity);
            let mut next = x.clone();
            for _ in 0..300 {
                system.step(&x, &[], &[], &mut next);
                std::mem::swap(&mut x, &mut next);
            }
            x
        };
        let at_gate = run([4.0, 0.4, 1.6], [0.0, 2.0, 1.0]);
        println!("gate slid {:.3} m, {:.3} m/s; ball leaves the post", at_gate[13], at_gate[14]);
        assert!(at_gate[13] > 0.01 && at_gate[14] > 0.05, "slid {} at {} m/s", at_gate[13], at_gate[14]);
        let at_post = run([5.6, 0.3, 1.6], [3.0, 0.0, 1.0]);
        assert!(at_post[3] < -0.5, "leaves at {} m/s", at_post[3]);
    }
}
