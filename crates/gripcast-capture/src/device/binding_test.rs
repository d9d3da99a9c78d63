//! Serial numbers that several cameras have, or none has.

use std::path::PathBuf;

use super::*;
use crate::device::Access;
use gripcast_base::error::ErrorKind;
use gripcast_imaging::PixelFormat;

/// Serial number that many cheap cameras have.
const FACTORY: &str = "200901010001";
const ROLES: [Role; 3] = [Role::Left, Role::Right, Role::External];

fn plugged(number: usize, serial: &str, port: &str) -> VideoDevice {
    VideoDevice {
        node: PathBuf::from(format!("/dev/video{number}")),
        index: 0,
        name: "Tactile Cam".to_owned(),
        product: "Tactile Cam".to_owned(),
        manufacturer: String::new(),
        serial: serial.to_owned(),
        vendor_id: None,
        product_id: None,
        interface: 0,
        port: port.to_owned(),
        bus: None,
        speed_mbps: None,
        access: Access::Open,
        captures: Some(true),
        modes: None,
    }
}

fn config(serial: &str, port: Option<&str>) -> CameraConfig {
    CameraConfig {
        product: "Tactile Cam".to_owned(),
        serial: (!serial.is_empty()).then(|| serial.to_owned()),
        port: port.map(str::to_owned),
        ..CameraConfig::new(SourceKind::V4l2, PixelFormat::Mjpg, 640, 480, 25.0)
    }
}

fn binder<const N: usize>(cameras: [(Role, CameraConfig); N]) -> CameraBinder {
    CameraBinder::new(&cameras.into())
}

fn twins() -> CameraBinder {
    binder([
        (Role::Left, config(FACTORY, Some("1-1"))),
        (Role::Right, config(FACTORY, Some("1-2"))),
    ])
}

fn failure(binder: &CameraBinder, role: Role, devices: &[VideoDevice]) -> String {
    let error = binder.bind(role, devices).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Device);
    assert!(error.remedy_text().is_some(), "{error}");
    error.to_string()
}

#[test]
fn unplugged_twin_is_absent_and_the_other_keeps_its_camera() {
    let devices = [plugged(0, FACTORY, "1-2")];
    let text = failure(&twins(), Role::Left, &devices);
    assert!(text.contains("no matching camera in port 1-1"), "{text}");
    assert!(text.contains("right has the same serial number"), "{text}");
    assert_eq!(twins().bind(Role::Right, &devices).unwrap().port, "1-2");
    let nowhere = [plugged(0, FACTORY, "2-4")];
    for role in [Role::Left, Role::Right] {
        failure(&twins(), role, &nowhere);
    }
}

#[test]
fn unique_serial_follows_its_camera_to_another_port() {
    let binder = binder([
        (Role::Left, config("A1", Some("1-1"))),
        (Role::Right, config("B2", Some("1-2"))),
    ]);
    let devices = [plugged(0, "A1", "1-2"), plugged(1, "B2", "2-4.3")];
    assert_eq!(binder.bind(Role::Left, &devices).unwrap().port, "1-2");
    assert_eq!(binder.bind(Role::Right, &devices).unwrap().port, "2-4.3");
}

#[test]
fn serial_seen_twice_stays_ambiguous() {
    let left = binder([(Role::Left, config(FACTORY, Some("1-1")))]);
    let stranger = plugged(1, FACTORY, "1-2");
    let both = [plugged(0, FACTORY, "1-1"), stranger.clone()];
    assert_eq!(left.bind(Role::Left, &both).unwrap().port, "1-1");
    let text = failure(&left, Role::Left, &[stranger]);
    assert!(text.contains("no matching camera in port 1-1"), "{text}");
}

#[test]
fn serial_of_zeros_is_no_serial() {
    for serial in ["0", "0000", "00-00"] {
        let left = binder([(Role::Left, config(serial, Some("1-1")))]);
        failure(&left, Role::Left, &[plugged(0, serial, "1-2")]);
        let devices = [plugged(0, serial, "1-2"), plugged(1, "", "1-1")];
        assert_eq!(left.bind(Role::Left, &devices).unwrap().port, "1-1");
    }
}

#[test]
fn twins_without_port_are_refused() {
    let binder = binder([
        (Role::Left, config(FACTORY, None)),
        (Role::Right, config(FACTORY, Some("1-2"))),
    ]);
    let devices = [plugged(0, FACTORY, "1-1"), plugged(1, FACTORY, "1-2")];
    for devices in [&devices[..], &devices[1..]] {
        let text = failure(&binder, Role::Left, devices);
        assert!(text.contains("names no `port`"), "{text}");
        assert!(text.contains("`gripcast rig init` writes them"), "{text}");
        assert_eq!(binder.bind(Role::Right, devices).unwrap().port, "1-2");
    }
}

