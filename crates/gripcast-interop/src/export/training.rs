//! Shards of labelled samples as `train` and `eval` read them: what synthetic and imported datasets
//! are made of.
//!
//! The tactile images are cropped by the profile of their camera and have the models' size, made
//! by the decoder of the live path and stored without loss: a model says of a sample what it says
//! live of the same frames.

use serde_json::json;

use super::format::{Setting, Writer};
use super::plan::SIZE;
use super::shard_files::ShardFiles;
use super::source::{Grasp, Image};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::shard::{
    ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow, ShardWriter,
};
use gripcast_dataset::{GraspRecord, Outcome, SplitBy, Stage};
use gripcast_imaging::{CropProfile, Decoder, Role, encode_png_rgb};

/// Writes the shards.
pub(super) struct TrainingShards<'a> {
    setting: Setting<'a>,
    decoder: Decoder,
    info: String,
    files: ShardFiles<'a>,
    /// The open shard and the bytes of its rows.
    open: Option<(ShardWriter, usize)>,
    /// How the tactile images are cropped.
    crop: &'a str,
}

impl<'a> TrainingShards<'a> {
    /// # Errors
    /// `Input`: no grasp has tactile images. `Internal`: no decoder can be had.
    pub(super) fn new(setting: Setting<'a>) -> Result<Self> {
        let Some(crop) = setting.survey.usual_crop() else {
            let what = "no grasp has tactile images that say how they are cropped";
            return Err(cannot(what.to_owned())
                .remedy("give `crop_profile` to the tactile cameras in the rig file"));
        };
        let descriptor = setting.descriptor;
        let info = json!({
            "exported_from": descriptor.name,
            "licence": descriptor.licence,
            "label_definition": descriptor.label_definition,
        });
        Ok(Self {
            setting,
            decoder: Decoder::new()?,
            info: info.to_string(),
            files: ShardFiles::new(setting.folder),
            open: None,
            crop,
        })
    }

    /// The open shard, a new one where the last is full.
    fn shard(&mut self, next: usize) -> Result<&mut ShardWriter> {
        let open = match self.open.take() {
            Some((full, bytes)) if bytes + next > self.setting.plan.shard_bytes => {
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

    fn end_part(&mut self) -> Result<()> {
        if let Some((open, _)) = self.open.take() {
            open.finish()?;
        }
        self.files.end_part()
    }

    /// A grasp as a sample, or why it cannot be one.
    fn row(&mut self, grasp: &Grasp) -> Result<ShardRow> {
        let record = &grasp.record;
        let outcome = match record.outcome {
            Outcome::Stable => ShardOutcome::Stable,
            Outcome::Slip => ShardOutcome::Slip,
            Outcome::Unlabelled => return Err(cannot("it has no label".to_owned())),
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
            grasp_depth: None,
        };
        Ok(ShardRow {
            facts: facts(record, outcome, self.crop)?,
            images,
        })
    }

    fn image(&mut self, grasp: &Grasp, stage: Stage, role: Role) -> Result<Vec<u8>> {
        let what = || format!("{} {role}", stage.name());
        let Some(image) = grasp.images.get(&(stage, role)) else {
            return Err(cannot(format!("it has no image {}", what())));
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

    /// The crop of a tactile image, that of all.
    fn crop(&self, image: &Image) -> Result<CropProfile> {
        match image.crop_profile.as_deref() {
            None => Err(cannot("the camera has no crop profile".to_owned())),
            Some(name) if name == self.crop => CropProfile::by_name(name),
            Some(name) => Err(cannot(format!(
                "it is cropped by {name}, most others by {}: a model knows one crop",
                self.crop
            ))),
        }
    }
}

impl Writer for TrainingShards<'_> {
    fn begin_part(&mut self, part: &str) -> Result<()> {
        self.end_part()?;
        self.files.begin_part(part);
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
        self.end_part()?;
        Ok(Vec::new())
    }
}

fn facts(record: &GraspRecord, outcome: ShardOutcome, crop: &str) -> Result<ShardFacts> {
    let truth = record.truth.as_ref();
    let annotated = record.pose.as_ref();
    let t_object_gripper = match (truth, annotated) {
        (Some(truth), _) => Some(truth.t_object_gripper),
        (None, Some(pose)) => Some(pose.t_object_gripper()?),
        (None, None) => None,
    };
    let opening = annotated.and_then(|pose| pose.quality.as_ref()?.opening_m);
    let (engine, appearance) = match truth {
        Some(_) => (ShardEngine::Fem, "virtual-rig"),
        None => (ShardEngine::Real, "real"),
    };
    Ok(ShardFacts {
        id: record.id.to_string(),
        simulation: record.id.to_string(),
        object: SplitBy::Object.item(record),
        category: "unknown".to_owned(),
        engine,
        outcome,
        outcome_detail: match outcome {
            ShardOutcome::Stable => "held".to_owned(),
            ShardOutcome::Slip => "lost".to_owned(),
        },
        stop_force_n: None,
        friction: truth.map(|truth| truth.friction),
        mass_kg: truth.map(|truth| truth.mass_kg),
        lifted_m: truth.map(|truth| truth.lifted_m),
        force_left_n: truth.map(|truth| truth.force_n[0]),
        force_right_n: truth.map(|truth| truth.force_n[1]),
        opening_m: truth.map(|truth| truth.opening_m).or(opening),
        t_object_gripper,
        fault: None,
        appearance: appearance.to_owned(),
        rendering: 0,
        seed: 0,
        crop_profile: crop.to_owned(),
    })
}

fn cannot(what: String) -> Error {
    Error::input(what)
}
