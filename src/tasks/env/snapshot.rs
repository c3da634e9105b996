//! The exact state of all environments as bytes.

use super::block::{EnvBlock, episode_state};
use super::{Env, spec};
use crate::config::EnvConfig;
use autodiff::lanes::first_lanes;
use autodiff::program::BLOCK;
use base::error::{Error, Result};

const MAGIC: [u8; 8] = *b"omnienv5";
/// What stands before the number of the format.
const NAME: &[u8] = b"omnienv";

impl Env {
    /// The exact state of all environments: physics, goals, episodes, random streams, transforms, statistics. Continuing
    /// from it gives the same bits, in this environment or in a fresh one of the same configuration.
    pub fn save(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.saved_len());
        bytes.extend(MAGIC);
        bytes.extend(self.fingerprint().to_le_bytes());
        for block in &self.blocks {
            block.all_rows().flatten().for_each(|x| bytes.extend(x.to_le_bytes()));
            block.seed.iter().chain(&block.episode).chain([&block.started]).for_each(|x| bytes.extend(x.to_le_bytes()));
            bytes.extend(block.count.to_le_bytes());
            block.sums.iter().flatten().for_each(|x| bytes.extend(x.to_le_bytes()));
            for set in block.sensors.iter().flat_map(|own| &own.sets) {
                let mut saved = vec![0.0; set.n_saved()];
                set.save(&mut saved);
                saved.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
            }
            if let (Some(setup), Some(own)) = (&self.core.estimating, &block.estimates) {
                let mut saved = vec![0.0; setup.n_saved()];
                for lane in 0..block.plant.occupied {
                    own.save(lane, &mut saved);
                    saved.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
                }
            }
        }
        bytes.extend(self.core.difficulty.to_le_bytes());
        bytes.extend(u64::from(self.core.collects).to_le_bytes());
        let s = &self.core.statistics;
        s.mean.iter().chain(&s.variance).chain([&s.count]).for_each(|x| bytes.extend(x.to_le_bytes()));
        bytes.extend(spec::fnv(&bytes).to_le_bytes());
        bytes
    }

    /// Continues from [`Env::save`]d bytes of an environment with the same configuration, but for [`EnvConfig::info`]: sums that were
    /// left out there are not those of the episode.
    ///
    /// # Errors
    /// [`Error::Format`] for bytes of another configuration or that were damaged, and for numbers that are not finite;
    /// [`Error::Value`] for counters of sensors that are none. Nothing is changed then.
    pub fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let refuse = |rule: &str, remedy: &str| Err(refused("the bytes", rule, remedy));
        let wanted = self.saved_len();
        if let Some([format @ b'0'..=b'9', ..]) =
            bytes.strip_prefix(NAME).filter(|rest| rest.first() != Some(&MAGIC[7]))
        {
            let (format, own) = (char::from(*format), char::from(MAGIC[7]));
            let rule = format!("are of format {format} of another version, and this one reads format {own}");
            return refuse(&rule, "Go on with the version that saved them, or begin anew.");
        }
        if bytes.len() != wanted || bytes[..8] != MAGIC || bytes[8..16] != self.fingerprint().to_le_bytes() {
            return refuse("are not of this configuration", "Build the environment as it was when it was saved.");
        }
        let (body, sum) = bytes.split_at(wanted - 8);
        if sum != spec::fnv(body).to_le_bytes() {
            return refuse("were damaged", "Use another copy.");
        }
        self.check_saved(Words(&body[16..]))?;
        let mut words = Words(&body[16..]);
        for (i, block) in self.blocks.iter_mut().enumerate() {
            block.all_rows_mut().flatten().for_each(|x| *x = f32::from_le_bytes(words.take()));
            block.seed.iter_mut().chain(&mut block.episode).for_each(|x| *x = u64::from_le_bytes(words.take()));
            block.started = u64::from_le_bytes(words.take()) & first_lanes(self.spec.n_env - i * BLOCK);
            block.moved = u64::MAX;
            block.references.fill(None);
            block.count = f64::from_le_bytes(words.take());
            block.sums.iter_mut().flatten().for_each(|x| *x = f64::from_le_bytes(words.take()));
            for set in block.sensors.iter_mut().flat_map(|own| &mut own.sets) {
                let saved: Vec<f64> = (0..set.n_saved()).map(|_| f64::from_le_bytes(words.take())).collect();
                set.restore(&saved)?;
            }
            if let (Some(setup), Some(own)) = (&self.core.estimating, &mut block.estimates) {
                for lane in 0..block.plant.occupied {
                    let saved: Vec<f64> = (0..setup.n_saved()).map(|_| f64::from_le_bytes(words.take())).collect();
                    own.restore(lane, &saved)?;
                }
            }
        }
        self.core.difficulty = f64::from_le_bytes(words.take());
        self.core.collects = u64::from_le_bytes(words.take()) != 0;
        let mut s = self.core.statistics.clone();
        s.mean.iter_mut().chain(&mut s.variance).for_each(|x| *x = f64::from_le_bytes(words.take()));
        s.count = f64::from_le_bytes(words.take());
        self.freeze(s);
        self.look_around();
        Ok(())
    }

    /// Checks all that [`Env::load`] could refuse, before anything is changed.
    fn check_saved(&self, mut words: Words<'_>) -> Result<()> {
        for (i, block) in self.blocks.iter().enumerate() {
            // an event that never comes is infinitely far away
            let event = block.plant.rows.iter().count()
                + block.plant.numbers.as_ref().map_or(0, |rows| rows.len())
                + episode_state::EVENT;
            for row in 0..block.all_rows().count() {
                for lane in 0..BLOCK {
                    let x = f32::from_le_bytes(words.take());
                    let fits = x.is_finite() || row == event && x == f32::INFINITY;
                    check(fits, x, || format!("environment {}, row {row}", i * BLOCK + lane))?;
                }
            }
            // seeds, episodes, which are started
            for _ in 0..2 * BLOCK + 1 {
                words.take::<8>();
            }
            let statistics = || format!("statistics of environments {} and more", i * BLOCK);
            words.not_negative(statistics)?;
            for _ in &block.sums {
                words.finite(statistics)?;
                words.not_negative(statistics)?;
            }
            // all sets have the same settings
            let mut sets = block.sensors.first().map_or_else(Vec::new, |own| own.sets.clone());
            for lane in 0..block.sensors.len() {
                for set in &mut sets {
                    let what = || format!("sensors of environment {}", i * BLOCK + lane);
                    let saved = (0..set.n_saved()).map(|_| words.shown(what)).collect::<Result<Vec<f64>>>()?;
                    set.restore(&saved)?;
                }
            }
            if let (Some(setup), Some(own)) = (&self.core.estimating, &block.estimates) {
                let mut own = own.clone();
                for lane in 0..block.plant.occupied {
                    let what = || format!("estimate of environment {}", i * BLOCK + lane);
                    let saved = (0..setup.n_saved()).map(|_| words.finite(what)).collect::<Result<Vec<f64>>>()?;
                    own.restore(lane, &saved)?;
                }
            }
        }
        let difficulty = words.finite(|| "difficulty".into())?;
        check((0.0..=1.0).contains(&difficulty), difficulty, || "difficulty".into())?;
        words.take::<8>();
        let s = &self.core.statistics;
        let statistics = || "statistics of observations".to_string();
        for _ in &s.mean {
            words.finite(statistics)?;
        }
        // variances and how many there were
        (0..=s.variance.len()).try_for_each(|_| words.not_negative(statistics))
    }

    /// Bytes of a saved state: every block has the same rows.
    fn saved_len(&self) -> usize {
        let of_block = |block: &EnvBlock| {
            let rows = block.all_rows().count() * size_of::<[f32; BLOCK]>();
            rows + (2 * BLOCK + 2 + 2 * block.sums.len()) * size_of::<u64>()
        };
        let blocks = self.blocks.first().map_or(0, of_block) * self.blocks.len();
        let of_environment = self.core.sensing.as_ref().map_or(0, |own| own.n_saved())
            + self.core.estimating.as_ref().map_or(0, |own| own.n_saved());
        let sensors = of_environment * self.spec.n_env;
        // magic, fingerprint; difficulty, whether it collects, statistics, sum
        16 + blocks + (sensors + 2 * self.core.sizes.normalised + 4) * size_of::<u64>()
    }

    /// Of everything that decides what saved numbers mean.
    fn fingerprint(&self) -> u64 {
        let config = EnvConfig { seed: 0, info: None, ..self.spec.config.clone() };
        spec::fnv(serde_json::to_string(&(&self.spec.task, config)).unwrap_or_default().as_bytes())
    }
}

