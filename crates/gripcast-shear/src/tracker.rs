//! The tracker of one gel.

use image::RgbImage;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use gripcast_base::error::{Error, Result};

use crate::darkness::Brightness;
use crate::lattice::Lattice;
use crate::markers::MarkerTracker;
use crate::texture::TextureTracker;
use crate::{MarkerField, MarkerPattern, ShearProblem};

/// What the shear was measured on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShearSource {
    /// Gel markers.
    Markers,
    /// The texture of the contact.
    Texture,
}

impl ShearSource {
    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Markers => "markers",
            Self::Texture => "texture",
        }
    }
}

/// Scale of a cropped GelSight Mini image, for limits of what is plausible where the scale is not
/// known, m/px.
pub const USUAL_M_PER_PX: f64 = 3.0e-5;

/// The shear of one gel in one image. Axes are those of the image: x right, y down.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShearSummary {
    /// What the shear was measured on.
    pub source: ShearSource,
    /// Confidence, 0 to 1.
    pub confidence: f64,
    /// Fraction of the gel markers, or of the contact's texture, that is tracked, 0 to 1.
    pub tracked_fraction: f64,
    /// Mean displacement of the skin in contact, of all of it without contact, mm.
    pub mean_displacement_mm: [f64; 2],
    /// Maximum displacement, mm.
    pub max_displacement_mm: f64,
    /// Mean divergence of the displacement, ∂u/∂x + ∂v/∂y; above 0 where the skin is stretched.
    pub divergence: f64,
    /// Mean curl of the displacement, ∂v/∂x − ∂u/∂y: twice the rotation in radians, from x
    /// towards y.
    pub curl: f64,
    /// Fraction of the image in contact, 0 to 1.
    pub contact_fraction: f64,
    /// Fraction of the contact that moves against the gel's rigid motion, 0 to 1; `None` without
    /// contact, with too few gel markers in it, and for texture.
    pub slip_ratio: Option<f64>,
}

impl ShearSummary {
    /// Whether all numbers are finite; JSON has no others.
    pub fn is_finite(&self) -> bool {
        let [x, y] = self.mean_displacement_mm;
        let numbers = [
            self.confidence,
            self.tracked_fraction,
            x,
            y,
            self.max_displacement_mm,
            self.divergence,
            self.curl,
            self.contact_fraction,
            self.slip_ratio.unwrap_or(0.0),
        ];
        numbers.iter().all(|number| number.is_finite())
    }
}

/// The number with six decimal places; further ones of an `f32` are noise.
pub(crate) fn decimal(number: f32) -> f64 {
    (f64::from(number) * 1e6).round() / 1e6
}

/// What the tracker says of one image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShearFrame {
    /// The shear; `None` where nothing can be said.
    pub summary: Option<ShearSummary>,
    /// The gel markers; `None` for a gel without.
    pub field: Option<MarkerField>,
    /// Problems.
    pub problems: Vec<ShearProblem>,
}

/// What is known of the gel markers before the first image.
#[derive(Clone, Copy, Debug)]
pub enum ExpectedMarkers<'a> {
    /// Nothing: the image decides.
    Unknown,
    /// The sensor profile has no gel markers.
    None,
    /// The sensor profile has this pattern.
    Pattern(&'a MarkerPattern),
}

impl ExpectedMarkers<'_> {
    /// Problems of an initial image, by the pitch of its gel markers, px.
    fn problem(self, found_px: Option<f32>, m_per_px: f64) -> Option<ShearProblem> {
        match (self, found_px) {
            (Self::Pattern(_), None) => Some(ShearProblem::NoMarkers),
            (Self::None, Some(_)) => Some(ShearProblem::UnexpectedMarkers),
            (Self::Pattern(pattern), Some(found_px)) => {
                let [x, y] = pattern.pitch_m;
                let expected_px = (x.min(y) / m_per_px) as f32;
                let is_other = (found_px / expected_px - 1.0).abs() > MAX_PITCH_DIFFERENCE;
                is_other.then_some(ShearProblem::OtherPitch {
                    found_px,
                    expected_px,
                })
            }
            (Self::Unknown, _) | (Self::None, None) => None,
        }
    }
}

