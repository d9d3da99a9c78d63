//! A foot switch as factories ship it: a USB boot keyboard with the one key `b`.

use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use crate::descriptors;
use crate::link::Link;

/// Interrupt IN endpoint.
pub(crate) const ENDPOINT: u8 = 1;

const HID_DESCRIPTOR: u8 = 0x21;
/// HID usage of the key `b`.
const KEY_B: u8 = 0x05;
const REPORT_BYTES: u8 = 8;

/// Boot keyboard of the HID specification, appendix B.1, without its LEDs:
/// modifiers, a reserved byte, six keys.
#[rustfmt::skip]
pub(crate) const REPORT_DESCRIPTOR: [u8; 43] = [
    0x05, 0x01, 0x09, 0x06, 0xa1, 0x01,
    0x05, 0x07, 0x19, 0xe0, 0x29, 0xe7, 0x15, 0x00, 0x25, 0x01,
    0x75, 0x01, 0x95, 0x08, 0x81, 0x02,
    0x95, 0x01, 0x75, 0x08, 0x81, 0x01,
    0x95, 0x06, 0x75, 0x08, 0x15, 0x00, 0x25, 0x65,
    0x19, 0x00, 0x29, 0x65, 0x81, 0x00,
    0xc0,
];

/// Configuration with one HID interface.
pub(crate) fn configuration() -> Vec<u8> {
    const BOOT_KEYBOARD: [u8; 3] = [3, 1, 1];
    const INTERRUPT: u8 = 3;
    const INTERVAL_MS: u8 = 10;
    let mut body = vec![9, 4, 0, 0, 1];
    body.extend_from_slice(&BOOT_KEYBOARD);
    body.push(0);
    let report_length = REPORT_DESCRIPTOR.len() as u8;
    body.extend_from_slice(&[9, HID_DESCRIPTOR, 0x11, 0x01, 0, 1, 0x22, report_length, 0]);
    body.extend_from_slice(&[
        7,
        5,
        0x80 | ENDPOINT,
        INTERRUPT,
        REPORT_BYTES,
        0,
        INTERVAL_MS,
    ]);
    descriptors::configuration(1, &body)
}

/// A report and when it leaves the pedal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Report {
    pub(crate) due: Instant,
    pub(crate) bytes: [u8; REPORT_BYTES as usize],
}

/// Reports of one press that starts `now`; a worn contact bounces twice before it holds and
/// once when it is let go.
pub(crate) fn press(now: Instant, bounces: bool) -> Vec<Report> {
    let edges_ms: &[u64] = if bounces {
        &[0, 12, 24, 36, 48, 160, 172, 184]
    } else {
        &[0, 150]
    };
    edges_ms
        .iter()
        .enumerate()
        .map(|(index, &after_ms)| {
            let mut bytes = [0; REPORT_BYTES as usize];
            if index % 2 == 0 {
                bytes[2] = KEY_B;
            }
            Report {
                due: now + Duration::from_millis(after_ms),
                bytes,
            }
        })
        .collect()
}

/// Sends reports until the pedal is unplugged.
pub(crate) fn pump(link: &Arc<Link>, reports: &Receiver<Report>) {
    for report in reports {
        if link.sleep_until(report.due).is_err()
            || link.answer_interrupt(ENDPOINT, &report.bytes).is_err()
        {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn press_ends_with_key_up() {
        let now = Instant::now();
        for bounces in [false, true] {
            let reports = press(now, bounces);
            assert_eq!(reports.first().unwrap().bytes[2], KEY_B);
            assert_eq!(reports.last().unwrap().bytes, [0; 8]);
            assert!(reports.is_sorted_by_key(|r| r.due));
        }
    }
}
