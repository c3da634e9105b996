//! The steps of an import, in order: fence, diagnosis, tree, urdf-rs, bodies, rotors, vehicle.

use super::bodies::{self, Body, Joint, left_out, total_mass};
use super::fault::{clean, fault, few, in_file};
use super::input_limits;
use super::options::ImportOptions;
use super::properties::{self, Properties};
use super::rotors::RotorFile;
use super::{Vehicle, Warning, diagnose, resolve, tree};
use crate::assembly::WORLD;
use crate::vehicle::{Part, Rotor};
use base::error::Result;
use nalgebra::Vector3;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// What an import gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Import {
    /// The vehicle; [`Vehicle::validate`] has passed.
    pub vehicle: Vehicle,
    /// What of the file was probably not meant.
    pub warnings: Vec<Warning>,
    /// Everything that was concluded rather than read, one sentence each.
    pub assumptions: Vec<String>,
}

/// The rotor file that belongs to a URDF: `dir/quad.urdf` → `dir/quad.rotors.toml`.
pub fn rotor_file_beside(urdf: &Path) -> PathBuf {
    urdf.with_extension("rotors.toml")
}

/// Reads a URDF file and its rotor file: that of [`ImportOptions::rotors`], else the one beside it, else none
/// (then `<properties>` must be there).
///
/// # Errors
/// [`Error::File`](base::error::Error::File) where a file cannot be read; otherwise as [`import_text`].
pub fn import_file(path: impl AsRef<Path>, options: &ImportOptions) -> Result<Import> {
    let (text, file, rotors) = read_files(path.as_ref(), options)?;
    import_text(&text, &file, rotors.as_ref(), options)
}

/// Text and name of a URDF, and its rotor file if there is one.
pub(super) fn read_files(path: &Path, options: &ImportOptions) -> Result<(String, String, Option<RotorFile>)> {
    let text = input_limits::read(path, &options.limits)?;
    let rotors = match rotor_path(path, options) {
        None => None,
        Some(found) => {
            let toml = input_limits::read(&found, &options.limits)?;
            Some(RotorFile::parse(&toml, &found.display().to_string())?)
        }
    };
    Ok((text, path.display().to_string(), rotors))
}

fn rotor_path(urdf: &Path, options: &ImportOptions) -> Option<PathBuf> {
    let beside = rotor_file_beside(urdf);
    match &options.rotors {
        Some(folder) if folder.is_dir() => beside
            .file_name()
            .map(|name| folder.join(name))
            .filter(|p| p.exists())
            .or(Some(beside).filter(|p| p.exists())),
        Some(file) => Some(file.clone()),
        None => Some(beside).filter(|p| p.exists()),
    }
}

/// Reads a URDF text. `file_name` is used in messages, and its stem as the vehicle's name; `rotors` wins over
/// `<properties>`.
///
/// # Errors
/// [`Error::Limit`](base::error::Error::Limit) for a size beyond [`ImportOptions::limits`], [`Error::Format`](base::error::Error::Format)
/// for everything that is wrong in the files, with place, rule and remedy. No text makes it panic, recurse or hang.
pub fn import_text(text: &str, file_name: &str, rotors: Option<&RotorFile>, options: &ImportOptions) -> Result<Import> {
    let mut read = read(text, file_name, options)?;
    let rotor_links: Vec<usize> = match (rotors, &read.properties) {
        (Some(file), _) => resolve::links(file, &read.bodies)?.into_iter().flatten().collect(),
        (None, Some(properties)) => properties.links(file_name, &read.bodies)?,
        (None, None) => return Err(no_rotors(file_name)),
    };
    check_masses(&mut read, &rotor_links)?;
    check_root(&mut read);
    if let Some(file) = rotors {
        check_part_names(&read.bodies, file)?;
    }
    let list = read.rotors(rotors)?;
    let vehicle = read.vehicle(rotors, list);
    vehicle.validate().map_err(|e| in_file(e, rotors.map_or(file_name, |r| &r.file), "vehicle"))?;
    let told = vehicle.warnings().into_iter().map(|odd| Warning::of(odd, file_name));
    Ok(Import { warnings: told.chain(read.warnings).collect(), vehicle, assumptions: read.assumptions })
}

