//! Arrays by name in one file, as NumPy reads them: a zip of `.npy` (format 1.0), compressed.

use omnidrones::error::{Error, Result};
use omnidrones::internals;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// A number of an array.
pub trait Number: Copy {
    /// As NumPy names it.
    const KIND: &str;
    /// The lowest byte first.
    fn write(self, to: &mut Vec<u8>);
}

macro_rules! numbers {
    ($($kind:ty: $name:literal),*) => {$(
        impl Number for $kind {
            const KIND: &str = $name;
            fn write(self, to: &mut Vec<u8>) {
                to.extend(self.to_le_bytes());
            }
        }
    )*};
}
numbers!(f32: "<f4", f64: "<f8", i64: "<i8");

impl Number for bool {
    const KIND: &str = "|b1";
    fn write(self, to: &mut Vec<u8>) {
        to.push(self.into());
    }
}

/// A file that is being filled.
pub struct Npz<'a> {
    zip: ZipWriter<BufWriter<&'a mut File>>,
    path: &'a Path,
}

impl Npz<'_> {
    /// Fills a file of a folder of ours, which appears whole or not at all.
    pub fn write(path: &Path, fill: impl FnOnce(&mut Npz<'_>) -> Result<()>) -> Result<()> {
        internals::replace_with(path, |file| {
            let mut own = Npz { zip: ZipWriter::new(BufWriter::new(file)), path };
            fill(&mut own)?;
            let end = own.zip.finish().map_err(|error| Error::file(path, error.into()))?;
            end.into_inner().map(drop).map_err(|error| Error::file(path, error.into_error()))
        })
    }

    /// Numbers, row-major; of shape `[]` a single one.
    pub fn numbers<T: Number>(&mut self, name: &str, shape: &[usize], values: &[T]) -> Result<()> {
        debug_assert_eq!(shape.iter().product::<usize>(), values.len(), "{name}");
        let mut bytes = Vec::with_capacity(std::mem::size_of_val(values));
        values.iter().for_each(|value| value.write(&mut bytes));
        self.array(name, T::KIND, shape, &bytes)
    }

    /// Texts; of shape `[]` a single one.
    pub fn texts<S: AsRef<str>>(&mut self, name: &str, shape: &[usize], texts: &[S]) -> Result<()> {
        let width = texts.iter().map(|text| text.as_ref().chars().count()).max().unwrap_or(0).max(1);
        let mut bytes = Vec::with_capacity(4 * width * texts.len());
        for text in texts {
            let letters = text.as_ref().chars().map(u32::from).chain(std::iter::repeat(0)).take(width);
            letters.for_each(|letter| bytes.extend(letter.to_le_bytes()));
        }
        self.array(name, &format!("<U{width}"), shape, &bytes)
    }

    fn array(&mut self, name: &str, kind: &str, shape: &[usize], bytes: &[u8]) -> Result<()> {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(1))
            .large_file(bytes.len() > u32::MAX as usize / 2);
        self.zip.start_file(format!("{name}.npy"), options).map_err(|error| Error::file(self.path, error.into()))?;
        let written = self.zip.write_all(&header(kind, shape)).and_then(|()| self.zip.write_all(bytes));
        written.map_err(|error| Error::file(self.path, error))
    }
}

/// Magic, version, length, and a Python dict that ends with a line at a multiple of 64 bytes.
fn header(kind: &str, shape: &[usize]) -> Vec<u8> {
    let sizes: String = shape.iter().map(|n| format!("{n},")).collect();
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({sizes}), }}");
    let padding = (64 - (10 + text.len() + 1) % 64) % 64;
    text.extend(std::iter::repeat_n(' ', padding));
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_ends_where_arrays_are_aligned() {
        for (kind, shape, said) in [("<f4", &[3, 2][..], "(3,2,)"), ("<U7", &[4], "(4,)"), ("|b1", &[], "()")] {
            let bytes = header(kind, shape);
            assert!(bytes.len().is_multiple_of(64) && bytes.ends_with(b"\n"), "{}", bytes.len());
            assert_eq!(usize::from(u16::from_le_bytes([bytes[8], bytes[9]])), bytes.len() - 10);
            let text = std::str::from_utf8(&bytes[10..]).unwrap();
            assert!(
                text.contains(&format!("'descr': '{kind}'")) && text.contains(&format!("'shape': {said}")),
                "{text}"
            );
        }
    }
}
