//! The devices of the emulated rig: what they are called and what they offer.

use crate::control::{self, Control};

/// Layout of a stream's images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pixels {
    Mjpg,
    Yuyv,
    Z16,
    Grey,
}

/// One image size at one rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Mode {
    pub(crate) width: u16,
    pub(crate) height: u16,
    pub(crate) fps: u32,
}

impl Mode {
    /// Frame interval in the 100 ns units of the UVC specification.
    pub(crate) fn interval_100ns(self) -> u32 {
        10_000_000 / self.fps
    }

    /// Upper limit of the bytes of one image.
    pub(crate) fn image_bytes(self, pixels: Pixels) -> u32 {
        let area = u32::from(self.width) * u32::from(self.height);
        match pixels {
            Pixels::Mjpg | Pixels::Grey => area,
            Pixels::Yuyv | Pixels::Z16 => area * 2,
        }
    }
}

/// A video stream of a camera function.
#[derive(Clone, Debug)]
pub(crate) struct Stream {
    /// Name in commands, counters and the rig file.
    pub(crate) role: &'static str,
    pub(crate) pixels: Pixels,
    pub(crate) modes: Vec<Mode>,
}

/// A video-control interface with its streams.
#[derive(Clone, Debug)]
pub(crate) struct CameraFunction {
    pub(crate) controls: Vec<Control>,
    /// Offers the hardware monitor of RealSense cameras as an extension unit.
    pub(crate) has_hardware_monitor: bool,
    pub(crate) streams: Vec<Stream>,
}

/// What a device does.
#[derive(Clone, Debug)]
pub(crate) enum Class {
    Camera(Vec<CameraFunction>),
    Pedal,
}

/// One USB device.
#[derive(Clone, Debug)]
pub(crate) struct Profile {
    pub(crate) vendor_id: u16,
    pub(crate) product_id: u16,
    pub(crate) manufacturer: &'static str,
    pub(crate) product: String,
    pub(crate) serial: &'static str,
    pub(crate) class: Class,
}

fn gelsight_mini(role: &'static str, unit: &str, serial: &'static str) -> Profile {
    Profile {
        vendor_id: 0x0c45,
        product_id: 0x636d,
        manufacturer: "Arducam Technology Co., Ltd.",
        product: format!("GelSight Mini R0B {unit}"),
        serial,
        class: Class::Camera(vec![CameraFunction {
            controls: control::gelsight_mini(),
            has_hardware_monitor: false,
            streams: vec![Stream {
                role,
                pixels: Pixels::Mjpg,
                modes: vec![Mode {
                    width: 3280,
                    height: 2464,
                    fps: 25,
                }],
            }],
        }]),
    }
}

fn realsense_d435() -> Profile {
    let modes = [(640, 480), (1280, 720)].map(|(width, height)| Mode {
        width,
        height,
        fps: 30,
    });
    let stream = |role, pixels| Stream {
        role,
        pixels,
        modes: modes.to_vec(),
    };
    Profile {
        vendor_id: 0x8086,
        product_id: 0x0b07,
        manufacturer: "Intel(R) RealSense(TM) Depth Camera 435",
        product: "Intel(R) RealSense(TM) Depth Camera 435".into(),
        serial: "814412070123",
        class: Class::Camera(vec![
            CameraFunction {
                controls: control::realsense_depth(),
                has_hardware_monitor: true,
                streams: vec![
                    stream("depth", Pixels::Z16),
                    stream("infrared", Pixels::Grey),
                ],
            },
            CameraFunction {
                controls: control::realsense_colour(),
                has_hardware_monitor: false,
                streams: vec![stream("rgb", Pixels::Yuyv)],
            },
        ]),
    }
}

fn pedal() -> Profile {
    Profile {
        vendor_id: 0x3553,
        product_id: 0xb001,
        manufacturer: "PCsensor",
        product: "FootSwitch".into(),
        serial: "",
        class: Class::Pedal,
    }
}

/// Number of devices of the rig.
pub(crate) const DEVICES: usize = 4;
/// Index of the pedal.
pub(crate) const PEDAL: usize = 3;
/// Names of the devices in commands.
pub(crate) const NAMES: [&str; DEVICES] = ["left", "right", "d435", "pedal"];

/// Serial number of many cheap cameras.
pub(crate) const TWIN_SERIAL: &str = "200901010001";

/// Gives both tactile sensors one serial number.
pub(crate) fn make_twins(profiles: &mut [Profile; DEVICES]) {
    let [left, right, ..] = profiles;
    left.serial = TWIN_SERIAL;
    right.serial = TWIN_SERIAL;
}

/// The devices in the order of [`NAMES`].
pub(crate) fn rig() -> [Profile; DEVICES] {
    [
        gelsight_mini("left", "2BNN-4ZE7", "2BNN4ZE7"),
        gelsight_mini("right", "28F5-K4RR", "28F5K4RR"),
        realsense_d435(),
        pedal(),
    ]
}
