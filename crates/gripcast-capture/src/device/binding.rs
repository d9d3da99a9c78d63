//! Binds roles of the rig file to connected devices.

use super::device_error;
use super::discovery::VideoDevice;
use crate::calibration::CameraConfig;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::Role;

/// Compares serials by their letters and digits: the GelSight Mini is labelled `2BNN-4ZE7` and
/// reports `2BNN4ZE7`.
fn same_serial(a: &str, b: &str) -> bool {
    let plain = |text: &str| -> String {
        text.chars()
            .filter(char::is_ascii_alphanumeric)
            .map(|c| c.to_ascii_uppercase())
            .collect()
    };
    plain(a) == plain(b)
}

/// Whether `device` matches product, serial and interface.
#[must_use]
pub fn is_candidate(config: &CameraConfig, device: &VideoDevice) -> bool {
    device.product.starts_with(&config.product)
        && config
            .serial
            .as_ref()
            .is_none_or(|serial| same_serial(serial, &device.serial))
        && config
            .interface
            .is_none_or(|interface| interface == device.interface)
}

/// Finds the device of `config`. The port is only compared without a serial, or among devices with
/// the same one.
///
/// # Errors
/// `Device` when none or several match, listing the devices found.
pub fn bind<'a>(
    role: Role,
    config: &CameraConfig,
    devices: &'a [VideoDevice],
) -> Result<&'a VideoDevice> {
    select(config, devices).map_err(|error| error.at(format_args!("camera {role}")))
}

fn select<'a>(config: &CameraConfig, devices: &'a [VideoDevice]) -> Result<&'a VideoDevice> {
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
    let of_interface = match config.interface {
        Some(wanted) => {
            let kept = keep(&of_serial, |d| d.interface == wanted);
            if kept.is_empty() {
                return Err(device_error(format!(
                    "{} has no camera on interface {wanted}; it has {}",
                    of_serial[0],
                    interfaces(&of_serial)
                ))
                .remedy("correct `interface` in the rig file, or remove it"));
            }
            kept
        }
        None => of_serial,
    };
    let of_port = by_port(config, of_interface)?;
    let of_format = keep(&of_port, |d| d.offers(config.format).unwrap_or(true));
    match of_format.as_slice() {
        [] => {
            let modes = of_port.iter().flat_map(|d| d.modes.iter().flatten());
            let modes: Vec<String> = modes.map(ToString::to_string).collect();
            Err(device_error(format!(
                "{} does not support {}; it supports {}",
                of_port[0],
                config.format,
                modes.join(", ")
            ))
            .remedy("set one of these modes in the rig file"))
        }
        [device] => Ok(device),
        several => Err(ambiguous(config, several)),
    }
}

fn with_serial<'a>(
    config: &CameraConfig,
    serial: &str,
    of_product: &[&'a VideoDevice],
) -> Result<Vec<&'a VideoDevice>> {
    let kept = keep(of_product, |d| same_serial(serial, &d.serial));
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

/// Selects by port among several physical cameras.
fn by_port<'a>(
    config: &CameraConfig,
    candidates: Vec<&'a VideoDevice>,
) -> Result<Vec<&'a VideoDevice>> {
    let Some(port) = &config.port else {
        return Ok(candidates);
    };
    let first = &candidates[0].port;
    let several = candidates.iter().any(|d| d.port != *first);
    // A unique serial decides.
    if config.serial.is_some() && !several {
        return Ok(candidates);
    }
    let kept = keep(&candidates, |d| d.port == *port);
    if kept.is_empty() {
        return Err(device_error(format!(
            "no matching camera in port {port}; found {}",
            list(&candidates)
        ))
        .remedy("plug it into that port, or correct `port` in the rig file"));
    }
    Ok(kept)
}

fn ambiguous(config: &CameraConfig, several: &[&VideoDevice]) -> Error {
    let first = several[0];
    let cameras = list(several);
    const BY_PORT: &str = "add `port` to the rig file and keep each camera in its port";
    if several.iter().all(|d| d.port == first.port) {
        let interfaces = interfaces(several);
        return device_error(format!(
            "{first} has several matching cameras: {interfaces}"
        ))
        .remedy("add `interface` to the rig file");
    }
    if several.iter().all(|d| d.serial.is_empty()) {
        let what = format!("several cameras match, none with a serial number: {cameras}");
        return device_error(what).remedy(BY_PORT);
    }
    if several
        .iter()
        .all(|d| same_serial(&d.serial, &first.serial))
    {
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
