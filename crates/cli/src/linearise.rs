//! `omnidrones linearise`: the exact linear model of a vehicle or a configuration about a steady flight.

use super::arguments::FlightArguments;
use super::design::{is_command, modes_table, out_of_reach, reach, tidy};
use super::failure::named;
use super::robot::{self, Flyer, FlyerArguments};
use super::source;
use crate::prelude::*;
use omnidrones::controllers::RotorFailure;
use omnidrones::controllers::design::{ErrorState, Trim, TrimTarget, trim, trim_damaged};
use omnidrones::controllers::linear::{Mode, modes, unobservable};
use omnidrones::dynamics::spatial::to_euler;
use omnidrones::dynamics::{Disturbance, Physics, Plant, Vehicle};
use std::f64::consts::PI;

/// What the command is for.
pub const ABOUT: &str = "\
Find a steady flight of a vehicle or a configuration (hover, forward and climbing flight, turns, tilted hover of what tilts its \
thrusters) and differentiate one step of it exactly: A and B of the error state, in which a rotation counts three numbers, with \
names and units, the modes, and what the commands do not reach.";

const EXAMPLES: &str = "\
Examples:
  omnidrones linearise hummingbird                              at hover
  omnidrones linearise iris --velocity 8,0,1 --save iris.json   forward and climbing; A, B, C, D for other tools
  omnidrones linearise firefly --velocity 5,0,0 --yaw-rate 0.5  a turn
  omnidrones linearise payload                                  a drone with a load
  omnidrones linearise omav_tilting --roll 20                   leaning, in place
  omnidrones linearise hummingbird --fail 2                     on three rotors, spinning

Files: --save writes A, B, C, D of one step with the names and units of all signals (.json), or as one table (.csv); with \
--continuous those of dx/dt, of which this step is the Tustin equivalent.

JSON: SI units, radians.

Exit codes: 0 linearised; 2 unusable input or arguments, or no such steady flight.";

/// Arguments of `linearise`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("vehicle", robot::any_flyer), mut_arg("reference", |a| a.hide(true)), mut_arg("gains", |a| a.hide(true)), mut_arg("rates", |a| a.hide(true)))]
pub struct Arguments {
    #[command(flatten)]
    flyer: FlyerArguments,
    /// Velocity [m/s]: forward, left, up
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_delimiter = ',',
        allow_hyphen_values = true,
        help_heading = "Steady flight"
    )]
    velocity: Option<Vec<f64>>,
    /// Rate about the vertical [rad/s]
    #[arg(long, value_name = "RATE", default_value_t = 0.0, help_heading = "Steady flight")]
    yaw_rate: f64,
    /// Roll to hold [degrees]; found where it is not given
    #[arg(long, value_name = "DEGREES", help_heading = "Steady flight")]
    roll: Option<f64>,
    /// Pitch to hold [degrees]; found where it is not given
    #[arg(long, value_name = "DEGREES", help_heading = "Steady flight")]
    pitch: Option<f64>,
    /// Without this rotor, or with a share of it (1:0.6); what must spin to stay up is found in its turn, in place
    #[arg(long, value_name = "ROTOR[:SHARE]", help_heading = "Steady flight")]
    fail: Option<String>,
    /// Of dx/dt in place of one step: the system whose Tustin equivalent the step is
    #[arg(long, help_heading = "Output")]
    continuous: bool,
    /// Write the linear model into this file (.json or .csv)
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    save: Option<PathBuf>,
    /// Replace a file that exists
    #[arg(long, requires = "save", help_heading = "Output")]
    force: bool,
    /// Print one JSON object and nothing else
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Arguments {
    fn target(&self) -> Result<TrimTarget> {
        let velocity = match self.velocity.as_deref() {
            None => [Some(0.0); 3],
            Some(&[x, y, z]) => [x, y, z].map(Some),
            Some(other) => return Err(Error::value("--velocity", format!("{other:?}"), "three numbers", "As 5,0,0.")),
        };
        let tilt = [self.roll, self.pitch].map(|angle| angle.map(|a| a * PI / 180.0));
        Ok(TrimTarget { velocity, yaw_rate: self.yaw_rate, tilt, air: Disturbance::none() })
    }

    /// With the rotor that failed, if one did.
    fn steady_flight(&self, vehicle: &Vehicle, physics: Physics) -> Result<(Plant, Trim)> {
        let Some(fail) = &self.fail else {
            let plant = Plant::of_vehicle(vehicle, physics)?;
            let found = trim(&plant, &self.target()?)?;
            return Ok((plant, found));
        };
        let names: Vec<String> = vehicle.rotors.iter().map(|r| r.name.clone()).collect();
        let (rotor, share) = named(fail, &names)?;
        RotorFailure { rotor, at: 0.0, effectiveness: share }.validate(names.len())?;
        let mut health = vec![1.0; names.len()];
        health[rotor] = share;
        trim_damaged(vehicle, physics, &health, &self.target()?)
    }
}

