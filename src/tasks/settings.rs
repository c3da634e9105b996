//! Settings of a task, each stated once: name, type, default, unit, meaning and domain in one line of [`settings!`].
//!
//! From that line come the field of the struct, its documentation, its key in `[task]`, the check of what is given, the
//! tables of `omnidrones tasks NAME` and the value that `{key}` stands for in the words of a task.

use base::error::Error;
// `settings!` names it from the crates of users
#[doc(hidden)]
pub use base::error::Result;
use base::reader;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// A number of a task's configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// Key in `[task]` of a configuration file.
    pub key: String,
    /// Where nothing is given.
    pub default: toml::Value,
    /// As it is.
    pub value: toml::Value,
    /// SI, with the frame where there is one; empty for what is no number.
    pub unit: String,
    /// What it is.
    pub meaning: String,
    /// What its numbers may be.
    pub domain: SettingDomain,
}

impl Setting {
    /// What it is, with unit.
    pub fn text(&self) -> String {
        if ["", "-"].contains(&self.unit.as_str()) {
            self.meaning.clone()
        } else {
            format!("{}, {}", self.meaning, self.unit)
        }
    }
}

/// What the numbers of a setting may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SettingDomain {
    /// Any that is finite.
    Any,
    /// > 0: distances, lengths.
    Positive,
    /// ≥ 0: losses, standard deviations.
    NotNegative,
    /// Within [0, 1].
    Share,
    /// Pairs of lowest and highest.
    Ordered,
    /// Pairs of lowest and highest, all > 0.
    PositiveOrdered,
}

impl SettingDomain {
    /// Refuses a value.
    fn check(self, key: &str, value: &toml::Value, meaning: &str) -> Result<()> {
        let (allows, rule): (fn(f64) -> bool, &str) = match self {
            Self::Any | Self::Ordered => (|_| true, ""),
            Self::Positive => (|x| x > 0.0, "> 0"),
            Self::NotNegative => (|x| x >= 0.0, "≥ 0"),
            Self::Share => (|x| (0.0..=1.0).contains(&x), "within [0, 1]"),
            Self::PositiveOrdered => (|x| x > 0.0, "[low, high] with 0 < low ≤ high"),
        };
        let key = format!("task.{key}");
        if let Some(wrong) = find(value, &|x| !allows(x)) {
            return Err(Error::value(key, wrong, rule, format!("It is: {meaning}.")));
        }
        let ordered = !matches!(self, Self::Ordered | Self::PositiveOrdered) || in_order(value);
        let remedy = "Give both the same to fix it.";
        if ordered { Ok(()) } else { Err(Error::value(key, value, "[low, high] with low ≤ high", remedy)) }
    }
}

/// Whether every innermost pair is one of lowest and highest.
fn in_order(value: &toml::Value) -> bool {
    let number = |x: &toml::Value| x.as_float().or(x.as_integer().map(|x| x as f64));
    match value.as_array().map(Vec::as_slice) {
        Some([low, high]) if number(low).is_some() => number(low) <= number(high),
        Some(all) => all.iter().all(in_order),
        None => true,
    }
}

/// The first number of a value, at any depth, that `is`.
pub(crate) fn find(value: &toml::Value, is: &dyn Fn(f64) -> bool) -> Option<f64> {
    match value {
        toml::Value::Float(x) => Some(*x).filter(|x| is(*x)),
        toml::Value::Integer(x) => Some(*x as f64).filter(|x| is(*x)),
        toml::Value::Array(all) => all.iter().find_map(|x| find(x, is)),
        toml::Value::Table(all) => all.values().find_map(|x| find(x, is)),
        _ => None,
    }
}

/// What a setting may be of: anything that TOML can hold.
pub trait SettingValue {
    /// As in a file.
    fn value(&self) -> toml::Value;

    /// Takes the place of what is.
    ///
    /// # Errors
    /// What speaks against the type.
    fn read(&mut self, value: &toml::Value) -> std::result::Result<(), String>;
}

impl<T: Serialize + DeserializeOwned> SettingValue for T {
    fn value(&self) -> toml::Value {
        toml::Value::try_from(self).unwrap_or_else(|_| String::new().into())
    }

    fn read(&mut self, value: &toml::Value) -> std::result::Result<(), String> {
        *self = reader::of_value(value).map_err(|fault| fault.message().lines().collect::<Vec<_>>().join(" "))?;
        Ok(())
    }
}

/// Who visits every setting: key, unit, meaning, domain, and the setting itself.
pub type Visit<'a> = dyn FnMut(String, [&'static str; 2], SettingDomain, &mut dyn SettingValue) -> Result<()> + 'a;

