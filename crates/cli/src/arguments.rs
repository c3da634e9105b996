//! Arguments that commands share.

use crate::prelude::*;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, Args, ValueEnum};
use omnidrones::controllers::optimal::MpcSettings;
use omnidrones::controllers::{FlightPlan, Rates, Reference};
use omnidrones::dynamics::aero::wind::{Dryden, Wind};
use omnidrones::dynamics::sensors::{SensorConfig, SensorFile};
use omnidrones::dynamics::{Effects, Gains, Integrator, Physics, Vehicle};
use omnidrones::parallel::Threads;
use omnidrones::rl::algorithm;
use omnidrones_plot::{Figure, Format};

/// Which vehicle, and where its rotor data are.
#[derive(Debug, Clone, Args)]
pub struct VehicleArguments {
    /// Rotor data of a URDF: which links are rotors, coefficients, motor, drag
    ///
    /// A TOML file, or a folder with STEM.rotors.toml. Without it the file beside the URDF is read (drone.urdf:
    /// drone.rotors.toml), else the <properties> element in the URDF. 'omnidrones import' drafts one.
    #[arg(long, value_name = "FILE.toml", help_heading = "Vehicle")]
    pub rotors: Option<PathBuf>,
    /// Folder of a package named in mesh paths (package://NAME/…); may be repeated
    ///
    /// Meshes are never opened and nobody needs them to fly; this silences the warning about them.
    #[arg(long, value_name = "NAME=DIR", value_parser = package, help_heading = "Vehicle")]
    pub package: Vec<(String, PathBuf)>,
}

/// What is flown, how finely, in what air.
#[derive(Debug, Clone, Args)]
pub struct FlightArguments {
    /// What to track: hover, step, circle, ellipse, lemniscate, waypoints, or a TOML file [default: lemniscate]
    ///
    /// A file holds the kind and any of its numbers:
    ///   kind = "circle"        # center, radius [m], rate [rad/s], spin_up [s], along_path, yaw
    ///   kind = "lemniscate"    # origin, scale [m], rate [rad/s], vertical, rotation, yaw
    ///   kind = "hover"         # position [m], yaw [rad]
    ///   kind = "step"          # from, to [m], time [s], yaw
    ///   kind = "waypoints"     # points = [{ time = 0, position = [0, 0, 2], yaw = 0 }, …], turns
    /// Yaw is in radians. Between waypoints it turns the short way, by half a turn at most: 3.1 and -3.1 are 5° apart. With
    /// turns = true it is taken as it is given: from 0 to 6.283 is one full turn.
    #[arg(long, value_name = "NAME|FILE.toml", help_heading = "Flight", verbatim_doc_comment)]
    pub reference: Option<String>,
    /// Simulation step [s], above 0 and at most 1; commands are held within a step
    #[arg(long, value_name = "SECONDS", default_value_t = 0.002, help_heading = "Simulation")]
    pub dt: f64,
    /// Integrator steps within a simulation step, 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Simulation")]
    pub substeps: usize,
    /// How the equations of motion are integrated
    #[arg(long, value_name = "NAME", default_value = "rk4", help_heading = "Simulation")]
    pub integrator: IntegratorName,
    /// Effects to simulate, separated by commas [default: body-drag,quadratic-drag,rotor-drag,rotor-inertia]
    ///
    /// An effect works only where the vehicle has coefficients for it. Wind is an option of 'fly'.
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        value_parser = one_of(&EFFECTS),
        help_heading = "Simulation",
        conflicts_with = "no_effects"
    )]
    pub effects: Option<Vec<Switch>>,
    /// Rotors, gravity and a rigid body alone: no drag, no gyroscopic rotors
    #[arg(long, help_heading = "Simulation")]
    pub no_effects: bool,
    /// How often the levels of the controller compute [Hz]; each must divide 1/dt [default: 500,250,100]
    ///
    /// Where dt does not allow the default, the nearest rates that it allows are taken.
    #[arg(long, value_name = "RATE,ATTITUDE,VELOCITY", value_parser = rates, allow_hyphen_values = true,
          help_heading = "Controller")]
    pub rates: Option<Rates>,
    /// Gains: published, derived (from inertia and motor lag), or a TOML file
    ///
    /// Published gains are used where they exist, else derived ones.
    /// A file holds four lines, each per body axis, and to integrate
    /// a fifth, of force and moment:
    ///   position = [4, 4, 4]               # K_p, 1/s²
    ///   velocity = [2.2, 2.2, 2.2]         # K_v, 1/s
    ///   attitude = [0.7, 0.7, 0.035]       # K_R, N m/rad
    ///   rate     = [0.1, 0.1, 0.025]       # K_ω, N m s/rad
    ///   integral = [4, 4]                  # L, 1/s
    /// 'omnidrones tune' writes such a file.
    #[arg(long, value_name = "NAME|FILE.toml", help_heading = "Controller", verbatim_doc_comment)]
    pub gains: Option<String>,
}

