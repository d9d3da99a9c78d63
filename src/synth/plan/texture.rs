//! Pictures of the user's as textures.

use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::draft::stored_path;
use crate::error::{Error, ErrorKind, Result};
use crate::files::sha256_hex;
use crate::render::visual::{Bitmap, load_bitmap};

/// Endings of files that are taken for pictures.
const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

/// A picture that may be on an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureTexture {
    /// A PNG or JPEG file: relative to the plan's folder where it lies in it.
    pub path: String,
    /// SHA-256 of the file, 64 hex digits.
    pub sha256: String,
    /// Width of the picture on the object, m.
    pub width_m: f64,
}

impl PictureTexture {
    /// A picture by its file, `width_m` wide on the object.
    ///
    /// # Errors
    /// Those of reading the picture; `Input` for a width that is not above 0.
    pub fn of_file(file: &Path, width_m: f64, plan_folder: &Path) -> Result<Self> {
        if !(width_m > 0.0 && width_m.is_finite()) {
            return Err(Error::new(
                ErrorKind::Input,
                format!("the width of a texture must be above 0, found {width_m} m"),
            )
            .remedy("give the width that the picture has on the object, in metres"));
        }
        load_bitmap(file)?;
        Ok(Self {
            path: stored_path(file, plan_folder)?,
            sha256: hash(file)?,
            width_m,
        })
    }

    /// What it is called: the file's name without its ending.
    pub fn words(&self) -> &str {
        let stem = Path::new(&self.path).file_stem();
        stem.and_then(|stem| stem.to_str()).unwrap_or(&self.path)
    }

    /// The picture. `folder` is that of the plan.
    ///
    /// # Errors
    /// Those of reading it; `Input` where it is not the planned one.
    pub fn load(&self, folder: &Path) -> Result<Bitmap> {
        let file = folder.join(&self.path);
        let found = hash(&file)?;
        if found != self.sha256 {
            return Err(Error::new(
                ErrorKind::Input,
                format!(
                    "the texture changed: expected {}, found {found}",
                    self.sha256
                ),
            )
            .at(file.display())
            .remedy("restore the picture, or make a new plan in another folder"));
        }
        load_bitmap(&file)
    }
}

/// The pictures of a folder, by name; each `width_m` wide on objects.
///
/// # Errors
/// `Input` for a folder without pictures; those of reading them.
pub fn texture_folder(
    folder: &Path,
    width_m: f64,
    plan_folder: &Path,
) -> Result<Vec<PictureTexture>> {
    let cannot = |e| Error::io("cannot read the folder of textures", e).at(folder.display());
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(cannot)? {
        let path = entry.map_err(cannot)?.path();
        let ending = path.extension().and_then(|ending| ending.to_str());
        if ending.is_some_and(|e| ENDINGS.contains(&e.to_lowercase().as_str())) {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(Error::new(ErrorKind::Input, "the folder has no pictures")
            .at(folder.display())
            .remedy("put PNG or JPEG files into it"));
    }
    files.sort();
    let of_file = |file| PictureTexture::of_file(file, width_m, plan_folder);
    files.iter().map(|file| of_file(file)).collect()
}

fn hash(file: &Path) -> Result<String> {
    let bytes =
        fs::read(file).map_err(|e| Error::io("cannot read the texture", e).at(file.display()))?;
    Ok(sha256_hex(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_of_pictures_is_read_and_a_changed_picture_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        for (name, level) in [("b.png", 9), ("a.PNG", 200)] {
            let picture = image::RgbImage::from_pixel(4, 2, image::Rgb([level; 3]));
            picture
                .save_with_format(file(name), image::ImageFormat::Png)
                .unwrap();
        }
        fs::write(file("notes.txt"), "").unwrap();
        let textures = texture_folder(folder.path(), 0.05, folder.path()).unwrap();
        let names: Vec<&str> = textures.iter().map(PictureTexture::words).collect();
        assert_eq!(names, ["a", "b"]);
        assert_eq!(textures[0].load(folder.path()).unwrap().size(), [4, 2]);
        fs::copy(file("b.png"), file("a.PNG")).unwrap();
        let error = textures[0].load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("changed"), "{error}");
        fs::write(file("b.png"), "no picture").unwrap();
        assert!(texture_folder(folder.path(), 0.05, folder.path()).is_err());
        assert!(PictureTexture::of_file(&file("a.PNG"), f64::NAN, folder.path()).is_err());
        let empty = tempfile::tempdir().unwrap();
        let error = texture_folder(empty.path(), 0.05, empty.path()).unwrap_err();
        assert!(error.to_string().contains("no pictures"));
    }
}
