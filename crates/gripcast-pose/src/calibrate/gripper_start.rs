//! Selection of markers and images, and initial view poses.

use glam::{DMat3, DQuat, DVec3};

use super::gripper_bundle::{Bundle, Marker, Observation, View, slides_differ};
use super::gripper_result::GripperImage;
use crate::solve::{solve_body_pose, solve_gripper};
use crate::{Board, BoardMarker, Body, Detection};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Minimum number of images that show a marker together with others.
pub(super) const MIN_OBSERVATIONS: usize = 4;
/// Errors are clipped at this when initial poses are scored, px.
const MAX_ERROR_PX: f64 = 30.0;
/// Initial openings, m.
const OPENINGS_M: [f64; 4] = [0.0, 0.03, 0.06, 0.09];

/// Markers and images used for calibration.
pub(super) struct Selection {
    /// The selected markers, and the images with at least two of them.
    pub(super) bundle: Bundle,
    /// Ids that are not in any image.
    pub(super) unobserved: Vec<u32>,
    /// Ids in too few images.
    pub(super) rare: Vec<u32>,
    /// Ids that are not in any image together with selected markers.
    pub(super) unlinked: Vec<u32>,
    /// Excluded images, with the reason.
    pub(super) left_out: Vec<(usize, &'static str)>,
}

/// A board marker with its own frame.
pub(super) fn framed(marker: &BoardMarker) -> Marker {
    let [a, b, c, d] = marker.corners_m;
    let right = (b - a + c - d).normalize_or(DVec3::X);
    let front = right.cross(a - d + b - c).normalize_or(DVec3::Z);
    let axes = DMat3::from_cols(right, front.cross(right), front);
    let pose = Pose::new(DQuat::from_mat3(&axes), marker.center_m());
    let back = pose.inverse();
    Marker {
        id: marker.id,
        body: marker.body,
        local: marker.corners_m.map(|c| back.transform_point(c)),
        nominal: pose,
        pose,
        slide: marker.body.slide(),
    }
}

/// Selects markers and images; the views get identity poses.
pub(super) fn select(board: &Board, camera: &Intrinsics, images: &[GripperImage]) -> Selection {
    let all: Vec<Marker> = board
        .markers
        .iter()
        .filter(|m| m.body != Body::Object)
        .map(framed)
        .collect();
    let observed: Vec<_> = images.iter().map(|image| observe(&all, image)).collect();
    let mut selection = Selection {
        bundle: Bundle {
            camera: *camera,
            markers: Vec::new(),
            slide: DVec3::X,
            views: Vec::new(),
        },
        unobserved: Vec::new(),
        rare: Vec::new(),
        unlinked: Vec::new(),
        left_out: Vec::new(),
    };
    let selected = selection.select_markers(&all, &observed);
    let index = |m: usize| (0..m).filter(|k| selected[*k]).count();
    for (image, detected) in observed.iter().enumerate() {
        let observations = detected.iter().filter(|(m, _)| selected[*m]);
        let observations: Vec<Observation> = observations
            .map(|(m, d)| Observation {
                marker: index(*m),
                pixels: d.corners_px,
                used: true,
            })
            .collect();
        let mut leave_out = |reason| selection.left_out.push((image, reason));
        match (detected.len(), observations.len()) {
            (0, _) => leave_out("no marker of the gripper detected"),
            (_, 0 | 1) => leave_out("fewer than two usable markers detected"),
            _ => {
                let differ = slides_differ(&selection.bundle.markers, &observations);
                selection.bundle.views.push(View {
                    image,
                    pose: Pose::IDENTITY,
                    opening_m: 0.0,
                    frees_opening: differ && !images[image].closed,
                    observations,
                });
            }
        }
    }
    selection
}

impl Selection {
    /// Selects the largest group of markers that are observed together often enough. Returns a
    /// mask.
    fn select_markers(
        &mut self,
        all: &[Marker],
        observed: &[Vec<(usize, &Detection)>],
    ) -> Vec<bool> {
        let indices = 0..all.len();
        let is_observed = |m: usize| observed.iter().flatten().any(|(i, _)| *i == m);
        let mut selected: Vec<bool> = indices.clone().map(is_observed).collect();
        let ids = |test: &dyn Fn(usize) -> bool| -> Vec<u32> {
            let matching = (0..all.len()).filter(|m| test(*m));
            matching.map(|m| all[m].id).collect()
        };
        self.unobserved = ids(&|m| !selected[m]);
        let in_image = |selected: &[bool], image: &[(usize, &Detection)]| -> Vec<usize> {
            let markers = image.iter().map(|(m, _)| *m);
            markers.filter(|m| selected[*m]).collect()
        };
        loop {
            let mut counts = vec![0; all.len()];
            for markers in observed.iter().map(|image| in_image(&selected, image)) {
                if markers.len() >= 2 {
                    markers.into_iter().for_each(|m| counts[m] += 1);
                }
            }
            let is_rare = |m: &usize| selected[*m] && counts[*m] < MIN_OBSERVATIONS;
            let Some(rare) = indices.clone().find(is_rare) else {
                break;
            };
            selected[rare] = false;
            self.rare.push(all[rare].id);
        }
        self.rare.sort_unstable();
        let groups = groups(all.len(), observed.iter().map(|i| in_image(&selected, i)));
        let members = || indices.clone().filter(|m| selected[*m]);
        let size = |group: usize| members().filter(|m| groups[*m] == group).count();
        let best = members().map(|m| groups[m]).max_by_key(|g| size(*g));
        let is_unlinked = |m: usize| selected[m] && Some(groups[m]) != best;
        self.unlinked = ids(&is_unlinked);
        let linked = |m: usize| selected[m] && !is_unlinked(m);
        self.bundle.markers = indices
            .clone()
            .filter(|m| linked(*m))
            .map(|m| all[m].clone())
            .collect();
        indices.map(linked).collect()
    }
}

/// Detections of the gripper's markers in an image, with marker indices. Skips markers that are
/// detected twice.
fn observe<'a>(all: &[Marker], image: &'a GripperImage) -> Vec<(usize, &'a Detection)> {
    let is_valid = |d: &&Detection| {
        let is_twice = image.detections.iter().filter(|o| o.id == d.id).count() > 1;
        !is_twice && d.corners_px.iter().all(|c| c.is_finite())
    };
    let index = |d: &Detection| all.iter().position(|m| m.id == d.id);
    let valid = image.detections.iter().filter(is_valid);
    valid.filter_map(|d| Some((index(d)?, d))).collect()
}

