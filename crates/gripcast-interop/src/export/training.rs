//! Shards of labelled samples for `train` and `eval`, in the format of synthetic and imported
//! datasets.
//!
//! Tactile images are cropped with the profile of their camera and resized by the decoder of the
//! live path, and stored without loss, so that a model predicts the same as live.

use serde_json::json;

use super::format::{ExportContext, Writer};
use super::plan::SIZE;
use super::selection::opening_m;
use super::shard_files::ShardFiles;
use super::source::{Grasp, Image};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::shard::{
    ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow, ShardWriter,
};
use gripcast_dataset::{GraspRecord, GroupKey, Outcome, Stage};
use gripcast_imaging::{
    CropProfile, Decoder, Depth, DepthImage, DepthView, Role, decode_png_grey16, encode_png_grey16,
    encode_png_rgb,
};

/// Depth of one count in shards, m.
const DEPTH_UNIT_M: f64 = 1e-3;

/// Writes the shards.
pub(super) struct TrainingShards<'a> {
    context: ExportContext<'a>,
    decoder: Decoder,
    info: String,
    files: ShardFiles<'a>,
    /// The open shard and the size of its rows, bytes.
    open: Option<(ShardWriter, usize)>,
    /// Name of the crop profile of the tactile images.
    crop: &'a str,
}

impl<'a> TrainingShards<'a> {
    /// # Errors
    /// `Input`: no grasp has tactile images. `Internal`: the decoder.
    pub(super) fn new(context: ExportContext<'a>) -> Result<Self> {
        let Some(crop) = context.survey.most_common_crop() else {
            let what = "no grasp has tactile images with a crop profile";
            return Err(Error::input(what)
                .remedy("set `crop_profile` of the tactile cameras in the rig file"));
        };
        let descriptor = context.descriptor;
        let info = json!({
            "exported_from": descriptor.name,
            "licence": descriptor.licence,
            "label_definition": descriptor.label_definition,
        });
        Ok(Self {
            context,
            decoder: Decoder::new()?,
            info: info.to_string(),
            files: ShardFiles::new(context.folder),
            open: None,
            crop,
        })
    }

    /// Returns the open shard, or a new one if it is full.
    fn shard(&mut self, next: usize) -> Result<&mut ShardWriter> {
        let open = match self.open.take() {
            Some((full, bytes)) if bytes + next > self.context.plan.shard_bytes => {
                full.finish()?;
                None
            }
            open => open,
        };
        let (shard, bytes) = match open {
            Some(open) => open,
            None => (ShardWriter::create(&self.files.next()?, &self.info)?, 0),
        };
        Ok(&mut self.open.insert((shard, bytes + next)).0)
    }

    fn end_split(&mut self) -> Result<()> {
        if let Some((open, _)) = self.open.take() {
            open.finish()?;
        }
        self.files.end_split()
    }

    /// Converts a grasp to a sample.
    fn row(&mut self, grasp: &Grasp) -> Result<ShardRow> {
        let record = &grasp.record;
        let outcome = match record.outcome {
            Outcome::Stable => ShardOutcome::Stable,
            Outcome::Slip => ShardOutcome::Slip,
            Outcome::Unlabelled => return Err(Error::input("the grasp is not labelled")),
        };
        let mut image = |stage, role| self.image(grasp, stage, role);
        let images = ShardImages {
            initial_left: image(Stage::Initial, Role::Left)?,
            initial_right: image(Stage::Initial, Role::Right)?,
            grasp_left: image(Stage::Grasp, Role::Left)?,
            grasp_right: image(Stage::Grasp, Role::Right)?,
            grasp_rgb: image(Stage::Grasp, Role::Rgb)?,
            initial_rgb: match grasp.images.contains_key(&(Stage::Initial, Role::Rgb)) {
                true => Some(image(Stage::Initial, Role::Rgb)?),
                false => None,
            },
            grasp_depth: aligned_depth(grasp)?,
        };
        Ok(ShardRow {
            facts: facts(record, outcome, self.crop)?,
            images,
        })
    }

    fn image(&mut self, grasp: &Grasp, stage: Stage, role: Role) -> Result<Vec<u8>> {
        let what = || format!("{} {role}", stage.name());
        let Some(image) = grasp.images.get(&(stage, role)) else {
            return Err(Error::input(format!("the grasp has no image {}", what())));
        };
        let crop = match role.is_tactile() {
            true => self.crop(image).map_err(|e| e.at(what()))?,
            false => CropProfile::FULL,
        };
        let (width, height) = SIZE;
        let small = self
            .decoder
            .decode_file(&image.bytes, Some(&crop), width, height)
            .and_then(|small| encode_png_rgb(&small));
        small.map_err(|e| e.at(what()))
    }

