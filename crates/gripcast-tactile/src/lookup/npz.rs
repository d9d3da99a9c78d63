//! NumPy's `npz`: a zip archive of arrays in `npy` form. Archives as `numpy.savez` writes them are
//! read: members stored as they are, arrays of little-endian floats or integers in C order.

use std::collections::BTreeMap;

use gripcast_base::error::{Error, ErrorKind, Result};

const END_OF_DIRECTORY: [u8; 4] = *b"PK\x05\x06";
const DIRECTORY_ENTRY: [u8; 4] = *b"PK\x01\x02";
const LOCAL_HEADER: [u8; 4] = *b"PK\x03\x04";
const NPY: [u8; 6] = *b"\x93NUMPY";

/// An array in C order.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NpyArray {
    /// Sizes of its axes, outermost first; none for a single number.
    pub(super) shape: Vec<usize>,
    /// Values.
    pub(super) values: Vec<f64>,
}

/// The arrays of an archive by name, without `.npy`.
///
/// # Errors
/// `Input` where the bytes are no such archive, are cut off or altered.
pub(super) fn read_npz(bytes: &[u8]) -> Result<BTreeMap<String, NpyArray>> {
    let mut arrays = BTreeMap::new();
    let (count, mut at) = directory(bytes)?;
    for _ in 0..count {
        let entry = Entry::read(bytes, at)?;
        at = entry.end;
        let name = entry
            .name
            .strip_suffix(".npy")
            .unwrap_or(&entry.name)
            .to_owned();
        let array = entry
            .content(bytes)
            .and_then(read_npy)
            .map_err(|e| e.at(&entry.name))?;
        arrays.insert(name, array);
    }
    Ok(arrays)
}

fn damaged(what: impl Into<String>) -> Error {
    Error::new(ErrorKind::Input, what).remedy("check that the file was copied whole")
}

fn part(bytes: &[u8], at: usize, count: usize) -> Result<&[u8]> {
    at.checked_add(count)
        .and_then(|end| bytes.get(at..end))
        .ok_or_else(|| {
            damaged(format!(
                "the archive is cut off after {} bytes",
                bytes.len()
            ))
        })
}

fn number(bytes: &[u8], at: usize, count: usize) -> Result<usize> {
    let digits = part(bytes, at, count)?.iter().rev();
    Ok(digits.fold(0, |sum, byte| sum << 8 | usize::from(*byte)))
}

/// Number of members, and where the directory begins.
fn directory(bytes: &[u8]) -> Result<(usize, usize)> {
    let end = bytes
        .windows(4)
        .rposition(|w| w == END_OF_DIRECTORY)
        .ok_or_else(|| {
            Error::new(ErrorKind::Input, "this is no npz archive, or it is cut off")
                .remedy("write it with numpy.savez")
        })?;
    part(bytes, end, 22)?;
    Ok((number(bytes, end + 10, 2)?, number(bytes, end + 16, 4)?))
}

/// A member of the archive.
struct Entry {
    name: String,
    method: usize,
    checksum: usize,
    size: usize,
    header: usize,
    /// Where the next entry of the directory begins.
    end: usize,
}

impl Entry {
    fn read(bytes: &[u8], at: usize) -> Result<Self> {
        if part(bytes, at, 4)? != DIRECTORY_ENTRY {
            return Err(damaged("the directory of the archive is damaged"));
        }
        let name_bytes = number(bytes, at + 28, 2)?;
        let others = number(bytes, at + 30, 2)? + number(bytes, at + 32, 2)?;
        let name = part(bytes, at + 46, name_bytes)?;
        Ok(Self {
            name: String::from_utf8_lossy(name).into_owned(),
            method: number(bytes, at + 10, 2)?,
            checksum: number(bytes, at + 16, 4)?,
            size: number(bytes, at + 24, 4)?,
            header: number(bytes, at + 42, 4)?,
            end: at + 46 + name_bytes + others,
        })
    }

