//! USB descriptors: device, configuration with UVC 1.00 camera functions or a HID keyboard,
//! strings.

use crate::control::{CAMERA_TERMINAL, Control, EXTENSION_UNIT, HardwareMonitor, PROCESSING_UNIT};
use crate::hid_pedal;
use crate::profile::{CameraFunction, Class, Mode, Pixels, Profile, Stream};

/// Bytes of an isochronous payload: three transactions of 1024 bytes a microframe.
pub(crate) const PAYLOAD_BYTES: u32 = 3 * 1024;
/// `wMaxPacketSize` of the same.
const HIGH_BANDWIDTH: u16 = 0x1400;

const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
const STRING: u8 = 3;
const HID_REPORT: u8 = 0x22;

const CLASS_VIDEO: u8 = 0x0e;
const CS_INTERFACE: u8 = 0x24;

const MANUFACTURER: u8 = 1;
const PRODUCT: u8 = 2;
const SERIAL: u8 = 3;

/// Interfaces and endpoint of one stream in the configuration descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct StreamPlace {
    /// Video-control interface of the function.
    pub(crate) control_interface: u8,
    /// Video-streaming interface.
    pub(crate) interface: u8,
    /// IN endpoint number, without the direction bit.
    pub(crate) endpoint: u8,
}

/// Numbers the interfaces and endpoints of camera functions: per function the control
/// interface, then its streams. The D435's colour function thereby starts at interface 3.
pub(crate) fn places(functions: &[CameraFunction]) -> Vec<Vec<StreamPlace>> {
    let mut interface = 0;
    let mut endpoint = 0;
    functions
        .iter()
        .map(|function| {
            let control_interface = interface;
            interface += 1;
            function
                .streams
                .iter()
                .map(|_| {
                    let place = StreamPlace {
                        control_interface,
                        interface,
                        endpoint: endpoint + 1,
                    };
                    interface += 1;
                    endpoint += 1;
                    place
                })
                .collect()
        })
        .collect()
}

/// All descriptors of a device.
#[derive(Clone, Debug)]
pub(crate) struct Descriptors {
    device: Vec<u8>,
    configuration: Vec<u8>,
    strings: [String; 3],
    is_pedal: bool,
}

impl Descriptors {
    pub(crate) fn new(profile: &Profile) -> Self {
        let (configuration, is_pedal) = match &profile.class {
            Class::Camera(functions) => (camera_configuration(functions), false),
            Class::Pedal => (hid_pedal::configuration(), true),
        };
        Self {
            device: device(profile, is_pedal),
            configuration,
            strings: [
                profile.manufacturer.to_owned(),
                profile.product.clone(),
                profile.serial.to_owned(),
            ],
            is_pedal,
        }
    }

    /// Descriptor for the `wValue` of GET_DESCRIPTOR; `None` = stall.
    pub(crate) fn get(&self, value: u16) -> Option<Vec<u8>> {
        let [index, kind] = value.to_le_bytes();
        match kind {
            DEVICE => Some(self.device.clone()),
            CONFIGURATION => Some(self.configuration.clone()),
            STRING => self.string(index),
            HID_REPORT if self.is_pedal => Some(hid_pedal::REPORT_DESCRIPTOR.to_vec()),
            _ => None,
        }
    }

    fn string(&self, index: u8) -> Option<Vec<u8>> {
        const ENGLISH_US: u16 = 0x0409;
        let units: Vec<u16> = match index {
            0 => vec![ENGLISH_US],
            _ => self
                .strings
                .get(usize::from(index) - 1)?
                .encode_utf16()
                .collect(),
        };
        let mut descriptor = vec![2 + units.len() as u8 * 2, STRING];
        descriptor.extend(units.iter().flat_map(|unit| unit.to_le_bytes()));
        Some(descriptor)
    }
}

/// Little-endian bytes in the making.
#[derive(Default)]
pub(crate) struct Bytes(Vec<u8>);

impl Bytes {
    pub(crate) fn raw(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend_from_slice(bytes);
        self
    }

    pub(crate) fn u16(&mut self, value: u16) -> &mut Self {
        self.raw(&value.to_le_bytes())
    }

    pub(crate) fn u32(&mut self, value: u32) -> &mut Self {
        self.raw(&value.to_le_bytes())
    }

    pub(crate) fn finish(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0)
    }
}

fn device(profile: &Profile, is_pedal: bool) -> Vec<u8> {
    // Interface association descriptors ask for class EF/02/01; a plain HID device says 0.
    let class = if is_pedal { [0, 0, 0] } else { [0xef, 2, 1] };
    let serial = if profile.serial.is_empty() { 0 } else { SERIAL };
    Bytes::default()
        .raw(&[18, DEVICE])
        .u16(0x0200)
        .raw(&class)
        .raw(&[64])
        .u16(profile.vendor_id)
        .u16(profile.product_id)
        .u16(0x0100)
        .raw(&[MANUFACTURER, PRODUCT, serial, 1])
        .finish()
}

