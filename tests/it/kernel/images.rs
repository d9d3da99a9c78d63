//! Full-size images for the emulated GelSight Minis.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use image::RgbImage;
use image::imageops::{self, FilterType};
use turbojpeg::{Image, PixelFormat, Subsamp};

use gripcast_testing::shared;

const WIDTH: u32 = 3280;
const HEIGHT: u32 = 2464;
/// Number of different images of each kind, so that cameras do not count as frozen.
const IMAGES: u32 = 3;

/// Directories of images for the two sensors, each with `free/` and `pressed/`.
#[derive(Debug)]
pub(super) struct Images {
    pub(super) left: PathBuf,
    pub(super) right: PathBuf,
}

/// Generates images.
pub(super) fn drawn() -> &'static Images {
    static DRAWN: OnceLock<Images> = OnceLock::new();
    DRAWN.get_or_init(|| write("drawn", &draw))
}

/// Reads images of a real GelSight Mini, 640×480, upscaled; `None` if they are missing.
pub(super) fn real() -> Option<Images> {
    let folder = shared("data/gsmini_taxim_ball")?;
    Some(write("real", &|side, is_pressed, number| {
        let name = match (is_pressed, side) {
            (false, _) => "nocontact.png".to_owned(),
            (true, "left") => format!("ball_{number:02}.png"),
            (true, _) => format!("ball_{:02}.png", 10 + number),
        };
        let mut image = image::open(folder.join(name)).unwrap().to_rgb8();
        stamp(&mut image, side, number);
        image
    }))
}

/// Makes an image unique by a small square in its corner, outside the crop.
fn stamp(image: &mut RgbImage, side: &str, number: u32) {
    let tone = 40 + 20 * number as u8 + if side == "left" { 0 } else { 100 };
    for (x, y) in (0..8).flat_map(|x| (0..8).map(move |y| (x, y))) {
        image.put_pixel(x, y, image::Rgb([tone; 3]));
    }
}

/// Draws an illuminated gel, with a round contact if pressed.
fn draw(side: &str, is_pressed: bool, number: u32) -> RgbImage {
    let mut image = RgbImage::from_fn(640, 480, |x, y| {
        let (x, y) = (x as f32, y as f32);
        let mut rgb = [
            90.0 + 60.0 * (1.0 - x / 640.0),
            110.0 + 40.0 * (y / 480.0),
            90.0 + 60.0 * (x / 640.0),
        ];
        let (dx, dy) = ((x - 320.0) / 90.0, (y - 240.0) / 90.0);
        let inside = 1.0 - dx * dx - dy * dy;
        if is_pressed && inside > 0.0 {
            for (channel, slope) in rgb.iter_mut().zip([-dx, dy, dx]) {
                *channel += 70.0 * slope - 10.0 * inside;
            }
        }
        image::Rgb(rgb.map(|value| value.round() as u8))
    });
    stamp(&mut image, side, number);
    image
}

/// Encodes the images at the size and chroma subsampling of the sensor.
fn write(name: &str, make: &dyn Fn(&str, bool, u32) -> RgbImage) -> Images {
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("gel-images-{name}"));
    for side in ["left", "right"] {
        for (kind, is_pressed) in [("free", false), ("pressed", true)] {
            let dir = root.join(side).join(kind);
            fs::create_dir_all(&dir).unwrap();
            for number in 0..IMAGES {
                let image = make(side, is_pressed, number);
                let full = imageops::resize(&image, WIDTH, HEIGHT, FilterType::Triangle);
                fs::write(dir.join(format!("{number}.jpg")), jpeg(&full)).unwrap();
            }
        }
    }
    Images {
        left: root.join("left"),
        right: root.join("right"),
    }
}

fn jpeg(image: &RgbImage) -> Vec<u8> {
    let image = Image {
        pixels: image.as_raw().as_slice(),
        width: image.width() as usize,
        pitch: image.width() as usize * 3,
        height: image.height() as usize,
        format: PixelFormat::RGB,
    };
    turbojpeg::compress(image, 80, Subsamp::Sub2x1)
        .unwrap()
        .to_vec()
}
