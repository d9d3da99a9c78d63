//! Appearances of an object without a language model.

use super::look::{Appearance, Modifier, linear_rgb};
use super::material::Material;
use super::surface::{Coat, Shade, State};
use gripcast_base::random::SeedStream;

/// Appearances per object, as in the paper (A.1, Texture).
pub const APPEARANCES: usize = 5;

/// Draws that may fail before any combination that is left is taken.
const DRAWS: usize = 64;
/// Largest relative change of a shade from object to object.
const SHADE_CHANGE: f64 = 0.08;
/// Largest change of the roughness from object to object.
const ROUGHNESS_CHANGE: f64 = 0.04;

/// Five different appearances of a material, composed of a state (wear, pattern), a shade and the
/// coat: `scratched blue enamel`, `raw light oak`. Shades come twice only when there are too few.
///
/// The words and looks depend on `seed`, `object` (its name) and the material alone.
pub fn builtin_appearances(object: &str, material: &Material, seed: u64) -> Vec<Modifier> {
    let name = format!("appearance/{}/{object}", material.name);
    let mut stream = SeedStream::named(seed, &name);
    let mut chosen: Vec<Modifier> = Vec::with_capacity(APPEARANCES);
    let mut shades: Vec<&String> = Vec::new();
    let mut draw = 0;
    while chosen.len() < APPEARANCES {
        let Some((coat, state, shade)) = drawn(material, &mut stream, draw) else {
            break;
        };
        draw += 1;
        let words = phrase(coat, state, shade);
        let known = chosen.iter().any(|m| m.words == words);
        let same_shade = draw <= DRAWS && shades.contains(&&shade.0);
        if !known && !same_shade {
            shades.push(&shade.0);
            chosen.push(Modifier {
                words,
                look: look(coat, state, shade, &mut stream),
            });
        }
    }
    chosen
}

/// A combination by chance; after the first draws all of them in their order.
fn drawn<'a>(
    material: &'a Material,
    stream: &mut SeedStream,
    draw: usize,
) -> Option<(&'a Coat, &'a State, &'a Shade)> {
    if draw < DRAWS {
        let coat = material.coats.get(stream.index(material.coats.len()))?;
        let state = coat.states.get(stream.index(coat.states.len()))?;
        let shade = coat.shades.get(stream.index(coat.shades.len()))?;
        return Some((coat, state, shade));
    }
    let mut all = material.coats.iter().flat_map(|coat| {
        let pairs = coat.shades.iter();
        pairs.flat_map(move |shade| coat.states.iter().map(move |state| (coat, state, shade)))
    });
    all.nth(draw - DRAWS)
}

fn phrase(coat: &Coat, state: &State, shade: &Shade) -> String {
    let words = [&state.0, &shade.0, &coat.noun].map(String::as_str);
    let said = words.into_iter().filter(|w| !w.is_empty());
    said.collect::<Vec<_>>().join(" ")
}

fn look(coat: &Coat, state: &State, shade: &Shade, stream: &mut SeedStream) -> Appearance {
    let brightness = stream.between(1.0 - SHADE_CHANGE, 1.0 + SHADE_CHANGE) as f32;
    let rougher = stream.between(-ROUGHNESS_CHANGE, ROUGHNESS_CHANGE) as f32;
    // What is clear stays clear.
    let change = if state.2 < 0.05 { 0.0 } else { rougher };
    Appearance {
        finish: coat.finish,
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
    fn every_material_has_five_different_appearances() {
        for material in Material::all() {
            for seed in 0..20 {
                let five = builtin_appearances("thing", material, seed);
                let words: BTreeSet<_> = five.iter().map(|m| &m.words).collect();
                assert_eq!(words.len(), APPEARANCES, "{}: {words:?}", material.name);
                for Modifier { words, look } in &five {
                    assert!(!words.contains("  ") && words.trim() == words, "{words:?}");
                    assert!((0.0..=1.0).contains(&look.roughness), "{words}: {look:?}");
                    let rgb = look.base_colour;
                    assert!(
                        rgb.iter().all(|c| (0.0..=1.0).contains(c)),
                        "{words}: {look:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn appearances_depend_on_seed_and_object_alone() {
        let steel = Material::named("steel").unwrap();
        let first = builtin_appearances("spoon", steel, 7);
        assert_eq!(first, builtin_appearances("spoon", steel, 7));
        assert_ne!(first, builtin_appearances("spoon", steel, 8));
        assert_ne!(first, builtin_appearances("fork", steel, 7));
    }

    #[test]
    fn words_and_look_say_the_same() {
        let steel = Material::named("steel").unwrap();
        let all: Vec<_> = (0..200)
            .flat_map(|s| builtin_appearances("box", steel, s))
            .collect();
        let find = |words: &str| &all.iter().find(|m| m.words == words).unwrap().look;
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
                .map(|m| m.look.base_colour[0].to_bits())
                .collect();
            all.len()
        };
        assert!((0..50).all(|s| shades(s) == APPEARANCES));
    }

    #[test]
    fn a_modifier_survives_its_file() {
        let glass = Material::named("glass").unwrap();
        for modifier in builtin_appearances("jar", glass, 3) {
            let text = serde_json::to_string(&modifier).unwrap();
            assert_eq!(serde_json::from_str::<Modifier>(&text).unwrap(), modifier);
        }
    }
}
