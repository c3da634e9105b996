//! Vehicles as TOML: the fields of [`Vehicle`] by their own names, SI units.
//!
//! Loading is fenced: size before anything is read, then syntax, then keys (an unknown one is an error that names the
//! nearest), then every number ([`Vehicle::validate`]). Saving and loading returns the same bits.

use super::vehicle::Vehicle;
use base::error::{Error, Result};
use base::reader;
use std::collections::HashSet;
use std::path::Path;

/// Largest vehicle file, bytes.
pub(crate) const MAX_FILE_BYTES: u64 = 16 << 20;

impl Vehicle {
    /// Reads and checks a vehicle; `file_name` is for messages (`<text>` where there is no file).
    ///
    /// ```
    /// # use omnidrones_dynamics::omnidrones;
    /// # use omnidrones::dynamics::{Vehicle, vehicles};
    /// let text = vehicles::by_name("iris")?.to_toml()?;
    /// let error = Vehicle::from_toml_str(&text.replace("max_speed", "max_sped"), "mine.toml").unwrap_err();
    /// assert!(error.to_string().contains("Did you mean `max_speed`?"), "{error}");
    /// # Ok::<(), omnidrones::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Limit`] above 16 MiB; [`Error::Format`] for what is no TOML, an unknown key, what [`validate`](Self::validate) refuses and
    /// a name used twice.
    pub fn from_toml_str(text: &str, file_name: &str) -> Result<Self> {
        check_size(text.len() as u64, file_name)?;
        let vehicle: Self = reader::of_toml(text, file_name)?;
        vehicle.validate().and_then(|()| unique_names(&vehicle)).map_err(|error| in_file(error, file_name))?;
        Ok(vehicle)
    }

    /// Reads and checks a vehicle file of at most 16 MiB.
    ///
    /// # Errors
    /// [`Error::File`] where it cannot be read; otherwise as [`from_toml_str`](Self::from_toml_str).
    pub fn from_toml_file(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let name = path.display().to_string();
        Self::from_toml_str(&base::file_gate::read_text(path, MAX_FILE_BYTES)?, &name)
    }

    /// As TOML text that [`from_toml_str`](Self::from_toml_str) reads back bit for bit.
    ///
    /// # Errors
    /// As [`validate`](Self::validate), and for a name used twice.
    pub fn to_toml(&self) -> Result<String> {
        self.validate()?;
        unique_names(self)?;
        toml::to_string(self).map_err(|e| {
            format_error("<text>", &self.name, &e.to_string(), "Report this: every vehicle has a TOML form.")
        })
    }
}

fn check_size(bytes: u64, file_name: &str) -> Result<()> {
    if bytes <= MAX_FILE_BYTES {
        return Ok(());
    }
    Err(Error::limit(
        format!("size of {file_name}"),
        format!("{bytes} bytes"),
        format!("{MAX_FILE_BYTES} bytes"),
        "A vehicle takes a few kilobytes: check that this is the right file.",
    ))
}

fn unique_names(vehicle: &Vehicle) -> Result<()> {
    let parts = vehicle.parts.iter().map(|p| ("part", &p.name));
    let rotors = vehicle.rotors.iter().map(|r| ("rotor", &r.name));
    let mut seen = HashSet::new();
    for (kind, name) in parts.chain(rotors) {
        if !seen.insert((kind, name)) {
            return Err(Error::value(
                format!("vehicle '{}': name of a {kind}", vehicle.name),
                format!("'{name}' twice"),
                format!("different from every other {kind}"),
                "Rename one of them.",
            ));
        }
    }
    Ok(())
}

fn format_error(file: &str, place: &str, rule: &str, remedy: &str) -> Error {
    Error::Format { file: file.into(), place: place.into(), rule: rule.into(), remedy: remedy.into() }
}

