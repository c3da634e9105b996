//! What befell a flight, however small its errors are: it came below the ground, or what it carries turned over.
//!
//! **Ground.** Most flights are simulated in free air, so that nothing stops them at the ground: it is judged afterwards. The
//! height h of a flight is that of its lowest point (shapes and rotor discs of all bodies; their origins where there are neither)
//! above the ground: z = 0, or what the model says, with hills above them; a model without a ground has none. h_r is the height at which
//! the same body would
//! be on its reference, level: the start's own, raised as the reference is. A flight fails where h < min(0, h_r) − [`GRAZE`].
//! So a reference that brings a vehicle as low as it stands, or begins there, is flown with its feet on the ground, wherever
//! its origin is. Where contact is simulated the ground stops what falls on it, so that any touch counts unless the reference
//! leads there (h_r ≤ `GRAZE`).
//!
//! A reference may go below the ground itself: that of a vehicle does where z < 0, that of several bodies where h_r < −`GRAZE`.
//!
//! **Turned over** is a load, a body without rotors that carries the others or hangs last, that was upright at first and then leans by
//! more than a right angle from
//! upright, or from the roll and pitch that were asked of it: it hangs above what carries it, and nothing stays on it.

pub use super::collision_parts::{lowest_point, nearest_still};

use super::collision_parts::over;
use super::flight::Flight;
use base::error::Result;
use dynamics::configurations::environment::vehicle_in;
use dynamics::scene::Scene;
use dynamics::spatial::{dot, from_euler, mat_vec, up_axis};
use dynamics::tree::{Multibody, body_poses};
use dynamics::{Effects, Physics, Plant};
use serde::Serialize;
use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt;

/// Less than this below the ground is no mishap, m: what a landing overshoots by, and what contact gives way.
pub const GRAZE: f64 = 0.01;
/// A reference on the ground is not below it by this, m.
const ROUNDING: f64 = 1e-9;

/// Beyond this a load has turned over: a right angle, and what rounding adds half way to being upside down as asked, rad.
const OVER: f64 = FRAC_PI_2 + ROUNDING;
const UP: [f64; 3] = [0.0, 0.0, 1.0];

/// Something that fails a flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Mishap {
    /// The reference itself leads below the ground.
    ReferenceBelowGround {
        /// Of it, or of what is lowest there, m: negative.
        height: f64,
        /// When it first does, s.
        time: f64,
    },
    /// It came below the ground, or touched it where the ground was simulated.
    Ground {
        /// Least height of the lowest point above the ground, m.
        height: f64,
        /// When it first did, s.
        time: f64,
    },
    /// A load turned over.
    TurnedOver {
        /// Name of the body.
        body: String,
        /// Largest angle from upright, or from where it was asked to be, rad.
        angle: f64,
        /// When it first passed a right angle, s.
        time: f64,
    },
}

impl fmt::Display for Mishap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ReferenceBelowGround { height, time } => {
                write!(f, "the reference leads it below the ground, by {:.3} m at most, first at {time:.2} s", -height)
            }
            Self::Ground { height, time } if *height < -GRAZE => {
                write!(f, "it went below the ground at {time:.2} s, by {:.3} m at most", -height)
            }
            Self::Ground { time, .. } => write!(f, "it hit the ground at {time:.2} s"),
            Self::TurnedOver { body, angle, time } => {
                write!(f, "'{body}' turned over at {time:.2} s, by {:.0}°", angle.to_degrees())
            }
        }
    }
}

/// What a flight was like over the ground.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightCheck {
    /// Least height of the lowest point of all bodies and rotors above the ground, m; above z = 0 where there is none.
    pub lowest: f64,
    /// Whether the ground counted.
    pub ground: bool,
    /// What befell it, in order of time.
    pub mishaps: Vec<Mishap>,
}

/// Judges a flight of this plant; `ground` leaves it out where false.
///
/// # Errors
/// As `vehicle_in`.
pub fn check_flight(plant: &Plant, flight: &Flight, ground: bool) -> Result<FlightCheck> {
    let bodies = bodies_of(plant)?;
    let heights: Vec<f64> =
        flight.states.chunks_exact(bodies.rest_state().len()).map(|row| height(&bodies, row)).collect();
    let mut mishaps = turned_over(&bodies, flight);
    let ground = ground && bodies.model().parts().contact.ground.is_some();
    if ground {
        mishaps.extend(below_ground(&bodies, plant.physics().effects.contact, flight, &heights));
    }
    mishaps.sort_by(|a, b| a.time().total_cmp(&b.time()));
    Ok(FlightCheck { lowest: heights.iter().fold(f64::INFINITY, |least, h| least.min(*h)), ground, mishaps })
}

