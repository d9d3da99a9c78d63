use super::*;
use crate::{BUILTIN_NAMES, LengthUnit, MassProperties, MeshQuery, Pose, builtin, load_mesh};
use gripcast_base::error::ErrorKind;
use gripcast_testing::shared;
use proptest::prelude::*;

/// Strict, so that each defect is refused or repaired exactly; `repair_test.rs` tests the others.
const STRICT: PrepareOptions = PrepareOptions {
    weld_tolerance_m: 1e-7,
    max_extent_m: 1.0,
    min_extent_m: 2e-3,
    crossing_tolerance_m: 1e-6,
    repair: Repair::Strict,
    wall_thickness_m: None,
    needs_inside: true,
};

fn run(mesh: &TriangleMesh) -> Result<PreparedMesh> {
    prepare(mesh, &STRICT)
}

fn error_text(mesh: &TriangleMesh) -> String {
    let error = run(mesh).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Input);
    assert!(error.remedy_text().is_some(), "{error}");
    error.to_string()
}

fn only_warning(prepared: &PreparedMesh) -> &str {
    assert_eq!(prepared.warnings.len(), 1, "{:?}", prepared.warnings);
    &prepared.warnings[0]
}

fn moved(mesh: &TriangleMesh, by: DVec3) -> TriangleMesh {
    mesh.transformed(&Pose::from_translation(by))
}

/// Corner tetrahedron with sides of 20 mm.
fn tetrahedron() -> TriangleMesh {
    TriangleMesh {
        vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    }
    .scaled(0.02)
}

/// Copy scaled per axis, facing outwards also if mirrored.
fn mirrored(mesh: &TriangleMesh, factor: DVec3) -> TriangleMesh {
    let mut copy = mesh.clone();
    copy.vertices.iter_mut().for_each(|v| *v *= factor);
    if factor.x * factor.y * factor.z < 0.0 {
        copy.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    }
    copy
}

fn volume(mesh: &TriangleMesh) -> f64 {
    MassProperties::from_mesh(mesh).unwrap().volume_m3
}

#[test]
fn valid_meshes_are_unchanged() {
    for name in BUILTIN_NAMES {
        let mesh = builtin(name).unwrap();
        let prepared = run(&mesh).unwrap();
        assert!(
            prepared.warnings.is_empty(),
            "{name}: {:?}",
            prepared.warnings
        );
        assert_eq!(prepared.mesh, mesh, "{name}");
    }
}

#[test]
fn invalid_meshes_are_rejected() {
    let mut mesh = tetrahedron();
    mesh.vertices[2].x = f64::INFINITY;
    assert!(error_text(&mesh).contains("finite"));
    let mut mesh = tetrahedron();
    mesh.triangles[0][0] = 4;
    assert!(error_text(&mesh).contains("only 4"));
    assert!(error_text(&TriangleMesh::default()).contains("no triangles"));
}

#[test]
fn implausible_sizes_suggest_the_unit() {
    let mesh = builtin("box").unwrap();
    let text = error_text(&mesh.scaled(1e3));
    assert!(
        text.contains("60000 mm long") && text.contains("pass --unit mm"),
        "{text}"
    );
    assert!(text.contains("1000 mm"), "{text}");
    let text = error_text(&mesh.scaled(1e-3));
    assert!(text.contains("pass --unit m,"), "{text}");
}

#[test]
fn degenerate_triangles_are_dropped() {
    let mut mesh = tetrahedron();
    mesh.vertices.push(mesh.vertices[3]);
    mesh.triangles.push([3, 4, 1]);
    let prepared = run(&mesh).unwrap();
    assert!(only_warning(&prepared).contains("1 degenerate"));
    assert_eq!(prepared.mesh, tetrahedron());
}

