//! Runs an import of videos.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use image::RgbImage;
use jiff::Timestamp;
use serde::Serialize;

use super::onset::{OnsetSettings, find_onset, first_still};
use super::table::{Begins, ClipRow};
use crate::left_out::LeftOut;
use crate::video::Video;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{BeneathPath, FileKind, GraspId};
use gripcast_dataset::{
    CapturedCamera, Dataset, DatasetWriter, GraspMeta, NewDataset, Outcome, StageCapture,
};
use gripcast_imaging::{CropProfile, Frame, GelCells, PixelFormat, Role, crop_and_resize};
use gripcast_shear::{ExpectedMarkers, ShearProblem, ShearTracker, USUAL_M_PER_PX};

/// Rig of imported clips.
const RIG: &str = "video";
/// Start of the note of an imported grasp; the id of the clip follows.
const NOTE: &str = "clip ";
/// Time between two frames, ns: videos seldom store the true one.
const NOMINAL_NS: u64 = 40_000_000;
/// Size of a tactile image for the search, px.
const SIZE: [u32; 2] = [320, 240];
const SIDES: [(Role, &str); 2] = [(Role::Left, "left"), (Role::Right, "right")];

/// What to import, and how.
#[derive(Clone, Debug)]
pub struct VideoImport {
    /// Name of the dataset.
    pub name: String,
    /// Licence of the data.
    pub licence: String,
    /// What the labels mean.
    pub label_definition: String,
    /// Crop profile of the frames.
    pub crop: CropProfile,
    /// How contact is found.
    pub onset: OnsetSettings,
    /// Frames between the contact of both fingers and the grasp frame.
    pub settle: usize,
    /// Initial frame of clips without one in the list.
    pub initial_frame: Option<usize>,
    /// Grasp frame of clips without one in the list.
    pub grasp_frame: Option<usize>,
    /// Whether a clip that begins in contact takes its last frame for the initial one.
    pub initial_at_end: bool,
}

/// A grasp that was imported.
#[derive(Clone, Debug, Serialize)]
pub struct ImportedClip {
    /// Id of the clip in the list.
    pub clip: String,
    /// Id of the grasp.
    pub grasp: GraspId,
    /// Frame of the open gripper.
    pub initial_frame: usize,
    /// First frame in contact of both gels, where it was looked for.
    pub contact_frames: Option<[usize; 2]>,
    /// Frame of the closed gripper.
    pub grasp_frame: usize,
}

/// What was imported.
#[derive(Clone, Debug, Serialize)]
pub struct VideoReport {
    /// Clips in the list.
    pub clips: usize,
    /// Clips that an earlier, interrupted run had imported.
    pub already_there: usize,
    /// Clips that were imported now.
    pub imported: Vec<ImportedClip>,
    /// Stable, slip and unlabelled grasps among them.
    pub outcomes: [usize; 3],
    /// Objects of these.
    pub objects: usize,
    /// Clips that were left out, with the reason.
    pub left_out: Vec<LeftOut>,
}

