//! Scene description: meshes, materials, textures, environment map and camera.

use glam::{DVec3, Vec3};

use super::camera::Camera;
use super::env_map::EnvMap;
use super::material::{Colour, Material, ensure};
use super::texture::Bitmap;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::Pose;

/// Winding number above which a point is inside.
const INSIDE: f64 = 0.9;

/// Triangle mesh with one material, in world coordinates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, m.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one per vertex; empty for flat shading.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one per vertex; empty without texture.
    pub uvs: Vec<[f32; 2]>,
    /// Indices into `positions`, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Scene::materials`].
    pub material: usize,
}

impl Mesh {
    /// Copy of a mesh in frame b, in world coordinates.
    #[must_use]
    pub fn transformed(&self, t_world_b: &Pose) -> Self {
        let position = |p: &Vec3| t_world_b.transform_point(p.as_dvec3()).as_vec3();
        let normal = |n: &Vec3| t_world_b.transform_vector(n.as_dvec3()).as_vec3();
        Self {
            positions: self.positions.iter().map(position).collect(),
            normals: self.normals.iter().map(normal).collect(),
            ..self.clone()
        }
    }

    /// Horizontal square centred at `centre`, facing up; the texture repeats every
    /// `texture_size_m`.
    pub fn ground(centre: Vec3, half_width_m: f32, texture_size_m: f32, material: usize) -> Self {
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0f32]];
        let repeats = half_width_m / texture_size_m;
        Self {
            positions: corners
                .map(|[x, y]| centre + half_width_m * Vec3::new(x, y, 0.0))
                .to_vec(),
            normals: Vec::new(),
            uvs: corners.map(|[x, y]| [x * repeats, -y * repeats]).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material,
        }
    }

    fn validate(&self, scene: &Scene) -> Result<()> {
        let count = self.positions.len();
        for (name, found) in [("normals", self.normals.len()), ("uvs", self.uvs.len())] {
            ensure(found == 0 || found == count, || {
                format!(
                    "the number of {name} must be 0 or that of the positions, {count}, found {found}"
                )
            })?;
        }
        for (v, p) in self.positions.iter().enumerate() {
            ensure(p.is_finite(), || {
                format!("position {v} must have finite coordinates, found {p}")
            })?;
        }
        for (v, n) in self.normals.iter().enumerate() {
            ensure(n.is_finite(), || {
                format!("normal {v} must be finite, found {n}")
            })?;
        }
        for (v, uv) in self.uvs.iter().enumerate() {
            ensure(uv.iter().all(|c| c.is_finite()), || {
                format!("texture coordinate {v} must be finite, found {uv:?}")
            })?;
        }
        for (t, triangle) in self.triangles.iter().enumerate() {
            ensure(triangle.iter().all(|&v| (v as usize) < count), || {
                format!(
                    "triangle {t} has vertex indices {triangle:?}, but the mesh has {count} vertices"
                )
            })?;
        }
        let (material, count) = (self.material, scene.materials.len());
        ensure(material < count, || {
            format!("material index {material} is out of range, the scene has {count} materials")
        })?;
        let is_textured = matches!(scene.materials[material].colour(), Some(Colour::Texture(_)));
        ensure(!is_textured || !self.uvs.is_empty(), || {
            "the mesh has a texture but no texture coordinates".to_owned()
        })
        .map_err(|e| e.remedy("use a mesh with texture coordinates"))
    }
}

/// A scene to render.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Meshes, world coordinates.
    pub meshes: Vec<Mesh>,
    /// Materials of the meshes.
    pub materials: Vec<Material>,
    /// Textures of the materials.
    pub textures: Vec<Bitmap>,
    /// Environment map.
    pub env_map: EnvMap,
    /// Camera.
    pub camera: Camera,
}

impl Scene {
    /// A scene without meshes.
    pub(super) fn empty(env_map: EnvMap, camera: Camera) -> Self {
        Self {
            meshes: Vec::new(),
            materials: Vec::new(),
            textures: Vec::new(),
            env_map,
            camera,
        }
    }

    /// Checks that the scene can be rendered.
    ///
    /// # Errors
    /// `Input` for non-finite coordinates, vertex, material or texture indices or material
    /// parameters out of range, an invalid environment map or camera; the error names the element
    /// and the value.
    pub fn validate(&self) -> Result<()> {
        for (m, mesh) in self.meshes.iter().enumerate() {
            mesh.validate(self).map_err(|e| e.at(format!("mesh {m}")))?;
        }
        for (m, material) in self.materials.iter().enumerate() {
            material
                .validate(self.textures.len())
                .map_err(|e| e.at(format!("material {m}")))?;
        }
        self.env_map
            .validate()
            .map_err(|e| e.at("environment map"))?;
        self.camera.validate().map_err(|e| e.at("camera"))
    }

    /// Checks that the camera is outside all closed meshes.
    ///
    /// # Errors
    /// `Input` if it is inside a closed mesh, whose inside would fill the image. Decided by the
    /// winding number of each mesh around the camera (sum of the solid angles of its triangles; van
    /// Oosterom and Strackee 1983), which stays well below 1 for open meshes.
    pub fn check_camera_outside(&self, camera: &Camera) -> Result<()> {
        let eye = camera.t_world_camera.translation_m;
        for (m, mesh) in self.meshes.iter().enumerate() {
            let winding: f64 = mesh
                .triangles
                .iter()
                .map(|t| solid_angle(t.map(|v| mesh.positions[v as usize].as_dvec3() - eye)))
                .sum::<f64>()
                / (4.0 * std::f64::consts::PI);
            if winding.abs() > INSIDE {
                return Err(
                    Error::input(format!("the camera at {eye} m is inside mesh {m}"))
                        .remedy("move the camera or the mesh, or check the unit of the mesh"),
                );
            }
        }
        Ok(())
    }
}

/// Signed solid angle of a triangle seen from the origin, sr.
fn solid_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * a.dot(b.cross(c)).atan2(below)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shading::{Projection, shaded_mesh};
    use gripcast_geometry::{CREASE_RAD, builtin};

    #[test]
    fn camera_inside_closed_mesh_is_detected() {
        let at =
            |x: f64| Camera::centred(4, 4, 1.0, Pose::from_translation(DVec3::new(x, 0.0, 0.0)));
        let scene = Scene {
            meshes: vec![
                Mesh::ground(Vec3::new(0.0, 0.0, -1e-3), 0.5, 0.1, 0),
                shaded_mesh(&builtin("mug").unwrap(), CREASE_RAD, Projection::None, 0),
            ],
            materials: vec![Material::grey(0.5)],
            textures: Vec::new(),
            env_map: EnvMap::uniform([1.0; 3]),
            camera: at(1.0),
        };
        // In the hollow of the mug, in its wall, and far away.
        assert!(scene.check_camera_outside(&at(0.0)).is_ok());
        assert!(scene.check_camera_outside(&at(0.5)).is_ok());
        let text = scene.check_camera_outside(&at(-0.028)).unwrap_err();
        assert!(text.to_string().contains("inside mesh 1"), "{text}");
    }
}
