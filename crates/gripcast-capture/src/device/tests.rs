//! Discovery, binding and errors over fake sysfs trees.

use std::fs;
use std::io;

use super::*;
use crate::calibration::{CameraConfig, SourceKind};
use crate::camera::{FakeCamera, FakeNodes};
use gripcast_base::error::{ErrorKind, Result};
use gripcast_imaging::{PixelFormat, Role};
use gripcast_testing::sysfs_tree::{Tree, Usb, d435, mini};

const LEFT: Usb<'static> = mini("3-2.1", "GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7");
const RIGHT: Usb<'static> = mini("3-2.2", "GelSight Mini R0B 28F5-K4RR", "28F5K4RR");

fn root(tree: &Tree) -> SystemRoot {
    SystemRoot {
        sys: tree.path("sys"),
        dev: tree.path("dev"),
        proc: tree.path("proc"),
    }
}

fn config(product: &str) -> CameraConfig {
    CameraConfig {
        product: product.to_owned(),
        ..CameraConfig::new(SourceKind::V4l2, PixelFormat::Mjpg, 3280, 2464, 25.0)
    }
}

/// Binds the only camera of a rig.
fn bind(role: Role, config: &CameraConfig, devices: &[VideoDevice]) -> Result<VideoDevice> {
    let binder = CameraBinder::new(&[(role, config.clone())].into());
    binder.bind(role, devices).cloned()
}

/// Two Minis and a D435 whose stereo function has depth, metadata, infrared and metadata nodes.
fn bench() -> (Tree, FakeNodes) {
    let mut tree = Tree::new();
    let nodes = FakeNodes::default();
    for usb in [LEFT, RIGHT] {
        let first = tree.plug(usb, &[(0, 2)]);
        nodes.insert(tree.node(first), FakeCamera::default());
        nodes.insert(tree.node(first + 1), FakeCamera::metadata());
    }
    let first = tree.plug(d435("4-1"), &[(0, 4), (3, 2)]);
    let stream = |fourcc: &[u8; 4]| FakeCamera::with_modes(&[(*fourcc, 640, 480, vec![30, 15])]);
    nodes.insert(tree.node(first), stream(b"Z16 "));
    nodes.insert(tree.node(first + 1), FakeCamera::metadata());
    nodes.insert(tree.node(first + 2), stream(b"GREY"));
    nodes.insert(tree.node(first + 3), FakeCamera::metadata());
    nodes.insert(tree.node(first + 4), stream(b"YUYV"));
    nodes.insert(tree.node(first + 5), FakeCamera::metadata());
    (tree, nodes)
}

fn probed(tree: &Tree, nodes: &FakeNodes) -> Vec<VideoDevice> {
    let mut devices = scan(&root(tree)).unwrap();
    for device in &mut devices {
        probe(device, nodes, &root(tree));
    }
    devices
}

#[test]
fn scan_joins_the_node_with_its_usb_device() {
    let (tree, nodes) = bench();
    let devices = probed(&tree, &nodes);
    assert_eq!(devices.len(), 10);
    let left = &devices[0];
    assert_eq!(left.node, tree.node(0));
    assert_eq!(left.name, "GelSight Mini R0B 2BNN-4ZE7: Ge");
    assert_eq!(left.product, "GelSight Mini R0B 2BNN-4ZE7");
    assert_eq!(left.serial, "2BNN4ZE7");
    assert_eq!(
        (left.vendor_id, left.product_id),
        (Some(0x0c45), Some(0x636d))
    );
    assert_eq!(
        (left.port.as_str(), left.bus, left.speed_mbps),
        ("3-2.1", Some(3), Some(480))
    );
    assert_eq!(left.access, Access::Open);
    assert_eq!(
        left.modes.as_ref().unwrap()[0].to_string(),
        "MJPG 3280×2464 @ 25"
    );
    let cameras: Vec<u32> = (0..10)
        .filter(|&i| devices[i as usize].is_camera())
        .collect();
    assert_eq!(cameras, [0, 2, 4, 6, 8], "metadata nodes are not cameras");
    assert_eq!(devices[8].interface, 3);
}

#[test]
fn machine_without_video_has_no_devices() {
    let tree = Tree::new();
    assert!(scan(&root(&tree)).unwrap().is_empty());
    fs::remove_dir_all(tree.path("sys/class")).unwrap();
    assert!(scan(&root(&tree)).unwrap().is_empty());
    let error = bind(Role::Left, &config("GelSight Mini"), &[]).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Device);
    assert!(
        error
            .to_string()
            .starts_with("camera left: no camera is plugged in")
    );
}

