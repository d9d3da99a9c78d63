//! What the surface of a whole object looks like, in words and numbers.

use serde::{Deserialize, Serialize};

use super::material::in_range;
use gripcast_base::error::Result;

/// How a surface reflects light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FinishClass {
    /// Wood with its grain.
    Wood,
    /// Bare metal.
    Metal,
    /// Cloth.
    Fabric,
    /// Glazed ceramic or enamel.
    Ceramic,
    /// Opaque plastic, paint or wax.
    Plastic,
    /// Print on paper, carton or foil.
    Print,
    /// Clear or tinted glass or plastic: light passes through.
    Glass,
    /// Stone or concrete.
    Stone,
    /// Rubber, silicone or foam.
    Rubber,
    /// Paper or cardboard without print.
    Paper,
    /// Leather, peel, food.
    Organic,
}

impl FinishClass {
    /// All of them.
    pub const ALL: [Self; 11] = [
        Self::Wood,
        Self::Metal,
        Self::Fabric,
        Self::Ceramic,
        Self::Plastic,
        Self::Print,
        Self::Glass,
        Self::Stone,
        Self::Rubber,
        Self::Paper,
        Self::Organic,
    ];
}

/// What is drawn on the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SurfacePattern {
    /// One colour.
    Plain,
    /// Lines of wood.
    Grain,
    /// Fine parallel lines.
    Brushed,
    /// Crossing threads.
    Woven,
    /// Loops of yarn.
    Knitted,
    /// Stripes of two colours.
    Striped,
    /// Dots of another colour.
    Dotted,
    /// Small specks.
    Speckled,
    /// Clouds of darker and lighter colour.
    Mottled,
    /// Veins.
    Marbled,
    /// Scratches.
    Scratched,
    /// Edges and corners rubbed off.
    Worn,
    /// Spots of rust or tarnish.
    Rusty,
    /// Fine cracks.
    Cracked,
    /// Text and fields of colour.
    Printed,
}

impl SurfacePattern {
    /// All of them.
    pub const ALL: [Self; 15] = [
        Self::Plain,
        Self::Grain,
        Self::Brushed,
        Self::Woven,
        Self::Knitted,
        Self::Striped,
        Self::Dotted,
        Self::Speckled,
        Self::Mottled,
        Self::Marbled,
        Self::Scratched,
        Self::Worn,
        Self::Rusty,
        Self::Cracked,
        Self::Printed,
    ];
}

/// Surface of a whole object, as [`Model::coated`](super::Model::coated) draws it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Appearance {
    /// How it reflects light.
    pub finish: FinishClass,
    /// Main colour, linear RGB in [0, 1]; of glass what passes through a body.
    pub base_colour: [f32; 3],
    /// 0 mirror to 1 dull.
    pub roughness: f32,
    /// What is drawn on it.
    pub pattern: SurfacePattern,
}

impl Appearance {
    /// Checks the ranges of the numbers.
    ///
    /// # Errors
    /// `Input` for a colour or a roughness outside [0, 1].
    pub fn validate(&self) -> Result<()> {
        let checked = in_range("base_colour", &self.base_colour, 0.0..=1.0)
            .and_then(|()| in_range("roughness", &[self.roughness], 0.0..=1.0));
        checked.map_err(|e| e.at("appearance"))
    }

    /// Whether its surface is damaged all over.
    pub(super) fn is_worn(&self) -> bool {
        use SurfacePattern::{Cracked, Rusty, Scratched, Worn};
        matches!(self.pattern, Scratched | Worn | Rusty | Cracked)
    }

    /// Whether it is a print, with colours beside the base colour.
    pub(super) fn is_print(&self) -> bool {
        self.finish == FinishClass::Print || self.pattern == SurfacePattern::Printed
    }
}
