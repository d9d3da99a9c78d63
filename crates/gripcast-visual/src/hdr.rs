//! Radiance HDR images (RGBE), the usual format of environment maps.
//!
//! `image` 0.25 is not used: it reads only `-Y +X`, allocates the whole image from the header,
//! mistakes rows of fewer than 8 pixels that begin with (2, 2, …) for run lengths, and its repeat
//! factor overflows on a chain of empty runs. This reader has a specific error for each kind of
//! damage. Format: Ward, *Real Pixels* (Graphics Gems II, 1991) and the manual page of Radiance's
//! `rpict`.

use std::path::Path;

use super::bitmap_file::read_image_file;
use super::linear_image::Image;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::file_type;

/// Maximum pixels per side; the largest environment maps in circulation have 16384 × 8192.
const MAX_SIDE: usize = 16_384;
/// Maximum number of header lines.
const MAX_HEADER_LINES: usize = 200;

/// Reads a Radiance HDR file as linear RGB radiance, top row first.
///
/// # Errors
/// `NotFound`, `Permission`, `Io` if the file cannot be read; `Input` if it is not a Radiance HDR
/// image, is truncated or too large.
pub fn load_hdr(path: &Path) -> Result<Image> {
    let bytes = read_image_file(path, "HDR image")?;
    read_hdr(&bytes).map_err(|e| e.at(path.display()))
}

/// Parses the bytes of a Radiance HDR file; see [`load_hdr`].
///
/// # Errors
/// `Input` as [`load_hdr`].
pub fn read_hdr(bytes: &[u8]) -> Result<Image> {
    if !bytes.starts_with(b"#?") {
        return Err(not_hdr(bytes));
    }
    let mut reader = Reader { bytes, position: 0 };
    let (size, exposure) = reader.header()?;
    let Layout { length, count, .. } = size;
    // Lines are appended as they are decoded, so that a forged header cannot allocate memory.
    let mut pixels = Vec::new();
    let mut codes = vec![[0_u8; 4]; length];
    for line in 0..count {
        reader.scan_line(&mut codes).map_err(|what| {
            invalid(format!("{what} in line {line} of {count}"))
                .remedy("check that the file is complete")
        })?;
        pixels.extend(
            codes
                .iter()
                .map(|&code| radiance(code).map(|v| v / exposure)),
        );
        if size.is_line_reversed {
            pixels[line * length..].reverse();
        }
    }
    if size.is_order_reversed {
        pixels = pixels.chunks(length).rev().flatten().copied().collect();
    }
    if !size.is_by_column {
        return Image::from_pixels(length, count, pixels);
    }
    let rows = (0..length).flat_map(|y| (0..count).map(move |x| x * length + y));
    Image::from_pixels(count, length, rows.map(|i| pixels[i]).collect())
}

fn invalid(what: impl Into<String>) -> Error {
    Error::input(what)
}

/// Error for a file of another type, which is named if recognised.
fn not_hdr(bytes: &[u8]) -> Error {
    let found = file_type(bytes).unwrap_or("a file of another type");
    invalid(format!(
        "expected a Radiance HDR image (`#?RADIANCE`), found {found}"
    ))
    .remedy("use a .hdr file (RGBE), for instance from Poly Haven, or a procedural sky")
}

/// Size and order of the pixels: lines are rows, or columns.
struct Layout {
    /// Pixels of a line.
    length: usize,
    /// Number of lines.
    count: usize,
    is_by_column: bool,
    /// Rows from right to left, or columns from bottom to top.
    is_line_reversed: bool,
    /// Rows from bottom to top, or columns from right to left.
    is_order_reversed: bool,
}

