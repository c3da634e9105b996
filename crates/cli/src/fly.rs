//! `omnidrones fly`: a vehicle or a configuration along a reference, its flight drawn; of a vehicle its derivatives certified.

mod around;
mod beside;
mod degrees;
mod derivatives;
mod drop;
pub mod estimate;
mod flown;
mod verdict;

use self::around::Around;
use self::beside::Beside;
use self::derivatives::Derivatives;
use self::flown::{Flown, write};
use super::arguments::{self, FlightArguments, OutputArguments, Outputs, VehicleArguments};
use super::failure::{FailureArguments, Story};
use super::filters::FilterArguments;
use super::robot::{self, Robot};
use super::source::{self, Source};
use crate::prelude::*;
use omnidrones::controllers::flight_check::lowest_point;
use omnidrones::controllers::optimal::MpcSettings;
use omnidrones::controllers::reference::Lemniscate;
use omnidrones::controllers::registry::{controller, steerable};
use omnidrones::controllers::{
    ChainRamp, ChainShape, Controller, FlightPlan, Reference, Setup, Tilt, Vectored, check_flight, default_controller,
    fly, vectored,
};
use omnidrones::dynamics::aero::wind::Wind;
use omnidrones::dynamics::assembly::Member;
use omnidrones::dynamics::configurations::environment::{environment, vehicle_in};
use omnidrones::dynamics::scene::Scene;
use omnidrones::dynamics::sensors::{SensorConfig, SensorSet};
use omnidrones::dynamics::tree::Multibody;
use omnidrones::dynamics::{Effects, Gains, Plant};
use omnidrones::rl::{PolicyController, load_policy};
use omnidrones_plot::robot::joints;
use std::time::Instant;

/// Seconds left out of the RMSE: the reference starts with a jump of acceleration.
const TRANSIENT: f64 = 2.0;
/// Of the lemniscate that configurations follow unless told otherwise, rad/s.
const GENTLE: f64 = 0.5;
/// Least way between the ground and whatever hangs lowest on that lemniscate, m.
const ROOM: f64 = 0.5;

/// What the command is for.
pub const ABOUT: &str = "\
Fly a vehicle, or a configuration of several bodies, closed loop along a reference. The flight starts on the reference, at rest; position, velocity, attitude \
and rate controllers compute at their own rates. Prints what the vehicle is, how well it tracked, and, for a single \
vehicle, a certificate that the derivatives of the very equations it flew are exact; writes plots.

Configurations have controllers by their make: one drone with a load has optimal feedback of the whole state (payload, \
inverted_pendulum), a load under several drones is tracked itself (transport), thrusters that tilt and drones on the joints of \
a frame hold position and attitude apart (omav_tilting, dragon, platform): --roll and --pitch turn them. They follow a slow \
lemniscate, high enough for what hangs below. Anything falls to the ground with --drop.

'omav' is a rigid vehicle that flies like any other; with --roll or --pitch it is flown as 'omav_tilting', the same machine with \
its tilts free.";

