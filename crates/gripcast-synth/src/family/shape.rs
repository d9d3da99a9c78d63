//! What all families do with a mesh: choose the width of its faces, centre it, check it.

use glam::DVec3;

use gripcast_base::error::{Error, Result};
use gripcast_geometry::{MassProperties, PrepareOptions, TriangleMesh, prepare};

/// Triangles that a shape is meant to have, if its faces then are neither too small nor too wide.
const TRIANGLES: f64 = 3200.0;
/// Triangles that no shape may exceed.
pub(super) const MAX_TRIANGLES: usize = 8000;
/// Widths of faces, m: smaller ones cost time, wider ones leave contact without vertices.
pub(super) const EDGE_M: (f64, f64) = (2.2e-3, 3.8e-3);
/// Longest side of a triangle, m: the diagonal of a square of the widest faces.
pub(super) const MAX_SIDE_M: f64 = 5.6e-3;
/// Longest side of the bounding box, m.
pub(super) const SIZE_M: (f64, f64) = (0.02, 0.15);
/// Least height of a triangle over its longest side, as a part of that side.
const MIN_SLENDERNESS: f64 = 0.02;
/// Grid to which coordinates are rounded, m: the last bits of sine and cosine differ between
/// machines.
const GRID_M: f64 = 1e-7;

/// The mesh that `make` gives for a width of faces (m) that suits the surface.
pub(super) fn with_edge(make: impl Fn(f64) -> Result<TriangleMesh>) -> Result<TriangleMesh> {
    with_max_edge(EDGE_M.1, make)
}

/// As [`with_edge`], for a shape with details that need faces of at most `most` (m).
pub(super) fn with_max_edge(
    most: f64,
    make: impl Fn(f64) -> Result<TriangleMesh>,
) -> Result<TriangleMesh> {
    let rough = make(most)?;
    let edge = (rough.area() / (0.433 * TRIANGLES)).sqrt();
    if edge >= most {
        return Ok(rough);
    }
    make(edge.max(EDGE_M.0))
}

/// From 0 to 1 without a kink while `fraction` goes from 0 to 1.
pub(super) fn smoothstep(fraction: f64) -> f64 {
    let fraction = fraction.clamp(0.0, 1.0);
    fraction * fraction * (3.0 - 2.0 * fraction)
}

/// The point rounded to the grid of all coordinates.
pub(super) fn snapped_to_grid(p: DVec3) -> DVec3 {
    // Adding zero turns −0 into 0.
    (p / GRID_M).round() * GRID_M + DVec3::ZERO
}

/// Cuts sides longer than [`MAX_SIDE_M`] in two, the longest first: contact is felt at vertices.
fn split_long_sides(mesh: &mut TriangleMesh) {
    loop {
        let edges = mesh.edges();
        let length = |edge: usize| {
            let [a, b] = edges.vertices[edge].map(|v| mesh.vertices[v as usize]);
            a.distance_squared(b)
        };
        let mut long: Vec<(f64, usize)> = (0..edges.len())
            .map(|edge| (length(edge), edge))
            .filter(|(squared, _)| *squared > MAX_SIDE_M * MAX_SIDE_M)
            .collect();
        if long.is_empty() {
            return;
        }
        long.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        let mut touched = vec![false; mesh.triangles.len()];
        for (_, edge) in long {
            let beside = edges.triangles(edge);
            if beside.iter().any(|&t| touched[t as usize]) {
                continue;
            }
            let [a, b] = edges.vertices[edge];
            let ends = [a, b].map(|v| mesh.vertices[v as usize]);
            let middle = mesh.vertices.len() as u32;
            mesh.vertices
                .push(snapped_to_grid(ends[0].midpoint(ends[1])));
            for &t in beside {
                touched[t as usize] = true;
                let whole = mesh.triangles[t as usize];
                mesh.triangles[t as usize] = whole.map(|v| if v == b { middle } else { v });
                let rest = whole.map(|v| if v == a { middle } else { v });
                mesh.triangles.push(rest);
            }
        }
    }
}

