//! A body with its materials in its own frame, ready to be added to a scene.

use std::path::Path;

use glam::DVec3;

use super::bitmap_file;
use super::finish::Finish;
use super::material::{Colour, Material};
use super::procedural::ProceduralTexture;
use super::scene::{Mesh, Scene};
use super::shading::{Projection, shaded_mesh};
use super::texture::Bitmap;
use gripcast_base::error::Result;
use gripcast_base::files::companions;
use gripcast_geometry::{
    Aabb, CREASE_RAD, ImageSource, LengthUnit, MeshMaterial, MeshPart, Pose, TexturedMesh,
    TriangleMesh, load_textured_mesh,
};
use gripcast_imaging::{srgb_decode, srgb_encode};

/// Minimum transmission of a material rendered as glass; below it is opaque.
const MIN_GLASS_TRANSMISSION: f64 = 0.5;

/// Meshes in the body's own frame with their materials and textures.
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// Surfaces, in the body's own frame.
    pub meshes: Vec<Mesh>,
    /// Materials of the meshes.
    pub materials: Vec<Material>,
    /// Textures of the materials.
    pub textures: Vec<Bitmap>,
}

/// A model read from a file, with warnings.
#[derive(Clone, Debug)]
pub struct LoadedModel {
    /// The model.
    pub model: Model,
    /// What was omitted or replaced.
    pub warnings: Vec<String>,
}

/// Transform of [`MeshMaterial::uv_transform`].
type UvTransform = [[f64; 3]; 2];

/// Reads an image that a mesh refers to by a relative path.
type ReadRelative<'a> = &'a dyn Fn(&str) -> std::io::Result<Vec<u8>>;

impl Model {
    /// Grey model of one mesh with material 0.
    pub fn plain(mesh: Mesh) -> Self {
        Self {
            meshes: vec![mesh],
            materials: vec![Material::grey(0.5)],
            textures: Vec::new(),
        }
    }

    /// Model of a single finish; textures are box-projected.
    ///
    /// # Errors
    /// None for a valid mesh.
    pub fn with_finish(shape: &TriangleMesh, finish: Finish, seed: u64) -> Result<Self> {
        let (material, texture) = finish.material(seed, 0)?;
        let (bitmap, projection) = finish_projection(shape, finish, texture);
        Ok(Self {
            meshes: vec![shaded_mesh(shape, CREASE_RAD, projection, 0)],
            materials: vec![material],
            textures: bitmap.into_iter().collect(),
        })
    }

    /// Reads a mesh file (OBJ with MTL, glTF, STL, PLY; coordinates in `unit`) with its textures.
    /// Parts without a material get `finish`.
    ///
    /// # Errors
    /// Those of [`load_mesh`](gripcast_geometry::load_mesh). Missing or damaged textures, materials
    /// and texture coordinates are warnings.
    pub fn load(path: &Path, unit: LengthUnit, finish: Finish, seed: u64) -> Result<LoadedModel> {
        let mesh = load_textured_mesh(path, unit)?;
        Self::from_textured(&mesh, &companions(path), finish, seed)
    }

    /// Converts a mesh with materials; `beside` reads the images that it refers to by a relative
    /// path. Parts without a material get `finish`.
    ///
    /// # Errors
    /// None for a valid mesh; missing files are warnings.
    pub fn from_textured(
        mesh: &TexturedMesh,
        beside: ReadRelative<'_>,
        finish: Finish,
        seed: u64,
    ) -> Result<LoadedModel> {
        let mut build = ModelBuilder {
            model: Self::default(),
            warnings: mesh.warnings.clone(),
            beside,
        };
        let uv_transforms: Vec<Option<UvTransform>> = mesh
            .materials
            .iter()
            .map(|material| build.material(material).then_some(material.uv_transform))
            .collect();
        let is_inside_out = signed_volume(mesh) < 0.0;
        if is_inside_out {
            build.warnings.push(
                "the mesh is inside out (negative volume); its triangles are flipped".to_string(),
            );
        }
        for (number, part) in mesh.parts.iter().enumerate() {
            let mut own = match part.material {
                Some(material) => build.part(part, material, uv_transforms[material], number),
                None => build.part_with_finish(part, finish, seed)?,
            };
            if is_inside_out {
                own.triangles.iter_mut().for_each(|t| t.swap(0, 1));
                own.normals.iter_mut().for_each(|n| *n = -*n);
            }
            build.model.meshes.push(own);
        }
        Ok(LoadedModel {
            model: build.model,
            warnings: build.warnings,
        })
    }

