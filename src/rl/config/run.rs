//! What all runs have, read from a map that holds tables of algorithms too.

use super::TrainConfig;
use crate::algorithm;
use serde::Deserialize;
use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeSeed, Deserializer, Error as _, IgnoredAny, IntoDeserializer, MapAccess, Visitor};
use std::fmt;

/// What all runs have, read from settings beside which tables of algorithms stand.
pub(super) struct Run(pub(super) TrainConfig);

impl<'de> Deserialize<'de> for Run {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Whole;
        impl<'de> Visitor<'de> for Whole {
            type Value = Run;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the settings of a run")
            }
            fn visit_map<M: MapAccess<'de>>(self, map: M) -> std::result::Result<Run, M::Error> {
                TrainConfig::deserialize(MapAccessDeserializer::new(Shared(map))).map(Run)
            }
        }
        deserializer.deserialize_map(Whole)
    }
}

/// The entries of a map that all runs have: a filter, so that mistakes keep line and column.
struct Shared<M>(M);

impl<'de, M: MapAccess<'de>> MapAccess<'de> for Shared<M> {
    type Error = M::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> std::result::Result<Option<K::Value>, M::Error> {
        let mut seed = Some(seed);
        loop {
            match self.0.next_key_seed(Key(&mut seed))? {
                None => return Ok(None),
                Some(Kind::Shared(key)) => return Ok(Some(key)),
                Some(Kind::Algorithm) => {
                    let name: String = self.0.next_value()?;
                    algorithm::by_name(algorithm::base(&name)).map_err(M::Error::custom)?;
                }
                Some(Kind::Table) => drop(self.0.next_value::<IgnoredAny>()?),
            }
        }
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> std::result::Result<V::Value, M::Error> {
        self.0.next_value_seed(seed)
    }
}

/// What a key of a run is of.
enum Kind<K> {
    Shared(K),
    /// The name of the algorithm.
    Algorithm,
    /// The table of one.
    Table,
}

struct Key<'a, K>(&'a mut Option<K>);

impl<'de, K: DeserializeSeed<'de>> DeserializeSeed<'de> for Key<'_, K> {
    type Value = Kind<K::Value>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> std::result::Result<Self::Value, D::Error> {
        deserializer.deserialize_identifier(self)
    }
}

impl<'de, K: DeserializeSeed<'de>> Visitor<'de> for Key<'_, K> {
    type Value = Kind<K::Value>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of a setting")
    }

    fn visit_str<E: serde::de::Error>(self, key: &str) -> std::result::Result<Self::Value, E> {
        if key == "algorithm" {
            return Ok(Kind::Algorithm);
        }
        if algorithm::names().contains(&key) {
            return Ok(Kind::Table);
        }
        let known = || TrainConfig::keys().iter().map(|k| format!("`{k}`")).collect::<Vec<_>>().join(", ");
        let unknown = |_: E| E::custom(format!("unknown field `{key}`, expected one of {}", known()));
        match self.0.take() {
            Some(seed) => seed.deserialize(key.into_deserializer()).map(Kind::Shared).map_err(unknown),
            None => Err(E::custom("keys ask one at a time")),
        }
    }
}
