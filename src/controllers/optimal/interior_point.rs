//! An interior-point method for a [`StageQp`](super::StageQp): bounds as barriers that grow steeper.
//!
//! A bound of a number v has a slack t and a multiplier y, both > 0: t = b − v + y/w above, t = v − b + y/w below, with w the weight of a soft
//! bound and 1/w = 0 for a hard one. Steps of Newton's method for t y = μ leave a program without bounds, whose diagonal has
//! y/(t + y/w) more: one Riccati recursion gives the predictor (μ = 0) and the corrector (μ as small as the predictor allows). Inputs stay
//! strictly within their bounds, and the dynamics are kept by every iterate.
//!
//! Source: Mehrotra 1992; Rao, Wright and Rawlings 1998 (the recursion inside); Nocedal and Wright 2006, section 16.6.

use super::stage_qp::{Blocks, Sizes, StageQp};

/// A bound, its slack and its multiplier.
#[derive(Debug, Clone, Copy)]
pub(super) struct Barrier {
    pub stage: usize,
    /// Number in z.
    pub at: usize,
    /// 1 above, −1 below.
    pub sign: f64,
    bound: f64,
    /// 1/w; 0 of a hard bound.
    softness: f64,
    pub slack: f64,
    pub multiplier: f64,
    /// Of the step.
    slack_step: f64,
    multiplier_step: f64,
    /// Products of the predictor's steps.
    second_order: f64,
}

/// Share of the way to the nearest bound that a step goes at most.
const SHARE: f64 = 0.995;

/// Barriers of all bounds of a program.
#[derive(Debug, Clone, Default)]
pub(super) struct Barriers {
    pub all: Vec<Barrier>,
}

impl Barrier {
    /// Whether the last step drew it to its bound: the slack vanishes faster than the multiplier.
    pub(super) fn is_active(&self) -> bool {
        // (t + δt)/t < (y + δy)/y
        self.slack_step * self.multiplier < self.multiplier_step * self.slack
    }

    /// σ(b − v) + y/w − t.
    fn residual(&self, value: f64) -> f64 {
        self.sign * (self.bound - value) + self.softness * self.multiplier - self.slack
    }

    fn curvature(&self) -> f64 {
        self.multiplier / (self.slack + self.softness * self.multiplier)
    }
}

impl Barriers {
    /// Of the bounds of a program, inputs put within them: hard ones first. Bounds of a single value have none.
    pub(super) fn begin(&mut self, qp: &StageQp, z: &mut Blocks) {
        let Sizes { m, stages, .. } = qp.sizes;
        self.all.clear();
        let mut push = |stage, at, sign, bound: f64, softness| {
            if bound.is_finite() {
                let [slack, multiplier, slack_step, multiplier_step, second_order] = [0.0; 5];
                self.all.push(Barrier {
                    stage,
                    at,
                    sign,
                    bound,
                    softness,
                    slack,
                    multiplier,
                    slack_step,
                    multiplier_step,
                    second_order,
                });
            }
        };
        for k in 0..stages {
            let (own, lower, upper) = (z.of_mut(k), qp.lower.of(k), qp.upper.of(k));
            for i in 0..m {
                if lower[i] < upper[i] {
                    own[i] = inside(own[i], lower[i], upper[i]);
                    push(k, i, -1.0, lower[i], 0.0);
                    push(k, i, 1.0, upper[i], 0.0);
                }
            }
        }
        for (k, bounds) in qp.soft.iter().enumerate() {
            for bound in bounds.iter().filter(|bound| bound.weight > 0.0) {
                push(k + 1, qp.sizes.first + bound.state, -1.0, bound.lower, 1.0 / bound.weight);
                push(k + 1, qp.sizes.first + bound.state, 1.0, bound.upper, 1.0 / bound.weight);
            }
        }
    }

