#![no_main]
//! The settings of a run, or of an environment: an error, or settings that read back as themselves.

use libfuzzer_sys::fuzz_target;
use omnidrones::rl::TrainConfig;
use omnidrones::tasks::EnvConfig;

fuzz_target!(|text: &str| {
    if let Ok(config) = TrainConfig::from_toml(text, "f.toml")
        && config.validate().is_ok()
    {
        let written = config.to_toml().expect("settings that hold can be written");
        let again = TrainConfig::from_toml(&written, "f.toml").expect("what was written can be read");
        assert_eq!(written, again.to_toml().expect("and written again"));
    }
    let _ = EnvConfig::from_toml(text, "f.toml").and_then(|config| config.validate());
});
