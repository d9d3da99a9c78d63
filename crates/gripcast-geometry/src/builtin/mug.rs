//! A mug: body, cavity and handle in one closed surface.

use std::f64::consts::PI;

use glam::DVec3;

use super::shapes::{band, disc, push, push_quad, square_ring};
use crate::mesh::TriangleMesh;

const OUTER_RADIUS_M: f64 = 0.030;
const INNER_RADIUS_M: f64 = 0.026;
const HEIGHT_M: f64 = 0.080;
const FLOOR_M: f64 = 0.005;
/// Segments around the body, as quarters.
const QUARTER: u32 = 16;
/// Rings of faces outside and inside.
const OUTER_ROWS: u32 = 28;
const INNER_ROWS: u32 = 25;
/// Faces replaced by the handle: columns about the x axis, rows at the top, and the mirrored rows
/// at the bottom.
const HANDLE_COLUMNS: (usize, usize) = (6, 10);
const HANDLE_ROWS: (usize, usize) = (20, 24);
/// Half width (along y) and half thickness of the round middle of the handle, m.
const HANDLE_HALF_M: (f64, f64) = (0.0050, 0.0042);
/// x where the straight ends of the handle meet its half circle, m.
const HANDLE_BEND_X_M: f64 = 0.036;
const HANDLE_CUTS: u32 = 24;

/// Upright mug, body centred at the origin, opening upwards (+z), handle towards +x.
pub(super) fn mug() -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let half = 0.5 * HEIGHT_M;
    let height =
        |from: f64, row: u32, rows: u32| from + (half - from) * f64::from(row) / f64::from(rows);
    let outer: Vec<_> = (0..=OUTER_ROWS)
        .map(|row| {
            let z = height(-half, row, OUTER_ROWS);
            square_ring(&mut mesh, QUARTER, OUTER_RADIUS_M, z)
        })
        .collect();
    let inner: Vec<_> = (0..=INNER_ROWS)
        .map(|row| {
            let z = height(FLOOR_M - half, row, INNER_ROWS);
            square_ring(&mut mesh, QUARTER, INNER_RADIUS_M, z)
        })
        .collect();
    let middle = 0.5 * (OUTER_RADIUS_M + INNER_RADIUS_M);
    let rim = square_ring(&mut mesh, QUARTER, middle, half);
    wall_with_openings(&mut mesh, &outer);
    for pair in inner.windows(2) {
        band(&mut mesh, &pair[1], &pair[0]);
    }
    band(&mut mesh, &outer[OUTER_ROWS as usize], &rim);
    band(&mut mesh, &rim, &inner[INNER_ROWS as usize]);
    disc(&mut mesh, &outer[0], false);
    disc(&mut mesh, &inner[0], true);
    handle(&mut mesh, &outer);
    mesh.without_unused_vertices()
}

/// Outside of the body without the faces that the handle replaces.
fn wall_with_openings(mesh: &mut TriangleMesh, rings: &[Vec<u32>]) {
    let last_row = rings.len() - 1;
    for row in 0..last_row {
        let mirrored = last_row - 1 - row;
        let open_row = |r: usize| (HANDLE_ROWS.0..HANDLE_ROWS.1).contains(&r);
        let beside_handle = open_row(row) || open_row(mirrored);
        for s in 0..rings[row].len() {
            if beside_handle && (HANDLE_COLUMNS.0..HANDLE_COLUMNS.1).contains(&s) {
                continue;
            }
            let next = (s + 1) % rings[row].len();
            let (low, up) = (&rings[row], &rings[row + 1]);
            push_quad(mesh, [low[s], low[next], up[next], up[s]]);
        }
    }
}

/// Boundary of an opening as (column, row) steps from its lower left corner, counter-clockwise seen
/// from outside.
fn opening_border() -> Vec<(usize, usize)> {
    let columns = HANDLE_COLUMNS.1 - HANDLE_COLUMNS.0;
    let rows = HANDLE_ROWS.1 - HANDLE_ROWS.0;
    let bottom = (0..columns).map(|c| (c, 0));
    let right = (0..rows).map(|r| (columns, r));
    let top = (0..columns).map(|c| (columns - c, rows));
    let left = (0..rows).map(|r| (0, rows - r));
    bottom.chain(right).chain(top).chain(left).collect()
}

/// A tube from the upper to the lower opening: straight out, half a circle, straight back.
fn handle(mesh: &mut TriangleMesh, rings: &[Vec<u32>]) {
    let last_row = rings.len() - 1;
    let border = opening_border();
    let at_body = |row: &dyn Fn(usize) -> usize| -> Vec<u32> {
        let vertex = |&(c, r): &(usize, usize)| rings[row(r)][HANDLE_COLUMNS.0 + c];
        border.iter().map(vertex).collect()
    };
    let start = at_body(&|r| HANDLE_ROWS.0 + r);
    let end = at_body(&|r| last_row - HANDLE_ROWS.0 - r);

    let corner = |i: usize| mesh.vertices[start[i] as usize];
    let bend_radius = 0.5 * (corner(0).z + corner(border.len() / 2).z);
    let opening_half = (
        corner(0).y.abs(),
        0.5 * (corner(border.len() / 2).z - corner(0).z),
    );

    let stations = handle_stations(bend_radius);
    let count = stations.len();
    let mut previous = start;
    for (index, (center, normal)) in stations.into_iter().enumerate() {
        // Transition from the square opening to the round middle within four rings.
        let from_end = (index + 1).min(count - index);
        let round = (from_end as f64 / 4.0).min(1.0);
        let mix = |square: f64, middle: f64| square + (middle - square) * round;
        let half_width = mix(opening_half.0, HANDLE_HALF_M.0);
        let half_thickness = mix(opening_half.1, HANDLE_HALF_M.1);
        let next: Vec<u32> = border
            .iter()
            .map(|&step| {
                let (p, q) = rounded(step, round);
                let offset = DVec3::Y * (p * half_width) + normal * (q * half_thickness);
                push(mesh, center + offset)
            })
            .collect();
        band(mesh, &previous, &next);
        previous = next;
    }
    band(mesh, &previous, &end);
}

/// Centres and normals (in the plane y = 0, initially +z) of the rings of the tube.
fn handle_stations(bend_radius: f64) -> Vec<(DVec3, DVec3)> {
    let mut stations = Vec::new();
    let straight_x = 0.5 * (OUTER_RADIUS_M + HANDLE_BEND_X_M);
    stations.push((DVec3::new(straight_x, 0.0, bend_radius), DVec3::Z));
    for cut in 0..=HANDLE_CUTS {
        let (sin, cos) = (PI * f64::from(cut) / f64::from(HANDLE_CUTS)).sin_cos();
        let normal = DVec3::new(sin, 0.0, cos);
        stations.push((DVec3::X * HANDLE_BEND_X_M + normal * bend_radius, normal));
    }
    stations.push((DVec3::new(straight_x, 0.0, -bend_radius), DVec3::NEG_Z));
    stations
}

/// Position of a boundary step in [−1, 1]², from the square (`round` = 0) to the circle (1).
fn rounded((column, row): (usize, usize), round: f64) -> (f64, f64) {
    let columns = (HANDLE_COLUMNS.1 - HANDLE_COLUMNS.0) as f64;
    let rows = (HANDLE_ROWS.1 - HANDLE_ROWS.0) as f64;
    let p = 2.0 * column as f64 / columns - 1.0;
    let q = 2.0 * row as f64 / rows - 1.0;
    let bend = |along: f64, across: f64| along * (1.0 - 0.5 * round * across * across).sqrt();
    (bend(p, q), bend(q, p))
}
