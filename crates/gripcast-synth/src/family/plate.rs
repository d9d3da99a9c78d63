//! Plates: bodies between a lower and an upper surface over an outline with holes.

use glam::{DVec2, DVec3};
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation as _};

use super::shape::{relative_height, snapped_to_grid};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::TriangleMesh;

/// Minimum distance of lattice points from the rim, in edge lengths.
const CLEARANCE: f64 = 0.65;
/// Maximum relative height of a degenerate triangle.
const DEGENERATE: f64 = 1e-3;

/// A plate.
pub(super) struct Plate<'a> {
    /// Points along the rim, m.
    pub(super) outline: Vec<DVec2>,
    /// Points along the rims of holes, m.
    pub(super) holes: Vec<Vec<DVec2>>,
    /// Heights of the lower and the upper surface (m) at a point and its distance (m) from the rim.
    pub(super) heights: &'a dyn Fn(DVec2, f64) -> [f64; 2],
    /// Edge length, m.
    pub(super) edge: f64,
}

impl Plate<'_> {
    /// # Errors
    /// `Internal` if rims cross or touch.
    pub(super) fn mesh(&self) -> Result<TriangleMesh> {
        let mut points = Vec::new();
        let mut rims = Vec::new();
        for (k, rim) in std::iter::once(&self.outline)
            .chain(&self.holes)
            .enumerate()
        {
            let first = points.len();
            points.extend(
                rim.iter()
                    .map(|p| snapped_to_grid(p.extend(0.0)).truncate()),
            );
            // All rims have the body on their left.
            if (signed_area(rim) > 0.0) != (k == 0) {
                points[first..].reverse();
            }
            rims.push(first..points.len());
        }
        let sides: Vec<[usize; 2]> = rims
            .iter()
            .flat_map(|rim| {
                rim.clone().map(|k| {
                    let next = if k + 1 == rim.end { rim.start } else { k + 1 };
                    [k, next]
                })
            })
            .collect();
        let on_rim = points.len();
        self.add_lattice(&mut points, &sides);
        let faces = triangulated(&points, &sides)?;
        Ok(self.solid(&points, &sides, on_rim, &faces))
    }

    /// Adds the points of a triangular lattice inside.
    fn add_lattice(&self, points: &mut Vec<DVec2>, sides: &[[usize; 2]]) {
        let rim = points.clone();
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for p in &rim {
            (low, high) = (low.min(*p), high.max(*p));
        }
        let step = DVec2::new(self.edge, self.edge * 0.866);
        let counts = ((high - low) / step).ceil();
        for row in 0..=counts.y as usize {
            for column in 0..=counts.x as usize {
                let shift = 0.5 * (row % 2) as f64;
                let p = low + step * DVec2::new(column as f64 + shift, row as f64 + 0.37);
                if inside(p, &rim, sides) && rim_distance_m(p, &rim, sides) > CLEARANCE * self.edge
                {
                    points.push(snapped_to_grid(p.extend(0.0)).truncate());
                }
            }
        }
    }

    fn solid(
        &self,
        points: &[DVec2],
        sides: &[[usize; 2]],
        on_rim: usize,
        faces: &[[usize; 3]],
    ) -> TriangleMesh {
        let rim = &points[..on_rim];
        let heights: Vec<[f64; 2]> = points
            .iter()
            .enumerate()
            .map(|(k, &p)| {
                let depth = if k < on_rim {
                    0.0
                } else {
                    rim_distance_m(p, rim, sides)
                };
                (self.heights)(p, depth)
            })
            .collect();
        let count = points.len() as u32;
        let mut mesh = TriangleMesh::default();
        for layer in [0, 1] {
            let level = points.iter().zip(&heights);
            mesh.vertices.extend(level.map(|(p, h)| p.extend(h[layer])));
        }
        for &face in faces {
            let [a, b, c] = face.map(|v| v as u32);
            mesh.triangles.push([c, b, a]);
            mesh.triangles.push([a + count, b + count, c + count]);
        }
        let max_thickness =
            (0..on_rim).fold(0.0, |t, k| f64::max(t, heights[k][1] - heights[k][0]));
        let rows = (max_thickness / self.edge - 0.3).ceil().max(1.0) as u32;
        let between = 2 * count;
        for row in 1..rows {
            let fraction = f64::from(row) / f64::from(rows);
            let level = rim.iter().zip(&heights);
            mesh.vertices
                .extend(level.map(|(p, h)| p.extend(h[0] + fraction * (h[1] - h[0]))));
        }
        let vertex = |k: usize, row: u32| match row {
            0 => k as u32,
            r if r == rows => k as u32 + count,
            r => between + (r - 1) * on_rim as u32 + k as u32,
        };
        for &[a, b] in sides {
            for row in 0..rows {
                let [p, q, r, s] =
                    [(a, row), (b, row), (b, row + 1), (a, row + 1)].map(|(k, row)| vertex(k, row));
                mesh.triangles.push([p, q, r]);
                mesh.triangles.push([p, r, s]);
            }
        }
        mesh
    }
}

