//! Named crop profiles.
//!
//! Public code crops GelSight Mini images in three incompatible ways; data and models record the
//! profile. A profile never changes; a different rule gets a new name.

use gripcast_base::error::{Error, Result, nearest_name};

/// A rectangle of whole pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CropWindow {
    /// First column.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// Width.
    pub width: u32,
    /// Height.
    pub height: u32,
}

/// A rule for the crop window of an image of any size.
///
/// | name | 3280×2464: columns, rows | 640×480: columns, rows |
/// | --- | --- | --- |
/// | `full-v1` | 0..3280, 0..2464 | 0..640, 0..480 |
/// | `gelsight-2017-full-v1` | 0..3280, 0..2464 | 0..640, 0..480 |
/// | `gsmini-seventh-v1` | 468..2812, 354..2112 | 91..549, 70..412 |
/// | `gsmini-fifteen-v1` | 492..2788, 369..2095 | 96..544, 72..408 |
/// | `gsmini-gs-sdk-v1` | 468..2812, 354..2112 | 91..549, 68..412 |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CropProfile {
    name: &'static str,
    rule: Rule,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rule {
    Full,
    Seventh,
    Fifteen,
    GsSdk,
}

impl CropProfile {
    /// The whole image.
    pub const FULL: Self = Self {
        name: "full-v1",
        rule: Rule::Full,
    };

    /// The whole image of the GelSight of 2017 with markers (*The Feeling of Success*).
    pub const GELSIGHT_2017_FULL: Self = Self {
        name: "gelsight-2017-full-v1",
        rule: Rule::Full,
    };

    /// GelSight's `gsrobotics`, 2022 to 2024 (`gsdevice.py`, `resize_crop_mini`): 1/7 off each
    /// side, rounded down, and two more rows off the top.
    pub const GSMINI_SEVENTH: Self = Self {
        name: "gsmini-seventh-v1",
        rule: Rule::Seventh,
    };

    /// GelSight's `gsrobotics` since 2025 (`image_processing.py`, `crop_and_resize`): 15 % off
    /// each side, rounded down.
    pub const GSMINI_FIFTEEN: Self = Self {
        name: "gsmini-fifteen-v1",
        rule: Rule::Fifteen,
    };

    /// `gs_sdk` (`gs_device.py`, `resize_crop`) for 320×240: 1/7 off each side, then the excess
    /// over 4:3 off the top or the left.
    pub const GSMINI_GS_SDK: Self = Self {
        name: "gsmini-gs-sdk-v1",
        rule: Rule::GsSdk,
    };

    /// All profiles.
    pub const ALL: [Self; 5] = [
        Self::FULL,
        Self::GELSIGHT_2017_FULL,
        Self::GSMINI_SEVENTH,
        Self::GSMINI_FIFTEEN,
        Self::GSMINI_GS_SDK,
    ];

    /// The profile with a name.
    ///
    /// # Errors
    /// `Config` for an unknown name.
    pub fn by_name(name: &str) -> Result<Self> {
        if let Some(profile) = Self::ALL.into_iter().find(|profile| profile.name == name) {
            return Ok(profile);
        }
        let known = Self::ALL.map(|profile| profile.name);
        let hint = nearest_name(name, known)
            .map_or(String::new(), |known| format!("did you mean `{known}`? "));
        Err(Error::config(format!("unknown crop profile `{name}`"))
            .remedy(format!("{hint}use one of {}", known.join(", "))))
    }

    /// Name of the profile.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// The window in an image of `width` × `height` pixels; `None` if it is empty.
    #[must_use]
    pub fn window(&self, width: u32, height: u32) -> Option<CropWindow> {
        let (left, top, right, bottom) = match self.rule {
            Rule::Full => (0, 0, 0, 0),
            Rule::Seventh => (width / 7, height / 7 + 2, width / 7, height / 7),
            Rule::Fifteen => {
                let (x, y) = (fifteen_percent(width), fifteen_percent(height));
                (x, y, x, y)
            }
            Rule::GsSdk => {
                let (x, y) = (width / 7, height / 7);
                let (inner_width, inner_height) = (width - 2 * x, height - 2 * y);
                // The excess over 4:3, rounded down: h − 3w/4, or w − 4h/3.
                let extra_top =
                    (4 * u64::from(inner_height)).saturating_sub(3 * u64::from(inner_width)) / 4;
                let extra_left =
                    (3 * u64::from(inner_width)).saturating_sub(4 * u64::from(inner_height)) / 3;
                (x + extra_left as u32, y + extra_top as u32, x, y)
            }
        };
        let window = CropWindow {
            left,
            top,
            width: width.checked_sub(left)?.checked_sub(right)?,
            height: height.checked_sub(top)?.checked_sub(bottom)?,
        };
        (window.width > 0 && window.height > 0).then_some(window)
    }
}

impl std::fmt::Display for CropProfile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name)
    }
}

/// `int(side * 0.15)` in double precision, as in the source.
fn fifteen_percent(side: u32) -> u32 {
    (f64::from(side) * 0.15) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    fn ranges(profile: CropProfile, width: u32, height: u32) -> (u32, u32, u32, u32) {
        let w = profile.window(width, height).unwrap();
        (w.left, w.left + w.width, w.top, w.top + w.height)
    }

    #[test]
    fn windows_are_those_of_the_sources() {
        for (profile, mini, vga) in [
            (CropProfile::FULL, (0, 3280, 0, 2464), (0, 640, 0, 480)),
            (
                CropProfile::GELSIGHT_2017_FULL,
                (0, 3280, 0, 2464),
                (0, 640, 0, 480),
            ),
            (
                CropProfile::GSMINI_SEVENTH,
                (468, 2812, 354, 2112),
                (91, 549, 70, 412),
            ),
            (
                CropProfile::GSMINI_FIFTEEN,
                (492, 2788, 369, 2095),
                (96, 544, 72, 408),
            ),
            (
                CropProfile::GSMINI_GS_SDK,
                (468, 2812, 354, 2112),
                (91, 549, 68, 412),
            ),
        ] {
            assert_eq!(ranges(profile, 3280, 2464), mini, "{profile}");
            assert_eq!(ranges(profile, 640, 480), vga, "{profile}");
        }
    }

    #[test]
    fn gs_sdk_crops_to_4_3() {
        assert_eq!(
            ranges(CropProfile::GSMINI_GS_SDK, 1400, 700),
            (200 + 333, 1200, 100, 600)
        );
        assert_eq!(
            ranges(CropProfile::GSMINI_GS_SDK, 700, 700),
            (100, 600, 100 + 125, 600)
        );
    }

    #[test]
    fn small_images_have_no_window() {
        for profile in CropProfile::ALL {
            for width in 0..20 {
                for height in 0..20 {
                    if let Some(w) = profile.window(width, height) {
                        assert!(w.left + w.width <= width && w.top + w.height <= height);
                    }
                }
            }
            assert!(profile.window(u32::MAX, u32::MAX).is_some());
        }
        assert_eq!(CropProfile::GSMINI_SEVENTH.window(3, 2), None);
    }

    #[test]
    fn names_round_trip() {
        for profile in CropProfile::ALL {
            assert_eq!(CropProfile::by_name(profile.name()).unwrap(), profile);
        }
        let error = CropProfile::by_name("gsmini-sevnth-v1").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Config);
        let text = error.to_string();
        assert!(text.contains("did you mean `gsmini-seventh-v1`?"), "{text}");
        assert!(text.contains("full-v1"), "{text}");
        let text = CropProfile::by_name("x").unwrap_err().to_string();
        assert!(!text.contains("did you mean"), "{text}");
    }
}
