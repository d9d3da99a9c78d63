//! Bodies of blended signed distance primitives, and their meshes.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::shape::{relative_height, snapped_to_grid};
use gripcast_geometry::implicit::{
    Field, QuadMesh, gradient, neighbours, smooth_on_surface, surface_net_by_sheet,
};
use gripcast_geometry::{Aabb, TriangleMesh};

/// Smoothing iterations of the mesh.
const ROUNDS: usize = 6;
/// Maximum lattices that are tried.
const LATTICES: u32 = 8;
/// Target number of quadrilaterals.
const QUADS: f64 = 1900.0;
/// Quadrilaterals per squared cell width, averaged over directions.
const DENSITY: f64 = 1.4;
/// Range of cell widths, m.
const CELL_M: (f64, f64) = (2.4e-3, 4.0e-3);
/// Cosine between normals around a vertex below which it is on an edge of the body.
const EDGE_COSINE: f64 = 0.8;
/// Minimum relative height of a good triangle.
const MIN_QUALITY: f64 = 0.15;

/// A primitive in its own frame.
#[derive(Clone, Copy, Debug)]
pub(super) enum Primitive {
    /// Half axes, m.
    Ellipsoid(DVec3),
    /// Half sizes and radius of the edges, m.
    Box(DVec3, f64),
    /// About z: radii at the bottom and the top, half height, radius of the edges, m.
    Frustum([f64; 2], f64, f64),
    /// About z: radii of the centre line and of the tube, m.
    Torus(f64, f64),
    /// From the origin along z: length, radii at both ends, m.
    Capsule(f64, [f64; 2]),
}

/// How a primitive is combined with the previous ones; the value is the blending width, m.
#[derive(Clone, Copy, Debug)]
pub(super) enum Operation {
    Union(f64),
    Difference(f64),
}

/// A body of primitives.
#[derive(Default)]
pub(super) struct Solid {
    parts: Vec<Part>,
    /// Minimum thickness of walls and capsules, m.
    min_thickness_m: f64,
}

struct Part {
    primitive: Primitive,
    operation: Operation,
    center: DVec3,
    /// Rotation from the body's axes to those of the primitive.
    rotation: DMat3,
}

impl Solid {
    /// Creates an empty body with a minimum thickness of walls and capsules (m).
    pub(super) fn new(min_thickness_m: f64) -> Self {
        Self {
            parts: Vec::new(),
            min_thickness_m,
        }
    }

    /// Adds a rotated primitive at a position (m).
    pub(super) fn add(
        &mut self,
        primitive: Primitive,
        center: DVec3,
        rotation: DQuat,
        operation: Operation,
    ) {
        self.parts.push(Part {
            primitive,
            operation,
            center,
            rotation: DMat3::from_quat(rotation).transpose(),
        });
    }

    /// Adds a capsule between two points (m) with a radius (m) at each.
    pub(super) fn capsule(&mut self, [from, to]: [DVec3; 2], radii: [f64; 2], width: f64) {
        let along = to - from;
        let rotation = DQuat::from_rotation_arc(DVec3::Z, along.normalize_or(DVec3::Z));
        let primitive = Primitive::Capsule(along.length(), radii);
        self.add(primitive, from, rotation, Operation::Union(width));
    }

    /// Signed distance (m), negative inside; a lower bound off the surface.
    pub(super) fn distance(&self, p: DVec3) -> f64 {
        self.parts.iter().fold(1.0, |body, part| {
            let own = part.primitive.distance(part.rotation * (p - part.center));
            match part.operation {
                Operation::Union(width) => smooth_union(body, own, width),
                Operation::Difference(width) => -smooth_union(-body, own, width),
            }
        })
    }

    /// Bounding box of the united primitives.
    fn bounds(&self) -> Aabb {
        Aabb::from_points(
            self.parts
                .iter()
                .filter(|part| matches!(part.operation, Operation::Union(_)))
                .flat_map(|part| {
                    let (center, half) = part.primitive.bounds();
                    let back = part.rotation.transpose();
                    let abs =
                        DMat3::from_cols(back.x_axis.abs(), back.y_axis.abs(), back.z_axis.abs());
                    let (center, half) = (part.center + back * center, abs * half);
                    [center - half, center + half]
                }),
        )
    }

    /// Meshes the surface; edges of the body stay sharp.
    pub(super) fn mesh(&self) -> TriangleMesh {
        let bounds = self.bounds();
        let center = bounds.center();
        let half = 0.5 * bounds.extent() + 1e-3;
        mesh_of(&|p| self.distance(p + center), half, self.min_thickness_m)
    }
}

