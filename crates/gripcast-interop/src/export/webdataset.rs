//! Tar shards with one sample per grasp: `<id>.json`, `<id>.<stage>_<role>.jpg` or `.png`.
//!
//! Readers group consecutive files by the part of their names before the first dot. Hugging Face
//! `datasets` infers the fields and their types from the first five samples; so all samples have
//! the same files and the same keys with values of the same types. An image that a grasp lacks is
//! black, and the JSON says so; a kind of image that is JPEG in some grasps and PNG in others is
//! PNG in all, with the same pixels.

use std::fs::File;
use std::io::{BufWriter, Write as _};

use image::RgbImage;
use tar::{Builder, EntryType, Header};

use super::facts::typed_json;
use super::fields::UniformField;
use super::format::{ExportContext, Writer};
use super::selection::CameraCounts;
use super::source::{Grasp, Image};
use super::staged::write_failed;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::Stage;
use gripcast_imaging::{Decoder, DepthImage, Role, encode_jpeg, encode_png_grey16, encode_png_rgb};

/// Size of a file's header and padding, bytes.
const OVERHEAD: usize = 1024;
/// Quality of a black JPEG, which has no detail.
const BLACK_QUALITY: u8 = 80;

/// A kind of image: a field of every sample.
struct Field {
    stage: Stage,
    role: Role,
    /// Whether the images of all grasps are JPEG; otherwise the field is PNG.
    is_jpeg: bool,
    /// Number of JPEG images that become PNG.
    converted: usize,
    /// The image of grasps that lack one.
    black: Vec<u8>,
}

impl Field {
    fn new(stage: Stage, role: Role, counts: &CameraCounts) -> Result<Self> {
        let is_jpeg = counts.jpegs == counts.grasps;
        let (width, height) = counts.sizes.first().copied().unwrap_or((1, 1));
        let black = match role {
            Role::Depth => encode_png_grey16(&DepthImage::new(width, height)),
            _ if is_jpeg => encode_jpeg(&RgbImage::new(width, height), BLACK_QUALITY),
            _ => encode_png_rgb(&RgbImage::new(width, height)),
        }?;
        Ok(Self {
            stage,
            role,
            is_jpeg,
            converted: if is_jpeg { 0 } else { counts.jpegs },
            black,
        })
    }

    fn name(&self) -> String {
        format!("{}_{}", self.stage.name(), self.role)
    }

    /// The bytes for a sample.
    ///
    /// # Errors
    /// The image does not decode.
    fn bytes(&self, image: Option<Image>, decoder: &mut Decoder) -> Result<Vec<u8>> {
        match image {
            None => Ok(self.black.clone()),
            Some(image) if !self.is_jpeg && image.extension() == "jpg" => {
                encode_png_rgb(&decoder.stored_image(&image.bytes)?)
            }
            Some(image) => Ok(image.bytes),
        }
    }
}

/// Lift frames of one gel: a file of every sample, empty where a grasp has none.
struct LiftField {
    role: Role,
    extension: &'static str,
}

impl LiftField {
    /// The gels whose lift frames have one format in all grasps; notes about the others.
    fn choose(context: ExportContext<'_>, notes: &mut Vec<String>) -> Vec<Self> {
        let mut chosen = Vec::new();
        for (&role, counts) in &context.survey.lifts {
            let extension = match counts.jpegs {
                0 => "pngs",
                all if all == counts.grasps => "mjpeg",
                _ => {
                    notes.push(format!(
                        "lift frames of {role} left out: some are JPEG, some PNG"
                    ));
                    continue;
                }
            };
            chosen.push(Self { role, extension });
        }
        chosen
    }
}

/// Writes the shards.
pub(super) struct TarShards<'a> {
    context: ExportContext<'a>,
    split: String,
    /// Number of shards of the split so far.
    shards: usize,
    open: Option<(Builder<BufWriter<File>>, usize)>,
    fields: Vec<Field>,
    arrays: Vec<(Stage, UniformField)>,
    lifts: Vec<LiftField>,
    notes: Vec<String>,
    decoder: Decoder,
}

impl<'a> TarShards<'a> {
    /// # Errors
    /// `Internal`: a defect of gripcast.
    pub(super) fn new(context: ExportContext<'a>) -> Result<Self> {
        let cameras = context.survey.cameras.iter();
        let fields = cameras.map(|((stage, role), counts)| Field::new(*stage, *role, counts));
        let (arrays, mut notes) = context.survey.fields.of_one_shape();
        let arrays = arrays.into_iter().flat_map(|field| {
            let stages: Vec<Stage> = field.counts.grasps.keys().copied().collect();
            stages.into_iter().map(move |stage| (stage, field.clone()))
        });
        let lifts = LiftField::choose(context, &mut notes);
        Ok(Self {
            arrays: arrays.collect(),
            lifts,
            notes,
            context,
            split: String::new(),
            shards: 0,
            open: None,
            fields: fields.collect::<Result<_>>()?,
            decoder: Decoder::new()?,
        })
    }

