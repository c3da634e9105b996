//! Tensors in a file of the safetensors format: an 8-byte length, a JSON header, the numbers one after the other.
//!
//! Both directions stream through one buffer, so a checkpoint needs no second copy in memory, and hash what they pass.

use super::disk::{Disk, Entry, Sink, hex};
use super::tensor::{Data, TensorElement, Tensors, codec::Codec};
use super::{MAX_HEADER, damaged, open};
use base::error::{Error, Result};
use safetensors::tensor::{Dtype, Metadata, TensorInfo};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Bytes of the buffer.
const CHUNK: usize = 1 << 16;

/// A file to be: its header, and the tensors in their order.
pub(super) struct Layout<'a> {
    header: Vec<u8>,
    order: Vec<&'a Data>,
    /// Length of the file.
    pub bytes: u64,
}

impl<'a> Layout<'a> {
    /// Tensors by falling alignment, then by name, as other writers of the format order them.
    ///
    /// # Errors
    /// [`Error::Limit`] if the header would be too long to be read again.
    pub fn new(tensors: &'a Tensors, path: &Path) -> Result<Self> {
        let mut order: Vec<_> = tensors.iter().map(|(name, t)| (dtype(t.data()), name, t)).collect();
        order.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(b.1)));
        let mut end = 0;
        let infos = order.iter().map(|(dtype, name, t)| {
            let start = end;
            end += n_byte(t.data());
            (name.to_string(), TensorInfo { dtype: *dtype, shape: t.shape().to_vec(), data_offsets: (start, end) })
        });
        let infos = infos.collect();
        let metadata = Metadata::new(None, infos).map_err(|e| damaged(path, "the tensors", e.to_string()))?;
        let mut header = serde_json::to_vec(&metadata).map_err(|e| damaged(path, "the header", e.to_string()))?;
        header.resize(header.len().next_multiple_of(8), b' ');
        if header.len() as u64 > MAX_HEADER {
            let what = format!("{}: length of the header", path.display());
            return Err(Error::limit(what, header.len(), MAX_HEADER, "Save fewer tensors, or with shorter names."));
        }
        let bytes = 8 + header.len() as u64 + end as u64;
        Ok(Self { header, order: order.into_iter().map(|(_, _, t)| t.data()).collect(), bytes })
    }

    /// Writes the file.
    pub fn write(&self, path: &Path, disk: &Disk) -> Result<Entry> {
        let mut sink = disk.create(path)?;
        sink.write(&(self.header.len() as u64).to_le_bytes())?;
        sink.write(&self.header)?;
        let mut buffer = Vec::with_capacity(CHUNK);
        for data in &self.order {
            match data {
                Data::F32(values) => write_values(&mut sink, values, &mut buffer)?,
                Data::F64(values) => write_values(&mut sink, values, &mut buffer)?,
                Data::U64(values) => write_values(&mut sink, values, &mut buffer)?,
                Data::Bytes(values) => write_values(&mut sink, values, &mut buffer)?,
            }
        }
        sink.finish()
    }
}

fn write_values<T: Codec>(sink: &mut Sink<'_>, values: &[T], buffer: &mut Vec<u8>) -> Result<()> {
    for part in values.chunks(CHUNK / size_of::<T>()) {
        buffer.clear();
        T::encode(part, buffer);
        sink.write(buffer)?;
    }
    Ok(())
}

fn dtype(data: &Data) -> Dtype {
    match data {
        Data::F32(_) => Dtype::F32,
        Data::F64(_) => Dtype::F64,
        Data::U64(_) => Dtype::U64,
        Data::Bytes(_) => Dtype::U8,
    }
}

fn n_byte(data: &Data) -> usize {
    match data {
        Data::F32(values) => size_of_val(&values[..]),
        Data::F64(values) => size_of_val(&values[..]),
        Data::U64(values) => size_of_val(&values[..]),
        Data::Bytes(values) => values.len(),
    }
}

/// The tensors that `wanted` names of a file whose length and hash are those of `entry`; what is not wanted is read past. Nothing is
/// handed out before the hash is known to be right, and nothing is allocated that the file does not hold.
///
/// # Errors
/// [`Error::File`] if it cannot be read, [`Error::Limit`] for a header beyond the limit, [`Error::Format`] if it is not
/// what the entry says, or its tensors leave holes, overlap or are of other kinds.
pub(super) fn read(path: &Path, entry: &Entry, wanted: &dyn Fn(&str) -> bool) -> Result<Tensors> {
    let (file, length) = open(path)?;
    if length != entry.bytes {
        let rule = format!("{length} bytes, but the manifest says {}", entry.bytes);
        return Err(damaged(path, "the length", rule));
    }
    let mut source = Source { path: path.to_path_buf(), file, left: length, hash: Sha256::new() };
    let metadata = source.header()?;
    let mut tensors = Tensors::new();
    for name in metadata.offset_keys() {
        let Some(info) = metadata.info(&name) else { continue };
        if !wanted(&name) {
            source.pass(info)?;
            continue;
        }
        match info.dtype {
            Dtype::F32 => source.tensor::<f32>(name, info, &mut tensors)?,
            Dtype::F64 => source.tensor::<f64>(name, info, &mut tensors)?,
            Dtype::U64 => source.tensor::<u64>(name, info, &mut tensors)?,
            Dtype::U8 => source.tensor::<u8>(name, info, &mut tensors)?,
            other => return Err(damaged(path, format!("tensor {name}"), format!("no number is of type {other}"))),
        }
    }
    if hex(&source.hash.finalize()) != entry.sha256 {
        return Err(damaged(path, "the whole file", "its SHA-256 is not the one in the manifest"));
    }
    Ok(tensors)
}

