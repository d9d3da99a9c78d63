//! Poses of sheet and tags in one image.

use image::GrayImage;

use super::BoardHashes;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::Intrinsics;
use gripcast_pose::detect::{Diagnosis, FullSearch, diagnose};
use gripcast_pose::levels::{Levels, with_levels};
use gripcast_pose::refine::{blur_px, image_notes, refine_all};
use gripcast_pose::solve::{
    BodyPose, GripperPose, RelativePose, relative_pose, solve_body_pose, solve_gripper,
};
use gripcast_pose::{BoardFile, Body, Detection, MarkerDetector, require_size};

/// Maximum distance of a grasping gripper from the object's frame, m.
const MAX_M: f64 = 0.5;
/// Minimum number of the gripper's tags without a note.
const MIN_TAGS: usize = 2;
/// Minimum number of the sheet's markers without a note.
const MIN_MARKERS: usize = 4;

/// Poses of sheet and gripper in one image.
#[derive(Clone, Debug)]
pub struct Observation {
    /// Pose of the sheet, whose frame is that of the object.
    pub object: BodyPose,
    /// Pose and opening of the gripper.
    pub gripper: GripperPose,
    /// Pose of the gripper in the object frame.
    pub relative: RelativePose,
    /// Detected markers of both.
    pub detections: Vec<Detection>,
    /// Blur of the markers' edges, px.
    pub blur_px: f64,
    /// Notes for the user.
    pub notes: Vec<String>,
}

impl Observation {
    /// Whether the pose of the sheet or of the gripper is ambiguous.
    #[must_use]
    pub fn is_ambiguous(&self) -> bool {
        self.object.ambiguous || self.gripper.body.ambiguous
    }
}

/// Annotates grasps of one object with one gripper and camera.
pub struct Annotator {
    sheet: BoardFile,
    tags: BoardFile,
    intrinsics: Intrinsics,
    /// A single one if both boards have the same dictionary.
    detectors: Vec<Box<dyn MarkerDetector>>,
    /// Levels of the camera, once an image has shown that they are linear.
    levels: Option<Levels>,
}

impl Annotator {
    /// Creates an annotator for an object on `sheet`, a gripper with `tags`, and a camera. `full`
    /// says whether images are also searched at full resolution.
    ///
    /// # Errors
    /// `Input` if the sheet has no marker of an object, the tags have none of a gripper, or both
    /// share ids.
    pub fn new(
        sheet: BoardFile,
        tags: BoardFile,
        intrinsics: Intrinsics,
        full: FullSearch,
    ) -> Result<Self> {
        check_boards(&sheet, &tags)?;
        let mut detectors = Vec::new();
        let (sheet_ids, tag_ids) = (sheet.board.ids(), tags.board.ids());
        let mut add = |dictionary, ids: &[u32]| -> Result<()> {
            let mut all = gripcast_pose::detect::detectors(dictionary, ids, full)?;
            detectors.push(all.remove(0));
            Ok(())
        };
        if sheet.dictionary.name() == tags.dictionary.name() {
            add(&sheet.dictionary, &[sheet_ids, tag_ids].concat())?;
        } else {
            add(&sheet.dictionary, &sheet_ids)?;
            add(&tags.dictionary, &tag_ids)?;
        }
        Ok(Self {
            sheet,
            tags,
            intrinsics,
            detectors,
            levels: None,
        })
    }

    /// The object's sheet.
    #[must_use]
    pub fn sheet(&self) -> &BoardFile {
        &self.sheet
    }

    /// The gripper's tags.
    #[must_use]
    pub fn tags(&self) -> &BoardFile {
        &self.tags
    }

    /// Hashes of both boards.
    #[must_use]
    pub fn boards(&self) -> BoardHashes {
        BoardHashes {
            sheet: self.sheet.board.hash(),
            tags: self.tags.board.hash(),
        }
    }

