//! Drones that carry something together: each holds its own place in the formation under its own cascade.
//!
//! Each drone sees only itself: its place is where it stands at rest, moved and turned with the reference; its mass is
//! its share of the whole. What hangs between them follows through passive joints. With a single drone this is the
//! plain cascade, fed with the mass of all it carries.

use super::cascade::{CascadeMemory, CascadeModel, RateDivisors, Rates};
use super::controller::Target;
use super::kinematics::Kinematics;
use super::law::{ControlLaw, LawController, LawInput};
use super::parameters::GainSet;
use super::reference::{Reference, Setpoint};
use autodiff::Scalar;
use autodiff::jet::Jet;
use base::error::{Error, Result};
use dynamics::spatial::{from_matrix, mat_vec, to_euler, transpose};
use dynamics::tree::{Multibody, body_poses, carrier};
use dynamics::{Gains, MAX_ROTORS};

/// Such drones with the memory of their cascades.
pub type FormationController = LawController<FormationLaw>;

/// One cascade per drone of a model.
///
/// - Target: a [`Setpoint`] per drone. Ticks: velocity and position, attitude, rate, of all.
/// - Memory: a [`CascadeMemory`] of [`MAX_ROTORS`] rotors per drone. Parameters: twelve gains per drone.
#[derive(Debug, Clone)]
pub struct FormationLaw {
    system: Multibody,
    members: Vec<Member>,
    schedule: RateDivisors,
}

#[derive(Debug, Clone)]
struct Member {
    name: String,
    body: usize,
    /// Its rotors' actions in the input.
    actions: Vec<usize>,
    cascade: CascadeModel<f64, MAX_ROTORS>,
    /// Where it stands at rest, from the root, m.
    place: [f64; 3],
    /// Its yaw at rest from the root's, rad.
    yaw: f64,
}

/// Numbers of a member's memory, target and parameters.
const LATCHED: usize = CascadeMemory::<f64, MAX_ROTORS>::DIM;
const SETPOINT: usize = Setpoint::<f64>::DIM;
const GAINS: usize = GainSet::<f64>::DIM;

impl FormationController {
    /// For a model whose drones have all their rotors on one body each. Without `gains`, those derived from each drone.
    ///
    /// # Errors
    /// [`Error::Value`] for a model without drones, a drone that is no vehicle of its own, or rates that do not divide
    /// 1/dt.
    pub fn new(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        FormationLaw::new(system, gains, rates).map(Self::of)
    }
}

impl FormationLaw {
    /// As [`FormationController::new`].
    ///
    /// # Errors
    /// Likewise.
    pub fn new(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        let model = system.model();
        let poses = body_poses(system, &system.rest_state());
        let root = poses[0];
        let share = model.mass() / model.drones().len().max(1) as f64;
        let member = |number: usize| {
            let drone = &model.drones()[number];
            let vehicle = carrier(model, number)?;
            let gains = gains.copied().unwrap_or_else(|| vehicle.derived_gains());
            let mut cascade = CascadeModel::new(&vehicle, &gains)?;
            cascade.body.mass = share;
            let pose = &poses[drone.body];
            let offset = [0, 1, 2].map(|k| pose.position[k] - root.position[k]);
            let yaw = |rotation| to_euler(from_matrix(rotation))[2];
            Ok(Member {
                name: drone.name.clone(),
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
        Ok(Self { system: system.clone(), members, schedule: RateDivisors::new(rates, system.physics().dt)? })
    }
}

impl ControlLaw for FormationLaw {
    fn name(&self) -> &str {
        if self.members.len() == 1 { "cascade" } else { "formation" }
    }

    fn description(&self) -> String {
        match self.members.len() {
            1 => "of the drone, fed with the whole mass".into(),
            n => format!("{n} cascades, each holds its own place and carries its share"),
        }
    }

    fn schedule(&self) -> Option<RateDivisors> {
        Some(self.schedule)
    }

    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        root(&self.system, state)
    }

    fn n_target(&self) -> usize {
        SETPOINT * self.members.len()
    }

    fn write_target(&self, target: Target<'_>, time: f64, row: &mut [f64]) {
        for (member, row) in self.members.iter().zip(row.chunks_exact_mut(SETPOINT)) {
            place(target.reference, time, member.place, member.yaw).write(row);
        }
    }

    fn n_tick(&self) -> usize {
        3
    }

    fn write_ticks(&self, tick: u64, ticks: &mut [f64]) {
        ticks.copy_from_slice(&self.schedule.ticks(tick));
    }

    fn memory(&self) -> Vec<f64> {
        let mut memory = vec![0.0; LATCHED * self.members.len()];
        let rows = memory.chunks_exact_mut(LATCHED);
        self.members.iter().zip(rows).for_each(|(member, row)| member.cascade.initial().write(row));
        memory
    }

    fn parameters(&self) -> Vec<f64> {
        let mut theta = vec![0.0; GAINS * self.members.len()];
        let rows = theta.chunks_exact_mut(GAINS);
        self.members.iter().zip(rows).for_each(|(member, row)| member.cascade.gains.write(row));
        theta
    }

    fn parameter_names(&self) -> Vec<String> {
        self.members.iter().flat_map(|m| GainSet::<f64>::names(&format!("{}.", m.name))).collect()
    }

    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, memory: &mut [S], commands: &mut [S]) {
        let poses = body_poses(&self.system, now.state);
        for (i, member) in self.members.iter().enumerate() {
            let pose = &poses[member.body];
            let own = Kinematics {
                position: pose.position,
                velocity: pose.velocity,
                attitude: from_matrix(pose.rotation),
                angular_velocity: mat_vec(transpose(pose.rotation), pose.angular_velocity),
            };
            let mut cascade = CascadeModel::<S, MAX_ROTORS>::constant(&member.cascade);
            if !now.parameters.is_empty() {
                cascade.gains = GainSet::read(&now.parameters[GAINS * i..]);
            }
            let memory = &mut memory[LATCHED * i..LATCHED * (i + 1)];
            let wanted = Setpoint::read(&now.target[SETPOINT * i..]);
            let ticks = [now.ticks[0], now.ticks[1], now.ticks[2]];
            let held = cascade.position(&cascade.own(&own), &CascadeMemory::read(memory), &wanted, ticks);
            held.write(memory);
            for (at, action) in member.actions.iter().zip(held.rotors) {
                commands[*at] = action;
            }
        }
    }
}

/// Where a point fixed to the reference's frame should be: p(t) + Rz(ψ(t)) o, with all derivatives.
fn place(reference: &Reference, time: f64, offset: [f64; 3], yaw: f64) -> Setpoint<f64> {
    let (p, heading) = reference.series(time);
    let (s, c) = Scalar::sin_cos(heading);
    let constant = |v: f64| <Jet<f64, 5> as Scalar>::constant(v);
    let [x, y, z] = offset.map(constant);
    let moved = [p[0] + c * x - s * y, p[1] + s * x + c * y, p[2] + z];
    Setpoint::from_series(moved, heading + constant(yaw))
}

/// The root of a model as a controller sees it.
pub(super) fn root(system: &Multibody, state: &[f64]) -> Kinematics<f64> {
    Kinematics::read(&state[system.layout().bodies[0].position..])
}
