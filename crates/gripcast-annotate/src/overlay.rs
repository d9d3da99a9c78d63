//! Draws an observation over its image.

use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};

use super::observation::Observation;
use gripcast_geometry::{Pose, TriangleMesh};
use gripcast_imaging::caption::{HEIGHT, write_text};
use gripcast_imaging::{Intrinsics, draw_line};
use gripcast_pose::Detection;
use gripcast_pose::camera::project;

/// Length of drawn axes, m.
const AXIS_M: f64 = 0.04;
/// Minimum angle between the faces of a drawn edge, rad.
const CREASE_RAD: f64 = 0.5;
/// Near clipping distance, m.
const NEAR_M: f64 = 0.01;
const AXES: [(DVec3, Rgb<u8>); 3] = [
    (DVec3::X, Rgb([235, 50, 50])),
    (DVec3::Y, Rgb([60, 200, 70])),
    (DVec3::Z, Rgb([70, 120, 255])),
];
const MESH: Rgb<u8> = Rgb([255, 220, 0]);
const USED: Rgb<u8> = Rgb([0, 230, 230]);
const EXCLUDED: Rgb<u8> = Rgb([255, 0, 200]);
const TEXT: Rgb<u8> = Rgb([255, 255, 255]);

/// Optional content of an overlay.
#[derive(Clone, Debug, Default)]
pub struct OverlayContent<'a> {
    /// Mesh of the object, m.
    pub mesh: Option<&'a TriangleMesh>,
    /// Lines of text.
    pub lines: Vec<String>,
}

/// Draws over `image`: detected markers (cyan; excluded ones magenta), the frames of object and
/// gripper (x red, y green, z blue), and the visible outline and creases of the mesh (yellow).
pub fn overlay(
    image: &mut RgbImage,
    observation: &Observation,
    intrinsics: &Intrinsics,
    content: &OverlayContent<'_>,
) {
    if let Some(mesh) = content.mesh {
        for [a, b] in visible_edges(mesh, &observation.object.t_camera_body) {
            segment(image, intrinsics, a, b, 1.0, MESH);
        }
    }
    let residuals = observation
        .object
        .markers
        .iter()
        .chain(&observation.gripper.body.markers);
    let excluded: Vec<u32> = residuals.filter(|m| !m.used).map(|m| m.id).collect();
    for detection in &observation.detections {
        let colour = if excluded.contains(&detection.id) {
            EXCLUDED
        } else {
            USED
        };
        outline(image, detection, colour);
    }
    draw_axes(image, intrinsics, &observation.object.t_camera_body);
    draw_axes(image, intrinsics, &observation.gripper.body.t_camera_body);
    let step = 2 * HEIGHT;
    for (row, text) in content.lines.iter().enumerate() {
        let y = HEIGHT + row as u32 * step;
        shade(image, y.saturating_sub(4), step);
        write_text(image, 8, y, text, TEXT);
    }
}

/// Draws detected markers over an image: outline (cyan), id, and a dot at the top left corner.
pub fn draw_markers(image: &mut RgbImage, detections: &[Detection]) {
    for detection in detections {
        outline(image, detection, USED);
        let first = detection.corners_px[0];
        line(image, first, first, 4.0, EXCLUDED);
        let at = detection.center_px();
        if at.cmpge(DVec2::ZERO).all() {
            let id = detection.id.to_string();
            write_text(image, at.x as u32, at.y as u32, &id, MESH);
        }
    }
}

/// Draws the axes of a frame: x red, y green, z blue.
pub fn draw_axes(image: &mut RgbImage, intrinsics: &Intrinsics, t_camera_body: &Pose) {
    for (axis, colour) in AXES {
        let tip = t_camera_body.transform_point(AXIS_M * axis);
        let origin = t_camera_body.translation_m;
        segment(image, intrinsics, origin, tip, 2.5, colour);
    }
}

fn outline(image: &mut RgbImage, detection: &Detection, colour: Rgb<u8>) {
    let corners = detection.corners_px;
    for i in 0..4 {
        line(image, corners[i], corners[(i + 1) % 4], 1.0, colour);
    }
}

/// Silhouette edges and visible creases, in the camera frame.
fn visible_edges(mesh: &TriangleMesh, t_camera_object: &Pose) -> Vec<[DVec3; 2]> {
    let placed = mesh.transformed(t_camera_object);
    let normals: Vec<DVec3> = placed
        .all_corners()
        .map(|[a, b, c]| (b - a).cross(c - a).normalize_or_zero())
        .collect();
    let faces_camera = |triangle: &u32| {
        let corner = placed.vertices[placed.triangles[*triangle as usize][0] as usize];
        normals[*triangle as usize].dot(corner) < 0.0
    };
    let edges = placed.edges();
    let drawn = (0..edges.len()).filter(|edge| {
        let triangles = edges.triangles(*edge);
        let facing = triangles.iter().filter(|t| faces_camera(t)).count();
        let is_sharp = || match triangles {
            [a, b] => normals[*a as usize].angle_between(normals[*b as usize]) > CREASE_RAD,
            _ => true,
        };
        facing > 0 && (facing < triangles.len() || is_sharp())
    });
    drawn
        .map(|edge| edges.vertices[edge].map(|v| placed.vertices[v as usize]))
        .collect()
}

/// Draws a line in space, in short pieces because of distortion.
fn segment(
    image: &mut RgbImage,
    intrinsics: &Intrinsics,
    a: DVec3,
    b: DVec3,
    width: f64,
    colour: Rgb<u8>,
) {
    const PIECES: usize = 8;
    let project_at = |i: usize| {
        let point = a.lerp(b, i as f64 / PIECES as f64);
        (point.z > NEAR_M).then(|| project(intrinsics, point))?
    };
    for i in 0..PIECES {
        if let (Some(from), Some(to)) = (project_at(i), project_at(i + 1)) {
            line(image, from, to, width, colour);
        }
    }
}

fn line(image: &mut RgbImage, a: DVec2, b: DVec2, width: f64, colour: Rgb<u8>) {
    draw_line(image, a.to_array(), b.to_array(), width, colour);
}

/// Darkens rows behind text.
fn shade(image: &mut RgbImage, from: u32, rows: u32) {
    let (width, height) = image.dimensions();
    for y in from..(from + rows).min(height) {
        for x in 0..width {
            let pixel = image.get_pixel_mut(x, y);
            pixel.0 = pixel.0.map(|level| level / 3);
        }
    }
}
