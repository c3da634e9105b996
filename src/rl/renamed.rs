//! Settings of algorithms by the names that they had in 0.1: runs and files of then are read still.

use crate::error::{Error, Result};
use crate::layers::Layer;
use toml::{Table, Value};

/// Table, and in it the name of then and of now.
const RENAMED: [(&str, &[(&str, &str)]); 3] = [
    (
        "apg",
        &[("window", "horizon"), ("rate", "learning_rate"), ("clip", "max_grad_norm"), ("carry_clip", "adjoint_clip")],
    ),
    (
        "shac",
        &[
            ("window", "horizon"),
            ("rate", "learning_rate"),
            ("critic_rate", "critic_learning_rate"),
            ("clip", "max_grad_norm"),
            ("critic_clip", "critic_max_grad_norm"),
            ("critic_passes", "critic_epochs"),
            ("target_keep", "polyak"),
            ("carry_clip", "adjoint_clip"),
        ],
    ),
    (
        "ppo",
        &[
            ("rate", "learning_rate"),
            ("critic_rate", "critic_learning_rate"),
            ("clip", "clip_epsilon"),
            ("gradient_clip", "max_grad_norm"),
        ],
    ),
];

/// A layer with today's names.
///
/// # Errors
/// [`Error::Format`] for a setting that is given by both of its names.
pub(crate) fn renamed(layer: Layer) -> Result<Layer> {
    for (table, names) in RENAMED {
        let given = |key: &str| layer.table().get(table).is_some_and(|own| own.get(key).is_some());
        if let Some((then, now)) = names.iter().find(|(then, now)| given(then) && given(now)) {
            let (file, place) = (layer.name().into(), format!("{table}.{then}"));
            let (rule, remedy) = (format!("is called {now}, which is given too"), format!("Remove {then}."));
            return Err(Error::Format { file, place, rule, remedy });
        }
    }
    Ok(layer.map(|mut settings: Table| {
        for (table, names) in RENAMED {
            let Some(Value::Table(own)) = settings.get_mut(table) else { continue };
            for (then, now) in names {
                if let Some(value) = own.remove(*then) {
                    own.insert(now.to_string(), value);
                }
            }
        }
        settings
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::TrainConfig;

    #[test]
    fn every_name_of_then_means_the_setting_of_now() {
        let value = |key: &str| {
            if key.contains("rate") {
                "0.003"
            } else if key.contains("clip") {
                "0.25"
            } else {
                "1"
            }
        };
        for (table, names) in RENAMED {
            for (then, now) in names {
                let of = |key: &str| {
                    let text = format!("{table}.{key} = {}", value(then));
                    TrainConfig::for_task("Hover", Some(table), Some((&text, "my.toml"))).unwrap()
                };
                assert_eq!(of(then), of(now), "{table}.{then}");
                let usual = TrainConfig::for_task("Hover", Some(table), None).unwrap();
                assert_ne!(of(then), usual, "{table}.{then} is not the default");
                let text = of(then).to_toml().unwrap();
                assert_eq!(TrainConfig::from_toml(&text, "config.toml").unwrap(), of(now), "{text}");
            }
        }
    }

    #[test]
    fn a_part_of_a_choice_goes_by_its_old_name_too() {
        let of = |text: &str| TrainConfig::for_task("Hover", Some("apg"), Some((text, "my.toml"))).unwrap();
        assert_eq!(of("apg.rate.from = 0.004"), of("apg.learning_rate.from = 0.004"));
    }

    #[test]
    fn a_setting_by_both_of_its_names_is_refused() {
        let text = "apg.window = 3\napg.horizon = 4";
        let error = TrainConfig::from_toml(text, "my.toml").unwrap_err().to_string();
        assert!(error.starts_with("my.toml: apg.window: is called horizon"), "{error}");
    }
}