const EXAMPLES: &str = "\
Examples:
  omnidrones fly                                      a quadrotor read from URDF
  omnidrones fly crazyflie --reference circle         a built-in vehicle on a circle
  omnidrones fly drone.urdf --rotors drone.toml       your vehicle, with these rotor data
  omnidrones fly iris --wind 4,0,0                    a steady wind of 4 m/s along x
  omnidrones fly iris --wind dryden:7.7 --seed 3      7.7 m/s with gusts (light turbulence)
  omnidrones fly iris --latency 5                     commands 10 ms late
  omnidrones fly firefly --gains out/firefly/gains.toml --format svg
  omnidrones fly hummingbird --json --no-plots --max-rmse 0.1
  omnidrones fly firefly --reference hover --fail 1   a rotor stops at 3 s; it flies on, without yaw
  omnidrones fly iris --fail 0:0.8 --at 5             a rotor keeps 80 % of its thrust from 5 s on
  omnidrones fly transport --reference hover          four drones hold a box
  omnidrones fly omav --roll 30 --reference hover     30° of roll, held in place
  omnidrones fly platform --roll 20                   a frame that flies on with 20° of roll
  omnidrones fly dragon --shape arc:30                a chain that bends while it flies
  omnidrones fly hummingbird --policy runs/Hover-apg-s0   what was learnt, on the vehicle as it is
  omnidrones fly firefly --controller lqi --wind 4,0,0   optimal state feedback with integrators
  omnidrones fly iris --csv --out before              every step, in before/flight.csv
  omnidrones fly iris --gains derived --beside before/flight.csv --out after   what that changes
  omnidrones fly iris --csv --sensors imu:bmi088,barometer   what these read, in flight.csv
  omnidrones fly hummingbird --sensors imu:bmi088,motion_capture:optical --estimator ekf   on what a filter makes of them
  omnidrones fly hummingbird --controller lqr --sensors imu:bmi088,motion_capture:optical --estimator kalman   LQG
  omnidrones fly iris --filters low_pass:80,notch:150:30   with filters of the body rates that it measures
  omnidrones fly payload --effects downwash,contact   with these effects
  omnidrones fly dragon --shape arc:30 --replay       a page for a browser, to turn it around and look
  omnidrones fly payload --drop=0.5                   falls half a metre to the ground
  omnidrones fly hummingbird --scene forest:3 --reference hover   a forest in front of it
  omnidrones fly hummingbird --scene rubble:1 --drop  falls onto blocks
  omnidrones fly hummingbird --fail 0 --no-ground     how a quadrotor falls without a rotor, wherever the ground is

Files in --out: overview, path, error, rotors, attitude, rates (.png or .svg), and with --csv flight.csv (one line per step, \
units in the header; under a cascade with the thrust, attitude and body rates that its levels commanded; with --sensors their readings, but of cameras and lidars, which have sensor_NAME.csv, one line per reading), with --npz flight.npz (the same as arrays, and the state). With --beside also beside, with --replay replay.html. Of a configuration also joints (angles) and with --csv joints.csv; with --sensors sensor_NAME; of a drop only drop, drop.csv, replay.html.

The tracking RMSE is the root mean square distance to the reference after the first 2 s (over the whole flight if it is \
no longer than that); so is the heading's, against the reference's yaw.

The ground is the plane z = 0, or that of --scene. A flight fails where its lowest point comes more than 10 mm below it, or touches it \
where contact is simulated. A reference may begin or end on the ground: where it is lower than a vehicle stands, the vehicle stands on \
it. --no-ground leaves it out.

JSON: SI units, radians; thrusts and saturation as shares of 1; null where a number does not exist.

Exit codes: 0 flown; 1 the flight diverged, was lost (more than 10 m from its reference, or farther than 5 m in the end), went into \
the ground or into something of --scene, turned its load over (by more than 90°), or its RMSE is not finite or above --max-rmse; 2 unusable input or arguments.";

