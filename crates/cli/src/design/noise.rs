//! `omnidrones design --sensors`: what noise of sensors makes of hover, by the linear model and as flown.

use crate::prelude::*;
use omnidrones::controllers::design::{LoopDeviations, LoopModel, MeasurementNoise, NoiseFlight, flown_deviations};
use omnidrones::controllers::reference::{Hover, Reference};
use omnidrones::controllers::{ClosedLoop, Controller, Target};
use omnidrones::dynamics::Disturbance;
use omnidrones::dynamics::sensors::SensorConfig;

/// How it is flown.
const FLIGHT: NoiseFlight = NoiseFlight { settling: 5.0, duration: 20.0, seed: 0 };
/// What the linear model moves by less than this share of the axis that it moves most, it does not move: that is of second order.
const NOTHING: f64 = 1e-3;
/// Numbers of the error state that are told: position, velocity, attitude, rate.
const TOLD: usize = 12;

/// Noise, and what it makes of states and commands.
pub struct Noise {
    sources: Vec<MeasurementNoise>,
    dt: f64,
    /// What the rows are of, with their units.
    names: Vec<(String, String)>,
    linear: LoopDeviations,
    flown: LoopDeviations,
    /// By how much flights as long scatter about the linear model, relative.
    scatter: LoopDeviations,
}

/// One number that moves.
struct Row<'a> {
    name: &'a str,
    unit: &'a str,
    flown: f64,
    /// Of the linear model, and by how much a flight scatters about it; none where the linear model does not move it.
    linear: Option<(f64, f64)>,
}

impl Noise {
    /// Of a stable loop about hover, whose controller is given the truth and this noise.
    pub fn of<C: Controller + Clone>(
        sensors: &[SensorConfig],
        model: &LoopModel,
        closed: &ClosedLoop<C>,
        air: &Disturbance<f64>,
        start: &[f64],
    ) -> Result<Self> {
        let sources = MeasurementNoise::of_sensors(sensors, model.dt)?;
        let hover = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
        let signals = model.measurements.iter().take(TOLD).chain(&model.commands);
        Ok(Self {
            dt: model.dt,
            names: signals.map(|signal| (signal.name.clone(), signal.unit.clone())).collect(),
            linear: model.deviations(&sources)?,
            flown: flown_deviations(closed, (Target::level(&hover), air), start, &sources, &FLIGHT)?,
            scatter: model.scatter(&sources, FLIGHT.duration)?,
            sources,
        })
    }

    /// All that is told.
    fn rows(&self) -> Vec<Row<'_>> {
        let [linear, flown, scatter] = [&self.linear, &self.flown, &self.scatter]
            .map(|d| d.states.iter().take(TOLD).chain(&d.commands).copied().collect::<Vec<f64>>());
        let is_moved = |i: usize| {
            let alike = if i < TOLD { i / 3 * 3..i / 3 * 3 + 3 } else { TOLD..linear.len() };
            linear[i] > NOTHING * linear[alike].iter().copied().fold(0.0, f64::max)
        };
        let row = |(i, (name, unit))| {
            let linear = is_moved(i).then(|| (linear[i], scatter[i]));
            Row { name, unit, flown: flown[i], linear }
        };
        self.names.iter().map(|(name, unit)| (&name[..], &unit[..])).enumerate().map(row).collect()
    }

    /// The section of a page.
    pub fn tell(&self, page: &mut Page) {
        let sources = self.sources.iter().map(|one| {
            let unit = ["m", "m/s", "rad", "rad/s"][one.place / 3];
            let [x, y, z] = one.deviation().map(|d| short(d, 3));
            let each = if x == y && y == z { format!("{x} {unit}") } else { format!("{x}, {y}, {z} {unit}") };
            let between = duration(self.dt * one.every as f64);
            Fact::new(&one.name, each).note(format!("standard deviation of a sample, one every {between}"))
        });
        page.heading("Noise of sensors in hover").facts(sources.collect()).table(self.table());
        page.prose(format!(
            "Standard deviations of the true state and of commands, where the controller is given the truth with this noise. Linear: by the \
             Lyapunov equation. Flown: {} s of hover, less the same flight without noise; a flight scatters about the linear figure by \
             the last column. What is of second order is flown alone: commands at a limit, motors whose lags up and down differ.",
            short(FLIGHT.duration, 3)
        ));
    }

    fn table(&self) -> Table {
        Table::new("of | unit | >linear | >flown | >± of a flight").filled(self.rows().into_iter().map(|row| {
            let (scale, unit) = shown_in(row.unit);
            let [linear, scatter] = match row.linear {
                Some((linear, scatter)) => [short(scale * linear, 3), format!("{} %", short(100.0 * scatter, 2))],
                None => ["0".into(), "–".into()],
            };
            [row.name.into(), unit.into(), linear, short(scale * row.flown, 3), scatter]
        }))
    }

    /// For JSON.
    pub fn json(&self) -> Value {
        let source = |one: &MeasurementNoise| json!({ "name": one.name, "deviation": one.deviation(), "between": self.dt * one.every as f64 });
        let row = |row: Row<'_>| {
            let (linear, scatter) = row.linear.unzip();
            let linear = linear.unwrap_or(0.0);
            json!({ "of": row.name, "unit": row.unit, "linear": linear, "flown": row.flown, "scatter": scatter })
        };
        json!({
            "sources": self.sources.iter().map(source).collect::<Vec<_>>(), "flight": FLIGHT,
            "deviations": self.rows().into_iter().map(row).collect::<Vec<_>>(),
        })
    }
}

/// Factor and name of the unit in which a deviation is told.
fn shown_in(unit: &str) -> (f64, &str) {
    match unit {
        "m" => (1e3, "mm"),
        "m/s" => (1e3, "mm/s"),
        "rad" => (1e3, "mrad"),
        "rad/s" => (1e3, "mrad/s"),
        "-" => (1e3, "1/1000"),
        other => (1.0, other),
    }
}
