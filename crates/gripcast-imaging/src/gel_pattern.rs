//! Synthetic GelSight Mini images, without an optical model.
//!
//! Colours and noise follow measurements on real Minis: without contact, the top is about
//! (40, 97, 108), the centre (125, 120, 145) and the bottom (68, 95, 81); the standard deviation of
//! the noise is 1.5, 1.0 and 1.8 grey levels in R, G and B. A contact is shaded by its slope
//! towards the three lamps.

use gripcast_base::random::scramble;
use image::RgbImage;

/// A round contact in image fractions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GelContact {
    /// Centre from the left edge, in image widths.
    pub centre_x: f32,
    /// Centre from the top edge, in image heights.
    pub centre_y: f32,
    /// Radius in image heights.
    pub radius: f32,
    /// Strength from 0 (no contact) to 1.
    pub strength: f32,
}

/// Colours at the top, centre and bottom without contact.
const COLUMN: [[f32; 3]; 3] = [
    [40.0, 97.0, 108.0],
    [125.0, 120.0, 145.0],
    [68.0, 95.0, 81.0],
];

/// Maximum change of each channel, grey levels.
const SHADING: [f32; 3] = [110.0, 75.0, 105.0];

/// Directions (x right, y down) towards the red, green and blue lamps.
const LAMPS: [[f32; 2]; 3] = [[0.0, 1.0], [0.87, -0.5], [-0.87, -0.5]];

/// Hash bits counted as noise per channel: n bits have a variance of n/4.
const NOISE_BITS: [u32; 3] = [9, 4, 13];

/// A gel with a contact of strength `contact` (0 to 1) near the centre; `seed` determines its
/// position and the noise.
pub fn synthetic_gel(width: u32, height: u32, seed: u64, contact: f32) -> RgbImage {
    let bits = scramble(seed ^ 0x6765_6c00);
    let offset = |bits: u64| ((bits & 0xff) as f32 / 255.0 - 0.5) * 0.2;
    gel_image(
        width,
        height,
        seed,
        GelContact {
            centre_x: 0.5 + offset(bits),
            centre_y: 0.5 + offset(bits >> 8),
            radius: 0.12,
            strength: contact,
        },
    )
}

/// A gel with a given contact; `noise_seed` determines the noise.
pub fn gel_image(width: u32, height: u32, noise_seed: u64, contact: GelContact) -> RgbImage {
    let mut image = RgbImage::new(width, height);
    let columns: Vec<f32> = (0..width)
        .map(|x| {
            let u = (x as f32 + 0.5) / width as f32 * 2.0 - 1.0;
            1.0 - 0.18 * u * u
        })
        .collect();
    let strength = contact.strength.clamp(0.0, 1.0);
    let radius = (contact.radius * height as f32).max(1.0);
    let (cx, cy) = (
        contact.centre_x * width as f32,
        contact.centre_y * height as f32,
    );
    // The gel is depressed around the contact as well.
    let outer = radius * 1.6;
    let noise = scramble(noise_seed);
    for (y, row) in image
        .chunks_exact_mut((width as usize * 3).max(3))
        .enumerate()
    {
        let base = column_colour((y as f32 + 0.5) / height as f32);
        let dy = y as f32 + 0.5 - cy;
        let touched = strength > 0.0 && dy.abs() < outer;
        let row_noise = noise ^ (y as u64) << 32;
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let mut colour = base.map(|level| level * columns[x]);
            let dx = x as f32 + 0.5 - cx;
            if touched && dx * dx + dy * dy < outer * outer {
                shade(&mut colour, dx / radius, dy / radius, strength);
            }
            let mut bits = scramble(row_noise ^ x as u64);
            for channel in 0..3 {
                let n = NOISE_BITS[channel];
                let ones = (bits & ((1 << n) - 1)).count_ones();
                bits >>= n;
                // Truncation after + 0.5 rounds; the cast saturates at 0 and 255.
                pixel[channel] = (colour[channel] + ones as f32 - n as f32 / 2.0 + 0.5) as u8;
            }
        }
    }
    image
}

/// Colour without contact at a fraction of the height, interpolated through `COLUMN`.
fn column_colour(v: f32) -> [f32; 3] {
    let [top, centre, bottom] = COLUMN;
    let end = if v < 0.5 { top } else { bottom };
    let away = (2.0 * v - 1.0).abs();
    let weight = away * away * (3.0 - 2.0 * away);
    std::array::from_fn(|c| centre[c] + (end[c] - centre[c]) * weight)
}

