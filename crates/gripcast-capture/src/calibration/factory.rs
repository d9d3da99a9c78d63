//! Factory intrinsics of a RealSense D435, read through its UVC extension unit.
//!
//! Extension unit 3 of the stereo function, selector 1, exchanges messages of 1024 bytes,
//! little-endian. Request: u16 length after the first four bytes (20), u16 magic, u32 opcode, four
//! u32 parameters. Reply: u32 opcode (or an error code), payload, u32 payload length at 1020.
//! Payload of the colour table: 16 bytes of header with a CRC-32, then the calibration, normalised
//! by the image's width and height.

use std::io;

use crate::camera::{ExtensionRequest, VideoNode, VideoNodes};
use crate::device::{self, SystemRoot, device_error};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{DistortionModel, Intrinsics};

const UNIT: u8 = 3;
const SELECTOR: u8 = 1;
const TRANSFER_BYTES: usize = 1024;
const LENGTH_AT: usize = 1020;
const MAGIC: u16 = 0xcdab;
const GET_CALIBRATION: u32 = 0x15;
const COLOUR_TABLE: u32 = 0x20;
const TABLE_HEADER_BYTES: usize = 16;
/// Floats: intrinsics 9, distortion 5, rotation 3, translation 3, projection 12.
const FLOATS: usize = 32;
/// Maximum number of attempts while the camera is busy.
const ATTEMPTS: usize = 5;

/// Reads the intrinsics of the colour camera of the D435 in a USB port. Works while it streams.
///
/// # Errors
/// `Device` for a missing camera or an invalid reply.
pub fn colour_intrinsics(
    root: &SystemRoot,
    nodes: &dyn VideoNodes,
    port: &str,
    width: u32,
    height: u32,
) -> Result<Intrinsics> {
    let devices = device::scan(root)?;
    let stereo = devices
        .iter()
        .filter(|d| d.port == port && d.is_camera())
        .min_by_key(|d| d.interface)
        .ok_or_else(|| device_error(format!("no camera in port {port}")))?;
    let mut node = nodes
        .open(&stereo.node)
        .map_err(|e| device::open_error(root, stereo, "open", e))?;
    ColourTable::read(node.as_mut())
        .and_then(|table| table.intrinsics(width, height))
        .map_err(|error| error.at(stereo))
}

/// Calibration of the colour camera, independent of the image size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColourTable {
    /// Intrinsic matrix in transmitted order.
    matrix: [f64; 9],
    /// Coefficients k1, k2, p1, p2, k3.
    coefficients: [f64; 5],
    /// Image size of the calibration, pixels; zero if unknown.
    width: u16,
    height: u16,
}

impl ColourTable {
    /// Reads the table from an open node of the stereo function.
    ///
    /// # Errors
    /// For a failed request or an invalid reply.
    pub fn read(node: &mut dyn VideoNode) -> Result<Self> {
        Self::parse(&exchange(
            node,
            request(GET_CALIBRATION, [COLOUR_TABLE, 0, 0, 0]),
        )?)
    }

    /// Parses the payload of a reply.
    ///
    /// # Errors
    /// `Device` for a truncated, damaged or different table.
    pub fn parse(payload: &[u8]) -> Result<Self> {
        let bad = |what: String| device_error(what).remedy(FALLBACK);
        let size = u32_at(payload, 4).unwrap_or(0) as usize;
        let table = payload
            .get(TABLE_HEADER_BYTES..)
            .and_then(|rest| rest.get(..size))
            .filter(|table| table.len() >= FLOATS * 4 + 4)
            .ok_or_else(|| {
                bad(format!(
                    "the colour calibration is truncated: {} bytes for a table of {size}",
                    payload.len()
                ))
            })?;
        let kind = u16_at(payload, 2).map_or(0, u32::from);
        if kind != COLOUR_TABLE {
            return Err(bad(format!(
                "expected calibration table {COLOUR_TABLE}, found table {kind}"
            )));
        }
        let (stated, found) = (u32_at(payload, 12).unwrap_or(0), crc32(table));
        if stated != found {
            return Err(bad(format!(
                "the colour calibration is damaged: CRC {found:08x}, expected {stated:08x}"
            )));
        }
        let float = |i: usize| {
            let bytes = [0, 1, 2, 3].map(|k| table[4 * i + k]);
            f64::from(f32::from_le_bytes(bytes))
        };
        Ok(Self {
            matrix: std::array::from_fn(float),
            coefficients: std::array::from_fn(|i| float(9 + i)),
            width: u16_at(table, FLOATS * 4).unwrap_or(0),
            height: u16_at(table, FLOATS * 4 + 2).unwrap_or(0),
        })
    }

