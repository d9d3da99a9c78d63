//! Which sightings take part, and where the search begins.

use glam::{DMat3, DQuat, DVec3};

use super::gripper_bundle::{Bundle, Marker, Sight, View, slides_differ};
use super::gripper_result::GripperImage;
use crate::solve::{solve_gripper, solve_part};
use crate::{Board, BoardMarker, Detection, Part};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Fewest images in which a marker is seen together with others.
pub(super) const MIN_SIGHTS: usize = 4;
/// Error beyond which a corner tells nothing but that it is wrong, px.
const WRONG_PX: f64 = 30.0;
/// Openings that searches start from, m.
const OPENINGS_M: [f64; 4] = [0.0, 0.03, 0.06, 0.09];

/// What becomes of the board's markers.
pub(super) struct Selection {
    /// The markers that take part, and the images with at least two of them.
    pub(super) bundle: Bundle,
    /// Ids that no image shows.
    pub(super) unseen: Vec<u32>,
    /// Ids with too few images.
    pub(super) rare: Vec<u32>,
    /// Ids that no image shows together with those that take part.
    pub(super) apart: Vec<u32>,
    /// Images that take no part, with the reason.
    pub(super) left_out: Vec<(usize, &'static str)>,
}

/// A marker of the board with a frame of its own.
pub(super) fn framed(marker: &BoardMarker) -> Marker {
    let [a, b, c, d] = marker.corners_m;
    let right = (b - a + c - d).normalize_or(DVec3::X);
    let front = right.cross(a - d + b - c).normalize_or(DVec3::Z);
    let axes = DMat3::from_cols(right, front.cross(right), front);
    let pose = Pose::new(DQuat::from_mat3(&axes), marker.center_m());
    let back = pose.inverse();
    Marker {
        id: marker.id,
        part: marker.part,
        local: marker.corners_m.map(|c| back.transform_point(c)),
        nominal: pose,
        pose,
        slide: marker.part.slide(),
    }
}

/// Chooses markers and images, without poses of the views.
pub(super) fn select(board: &Board, camera: &Intrinsics, images: &[GripperImage]) -> Selection {
    let all: Vec<Marker> = board
        .markers
        .iter()
        .filter(|m| m.part != Part::Object)
        .map(framed)
        .collect();
    let seen: Vec<Vec<(usize, &Detection)>> = images.iter().map(|p| sightings(&all, p)).collect();
    let mut selection = Selection {
        bundle: Bundle {
            camera: *camera,
            markers: Vec::new(),
            slide: DVec3::X,
            views: Vec::new(),
        },
        unseen: Vec::new(),
        rare: Vec::new(),
        apart: Vec::new(),
        left_out: Vec::new(),
    };
    let taken = selection.take_markers(&all, &seen);
    let place = |m: usize| (0..m).filter(|k| taken[*k]).count();
    for (image, sights) in seen.iter().enumerate() {
        let here = sights.iter().filter(|(m, _)| taken[*m]);
        let here: Vec<Sight> = here
            .map(|(m, d)| Sight {
                marker: place(*m),
                pixels: d.corners_px,
                used: true,
            })
            .collect();
        let mut leave_out = |reason| selection.left_out.push((image, reason));
        match (sights.len(), here.len()) {
            (0, _) => leave_out("no marker of the gripper was found"),
            (_, 0 | 1) => leave_out("only one marker that takes part was found"),
            _ => {
                let differ = slides_differ(&selection.bundle.markers, &here);
                selection.bundle.views.push(View {
                    image,
                    pose: Pose::IDENTITY,
                    opening_m: 0.0,
                    frees_opening: differ && !images[image].closed,
                    sights: here,
                });
            }
        }
    }
    selection
}

impl Selection {
    /// Takes the largest group of markers that are seen together often enough; which of all.
    fn take_markers(&mut self, all: &[Marker], seen: &[Vec<(usize, &Detection)>]) -> Vec<bool> {
        let is_seen = |m: usize| seen.iter().flatten().any(|(i, _)| *i == m);
        let mut taken: Vec<bool> = (0..all.len()).map(is_seen).collect();
        let ids = |chosen: &dyn Fn(usize) -> bool| -> Vec<u32> {
            let chosen = (0..all.len()).filter(|m| chosen(*m));
            chosen.map(|m| all[m].id).collect()
        };
        self.unseen = ids(&|m| !taken[m]);
        let shown = |taken: &[bool], sights: &[(usize, &Detection)]| -> Vec<usize> {
            let here = sights.iter().map(|(m, _)| *m).filter(|m| taken[*m]);
            here.collect()
        };
        loop {
            let mut counts = vec![0; all.len()];
            for here in seen.iter().map(|sights| shown(&taken, sights)) {
                if here.len() >= 2 {
                    here.into_iter().for_each(|m| counts[m] += 1);
                }
            }
            let few = (0..all.len()).find(|m| taken[*m] && counts[*m] < MIN_SIGHTS);
            let Some(few) = few else { break };
            taken[few] = false;
            self.rare.push(all[few].id);
        }
        self.rare.sort_unstable();
        let groups = groups(all.len(), seen.iter().map(|s| shown(&taken, s)));
        let size = |group: usize| {
            (0..all.len())
                .filter(|m| taken[*m] && groups[*m] == group)
                .count()
        };
        let best = (0..all.len())
            .filter(|m| taken[*m])
            .map(|m| groups[m])
            .max_by_key(|g| size(*g));
        let is_apart = |m: usize| taken[m] && Some(groups[m]) != best;
        self.apart = ids(&is_apart);
        let taken: Vec<bool> = (0..all.len()).map(|m| taken[m] && !is_apart(m)).collect();
        let chosen = all.iter().zip(&taken).filter(|(_, taken)| **taken);
        self.bundle.markers = chosen.map(|(marker, _)| marker.clone()).collect();
        taken
    }
}

/// An image's detections of the gripper's markers; one that is found twice is neither.
fn sightings<'a>(all: &[Marker], image: &'a GripperImage) -> Vec<(usize, &'a Detection)> {
    let is_sound = |d: &Detection| {
        let twice = image.detections.iter().filter(|o| o.id == d.id).count() > 1;
        !twice && d.corners_px.iter().all(|c| c.is_finite())
    };
    let place = |d: &Detection| all.iter().position(|m| m.id == d.id);
    let sound = image.detections.iter().filter(|d| is_sound(d));
    sound.filter_map(|d| place(d).map(|m| (m, d))).collect()
}

