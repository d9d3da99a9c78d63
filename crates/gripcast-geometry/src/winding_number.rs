//! Generalised winding number of a surface that may be open.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use super::aabb::Aabb;
use super::bvh::Bvh;

/// Distance, in radii of a group of triangles, from which its dipole stands for it.
const FAR: f64 = 3.0;

/// The generalised winding number of a surface (Jacobson et al., *Robust inside-outside segmentation
/// using generalized winding numbers*, SIGGRAPH 2013): its solid angle over 4π, 1 inside a closed
/// surface, 0 outside, between them near a hole, 2 where two bodies overlap. Distant groups of
/// triangles count by their dipole and quadrupole (Barill et al., *Fast winding numbers for soups and
/// clouds*, SIGGRAPH 2018, second order), with an error of about 0.01.
#[derive(Clone, Debug)]
pub(super) struct WindingNumber {
    bvh: Bvh,
    /// Corners of the triangles in leaf order, m.
    corners: Vec<[DVec3; 3]>,
    /// Of each node of the hierarchy.
    groups: Vec<Group>,
}

/// A group of triangles.
#[derive(Clone, Copy, Debug)]
struct Group {
    /// Mean position weighted by area, m.
    center: DVec3,
    /// Sum of the normals weighted by area, m².
    normal: DVec3,
    /// Sum of the products n xᵀ of the normals weighted by area and the positions from the centre,
    /// m³.
    spread: DMat3,
    area: f64,
}

impl WindingNumber {
    /// Prepares a surface, given by the corners of its triangles (m).
    pub(super) fn new(triangles: &[[DVec3; 3]]) -> Self {
        let boxes: Vec<Aabb> = triangles.iter().map(|t| Aabb::from_points(*t)).collect();
        let bvh = Bvh::build(&boxes);
        let in_order = bvh.leaf_order().iter();
        let corners: Vec<[DVec3; 3]> = in_order.map(|&t| triangles[t as usize]).collect();
        let groups = bvh.summaries(
            |slots| {
                let all = corners[slots].iter().map(Group::of);
                all.reduce(|a, b| a.with(&b)).unwrap_or(Group::NONE)
            },
            Group::with,
        );
        Self {
            bvh,
            corners,
            groups,
        }
    }

    /// The winding number of a point (m).
    pub(super) fn at(&self, point: DVec3) -> f64 {
        let (mut far, mut near) = (0.0, 0.0);
        self.bvh.search_nodes(
            |node, bounds| {
                let group = &self.groups[node];
                let reach = (bounds.max - group.center).max(group.center - bounds.min);
                let away = group.center - point;
                if away.length_squared() <= FAR * FAR * reach.length_squared() {
                    return true;
                }
                far += group.solid_angle(away);
                false
            },
            |slot| {
                near += solid_angle(&self.corners[slot], point);
                false
            },
        );
        (far + near) / (4.0 * PI)
    }
}

impl Group {
    const NONE: Self = Self {
        center: DVec3::ZERO,
        normal: DVec3::ZERO,
        spread: DMat3::ZERO,
        area: 0.0,
    };

    fn of([a, b, c]: &[DVec3; 3]) -> Self {
        let normal = 0.5 * (*b - *a).cross(*c - *a);
        Self {
            center: (*a + *b + *c) / 3.0,
            normal,
            spread: DMat3::ZERO,
            area: normal.length(),
        }
    }

    /// Solid angle seen from a distant point, sr; `away` points from there to the centre. Taylor
    /// expansion of r / |r|³.
    fn solid_angle(&self, away: DVec3) -> f64 {
        let squared = away.length_squared();
        let cubed = squared * squared.sqrt();
        let m = self.spread;
        let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
        (self.normal.dot(away) + trace - 3.0 * away.dot(m * away) / squared) / cubed
    }

    fn with(&self, other: &Self) -> Self {
        let area = self.area + other.area;
        let share = if area > 0.0 { other.area / area } else { 0.5 };
        let center = self.center.lerp(other.center, share);
        let moved = |group: &Self| {
            let (n, x) = (group.normal, group.center - center);
            group.spread + DMat3::from_cols(n * x.x, n * x.y, n * x.z)
        };
        Self {
            center,
            normal: self.normal + other.normal,
            spread: moved(self) + moved(other),
            area,
        }
    }
}

/// Solid angle of a triangle, sr, positive seen from behind (Van Oosterom and Strackee, IEEE Trans.
/// Biomed. Eng. 1983).
pub(super) fn solid_angle(corners: &[DVec3; 3], eye: DVec3) -> f64 {
    let [a, b, c] = corners.map(|corner| corner - eye);
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let numerator = a.dot(b.cross(c));
    let denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * numerator.atan2(denominator)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MeshQuery, TriangleMesh, builtin};
    use rand::{RngExt as _, SeedableRng as _};

    fn of(mesh: &TriangleMesh) -> WindingNumber {
        WindingNumber::new(&mesh.all_corners().collect::<Vec<_>>())
    }

    #[test]
    fn closed_surface_has_one_inside_and_zero_outside() {
        let mesh = builtin("mug").unwrap();
        let (winding, query) = (of(&mesh), MeshQuery::new(&mesh));
        let bounds = mesh.bounds();
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(5);
        for _ in 0..500 {
            let at = DVec3::from_array(
                [0, 1, 2].map(|k| rng.random_range(bounds.min[k] - 0.01..bounds.max[k] + 0.01)),
            );
            let expected = f64::from(u8::from(query.contains(at)));
            let found = winding.at(at);
            assert!((found - expected).abs() < 0.03, "{found} at {at}");
        }
    }

    #[test]
    fn half_a_sphere_gives_its_solid_angle() {
        let mut mesh = builtin("sphere").unwrap();
        let above = |t: &[u32; 3]| mesh.corners(*t).iter().all(|v| v.z > -1e-9);
        mesh.triangles = mesh.triangles.iter().copied().filter(above).collect();
        let exact: f64 = mesh
            .all_corners()
            .map(|t| solid_angle(&t, DVec3::ZERO))
            .sum();
        let found = of(&mesh).at(DVec3::ZERO);
        assert!((found - exact / (4.0 * PI)).abs() < 0.02, "{found}");
        assert!(found > 0.45 && found < 0.5, "{found}");
        assert_eq!(of(&TriangleMesh::default()).at(DVec3::ZERO), 0.0);
    }
}
