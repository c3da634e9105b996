//! What a controller has to bear: disk margins of all commands at once, in several winds, on plants that are not as believed,
//! and a latency.
//!
//! The gate closes the loop that flies (all rates, holds, motors) at hover in each wind, which is forward flight at that speed,
//! with mass, inertia and motor lag each at both ends of their spread: the corners of the box. The law keeps believing in the
//! nominal vehicle. What counts is the least multi-loop [disk margin](LoopModel::disk_margin) over all of it. Whether the nominal
//! loop at hover is stable with the latency is told beside it.

use super::loop_model::{AnalysisPoint, LoopMargins, LoopModel};
use super::stability::Stability;
use super::trim::{Trim, TrimTarget, trim};
use crate::cascade::Rates;
use crate::cascade_law::CascadeLaw;
use crate::closed_loop::ClosedLoop;
use crate::controller::Target;
use crate::filter::FilterSettings;
use crate::reference::{Hover, Reference};
use base::error::{Error, Result};
use base::parallel::Threads;
use dynamics::{Disturbance, Gains, Physics, Plant, Vehicle};
use rng::Stream;
use serde::{Deserialize, Serialize};

/// What is asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MarginGate {
    /// Least disk margin α of all commands at once; [0.01, 1.99]. Default 0.5.
    pub disk: f64,
    /// Forward speeds at which loops are judged, m/s; one or more, each within [0, 100]. Default 0, 5, 10.
    pub speeds: Vec<f64>,
    /// Mass, inertia and motor lag between 1 − spread and 1 + spread of what is believed; [0, 0.9]. Default 0.3.
    pub spread: f64,
    /// Latency with which the nominal loop should still be stable at hover, s; [0, 0.2]. Default 0.05.
    pub latency: f64,
}

impl Default for MarginGate {
    /// 0.5 at 0, 5 and 10 m/s over ±30 %, and 50 ms.
    fn default() -> Self {
        Self { disk: 0.5, speeds: vec![0.0, 5.0, 10.0], spread: 0.3, latency: 0.05 }
    }
}

/// A speed and a plant at which a loop is judged.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Corner {
    /// Forward speed, m/s.
    pub speed: f64,
    /// Mass, as a factor of the believed one.
    pub mass: f64,
    /// Inertia, as a factor of the believed one.
    pub inertia: f64,
    /// Motor time constants, as a factor of the believed ones.
    pub lag: f64,
    /// How far the centre of mass lies before and left of where it is believed, m, body axes.
    pub shift: [f64; 2],
}

impl Corner {
    /// The vehicle as it is believed to be, at a speed.
    pub fn nominal(speed: f64) -> Self {
        Self { speed, mass: 1.0, inertia: 1.0, lag: 1.0, shift: [0.0; 2] }
    }

    /// A random one: factors between 1 − spread and 1 + spread, the centre of mass up to `shift` (m) off along either axis.
    pub(super) fn drawn(stream: &mut Stream, speed: f64, spread: f64, shift: f64) -> Self {
        let mut factor = || if spread > 0.0 { stream.uniform(1.0 - spread, 1.0 + spread) } else { 1.0 };
        let (mass, inertia, lag) = (factor(), factor(), factor());
        let mut off = || if shift > 0.0 { stream.uniform(-shift, shift) } else { 0.0 };
        Self { speed, mass, inertia, lag, shift: [off(), off()] }
    }
}

/// Why a loop has no margin.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MarginFailure {
    /// Combinations of states neither settle nor grow: commands do not move them, or do not depend on them.
    Marginal(Vec<String>),
    /// A pole lies outside the unit circle: how fast it grows, 1/s, and turns, rad/s.
    Unstable {
        /// 1/s.
        growth: f64,
        /// rad/s.
        frequency: f64,
    },
    /// The plant has no steady flight there.
    NoTrim(String),
    /// The loop does not come to rest about that flight, or its model is not found.
    NotSteady(String),
}

impl std::fmt::Display for MarginFailure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Marginal(what) => Stability::Marginal(what.clone()).fmt(f),
            Self::Unstable { growth, frequency } => {
                Stability::Unstable { growth: *growth, frequency: *frequency }.fmt(f)
            }
            Self::NoTrim(why) => write!(f, "no steady flight: {why}"),
            Self::NotSteady(why) => write!(f, "does not come to rest: {why}"),
        }
    }
}