#[test]
fn nodes_sort_by_number_and_ports_by_value() {
    let mut tree = Tree::new();
    for i in 0..11 {
        tree.plug(mini(&format!("3-{}", 11 - i), "Cam", ""), &[(0, 1)]);
    }
    let mut devices = scan(&root(&tree)).unwrap();
    assert_eq!(devices[10].node, tree.node(10));
    devices.sort_by(VideoDevice::port_order);
    let ports: Vec<&str> = devices.iter().map(|d| d.port.as_str()).collect();
    assert_eq!(ports[..3], ["3-1", "3-2", "3-3"]);
    assert_eq!(ports[10], "3-11");
}

#[test]
fn serial_overrides_the_port() {
    for (a, b) in [("3-2.1", "3-2.2"), ("3-2.2", "3-2.1")] {
        let mut tree = Tree::new();
        tree.plug(Usb { port: a, ..LEFT }, &[(0, 2)]);
        tree.plug(Usb { port: b, ..RIGHT }, &[(0, 2)]);
        let devices = scan(&root(&tree)).unwrap();
        // With a dash, as labelled on the sensor.
        let wanted = CameraConfig {
            serial: Some("2BNN-4ZE7".into()),
            port: Some("3-2.1".into()),
            ..config("GelSight Mini")
        };
        let bound = bind(Role::Left, &wanted, &devices).unwrap();
        assert_eq!(
            (bound.serial.as_str(), bound.port.as_str()),
            ("2BNN4ZE7", a)
        );
    }
}

#[test]
fn failed_bindings_list_the_devices() {
    let (tree, nodes) = bench();
    let devices = probed(&tree, &nodes);
    let message = |config: CameraConfig| {
        let error = bind(Role::Left, &config, &devices).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Device);
        assert!(error.remedy_text().is_some());
        error.to_string()
    };
    let text = message(config("GelSight Max"));
    assert!(text.contains("starting with `GelSight Max`"), "{text}");
    assert!(text.contains("serial 28F5K4RR, port 3-2.2"), "{text}");

    let text = message(CameraConfig {
        serial: Some("AAAA1111".into()),
        ..config("GelSight Mini")
    });
    assert!(
        text.contains(
            "found GelSight Mini with serials 28F5K4RR, 2BNN4ZE7; the rig expects AAAA1111"
        ),
        "{text}"
    );

    let text = message(config("GelSight Mini"));
    assert!(
        text.contains("several cameras match") && text.contains("add the `serial`"),
        "{text}"
    );

    let text = message(CameraConfig {
        interface: Some(2),
        ..config("Intel(R) RealSense")
    });
    assert!(
        text.contains("no camera on interface 2; it has interface 0, interface 3"),
        "{text}"
    );

    let text = message(CameraConfig {
        serial: Some("2BNN4ZE7".into()),
        format: PixelFormat::Yuyv,
        ..config("GelSight Mini")
    });
    assert!(
        text.contains("does not support YUYV; it supports MJPG 3280×2464 @ 25"),
        "{text}"
    );
}

#[test]
fn format_distinguishes_depth_infrared_and_colour() {
    let (tree, nodes) = bench();
    let devices = probed(&tree, &nodes);
    for (format, interface, node) in [
        (PixelFormat::Z16, None, 4),
        (PixelFormat::Z16, Some(0), 4),
        (PixelFormat::Grey, Some(0), 6),
        (PixelFormat::Yuyv, None, 8),
        (PixelFormat::Yuyv, Some(3), 8),
    ] {
        let wanted = CameraConfig {
            format,
            interface,
            ..config("Intel(R) RealSense(TM) Depth Camera 435")
        };
        let bound = bind(Role::Depth, &wanted, &devices).unwrap();
        assert_eq!(bound.node, tree.node(node), "{format} {interface:?}");
    }
    // Without modes (no permission) the interface is required.
    let unprobed = scan(&root(&tree)).unwrap();
    let error = bind(Role::Rgb, &config("Intel(R)"), &unprobed).unwrap_err();
    assert!(error.to_string().contains("add `interface`"), "{error}");
}

