//! Material libraries of Wavefront OBJ, with the PBR statements `Pr` and `Pm`.
//!
//! Invalid statements become warnings, never errors.
//!
//! The Phong exponent `Ns` becomes the roughness `(2 / (Ns + 2))^(1/4)` (Blinn–Phong exponent to
//! GGX alpha, Walter et al., *Microfacet Models for Refraction*, 2007, then its square root).
//! Programs disagree about `Tr`: the format and most use 1 − `d`, MeshLab and VCG the opacity. So it
//! counts only without `d`, and 1, which would make an object invisible, is opaque. A material with
//! `d` below 1 or an `illum` model 4, 6, 7 or 9 is transparent; one with almost no
//! `Kd` but a bright `Ks` is a metal. Keywords count in any case, as in other programs. Of the
//! options of `map_Kd`, `-s` and `-o` (uv · s + o) are used.

use super::material::{ImageSource, MeshMaterial};
use super::text;

/// `illum` models with transparency.
const GLASS_MODELS: [u32; 4] = [4, 6, 7, 9];
/// Minimum peak of `Ks` of a metal.
const METAL_SPECULAR: f64 = 0.4;
/// Maximum ratio of the peaks of `Kd` and `Ks` of a metal.
const METAL_DIFFUSE_RATIO: f64 = 0.2;

/// Options of `map_…` statements with their maximum number of values.
const MAP_OPTIONS: [(&str, usize); 12] = [
    ("-blendu", 1),
    ("-blendv", 1),
    ("-boost", 1),
    ("-mm", 2),
    ("-o", 3),
    ("-s", 3),
    ("-t", 3),
    ("-texres", 1),
    ("-clamp", 1),
    ("-bm", 1),
    ("-imfchan", 1),
    ("-type", 1),
];

/// Statements of one `newmtl`.
#[derive(Default)]
struct Entry {
    name: String,
    diffuse: Option<[f64; 3]>,
    diffuse_map: Option<DiffuseMap>,
    specular: Option<[f64; 3]>,
    emission: Option<[f64; 3]>,
    filter: Option<[f64; 3]>,
    exponent: Option<f64>,
    opacity: Option<f64>,
    transparency: Option<f64>,
    ior: Option<f64>,
    model: Option<u32>,
    roughness: Option<f64>,
    metallic: Option<f64>,
}

/// File and placement of `map_Kd`.
struct DiffuseMap {
    file: String,
    scale: [f64; 2],
    offset: [f64; 2],
}

impl DiffuseMap {
    /// Transform of texture coordinates with v downwards.
    fn uv_transform(&self) -> [[f64; 3]; 2] {
        let ([su, sv], [ou, ov]) = (self.scale, self.offset);
        [[su, 0.0, ou], [0.0, sv, 1.0 - sv - ov]]
    }
}

/// Parses a library; each warning states its line.
pub(super) fn read(bytes: &[u8], warnings: &mut Vec<String>) -> Vec<MeshMaterial> {
    let text = text::decode(bytes);
    let mut entries: Vec<Entry> = Vec::new();
    for (index, line) in text::lines(&text).enumerate() {
        let line = line.trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = text::without_comment(rest);
        if keyword.eq_ignore_ascii_case("newmtl") {
            entries.push(Entry {
                name: rest.to_string(),
                ..Entry::default()
            });
            continue;
        }
        let warning = match entries.last_mut() {
            Some(entry) => entry.read(keyword, rest),
            None if keyword.is_empty() || keyword.starts_with('#') => None,
            None => Some(format!("{keyword:?} before the first `newmtl`")),
        };
        warnings.extend(warning.map(|text| format!("line {}: {text}", index + 1)));
    }
    entries.into_iter().map(Entry::material).collect()
}

impl Entry {
    /// Reads one statement; returns a warning if it cannot be used.
    fn read(&mut self, keyword: &str, rest: &str) -> Option<String> {
        let bad = || Some(format!("invalid statement `{keyword} {rest}` is ignored"));
        let number = || rest.split_whitespace().next()?.parse::<f64>().ok();
        let number = || number().filter(|n| n.is_finite());
        let slot = match &*keyword.to_ascii_lowercase() {
            "kd" => return store(&mut self.diffuse, color(rest), bad),
            "ks" => return store(&mut self.specular, color(rest), bad),
            "ke" => return store(&mut self.emission, color(rest), bad),
            "tf" => return store(&mut self.filter, color(rest), bad),
            "map_kd" => return store(&mut self.diffuse_map, diffuse_map(rest), bad),
            "illum" => return store(&mut self.model, rest.parse().ok(), bad),
            "tr" => return store(&mut self.transparency, number(), bad),
            "d" => {
                let word = rest.strip_prefix("-halo").unwrap_or(rest).trim();
                return store(&mut self.opacity, word.parse().ok(), bad);
            }
            "ns" => &mut self.exponent,
            "ni" => &mut self.ior,
            "pr" => &mut self.roughness,
            "pm" => &mut self.metallic,
            lower if lower.starts_with("map_") || matches!(lower, "bump" | "norm" | "disp") => {
                return Some(format!("`{keyword}` is not supported and is ignored"));
            }
            _ => return None,
        };
        store(slot, number(), bad)
    }

