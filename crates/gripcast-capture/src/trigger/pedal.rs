//! Foot pedals and presenters: USB keyboards read through hidraw, independent of the window focus.
//!
//! Reports are those of a boot keyboard (USB HID 1.11, appendix B.1): modifiers, reserved, six
//! key usages. Key-down edges are debounced.

use std::collections::BTreeMap;
use std::ffi::{CStr, CString};
use std::fs::OpenOptions;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use hidapi::{HidApi, HidDevice};

use super::TriggerEvent;
use crate::calibration::PedalConfig;
use crate::camera::Clock;
use crate::device::{LOCAL_UDEV_RULES, device_error};
use gripcast_base::error::{Error, Result};

const FIRST_BACKOFF_NS: u64 = 500_000_000;
const MAX_BACKOFF_NS: u64 = 5_000_000_000;
const READ_TIMEOUT_MS: i32 = 100;

/// HID usages (page 7) of named keys other than letters, digits and function keys.
const NAMED_KEYS: &[(&str, u8)] = &[
    ("enter", 0x28),
    ("escape", 0x29),
    ("backspace", 0x2A),
    ("tab", 0x2B),
    ("space", 0x2C),
    ("minus", 0x2D),
    ("comma", 0x36),
    ("period", 0x37),
    ("slash", 0x38),
    ("home", 0x4A),
    ("page_up", 0x4B),
    ("delete", 0x4C),
    ("end", 0x4D),
    ("page_down", 0x4E),
    ("right", 0x4F),
    ("left", 0x50),
    ("down", 0x51),
    ("up", 0x52),
];

/// HID keyboard usage of a key name: `a`–`z`, `0`–`9`, `f1`–`f12`, `enter`, `page_down`, ….
fn key_usage(name: &str) -> Option<u8> {
    match name.as_bytes() {
        [letter @ b'a'..=b'z'] => return Some(0x04 + (letter - b'a')),
        [b'0'] => return Some(0x27),
        [digit @ b'1'..=b'9'] => return Some(0x1E + (digit - b'1')),
        _ => {}
    }
    if let Some(number) = name.strip_prefix('f')
        && !number.starts_with('0')
        && let Ok(number @ 1..=12) = number.parse::<u8>()
    {
        return Some(0x3A + number - 1);
    }
    NAMED_KEYS
        .iter()
        .find(|(known, _)| *known == name)
        .map(|(_, usage)| *usage)
}

/// Key name of a HID keyboard usage; the inverse of [`key_usage`].
fn usage_key(usage: u8) -> Option<String> {
    match usage {
        0x04..=0x1D => Some(char::from(b'a' + (usage - 0x04)).to_string()),
        0x1E..=0x26 => Some(char::from(b'1' + (usage - 0x1E)).to_string()),
        0x27 => Some("0".to_owned()),
        0x3A..=0x45 => Some(format!("f{}", usage - 0x3A + 1)),
        _ => NAMED_KEYS
            .iter()
            .find(|(_, known)| *known == usage)
            .map(|(name, _)| (*name).to_owned()),
    }
}

/// Commands of a pedal by key usage.
type KeyMap = BTreeMap<u8, String>;

/// # Errors
/// `Config` for an unknown key or a pedal without keys.
fn key_map(config: &PedalConfig) -> Result<KeyMap> {
    let pedal = pedal_name(config);
    if config.keys.is_empty() {
        return Err(Error::config("the pedal has no keys")
            .at(pedal)
            .remedy("add keys, for instance `keys = { b = \"trigger\" }`"));
    }
    let usage = |(name, command): (&String, &String)| {
        let usage = key_usage(name).ok_or_else(|| {
            Error::config(format!("unknown key `{name}`"))
                .at(&pedal)
                .remedy(
                    "use a–z, 0–9, f1–f12, space, enter, escape, tab, period, comma, slash, \
                     minus, backspace, delete, home, end, page_up, page_down, up, down, left or \
                     right",
                )
        })?;
        Ok((usage, command.clone()))
    };
    config.keys.iter().map(usage).collect()
}

/// Detects debounced key-down edges in keyboard reports.
#[derive(Debug)]
struct KeyEdgeDetector {
    debounce_ns: u64,
    down: Vec<u8>,
    last_edge_ns: BTreeMap<u8, u64>,
}

