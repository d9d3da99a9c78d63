//! Closest points, inside tests and ray casts on a triangle mesh.

use glam::DVec3;

use super::aabb::Aabb;
use super::bvh::Bvh;
use super::mesh::TriangleMesh;

/// Ray directions of the inside test, not aligned with common mesh directions.
const PARITY_DIRECTIONS: [DVec3; 3] = [
    DVec3::new(0.546_231, 0.337_918, 0.766_469),
    DVec3::new(-0.712_387, 0.558_113, -0.425_519),
    DVec3::new(0.227_741, -0.876_229, -0.424_673),
];

/// Padding of boxes in ray tests, m: more than the rounding of coordinates and parameters.
const BOX_PAD_M: f64 = 1e-12;

/// A triangle mesh prepared for queries. Triangle indices are those of the mesh; barycentric
/// coordinates belong to the corners in order and sum to 1.
#[derive(Clone, Debug, Default)]
pub struct MeshQuery {
    bvh: Bvh,
    /// Corners of the triangles in leaf order.
    corners: Vec<[DVec3; 3]>,
}

/// Point of a mesh closest to a query point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosestPoint {
    /// Point on the mesh, m.
    pub point_m: DVec3,
    /// Distance to it, m.
    pub distance_m: f64,
    /// Index of its triangle.
    pub triangle: u32,
    /// Barycentric coordinates in the triangle.
    pub barycentric: [f64; 3],
}

/// Intersection of a ray with a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// The hit lies at `origin + t · direction`.
    pub t: f64,
    /// Index of the triangle.
    pub triangle: u32,
    /// Barycentric coordinates in the triangle.
    pub barycentric: [f64; 3],
    /// Whether the ray hits the outer side, from which the corners run counter-clockwise.
    pub front: bool,
}

impl MeshQuery {
    /// Prepares a mesh for queries.
    pub fn new(mesh: &TriangleMesh) -> Self {
        let bvh = Bvh::build(&mesh.triangle_bounds());
        let in_order = bvh.leaf_order().iter();
        let corners = in_order
            .map(|&t| mesh.corners(mesh.triangles[t as usize]))
            .collect();
        Self { bvh, corners }
    }

    /// Bounding box of the mesh.
    pub fn bounds(&self) -> Aabb {
        self.bvh.bounds()
    }

    /// Closest point of the mesh; `None` if the mesh is empty.
    pub fn closest_point(&self, point: DVec3) -> Option<ClosestPoint> {
        let mut nearest = None;
        self.bvh.minimise(
            f64::INFINITY,
            |bounds| bounds.distance_squared(point),
            |slot, best| {
                let (weights, on_triangle) = closest_on_triangle(point, &self.corners[slot]);
                let squared = on_triangle.distance_squared(point);
                if squared >= best {
                    return best;
                }
                nearest = Some((slot, weights, on_triangle, squared));
                squared
            },
        );
        nearest.map(|(slot, barycentric, point_m, squared)| ClosestPoint {
            point_m,
            distance_m: squared.sqrt(),
            triangle: self.bvh.leaf_order()[slot],
            barycentric,
        })
    }

    /// First intersection with 0 ≤ t < `t_max`, from either side. Watertight between neighbouring
    /// triangles.
    pub fn ray_cast(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<RayHit> {
        let ray = Ray::new(origin, direction);
        let mut nearest = None;
        self.bvh.minimise(
            t_max,
            |bounds| ray.entry(bounds),
            |slot, best| match ray.hit(&self.corners[slot]) {
                Some(hit) if hit.t < best => {
                    nearest = Some((slot, hit));
                    hit.t
                }
                _ => best,
            },
        );
        nearest.map(|(slot, hit)| RayHit {
            t: hit.t,
            triangle: self.bvh.leaf_order()[slot],
            barycentric: hit.barycentric,
            front: hit.front,
        })
    }

    /// Whether the point lies inside a closed mesh: the majority of three rays intersects an odd
    /// number of triangles.
    pub fn contains(&self, point: DVec3) -> bool {
        if !self.bvh.bounds().contains(point) {
            return false;
        }
        let odd = |&direction: &DVec3| self.crossings(point, direction) % 2 == 1;
        PARITY_DIRECTIONS.iter().filter(|d| odd(d)).count() >= 2
    }

    /// Number of triangles that a ray intersects.
    fn crossings(&self, origin: DVec3, direction: DVec3) -> usize {
        let ray = Ray::new(origin, direction);
        let mut count = 0;
        self.bvh.search(
            |bounds| ray.entry(bounds) < f64::INFINITY,
            |slot| {
                count += usize::from(ray.hit(&self.corners[slot]).is_some());
                false
            },
        );
        count
    }
}

/// Barycentric coordinates and position of the point of a triangle closest to `p` (Ericson,
/// *Real-Time Collision Detection*, 2005, §5.1.5).
pub(super) fn closest_on_triangle(p: DVec3, &[a, b, c]: &[DVec3; 3]) -> ([f64; 3], DVec3) {
    let weights = closest_weights(p, a, b, c);
    let [wa, wb, wc] = weights;
    (weights, a * wa + b * wb + c * wc)
}

fn closest_weights(p: DVec3, a: DVec3, b: DVec3, c: DVec3) -> [f64; 3] {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(p - a), ac.dot(p - a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let (d3, d4) = (ab.dot(p - b), ac.dot(p - b));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return [1.0 - v, v, 0.0];
    }
    let (d5, d6) = (ab.dot(p - c), ac.dot(p - c));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return [1.0 - w, 0.0, w];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - w, w];
    }
    let sum = va + vb + vc;
    [va / sum, vb / sum, vc / sum]
}

