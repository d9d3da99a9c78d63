//! The embedded table `surfaces.toml`: materials, their surfaces, and words that describe surfaces.

use std::collections::HashMap;
use std::sync::LazyLock;

use serde::Deserialize;

use super::material::Material;
use gripcast_visual::{FinishClass, SurfacePattern};

/// A colour word and its colour, sRGB 0xRRGGBB.
pub(super) type Shade = (String, u32);
/// A word for a state, its pattern and roughness.
pub(super) type State = (String, SurfacePattern, f32);

/// A kind of surface; each of its states combines with each of its shades.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Surface {
    /// How it reflects light.
    pub(super) finish: FinishClass,
    /// Word after state and shade; empty if the shade names the material.
    pub(super) noun: String,
    pub(super) states: Vec<State>,
    shades: ShadeList,
}

/// A list of [`Shades`] by name, or the shades themselves.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(untagged)]
enum ShadeList {
    Named(String),
    Own(Vec<Shade>),
}

impl Surface {
    pub(super) fn shades(&self) -> &[Shade] {
        match &self.shades {
            ShadeList::Own(shades) => shades,
            ShadeList::Named(name) => match &name[..] {
                "paint" => &SURFACES.shades.paint,
                "wood" => &SURFACES.shades.wood,
                "clear" => &SURFACES.shades.clear,
                _ => &[],
            },
        }
    }
}

/// Word stems and their meaning.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Words {
    pub(super) finishes: Vec<(String, FinishClass)>,
    pub(super) patterns: Vec<(String, SurfacePattern)>,
    pub(super) roughness: Vec<(String, f32)>,
}

/// Shared lists of shades.
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

/// The parsed table; tests check that it is valid.
pub(super) static SURFACES: LazyLock<Surfaces> = LazyLock::new(|| {
    toml::from_str::<File>(include_str!("surfaces.toml"))
        .map_or_else(|_| Surfaces::default(), Surfaces::from)
});

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    materials: Vec<(String, f64, [f64; 2], Vec<String>)>,
    surfaces: HashMap<String, Surface>,
    shades: Shades,
    words: Words,
    fills: HashMap<String, f64>,
}

impl From<File> for Surfaces {
    fn from(file: File) -> Self {
        let rows = file.materials.into_iter();
        let materials = rows.map(|(name, density_kg_m3, friction, surfaces)| Material {
            name,
            density_kg_m3,
            friction,
            surfaces: surfaces
                .iter()
                .filter_map(|surface| file.surfaces.get(surface).cloned())
                .collect(),
        });
        Self {
            materials: materials.collect(),
            shades: file.shades,
            words: file.words,
            fills: file.fills,
        }
    }
}