    fn close(&mut self) -> Result<()> {
        let Some((builder, _)) = self.open.take() else {
            return Ok(());
        };
        let closed = builder.into_inner().and_then(|mut file| file.flush());
        closed.map_err(write_failed)
    }

    /// Returns the open shard, or a new one if it is full.
    fn shard(&mut self, next: usize) -> Result<&mut Builder<BufWriter<File>>> {
        let max_bytes = self.context.plan.shard_bytes;
        if self
            .open
            .as_ref()
            .is_some_and(|(_, size)| size + next > max_bytes)
        {
            self.close()?;
        }
        let (builder, size) = match self.open.take() {
            Some(open) => open,
            None => {
                let name = format!("{}-{:06}.tar", self.split, self.shards);
                self.shards += 1;
                (Builder::new(self.context.folder.file(&name)?), 0)
            }
        };
        let (builder, _) = self.open.insert((builder, size + next));
        Ok(builder)
    }
}

impl Writer for TarShards<'_> {
    fn begin_split(&mut self, split: &str) -> Result<()> {
        self.close()?;
        split.clone_into(&mut self.split);
        self.shards = 0;
        Ok(())
    }

    fn push(&mut self, mut grasp: Grasp) -> Result<Option<Error>> {
        let id = grasp.record.id.clone();
        if id.contains('.') {
            let what = "WebDataset does not support ids with a dot";
            return Ok(Some(Error::input(what)));
        }
        let mut json = typed_json(&grasp);
        let mut files: Vec<(String, Vec<u8>)> = Vec::new();
        for field in &self.fields {
            let image = grasp.images.remove(&(field.stage, field.role));
            json.insert(format!("has_{}", field.name()), image.is_some().into());
            let bytes = match field.bytes(image, &mut self.decoder) {
                Ok(bytes) => bytes,
                Err(error) => return Ok(Some(error)),
            };
            let extension = if field.is_jpeg { "jpg" } else { "png" };
            files.push((format!("{id}.{}.{extension}", field.name()), bytes));
        }
        for (stage, field) in &self.arrays {
            let (role, name) = &field.key;
            let name = format!("{}_{role}_{name}", stage.name());
            let is_there = grasp
                .fields
                .contains_key(&(*stage, *role, field.key.1.clone()));
            json.insert(format!("has_{name}"), is_there.into());
            match field.of(&grasp.fields, *stage) {
                Ok(array) => files.push((format!("{id}.{name}.npy"), array.to_npy())),
                Err(error) => return Ok(Some(error)),
            }
        }
        for lift in &self.lifts {
            let bytes = grasp.lifts.remove(&lift.role);
            json.insert(format!("has_lift_{}", lift.role), bytes.is_some().into());
            let name = format!("{id}.lift_{}.{}", lift.role, lift.extension);
            files.push((name, bytes.unwrap_or_default()));
        }
        let json = serde_json::to_vec(&json)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        let bytes: usize = files.iter().map(|(_, bytes)| bytes.len()).sum();
        let size = json.len() + bytes + OVERHEAD * (1 + files.len());
        let builder = self.shard(size)?;
        append(builder, &format!("{id}.json"), &json)?;
        for (name, bytes) in &files {
            append(builder, name, bytes)?;
        }
        Ok(None)
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>> {
        self.close()?;
        let mut notes = std::mem::take(&mut self.notes);
        for field in &self.fields {
            let name = field.name();
            let counts = self.context.survey.cameras.get(&(field.stage, field.role));
            let lacking = self.context.survey.grasps - counts.map_or(0, |counts| counts.grasps);
            if lacking > 0 {
                notes.push(format!(
                    "{name}: black where `has_{name}` is false, {lacking} grasps"
                ));
            }
            if field.converted > 0 {
                let count = field.converted;
                notes.push(format!(
                    "{name}: {count} JPEG images became PNG, as the others are"
                ));
            }
        }
        Ok(notes)
    }
}

/// Adds a file without owner and date, so that equal grasps give equal bytes.
fn append(builder: &mut Builder<BufWriter<File>>, name: &str, bytes: &[u8]) -> Result<()> {
    let mut header = Header::new_ustar();
    header.set_entry_type(EntryType::Regular);
    header.set_size(bytes.len() as u64);
    header.set_mode(0o644);
    header.set_mtime(0);
    header.set_uid(0);
    header.set_gid(0);
    let appended = builder.append_data(&mut header, name, bytes);
    appended.map_err(write_failed)
}
