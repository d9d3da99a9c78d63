//! A film: one simulated grasp as the virtual rig plays it.
//!
//! A film is five files that share a name:
//!
//! | file | what |
//! | --- | --- |
//! | `NAME.trace.bin` | the trace of the grasp, thinned to the steps that are shown |
//! | `NAME.colour.jpg` | what the D435's colour camera sees at the key steps, one below the other |
//! | `NAME.depth.png` | what its stereo module measures there without noise, 16 bits, mm |
//! | `NAME.outside.jpg` | what a camera beside the table sees at its own key steps |
//! | `NAME.sheet.toml` | the board file of the sheet that the object stands on |
//!
//! The trace's header says in `film` which steps are keys, and the intrinsics of the camera
//! beside the table: `{"keys": [0, 3, …], "outside_keys": [0, …], "outside_camera": {…}}`. Between keys the image of the last one is
//! shown. Tactile images are not stored: they are rendered from the trace, step by step.

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
use gripcast_sim::grasp::{GraspOutcome, StageName, TraceFile, TraceStep};
use gripcast_tactile::{SimulatedGel, TraceHeader, TraceObject, TraceStart};

/// Ends of the files' names.
pub(super) const TRACE: &str = ".trace.bin";
const COLOUR: &str = ".colour.jpg";
const DEPTH: &str = ".depth.png";
const OUTSIDE: &str = ".outside.jpg";
const SHEET: &str = ".sheet.toml";
/// Most pixels of a strip: 100 images of the colour camera.
const MAX_PIXELS: usize = 100 * 1280 * 720;

/// The contents of a film's files.
#[derive(Clone, Debug)]
pub struct FilmFiles {
    /// Thinned trace with the keys in its header.
    pub trace: Cow<'static, [u8]>,
    /// JPEG strip of the colour camera.
    pub colour: Cow<'static, [u8]>,
    /// PNG strip of the depth camera.
    pub depth: Cow<'static, [u8]>,
    /// JPEG strip of the camera beside the table.
    pub outside: Cow<'static, [u8]>,
    /// Board file of the sheet.
    pub sheet: Cow<'static, [u8]>,
}

impl FilmFiles {
    /// Reads the films' files of `name` in a folder.
    pub(super) fn read(folder: &Path, name: &str) -> Result<Self> {
        let read = |end: &str| -> Result<Cow<'static, [u8]>> {
            let file = FileName::parse(&format!("{name}{end}"))?;
            let path = Root::new(folder).top().join(file);
            let bytes = path
                .read(FileKind::Mesh)
                .map_err(|e| Error::io("cannot read the film", e).at(path.display()))?;
            Ok(Cow::Owned(bytes))
        };
        Ok(Self {
            trace: read(TRACE)?,
            colour: read(COLOUR)?,
            depth: read(DEPTH)?,
            outside: read(OUTSIDE)?,
            sheet: read(SHEET)?,
        })
    }

    /// Names and contents of the files of a film called `name`.
    pub fn named(&self, name: &str) -> [(String, &[u8]); 5] {
        [
            (format!("{name}{TRACE}"), &*self.trace),
            (format!("{name}{COLOUR}"), &*self.colour),
            (format!("{name}{DEPTH}"), &*self.depth),
            (format!("{name}{OUTSIDE}"), &*self.outside),
            (format!("{name}{SHEET}"), &*self.sheet),
        ]
    }
}

/// Which shown steps have an image; what a film's header says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilmKeys {
    /// Steps with an image of the colour and the depth camera, ascending from 0.
    pub keys: Vec<usize>,
    /// Steps with an image of the camera beside the table.
    pub outside_keys: Vec<usize>,
    /// That camera.
    pub outside_camera: Intrinsics,
}

impl FilmKeys {
    fn validate(&self, steps: usize) -> Result<()> {
        for keys in [&self.keys, &self.outside_keys] {
            let ascending = keys.windows(2).all(|pair| pair[0] < pair[1]);
            let within = keys.last().is_some_and(|last| *last < steps);
            if keys.first() != Some(&0) || !ascending || !within {
                return Err(damaged(format!(
                    "its keys must ascend from 0 and be below its {steps} steps, found {keys:?}"
                )));
            }
        }
        self.outside_camera
            .validate()
            .map(|_| ())
            .map_err(|e| damaged("its camera beside the table".to_owned()).because(e))
    }
}

/// What a film's header tells of the grasp.
#[derive(Deserialize)]
struct Told {
    outcome: GraspOutcome,
    lifted_m: f64,
    object: ToldObject,
    film: FilmKeys,
}

#[derive(Deserialize)]
struct ToldObject {
    mass_kg: f64,
    friction: f64,
}