impl Primitive {
    fn distance(&self, p: DVec3) -> f64 {
        match *self {
            Self::Ellipsoid(half) => {
                let near = (p / half).length();
                let slope = (p / (half * half)).length();
                if slope > 1e-6 {
                    near * (near - 1.0) / slope
                } else {
                    -half.min_element()
                }
            }
            Self::Box(half, round) => {
                let off = p.abs() - half + round;
                off.max(DVec3::ZERO).length() + off.max_element().min(0.0) - round
            }
            Self::Frustum([bottom, top], half, round) => {
                let fraction = (0.5 + 0.5 * p.z / half).clamp(0.0, 1.0);
                let slope = (0.5 * (top - bottom) / half).hypot(1.0);
                let radius = bottom + (top - bottom) * fraction;
                let side = (p.truncate().length() - radius) / slope;
                let off = DVec2::new(side, p.z.abs() - half) + round;
                off.max(DVec2::ZERO).length() + off.max_element().min(0.0) - round
            }
            Self::Torus(radius, tube) => {
                DVec2::new(p.truncate().length() - radius, p.z).length() - tube
            }
            Self::Capsule(length, [from, to]) => {
                let fraction = (p.z / length.max(1e-9)).clamp(0.0, 1.0);
                p.distance(DVec3::Z * (length * fraction)) - (from + (to - from) * fraction)
            }
        }
    }

    /// Centre and half sizes of the bounding box.
    fn bounds(&self) -> (DVec3, DVec3) {
        match *self {
            Self::Ellipsoid(half) | Self::Box(half, _) => (DVec3::ZERO, half),
            Self::Frustum([bottom, top], half, _) => {
                let radius = bottom.max(top);
                (DVec3::ZERO, DVec3::new(radius, radius, half))
            }
            Self::Torus(radius, tube) => {
                let wide = radius + tube;
                (DVec3::ZERO, DVec3::new(wide, wide, tube))
            }
            Self::Capsule(length, [from, to]) => {
                let wide = from.max(to);
                let half = DVec3::new(wide, wide, 0.5 * length + wide);
                (DVec3::Z * (0.5 * length), half)
            }
        }
    }
}

/// Quadratic smooth minimum (Quilez, *Smooth minimum*).
pub(super) fn smooth_union(a: f64, b: f64, width: f64) -> f64 {
    if width <= 0.0 {
        return a.min(b);
    }
    let overlap = (width - (a - b).abs()).max(0.0) / width;
    a.min(b) - 0.25 * width * overlap * overlap
}

/// Meshes the zero level set of a field within ±`half` (m); walls are at least `min_thickness_m`
/// thick.
pub(super) fn mesh_of(field: Field<'_>, half: DVec3, min_thickness_m: f64) -> TriangleMesh {
    let cell = (DENSITY * area(field, half) / QUADS).sqrt();
    let cell = cell.clamp(CELL_M.0, CELL_M.1).min(min_thickness_m / 1.1);
    let mut mesh = TriangleMesh::default();
    for lattice in 0..LATTICES {
        let shift = f64::from(lattice) / f64::from(LATTICES);
        let net = surface_net_by_sheet(field, half, cell, shift);
        if is_closed(&net) {
            return triangles(field, net, cell);
        }
        mesh.vertices = net.vertices;
    }
    mesh
}

/// Estimates the area of the zero level set, m², by counting the cells of a coarse lattice around
/// it.
fn area(field: Field<'_>, half: DVec3) -> f64 {
    const STEP_M: f64 = 5e-3;
    let counts = (half / STEP_M).ceil() + 1.0;
    let [nx, ny, nz] = counts.to_array().map(|c| c as i32);
    let mut near = 0;
    for z in -nz..=nz {
        for y in -ny..=ny {
            for x in -nx..=nx {
                let p = DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * STEP_M;
                near += u32::from(field(p).abs() < 0.5 * STEP_M);
            }
        }
    }
    f64::from(near) * STEP_M * STEP_M
}

/// Whether each side is shared by two quadrilaterals.
fn is_closed(net: &QuadMesh) -> bool {
    let mut sides: Vec<[u32; 2]> = net
        .quads
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b], [b, c], [c, d], [d, a]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    sides.sort_unstable();
    !sides.is_empty() && sides.chunk_by(|a, b| a == b).all(|same| same.len() == 2)
}

fn triangles(field: Field<'_>, mut net: QuadMesh, cell: f64) -> TriangleMesh {
    smooth_on_surface(field, &mut net, ROUNDS);
    sharpen(field, &mut net, cell);
    for v in &mut net.vertices {
        *v = snapped_to_grid(*v);
    }
    let mut mesh = TriangleMesh {
        vertices: net.vertices,
        triangles: Vec::new(),
    };
    for quad in net.quads {
        let [a, b, c, d] = along_surface(field, quad, &mesh.vertices);
        mesh.triangles.push([a, b, c]);
        mesh.triangles.push([a, c, d]);
    }
    mesh
}