#[test]
fn duplicates_and_fins_are_dropped() {
    for twin in [[0, 2, 1], [1, 2, 0]] {
        let mut mesh = tetrahedron();
        mesh.triangles.push(twin);
        let prepared = run(&mesh).unwrap();
        assert!(only_warning(&prepared).contains("1 duplicate"));
        assert_eq!(prepared.mesh, tetrahedron());
    }
    // A sheet of two opposite triangles on one edge, as in EGAD's B4.
    let mut mesh = tetrahedron();
    mesh.vertices.push(DVec3::new(0.01, -0.01, 0.0));
    mesh.triangles.extend([[0, 1, 4], [1, 0, 4]]);
    let prepared = run(&mesh).unwrap();
    assert!(only_warning(&prepared).contains("2 duplicate"));
    assert_eq!(prepared.mesh, tetrahedron());
}

#[test]
fn solids_sharing_an_edge_are_separated() {
    // Corner tetrahedra opposite at the z axis, with a common edge along it.
    let mesh = tetrahedron().joined(&mirrored(&tetrahedron(), DVec3::new(-1.0, -1.0, 1.0)));
    let prepared = run(&mesh).unwrap();
    assert!(only_warning(&prepared).contains("split 1 edge(s)"));
    assert!(prepared.mesh.edges().is_closed());
    assert_eq!(prepared.mesh.vertices.len(), 8);
    assert!((volume(&prepared.mesh) - 2.0 * volume(&tetrahedron())).abs() < 1e-20);
}

#[test]
fn solids_sharing_a_vertex_are_separated() {
    let mesh = tetrahedron().joined(&mirrored(&tetrahedron(), DVec3::NEG_ONE));
    let prepared = run(&mesh).unwrap();
    assert!(only_warning(&prepared).contains("duplicated 1 vertices"));
    assert_eq!(prepared.mesh.vertices.len(), 8);
}

/// Outer faces of a block of unit cells (10 mm) at lattice positions.
fn cells(positions: &[[i32; 3]]) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for position in positions {
        for axis in 0..3 {
            for step in [-1, 1] {
                let mut neighbour = *position;
                neighbour[axis] += step;
                if positions.contains(&neighbour) {
                    continue;
                }
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let corner = |du: i32, dv: i32| {
                    let mut node = *position;
                    node[axis] += i32::from(step > 0);
                    node[u] += du;
                    node[v] += dv;
                    DVec3::from_array(node.map(f64::from)) * 0.01
                };
                let first = mesh.vertices.len() as u32;
                mesh.vertices
                    .extend([corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)]);
                let [a, b, c, d] = [first, first + 1, first + 2, first + 3];
                let faces = if step > 0 {
                    [[a, b, c], [a, c, d]]
                } else {
                    [[c, b, a], [d, c, a]]
                };
                mesh.triangles.extend(faces);
            }
        }
    }
    mesh
}

#[test]
fn ring_closed_at_an_edge_is_separated() {
    // A ring of cells whose ends share an edge but no face: one component on both sides.
    let mesh = cells(&[
        [0, 0, 0],
        [1, 0, 0],
        [2, 0, 0],
        [2, 1, 0],
        [2, 2, 0],
        [1, 2, 0],
        [0, 1, 1],
        [0, 2, 0],
        [0, 1, 2],
        [0, 0, 2],
        [0, 0, 1],
    ]);
    let prepared = run(&mesh).unwrap();
    assert!(prepared.mesh.edges().is_closed());
    assert!((volume(&prepared.mesh) - 11e-6).abs() < 1e-15);
    let text = only_warning(&prepared);
    assert!(text.contains("split 1 edge(s)"), "{text}");
}