struct Reader<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl Reader<'_> {
    fn byte(&mut self) -> Result<u8, &'static str> {
        let byte = self.bytes.get(self.position).ok_or("the file ends")?;
        self.position += 1;
        Ok(*byte)
    }

    fn code(&mut self) -> Result<[u8; 4], &'static str> {
        Ok([self.byte()?, self.byte()?, self.byte()?, self.byte()?])
    }

    fn line(&mut self) -> Option<String> {
        let rest = self.bytes.get(self.position..)?;
        let length = rest.iter().position(|&b| b == b'\n')?;
        self.position += length + 1;
        let text = String::from_utf8_lossy(&rest[..length]);
        Some(text.trim_end_matches('\r').to_string())
    }

    /// Returns the layout and the product of the exposures applied to the values.
    fn header(&mut self) -> Result<(Layout, f32)> {
        let mut exposure = 1.0_f32;
        for _ in 0..MAX_HEADER_LINES {
            let Some(line) = self.line() else { break };
            if let Some(format) = line.strip_prefix("FORMAT=") {
                if format.trim() != "32-bit_rle_rgbe" {
                    return Err(invalid(format!(
                        "HDR values must be 32-bit_rle_rgbe, found {format:?}"
                    ))
                    .remedy(
                        "convert the image to RGBE, for instance with Radiance's `ra_xyze -r`",
                    ));
                }
            } else if let Some(value) = line.strip_prefix("EXPOSURE=") {
                let value = value.trim().parse().unwrap_or(1.0_f32);
                if value.is_normal() && value > 0.0 {
                    exposure *= value;
                }
            } else if ["-Y ", "+Y ", "-X ", "+X "]
                .iter()
                .any(|axis| line.starts_with(axis))
            {
                return Ok((layout(&line)?, exposure));
            }
        }
        Err(
            invalid("the HDR header does not end in a size such as `-Y 512 +X 1024`")
                .remedy("check that the file is complete"),
        )
    }

    /// Decodes one row in any of the three encodings.
    fn scan_line(&mut self, codes: &mut [[u8; 4]]) -> Result<(), &'static str> {
        let first = self.code()?;
        let is_new = first[0] == 2 && first[1] == 2 && first[2] < 128;
        let announced = usize::from(first[2]) << 8 | usize::from(first[3]);
        if is_new && announced == codes.len() && (8..32_768).contains(&codes.len()) {
            return (0..4).try_for_each(|channel| self.channel(codes, channel));
        }
        self.position -= 4;
        self.old_line(codes)
    }

    /// Decodes one channel of a run-length encoded row.
    fn channel(&mut self, codes: &mut [[u8; 4]], channel: usize) -> Result<(), &'static str> {
        let mut column = 0;
        while column < codes.len() {
            let count = self.byte()?;
            let length = usize::from(if count > 128 { count - 128 } else { count });
            if length == 0 || column + length > codes.len() {
                return Err("a run does not fit the width");
            }
            if count > 128 {
                let value = self.byte()?;
                codes[column..column + length]
                    .iter_mut()
                    .for_each(|c| c[channel] = value);
            } else {
                for code in &mut codes[column..column + length] {
                    code[channel] = self.byte()?;
                }
            }
            column += length;
        }
        Ok(())
    }

    /// Decodes flat pixels, where (1, 1, 1, n) repeats the previous one.
    fn old_line(&mut self, codes: &mut [[u8; 4]]) -> Result<(), &'static str> {
        let (mut column, mut shift) = (0, 0_u32);
        while column < codes.len() {
            let code = self.code()?;
            if code[..3] != [1, 1, 1] {
                codes[column] = code;
                (column, shift) = (column + 1, 0);
                continue;
            }
            let length = usize::from(code[3]) << shift;
            if column == 0 || shift > 16 || column + length > codes.len() {
                return Err("a repetition does not fit the width");
            }
            let last = codes[column - 1];
            codes[column..column + length].fill(last);
            (column, shift) = (column + length, shift + 8);
        }
        Ok(())
    }
}

/// Parses a size such as `-Y 512 +X 1024`: rows from the top, each from the left.
fn layout(line: &str) -> Result<Layout> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let parsed = match words[..] {
        [first, count, second, length] => {
            let numbers = count
                .parse::<usize>()
                .ok()
                .zip(length.parse::<usize>().ok());
            let order = match (first, second) {
                ("-Y" | "+Y", "-X" | "+X") => Some((false, first == "+Y", second == "-X")),
                ("-X" | "+X", "-Y" | "+Y") => Some((true, first == "-X", second == "+Y")),
                _ => None,
            };
            numbers.zip(order).map(|((count, length), order)| Layout {
                length,
                count,
                is_by_column: order.0,
                is_order_reversed: order.1,
                is_line_reversed: order.2,
            })
        }
        _ => None,
    };
    let size = parsed.ok_or_else(|| invalid(format!("invalid HDR size {line:?}")))?;
    let is_usable = |n: usize| (1..=MAX_SIDE).contains(&n);
    if !is_usable(size.length) || !is_usable(size.count) {
        return Err(invalid(format!(
            "an HDR image must have 1 to {MAX_SIDE} pixels per side, found {}×{}",
            size.length, size.count
        ))
        .remedy("scale it down; 2048×1024 is enough for lighting"));
    }
    Ok(size)
}

