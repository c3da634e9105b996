//! A [`MarginGate`] as a part of the descent of [`tune`](mod@super::tune): while the least disk margin is short, the descent leaves out
//! what lowers it and climbs it; the gains that come out have passed the whole gate.

use super::margin_gate::{Corner, Flown, MarginGate};
use super::tune_plan::TunePlan;
use super::tuned_loop::gains_of;
use base::error::Result;
use base::parallel::Threads;
use dynamics::{Gains, Vehicle};

/// A gate as a part of the descent.
pub(super) struct Constraint<'a> {
    vehicle: &'a Vehicle,
    plan: &'a TunePlan,
    gate: &'a MarginGate,
    start: Gains,
    /// Corners that were worst when all were judged last.
    worst: Vec<Corner>,
    /// Those that ever were.
    critical: Vec<Corner>,
    /// ln K of least error among those whose worst corners passed, and that error.
    kept: Vec<(f64, Vec<f64>)>,
    /// What sampling folds takes off a margin, as a factor, at the corner that was worst when all were judged last.
    folding: f64,
}

/// Descent steps after which all corners are judged anew.
const JUDGED_EVERY: usize = 10;
/// Corners that are watched in between.
const WATCHED: usize = 3;
/// The margin is led to this much more than is asked, so that it is kept at the end.
const RESERVE: f64 = 1.06;
/// Most gains that are judged at the whole gate in the end.
const CANDIDATES: usize = 12;
/// Gains that change together where the slope of the margin is asked for: where roll and pitch are as short, neither alone helps.
const ALIKE: [&[usize]; 10] = [&[0, 1], &[2], &[3, 4], &[5], &[6, 7], &[8], &[9, 10], &[11], &[12], &[13]];
/// From a shortage of one in so many of what is asked on, the climb is as long as the gradient.
const HASTE: f64 = 10.0;
/// Relative change of a gain for slopes of the margin.
const NUDGE: f64 = 0.01;

/// Takes out of a gradient what would lower the margin, and adds a climb along its slope of `share` of the gradient's own size.
fn climb(gradient: &mut [f64], slopes: &[f64], share: f64) {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (size, steepness) = (dot(gradient, gradient).sqrt(), dot(slopes, slopes));
    if steepness == 0.0 || !steepness.is_finite() {
        return;
    }
    // a step goes against the gradient
    let lowers = (dot(gradient, slopes) / steepness).max(0.0);
    let climbs = share * size / steepness.sqrt();
    gradient.iter_mut().zip(slopes).for_each(|(g, slope)| *g -= (lowers + climbs) * slope);
}

impl<'a> Constraint<'a> {
    pub fn new(vehicle: &'a Vehicle, start: &Gains, plan: &'a TunePlan, gate: &'a MarginGate) -> Result<Self> {
        gate.validate()?;
        Ok(Self {
            vehicle,
            plan,
            gate,
            start: *start,
            worst: Vec::new(),
            critical: Vec::new(),
            kept: Vec::new(),
            folding: 1.0,
        })
    }

    fn flown<'b>(&'b self, gains: &'b Gains) -> Flown<'b> {
        Flown::in_still_air(self.vehicle, gains, &self.plan.physics, &self.plan.rates)
    }

    /// The margin at a corner, up to changes of the folding.
    fn alpha(&self, theta: &[f64], corner: &Corner) -> f64 {
        self.folding * self.flown(&gains_of(theta)).unfolded_disk_margin(corner)
    }

    /// Turns a gradient over ln K to where the margin rises, while it is short.
    pub fn lead(
        &mut self,
        iteration: usize,
        theta: &[f64],
        rmse: f64,
        gradient: &mut [f64],
        threads: &Threads,
    ) -> Result<()> {
        if iteration.is_multiple_of(JUDGED_EVERY) {
            let all = self.gate.corners();
            let alphas = threads.map(all.len(), |i| self.alpha(theta, &all[i]));
            let mut order: Vec<usize> = (0..all.len()).collect();
            order.sort_by(|a, b| alphas[*a].total_cmp(&alphas[*b]));
            self.worst = order.iter().take(WATCHED).map(|i| all[*i]).collect();
            let exact = self.flown(&gains_of(theta)).disk_margin(&self.worst[0]).unwrap_or(0.0);
            if exact > 0.0 && alphas[order[0]] > 0.0 {
                self.folding *= exact / alphas[order[0]];
            }
            let fresh: Vec<Corner> = self.worst.iter().filter(|c| !self.critical.contains(c)).copied().collect();
            self.critical.extend(fresh);
        }
        let alphas = threads.map(self.worst.len(), |i| self.alpha(theta, &self.worst[i]));
        let least = (0..alphas.len()).min_by(|a, b| alphas[*a].total_cmp(&alphas[*b])).unwrap_or(0);
        let (alpha, corner, wanted) = (alphas[least], self.worst[least], RESERVE * self.gate.disk);
        if alpha >= self.gate.disk {
            self.kept.push((rmse, theta.to_vec()));
        }
        let shortage = (1.0 - alpha / wanted).max(0.0);
        if shortage > 0.0 {
            let alike: Vec<&[usize]> = ALIKE.into_iter().filter(|of| of.iter().all(|i| *i < theta.len())).collect();
            let along = threads.map(alike.len(), |k| {
                let mut other = theta.to_vec();
                alike[k].iter().for_each(|i| other[*i] += NUDGE);
                (self.alpha(&other, &corner) - alpha) / NUDGE
            });
            let mut slopes = vec![0.0; theta.len()];
            for (of, slope) in alike.iter().zip(along) {
                of.iter().for_each(|i| slopes[*i] = slope / of.len() as f64);
            }
            climb(gradient, &slopes, (HASTE * shortage).min(1.0));
        }
        Ok(())
    }

    /// The best of those kept that pass the whole gate; if none does, the start.
    pub fn best(&self, threads: &Threads) -> Result<Gains> {
        let mut kept = self.kept.clone();
        kept.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, theta) in kept.iter().take(CANDIDATES) {
            let gains = gains_of(theta);
            let exact = |i: usize| self.flown(&gains).disk_margin(&self.critical[i]).unwrap_or(0.0);
            if threads.map(self.critical.len(), exact).iter().any(|alpha| *alpha < self.gate.disk) {
                continue;
            }
            if self.gate.judge(self.vehicle, &gains, &self.plan.physics, &self.plan.rates, threads)?.passes {
                return Ok(gains);
            }
        }
        Ok(self.start)
    }
}
