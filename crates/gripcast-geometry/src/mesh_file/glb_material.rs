//! Materials and images of glTF 2.0, with the extensions for transmission and index of
//! refraction.
//!
//! Parsed separately from the shape, so that invalid materials do not prevent reading the shape.

use serde::Deserialize;

use super::glb::{Gltf, decode_data_uri};
use super::material::{ImageSource, MeshMaterial};

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
    extensions: serde_json::Map<String, serde_json::Value>,
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
    let [red, green, blue, alpha] = pbr.base_color_factor;
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
        base_color_image: image(&pbr.base_color_texture),
        metallic: finite(pbr.metallic_factor, 1.0).clamp(0.0, 1.0),
        roughness: finite(pbr.roughness_factor, 1.0).clamp(0.0, 1.0),
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
    if texture_use.tex_coord != 0 {
        return Err("only the first set of texture coordinates is supported".to_string());
    }
    if texture_use.extensions.contains_key("KHR_texture_transform") {
        return Err("KHR_texture_transform is not supported; the texture is ignored".to_string());
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
            None => Ok(ImageSource::File(uri.replace("%20", " "))),
        },
        (None, Some(view)) => gltf
            .view(view)
            .map(|bytes| ImageSource::Embedded(name, bytes.to_vec()))
            .ok_or_else(|| format!("image {index} lies outside the buffer")),
        (None, None) => Err(format!("image {index} has no content")),
    }
}
