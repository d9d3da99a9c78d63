//! Limits, tolerances and the choice of repairs.

use std::fmt;
use std::str::FromStr;

use gripcast_base::error::{Error, Result};

/// What is done about defects of a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Repair {
    /// `none`: the mesh is taken as it is, if contact permits.
    None,
    /// `auto`: repairs what can be repaired, with a warning for each kind. Pieces may touch, overlap
    /// and cross themselves; holes may be small.
    #[default]
    Auto,
    /// `strict`: refuses a mesh that is not closed or that intersects itself.
    Strict,
}

impl Repair {
    /// All choices.
    pub const ALL: [Self; 3] = [Self::None, Self::Auto, Self::Strict];
}

impl fmt::Display for Repair {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "none",
            Self::Auto => "auto",
            Self::Strict => "strict",
        })
    }
}

impl FromStr for Repair {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|r| r.to_string() == text);
        found.ok_or_else(|| {
            Error::usage(format!("unknown repair {text:?}")).remedy("use none, auto or strict")
        })
    }
}

/// Limits, tolerances and repairs of [`prepare`](super::prepare).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrepareOptions {
    /// Distance up to which vertices are merged, m. Default 0.1 µm: below the resolution of scans
    /// and prints, above the rounding of single-precision coordinates.
    pub weld_tolerance_m: f64,
    /// Maximum side of the bounding box, m. Default 1 m.
    pub max_extent_m: f64,
    /// Minimum longest side of the bounding box, m. Default 2 mm.
    pub min_extent_m: f64,
    /// Depth up to which self-intersections are tolerated, m. Default 1 µm: slivers of exported
    /// meshes cause such intersections, without effect.
    pub crossing_tolerance_m: f64,
    /// What is done about defects. Default [`Repair::Auto`].
    pub repair: Repair,
    /// Thickness of the wall that an open surface gets, m. Default: none, it must have an inside.
    pub wall_thickness_m: Option<f64>,
    /// Whether the surface must have an inside, which mass needs. Default true; contact and pictures
    /// do without.
    pub needs_inside: bool,
}

impl Default for PrepareOptions {
    fn default() -> Self {
        Self {
            weld_tolerance_m: 1e-7,
            max_extent_m: 1.0,
            min_extent_m: 2e-3,
            crossing_tolerance_m: 1e-6,
            repair: Repair::default(),
            wall_thickness_m: None,
            needs_inside: true,
        }
    }
}
