//! The course of a run for TensorBoard: an event file of scalars.
//!
//! ```text
//! file    = record*                     the first holds the version of the format
//! record  = length u64, crc(length), data, crc(data)              little-endian (TFRecord)
//! crc(x)  = rotate_right(CRC-32C(x), 15) + 0xa282ead8
//! data    = Event { wall_time: 1 double, step: 2 int64, file_version: 3 string, summary: 5 Summary }   (protobuf)
//! Summary = { value: 1 { tag: 1 string, simple_value: 2 float }* }
//! ```

use super::log::Line;
use base::error::{Error, Result};
use base::file_gate;
use crc::{CRC_32_ISCSI, Crc};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Name of the file: TensorBoard looks for `tfevents`.
pub(crate) const EVENTS: &str = "events.out.tfevents.omnidrones";

const VERSION: &str = "brain.Event:2";

static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);

/// The file, at its end.
#[derive(Debug)]
pub(crate) struct Events(File, PathBuf);

impl Events {
    /// The file in `folder`, cut back to whole records of updates up to `update`.
    ///
    /// # Errors
    /// [`Error::File`] if the disk refuses.
    pub fn open(folder: &Path, update: u64) -> Result<Self> {
        let path = folder.join(EVENTS);
        let bytes = file_gate::read_own(&path, file_gate::MAX_LOG)?;
        let kept: usize = records(&bytes).take_while(|data| step(data) <= update).map(|data| framed(data.len())).sum();
        let begins = kept == 0;
        if kept < bytes.len() {
            file_gate::replace(&path, &bytes[..kept])?;
        }
        let mut events = Self(file_gate::append(&path)?, path);
        if begins {
            let mut event = Vec::new();
            double(&mut event, 1, now());
            bytes_field(&mut event, 3, VERSION.as_bytes());
            events.append(&event)?;
        }
        Ok(events)
    }

    /// Adds the numbers of a line that exist: `eval_success` as `eval/success`, `time_fly` as `time/fly`, all others under
    /// `train/`.
    ///
    /// # Errors
    /// [`Error::File`] if the disk refuses.
    pub fn write(&mut self, line: &Line) -> Result<()> {
        let mut summary = Vec::new();
        for (name, x) in line.iter().filter(|(name, x)| x.is_finite() && *name != "update") {
            let mut value = Vec::new();
            bytes_field(&mut value, 1, tag(name).as_bytes());
            varint(&mut value, 2 << 3 | 5);
            value.extend((x as f32).to_le_bytes());
            bytes_field(&mut summary, 1, &value);
        }
        let mut event = Vec::new();
        double(&mut event, 1, now());
        varint(&mut event, 2 << 3);
        varint(&mut event, line.get("update").unwrap_or(0.0) as u64);
        bytes_field(&mut event, 5, &summary);
        self.append(&event)
    }

    fn append(&mut self, data: &[u8]) -> Result<()> {
        let length = (data.len() as u64).to_le_bytes();
        let record = [&length[..], &masked(&length), data, &masked(data)].concat();
        self.0.write_all(&record).map_err(|e| Error::file(&self.1, e))
    }
}

fn tag(name: &str) -> String {
    match name.split_once('_') {
        Some((group @ ("eval" | "time"), rest)) => format!("{group}/{rest}"),
        _ => format!("train/{name}"),
    }
}

fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

fn masked(data: &[u8]) -> [u8; 4] {
    CRC.checksum(data).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

fn varint(to: &mut Vec<u8>, mut x: u64) {
    while x >= 0x80 {
        to.push(x as u8 | 0x80);
        x >>= 7;
    }
    to.push(x as u8);
}

fn double(to: &mut Vec<u8>, field: u64, x: f64) {
    varint(to, field << 3 | 1);
    to.extend(x.to_le_bytes());
}

fn bytes_field(to: &mut Vec<u8>, field: u64, bytes: &[u8]) {
    varint(to, field << 3 | 2);
    varint(to, bytes.len() as u64);
    to.extend(bytes);
}

/// Bytes of a record around so many of data.
fn framed(data: usize) -> usize {
    8 + 4 + data + 4
}

/// The data of the records that are whole and have the right sums, up to the first that is not.
fn records(mut bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let (length, rest) = bytes.split_first_chunk::<8>()?;
        let (sum, rest) = rest.split_first_chunk::<4>()?;
        let n = usize::try_from(u64::from_le_bytes(*length)).ok().filter(|_| *sum == masked(length))?;
        let (data, rest) = rest.split_at_checked(n)?;
        let (sum, rest) = rest.split_first_chunk::<4>()?;
        bytes = rest;
        (*sum == masked(data)).then_some(data)
    })
}

/// The step of an event of ours, which stands behind its time; 0 where it has none.
fn step(data: &[u8]) -> u64 {
    let Some([tag, rest @ ..]) = data.get(9..) else { return 0 };
    if *tag != 2 << 3 {
        return 0;
    }
    let n = rest.iter().take_while(|byte| **byte & 0x80 != 0).count() + 1;
    rest.iter().take(n).rev().fold(0, |x, byte| x << 7 | u64::from(byte & 0x7f))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(update: u64) -> Line {
        let mut line = Line::new(update);
        line.put("loss", 0.5 * update as f64);
        line.put("eval_success", 0.25);
        line.put("return", f64::NAN);
        line
    }

    #[test]
    fn the_checksum_is_the_castagnoli_one() {
        assert_eq!(CRC.checksum(b"123456789"), 0xe306_9283); // RFC 3720, B.4 and the catalogue of Cook
    }

    #[test]
    fn records_read_back_with_their_sums_and_hold_the_numbers_that_exist() {
        let folder = tempfile::tempdir().unwrap();
        let mut events = Events::open(folder.path(), 0).unwrap();
        (1..4).for_each(|k| events.write(&line(300 * k)).unwrap());
        let bytes = std::fs::read(folder.path().join(EVENTS)).unwrap();
        let all: Vec<&[u8]> = records(&bytes).collect();
        assert_eq!(all.iter().map(|data| step(data)).collect::<Vec<_>>(), [0, 300, 600, 900]);
        assert_eq!(all.iter().map(|data| framed(data.len())).sum::<usize>(), bytes.len());
        let has = |data: &[u8], part: &[u8]| data.windows(part.len()).any(|own| own == part);
        assert!(has(all[0], VERSION.as_bytes()) && has(all[2], b"\x0a\x0atrain/loss\x15\x00\x00\x96\x43")); // 300 as f32
        assert!(has(all[1], b"eval/success\x15\x00\x00\x80\x3e") && !has(all[1], b"return"));
    }

    #[test]
    fn a_file_is_cut_back_to_an_update_and_what_is_torn_or_damaged_goes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(EVENTS);
        let steps = || records(&std::fs::read(&path).unwrap()).map(step).collect::<Vec<_>>();
        let mut events = Events::open(folder.path(), 0).unwrap();
        (1..5).for_each(|k| events.write(&line(k)).unwrap());
        Events::open(folder.path(), 3).unwrap();
        assert_eq!(steps(), [0, 1, 2, 3]);
        let mut bytes = std::fs::read(&path).unwrap();
        let n = bytes.len();
        bytes[n - 6] ^= 1;
        std::fs::write(&path, &bytes).unwrap();
        Events::open(folder.path(), 9).unwrap().write(&line(4)).unwrap();
        assert_eq!(steps(), [0, 1, 2, 4]);
        std::fs::write(&path, &bytes[..20]).unwrap();
        Events::open(folder.path(), 9).unwrap();
        assert_eq!(steps(), [0]);
    }
}