impl FlightArguments {
    /// Refuses a step that no clock has, before counting the steps of a flight.
    pub fn check(&self) -> Result<()> {
        self.physics().validate()
    }

    /// The reference, read and checked.
    pub fn reference(&self) -> Result<Reference> {
        reference(self.reference.as_deref().unwrap_or("lemniscate"))
    }

    /// Step, integrator, effects.
    pub fn physics(&self) -> Physics {
        let effects = match &self.effects {
            _ if self.no_effects => Effects::none(),
            None => Effects::default(),
            Some(switches) => {
                let mut effects = Effects::none();
                switches.iter().for_each(|switch| *switch(&mut effects) = true);
                effects
            }
        };
        Physics { dt: self.dt, substeps: self.substeps, integrator: self.integrator.into(), effects }
    }

    /// The rates asked for, else the default ones fitted to dt.
    pub fn rates(&self) -> Rates {
        let fitted = |rate: f64| {
            let every = (1.0 / (self.dt * rate)).round().max(1.0);
            if every.is_finite() { 1.0 / (self.dt * every) } else { rate }
        };
        let Rates { rate, attitude, velocity } = Rates::default();
        self.rates.unwrap_or(Rates { rate: fitted(rate), attitude: fitted(attitude), velocity: fitted(velocity) })
    }

    /// The gains to start from, and what they are called.
    pub fn gains(&self, vehicle: &Vehicle) -> Result<(Gains, String)> {
        let usual = if vehicle.published_gains.is_some() { "published" } else { "derived" };
        match self.gains.as_deref().unwrap_or(usual) {
            "derived" => Ok((vehicle.derived_gains(), "derived".into())),
            "published" => match vehicle.published_gains {
                Some(gains) => Ok((gains, "published".into())),
                None => Err(Error::value(
                    "--gains",
                    "published",
                    format!("derived or a TOML file: nobody published gains for '{}'", vehicle.name),
                    "Leave the option out for derived gains.",
                )),
            },
            file if is_path(file) => Ok((files::read_toml(Path::new(file))?, file.to_string())),
            name => Err(Error::Unknown {
                kind: "set of gains",
                name: name.into(),
                known: ["published", "derived", "FILE.toml"].map(String::from).to_vec(),
            }),
        }
    }

    /// The gains of a configuration: those of a file; `None` for what its controller derives.
    pub fn own_gains(&self) -> Result<Option<Gains>> {
        match self.gains.as_deref() {
            None | Some("derived") => Ok(None),
            Some("published") => Err(Error::value(
                "--gains",
                "published, but nobody published gains for configurations",
                "derived or a TOML file",
                "Leave the option out for gains derived from what each controller flies.",
            )),
            Some(file) => files::read_toml(Path::new(file)).map(Some),
        }
    }

    /// A plan of `duration` seconds (without one: 15, or until 2 s after the end of the reference).
    pub fn plan(&self, duration: Option<f64>, wind: Wind, seed: u64) -> Result<FlightPlan> {
        let reference = self.reference()?;
        let usual = reference.duration().map_or(15.0, |end| end + 2.0);
        let (physics, rates) = (self.physics(), self.rates());
        Ok(FlightPlan {
            reference,
            duration: duration.unwrap_or(usual),
            physics,
            rates,
            wind,
            seed,
            ..FlightPlan::default()
        })
    }
}

/// Names of integrators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum IntegratorName {
    /// Runge–Kutta of fourth order
    Rk4,
    /// First order, half the work, implicit gyroscopic term
    #[value(alias = "semi_implicit")] // as files spell it
    SemiImplicit,
}

impl From<IntegratorName> for Integrator {
    fn from(name: IntegratorName) -> Self {
        match name {
            IntegratorName::Rk4 => Self::RungeKutta4,
            IntegratorName::SemiImplicit => Self::SemiImplicit,
        }
    }
}

/// Switches of effects.
type Switch = fn(&mut Effects) -> &mut bool;

