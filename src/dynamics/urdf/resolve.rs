//! Rotor entries placed on the bodies: where the hub is, which way it pushes, and that every value is there.

use super::bodies::{Body, hubs};
use super::fault::{clean, fault};
use super::rotors::{RotorEntry, RotorFile};
use super::schema::LARGEST;
use crate::vehicle::Rotor;
use base::error::{Result, suggestion};
use nalgebra::Vector3;
use std::collections::HashSet;

/// Index of the body that each entry names, in the order of the entries.
pub(super) fn links(file: &RotorFile, bodies: &[Body]) -> Result<Vec<Option<usize>>> {
    let mut taken = HashSet::new();
    let mut found = Vec::with_capacity(file.rotors.len());
    for (i, entry) in file.rotors.iter().enumerate() {
        let joint = |b: &Body| b.joint.as_ref().map(|j| j.name.clone());
        let index = match (&entry.link, &entry.joint) {
            (Some(link), _) => Some(look_up(file, i, "link", link, bodies, |b| Some(b.name.clone()))?),
            (None, Some(name)) => Some(look_up(file, i, "joint", name, bodies, joint)?),
            (None, None) => None,
        };
        if let Some(index) = index
            && !taken.insert(index)
        {
            let rule = "another rotor is on the same link";
            return Err(fault(&file.file, entry.place(i), rule, "Give each rotor its own link, or a position."));
        }
        found.push(index);
    }
    Ok(found)
}

fn look_up(
    file: &RotorFile,
    index: usize,
    kind: &str,
    name: &str,
    bodies: &[Body],
    name_of: impl Fn(&Body) -> Option<String>,
) -> Result<usize> {
    if let Some(found) = bodies.iter().position(|b| name_of(b).is_some_and(|n| n == name)) {
        return Ok(found);
    }
    let known: Vec<String> = bodies.iter().filter_map(&name_of).collect();
    let place = file.rotors.get(index).map_or_else(String::new, |r| r.place(index));
    let rule = format!("the URDF has no {kind} '{}'{}", clean(name), clean(&suggestion(name, &known)));
    let listed: Vec<&str> = known.iter().map(String::as_str).take(8).collect();
    Err(fault(
        &file.file,
        place,
        rule,
        format!("It has: {}.", listed.iter().map(|n| clean(n)).collect::<Vec<_>>().join(", ")),
    ))
}

/// The rotors of a vehicle from its rotor file. What had to be concluded is added to `assumptions`.
pub(super) fn rotors(file: &RotorFile, bodies: &[Body], assumptions: &mut Vec<String>) -> Result<Vec<Rotor>> {
    let links = links(file, bodies)?;
    let on: Vec<&Body> = links.iter().flatten().filter_map(|i| bodies.get(*i)).collect();
    let (positions, by_mass) = hubs(&on);
    let needed = file.rotors.iter().zip(&links).any(|(e, link)| link.is_some() && e.position.is_none());
    if by_mass && needed {
        assumptions.push(hubs_by_mass(&on));
    }
    let mut positions = positions.into_iter();
    let mut names = HashSet::new();
    let mut rotors = Vec::with_capacity(links.len());
    for (i, (entry, link)) in file.rotors.iter().zip(&links).enumerate() {
        let body = link.and_then(|index| bodies.get(index));
        let hub = body.and_then(|_| positions.next());
        let place = Place { file: &file.file, place: entry.place(i) };
        let rotor = Values { entry, defaults: &file.defaults, place }.rotor(i, body, hub, assumptions)?;
        if !names.insert(rotor.name.clone()) {
            let rule = format!("a second rotor is called '{}'", clean(&rotor.name));
            return Err(fault(&file.file, entry.place(i), rule, "Rename one."));
        }
        rotors.push(rotor);
    }
    Ok(rotors)
}

/// What is said where rotor positions were taken from `<inertial><origin>`.
pub(super) fn hubs_by_mass(on: &[&Body]) -> String {
    let names: Vec<&str> = on.iter().map(|b| b.name.as_str()).collect();
    format!(
        "The frames of the rotor links {} all lie at one point: their <inertial><origin> is taken as the rotor's position.",
        super::fault::few(&names)
    )
}

/// Thrust direction of a rotor link in the base frame: a moving joint's axis, turned upward; else the link's z.
pub(super) fn axis(body: &Body, assumptions: &mut Vec<String>) -> Vector3<f64> {
    let up = body.rotation * Vector3::z();
    let moving = body.joint.as_ref().filter(|j| !j.fixed && matches!(j.kind.as_str(), "revolute" | "continuous"));
    let Some(joint) = moving else { return up };
    let length = joint.axis.norm();
    let axis = if length > 1e-9 { joint.axis / length } else { up };
    if axis.z < -1e-9 {
        assumptions
            .push(format!("The axis of joint '{}' points down: thrust is taken against it.", clean(&joint.name)));
        return -axis;
    }
    axis
}

struct Place<'a> {
    file: &'a str,
    place: String,
}

/// One entry over the defaults.
struct Values<'a> {
    entry: &'a RotorEntry,
    defaults: &'a RotorEntry,
    place: Place<'a>,
}

type Field = fn(&RotorEntry) -> Option<f64>;

