//! A UMI-style parallel gripper with two GelSight Minis, in code.
//!
//! # Dimensions
//! Gripper frame: origin midway between the gel faces, x closing, z approach, the camera towards
//! −y. mm; x is measured from a finger's gel face outwards, the rest from the origin. The Mini
//! has its real outer size; rails, palm and handle are a plausible hand-held gripper, not a copy
//! of one.
//!
//! | part | x | y | z | rounding |
//! | --- | --- | --- | --- | --- |
//! | gel | 0 to 4 | ±10 | ±12.5 | 0.4 |
//! | Mini, housing (32 × 28 × 25 with gel) | 2 to 25 | ±14 | −19.1 to 12.9 | 2.5 |
//! | Mini, back cover | 25 to 27 | ±12.5 | −17.5 to 11.5 | 1 |
//! | Mini, label | 8 to 20 | ±14.15 | −9 to −5 | – |
//! | cradle, two walls | 9 to 30 | ±(14 to 16.5) | −21 to −4 | 1 |
//! | finger plate | 27 to 32 | ±13 | −72 to 6 | 1.5 |
//! | finger rib | 32 to 38 | ±3.5 | −86 to −14 | 1.5 |
//! | finger foot | 8 to 34 | ±13 | −86 to −70 | 2 |
//! | cable, diameter 3.6 | 14 to 46 | 0 to 18 | −118 to −19 | – |
//! | carriage | 4 to 38 | ±17 | −104 to −86 | 1.5 |
//!
//! x from the middle of the gripper:
//!
//! | part | x | y | z | rounding |
//! | --- | --- | --- | --- | --- |
//! | rail | ±112, longer for openings above 140 | ±7.5 | −113 to −101 | 1 |
//! | rail ends | 6 long | ±12 | −117 to −97 | 1.5 |
//! | palm | ±62 | ±24 | −156 to −116 | 6 |
//! | handle | ±17 | ±15 | −262 to −150 | 12 |
//! | camera arm | ±12 | −68 to −10 | −192 to −170 | 3 |
//! | D435 | 90 wide, 25 high, 25 deep, its ends round, behind the camera’s place | | | 12.5 |

use glam::{DQuat, DVec3};

use super::d435::t_gripper_camera;
use super::solids::{cylinder, mirrored_x, rounded_box, smooth_path, tube};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_geometry::{Pose, TriangleMesh};

/// Widest opening that is drawn, m.
const WIDEST_M: f64 = 0.2;
const MM: f64 = 1e-3;

/// What a part is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum GripperSurface {
    /// Coating of the gel: matt grey.
    Gel,
    /// Black plastic of the sensor.
    Housing,
    /// White ink.
    Label,
    /// Printed plastic of the fingers, the palm and the camera arm.
    Print,
    /// Black anodised aluminium.
    Anodised,
    /// Ground steel.
    Steel,
    /// Cables and grip.
    Rubber,
    /// Shell of the D435.
    CameraShell,
    /// Its dark window.
    CameraWindow,
}

/// A closed body of the gripper.
#[derive(Clone, Debug)]
pub struct GripperPart {
    /// What it is, as in the table of this module.
    pub name: &'static str,
    /// What it is made of.
    pub surface: GripperSurface,
    /// Shape in the gripper frame, m.
    pub shape: TriangleMesh,
}

/// All parts of a gripper whose undeformed gel faces are `opening_m` apart. The gels come first,
/// left then right; the D435 comes last, as the parts named `camera …`.
///
/// # Errors
/// `Input` for an opening that is not from 0 to 0.2 m.
pub fn gripper_parts(opening_m: f64) -> Result<Vec<GripperPart>> {
    if !(0.0..=WIDEST_M).contains(&opening_m) {
        return Err(Error::new(
            ErrorKind::Input,
            format!("the gripper's opening must be from 0 to {WIDEST_M} m, found {opening_m}"),
        )
        .remedy("give the distance between the gels' faces in metres"));
    }
    let mut parts = Vec::new();
    for (name, surface, shape) in finger() {
        // Drawn at positive x, which is the right finger.
        let moved = shape.transformed(&Pose::from_translation(DVec3::X * 0.5 * opening_m));
        parts.push(part(name, surface, mirrored_x(&moved)));
        parts.push(part(name, surface, moved));
    }
    parts.extend(body(opening_m));
    parts.extend(camera());
    Ok(parts)
}

fn part(name: &'static str, surface: GripperSurface, shape: TriangleMesh) -> GripperPart {
    GripperPart {
        name,
        surface,
        shape,
    }
}

