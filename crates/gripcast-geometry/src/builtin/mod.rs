//! Named procedural meshes: watertight, counter-clockwise seen from outside, centred at the origin,
//! z up.

mod fine;
mod hard;
pub mod implicit;
mod mug;
mod shapes;

use glam::DVec3;

use super::mesh::TriangleMesh;
use gripcast_base::error::{Error, Result, nearest_name};

#[cfg(test)]
pub(super) use shapes::uv_sphere;

/// Names of the built-in meshes.
pub const BUILTIN_NAMES: &[&str] = &[
    "box", "sphere", "cylinder", "mug", "wedge", "bar", "spike", "ball", "bottle", "jack", "star",
    "dented", "ring", "saddle", "lump",
];

/// Creates a built-in mesh (m) by name, with or without the prefix `builtin:`. Faces are 2 to 4 mm
/// wide, those of `ball` and `bottle` about 1 mm.
///
/// | name | shape | triangles |
/// | --- | --- | --- |
/// | `box` | 40 × 40 × 60 mm | 4096 |
/// | `sphere` | radius 25 mm, 36 meridians, 19 rings of faces | 1296 |
/// | `cylinder` | upright, diameter 50 mm, height 80 mm | 3920 |
/// | `mug` | diameter 60 mm, height 80 mm, wall 4 mm, handle towards +x to 63 mm from the axis | 8896 |
/// | `wedge` | 40 mm deep, 50 mm high; 50 mm wide at the bottom, 30 mm at the top: sides inclined by 11.3° | 3312 |
/// | `bar` | 10 × 20 × 120 mm | 2048 |
/// | `spike` | octahedron, corners at ±20, ±20, ±35 mm | 1152 |
/// | `ball` | radius 25 mm | 10368 |
/// | `bottle` | upright, diameter 43 mm, height 110 mm, cap of 33 mm with 32 ribs | 21248 |
/// | `jack` | six knobbed arms of different length, 64 to 66 mm across | 7068 |
/// | `star` | prism over a star of five rounded points, 50 mm across and high, twisted by 50° | 10440 |
/// | `dented` | ball of 54 mm with seven dents | 10168 |
/// | `ring` | wavy ring of 61 mm, about 17 mm thick | 7716 |
/// | `saddle` | round saddle with three legs, 58 mm across, 37 mm high, 11 mm thick | 8580 |
/// | `lump` | ball with bumps and hollows, 51 × 54 × 61 mm | 9284 |
///
/// The last six are not convex and hard to grasp; their longest edges are below 3 mm.
///
/// # Errors
/// `NotFound` for an unknown name; the remedy lists the names.
///
/// ```
/// let mug = gripcast_geometry::builtin("builtin:mug")?;
/// assert!(mug.edges().is_closed());
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
pub fn builtin(name: &str) -> Result<TriangleMesh> {
    Ok(match name.strip_prefix("builtin:").unwrap_or(name) {
        "box" => shapes::grid_box(DVec3::new(0.04, 0.04, 0.06), [16, 16, 24]),
        "sphere" => shapes::uv_sphere(0.025, 36, 19),
        "cylinder" => shapes::cylinder(0.025, 0.08, 14, 28),
        "mug" => mug::mug(),
        "wedge" => wedge(),
        "bar" => shapes::grid_box(DVec3::new(0.01, 0.02, 0.12), [4, 8, 40]),
        "spike" => shapes::octahedron(DVec3::new(0.02, 0.02, 0.035), 12),
        "ball" => fine::ball(0.025, 36),
        "bottle" => fine::bottle(),
        "jack" => hard::jack(),
        "star" => hard::star(),
        "dented" => hard::dented(),
        "ring" => hard::ring(),
        "saddle" => hard::saddle(),
        "lump" => hard::lump(),
        other => return Err(unknown(other)),
    })
}

/// Box whose width (x) shrinks from 50 mm at the bottom to 30 mm at the top.
fn wedge() -> TriangleMesh {
    let height = 0.05;
    let mut mesh = shapes::grid_box(DVec3::new(0.05, 0.04, height), [18, 14, 18]);
    for vertex in &mut mesh.vertices {
        vertex.x *= 1.0 - 0.4 * (vertex.z / height + 0.5);
    }
    mesh
}

