//! Every built-in task: one line each.

use super::config::EnvConfig;
use super::env::Env;
use super::suite::*;
use crate::error::{Error, Result};
use crate::layers::{self, Layer};

/// One line of the registry.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// What users type.
    pub name: &'static str,
    /// One line for tables.
    pub description: &'static str,
    /// Its own defaults, as TOML of an [`EnvConfig`].
    pub defaults: &'static str,
    /// Documentation and code.
    pub source: &'static str,
    /// The source that describes it: its own, or that of the task whose variant it is.
    described: &'static str,
    /// What a variant has of its own, in words.
    own: &'static str,
    make: fn(&str, &EnvConfig) -> Result<Env>,
}

const fn entry(
    name: &'static str,
    description: &'static str,
    source: &'static str,
    make: fn(&str, &EnvConfig) -> Result<Env>,
) -> Entry {
    Entry { name, description, defaults: "", source, described: source, own: "", make }
}

/// Groups of tasks by how their names begin or end; the first that fits counts.
const FAMILIES: [(&str, &str, &str); 8] = [
    ("", "Rand", "another drone in every episode"),
    ("InvPendulum", "", "a ball that stands on a bar"),
    ("Payload", "", "a slung ball"),
    ("Over", "", "an over-actuated platform"),
    ("Transport", "", "a box carried by a team"),
    ("Formation", "", "a team of single drones"),
    ("Omav", "", "thrusters that tilt"),
    ("Dragon", "", "thrusters that tilt"),
];

impl Entry {
    /// What the task is about, for tables in groups: the entries of a family follow each other.
    pub fn family(&self) -> &'static str {
        let fits = |(head, tail, _): &&(&str, &str, &str)| self.name.starts_with(head) && self.name.ends_with(tail);
        FAMILIES.iter().find(fits).map_or("one drone", |(_, _, family)| family)
    }

    /// The task that `described` describes, with defaults of its own, which `own` says in words.
    const fn variant(self, described: &'static str, defaults: &'static str, own: &'static str) -> Self {
        Self { described, defaults, own, ..self }
    }

    /// Symbols, target and start of an episode, in words; of a variant also what it has of its own.
    pub fn setting(&self) -> String {
        let paragraphs = self.paragraphs().into_iter().skip(1).filter(|p| !p.starts_with("- "));
        let own = (!self.own.is_empty()).then(|| self.own.to_string());
        paragraphs.chain(own).collect::<Vec<_>>().join(" ")
    }

    /// When the goal counts as reached in a step: what [`Task::success`](super::Task::success) asks.
    pub fn success(&self) -> String {
        self.item("- Success: ")
    }

    /// Whether an episode is a success if any of its steps was one, not its last.
    pub fn succeeds_once(&self) -> bool {
        self.success().contains("once in the episode")
    }

    /// The formula of [`Task::loss`](super::Task::loss).
    pub fn loss(&self) -> String {
        self.item("- Loss: ")
    }

    fn item(&self, head: &str) -> String {
        let found = self.paragraphs().into_iter().find_map(|p| p.strip_prefix(head).map(String::from));
        found.unwrap_or_default().trim_end_matches('.').into()
    }

    /// The documentation without its tables; items of lists are paragraphs of their own.
    fn paragraphs(&self) -> Vec<String> {
        let mut all = vec![String::new()];
        for line in self.described.lines().map_while(|line| line.strip_prefix("//!")).map(str::trim) {
            if line.is_empty() || line.starts_with("- ") {
                all.push(String::new());
            }
            if let Some(last) = all.last_mut().filter(|_| !line.starts_with('|')) {
                last.push_str(if last.is_empty() { "" } else { " " });
                last.push_str(line);
            }
        }
        all.retain(|paragraph| !paragraph.is_empty());
        all.iter().map(|paragraph| plain(paragraph)).collect()
    }
}

/// Without marks of code and links: `[word](place)` is `word`.
fn plain(text: &str) -> String {
    let text = text.replace('`', "");
    let mut parts = text.split("](crate::");
    let mut out = parts.next().unwrap_or_default().to_string();
    for part in parts {
        if let Some(open) = out.rfind('[') {
            out.remove(open);
        }
        out.push_str(part.split_once(')').map_or(part, |(_, rest)| rest));
    }
    out
}

