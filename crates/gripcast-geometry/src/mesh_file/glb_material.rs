//! Materials and images of glTF 2.0, with the extensions for transmission and index of
//! refraction.
//!
//! Read apart from the shape: a document whose materials are damaged still has a shape.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;

use super::appearance::{ImageSource, MeshMaterial};
use super::glb::Gltf;

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
    /// The values that the format implies.
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
    #[serde(default = "usual_ior")]
    ior: f64,
}

/// The index that the format implies.
fn usual_ior() -> f64 {
    1.5
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

/// The materials of a document in their order; empty, with a warning, where they cannot be read.
pub(super) fn read(json: &[u8], gltf: &Gltf, warnings: &mut Vec<String>) -> Vec<MeshMaterial> {
    let document: Document = match serde_json::from_slice(json) {
        Ok(document) => document,
        Err(error) => {
            warnings.push(format!(
                "the materials of the glTF cannot be read and are left out: {error}"
            ));
            return Vec::new();
        }
    };
    let material = |(index, entry): (usize, &Material)| {
        let mut told = Vec::new();
        let read = convert(entry, &document, gltf, &mut told);
        let label = format!("material {index} {:?}", entry.name);
        warnings.extend(told.into_iter().map(|text| format!("{label}: {text}")));
        read
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
    on_progress: &mut Vec<String>,
) -> MeshMaterial {
    let pbr = &entry.pbr_metallic_roughness;
    let [red, green, blue, alpha] = pbr.base_color_factor;
    let see_through = match entry.alpha_mode.as_str() {
        "BLEND" => 1.0 - alpha,
        "MASK" => {
            on_progress
                .push("cut-outs (alphaMode MASK) are not supported: it is opaque".to_string());
            0.0
        }
        _ => 0.0,
    };
    if entry.normal_texture.is_some() {
        on_progress.push("its normal map is not supported and is ignored".to_string());
    }
    let transmission = entry.extensions.transmission.transmission_factor;
    let ior = entry.extensions.ior.as_ref().map_or(usual_ior(), |e| e.ior);
    let mut image = |of: &Option<TextureUse>| {
        let of = of.as_ref()?;
        source(of, document, gltf)
            .map_err(|text| on_progress.push(text))
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
        ior: if (1.0..=4.0).contains(&ior) {
            ior
        } else {
            plain.ior
        },
        emission: entry.emissive_factor.map(|c| finite(c, 0.0).max(0.0)),
    }
}

/// The image behind a texture; the warning where there is none.
fn source(of: &TextureUse, document: &Document, gltf: &Gltf) -> Result<ImageSource, String> {
    if of.tex_coord != 0 {
        return Err("only the first set of texture coordinates is read".to_string());
    }
    if of.extensions.contains_key("KHR_texture_transform") {
        return Err("a texture with KHR_texture_transform is left out".to_string());
    }
    let texture = document.textures.get(of.index);
    let texture = texture.ok_or_else(|| format!("there is no texture {}", of.index))?;
    let index = texture.source.ok_or_else(|| {
        format!(
            "texture {} has no PNG or JPEG image and is left out",
            of.index
        )
    })?;
    let image = document.images.get(index);
    let image = image.ok_or_else(|| format!("there is no image {index}"))?;
    let place = format!("image {index}");
    match (&image.uri, image.buffer_view) {
        (Some(uri), _) => match uri.strip_prefix("data:") {
            Some(data) => {
                let encoded = data.split_once("base64,").map_or("", |(_, text)| text);
                let bytes = STANDARD.decode(encoded);
                bytes
                    .map(|bytes| ImageSource::Embedded(place, bytes))
                    .map_err(|error| format!("image {index} is not base64: {error}"))
            }
            None => Ok(ImageSource::Beside(uri.replace("%20", " "))),
        },
        (None, Some(view)) => gltf
            .view(view)
            .map(|bytes| ImageSource::Embedded(place, bytes.to_vec()))
            .ok_or_else(|| format!("image {index} lies outside the file")),
        (None, None) => Err(format!("image {index} has no content")),
    }
}
