//! The virtual cameras of a rig file.

use std::path::PathBuf;
use std::sync::Arc;

use super::camera::VirtualRig;
use super::hand::VirtualHand;
use super::library::FilmLibrary;
use gripcast_base::error::{Error, Result};
use gripcast_capture::calibration::CameraConfig;
use gripcast_capture::camera::{CameraOpener, MonotonicClock, VirtualCameras};
use gripcast_imaging::Role;

/// Names the file with the roles of virtual cameras that are unplugged.
const UNPLUGGED_VARIABLE: &str = "GRIPCAST_VIRTUAL_UNPLUGGED";

/// Opens the `virtual` cameras of a rig file; they all see one hand.
pub struct VirtualSource {
    seed: u64,
    /// The rig and the folder of its films, once a camera was asked for.
    rig: Option<(VirtualRig, Option<PathBuf>)>,
}

impl VirtualSource {
    /// The order of the films and the noise follow from `seed`.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { seed, rig: None }
    }

    /// The hand, where the rig has virtual cameras.
    #[must_use]
    pub fn hand(&self) -> Option<Arc<VirtualHand>> {
        self.rig.as_ref().map(|(rig, _)| rig.hand())
    }
}

impl VirtualCameras for VirtualSource {
    fn camera(&mut self, role: Role, config: &CameraConfig) -> Result<Box<dyn CameraOpener>> {
        let (rig, films) = match &self.rig {
            Some(made) => made,
            None => self
                .rig
                .insert((made(config, self.seed)?, config.path.clone())),
        };
        if *films != config.path {
            return Err(
                Error::config("the virtual cameras of a rig must play the same films")
                    .at(format!("camera {role}"))
                    .remedy("give every virtual camera the same `path`, or none"),
            );
        }
        Ok(Box::new(rig.camera(role, config)?))
    }
}

/// The rig that plays the films of a virtual camera.
fn made(camera: &CameraConfig, seed: u64) -> Result<VirtualRig> {
    let films = match &camera.path {
        Some(folder) => FilmLibrary::read(folder)?,
        None => FilmLibrary::built_in()?,
    };
    let rig = VirtualRig::new(films, seed, Arc::new(MonotonicClock));
    Ok(match std::env::var_os(UNPLUGGED_VARIABLE) {
        Some(file) => rig.with_unplugged(file.into()),
        None => rig,
    })
}
