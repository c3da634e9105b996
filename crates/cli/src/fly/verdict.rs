//! Whether a flight is one, or why not: diverged, lost, into something, off its reference; what tells how near it was.

use super::What;
use super::around::Approach;
use super::flown::Flown;
use crate::prelude::*;
use omnidrones::controllers::{Mishap, RotorFailure};
use omnidrones::dynamics::aero::wind::Wind;
use omnidrones::flight::{FlightSummary, LOST};

impl Flown {
    /// Whether it flew, or why not.
    pub fn verdict(&self, max_rmse: Option<f64>) -> std::result::Result<(), String> {
        if let Some(t) = self.flight.diverged_at {
            return Err(format!(
                "the flight diverged at {} s: gains too high for dt, or a reference or shape beyond what flies",
                short(t, 4)
            ));
        }
        if let Some((at, far)) = self.flight.lost() {
            let (at, far) = (short(at, 4), length(far));
            let left = self.story.as_ref().map_or_else(String::new, |s| format!(" ({})", s.left()));
            return Err(match &self.what {
                What::Vehicle { .. } => {
                    format!(
                        "the vehicle was lost at {at} s, too far from its reference, and came as far as {far} from it{left}"
                    )
                }
                What::Model(robot) => format!(
                    "the vehicle was lost at {at} s: '{}' came as far as {far} from its reference; {}",
                    robot.model.name(),
                    self.advice()
                ),
            });
        }
        if let Some(touch) = self.approach.as_ref().and_then(Approach::touch) {
            return Err(touch);
        }
        if let Some(mishap) = self.judgement.mishaps.first() {
            let remedy = match mishap {
                Mishap::ReferenceBelowGround { .. } => ": raise it, or leave the ground out by --no-ground",
                _ => "",
            };
            let broken = if self.plan.failures.is_empty() { String::new() } else { format!(" ({})", self.failed()) };
            return Err(format!("{mishap}{broken}{remedy}"));
        }
        tracked(&self.summary, max_rmse)
    }

    /// Which rotors failed.
    fn failed(&self) -> String {
        let rotors = self.plant.rotors();
        let one = |f: &RotorFailure| {
            let name = rotors.get(f.rotor).map_or("", |rotor| rotor.name.as_str());
            let lost = if f.effectiveness > 0.0 { "weakened" } else { "was lost" };
            format!("rotor '{name}' {lost} at {} s", short(f.at, 4))
        };
        self.plan.failures.iter().map(one).collect::<Vec<_>>().join(", ")
    }

    /// What to try with a configuration that was lost: what was asked of it, undone.
    fn advice(&self) -> String {
        if !self.plan.failures.is_empty() {
            return format!("{}: it does not fly without; leave out --fail, or weaken it less", self.failed());
        }
        let asked = [
            ("less of --roll, --pitch or --shape", !self.flight.log.asked_angles.is_empty()),
            ("less of --wind", self.plan.wind != Wind::Calm),
            ("less of --latency", self.plan.latency > 0),
        ];
        let asked = asked.into_iter().filter(|(_, given)| *given).map(|(what, _)| what);
        let all: Vec<&str> = std::iter::once("try a slower --reference, or hover").chain(asked).collect();
        all.join(", ")
    }

    /// How near the ground it came.
    pub fn lowest_fact(&self) -> Fact {
        let (lowest, simulated) = (self.judgement.lowest, self.plan.physics.effects.contact);
        let ground = match (self.judgement.ground, lowest < 0.0) {
            (false, _) => "of all bodies and rotors above z = 0; the ground is left out",
            (true, false) => "of all bodies and rotors above the ground, over the whole flight",
            (true, true) if simulated => "of all bodies and rotors above the ground: it touched it",
            (true, true) => "below the ground, which nothing stops it at",
        };
        Fact::new("lowest point", format!("{} m", short(lowest, 3))).note(ground)
    }

    /// How the heading kept to the reference's yaw.
    pub fn heading_fact(&self) -> Fact {
        let degrees = |v: Option<f64>| format!("{}°", number(v.map(f64::to_degrees), 2));
        let s = &self.summary;
        Fact::new("heading error", degrees(s.heading_rmse))
            .note(format!("RMSE about body z, from the reference's yaw; {} at most", degrees(s.max_heading_error)))
    }
}

/// Whether a flight kept to its reference, or why not.
pub fn tracked(summary: &FlightSummary, max_rmse: Option<f64>) -> std::result::Result<(), String> {
    if let Some(since) = summary.lost_at {
        let far = length(summary.max_error_overall);
        return Err(format!(
            "the reference was lost: farther than {} from {} s to the end, {far} at most",
            length(LOST),
            short(since, 3)
        ));
    }
    match (summary.rmse, max_rmse) {
        (None, _) => Err("the tracking RMSE is not finite".into()),
        (Some(rmse), Some(limit)) if rmse > limit => {
            Err(format!("the tracking RMSE of {} exceeds --max-rmse {}", length(rmse), length(limit)))
        }
        _ => Ok(()),
    }
}
