//! The linear model of a loop with an estimator between sensors and controller.
//!
//! The law sees x̂ = x + ε in place of x. With the loop on the true state z⁺ = a z + b_m ε + b_c d, d added to the commands behind the
//! controller, the estimator adds how ε goes on:
//!
//! ```text
//! kalman       ε⁻ = A ε⁺ − B d        ε⁺ = ε⁻ + L (y − C x̂⁻)        y − C x̂⁻ = −C ε⁻
//! ekf,         ε = 0 of the body: the inertial unit feels what d does        ε = E(x) − x where the unit is late
//! complementary
//! both         Ω: ε⁺ = A_Ω ε − B_Ω d        rotor speeds follow the commands that were given, not what became of them
//! ```
//!
//! A filter that is driven by commands knows those that it gave: what becomes of them on the way to the plant it finds out by its sensors
//! alone. So margins with it are those of LQG, which may be as small as can be (Doyle 1978). What is driven by an inertial unit is not
//! moved by the commands at all, and the loop bears what it bears on the true state. Late readings are kept as what they told in addition
//! to the estimate of then, until they come.
//!
//! Source: Doyle 1978; Anderson and Moore 1990, chapter 8.

use super::error_state::ErrorState;
use super::loop_model::{LoopModel, Step};
use super::trim::{TrimTarget, trim};
use crate::closed_loop::check_latency;
use crate::estimation::{Estimator, EstimatorSettings, HoverKalman};
use crate::period::common_period;
use autodiff::Array;
use base::error::{Error, Result};
use dynamics::Plant;
use dynamics::sensors::{SensorConfig, SensorModel};
use dynamics::spatial::{cross, rotate};
use nalgebra::DMatrix;

/// Latest reading of a loop that is judged, steps: each is a state of it.
const MOST_LATE: u64 = 100;

impl LoopModel {
    /// The same loop, of a vehicle at hover in still air along x, with an estimator between these sensors and the controller. `latency` is
    /// that of the loop, steps.
    ///
    /// Margins at commands are of what becomes of a command behind controller and estimator. Measurements are of `kalman` what its sensors
    /// read, of the others the estimate that the controller is given.
    ///
    /// # Errors
    /// [`Error::Value`] for a complementary filter that the accelerometer rights, and an inertial unit that is not read in every step;
    /// [`Error::Limit`] for rates that come round after more than [`MOST_PERIOD`](Self::MOST_PERIOD) steps; as [`Estimator::new`].
    pub fn with_estimator(
        &self,
        plant: &Plant,
        sensors: &[SensorConfig],
        settings: &EstimatorSettings,
        latency: usize,
    ) -> Result<Self> {
        check_latency(latency)?;
        for sensor in sensors {
            let late = sensor.steps_late(plant.physics().dt)?;
            if late > MOST_LATE {
                let (value, limit) = (format!("{late} steps late"), format!("{MOST_LATE} steps, for margins"));
                return Err(Error::limit(sensor.place(), value, limit, "Read it sooner, or leave it out."));
            }
        }
        match Estimator::new(plant, sensors, settings)? {
            Estimator::Kalman(filter) => self.with_kalman(&filter, latency),
            Estimator::Complementary(filter) if filter.is_levelled() => {
                let rule = "beside a sensor of the attitude: the accelerometer's direction is moved by every command";
                let remedy = "Add motion_capture, or set accelerometer = 0 in the estimator's file.";
                Err(Error::value("margins with estimator complementary", "righted by the accelerometer", rule, remedy))
            }
            Estimator::Ekf(_) | Estimator::Complementary(_) => self.with_inertial(plant, sensors, latency),
        }
    }

    fn with_kalman(&self, filter: &HoverKalman, latency: usize) -> Result<Self> {
        let period = common_period(self.period() as u64, filter.period() as u64) as usize;
        if period > Self::MOST_PERIOD {
            let most = format!("{} steps", Self::MOST_PERIOD);
            let remedy = "Let rates of sensors and controller be whole parts of one another.";
            return Err(Error::limit("loop with an estimator: steps until all rates come round", period, most, remedy));
        }
        let layout = Layout::of(self, filter, latency);
        let steps = (0..period).map(|k| layout.step(&self.steps[k % self.period()], filter, k)).collect();
        let measurements = filter.told().iter().flat_map(|own| own.signals()).collect();
        Ok(Self { steps, measurements, ..self.clone() })
    }

