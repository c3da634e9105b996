//! A flight read back from its CSV file.

use super::{Commanded, FlightLog, FlightSample};
use base::error::{Error, Result};
use base::file_gate;
use std::collections::HashMap;
use std::path::Path;

/// Largest file of a flight, bytes: half a million steps.
const MAX_BYTES: u64 = 1 << 28;

impl FlightLog {
    /// The flight in a file of [`write_csv`](Self::write_csv), whatever order its columns have; others are passed over. The file
    /// does not tell the vehicle's name and the limits of its rotors: they are empty and NaN. Readings of sensors, asked angles and a
    /// leaning hover's attitude are not read back.
    ///
    /// # Errors
    /// [`Error::File`], [`Error::Limit`] above 256 MiB, and [`Error::Format`] for a file without a column or a sample, for
    /// cells that are no numbers and for times that do not ascend.
    pub fn read_csv(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let text = file_gate::read_text(path, MAX_BYTES)?;
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let header: Vec<String> = match reader.headers() {
            Ok(names) => names.iter().map(|name| name.trim().to_string()).collect(),
            Err(error) => return Err(unlike(path, "line 1".into(), error.to_string())),
        };
        if let Some(separator) = foreign_separator(&header) {
            return Err(unlike_columns(path, separator));
        }
        let mut log = Self::like(&header);
        let names = log.csv_header();
        // of two of one name the first counts
        let known: HashMap<&str, usize> = header.iter().enumerate().rev().map(|(k, name)| (name.as_str(), k)).collect();
        let places = names.iter().map(|name| {
            let place = known.get(name.as_str()).copied();
            place.ok_or_else(|| unlike(path, "line 1".into(), format!("has no column '{name}'")))
        });
        let places: Vec<usize> = places.collect::<Result<_>>()?;
        log.commanded.clear();
        let mut row = Vec::new();
        for (i, record) in reader.records().enumerate() {
            let line = format!("line {}", i + 2);
            let record = record.map_err(|error| unlike(path, line.clone(), error.to_string()))?;
            row.clear();
            for (name, at) in names.iter().zip(&places) {
                let cell = record.get(*at).unwrap_or_default();
                let number = cell.trim().parse::<f64>();
                row.push(number.map_err(|_| unlike(path, line.clone(), unlike_number(cell, name)))?);
            }
            if !(row[0].is_finite() && log.time.last().is_none_or(|last| *last < row[0])) {
                return Err(unlike(path, line, format!("has the time {} s, which is not after the last", row[0])));
            }
            log.push_row(&row)?;
        }
        if log.is_empty() { Err(unlike(path, "line 2".into(), "is not there: no samples".into())) } else { Ok(log) }
    }

    /// Without a sample, with the columns that a header tells: as many rotors, and one blank row of commands where it has them.
    fn like(header: &[String]) -> Self {
        // columns of sensors have a dot in their names
        let header: Vec<&String> = header.iter().filter(|name| !name.contains('.')).collect();
        let n_rotor = header.iter().filter(|name| name.starts_with("rotor_speed_")).count();
        let mut log = Self::new("", &vec![f64::NAN; n_rotor]);
        if header.iter().any(|name| name.starts_with("commanded_")) {
            log.commanded.push(Commanded { thrust: 0.0, attitude: [0.0; 4], angular_velocity: [0.0; 3] });
        }
        log
    }

    /// Appends numbers in the order of [`csv_header`](Self::csv_header).
    fn push_row(&mut self, row: &[f64]) -> Result<()> {
        let (mut cells, n) = (Cells(row), self.n_rotor());
        let [time] = cells.take();
        let (position, velocity, attitude, angular_velocity) = (cells.take(), cells.take(), cells.take(), cells.take());
        let (reference_position, reference_velocity, reference_acceleration) =
            (cells.take(), cells.take(), cells.take());
        let [reference_yaw] = cells.take();
        let [rotor_speed, rotor_command, thrust] = [(); 3].map(|()| cells.slice(n));
        let wind = cells.take();
        if !cells.0.is_empty() {
            let [thrust] = cells.take();
            self.commanded.push(Commanded { thrust, attitude: cells.take(), angular_velocity: cells.take() });
        }
        self.push(FlightSample {
            time,
            position,
            velocity,
            attitude,
            angular_velocity,
            reference_position,
            reference_velocity,
            reference_acceleration,
            reference_yaw,
            rotor_speed,
            rotor_command,
            thrust,
            wind,
        })
    }
}

/// What is left of a row.
struct Cells<'a>(&'a [f64]);

impl<'a> Cells<'a> {
    fn slice(&mut self, n: usize) -> &'a [f64] {
        let (head, rest) = self.0.split_at(n);
        self.0 = rest;
        head
    }

    fn take<const N: usize>(&mut self) -> [f64; N] {
        let head = self.slice(N);
        std::array::from_fn(|i| head[i])
    }
}

/// What separates the columns of a header that was read as one column.
fn foreign_separator(header: &[String]) -> Option<&'static str> {
    let [whole] = header else { return None };
    [(';', "semicolons"), ('\t', "tabs"), ('|', "bars")]
        .into_iter()
        .find(|(c, _)| whole.contains(*c))
        .map(|(_, name)| name)
}

/// What is wrong with a cell that is no number.
fn unlike_number(cell: &str, name: &str) -> String {
    let decimal = cell.trim().replacen(',', ".", 1).parse::<f64>().is_ok();
    format!("has '{cell}' as its {name}{}", if decimal { ", with a decimal comma where a point must be" } else { "" })
}

fn unlike_columns(path: &Path, separator: &str) -> Error {
    Error::Format {
        file: path.display().to_string(),
        place: "line 1".into(),
        rule: format!("separates its columns by {separator}"),
        remedy:
            "Save it with commas between columns and a decimal point in numbers, as omnidrones fly --csv writes it."
                .into(),
    }
}

fn unlike(path: &Path, place: String, rule: String) -> Error {
    let remedy = "Give the flight.csv of a flight: omnidrones fly --csv writes it.".into();
    Error::Format { file: path.display().to_string(), place, rule, remedy }
}

#[cfg(test)]
mod tests;