/// Rounded box by its bounds in mm.
fn block(x: [f64; 2], y: [f64; 2], z: [f64; 2], rounding: f64) -> TriangleMesh {
    let low = DVec3::new(x[0], y[0], z[0]) * MM;
    let high = DVec3::new(x[1], y[1], z[1]) * MM;
    rounded_box(low, high, rounding * MM)
}

/// Parts of the right finger with its gel face at x = 0.
fn finger() -> Vec<(&'static str, GripperSurface, TriangleMesh)> {
    use GripperSurface::{Anodised, Gel, Housing, Label, Print, Rubber, Steel};
    let mut parts = vec![
        (
            "gel",
            Gel,
            block([0.0, 4.0], [-10.0, 10.0], [-12.5, 12.5], 0.4),
        ),
        (
            "housing",
            Housing,
            block([2.0, 25.0], [-14.0, 14.0], [-19.1, 12.9], 2.5),
        ),
        (
            "back cover",
            Anodised,
            block([25.0, 27.0], [-12.5, 12.5], [-17.5, 11.5], 1.0),
        ),
        (
            "label",
            Label,
            block([8.0, 20.0], [-14.15, 14.15], [-9.0, -7.6], 0.05),
        ),
        (
            "label",
            Label,
            block([8.0, 15.0], [-14.15, 14.15], [-6.4, -5.4], 0.05),
        ),
        (
            "plate",
            Print,
            block([27.0, 32.0], [-13.0, 13.0], [-72.0, 6.0], 1.5),
        ),
        (
            "rib",
            Print,
            block([32.0, 38.0], [-3.5, 3.5], [-86.0, -14.0], 1.5),
        ),
        (
            "foot",
            Print,
            block([8.0, 34.0], [-13.0, 13.0], [-86.0, -70.0], 2.0),
        ),
        (
            "carriage",
            Anodised,
            block([4.0, 38.0], [-17.0, 17.0], [-104.0, -86.0], 1.5),
        ),
    ];
    for side in [-1.0, 1.0_f64] {
        let y = [14.0 * side, 16.5 * side];
        let y = [y[0].min(y[1]), y[0].max(y[1])];
        parts.push(("cradle", Print, block([9.0, 30.0], y, [-21.0, -4.0], 1.0)));
        // Heads of screws on the sides that the cameras see.
        for (x, z, reach, radius) in [
            (13.0, -17.5, 17.2, 1.6),
            (26.0, -7.5, 17.2, 1.6),
            (11.0, -90.5, 17.8, 2.4),
            (31.0, -90.5, 17.8, 2.4),
            (11.0, -99.5, 17.8, 2.4),
            (31.0, -99.5, 17.8, 2.4),
        ] {
            let end = |y: f64| DVec3::new(x, y * side, z) * MM;
            let inside = reach - 3.0;
            parts.push((
                "screw",
                Steel,
                cylinder(end(inside), end(reach), radius * MM, 20),
            ));
        }
    }
    let cable = [
        [14.0, 0.0, -18.0],
        [14.0, 1.0, -34.0],
        [20.0, 9.0, -56.0],
        [38.0, 17.0, -80.0],
        [46.0, 18.0, -104.0],
        [38.0, 14.0, -118.0],
    ]
    .map(|p| DVec3::from_array(p) * MM);
    parts.push(("cable", Rubber, tube(&smooth_path(&cable, 6), 1.8 * MM, 16)));
    parts
}

/// Rail, palm, handle and the arm of the camera.
fn body(opening_m: f64) -> Vec<GripperPart> {
    use GripperSurface::{Anodised, Print, Rubber, Steel};
    let half = (0.5 * opening_m / MM + 42.0).max(112.0);
    let end = |side: f64| {
        let x = [side * half, side * (half + 6.0)];
        let x = [x[0].min(x[1]), x[0].max(x[1])];
        block(x, [-12.0, 12.0], [-117.0, -97.0], 1.5)
    };
    vec![
        part(
            "rail",
            Steel,
            block([-half, half], [-7.5, 7.5], [-113.0, -101.0], 1.0),
        ),
        part("rail end", Anodised, end(-1.0)),
        part("rail end", Anodised, end(1.0)),
        part(
            "palm",
            Print,
            block([-62.0, 62.0], [-24.0, 24.0], [-156.0, -116.0], 6.0),
        ),
        part(
            "handle",
            Rubber,
            block([-17.0, 17.0], [-15.0, 15.0], [-262.0, -150.0], 12.0),
        ),
        part(
            "arm",
            Print,
            block([-12.0, 12.0], [-68.0, -10.0], [-192.0, -170.0], 3.0),
        ),
    ]
}

