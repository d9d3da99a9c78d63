//! Calibration folder: `presses.json`, or images only.
//!
//! ```json
//! {"no_contact": "no_contact.png", "ball_diameter_m": 0.0047, "m_per_px": 5.1e-5,
//!  "presses": [{"file": "press_01.png", "center_px": [76.0, 182.0], "radius_px": 38.0}]}
//! ```
//! `ball_diameter_m` and `m_per_px` may be null, `center_px` and `radius_px` may be missing: the
//! contact is then detected in the image. Other keys are ignored.

use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::Path;

use image::RgbImage;
use serde::Deserialize;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root, sha256_hex};
use gripcast_imaging::Decoder;

/// Name of the press list.
const LIST: &str = "presses.json";
/// File stems of the no-contact image in a folder without a list.
const NO_CONTACT: [&str; 6] = [
    "no_contact",
    "nocontact",
    "no-contact",
    "background",
    "bg",
    "reference",
];
/// Suffixes of image files.
const SUFFIXES: [&str; 3] = ["png", "jpg", "jpeg"];

/// List of the presses of a folder.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct PressList {
    /// File of the no-contact image.
    pub(super) no_contact: String,
    /// Ball diameter, m.
    #[serde(default)]
    pub(super) ball_diameter_m: Option<f64>,
    /// Pixel size, m.
    #[serde(default)]
    pub(super) m_per_px: Option<f64>,
    /// The presses.
    pub(super) presses: Vec<PressEntry>,
}

/// An entry of the list.
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct PressEntry {
    /// Image file.
    pub(super) file: String,
    /// Column and row of the contact centre, px.
    #[serde(default)]
    center_px: Option<Vec<Option<f64>>>,
    /// Contact radius, px.
    #[serde(default)]
    radius_px: Option<f64>,
}

/// Label of a press: contact centre and radius, px.
pub(super) type Label = ([f64; 2], f64);

impl PressEntry {
    /// Returns the label, `None` if there is none, or an error text if it is invalid.
    pub(super) fn label(&self) -> Result<Option<Label>, String> {
        match (self.center_px.as_deref(), self.radius_px) {
            (None, None) => Ok(None),
            (Some([Some(x), Some(y)]), Some(r)) if r > 0.0 && (x + y + r).is_finite() => {
                Ok(Some(([*x, *y], r)))
            }
            (centre, radius) => Err(format!(
                "invalid label: expected two numbers `center_px` and a positive `radius_px`, found \
                 {centre:?} and {radius:?}"
            )),
        }
    }
}