impl KeyEdgeDetector {
    fn new(debounce_ns: u64) -> Self {
        Self {
            debounce_ns,
            down: Vec::new(),
            last_edge_ns: BTreeMap::new(),
        }
    }

    /// Usages of the keys pressed in an input report (8 bytes, or 9 with a leading report id).
    /// Reports of other lengths and roll-over errors are ignored.
    fn report(&mut self, report: &[u8], now_ns: u64) -> Vec<u8> {
        const ROLL_OVER: u8 = 0x01;
        let keys = match report.len() {
            8 => &report[2..8],
            9 => &report[3..9],
            _ => return Vec::new(),
        };
        if keys.contains(&ROLL_OVER) {
            return Vec::new();
        }
        let mut now_down: Vec<u8> = keys.iter().copied().filter(|usage| *usage > 3).collect();
        now_down.sort_unstable();
        now_down.dedup();
        for usage in self.down.iter().filter(|usage| !now_down.contains(usage)) {
            self.last_edge_ns.insert(*usage, now_ns);
        }
        let mut pressed = Vec::new();
        for usage in now_down.iter().copied() {
            if self.down.contains(&usage) {
                continue;
            }
            // Releases restart the debounce time as well.
            let is_debounced = self
                .last_edge_ns
                .insert(usage, now_ns)
                .is_none_or(|edge_ns| now_ns.saturating_sub(edge_ns) >= self.debounce_ns);
            if is_debounced {
                pressed.push(usage);
            }
        }
        self.down = now_down;
        pressed
    }

    /// Releases all keys of an unplugged pedal.
    fn reset(&mut self) {
        self.down.clear();
    }
}

/// Event of a pedal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PedalEvent {
    /// The pedal was opened.
    Ready {
        /// Product name, or the USB ids.
        product: String,
    },
    /// A key was pressed.
    Trigger(TriggerEvent),
    /// A key without a command was pressed.
    Unmapped {
        /// Name of the key, or its usage in hex.
        key: String,
    },
    /// Absent, inaccessible or unplugged; retried. Sent once per reason.
    Lost {
        /// The error with its remedy.
        reason: String,
    },
}

/// The udev rule for access to a pedal without root.
pub fn pedal_udev_rule(vendor: u16, product: u16) -> String {
    format!(
        "KERNEL==\"hidraw*\", ATTRS{{idVendor}}==\"{vendor:04x}\", \
         ATTRS{{idProduct}}==\"{product:04x}\", MODE=\"0660\", GROUP=\"plugdev\", TAG+=\"uaccess\""
    )
}

/// Reads a pedal until `stop` is set, reopening it when it is lost. Blocks; run it on a thread.
///
/// # Errors
/// `Config` for invalid keys; other errors are sent to `sink` and retried.
pub fn run_pedal(
    config: &PedalConfig,
    clock: &dyn Clock,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(PedalEvent),
) -> Result<()> {
    let keys = key_map(config)?;
    let mut edges = KeyEdgeDetector::new(config.debounce_ms.saturating_mul(1_000_000));
    let mut backoff_ns = FIRST_BACKOFF_NS;
    let mut last_reason = String::new();
    while !stop.load(Ordering::Relaxed) {
        let reason = match open_pedal(config) {
            Ok((device, product)) => {
                backoff_ns = FIRST_BACKOFF_NS;
                last_reason.clear();
                edges.reset();
                sink(PedalEvent::Ready { product });
                match read_reports(&device, &keys, &mut edges, clock, stop, sink) {
                    Ok(()) => return Ok(()),
                    Err(reason) => format!("{}: unplugged: {reason}", pedal_name(config)),
                }
            }
            Err(error) => error.to_string(),
        };
        if reason != last_reason {
            last_reason.clone_from(&reason);
            sink(PedalEvent::Lost { reason });
        }
        let until_ns = clock.now_ns() + backoff_ns;
        while !stop.load(Ordering::Relaxed) && clock.now_ns() < until_ns {
            clock.sleep_until(until_ns.min(clock.now_ns() + 50_000_000));
        }
        backoff_ns = (backoff_ns * 2).min(MAX_BACKOFF_NS);
    }
    Ok(())
}