    /// Returns the model scaled by a factor.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        for mesh in &mut self.meshes {
            for position in &mut mesh.positions {
                *position *= factor as f32;
            }
        }
        self
    }

    /// Adds the model to a scene.
    pub fn add_to(&self, scene: &mut Scene, t_world_model: &Pose) {
        let (materials, textures) = (scene.materials.len(), scene.textures.len());
        let renumbered = |mut material: Material| {
            if let Material::Principled { base_colour: c, .. }
            | Material::Diffuse { reflectance: c } = &mut material
                && let Colour::Texture(index) = c
            {
                *index += textures;
            }
            material
        };
        scene.textures.extend(self.textures.iter().cloned());
        scene
            .materials
            .extend(self.materials.iter().copied().map(renumbered));
        scene.meshes.extend(self.meshes.iter().map(|mesh| {
            let mut placed = mesh.transformed(t_world_model);
            placed.material += materials;
            placed
        }));
    }

    /// Iterates over the vertices of all meshes in the model's frame, m.
    pub fn positions(&self) -> impl Iterator<Item = DVec3> {
        let all = self.meshes.iter().flat_map(|mesh| &mesh.positions);
        all.map(|p| p.as_dvec3())
    }
}

/// Returns the texture of a finish and its box projection: a print covers the shape once, other
/// textures keep their real size.
fn finish_projection(
    shape: &TriangleMesh,
    finish: Finish,
    texture: Option<(Bitmap, f64)>,
) -> (Option<Bitmap>, Projection) {
    let Some((bitmap, tile_m)) = texture else {
        return (None, Projection::None);
    };
    let bounds = shape.bounds();
    let extent = bounds.extent().max_element();
    let covers = finish == Finish::Textured(ProceduralTexture::Print) && extent > 0.0;
    let (width_m, origin_m) = match covers {
        true => (extent, bounds.min),
        false => (tile_m, DVec3::ZERO),
    };
    (Some(bitmap), Projection::Box { width_m, origin_m })
}

/// Returns the volume enclosed by all parts in the unit of the mesh; 0 if they are not closed,
/// judged by the sum of the vector areas.
fn signed_volume(mesh: &TexturedMesh) -> f64 {
    let corners = || mesh.parts.iter().flat_map(|part| part.shape.all_corners());
    let areas = corners().map(|[a, b, c]| 0.5 * (b - a).cross(c - a));
    let (sum, total) = areas.fold((DVec3::ZERO, 0.0), |(sum, total), area| {
        (sum + area, total + area.length())
    });
    if sum.length() > 1e-6 * total {
        return 0.0;
    }
    let bounds = Aabb::from_points(corners().flatten());
    let o = bounds.center();
    corners()
        .map(|[a, b, c]| (a - o).dot((b - o).cross(c - o)) / 6.0)
        .sum()
}

/// A model under construction.
struct ModelBuilder<'a> {
    model: Model,
    warnings: Vec<String>,
    beside: ReadRelative<'a>,
}