/// The mesh with its bounding box centred in the origin and rounded coordinates.
///
/// # Errors
/// `Internal` if it is not closed, connected, free of slivers and self-intersections, or exceeds
/// the limits of size and triangles.
pub(super) fn finished(mut mesh: TriangleMesh) -> Result<TriangleMesh> {
    let center = mesh.bounds().center();
    for v in &mut mesh.vertices {
        *v = snapped_to_grid(*v - center);
    }
    split_long_sides(&mut mesh);
    check(&mesh)?;
    Ok(mesh)
}

fn check(mesh: &TriangleMesh) -> Result<()> {
    let fail = |what: String| Err(Error::internal(what));
    let size = mesh.bounds().extent().max_element();
    if !(SIZE_M.0..=SIZE_M.1).contains(&size) {
        return fail(format!("its size is {size} m"));
    }
    if mesh.triangles.len() > MAX_TRIANGLES {
        return fail(format!("it has {} triangles", mesh.triangles.len()));
    }
    // Open meshes are refused by `prepare`; before, the quick tests.
    let least = mesh.all_corners().map(relative_height).fold(1.0, f64::min);
    if least < MIN_SLENDERNESS {
        return fail(format!("a triangle is a sliver: {least}"));
    }
    if !is_connected(mesh) {
        return fail("it has several parts".to_string());
    }
    MassProperties::of(mesh)?;
    let prepared = prepare(mesh, &PrepareOptions::default())?;
    if prepared.mesh != *mesh || !prepared.warnings.is_empty() {
        return fail(format!("it had to be fixed: {:?}", prepared.warnings));
    }
    Ok(())
}

/// Height of a triangle over its longest side, as a part of that side.
pub(super) fn relative_height([a, b, c]: [DVec3; 3]) -> f64 {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    (b - a).cross(c - a).length() / (longest * longest).max(f64::MIN_POSITIVE)
}

/// Whether all vertices hang together.
fn is_connected(mesh: &TriangleMesh) -> bool {
    let mut lowest: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    loop {
        let mut changed = false;
        for triangle in mesh.triangles.iter().chain(mesh.triangles.iter().rev()) {
            let least = triangle.iter().map(|&v| lowest[v as usize]).min();
            for &v in triangle {
                let before = std::mem::replace(&mut lowest[v as usize], least.unwrap_or(v));
                changed |= Some(before) != least;
            }
        }
        if !changed {
            return lowest.iter().all(|&l| l == 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;

    #[test]
    fn unsound_meshes_are_refused() {
        let sound = builtin("wedge").unwrap();
        assert!(finished(sound.clone()).is_ok());
        let far = sound.transformed(&gripcast_geometry::Pose::new(
            glam::DQuat::IDENTITY,
            DVec3::X * 0.08,
        ));
        let two = sound.scaled(0.9).joined(&far.scaled(0.9));
        let mut open = sound.clone();
        open.triangles.pop();
        let mut thin = sound.clone();
        thin.vertices[1] = thin.vertices[0];
        let large = SIZE_M.1 / sound.bounds().extent().max_element();
        for (mesh, reason) in [
            (two, "several parts"),
            (open, "close"),
            (thin, "sliver"),
            (sound.scaled(1.01 * large), "its size"),
            (sound.scaled(0.1), "its size"),
        ] {
            let text = finished(mesh).unwrap_err().to_string();
            assert!(text.contains(reason), "{reason}: {text}");
        }
    }

    #[test]
    fn long_sides_are_cut_without_a_change_of_the_body() {
        let large = builtin("box").unwrap().scaled(2.0);
        let mut mesh = large.clone();
        split_long_sides(&mut mesh);
        assert!(mesh.edges().is_closed());
        let volume = |mesh| MassProperties::of(mesh).unwrap().volume_m3;
        assert!((volume(&mesh) / volume(&large) - 1.0).abs() < 1e-9);
        let sides = mesh
            .all_corners()
            .flat_map(|[a, b, c]| [a - b, b - c, c - a]);
        assert!(sides.into_iter().all(|side| side.length() <= MAX_SIDE_M));
    }

    #[test]
    fn coordinates_lie_on_the_grid() {
        let p = snapped_to_grid(DVec3::new(0.012_345_678_9, -1e-9, 0.0));
        assert_eq!(p.x, (123_457_f64) * 1e-7);
        assert!(p.y == 0.0 && p.y.is_sign_positive());
    }
}
