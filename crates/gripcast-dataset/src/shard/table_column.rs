//! Columns of any table with images: their Parquet schema and the features of Hugging Face.

use parquet::errors::ParquetError;
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::TypePtr;

/// Names of the labels 0 and 1 in a column `label`.
const LABELS: [&str; 2] = ["slip", "stable"];

/// What a column holds, and the cell that it takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableKind {
    /// UTF-8; `Text`.
    Text,
    /// A list of one text; `Text`.
    OneText,
    /// Signed, 64 bit; `Integer`.
    Integer,
    /// True or false; `Integer`, 0 is false.
    Flag,
    /// Double precision; `Number`.
    Number,
    /// Single precision; `Number`.
    Single,
    /// A list of doubles; `Numbers`.
    Numbers,
    /// A list of so many singles; `Numbers`.
    Singles(usize),
    /// An encoded image, its bytes and its file name; `Image`.
    Image,
}

/// The schema of a file. Every column is optional, as Arrow writes them.
pub(super) fn schema<'a>(
    columns: impl Iterator<Item = (&'a str, TableKind)>,
) -> Result<TypePtr, ParquetError> {
    let list = |name: &str, element: &str| {
        format!("optional group {name} (LIST) {{ repeated group list {{ optional {element}; }} }}")
    };
    let mut text = String::from("message schema {");
    for (name, kind) in columns {
        text += &match kind {
            TableKind::Text => format!("optional binary {name} (STRING);"),
            TableKind::OneText => list(name, "binary element (STRING)"),
            TableKind::Integer => format!("optional int64 {name};"),
            TableKind::Flag => format!("optional boolean {name};"),
            TableKind::Number => format!("optional double {name};"),
            TableKind::Single => format!("optional float {name};"),
            TableKind::Numbers => list(name, "double element"),
            TableKind::Singles(_) => list(name, "float element"),
            TableKind::Image => format!(
                "optional group {name} {{ optional binary bytes; optional binary path (STRING); }}"
            ),
        };
    }
    text.push('}');
    Ok(TypePtr::new(parse_message_type(&text)?))
}

/// The value of the `huggingface` key.
///
/// Lists are called `Sequence`, which releases of `datasets` before 4 and after it know.
pub(super) fn features<'a>(columns: impl Iterator<Item = (&'a str, TableKind)>) -> String {
    // Written by hand: a map of another build of serde_json might have another order.
    let features: Vec<String> = columns
        .map(|(name, kind)| format!(r#""{name}":{}"#, feature(name, kind)))
        .collect();
    format!(r#"{{"info":{{"features":{{{}}}}}}}"#, features.join(","))
}

fn feature(name: &str, kind: TableKind) -> String {
    let value = |dtype: &str| format!(r#"{{"dtype":"{dtype}","_type":"Value"}}"#);
    let list = |dtype: &str| format!(r#"{{"feature":{},"_type":"Sequence"}}"#, value(dtype));
    match kind {
        _ if name == "label" => {
            let [slip, stable] = LABELS;
            format!(r#"{{"names":["{slip}","{stable}"],"_type":"ClassLabel"}}"#)
        }
        TableKind::Text => value("string"),
        TableKind::OneText => list("string"),
        TableKind::Integer => value("int64"),
        TableKind::Flag => value("bool"),
        TableKind::Number => value("float64"),
        TableKind::Single => value("float32"),
        TableKind::Numbers => list("float64"),
        TableKind::Singles(length) => format!(
            r#"{{"feature":{},"length":{length},"_type":"Sequence"}}"#,
            value("float32")
        ),
        TableKind::Image => r#"{"_type":"Image"}"#.to_owned(),
    }
}
