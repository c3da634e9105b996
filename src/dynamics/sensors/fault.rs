//! Faults of a sensor, which begin and end at known times: a receiver without satellites, a magnetometer beside a motor, a part that hangs.

use super::limits::within;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Latest time of a fault, s.
const MAX_TIME: f64 = 1e9;
/// Most that a sensor is off, in its unit.
const MAX_OFFSET: f64 = 1e12;

/// A fault. In TOML, in the table of a sensor: `faults = [{ kind = "lost", from = 4.0, until = 6.0 }]`.
///
/// Samples taken from `from` (s since the flight or episode began) until before `until` have it. The noise of no sensor changes by it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorFault {
    /// What happens.
    pub kind: FaultKind,
    /// s.
    pub from: f64,
    /// s.
    pub until: f64,
    /// By how much a sensor with an offset is off, channel by channel, in their units; channels behind the list by nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by: Vec<f64>,
}

/// What happens to a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// It reads nothing: NaN in every channel.
    Lost,
    /// It reads what it read last.
    Stuck,
    /// It is off.
    Offset,
}

impl SensorFault {
    /// Checks times and offsets of a sensor with `n` channels.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] that names the number.
    pub(crate) fn validate(&self, what: &str, n: usize) -> Result<()> {
        within(&format!("{what}: faults: from"), self.from, 0.0, MAX_TIME)?;
        if !(self.until > self.from && self.until <= MAX_TIME) {
            let limit = format!("> {} s, when it begins, and ≤ {MAX_TIME:e} s", self.from);
            return Err(Error::value(format!("{what}: faults: until"), self.until, limit, "Give when it is over."));
        }
        let wanted = if self.kind == FaultKind::Offset { 1..=n } else { 0..=0 };
        if !wanted.contains(&self.by.len()) {
            let limit = match self.kind {
                FaultKind::Offset => format!("1 to {n} numbers, one per channel"),
                FaultKind::Lost | FaultKind::Stuck => "none for a fault that is no offset".into(),
            };
            let remedy = "Give offsets in the order of its columns, of kind 'offset'.";
            return Err(Error::value(
                format!("{what}: faults: by"),
                format!("{} numbers", self.by.len()),
                limit,
                remedy,
            ));
        }
        self.by.iter().try_for_each(|x| within(&format!("{what}: faults: by"), *x, -MAX_OFFSET, MAX_OFFSET))
    }

    /// Whether samples taken at `time` (s) have it.
    pub(crate) fn is_acting(&self, time: f64) -> bool {
        (self.from..self.until).contains(&time)
    }

    /// Adds its offset.
    pub(crate) fn add_to(&self, sample: &mut [f64]) {
        sample.iter_mut().zip(&self.by).for_each(|(x, by)| *x += by);
    }
}
