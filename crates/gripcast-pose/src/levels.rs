//! Levels of an image: what they say about the light.
//!
//! Corners are located in linear light (see [`crate::refine`]), which needs to know how the camera
//! encodes it. Most cameras follow sRGB; machine-vision cameras often send linear levels. Taken for
//! the other, every marker grows or shrinks by a few tenths of a pixel, which shows as a residual.

use std::borrow::Cow;

use gripcast_base::error::Result;
use gripcast_imaging::srgb_encode;
use image::GrayImage;

/// Residual below which sRGB is not questioned, px.
const CLEAR_PX: f64 = 0.08;
/// Linear levels must fit better than sRGB by this ratio and this difference, px.
const BETTER: (f64, f64) = (0.7, 0.04);

/// How levels encode light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Levels {
    /// IEC 61966-2-1, as almost all cameras.
    Srgb,
    /// Proportional to light.
    Linear,
}

impl Levels {
    /// Name on the command line and in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Srgb => "srgb",
            Self::Linear => "linear",
        }
    }

    /// The image with sRGB levels.
    #[must_use]
    pub fn to_srgb(self, image: &GrayImage) -> Cow<'_, GrayImage> {
        match self {
            Self::Srgb => Cow::Borrowed(image),
            Self::Linear => {
                let table: [u8; 256] = std::array::from_fn(|v| srgb_encode(v as f32 / 255.0));
                let mut encoded = image.clone();
                encoded.iter_mut().for_each(|p| *p = table[usize::from(*p)]);
                Cow::Owned(encoded)
            }
        }
    }
}

/// A measurement with the levels that fit it.
#[derive(Clone, Debug)]
pub struct ByLevels<T> {
    /// The levels.
    pub levels: Levels,
    /// The measurement.
    pub measured: T,
    /// Note for the user if the levels are not sRGB.
    pub note: Option<String>,
}

/// Measures an image with `levels`; `None`: with those of the smaller residual. `measure` gets the
/// image with sRGB levels and returns its result with its residual, px.
///
/// # Errors
/// Those of `measure` for sRGB or the given levels.
pub fn with_levels<T>(
    image: &GrayImage,
    levels: Option<Levels>,
    mut measure: impl FnMut(&GrayImage) -> Result<(T, f64)>,
) -> Result<ByLevels<T>> {
    let first = levels.unwrap_or(Levels::Srgb);
    let (measured, srgb_px) = measure(&first.to_srgb(image))?;
    if levels.is_none()
        && srgb_px > CLEAR_PX
        && let Ok((other, linear_px)) = measure(&Levels::Linear.to_srgb(image))
        && linear_px < BETTER.0 * srgb_px
        && linear_px < srgb_px - BETTER.1
    {
        let note = format!(
            "the levels are taken as linear: the residual is {linear_px:.2} px, as sRGB \
             {srgb_px:.2} px"
        );
        return Ok(ByLevels {
            levels: Levels::Linear,
            measured: other,
            note: Some(note),
        });
    }
    Ok(ByLevels {
        levels: first,
        measured,
        note: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;

    #[test]
    fn the_smaller_residual_decides() {
        let image = GrayImage::from_pixel(4, 4, Luma([55]));
        let residual_of = |srgb: f64, linear: f64| {
            move |seen: &GrayImage| {
                // 55/255 is sRGB level 128.
                let is_linear = seen.get_pixel(0, 0).0[0] == 128;
                Ok((is_linear, if is_linear { linear } else { srgb }))
            }
        };
        let chosen = |srgb, linear| with_levels(&image, None, residual_of(srgb, linear)).unwrap();
        let linear = chosen(0.25, 0.05);
        assert!(linear.levels == Levels::Linear && linear.measured);
        assert!(linear.note.unwrap().contains("0.05 px, as sRGB 0.25 px"));
        assert_eq!(chosen(0.05, 0.01).levels, Levels::Srgb);
        assert_eq!(chosen(0.5, 0.4).levels, Levels::Srgb);
        let given = with_levels(&image, Some(Levels::Linear), residual_of(0.1, 0.9)).unwrap();
        assert!(given.measured && given.note.is_none());
    }
}
