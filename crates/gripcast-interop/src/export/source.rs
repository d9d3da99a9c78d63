//! Reads and checks grasps with their images for an export.

use std::collections::BTreeMap;

use super::fields::Fields;
use gripcast_base::error::Result;
use gripcast_dataset::{CameraRecord, Dataset, GraspId, GraspRecord, Stage};
use gripcast_imaging::jpeg::{self, JpegDecoder};
use gripcast_imaging::{PixelFormat, Role};

/// A complete grasp.
pub(super) struct Grasp {
    pub(super) record: GraspRecord,
    /// Bytes of `grasp.json`.
    pub(super) json: Vec<u8>,
    /// Images of both stages, without pre-grasp frames.
    pub(super) images: BTreeMap<(Stage, Role), Image>,
    /// Field arrays of both stages.
    pub(super) fields: Fields,
    /// Lift frames by gel, one after the other, as stored; only for formats that carry them.
    pub(super) lifts: BTreeMap<Role, Vec<u8>>,
}

/// An encoded image in a standard format.
pub(super) struct Image {
    /// PNG, or JPEG as sent by the camera but without padding and with Huffman tables.
    pub bytes: Vec<u8>,
    /// Whether it has a single channel.
    pub(super) is_grey: bool,
    /// Name of the crop profile; tactile cameras only.
    pub(super) crop_profile: Option<String>,
}

impl Image {
    /// File extension.
    pub(super) fn extension(&self) -> &'static str {
        if self.bytes.starts_with(b"\x89PNG") {
            "png"
        } else {
            "jpg"
        }
    }
}

impl Grasp {
    /// Size of record, images, fields and lift frames, bytes.
    pub(super) fn bytes(&self) -> usize {
        let images = self.images.values().map(|image| image.bytes.len());
        let lifts = self.lifts.values().map(Vec::len);
        let fields = self.fields.values().map(|array| 4 * array.values().len());
        self.json.len() + images.chain(lifts).chain(fields).sum::<usize>()
    }
}

/// Reads grasps of a dataset.
pub(super) struct Source<'a> {
    dataset: &'a Dataset,
    jpeg: JpegDecoder,
    with_lifts: bool,
}

impl<'a> Source<'a> {
    /// `with_lifts`: reads the lift frames as well.
    pub(super) fn new(dataset: &'a Dataset, with_lifts: bool) -> Result<Self> {
        let jpeg = JpegDecoder::new()?;
        Ok(Self {
            dataset,
            jpeg,
            with_lifts,
        })
    }

    /// Reads a grasp and checks that all its images decode.
    ///
    /// # Errors
    /// The defect of the grasp.
    pub(super) fn read(&mut self, id: &GraspId) -> Result<Grasp> {
        let (record, json) = self.dataset.grasp_with_json(id)?;
        let mut images = BTreeMap::new();
        for (stage, frames) in record.stages() {
            for (role, camera) in &frames.cameras {
                let image = self
                    .image(&record, camera)
                    .map_err(|e| e.at(format!("{} {role}", stage.name())))?;
                images.insert((stage, *role), image);
            }
        }
        let mut fields = Fields::new();
        for (stage, frames) in record.stages() {
            for (role, of_role) in &frames.fields {
                for name in of_role.keys() {
                    let array = self.dataset.field(&record, stage, *role, name)?;
                    fields.insert((stage, *role, name.clone()), array);
                }
            }
        }
        let mut lifts = BTreeMap::new();
        if self.with_lifts {
            for role in record.lift.iter().flat_map(|lift| lift.cameras.keys()) {
                lifts.insert(*role, self.dataset.lift_bytes(&record, *role)?);
            }
        }
        Ok(Grasp {
            record,
            json,
            images,
            fields,
            lifts,
        })
    }

    fn image(&mut self, record: &GraspRecord, camera: &CameraRecord) -> Result<Image> {
        let stored = self.dataset.stored_image(record, camera)?;
        let (bytes, is_grey) = match camera.format {
            PixelFormat::Mjpg => {
                let header = self.jpeg.verify(&stored)?;
                let (file, _) = jpeg::whole_file(&stored)?;
                (file.into_owned(), header.components == 1)
            }
            PixelFormat::Yuyv | PixelFormat::Rgb => (stored, false),
            PixelFormat::Grey | PixelFormat::Z16 => (stored, true),
        };
        Ok(Image {
            bytes,
            is_grey,
            crop_profile: camera.crop_profile.clone(),
        })
    }
}
