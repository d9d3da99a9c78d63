//! Reads PNG and JPEG files as textures.

use std::path::Path;

use image::{ImageFormat, ImageReader, Limits, RgbImage};

use super::texture::Bitmap;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, file_type, read_regular};
use gripcast_imaging::jpeg::{JpegDecoder, JpegScale, inspect};
use gripcast_imaging::{CropProfile, crop_and_resize};

/// Longest side of a texture, px. Larger images are scaled down: renders of a grasp show no more
/// detail.
const MAX_TEXTURE: u32 = 4096;
/// Longest side of an image that is read, px.
const MAX_SIDE: u32 = 32_768;
/// Memory limit of the decoder, bytes.
const MAX_MEMORY: u64 = 2 << 30;

/// A decoded image and, if it was scaled down, a warning.
pub(super) struct Loaded {
    pub(super) image: RgbImage,
    pub(super) warning: Option<String>,
}

/// Reads a PNG or JPEG file as a texture.
///
/// # Errors
/// `NotFound`, `Permission`, `Io` if the file cannot be read; `Input` if it is not a PNG or JPEG
/// image, is damaged or too large.
pub fn load_bitmap(path: &Path) -> Result<Bitmap> {
    let bytes = read_image_file(path, "texture")?;
    let loaded = decode(&bytes).map_err(|e| e.at(path.display()))?;
    Bitmap::from_srgb8(&loaded.image)
}

/// Decodes a PNG or JPEG image as a texture.
///
/// # Errors
/// `Input` as [`load_bitmap`].
pub fn read_bitmap(bytes: &[u8]) -> Result<Bitmap> {
    Bitmap::from_srgb8(&decode(bytes)?.image)
}

/// Decodes a PNG or JPEG image and scales it down to [`MAX_TEXTURE`].
pub(super) fn decode(bytes: &[u8]) -> Result<Loaded> {
    let image = match bytes {
        [0xff, 0xd8, ..] => decode_jpeg(bytes)?,
        [0x89, b'P', b'N', b'G', ..] => decode_png(bytes)?,
        _ => return Err(unsupported(bytes)),
    };
    let (width, height) = image.dimensions();
    let largest = width.max(height);
    if largest <= MAX_TEXTURE {
        return Ok(Loaded {
            image,
            warning: None,
        });
    }
    let scaled = |side: u32| {
        let side = u64::from(side) * u64::from(MAX_TEXTURE) / u64::from(largest);
        (side as u32).max(1)
    };
    let small = crop_and_resize(&image, &CropProfile::FULL, scaled(width), scaled(height))
        .map_err(Error::from)?;
    Ok(Loaded {
        warning: Some(format!(
            "the image of {width}×{height} px is scaled down to {}×{} px",
            small.width(),
            small.height()
        )),
        image: small,
    })
}

fn too_large(width: u32, height: u32) -> Error {
    Error::input(format!(
        "a texture may have at most {MAX_SIDE} pixels per side, found {width}×{height}"
    ))
    .remedy(format!(
        "scale it down to {MAX_TEXTURE} pixels, the most that is used"
    ))
}

fn decode_jpeg(bytes: &[u8]) -> Result<RgbImage> {
    let header = inspect(bytes)?;
    let (width, height) = (header.width, header.height);
    if width.max(height) > MAX_SIDE {
        return Err(too_large(width, height));
    }
    let scale = JpegScale::smallest_for((width, height), (MAX_TEXTURE, MAX_TEXTURE));
    let mut decoder = JpegDecoder::new()?;
    let pixels = decoder.decode(bytes, scale)?;
    let image = RgbImage::from_raw(pixels.width, pixels.height, pixels.rgb.to_vec());
    image.ok_or_else(|| too_large(width, height))
}

fn decode_png(bytes: &[u8]) -> Result<RgbImage> {
    let unreadable = |e| {
        Error::input("cannot decode the PNG image")
            .because(e)
            .remedy("check that the file is complete, or export the image again")
    };
    let reader = || ImageReader::with_format(std::io::Cursor::new(bytes), ImageFormat::Png);
    let (width, height) = reader().into_dimensions().map_err(unreadable)?;
    if width.max(height) > MAX_SIDE {
        return Err(too_large(width, height));
    }
    let mut reader = reader();
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(MAX_MEMORY);
    reader.limits(limits);
    Ok(reader.decode().map_err(unreadable)?.into_rgb8())
}

/// Error for a file of another type, which is named if recognised.
fn unsupported(bytes: &[u8]) -> Error {
    let found = file_type(bytes).unwrap_or("a file of another type");
    Error::input(format!(
        "a texture must be a PNG or JPEG image, found {found}"
    ))
    .remedy("convert it to PNG or JPEG")
}

/// Reads a whole image file, with an error that says what cannot be read.
pub(super) fn read_image_file(path: &Path, what: &str) -> Result<Vec<u8>> {
    read_regular(path, FileKind::Mesh).map_err(|e| {
        Error::io(format!("cannot read the {what}"), e)
            .at(path.display())
            .remedy("check the path and its permissions")
    })
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;

    use super::*;
    use gripcast_imaging::{encode_jpeg, encode_png_rgb};

    fn image(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8, y as u8, 90]))
    }

    #[test]
    fn png_and_jpeg_files_load_as_textures() {
        let folder = tempfile::tempdir().unwrap();
        let png = folder.path().join("a.png");
        fs::write(&png, encode_png_rgb(&image(8, 6)).unwrap()).unwrap();
        let bitmap = load_bitmap(&png).unwrap();
        assert_eq!(bitmap.to_srgb8(), image(8, 6));
        // The content decides, not the name.
        let jpeg = folder.path().join("b.png");
        fs::write(&jpeg, encode_jpeg(&image(16, 16), 95).unwrap()).unwrap();
        assert_eq!(load_bitmap(&jpeg).unwrap().size(), [16, 16]);
    }

    #[test]
    fn large_image_is_scaled_down_with_warning() {
        let loaded = decode(&encode_png_rgb(&image(5000, 10)).unwrap()).unwrap();
        assert_eq!(loaded.image.dimensions(), (4096, 8));
        assert!(loaded.warning.unwrap().contains("5000×10"));
        let text = decode(&encode_png_rgb(&image(40_000, 1)).unwrap());
        let text = text.err().unwrap().to_string();
        assert!(text.contains("40000×1"), "{text}");
    }

    #[test]
    fn unsupported_file_error_names_its_format() {
        let whole = encode_png_rgb(&image(8, 8)).unwrap();
        for (bytes, expected) in [
            (&b""[..], "empty"),
            (b"\xabKTX 20\xbb", "KTX"),
            (b"RIFF....WEBP", "WebP"),
            (b"#?RADIANCE", "Radiance"),
            (b"hello", "PNG or JPEG"),
            (&whole[..30], "PNG"),
            (b"\xff\xd8\xff\xe0", "JPEG"),
        ] {
            let error = decode(bytes).err().unwrap();
            assert!(error.to_string().contains(expected), "{expected}: {error}");
        }
        let missing = load_bitmap(Path::new("/nowhere/wood.png")).unwrap_err();
        assert_eq!(missing.kind(), ErrorKind::NotFound);
    }
}
