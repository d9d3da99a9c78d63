//! The virtual cameras of a rig file.

use std::path::PathBuf;
use std::sync::Arc;

use super::camera::VirtualRig;
use super::hand::VirtualHand;
use super::library::ClipLibrary;
use gripcast_base::error::{Error, Result};
use gripcast_capture::calibration::CameraConfig;
use gripcast_capture::camera::{CameraOpener, MonotonicClock, VirtualCameras};
use gripcast_imaging::Role;

/// Environment variable with the path of a file that lists the roles of unplugged virtual cameras.
const UNPLUGGED_VARIABLE: &str = "GRIPCAST_VIRTUAL_UNPLUGGED";

/// Opens the `virtual` cameras of a rig file; all of them see the same hand.
pub struct VirtualSource {
    seed: u64,
    /// The rig and its clip folder, once a camera has been requested.
    rig: Option<(VirtualRig, Option<PathBuf>)>,
}

impl VirtualSource {
    /// Creates a source whose clip order and noise follow from `seed`.
    pub fn new(seed: u64) -> Self {
        Self { seed, rig: None }
    }

    /// Returns the hand, if the rig has virtual cameras.
    pub fn hand(&self) -> Option<Arc<VirtualHand>> {
        self.rig.as_ref().map(|(rig, _)| rig.hand())
    }
}

impl VirtualCameras for VirtualSource {
    fn camera(&mut self, role: Role, config: &CameraConfig) -> Result<Box<dyn CameraOpener>> {
        let (rig, clips) = match &self.rig {
            Some(rig) => rig,
            None => self
                .rig
                .insert((virtual_rig(config, self.seed)?, config.path.clone())),
        };
        if *clips != config.path {
            return Err(
                Error::config("the virtual cameras of a rig must play the same clips")
                    .at(format!("camera {role}"))
                    .remedy("set the same `path` for every virtual camera, or none"),
            );
        }
        Ok(Box::new(rig.camera(role, config)?))
    }
}

/// Creates the rig that plays the clips of a virtual camera.
fn virtual_rig(camera: &CameraConfig, seed: u64) -> Result<VirtualRig> {
    let clips = match &camera.path {
        Some(folder) => ClipLibrary::read(folder)?,
        None => ClipLibrary::built_in()?,
    };
    let rig = VirtualRig::new(clips, seed, Arc::new(MonotonicClock));
    Ok(match std::env::var_os(UNPLUGGED_VARIABLE) {
        Some(file) => rig.with_unplugged(file.into()),
        None => rig,
    })
}
