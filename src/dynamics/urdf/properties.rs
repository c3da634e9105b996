//! The `<properties>` element of the gym-pybullet-drones family (cf2x, cf2p, racer).
//!
//! Its conventions, from that simulator's `BaseAviary`: thrust kf·n² and torque km·n² with n in revolutions per minute;
//! n_max = √(thrust2weight·m·g/(4 kf)); drag −(Σ Ωᵢ)·(drag_coeff_xy, drag_coeff_xy, drag_coeff_z)·v with Ω in rad/s, which
//! is the library's rotor drag per rotor; yaw moment −Q₀ + Q₁ − Q₂ + Q₃, and the opposite for the racer.

use super::bodies::{Body, hubs, total_mass};
use super::diagnose::{Lines, numbers, place};
use super::fault::{clean, fault};
use super::recognise::{rotor_links, seen_along, spacing};
use super::schema::LARGEST;
use super::{Warning, resolve};
use crate::vehicle::{GRAVITY, Rotor};
use base::error::Result;
use roxmltree::{Document, Node};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

const KNOWN: [&str; 12] = [
    "arm",
    "kf",
    "km",
    "thrust2weight",
    "max_speed_kmh",
    "gnd_eff_coeff",
    "prop_radius",
    "drag_coeff_xy",
    "drag_coeff_z",
    "dw_coeff_1",
    "dw_coeff_2",
    "dw_coeff_3",
];

/// The numbers of the element, all finite.
pub(super) struct Properties {
    values: BTreeMap<String, f64>,
    place: String,
}

/// Reads the element where there is one with at least one of `kf`, `km`, `thrust2weight`.
pub(super) fn read(document: &Document, file: &str, warnings: &mut Vec<Warning>) -> Result<Option<Properties>> {
    let Some(node) = document.root_element().children().find(|n| n.has_tag_name("properties")) else { return Ok(None) };
    let line = Lines::new(document).of(node);
    let mut values = BTreeMap::new();
    for attribute in node.attributes() {
        let name = attribute.name();
        if KNOWN.contains(&name) {
            values.insert(name.to_string(), value(file, node, name, attribute.value())?);
        } else {
            warnings.push(Warning {
                file: file.to_string(),
                line: Some(line),
                element: format!("<properties {}>", clean(name)),
                rule: "unknown attribute".into(),
                remedy: format!("It is ignored; known: {}.", KNOWN.join(", ")),
            });
        }
    }
    let about_rotors = ["kf", "km", "thrust2weight"].iter().any(|k| values.contains_key(*k));
    Ok(about_rotors.then(|| Properties { values, place: place(node) }))
}

fn value(file: &str, node: Node, name: &str, text: &str) -> Result<f64> {
    let value = numbers(file, node, name, text, 1)?.first().copied().unwrap_or_default();
    let signed = name.starts_with("dw_coeff");
    if value.abs() <= LARGEST && (signed || value >= 0.0) {
        return Ok(value);
    }
    let rule = format!("{name} is {value}, but it must lie between 0 and {LARGEST:e}");
    Err(fault(file, place(node), rule, "Check its sign and unit."))
}

impl Properties {
    fn need(&self, file: &str, name: &str) -> Result<f64> {
        match self.values.get(name) {
            Some(x) if *x > 0.0 => Ok(*x),
            Some(x) => {
                let rule = format!("{name} is {x}, but it must be > 0");
                Err(fault(file, self.place.clone(), rule, "Give the real rotor's value."))
            }
            None => {
                let remedy = format!("Add {name}=\"…\", or write a rotor file (*.rotors.toml).");
                Err(fault(file, self.place.clone(), format!("{name} is missing"), remedy))
            }
        }
    }

    fn get(&self, name: &str) -> f64 {
        self.values.get(name).copied().unwrap_or(0.0)
    }

    /// The bodies that carry the rotors.
    pub fn links(&self, file: &str, bodies: &[Body]) -> Result<Vec<usize>> {
        let links = rotor_links(bodies);
        if (1..=crate::vehicle::MAX_ROTORS).contains(&links.len()) {
            return Ok(links);
        }
        let rule = format!("it describes rotors, but {} links are named like one", links.len());
        Err(fault(
            file,
            self.place.clone(),
            rule,
            "Name the rotor links prop0_link, prop1_link, …, or write a rotor file.",
        ))
    }

