//! Meshes that are not one closed manifold: pieces, overlaps, holes, flipped parts.

use super::*;
use crate::{LengthUnit, Pose, builtin, load_mesh};
use glam::{DMat3, DQuat};
use gripcast_testing::shared;
use proptest::prelude::*;

fn run(mesh: &TriangleMesh) -> PreparedMesh {
    prepare(mesh, &PrepareOptions::default()).unwrap()
}

fn solid(mesh: &TriangleMesh) -> Solid {
    run(mesh).solid.unwrap()
}

fn refused(mesh: &TriangleMesh) -> String {
    let error = prepare(mesh, &PrepareOptions::default()).unwrap_err();
    assert!(error.remedy_text().is_some(), "{error}");
    format!("{error} {}", error.remedy_text().unwrap_or_default())
}

fn strict(mesh: &TriangleMesh) -> Result<PreparedMesh> {
    let options = PrepareOptions {
        repair: Repair::Strict,
        ..PrepareOptions::default()
    };
    prepare(mesh, &options)
}

fn has_warning(prepared: &PreparedMesh, text: &str) -> bool {
    prepared.warnings.iter().any(|w| w.contains(text))
}

/// A box of twelve triangles.
fn cuboid(low: DVec3, high: DVec3) -> TriangleMesh {
    let corner = |i: u32| {
        DVec3::from_array([0, 1, 2].map(|axis| {
            if i >> axis & 1 == 1 {
                high[axis]
            } else {
                low[axis]
            }
        }))
    };
    let quads = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    TriangleMesh {
        vertices: (0..8).map(corner).collect(),
        triangles: quads
            .iter()
            .flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]])
            .collect(),
    }
}

fn cube() -> TriangleMesh {
    cuboid(DVec3::ZERO, DVec3::splat(0.04))
}

fn inverted(mesh: &TriangleMesh) -> TriangleMesh {
    let mut mesh = mesh.clone();
    mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    mesh
}

fn assert_near(found: f64, expected: f64, relative: f64) {
    let error = (found / expected - 1.0).abs();
    assert!(
        error <= relative,
        "found {found:e}, expected {expected:e}: {error:e}"
    );
}

#[test]
fn union_of_two_overlapping_boxes_counts_their_common_part_once() {
    let mesh = cube().joined(&cuboid(DVec3::splat(0.02), DVec3::splat(0.06)));
    let prepared = run(&mesh);
    assert_eq!(prepared.mesh, mesh);
    assert!(
        has_warning(&prepared, "pieces overlap: 6.7 % of the volume"),
        "{:?}",
        prepared.warnings
    );
    let found = prepared.solid.unwrap();
    assert_near(found.properties.volume_m3, 120e-6, 2e-3);
    assert!(
        found
            .properties
            .center_of_mass_m
            .distance(DVec3::splat(0.03))
            < 3e-5
    );
    assert_near(found.overlap, 8.0 / 120.0, 0.02);
    assert!(found.uncertainty < 0.01, "{}", found.uncertainty);
    assert!(strict(&mesh).is_err());
}

#[test]
fn second_moments_of_a_union_are_those_of_the_whole() {
    // Two overlapping halves of one bar.
    let whole = cuboid(DVec3::ZERO, DVec3::new(0.08, 0.02, 0.03));
    let halves = cuboid(DVec3::ZERO, DVec3::new(0.05, 0.02, 0.03)).joined(&cuboid(
        DVec3::new(0.03, 0.0, 0.0),
        DVec3::new(0.08, 0.02, 0.03),
    ));
    let (found, expected) = (solid(&halves).properties, solid(&whole).properties);
    assert_near(found.volume_m3, expected.volume_m3, 5e-3);
    let entries = |m: DMat3| m.to_cols_array();
    let scale = expected.second_moment_m5.x_axis.x;
    for (f, e) in entries(found.second_moment_m5)
        .iter()
        .zip(entries(expected.second_moment_m5))
    {
        assert!((f - e).abs() < 0.01 * scale, "{f:e} {e:e}");
    }
}

