//! Convex hull by quickhull (Barber, Dobkin and Huhdanpaa, ACM TOMS 1996) with exact orientation
//! predicates.
//!
//! A face is visible from a point only if the point is strictly in front of it, so coplanar,
//! collinear and duplicate points need no tolerance.

use std::collections::BTreeMap;

use glam::DVec3;
use robust::{Coord3D, orient3d};

use super::mesh::TriangleMesh;
use gripcast_base::error::{Error, Result};

/// A face, its neighbours across the side that starts at each corner, and the points in front of it
/// that are not assigned to another face.
struct Face {
    corners: [u32; 3],
    neighbours: [usize; 3],
    outside: Vec<u32>,
    alive: bool,
}

struct Hull<'a> {
    points: &'a [DVec3],
    faces: Vec<Face>,
}

/// A side between a face visible from a point and one that is not.
struct HorizonSide {
    from: u32,
    to: u32,
    /// The invisible face.
    beyond: usize,
}

/// Computes the convex hull of points (m): a closed mesh, counter-clockwise seen from outside.
/// Planar facets are triangulated, possibly into slivers; points within facets or sides may be left
/// out.
///
/// # Errors
/// `Input` if the points do not span a volume or are not finite.
pub fn convex_hull(points: &[DVec3]) -> Result<TriangleMesh> {
    if let Some(bad) = points.iter().find(|p| !p.is_finite()) {
        let found = bad.to_array();
        return Err(Error::input(format!(
            "a convex hull needs finite points, found {found:?}"
        )));
    }
    let simplex = first_simplex(points).ok_or_else(|| {
        Error::input(format!(
            "a convex hull needs points that span a volume, found {} coplanar points",
            points.len()
        ))
        .remedy("give the body some thickness")
    })?;
    let mut hull = Hull::from_simplex(points, simplex);
    // New faces are appended: each face is processed once.
    let mut next = 0;
    while next < hull.faces.len() {
        if hull.faces[next].alive && !hull.faces[next].outside.is_empty() {
            hull.add_farthest(next);
        }
        next += 1;
    }
    let triangles = hull.faces.iter().filter(|f| f.alive).map(|f| f.corners);
    Ok(TriangleMesh {
        vertices: points.to_vec(),
        triangles: triangles.collect(),
    }
    .without_unused_vertices())
}

/// Four distant points that span a volume; `None` if all points are coplanar.
fn first_simplex(points: &[DVec3]) -> Option<[u32; 4]> {
    let farthest = |measure: &dyn Fn(DVec3) -> f64| -> Option<u32> {
        let measured = points.iter().map(|&p| measure(p)).enumerate();
        let best = measured.max_by(|x, y| x.1.total_cmp(&y.1).then(y.0.cmp(&x.0)));
        best.filter(|(_, value)| *value > 0.0)
            .map(|(index, _)| index as u32)
    };
    let at = |index: u32| points[index as usize];
    let a = farthest(&|p| 1.0 + (p - points[0]).length_squared())?;
    let b = farthest(&|p| (p - at(a)).length_squared())?;
    let c = farthest(&|p| (p - at(a)).cross(at(b) - at(a)).length_squared())?;
    let d = farthest(&|p| orientation(at(a), at(b), at(c), p).abs())?;
    // The first face must face away from the fourth point; the others follow from it.
    if orientation(at(a), at(b), at(c), at(d)) > 0.0 {
        Some([a, b, c, d])
    } else {
        Some([b, a, c, d])
    }
}

impl<'a> Hull<'a> {
    fn from_simplex(points: &'a [DVec3], [a, b, c, d]: [u32; 4]) -> Self {
        let face = |corners, neighbours| Face {
            corners,
            neighbours,
            outside: Vec::new(),
            alive: true,
        };
        let mut hull = Self {
            points,
            faces: vec![
                face([a, b, c], [1, 2, 3]),
                face([b, a, d], [0, 3, 2]),
                face([c, b, d], [0, 1, 3]),
                face([a, c, d], [0, 2, 1]),
            ],
        };
        hull.assign_points((0..points.len() as u32).collect(), 0);
        hull
    }

