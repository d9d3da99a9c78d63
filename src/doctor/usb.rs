//! Connected cameras, their link speeds and permissions.

use std::collections::BTreeMap;

use super::{CheckStatus, Finding};
use gripcast_base::error::Result;
use gripcast_capture::calibration::{CameraConfig, RigFile};
use gripcast_capture::camera::KernelNodes;
use gripcast_capture::device::{
    Access, CameraBinder, SystemRoot, VideoDevice, crowded_buses, indistinct_cameras,
    permission_error, probe, scan,
};
use gripcast_imaging::PixelFormat;

/// Fraction of a link available to isochronous transfers (USB 2.0, 5.6.4).
const ISOCHRONOUS_FRACTION: f64 = 0.8;

/// Lists the connected cameras with their modes.
///
/// # Errors
/// If the device descriptions of the kernel cannot be read.
pub(crate) fn connected_cameras(root: &SystemRoot) -> Result<Vec<VideoDevice>> {
    let mut devices = scan(root)?;
    for device in &mut devices {
        probe(device, &KernelNodes, root);
    }
    devices.retain(VideoDevice::is_camera);
    Ok(devices)
}

/// Describes each USB 2 bus shared by several cameras.
pub(crate) fn shared_buses(devices: &[VideoDevice]) -> Vec<String> {
    crowded_buses(devices)
        .iter()
        .map(|(bus, on_bus)| {
            let names: Vec<String> = on_bus.iter().map(ToString::to_string).collect();
            format!(
                "{} cameras share USB bus {bus}, whose bandwidth may be insufficient: {}",
                on_bus.len(),
                names.join("; ")
            )
        })
        .collect()
}

/// Describes each group of cameras that only their ports distinguish.
pub(crate) fn repeated_serials(devices: &[VideoDevice]) -> Vec<String> {
    let groups = indistinct_cameras(devices);
    groups.iter().map(|cameras| indistinct(cameras)).collect()
}

fn indistinct(cameras: &[&VideoDevice]) -> String {
    let ports: Vec<&str> = cameras.iter().map(|camera| camera.port.as_str()).collect();
    let first = cameras.first();
    let product = first.map_or("", |camera| camera.product.as_str());
    let serial = match first.map_or("", |camera| camera.serial.as_str()) {
        "" => "no serial number".to_owned(),
        serial => format!("the serial number {serial}"),
    };
    format!(
        "{} cameras ({product}) have {serial}: only their ports {} distinguish them",
        cameras.len(),
        ports.join(", ")
    )
}

/// Warns of cameras that only their ports distinguish, unless the rig file names those ports.
fn repeated_serial_findings(rig: Option<&RigFile>, devices: &[VideoDevice]) -> Vec<Finding> {
    let has_port = |device: &VideoDevice| {
        let mut cameras = rig.iter().flat_map(|rig| rig.cameras.values());
        cameras.any(|camera| camera.port.as_ref() == Some(&device.port))
    };
    indistinct_cameras(devices)
        .iter()
        .map(|cameras| {
            let finding = Finding::new("usb", "serials", CheckStatus::Ok, indistinct(cameras));
            if cameras.iter().all(|camera| has_port(camera)) {
                return finding;
            }
            finding.warn(
                "give each of them its `port` in the rig file and keep it there; `gripcast rig \
                 init` writes the ports",
            )
        })
        .collect()
}

/// Describes whether a camera can be opened.
pub(crate) fn access_text(access: &Access) -> String {
    match access {
        Access::Unknown => "not checked".to_owned(),
        Access::Open => "ready".to_owned(),
        Access::Denied => "no permission".to_owned(),
        Access::Missing => "no device node".to_owned(),
        Access::Busy(None) => "in use".to_owned(),
        Access::Busy(Some(owner)) => format!("in use by {owner}"),
        Access::Failed(reason) => reason.clone(),
    }
}

/// Checks access to all cameras and the bandwidth required by the rig.
pub(super) fn findings(root: &SystemRoot, rig: Option<&RigFile>) -> Vec<Finding> {
    let devices = match connected_cameras(root) {
        Ok(devices) => devices,
        Err(error) => return vec![Finding::failed("usb", "cameras", &error)],
    };
    if devices.is_empty() {
        let found = "no camera is connected";
        // A rig with real cameras fails in its own check.
        return vec![Finding::new("usb", "cameras", CheckStatus::Ok, found)];
    }
    let mut findings: Vec<Finding> = devices.iter().map(access).collect();
    for sentence in shared_buses(&devices) {
        findings.push(
            Finding::new("usb", "bandwidth", CheckStatus::Warn, sentence)
                .remedy("connect one of them to another USB controller; another hub does not help"),
        );
    }
    findings.extend(repeated_serial_findings(rig, &devices));
    if let Some(rig) = rig {
        findings.extend(overload(rig, &devices));
    }
    findings
}

fn access(device: &VideoDevice) -> Finding {
    let speed = device.speed_mbps;
    let link = speed.map_or(String::new(), |speed| format!(", {speed} Mbit/s"));
    let found = format!("{device}{link}: {}", access_text(&device.access));
    let name = device.node.display().to_string();
    let mut finding = Finding::new("usb", name, CheckStatus::Ok, found);
    if let Some(speed) = speed {
        finding = finding.measurement("speed_mbps", f64::from(speed));
    }
    let denied;
    let remedy = match &device.access {
        Access::Open => return finding,
        Access::Denied => {
            denied = permission_error(device, "open");
            denied.remedy_text().unwrap_or_default()
        }
        Access::Busy(_) => "stop the program that uses it",
        Access::Unknown | Access::Missing | Access::Failed(_) => {
            "replug it; see `sudo dmesg` for kernel messages"
        }
    };
    finding.status = CheckStatus::Fail;
    finding.remedy(remedy)
}