/// Arguments of `fly`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| arguments::out(out, "Folder for what is written [default: out/VEHICLE]")))]
#[command(group = clap::ArgGroup::new("logged").multiple(true))]
pub struct Arguments {
    /// A vehicle ('omnidrones models'), a configuration ('omnidrones show'), or a file FILE.toml or FILE.urdf
    ///
    /// Without it, a quadrotor of 0.67 kg that this program carries as URDF. 'omav' is the rigid vehicle, 'omav_tilting'
    /// the one whose rotor units tilt.
    #[arg(value_name = "VEHICLE|CONFIG|FILE")]
    vehicle: Option<String>,
    #[command(flatten)]
    rotors: VehicleArguments,
    #[command(flatten)]
    flight: FlightArguments,
    #[command(flatten)]
    filters: FilterArguments,
    /// A policy flies: the folder of a run, trained to hold a point with this vehicle; the reference takes its goal's place
    ///
    /// Physics are those of the vehicle itself, without the motor lag and damping of the benchmark's tasks.
    #[arg(long, value_name = "RUN", conflicts_with_all = ["gains", "drop"], help_heading = "Flight")]
    policy: Option<PathBuf>,
    /// Who flies: a name of the table of controllers, as cascade, fault_tolerant, lqr, lqi, mpc [default: by its make]
    #[arg(long, value_name = "NAME", conflicts_with_all = ["policy", "drop"], help_heading = "Controller")]
    controller: Option<String>,
    /// How --controller mpc plans: a file of its settings, each with a default
    ///
    ///   stages = 20                        # of the horizon
    ///   stage = 0.05                       # s each
    ///   rate = 100.0                       # plans per second, at most
    ///   iterations = 1                     # programs per plan
    ///   estimate = 10.0                    # rate of the disturbance estimate, 1/s; 0 for none
    ///   latency = 0                        # steps by which it is told that commands act late
    ///   [weights]                          # position, velocity, attitude, angular_velocity per axis; joint, joint_rate, input
    ///   position = [600, 600, 1500]
    ///   [[state_bound]]                    # what costs beyond: lower, upper, weight = 1000
    ///   state = "velocity_x"
    ///   upper = 2
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["policy", "drop"], help_heading = "Controller", verbatim_doc_comment)]
    mpc: Option<PathBuf>,
    /// Drop it from this height above the ground instead, rotors idle [default: 1]
    ///
    /// Bodies touch the ground at z = 0 and what is not joined to them. --seed disturbs the start a little.
    #[arg(long, value_name = "METRES", num_args = 0..=1, require_equals = true, default_missing_value = "1",
          help_heading = "Flight")]
    drop: Option<f64>,
    /// Roll to hold beside the reference, -180 to 180 [degrees]; omav, dragon and platform only
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, help_heading = "Flight")]
    roll: f64,
    /// Pitch to hold beside the reference, -90 to 90 [degrees]; omav, dragon and platform only
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, help_heading = "Flight")]
    pitch: f64,
    /// When to turn to --roll and --pitch, and over how long [s]; a step unless told how long
    #[arg(long, value_name = "AT[:RAMP]", default_value = "1", value_parser = arguments::tilt_at, help_heading = "Flight")]
    tilt_at: [f64; 2],
    /// Shape that a chain takes in flight: straight, arc, zigzag, or arc:DEGREES [default: straight]; dragon only
    #[arg(long, value_name = "SHAPE", help_heading = "Flight")]
    shape: Option<String>,
    /// What stands around, and pushes back: KIND[:SEED] or a TOML file
    ///
    /// Kinds: forest, corridor, rooms, gates, rubble, from x = 0 along +x, and terrain. A file holds [[generate]], [[gates]],
    /// [[obstacles]] and [[mesh]] tables (docs/flying.md). Switches the effect 'contact' on.
    #[arg(long, value_name = "KIND[:SEED]|FILE.toml", help_heading = "Flight")]
    scene: Option<String>,
    /// Leave the ground out: a flight below z = 0 is no failure, and nothing touches it
    ///
    /// A file of --scene says itself what ground there is.
    #[arg(long, conflicts_with_all = ["scene", "drop"], help_heading = "Flight")]
    no_ground: bool,
    /// Length of the flight [s] [default: 15, or to 2 s after the last waypoint; configurations 20, drops 3]
    #[arg(long, value_name = "SECONDS", help_heading = "Flight")]
    duration: Option<f64>,
    /// Wind [m/s]: none, X,Y,Z, dryden:W20, or dryden:W20:X,Y,Z
    ///
    /// X,Y,Z is a steady velocity of the air in world axes. dryden adds turbulence (MIL-F-8785C, low altitude) for a
    /// wind speed W20 at 20 ft: 7.7 light, 15 moderate, 23 severe; around a mean wind of W20 along x, or X,Y,Z. Wind
    /// acts through drag: a vehicle without drag coefficients does not feel it.
    #[arg(long, value_name = "WIND", default_value = "none", value_parser = arguments::wind, allow_hyphen_values = true,
          help_heading = "Flight")]
    wind: Wind,
    /// Seed of the gusts, of what sensors read, and of the start of a drop
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Flight")]
    seed: u64,
    /// Steps of dt by which commands act late
    #[arg(long, value_name = "STEPS", default_value_t = 0, conflicts_with = "drop", help_heading = "Flight")]
    latency: usize,
    #[command(flatten)]
    failure: FailureArguments,
    /// Compare with an earlier flight: the flight.csv that --csv wrote, of any vehicle
    ///
    /// Draws both into the figure 'beside' and prints their errors and tilts beside each other.
    #[arg(long, value_name = "FILE.csv", conflicts_with = "drop", help_heading = "Output")]
    beside: Option<PathBuf>,
    /// Exit with 1 if the tracking RMSE exceeds this [m]
    #[arg(long, value_name = "METRES", help_heading = "Flight")]
    max_rmse: Option<f64>,
    #[command(flatten)]
    output: OutputArguments,
    /// Write every step to flight.csv
    #[arg(long, group = "logged", help_heading = "Output")]
    csv: bool,
    /// Write every step to flight.npz, for NumPy; the whole state too
    #[arg(long, group = "logged", conflicts_with = "drop", help_heading = "Output")]
    npz: bool,
    /// Write flight.mcap, for Foxglove and rerun
    #[cfg_attr(not(feature = "mcap"), arg(hide = true))]
    #[arg(long, group = "logged", conflicts_with = "drop", help_heading = "Output")]
    mcap: bool,
    /// What sensors read, as plots and into the log (--csv, --npz): KIND[:PRESET],…, or a TOML file with [[sensor]] tables
    ///
    /// Kinds and presets, without which a sensor has no errors:
    ///   imu (adis16448, mpu6000, bmi088), magnetometer (pegasus), barometer (px4, ms5611),
    ///   gnss (single_point), motion_capture (optical), range (vl53l1x), flow (pmw3901),
    ///   contact (where something touches), lidar (omnidrones, os0, mid360), camera (d435, diffphysdrone)
    /// A file says more (docs/sensors.md):
    ///   [[sensor]]
    ///   name = "imu"                     # its noise depends on it and on --seed
    ///   kind = "imu"
    ///   preset = "bmi088"
    ///   on = "hummingbird"               # body; the first unless told otherwise
    ///   position = [0.02, 0.0, 0.0]      # m, body; and rotation = [w, x, y, z]
    ///   every = 2                        # steps, or rate in Hz
    ///   latency = 1                      # steps, or delay in s
    ///   gyroscope = { density = 3e-4 }   # over what the preset says
    /// Controllers are given the true state, unless there is an --estimator.
    #[arg(long, value_name = "LIST|FILE.toml", conflicts_with = "drop", help_heading = "Output", verbatim_doc_comment)]
    sensors: Option<String>,
    /// What makes an estimate of what the sensors read, on which the controller flies: ekf, complementary, kalman, or a file
    ///
    /// Of one rigid vehicle, with gnss, motion_capture, magnetometer, barometer, range. Each begins where the flight does.
    ///   ekf             error-state Kalman filter, driven by an imu; takes in flow too
    ///   complementary   fixed gains, driven by an imu; without a covariance
    ///   kalman          steady Kalman filter about hover, driven by the commands;
    ///                   LQG with --controller lqr
    /// A file says more (docs/estimation.md), by its kind, each with a default:
    ///   kind = "ekf"               # unless told otherwise
    ///   position = 0.1             # standard deviation at the start, m;
    ///                              # velocity, m/s; attitude, rad
    ///   gate = 30.0                # largest squared innovation taken in, per number
    ///   patience = 1.0             # s until what was left out is believed again
    ///   beyond_gyroscope = 10.0    # what a sample at its limit may miss, rad/s;
    ///                              # beyond_accelerometer, m/s²
    /// or
    ///   kind = "complementary"
    ///   attitude = 10.0            # rates in 1/s, 0 leaves out; accelerometer, heading,
    ///                              # bias, motion_capture, gnss, gnss_velocity, height
    /// or
    ///   kind = "kalman"            # densities of what the model misses
    ///   acceleration = 0.1         # m/s²/√Hz; angular_acceleration, rad/s²/√Hz;
    ///                              # angular_velocity, rad/s/√Hz
    #[arg(
        long,
        value_name = "NAME|FILE.toml",
        conflicts_with = "drop",
        help_heading = "Controller",
        verbatim_doc_comment
    )]
    estimator: Option<String>,
    /// Write replay.html: the flight in space, a page for any browser
    #[arg(long, help_heading = "Output")]
    replay: bool,
}

