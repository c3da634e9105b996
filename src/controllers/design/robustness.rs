//! What a loop bears in a box of plants: how many of random plants are stable, and the least disk margin that is found in it.
//!
//! The box holds mass, inertia and motor lag between 1 − spread and 1 + spread of what is believed, and the centre of mass up to a
//! shift off along both axes; the law keeps believing. Random plants give the share of stable ones with exact bounds. The least margin
//! is looked for at the corners, and from the worst of them by a pattern search over the box: along every number both ways, to the
//! best of these, with half the step where none is worse. It finds a local worst case: an upper bound of the least margin.
//!
//! Source: Clopper and Pearson 1934 for the bounds; Torczon 1997 for the search.

use super::margin_gate::{Corner, Flown, MarginFailure};
use crate::cascade::Rates;
use crate::cascade_law::CascadeLaw;
use crate::confidence::Proportion;
use crate::filter::FilterSettings;
use base::error::{Error, Result};
use base::parallel::Threads;
use dynamics::{Disturbance, Gains, Physics, Vehicle};
use rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};

/// Which plants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlantUncertainty {
    /// Mass, inertia and motor lag between 1 − spread and 1 + spread of what is believed; [0, 0.9]. Default 0.3.
    pub spread: f64,
    /// How far the centre of mass may lie off, forward and to the left, m; [0, 10]. Default 0.
    pub shift: f64,
    /// Random plants, 1 to 1 000 000. Default 200.
    pub samples: usize,
    /// Confidence of the bounds; [0.5, 0.999999]. Default 0.95.
    pub confidence: f64,
    /// Of the random plants. Default 0.
    pub seed: u64,
}

impl Default for PlantUncertainty {
    /// ±30 %, the centre of mass where it is believed, 200 plants, 95 %.
    fn default() -> Self {
        Self { spread: 0.3, shift: 0.0, samples: 200, confidence: 0.95, seed: 0 }
    }
}

/// Most random plants.
pub const MAX_SAMPLES: usize = 1_000_000;
/// First step of the search, and the last, of half the width of the box.
const STEPS: [f64; 2] = [0.5, 0.06];

impl PlantUncertainty {
    /// Checks the ranges given with the fields.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] that names the first outside.
    pub fn validate(&self) -> Result<()> {
        let rows = [
            ("spread", self.spread, 0.0..=0.9, "within [0, 0.9]"),
            ("shift", self.shift, 0.0..=10.0, "within [0, 10] m"),
            ("confidence", self.confidence, 0.5..=0.999_999, "within [0.5, 0.999999]"),
        ];
        for (what, value, range, rule) in rows {
            if !range.contains(&value) {
                return Err(Error::value(what, value, rule, "Leave it out for the default."));
            }
        }
        if !(1..=MAX_SAMPLES).contains(&self.samples) {
            let limit = format!("1 to {MAX_SAMPLES}");
            return Err(Error::limit("samples", self.samples, limit, "200 is the default."));
        }
        Ok(())
    }

    /// The plant at a place of [−1, 1]⁵: mass, inertia, lag, shift forward and left.
    fn at(&self, place: &[f64; N_NUMBER]) -> Corner {
        let factor = |k: usize| 1.0 + self.spread * place[k];
        let shift = [self.shift * place[3], self.shift * place[4]];
        Corner { mass: factor(0), inertia: factor(1), lag: factor(2), shift, ..Corner::nominal(0.0) }
    }

    /// Which numbers vary.
    fn axes(&self) -> Vec<usize> {
        (0..N_NUMBER).filter(|k| if *k < 3 { self.spread > 0.0 } else { self.shift > 0.0 }).collect()
    }
}

/// Mass, inertia, lag, two shifts.
const N_NUMBER: usize = 5;

/// A plant and its disk margin of all commands at once.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlantMargin {
    /// As factors of the believed one.
    pub plant: Corner,
    /// Disk margin α; 0 where the loop has none.
    pub disk: f64,
    /// Why it has none.
    pub flaw: Option<MarginFailure>,
}

/// What a loop bears in a box.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Robustness {
    /// Which box.
    pub plants: PlantUncertainty,
    /// Share of the random plants whose loop is stable.
    pub stable: Proportion,
    /// One of those that are not.
    pub unstable: Option<PlantMargin>,
    /// The plant as believed.
    pub nominal: PlantMargin,
    /// The corner of least margin.
    pub corner: PlantMargin,
    /// The plant of least margin among the believed one, the corners, the search from the worst corner, and a random plant whose loop is
    /// not stable; of the other random plants only stability is judged.
    pub worst: PlantMargin,
    /// Margins that were found for this.
    pub n_judged: usize,
}