    fn content<'a>(&self, bytes: &'a [u8]) -> Result<&'a [u8]> {
        if self.method != 0 {
            return Err(Error::new(
                ErrorKind::Input,
                "the member is compressed, expected a stored one",
            )
            .remedy("write it with numpy.savez instead of numpy.savez_compressed"));
        }
        if part(bytes, self.header, 4)? != LOCAL_HEADER {
            return Err(damaged("the member's header is damaged"));
        }
        let names = number(bytes, self.header + 26, 2)? + number(bytes, self.header + 28, 2)?;
        let content = part(bytes, self.header + 30 + names, self.size)?;
        if crc32(content) as usize != self.checksum {
            return Err(damaged("the member's checksum does not match"));
        }
        Ok(content)
    }
}

/// CRC-32 of ISO 3309, as in zip.
fn crc32(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut i = 0;
        while i < 256 {
            let mut value = i as u32;
            let mut bit = 0;
            while bit < 8 {
                value = (value >> 1) ^ (0xEDB8_8320 * (value & 1));
                bit += 1;
            }
            table[i] = value;
            i += 1;
        }
        table
    };
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (crc >> 8) ^ TABLE[((crc ^ u32::from(*byte)) & 0xFF) as usize]
    })
}

fn read_npy(bytes: &[u8]) -> Result<NpyArray> {
    if !bytes.starts_with(&NPY) {
        return Err(damaged("the member is no npy array"));
    }
    let length_bytes = if number(bytes, 6, 1)? == 1 { 2 } else { 4 };
    let start = 8 + length_bytes;
    let length = number(bytes, 8, length_bytes)?;
    let header = String::from_utf8_lossy(part(bytes, start, length)?);
    let data = &bytes[start + length..];
    if field(&header, "fortran_order")?.starts_with("True") {
        return Err(unsupported("it is in Fortran order, expected C order"));
    }
    let shape = shape(field(&header, "shape")?)?;
    let kind = field(&header, "descr")?
        .trim_matches(['\'', '"'])
        .to_owned();
    let values: Vec<f64> = match kind.as_str() {
        "<f8" => numbers(data, f64::from_le_bytes),
        "<f4" => numbers(data, |b| f64::from(f32::from_le_bytes(b))),
        "<i8" => numbers(data, |b| i64::from_le_bytes(b) as f64),
        "<i4" => numbers(data, |b| f64::from(i32::from_le_bytes(b))),
        other => {
            return Err(unsupported(&format!(
                "its type is {other:?}, expected <f8, <f4, <i8 or <i4"
            )));
        }
    };
    let expected = shape
        .iter()
        .try_fold(1_usize, |n, side| n.checked_mul(*side));
    if expected != Some(values.len()) {
        return Err(damaged(format!(
            "the array of shape {shape:?} holds {} values",
            values.len()
        )));
    }
    Ok(NpyArray { shape, values })
}

fn unsupported(what: &str) -> Error {
    Error::new(
        ErrorKind::Input,
        format!("the array cannot be read: {what}"),
    )
    .remedy("save it as numpy.ascontiguousarray(a, dtype='<f8')")
}

fn numbers<const N: usize>(data: &[u8], read: impl Fn([u8; N]) -> f64) -> Vec<f64> {
    let (items, _) = data.as_chunks::<N>();
    items.iter().map(|item| read(*item)).collect()
}

/// What follows a key of the header's dictionary.
fn field<'a>(header: &'a str, key: &str) -> Result<&'a str> {
    let lacking = || damaged(format!("the array's header lacks {key:?}"));
    let quoted = format!("'{key}':");
    let (_, rest) = header.split_once(&quoted).ok_or_else(lacking)?;
    let rest = rest.trim_start();
    let end = if rest.starts_with('(') {
        rest.find(')').map(|i| i + 1)
    } else {
        rest.find([',', '}'])
    };
    end.map(|end| &rest[..end]).ok_or_else(lacking)
}