/// How a set of gains fares at a gate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MarginReport {
    /// The disk margin α of all commands at every corner; 0 where the loop is not stable.
    pub corners: Vec<(Corner, f64)>,
    /// Place in `corners` of the least of them.
    pub worst: usize,
    /// Why corners have no margin: their places in `corners`, and what was found there.
    pub flaws: Vec<(usize, MarginFailure)>,
    /// Delay that ends stability of the nominal loop at hover, s ([`LoopMargins::delay`](super::LoopMargins::delay)).
    pub delay: f64,
    /// Whether every corner has the disk margin that is asked for.
    pub passes: bool,
    /// Whether the nominal loop at hover bears the latency that is asked for.
    pub bears_latency: bool,
}

impl MarginReport {
    /// The least disk margin.
    pub fn least(&self) -> f64 {
        self.corners[self.worst].1
    }

    /// The least disk margin of the plant as believed, over all speeds.
    pub fn nominal(&self) -> f64 {
        let own = |c: &Corner| *c == Corner::nominal(c.speed);
        self.corners.iter().filter(|(c, _)| own(c)).map(|(_, alpha)| *alpha).fold(f64::INFINITY, f64::min)
    }
}

impl MarginGate {
    /// Checks the ranges given with the fields.
    ///
    /// # Errors
    /// [`Error::Value`] that names the first outside.
    pub fn validate(&self) -> Result<()> {
        let rows = [
            ("margins.disk", self.disk, 0.01..=1.99, "within [0.01, 1.99]"),
            ("margins.spread", self.spread, 0.0..=0.9, "within [0, 0.9]"),
            ("margins.latency", self.latency, 0.0..=0.2, "within [0, 0.2] s"),
        ];
        for (what, value, range, rule) in rows {
            if !range.contains(&value) {
                return Err(Error::value(what, value, rule, "Leave it out for the default."));
            }
        }
        if self.speeds.is_empty() || self.speeds.iter().any(|v| !(0.0..=100.0).contains(v)) {
            let value = format!("{:?}", self.speeds);
            return Err(Error::value("margins.speeds", value, "one or more, up to 100 m/s", "As [0, 5, 10]."));
        }
        Ok(())
    }

    /// All corners: of every speed the believed plant, then the box.
    pub fn corners(&self) -> Vec<Corner> {
        let end = |of: usize, bit: usize| if of >> bit & 1 == 0 { 1.0 - self.spread } else { 1.0 + self.spread };
        let boxed =
            |speed, of| Corner { speed, mass: end(of, 0), inertia: end(of, 1), lag: end(of, 2), shift: [0.0; 2] };
        let n = if self.spread > 0.0 { 8 } else { 0 };
        let of = |speed: &f64| -> Vec<Corner> {
            std::iter::once(Corner::nominal(*speed)).chain((0..n).map(|k| boxed(*speed, k))).collect()
        };
        self.speeds.iter().flat_map(of).collect()
    }

    /// Judges gains of a vehicle's cascade.
    ///
    /// # Errors
    /// As [`validate`](Self::validate); [`Error::Value`] where vehicle, gains or rates are not valid.
    pub fn judge(
        &self,
        vehicle: &Vehicle,
        gains: &Gains,
        physics: &Physics,
        rates: &Rates,
        threads: &Threads,
    ) -> Result<MarginReport> {
        self.validate()?;
        // what cannot fly at all is told before it is judged
        CascadeLaw::new(vehicle, physics, gains, rates)?;
        let flown = Flown::in_still_air(vehicle, gains, physics, rates);
        let corners = self.corners();
        let found = threads.map(corners.len(), |i| flown.disk_margin(&corners[i]));
        let alpha = |found: &std::result::Result<f64, MarginFailure>| *found.as_ref().unwrap_or(&0.0);
        let flaws =
            found.iter().enumerate().filter_map(|(i, found)| Some((i, found.as_ref().err()?.clone()))).collect();
        let corners: Vec<(Corner, f64)> = corners.into_iter().zip(found.iter().map(alpha)).collect();
        let worst = (0..corners.len()).min_by(|a, b| corners[*a].1.total_cmp(&corners[*b].1)).unwrap_or(0);
        let delay = flown.hover_margins().map_or(0.0, |margins| if margins.stable { margins.delay } else { 0.0 });
        let passes = corners[worst].1 >= self.disk;
        Ok(MarginReport { corners, worst, flaws, delay, passes, bears_latency: delay > self.latency })
    }
}

/// A vehicle under its cascade, to be judged at corners.
#[derive(Clone, Copy)]
pub(super) struct Flown<'a> {
    pub vehicle: &'a Vehicle,
    pub gains: &'a Gains,
    pub physics: &'a Physics,
    pub rates: &'a Rates,
    /// Of the measured angular velocity.
    pub filters: &'a [FilterSettings],
    /// Steps by which commands act late.
    pub latency: usize,
    /// What acts beside the wind of a corner's speed.
    pub air: Disturbance<f64>,
}

