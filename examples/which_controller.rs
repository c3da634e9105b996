//! Every controller of the registry on the same manoeuvre: prints the tables of docs/which-controller.md and draws its figures.
//!
//! `cargo run --release --example which_controller -- [FOLDER]`: a minute.

use omnidrones::controllers::optimal::MpcSettings;
use omnidrones::controllers::reference::Lemniscate;
use omnidrones::controllers::registry::{REGISTRY, controller};
use omnidrones::controllers::{Kinematics, RateDivisors, Setup};
use omnidrones::dynamics::aero::wind::Wind;
use omnidrones::error::{Error, Result};
use omnidrones::flight::FlightLog;
use omnidrones::prelude::*;
use omnidrones_plot::{Colour, Figure, Panel, Series};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The start is left out of the errors, s: the reference begins with a jump of acceleration.
const START: f64 = 2.0;
/// Of the lemniscate of vehicles and of systems of bodies, rad/s.
const RATES: [f64; 2] = [1.5, 0.5];
/// Length of their flights, s: a whole lap after the start.
const LENGTHS: [f64; 2] = [8.0, 15.0];
/// Steps of 2 ms by which commands are late.
const LATE: usize = 10;
/// Plans of larger states take too long for a page, or for a build with checks.
const MOST_STATES: usize = if cfg!(debug_assertions) { 30 } else { 60 };
/// Flights whose steps are timed; of each step the shortest time counts, since other programs only add to it. A build with checks
/// measures nothing: it flies once.
const REPEATS: usize = if cfg!(debug_assertions) { 1 } else { 3 };
/// Samples of a log that are drawn.
const DRAWN: usize = 300;

/// A controller under a stop watch.
struct Timed {
    inner: Box<dyn Controller>,
    /// Of every tick, s.
    times: Vec<f64>,
}

impl Controller for Timed {
    fn name(&self) -> &str {
        self.inner.name()
    }
    fn rate(&self) -> Option<f64> {
        self.inner.rate()
    }
    fn schedule(&self) -> Option<RateDivisors> {
        self.inner.schedule()
    }
    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        self.inner.tracked(state)
    }
    fn reset(&mut self) {
        self.inner.reset();
    }
    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, commands: &mut [f64]) {
        let clock = Instant::now();
        self.inner.tick(seen, target, commands);
        self.times.push(clock.elapsed().as_secs_f64());
    }
}

fn main() -> Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or("which-controller".into()));
    std::fs::create_dir_all(&folder).map_err(|e| Error::file(&folder, e))?;
    vehicles_table(&folder)?;
    println!();
    systems_table(&folder)
}

fn plan(is_vehicle: bool) -> FlightPlan {
    let [rate, duration] = [RATES, LENGTHS].map(|of| of[usize::from(!is_vehicle)]);
    let origin = [0.0, 0.0, if is_vehicle { 2.0 } else { 4.0 }];
    let reference = Reference::Lemniscate(Lemniscate { rate, origin, ..Lemniscate::default() });
    FlightPlan { reference, duration, ..FlightPlan::default() }
}

fn windy(plan: &FlightPlan) -> FlightPlan {
    FlightPlan { wind: Wind::Constant { velocity: [5.0, 0.0, 0.0] }, ..plan.clone() }
}

/// The vehicle with a tenth more of mass and inertia.
fn heavier(vehicle: &Vehicle) -> Vehicle {
    let mut heavy = vehicle.clone();
    for part in &mut heavy.parts {
        part.mass *= 1.1;
        let i = &mut part.inertia;
        for x in [&mut i.xx, &mut i.yy, &mut i.zz, &mut i.xy, &mut i.xz, &mut i.yz] {
            *x *= 1.1;
        }
    }
    heavy
}

fn vehicles_table(folder: &Path) -> Result<()> {
    let (still, vehicle) = (plan(true), vehicles::by_name("hummingbird")?);
    let wind = windy(&still);
    let late = FlightPlan { latency: LATE, ..still.clone() };
    let plant = Plant::of_vehicle(&vehicle, still.air_physics())?;
    let heavy = Plant::of_vehicle(&heavier(&vehicle), still.air_physics())?;
    let in_air = Plant::of_vehicle(&vehicle, wind.air_physics())?;
    let setup = Setup::new(None, &still.rates);
    println!("| controller | still air | 5 m/s of wind | 20 ms late | 10 % heavier | µs a step; 99 % of ticks |");
    println!("|---|---|---|---|---|---|");
    for entry in REGISTRY.iter().filter(|entry| entry.suits(&plant)) {
        let own = |believed: &Plant| controller(entry.name, believed, &setup);
        let once = |truth: &Plant, plan: &FlightPlan| -> Result<String> {
            Ok(error(&fly(truth, &mut *own(&plant)?, plan, &mut |_| ())?))
        };
        let (flight, time) = timed(&in_air, &|| own(&in_air), &wind)?;
        let [calm, late, heavy] = [(&plant, &still), (&plant, &late), (&heavy, &still)].map(|(p, plan)| once(p, plan));
        println!("| `{}` | {} | {} | {} | {} | {time} |", entry.name, calm?, error(&flight), late?, heavy?);
        figure(&flight.log, &wind).save(folder.join(format!("{}.svg", entry.name)))?;
    }
    let told = MpcSettings { latency: LATE, ..MpcSettings::for_plant(&plant) };
    let mut mpc = controller("mpc", &plant, &Setup { mpc: Some(&told), ..setup })?;
    println!("| `mpc`, told so | | | {} | | |", error(&fly(&plant, &mut *mpc, &late, &mut |_| ())?));
    Ok(())
}

