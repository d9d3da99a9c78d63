//! Shipped sensor profiles, by name.

use std::path::Path;

use super::profile::SensorProfile;
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_imaging::decode_png_rgb;

/// A shipped profile: its name, its TOML and its background image, if it has one.
struct Shipped {
    name: &'static str,
    toml: &'static str,
    background: Option<&'static [u8]>,
}

/// All shipped profiles; their provenance says what they were fitted to.
const SHIPPED: [Shipped; 2] = [
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
];

impl SensorProfile {
    /// Names of the shipped profiles.
    #[must_use]
    pub fn names() -> [&'static str; SHIPPED.len()] {
        SHIPPED.map(|shipped| shipped.name)
    }

    /// Returns the shipped profile of a name.
    ///
    /// # Errors
    /// `Config` for an unknown name, with the nearest one and all names.
    pub fn shipped(name: &str) -> Result<Self> {
        let Some(found) = SHIPPED.iter().find(|shipped| shipped.name == name) else {
            let names = Self::names();
            let hint = nearest_name(name, names)
                .map_or(String::new(), |near| format!("did you mean `{near}`? "));
            return Err(
                Error::config(format!("unknown sensor profile `{name}`")).remedy(format!(
                    "{hint}use one of {}, or the path of a file that ends in .toml",
                    names.join(", ")
                )),
            );
        };
        let mut profile = Self::from_toml(found.toml).map_err(|e| e.at(name))?;
        if let Some(background) = found.background {
            profile.background.image = Some(decode_png_rgb(background)?);
            profile.check_image()?;
        }
        Ok(profile)
    }

    /// Returns the generic GelSight Mini.
    ///
    /// # Errors
    /// None; a test covers the shipped file.
    pub fn gelsight_mini() -> Result<Self> {
        Self::shipped("gelsight-mini")
    }

    /// Returns a shipped profile by its name, or reads a file: whatever has a slash or ends in
    /// `.toml`.
    ///
    /// # Errors
    /// Those of [`SensorProfile::shipped`] and [`SensorProfile::load`].
    pub fn named_or_load(name_or_file: &str) -> Result<Self> {
        let is_file = name_or_file.contains('/') || name_or_file.ends_with(".toml");
        if is_file {
            Self::load(Path::new(name_or_file))
        } else {
            Self::shipped(name_or_file)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_profiles_are_valid_and_say_where_they_come_from() {
        for name in SensorProfile::names() {
            let profile = SensorProfile::shipped(name).unwrap();
            assert_eq!(profile.name, name);
            assert!(profile.provenance.len() > 100, "{name}");
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
        for name in SensorProfile::names() {
            assert!(text.contains(name), "{text}");
        }
    }
}