    /// Intrinsics for an image size. A different aspect ratio crops the longer side and keeps the
    /// focal length in pixels of the other.
    ///
    /// # Errors
    /// `Config` for implausible intrinsics.
    pub fn intrinsics(&self, width: u32, height: u32) -> Result<Intrinsics> {
        let (w, h) = (f64::from(width), f64::from(height));
        let wanted = h / w;
        let calibrated = if self.width > 0 && self.height > 0 {
            f64::from(self.height) / f64::from(self.width)
        } else {
            9.0 / 16.0
        };
        let (along_x, along_y) = if wanted < calibrated {
            (1.0, calibrated / wanted)
        } else {
            (wanted / calibrated, 1.0)
        };
        let m = &self.matrix;
        Intrinsics {
            width,
            height,
            fx: m[0] * along_x * w / 2.0,
            fy: m[4] * along_y * h / 2.0,
            cx: (1.0 + m[2] * along_x) * w / 2.0,
            cy: (1.0 + m[5] * along_y) * h / 2.0,
            model: DistortionModel::InverseBrownConrady,
            coefficients: self.coefficients,
        }
        .validate()
    }
}

const FALLBACK: &str = "give an intrinsics file instead";

/// A request to the firmware.
fn request(opcode: u32, parameters: [u32; 4]) -> [u8; TRANSFER_BYTES] {
    let mut bytes = [0; TRANSFER_BYTES];
    bytes[0..2].copy_from_slice(&20_u16.to_le_bytes());
    bytes[2..4].copy_from_slice(&MAGIC.to_le_bytes());
    let words = [opcode].into_iter().chain(parameters);
    for (slot, word) in bytes[4..24].chunks_exact_mut(4).zip(words) {
        slot.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

/// Payload of a reply to `opcode`.
fn reply_payload(opcode: u32, reply: &[u8; TRANSFER_BYTES]) -> Result<&[u8]> {
    let echo = u32_at(reply, 0).unwrap_or(0);
    if echo != opcode {
        return Err(device_error(format!(
            "the camera rejects command {opcode:#x} with code {}",
            echo.cast_signed()
        ))
        .remedy(FALLBACK));
    }
    let length = u32_at(reply, LENGTH_AT).unwrap_or(0) as usize;
    reply[4..LENGTH_AT].get(..length).ok_or_else(|| {
        device_error(format!(
            "the reply of the camera is too long: {length} bytes"
        ))
        .remedy(FALLBACK)
    })
}

fn exchange(node: &mut dyn VideoNode, request: [u8; TRANSFER_BYTES]) -> Result<Vec<u8>> {
    let opcode = u32_at(&request, 4).unwrap_or(0);
    let mut outcome = Ok(());
    for _ in 0..ATTEMPTS {
        let (mut sent, mut reply) = (request, [0; TRANSFER_BYTES]);
        outcome = node
            .extension_unit(UNIT, SELECTOR, ExtensionRequest::Set, &mut sent)
            .and_then(|()| node.extension_unit(UNIT, SELECTOR, ExtensionRequest::Get, &mut reply));
        match &outcome {
            Ok(()) => return reply_payload(opcode, &reply).map(<[u8]>::to_vec),
            Err(error) if !is_transient(error) => break,
            Err(_) => {}
        }
    }
    let cause = outcome.err().unwrap_or_else(|| io::ErrorKind::Other.into());
    if cause.raw_os_error() == Some(libc::ENOENT) {
        let what = format!("the camera has no extension unit {UNIT} with its calibration");
        return Err(device_error(what).remedy(FALLBACK));
    }
    Err(Error::io("cannot read the calibration of the camera", cause).remedy(FALLBACK))
}

/// Whether a retry may succeed.
fn is_transient(error: &io::Error) -> bool {
    matches!(
        error.raw_os_error(),
        Some(libc::EIO | libc::EAGAIN | libc::EBUSY)
    )
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(bytes);
    crc.sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    use crate::camera::{FakeCamera, FakeNodes};
    use gripcast_testing::sysfs_tree::{Tree, d435};

    /// A table calibrated at 1920×1080 with fx = fy = 1380 px, principal point (967, 543).
    fn payload() -> Vec<u8> {
        let (fx, fy) = (1380.0 / 960.0, 1380.0 / 540.0);
        let (x, y) = (967.0 / 960.0 - 1.0, 543.0 / 540.0 - 1.0);
        let mut floats = vec![fx, 0.0, x, 0.0, fy, y, 0.0, 0.0, 1.0_f32];
        floats.extend([0.125, -0.25, 0.5, 0.0, 0.0625]);
        floats.resize(FLOATS, 0.0);
        let mut table: Vec<u8> = floats.iter().flat_map(|f| f.to_le_bytes()).collect();
        table.extend(1920_u16.to_le_bytes());
        table.extend(1080_u16.to_le_bytes());
        table.resize(256, 0);
        let mut payload = vec![1, 2];
        payload.extend(32_u16.to_le_bytes());
        payload.extend(256_u32.to_le_bytes());
        payload.extend(0_u32.to_le_bytes());
        payload.extend(crc32(&table).to_le_bytes());
        payload.extend(table);
        payload
    }

    fn reply(opcode: u32, payload: &[u8]) -> [u8; TRANSFER_BYTES] {
        let mut bytes = [0; TRANSFER_BYTES];
        bytes[..4].copy_from_slice(&opcode.to_le_bytes());
        bytes[4..4 + payload.len()].copy_from_slice(payload);
        bytes[LENGTH_AT..].copy_from_slice(&(payload.len() as u32).to_le_bytes());
        bytes
    }

    #[test]
    fn crc_matches_the_check_value() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
    }

    #[test]
    fn request_layout() {
        let bytes = request(GET_CALIBRATION, [COLOUR_TABLE, 0, 0, 0]);
        assert_eq!(
            bytes[..12],
            [20, 0, 0xab, 0xcd, 0x15, 0, 0, 0, 0x20, 0, 0, 0]
        );
        assert!(bytes[12..].iter().all(|&b| b == 0));
    }

    #[test]
    fn table_scales_to_full_smaller_and_cropped_images() {
        let table = ColourTable::parse(&payload()).unwrap();
        let close = |a: f64, b: f64| (a - b).abs() < 1e-3;
        let full = table.intrinsics(1920, 1080).unwrap();
        assert!(close(full.fx, 1380.0) && close(full.fy, 1380.0));
        assert!(close(full.cx, 967.0) && close(full.cy, 543.0));
        assert_eq!(full.coefficients, [0.125, -0.25, 0.5, 0.0, 0.0625]);
        let hd = table.intrinsics(1280, 720).unwrap();
        assert!(close(hd.fx, 920.0) && close(hd.cx, 967.0 / 1.5));
        // 640×480 is the centre of 853×480.
        let vga = table.intrinsics(640, 480).unwrap();
        assert!(
            close(vga.fx, 1380.0 * 480.0 / 1080.0) && close(vga.fx, vga.fy),
            "{vga:?}"
        );
        assert!(close(vga.cx, 320.0 + 7.0 * 480.0 / 1080.0), "{vga:?}");
        let wide = table.intrinsics(1920, 800).unwrap();
        assert!(close(wide.fx, 1380.0) && close(wide.fy, 1380.0), "{wide:?}");
        assert!(close(wide.cy, 400.0 + 3.0), "{wide:?}");
    }

    #[test]
    fn damaged_tables_and_replies_are_rejected() {
        let good = payload();
        for length in 0..good.len() {
            assert!(ColourTable::parse(&good[..length]).is_err(), "{length}");
        }
        let mut flipped = good.clone();
        flipped[40] ^= 1;
        let error = ColourTable::parse(&flipped).unwrap_err();
        assert!(error.to_string().contains("damaged: CRC"), "{error}");
        let mut other = good;
        other[2] = 25;
        assert!(
            ColourTable::parse(&other)
                .unwrap_err()
                .to_string()
                .contains("table 25")
        );

        let error = reply_payload(0x15, &reply(0xffff_fffa, &[])).unwrap_err();
        assert!(error.to_string().contains("with code -6"), "{error}");
        let mut long = reply(0x15, &[]);
        long[LENGTH_AT..].copy_from_slice(&1017_u32.to_le_bytes());
        assert!(reply_payload(0x15, &long).is_err());
    }

    #[test]
    fn stereo_function_is_queried() {
        let mut tree = Tree::new();
        let nodes = FakeNodes::default();
        let first = tree.plug(d435("4-1"), &[(0, 4), (3, 2)]);
        let camera = nodes.insert(
            tree.node(first),
            FakeCamera {
                extension: reply(0x15, &payload()).to_vec(),
                ..FakeCamera::default()
            },
        );
        let root = SystemRoot {
            sys: tree.path("sys"),
            dev: tree.path("dev"),
            proc: tree.path("proc"),
        };
        let found = colour_intrinsics(&root, &nodes, "4-1", 1920, 1080).unwrap();
        assert!((found.fx - 1380.0).abs() < 1e-3);
        let sent = camera.lock().unwrap().extension_set.clone();
        assert_eq!(sent, request(0x15, [0x20, 0, 0, 0]));
        let error = colour_intrinsics(&root, &nodes, "4-2", 1920, 1080).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Device);
    }
}
