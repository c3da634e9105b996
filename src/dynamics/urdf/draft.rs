//! A first rotor file for a URDF that has none: what the names tell, and honest guesses for the rest.

use super::bodies::{Body, hubs, total_mass};
use super::fault::{fault, few};
use super::import::{Read, check_masses, read};
use super::options::ImportOptions;
use super::recognise::{alternating_spins, rotor_links, seen_along, spacing};
use super::{export, resolve};
use crate::vehicle::{GRAVITY, MAX_ROTORS, Vehicle};
use base::error::Result;
use nalgebra::Vector3;
use std::f64::consts::TAU;
use std::fmt::Write;

/// A rotor file to be read and corrected by a person.
#[derive(Debug, Clone, PartialEq)]
pub struct Draft {
    /// The text of `<stem>.rotors.toml`; each guess carries a comment `# assumed: …`. It reads back.
    pub toml: String,
    /// The same guesses, one sentence each.
    pub assumptions: Vec<String>,
}

impl Draft {
    /// Begins the comment behind every guess.
    pub const GUESS: &str = "# assumed";
}

/// Drafts the rotor file of a URDF text.
///
/// Rotor links are recognised by name (rotor, prop, propeller, motor), spins alternate by angle, and the coefficients
/// are those of propellers that fit between the hubs and lift 2.25 times the weight. With a `<properties>` element its
/// numbers are used. Without any rotor link four hubs are placed around the origin.
///
/// # Errors
/// As [`super::import_text`], and where more than [`MAX_ROTORS`] links look like rotors.
pub fn draft_rotors(text: &str, file_name: &str, options: &ImportOptions) -> Result<Draft> {
    let mut read = read(text, file_name, options)?;
    let links = rotor_links(&read.bodies);
    check_masses(&mut read, &links)?;
    if let Some(properties) = &read.properties {
        let rotors = properties.rotors(file_name, &read.robot, &read.bodies, &mut read.assumptions)?;
        let vehicle = Vehicle {
            name: read.name(),
            source: "the <properties> element of the URDF".into(),
            parts: Vec::new(),
            rotors,
            drag: Default::default(),
            shapes: vec![],
            published_gains: None,
        };
        let notes: String = read.assumptions.iter().map(|a| format!("{}: {a}\n", Draft::GUESS)).collect();
        return Ok(Draft { toml: notes + &export::rotor_file(&vehicle).to_toml()?, assumptions: read.assumptions });
    }
    if links.len() > MAX_ROTORS {
        let names: Vec<&str> = links.iter().filter_map(|i| read.bodies.get(*i)).map(|b| b.name.as_str()).collect();
        let rule = format!("{} links look like rotors ({}), over the limit of {MAX_ROTORS}", links.len(), few(&names));
        return Err(fault(file_name, "<robot>", rule, "Write the rotor file by hand."));
    }
    Ok(guess(&read, &links))
}

/// One drafted value with its reason.
struct Line {
    key: &'static str,
    value: f64,
    why: String,
}