/// Moves vertices near an edge of the body onto it, by minimising the distances from the
/// surrounding tangent planes (quadratic error function of Ju et al., *Dual contouring of Hermite
/// data*, 2002).
fn sharpen(field: Field<'_>, net: &mut QuadMesh, cell: f64) {
    let normals: Vec<DVec3> = net
        .vertices
        .iter()
        .map(|&v| gradient(field, v).normalize_or_zero())
        .collect();
    let before = net.vertices.clone();
    let mut faces = vec![Vec::new(); before.len()];
    for (face, quad) in net.quads.iter().enumerate() {
        quad.iter().for_each(|&v| faces[v as usize].push(face));
    }
    for (v, around) in neighbours(&net.quads, before.len()).iter().enumerate() {
        let planes: Vec<usize> = around.iter().map(|&n| n as usize).chain([v]).collect();
        let spread = planes
            .iter()
            .flat_map(|&m| planes.iter().map(move |&n| (m, n)));
        let min = spread.fold(1.0, |c, (m, n)| f64::min(c, normals[m].dot(normals[n])));
        if min > EDGE_COSINE {
            continue;
        }
        let step = towards_planes(before[v], planes.iter().map(|&n| (before[n], normals[n])));
        let moved = before[v] + step.clamp_length_max(0.45 * cell);
        // In smooth blends, distant tangent planes are not representative.
        if field(moved).abs() > field(before[v]).abs() + 0.12 * cell {
            continue;
        }
        let previous = std::mem::replace(&mut net.vertices[v], moved);
        let is_good = |&face: &usize| {
            let quad = net.quads[face];
            let rotated = [quad[1], quad[2], quad[3], quad[0]];
            quality(quad, &net.vertices).max(quality(rotated, &net.vertices)) > MIN_QUALITY
        };
        if !faces[v].iter().all(is_good) {
            net.vertices[v] = previous;
        }
    }
}

/// Step from a position to the minimum of the squared distances from planes (point, normal).
fn towards_planes(position: DVec3, planes: impl Iterator<Item = (DVec3, DVec3)>) -> DVec3 {
    /// Regularisation weight.
    const STAY: f64 = 0.05;
    let mut matrix = DMat3::from_diagonal(DVec3::splat(STAY));
    let mut right = DVec3::ZERO;
    for (point, normal) in planes {
        matrix += DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
        right += normal * normal.dot(point - position);
    }
    matrix.inverse() * right
}

/// Quality of the two triangles of a quadrilateral that is split along its first diagonal: the
/// smaller relative height, negative if they are folded.
fn quality([a, b, c, d]: [u32; 4], vertices: &[DVec3]) -> f64 {
    let [a, b, c, d] = [a, b, c, d].map(|v| vertices[v as usize]);
    let min = relative_height([a, b, c]).min(relative_height([a, c, d]));
    let folded = (b - a).cross(c - a).dot((c - a).cross(d - a)) < 0.0;
    if folded { min - 1.0 } else { min }
}

/// Rotates a quadrilateral so that its first diagonal is the one closer to the surface, unless the
/// triangles are bad.
fn along_surface(field: Field<'_>, quad: [u32; 4], vertices: &[DVec3]) -> [u32; 4] {
    /// Differences within rounding, m.
    const TIE_M: f64 = 2e-5;
    let [a, b, c, d] = quad;
    let rotated = [b, c, d, a];
    let [first, second] = [quad, rotated].map(|q| quality(q, vertices));
    if first.min(second) < MIN_QUALITY && (first - second).abs() > 1e-3 {
        return if first > second { quad } else { rotated };
    }
    let vertex = |i: u32| vertices[i as usize];
    let off = |i, j| field(vertex(i).midpoint(vertex(j))).abs();
    let longer = vertex(a).distance(vertex(c)) - vertex(b).distance(vertex(d));
    let farther = off(a, c) - off(b, d);
    let is_rotated = if farther.abs() > TIE_M {
        farther > 0.0
    } else {
        longer > TIE_M
    };
    if is_rotated { rotated } else { quad }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::MassProperties;
    use std::f64::consts::PI;

    #[test]
    fn box_keeps_its_edges() {
        let mut solid = Solid::new(0.02);
        let half = DVec3::new(0.02, 0.015, 0.01);
        let rotation = DQuat::from_rotation_z(0.3) * DQuat::from_rotation_x(0.2);
        solid.add(
            Primitive::Box(half, 0.0),
            DVec3::ONE * 0.01,
            rotation,
            Operation::Union(0.0),
        );
        let mesh = solid.mesh();
        assert!(mesh.edges().is_closed());
        let volume = MassProperties::from_mesh(&mesh).unwrap().volume_m3;
        let expected = 8.0 * half.element_product();
        assert!(
            (volume / expected - 1.0).abs() < 0.02,
            "{volume} {expected}"
        );
    }

    #[test]
    fn difference_of_balls_is_a_shell() {
        let mut solid = Solid::new(0.004);
        let ball = Primitive::Ellipsoid(DVec3::splat(0.02));
        solid.add(ball, DVec3::ZERO, DQuat::IDENTITY, Operation::Union(0.0));
        let hollow = Primitive::Ellipsoid(DVec3::splat(0.016));
        solid.add(
            hollow,
            DVec3::ZERO,
            DQuat::IDENTITY,
            Operation::Difference(0.0),
        );
        let volume = MassProperties::from_mesh(&solid.mesh()).unwrap().volume_m3;
        let expected = 4.0 / 3.0 * PI * (8e-6 - 4.096e-6);
        assert!(
            (volume / expected - 1.0).abs() < 0.03,
            "{volume} {expected}"
        );
    }
}
