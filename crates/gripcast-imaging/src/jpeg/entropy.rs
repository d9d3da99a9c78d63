//! Walks the entropy-coded data of a sequential JPEG (ITU T.81 annex F) without decoding pixels, to
//! tell stray bytes from missing ones.

use std::borrow::Cow;
use std::ops::Range;

use super::code;

/// Most stray bytes behind the data of a restart interval, and behind that of the image.
const MAX_STRAY_BYTES: usize = 16;
/// Highest magnitude of a transform coefficient of 8-bit samples, with room for rounding.
const MAX_COEFFICIENT: i64 = 1200;

/// The scan of a sequential JPEG of one scan.
pub(super) struct Scan<'a> {
    /// Offset of its entropy-coded data.
    pub(super) start: usize,
    /// Tables of each component, and its blocks per coded unit.
    pub(super) blocks: Vec<(BlockTables<'a>, usize)>,
    /// Number of coded units.
    pub(super) units: u32,
    /// Coded units per restart interval; 0: one interval.
    pub(super) restart_interval: u32,
}

/// Tables of the blocks of a component; Huffman tables are 16 code counts, then symbols.
pub(super) struct BlockTables<'a> {
    pub(super) dc: Cow<'a, [u8]>,
    pub(super) ac: Cow<'a, [u8]>,
    /// In zigzag order.
    pub(super) quantisation: [u16; 64],
}

/// Whole entropy-coded data.
pub(super) struct Walked {
    /// Data of each restart interval, without stray bytes.
    pub(super) intervals: Vec<Range<usize>>,
    /// Number of stray bytes between the intervals' data and the markers behind them.
    pub(super) stray_bytes: usize,
    /// Offset behind the data of the last interval.
    pub(super) end: usize,
}

/// Walks the data of `scan` in `bytes`; `None` where a block is missing or invalid, or more than
/// stray bytes follow the last block of an interval.
///
/// Stray bytes are accepted only behind data that is whole by itself: every code is defined, every
/// coefficient is possible, and the last byte is filled with ones, as encoders do.
pub(super) fn walk(bytes: &[u8], scan: &Scan<'_>) -> Option<Walked> {
    let components: Vec<Component> = scan
        .blocks
        .iter()
        .map(|(tables, blocks)| Component {
            dc: Codes::new(&tables.dc),
            ac: Codes::new(&tables.ac),
            quantisation: tables.quantisation.map(i64::from),
            blocks: *blocks,
        })
        .collect();
    let per_interval = match scan.restart_interval {
        0 => scan.units,
        units => units,
    };
    let mut walked = Walked {
        intervals: Vec::new(),
        stray_bytes: 0,
        end: scan.start,
    };
    let mut left = scan.units;
    let mut start = scan.start;
    loop {
        let units = left.min(per_interval);
        left -= units;
        let mut bits = Bits::new(bytes, start);
        interval(&mut bits, &components, units)?;
        let (end, is_filled) = bits.end();
        walked.intervals.push(start..end);
        let is_last = left == 0;
        let stray = match is_last {
            true => stray_at_end(bytes, end),
            false => stray_before(bytes, end, is_restart),
        }?;
        // Zeros are valid codes: data that goes on into the zeros of an unused buffer is not whole.
        // One byte of zeros is common in flat images.
        let runs_into_zeros = end >= start + 2 && bytes[end - 2..].starts_with(&[0, 0, 0]);
        walked.end = end;
        let has_marker = marker(bytes, end + stray).is_some();
        if (stray > 0 || !has_marker) && (!is_filled || runs_into_zeros) {
            return None;
        }
        if has_marker {
            walked.stray_bytes += stray;
        }
        if is_last {
            return Some(walked);
        }
        start = behind_marker(bytes, end + stray);
    }
}

/// Number of bytes from `at` to a marker, if they are few.
fn stray_before(bytes: &[u8], at: usize, is_expected: fn(u8) -> bool) -> Option<usize> {
    (0..=MAX_STRAY_BYTES).find(|stray| marker(bytes, at + stray).is_some_and(is_expected))
}

/// Number of bytes behind the last interval: to the end-of-image marker, or of unused memory
/// instead of one.
fn stray_at_end(bytes: &[u8], at: usize) -> Option<usize> {
    let rest = &bytes[at..];
    let is_unused = |value: u8| rest.iter().all(|byte| *byte == value);
    stray_before(bytes, at, |code| code == code::EOI)
        .or_else(|| (is_unused(0) || is_unused(0xff)).then_some(rest.len()))
}

fn is_restart(code: u8) -> bool {
    matches!(code, code::RST0..=code::RST7)
}

/// Code of the marker at `at`, behind its fill bytes.
fn marker(bytes: &[u8], at: usize) -> Option<u8> {
    let rest = bytes.get(at..).filter(|rest| rest.first() == Some(&0xff))?;
    let code = *rest.iter().find(|byte| **byte != 0xff)?;
    (code != 0).then_some(code)
}

/// Offset behind the marker at `at`.
fn behind_marker(bytes: &[u8], at: usize) -> usize {
    let fill = bytes[at..].iter().take_while(|byte| **byte == 0xff);
    at + fill.count() + 1
}

/// Codes of a component's blocks.
struct Component {
    dc: Codes,
    ac: Codes,
    quantisation: [i64; 64],
    blocks: usize,
}

