//! `omnidrones import`: what is in a URDF, what is odd, what had to be assumed; a draft of its rotor file.

use super::arguments::VehicleArguments;
use super::{sheet, source};
use crate::prelude::*;
use omnidrones::dynamics::Vehicle;
use omnidrones::dynamics::urdf::{
    Draft, Import, ImportOptions, RotorFile, draft_rotors, import_file, import_text, rotor_file_beside,
};

/// What the command is for.
pub const ABOUT: &str = "\
Read a URDF and say what is in it: bodies, rotors, every oddity with its line, and every number that was concluded \
rather than read. URDF cannot describe rotors; they come from a small TOML beside it (drone.urdf: drone.rotors.toml), \
or from a <properties> element. Where neither exists, a draft of that TOML is written from the names of the links, with \
each guess marked for you to correct: beside the URDF, or to --out. What will be written is said before.";

const EXAMPLES: &str = "\
Examples:
  omnidrones import drone.urdf                      report; a draft beside it if rotor data lack
  omnidrones import drone.urdf --out out            the draft goes to out/drone.rotors.toml
  omnidrones import drone.urdf --draft --out new    a new draft although rotor data exist
  omnidrones import drone.urdf --rotors mine.toml   with rotor data of your choice
  omnidrones import drone.urdf --to drone.toml      everything in one file that 'fly' reads

No existing file is overwritten without --force. No program is started, no mesh is opened.
JSON: SI units, radians.

Exit codes: 0 imported; 2 unusable input or arguments (each message names file, element, rule and remedy).";

/// Arguments of `import`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// The URDF
    #[arg(value_name = "FILE.urdf")]
    file: PathBuf,
    #[command(flatten)]
    rotors: VehicleArguments,
    /// Write a draft of the rotor file even if there are rotor data
    #[arg(long, conflicts_with = "rotors", help_heading = "Output")]
    draft: bool,
    /// Folder for the draft [default: that of the URDF]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Write the whole vehicle as one TOML, which 'fly' reads
    #[arg(long, value_name = "FILE.toml", help_heading = "Output")]
    to: Option<PathBuf>,
    /// Overwrite existing files
    #[arg(long, help_heading = "Output")]
    force: bool,
    /// Print one JSON object and nothing else
    #[arg(long, help_heading = "Output")]
    json: bool,
}

struct Imported {
    import: Import,
    rotors_from: String,
    drafted: bool,
}

/// Imports.
pub fn run(a: &Arguments) -> Result<Report> {
    let options = source::options(&a.rotors)?;
    if let Some(to) = a.to.as_ref().filter(|to| to.extension().is_none_or(|e| e != "toml")) {
        let value = format!("'{}'", to.display());
        return Err(Error::value("--to", value, "a file that ends in .toml", "Name it so: 'fly' knows it by that."));
    }
    let mut written = Vec::new();
    let imported = import(a, &options, &mut written)?;
    let vehicle = &imported.import.vehicle;
    if let Some(to) = &a.to {
        announce(a, to, "the whole vehicle");
        files::write_new(to, &vehicle.to_toml()?, a.force)?;
        written.push(to.clone());
    }
    if a.json {
        let odd = imported.import.warnings.iter().map(ToString::to_string);
        let warnings: Vec<String> = odd.chain(source::verdicts(&imported.import.vehicle)).collect();
        let value = json!({
            "command": "import",
            "file": a.file.display().to_string(),
            "rotors_from": imported.rotors_from,
            "drafted": imported.drafted,
            "warnings": warnings,
            "assumptions": imported.import.assumptions,
            "vehicle": sheet::json(vehicle)?,
            "files": files::names(&written),
        });
        return Ok(Report::json(&value, true));
    }
    Ok(Report::page(&page(a, &imported, &written), true))
}

