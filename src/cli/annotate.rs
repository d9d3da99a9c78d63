//! `gripcast annotate DATASET`: where the gripper was relative to the object, in every grasp.
//!
//! ```text
//! gripcast annotate demo                          boards and intrinsics as collected
//! gripcast annotate demo --sheet cup.toml --tags tags.toml --intrinsics external.yaml
//! gripcast annotate demo --sheet sheets/          sheets/OBJECT.toml for each object's name
//! gripcast annotate demo --again --json           also those that have a pose
//! ```
//!
//! The last sharp images of the external camera before the fingers close give
//! `t_object_gripper` with its covariance, which goes into `grasp.json`; `overlays/GRASP.jpg` shows
//! what was found. A pose that a person has corrected is never overwritten.
//!
//! Exit codes: 0 all have a pose · 1 nothing could be done · 2 usage · 3 some grasps have none,
//! each with the reason · 130 interrupted; what is written by then is whole.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DQuat, DVec3};
use image::imageops::grayscale;
use image::{GrayImage, RgbImage};
use serde::Serialize;

use super::sim_object::SimObject;
use super::working::{Progress, interruptible};
use super::{Context, create_folder, print_report};
use crate::daemon::{read_sheets, stored_intrinsics};
use gripcast_annotate::{
    Annotation, Annotator, Observation, OverlayContent, is_between_fingers, overlay,
};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{ContentKey, FileKind, ObjectName, Root};
use gripcast_dataset::{Dataset, DatasetWriter, GraspId, GraspRecord, NewDataset, PoseRecord};
use gripcast_geometry::{LengthUnit, Pose, TriangleMesh};
use gripcast_imaging::{Decoder, Intrinsics, Role, encode_jpeg};
use gripcast_pose::{BoardFile, PrintedSheet, load_intrinsics};

/// JPEG quality of the overlays.
const OVERLAY_QUALITY: u8 = 88;
/// Folder of the overlays in a dataset.
const OVERLAYS: &str = "overlays";

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Directory of the dataset
    dataset: PathBuf,
    /// Board file of the sheet that the object stood on, or a folder with OBJECT.toml for each
    /// object [default: as collected]
    #[arg(long, value_name = "FILE|DIR")]
    sheet: Option<PathBuf>,
    /// Board file of the gripper's tags [default: as collected]
    #[arg(long, value_name = "FILE")]
    tags: Option<PathBuf>,
    /// Intrinsics of the external camera [default: as collected]
    #[arg(long, value_name = "FILE")]
    intrinsics: Option<PathBuf>,
    /// Annotate grasps that have a pose again, unless a person has corrected it
    #[arg(long)]
    again: bool,
    /// Folder of the overlay images [default: DATASET/overlays]
    #[arg(long, value_name = "DIR")]
    overlays: Option<PathBuf>,
    /// Draw no overlay images
    #[arg(long, conflicts_with = "overlays")]
    no_overlays: bool,
    /// Change nothing, only say what would be found
    #[arg(long)]
    dry_run: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// What was done.
#[derive(Debug, Default, Serialize)]
struct Summary {
    dataset: PathBuf,
    grasps: usize,
    annotated: Vec<Annotated>,
    /// They had a pose already.
    already: Vec<GraspId>,
    /// A person has corrected their pose.
    by_hand: Vec<GraspId>,
    failed: Vec<Failed>,
    dry_run: bool,
}

