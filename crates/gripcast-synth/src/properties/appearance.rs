//! Appearances of objects, and those from the table of materials.

use serde::{Deserialize, Serialize};

use super::material::Material;
use super::surface::{Shade, State, Surface};
use gripcast_base::random::SeedStream;
use gripcast_imaging::srgb_decode;
use gripcast_visual::Appearance;

/// Appearances per object, as in the paper (A.1, Texture).
pub const APPEARANCES: usize = 5;

/// Random draws before the remaining combinations are tried in order.
const DRAWS: usize = 64;
/// Maximum relative variation of a shade between objects.
const SHADE_CHANGE: f64 = 0.08;
/// Maximum variation of the roughness between objects.
const ROUGHNESS_CHANGE: f64 = 0.04;

/// An appearance with its description.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DescribedAppearance {
    /// Words before the category, for instance `scratched blue enamel`.
    #[serde(rename = "words")]
    pub description: String,
    /// Appearance for the renderer.
    #[serde(rename = "look")]
    pub appearance: Appearance,
}

/// Converts an sRGB colour 0xRRGGBB to linear RGB.
pub(super) fn linear_rgb(hex: u32) -> [f32; 3] {
    let [_, r, g, b] = hex.to_be_bytes();
    [r, g, b].map(srgb_decode)
}

/// Draws five different appearances of a material: combinations of a state (wear, pattern), a shade
/// and a surface, for instance `scratched blue enamel` or `raw light oak`. A shade repeats only if
/// there are too few.
///
/// The result depends only on `seed`, `object` (its name) and the material.
pub fn builtin_appearances(
    object: &str,
    material: &Material,
    seed: u64,
) -> Vec<DescribedAppearance> {
    let name = format!("appearance/{}/{object}", material.name);
    let mut stream = SeedStream::named(seed, &name);
    let mut chosen: Vec<DescribedAppearance> = Vec::with_capacity(APPEARANCES);
    let mut shades: Vec<&String> = Vec::new();
    let mut draw = 0;
    while chosen.len() < APPEARANCES {
        let Some((surface, state, shade)) = drawn(material, &mut stream, draw) else {
            break;
        };
        draw += 1;
        let description = description(surface, state, shade);
        let is_duplicate = chosen.iter().any(|other| other.description == description);
        let same_shade = draw <= DRAWS && shades.contains(&&shade.0);
        if !is_duplicate && !same_shade {
            shades.push(&shade.0);
            chosen.push(DescribedAppearance {
                description,
                appearance: appearance(surface, state, shade, &mut stream),
            });
        }
    }
    chosen
}

/// Draws a random combination; after [`DRAWS`] draws, returns all of them in order.
fn drawn<'a>(
    material: &'a Material,
    stream: &mut SeedStream,
    draw: usize,
) -> Option<(&'a Surface, &'a State, &'a Shade)> {
    if draw < DRAWS {
        let surface = material
            .surfaces
            .get(stream.index(material.surfaces.len()))?;
        let state = surface.states.get(stream.index(surface.states.len()))?;
        let shades = surface.shades();
        let shade = shades.get(stream.index(shades.len()))?;
        return Some((surface, state, shade));
    }
    let mut all = material.surfaces.iter().flat_map(|surface| {
        let pairs = surface.shades().iter();
        pairs.flat_map(move |shade| {
            surface
                .states
                .iter()
                .map(move |state| (surface, state, shade))
        })
    });
    all.nth(draw - DRAWS)
}

fn description(surface: &Surface, state: &State, shade: &Shade) -> String {
    let words = [&state.0, &shade.0, &surface.noun].map(String::as_str);
    let words = words.into_iter().filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join(" ")
}

fn appearance(
    surface: &Surface,
    state: &State,
    shade: &Shade,
    stream: &mut SeedStream,
) -> Appearance {
    let brightness = stream.between(1.0 - SHADE_CHANGE, 1.0 + SHADE_CHANGE) as f32;
    let variation = stream.between(-ROUGHNESS_CHANGE, ROUGHNESS_CHANGE) as f32;
    // Clear surfaces stay clear.
    let change = if state.2 < 0.05 { 0.0 } else { variation };
    Appearance {
        finish: surface.finish,
        base_colour: linear_rgb(shade.1).map(|c| (c * brightness).clamp(0.0, 1.0)),
        roughness: (state.2 + change).clamp(0.0, 1.0),
        pattern: state.1,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_material_has_five_distinct_appearances() {
        for material in Material::all() {
            for seed in 0..20 {
                let five = builtin_appearances("thing", material, seed);
                let words: BTreeSet<_> = five.iter().map(|m| &m.description).collect();
                assert_eq!(words.len(), APPEARANCES, "{}: {words:?}", material.name);
                for DescribedAppearance {
                    description,
                    appearance,
                } in &five
                {
                    assert!(!description.contains("  ") && description.trim() == description);
                    assert!((0.0..=1.0).contains(&appearance.roughness), "{description}");
                    let rgb = appearance.base_colour;
                    assert!(rgb.iter().all(|c| (0.0..=1.0).contains(c)), "{description}");
                }
            }
        }
    }

    #[test]
    fn appearances_depend_only_on_seed_and_object() {
        let steel = Material::named("steel").unwrap();
        let first = builtin_appearances("spoon", steel, 7);
        assert_eq!(first, builtin_appearances("spoon", steel, 7));
        assert_ne!(first, builtin_appearances("spoon", steel, 8));
        assert_ne!(first, builtin_appearances("fork", steel, 7));
    }

    #[test]
    fn description_matches_appearance() {
        let steel = Material::named("steel").unwrap();
        let all: Vec<_> = (0..200)
            .flat_map(|s| builtin_appearances("box", steel, s))
            .collect();
        let find = |words: &str| {
            &all.iter()
                .find(|m| m.description == words)
                .unwrap()
                .appearance
        };
        let enamel = find("scratched blue enamel");
        assert_eq!(
            serde_json::to_string(&[enamel.finish]).unwrap() + &format!("{:?}", enamel.pattern),
            "[\"ceramic\"]Scratched"
        );
        let [r, g, b] = enamel.base_colour;
        assert!(b > 2.0 * g && g > r, "{enamel:?}");
        let shades = |s| {
            let five = builtin_appearances("box", steel, s);
            let all: BTreeSet<_> = five
                .iter()
                .map(|m| m.appearance.base_colour[0].to_bits())
                .collect();
            all.len()
        };
        assert!((0..50).all(|s| shades(s) == APPEARANCES));
    }

    #[test]
    fn appearance_survives_serialisation() {
        let glass = Material::named("glass").unwrap();
        for drawn in builtin_appearances("jar", glass, 3) {
            let text = serde_json::to_string(&drawn).unwrap();
            assert_eq!(
                serde_json::from_str::<DescribedAppearance>(&text).unwrap(),
                drawn
            );
        }
    }
}