impl Arguments {
    /// The vehicle that was named; one that is to hold a tilt, with its tilts free.
    fn named(&self) -> Option<&str> {
        match self.vehicle.as_deref() {
            Some(named) if named.eq_ignore_ascii_case("omav") && self.turns() && self.drop.is_none() => {
                Some("omav_tilting")
            }
            named => named,
        }
    }

    /// Whether a log for Foxglove and rerun is wanted.
    fn mcap(&self) -> bool {
        cfg!(feature = "mcap") && self.mcap
    }

    fn turns(&self) -> bool {
        self.roll != 0.0 || self.pitch != 0.0
    }

    /// What to hold beside the reference.
    fn tilt(&self) -> Result<Tilt> {
        let [at, ramp] = self.tilt_at;
        for (what, value, most) in [("--roll", self.roll, 180.0), ("--pitch", self.pitch, 90.0)] {
            if value.is_nan() || value.abs() > most {
                let rule = format!("within ±{most}");
                return Err(Error::value(what, format!("{value}°"), rule, "Give it in degrees."));
            }
        }
        let tilt = Tilt { roll: self.roll.to_radians(), pitch: self.pitch.to_radians(), at, ramp };
        tilt.validate()?;
        Ok(tilt)
    }

    /// Refuses a tilt or a shape for what has neither.
    fn level(&self) -> Result<()> {
        let what = if self.shape.is_some() { "--shape" } else { "--roll or --pitch" };
        if !self.turns() && self.shape.is_none() {
            return Ok(());
        }
        let rule = "left out for what does not tilt its thrusters";
        Err(Error::value(what, "given", rule, "omav_tilting, dragon and platform hold a tilt, dragon takes a shape."))
    }
}