/// Converts mantissas with a common exponent to radiance.
fn radiance([r, g, b, exponent]: [u8; 4]) -> [f32; 3] {
    if exponent == 0 {
        return [0.0; 3];
    }
    let scale = 2.0_f32.powi(i32::from(exponent) - 136);
    [r, g, b].map(|m| f32::from(m) * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    fn file(size: &str, body: &[u8]) -> Vec<u8> {
        let head = format!("#?RADIANCE\n# by hand\nFORMAT=32-bit_rle_rgbe\n\n{size}\n");
        [head.as_bytes(), body].concat()
    }

    #[test]
    fn all_three_encodings_are_decoded() {
        let flat = [128, 64, 32, 129, 0, 0, 0, 0];
        let image = read_hdr(&file("-Y 1 +X 2", &flat)).unwrap();
        assert_eq!(image.pixels, [[1.0, 0.5, 0.25], [0.0; 3]]);

        let old = [128, 64, 32, 129, 1, 1, 1, 3];
        let image = read_hdr(&file("-Y 1 +X 4", &old)).unwrap();
        assert_eq!(image.pixels, [[1.0, 0.5, 0.25]; 4]);

        let mut new = vec![2, 2, 0, 9];
        new.extend([128 + 9, 128]); // a run of red
        new.extend([9, 64, 64, 64, 64, 64, 64, 64, 64, 64]); // green one by one
        new.extend([128 + 4, 32, 128 + 5, 32]);
        new.extend([128 + 9, 129]);
        let image = read_hdr(&file("-Y 1 +X 9", &new)).unwrap();
        assert_eq!(image.pixels, [[1.0, 0.5, 0.25]; 9]);
    }

    #[test]
    fn pixel_order_and_exposure_are_normalised() {
        let body = [128, 0, 0, 129, 0, 128, 0, 129];
        let turned = read_hdr(&file("+Y 2 -X 1", &body)).unwrap();
        assert_eq!(turned.pixels, [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
        // Columns from the left, each from the top: the first two pixels are the left column.
        let body = [1_u8, 2, 3, 4].map(|red| [red, 0, 0, 136]).concat();
        for (size, expected) in [
            ("+X 2 -Y 2", [1.0, 3.0, 2.0, 4.0]),
            ("+X 2 +Y 2", [2.0, 4.0, 1.0, 3.0]),
            ("-X 2 -Y 2", [3.0, 1.0, 4.0, 2.0]),
            ("-X 2 +Y 2", [4.0, 2.0, 3.0, 1.0]),
        ] {
            let image = read_hdr(&file(size, &body)).unwrap();
            let reds: Vec<f32> = image.pixels.iter().map(|p| p[0]).collect();
            assert_eq!(reds, expected, "{size}");
        }
        let tall = read_hdr(&file("+X 1 -Y 4", &body)).unwrap();
        assert_eq!((tall.width, tall.height), (1, 4));
        let head = "#?RGBE\nEXPOSURE=2\nEXPOSURE= 0\n\n-Y 1 +X 1\n";
        let halved = read_hdr(&[head.as_bytes(), &[128, 64, 32, 129]].concat()).unwrap();
        assert_eq!(halved.pixels, [[0.5, 0.25, 0.125]]);
    }

    #[test]
    fn damaged_or_foreign_file_is_explained() {
        let whole = file("-Y 2 +X 1", &[128, 64, 32, 129, 128, 64, 32, 129]);
        let cut = &whole[..whole.len() - 2];
        let mut overlong = vec![2, 2, 0, 8];
        overlong.extend([128 + 9, 1]);
        let xyze = b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\nabcd".to_vec();
        for (bytes, expected) in [
            (Vec::new(), "empty"),
            (b"\x89PNG\r\n".to_vec(), "PNG"),
            (b"\xff\xd8\xff\xe0".to_vec(), "JPEG"),
            (b"\x76\x2f\x31\x01".to_vec(), "OpenEXR"),
            (
                b"version https://git-lfs.github.com".to_vec(),
                "git lfs pull",
            ),
            (b"hello".to_vec(), "#?RADIANCE"),
            (b"#?RADIANCE\nno size".to_vec(), "-Y 512 +X 1024"),
            (xyze, "32-bit_rle_xyze"),
            (cut.to_vec(), "the file ends in line 1 of 2"),
            (file("-Y 1 +X 8", &overlong), "does not fit the width"),
            (file("-Y 1 +X 99999999", &[]), "pixels per side"),
            (file("-Y 0 +X 4", &[]), "pixels per side"),
            (file("-Y one +X 4", &[]), "invalid HDR size"),
            (file("-Y 4 +Y 4", &[]), "invalid HDR size"),
        ] {
            let error = read_hdr(&bytes).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Input);
            assert!(error.to_string().contains(expected), "{expected}: {error}");
        }
        let missing = load_hdr(Path::new("/nowhere/sky.hdr")).unwrap_err();
        assert_eq!(missing.kind(), ErrorKind::NotFound);
    }
}
