//! Errors of opening a device node, with their remedies.

use std::io;

use super::device_error;
use super::discovery::VideoDevice;
use super::owner::NodeOwner;
use super::sysfs::SystemRoot;
use gripcast_base::error::{Error, ErrorKind};

/// File for local udev rules; `70-gripcast.rules` would replace the packaged file.
pub const LOCAL_UDEV_RULES: &str = "/etc/udev/rules.d/70-gripcast-local.rules";

/// The udev rule for access to a camera by the group `video` and the local user.
#[must_use]
pub fn udev_rule(vendor_id: u16, product_id: u16) -> String {
    format!(
        "SUBSYSTEM==\"video4linux\", ATTRS{{idVendor}}==\"{vendor_id:04x}\", \
         ATTRS{{idProduct}}==\"{product_id:04x}\", GROUP=\"video\", MODE=\"0660\", TAG+=\"uaccess\""
    )
}

/// The error for denied access to `device`, with the udev rule.
#[must_use]
pub fn permission_error(device: &VideoDevice, step: &str) -> Error {
    let group = "add yourself to its group: `sudo usermod -aG video $USER`, then log in again";
    let remedy = match (device.vendor_id, device.product_id) {
        (Some(vendor), Some(product)) => format!(
            "{group}; or write this line into {LOCAL_UDEV_RULES}:\n    {}\n    \
             and run `sudo udevadm control --reload && sudo udevadm trigger`",
            udev_rule(vendor, product)
        ),
        _ => group.to_owned(),
    };
    Error::new(
        ErrorKind::Permission,
        format!(
            "no permission to {step} {} ({device})",
            device.node.display()
        ),
    )
    .remedy(remedy)
}

/// The error for a `device` that could not be opened or configured.
#[must_use]
pub fn open_error(root: &SystemRoot, device: &VideoDevice, step: &str, cause: io::Error) -> Error {
    let node = device.node.display();
    match cause.raw_os_error() {
        Some(libc::EACCES | libc::EPERM) => permission_error(device, step),
        Some(libc::EBUSY) => {
            let owner = NodeOwner::find(root, &device.node)
                .map_or_else(|| "another program".to_owned(), |owner| owner.to_string());
            Error::new(
                ErrorKind::Busy,
                format!("cannot {step} {node} ({device}): {owner} is using it"),
            )
            .remedy(format!(
                "end that program; `fuser -v {node}` shows who it is"
            ))
        }
        Some(libc::ENODEV | libc::ENXIO | libc::ENOENT) => device_error(format!(
            "cannot {step} {node} ({device}): the camera is disconnected"
        ))
        .remedy("plug it in again and check its cable"),
        _ => Error::io(format!("cannot {step} {node} ({device})"), cause),
    }
}
