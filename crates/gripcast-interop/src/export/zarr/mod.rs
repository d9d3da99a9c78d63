//! Zarr arrays with the layout of the replay buffer of UMI and Diffusion Policy: `data/` has one
//! row per frame, `meta/` one row per grasp, `meta/episode_ends` is the end of each grasp in
//! `data/`.
//!
//! Zarr version 2, which every release of Python's `zarr` reads, with zlib-compressed chunks.
//! Written without a Zarr library, which would add a hundred crates.

mod array;
mod store;

use std::collections::BTreeMap;
use std::path::Path;

use image::RgbImage;
use serde_json::json;

use super::fields::UniformField;
use super::format::{ExportContext, Writer};
use super::source::Grasp;
use array::{Images, Kind, Rows};
use gripcast_base::error::{Error, Result};
use gripcast_dataset::{Outcome, Stage};
use gripcast_imaging::{CropProfile, Decoder, Role};
use store::Store;

/// Exported cameras, resized to a common size.
const ROLES: [Role; 3] = [Role::Left, Role::Right, Role::Rgb];
/// Maximum image width and height, pixels.
const MAX_SIDE: u32 = 8192;
/// Temporary name of a zip file.
pub(super) const ZIP_NAME: &str = "export.zip";

/// Whether the export is a zip file.
pub(super) fn is_zip(out: &Path) -> bool {
    out.extension().is_some_and(|extension| extension == "zip")
}

/// Writes the arrays.
pub(super) struct ReplayBuffer<'a> {
    context: ExportContext<'a>,
    decoder: Decoder,
    store: Store<'a>,
    cameras: Vec<Camera>,
    stage: Rows,
    fields: Vec<(UniformField, Rows)>,
    notes: Vec<String>,
    grasps: PerGrasp,
    split: String,
    frames: usize,
}

/// Arrays of one camera.
struct Camera {
    role: Role,
    images: Images,
    /// Whether the grasp has the image; a missing one is black.
    present: Rows,
}

/// Arrays with one row per grasp.
struct PerGrasp {
    episode_ends: Rows,
    outcome: Rows,
    p_stable: Rows,
    force_n: Rows,
    force_std_n: Rows,
    force_shear_n: Rows,
    pose_t_m: Rows,
    pose_q_wxyz: Rows,
    id: Rows,
    object: Rows,
    split: Rows,
}

impl PerGrasp {
    fn new(context: ExportContext<'_>) -> Self {
        let survey = context.survey;
        let longest_split = context.splits.iter().map(|(name, _)| name.chars().count());
        let text = |length: usize| Kind::Text(length.max(1));
        Self {
            episode_ends: Rows::new("meta/episode_ends", Kind::I8, &[]),
            outcome: Rows::new("meta/outcome", Kind::I1, &[]),
            p_stable: Rows::new("meta/p_stable", Kind::F8, &[]),
            force_n: Rows::new("meta/force_n", Kind::F8, &[2]),
            force_std_n: Rows::new("meta/force_std_n", Kind::F8, &[2]),
            force_shear_n: Rows::new("meta/force_shear_n", Kind::F8, &[2, 2]),
            pose_t_m: Rows::new("meta/pose_t_m", Kind::F8, &[3]),
            pose_q_wxyz: Rows::new("meta/pose_q_wxyz", Kind::F8, &[4]),
            id: Rows::new("meta/id", text(survey.longest_id), &[]),
            object: Rows::new("meta/object", text(survey.longest_object), &[]),
            split: Rows::new("meta/part", text(longest_split.max().unwrap_or(1)), &[]),
        }
    }

