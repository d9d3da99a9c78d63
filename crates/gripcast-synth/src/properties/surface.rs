//! The table of materials, their surfaces, and words for surfaces: `surfaces.toml`.

use std::collections::HashMap;
use std::sync::LazyLock;

use serde::Deserialize;

use super::look::{FinishClass, SurfacePattern};
use super::material::Material;

/// A colour word and its colour, sRGB 0xRRGGBB.
pub(super) type Shade = (String, u32);
/// A word for a state, its pattern and roughness.
pub(super) type State = (String, SurfacePattern, f32);

/// A kind of surface; each of its states goes with each of its shades.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Coat {
    /// How it reflects light.
    pub(super) finish: FinishClass,
    /// Word after state and shade; empty where the shade names the material.
    pub(super) noun: String,
    pub(super) states: Vec<State>,
    pub(super) shades: Vec<Shade>,
}

/// Stems of words and what they say.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Words {
    pub(super) finishes: Vec<(String, FinishClass)>,
    pub(super) patterns: Vec<(String, SurfacePattern)>,
    pub(super) roughness: Vec<(String, f32)>,
}

/// Shades by what has them.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Shades {
    pub(super) paint: Vec<Shade>,
    pub(super) wood: Vec<Shade>,
    pub(super) clear: Vec<Shade>,
    pub(super) bare: Vec<Shade>,
}

#[derive(Default)]
pub(super) struct Surfaces {
    pub(super) materials: Vec<Material>,
    pub(super) shades: Shades,
    pub(super) words: Words,
    pub(super) fills: HashMap<String, f64>,
}

/// What the file says; a test reads it.
pub(super) static SURFACES: LazyLock<Surfaces> = LazyLock::new(|| {
    toml::from_str::<File>(include_str!("surfaces.toml"))
        .map_or_else(|_| Surfaces::default(), Surfaces::of)
});

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    materials: Vec<(String, f64, [f64; 2], Vec<String>)>,
    coats: HashMap<String, CoatEntry>,
    shades: Shades,
    words: Words,
    fills: HashMap<String, f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CoatEntry {
    finish: FinishClass,
    noun: String,
    states: Vec<State>,
    shades: ShadeEntry,
}

/// Shades by the name of their list, or the shades.
#[derive(Deserialize)]
#[serde(untagged)]
enum ShadeEntry {
    Named(String),
    Own(Vec<Shade>),
}

impl Surfaces {
    fn of(file: File) -> Self {
        let shades = |entry: &ShadeEntry| match entry {
            ShadeEntry::Own(shades) => shades.clone(),
            ShadeEntry::Named(name) => match &name[..] {
                "paint" => file.shades.paint.clone(),
                "wood" => file.shades.wood.clone(),
                "clear" => file.shades.clear.clone(),
                _ => Vec::new(),
            },
        };
        let coat = |name: &String| {
            file.coats.get(name).map(|coat| Coat {
                finish: coat.finish,
                noun: coat.noun.clone(),
                states: coat.states.clone(),
                shades: shades(&coat.shades),
            })
        };
        let rows = file.materials.iter();
        let materials = rows.map(|(name, density_kg_m3, friction, coats)| Material {
            name: name.clone(),
            density_kg_m3: *density_kg_m3,
            friction: *friction,
            coats: coats.iter().filter_map(coat).collect(),
        });
        Self {
            materials: materials.collect(),
            shades: file.shades,
            words: file.words,
            fills: file.fills,
        }
    }
}