/// Effects by name, with what they are.
const EFFECTS: [(&str, &str, Switch); 9] = [
    ("body-drag", "Linear and angular drag of the airframe", |e| &mut e.body_drag),
    ("quadratic-drag", "Quadratic drag of the airframe", |e| &mut e.quadratic_drag),
    ("rotor-drag", "Drag of the rotors in the air that passes them", |e| &mut e.rotor_drag),
    ("rolling-moment", "Rolling moment of the rotors in the air that passes them", |e| &mut e.rolling_moment),
    ("rotor-inertia", "Angular momentum of the rotors", |e| &mut e.rotor_inertia),
    ("ground-effect", "Thrust gained within a few radii of the ground at z = 0", |e| &mut e.ground_effect),
    ("downwash", "Wakes of drones on each other; configurations only", |e| &mut e.downwash),
    ("load-downwash", "Wakes of drones on what they carry; configurations only", |e| &mut e.load_downwash),
    ("contact", "Forces between bodies that touch, and on the ground at z = 0; configurations only, and --drop", |e| {
        &mut e.contact
    }),
];

/// File types of figures, as in a file name.
const FORMATS: [(&str, &str, &str); 2] = [("png", "Pixels", "png"), ("svg", "Vectors", "svg")];

/// One of these names, each with what it is, for the value that stands beside it.
pub fn one_of<T: Clone + Send + Sync + 'static>(
    all: &'static [(&'static str, &'static str, T)],
) -> impl TypedValueParser<Value = T> {
    let names = all.iter().map(|(name, what, _)| PossibleValue::new(*name).help(*what));
    PossibleValuesParser::new(names).try_map(|given| {
        let known = all.iter().find(|(name, ..)| *name == given);
        known.map(|(.., value)| value.clone()).ok_or("it is not known")
    })
}

/// Refuses --mcap where this program was built without it.
pub fn check_mcap(asked: bool) -> Result<()> {
    if cfg!(feature = "mcap") || !asked {
        return Ok(());
    }
    let remedy =
        "Build it so: cargo install --path crates/cli --features mcap. --csv, --npz and --replay need nothing.";
    Err(Error::value("--mcap", "given", "left out by a program that was built without it", remedy))
}

/// Where output goes, and in what form.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Output")]
pub struct OutputArguments {
    /// Folder for what is written
    ///
    /// It must be new, empty or made by omnidrones, whose earlier output is then replaced.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write into a folder of other files too, and replace those of the same names
    #[arg(long)]
    pub force: bool,
    /// File type of the plots
    #[arg(long, value_name = "TYPE", default_value = "png", value_parser = one_of(&FORMATS))]
    pub format: &'static str,
    /// Draw nothing
    #[arg(long)]
    pub no_plots: bool,
    /// Print one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
}

/// The option `--out` of a command, with what is written there and where it is by default.
pub fn out(option: Arg, what: &str) -> Arg {
    let rule = "It must be new, empty or made by omnidrones, whose earlier output is then replaced.";
    option.help(what.to_string()).long_help(format!("{what}\n\n{rule}"))
}

impl OutputArguments {
    /// The folder, ready to be written into where there are plots to draw or `other` files to write.
    pub fn open(&self, usual: impl Into<PathBuf>, other: bool) -> Result<Outputs> {
        let folder = self.out.clone().unwrap_or_else(|| usual.into());
        let plots = (!self.no_plots).then_some(self.format);
        if other || plots.is_some() {
            files::prepare(&folder, self.force)?;
        }
        Ok(Outputs { folder, plots, quiet: self.json, written: Vec::new() })
    }
}

/// A folder that a command writes into, and the files that it wrote there.
pub struct Outputs {
    pub folder: PathBuf,
    /// File type of plots, where they are to be drawn.
    pub plots: Option<&'static str>,
    quiet: bool,
    pub written: Vec<PathBuf>,
}

impl Outputs {
    /// Draws NAME.png or NAME.svg, unless nothing is to be drawn.
    pub fn draw(&mut self, name: &str, figure: impl FnOnce() -> Figure) -> Result<()> {
        self.plots.map_or(Ok(()), |extension| self.save(&format!("{name}.{extension}"), &figure()))
    }

    fn save(&mut self, name: &str, figure: &Figure) -> Result<()> {
        let spinner = progress::spinner("drawing", self.quiet);
        let drawn = self.put(name, |path| figure.save(path));
        spinner.finish_and_clear();
        drawn
    }

    /// Writes a file of that name.
    pub fn put(&mut self, name: &str, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
        let path = self.folder.join(name);
        write(&path)?;
        files::note_saved(&path);
        self.written.push(path);
        Ok(())
    }