    fn push(
        &mut self,
        store: &mut Store<'_>,
        grasp: &Grasp,
        split: &str,
        end: usize,
    ) -> Result<()> {
        let record = &grasp.record;
        let outcome: i8 = match record.outcome {
            Outcome::Stable => 1,
            Outcome::Slip => 0,
            Outcome::Unlabelled => -1,
        };
        let p_stable = record.prediction.as_ref().map_or(f64::NAN, |p| p.p_stable);
        let pose = record.pose.as_ref();
        let t_m = pose.map_or([f64::NAN; 3], |pose| pose.t_m);
        let q_wxyz = pose.map_or([f64::NAN; 4], |pose| pose.q_wxyz);
        self.episode_ends.push(store, &(end as i64).to_le_bytes())?;
        self.outcome.push(store, &outcome.to_le_bytes())?;
        self.p_stable.push(store, &p_stable.to_le_bytes())?;
        let forces = [Role::Left, Role::Right].map(|role| record.grasp.force.get(&role));
        let normal = forces.map(|force| force.map_or(f64::NAN, |f| f.normal_n));
        let std = forces.map(|force| force.map_or(f64::NAN, |f| f.normal_std_n));
        let shear = forces.map(|force| force.and_then(|f| f.shear_n).unwrap_or([f64::NAN; 2]));
        self.force_n.push(store, &le_bytes(&normal))?;
        self.force_std_n.push(store, &le_bytes(&std))?;
        self.force_shear_n
            .push(store, &le_bytes(shear.as_flattened()))?;
        self.pose_t_m.push(store, &le_bytes(&t_m))?;
        self.pose_q_wxyz.push(store, &le_bytes(&q_wxyz))?;
        self.id.push_text(store, &record.id)?;
        self.object.push_text(store, &record.object)?;
        self.split.push_text(store, split)
    }

    fn finish(self, store: &mut Store<'_>) -> Result<()> {
        let numbers = [
            self.episode_ends,
            self.outcome,
            self.p_stable,
            self.force_n,
            self.force_std_n,
            self.force_shear_n,
            self.pose_t_m,
            self.pose_q_wxyz,
        ];
        let texts = [self.id, self.object, self.split];
        numbers
            .into_iter()
            .chain(texts)
            .try_for_each(|rows| rows.finish(store))
    }
}

impl<'a> ReplayBuffer<'a> {
    /// # Errors
    /// `Usage`: invalid image size. `Input`: no grasp has any of the cameras. Those of the files.
    pub(super) fn new(context: ExportContext<'a>) -> Result<Self> {
        let (width, height) = context.plan.size;
        let valid = 1..=MAX_SIDE;
        if !valid.contains(&width) || !valid.contains(&height) {
            let what = format!("invalid image size {width}×{height}");
            return Err(Error::usage(what).remedy(format!(
                "give a width and height of 1 to {MAX_SIDE} pixels, such as 320x240"
            )));
        }
        let has = |role: &Role| {
            let cameras = &context.survey.cameras;
            Stage::ALL
                .iter()
                .any(|stage| cameras.contains_key(&(*stage, *role)))
        };
        let cameras: Vec<Camera> = ROLES
            .into_iter()
            .filter(has)
            .map(|role| Camera {
                role,
                images: Images::new(format!("data/{role}"), context.plan.size),
                present: Rows::new(format!("data/{role}_is_there"), Kind::Bool, &[]),
            })
            .collect();
        if cameras.is_empty() {
            let what = "no grasp has an image of left, right or rgb";
            return Err(Error::input(what));
        }
        let (fields, notes) = context.survey.fields.of_one_shape();
        let rows = |field: UniformField| {
            let name = format!("data/{}_{}", field.key.0, field.key.1);
            let rows = Rows::new(name, Kind::F4, &field.shape);
            (field, rows)
        };
        let fields: Vec<_> = fields.into_iter().map(rows).collect();
        let mut store = Store::create(context.folder, is_zip(context.folder.target()))?;
        store.put_json(".zattrs", &attributes(context, &fields))?;
        for group in ["", "data/", "meta/"] {
            store.put_json(&format!("{group}.zgroup"), &json!({"zarr_format": 2}))?;
        }
        Ok(Self {
            decoder: Decoder::new()?,
            store,
            cameras,
            stage: Rows::new("data/stage", Kind::U1, &[]),
            fields,
            notes,
            grasps: PerGrasp::new(context),
            split: String::new(),
            frames: 0,
            context,
        })
    }