/// Number of the group that each marker belongs to: those that some image shows together.
fn groups(count: usize, shown: impl Iterator<Item = Vec<usize>>) -> Vec<usize> {
    let mut group: Vec<usize> = (0..count).collect();
    for here in shown {
        let Some(first) = here.first().map(|m| group[*m]) else {
            continue;
        };
        for m in here {
            let old = group[m];
            group
                .iter_mut()
                .filter(|g| **g == old)
                .for_each(|g| *g = first);
        }
    }
    group
}

/// Gives each view the pose that fits best with markers where they are described: of all markers
/// together, or of one of them alone where they are too far off for that.
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

/// Possible poses `t_camera_gripper` with openings (m).
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
        result.push((found.body.t_camera_part, opening_m));
    }
    let openings = if view.frees_opening {
        &OPENINGS_M[..]
    } else {
        &[0.0]
    };
    for sight in &view.sights {
        let marker = &bundle.markers[sight.marker];
        let alone = Board {
            markers: board
                .markers
                .iter()
                .filter(|m| m.id == marker.id)
                .cloned()
                .collect(),
            ..board.clone()
        };
        let Ok(found) = solve_part(&alone, marker.part, &image.detections, camera) else {
            continue;
        };
        for pose in [Some(found.t_camera_part), found.runner_up]
            .into_iter()
            .flatten()
        {
            for opening_m in openings {
                let slid = DVec3::X * (marker.slide * opening_m);
                result.push((pose * Pose::from_translation(-slid), *opening_m));
            }
        }
    }
    result
}

/// Sum of squared errors, each at most that of a wrong corner, px².
fn score(bundle: &Bundle, view: &View) -> f64 {
    let errors = view.sights.iter().flat_map(|s| bundle.errors_px(view, s));
    errors.map(|e| e.min(WRONG_PX).powi(2)).sum()
}
