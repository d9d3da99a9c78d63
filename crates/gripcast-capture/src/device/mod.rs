//! Discovery, identity and access rights of USB cameras.
//!
//! A role is bound to a product, a serial number and an interface, never to `/dev/videoN`; to a port
//! where serial numbers repeat.

mod access;
mod bandwidth;
mod binding;
mod discovery;
mod owner;
mod sysfs;
#[cfg(test)]
mod tests;

pub use access::{LOCAL_UDEV_RULES, open_error, permission_error, udev_rule};
pub use bandwidth::{crowded_buses, no_bandwidth_error};
pub use binding::{CameraBinder, indistinct_cameras};
pub(crate) use binding::{are_twins, serial_key};
pub(crate) use discovery::modes;
pub use discovery::{Access, Mode, VideoDevice, probe, scan};
pub use owner::NodeOwner;
pub use sysfs::SystemRoot;

use gripcast_base::error::{Error, ErrorKind};

pub(crate) fn device_error(what: impl Into<String>) -> Error {
    Error::new(ErrorKind::Device, what)
}
