#![no_main]
//! A URDF, and behind the first NUL its rotor file: an error of one line, or a vehicle that can be written and read again.

use libfuzzer_sys::fuzz_target;
use omnidrones::dynamics::urdf::{ImportOptions, RotorFile, draft_rotors, export, import_text};

fuzz_target!(|text: &str| {
    let (urdf, rotors) = text.split_once('\0').map_or((text, None), |(urdf, rotors)| (urdf, Some(rotors)));
    let options = ImportOptions::default();
    let rotors = rotors.and_then(|text| RotorFile::parse(text, "f.rotors.toml").ok());
    match import_text(urdf, "f.urdf", rotors.as_ref(), &options) {
        Err(error) => assert!(!error.to_string().contains('\n'), "two lines: {error}"),
        Ok(import) => {
            assert!(import.vehicle.validate().is_ok());
            let _ = (export(&import.vehicle), draft_rotors(urdf, "f.urdf", &options));
        }
    }
});