/// The D435 around its colour camera: imagers 14.7 and 64.7 mm to the right of it, 4.2 mm behind
/// the window (data sheet of the D400 series).
fn camera() -> Vec<GripperPart> {
    use GripperSurface::{CameraShell, CameraWindow, Housing};
    let place = t_gripper_camera();
    let middle = 14.7 + 17.5;
    let end = |x: f64| {
        let [from, to] = [-20.8, 3.6].map(|z| DVec3::new(middle + x, 0.0, z) * MM);
        cylinder(from, to, 12.5 * MM, 48)
    };
    let mut parts = vec![
        (
            "camera shell",
            CameraShell,
            block(
                [middle - 32.5, middle + 32.5],
                [-12.5, 12.5],
                [-20.8, 3.6],
                0.2,
            ),
        ),
        ("camera shell", CameraShell, end(-32.5)),
        ("camera shell", CameraShell, end(32.5)),
        (
            "camera window",
            CameraWindow,
            block([middle - 40.0, middle + 40.0], [-8.0, 8.0], [0.0, 4.2], 0.5),
        ),
    ];
    for x in [0.0, 14.7, 45.0, 64.7] {
        let [from, to] = [1.0, 4.5].map(|z| DVec3::new(x, 0.0, z) * MM);
        parts.push(("camera lens", Housing, cylinder(from, to, 3.2 * MM, 24)));
    }
    parts
        .into_iter()
        .map(|(name, surface, shape)| part(name, surface, shape.transformed(&place)))
        .collect()
}

/// A pose from the rotation about the x axis by `angle_rad` and a place, m.
pub(super) fn pitched(angle_rad: f64, place: DVec3) -> Pose {
    Pose::new(DQuat::from_rotation_x(angle_rad), place)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::{MassProperties, MeshQuery};

    #[test]
    fn every_part_is_closed_and_turned_outwards() {
        for opening in [0.0, 0.042, 0.2] {
            for part in gripper_parts(opening).unwrap() {
                assert!(part.shape.edges().is_closed(), "{}", part.name);
                let volume = MassProperties::of(&part.shape).unwrap().volume_m3;
                assert!(volume > 0.0, "{}: {volume}", part.name);
            }
        }
    }

    #[test]
    fn gel_faces_are_the_opening_apart() {
        for opening in [0.0, 0.042, 0.11] {
            let parts = gripper_parts(opening).unwrap();
            let [left, right] = [&parts[0], &parts[1]].map(|part| {
                assert_eq!((part.name, part.surface), ("gel", GripperSurface::Gel));
                part.shape.bounds()
            });
            assert!((left.max.x + 0.5 * opening).abs() < 1e-12);
            assert!((right.min.x - 0.5 * opening).abs() < 1e-12);
            let size = (right.max - right.min) * 1e3;
            assert!(
                (size - DVec3::new(4.0, 20.0, 25.0)).length() < 1e-9,
                "{size}"
            );
            assert!((right.center() * DVec3::new(0.0, 1.0, 1.0)).length() < 1e-12);
        }
    }

    #[test]
    fn the_mini_has_its_size_and_nothing_reaches_between_the_faces() {
        let parts = gripper_parts(0.05).unwrap();
        let mini = parts[0].shape.bounds().union(&parts[2].shape.bounds());
        let size = (mini.max - mini.min) * 1e3;
        assert!(
            (size - DVec3::new(25.0, 28.0, 32.0)).length() < 1e-9,
            "{size}"
        );
        for part in parts
            .iter()
            .filter(|part| part.surface != GripperSurface::Gel)
        {
            let query = MeshQuery::new(&part.shape);
            for z in [-0.012, 0.0, 0.012] {
                for x in [-0.02, 0.0, 0.02] {
                    assert!(!query.contains(DVec3::new(x, 0.0, z)), "{}", part.name);
                }
            }
            // Nothing is lower than the gels by more than the free space left above the ground.
            assert!(part.shape.bounds().max.z <= 0.0129 + 1e-9, "{}", part.name);
        }
    }

    #[test]
    fn nothing_hides_the_gels_from_the_camera() {
        let parts = gripper_parts(0.06).unwrap();
        let eye = t_gripper_camera().translation_m;
        for part in parts.iter().filter(|p| !p.name.starts_with("camera")) {
            let query = MeshQuery::new(&part.shape);
            // Just in front of the middles of the faces, and the point between them.
            for x in [-0.0295, 0.0, 0.0295] {
                let ray = DVec3::new(x, 0.0, 0.0) - eye;
                assert!(query.ray_cast(eye, ray, 1.0).is_none(), "{}", part.name);
            }
        }
    }

    #[test]
    fn impossible_openings_are_explained() {
        for bad in [-0.01, 0.3, f64::NAN] {
            let text = gripper_parts(bad).unwrap_err().to_string();
            assert!(text.contains("opening") && text.contains("0.2"), "{text}");
        }
    }
}
