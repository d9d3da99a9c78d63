//! Pictures that users and meshes name, as textures.

use std::path::Path;

use image::{ImageFormat, ImageReader, Limits, RgbImage};

use super::texture::Bitmap;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular};
use gripcast_imaging::jpeg::{JpegDecoder, JpegScale, inspect};
use gripcast_imaging::{CropProfile, crop_and_resize};

/// Textures are scaled down to this side; more detail than a picture of a grasp can show.
const LARGEST_TEXTURE: u32 = 4096;
/// Pictures with a longer side are refused.
const LARGEST_SIDE: u32 = 32_768;
/// Memory that decoding may take, bytes.
const MOST_MEMORY: u64 = 2 << 30;

/// A decoded picture, and a warning where it was changed.
pub(super) struct Loaded {
    pub(super) picture: RgbImage,
    pub(super) warning: Option<String>,
}

/// Reads a PNG or JPEG file as a texture.
///
/// # Errors
/// `NotFound`, `Permission`, `Io` if the file cannot be read; `Input` if it is no PNG or JPEG
/// picture, is damaged or too large.
pub fn load_bitmap(path: &Path) -> Result<Bitmap> {
    let bytes = read_regular(path, FileKind::Mesh).map_err(|e| {
        Error::io("cannot read the texture", e)
            .at(path.display())
            .remedy("check the path and its permissions")
    })?;
    let loaded = decode(&bytes).map_err(|e| e.at(path.display()))?;
    Bitmap::from_srgb8(&loaded.picture)
}

/// The texture in the bytes of a PNG or JPEG file.
///
/// # Errors
/// As of [`load_bitmap`].
pub fn read_bitmap(bytes: &[u8]) -> Result<Bitmap> {
    Bitmap::from_srgb8(&decode(bytes)?.picture)
}

/// Decodes a PNG or JPEG picture and scales it down to the largest texture.
pub(super) fn decode(bytes: &[u8]) -> Result<Loaded> {
    let is_png = bytes.starts_with(b"\x89PNG");
    let picture = match bytes {
        [0xff, 0xd8, ..] => decode_jpeg(bytes)?,
        _ if is_png => decode_png(bytes)?,
        _ => return Err(foreign(bytes)),
    };
    let (width, height) = picture.dimensions();
    let largest = width.max(height);
    if largest <= LARGEST_TEXTURE {
        return Ok(Loaded {
            picture,
            warning: None,
        });
    }
    let scaled = |side: u32| {
        let side = u64::from(side) * u64::from(LARGEST_TEXTURE) / u64::from(largest);
        (side as u32).max(1)
    };
    let small = crop_and_resize(&picture, &CropProfile::FULL, scaled(width), scaled(height))
        .map_err(Error::from)?;
    Ok(Loaded {
        warning: Some(format!(
            "the picture of {width}×{height} is scaled down to {}×{}",
            small.width(),
            small.height()
        )),
        picture: small,
    })
}

fn too_large(width: u32, height: u32) -> Error {
    Error::input(format!(
        "a texture may have {LARGEST_SIDE} pixels a side, found {width}×{height}"
    ))
    .remedy(format!(
        "scale it down; {LARGEST_TEXTURE} pixels are used at most"
    ))
}

fn decode_jpeg(bytes: &[u8]) -> Result<RgbImage> {
    let header = inspect(bytes)?;
    let (width, height) = (header.width, header.height);
    if width.max(height) > LARGEST_SIDE {
        return Err(too_large(width, height));
    }
    let scale = JpegScale::smallest_for((width, height), (LARGEST_TEXTURE, LARGEST_TEXTURE));
    let mut decoder = JpegDecoder::new()?;
    let pixels = decoder.decode(bytes, scale)?;
    let picture = RgbImage::from_raw(pixels.width, pixels.height, pixels.rgb.to_vec());
    picture.ok_or_else(|| too_large(width, height))
}

fn decode_png(bytes: &[u8]) -> Result<RgbImage> {
    let unreadable = |e| {
        Error::input("the PNG cannot be read")
            .because(e)
            .remedy("check that the file was copied whole, or save the picture again")
    };
    let reader = || ImageReader::with_format(std::io::Cursor::new(bytes), ImageFormat::Png);
    let (width, height) = reader().into_dimensions().map_err(unreadable)?;
    if width.max(height) > LARGEST_SIDE {
        return Err(too_large(width, height));
    }
    let mut reader = reader();
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(MOST_MEMORY);
    reader.limits(limits);
    Ok(reader.decode().map_err(unreadable)?.into_rgb8())
}

/// Says what the file is instead, where that is known.
fn foreign(bytes: &[u8]) -> Error {
    let is = match bytes {
        [] => "it is empty",
        [0xab, b'K', b'T', b'X', ..] => "it is a KTX texture",
        [b'R', b'I', b'F', b'F', ..] => "it is a WebP picture",
        [b'G', b'I', b'F', ..] => "it is a GIF picture",
        [b'B', b'M', ..] => "it is a BMP picture",
        [b'D', b'D', b'S', ..] => "it is a DDS texture",
        _ if bytes.starts_with(b"version https://git-lfs") => "it is a Git LFS pointer",
        _ if bytes.starts_with(b"#?") => "it is a Radiance HDR picture",
        _ => "its first bytes are those of neither",
    };
    Error::input(format!("a texture must be a PNG or JPEG picture, but {is}"))
        .remedy("convert it to PNG or JPEG")
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;

    use super::*;
    use gripcast_imaging::{encode_jpeg, encode_png_rgb};

    fn picture(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8, y as u8, 90]))
    }

    #[test]
    fn png_and_jpeg_files_become_textures() {
        let folder = tempfile::tempdir().unwrap();
        let png = folder.path().join("a.png");
        fs::write(&png, encode_png_rgb(&picture(8, 6)).unwrap()).unwrap();
        let bitmap = load_bitmap(&png).unwrap();
        assert_eq!(bitmap.to_srgb8(), picture(8, 6));
        // The content decides, not the name.
        let jpeg = folder.path().join("b.png");
        fs::write(&jpeg, encode_jpeg(&picture(16, 16), 95).unwrap()).unwrap();
        assert_eq!(load_bitmap(&jpeg).unwrap().size(), [16, 16]);
    }

    #[test]
    fn huge_pictures_are_scaled_down_with_a_warning() {
        let loaded = decode(&encode_png_rgb(&picture(5000, 10)).unwrap()).unwrap();
        assert_eq!(loaded.picture.dimensions(), (4096, 8));
        assert!(loaded.warning.unwrap().contains("5000×10"));
        let text = decode(&encode_png_rgb(&picture(40_000, 1)).unwrap());
        let text = text.err().unwrap().to_string();
        assert!(text.contains("40000×1"), "{text}");
    }

    #[test]
    fn wrong_files_are_explained() {
        let whole = encode_png_rgb(&picture(8, 8)).unwrap();
        for (bytes, told) in [
            (&b""[..], "empty"),
            (b"\xabKTX 20\xbb", "KTX"),
            (b"RIFF....WEBP", "WebP"),
            (b"#?RADIANCE", "Radiance"),
            (b"hello", "PNG or JPEG"),
            (&whole[..30], "PNG"),
            (b"\xff\xd8\xff\xe0", "JPEG"),
        ] {
            let error = decode(bytes).err().unwrap();
            assert!(error.to_string().contains(told), "{told}: {error}");
        }
        let missing = load_bitmap(Path::new("/nowhere/wood.png")).unwrap_err();
        assert_eq!(missing.kind(), ErrorKind::NotFound);
    }
}
