//! Algorithms and variants by their names.

use omnidrones::rl::TrainConfig;
use omnidrones::rl::algorithm::{VARIANTS, by_name, names};
use omnidrones::rl::apg::ApgConfig;
use omnidrones::rl::ppo::PpoConfig;

#[test]
fn every_algorithm_is_found_by_its_name_and_a_wrong_name_suggests_the_nearest() {
    for name in names() {
        assert_eq!(by_name(&name.to_uppercase()).unwrap().name(), name);
    }
    assert!(by_name("pppo").unwrap_err().to_string().contains("did you mean 'ppo'?"));
}

#[test]
fn every_variant_is_settings_of_an_algorithm_and_no_algorithm_of_its_own() {
    for own in VARIANTS {
        assert!(by_name(own.name).is_err() && by_name(own.of).is_ok(), "{}", own.name);
        let by_variant = TrainConfig::for_task("OverHover", Some(own.name), None).unwrap();
        let by_settings = TrainConfig::for_task("OverHover", Some(own.of), Some((own.settings, "own"))).unwrap();
        assert_eq!(by_variant.to_toml().unwrap(), by_settings.to_toml().unwrap(), "{}", own.name);
        let named = format!("task = 'OverHover'\nalgorithm = '{}'", own.name);
        assert_eq!(TrainConfig::from_toml(&named, "own").unwrap().algorithm.name(), own.of);
    }
}

#[test]
fn settings_are_copied_and_seen_by_their_type() {
    let one = by_name("apg").unwrap();
    let mut other = one.clone();
    assert!(other.get::<PpoConfig>().is_none());
    other.get_mut::<ApgConfig>().unwrap().horizon = 3;
    other.set_updates(7);
    assert_eq!((other.updates(), one.get::<ApgConfig>().unwrap().horizon), (7, 48));
}
