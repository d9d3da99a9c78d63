use super::*;
use gripcast_base::error::ErrorKind;
use std::collections::BTreeMap;

fn grids() -> Vec<GelGrid> {
    let grading = Grading {
        front: 1.4,
        plane: 1.5,
        centre_m: [0.003, -0.002],
    };
    vec![
        GelPad::default().grid(GelResolution::Coarse).unwrap(),
        GelPad::default().grid(GelResolution::Default).unwrap(),
        GelGrid::graded([8, 7, 4], [0.025, 0.02, 0.004], grading).unwrap(),
        GelGrid::new([vec![0.0, 1.0], vec![-1.0, 2.0], vec![0.0, 0.5]]).unwrap(),
    ]
}

fn size(grid: &GelGrid) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|a| {
        let axis = &grid.axes()[a];
        axis[axis.len() - 1] - axis[0]
    }))
}

#[test]
fn standard_pads_have_the_stated_size() {
    for (resolution, nodes, tets) in [
        (GelResolution::Coarse, 13 * 11 * 3, 1200),
        (GelResolution::Default, 19 * 16 * 4, 4050),
        (GelResolution::Fine, 26 * 21 * 5, 10_000),
    ] {
        let grid = GelPad::default().grid(resolution).unwrap();
        assert_eq!(grid.positions().len(), nodes);
        assert_eq!(grid.tets().len(), tets);
        assert!(size(&grid).abs_diff_eq(DVec3::new(0.025, 0.020, 0.004), 1e-15));
        assert_eq!(grid.axes()[0][0], -0.0125);
        assert_eq!(grid.thickness_m(), 0.004);
    }
}

#[test]
fn tetrahedra_fill_the_box() {
    for grid in grids() {
        let volumes = grid.tets().iter().map(|t| tet_volume(t, grid.positions()));
        assert!(volumes.clone().all(|v| v > 0.0));
        let expected = size(&grid).element_product();
        assert!((volumes.sum::<f64>() / expected - 1.0).abs() < 1e-12);
        let mass: f64 = grid.lumped_masses(1000.0).unwrap().iter().sum();
        assert!((mass / (1000.0 * expected) - 1.0).abs() < 1e-12);
    }
}

#[test]
fn every_inner_face_has_two_tetrahedra() {
    for grid in grids() {
        let mut uses = BTreeMap::new();
        for &[a, b, c, d] in grid.tets() {
            for mut face in [[a, b, c], [a, b, d], [a, c, d], [b, c, d]] {
                face.sort_unstable();
                *uses.entry(face).or_insert(0) += 1;
            }
        }
        let outer = uses.values().filter(|n| **n == 1).count();
        assert!(uses.values().all(|n| *n <= 2));
        assert_eq!(
            outer,
            grid.triangles.len(),
            "faces that lie in none of the six planes"
        );
        let [nx, ny, nz] = grid.nodes().map(|n| n - 1);
        assert_eq!(outer, 4 * (nx * ny + ny * nz + nz * nx));
    }
}

#[test]
fn sides_face_outwards_with_their_area() {
    for grid in grids() {
        let extent = size(&grid);
        for (side, normal) in [
            (Side::Front, DVec3::Z),
            (Side::XMin, -DVec3::X),
            (Side::XMax, DVec3::X),
            (Side::YMin, -DVec3::Y),
            (Side::YMax, DVec3::Y),
            (Side::Back, -DVec3::Z),
        ] {
            let mut total = 0.0;
            for t in grid.triangles(side) {
                let [a, b, c] = t.map(|v| grid.positions()[v as usize]);
                let area = 0.5 * (b - a).cross(c - a);
                assert!(
                    (area.dot(normal) / area.length() - 1.0).abs() < 1e-12,
                    "{side:?}"
                );
                total += area.length();
            }
            let expected = extent.element_product() / extent.dot(normal).abs();
            assert!((total / expected - 1.0).abs() < 1e-12, "{side:?}: {total}");
        }
    }
}

#[test]
fn contact_areas_sum_without_the_back() {
    for grid in grids() {
        let (extent, surface) = (size(&grid), grid.contact_surface());
        let area = extent.x * extent.y + 2.0 * extent.z * (extent.x + extent.y);
        for areas in [surface.vertex_areas(), surface.edge_areas()] {
            assert!((areas.iter().sum::<f64>() / area - 1.0).abs() < 1e-12);
            assert!(areas.iter().all(|a| *a > 0.0));
        }
        assert_eq!(surface.vertices().len(), surface.vertex_areas().len());
        assert_eq!(surface.edges().len(), surface.edge_areas().len());
        assert!(surface.edges().is_sorted_by(|a, b| a < b));
        assert!(surface.edges().iter().all(|[a, b]| a < b));
        // A disc: V - E + F = 1.
        let euler = surface.vertices().len() + surface.triangles().len();
        assert_eq!(euler, surface.edges().len() + 1);
    }
}

#[test]
fn back_face_is_driven() {
    for grid in grids() {
        let [nx, ny, _] = grid.nodes();
        let expected: Vec<u32> = (0..(nx * ny) as u32).collect();
        assert_eq!(grid.driven(), expected);
        let area = size(&grid).x * size(&grid).y;
        assert!((grid.driven_areas().iter().sum::<f64>() / area - 1.0).abs() < 1e-12);
    }
}

#[test]
fn grading_is_finest_at_its_centre() {
    let grid = &grids()[2];
    let cells =
        |axis: usize| -> Vec<f64> { grid.axes()[axis].windows(2).map(|w| w[1] - w[0]).collect() };
    let z = cells(2);
    assert!(z.is_sorted_by(|a, b| a > b), "{z:?}");
    for (axis, centre) in [(0, 0.003), (1, -0.002)] {
        let widths = cells(axis);
        let narrowest = (0..widths.len())
            .min_by(|a, b| widths[*a].total_cmp(&widths[*b]))
            .unwrap();
        let offset = grid.axes()[axis][narrowest] - centre;
        assert!(offset.abs() < 2.0 * widths[narrowest], "{widths:?}");
    }
}

#[test]
fn invalid_grids_are_rejected() {
    let pad = [0.025, 0.02, 0.004];
    let flat = Grading {
        front: 0.5,
        ..Grading::default()
    };
    let aside = Grading {
        centre_m: [0.02, 0.0],
        ..Grading::default()
    };
    for bad in [
        GelGrid::uniform([1, 5, 5], pad),
        GelGrid::uniform([5, 5, 5], [0.025, 0.0, 0.004]),
        GelGrid::uniform([5, 5, 5], [0.025, f64::NAN, 0.004]),
        GelGrid::graded([5, 5, 5], pad, flat),
        GelGrid::graded([5, 5, 5], pad, aside),
        GelGrid::new([vec![0.0, 1.0], vec![1.0, 0.0], vec![0.0, 1.0]]),
        GelGrid::new([vec![0.0, 1.0], vec![0.0, 1.0], vec![0.1, 1.0]]),
        GelGrid::new([vec![0.0, f64::INFINITY], vec![0.0, 1.0], vec![0.0, 1.0]]),
    ] {
        assert_eq!(bad.unwrap_err().kind(), ErrorKind::Input);
    }
    let grid = GelGrid::uniform([2, 2, 2], pad).unwrap();
    assert!(grid.lumped_masses(0.0).is_err());
}

#[test]
fn resolution_parses_its_name() {
    assert_eq!(
        GelResolution::from_name("fine").unwrap(),
        GelResolution::Fine
    );
    let text = GelResolution::from_name("corse").unwrap_err().to_string();
    assert!(text.contains("did you mean coarse"), "{text}");
}