#[test]
fn equal_or_missing_serials_require_a_port() {
    for serial in ["0001", ""] {
        let mut tree = Tree::new();
        tree.plug(mini("3-1", "GelSight Mini", serial), &[(0, 2)]);
        tree.plug(mini("3-2", "GelSight Mini", serial), &[(0, 2)]);
        let devices = scan(&root(&tree)).unwrap();
        let wanted = |port: Option<&str>| CameraConfig {
            serial: Some(serial.to_owned()).filter(|s| !s.is_empty()),
            port: port.map(str::to_owned),
            ..config("GelSight Mini")
        };
        let text = bind(Role::Left, &wanted(None), &devices)
            .unwrap_err()
            .to_string();
        assert!(
            text.contains("add `port`") && text.contains("port 3-1"),
            "{text}"
        );
        let bound = bind(Role::Left, &wanted(Some("3-2")), &devices).unwrap();
        assert_eq!(bound.port, "3-2");
        let text = bind(Role::Left, &wanted(Some("3-9")), &devices)
            .unwrap_err()
            .to_string();
        assert!(text.contains("port 3-9"), "{text}");
    }
    let mut tree = Tree::new();
    tree.plug(mini("3-1", "GelSight Mini", ""), &[(0, 2)]);
    let wanted = CameraConfig {
        serial: Some("2BNN4ZE7".into()),
        ..config("GelSight Mini")
    };
    let text = bind(Role::Left, &wanted, &scan(&root(&tree)).unwrap())
        .unwrap_err()
        .to_string();
    assert!(text.contains("reports no serial number"), "{text}");
}

#[test]
fn system_errors_have_remedies() {
    let (tree, nodes) = bench();
    let devices = probed(&tree, &nodes);
    let explain = |code| {
        open_error(
            &root(&tree),
            &devices[0],
            "open",
            io::Error::from_raw_os_error(code),
        )
    };
    let denied = explain(libc::EACCES);
    assert_eq!(denied.kind(), ErrorKind::Permission);
    let text = denied.to_string();
    assert!(text.contains("usermod -aG video"), "{text}");
    assert!(
        text.contains(
            r#"SUBSYSTEM=="video4linux", ATTRS{idVendor}=="0c45", ATTRS{idProduct}=="636d", GROUP="video", MODE="0660""#
        ),
        "{text}"
    );
    assert!(text.contains("udevadm control --reload"), "{text}");

    tree.hold(4242, "cheese", 0);
    let busy = explain(libc::EBUSY);
    assert_eq!(busy.kind(), ErrorKind::Busy);
    assert!(
        busy.to_string()
            .contains("cheese (process 4242) is using it"),
        "{busy}"
    );
    assert_eq!(explain(libc::ENODEV).kind(), ErrorKind::Device);
    assert_eq!(explain(libc::EIO).kind(), ErrorKind::Io);
}

#[test]
fn probing_reports_access() {
    let (tree, nodes) = bench();
    let mut devices = scan(&root(&tree)).unwrap();
    let failing = |code| FakeCamera {
        open_faults: [code].into(),
        ..FakeCamera::default()
    };
    nodes.insert(tree.node(0), failing(libc::EACCES));
    nodes.insert(tree.node(2), failing(libc::EBUSY));
    nodes.insert(tree.node(4), failing(libc::ENOENT));
    tree.hold(77, "obs", 8);
    for device in &mut devices {
        probe(device, &nodes, &root(&tree));
    }
    assert_eq!(devices[0].access, Access::Denied);
    assert!(devices[0].is_camera() && devices[0].modes.is_none());
    assert_eq!(devices[2].access, Access::Busy(None));
    assert_eq!(devices[4].access, Access::Missing);
    let owner = NodeOwner {
        pid: 77,
        name: "obs".into(),
    };
    assert_eq!(devices[8].access, Access::Busy(Some(owner)));
    assert!(devices[8].modes.is_some());
}

#[test]
fn cameras_on_a_shared_usb_2_bus_are_listed() {
    let (tree, nodes) = bench();
    let devices = probed(&tree, &nodes);
    let crowded = crowded_buses(&devices);
    assert_eq!(crowded.keys().copied().collect::<Vec<_>>(), [3]);
    assert_eq!(crowded[&3].len(), 2);
    let error = no_bandwidth_error(&devices[0], &devices);
    assert_eq!(error.kind(), ErrorKind::Device);
    let text = error.to_string();
    assert!(text.contains("USB bus 3"), "{text}");
    assert!(
        text.contains("serial 2BNN4ZE7") && text.contains("serial 28F5K4RR"),
        "{text}"
    );
    assert!(!text.contains("RealSense"), "{text}");
}
