//! Tests of depths.

use glam::DVec3;

use super::*;
use crate::rays::bumpy_ball;
use gripcast_geometry::{Pose, TriangleMesh};

const GRID: SensorGeometry = SensorGeometry {
    width: 120,
    height: 90,
    pixel_m: 1e-4,
    gel_thickness_m: 4e-3,
};

fn scene(object: &TriangleMesh, position: DVec3, gap_m: f64) -> TactileScene<'_> {
    TactileScene {
        object,
        t_sensor_object: Pose::from_translation(position),
        face_m: 4e-3,
        gap_m,
        gel_face: None,
        skin: crate::Skin::default(),
    }
}

fn depth(scene: &TactileScene<'_>) -> PressDepth {
    object_depth(scene, &GRID, &mut Rasteriser::new())
}

#[test]
fn ball_has_analytic_depth() {
    let radius = 6e-3;
    // Sagitta of a face: 0.6 µm.
    let ball = bumpy_ball(radius, 0.0, 160, 320);
    let position = DVec3::new(1.1e-3, -0.7e-3, 4e-3 + radius - 1.2e-3);
    for gap in [0.0, 4.5e-4] {
        let press = depth(&scene(&ball, position, gap));
        let mut worst = 0.0f64;
        for (pixel, depth) in press.depth_m.iter().enumerate() {
            let [x, y] = GRID.pixel_to_gel_m((pixel % 120) as f64, (pixel / 120) as f64);
            let aside = (x - position.x).powi(2) + (y - position.y).powi(2);
            let up = (radius * radius - aside).max(0.0).sqrt();
            let expected = (4e-3 + gap - (position.z - up)).max(0.0);
            let expected = if aside < radius * radius {
                expected
            } else {
                0.0
            };
            worst = worst.max((f64::from(*depth) - expected).abs());
        }
        assert!(worst < 1e-6, "{worst}");
        assert!((press.deepest_m() - 1.2e-3 - gap).abs() < 1e-6);
    }
}

#[test]
fn depth_is_clipped_to_gel_thickness() {
    let ball = bumpy_ball(8e-3, 0.0, 40, 40);
    // 5 mm deep, beyond the gel's back: still no hole.
    let press = depth(&scene(&ball, DVec3::Z * 7e-3, 0.0));
    assert_eq!(press.deepest_m(), f64::from(4e-3_f32));
    assert_eq!(press.depth_m[45 * 120 + 60], 4e-3);
    assert!(press.depth_m.iter().all(|d| (0.0..=4e-3).contains(d)));
}

#[test]
fn object_behind_the_sensor_is_ignored() {
    let ball = bumpy_ball(8e-3, 0.0, 40, 40);
    let press = depth(&scene(&ball, DVec3::Z * -30e-3, 0.0));
    assert_eq!(press, PressDepth::untouched(GRID));
}

#[test]
fn gel_surface_depth_shows_only_indentation() {
    let ball = bumpy_ball(8e-3, 0.0, 40, 40);
    let corner = |x: f64, y: f64, z: f64| DVec3::new(0.0125 * x, 0.01 * y, z);
    let face = |middle: f64| TriangleMesh {
        vertices: vec![
            corner(-1.0, -1.0, 4e-3),
            corner(1.0, -1.0, 4e-3),
            corner(1.0, 1.0, 4e-3),
            corner(-1.0, 1.0, 4e-3),
            corner(0.0, 0.0, middle),
        ],
        triangles: vec![[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
    };
    let mut scene = scene(&ball, DVec3::Z * 0.1, 0.0);
    assert!(gel_surface_depth(&scene, &GRID, &mut Rasteriser::new()).is_none());
    scene.gel_face = Some(face(4e-3));
    let flat = gel_surface_depth(&scene, &GRID, &mut Rasteriser::new());
    assert_eq!(flat, Some(PressDepth::untouched(GRID)));
    scene.gel_face = Some(face(3e-3));
    let sunken = gel_surface_depth(&scene, &GRID, &mut Rasteriser::new()).unwrap();
    // Half a pixel from the middle of a pyramid 1 mm deep.
    let expected = 1e-3 * (1.0 - 0.5e-4 / 0.01);
    assert!((sunken.deepest_m() - expected).abs() < 1e-7);
    // A bulge beyond the face at rest is not an indentation.
    scene.gel_face = Some(face(4.2e-3));
    let bulge = gel_surface_depth(&scene, &GRID, &mut Rasteriser::new());
    assert_eq!(bulge, Some(PressDepth::untouched(GRID)));
}