/// Walks the blocks of a restart interval.
fn interval(bits: &mut Bits<'_>, components: &[Component], units: u32) -> Option<()> {
    let mut predictions = [0_i64; 4];
    for _ in 0..units {
        for (component, prediction) in components.iter().zip(&mut predictions) {
            for _ in 0..component.blocks {
                block(bits, component, prediction)?;
            }
        }
    }
    Some(())
}

fn block(bits: &mut Bits<'_>, component: &Component, prediction: &mut i64) -> Option<()> {
    let is_possible =
        |value: i64, at: usize| (value * component.quantisation[at]).abs() <= MAX_COEFFICIENT;
    let size = component.dc.next(bits).filter(|size| *size <= 11)?;
    *prediction += bits.value(size)?;
    if !is_possible(*prediction, 0) {
        return None;
    }
    let mut at = 1;
    while at < 64 {
        let symbol = component.ac.next(bits)?;
        let (run, size) = (usize::from(symbol >> 4), symbol & 15);
        match (run, size) {
            (0, 0) => return Some(()),
            (15, 0) => at += 16,
            (_, 0) => return None,
            _ => {
                at += run;
                let value = bits.value(size)?;
                if at > 63 || !is_possible(value, at) {
                    return None;
                }
                at += 1;
            }
        }
    }
    (at == 64).then_some(())
}

/// Reads bits of entropy-coded data up to the next marker.
struct Bits<'a> {
    bytes: &'a [u8],
    /// Offset of the next byte.
    at: usize,
    buffer: u64,
    /// Number of unread bits in the buffer.
    count: u32,
}

impl<'a> Bits<'a> {
    fn new(bytes: &'a [u8], at: usize) -> Self {
        Self {
            bytes,
            at,
            buffer: 0,
            count: 0,
        }
    }

    /// Makes `count` bits available, at most 16.
    fn fill(&mut self, count: u32) -> Option<()> {
        while self.count < count {
            let byte = *self.bytes.get(self.at)?;
            if byte == 0xff {
                // A stuffed byte; anything else is a marker.
                if self.bytes.get(self.at + 1) != Some(&0) {
                    return None;
                }
                self.at += 1;
            }
            self.at += 1;
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.count += 8;
        }
        Some(())
    }

    fn bits(&mut self, count: u32) -> Option<u64> {
        self.fill(count)?;
        self.count -= count;
        Some(self.buffer >> self.count & ((1 << count) - 1))
    }

    /// A coefficient of `size` bits (T.81, figure F.12).
    fn value(&mut self, size: u8) -> Option<i64> {
        let size = u32::from(size);
        let bits = self.bits(size)?.cast_signed();
        Some(match size {
            0 => 0,
            _ if bits >> (size - 1) == 1 => bits,
            _ => bits - (1 << size) + 1,
        })
    }

    /// Offset behind the byte of the last read bit, and whether the rest of it is ones.
    fn end(&self) -> (usize, bool) {
        let mut at = self.at;
        for _ in 0..self.count / 8 {
            let is_stuffed = at >= 2 && self.bytes[at - 2..at] == [0xff, 0];
            at -= if is_stuffed { 2 } else { 1 };
        }
        let rest = self.buffer >> (self.count / 8 * 8);
        let fill = (1 << (self.count % 8)) - 1;
        (at, rest & fill == fill)
    }
}

/// A Huffman table for decoding.
struct Codes {
    /// Length and symbol by the next 8 bits; length 0 for longer codes.
    short: [(u8, u8); 256],
    /// First code, number of codes and offset of the first symbol, by length.
    lengths: [(u64, u64, usize); 17],
    symbols: Vec<u8>,
}

impl Codes {
    /// `table`: 16 code counts, then symbols.
    fn new(table: &[u8]) -> Self {
        let (counts, symbols) = table.split_at(table.len().min(16));
        let mut codes = Self {
            short: [(0, 0); 256],
            lengths: [(0, 0, 0); 17],
            symbols: symbols.to_vec(),
        };
        let (mut code, mut offset) = (0_u64, 0);
        for (length, count) in (1_usize..).zip(counts) {
            codes.lengths[length] = (code, u64::from(*count), offset);
            for symbol in symbols.iter().skip(offset).take(usize::from(*count)) {
                if length <= 8 {
                    let first = (code as usize) << (8 - length);
                    let entries = codes.short.iter_mut().skip(first);
                    for entry in entries.take(1 << (8 - length)) {
                        *entry = (length as u8, *symbol);
                    }
                }
                code += 1;
            }
            offset += usize::from(*count);
            code <<= 1;
        }
        codes
    }

    fn next(&self, bits: &mut Bits<'_>) -> Option<u8> {
        if bits.fill(8).is_some() {
            let ahead = (bits.buffer >> (bits.count - 8) & 0xff) as usize;
            let (length, symbol) = self.short[ahead];
            if length > 0 {
                bits.count -= u32::from(length);
                return Some(symbol);
            }
        }
        let mut code = 0;
        for (first, count, offset) in &self.lengths[1..] {
            code = code << 1 | bits.bits(1)?;
            if code >= *first && code - first < *count {
                return self.symbols.get(offset + (code - first) as usize).copied();
            }
        }
        None
    }
}