/// Group of each marker: markers that are linked by common images share a group.
fn groups(count: usize, images: impl Iterator<Item = Vec<usize>>) -> Vec<usize> {
    let mut group: Vec<usize> = (0..count).collect();
    for markers in images {
        let Some(first) = markers.first().map(|m| group[*m]) else {
            continue;
        };
        for m in markers {
            let old = group[m];
            let same = group.iter_mut().filter(|g| **g == old);
            same.for_each(|g| *g = first);
        }
    }
    group
}

/// Initialises each view with the best pose for nominal markers: from all markers together, or from
/// one of them alone if they are too far off.
pub(super) fn start(bundle: &mut Bundle, board: &Board, images: &[GripperImage]) {
    for i in 0..bundle.views.len() {
        let image = &images[bundle.views[i].image];
        let candidates = candidates(bundle, &bundle.views[i], board, image);
        let scored = candidates.into_iter().map(|(pose, opening_m)| {
            let view = View {
                pose,
                opening_m,
                ..bundle.views[i].clone()
            };
            (score(bundle, &view), view)
        });
        if let Some((_, view)) = scored.min_by(|a, b| a.0.total_cmp(&b.0)) {
            bundle.views[i] = view;
        }
    }
}

/// Candidate poses `t_camera_gripper` with openings (m).
fn candidates(
    bundle: &Bundle,
    view: &View,
    board: &Board,
    image: &GripperImage,
) -> Vec<(Pose, f64)> {
    let camera = &bundle.camera;
    let mut result = Vec::new();
    let known = (!view.frees_opening).then_some(0.0);
    if let Ok(found) = solve_gripper(board, &image.detections, camera, known) {
        let opening_m = found.opening.map_or(0.0, |o| o.opening_m);
        result.push((found.body.t_camera_body, opening_m));
    }
    let openings = if view.frees_opening {
        &OPENINGS_M[..]
    } else {
        &[0.0]
    };
    for observation in &view.observations {
        let marker = &bundle.markers[observation.marker];
        let mut alone = board.clone();
        alone.markers.retain(|m| m.id == marker.id);
        let Ok(found) = solve_body_pose(&alone, marker.body, &image.detections, camera) else {
            continue;
        };
        for pose in std::iter::once(found.t_camera_body).chain(found.runner_up) {
            for opening_m in openings {
                let slid = DVec3::X * (marker.slide * opening_m);
                result.push((pose * Pose::from_translation(-slid), *opening_m));
            }
        }
    }
    result
}

/// Sum of squared clipped errors, px².
fn score(bundle: &Bundle, view: &View) -> f64 {
    let observations = view.observations.iter();
    let errors = observations.flat_map(|o| bundle.errors_px(view, o));
    errors.map(|e| e.min(MAX_ERROR_PX).powi(2)).sum()
}
