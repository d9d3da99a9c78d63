//! Rigid indenters as fine triangle surfaces, tip at the origin, pointing along -z.
//!
//! Only the part that can meet a pad is meshed. A polyhedron with its vertices on a curved surface
//! lies inside it; the vertices are moved outwards by its mean distance, so that the surface is
//! exact on average.

use std::f64::consts::{FRAC_PI_4, TAU};

use glam::{DVec2, DVec3};

use gripcast_base::error::{Error, Result};
use gripcast_geometry::TriangleMesh;

/// Shape pressed into a gel. Long indenters lie along the gel's y axis.
#[derive(Clone, Debug, PartialEq)]
pub enum Indenter {
    /// A sphere.
    Sphere {
        /// Radius, m.
        radius_m: f64,
    },
    /// A lying cylinder, longer than the gel.
    Cylinder {
        /// Radius, m.
        radius_m: f64,
    },
    /// A flat plate, larger than the gel.
    Plate,
    /// A straight edge of 90 degrees with a rounded tip, longer than the gel.
    Edge {
        /// Radius of the tip, m.
        radius_m: f64,
    },
    /// Any surface, in the gel frame; its lowest point above the gel's face (minimum z) touches
    /// first.
    Mesh(TriangleMesh),
}

/// Meshing parameters of an indenter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MeshSize {
    /// Face size across the contact, m.
    pub(super) face_m: f64,
    /// Face size along y, where the indenter is constant, m.
    pub(super) along_m: f64,
    /// Half extent of the gel, m.
    pub(super) half: DVec2,
    /// Maximum depth, m.
    pub(super) depth_m: f64,
}

/// Margin beyond the gel, m.
const MARGIN_M: f64 = 5e-4;

impl Indenter {
    /// Checks the radius, or that the mesh lies above a gel of half extent `half` (m).
    ///
    /// # Errors
    /// `Input` for a radius that is not positive, an invalid mesh, or one beside the gel.
    pub(super) fn validate(&self, half: DVec2) -> Result<()> {
        match self {
            Self::Sphere { radius_m } | Self::Cylinder { radius_m } | Self::Edge { radius_m } => {
                if radius_m.is_finite() && *radius_m > 0.0 {
                    return Ok(());
                }
                let what = format!("the indenter's radius must be above 0 m, found {radius_m}");
                Err(Error::input(what))
            }
            Self::Plate => Ok(()),
            Self::Mesh(mesh) => {
                mesh.validate()?;
                lowest_above(mesh, half).map_or_else(|| Err(beside(mesh, half)), |_| Ok(()))
            }
        }
    }

    /// Surface whose lowest point above the gel is at z = 0; analytic shapes are smaller by `inset_m`.
    pub(super) fn surface(&self, size: &MeshSize, inset_m: f64) -> TriangleMesh {
        match self {
            Self::Sphere { radius_m } => cap(shrunk(*radius_m, inset_m), size),
            Self::Cylinder { radius_m } => {
                let radius = shrunk(*radius_m, inset_m);
                let angle = arc_angle(radius, size).min(1.4);
                extrude(&arc(radius, angle, size.face_m), size)
            }
            Self::Plate => extrude(&flat(size), size),
            Self::Edge { radius_m } => {
                let radius = shrunk(*radius_m, inset_m);
                extrude(&wedge(radius, size), size)
            }
            Self::Mesh(mesh) => {
                let lowest = lowest_above(mesh, size.half).unwrap_or(mesh.bounds().min.z);
                let mut mesh = mesh.clone();
                for vertex in &mut mesh.vertices {
                    vertex.z -= lowest;
                }
                mesh
            }
        }
    }
}

/// Lowest z of the part of a mesh above the rectangle of half extent `half`; `None` if there is no
/// such part.
fn lowest_above(mesh: &TriangleMesh, half: DVec2) -> Option<f64> {
    let lowest = mesh
        .all_corners()
        .flat_map(|corners| clipped(&corners, half))
        .map(|p| p.z);
    lowest.reduce(f64::min)
}

/// Polygon of the part of a triangle above a rectangle (Sutherland and Hodgman, CACM 1974).
fn clipped(corners: &[DVec3; 3], half: DVec2) -> Vec<DVec3> {
    let mut polygon = corners.to_vec();
    for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)] {
        let room = |p: DVec3| half[axis] - sign * p[axis];
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (i, &from) in polygon.iter().enumerate() {
            let to = polygon[(i + 1) % polygon.len()];
            if room(from) >= 0.0 {
                kept.push(from);
            }
            if room(from).min(room(to)) < 0.0 && room(from).max(room(to)) > 0.0 {
                kept.push(from.lerp(to, room(from) / (room(from) - room(to))));
            }
        }
        polygon = kept;
    }
    polygon
}

