//! The record of one flight: what was, what should have been, what the rotors did; its key figures; its CSV file.

mod read;
mod scans;

pub use scans::Scans;

use autodiff::System;
use base::error::{Error, Result};
use dynamics::rotor::LEAST_THRUST;
use dynamics::spatial::{Quat, Vec3, conjugate, cross, dot, from_euler, multiply, rotate, to_euler, up_axis};
use dynamics::vehicle::GRAVITY;
use dynamics::{Plant, Quantity};
use serde::Serialize;
use std::path::Path;

/// Farther from the reference than this, what flies counts as lost, m.
pub const LOST: f64 = 5.0;

/// One instant of a flight. Rotor slices have one entry per rotor of the log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightSample<'a> {
    /// Time of the flight, s.
    pub time: f64,
    /// World, m.
    pub position: [f64; 3],
    /// World, m/s.
    pub velocity: [f64; 3],
    /// Body → world, `[w, x, y, z]`.
    pub attitude: [f64; 4],
    /// Body, rad/s.
    pub angular_velocity: [f64; 3],
    /// World, m.
    pub reference_position: [f64; 3],
    /// World, m/s.
    pub reference_velocity: [f64; 3],
    /// World, m/s².
    pub reference_acceleration: [f64; 3],
    /// rad.
    pub reference_yaw: f64,
    /// rad/s.
    pub rotor_speed: &'a [f64],
    /// Commanded rotor speed, rad/s (Ω_cmd, not the action in [−1, 1]).
    pub rotor_command: &'a [f64],
    /// N.
    pub thrust: &'a [f64],
    /// World, m/s.
    pub wind: [f64; 3],
}

/// What the levels of a cascade asked of the next ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Commanded {
    /// Total thrust along body z, N: of the velocity level.
    pub thrust: f64,
    /// Body → world, `[w, x, y, z]`, w ≥ 0: of the velocity level.
    pub attitude: [f64; 4],
    /// Body, rad/s: of the attitude level.
    pub angular_velocity: [f64; 3],
}

/// A flight in columns, row i of each belonging to `time[i]`. Rotor columns are row-major `[sample, rotor]`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FlightLog {
    /// For titles.
    pub vehicle: String,
    /// Ω_max, rad/s, `[rotor]`; NaN where it is not known.
    pub max_rotor_speed: Vec<f64>,
    /// s.
    pub time: Vec<f64>,
    /// World, m.
    pub position: Vec<[f64; 3]>,
    /// World, m/s.
    pub velocity: Vec<[f64; 3]>,
    /// Body → world, `[w, x, y, z]`.
    pub attitude: Vec<[f64; 4]>,
    /// Body, rad/s.
    pub angular_velocity: Vec<[f64; 3]>,
    /// World, m.
    pub reference_position: Vec<[f64; 3]>,
    /// World, m/s.
    pub reference_velocity: Vec<[f64; 3]>,
    /// World, m/s².
    pub reference_acceleration: Vec<[f64; 3]>,
    /// rad.
    pub reference_yaw: Vec<f64>,
    /// rad/s, `[sample, rotor]`.
    pub rotor_speed: Vec<f64>,
    /// Commanded speed, rad/s, `[sample, rotor]`.
    pub rotor_command: Vec<f64>,
    /// N, `[sample, rotor]`.
    pub thrust: Vec<f64>,
    /// World, m/s.
    pub wind: Vec<[f64; 3]>,
    /// (roll, pitch, yaw) that were asked apart from the force, rad, one per sample; empty where the force chose the attitude.
    pub asked_angles: Vec<[f64; 3]>,
    /// Body → world at yaw 0, `[w, x, y, z]`, of a [hover](dynamics::HoverTrim) that leans: tilt, heading and what the reference
    /// asks are measured from there. `None` for one that is level, and where it is not known.
    pub hover_attitude: Option<[f64; 4]>,
    /// Commands between the levels of a cascade, one per sample; empty where the controller has no such levels.
    pub commanded: Vec<Commanded>,
    /// What sensors read but for cameras and lidars, by name and unit; empty without any.
    pub sensor_channels: Vec<Quantity>,
    /// Their readings, row-major `[sample, channel]`.
    pub sensor_readings: Vec<f64>,
    /// What cameras and lidars read; no part of the CSV.
    pub scans: Vec<Scans>,
}