    fn material(self) -> MeshMaterial {
        let plain = MeshMaterial::default();
        let peak = |c: [f64; 3]| c.into_iter().fold(0.0, f64::max);
        let default_color = if self.diffuse_map.is_some() {
            [1.0; 3]
        } else {
            plain.base_color
        };
        // A black image would be invisible: exporters leave `Kd` at 0 where an image replaces it.
        let is_used = |color: &[f64; 3]| self.diffuse_map.is_none() || peak(*color) > 0.0;
        let diffuse = self.diffuse.filter(is_used).unwrap_or(default_color);
        let specular = self.specular.unwrap_or([0.0; 3]);
        let from_transparency = self.transparency.filter(|&t| t < 1.0).map(|t| 1.0 - t);
        let opacity = self.opacity.or(from_transparency).unwrap_or(1.0);
        let opacity = opacity.clamp(0.0, 1.0);
        let is_glass_model = self.model.is_some_and(|m| GLASS_MODELS.contains(&m));
        let transmission = match opacity {
            1.0 if is_glass_model => 1.0,
            opacity => 1.0 - opacity,
        };
        let seems_metal = transmission == 0.0
            && self.model.is_none_or(|m| m >= 2)
            && peak(specular) >= METAL_SPECULAR
            && self.diffuse_map.is_none()
            && peak(diffuse) < METAL_DIFFUSE_RATIO * peak(specular);
        let metallic = self.metallic.unwrap_or(f64::from(u8::from(seems_metal)));
        let base_color = if self.metallic.is_none() && seems_metal {
            specular
        } else if transmission > 0.5 {
            self.filter.unwrap_or([1.0; 3])
        } else {
            diffuse
        };
        // Programs write `Ns` also for diffuse materials.
        let is_specular = seems_metal || transmission > 0.0 || peak(specular) > 0.0;
        let from_exponent = self
            .exponent
            .filter(|_| is_specular)
            .map(|n| (2.0 / (n.max(0.0) + 2.0)).powf(0.25));
        MeshMaterial {
            name: self.name,
            base_color: base_color.map(|c| c.clamp(0.0, 1.0)),
            uv_transform: self
                .diffuse_map
                .as_ref()
                .map_or(plain.uv_transform, DiffuseMap::uv_transform),
            base_color_image: self.diffuse_map.map(|map| ImageSource::File(map.file)),
            metallic: metallic.clamp(0.0, 1.0),
            roughness: self
                .roughness
                .or(from_exponent)
                .unwrap_or(if transmission > 0.0 {
                    0.0
                } else {
                    plain.roughness
                })
                .clamp(0.0, 1.0),
            transmission,
            ior: self
                .ior
                .filter(|n| (1.0..=4.0).contains(n))
                .unwrap_or(plain.ior),
            emission: self.emission.unwrap_or_default().map(|c| c.max(0.0)),
            ..plain
        }
    }
}

/// Stores a value, or returns the warning of `bad`.
fn store<T>(
    slot: &mut Option<T>,
    value: Option<T>,
    bad: impl Fn() -> Option<String>,
) -> Option<String> {
    if value.is_none() {
        return bad();
    }
    *slot = value;
    None
}

/// Parses one (grey) to three numbers; spectral files and XYZ are not supported.
fn color(words: &str) -> Option<[f64; 3]> {
    let mut numbers = words.split_whitespace().map(|word| word.parse::<f64>());
    let red = numbers.next()?.ok()?;
    let green = numbers.next().map_or(Some(red), Result::ok)?;
    let blue = numbers.next().map_or(Some(red), Result::ok)?;
    let all = [red, green, blue];
    all.iter().all(|c| c.is_finite()).then_some(all)
}

/// Parses options and the file name, which may contain spaces and backslashes.
fn diffuse_map(words: &str) -> Option<DiffuseMap> {
    let (mut scale, mut offset) = ([1.0; 2], [0.0; 2]);
    let mut rest = words.trim();
    while let Some((option, max_values)) = MAP_OPTIONS.iter().find(|(option, _)| {
        let first = rest.split_whitespace().next();
        first.is_some_and(|word| word.eq_ignore_ascii_case(option))
    }) {
        rest = rest[option.len()..].trim_start();
        for count in 0..*max_values {
            let word = rest.split_whitespace().next()?;
            let number = word.parse::<f64>().ok();
            if count > 0 && number.is_none() {
                break;
            }
            rest = rest[word.len()..].trim_start();
            let slot = match *option {
                "-s" => scale.get_mut(count),
                "-o" => offset.get_mut(count),
                _ => None,
            };
            if let (Some(slot), Some(number)) = (slot, number.filter(|n| n.is_finite())) {
                *slot = number;
            }
        }
    }
    let file = rest.trim_matches('"').replace('\\', "/");
    (!file.is_empty()).then_some(DiffuseMap {
        file,
        scale,
        offset,
    })
}
