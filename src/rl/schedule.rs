//! Numbers that change while a learner learns: rates, entropy weights, clip ranges.
//!
//! In a configuration a schedule is a bare number or a table:
//!
//! ```toml
//! entropy = 0.001
//! learning_rate = { kind = "cosine", from = 0.01, to = 1e-4, warm_up = 0.02 }
//! ```

use base::error::{Error, Result, finite};
use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// A number as a function of progress, the share of the training that is done.
///
/// With w the `warm_up` and q = (progress − w)/(1 − w) the share of what comes behind it, the number is the first one
/// times progress/w before w, hence 0 at the very start, and behind it as the kind says.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self", tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Schedule {
    /// Always `value`. Without a warm-up its text is the bare number.
    Constant {
        /// The number.
        value: f64,
        /// Share of the training, in [0, 1), in which the number rises from 0.
        #[serde(default, skip_serializing_if = "is_zero")]
        warm_up: f64,
    },
    /// from (1 − q) + to q.
    Linear {
        /// First number.
        from: f64,
        /// Last number.
        to: f64,
        /// Share of the training, in [0, 1), in which the number rises from 0.
        #[serde(default, skip_serializing_if = "is_zero")]
        warm_up: f64,
    },
    /// Half a wave, flat at both ends (Loshchilov and Hutter 2017): linear in (1 − cos πq)/2.
    Cosine {
        /// First number.
        from: f64,
        /// Last number.
        to: f64,
        /// Share of the training, in [0, 1), in which the number rises from 0.
        #[serde(default, skip_serializing_if = "is_zero")]
        warm_up: f64,
    },
    /// from^(1 − q) to^q: the same factor in equal times. Both above 0.
    Exponential {
        /// First number.
        from: f64,
        /// Last number.
        to: f64,
        /// Share of the training, in [0, 1), in which the number rises from 0.
        #[serde(default, skip_serializing_if = "is_zero")]
        warm_up: f64,
    },
}

impl Schedule {
    /// Half a cosine from one number to another, without a warm-up.
    pub const fn cosine(from: f64, to: f64) -> Self {
        Self::Cosine { from, to, warm_up: 0.0 }
    }

    /// Always `value`.
    pub const fn constant(value: f64) -> Self {
        Self::Constant { value, warm_up: 0.0 }
    }

    /// The number at a progress in [0, 1]. Outside it is that of the nearer end; for NaN that of the start.
    pub fn at(&self, progress: f64) -> f64 {
        let progress = if progress.is_nan() { 0.0 } else { progress.clamp(0.0, 1.0) };
        let (first, _, warm_up) = self.parts();
        if progress < warm_up {
            return first * progress / warm_up;
        }
        let q = (progress - warm_up) / (1.0 - warm_up);
        match *self {
            Self::Constant { value, .. } => value,
            Self::Linear { from, to, .. } => between(from, to, q),
            Self::Cosine { from, to, .. } => between(from, to, 0.5 * (1.0 - (std::f64::consts::PI * q).cos())),
            Self::Exponential { from, to, .. } => from.powf(1.0 - q) * to.powf(q),
        }
    }

    /// Checks every number; `what` is the setting's name in the message.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers that are not finite, ends of an exponential that are not positive, and a warm-up
    /// outside [0, 1).
    pub fn validate(&self, what: &str) -> Result<()> {
        let (first, last, warm_up) = self.parts();
        let names = if matches!(self, Self::Constant { .. }) { ["value"; 2] } else { ["from", "to"] };
        for (name, x) in names.into_iter().zip([first, last]) {
            finite(&format!("{what}: {name}"), &[x])?;
            if matches!(self, Self::Exponential { .. }) && x <= 0.0 {
                let remedy = "Use kind = 'linear' or 'cosine' to reach 0.";
                return Err(Error::value(format!("{what}: {name}"), x, "> 0 of an exponential schedule", remedy));
            }
        }
        if !(0.0..1.0).contains(&warm_up) {
            let remedy = "It is a share of the training: 0.02 is its first fiftieth.";
            return Err(Error::value(format!("{what}: warm_up"), warm_up, "in [0, 1)", remedy));
        }
        Ok(())
    }

    /// First number behind the warm-up, and last number: all others lie between 0 and these.
    pub(crate) fn ends(&self) -> [f64; 2] {
        let (first, last, _) = self.parts();
        [first, last]
    }

    /// First number behind the warm-up, last number, warm-up.
    fn parts(&self) -> (f64, f64, f64) {
        match *self {
            Self::Constant { value, warm_up } => (value, value, warm_up),
            Self::Linear { from, to, warm_up }
            | Self::Cosine { from, to, warm_up }
            | Self::Exponential { from, to, warm_up } => (from, to, warm_up),
        }
    }
}

/// `from` at s = 0 and `to` at s = 1, to the bit.
fn between(from: f64, to: f64, s: f64) -> f64 {
    from * (1.0 - s) + to * s
}

fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

impl From<f64> for Schedule {
    fn from(value: f64) -> Self {
        Self::constant(value)
    }
}

impl Serialize for Schedule {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        match self {
            Self::Constant { value, warm_up: 0.0 } => serializer.serialize_f64(*value),
            _ => Self::serialize(self, serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Schedule {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        deserializer.deserialize_any(NumberOrTable)
    }
}

/// An untagged enum would only say that no variant matched.
struct NumberOrTable;

impl<'de> Visitor<'de> for NumberOrTable {
    type Value = Schedule;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number or a table such as { kind = \"linear\", from = 1e-3, to = 0 }")
    }

    fn visit_f64<E>(self, value: f64) -> std::result::Result<Schedule, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> std::result::Result<Schedule, E> {
        Ok((value as f64).into())
    }

    fn visit_u64<E>(self, value: u64) -> std::result::Result<Schedule, E> {
        Ok((value as f64).into())
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> std::result::Result<Schedule, A::Error> {
        // the derived function of `remote = "Self"`, which knows tables only
        Schedule::deserialize(MapAccessDeserializer::new(map))
    }
}
