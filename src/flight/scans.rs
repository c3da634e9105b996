//! What cameras and lidars read along a flight.

use base::error::Result;
use dynamics::Quantity;
use dynamics::sensors::{ReadingLayout, Sensor, SensorConfig};
use std::path::Path;

/// What a camera or lidar read along a flight: a row per reading, of thousands of numbers, where other columns of a
/// [`FlightLog`](super::FlightLog) have one per step.
#[derive(Debug, Clone, PartialEq)]
pub struct Scans {
    /// Name of the sensor.
    pub sensor: String,
    /// Shape of a row: an image or a scan.
    pub layout: ReadingLayout,
    /// Names and units of the numbers of a row.
    pub channels: Vec<Quantity>,
    /// When each row was first read, which is the sensor's latency after it was taken, s.
    pub time: Vec<f64>,
    /// Row-major `[reading, channel]`.
    pub readings: Vec<f64>,
}

impl Scans {
    /// Of a sensor that has none yet; `None` of one whose numbers are few and stand in columns of the log.
    #[doc(hidden)]
    pub fn of(config: &SensorConfig, sensor: &Sensor) -> Option<Self> {
        let (layout, channels) = (config.model.layout(), sensor.channels().to_vec());
        let empty = || Self { sensor: config.name.clone(), layout, channels, time: Vec::new(), readings: Vec::new() };
        (layout != ReadingLayout::Vector).then(empty)
    }

    /// Number of readings.
    pub fn len(&self) -> usize {
        self.time.len()
    }

    /// Whether nothing was read.
    pub fn is_empty(&self) -> bool {
        self.time.is_empty()
    }

    /// The numbers of reading `i`, `[channel]`.
    ///
    /// # Panics
    /// If there is no such reading.
    pub fn row(&self, i: usize) -> &[f64] {
        let n = self.channels.len();
        &self.readings[i * n..(i + 1) * n]
    }

    /// Appends what was read at `time`.
    #[doc(hidden)]
    pub fn push(&mut self, time: f64, reading: &[f64]) {
        self.time.push(time);
        self.readings.extend_from_slice(reading);
    }

    fn csv_header(&self) -> Vec<String> {
        let named = self.channels.iter().map(|channel| format!("{} [{}]", channel.name, channel.unit));
        std::iter::once("time [s]".to_string()).chain(named).collect()
    }

    fn csv_row(&self, i: usize, row: &mut Vec<f64>) {
        row.clear();
        row.push(self.time[i]);
        row.extend_from_slice(self.row(i));
    }

    /// About how many bytes [`write_csv`](Self::write_csv) writes, estimated from at most 16 of its rows.
    pub fn csv_size(&self) -> u64 {
        super::csv_size(&self.csv_header(), self.len(), |i, row| self.csv_row(i, row))
    }

    /// Writes a header line with units and one line per reading, as [`FlightLog::write_csv`](super::FlightLog::write_csv) does.
    ///
    /// # Errors
    /// [`Error::File`](base::error::Error::File) where the file cannot be written.
    pub fn write_csv(&self, path: impl AsRef<Path>) -> Result<()> {
        super::write_rows(path.as_ref(), &self.csv_header(), self.len(), |i, row| self.csv_row(i, row))
    }
}
