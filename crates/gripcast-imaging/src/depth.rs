//! Depth images of the camera between the fingers, and their view from its colour camera.

use std::ops::Range;

use gripcast_geometry::WristCamera;

use super::z16::DepthImage;

/// Code of a depth beyond the range of the camera.
const OUT_OF_RANGE: u16 = u16::MAX;

/// Camera whose view a depth image shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthView {
    /// The colour camera: the depth image is aligned to the colour image.
    #[default]
    Colour,
    /// The left imager of a RealSense D435, whose depth images are as it streams them.
    LeftImager,
}

impl DepthView {
    /// All views.
    pub const ALL: [Self; 2] = [Self::Colour, Self::LeftImager];

    /// Name on the command line and in Python.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Colour => "colour",
            Self::LeftImager => "left-imager",
        }
    }

    /// View of a depth camera: images of a virtual rig are aligned to its colour images, those of a
    /// D435 are seen from its left imager. None for another USB product, whose lenses are not known.
    #[must_use]
    pub fn of_camera(is_virtual: bool, product: &str) -> Option<Self> {
        if is_virtual {
            return Some(Self::Colour);
        }
        product.contains("435").then_some(Self::LeftImager)
    }
}

/// The colour image that depths are wanted in, and the lenses.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ColourView {
    /// Width of the colour image, px.
    width: usize,
    /// Height of the colour image, px.
    height: usize,
    /// Focal length of the colour image, px.
    focal_px: f64,
    /// Focal length of the depth image, px.
    depth_focal_px: f64,
    /// Offset of the left imager to the right of the colour camera, m.
    left_imager_m: f64,
}

/// A depth image.
#[derive(Clone, Debug, PartialEq)]
pub struct Depth {
    /// Depth codes; 0 and 65,535 are unknown.
    pub image: DepthImage,
    /// Depth of one code, m.
    pub unit_m: f64,
}

impl Depth {
    /// Depth of each pixel of a colour image of `width` × `height` of the [`WristCamera`], m,
    /// row-major; 0 is unknown. Lenses and their distance are nominal (D400 series data sheet).
    ///
    /// An aligned image is cropped to the aspect ratio of the colour image. Depths are those of the
    /// nearest pixels, as mixing depths across an edge would make points that do not exist. An image
    /// of the left imager, whose optical axes are parallel to those of the colour camera, is
    /// projected; the nearest surface hides others.
    #[must_use]
    pub fn in_colour_image(&self, view: DepthView, width: usize, height: usize) -> Vec<f64> {
        let (columns, rows) = self.image.dimensions();
        let colour = ColourView {
            width,
            height,
            focal_px: WristCamera::focal_px(width, height),
            depth_focal_px: WristCamera::depth_focal_px(columns as usize, rows as usize),
            left_imager_m: WristCamera::LEFT_IMAGER_M,
        };
        self.seen_by(view, &colour)
    }

    fn seen_by(&self, view: DepthView, colour: &ColourView) -> Vec<f64> {
        let (width, height) = self.image.dimensions();
        if width == 0 || height == 0 {
            return vec![0.0; colour.width * colour.height];
        }
        match view {
            DepthView::Colour => self.cropped(colour),
            DepthView::LeftImager => self.projected(colour),
        }
    }

    /// Depth of a code, m; none if it is unknown.
    fn depth_m(&self, code: u16) -> Option<f64> {
        let z = f64::from(code) * self.unit_m;
        (!matches!(code, 0 | OUT_OF_RANGE) && z > 0.0).then_some(z)
    }

    fn cropped(&self, colour: &ColourView) -> Vec<f64> {
        let (width, height) = self.image.dimensions();
        let [x_scale, y_scale] = [(width, colour.width), (height, colour.height)]
            .map(|(side, wanted)| f64::from(side) / wanted as f64);
        let scale = x_scale.min(y_scale);
        let nearest = |side: u32, all: usize, at: usize| {
            let position = 0.5 * f64::from(side) + (at as f64 + 0.5 - 0.5 * all as f64) * scale;
            (position as u32).min(side - 1)
        };
        let columns = 0..colour.width;
        let columns: Vec<u32> = columns.map(|x| nearest(width, colour.width, x)).collect();
        let rows = (0..colour.height).map(|y| nearest(height, colour.height, y));
        let pixels = rows.flat_map(|row| columns.iter().map(move |column| (*column, row)));
        let depths = pixels.map(|(x, y)| self.depth_m(self.image.get_pixel(x, y)[0]));
        depths.map(Option::unwrap_or_default).collect()
    }