/// Bytes that are read from their beginning; zeros behind their end.
struct Words<'a>(&'a [u8]);

fn refused(place: &str, rule: &str, remedy: &str) -> Error {
    let (file, place) = ("<saved environment>".into(), place.into());
    Error::Format { file, place, rule: rule.into(), remedy: remedy.into() }
}

/// Refuses a number unless it fits there.
fn check(fits: bool, x: impl std::fmt::Display, place: impl FnOnce() -> String) -> Result<()> {
    if fits {
        Ok(())
    } else {
        Err(refused(&place(), &format!("{x} is no number that can be there"), "Use another copy."))
    }
}

impl Words<'_> {
    fn finite(&mut self, place: impl FnOnce() -> String) -> Result<f64> {
        let x = f64::from_le_bytes(self.take());
        check(x.is_finite(), x, place).map(|()| x)
    }

    /// A number that observations can show, which are in `f32`.
    fn shown(&mut self, place: impl FnOnce() -> String) -> Result<f64> {
        let x = f64::from_le_bytes(self.take());
        check(x.abs() <= f64::from(f32::MAX), x, place).map(|()| x)
    }

    fn not_negative(&mut self, place: impl FnOnce() -> String) -> Result<()> {
        let x = f64::from_le_bytes(self.take());
        check(x.is_finite() && x >= 0.0, x, place)
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        let Some((word, rest)) = self.0.split_first_chunk() else {
            return [0; N];
        };
        self.0 = rest;
        *word
    }
}
