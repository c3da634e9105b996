//! A curriculum: how hard episodes are follows how many of them go well.
//!
//! Tasks and randomisation take a difficulty d between 0 and 1 ([`Env::set_difficulty`](tasks::Env::set_difficulty)):
//! starts near the goal, wide gates, the nominal drone at 0, the task itself at 1. Over each [`Curriculum::episodes`]
//! episodes that ended, d rises by [`Curriculum::step`] if more than [`Curriculum::raise`] of them went well, and falls by it
//! if fewer than [`Curriculum::lower`] did; or their mean return, as a share of the largest, is what is compared
//! ([`GoodEpisode::Return`]), where episodes last long before they are flown well. It never falls behind a line from
//! [`Curriculum::from`] at the start to 1 at [`Curriculum::full`] of the run, so that every run ends on the task itself.
//! [`EnvConfig::easier`](tasks::EnvConfig::easier) mixes easier episodes in.
//! (Akkaya et al. 2019 move the ranges of randomisation by such thresholds; Rudin et al. 2022 the terrain.)

use super::checkpoint::Tensors;
use super::learner::Episodes;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// What of episodes says how well they went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GoodEpisode {
    /// The share of them that the task did not end.
    #[default]
    Survival,
    /// The share of them whose last step was a success too.
    Success,
    /// Their mean return, as a share of the largest reward of a step times the steps of an episode.
    Return,
}

/// Settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Curriculum {
    /// Difficulty at the start of the run; 1 for no curriculum. Within [0, 1]; default 1.
    pub from: f64,
    /// Share of the run from which on the difficulty is 1 in any case. Within [0, 1]; default 0.7.
    pub full: f64,
    /// What tells how many episodes went well: "survival", "success", or "return", the mean return as a share of the largest.
    /// Default "survival".
    pub good: GoodEpisode,
    /// Share of good episodes, or of return, above which the difficulty rises. Within [0, 1]; default 0.8.
    pub raise: f64,
    /// Share of good episodes, or of return, below which it falls. Within [0, 1], at most `raise`; default 0.4.
    pub lower: f64,
    /// How far it moves at a time. Within (0, 1]; default 0.05.
    pub step: f64,
    /// Episodes between two moves. At least 1; default 256.
    pub episodes: u64,
}

impl Default for Curriculum {
    fn default() -> Self {
        let good = GoodEpisode::default();
        Self { from: 1.0, full: 0.7, good, raise: 0.8, lower: 0.4, step: 0.05, episodes: 256 }
    }
}

impl Curriculum {
    /// Whether there is one.
    pub fn is_on(&self) -> bool {
        self.from < 1.0
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        for (what, x) in [("from", self.from), ("full", self.full), ("raise", self.raise), ("lower", self.lower)] {
            if !(0.0..=1.0).contains(&x) {
                let remedy = "0, 0.7, 0.8 and 0.4 are usual.";
                return Err(Error::value(format!("curriculum.{what}"), x, "within [0, 1]", remedy));
            }
        }
        if !(self.step > 0.0 && self.step <= 1.0) {
            return Err(Error::value("curriculum.step", self.step, "within (0, 1]", "0.05 is usual."));
        }
        if self.lower > self.raise {
            let limit = format!("≤ curriculum.raise, {}", self.raise);
            return Err(Error::value("curriculum.lower", self.lower, limit, "0.4 below 0.8 is usual."));
        }
        if self.episodes == 0 {
            return Err(Error::value("curriculum.episodes", 0, "≥ 1", "256 tell a share to 3 %."));
        }
        Ok(())
    }
}

/// A curriculum in the middle of a run.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Difficulty {
    settings: Curriculum,
    /// Of an episode.
    largest_return: f64,
    share: f64,
    /// Sum over episodes, 1 for one that went well.
    good: f64,
    count: u64,
}

/// Name of its tensor in a checkpoint.
const TENSOR: &str = "curriculum";

impl Difficulty {
    /// At the start of a run in a task of that largest return of an episode.
    pub fn new(settings: &Curriculum, largest_return: f64) -> Self {
        Self { share: settings.from, largest_return, settings: settings.clone(), good: 0.0, count: 0 }
    }

    /// Of episodes that begin now.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Takes in what ended in an update; `progress` is the share of the run that is done. Gives whether the difficulty moved.
    pub fn take(&mut self, ended: &Episodes, progress: f64) -> bool {
        let own = &self.settings;
        let before = self.share;
        self.count += ended.count;
        self.good += match own.good {
            GoodEpisode::Survival => (ended.count - ended.crashed) as f64,
            GoodEpisode::Success => ended.succeeded as f64,
            GoodEpisode::Return => (ended.total_return / self.largest_return).clamp(0.0, ended.count as f64),
        };
        if self.count >= own.episodes {
            let good = self.good / self.count as f64;
            self.share += own.step * (f64::from(good > own.raise) - f64::from(good < own.lower));
            (self.good, self.count) = (0.0, 0);
        }
        let line = if progress >= own.full { 1.0 } else { own.from + (1.0 - own.from) * progress / own.full };
        self.share = self.share.clamp(line, 1.0);
        self.share != before
    }