impl ModelBuilder<'_> {
    /// Adds a material; returns whether it is textured.
    fn material(&mut self, from: &MeshMaterial) -> bool {
        let label = format!("material {:?}", from.name);
        let mut warn = |text: String| self.warnings.push(format!("{label}: {text}"));
        if from.emission.iter().any(|e| *e > 0.0) {
            warn("emission is not rendered".to_string());
        }
        if from.transmission > MIN_GLASS_TRANSMISSION {
            self.model.materials.push(Material::Dielectric {
                ior: from.ior as f32,
                roughness: from.roughness as f32,
                transmittance: from.base_color.map(|c| c as f32),
            });
            return false;
        }
        if from.transmission > 0.0 {
            warn("partial transparency is rendered opaque".to_string());
        }
        let (mut roughness, mut metallic) = (from.roughness, from.metallic);
        if let Some(source) = &from.metallic_roughness_image
            && let Some(image) = self.image(source, &label)
        {
            // The mean of the image is used for the whole material.
            let mean = |channel: usize| {
                let values = image.pixels().map(|p| f64::from(p[channel]));
                values.sum::<f64>() / f64::from(image.width() * image.height()) / 255.0
            };
            (roughness, metallic) = (roughness * mean(1), metallic * mean(2));
        }
        let image = from
            .base_color_image
            .as_ref()
            .map(|source| self.image(source, &label));
        let base_colour = match image {
            Some(Some(image)) => self.texture(tinted(image, from.base_color)),
            // The factor of an image is usually white.
            Some(None) if from.base_color == [1.0; 3] => None,
            Some(None) => Some(Colour::Constant(from.base_color.map(|c| c as f32))),
            None => Some(Colour::Constant(from.base_color.map(|c| c as f32))),
        };
        let is_textured = matches!(base_colour, Some(Colour::Texture(_)));
        self.model.materials.push(Material::Principled {
            base_colour: base_colour.unwrap_or(Colour::Constant([0.5; 3])),
            metallic: metallic.clamp(0.0, 1.0) as f32,
            roughness: roughness.clamp(0.0, 1.0) as f32,
            ior: from.ior as f32,
        });
        is_textured
    }

    fn texture(&mut self, image: image::RgbImage) -> Option<Colour> {
        let bitmap = Bitmap::from_srgb8(&image).ok()?;
        self.model.textures.push(bitmap);
        Some(Colour::Texture(self.model.textures.len() - 1))
    }

    /// Returns the decoded image; `None`, with a warning, if that fails.
    fn image(&mut self, source: &ImageSource, label: &str) -> Option<image::RgbImage> {
        let name = source.name();
        let read = match source {
            ImageSource::Embedded(_, bytes) => Ok(bytes.clone()),
            ImageSource::File(path) => (self.beside)(path),
        };
        let loaded = match read {
            Ok(bytes) => bitmap_file::decode(&bytes).map_err(|e| e.to_string()),
            Err(error) => Err(format!("cannot read it: {error}")),
        };
        let (image, warning) = match loaded {
            Ok(loaded) => (Some(loaded.image), loaded.warning),
            Err(text) => (
                None,
                Some(format!("{text}; a plain colour is used instead")),
            ),
        };
        let warning = warning.map(|text| format!("{label}: texture {name:?}: {text}"));
        self.warnings.extend(warning);
        image
    }

    /// Converts a part with a material of the file.
    fn part(
        &mut self,
        part: &MeshPart,
        material: usize,
        uv_transform: Option<UvTransform>,
        number: usize,
    ) -> Mesh {
        let textured = uv_transform.is_some();
        let placed = |&[u, v]: &[f64; 2]| {
            let rows = uv_transform.unwrap_or_default();
            rows.map(|[a, b, c]| (a * u + b * v + c) as f32)
        };
        let extent = part.shape.bounds().extent().max_element();
        let width = if extent > 0.0 { extent } else { 1.0 };
        if matches!(self.model.materials[material], Material::Dielectric { .. })
            && !is_closed(&part.shape)
        {
            self.warnings.push(format!(
                "part {number} is glass but not closed: refraction is wrong"
            ));
        }
        let needs_projection = textured && part.uvs.is_none();
        if needs_projection {
            self.warnings.push(format!(
                "part {number} has a texture but no texture coordinates: the image is \
                 box-projected"
            ));
        }
        let projection = if needs_projection {
            Projection::Box {
                width_m: width,
                origin_m: part.shape.bounds().min,
            }
        } else {
            Projection::None
        };
        match (&part.normals, &part.uvs) {
            (None, Some(uvs)) if textured => {
                let uvs: Vec<[f32; 2]> = uvs.iter().map(placed).collect();
                flat_with_uvs(part, &uvs, material)
            }
            (Some(normals), uvs) if !needs_projection => Mesh {
                positions: part.shape.vertices.iter().map(|v| v.as_vec3()).collect(),
                normals: normals.iter().map(|n| n.as_vec3()).collect(),
                uvs: uvs.iter().flatten().map(placed).collect(),
                triangles: part.shape.triangles.clone(),
                material,
            },
            _ => shaded_mesh(&part.shape, CREASE_RAD, projection, material),
        }
    }

    /// Converts a part without a material.
    fn part_with_finish(&mut self, part: &MeshPart, finish: Finish, seed: u64) -> Result<Mesh> {
        let (material, texture) = finish.material(seed, self.model.textures.len())?;
        let (bitmap, projection) = finish_projection(&part.shape, finish, texture);
        self.model.materials.push(material);
        self.model.textures.extend(bitmap);
        let index = self.model.materials.len() - 1;
        Ok(shaded_mesh(&part.shape, CREASE_RAD, projection, index))
    }
}