impl<'a> Flown<'a> {
    pub fn in_still_air(vehicle: &'a Vehicle, gains: &'a Gains, physics: &'a Physics, rates: &'a Rates) -> Self {
        Self { vehicle, gains, physics, rates, filters: &[], latency: 0, air: Disturbance::none() }
    }

    /// The loop at a corner, which is stable; else what is wrong with it.
    pub fn stable(&self, corner: &Corner) -> std::result::Result<LoopModel, MarginFailure> {
        let not_steady = |e: Error| MarginFailure::NotSteady(e.to_string());
        let plant = self.plant(corner).map_err(not_steady)?;
        let steady = self.steady(&plant, corner).map_err(|e| MarginFailure::NoTrim(e.to_string()))?;
        let model = self.model(plant, &steady, corner).map_err(not_steady)?;
        match model.stability().map_err(not_steady)? {
            Stability::Stable => Ok(model),
            Stability::Marginal(what) => Err(MarginFailure::Marginal(what)),
            Stability::Unstable { growth, frequency } => Err(MarginFailure::Unstable { growth, frequency }),
        }
    }

    /// The disk margin of all commands at a corner.
    pub fn disk_margin(&self, corner: &Corner) -> std::result::Result<f64, MarginFailure> {
        let found = self.stable(corner)?.disk_margin(AnalysisPoint::Commands, 0.0);
        found.map(|disk| disk.alpha).map_err(|e| MarginFailure::NotSteady(e.to_string()))
    }

    /// The same without what sampling folds: more for loops of several rates, smooth in the gains, and found faster; 0 without one.
    pub fn unfolded_disk_margin(&self, corner: &Corner) -> f64 {
        self.at(corner).and_then(|model| model.unfolded_disk_margin()).unwrap_or(0.0)
    }

    /// Margins of all commands of the believed loop at hover.
    pub fn hover_margins(&self) -> Result<LoopMargins> {
        self.at(&Corner::nominal(0.0))?.margins(AnalysisPoint::Commands)
    }

    fn at(&self, corner: &Corner) -> Result<LoopModel> {
        let plant = self.plant(corner)?;
        let steady = self.steady(&plant, corner)?;
        self.model(plant, &steady, corner)
    }

    fn physics(&self) -> Physics {
        let mut physics = *self.physics;
        physics.effects.disturbance = true;
        physics
    }

    fn plant(&self, corner: &Corner) -> Result<Plant> {
        Plant::of_vehicle(&truth(self.vehicle, corner), self.physics())
    }

    fn air(&self, corner: &Corner) -> Disturbance<f64> {
        let mut air = self.air;
        air.wind[0] -= corner.speed;
        air
    }

    fn steady(&self, plant: &Plant, corner: &Corner) -> Result<Trim> {
        trim(plant, &TrimTarget { air: self.air(corner), ..TrimTarget::hover() })
    }

    /// The loop of the true plant under the law of the believed one.
    fn model(&self, plant: Plant, steady: &Trim, corner: &Corner) -> Result<LoopModel> {
        let law = CascadeLaw::new(self.vehicle, &self.physics(), self.gains, self.rates)?.with_filters(self.filters)?;
        let there = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
        let closed = ClosedLoop::new(plant, law.running())?.with_latency(self.latency)?;
        LoopModel::new(closed, Target::level(&there), &self.air(corner), &steady.state)
    }
}

/// The vehicle with mass, inertia, lag and centre of mass of a corner.
#[doc(hidden)]
pub fn truth(vehicle: &Vehicle, corner: &Corner) -> Vehicle {
    let mut truth = vehicle.clone();
    let center: [f64; 3] = vehicle.mass_properties().center_of_mass.into();
    // what the distance of a part adds to the inertia goes with its mass too
    let reach = (corner.inertia / corner.mass).sqrt();
    for part in &mut truth.parts {
        part.mass *= corner.mass;
        let shift = [corner.shift[0], corner.shift[1], 0.0];
        for ((x, c), off) in part.position.iter_mut().zip(center).zip(shift) {
            *x = c + reach * (*x - c) + off;
        }
        let i = &mut part.inertia;
        for j in [&mut i.xx, &mut i.yy, &mut i.zz, &mut i.xy, &mut i.xz, &mut i.yz] {
            *j *= corner.inertia;
        }
    }
    for rotor in &mut truth.rotors {
        rotor.time_constant_up *= corner.lag;
        rotor.time_constant_down *= corner.lag;
    }
    truth
}
