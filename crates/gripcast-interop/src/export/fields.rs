//! Which field arrays an export can carry, and the values of grasps that lack one.

use std::collections::{BTreeMap, BTreeSet};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::npy::Array;
use gripcast_dataset::{FieldName, FieldRecord, GraspRecord, MARKERS, Stage};
use gripcast_imaging::{PixelFormat, Role};

/// Field of a gel.
pub(super) type FieldKey = (Role, FieldName);

/// Survey of one field of one gel over the selected grasps.
#[derive(Clone, Debug)]
pub(super) struct FieldCounts {
    /// Number of grasps with the field, by stage.
    pub(super) grasps: BTreeMap<Stage, usize>,
    /// Shapes of the arrays.
    shapes: BTreeSet<Vec<usize>>,
    /// Names of the components.
    pub(super) columns: Vec<String>,
    /// Units of the components.
    pub(super) units: Vec<String>,
    /// Frame of the coordinates.
    pub(super) frame: String,
    /// Whether all grasps agree about components, units and frame.
    agrees: bool,
}

impl FieldCounts {
    fn new(field: &FieldRecord) -> Self {
        Self {
            grasps: BTreeMap::new(),
            shapes: BTreeSet::new(),
            columns: field.columns.clone(),
            units: field.units.clone(),
            frame: field.frame.clone(),
            agrees: true,
        }
    }

    fn add(&mut self, stage: Stage, field: &FieldRecord) {
        *self.grasps.entry(stage).or_default() += 1;
        self.shapes.insert(field.shape.clone());
        self.agrees &=
            self.columns == field.columns && self.units == field.units && self.frame == field.frame;
    }

    /// The shape that all grasps share.
    fn shape(&self) -> Option<&[usize]> {
        let mut shapes = self.shapes.iter();
        let first = shapes.next()?;
        (shapes.next().is_none() && self.agrees).then_some(first)
    }

    /// The number of dimensions that all grasps share.
    pub(super) fn dimensions(&self) -> Option<usize> {
        let mut dimensions = self.shapes.iter().map(Vec::len);
        let first = dimensions.next()?;
        (first > 0 && dimensions.all(|n| n == first)).then_some(first)
    }
}

/// Fields of the selected grasps.
#[derive(Clone, Debug, Default)]
pub(super) struct FieldSurvey(BTreeMap<FieldKey, FieldCounts>);

impl FieldSurvey {
    pub(super) fn add(&mut self, record: &GraspRecord) {
        for (stage, frames) in record.stages() {
            for (role, fields) in &frames.fields {
                for (name, field) in fields {
                    let counts = self.0.entry((*role, name.clone()));
                    let counts = counts.or_insert_with(|| FieldCounts::new(field));
                    counts.add(stage, field);
                }
            }
        }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (&FieldKey, &FieldCounts)> {
        self.0.iter()
    }

    /// Fields of one shape in all grasps that have them, and a note for each other one: some formats
    /// have one shape for all.
    pub(super) fn of_one_shape(&self) -> (Vec<UniformField>, Vec<String>) {
        let (mut uniform, mut notes) = (Vec::new(), Vec::new());
        for (key, counts) in &self.0 {
            match counts.shape() {
                Some(shape) => uniform.push(UniformField {
                    key: key.clone(),
                    shape: shape.to_vec(),
                    counts: counts.clone(),
                }),
                None => notes.push(format!(
                    "field {} of {} left out: its arrays have different shapes, components or units",
                    key.1, key.0
                )),
            }
        }
        (uniform, notes)
    }
}

/// A field whose arrays all have one shape.
#[derive(Clone, Debug)]
pub(super) struct UniformField {
    pub(super) key: FieldKey,
    pub(super) shape: Vec<usize>,
    pub(super) counts: FieldCounts,
}

impl UniformField {
    /// The array of a grasp; NaN where it has none.
    ///
    /// # Errors
    /// `Input`: the record was changed during the export.
    pub(super) fn of(&self, fields: &Fields, stage: Stage) -> Result<Array> {
        let (role, name) = &self.key;
        match fields.get(&(stage, *role, name.clone())) {
            Some(array) if array.shape() == self.shape => Ok(array.clone()),
            Some(_) => Err(Error::input(format!(
                "the field {name} of {role} was changed"
            ))),
            None => Array::new(
                self.shape.clone(),
                vec![f32::NAN; self.shape.iter().product()],
            ),
        }
    }
}

/// Field arrays of a grasp.
pub(super) type Fields = BTreeMap<(Stage, Role, FieldName), Array>;

/// Name of a field in the features of LeRobot: `left` for the markers of the left gel,
/// `left.NAME` for other fields.
pub(super) fn tactile_name((role, name): &FieldKey) -> String {
    if *name == MARKERS {
        role.to_string()
    } else {
        format!("{role}.{name}")
    }
}

/// Survey of the lift frames of one gel.
#[derive(Clone, Debug, Default)]
pub(super) struct LiftCounts {
    /// Number of grasps with lift frames.
    pub(super) grasps: usize,
    /// Number of those whose frames are JPEG; the others are PNG.
    pub(super) jpegs: usize,
}

impl LiftCounts {
    pub(super) fn survey(lifts: &mut BTreeMap<Role, Self>, record: &GraspRecord) {
        for (role, lift) in record.lift.iter().flat_map(|lift| &lift.cameras) {
            let counts = lifts.entry(*role).or_default();
            counts.grasps += 1;
            counts.jpegs += usize::from(lift.format == PixelFormat::Mjpg);
        }
    }
}
