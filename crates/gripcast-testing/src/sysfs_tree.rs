//! Builds fake `/sys`, `/dev` and `/proc` trees in a temporary directory, for tests.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

/// A fake `/sys`, `/dev` and `/proc`.
pub struct Tree {
    directory: tempfile::TempDir,
    nodes: u32,
}

/// A USB device in the tree.
#[derive(Clone, Copy)]
pub struct Usb<'a> {
    /// Port path, such as `3-1`.
    pub port: &'a str,
    /// Vendor and product id.
    pub ids: (u16, u16),
    /// Product string.
    pub product: &'a str,
    /// Serial number.
    pub serial: &'a str,
    /// Bus number.
    pub bus: u32,
    /// Link speed, Mbit/s.
    pub speed: &'a str,
}

/// A GelSight Mini with the given serial.
pub const fn mini<'a>(port: &'a str, product: &'a str, serial: &'a str) -> Usb<'a> {
    Usb {
        port,
        ids: (0x0c45, 0x636d),
        product,
        serial,
        bus: 3,
        speed: "480",
    }
}

/// A RealSense D435 on a SuperSpeed port.
pub const fn d435(port: &str) -> Usb<'_> {
    Usb {
        port,
        ids: (0x8086, 0x0b07),
        product: "Intel(R) RealSense(TM) Depth Camera 435",
        serial: "814412070123",
        bus: 4,
        speed: "5000",
    }
}

impl Default for Tree {
    fn default() -> Self {
        Self::new()
    }
}

impl Tree {
    /// A tree without devices.
    pub fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        for part in ["sys/class/video4linux", "dev", "proc"] {
            fs::create_dir_all(directory.path().join(part)).unwrap();
        }
        Self {
            directory,
            nodes: 0,
        }
    }

    /// Path in the tree.
    pub fn path(&self, part: &str) -> PathBuf {
        self.directory.path().join(part)
    }

    /// Path of the video node with a number.
    pub fn node(&self, number: u32) -> PathBuf {
        self.path("dev").join(format!("video{number}"))
    }

    /// Plugs in a device; each function is an interface number and its number of nodes, the first
    /// and third of which deliver images. Returns the number of its first node.
    pub fn plug(&mut self, usb: Usb<'_>, functions: &[(u8, u32)]) -> u32 {
        let device = self
            .path("sys/devices/pci0000:00/0000:00:14.0")
            .join(format!("usb{}", usb.bus))
            .join(usb.port);
        fs::create_dir_all(&device).unwrap();
        write(&device, "idVendor", &format!("{:04x}", usb.ids.0));
        write(&device, "idProduct", &format!("{:04x}", usb.ids.1));
        write(&device, "product", usb.product);
        write(&device, "busnum", &usb.bus.to_string());
        write(&device, "speed", usb.speed);
        if !usb.serial.is_empty() {
            write(&device, "serial", usb.serial);
        }
        let first = self.nodes;
        for &(interface, count) in functions {
            let name = format!("{}:1.{interface}", usb.port);
            let directory = device.join(&name);
            fs::create_dir_all(&directory).unwrap();
            write(&directory, "bInterfaceNumber", &format!("{interface:02x}"));
            for index in 0..count {
                let node = format!("video{}", self.nodes);
                let entry = directory.join("video4linux").join(&node);
                fs::create_dir_all(&entry).unwrap();
                let card = format!("{}: {}", usb.product, usb.product);
                write(&entry, "name", &card[..31.min(card.len())]);
                write(&entry, "index", &index.to_string());
                symlink("../..", entry.join("device")).unwrap();
                symlink(&entry, self.path("sys/class/video4linux").join(&node)).unwrap();
                fs::write(self.node(self.nodes), "").unwrap();
                self.nodes += 1;
            }
        }
        first
    }

    /// Adds a process that has the node open.
    pub fn hold(&self, pid: u32, name: &str, node: u32) {
        let directory = self.path("proc").join(pid.to_string());
        fs::create_dir_all(directory.join("fd")).unwrap();
        write(&directory, "comm", name);
        symlink(self.node(node), directory.join("fd/5")).unwrap();
    }
}

fn write(directory: &Path, name: &str, value: &str) {
    fs::write(directory.join(name), format!("{value}\n")).unwrap();
}