impl PressList {
    /// Reads the list of a folder, or creates one from its images.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let path = Root::new(folder).top().join(LIST);
        match path.read(FileKind::List) {
            Ok(bytes) => serde_json::from_slice(&bytes).map_err(|cause| {
                Error::input("cannot parse the list of presses")
                    .because(cause)
                    .at(path.display())
                    .remedy(
                        "it must have `no_contact` and `presses`, each with `file`, `center_px` and \
                         `radius_px`; delete the list to detect the contacts",
                    )
            }),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Self::from_images(folder),
            Err(e) => Err(Error::io("cannot read the list of presses", e)
                .at(path.display())
                .remedy("give the folder with presses.json or with images of presses")),
        }
    }

    /// Returns the positions of named presses in the list, without repetition: by file name, file
    /// name without suffix, number from 1, or range of numbers.
    ///
    /// # Errors
    /// `Usage` if a name is unknown.
    pub(super) fn positions(&self, names: &[String]) -> Result<Vec<usize>> {
        let mut positions = Vec::new();
        for name in names {
            for position in self.position(name).ok_or_else(|| self.unknown(name))? {
                if !positions.contains(&position) {
                    positions.push(position);
                }
            }
        }
        Ok(positions)
    }

    fn position(&self, name: &str) -> Option<RangeInclusive<usize>> {
        let of = |is: &dyn Fn(&str) -> bool| {
            let found = self.presses.iter().position(|press| is(&press.file));
            found.map(|position| position..=position)
        };
        let stem = |file: &str| file.rsplit_once('.').map_or(file, |(stem, _)| stem) == name;
        let number = |text: &str| {
            let number: usize = text.trim().parse().ok()?;
            (1..=self.presses.len())
                .contains(&number)
                .then(|| number - 1)
        };
        let range = || {
            let (first, last) = name.split_once('-')?;
            let (first, last) = (number(first)?, number(last)?);
            (first <= last).then_some(first..=last)
        };
        of(&|file| file == name)
            .or_else(|| of(&stem))
            .or_else(|| number(name).map(|position| position..=position))
            .or_else(range)
    }

    fn unknown(&self, name: &str) -> Error {
        let ends = match (self.presses.first(), self.presses.last()) {
            (Some(first), Some(last)) => format!(", {} to {}", first.file, last.file),
            _ => String::new(),
        };
        Error::usage(format!(
            "`{name}` names none of the {} presses{ends}",
            self.presses.len()
        ))
        .remedy("name a press by its file, its number in the list from 1, or a range as 1-14")
    }

    fn from_images(folder: &Path) -> Result<Self> {
        let mut names = image_names(folder)?;
        let stem = |name: &str| {
            let stem = Path::new(name).file_stem().unwrap_or_default();
            stem.to_string_lossy().to_ascii_lowercase()
        };
        let Some(index) = names
            .iter()
            .position(|name| NO_CONTACT.contains(&stem(name).as_str()))
        else {
            return Err(Error::not_found(format!(
                "neither {LIST} nor a no-contact image found; {} other images",
                names.len()
            ))
            .at(folder.display())
            .remedy("name the image of the untouched gel no_contact.png"));
        };
        let no_contact = names.remove(index);
        let presses = names
            .into_iter()
            .map(|file| PressEntry {
                file,
                ..PressEntry::default()
            })
            .collect();
        Ok(Self {
            no_contact,
            ball_diameter_m: None,
            m_per_px: None,
            presses,
        })
    }
}

/// Returns the names of the images in a folder, sorted, numbers by their value.
fn image_names(folder: &Path) -> Result<Vec<String>> {
    let refused = |e| {
        Error::io("cannot read the folder of presses", e)
            .at(folder.display())
            .remedy("give a folder with presses.json or with images of presses")
    };
    let mut names = Vec::new();
    for entry in Root::new(folder).top().entries().map_err(refused)? {
        let name = entry.name();
        let suffix = name.rsplit_once('.').map_or("", |(_, suffix)| suffix);
        if SUFFIXES.contains(&suffix.to_ascii_lowercase().as_str()) {
            names.push(name);
        }
    }
    names.sort_by_cached_key(|name| by_number(name));
    Ok(names)
}

/// Sort key: each run of digits has 20 digits.
fn by_number(name: &str) -> String {
    let mut key = String::new();
    let mut rest = name;
    while let Some(start) = rest.find(|c: char| c.is_ascii_digit()) {
        let (text, digits) = rest.split_at(start);
        let end = digits.find(|c: char| !c.is_ascii_digit());
        let (digits, after) = digits.split_at(end.unwrap_or(digits.len()));
        let _ = write!(key, "{text}{:0>20}", digits.trim_start_matches('0'));
        rest = after;
    }
    key + rest
}

/// Reads a PNG or JPEG image of a folder; returns it with the SHA-256 of the file.
pub(super) fn read_image(folder: &Path, file: &str) -> Result<(RgbImage, String)> {
    let path = folder.join(file);
    let bytes = Root::new(folder)
        .resolve(file)
        .and_then(|path| path.read(FileKind::Image))
        .map_err(|e| Error::io("cannot read the image", e).at(path.display()))?;
    let decoded = Decoder::new()?.stored_image(&bytes);
    let image = decoded.map_err(|e| e.at(path.display()))?;
    Ok((image, sha256_hex(&bytes)))
}
