//! Clips: recorded simulated grasps that the virtual rig plays back.
//!
//! A clip is five files with a common name:
//!
//! | file | contents |
//! | --- | --- |
//! | `NAME.trace.bin` | trace of the grasp and its fields, if recorded, thinned to the shown steps |
//! | `NAME.colour.jpg` | images of the D435's colour camera at the keyframes, stacked vertically |
//! | `NAME.depth.png` | noise-free depth images at their own keyframes, 16 bits, mm |
//! | `NAME.external.jpg` | images of the external camera at its own keyframes |
//! | `NAME.sheet.toml` | board file of the sheet under the object |
//!
//! The `clip` entry of the trace header lists the keyframes (as indices of shown steps) and the
//! intrinsics of the external camera:
//! `{"keys": [0, 3, …], "depth_keys": [0, 3, …], "external_keys": [0, …], "external_camera": {…}}`. Between two keyframes the
//! image of the earlier one is shown. Tactile images are not stored: they are rendered from the
//! trace at each step.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use glam::DVec3;
use image::RgbImage;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, FileName, Root};
use gripcast_dataset::SimulatedTruth;
use gripcast_geometry::{Pose, TriangleMesh};
use gripcast_imaging::{DepthImage, Intrinsics, decode_png_grey16};
use gripcast_pose::BoardFile;
use gripcast_sim::fields::{FaceField, FieldSeries};
use gripcast_sim::grasp::{Finger, GraspOutcome, StageName, Trace, TraceFile, TraceStep};
use gripcast_tactile::{SimulatedGel, TraceHeader, TraceObject, TraceStart};

/// Suffixes of the files.
pub(super) const TRACE: &str = ".trace.bin";
const COLOUR: &str = ".colour.jpg";
const DEPTH: &str = ".depth.png";
const EXTERNAL: &str = ".external.jpg";
const SHEET: &str = ".sheet.toml";
/// Difference of the times of one step in steps and fields, s.
pub(super) const SAME_TIME_S: f64 = 1e-9;
/// Maximum pixels of an image strip: 100 images of the colour camera.
const MAX_PIXELS: usize = 100 * 1280 * 720;

/// Contents of the five files of a clip.
#[derive(Clone, Debug)]
pub struct ClipFiles {
    /// Thinned trace with the keyframes in its header.
    pub trace: Cow<'static, [u8]>,
    /// JPEG strip of the colour camera.
    pub colour: Cow<'static, [u8]>,
    /// PNG strip of the depth camera.
    pub depth: Cow<'static, [u8]>,
    /// JPEG strip of the external camera.
    pub external: Cow<'static, [u8]>,
    /// Board file of the sheet under the object.
    pub sheet: Cow<'static, [u8]>,
}

impl ClipFiles {
    /// Reads the files of the clip `name` in `folder`.
    pub(super) fn read(folder: &Path, name: &str) -> Result<Self> {
        let read = |end: &str| -> Result<Cow<'static, [u8]>> {
            let file = FileName::parse(&format!("{name}{end}"))?;
            let path = Root::new(folder).top().join(file);
            let bytes = path
                .read(FileKind::Mesh)
                .map_err(|e| Error::io("cannot read the clip", e).at(path.display()))?;
            Ok(Cow::Owned(bytes))
        };
        Ok(Self {
            trace: read(TRACE)?,
            colour: read(COLOUR)?,
            depth: read(DEPTH)?,
            external: read(EXTERNAL)?,
            sheet: read(SHEET)?,
        })
    }

    /// Returns the file names and contents of a clip called `name`.
    pub fn named(&self, name: &str) -> [(String, &[u8]); 5] {
        [
            (format!("{name}{TRACE}"), &*self.trace),
            (format!("{name}{COLOUR}"), &*self.colour),
            (format!("{name}{DEPTH}"), &*self.depth),
            (format!("{name}{EXTERNAL}"), &*self.external),
            (format!("{name}{SHEET}"), &*self.sheet),
        ]
    }
}