#[derive(Debug, Serialize)]
struct Annotated {
    grasp: GraspId,
    object: String,
    pose: PoseRecord,
    overlay: Option<PathBuf>,
    /// Distance and angle from the truth, where the frames are those of a virtual rig.
    #[serde(skip_serializing_if = "Option::is_none")]
    off_truth_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    off_truth_deg: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Failed {
    grasp: GraspId,
    reason: String,
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let json = args.json;
    let summary = interruptible(context, "annotating", move |progress| {
        annotate(&args, progress)
    })??;
    print_report(json, &summary, |summary| summary.text())?;
    if !summary.failed.is_empty() {
        return Err(Error::new(
            ErrorKind::Partial,
            format!(
                "{} of {} grasps have no pose",
                summary.failed.len(),
                summary.grasps
            ),
        )
        .remedy("their reasons are above"));
    }
    Ok(())
}

fn annotate(args: &Args, progress: &Progress) -> Result<Summary> {
    let given = Given::read(args)?;
    let dataset = Dataset::open(&args.dataset)?;
    let mut writer = None;
    if !args.dry_run {
        let described = dataset.descriptor();
        let same = NewDataset {
            name: described.name.clone(),
            rig: described.rig.clone(),
            licence: described.licence.clone(),
            label_definition: described.label_definition.clone(),
        };
        writer = Some(DatasetWriter::open_or_create(&args.dataset, &same)?.0);
    }
    let ids = dataset.ids()?;
    let mut summary = Summary {
        dataset: args.dataset.clone(),
        grasps: ids.len(),
        dry_run: args.dry_run,
        ..Summary::default()
    };
    let mut work = Work {
        args,
        given,
        dataset: &dataset,
        decoder: Decoder::new()?,
        annotator: None,
        meshes: BTreeMap::new(),
    };
    for (done, id) in ids.iter().enumerate() {
        progress.at(done as u64, ids.len() as u64);
        let result = dataset.grasp(id).and_then(|record| {
            if let Some(pose) = &record.pose {
                if pose.corrected_by_hand {
                    summary.by_hand.push(id.clone());
                    return Ok(());
                }
                if !args.again {
                    summary.already.push(id.clone());
                    return Ok(());
                }
            }
            let annotated = work.grasp(&record)?;
            if let Some(writer) = &mut writer {
                writer.set_pose(id, annotated.pose.clone())?;
            }
            summary.annotated.push(annotated);
            Ok(())
        });
        if let Err(error) = result {
            if error.kind() == ErrorKind::DiskFull {
                return Err(error);
            }
            progress.line(format!("{id}: {error}"));
            summary.failed.push(Failed {
                grasp: id.clone(),
                reason: error.to_string(),
            });
        }
    }
    if let Some(mut writer) = writer {
        writer.flush_index()?;
    }
    if summary.grasps == summary.failed.len() && summary.grasps > 0 {
        let first = summary.failed.first().map_or("", |f| f.reason.as_str());
        let text = if summary.grasps == 1 {
            first.to_owned()
        } else {
            format!("no grasp could be annotated; the first: {first}")
        };
        return Err(Error::input(text));
    }
    Ok(summary)
}

/// Boards and intrinsics of the command line.
struct Given {
    sheet: Option<BoardFile>,
    sheets: Option<BTreeMap<ObjectName, BoardFile>>,
    tags: Option<BoardFile>,
    intrinsics: Option<Intrinsics>,
}

impl Given {
    fn read(args: &Args) -> Result<Self> {
        let is_folder = args.sheet.as_ref().is_some_and(|sheet| sheet.is_dir());
        let (folder, file) = if is_folder {
            (args.sheet.as_deref(), None)
        } else {
            (None, args.sheet.as_deref())
        };
        let intrinsics = args.intrinsics.as_deref();
        Ok(Self {
            sheet: file.map(BoardFile::load).transpose()?,
            sheets: folder.map(read_sheets).transpose()?,
            tags: args.tags.as_deref().map(BoardFile::load).transpose()?,
            intrinsics: intrinsics.map(load_intrinsics).transpose()?,
        })
    }
}

struct Work<'a> {
    args: &'a Args,
    given: Given,
    dataset: &'a Dataset,
    decoder: Decoder,
    /// Of the last grasp; most have the same boards.
    annotator: Option<Annotator>,
    /// Meshes of sheets by their hash; none where they cannot be found.
    meshes: BTreeMap<String, Option<Arc<TriangleMesh>>>,
}