/// Linearises.
pub fn run(a: &Arguments) -> Result<Report> {
    a.flyer.flight.check()?;
    let FlightArguments { reference, gains, rates, .. } = &a.flyer.flight;
    let rates = rates.map(|rates| format!("{rates:?}"));
    for (name, given) in [("--reference", reference), ("--gains", gains), ("--rates", &rates)] {
        if let Some(given) = given {
            return Err(Error::value(name, given, "none in 'linearise'", "Leave it out: nobody steers here."));
        }
    }
    let save = files::model_file(a.save.as_deref(), a.force)?;
    let physics = a.flyer.flight.physics();
    let (plant, found) = match (a.flyer.flyer()?, &a.fail) {
        (Flyer::Configuration(model), None) => {
            let plant = Plant::of_model(&model, physics)?;
            let found = trim(&plant, &a.target()?)?;
            (plant, found)
        }
        (Flyer::Configuration(_), Some(fail)) => {
            let remedy = "Rotors of configurations are not lost here.";
            return Err(Error::value("--fail", fail, "a rotor of a vehicle", remedy));
        }
        (Flyer::Vehicle(source), _) => a.steady_flight(&source.vehicle, physics)?,
    };
    if plant.rotors().is_empty() {
        let remedy = "Take one that flies: 'omnidrones show' lists all.";
        return Err(Error::value("configuration", format!("'{}'", plant.name()), "one with rotors", remedy));
    }
    let step = ErrorState::of_plant(&plant)?.state_space(&plant, &found.state, &found.input, found.yaw_rate)?;
    let (modes, hidden): (Vec<Mode>, _) = (modes(&step)?, out_of_reach(&step)?);
    let unseen = unobservable(&step)?;
    let model = if a.continuous { step.continuous()? } else { step };
    if let Some((file, as_json)) = save {
        let text = if as_json { format!("{:#}\n", model.to_json()) } else { model.to_csv() };
        files::replace(file, text.as_bytes())?;
        files::note_saved(file);
    }
    if a.json {
        let value = json!({
            "command": "linearise", "version": env!("CARGO_PKG_VERSION"), "success": true, "plant": plant.name(), "warnings": warnings(a, &plant), "model": model.to_json(), "reached": hidden.reached, "out_of_reach": hidden.names(model.states()),
            "trim": { "state": found.state, "input": found.input, "residual": found.residual, "limited": found.limited },
            "modes": modes.iter().map(super::design::mode_json(&model)).collect::<Vec<_>>(),
        });
        return Ok(Report::json(&value, true));
    }
    let mut page = Page::new();
    page.title(
        plant.name(),
        if a.continuous { "dx/dt about a steady flight" } else { "one step about a steady flight" },
    );
    page.notes("warning", &warnings(a, &plant), 3, "");
    page.heading("Steady flight").facts(steady(&plant, &found));
    let of_all = |n: usize| format!("{n} of {} directions", model.n_state());
    page.heading("Linear model").facts(vec![
        Fact::new("states", model.n_state().to_string()).note("of the error: a rotation counts three"),
        Fact::new("inputs", model.n_input().to_string()),
        Fact::new("step", model.dt().map_or("continuous".into(), |dt| format!("{} ms", short(1e3 * dt, 3)))),
        Fact::new("reached by commands", of_all(hidden.reached)),
        Fact::new("shown", of_all(unseen.reached)).note("with the whole state measured"),
    ]);
    if !hidden.directions.is_empty() {
        page.line(format!("  {}", reach(&hidden, &model)));
    }
    page.heading("Modes").table(modes_table(&modes, &model));
    page.written(a.save.as_slice());
    Ok(Report::page(&page, true))
}

/// What keeps the vehicle from being steered; of one that lost a rotor its steady flight has been told.
fn warnings(a: &Arguments, plant: &Plant) -> Vec<String> {
    match plant {
        Plant::Rigid(m) if a.fail.is_none() => source::verdicts(m.vehicle()),
        _ => Vec::new(),
    }
}

/// Where the model is taken: how it moves, leans and turns, and what holds it there.
fn steady(plant: &Plant, found: &Trim) -> Vec<Fact> {
    let list = |numbers: &[f64]| numbers.iter().map(|x| short(tidy(*x), 3)).collect::<Vec<_>>().join(", ");
    let commands: Vec<f64> = plant
        .input_quantities()
        .iter()
        .zip(&found.input)
        .filter(|(q, _)| is_command(&q.name))
        .map(|(_, u)| *u)
        .collect();
    let mut facts = Vec::new();
    if let Some(root) = plant.roots().first() {
        let [roll, pitch, _] = to_euler([6, 7, 8, 9].map(|k| found.state[root + k]));
        facts.push(Fact::new("velocity", format!("{} m/s", list(&found.state[root + 3..root + 6]))));
        facts.push(Fact::new("roll, pitch", format!("{}°", list(&[roll, pitch].map(f64::to_degrees)))));
    }
    facts.push(
        Fact::new("commands", list(&commands))
            .note("of rotors −1 stands, 1 is full thrust; of joints the ends of their range"),
    );
    if tidy(found.yaw_rate) != 0.0 {
        facts.push(
            Fact::new("turns", format!("{} rad/s", short(found.yaw_rate, 3)))
                .note("about the vertical; the model is seen from a frame that turns with it"),
        );
    }
    facts.extend([
        Fact::new("residual", short(found.residual, 2)).note("largest rate of change that is left, SI units"),
        Fact::new("commands at a limit", found.limited.len().to_string()),
    ]);
    facts
}
