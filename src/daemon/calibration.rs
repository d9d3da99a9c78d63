//! Calibration of the cameras as stored in a dataset.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::ContentKey;
use gripcast_capture::calibration::{CameraConfig, RigFile, SourceKind};
use gripcast_dataset::DatasetWriter;
use gripcast_imaging::{Intrinsics, Role};
use gripcast_tactile::force::ForceCalibration;

/// Contents of a file in `calibration/`.
#[derive(Serialize)]
struct Calibration<'a> {
    camera: &'a CameraConfig,
    intrinsics: Option<&'a Intrinsics>,
    #[serde(skip_serializing_if = "Option::is_none")]
    force: Option<&'a ForceCalibration>,
}

/// Stores the calibration of every camera of a rig and returns the content keys.
///
/// # Errors
/// `DiskFull`, `Io`, ….
pub(super) fn store_calibration(
    writer: &mut DatasetWriter,
    rig: &RigFile,
    intrinsics: &BTreeMap<Role, Intrinsics>,
    forces: &BTreeMap<Role, ForceCalibration>,
) -> Result<BTreeMap<Role, ContentKey>> {
    rig.cameras
        .iter()
        .map(|(role, camera)| {
            let calibration = Calibration {
                camera,
                intrinsics: intrinsics.get(role),
                force: forces.get(role),
            };
            let text = toml::to_string_pretty(&calibration)
                .map_err(|e| Error::internal("cannot serialise the calibration").because(e))?;
            Ok((*role, writer.put_calibration(&text)?))
        })
        .collect()
}

/// Reads the source of a camera's frames from a file that `store_calibration` wrote; none if it is
/// invalid.
pub(super) fn stored_source(text: &str) -> Option<SourceKind> {
    #[derive(Deserialize)]
    struct Stored {
        camera: CameraConfig,
    }
    let stored: Stored = toml::from_str(text).ok()?;
    Some(stored.camera.source)
}

/// Reads the intrinsics, if any, from a file that `store_calibration` wrote.
///
/// # Errors
/// `Input` for an invalid file; `Config` for implausible intrinsics.
pub fn stored_intrinsics(text: &str) -> Result<Option<Intrinsics>> {
    #[derive(Deserialize)]
    struct Stored {
        intrinsics: Option<Intrinsics>,
    }
    let stored: Stored = toml::from_str(text).map_err(|e| {
        let what = format!("cannot read the stored calibration: {}", e.message());
        Error::input(what).remedy("pass --intrinsics FILE")
    })?;
    stored.intrinsics.map(Intrinsics::validate).transpose()
}