fn read_reports(
    device: &HidDevice,
    keys: &KeyMap,
    edges: &mut KeyEdgeDetector,
    clock: &dyn Clock,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(PedalEvent),
) -> Result<(), String> {
    let mut report = [0_u8; 64];
    while !stop.load(Ordering::Relaxed) {
        let length = device
            .read_timeout(&mut report, READ_TIMEOUT_MS)
            .map_err(|error| error.to_string())?;
        let at_ns = clock.now_ns();
        for usage in edges.report(&report[..length], at_ns) {
            sink(match keys.get(&usage) {
                Some(text) => PedalEvent::Trigger(TriggerEvent {
                    text: text.clone(),
                    at_ns,
                }),
                None => PedalEvent::Unmapped {
                    key: usage_key(usage).unwrap_or_else(|| format!("usage 0x{usage:02x}")),
                },
            });
        }
    }
    Ok(())
}

/// Product name of the pedal.
///
/// # Errors
/// `Config` for invalid keys, `Device` for an absent pedal, `Permission` with the udev rule.
pub fn find_pedal(config: &PedalConfig) -> Result<String> {
    key_map(config)?;
    open_pedal(config).map(|(_, product)| product)
}

fn pedal_name(config: &PedalConfig) -> String {
    format!("pedal {:04x}:{:04x}", config.vendor, config.product)
}

fn open_pedal(config: &PedalConfig) -> Result<(HidDevice, String)> {
    const GENERIC_DESKTOP: u16 = 1;
    const KEYBOARD: u16 = 6;
    let failed = |what: &str, error: hidapi::HidError| {
        device_error(what).at(pedal_name(config)).because(error)
    };
    let api = HidApi::new().map_err(|error| failed("cannot list HID devices", error))?;
    let mut found: Vec<(bool, i32, CString, String)> = api
        .device_list()
        .filter(|info| info.vendor_id() == config.vendor && info.product_id() == config.product)
        .map(|info| {
            let is_keyboard = info.usage_page() == GENERIC_DESKTOP && info.usage() == KEYBOARD;
            let product = info.product_string().unwrap_or_default().trim().to_owned();
            let path = info.path().to_owned();
            (!is_keyboard, info.interface_number(), path, product)
        })
        .collect();
    // Some pedals also have mouse and set-up interfaces: the keyboard sorts first.
    found.sort();
    let Some((_, _, path, product)) = found.into_iter().next() else {
        return Err(device_error("not plugged in")
            .at(pedal_name(config))
            .remedy("plug it in, or correct vendor and product in the rig file (see `lsusb`)"));
    };
    check_access(config, &path)?;
    let device = api
        .open_path(&path)
        .map_err(|error| failed("cannot open", error))?;
    let product = if product.is_empty() {
        pedal_name(config)
    } else {
        product
    };
    Ok((device, product))
}

/// Opens the node for the error of the operating system: hidapi has only its text.
fn check_access(config: &PedalConfig, path: &CStr) -> Result<()> {
    let path = path.to_string_lossy();
    match OpenOptions::new()
        .read(true)
        .write(true)
        .open(Path::new(&*path))
    {
        Ok(_) => Ok(()),
        Err(error) => Err(access_error(config, &path, error)),
    }
}

