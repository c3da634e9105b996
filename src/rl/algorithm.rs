//! Which algorithms there are, by their names.
//!
//! An algorithm is the struct of its settings. It stands in files as a table of its own name; whoever trains, evaluates,
//! resumes or draws a run sees it through [`Algorithm`] alone.

pub use super::learner::{Algorithm, Plain};

use super::apg::ApgConfig;
use super::dagger::DaggerConfig;
use super::dqn::DqnConfig;
use super::ppo::PpoConfig;
use super::sac::SacConfig;
use super::shac::ShacConfig;
use super::td3::Td3Config;
use base::error::{Error, Result};
use base::layers::{self, Layer};
use serde::Deserialize;
use serde::de::{DeserializeOwned, Deserializer, IgnoredAny, MapAccess, Visitor};
use std::fmt;
use std::marker::PhantomData;
use std::sync::{PoisonError, RwLock};
use tasks::EnvConfig;
use toml::Table;

/// Reads the settings of a run: a table, and layers over it.
type Read = fn(Table, &[Layer]) -> Result<Box<dyn Algorithm>>;

/// One that is known by its name.
#[derive(Clone, Copy)]
pub(crate) struct Entry {
    /// With its defaults.
    pub default: fn() -> Box<dyn Algorithm>,
    /// From the settings of a run: a table, and layers over it.
    pub read: Read,
}

const fn entry<A: Algorithm + Default + DeserializeOwned>() -> Entry {
    Entry { default: || Box::new(A::default()), read: read::<A> }
}

static BUILT_IN: [Entry; 7] = [
    entry::<ApgConfig>(),
    entry::<ShacConfig>(),
    entry::<PpoConfig>(),
    entry::<SacConfig>(),
    entry::<Td3Config>(),
    entry::<DqnConfig>(),
    entry::<DaggerConfig>(),
];
static OWN: RwLock<Vec<Entry>> = RwLock::new(Vec::new());

/// All of them, built-in ones first.
pub(crate) fn entries() -> Vec<Entry> {
    let own = OWN.read().unwrap_or_else(PoisonError::into_inner);
    BUILT_IN.iter().chain(own.iter()).copied().collect()
}

/// Names of all algorithms, built-in ones first.
pub fn names() -> Vec<&'static str> {
    entries().iter().map(|entry| (entry.default)().name()).collect()
}

/// A name that the literature has for settings of an algorithm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variant {
    /// As it is called.
    pub name: &'static str,
    /// Of the algorithm.
    pub of: &'static str,
    /// Settings, in TOML.
    pub settings: &'static str,
}

/// All such names.
pub static VARIANTS: [Variant; 9] = [
    Variant { name: "mappo", of: "ppo", settings: "ppo.central_critic = true" },
    Variant { name: "happo", of: "ppo", settings: "ppo = { central_critic = true, team = 'sequential' }" },
    Variant {
        name: "ddpg",
        of: "td3",
        settings: "td3 = { critics = 1, actor_delay = 1, exploration = { target_noise = 0.0 } }",
    },
    Variant {
        name: "fasttd3",
        of: "td3",
        settings: "[td3]
            n_env = 2048
            steps = 4
            updates = 1000
            gradient_steps = 8
            batch = 2048
            tau = 0.02
            quantiles = 25
            replay.capacity = 1_000_000",
    },
    Variant {
        name: "maddpg",
        of: "td3",
        settings: "td3 = { central_critic = true, critics = 1, actor_delay = 1, exploration = { target_noise = 0.0 } }",
    },
    Variant { name: "matd3", of: "td3", settings: "td3.central_critic = true" },
    Variant {
        name: "rma",
        of: "dagger",
        settings: "from = '/apg'
            env.observation = [{ kind = 'history', steps = 16 }]
            [from_settings]
            observation = [{ kind = 'privileged' }]
            apg.network.encoder = [{ kind = 'mlp', group = 'parameters', units = [32, 8] }]
            [dagger]
            imitate = 'latent'
            teacher_share = 0.0
            network.encoder = [{ kind = 'mlp', group = 'past', units = [64, 8] }]",
    },
    Variant { name: "vdn", of: "dqn", settings: "dqn = { mixer = { kind = 'sum' }, quantiles = 1 }" },
    Variant {
        name: "qmix",
        of: "dqn",
        settings: "dqn = { mixer = { kind = 'monotone', units = 32, hidden = 64 }, quantiles = 1 }",
    },
];

