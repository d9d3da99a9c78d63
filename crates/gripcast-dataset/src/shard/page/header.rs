//! Page headers in Thrift's compact protocol
//! (`parquet.thrift` of the Apache Parquet format, `PageHeader`).
//!
//! Read here and not by the Parquet crate, so that sizes are checked before anything is
//! decompressed.

/// Required fields of a page header.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PageHeader {
    /// 0 data, 1 index, 2 dictionary, 3 data version 2.
    pub(super) kind: i64,
    /// Decompressed size of the contents, bytes.
    pub(super) uncompressed: i64,
    /// Size of the contents in the file, bytes.
    pub(super) compressed: i64,
    /// CRC-32 of the contents in the file.
    pub(super) crc: Option<i64>,
    pub(super) num_values: i64,
    pub(super) encoding: i64,
    /// Encodings of the levels, version 1.
    pub(super) definition_encoding: i64,
    pub(super) repetition_encoding: i64,
    /// Version 2.
    pub(super) num_nulls: i64,
    pub(super) num_rows: i64,
    pub(super) definition_bytes: i64,
    pub(super) repetition_bytes: i64,
    pub(super) is_compressed: bool,
}

/// Maximum nesting depth; a page header needs three.
const MAX_DEPTH: usize = 16;

impl PageHeader {
    /// Parses the header at the start of `bytes`; returns it with its length. `None`: invalid or
    /// truncated.
    pub(super) fn parse(bytes: &[u8]) -> Option<(Self, usize)> {
        let mut thrift = Thrift { bytes, offset: 0 };
        let mut header = Self {
            is_compressed: true,
            ..Self::default()
        };
        let mut id = 0;
        while let Some(field) = thrift.field(&mut id)? {
            match (id, field) {
                (1, Field::Integer(v)) => header.kind = v,
                (2, Field::Integer(v)) => header.uncompressed = v,
                (3, Field::Integer(v)) => header.compressed = v,
                (4, Field::Integer(v)) => header.crc = Some(v),
                (5 | 7 | 8, Field::Struct) => header.parse_kind(id, &mut thrift)?,
                (_, field) => thrift.skip(field, MAX_DEPTH)?,
            }
        }
        Some((header, thrift.offset))
    }

    fn parse_kind(&mut self, kind: i64, thrift: &mut Thrift<'_>) -> Option<()> {
        let mut id = 0;
        while let Some(field) = thrift.field(&mut id)? {
            match (kind, id, field) {
                (_, 1, Field::Integer(v)) => self.num_values = v,
                (5 | 7, 2, Field::Integer(v)) => self.encoding = v,
                (5, 3, Field::Integer(v)) => self.definition_encoding = v,
                (5, 4, Field::Integer(v)) => self.repetition_encoding = v,
                (8, 2, Field::Integer(v)) => self.num_nulls = v,
                (8, 3, Field::Integer(v)) => self.num_rows = v,
                (8, 4, Field::Integer(v)) => self.encoding = v,
                (8, 5, Field::Integer(v)) => self.definition_bytes = v,
                (8, 6, Field::Integer(v)) => self.repetition_bytes = v,
                (8, 7, Field::Bool(v)) => self.is_compressed = v,
                (_, _, field) => thrift.skip(field, MAX_DEPTH)?,
            }
        }
        Some(())
    }
}

/// A field: its scalar value, or the type of a value still to be read.
enum Field {
    Bool(bool),
    Integer(i64),
    Double,
    Binary,
    List,
    Map,
    Struct,
}

struct Thrift<'a> {
    bytes: &'a [u8],
    offset: usize,
}

