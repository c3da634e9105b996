//! The messages of ONNX that a policy needs, by hand: field numbers are those of `onnx.proto` (Open Neural Network Exchange, IR version 8).
//!
//! What has a value of 0 is left out by the encoding; where that is another meaning than 0, the field is optional and given.

use prost::Message;

/// The type of a tensor's numbers.
pub const FLOAT: i32 = 1;
/// The type of whole numbers.
pub const INT64: i32 = 7;

/// Types of attributes.
pub const ATTRIBUTE_FLOAT: i32 = 1;
/// A whole number.
pub const ATTRIBUTE_INT: i32 = 2;
/// Several whole numbers.
pub const ATTRIBUTE_INTS: i32 = 7;

/// A file.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxModel {
    /// Version of the format.
    #[prost(int64, tag = "1")]
    pub ir_version: i64,
    /// Who wrote it.
    #[prost(string, tag = "2")]
    pub producer_name: String,
    /// Which version of that.
    #[prost(string, tag = "3")]
    pub producer_version: String,
    /// What it is.
    #[prost(string, tag = "6")]
    pub doc_string: String,
    /// What it computes.
    #[prost(message, optional, tag = "7")]
    pub graph: Option<OnnxGraph>,
    /// Which operators it means.
    #[prost(message, repeated, tag = "8")]
    pub opset_import: Vec<OnnxOperators>,
    /// Keys and values.
    #[prost(message, repeated, tag = "14")]
    pub metadata_props: Vec<OnnxEntry>,
}

/// A set of operators.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxOperators {
    /// Empty for the standard's own.
    #[prost(string, tag = "1")]
    pub domain: String,
    /// Its version.
    #[prost(int64, tag = "2")]
    pub version: i64,
}

/// A key and its value.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxEntry {
    /// The key.
    #[prost(string, tag = "1")]
    pub key: String,
    /// The value.
    #[prost(string, tag = "2")]
    pub value: String,
}

/// Nodes in the order in which they are computed.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxGraph {
    /// What is computed.
    #[prost(message, repeated, tag = "1")]
    pub node: Vec<OnnxNode>,
    /// Its name.
    #[prost(string, tag = "2")]
    pub name: String,
    /// Constants.
    #[prost(message, repeated, tag = "5")]
    pub initializer: Vec<OnnxTensor>,
    /// What it takes.
    #[prost(message, repeated, tag = "11")]
    pub input: Vec<OnnxValue>,
    /// What it gives.
    #[prost(message, repeated, tag = "12")]
    pub output: Vec<OnnxValue>,
}

/// One operation.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxNode {
    /// Names of what it reads; empty where something is left out.
    #[prost(string, repeated, tag = "1")]
    pub input: Vec<String>,
    /// Names of what it gives.
    #[prost(string, repeated, tag = "2")]
    pub output: Vec<String>,
    /// Its own name.
    #[prost(string, tag = "3")]
    pub name: String,
    /// Which operation.
    #[prost(string, tag = "4")]
    pub op_type: String,
    /// Its settings.
    #[prost(message, repeated, tag = "5")]
    pub attribute: Vec<OnnxAttribute>,
}

/// A setting of an operation.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxAttribute {
    /// Its name.
    #[prost(string, tag = "1")]
    pub name: String,
    /// Of [`ATTRIBUTE_FLOAT`].
    #[prost(float, optional, tag = "2")]
    pub f: Option<f32>,
    /// Of [`ATTRIBUTE_INT`].
    #[prost(int64, optional, tag = "3")]
    pub i: Option<i64>,
    /// Of [`ATTRIBUTE_INTS`].
    #[prost(int64, repeated, packed = "false", tag = "8")]
    pub ints: Vec<i64>,
    /// Which of them it is.
    #[prost(int32, tag = "20")]
    pub r#type: i32,
}

/// A constant.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxTensor {
    /// Sizes of its axes.
    #[prost(int64, repeated, packed = "false", tag = "1")]
    pub dims: Vec<i64>,
    /// [`FLOAT`] or [`INT64`].
    #[prost(int32, tag = "2")]
    pub data_type: i32,
    /// Its name.
    #[prost(string, tag = "8")]
    pub name: String,
    /// Its numbers, little-endian.
    #[prost(bytes = "vec", tag = "9")]
    pub raw_data: Vec<u8>,
}

/// What goes in or comes out.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxValue {
    /// Its name.
    #[prost(string, tag = "1")]
    pub name: String,
    /// What it is made of.
    #[prost(message, optional, tag = "2")]
    pub r#type: Option<OnnxType>,
    /// What its numbers are.
    #[prost(string, tag = "3")]
    pub doc_string: String,
}

/// The type of a value.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxType {
    /// Of a tensor.
    #[prost(message, optional, tag = "1")]
    pub tensor_type: Option<OnnxTensorType>,
}

/// The type of a tensor.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxTensorType {
    /// [`FLOAT`] or [`INT64`].
    #[prost(int32, tag = "1")]
    pub elem_type: i32,
    /// Its axes.
    #[prost(message, optional, tag = "2")]
    pub shape: Option<OnnxShape>,
}

/// Axes of a tensor.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxShape {
    /// Each of them.
    #[prost(message, repeated, tag = "1")]
    pub dim: Vec<OnnxAxis>,
}

/// The size of an axis: a number, or a name where any will do.
#[derive(Clone, PartialEq, Message)]
pub struct OnnxAxis {
    /// The number.
    #[prost(int64, optional, tag = "1")]
    pub dim_value: Option<i64>,
    /// The name.
    #[prost(string, optional, tag = "2")]
    pub dim_param: Option<String>,
}