/// The key figures of a flight.
///
/// An RMSE is `None` (`null`) when no sample lies in its window or one of them is not finite: a mean over the rest
/// would hide a divergence. Maxima are over the finite samples, `None` without any; `non_finite_samples` says how many are not.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlightSummary {
    /// Name of the vehicle.
    pub vehicle: String,
    /// Number of samples.
    pub samples: usize,
    /// Last minus first time, s.
    pub duration: f64,
    /// Start of the window of `rmse`, s.
    pub rmse_after: f64,
    /// Root of the mean of ‖p − p_ref‖² for t ≥ `rmse_after`, m.
    pub rmse: Option<f64>,
    /// Largest ‖p − p_ref‖ for t ≥ `rmse_after`, m.
    pub max_error: Option<f64>,
    /// Largest ‖p − p_ref‖ of the whole flight, m.
    pub max_error_overall: Option<f64>,
    /// Since when the reference was lost, s: [`FlightLog::lost_at`].
    pub lost_at: Option<f64>,
    /// Largest ‖v‖, m/s.
    pub max_speed: Option<f64>,
    /// Largest angle between world z and what points up in hover, rad: [`FlightLog::tilt`].
    pub max_tilt: Option<f64>,
    /// Root of the mean square of the heading's error for t ≥ `rmse_after`, rad: [`FlightLog::heading_error`].
    pub heading_rmse: Option<f64>,
    /// Largest heading error for t ≥ `rmse_after`, rad.
    pub max_heading_error: Option<f64>,
    /// Share of rotor commands at Ω_max or at the idle floor, 0 to 1: [`FlightLog::saturation_share`].
    pub saturation: Option<f64>,
    /// Samples with a position, velocity, attitude or reference position that is not finite.
    pub non_finite_samples: usize,
}

impl FlightLog {
    /// Memory of one sample of a flight of this plant, with its state and `n_reading` numbers of sensors, bytes.
    #[doc(hidden)]
    pub fn bytes_of_sample(plant: &Plant, n_reading: usize) -> usize {
        let fixed = size_of::<FlightSample<'_>>() + size_of::<Commanded>();
        fixed + (3 * plant.rotors().len() + plant.n_state() + n_reading) * size_of::<f64>()
    }

    /// An empty log of a vehicle whose rotors reach `max_rotor_speed` (rad/s, one per rotor).
    pub fn new(vehicle: impl Into<String>, max_rotor_speed: &[f64]) -> Self {
        Self { vehicle: vehicle.into(), max_rotor_speed: max_rotor_speed.to_vec(), ..Self::default() }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.time.len()
    }

    /// Whether nothing was recorded.
    pub fn is_empty(&self) -> bool {
        self.time.is_empty()
    }

    /// Number of rotors.
    pub fn n_rotor(&self) -> usize {
        self.max_rotor_speed.len()
    }

    /// Appends a sample. Non-finite values are kept: they show where a flight diverged.
    ///
    /// # Errors
    /// [`Error::Value`] for a rotor slice that has not one entry per rotor; nothing is appended then.
    pub fn push(&mut self, sample: FlightSample<'_>) -> Result<()> {
        let n = self.n_rotor();
        for (what, column) in
            [("rotor_speed", sample.rotor_speed), ("rotor_command", sample.rotor_command), ("thrust", sample.thrust)]
        {
            if column.len() != n {
                return Err(Error::value(
                    format!("flight log: length of {what}"),
                    column.len(),
                    format!("{n}, the number of rotors"),
                    "Make the log with one max_rotor_speed per rotor.",
                ));
            }
        }
        self.time.push(sample.time);
        self.position.push(sample.position);
        self.velocity.push(sample.velocity);
        self.attitude.push(sample.attitude);
        self.angular_velocity.push(sample.angular_velocity);
        self.reference_position.push(sample.reference_position);
        self.reference_velocity.push(sample.reference_velocity);
        self.reference_acceleration.push(sample.reference_acceleration);
        self.reference_yaw.push(sample.reference_yaw);
        self.rotor_speed.extend_from_slice(sample.rotor_speed);
        self.rotor_command.extend_from_slice(sample.rotor_command);
        self.thrust.extend_from_slice(sample.thrust);
        self.wind.push(sample.wind);
        Ok(())
    }

    /// p − p_ref per sample, m.
    pub fn tracking_error(&self) -> Vec<[f64; 3]> {
        let pairs = self.position.iter().zip(&self.reference_position);
        pairs.map(|(p, r)| [p[0] - r[0], p[1] - r[1], p[2] - r[2]]).collect()
    }

    /// ‖p − p_ref‖ per sample, m.
    pub fn error_norm(&self) -> Vec<f64> {
        self.tracking_error().iter().map(norm).collect()
    }