/// The same complaint with the file in front.
pub(crate) fn in_file(error: Error, file_name: &str) -> Error {
    match error {
        Error::Value { what, value, limit, remedy } => {
            format_error(file_name, &what, &format!("is {value}, but it must be {limit}"), &remedy)
        }
        Error::Limit { what, value, limit, remedy } => {
            format_error(file_name, &what, &format!("is {value}, over the limit of {limit}"), &remedy)
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicles;

    fn hummingbird() -> String {
        vehicles::by_name("hummingbird").unwrap().to_toml().unwrap()
    }

    #[test]
    fn every_vehicle_comes_back_from_toml_bit_for_bit() {
        for vehicle in vehicles::all() {
            let text = vehicle.to_toml().unwrap();
            let back = Vehicle::from_toml_str(&text, "<text>").unwrap();
            assert_eq!(back, vehicle);
            assert_eq!(back.to_toml().unwrap(), text);
        }
    }

    #[test]
    fn a_vehicle_comes_back_from_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.toml");
        std::fs::write(&path, hummingbird()).unwrap();
        assert_eq!(Vehicle::from_toml_file(&path).unwrap(), vehicles::by_name("hummingbird").unwrap());
    }

    #[test]
    fn an_unknown_key_is_refused_with_its_line_and_the_nearest_key() {
        let text = hummingbird().replacen("max_speed", "maxspeed", 1);
        let line = text.lines().position(|l| l.starts_with("maxspeed")).unwrap() + 1;
        let message = Vehicle::from_toml_str(&text, "mine.toml").unwrap_err().to_string();
        assert!(
            message.starts_with(&format!("mine.toml: line {line}, column 1: unknown field `maxspeed`")),
            "{message}"
        );
        assert!(message.ends_with("Did you mean `max_speed`?"), "{message}");
        let message = Vehicle::from_toml_str(&format!("colour = 'red'\n{text}"), "m").unwrap_err().to_string();
        assert!(message.starts_with("m: line 1, column 1: unknown field `colour`"), "{message}");
        assert!(message.ends_with("Remove the key: it has no meaning there."), "{message}");
    }

    #[test]
    fn broken_syntax_and_missing_keys_name_file_and_line() {
        let message = Vehicle::from_toml_str("name = 'x'\nparts = [", "mine.toml").unwrap_err().to_string();
        assert!(message.starts_with("mine.toml: line 2"), "{message}");
        let message = Vehicle::from_toml_str("name = 'x'", "mine.toml").unwrap_err().to_string();
        assert!(message.contains("missing field `parts`"), "{message}");
    }

    #[test]
    fn unphysical_numbers_and_repeated_names_name_file_and_element() {
        let text = hummingbird();
        for (from, to, what) in [
            ("mass = 0.68", "mass = -0.68", "mine.toml: vehicle 'hummingbird': part 'base_link': mass: is -0.68"),
            ("mass = 0.68", "mass = nan", "mine.toml: vehicle 'hummingbird': part 'base_link': mass: is NaN"),
            ("max_speed = 838.0", "max_speed = 0", "rotor 'rotor_0': max_speed: is 0"),
            ("name = \"rotor_1\"", "name = \"rotor_0\"", "name of a part: is 'rotor_0' twice"),
        ] {
            assert!(text.contains(from), "{text}");
            let message = Vehicle::from_toml_str(&text.replacen(from, to, 1), "mine.toml").unwrap_err().to_string();
            assert!(message.contains(what), "{message}");
        }
    }

    #[test]
    fn a_whole_number_may_stand_for_a_real_one() {
        let text = hummingbird().replace("spin = 1.0", "spin = 1");
        assert_eq!(Vehicle::from_toml_str(&text, "<text>").unwrap(), vehicles::by_name("hummingbird").unwrap());
    }

    #[test]
    fn a_file_too_large_is_refused_by_its_size_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large.toml");
        std::fs::File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let message = Vehicle::from_toml_file(&path).unwrap_err().to_string();
        assert!(message.contains("1099511627776 bytes, over the limit of 16777216 bytes"), "{message}");
        let message = Vehicle::from_toml_file(folder.path()).unwrap_err().to_string();
        assert!(message.contains("must be a regular file"), "{message}");
    }

    #[test]
    fn deep_nesting_is_an_error_and_not_a_stack_overflow() {
        let text = format!("parts = {}", "[".repeat(1 << 20));
        assert!(Vehicle::from_toml_str(&text, "deep.toml").is_err());
    }
}
