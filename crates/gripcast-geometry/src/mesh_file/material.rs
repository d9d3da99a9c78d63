//! Materials of mesh files.

/// Source of an image (PNG, JPEG, …).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImageSource {
    /// A file, by its path relative to the mesh file.
    File(String),
    /// Embedded in the mesh file: a description for messages, and the bytes.
    Embedded(String, Vec<u8>),
}

impl ImageSource {
    /// Path or description, for messages.
    pub fn name(&self) -> &str {
        match self {
            Self::File(name) | Self::Embedded(name, _) => name,
        }
    }
}

/// Texture coordinates as they are.
pub(super) const UV_IDENTITY: [[f64; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

/// A material in the metallic-roughness model of glTF 2.0; colours are linear.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshMaterial {
    /// Name in the file, possibly empty.
    pub name: String,
    /// Base colour, 0 to 1: diffuse reflectance of a dielectric, reflectance of a metal at normal
    /// incidence, tint of transmitted light. Multiplies the image.
    pub base_color: [f64; 3],
    /// sRGB image of the base colour.
    pub base_color_image: Option<ImageSource>,
    /// From texture coordinates (u, v, 1), as of [`MeshPart::uvs`](super::MeshPart::uvs), to those
    /// in the image.
    pub uv_transform: [[f64; 3]; 2],
    /// 0 for a dielectric, 1 for a metal.
    pub metallic: f64,
    /// Perceptual roughness, 0 (mirror) to 1 (matt); its square is the GGX alpha.
    pub roughness: f64,
    /// Image whose green channel multiplies `roughness` and whose blue channel multiplies
    /// `metallic`.
    pub metallic_roughness_image: Option<ImageSource>,
    /// Fraction of light transmitted instead of diffusely reflected, 0 to 1 (glass).
    pub transmission: f64,
    /// Index of refraction, 1 or more.
    pub ior: f64,
    /// Emitted radiance, relative units.
    pub emission: [f64; 3],
}

impl Default for MeshMaterial {
    /// A matt light grey.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [0.8; 3],
            base_color_image: None,
            uv_transform: UV_IDENTITY,
            metallic: 0.0,
            roughness: 0.6,
            metallic_roughness_image: None,
            transmission: 0.0,
            ior: 1.5,
            emission: [0.0; 3],
        }
    }
}