    /// Decodes the images of both frames, by camera.
    fn decode(&mut self, grasp: &Grasp) -> Result<Vec<Vec<Option<RgbImage>>>> {
        let (width, height) = self.context.plan.size;
        let mut frames = Vec::new();
        for stage in Stage::ALL {
            let mut images = Vec::new();
            for camera in &self.cameras {
                let Some(image) = grasp.images.get(&(stage, camera.role)) else {
                    images.push(None);
                    continue;
                };
                let crop = image.crop_profile.as_deref();
                let crop = crop.map(CropProfile::by_name).transpose()?;
                let bytes = &image.bytes;
                let decoded = self
                    .decoder
                    .decode_file(bytes, crop.as_ref(), width, height)?;
                images.push(Some(decoded));
            }
            frames.push(images);
        }
        Ok(frames)
    }
}

impl Writer for ReplayBuffer<'_> {
    fn begin_split(&mut self, split: &str) -> Result<()> {
        split.clone_into(&mut self.split);
        Ok(())
    }

    fn push(&mut self, grasp: Grasp) -> Result<Option<Error>> {
        let frames = match self.decode(&grasp) {
            Ok(frames) => frames,
            Err(error) => return Ok(Some(error)),
        };
        let mut arrays = Vec::new();
        for stage in Stage::ALL {
            for (field, _) in &self.fields {
                match field.of(&grasp.fields, stage) {
                    Ok(array) => arrays.push(array.to_le_bytes()),
                    Err(error) => return Ok(Some(error)),
                }
            }
        }
        let mut arrays = arrays.into_iter();
        let store = &mut self.store;
        for (stage, images) in (0_u8..).zip(frames) {
            for (camera, image) in self.cameras.iter_mut().zip(images) {
                let present = [u8::from(image.is_some())];
                camera.present.push(store, &present)?;
                let pixels = image.as_ref().map(|image| image.as_raw().as_slice());
                camera.images.push(store, pixels)?;
            }
            for ((_, rows), array) in self.fields.iter_mut().zip(arrays.by_ref()) {
                rows.push(store, &array)?;
            }
            self.stage.push(store, &[stage])?;
            self.frames += 1;
        }
        self.grasps.push(store, &grasp, &self.split, self.frames)?;
        Ok(None)
    }

    fn finish(self: Box<Self>) -> Result<Vec<String>> {
        let mut store = self.store;
        for camera in self.cameras {
            camera.images.finish(&mut store)?;
            camera.present.finish(&mut store)?;
        }
        for (_, rows) in self.fields {
            rows.finish(&mut store)?;
        }
        self.stage.finish(&mut store)?;
        self.grasps.finish(&mut store)?;
        store.finish()?;
        let mut notes = self.notes;
        notes.extend(not_exported(self.context));
        Ok(notes)
    }
}

/// Meaning of the arrays, for `.zattrs`.
fn attributes(context: ExportContext<'_>, fields: &[(UniformField, Rows)]) -> serde_json::Value {
    let described = fields.iter().map(|(field, _)| {
        let (role, name) = &field.key;
        let counts = &field.counts;
        let description = json!({
            "columns": counts.columns,
            "units": counts.units,
            "frame": counts.frame,
        });
        (format!("{role}_{name}"), description)
    });
    let described: serde_json::Map<_, _> = described.collect();
    let (width, height) = context.plan.size;
    let descriptor = context.descriptor;
    json!({
        "dataset": descriptor.name,
        "licence": descriptor.licence,
        "label_definition": descriptor.label_definition,
        "outcome": {"-1": "unlabelled", "0": "slip", "1": "stable"},
        "stage": {"0": "initial", "1": "grasp"},
        "width": width,
        "height": height,
        "fields": described,
    })
}

/// A note for each camera that is not exported.
fn not_exported(context: ExportContext<'_>) -> Vec<String> {
    let mut others: BTreeMap<Role, usize> = BTreeMap::new();
    for ((_, role), counts) in &context.survey.cameras {
        if !ROLES.contains(role) {
            let max = others.entry(*role).or_default();
            *max = counts.grasps.max(*max);
        }
    }
    let note = |(role, grasps)| format!("{role} left out: images of {grasps} grasps");
    others.into_iter().map(note).collect()
}

fn le_bytes(numbers: &[f64]) -> Vec<u8> {
    numbers
        .iter()
        .flat_map(|number| number.to_le_bytes())
        .collect()
}
