//! Controllers on the 144 ellipses of a published comparison: how near they stay, and how often they crash.
//!
//! The references are level and standing [`Ellipse`]s with peak acceleration a ∈ {10, …, 60} m/s², peak speed V ∈ {5, 10, 15, 20} m/s
//! and half axes V²/a and a fraction 1, ½ or ⅕ of it; the vehicle is a quadrotor of 0.75 kg with 4.6 times the thrust it
//! weighs ([`quadrotor`]). 81 of the references ask for more than its rotors have ([`TrackingCell::is_feasible`]). Beside the
//! nominal plant there are four that the controller does not know of: [`TrackingCondition`].
//!
//! Where this departs from the paper: the plant is stepped at 600 Hz (500 there) so that 300 Hz divide it; it has linear body drag but
//! not the lift of 0.01 kg/m · v²; a flight starts at rest and gathers speed within [`SPIN_UP`] seconds, errors count for
//! [`COUNTED`] seconds from then on; the heading is constant, and standing ellipses lie across it; the centre of mass is shifted
//! forward, the moment acts about body x; a flight has crashed once it is more than 10 m off; no controller integrates, for the paper's do
//! not (`lqi` does by its design); and what is feasible is so for the nominal vehicle.
//!
//! Source: Sun, Romero, Foehn, Kaufmann, Scaramuzza, A Comparative Study of Nonlinear MPC and Differential-Flatness-Based Control for
//! Quadrotor Agile Flight, T-RO 2022 (arXiv 2109.01365).

use omnidrones::controllers::controller::{Controller, Target};
use omnidrones::controllers::design::Corner;
use omnidrones::controllers::flight::LOST;
use omnidrones::controllers::reference::{Ellipse, Reference};
use omnidrones::controllers::registry::{Setup, controller};
use omnidrones::controllers::{BodyModel, ClosedLoop, ExogenousInputs, Mixer, Rates, start_on};
use omnidrones::dynamics::vehicle::{Drag, Inertia, Part, Rotor};
use omnidrones::dynamics::{Disturbance, Effects, Gains, MAX_ROTORS, Physics, Plant, Vehicle};
use omnidrones::error::Result;
use omnidrones::internals::{flat_wrench, truth};
use omnidrones::parallel::Threads;
use serde::Serialize;

/// The published mean error (m) of flatness-based control on the nominal plant over all 144 references: 76 of 0.084 m, 68 of 0.77 m.
pub const PUBLISHED_OVER_ALL: f64 = (76.0 * 0.084 + 68.0 * 0.77) / 144.0;
/// Peak accelerations, m/s².
pub const ACCELERATIONS: [f64; 6] = [10.0, 20.0, 30.0, 40.0, 50.0, 60.0];
/// Peak speeds, m/s.
pub const SPEEDS: [f64; 4] = [5.0, 10.0, 15.0, 20.0];
/// How long a flight takes to gather its speed, s.
pub const SPIN_UP: f64 = 4.0;
/// How long errors count, s.
pub const COUNTED: f64 = 10.0;
/// Points of a lap that are asked whether the rotors can do it.
const SAMPLES: usize = 360;
/// Height of the centre, m: no ellipse reaches the ground.
const HEIGHT: f64 = 50.0;

/// One reference of the comparison.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrackingCell {
    /// Peak acceleration a, m/s².
    pub acceleration: f64,
    /// Peak speed V, m/s.
    pub speed: f64,
    /// Larger half axis over the smaller.
    pub ratio: f64,
    /// Whether it stands.
    pub standing: bool,
}

impl TrackingCell {
    /// All 144.
    pub fn all() -> Vec<Self> {
        let mut cells = Vec::new();
        for standing in [false, true] {
            for acceleration in ACCELERATIONS {
                for speed in SPEEDS {
                    cells.extend([1.0, 2.0, 5.0].map(|ratio| Self { acceleration, speed, ratio, standing }));
                }
            }
        }
        cells
    }

