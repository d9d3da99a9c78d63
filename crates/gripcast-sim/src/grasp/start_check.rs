//! Detects a gripper that starts inside the object or the ground.

use glam::DVec3;

use crate::solver::{Gel, Object};
use gripcast_geometry::TriangleMesh;

/// Describes an initial penetration of object and gel or of gel and ground, if there is one.
pub(super) fn penetration(gels: &[Gel], object: &Object, mesh: &TriangleMesh) -> Option<String> {
    for (gel, side) in gels.iter().zip(["left", "right"]) {
        let lowest = gel
            .positions()
            .iter()
            .fold(f64::INFINITY, |z, x| z.min(x.z));
        if lowest < 0.0 {
            return Some(format!(
                "the {side} gel reaches {:.1} mm below the ground",
                -1e3 * lowest
            ));
        }
        if overlaps_box(gel, object, mesh) {
            return Some(format!("the {side} gel is inside the object"));
        }
    }
    None
}

/// Whether a triangle of the object intersects the gel's box, or the box lies inside the object.
fn overlaps_box(gel: &Gel, object: &Object, mesh: &TriangleMesh) -> bool {
    let x = gel.positions();
    let rest = gel.rest();
    let corner = |pick: fn(f64, f64) -> f64, axis: usize| {
        rest.iter()
            .fold(rest[0][axis], |found, p| pick(found, p[axis]))
    };
    let low = DVec3::from_array([0, 1, 2].map(|axis| corner(f64::min, axis)));
    let high = DVec3::from_array([0, 1, 2].map(|axis| corner(f64::max, axis)));
    let Some(frame) = rest_frame(rest, x) else {
        return false;
    };
    let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
    let to_box = |vertex: DVec3| frame.to_rest(object.state().point(vertex)) - center;
    let meets = mesh
        .triangles
        .iter()
        .any(|t| triangle_meets_box(t.map(|v| to_box(mesh.vertices[v as usize])), half));
    meets || is_inside(mesh, to_box)
}

/// Pose of an undeformed gel in the world.
struct Frame {
    rotation: glam::DMat3,
    translation: DVec3,
}

impl Frame {
    fn to_rest(&self, world: DVec3) -> DVec3 {
        self.rotation.transpose() * (world - self.translation)
    }
}

fn rest_frame(rest: &[DVec3], x: &[DVec3]) -> Option<Frame> {
    let along = |axis: usize| {
        (1..rest.len()).find(|&i| {
            let d = rest[i] - rest[0];
            d[axis] != 0.0 && (d.length() - d[axis].abs()) < 1e-12
        })
    };
    let direction = |axis: usize| {
        let i = along(axis)?;
        Some((x[i] - x[0]) / (rest[i] - rest[0])[axis])
    };
    let rotation = glam::DMat3::from_cols(direction(0)?, direction(1)?, direction(2)?);
    Some(Frame {
        rotation,
        translation: x[0] - rotation * rest[0],
    })
}

/// Separating axis test of a triangle against a box centred on the origin (Akenine-Möller 2001).
fn triangle_meets_box(t: [DVec3; 3], half: DVec3) -> bool {
    let separated = |axis: DVec3| {
        let reach = axis.abs().dot(half);
        let [a, b, c] = t.map(|p| p.dot(axis));
        a.min(b).min(c) > reach || a.max(b).max(c) < -reach
    };
    let edges = [t[1] - t[0], t[2] - t[1], t[0] - t[2]];
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let crossed = edges
        .iter()
        .flat_map(|edge| axes.iter().map(|axis| edge.cross(*axis)));
    !axes
        .into_iter()
        .chain([edges[0].cross(edges[1])])
        .chain(crossed)
        .any(separated)
}

/// Whether the origin lies inside the mapped mesh, by the sum of solid angles.
fn is_inside(mesh: &TriangleMesh, map: impl Fn(DVec3) -> DVec3) -> bool {
    let angle: f64 = mesh
        .all_corners()
        .map(|t| {
            let [a, b, c] = t.map(&map);
            let (la, lb, lc) = (a.length(), b.length(), c.length());
            let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
            2.0 * a.dot(b.cross(c)).atan2(below)
        })
        .sum();
    angle.abs() > 2.0 * std::f64::consts::PI
}
