//! What readings tell of themselves: which are none, which disagree with what is known, and which are believed again.

use super::aiding::Agreement;
use super::sensor_filter::{ScheduledAid, SensorFilter};
use super::state_estimator::StateEstimatorSettings;

/// Largest number that an inertial unit may read, m/s² and rad/s: beyond, it is no reading.
const MOST_READ: f64 = 1e4;
/// Likewise of any other sensor, in its unit.
const MOST_TOLD: f64 = 1e9;
/// Largest variance that P grows to where a sensor is believed against it: 1e12 times that of a fine sensor, as far as rounding goes.
const MOST_VARIANCE: f64 = 1e6;

/// How the readings of a sensor agreed with what was expected of them.
#[derive(Debug, Clone, PartialEq)]
pub struct InnovationRecord {
    /// The sensor's and what it tells: `gps.velocity`.
    pub name: String,
    /// Numbers of an innovation.
    pub n_channel: usize,
    /// Readings that came.
    pub n: u64,
    /// Of those, left out: beyond the gate.
    pub left_out: u64,
    /// Of those, lost: the sensor says so itself, they are no numbers, or the last ones to the last bit.
    pub lost: u64,
    /// Times that it was believed again after its patience.
    pub believed_again: u64,
    /// Sum of the squared innovations νᵀ S⁻¹ ν of those that were taken in: n × `n_channel` on average where all is consistent.
    pub squared: f64,
}

impl InnovationRecord {
    /// Mean squared innovation per number: 1 where all is consistent.
    pub fn mean(&self) -> f64 {
        self.squared / ((self.n - self.left_out - self.lost) as f64 * self.n_channel as f64)
    }
}

impl InnovationRecord {
    /// Of no reading yet.
    pub(super) fn new(sensor: &str, quantity: &str, n_channel: usize) -> Self {
        let name = format!("{sensor}.{quantity}");
        Self { name, n_channel, n: 0, left_out: 0, lost: 0, believed_again: 0, squared: 0.0 }
    }

    /// Of no reading yet of an aid.
    pub(super) fn of(aid: &ScheduledAid) -> Self {
        Self::new(&aid.schedule.name, aid.aid.kind.quantity(), aid.aid.kind.n_channel())
    }

    pub(super) fn clear(&mut self) {
        (self.n, self.left_out, self.lost, self.believed_again, self.squared) = (0, 0, 0, 0, 0.0);
    }
}

/// A sample of an inertial unit as a filter takes it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct InertialSample {
    /// Specific force (m/s²) and angular velocity (rad/s).
    pub numbers: [f64; 6],
    /// Variances that accelerometer and gyroscope have beside their noise: what is at a limit says little.
    pub added: [f64; 2],
}

impl InertialSample {
    /// Of what was read; numbers that no unit reads are those of the sample before.
    pub fn new(read: [f64; 6], before: &Self, filter: &SensorFilter, settings: &StateEstimatorSettings) -> Self {
        let is_read = |x: f64| x.abs() <= MOST_READ;
        let is_beyond = |k: usize| read[3 * k..][..3].iter().any(|x| filter.is_at_limit(k, *x) || !is_read(*x));
        // with noise none is read twice
        let hangs = read == before.numbers;
        let is_beyond = [hangs || is_beyond(0), hangs || is_beyond(1)];
        let most = [settings.beyond_accelerometer, settings.beyond_gyroscope];
        Self {
            numbers: std::array::from_fn(|k| if is_read(read[k]) { read[k] } else { before.numbers[k] }),
            added: std::array::from_fn(|k| if is_beyond[k] { most[k] * most[k] } else { 0.0 }),
        }
    }

    /// Whether it was at a limit, no number, or the last one.
    pub fn is_saturated(&self) -> bool {
        self.added != [0.0; 2]
    }
}

/// How far a sensor that aids is trusted, from how its last readings agreed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Trust {
    /// Since when its readings are left out, s of them in a row.
    pub left_out_for: f64,
    /// ν² of the last.
    pub last_squared: f64,
    /// Its last numbers.
    pub last: [f64; 4],
}

impl Trust {
    /// The numbers of a reading with its gate and fading, if it can be taken in; `largest` is the largest variance of P.
    pub fn ask(
        &mut self,
        aid: &ScheduledAid,
        (settings, largest): (&StateEstimatorSettings, f64),
        read: &[f64],
        record: &mut InnovationRecord,
    ) -> Option<([f64; 4], [f64; 2])> {
        record.n += 1;
        let n = aid.aid.kind.n_reading();
        let is_lost = aid.valid.is_some_and(|valid| read[valid] != 1.0);
        let mut numbers = [0.0; 4];
        numbers[..n].copy_from_slice(&read[..n]);
        // several numbers with noise never come twice
        let hangs = n > 1 && numbers == self.last;
        self.last = numbers.map(|x| if x.is_finite() { x } else { 0.0 });
        // what tells nothing disagrees with nothing
        if is_lost || hangs || !read[..n].iter().all(|x| x.abs() <= MOST_TOLD) {
            record.lost += 1;
            return None;
        }
        let n_channel = aid.aid.kind.n_channel() as f64;
        if self.left_out_for < settings.patience {
            return Some((numbers, [settings.gate * n_channel, 1.0]));
        }
        record.believed_again += 1;
        let room = MOST_VARIANCE / largest;
        Some((numbers, [f64::MAX, (self.last_squared / n_channel).min(room).max(1.0)]))
    }

    /// Counts how a reading agreed.
    pub fn count(&mut self, told: Agreement<f64>, period: f64, record: &mut InnovationRecord) {
        self.last_squared = if told.squared.is_finite() { told.squared } else { f64::MAX };
        if told.is_taken == 1.0 {
            record.squared += told.squared;
            self.left_out_for = 0.0;
        } else {
            record.left_out += 1;
            self.left_out_for += period;
        }
    }
}
