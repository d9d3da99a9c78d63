//! Reads ONNX files.

use std::path::Path;

use prost::Message as _;
use tract_onnx::pb::ModelProto;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular};

/// First byte of ONNX files: field 1, varint (`ir_version`).
const FIRST_BYTE: u8 = 0x08;

/// Reads a model file.
///
/// # Errors
/// When it is missing, unreadable, not a regular file, or too large.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    read_regular(path, FileKind::Model)
        .map_err(|e| Error::io("cannot read the model file", e).at(path.display()))
}

/// Decodes a model file.
///
/// # Errors
/// When the bytes are not an ONNX message; the error names recognised other formats.
pub fn decode(bytes: &[u8]) -> Result<ModelProto> {
    if bytes.is_empty() {
        return Err(Error::input("the model file is empty (0 bytes)")
            .remedy("copy or export the model again"));
    }
    if let Some((found, remedy)) = recognise(bytes) {
        return Err(Error::input(format!("expected an ONNX file, found {found}")).remedy(remedy));
    }
    let decoded = ModelProto::decode(bytes).map_err(|cause| {
        let what = if bytes[0] == FIRST_BYTE {
            format!(
                "the ONNX file is damaged or truncated ({} bytes)",
                bytes.len()
            )
        } else {
            "not an ONNX file".to_owned()
        };
        Error::input(what)
            .because(cause)
            .remedy("copy or export the model again and compare its sha256 with its card")
    })?;
    if decoded.graph.is_none() {
        return Err(Error::input(format!(
            "no ONNX graph in the file ({} bytes): it is truncated, or not an ONNX file",
            bytes.len()
        ))
        .remedy("copy or export the model again and compare its sha256 with its card"));
    }
    Ok(decoded)
}

/// Recognises common other formats.
fn recognise(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    const EXPORT: &str = "export the network with opset 17 and gripcast's metadata first";
    const NAME: &str = "give the .onnx file itself";
    let starts = |magic: &[u8]| bytes.starts_with(magic);
    if starts(b"version https://git-lfs") {
        Some((
            "a Git LFS pointer",
            "run `git lfs pull` to fetch the file itself",
        ))
    } else if starts(&[0xff, 0xd8, 0xff]) {
        Some(("a JPEG image", NAME))
    } else if starts(b"\x89PNG") {
        Some(("a PNG image", NAME))
    } else if starts(b"PK\x03\x04") {
        Some(("a ZIP archive (PyTorch saves `.pt` like this)", EXPORT))
    } else if starts(&[0x80, 0x02]) || starts(&[0x80, 0x04]) {
        Some(("a Python pickle", EXPORT))
    } else if starts(b"\x89HDF") {
        Some(("an HDF5 file", EXPORT))
    } else if starts(&[0x1f, 0x8b]) {
        Some(("a gzip archive", "unpack it first"))
    } else if bytes
        .iter()
        .all(|b| b.is_ascii_graphic() || b.is_ascii_whitespace())
    {
        Some(("a text file", NAME))
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn error_names_the_found_format() {
        for (bytes, expected) in [
            (&b""[..], "empty (0 bytes)"),
            (b"\xff\xd8\xff\xe0\0\x10JFIF", "a JPEG image"),
            (b"\x89PNG\r\n\x1a\n", "a PNG image"),
            (b"PK\x03\x04\0\0", "a ZIP archive"),
            (
                b"version https://git-lfs.github.com/spec/v1\n",
                "a Git LFS pointer",
            ),
            (b"name = \"model\"\n", "a text file"),
            (b"\x08\x08\x3a\xff", "damaged or truncated"),
            (b"\x08\x08", "no ONNX graph"),
            (b"\xfe\xfe\xfe\xfe", "not an ONNX file"),
        ] {
            let error = decode(bytes).unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
            assert_eq!(error.kind(), ErrorKind::Input);
            assert!(error.remedy_text().is_some(), "{error}");
        }
    }

    #[test]
    fn directory_and_missing_file_have_different_errors() {
        let directory = read(Path::new("/")).unwrap_err();
        assert!(directory.to_string().contains("a directory"), "{directory}");
        let missing = read(Path::new("/no/such/model.onnx")).unwrap_err();
        assert_eq!(missing.kind(), ErrorKind::NotFound);
        assert!(missing.to_string().starts_with("/no/such/model.onnx: "));
    }
}