    /// The ellipse: half axes V²/a and that over the ratio, at the rate a/V.
    pub fn reference(&self) -> Reference {
        let radius = self.speed * self.speed / self.acceleration;
        Reference::Ellipse(Ellipse {
            center: [0.0, 0.0, HEIGHT],
            half_axes: [radius, radius / self.ratio],
            rate: self.acceleration / self.speed,
            spin_up: SPIN_UP,
            standing: self.standing,
            yaw: 0.0,
        })
    }

    /// Whether a vehicle without error stays within its rotors' limits all round: thrusts B⁺ [m‖f‖, Jα + ω × Jω] within
    /// [0, T_max], with f, ω, α of the flatness map with drag. Motor lag is left out.
    ///
    /// # Errors
    /// As [`Mixer::new`].
    pub fn is_feasible(&self, vehicle: &Vehicle) -> Result<bool> {
        let vehicle = &vehicle.upright();
        let (mixer, body, reference) =
            (Mixer::new(vehicle)?.carrying(vehicle), BodyModel::of(vehicle), self.reference());
        let rows: [[f64; 4]; MAX_ROTORS] = mixer.padded()?;
        let lap = 2.0 * std::f64::consts::PI * self.speed / self.acceleration;
        Ok((0..SAMPLES).all(|k| {
            let sample = reference.sample(SPIN_UP + lap * k as f64 / SAMPLES as f64);
            let wrench = flat_wrench(&body, &sample);
            vehicle.rotors.iter().zip(&rows).all(|(rotor, row)| {
                let thrust: f64 = row.iter().zip(wrench).map(|(p, w)| p * w).sum();
                (0.0..=rotor.max_thrust()).contains(&thrust)
            })
        }))
    }
}

/// How the plant differs from what its controller believes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TrackingCondition {
    /// Not at all.
    Nominal,
    /// 30 % more mass.
    Mass,
    /// The centre of mass a tenth of an arm ahead.
    CenterOfMass,
    /// Commands 50 ms late.
    Latency,
    /// A moment of 0.3 N m about body x.
    Moment,
}

impl TrackingCondition {
    /// In the order of the published table.
    pub const ALL: [Self; 5] = [Self::Nominal, Self::CenterOfMass, Self::Mass, Self::Latency, Self::Moment];

    /// For tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nominal => "nominal",
            Self::Mass => "mass + 30 %",
            Self::CenterOfMass => "centre of mass off by 10 % of an arm",
            Self::Latency => "50 ms late",
            Self::Moment => "moment of 0.3 N m",
        }
    }

    /// The published mean error (m) of flatness-based control without INDI, and with it where it is told, over the 76 references that the
    /// paper calls feasible; they are not told one by one, and [`TrackingCell::is_feasible`] finds 63.
    pub fn published(self) -> [Option<f64>; 2] {
        match self {
            Self::Nominal => [Some(0.084), Some(0.085)],
            Self::CenterOfMass => [Some(1.499), Some(0.099)],
            Self::Mass => [Some(0.687), None],
            Self::Latency => [Some(0.669), None],
            Self::Moment => [Some(4.949), None],
        }
    }

    /// The same of nonlinear MPC, without INDI and with it, and the share (%) of the references on which it crashed without, where it is
    /// told. Nominal deviations are 0.049 m; over the references that are not feasible it is 0.40 m.
    pub fn published_mpc(self) -> ([Option<f64>; 2], Option<f64>) {
        match self {
            Self::Nominal => ([Some(0.084), Some(0.082)], None),
            Self::CenterOfMass => ([Some(0.264), Some(0.081)], None),
            Self::Mass => ([Some(0.809), None], Some(10.7)),
            Self::Latency => ([Some(3.45), None], Some(66.7)),
            Self::Moment => ([Some(0.566), None], None),
        }
    }

    fn truth(self, vehicle: &Vehicle) -> Vehicle {
        let own = Corner::nominal(0.0);
        match self {
            Self::Mass => truth(vehicle, &Corner { mass: 1.3, ..own }),
            Self::CenterOfMass => {
                let mut truth = vehicle.clone();
                let arms = vehicle.rotors.iter().map(|r| r.position[0].hypot(r.position[1]));
                let shift = 0.1 * arms.fold(0.0, f64::max);
                truth.parts.iter_mut().for_each(|part| part.position[0] += shift);
                truth
            }
            _ => vehicle.clone(),
        }
    }

    fn air(self) -> Disturbance<f64> {
        let moment = if self == Self::Moment { [0.3, 0.0, 0.0] } else { [0.0; 3] };
        Disturbance { moment, ..Disturbance::none() }
    }

    fn latency(self, dt: f64) -> usize {
        if self == Self::Latency { (0.05 / dt).round() as usize } else { 0 }
    }
}

