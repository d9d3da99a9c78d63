//! The look that words of a language model stand for.

use super::look::FinishClass::{
    self, Ceramic, Fabric, Glass, Metal, Organic, Paper, Plastic, Print, Rubber, Stone, Wood,
};
use super::look::PatternWord::{self, Grain, Plain, Printed, Speckled, Woven};
use super::look::{Look, Modifier, linear_rgb};
use super::material::Material;
use super::surface::{SURFACES, Shade};
use gripcast_base::random::SeedStream;

impl Modifier {
    /// An appearance of a thing of `material` in English words; what they leave open is that of
    /// the bare material, the colour one by chance.
    pub fn from_words(words: &str, material: &Material, seed: u64) -> Self {
        Self {
            words: words.to_owned(),
            look: look_of_words(words, material, seed),
        }
    }
}

/// The look of an appearance in English words. What the words leave open is that of the bare
/// material, the colour one by chance.
fn look_of_words(words: &str, material: &Material, seed: u64) -> Look {
    let text = words.to_lowercase();
    let spoken: Vec<&str> = text
        .split(|c: char| !c.is_alphabetic())
        .filter(|w| !w.is_empty())
        .collect();
    let known = &SURFACES.words;
    let finish = last(&spoken, &known.finishes).unwrap_or_else(|| material.finish());
    let pattern = last(&spoken, &known.patterns).unwrap_or(usual_pattern(finish));
    let roughness = last(&spoken, &known.roughness).unwrap_or(usual_roughness(finish));
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
fn last<T: Copy>(spoken: &[&str], known: &[(String, T)]) -> Option<T> {
    let meaning = |word: &&str| known.iter().find(|(stem, _)| word.starts_with(&**stem));
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
    let shades = &SURFACES.shades;
    // The other colours of clear things are those of paint, or none.
    let clear = shades.clear.get(3..).unwrap_or_default();
    longest(&shades.paint)
        .or(gray)
        .or_else(|| longest(&shades.wood))
        .or(wood)
        .or_else(|| longest(clear))
        .or_else(|| last(spoken, &shades.bare))
}

fn any_colour(finish: FinishClass, material: &Material, stream: &mut SeedStream) -> u32 {
    let bare = material.coats.iter().find(|c| c.finish == finish);
    let known = &SURFACES.shades;
    let shades = match (bare, finish) {
        (Some(coat), _) => &coat.shades,
        (None, Wood) => &known.wood,
        (None, Glass) => &known.clear,
        // Silver to aluminium.
        (None, Metal) => known.bare.get(4..8).unwrap_or_default(),
        (None, _) => &known.paint,
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
    use super::super::look::PatternWord::{Brushed, Scratched, Worn};
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
