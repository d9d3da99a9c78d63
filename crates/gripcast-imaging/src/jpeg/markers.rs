//! Parser of the marker segments of a JPEG (ITU T.81 annex B).

use std::borrow::Cow;

use super::code;
use super::damage::JpegDamage;
use super::entropy::{self, BlockTables, Scan};
use super::standard_tables;

/// Maximum number of pixels.
const MAX_PIXELS: u64 = 1 << 26;

/// Chroma subsampling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Subsampling {
    /// No colour.
    Grey,
    /// Full chroma resolution.
    S444,
    /// Half horizontal chroma resolution (UVC cameras).
    S422,
    /// Half chroma resolution in both directions.
    S420,
    /// Half vertical chroma resolution.
    S440,
    /// Quarter horizontal chroma resolution.
    S411,
    /// Other sampling factors.
    Other,
}

/// Header of a JPEG.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct JpegHeader {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Number of components: 1 (grey) or 3 (YCbCr).
    pub components: u8,
    /// Chroma subsampling.
    pub subsampling: Subsampling,
    /// Whether the image is progressive.
    pub progressive: bool,
    /// Whether the file has all Huffman tables of its scans. UVC cameras may omit the standard
    /// tables.
    pub has_huffman_tables: bool,
    /// Number of scans.
    pub scans: u32,
    /// Coded blocks between restart markers; 0: none.
    pub restart_interval: u16,
    /// Offset of the start-of-image marker.
    pub start: usize,
    /// Offset of the end of the image: behind its end-of-image marker or, without one, behind its
    /// entropy-coded data.
    pub end: usize,
    /// Whether the image has its end-of-image marker.
    pub has_end_marker: bool,
}

/// First bytes of a JPEG: the start-of-image marker and the first byte of the next marker.
const START: [u8; 3] = [0xff, code::SOI, 0xff];

/// Parses the marker structure of a JPEG.
///
/// Harmless, because every image byte is there: bytes before the start-of-image marker, bytes after
/// the end-of-image marker, and a missing end-of-image marker after whole entropy-coded data.
/// Entropy-coded data is not decoded, except that of a JPEG without an end-of-image marker.
///
/// # Errors
/// The first damage.
pub fn inspect(bytes: &[u8]) -> Result<JpegHeader, JpegDamage> {
    Parser::run(bytes).map(|(header, _)| header)
}

/// [`inspect`], with the scan of a sequential JPEG of one scan.
pub(super) fn inspect_scan(bytes: &[u8]) -> Result<(JpegHeader, Option<Scan<'_>>), JpegDamage> {
    Parser::run(bytes)
}

fn truncated(bytes: &[u8], expected: &'static str) -> JpegDamage {
    JpegDamage::Truncated {
        length: bytes.len(),
        expected,
    }
}

fn malformed(what: impl Into<String>) -> JpegDamage {
    JpegDamage::Malformed(what.into())
}

/// Defined tables by slot.
#[derive(Default)]
struct Tables<'a> {
    /// Values in zigzag order.
    quantisation: [Option<[u16; 64]>; 4],
    /// Code counts and symbols.
    huffman_dc: [Option<&'a [u8]>; 4],
    huffman_ac: [Option<&'a [u8]>; 4],
}

struct FrameHeader {
    width: u32,
    height: u32,
    progressive: bool,
    components: Vec<Component>,
}

struct Component {
    id: u8,
    horizontal: u8,
    vertical: u8,
    quantisation: u8,
    scanned: bool,
}

impl FrameHeader {
    /// Number of coded units of a scan of all components.
    fn coded_units(&self) -> u32 {
        let is_single = self.components.len() == 1;
        let most = |factor: fn(&Component) -> u8| match is_single {
            true => 1,
            false => self.components.iter().map(factor).max().unwrap_or(1).into(),
        };
        let columns = self.width.div_ceil(8 * most(|c| c.horizontal));
        let rows = self.height.div_ceil(8 * most(|c| c.vertical));
        columns * rows
    }

    fn subsampling(&self) -> Subsampling {
        let [luma, blue, red] = self.components.as_slice() else {
            return Subsampling::Grey;
        };
        if (blue.horizontal, blue.vertical) != (1, 1) || (red.horizontal, red.vertical) != (1, 1) {
            return Subsampling::Other;
        }
        match (luma.horizontal, luma.vertical) {
            (1, 1) => Subsampling::S444,
            (2, 1) => Subsampling::S422,
            (2, 2) => Subsampling::S420,
            (1, 2) => Subsampling::S440,
            (4, 1) => Subsampling::S411,
            _ => Subsampling::Other,
        }
    }
}

struct Parser<'a> {
    bytes: &'a [u8],
    at: usize,
    frame: Option<FrameHeader>,
    start: usize,
    scans: u32,
    /// The newest scan, if its data can be walked.
    scan: Option<Scan<'a>>,
    restart_interval: u16,
    tables: Tables<'a>,
    has_huffman_tables: bool,
}