/// The error of an indenter beside the gel.
fn beside(mesh: &TriangleMesh, half: DVec2) -> Error {
    let bounds = mesh.bounds();
    let (low, high) = (1e3 * bounds.min, 1e3 * bounds.max);
    Error::input(format!(
        "the indenter lies beside the gel: it spans x from {:.1} to {:.1} mm and y from {:.1} to \
         {:.1} mm, the gel x within {:.1} mm and y within {:.1} mm of 0",
        low.x,
        high.x,
        low.y,
        high.y,
        1e3 * half.x,
        1e3 * half.y
    ))
    .remedy("move the mesh: its origin is above the centre of the gel; check --unit")
}

fn shrunk(radius: f64, inset: f64) -> f64 {
    (radius - inset).max(0.5 * radius)
}

/// Polar angle beyond which a round indenter cannot touch: the undeformed face lies deeper there.
/// The free surface of a pad sinks around the contact, so slightly more than the overlap suffices.
fn arc_angle(radius: f64, size: &MeshSize) -> f64 {
    let cosine = 1.0 - 1.1 * size.depth_m / radius;
    (cosine.max(0.0).acos() + 2.0 * size.face_m / radius).min(1.5)
}

/// Lower cap of a sphere: rings of faces around the pole.
fn cap(radius: f64, size: &MeshSize) -> TriangleMesh {
    let angle = arc_angle(radius, size);
    let rings = (angle * radius / size.face_m).ceil().max(2.0) as u32;
    let face = angle * radius / f64::from(rings);
    // A triangle with sides a, b, c lies (a² + b² + c²) / 24 R inside on average; the squared sides
    // sum to 3.72 face² here.
    let raised = radius + 3.72 * face * face / (24.0 * radius);
    let at = |ring: u32, part: u32| {
        let (sine, cosine) = (angle * f64::from(ring) / f64::from(rings)).sin_cos();
        let turn = TAU * f64::from(part) / f64::from(6 * ring.max(1));
        let out = DVec2::from_angle(turn) * sine;
        DVec3::new(out.x, out.y, -cosine) * raised + DVec3::Z * radius
    };
    let mut mesh = TriangleMesh {
        vertices: vec![at(0, 0)],
        triangles: Vec::new(),
    };
    let start = |ring: u32| {
        if ring == 0 {
            0
        } else {
            1 + 3 * ring * (ring - 1)
        }
    };
    for ring in 1..=rings {
        mesh.vertices
            .extend((0..6 * ring).map(|part| at(ring, part)));
        for sector in 0..6 {
            // Per sector the outer ring has `ring` faces, the inner one fewer.
            let outer = |k: u32| start(ring) + (sector * ring + k) % (6 * ring);
            let inner = |k: u32| match ring {
                1 => 0,
                _ => start(ring - 1) + (sector * (ring - 1) + k) % (6 * (ring - 1)),
            };
            for k in 0..ring {
                mesh.triangles.push([inner(k), outer(k + 1), outer(k)]);
                if k + 1 < ring {
                    mesh.triangles.push([inner(k), inner(k + 1), outer(k + 1)]);
                }
            }
        }
    }
    mesh
}

/// Profile (x, z) of a lying cylinder around its lowest line, x rising.
fn arc(radius: f64, angle: f64, face: f64) -> Vec<DVec2> {
    let parts = (2.0 * angle * radius / face).ceil().max(4.0) as u32;
    let face = 2.0 * angle * radius / f64::from(parts);
    let raised = radius + face * face / (12.0 * radius);
    (0..=parts)
        .map(|k| {
            let (sine, cosine) = (angle * (2.0 * f64::from(k) / f64::from(parts) - 1.0)).sin_cos();
            DVec2::new(sine * raised, radius - cosine * raised)
        })
        .collect()
}

/// Profile of a 90 degree edge with a rounded tip.
fn wedge(radius: f64, size: &MeshSize) -> Vec<DVec2> {
    let tip = arc(radius, FRAC_PI_4, size.face_m);
    // The flanks rise away from the tip; the free surface does not follow far.
    let length = (1.5 * size.depth_m).max(2.0 * radius);
    let parts = (length / size.face_m).ceil().min(200.0) as u32;
    let flank = |sign: f64, from: DVec2, k: u32| {
        from + DVec2::new(sign, 1.0) * (length * f64::from(k) / f64::from(parts))
    };
    let (first, last) = (tip[0], tip[tip.len() - 1]);
    let left = (1..=parts).rev().map(|k| flank(-1.0, first, k));
    let right = (1..=parts).map(|k| flank(1.0, last, k));
    left.chain(tip.iter().copied()).chain(right).collect()
}

