//! Folders of calibration images.

use std::fs;
use std::path::{Path, PathBuf};

use image::GrayImage;
use image::imageops::grayscale;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, is_system_file, read_regular};
use gripcast_imaging::Decoder;

/// Suffixes of images.
const SUFFIXES: [&str; 3] = ["png", "jpg", "jpeg"];

/// Lists the images in a folder, sorted by name.
///
/// # Errors
/// `Io`; `Input` for a folder without images.
pub(super) fn images(folder: &Path) -> Result<Vec<PathBuf>> {
    let cannot = |e| Error::io("cannot read the folder of images", e).at(folder.display());
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(cannot)? {
        let path = entry.map_err(cannot)?.path();
        let suffix = path.extension().unwrap_or_default();
        let is_image = SUFFIXES.iter().any(|s| suffix.eq_ignore_ascii_case(s));
        if is_image && !is_system_file(&file_name(&path)) {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(Error::input("the folder has no .png or .jpg images").at(folder.display()));
    }
    Ok(files)
}

/// Returns the name of a file without its folder.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// Reads an image as grey, at its stored size.
///
/// # Errors
/// `Io`; `Input` for an invalid image.
pub(super) fn read_grey(decoder: &mut Decoder, path: &Path) -> Result<GrayImage> {
    let bytes =
        read_regular(path, FileKind::Image).map_err(|e| Error::io("cannot read the image", e))?;
    Ok(grayscale(&decoder.stored_image(&bytes)?))
}