/// Triangulates the area inside an odd number of rims, counter-clockwise.
fn triangulated(points: &[DVec2], sides: &[[usize; 2]]) -> Result<Vec<[usize; 3]>> {
    let crossing = || Error::internal("the rims of a plate cross or touch");
    let mut net = ConstrainedDelaunayTriangulation::<Point2<f64>>::new();
    let mut handles = Vec::with_capacity(points.len());
    for p in points {
        let handle = net
            .insert(Point2::new(p.x, p.y))
            .map_err(|e| crossing().because(e))?;
        if handle.index() != handles.len() {
            return Err(crossing());
        }
        handles.push(handle);
    }
    for &[a, b] in sides {
        if !net.can_add_constraint(handles[a], handles[b]) {
            return Err(crossing());
        }
        net.add_constraint(handles[a], handles[b]);
    }
    let rim = &points[..sides.len()];
    // Three points of a straight side can form a triangle without area outside of the body.
    let on_side = |face: &[usize; 3]| {
        let corners = face.map(|v| points[v].extend(0.0));
        face.iter().all(|&v| v < rim.len()) && relative_height(corners) < DEGENERATE
    };
    Ok(net
        .inner_faces()
        .map(|face| face.vertices().map(|v| v.index()))
        .filter(|face| {
            if on_side(face) {
                return false;
            }
            let middle = face.iter().map(|&v| points[v]).sum::<DVec2>() / 3.0;
            inside(middle, rim, sides)
        })
        .collect())
}

fn signed_area(rim: &[DVec2]) -> f64 {
    let next = rim.iter().cycle().skip(1);
    rim.iter()
        .zip(next)
        .map(|(a, b)| 0.5 * a.perp_dot(*b))
        .sum()
}

/// Whether a point lies inside an odd number of rims.
fn inside(p: DVec2, points: &[DVec2], sides: &[[usize; 2]]) -> bool {
    sides.iter().fold(false, |within, &[a, b]| {
        let (a, b) = (points[a], points[b]);
        let crosses =
            (a.y > p.y) != (b.y > p.y) && p.x < a.x + (b.x - a.x) * (p.y - a.y) / (b.y - a.y);
        within != crosses
    })
}

/// Distance to the nearest rim, m.
fn rim_distance_m(p: DVec2, points: &[DVec2], sides: &[[usize; 2]]) -> f64 {
    let squared = sides.iter().fold(f64::INFINITY, |min, &[a, b]| {
        let (a, along) = (points[a], points[b] - points[a]);
        let fraction = ((p - a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        min.min(p.distance_squared(a + fraction * along))
    });
    squared.sqrt()
}

/// Bends a point upwards, towards +z, about a line along y: beyond `start` (m) in x, the centre
/// line follows an arc of the given radius (m) and angle (rad, negative is downwards) and then
/// continues straight.
pub(super) fn bent(p: DVec3, start: f64, radius: f64, angle: f64) -> DVec3 {
    let beyond = p.x - start;
    if beyond <= 0.0 {
        return p;
    }
    let side = angle.signum();
    let bend = (beyond / radius).min(angle.abs());
    let (sin, cos) = bend.sin_cos();
    let arm = radius - side * p.z;
    let rest = beyond - bend * radius;
    DVec3::new(
        start + arm * sin + rest * cos,
        p.y,
        side * (radius - arm * cos + rest * sin),
    )
}

#[cfg(test)]
mod tests {
    use super::super::outline::{circle, closed_line, sharp};
    use super::*;
    use gripcast_geometry::MassProperties;
    use std::f64::consts::PI;

    fn flat(
        outline: Vec<DVec2>,
        holes: Vec<Vec<DVec2>>,
        thickness: f64,
        edge: f64,
    ) -> Result<TriangleMesh> {
        Plate {
            outline,
            holes,
            heights: &|_, _| [-0.5 * thickness, 0.5 * thickness],
            edge,
        }
        .mesh()
    }

    #[test]
    fn plate_with_a_hole_has_its_volume() {
        let knots = [(-0.02, -0.01), (0.02, -0.01), (0.02, 0.01), (-0.02, 0.01)];
        let outline = closed_line(&knots.map(|(x, y)| sharp(x, y)), 0.0025);
        let hole = circle(DVec2::new(0.008, 0.0), 0.005, 0.0025);
        let mesh = flat(outline, vec![hole], 0.006, 0.0025).unwrap();
        assert!(mesh.edges().is_closed());
        let volume = MassProperties::from_mesh(&mesh).unwrap().volume_m3;
        let expected = (8e-4 - PI * 25e-6) * 0.006;
        assert!((volume / expected - 1.0).abs() < 0.02, "{volume}");
    }

    #[test]
    fn crossing_rims_are_refused() {
        let outline = circle(DVec2::ZERO, 0.01, 0.002);
        let hole = circle(DVec2::new(0.008, 0.0), 0.005, 0.002);
        assert!(flat(outline, vec![hole], 0.003, 0.002).is_err());
    }

    #[test]
    fn bending_keeps_the_length_of_the_centre_line() {
        let end = bent(DVec3::new(0.03, 0.0, 0.0), 0.01, 0.005, 0.5 * PI);
        let arc = 0.005 * 0.5 * PI;
        let expected = DVec3::new(0.015, 0.0, 0.005 + 0.02 - arc);
        assert!(end.distance(expected) < 1e-12, "{end}");
        let down = bent(DVec3::new(0.03, 0.0, 0.001), 0.01, 0.005, -0.5 * PI);
        assert!((down.x - 0.016).abs() < 1e-12 && down.z < 0.0, "{down}");
    }
}