impl Thrift<'_> {
    fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.offset)?;
        self.offset += 1;
        Some(byte)
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    fn integer(&mut self) -> Option<i64> {
        let zigzag = self.varint()?;
        Some((zigzag >> 1).cast_signed() ^ -(zigzag & 1).cast_signed())
    }

    fn advance(&mut self, length: u64) -> Option<()> {
        let left = (self.bytes.len() - self.offset) as u64;
        if length > left {
            return None;
        }
        self.offset += length as usize;
        Some(())
    }

    /// Reads the next field of a structure; the inner `None` is its end. `id`: of the previous
    /// field.
    fn field(&mut self, id: &mut i64) -> Option<Option<Field>> {
        let byte = self.byte()?;
        if byte == 0 {
            return Some(None);
        }
        *id = match byte >> 4 {
            0 => self.integer()?,
            delta => id.checked_add(i64::from(delta))?,
        };
        match byte & 0x0f {
            1 => Some(Some(Field::Bool(true))),
            2 => Some(Some(Field::Bool(false))),
            kind => self.value(kind).map(Some),
        }
    }

    fn value(&mut self, kind: u8) -> Option<Field> {
        Some(match kind {
            // In a list a boolean is a byte.
            1..=3 => Field::Integer(i64::from(self.byte()?)),
            4..=6 => Field::Integer(self.integer()?),
            7 => Field::Double,
            8 => Field::Binary,
            9 | 10 => Field::List,
            11 => Field::Map,
            12 => Field::Struct,
            _ => return None,
        })
    }

    /// Skips the unread rest of a field.
    fn skip(&mut self, field: Field, depth: usize) -> Option<()> {
        let depth = depth.checked_sub(1)?;
        match field {
            Field::Bool(_) | Field::Integer(_) => Some(()),
            Field::Double => self.advance(8),
            Field::Binary => {
                let length = self.varint()?;
                self.advance(length)
            }
            Field::List => {
                let byte = self.byte()?;
                let count = match byte >> 4 {
                    15 => self.varint()?,
                    count => u64::from(count),
                };
                self.skip_values(count, &[byte & 0x0f], depth)
            }
            Field::Map => {
                let count = self.varint()?;
                if count == 0 {
                    return Some(());
                }
                let kinds = self.byte()?;
                self.skip_values(count, &[kinds >> 4, kinds & 0x0f], depth)
            }
            Field::Struct => {
                let mut id = 0;
                while let Some(field) = self.field(&mut id)? {
                    self.skip(field, depth)?;
                }
                Some(())
            }
        }
    }

    /// Each value takes at least one byte, so the input bounds the work.
    fn skip_values(&mut self, count: u64, kinds: &[u8], depth: usize) -> Option<()> {
        for _ in 0..count {
            for &kind in kinds {
                let field = self.value(kind)?;
                self.skip(field, depth)?;
            }
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A data page of 3 values, 40 bytes packed into 20, plain, levels RLE, statistics with a
    /// text, a crc.
    const HEADER: &[u8] = &[
        0x15, 0x00, 0x15, 0x50, 0x15, 0x28, 0x15, 0x0d, 0x1c, 0x15, 0x06, 0x15, 0x00, 0x15, 0x06,
        0x15, 0x06, 0x1c, 0x18, 0x02, b'a', b'b', 0x00, 0x00, 0x00,
    ];

    #[test]
    fn header_is_parsed_with_its_length() {
        let mut bytes = HEADER.to_vec();
        bytes.extend([0xaa; 9]);
        let (header, length) = PageHeader::parse(&bytes).unwrap();
        assert_eq!(length, HEADER.len());
        let expected = PageHeader {
            kind: 0,
            uncompressed: 40,
            compressed: 20,
            crc: Some(-7),
            num_values: 3,
            definition_encoding: 3,
            repetition_encoding: 3,
            is_compressed: true,
            ..PageHeader::default()
        };
        assert_eq!(header, expected);
    }

    #[test]
    fn truncated_header_is_none() {
        for length in 0..HEADER.len() {
            assert_eq!(PageHeader::parse(&HEADER[..length]), None, "{length}");
        }
    }

    #[test]
    fn deep_and_long_structures_are_bounded() {
        assert_eq!(PageHeader::parse(&[0x9c; 100_000]), None);
        let long_list = [0x99, 0xf3, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f];
        assert_eq!(PageHeader::parse(&long_list), None);
        assert_eq!(PageHeader::parse(&[0x15, 0x80, 0x80]), None);
    }
}