impl Work<'_> {
    fn grasp(&mut self, record: &GraspRecord) -> Result<Annotated> {
        let (images, unreadable) = self.images(record);
        if images.is_empty() {
            return Err(unreadable.unwrap_or_else(|| {
                Error::not_found("the grasp has no image of an external camera")
                    .remedy("bind [cameras.external] in the rig file when collecting")
            }));
        }
        self.prepare(record)?;
        let Some(annotator) = &mut self.annotator else {
            return Err(Error::internal("there is no annotator"));
        };
        let grey = images.iter().map(|p| (p.name.clone(), &p.grey));
        let Annotation {
            record: mut pose,
            shown,
            shown_image,
        } = annotator.annotate(grey)?;
        if let (Some(quality), Some(error)) = (&mut pose.quality, unreadable) {
            let note = format!("an image was left out: {}", error.what());
            quality.notes.push(note);
        }
        let mesh = self.mesh();
        if let (Some(mesh), Some(quality)) = (&mesh, &mut pose.quality)
            && let Some(opening_m) = quality.opening_m
            && !is_between_fingers(mesh, &placed(&pose.t_m, &pose.q_wxyz), opening_m)
        {
            quality.notes.push(
                "nothing of the object would be between the fingers: was the sheet printed at \
                 100 % (--measured-mm), and did the object stand on its line?"
                    .to_owned(),
            );
        }
        let off = record.truth.as_ref().map(|truth| {
            let (shift_m, turn_rad) = distance(&pose, &truth.t_object_gripper_initial);
            (1e3 * shift_m, turn_rad.to_degrees())
        });
        let colour = images.into_iter().find(|p| p.name == shown_image);
        let overlay = match colour {
            Some(image) if !self.args.no_overlays && !self.args.dry_run => {
                Some(self.draw(record, image.colour, &shown, &pose, mesh.as_deref())?)
            }
            _ => None,
        };
        Ok(Annotated {
            grasp: record.id.clone(),
            object: record.object.to_string(),
            pose,
            overlay,
            off_truth_mm: off.map(|(mm, _)| mm),
            off_truth_deg: off.map(|(_, deg)| deg),
        })
    }

    /// The images from before the fingers closed, by time; an error of one that cannot be read.
    fn images(&mut self, record: &GraspRecord) -> (Vec<Image>, Option<Error>) {
        let mut failure = None;
        let mut images = Vec::new();
        for (camera, path) in self.dataset.external_images_before_closing(record) {
            let bytes = path
                .read(FileKind::Image)
                .map_err(|e| Error::io("cannot read the image", e));
            let read = bytes.and_then(|bytes| self.decoder.stored_image(&bytes));
            match read.map_err(|e| e.at(path.display())) {
                Ok(colour) => images.push(Image {
                    name: camera.file.into(),
                    grey: grayscale(&colour),
                    colour,
                }),
                Err(error) => failure = Some(error),
            }
        }
        (images, failure)
    }

    /// Sees to an annotator for the boards and the camera of a grasp.
    fn prepare(&mut self, record: &GraspRecord) -> Result<()> {
        let (sheet, tags) = (self.sheet(record)?, self.tags(record)?);
        let intrinsics = self.intrinsics(record)?;
        let fits = self.annotator.as_ref().is_some_and(|annotator| {
            annotator.sheet() == &sheet
                && annotator.tags() == &tags
                && annotator.intrinsics() == &intrinsics
        });
        if !fits {
            self.annotator = None;
            self.annotator = Some(Annotator::new(sheet, tags, intrinsics)?);
        }
        Ok(())
    }

    fn sheet(&self, record: &GraspRecord) -> Result<BoardFile> {
        if let Some(sheet) = &self.given.sheet {
            return Ok(sheet.clone());
        }
        if let Some(sheets) = &self.given.sheets {
            return sheets.get(&record.object).cloned().ok_or_else(|| {
                Error::not_found(format!(
                    "there is no sheet for the object `{}`",
                    record.object
                ))
                .remedy(format!(
                    "put its board file there as {}.toml",
                    record.object
                ))
            });
        }
        let key = record.boards.as_ref().map(|boards| &boards.sheet);
        self.stored(key, "which sheet the object stood on", "--sheet FILE")
    }

    fn tags(&self, record: &GraspRecord) -> Result<BoardFile> {
        if let Some(tags) = &self.given.tags {
            return Ok(tags.clone());
        }
        let key = record.boards.as_ref().map(|boards| &boards.tags);
        self.stored(key, "which tags the gripper had", "--tags FILE")
    }

    /// A board that was stored with the grasp.
    fn stored(&self, key: Option<&ContentKey>, what: &str, flag: &str) -> Result<BoardFile> {
        let Some(key) = key else {
            return Err(Error::not_found(format!("the dataset does not say {what}"))
                .remedy(format!("give {flag}")));
        };
        BoardFile::parse(&self.dataset.calibration(key)?, Path::new(""))
    }

    fn intrinsics(&self, record: &GraspRecord) -> Result<Intrinsics> {
        if let Some(intrinsics) = &self.given.intrinsics {
            return Ok(*intrinsics);
        }
        let key = record.calibration.get(&Role::External);
        let text = key.map(|key| self.dataset.calibration(key)).transpose()?;
        let stored = text.map(|text| stored_intrinsics(&text)).transpose()?;
        stored.flatten().ok_or_else(|| {
            Error::not_found(
                "the external camera is not calibrated: the dataset has no intrinsics of it",
            )
            .remedy("measure them with `gripcast calibrate intrinsics` and give --intrinsics FILE")
        })
    }

    /// The mesh of the object on the sheet, where it can be found.
    fn mesh(&mut self) -> Option<Arc<TriangleMesh>> {
        let sheet = self.annotator.as_ref()?.sheet().sheet.as_ref()?;
        let known = self.meshes.entry(sheet.object_sha256.clone());
        known
            .or_insert_with(|| mesh_of(sheet).map(Arc::new))
            .clone()
    }

    fn draw(
        &self,
        record: &GraspRecord,
        mut image: RgbImage,
        shown: &Observation,
        pose: &PoseRecord,
        mesh: Option<&TriangleMesh>,
    ) -> Result<PathBuf> {
        // Inside a dataset nothing is written through a link.
        let folder = match &self.args.overlays {
            Some(folder) => {
                create_folder(folder)?;
                Root::new(folder).top()
            }
            None => Root::new(&self.args.dataset).top().join(OVERLAYS),
        };
        let unwritten = |e| Error::io("cannot write the overlay", e).at(folder.display());
        if let Some(annotator) = &self.annotator {
            let content = OverlayContent {
                mesh,
                lines: lines(record, pose),
            };
            overlay(&mut image, shown, annotator.intrinsics(), &content);
        }
        let jpeg = encode_jpeg(&image, OVERLAY_QUALITY)?;
        let place = folder.join_affixed("", &record.id, ".jpg");
        let written = folder.create_dir_all().and_then(|()| place.replace(&jpeg));
        written.map_err(unwritten)?;
        Ok(place.shown())
    }
}