/// Every built-in task.
pub static REGISTRY: &[Entry] = &[
    entry("Hover", "fly to a point and hold it, with a heading", include_str!("suite/hover.rs"), |name, config| {
        Env::of(hover::Hover::new(config)?, name, config)
    }),
    entry("Track", "follow a lemniscate", include_str!("suite/track.rs"), |name, config| {
        Env::of(track::Track::new(config)?, name, config)
    }),
    entry(
        "FlyThrough",
        "fly through a gate that slides sideways",
        include_str!("suite/fly_through.rs"),
        |name, config| Env::of(fly_through::FlyThrough::new(config)?, name, config),
    ),
    entry(
        "InvPendulumHover",
        "balance a ball on a bar at a point",
        include_str!("suite/pendulum_hover.rs"),
        |name, config| Env::of(pendulum_hover::InvPendulumHover::new(config)?, name, config),
    ),
    entry(
        "InvPendulumTrack",
        "lead a ball that stands on a bar along a lemniscate",
        include_str!("suite/pendulum_track.rs"),
        |name, config| Env::of(pendulum_track::InvPendulumTrack::new(config)?, name, config),
    ),
    entry(
        "InvPendulumFlyThrough",
        "carry a ball that stands on a bar past two level bars",
        include_str!("suite/pendulum_fly_through.rs"),
        |name, config| Env::of(pendulum_fly_through::InvPendulumFlyThrough::new(config)?, name, config),
    ),
    entry(
        "PayloadHover",
        "hold a slung ball at a point while it is pushed",
        include_str!("suite/payload_hover.rs"),
        |name, config| Env::of(payload_hover::PayloadHover::new(config)?, name, config),
    ),
    entry(
        "PayloadTrack",
        "lead a slung ball along a lemniscate",
        include_str!("suite/payload_track.rs"),
        |name, config| Env::of(payload_track::PayloadTrack::new(config)?, name, config),
    ),
    entry(
        "PayloadFlyThrough",
        "swing a slung ball past two level bars",
        include_str!("suite/payload_fly_through.rs"),
        |name, config| Env::of(payload_fly_through::PayloadFlyThrough::new(config)?, name, config),
    ),
    entry(
        "HoverRand",
        "hover with another drone in every episode",
        include_str!("suite/variants.rs"),
        |name, config| Env::of(hover::Hover::new(config)?, name, config),
    )
    .variant(include_str!("suite/hover.rs"), variants::HOVER_RAND, variants::HOVER_RAND_OWN),
    entry(
        "TrackRand",
        "follow a lemniscate with another drone in every episode",
        include_str!("suite/variants.rs"),
        |name, config| Env::of(track::Track::new(config)?, name, config),
    )
    .variant(include_str!("suite/track.rs"), variants::TRACK_RAND, variants::TRACK_RAND_OWN),
    entry("OmavHover", "hover with an Omav whose rotors tilt", include_str!("suite/variants.rs"), |name, config| {
        Env::of(hover::Hover::new(config)?, name, config)
    })
    .variant(include_str!("suite/hover.rs"), variants::OMAV, variants::OMAV_OWN),
    entry(
        "OmavTrack",
        "follow a lemniscate with an Omav whose rotors tilt",
        include_str!("suite/variants.rs"),
        |name, config| Env::of(track::Track::new(config)?, name, config),
    )
    .variant(include_str!("suite/track.rs"), variants::OMAV, variants::OMAV_OWN),
    entry(
        "DragonHover",
        "fly a chain of four links to a point",
        include_str!("suite/dragon_hover.rs"),
        |name, config| Env::of(dragon_hover::DragonHover::new(config)?, name, config),
    ),
    entry(
        "OverHover",
        "bring an over-actuated platform to a pose and hold it",
        include_str!("suite/over_hover.rs"),
        |name, config| Env::of(over_hover::OverHover::new(config)?, name, config),
    ),
    entry(
        "OverTrack",
        "carry an over-actuated platform along a lemniscate",
        include_str!("suite/over_track.rs"),
        |name, config| Env::of(over_track::OverTrack::new(config)?, name, config),
    ),
    entry(
        "OverFlyThrough",
        "bring an over-actuated platform through a row of poles",
        include_str!("suite/over_fly_through.rs"),
        |name, config| Env::of(over_fly_through::OverFlyThrough::new(config)?, name, config),
    ),
    entry(
        "TransportHover",
        "bring a box on bars to a point and hold it",
        include_str!("suite/transport_hover.rs"),
        |name, config| Env::of(transport_hover::TransportHover::new(config)?, name, config),
    ),
    entry(
        "TransportTrack",
        "carry a box on bars along a lemniscate",
        include_str!("suite/transport_track.rs"),
        |name, config| Env::of(transport_track::TransportTrack::new(config)?, name, config),
    ),
    entry(
        "TransportFlyThrough",
        "take a box on bars between two beams",
        include_str!("suite/transport_fly_through.rs"),
        |name, config| Env::of(transport_fly_through::TransportFlyThrough::new(config)?, name, config),
    ),
    entry("Formation", "form a figure in each other's downwash", include_str!("suite/formation.rs"), |name, config| {
        Env::of(formation::Formation::new(config)?, name, config)
    }),
];