/// Settings of a list, with what a table gives in place of defaults.
///
/// # Errors
/// As [`Settings::of`].
pub fn given(mut list: Vec<Setting>, table: &toml::Table) -> Result<Vec<Setting>> {
    for own in &mut list {
        let given = table.get(&own.key);
        let Some(value) = given.map_or(Some(own.value.clone()), |given| like(&own.default, given)) else {
            let (kind, key) = (own.default.type_str(), own.key.clone());
            let rule = format!("{}: not of the kind of its default, {kind} {}", table[&own.key], own.default);
            let remedy = format!("It is: {}.", own.meaning);
            return Err(Error::Format { file: "[task]".into(), place: key, rule, remedy });
        };
        own.domain.check(&own.key, &value, &own.meaning)?;
        own.value = value;
    }
    let known: Vec<String> = list.iter().map(|own| own.key.clone()).collect();
    match table.keys().find(|key| !known.contains(key)) {
        None => Ok(list),
        Some(key) => Err(Error::unknown_key("[task]", key, &known)),
    }
}

/// A value of the kind of another: whole numbers are numbers, lists are as long and as deep.
fn like(default: &toml::Value, given: &toml::Value) -> Option<toml::Value> {
    use toml::Value::{Array, Float, Integer};
    match (default, given) {
        (Float(_), Integer(n)) => Some(Float(*n as f64)),
        (Integer(_), Float(x)) if x.fract() == 0.0 && x.abs() < 2f64.powi(53) => Some(Integer(*x as i64)),
        (Array(default), Array(given)) if default.is_empty() => Some(Array(given.clone())),
        (Array(default), Array(given)) => {
            let pairs = given.iter().enumerate().map(|(i, own)| like(default.get(i).unwrap_or(&default[0]), own));
            Some(Array(pairs.collect::<Option<_>>()?)).filter(|_| default.len() == given.len() || default[0].is_array())
        }
        (a, b) => a.same_type(b).then(|| given.clone()),
    }
}

/// A struct of settings, as [`settings!`] makes it.
pub trait Settings: Clone + Default {
    /// Visits every setting, in order; `prefix` stands before the keys.
    ///
    /// # Errors
    /// Those of the visit.
    fn each(&mut self, prefix: &str, visit: &mut Visit<'_>) -> Result<()>;

    /// What a table gives, over the defaults.
    ///
    /// # Errors
    /// [`Error::Format`] for an unknown key, with the nearest, and for a value of another type; [`Error::Value`] outside its
    /// domain.
    fn of(table: &toml::Table) -> Result<Self> {
        let (mut own, mut known) = (Self::default(), Vec::new());
        own.each("", &mut |key, [_, meaning], domain, setting| {
            if let Some(value) = table.get(&key) {
                setting.read(value).map_err(|rule| Error::Format {
                    file: "[task]".into(),
                    place: key.clone(),
                    rule: format!("{value}: {rule}"),
                    remedy: format!("It is: {meaning}."),
                })?;
                domain.check(&key, value, meaning)?;
            }
            known.push(key);
            Ok(())
        })?;
        match table.keys().find(|key| !known.contains(key)) {
            None => Ok(own),
            Some(key) => Err(Error::unknown_key("[task]", key, &known)),
        }
    }

    /// All settings as data.
    fn list(&self) -> Vec<Setting> {
        let mut all = Vec::new();
        // visits of this kind have no errors
        let _ = Self::default().each("", &mut |key, [unit, meaning], domain, setting| {
            let default = setting.value();
            let value = default.clone();
            all.push(Setting { key, default, value, unit: unit.into(), meaning: meaning.into(), domain });
            Ok(())
        });
        let mut own = all.iter_mut();
        let _ = self.clone().each("", &mut |_, _, _, setting| {
            own.next().into_iter().for_each(|s| s.value = setting.value());
            Ok(())
        });
        all
    }
}

/// A struct of settings, each in one line: `name: type = default => ("unit", "meaning", SettingDomain);`. What several tasks share is
/// a struct of its own, whose keys begin with the name of the field (`=> group;`) or not (`=> flat;`).
///
/// ```
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::settings;
/// use omnidrones::tasks::settings::Settings;
///
/// settings! {
///     /// Of a task that climbs.
///     pub struct ClimbSettings {
///         vehicle: String = "hummingbird".into() => ("", "what flies", Any);
///         height: f64 = 2.0 => ("m, world", "to rise to", Positive);
///     }
/// }
/// let own = ClimbSettings::of(&"height = 3.0".parse().unwrap())?;
/// assert_eq!((own.height, own.list()[1].default.as_float()), (3.0, Some(2.0)));
/// assert!(ClimbSettings::of(&"height = -1.0".parse().unwrap()).is_err());
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[macro_export]
macro_rules! settings {
    ($(#[$meta:meta])* $vis:vis struct $name:ident { $($field:ident: $type:ty = $default:expr => $how:tt;)+ }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq)]
        $vis struct $name {
            $(#[doc = $crate::settings!(@doc $field $how)] pub $field: $type,)+
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)+ }
            }
        }

        impl $crate::settings::Settings for $name {
            fn each(
                &mut self,
                prefix: &str,
                visit: &mut $crate::settings::Visit<'_>,
            ) -> $crate::settings::Result<()> {
                $($crate::settings!(@visit self prefix visit $field $how);)+
                Ok(())
            }
        }
    };
    (@doc $field:ident group) => { concat!("Those that begin with `", stringify!($field), "_`.") };
    (@doc $field:ident flat) => { "Those that other tasks have too." };
    (@doc $field:ident ($unit:literal, $meaning:literal, $domain:ident)) => { concat!($meaning, "; ", $unit) };
    (@visit $own:ident $prefix:ident $visit:ident $field:ident group) => {
        $crate::settings::Settings::each(
            &mut $own.$field,
            &format!("{}{}_", $prefix, stringify!($field)),
            &mut *$visit,
        )?
    };
    (@visit $own:ident $prefix:ident $visit:ident $field:ident flat) => {
        $crate::settings::Settings::each(&mut $own.$field, $prefix, &mut *$visit)?
    };
    (@visit $own:ident $prefix:ident $visit:ident $field:ident ($unit:literal, $meaning:literal, $domain:ident)) => {
        $visit(
            format!("{}{}", $prefix, stringify!($field)),
            [$unit, $meaning],
            $crate::settings::SettingDomain::$domain,
            &mut $own.$field,
        )?
    };
}