    /// For [`Difficulty::load`].
    ///
    /// # Errors
    /// None for a name that is used once.
    pub fn save(&self, to: &mut Tensors) -> Result<()> {
        to.insert(TENSOR, &[3], vec![self.share, self.good, self.count as f64])
    }

    /// Goes on as saved.
    ///
    /// # Errors
    /// [`Error`] for a tensor that is missing, [`Error::Value`] for numbers that none saved.
    pub fn load(&mut self, from: &Tensors) -> Result<()> {
        let own = from.get::<f64>(TENSOR, &[3])?;
        let [share, good, count] = [own[0], own[1], own[2]];
        if !((0.0..=1.0).contains(&share) && (0.0..=count).contains(&good) && count.is_finite()) {
            let limit = "a difficulty within [0, 1] and counts of episodes";
            return Err(Error::value(
                "curriculum of the checkpoint",
                format!("{own:?}"),
                limit,
                "Load an earlier one.",
            ));
        }
        (self.share, self.good, self.count) = (share, good, count as u64);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ended(count: u64, crashed: u64, succeeded: u64) -> Episodes {
        Episodes { count, crashed, succeeded, ..Episodes::default() }
    }

    #[test]
    fn difficulty_follows_the_share_of_good_episodes_and_never_falls_behind_its_line() {
        let settings = Curriculum { from: 0.25, step: 0.125, episodes: 10, full: 0.5, ..Curriculum::default() };
        let mut own = Difficulty::new(&settings, 100.0);
        assert!(!own.take(&ended(9, 0, 0), 0.0) && own.share() == 0.25); // too few to tell
        assert!(own.take(&ended(1, 0, 0), 0.0) && own.share() == 0.375);
        assert!(!own.take(&ended(10, 4, 0), 0.0)); // between the limits
        assert!(own.take(&ended(10, 9, 0), 0.0) && own.share() == 0.25);
        assert!(!own.take(&ended(10, 10, 0), 0.0)); // not below its start
        assert!(own.take(&ended(10, 10, 0), 0.25) && own.share() == 0.625); // halfway up the line
        assert!(own.take(&ended(0, 0, 0), 0.5) && own.share() == 1.0);
        let settings = Curriculum { good: GoodEpisode::Success, ..settings };
        let mut own = Difficulty::new(&settings, 100.0);
        assert!(!own.take(&ended(10, 0, 7), 0.0)); // survived all, reached seven
        assert!(own.take(&ended(10, 0, 9), 0.0));
        let settings = Curriculum { good: GoodEpisode::Return, raise: 0.5, ..settings };
        let mut own = Difficulty::new(&settings, 100.0);
        let returned = |total_return| Episodes { total_return, ..ended(10, 0, 10) };
        assert!(!own.take(&returned(490.0), 0.0) && own.take(&returned(510.0), 0.0)); // 49, 51 of 100 an episode
        assert!(own.take(&returned(-1e9), 0.0) && own.share() == settings.from);
    }

    #[test]
    fn a_curriculum_goes_on_as_saved_and_refuses_forged_numbers() {
        let settings = Curriculum { from: 0.0, ..Curriculum::default() };
        let mut own = Difficulty::new(&settings, 100.0);
        own.take(&ended(300, 0, 0), 0.01);
        own.take(&ended(100, 3, 0), 0.01);
        let mut saved = Tensors::new();
        own.save(&mut saved).unwrap();
        let mut again = Difficulty::new(&settings, 100.0);
        again.load(&saved).unwrap();
        assert_eq!(again, own);
        for forged in [[2.0, 0.0, 0.0], [f64::NAN, 0.0, 0.0], [0.5, 3.0, 2.0], [0.5, -1.0, 2.0]] {
            let mut saved = Tensors::new();
            saved.insert(TENSOR, &[3], forged.to_vec()).unwrap();
            assert!(Difficulty::new(&settings, 100.0).load(&saved).is_err(), "{forged:?}");
        }
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let refused = |own: Curriculum| own.validate().is_err();
        assert!(!refused(Curriculum::default()) && !Curriculum::default().is_on());
        assert!(refused(Curriculum { from: -0.1, ..Curriculum::default() }));
        assert!(refused(Curriculum { step: 0.0, ..Curriculum::default() }));
        assert!(refused(Curriculum { lower: 0.9, ..Curriculum::default() }));
        assert!(refused(Curriculum { episodes: 0, ..Curriculum::default() }));
        assert!(refused(Curriculum { full: f64::NAN, ..Curriculum::default() }));
    }
}
