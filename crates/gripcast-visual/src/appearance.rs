//! Appearance of a whole object: finish, colour, roughness, pattern.

use serde::{Deserialize, Serialize};

use super::material::in_range;
use gripcast_base::error::Result;

/// Class of material that determines how a surface reflects light.
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
    /// Clear or tinted glass or plastic (transmissive).
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

#[cfg(test)]
impl FinishClass {
    pub(super) const ALL: [Self; 11] = [
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

/// Pattern on a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SurfacePattern {
    /// Single colour.
    Plain,
    /// Wood grain.
    Grain,
    /// Fine parallel lines of brushed metal.
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
    /// Rubbed edges and corners.
    Worn,
    /// Spots of rust or tarnish.
    Rusty,
    /// Fine cracks.
    Cracked,
    /// Text and fields of colour.
    Printed,
}

#[cfg(test)]
impl SurfacePattern {
    pub(super) const ALL: [Self; 15] = [
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

/// Appearance of a whole object, textured by
/// [`Model::with_appearance`](super::Model::with_appearance).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Appearance {
    /// Material class.
    pub finish: FinishClass,
    /// Base colour, linear RGB in [0, 1]; for glass the transmittance of the body.
    pub base_colour: [f32; 3],
    /// Perceptual roughness from 0 (mirror) to 1 (matt).
    pub roughness: f32,
    /// Pattern.
    pub pattern: SurfacePattern,
}

impl Appearance {
    /// Checks the ranges of the values.
    ///
    /// # Errors
    /// `Input` if the colour or the roughness is outside [0, 1].
    pub fn validate(&self) -> Result<()> {
        let checked = in_range("base_colour", &self.base_colour, 0.0..=1.0)
            .and_then(|()| in_range("roughness", &[self.roughness], 0.0..=1.0));
        checked.map_err(|e| e.at("appearance"))
    }

    /// Whether the pattern is damage over the whole surface.
    pub(super) fn is_worn(&self) -> bool {
        use SurfacePattern::{Cracked, Rusty, Scratched, Worn};
        matches!(self.pattern, Scratched | Worn | Rusty | Cracked)
    }

    /// Whether it is a print, which has colours beside the base colour.
    pub(super) fn is_print(&self) -> bool {
        self.finish == FinishClass::Print || self.pattern == SurfacePattern::Printed
    }
}