    /// √(mean ‖p − p_ref‖²) over t ≥ `after` (s), m; `None` when no sample is there or one of them is not finite.
    pub fn rmse(&self, after: f64) -> Option<f64> {
        let errors = self.error_norm();
        rms(self.time.iter().zip(errors).filter(|(t, _)| t.is_nan() || **t >= after).map(|(_, e)| e))
    }

    /// Largest finite ‖p − p_ref‖ over t ≥ `after` (s), m; `None` without one.
    pub fn max_error(&self, after: f64) -> Option<f64> {
        let late = self.time.iter().zip(self.error_norm()).filter(|(t, _)| **t >= after);
        largest(late.map(|(_, e)| e))
    }

    /// Since when ‖p − p_ref‖ has been above [`LOST`], or not finite, until the end, s; `None` where it is not in the end.
    pub fn lost_at(&self) -> Option<f64> {
        let found = self.error_norm().iter().rposition(|e| *e <= LOST);
        self.time.get(found.map_or(0, |i| i + 1)).copied()
    }

    /// ‖v‖ per sample, m/s.
    pub fn speed(&self) -> Vec<f64> {
        self.velocity.iter().map(norm).collect()
    }

    /// Largest finite ‖v‖, m/s; `None` without one.
    pub fn max_speed(&self) -> Option<f64> {
        largest(self.speed().into_iter())
    }

    /// The attitude per sample of the axes that are level in hover: the body's, but of a vehicle that leans.
    fn attitude_from_hover(&self) -> impl Iterator<Item = Quat<f64>> {
        let back = self.hover_attitude.map(conjugate);
        self.attitude.iter().map(move |q| back.map_or(*q, |back| multiply(*q, back)))
    }

    /// Angle between world z and the axis that points up in hover per sample, rad, 0 to π: body z, but of a vehicle that leans.
    pub fn tilt(&self) -> Vec<f64> {
        let angle = |q: Quat<f64>| {
            let z = up_axis(q);
            z[0].hypot(z[1]).atan2(z[2])
        };
        self.attitude_from_hover().map(angle).collect()
    }

    /// Largest finite [tilt](Self::tilt), rad; `None` without one.
    pub fn max_tilt(&self) -> Option<f64> {
        largest(self.tilt().into_iter())
    }

    /// Angle about body z per sample, within ±π, rad, from the attitude that has the same body z and the reference's yaw:
    /// b₂ along b₃ × (cos ψ, sin ψ, 0), as `desired_attitude` of the velocity level. Upright it
    /// is heading less yaw; where roll and pitch were asked apart from the force, that at any tilt. 0 where there is no heading.
    /// Of a vehicle that leans in hover, in the axes that are level there.
    pub fn heading_error(&self) -> Vec<f64> {
        let apart = !self.asked_angles.is_empty();
        let pairs = self.attitude_from_hover().zip(&self.attitude).zip(&self.reference_yaw);
        let error = |((q, body), yaw): ((Quat<f64>, &Quat<f64>), &f64)| {
            let (s, c) = yaw.sin_cos();
            if apart {
                let [x, y, _] = rotate(*body, [1.0, 0.0, 0.0]);
                return angle(c * y - s * x, c * x + s * y);
            }
            let (up, left) = (up_axis(q), rotate(q, [0.0, 1.0, 0.0]));
            let wanted = cross(up, [c, s, 0.0]);
            angle(dot(up, cross(wanted, left)), dot(wanted, left))
        };
        pairs.map(error).collect()
    }

    /// Share of rotor commands at or beyond Ω_max or the idle floor 0.01 Ω_max (to 1e-6 of Ω_max), 0 to 1; `None` without rotors or
    /// samples and where an Ω_max is not known.
    pub fn saturation_share(&self) -> Option<f64> {
        let n = self.n_rotor();
        if n == 0 || self.rotor_command.is_empty() || self.max_rotor_speed.iter().any(|most| most.is_nan()) {
            return None;
        }
        let limits = self.max_rotor_speed.iter().cycle();
        let idle = LEAST_THRUST.sqrt();
        let at_limit = |(command, limit): &(&f64, &f64)| {
            **command >= (1.0 - 1e-6) * **limit || **command <= (idle + 1e-6) * **limit
        };
        let count = self.rotor_command.iter().zip(limits).filter(at_limit).count();
        Some(count as f64 / self.rotor_command.len() as f64)
    }

    /// Rotor `i`, less than [`n_rotor`](Self::n_rotor), of a row-major rotor column `[sample, rotor]` of this log, as (time in s, value).
    pub fn rotor_history(&self, column: &[f64], i: usize) -> Vec<(f64, f64)> {
        let n = self.n_rotor().max(1);
        self.time.iter().copied().zip(column.iter().copied().skip(i).step_by(n)).collect()
    }

