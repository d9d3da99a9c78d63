//! Depth for the eye: a perceptual colour map over the working range, with its scale.

use std::sync::LazyLock;

use image::{Rgb, RgbImage};

use super::caption::{ADVANCE, HEIGHT, write_text};
use super::crop::CropWindow;

/// Working range of a depth camera on a gripper: the first and the last colour, m. Nearer and
/// farther depths have the end colours.
pub const DEPTH_RANGE_M: [f64; 2] = [0.1, 0.8];

/// Number of colours.
const COLOURS: usize = 256;
/// Coefficients of Turbo per channel, from x⁰ to x⁵: the fit by Ruofei Du of the map by Anton
/// Mikhailov (Google, Apache-2.0).
const TURBO: [[f32; 6]; 3] = [
    [
        0.135_721_4,
        4.615_392_6,
        -42.660_32,
        132.131_08,
        -152.942_4,
        59.286_38,
    ],
    [
        0.091_402_6,
        2.194_188_4,
        4.842_966_6,
        -14.185_033,
        4.277_298_6,
        2.829_566,
    ],
    [
        0.106_673_3,
        12.641_946,
        -60.582_05,
        110.362_77,
        -89.903_11,
        27.348_25,
    ],
];
/// First colour: the nearly grey ones before it could be taken for no depth.
const FIRST: f32 = 0.04;
/// The two greys of pixels without depth: Turbo has no greys.
const NO_DEPTH: [[u8; 3]; 2] = [[40; 3], [96; 3]];
/// Width of a stripe of pixels without depth, px.
const STRIPE: u32 = 4;
/// Smallest image with a scale, px.
const SCALED_SIZE: (u32, u32) = (200, 60);

static PALETTE: LazyLock<[[u8; 3]; COLOURS]> = LazyLock::new(|| {
    std::array::from_fn(|index| {
        let x = FIRST + (1.0 - FIRST) * index as f32 / (COLOURS - 1) as f32;
        TURBO.map(|channel| {
            let value = channel.iter().rev().fold(0.0, |sum, c| sum * x + c);
            (255.0 * value.clamp(0.0, 1.0)).round() as u8
        })
    })
});

/// Colours of the values of one depth image.
pub(super) struct DepthColours {
    /// First value of the range and its width, units.
    near: f64,
    span: f64,
}

impl DepthColours {
    /// Colours of depths in units of `unit_m`.
    pub(super) fn new(unit_m: f64) -> Self {
        let [near, far] = DEPTH_RANGE_M.map(|metres| metres / unit_m);
        Self {
            near,
            span: far - near,
        }
    }

    /// Returns the colour of a depth at a pixel: blue for near over green to red for far; grey
    /// stripes for no depth (0).
    pub(super) fn colour(&self, depth: u16, x: u32, y: u32) -> [u8; 3] {
        if depth == 0 {
            return NO_DEPTH[((x + y) / STRIPE % 2) as usize];
        }
        let fraction = ((f64::from(depth) - self.near) / self.span).clamp(0.0, 1.0);
        PALETTE[(fraction * (COLOURS - 1) as f64).round() as usize]
    }
}

/// A depth image in colours, by nearest neighbour, with the scale at its lower edge.
pub(super) fn draw(
    depth: impl Fn(u32, u32) -> u16,
    unit_m: f64,
    window: CropWindow,
    (width, height): (u32, u32),
) -> RgbImage {
    let colours = DepthColours::new(unit_m);
    let nearest = |index: u32, target: u32, first: u32, count: u32| {
        let centre = (2 * u64::from(index) + 1) * u64::from(count);
        first + (centre / (2 * u64::from(target))) as u32
    };
    let mut image = RgbImage::from_fn(width, height, |x, y| {
        let column = nearest(x, width, window.left, window.width);
        let row = nearest(y, height, window.top, window.height);
        Rgb(colours.colour(depth(column, row), x, y))
    });
    draw_scale(&mut image, &colours, unit_m);
    image
}

