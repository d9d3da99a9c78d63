//! Detected markers joined with where they are on their part.

use glam::{DVec2, DVec3};

use super::reprojection::{Observation, State, residual};
use crate::camera::undistort;
use crate::{Board, Detection, Part};
use gripcast_imaging::Intrinsics;

/// One seen marker.
#[derive(Clone, Debug)]
pub(super) struct Sighting {
    pub(super) id: u32,
    pub(super) corners: [Observation; 4],
    /// Ideal image coordinates of the corners.
    pub(super) ideal: [DVec2; 4],
}

impl Sighting {
    /// Unit normal of the marker, towards its front.
    pub(super) fn normal(&self) -> DVec3 {
        let [a, b, c, d] = self.corners.map(|o| o.point_m);
        (d - b).cross(c - a).normalize_or_zero()
    }

    /// Area in the image, px².
    pub(super) fn area_px(&self) -> f64 {
        let [a, b, c, d] = self.corners.map(|o| o.pixel);
        0.5 * (c - a).perp_dot(d - b).abs()
    }

    /// Distances of its corners from where `state` predicts them, px; infinite behind the camera.
    pub(super) fn errors_px(&self, intrinsics: &Intrinsics, state: &State) -> [f64; 4] {
        self.corners
            .map(|corner| residual(intrinsics, state, &corner).map_or(f64::INFINITY, DVec2::length))
    }

    /// Root mean square of [`Self::errors_px`].
    pub(super) fn rms_px(&self, intrinsics: &Intrinsics, state: &State) -> f64 {
        let squares = self.errors_px(intrinsics, state).map(|e| e * e);
        (squares.iter().sum::<f64>() / 4.0).sqrt()
    }
}

/// The detections that are markers of `parts` with what the caller should know about the others.
pub(super) fn sightings(
    board: &Board,
    parts: &[Part],
    detections: &[Detection],
    intrinsics: &Intrinsics,
) -> (Vec<Sighting>, Vec<String>) {
    let mut found: Vec<Sighting> = Vec::new();
    let mut notes = Vec::new();
    for detection in detections {
        let marker = board
            .markers
            .iter()
            .find(|m| m.id == detection.id && parts.contains(&m.part));
        let Some(marker) = marker else { continue };
        let ideal = detection.corners_px.map(|c| undistort(intrinsics, c));
        let [Some(a), Some(b), Some(c), Some(d)] = ideal else {
            notes.push(format!(
                "marker {} is where the lens model has no answer; it was left out",
                marker.id
            ));
            continue;
        };
        if found.iter().any(|s| s.id == marker.id) {
            notes.push(format!("marker {} was seen more than once", marker.id));
        }
        let slide = marker.part.slide();
        let corner = |i: usize| Observation {
            point_m: marker.corners_m[i],
            slide,
            pixel: detection.corners_px[i],
        };
        found.push(Sighting {
            id: marker.id,
            corners: [corner(0), corner(1), corner(2), corner(3)],
            ideal: [a, b, c, d],
        });
    }
    (found, notes)
}

/// Largest angle between two normals, rad.
pub(super) fn normals_apart(sightings: &[&Sighting]) -> f64 {
    let normals: Vec<DVec3> = sightings.iter().map(|s| s.normal()).collect();
    let mut widest: f64 = 0.0;
    for (i, a) in normals.iter().enumerate() {
        for b in &normals[..i] {
            widest = widest.max(a.angle_between(*b));
        }
    }
    widest
}
