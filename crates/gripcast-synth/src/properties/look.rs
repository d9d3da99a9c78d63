//! An appearance in words and as the renderer draws it.

use serde::{Deserialize, Serialize};

use gripcast_imaging::srgb_decode;
pub use gripcast_visual::{Appearance, FinishClass, SurfacePattern};

/// An appearance of an object: the words that come before its category, and the look.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Modifier {
    /// For instance `scratched blue enamel`.
    pub words: String,
    /// What these words look like.
    pub look: Appearance,
}

/// Linear RGB of a colour written as 0xRRGGBB in sRGB.
pub(super) fn linear_rgb(hex: u32) -> [f32; 3] {
    let [_, r, g, b] = hex.to_be_bytes();
    [r, g, b].map(srgb_decode)
}