#[test]
fn edge_with_connected_ends_gets_a_middle_vertex() {
    // Two cells share an edge; bridges around both of its ends join the fans there.
    let mesh = cells(&[
        [0, 0, 1],
        [1, 1, 1],
        [0, 0, 0],
        [1, 1, 0],
        [0, 1, 0],
        [0, 0, 2],
        [1, 1, 2],
        [1, 0, 2],
    ]);
    let corners = mesh.vertices.clone();
    let prepared = run(&mesh).unwrap();
    assert!(prepared.mesh.edges().is_closed());
    assert!((volume(&prepared.mesh) - 8e-6).abs() < 1e-15);
    let added = prepared
        .mesh
        .vertices
        .iter()
        .filter(|v| !corners.contains(v));
    assert_eq!(added.collect::<Vec<_>>(), [&DVec3::new(0.01, 0.01, 0.015)]);
    assert!(only_warning(&prepared).contains("split 1 edge(s)"));
}

#[test]
fn inner_walls_are_rejected() {
    // Three triangles at an edge: a wall through the solid.
    let mut mesh = cells(&[[0, 0, 0], [1, 0, 0]]);
    let wall = [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]];
    let first = mesh.vertices.len() as u32;
    mesh.vertices
        .extend(wall.map(|p: [i32; 3]| DVec3::from_array(p.map(f64::from)) * 0.01));
    mesh.triangles
        .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    let text = error_text(&mesh);
    assert!(
        text.contains("two triangles, found 3 near (10.00,"),
        "{text}"
    );
}

#[test]
fn winding_is_repaired() {
    let mesh = builtin("wedge").unwrap();
    let mut mixed = mesh.clone();
    for triangle in mixed.triangles.iter_mut().step_by(5) {
        triangle.swap(0, 1);
    }
    let prepared = run(&mixed).unwrap();
    assert!(only_warning(&prepared).contains("flipped 663 triangle(s)"));
    assert!((volume(&prepared.mesh) - volume(&mesh)).abs() < 1e-18);

    let mut inside_out = mesh.clone();
    inside_out.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let prepared = run(&inside_out).unwrap();
    assert!(only_warning(&prepared).contains("1 of 1 component(s)"));
    assert!((volume(&prepared.mesh) - volume(&mesh)).abs() < 1e-18);
}

#[test]
fn components_and_cavities_are_accepted() {
    let outer = builtin("sphere").unwrap();
    let apart = outer.joined(&moved(&outer, DVec3::X * 0.06));
    assert!(run(&apart).unwrap().warnings.is_empty());

    // A component that faces inwards in another is a cavity, also if all of it is inverted.
    let inner = outer.scaled(0.5);
    let mut hollow = outer.joined(&inner);
    for triangle in &mut hollow.triangles[outer.triangles.len()..] {
        triangle.swap(0, 1);
    }
    let prepared = run(&hollow).unwrap();
    assert!(prepared.warnings.is_empty(), "{:?}", prepared.warnings);
    assert!((volume(&prepared.mesh) / volume(&outer) - 0.875).abs() < 1e-12);
    hollow.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let prepared = run(&hollow).unwrap();
    assert!(only_warning(&prepared).contains("2 of 2 component(s)"));
    assert!((volume(&prepared.mesh) / volume(&outer) - 0.875).abs() < 1e-12);
    // One that faces outwards is counted twice.
    let text = error_text(&outer.joined(&inner));
    assert!(text.contains("of the volume counts once"), "{text}");

    let mut open = apart.clone();
    open.triangles.pop();
    assert!(error_text(&open).contains("3 boundary edges"));
}

#[test]
fn holes_are_counted_with_their_position() {
    let mut mesh = builtin("box").unwrap();
    let at_top = |c: [DVec3; 3]| c.iter().all(|v| v.z > 0.0299 && v.x > 0.0 && v.y > 0.0);
    let kept = |t: &[u32; 3]| !at_top(mesh.corners(*t));
    mesh.triangles = mesh.triangles.iter().copied().filter(kept).collect();
    mesh.triangles.remove(0);
    let text = error_text(&mesh);
    assert!(text.contains("31 boundary edges in 2 hole(s)"), "{text}");
    assert!(
        text.contains("17.5 mm wide around (11.25, 11.25, 30.00) mm"),
        "{text}"
    );
}

