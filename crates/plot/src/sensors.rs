//! The figures of what sensors read along a flight: curves, scans over time, pictures.

use super::flight::{timed, without_x_label};
use super::{Colour, Figure, HeatMap, Panel, Picture, Series};
use omnidrones::dynamics::sensors::{Channel, DistanceEncoding, Pattern, ReadingLayout, SensorConfig, SensorModel};
use omnidrones::flight::FlightLog;

/// Most moments of a scan, and most pictures of a camera.
const MOMENTS: usize = 150;
const PICTURES: usize = 6;
/// Most rows of beams that are drawn.
const SCANS: usize = 4;
/// Height of a chart over time, units.
const HEIGHT: f64 = 150.0;

/// One figure per sensor, with its name: quantities below each other, scans beam by beam over time, of scattered beams how many are how
/// near, pictures at equal times.
/// `sensors` are those of the flight, in order.
pub fn sensor_figures(sensors: &[SensorConfig], log: &FlightLog) -> Vec<(String, Figure)> {
    let mut first = 0;
    let figure = |sensor: &SensorConfig| {
        let channels = sensor.model.channels();
        let readings = Readings::of(sensor, log, first, channels.len());
        first += if sensor.model.layout() == ReadingLayout::Vector { channels.len() } else { 0 };
        let figure = Figure::new(format!("{}: {}", log.vehicle, sensor.name));
        let figure = match sensor.model.layout() {
            ReadingLayout::Vector => curves(figure, &channels, &readings, log),
            ReadingLayout::Lidar { .. } if scatters(&sensor.model) => {
                quantiles(figure, &sensor.model, &channels[0], &readings)
            }
            ReadingLayout::Lidar { rows, columns } => {
                scans(figure.subtitle(told(&sensor.model, &channels[0], readings.ends())), [rows, columns], &readings)
            }
            ReadingLayout::Image { height, width, channels: n } => {
                let one = n == 1;
                let figure =
                    if one { figure.subtitle(told(&sensor.model, &channels[0], readings.ends())) } else { figure };
                pictures(figure, [height, width, n], &readings)
            }
        };
        (sensor.name.clone(), figure)
    };
    sensors.iter().map(figure).collect()
}

/// What one sensor read.
struct Readings<'a> {
    times: &'a [f64],
    /// A row per time, in which its numbers begin at `first`.
    rows: &'a [f64],
    width: usize,
    first: usize,
    n: usize,
}

impl<'a> Readings<'a> {
    /// Of the sensor, whose numbers begin at `first` where they stand in columns of the log.
    fn of(sensor: &SensorConfig, log: &'a FlightLog, first: usize, n: usize) -> Self {
        match log.scans.iter().find(|scans| scans.sensor == sensor.name) {
            Some(scans) => Self { times: &scans.time, rows: &scans.readings, width: n, first: 0, n },
            None => Self { times: &log.time, rows: &log.sensor_readings, width: log.sensor_channels.len(), first, n },
        }
    }

    fn len(&self) -> usize {
        self.times.len()
    }

    fn at(&self, sample: usize) -> &[f64] {
        let from = sample * self.width + self.first;
        &self.rows[from..from + self.n]
    }

    fn timed(&self, values: impl Iterator<Item = f64>) -> Vec<(f64, f64)> {
        self.times.iter().copied().zip(values).collect()
    }

    /// At most `n` samples, as far from each other as can be.
    fn samples(&self, n: usize) -> Vec<usize> {
        let (all, n) = (self.len(), n.min(self.len()));
        (0..n).map(|i| i * all / n).collect()
    }

    /// Least and largest number of the whole flight.
    fn ends(&self) -> [f64; 2] {
        let all = (0..self.len()).flat_map(|i| self.at(i));
        all.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(*x), high.max(*x)])
    }

    /// Where a number lies between them.
    fn share(&self) -> impl Fn(f64) -> f64 {
        let [low, high] = self.ends();
        move |x| if high > low { (x - low) / (high - low) } else { 0.5 }
    }
}

/// What a position or velocity is read of, in the world: the vehicle's, by its own point.
fn flown<'a>(log: &'a FlightLog, stem: &str) -> &'a [[f64; 3]] {
    match stem {
        "position" => &log.position,
        "velocity" => &log.velocity,
        _ => &[],
    }
}

