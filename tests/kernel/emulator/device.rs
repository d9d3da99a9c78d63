//! One plugged device: answers control requests and owns the threads that send its data.

use std::fs;
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::mpsc::{self, Sender};
use std::thread;
use std::time::Duration;

use crate::camera;
use crate::control::{ControlPanel, EXTENSION_UNIT, HardwareMonitor, request};
use crate::descriptors::{self, Descriptors, PAYLOAD_BYTES, StreamPlace};
use crate::feed::Feed;
use crate::hid_pedal::{self, Report};
use crate::link::Link;
use crate::profile::{CameraFunction, Class, Mode, Pixels, Profile};
use crate::usbip::{self, Request, Submit};

/// Where `vhci_hcd` takes devices: `<port> <socket> <device id> <speed>`.
const VHCI_ATTACH: &str = "/sys/devices/platform/vhci_hcd.0/attach";

/// A setup packet.
#[derive(Clone, Copy, Debug)]
struct Setup {
    request_type: u8,
    request: u8,
    value: u16,
    index: u16,
}

impl Setup {
    fn new(bytes: [u8; 8]) -> Self {
        let [request_type, request, v0, v1, i0, i1, _, _] = bytes;
        Self {
            request_type,
            request,
            value: u16::from_le_bytes([v0, v1]),
            index: u16::from_le_bytes([i0, i1]),
        }
    }

    fn interface(self) -> u8 {
        self.index.to_le_bytes()[0]
    }

    fn entity(self) -> u8 {
        self.index.to_le_bytes()[1]
    }

    fn selector(self) -> u8 {
        self.value.to_le_bytes()[1]
    }
}

/// `bmRequestType` values.
mod request_type {
    pub(super) const TO_DEVICE: u8 = 0x00;
    pub(super) const TO_INTERFACE: u8 = 0x01;
    pub(super) const TO_ENDPOINT: u8 = 0x02;
    pub(super) const CLASS_TO_INTERFACE: u8 = 0x21;
    pub(super) const FROM_DEVICE: u8 = 0x80;
    pub(super) const FROM_INTERFACE: u8 = 0x81;
    pub(super) const FROM_ENDPOINT: u8 = 0x82;
    pub(super) const CLASS_FROM_INTERFACE: u8 = 0xa1;
}

/// Standard requests (`bRequest`).
mod standard {
    pub(super) const GET_STATUS: u8 = 0;
    pub(super) const CLEAR_FEATURE: u8 = 1;
    pub(super) const GET_DESCRIPTOR: u8 = 6;
    pub(super) const GET_CONFIGURATION: u8 = 8;
    pub(super) const SET_CONFIGURATION: u8 = 9;
    pub(super) const GET_INTERFACE: u8 = 10;
    pub(super) const SET_INTERFACE: u8 = 11;
}

/// A stream's negotiation.
struct StreamControl {
    place: StreamPlace,
    feed: Arc<Feed>,
    pixels: Pixels,
    modes: Vec<Mode>,
    probed: usize,
    committed: usize,
}

impl StreamControl {
    const PROBE: u8 = 1;
    const COMMIT: u8 = 2;
    /// Bytes of the probe and commit controls in UVC 1.00.
    const LENGTH: usize = 26;

    fn get(&self, what: u8) -> Option<Vec<u8>> {
        match what {
            request::GET_LEN => Some(vec![Self::LENGTH as u8, 0]),
            request::GET_INFO => Some(vec![3]),
            request::GET_CUR | request::GET_MIN | request::GET_MAX | request::GET_DEF => {
                let mode = *self.modes.get(self.probed)?;
                let bytes = descriptors::Bytes::default()
                    .raw(&[1, 0, 1, self.probed as u8 + 1])
                    .u32(mode.interval_100ns())
                    .raw(&[0; 10])
                    .u32(mode.image_bytes(self.pixels))
                    .u32(PAYLOAD_BYTES)
                    .finish();
                Some(bytes)
            }
            _ => None,
        }
    }