    /// Intrinsics of the camera.
    #[must_use]
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Measures the poses of sheet and gripper in an image.
    ///
    /// # Errors
    /// `Input` for an image whose size differs from the intrinsics, without sheet or tags (with a
    /// diagnosis), or in which they do not match their board files.
    pub fn observe(&mut self, image: &GrayImage) -> Result<Observation> {
        require_size(&self.intrinsics, image.width(), image.height())?;
        let mut found = Vec::new();
        for detector in &mut self.detectors {
            found.extend(detector.detect(image)?);
        }
        let is_detected = |board: &BoardFile| {
            let ids = board.board.ids();
            found.iter().any(|d| ids.contains(&d.id))
        };
        for (what, board) in [
            ("the sheet", &self.sheet),
            ("the gripper's tags", &self.tags),
        ] {
            if !is_detected(board) {
                return Err(missing_board(image, what, board)?);
            }
        }
        let seen = with_levels(image, self.levels, |image| self.solve(image, &found))?;
        if seen.levels == Levels::Linear {
            self.levels = Some(Levels::Linear);
        }
        let (detections, object, gripper) = seen.measured;
        let relative = relative_pose(&object, &gripper.body);
        let distance_m = relative.t_object_gripper.translation_m.length();
        if distance_m > MAX_M {
            return Err(Error::input(format!(
                "the gripper is {distance_m:.2} m from the object: too far for a grasp"
            ))
            .remedy("check that both board files have the printed sizes"));
        }
        let encoded = seen.levels.to_srgb(image);
        let mut notes = [&object.notes[..], &gripper.body.notes].concat();
        notes.extend(seen.note);
        notes.extend(image_notes(&encoded, &detections));
        self.add_notes(&object, &gripper, &mut notes);
        Ok(Observation {
            object,
            gripper,
            relative,
            blur_px: blur_px(&encoded, &detections).unwrap_or(f64::INFINITY),
            detections,
            notes,
        })
    }

    /// Poses from the refined markers of an image with sRGB levels, with their residual, px.
    fn solve(&self, image: &GrayImage, found: &[Detection]) -> Result<(Solved, f64)> {
        let detections = refine_all(image, found);
        let sheet = &self.sheet.board;
        let object = solve_body_pose(sheet, Body::Object, &detections, &self.intrinsics)
            .map_err(|e| e.at("the sheet"))?;
        let gripper = solve_gripper(&self.tags.board, &detections, &self.intrinsics, None)
            .map_err(|e| e.at("the gripper's tags"))?;
        let residual_px = object.rms_px.max(gripper.body.rms_px);
        Ok(((detections, object, gripper), residual_px))
    }

    fn add_notes(&self, object: &BodyPose, gripper: &GripperPose, notes: &mut Vec<String>) {
        let used = object.used_markers();
        if used < MIN_MARKERS {
            notes.push(format!(
                "only {used} of {} markers of the sheet are detected",
                self.sheet.board.markers.len()
            ));
        }
        if gripper.body.used_markers() < MIN_TAGS {
            notes
                .push("only one tag of the gripper is used: its rotation is inaccurate".to_owned());
        }
        for (what, pose) in [("sheet", object), ("gripper's tags", &gripper.body)] {
            if pose.ambiguous {
                notes.push(format!("the pose of the {what} is ambiguous"));
            }
            notes.extend(pose.residual_note(what));
        }
    }
}

/// Refined markers, and the poses of sheet and gripper.
type Solved = (Vec<Detection>, BodyPose, GripperPose);

fn check_boards(sheet: &BoardFile, tags: &BoardFile) -> Result<()> {
    let is_object = |body: Body| body == Body::Object;
    if !sheet.board.markers.iter().any(|m| is_object(m.body)) {
        return Err(Error::input(format!(
            "board `{}` is not a sheet: it has no marker of part `object`",
            sheet.board.name
        ))
        .remedy("make one with `gripcast board make`"));
    }
    if tags.board.markers.iter().all(|m| is_object(m.body)) {
        return Err(Error::input(format!(
            "board `{}` has no marker of a gripper (part body, finger_left or finger_right)",
            tags.board.name
        ))
        .remedy("make one with `gripcast board gripper`"));
    }
    let tag_ids = tags.board.ids();
    let mut sheet_ids = sheet.board.ids().into_iter();
    match sheet_ids.find(|id| tag_ids.contains(id)) {
        Some(id) if sheet.dictionary.name() == tags.dictionary.name() => {
            Err(Error::input(format!(
                "both `{}` and `{}` have the marker {id} of {}",
                sheet.board.name,
                tags.board.name,
                sheet.dictionary.name()
            ))
            .remedy("make one of them with a different --first-id"))
        }
        _ => Ok(()),
    }
}

/// The error for a board without detected markers.
fn missing_board(image: &GrayImage, what: &str, board: &BoardFile) -> Result<Error> {
    let ids = board.board.ids();
    let name = &board.board.name;
    Ok(match diagnose(image, &board.dictionary, &ids)? {
        // Other markers are those of the other board.
        Diagnosis::OtherMarkers(_) | Diagnosis::Nothing => Error::input(format!(
            "{what} (board `{name}`) is not in the image: none of its markers is detected"
        ))
        .remedy(
            "show its markers to the camera in focus, at least 20 px large and evenly lit; \
                 give the board file of the printed board",
        ),
        cause => cause.to_error(&format!("{what}, board `{name}`")),
    })
}
