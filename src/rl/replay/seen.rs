//! What was seen, row by row: as numbers, or images and beams as bytes.
//!
//! A byte stands for low + k (high − low)/255 within the bounds of its field: off by at most half a step, 0.2 % of the range, for a
//! quarter of the memory (as Mnih et al. 2015 keep their frames).

use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use tasks::{Field, ObservationTransform, Spec};

/// How images and the beams of lidars are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// As they are.
    #[default]
    F32,
    /// In 256 steps between the bounds of their field; a pixel that is not a number is its least.
    U8,
}

/// Which numbers of an agent's observation are bytes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ReplayCode {
    /// Columns, and the value of 0 and of a step.
    fields: Vec<(Range<usize>, f32, f32)>,
    /// Numbers of an agent's observation in all.
    n: usize,
}

impl ReplayCode {
    /// For `n` numbers of an agent, all as they are.
    pub fn plain(n: usize) -> Self {
        Self { fields: Vec::new(), n }
    }

    /// For what environments show.
    ///
    /// # Errors
    /// [`Error::Value`] for bytes where nothing is an image or a lidar, where one has no bounds, and behind a stage `normalise`,
    /// which has others.
    pub fn of(spec: &Spec, precision: Precision) -> Result<Self> {
        let n = spec.n_observation;
        if precision == Precision::F32 {
            return Ok(Self::plain(n));
        }
        let refuse = |limit: &str, remedy: &str| Err(Error::value("replay.images", "u8", limit, remedy));
        if spec.config.observation.iter().any(|stage| matches!(stage, ObservationTransform::Normalise { .. })) {
            return refuse(
                "f32 for normalised observations",
                "Set normalise_observation = false in the table of the algorithm.",
            );
        }
        let (mut first, mut fields) = (0, Vec::new());
        for field in &spec.observation {
            let columns = first..first + field.size;
            first = columns.end;
            if field.is_of_rays() {
                let Field { low, high, .. } = field;
                if !(low.is_finite() && high.is_finite() && low < high) {
                    return refuse("f32 for an image without bounds", "Leave noise off images, or keep them as f32.");
                }
                fields.push((columns, *low as f32, ((high - low) / 255.0) as f32));
            }
        }
        if fields.is_empty() {
            return refuse("f32 where no image or lidar is seen", "Leave it out, or add a sensor that makes images.");
        }
        Ok(Self { fields, n })
    }

    fn n_byte(&self) -> usize {
        self.fields.iter().map(|(columns, ..)| columns.len()).sum()
    }

    fn n_float(&self) -> usize {
        self.n - self.n_byte()
    }

    /// Bytes of an agent's observation.
    pub fn bytes(&self) -> usize {
        4 * self.n_float() + self.n_byte()
    }

    /// Columns that stay numbers.
    fn plain_columns(&self) -> impl Iterator<Item = Range<usize>> {
        let ends = self.fields.iter().map(|(columns, ..)| columns.start).chain([self.n]);
        let starts = [0].into_iter().chain(self.fields.iter().map(|(columns, ..)| columns.end));
        starts.zip(ends).map(|(a, b)| a..b)
    }
}

/// Observations of agents, one after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    code: ReplayCode,
    pub(super) floats: Vec<f32>,
    pub(super) bytes: Vec<u8>,
}

impl Seen {
    /// Of `rows` agents, all zeros.
    pub fn new(code: ReplayCode, rows: usize) -> Self {
        Self { floats: vec![0.0; rows * code.n_float()], bytes: vec![0; rows * code.n_byte()], code }
    }