/// Configuration descriptor around the descriptors of `interfaces` interfaces.
pub(crate) fn configuration(interfaces: u8, body: &[u8]) -> Vec<u8> {
    const BUS_POWERED: u8 = 0x80;
    const MILLIAMPERE_500: u8 = 250;
    Bytes::default()
        .raw(&[9, CONFIGURATION])
        .u16(9 + body.len() as u16)
        .raw(&[interfaces, 1, 0, BUS_POWERED, MILLIAMPERE_500])
        .raw(body)
        .finish()
}

fn camera_configuration(functions: &[CameraFunction]) -> Vec<u8> {
    let mut body = Bytes::default();
    let mut interfaces = 0;
    for (function, places) in functions.iter().zip(places(functions)) {
        let count = 1 + function.streams.len() as u8;
        let [association, video_control, undefined] = [11, 1, 0];
        body.raw(&[
            8,
            association,
            interfaces,
            count,
            CLASS_VIDEO,
            3,
            0,
            PRODUCT,
        ]);
        body.raw(&[
            9,
            4,
            interfaces,
            0,
            0,
            CLASS_VIDEO,
            video_control,
            undefined,
            PRODUCT,
        ]);
        body.raw(&control_interface(function, &places));
        for (index, (stream, place)) in function.streams.iter().zip(&places).enumerate() {
            body.raw(&streaming_interface(stream, *place, output_terminal(index)));
        }
        interfaces += count;
    }
    configuration(interfaces, &body.finish())
}

/// Id of the output terminal of a function's stream, after the fixed entities.
fn output_terminal(stream: usize) -> u8 {
    EXTENSION_UNIT + 1 + stream as u8
}

fn control_bits(controls: &[Control], entity: u8) -> [u8; 3] {
    let bits = controls
        .iter()
        .filter(|c| c.entity == entity)
        .fold(0_u32, |bits, c| bits | 1 << c.bit);
    let [a, b, c, _] = bits.to_le_bytes();
    [a, b, c]
}

/// Class-specific part of a video-control interface:
/// camera terminal → processing unit → (extension unit) → one output terminal a stream.
fn control_interface(function: &CameraFunction, places: &[StreamPlace]) -> Vec<u8> {
    const CAMERA: u16 = 0x0201;
    const USB_STREAMING: u16 = 0x0101;
    let mut entities = Bytes::default();
    entities
        .raw(&[18, CS_INTERFACE, 2, CAMERA_TERMINAL])
        .u16(CAMERA)
        .raw(&[0, 0])
        .raw(&[0; 6])
        .raw(&[3])
        .raw(&control_bits(&function.controls, CAMERA_TERMINAL));
    let [low, high, _] = control_bits(&function.controls, PROCESSING_UNIT);
    entities
        .raw(&[11, CS_INTERFACE, 5, PROCESSING_UNIT, CAMERA_TERMINAL])
        .u16(0)
        .raw(&[2, low, high, 0]);
    let mut last = PROCESSING_UNIT;
    if function.has_hardware_monitor {
        let selector_bit = 1 << (HardwareMonitor::SELECTOR - 1);
        entities
            .raw(&[26, CS_INTERFACE, 6, EXTENSION_UNIT])
            .raw(&HardwareMonitor::GUID)
            .raw(&[1, 1, last, 1, selector_bit, 0]);
        last = EXTENSION_UNIT;
    }
    for stream in 0..function.streams.len() {
        entities
            .raw(&[9, CS_INTERFACE, 3, output_terminal(stream)])
            .u16(USB_STREAMING)
            .raw(&[0, last, 0]);
    }
    let entities = entities.finish();
    let streams: Vec<u8> = places.iter().map(|place| place.interface).collect();
    let header = 12 + streams.len() as u16;
    Bytes::default()
        .raw(&[header as u8, CS_INTERFACE, 1])
        .u16(0x0100)
        .u16(header + entities.len() as u16)
        .u32(48_000_000)
        .raw(&[streams.len() as u8])
        .raw(&streams)
        .raw(&entities)
        .finish()
}

/// GUID of an uncompressed format: its four characters and the common tail.
fn format_guid(code: [u8; 4]) -> [u8; 16] {
    let mut guid = [
        0, 0, 0, 0, 0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71,
    ];
    guid[..4].copy_from_slice(&code);
    guid
}

