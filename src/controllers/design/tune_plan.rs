//! What gains are tuned on.

use super::margin_gate::MarginGate;
use crate::cascade::Rates;
use crate::closed_loop::check_latency;
use crate::reference::Reference;
use base::error::{Error, Result};
use dynamics::Physics;
use serde::{Deserialize, Serialize};

/// What to tune on, and for how long.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TunePlan {
    /// The reference of every flight. Default: the lemniscate.
    pub reference: Reference,
    /// Length of a flight, s; 1 to 100 000 steps. Default 6.
    pub duration: f64,
    /// Time step, integrator, effects.
    pub physics: Physics,
    /// How often each control level computes.
    pub rates: Rates,
    /// Training starts, 1 to 65 536. Default 64.
    pub n_start: usize,
    /// Held-out starts, 1 to 65 536, drawn from other streams. Default 256.
    pub n_held_out: usize,
    /// Largest offset of a start from the reference, m per axis; [0, 100]. Default 0.3.
    pub position_spread: f64,
    /// Largest velocity of a start, m/s per axis; [0, 100]. Default 0.3.
    pub velocity_spread: f64,
    /// Largest roll and pitch of a start, rad; yaw spreads twice as far. [0, 1.5]. Default 0.2.
    pub tilt_spread: f64,
    /// Descent steps, 1 to 100 000. Default 60.
    pub iterations: usize,
    /// Relative change of a gain per step, at first; it falls to a tenth by the end. [0, 1]. Default 0.08.
    pub learning_rate: f64,
    /// Seed of the starts. Default 0.
    pub seed: u64,
    /// Further references, of the same weight as the first. Default none.
    pub also: Vec<Reference>,
    /// Steps by which commands act late, 0 to 1000. Default 0.
    pub latency: usize,
    /// Margins that the gains must have. Default none.
    pub margins: Option<MarginGate>,
    /// References that gains are judged on and not tuned on. Default none.
    pub held_out: Vec<Reference>,
    /// Plants of all flights: mass, inertia and motor lag are drawn, each between 1 − spread and 1 + spread of what is believed;
    /// [0, 0.9]. Default 0.
    pub plant_spread: f64,
}

impl Default for TunePlan {
    /// Six seconds of the lemniscate from 64 starts within 0.3 m, 0.3 m/s and 0.2 rad, 60 descent steps.
    fn default() -> Self {
        Self {
            reference: Reference::Lemniscate(Default::default()),
            duration: 6.0,
            physics: Physics::default(),
            rates: Rates::default(),
            n_start: 64,
            n_held_out: 256,
            position_spread: 0.3,
            velocity_spread: 0.3,
            tilt_spread: 0.2,
            iterations: 60,
            learning_rate: 0.08,
            seed: 0,
            also: Vec::new(),
            latency: 0,
            margins: None,
            held_out: Vec::new(),
            plant_spread: 0.0,
        }
    }
}

/// Largest number of starts or held-out starts.
pub const MAX_STARTS: usize = 1 << 16;

impl TunePlan {
    /// All references that are tuned on.
    pub fn references(&self) -> impl Iterator<Item = &Reference> {
        std::iter::once(&self.reference).chain(&self.also)
    }

    /// Those, then the ones that are held out.
    pub(super) fn all_references(&self) -> impl Iterator<Item = &Reference> {
        self.references().chain(&self.held_out)
    }

    pub(super) fn n_step(&self) -> Result<usize> {
        self.physics.validate()?;
        self.all_references().try_for_each(Reference::validate)?;
        check_latency(self.latency)?;
        self.margins.iter().try_for_each(MarginGate::validate)?;
        for (what, n, least, most) in [
            ("n_start", self.n_start, 1, MAX_STARTS),
            ("n_held_out", self.n_held_out, 1, MAX_STARTS),
            ("iterations", self.iterations, 1, 100_000),
        ] {
            if n < least || n > most {
                return Err(Error::limit(what, n, format!("{least} to {most}"), "The defaults are a good start."));
            }
        }
        for (what, value, most) in [
            ("position_spread", self.position_spread, 100.0),
            ("velocity_spread", self.velocity_spread, 100.0),
            ("tilt_spread", self.tilt_spread, 1.5),
            ("learning_rate", self.learning_rate, 1.0),
            ("plant_spread", self.plant_spread, 0.9),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err(Error::value(what, value, format!("in [0, {most}]"), "Leave it out for the default."));
            }
        }
        let steps = (self.duration / self.physics.dt).round();
        if !(1.0..=100_000.0).contains(&steps) {
            let value = format!("{} s ({steps} steps of {} s)", self.duration, self.physics.dt);
            return Err(Error::limit("duration", value, "1 to 100000 steps", "Tune on a shorter flight."));
        }
        Ok(steps as usize)
    }
}
