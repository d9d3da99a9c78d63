//! Finds contact in made clips.

use image::RgbImage;

use super::*;
use gripcast_base::error::Result;
use gripcast_imaging::{GelCells, synthetic_gel};

/// A clip of a gel by the strength of its contact in each frame.
fn gel(seed: u64, strengths: &[f32]) -> Vec<GelCells> {
    let frame = |strength: &f32| synthetic_gel(320, 240, seed, *strength);
    let cells = |image: RgbImage| GelCells::new(&image).unwrap();
    strengths.iter().map(frame).map(cells).collect()
}

/// Strengths: `stale` frames of an earlier touch, then open until `contact`, then pressed.
fn strengths(stale: usize, contact: usize, frames: usize) -> Vec<f32> {
    let strength = |at: usize| match at {
        at if at < stale => 0.6,
        at if at < contact => 0.0,
        at => (0.3 * (at - contact + 1) as f32).min(0.8),
    };
    (0..frames).map(strength).collect()
}

fn found(left: &[f32], right: &[f32], initial: Option<usize>) -> Result<PairOnset> {
    let gels = [gel(1, left), gel(2, right)];
    find_onset([&gels[0], &gels[1]], initial, &OnsetSettings::default())
}

#[test]
fn contact_of_both_fingers_is_found_after_the_stale_frames() {
    let onset = found(&strengths(5, 20, 40), &strengths(0, 23, 40), None).unwrap();
    assert_eq!(onset.contact, [20, 23]);
    assert_eq!((onset.initial, onset.both()), (18, 23));
    // A touch before the gripper is open: the open gripper comes after it.
    let onset = found(&strengths(9, 20, 40), &strengths(7, 20, 40), None).unwrap();
    assert_eq!((onset.initial, onset.contact), (18, [20, 20]));
    // Contact right after the still frames leaves the last of them.
    let onset = found(&strengths(7, 11, 40), &strengths(7, 11, 40), None).unwrap();
    assert_eq!((onset.initial, onset.contact), (10, [11, 11]));
    let onset = found(&strengths(5, 20, 40), &strengths(5, 23, 40), Some(8)).unwrap();
    assert_eq!((onset.initial, onset.contact), (8, [20, 23]));
}

#[test]
fn one_touch_or_a_frame_of_it_is_no_contact_of_both() {
    let open = vec![0.0; 40];
    let error = found(&strengths(5, 20, 40), &open, None)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("the right gel does not come into contact"),
        "{error}"
    );
    let mut blink = open.clone();
    blink[20] = 0.8;
    let error = found(&blink, &open, None).unwrap_err().to_string();
    assert!(error.contains("no gel comes into contact"), "{error}");
    // In contact from the beginning: nothing changes, so nothing is found.
    let held = vec![0.7; 40];
    let error = found(&held, &held, None).unwrap_err().to_string();
    assert!(error.contains("the clip may begin in contact"), "{error}");
}

#[test]
fn a_gripper_that_never_stands_still_is_told() {
    let shaken: Vec<f32> = (0..40).map(|at| 0.4 + 0.4 * (at % 2) as f32).collect();
    let error = found(&shaken, &shaken, None).unwrap_err().to_string();
    assert!(error.contains("never still together"), "{error}");
}