/// Parts of the rotor file may not bear the name of a link or of each other.
pub(super) fn check_part_names(bodies: &[Body], file: &RotorFile) -> Result<()> {
    let mut names: HashSet<&str> = bodies.iter().map(|b| b.name.as_str()).collect();
    match file.parts.iter().enumerate().find(|(_, part)| !names.insert(part.name.as_str())) {
        None => Ok(()),
        Some((i, part)) => {
            let name = clean(&part.name);
            let rule = format!("a link or part is called '{name}' too");
            Err(fault(&file.file, format!("[[parts]] {i} ('{name}')"), rule, "Rename it."))
        }
    }
}

fn no_rotors(file: &str) -> base::error::Error {
    let beside = rotor_file_beside(Path::new(file));
    let rule = "there is no rotor file, and no <properties> element with kf, km and thrust2weight";
    let remedy = format!(
        "URDF cannot describe rotors: write {} ('omnidrones import' drafts one), or name it with --rotors (ImportOptions::rotors).",
        clean(&beside.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()))
    );
    fault(file, "<robot>", rule, remedy)
}

/// A URDF before its rotors are known.
pub(super) struct Read {
    pub file: String,
    pub robot: String,
    pub bodies: Vec<Body>,
    pub properties: Option<Properties>,
    pub warnings: Vec<Warning>,
    pub assumptions: Vec<String>,
}

/// Fence, diagnosis, tree, urdf-rs, bodies.
pub(super) fn read(text: &str, file: &str, options: &ImportOptions) -> Result<Read> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    input_limits::check(text, file, &options.limits)?;
    let document = diagnose::parse(text, file)?;
    let mut warnings = diagnose::check(&document, file, options)?;
    let tree = tree::read(&document, file, options)?;
    let properties = properties::read(&document, file, &mut warnings)?;
    let robot = urdf_rs::read_from_string(text).map_err(|e| {
        let text: String = e.to_string().chars().take(300).map(|c| if c.is_control() { ' ' } else { c }).collect();
        fault(file, "<robot>", format!("urdf-rs cannot read it ({text})"), "Compare with the URDF specification.")
    })?;
    let bodies = bodies::place(&robot, &tree, file)?;
    Ok(Read { file: file.to_string(), robot: robot.name, bodies, properties, warnings, assumptions: Vec::new() })
}

impl Read {
    pub(super) fn rotors(&mut self, rotors: Option<&RotorFile>) -> Result<Vec<Rotor>> {
        match (rotors, &self.properties) {
            (Some(file), properties) => {
                if properties.is_some() {
                    let text = format!("{} is used for the rotors; <properties> is not.", file.file);
                    self.assumptions.push(text);
                }
                resolve::rotors(file, &self.bodies, &mut self.assumptions)
            }
            (None, Some(properties)) => properties.rotors(&self.file, &self.robot, &self.bodies, &mut self.assumptions),
            (None, None) => Err(no_rotors(&self.file)),
        }
    }

    fn vehicle(&self, file: Option<&RotorFile>, rotors: Vec<Rotor>) -> Vehicle {
        let own = self.bodies.iter().filter(|b| b.mass > 0.0 || b.has_inertia());
        let parts = own.map(|b| Part::new(b.name.clone(), b.mass, b.center_of_mass.into(), b.inertia));
        let extra = file.map_or(&[][..], |f| f.parts.as_slice());
        Vehicle {
            name: file.and_then(|f| f.name.clone()).unwrap_or_else(|| self.name()),
            source: file.map_or_else(String::new, |f| f.source.clone()),
            parts: parts.chain(extra.iter().cloned()).collect(),
            rotors,
            drag: file.map(|f| f.drag).unwrap_or_default(),
            shapes: self.bodies.iter().flat_map(Body::shapes_in_base).collect(),
            published_gains: file.and_then(|f| f.gains),
        }
    }

