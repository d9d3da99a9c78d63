//! The sending side of a camera stream: images cut into isochronous UVC payloads, paced by
//! the clock.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::descriptors::StreamPlace;
use crate::feed::{Clock, Feed, Transmission};
use crate::link::{Interrupted, Link, Streaming};
use crate::usbip::{PacketDone, Status, Submit};

const PAYLOAD_HEADER: usize = 12;
/// Clock that presentation times count in, Hz; as in the video-control header.
const CLOCK_HZ: u128 = 48_000_000;

/// Bits of the payload header (UVC 1.00 §2.4.3.3).
mod header_bit {
    pub(super) const FRAME_ID: u8 = 0x01;
    pub(super) const END_OF_FRAME: u8 = 0x02;
    pub(super) const TIMES_PRESENT: u8 = 0x0c;
    pub(super) const ERROR: u8 = 0x40;
    pub(super) const END_OF_HEADER: u8 = 0x80;
}

/// Payload header: length, bits, presentation time, source clock and frame number.
fn payload_header(bits: u8, since_start: Duration) -> [u8; PAYLOAD_HEADER] {
    let ticks = (since_start.as_nanos() * CLOCK_HZ / 1_000_000_000) as u32;
    let usb_frame = (since_start.as_millis() % 2048) as u16;
    let mut header = [0; PAYLOAD_HEADER];
    header[0] = PAYLOAD_HEADER as u8;
    header[1] = bits | header_bit::TIMES_PRESENT | header_bit::END_OF_HEADER;
    header[2..6].copy_from_slice(&ticks.to_le_bytes());
    header[6..10].copy_from_slice(&ticks.to_le_bytes());
    header[10..12].copy_from_slice(&usb_frame.to_le_bytes());
    header
}

/// An image that is being cut into payloads.
struct Payloads<'a> {
    transmission: &'a Transmission,
    frame_id: u8,
    presented: Duration,
    sent_bytes: usize,
    sent_packets: usize,
}

impl Payloads<'_> {
    fn is_done(&self) -> bool {
        self.sent_bytes >= self.transmission.bytes.len()
    }

    /// Fills one transfer of the host.
    fn fill(&mut self, submit: &Submit) -> (Vec<u8>, Vec<PacketDone>) {
        let mut data = Vec::with_capacity(submit.length as usize);
        let packets = submit
            .packets
            .iter()
            .map(|&packet| {
                let before = data.len();
                let status = self.push_payload(packet.length as usize, &mut data);
                PacketDone {
                    packet,
                    actual: (data.len() - before) as u32,
                    status,
                }
            })
            .collect();
        (data, packets)
    }

    /// Appends a payload of at most `room` bytes; nothing once the image is done.
    fn push_payload(&mut self, room: usize, data: &mut Vec<u8>) -> Status {
        if self.is_done() {
            return Status::Ok;
        }
        let rest = &self.transmission.bytes[self.sent_bytes..];
        let part = &rest[..rest.len().min(room.saturating_sub(PAYLOAD_HEADER))];
        self.sent_bytes += part.len();
        self.sent_packets += 1;
        if self.transmission.loses_packet && self.sent_packets == 2 {
            return Status::PacketLost;
        }
        let mut bits = self.frame_id;
        if self.is_done() {
            bits |= header_bit::END_OF_FRAME;
        }
        if self.transmission.has_error_bit {
            bits |= header_bit::ERROR;
        }
        data.extend_from_slice(&payload_header(bits, self.presented));
        data.extend_from_slice(part);
        Status::Ok
    }
}

/// Sends images whenever the host streams, until the camera is unplugged.
pub(crate) fn pump(link: &Arc<Link>, place: StreamPlace, feed: &Arc<Feed>) {
    while let Some(streaming) = link.wait_for_stream(place.interface) {
        if let Err(Interrupted::Unplugged) = run(link, place, feed, streaming) {
            return;
        }
    }
}

/// Sends image after image; ends only by an interruption. Image n is due n intervals
/// after the start; what a slow machine misses is skipped.
fn run(
    link: &Link,
    place: StreamPlace,
    feed: &Feed,
    streaming: Streaming,
) -> Result<(), Interrupted> {
    let interval = Duration::from_nanos(1_000_000_000 / u64::from(streaming.mode.fps));
    let mut frame_id = 0;
    let mut slot: u32 = 0;
    let mut presented = Duration::ZERO;
    loop {
        let passed = Instant::now().saturating_duration_since(streaming.since);
        slot = (slot + 1).max((passed.as_nanos() / interval.as_nanos()) as u32);
        link.sleep_while_streaming(
            place.interface,
            streaming,
            streaming.since + interval * slot,
        )?;
        let Some(transmission) = feed.next(streaming.mode) else {
            continue;
        };
        frame_id ^= header_bit::FRAME_ID;
        presented = match transmission.clock {
            Clock::Runs => streaming.since.elapsed(),
            Clock::StandsStill => presented,
            Clock::Ahead(by) => streaming.since.elapsed() + by,
        };
        let mut payloads = Payloads {
            transmission: &transmission,
            frame_id,
            presented,
            sent_bytes: 0,
            sent_packets: 0,
        };
        while !payloads.is_done() {
            link.answer_isochronous(place.endpoint, place.interface, streaming, |submit| {
                payloads.fill(submit)
            })?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::usbip::Packet;

    fn submit(packets: u32) -> Submit {
        Submit {
            seq: 1,
            endpoint: 1,
            is_in: true,
            length: packets * 112,
            setup: [0; 8],
            data: Vec::new(),
            packets: (0..packets)
                .map(|k| Packet {
                    offset: k * 112,
                    length: 112,
                })
                .collect(),
        }
    }

    fn transmission(loses_packet: bool) -> Transmission {
        Transmission {
            bytes: Arc::new((0..250).map(|k| k as u8).collect()),
            has_error_bit: false,
            loses_packet,
            clock: Clock::Runs,
        }
    }

    fn payloads(transmission: &Transmission) -> Payloads<'_> {
        Payloads {
            transmission,
            frame_id: 1,
            presented: Duration::from_millis(40),
            sent_bytes: 0,
            sent_packets: 0,
        }
    }

    #[test]
    fn payloads_join_to_the_image_and_the_last_one_ends_it() {
        let transmission = transmission(false);
        let mut payloads = payloads(&transmission);
        let (mut data, mut done) = payloads.fill(&submit(2));
        assert!(!payloads.is_done());
        let (more, more_done) = payloads.fill(&submit(2));
        data.extend(more);
        done.extend(more_done);
        assert!(payloads.is_done());
        let lengths: Vec<u32> = done.iter().map(|p| p.actual).collect();
        assert_eq!(lengths, [112, 112, 62, 0]);

        let mut joined = Vec::new();
        let mut ends = Vec::new();
        let mut at = 0;
        for packet in done.iter().filter(|p| p.actual > 0) {
            ends.push(data[at + 1] & header_bit::END_OF_FRAME != 0);
            joined.extend_from_slice(&data[at + PAYLOAD_HEADER..at + packet.actual as usize]);
            at += packet.actual as usize;
        }
        assert_eq!(joined, *transmission.bytes);
        assert_eq!(ends, [false, false, true]);
    }

    #[test]
    fn lost_packet_carries_no_data() {
        let transmission = transmission(true);
        let (data, done) = payloads(&transmission).fill(&submit(3));
        assert_eq!(done[1].status, Status::PacketLost);
        assert_eq!(done[1].actual, 0);
        assert_eq!(data.len(), 112 + 62);
    }
}