    /// Crop profile of a tactile image, which must be that of the export.
    fn crop(&self, image: &Image) -> Result<CropProfile> {
        match image.crop_profile.as_deref() {
            None => Err(Error::input("the camera has no crop profile")),
            Some(name) if name == self.crop => CropProfile::by_name(name),
            Some(name) => Err(Error::input(format!(
                "expected the crop profile {}, found {name}",
                self.crop
            ))),
        }
    }
}

impl Writer for TrainingShards<'_> {
    fn begin_split(&mut self, split: &str) -> Result<()> {
        self.end_split()?;
        self.files.begin_split(split);
        Ok(())
    }

    fn push(&mut self, grasp: Grasp) -> Result<Option<Error>> {
        let row = match self.row(&grasp) {
            Ok(row) => row,
            Err(error) => return Ok(Some(error)),
        };
        match self.shard(row.bytes())?.push(row) {
            Ok(()) => Ok(None),
            Err(error) if error.kind() == ErrorKind::Input => Ok(Some(error)),
            Err(error) => Err(error),
        }
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>> {
        self.end_split()?;
        Ok(Vec::new())
    }
}

/// Depth image in the grasp as the colour image shows it, mm, PNG; none without one, or of a camera
/// whose lenses are not known.
fn aligned_depth(grasp: &Grasp) -> Result<Option<Vec<u8>>> {
    let camera = grasp.record.grasp.cameras.get(&Role::Depth);
    let image = grasp.images.get(&(Stage::Grasp, Role::Depth));
    let (Some(camera), Some(image)) = (camera, image) else {
        return Ok(None);
    };
    let view = DepthView::of_camera(grasp.record.is_simulated(), &camera.product);
    let (Some(view), Some(unit_m)) = (view, camera.depth_unit_m) else {
        return Ok(None);
    };
    let image = decode_png_grey16(&image.bytes).map_err(|e| e.at("grasp depth"))?;
    let (width, height) = SIZE;
    let depth = Depth { image, unit_m };
    let depths_m = depth.in_colour_image(view, width as usize, height as usize);
    let counts = depths_m.iter().map(|z| (z / DEPTH_UNIT_M).round());
    // Beyond the range of 16 bits a depth is unknown.
    let counts = counts.map(|z| if z < f64::from(u16::MAX) { z as u16 } else { 0 });
    let aligned = DepthImage::from_vec(width, height, counts.collect())
        .ok_or_else(|| Error::internal("a depth image has another number of pixels"))?;
    encode_png_grey16(&aligned).map(Some)
}

fn facts(record: &GraspRecord, outcome: ShardOutcome, crop: &str) -> Result<ShardFacts> {
    let truth = record.truth.as_ref();
    let annotated = record.pose.as_ref();
    let t_object_gripper = match (truth, annotated) {
        (Some(truth), _) => Some(truth.t_object_gripper),
        (None, Some(pose)) => Some(pose.t_object_gripper()?),
        (None, None) => None,
    };
    let (engine, appearance) = match truth {
        Some(_) => (ShardEngine::Fem, "virtual-rig"),
        None => (ShardEngine::Real, "real"),
    };
    Ok(ShardFacts {
        id: record.id.to_string(),
        simulation: record.id.to_string(),
        object: GroupKey::Object.group(record),
        category: "unknown".to_owned(),
        engine,
        outcome,
        outcome_detail: match outcome {
            ShardOutcome::Stable => "stable".to_owned(),
            ShardOutcome::Slip => "slip".to_owned(),
        },
        stop_force_n: None,
        friction: truth.map(|truth| truth.friction),
        mass_kg: truth.map(|truth| truth.mass_kg),
        lifted_m: truth.map(|truth| truth.lifted_m),
        force_left_n: truth.map(|truth| truth.force_n[0]),
        force_right_n: truth.map(|truth| truth.force_n[1]),
        opening_m: opening_m(record),
        t_object_gripper,
        fault: None,
        appearance: appearance.to_owned(),
        rendering: 0,
        seed: 0,
        crop_profile: crop.to_owned(),
        geometry: None,
        lift: None,
        contact: None,
    })
}