fn shape(tuple: &str) -> Result<Vec<usize>> {
    let sides = tuple.trim_matches(['(', ')']).split(',');
    sides
        .map(str::trim)
        .filter(|side| !side.is_empty())
        .map(|side| {
            side.parse()
                .map_err(|_| damaged(format!("the array's shape is {tuple:?}")))
        })
        .collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// An archive as `numpy.savez` writes it.
    pub(in super::super) fn archive(members: &[(&str, &[usize], &[f64])]) -> Vec<u8> {
        let (mut out, mut entries) = (Vec::new(), Vec::new());
        for (name, shape, values) in members {
            let sides: String = shape.iter().map(|s| format!("{s},")).collect();
            let mut header =
                format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({sides}), }}");
            while (header.len() + 11) % 64 != 0 {
                header.push(' ');
            }
            header.push('\n');
            let mut content = b"\x93NUMPY\x01\x00".to_vec();
            content.extend((header.len() as u16).to_le_bytes());
            content.extend(header.as_bytes());
            content.extend(values.iter().flat_map(|v| v.to_le_bytes()));
            let name = format!("{name}.npy");
            let start = out.len() as u32;
            out.extend(LOCAL_HEADER);
            out.extend([0; 22]);
            out.extend((name.len() as u16).to_le_bytes());
            out.extend([0; 2]);
            out.extend(name.as_bytes());
            out.extend(&content);
            entries.extend(DIRECTORY_ENTRY);
            entries.extend([0; 12]);
            entries.extend(crc32(&content).to_le_bytes());
            entries.extend([(content.len() as u32).to_le_bytes(); 2].concat());
            entries.extend((name.len() as u16).to_le_bytes());
            entries.extend([0; 12]);
            entries.extend(start.to_le_bytes());
            entries.extend(name.as_bytes());
        }
        let start = out.len() as u32;
        out.extend(&entries);
        out.extend(END_OF_DIRECTORY);
        out.extend([0; 4]);
        out.extend([(members.len() as u16).to_le_bytes(); 2].concat());
        out.extend((entries.len() as u32).to_le_bytes());
        out.extend(start.to_le_bytes());
        out.extend([0; 2]);
        out
    }

    #[test]
    fn arrays_come_back() {
        let bytes = archive(&[
            ("a", &[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, -6.5]),
            ("b", &[], &[7.0]),
        ]);
        let arrays = read_npz(&bytes).unwrap();
        assert_eq!(arrays["a"].shape, [2, 3]);
        assert_eq!(arrays["a"].values[5], -6.5);
        assert_eq!((arrays["b"].shape.len(), arrays["b"].values[0]), (0, 7.0));
    }

    #[test]
    fn the_checksum_is_that_of_zip() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn no_damaged_byte_and_no_cut_is_taken_for_data() {
        let values: Vec<f64> = (0..12).map(f64::from).collect();
        let bytes = archive(&[("grad", &[3, 4], &values)]);
        let good = read_npz(&bytes).unwrap();
        for cut in 0..bytes.len() {
            assert!(read_npz(&bytes[..cut]).is_err(), "{cut}");
        }
        for at in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[at] ^= 0x15;
            // Fields that are not needed may change; what is read may not.
            if let Ok(arrays) = read_npz(&bad) {
                assert!(arrays.values().all(|a| *a == good["grad"]), "{at}");
            }
        }
    }

    #[test]
    fn what_is_not_supported_is_explained() {
        let text = read_npz(b"\x89PNG").unwrap_err().to_string();
        assert!(text.contains("npz"), "{text}");
        let mut bytes = archive(&[("a", &[1], &[1.0])]);
        let entry = bytes.windows(4).position(|w| w == DIRECTORY_ENTRY).unwrap();
        bytes[entry + 10] = 8;
        let text = read_npz(&bytes).unwrap_err().to_string();
        assert!(text.contains("a.npy") && text.contains("savez"), "{text}");
    }
}
