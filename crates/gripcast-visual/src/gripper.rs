//! Mesh model of a UMI-style parallel gripper with two GelSight Minis.
//!
//! # Dimensions
//! Gripper frame: origin midway between the gel faces, x closing direction, z approach direction,
//! the camera on the −y side; mm. x is measured outwards from a finger's gel face, y and z from the
//! origin. The Mini has its real outer dimensions; rails, palm and handle are a plausible hand-held
//! gripper, not a copy of one.
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
//! x from the centre of the gripper:
//!
//! | part | x | y | z | rounding |
//! | --- | --- | --- | --- | --- |
//! | rail | ±112, longer for openings above 140 | ±7.5 | −113 to −101 | 1 |
//! | rail ends | 6 long | ±12 | −117 to −97 | 1.5 |
//! | palm | ±62 | ±24 | −156 to −116 | 6 |
//! | handle | ±17 | ±15 | −262 to −150 | 12 |
//! | camera arm | ±12 | −68 to −10 | −192 to −170 | 3 |
//! | D435 | 90 wide, 25 high, 25 deep, rounded ends, behind the camera's origin | | | 12.5 |

use glam::DVec3;

use serde::Deserialize;

use GripperSurface::{Anodised, CameraShell, CameraWindow, Housing, Print, Rubber, Steel};

use super::solids::{cylinder, mirrored_x, rounded_box, smooth_path, tube};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh, WristCamera};

/// Maximum opening, m.
const MAX_OPENING_M: f64 = 0.2;
const MM: f64 = 1e-3;

/// Surface material of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GripperSurface {
    /// Gel coating: matt grey.
    Gel,
    /// Black plastic of the sensor.
    Housing,
    /// White ink.
    Label,
    /// 3D-printed plastic of the fingers, the palm and the camera arm.
    Print,
    /// Black anodised aluminium.
    Anodised,
    /// Ground steel.
    Steel,
    /// Cables and grip.
    Rubber,
    /// Shell of the D435.
    CameraShell,
    /// Dark window of the D435.
    CameraWindow,
}

/// A closed body of the gripper.
#[derive(Clone, Debug)]
pub struct GripperPart {
    /// Name of the part as in the table of this module.
    pub name: String,
    /// Surface material.
    pub surface: GripperSurface,
    /// Shape in the gripper frame, m.
    pub shape: TriangleMesh,
}

/// Returns all parts of a gripper whose undeformed gel faces are `opening_m` apart. The gels come
/// first, left then right; the D435 comes last, as the parts named `camera …`.
///
/// # Errors
/// `Input` if the opening is not within 0 to 0.2 m.
pub fn gripper_parts(opening_m: f64) -> Result<Vec<GripperPart>> {
    if !(0.0..=MAX_OPENING_M).contains(&opening_m) {
        return Err(Error::input(format!(
            "the gripper's opening must be from 0 to {MAX_OPENING_M} m, found {opening_m}"
        ))
        .remedy("give the distance between the gel faces in metres"));
    }
    let Ok(dimensions) = toml::from_str::<Dimensions>(include_str!("gripper.toml")) else {
        return Err(Error::internal("cannot parse gripper.toml"));
    };
    let mut parts = Vec::new();
    for part in finger(&dimensions) {
        // Modelled at positive x: the right finger.
        let moved = part.moved(&Pose::from_translation(DVec3::X * 0.5 * opening_m));
        parts.push(GripperPart {
            shape: mirrored_x(&moved.shape),
            ..moved.clone()
        });
        parts.push(moved);
    }
    parts.extend(rail(opening_m).map(GripperPart::from_box));
    parts.extend(dimensions.body.into_iter().map(GripperPart::from_box));
    parts.extend(camera());
    Ok(parts)
}

type Range = [f64; 2];
/// A rounded box: name, surface, bounds along x, y and z, rounding; mm.
type BoxSpec = (String, GripperSurface, Range, Range, Range, f64);

#[derive(Deserialize)]
struct Dimensions {
    finger: Vec<BoxSpec>,
    body: Vec<BoxSpec>,
    /// Screws on the sides that the cameras see: x, z, y of the head, radius; mm.
    screws: Vec<[f64; 4]>,
    /// Control points of the cable of a finger, mm.
    cable: Vec<[f64; 3]>,
}

impl GripperPart {
    fn new(name: &str, surface: GripperSurface, shape: TriangleMesh) -> Self {
        let name = name.to_owned();
        Self {
            name,
            surface,
            shape,
        }
    }

    fn from_box((name, surface, x, y, z, rounding): BoxSpec) -> Self {
        let low = DVec3::new(x[0], y[0], z[0]) * MM;
        let high = DVec3::new(x[1], y[1], z[1]) * MM;
        Self::new(&name, surface, rounded_box(low, high, rounding * MM))
    }