/// Returns the bit rate of a camera's raw images, Mbit/s; `None` for compressed ones.
fn raw_mbps(camera: &CameraConfig) -> Option<f64> {
    let bytes = match camera.format {
        PixelFormat::Yuyv | PixelFormat::Z16 => 2.0,
        PixelFormat::Grey => 1.0,
        PixelFormat::Rgb => 3.0,
        PixelFormat::Mjpg => return None,
    };
    let pixels = f64::from(camera.width) * f64::from(camera.height);
    Some(8e-6 * bytes * pixels * camera.fps)
}

/// Finds links with less bandwidth than the raw images of their cameras.
fn overload(rig: &RigFile, devices: &[VideoDevice]) -> Vec<Finding> {
    let mut links: BTreeMap<&str, (f64, u32, Vec<String>)> = BTreeMap::new();
    let binder = CameraBinder::new(&rig.cameras);
    for (role, camera) in &rig.cameras {
        let (Ok(device), Some(mbps)) = (binder.bind(*role, devices), raw_mbps(camera)) else {
            continue;
        };
        let Some(speed) = device.speed_mbps else {
            continue;
        };
        let link = links
            .entry(&device.port)
            .or_insert((0.0, speed, Vec::new()));
        link.0 += mbps;
        link.2.push(role.name().to_owned());
    }
    let finding = |(mbps, speed, roles): (f64, u32, Vec<String>)| {
        let available = ISOCHRONOUS_FRACTION * f64::from(speed);
        (mbps > available).then(|| {
            let found = format!(
                "{} need {mbps:.0} Mbit/s, the link provides {available:.0}",
                roles.join(" and ")
            );
            Finding::new("usb", "link", CheckStatus::Fail, found)
                .measurement("required_mbps", mbps)
                .measurement("available_mbps", available)
                .remedy(
                    "use a USB 3 cable and port (blue, or marked SS), or set fewer or smaller \
                     frames in the rig file",
                )
        })
    };
    links.into_values().filter_map(finding).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_capture::calibration::SourceKind;
    use gripcast_imaging::Role;
    use gripcast_testing::sysfs_tree::{Tree, Usb, d435, mini};

    /// Checks a D435 on a link of this speed with a rig that uses both of its images.
    fn verdicts(speed_mbps: &str, [width, height]: [u32; 2]) -> Vec<Finding> {
        let mut tree = Tree::new();
        let d435 = Usb {
            speed: speed_mbps,
            ..d435("4-1")
        };
        tree.plug(d435, &[(0, 2), (3, 2)]);
        let root = SystemRoot {
            sys: tree.path("sys"),
            dev: tree.path("dev"),
            proc: tree.path("proc"),
        };
        let devices = scan(&root).unwrap();
        let camera = |format, interface| CameraConfig {
            product: "Intel(R) RealSense(TM) Depth Camera 435".to_owned(),
            interface: Some(interface),
            ..CameraConfig::new(SourceKind::V4l2, format, width, height, 30.0)
        };
        let mut rig = RigFile::virtual_rig();
        rig.cameras = BTreeMap::from([
            (Role::Depth, camera(PixelFormat::Z16, 0)),
            (Role::Rgb, camera(PixelFormat::Yuyv, 3)),
        ]);
        overload(&rig, &devices)
    }

    #[test]
    fn d435_on_usb_2_cable_is_reported() {
        let found = verdicts("480", [1280, 720]);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].status, CheckStatus::Fail);
        let text = &found[0].message;
        assert!(text.contains("rgb and depth need 885 Mbit/s"), "{text}");
        assert!(text.contains("provides 384"), "{text}");
        assert!(verdicts("5000", [1280, 720]).is_empty());
        assert!(verdicts("480", [424, 240]).is_empty());
    }

    #[test]
    fn repeated_serials_are_reported_until_the_rig_names_the_ports() {
        let mut tree = Tree::new();
        for port in ["3-1", "3-2"] {
            tree.plug(mini(port, "Tactile Cam", "200901010001"), &[(0, 2)]);
        }
        tree.plug(mini("3-3", "Tactile Cam", "200901010002"), &[(0, 2)]);
        let root = SystemRoot {
            sys: tree.path("sys"),
            dev: tree.path("dev"),
            proc: tree.path("proc"),
        };
        let devices = scan(&root).unwrap();
        let found = repeated_serial_findings(None, &devices);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].status, CheckStatus::Warn);
        assert_eq!(
            found[0].message,
            "2 cameras (Tactile Cam) have the serial number 200901010001: only their ports 3-1, \
             3-2 distinguish them"
        );
        let mut rig = RigFile::virtual_rig();
        let mut name_port = |role, port: &str| {
            if let Some(camera) = rig.cameras.get_mut(&role) {
                camera.port = Some(port.to_owned());
            }
            repeated_serial_findings(Some(&rig), &devices)[0].status
        };
        assert_eq!(name_port(Role::Left, "3-1"), CheckStatus::Warn);
        assert_eq!(name_port(Role::Right, "3-2"), CheckStatus::Ok);
    }
}
