//! A sample of a shard.

use std::fmt;

use glam::DQuat;

use super::cell::{Cell, Cells, column_error};
use gripcast_base::error::Result;
use gripcast_geometry::{GraspGeometry, Pose};
use gripcast_imaging::ObjectMotion;
use gripcast_shear::{ContactMaps, GelMotion, LiftMotion};

/// Tolerance of a unit quaternion's norm.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Smallest positive number.
const ABOVE_0: f64 = f64::MIN_POSITIVE;
/// Signature of PNG files.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Signature of JPEG files.
const JPEG: &[u8] = b"\xff\xd8\xff";

/// One grasp, real or a rendering of a simulated one: scalar columns and images.
#[derive(Clone, Debug, PartialEq)]
pub struct ShardRow {
    /// Columns other than the images.
    pub facts: ShardFacts,
    /// Encoded images.
    pub images: ShardImages,
}

/// A sample without its images. Columns are named like the fields unless stated otherwise. Fields
/// unknown for a real grasp are none.
#[derive(Clone, Debug, PartialEq)]
pub struct ShardFacts {
    /// Id of the sample, not empty, unique in its dataset.
    pub id: String,
    /// Id of the simulation, shared by its renderings; the grasp id of a real grasp. Not empty.
    pub simulation: String,
    /// Object to grasp, not empty.
    pub object: String,
    /// Category of the object.
    pub category: String,
    /// Simulator that determined the outcome, or reality.
    pub engine: ShardEngine,
    /// Outcome of the lift; also the column `label`: 0 slip, 1 stable.
    pub outcome: ShardOutcome,
    /// Simulation outcome: `success`, `slip`, `eject`, ….
    pub outcome_detail: String,
    /// Stopping force: mean normal force at which the fingers stop closing, N, > 0.
    pub stop_force_n: Option<f64>,
    /// Coefficient of friction between gel and object, ≥ 0.
    pub friction: Option<f64>,
    /// Mass of the object, kg, > 0.
    pub mass_kg: Option<f64>,
    /// Rise of the object's centre of mass from the ground to the end of the lift, m.
    pub lifted_m: Option<f64>,
    /// Normal force on the left finger in the grasp, N, ≥ 0.
    pub force_left_n: Option<f64>,
    /// Normal force on the right finger in the grasp, N, ≥ 0.
    pub force_right_n: Option<f64>,
    /// Distance between the gels' front faces in the grasp, m.
    pub opening_m: Option<f64>,
    /// Maps gripper coordinates into the object frame; columns `pose_t_m` (m) and `pose_q_wxyz`
    /// (unit quaternion, w ≥ 0).
    pub t_object_gripper: Option<Pose>,
    /// Extents of the object in the gripper frame; column `geometry_m` with the values of
    /// [`GraspGeometry::to_array`].
    pub geometry: Option<GraspGeometry>,
    /// What is seen in the lift; column `lift_motion` with the values of
    /// [`LiftMotion::gel_values`], column `object_motion` with those of
    /// [`LiftMotion::object_values`].
    pub lift: Option<LiftMotion>,
    /// Displacement of the gels' faces in the grasp; column `contact_map_m` with the values of
    /// [`ContactMaps::values`].
    pub contact: Option<ContactMaps>,
    /// Planned deviation from an antipodal grasp: `none`, `off_centre`, `tilted`, …; none for a
    /// grasp from outside the plan.
    pub fault: Option<String>,
    /// Appearance of object and scene.
    pub appearance: String,
    /// Index of the rendering of its simulation, from 0.
    pub rendering: u32,
    /// Seed of the rendering, below 2⁶³ (stored as a signed integer).
    pub seed: u64,
    /// Crop profile of the tactile images.
    pub crop_profile: String,
}

/// Encoded images of a sample, PNG or JPEG, of the two stages of the cycle.
#[derive(Clone, Debug, PartialEq)]
pub struct ShardImages {
    /// Left tactile sensor (−x of the gripper frame) before the fingers close.
    pub initial_left: Vec<u8>,
    /// Right tactile sensor (+x of the gripper frame) before the fingers close.
    pub initial_right: Vec<u8>,
    /// Left tactile sensor in the grasp, before the lift.
    pub grasp_left: Vec<u8>,
    /// Right tactile sensor in the grasp, before the lift.
    pub grasp_right: Vec<u8>,
    /// Colour camera between the fingers in the grasp.
    pub grasp_rgb: Vec<u8>,
    /// Colour camera between the fingers before the fingers close.
    pub initial_rgb: Option<Vec<u8>>,
    /// Depth camera between the fingers in the grasp: 16-bit PNG, mm.
    pub grasp_depth: Option<Vec<u8>>,
}