fn systems_table(folder: &Path) -> Result<()> {
    let still = plan(false);
    let wind = windy(&still);
    let setup = Setup::new(None, &still.rates);
    println!("| flown | controller | still air | 5 m/s of wind | µs a step; 99 % of ticks |\n|---|---|---|---|---|");
    for name in ["payload", "inverted_pendulum", "platform", "transport", "omav_tilting"] {
        let [calm, in_air] =
            [&still, &wind].map(|plan| Plant::of_model(&configurations::by_name(name)?, plan.air_physics()));
        let (calm, in_air) = (calm?, in_air?);
        for entry in REGISTRY.iter().filter(|entry| entry.suits(&calm)) {
            if entry.name.starts_with("mpc") && calm.n_state() > MOST_STATES {
                continue;
            }
            let own = |believed: &Plant| controller(entry.name, believed, &setup);
            // suits by its make, but says that it cannot steer this one
            if own(&calm).is_err() {
                continue;
            }
            let (flight, time) = timed(&calm, &|| own(&calm), &still)?;
            let windy = fly(&in_air, &mut *own(&in_air)?, &wind, &mut |_| ())?;
            println!("| {name} | `{}` | {} | {} | {time} |", entry.name, error(&flight), error(&windy));
            figure(&flight.log, &still).save(folder.join(format!("{name}-{}.svg", entry.name)))?;
        }
    }
    Ok(())
}

/// A flight, and in words how long a step of it takes and what 99 % of ticks are within.
fn timed(plant: &Plant, make: &dyn Fn() -> Result<Box<dyn Controller>>, plan: &FlightPlan) -> Result<(Flight, String)> {
    let mut best: Option<(Flight, Vec<f64>)> = None;
    for _ in 0..REPEATS {
        let mut own = Timed { inner: make()?, times: Vec::new() };
        let flight = fly(plant, &mut own, plan, &mut |_| ())?;
        let times = match best {
            Some((_, earlier)) => earlier.iter().zip(&own.times).map(|(a, b)| a.min(*b)).collect(),
            None => own.times,
        };
        best = Some((flight, times));
    }
    let (flight, mut times) = best.expect("flown above");
    let a_step = times.iter().sum::<f64>() / flight.log.len() as f64;
    times.sort_by(f64::total_cmp);
    let late = times.get(times.len() * 99 / 100).copied().unwrap_or(f64::NAN);
    Ok((flight, format!("{}; {}", rounded(1e6 * a_step), rounded(1e6 * late))))
}

/// Of two digits.
fn rounded(x: f64) -> String {
    if x < 10.0 { format!("{x:.1}") } else { format!("{x:.0}") }
}

fn error(flight: &Flight) -> String {
    match flight.log.rmse(START) {
        Some(metres) if flight.lost().is_none() && flight.diverged_at.is_none() => format!("{:.1} mm", 1e3 * metres),
        _ => "lost".into(),
    }
}

/// Path from above, distance to the reference, commands; on the same scales for all.
fn figure(log: &FlightLog, plan: &FlightPlan) -> Figure {
    let every = (log.len() / DRAWN).max(1);
    let above = |rows: &[[f64; 3]]| rows.iter().step_by(every).map(|p| (p[0], p[1])).collect();
    let path = Panel::new("From above", "x [m]", "y [m]")
        .x_range(-3.2, 3.2)
        .y_range(-1.6, 1.6)
        .series(Series::line("reference", above(&log.reference_position)).colour(Colour::INK).dashed().width(1.0))
        .series(Series::line("flown", above(&log.position)).colour(Colour::BLUE));
    let distance = log.time.iter().copied().zip(log.error_norm().into_iter().map(|e| 100.0 * e));
    let error = Panel::new("Distance to the reference", "time [s]", "error [cm]")
        .log_y()
        .y_range(0.1, 300.0)
        .x_range(0.0, plan.duration)
        .series(Series::line("", distance.step_by(every).collect()).colour(Colour::VERMILLION));
    let n = log.n_rotor();
    let share = |k: usize, i: usize| (log.rotor_command[k * n + i] / log.max_rotor_speed[i]).powi(2);
    let rotors = Panel::new("Commands of the first four rotors", "time [s]", "share of most thrust [-]");
    let rotors = rotors.x_range(0.0, plan.duration).y_range(0.0, 1.05);
    let rotors = (0..n.min(4)).fold(rotors, |panel, i| {
        let own = (0..log.len()).step_by(every).map(|k| (log.time[k], share(k, i))).collect();
        panel.series(Series::line("", own).colour(Colour::nth(i)).width(0.8))
    });
    Figure::new("")
        .size(1000.0, 240.0)
        .grid(&[1.35, 1.0, 1.0], &[1.0])
        .place((0, 0), (1, 1), path)
        .place((1, 0), (1, 1), error)
        .place((2, 0), (1, 1), rotors)
}