    /// (roll, pitch, yaw) of the body per sample, rad: R = Rz(yaw) Ry(pitch) Rx(roll).
    pub fn euler_angles(&self) -> Vec<[f64; 3]> {
        self.attitude.iter().map(|q| to_euler(*q)).collect()
    }

    /// (roll, pitch, yaw) per sample that the reference asks of a vehicle without drag, rad: body z along a_ref + g e_z,
    /// heading from the reference yaw (Mellinger and Kumar 2011, section III); NaN in free fall. Where angles were asked apart
    /// from the force, those. Of a vehicle that leans in hover, what points up there takes the place of body z.
    pub fn reference_euler_angles(&self) -> Vec<[f64; 3]> {
        if !self.asked_angles.is_empty() {
            return self.asked_angles.clone();
        }
        let pairs = self.reference_acceleration.iter().zip(&self.reference_yaw);
        pairs
            .map(|(a, yaw)| {
                let (s, c) = yaw.sin_cos();
                // Thrust direction in the frame turned by the yaw alone.
                let (x, y, z) = (c * a[0] + s * a[1], c * a[1] - s * a[0], a[2] + GRAVITY);
                if x.hypot(y).hypot(z) < 1e-9 {
                    return [f64::NAN; 3];
                }
                let [roll, pitch, yaw] = [(-y).atan2(x.hypot(z)), x.atan2(z), yaw.sin().atan2(yaw.cos())];
                let leaning = |hover| to_euler(multiply(from_euler(roll, pitch, yaw), hover));
                self.hover_attitude.map_or([roll, pitch, yaw], leaning)
            })
            .collect()
    }

    /// (roll, pitch, yaw) per sample that a cascade's velocity level commanded, rad; empty without one.
    pub fn commanded_euler_angles(&self) -> Vec<[f64; 3]> {
        self.commanded.iter().map(|c| to_euler(c.attitude)).collect()
    }

    /// Key figures; errors of position and heading over t ≥ `after` (s).
    pub fn summary(&self, after: f64) -> FlightSummary {
        let duration = match (self.time.first(), self.time.last()) {
            (Some(first), Some(last)) => last - first,
            _ => 0.0,
        };
        let broken = |i: &usize| {
            let fine = |v: &[f64]| v.iter().all(|x| x.is_finite());
            !(fine(&self.position[*i])
                && fine(&self.velocity[*i])
                && fine(&self.attitude[*i])
                && fine(&self.reference_position[*i]))
        };
        let heading = self.heading_error();
        let late = || self.time.iter().zip(&heading).filter(|(t, _)| t.is_nan() || **t >= after).map(|(_, e)| e);
        FlightSummary {
            vehicle: self.vehicle.clone(),
            samples: self.len(),
            duration,
            rmse_after: after,
            rmse: self.rmse(after),
            max_error: self.max_error(after),
            max_error_overall: self.max_error(f64::NEG_INFINITY),
            lost_at: self.lost_at(),
            max_speed: self.max_speed(),
            max_tilt: self.max_tilt(),
            heading_rmse: rms(late().copied()),
            max_heading_error: largest(late().map(|e| e.abs())),
            saturation: self.saturation_share(),
            non_finite_samples: (0..self.len()).filter(broken).count(),
        }
    }

    /// Names of the CSV columns, units in brackets, in the order they are written.
    pub fn csv_header(&self) -> Vec<String> {
        let xyz = |name: &str, unit: &str| ["x", "y", "z"].map(|axis| format!("{name}_{axis} [{unit}]"));
        let rotors = |name: &str, unit: &str| -> Vec<String> {
            (0..self.n_rotor()).map(|i| format!("{name}_{i} [{unit}]")).collect()
        };
        let mut header = vec!["time [s]".to_string()];
        header.extend(xyz("position", "m"));
        header.extend(xyz("velocity", "m/s"));
        header.extend(["w", "x", "y", "z"].map(|c| format!("attitude_{c} [-]")));
        header.extend(xyz("angular_velocity", "rad/s"));
        header.extend(xyz("reference_position", "m"));
        header.extend(xyz("reference_velocity", "m/s"));
        header.extend(xyz("reference_acceleration", "m/s^2"));
        header.push("reference_yaw [rad]".to_string());
        header.extend(rotors("rotor_speed", "rad/s"));
        header.extend(rotors("rotor_command", "rad/s"));
        header.extend(rotors("thrust", "N"));
        header.extend(xyz("wind", "m/s"));
        if !self.commanded.is_empty() {
            header.push("commanded_thrust [N]".to_string());
            header.extend(["w", "x", "y", "z"].map(|c| format!("commanded_attitude_{c} [-]")));
            header.extend(xyz("commanded_angular_velocity", "rad/s"));
        }
        header.extend(self.sensor_channels.iter().map(|channel| format!("{} [{}]", channel.name, channel.unit)));
        header
    }