/// Multiplies an image by a linear colour.
fn tinted(mut image: image::RgbImage, color: [f64; 3]) -> image::RgbImage {
    if color == [1.0; 3] {
        return image;
    }
    let tables: [[u8; 256]; 3] = color
        .map(|factor| std::array::from_fn(|v| srgb_encode(srgb_decode(v as u8) * factor as f32)));
    for pixel in image.pixels_mut() {
        for (value, table) in pixel.0.iter_mut().zip(&tables) {
            *value = table[usize::from(*value)];
        }
    }
    image
}

/// Converts a part with texture coordinates but without normals.
fn flat_with_uvs(part: &MeshPart, uvs: &[[f32; 2]], material: usize) -> Mesh {
    // Texture seams must not become creases: normals come from the welded shape.
    let welded = welded(&part.shape);
    let smooth = shaded_mesh(&welded, CREASE_RAD, Projection::None, material);
    let mut mesh = Mesh {
        material,
        ..Mesh::default()
    };
    for (own, smoothed) in part.shape.triangles.iter().zip(&smooth.triangles) {
        let first = mesh.positions.len() as u32;
        for k in 0..3 {
            let vertex = own[k] as usize;
            mesh.positions.push(part.shape.vertices[vertex].as_vec3());
            mesh.normals.push(smooth.normals[smoothed[k] as usize]);
            mesh.uvs.push(uvs[vertex]);
        }
        mesh.triangles.push([first, first + 1, first + 2]);
    }
    mesh
}

/// Merges vertices at the same position; keeps the order of the triangles.
fn welded(shape: &TriangleMesh) -> TriangleMesh {
    let mut vertex_ids = std::collections::HashMap::new();
    let mut vertices = Vec::new();
    let renamed: Vec<u32> = shape
        .vertices
        .iter()
        .map(|v| {
            // Adding zero turns −0 into 0.
            let key = (*v + DVec3::ZERO).to_array().map(f64::to_bits);
            *vertex_ids.entry(key).or_insert_with(|| {
                vertices.push(*v);
                vertices.len() as u32 - 1
            })
        })
        .collect();
    let triangles = shape.triangles.iter();
    TriangleMesh {
        triangles: triangles.map(|t| t.map(|v| renamed[v as usize])).collect(),
        vertices,
    }
}

pub(super) fn is_closed(shape: &TriangleMesh) -> bool {
    welded(shape).edges().is_closed()
}

#[cfg(test)]
#[path = "model_test.rs"]
mod tests;