    /// Writes a text.
    pub fn text(&mut self, name: &str, text: String) -> Result<()> {
        self.put(name, |path| files::replace(path, text.as_bytes()))
    }

    /// What was written. The page and those pictures of an earlier command there that were not written anew are of another
    /// flight, and go.
    pub fn done(self, is_picture: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>> {
        if !self.written.is_empty() {
            files::remove_stale(&self.folder, &self.written, &|name| {
                let stem = name.strip_suffix(".png").or_else(|| name.strip_suffix(".svg"));
                name == files::REPLAY || stem.is_some_and(&is_picture)
            })?;
        }
        Ok(self.written)
    }
}

/// Group of the files that a command is told to write: `--force` is for any of them.
pub const WRITTEN: &str = "written";

/// One picture, for commands whose answer is a page.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Output", group = clap::ArgGroup::new(WRITTEN).multiple(true))]
pub struct PlotArguments {
    /// Draw it into this file (.png or .svg)
    #[arg(long, visible_alias = "out", value_name = "FILE", group = WRITTEN)]
    pub plot: Option<PathBuf>,
    /// Replace a file that exists
    #[arg(long, requires = WRITTEN)]
    pub force: bool,
    /// Print one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
}

impl PlotArguments {
    /// Refuses a file that cannot be drawn into, before any work.
    pub fn check(&self) -> Result<()> {
        let Some(file) = &self.plot else { return Ok(()) };
        Format::of(file)?;
        files::check_new(file, self.force)?;
        files::make_parent(file)
    }
}

/// A page for a browser, for commands that write one.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Output")]
pub struct PageArguments {
    /// The page
    #[arg(long, value_name = "FILE.html")]
    pub out: Option<PathBuf>,
    /// Replace a file that exists
    #[arg(long)]
    pub force: bool,
    /// Print one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
}

impl PageArguments {
    /// Refuses a name that is none of a page.
    pub fn check(&self) -> Result<()> {
        let wrong = |path: &&PathBuf| path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("html"));
        let Some(path) = self.out.as_ref().filter(wrong) else { return Ok(()) };
        let value = format!("'{}'", path.display());
        Err(Error::value("page", value, "a name that ends in .html", "Add .html to it."))
    }
}

/// Threads of a command.
#[derive(Debug, Clone, Args)]
pub struct ThreadArguments {
    /// Threads; the results do not depend on it [default: all cores]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
}

impl ThreadArguments {
    /// As many as were asked for.
    pub fn threads(&self) -> Result<Threads> {
        self.threads.map_or_else(|| Ok(Threads::default()), Threads::new)
    }
}

/// Names that `--algo` takes, in any case where the argument ignores it.
pub fn algorithms() -> impl TypedValueParser<Value = String> {
    let names = algorithm::names().into_iter().chain(algorithm::VARIANTS.iter().map(|own| own.name));
    PossibleValuesParser::new(names).map(|name| name.to_lowercase())
}

/// Refuses gains for a controller that has none: optimal feedback of a rigid vehicle.
pub fn check_gains(flight: &FlightArguments, controller: Option<&str>, rigid: bool) -> Result<()> {
    if let (Some(r), Some("mpc")) = (flight.rates, controller) {
        let given = format!("{},{},{}", r.rate, r.attitude, r.velocity);
        let remedy = "Its rate stands in the file of --mpc.";
        return Err(Error::value("--rates with --controller mpc", given, "left out: it has no levels", remedy));
    }
    match (&flight.gains, controller) {
        (Some(given), Some(name)) if rigid && is_optimal(name) => {
            let what = format!("--gains with --controller {name}");
            Err(Error::value(what, given, "left out: its feedback follows from weights", "Leave out one of both."))
        }
        _ => Ok(()),
    }
}

/// Whether a controller of rigid vehicles has no gains of levels.
pub fn is_optimal(name: &str) -> bool {
    ["lqr", "lqi", "mpc", "mpc_indi"].contains(&name)
}

/// The settings of `--mpc`, which are of controllers that plan.
pub fn mpc_settings(file: Option<&Path>, controller: &str) -> Result<Option<MpcSettings>> {
    let Some(file) = file else { return Ok(None) };
    if !["mpc", "mpc_indi"].contains(&controller) {
        let value = format!("given with controller '{controller}'");
        return Err(Error::value(
            "--mpc",
            value,
            "given with --controller mpc or mpc_indi",
            "Leave one of both out, or add it.",
        ));
    }
    files::read_toml(file).map(Some)
}

