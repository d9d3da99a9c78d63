//! Names the type of a file by its first bytes.

/// Signatures: offset, bytes, and what the file is. The first match counts.
const SIGNATURES: &[(usize, &[u8], &str)] = &[
    (
        0,
        b"version https://git-lfs",
        "a Git LFS pointer (fetch the file with `git lfs pull`)",
    ),
    (0, b"\x89PNG", "a PNG image"),
    (0, b"\xff\xd8\xff", "a JPEG image"),
    (8, b"WEBP", "a WebP image"),
    (0, b"GIF8", "a GIF image"),
    (0, b"II*\0", "a TIFF image"),
    (0, b"MM\0*", "a TIFF image"),
    (0, b"#?", "a Radiance HDR image"),
    (0, b"\x76\x2f\x31\x01", "an OpenEXR image"),
    (0, b"\xabKTX", "a KTX texture"),
    (0, b"DDS ", "a DDS texture"),
    (4, b"ftyp", "an MP4, HEIC or AVIF file"),
    (4, b"TFL3", "a TensorFlow Lite model"),
    (4, b"TFL2", "a TensorFlow Lite model"),
    (0, b"\x89HDF", "an HDF5 file"),
    (0, b"PAR1", "a Parquet file"),
    (0, b"ARROW1", "an Arrow (Feather) file"),
    (0, b"\x93NUMPY", "a NumPy array"),
    (0, b"glTF", "a glTF binary"),
    (0, b"GGUF", "a GGUF model"),
    (0, b"%PDF", "a PDF file"),
    (0, b"\x7fELF", "a program or library"),
    (0, b"\x1f\x8b", "a gzip archive (unpack it first)"),
    (0, b"\x28\xb5\x2f\xfd", "a zstd archive (unpack it first)"),
    (0, b"\xfd7zXZ\0", "an xz archive (unpack it first)"),
    (0, b"BZh", "a bzip2 archive (unpack it first)"),
    (0, b"7z\xbc\xaf", "a 7-Zip archive (unpack it first)"),
    (0, b"Rar!", "a RAR archive (unpack it first)"),
    (257, b"ustar", "a tar archive (unpack it first)"),
];
/// Bytes of the start of a ZIP archive.
const ZIP: &[u8] = b"PK\x03\x04";
/// Start of a pickle of PyTorch's old format, after the opcode for its magic number.
const OLD_PYTORCH: &[u8] = b"\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19";
/// Bytes read to tell HTML, and text from binary.
const START: usize = 4096;

/// Names the type of a file, with an article: `a PNG image`. None if it is not recognised.
///
/// Only the start is looked at, so a damaged file is named as what it was. ONNX files have no
/// signature.
#[must_use]
pub fn file_type(bytes: &[u8]) -> Option<&'static str> {
    if bytes.is_empty() {
        return Some("an empty file");
    }
    let known = SIGNATURES
        .iter()
        .find(|(at, magic, _)| bytes.get(*at..).is_some_and(|b| b.starts_with(magic)));
    if let Some((_, _, name)) = known {
        return Some(name);
    }
    if bytes.starts_with(ZIP) {
        let holds_pickle = find(bytes, b"data.pkl") || find(bytes, b"constants.pkl");
        return Some(if holds_pickle {
            "a PyTorch file (weights or TorchScript in a ZIP archive)"
        } else {
            "a ZIP archive"
        });
    }
    if let Some(name) = pickle(bytes) {
        return Some(name);
    }
    if is_safetensors(bytes) {
        return Some("a safetensors file (weights without a network)");
    }
    text(bytes).or_else(|| bytes.starts_with(b"BM").then_some("a BMP image"))
}

fn find(bytes: &[u8], text: &[u8]) -> bool {
    let start = &bytes[..bytes.len().min(START)];
    start.windows(text.len()).any(|window| window == text)
}

