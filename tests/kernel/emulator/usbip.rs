//! The USB/IP wire format between `vhci_hcd` and an emulated device, after the handshake.
//!
//! Every message starts with 48 bytes of big-endian words (Linux
//! `Documentation/usb/usbip_protocol.rst`); isochronous packet descriptors follow the data.

use std::io::{self, Read};

const HEADER_BYTES: usize = 48;
const PACKET_BYTES: usize = 16;
/// More than any URB of uvcvideo or usbhid; a larger length means that the stream is out of step.
const MAX_TRANSFER: usize = 4 << 20;
const MAX_PACKETS: usize = 1024;

const CMD_SUBMIT: u32 = 1;
const CMD_UNLINK: u32 = 2;
const RET_SUBMIT: u32 = 3;
const RET_UNLINK: u32 = 4;

/// Status of a transfer, as a negative Linux error number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    Ok,
    /// The endpoint stalls: the request is not supported.
    Stall,
    /// The transfer was taken back by the host before it was done.
    Unlinked,
    /// Data of an isochronous packet was lost on the bus.
    PacketLost,
}

impl Status {
    fn code(self) -> i32 {
        match self {
            Self::Ok => 0,
            Self::Stall => -32,
            Self::Unlinked => -104,
            Self::PacketLost => -18,
        }
    }
}

/// Where an isochronous packet lies in the transfer buffer of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Packet {
    pub(crate) offset: u32,
    pub(crate) length: u32,
}

/// An answered isochronous packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PacketDone {
    pub(crate) packet: Packet,
    pub(crate) actual: u32,
    pub(crate) status: Status,
}

/// A transfer that the host asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Submit {
    pub(crate) seq: u32,
    pub(crate) endpoint: u8,
    /// Device to host.
    pub(crate) is_in: bool,
    pub(crate) length: u32,
    /// Setup packet of a control transfer.
    pub(crate) setup: [u8; 8],
    /// Data of an OUT transfer.
    pub(crate) data: Vec<u8>,
    /// Empty unless the transfer is isochronous.
    pub(crate) packets: Vec<Packet>,
}

/// A message from the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    Submit(Submit),
    /// Takes the transfer `victim` back.
    Unlink {
        seq: u32,
        victim: u32,
    },
}