#[test]
fn camera_of_another_role_is_not_taken() {
    let by_serial = binder([
        (Role::Left, config("", None)),
        (Role::Right, config("B2", None)),
    ]);
    let devices = [plugged(0, "B2", "1-2")];
    let text = failure(&by_serial, Role::Left, &devices);
    assert!(text.contains("is that of right"), "{text}");
    assert_eq!(by_serial.bind(Role::Right, &devices).unwrap().port, "1-2");
    // Each role takes it for its own.
    let alike = binder([
        (Role::Left, config("", None)),
        (Role::Right, config("", None)),
    ]);
    for role in [Role::Left, Role::Right] {
        failure(&alike, role, &devices);
    }
}

#[test]
fn streams_of_one_device_are_no_twins() {
    let stream = |format, interface| CameraConfig {
        format,
        interface: Some(interface),
        ..config("814412070123", Some("1-1"))
    };
    let binder = binder([
        (Role::Rgb, stream(PixelFormat::Yuyv, 3)),
        (Role::Depth, stream(PixelFormat::Z16, 0)),
    ]);
    let node = |number, interface| VideoDevice {
        interface,
        ..plugged(number, "814412070123", "2-7")
    };
    let devices = [node(0, 0), node(1, 3)];
    for (role, interface) in [(Role::Rgb, 3), (Role::Depth, 0)] {
        let bound = binder.bind(role, &devices).unwrap();
        assert_eq!(bound.interface, interface, "moved to another port");
        assert!(!binder.is_bound_by_port(role));
    }
}

/// Where each of four cameras can be: unplugged, or in one of four ports.
fn attachments() -> Vec<[Option<usize>; 4]> {
    let mut all = Vec::new();
    for code in 0..5_usize.pow(4) {
        let place = |camera: u32| (code / 5_usize.pow(camera) % 5).checked_sub(1);
        let places = [place(0), place(1), place(2), place(3)];
        let used: Vec<usize> = places.iter().flatten().copied().collect();
        let distinct: BTreeSet<usize> = used.iter().copied().collect();
        if distinct.len() == used.len() {
            all.push(places);
        }
    }
    all
}

/// All rigs of three cameras with equal, different or no serial numbers and with or without ports,
/// and all attachments of these cameras and of one that is not in the rig.
#[test]
fn no_role_gets_the_camera_of_another() {
    const PORTS: [&str; 4] = ["1-1", "1-2", "1-3", "1-4"];
    const SERIALS: [&str; 3] = ["A", "B", ""];
    let attachments = attachments();
    for code in 0..27 {
        let own = [code % 3, code / 3 % 3, code / 9].map(|i| SERIALS[i]);
        let serials = [own[0], own[1], own[2], "A"];
        for named_ports in [0b000, 0b001, 0b110, 0b111] {
            let port = |i: usize| (named_ports >> i & 1 == 1).then_some(PORTS[i]);
            let camera = |i: usize| (ROLES[i], config(own[i], port(i)));
            let rig = || binder([camera(0), camera(1), camera(2)]);
            for places in &attachments {
                let devices: Vec<VideoDevice> = (0..4)
                    .filter_map(|i| Some(plugged(i, serials[i], PORTS[places[i]?])))
                    .collect();
                let context = || format!("rig {own:?}, ports {named_ports:03b}, {places:?}");
                let bound = ROLES.map(|role| rig().bind(role, &devices).ok());
                for (i, device) in bound.iter().enumerate() {
                    let others = own.iter().enumerate().filter(|(j, _)| *j != i);
                    let in_rig = others.filter(|(_, s)| **s == own[i]).count() > 0;
                    let attached = devices.iter().filter(|d| d.serial == own[i]).count();
                    let identifies = !own[i].is_empty() && !in_rig && attached <= 1;
                    if let Some(device) = device {
                        let is_shared = bound[..i].contains(&Some(device));
                        assert!(!is_shared, "two roles on one camera: {}", context());
                        assert!(own[i].is_empty() || device.serial == own[i]);
                        let in_port = port(i) == Some(device.port.as_str());
                        let is_only = own[i].is_empty() && port(i).is_none();
                        assert!(
                            in_port || identifies || is_only,
                            "wrong twin: {}",
                            context()
                        );
                    }
                    let expected = if identifies {
                        attached == 1
                    } else {
                        // A camera in its port, which no better identified role claims.
                        !own[i].is_empty() && port(i).is_some() && places[i] == Some(i)
                    };
                    assert!(!expected || device.is_some(), "absent: {}", context());
                }
            }
        }
    }
}