impl<'a> Parser<'a> {
    fn run(bytes: &'a [u8]) -> Result<(JpegHeader, Option<Scan<'a>>), JpegDamage> {
        let start = find_start(bytes)?;
        Parser {
            bytes,
            at: start + 2,
            frame: None,
            start,
            scans: 0,
            scan: None,
            restart_interval: 0,
            tables: Tables::default(),
            has_huffman_tables: true,
        }
        .segments()
    }

    fn segments(mut self) -> Result<(JpegHeader, Option<Scan<'a>>), JpegDamage> {
        loop {
            let marker = self.marker()?;
            match marker {
                code::EOI => return self.finish(true),
                code::SOS => {
                    self.scan()?;
                    if !self.skip_entropy_coded_data()? {
                        return self.end_without_marker();
                    }
                }
                code::SOF0 | code::SOF1 | code::SOF2 => self.start_of_frame(marker)?,
                code::DHT => self.huffman_tables()?,
                code::DQT => self.quantisation_tables()?,
                code::DRI => self.define_restart()?,
                code::APP0..=code::APP15 | code::COM => {
                    self.segment()?;
                }
                code::DAC => {
                    return Err(JpegDamage::Unsupported(
                        "arithmetic coding, expected Huffman coding".into(),
                    ));
                }
                code::SOF0..=code::SOF15 if marker != code::JPG => {
                    return Err(JpegDamage::Unsupported(format!(
                        "frame type SOF{}, expected SOF0, SOF1 or SOF2",
                        marker - code::SOF0
                    )));
                }
                _ => {
                    return Err(malformed(format!(
                        "unexpected marker FF {marker:02X} at byte {}",
                        self.at - 2
                    )));
                }
            }
        }
    }

    /// Reads the next marker code, after fill bytes (FF).
    fn marker(&mut self) -> Result<u8, JpegDamage> {
        let expected = if self.scans == 0 {
            "a marker segment before the scan"
        } else {
            "the end-of-image marker FF D9"
        };
        let start = self.at;
        let first = *self
            .bytes
            .get(start)
            .ok_or_else(|| truncated(self.bytes, expected))?;
        if first != 0xff {
            return Err(malformed(format!(
                "expected a marker at byte {start}, found {first:02X}"
            )));
        }
        let fill = self.bytes[start..]
            .iter()
            .take_while(|byte| **byte == 0xff)
            .count();
        let marker = *self
            .bytes
            .get(start + fill)
            .ok_or_else(|| truncated(self.bytes, expected))?;
        self.at = start + fill + 1;
        Ok(marker)
    }

