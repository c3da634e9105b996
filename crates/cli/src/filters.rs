//! `--filters`: what the measured angular velocity passes before the cascade is given it.

use crate::prelude::*;
use omnidrones::controllers::{FilterFile, FilterSettings};

/// Which filters.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Controller")]
pub struct FilterArguments {
    /// Filters of the measured body rates, first to last: low_pass:HZ[:ORDER] and notch:HZ:BANDWIDTH, or a TOML file
    ///
    /// As low_pass:80,notch:150:30. Of the cascade of one vehicle, eight at most.
    /// They compute with its rate level. A file holds tables:
    ///   [[filter]]
    ///   kind = "low_pass"
    ///   frequency = 80                   # Hz, where half the power is left
    ///   order = 2                        # 1 or 2
    ///   [[filter]]
    ///   kind = "notch"
    ///   frequency = 150                  # Hz, what is taken out
    ///   bandwidth = 30                   # Hz, what loses half its power or more
    /// Frequencies lie below half the rate of the rate level.
    #[arg(long, value_name = "LIST|FILE.toml", verbatim_doc_comment)]
    filters: Option<String>,
}

impl FilterArguments {
    /// The filters; none where none are asked for.
    pub fn settings(&self) -> Result<Vec<FilterSettings>> {
        match self.filters.as_deref() {
            None => Ok(Vec::new()),
            Some(file) if file.to_lowercase().ends_with(".toml") => {
                Ok(files::read_toml::<FilterFile>(Path::new(file))?.filter)
            }
            Some(list) => FilterSettings::parse_list(list),
        }
    }

    /// Refuses them for what is not flown by the cascade of one vehicle.
    pub fn refuse(&self, whom: &str, remedy: &str) -> Result<()> {
        let Some(given) = &self.filters else { return Ok(()) };
        let rule = "left out: the cascade of one vehicle alone has filters";
        Err(Error::value(format!("--filters with {whom}"), given, rule, remedy))
    }

    /// As they were given.
    pub fn given(&self) -> Option<String> {
        self.filters.clone()
    }
}

/// What filters do, at the rate of the level they are of.
pub fn fact(filters: &[FilterSettings], rate: f64) -> Option<Fact> {
    let all = filters.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    let late = FilterSettings::delay_of(filters, 1.0 / rate);
    (!filters.is_empty())
        .then(|| Fact::new("filters of body rates", all).note(format!("slow motion is seen {} late", duration(late))))
}
