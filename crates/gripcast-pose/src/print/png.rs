//! Greyscale PNG output.
//!
//! Cells are drawn by their coverage of each pixel, so that their edges are accurate to a hundredth
//! of a pixel. A point at x mm is at x · dpi / 25.4 − ½ px; (0, 0) is the centre of the top-left
//! pixel.

use glam::DVec2;
use image::GrayImage;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use super::drawing::{Drawing, Shape, TextAnchor};
use gripcast_base::error::{Error, Result};

/// Supported resolutions, dots per inch.
const DPI: std::ops::RangeInclusive<f64> = 72.0..=1200.0;
/// Width of Helvetica's digits, relative to the font size.
const LETTER: f64 = 0.556;
/// Height of a rastered letter including descenders, px.
const RASTER: usize = 32;
/// Row of the baseline in the raster.
const BASELINE: f64 = 25.0;
/// Font size of the raster, px.
const RASTER_EM: f64 = 27.0;

/// Writes a drawing as greyscale PNG with its resolution in the chunk `pHYs`.
///
/// # Errors
/// `Input` for a resolution outside 72 to 1200 dots per inch.
pub fn png(drawing: &Drawing, dpi: f64) -> Result<Vec<u8>> {
    let image = raster(drawing, dpi)?;
    let failed =
        |e: png::EncodingError| Error::internal("cannot write the sheet as PNG").because(e);
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, image.width(), image.height());
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let per_metre = (dpi / 0.0254).round() as u32;
    encoder.set_pixel_dims(Some(png::PixelDimensions {
        xppu: per_metre,
        yppu: per_metre,
        unit: png::Unit::Meter,
    }));
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(image.as_raw()).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(out)
}

/// Rasters a drawing: 255 times the fraction of each pixel that is not covered.
///
/// # Errors
/// As [`png()`].
pub fn raster(drawing: &Drawing, dpi: f64) -> Result<GrayImage> {
    if !DPI.contains(&dpi) {
        return Err(Error::input(format!(
            "the resolution must be from {} to {} dots per inch, found {dpi}",
            DPI.start(),
            DPI.end()
        )));
    }
    let scale = dpi / 25.4;
    let [width, height] = drawing.size_mm.map(|mm| (mm * scale).round() as u32);
    let mut canvas = Canvas {
        image: GrayImage::from_pixel(width, height, image::Luma([255])),
        scale,
    };
    for shape in &drawing.shapes {
        canvas.draw(shape);
    }
    Ok(canvas.image)
}

struct Canvas {
    image: GrayImage,
    /// Pixels per millimetre.
    scale: f64,
}

impl Canvas {
    fn draw(&mut self, shape: &Shape) {
        match shape {
            Shape::Marker { outer, holes } => self.marker(outer, holes),
            Shape::Line {
                points,
                closed,
                width_mm,
                dash_mm,
                colour,
            } => {
                let [r, g, b] = colour.map(f64::from);
                let grey = 0.299 * r + 0.587 * g + 0.114 * b;
                let mut ends = points.clone();
                if *closed {
                    ends.extend(points.first());
                }
                let pieces = match dash_mm {
                    Some(dash) => dashes(&ends, *dash),
                    None => ends.windows(2).map(|w| [w[0], w[1]]).collect(),
                };
                for piece in pieces {
                    self.segment(piece, *width_mm, grey);
                }
            }
            Shape::Text {
                at,
                size_mm,
                anchor,
                text,
            } => self.text(*at, *size_mm, *anchor, text),
        }
    }

    /// Columns or rows that overlap an interval in px, clamped to the image.
    fn overlapping(from: f64, to: f64, count: u32) -> std::ops::Range<u32> {
        let clamp = |v: f64| v.clamp(0.0, f64::from(count)) as u32;
        clamp(from.floor())..clamp(to.ceil())
    }