    /// Reads the payload of the current segment.
    fn segment(&mut self) -> Result<&'a [u8], JpegDamage> {
        let bytes = self.bytes;
        let end = || truncated(bytes, "the rest of a marker segment");
        let length = bytes.get(self.at..self.at + 2).ok_or_else(end)?;
        let length = usize::from(u16::from_be_bytes([length[0], length[1]]));
        if length < 2 {
            return Err(malformed(format!(
                "segment length {length} at byte {}, expected at least 2",
                self.at
            )));
        }
        let payload = bytes.get(self.at + 2..self.at + length).ok_or_else(end)?;
        self.at += length;
        Ok(payload)
    }

    fn start_of_frame(&mut self, marker: u8) -> Result<(), JpegDamage> {
        let payload = self.segment()?;
        if self.frame.is_some() {
            return Err(malformed("two frame headers, expected one"));
        }
        let [precision, h1, h0, w1, w0, count, components @ ..] = payload else {
            return Err(malformed("the frame header is too short"));
        };
        if *precision != 8 {
            return Err(JpegDamage::Unsupported(format!(
                "{precision} bits per sample, expected 8"
            )));
        }
        let width = u32::from(u16::from_be_bytes([*w1, *w0]));
        let height = u32::from(u16::from_be_bytes([*h1, *h0]));
        if width == 0 || height == 0 {
            return Err(malformed(format!("image size {width}×{height}")));
        }
        if u64::from(width) * u64::from(height) > MAX_PIXELS {
            return Err(JpegDamage::Unsupported(format!(
                "{width}×{height} pixels, expected at most {MAX_PIXELS} in all"
            )));
        }
        if !matches!(count, 1 | 3) {
            return Err(JpegDamage::Unsupported(format!(
                "{count} colour components, expected 1 or 3"
            )));
        }
        if components.len() != usize::from(*count) * 3 {
            return Err(malformed(format!(
                "the frame header describes {} components, expected {count}",
                components.len() / 3
            )));
        }
        let components: Vec<Component> = components
            .chunks_exact(3)
            .map(|c| Component {
                id: c[0],
                horizontal: c[1] >> 4,
                vertical: c[1] & 15,
                quantisation: c[2],
                scanned: false,
            })
            .collect();
        for c in &components {
            if !(1..=4).contains(&c.horizontal)
                || !(1..=4).contains(&c.vertical)
                || c.quantisation > 3
            {
                return Err(malformed(format!(
                    "component {} has sampling {}×{} and quantisation table {}, expected 1 to 4 and 0 to 3",
                    c.id, c.horizontal, c.vertical, c.quantisation
                )));
            }
        }
        self.frame = Some(FrameHeader {
            width,
            height,
            progressive: marker == code::SOF2,
            components,
        });
        Ok(())
    }

    fn huffman_tables(&mut self) -> Result<(), JpegDamage> {
        let mut rest = self.segment()?;
        while let [class_and_slot, after @ ..] = rest {
            let (class, slot) = (class_and_slot >> 4, class_and_slot & 15);
            let Some((counts, values)) = after.split_at_checked(16) else {
                return Err(malformed("a Huffman table is truncated"));
            };
            let symbols: usize = counts.iter().map(|n| usize::from(*n)).sum();
            if class > 1 || slot > 3 || symbols == 0 || symbols > 256 || symbols > values.len() {
                return Err(malformed(format!(
                    "Huffman table of class {class}, slot {slot} with {symbols} symbols in {} bytes",
                    values.len()
                )));
            }
            let tables = match class {
                0 => &mut self.tables.huffman_dc,
                _ => &mut self.tables.huffman_ac,
            };
            tables[usize::from(slot)] = Some(&after[..16 + symbols]);
            rest = &values[symbols..];
        }
        Ok(())
    }

    fn quantisation_tables(&mut self) -> Result<(), JpegDamage> {
        let mut rest = self.segment()?;
        while let [class_and_slot, after @ ..] = rest {
            let (precision, slot) = (class_and_slot >> 4, class_and_slot & 15);
            let size = if precision == 0 { 64 } else { 128 };
            if precision > 1 || slot > 3 || after.len() < size {
                return Err(malformed(format!(
                    "quantisation table of precision {precision}, slot {slot} in {} bytes, expected {size}",
                    after.len()
                )));
            }
            let value = |i: usize| match precision {
                0 => u16::from(after[i]),
                _ => u16::from_be_bytes([after[2 * i], after[2 * i + 1]]),
            };
            self.tables.quantisation[usize::from(slot)] = Some(std::array::from_fn(value));
            rest = &after[size..];
        }
        Ok(())
    }

    fn define_restart(&mut self) -> Result<(), JpegDamage> {
        let payload = self.segment()?;
        let [high, low] = payload else {
            return Err(malformed(format!(
                "restart segment of {} bytes, expected 2",
                payload.len()
            )));
        };
        self.restart_interval = u16::from_be_bytes([*high, *low]);
        Ok(())
    }

    fn scan(&mut self) -> Result<(), JpegDamage> {
        let payload = self.segment()?;
        let frame = self
            .frame
            .as_mut()
            .ok_or_else(|| malformed("a scan before the frame header"))?;
        let [count, rest @ ..] = payload else {
            return Err(malformed("the scan header is empty"));
        };
        let count = usize::from(*count);
        if count == 0 || count > frame.components.len() || rest.len() != count * 2 + 3 {
            return Err(malformed(format!(
                "scan header of {} bytes for {count} components, the frame has {}",
                payload.len(),
                frame.components.len()
            )));
        }
        let (components, spectral) = rest.split_at(count * 2);
        let mut blocks = Vec::new();
        for pair in components.chunks_exact(2) {
            let (id, dc, ac) = (pair[0], pair[1] >> 4, pair[1] & 15);
            let component = frame
                .components
                .iter_mut()
                .find(|c| c.id == id)
                .ok_or_else(|| malformed(format!("the scan has the unknown component {id}")))?;
            component.scanned = true;
            // libjpeg would decode with the table of an earlier frame.
            let quantisation = self.tables.quantisation[usize::from(component.quantisation)]
                .ok_or_else(|| {
                    malformed(format!(
                        "quantisation table {} is used but not defined",
                        component.quantisation
                    ))
                })?;
            let needs_dc = spectral[0] == 0 && spectral[2] >> 4 == 0;
            let needs_ac = spectral[1] > 0;
            let defined = |tables: &[Option<&'a [u8]>; 4], slot: u8| {
                tables.get(usize::from(slot)).copied().flatten()
            };
            let own_dc = defined(&self.tables.huffman_dc, dc);
            let own_ac = defined(&self.tables.huffman_ac, ac);
            if (needs_dc && own_dc.is_none()) || (needs_ac && own_ac.is_none()) {
                if frame.progressive || dc > 1 || ac > 1 {
                    return Err(malformed(format!(
                        "Huffman tables {dc}/{ac} are used but neither defined nor standard"
                    )));
                }
                self.has_huffman_tables = false;
            }
            let tables = BlockTables {
                dc: own_dc.map_or_else(|| standard_tables::dc(dc), Cow::Borrowed),
                ac: own_ac.map_or_else(|| standard_tables::ac(ac), Cow::Borrowed),
                quantisation,
            };
            // A scan of one component has one block per coded unit.
            let per_unit = match count {
                1 => 1,
                _ => usize::from(component.horizontal) * usize::from(component.vertical),
            };
            blocks.push((tables, per_unit));
        }
        self.scans += 1;
        let is_whole = self.scans == 1 && count == frame.components.len();
        self.scan = (is_whole && !frame.progressive).then(|| Scan {
            start: self.at,
            blocks,
            units: frame.coded_units(),
            restart_interval: u32::from(self.restart_interval),
        });
        Ok(())
    }

    /// Skips to the marker after the scan, checking the restart markers; whether there is one.
    fn skip_entropy_coded_data(&mut self) -> Result<bool, JpegDamage> {
        let mut restarts: u32 = 0;
        loop {
            let Some(found) = find_ff(&self.bytes[self.at..]).map(|found| found + self.at) else {
                return Ok(false);
            };
            let Some(next) = self.bytes.get(found + 1) else {
                return Ok(false);
            };
            match *next {
                0 => self.at = found + 2,
                0xff => self.at = found + 1,
                restart @ code::RST0..=code::RST7 => {
                    if self.restart_interval == 0 {
                        return Err(malformed(format!(
                            "restart marker at byte {found}, but no restart interval is defined"
                        )));
                    }
                    let expected = code::RST0 + (restarts % 8) as u8;
                    if restart != expected {
                        return Err(malformed(format!(
                            "restart marker {} at byte {found}, expected {}",
                            restart - code::RST0,
                            expected - code::RST0
                        )));
                    }
                    restarts += 1;
                    self.at = found + 2;
                }
                _ => {
                    self.at = found;
                    return Ok(true);
                }
            }
        }
    }

    /// Ends an image whose scan runs to the end of the input: harmless if its data are whole.
    fn end_without_marker(mut self) -> Result<(JpegHeader, Option<Scan<'a>>), JpegDamage> {
        let end = truncated(self.bytes, "the end-of-image marker FF D9");
        let scan = self.scan.as_ref().ok_or_else(|| end.clone())?;
        self.at = entropy::walk(self.bytes, scan).ok_or(end)?.end;
        self.finish(false)
    }

    fn finish(self, has_end_marker: bool) -> Result<(JpegHeader, Option<Scan<'a>>), JpegDamage> {
        let frame = self
            .frame
            .ok_or_else(|| malformed("the image ends before its frame header"))?;
        if let Some(missing) = frame.components.iter().find(|c| !c.scanned) {
            return Err(malformed(format!(
                "the image ends before a scan of component {}",
                missing.id
            )));
        }
        let header = JpegHeader {
            width: frame.width,
            height: frame.height,
            components: frame.components.len() as u8,
            subsampling: frame.subsampling(),
            progressive: frame.progressive,
            has_huffman_tables: self.has_huffman_tables,
            scans: self.scans,
            restart_interval: self.restart_interval,
            start: self.start,
            end: self.at,
            has_end_marker,
        };
        Ok((header, self.scan))
    }
}

/// Offset of the start-of-image marker; cameras that do not clear their buffers send bytes before
/// it.
fn find_start(bytes: &[u8]) -> Result<usize, JpegDamage> {
    if let Some(start) = bytes.windows(START.len()).position(|three| three == START) {
        return Ok(start);
    }
    Err(match bytes {
        [0xff] | [0xff, code::SOI] => truncated(bytes, "the start-of-image marker"),
        [0xff, code::SOI, found, ..] => {
            malformed(format!("expected a marker at byte 2, found {found:02X}"))
        }
        _ => JpegDamage::NotJpeg {
            found: bytes[..bytes.len().min(4)].to_vec(),
        },
    })
}

/// Position of the first FF byte; skips blocks by a vectorisable test.
fn find_ff(bytes: &[u8]) -> Option<usize> {
    const BLOCK: usize = 64;
    let skipped = bytes
        .chunks_exact(BLOCK)
        .take_while(|block| !block.iter().fold(false, |any, byte| any | (*byte == 0xff)))
        .count()
        * BLOCK;
    let rest = bytes[skipped..].iter().position(|byte| *byte == 0xff)?;
    Some(skipped + rest)
}
