//! A grasp with its images, checked and ready for other programs.

use std::collections::BTreeMap;

use gripcast_base::error::Result;
use gripcast_dataset::{CameraRecord, Dataset, GraspId, GraspRecord, Stage};
use gripcast_imaging::jpeg::{self, JpegDecoder};
use gripcast_imaging::{PixelFormat, Role};

/// One whole grasp.
pub(super) struct Grasp {
    pub(super) record: GraspRecord,
    /// Its `grasp.json` as it is.
    pub(super) json: Vec<u8>,
    /// Frames of the approach are not among them.
    pub(super) images: BTreeMap<(Stage, Role), Image>,
}

/// An encoded image that any viewer opens.
pub(super) struct Image {
    /// JPEG as the camera sent it but without padding and with Huffman tables; or PNG.
    pub bytes: Vec<u8>,
    /// Whether it has one channel.
    pub(super) is_grey: bool,
    /// Named crop, tactile cameras.
    pub(super) crop_profile: Option<String>,
}

impl Image {
    /// Ending of its file name.
    pub(super) fn extension(&self) -> &'static str {
        if self.bytes.starts_with(b"\x89PNG") {
            "png"
        } else {
            "jpg"
        }
    }
}

impl Grasp {
    /// Bytes of record and images.
    pub(super) fn bytes(&self) -> usize {
        let images = self.images.values().map(|image| image.bytes.len());
        self.json.len() + images.sum::<usize>()
    }
}

/// Reads grasps.
pub(super) struct Source<'a> {
    dataset: &'a Dataset,
    jpeg: JpegDecoder,
}

impl<'a> Source<'a> {
    pub(super) fn new(dataset: &'a Dataset) -> Result<Self> {
        let jpeg = JpegDecoder::new()?;
        Ok(Self { dataset, jpeg })
    }

    /// One grasp, all of whose images decode.
    ///
    /// # Errors
    /// What is wrong with it.
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
        Ok(Grasp {
            record,
            json,
            images,
        })
    }

    fn image(&mut self, record: &GraspRecord, camera: &CameraRecord) -> Result<Image> {
        let stored = self.dataset.stored_image(record, camera)?;
        let (bytes, is_grey) = match camera.format {
            PixelFormat::Mjpg => {
                let header = self.jpeg.verify(&stored)?;
                let bytes = jpeg::complete(&stored, &header).into_owned();
                (bytes, header.components == 1)
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