/// Recognises pickles of the protocols 0 to 5.
fn pickle(bytes: &[u8]) -> Option<&'static str> {
    let body = match bytes {
        [0x80, 1..=5, body @ ..] => body,
        // Protocols 0 and 1 have no header: a container, its number, and a stop at the end.
        [b'(', b'd' | b'l' | b't', b'p', b'0'..=b'9', ..] | [b'}' | b']', b'q', ..]
            if bytes.trim_ascii_end().ends_with(b".") =>
        {
            bytes
        }
        _ => return None,
    };
    Some(if body.starts_with(OLD_PYTORCH) {
        "a PyTorch file (pickled weights)"
    } else {
        "a Python pickle"
    })
}

/// Whether a length and a JSON object of that length are at the start.
fn is_safetensors(bytes: &[u8]) -> bool {
    let Some((length, json)) = bytes.split_first_chunk::<8>() else {
        return false;
    };
    let length = u64::from_le_bytes(*length);
    json.starts_with(b"{\"") && (2..1 << 32).contains(&length)
}

fn text(bytes: &[u8]) -> Option<&'static str> {
    let start = &bytes[..bytes.len().min(START)];
    let text = match std::str::from_utf8(start) {
        Ok(text) => text,
        // A character cut off at the end is no damage.
        Err(e) if e.error_len().is_none() => std::str::from_utf8(&start[..e.valid_up_to()]).ok()?,
        Err(_) => return None,
    };
    let is_text = |c: char| !c.is_control() || c.is_whitespace();
    if !text.chars().all(is_text) {
        return None;
    }
    let text = text.trim_start_matches('\u{feff}').trim_start();
    let tag: String = text.chars().take(15).collect::<String>().to_lowercase();
    Some(match text.chars().next() {
        _ if tag.starts_with("<!doctype html") || tag.starts_with("<html") => {
            "an HTML page (probably an error page of a download)"
        }
        Some('<') => "an XML or HTML file",
        Some('{' | '[') => "a JSON file",
        _ => "a text file",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_named_by_their_start() {
        let safetensors = [&64_u64.to_le_bytes()[..], b"{\"w\":{\"dtype\":\"F32\"}}"].concat();
        let old = [&b"\x80\x02"[..], OLD_PYTORCH, b"."].concat();
        let cases: &[(&[u8], &str)] = &[
            (b"", "empty"),
            (b"\x89PNG\r\n\x1a\n", "PNG"),
            (b"RIFF\x10\0\0\0WEBPVP8 ", "WebP"),
            (b"\x1c\0\0\0TFL3\0\0", "TensorFlow Lite"),
            (b"PK\x03\x04\0\0archive/data.pkl", "PyTorch"),
            (b"PK\x03\x04\0\0notes.txt", "ZIP"),
            (b"\x80\x02}q\0.", "pickle"),
            (b"\x80\x05\x95\0\0\0", "pickle"),
            (b"(dp0\nVstate\np1\n.", "pickle"),
            (b"}q\0X\x05\0\0\0statq\x01.", "pickle"),
            (&old, "PyTorch"),
            (&safetensors, "safetensors"),
            (b"\n<!DOCTYPE html><title>404 \xe2\x80\x93", "HTML page"),
            ("\u{feff}<HTML>".as_bytes(), "HTML page"),
            (b"<?xml version=\"1.0\"?>", "XML"),
            (b"{\"a\": 1}", "JSON"),
            ("Grüße".as_bytes(), "text"),
        ];
        for (bytes, expected) in cases {
            let name = file_type(bytes).unwrap_or_default();
            assert!(name.contains(expected), "{expected}: {name:?}");
        }
    }

    #[test]
    fn binary_files_without_a_signature_are_not_named() {
        for bytes in [&b"\x08\x08\x12\x07pytorch"[..], b"\xfe\xfe\xfe", b"\x08"] {
            assert_eq!(file_type(bytes), None, "{bytes:?}");
        }
    }

    #[test]
    fn text_may_end_within_a_character() {
        let mut long = vec![b'a'; START - 1];
        long.extend("ü".as_bytes());
        assert_eq!(file_type(&long), Some("a text file"));
    }
}
