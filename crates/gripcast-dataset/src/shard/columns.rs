//! Columns of a shard: names, types and order; Parquet schema and Hugging Face features.

use parquet::errors::ParquetError;
use parquet::schema::types::TypePtr;

use super::table_column::{self, ColumnType};
use gripcast_geometry::GraspGeometry;
use gripcast_imaging::ObjectMotion;
use gripcast_shear::{ContactMaps, LiftMotion};

/// One column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    pub(super) name: &'static str,
    pub(super) kind: ColumnType,
    /// Whether it may be null or missing.
    pub(super) nullable: bool,
}

const fn required(name: &'static str, kind: ColumnType) -> Column {
    Column {
        name,
        kind,
        nullable: false,
    }
}

const fn nullable(name: &'static str, kind: ColumnType) -> Column {
    Column {
        name,
        kind,
        nullable: true,
    }
}

/// Columns of `ShardFacts`, in the order of the file.
pub(super) const FACTS: [Column; 26] = [
    required("id", ColumnType::Text),
    required("simulation", ColumnType::Text),
    required("object", ColumnType::Text),
    required("category", ColumnType::Text),
    required("engine", ColumnType::Text),
    required("outcome", ColumnType::Text),
    required("outcome_detail", ColumnType::Text),
    required("label", ColumnType::Int64),
    nullable("stop_force_n", ColumnType::Float64),
    nullable("friction", ColumnType::Float64),
    nullable("mass_kg", ColumnType::Float64),
    nullable("lifted_m", ColumnType::Float64),
    nullable("force_left_n", ColumnType::Float64),
    nullable("force_right_n", ColumnType::Float64),
    nullable("opening_m", ColumnType::Float64),
    nullable("pose_t_m", ColumnType::Float64List(3)),
    nullable("pose_q_wxyz", ColumnType::Float64List(4)),
    nullable("fault", ColumnType::Text),
    required("appearance", ColumnType::Text),
    required("rendering", ColumnType::Int64),
    required("seed", ColumnType::Int64),
    required("crop_profile", ColumnType::Text),
    nullable("geometry_m", ColumnType::Float64List(GraspGeometry::LEN)),
    nullable("lift_motion", ColumnType::Float64List(LiftMotion::LEN)),
    nullable(
        "object_motion",
        ColumnType::Float64List(LiftMotion::FRAMES * ObjectMotion::LEN),
    ),
    nullable("contact_map_m", ColumnType::Float64List(ContactMaps::LEN)),
];

/// Columns of `ShardImages`, after the facts: `<stage>_<role>`.
pub(super) const IMAGES: [Column; 7] = [
    required("initial_left", ColumnType::Image),
    required("initial_right", ColumnType::Image),
    required("grasp_left", ColumnType::Image),
    required("grasp_right", ColumnType::Image),
    required("grasp_rgb", ColumnType::Image),
    nullable("initial_rgb", ColumnType::Image),
    nullable("grasp_depth", ColumnType::Image),
];

/// Returns all columns in the order of the file.
pub(super) fn columns() -> impl Iterator<Item = &'static Column> {
    FACTS.iter().chain(&IMAGES)
}

/// Returns all columns as columns of a table.
pub(super) fn table_columns() -> impl Iterator<Item = (&'static str, ColumnType)> {
    columns().map(|column| (column.name, column.kind))
}

/// Returns the schema of a shard. Every column is optional, as in Arrow; required ones are never
/// null.
pub(super) fn schema() -> Result<TypePtr, ParquetError> {
    table_column::schema(table_columns())
}

/// Returns the value of the `huggingface` key.
pub(super) fn features() -> String {
    table_column::features(table_columns())
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    #[test]
    fn schema_and_features_list_columns_in_order() {
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
