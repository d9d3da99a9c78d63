//! Appearances from English descriptions, as a language model writes them.

use super::appearance::{DescribedAppearance, linear_rgb};
use super::material::Material;
use super::surface::{SURFACES, Shade};
use gripcast_base::random::SeedStream;
use gripcast_visual::Appearance;
use gripcast_visual::FinishClass::{
    self, Ceramic, Fabric, Glass, Metal, Organic, Paper, Plastic, Print, Rubber, Stone, Wood,
};
use gripcast_visual::SurfacePattern::{self, Grain, Plain, Printed, Speckled, Woven};

impl DescribedAppearance {
    /// Interprets a description. Unspecified properties are those of the bare `material`, with a
    /// random colour.
    pub fn from_words(description: &str, material: &Material, seed: u64) -> Self {
        Self {
            description: description.to_owned(),
            appearance: interpret(description, material, seed),
        }
    }
}

fn interpret(description: &str, material: &Material, seed: u64) -> Appearance {
    let text = description.to_lowercase();
    let words: Vec<&str> = text
        .split(|c: char| !c.is_alphabetic())
        .filter(|w| !w.is_empty())
        .collect();
    let stems = &SURFACES.words;
    let finish = last_match(&words, &stems.finishes).unwrap_or_else(|| material.finish());
    let pattern = last_match(&words, &stems.patterns).unwrap_or(default_pattern(finish));
    let roughness = last_match(&words, &stems.roughness).unwrap_or(default_roughness(finish));
    let mut stream = SeedStream::named(seed, &format!("look/{text}"));
    let hex = named_colour(&words).unwrap_or_else(|| random_colour(finish, material, &mut stream));
    Appearance {
        finish,
        base_colour: linear_rgb(hex),
        roughness,
        pattern,
    }
}

/// Returns the meaning of the last word that starts with one of the stems.
fn last_match<T: Copy>(words: &[&str], stems: &[(String, T)]) -> Option<T> {
    let meaning = |word: &&str| stems.iter().find(|(stem, _)| word.starts_with(&**stem));
    let found = words.iter().rev().find_map(meaning);
    found.map(|(_, value)| *value)
}

/// Finds a named colour: paint before kinds of wood before bare materials, the longest name first,
/// so that `light blue` is not `blue`.
fn named_colour(words: &[&str]) -> Option<u32> {
    let text = format!(" {} ", words.join(" "));
    let longest = |shades: &[Shade]| {
        let named = shades
            .iter()
            .filter(|(name, _)| text.contains(&format!(" {name} ")));
        named
            .max_by_key(|(name, _)| name.len())
            .map(|(_, hex)| *hex)
    };
    let gray = words.contains(&"gray").then_some(0x8A_8C8E);
    let wood = words.contains(&"oak").then_some(0xC4_A26E);
    let shades = &SURFACES.shades;
    // The first three clear shades are those of paint, or none.
    let clear = shades.clear.get(3..).unwrap_or_default();
    longest(&shades.paint)
        .or(gray)
        .or_else(|| longest(&shades.wood))
        .or(wood)
        .or_else(|| longest(clear))
        .or_else(|| last_match(words, &shades.bare))
}

fn random_colour(finish: FinishClass, material: &Material, stream: &mut SeedStream) -> u32 {
    let surface = material.surfaces.iter().find(|s| s.finish == finish);
    let shared = &SURFACES.shades;
    let shades = match (surface, finish) {
        (Some(surface), _) => surface.shades(),
        (None, Wood) => &shared.wood,
        (None, Glass) => &shared.clear,
        // Silver to aluminium.
        (None, Metal) => shared.bare.get(4..8).unwrap_or_default(),
        (None, _) => &shared.paint,
    };
    shades
        .get(stream.index(shades.len()))
        .map_or(0x80_8080, |(_, hex)| *hex)
}

fn default_pattern(finish: FinishClass) -> SurfacePattern {
    match finish {
        Wood => Grain,
        Fabric => Woven,
        Print => Printed,
        Stone => Speckled,
        _ => Plain,
    }
}

fn default_roughness(finish: FinishClass) -> f32 {
    match finish {
        Glass => 0.0,
        Ceramic => 0.15,
        Metal => 0.25,
        Plastic | Print => 0.35,
        Wood | Organic => 0.55,
        Rubber | Stone => 0.7,
        Paper => 0.85,
        Fabric => 0.9,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_visual::SurfacePattern::{Brushed, Scratched, Worn};

    fn look(words: &str) -> Appearance {
        interpret(words, Material::named("abs").unwrap(), 1)
    }

    #[test]
    fn words_define_finish_colour_pattern_and_roughness() {
        let enamel = look("Scratched light blue enamel");
        assert_eq!((enamel.finish, enamel.pattern), (Ceramic, Scratched));
        assert_eq!(enamel.base_colour, linear_rgb(0x86_B4D6));
        let oak = look("weathered oak");
        assert_eq!((oak.finish, oak.pattern, oak.roughness), (Wood, Worn, 0.75));
        let steel = look("brushed stainless steel");
        assert_eq!(
            (steel.finish, steel.pattern, steel.roughness),
            (Metal, Brushed, 0.35)
        );
        assert_eq!(look("matte black").roughness, 0.65);
        assert_eq!(look("rustic stoneware").finish, Ceramic);
        assert_eq!(look("rustic stoneware").pattern, Worn);
        // The noun comes last.
        assert_eq!(look("wood-print plastic").finish, Plastic);
        assert_eq!(look("polished gold").base_colour, linear_rgb(0xD9_B45E));
    }

    #[test]
    fn unspecified_properties_come_from_the_material() {
        let pale = look("mysterious");
        assert_eq!((pale.finish, pale.pattern), (Plastic, Plain));
        assert_eq!(pale, look("mysterious"));
        let glass = interpret("old", Material::named("glass").unwrap(), 1);
        assert_eq!((glass.finish, glass.roughness), (Glass, 0.0));
        assert_eq!(look("").finish, Plastic);
        let seeds: Vec<_> = (0..20)
            .map(|s| interpret("smooth", Material::named("abs").unwrap(), s).base_colour)
            .collect();
        assert!(seeds.iter().any(|c| *c != seeds[0]));
    }
}
