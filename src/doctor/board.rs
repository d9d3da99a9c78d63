//! Detection of the printed markers by the external camera.

use super::{CheckStatus, Finding};
use crate::camera_check::CameraCheck;
use crate::daemon::Boards;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Decoder, Role};
use gripcast_pose::BoardFile;
use gripcast_pose::detect::{FullSearch, detectors};

/// Detects the gripper's tags and, for a virtual rig or a single sheet, the sheet in the last frame
/// of the external camera.
pub(super) fn findings(checks: &[CameraCheck], boards: Option<Result<Boards>>) -> Vec<Finding> {
    let external = checks.iter().find(|check| check.role == Role::External);
    let Some(external) = external else {
        return Vec::new();
    };
    let boards = match boards {
        Some(Ok(boards)) => boards,
        Some(Err(error)) => return vec![Finding::failed("board", "files", &error)],
        None => {
            let found = "the rig file has no boards, so grasps get no live pose";
            return vec![Finding::new("board", "files", CheckStatus::Skipped, found)];
        }
    };
    let frame = external
        .measurement
        .as_ref()
        .and_then(|measurement| measurement.last.as_ref());
    let Some(frame) = frame else {
        let found = "the external camera sent no frame";
        return vec![Finding::new(
            "board",
            "markers",
            CheckStatus::Skipped,
            found,
        )];
    };
    let image = Decoder::new().and_then(|mut decoder| {
        decoder
            .decode_full(frame)
            .map_err(|damage| Error::input(damage.to_string()).remedy("run the check again"))
    });
    let grey = match image {
        Ok(image) => image::imageops::grayscale(&image),
        Err(error) => return vec![Finding::failed("board", "markers", &error)],
    };
    let expected = [
        ("the gripper's tags", Some(boards.tags.clone())),
        ("the sheet", boards.sheet("").ok().flatten()),
    ];
    let detected = expected
        .into_iter()
        .filter_map(|(name, board)| Some((name, board?)))
        .map(|(name, board)| match markers(&board, &grey) {
            Ok(count) => visibility(name, count, board.board.markers.len()),
            Err(error) => Finding::failed("board", name, &error),
        });
    detected.collect()
}

/// Counts the markers of a board in an image.
fn markers(board: &BoardFile, image: &image::GrayImage) -> Result<usize> {
    let mut detectors = detectors(&board.dictionary, &board.board.ids(), FullSearch::IfSmall)?;
    match detectors.first_mut() {
        Some(detector) => Ok(detector.detect(image)?.len()),
        None => Ok(0),
    }
}

fn visibility(name: &str, count: usize, all: usize) -> Finding {
    let message = format!("{count} of {all} markers detected");
    let finding = Finding::new("board", name, CheckStatus::Ok, message);
    let finding = finding.measurement("markers", count as f64);
    if count > 0 {
        return finding;
    }
    finding
        .warn("move the camera or the gripper until the markers are in view, sharp and evenly lit")
}