    /// Keeps observations `[_, n]` from row `first` on.
    pub fn put(&mut self, first: usize, seen: &[f32]) {
        let ReplayCode { fields, n } = &self.code;
        if fields.is_empty() {
            return self.floats[first * n..][..seen.len()].copy_from_slice(seen);
        }
        let (n_float, n_byte) = (self.code.n_float(), self.code.n_byte());
        for (k, row) in seen.chunks_exact(*n).enumerate() {
            let (mut at_float, mut at_byte) = ((first + k) * n_float, (first + k) * n_byte);
            for columns in self.code.plain_columns() {
                self.floats[at_float..][..columns.len()].copy_from_slice(&row[columns.clone()]);
                at_float += columns.len();
            }
            for (columns, low, step) in fields {
                // what is not a number is the least
                let coded = row[columns.clone()].iter().map(|x| ((x - low) / step).round() as u8);
                self.bytes[at_byte..][..columns.len()].iter_mut().zip(coded).for_each(|(to, x)| *to = x);
                at_byte += columns.len();
            }
        }
    }

    /// Writes as many rows from `first` on as there is room for.
    pub fn get(&self, first: usize, to: &mut [f32]) {
        let ReplayCode { fields, n } = &self.code;
        if fields.is_empty() {
            return to.copy_from_slice(&self.floats[first * n..][..to.len()]);
        }
        let (n_float, n_byte) = (self.code.n_float(), self.code.n_byte());
        for (k, row) in to.chunks_exact_mut(*n).enumerate() {
            let (mut at_float, mut at_byte) = ((first + k) * n_float, (first + k) * n_byte);
            for columns in self.code.plain_columns() {
                let own = &self.floats[at_float..][..columns.len()];
                at_float += own.len();
                row[columns].copy_from_slice(own);
            }
            for (columns, low, step) in fields {
                let own = &self.bytes[at_byte..][..columns.len()];
                at_byte += own.len();
                row[columns.clone()].iter_mut().zip(own).for_each(|(x, k)| *x = low + f32::from(*k) * step);
            }
        }
    }

    /// Changes every row, where all are numbers.
    pub fn each(&mut self, change: impl FnMut(&mut [f32])) {
        if self.code.fields.is_empty() {
            self.floats.chunks_exact_mut(self.code.n).for_each(change);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tasks::{Env, EnvConfig};

    #[test]
    fn bytes_are_off_by_half_a_step_and_the_rest_is_as_it_was() {
        let code = ReplayCode { fields: vec![(1..3, 0.0, 1.0 / 255.0), (4..5, -2.0, 4.0 / 255.0)], n: 6 };
        assert_eq!((code.bytes(), ReplayCode::plain(6).bytes()), (4 * 3 + 3, 24));
        let mut seen = Seen::new(code, 3);
        let rows = [1e3, 0.3, 1.0, -7.5, 1.99, f32::NAN, 0.0, 5.0, f32::NAN, 0.25, -9.0, 3.0];
        seen.put(1, &rows);
        let mut back = [0.0; 12];
        seen.get(1, &mut back);
        let wanted = [1e3, 0.3, 1.0, -7.5, 1.99, f32::NAN, 0.0, 1.0, 0.0, 0.25, -2.0, 3.0];
        for (k, (got, wanted)) in back.iter().zip(wanted).enumerate() {
            let half = match k % 6 {
                1 | 2 => 0.5 / 255.0,
                4 => 2.0 / 255.0,
                _ => 0.0,
            };
            assert!((got - wanted).abs() <= half + 1e-6 || got.is_nan() && wanted.is_nan(), "{k}: {got} {wanted}");
        }
        seen.get(0, &mut back[..6]);
        assert_eq!(back[..6], [0.0, 0.0, 0.0, 0.0, -2.0, 0.0], "nothing was kept there");
    }

    #[test]
    fn what_bytes_cannot_hold_is_refused_with_the_remedy() {
        let told = |text: &str| {
            let config = EnvConfig { n_env: 1, ..EnvConfig::from_toml(text, "test").unwrap() };
            ReplayCode::of(Env::make("Hover", &config).unwrap().spec(), Precision::U8).map_err(|e| e.to_string())
        };
        assert!(told("").unwrap_err().contains("no image or lidar"));
        assert!(told("observation = [{ kind = 'normalise' }]").unwrap_err().contains("normalise_observation = false"));
    }
}
