//! `gripcast annotate DATASET`: estimates the gripper pose relative to the object in every grasp.
//!
//! ```text
//! gripcast annotate demo                          boards and intrinsics as collected
//! gripcast annotate demo --sheet cup.toml --tags tags.toml --intrinsics external.yaml
//! gripcast annotate demo --sheet sheets/          sheets/OBJECT.toml for each object
//! gripcast annotate demo --again --json           also grasps that have a pose
//! ```
//!
//! `t_object_gripper` and its covariance are estimated from the last sharp pre-grasp frames of the
//! external camera and stored in `grasp.json`; `overlays/GRASP.jpg` shows the detections. A pose
//! that was corrected by hand is never overwritten.
//!
//! Exit codes: 0 all grasps have a pose · 1 none has · 2 usage · 3 some have none · 130
//! interrupted.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DQuat, DVec3};
use image::imageops::grayscale;
use image::{GrayImage, RgbImage};
use serde::Serialize;

use super::working::{Progress, interruptible};
use super::{Context, create_folder, print_report};
use crate::daemon::{read_object_boards, stored_intrinsics};
use gripcast_annotate::{
    Annotation, Annotator, Observation, OverlayContent, is_between_fingers, overlay,
};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{ContentKey, FileKind, ObjectName, Root};
use gripcast_dataset::{Dataset, DatasetWriter, GraspId, GraspRecord, PoseRecord};
use gripcast_geometry::{LengthUnit, MeshOptions, Pose, TriangleMesh, load_object_mesh};
use gripcast_imaging::{Decoder, Intrinsics, Role, encode_jpeg};
use gripcast_pose::detect::FullSearch;
use gripcast_pose::{BoardFile, PrintedSheet, load_intrinsics};

const OVERLAY_JPEG_QUALITY: u8 = 88;
/// Folder of the overlays in a dataset.
const OVERLAYS: &str = "overlays";

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the dataset
    dataset: PathBuf,
    /// Board file of the printed sheet below the object, or a folder with OBJECT.toml for each
    /// object [default: as collected]
    #[arg(long, value_name = "FILE|DIR")]
    sheet: Option<PathBuf>,
    /// Board file of the gripper tags [default: as collected]
    #[arg(long, value_name = "FILE")]
    tags: Option<PathBuf>,
    /// Intrinsics of the external camera [default: as collected]
    #[arg(long, value_name = "FILE")]
    intrinsics: Option<PathBuf>,
    /// Also annotate grasps that have a pose, unless it was corrected by hand
    #[arg(long)]
    again: bool,
    /// Output directory of the overlay images [default: DATASET/overlays]
    #[arg(long, value_name = "DIR")]
    overlays: Option<PathBuf>,
    /// Do not write overlay images
    #[arg(long, conflicts_with = "overlays")]
    no_overlays: bool,
    /// Estimate the poses without writing anything
    #[arg(long)]
    dry_run: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Result of the command.
#[derive(Debug, Default, Serialize)]
struct Summary {
    dataset: PathBuf,
    grasps: usize,
    annotated: Vec<Annotated>,
    /// Skipped: annotated before.
    already: Vec<GraspId>,
    /// Skipped: corrected by hand.
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
    /// Distance and angle to the ground truth of a virtual rig.
    #[serde(skip_serializing_if = "Option::is_none")]
    error_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error_deg: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Failed {
    grasp: GraspId,
    reason: String,
}

/// Runs the command.
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
        .remedy("see the reasons above"));
    }
    Ok(())
}

fn annotate(args: &Args, progress: &Progress) -> Result<Summary> {
    let given = GivenCalibration::read(args)?;
    let dataset = Dataset::open(&args.dataset)?;
    let mut writer = None;
    if !args.dry_run {
        writer = Some(DatasetWriter::open(&args.dataset)?.0);
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
        progress.count(done, ids.len());
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
            format!("no grasp could be annotated; first error: {first}")
        };
        return Err(Error::input(text));
    }
    Ok(summary)
}

/// Boards and intrinsics given on the command line.
struct GivenCalibration {
    sheet: Option<BoardFile>,
    sheets: Option<BTreeMap<ObjectName, BoardFile>>,
    tags: Option<BoardFile>,
    intrinsics: Option<Intrinsics>,
}

impl GivenCalibration {
    fn read(args: &Args) -> Result<Self> {
        let sheet = args.sheet.as_deref();
        let (file, folder) = (sheet.filter(|s| !s.is_dir()), sheet.filter(|s| s.is_dir()));
        let intrinsics = args.intrinsics.as_deref();
        Ok(Self {
            sheet: file.map(BoardFile::load).transpose()?,
            sheets: folder.map(read_object_boards).transpose()?,
            tags: args.tags.as_deref().map(BoardFile::load).transpose()?,
            intrinsics: intrinsics.map(load_intrinsics).transpose()?,
        })
    }
}

struct Work<'a> {
    args: &'a Args,
    given: GivenCalibration,
    dataset: &'a Dataset,
    decoder: Decoder,
    /// Annotator of the previous grasp, reused for the same boards.
    annotator: Option<Annotator>,
    /// Meshes of sheets by hash; none if the mesh is not found.
    meshes: BTreeMap<String, Option<Arc<TriangleMesh>>>,
}

