//! Field arrays: what was measured all over a gel, such as the motion of its markers, as `.npy`
//! files beside the images.

use serde::{Deserialize, Serialize};

use super::layout::Stage;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::npy::{Array, DTYPE};
use gripcast_base::files::{FieldName, FileName};
use gripcast_imaging::Role;

/// Name of the field of gel markers.
pub const MARKERS: &str = "markers";
/// Columns of the field of gel markers and their units.
const MARKER_COLUMNS: [(&str, &str); 5] = [
    ("rest_x_px", "px"),
    ("rest_y_px", "px"),
    ("dx_px", "px"),
    ("dy_px", "px"),
    ("confidence", "1"),
];
/// Frame of pixel coordinates: x right, y down, origin in the centre of the top-left pixel of the
/// cropped image at the models' size, 320×240.
const SENSOR_IMAGE: &str = "sensor_image";
/// Maximum length of a name of a column, a unit or a frame, bytes.
const MAX_WORD_BYTES: usize = 64;

/// A field of one gel at one trigger, with its values.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldArray {
    /// Camera of the gel.
    pub role: Role,
    /// Name of the field.
    pub name: FieldName,
    /// Names of the components: the last dimension.
    pub columns: Vec<String>,
    /// Unit of each component; `1` where it has none.
    pub units: Vec<String>,
    /// Frame of the coordinates.
    pub frame: String,
    /// Metres per pixel, where the units are pixels.
    pub m_per_px: Option<f64>,
    /// Values; NaN where there is none.
    pub values: Array,
}

impl FieldArray {
    /// The field of gel markers: rows × columns of the lattice × (rest position x, y, displacement
    /// x, y, confidence), px.
    ///
    /// # Errors
    /// `Input` where the number of values is not the product of the shape.
    pub fn markers(role: Role, values: Vec<f32>, shape: [usize; 3], m_per_px: f64) -> Result<Self> {
        Ok(Self {
            role,
            name: FieldName::parse(MARKERS)?,
            columns: MARKER_COLUMNS.map(|(name, _)| name.to_owned()).to_vec(),
            units: MARKER_COLUMNS.map(|(_, unit)| unit.to_owned()).to_vec(),
            frame: SENSOR_IMAGE.to_owned(),
            m_per_px: Some(m_per_px),
            values: Array::new(shape, values)?,
        })
    }

    /// The record of the field at a stage.
    ///
    /// # Errors
    /// `Input` where it does not describe the values.
    pub(super) fn record(&self, stage: Stage) -> Result<FieldRecord> {
        let words = [stage.name(), self.role.name(), self.name.as_str(), "npy"];
        let record = FieldRecord {
            file: FileName::from_words(&words),
            shape: self.values.shape().to_vec(),
            dtype: DTYPE.to_owned(),
            columns: self.columns.clone(),
            units: self.units.clone(),
            frame: self.frame.clone(),
            m_per_px: self.m_per_px,
        };
        match record.fault() {
            Some(fault) => Err(Error::input(fault).at(&record.file)),
            None => Ok(record),
        }
    }
}

/// A field of one gel at one trigger, as the record describes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldRecord {
    /// File name inside the grasp's directory.
    pub file: FileName,
    /// Size of each dimension, the slowest first; the last one are the components.
    pub shape: Vec<usize>,
    /// Type of the values, as NumPy names it: `<f4`.
    pub dtype: String,
    /// Names of the components.
    pub columns: Vec<String>,
    /// Unit of each component; `1` where it has none.
    pub units: Vec<String>,
    /// Frame of the coordinates: `sensor_image`, `gel`.
    pub frame: String,
    /// Metres per pixel, where the units are pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub m_per_px: Option<f64>,
}

impl FieldRecord {
    /// Reads the values from the contents of the file.
    ///
    /// # Errors
    /// `Input`: it is not the array of the record.
    pub(super) fn parse(&self, bytes: &[u8]) -> Result<Array> {
        if let Some(fault) = self.fault() {
            return Err(Error::input(fault));
        }
        let array = Array::from_npy(bytes)?;
        if array.shape() != self.shape {
            let (expected, found) = (&self.shape, array.shape());
            return Err(Error::input(format!(
                "expected an array of shape {expected:?} as recorded, found {found:?}"
            )));
        }
        Ok(array)
    }

    /// What is wrong with the description itself.
    fn fault(&self) -> Option<String> {
        let components = self.shape.last().copied().unwrap_or(0);
        if self.dtype != DTYPE {
            return Some(format!(
                "expected values of type {DTYPE}, found {:.20}",
                self.dtype
            ));
        }
        if self.columns.len() != components || self.units.len() != components {
            return Some(format!(
                "expected names and units of {components} components, found {} names and {} units",
                self.columns.len(),
                self.units.len()
            ));
        }
        let words = self.columns.iter().chain(&self.units).chain([&self.frame]);
        let is_word = |text: &&String| {
            (1..=MAX_WORD_BYTES).contains(&text.len()) && !text.chars().any(char::is_control)
        };
        let wrong = words.into_iter().find(|text| !is_word(text))?;
        Some(format!("expected a short name or unit, found {wrong:.80?}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn record_describes_the_values() {
        let field = FieldArray::markers(Role::Left, vec![0.5; 30], [2, 3, 5], 2.9e-5).unwrap();
        let record = field.record(Stage::Grasp).unwrap();
        assert_eq!(record.file, "grasp.left.markers.npy");
        assert_eq!(record.shape, [2, 3, 5]);
        let npy = field.values.to_npy();
        assert_eq!(record.parse(&npy).unwrap(), field.values);
        let other = Array::new([3, 2, 5], vec![0.5; 30]).unwrap();
        let error = record.parse(&other.to_npy()).unwrap_err().to_string();
        assert!(
            error.contains("[2, 3, 5]") && error.contains("[3, 2, 5]"),
            "{error}"
        );
        assert!(record.parse(&npy[..npy.len() - 1]).is_err());

        let mut short = field.clone();
        short.columns.pop();
        let error = short.record(Stage::Grasp).unwrap_err().to_string();
        assert!(error.contains("4 names and 5 units"), "{error}");
        let mut torn = field;
        torn.units[0] = "p\nx".into();
        assert!(torn.record(Stage::Grasp).is_err());
        assert!(FieldArray::markers(Role::Left, vec![0.0; 29], [2, 3, 5], 1.0).is_err());
    }
}