    /// `None` = stall: no such mode, or a camera that refuses to start.
    fn set(&mut self, selector: u8, data: &[u8]) -> Option<()> {
        if data.len() != Self::LENGTH || data[2] != 1 {
            return None;
        }
        let index = usize::from(data[3]).checked_sub(1)?;
        self.modes.get(index)?;
        match selector {
            Self::PROBE => self.probed = index,
            Self::COMMIT if self.feed.takes_start() => self.committed = index,
            _ => return None,
        }
        Some(())
    }
}

/// Controls of one camera function.
struct FunctionControl {
    interface: u8,
    panel: ControlPanel,
    monitor: Option<HardwareMonitor>,
}

/// Everything that answers control requests.
struct ControlEndpoint {
    descriptors: Descriptors,
    is_pedal: bool,
    functions: Vec<FunctionControl>,
    streams: Vec<StreamControl>,
    link: Arc<Link>,
}

impl ControlEndpoint {
    fn new(profile: &Profile, feeds: &[Arc<Feed>], link: Arc<Link>) -> Self {
        let mut feeds = feeds.iter();
        let mut functions = Vec::new();
        let mut streams = Vec::new();
        if let Class::Camera(cameras) = &profile.class {
            for (function, places) in cameras.iter().zip(descriptors::places(cameras)) {
                functions.push(FunctionControl {
                    interface: places[0].control_interface,
                    panel: ControlPanel::new(function.controls.clone()),
                    monitor: function.has_hardware_monitor.then(HardwareMonitor::new),
                });
                let streams_of = function.streams.iter().zip(places);
                for ((stream, place), feed) in streams_of.zip(&mut feeds) {
                    streams.push(StreamControl {
                        place,
                        feed: feed.clone(),
                        pixels: stream.pixels,
                        modes: stream.modes.clone(),
                        probed: 0,
                        committed: 0,
                    });
                }
            }
        }
        Self {
            descriptors: Descriptors::new(profile),
            is_pedal: matches!(profile.class, Class::Pedal),
            functions,
            streams,
            link,
        }
    }

    /// The data of a read, nothing for a write, `None` = stall.
    fn answer(&mut self, submit: &Submit) -> Option<Vec<u8>> {
        let setup = Setup::new(submit.setup);
        match (setup.request_type, setup.request) {
            (
                request_type::FROM_DEVICE | request_type::FROM_INTERFACE,
                standard::GET_DESCRIPTOR,
            ) => self.descriptors.get(setup.value),
            (
                request_type::FROM_DEVICE
                | request_type::FROM_INTERFACE
                | request_type::FROM_ENDPOINT,
                standard::GET_STATUS,
            ) => Some(vec![0, 0]),
            (request_type::FROM_DEVICE, standard::GET_CONFIGURATION) => Some(vec![1]),
            (request_type::FROM_INTERFACE, standard::GET_INTERFACE) => Some(vec![0]),
            (request_type::TO_DEVICE, standard::SET_CONFIGURATION)
            | (request_type::TO_ENDPOINT, standard::CLEAR_FEATURE) => Some(Vec::new()),
            (request_type::TO_INTERFACE, standard::SET_INTERFACE) => {
                self.set_interface(setup.interface(), setup.value)
            }
            (request_type::CLASS_TO_INTERFACE, _) if self.is_pedal => Some(Vec::new()),
            (request_type::CLASS_TO_INTERFACE, request::SET_CUR) => {
                self.set_cur(setup, &submit.data).map(|()| Vec::new())
            }
            (request_type::CLASS_FROM_INTERFACE, _) => self.get_class(setup),
            _ => None,
        }
    }

    fn set_interface(&mut self, interface: u8, setting: u16) -> Option<Vec<u8>> {
        if let Some(stream) = self.streams.iter().find(|s| s.place.interface == interface) {
            match setting {
                0 => self.link.stop_stream(interface),
                1 => self
                    .link
                    .start_stream(interface, stream.modes[stream.committed]),
                _ => return None,
            }
        }
        Some(Vec::new())
    }

