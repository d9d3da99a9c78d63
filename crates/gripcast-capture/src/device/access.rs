//! Why a device node cannot be opened, and what to do about it.

use std::io;

use super::discovery::VideoDevice;
use super::owner::NodeOwner;
use super::sysfs::SystemRoot;
use gripcast_base::error::{Error, ErrorKind};

/// Where udev rules of one's own belong. Not `70-gripcast.rules`: that would replace the packaged
/// file of this name.
pub const LOCAL_UDEV_RULES: &str = "/etc/udev/rules.d/70-gripcast-local.rules";

/// The udev rule that opens a camera to the group `video` and to the person at the screen.
#[must_use]
pub fn udev_rule(vendor_id: u16, product_id: u16) -> String {
    format!(
        "SUBSYSTEM==\"video4linux\", ATTRS{{idVendor}}==\"{vendor_id:04x}\", \
         ATTRS{{idProduct}}==\"{product_id:04x}\", GROUP=\"video\", MODE=\"0660\", TAG+=\"uaccess\""
    )
}

/// Explains that the operating system keeps `device` from us, with the udev rule that fixes it.
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

/// Explains why `device` could not be opened or configured.
#[must_use]
pub fn open_error(root: &SystemRoot, device: &VideoDevice, step: &str, cause: io::Error) -> Error {
    let node = device.node.display();
    match cause.raw_os_error() {
        Some(libc::EACCES | libc::EPERM) => permission_error(device, step),
        Some(libc::EBUSY) => {
            let holder = NodeOwner::find(root, &device.node)
                .map_or_else(|| "another program".to_owned(), |owner| owner.to_string());
            Error::new(
                ErrorKind::Busy,
                format!("cannot {step} {node} ({device}): {holder} is using it"),
            )
            .remedy(format!(
                "end that program; `fuser -v {node}` shows who it is"
            ))
        }
        Some(libc::ENODEV | libc::ENXIO | libc::ENOENT) => Error::new(
            ErrorKind::Device,
            format!("cannot {step} {node} ({device}): the camera is gone"),
        )
        .remedy("plug it in again and look at its cable"),
        _ => Error::io(format!("cannot {step} {node} ({device})"), cause),
    }
}
