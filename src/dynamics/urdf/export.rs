//! A vehicle written back as URDF and rotor file; importing the pair gives the same vehicle.

use super::fault::fault;
use super::rotors::{RotorEntry, RotorFile};
use crate::shape::{Geometry, Shape};
use crate::spatial::to_euler;
use crate::vehicle::{Part, Rotor, Vehicle};
use base::error::Result;
use std::fmt::Write;

/// Writes a vehicle as (URDF text, rotor-file text).
///
/// Every part becomes a link with its axes along the base axes; a part that bears a rotor's name gets its link frame at
/// that rotor's hub. Shapes are collision geometry of the first. Hubs, axes and coefficients stand in the rotor file in full precision, so that mass, centre of
/// mass, inertia and rotors survive the round trip to 1e-12.
///
/// # Errors
/// As [`Vehicle::validate`]; also where a name holds control characters or two parts share one.
pub fn export(vehicle: &Vehicle) -> Result<(String, String)> {
    vehicle.validate()?;
    let names = vehicle.parts.iter().map(|p| p.name.as_str());
    let mut seen = std::collections::HashSet::new();
    for name in names.chain(vehicle.rotors.iter().map(|r| r.name.as_str())).chain([vehicle.name.as_str()]) {
        if name.is_empty() || name.trim() != name || name.chars().any(char::is_control) {
            let rule = format!("the name '{}' cannot stand in a URDF", super::fault::clean(name));
            return Err(fault("<export>", "vehicle", rule, "Use a name without control characters or outer blanks."));
        }
    }
    if let Some(part) = vehicle.parts.iter().find(|p| !seen.insert(p.name.as_str())) {
        let rule = format!("two parts are called '{}'", super::fault::clean(&part.name));
        return Err(fault("<export>", "vehicle", rule, "Rename one: links of a URDF have unique names."));
    }
    Ok((urdf(vehicle), rotor_file(vehicle).to_toml()?))
}

fn urdf(vehicle: &Vehicle) -> String {
    let mut text = format!("<?xml version=\"1.0\"?>\n<robot name=\"{}\">\n", escaped(&vehicle.name));
    let root = vehicle.parts.first();
    for (i, part) in vehicle.parts.iter().enumerate() {
        // The root link's frame is the base frame, whatever it is called.
        let hub = vehicle.rotors.iter().find(|r| i > 0 && r.name == part.name).map_or([0.0; 3], |r| r.position);
        let shapes = if i == 0 { vehicle.shapes.as_slice() } else { &[] };
        link(&mut text, part, hub, shapes);
        if let Some(root) = root.filter(|_| i > 0) {
            joint(&mut text, &root.name, &part.name, hub);
        }
    }
    text.push_str("</robot>\n");
    text
}

fn link(text: &mut String, part: &Part, hub: [f64; 3], shapes: &[Shape]) {
    let [x, y, z] = part.position;
    let [a, b, c] = hub;
    let i = &part.inertia;
    // Writing to a String cannot fail.
    let _ = write!(
        text,
        "  <link name=\"{}\">\n    <inertial>\n      <origin xyz=\"{:?} {:?} {:?}\"/>\n      <mass value=\"{:?}\"/>\n      \
         <inertia ixx=\"{:?}\" ixy=\"{:?}\" ixz=\"{:?}\" iyy=\"{:?}\" iyz=\"{:?}\" izz=\"{:?}\"/>\n    </inertial>\n",
        escaped(&part.name),
        x - a,
        y - b,
        z - c,
        part.mass,
        i.xx,
        i.xy,
        i.xz,
        i.yy,
        i.yz,
        i.zz
    );
    shapes.iter().for_each(|shape| collision(text, shape));
    text.push_str("  </link>\n");
}

fn collision(text: &mut String, shape: &Shape) {
    let ([x, y, z], [roll, pitch, yaw]) = (shape.position, to_euler(shape.rotation));
    let geometry = match shape.geometry {
        Geometry::Box { size: [a, b, c] } => format!("<box size=\"{a:?} {b:?} {c:?}\"/>"),
        Geometry::Sphere { radius } => format!("<sphere radius=\"{radius:?}\"/>"),
        Geometry::Capsule { radius, length } => format!("<capsule radius=\"{radius:?}\" length=\"{length:?}\"/>"),
    };
    let _ = write!(
        text,
        "    <collision>\n      <origin xyz=\"{x:?} {y:?} {z:?}\" rpy=\"{roll:?} {pitch:?} {yaw:?}\"/>\n      \
         <geometry>{geometry}</geometry>\n    </collision>\n"
    );
}

fn joint(text: &mut String, root: &str, child: &str, [x, y, z]: [f64; 3]) {
    let (root, child) = (escaped(root), escaped(child));
    let _ = write!(
        text,
        "  <joint name=\"{child}_joint\" type=\"fixed\">\n    <origin xyz=\"{x:?} {y:?} {z:?}\"/>\n    \
         <parent link=\"{root}\"/>\n    <child link=\"{child}\"/>\n  </joint>\n"
    );
}

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

pub(super) fn rotor_file(vehicle: &Vehicle) -> RotorFile {
    let link = |name: &str| vehicle.parts.iter().skip(1).find(|p| p.name == name).map(|p| p.name.clone());
    RotorFile {
        file: String::new(),
        name: Some(vehicle.name.clone()),
        source: vehicle.source.clone(),
        defaults: RotorEntry::default(),
        rotors: vehicle.rotors.iter().map(|r| entry(r, link(&r.name))).collect(),
        parts: Vec::new(),
        drag: vehicle.drag,
        gains: vehicle.published_gains,
    }
}

fn entry(rotor: &Rotor, link: Option<String>) -> RotorEntry {
    let some = |x: f64| Some(x).filter(|x| *x != 0.0);
    RotorEntry {
        name: Some(rotor.name.clone()),
        link,
        position: Some(rotor.position),
        axis: Some(rotor.axis),
        spin: Some(rotor.spin),
        thrust_coefficient: Some(rotor.thrust_coefficient),
        moment_per_thrust: Some(rotor.moment_per_thrust),
        max_speed: Some(rotor.max_speed),
        time_constant_up: Some(rotor.time_constant_up),
        time_constant_down: Some(rotor.time_constant_down),
        inertia: some(rotor.inertia),
        radius: some(rotor.radius),
        drag_coefficient: some(rotor.drag_coefficient),
        axial_drag_coefficient: some(rotor.axial_drag_coefficient),
        rolling_coefficient: some(rotor.rolling_coefficient),
        ..RotorEntry::default()
    }
}
