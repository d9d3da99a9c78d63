//! Binds roles of the rig file to connected devices.
//!
//! A serial number identifies a camera only while no other role of the rig file and no other
//! connected camera has it; otherwise the port does. Two roles never get the same stream.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

use super::device_error;
use super::discovery::VideoDevice;
use crate::calibration::{CameraConfig, SourceKind};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::Role;

/// Remedy for cameras that only their ports distinguish.
const BY_PORT: &str = "add `port` to each of them in the rig file and keep every camera in its \
     port; `gripcast rig list` shows the ports, `gripcast rig init` writes them";

/// Letters and digits of a serial number in upper case: the GelSight Mini is labelled `2BNN-4ZE7`
/// and reports `2BNN4ZE7`. `None` for one that identifies nothing: empty, or only zeros.
pub(crate) fn serial_key(serial: &str) -> Option<String> {
    let letters = serial.chars().filter(char::is_ascii_alphanumeric);
    let key: String = letters.map(|c| c.to_ascii_uppercase()).collect();
    key.contains(|c| c != '0').then_some(key)
}

fn config_key(config: &CameraConfig) -> Option<String> {
    config.serial.as_deref().and_then(serial_key)
}

fn products_overlap(a: &CameraConfig, b: &CameraConfig) -> bool {
    a.product.starts_with(&b.product) || b.product.starts_with(&a.product)
}

/// Whether `a` and `b` may mean the same stream of the same device, apart from the port.
fn same_stream(a: &CameraConfig, b: &CameraConfig) -> bool {
    let same_interface = match (a.interface, b.interface) {
        (Some(a), Some(b)) => a == b,
        _ => true,
    };
    same_interface && a.format == b.format
}

/// Whether `a` and `b` are different cameras with the same serial number. The streams of one
/// device, such as depth and colour of a D435, are no twins.
pub(crate) fn are_twins(a: &CameraConfig, b: &CameraConfig) -> bool {
    let other_port = matches!((&a.port, &b.port), (Some(a), Some(b)) if a != b);
    let key = config_key(a);
    key.is_some()
        && key == config_key(b)
        && products_overlap(a, b)
        && (other_port || same_stream(a, b))
}

/// Whether `device` matches product, serial and interface.
fn is_candidate(config: &CameraConfig, device: &VideoDevice) -> bool {
    device.product.starts_with(&config.product)
        && has_serial(config, device)
        && config
            .interface
            .is_none_or(|interface| interface == device.interface)
}

fn has_serial(config: &CameraConfig, device: &VideoDevice) -> bool {
    let wanted = config.serial.as_deref().map(serial_key);
    wanted.is_none_or(|key| key == serial_key(&device.serial))
}

/// Groups of connected cameras with the same product and serial number, or without one: only
/// their ports distinguish them. One device per camera.
#[must_use]
pub fn indistinct_cameras(devices: &[VideoDevice]) -> Vec<Vec<&VideoDevice>> {
    let mut groups: BTreeMap<(&str, Option<String>), Vec<&VideoDevice>> = BTreeMap::new();
    for device in devices.iter().filter(|device| device.is_camera()) {
        let key = (device.product.as_str(), serial_key(&device.serial));
        let group = groups.entry(key).or_default();
        if group.iter().all(|other| other.port != device.port) {
            group.push(device);
        }
    }
    groups.retain(|_, cameras| cameras.len() > 1);
    groups.into_values().collect()
}

/// Binds the V4L2 cameras of a rig to connected devices.
#[derive(Debug)]
pub struct CameraBinder {
    cameras: BTreeMap<Role, CameraConfig>,
    /// Serial numbers that several connected cameras had at once. They stay ambiguous while one of
    /// those cameras is unplugged.
    repeated: Mutex<BTreeSet<String>>,
}

impl CameraBinder {
    /// Binder for the V4L2 cameras among `cameras`.
    #[must_use]
    pub fn new(cameras: &BTreeMap<Role, CameraConfig>) -> Self {
        let real = cameras
            .iter()
            .filter(|(_, camera)| camera.source == SourceKind::V4l2);
        Self {
            cameras: real.map(|(role, camera)| (*role, camera.clone())).collect(),
            repeated: Mutex::default(),
        }
    }