/// The variant of that name (case does not matter), if it is one.
pub fn variant(name: &str) -> Option<&'static Variant> {
    VARIANTS.iter().find(|own| own.name.eq_ignore_ascii_case(name))
}

/// The algorithm that a name stands for: its own, or that of which it is a variant.
pub fn base(name: &str) -> &str {
    variant(name).map_or(name, |own| own.of)
}

/// The algorithm of that name (case does not matter) with its defaults.
///
/// # Errors
/// [`Error::Unknown`] with the nearest.
pub fn by_name(name: &str) -> Result<Box<dyn Algorithm>> {
    let mut all = entries().into_iter().map(|entry| (entry.default)());
    all.find(|own| own.name().eq_ignore_ascii_case(name)).ok_or_else(|| Error::Unknown {
        kind: "algorithm",
        name: name.into(),
        known: names().into_iter().chain(VARIANTS.iter().map(|own| own.name)).map(String::from).collect(),
    })
}

/// Makes an algorithm of one's own known in this process: files may hold a table of its name, and runs go by it.
/// Do so before settings, runs or policies of it are read. Once more does nothing.
///
/// # Errors
/// [`Error::Value`] for the name of another one, or of a setting that runs or environments have.
pub fn register<A: Algorithm + Default + DeserializeOwned>() -> Result<()> {
    let new = A::default();
    let same = |known: &dyn Algorithm| known.get::<A>().is_some();
    let mut own = OWN.write().unwrap_or_else(PoisonError::into_inner);
    let all: Vec<_> = BUILT_IN.iter().chain(own.iter()).map(|entry| (entry.default)()).collect();
    if all.iter().any(|known| same(&**known)) {
        return Ok(());
    }
    let taken = |name: &str| name.eq_ignore_ascii_case(new.name());
    let variants = VARIANTS.iter().map(|own| own.name.to_string());
    let settings = super::config::TrainConfig::own_keys().into_iter().chain(EnvConfig::keys()).chain(variants);
    if all.iter().any(|known| taken(known.name())) || settings.into_iter().any(|key| taken(&key)) {
        let remedy = "Name it otherwise: its settings are a table of that name.";
        return Err(Error::value("name of the algorithm", new.name(), "one that is not taken", remedy));
    }
    own.push(entry::<A>());
    Ok(())
}

fn read<A: Algorithm + Default + DeserializeOwned>(base: Table, over: &[Layer]) -> Result<Box<dyn Algorithm>> {
    layers::read::<Only<A>>(base, over).map(|Only(own)| Box::new(own) as Box<dyn Algorithm>)
}

/// Of the settings of a run those of one algorithm; the others are read by others.
struct Only<A>(A);

impl<'de, A: Algorithm + Default + Deserialize<'de>> Deserialize<'de> for Only<A> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Table<A>(PhantomData<A>);
        impl<'de, A: Algorithm + Default + Deserialize<'de>> Visitor<'de> for Table<A> {
            type Value = Only<A>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the settings of a run")
            }
            fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> std::result::Result<Only<A>, M::Error> {
                let mut own = A::default();
                while let Some(key) = map.next_key::<String>()? {
                    if key == own.name() {
                        own = map.next_value()?;
                    } else {
                        map.next_value::<IgnoredAny>()?;
                    }
                }
                Ok(Only(own))
            }
        }
        deserializer.deserialize_map(Table(PhantomData))
    }
}