/// Imports clips as grasps of the dataset at `out`; each grasp is durable once it is counted, and the
/// same call continues after an interruption.
///
/// # Errors
/// `Input`: no clip could be imported, or `out` has other contents; `NotFound` without ffmpeg; those
/// of the writer.
pub fn import_videos(
    clips: &[ClipRow],
    mut left_out: Vec<LeftOut>,
    out: &Path,
    import: &VideoImport,
    on_progress: &dyn Fn(usize, usize),
) -> Result<VideoReport> {
    let total = clips.len() + left_out.len();
    let mut imported = Vec::new();
    let mut outcomes = [0; 3];
    let mut objects = BTreeSet::new();
    let there = clips_there(out)?;
    // Nothing is written before the first clip is read.
    let mut writer = None;
    for (done, clip) in clips.iter().enumerate() {
        on_progress(done, clips.len());
        if there.contains(clip.id.as_str()) {
            continue;
        }
        let frames = match grasp_of(clip, import) {
            Ok(frames) => frames,
            Err(error) if is_of_the_clip(&error) => {
                left_out.push(LeftOut {
                    id: clip.id.to_string(),
                    reason: error.to_string(),
                });
                continue;
            }
            Err(error) => return Err(error.at(format!("clip {}", clip.id))),
        };
        let writer = match &mut writer {
            Some(writer) => writer,
            None => writer.insert(opened(out, import)?),
        };
        let grasp = save(writer, clip, &frames, import)?;
        outcomes[match clip.outcome {
            Outcome::Stable => 0,
            Outcome::Slip => 1,
            Outcome::Unlabelled => 2,
        }] += 1;
        objects.insert(clip.object.as_str());
        imported.push(ImportedClip {
            clip: clip.id.to_string(),
            grasp,
            initial_frame: frames.initial,
            contact_frames: frames.contact,
            grasp_frame: frames.grasp,
        });
    }
    if let Some(writer) = &mut writer {
        writer.flush_index()?;
    }
    on_progress(clips.len(), clips.len());
    let already_there = clips
        .iter()
        .filter(|clip| there.contains(clip.id.as_str()))
        .count();
    if let (true, 0, Some(first)) = (imported.is_empty(), already_there, left_out.first()) {
        let what = format!(
            "none of the {total} clips could be imported; {}: {}",
            first.id, first.reason
        );
        return Err(Error::input(what));
    }
    Ok(VideoReport {
        clips: total,
        already_there,
        imported,
        outcomes,
        objects: objects.len(),
        left_out,
    })
}

/// Whether an error concerns one clip only. Without ffmpeg there is no other.
fn is_of_the_clip(error: &Error) -> bool {
    matches!(error.kind(), ErrorKind::Input)
        || (error.kind() == ErrorKind::NotFound
            && !error.to_string().contains("the program ffmpeg"))
}

/// Ids of the clips that the dataset has.
fn clips_there(out: &Path) -> Result<BTreeSet<String>> {
    let mut there = BTreeSet::new();
    if !out.join("dataset.toml").is_file() {
        return Ok(there);
    }
    let dataset = Dataset::open(out)?;
    if dataset.descriptor().rig != RIG {
        let what = format!(
            "the dataset was taken by the rig `{}`, not imported from videos",
            dataset.descriptor().rig
        );
        return Err(Error::input(what)
            .at(out.display())
            .remedy("give a new directory"));
    }
    for record in dataset.grasps()? {
        let note = record?.note;
        let id = note
            .strip_prefix(NOTE)
            .and_then(|rest| rest.split_once(": "));
        there.extend(id.map(|(id, _)| id.to_owned()));
    }
    Ok(there)
}

fn opened(out: &Path, import: &VideoImport) -> Result<DatasetWriter> {
    let new = NewDataset {
        name: import.name.clone(),
        rig: RIG.to_owned(),
        licence: import.licence.clone(),
        label_definition: import.label_definition.clone(),
    };
    let (mut writer, opened) = DatasetWriter::open_or_create(out, &new)?;
    if let Some(pending) = opened.pending {
        writer.discard_initial(&pending)?;
    }
    Ok(writer)
}

/// The frames of a grasp.
struct GraspFrames {
    initial: usize,
    contact: Option<[usize; 2]>,
    grasp: usize,
    /// Initial and grasp image of the left and the right gel.
    images: [[RgbImage; 2]; 2],
}

fn grasp_of(clip: &ClipRow, import: &VideoImport) -> Result<GraspFrames> {
    let given = [
        clip.initial_frame.or(import.initial_frame),
        clip.grasp_frame.or(import.grasp_frame),
    ];
    let ([initial, grasp], contact) = match given {
        [Some(initial), Some(grasp)] => ([initial, grasp], None),
        _ => found_frames(clip, given, import)?,
    };
    let images = [
        read_frames(&clip.videos[0], [initial, grasp])?,
        read_frames(&clip.videos[1], [initial, grasp])?,
    ];
    if initial == grasp {
        return Err(Error::input(format!(
            "initial and grasp frame are both frame {grasp}"
        )));
    }
    if given != [Some(initial), Some(grasp)] {
        check_initial(&images, clip, import)?;
    }
    Ok(GraspFrames {
        initial,
        contact,
        grasp,
        images,
    })
}

