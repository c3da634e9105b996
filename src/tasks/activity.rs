//! How busy a policy keeps the rotors: commands that jump in every step hold a simulated drone still and wear out a motor,
//! and no figure of success shows them.

use super::env::Env;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Activity of the commands c of rotors, each in \[−1, 1\] ([`Env::rotor_commands_into`]), over the episodes of an evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Activity {
    /// Mean of |c_t − c_{t−1}| over the rotors and steps of an episode, then over episodes.
    pub change: f64,
    /// The same over the last second of every episode.
    pub last_second: f64,
    /// Share of the power of c about its mean that lies above a quarter of the rate of steps, where a command swings within four
    /// steps: Σy²/Σ(c − c̄)² over all episodes, y the output of a half-band filter of 31 taps (Hamming's window). 0 where c stands
    /// still, and of episodes shorter than the filter.
    pub fast: f64,
}

/// Activity in one episode.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EpisodeActivity {
    /// See [`Activity::change`].
    pub change: f64,
    /// See [`Activity::last_second`].
    pub last_second: f64,
    /// Σy² and Σ(c − c̄)² of [`Activity::fast`], over the rotors.
    pub power: [f64; 2],
}

impl Activity {
    /// Over episodes; NaN of none.
    pub fn over(episodes: &[EpisodeActivity]) -> Self {
        let n = episodes.len() as f64;
        let sum = |of: fn(&EpisodeActivity) -> f64| episodes.iter().map(of).sum::<f64>();
        let (fast, all) = (sum(|e| e.power[0]), sum(|e| e.power[1]));
        Self {
            change: sum(|e| e.change) / n,
            last_second: sum(|e| e.last_second) / n,
            fast: if all > 0.0 { fast / all } else { 0.0 },
        }
    }
}

/// Most distant tap of the filter, steps.
const REACH: usize = 15;
const TAPS: usize = 2 * REACH + 1;

/// Tap k of the ideal filter that lets pass what is above a quarter of the rate, −sin(πk/2)/(πk), through Hamming's window.
fn tap(k: usize) -> f64 {
    let x = k as f64;
    let window = 0.54 + 0.46 * (PI * x / (REACH + 1) as f64).cos();
    if k == 0 { 0.5 } else { -(0.5 * PI * x).sin() / (PI * x) * window }
}

/// Watches the commands of all environments, step by step.
pub(super) struct Commands {
    /// Rotors of an environment.
    n: usize,
    /// Of this step, `[E, n]`.
    now: Vec<f32>,
    episodes: Vec<EpisodeCommands>,
    taps: [f64; REACH + 1],
}

/// What is kept of one episode.
#[derive(Clone)]
struct EpisodeCommands {
    /// The last commands, `[TAPS, n]`, that of step t in row t mod TAPS.
    rows: Vec<f32>,
    /// The last second's mean changes, that of step t in place t mod its length.
    recent: Vec<f64>,
    n_step: usize,
    change: f64,
    /// Σy².
    fast: f64,
    /// Per rotor Σ(c − c_0) and Σ(c − c_0)² of the commands that were filtered.
    sums: Vec<[f64; 2]>,
    first: Vec<f32>,
}

impl Commands {
    pub(super) fn of(env: &Env) -> Self {
        let (spec, n) = (env.spec(), env.n_rotor());
        let second = ((1.0 / spec.dt).round() as usize).clamp(1, spec.horizon.max(1));
        let one = EpisodeCommands {
            rows: vec![0.0; TAPS * n],
            recent: vec![0.0; second],
            n_step: 0,
            change: 0.0,
            fast: 0.0,
            sums: vec![[0.0; 2]; n],
            first: vec![0.0; n],
        };
        Self { n, now: vec![0.0; spec.n_env * n], episodes: vec![one; spec.n_env], taps: std::array::from_fn(tap) }
    }

    /// Takes in the commands of the environments that fly.
    pub(super) fn see(&mut self, env: &Env, flying: &[bool]) -> base::error::Result<()> {
        env.rotor_commands_into(&mut self.now)?;
        let rows = self.now.chunks_exact(self.n.max(1));
        for ((own, row), _) in self.episodes.iter_mut().zip(rows).zip(flying).filter(|(_, flies)| **flies) {
            own.take(row, &self.taps);
        }
        Ok(())
    }

    pub(super) fn episodes(&self) -> Vec<EpisodeActivity> {
        self.episodes.iter().map(EpisodeCommands::activity).collect()
    }
}

impl EpisodeCommands {
    fn row(&self, step: usize) -> &[f32] {
        let n = self.first.len();
        &self.rows[step % TAPS * n..][..n]
    }