/// A file being read, what is left of it and the hash so far.
struct Source {
    path: PathBuf,
    file: File,
    left: u64,
    hash: Sha256,
}

impl Source {
    fn fill(&mut self, buffer: &mut [u8]) -> Result<()> {
        let left = self.left.checked_sub(buffer.len() as u64);
        self.left = left.ok_or_else(|| damaged(&self.path, "the end", "it comes too early"))?;
        self.file.read_exact(buffer).map_err(|e| Error::file(&self.path, e))?;
        self.hash.update(buffer);
        Ok(())
    }

    /// The header, whose tensors cover the rest of the file.
    fn header(&mut self) -> Result<Metadata> {
        let mut length = [0; 8];
        self.fill(&mut length)?;
        let length = u64::from_le_bytes(length);
        if length > MAX_HEADER.min(self.left) {
            let what = format!("{}: length of the header", self.path.display());
            let remedy = "The file is damaged or foreign: load another checkpoint.";
            return Err(Error::limit(what, length, MAX_HEADER.min(self.left), remedy));
        }
        let mut header = vec![0; length as usize];
        self.fill(&mut header)?;
        let metadata: Metadata =
            serde_json::from_slice(&header).map_err(|e| damaged(&self.path, "the header", e.to_string()))?;
        let covered = metadata.data_len() as u64;
        if covered != self.left {
            let rule = format!("its tensors cover {covered} bytes, and {} follow", self.left);
            return Err(damaged(&self.path, "the header", rule));
        }
        Ok(metadata)
    }

    /// Reads the next `left` bytes, a part after the other.
    fn parts(&mut self, mut left: usize, mut each: impl FnMut(&[u8])) -> Result<()> {
        let mut buffer = vec![0; CHUNK.min(left)];
        while left > 0 {
            let part = &mut buffer[..left.min(CHUNK)];
            self.fill(part)?;
            each(part);
            left -= part.len();
        }
        Ok(())
    }

    /// Reads past the next tensor of the file.
    fn pass(&mut self, info: &TensorInfo) -> Result<()> {
        self.parts(bytes(info), |_| ())
    }

    /// The next tensor of the file.
    fn tensor<T: TensorElement>(&mut self, name: String, info: &TensorInfo, tensors: &mut Tensors) -> Result<()> {
        let n = bytes(info) / size_of::<T>();
        let mut values: Vec<T> = Vec::new();
        if values.try_reserve_exact(n).is_err() {
            let what = format!("{}: numbers of tensor {name}", self.path.display());
            return Err(Error::limit(what, n, "the free memory", "Free some, or load on a larger machine."));
        }
        self.parts(n * size_of::<T>(), |part| T::decode(part, &mut values))?;
        tensors.insert(name, &info.shape, values)
    }
}

/// What a tensor takes of a file.
fn bytes(info: &TensorInfo) -> usize {
    info.data_offsets.1.saturating_sub(info.data_offsets.0)
}

#[cfg(test)]
mod tests {
    use super::super::tests::sample;
    use super::*;
    use safetensors::tensor::TensorView;
    use std::time::Instant;

    /// A file with this header and `n` bytes of numbers, and its true entry.
    fn forged(folder: &Path, length: u64, header: &str, n: usize) -> (PathBuf, Entry) {
        let bytes = [&length.to_le_bytes(), header.as_bytes(), &vec![7; n]].concat();
        let path = folder.join("forged.safetensors");
        std::fs::write(&path, &bytes).unwrap();
        (path, Entry { bytes: bytes.len() as u64, sha256: hex(&Sha256::digest(&bytes)) })
    }

    #[test]
    fn files_are_those_of_the_reference_writer_and_its_reader_reads_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        let state = sample(1, 50).state;
        let entry = Layout::new(&state, &path).unwrap().write(&path, &Disk::default()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let encoded: Vec<(&str, Dtype, Vec<usize>, Vec<u8>)> = state
            .iter()
            .map(|(name, tensor)| {
                let mut raw = Vec::new();
                match tensor.data() {
                    Data::F32(values) => f32::encode(values, &mut raw),
                    Data::F64(values) => f64::encode(values, &mut raw),
                    Data::U64(values) => u64::encode(values, &mut raw),
                    Data::Bytes(values) => u8::encode(values, &mut raw),
                }
                (name, dtype(tensor.data()), tensor.shape().to_vec(), raw)
            })
            .collect();
        let views = encoded
            .iter()
            .map(|(name, dtype, shape, raw)| (*name, TensorView::new(*dtype, shape.clone(), raw).unwrap()));
        assert!(safetensors::serialize(views, None).unwrap() == bytes);
        let theirs = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        for (name, dtype, shape, raw) in &encoded {
            let tensor = theirs.tensor(name).unwrap();
            assert_eq!((tensor.dtype(), tensor.shape(), tensor.data()), (*dtype, &shape[..], &raw[..]));
        }
        assert_eq!((entry.bytes, entry.sha256), (bytes.len() as u64, hex(&Sha256::digest(&bytes))));
    }