/// Draws `0.1 ▒▒▒▒ 0.8 M ▒ NO DEPTH` at the lower edge, if there is room.
fn draw_scale(image: &mut RgbImage, colours: &DepthColours, unit_m: f64) {
    let (width, height) = image.dimensions();
    if width < SCALED_SIZE.0 || height < SCALED_SIZE.1 {
        return;
    }
    let [near, far] = DEPTH_RANGE_M;
    let (near_text, far_text) = (format!("{near}"), format!("{far} M"));
    let none_text = "NO DEPTH";
    let text_width = |text: &str| text.chars().count() as u32 * ADVANCE;
    let top = height - HEIGHT - 4;
    let swatch = 2 * HEIGHT;
    let none_at = width - 2 - text_width(none_text);
    let far_at = none_at - swatch - 10 - text_width(&far_text);
    let near_at = 3;
    let ramp = near_at + text_width(&near_text) + 2..far_at - 4;
    for (x, y) in (0..width).flat_map(|x| (top..height).map(move |y| (x, y))) {
        let is_inside = y >= top + 2 && y + 2 < height;
        let pixel = if is_inside && ramp.contains(&x) {
            let fraction = f64::from(x - ramp.start) / f64::from(ramp.len() as u32 - 1);
            let depth = (near + fraction * (far - near)) / unit_m;
            colours.colour(depth.round().clamp(1.0, 65535.0) as u16, x, y)
        } else if is_inside && (none_at - swatch - 3..none_at - 3).contains(&x) {
            colours.colour(0, x, y)
        } else {
            [0; 3]
        };
        image.put_pixel(x, y, Rgb(pixel));
    }
    let white = Rgb([255; 3]);
    write_text(image, near_at, top + 2, &near_text, white);
    write_text(image, far_at, top + 2, &far_text, white);
    write_text(image, none_at, top + 2, none_text, white);
}

#[cfg(test)]
mod tests {
    use super::*;

    const MM: f64 = 0.001;

    fn full(width: u32, height: u32) -> CropWindow {
        CropWindow {
            left: 0,
            top: 0,
            width,
            height,
        }
    }

    #[test]
    fn ends_and_middle_are_those_of_turbo() {
        let colours = DepthColours::new(MM);
        let near = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 3);
        for (depth, expected) in [
            (100, [66, 47, 133]),
            (450, [167, 246, 72]),
            (800, [144, 13, 0]),
        ] {
            let found = colours.colour(depth, 0, 0);
            assert!(near(found, expected), "{depth} mm: {found:?}");
        }
        assert_eq!(colours.colour(1, 0, 0), colours.colour(100, 0, 0));
        assert_eq!(colours.colour(u16::MAX, 0, 0), colours.colour(800, 0, 0));
    }

    /// A step of two centimetres is visible anywhere in the working range, unlike in a map over the
    /// sensor's whole range.
    #[test]
    fn two_centimetres_are_visible_everywhere() {
        let colours = DepthColours::new(MM);
        for depth in (100..780_u16).step_by(20) {
            let (a, b) = (
                colours.colour(depth, 0, 0),
                colours.colour(depth + 20, 0, 0),
            );
            let change: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(b))).sum();
            assert!(change >= 10, "{depth} mm: {a:?} and {b:?}");
        }
    }

    #[test]
    fn missing_depth_is_striped_grey_and_no_depth_is_grey() {
        let colours = DepthColours::new(MM);
        let stripes = [colours.colour(0, 0, 0), colours.colour(0, STRIPE, 0)];
        assert_ne!(stripes[0], stripes[1]);
        let is_grey = |[r, g, b]: [u8; 3]| r.abs_diff(g).max(g.abs_diff(b)) < 24;
        assert!(stripes.into_iter().all(is_grey));
        assert!((100..=800).all(|depth| !is_grey(colours.colour(depth, 0, 0))));
    }

    #[test]
    fn unit_of_the_camera_counts() {
        let (coarse, fine) = (DepthColours::new(MM), DepthColours::new(0.0001));
        assert_eq!(coarse.colour(450, 0, 0), fine.colour(4500, 0, 0));
        assert_ne!(coarse.colour(450, 0, 0), fine.colour(450, 0, 0));
    }

    #[test]
    fn scale_has_the_colours_of_the_image() {
        let image = draw(|_, _| 450, MM, full(640, 480), (320, 240));
        let middle = *image.get_pixel(0, 0);
        assert_eq!(image.dimensions(), (320, 240));
        let row: Vec<Rgb<u8>> = (0..320).map(|x| *image.get_pixel(x, 234)).collect();
        assert!(row.contains(&middle), "the scale lacks {middle:?}");
        assert!(row.contains(&Rgb(NO_DEPTH[0])) && row.contains(&Rgb(NO_DEPTH[1])));
        assert_eq!(*image.get_pixel(160, 220), middle);
        let small = draw(|_, _| 450, MM, full(4, 4), (40, 30));
        assert!(small.pixels().all(|pixel| *pixel == middle));
    }

    #[test]
    fn pixels_are_the_nearest_of_the_window() {
        let depth = |x: u32, y: u32| (100 + 10 * x + 100 * y) as u16;
        let window = CropWindow {
            left: 2,
            top: 1,
            width: 2,
            height: 1,
        };
        let image = draw(depth, MM, window, (4, 1));
        let colours = DepthColours::new(MM);
        let expected = [220, 220, 230, 230].map(|d| Rgb(colours.colour(d, 0, 0)));
        assert!((0..4).all(|x| *image.get_pixel(x, 0) == expected[x as usize]));
    }
}