/// Flies.
pub fn run(a: &Arguments) -> Result<Report> {
    if let Some(limit) = a.max_rmse.filter(|m| !(*m > 0.0 && m.is_finite())) {
        return Err(Error::value("--max-rmse", limit, "> 0 m", "Leave it out to accept any finite error."));
    }
    a.flight.check()?;
    arguments::check_mcap(a.mcap)?;
    let configuration = a.named().is_some_and(|named| robot::configuration(named).is_some());
    if !configuration && a.drop.is_none() {
        return flown(a, vehicle(a, Around::of(a)?)?);
    }
    let mut robot = robot::load(a.named().unwrap_or("hummingbird"), &a.rotors)?;
    let around = Around::of(a)?;
    if let Some(around) = &around {
        robot.model = around.with(robot.model)?;
    } else if a.no_ground {
        robot.model =
            environment(robot.model.name().to_string(), &[Member::new("", robot.model, [0.0; 3])], &Scene::default())?;
    }
    // what nobody steers yet falls
    let alone = !robot.model.drones().is_empty() && !steerable(&robot.model);
    if a.drop.is_none() && !alone {
        return flown(a, configured(a, robot, around)?);
    }
    a.filters.refuse("--drop", "Its rotors idle: nobody steers it.")?;
    if !a.failure.fail.is_empty() {
        return Err(Error::value("--fail", "given", "left out for what is dropped", "Its rotors idle anyway."));
    }
    drop::dropped(a, &robot)
}

/// Where the files of a flight go; made if there will be any.
fn outputs(a: &Arguments, name: &str) -> Result<Outputs> {
    a.output.open(files::default_folder(name), a.csv || a.npz || a.mcap() || a.replay)
}

/// Whether a picture of that name is of a flight.
fn is_picture(name: &str) -> bool {
    let own = ["overview", "path", "error", "estimate", "rotors", "attitude", "rates", "joints", "beside", "drop"];
    own.contains(&name) || name.starts_with("sensor_")
}

/// What flies, under whom, along what.
struct Flyer {
    plant: Plant,
    controller: Box<dyn Controller>,
    plan: FlightPlan,
    what: What,
    around: Option<Around>,
    warnings: Vec<String>,
}

/// Where it comes from.
enum What {
    Vehicle { source: Box<Source>, gains: Gains, gains_name: String },
    Model(Box<Robot>),
}