/// The vehicle of the comparison, with its gains as accelerations (1/s², 1/s) times its inertia.
///
/// The paper's attitude gains are taken per radian. If they are meant per half of it (the vector part of a quaternion), they are half as
/// large: then a latency of 50 ms is borne on more references, and everything else is tracked worse.
pub fn quadrotor() -> Vehicle {
    let (forward, aside) = (0.14 * 56_f64.to_radians().cos(), 0.14 * 56_f64.to_radians().sin());
    let (coefficient, inertia) = (1.51e-6, [2.5e-3, 2.1e-3, 4.3e-3]);
    let layout = [(forward, -aside, 1.0), (-forward, aside, 1.0), (forward, aside, -1.0), (-forward, -aside, -1.0)];
    let rotor = |(i, (x, y, spin)): (usize, (f64, f64, f64))| Rotor {
        name: format!("rotor_{i}"),
        position: [x, y, 0.0],
        axis: [0.0, 0.0, 1.0],
        spin,
        thrust_coefficient: coefficient,
        moment_per_thrust: 2.37e-8 / coefficient,
        max_speed: (8.5 / coefficient).sqrt(),
        time_constant_up: 0.03,
        time_constant_down: 0.03,
        inertia: 0.0,
        radius: 0.0,
        drag_coefficient: 0.0,
        axial_drag_coefficient: 0.0,
        rolling_coefficient: 0.0,
    };
    let times = |per_inertia: [f64; 3]| [0, 1, 2].map(|k| per_inertia[k] * inertia[k]);
    Vehicle {
        name: "sun_quadrotor".into(),
        source: "Sun, Romero, Foehn, Kaufmann, Scaramuzza 2022, table I".into(),
        parts: vec![Part::new("body", 0.75, [0.0; 3], Inertia::diagonal(inertia[0], inertia[1], inertia[2]))],
        rotors: layout.into_iter().enumerate().map(rotor).collect(),
        drag: Drag { linear: [0.26, 0.28, 0.42], ..Drag::default() },
        shapes: Vec::new(),
        published_gains: Some(Gains {
            position: [10.0; 3],
            velocity: [6.0; 3],
            attitude: times([150.0, 150.0, 3.0]),
            rate: times([20.0, 20.0, 8.0]),
            integral: [0.0; 2],
        }),
    }
}

/// 600 Hz, linear drag of the body.
pub fn physics() -> Physics {
    let effects = Effects { body_drag: true, disturbance: true, ..Effects::none() };
    Physics { dt: 1.0 / 600.0, effects, ..Physics::default() }
}

/// 300 Hz at every level.
pub fn rates() -> Rates {
    Rates { rate: 300.0, attitude: 300.0, velocity: 300.0 }
}

/// How one reference was flown.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrackingFlight {
    /// What was flown.
    pub cell: TrackingCell,
    /// Whether the rotors of the nominal vehicle can do it.
    pub feasible: bool,
    /// Root mean square distance while errors count, m; `None` after a crash.
    pub rmse: Option<f64>,
}

/// One controller on one plant over all references.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrackingRow {
    /// Its name in the registry.
    pub controller: String,
    /// Of the plant.
    pub condition: TrackingCondition,
    /// In the order of [`TrackingCell::all`].
    pub flights: Vec<TrackingFlight>,
}

impl TrackingRow {
    /// Mean over the flights that `counts` and that did not crash, m; `None` where all crashed.
    pub fn mean_rmse(&self, counts: impl Fn(&TrackingFlight) -> bool) -> Option<f64> {
        let kept: Vec<f64> = self.flights.iter().filter(|f| counts(f)).filter_map(|f| f.rmse).collect();
        (!kept.is_empty()).then(|| kept.iter().sum::<f64>() / kept.len() as f64)
    }

