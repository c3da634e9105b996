//! Named arrays of numbers, as the files of a checkpoint hold them.

use base::error::{Error, Result};
use std::collections::BTreeMap;

/// Numbers of a tensor, row-major. Equal when their bits are: a NaN equals itself, 0 differs from −0.
#[derive(Debug, Clone)]
pub enum Data {
    /// Weights, moments.
    F32(Vec<f32>),
    /// Statistics.
    F64(Vec<f64>),
    /// Counters, keys of random streams.
    U64(Vec<u64>),
    /// Whatever has its own encoding, as snapshots of environments.
    Bytes(Vec<u8>),
}

impl PartialEq for Data {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::F32(a), Self::F32(b)) => a.iter().map(|x| x.to_bits()).eq(b.iter().map(|x| x.to_bits())),
            (Self::F64(a), Self::F64(b)) => a.iter().map(|x| x.to_bits()).eq(b.iter().map(|x| x.to_bits())),
            (Self::U64(a), Self::U64(b)) => a == b,
            (Self::Bytes(a), Self::Bytes(b)) => a == b,
            _ => false,
        }
    }
}

impl Data {
    fn kind(&self) -> &'static str {
        match self {
            Self::F32(_) => <f32 as codec::Codec>::KIND,
            Self::F64(_) => <f64 as codec::Codec>::KIND,
            Self::U64(_) => <u64 as codec::Codec>::KIND,
            Self::Bytes(_) => <u8 as codec::Codec>::KIND,
        }
    }
}

/// What a tensor can be made of: `f32`, `f64`, `u64`, `u8`.
pub trait TensorElement: codec::Codec {}

pub(super) mod codec {
    use super::Data;

    /// Between numbers, [`Data`] and little-endian bytes.
    pub trait Codec: Copy {
        /// Name for messages.
        const KIND: &'static str;
        fn data(values: Vec<Self>) -> Data;
        fn values(data: &Data) -> Option<&[Self]>;
        fn into_values(data: Data) -> Option<Vec<Self>>;
        fn encode(values: &[Self], bytes: &mut Vec<u8>);
        fn decode(bytes: &[u8], values: &mut Vec<Self>);
    }

    macro_rules! elements {
        ($($number:ty, $variant:ident;)*) => {$(
            impl super::TensorElement for $number {}
            impl Codec for $number {
                const KIND: &'static str = stringify!($number);
                fn data(values: Vec<Self>) -> Data {
                    Data::$variant(values)
                }
                fn values(data: &Data) -> Option<&[Self]> {
                    if let Data::$variant(values) = data { Some(values) } else { None }
                }
                fn into_values(data: Data) -> Option<Vec<Self>> {
                    if let Data::$variant(values) = data { Some(values) } else { None }
                }
                fn encode(values: &[Self], bytes: &mut Vec<u8>) {
                    bytes.extend(values.iter().flat_map(|x| x.to_le_bytes()));
                }
                fn decode(bytes: &[u8], values: &mut Vec<Self>) {
                    values.extend(bytes.as_chunks().0.iter().map(|b| Self::from_le_bytes(*b)));
                }
            }
        )*};
    }
    elements! { f32, F32; f64, F64; u64, U64; u8, Bytes; }
}

/// An array of numbers and its shape, whose product is their count.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    shape: Vec<usize>,
    data: Data,
}

impl Tensor {
    /// Sizes, slowest index first; empty for a single number.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The numbers, row-major.
    pub fn data(&self) -> &Data {
        &self.data
    }

    fn is<T: TensorElement>(&self, shape: &[usize]) -> bool {
        T::values(&self.data).is_some() && self.shape == shape
    }
}

/// Longest name, bytes.
const MAX_NAME: usize = 256;

/// Tensors by name, in the order of their names.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tensors(BTreeMap<String, Tensor>);

