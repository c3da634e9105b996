//! A plan in front of incremental inversion (INDI): the plan says what force and moment, increments answer for what turns the body beside.
//!
//! ```text
//! reference ─▶ Mpc ─▶ thrusts T_d ─▶ [F_d, M_d] = B T_d ─▶ M = M_d + d̂ − d ─▶ bounded allocation ─▶ rotor commands
//!               ▲ d̂                        d = J (ω̇_f − α_f)
//! ```
//!
//! - T_d are the thrusts that the plan's first inputs hold in the end, not those that rotors reach by a time: the plan answers for their
//!   lag already. α_d = J⁻¹ (M_d + N + d̂) is the angular acceleration that the model has under them, N what turns it beside its rotors.
//! - α_f is the angular acceleration of the model at the measured rotor speeds and ω̇_f the measured one, both behind the same
//!   [`CUTOFF`](crate::indi::CUTOFF) filter: this is M = M_f + J (α_d − ω̇_f) with N filtered too. Where the model is right both agree,
//!   and the commands are the plan's.
//! - d̂ is d as the plan was told it last, in place of a moment that it would learn itself: M_d holds against d̂ already. A plan that is
//!   not told spends thrust that d has taken. Under 0.3 N m it was 0.179 m off the references of `benchmark tracking` that rotors can
//!   fly, and 0.002 m when told.
//! - All of it at the rate of the rate level; between two plans T_d and d̂ are held.
//! - What exceeds the bounds is given up by priority, roll and pitch before thrust before yaw.
//!
//! Source: Sun, Romero, Foehn, Kaufmann, Scaramuzza 2022 (nonlinear MPC with INDI).

use super::mpc::{Mpc, MpcSettings};
use crate::allocation::problem::WRENCH;
use crate::cascade::{RateDivisors, Rates};
use crate::cascade_law::with_drag_of;
use crate::controller::{Controller, Measurement, Note, Target};
use crate::filter::DigitalFilter;
use crate::hover_axes::HoverAxes;
use crate::incremental::{BoundedRotors, CUTOFF, EqualFilters, equal_filter};
use crate::kinematics::Kinematics;
use crate::nominal_body::NominalBody;
use base::error::{Error, Result};
use dynamics::Plant;
use dynamics::spatial::mat_vec;
use nalgebra::DMatrix;

/// Moments beyond so many times what the rotors have are no motion of a body: the filters begin anew.
const ABSURD: f64 = 10.0;

/// First rotor speed in the state of a rigid vehicle.
const FIRST_ROTOR: usize = 13;

/// Model predictive control with INDI of one rigid vehicle; see the [module](self).
pub struct PlannedIndi {
    mpc: Mpc,
    axes: HoverAxes<f64>,
    believed: NominalBody,
    rotors: BoundedRotors,
    /// Wrench (axes of hover) of one newton per rotor, 6 × n_rotor.
    geometry: DMatrix<f64>,
    /// Most moment that rotors have about each axis, N m.
    most: [f64; 3],
    filter: DigitalFilter,
    filters: EqualFilters<f64>,
    /// Whether the filters have nothing to go on from.
    is_first: bool,
    /// d: the moment beside the model, N m.
    beside: [f64; 3],
    /// And as the plan was told.
    planned: [f64; 3],
    /// Steps of the plant between two ticks.
    every: u64,
    step: u64,
    period: f64,
    commands: Vec<f64>,
}

impl PlannedIndi {
    /// Of a rigid vehicle that is believed to be so, with a plan of these settings.
    ///
    /// # Errors
    /// [`Error::Value`] for an articulated plant, a latency, rotors that do not turn thrust, roll, pitch and yaw apart, or a rate that does not divide
    /// 1/dt; as [`Mpc::new`].
    pub fn new(plant: &Plant, settings: &MpcSettings, rates: &Rates) -> Result<Self> {
        let Plant::Rigid(multirotor) = plant else {
            let (what, rule) = (format!("plant '{}'", plant.name()), "one rigid vehicle");
            return Err(Error::value(what, "of another make", rule, "Take 'mpc' without INDI."));
        };
        if settings.latency > 0 {
            let remedy = "Take 'mpc', which bears it: increments need the answer to commands at once.";
            return Err(Error::value("mpc_indi: latency", settings.latency, "0", remedy));
        }
        let mpc = Mpc::new(plant, settings)?;
        let vehicle = with_drag_of(multirotor.vehicle(), plant.physics().effects);
        vehicle.check_steerable()?;
        let (axes, vehicle) = (HoverAxes::of(&vehicle), vehicle.upright());
        let geometry = vehicle.allocation_matrix();
        let most = [3, 4, 5].map(|row| {
            geometry.row(row).iter().zip(&vehicle.rotors).map(|(b, rotor)| b.abs() * rotor.max_thrust()).sum()
        });
        let dt = plant.physics().dt;
        let every = RateDivisors::new(rates, dt)?.every[2];
        let period = every as f64 * dt;
        Ok(Self {
            commands: mpc.commands().to_vec(),
            believed: NominalBody::new(&vehicle)?,
            rotors: BoundedRotors::new(&vehicle)?,
            filter: equal_filter(period),
            filters: EqualFilters::zeros(),
            is_first: true,
            beside: [0.0; 3],
            planned: [0.0; 3],
            step: 0,
            mpc,
            axes,
            geometry,
            most,
            every,
            period,
        })
    }