/// Shown steps for which the cameras have an image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Keyframes {
    /// Steps with an image of the colour camera, ascending from 0.
    pub keys: Vec<usize>,
    /// Steps with an image of the depth camera, ascending from 0: also all steps of the lift.
    pub depth_keys: Vec<usize>,
    /// Steps with an image of the external camera, ascending from 0.
    pub external_keys: Vec<usize>,
    /// Intrinsics of the external camera.
    pub external_camera: Intrinsics,
}

impl Keyframes {
    fn validate(&self, steps: usize) -> Result<()> {
        for keys in [&self.keys, &self.depth_keys, &self.external_keys] {
            let ascending = keys.windows(2).all(|pair| pair[0] < pair[1]);
            let within = keys.last().is_some_and(|last| *last < steps);
            if keys.first() != Some(&0) || !ascending || !within {
                return Err(damaged(format!(
                    "expected keyframes that ascend from 0 to below {steps}, found {keys:?}"
                )));
            }
        }
        self.external_camera
            .validate()
            .map(|_| ())
            .map_err(|e| damaged("its external camera".to_owned()).because(e))
    }
}

/// Fields of the trace header that a clip uses.
#[derive(Debug, Deserialize)]
struct ClipHeader {
    outcome: GraspOutcome,
    lifted_m: f64,
    object: ClipObject,
    clip: Keyframes,
}

#[derive(Debug, Deserialize)]
struct ClipObject {
    mass_kg: f64,
    friction: f64,
}

/// One simulated grasp, ready for playback.
#[derive(Debug)]
pub struct Clip {
    /// Common stem of the file names.
    pub(super) name: String,
    folder: PathBuf,
    pub(super) files: ClipFiles,
    header: ClipHeader,
    object: TraceObject,
    mesh: OnceLock<TriangleMesh>,
    pub(super) gel: SimulatedGel,
    /// Poses at the start of the grasp.
    pub(super) start: TraceStart,
    /// The shown steps.
    pub(super) steps: Vec<TraceStep>,
    /// Fields of the gels' faces, if the simulation recorded them.
    fields: Option<FieldSeries>,
    /// Index of the last step before the lift.
    closed: usize,
}

impl Clip {
    /// Parses the trace of a clip; images and mesh are read on demand. A relative mesh path is
    /// resolved against `folder`.
    ///
    /// # Errors
    /// `Input` for an invalid trace, one without steps, or a header with missing fields.
    pub fn parse(name: &str, files: ClipFiles, folder: &Path) -> Result<Self> {
        let TraceFile { header, trace } = TraceFile::read(&files.trace)?;
        let clip_header = ClipHeader::deserialize(&header).map_err(|e| {
            damaged("its header lacks the keyframes, outcome or object".to_owned()).because(e)
        })?;
        let TraceHeader { gel, object } = TraceHeader::read(&header)?;
        let start = TraceStart::read(&header)?;
        let Trace { steps, fields, .. } = trace;
        clip_header.clip.validate(steps.len())?;
        let before_lift = |step: &TraceStep| step.stage != StageName::Lift;
        let closed = steps.iter().rposition(before_lift).unwrap_or(0);
        Ok(Self {
            name: name.to_owned(),
            folder: folder.to_owned(),
            files,
            header: clip_header,
            object,
            mesh: OnceLock::new(),
            gel,
            start,
            steps,
            fields,
            closed,
        })
    }

    /// Returns the field of a gel's face at a step, if the simulation recorded it.
    pub(super) fn field_at(&self, step: usize, finger: Finger) -> Option<&FaceField> {
        let t_s = self.steps[step].t_s;
        let mut fields = self.fields.iter().flat_map(|series| &series.steps);
        let found = fields.find(|field| (field.t_s - t_s).abs() < SAME_TIME_S)?;
        found.gels.get(finger as usize)
    }

    /// Reads the mesh and all images to check the clip before playback.
    ///
    /// # Errors
    /// `Input` for a damaged image strip; errors of reading the mesh.
    pub(super) fn check(&self) -> Result<()> {
        self.mesh()?;
        self.colour()?;
        self.external()?;
        self.sheet()?;
        self.depth_mm().map(|_| ())
    }

