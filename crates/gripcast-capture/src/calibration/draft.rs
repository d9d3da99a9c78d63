//! Drafts a rig file from the connected cameras.

use std::fmt::Write as _;

use super::rig_file::RigFile;
use crate::device::{Mode, VideoDevice, device_error, serial_key};
use gripcast_base::error::Result;
use gripcast_imaging::{PixelFormat, Role};

const MINI: &str = "GelSight Mini";
const REALSENSE: &str = "RealSense";

/// Controls with fixed exposure, white balance and gain for a GelSight Mini.
const MINI_CONTROLS: &str = "{ auto_exposure = 1, exposure_time_absolute = 180, \
     exposure_dynamic_framerate = 0, white_balance_automatic = 0, \
     white_balance_temperature = 4500, gain = 0, power_line_frequency = 0, brightness = 0, \
     contrast = 32, saturation = 64, hue = 0, gamma = 140, sharpness = 3, \
     backlight_compensation = 0 }";

/// A proposed rig file.
#[derive(Clone, Debug)]
pub struct Draft {
    /// Text of the file.
    pub text: String,
    /// Notes for the user.
    pub notes: Vec<String>,
}

/// Preferred mode of a role: sizes by preference, rate in 1/s.
struct ModePreference {
    format: PixelFormat,
    sizes: &'static [(u32, u32)],
    fps: f64,
}

const TACTILE: ModePreference = ModePreference {
    format: PixelFormat::Mjpg,
    sizes: &[(3280, 2464)],
    fps: 25.0,
};
const COLOUR: ModePreference = ModePreference {
    format: PixelFormat::Yuyv,
    sizes: &[(1280, 720), (640, 480)],
    fps: 30.0,
};
const DEPTH: ModePreference = ModePreference {
    format: PixelFormat::Z16,
    sizes: &[(640, 480), (848, 480)],
    fps: 30.0,
};

impl ModePreference {
    /// The best supported mode: a preferred size, else the largest; the preferred rate, else the
    /// highest. The preference itself for unknown modes.
    fn select(&self, device: &VideoDevice) -> (u32, u32, f64) {
        let supported: Vec<&Mode> = device
            .modes
            .iter()
            .flatten()
            .filter(|mode| mode.fourcc == self.format.fourcc())
            .collect();
        let preferred = self
            .sizes
            .iter()
            .find_map(|&size| supported.iter().find(|m| (m.width, m.height) == size));
        let largest = supported
            .iter()
            .max_by_key(|m| u64::from(m.width) * u64::from(m.height));
        match preferred.or(largest) {
            Some(mode) => {
                let preferred = mode.fps.iter().find(|fps| (*fps - self.fps).abs() < 0.5);
                let highest = mode.fps.iter().copied().reduce(f64::max);
                let fps = preferred.copied().or(highest).unwrap_or(self.fps);
                (mode.width, mode.height, fps)
            }
            None => (self.sizes[0].0, self.sizes[0].1, self.fps),
        }
    }
}

