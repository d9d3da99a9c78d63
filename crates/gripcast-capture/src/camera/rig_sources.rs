//! The cameras of a rig file, whatever kind they are.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{CameraOpener, KernelNodes, MonotonicClock, ReplayOpener, V4l2Opener};
use crate::calibration::{CameraConfig, RigFile, SourceKind, colour_intrinsics};
use crate::device::SystemRoot;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Intrinsics, Role};

/// Opens the `virtual` cameras of a rig; the simulation behind them is not part of this crate.
pub trait VirtualCameras {
    /// An opener for the virtual camera of `role`.
    ///
    /// # Errors
    /// [`ErrorKind::Config`] when no virtual camera can do what `config` asks for.
    fn camera(&mut self, role: Role, config: &CameraConfig) -> Result<Box<dyn CameraOpener>>;
}

/// No virtual cameras: a rig that has some is refused.
pub struct NoVirtualCameras;

impl VirtualCameras for NoVirtualCameras {
    fn camera(&mut self, role: Role, _: &CameraConfig) -> Result<Box<dyn CameraOpener>> {
        let what = "virtual cameras are not available here";
        Err(Error::config(what)
            .at(format!("camera {role}"))
            .remedy("set `source` to \"v4l2\" or \"replay\" in the rig file"))
    }
}

/// Openers for every camera of a rig.
pub struct RigSources {
    /// One a camera.
    pub openers: Vec<Box<dyn CameraOpener>>,
    /// Cameras whose presence can be asked before they are opened.
    present: Vec<V4l2Opener>,
}

impl RigSources {
    /// Openers for the cameras of `rig`; nothing is opened yet. `virtual_cameras` makes those
    /// with `source = "virtual"`.
    ///
    /// # Errors
    /// When the rig file asks for what a source cannot do.
    pub fn of(
        rig: &RigFile,
        root: &SystemRoot,
        virtual_cameras: &mut dyn VirtualCameras,
    ) -> Result<Self> {
        let mut sources = Self {
            openers: Vec::new(),
            present: Vec::new(),
        };
        for (role, camera) in &rig.cameras {
            let opener: Box<dyn CameraOpener> = match camera.source {
                SourceKind::V4l2 => {
                    let opener = || V4l2Opener::new(*role, camera.clone(), root.clone());
                    sources.present.push(opener());
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

    /// Factory intrinsics of D435 colour cameras for which the rig names no file. What could not
    /// be read is told in the second value and is no obstacle to collecting.
    pub fn factory_intrinsics(
        &self,
        rig: &RigFile,
        root: &SystemRoot,
    ) -> (BTreeMap<Role, Intrinsics>, Vec<String>) {
        let (mut found, mut notes) = (BTreeMap::new(), Vec::new());
        for opener in &self.present {
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

    /// Checks that every real camera is plugged in and unambiguous.
    ///
    /// # Errors
    /// `Device` for the first one that is not, saying what was found instead.
    pub fn check_present(&self) -> Result<()> {
        for opener in &self.present {
            opener
                .find()
                .map_err(|e| e.at(format!("camera {}", opener.role())))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn a_virtual_rig_is_refused_where_nothing_simulates_it() {
        let rig = RigFile::virtual_rig();
        let made = RigSources::of(&rig, &SystemRoot::default(), &mut NoVirtualCameras);
        let error = made.err().unwrap();
        assert_eq!(error.kind(), ErrorKind::Config);
        let text = error.to_string();
        assert!(text.starts_with("camera left: virtual cameras"), "{text}");
    }
}