/// Sensors in short, or in a file.
pub fn sensors(named: &str) -> Result<Vec<SensorConfig>> {
    match SensorConfig::parse_list(named) {
        Err(_) if is_path(named) => Ok(SensorFile::of(files::read_toml(Path::new(named))?, named)?.sensor),
        known => known,
    }
}

/// A reference of a name or in a file, checked.
pub fn reference(named: &str) -> Result<Reference> {
    let reference = match Reference::by_name(named) {
        Err(_) if is_path(named) => files::read_toml(Path::new(named))?,
        known => known?,
    };
    reference.validate()?;
    Ok(reference)
}

/// Whether an argument that may be a name or a file means a file, where it is no name: names win.
pub fn is_path(text: &str) -> bool {
    let path = Path::new(text);
    text.contains(['/', '\\']) || path.extension().is_some() || path.exists()
}

fn number(text: &str) -> std::result::Result<f64, String> {
    let v: f64 = text.trim().parse().map_err(|_| format!("'{}' is not a number", text.trim()))?;
    if v.is_finite() { Ok(v) } else { Err(format!("{v} is not finite")) }
}

/// N finite numbers between commas.
pub fn list<const N: usize>(text: &str, what: &str) -> std::result::Result<[f64; N], String> {
    let numbers = text.split(',').map(number).collect::<std::result::Result<Vec<_>, _>>()?;
    let n = numbers.len();
    <[f64; N]>::try_from(numbers).map_err(|_| format!("expected {N} numbers {what}, got {n}"))
}

pub fn rates(text: &str) -> std::result::Result<Rates, String> {
    let [rate, attitude, velocity] = list(text, "RATE,ATTITUDE,VELOCITY in Hz")?;
    Ok(Rates { rate, attitude, velocity })
}

/// `AT` or `AT:RAMP`, s.
pub fn tilt_at(text: &str) -> std::result::Result<[f64; 2], String> {
    let (at, ramp) = text.split_once(':').map_or((text, "0"), |(at, ramp)| (at, ramp));
    Ok([number(at)?, number(ramp)?])
}

/// `none`, `X,Y,Z`, `dryden:W20` or `dryden:W20:X,Y,Z`.
pub fn wind(text: &str) -> std::result::Result<Wind, String> {
    let wind = match text.strip_prefix("dryden:") {
        _ if text == "none" => Wind::Calm,
        Some(rest) => {
            let (strength, mean) = rest.split_once(':').map_or((rest, None), |(w, mean)| (w, Some(mean)));
            let wind_at_20_feet = number(strength)?;
            let mean = mean.map_or(Ok([wind_at_20_feet, 0.0, 0.0]), |m| list(m, "X,Y,Z in m/s"))?;
            let airspeed = mean.iter().map(|v| v * v).sum::<f64>().sqrt().max(1.0);
            // 20 ft, where W₂₀ is measured
            Wind::Dryden(Dryden { mean, wind_at_20_feet, height: 6.096, airspeed })
        }
        None if !text.contains(',') => {
            return Err("expected none, X,Y,Z (m/s), dryden:W20 or dryden:W20:X,Y,Z (m/s)".into());
        }
        None => Wind::Constant { velocity: list(text, "X,Y,Z in m/s")? },
    };
    wind.validate().map_err(|e| e.to_string())?;
    Ok(wind)
}

fn package(text: &str) -> std::result::Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((name, folder)) if !name.is_empty() && !folder.is_empty() => Ok((name.into(), folder.into())),
        _ => Err("expected NAME=DIR, as in robots=/opt/robots".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn winds_are_read_or_refused_with_a_reason() {
        assert_eq!(wind("none"), Ok(Wind::Calm));
        assert_eq!(wind("-3,0.5,0"), Ok(Wind::Constant { velocity: [-3.0, 0.5, 0.0] }));
        assert!(matches!(wind("dryden:7.7"), Ok(Wind::Dryden(d)) if d.mean == [7.7, 0.0, 0.0]));
        assert!(matches!(wind("dryden:7.7:0,0,0"), Ok(Wind::Dryden(d)) if d.airspeed == 1.0));
        for (text, words) in [
            ("1,2", "got 2"),
            ("nan,0,0", "not finite"),
            ("storm", "expected none"),
            ("dryden:-1", "it must be ≥ 0"),
            ("dryden:", "'' is not a number"),
        ] {
            let refusal = wind(text).unwrap_err();
            assert!(refusal.contains(words), "{text}: {refusal}");
        }
    }
}
