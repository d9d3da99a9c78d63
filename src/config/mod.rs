//! Configuration: defaults < TOML file < `GRIPCAST__SECTION__KEY` < flags.
//!
//! Every value keeps its origin (`gripcast config show`); an unknown key is an error that names the
//! nearest one. A `gripcast.toml` found in the current folder may not set protected keys.

mod layers;
mod values;

pub(crate) use values::{ADAPT_STRENGTH, ERROR_RATE_OR_NONE, KEEP_LIFT_S};

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::daemon::BlackBoxSettings;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{Label, ObjectName};
use gripcast_nn::predict::ADAPTATION_STRENGTH;
use gripcast_session::GuardLimits;

pub use layers::{
    ConfigFile, FlagValue, Ignored, Layered, Origin, default_file, linked_folders, load, merge,
};

/// All settings; an empty string means not set.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Collection.
    pub collect: CollectConfig,
    /// Daemon.
    pub daemon: DaemonConfig,
    /// Limits of the trigger guards.
    pub guards: GuardLimits,
    /// Rolling log of a collection.
    pub black_box: BlackBoxConfig,
    /// Files of datasets, plans and meshes.
    pub files: FilesConfig,
}

/// Section `[files]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FilesConfig {
    /// Folders outside of a dataset that its symbolic links may point into, separated by `:`.
    pub linked_folders: String,
}

impl FilesConfig {
    /// Returns the folders.
    #[must_use]
    pub fn folders(&self) -> Vec<PathBuf> {
        std::env::split_paths(&self.linked_folders)
            .filter(|path| !path.as_os_str().is_empty())
            .collect()
    }
}

/// Size of the black box write queue, bytes: a third of a second of two GelSight Minis and a D435.
const BLACK_BOX_QUEUE_BYTES: usize = 64 << 20;

/// Section `[black_box]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BlackBoxConfig {
    /// Whether it is enabled.
    pub enabled: bool,
    /// Parent folder of one folder per dataset; empty: `blackbox` in the dataset.
    pub directory: String,
    /// Size at which a new file is started, MiB.
    pub file_mib: u64,
    /// Maximum size of a dataset's log, GiB; the oldest files are removed.
    pub total_gib: f64,
    /// Free disk space below which logging stops, GB.
    pub reserve_gb: f64,
}

impl Default for BlackBoxConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            directory: String::new(),
            file_mib: 1024,
            total_gib: 20.0,
            reserve_gb: 2.0,
        }
    }
}

impl BlackBoxConfig {
    /// Returns the black box settings of a dataset; none if disabled.
    ///
    /// # Errors
    /// `Config` for limits that are out of range or contradict each other.
    pub fn settings(&self, dataset: &Path) -> Result<Option<BlackBoxSettings>> {
        if !self.enabled {
            return Ok(None);
        }
        let invalid = |key: &str, expected: &str, found: &dyn fmt::Display| {
            let what = format!("`black_box.{key}` must be {expected}, found {found}");
            Error::config(what)
        };
        if !(1..=1 << 20).contains(&self.file_mib) {
            return Err(invalid("file_mib", "between 1 and 1048576", &self.file_mib));
        }
        let file_bytes = self.file_mib << 20;
        let total = self.total_gib * (1_u64 << 30) as f64;
        if !(total.is_finite() && total >= file_bytes as f64) {
            let expected = format!("at least one file of {} MiB", self.file_mib);
            return Err(invalid("total_gib", &expected, &self.total_gib));
        }
        let reserve = self.reserve_gb * 1e9;
        if !(reserve.is_finite() && reserve >= 0.0) {
            return Err(invalid("reserve_gb", "0 or more", &self.reserve_gb));
        }
        let directory = if self.directory.is_empty() {
            dataset.join("blackbox")
        } else {
            let name = dataset.file_name().unwrap_or(dataset.as_os_str());
            Path::new(&self.directory).join(name)
        };
        Ok(Some(BlackBoxSettings {
            directory,
            file_bytes,
            total_bytes: total as u64,
            reserve_bytes: reserve as u64,
            queue_bytes: BLACK_BOX_QUEUE_BYTES,
        }))
    }
}