    fn marker(&mut self, outer: &[f64; 4], holes: &[[f64; 4]]) {
        let scaled = |r: &[f64; 4]| r.map(|v| v * self.scale);
        let outer = scaled(outer);
        let holes: Vec<[f64; 4]> = holes.iter().map(scaled).collect();
        let columns = Self::overlapping(outer[0], outer[0] + outer[2], self.image.width());
        let rows = Self::overlapping(outer[1], outer[1] + outer[3], self.image.height());
        for y in rows {
            for x in columns.clone() {
                let white: f64 = holes.iter().map(|hole| coverage(hole, x, y)).sum();
                self.darken(x, y, coverage(&outer, x, y) - white, 0.0);
            }
        }
    }

    /// A line with butt caps.
    fn segment(&mut self, [a, b]: [DVec2; 2], width_mm: f64, grey: f64) {
        let (a, b) = (a * self.scale, b * self.scale);
        let half = 0.5 * width_mm * self.scale;
        let length = a.distance(b);
        let along = (b - a).normalize_or_zero();
        let (low, high) = (a.min(b) - half - 1.0, a.max(b) + half + 1.0);
        let ramp = |inside: f64| (inside + 0.5).clamp(0.0, 1.0);
        for y in Self::overlapping(low.y, high.y, self.image.height()) {
            for x in Self::overlapping(low.x, high.x, self.image.width()) {
                let p = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) - a;
                let (u, v) = (p.dot(along), p.perp_dot(along).abs());
                let ends = ramp(u).min(ramp(length - u));
                // Lines thinner than a pixel are drawn lighter.
                let across = (ramp(half - v) - ramp(-half - v)).max(0.0);
                self.darken(x, y, ends * across, grey);
            }
        }
    }

    fn text(&mut self, at: DVec2, size_mm: f64, anchor: TextAnchor, text: &str) {
        let advance = LETTER * size_mm;
        let start = match anchor {
            TextAnchor::Start => at.x,
            TextAnchor::Middle => at.x - 0.5 * advance * text.len() as f64,
        };
        for (k, letter) in text.chars().enumerate() {
            let x = start + advance * k as f64;
            self.letter(DVec2::new(x, at.y), size_mm, letter);
        }
    }

    fn letter(&mut self, at: DVec2, size_mm: f64, letter: char) {
        let Some(glyph) = get_raster(letter, FontWeight::Regular, RasterHeight::Size32) else {
            return;
        };
        let columns = get_raster_width(FontWeight::Regular, RasterHeight::Size32);
        let at = at * self.scale;
        // Image pixels per glyph pixel, along x and y.
        let step = DVec2::new(
            LETTER * size_mm * self.scale / columns as f64,
            size_mm * self.scale / RASTER_EM,
        );
        let top = at.y - BASELINE * step.y;
        let right = at.x + columns as f64 * step.x;
        let bottom = top + RASTER as f64 * step.y;
        let ink =
            |column: usize, row: usize| f64::from(glyph.pixel(column, row).unwrap_or(0)) / 255.0;
        for y in Self::overlapping(top, bottom, self.image.height()) {
            for x in Self::overlapping(at.x, right, self.image.width()) {
                let column = (f64::from(x) + 0.5 - at.x) / step.x;
                let row = (f64::from(y) + 0.5 - top) / step.y;
                if column < 0.0 || row < 0.0 {
                    continue;
                }
                self.darken(x, y, ink(column as usize, row as usize), 0.0);
            }
        }
    }

    fn darken(&mut self, x: u32, y: u32, fraction: f64, grey: f64) {
        let value = 255.0 - fraction.clamp(0.0, 1.0) * (255.0 - grey);
        let pixel = &mut self.image.get_pixel_mut(x, y).0[0];
        *pixel = (*pixel).min(value.round() as u8);
    }
}

/// Fraction of a pixel covered by a rectangle in px; pixel 0 is from 0 to 1.
fn coverage([left, top, width, height]: &[f64; 4], x: u32, y: u32) -> f64 {
    let overlap = |from: f64, length: f64, pixel: u32| {
        let pixel = f64::from(pixel);
        ((from + length).min(pixel + 1.0) - from.max(pixel)).max(0.0)
    };
    overlap(*left, *width, x) * overlap(*top, *height, y)
}

