//! Scene description: meshes, materials, textures, environment map and camera.

use glam::{DVec3, Vec3};

use super::camera::Camera;
use super::env_map::EnvMap;
use super::material::{Colour, Material};
use super::texture::Bitmap;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};

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
    /// Flat-shaded mesh without texture coordinates.
    pub fn from_triangles(mesh: &TriangleMesh, material: usize) -> Self {
        Self {
            positions: mesh.vertices.iter().map(|v| v.as_vec3()).collect(),
            triangles: mesh.triangles.clone(),
            material,
            ..Self::default()
        }
    }

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
        let bad = |what: String| Err(Error::input(what));
        let count = self.positions.len();
        for (name, found) in [("normals", self.normals.len()), ("uvs", self.uvs.len())] {
            if found != 0 && found != count {
                return bad(format!(
                    "the number of {name} must be 0 or that of the positions, {count}, found {found}"
                ));
            }
        }
        if let Some(v) = self.positions.iter().position(|p| !p.is_finite()) {
            let found = self.positions[v];
            return bad(format!(
                "position {v} must have finite coordinates, found {found}"
            ));
        }
        if let Some(v) = self.normals.iter().position(|n| !n.is_finite()) {
            let found = self.normals[v];
            return bad(format!("normal {v} must be finite, found {found}"));
        }
        if let Some(v) = self
            .uvs
            .iter()
            .position(|uv| !uv.iter().all(|c| c.is_finite()))
        {
            let found = self.uvs[v];
            return bad(format!(
                "texture coordinate {v} must be finite, found {found:?}"
            ));
        }
        let outside = |t: &[u32; 3]| t.iter().any(|&v| v as usize >= count);
        if let Some(t) = self.triangles.iter().position(outside) {
            let found = self.triangles[t];
            return bad(format!(
                "triangle {t} has vertex indices {found:?}, but the mesh has {count} vertices"
            ));
        }
        let Some(material) = scene.materials.get(self.material) else {
            let found = (self.material, scene.materials.len());
            return bad(format!(
                "material index {} is out of range, the scene has {} materials",
                found.0, found.1
            ));
        };
        if matches!(material.colour(), Some(Colour::Texture(_))) && self.uvs.is_empty() {
            return Err(
                Error::input("the mesh has a texture but no texture coordinates")
                    .remedy("use a mesh with texture coordinates"),
            );
        }
        Ok(())
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
    use gripcast_geometry::builtin;

    #[test]
    fn camera_inside_closed_mesh_is_detected() {
        let at =
            |x: f64| Camera::centred(4, 4, 1.0, Pose::from_translation(DVec3::new(x, 0.0, 0.0)));
        let scene = Scene {
            meshes: vec![
                Mesh::ground(Vec3::new(0.0, 0.0, -1e-3), 0.5, 0.1, 0),
                Mesh::from_triangles(&builtin("mug").unwrap(), 0),
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
