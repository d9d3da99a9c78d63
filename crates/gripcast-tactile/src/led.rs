//! LED shading: near point lights with diffuse and specular reflection.
//!
//! For an LED at p, a point of the face at q and the unit vector l from q to p, I = (d₀/|p − q|)² ·
//! (k_d max(n·l, 0) + k_s max(r_z, 0)^α), r = 2 (n·l) n − l (Phong), with the camera straight above
//! the face and d₀ the distance of the LED from the centre of the face. The change relative to the
//! untouched gel is Σ I(n) − Σ I(0, 0, 1), so slope-independent light cancels.

use serde::{Deserialize, Serialize};

use super::ensure;
use super::normals::Normals;
use super::press_depth::SensorGeometry;
use super::shading::direction;
use gripcast_base::error::{Error, Result};

/// One near point light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Led {
    /// Position, m: x along the columns and y along the rows from the image centre, z from the face
    /// towards the camera.
    pub position_m: [f64; 3],
    /// Diffuse intensity in red, green, blue, grey levels.
    pub diffuse: [f64; 3],
    /// Specular intensity in red, green, blue, grey levels.
    pub specular: [f64; 3],
}

/// LEDs and shininess of a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LedShading {
    /// Phong exponent, 1 to 64.
    pub shininess: u32,
    /// LEDs.
    pub leds: Vec<Led>,
}

/// Maximum number of LEDs.
const MAX_LEDS: usize = 16;
/// Maximum Phong exponent.
const MAX_SHININESS: u32 = 64;

/// Unit vector from the middle of the face to an LED.
fn direction_to(led: &Led) -> [f64; 3] {
    let [x, y, z] = led.position_m;
    let length = x.hypot(y).hypot(z);
    led.position_m.map(|c| c / length)
}

impl LedShading {
    /// Initial guess for a GelSight Mini: red, green and blue LEDs at 120° beside the pad, red at
    /// the top of the image.
    pub fn mini_guess() -> Self {
        let led = |degrees: f64, channel: usize| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let mut diffuse = [15.0; 3];
            diffuse[channel] = 120.0;
            let mut specular = [2.0; 3];
            specular[channel] = 25.0;
            Led {
                position_m: [13e-3 * cos, 13e-3 * sin, 5e-3],
                diffuse,
                specular,
            }
        };
        Self {
            shininess: 8,
            leds: vec![led(-90.0, 0), led(30.0, 1), led(150.0, 2)],
        }
    }

    /// Tilt of the normal (x, y), of length 1, that brightens red, green and blue most.
    pub(super) fn brightening_slope(&self) -> [[f64; 2]; 3] {
        std::array::from_fn(|channel| {
            let along = |axis: usize| {
                let leds = self.leds.iter();
                leds.map(|led| led.diffuse[channel] * direction_to(led)[axis])
                    .sum()
            };
            direction([along(0), along(1)])
        })
    }

    /// Checks counts and ranges.
    ///
    /// # Errors
    /// `Config` with the expected and the found value.
    pub fn validate(&self) -> Result<()> {
        let require = |holds, what: &dyn Fn() -> String| {
            ensure(holds, || Error::config(format!("shading.{}", what())))
        };
        let (count, shininess) = (self.leds.len(), self.shininess);
        require((1..=MAX_LEDS).contains(&count), &|| {
            format!("leds must contain 1 to {MAX_LEDS} LEDs, found {count}")
        })?;
        require((1..=MAX_SHININESS).contains(&shininess), &|| {
            format!("shininess must be 1 to {MAX_SHININESS}, found {shininess}")
        })?;
        for (i, led) in self.leds.iter().enumerate() {
            let values = [led.position_m, led.diffuse, led.specular];
            require(values.iter().flatten().all(|v| v.is_finite()), &|| {
                format!("leds[{i}] contains a value that is not finite")
            })?;
            let z = led.position_m[2];
            require(z > 0.0, &|| {
                format!("leds[{i}] must lie in front of the face (z > 0), found z = {z} m")
            })?;
        }
        Ok(())
    }

    /// Adds the change of each pixel, grey levels, to the red, green and blue planes.
    pub(super) fn add(
        &self,
        geometry: &SensorGeometry,
        normals: &Normals,
        planes: &mut [Vec<f32>; 3],
    ) {
        let Some(region) = normals.region else {
            return;
        };
        let mut light = RowLight::default();
        for led in &self.leds {
            let light_source = PointLight::new(led, self.shininess);
            for row in region.y0..region.y1 {
                let span = row * geometry.width + region.x0..row * geometry.width + region.x1;
                let [first, y] = geometry.pixel_to_gel_m(region.x0 as f64, row as f64);
                let start = [first as f32, y as f32];
                light.fill(
                    &light_source,
                    start,
                    geometry.pixel_m as f32,
                    [
                        &normals.x[span.clone()],
                        &normals.y[span.clone()],
                        &normals.z_less_1[span.clone()],
                    ],
                );
                for (channel, plane) in planes.iter_mut().enumerate() {
                    let (diffuse, specular) = (
                        light_source.diffuse[channel],
                        light_source.specular[channel],
                    );
                    let row = plane[span.clone()].iter_mut();
                    for (out, (d, s)) in row.zip(light.diffuse.iter().zip(&light.shine)) {
                        *out += diffuse * d + specular * s;
                    }
                }
            }
        }
    }
}

