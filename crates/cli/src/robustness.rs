//! `omnidrones design --spread`: the same loop over a box of plants.

use crate::prelude::*;
use omnidrones::controllers::design::robustness::robustness;
use omnidrones::controllers::design::{PlantMargin, PlantUncertainty, Robustness};
use omnidrones::controllers::{FilterSettings, Rates};
use omnidrones::dynamics::{Disturbance, Gains, Physics, Vehicle};
use omnidrones::parallel::Threads;

/// Which plants to judge.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Plants")]
pub struct PlantArguments {
    /// Judge the loop on plants whose mass, inertia and motor lag lie within 1 ± SHARE of what is believed
    #[arg(long, value_name = "SHARE")]
    spread: Option<f64>,
    /// How far the centre of mass may lie off, forward and to the left [m]
    #[arg(long, value_name = "METRES", default_value_t = 0.0, requires = "spread")]
    shift: f64,
    /// Random plants
    #[arg(long, value_name = "N", default_value_t = PlantUncertainty::default().samples, requires = "spread")]
    samples: usize,
    /// Seed of the plants
    #[arg(long, value_name = "N", default_value_t = 0, requires = "spread")]
    seed: u64,
}

impl PlantArguments {
    /// The spread, where it is asked for.
    pub fn spread(&self) -> Option<f64> {
        self.spread
    }

    /// Judges the loop where it is asked to.
    pub fn judge(
        &self,
        vehicle: &Vehicle,
        gains: &Gains,
        flown: (&Physics, &Rates, &[FilterSettings]),
        outside: (usize, &Disturbance<f64>),
    ) -> Result<Option<Robustness>> {
        let Some(spread) = self.spread else { return Ok(None) };
        let plants = PlantUncertainty {
            spread,
            shift: self.shift,
            samples: self.samples,
            seed: self.seed,
            ..PlantUncertainty::default()
        };
        robustness(vehicle, gains, flown, outside, &plants, &Threads::default()).map(Some)
    }
}

/// The share of stable plants, and the plants of least margin.
pub fn tell(page: &mut Page, found: &Robustness) {
    page.heading("Plants not as believed").facts(facts(found)).table(table(found));
    for line in flaws(found) {
        page.line(line);
    }
}

/// The box, and how many of its plants are stable.
fn facts(found: &Robustness) -> Vec<Fact> {
    let PlantUncertainty { spread, shift, samples, confidence, .. } = found.plants;
    let percent = |share: f64| short(100.0 * share, 3);
    let [low, high] = found.stable.bounds.map(percent);
    vec![
        Fact::new("box", format!("mass, inertia and lag ± {} %", percent(spread)))
            .note(format!("centre of mass ± {} mm forward and left", short(1e3 * shift, 3))),
        Fact::new("stable", format!("{} of {samples} random plants", found.stable.hits))
            .note(format!("with {} % confidence {low} to {high} % of all", percent(confidence))),
        Fact::new("least disk margin", short(found.worst.disk, 3)).note(format!(
            "of {} plants: the corners, and a search from the worst; 0 where a random one is unstable",
            found.n_judged
        )),
    ]
}

/// Plants with a name in the report.
fn named(found: &Robustness) -> [(&'static str, Option<&PlantMargin>); 4] {
    [
        ("as believed", Some(&found.nominal)),
        ("worst corner", Some(&found.corner)),
        ("worst found", Some(&found.worst)),
        ("a random unstable", found.unstable.as_ref()),
    ]
}

/// Their factors and margins.
fn table(found: &Robustness) -> Table {
    Table::new("plant | >mass | >inertia | >lag | >forward [mm] | >left [mm] | >disk").filled(
        named(found).into_iter().filter_map(|(name, one)| Some((name, one?))).map(
            |(name, PlantMargin { plant, disk, .. })| {
                let factor = |f: f64| format!("× {}", short(f, 3));
                let [forward, left] = plant.shift.map(|s| short(1e3 * s, 3));
                [
                    name.to_string(),
                    factor(plant.mass),
                    factor(plant.inertia),
                    factor(plant.lag),
                    forward,
                    left,
                    short(*disk, 3),
                ]
            },
        ),
    )
}

/// Why some have no margin.
fn flaws(found: &Robustness) -> Vec<String> {
    let told = |(name, one): (&str, Option<&PlantMargin>)| Some(format!("  {name}: {}", one?.flaw.as_ref()?));
    named(found).into_iter().filter_map(told).collect()
}