/// A ray with the values that its box and triangle tests share.
struct Ray {
    origin: DVec3,
    inverse: DVec3,
    /// Axes permuted so that the direction is largest along the last one.
    axes: [usize; 3],
    /// Shear that maps the direction to the unit vector of the last axis.
    shear: DVec3,
}

#[derive(Clone, Copy)]
struct TriangleHit {
    t: f64,
    barycentric: [f64; 3],
    front: bool,
}

impl Ray {
    fn new(origin: DVec3, direction: DVec3) -> Self {
        // A finite inverse avoids 0 · ∞ in the box test; the padding includes the boundary.
        let inverse = |d: f64| {
            if d.abs() < 1e-300 {
                1e300f64.copysign(d)
            } else {
                1.0 / d
            }
        };
        let z = direction.abs().max_position();
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if direction[z] < 0.0 {
            (x, y) = (y, x);
        }
        let d = direction[z];
        Self {
            origin,
            inverse: DVec3::from_array(direction.to_array().map(inverse)),
            axes: [x, y, z],
            shear: DVec3::new(direction[x] / d, direction[y] / d, 1.0 / d),
        }
    }

    /// Parameter at which the ray enters the box, at least 0; infinite for a miss.
    #[inline]
    fn entry(&self, bounds: &Aabb) -> f64 {
        let (a, b) = (
            (bounds.min - self.origin - BOX_PAD_M) * self.inverse,
            (bounds.max - self.origin + BOX_PAD_M) * self.inverse,
        );
        let (near, far) = (a.min(b), a.max(b));
        let enter = near.x.max(near.y).max(near.z).max(0.0);
        let exit = far.x.min(far.y).min(far.z);
        if enter <= exit { enter } else { f64::INFINITY }
    }

