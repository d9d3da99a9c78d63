//! The look that words of a language model stand for.

use super::coat::{COLOURS, Shade, TINTS, WOODS};
use super::look::FinishClass::{
    self, Ceramic, Fabric, Glass, Metal, Organic, Paper, Plastic, Print, Rubber, Stone, Wood,
};
use super::look::PatternWord::{
    self, Brushed, Cracked, Dotted, Grain, Knitted, Marbled, Mottled, Plain, Printed, Rusty,
    Scratched, Speckled, Striped, Worn, Woven,
};
use super::look::{Look, linear_rgb};
use super::material::Material;
use gripcast_base::random::SeedStream;

/// Stems of words that name what a surface is; the last one in the text counts, as the noun comes
/// last in English.
const FINISHES: &[(&str, FinishClass)] = &[
    ("wood", Wood),
    ("oak", Wood),
    ("walnut", Wood),
    ("bamboo", Wood),
    ("mahogany", Wood),
    ("teak", Wood),
    ("metal", Metal),
    ("steel", Metal),
    ("chrome", Metal),
    ("alumin", Metal),
    ("brass", Metal),
    ("copper", Metal),
    ("bronze", Metal),
    ("silver", Metal),
    ("gold", Metal),
    ("iron", Metal),
    ("cloth", Fabric),
    ("fabric", Fabric),
    ("cotton", Fabric),
    ("linen", Fabric),
    ("wool", Fabric),
    ("denim", Fabric),
    ("velvet", Fabric),
    ("felt", Fabric),
    ("canvas", Fabric),
    ("stoneware", Ceramic),
    ("ceramic", Ceramic),
    ("porcelain", Ceramic),
    ("enamel", Ceramic),
    ("glaze", Ceramic),
    ("plastic", Plastic),
    ("acrylic", Plastic),
    ("paint", Plastic),
    ("lacquer", Plastic),
    ("wax", Plastic),
    ("print", Print),
    ("label", Print),
    ("carton", Print),
    ("glass", Glass),
    ("crystal", Glass),
    ("transparent", Glass),
    ("translucent", Glass),
    ("stone", Stone),
    ("marble", Stone),
    ("granite", Stone),
    ("concrete", Stone),
    ("terracotta", Stone),
    ("clay", Stone),
    ("rubber", Rubber),
    ("silicone", Rubber),
    ("foam", Rubber),
    ("paper", Paper),
    ("cardboard", Paper),
    ("leather", Organic),
    ("cork", Organic),
    ("chocolate", Organic),
];

const PATTERNS: &[(&str, PatternWord)] = &[
    ("grain", Grain),
    ("brush", Brushed),
    ("woven", Woven),
    ("weave", Woven),
    ("knit", Knitted),
    ("strip", Striped),
    ("dot", Dotted),
    ("speckle", Speckled),
    ("freckle", Speckled),
    ("textured", Speckled),
    ("mottled", Mottled),
    ("stained", Mottled),
    ("hammer", Mottled),
    ("marbl", Marbled),
    ("vein", Marbled),
    ("scratch", Scratched),
    ("worn", Worn),
    ("weather", Worn),
    ("faded", Worn),
    ("distress", Worn),
    ("chip", Worn),
    ("vintage", Worn),
    ("rustic", Worn),
    ("rust", Rusty),
    ("tarnish", Rusty),
    ("patina", Rusty),
    ("crack", Cracked),
    ("print", Printed),
    ("floral", Printed),
    ("pattern", Printed),
    ("label", Printed),
];

const ROUGHNESS: &[(&str, f32)] = &[
    ("mirror", 0.05),
    ("polish", 0.15),
    ("gloss", 0.15),
    ("shiny", 0.15),
    ("lacquer", 0.20),
    ("satin", 0.40),
    ("brush", 0.35),
    ("smooth", 0.35),
    ("frost", 0.40),
    ("matt", 0.65),
    ("rough", 0.80),
    ("rust", 0.75),
    ("weather", 0.75),
    ("dusty", 0.85),
];

