//! Materials and images of glTF 2.0, with the extensions for transmission, index of refraction,
//! unlit materials, specular-glossiness and texture transforms.
//!
//! Parsed separately from the shape, so that invalid materials do not prevent reading the shape.

use percent_encoding::percent_decode_str;
use serde::Deserialize;

use super::glb::{Gltf, decode_data_uri};
use super::material::{ImageSource, MeshMaterial, UV_IDENTITY};

#[derive(Default, Deserialize)]
#[serde(default)]
struct Document {
    materials: Vec<Material>,
    textures: Vec<Texture>,
    images: Vec<Image>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Material {
    name: String,
    pbr_metallic_roughness: MetallicRoughness,
    emissive_factor: [f64; 3],
    alpha_mode: String,
    normal_texture: Option<serde::de::IgnoredAny>,
    extensions: Extensions,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            pbr_metallic_roughness: MetallicRoughness::default(),
            emissive_factor: [0.0; 3],
            alpha_mode: "OPAQUE".to_string(),
            normal_texture: None,
            extensions: Extensions::default(),
        }
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct MetallicRoughness {
    base_color_factor: [f64; 4],
    base_color_texture: Option<TextureUse>,
    metallic_factor: f64,
    roughness_factor: f64,
    metallic_roughness_texture: Option<TextureUse>,
}

impl Default for MetallicRoughness {
    /// Defaults of the format.
    fn default() -> Self {
        Self {
            base_color_factor: [1.0; 4],
            base_color_texture: None,
            metallic_factor: 1.0,
            roughness_factor: 1.0,
            metallic_roughness_texture: None,
        }
    }
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Extensions {
    #[serde(rename = "KHR_materials_transmission")]
    transmission: Transmission,
    #[serde(rename = "KHR_materials_ior")]
    ior: Option<Ior>,
    #[serde(rename = "KHR_materials_unlit")]
    unlit: Option<serde::de::IgnoredAny>,
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    specular_glossiness: Option<SpecularGlossiness>,
}

/// The material model of older exporters; its specular colour is not used.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct SpecularGlossiness {
    diffuse_factor: [f64; 4],
    diffuse_texture: Option<TextureUse>,
    glossiness_factor: f64,
}

impl Default for SpecularGlossiness {
    /// Defaults of the extension.
    fn default() -> Self {
        Self {
            diffuse_factor: [1.0; 4],
            diffuse_texture: None,
            glossiness_factor: 1.0,
        }
    }
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Transmission {
    transmission_factor: f64,
}

#[derive(Deserialize)]
struct Ior {
    ior: Option<f64>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct TextureUse {
    index: usize,
    #[serde(default)]
    tex_coord: u32,
    #[serde(default)]
    extensions: TextureExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct TextureExtensions {
    #[serde(rename = "KHR_texture_transform")]
    transform: Option<TextureTransform>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct TextureTransform {
    offset: [f64; 2],
    rotation: f64,
    scale: [f64; 2],
    tex_coord: Option<u32>,
}

impl Default for TextureTransform {
    fn default() -> Self {
        Self {
            offset: [0.0; 2],
            rotation: 0.0,
            scale: [1.0; 2],
            tex_coord: None,
        }
    }
}

impl TextureUse {
    /// Offset · rotation · scale; the rotation is clockwise in the image, whose v points down.
    fn uv_transform(&self) -> [[f64; 3]; 2] {
        let Some(transform) = &self.extensions.transform else {
            return UV_IDENTITY;
        };
        let (sin, cos) = transform.rotation.sin_cos();
        let ([su, sv], [ou, ov]) = (transform.scale, transform.offset);
        let matrix = [[cos * su, sin * sv, ou], [-sin * su, cos * sv, ov]];
        let is_finite = matrix.iter().flatten().all(|value| value.is_finite());
        if is_finite { matrix } else { UV_IDENTITY }
    }

    fn uv_set(&self) -> u32 {
        let transform = self.extensions.transform.as_ref();
        transform
            .and_then(|t| t.tex_coord)
            .unwrap_or(self.tex_coord)
    }
}

#[derive(Deserialize)]
struct Texture {
    source: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Image {
    uri: Option<String>,
    buffer_view: Option<usize>,
}

/// Reads the materials of a document in order; on error empty, with a warning.
pub(super) fn read(json: &[u8], gltf: &Gltf, warnings: &mut Vec<String>) -> Vec<MeshMaterial> {
    let document: Document = match serde_json::from_slice(json) {
        Ok(document) => document,
        Err(error) => {
            warnings.push(format!(
                "invalid materials in the glTF are ignored: {error}"
            ));
            return Vec::new();
        }
    };
    let material = |(index, entry): (usize, &Material)| {
        let mut messages = Vec::new();
        let material = convert(entry, &document, gltf, &mut messages);
        let label = format!("material {index} {:?}", entry.name);
        warnings.extend(messages.into_iter().map(|text| format!("{label}: {text}")));
        material
    };
    document
        .materials
        .iter()
        .enumerate()
        .map(material)
        .collect()
}

fn convert(
    entry: &Material,
    document: &Document,
    gltf: &Gltf,
    messages: &mut Vec<String>,
) -> MeshMaterial {
    let pbr = &entry.pbr_metallic_roughness;
    let (mut factor, mut texture) = (pbr.base_color_factor, &pbr.base_color_texture);
    let (mut metallic, mut roughness) = (pbr.metallic_factor, pbr.roughness_factor);
    if let Some(older) = &entry.extensions.specular_glossiness {
        (factor, texture) = (older.diffuse_factor, &older.diffuse_texture);
        (metallic, roughness) = (0.0, 1.0 - older.glossiness_factor);
    }
    if entry.extensions.unlit.is_some() {
        messages.push("KHR_materials_unlit is rendered as a matt surface".to_string());
        (metallic, roughness) = (0.0, 1.0);
    }
    let [red, green, blue, alpha] = factor;
    let see_through = match entry.alpha_mode.as_str() {
        "BLEND" => 1.0 - alpha,
        "MASK" => {
            messages.push("alphaMode MASK is not supported and is treated as opaque".to_string());
            0.0
        }
        _ => 0.0,
    };
    if entry.normal_texture.is_some() {
        messages.push("the normal map is not supported and is ignored".to_string());
    }
    let transmission = entry.extensions.transmission.transmission_factor;
    let ior = entry.extensions.ior.as_ref().and_then(|e| e.ior);
    let mut image = |texture: &Option<TextureUse>| {
        image_source(texture.as_ref()?, document, gltf)
            .map_err(|text| messages.push(text))
            .ok()
    };
    let plain = MeshMaterial::default();
    let finite = |value: f64, otherwise: f64| if value.is_finite() { value } else { otherwise };
    MeshMaterial {
        name: entry.name.clone(),
        base_color: [red, green, blue].map(|c| finite(c, 1.0).clamp(0.0, 1.0)),
        base_color_image: image(texture),
        uv_transform: texture
            .as_ref()
            .map_or(UV_IDENTITY, TextureUse::uv_transform),
        metallic: finite(metallic, 1.0).clamp(0.0, 1.0),
        roughness: finite(roughness, 1.0).clamp(0.0, 1.0),
        metallic_roughness_image: image(&pbr.metallic_roughness_texture),
        transmission: finite(transmission.max(see_through), 0.0).clamp(0.0, 1.0),
        ior: ior.filter(|n| (1.0..=4.0).contains(n)).unwrap_or(plain.ior),
        emission: entry.emissive_factor.map(|c| finite(c, 0.0).max(0.0)),
    }
}

/// Image of a texture, or the reason why there is none.
fn image_source(
    texture_use: &TextureUse,
    document: &Document,
    gltf: &Gltf,
) -> Result<ImageSource, String> {
    if texture_use.uv_set() != 0 {
        return Err("only the first set of texture coordinates is supported".to_string());
    }
    let texture = document.textures.get(texture_use.index);
    let texture = texture.ok_or_else(|| format!("texture {} not found", texture_use.index))?;
    let index = texture.source.ok_or_else(|| {
        format!(
            "texture {} has no PNG or JPEG image and is ignored",
            texture_use.index
        )
    })?;
    let image = document.images.get(index);
    let image = image.ok_or_else(|| format!("image {index} not found"))?;
    let name = format!("image {index}");
    match (&image.uri, image.buffer_view) {
        (Some(uri), _) => match decode_data_uri(uri) {
            Some(bytes) => bytes
                .map(|bytes| ImageSource::Embedded(name, bytes))
                .map_err(|error| format!("image {index} is not valid base64: {error}")),
            None => Ok(ImageSource::File(
                percent_decode_str(uri).decode_utf8_lossy().into_owned(),
            )),
        },
        (None, Some(view)) => gltf
            .view(view)
            .map(|bytes| ImageSource::Embedded(name, bytes.to_vec()))
            .ok_or_else(|| format!("image {index} lies outside the buffer")),
        (None, None) => Err(format!("image {index} has no content")),
    }
}