    #[test]
    fn hashes_are_those_of_the_standard() {
        // FIPS 180-4 example: the one-block message "abc"
        let wanted = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(hex(&Sha256::digest(b"abc")), wanted);
    }

    #[test]
    fn a_forged_header_is_refused_though_its_hash_is_right() {
        let folder = tempfile::tempdir().unwrap();
        let one = |dtype: &str, shape: &str, offsets: &str| {
            format!(r#"{{"a":{{"dtype":"{dtype}","shape":{shape},"data_offsets":{offsets}}}}}"#)
        };
        let two = |a: &str, b: &str| {
            let info = r#""dtype":"U8","shape":[4],"data_offsets""#;
            format!(r#"{{"a":{{{info}:{a}}},"b":{{{info}:{b}}}}}"#)
        };
        let cases = [
            ("sound", one("U8", "[8]", "[0,8]"), 8, ""),
            ("sound", two("[4,8]", "[0,4]"), 8, ""),
            ("a hole", two("[0,4]", "[5,9]"), 9, "invalid offset"),
            ("a hole at the start", one("U8", "[4]", "[4,8]"), 8, "invalid offset"),
            ("overlap", two("[0,4]", "[3,7]"), 7, "invalid offset"),
            ("the same place twice", two("[0,4]", "[0,4]"), 4, "invalid offset"),
            ("backwards", one("U8", "[4]", "[4,0]"), 4, "invalid offset"),
            ("more numbers than bytes", one("F64", "[8]", "[0,8]"), 8, "invalid shape"),
            ("beyond the end", one("U8", "[99]", "[0,99]"), 8, "cover 99 bytes, and 8 follow"),
            ("before the end", one("U8", "[7]", "[0,7]"), 8, "cover 7 bytes, and 8 follow"),
            ("a petabyte", one("U8", "[1125899906842624]", "[0,1125899906842624]"), 8, "and 8 follow"),
            ("overflow", one("F64", "[4294967296,4294967296]", "[0,8]"), 8, "overflow"),
            ("overflow of offsets", one("U8", "[8]", "[0,18446744073709551616]"), 8, "invalid"),
            ("another kind", one("BF16", "[4]", "[0,8]"), 8, "no number is of type BF16"),
            ("an unknown kind", one("Q7", "[4]", "[0,8]"), 8, "unknown variant `Q7`"),
            ("no name", one("U8", "[8]", "[0,8]").replace("\"a\"", "\"\""), 8, "name of a tensor"),
            ("control characters", one("U8", "[8]", "[0,8]").replace("\"a\"", r#""\u001b[2J""#), 8, "u{1b}[2J"),
            ("no JSON", "{\"a".into(), 8, "EOF"),
            ("nested", "[".repeat(100_000), 8, "the header"),
            ("nothing", String::new(), 0, "EOF"),
        ];
        for (what, header, n, wanted) in cases {
            let (path, entry) = forged(folder.path(), header.len() as u64, &header, n);
            match read(&path, &entry, &|_| true) {
                Ok(_) => assert_eq!(what, "sound"),
                Err(e) => assert!(!wanted.is_empty() && e.to_string().contains(wanted), "{what}: {e}"),
            }
        }
    }

    #[test]
    fn a_header_of_any_claimed_length_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        for length in [1 << 63, u64::MAX, u64::MAX - 7, 1 << 40, MAX_HEADER + 1, 11] {
            let (path, entry) = forged(folder.path(), length, "{}        ", 0);
            let start = Instant::now();
            let text = read(&path, &entry, &|_| true).unwrap_err().to_string();
            let took = start.elapsed();
            assert!(text.contains(&format!("length of the header is {length}, over the limit of 10.")), "{text}");
            assert!(took.as_millis() < 10, "{took:?}"); // measured 0.02 ms
        }
    }

    #[test]
    fn without_the_hash_a_flipped_bit_would_be_loaded_in_silence() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        let policy = sample(1, 50).policy;
        let entry = Layout::new(&policy, &path).unwrap().write(&path, &Disk::default()).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&path, &bytes).unwrap();
        assert!(read(&path, &entry, &|_| true).unwrap_err().to_string().contains("SHA-256"));
        assert!(safetensors::SafeTensors::deserialize(&bytes).is_ok());
        let trusting = Entry { sha256: hex(&Sha256::digest(&bytes)), ..entry };
        assert_ne!(read(&path, &trusting, &|_| true).unwrap(), policy);
    }
}