    fn with_inertial(&self, plant: &Plant, sensors: &[SensorConfig], latency: usize) -> Result<Self> {
        let dt = plant.physics().dt;
        let unit = sensors.iter().find(|config| matches!(config.model, SensorModel::Imu(_)));
        let Some(unit) = unit else {
            return Err(Error::value("sensors", "without an inertial unit", "one imu among them", "Add imu:bmi088."));
        };
        let (every, late) = (unit.steps_between(dt)?, unit.steps_late(dt)? as usize);
        if every > 1 {
            let remedy = "Leave out its rate or every.";
            return Err(Error::value(unit.place(), format!("every {every} steps"), "read in every step", remedy));
        }
        let trimmed = trim(plant, &TrimTarget::hover())?;
        let linear = ErrorState::of_plant(plant)?.state_space(plant, &trimmed.state, &trimmed.input, 0.0)?;
        let (n, m) = (self.measurements.len(), self.commands.len());
        let rotors = n - BODY;
        let a = linear.a().view((BODY, BODY), (rotors, rotors)).into_owned();
        let b = linear.b().view((BODY, 0), (rotors, m)).into_owned();
        let held = if late > 0 { BODY * (late + 1) } else { 0 };
        let z = self.n_state();
        let ahead = ahead(unit, trimmed.state[..].array(6), late, dt);
        let width = z + rotors + held + m * latency;
        let steps = self.steps.iter().map(|step| {
            let mut e = DMatrix::zeros(n, width);
            e.view_mut((BODY, z), (rotors, rotors)).fill_with_identity();
            if late > 0 {
                let at = z + rotors;
                e.view_mut((0, at + BODY * (late - 1)), (BODY, BODY)).copy_from(&ahead[0]);
                e.view_mut((0, at + BODY * late), (BODY, BODY)).copy_from(&ahead[1]);
                (0..BODY).for_each(|k| e[(k, k)] -= 1.0);
            }
            let mut next = estimated(step, &e, width);
            next.a.view_mut((z, z), (rotors, rotors)).copy_from(&a);
            // what the unit felt, the newest first
            for (to, from) in (0..held / BODY).map(|i| (z + rotors + BODY * i, i)) {
                let from = if from == 0 { 0 } else { to - BODY };
                next.a.view_mut((to, from), (BODY, BODY)).fill_with_identity();
            }
            disturb(&mut next, &b, z, width - m * latency, latency);
            next.by_measurement = DMatrix::zeros(width, n);
            next.by_measurement.rows_mut(0, z).copy_from(&step.by_measurement);
            next.measured = e;
            (0..n).for_each(|k| next.measured[(k, k)] += 1.0);
            next
        });
        Ok(Self { steps: steps.collect(), ..self.clone() })
    }
}

/// Numbers of the error of a body.
const BODY: usize = 12;

/// The loop whose law sees x + e, e over the whole state of `width` numbers; nothing else goes on yet.
fn estimated(step: &Step, e: &DMatrix<f64>, width: usize) -> Step {
    let (z, n, m) = (step.a.nrows(), e.nrows(), step.commanded.nrows());
    let mut a = DMatrix::zeros(width, width);
    let through = &step.by_measurement * e.columns(0, width);
    a.rows_mut(0, z).copy_from(&through);
    let mut own = a.view_mut((0, 0), (z, z));
    own += &step.a;
    let mut by_command = DMatrix::zeros(width, m);
    by_command.rows_mut(0, z).copy_from(&step.by_command);
    let mut commanded = step.commanded.columns(0, n) * e.columns(0, width);
    let mut own = commanded.columns_mut(0, z);
    own += &step.commanded;
    Step { a, by_command, commanded, by_measurement: DMatrix::zeros(0, 0), measured: DMatrix::zeros(0, 0) }
}

/// −B d on what begins at `at`, d as late as the commands: its line begins at `line`, newest first.
fn disturb(next: &mut Step, b: &DMatrix<f64>, at: usize, line: usize, latency: usize) {
    let (rows, m) = b.shape();
    if latency == 0 {
        let mut own = next.by_command.view_mut((at, 0), (rows, m));
        own -= b;
        return;
    }
    let mut own = next.a.view_mut((at, line + m * (latency - 1)), (rows, m));
    own -= b;
    next.by_command.view_mut((line, 0), (m, m)).fill_with_identity();
    (1..latency).for_each(|k| {
        next.a.view_mut((line + m * k, line + m * (k - 1)), (m, m)).fill_with_identity();
    });
}

/// What an inertial unit that is read `late` steps late makes of the state of then, and of that a step before: the estimate of now.
fn ahead(unit: &SensorConfig, attitude: [f64; 4], late: usize, dt: f64) -> [DMatrix<f64>; 2] {
    let t = late as f64 * dt;
    let one = DMatrix::<f64>::identity(BODY, BODY);
    // place and velocity of the unit: p − R [r]ₓ θ, v − R [r]ₓ ω
    let mut mounted = one.clone();
    for j in 0..3 {
        let axis = [0, 1, 2].map(|k| f64::from(u8::from(k == j)));
        let swung = rotate(attitude, cross(axis, unit.position));
        (0..3).for_each(|i| (mounted[(i, 6 + j)], mounted[(3 + i, 9 + j)]) = (swung[i], swung[i]));
    }
    let back = 2.0 * &one - &mounted;
    // θ + t ω, p + t v + ½ t² a, v + t a with a the last difference of v
    let (mut now, mut before) = (one, DMatrix::zeros(BODY, BODY));
    for k in 0..3 {
        (now[(k, 3 + k)], now[(6 + k, 9 + k)]) = (t + 0.5 * t * t / dt, t);
        now[(3 + k, 3 + k)] += t / dt;
        (before[(k, 3 + k)], before[(3 + k, 3 + k)]) = (-0.5 * t * t / dt, -t / dt);
    }
    [&back * now * &mounted, &back * before * &mounted]
}