/// A panel per quantity, with a curve per axis; of positions and velocities also the vehicle's, dashed.
fn curves(figure: Figure, channels: &[Channel], readings: &Readings<'_>, log: &FlightLog) -> Figure {
    let stem = |k: usize| {
        let name = channels[k].0.as_ref();
        ["_x", "_y", "_z", "_w"].iter().find_map(|axis| name.strip_suffix(axis)).unwrap_or(name).to_string()
    };
    let mut panels: Vec<(String, Panel)> = Vec::new();
    for (k, (name, unit)) in channels.iter().enumerate() {
        let stem = stem(k);
        if panels.last().is_none_or(|(last, _)| *last != stem) {
            panels.push((stem.clone(), Panel::new("", "time [s]", format!("{stem} [{unit}]"))));
        }
        let Some((_, panel)) = panels.last_mut() else { continue };
        let axis = name[stem.len()..].trim_start_matches('_');
        let values = readings.timed((0..readings.len()).map(|i| readings.at(i)[k]));
        let shown = panel.series.iter().filter(|s| !s.dashed).count();
        let line = Series::line(axis, values).colour(Colour::nth(shown)).width(1.0);
        *panel = std::mem::take(panel).series(line);
        let flown = flown(log, &stem);
        if !flown.is_empty() {
            let line = Series::line("flown", timed(log, flown.iter().map(|at| at[shown])));
            *panel = std::mem::take(panel).series(line.colour(Colour::INK).dashed().width(0.8));
        }
    }
    let last = panels.len() - 1;
    let figure = figure.size(800.0, 60.0 + HEIGHT * panels.len() as f64);
    let labelled = |(i, (_, panel)): (usize, (String, Panel))| if i < last { without_x_label(panel) } else { panel };
    panels.into_iter().enumerate().map(labelled).fold(figure, Figure::chart)
}

/// Whether beams point elsewhere in every scan.
fn scatters(model: &SensorModel) -> bool {
    matches!(model, SensorModel::Lidar(lidar) if lidar.pattern == Pattern::Scatter)
}

/// Shares of a scan's readings that curves are drawn of.
const SHARES: [(f64, &str); 4] =
    [(0.0, "least"), (0.1, "a tenth below"), (0.5, "half below"), (0.9, "nine tenths below")];

/// A curve per share of all beams: where each of them points is another direction in every scan.
fn quantiles(figure: Figure, model: &SensorModel, channel: &Channel, readings: &Readings<'_>) -> Figure {
    let mut curves = vec![Vec::with_capacity(readings.len()); SHARES.len()];
    let mut scan = Vec::with_capacity(readings.n);
    for i in 0..readings.len() {
        scan.clear();
        scan.extend_from_slice(readings.at(i));
        scan.sort_by(f64::total_cmp);
        for (curve, (share, _)) in curves.iter_mut().zip(SHARES) {
            curve.push(scan[(share * (scan.len() - 1) as f64).round() as usize]);
        }
    }
    let panel = Panel::new("", "time [s]", format!("{} [{}]", named(model, channel), channel.1));
    let line = |(k, (curve, (_, share))): (usize, (Vec<f64>, (f64, &str)))| {
        Series::line(share, readings.timed(curve.into_iter())).colour(Colour::nth(k)).width(1.0)
    };
    let panel = curves.into_iter().zip(SHARES).enumerate().map(line).fold(panel, Panel::series);
    figure.subtitle(format!("{} beams, scattered anew in every scan", readings.n)).size(800.0, 320.0).chart(panel)
}

/// What colours mean.
fn told(model: &SensorModel, channel: &Channel, [low, high]: [f64; 2]) -> String {
    let (what, unit) = (named(model, channel), &channel.1);
    if low < high {
        format!("{what}: dark {low:.3}, bright {high:.3} {unit}")
    } else {
        format!("{what}: all {low:.3} {unit}")
    }
}

/// The name of a channel without its number, and the form in which it is told.
fn named(model: &SensorModel, (name, _): &Channel) -> String {
    let what = name.trim_end_matches(|c: char| c == '_' || c.is_ascii_digit());
    let form = match model {
        SensorModel::Lidar(lidar) => lidar.form,
        SensorModel::Camera(camera) => camera.form,
        _ => DistanceEncoding::Distance,
    };
    let form = match form {
        DistanceEncoding::Distance => "",
        DistanceEncoding::Proximity => ", told as proximity",
        DistanceEncoding::Inverse => ", told as inverse distance",
    };
    format!("{what}{form}")
}

/// Beams from below upwards over time, maps of as many elevations as fit.
fn scans(figure: Figure, [rows, columns]: [usize; 2], readings: &Readings<'_>) -> Figure {
    let (samples, share_of) = (readings.samples(MOMENTS), readings.share());
    let times = readings.times.first().copied().zip(readings.times.last().copied()).unwrap_or_default();
    let shown = columns.min(SCANS);
    let map = |i: usize| {
        let elevation = i * columns / shown;
        let title = format!("Elevation {} of {columns}", elevation + 1);
        let map = HeatMap::new(title, "time [s]", "beam").ranges(times, (0.0, rows as f64)).seamless();
        (0..rows).fold(map, |map, beam| {
            let share = |i: &usize| share_of(readings.at(*i)[beam * columns + elevation]);
            map.row(samples.iter().map(share).collect(), Vec::new())
        })
    };
    (0..shown).map(map).fold(figure.size(800.0, 60.0 + 1.2 * HEIGHT * shown as f64), Figure::chart)
}