/// One simulated grasp, ready to be played.
#[derive(Debug)]
pub struct Film {
    name: String,
    folder: PathBuf,
    files: FilmFiles,
    keys: FilmKeys,
    object: TraceObject,
    mesh: OnceLock<TriangleMesh>,
    gel: SimulatedGel,
    start: TraceStart,
    steps: Vec<TraceStep>,
    /// The last step before the lift.
    closed: usize,
    outcome: GraspOutcome,
    lifted_m: f64,
    mass_kg: f64,
    friction: f64,
}

impl Film {
    /// Reads a film; its images and the object's mesh are read when they are asked for.
    /// `folder` is where a relative path of the mesh is looked for.
    ///
    /// # Errors
    /// `Input` where the trace is none, has no steps, or its header lacks what a film needs.
    pub fn parse(name: &str, files: FilmFiles, folder: &Path) -> Result<Self> {
        let TraceFile { header, trace } = TraceFile::read(&files.trace)?;
        let told = Told::deserialize(&header).map_err(|e| {
            damaged("the trace's header does not tell its keys, outcome and object".to_owned())
                .because(e)
        })?;
        let TraceHeader { gel, object } = TraceHeader::read(&header)?;
        let start = TraceStart::read(&header)?;
        let steps = trace.steps;
        told.film.validate(steps.len())?;
        let before_lift = |step: &TraceStep| step.stage != StageName::Lift;
        let closed = steps.iter().rposition(before_lift).unwrap_or(0);
        Ok(Self {
            name: name.to_owned(),
            folder: folder.to_owned(),
            files,
            keys: told.film,
            object,
            mesh: OnceLock::new(),
            gel,
            start,
            steps,
            closed,
            outcome: told.outcome,
            lifted_m: told.lifted_m,
            mass_kg: told.object.mass_kg,
            friction: told.object.friction,
        })
    }

    /// Reads everything, so that nothing can fail later.
    ///
    /// # Errors
    /// `Input` for a damaged strip; those of reading the object's mesh.
    pub(super) fn check(&self) -> Result<()> {
        self.mesh()?;
        self.colour()?;
        self.outside()?;
        self.sheet()?;
        self.depth_mm().map(|_| ())
    }

    /// Its name: that of its files.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its files.
    pub fn files(&self) -> &FilmFiles {
        &self.files
    }

    /// How the grasp ends.
    pub fn outcome(&self) -> GraspOutcome {
        self.outcome
    }

    /// Name of the object without the folder or `builtin:`.
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

    /// The step that is shown at `progress`: 0 open, 1 closed, 2 lifted.
    pub fn step_at(&self, progress: f64) -> usize {
        let last = self.steps.len() - 1;
        let at = if progress <= 1.0 {
            progress.max(0.0) * self.closed as f64
        } else {
            self.closed as f64 + (progress - 1.0).min(1.0) * (last - self.closed) as f64
        };
        // Half a step of rounding would show contact before the hand has moved.
        (at + 1e-9) as usize
    }

    /// The shown steps.
    pub fn steps(&self) -> &[TraceStep] {
        &self.steps
    }

    /// How the grasp began.
    pub fn start(&self) -> &TraceStart {
        &self.start
    }

    /// The gels of the simulation.
    pub fn gel(&self) -> &SimulatedGel {
        &self.gel
    }

    /// The object's mesh as it was simulated, m.
    ///
    /// # Errors
    /// Those of reading it; `Input` where it is no longer the simulated one.
    pub fn mesh(&self) -> Result<&TriangleMesh> {
        if let Some(mesh) = self.mesh.get() {
            return Ok(mesh);
        }
        let trace = self.folder.join(format!("{}{TRACE}", self.name));
        let mesh = self.object.load(&trace)?;
        Ok(self.mesh.get_or_init(|| mesh))
    }

    /// What is true at a step: what a perfect observer of the grasp would write down.
    pub fn truth_at(&self, step: usize) -> SimulatedTruth {
        let step = &self.steps[step.min(self.steps.len() - 1)];
        let lift = Pose::from_translation(DVec3::Z * step.lifted_m);
        let t_world_gripper = lift * self.start.t_world_gripper();
        SimulatedTruth {
            clip: self.name.clone(),
            object: self.object.source.clone(),
            object_sha256: self.object.sha256.clone(),
            mass_kg: self.mass_kg,
            friction: self.friction,
            outcome: self.outcome.name().to_owned(),
            held: self.outcome == GraspOutcome::Success,
            lifted_m: self.lifted_m,
            t_object_gripper_initial: self.start.t_object_gripper,
            t_object_gripper: step.t_world_object.inverse() * t_world_gripper,
            opening_m: step.opening_m,
            force_n: step.force.map(|force| force.normal_n),
        }
    }