#[test]
fn a_klein_bottle_is_rejected() {
    // A torus grid glued with a mirrored seam (embedded with a crossing, as it must be).
    let (n, m) = (24u32, 12u32);
    let at = |i: u32, j: u32| {
        let flip = i == n;
        let j = if flip { (m - j % m) % m } else { j % m };
        (i % n) * m + j
    };
    let mut mesh = TriangleMesh::default();
    for i in 0..n {
        for j in 0..m {
            let u = std::f64::consts::TAU * f64::from(i) / f64::from(n);
            let v = std::f64::consts::TAU * f64::from(j) / f64::from(m);
            let r = 0.03 + 0.01 * ((0.5 * u).cos() * v.sin() - (0.5 * u).sin() * (2.0 * v).sin());
            let z = 0.01 * ((0.5 * u).sin() * v.sin() + (0.5 * u).cos() * (2.0 * v).sin());
            mesh.vertices.push(DVec3::new(
                r * u.cos(),
                r * u.sin(),
                z + 1e-3 * f64::from(j),
            ));
            let quad = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.triangles
                .extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
        }
    }
    let text = error_text(&mesh);
    assert!(text.contains("one-sided"), "{text}");
}

#[test]
fn flat_bodies_are_rejected() {
    let mesh = builtin("bar").unwrap();
    let flat = mirrored(&mesh, DVec3::new(1e-7, 1.0, 1.0));
    let options = PrepareOptions {
        weld_tolerance_m: 0.0,
        ..STRICT
    };
    let text = prepare(&flat, &options).unwrap_err().to_string();
    assert!(text.contains("enclose a volume"), "{text}");
}

#[test]
fn slivers_are_removed_by_flips() {
    // A tetrahedron with an extra vertex on an edge and a triangle without area beside it.
    let mut mesh = tetrahedron();
    let middle = 0.5 * (mesh.vertices[1] + mesh.vertices[2]);
    mesh.vertices.push(middle);
    mesh.triangles[0] = [0, 4, 1];
    mesh.triangles.extend([[0, 2, 4], [2, 1, 4]]);
    assert!(mesh.edges().is_closed());
    let prepared = run(&mesh).unwrap();
    assert!(only_warning(&prepared).contains("flipped 1"));
    assert!(prepared.mesh.edges().is_closed());
    assert!(prepared.mesh.triangle_areas().iter().all(|a| *a > 1e-5));
    assert!((volume(&prepared.mesh) - volume(&tetrahedron())).abs() < 1e-20);
}

#[test]
fn intersecting_surfaces_are_rejected_touching_ones_not() {
    let cube = builtin("box").unwrap();
    let overlapping = cube.joined(&moved(&cube, DVec3::new(0.011, 0.007, 0.013)));
    let text = error_text(&overlapping);
    assert!(text.contains("intersects itself"), "{text}");
    // On the same lattice, so that sides intersect sides and corners.
    let lattice = cube.joined(&moved(&cube, DVec3::new(0.01, 0.01, 0.01)));
    assert!(run(&lattice).is_err());
    // Side by side with a gap, and one through the other without any corner inside.
    assert!(run(&cube.joined(&moved(&cube, DVec3::X * 0.0401))).is_ok());
    let needle = mirrored(&builtin("bar").unwrap(), DVec3::new(0.9, 0.45, 1.03));
    assert!(error_text(&cube.joined(&needle)).contains("intersects itself"));
}

#[test]
fn shallow_intersections_are_warnings() {
    let spike = builtin("spike").unwrap();
    // The tip of one body just pierces the side of another.
    let cube = builtin("box").unwrap();
    let pierced = |depth: f64| {
        let position = DVec3::new(1e-4, 2e-4, 0.03 + 0.035 - depth);
        run(&cube.joined(&moved(&spike, position)))
    };
    let prepared = pierced(5e-7).unwrap();
    assert!(only_warning(&prepared).contains("intersect by less than 0.001 mm"));
    assert!(pierced(5e-6).is_err());
}