impl Entry {
    /// The environment of a configuration over the task's own defaults: they hold for settings of `task` that it does not
    /// name, and for `randomise` where it is none.
    ///
    /// # Errors
    /// As [`Env::of`].
    pub fn env(&self, config: &EnvConfig) -> Result<Env> {
        let (mut own, usual) = (config.clone(), self.default_config()?);
        own.randomise = own.randomise.or(usual.randomise);
        for (key, value) in usual.task {
            own.task.entry(key).or_insert(value);
        }
        (self.make)(self.name, &own)
    }

    /// The configuration of layers, each over those before it, all over the task's own defaults.
    ///
    /// # Errors
    /// As [`layers::read`].
    pub fn config(&self, over: &[Layer]) -> Result<EnvConfig> {
        layers::read(self.default_table()?, over)
    }

    /// The task's own defaults as a table.
    pub(crate) fn default_table(&self) -> Result<toml::Table> {
        Ok(Layer::of_text(self.defaults, self.name)?.table().clone())
    }

    /// The task's own defaults.
    ///
    /// # Errors
    /// None for the registry as it is: a test reads them all.
    pub fn default_config(&self) -> Result<EnvConfig> {
        EnvConfig::from_toml(self.defaults, self.name)
    }
}

/// The names that [`by_name`] knows.
pub fn names() -> Vec<&'static str> {
    REGISTRY.iter().map(|entry| entry.name).collect()
}

