//! Tracked frames as a table or an array.

use std::fmt::Write as _;
use std::path::Path;

use super::flags::suffix;
use gripcast_base::error::Result;
use gripcast_base::files::{BeneathPath, npy, save};
use gripcast_dataset::shard::{ColumnType, TableCell as Cell, TableWriter};
use gripcast_shear::{MarkerField, ShearFrame};

/// Suffixes of the outputs.
pub(super) const SUFFIXES: [&str; 3] = ["csv", "parquet", "npy"];

/// Columns of gel markers that are integers: frame, row, column.
const INDICES: usize = 3;
/// Columns of a table of gel markers.
const MARKER_COLUMNS: [&str; 15] = [
    "frame",
    "row",
    "column",
    "rest_x_px",
    "rest_y_px",
    "dx_px",
    "dy_px",
    "dx_m",
    "dy_m",
    "confidence",
    "strain_xx",
    "strain_yy",
    "strain_xy",
    "divergence",
    "curl",
];
/// Columns of a table of texture: one row a frame.
const TEXTURE_COLUMNS: [&str; 7] = [
    "frame",
    "dx_px",
    "dy_px",
    "dx_m",
    "dy_m",
    "curl",
    "confidence",
];

/// A tracked frame with its number.
pub(super) struct TrackedFrame {
    pub(super) number: usize,
    pub(super) shear: ShearFrame,
}

/// What the lengths in m are computed with.
#[derive(Clone, Copy)]
pub(super) struct Scale {
    /// Scale that the tracker got, m/px.
    pub(super) m_per_px: f64,
    /// Whether the user gave it; else lengths in m are empty.
    pub(super) is_known: bool,
}

impl Scale {
    fn metres(self, px: f64) -> f64 {
        if self.is_known {
            self.m_per_px * px
        } else {
            f64::NAN
        }
    }
}

/// Writes the frames in the format that the suffix of `path` names.
///
/// # Errors
/// Those of writing the file.
pub(super) fn write(path: &Path, frames: &[TrackedFrame], scale: Scale) -> Result<()> {
    match suffix(path).as_str() {
        "npy" => save(path, &array(frames)?.to_npy()),
        "parquet" => write_parquet(path, frames, scale),
        _ => save(path, csv(frames, scale).as_bytes()),
    }
}

/// Whether the frames have gel markers.
fn has_markers(frames: &[TrackedFrame]) -> bool {
    frames.iter().any(|frame| frame.shear.field.is_some())
}

fn columns(frames: &[TrackedFrame]) -> (&'static [&'static str], usize) {
    match has_markers(frames) {
        true => (&MARKER_COLUMNS, INDICES),
        false => (&TEXTURE_COLUMNS, 1),
    }
}

/// Calls `visit` with each row; NaN where nothing is known.
fn visit_rows(
    frames: &[TrackedFrame],
    scale: Scale,
    mut visit: impl FnMut(&[f64]) -> Result<()>,
) -> Result<()> {
    let is_markers = has_markers(frames);
    for frame in frames {
        match &frame.shear.field {
            Some(field) => {
                for at in 0..field.markers.len() {
                    if let Some(row) = marker_row(frame.number, field, at, scale) {
                        visit(&row)?;
                    }
                }
            }
            None if !is_markers => visit(&texture_row(frame, scale))?,
            None => {}
        }
    }
    Ok(())
}

fn marker_row(number: usize, field: &MarkerField, at: usize, scale: Scale) -> Option<[f64; 15]> {
    let marker = field.markers[at]?;
    let (row, column) = (at / field.columns, at % field.columns);
    let [dx, dy] = match marker.confidence > 0.0 {
        true => marker.displacement_px().map(f64::from),
        false => [f64::NAN; 2],
    };
    let unknown = [[f32::NAN; 2]; 2];
    let [[xx, xy], [yx, yy]] = field
        .gradient(column, row)
        .unwrap_or(unknown)
        .map(|g| g.map(f64::from));
    Some([
        number as f64,
        row as f64,
        column as f64,
        f64::from(marker.rest_px[0]),
        f64::from(marker.rest_px[1]),
        dx,
        dy,
        scale.metres(dx),
        scale.metres(dy),
        f64::from(marker.confidence),
        xx,
        yy,
        0.5 * (xy + yx),
        xx + yy,
        yx - xy,
    ])
}

fn texture_row(frame: &TrackedFrame, scale: Scale) -> [f64; 7] {
    let summary = frame.shear.summary;
    let px = |axis: usize| {
        let mm = summary.map_or(f64::NAN, |s| s.mean_displacement_mm[axis]);
        mm / (1e3 * scale.m_per_px)
    };
    let (dx, dy) = (px(0), px(1));
    [
        frame.number as f64,
        dx,
        dy,
        scale.metres(dx),
        scale.metres(dy),
        summary.map_or(f64::NAN, |s| s.curl),
        summary.map_or(0.0, |s| s.confidence),
    ]
}

fn csv(frames: &[TrackedFrame], scale: Scale) -> String {
    let (names, indices) = columns(frames);
    let mut text = names.join(",");
    text.push('\n');
    // Rows of this writer never fail.
    let _ = visit_rows(frames, scale, |row| {
        for (i, value) in row.iter().enumerate() {
            let comma = if i > 0 { "," } else { "" };
            let _ = match value {
                value if value.is_nan() => write!(text, "{comma}"),
                value if i < indices => write!(text, "{comma}{value}"),
                // Single precision: what was measured.
                value => write!(text, "{comma}{}", *value as f32),
            };
        }
        text.push('\n');
        Ok(())
    });
    text
}

fn write_parquet(path: &Path, frames: &[TrackedFrame], scale: Scale) -> Result<()> {
    let (names, indices) = columns(frames);
    let columns = names.iter().enumerate().map(|(i, name)| {
        let kind = if i < indices {
            ColumnType::Int64
        } else {
            ColumnType::Float32
        };
        ((*name).to_owned(), kind)
    });
    let mut table = TableWriter::create(BeneathPath::from_user_path(path), columns.collect(), &[])?;
    visit_rows(frames, scale, |row| {
        let cells = row.iter().enumerate().map(|(i, value)| match value {
            value if value.is_nan() => Cell::Null,
            value if i < indices => Cell::Integer(*value as i64),
            value => Cell::Number(*value),
        });
        table.push(cells.collect())
    })?;
    table.finish().map(|_| ())
}

/// Frames × rows × columns × 5 as [`MarkerField::to_array`]; for texture, frames × 4: dx, dy (px),
/// curl, confidence.
fn array(frames: &[TrackedFrame]) -> Result<npy::Array> {
    let field = frames.iter().find_map(|frame| frame.shear.field.as_ref());
    let Some(field) = field else {
        let scale = Scale {
            m_per_px: 1e-3,
            is_known: false,
        };
        let rows = frames.iter().flat_map(|frame| {
            let [_, dx, dy, _, _, curl, confidence] = texture_row(frame, scale);
            [dx, dy, curl, confidence].map(|value| value as f32)
        });
        return npy::Array::new(vec![frames.len(), 4], rows.collect());
    };
    let shape = field.to_array().1;
    let size = shape.iter().product();
    let values = frames.iter().flat_map(|frame| match &frame.shear.field {
        Some(field) => field.to_array().0,
        None => vec![f32::NAN; size],
    });
    npy::Array::new(
        [vec![frames.len()], shape.to_vec()].concat(),
        values.collect(),
    )
}