#[test]
fn touching_boxes_lose_their_common_wall() {
    let mesh = cube().joined(&cuboid(
        DVec3::new(0.0, 0.0, 0.04),
        DVec3::new(0.04, 0.04, 0.08),
    ));
    let found = solid(&mesh);
    assert_near(found.properties.volume_m3, 128e-6, 1e-12);
    assert!(
        found
            .properties
            .center_of_mass_m
            .distance(DVec3::new(0.02, 0.02, 0.04))
            < 1e-12
    );
    assert_eq!(found.uncertainty, 0.0);
}

#[test]
fn nested_bodies_are_solid_and_cavities_face_inwards() {
    let (outer, inner) = (
        cuboid(DVec3::ZERO, DVec3::splat(0.05)),
        cuboid(DVec3::splat(0.01), DVec3::splat(0.04)),
    );
    let prepared = run(&outer.joined(&inner));
    assert_near(prepared.solid.unwrap().properties.volume_m3, 125e-6, 2e-3);
    assert!(
        has_warning(&prepared, "pieces overlap"),
        "{:?}",
        prepared.warnings
    );
    let hollow = run(&outer.joined(&inverted(&inner)));
    assert_near(hollow.solid.unwrap().properties.volume_m3, 98e-6, 1e-12);
    assert!(hollow.warnings.is_empty(), "{:?}", hollow.warnings);
    // All of it inside out: the cavity stays one.
    let hollow = run(&inverted(&outer.joined(&inverted(&inner))));
    assert_near(hollow.solid.unwrap().properties.volume_m3, 98e-6, 1e-12);
}

#[test]
fn a_piece_that_faces_inwards_is_flipped() {
    let apart = cuboid(DVec3::new(0.06, 0.0, 0.0), DVec3::new(0.08, 0.02, 0.02));
    let prepared = run(&cube().joined(&inverted(&apart)));
    assert!(
        has_warning(&prepared, "1 of 2 component(s)"),
        "{:?}",
        prepared.warnings
    );
    assert_near(prepared.solid.unwrap().properties.volume_m3, 72e-6, 1e-12);
}

#[test]
fn a_surface_with_two_sides_becomes_one() {
    let mesh = builtin("box").unwrap();
    let prepared = run(&mesh.joined(&inverted(&mesh)));
    assert!(
        has_warning(&prepared, "duplicate"),
        "{:?}",
        prepared.warnings
    );
    assert_eq!(prepared.mesh, mesh);
}

#[test]
fn small_holes_are_closed_and_large_ones_refused() {
    let whole = builtin("sphere").unwrap();
    let expected = solid(&whole).properties;
    let mut scan = whole.clone();
    scan.triangles.drain(100..103);
    let prepared = run(&scan);
    let found = prepared.solid.unwrap();
    assert_near(found.properties.volume_m3, expected.volume_m3, 1e-3);
    assert!(
        found
            .properties
            .center_of_mass_m
            .distance(expected.center_of_mass_m)
            < 1e-5
    );
    assert!(
        has_warning(&prepared, "closed holes"),
        "{:?}",
        prepared.warnings
    );
    assert!(
        strict(&scan)
            .unwrap_err()
            .to_string()
            .contains("boundary edges")
    );

    let mut bowl = whole;
    let below = |t: &[u32; 3]| bowl.corners(*t).iter().all(|v| v.z < 1e-9);
    bowl.triangles = bowl.triangles.iter().copied().filter(below).collect();
    let text = refused(&bowl);
    assert!(
        text.contains("inside") && text.contains("--wall-thickness-mm"),
        "{text}"
    );
}

