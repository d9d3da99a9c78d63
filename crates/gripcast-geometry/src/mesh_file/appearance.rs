//! How a surface looks, as mesh files say it.

/// Where the bytes of an image (PNG, JPEG, …) are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImageSource {
    /// A file, by its path relative to the file that names it.
    Beside(String),
    /// Within the mesh file itself; the text says where, for messages.
    Embedded(String, Vec<u8>),
}

impl ImageSource {
    /// The path or the place within the file, for messages.
    pub fn name(&self) -> &str {
        match self {
            Self::Beside(name) | Self::Embedded(name, _) => name,
        }
    }
}

/// A material in the metallic-roughness model of glTF 2.0. All colours are linear.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshMaterial {
    /// Name in the file; may be empty.
    pub name: String,
    /// Reflectance of a dielectric, reflectance at normal incidence of a metal, tint of light that
    /// passes through; each 0 to 1. The image is multiplied by it.
    pub base_color: [f64; 3],
    /// Image of the base colour, sRGB.
    pub base_color_image: Option<ImageSource>,
    /// 0 dielectric, 1 metal.
    pub metallic: f64,
    /// Perceptual roughness, 0 mirror to 1 matt; its square is the GGX alpha.
    pub roughness: f64,
    /// Image whose green channel multiplies the roughness, and its blue one `metallic`.
    pub metallic_roughness_image: Option<ImageSource>,
    /// Fraction of the light that enters the body instead of being scattered at its surface, 0 to 1:
    /// 1 is glass.
    pub transmission: f64,
    /// Index of refraction, 1 or more.
    pub ior: f64,
    /// Radiance that leaves the surface by itself, relative units.
    pub emission: [f64; 3],
}

impl Default for MeshMaterial {
    /// A matt light grey.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [0.8; 3],
            base_color_image: None,
            metallic: 0.0,
            roughness: 0.6,
            metallic_roughness_image: None,
            transmission: 0.0,
            ior: 1.5,
            emission: [0.0; 3],
        }
    }
}