/// Measures the shear of one gel, image by image.
#[derive(Clone, Debug)]
pub struct ShearTracker {
    size: [u32; 2],
    method: Method,
    /// Problems of the initial image, which all frames have.
    problems: Vec<ShearProblem>,
}

#[derive(Clone, Debug)]
enum Method {
    Markers(Box<MarkerTracker>),
    Texture(Box<TextureTracker>),
}

/// Minimum width and height of an image, px.
const MIN_SIZE: [u32; 2] = [80, 60];
/// Maximum difference of the pitch from that of the sensor profile, fraction.
const MAX_PITCH_DIFFERENCE: f32 = 0.12;

impl ShearTracker {
    /// Starts from the image of the untouched gel; `m_per_px` is the scale of the image. Whether
    /// gel markers or texture are followed is decided by the image; a difference from what is
    /// `expected` is a problem of every frame.
    ///
    /// # Errors
    /// `Input` for a scale that is not a positive number, or an image below 80×60 pixels.
    pub fn new(initial: &RgbImage, m_per_px: f64, expected: ExpectedMarkers<'_>) -> Result<Self> {
        if !(m_per_px.is_finite() && m_per_px > 0.0) {
            let what = format!("expected a positive scale in m/px, found {m_per_px}");
            return Err(
                Error::input(what).remedy("0.00003 is that of a cropped GelSight Mini image")
            );
        }
        let size = [initial.width(), initial.height()];
        if size[0] < MIN_SIZE[0] || size[1] < MIN_SIZE[1] {
            let [width, height] = MIN_SIZE;
            let what = format!(
                "expected a tactile image of at least {width}×{height} pixels, found {}×{}",
                size[0], size[1]
            );
            return Err(Error::input(what));
        }
        let lattice = Lattice::find(&Brightness::new(initial));
        let pitch = lattice.as_ref().map(Lattice::pitch);
        let mut problems = Vec::from_iter(expected.problem(pitch, m_per_px));
        if lattice.as_ref().is_some_and(|lattice| lattice.is_deformed) {
            problems.push(ShearProblem::DeformedInitial);
        }
        let method = match lattice {
            Some(lattice) => {
                Method::Markers(Box::new(MarkerTracker::new(initial, lattice, m_per_px)))
            }
            None => Method::Texture(Box::new(TextureTracker::new(initial, m_per_px))),
        };
        Ok(Self {
            size,
            method,
            problems,
        })
    }

    /// Pitch of the gel markers in the initial image, px; `None` for a gel without.
    pub fn pitch_px(&self) -> Option<f32> {
        match &self.method {
            Method::Markers(markers) => Some(markers.pitch_px()),
            Method::Texture(_) => None,
        }
    }

    /// What the shear is measured on.
    pub fn source(&self) -> ShearSource {
        match self.method {
            Method::Markers(_) => ShearSource::Markers,
            Method::Texture(_) => ShearSource::Texture,
        }
    }

    /// Measures one image against the initial one.
    pub fn update(&mut self, image: &RgbImage) -> ShearFrame {
        let found = [image.width(), image.height()];
        let mut problems = self.problems.clone();
        if found != self.size {
            problems.push(ShearProblem::Resized {
                found,
                expected: self.size,
            });
            return ShearFrame {
                problems,
                ..ShearFrame::default()
            };
        }
        let mut frame = match &mut self.method {
            Method::Markers(markers) => markers.update(image),
            Method::Texture(texture) => texture.update(image),
        };
        problems.append(&mut frame.problems);
        ShearFrame { problems, ..frame }
    }

    /// Measures frames from before the initial one, from the last to the first; `None` for one that
    /// is missing. The results are in the order of the frames and have no slip ratio, because which
    /// motion was first matters for slip.
    pub fn backwards<'a>(
        mut self,
        frames: impl DoubleEndedIterator<Item = Option<&'a RgbImage>>,
    ) -> Vec<Option<ShearFrame>> {
        let track = |image: Option<&RgbImage>| {
            let mut shear = self.update(image?);
            if let Some(summary) = &mut shear.summary {
                summary.slip_ratio = None;
            }
            Some(shear)
        };
        let mut tracked: Vec<_> = frames.rev().map(track).collect();
        tracked.reverse();
        tracked
    }
}
