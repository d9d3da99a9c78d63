//! Reads a dataset.

use std::path::Path;

use image::RgbImage;

use super::descriptor::Descriptor;
use super::digest::digest;
use super::grasp::{CameraRecord, GraspRecord};
use super::layout::{GRASP_JSON, Layout, Stage};
use super::lift::LiftCamera;
use super::record_file::read_grasp_of;
use super::stored_file::StoredFile;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::npy::Array;
use gripcast_base::files::{
    BeneathPath, ContentKey, FileKind, FileName, GraspId, conflict_copy_of, without_bom,
};
use gripcast_imaging::{CropProfile, Decoder, Frame, PixelFormat, Role, decode_png};

/// Size of the cropped images that models and markers refer to, px.
pub const TACTILE_SIZE: [u32; 2] = [320, 240];

/// A dataset opened for reading; any number of readers may coexist with one writer.
#[derive(Clone, Debug)]
pub struct Dataset {
    layout: Layout,
    descriptor: Descriptor,
}

impl Dataset {
    /// Opens a dataset for reading.
    ///
    /// # Errors
    /// `NotFound` without a dataset, `Input` when it is unreadable or of a newer version.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let layout = Layout::new(path.as_ref());
        let descriptor = Descriptor::read(&layout)?;
        Ok(Self { layout, descriptor })
    }

    /// Description of the dataset, from `dataset.toml`.
    #[must_use]
    pub fn descriptor(&self) -> &Descriptor {
        &self.descriptor
    }

    /// Directory of the dataset.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.layout.root()
    }

    pub(super) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Ids of all complete grasps, sorted.
    ///
    /// # Errors
    /// When `grasps/` cannot be read.
    pub fn ids(&self) -> Result<Vec<GraspId>> {
        grasp_ids(&self.layout)
    }

    /// Reads the record of a grasp.
    ///
    /// # Errors
    /// `NotFound` without that grasp, `Input` when its record is unreadable or belongs to another
    /// grasp.
    pub fn grasp(&self, id: &GraspId) -> Result<GraspRecord> {
        read_grasp_of(&self.layout, id)
    }

    /// Whether `trash/` contains a complete grasp of this id.
    #[must_use]
    pub fn is_in_trash(&self, id: &GraspId) -> bool {
        self.layout.trashed(id).join(GRASP_JSON).is_file()
    }

    /// Reads all complete grasps, sorted by id. An unreadable grasp is an `Err` item.
    ///
    /// # Errors
    /// When `grasps/` cannot be read.
    pub fn grasps(&self) -> Result<impl Iterator<Item = Result<GraspRecord>>> {
        Ok(self.ids()?.into_iter().map(|id| self.grasp(&id)))
    }

    /// Path of an image of a grasp; `None` without an image of that role at that stage.
    #[must_use]
    pub fn image_path(
        &self,
        record: &GraspRecord,
        stage: Stage,
        role: Role,
    ) -> Option<BeneathPath> {
        let camera = record.stage(stage).cameras.get(&role)?;
        Some(self.layout.grasp(&record.id).join(&camera.file))
    }

    /// Path of a file of a grasp, by its name in the record; `None` for other names.
    #[must_use]
    pub fn file(&self, record: &GraspRecord, name: &str) -> Option<BeneathPath> {
        let (name, _) = record.files.get_key_value(name)?;
        Some(self.layout.grasp(&record.id).join(name))
    }

    /// Images of the external camera from before the gripper closed, by time: pre-grasp frames
    /// and initial frame.
    #[must_use]
    pub fn external_images_before_closing(
        &self,
        record: &GraspRecord,
    ) -> Vec<(CameraRecord, BeneathPath)> {
        let initial = record.initial.cameras.get(&Role::External);
        let mut cameras: Vec<CameraRecord> = record
            .pre_grasp_frames
            .iter()
            .chain(initial)
            .cloned()
            .collect();
        cameras.sort_by_key(|camera| camera.driver_time_ns);
        let grasp = self.layout.grasp(&record.id);
        cameras
            .into_iter()
            .map(|camera| {
                let path = grasp.join(&camera.file);
                (camera, path)
            })
            .collect()
    }

    /// Reads the text of a calibration by its key.
    ///
    /// # Errors
    /// `NotFound` without it, `Io`, ….
    pub fn calibration(&self, key: &ContentKey) -> Result<String> {
        let path = self.layout.calibration().join_affixed("", key, ".toml");
        path.read_to_string(FileKind::Record)
            .map_err(|e| Error::io("cannot read the calibration", e).at(path.display()))
    }

    /// Reads a grasp with the bytes of its `grasp.json`, without a byte-order mark.
    ///
    /// # Errors
    /// As [`grasp`](Self::grasp).
    pub fn grasp_with_json(&self, id: &GraspId) -> Result<(GraspRecord, Vec<u8>)> {
        let record = read_grasp_of(&self.layout, id)?;
        let path = self.layout.grasp(id).join(GRASP_JSON);
        let json = path
            .read(FileKind::Record)
            .map_err(|e| Error::io("cannot read the record", e).at(path.display()))?;
        let json = without_bom(&json).to_vec();
        Ok((record, json))
    }

    /// Reads a stored image and checks file size, sha256 and image size against the record. The
    /// entropy-coded data of a JPEG is not decoded.
    ///
    /// # Errors
    /// `NotFound`, `Io`: the file. `Input`: it differs from the record, or is damaged.
    pub fn stored_image(&self, record: &GraspRecord, camera: &CameraRecord) -> Result<Vec<u8>> {
        self.stored(record, &camera.file, StoredFile::Image(camera))
    }

    /// Reads a field array and checks it against the record.
    ///
    /// # Errors
    /// `NotFound` without that field; `Input`: it differs from the record.
    pub fn field(
        &self,
        record: &GraspRecord,
        stage: Stage,
        role: Role,
        name: &str,
    ) -> Result<Array> {
        let fields = record.stage(stage).fields.get(&role);
        let field = fields.and_then(|fields| fields.get(name)).ok_or_else(|| {
            Error::not_found(format!(
                "{} has no field `{name}` of {role} at the {} stage",
                record.id,
                stage.name()
            ))
        })?;
        let bytes = self.stored(record, &field.file, StoredFile::Field(field))?;
        field.parse(&bytes)
    }

    /// Reads the lift frames of a gel as the camera sent them, raw formats as RGB, and checks them
    /// against the record.
    ///
    /// # Errors
    /// `NotFound` without lift frames of that gel; `Input`: they differ from the record.
    pub fn lift_frames(&self, record: &GraspRecord, role: Role) -> Result<Vec<Frame>> {
        let lift = self.lift_of(record, role)?;
        let bytes = self.lift_bytes(record, role)?;
        let path = self.layout.grasp(&record.id).join(&lift.file);
        let split = lift.split(&bytes).map_err(|e| e.at(path.display()))?;
        let frames = split.into_iter().map(|(frame, image)| {
            let (format, data) = pixels(&path, lift.format, image.to_vec())?;
            Ok(Frame {
                format,
                width: lift.width,
                height: lift.height,
                data: data.into(),
                sequence: frame.sequence,
                driver_time_ns: frame.driver_time_ns,
                received_ns: frame.driver_time_ns,
            })
        });
        frames.collect()
    }

    /// Reads the file with the lift frames of a gel, one after the other, and checks it against the
    /// record.
    ///
    /// # Errors
    /// As [`lift_frames`](Self::lift_frames).
    pub fn lift_bytes(&self, record: &GraspRecord, role: Role) -> Result<Vec<u8>> {
        let lift = self.lift_of(record, role)?;
        self.stored(record, &lift.file, StoredFile::Lift(lift))
    }

    fn lift_of<'a>(&self, record: &'a GraspRecord, role: Role) -> Result<&'a LiftCamera> {
        let lift = record
            .lift
            .as_ref()
            .and_then(|lift| lift.cameras.get(&role));
        lift.ok_or_else(|| Error::not_found(format!("{} has no lift frames of {role}", record.id)))
    }

    /// Reads a file of a grasp and checks it against the record.
    fn stored(
        &self,
        record: &GraspRecord,
        name: &FileName,
        file: StoredFile<'_>,
    ) -> Result<Vec<u8>> {
        let path = self.layout.grasp(&record.id).join(name);
        let refused = |what: String| Error::input(what).at(path.display());
        let bytes = path
            .read(FileKind::Image)
            .map_err(|e| Error::io("cannot read the file", e).at(path.display()))?;
        let Some(expected) = record.files.get(name) else {
            return Err(refused("the record lacks a digest of the file".to_owned()));
        };
        if digest(&bytes) != *expected {
            return Err(refused("size or sha256 differ from the record".to_owned()));
        }
        match file.defect(&bytes) {
            Some(defect) => Err(refused(defect)),
            None => Ok(bytes),
        }
    }

    /// Loads a stored frame as the camera sent it; a YUYV frame as RGB with the pixels that the
    /// sent frame decodes to.
    ///
    /// # Errors
    /// `NotFound` without a frame of that role at that stage; `Input` when the file is damaged.
    pub fn load_frame(&self, record: &GraspRecord, stage: Stage, role: Role) -> Result<Frame> {
        let camera = record.stage(stage).cameras.get(&role).ok_or_else(|| {
            Error::not_found(format!(
                "{} has no {} frame of {role}",
                record.id,
                stage.name()
            ))
        })?;
        load_frame(&self.layout.grasp(&record.id), camera)
    }

    /// Decodes the tactile image of a gel, cropped by the profile in its record and resized to
    /// 320×240, as models and the tracker of gel markers see it.
    ///
    /// # Errors
    /// As [`load_frame`](Self::load_frame); `Config` for an unknown crop profile.
    pub fn tactile_image(
        &self,
        decoder: &mut Decoder,
        record: &GraspRecord,
        stage: Stage,
        role: Role,
    ) -> Result<RgbImage> {
        let frame = self.load_frame(record, stage, role)?;
        let camera = record.stage(stage).cameras.get(&role);
        let crop = camera.and_then(|camera| camera.crop_profile.as_deref());
        let crop = crop.map(CropProfile::by_name).transpose()?;
        let [width, height] = TACTILE_SIZE;
        let image = decoder.decode(&frame, crop.as_ref(), width, height);
        image.map_err(|e| {
            let place = format!("grasps/{} {role} {}", record.id, stage.name());
            Error::from(e).at(place).at(self.path().display())
        })
    }
}