/// Origin of the outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ShardEngine {
    /// Simulator with finite-element gels.
    Fem,
    /// Simulator with rigid fingers.
    Rigid,
    /// A real lift.
    Real,
}

/// Outcome of a lift; the number is the label.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ShardOutcome {
    /// The object slipped, fell or was squeezed out.
    Slip = 0,
    /// The object stayed in the gripper.
    Stable = 1,
}

impl ShardEngine {
    /// All engines.
    pub const ALL: [Self; 3] = [Self::Fem, Self::Rigid, Self::Real];

    /// Name in shards.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fem => "fem",
            Self::Rigid => "rigid",
            Self::Real => "real",
        }
    }
}

impl ShardOutcome {
    /// Both outcomes, in the order of the labels.
    pub const ALL: [Self; 2] = [Self::Slip, Self::Stable];

    /// Name in shards.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Slip => "slip",
            Self::Stable => "stable",
        }
    }

    /// Label: 0 slip, 1 stable.
    #[must_use]
    pub fn label(self) -> i64 {
        self as i64
    }
}

impl fmt::Display for ShardEngine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl fmt::Display for ShardOutcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl ShardFacts {
    /// Cells in the order of the columns.
    pub(super) fn cells(&self) -> Vec<Cell<'_>> {
        let [t_m, q_wxyz] = match &self.t_object_gripper {
            None => [Cell::Null, Cell::Null],
            Some(pose) => {
                let (t_m, q_wxyz) = pose_numbers(pose);
                [Cell::Numbers(t_m.to_vec()), Cell::Numbers(q_wxyz.to_vec())]
            }
        };
        vec![
            Cell::text(&self.id),
            Cell::text(&self.simulation),
            Cell::text(&self.object),
            Cell::text(&self.category),
            Cell::text(self.engine.name()),
            Cell::text(self.outcome.name()),
            Cell::text(&self.outcome_detail),
            Cell::Integer(self.outcome.label()),
            Cell::optional_number(self.stop_force_n),
            Cell::optional_number(self.friction),
            Cell::optional_number(self.mass_kg),
            Cell::optional_number(self.lifted_m),
            Cell::optional_number(self.force_left_n),
            Cell::optional_number(self.force_right_n),
            Cell::optional_number(self.opening_m),
            t_m,
            q_wxyz,
            Cell::optional_text(self.fault.as_deref()),
            Cell::text(&self.appearance),
            Cell::Integer(i64::from(self.rendering)),
            Cell::Integer(self.seed.cast_signed()),
            Cell::text(&self.crop_profile),
            self.geometry.map_or(Cell::Null, |geometry| {
                Cell::Numbers(geometry.to_array().to_vec())
            }),
            self.lift
                .as_ref()
                .map_or(Cell::Null, |lift| Cell::Numbers(lift.gel_values())),
            self.lift
                .as_ref()
                .and_then(LiftMotion::object_values)
                .map_or(Cell::Null, Cell::Numbers),
            self.contact
                .as_ref()
                .map_or(Cell::Null, |maps| Cell::Numbers(maps.values().to_vec())),
        ]
    }

    /// Reads cells in the order of the columns.
    pub(super) fn from_cells(cells: &mut Cells<'_>) -> Result<Self> {
        let [id, simulation, object, category] =
            [cells.text()?, cells.text()?, cells.text()?, cells.text()?];
        let engine = cells.named(&ShardEngine::ALL.map(|e| (e.name(), e)))?;
        let outcome = cells.named(&ShardOutcome::ALL.map(|o| (o.name(), o)))?;
        let outcome_detail = cells.text()?;
        let label = cells.integer()?;
        if label != outcome.label() {
            let expected = outcome.label();
            let what = format!("is {label}, expected {expected} for outcome {outcome}");
            return Err(column_error("label", what));
        }
        Ok(Self {
            id,
            simulation,
            object,
            category,
            engine,
            outcome,
            outcome_detail,
            stop_force_n: cells.optional_number()?,
            friction: cells.optional_number()?,
            mass_kg: cells.optional_number()?,
            lifted_m: cells.optional_number()?,
            force_left_n: cells.optional_number()?,
            force_right_n: cells.optional_number()?,
            opening_m: cells.optional_number()?,
            t_object_gripper: optional_pose(cells)?,
            fault: cells.optional_text()?,
            appearance: cells.text()?,
            rendering: cells.natural()?,
            seed: cells.natural()?,
            crop_profile: cells.text()?,
            geometry: cells.optional_numbers()?.map(geometry).transpose()?,
            lift: lift_motion(cells.optional_numbers()?, cells.optional_numbers()?)?,
            contact: cells.optional_numbers()?.map(contact_maps).transpose()?,
        })
    }

    /// # Errors
    /// `Input`: the first field with an invalid value.
    pub(super) fn check(&self) -> Result<()> {
        for (name, text) in [
            ("id", &self.id),
            ("simulation", &self.simulation),
            ("object", &self.object),
        ] {
            if text.is_empty() {
                return Err(column_error(name, "is empty"));
            }
        }
        // Lower bounds.
        let bounds = [
            ("stop_force_n", self.stop_force_n, ABOVE_0),
            ("friction", self.friction, 0.0),
            ("mass_kg", self.mass_kg, ABOVE_0),
            ("lifted_m", self.lifted_m, f64::MIN),
            ("force_left_n", self.force_left_n, 0.0),
            ("force_right_n", self.force_right_n, 0.0),
            ("opening_m", self.opening_m, f64::MIN),
        ];
        for (name, value, min) in bounds {
            if let Some(value) = value.filter(|v| !(min..=f64::MAX).contains(v)) {
                let expected = match min {
                    ABOVE_0 => " above 0",
                    0.0 => " of at least 0",
                    _ => "",
                };
                let what = format!("is {value}, expected a finite number{expected}");
                return Err(column_error(name, what));
            }
        }
        if i64::try_from(self.seed).is_err() {
            return Err(column_error(
                "seed",
                format!("is {}, expected a value below 2^63", self.seed),
            ));
        }
        let extents = self.geometry.iter().flat_map(|g| g.to_array());
        if let Some(value) = extents.into_iter().find(|value| !value.is_finite()) {
            let what = format!("has {value}, expected finite numbers");
            return Err(column_error("geometry_m", what));
        }
        if !self.lift.as_ref().is_none_or(LiftMotion::is_finite) {
            return Err(column_error(
                "lift_motion",
                "has a number that is not finite",
            ));
        }
        let Some(stored) = &self.t_object_gripper else {
            return Ok(());
        };
        let (t_m, q_wxyz) = pose_numbers(stored);
        pose(&t_m, &q_wxyz).map(|_| ())
    }
}