/// A single vehicle. Where something stands around it, its controller still believes that it flies alone.
fn vehicle(a: &Arguments, around: Option<Around>) -> Result<Flyer> {
    a.level()?;
    if let Some(named) = &a.vehicle {
        robot::known(named)?;
    }
    if around.is_none() {
        alone(&a.flight.physics().effects)?;
    }
    // a program finds them in what is printed
    let load = if a.output.json { source::load } else { source::to_use };
    let source = load(a.vehicle.as_deref(), &a.rotors)?;
    let mut plan = a.flight.plan(a.duration, a.wind.clone(), a.seed)?;
    plan.n_step()?;
    plan.physics.effects.contact = false;
    let believed = Plant::of_vehicle(&source.vehicle, plan.air_physics())?;
    let mut plant = believed.clone();
    if let Some(around) = &around {
        plan.physics.effects.contact = true;
        plant = Plant::of_model(&vehicle_in(&source.vehicle, &around.scene)?, plan.air_physics())?;
    }
    fail(a, &plant, &mut plan)?;
    (plan.latency, plan.sensors) = (a.latency, sensors(a, &plant)?);
    plan.estimator = a.estimator.as_deref().map(|named| estimate::settings(named, &plan.sensors)).transpose()?;
    plan.filters = a.filters.settings()?;
    arguments::check_gains(&a.flight, a.controller.as_deref(), true)?;
    let (gains, gains_name) = a.flight.gains(&source.vehicle)?;
    let usual = if plan.failures.is_empty() { "cascade" } else { "fault_tolerant" };
    let name = a.controller.as_deref().unwrap_or(usual);
    let mut warnings = Vec::new();
    let controller = match policy(a, &believed, &mut warnings)? {
        Some(policy) => {
            a.filters.refuse("--policy", "Leave out one of both.")?;
            policy
        }
        None => {
            let mpc = mpc_settings(a, name, &mut warnings)?;
            controller(
                name,
                &believed,
                &Setup { mpc: mpc.as_ref(), filters: &plan.filters, ..Setup::new(Some(&gains), &plan.rates) },
            )?
        }
    };
    let what = What::Vehicle { source: Box::new(source), gains, gains_name };
    Ok(Flyer { plant, controller, plan, what, around, warnings })
}

/// A configuration.
fn configured(a: &Arguments, robot: Robot, around: Option<Around>) -> Result<Flyer> {
    a.filters.refuse("a configuration", "Leave it out, or fly a vehicle.")?;
    let plant = model_plant(a, &robot, around.is_some())?;
    let reference = reference(a, &plant)?;
    let usual = reference.duration().map_or(20.0, |end| end + 2.0);
    let mut plan = a.flight.plan(Some(a.duration.unwrap_or(usual)), a.wind.clone(), a.seed)?;
    (plan.reference, plan.physics) = (reference, *plant.physics());
    plan.n_step()?;
    plan.tilt = a.tilt()?;
    fail(a, &plant, &mut plan)?;
    (plan.latency, plan.sensors) = (a.latency, sensors(a, &plant)?);
    plan.estimator = a.estimator.as_deref().map(|named| estimate::settings(named, &plan.sensors)).transpose()?;
    let mut warnings = Vec::new();
    let controller = model_controller(a, &plant, &plan, &mut warnings)?;
    Ok(Flyer { plant, controller, plan, what: What::Model(Box::new(robot)), around, warnings })
}

/// The sensors of the arguments, refused before anything is made where the plant cannot carry them.
fn sensors(a: &Arguments, plant: &Plant) -> Result<Vec<SensorConfig>> {
    let list = a.sensors.as_deref().map_or(Ok(Vec::new()), arguments::sensors)?;
    SensorSet::new(&list, plant.physics().dt, &plant.body_names())?;
    if !list.is_empty() && a.estimator.is_none() && a.output.no_plots && !(a.csv || a.npz || a.mcap() || a.replay) {
        let remedy = "Add --csv, --npz or --replay, or leave --no-plots out.";
        return Err(Error::value("--sensors", "neither drawn nor in a log", "to be read by somebody", remedy));
    }
    Ok(list)
}