impl Work<'_> {
    fn grasp(&mut self, record: &GraspRecord) -> Result<Annotated> {
        let (images, unreadable) = self.images(record);
        if images.is_empty() {
            return Err(unreadable.unwrap_or_else(|| {
                Error::not_found("the grasp has no image of an external camera")
                    .remedy("collect with [cameras.external] in the rig file")
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
                "the object is not between the fingers: check that the sheet was printed at 100 % \
                 (`gripcast board make --measured-mm`) and that the object stood on its outline"
                    .to_owned(),
            );
        }
        let error = record.truth.as_ref().map(|truth| {
            let (distance_m, angle_rad) = distance(&pose, &truth.t_object_gripper_initial);
            (1e3 * distance_m, angle_rad.to_degrees())
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
            error_mm: error.map(|(mm, _)| mm),
            error_deg: error.map(|(_, deg)| deg),
        })
    }

    /// Reads the pre-grasp images in order of time; also returns the last read error.
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

    /// Prepares an annotator for the boards and the camera of a grasp.
    fn prepare(&mut self, record: &GraspRecord) -> Result<()> {
        let (sheet, tags) = (self.sheet(record)?, self.tags(record)?);
        let intrinsics = self.intrinsics(record)?;
        let is_same = self.annotator.as_ref().is_some_and(|annotator| {
            annotator.sheet() == &sheet
                && annotator.tags() == &tags
                && annotator.intrinsics() == &intrinsics
        });
        if !is_same {
            self.annotator = None;
            self.annotator = Some(Annotator::new(
                sheet,
                tags,
                intrinsics,
                FullSearch::IfSmall,
            )?);
        }
        Ok(())
    }

    fn sheet(&self, record: &GraspRecord) -> Result<BoardFile> {
        if let Some(sheet) = &self.given.sheet {
            return Ok(sheet.clone());
        }
        if let Some(sheets) = &self.given.sheets {
            return sheets.get(&record.object).cloned().ok_or_else(|| {
                let object = &record.object;
                Error::not_found(format!("no sheet for the object `{object}`"))
                    .remedy(format!("add its board file as {object}.toml"))
            });
        }
        let key = record.boards.as_ref().map(|boards| &boards.sheet);
        self.stored(key, "sheet below the object", "--sheet FILE")
    }

    fn tags(&self, record: &GraspRecord) -> Result<BoardFile> {
        if let Some(tags) = &self.given.tags {
            return Ok(tags.clone());
        }
        let key = record.boards.as_ref().map(|boards| &boards.tags);
        self.stored(key, "gripper tags", "--tags FILE")
    }

    /// Returns a board stored with the grasp.
    fn stored(&self, key: Option<&ContentKey>, what: &str, flag: &str) -> Result<BoardFile> {
        let Some(key) = key else {
            let what = format!("the dataset does not record the {what}");
            return Err(Error::not_found(what).remedy(format!("give {flag}")));
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
            .remedy("run `gripcast calibrate intrinsics` and give --intrinsics FILE")
        })
    }

    /// Returns the mesh of the object on the sheet, if it is found.
    fn mesh(&mut self) -> Option<Arc<TriangleMesh>> {
        let sheet = self.annotator.as_ref()?.sheet().sheet.as_ref()?;
        let mesh = self.meshes.entry(sheet.object_sha256.clone());
        mesh.or_insert_with(|| mesh_of(sheet).map(Arc::new)).clone()
    }

    fn draw(
        &self,
        record: &GraspRecord,
        mut image: RgbImage,
        shown: &Observation,
        pose: &PoseRecord,
        mesh: Option<&TriangleMesh>,
    ) -> Result<PathBuf> {
        // Inside a dataset, links are not followed.
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
        let jpeg = encode_jpeg(&image, OVERLAY_JPEG_QUALITY)?;
        let file = folder.join_affixed("", &record.id, ".jpg");
        let written = folder.create_dir_all().and_then(|()| file.replace(&jpeg));
        written.map_err(unwritten)?;
        Ok(file.shown())
    }
}

struct Image {
    name: String,
    grey: GrayImage,
    colour: RgbImage,
}

/// Loads the mesh of a sheet in the unit that gives its hash.
fn mesh_of(sheet: &PrintedSheet) -> Option<TriangleMesh> {
    LengthUnit::ALL.into_iter().find_map(|unit| {
        let mut options = MeshOptions::new(unit, 1.0);
        options.prepare.needs_inside = false;
        let mesh = load_object_mesh(&sheet.object, &options).ok()?.mesh;
        (mesh.content_hash() == sheet.object_sha256).then_some(mesh)
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

/// Returns distance (m) and angle (rad) between two poses.
fn distance(pose: &PoseRecord, other: &Pose) -> (f64, f64) {
    let own = placed(&pose.t_m, &pose.q_wxyz);
    let shift = other.translation_m - own.translation_m;
    (shift.length(), own.rotation_from(other).length())
}

impl Summary {
    fn text(&self) -> String {
        let mut lines: Vec<String> = self
            .annotated
            .iter()
            .map(|done| {
                let [x, y, z] = done.pose.t_m.map(|m| 1e3 * m);
                let notes = done.pose.quality.iter().flat_map(|q| &q.notes);
                let notes: String = notes.map(|note| format!("\n       note: {note}")).collect();
                let error = done.error_mm.zip(done.error_deg);
                format!(
                    "{}  {:<12} {x:8.2} {y:8.2} {z:8.2} mm{}{notes}",
                    done.grasp,
                    done.object,
                    error.map_or(String::new(), |(mm, deg)| format!(
                        "  error {mm:.3} mm, {deg:.3}°"
                    )),
                )
            })
            .collect();
        let dry_run = if self.dry_run { " (dry run)" } else { "" };
        for (count, what) in [
            (self.annotated.len(), "annotated"),
            (
                self.already.len(),
                "annotated before (--again repeats them)",
            ),
            (self.by_hand.len(), "corrected by hand, kept"),
            (self.failed.len(), "without a pose"),
        ] {
            if count > 0 || what == "annotated" {
                lines.push(format!("{count:5}  {what}{dry_run}"));
            }
        }
        lines.join("\n")
    }
}