    /// Number of the colour (and depth) image at a step.
    pub(super) fn key_at(&self, step: usize) -> usize {
        key_at(&self.keys.keys, step)
    }

    /// Number of the outside image at a step.
    pub(super) fn outside_key_at(&self, step: usize) -> usize {
        key_at(&self.keys.outside_keys, step)
    }

    /// Images of the colour camera, one a key.
    pub(super) fn colour(&self) -> Result<Vec<RgbImage>> {
        self.strip(&self.files.colour, COLOUR, self.keys.keys.len())
    }

    /// Images of the camera beside the table.
    pub(super) fn outside(&self) -> Result<Vec<RgbImage>> {
        self.strip(&self.files.outside, OUTSIDE, self.keys.outside_keys.len())
    }

    /// Intrinsics of the camera beside the table where its frames have `width` × `height` pixels;
    /// none for another shape than that of the film's images, as those are cut.
    pub fn outside_intrinsics(&self, width: u32, height: u32) -> Option<Intrinsics> {
        let own = self.keys.outside_camera;
        if u64::from(width) * u64::from(own.height) != u64::from(height) * u64::from(own.width) {
            return None;
        }
        let scale = f64::from(width) / f64::from(own.width);
        let place = |centre: f64| (centre + 0.5) * scale - 0.5;
        Some(Intrinsics {
            width,
            height,
            fx: own.fx * scale,
            fy: own.fy * scale,
            cx: place(own.cx),
            cy: place(own.cy),
            ..own
        })
    }

    /// The sheet that the object stands on.
    ///
    /// # Errors
    /// `Input` for a damaged file.
    pub fn sheet(&self) -> Result<BoardFile> {
        let read = || {
            let text = str::from_utf8(&self.files.sheet)
                .map_err(|_| damaged("its sheet is no text".to_owned()))?;
            BoardFile::parse(text, &self.folder)
        };
        read().map_err(|e| e.at(format!("{}{SHEET}", self.name)))
    }

    /// Depth images without noise, mm, 0 where stereo is blind.
    pub(super) fn depth_mm(&self) -> Result<Vec<DepthImage>> {
        let at = |e: Error| e.at(format!("{}{DEPTH}", self.name));
        let strip = decode_png_grey16(&self.files.depth).map_err(at)?;
        let (width, height) = (strip.width(), strip.height());
        let count = self.keys.keys.len();
        let rows = rows_of_one(height, count).map_err(at)?;
        let length = width as usize * rows as usize;
        let images = strip.as_raw().chunks_exact(length).map(|rows_mm| {
            DepthImage::from_vec(width, rows, rows_mm.to_vec())
                .ok_or_else(|| damaged("its depth strip has the wrong size".to_owned()))
        });
        images.collect()
    }

    fn strip(&self, jpeg: &[u8], end: &str, count: usize) -> Result<Vec<RgbImage>> {
        let at = |e: Error| e.at(format!("{}{end}", self.name));
        let broken = |e: turbojpeg::Error| at(damaged("its JPEG is damaged".to_owned()).because(e));
        let header = turbojpeg::read_header(jpeg).map_err(broken)?;
        if header.width * header.height > MAX_PIXELS {
            let (width, height) = (header.width, header.height);
            return Err(at(damaged(format!("{width}×{height} pixels is no strip"))));
        }
        let strip = turbojpeg::decompress(jpeg, turbojpeg::PixelFormat::RGB).map_err(broken)?;
        let rows = rows_of_one(strip.height as u32, count).map_err(at)?;
        // Rows of the decoder may be padded.
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

/// The header of a film: that of the trace without the figures of the machine that simulated it.
pub(super) fn film_header(header: &Value, keys: &FilmKeys) -> Result<Value> {
    let mut header = header.clone();
    let Some(fields) = header.as_object_mut() else {
        return Err(damaged("the trace's header is no object".to_owned()));
    };
    for of_the_machine in ["wall_s", "times"] {
        fields.remove(of_the_machine);
    }
    let keys = serde_json::to_value(keys)
        .map_err(|e| Error::internal("cannot write the film's keys").because(e))?;
    fields.insert("film".to_owned(), keys);
    Ok(header)
}

fn key_at(keys: &[usize], step: usize) -> usize {
    keys.partition_point(|key| *key <= step).saturating_sub(1)
}

/// Rows of one of `count` images of a strip.
fn rows_of_one(rows: u32, count: usize) -> Result<u32> {
    let count = count as u32;
    if count > 0 && rows > 0 && rows.is_multiple_of(count) {
        return Ok(rows / count);
    }
    Err(damaged(format!(
        "a strip of {count} images cannot have {rows} rows"
    )))
}

fn damaged(what: String) -> Error {
    Error::input(format!("this is no film: {what}"))
        .remedy("make it again with `gripcast render film`")
}
