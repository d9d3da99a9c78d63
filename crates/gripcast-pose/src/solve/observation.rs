//! Detected markers joined with their corners on the board.

use glam::{DVec2, DVec3};

use super::reprojection::{CornerObservation, State, residual};
use crate::camera::undistort;
use crate::least_squares::rms;
use crate::{Board, Body, Detection};
use gripcast_imaging::Intrinsics;

/// An observed marker.
#[derive(Clone, Debug)]
pub(super) struct MarkerObservation {
    pub(super) id: u32,
    pub(super) corners: [CornerObservation; 4],
    /// Normalised image coordinates of the corners.
    pub(super) ideal: [DVec2; 4],
}

impl MarkerObservation {
    /// Unit normal of the marker.
    pub(super) fn normal(&self) -> DVec3 {
        let [a, b, c, d] = self.corners.map(|o| o.point_m);
        (d - b).cross(c - a).normalize_or_zero()
    }

    /// Area in the image, px².
    pub(super) fn area_px(&self) -> f64 {
        let [a, b, c, d] = self.corners.map(|o| o.pixel);
        0.5 * (c - a).perp_dot(d - b).abs()
    }

    /// Reprojection errors of its corners, px; infinite behind the camera.
    pub(super) fn errors_px(&self, intrinsics: &Intrinsics, state: &State) -> [f64; 4] {
        self.corners
            .map(|corner| residual(intrinsics, state, &corner).map_or(f64::INFINITY, DVec2::length))
    }

    /// Root mean square of [`Self::errors_px`].
    pub(super) fn rms_px(&self, intrinsics: &Intrinsics, state: &State) -> f64 {
        rms(&self.errors_px(intrinsics, state))
    }
}

/// The observed markers of `bodies`, and notes about excluded detections.
pub(super) fn observe_markers(
    board: &Board,
    bodies: &[Body],
    detections: &[Detection],
    intrinsics: &Intrinsics,
) -> (Vec<MarkerObservation>, Vec<String>) {
    let mut found: Vec<MarkerObservation> = Vec::new();
    let mut notes = Vec::new();
    for detection in detections {
        let marker = board
            .markers
            .iter()
            .find(|m| m.id == detection.id && bodies.contains(&m.body));
        let Some(marker) = marker else { continue };
        let copies = detections.iter().filter(|d| d.id == marker.id).count();
        if copies > 1 {
            let note = format!(
                "marker {} is in the image {copies} times: none of them was used",
                marker.id
            );
            if !notes.contains(&note) {
                notes.push(note);
            }
            continue;
        }
        let ideal = detection.corners_px.map(|c| undistort(intrinsics, c));
        let [Some(a), Some(b), Some(c), Some(d)] = ideal else {
            notes.push(format!(
                "marker {} was excluded: the lens model cannot be inverted at its corners",
                marker.id
            ));
            continue;
        };
        let slide = marker.body.slide();
        let corner = |i: usize| CornerObservation {
            point_m: marker.corners_m[i],
            slide,
            pixel: detection.corners_px[i],
        };
        found.push(MarkerObservation {
            id: marker.id,
            corners: [corner(0), corner(1), corner(2), corner(3)],
            ideal: [a, b, c, d],
        });
    }
    (found, notes)
}

/// Largest angle between two normals, rad.
pub(super) fn normal_spread(observations: &[&MarkerObservation]) -> f64 {
    let normals: Vec<DVec3> = observations.iter().map(|o| o.normal()).collect();
    let pairs = normals
        .iter()
        .enumerate()
        .flat_map(|(i, a)| normals[..i].iter().map(|b| a.angle_between(*b)));
    pairs.fold(0.0, f64::max)
}
