//! Draws the displacement of gel markers over the frames: a strip, a folder of images or a video.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use image::{Rgb, RgbImage};

use super::create_folder;
use super::flags::{check_output, suffix};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::save;
use gripcast_imaging::caption::write_text;
use gripcast_imaging::{draw_arrow, draw_line, encode_png_rgb};
use gripcast_interop::video::ffmpeg_error;
use gripcast_shear::{ShearFrame, ShearSource};

/// Columns and rows of a strip.
const STRIP: [usize; 2] = [3, 2];
/// Magnification of displacements.
const MAGNIFICATION: f64 = 4.0;
/// Width of lines, px.
const WIDTH: f64 = 2.0;
/// Frames per second of a video.
const VIDEO_RATE: &str = "10";
const TRACKED: Rgb<u8> = Rgb([255, 230, 60]);
const LOST: Rgb<u8> = Rgb([255, 60, 60]);
const TEXT: Rgb<u8> = Rgb([255, 255, 255]);

/// Where overlays go.
pub(super) enum Overlay {
    None,
    Strip(PathBuf, Strip),
    Folder(PathBuf),
    Video(PathBuf, Option<Encoder>),
}

impl Overlay {
    /// A strip for `.png`, a video for `.mp4`, else a folder.
    ///
    /// # Errors
    /// `Usage`, `NotFound`, `Io`: the output cannot be created.
    pub(super) fn new(path: Option<&Path>) -> Result<Self> {
        let Some(path) = path else {
            return Ok(Self::None);
        };
        let kind = suffix(path);
        if kind.is_empty() {
            create_folder(path)?;
            return Ok(Self::Folder(path.to_owned()));
        }
        check_output("--overlay", path, &["png", "mp4"])?;
        Ok(match kind == "png" {
            true => Self::Strip(path.to_owned(), Strip::default()),
            false => Self::Video(path.to_owned(), None),
        })
    }

    /// Adds a frame; frames come in order.
    ///
    /// # Errors
    /// Those of writing.
    pub(super) fn add(
        &mut self,
        number: usize,
        image: &RgbImage,
        shear: &ShearFrame,
    ) -> Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Strip(_, strip) => {
                strip.add(|| drawn(number, image, shear));
                Ok(())
            }
            Self::Folder(folder) => {
                let png = encode_png_rgb(&drawn(number, image, shear))?;
                save(&folder.join(format!("{number:06}.png")), &png)
            }
            Self::Video(path, encoder) => {
                let image = drawn(number, image, shear);
                let encoder = match encoder {
                    Some(encoder) => encoder,
                    None => encoder.insert(Encoder::start(path, &image)?),
                };
                encoder.add(&image)
            }
        }
    }

    /// Completes the output.
    ///
    /// # Errors
    /// Those of writing, or of ffmpeg.
    pub(super) fn finish(self) -> Result<()> {
        match self {
            Self::None | Self::Folder(_) | Self::Video(_, None) => Ok(()),
            Self::Strip(path, strip) => save(&path, &encode_png_rgb(&strip.image())?),
            Self::Video(path, Some(encoder)) => encoder.finish().map_err(|e| e.at(path.display())),
        }
    }
}

/// Some frames at even distances, however many there are.
#[derive(Default)]
pub(super) struct Strip {
    kept: Vec<RgbImage>,
    stride: usize,
    seen: usize,
}

impl Strip {
    fn add(&mut self, image: impl FnOnce() -> RgbImage) {
        let capacity = 4 * STRIP[0] * STRIP[1];
        self.stride = self.stride.max(1);
        if self.seen.is_multiple_of(self.stride) {
            self.kept.push(image());
            if self.kept.len() == capacity {
                let mut index = 0;
                self.kept.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.stride *= 2;
            }
        }
        self.seen += 1;
    }