    /// Whether the modes of `device` must be known to bind `role`: it matches the role, or another
    /// role that may claim the same devices.
    #[must_use]
    pub fn is_candidate(&self, role: Role, device: &VideoDevice) -> bool {
        let Some(config) = self.cameras.get(&role) else {
            return false;
        };
        let may_meet = |other: &CameraConfig| {
            let keys = (config_key(config), config_key(other));
            let same_serial = !matches!(&keys, (Some(a), Some(b)) if a != b);
            same_serial && products_overlap(config, other)
        };
        let rivals = self.cameras.values().filter(|other| may_meet(other));
        rivals.into_iter().any(|rival| is_candidate(rival, device))
    }

    /// Whether only the port identifies the camera of `role`.
    #[must_use]
    pub fn is_bound_by_port(&self, role: Role) -> bool {
        self.cameras
            .get(&role)
            .is_some_and(|config| config_key(config).is_none() || self.twin(role).is_some())
    }

    /// Finds the device of `role`.
    ///
    /// # Errors
    /// `Device` when none or several match, or another role has the only one; it lists the devices
    /// found.
    pub fn bind<'a>(&self, role: Role, devices: &'a [VideoDevice]) -> Result<&'a VideoDevice> {
        let bound = match self.cameras.get(&role) {
            Some(config) => self
                .select(role, config, devices)
                .and_then(|device| self.check_unclaimed(role, config, device, devices)),
            None => Err(device_error("the rig has no such V4L2 camera")),
        };
        bound.map_err(|error| error.at(format_args!("camera {role}")))
    }

    /// The role whose camera has the same serial number.
    fn twin(&self, role: Role) -> Option<Role> {
        let config = self.cameras.get(&role)?;
        let mut others = self.cameras.iter().filter(|(other, _)| **other != role);
        others
            .find(|(_, other)| are_twins(config, other))
            .map(|(twin, _)| *twin)
    }

    /// Fails if another role is identified at least as well by `device`.
    fn check_unclaimed<'a>(
        &self,
        role: Role,
        config: &CameraConfig,
        device: &'a VideoDevice,
        devices: &[VideoDevice],
    ) -> Result<&'a VideoDevice> {
        let rank = |config: &CameraConfig| (config_key(config).is_some(), config.port.is_some());
        for (other_role, other) in &self.cameras {
            if *other_role == role || rank(other) < rank(config) {
                continue;
            }
            let claimed = self.select(*other_role, other, devices);
            if claimed.is_ok_and(|claimed| claimed.node == device.node) {
                let what = format!("the only matching camera, {device}, is that of {other_role}");
                return Err(device_error(what).remedy(
                    "plug the missing camera in; give each camera its own `serial` or `port` in \
                     the rig file",
                ));
            }
        }
        Ok(device)
    }

    fn select<'a>(
        &self,
        role: Role,
        config: &CameraConfig,
        devices: &'a [VideoDevice],
    ) -> Result<&'a VideoDevice> {
        let cameras: Vec<&VideoDevice> = devices.iter().filter(|d| d.is_camera()).collect();
        if cameras.is_empty() {
            return Err(device_error("no camera is plugged in")
                .remedy("plug the cameras in; `gripcast rig list` lists what the kernel detects"));
        }
        let of_product = keep(&cameras, |d| d.product.starts_with(&config.product));
        if of_product.is_empty() {
            return Err(device_error(format!(
                "no camera has a product name starting with `{}`; found {}",
                config.product,
                list(&cameras)
            ))
            .remedy(
                "plug it in, or correct `product` in the rig file; `gripcast rig list` lists all",
            ));
        }
        let of_serial = match &config.serial {
            Some(serial) => with_serial(config, serial, &of_product)?,
            None => of_product,
        };
        let of_port = self.by_port(role, config, of_serial)?;
        let of_interface = by_interface(config, of_port)?;
        let of_format = keep(&of_interface, |d| d.offers(config.format).unwrap_or(true));
        match of_format.as_slice() {
            [] => Err(no_format(config, &of_interface)),
            [device] => Ok(device),
            several => Err(ambiguous(config, several)),
        }
    }

    /// Selects by port, unless the serial number identifies one camera.
    fn by_port<'a>(
        &self,
        role: Role,
        config: &CameraConfig,
        candidates: Vec<&'a VideoDevice>,
    ) -> Result<Vec<&'a VideoDevice>> {
        let twin = self.twin(role);
        let key = config_key(config);
        let is_repeated = key.as_ref().is_some_and(|key| {
            let mut repeated = self.repeated.lock().unwrap_or_else(PoisonError::into_inner);
            if candidates.iter().any(|d| d.port != candidates[0].port) {
                repeated.insert(key.clone());
            }
            repeated.contains(key)
        });
        if key.is_some() && twin.is_none() && !is_repeated {
            return Ok(candidates);
        }
        let reason = match (&config.serial, twin) {
            (Some(serial), Some(twin)) => {
                format!("; the camera of {twin} has the same serial number {serial}")
            }
            _ => String::new(),
        };
        let Some(port) = &config.port else {
            return match twin {
                Some(_) => Err(device_error(format!(
                    "the rig file names no `port`{reason}: found {}",
                    list(&candidates)
                ))
                .remedy(BY_PORT)),
                None => Ok(candidates),
            };
        };
        let kept = keep(&candidates, |d| d.port == *port);
        if kept.is_empty() {
            return Err(device_error(format!(
                "no matching camera in port {port}{reason}; found {}",
                list(&candidates)
            ))
            .remedy("plug it into that port, or correct `port` in the rig file"));
        }
        Ok(kept)
    }
}

