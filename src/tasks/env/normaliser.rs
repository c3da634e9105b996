//! Statistics of observations: collected while stepping, frozen in between.
//!
//! One batch: step, [`Env::update_normaliser`], [`Env::observe`]. Several shards of a batch: [`Env::take_pending`] of each,
//! [`PendingStatistics::add`] in a fixed order, [`Statistics::merge`], then [`Env::set_statistics`] and `set_collecting(true)` in all of
//! them. Evaluation: `set_statistics` alone.

use super::Env;
use crate::observation::Statistics;
use autodiff::program::BLOCK;
use base::error::{Error, Result, finite};

/// What a normaliser saw since its statistics were frozen: sums about their mean, for [`Statistics::merge`].
#[derive(Debug, Clone, PartialEq)]
pub struct PendingStatistics {
    /// Observations, of all agents.
    pub count: f64,
    /// Σ(x − mean) per number.
    pub sums: Vec<f64>,
    /// Σ(x − mean)² per number.
    pub squares: Vec<f64>,
}

impl PendingStatistics {
    /// Adds what another shard saw since the same statistics were frozen.
    ///
    /// # Errors
    /// [`Error::Value`] if it is of another number of entries.
    pub fn add(&mut self, other: &Self) -> Result<()> {
        let (got, wanted) = (other.sums.len(), self.sums.len());
        if got != wanted || other.squares.len() != self.squares.len() {
            let remedy = "Take them from environments with the same transforms.";
            return Err(Error::value("entries of the sums", got, wanted.to_string(), remedy));
        }
        self.count += other.count;
        self.sums.iter_mut().zip(&other.sums).for_each(|(a, b)| *a += b);
        self.squares.iter_mut().zip(&other.squares).for_each(|(a, b)| *a += b);
        Ok(())
    }
}

impl Env {
    /// Takes the statistics of all observations since the last call into the normaliser, block by block in order, and
    /// freezes them. Observations in hand are of the old scale: [`Env::observe`] writes them anew. Without a stage
    /// `normalise` it does nothing.
    pub fn update_normaliser(&mut self) {
        let pending = self.take_pending();
        let mut statistics = self.core.statistics.clone();
        statistics.merge(pending.count, &pending.sums, &pending.squares);
        self.freeze(statistics);
    }

    /// Takes out what was collected since the statistics were frozen.
    pub fn take_pending(&mut self) -> PendingStatistics {
        let n = self.core.sizes.normalised;
        let mut pending = PendingStatistics { count: 0.0, sums: vec![0.0; n], squares: vec![0.0; n] };
        for block in &mut self.blocks {
            pending.count += std::mem::take(&mut block.count);
            for (k, own) in block.sums.iter_mut().enumerate() {
                let [sum, square] = std::mem::take(own);
                pending.sums[k] += sum;
                pending.squares[k] += square;
            }
        }
        pending
    }

    /// The normaliser's statistics.
    pub fn statistics(&self) -> &Statistics {
        &self.core.statistics
    }

    /// Freezes other statistics. What was collected about the old mean is dropped, and collecting stops until
    /// [`Env::set_collecting`].
    ///
    /// # Errors
    /// [`Error::Value`] if they are of another number of entries, or no statistics.
    pub fn set_statistics(&mut self, statistics: Statistics) -> Result<()> {
        let (got, wanted) = (statistics.mean.len(), self.core.sizes.normalised);
        if got != wanted || statistics.variance.len() != wanted {
            let remedy = "Take them from an environment with the same transforms.";
            return Err(Error::value("entries of the statistics", got, wanted.to_string(), remedy));
        }
        finite("mean of the statistics", &statistics.mean)?;
        finite("variance of the statistics", &statistics.variance)?;
        finite("count of the statistics", &[statistics.count])?;
        if let Some(least) = statistics.variance.iter().copied().chain([statistics.count]).find(|x| *x < 0.0) {
            let remedy = "Take them from Env::statistics.";
            return Err(Error::value("variance or count of the statistics", least, "≥ 0", remedy));
        }
        self.core.collects = false;
        self.take_pending();
        self.freeze(statistics);
        Ok(())
    }

    /// Whether steps collect statistics from now on; they do at first.
    pub fn set_collecting(&mut self, collects: bool) {
        self.core.collects = collects;
    }

    pub(super) fn freeze(&mut self, statistics: Statistics) {
        let inverse = statistics.variance.iter().map(|v| 1.0 / (v + VARIANCE_FLOOR).sqrt());
        self.core.frozen = statistics.mean.iter().copied().chain(inverse).collect();
        let rows = self.core.layout.shared.statistics.of_mut(&mut self.core.shared);
        rows.iter_mut().zip(&*self.core.frozen).for_each(|(row, x)| *row = [*x as f32; BLOCK]);
        self.core.statistics = statistics;
    }
}

/// Under a normaliser's variances.
pub const VARIANCE_FLOOR: f64 = 1e-8;
