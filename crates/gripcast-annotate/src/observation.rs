//! Sheet and tags in one image.

use image::GrayImage;

use super::BoardHashes;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::Intrinsics;
use gripcast_pose::detect::{Diagnosis, diagnose, known_dictionaries};
use gripcast_pose::refine::{refine_all, sharpness};
use gripcast_pose::solve::{
    GripperPose, PartPose, RelativePose, relative, solve_gripper, solve_part,
};
use gripcast_pose::{BoardFile, Detection, MarkerDetector, Part, require_size};

/// A gripper that holds or is about to hold the object is not farther from its frame, m.
const MAX_M: f64 = 0.5;
/// Residuals from which the sheet is not as its description says, px.
const POOR_FIT_PX: f64 = 1.0;
/// Tags fewer than this are told of.
const FEW_TAGS: usize = 2;
/// The same for the sheet's markers.
const FEW_MARKERS: usize = 4;

/// Sheet and gripper as one image shows them.
#[derive(Clone, Debug)]
pub struct Observation {
    /// The sheet, which has the object's frame, in the camera.
    pub object: PartPose,
    /// The gripper in the camera, with its opening.
    pub gripper: GripperPose,
    /// The gripper in the object's frame.
    pub relative: RelativePose,
    /// The markers that were found, of both.
    pub detections: Vec<Detection>,
    /// Blur of their edges, px.
    pub blur_px: f64,
    /// What a person should know.
    pub notes: Vec<String>,
}

impl Observation {
    /// Whether another pose of the sheet or the gripper fits nearly as well.
    #[must_use]
    pub fn is_ambiguous(&self) -> bool {
        self.object.ambiguous || self.gripper.body.ambiguous
    }
}

/// Measures grasps of one object with one gripper and camera.
pub struct Annotator {
    sheet: BoardFile,
    tags: BoardFile,
    intrinsics: Intrinsics,
    /// One where both boards have the same dictionary.
    detectors: Vec<Box<dyn MarkerDetector>>,
}

impl Annotator {
    /// For an object on its `sheet`, a gripper with `tags`, and a camera.
    ///
    /// # Errors
    /// `Input` if the sheet has no marker of an object, the tags none of a gripper, or both share
    /// ids.
    pub fn new(sheet: BoardFile, tags: BoardFile, intrinsics: Intrinsics) -> Result<Self> {
        check_parts(&sheet, &tags)?;
        let mut detectors = Vec::new();
        let same = sheet.dictionary.name() == tags.dictionary.name();
        let (of_sheet, of_tags) = (sheet.board.ids(), tags.board.ids());
        let mut add = |dictionary, ids: &[u32]| -> Result<()> {
            let mut all = gripcast_pose::detect::detectors(dictionary, ids)?;
            detectors.push(all.remove(0));
            Ok(())
        };
        if same {
            add(&sheet.dictionary, &[of_sheet, of_tags].concat())?;
        } else {
            add(&sheet.dictionary, &of_sheet)?;
            add(&tags.dictionary, &of_tags)?;
        }
        Ok(Self {
            sheet,
            tags,
            intrinsics,
            detectors,
        })
    }

    /// The sheet that the object stands on.
    #[must_use]
    pub fn sheet(&self) -> &BoardFile {
        &self.sheet
    }

    /// The gripper's tags.
    #[must_use]
    pub fn tags(&self) -> &BoardFile {
        &self.tags
    }

    /// Their hashes.
    #[must_use]
    pub fn boards(&self) -> BoardHashes {
        BoardHashes {
            sheet: self.sheet.board.hash(),
            tags: self.tags.board.hash(),
        }
    }