/// Profile of a plate wider than the gel.
fn flat(size: &MeshSize) -> Vec<DVec2> {
    let half = size.half.x + MARGIN_M;
    let cells = (2.0 * half / size.along_m).ceil();
    let x = |k: u32| half * (2.0 * f64::from(k) / cells - 1.0);
    (0..=cells as u32).map(|k| DVec2::new(x(k), 0.0)).collect()
}

/// Extrudes a profile along y beyond the gel: two triangles per cell, facing down, with alternating
/// diagonals.
fn extrude(profile: &[DVec2], size: &MeshSize) -> TriangleMesh {
    let half = size.half.y + MARGIN_M;
    let rows = (2.0 * half / size.along_m).ceil() as u32;
    let width = profile.len() as u32;
    let mut mesh = TriangleMesh::default();
    for row in 0..=rows {
        let y = half * (2.0 * f64::from(row) / f64::from(rows) - 1.0);
        let points = profile.iter().map(|p| DVec3::new(p.x, y, p.y));
        mesh.vertices.extend(points);
    }
    for row in 0..rows {
        for k in 0..width - 1 {
            let a = row * width + k;
            let (b, c, d) = (a + 1, a + width + 1, a + width);
            if (row + k) % 2 == 0 {
                mesh.triangles.extend([[a, c, b], [a, d, c]]);
            } else {
                mesh.triangles.extend([[a, d, b], [b, d, c]]);
            }
        }
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: MeshSize = MeshSize {
        face_m: 2e-4,
        along_m: 5e-4,
        half: DVec2::new(0.0125, 0.01),
        depth_m: 1e-3,
    };

    #[test]
    fn surfaces_face_down_and_start_at_zero() {
        let indenters = [
            Indenter::Sphere { radius_m: 0.01 },
            Indenter::Cylinder { radius_m: 0.005 },
            Indenter::Plate,
            Indenter::Edge { radius_m: 5e-4 },
        ];
        for indenter in indenters {
            let mesh = indenter.surface(&SIZE, 0.0);
            mesh.validate().unwrap();
            for [a, b, c] in mesh.all_corners() {
                assert!((b - a).cross(c - a).z < 0.0, "{indenter:?}");
            }
            let lowest = mesh.bounds().min.z;
            assert!(lowest.abs() < 1e-5, "{indenter:?}: {lowest}");
            let boundary = mesh.edges();
            let inner = (0..boundary.len()).filter(|&e| boundary.triangles(e).len() > 2);
            assert_eq!(inner.count(), 0);
        }
    }

    #[test]
    fn mesh_beside_the_gel_is_refused_and_the_part_above_it_counts() {
        let half = SIZE.half;
        let at = |x: f64, y: f64| {
            let box_mesh = gripcast_geometry::builtin("box").unwrap();
            let shift = gripcast_geometry::Pose::from_translation(DVec3::new(x, y, 0.05));
            box_mesh.transformed(&shift)
        };
        assert!(Indenter::Mesh(at(0.0, 0.0)).validate(half).is_ok());
        // The box is 40 mm wide; its side crosses the gel without a corner above it.
        assert!(Indenter::Mesh(at(0.032, 0.0)).validate(half).is_ok());
        for (x, y) in [(0.033, 0.0), (0.0, -0.031), (1.0, 1.0)] {
            let error = Indenter::Mesh(at(x, y)).validate(half).unwrap_err();
            let text = error.to_string();
            assert!(
                text.contains("beside the gel") && text.contains("within 12.5"),
                "{text}"
            );
        }
        // A ramp whose lowest corner lies outside: the depth counts from where it meets the gel.
        let ramp = TriangleMesh {
            vertices: [(-0.1, -0.1, 0.1), (0.1, -0.1, -0.1), (0.0, 0.2, 0.0)]
                .map(|(x, y, z)| DVec3::new(x, y, z))
                .to_vec(),
            triangles: vec![[0, 1, 2]],
        };
        let lowest = lowest_above(&ramp, half).unwrap();
        assert!((lowest + 0.0125).abs() < 1e-12, "{lowest}");
    }

    #[test]
    fn sphere_mesh_has_the_radius_on_average() {
        let radius = 0.01;
        let mesh = cap(radius, &SIZE);
        let center = DVec3::Z * radius;
        let (mut area, mut moment) = (0.0, 0.0);
        for ([a, b, c], face) in mesh.all_corners().zip(mesh.triangle_areas()) {
            // Exact to third order in the corners and edge middles.
            let middles = [(a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5];
            let mean: f64 = middles.iter().map(|m| m.distance(center)).sum::<f64>() / 3.0;
            area += face;
            moment += face * (mean - radius);
        }
        let error = moment / area;
        assert!(error.abs() < 1e-8, "{error:e}");
    }
}