#[test]
fn reported_position_lies_on_the_surface() {
    let mesh = builtin("sphere").unwrap();
    let both = mesh.joined(&moved(&mesh, DVec3::X * 0.03));
    let found = self_intersection::find(&both, 0.0);
    let position = found.first_position.unwrap();
    assert!((position.x - 0.015).abs() < 1e-3, "{position}");
    let query = MeshQuery::new(&mesh);
    assert!(query.closest_point(position).unwrap().distance_m < 1e-12);
    assert!(found.pairs > 50 && found.pairs < 1000, "{}", found.pairs);
}

#[test]
fn fold_is_an_intersection_flat_neighbour_is_not() {
    let pair = |far: DVec3| TriangleMesh {
        vertices: vec![DVec3::ZERO, DVec3::X, DVec3::new(0.3, 0.5, 0.0), far],
        triangles: vec![[0, 1, 2], [1, 0, 3]],
    };
    let intersections = |far| self_intersection::find(&pair(far), 0.0).pairs;
    assert_eq!(intersections(DVec3::new(0.5, 0.4, 0.0)), 1);
    assert_eq!(intersections(DVec3::new(0.5, -0.4, 0.0)), 0);
    assert_eq!(intersections(DVec3::new(0.5, 0.4, 1e-9)), 0);
}

#[test]
fn egad_meshes_are_prepared() {
    let Some(folder) = shared("data/egad_eval") else {
        return;
    };
    for (name, warning) in [
        ("B1", None),
        ("B4", Some("2 duplicate")),
        ("C2", None),
        ("C4", None),
    ] {
        let path = folder.join(format!("{name}.obj"));
        let unscaled = load_mesh(&path, LengthUnit::Metre).unwrap();
        assert!(error_text(&unscaled).contains("--unit mm"), "{name}");
        let mesh = load_mesh(&path, LengthUnit::Millimetre).unwrap();
        let prepared = run(&mesh).unwrap_or_else(|e| panic!("{name}: {e}"));
        let volume_cm3 = volume(&prepared.mesh) * 1e6;
        println!("{name}: {volume_cm3:.1} cm3, {:?}", prepared.warnings);
        let has_warning = prepared
            .warnings
            .iter()
            .any(|w| warning.is_some_and(|t| w.contains(t)));
        assert_eq!(
            has_warning,
            warning.is_some(),
            "{name}: {:?}",
            prepared.warnings
        );
        assert!(prepared.mesh.edges().is_closed());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Lattice cells touch at edges and corners and enclose cavities in all possible ways.
    #[test]
    fn bodies_of_cells_become_manifold(
        filled in prop::collection::btree_set([0..4i32, 0..4, 0..4], 1..40)
    ) {
        let positions: Vec<[i32; 3]> = filled.into_iter().collect();
        let prepared = run(&cells(&positions)).unwrap();
        let found = volume(&prepared.mesh);
        prop_assert!((found - 1e-6 * positions.len() as f64).abs() < 1e-14, "{found}");
        prop_assert!(prepared.mesh.edges().is_closed());
        let again = run(&prepared.mesh).unwrap();
        prop_assert!((volume(&again.mesh) - found).abs() < 1e-14);
    }

    #[test]
    fn triangle_soups_never_panic(
        corners in prop::collection::vec([0..3i32, 0..3, 0..3], 4..12),
        triangles in prop::collection::vec([0..4u32, 0..4, 0..4], 1..24),
    ) {
        let vertices = corners.iter().map(|c| DVec3::from_array(c.map(f64::from)) * 0.01);
        let mesh = TriangleMesh { vertices: vertices.collect(), triangles };
        match run(&mesh) {
            Ok(prepared) => prop_assert!(prepared.mesh.edges().is_closed()),
            Err(error) => prop_assert!(error.remedy_text().is_some(), "{error}"),
        }
    }
}