    /// Intersection with a triangle at t ≥ 0 (Woop, Benthin and Wald, *Watertight Ray/Triangle
    /// Intersection*, JCGT 2013): in coordinates sheared along the ray, neighbours evaluate their
    /// common side identically.
    #[inline]
    fn hit(&self, corners: &[DVec3; 3]) -> Option<TriangleHit> {
        let [x, y, z] = self.axes;
        let [a, b, c] = corners.map(|corner| {
            let p = corner - self.origin;
            DVec3::new(
                p[x] - self.shear.x * p[z],
                p[y] - self.shear.y * p[z],
                self.shear.z * p[z],
            )
        });
        let u = c.x * b.y - c.y * b.x;
        let v = a.x * c.y - a.y * c.x;
        let w = b.x * a.y - b.y * a.x;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let sum = u + v + w;
        if sum == 0.0 {
            return None;
        }
        let barycentric = [u / sum, v / sum, w / sum];
        let t = barycentric[0] * a.z + barycentric[1] * b.z + barycentric[2] * c.z;
        (t >= 0.0).then_some(TriangleHit {
            t,
            barycentric,
            front: sum > 0.0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Pose, builtin};
    use glam::DQuat;
    use rand::{Rng, RngExt as _, SeedableRng as _};

    fn random_point(scale: f64, rng: &mut impl Rng) -> DVec3 {
        let mut part = || rng.random_range(-scale..scale);
        DVec3::new(part(), part(), part())
    }

    fn rng() -> rand_pcg::Pcg64Mcg {
        rand_pcg::Pcg64Mcg::seed_from_u64(3)
    }

    /// Signed distance to a box of half size `h` centred in the origin.
    fn box_distance(p: DVec3, h: DVec3) -> f64 {
        let q = p.abs() - h;
        q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
    }

    #[test]
    fn box_distances_match_their_closed_form() {
        let pose = Pose::new(
            DQuat::from_xyzw(0.3, -0.2, 0.1, 0.8),
            DVec3::new(0.1, 0.2, -0.3),
        );
        let half = DVec3::new(0.02, 0.02, 0.03);
        let query = MeshQuery::new(&builtin("box").unwrap().transformed(&pose));
        let mut rng = rng();
        for _ in 0..500 {
            let local = random_point(0.06, &mut rng);
            let p = pose.transform_point(local);
            let expected = box_distance(local, half);
            let sign = if query.contains(p) { -1.0 } else { 1.0 };
            let found = sign * query.closest_point(p).unwrap().distance_m;
            assert!(
                (found - expected).abs() < 1e-14,
                "{local} {found} {expected}"
            );
            let nearest = query.closest_point(p).unwrap();
            assert!((nearest.barycentric.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn closest_points_match_brute_force() {
        let mesh = builtin("sphere").unwrap();
        let query = MeshQuery::new(&mesh);
        let mut rng = rng();
        for _ in 0..100 {
            let p = random_point(0.05, &mut rng);
            let found = query.closest_point(p).unwrap();
            let all = mesh
                .all_corners()
                .map(|c| closest_on_triangle(p, &c).1.distance(p));
            assert_eq!(found.distance_m, all.fold(f64::INFINITY, f64::min));
            let [a, b, c] = mesh.corners(mesh.triangles[found.triangle as usize]);
            let [wa, wb, wc] = found.barycentric;
            assert!((a * wa + b * wb + c * wc).distance(found.point_m) < 1e-16);
        }
    }

    #[test]
    fn ray_casts_match_brute_force() {
        let mesh = builtin("sphere").unwrap();
        let query = MeshQuery::new(&mesh);
        let mut rng = rng();
        for _ in 0..300 {
            let origin = random_point(0.06, &mut rng);
            let direction = random_point(1.0, &mut rng);
            let ray = Ray::new(origin, direction);
            let all = mesh.all_corners().filter_map(|c| ray.hit(&c)).map(|h| h.t);
            let expected = all.fold(f64::INFINITY, f64::min);
            let found = query.ray_cast(origin, direction, f64::INFINITY);
            assert_eq!(found.map_or(f64::INFINITY, |h| h.t), expected);
            let near = query.ray_cast(origin, direction, 0.05);
            assert_eq!(near.is_some(), expected < 0.05);
            let Some(hit) = found else { continue };
            let [a, b, c] = mesh.corners(mesh.triangles[hit.triangle as usize]);
            let [wa, wb, wc] = hit.barycentric;
            let point = origin + direction * hit.t;
            assert!((a * wa + b * wb + c * wc).distance(point) < 1e-15);
            let towards = direction.dot((b - a).cross(c - a)) < 0.0;
            assert_eq!(hit.front, towards);
            assert_eq!(hit.front, !query.contains(origin));
        }
    }

    #[test]
    fn axis_rays_through_vertices_and_sides_hit() {
        let query = MeshQuery::new(&builtin("box").unwrap());
        // The lattice of the box: vertices, sides and diagonals of its top face.
        for i in 0..=32 {
            for j in 0..=32 {
                let at = |k: i32| -0.02 + 0.04 * f64::from(k) / 32.0;
                let origin = DVec3::new(at(i), at(j), 0.1);
                let hit = query.ray_cast(origin, DVec3::NEG_Z, 1.0).unwrap();
                assert!((hit.t - 0.07).abs() < 1e-15, "{i} {j} {}", hit.t);
            }
        }
        assert!(query.ray_cast(DVec3::Z, DVec3::NEG_Z, 0.9).is_none());
        assert!(query.ray_cast(DVec3::Z, DVec3::Z, f64::INFINITY).is_none());
    }

    #[test]
    fn empty_mesh_has_no_hits() {
        let query = MeshQuery::new(&TriangleMesh::default());
        assert!(query.closest_point(DVec3::ZERO).is_none());
        assert!(query.ray_cast(DVec3::ZERO, DVec3::X, 1.0).is_none());
        assert!(!query.contains(DVec3::ZERO));
    }
}
