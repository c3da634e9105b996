//! Models under test: every vehicle as one body, every configuration, and systems that use every kind of joint in every
//! place.

use omnidrones::dynamics::assembly::{Assembly, Solid};
use omnidrones::dynamics::configurations::{self, InvertedPendulum, Payload, Platform, Transport};
use omnidrones::dynamics::tree::{Body, ContactSettings, IDENTITY, Joint, Model, ModelParts, Motion, MountedRotor};
use omnidrones::dynamics::{Drag, Inertia, Vehicle, vehicle::GRAVITY, vehicles};

/// All of them, by unique names.
pub fn all() -> Vec<Model> {
    let vehicles = vehicles::all().into_iter().map(|v| of_vehicle(&v));
    let configurations = configurations::all().unwrap();
    vehicles.chain(configurations).chain([universal_load(), every_joint(), arm(), two_trees()]).collect()
}

/// Every configuration that takes a vehicle, with every vehicle.
pub fn combined() -> Vec<Model> {
    let mut out = Vec::new();
    for drone in vehicles::all() {
        let models = [
            Payload { drone: drone.clone(), ..Payload::default() }.build().unwrap().model,
            InvertedPendulum { drone: drone.clone(), ..InvertedPendulum::default() }.build().unwrap().model,
            Platform { drone: drone.clone(), ..Platform::default() }.build().unwrap().model,
            Transport { drone: drone.clone(), ..Transport::four() }.build().unwrap().model,
        ];
        for model in models {
            let mut parts = model.parts().clone();
            parts.name = format!("{}_of_{}", parts.name, drone.name);
            out.push(Model::new(parts).unwrap());
        }
    }
    out
}

/// A vehicle as one floating body.
pub fn of_vehicle(vehicle: &Vehicle) -> Model {
    let mut assembly = Assembly::new(&vehicle.name);
    assembly.part("drone", Solid::vehicle(vehicle));
    assembly.model().unwrap()
}

fn model(name: &str, bodies: Vec<Body>, rotors: Vec<MountedRotor>) -> Model {
    let (drones, frames, shapes) = (Vec::new(), Vec::new(), Vec::new());
    let (name, gravity, contact) = (name.into(), GRAVITY, ContactSettings::default());
    Model::new(ModelParts {
        name,
        gravity,
        bodies,
        rotors,
        drones,
        frames,
        shapes,
        contact,
        mesh: vec![],
        pushed: vec![],
        cables: vec![],
    })
    .unwrap()
}

fn body(name: &str, parent: Option<usize>, joint: Joint, mass: f64) -> Body {
    let (inertia, drag) = (Inertia::zero(), Drag::default());
    Body { name: name.into(), parent, joint, mass, center_of_mass: [0.0; 3], inertia, drag }
}

/// A body with products of inertia and its centre of mass off the joint.
fn lump(name: &str, parent: Option<usize>, joint: Joint, mass: f64) -> Body {
    let inertia = Inertia { xy: 0.08 * mass * 0.01, yz: -0.05 * mass * 0.01, ..diagonal(mass) };
    Body { center_of_mass: [0.03, -0.02, -0.1], inertia, ..body(name, parent, joint, mass) }
}

fn diagonal(mass: f64) -> Inertia {
    Inertia::diagonal(0.010 * mass, 0.012 * mass, 0.008 * mass)
}

fn hinge(name: &str, axis: [f64; 3], position: [f64; 3]) -> Joint {
    Joint { position, ..Joint::new(name, Motion::Revolute(axis)) }
}

/// Of a unit quaternion that is no simple fraction of a turn.
fn turned() -> [[f64; 3]; 3] {
    let r = nalgebra::Rotation3::from_euler_angles(0.4, -0.7, 1.1);
    std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)]))
}