/// Section `[daemon]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DaemonConfig {
    /// Address and port of the page and the API; `none` disables TCP.
    pub listen: String,
    /// Unix socket for local programs; empty: in `$XDG_RUNTIME_DIR` or `/run/gripcast`; `none`
    /// disables it.
    pub socket: String,
    /// File with the token that TCP clients must present.
    pub token_file: String,
}

impl Default for DaemonConfig {
    fn default() -> Self {
        Self {
            listen: "127.0.0.1:7471".into(),
            socket: String::new(),
            token_file: String::new(),
        }
    }
}

/// Section `[collect]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CollectConfig {
    /// Rig name or file.
    pub rig: String,
    /// Dataset folder.
    pub dataset: String,
    /// Initial object name.
    pub object: ObjectName,
    /// Initial scene name.
    pub scene: Label,
    /// Name of the operator.
    pub operator: Label,
    /// ONNX file, `gripcast-vt` or `baseline-contact`; empty: the first of the two that suits the
    /// rig; `none` disables prediction.
    pub model: String,
    /// `auto`, `bell` or `off`.
    pub sound: String,
    /// Images of the screen: `auto`, `kitty`, `iterm2`, `sixel` or `blocks`.
    pub graphics: String,
    /// Licence of a new dataset.
    pub licence: String,
    /// Labelled grasps wanted per object, shown with its count; 0: no target.
    pub target_per_object: u32,
    /// Time after the grasp trigger for which the frames of both gels are stored with the grasp, s;
    /// 0: none.
    pub keep_lift_s: f64,
    /// Error rate of the prediction sets (stable, slip, can't tell); 0: no sets.
    pub error_rate: f64,
    /// Whether predictions are adapted to the base rate of the rig's labels.
    pub adapt: bool,
    /// Weight of the model's base rate in the adaptation, in labels.
    pub adapt_strength: f64,
}

impl Default for CollectConfig {
    fn default() -> Self {
        Self {
            rig: String::new(),
            dataset: String::new(),
            object: ObjectName::default(),
            scene: Label::nearest("scene"),
            operator: Label::default(),
            model: String::new(),
            sound: "auto".into(),
            graphics: "auto".into(),
            licence: "not stated".into(),
            target_per_object: 0,
            keep_lift_s: 0.0,
            error_rate: 0.0,
            adapt: false,
            adapt_strength: ADAPTATION_STRENGTH,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn black_box_is_off_and_checks_limits() {
        let dataset = Path::new("/data/kitchen");
        assert_eq!(BlackBoxConfig::default().settings(dataset).unwrap(), None);
        let on = BlackBoxConfig {
            enabled: true,
            ..BlackBoxConfig::default()
        };
        let settings = on.settings(dataset).unwrap().unwrap();
        assert_eq!(settings.directory, Path::new("/data/kitchen/blackbox"));
        assert_eq!(settings.file_bytes, 1 << 30);
        assert_eq!(settings.total_bytes, 20 << 30);
        assert_eq!(settings.reserve_bytes, 2_000_000_000);
        let apart = BlackBoxConfig {
            directory: "/logs".into(),
            ..on.clone()
        };
        let settings = apart.settings(dataset).unwrap().unwrap();
        assert_eq!(settings.directory, Path::new("/logs/kitchen"));
        for (wrong, key) in [
            (
                BlackBoxConfig {
                    file_mib: 0,
                    ..on.clone()
                },
                "file_mib",
            ),
            (
                BlackBoxConfig {
                    total_gib: 0.5,
                    ..on.clone()
                },
                "total_gib",
            ),
            (
                BlackBoxConfig {
                    total_gib: f64::NAN,
                    ..on.clone()
                },
                "total_gib",
            ),
            (
                BlackBoxConfig {
                    reserve_gb: -1.0,
                    ..on.clone()
                },
                "reserve_gb",
            ),
        ] {
            let error = wrong.settings(dataset).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Config);
            assert!(error.to_string().contains(key), "{error}");
        }
    }
}