fn guess(read: &Read, links: &[usize]) -> Draft {
    let mass = total_mass(&read.bodies);
    let on: Vec<&Body> = links.iter().filter_map(|i| read.bodies.get(*i)).collect();
    let mut assumptions = read.assumptions.clone();
    let (positions, from_links) = place(&on, mass, &mut assumptions);
    let seen = seen_along(&thrust(&on), &positions);
    let lines = values(mass, &seen);
    let spins = alternating_spins(&seen);
    assumptions.extend(lines.iter().map(|l| format!("{} = {:?}: {}.", l.key, l.value, l.why)));
    assumptions.push("Spins alternate around the vehicle; check them against the real propellers.".into());
    let left = spins.iter().filter(|spin| **spin > 0.0).count();
    let right = spins.len() - left;
    if left != right {
        assumptions.push(format!(
            "The spins do not cancel: {left} of {} rotors turn counter-clockwise and {right} clockwise, so that equal thrusts \
             turn the vehicle.",
            spins.len()
        ));
    }
    let mark = Draft::GUESS;
    let mut toml =
        format!("# Draft for {}: every line marked 'assumed' is a guess.\n", super::fault::clean(&read.file));
    let _ = write!(toml, "source = \"drafted from names and mass; nothing measured\"\n\n[defaults]\n");
    for line in &lines {
        let _ = writeln!(toml, "{} = {:?} {mark}: {}", line.key, line.value, line.why);
    }
    for (i, (position, spin)) in positions.iter().zip(&spins).enumerate() {
        let _ = write!(toml, "\n[[rotors]]\n");
        match on.get(i).filter(|_| from_links) {
            Some(body) => {
                let _ = writeln!(toml, "link = {} {mark}: by its name", toml::Value::from(body.name.as_str()));
            }
            None => {
                let [x, y, z]: [f64; 3] = (*position).into();
                let _ = writeln!(toml, "position = [{x:.6}, {y:.6}, {z:.6}] {mark}: no link is named like a rotor");
            }
        }
        let _ = writeln!(toml, "spin = {spin:.0} {mark}: alternating");
    }
    Draft { toml, assumptions }
}

/// The direction in which rotors push, not of unit length; up where there is none.
fn thrust(on: &[&Body]) -> Vector3<f64> {
    let sum: Vector3<f64> = on.iter().map(|body| resolve::axis(body, &mut Vec::new())).sum();
    if sum.norm() > 1e-6 { sum } else { Vector3::z() }
}

/// Hubs from the links, or four around the origin at the arm of a Hummingbird scaled by mass.
fn place(on: &[&Body], mass: f64, assumptions: &mut Vec<String>) -> (Vec<Vector3<f64>>, bool) {
    if !on.is_empty() {
        let (positions, by_mass) = hubs(on);
        if by_mass {
            assumptions.push(resolve::hubs_by_mass(on));
        }
        let names: Vec<&str> = on.iter().map(|b| b.name.as_str()).collect();
        assumptions.push(format!("{} rotors by their names: {}.", on.len(), few(&names)));
        return (positions, true);
    }
    let arm = 0.17 * (mass / 0.716).cbrt();
    let side = arm * std::f64::consts::FRAC_1_SQRT_2;
    assumptions.push(format!(
        "No link is named like a rotor: four are placed in an X with arm {arm:.3} m (a Hummingbird scaled by mass)."
    ));
    let corners = [(side, side), (-side, side), (-side, -side), (side, -side)];
    (corners.iter().map(|(x, y)| Vector3::new(*x, *y, 0.0)).collect(), false)
}

/// Propellers of C_T = 0.1 (thrust C_T ρ n² D⁴) that leave a gap of a fifth between hubs, as seen along the thrust.
fn values(mass: f64, seen: &[Vector3<f64>]) -> Vec<Line> {
    let n = seen.len().max(1) as f64;
    let gap = spacing(seen).unwrap_or(0.24 * (mass / 0.716).cbrt());
    let radius = 0.4 * gap.clamp(0.01, 10.0);
    let thrust_coefficient = 0.1 * 1.225 * (2.0 * radius).powi(4) / (TAU * TAU);
    let thrust = 2.25 * mass * GRAVITY / n;
    // Six digits: more would look measured.
    let short = |x: f64| format!("{x:.5e}").parse().unwrap_or(x);
    let line = |key, value, why: &str| Line { key, value: short(value), why: why.into() };
    vec![
        line("thrust_coefficient", thrust_coefficient, "C_T = 0.1 at this radius, air of 1.225 kg/m³"),
        line("moment_per_thrust", 0.16 * radius, "0.16 radii, as on the Hummingbird"),
        Line {
            key: "max_speed",
            value: short((thrust / thrust_coefficient).sqrt()),
            why: format!("thrust 2.25 times the weight of {mass:.4} kg"),
        },
        line("time_constant", 0.03, "30 ms, a mid-size brushless motor"),
        line("radius", radius, "four tenths of the distance between hubs"),
    ]
}
