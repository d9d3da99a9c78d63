//! Maps columns to the leaves of a file's schema, for any writer.

use parquet::basic::{ConvertedType, LogicalType, Type};
use parquet::file::metadata::ParquetMetaData;
use parquet::schema::types::{ColumnDescriptor, SchemaDescriptor};

use super::cell::column_error;
use super::columns::{Column, columns};
use super::table_column::ColumnType;
use gripcast_base::error::{Error, Result};

/// Maximum length of a list, so that a damaged count takes no memory.
const MAX_LIST: i64 = 512;
/// Maximum number of bytes of the images of a row group that are stored as lists of numbers.
const MAX_LISTED_BYTES: i64 = 128 << 20;

/// Index of each column's leaf in the schema; none where the file lacks the column.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub(super) leaves: Vec<Option<usize>>,
}

impl Layout {
    /// # Errors
    /// `Input`: a column is missing or of another type.
    pub(super) fn find(schema: &SchemaDescriptor) -> Result<Self> {
        let leaves = columns().map(|column| leaf(schema, column));
        Ok(Self {
            leaves: leaves.collect::<Result<_>>()?,
        })
    }

    /// Checks the counts of all row groups; returns the number of rows.
    ///
    /// # Errors
    /// `Input`: they contradict each other.
    pub(super) fn count_rows(&self, metadata: &ParquetMetaData) -> Result<usize> {
        let mut sum = 0_i64;
        for (index, group) in metadata.row_groups().iter().enumerate() {
            let rows = group.num_rows();
            sum = sum.saturating_add(rows);
            if rows < 0 {
                return Err(Error::input(format!("row group {index} has {rows} rows")));
            }
            for (column, leaf) in columns().zip(&self.leaves) {
                let Some(chunk) = leaf.and_then(|leaf| group.columns().get(leaf)) else {
                    continue;
                };
                let max_values = match column.kind {
                    ColumnType::Float64List(_) => rows.saturating_mul(MAX_LIST),
                    ColumnType::Image if chunk.column_descr().max_rep_level() > 0 => {
                        MAX_LISTED_BYTES
                    }
                    _ => rows,
                };
                let values = chunk.num_values();
                if !(rows..=max_values).contains(&values) {
                    let name = column.name;
                    let what = format!(
                        "row group {index} has {rows} rows and {values} values in column {name}"
                    );
                    return Err(Error::input(what));
                }
            }
        }
        let rows = metadata.file_metadata().num_rows();
        if rows != sum {
            let what = format!("expected {rows} rows, the row groups have {sum}");
            return Err(Error::input(what));
        }
        usize::try_from(sum).map_err(|_| Error::input(format!("too many rows: {sum}")))
    }
}

fn leaf(schema: &SchemaDescriptor, column: &Column) -> Result<Option<usize>> {
    let mut found = schema.columns().iter().enumerate().filter(|(_, leaf)| {
        let path = leaf.path().parts();
        let named = path.first().is_some_and(|first| first == column.name);
        // The name of an image follows from the column's name.
        let is_value = column.kind != ColumnType::Image
            || path.len() == 1
            || path[1] == "bytes"
            || leaf.max_rep_level() > 0;
        named && is_value
    });
    let (first, second) = (found.next(), found.next());
    match (first, second) {
        (None, _) if column.nullable => Ok(None),
        (None, _) => {
            let what = format!("missing column {}", column.name);
            let remedy = "write all columns of a gripcast shard";
            Err(Error::input(what).remedy(remedy))
        }
        // A column that is all null has no type in files written by pandas.
        (Some((_, leaf)), None) if column.nullable && is_unknown(leaf) => Ok(None),
        (Some((number, leaf)), None) if fits(leaf, column) => Ok(Some(number)),
        (Some((_, leaf)), _) => Err(column_error(
            column.name,
            format!(
                "has type {}, expected {}",
                describe(schema, column, leaf),
                expected(column)
            ),
        )),
    }
}

/// Whether the numbers of a column are bytes.
fn is_byte(leaf: &ColumnDescriptor) -> bool {
    let is_byte = |logical: &LogicalType| matches!(logical, LogicalType::Integer(int) if int.bit_width == 8 && !int.is_signed);
    leaf.logical_type_ref().is_some_and(is_byte) || leaf.converted_type() == ConvertedType::UINT_8
}

fn is_unknown(leaf: &ColumnDescriptor) -> bool {
    leaf.logical_type_ref() == Some(&LogicalType::Unknown)
}