/// Imports with the rotor data there are, else with a draft that is written first.
fn import(a: &Arguments, options: &ImportOptions, written: &mut Vec<PathBuf>) -> Result<Imported> {
    let found = source::rotor_file(&a.file, options);
    if !a.draft {
        match import_file(&a.file, options) {
            Ok(mut import) => {
                let rotors_from = source::rotor_source(&a.file, options);
                import.assumptions.extend(found.as_deref().map(unedited).transpose()?.flatten());
                return Ok(Imported { import, rotors_from, drafted: false });
            }
            // without a rotor file the reason may be just that: a draft fails for every other
            Err(error) if found.is_some() => return Err(error),
            Err(_) => {}
        }
    }
    let name = a.file.display().to_string();
    let text = files::read_text(&a.file, options.limits.file_bytes as u64)?;
    let Draft { toml, assumptions } = draft_rotors(&text, &name, options)?;
    let path = draft_path(&a.file, a.out.as_deref());
    let file_name = path.display().to_string();
    let rotors = RotorFile::parse(&toml, &file_name)?;
    let mut import = import_text(&text, &name, Some(&rotors), options)?;
    announce(a, &path, "a draft of its rotors");
    files::write_new(&path, &toml, a.force)?;
    written.push(path);
    import.assumptions.retain(|known| !assumptions.contains(known));
    import.assumptions.splice(0..0, assumptions);
    Ok(Imported { import, rotors_from: file_name, drafted: true })
}

/// How many guesses of a draft still stand in a rotor file.
fn unedited(rotors: &Path) -> Result<Option<String>> {
    let guesses = files::read_text(rotors, files::MAX_CONFIG_BYTES)?.matches(Draft::GUESS).count();
    let (file, mark) = (rotors.display(), Draft::GUESS);
    let told = || format!("{guesses} lines of {file} are marked '{mark}', as its draft was written");
    Ok((guesses > 0).then(told))
}

/// Says what will be written, before it is.
fn announce(a: &Arguments, path: &Path, what: &str) {
    if !a.json {
        eprintln!("writing {}: {what}", path.display());
    }
}

fn draft_path(urdf: &Path, out: Option<&Path>) -> PathBuf {
    let beside = rotor_file_beside(urdf);
    match (out, beside.file_name()) {
        (Some(folder), Some(name)) => folder.join(name),
        _ => beside,
    }
}

fn page(a: &Arguments, imported: &Imported, written: &[PathBuf]) -> Page {
    let Import { vehicle, warnings, assumptions } = &imported.import;
    let mut page = Page::new();
    let how = if imported.drafted { "a DRAFT of its rotors, " } else { "" };
    page.title(&vehicle.name, &format!("{} with {how}{}", a.file.display(), imported.rotors_from));
    if !vehicle.source.is_empty() {
        page.line(format!("  rotor data from: {}", vehicle.source));
    }
    page.line("").facts(sheet::key_facts(vehicle));
    page.heading("Bodies, merged into one").table(sheet::parts(vehicle));
    sheet::rotors(&mut page, vehicle);
    let gains = gains(vehicle);
    page.heading("Gains").table(sheet::gains_table(vehicle, &[gains]));
    let texts: Vec<String> = warnings.iter().map(ToString::to_string).chain(source::verdicts(vehicle)).collect();
    list(&mut page, "Odd in the file", "nothing", &texts);
    list(&mut page, "Assumed, not read", "nothing", assumptions);
    page.written(written);
    page.line("");
    for line in last(imported, &fly(a, imported)) {
        page.line(line);
    }
    page
}

/// What to do with it now: `fly` it, or first mend what keeps it from that.
fn last(imported: &Imported, fly: &str) -> Vec<String> {
    match (source::verdicts(&imported.import.vehicle).first(), imported.drafted) {
        (None, true) => vec![format!("Correct the draft where you know better, then: {fly}")],
        (None, false) => vec![format!("Fly it: {fly}")],
        (Some(reason), drafted) => {
            let what = if drafted { "Correct the draft" } else { "Mend that" };
            vec![format!("It does not fly yet: {reason}"), format!("{what}, then: {fly}")]
        }
    }
}

fn gains(vehicle: &Vehicle) -> (&'static str, omnidrones::dynamics::Gains) {
    let name = if vehicle.published_gains.is_some() { "from the rotor file" } else { "derived" };
    (name, vehicle.gains())
}

fn fly(a: &Arguments, imported: &Imported) -> String {
    let beside = rotor_file_beside(&a.file).display().to_string();
    let found = imported.rotors_from == beside || imported.rotors_from == "its <properties>";
    let rotors =
        if found { String::new() } else { format!(" --rotors {}", files::word(Path::new(&imported.rotors_from))) };
    format!("omnidrones fly {}{rotors}", files::word(&a.file))
}

fn list(page: &mut Page, heading: &str, none: &str, texts: &[String]) {
    page.heading(heading);
    if texts.is_empty() {
        page.line(format!("  {none}"));
    }
    for text in texts {
        page.line(format!("  - {text}"));
    }
}