/// The frames of a clip of which at least one was not given.
fn found_frames(
    clip: &ClipRow,
    [initial, grasp]: [Option<usize>; 2],
    import: &VideoImport,
) -> Result<([usize; 2], Option<[usize; 2]>)> {
    let begins_in_contact = clip.begins == Some(Begins::Contact) && initial.is_none();
    if begins_in_contact && !import.initial_at_end {
        return Err(begins_in_contact_error(
            "the list says that the clip begins in contact",
        ));
    }
    let crop = &import.crop;
    let [left, right] = [
        cells_of(&clip.videos[0], crop, import)?,
        cells_of(&clip.videos[1], crop, import)?,
    ];
    if left.frames != right.frames {
        let what = format!(
            "the left video has {} frames, the right one {}, so their frames need not belong \
             together",
            left.frames, right.frames
        );
        return Err(Error::input(what)
            .remedy("cut both to the same frames, or give `initial_frame` and `grasp_frame`"));
    }
    let gels = [&left.cells[..], &right.cells[..]];
    let settings = &import.onset;
    if begins_in_contact {
        let grasp = grasp.or_else(|| first_still(gels, left.cells.len(), settings));
        let grasp = grasp.unwrap_or(settings.skip.min(left.frames.saturating_sub(1)));
        return Ok(([left.frames.saturating_sub(1), grasp], None));
    }
    let onset = find_onset(gels, initial, settings)?;
    let grasp = grasp.unwrap_or(onset.both() + import.settle);
    if grasp >= left.frames {
        let what = format!(
            "the fingers touch in frame {}, but the clip has only {} frames",
            onset.both(),
            left.frames
        );
        return Err(Error::input(what));
    }
    if onset.initial >= grasp {
        let what = format!(
            "the initial frame {} is not before the grasp frame {grasp}",
            onset.initial
        );
        return Err(Error::input(what));
    }
    Ok(([onset.initial, grasp], Some(onset.contact)))
}

fn begins_in_contact_error(why: &str) -> Error {
    Error::input(format!(
        "{why}: it has no image of the open gripper before the grasp"
    ))
    .remedy(
        "give `initial_frame` and `grasp_frame`, or take the last frame for the initial one where \
         the gripper opens at the end (`--initial-at-end`)",
    )
}

/// Checks that the initial images are of free gels.
fn check_initial(images: &[[RgbImage; 2]; 2], clip: &ClipRow, import: &VideoImport) -> Result<()> {
    for ([initial, grasp], (_, side)) in images.iter().zip(SIDES) {
        let [initial, grasp] = [
            cropped(initial, &import.crop)?,
            cropped(grasp, &import.crop)?,
        ];
        let level = GelCells::new(&grasp)?.contact_level(&GelCells::new(&initial)?);
        if level <= import.onset.contact_level {
            let what = format!(
                "the {side} gel looks the same in initial and grasp frame (contact level {level:.2}, \
                 in contact above {:.2})",
                import.onset.contact_level
            );
            return Err(Error::input(what).remedy("give `initial_frame` and `grasp_frame`"));
        }
        let tracker =
            ShearTracker::new(&initial, USUAL_M_PER_PX, ExpectedMarkers::Unknown)?.update(&initial);
        if clip.begins != Some(Begins::Open)
            && tracker.problems.contains(&ShearProblem::DeformedInitial)
        {
            return Err(begins_in_contact_error(&format!(
                "something deforms the {side} gel in the initial frame, so the clip begins in contact"
            )));
        }
    }
    Ok(())
}

fn cropped(image: &RgbImage, crop: &CropProfile) -> Result<RgbImage> {
    Ok(crop_and_resize(image, crop, SIZE[0], SIZE[1])?)
}

/// The first frames of a video as cells, and how many frames it has.
struct VideoCells {
    cells: Vec<GelCells>,
    frames: usize,
}

