//! The columns: names, kinds, order; the Parquet schema and the features of Hugging Face.

use parquet::errors::ParquetError;
use parquet::schema::types::TypePtr;

use super::table_column::{self, TableKind};

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// UTF-8.
    Text,
    /// Signed, 64 bit.
    Integer,
    /// Double precision.
    Number,
    /// A list of so many doubles.
    Numbers(usize),
    /// An encoded image: its bytes and its file name.
    Image,
}

/// One column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    /// Whether rows may lack it, and so the file.
    pub(super) nullable: bool,
}

const fn always(name: &'static str, kind: Kind) -> Column {
    Column {
        name,
        kind,
        nullable: false,
    }
}

const fn nullable(name: &'static str, kind: Kind) -> Column {
    Column {
        name,
        kind,
        nullable: true,
    }
}

/// Columns of `ShardFacts`, in the order of the file.
pub(super) const FACTS: [Column; 22] = [
    always("id", Kind::Text),
    always("simulation", Kind::Text),
    always("object", Kind::Text),
    always("category", Kind::Text),
    always("engine", Kind::Text),
    always("outcome", Kind::Text),
    always("outcome_detail", Kind::Text),
    always("label", Kind::Integer),
    nullable("stop_force_n", Kind::Number),
    nullable("friction", Kind::Number),
    nullable("mass_kg", Kind::Number),
    nullable("lifted_m", Kind::Number),
    nullable("force_left_n", Kind::Number),
    nullable("force_right_n", Kind::Number),
    nullable("opening_m", Kind::Number),
    nullable("pose_t_m", Kind::Numbers(3)),
    nullable("pose_q_wxyz", Kind::Numbers(4)),
    nullable("fault", Kind::Text),
    always("appearance", Kind::Text),
    always("rendering", Kind::Integer),
    always("seed", Kind::Integer),
    always("crop_profile", Kind::Text),
];

/// Columns of `ShardImages`, after the facts: `<stage>_<role>`.
pub(super) const IMAGES: [Column; 7] = [
    always("initial_left", Kind::Image),
    always("initial_right", Kind::Image),
    always("grasp_left", Kind::Image),
    always("grasp_right", Kind::Image),
    always("grasp_rgb", Kind::Image),
    nullable("initial_rgb", Kind::Image),
    nullable("grasp_depth", Kind::Image),
];

/// All columns in the order of the file.
pub(super) fn columns() -> impl Iterator<Item = &'static Column> {
    FACTS.iter().chain(&IMAGES)
}

/// The same as columns of any table.
pub(super) fn table_columns() -> impl Iterator<Item = (&'static str, TableKind)> {
    columns().map(|column| (column.name, column.kind.into()))
}

/// The schema of the file. Every column is optional, as Arrow writes them; those that a row always
/// has are never null.
pub(super) fn schema() -> Result<TypePtr, ParquetError> {
    table_column::schema(table_columns())
}

/// The value of the `huggingface` key.
pub(super) fn features() -> String {
    table_column::features(table_columns())
}

impl From<Kind> for TableKind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Text => Self::Text,
            Kind::Integer => Self::Integer,
            Kind::Number => Self::Number,
            Kind::Numbers(_) => Self::Numbers,
            Kind::Image => Self::Image,
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    #[test]
    fn schema_and_features_have_the_columns_in_order() {
        let schema = schema().unwrap();
        let names: Vec<&str> = schema.get_fields().iter().map(|f| f.name()).collect();
        let expected: Vec<&str> = columns().map(|c| c.name).collect();
        assert_eq!(names, expected);
        let features = features();
        let parsed: Value = serde_json::from_str(&features).unwrap();
        assert_eq!(
            parsed["info"]["features"]["label"]["names"],
            json!(["slip", "stable"])
        );
        let mut at = 0;
        for name in expected {
            let found = features.find(&format!("\"{name}\":")).unwrap();
            assert!(found > at, "{name}");
            at = found;
        }
    }
}