    fn set_cur(&mut self, setup: Setup, data: &[u8]) -> Option<()> {
        if setup.entity() == 0 {
            let stream = self
                .streams
                .iter_mut()
                .find(|s| s.place.interface == setup.interface())?;
            return stream.set(setup.selector(), data);
        }
        let function = self
            .functions
            .iter_mut()
            .find(|f| f.interface == setup.interface())?;
        let was_taken = match &mut function.monitor {
            Some(monitor) if setup.entity() == EXTENSION_UNIT => {
                setup.selector() == HardwareMonitor::SELECTOR && monitor.set(data)
            }
            _ => function.panel.set(setup.entity(), setup.selector(), data),
        };
        was_taken.then_some(())
    }

    fn get_class(&self, setup: Setup) -> Option<Vec<u8>> {
        if setup.entity() == 0 {
            return self
                .streams
                .iter()
                .find(|s| s.place.interface == setup.interface())?
                .get(setup.request);
        }
        let function = self
            .functions
            .iter()
            .find(|f| f.interface == setup.interface())?;
        match &function.monitor {
            Some(monitor) if setup.entity() == EXTENSION_UNIT => monitor.get(setup.request),
            _ => function
                .panel
                .get(setup.entity(), setup.selector(), setup.request),
        }
    }
}

/// A device in its port; pulled out when dropped.
pub(crate) struct Plugged {
    link: Arc<Link>,
    /// Reports of a pedal.
    reports: Option<Sender<Report>>,
}

impl Plugged {
    /// Plugs a device into a port of `vhci_hcd`. `feeds` are the streams of a camera in the
    /// order of its functions.
    pub(crate) fn new(profile: &Profile, port: u8, feeds: &[Arc<Feed>]) -> io::Result<Self> {
        let (ours, kernels) = UnixStream::pair()?;
        let link = Arc::new(Link::new(ours.try_clone()?));
        let control = ControlEndpoint::new(profile, feeds, link.clone());
        let mut reports = None;
        match &profile.class {
            Class::Camera(functions) => spawn_cameras(functions, feeds, &link),
            Class::Pedal => {
                let (sender, receiver) = mpsc::channel();
                let link = link.clone();
                thread::spawn(move || hid_pedal::pump(&link, &receiver));
                reports = Some(sender);
            }
        }
        thread::spawn(move || serve(ours, control));
        let plugged = Self { link, reports };
        attach(port, &kernels, &profile.class)?;
        Ok(plugged)
    }

    /// Sends reports of the pedal; nothing on a camera.
    pub(crate) fn report(&self, reports: impl IntoIterator<Item = Report>) {
        if let Some(sender) = &self.reports {
            for report in reports {
                // Fails only where the pedal is just being pulled out.
                let _ = sender.send(report);
            }
        }
    }
}

impl Drop for Plugged {
    fn drop(&mut self) {
        // Fails only where the kernel has let go already.
        let _ = self.link.unplug();
    }
}

fn spawn_cameras(functions: &[CameraFunction], feeds: &[Arc<Feed>], link: &Arc<Link>) {
    let places = descriptors::places(functions);
    for (place, feed) in places.into_iter().flatten().zip(feeds) {
        let (link, feed) = (link.clone(), feed.clone());
        thread::spawn(move || camera::pump(&link, place, &feed));
    }
}

/// Reads requests until the device is unplugged.
fn serve(mut from_host: UnixStream, mut control: ControlEndpoint) {
    let link = control.link.clone();
    loop {
        match usbip::read_request(&mut from_host) {
            Ok(Request::Submit(submit)) => {
                if let Some(submit) = link.accept(submit) {
                    let answer = control.answer(&submit);
                    link.answer_control(&submit, answer.as_deref());
                }
            }
            Ok(Request::Unlink { seq, victim }) => link.unlink(seq, victim),
            Err(error) => {
                if error.kind() != io::ErrorKind::UnexpectedEof {
                    eprintln!("usbip-cameras: a device lost its host: {error}");
                }
                // Fails only where the plug has been pulled already.
                let _ = link.unplug();
                return;
            }
        }
    }
}