/// Judges gains of a vehicle's cascade in hover over a box of plants, with filters of the measured angular velocity, with commands
/// `latency` steps late, in steady air.
///
/// # Errors
/// As [`PlantUncertainty::validate`]; [`Error::Value`] where vehicle, gains, rates or filters are not valid.
pub fn robustness(
    vehicle: &Vehicle,
    gains: &Gains,
    (physics, rates, filters): (&Physics, &Rates, &[FilterSettings]),
    latency_and_air: (usize, &Disturbance<f64>),
    plants: &PlantUncertainty,
    threads: &Threads,
) -> Result<Robustness> {
    let (latency, air) = latency_and_air;
    plants.validate()?;
    // what cannot fly at all is told before it is judged
    CascadeLaw::new(vehicle, physics, gains, rates)?.with_filters(filters)?;
    let flown = Flown { filters, latency, air: *air, ..Flown::in_still_air(vehicle, gains, physics, rates) };
    let flaws = threads.map(plants.samples, |i| {
        let mut stream = Stream::new(plants.seed, i as u64, 0, Purpose::PARAMETERS);
        let plant = Corner::drawn(&mut stream, 0.0, plants.spread, plants.shift);
        flown.stable(&plant).err().map(|flaw| PlantMargin { plant, disk: 0.0, flaw: Some(flaw) })
    });
    let stable = flaws.iter().filter(|flaw| flaw.is_none()).count();
    let search = Search { flown, plants, threads };
    let nominal = search.judge(&[0.0; N_NUMBER]);
    let corners = search.corners();
    let judged = search.all(&corners);
    let least = least_of(&judged).unwrap_or(0);
    let (found, n_searched) = search.down_from(corners[least], judged[least].clone());
    let unstable = flaws.into_iter().flatten().next();
    let all: Vec<PlantMargin> = [Some(found), Some(nominal.clone()), unstable.clone()].into_iter().flatten().collect();
    let worst = all[least_of(&all).unwrap_or(0)].clone();
    Ok(Robustness {
        plants: *plants,
        stable: Proportion::counted(stable, plants.samples, plants.confidence),
        unstable,
        nominal,
        corner: judged[least].clone(),
        worst,
        n_judged: 1 + corners.len() + n_searched,
    })
}

/// Place of the first of least margin.
fn least_of(judged: &[PlantMargin]) -> Option<usize> {
    (0..judged.len()).min_by(|a, b| judged[*a].disk.total_cmp(&judged[*b].disk))
}

/// Looks for small margins in a box.
struct Search<'a> {
    flown: Flown<'a>,
    plants: &'a PlantUncertainty,
    threads: &'a Threads,
}

impl Search<'_> {
    fn judge(&self, place: &[f64; N_NUMBER]) -> PlantMargin {
        let plant = self.plants.at(place);
        match self.flown.disk_margin(&plant) {
            Ok(disk) => PlantMargin { plant, disk, flaw: None },
            Err(flaw) => PlantMargin { plant, disk: 0.0, flaw: Some(flaw) },
        }
    }

    fn all(&self, places: &[[f64; N_NUMBER]]) -> Vec<PlantMargin> {
        self.threads.map(places.len(), |i| self.judge(&places[i]))
    }

    fn corners(&self) -> Vec<[f64; N_NUMBER]> {
        let axes = self.plants.axes();
        let corner = |bits: usize| {
            let mut place = [0.0; N_NUMBER];
            axes.iter().enumerate().for_each(|(k, axis)| place[*axis] = if bits >> k & 1 == 0 { -1.0 } else { 1.0 });
            place
        };
        (0..1 << axes.len()).map(corner).collect()
    }

    /// The pattern search, and how many margins it found; nothing is worse than none.
    fn down_from(&self, mut place: [f64; N_NUMBER], mut worst: PlantMargin) -> (PlantMargin, usize) {
        let (mut step, mut n) = (STEPS[0], 0);
        while step >= STEPS[1] && worst.disk > 0.0 {
            let mut around = Vec::new();
            for axis in self.plants.axes() {
                for way in [-step, step] {
                    let mut other = place;
                    other[axis] = (other[axis] + way).clamp(-1.0, 1.0);
                    if other != place {
                        around.push(other);
                    }
                }
            }
            let judged = self.all(&around);
            n += judged.len();
            match least_of(&judged).filter(|k| judged[*k].disk < worst.disk) {
                Some(k) => (place, worst) = (around[k], judged[k].clone()),
                None => step *= 0.5,
            }
        }
        (worst, n)
    }
}