fn cells_of(path: &BeneathPath, crop: &CropProfile, import: &VideoImport) -> Result<VideoCells> {
    let mut video = opened_video(path)?;
    let mut cells = Vec::new();
    for image in &mut video {
        let image = image?;
        if cells.len() < import.onset.frames() {
            cells.push(GelCells::new(&cropped(&image, crop)?)?);
        }
    }
    let frames = video.frames();
    video.close()?;
    Ok(VideoCells { cells, frames })
}

fn read_frames(path: &BeneathPath, [first, second]: [usize; 2]) -> Result<[RgbImage; 2]> {
    let mut video = opened_video(path)?;
    let mut found = [None, None];
    for (number, image) in (&mut video).enumerate() {
        let image = image?;
        for (found, wanted) in found.iter_mut().zip([first, second]) {
            if number == wanted {
                *found = Some(image.clone());
            }
        }
        if number >= first.max(second) {
            break;
        }
    }
    let frames = video.frames();
    video.stop()?;
    let [Some(a), Some(b)] = found else {
        let what = format!(
            "frame {} does not exist: there are {frames} frames",
            first.max(second)
        );
        return Err(Error::input(what).at(path.display()));
    };
    Ok([a, b])
}

fn opened_video(path: &BeneathPath) -> Result<Video> {
    let file = path
        .open_file(FileKind::Bulk)
        .map_err(|e| Error::io("cannot open the video", e).at(path.display()))?;
    Video::of_file(file, &path.shown())
}

fn save(
    writer: &mut DatasetWriter,
    clip: &ClipRow,
    frames: &GraspFrames,
    import: &VideoImport,
) -> Result<GraspId> {
    // When the video was written: nothing else is known of its time.
    let file = clip.videos[0].open_file(FileKind::Bulk);
    let modified = file.and_then(|file| file.metadata()?.modified());
    let written = modified
        .ok()
        .and_then(|time| Timestamp::try_from(time).ok())
        .unwrap_or_default();
    let stage = |which: usize, number: usize| StageCapture {
        captured_at: written,
        trigger_time_ns: number as u64 * NOMINAL_NS,
        trigger: "import".to_owned(),
        cameras: SIDES
            .iter()
            .zip(&frames.images)
            .zip(&clip.videos)
            .map(|((&(role, _), images), video)| {
                (role, camera(&images[which], number, video, import))
            })
            .collect(),
        pre_grasp_frames: Vec::new(),
        fields: Vec::new(),
        force: BTreeMap::new(),
        shear: BTreeMap::new(),
        pose: None,
        truth: None,
    };
    let pending = writer.save_initial(&stage(0, frames.initial), Vec::new())?;
    let contact = frames
        .contact
        .map(|[left, right]| format!(", contact in frames {left} and {right}"));
    let meta = GraspMeta {
        object: clip.object.clone(),
        rig: RIG.to_owned(),
        outcome: clip.outcome,
        note: format!(
            "{NOTE}{}: initial frame {}{}, grasp frame {}",
            clip.id,
            frames.initial,
            contact.unwrap_or_default(),
            frames.grasp
        ),
        ..GraspMeta::default()
    };
    let record = writer.save_grasp(&pending, &stage(1, frames.grasp), meta)?;
    Ok(record.id)
}

fn camera(
    image: &RgbImage,
    number: usize,
    video: &BeneathPath,
    import: &VideoImport,
) -> CapturedCamera {
    CapturedCamera {
        frame: Frame {
            format: PixelFormat::Rgb,
            width: image.width(),
            height: image.height(),
            data: image.as_raw().clone().into(),
            sequence: u32::try_from(number).unwrap_or(u32::MAX),
            driver_time_ns: number as u64 * NOMINAL_NS,
            received_ns: number as u64 * NOMINAL_NS,
        },
        product: "video".to_owned(),
        serial: video.name(),
        interface: 0,
        port: String::new(),
        controls: BTreeMap::new(),
        age_ms: 0.0,
        crop_profile: Some(import.crop.name().to_owned()),
        depth_unit_m: None,
    }
}