    /// Slacks and multipliers at a point with slopes `g` of inputs.
    pub(super) fn centre(&mut self, z: &Blocks, costates: &Blocks, first: usize) {
        let of = |b: &Barrier| b.sign * (b.bound - z.of(b.stage)[b.at]);
        // what bounds have to hold against: slopes times slacks of inputs, on average
        let hard = self.all.iter().filter(|b| b.at < first);
        let (sum, n) = hard.fold((0.0, 0.0), |(sum, n), b| (sum + of(b) * costates.of(b.stage)[b.at].abs(), n + 1.0));
        let mu = (sum / f64::max(n, 1.0)).max(1e-12);
        for b in &mut self.all {
            let own = of(b);
            if b.softness > 0.0 {
                // on the central path: t y = μ, t = own + y/w
                let half = 0.5 * own;
                b.slack = half + (half * half + mu * b.softness).sqrt();
                b.slack = b.slack.max(1e-9 * (1.0 + own.abs()));
            } else {
                b.slack = own;
            }
            b.multiplier = mu / b.slack;
        }
    }

    /// Mean of t y.
    pub(super) fn mu(&self) -> f64 {
        self.all.iter().map(|b| b.slack * b.multiplier).sum::<f64>() / self.all.len() as f64
    }

    /// Adds their curvatures.
    pub(super) fn add_curvature(&self, added: &mut Blocks) {
        for b in &self.all {
            added.of_mut(b.stage)[b.at] += b.curvature();
        }
    }

    /// Adds what they push with to the slopes, for products t y → μ but for those of the predictor's steps.
    pub(super) fn add_push(&self, z: &Blocks, mu: f64, w: &mut Blocks) {
        for b in &self.all {
            let residual = b.residual(z.of(b.stage)[b.at]);
            let wanted = mu - b.slack * b.multiplier - b.second_order - b.multiplier * residual;
            let push = b.multiplier + wanted / (b.slack + b.softness * b.multiplier);
            w.of_mut(b.stage)[b.at] += b.sign * push;
        }
    }

    /// Steps of slacks and multipliers that follow from a step of z; the largest share of it that keeps all of them positive.
    pub(super) fn follow(&mut self, z: &Blocks, step: &Blocks, mu: f64) -> f64 {
        let mut longest = f64::INFINITY;
        for b in &mut self.all {
            let (value, moved) = (z.of(b.stage)[b.at], step.of(b.stage)[b.at]);
            let residual = b.residual(value);
            let wanted = mu - b.slack * b.multiplier - b.second_order - b.multiplier * residual;
            let room = b.slack + b.softness * b.multiplier;
            b.multiplier_step = (wanted + b.multiplier * b.sign * moved) / room;
            b.slack_step = -b.sign * moved + b.softness * b.multiplier_step + residual;
            for (own, step) in [(b.slack, b.slack_step), (b.multiplier, b.multiplier_step)] {
                if own + step * longest < 0.0 {
                    longest = -own / step;
                }
            }
        }
        longest
    }

    /// Mean of t y after a share of the steps.
    pub(super) fn mu_after(&self, share: f64) -> f64 {
        let of = |b: &Barrier| (b.slack + share * b.slack_step) * (b.multiplier + share * b.multiplier_step);
        self.all.iter().map(of).sum::<f64>() / self.all.len() as f64
    }

    /// Keeps the products of the predictor's steps for the corrector, or forgets them.
    pub(super) fn keep_second_order(&mut self, keeps: bool) {
        for b in &mut self.all {
            b.second_order = if keeps { b.slack_step * b.multiplier_step } else { 0.0 };
        }
    }

    /// Goes a share of the steps.
    pub(super) fn advance(&mut self, share: f64) {
        for b in &mut self.all {
            b.slack += share * b.slack_step;
            b.multiplier += share * b.multiplier_step;
        }
    }

    /// The share of a step that is taken where `longest` would reach the nearest bound.
    pub(super) fn taken(longest: f64) -> f64 {
        (SHARE * longest).min(1.0)
    }
}

/// A value well within bounds, near where it was.
fn inside(value: f64, lower: f64, upper: f64) -> f64 {
    let value = if value.is_finite() { value } else { 0.0 };
    let margin = if (upper - lower).is_finite() { 0.1 * (upper - lower) } else { 0.1 * (1.0 + value.abs()) };
    value.max(lower + margin).min(upper - margin)
}