fn format(stream: &Stream) -> Vec<u8> {
    let count = stream.modes.len() as u8;
    let (code, bits_per_pixel) = match stream.pixels {
        Pixels::Mjpg => return vec![11, CS_INTERFACE, 6, 1, count, 1, 1, 0, 0, 0, 0],
        Pixels::Yuyv => (*b"YUY2", 16),
        Pixels::Z16 => (*b"Z16 ", 16),
        Pixels::Grey => (*b"Y800", 8),
    };
    Bytes::default()
        .raw(&[27, CS_INTERFACE, 4, 1, count])
        .raw(&format_guid(code))
        .raw(&[bits_per_pixel, 1, 0, 0, 0, 0])
        .finish()
}

fn frame(pixels: Pixels, index: u8, mode: Mode) -> Vec<u8> {
    let subtype = if pixels == Pixels::Mjpg { 7 } else { 5 };
    let bytes = mode.image_bytes(pixels);
    let bits_per_second = bytes.saturating_mul(8).saturating_mul(mode.fps);
    Bytes::default()
        .raw(&[30, CS_INTERFACE, subtype, index, 0])
        .u16(mode.width)
        .u16(mode.height)
        .u32(bits_per_second)
        .u32(bits_per_second)
        .u32(bytes)
        .u32(mode.interval_100ns())
        .raw(&[1])
        .u32(mode.interval_100ns())
        .finish()
}

/// A video-streaming interface: setting 0 without endpoint, setting 1 with the isochronous one.
fn streaming_interface(stream: &Stream, place: StreamPlace, terminal: u8) -> Vec<u8> {
    const BT709_SRGB_BT601: [u8; 6] = [6, CS_INTERFACE, 0x0d, 1, 1, 4];
    const HEADER: u16 = 14;
    let address = 0x80 | place.endpoint;
    let mut formats = Bytes::default();
    formats.raw(&format(stream));
    for (index, mode) in (1..).zip(&stream.modes) {
        formats.raw(&frame(stream.pixels, index, *mode));
    }
    let formats = formats.raw(&BT709_SRGB_BT601).finish();
    let setting = |number: u8, endpoints: u8| {
        [
            9,
            4,
            place.interface,
            number,
            endpoints,
            CLASS_VIDEO,
            2,
            0,
            0,
        ]
    };
    Bytes::default()
        .raw(&setting(0, 0))
        .raw(&[HEADER as u8, CS_INTERFACE, 1, 1])
        .u16(HEADER + formats.len() as u16)
        .raw(&[address, 0, terminal, 0, 0, 0, 1, 0])
        .raw(&formats)
        .raw(&setting(1, 1))
        .raw(&[7, 5, address, 5])
        .u16(HIGH_BANDWIDTH)
        .raw(&[1])
        .finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile;

    /// Splits a configuration into its descriptors; fails where lengths do not add up.
    fn split(mut bytes: &[u8]) -> Vec<&[u8]> {
        let mut found = Vec::new();
        while let Some(&length) = bytes.first() {
            let (head, rest) = bytes.split_at(usize::from(length));
            found.push(head);
            bytes = rest;
        }
        found
    }

    #[test]
    fn lengths_add_up_in_every_configuration() {
        for profile in profile::rig() {
            let bytes = Descriptors::new(&profile).get(0x0200).unwrap();
            assert_eq!(
                u16::from_le_bytes([bytes[2], bytes[3]]) as usize,
                bytes.len()
            );
            let interfaces: std::collections::BTreeSet<u8> = split(&bytes)
                .into_iter()
                .filter(|d| d[1] == 4)
                .map(|d| d[2])
                .collect();
            assert_eq!(
                interfaces.len(),
                usize::from(bytes[4]),
                "{}",
                profile.product
            );
        }
    }

    #[test]
    fn colour_of_the_d435_is_on_control_interface_3() {
        let [_, _, d435, _] = profile::rig();
        let Class::Camera(functions) = &d435.class else {
            panic!("the D435 is a camera");
        };
        let places = places(functions);
        assert_eq!(
            places[1],
            [StreamPlace {
                control_interface: 3,
                interface: 4,
                endpoint: 3
            }]
        );
        let bytes = Descriptors::new(&d435).get(0x0200).unwrap();
        let control: Vec<u8> = split(&bytes)
            .into_iter()
            .filter(|d| d[1] == 4 && d[6] == 1)
            .map(|d| d[2])
            .collect();
        assert_eq!(control, [0, 3]);
    }

    #[test]
    fn strings_are_utf16_and_unknown_ones_stall() {
        let [mini, ..] = profile::rig();
        let descriptors = Descriptors::new(&mini);
        let product = descriptors.get(0x0302).unwrap();
        let units: Vec<u16> = product[2..]
            .chunks(2)
            .map(|c| u16::from_le_bytes([c[0], c[1]]))
            .collect();
        assert_eq!(
            String::from_utf16(&units).unwrap(),
            "GelSight Mini R0B 2BNN-4ZE7"
        );
        assert_eq!(usize::from(product[0]), product.len());
        assert_eq!(descriptors.get(0x0304), None);
        assert_eq!(descriptors.get(0x0600), None);
    }
}