    fn projected(&self, colour: &ColourView) -> Vec<f64> {
        let (width, height) = self.image.dimensions();
        let (from, to) = (colour.depth_focal_px, colour.focal_px);
        let middle = [width, height].map(|side| 0.5 * (f64::from(side) - 1.0));
        let centre = [colour.width, colour.height].map(|side| 0.5 * (side as f64 - 1.0));
        // Half a pixel of the depth image in the colour image, and at least half of one there.
        let reach = 0.5 * (to / from).max(1.0);
        let covered = |at: f64, count: usize| covered(at - reach, at + reach, count);
        let direction = |at: u32, axis: usize| (f64::from(at) - middle[axis]) / from;
        let directions: Vec<f64> = (0..width).map(|x| direction(x, 0)).collect();
        let mut depths = vec![0.0; colour.width * colour.height];
        for (y, codes) in self.image.chunks_exact(width as usize).enumerate() {
            let v = direction(y as u32, 1);
            let rows = covered(centre[1] + to * v, colour.height);
            if rows.is_empty() {
                continue;
            }
            for (u, code) in directions.iter().zip(codes) {
                let Some(z) = self.depth_m(*code) else {
                    continue;
                };
                let column = centre[0] + to * (u + colour.left_imager_m / z);
                let columns = covered(column, colour.width);
                for row in rows.clone() {
                    for depth in &mut depths[row * colour.width..][columns.clone()] {
                        if *depth == 0.0 || z < *depth {
                            *depth = z;
                        }
                    }
                }
            }
        }
        depths
    }
}

/// Integers from `low` to `high` below `count`. `ceil` and `floor` are library calls without SSE4.1.
#[inline]
fn covered(low: f64, high: f64, count: usize) -> Range<usize> {
    let limit = count as f64;
    let low = low.clamp(0.0, limit);
    let first = low as u32;
    let first = first + u32::from(f64::from(first) < low);
    let end = match high < 0.0 {
        true => 0,
        false => (high.min(limit) as u32 + 1).min(count as u32),
    };
    // Never reversed, as slices have it.
    first.min(end) as usize..end as usize
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    #[test]
    fn view_follows_from_camera() {
        let view = DepthView::of_camera;
        let d435 = "Intel(R) RealSense(TM) Depth Camera 435";
        assert_eq!(view(true, d435), Some(DepthView::Colour));
        assert_eq!(view(false, d435), Some(DepthView::LeftImager));
        assert_eq!(view(false, "Intel(R) RealSense(TM) Depth Camera 455"), None);
        assert_eq!(view(false, ""), None);
    }

    #[test]
    fn covered_integers_are_those_between() {
        for count in [0, 1, 7] {
            for step in -40..60 {
                for width in 0..12 {
                    let low = 0.25 * f64::from(step);
                    let high = low + 0.25 * f64::from(width);
                    let is_between = |at: &usize| (low..=high).contains(&(*at as f64));
                    let expected: Vec<usize> = (0..count).filter(is_between).collect();
                    let found: Vec<usize> = covered(low, high, count).collect();
                    assert_eq!(found, expected, "{low} {high} {count}");
                }
            }
        }
        assert!(covered(f64::INFINITY, f64::INFINITY, 5).is_empty());
    }

    #[test]
    fn point_moves_by_its_disparity_and_the_nearest_is_seen() {
        let mut image = DepthImage::new(64, 48);
        for (x, code) in [(20, 100), (26, 400)] {
            image.put_pixel(x, 24, Luma([code]));
        }
        let depth = Depth {
            image,
            unit_m: 1e-3,
        };
        let colour = ColourView {
            width: 64,
            height: 48,
            focal_px: 50.0,
            depth_focal_px: 50.0,
            left_imager_m: 0.016,
        };
        // Disparities of 8 and 2 px.
        let found = depth.seen_by(DepthView::LeftImager, &colour);
        assert_eq!(found[24 * 64 + 28], 0.1);
        assert_eq!(found.iter().filter(|z| **z > 0.0).count(), 1);
        let aligned = depth.seen_by(DepthView::Colour, &colour);
        assert_eq!([aligned[24 * 64 + 20], aligned[24 * 64 + 26]], [0.1, 0.4]);
    }
}