/// Change of an LED's light along a row, as [`PointLight::change`], in loops that vectorise.
#[derive(Default)]
struct RowLight {
    diffuse: Vec<f32>,
    shine: Vec<f32>,
    shine_flat: Vec<f32>,
    falloff: Vec<f32>,
}

impl RowLight {
    /// `start` is the position of the first pixel, m; the others follow along x.
    fn fill(&mut self, led: &PointLight, start: [f32; 2], pixel_m: f32, normals: [&[f32]; 3]) {
        let [nx, ny, nz] = normals;
        for plane in [
            &mut self.diffuse,
            &mut self.shine,
            &mut self.shine_flat,
            &mut self.falloff,
        ] {
            plane.resize(nx.len(), 0.0);
        }
        let (y, z) = (led.position[1] - start[1], led.position[2]);
        let across = y * y + z * z;
        let out = self.diffuse.iter_mut().zip(self.falloff.iter_mut());
        let out = out.zip(self.shine.iter_mut().zip(self.shine_flat.iter_mut()));
        let normals = nx.iter().zip(ny.iter().zip(nz));
        for (i, (((diffuse, falloff), (shine, flat)), (nx, (ny, nz)))) in
            out.zip(normals).enumerate()
        {
            let x = led.position[0] - (start[0] + i as f32 * pixel_m);
            let square = x * x + across;
            let inverse = 1.0 / square.sqrt();
            let upward = z * inverse;
            let facing = (nx * x + ny * y) * inverse + (1.0 + nz) * upward;
            *falloff = led.distance_square / square;
            *diffuse = *falloff * (facing.max(0.0) - upward);
            *shine = (2.0 * facing * (1.0 + nz) - upward).max(0.0);
            *flat = upward.max(0.0);
        }
        pow_all(&mut self.shine, led.shininess);
        pow_all(&mut self.shine_flat, led.shininess);
        let flat = self.shine_flat.iter().zip(&self.falloff);
        for (shine, (flat, falloff)) in self.shine.iter_mut().zip(flat) {
            *shine = falloff * (*shine - flat);
        }
    }
}

/// Raises all values to a power by repeated squaring.
fn pow_all(values: &mut [f32], exponent: u32) {
    const BLOCK: usize = 16;
    for block in values.chunks_mut(BLOCK) {
        let mut square = [0.0f32; BLOCK];
        square[..block.len()].copy_from_slice(block);
        let mut result = [1.0f32; BLOCK];
        let mut left = exponent;
        while left > 0 {
            for (result, square) in result.iter_mut().zip(&mut square) {
                if left & 1 == 1 {
                    *result *= *square;
                }
                *square *= *square;
            }
            left >>= 1;
        }
        block.copy_from_slice(&result[..block.len()]);
    }
}

/// An LED in single precision.
#[derive(Clone, Debug)]
pub(super) struct PointLight {
    position: [f32; 3],
    distance_square: f32,
    diffuse: [f32; 3],
    specular: [f32; 3],
    shininess: u32,
}

