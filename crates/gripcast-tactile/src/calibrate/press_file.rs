//! The folder of a calibration: `presses.json`, or images alone.
//!
//! ```json
//! {"no_contact": "no_contact.png", "ball_diameter_m": 0.0047, "m_per_px": 5.1e-5,
//!  "presses": [{"file": "press_01.png", "center_px": [76.0, 182.0], "radius_px": 38.0}]}
//! ```
//! `ball_diameter_m` and `m_per_px` may be null, `center_px` and `radius_px` may be missing: the
//! contact is then found in the image. Other keys are not read.

use std::path::Path;

use image::RgbImage;
use serde::Deserialize;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root};
use gripcast_imaging::jpeg::JpegScale;
use gripcast_imaging::{JpegDecoder, decode_png_rgb};

/// Name of the list.
const LIST: &str = "presses.json";
/// Names under which the image without contact is looked for where there is no list.
const NO_CONTACT: [&str; 6] = [
    "no_contact",
    "nocontact",
    "no-contact",
    "background",
    "bg",
    "reference",
];
/// Suffixes of images.
const SUFFIXES: [&str; 3] = ["png", "jpg", "jpeg"];

/// A folder's list of presses.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct PressList {
    /// Image of the untouched gel.
    pub(super) no_contact: String,
    /// Diameter of the ball, m.
    #[serde(default)]
    pub(super) ball_diameter_m: Option<f64>,
    /// Size of a pixel, m.
    #[serde(default)]
    pub(super) m_per_px: Option<f64>,
    /// The presses.
    pub(super) presses: Vec<PressEntry>,
}

/// One press of the list.
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct PressEntry {
    /// Image.
    pub(super) file: String,
    /// Column and row of the contact's centre, pixels.
    #[serde(default)]
    center_px: Option<Vec<Option<f64>>>,
    /// Radius of the contact, pixels.
    #[serde(default)]
    radius_px: Option<f64>,
}

/// Label of a press: centre and radius, pixels.
pub(super) type Label = ([f64; 2], f64);

impl PressEntry {
    /// The label; `None` where there is none, a reason where it is wrong.
    pub(super) fn label(&self) -> Result<Option<Label>, String> {
        match (self.center_px.as_deref(), self.radius_px) {
            (None, None) => Ok(None),
            (Some([Some(x), Some(y)]), Some(r)) if r > 0.0 && (x + y + r).is_finite() => {
                Ok(Some(([*x, *y], r)))
            }
            (centre, radius) => Err(format!(
                "its label must be two numbers `center_px` and a positive `radius_px`, found \
                 {centre:?} and {radius:?}"
            )),
        }
    }
}

impl PressList {
    /// Reads the list of a folder, or makes one of the images in it.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let path = Root::new(folder).top().join(LIST);
        match path.read(FileKind::List) {
            Ok(bytes) => serde_json::from_slice(&bytes).map_err(|cause| {
                Error::input("the list of presses cannot be read")
                    .because(cause)
                    .at(path.display())
                    .remedy(
                        "it needs `no_contact` and `presses`, each with `file`, `center_px` and \
                         `radius_px`; delete the list to have the contacts found",
                    )
            }),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Self::of_images(folder),
            Err(e) => Err(Error::io("cannot read the list of presses", e).at(path.display())),
        }
    }

    fn of_images(folder: &Path) -> Result<Self> {
        let mut names = image_names(folder)?;
        let stem = |name: &str| {
            let stem = Path::new(name).file_stem().unwrap_or_default();
            stem.to_string_lossy().to_ascii_lowercase()
        };
        let Some(place) = names
            .iter()
            .position(|name| NO_CONTACT.contains(&stem(name).as_str()))
        else {
            return Err(Error::not_found(format!(
                "neither {LIST} nor an image without contact is there; {} other images",
                names.len()
            ))
            .at(folder.display())
            .remedy("name the image of the untouched gel no_contact.png"));
        };
        let no_contact = names.remove(place);
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

/// Names of the images in a folder, sorted.
fn image_names(folder: &Path) -> Result<Vec<String>> {
    let refused = |e| {
        Error::io("cannot read the folder of presses", e)
            .at(folder.display())
            .remedy("name a folder with presses.json or with images of presses")
    };
    let mut names = Vec::new();
    for entry in Root::new(folder).top().entries().map_err(refused)? {
        let name = entry.name();
        let suffix = name.rsplit_once('.').map_or("", |(_, suffix)| suffix);
        if SUFFIXES.contains(&suffix.to_ascii_lowercase().as_str()) {
            names.push(name);
        }
    }
    Ok(names)
}

/// Reads a PNG or JPEG image of a folder.
pub(super) fn read_image(folder: &Path, file: &str) -> Result<RgbImage> {
    let path = folder.join(file);
    let bytes = Root::new(folder)
        .resolve(file)
        .and_then(|place| place.read(FileKind::Image))
        .map_err(|e| Error::io("cannot read the image", e).at(path.display()))?;
    decode(&bytes).map_err(|e| e.at(path.display()))
}

fn decode(bytes: &[u8]) -> Result<RgbImage> {
    if !bytes.starts_with(&[0xff, 0xd8]) {
        return decode_png_rgb(bytes);
    }
    let mut decoder = JpegDecoder::new()?;
    let pixels = decoder.decode(bytes, JpegScale::Whole)?;
    let (width, height) = (pixels.width, pixels.height);
    RgbImage::from_raw(width, height, pixels.rgb.to_vec())
        .ok_or_else(|| Error::input("the JPEG has an impossible size"))
}