pub use settings;

/// A text with the values of settings for `{key}`, and for `{×key}` the value as a factor, left out where it is 1.
pub(crate) fn filled(text: &str, settings: &[Setting]) -> String {
    let mut parts = text.split('{');
    let mut out = parts.next().unwrap_or_default().to_string();
    for part in parts {
        let found = part.split_once('}').and_then(|(key, rest)| {
            let (key, factor) = key.strip_prefix('×').map_or((key, false), |key| (key, true));
            settings.iter().find(|s| s.key == key).map(|s| (short(&s.value), factor, rest))
        });
        match found {
            Some((value, true, rest)) => out += &if value == "1" { rest.into() } else { format!("{value} {rest}") },
            Some((value, false, rest)) => out += &format!("{value}{rest}"),
            None => out += &format!("{{{part}"),
        }
    }
    out
}

/// A value for people: four digits; (x, y, z) for three numbers, [low, high] for two, products of ranges.
fn short(value: &toml::Value) -> String {
    let list = |all: &[toml::Value], between: &str| all.iter().map(short).collect::<Vec<_>>().join(between);
    match value {
        toml::Value::Float(x) if *x == 0.0 => "0".into(),
        toml::Value::Float(x) => {
            let unit = 10_f64.powi(3 - x.abs().log10().floor() as i32);
            format!("{}", (x * unit).round() / unit).replace('-', "−")
        }
        toml::Value::Integer(x) => x.to_string().replace('-', "−"),
        toml::Value::Array(all) if all.iter().all(toml::Value::is_array) => list(all, " × "),
        toml::Value::Array(all) if all.len() == 2 => format!("[{}]", list(all, ", ")),
        toml::Value::Array(all) => format!("({})", list(all, ", ")),
        toml::Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    settings! {
        struct Inner {
            tilt: f64 = 0.2 => ("rad", "largest tilt", NotNegative);
            range: [[f64; 2]; 2] = [[-1.5, 1.5], [0.0, 2.0]] => ("m", "where it begins", Ordered);
        }
    }
    settings! {
        struct Outer {
            horizon: usize = 500 => ("steps", "T", Any);
            start: Inner = Inner { tilt: 0.25, ..Inner::default() } => group;
            weight: f64 = 1.0 => ("-", "of a term", Any);
        }
    }

    #[test]
    fn a_setting_is_stated_once_and_read_listed_and_told() {
        let own = Outer::of(&"start_tilt = 1\nweight = 0.5".parse().unwrap()).unwrap();
        assert_eq!((own.horizon, own.start.tilt, own.start.range[1], own.weight), (500, 1.0, [0.0, 2.0], 0.5));
        let list = own.list();
        let keys: Vec<&str> = list.iter().map(|s| s.key.as_str()).collect();
        assert_eq!(keys, ["horizon", "start_tilt", "start_range", "weight"]);
        assert_eq!((list[1].default.as_float(), list[1].value.as_float()), (Some(0.25), Some(1.0)));
        assert_eq!(list[0].text(), "T, steps");
        let told = filled("{×weight}x, {×start_tilt}y in {start_range} m, {unknown}", &list);
        assert_eq!(told, "0.5 x, y in [−1.5, 1.5] × [0, 2] m, {unknown}");
    }

    #[test]
    fn what_a_setting_cannot_be_is_refused_with_its_key() {
        for (text, words) in [
            ("horizn = 3", "[task]: horizn: unknown field `horizn`"),
            ("horizn = 3", "Did you mean `horizon`?"),
            ("start = 3", "unknown field `start`"),
            ("horizon = 'long'", "[task]: horizon: \"long\": invalid type: string"),
            ("start_tilt = -0.1", "task.start_tilt is -0.1, but it must be ≥ 0. It is: largest tilt."),
            (
                "start_range = [[0.0, 1.0], [1.0, 0.5]]",
                "task.start_range is [[0.0, 1.0], [1.0, 0.5]], but it must be [low",
            ),
        ] {
            let error = Outer::of(&text.parse().unwrap()).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