#[test]
fn an_open_box_gets_a_wall() {
    let mut open = cube();
    // Without the side x = 40 mm.
    open.triangles.truncate(10);
    let text = refused(&open);
    assert!(text.contains("--wall-thickness-mm"), "{text}");
    let options = PrepareOptions {
        wall_thickness_m: Some(0.002),
        ..PrepareOptions::default()
    };
    for mesh in [open.clone(), inverted(&open)] {
        let prepared = prepare(&mesh, &options).unwrap();
        // Five walls of 40 mm, 2 mm thick, inwards.
        let expected = 40.0 * 40.0 * 40.0 - 38.0 * 36.0 * 36.0;
        let found = prepared.solid.unwrap();
        assert_near(found.properties.volume_m3, expected * 1e-9, 1e-3);
        assert_eq!(prepared.mesh.bounds(), open.bounds());
        assert!(
            has_warning(&prepared, "a wall of 2 mm"),
            "{:?}",
            prepared.warnings
        );
    }
    let closed = prepare(&cube(), &options).unwrap();
    assert!(has_warning(&closed, "not used"), "{:?}", closed.warnings);
    assert_eq!(closed.mesh, cube());
    let thick = PrepareOptions {
        wall_thickness_m: Some(0.05),
        ..options
    };
    assert!(prepare(&open, &thick).is_err());
}

#[test]
fn what_needs_no_mass_takes_open_and_flat_surfaces() {
    let mut sheet = cube();
    sheet.triangles.truncate(2);
    let options = PrepareOptions {
        needs_inside: false,
        ..PrepareOptions::default()
    };
    let prepared = prepare(&sheet, &options).unwrap();
    assert_eq!((prepared.solid, prepared.mesh.triangles.len()), (None, 2));
    assert!(refused(&sheet).contains("volume"));
}

#[test]
fn nothing_is_repaired_on_request() {
    let options = PrepareOptions {
        repair: Repair::None,
        ..PrepareOptions::default()
    };
    let twice = cube().joined(&cube());
    assert_eq!(prepare(&twice, &options).unwrap().mesh, twice);
    let mut flat = cube();
    flat.triangles.push([0, 0, 1]);
    let text = prepare(&flat, &options).unwrap_err().to_string();
    assert!(text.contains("area above 0"), "{text}");
    assert!(prepare(&inverted(&cube()), &options).is_err());
}

#[test]
fn strays_far_from_the_object_are_dropped() {
    let far = cuboid(DVec3::splat(0.1), DVec3::splat(0.1005));
    let prepared = run(&cube().joined(&far));
    assert!(
        has_warning(&prepared, "dropped 1 stray"),
        "{:?}",
        prepared.warnings
    );
    assert_eq!(prepared.mesh, cube());
    // A small part that belongs to the object stays.
    let knob = cuboid(
        DVec3::new(0.02, 0.02, 0.0399),
        DVec3::new(0.0205, 0.0205, 0.0405),
    );
    assert_eq!(run(&cube().joined(&knob)).mesh.triangles.len(), 24);
}

