//! Shipped sensor profiles, by name.

use std::path::Path;

use serde::{Deserialize, Deserializer, Serialize, de::Error as _};

use super::profile::SensorProfile;
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_imaging::decode_png_rgb;
use gripcast_sim::grasp::Finger;

/// A shipped profile: its name, its TOML and its background image, if it has one.
#[derive(Clone, Copy)]
struct Shipped {
    name: &'static str,
    toml: &'static str,
    background: Option<&'static [u8]>,
}

/// All shipped profiles; their provenance says what they were fitted to.
const SHIPPED: [Shipped; 4] = [
    Shipped {
        name: "gelsight-mini",
        toml: include_str!("../../../calib/sensors/gelsight-mini.toml"),
        background: Some(include_bytes!(
            "../../../calib/sensors/gelsight-mini.background.png"
        )),
    },
    Shipped {
        name: "gelsight-mini-markers",
        toml: include_str!("../../../calib/sensors/gelsight-mini-markers.toml"),
        background: None,
    },
    Shipped {
        name: "gelsight-r1.5",
        toml: include_str!("../../../calib/sensors/gelsight-r1.5.toml"),
        background: Some(include_bytes!(
            "../../../calib/sensors/gelsight-r1.5.background.png"
        )),
    },
    Shipped {
        name: "digit",
        toml: include_str!("../../../calib/sensors/digit.toml"),
        background: None,
    },
];

/// Name of a shipped profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SensorName(&'static str);

impl SensorName {
    /// The generic GelSight Mini.
    pub const GELSIGHT_MINI: Self = Self("gelsight-mini");

    /// All names.
    #[must_use]
    pub fn all() -> [Self; SHIPPED.len()] {
        SHIPPED.map(|shipped| Self(shipped.name))
    }

    /// The name as text.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        self.0
    }

    /// Returns the shipped profile of a name.
    ///
    /// # Errors
    /// `Config` for an unknown name, with the nearest one and all names.
    pub fn by_name(name: &str) -> Result<Self> {
        Self::find(name).map(|shipped| Self(shipped.name))
    }

    /// Returns the profile.
    ///
    /// # Errors
    /// None; a test covers the shipped files.
    pub fn profile(self) -> Result<SensorProfile> {
        let shipped = Self::find(self.0)?;
        let mut profile = SensorProfile::from_toml(shipped.toml).map_err(|e| e.at(shipped.name))?;
        if let Some(background) = shipped.background {
            profile.background.image = Some(decode_png_rgb(background)?);
            profile.check_image()?;
        }
        Ok(profile)
    }

    fn find(name: &str) -> Result<&'static Shipped> {
        SHIPPED
            .iter()
            .find(|shipped| shipped.name == name)
            .ok_or_else(|| {
                let names = SHIPPED.each_ref().map(|shipped| shipped.name);
                let hint = nearest_name(name, names)
                    .map_or(String::new(), |near| format!("did you mean `{near}`? "));
                Error::config(format!("unknown sensor profile `{name}`")).remedy(format!(
                    "{hint}use one of {}, or the path of a file that ends in .toml",
                    names.join(", ")
                ))
            })
    }
}

impl<'de> Deserialize<'de> for SensorName {
    fn deserialize<D: Deserializer<'de>>(d: D) -> std::result::Result<Self, D::Error> {
        Self::by_name(&String::deserialize(d)?).map_err(D::Error::custom)
    }
}

impl SensorProfile {
    /// Returns the generic GelSight Mini.
    ///
    /// # Errors
    /// None; a test covers the shipped file.
    pub fn gelsight_mini() -> Result<Self> {
        SensorName::GELSIGHT_MINI.profile()
    }

    /// Returns a shipped profile by its name, or reads a file: whatever has a slash or ends in
    /// `.toml`.
    ///
    /// # Errors
    /// Those of [`SensorName::by_name`] and [`SensorProfile::load`].
    pub fn named_or_load(name_or_file: &str) -> Result<Self> {
        if name_or_file.contains('/') || name_or_file.ends_with(".toml") {
            Self::load(Path::new(name_or_file))
        } else {
            SensorName::by_name(name_or_file)?.profile()
        }
    }

    /// The profile of a sensor on a finger: the gels of two sensors of a kind differ, so one without
    /// a serial gets the finger's name.
    #[must_use]
    pub fn on_finger(mut self, finger: Finger) -> Self {
        if self.serial.is_empty() {
            self.serial = finger.name().to_owned();
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_profiles_are_valid_and_say_where_they_come_from() {
        for name in SensorName::all() {
            let profile = name.profile().unwrap();
            assert_eq!(profile.name, name.as_str());
            assert!(profile.provenance.len() > 100, "{name:?}");
            let back = SensorProfile::from_toml(&profile.to_toml().unwrap()).unwrap();
            assert_eq!((back.gel, back.markers), (profile.gel, profile.markers));
        }
    }

    #[test]
    fn unknown_name_is_answered_with_all_names() {
        let error = SensorProfile::named_or_load("gelsight-mini-marker").unwrap_err();
        let text = format!("{error}");
        assert!(
            text.contains("did you mean `gelsight-mini-markers`?"),
            "{text}"
        );
        for name in SensorName::all() {
            assert!(text.contains(name.as_str()), "{text}");
        }
    }
}
