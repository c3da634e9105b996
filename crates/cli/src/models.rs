//! `omnidrones models`: the built-in vehicles as a list, or one vehicle as a sheet, TOML or URDF.

use super::arguments::VehicleArguments;
use super::sheet::{self, KeyFigures};
use super::{failure, source};
use crate::prelude::*;
use omnidrones::dynamics::{urdf, vehicles};

/// What the command is for.
pub const ABOUT: &str = "\
List the built-in vehicles, or print everything about one: mass, inertia, parts, rotors, drag, the allocation matrix, \
what is left after the loss of a rotor, gains with their bandwidths, and where the numbers come from. The vehicle may also be your own TOML or URDF file.";

const EXAMPLES: &str = "\
Examples:
  omnidrones models                          the list
  omnidrones models firefly                  one vehicle's sheet
  omnidrones models firefly --toml > my.toml a file to edit and fly: omnidrones fly my.toml
  omnidrones models firefly --urdf out       out/firefly.urdf and out/firefly.rotors.toml
  omnidrones models drone.urdf --json        an imported vehicle, as JSON

Hover command: the rotor command in [-1, 1] that hovers; the thrust of a rotor is (1 + command)/2 of its largest.
JSON: SI units, radians; the list is under \"models\".

Exit codes: 0 printed; 2 unusable input or arguments.";

/// Arguments of `models`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// A built-in vehicle, or a file FILE.toml or FILE.urdf; without it, the list
    #[arg(value_name = "VEHICLE|FILE")]
    vehicle: Option<String>,
    #[command(flatten)]
    rotors: VehicleArguments,
    /// Print JSON and nothing else
    #[arg(long, help_heading = "Output")]
    json: bool,
    /// Print the vehicle as TOML, which 'fly' reads
    #[arg(long, requires = "vehicle", conflicts_with = "json", help_heading = "Output")]
    toml: bool,
    /// Write NAME.urdf and NAME.rotors.toml into this folder
    #[arg(long, value_name = "DIR", requires = "vehicle", conflicts_with_all = ["json", "toml"], help_heading = "Output")]
    urdf: Option<PathBuf>,
    /// Let --urdf overwrite existing files
    #[arg(long, requires = "urdf", help_heading = "Output")]
    force: bool,
}

/// Prints.
pub fn run(a: &Arguments) -> Result<Report> {
    let Some(named) = &a.vehicle else { return list(a.json) };
    let source = source::load(Some(named), &a.rotors)?;
    let vehicle = &source.vehicle;
    if a.toml {
        return Ok(Report::done(vehicle.to_toml()?));
    }
    let mut page = Page::new();
    if let Some(folder) = &a.urdf {
        let (text, rotors) = urdf::export(vehicle)?;
        let plain = files::default_folder(&vehicle.name);
        let stem = plain.file_name().map_or_else(|| "vehicle".into(), |n| n.to_string_lossy().into_owned());
        let paths = [folder.join(format!("{stem}.urdf")), folder.join(format!("{stem}.rotors.toml"))];
        for (path, text) in paths.iter().zip([text, rotors]) {
            files::write_new(path, &text, a.force)?;
        }
        page.written(&paths);
        return Ok(Report::page(&page, true));
    }
    if a.json {
        let mut value = sheet::json(vehicle)?;
        value["origin"] = source.json();
        value["failures"] = failure::json(vehicle)?;
        return Ok(Report::json(&value, true));
    }
    source.describe(&mut page);
    page.line("");
    sheet::sheet(&mut page, vehicle)?;
    let mut sets = vec![("derived", vehicle.derived_gains())];
    if let Some(gains) = vehicle.published_gains {
        sets.insert(0, ("published (used)", gains));
    }
    failure::sheet(&mut page, vehicle)?;
    page.heading("Gains").table(sheet::gains_table(vehicle, &sets));
    page.line(format!(
        "  bandwidth and damping without motor lag; the motors carry up to {} rad/s in attitude",
        short(vehicle.bandwidth_limit(), 3)
    ));
    Ok(Report::page(&page, true))
}

fn list(as_json: bool) -> Result<Report> {
    if as_json {
        let row = |entry: &vehicles::VehicleEntry| {
            let vehicle = (entry.build)();
            let mut value = KeyFigures::of(&vehicle).json(&vehicle);
            value["description"] = json!(entry.description);
            value
        };
        let rows: Vec<_> = vehicles::REGISTRY.iter().map(row).collect();
        return Ok(Report::json(&json!({ "command": "models", "models": rows }), true));
    }
    let mut table =
        Table::new("name | >rotors | >mass [kg] | >thrust / weight | >hover command | >motor lag up / down [ms]");
    let mut stories = Vec::new();
    for entry in vehicles::REGISTRY {
        let vehicle = (entry.build)();
        let key = KeyFigures::of(&vehicle);
        table.row([
            entry.name.to_string(),
            vehicle.n_rotor().to_string(),
            short(key.mass, 4),
            number(key.thrust_to_weight, 2),
            key.hover_command().map_or("–".into(), |a| format!("{a:+.3}")),
            key.motor(),
        ]);
        stories.push(Fact::new(entry.name, entry.description));
        stories.push(Fact::new("", format!("numbers from: {}", vehicle.source)));
    }
    let mut page = Page::new();
    page.table(table).line("").facts(stories);
    page.line("\nomnidrones models NAME prints one of them in full, omnidrones fly NAME flies it.");
    Ok(Report::page(&page, true))
}
