//! What every kind of sensor does.

use super::context::SensorContext;
use super::mount::Motion;
use base::error::Result;
use rng::Stream;
use std::borrow::Cow;

/// A sensor at work. The numbers that it draws in a sample do not depend on what it measures.
pub(crate) trait Device {
    /// Begins an episode with the stream's first numbers.
    fn draw(&mut self, stream: &mut Stream);

    /// Measures; `out` holds the sample before.
    fn sample(&mut self, at: &Motion, context: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]);

    /// Visits what changes from sample to sample.
    fn each(&mut self, visit: &mut dyn FnMut(&mut f64));
}

/// Name and unit of a number that a sensor reads.
pub type Channel = (Cow<'static, str>, &'static str);

/// How the numbers of a reading lie about each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReadingLayout {
    /// One behind the other.
    Vector,
    /// Rows of pixels from above, all channels of a pixel together.
    Image {
        /// Rows.
        height: usize,
        /// Pixels of a row.
        width: usize,
        /// Numbers of a pixel.
        channels: usize,
    },
    /// Distances along beams, row by row.
    Lidar {
        /// Rows of beams.
        rows: usize,
        /// Beams of a row.
        columns: usize,
    },
}

/// What the settings of a kind tell of it.
pub(crate) trait KindSettings {
    /// Names and units of readings that are always the same.
    const CHANNELS: &[(&'static str, &'static str)] = &[];
    /// Keys that stand in a table only where they are given.
    const OPTIONAL: &[&'static str] = &[];

    /// Names and units of its readings, in order.
    fn channels(&self) -> Vec<Channel> {
        Self::CHANNELS.iter().map(|(name, unit)| (Cow::Borrowed(*name), *unit)).collect()
    }

    /// How they lie.
    fn layout(&self) -> ReadingLayout {
        ReadingLayout::Vector
    }

    /// Least and largest reading; infinite where there is none.
    fn bounds(&self) -> [f64; 2] {
        [f64::NEG_INFINITY, f64::INFINITY]
    }

    /// Refuses numbers that no such part has; `what` names the sensor.
    fn validate(&self, what: &str) -> Result<()>;
}
