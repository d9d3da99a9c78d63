//! Reads ONNX files.

use std::path::Path;

use prost::Message as _;
use tract_onnx::pb::ModelProto;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, file_type, read_regular};

/// First byte of ONNX files: field 1, varint (`ir_version`).
const FIRST_BYTE: u8 = 0x08;
const COPY: &str = "copy or export the model again and compare its sha256 with its card";
/// Call of PyTorch that writes a file that gripcast reads.
pub const PYTORCH_EXPORT: &str = "`torch.onnx.export(model.eval().float(), args, \"model.onnx\", \
                                  opset_version=17, dynamo=False, input_names=[…], \
                                  output_names=[\"p_stable\"])`";

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
        return Err(Error::input("the model file is empty (0 bytes)").remedy(COPY));
    }
    if let Some(found) = file_type(bytes) {
        return Err(
            Error::input(format!("expected an ONNX file, found {found}")).remedy(format!(
                "give the .onnx file itself; from PyTorch, export the network with \
                 {PYTORCH_EXPORT}, then `gripcast predict stamp`"
            )),
        );
    }
    // Every ONNX file begins with its `ir_version`.
    let starts_as_onnx = bytes[0] == FIRST_BYTE;
    let decoded = ModelProto::decode(bytes).ok();
    let decoded = decoded.filter(|model| starts_as_onnx || model.graph.is_some());
    match decoded {
        Some(model) if model.graph.is_some() => Ok(model),
        _ if starts_as_onnx => Err(Error::input(format!(
            "the ONNX file is damaged or truncated ({} bytes)",
            bytes.len()
        ))
        .remedy(COPY)),
        _ => Err(Error::input("not an ONNX file, and of no type that gripcast knows").remedy(COPY)),
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
            (b"\x08\x08", "damaged or truncated"),
            (b"<!DOCTYPE html>", "an HTML page"),
            (b"\x80\x03}q\0.", "a Python pickle"),
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