    /// Whether the point lies strictly in front of the face.
    fn sees(&self, point: u32, face: usize) -> bool {
        let [a, b, c] = self.faces[face].corners.map(|v| self.points[v as usize]);
        orientation(a, b, c, self.points[point as usize]) < 0.0
    }

    /// Assigns each point to the first face, from index `first` on, that it sees. Points that see
    /// none lie inside.
    fn assign_points(&mut self, points: Vec<u32>, first: usize) {
        for point in points {
            if let Some(face) = (first..self.faces.len()).find(|&f| self.sees(point, f)) {
                self.faces[face].outside.push(point);
            }
        }
    }

    /// Extends the hull by the farthest point in front of a face.
    fn add_farthest(&mut self, face: usize) {
        let [a, b, c] = self.faces[face].corners.map(|v| self.points[v as usize]);
        let normal = (b - a).cross(c - a);
        let height = |&p: &u32| (self.points[p as usize] - a).dot(normal);
        let outside = self.faces[face].outside.iter().copied();
        let farthest = outside.max_by(|x, y| height(x).total_cmp(&height(y)).then(y.cmp(x)));
        let Some(apex) = farthest else { return };

        let (visible, horizon) = self.horizon(apex, face);
        let mut orphans = Vec::new();
        for face in visible {
            self.faces[face].alive = false;
            orphans.append(&mut self.faces[face].outside);
        }
        let first = self.faces.len();
        let new_faces = |vertex: fn(&HorizonSide) -> u32| -> BTreeMap<u32, usize> {
            horizon.iter().map(vertex).zip(first..).collect()
        };
        let (starting_at, ending_at) = (new_faces(|side| side.from), new_faces(|side| side.to));
        for (i, side) in horizon.iter().enumerate() {
            let beyond = &mut self.faces[side.beyond];
            let back = beyond.corners.iter().position(|&v| v == side.to);
            beyond.neighbours[back.unwrap_or(0)] = first + i;
            self.faces.push(Face {
                corners: [side.from, side.to, apex],
                neighbours: [side.beyond, starting_at[&side.to], ending_at[&side.from]],
                outside: Vec::new(),
                alive: true,
            });
        }
        orphans.retain(|&p| p != apex);
        self.assign_points(orphans, first);
    }

    /// The faces visible from the point, found from the visible face `start`, and their horizon.
    fn horizon(&self, point: u32, start: usize) -> (Vec<usize>, Vec<HorizonSide>) {
        let mut visibility = BTreeMap::from([(start, true)]);
        let (mut visible, mut horizon) = (vec![start], Vec::new());
        let mut open = vec![start];
        while let Some(face) = open.pop() {
            let Face {
                corners,
                neighbours,
                ..
            } = &self.faces[face];
            for k in 0..3 {
                let beyond = neighbours[k];
                let is_new = !visibility.contains_key(&beyond);
                let is_visible = *visibility
                    .entry(beyond)
                    .or_insert_with(|| self.sees(point, beyond));
                if !is_visible {
                    horizon.push(HorizonSide {
                        from: corners[k],
                        to: corners[(k + 1) % 3],
                        beyond,
                    });
                } else if is_new {
                    visible.push(beyond);
                    open.push(beyond);
                }
            }
        }
        (visible, horizon)
    }
}

