//! What a surface looks like, in words and for the renderer.

use serde::{Deserialize, Serialize};

use crate::imaging::srgb_decode;

/// How a surface reflects light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
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

/// What is drawn on the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum PatternWord {
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

/// Surface of a whole object, as the renderer needs it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Look {
    /// How it reflects light.
    pub finish: FinishClass,
    /// Main colour, linear RGB in [0, 1]; of glass what passes through.
    pub base_colour: [f32; 3],
    /// 0 mirror to 1 dull.
    pub roughness: f32,
    /// What is drawn on it.
    pub pattern: PatternWord,
}

/// An appearance of an object: the words that come before its category, and the look.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Modifier {
    /// For instance `scratched blue enamel`.
    pub words: String,
    /// What these words look like.
    pub look: Look,
}

/// Linear RGB of a colour written as 0xRRGGBB in sRGB.
pub(super) fn linear_rgb(hex: u32) -> [f32; 3] {
    let [_, r, g, b] = hex.to_be_bytes();
    [r, g, b].map(srgb_decode)
}