/// A drone with a bar on two hinges through one point, a massless body between them, and a weight on the bar's end.
fn universal_load() -> Model {
    let mut model = of_vehicle(&vehicles::by_name("hummingbird").unwrap()).parts().clone();
    let mut pitch = hinge("pitch", [0.0, 1.0, 0.0], [0.0; 3]);
    (pitch.damping, pitch.stiffness, pitch.rest) = (2e-3, 0.05, 0.2);
    let bar = Body { center_of_mass: [0.0, 0.0, -0.4], inertia: diagonal(0.1), ..body("bar", Some(1), pitch, 0.15) };
    model.bodies.push(body("cross", Some(0), hinge("roll", [1.0, 0.0, 0.0], [0.0, 0.0, -0.05]), 0.0));
    model.bodies.push(bar);
    let mut end = Joint::new("end", Motion::Ball);
    (end.position, end.damping) = ([0.0, 0.0, -0.8], 1e-3);
    model.bodies.push(lump("weight", Some(2), end, 0.1));
    model.name = "universal_load".into();
    Model::new(model).unwrap()
}

/// A floating root with every kind of joint, turned joint frames, oblique axes, and rotors on three of its bodies.
fn every_joint() -> Model {
    let (s, c) = 0.6_f64.sin_cos();
    let oblique = |name: &str, motion: Motion| Joint {
        rotation: turned(),
        position: [0.2, -0.1, 0.05],
        damping: 0.02,
        ..Joint::new(name, motion)
    };
    let mut slide = oblique("slide", Motion::Prismatic([s, 0.0, c]));
    (slide.stiffness, slide.rest) = (3.0, 0.1);
    let mut ball = oblique("ball", Motion::Ball);
    ball.stiffness = 0.2;
    let bodies = vec![
        lump("base", None, Joint::new("base", Motion::Floating), 1.2),
        lump("slider", Some(0), slide, 0.4),
        lump("swing", Some(1), ball, 0.3),
        lump("blade", Some(2), oblique("blade", Motion::Revolute([0.0, c, s])), 0.2),
        lump("side", Some(0), oblique("side", Motion::Revolute([1.0, 0.0, 0.0])), 0.3),
        lump("rail", Some(4), Joint { rotation: IDENTITY, ..oblique("rail", Motion::Prismatic([0.0, 1.0, 0.0])) }, 0.2),
        lump("bell", Some(5), hinge("bell", [0.0, 0.0, 1.0], [0.0; 3]), 0.1),
    ];
    let mut rotors = Vec::new();
    for (carrier, vehicle) in [(0, "hummingbird"), (3, "omav"), (6, "hummingbird")] {
        for rotor in &vehicles::by_name(vehicle).unwrap().rotors[..2] {
            let mut rotor = rotor.clone();
            rotor.name = format!("{carrier}_{}", rotor.name);
            rotors.push(MountedRotor { body: carrier, rotor });
        }
    }
    model("every_joint", bodies, rotors)
}

/// Six bodies one after the other on the world, the first on a slide.
fn arm() -> Model {
    let mut bodies = Vec::new();
    let axes = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]];
    for i in 0..6 {
        let name = format!("link_{i}");
        let axis = axes[i % 3];
        let motion = if i == 0 { Motion::Prismatic(axis) } else { Motion::Revolute(axis) };
        let joint = Joint { position: [0.3, 0.0, 0.1], damping: 0.01, rotation: turned(), ..Joint::new(&name, motion) };
        bodies.push(lump(&name, i.checked_sub(1), joint, 1.0 / (1.0 + i as f64)));
    }
    model("arm", bodies, Vec::new())
}

/// A drone with a swinging load beside a ball pendulum on the world, and a second drone.
fn two_trees() -> Model {
    let mut parts = universal_load().parts().clone();
    let n = parts.bodies.len();
    parts.bodies.push(lump("bob", None, Joint { position: [0.0, 0.0, 3.0], ..Joint::new("bob", Motion::Ball) }, 0.5));
    let other = of_vehicle(&vehicles::by_name("firefly").unwrap()).parts().clone();
    for (mut body, joint) in other.bodies.into_iter().zip(["other"]) {
        (body.name, body.joint.name) = (joint.into(), joint.into());
        parts.bodies.push(body);
    }
    for mut mounted in other.rotors {
        mounted.body = n + 1;
        mounted.rotor.name = format!("other_{}", mounted.rotor.name);
        parts.rotors.push(mounted);
    }
    parts.name = "two_trees".into();
    Model::new(parts).unwrap()
}
