//! What the engine inside reads of an ONNX file: a part of ONNX's protobuf messages, with the numbers of `onnx.proto3`.
//! Files come from outside: prost never takes more memory than some multiple of the file's own, and an array here has as many values as its
//! dimensions say, or the file is refused.

use boxline::{Error, ErrorKind};
use prost::Message;

#[derive(Message)]
pub(crate) struct Model {
    #[prost(message, optional, tag = "7")]
    pub graph: Option<Graph>,
    #[prost(message, repeated, tag = "8")]
    pub opsets: Vec<Opset>,
}

/// The version of a family of operators.
#[derive(Message)]
pub(crate) struct Opset {
    #[prost(string, tag = "1")]
    pub domain: String,
    #[prost(int64, tag = "2")]
    pub version: i64,
}

#[derive(Message)]
pub(crate) struct Graph {
    #[prost(message, repeated, tag = "1")]
    pub nodes: Vec<Node>,
    #[prost(message, repeated, tag = "5")]
    pub weights: Vec<Tensor>,
    #[prost(message, repeated, tag = "11")]
    pub inputs: Vec<ValueInfo>,
    #[prost(message, repeated, tag = "12")]
    pub outputs: Vec<ValueInfo>,
}

#[derive(Message)]
pub(crate) struct Node {
    #[prost(string, repeated, tag = "1")]
    pub inputs: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    pub outputs: Vec<String>,
    #[prost(string, tag = "4")]
    pub operator: String,
    #[prost(message, repeated, tag = "5")]
    pub attributes: Vec<Attribute>,
    #[prost(string, tag = "7")]
    pub domain: String,
}

#[derive(Clone, Message)]
pub(crate) struct Attribute {
    #[prost(string, tag = "1")]
    pub name: String,
    #[prost(float, tag = "2")]
    pub float: f32,
    #[prost(int64, tag = "3")]
    pub int: i64,
    #[prost(bytes = "vec", tag = "4")]
    pub text: Vec<u8>,
    #[prost(message, optional, tag = "5")]
    pub tensor: Option<Tensor>,
    #[prost(int64, repeated, tag = "8")]
    pub ints: Vec<i64>,
}

#[derive(Clone, Message)]
pub(crate) struct Tensor {
    #[prost(int64, repeated, tag = "1")]
    pub dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    pub data_type: i32,
    #[prost(float, repeated, tag = "4")]
    pub floats: Vec<f32>,
    #[prost(int64, repeated, tag = "7")]
    pub ints: Vec<i64>,
    #[prost(string, tag = "8")]
    pub name: String,
    #[prost(bytes = "vec", tag = "9")]
    pub raw: Vec<u8>,
    #[prost(int32, tag = "14")]
    pub location: i32,
}

#[derive(Message)]
pub(crate) struct ValueInfo {
    #[prost(string, tag = "1")]
    pub name: String,
    #[prost(message, optional, tag = "2")]
    pub kind: Option<Kind>,
}

#[derive(Message)]
pub(crate) struct Kind {
    #[prost(message, optional, tag = "1")]
    pub tensor: Option<TensorKind>,
}

#[derive(Message)]
pub(crate) struct TensorKind {
    #[prost(int32, tag = "1")]
    pub data_type: i32,
    #[prost(message, optional, tag = "2")]
    pub shape: Option<Shape>,
}

#[derive(Message)]
pub(crate) struct Shape {
    #[prost(message, repeated, tag = "1")]
    pub dims: Vec<Dim>,
}

#[derive(Message)]
pub(crate) struct Dim {
    /// Absent where the size is a name.
    #[prost(int64, optional, tag = "1")]
    pub size: Option<i64>,
}

/// ONNX's numbers of types.
pub(crate) const FLOAT: i32 = 1;
const INT64: i32 = 7;

/// Values of an array that is known when a file is loaded.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Data {
    /// Weights and the like.
    Floats(Vec<f32>),
    /// Sizes, axes, places.
    Whole(Vec<i64>),
}

impl Model {
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Error> {
        Self::decode(bytes)
            .map_err(|e| bad(format!("the file is no ONNX file or is damaged: {e}")).with_source(e))
    }
}

impl ValueInfo {
    /// Sizes, -1 for one that is not fixed; nothing if it holds no f32.
    pub fn sizes(&self) -> Vec<i64> {
        let tensor = self.kind.as_ref().and_then(|kind| kind.tensor.as_ref());
        let shape = tensor.filter(|t| t.data_type == FLOAT).and_then(|t| t.shape.as_ref());
        shape.map_or_else(Vec::new, |s| s.dims.iter().map(|d| d.size.unwrap_or(-1)).collect())
    }
}

impl Tensor {
    /// The sizes and the values.
    pub fn contents(self) -> Result<(Vec<usize>, Data), Error> {
        let name = &self.name;
        let wrong = |what: &str| Err(bad(format!("the network's array {name:?} {what}")));
        if self.location != 0 {
            return wrong("lies in another file");
        }
        let sizes: Option<Vec<usize>> = self.dims.iter().map(|d| usize::try_from(*d).ok()).collect();
        let Some((sizes, len)) = sizes.and_then(|s| super::forward::len_of(&s).map(|len| (s, len))) else {
            return wrong("is too large");
        };
        let data = match self.data_type {
            FLOAT if self.raw.is_empty() => Data::Floats(self.floats),
            FLOAT if self.raw.len().is_multiple_of(4) => {
                Data::Floats(self.raw.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
            }
            INT64 if self.raw.is_empty() => Data::Whole(self.ints),
            INT64 if self.raw.len().is_multiple_of(8) => {
                Data::Whole(self.raw.as_chunks().0.iter().map(|b| i64::from_le_bytes(*b)).collect())
            }
            FLOAT | INT64 => return wrong("is cut off"),
            other => {
                return wrong(&format!(
                    "holds numbers of type {other}, the engine inside knows 32-bit floats and 64-bit integers; ONNX Runtime can run it"
                ));
            }
        };
        let found = match &data {
            Data::Floats(values) => values.len(),
            Data::Whole(values) => values.len(),
        };
        if found != len {
            return wrong(&format!("has {found} values where its sizes say {len}"));
        }
        Ok((sizes, data))
    }
}

/// A fault of the file.
pub(crate) fn bad(text: impl Into<String>) -> Error {
    Error::new(ErrorKind::ModelFile, text.into())
}
