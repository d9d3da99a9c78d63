//! The files of a grasp beside its record, and what each must contain.

use std::collections::BTreeMap;

use super::field::FieldRecord;
use super::grasp::{CameraRecord, GraspRecord};
use super::image_file;
use super::lift::LiftCamera;

/// What a file of a grasp is.
#[derive(Clone, Copy, Debug)]
pub(super) enum StoredFile<'a> {
    /// An image.
    Image(&'a CameraRecord),
    /// A field array.
    Field(&'a FieldRecord),
    /// The lift frames of a camera.
    Lift(&'a LiftCamera),
}

impl StoredFile<'_> {
    /// Returns the defect of the contents; `None` where they are as recorded.
    pub(super) fn defect(self, bytes: &[u8]) -> Option<String> {
        match self {
            Self::Image(camera) => {
                image_file::defect(bytes, camera.format, camera.width, camera.height)
            }
            Self::Field(field) => field.parse(bytes).err().map(|e| e.what().to_owned()),
            Self::Lift(lift) => lift.split(bytes).err().map(|e| e.to_string()),
        }
    }
}

impl GraspRecord {
    /// Files that the record describes, by name.
    pub(super) fn stored_files(&self) -> BTreeMap<&str, StoredFile<'_>> {
        let stages = || self.stages().into_iter().map(|(_, stage)| stage);
        let cameras = stages()
            .flat_map(|stage| stage.cameras.values())
            .chain(&self.pre_grasp_frames)
            .map(|camera| (camera.file.as_str(), StoredFile::Image(camera)));
        let fields = stages()
            .flat_map(|stage| stage.fields.values().flat_map(BTreeMap::values))
            .map(|field| (field.file.as_str(), StoredFile::Field(field)));
        let lifts = self
            .lift
            .iter()
            .flat_map(|lift| lift.cameras.values())
            .map(|lift| (lift.file.as_str(), StoredFile::Lift(lift)));
        cameras.chain(fields).chain(lifts).collect()
    }
}
