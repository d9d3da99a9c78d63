//! The cameras of a rig file, whatever kind they are.

use std::sync::Arc;

use super::{CameraOpener, MonotonicClock, ReplayOpener, V4l2Opener, VirtualHand, VirtualRig};
use crate::error::Result;
use crate::rig::calibration::{RigFile, SourceKind};
use crate::rig::device::SystemRoot;

/// Openers for every camera of a rig.
pub struct RigSources {
    /// One a camera.
    pub openers: Vec<Box<dyn CameraOpener>>,
    /// The virtual hand, where the rig has virtual cameras.
    pub hand: Option<Arc<VirtualHand>>,
    /// Cameras whose presence can be asked before they are opened.
    present: Vec<V4l2Opener>,
}

impl RigSources {
    /// Openers for the cameras of `rig`; nothing is opened yet.
    ///
    /// # Errors
    /// When the rig file asks for what a source cannot do.
    pub fn of(rig: &RigFile, root: &SystemRoot, seed: u64) -> Result<Self> {
        let mut sources = Self {
            openers: Vec::new(),
            hand: None,
            present: Vec::new(),
        };
        let mut scene: Option<VirtualRig> = None;
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
                SourceKind::Virtual => {
                    let scene = scene
                        .get_or_insert_with(|| VirtualRig::new(seed, Arc::new(MonotonicClock)));
                    sources.hand = Some(scene.hand());
                    Box::new(scene.camera(*role, camera)?)
                }
            };
            sources.openers.push(opener);
        }
        Ok(sources)
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