/// The policy of the arguments, with a warning where it was trained on something else.
fn policy(a: &Arguments, plant: &Plant, warnings: &mut Vec<String>) -> Result<Option<Box<dyn Controller>>> {
    let Some(run) = &a.policy else { return Ok(None) };
    let policy = PolicyController::new(load_policy(run)?, plant)?;
    let told = |p: &Plant| format!("'{}' of {} kg", p.name(), short(p.mass(), 3));
    let (own, other) = (policy.trained_on(), plant);
    if own.name() != other.name() || (own.mass() / other.mass() - 1.0).abs() > 1e-6 {
        warnings.push(format!(
            "the policy was trained on {}; it flies {}, which it has never seen",
            told(own),
            told(other)
        ));
    }
    if policy.sees_estimates() && a.estimator.is_none() {
        warnings.push("the policy was trained on estimates; it flies on the truth. --sensors … --estimator ekf flies it on what sensors read".into());
    }
    Ok(Some(Box::new(policy)))
}

/// The failures of the arguments.
fn fail(a: &Arguments, plant: &Plant, plan: &mut FlightPlan) -> Result<()> {
    let names: Vec<String> = plant.rotors().iter().map(|r| r.name.clone()).collect();
    (plan.failures, plan.detection_delay) = (a.failure.of(&names)?, a.failure.detection);
    if let Some(late) = plan.failures.iter().find(|failure| failure.at >= plan.duration) {
        let (value, limit) = (format!("{} s", late.at), format!("before the end of the flight at {} s", plan.duration));
        return Err(Error::value("--at", value, limit, "Fly longer (--duration), or let it fail earlier."));
    }
    Ok(())
}

/// A model with the effects of the arguments, and of the wind.
fn model_plant(a: &Arguments, robot: &Robot, contact: bool) -> Result<Plant> {
    let mut physics = a.flight.physics();
    physics.effects.disturbance |= a.wind != Wind::Calm;
    physics.effects.contact |= contact;
    Plant::of_model(&robot.model, physics)
}

/// What was asked, else a slow lemniscate high enough for what hangs below.
fn reference(a: &Arguments, plant: &Plant) -> Result<Reference> {
    let (None, Some(system)) = (&a.flight.reference, plant.tree()) else { return a.flight.reference() };
    Ok(slow_lemniscate(system))
}

/// The reference of a configuration unless told otherwise.
pub fn slow_lemniscate(system: &Multibody) -> Reference {
    let below = -lowest_point(system, &system.rest_state());
    let usual = Lemniscate::default();
    let dip = usual.scale[2] * usual.vertical;
    let height = (ROOM + dip + below).max(usual.origin[2]);
    Reference::Lemniscate(Lemniscate { rate: GENTLE, origin: [0.0, 0.0, (10.0 * height).ceil() / 10.0], ..usual })
}

/// Who flies a configuration, in what shape.
fn model_controller(
    a: &Arguments,
    plant: &Plant,
    plan: &FlightPlan,
    warnings: &mut Vec<String>,
) -> Result<Box<dyn Controller>> {
    let gains = a.flight.own_gains()?;
    if a.controller.is_none() {
        mpc_settings(a, "that suits the plant", warnings)?;
    }
    if let Some(policy) = policy(a, plant, warnings)? {
        a.level()?;
        return Ok(policy);
    }
    if let Some(name) = &a.controller {
        let mpc = mpc_settings(a, name, warnings)?;
        let setup = Setup { mpc: mpc.as_ref(), ..Setup::new(gains.as_ref(), &plan.rates) };
        let own = controller(name, plant, &setup)?;
        if a.shape.is_some() || !own.holds_tilt() {
            a.level()?;
        }
        return Ok(own);
    }
    match plant.tree().filter(|system| vectored(system.model())) {
        Some(system) => {
            let shape = a.shape.as_deref().map_or(Ok(ChainShape::Straight), ChainShape::parse)?;
            let chain = ChainRamp::new(system.model(), shape, plan.tilt.at)?;
            Ok(Box::new(Vectored::new(system, gains.as_ref(), &plan.rates)?.with_chain(chain)))
        }
        None => {
            let own = default_controller(plant, &Setup::new(gains.as_ref(), &plan.rates))?;
            if a.shape.is_some() || !own.holds_tilt() {
                a.level()?;
            }
            Ok(own)
        }
    }
}