/// Dashes of a line.
fn dashes(points: &[DVec2], [on, off]: [f64; 2]) -> Vec<[DVec2; 2]> {
    let mut pieces = Vec::new();
    let mut is_on = true;
    let mut left = on;
    for pair in points.windows(2) {
        let (mut from, to) = (pair[0], pair[1]);
        loop {
            let length = from.distance(to);
            let step = left.min(length);
            let next = from + (to - from).normalize_or_zero() * step;
            if is_on && step > 0.0 {
                pieces.push([from, next]);
            }
            left -= step;
            from = next;
            if left > 1e-9 {
                break;
            }
            is_on = !is_on;
            left = if is_on { on } else { off };
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_has_its_resolution() {
        let drawing = Drawing::new([50.8, 25.4], "t");
        let bytes = png(&drawing, 300.0).unwrap();
        let decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        let reader = decoder.read_info().unwrap();
        let info = reader.info();
        assert_eq!((info.width, info.height), (600, 300));
        let dims = info.pixel_dims.unwrap();
        assert_eq!(
            (dims.xppu, dims.yppu, dims.unit),
            (11811, 11811, png::Unit::Meter)
        );
        for bad in [0.0, 20.0, 5000.0, f64::NAN] {
            assert!(png(&drawing, bad).unwrap_err().to_string().contains("72"));
        }
    }

    #[test]
    fn lines_are_to_scale() {
        let mut drawing = Drawing::new([120.0, 20.0], "t");
        let y = 10.0;
        for x in [10.0, 110.0] {
            drawing.thin_line(DVec2::new(x, y - 3.0), DVec2::new(x, y + 3.0));
        }
        let image = raster(&drawing, 300.0).unwrap();
        let row = (y * 300.0 / 25.4) as u32;
        let dark: Vec<(f64, f64)> = (0..image.width())
            .map(|x| {
                (
                    f64::from(x),
                    255.0 - f64::from(image.get_pixel(x, row).0[0]),
                )
            })
            .collect();
        let middle = |range: std::ops::Range<usize>| {
            let dark = &dark[range];
            let weight: f64 = dark.iter().map(|(_, w)| w).sum();
            dark.iter().map(|(x, w)| x * w).sum::<f64>() / weight
        };
        let half = dark.len() / 2;
        let (first, last) = (middle(0..half), middle(half..dark.len()));
        assert!((last - first - 100.0 * 300.0 / 25.4).abs() < 0.02);
        assert!((first - (10.0 * 300.0 / 25.4 - 0.5)).abs() < 0.02);
    }

    #[test]
    fn cell_edges_are_accurate_below_a_pixel() {
        let mut drawing = Drawing::new([20.0, 20.0], "t");
        drawing.shapes.push(Shape::Marker {
            outer: [2.03, 3.07, 10.0, 10.0],
            holes: vec![[4.01, 5.0, 2.0, 2.0]],
        });
        let scale = 100.0 / 25.4;
        let image = raster(&drawing, 100.0).unwrap();
        let ink: f64 = image.iter().map(|v| 1.0 - f64::from(*v) / 255.0).sum();
        assert!((ink / (scale * scale) - 96.0).abs() < 0.05, "{ink}");
        let middle: f64 = image.iter().copied().map(f64::from).sum();
        assert!(middle > 0.0);
        let column = |x: f64| (x * scale) as u32;
        assert_eq!(image.get_pixel(column(3.0), column(4.0)).0, [0]);
        assert_eq!(image.get_pixel(column(5.0), column(6.0)).0, [255]);
    }

    #[test]
    fn dashes_continue_around_corners() {
        let points = [DVec2::ZERO, DVec2::new(3.0, 0.0), DVec2::new(3.0, 4.0)];
        let pieces = dashes(&points, [2.0, 2.0]);
        let length: f64 = pieces.iter().map(|[a, b]| a.distance(*b)).sum();
        assert!((length - 4.0).abs() < 1e-12, "{pieces:?}");
        assert_eq!(pieces[1][0], DVec2::new(3.0, 1.0));
    }
}