    /// Returns the simulation outcome of the grasp.
    pub fn outcome(&self) -> GraspOutcome {
        self.header.outcome
    }

    /// Returns the name of the object without its folder or `builtin:`.
    pub fn object_name(&self) -> &str {
        let source = &self.object.source;
        match source.strip_prefix("builtin:") {
            Some(name) => name,
            None => Path::new(source)
                .file_stem()
                .and_then(|stem| stem.to_str())
                .unwrap_or(source),
        }
    }

    /// Returns the index of the step shown at `progress`: 0 open, 1 closed, 2 lifted.
    pub fn step_at(&self, progress: f64) -> usize {
        let last = self.steps.len() - 1;
        let index = if progress <= 1.0 {
            progress.max(0.0) * self.closed as f64
        } else {
            self.closed as f64 + (progress - 1.0).min(1.0) * (last - self.closed) as f64
        };
        // Rounding to the nearest step would show contact before the hand moves.
        (index + 1e-9) as usize
    }

    /// Returns the mesh of the object, in its own frame, m.
    ///
    /// # Errors
    /// `Input` if the mesh is not the simulated one; errors of reading it.
    pub fn mesh(&self) -> Result<&TriangleMesh> {
        if let Some(mesh) = self.mesh.get() {
            return Ok(mesh);
        }
        let trace = self.folder.join(format!("{}{TRACE}", self.name));
        let mesh = self.object.load(&trace)?;
        Ok(self.mesh.get_or_init(|| mesh))
    }

    /// Returns the ground truth at a step.
    pub fn truth_at(&self, step: usize) -> SimulatedTruth {
        let step = &self.steps[step.min(self.steps.len() - 1)];
        let lift = Pose::from_translation(DVec3::Z * step.lifted_m);
        let t_world_gripper = lift * self.start.t_world_gripper();
        SimulatedTruth {
            clip: self.name.clone(),
            object: self.object.source.clone(),
            object_sha256: self.object.sha256.clone(),
            mass_kg: self.header.object.mass_kg,
            friction: self.header.object.friction,
            outcome: self.outcome().name().to_owned(),
            stable: self.outcome() == GraspOutcome::Success,
            lifted_m: self.header.lifted_m,
            t_object_gripper_initial: self.start.t_object_gripper,
            t_object_gripper: step.t_world_object.inverse() * t_world_gripper,
            opening_m: step.opening_m,
            force_n: step.force.map(|force| force.normal_n),
        }
    }

    /// Returns the index of the colour image at a step.
    pub(super) fn key_at(&self, step: usize) -> usize {
        key_at(&self.header.clip.keys, step)
    }

    /// Returns the index of the depth image at a step.
    pub(super) fn depth_key_at(&self, step: usize) -> usize {
        key_at(&self.header.clip.depth_keys, step)
    }

    /// Returns the index of the external image at a step.
    pub(super) fn external_key_at(&self, step: usize) -> usize {
        key_at(&self.header.clip.external_keys, step)
    }

    /// Decodes the images of the colour camera, one per keyframe.
    pub(super) fn colour(&self) -> Result<Vec<RgbImage>> {
        self.strip(&self.files.colour, COLOUR, &self.header.clip.keys)
    }

    /// Decodes the images of the external camera, one per keyframe.
    pub(super) fn external(&self) -> Result<Vec<RgbImage>> {
        self.strip(
            &self.files.external,
            EXTERNAL,
            &self.header.clip.external_keys,
        )
    }

    /// Returns the intrinsics of the external camera for frames of `width` × `height` pixels, or
    /// `None` for another aspect ratio, because such images are cropped.
    pub fn external_intrinsics(&self, width: u32, height: u32) -> Option<Intrinsics> {
        let own = self.header.clip.external_camera;
        if u64::from(width) * u64::from(own.height) != u64::from(height) * u64::from(own.width) {
            return None;
        }
        let scale = f64::from(width) / f64::from(own.width);
        let scaled = |centre: f64| (centre + 0.5) * scale - 0.5;
        Some(Intrinsics {
            width,
            height,
            fx: own.fx * scale,
            fy: own.fy * scale,
            cx: scaled(own.cx),
            cy: scaled(own.cy),
            ..own
        })
    }