/// Pictures at equal times, three in a row.
fn pictures(figure: Figure, [height, width, channels]: [usize; 3], readings: &Readings<'_>) -> Figure {
    let (samples, share) = (readings.samples(PICTURES), readings.share());
    let colour = |pixel: &[f64]| match pixel {
        [one] => Colour::heat(share(*one)),
        _ => {
            let [red, green, blue] = [0, 1, 2].map(|k| (255.0 * share(pixel[k])).round() as u8);
            Colour(red, green, blue)
        }
    };
    let picture = |i: &usize| {
        let row = |row: &[f64]| row.chunks_exact(channels).map(colour).collect();
        let rows = readings.at(*i).chunks_exact(width * channels).map(row).collect();
        Picture::new(format!("{:.2} s", readings.times[*i]), rows)
    };
    let (across, down) = (samples.len().clamp(1, 3), samples.len().div_ceil(3).max(1));
    let tall = 740.0 / 3.0 * height as f64 / width as f64 + 24.0;
    let figure = figure.size(800.0, 60.0 + tall * down as f64).grid(&vec![1.0; across], &vec![1.0; down]);
    let placed = samples.iter().map(picture).enumerate();
    placed.fold(figure, |figure, (i, picture)| figure.place((i % 3, i / 3), (1, 1), picture))
}

#[cfg(test)]
mod tests {
    use super::*;
    use omnidrones::dynamics::Quantity;
    use omnidrones::flight::Scans;

    #[test]
    fn every_kind_of_reading_has_its_figure() {
        let sensors = SensorConfig::parse_list("imu,lidar:omnidrones,camera:diffphysdrone").unwrap();
        let texts = drawn(&sensors);
        assert!(texts[0].contains("accelerometer [m/s^2]") && texts[0].contains("gyroscope [rad/s]"), "{}", texts[0]);
        assert!(texts[1].contains("Elevation 4 of 4") && texts[1].contains("beam"));
        assert!(texts[2].contains("0.10 s") && texts[2].matches("<rect").count() > 2 * 16 * 12);
    }

    #[test]
    fn scattered_beams_are_told_by_how_many_are_how_near_and_not_as_a_grid() {
        let texts = drawn(&SensorConfig::parse_list("lidar:mid360").unwrap());
        assert!(texts[0].contains("half below") && texts[0].contains("beams, scattered"), "{}", texts[0]);
        assert!(texts[0].contains("range [m]") && !texts[0].contains("Elevation"), "{}", texts[0]);
    }

    #[test]
    fn a_position_stands_beside_the_one_that_was_flown() {
        let texts = drawn(&SensorConfig::parse_list("gnss:single_point,imu").unwrap());
        assert_eq!(texts[0].matches("\nflown\n").count(), 2, "position and velocity: {}", texts[0]);
        assert!(!texts[1].contains("flown"), "{}", texts[1]);
    }

    /// The figures of a flight of three samples.
    fn drawn(sensors: &[SensorConfig]) -> Vec<String> {
        let mut log = FlightLog::new("drone", &[]);
        log.time = vec![0.0, 0.1, 0.2];
        log.position = vec![[0.0, 0.0, 1.0]; 3];
        log.velocity = vec![[0.1, 0.0, 0.0]; 3];
        let read = |i: usize, n: usize| (0..n).map(move |k| (0.01 * (i * n + k) as f64).sin().abs());
        let named = |n: usize| vec![Quantity { name: "x".into(), unit: "-" }; n];
        let (few, many): (Vec<_>, Vec<_>) = sensors.iter().partition(|own| own.model.layout() == ReadingLayout::Vector);
        let n: usize = few.iter().map(|sensor| sensor.model.channels().len()).sum();
        log.sensor_channels = named(n);
        log.sensor_readings = (0..3).flat_map(|i| read(i, n)).collect();
        log.scans.extend(many.into_iter().map(|own| {
            let (layout, n) = (own.model.layout(), own.model.channels().len());
            // two readings in three steps
            let readings = (0..2).flat_map(|i| read(i, n)).collect();
            Scans { sensor: own.name.clone(), layout, channels: named(n), time: vec![0.0, 0.1], readings }
        }));
        let figures = sensor_figures(sensors, &log);
        assert!(figures.iter().zip(sensors).all(|((name, _), sensor)| *name == sensor.name));
        figures.iter().map(|(_, figure)| figure.svg().unwrap()).collect()
    }
}