/// Colours of the bare material that a word names.
const METALS: &[Shade] = &[
    ("gold", 0xD9B45E),
    ("brass", 0xD9B45E),
    ("copper", 0xE09A74),
    ("bronze", 0xA6713F),
    ("silver", 0xD2D3D4),
    ("chrome", 0xC6C6C8),
    ("steel", 0xB4B5B8),
    ("alumin", 0xD2D3D4),
    ("iron", 0x5E6063),
    ("terracotta", 0xB5623C),
    ("denim", 0x33507A),
    ("cork", 0xC49B6A),
    ("chocolate", 0x4E3020),
];

/// The look of an appearance in English words. What the words leave open is that of the bare
/// material, the colour one by chance.
pub(super) fn look_of_words(words: &str, material: &Material, seed: u64) -> Look {
    let text = words.to_lowercase();
    let spoken: Vec<&str> = text
        .split(|c: char| !c.is_alphabetic())
        .filter(|w| !w.is_empty())
        .collect();
    let finish = last(&spoken, FINISHES).unwrap_or_else(|| material.finish());
    let pattern = last(&spoken, PATTERNS).unwrap_or(usual_pattern(finish));
    let roughness = last(&spoken, ROUGHNESS).unwrap_or(usual_roughness(finish));
    let mut stream = SeedStream::named(seed, &format!("look/{text}"));
    let hex = colour(&spoken).unwrap_or_else(|| any_colour(finish, material, &mut stream));
    Look {
        finish,
        base_colour: linear_rgb(hex),
        roughness,
        pattern,
    }
}

/// What the last word stands for that begins with a known stem.
fn last<T: Copy>(spoken: &[&str], known: &[(&str, T)]) -> Option<T> {
    let meaning = |word: &&str| known.iter().find(|(stem, _)| word.starts_with(stem));
    spoken
        .iter()
        .rev()
        .find_map(meaning)
        .map(|(_, value)| *value)
}

/// The colour that is named: paint before kinds of wood before bare materials, longest first, so
/// that `light blue` is not `blue`.
fn colour(spoken: &[&str]) -> Option<u32> {
    let spoken_text = format!(" {} ", spoken.join(" "));
    let longest = |shades: &[Shade]| {
        let named = shades
            .iter()
            .filter(|(name, _)| spoken_text.contains(&format!(" {name} ")));
        named
            .max_by_key(|(name, _)| name.len())
            .map(|(_, hex)| *hex)
    };
    let gray = spoken.contains(&"gray").then_some(0x8A_8C8E);
    let wood = spoken.contains(&"oak").then_some(0xC4_A26E);
    longest(COLOURS)
        .or(gray)
        .or_else(|| longest(WOODS))
        .or(wood)
        .or_else(|| longest(&TINTS[3..]))
        .or_else(|| last(spoken, METALS))
}

fn any_colour(finish: FinishClass, material: &Material, stream: &mut SeedStream) -> u32 {
    let bare = material.coats.iter().find(|c| c.finish == finish);
    let shades = match (bare, finish) {
        (Some(coat), _) => coat.shades,
        (None, Wood) => WOODS,
        (None, Glass) => TINTS,
        (None, Metal) => &METALS[4..8],
        (None, _) => COLOURS,
    };
    shades
        .get(stream.index(shades.len()))
        .map_or(0x80_8080, |(_, hex)| *hex)
}

fn usual_pattern(finish: FinishClass) -> PatternWord {
    match finish {
        Wood => Grain,
        Fabric => Woven,
        Print => Printed,
        Stone => Speckled,
        _ => Plain,
    }
}

fn usual_roughness(finish: FinishClass) -> f32 {
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

    fn look(words: &str) -> Look {
        look_of_words(words, Material::named("abs").unwrap(), 1)
    }

    #[test]
    fn words_name_finish_colour_pattern_and_roughness() {
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
    fn open_words_take_the_material() {
        let pale = look("mysterious");
        assert_eq!((pale.finish, pale.pattern), (Plastic, Plain));
        assert_eq!(pale, look("mysterious"));
        let glass = look_of_words("old", Material::named("glass").unwrap(), 1);
        assert_eq!((glass.finish, glass.roughness), (Glass, 0.0));
        assert_eq!(look("").finish, Plastic);
        let seeds: Vec<_> = (0..20)
            .map(|s| look_of_words("smooth", Material::named("abs").unwrap(), s).base_colour)
            .collect();
        assert!(seeds.iter().any(|c| *c != seeds[0]));
    }
}
