//! USB bandwidth: cameras that share a bus.

use std::collections::BTreeMap;

use super::device_error;
use super::discovery::VideoDevice;
use gripcast_base::error::Error;

/// Link speed of USB 2, Mbit/s. Faster links are on separate buses.
const HIGH_SPEED_MBPS: u32 = 480;

/// Buses with several USB 2 cameras, with one device per physical camera.
#[must_use]
pub fn crowded_buses(devices: &[VideoDevice]) -> BTreeMap<u32, Vec<&VideoDevice>> {
    let mut buses: BTreeMap<u32, Vec<&VideoDevice>> = BTreeMap::new();
    for device in devices.iter().filter(|device| device.is_camera()) {
        let slow = device
            .speed_mbps
            .is_none_or(|speed| speed <= HIGH_SPEED_MBPS);
        if let Some(bus) = device.bus.filter(|_| slow) {
            let on_bus = buses.entry(bus).or_default();
            if on_bus.iter().all(|other| other.port != device.port) {
                on_bus.push(device);
            }
        }
    }
    buses.retain(|_, cameras| cameras.len() > 1);
    buses
}

/// The error for `ENOSPC` at the start of a stream: the bus of `device` lacks the bandwidth that
/// the camera requests.
#[must_use]
pub fn no_bandwidth_error(device: &VideoDevice, all: &[VideoDevice]) -> Error {
    let mut others: Vec<String> = all
        .iter()
        .filter(|other| other.is_camera() && other.bus == device.bus && other.port != device.port)
        .map(ToString::to_string)
        .collect();
    others.dedup();
    let bus = device
        .bus
        .map_or_else(|| "its USB bus".to_owned(), |bus| format!("USB bus {bus}"));
    let shared = if others.is_empty() {
        "no other camera is on it; other devices may use it".to_owned()
    } else {
        format!("shared with {}", others.join("; "))
    };
    device_error(format!(
        "{bus} has too little bandwidth left for {device} ({shared})"
    ))
    .remedy(
        "plug one of the cameras into a port of another USB controller (a port on the other side \
         of the laptop, a dock, a PCIe card); a second hub does not help, and neither does the \
         uvcvideo option quirks=128, which the kernel ignores for MJPG",
    )
}
