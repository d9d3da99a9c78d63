//! Binds a role of the rig file to one of the devices that are plugged in.

use super::discovery::VideoDevice;
use crate::calibration::CameraConfig;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_imaging::Role;

/// Whether two spellings of a serial are the same; the GelSight Mini prints `2BNN-4ZE7` and
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

/// Whether product, serial and interface allow `device`; such devices are worth opening to learn
/// what they offer.
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

/// Finds the one device that `config` means. A serial decides wherever it is given; the port
/// counts only without one, or between two devices with the same one.
///
/// # Errors
/// [`ErrorKind::Device`] when none or several match, saying which were seen and what to change.
pub fn bind<'a>(
    role: Role,
    config: &CameraConfig,
    devices: &'a [VideoDevice],
) -> Result<&'a VideoDevice> {
    choose(config, devices).map_err(|error| error.at(format_args!("camera {role}")))
}

fn choose<'a>(config: &CameraConfig, devices: &'a [VideoDevice]) -> Result<&'a VideoDevice> {
    let cameras: Vec<&VideoDevice> = devices.iter().filter(|d| d.is_camera()).collect();
    if cameras.is_empty() {
        return Err(missing("no camera is plugged in".to_owned())
            .remedy("plug the cameras in; `gripcast rig list` shows what the kernel sees"));
    }
    let of_product = keep(&cameras, |d| d.product.starts_with(&config.product));
    if of_product.is_empty() {
        return Err(missing(format!(
            "no camera whose product begins with `{}`; found {}",
            config.product,
            list(&cameras)
        ))
        .remedy(
            "plug it in, or correct `product` in the rig file; `gripcast rig list` shows all",
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
                return Err(missing(format!(
                    "{} has no camera on interface {wanted}; it has {}",
                    of_serial[0],
                    interfaces(&of_serial)
                ))
                .remedy("correct `interface` in the rig file, or leave it out"));
            }
            kept
        }
        None => of_serial,
    };
    let of_port = by_port(config, of_interface)?;
    let of_format = keep(&of_port, |d| d.offers(config.format).unwrap_or(true));
    match of_format.as_slice() {
        [] => Err(Error::new(
            ErrorKind::Device,
            format!(
                "{} offers no {}; it offers {}",
                of_port[0],
                config.format,
                {
                    let modes: Vec<String> = of_port
                        .iter()
                        .flat_map(|d| d.modes.iter().flatten())
                        .map(ToString::to_string)
                        .collect();
                    modes.join(", ")
                }
            ),
        )
        .remedy("write one of these modes into the rig file")),
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
    let error = missing(format!(
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
            "this camera reports no serial number: take `serial` out of the rig file and give \
             `port` instead",
        )
    } else {
        error.remedy(
            "plug the expected camera in, or write the serial that is there into the rig file",
        )
    })
}

/// Narrows several physical cameras down by the port of the rig file.
fn by_port<'a>(
    config: &CameraConfig,
    candidates: Vec<&'a VideoDevice>,
) -> Result<Vec<&'a VideoDevice>> {
    let Some(port) = &config.port else {
        return Ok(candidates);
    };
    let first = &candidates[0].port;
    let several = candidates.iter().any(|d| d.port != *first);
    // A serial that one camera alone carries decides, wherever it is plugged in.
    if config.serial.is_some() && !several {
        return Ok(candidates);
    }
    let kept = keep(&candidates, |d| d.port == *port);
    if kept.is_empty() {
        return Err(missing(format!(
            "nothing that matches is plugged into port {port}; found {}",
            list(&candidates)
        ))
        .remedy("plug it into that port, or correct `port` in the rig file"));
    }
    Ok(kept)
}

fn ambiguous(config: &CameraConfig, several: &[&VideoDevice]) -> Error {
    let first = several[0];
    let error = |what: String| Error::new(ErrorKind::Device, what);
    if several.iter().all(|d| d.port == first.port) {
        return error(format!(
            "{first} has several cameras that match: {}",
            interfaces(several)
        ))
        .remedy("add `interface` to the rig file");
    }
    if several.iter().all(|d| d.serial.is_empty()) {
        return error(format!(
            "several cameras match and none has a serial number: {}",
            list(several)
        ))
        .remedy("add `port` to the rig file and keep each camera in its port");
    }
    if several
        .iter()
        .all(|d| same_serial(&d.serial, &first.serial))
    {
        return error(format!(
            "several cameras have the same serial number: {}",
            list(several)
        ))
        .remedy("add `port` to the rig file and keep each camera in its port");
    }
    error(format!(
        "several cameras match `{}`: {}",
        config.product,
        list(several)
    ))
    .remedy("add the `serial` of the one that is meant to the rig file")
}

fn missing(what: String) -> Error {
    Error::new(ErrorKind::Device, what)
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