impl ShardImages {
    /// Cells in the order of the columns.
    pub(super) fn cells(&self) -> Vec<Cell<'_>> {
        vec![
            Cell::image(&self.initial_left),
            Cell::image(&self.initial_right),
            Cell::image(&self.grasp_left),
            Cell::image(&self.grasp_right),
            Cell::image(&self.grasp_rgb),
            Cell::optional_image(self.initial_rgb.as_deref()),
            Cell::optional_image(self.grasp_depth.as_deref()),
        ]
    }

    /// Reads cells in the order of the columns.
    pub(super) fn from_cells(cells: &mut Cells<'_>) -> Result<Self> {
        Ok(Self {
            initial_left: cells.image()?,
            initial_right: cells.image()?,
            grasp_left: cells.image()?,
            grasp_right: cells.image()?,
            grasp_rgb: cells.image()?,
            initial_rgb: cells.optional_image()?,
            grasp_depth: cells.optional_image()?,
        })
    }
}

impl ShardRow {
    /// Approximate size in a shard, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.cells().iter().map(Cell::size).sum()
    }

    /// Cells in the order of the columns.
    pub(super) fn cells(&self) -> Vec<Cell<'_>> {
        let mut cells = self.facts.cells();
        cells.extend(self.images.cells());
        cells
    }
}

/// File extension of an encoded image; none when it is neither PNG nor JPEG.
pub(super) fn image_extension(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        _ if bytes.starts_with(PNG) => Some("png"),
        _ if bytes.starts_with(JPEG) => Some("jpg"),
        _ => None,
    }
}

/// Returns the translation, and the rotation as w, x, y, z.
fn pose_numbers(pose: &Pose) -> ([f64; 3], [f64; 4]) {
    let q = pose.rotation;
    (pose.translation_m.to_array(), [q.w, q.x, q.y, q.z])
}

/// Reads the pose; none where both columns are null.
fn optional_pose(cells: &mut Cells<'_>) -> Result<Option<Pose>> {
    match (cells.optional_numbers()?, cells.optional_numbers()?) {
        (None, None) => Ok(None),
        (Some(t_m), Some(q_wxyz)) => pose(&t_m, &q_wxyz).map(Some),
        (None, Some(_)) => Err(column_error("pose_t_m", "is null, pose_q_wxyz is not")),
        (Some(_), None) => Err(column_error("pose_q_wxyz", "is null, pose_t_m is not")),
    }
}