    /// About how many bytes [`write_csv`](Self::write_csv) writes, estimated from at most 16 of its rows.
    pub fn csv_size(&self) -> u64 {
        csv_size(&self.csv_header(), self.len(), |i, row| self.csv_row(i, row))
    }

    /// Row `i` in the order of [`csv_header`](Self::csv_header).
    fn csv_row(&self, i: usize, row: &mut Vec<f64>) {
        let n = self.n_rotor();
        row.clear();
        row.push(self.time[i]);
        row.extend(self.position[i]);
        row.extend(self.velocity[i]);
        row.extend(self.attitude[i]);
        row.extend(self.angular_velocity[i]);
        row.extend(self.reference_position[i]);
        row.extend(self.reference_velocity[i]);
        row.extend(self.reference_acceleration[i]);
        row.push(self.reference_yaw[i]);
        for column in [&self.rotor_speed, &self.rotor_command, &self.thrust] {
            row.extend_from_slice(&column[i * n..(i + 1) * n]);
        }
        row.extend(self.wind[i]);
        if let Some(asked) = self.commanded.get(i) {
            row.push(asked.thrust);
            row.extend(asked.attitude);
            row.extend(asked.angular_velocity);
        }
        let width = self.sensor_channels.len();
        row.extend_from_slice(&self.sensor_readings[i * width..(i + 1) * width]);
    }

    /// The columns of the CSV: name with its unit in brackets, then one number per sample.
    pub fn columns(&self) -> Vec<(String, Vec<f64>)> {
        let mut columns: Vec<_> =
            self.csv_header().into_iter().map(|name| (name, Vec::with_capacity(self.len()))).collect();
        let mut row = Vec::new();
        for i in 0..self.len() {
            self.csv_row(i, &mut row);
            columns.iter_mut().zip(&row).for_each(|((_, column), x)| column.push(*x));
        }
        columns
    }

    /// Writes the log as CSV: one header line with units, one line per sample, numbers that read back to the same bits
    /// (`NaN`, `inf`, `-inf` where not finite). The file appears whole or not at all.
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be written.
    pub fn write_csv(&self, path: impl AsRef<Path>) -> Result<()> {
        write_rows(path.as_ref(), &self.csv_header(), self.len(), |i, row| self.csv_row(i, row))
    }
}

/// About how many bytes `n` rows take as CSV, by some of them.
fn csv_size(header: &[String], n: usize, fill: impl Fn(usize, &mut Vec<f64>)) -> u64 {
    const ROWS: usize = 16;
    let (seen, mut row, mut letters) = (n.min(ROWS), Vec::new(), 0);
    for k in 0..seen {
        fill(k * n / seen, &mut row);
        letters += row.iter().map(|x| x.to_string().len() + 1).sum::<usize>();
    }
    let head: usize = header.iter().map(|name| name.len() + 1).sum();
    (head + letters * n / seen.max(1)) as u64
}

/// Writes `n` rows below a header, whole or not at all.
fn write_rows(path: &Path, header: &[String], n: usize, fill: impl Fn(usize, &mut Vec<f64>)) -> Result<()> {
    let failed = |e: csv::Error| Error::file(path, e.into());
    base::file_gate::replace_with(path, |file| {
        let mut writer = csv::Writer::from_writer(std::io::BufWriter::new(file));
        writer.write_record(header.iter().map(|name| base::names::cell(name))).map_err(failed)?;
        let mut row = Vec::new();
        for i in 0..n {
            fill(i, &mut row);
            writer.write_record(row.iter().map(f64::to_string)).map_err(failed)?;
        }
        writer.flush().map_err(|e| Error::file(path, e))
    })
}

fn norm(v: &Vec3<f64>) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

/// Of a direction in a plane; 0 where it points out of it.
fn angle(sine: f64, cosine: f64) -> f64 {
    if sine.hypot(cosine) < 1e-3 { 0.0 } else { sine.atan2(cosine) }
}

/// Root of the mean square; `None` without values and where one is not finite.
fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), e| (sum + e * e, count + 1));
    let rms = (sum / count as f64).sqrt();
    rms.is_finite().then_some(rms)
}

fn largest(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.filter(|v| v.is_finite()).max_by(f64::total_cmp)
}