/// Drafts a rig: two GelSight Minis as left and right in the order of their USB ports, a RealSense
/// as colour and depth.
///
/// # Errors
/// `Device` unless exactly two Minis are connected, `Config` for an
/// invalid `id`.
pub fn draft(id: &str, devices: &[VideoDevice]) -> Result<Draft> {
    let mut cameras: Vec<&VideoDevice> = devices.iter().filter(|d| d.is_camera()).collect();
    cameras.sort_by(|a, b| a.port_order(b));
    let minis: Vec<&VideoDevice> = cameras
        .iter()
        .copied()
        .filter(|d| d.product.starts_with(MINI) && d.index == 0)
        .collect();
    let [left, right] = minis.as_slice() else {
        let mut names: Vec<String> = cameras.iter().map(ToString::to_string).collect();
        if names.is_empty() {
            names.push("none".to_owned());
        }
        return Err(device_error(format!(
            "a rig needs two {MINI} sensors, {} found; connected cameras: {}",
            minis.len(),
            names.join("; ")
        ))
        .remedy("plug in exactly the two sensors of the gripper; `gripcast rig list` lists all"));
    };
    let same_serial = serial_key(&left.serial) == serial_key(&right.serial);
    let key = if same_serial { "port" } else { "serial" };
    let mut notes = vec![format!(
        "left is in port {}, right in port {}: touch the left gel and swap the two `{key}` lines \
         if the other image changes",
        left.port, right.port
    )];
    let mut text = format!("schema = 1\nid = {}\n", quoted(id));
    for (role, device) in [(Role::Left, *left), (Role::Right, *right)] {
        section(&mut text, role, MINI, device, &TACTILE, same_serial);
        line(&mut text, "crop_profile", &quoted("gsmini-seventh-v1"));
        line(&mut text, "controls", MINI_CONTROLS);
    }
    if same_serial {
        notes.push(
            "the two sensors have the same serial number or none: they are distinguished by port \
             and must stay in their ports"
                .to_owned(),
        );
    }
    realsense(&mut text, &cameras, &mut notes);
    RigFile::parse(&text)?;
    Ok(Draft { text, notes })
}

fn realsense(text: &mut String, cameras: &[&VideoDevice], notes: &mut Vec<String>) {
    let devices: Vec<&VideoDevice> = cameras
        .iter()
        .copied()
        .filter(|d| d.product.contains(REALSENSE))
        .collect();
    let Some(first) = devices.first() else {
        notes.push("no RealSense camera found: the rig has no colour and no depth".to_owned());
        return;
    };
    if devices.iter().any(|d| d.port != first.port) {
        notes.push(format!(
            "several RealSense cameras found; the one in port {} is used",
            first.port
        ));
    }
    let find = |format, interface| {
        let mut own = devices.iter().filter(|d| d.port == first.port);
        own.clone()
            .find(|d| d.offers(format) == Some(true))
            .or_else(|| own.find(|d| d.modes.is_none() && d.interface == interface))
    };
    match find(PixelFormat::Yuyv, 3) {
        Some(device) => {
            section(text, Role::Rgb, &device.product, device, &COLOUR, false);
            text.push_str("# 1: mains of 50 Hz, 2: 60 Hz\n");
            line(text, "controls", "{ power_line_frequency = 1 }");
        }
        None => notes.push(format!("{first} does not support colour images (YUYV)")),
    }
    match find(PixelFormat::Z16, 0) {
        Some(device) => {
            section(text, Role::Depth, &device.product, device, &DEPTH, false);
            line(text, "depth_unit_m", "0.001");
        }
        None => notes.push(format!("{first} does not support depth (Z16)")),
    }
}

fn section(
    text: &mut String,
    role: Role,
    product: &str,
    device: &VideoDevice,
    preference: &ModePreference,
    by_port: bool,
) {
    let (width, height, fps) = preference.select(device);
    text.push_str(&format!("\n[cameras.{role}]\n"));
    line(text, "product", &quoted(product));
    if !device.serial.is_empty() {
        line(text, "serial", &quoted(&device.serial));
    }
    if by_port || serial_key(&device.serial).is_none() {
        line(text, "port", &quoted(&device.port));
    }
    if product.contains(REALSENSE) {
        line(text, "interface", &device.interface.to_string());
    }
    line(text, "format", &quoted(&preference.format.to_string()));
    line(text, "width", &width.to_string());
    line(text, "height", &height.to_string());
    line(text, "fps", &fps.to_string());
}

fn line(text: &mut String, key: &str, value: &str) {
    // Writing to a string cannot fail.
    writeln!(text, "{key} = {value}").ok();
}

fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    use crate::camera::{FakeCamera, FakeNodes};
    use crate::device::{CameraBinder, SystemRoot, probe, scan};
    use gripcast_testing::sysfs_tree::{Tree, Usb, d435, mini};

    fn devices(usbs: &[Usb<'_>], with_d435: bool) -> Vec<VideoDevice> {
        let mut tree = Tree::new();
        let nodes = FakeNodes::default();
        for usb in usbs {
            let first = tree.plug(*usb, &[(0, 2)]);
            nodes.insert(tree.node(first), FakeCamera::default());
            nodes.insert(tree.node(first + 1), FakeCamera::metadata());
        }
        if with_d435 {
            let first = tree.plug(d435("4-1"), &[(0, 1), (2, 1)]);
            let depth = [(*b"Z16 ", 640, 480, vec![90, 30])];
            let colour = [
                (*b"YUYV", 640, 480, vec![30]),
                (*b"YUYV", 1280, 720, vec![15, 6]),
            ];
            nodes.insert(tree.node(first), FakeCamera::with_modes(&depth));
            nodes.insert(tree.node(first + 1), FakeCamera::with_modes(&colour));
        }
        let root = SystemRoot {
            sys: tree.path("sys"),
            dev: tree.path("dev"),
            proc: tree.path("proc"),
        };
        let mut devices = scan(&root).unwrap();
        for device in &mut devices {
            probe(device, &nodes, &root);
        }
        devices
    }

    const A: Usb<'static> = mini("3-10", "GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7");
    const B: Usb<'static> = mini("3-2", "GelSight Mini R0B 28F5-K4RR", "28F5K4RR");

    #[test]
    fn draft_binds_to_its_cameras() {
        let devices = devices(&[A, B], true);
        let draft = draft("bench-1", &devices).unwrap();
        let rig = RigFile::parse(&draft.text).unwrap();
        assert_eq!(rig.cameras[&Role::Left].serial.as_deref(), Some("28F5K4RR"));
        assert_eq!(
            rig.cameras[&Role::Right].serial.as_deref(),
            Some("2BNN4ZE7")
        );
        assert!(draft.notes[0].contains("left is in port 3-2, right in port 3-10"));
        let rgb = &rig.cameras[&Role::Rgb];
        assert_eq!((rgb.width, rgb.height, rgb.fps), (1280, 720, 15.0));
        assert_eq!(rgb.interface, Some(2));
        assert_eq!(rig.cameras[&Role::Depth].fps, 30.0);
        let binder = CameraBinder::new(&rig.cameras);
        for role in rig.cameras.keys() {
            binder.bind(*role, &devices).unwrap();
        }
    }

    #[test]
    fn sensors_without_distinct_serials_are_bound_by_port() {
        for serial in ["", "0001", "0000"] {
            let devices = devices(&[Usb { serial, ..A }, Usb { serial, ..B }], false);
            let draft = draft("x", &devices).unwrap();
            let rig = RigFile::parse(&draft.text).unwrap();
            assert_eq!(rig.cameras[&Role::Left].port.as_deref(), Some("3-2"));
            assert!(
                draft
                    .notes
                    .iter()
                    .any(|note| note.contains("distinguished by port"))
            );
            assert!(draft.notes[0].contains("swap the two `port` lines"));
            assert!(draft.notes.iter().any(|note| note.contains("no RealSense")));
            let binder = CameraBinder::new(&rig.cameras);
            for (role, camera) in &rig.cameras {
                let bound = binder.bind(*role, &devices).unwrap();
                assert_eq!(Some(&bound.port), camera.port.as_ref());
            }
        }
    }

    #[test]
    fn draft_requires_two_sensors() {
        for usbs in [&[][..], &[A], &[A, B, mini("3-3", "GelSight Mini", "C")]] {
            let error = draft("x", &devices(usbs, true)).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Device);
            assert!(
                error.to_string().contains(&format!("{} found", usbs.len())),
                "{error}"
            );
        }
        let error = draft("a/b", &devices(&[A, B], false)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Config);
    }
}