struct Image {
    name: String,
    grey: GrayImage,
    colour: RgbImage,
}

/// The mesh that a sheet was made for, in whichever unit has its hash.
fn mesh_of(sheet: &PrintedSheet) -> Option<TriangleMesh> {
    LengthUnit::ALL.into_iter().find_map(|unit| {
        let object = SimObject::read(&sheet.object, unit, 1.0).ok()?;
        (object.mesh.content_hash() == sheet.object_sha256).then_some(object.mesh)
    })
}

fn lines(record: &GraspRecord, pose: &PoseRecord) -> Vec<String> {
    let [x, y, z] = pose.t_m.map(|m| 1e3 * m);
    let sigma = |first: usize, unit: f64| {
        let variances = pose
            .covariance
            .iter()
            .flatten()
            .step_by(7)
            .skip(first)
            .take(3);
        unit * variances.sum::<f64>().max(0.0).sqrt()
    };
    let mut lines = vec![
        format!("{} {}", record.id, record.object),
        format!(
            "t_object_gripper {x:.2} {y:.2} {z:.2} mm  sigma {:.2} mm {:.3} deg",
            sigma(0, 1e3),
            sigma(3, 180.0 / std::f64::consts::PI)
        ),
    ];
    if let Some(quality) = &pose.quality {
        let opening = quality.opening_m.map_or(String::new(), |opening| {
            format!("  opening {:.2} mm", 1e3 * opening)
        });
        lines.push(format!(
            "sheet {} markers {:.2} px  tags {} {:.2} px  frames {}{opening}{}",
            quality.markers[0],
            pose.reprojection_px.unwrap_or_default(),
            quality.markers[1],
            quality.tags_reprojection_px,
            quality.frames.len(),
            if quality.ambiguous { "  AMBIGUOUS" } else { "" },
        ));
    }
    lines
}

fn placed(t_m: &[f64; 3], [w, x, y, z]: &[f64; 4]) -> Pose {
    Pose::new(DQuat::from_xyzw(*x, *y, *z, *w), DVec3::from_array(*t_m))
}

/// Distance, m, and angle, rad, of a pose from another.
fn distance(pose: &PoseRecord, other: &Pose) -> (f64, f64) {
    let own = placed(&pose.t_m, &pose.q_wxyz);
    let shift = other.translation_m - own.translation_m;
    (shift.length(), own.turn_from(other).length())
}

impl Summary {
    fn text(&self) -> String {
        let mut lines: Vec<String> = self
            .annotated
            .iter()
            .map(|done| {
                let [x, y, z] = done.pose.t_m.map(|m| 1e3 * m);
                let quality = done.pose.quality.as_ref();
                let doubts = quality.map_or(0, |q| q.notes.len());
                let off = done.off_truth_mm.zip(done.off_truth_deg);
                format!(
                    "{}  {:<12} {x:8.2} {y:8.2} {z:8.2} mm{}{}",
                    done.grasp,
                    done.object,
                    off.map_or(String::new(), |(mm, deg)| format!(
                        "  off the truth by {mm:.3} mm, {deg:.3}°"
                    )),
                    match doubts {
                        0 => String::new(),
                        count => format!("  {count} notes"),
                    }
                )
            })
            .collect();
        for (count, what) in [
            (self.annotated.len(), "annotated"),
            (
                self.already.len(),
                "had a pose already (--again measures them anew)",
            ),
            (self.by_hand.len(), "corrected by hand, kept"),
            (self.failed.len(), "without a pose"),
        ] {
            if count > 0 || what == "annotated" {
                let dry = if self.dry_run {
                    " (nothing was changed)"
                } else {
                    ""
                };
                lines.push(format!("{count:5}  {what}{dry}"));
            }
        }
        lines.join("\n")
    }
}