    fn take(&mut self, row: &[f32], taps: &[f64; REACH + 1]) {
        let (t, n) = (self.n_step, row.len());
        if t == 0 {
            self.first.copy_from_slice(row);
        } else {
            let before = self.row(t - 1);
            let change = row.iter().zip(before).map(|(c, b)| f64::from((c - b).abs())).sum::<f64>() / n as f64;
            self.change += change;
            let place = t % self.recent.len();
            self.recent[place] = change;
        }
        self.rows[t % TAPS * n..][..n].copy_from_slice(row);
        self.n_step += 1;
        if self.n_step >= TAPS {
            self.filter(t - REACH, taps);
        }
    }

    /// Takes the commands of a step into the powers; as many follow as are known before.
    fn filter(&mut self, step: usize, taps: &[f64; REACH + 1]) {
        // behind the last row stands the first, so that a tap finds its rows without a division
        let (n, oldest, middle) = (self.first.len(), (step + REACH + 1) % TAPS, step % TAPS);
        let place = |k: usize| if k < TAPS { k } else { k - TAPS };
        for i in 0..n {
            let at = |row: usize| f64::from(self.rows[row * n + i] - self.first[i]);
            let side = |k: usize| taps[k] * (at(place(oldest + REACH - k)) + at(place(oldest + REACH + k)));
            let sides = (1..=REACH).step_by(2).map(side);
            let (c, y) = (at(middle), taps[0] * at(middle) + sides.sum::<f64>());
            self.fast += y * y;
            self.sums[i][0] += c;
            self.sums[i][1] += c * c;
        }
    }

    fn activity(&self) -> EpisodeActivity {
        let changes = self.n_step.saturating_sub(1);
        let recent = changes.min(self.recent.len());
        let last = (0..recent).map(|k| self.recent[(self.n_step - 1 - k) % self.recent.len()]).sum::<f64>();
        let filtered = (self.n_step + 1).saturating_sub(TAPS).max(1) as f64;
        let about_mean = self.sums.iter().map(|[sum, squares]| (squares - sum * sum / filtered).max(0.0)).sum();
        let share = |sum: f64, n: usize| if n == 0 { 0.0 } else { sum / n as f64 };
        EpisodeActivity {
            change: share(self.change, changes),
            last_second: share(last, recent),
            power: [self.fast, about_mean],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flown(recent: usize, commands: impl Iterator<Item = f32>) -> EpisodeActivity {
        let mut own = EpisodeCommands {
            rows: vec![0.0; TAPS],
            recent: vec![0.0; recent],
            n_step: 0,
            change: 0.0,
            fast: 0.0,
            sums: vec![[0.0; 2]],
            first: vec![0.0],
        };
        commands.for_each(|c| own.take(&[c], &std::array::from_fn(tap)));
        own.activity()
    }

    fn fast(episode: EpisodeActivity) -> f64 {
        Activity::over(&[episode]).fast
    }

    /// A sine of `f` periods per step: what the filter leaves of it is the square of its gain, 1 above a quarter.
    #[test]
    fn power_above_a_quarter_of_the_rate_is_told_from_power_below() {
        for f in [0.01, 0.05, 0.1, 0.15, 0.2] {
            let share = fast(flown(60, (0..500).map(|t| (0.3 * (2.0 * PI * f * f64::from(t)).sin()) as f32)));
            assert!(share < 0.02, "{f}: {share}"); // 0.004 at most
        }
        for f in [0.3, 0.35, 0.4, 0.45, 0.499] {
            let share = fast(flown(60, (0..500).map(|t| (0.3 * (2.0 * PI * f * f64::from(t)).sin()) as f32)));
            assert!((share - 1.0).abs() < 0.02, "{f}: {share}");
        }
    }

    /// A period of two steps between −0.89 and 0.42, as a policy was seen to command that holds its drone still.
    #[test]
    fn a_command_that_jumps_every_step_is_seen_where_its_mean_is_a_good_one() {
        let jumps = flown(60, (0..500).map(|t| if t % 2 == 0 { -0.89 } else { 0.42 }));
        assert!((jumps.change - 1.31).abs() < 1e-6 && (jumps.last_second - 1.31).abs() < 1e-6, "{jumps:?}");
        assert!((fast(jumps) - 1.0).abs() < 5e-3, "{jumps:?}");
        let still = flown(60, (0..500).map(|_| -0.23));
        assert_eq!((still.change, still.last_second, fast(still)), (0.0, 0.0, 0.0));
    }

    #[test]
    fn the_last_second_is_the_end_of_the_episode_however_long_it_is() {
        for steps in [2_u16, 10, 60, 61, 200] {
            let calms = flown(60, (0..steps).map(|t| if t + 62 > steps { 0.0 } else { f32::from(t % 2) }));
            assert_eq!(calms.last_second, 0.0, "{steps}");
            let wakes = flown(60, (0..steps).map(|t| if t + 62 > steps { f32::from(t % 2) } else { 0.0 }));
            assert!((wakes.last_second - 1.0).abs() < 0.02, "{steps}: {wakes:?}");
        }
        assert_eq!(flown(60, std::iter::once(0.4)), EpisodeActivity::default());
    }
}
