//! Whether the external camera sees the printed markers.

use super::{Finding, Verdict};
use crate::camera_check::CameraCheck;
use crate::daemon::Boards;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Decoder, Role};
use gripcast_pose::BoardFile;
use gripcast_pose::detect::detectors;

/// The gripper's tags and, on the virtual rig or where one sheet serves all objects, the sheet in
/// the last frame of the external camera.
pub(super) fn findings(checks: &[CameraCheck], boards: Option<Result<Boards>>) -> Vec<Finding> {
    let external = checks.iter().find(|check| check.role == Role::External);
    let Some(external) = external else {
        return Vec::new();
    };
    let boards = match boards {
        Some(Ok(boards)) => boards,
        Some(Err(error)) => return vec![Finding::failed("board", "files", &error)],
        None => {
            let found = "the rig file names no boards, so grasps are not annotated live";
            return vec![Finding::new("board", "files", Verdict::Skipped, found)];
        }
    };
    let frame = external
        .opened
        .as_ref()
        .and_then(|opened| opened.last.as_ref());
    let Some(frame) = frame else {
        let found = "the external camera sent no frame";
        return vec![Finding::new("board", "markers", Verdict::Skipped, found)];
    };
    let image = Decoder::new().and_then(|mut decoder| {
        decoder
            .decode_full(frame)
            .map_err(|damage| Error::input(damage.to_string()).remedy("measure again"))
    });
    let grey = match image {
        Ok(image) => image::imageops::grayscale(&image),
        Err(error) => return vec![Finding::failed("board", "markers", &error)],
    };
    let mut wanted = vec![("the gripper's tags", Some(boards.tags.clone()))];
    wanted.push(("the sheet", boards.sheet("").ok().flatten()));
    let seen = wanted
        .into_iter()
        .filter_map(|(name, board)| Some((name, board?)))
        .map(|(name, board)| match markers(&board, &grey) {
            Ok(seen) => visibility(name, seen, board.board.markers.len()),
            Err(error) => Finding::failed("board", name, &error),
        });
    seen.collect()
}

/// How many markers of a board an image shows.
fn markers(board: &BoardFile, image: &image::GrayImage) -> Result<usize> {
    let mut detectors = detectors(&board.dictionary, &board.board.ids())?;
    match detectors.first_mut() {
        Some(detector) => Ok(detector.detect(image)?.len()),
        None => Ok(0),
    }
}

fn visibility(name: &str, seen: usize, all: usize) -> Finding {
    let found = format!("{seen} of {all} markers seen");
    let finding = Finding::new("board", name, Verdict::Ok, found).figure("markers", seen as f64);
    if seen > 0 {
        return finding;
    }
    Finding {
        verdict: Verdict::Warn,
        ..finding
    }
    .remedy("turn the camera or the gripper until they are seen, sharp and evenly lit")
}