/// Ids of the complete grasps, sorted, without conflict copies.
pub(super) fn grasp_ids(layout: &Layout) -> Result<Vec<GraspId>> {
    let names = subdirectories(&layout.grasps())?;
    let is_grasp = |name: &&String| copied_from(name, &names).is_none();
    let ids = names.iter().filter(is_grasp);
    Ok(ids.filter_map(|name| GraspId::parse(name).ok()).collect())
}

/// The directory that a directory in `grasps/` is a conflict copy of. `names`: sorted names in
/// `grasps/`.
pub(super) fn copied_from(name: &str, names: &[String]) -> Option<String> {
    conflict_copy_of(name).filter(|original| names.binary_search(original).is_ok())
}

/// Names of the directories inside a directory, sorted.
pub(super) fn subdirectories(path: &BeneathPath) -> Result<Vec<String>> {
    let folders = path
        .directories()
        .map_err(|e| Error::io("cannot read the directory", e).at(path.display()))?;
    Ok(folders.iter().map(BeneathPath::name).collect())
}

/// Entries of a directory, sorted by name.
pub(super) fn entries(path: &BeneathPath) -> Result<Vec<BeneathPath>> {
    path.entries()
        .map_err(|e| Error::io("cannot read the directory", e).at(path.display()))
}