#[test]
fn field_meshes_have_the_volume_of_their_union() {
    // Volumes in cm³ by construction, or of the union by manifold3d.
    let cases = [
        ("interlocked-rings/rings.obj", 15.5895),
        ("nested/cavity_outward.obj", 125.0),
        ("nested/rattle.obj", 43.9687),
        ("open-box/one-missing.obj", 36.0),
        ("overlap-union/overlap.obj", 44.0),
        ("overlap-union/touching.obj", 72.0),
        ("scan-holes/island.obj", 112.853),
        ("scan-holes/one_hole.obj", 112.853),
        ("scan-holes/unused_vertex.obj", 112.853),
        ("invariance/flipped.obj", 42.1861),
        ("invariance/mirrored.obj", 42.1861),
        ("invariance/soup.obj", 42.1861),
    ];
    let Some(folder) = shared("field/mesh-sim-pose") else {
        return;
    };
    let load = |name: &str| load_mesh(&folder.join(name), LengthUnit::Metre).unwrap();
    for (name, expected) in cases {
        let found = prepare(&load(name), &PrepareOptions::default())
            .unwrap_or_else(|e| panic!("{name}: {e}"));
        let volume_cm3 = 1e6 * found.solid.unwrap().properties.volume_m3;
        assert!(
            (volume_cm3 / expected - 1.0).abs() < 0.005,
            "{name}: {volume_cm3}"
        );
    }
    for name in ["open-cup/cup_single_wall.obj", "open-box/open.obj"] {
        let mesh = load(name);
        assert!(refused(&mesh).contains("--wall-thickness-mm"), "{name}");
        let options = PrepareOptions {
            wall_thickness_m: Some(1e-3),
            ..PrepareOptions::default()
        };
        let volume_m3 = prepare(&mesh, &options)
            .unwrap()
            .solid
            .unwrap()
            .properties
            .volume_m3;
        // A thin shell: area times thickness, less what corners have in common.
        assert_near(volume_m3, mesh.area() * 1e-3, 0.08);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Volume and centre of mass of a union of two boxes, wherever it is.
    #[test]
    fn union_of_boxes_is_exact_to_one_percent(
        shift in prop::array::uniform3(-0.03..0.03f64),
        size in prop::array::uniform3(0.01..0.05f64),
        at in prop::array::uniform3(-0.2..0.2f64),
    ) {
        let (low, high) = (DVec3::from_array(shift), DVec3::from_array(shift) + DVec3::from_array(size));
        let mesh = cube().joined(&cuboid(low, high));
        let common = (high.min(DVec3::splat(0.04)) - low.max(DVec3::ZERO)).max(DVec3::ZERO);
        let middle = 0.5 * (high.min(DVec3::splat(0.04)) + low.max(DVec3::ZERO));
        let own = high - low;
        let parts = [
            (64e-6, DVec3::splat(0.02)),
            (own.x * own.y * own.z, 0.5 * (low + high)),
            (-common.x * common.y * common.z, middle),
        ];
        let volume: f64 = parts.iter().map(|p| p.0).sum();
        let center = parts.iter().map(|p| p.1 * p.0).sum::<DVec3>() / volume;
        let moved = Pose::from_translation(DVec3::from_array(at));
        let found = solid(&mesh.transformed(&moved)).properties;
        prop_assert!((found.volume_m3 / volume - 1.0).abs() < 0.01, "{} {volume}", found.volume_m3);
        let error = found.center_of_mass_m.distance(moved.transform_point(center));
        prop_assert!(error < 2e-4, "{error}");
    }

    /// A clean mesh is integrated exactly, in any orientation.
    #[test]
    fn clean_meshes_have_no_miscount(q in prop::array::uniform4(-1.0..1.0f64)) {
        let rotation = DQuat::from_xyzw(q[0], q[1], q[2], q[3]);
        prop_assume!(rotation.length() > 0.1);
        let mesh = builtin("mug").unwrap();
        let mesh = mesh.transformed(&Pose::from_rotation(rotation.normalize()));
        let found = Solid::of(&mesh).unwrap();
        prop_assert_eq!(found.properties, crate::MassProperties::of_closed(&mesh).unwrap());
        prop_assert_eq!((found.overlap, found.uncertainty), (0.0, 0.0));
    }

    #[test]
    fn soups_never_panic(
        corners in prop::collection::vec([0..4i32, 0..4, 0..4], 4..16),
        triangles in prop::collection::vec([0..4u32, 0..4, 0..4], 1..40),
        wall in prop::option::of(0.0..0.02f64),
    ) {
        let vertices = corners.iter().map(|c| DVec3::from_array(c.map(f64::from)) * 0.01);
        let mesh = TriangleMesh { vertices: vertices.collect(), triangles };
        for repair in Repair::ALL {
            let options = PrepareOptions { repair, wall_thickness_m: wall, ..PrepareOptions::default() };
            match prepare(&mesh, &options) {
                Ok(prepared) => {
                    let solid = prepared.solid.unwrap();
                    prop_assert!(solid.properties.volume_m3 > 0.0 && solid.uncertainty <= 0.1);
                }
                Err(error) => prop_assert!(error.remedy_text().is_some(), "{error}"),
            }
        }
    }
}