/// Where the numbers of the whole state lie: the loop, ε, readings that are under way, injections that are under way.
struct Layout {
    z: usize,
    n: usize,
    /// First register of each sensor, and how many samples of it are under way.
    registers: Vec<(usize, usize)>,
    line: usize,
    latency: usize,
    width: usize,
    /// First of each sensor's among all that is measured, and their number.
    measured: Vec<usize>,
    n_measured: usize,
}

impl Layout {
    fn of(model: &LoopModel, filter: &HoverKalman, latency: usize) -> Self {
        let (z, n) = (model.n_state(), model.measurements.len());
        let (mut at, mut n_measured) = (z + n, 0);
        let (mut registers, mut measured) = (Vec::new(), Vec::new());
        for own in filter.told() {
            let under_way = own.schedule.latency.div_ceil(own.schedule.every) as usize;
            registers.push((at, under_way));
            measured.push(n_measured);
            at += under_way * own.n();
            n_measured += own.n();
        }
        let width = at + latency * model.commands.len();
        Self { z, n, registers, line: at, latency, width, measured, n_measured }
    }

    /// Step `k` of a period.
    fn step(&self, step: &Step, filter: &HoverKalman, k: usize) -> Step {
        let told = filter.told();
        let [a, b] = filter.model();
        let late = |i: usize| told[i].schedule.latency as usize;
        let every = |i: usize| told[i].schedule.every as usize;
        // later by whole periods, so that what is under way was sampled at a step ≥ 0
        let longest = (0..told.len()).map(late).max().unwrap_or(0);
        let k = k + longest.div_ceil(filter.period()) * filter.period();
        let all = self.width + self.n_measured;
        let select = |at: usize, n: usize| DMatrix::from_fn(n, all, |i, j| f64::from(u8::from(j == at + i)));
        let mut e = select(self.z, self.n);
        let mut registers: Vec<Vec<DMatrix<f64>>> = told
            .iter()
            .zip(&self.registers)
            .map(|(own, (at, count))| (0..*count).map(|slot| select(at + slot * own.n(), own.n())).collect())
            .collect();
        // the newest first: how many samples of it came since one of step s
        let slot = |i: usize, s: usize| (k - 1) / every(i) - s / every(i);

        // what comes late, the oldest first
        let mut coming: Vec<(usize, usize)> = (0..told.len())
            .filter(|i| late(*i) > 0)
            .filter_map(|i| k.checked_sub(late(i)).filter(|s| s.is_multiple_of(every(i))).map(|s| (s, i)))
            .collect();
        coming.sort_unstable();
        for (sampled, i) in coming {
            let mut moved = told[i].gain(sampled) * &registers[i][slot(i, sampled)];
            for s in sampled..k {
                let behind = if s == sampled { i + 1 } else { 0 };
                for other in (behind..told.len()).filter(|other| told[*other].is_due(s)) {
                    let told_less = &told[other].rows * &moved;
                    if s + late(other) < k {
                        moved -= told[other].gain(s) * told_less;
                    } else {
                        registers[other][slot(other, s)] -= told_less;
                    }
                }
                moved = a * moved;
            }
            e += moved;
        }
        let mut measured = DMatrix::zeros(self.n_measured, self.width);
        for (i, own) in told.iter().enumerate() {
            // what there is to be read, whether it is or not
            measured.view_mut((self.measured[i], 0), own.rows.shape()).copy_from(&own.rows);
        }
        for (i, own) in told.iter().enumerate().filter(|(_, own)| own.is_due(k)) {
            let missing = select(self.width + self.measured[i], own.n()) - &own.rows * &e;
            if late(i) == 0 {
                e += own.gain(k) * missing;
            } else {
                registers[i].rotate_right(1);
                registers[i][0] = missing;
            }
        }

        let mut next = estimated(step, &e, self.width);
        let mut by_measurement = DMatrix::zeros(self.width, self.n_measured);
        let seen = &step.by_measurement * e.columns(self.width, self.n_measured);
        by_measurement.rows_mut(0, self.z).copy_from(&seen);
        let mut put = |at: usize, rows: &DMatrix<f64>| {
            next.a.rows_mut(at, rows.nrows()).copy_from(&rows.columns(0, self.width));
            by_measurement.rows_mut(at, rows.nrows()).copy_from(&rows.columns(self.width, self.n_measured));
        };
        put(self.z, &(a * &e));
        for (own, (at, _)) in registers.iter().zip(&self.registers) {
            own.iter().enumerate().for_each(|(slot, rows)| put(at + slot * rows.nrows(), rows));
        }
        disturb(&mut next, b, self.z, self.line, self.latency);
        next.by_measurement = by_measurement;
        next.measured = measured;
        next
    }
}

#[cfg(test)]
mod tests;