/// Orientation of four points, with exact sign: positive if `d` lies behind the plane through a, b
/// and c, which are counter-clockwise seen from its front.
pub(super) fn orientation(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    let [a, b, c, d] = [a, b, c, d].map(|v| Coord3D {
        x: v.x,
        y: v.y,
        z: v.z,
    });
    orient3d(a, b, c, d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BUILTIN_NAMES, MassProperties, Pose, builtin};
    use glam::DQuat;
    use proptest::prelude::*;

    /// Checks that the hull is closed, convex and contains all points.
    fn check(points: &[DVec3]) -> TriangleMesh {
        let hull = convex_hull(points).unwrap();
        assert!(hull.edges().is_closed());
        let euler = hull.vertices.len() + hull.triangles.len();
        assert_eq!(euler, hull.edges().len() + 2);
        for [a, b, c] in hull.all_corners() {
            assert!(points.iter().all(|&p| orientation(a, b, c, p) >= 0.0));
        }
        hull
    }

    fn volume(mesh: &TriangleMesh) -> f64 {
        MassProperties::from_mesh(mesh).unwrap().volume_m3
    }

    #[test]
    fn hull_of_a_lattice_is_a_box() {
        let mut points = Vec::new();
        for i in 0..216 {
            let lattice = [i % 6, i / 6 % 6, i / 36].map(f64::from);
            points.push(DVec3::from_array(lattice) * 0.1);
            points.push(DVec3::from_array(lattice) * 0.1);
        }
        let hull = check(&points);
        assert!((volume(&hull) - 0.125).abs() < 1e-15);
    }

    #[test]
    fn convex_shapes_are_their_own_hull() {
        for name in BUILTIN_NAMES {
            let mesh = builtin(name).unwrap();
            for rotation in [DQuat::IDENTITY, DQuat::from_xyzw(0.1, 0.7, -0.3, 0.64)] {
                let rotated = mesh.transformed(&Pose::from_rotation(rotation));
                let hull = check(&rotated.vertices);
                let ratio = volume(&hull) / volume(&mesh);
                match *name {
                    "mug" => assert!(ratio > 2.0, "{ratio}"),
                    "bottle" => assert!((1.05..1.2).contains(&ratio), "{ratio}"),
                    "jack" | "star" | "dented" | "ring" | "saddle" | "lump" => {
                        assert!(ratio > 1.05, "{name}: {ratio}");
                    }
                    _ => assert!((ratio - 1.0).abs() < 1e-12, "{name}: {ratio}"),
                }
            }
        }
    }

    #[test]
    fn coplanar_points_are_rejected() {
        let flat: Vec<DVec3> = (0..20)
            .map(|i| DVec3::new(f64::from(i % 5), f64::from(i / 5), 1.0))
            .collect();
        for points in [&flat[..], &flat[..5], &flat[..1], &[]] {
            let text = convex_hull(points).unwrap_err().to_string();
            assert!(text.contains("span a volume"), "{text}");
        }
        assert!(convex_hull(&[DVec3::NAN; 4]).is_err());
    }

    /// Six times the volume of a greedily chosen tetrahedron of four points.
    fn largest_volume(points: &[DVec3]) -> f64 {
        let from = |p: &DVec3| *p - points[0];
        let farthest = |measure: &dyn Fn(DVec3) -> f64| {
            let by = |a: &DVec3, b: &DVec3| measure(*a).total_cmp(&measure(*b));
            points.iter().map(from).max_by(by).unwrap()
        };
        let a = farthest(&DVec3::length);
        let b = farthest(&|p| p.cross(a).length());
        let c = farthest(&|p| p.dot(a.cross(b)).abs());
        c.dot(a.cross(b)).abs()
    }

    proptest! {
        #[test]
        fn hulls_of_coarse_points_are_convex(
            points in prop::collection::vec([-3..=3i32, -3..=3, -3..=3], 4..60), jitter in 0..2
        ) {
            // Many coplanar and duplicate points, exactly or up to rounding.
            let points: Vec<DVec3> = points
                .into_iter()
                .map(|p| DVec3::from_array(p.map(f64::from)) * 0.1)
                .map(|p| if jitter == 1 { DQuat::from_rotation_x(0.3) * p } else { p })
                .collect();
            // Coordinates are multiples of 0.1: four points that are not coplanar are far from it.
            prop_assert!(convex_hull(&points).is_ok() || largest_volume(&points) < 1e-9);
            if convex_hull(&points).is_ok() {
                check(&points);
            }
        }
    }
}
