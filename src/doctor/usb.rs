//! What is plugged in, at which speed, and whether it may be opened.

use std::collections::BTreeMap;

use super::{Finding, Verdict};
use gripcast_base::error::Result;
use gripcast_capture::calibration::{CameraConfig, RigFile, SourceKind};
use gripcast_capture::camera::KernelNodes;
use gripcast_capture::device::{
    Access, SystemRoot, VideoDevice, bind, crowded_buses, permission_error, probe, scan,
};
use gripcast_imaging::PixelFormat;

/// Fraction of a link that isochronous transfers may reserve (USB 2.0, 5.6.4).
const RESERVABLE: f64 = 0.8;

/// The cameras that are plugged in, each asked for its modes.
///
/// # Errors
/// When the kernel's descriptions cannot be read.
pub(crate) fn plugged_cameras(root: &SystemRoot) -> Result<Vec<VideoDevice>> {
    let mut devices = scan(root)?;
    for device in &mut devices {
        probe(device, &KernelNodes, root);
    }
    devices.retain(VideoDevice::is_camera);
    Ok(devices)
}

/// One sentence for each USB-2 bus that several cameras share.
pub(crate) fn crowding(devices: &[VideoDevice]) -> Vec<String> {
    crowded_buses(devices)
        .iter()
        .map(|(bus, on_bus)| {
            let names: Vec<String> = on_bus.iter().map(ToString::to_string).collect();
            format!(
                "{} cameras share USB bus {bus}, which may be too little for all: {}",
                on_bus.len(),
                names.join("; ")
            )
        })
        .collect()
}

/// Whether a camera can be opened, in words.
pub(crate) fn access_text(access: &Access) -> String {
    match access {
        Access::Unknown => "not tried".to_owned(),
        Access::Open => "ready".to_owned(),
        Access::Denied => "no permission".to_owned(),
        Access::Missing => "no device node".to_owned(),
        Access::Busy(None) => "in use".to_owned(),
        Access::Busy(Some(owner)) => format!("in use by {owner}"),
        Access::Failed(reason) => reason.clone(),
    }
}

/// All cameras, and what the cameras of the rig ask of their links.
pub(super) fn findings(root: &SystemRoot, rig: Option<&RigFile>) -> Vec<Finding> {
    let devices = match plugged_cameras(root) {
        Ok(devices) => devices,
        Err(error) => return vec![Finding::failed("usb", "cameras", &error)],
    };
    if devices.is_empty() {
        let found = "no camera is plugged in";
        // The check of a rig with real cameras fails on its own.
        return vec![Finding::new("usb", "cameras", Verdict::Ok, found)];
    }
    let mut findings: Vec<Finding> = devices.iter().map(access).collect();
    for sentence in crowding(&devices) {
        findings.push(Finding::new("usb", "bandwidth", Verdict::Warn, sentence).remedy(
            "plug one of them into a port of another USB controller; a second hub does not help",
        ));
    }
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
    let mut finding = Finding::new("usb", name, Verdict::Ok, found);
    if let Some(speed) = speed {
        finding = finding.figure("speed_mbps", f64::from(speed));
    }
    match &device.access {
        Access::Open => finding,
        Access::Denied => {
            let error = permission_error(device, "open");
            finding.verdict = Verdict::Fail;
            finding.remedy(error.remedy_text().unwrap_or_default())
        }
        Access::Busy(_) => {
            finding.verdict = Verdict::Fail;
            finding.remedy("end the program that uses it")
        }
        Access::Unknown | Access::Missing | Access::Failed(_) => {
            finding.verdict = Verdict::Fail;
            finding
                .remedy("unplug it and plug it in again; `sudo dmesg` tells what the kernel says")
        }
    }
}

/// Bits a second of a camera's images; none where it compresses them.
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

/// Links that cannot carry the raw images that the rig asks of the cameras behind them.
fn overload(rig: &RigFile, devices: &[VideoDevice]) -> Vec<Finding> {
    let mut links: BTreeMap<&str, (f64, u32, Vec<String>)> = BTreeMap::new();
    for (role, camera) in &rig.cameras {
        let bound = (camera.source == SourceKind::V4l2).then(|| bind(*role, camera, devices));
        let (Some(Ok(device)), Some(mbps)) = (bound, raw_mbps(camera)) else {
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
    let too_much = |(mbps, speed, roles): (f64, u32, Vec<String>)| {
        let carried = RESERVABLE * f64::from(speed);
        (mbps > carried).then(|| {
            let found = format!(
                "{} send {mbps:.0} Mbit/s over a link that carries {carried:.0}",
                roles.join(" and ")
            );
            Finding::new("usb", "link", Verdict::Fail, found)
                .figure("asked_mbps", mbps)
                .figure("carried_mbps", carried)
                .remedy(
                    "use a USB 3 cable and port (blue, or marked SS), or ask for fewer or smaller \
                     frames in the rig file",
                )
        })
    };
    links.into_values().filter_map(too_much).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::Role;
    use gripcast_testing::sysfs_tree::{Tree, Usb, d435};

    /// A D435 on a link of this speed, and the rig that asks for both of its images.
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
    fn a_d435_behind_a_usb_2_cable_is_told() {
        let found = verdicts("480", [1280, 720]);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].verdict, Verdict::Fail);
        let text = &found[0].found;
        assert!(text.contains("rgb and depth send 885 Mbit/s"), "{text}");
        assert!(text.contains("carries 384"), "{text}");
        assert!(verdicts("5000", [1280, 720]).is_empty());
        assert!(verdicts("480", [424, 240]).is_empty());
    }
}
