//! Dome of light around the scene.

use super::picture::Picture;
use gripcast_base::error::{Error, ErrorKind, Result};

/// Light from infinitely far away: radiance over directions, as a latitude-longitude picture.
///
/// The top row of the picture lies around the world's +z, the bottom row around −z. Without
/// rotation the middle column looks along +x, columns further right lie clockwise seen from above
/// (towards −y), so that the picture appears as it was taken. Pixel centres are at (i + ½)/n;
/// between them radiance is interpolated bilinearly.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    /// Radiance, linear RGB; usually twice as wide as high.
    pub map: Picture,
    /// Turns the dome about the world's z, counter-clockwise seen from above, rad.
    pub rotation_rad: f32,
    /// Factor on all radiance.
    pub intensity: f32,
}

impl Environment {
    /// Dome from a latitude-longitude picture, not turned, intensity 1.
    pub fn new(map: Picture) -> Self {
        Self {
            map,
            rotation_rad: 0.0,
            intensity: 1.0,
        }
    }

    /// The same radiance from all directions.
    pub fn uniform(radiance: [f32; 3]) -> Self {
        Self::new(Picture::filled(4, 2, radiance))
    }

    pub(super) fn validate(&self) -> Result<()> {
        let bad = |what: String| Err(Error::new(ErrorKind::Input, what));
        let (width, height) = (self.map.width, self.map.height);
        if width == 0 || height == 0 || self.map.pixels.len() != width * height {
            let found = self.map.pixels.len();
            return bad(format!(
                "a map of {width}×{height} must have that many pixels, found {found}"
            ));
        }
        if !self.rotation_rad.is_finite() {
            let found = self.rotation_rad;
            return bad(format!("the rotation must be finite, found {found}"));
        }
        if !(0.0..=f32::MAX).contains(&self.intensity) {
            let found = self.intensity;
            return bad(format!("the intensity must not be negative, found {found}"));
        }
        let wrong = |p: &[f32; 3]| p.iter().any(|v| !(0.0..=f32::MAX).contains(v));
        if let Some(at) = self.map.pixels.iter().position(wrong) {
            let (column, row) = (at % width, at / width);
            let found = self.map.pixels[at];
            return bad(format!(
                "radiance must be finite and not negative, found {found:?} in column {column}, row {row}"
            ));
        }
        Ok(())
    }
}