impl PointLight {
    pub(super) fn new(led: &Led, shininess: u32) -> Self {
        let position = led.position_m.map(|v| v as f32);
        Self {
            position,
            distance_square: position.iter().map(|v| v * v).sum(),
            diffuse: led.diffuse.map(|v| v as f32),
            specular: led.specular.map(|v| v as f32),
            shininess,
        }
    }

    /// Returns the diffuse and specular change, for unit intensity, at a position of the face (m)
    /// with the normal (nx, ny, nz − 1).
    pub(super) fn change(&self, position: [f32; 2], normal: [f32; 3]) -> [f32; 2] {
        let [x, y, z_less_1] = normal;
        if x == 0.0 && y == 0.0 {
            return [0.0; 2];
        }
        let to = [
            self.position[0] - position[0],
            self.position[1] - position[1],
            self.position[2],
        ];
        let square: f32 = to.iter().map(|v| v * v).sum();
        let falloff = self.distance_square / square;
        let l = to.map(|v| v / square.sqrt());
        let z = 1.0 + z_less_1;
        let facing = x * l[0] + y * l[1] + z * l[2];
        let shine = |r_z: f32| r_z.max(0.0).powi(self.shininess as i32);
        [
            falloff * (facing.max(0.0) - l[2]),
            falloff * (shine(2.0 * facing * z - l[2]) - shine(l[2])),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_towards_the_led_is_brighter() {
        let guess = LedShading::mini_guess();
        guess.validate().unwrap();
        let red = PointLight::new(&guess.leds[0], guess.shininess);
        let tilt = |degrees: f32| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            [0.0, sin, cos - 1.0]
        };
        assert!(red.change([0.0; 2], tilt(-20.0))[0] > 0.1);
        assert!(red.change([0.0; 2], tilt(20.0))[0] < -0.1);
        assert_eq!(red.change([0.0; 2], [0.0; 3]), [0.0; 2]);
        // Light falls off with the square of the distance.
        let near = red.change([0.0, -5e-3], tilt(-1.0))[0];
        let far = red.change([0.0, 5e-3], tilt(-1.0))[0];
        assert!(near > 2.0 * far);
    }

    #[test]
    fn row_shading_equals_pixel_shading() {
        let geometry = SensorGeometry {
            width: 37,
            height: 5,
            pixel_m: 2e-4,
            gel_thickness_m: 4e-3,
        };
        let map: Vec<f32> = (0..185)
            .map(|i| 1e-4 * ((i % 37) as f32 * 0.6).sin() * (i / 37) as f32)
            .collect();
        let mut normals = Normals::default();
        normals.compute(&map, &geometry);
        let shading = LedShading::mini_guess();
        let mut planes = std::array::from_fn(|_| vec![0.0; 185]);
        shading.add(&geometry, &normals, &mut planes);
        for (i, found) in planes[1].iter().enumerate() {
            let [x, y] = geometry.pixel_to_gel_m((i % 37) as f64, (i / 37) as f64);
            let normal = [normals.x[i], normals.y[i], normals.z_less_1[i]];
            let expected: f32 = shading
                .leds
                .iter()
                .map(|led| {
                    let [d, s] = PointLight::new(led, 8).change([x as f32, y as f32], normal);
                    led.diffuse[1] as f32 * d + led.specular[1] as f32 * s
                })
                .sum();
            assert!((found - expected).abs() < 2e-3, "{found} {expected}");
        }
    }

    #[test]
    fn powers_agree_with_powi() {
        for exponent in [1, 2, 7, 8, 33, 64] {
            let bases: Vec<f32> = (0..999).map(|i| i as f32 / 997.0).collect();
            let mut powers = bases.clone();
            pow_all(&mut powers, exponent);
            let expected: Vec<f32> = bases.iter().map(|b| b.powi(exponent as i32)).collect();
            assert_eq!(powers, expected);
        }
    }

    #[test]
    fn led_behind_the_face_is_refused() {
        let mut shading = LedShading::mini_guess();
        shading.leds[1].position_m[2] = 0.0;
        assert!(
            shading
                .validate()
                .unwrap_err()
                .to_string()
                .contains("leds[1]")
        );
        shading.leds.clear();
        assert!(shading.validate().is_err());
    }
}
