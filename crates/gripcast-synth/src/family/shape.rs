//! Common steps of all families: choosing the edge length, centring and checking the mesh.

use glam::DVec3;

use gripcast_base::error::{Error, Result};
use gripcast_geometry::{MassProperties, PrepareOptions, Repair, TriangleMesh, prepare};

/// Target number of triangles, as far as the limits of the edge length allow.
const TRIANGLES: f64 = 3200.0;
/// Maximum number of triangles.
pub(super) const MAX_TRIANGLES: usize = 8000;
/// Range of edge lengths, m: shorter edges cost time, longer ones leave contacts without vertices.
pub(super) const EDGE_M: (f64, f64) = (2.2e-3, 3.8e-3);
/// Maximum side of a triangle, m: the diagonal of a square of the longest edges.
pub(super) const MAX_SIDE_M: f64 = 5.6e-3;
/// Range of the longest side of the bounding box, m.
pub(super) const SIZE_M: (f64, f64) = (0.02, 0.15);
/// Minimum of [`relative_height`].
const MIN_RELATIVE_HEIGHT: f64 = 0.02;
/// Grid to which coordinates are snapped, m, since the last bits of sine and cosine differ between
/// machines.
const GRID_M: f64 = 1e-7;

/// Generates a mesh with a suitable edge length (m).
pub(super) fn with_edge(generate: impl Fn(f64) -> Result<TriangleMesh>) -> Result<TriangleMesh> {
    with_max_edge(EDGE_M.1, generate)
}

/// As [`with_edge`], with edges of at most `max` (m) for fine details.
pub(super) fn with_max_edge(
    max: f64,
    generate: impl Fn(f64) -> Result<TriangleMesh>,
) -> Result<TriangleMesh> {
    let coarse = generate(max)?;
    let edge = (coarse.area() / (0.433 * TRIANGLES)).sqrt();
    if edge >= max {
        return Ok(coarse);
    }
    generate(edge.max(EDGE_M.0))
}

/// Smooth step from 0 to 1.
pub(super) fn smoothstep(fraction: f64) -> f64 {
    let fraction = fraction.clamp(0.0, 1.0);
    fraction * fraction * (3.0 - 2.0 * fraction)
}

/// Snaps a point to the grid of all coordinates.
pub(super) fn snapped_to_grid(p: DVec3) -> DVec3 {
    // Adding zero turns −0 into 0.
    (p / GRID_M).round() * GRID_M + DVec3::ZERO
}

/// Splits sides longer than [`MAX_SIDE_M`], the longest first, since contact acts at vertices.
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
            let adjacent = edges.triangles(edge);
            if adjacent.iter().any(|&t| touched[t as usize]) {
                continue;
            }
            let [a, b] = edges.vertices[edge];
            let ends = [a, b].map(|v| mesh.vertices[v as usize]);
            let middle = mesh.vertices.len() as u32;
            mesh.vertices
                .push(snapped_to_grid(ends[0].midpoint(ends[1])));
            for &t in adjacent {
                touched[t as usize] = true;
                let whole = mesh.triangles[t as usize];
                mesh.triangles[t as usize] = whole.map(|v| if v == b { middle } else { v });
                let rest = whole.map(|v| if v == a { middle } else { v });
                mesh.triangles.push(rest);
            }
        }
    }
}

/// Centres the bounding box at the origin, snaps the coordinates and checks the mesh.
///
/// # Errors
/// `Internal` if it is open, disconnected, has slivers or self-intersections, or exceeds the limits
/// of size and triangles.
pub(super) fn finish(mut mesh: TriangleMesh) -> Result<TriangleMesh> {
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
    // Quick checks first; `prepare` refuses open meshes.
    let min = mesh.all_corners().map(relative_height).fold(1.0, f64::min);
    if min < MIN_RELATIVE_HEIGHT {
        return fail(format!("a triangle is a sliver: {min}"));
    }
    if !is_connected(mesh) {
        return fail("it has several components".to_string());
    }
    MassProperties::of_closed(mesh)?;
    let strict = PrepareOptions {
        repair: Repair::Strict,
        ..PrepareOptions::default()
    };
    let prepared = prepare(mesh, &strict)?;
    if prepared.mesh != *mesh || !prepared.warnings.is_empty() {
        return fail(format!("it needed repair: {:?}", prepared.warnings));
    }
    Ok(())
}

/// Height of a triangle over its longest side, divided by that side.
pub(super) fn relative_height([a, b, c]: [DVec3; 3]) -> f64 {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    (b - a).cross(c - a).length() / (longest * longest).max(f64::MIN_POSITIVE)
}

/// Whether the mesh is connected.
fn is_connected(mesh: &TriangleMesh) -> bool {
    let mut labels: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    loop {
        let mut changed = false;
        for triangle in mesh.triangles.iter().chain(mesh.triangles.iter().rev()) {
            let min = triangle.iter().map(|&v| labels[v as usize]).min();
            for &v in triangle {
                let before = std::mem::replace(&mut labels[v as usize], min.unwrap_or(v));
                changed |= Some(before) != min;
            }
        }
        if !changed {
            return labels.iter().all(|&l| l == 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;

    #[test]
    fn invalid_meshes_are_refused() {
        let valid = builtin("wedge").unwrap();
        assert!(finish(valid.clone()).is_ok());
        let far = valid.transformed(&gripcast_geometry::Pose::new(
            glam::DQuat::IDENTITY,
            DVec3::X * 0.08,
        ));
        let two = valid.scaled(0.9).joined(&far.scaled(0.9));
        let mut open = valid.clone();
        open.triangles.pop();
        let mut thin = valid.clone();
        thin.vertices[1] = thin.vertices[0];
        let large = SIZE_M.1 / valid.bounds().extent().max_element();
        for (mesh, reason) in [
            (two, "several components"),
            (open, "close"),
            (thin, "sliver"),
            (valid.scaled(1.01 * large), "its size"),
            (valid.scaled(0.1), "its size"),
        ] {
            let text = finish(mesh).unwrap_err().to_string();
            assert!(text.contains(reason), "{reason}: {text}");
        }
    }

    #[test]
    fn splitting_long_sides_keeps_the_volume() {
        let large = builtin("box").unwrap().scaled(2.0);
        let mut mesh = large.clone();
        split_long_sides(&mut mesh);
        assert!(mesh.edges().is_closed());
        let volume = |mesh| MassProperties::from_mesh(mesh).unwrap().volume_m3;
        assert!((volume(&mesh) / volume(&large) - 1.0).abs() < 1e-9);
        let sides = mesh
            .all_corners()
            .flat_map(|[a, b, c]| [a - b, b - c, c - a]);
        assert!(sides.into_iter().all(|side| side.length() <= MAX_SIDE_M));
    }

    #[test]
    fn coordinates_are_on_the_grid() {
        let p = snapped_to_grid(DVec3::new(0.012_345_678_9, -1e-9, 0.0));
        assert_eq!(p.x, (123_457_f64) * 1e-7);
        assert!(p.y == 0.0 && p.y.is_sign_positive());
    }
}