impl Values<'_> {
    fn rotor(
        &self,
        index: usize,
        body: Option<&Body>,
        hub: Option<Vector3<f64>>,
        assumptions: &mut Vec<String>,
    ) -> Result<Rotor> {
        let entry = self.entry;
        let name =
            entry.name.clone().or_else(|| body.map(|b| b.name.clone())).unwrap_or_else(|| format!("rotor_{index}"));
        let position = match (entry.position, hub) {
            (Some(position), _) => position,
            (None, Some(hub)) => hub.into(),
            (None, None) => return Err(self.missing("link, joint or position", "Say where the rotor is.")),
        };
        let axis = match (entry.axis.or(self.defaults.axis), body) {
            (Some(axis), _) => self.unit(axis)?,
            (None, Some(body)) => axis(body, assumptions).into(),
            (None, None) => [0.0, 0.0, 1.0],
        };
        let thrust_coefficient = self.need("thrust_coefficient", |e| e.thrust_coefficient, "Give k_f in N s²/rad².")?;
        self.positive("thrust_coefficient", thrust_coefficient)?;
        let (up, down) = (
            |e: &RotorEntry| e.time_constant_up.or(e.time_constant),
            |e: &RotorEntry| e.time_constant_down.or(e.time_constant),
        );
        Ok(Rotor {
            name,
            position,
            axis,
            spin: self.need("spin", |e| e.spin, "Give +1 (counter-clockwise seen from +axis) or -1.")?,
            thrust_coefficient,
            moment_per_thrust: self.moment_per_thrust(thrust_coefficient)?,
            max_speed: self.max_speed(thrust_coefficient)?,
            time_constant_up: self.need("time_constant_up", up, "Give time_constant in seconds.")?,
            time_constant_down: self.need("time_constant_down", down, "Give time_constant in seconds.")?,
            inertia: self.maybe("inertia", |e| e.inertia)?.unwrap_or(0.0),
            radius: self.maybe("radius", |e| e.radius)?.unwrap_or(0.0),
            drag_coefficient: self.maybe("drag_coefficient", |e| e.drag_coefficient)?.unwrap_or(0.0),
            axial_drag_coefficient: self.maybe("axial_drag_coefficient", |e| e.axial_drag_coefficient)?.unwrap_or(0.0),
            rolling_coefficient: self.maybe("rolling_coefficient", |e| e.rolling_coefficient)?.unwrap_or(0.0),
        })
    }

    /// The entry's value, else the default's; finite and of a size that occurs.
    fn maybe(&self, name: &str, field: Field) -> Result<Option<f64>> {
        match field(self.entry).or_else(|| field(self.defaults)) {
            Some(x) if !x.is_finite() || x.abs() > LARGEST => Err(fault(
                self.place.file,
                self.place.place.clone(),
                format!("{name} is {x}, but it must be finite and at most {LARGEST:e}"),
                "Write a finite number in SI units.",
            )),
            value => Ok(value),
        }
    }

    fn need(&self, name: &str, field: Field, remedy: &str) -> Result<f64> {
        self.maybe(name, field)?.ok_or_else(|| self.missing(name, &format!("{remedy} [defaults] serves all rotors.")))
    }

    fn missing(&self, name: &str, remedy: &str) -> base::error::Error {
        fault(self.place.file, self.place.place.clone(), format!("{name} is missing"), remedy)
    }

    fn positive(&self, name: &str, value: f64) -> Result<()> {
        if value > 0.0 {
            return Ok(());
        }
        let rule = format!("{name} is {value}, but it must be > 0");
        Err(fault(self.place.file, self.place.place.clone(), rule, "Give the real rotor's value in SI units."))
    }

    fn unit(&self, axis: [f64; 3]) -> Result<[f64; 3]> {
        let vector = Vector3::from(axis);
        let length = vector.norm();
        if length > 1e-9 && length < LARGEST {
            // A unit vector keeps its bits, so that an export reads back equal.
            return Ok(if (length - 1.0).abs() < 1e-12 { axis } else { (vector / length).into() });
        }
        let rule = format!("axis {axis:?} has no direction");
        Err(fault(self.place.file, self.place.place.clone(), rule, "Give it a length: [0, 0, 1] is up."))
    }

    /// The entry's own key wins over the other key in `[defaults]`.
    fn moment_per_thrust(&self, thrust_coefficient: f64) -> Result<f64> {
        let own = self.entry.moment_per_thrust.is_some();
        match self.maybe("torque_coefficient", |e| e.torque_coefficient)? {
            Some(torque)
                if self.entry.torque_coefficient.is_some() || !own && self.defaults.moment_per_thrust.is_none() =>
            {
                Ok(torque / thrust_coefficient)
            }
            _ => self.need("moment_per_thrust", |e| e.moment_per_thrust, "Give κ = k_m/k_f in metres."),
        }
    }

    fn max_speed(&self, thrust_coefficient: f64) -> Result<f64> {
        let own = self.entry.max_speed.is_some();
        match self.maybe("max_thrust", |e| e.max_thrust)? {
            Some(thrust) if self.entry.max_thrust.is_some() || !own && self.defaults.max_speed.is_none() => {
                self.positive("max_thrust", thrust)?;
                Ok((thrust / thrust_coefficient).sqrt())
            }
            _ => self.need("max_speed", |e| e.max_speed, "Give Ω_max in rad/s, or max_thrust in N."),
        }
    }
}