    /// The same with a controller that flies while no plan is found.
    #[must_use]
    pub fn with_fallback(mut self, fallback: Box<dyn Controller>) -> Self {
        self.mpc = self.mpc.with_fallback(fallback);
        self
    }

    /// What plans.
    pub fn mpc(&self) -> &Mpc {
        &self.mpc
    }

    /// The moment beside the model that it answers for now, N m, body.
    pub fn moment(&self) -> [f64; 3] {
        self.axes.to_body(self.beside)
    }

    /// d = J (ω̇_f − α_f), not more than rotors have; none for measurements that are no motion.
    fn learn(&mut self, state: &[f64]) {
        let motion = self.axes.kinematics(&Kinematics::read(state));
        let rotors = self.believed.wrench(|i| self.rotors.thrust_at(i, state[FIRST_ROTOR + i]));
        let [_, _, _, x, y, z] = self.believed.acceleration(&motion, rotors);
        let w = motion.angular_velocity;
        let (mean, slope) =
            self.filters.filtered(self.is_first, &self.filter, [w[0], w[1], w[2], x, y, z], self.period);
        let change = [0, 1, 2].map(|k| slope[k] - mean[3 + k]);
        let found: [f64; 3] = mat_vec(self.believed.body().inertia, change);
        self.is_first = !found.iter().zip(self.most).all(|(m, most)| m.abs() <= ABSURD * most);
        let within = |k: usize| found[k].clamp(-self.most[k], self.most[k]);
        self.beside = if self.is_first { [0.0; 3] } else { [0, 1, 2].map(within) };
    }

    /// Commands for the planned wrench, and for what the moment beside the model is not as planned.
    fn allocate(&mut self) {
        let mut wrench = [0.0; WRENCH];
        for (i, action) in self.mpc.commands()[..self.geometry.ncols()].iter().enumerate() {
            let thrust = self.rotors.thrust_of(i, *action);
            (0..WRENCH).for_each(|row| wrench[row] += self.geometry[(row, i)] * thrust);
        }
        (0..3).for_each(|k| wrench[3 + k] += self.planned[k] - self.beside[k]);
        self.rotors.write_actions(&wrench, &mut self.commands);
    }
}

impl Controller for PlannedIndi {
    fn name(&self) -> &str {
        "mpc_indi"
    }

    fn why_no_law(&self) -> &'static str {
        "a plan, whose solver takes as many steps as it needs"
    }

    fn description(&self) -> String {
        format!("{}, over incremental inversion of the rotation with filters at {CUTOFF} Hz", self.mpc.description())
    }

    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        self.mpc.tracked(state)
    }

    fn reset(&mut self) {
        self.mpc.reset();
        self.commands.copy_from_slice(self.mpc.commands());
        (self.step, self.is_first) = (0, true);
        (self.beside, self.planned) = ([0.0; 3], [0.0; 3]);
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, commands: &mut [f64]) {
        if self.step.is_multiple_of(self.every) {
            self.learn(seen.state);
        }
        if self.mpc.is_due() {
            self.planned = self.beside;
            self.mpc.take_moment(self.moment());
        }
        self.mpc.decide(seen, target);
        if self.mpc.falls_back() {
            self.commands.copy_from_slice(self.mpc.commands());
        } else if self.step.is_multiple_of(self.every) {
            self.allocate();
        }
        self.step += 1;
        commands.copy_from_slice(&self.commands[..commands.len()]);
        self.mpc.sent(seen.state, commands);
    }

    fn tell(&mut self, effectiveness: &[f64]) -> Result<()> {
        self.mpc.tell(effectiveness)?;
        self.rotors.tell(effectiveness);
        Ok(())
    }

    fn notes(&self) -> Vec<Note> {
        let [x, y, z] = self.moment();
        let mut notes = self.mpc.notes();
        notes.push(Note::new(
            "moment beside the model",
            format!("{x:.3}, {y:.3}, {z:.3} N m"),
            "about body x, y, z, at the end",
        ));
        notes
    }
}