/// Adds the shading of a pressed ball at (u, v), in contact radii.
fn shade(colour: &mut [f32; 3], u: f32, v: f32, strength: f32) {
    let r = (u * u + v * v).sqrt();
    let slope = if r < 1.0 {
        r
    } else {
        ((1.6 - r) / 0.6).max(0.0)
    };
    let (nx, ny) = if r > 0.0 { (u / r, v / r) } else { (0.0, 0.0) };
    for channel in 0..3 {
        let [lx, ly] = LAMPS[channel];
        colour[channel] += SHADING[channel] * strength * slope * (nx * lx + ny * ly);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(image: &RgbImage, rows: std::ops::Range<u32>) -> [f64; 3] {
        let mut sum = [0.0; 3];
        let mut count = 0.0;
        for y in rows {
            for x in image.width() * 2 / 5..image.width() * 3 / 5 {
                for (total, level) in sum.iter_mut().zip(image.get_pixel(x, y).0) {
                    *total += f64::from(level);
                }
                count += 1.0;
            }
        }
        sum.map(|total| total / count)
    }

    #[test]
    fn untouched_gel_has_the_measured_colours() {
        let gel = synthetic_gel(320, 240, 1, 0.0);
        for (rows, expected) in [
            (0..4, COLUMN[0]),
            (118..122, COLUMN[1]),
            (236..240, COLUMN[2]),
        ] {
            let found = mean(&gel, rows);
            for c in 0..3 {
                assert!((found[c] - f64::from(expected[c])).abs() < 2.0, "{found:?}");
            }
        }
    }

    #[test]
    fn noise_has_the_measured_deviation() {
        let a = synthetic_gel(320, 240, 1, 0.0);
        let b = synthetic_gel(320, 240, 2, 0.0);
        for (channel, expected) in [1.5_f64, 1.0, 1.8].into_iter().enumerate() {
            let squares: f64 = a
                .pixels()
                .zip(b.pixels())
                .map(|(p, q)| (f64::from(p.0[channel]) - f64::from(q.0[channel])).powi(2))
                .sum();
            // The difference of two independent draws has twice the variance.
            let deviation = (squares / f64::from(320 * 240) / 2.0).sqrt();
            assert!((deviation - expected).abs() < 0.1, "{channel}: {deviation}");
        }
    }

    #[test]
    fn same_arguments_give_the_same_bytes() {
        let gel = || synthetic_gel(160, 120, 7, 1.0);
        assert_eq!(gel(), gel());
        assert_ne!(gel(), synthetic_gel(160, 120, 8, 1.0));
    }

    #[test]
    fn contact_shading_is_local() {
        let contact = GelContact {
            centre_x: 0.4,
            centre_y: 0.5,
            radius: 0.2,
            strength: 1.0,
        };
        let untouched = GelContact {
            strength: 0.0,
            ..contact
        };
        let free = gel_image(160, 120, 7, untouched);
        let pressed = gel_image(160, 120, 7, contact);
        let mut at_edge = 0;
        for (x, y, pixel) in pressed.enumerate_pixels() {
            let (dx, dy) = (x as f32 + 0.5 - 64.0, y as f32 + 0.5 - 60.0);
            let distance = dx.hypot(dy) / 24.0;
            let before = free.get_pixel(x, y);
            let change = |c: usize| i32::from(pixel[c]) - i32::from(before[c]);
            if distance >= 1.61 {
                assert_eq!(pixel, before, "({x}, {y})");
            } else if (0.9..1.1).contains(&distance) {
                at_edge += 1;
                // Each lamp brightens the side facing it.
                for (c, [lx, ly]) in LAMPS.into_iter().enumerate() {
                    let facing = (dx * lx + dy * ly) / dx.hypot(dy);
                    let expected = SHADING[c] * facing;
                    if facing.abs() > 0.5 && (40.0..215.0).contains(&f32::from(pixel[c])) {
                        let off = (change(c) as f32 - expected).abs();
                        assert!(off < 0.2 * SHADING[c], "({x}, {y}) {c}: {}", change(c));
                    }
                }
            }
        }
        assert!(at_edge > 500, "{at_edge}");
    }

    #[test]
    fn degenerate_sizes_and_contacts() {
        assert_eq!(synthetic_gel(1, 1, 0, f32::NAN).dimensions(), (1, 1));
        assert_eq!(synthetic_gel(0, 5, 0, 1.0).dimensions(), (0, 5));
        assert_eq!(synthetic_gel(5, 0, 0, -3.0).dimensions(), (5, 0));
    }
}