    /// The camera.
    #[must_use]
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Measures sheet and gripper in an image.
    ///
    /// # Errors
    /// `Input` for an image of another size than the intrinsics', without the sheet or the tags
    /// (what is there in their place is told), or in which they are not as described.
    pub fn observe(&mut self, image: &GrayImage) -> Result<Observation> {
        require_size(&self.intrinsics, image.width(), image.height())?;
        let mut found = Vec::new();
        for detector in &mut self.detectors {
            found.extend(detector.detect(image)?);
        }
        let detections = refine_all(image, &found);
        let seen = |board: &BoardFile| {
            let ids = board.board.ids();
            detections.iter().any(|d| ids.contains(&d.id))
        };
        for (what, board) in [
            ("the sheet", &self.sheet),
            ("the gripper's tags", &self.tags),
        ] {
            if !seen(board) {
                return Err(explain_absence(image, what, board)?);
            }
        }
        let object = solve_part(
            &self.sheet.board,
            Part::Object,
            &detections,
            &self.intrinsics,
        )
        .map_err(|e| e.at("the sheet"))?;
        let gripper = solve_gripper(&self.tags.board, &detections, &self.intrinsics, None)
            .map_err(|e| e.at("the gripper's tags"))?;
        let relative = relative(&object, &gripper.body);
        let distance_m = relative.t_object_gripper.translation_m.length();
        if distance_m > MAX_M {
            return Err(Error::input(format!(
                "the gripper would be {distance_m:.2} m from the object, which is no grasp"
            ))
            .remedy("check that both board files have the sizes that were printed"));
        }
        let blur = sharpness(image, &detections);
        let mut notes: Vec<String> = [&object.notes, &gripper.body.notes]
            .into_iter()
            .flatten()
            .cloned()
            .collect();
        notes.extend(self.doubts(&object, &gripper));
        Ok(Observation {
            object,
            gripper,
            relative,
            detections,
            blur_px: blur.map_or(f64::INFINITY, |s| s.blur_px),
            notes,
        })
    }

    fn doubts(&self, object: &PartPose, gripper: &GripperPose) -> Vec<String> {
        let mut doubts = Vec::new();
        let of_sheet = object.used_markers();
        if of_sheet < FEW_MARKERS {
            doubts.push(format!(
                "only {of_sheet} markers of the sheet are seen, of {}",
                self.sheet.board.markers.len()
            ));
        }
        if gripper.body.used_markers() < FEW_TAGS {
            doubts.push(
                "one tag of the gripper decides alone: its direction is known poorly".to_owned(),
            );
        }
        for (what, pose) in [("sheet", object), ("gripper's tags", &gripper.body)] {
            if pose.ambiguous {
                doubts.push(format!("the pose of the {what} is ambiguous"));
            }
            if pose.rms_px > POOR_FIT_PX {
                doubts.push(format!(
                    "the {what} fit to {:.1} px only: are board file and intrinsics right?",
                    pose.rms_px
                ));
            }
        }
        doubts
    }
}

fn check_parts(sheet: &BoardFile, tags: &BoardFile) -> Result<()> {
    let input = |what: String| Error::input(what);
    let is_object = |part: Part| part == Part::Object;
    if !sheet.board.markers.iter().any(|m| is_object(m.part)) {
        return Err(input(format!(
            "board `{}` has no marker of part `object`, so it is no sheet",
            sheet.board.name
        ))
        .remedy("make one with `gripcast board make`"));
    }
    if tags.board.markers.iter().all(|m| is_object(m.part)) {
        return Err(input(format!(
            "board `{}` has no marker of a gripper's part (body, finger_left, finger_right)",
            tags.board.name
        ))
        .remedy("make one with `gripcast board gripper`"));
    }
    let of_tags = tags.board.ids();
    let shared: Vec<u32> = sheet.board.ids();
    let shared = shared.into_iter().find(|id| of_tags.contains(id));
    match shared {
        Some(id) if sheet.dictionary.name() == tags.dictionary.name() => Err(input(format!(
            "both `{}` and `{}` have the marker {id} of {}",
            sheet.board.name,
            tags.board.name,
            sheet.dictionary.name()
        ))
        .remedy("make one of them with another --first-id")),
        _ => Ok(()),
    }
}

/// Why none of a board's markers was found.
fn explain_absence(image: &GrayImage, what: &str, board: &BoardFile) -> Result<Error> {
    let ids = board.board.ids();
    let why = diagnose(image, &board.dictionary, &ids, &known_dictionaries())?;
    let why = match why {
        // Other markers are in every such image: the other board's.
        Diagnosis::OtherMarkers(_) => Diagnosis::Nothing,
        why => why,
    };
    let name = &board.board.name;
    if why == Diagnosis::Nothing {
        return Ok(Error::input(format!(
            "{what} (board `{name}`) is not in the image: none of its markers is found"
        ))
        .remedy(
            "let the camera see it, sharp and evenly lit, its markers at least 20 pixels large; \
             give the board file of what was printed",
        ));
    }
    Ok(why.explain(&format!("{what}, board `{name}`")))
}
