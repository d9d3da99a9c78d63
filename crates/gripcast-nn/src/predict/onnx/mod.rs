//! Writes ONNX files, and reads them with explained errors.
//!
//! The message types are those of [`tract_onnx::pb`]. Written files have opset [`OPSET`] and IR
//! version [`IR_VERSION`], which onnxruntime and tract both read.

mod attribute;
mod file;
mod graph;

pub use attribute::Attribute;
pub use file::{PYTORCH_EXPORT, decode, read};
pub use graph::{OPEN_BATCH, OnnxGraphBuilder, Value};
pub use tract_onnx::pb;

/// Version of the default operator set of written files.
pub const OPSET: i64 = 17;
/// Version of the file format of written files.
pub const IR_VERSION: i64 = 8;
