//! User images as textures.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::TEXTURES;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, ContentKey, FileKind, FileName, Label, Root, sha256_hex};
use gripcast_visual::{Bitmap, read_bitmap};

/// Suffixes of image files.
const SUFFIXES: [&str; 3] = [".png", ".jpg", ".jpeg"];

/// A texture that an object may have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageTexture {
    /// A PNG or JPEG file in the plan's folder `textures`.
    pub file: FileName,
    /// Name of the original file without its suffix.
    #[serde(rename = "words")]
    pub name: Label,
    /// SHA-256 of the file, 64 hex digits.
    pub sha256: String,
    /// Width of the image on the object, m.
    pub width_m: f64,
}

/// A texture before it is stored in a plan's folder.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureDraft {
    /// Entry in the plan.
    pub planned: ImageTexture,
    source: BeneathPath,
}

impl ImageTexture {
    /// Loads the image; `root` is the plan's folder.
    ///
    /// # Errors
    /// Errors of reading it; `Input` if it is not the planned one.
    pub fn load(&self, root: &Root) -> Result<Bitmap> {
        let place = root.top().join(TEXTURES).join(&self.file);
        let bytes = read(&place)?;
        self.check(&bytes)
            .and_then(|()| read_bitmap(&bytes))
            .map_err(|e| e.at(place.display()))
    }

    fn check(&self, bytes: &[u8]) -> Result<()> {
        let found = sha256_hex(bytes);
        if found == self.sha256 {
            return Ok(());
        }
        Err(Error::input(format!(
            "the texture changed: expected {}, found {found}",
            self.sha256
        ))
        .remedy("restore the image, or create the plan again in another folder"))
    }
}

impl TextureDraft {
    /// Reads an image file that is `width_m` wide on the object.
    ///
    /// # Errors
    /// Errors of reading the image; `Input` for a width that is not above 0.
    pub fn from_file(source: BeneathPath, width_m: f64) -> Result<Self> {
        if !(width_m > 0.0 && width_m.is_finite()) {
            return Err(Error::input(format!(
                "the width of a texture must be above 0, found {width_m} m"
            ))
            .remedy("give the width of the image on the object in metres"));
        }
        let bytes = read(&source)?;
        read_bitmap(&bytes).map_err(|e| e.at(source.display()))?;
        let suffix = if bytes.starts_with(b"\x89PNG") {
            ".png"
        } else {
            ".jpg"
        };
        let file_name = source.name();
        let stem = Path::new(&file_name).file_stem().unwrap_or_default();
        Ok(Self {
            planned: ImageTexture {
                file: ContentKey::from_contents(&bytes).with_suffix(suffix),
                name: Label::nearest(&stem.to_string_lossy()),
                sha256: sha256_hex(&bytes),
                width_m,
            },
            source,
        })
    }

    /// Reads the bytes of the image.
    ///
    /// # Errors
    /// Errors of reading it; `Input` if it changed since it was first read.
    pub(super) fn read(&self) -> Result<Vec<u8>> {
        let bytes = read(&self.source)?;
        self.planned
            .check(&bytes)
            .map_err(|e| e.at(self.source.display()))?;
        Ok(bytes)
    }
}

/// Loads the images of a folder, sorted by name, each `width_m` wide on objects.
///
/// # Errors
/// `Input` for a folder without images; errors of reading them.
pub fn load_textures(folder: &Path, width_m: f64) -> Result<Vec<TextureDraft>> {
    let mut files = Root::new(folder)
        .top()
        .entries()
        .map_err(|e| Error::io("cannot read the folder with textures", e).at(folder.display()))?;
    files.retain(|file| {
        let name = file.name().to_lowercase();
        SUFFIXES.iter().any(|suffix| name.ends_with(suffix))
    });
    if files.is_empty() {
        return Err(Error::input("the folder has no images")
            .at(folder.display())
            .remedy("put PNG or JPEG files into it"));
    }
    let files = files.into_iter();
    files
        .map(|file| TextureDraft::from_file(file, width_m))
        .collect()
}

fn read(place: &BeneathPath) -> Result<Vec<u8>> {
    place.read(FileKind::Image).map_err(|e| {
        Error::io("cannot read the texture", e)
            .at(place.display())
            .remedy("check the path and its permissions")
    })
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;

    use super::*;

    #[test]
    fn folder_of_images_loads_and_changes_are_detected() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        for (name, level) in [("b.png", 9), ("a.PNG", 200)] {
            let image = image::RgbImage::from_pixel(4, 2, image::Rgb([level; 3]));
            image
                .save_with_format(file(name), image::ImageFormat::Png)
                .unwrap();
        }
        fs::write(file("notes.txt"), "").unwrap();
        let textures = load_textures(folder.path(), 0.05).unwrap();
        let names: Vec<&str> = textures.iter().map(|t| &*t.planned.name).collect();
        assert_eq!(names, ["a", "b"]);
        let plan = tempfile::tempdir().unwrap();
        let planned = &textures[0].planned;
        let stored = plan.path().join(TEXTURES).join(planned.file.as_str());
        fs::create_dir(plan.path().join(TEXTURES)).unwrap();
        fs::write(&stored, textures[0].read().unwrap()).unwrap();
        let root = Root::new(plan.path());
        assert_eq!(planned.load(&root).unwrap().size(), [4, 2]);
        fs::copy(file("b.png"), &stored).unwrap();
        let error = planned.load(&root).unwrap_err().to_string();
        assert!(error.contains("changed"), "{error}");
        fs::copy(file("b.png"), file("a.PNG")).unwrap();
        assert!(textures[0].read().is_err());
        fs::write(file("b.png"), "no image").unwrap();
        assert!(load_textures(folder.path(), 0.05).is_err());
        let place = Root::new(folder.path()).top().join("a.PNG");
        assert!(TextureDraft::from_file(place, f64::NAN).is_err());
        let empty = tempfile::tempdir().unwrap();
        let error = load_textures(empty.path(), 0.05).unwrap_err();
        assert!(error.to_string().contains("no images"));
    }

    #[test]
    fn image_outside_of_the_folder_is_not_read() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::create_dir_all(at("plan/textures")).unwrap();
        image::RgbImage::new(4, 2).save(at("secret.png")).unwrap();
        std::os::unix::fs::symlink("../../secret.png", at("plan/textures/a.png")).unwrap();
        let error = load_textures(&at("plan/textures"), 0.05).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        let planned = ImageTexture {
            file: FileName::parse("a.png").unwrap(),
            name: Label::default(),
            sha256: sha256_hex(fs::read(at("secret.png")).unwrap()),
            width_m: 0.1,
        };
        let error = planned.load(&Root::new(at("plan"))).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
    }
}
