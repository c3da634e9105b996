//! A vehicle from whatever the user typed: a built-in name, a vehicle TOML, a URDF, or nothing.

use super::arguments::{VehicleArguments, is_path};
use crate::prelude::*;
use omnidrones::controllers::CascadeModel;
use omnidrones::dynamics::urdf::{Import, ImportOptions, RotorFile, import_file, import_text, rotor_file_beside};
use omnidrones::dynamics::{MAX_ROTORS, Vehicle, configurations, vehicles};

/// The URDF that is flown when nothing is named; built in, so that every folder gives the same flight.
const DEFAULT_URDF: (&str, &str) = ("assets/urdf/plain_x.urdf", include_str!("../../../assets/urdf/plain_x.urdf"));
const DEFAULT_ROTORS: (&str, &str) =
    ("assets/urdf/plain_x.rotors.toml", include_str!("../../../assets/urdf/plain_x.rotors.toml"));

/// Share of its largest thrust that a rotor should keep to either limit in hover.
const LEAST_RESERVE: f64 = 0.01;

/// A vehicle and its story.
pub struct Source {
    /// The vehicle; valid.
    pub vehicle: Vehicle,
    /// `built in`, `vehicle file x.toml`, `URDF x.urdf with x.rotors.toml`.
    pub origin: String,
    /// Oddities of a URDF, and of the vehicle itself.
    pub warnings: Vec<String>,
    /// What a URDF import concluded rather than read.
    pub assumptions: Vec<String>,
    /// The file, for hints.
    pub file: Option<PathBuf>,
}

/// Loads what `named` means; without a name the URDF of our own corpus.
pub fn load(named: Option<&str>, arguments: &VehicleArguments) -> Result<Source> {
    let Some(named) = named else {
        let rotors = RotorFile::parse(DEFAULT_ROTORS.1, DEFAULT_ROTORS.0)?;
        let import = import_text(DEFAULT_URDF.1, DEFAULT_URDF.0, Some(&rotors), &options(arguments)?)?;
        let origin = format!("URDF {} with {}, carried in this program", DEFAULT_URDF.0, DEFAULT_ROTORS.0);
        return Ok(imported(import, origin, None));
    };
    let path = Path::new(named);
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    let known = vehicles::names().iter().any(|name| name.eq_ignore_ascii_case(named));
    if let Some(name) = configurations::names().into_iter().find(|name| !known && name.eq_ignore_ascii_case(named)) {
        let remedy = format!(
            "It is an articulated system: 'omnidrones show {name}' shows it; 'fly' and 'linearise' take those with rotors."
        );
        return Err(Error::value("vehicle", format!("'{name}'"), "a rigid vehicle", &remedy));
    }
    if known || !is_path(named) {
        no_rotor_file(named, arguments)?;
        let vehicle = vehicles::by_name(named)?;
        return Ok(told(vehicle, "built in".into(), None));
    }
    match extension.as_deref() {
        Some("toml") => {
            no_rotor_file(named, arguments)?;
            if named.ends_with(".rotors.toml") {
                return Err(format(named, "is the rotor file of a URDF, not a vehicle", "Name the URDF beside it."));
            }
            files::check_there(path)?;
            Ok(told(Vehicle::from_toml_file(path)?, format!("vehicle file {named}"), Some(path)))
        }
        Some("urdf" | "xml") => {
            let options = options(arguments)?;
            files::check_there(path)?;
            let import = import_file(path, &options)?;
            let origin = format!("URDF {named} with {}", rotor_source(path, &options));
            Ok(imported(import, origin, Some(path)))
        }
        Some("xacro") => {
            let remedy = "Expand it first: xacro FILE.xacro > FILE.urdf.";
            Err(format(named, "is a xacro file, which is a program that makes a URDF", remedy))
        }
        _ => Err(Error::value(
            "vehicle",
            format!("'{named}'"),
            "a built-in name, or a file that ends in .toml or .urdf",
            "'omnidrones models' lists the built-in names.",
        )),
    }
}

/// The same for a command that goes on to use the vehicle: what is odd about it is told first, for that may be why it fails.
pub fn to_use(named: Option<&str>, arguments: &VehicleArguments) -> Result<Source> {
    let source = load(named, arguments)?;
    for odd in source.vehicle.warnings() {
        eprintln!("warning: {}", shown(&odd.to_string()));
    }
    Ok(source)
}

