//! Settings in layers: tables of TOML, each over those before it, merged before anything is read from them.
//!
//! What a layer says counts, also where it says what was the default anyway. Tables are merged key by key; a table with
//! a `kind` is a choice and replaces the one below it, while one without goes over the choice that stands:
//! `learning_rate.from = 0.005` changes one end of a recipe's schedule. An `own_vehicle` replaces the one below it whole: a
//! vehicle without published gains does not fly another one's.

use crate::error::{Error, Result};
use crate::reader::{self, Fault};
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// A table of settings, and where it comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    name: String,
    /// What it was read from, for line and column of mistakes.
    text: Option<String>,
    table: Table,
}

impl Layer {
    /// From TOML text; `file` is for messages.
    ///
    /// # Errors
    /// [`Error::Format`] with line and column for text that is no TOML.
    pub fn of_text(text: &str, file: &str) -> Result<Self> {
        Ok(Self { name: file.into(), text: Some(text.into()), table: reader::parse(text, file)? })
    }

    /// From a table that comes from no file; `name` is for messages.
    pub fn of_table(name: &str, table: Table) -> Self {
        Self { name: name.into(), text: None, table }
    }

    /// Where it comes from, as messages name it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its settings.
    pub fn table(&self) -> &Table {
        &self.table
    }

    /// With its table rearranged; mistakes in what `change` leaves alone keep their line and column.
    pub fn map(mut self, change: impl FnOnce(Table) -> Table) -> Self {
        let before = self.table.clone();
        self.table = change(self.table);
        self.text = self.text.filter(|_| before == self.table);
        self
    }

    /// What is wrong with the merged settings since this layer came, in words of its own: line and column where the layer
    /// is a text that is wrong by itself, else the path of the key.
    fn error_of_layer<T: DeserializeOwned>(&self, merged: &Fault) -> Error {
        let alone = self.text.as_ref().and_then(|text| Some((text, reader::of_table::<T>(&self.table).err()?)));
        match alone {
            // a part of a choice below lacks the rest by itself
            Some((text, fault)) if !fault.message().starts_with("missing field") => fault.in_text(text, &self.name),
            _ => merged.in_table(&self.name),
        }
    }
}

/// Tables that are one thing: what a layer leaves out is not taken from the layer below.
const WHOLE: &str = "own_vehicle";

/// Puts `over` on top of `under`, table by table. A table with a `kind`, or of a vehicle, replaces the one below it.
pub fn merge(under: &mut Table, over: Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) if !above.contains_key("kind") && key != WHOLE => {
                merge(below, above);
            }
            (_, value) => drop(under.insert(key, value)),
        }
    }
}

/// The settings of `layers`, each over those before it, all over `base`; `base` alone without layers.
///
/// # Errors
/// [`Error::Format`] that names the first layer with which something cannot be read, line and column (of a table: the
/// path of the key), and for an unknown key the nearest known one.
pub fn read<T: DeserializeOwned>(base: Table, layers: &[Layer]) -> Result<T> {
    let (mut merged, mut settings) = (base, None);
    for layer in layers {
        merge(&mut merged, layer.table.clone());
        settings = Some(reader::of_table(&merged).map_err(|fault| layer.error_of_layer::<T>(&fault))?);
    }
    match settings {
        Some(settings) => Ok(settings),
        None => reader::of_table(&merged).map_err(|fault| fault.in_table("settings")),
    }
}

/// A value at a dotted path, as a table: `at("a.b", x)` is `{ a = { b = x } }`. Every dot separates; quotes mean nothing.
pub fn at(path: &str, value: Value) -> Table {
    let mut keys = path.rsplit('.');
    let last = keys.next().unwrap_or_default();
    let innermost = Table::from_iter([(last.to_string(), value)]);
    keys.fold(innermost, |inner, key| Table::from_iter([(key.to_string(), Value::Table(inner))]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    /// Settings as those of environments are.
    #[derive(Debug, Default, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct EnvConfig {
        seed: u64,
        dt: f64,
        integrator: String,
        action_scale: ActionScale,
        delay: Delay,
    }

    #[derive(Debug, Default, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct ActionScale {
        rate: f64,
    }

    #[derive(Debug, Default, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct Delay {
        min: usize,
        max: usize,
    }

    fn table(text: &str) -> Table {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn a_table_with_a_kind_replaces_another_and_one_without_goes_over_it() {
        let mut under = table("rate = { kind = 'linear', from = 1.0, to = 0.0 }\na.b = 1\na.c = 2");
        merge(&mut under, table("rate.from = 3.0\na.c = 3"));
        assert_eq!(under, table("rate = { kind = 'linear', from = 3.0, to = 0.0 }\na.b = 1\na.c = 3"));
        merge(&mut under, table("rate = { kind = 'constant', value = 2.0 }"));
        assert_eq!(under["rate"], Value::Table(table("kind = 'constant'\nvalue = 2.0")));
    }

    #[test]
    fn a_vehicle_takes_nothing_from_the_one_that_it_replaces() {
        let mut under = table("[env.own_vehicle]\nname = 'a'\npublished_gains.rate = [1, 1, 1]\n[env]\ndt = 0.01");
        merge(&mut under, table("env.own_vehicle.name = 'b'"));
        assert_eq!(under, table("env.dt = 0.01\nenv.own_vehicle.name = 'b'"));
    }

    #[test]
    fn a_mistake_is_named_by_line_and_column_in_a_text_and_by_its_key_in_a_table() {
        let told = |layer: Layer| read::<EnvConfig>(Table::new(), &[layer]).unwrap_err().to_string();
        let text = "seed = 1\nintegrater = 'rk4'";
        let of_text = told(Layer::of_text(text, "my.toml").unwrap());
        assert!(of_text.starts_with("my.toml: line 2, column 1: unknown field `integrater`"), "{of_text}");
        let of_table = told(Layer::of_table("configuration", table("action_scale.rate = 'fast'")));
        assert!(of_table.starts_with("configuration: action_scale.rate: invalid type: string"), "{of_table}");
        let unknown = told(Layer::of_table("configuration", table("delay.mim = 3")));
        assert!(unknown.starts_with("configuration: delay") && unknown.contains("Did you mean `min`?"), "{unknown}");
    }

    #[test]
    fn the_layer_that_is_wrong_is_blamed() {
        let layers = [Layer::of_table("first", table("dt = 0.01")), Layer::of_table("second", table("dt = 'long'"))];
        let error = read::<EnvConfig>(Table::new(), &layers).unwrap_err().to_string();
        assert!(error.starts_with("second: dt: "), "{error}");
    }

    #[test]
    fn a_dotted_path_is_a_table_in_tables() {
        assert_eq!(at("a.b.c", Value::Integer(1)), table("a.b.c = 1"));
    }
}