    fn moved(&self, pose: &Pose) -> Self {
        Self::new(&self.name, self.surface, self.shape.transformed(pose))
    }
}

/// Parts of the right finger with its gel face at x = 0.
fn finger(dimensions: &Dimensions) -> Vec<GripperPart> {
    let boxes = dimensions.finger.iter().cloned();
    let mut parts: Vec<_> = boxes.map(GripperPart::from_box).collect();
    for (side, y) in [(-1.0, [-16.5, -14.0]), (1.0, [14.0, 16.5])] {
        let name = "cradle".to_owned();
        let cradle = (name, Print, [9.0, 30.0], y, [-21.0, -4.0], 1.0);
        parts.push(GripperPart::from_box(cradle));
        for &[x, z, reach, radius] in &dimensions.screws {
            let [from, to] = [reach - 3.0, reach].map(|y| DVec3::new(x, y * side, z) * MM);
            let shape = cylinder(from, to, radius * MM, 20);
            parts.push(GripperPart::new("screw", Steel, shape));
        }
    }
    let points = dimensions.cable.iter().map(|p| DVec3::from_array(*p) * MM);
    let cable = tube(&smooth_path(&points.collect::<Vec<_>>(), 6), 1.8 * MM, 16);
    parts.push(GripperPart::new("cable", Rubber, cable));
    parts
}

/// Rail and rail ends; longer for openings above 140 mm.
fn rail(opening_m: f64) -> [BoxSpec; 3] {
    let half = (0.5 * opening_m / MM + 42.0).max(112.0);
    let end = |x| {
        let name = "rail end".to_owned();
        (name, Anodised, x, [-12.0, 12.0], [-117.0, -97.0], 1.5)
    };
    let rail = ("rail".to_owned(), Steel, [-half, half]);
    [
        (rail.0, rail.1, rail.2, [-7.5, 7.5], [-113.0, -101.0], 1.0),
        end([-(half + 6.0), -half]),
        end([half, half + 6.0]),
    ]
}

/// The D435 around its colour camera: infrared imagers 14.7 and 64.7 mm to the right, window 4.2 mm
/// in front (D400 series data sheet).
fn camera() -> Vec<GripperPart> {
    let middle = 14.7 + 17.5;
    let rounded_box_part = |name: &str, surface, half: f64, y, z, rounding| {
        let x = [middle - half, middle + half];
        GripperPart::from_box((name.to_owned(), surface, x, y, z, rounding))
    };
    let rod = |name, surface, x: f64, z: Range, radius, segments| {
        let [from, to] = z.map(|z| DVec3::new(x, 0.0, z) * MM);
        GripperPart::new(name, surface, cylinder(from, to, radius * MM, segments))
    };
    let (shell, ends) = ("camera shell", [-20.8, 3.6]);
    let window = [-8.0, 8.0];
    let mut parts = vec![
        rounded_box_part(shell, CameraShell, 32.5, [-12.5, 12.5], ends, 0.2),
        rod(shell, CameraShell, middle + -32.5, ends, 12.5, 48),
        rod(shell, CameraShell, middle + 32.5, ends, 12.5, 48),
        rounded_box_part("camera window", CameraWindow, 40.0, window, [0.0, 4.2], 0.5),
    ];
    let lens = |x| rod("camera lens", Housing, x, [1.0, 4.5], 3.2, 24);
    parts.extend([0.0, 14.7, 45.0, 64.7].map(lens));
    let t_gripper_camera = WristCamera::t_gripper_camera();
    parts
        .iter()
        .map(|part| part.moved(&t_gripper_camera))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::{MassProperties, MeshQuery};

    #[test]
    fn every_part_is_closed_and_faces_outwards() {
        for opening in [0.0, 0.042, 0.2] {
            for part in gripper_parts(opening).unwrap() {
                assert!(part.shape.edges().is_closed(), "{}", part.name);
                let volume = MassProperties::from_mesh(&part.shape).unwrap().volume_m3;
                assert!(volume > 0.0, "{}: {volume}", part.name);
            }
        }
    }

    #[test]
    fn gel_faces_are_opening_apart() {
        for opening in [0.0, 0.042, 0.11] {
            let parts = gripper_parts(opening).unwrap();
            let [left, right] = [&parts[0], &parts[1]].map(|part| {
                assert_eq!((&*part.name, part.surface), ("gel", GripperSurface::Gel));
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
    fn mini_has_its_size_and_gap_between_faces_is_free() {
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
    fn camera_has_clear_view_of_gels() {
        let parts = gripper_parts(0.06).unwrap();
        let eye = WristCamera::t_gripper_camera().translation_m;
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
    fn opening_out_of_range_is_refused() {
        for bad in [-0.01, 0.3, f64::NAN] {
            let text = gripper_parts(bad).unwrap_err().to_string();
            assert!(text.contains("opening") && text.contains("0.2"), "{text}");
        }
    }
}
