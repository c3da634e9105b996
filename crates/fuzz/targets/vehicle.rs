#![no_main]
//! A vehicle's TOML: an error, or a vehicle that reads back as itself.

use libfuzzer_sys::fuzz_target;
use omnidrones::dynamics::Vehicle;

fuzz_target!(|text: &str| {
    let Ok(vehicle) = Vehicle::from_toml_str(text, "f.toml") else { return };
    let written = vehicle.to_toml().expect("a vehicle that was read can be written");
    let again = Vehicle::from_toml_str(&written, "f.toml").expect("what was written can be read");
    assert_eq!(written, again.to_toml().expect("and written again"));
});