    /// Returns the board of the sheet under the object.
    ///
    /// # Errors
    /// `Input` for a damaged board file.
    pub fn sheet(&self) -> Result<BoardFile> {
        let read = || {
            let text = str::from_utf8(&self.files.sheet)
                .map_err(|_| damaged("its sheet is not UTF-8 text".to_owned()))?;
            BoardFile::parse(text, &self.folder)
        };
        read().map_err(|e| e.at(format!("{}{SHEET}", self.name)))
    }

    /// Decodes the noise-free depth images, mm, 0 where stereo has no match.
    pub(super) fn depth_mm(&self) -> Result<Vec<DepthImage>> {
        let at = |e: Error| e.at(format!("{}{DEPTH}", self.name));
        let strip = decode_png_grey16(&self.files.depth).map_err(at)?;
        let (width, height) = (strip.width(), strip.height());
        let rows = image_rows(height, &self.header.clip.depth_keys).map_err(at)?;
        let length = width as usize * rows as usize;
        let images = strip.as_raw().chunks_exact(length).map(|rows_mm| {
            DepthImage::from_vec(width, rows, rows_mm.to_vec())
                .ok_or_else(|| damaged("its depth strip has the wrong size".to_owned()))
        });
        images.collect()
    }

    /// Decodes a JPEG strip with one image per keyframe.
    fn strip(&self, jpeg: &[u8], suffix: &str, keys: &[usize]) -> Result<Vec<RgbImage>> {
        let at = |e: Error| e.at(format!("{}{suffix}", self.name));
        let broken = |e: turbojpeg::Error| at(damaged("its JPEG is damaged".to_owned()).because(e));
        let header = turbojpeg::read_header(jpeg).map_err(broken)?;
        if header.width * header.height > MAX_PIXELS {
            let (width, height) = (header.width, header.height);
            return Err(at(damaged(format!("{width}×{height} pixels are too many"))));
        }
        let strip = turbojpeg::decompress(jpeg, turbojpeg::PixelFormat::RGB).map_err(broken)?;
        let rows = image_rows(strip.height as u32, keys).map_err(at)?;
        // The decoder may pad rows.
        let tight: Vec<u8> = strip
            .pixels
            .chunks(strip.pitch)
            .flat_map(|row| &row[..3 * strip.width])
            .copied()
            .collect();
        let width = strip.width as u32;
        let images = tight
            .chunks_exact(3 * strip.width * rows as usize)
            .map(|image| {
                RgbImage::from_raw(width, rows, image.to_vec())
                    .ok_or_else(|| at(damaged("its strip has the wrong size".to_owned())))
            });
        images.collect()
    }
}

/// Returns the header of a clip: the trace header with keyframes and without timings.
pub(super) fn clip_header(header: &Value, keys: &Keyframes) -> Result<Value> {
    let mut header = header.clone();
    let Some(fields) = header.as_object_mut() else {
        return Err(damaged("the trace header is not a JSON object".to_owned()));
    };
    for timing in ["wall_s", "times"] {
        fields.remove(timing);
    }
    let keys = serde_json::to_value(keys)
        .map_err(|e| Error::internal("cannot serialise the keyframes").because(e))?;
    fields.insert("clip".to_owned(), keys);
    Ok(header)
}

fn key_at(keys: &[usize], step: usize) -> usize {
    keys.partition_point(|key| *key <= step).saturating_sub(1)
}

/// Returns the rows of one image in a strip of `rows` rows with one image per keyframe.
fn image_rows(rows: u32, keys: &[usize]) -> Result<u32> {
    let count = keys.len() as u32;
    if count > 0 && rows > 0 && rows.is_multiple_of(count) {
        return Ok(rows / count);
    }
    Err(damaged(format!(
        "expected a strip of {count} images of equal height, found {rows} rows"
    )))
}

fn damaged(what: String) -> Error {
    Error::input(format!("not a valid clip: {what}"))
        .remedy("record it again with `gripcast render clip`")
}
