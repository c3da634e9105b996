//! Drones that carry something together: each holds its own place in the formation under its own cascade.
//!
//! Each drone sees only itself: its place is where it stands at rest, moved and turned with the reference; its mass is
//! its share of the whole. What hangs between them follows through passive joints. With a single drone this is the
//! plain cascade, fed with the mass of all it carries.

use super::cascade::{Cascade, Rates};
use super::kinematics::Kinematics;
use super::pilot::{Command, Pilot};
use super::reference::{Reference, Sample};
use crate::autodiff::jet::Jet;
use crate::dynamics::spatial::{from_matrix, mat_vec, to_euler, transpose};
use crate::dynamics::tree::{Model, Multibody, body_poses};
use crate::dynamics::{Gains, Inertia, Part, Vehicle};
use crate::error::{Error, Result};

/// One cascade per drone of a model.
#[derive(Debug, Clone)]
pub struct Formation {
    system: Multibody,
    members: Vec<Member>,
}

#[derive(Debug, Clone)]
struct Member {
    body: usize,
    /// Its rotors' actions in the input.
    actions: Vec<usize>,
    cascade: Cascade,
    /// Where it stands at rest, from the root, m.
    place: [f64; 3],
    /// Its yaw at rest from the root's, rad.
    yaw: f64,
}

impl Formation {
    /// For a model whose drones have all their rotors on one body each. Without `gains`, those derived from each drone.
    ///
    /// # Errors
    /// [`Error::Value`] for a model without drones, a drone that is no vehicle of its own, or rates that do not divide
    /// 1/dt.
    pub fn new(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        let model = system.model();
        let poses = body_poses(system, &system.rest_state());
        let root = poses[0];
        let share = model.mass() / model.drones().len().max(1) as f64;
        let member = |number: usize| {
            let drone = &model.drones()[number];
            let vehicle = carrier(model, number)?;
            let gains = gains.copied().unwrap_or_else(|| vehicle.derived_gains());
            let mut cascade = Cascade::new(&vehicle, &gains, rates, system.physics().dt)?;
            cascade.model.body.mass = share;
            cascade.reset();
            let pose = &poses[drone.body];
            let offset = [0, 1, 2].map(|k| pose.position[k] - root.position[k]);
            let yaw = |rotation| to_euler(from_matrix(rotation))[2];
            Ok(Member {
                body: drone.body,
                actions: drone.rotors.iter().map(|r| system.layout().rotor_action[*r]).collect(),
                cascade,
                place: mat_vec(transpose(root.rotation), offset),
                yaw: yaw(pose.rotation) - yaw(root.rotation),
            })
        };
        let members = (0..model.drones().len()).map(member).collect::<Result<Vec<_>>>()?;
        if members.is_empty() {
            let what = format!("model '{}': number of drones", model.name());
            return Err(Error::value(what, 0, "≥ 1 for a formation", "Give it a vehicle."));
        }
        Ok(Self { system: system.clone(), members })
    }
}

impl Pilot for Formation {
    fn name(&self) -> &'static str {
        if self.members.len() == 1 { "cascade" } else { "formation" }
    }

    fn description(&self) -> String {
        match self.members.len() {
            1 => "of the drone, fed with the whole mass".into(),
            n => format!("{n} cascades, each holds its own place and carries its share"),
        }
    }

    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        root(&self.system, state)
    }

    fn command(&mut self, moment: Command<'_>, input: &mut [f64]) {
        let poses = body_poses(&self.system, moment.state);
        for member in &mut self.members {
            let pose = &poses[member.body];
            let own = Kinematics {
                position: pose.position,
                velocity: pose.velocity,
                attitude: from_matrix(pose.rotation),
                angular_velocity: mat_vec(transpose(pose.rotation), pose.angular_velocity),
            };
            let wanted = place(moment.reference, moment.time, member.place, member.yaw);
            let actions = member.cascade.position(&own, &wanted);
            for (at, action) in member.actions.iter().zip(actions) {
                input[*at] = action;
            }
        }
    }
}

/// Where a point fixed to the reference's frame should be: p(t) + Rz(ψ(t)) o, with all derivatives.
fn place(reference: &Reference, time: f64, offset: [f64; 3], yaw: f64) -> Sample<f64> {
    let t = Jet::<f64, 5>::variable(time);
    let (p, heading) = (reference.position(t), reference.yaw(t));
    let (s, c) = crate::autodiff::Scalar::sin_cos(heading);
    let constant = |v: f64| <Jet<f64, 5> as crate::autodiff::Scalar>::constant(v);
    let [x, y, z] = offset.map(constant);
    let moved = [p[0] + c * x - s * y, p[1] + s * x + c * y, p[2] + z];
    Sample::from_series(moved, heading + constant(yaw))
}

/// The root of a model as a controller sees it.
pub(super) fn root(system: &Multibody, state: &[f64]) -> Kinematics<f64> {
    Kinematics::read(&state[system.layout().bodies[0].position..])
}

/// The body of a drone with its rotors as a vehicle of its own: what its cascade believes to fly.
///
/// # Errors
/// [`Error::Value`] where the drone has rotors on other bodies.
pub fn carrier(model: &Model, number: usize) -> Result<Vehicle> {
    let drone = &model.drones()[number];
    let body = &model.bodies()[drone.body];
    let away = drone.rotors.iter().find(|r| model.rotors()[**r].body != drone.body);
    if let Some(rotor) = away {
        return Err(Error::value(
            format!("drone '{}': rotor '{}'", drone.name, model.rotors()[*rotor].rotor.name),
            "on another body",
            "on the drone's own body",
            "Steer it as one rigid vehicle: controllers::Frozen.",
        ));
    }
    let inertia = Inertia { ..body.inertia };
    Ok(Vehicle {
        name: drone.name.clone(),
        source: format!("model '{}'", model.name()),
        parts: vec![Part::new(&body.name, body.mass, body.center_of_mass, inertia)],
        rotors: drone.rotors.iter().map(|r| model.rotors()[*r].rotor.clone()).collect(),
        drag: body.drag,
        shapes: Vec::new(),
        published_gains: None,
    })
}