    /// The file's stem, else the robot's name, in lower case.
    pub fn name(&self) -> String {
        let path = Path::new(&self.file);
        let stem = path.extension().and(path.file_stem()).map(|s| s.to_string_lossy().to_lowercase());
        let robot = Some(self.robot.to_lowercase()).filter(|s| !s.is_empty());
        stem.or(robot).unwrap_or_else(|| "vehicle".into())
    }

    pub(super) fn warn(&mut self, line: u32, element: String, rule: String, remedy: &str) {
        let file = self.file.clone();
        self.warnings.push(Warning { file, line: Some(line), element, rule, remedy: remedy.into() });
    }
}

/// Mass where it is needed, and a word on every link that has none and every joint that would move.
pub(super) fn check_masses(read: &mut Read, rotors: &[usize]) -> Result<()> {
    if total_mass(&read.bodies) <= 0.0 {
        let rule = "no link has a mass: the total is 0 kg, but it must be > 0";
        return Err(fault(&read.file, "<robot>", rule, "Give the airframe an <inertial> with mass and inertia."));
    }
    check_moving(read, rotors)?;
    // joints of other links are held, which check_moving tells
    let said = left_out(&read.bodies, |i| !rotors.contains(&i));
    read.assumptions.extend(said);
    let massless = |b: &&Body| b.mass <= 0.0 && !b.has_inertia() && !b.is_world();
    let ghost = |b: &&Body| b.mass <= 0.0 && b.has_inertia();
    let point = |b: &&Body| b.mass > 0.0 && !b.has_inertia();
    gather(read, massless, "without mass", "Merged into the rest of the vehicle, to which it adds nothing.");
    gather(read, ghost, "with inertia but no mass", "The inertia is kept; give the link its mass.");
    gather(read, point, "with mass but no inertia", "Merged into the rest as a point mass at its centre of mass.");
    Ok(())
}

/// A word on joints to a root called `world`: in a model they hold the vehicle, here nothing does.
fn check_root(read: &mut Read) {
    let world = read.bodies.iter().position(Body::is_world);
    let root = world.and_then(|i| read.bodies.get(i)).map_or(WORLD, |b| b.name.as_str());
    let ties = |b: &&Body| b.joint.as_ref().is_some_and(|j| Some(j.parent) == world && j.kind != "floating");
    let Some((joint, link)) = read.bodies.iter().find(ties).and_then(|b| Some((b.joint.as_ref()?, &b.name))) else {
        return;
    };
    let element = format!("joint '{}'", clean(&joint.name));
    let (link, root) = (clean(link), clean(root));
    let rule = format!("a {} joint ties link '{link}' to the root '{root}', which stands still", joint.kind);
    let remedy = "Here the vehicle flies freely all the same: remove link and joint, or make the joint floating. As a model \
                  (import_model_file) it is held.";
    read.warn(joint.line, element, rule, remedy);
}

/// One warning for all links that pass `test`.
fn gather(read: &mut Read, test: impl Fn(&&Body) -> bool, rule: &str, remedy: &str) {
    let names: Vec<&str> = read.bodies.iter().filter(&test).map(|b| b.name.as_str()).collect();
    let Some(line) = read.bodies.iter().filter(&test).map(|b| b.line).min() else { return };
    let (plural, count) =
        if names.len() == 1 { ("link", String::new()) } else { ("links", format!("{} links ", names.len())) };
    let element = format!("{plural} {}", few(&names));
    read.warn(line, element, format!("{count}{rule}"), remedy);
}

