//! Images in pages: validated data URIs.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::RgbImage;
use maud::{Markup, html};

use gripcast_base::error::Result;
use gripcast_imaging::encode_jpeg;

/// JPEG quality of the images in a page.
const QUALITY: u8 = 80;

/// Encodes an image as `data:image/jpeg;base64,…`.
///
/// # Errors
/// `Input` for an empty image.
pub fn data_uri(image: &RgbImage) -> Result<String> {
    let bytes = encode_jpeg(image, QUALITY)?;
    Ok(format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes)))
}

/// Renders an image with an id for [`repeat_image`]; a placeholder if the URI is invalid.
pub fn image(uri: &str, id: &str, alt: &str) -> Markup {
    frame(uri, alt, |[width, height]| {
        html! { image id=(id) width=(width) height=(height) href=(uri) {} }
    })
}

/// Renders an image of the same page a second time, without its bytes.
pub fn repeat_image(uri: &str, id: &str, alt: &str) -> Markup {
    frame(uri, alt, |_| html! { use href={ "#" (id) } {} })
}

fn frame(uri: &str, alt: &str, content: impl Fn([u32; 2]) -> Markup) -> Markup {
    html! {
        @if let Some([width, height]) = size(uri) {
            svg.pic viewBox={ "0 0 " (width) " " (height) } role="img" aria-label=(alt) {
                (content([width, height]))
            }
        } @else {
            span.nopic role="img" aria-label={ (alt) ": missing" } { "no image" }
        }
    }
}

/// Width and height, px, of a JPEG or PNG data URI; none for anything else.
fn size(uri: &str) -> Option<[u32; 2]> {
    let (kind, body) = uri.strip_prefix("data:image/")?.split_once(";base64,")?;
    let bytes = STANDARD.decode(body).ok()?;
    let size = match kind {
        "jpeg" => jpeg_size(&bytes)?,
        "png" => png_size(&bytes)?,
        _ => return None,
    };
    (size[0] > 0 && size[1] > 0).then_some(size)
}

fn png_size(bytes: &[u8]) -> Option<[u32; 2]> {
    let rest = bytes.strip_prefix(b"\x89PNG\r\n\x1a\n")?;
    let number = |at: usize| -> Option<u32> {
        Some(u32::from_be_bytes(rest.get(at..at + 4)?.try_into().ok()?))
    };
    Some([number(8)?, number(12)?])
}

/// Reads the start-of-frame segment (ITU T.81, B.2.2).
fn jpeg_size(bytes: &[u8]) -> Option<[u32; 2]> {
    let mut at = bytes.strip_prefix(b"\xff\xd8").map(|_| 2)?;
    let number = |at: usize| -> Option<usize> {
        let pair = bytes.get(at..at + 2)?;
        Some(usize::from(pair[0]) << 8 | usize::from(pair[1]))
    };
    loop {
        let [0xff, marker] = *bytes.get(at..at + 2)? else {
            return None;
        };
        match marker {
            0xff => at += 1,
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                return Some([number(at + 7)? as u32, number(at + 5)? as u32]);
            }
            0xda => return None,
            _ => at += 2 + number(at + 2)?,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jpeg(bytes: &[u8]) -> String {
        format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes))
    }

    #[test]
    fn size_is_read_from_the_header() {
        let head = [
            0xff, 0xd8, 0xff, 0xe0, 0, 4, 9, 9, 0xff, 0xff, 0xc0, 0, 11, 8, 0, 120, 0, 160, 1,
        ];
        assert_eq!(size(&jpeg(&head)), Some([160, 120]));
        assert_eq!(size(&jpeg(&head[..14])), None);
        let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
        png.extend([0, 0, 0, 3, 0, 0, 0, 2]);
        let uri = format!("data:image/png;base64,{}", STANDARD.encode(&png));
        assert_eq!(size(&uri), Some([3, 2]));
    }

    #[test]
    fn invalid_uris_render_a_placeholder() {
        for uri in [
            "",
            "https://example.org/a.jpg",
            "data:image/svg+xml;base64,PHN2Zz4=",
            "data:image/jpeg;base64,\"/><script>",
            "data:image/jpeg;base64,AAAA",
        ] {
            let out = image(uri, "p", "the \"view\"").into_string();
            assert!(
                out.contains("no image") && !out.contains("image id"),
                "{uri}"
            );
            assert!(out.contains("the &quot;view&quot;: missing"), "{out}");
        }
    }
}
