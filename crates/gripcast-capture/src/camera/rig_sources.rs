//! The cameras of a rig file, whatever kind they are.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use super::{
    CameraOpener, FilmLibrary, KernelNodes, MonotonicClock, ReplayOpener, V4l2Opener, VirtualHand,
    VirtualRig,
};
use crate::calibration::{CameraConfig, RigFile, SourceKind, colour_intrinsics};
use crate::device::SystemRoot;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_imaging::{Intrinsics, Role};
use gripcast_pose::load_intrinsics;

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
        let mut scene: Option<(VirtualRig, &Option<PathBuf>)> = None;
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
                    let (rig, films) = match &scene {
                        Some(made) => made,
                        None => scene.insert((virtual_rig(camera, seed)?, &camera.path)),
                    };
                    if **films != camera.path {
                        return Err(Error::new(
                            ErrorKind::Config,
                            "the virtual cameras of a rig must play the same films",
                        )
                        .at(format!("camera {role}"))
                        .remedy("give every virtual camera the same `path`, or none"));
                    }
                    sources.hand = Some(rig.hand());
                    Box::new(rig.camera(*role, camera)?)
                }
            };
            sources.openers.push(opener);
        }
        Ok(sources)
    }

    /// Intrinsics of the colour cameras: from the file that the rig names, else from the D435
    /// itself. What could not be had is told in the second value and is no obstacle to collecting.
    ///
    /// # Errors
    /// When an intrinsics file is named and wrong: its poses would be wrong later.
    pub fn intrinsics(
        &self,
        rig: &RigFile,
        root: &SystemRoot,
    ) -> Result<(BTreeMap<Role, Intrinsics>, Vec<String>)> {
        let (mut found, mut notes) = (BTreeMap::new(), Vec::new());
        for (role, camera) in &rig.cameras {
            if let Some(path) = &camera.intrinsics {
                found.insert(*role, load_intrinsics(path)?);
            } else if *role == Role::External
                && camera.source == SourceKind::Virtual
                && let Some(hand) = &self.hand
            {
                found.extend(
                    hand.film()
                        .outside_intrinsics(camera.width, camera.height)
                        .map(|intrinsics| (*role, intrinsics)),
                );
            }
        }
        for opener in &self.present {
            let role = opener.role();
            let Some(camera) = rig.cameras.get(&role) else {
                continue;
            };
            let is_d435_colour = role == Role::Rgb && camera.product.contains("RealSense");
            if !is_d435_colour || found.contains_key(&role) {
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
        Ok((found, notes))
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

/// Names the file with the roles of virtual cameras that are unplugged.
const UNPLUGGED_VARIABLE: &str = "GRIPCAST_VIRTUAL_UNPLUGGED";

/// The rig that plays the films of a virtual camera.
fn virtual_rig(camera: &CameraConfig, seed: u64) -> Result<VirtualRig> {
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
