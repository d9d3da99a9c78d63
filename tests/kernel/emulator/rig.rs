//! The emulated rig: two GelSight Minis, a D435 and a foot switch, plugged or not.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use crate::command::Command;
use crate::device::Plugged;
use crate::feed::{Feed, Images};
use crate::hid_pedal;
use crate::profile::{self, Class, DEVICES, PEDAL, Pixels, Profile};

/// Images sent and spoilt, by camera and kind.
pub(crate) type Counters = BTreeMap<&'static str, BTreeMap<&'static str, u64>>;

/// See the module.
pub(crate) struct Rig {
    profiles: [Profile; DEVICES],
    /// By device, in the order of its streams.
    feeds: [Vec<(&'static str, Arc<Feed>)>; DEVICES],
    plugged: [Option<Plugged>; DEVICES],
}

impl Rig {
    /// A rig with nothing plugged in; the gels see the images of the two directories.
    pub(crate) fn new(left: &Path, right: &Path) -> io::Result<Self> {
        let profiles = profile::rig();
        let mut feeds = [const { Vec::new() }; DEVICES];
        for (feeds, profile) in feeds.iter_mut().zip(&profiles) {
            let Class::Camera(functions) = &profile.class else {
                continue;
            };
            for stream in functions.iter().flat_map(|f| &f.streams) {
                let images = match (stream.pixels, stream.role) {
                    (Pixels::Mjpg, "left") => Images::from_dir(left)?,
                    (Pixels::Mjpg, _) => Images::from_dir(right)?,
                    (pixels, _) => Images::Drawn(pixels),
                };
                feeds.push((stream.role, Arc::new(Feed::new(images))));
            }
        }
        Ok(Self {
            profiles,
            feeds,
            plugged: [const { None }; DEVICES],
        })
    }

    fn all_feeds(&self) -> impl Iterator<Item = &(&'static str, Arc<Feed>)> {
        self.feeds.iter().flatten()
    }

    /// Stream of a camera by its role.
    pub(crate) fn feed(&self, role: &str) -> io::Result<&Arc<Feed>> {
        let found = self.all_feeds().find(|(name, _)| *name == role);
        found.map(|(_, feed)| feed).ok_or_else(|| {
            io::Error::new(
                io::ErrorKind::InvalidInput,
                format!("unknown camera `{role}`"),
            )
        })
    }

    /// Carries a command out.
    pub(crate) fn obey(&mut self, command: &Command) -> io::Result<()> {
        match command {
            Command::Attach { device, port } => {
                let feeds: Vec<_> = self.feeds[*device].iter().map(|(_, f)| f.clone()).collect();
                let plugged = Plugged::new(&self.profiles[*device], *port, &feeds)?;
                self.plugged[*device] = Some(plugged);
                feeds.iter().for_each(|feed| feed.plugged());
            }
            Command::Detach { device } => self.plugged[*device] = None,
            Command::Fault {
                camera,
                fault,
                images,
            } => self.feed(camera)?.set_fault(*fault, *images),
            Command::StallCommit { camera, times } => self.feed(camera)?.refuse_starts(*times),
            Command::TwinSerials => profile::make_twins(&mut self.profiles),
            Command::Touch(touch) => {
                for (_, feed) in self.all_feeds() {
                    feed.set_touch(*touch);
                }
            }
            Command::Pedal { bounces } => {
                if let Some(pedal) = &self.plugged[PEDAL] {
                    pedal.report(hid_pedal::press(Instant::now(), *bounces));
                }
            }
            Command::Quit => self.plugged = [const { None }; DEVICES],
        }
        Ok(())
    }

    /// How long each camera that was plugged in again took to its next image, s.
    pub(crate) fn came_back_s(&self) -> BTreeMap<&'static str, Vec<f64>> {
        self.all_feeds()
            .map(|(role, feed)| (*role, feed.came_back_s()))
            .collect()
    }

    /// What each camera has sent so far.
    pub(crate) fn counters(&self) -> Counters {
        self.all_feeds()
            .map(|(role, feed)| (*role, feed.counters()))
            .collect()
    }
}