    /// How many of the flights that `counts` crashed, and how many those are. The references are all there are, not a sample: the
    /// share has no bounds.
    pub fn crashes(&self, counts: impl Fn(&TrackingFlight) -> bool) -> (usize, usize) {
        let counted = || self.flights.iter().filter(|f| counts(f));
        (counted().filter(|f| f.rmse.is_none()).count(), counted().count())
    }
}

/// The vehicle and its references, with what its rotors can do.
pub struct Tracking {
    vehicle: Vehicle,
    cells: Vec<(TrackingCell, bool)>,
}

impl Tracking {
    /// Finds the feasible ones.
    ///
    /// # Errors
    /// As [`TrackingCell::is_feasible`].
    pub fn new(threads: &Threads) -> Result<Self> {
        let (vehicle, cells) = (quadrotor(), TrackingCell::all());
        let cells = threads.map(cells.len(), |i| Ok((cells[i], cells[i].is_feasible(&vehicle)?)));
        Ok(Self { cells: cells.into_iter().collect::<Result<_>>()?, vehicle })
    }

    /// The references, and whether each is feasible.
    pub fn cells(&self) -> &[(TrackingCell, bool)] {
        &self.cells
    }

    /// Flies them all under a controller of the registry, built for the nominal vehicle.
    ///
    /// # Errors
    /// As the controller's.
    pub fn fly(&self, name: &str, condition: TrackingCondition, threads: &Threads) -> Result<TrackingRow> {
        let rates = rates();
        self.fly_with(name, |believed| controller(name, believed, &Setup::new(None, &rates)), condition, threads)
    }

    /// Likewise under a controller that `build` makes for the nominal vehicle.
    ///
    /// # Errors
    /// As `build`.
    pub fn fly_with(
        &self,
        name: &str,
        build: impl Fn(&Plant) -> Result<Box<dyn Controller>> + Sync,
        condition: TrackingCondition,
        threads: &Threads,
    ) -> Result<TrackingRow> {
        let believed = Plant::of_vehicle(&self.vehicle, physics())?;
        let flights = threads.map(self.cells.len(), |i| -> Result<TrackingFlight> {
            let (cell, feasible) = self.cells[i];
            let rmse = fly_cell(build(&believed)?, &self.vehicle, condition, &cell)?;
            Ok(TrackingFlight { cell, feasible, rmse })
        });
        let flights = flights.into_iter().collect::<Result<_>>()?;
        Ok(TrackingRow { controller: name.into(), condition, flights })
    }
}

fn fly_cell(
    law: Box<dyn Controller>,
    vehicle: &Vehicle,
    condition: TrackingCondition,
    cell: &TrackingCell,
) -> Result<Option<f64>> {
    let (physics, reference) = (physics(), cell.reference());
    let plant = Plant::of_vehicle(&condition.truth(vehicle), physics)?;
    let mut state = start_on(&plant, &law, &reference)?;
    let mut next = state.clone();
    let mut system = ClosedLoop::new(plant, law)?.with_latency(condition.latency(physics.dt))?;
    let (target, outside) = (Target::level(&reference), ExogenousInputs::air(condition.air()));
    let n_step = ((SPIN_UP + COUNTED) / physics.dt).round() as u64;
    let (mut sum, mut count) = (0.0, 0_u32);
    for k in 0..n_step {
        system.advance(&state, target, &outside, &mut next)?;
        std::mem::swap(&mut state, &mut next);
        let time = (k + 1) as f64 * physics.dt;
        let wanted = reference.sample(time).position;
        let squared: f64 = (0..3).map(|i| (state[i] - wanted[i]).powi(2)).sum();
        if squared.is_nan() || squared > LOST * LOST {
            return Ok(None);
        }
        if time > SPIN_UP {
            (sum, count) = (sum + squared, count + 1);
        }
    }
    Ok(Some((sum / f64::from(count)).sqrt()))
}