    fn image(&self) -> RgbImage {
        let count = (STRIP[0] * STRIP[1]).min(self.kept.len());
        let chosen = (0..count).map(|i| match count {
            1 => &self.kept[0],
            _ => &self.kept[i * (self.kept.len() - 1) / (count - 1)],
        });
        let chosen: Vec<&RgbImage> = chosen.collect();
        let width = chosen.iter().map(|image| image.width()).max().unwrap_or(1);
        let height = chosen.iter().map(|image| image.height()).max().unwrap_or(1);
        let columns = STRIP[0].min(count).max(1);
        let rows = count.div_ceil(columns).max(1);
        let mut strip = RgbImage::new(columns as u32 * width, rows as u32 * height);
        for (i, image) in chosen.into_iter().enumerate() {
            let (x, y) = ((i % columns) as u32 * width, (i / columns) as u32 * height);
            image::imageops::replace(&mut strip, image, i64::from(x), i64::from(y));
        }
        strip
    }
}

/// A video that ffmpeg encodes.
pub(super) struct Encoder {
    child: Child,
    size: (u32, u32),
}

impl Encoder {
    fn start(path: &Path, first: &RgbImage) -> Result<Self> {
        let size = first.dimensions();
        let child = Command::new("ffmpeg")
            .args([
                "-nostdin", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24",
            ])
            .args([
                "-s",
                &format!("{}x{}", size.0, size.1),
                "-r",
                VIDEO_RATE,
                "-i",
                "-",
            ])
            .args([
                "-vf",
                "pad=ceil(iw/2)*2:ceil(ih/2)*2",
                "-pix_fmt",
                "yuv420p",
            ])
            .arg(path)
            .stdin(Stdio::piped())
            .spawn()
            .map_err(ffmpeg_error)?;
        Ok(Self { child, size })
    }

    fn add(&mut self, image: &RgbImage) -> Result<()> {
        // A video has one size; a frame of another one has no field to draw either.
        if image.dimensions() != self.size {
            return Ok(());
        }
        let input = self.child.stdin.as_mut();
        let input = input.ok_or_else(|| Error::internal("ffmpeg has no input"))?;
        input
            .write_all(image.as_raw())
            .map_err(|e| Error::io("cannot write the overlay to ffmpeg", e))
    }

    fn finish(mut self) -> Result<()> {
        drop(self.child.stdin.take());
        let status = self
            .child
            .wait()
            .map_err(|e| Error::io("cannot wait for ffmpeg", e))?;
        match status.success() {
            true => Ok(()),
            false => Err(Error::input(format!(
                "ffmpeg could not encode the overlay: {status}"
            ))),
        }
    }
}

/// The frame with an arrow for each gel marker, from its rest position, magnified.
fn drawn(number: usize, image: &RgbImage, shear: &ShearFrame) -> RgbImage {
    let mut drawn = image.clone();
    let markers = shear
        .field
        .iter()
        .flat_map(|field| field.markers.iter().flatten());
    for marker in markers {
        if marker.confidence > 0.0 {
            let from = marker.rest_px.map(f64::from);
            let moved = marker.displacement_px().map(f64::from);
            let to = [0, 1].map(|axis| from[axis] + MAGNIFICATION * moved[axis]);
            draw_arrow(&mut drawn, from, to, WIDTH, TRACKED);
        } else {
            let [x, y] = marker.position_px.map(f64::from);
            let [left, right, top, bottom] = [x - 4.0, x + 4.0, y - 4.0, y + 4.0];
            draw_line(&mut drawn, [left, top], [right, bottom], WIDTH, LOST);
            draw_line(&mut drawn, [left, bottom], [right, top], WIDTH, LOST);
        }
    }
    let mut text = format!("{number}");
    if let Some(summary) = shear.summary {
        let centre = [image.width(), image.height()].map(|side| 0.5 * f64::from(side));
        let [dx, dy] = summary.mean_displacement_mm;
        if summary.source == ShearSource::Texture {
            // A millimetre is a quarter of the image.
            let length = 0.25 * f64::from(image.width());
            let to = [centre[0] + length * dx, centre[1] + length * dy];
            draw_arrow(&mut drawn, centre, to, WIDTH, TRACKED);
        }
        if let Some(slip) = summary.slip_ratio {
            text += &format!(" slip {slip:.2}");
        }
    }
    write_text(
        &mut drawn,
        4,
        image.height().saturating_sub(11),
        &text,
        TEXT,
    );
    drawn
}