impl Tensors {
    /// None.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds `values`, row-major in `shape`, under a new name of 1 to 256 bytes without control characters.
    ///
    /// # Errors
    /// [`Error::Value`] if the name is taken or no name, or the shape's product is not the number of values.
    pub fn insert<T: TensorElement>(&mut self, name: impl Into<String>, shape: &[usize], values: Vec<T>) -> Result<()> {
        let name = name.into();
        if name.is_empty() || name.len() > MAX_NAME || name.contains(char::is_control) || name == "__metadata__" {
            let limit = format!("1 to {MAX_NAME} printable bytes, and not __metadata__");
            let shown = name.chars().take(64).collect::<String>().escape_debug().to_string();
            return Err(Error::value("name of a tensor", format!("'{shown}'"), limit, "Choose another."));
        }
        if self.0.contains_key(&name) {
            return Err(Error::value("name of a tensor", format!("'{name}' again"), "new", "Choose another."));
        }
        let n = shape.iter().try_fold(1usize, |n, size| n.checked_mul(*size));
        if n != Some(values.len()) {
            let remedy = "Give a shape whose product is that number.";
            return Err(Error::value(
                format!("number of values of tensor {name}"),
                values.len(),
                format!("as many as {shape:?} holds"),
                remedy,
            ));
        }
        self.0.insert(name, Tensor { shape: shape.to_vec(), data: T::data(values) });
        Ok(())
    }

    /// The tensor `name`.
    ///
    /// # Errors
    /// [`Error::Unknown`] if there is none.
    pub fn tensor(&self, name: &str) -> Result<&Tensor> {
        self.0.get(name).ok_or_else(|| Error::Unknown {
            kind: "tensor",
            name: name.into(),
            known: self.0.keys().cloned().collect(),
        })
    }

    /// The values of tensor `name`, which has to be of `T` and `shape`.
    ///
    /// # Errors
    /// [`Error::Unknown`] if there is none of that name, [`Error::Value`] if it is of another kind or shape.
    pub fn get<T: TensorElement>(&self, name: &str, shape: &[usize]) -> Result<&[T]> {
        let tensor = self.tensor(name)?;
        let values = T::values(&tensor.data).filter(|_| tensor.shape == shape);
        values.ok_or_else(|| mismatch::<T>(name, tensor, shape))
    }

    /// As [`get`](Self::get), but moves them out. What was refused stays.
    ///
    /// # Errors
    /// As [`get`](Self::get).
    pub fn take<T: TensorElement>(&mut self, name: &str, shape: &[usize]) -> Result<Vec<T>> {
        let tensor = self.tensor(name)?;
        if !tensor.is::<T>(shape) {
            return Err(mismatch::<T>(name, tensor, shape));
        }
        Ok(self.0.remove(name).and_then(|t| T::into_values(t.data)).unwrap_or_default())
    }

    /// Nothing is left: whoever takes all that he knows learns here whether there was more.
    ///
    /// # Errors
    /// [`Error::Value`] naming the first tensor left.
    pub fn none_left(&self) -> Result<()> {
        let Some((name, tensor)) = self.0.first_key_value() else { return Ok(()) };
        let what = format!("tensor {name}");
        Err(Error::value(what, describe(tensor.data.kind(), &tensor.shape), "one that is known here", REMEDY))
    }

    /// Names and tensors, in the order of names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Tensor)> {
        self.0.iter().map(|(name, tensor)| (name.as_str(), tensor))
    }

    /// Number of tensors.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

const REMEDY: &str = "Build what is to be restored with the settings in the checkpoint's manifest, or load another.";

fn mismatch<T: TensorElement>(name: &str, tensor: &Tensor, shape: &[usize]) -> Error {
    let found = describe(tensor.data.kind(), &tensor.shape);
    Error::value(format!("tensor {name}"), found, describe(T::KIND, shape), REMEDY)
}

fn describe(kind: &str, shape: &[usize]) -> String {
    format!("{kind} of shape {shape:?}")
}
