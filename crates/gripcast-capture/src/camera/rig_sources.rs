//! Openers for the cameras of a rig file.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{CameraOpener, KernelNodes, MonotonicClock, ReplayOpener, V4l2Opener};
use crate::calibration::{CameraConfig, RigFile, SourceKind, colour_intrinsics};
use crate::device::{CameraBinder, SystemRoot};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Intrinsics, Role};

/// Creates openers for the `virtual` cameras of a rig.
pub trait VirtualCameras {
    /// An opener for the virtual camera of `role`.
    ///
    /// # Errors
    /// `Config` for an unsupported `config`.
    fn camera(&mut self, role: Role, config: &CameraConfig) -> Result<Box<dyn CameraOpener>>;
}

/// Rejects virtual cameras.
pub struct NoVirtualCameras;

impl VirtualCameras for NoVirtualCameras {
    fn camera(&mut self, role: Role, _: &CameraConfig) -> Result<Box<dyn CameraOpener>> {
        let what = "virtual cameras are not supported here";
        Err(Error::config(what)
            .at(format!("camera {role}"))
            .remedy("set `source` to \"v4l2\" or \"replay\" in the rig file"))
    }
}

/// Openers for all cameras of a rig.
pub struct RigSources {
    /// One per camera.
    pub openers: Vec<Box<dyn CameraOpener>>,
    /// V4L2 cameras.
    v4l2: Vec<V4l2Opener>,
}

impl RigSources {
    /// Creates openers for the cameras of `rig`, using `virtual_cameras` for those with
    /// `source = "virtual"`.
    ///
    /// # Errors
    /// For an unsupported camera configuration.
    pub fn new(
        rig: &RigFile,
        root: &SystemRoot,
        virtual_cameras: &mut dyn VirtualCameras,
    ) -> Result<Self> {
        let mut sources = Self {
            openers: Vec::new(),
            v4l2: Vec::new(),
        };
        let binder = Arc::new(CameraBinder::new(&rig.cameras));
        for (role, camera) in &rig.cameras {
            let opener: Box<dyn CameraOpener> = match camera.source {
                SourceKind::V4l2 => {
                    let opener =
                        || V4l2Opener::new(*role, camera.clone(), binder.clone(), root.clone());
                    sources.v4l2.push(opener());
                    Box::new(opener())
                }
                SourceKind::Replay => {
                    Box::new(ReplayOpener::new(*role, camera, Arc::new(MonotonicClock))?)
                }
                SourceKind::Virtual => virtual_cameras.camera(*role, camera)?,
            };
            sources.openers.push(opener);
        }
        Ok(sources)
    }

    /// Factory intrinsics of D435 colour cameras without an intrinsics file, and notes about
    /// failures.
    pub fn factory_intrinsics(
        &self,
        rig: &RigFile,
        root: &SystemRoot,
    ) -> (BTreeMap<Role, Intrinsics>, Vec<String>) {
        let (mut found, mut notes) = (BTreeMap::new(), Vec::new());
        for opener in &self.v4l2 {
            let role = opener.role();
            let Some(camera) = rig.cameras.get(&role) else {
                continue;
            };
            let is_d435_colour = role == Role::Rgb && camera.product.contains("RealSense");
            if !is_d435_colour || camera.intrinsics.is_some() {
                continue;
            }
            let (width, height) = (camera.width, camera.height);
            let read = opener.find().and_then(|(device, _)| {
                colour_intrinsics(root, &KernelNodes, &device.port, width, height)
            });
            match read {
                Ok(intrinsics) => {
                    found.insert(role, intrinsics);
                }
                Err(error) => notes.push(format!("{role}: no factory intrinsics: {error}")),
            }
        }
        (found, notes)
    }

    /// Checks that all V4L2 cameras are connected and unambiguous.
    ///
    /// # Errors
    /// `Device` for the first one that is not.
    pub fn check_present(&self) -> Result<()> {
        for opener in &self.v4l2 {
            opener.find()?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn virtual_cameras_can_be_unsupported() {
        let rig = RigFile::virtual_rig();
        let sources = RigSources::new(&rig, &SystemRoot::default(), &mut NoVirtualCameras);
        let error = sources.err().unwrap();
        assert_eq!(error.kind(), ErrorKind::Config);
        let text = error.to_string();
        assert!(text.starts_with("camera left: virtual cameras"), "{text}");
    }
}