/// Loads a stored file as the original frame; YUYV as RGB.
pub(super) fn load_frame(dir: &BeneathPath, camera: &CameraRecord) -> Result<Frame> {
    let path = dir.join(&camera.file);
    let bytes = path
        .read(FileKind::Image)
        .map_err(|e| Error::io("cannot read the image", e).at(path.display()))?;
    let (format, data) = pixels(&path, camera.format, bytes)?;
    Ok(Frame {
        format,
        width: camera.width,
        height: camera.height,
        data: data.into(),
        sequence: camera.sequence,
        driver_time_ns: camera.driver_time_ns,
        received_ns: camera.driver_time_ns,
    })
}

/// Format and payload of a stored image; YUYV as RGB.
fn pixels(
    path: &BeneathPath,
    format: PixelFormat,
    bytes: Vec<u8>,
) -> Result<(PixelFormat, Vec<u8>)> {
    let format = match format {
        PixelFormat::Yuyv => PixelFormat::Rgb,
        other => other,
    };
    let data = match format {
        PixelFormat::Mjpg => bytes,
        PixelFormat::Z16 => match decode(path, &bytes)? {
            image::DynamicImage::ImageLuma16(image) => image
                .into_raw()
                .into_iter()
                .flat_map(u16::to_le_bytes)
                .collect(),
            _ => return Err(wrong_type(path, "a 16-bit grey image")),
        },
        PixelFormat::Grey => match decode(path, &bytes)? {
            image::DynamicImage::ImageLuma8(image) => image.into_raw(),
            _ => return Err(wrong_type(path, "an 8-bit grey image")),
        },
        PixelFormat::Yuyv | PixelFormat::Rgb => match decode(path, &bytes)? {
            image::DynamicImage::ImageRgb8(image) => image.into_raw(),
            _ => return Err(wrong_type(path, "an RGB image")),
        },
    };
    Ok((format, data))
}

fn decode(path: &BeneathPath, bytes: &[u8]) -> Result<image::DynamicImage> {
    decode_png(bytes).map_err(|e| e.at(path.display()))
}

fn wrong_type(path: &BeneathPath, expected: &str) -> Error {
    Error::input(format!("expected {expected}")).at(path.display())
}