/// Joints that move: rotors are held (their speed is a state of its own), others are held at zero and warned about.
fn check_moving(read: &mut Read, rotors: &[usize]) -> Result<()> {
    let mut held = Vec::new();
    let mut warnings = Vec::new();
    for (i, body) in read.bodies.iter().enumerate() {
        let Some(joint) = body.joint.as_ref().filter(|j| !j.fixed) else { continue };
        let place = format!("line {}, joint '{}'", joint.line, clean(&joint.name));
        if rotors.contains(&i) {
            if !matches!(joint.kind.as_str(), "revolute" | "continuous") {
                let rule = format!("the joint of a rotor is of type '{}'", clean(&joint.kind));
                return Err(fault(&read.file, place, rule, "A rotor turns: use continuous, revolute or fixed."));
            }
            held.push(joint.name.as_str());
            continue;
        }
        let (mass, moment) = carried(&read.bodies, i, body, joint);
        if mass <= 0.0 || moment <= 0.0 {
            let what = if mass <= 0.0 { "mass" } else { "inertia" };
            let rule = format!("link '{}' moves on this {} joint but carries no {what}", clean(&body.name), joint.kind);
            let remedy = "Give it an <inertial>, make the joint fixed, or declare the link a rotor.";
            return Err(fault(&read.file, place, rule, remedy));
        }
        let element = format!("joint '{}'", clean(&joint.name));
        match (joint.kind.as_str(), read.bodies.get(joint.parent)) {
            // so a file says that a vehicle is free
            ("floating", Some(parent)) if parent.is_world() => {}
            ("floating", _) => {
                let rule =
                    "a floating joint under a link that moves: what hangs on it is a body of its own".to_string();
                let remedy = "It is welded here: use two files, or make the joint fixed. Only a root link called 'world' lets \
                              others float.";
                warnings.push((joint.line, element, rule, remedy));
            }
            (kind, _) => {
                let remedy = "Import it as a model (import_model_file) to let it move, or make it fixed.";
                let beyond = joint.never_at_zero().map(|limits| format!(", which its {limits} exclude"));
                let rule = format!("a {kind} joint that is no rotor's is held at zero{}", beyond.unwrap_or_default());
                warnings.push((joint.line, element, rule, remedy));
            }
        }
    }
    if !held.is_empty() {
        let text = format!("Rotor joints {} are held still: rotor speed is a state of the rotor model.", few(&held));
        read.assumptions.push(text);
    }
    for (line, element, rule, remedy) in warnings {
        read.warn(line, element, rule, remedy);
    }
    Ok(())
}

/// Mass of all that hangs on a joint, and what resists its motion: a moment of inertia about the axis, kg m²; of a joint that
/// slides, the mass; of any other, the least moment about an axis of the base frame.
fn carried(bodies: &[Body], index: usize, body: &Body, joint: &Joint) -> (f64, f64) {
    let axes = match joint.kind.as_str() {
        "revolute" | "continuous" => vec![joint.axis.normalize()],
        "prismatic" => Vec::new(),
        _ => vec![Vector3::x(), Vector3::y(), Vector3::z()],
    };
    let mut mass = 0.0;
    let mut moments = vec![0.0; axes.len()];
    for own in (0..bodies.len()).filter(|i| hangs_on(bodies, *i, index)).filter_map(|i| bodies.get(i)) {
        mass += own.mass;
        moments.iter_mut().zip(&axes).for_each(|(sum, axis)| *sum += own.moment_about(&body.origin, axis));
    }
    (mass, moments.into_iter().reduce(f64::min).unwrap_or(mass))
}

/// Whether body `i` is `carrier` or hangs on it; the tree has no cycles, and at most `InputLimits::bodies` links.
fn hangs_on(bodies: &[Body], mut i: usize, carrier: usize) -> bool {
    while i != carrier {
        match bodies.get(i).and_then(|b| b.joint.as_ref()) {
            Some(joint) => i = joint.parent,
            None => return false,
        }
    }
    true
}
