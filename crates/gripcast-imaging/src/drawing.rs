//! Lines and arrows over images.

use image::{Rgb, RgbImage};

/// Draws an antialiased line from `a` to `b` (px), clipped to the image; a point draws a dot. Draws
/// nothing for coordinates that are not finite.
pub fn draw_line(image: &mut RgbImage, a: [f64; 2], b: [f64; 2], width: f64, colour: Rgb<u8>) {
    let size = [image.width(), image.height()].map(f64::from);
    let margin = 0.5 * width + 1.0;
    let low = [0, 1].map(|i| (a[i].min(b[i]) - margin).max(0.0));
    let high = [0, 1].map(|i| (a[i].max(b[i]) + margin).min(size[i] - 1.0));
    let is_finite = a.iter().chain(&b).all(|value| value.is_finite());
    if !is_finite || low[0] > high[0] || low[1] > high[1] {
        return;
    }
    let along = [0, 1].map(|i| b[i] - a[i]);
    let length_squared = along.map(|d| d * d).iter().sum::<f64>().max(1e-12);
    for y in low[1] as u32..=high[1] as u32 {
        for x in low[0] as u32..=high[0] as u32 {
            let off = [f64::from(x) - a[0], f64::from(y) - a[1]];
            let t = (off[0] * along[0] + off[1] * along[1]) / length_squared;
            let t = t.clamp(0.0, 1.0);
            let distance = (off[0] - t * along[0]).hypot(off[1] - t * along[1]);
            let coverage = (0.5 * width + 0.5 - distance).clamp(0.0, 1.0);
            if coverage > 0.0 {
                let pixel = image.get_pixel_mut(x, y);
                for (level, target) in pixel.0.iter_mut().zip(colour.0) {
                    let (old, new) = (f64::from(*level), f64::from(target));
                    *level = (old + coverage * (new - old)).round() as u8;
                }
            }
        }
    }
}

/// Length of the strokes of an arrow's head, px.
const HEAD_PX: f64 = 4.0;

/// Draws an antialiased arrow from `a` to `b` (px), clipped to the image.
pub fn draw_arrow(image: &mut RgbImage, a: [f64; 2], b: [f64; 2], width: f64, colour: Rgb<u8>) {
    draw_line(image, a, b, width, colour);
    let along = [b[0] - a[0], b[1] - a[1]];
    let length = along[0].hypot(along[1]);
    if length < 1.0 {
        return;
    }
    let [x, y] = along.map(|d| d / length * HEAD_PX.min(0.5 * length));
    for side in [-0.6, 0.6] {
        let tip = [b[0] - x - side * y, b[1] - y + side * x];
        draw_line(image, b, tip, width, colour);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHITE: Rgb<u8> = Rgb([255; 3]);

    #[test]
    fn line_covers_its_width_and_is_clipped() {
        let mut image = RgbImage::new(20, 10);
        draw_line(&mut image, [-5.0, 4.0], [30.0, 4.0], 1.0, WHITE);
        for x in 0..20 {
            let column = (0..10).map(|y| image.get_pixel(x, y).0[0]);
            let expected = (0..10).map(|y| if y == 4 { 255 } else { 0 });
            assert!(column.eq(expected), "column {x}");
        }
    }

    #[test]
    fn invalid_coordinates_draw_nothing() {
        let mut image = RgbImage::new(8, 8);
        for end in [[f64::NAN, 1.0], [f64::INFINITY, 1.0], [-9.0, -9.0]] {
            draw_line(&mut image, [-9.0, -8.0], end, 2.0, WHITE);
        }
        assert!(image.pixels().all(|pixel| pixel.0 == [0; 3]));
    }
}