/// The settings of --mpc, with a warning where they tell another latency than there is.
fn mpc_settings(a: &Arguments, controller: &str, warnings: &mut Vec<String>) -> Result<Option<MpcSettings>> {
    let settings = arguments::mpc_settings(a.mpc.as_deref(), controller)?;
    if let Some(told) = settings.as_ref().map(|own| own.latency).filter(|told| *told != a.latency) {
        let real = counted(a.latency, "step");
        warnings.push(format!("--mpc tells a latency of {}, and commands act {real} late", counted(told, "step")));
    }
    Ok(settings)
}

/// Refuses effects that need more than one rigid vehicle.
fn alone(effects: &Effects) -> Result<()> {
    let wrong = [
        ("contact", effects.contact, "Drop it with --drop."),
        ("downwash", effects.downwash, "Leave it out."),
        ("load-downwash", effects.load_downwash, "Leave it out."),
    ];
    match wrong.into_iter().find(|(_, on, _)| *on) {
        None => Ok(()),
        Some((name, _, remedy)) => Err(Error::value(
            "--effects",
            format!("{name} for a single vehicle in flight"),
            "used with a configuration",
            remedy,
        )),
    }
}

fn flown(a: &Arguments, flyer: Flyer) -> Result<Report> {
    let Flyer { plant, mut controller, plan, what, around, mut warnings } = flyer;
    warnings.extend(degrees::hint(&plan.reference));
    warnings.extend(plan.estimator.iter().flat_map(|own| estimate::warnings(&plan.sensors, own.kind())));
    let earlier = a.beside.as_deref().map(Beside::read).transpose()?;
    let mut outputs = outputs(a, plant.name())?;
    let bar = progress::bar(plan.n_step()?, "flying", a.output.json);
    let clock = Instant::now();
    let flight = fly(&plant, &mut controller, &plan, &mut |k| {
        if k % 256 == 0 {
            bar.set_position(k);
        }
    })?;
    let wall_time = clock.elapsed().as_secs_f64();
    bar.finish_and_clear();

    let after = if plan.duration > TRANSIENT { TRANSIENT } else { 0.0 };
    let (mut derivatives, mut story) = (None, None);
    if let What::Vehicle { source, gains, .. } = &what {
        if a.policy.is_none() && controller.name() == "cascade" {
            let alone = around.is_none();
            derivatives = Some(if alone {
                Derivatives::of(&source.vehicle, gains, &plan, &flight)?
            } else {
                Derivatives::none()
            });
        }
        story = Story::of(&source.vehicle, &plan, &flight)?;
    }
    write(a, &mut outputs, &plant, &flight, &plan.sensors, after, story.as_ref())?;
    if let Some(earlier) = &earlier {
        outputs.draw("beside", || earlier.figure(&flight.log))?;
    }
    let judgement = check_flight(&plant, &flight, !a.no_ground)?;
    let (mut histories, mut approach) = (Vec::new(), None);
    if let Some(system) = plant.tree() {
        histories = joints(system, &flight.states);
        approach = around.and_then(|around| around.approach(system, &flight));
    }
    let mut result = Flown {
        controller: [controller.name().into(), controller.description()],
        notes: controller.notes(),
        summary: flight.log.summary(after),
        beside: earlier.map(|earlier| earlier.compare(&flight.log, after)),
        joints: histories,
        judgement,
        approach,
        learnt: a.policy.is_some(),
        warnings,
        derivatives,
        story,
        what,
        plant,
        plan,
        flight,
        wall_time,
        written: Vec::new(),
    };
    #[cfg(feature = "mcap")]
    if a.mcap {
        outputs.put("flight.mcap", |path| result.write_mcap(path))?;
    }
    let verdict = result.verdict(a.max_rmse);
    if a.replay {
        outputs.text(files::REPLAY, result.replay())?;
    }
    result.written = outputs.done(is_picture)?;
    Ok(Report::told(a.output.json, verdict.is_ok(), || result.json(&verdict), || result.page(&verdict)))
}