fn access_error(config: &PedalConfig, path: &str, error: io::Error) -> Error {
    let is_denied = error.kind() == io::ErrorKind::PermissionDenied;
    let error = Error::io(format!("cannot open {path}"), error).at(pedal_name(config));
    if !is_denied {
        return error;
    }
    error.remedy(format!(
        "put this line into {LOCAL_UDEV_RULES}:\n    {}\n    \
         then run: sudo udevadm control --reload && sudo udevadm trigger",
        pedal_udev_rule(config.vendor, config.product)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    const MS: u64 = 1_000_000;
    const A: u8 = 0x04;
    const B: u8 = 0x05;

    fn keys(down: &[u8]) -> [u8; 8] {
        let mut report = [0; 8];
        report[2..2 + down.len()].copy_from_slice(down);
        report
    }

    fn presses(sequence: &[(u64, &[u8])]) -> Vec<(u64, u8)> {
        let mut detector = KeyEdgeDetector::new(80 * MS);
        sequence
            .iter()
            .flat_map(|(at_ms, down)| {
                detector
                    .report(&keys(down), at_ms * MS)
                    .into_iter()
                    .map(move |usage| (*at_ms, usage))
            })
            .collect()
    }

    fn config(keys: &[(&str, &str)]) -> PedalConfig {
        PedalConfig {
            vendor: 0x0C45,
            product: 0x7403,
            keys: keys
                .iter()
                .map(|(key, command)| ((*key).to_owned(), (*command).to_owned()))
                .collect(),
            debounce_ms: 80,
        }
    }

    #[test]
    fn bounces_are_one_press() {
        let sequence: &[(u64, &[u8])] = &[
            (1000, &[A]),
            (1004, &[]),
            (1007, &[A]),
            (1500, &[]),
            (1503, &[A]),
            (1509, &[]),
        ];
        assert_eq!(presses(sequence), [(1000, A)]);
    }

    #[test]
    fn held_keys_do_not_repeat() {
        let sequence: &[(u64, &[u8])] = &[
            (0, &[A]),
            (30, &[A]),
            (600, &[A]),
            (700, &[]),
            (780, &[A]),
            (900, &[]),
        ];
        assert_eq!(presses(sequence), [(0, A), (780, A)]);
    }

    /// Some devices send a held key as short presses.
    #[test]
    fn repeated_reports_of_a_held_pedal_are_one_press() {
        let mut detector = KeyEdgeDetector::new(150 * MS);
        let mut pressed = Vec::new();
        for press in 0..30 {
            let at_ns = 90 * MS * press;
            pressed.extend(detector.report(&keys(&[A]), at_ns));
            pressed.extend(detector.report(&keys(&[]), at_ns + 5 * MS));
        }
        assert_eq!(pressed, [A]);
        assert_eq!(detector.report(&keys(&[A]), 3_000 * MS), [A]);
    }

    #[test]
    fn keys_are_debounced_independently() {
        let sequence: &[(u64, &[u8])] = &[(0, &[A]), (10, &[A, B]), (20, &[B]), (30, &[])];
        assert_eq!(presses(sequence), [(0, A), (10, B)]);
    }

    #[test]
    fn invalid_reports_are_ignored() {
        let mut detector = KeyEdgeDetector::new(0);
        assert_eq!(detector.report(&[1, 0, 0, A, 0, 0, 0, 0, 0], 0), [A]);
        assert!(detector.report(&[0, 0, 1, 1, 1, 1, 1, 1], 1).is_empty());
        assert!(detector.report(&[0, 0, B], 2).is_empty());
        assert!(detector.report(&[], 3).is_empty());
        assert_eq!(detector.report(&keys(&[A, B]), 4), [B]);
    }

    #[test]
    fn reset_releases_all_keys() {
        let mut detector = KeyEdgeDetector::new(80 * MS);
        assert_eq!(detector.report(&keys(&[A]), 0), [A]);
        detector.reset();
        assert_eq!(detector.report(&keys(&[A]), 1000 * MS), [A]);
    }

    #[test]
    fn key_names_round_trip() {
        for usage in 0..=u8::MAX {
            if let Some(name) = usage_key(usage) {
                assert_eq!(key_usage(&name), Some(usage), "{name}");
            }
        }
        for (name, usage) in [
            ("a", 0x04),
            ("z", 0x1D),
            ("1", 0x1E),
            ("0", 0x27),
            ("f12", 0x45),
        ] {
            assert_eq!(key_usage(name), Some(usage));
        }
        for name in ["", "A", "f0", "f01", "f13", "pgdn", "ä"] {
            assert_eq!(key_usage(name), None, "{name}");
        }
    }

    #[test]
    fn unknown_keys_are_rejected() {
        let map = key_map(&config(&[("b", "trigger"), ("page_down", "stable")])).unwrap();
        assert_eq!(map.get(&B).map(String::as_str), Some("trigger"));
        assert_eq!(map.get(&0x4E).map(String::as_str), Some("stable"));
        assert_eq!(map.get(&A), None);
        let error = key_map(&config(&[("pgdn", "stable")])).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Config);
        assert!(
            error
                .to_string()
                .contains("pedal 0c45:7403: unknown key `pgdn`")
        );
        assert!(key_map(&config(&[])).is_err());
    }

    #[test]
    fn permission_error_has_the_udev_rule() {
        let denied = io::Error::from(io::ErrorKind::PermissionDenied);
        let error = access_error(&config(&[]), "/dev/hidraw3", denied);
        assert_eq!(error.kind(), ErrorKind::Permission);
        let text = error.to_string();
        assert!(text.contains("/dev/hidraw3"), "{text}");
        assert!(
            text.contains(
                r#"KERNEL=="hidraw*", ATTRS{idVendor}=="0c45", ATTRS{idProduct}=="7403""#
            ),
            "{text}"
        );
    }
}
