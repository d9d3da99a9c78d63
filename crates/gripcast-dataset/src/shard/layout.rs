//! Where the columns are in a file, whoever wrote it.

use parquet::basic::{LogicalType, Type};
use parquet::file::metadata::ParquetMetaData;
use parquet::schema::types::{ColumnDescriptor, SchemaDescriptor};

use super::cell::wrong;
use super::columns::{Column, Kind, columns};
use gripcast_base::error::{Error, Result};

/// Most values of a list that are looked at, so that a damaged count takes no memory.
const MAX_LIST: i64 = 16;

/// For each column the leaf of the schema that holds its values; none where the file lacks it.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub(super) leaves: Vec<Option<usize>>,
}

impl Layout {
    /// # Errors
    /// `Input`: a column is missing or of another kind.
    pub(super) fn find(schema: &SchemaDescriptor) -> Result<Self> {
        let leaves = columns().map(|column| leaf(schema, column));
        Ok(Self {
            leaves: leaves.collect::<Result<_>>()?,
        })
    }

    /// Checks that the counts of all row groups agree; the number of rows.
    ///
    /// # Errors
    /// `Input`: they do not.
    pub(super) fn count_rows(&self, metadata: &ParquetMetaData) -> Result<usize> {
        let mut sum = 0_i64;
        for (number, group) in metadata.row_groups().iter().enumerate() {
            let rows = group.num_rows();
            sum = sum.saturating_add(rows);
            if rows < 0 {
                return Err(counts(format!("row group {number} has {rows} rows")));
            }
            for (column, leaf) in columns().zip(&self.leaves) {
                let Some(chunk) = leaf.and_then(|leaf| group.columns().get(leaf)) else {
                    continue;
                };
                let most = match column.kind {
                    Kind::Numbers(_) => rows.saturating_mul(MAX_LIST),
                    _ => rows,
                };
                let values = chunk.num_values();
                if !(rows..=most).contains(&values) {
                    let name = column.name;
                    let what = format!(
                        "row group {number} has {rows} rows and {values} values in column {name}"
                    );
                    return Err(counts(what));
                }
            }
        }
        let rows = metadata.file_metadata().num_rows();
        if rows != sum {
            let what = format!("the row groups have {sum} rows, the file says {rows}");
            return Err(counts(what));
        }
        usize::try_from(sum).map_err(|_| counts(format!("{sum} rows are too many")))
    }
}

fn leaf(schema: &SchemaDescriptor, column: &Column) -> Result<Option<usize>> {
    let mut found = schema.columns().iter().enumerate().filter(|(_, leaf)| {
        let parts = leaf.path().parts();
        let named = parts.first().is_some_and(|first| first == column.name);
        // Of an image the bytes count: its name is in the column's name.
        let part = column.kind != Kind::Image || parts.len() == 1 || parts[1] == "bytes";
        named && part
    });
    let (first, second) = (found.next(), found.next());
    match (first, second) {
        (None, _) if column.nullable => Ok(None),
        (None, _) => {
            let what = format!("the column {} is missing", column.name);
            let remedy = "the columns are those of a shard of gripcast";
            Err(Error::input(what).remedy(remedy))
        }
        // A column of nothing but nulls has no type in files that pandas wrote.
        (Some((_, leaf)), None) if column.nullable && is_unknown(leaf) => Ok(None),
        (Some((number, leaf)), None) if fits(leaf, column) => Ok(Some(number)),
        (Some((_, leaf)), _) => Err(wrong(
            column.name,
            format!(
                "has the type {}; expected {}",
                describe(schema, column, leaf),
                expected(column)
            ),
        )),
    }
}

fn is_unknown(leaf: &ColumnDescriptor) -> bool {
    leaf.logical_type_ref() == Some(&LogicalType::Unknown)
}

fn fits(leaf: &ColumnDescriptor, column: &Column) -> bool {
    let kind = leaf.physical_type();
    let (parts, repeated) = (leaf.path().parts().len(), leaf.max_rep_level());
    match column.kind {
        Kind::Text => kind == Type::BYTE_ARRAY && parts == 1 && repeated == 0,
        Kind::Integer => matches!(kind, Type::INT64 | Type::INT32) && parts == 1 && repeated == 0,
        Kind::Number => kind == Type::DOUBLE && parts == 1 && repeated == 0,
        Kind::Numbers(_) => kind == Type::DOUBLE && repeated == 1,
        Kind::Image => kind == Type::BYTE_ARRAY && parts <= 2 && repeated == 0,
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
        Kind::Text => "BYTE_ARRAY, a text",
        Kind::Integer => "INT64 or INT32",
        Kind::Number => "DOUBLE",
        Kind::Numbers(_) => "a list of DOUBLE",
        Kind::Image => "a group of bytes (BYTE_ARRAY) and path",
    }
}

fn counts(what: String) -> Error {
    Error::input(what)
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::sync::Arc;

    use parquet::schema::parser::parse_message_type;
    use parquet::schema::printer::print_schema;

    use super::super::columns::schema;
    use super::*;

    /// The layout of a schema in which a part of ours is another.
    fn find(ours: &str, other: &str) -> Result<Layout> {
        let mut text = Vec::new();
        print_schema(&mut text, &schema().unwrap());
        let text = String::from_utf8(text).unwrap();
        assert!(text.contains(ours), "{ours} is not in {text}");
        let parsed = parse_message_type(&text.replacen(ours, other, 1)).unwrap();
        Layout::find(&SchemaDescriptor::new(Arc::new(parsed)))
    }

    #[test]
    fn columns_may_be_missing_only_where_they_may_be_null() {
        let leaf = |layout: &Layout, name: &str| {
            let at = columns().position(|column| column.name == name).unwrap();
            layout.leaves[at]
        };
        let ours = find("", "").unwrap();
        assert!(ours.leaves.iter().all(Option::is_some));
        assert_eq!(leaf(&ours, "grasp_depth"), Some(34));
        let other = find("DOUBLE force_left_n;", "DOUBLE other_n;").unwrap();
        assert_eq!(leaf(&other, "force_left_n"), None);
        assert_eq!(leaf(&other, "opening_m"), leaf(&ours, "opening_m"));
        let null = find("DOUBLE force_left_n;", "INT32 force_left_n (UNKNOWN);").unwrap();
        assert_eq!(leaf(&null, "force_left_n"), None);
        let error = find("INT64 seed;", "INT64 seeds;").unwrap_err();
        assert!(
            error.to_string().contains("the column seed is missing"),
            "{error}"
        );
    }

    #[test]
    fn wrong_types_are_named() {
        for (ours, other, expected) in [
            (
                "INT64 label;",
                "DOUBLE label;",
                "column label has the type DOUBLE",
            ),
            (
                "DOUBLE mass_kg;",
                "FLOAT mass_kg;",
                "column mass_kg has the type FLOAT",
            ),
            (
                "BYTE_ARRAY id (STRING);",
                "INT64 id;",
                "expected BYTE_ARRAY, a text",
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
                "column pose_t_m has the type a group of 2 values",
            ),
        ] {
            let error = find(ours, other).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Input);
            assert!(error.to_string().contains(expected), "{error}");
        }
        find("INT64 label;", "INT32 label;").unwrap();
    }
}
