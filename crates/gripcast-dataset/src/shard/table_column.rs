//! Column types of tables with images: Parquet schema and Hugging Face features.

use parquet::errors::ParquetError;
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::TypePtr;

/// Names of the labels 0 and 1 in a column `label`.
const LABELS: [&str; 2] = ["slip", "stable"];

/// Type of a column, and the cell that it takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnType {
    /// UTF-8; `Text`.
    Text,
    /// A list of one string; `Text`.
    TextList,
    /// 64-bit signed integer; `Integer`.
    Int64,
    /// Boolean; `Integer`, 0 is false.
    Bool,
    /// 64-bit float; `Number`.
    Float64,
    /// 32-bit float; `Number`.
    Float32,
    /// A list of at most this number of 64-bit floats; `Numbers`.
    Float64List(usize),
    /// A list of 32-bit floats of this length; `Numbers`.
    Float32List(usize),
    /// An encoded image and its file name; `Image`.
    Image,
    /// A list of encoded images and their file names; `Images`.
    ImageList,
    /// An array of 32-bit floats of this number of dimensions, any size: nested lists; `Array`.
    Float32Array(usize),
}

/// Returns the schema of a file. Every column is optional, as in Arrow.
pub(super) fn schema<'a>(
    columns: impl Iterator<Item = (&'a str, ColumnType)>,
) -> Result<TypePtr, ParquetError> {
    let list = |name: &str, element: &str| {
        format!("optional group {name} (LIST) {{ repeated group list {{ {element} }} }}")
    };
    let image = |name: &str| {
        format!("optional group {name} {{ optional binary bytes; optional binary path (STRING); }}")
    };
    let mut text = String::from("message schema {");
    for (name, kind) in columns {
        text += &match kind {
            ColumnType::Text => format!("optional binary {name} (STRING);"),
            ColumnType::TextList => list(name, "optional binary element (STRING);"),
            ColumnType::Int64 => format!("optional int64 {name};"),
            ColumnType::Bool => format!("optional boolean {name};"),
            ColumnType::Float64 => format!("optional double {name};"),
            ColumnType::Float32 => format!("optional float {name};"),
            ColumnType::Float64List(_) => list(name, "optional double element;"),
            ColumnType::Float32List(_) => list(name, "optional float element;"),
            ColumnType::Image => image(name),
            ColumnType::ImageList => list(name, &image("element")),
            ColumnType::Float32Array(dimensions) => {
                let names = std::iter::repeat_n("element", dimensions.saturating_sub(1));
                let names = names.chain([name]);
                let leaf = "optional float element;".to_owned();
                names.fold(leaf, |element, name| list(name, &element))
            }
        };
    }
    text.push('}');
    Ok(TypePtr::new(parse_message_type(&text)?))
}

/// Returns the value of the `huggingface` key.
///
/// Lists are called `Sequence`, which all releases of `datasets` accept.
pub(super) fn features<'a>(columns: impl Iterator<Item = (&'a str, ColumnType)>) -> String {
    // Formatted by hand to fix the order of the keys.
    let features: Vec<String> = columns
        .map(|(name, kind)| format!(r#""{name}":{}"#, feature(name, kind)))
        .collect();
    format!(r#"{{"info":{{"features":{{{}}}}}}}"#, features.join(","))
}

fn feature(name: &str, kind: ColumnType) -> String {
    let value = |dtype: &str| format!(r#"{{"dtype":"{dtype}","_type":"Value"}}"#);
    let list = |dtype: &str| format!(r#"{{"feature":{},"_type":"Sequence"}}"#, value(dtype));
    match kind {
        _ if name == "label" => {
            let [slip, stable] = LABELS;
            format!(r#"{{"names":["{slip}","{stable}"],"_type":"ClassLabel"}}"#)
        }
        ColumnType::Text => value("string"),
        ColumnType::TextList => list("string"),
        ColumnType::Int64 => value("int64"),
        ColumnType::Bool => value("bool"),
        ColumnType::Float64 => value("float64"),
        ColumnType::Float32 => value("float32"),
        ColumnType::Float64List(_) => list("float64"),
        ColumnType::Float32List(length) => format!(
            r#"{{"feature":{},"length":{length},"_type":"Sequence"}}"#,
            value("float32")
        ),
        ColumnType::Image => r#"{"_type":"Image"}"#.to_owned(),
        ColumnType::ImageList => r#"{"feature":{"_type":"Image"},"_type":"Sequence"}"#.to_owned(),
        ColumnType::Float32Array(dimensions) => (0..dimensions)
            .fold(value("float32"), |inner, _| {
                format!(r#"{{"feature":{inner},"_type":"Sequence"}}"#)
            }),
    }
}