fn lift_motion(gels: Option<Vec<f64>>, object: Option<Vec<f64>>) -> Result<Option<LiftMotion>> {
    let Some(gels) = gels else {
        return match object {
            None => Ok(None),
            Some(_) => Err(column_error("lift_motion", "is null, object_motion is not")),
        };
    };
    let motion = LiftMotion::from_gel_values(&gels).ok_or_else(|| {
        let what = format!(
            "has {} numbers, expected {} per image and at most {}, finite but for slip ratios",
            gels.len(),
            2 * GelMotion::LEN,
            LiftMotion::LEN
        );
        column_error("lift_motion", what)
    })?;
    let Some(object) = object else {
        return Ok(Some(motion));
    };
    let expected = ObjectMotion::LEN * motion.images.len();
    let with_object = motion.with_object_values(&object).ok_or_else(|| {
        let found = object.len();
        let what = format!(
            "has {found} numbers, expected {} per image of `lift_motion` ({expected}), none infinite",
            ObjectMotion::LEN
        );
        column_error("object_motion", what)
    });
    with_object.map(Some)
}

fn contact_maps(values: Vec<f64>) -> Result<ContactMaps> {
    let count = values.len();
    ContactMaps::new(values).ok_or_else(|| {
        let expected = ContactMaps::LEN;
        let what = format!("has {count} numbers, expected {expected}, all finite");
        column_error("contact_map_m", what)
    })
}

fn geometry(values: Vec<f64>) -> Result<GraspGeometry> {
    let found = values.len();
    match values.try_into() {
        Ok(values) => Ok(GraspGeometry::from_array(values)),
        Err(_) => Err(column_error(
            "geometry_m",
            format!("has {found} numbers, expected {}", GraspGeometry::LEN),
        )),
    }
}

fn pose(t_m: &[f64], q_wxyz: &[f64]) -> Result<Pose> {
    let (&[x, y, z], &[qw, qx, qy, qz]) = (t_m, q_wxyz) else {
        return Err(column_error(
            "pose_t_m",
            "and pose_q_wxyz need 3 and 4 numbers",
        ));
    };
    let translation_m = glam::DVec3::new(x, y, z);
    if !translation_m.is_finite() {
        return Err(column_error(
            "pose_t_m",
            format!("is {t_m:?}, expected finite numbers"),
        ));
    }
    let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
    // False for NaN.
    let is_unit = (rotation.length() - 1.0).abs() <= UNIT_TOLERANCE;
    if !is_unit {
        return Err(column_error(
            "pose_q_wxyz",
            format!("is {q_wxyz:?}, expected a unit quaternion"),
        ));
    }
    Ok(Pose::new(rotation, translation_m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incomplete_contact_map_is_refused() {
        let values = vec![1e-4; ContactMaps::LEN];
        assert_eq!(contact_maps(values.clone()).unwrap().values(), values);
        let error = contact_maps(values[1..].to_vec()).unwrap_err().to_string();
        assert!(error.contains("contact_map_m"), "{error}");
        assert!(error.contains("479 numbers, expected 480"), "{error}");
        let damaged = [&values[1..], &[f64::NAN]].concat();
        assert!(contact_maps(damaged).is_err());
    }

    #[test]
    fn motion_of_the_object_must_belong_to_the_images() {
        let gels = vec![0.0; 2 * 2 * GelMotion::LEN];
        let read = |object| lift_motion(Some(gels.clone()), object);
        assert_eq!(read(None).unwrap().unwrap().images.len(), 2);
        let found = read(Some(vec![0.5, f64::NAN, 0.0, f64::NAN, f64::NAN, f64::NAN]));
        let images = found.unwrap().unwrap().images;
        assert_eq!(images[0].object.unwrap().between_mm, Some(0.5));
        assert_eq!(images[1].object, None);
        for wrong in [vec![0.0; 3], vec![f64::INFINITY; 6]] {
            let error = read(Some(wrong)).unwrap_err().to_string();
            assert!(
                error.contains("object_motion") && error.contains("(6)"),
                "{error}"
            );
        }
        assert_eq!(lift_motion(None, None).unwrap(), None);
        let error = lift_motion(None, Some(vec![0.0; 3])).unwrap_err();
        assert!(error.to_string().contains("is null"), "{error}");
    }
}