fn by_interface<'a>(
    config: &CameraConfig,
    candidates: Vec<&'a VideoDevice>,
) -> Result<Vec<&'a VideoDevice>> {
    let Some(wanted) = config.interface else {
        return Ok(candidates);
    };
    let kept = keep(&candidates, |d| d.interface == wanted);
    if kept.is_empty() {
        return Err(device_error(format!(
            "{} has no camera on interface {wanted}; it has {}",
            candidates[0],
            interfaces(&candidates)
        ))
        .remedy("correct `interface` in the rig file, or remove it"));
    }
    Ok(kept)
}

fn no_format(config: &CameraConfig, candidates: &[&VideoDevice]) -> Error {
    let modes = candidates.iter().flat_map(|d| d.modes.iter().flatten());
    let modes: Vec<String> = modes.map(ToString::to_string).collect();
    device_error(format!(
        "{} does not support {}; it supports {}",
        candidates[0],
        config.format,
        modes.join(", ")
    ))
    .remedy("set one of these modes in the rig file")
}

fn with_serial<'a>(
    config: &CameraConfig,
    serial: &str,
    of_product: &[&'a VideoDevice],
) -> Result<Vec<&'a VideoDevice>> {
    let kept = keep(of_product, |d| has_serial(config, d));
    if !kept.is_empty() {
        return Ok(kept);
    }
    let mut serials: Vec<&str> = of_product
        .iter()
        .map(|d| match d.serial.as_str() {
            "" => "none",
            serial => serial,
        })
        .collect();
    serials.sort_unstable();
    serials.dedup();
    let error = device_error(format!(
        "found {} with serials {}; the rig expects {serial}",
        if config.product.is_empty() {
            "cameras"
        } else {
            &config.product
        },
        serials.join(", ")
    ));
    Err(if serials == ["none"] {
        error.remedy(
            "this camera reports no serial number: replace `serial` in the rig file by `port`",
        )
    } else {
        error.remedy("plug the expected camera in, or correct `serial` in the rig file")
    })
}

fn ambiguous(config: &CameraConfig, several: &[&VideoDevice]) -> Error {
    let first = several[0];
    let cameras = list(several);
    if several.iter().all(|d| d.port == first.port) {
        let interfaces = interfaces(several);
        return device_error(format!(
            "{first} has several matching cameras: {interfaces}"
        ))
        .remedy("add `interface` to the rig file");
    }
    let key = serial_key(&first.serial);
    if several.iter().all(|d| serial_key(&d.serial) == key) {
        if key.is_none() {
            let what = format!("several cameras match, none with a serial number: {cameras}");
            return device_error(what).remedy(BY_PORT);
        }
        let what = format!("several cameras have the same serial number: {cameras}");
        return device_error(what).remedy(BY_PORT);
    }
    device_error(format!(
        "several cameras match `{}`: {cameras}",
        config.product
    ))
    .remedy("add the `serial` of the intended one to the rig file")
}

fn keep<'a>(
    devices: &[&'a VideoDevice],
    test: impl Fn(&VideoDevice) -> bool,
) -> Vec<&'a VideoDevice> {
    devices.iter().copied().filter(|d| test(d)).collect()
}

fn list(devices: &[&VideoDevice]) -> String {
    let mut names: Vec<String> = devices.iter().map(ToString::to_string).collect();
    names.dedup();
    names.join("; ")
}

fn interfaces(devices: &[&VideoDevice]) -> String {
    let mut numbers: Vec<u8> = devices.iter().map(|d| d.interface).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let texts: Vec<String> = numbers.iter().map(|n| format!("interface {n}")).collect();
    texts.join(", ")
}

#[cfg(test)]
#[path = "binding_test.rs"]
mod tests;
