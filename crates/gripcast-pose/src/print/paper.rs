//! Paper sizes.

use std::fmt;
use std::str::FromStr;

use gripcast_base::error::{Error, Result, unknown_name};

/// A paper size.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Paper {
    /// 210 × 297 mm.
    #[default]
    A4,
    /// 297 × 420 mm.
    A3,
    /// 8.5 × 11 in.
    Letter,
}

impl Paper {
    /// All sizes.
    pub const ALL: [Self; 3] = [Self::A4, Self::A3, Self::Letter];

    /// Name of the size.
    pub fn name(self) -> &'static str {
        match self {
            Self::A4 => "A4",
            Self::A3 => "A3",
            Self::Letter => "Letter",
        }
    }

    /// Width and height in portrait, mm.
    pub fn portrait_mm(self) -> [f64; 2] {
        match self {
            Self::A4 => [210.0, 297.0],
            Self::A3 => [297.0, 420.0],
            Self::Letter => [215.9, 279.4],
        }
    }

    /// Width and height in landscape, mm.
    pub fn landscape_mm(self) -> [f64; 2] {
        let [width, height] = self.portrait_mm();
        [height, width]
    }
}

impl fmt::Display for Paper {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Paper {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let mut papers = Self::ALL.into_iter();
        papers
            .find(|paper| paper.name().eq_ignore_ascii_case(text))
            .ok_or_else(|| unknown_name("paper", text, &Self::ALL.map(Self::name)))
    }
}