/// What keeps a vehicle from being flown, as 'fly' says it: axes that its rotors do not turn apart, no hover, too little thrust.
pub fn verdicts(vehicle: &Vehicle) -> Vec<String> {
    let hovers = vehicle.check_steerable().and_then(|()| vehicle.hover());
    let flown = hovers.and_then(|_| CascadeModel::<f64, MAX_ROTORS>::new(vehicle, &vehicle.gains()));
    let refused = flown.err().map(|error| error.to_string());
    refused.or_else(|| on_the_edge(vehicle)).into_iter().collect()
}

/// A hover with a rotor at its limit: nothing is left to steer with.
fn on_the_edge(vehicle: &Vehicle) -> Option<String> {
    let hover = vehicle.hover().ok()?;
    let edge = hover.reserve < LEAST_RESERVE;
    edge.then(|| {
        let name = &vehicle.rotors[hover.tightest].name;
        let reserve = 100.0 * hover.reserve;
        format!("hover: rotor '{name}' keeps {reserve:.2} % of its thrust to its limit, so that little is left to steer with. Move the centre of mass, or change what the rotors do")
    })
}

/// Import options from the arguments; `--rotors` is there.
pub fn options(arguments: &VehicleArguments) -> Result<ImportOptions> {
    arguments.rotors.as_deref().map(files::check_there).transpose()?;
    Ok(ImportOptions {
        rotors: arguments.rotors.clone(),
        packages: arguments.package.iter().cloned().collect(),
        ..ImportOptions::default()
    })
}

/// The rotor file that an import reads, if any.
pub fn rotor_file(urdf: &Path, options: &ImportOptions) -> Option<PathBuf> {
    let beside = rotor_file_beside(urdf);
    let candidates = match &options.rotors {
        Some(folder) if folder.is_dir() => vec![folder.join(beside.file_name()?), beside],
        Some(file) => return Some(file.clone()),
        None => vec![beside],
    };
    candidates.into_iter().find(|p| p.exists())
}

/// The same in words.
pub fn rotor_source(urdf: &Path, options: &ImportOptions) -> String {
    rotor_file(urdf, options).map_or_else(|| "its <properties>".into(), |p| p.display().to_string())
}

fn imported(import: Import, origin: String, file: Option<&Path>) -> Source {
    Source {
        warnings: import.warnings.iter().map(ToString::to_string).chain(verdicts(&import.vehicle)).collect(),
        vehicle: import.vehicle,
        origin,
        assumptions: import.assumptions,
        file: file.map(Path::to_path_buf),
    }
}

fn told(vehicle: Vehicle, origin: String, file: Option<&Path>) -> Source {
    let file = file.map(Path::to_path_buf);
    let odd = vehicle.warnings().into_iter().map(|odd| odd.to_string());
    let warnings = odd.chain(verdicts(&vehicle)).collect();
    Source { vehicle, origin, warnings, assumptions: Vec::new(), file }
}

fn no_rotor_file(named: &str, arguments: &VehicleArguments) -> Result<()> {
    match &arguments.rotors {
        None => Ok(()),
        Some(file) => Err(Error::value(
            "--rotors",
            format!("{} with vehicle '{named}'", file.display()),
            "used with a URDF",
            "Built-in vehicles and vehicle files have their rotors: leave it out.",
        )),
    }
}

fn format(file: &str, rule: &str, remedy: &str) -> Error {
    Error::Format { file: file.into(), place: "the file".into(), rule: rule.into(), remedy: remedy.into() }
}

impl Source {
    /// Title line, then up to three warnings and assumptions each.
    pub fn describe(&self, page: &mut Page) {
        page.title(&self.vehicle.name, &self.origin);
        if !self.vehicle.source.is_empty() {
            page.line(format!("  numbers from: {}", self.vehicle.source));
        }
        let more = self.file.as_ref().map_or(String::new(), |f| format!("omnidrones import {}", files::word(f)));
        page.notes("warning", &self.warnings, 3, &more);
        page.notes("assumed", &self.assumptions, 3, &more);
    }

    /// Origin, warnings and assumptions for JSON.
    pub fn json(&self) -> Value {
        json!({ "origin": self.origin, "warnings": self.warnings, "assumptions": self.assumptions })
    }
}