fn fits(leaf: &ColumnDescriptor, column: &Column) -> bool {
    let kind = leaf.physical_type();
    let (depth, repeated) = (leaf.path().parts().len(), leaf.max_rep_level());
    match column.kind {
        ColumnType::Text => kind == Type::BYTE_ARRAY && depth == 1 && repeated == 0,
        ColumnType::Int64 => {
            matches!(kind, Type::INT64 | Type::INT32 | Type::BOOLEAN) && depth == 1 && repeated == 0
        }
        ColumnType::Float64 => {
            matches!(kind, Type::DOUBLE | Type::FLOAT) && depth == 1 && repeated == 0
        }
        ColumnType::Float64List(_) => matches!(kind, Type::DOUBLE | Type::FLOAT) && repeated == 1,
        ColumnType::Image => match kind {
            Type::BYTE_ARRAY => depth <= 2 && repeated == 0,
            Type::INT32 => repeated == 1 && is_byte(leaf),
            _ => false,
        },
        _ => false,
    }
}

fn describe(schema: &SchemaDescriptor, column: &Column, leaf: &ColumnDescriptor) -> String {
    let leaves = schema.columns().iter();
    let of_column = leaves.filter(|l| l.path().parts().first().is_some_and(|p| p == column.name));
    match of_column.count() {
        1 => format!("{} ({})", leaf.physical_type(), leaf.path().string()),
        several => format!("a group of {several} values"),
    }
}

fn expected(column: &Column) -> &'static str {
    match column.kind {
        ColumnType::Text => "BYTE_ARRAY (a string)",
        ColumnType::Int64 => "INT64, INT32 or BOOLEAN",
        ColumnType::Float64 => "DOUBLE or FLOAT",
        ColumnType::Float64List(_) => "a list of DOUBLE or FLOAT",
        ColumnType::Image => "a group of bytes (BYTE_ARRAY) and path, or a list of uint8",
        _ => "a type of a shard",
    }
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::sync::Arc;

    use parquet::schema::parser::parse_message_type;
    use parquet::schema::printer::print_schema;

    use super::super::columns::schema;
    use super::*;

    /// Layout of our schema with `ours` replaced by `other`.
    fn find(ours: &str, other: &str) -> Result<Layout> {
        let mut text = Vec::new();
        print_schema(&mut text, &schema().unwrap());
        let text = String::from_utf8(text).unwrap();
        assert!(text.contains(ours), "{ours} is not in {text}");
        let parsed = parse_message_type(&text.replacen(ours, other, 1)).unwrap();
        Layout::find(&SchemaDescriptor::new(Arc::new(parsed)))
    }

    #[test]
    fn only_nullable_columns_may_be_missing() {
        let leaf = |layout: &Layout, name: &str| {
            let index = columns().position(|column| column.name == name).unwrap();
            layout.leaves[index]
        };
        let ours = find("", "").unwrap();
        assert!(ours.leaves.iter().all(Option::is_some));
        assert_eq!(leaf(&ours, "grasp_depth"), Some(38));
        let other = find("DOUBLE force_left_n;", "DOUBLE other_n;").unwrap();
        assert_eq!(leaf(&other, "force_left_n"), None);
        assert_eq!(leaf(&other, "opening_m"), leaf(&ours, "opening_m"));
        let null = find("DOUBLE force_left_n;", "INT32 force_left_n (UNKNOWN);").unwrap();
        assert_eq!(leaf(&null, "force_left_n"), None);
        let error = find("INT64 seed;", "INT64 seeds;").unwrap_err();
        assert!(error.to_string().contains("missing column seed"), "{error}");
    }

    #[test]
    fn wrong_type_is_reported() {
        for (ours, other, expected) in [
            (
                "INT64 label;",
                "DOUBLE label;",
                "column label has type DOUBLE",
            ),
            (
                "DOUBLE mass_kg;",
                "INT64 mass_kg;",
                "column mass_kg has type INT64",
            ),
            (
                "BYTE_ARRAY id (STRING);",
                "INT64 id;",
                "expected BYTE_ARRAY (a string)",
            ),
            (
                "OPTIONAL DOUBLE friction;",
                "REPEATED DOUBLE friction;",
                "column friction has",
            ),
            (
                "BYTE_ARRAY bytes;",
                "INT32 bytes;",
                "column initial_left has",
            ),
            (
                "DOUBLE element;",
                "BYTE_ARRAY element;",
                "expected a list of DOUBLE",
            ),
            (
                "DOUBLE element;",
                "DOUBLE element; OPTIONAL DOUBLE more;",
                "column pose_t_m has type a group of 2 values",
            ),
        ] {
            let error = find(ours, other).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Input);
            assert!(error.to_string().contains(expected), "{error}");
        }
        for (ours, other) in [
            ("INT64 label;", "INT32 label;"),
            ("INT64 label;", "BOOLEAN label;"),
            ("DOUBLE mass_kg;", "FLOAT mass_kg;"),
            ("DOUBLE element;", "FLOAT element;"),
        ] {
            find(ours, other).unwrap();
        }
    }
}
