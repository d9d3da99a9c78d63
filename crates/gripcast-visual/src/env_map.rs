//! Environment map around the scene.

use super::linear_image::Image;
use super::material::ensure;
use gripcast_base::error::Result;

/// Environment map: radiance arriving from infinity over all directions, as a latitude-longitude
/// image.
///
/// The top row of the image is the world's +z, the bottom row −z. Without rotation the centre
/// column is +x and columns further right lie clockwise seen from above (towards −y), so that the
/// image appears as it was taken. Pixel centres are at (i + ½)/n; radiance is interpolated
/// bilinearly.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvMap {
    /// Radiance, linear RGB; usually twice as wide as high.
    pub map: Image,
    /// Rotation about the world's z axis, counter-clockwise seen from above, rad.
    pub rotation_rad: f32,
    /// Factor on all radiance.
    pub intensity: f32,
}

impl EnvMap {
    /// Environment map with intensity 1 and no rotation.
    pub fn new(map: Image) -> Self {
        Self {
            map,
            rotation_rad: 0.0,
            intensity: 1.0,
        }
    }

    /// Constant radiance from all directions.
    pub fn uniform(radiance: [f32; 3]) -> Self {
        Self::new(Image::filled(4, 2, radiance))
    }

    pub(super) fn validate(&self) -> Result<()> {
        let (width, height, found) = (self.map.width, self.map.height, self.map.pixels.len());
        ensure(found > 0 && found == width * height, || {
            format!(
                "an environment map of {width}×{height} must have as many pixels, found {found}"
            )
        })?;
        ensure(self.rotation_rad.is_finite(), || {
            format!("the rotation must be finite, found {}", self.rotation_rad)
        })?;
        ensure((0.0..=f32::MAX).contains(&self.intensity), || {
            format!(
                "the intensity must not be negative, found {}",
                self.intensity
            )
        })?;
        let is_invalid = |p: &[f32; 3]| p.iter().any(|v| !(0.0..=f32::MAX).contains(v));
        let invalid = self.map.pixels.iter().position(is_invalid);
        ensure(invalid.is_none(), || {
            let index = invalid.unwrap_or_default();
            let (column, row, found) = (index % width, index / width, self.map.pixels[index]);
            format!(
                "radiance must be finite and not negative, found {found:?} in column {column}, row {row}"
            )
        })
    }
}

/// Returns the linear RGB of a black body of 2000 to 12000 K with luminance 1.
///
/// The chromaticity is Krystek's approximation of the Planckian locus (Color Research &
/// Application, 1985).
pub(super) fn light_of_kelvin(kelvin: f32) -> [f32; 3] {
    let t = kelvin.clamp(2000.0, 12_000.0);
    let u = (0.860_117_76 + 1.541_182_5e-4 * t + 1.286_412_2e-7 * t * t)
        / (1.0 + 8.424_202_4e-4 * t + 7.081_452e-7 * t * t);
    let v = (0.317_398_73 + 4.228_062_4e-5 * t + 4.204_816_9e-8 * t * t)
        / (1.0 - 2.897_418_2e-5 * t + 1.614_560_5e-7 * t * t);
    let scale = 2.0 * u - 8.0 * v + 4.0;
    let (x, y) = (3.0 * u / scale, 2.0 * v / scale);
    let (big_x, big_z) = (x / y, (1.0 - x - y) / y);
    [
        3.240_97 * big_x - 1.537_383 - 0.498_611 * big_z,
        -0.969_244 * big_x + 1.875_968 + 0.041_555 * big_z,
        0.055_63 * big_x - 0.203_977 + 1.056_972 * big_z,
    ]
    .map(|c| c.max(0.0))
}