fn unknown(name: &str) -> Error {
    let nearest = nearest_name(name, BUILTIN_NAMES.iter().copied());
    let hint = nearest.map_or(String::new(), |n| format!("did you mean builtin:{n}? "));
    Error::not_found(format!("unknown built-in mesh {name:?}"))
        .remedy(format!("{hint}available: {}", BUILTIN_NAMES.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MassProperties, PrepareOptions, convex_hull, prepare};

    #[test]
    fn all_shapes_are_watertight_and_face_outwards() {
        for name in BUILTIN_NAMES {
            let mesh = builtin(name).unwrap();
            mesh.validate().unwrap();
            let edges = mesh.edges();
            assert!(edges.is_closed(), "{name}");
            assert!(
                MassProperties::from_mesh(&mesh).unwrap().volume_m3 > 0.0,
                "{name}"
            );
            let euler =
                mesh.vertices.len() as i64 - edges.len() as i64 + mesh.triangles.len() as i64;
            let has_hole = ["mug", "ring"].contains(name);
            assert_eq!(euler, if has_hole { 0 } else { 2 }, "{name}");
        }
    }

    #[test]
    fn faces_are_small_and_not_slivers() {
        for name in BUILTIN_NAMES {
            let mesh = builtin(name).unwrap();
            for (corners, area) in mesh.all_corners().zip(mesh.triangle_areas()) {
                let [a, b, c] = corners;
                let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
                assert!(longest < 0.0065, "{name}: {longest}");
                // The triangles around the poles of the sphere are narrow.
                let min = if *name == "sphere" { 0.05 } else { 0.15 };
                assert!(2.0 * area > min * longest * longest, "{name}: {corners:?}");
            }
        }
    }

    #[test]
    fn sizes_match_the_documentation() {
        let expected = [
            ("box", [40.0, 40.0, 60.0], 4096),
            ("sphere", [50.0, 50.0, 50.0], 1296),
            ("cylinder", [50.0, 50.0, 80.0], 3920),
            ("mug", [93.0, 60.0, 80.0], 8896),
            ("wedge", [50.0, 40.0, 50.0], 3312),
            ("bar", [10.0, 20.0, 120.0], 2048),
            ("spike", [40.0, 40.0, 70.0], 1152),
            ("ball", [50.0, 50.0, 50.0], 10368),
            ("bottle", [43.0, 43.0, 110.0], 21248),
            ("jack", [65.2, 66.2, 64.2], 7068),
            ("star", [49.3, 50.0, 50.0], 10440),
            ("dented", [54.1, 54.2, 54.0], 10168),
            ("ring", [61.3, 60.7, 26.0], 7716),
            ("saddle", [57.9, 58.0, 36.9], 8580),
            ("lump", [50.8, 54.1, 61.1], 9284),
        ];
        for ((name, size_mm, triangles), known) in expected.into_iter().zip(BUILTIN_NAMES) {
            assert_eq!(name, *known);
            let mesh = builtin(name).unwrap();
            let size = mesh.bounds().extent() * 1e3;
            // Polygons inscribed in circles fall short by less than a fifth of a millimetre.
            let off = (size - DVec3::from_array(size_mm)).abs().max_element();
            assert!(off < 0.2, "{name}: {size}");
            assert_eq!(mesh.triangles.len(), triangles, "{name}");
        }
    }

    #[test]
    fn all_shapes_need_no_repair() {
        for name in BUILTIN_NAMES {
            let prepared = prepare(&builtin(name).unwrap(), &PrepareOptions::default()).unwrap();
            assert!(
                prepared.warnings.is_empty(),
                "{name}: {:?}",
                prepared.warnings
            );
        }
    }

    #[test]
    fn hard_shapes_are_not_convex() {
        for (name, max_fraction) in [
            ("jack", 0.35),
            ("star", 0.75),
            ("dented", 0.95),
            ("ring", 0.65),
            ("saddle", 0.5),
            ("lump", 0.9),
        ] {
            let mesh = builtin(name).unwrap();
            let volume = |mesh: &TriangleMesh| MassProperties::from_mesh(mesh).unwrap().volume_m3;
            let fraction = volume(&mesh) / volume(&convex_hull(&mesh.vertices).unwrap());
            assert!(
                (0.1..max_fraction).contains(&fraction),
                "{name}: {fraction}"
            );
        }
    }

    #[test]
    fn misspelt_name_suggests_the_nearest() {
        let text = builtin("builtin:spere").unwrap_err().to_string();
        assert!(
            text.contains("builtin:sphere") && text.contains("wedge"),
            "{text}"
        );
    }
}