/// The built-in task of that name (case does not matter).
///
/// # Errors
/// [`Error::Unknown`] with the nearest.
pub fn by_name(name: &str) -> Result<&'static Entry> {
    REGISTRY.iter().find(|entry| entry.name.eq_ignore_ascii_case(name)).ok_or_else(|| Error::Unknown {
        kind: "task",
        name: name.to_string(),
        known: names().into_iter().map(String::from).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::config::Autoreset;
    use super::super::{Baseline, Watched, evaluate};
    use super::*;

    #[test]
    fn a_list_that_is_given_empty_is_empty_and_one_that_is_not_given_is_the_tasks_own() {
        let entry = by_name("HoverRand").unwrap();
        let changes = |config: &EnvConfig| {
            entry.env(&EnvConfig { n_env: 1, ..config.clone() }).unwrap().spec().config.changes().len()
        };
        let of = |text: &str| EnvConfig::from_toml(text, "my.toml").unwrap();
        assert_eq!((changes(&of("")), changes(&of("randomise = []"))), (9, 0));
        assert_eq!(changes(&EnvConfig { randomise: Some(Vec::new()), ..EnvConfig::default() }), 0);
        let over = |text: &str| changes(&entry.config(&[Layer::of_text(text, "my.toml").unwrap()]).unwrap());
        assert_eq!((over("dt = 0.016"), over("randomise = []")), (9, 0));
    }

    #[test]
    fn the_defaults_of_a_task_are_changes_and_settings_of_the_task() {
        for entry in REGISTRY {
            let table = entry.default_table().unwrap();
            assert!(table.keys().all(|key| key == "randomise" || key == "task"), "{}: {table}", entry.name);
        }
    }

    #[test]
    fn every_task_tells_its_start_its_success_and_its_loss() {
        for entry in REGISTRY {
            let (setting, success, loss) = (entry.setting(), entry.success(), entry.loss());
            assert!(setting.contains("Start: "), "{}: {setting}", entry.name);
            assert!(success.contains(" < 0.") && loss.contains("√("), "{}: {success}; {loss}", entry.name);
            for text in [setting, success, loss] {
                assert!(!text.contains("](") && !text.contains('`'), "{}: {text}", entry.name);
            }
        }
        assert_eq!(by_name("OmavHover").unwrap().success(), "position_error < 0.1 m");
        for (name, own) in [("OmavTrack", "tilt"), ("HoverRand", "are drawn"), ("TrackRand", "every motor are drawn")] {
            assert!(by_name(name).unwrap().setting().contains(own), "{name}");
        }
        assert!(by_name("FlyThrough").unwrap().succeeds_once() && !by_name("Hover").unwrap().succeeds_once());
    }

    /// `position_error < 0.1 m`: metric and limit of every condition.
    fn limits(success: &str) -> Vec<(String, f64)> {
        let limit = |text: &str| {
            let (name, rest) = text.split_once(" < ").unwrap();
            (name.to_string(), rest.split(' ').next().unwrap().parse().unwrap())
        };
        success.split(" and ").map(limit).collect()
    }

    const N: usize = 4;

    /// What flights of 4.8 s need not show: a success (true) or a step without one (false), and why.
    const UNSEEN: &[(&str, bool, &str)] = &[
        ("InvPendulumHover", true, "the ball may be under way for longer"),
        ("PayloadHover", true, "the ball is pushed"),
        ("OverHover", true, "the platform may be under way for longer"),
        ("TransportHover", true, "the box may be under way for longer"),
        ("DragonHover", true, "the chain may be under way for longer"),
        ("Formation", true, "the drones may be under way for longer"),
        ("Track", false, "starts on the path and stays there"),
        ("TrackRand", false, "starts on the path"),
        ("OmavTrack", false, "starts on the path and stays there"),
        ("PayloadTrack", false, "starts on the path"),
        ("OverTrack", false, "starts on the path"),
        ("TransportTrack", false, "starts on the path"),
    ];

    #[test]
    fn success_is_what_it_is_said_to_be() {
        for entry in REGISTRY {
            let mut config = EnvConfig { n_env: N, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
            config.task.insert("horizon".into(), 300.into());
            let (mut env, said) = (entry.env(&config).unwrap(), entry.success());
            let Ok(mut own) = Baseline::new(&env) else { continue };
            let (spec, limits) = (env.spec().clone(), limits(&said));
            let (once, more) = (entry.succeeds_once(), said.contains("with all"));
            let (mut before, mut seen) = ([false; N], [false; 2]);
            let mut watch = |watched: &Watched<'_>| {
                let told = |i: usize, name: &str| {
                    f64::from(watched.out.info[i * spec.info.len() + spec.info_column(name).unwrap()])
                };
                for i in (0..N).filter(|i| watched.flying[*i] && watched.out.terminated[*i] == 0) {
                    let near = limits.iter().any(|(name, limit)| (told(i, name) - limit).abs() < 1e-4);
                    let now = limits.iter().all(|(name, limit)| told(i, name) < *limit);
                    before[i] = now || once && before[i];
                    let success = told(i, "success") > 0.5;
                    seen[usize::from(success)] = true;
                    assert!(near || success == before[i] || more && !success, "{}, step {}", entry.name, watched.step);
                }
            };
            evaluate(&mut env, &mut own.policy(), &mut watch).unwrap();
            for success in [false, true] {
                let excused = UNSEEN.iter().any(|(name, what, _)| (*name, *what) == (entry.name, success));
                assert!(excused || seen[usize::from(success)], "{}: no step with success {success}", entry.name);
            }
        }
    }
}
