//! Triangles prepared for shading, and surface interactions.

use glam::Vec3;

use super::bvh::Hit;
use super::scene::{Mesh, Scene};

/// Offset of ray origins from the surface as a fraction of the largest coordinate: 64 ulps.
const OFFSET: f32 = 64.0 * f32::EPSILON;
/// Minimum coordinate used for the offset, m.
const MIN_SIZE: f32 = 0.03;

/// Triangle with its shading attributes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    pub(super) corners: [Vec3; 3],
    normals: [Vec3; 3],
    uvs: [[f32; 2]; 3],
    /// Material index.
    pub(super) material: u32,
}

/// Point where a ray hits a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfaceInteraction {
    pub(super) position: Vec3,
    /// Unit geometric normal, by the winding of the triangle.
    pub(super) normal: Vec3,
    /// Unit shading normal on the same side.
    pub(super) shading_normal: Vec3,
    pub(super) uv: [f32; 2],
}

/// Orthonormal frame with its third axis along a normal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    x: Vec3,
    y: Vec3,
    z: Vec3,
}

impl Face {
    fn new(mesh: &Mesh, triangle: [u32; 3]) -> Self {
        let vertices = triangle.map(|v| v as usize);
        let corners = vertices.map(|v| mesh.positions[v]);
        let flat = geometric_normal(corners);
        let smooth = |v: usize| mesh.normals.get(v).and_then(|n| n.try_normalize());
        Self {
            corners,
            normals: vertices.map(|v| smooth(v).unwrap_or(flat)),
            uvs: vertices.map(|v| mesh.uvs.get(v).copied().unwrap_or_default()),
            material: mesh.material as u32,
        }
    }

    /// Returns all triangles of a scene, mesh by mesh.
    pub(super) fn all(scene: &Scene) -> Vec<Self> {
        let meshes = scene.meshes.iter();
        meshes
            .flat_map(|mesh| mesh.triangles.iter().map(|&t| Self::new(mesh, t)))
            .collect()
    }

    /// Returns the surface interaction of a hit.
    #[inline(always)]
    pub(super) fn interaction(&self, hit: &Hit) -> SurfaceInteraction {
        let [v, w] = hit.weights;
        let u = 1.0 - v - w;
        let normal = geometric_normal(self.corners);
        let shading = interpolate(self.normals, [u, v, w]).normalize_or(normal);
        let [a, b, c] = self.uvs;
        SurfaceInteraction {
            position: interpolate(self.corners, [u, v, w]),
            normal,
            shading_normal: if shading.dot(normal) < 0.0 {
                -shading
            } else {
                shading
            },
            uv: [
                u * a[0] + v * b[0] + w * c[0],
                u * a[1] + v * b[1] + w * c[1],
            ],
        }
    }
}

#[inline(always)]
fn interpolate(p: [Vec3; 3], weights: [f32; 3]) -> Vec3 {
    p[0] * weights[0] + p[1] * weights[1] + p[2] * weights[2]
}

#[inline(always)]
fn geometric_normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    // Scaled up: the squared area of a small triangle underflows f32.
    let cross = ((b - a) * 1e4).cross((c - a) * 1e4);
    cross.normalize_or(Vec3::Z)
}

impl SurfaceInteraction {
    /// Origin of a ray that leaves in `direction`, offset from the surface to avoid
    /// self-intersection.
    #[inline(always)]
    pub(super) fn ray_origin(&self, direction: Vec3) -> Vec3 {
        let size = self.position.abs().max_element().max(MIN_SIZE);
        let offset = self.normal * (OFFSET * size);
        if direction.dot(self.normal) < 0.0 {
            self.position - offset
        } else {
            self.position + offset
        }
    }
}

impl Frame {
    /// Frame around a unit vector (Duff et al., *Building an orthonormal basis, revisited*, 2017).
    #[inline(always)]
    pub(super) fn around(z: Vec3) -> Self {
        let sign = 1f32.copysign(z.z);
        let a = -1.0 / (sign + z.z);
        let b = z.x * z.y * a;
        Self {
            x: Vec3::new(1.0 + sign * z.x * z.x * a, sign * b, -sign * z.x),
            y: Vec3::new(b, sign + z.y * z.y * a, -z.y),
            z,
        }
    }

    #[inline(always)]
    pub(super) fn to_local(self, v: Vec3) -> Vec3 {
        Vec3::new(v.dot(self.x), v.dot(self.y), v.dot(self.z))
    }

    #[inline(always)]
    pub(super) fn to_world(self, v: Vec3) -> Vec3 {
        self.x * v.x + self.y * v.y + self.z * v.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_and_right_handed() {
        for z in [
            Vec3::Z,
            -Vec3::Z,
            Vec3::new(0.3, -0.4, 0.1).normalize(),
            Vec3::new(-1.0, 0.0, -1e-7).normalize(),
        ] {
            let frame = Frame::around(z);
            assert!((frame.x.cross(frame.y) - z).length() < 1e-6, "{z}");
            let v = Vec3::new(0.2, 0.7, -0.5);
            assert!(
                (frame.to_world(frame.to_local(v)) - v).length() < 1e-6,
                "{z}"
            );
        }
    }
}