impl Mishap {
    /// When it began, s.
    pub fn time(&self) -> f64 {
        match self {
            Self::ReferenceBelowGround { time, .. } | Self::Ground { time, .. } | Self::TurnedOver { time, .. } => {
                *time
            }
        }
    }
}

/// The bodies of a plant; of a rigid vehicle itself as one, over level ground.
fn bodies_of(plant: &Plant) -> Result<Multibody> {
    match plant {
        Plant::Tree(system) => Ok(system.clone()),
        Plant::Rigid(system) => {
            let physics = Physics { effects: Effects::none(), ..*system.physics() };
            Multibody::new(&vehicle_in(system.vehicle(), &Scene::grounded())?, physics)
        }
    }
}

/// Of the lowest point above the ground, m.
fn height(bodies: &Multibody, state: &[f64]) -> f64 {
    let contact = &bodies.model().parts().contact;
    let level = contact.ground.unwrap_or(0.0);
    match &contact.relief {
        Some(relief) => over(bodies, state, level, relief),
        None => lowest_point(bodies, state) - level,
    }
}

fn below_ground(bodies: &Multibody, simulated: bool, flight: &Flight, heights: &[f64]) -> Vec<Mishap> {
    let (log, contact) = (&flight.log, &bodies.model().parts().contact);
    let (Some(first), Some(begin)) = (heights.first(), log.position.first()) else { return Vec::new() };
    let (level, alone) = (contact.ground.unwrap_or(0.0), bodies.model().bodies().len() == 1);
    // over hills a reference has no height of its own
    let asked = |wanted: &[f64; 3]| match contact.relief {
        None => first + wanted[2] - begin[2],
        Some(_) => f64::INFINITY,
    };
    let buried = |wanted: &[f64; 3]| {
        let (own, least) = if alone { (wanted[2] - level, -ROUNDING) } else { (asked(wanted), -GRAZE) };
        if contact.relief.is_none() && own < least { Some(own) } else { None }
    };
    let below = || log.time.iter().zip(&log.reference_position).filter_map(|(t, w)| Some((*t, buried(w)?)));
    if let Some((time, _)) = below().next() {
        return vec![Mishap::ReferenceBelowGround { height: below().fold(0.0, |least, (_, h)| h.min(least)), time }];
    }
    let graze = |asked: f64| if simulated && asked > GRAZE { 0.0 } else { GRAZE };
    let fails = |(h, w): (&f64, &[f64; 3])| *h < asked(w).min(0.0) - graze(asked(w));
    let first = heights.iter().zip(&log.reference_position).position(fails);
    let least = heights.iter().fold(f64::INFINITY, |least, h| least.min(*h));
    first.map(|k| Mishap::Ground { height: least, time: log.time[k] }).into_iter().collect()
}

/// Loads that turned over.
fn turned_over(bodies: &Multibody, flight: &Flight) -> Vec<Mishap> {
    let model = bodies.model();
    let flies = |i: &usize| model.rotors().iter().any(|r| r.body == *i);
    // a bar under a rotor that failed hangs, and its load flies on
    let between =
        |i: &usize| model.bodies()[*i].parent.is_some() && model.bodies().iter().any(|b| b.parent == Some(*i));
    let is_load = |i: &usize| model.bodies()[*i].mass > 0.0 && !flies(i) && !between(i);
    let loads: Vec<usize> = (0..model.bodies().len()).filter(is_load).collect();
    let mut angles = vec![Vec::new(); loads.len()];
    for (k, row) in flight.states.chunks_exact(bodies.rest_state().len()).enumerate() {
        let poses = body_poses(bodies, row);
        let asked = flight.log.asked_angles.get(k).map(|[roll, pitch, yaw]| up_axis(from_euler(*roll, *pitch, *yaw)));
        for (own, i) in angles.iter_mut().zip(&loads) {
            let up = mat_vec(poses[*i].rotation, UP);
            let from = |wanted: [f64; 3]| dot(up, wanted).clamp(-1.0, 1.0).acos();
            // on its way to a tilt it may be far from that, or from upright, never from both
            own.push(asked.map_or(PI, from).min(from(UP)));
        }
    }
    let judged = loads.iter().zip(&angles).filter(|(_, own)| own.first().is_some_and(|first| *first < FRAC_PI_2));
    let told = judged.filter_map(|(i, own)| {
        let first = own.iter().position(|angle| *angle > OVER)?;
        let angle = own.iter().fold(0.0, |most: f64, angle| most.max(*angle));
        Some(Mishap::TurnedOver { body: model.bodies()[*i].name.clone(), angle, time: flight.log.time[first] })
    });
    told.collect()
}