/// Hands the socket to the kernel. A port is busy for a moment after its device was pulled out.
fn attach(port: u8, kernels: &UnixStream, class: &Class) -> io::Result<()> {
    const RETRY: Duration = Duration::from_millis(20);
    const ATTEMPTS: u32 = 100;
    let speed = match class {
        Class::Camera(_) => 3,
        Class::Pedal => 2,
    };
    let device_id = 0x1_0001 + u32::from(port);
    let line = format!("{port} {} {device_id} {speed}", kernels.as_raw_fd());
    let mut outcome = fs::write(VHCI_ATTACH, &line);
    for _ in 1..ATTEMPTS {
        match &outcome {
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => {
                thread::sleep(RETRY);
                outcome = fs::write(VHCI_ATTACH, &line);
            }
            _ => break,
        }
    }
    outcome
        .map_err(|error| io::Error::new(error.kind(), format!("{VHCI_ATTACH}: `{line}`: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feed::Images;
    use crate::profile;

    fn endpoint(device: usize) -> ControlEndpoint {
        let (ours, _) = UnixStream::pair().unwrap();
        let feed = || Arc::new(Feed::new(Images::Drawn(Pixels::Z16)));
        let feeds = [feed(), feed(), feed()];
        ControlEndpoint::new(&profile::rig()[device], &feeds, Arc::new(Link::new(ours)))
    }

    fn control(setup: [u8; 8], data: &[u8]) -> Submit {
        Submit {
            seq: 1,
            endpoint: 0,
            is_in: setup[0] & 0x80 != 0,
            length: data.len() as u32,
            setup,
            data: data.to_vec(),
            packets: Vec::new(),
        }
    }

    #[test]
    fn second_depth_mode_is_negotiated_and_started() {
        let mut d435 = endpoint(2);
        let mut wanted = vec![0; 26];
        wanted[2] = 1;
        wanted[3] = 2;
        for selector in [1, 2] {
            let set = control([0x21, 1, 0, selector, 1, 0, 26, 0], &wanted);
            assert_eq!(d435.answer(&set), Some(Vec::new()));
        }
        let get = control([0xa1, 0x81, 0, 1, 1, 0, 26, 0], &[]);
        let found = d435.answer(&get).unwrap();
        assert_eq!(found.len(), 26);
        assert_eq!(found[18..22], (1280_u32 * 720 * 2).to_le_bytes());

        assert!(
            d435.answer(&control([1, 11, 1, 0, 1, 0, 0, 0], &[]))
                .is_some()
        );
        assert_eq!(d435.link.wait_for_stream(1).unwrap().mode.width, 1280);
    }

    #[test]
    fn unknown_requests_and_modes_stall() {
        let mut mini = endpoint(0);
        let mut wanted = vec![0; 26];
        wanted[2] = 1;
        wanted[3] = 2;
        assert_eq!(
            mini.answer(&control([0x21, 1, 0, 1, 1, 0, 26, 0], &wanted)),
            None
        );
        assert_eq!(
            mini.answer(&control([0xc0, 1, 0, 0, 0, 0, 0, 0], &[])),
            None
        );
        assert_eq!(mini.answer(&control([1, 11, 7, 0, 1, 0, 0, 0], &[])), None);
    }

    #[test]
    fn hardware_monitor_is_only_on_depth_function() {
        let mut d435 = endpoint(2);
        let length = |interface: u8| control([0xa1, 0x85, 0, 1, interface, 3, 2, 0], &[]);
        assert_eq!(d435.answer(&length(0)), Some(vec![0, 4]));
        assert_eq!(d435.answer(&length(3)), None);
    }
}