fn out_of_step(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

fn word(bytes: &[u8], index: usize) -> u32 {
    let mut word = [0; 4];
    word.copy_from_slice(&bytes[index * 4..index * 4 + 4]);
    u32::from_be_bytes(word)
}

/// Reads the next message; fails with `UnexpectedEof` once the host has let go of the device.
pub(crate) fn read_request(from: &mut impl Read) -> io::Result<Request> {
    let mut header = [0; HEADER_BYTES];
    from.read_exact(&mut header)?;
    let seq = word(&header, 1);
    match word(&header, 0) {
        CMD_UNLINK => Ok(Request::Unlink {
            seq,
            victim: word(&header, 5),
        }),
        CMD_SUBMIT => {
            let is_in = word(&header, 3) == 1;
            let length = word(&header, 6);
            if length as usize > MAX_TRANSFER {
                return Err(out_of_step(format!("transfer of {length} bytes")));
            }
            // Documented as -1 where a transfer is not isochronous; the kernel sends 0.
            let packet_count = match word(&header, 8) {
                u32::MAX => 0,
                count if count as usize <= MAX_PACKETS => count as usize,
                count => return Err(out_of_step(format!("{count} isochronous packets"))),
            };
            let mut setup = [0; 8];
            setup.copy_from_slice(&header[40..48]);
            let mut data = vec![0; if is_in { 0 } else { length as usize }];
            from.read_exact(&mut data)?;
            let mut descriptors = vec![0; packet_count * PACKET_BYTES];
            from.read_exact(&mut descriptors)?;
            let packets = descriptors
                .chunks_exact(PACKET_BYTES)
                .map(|bytes| Packet {
                    offset: word(bytes, 0),
                    length: word(bytes, 1),
                })
                .collect();
            Ok(Request::Submit(Submit {
                seq,
                endpoint: (word(&header, 4) & 0x0f) as u8,
                is_in,
                length,
                setup,
                data,
                packets,
            }))
        }
        other => Err(out_of_step(format!("message of unknown kind {other}"))),
    }
}

fn push_words(to: &mut Vec<u8>, words: &[u32]) {
    for word in words {
        to.extend_from_slice(&word.to_be_bytes());
    }
}

/// Answer to a [`Submit`]: `actual` bytes were moved; `data` holds them for an IN transfer.
/// Isochronous data is compacted: only the actual bytes of each packet, without gaps.
pub(crate) fn submit_reply(
    seq: u32,
    status: Status,
    data: &[u8],
    actual: u32,
    packets: &[PacketDone],
) -> Vec<u8> {
    let mut reply = Vec::with_capacity(HEADER_BYTES + data.len() + packets.len() * PACKET_BYTES);
    let lost = packets.iter().filter(|p| p.status != Status::Ok).count();
    #[rustfmt::skip]
    push_words(&mut reply, &[
        RET_SUBMIT, seq, 0, 0, 0,
        status.code().cast_unsigned(), actual, 0, packets.len() as u32, lost as u32, 0, 0,
    ]);
    reply.extend_from_slice(data);
    for done in packets {
        push_words(
            &mut reply,
            &[
                done.packet.offset,
                done.packet.length,
                done.actual,
                done.status.code().cast_unsigned(),
            ],
        );
    }
    reply
}

/// Answer to an unlink: `Unlinked` where the transfer was still waiting, `Ok` where its answer
/// had already been sent.
pub(crate) fn unlink_reply(seq: u32, status: Status) -> Vec<u8> {
    let mut reply = Vec::with_capacity(HEADER_BYTES);
    #[rustfmt::skip]
    push_words(&mut reply, &[
        RET_UNLINK, seq, 0, 0, 0, status.code().cast_unsigned(), 0, 0, 0, 0, 0, 0,
    ]);
    reply
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(words: [u32; 10], setup: [u8; 8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        push_words(&mut bytes, &words);
        bytes.extend_from_slice(&setup);
        bytes
    }

    #[test]
    fn control_write_carries_setup_and_data() {
        let setup = [0x21, 1, 0, 2, 1, 0, 3, 0];
        let mut bytes = message([1, 7, 0x10001, 0, 0, 0, 3, 0, 0, 0], setup);
        bytes.extend_from_slice(&[9, 8, 7]);
        let Request::Submit(submit) = read_request(&mut bytes.as_slice()).unwrap() else {
            panic!("expected a submit");
        };
        assert_eq!((submit.seq, submit.endpoint, submit.is_in), (7, 0, false));
        assert_eq!(submit.setup, setup);
        assert_eq!(submit.data, [9, 8, 7]);
        assert!(submit.packets.is_empty());
    }

    #[test]
    fn isochronous_read_carries_packets_and_no_data() {
        let mut bytes = message([1, 9, 0x10001, 1, 1, 0, 6144, 0, 2, 1], [0; 8]);
        push_words(&mut bytes, &[0, 3072, 0, 0, 3072, 3072, 0, 0]);
        let Request::Submit(submit) = read_request(&mut bytes.as_slice()).unwrap() else {
            panic!("expected a submit");
        };
        assert!(submit.is_in && submit.data.is_empty());
        assert_eq!(submit.packets[1].offset, 3072);
    }

    #[test]
    fn both_ways_of_saying_not_isochronous_are_understood() {
        for count in [0, u32::MAX] {
            let bytes = message([1, 9, 0, 1, 1, 0, 8, 0, count, 10], [0; 8]);
            let request = read_request(&mut bytes.as_slice()).unwrap();
            assert!(matches!(request, Request::Submit(s) if s.packets.is_empty()));
        }
    }

    #[test]
    fn unlink_names_its_victim() {
        let bytes = message([2, 12, 0, 0, 0, 11, 0, 0, 0, 0], [0; 8]);
        assert_eq!(
            read_request(&mut bytes.as_slice()).unwrap(),
            Request::Unlink {
                seq: 12,
                victim: 11
            }
        );
    }

    #[test]
    fn nonsense_and_a_cut_message_are_errors() {
        let unknown = message([5, 0, 0, 0, 0, 0, 0, 0, 0, 0], [0; 8]);
        assert!(read_request(&mut unknown.as_slice()).is_err());
        let huge = message([1, 0, 0, 0, 0, 0, u32::MAX, 0, 0, 0], [0; 8]);
        assert!(read_request(&mut huge.as_slice()).is_err());
        let cut = read_request(&mut &unknown[..20]).unwrap_err();
        assert_eq!(cut.kind(), io::ErrorKind::UnexpectedEof);
    }

    #[test]
    fn replies_have_the_layout_of_the_kernel() {
        let done = PacketDone {
            packet: Packet {
                offset: 0,
                length: 3072,
            },
            actual: 0,
            status: Status::PacketLost,
        };
        let reply = submit_reply(4, Status::Ok, &[1, 2], 2, &[done]);
        assert_eq!(reply.len(), 48 + 2 + 16);
        assert_eq!((word(&reply, 0), word(&reply, 1)), (3, 4));
        assert_eq!(
            (word(&reply, 6), word(&reply, 8), word(&reply, 9)),
            (2, 1, 1)
        );
        assert_eq!(word(&reply[50..], 3), (-18_i32).cast_unsigned());

        let reply = unlink_reply(5, Status::Unlinked);
        assert_eq!(reply.len(), 48);
        assert_eq!(word(&reply, 5), (-104_i32).cast_unsigned());
    }
}