    /// The rotors, with every conclusion and oddity added to `assumptions`.
    pub fn rotors(
        &self,
        file: &str,
        robot: &str,
        bodies: &[Body],
        assumptions: &mut Vec<String>,
    ) -> Result<Vec<Rotor>> {
        let links = self.links(file, bodies)?;
        let on: Vec<&Body> = links.iter().filter_map(|i| bodies.get(*i)).collect();
        let (positions, by_mass) = hubs(&on);
        if by_mass {
            assumptions.push(resolve::hubs_by_mass(&on));
        }
        let (kf, km) = (self.need(file, "kf")?, self.need(file, "km")?);
        let thrust_to_weight = self.need(file, "thrust2weight")?;
        let per_rotor = thrust_to_weight * total_mass(bodies) * GRAVITY / on.len() as f64;
        let thrust_coefficient = kf * (60.0 / TAU).powi(2);
        let max_speed = (per_rotor / thrust_coefficient).sqrt();
        let radius = self.radius(&positions, assumptions);
        let time_constant = time_constant(total_mass(bodies), assumptions);
        self.say(file, robot, km / kf, radius, &positions, assumptions);
        check_inertia(bodies, assumptions);
        let first = if robot == "racer" { -1.0 } else { 1.0 };
        let rotors = on.iter().zip(&positions).enumerate().map(|(i, (body, position))| Rotor {
            name: body.name.clone(),
            position: (*position).into(),
            axis: resolve::axis(body, assumptions).into(),
            spin: if i % 2 == 0 { first } else { -first },
            thrust_coefficient,
            moment_per_thrust: km / kf,
            max_speed,
            time_constant_up: time_constant,
            time_constant_down: time_constant,
            inertia: 0.0,
            radius,
            drag_coefficient: self.get("drag_coeff_xy"),
            axial_drag_coefficient: self.get("drag_coeff_z"),
            rolling_coefficient: 0.0,
        });
        Ok(rotors.collect())
    }

    /// Propellers that would cut each other, but not at half the size, are a diameter written as a radius.
    fn radius(&self, positions: &[nalgebra::Vector3<f64>], assumptions: &mut Vec<String>) -> f64 {
        let radius = self.get("prop_radius");
        match spacing(&seen_along(&nalgebra::Vector3::z(), positions)) {
            Some(d) if 2.0 * radius > d && radius <= d => {
                assumptions.push(format!(
                    "Odd: with prop_radius {radius} m the propellers would overlap (hubs {d:.4} m apart), so it is read as \
                     a diameter: radius {} m.",
                    radius / 2.0
                ));
                radius / 2.0
            }
            _ => radius,
        }
    }

    fn say(
        &self,
        file: &str,
        robot: &str,
        moment_per_thrust: f64,
        radius: f64,
        positions: &[nalgebra::Vector3<f64>],
        assumptions: &mut Vec<String>,
    ) {
        let flip = if robot == "racer" { ", and the racer's yaw torques are the opposite" } else { "" };
        assumptions.push(format!(
            "Rotors of {} come from <properties>, read as gym-pybullet-drones does: kf, km per (rev/min)²; Ω_max from \
             thrust2weight with g = {GRAVITY}; spins alternate, prop0 counter-clockwise{flip}.",
            clean(file)
        ));
        assumptions.push(
            "The ground-effect and downwash coefficients and max_speed_kmh are not part of a vehicle and are left out; rotor \
             inertia is taken as 0."
                .into(),
        );
        let arm = self.get("arm");
        let longest = positions.iter().map(|p| p.xy().norm()).fold(0.0, f64::max);
        if arm > 0.0 && (longest - arm).abs() > 0.05 * arm {
            assumptions.push(format!("Odd: arm is {arm} m, but a rotor is {longest:.4} m away. The position is used."));
        }
        let ratio = moment_per_thrust / radius;
        if radius > 0.0 && !(0.05..=0.6).contains(&ratio) {
            assumptions.push(format!(
                "Odd: km/kf = {moment_per_thrust:.5} m is {ratio:.2} propeller radii (0.1 to 0.4 is usual). It is used as written."
            ));
        }
    }
}

/// The file has no motor lag.
fn time_constant(mass: f64, assumptions: &mut Vec<String>) -> f64 {
    let (value, source) = if mass < 0.1 {
        (0.0555, "measured on a Crazyflie speeding up (learning-to-fly, 0.0555 s; there 0.249 s slowing down)")
    } else {
        (0.030, "of a racing quadrotor (Sun et al. 2022)")
    };
    assumptions.push(format!("The motor time constant is not in the file: {value} s both ways is assumed, {source}."));
    value
}

fn check_inertia(bodies: &[Body], assumptions: &mut Vec<String>) {
    for body in bodies.iter().filter(|b| b.mass > 0.0 && b.has_inertia()) {
        let i = &body.inertia;
        if i.xx == i.zz && i.yy == i.zz {
            assumptions.push(format!(
                "Odd: link '{}' has one moment of inertia, {} kg m², about all axes; a flat multirotor has about twice as \
                 much about z. It is used as written.",
                clean(&body.name),
                i.zz
            ));
        }
    }
}
