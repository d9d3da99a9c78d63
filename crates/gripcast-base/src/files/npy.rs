//! Arrays of `f32` as `.npy` files, which NumPy reads: format version 1.0, `<f4`, row-major.
//!
//! Format: <https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>.

use crate::error::{Error, Result};

/// Maximum number of values of an array: 1 GiB.
const MAX_VALUES: usize = 1 << 28;
/// Maximum number of dimensions.
const MAX_DIMENSIONS: usize = 8;
/// Magic string and version.
const MAGIC: &[u8; 8] = b"\x93NUMPY\x01\x00";
/// The values begin at a multiple of this.
const ALIGNMENT: usize = 64;

/// Name of the element type in the files: little-endian 32-bit floats.
pub const DTYPE: &str = "<f4";

/// Row-major array of `f32`.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Size of each dimension, the slowest first.
    shape: Vec<usize>,
    values: Vec<f32>,
}

impl Array {
    /// Makes an array of `values` in row-major order.
    ///
    /// # Errors
    /// `Input` where the number of values is not the product of the shape, or above the limits of
    /// a file.
    pub fn new(shape: impl Into<Vec<usize>>, values: Vec<f32>) -> Result<Self> {
        let shape = shape.into();
        let expected = number_of_values(&shape)?;
        if values.len() != expected {
            return Err(Error::input(format!(
                "expected {expected} values in an array of shape {}, found {}",
                shown(&shape),
                values.len()
            )));
        }
        Ok(Self { shape, values })
    }

    /// Size of each dimension, the slowest first.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Values in row-major order.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The values, little-endian, without a header.
    #[must_use]
    pub fn to_le_bytes(&self) -> Vec<u8> {
        self.values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    /// Contents of a `.npy` file.
    #[must_use]
    pub fn to_npy(&self) -> Vec<u8> {
        let mut bytes = header(&self.shape);
        bytes.extend(self.values.iter().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    /// Reads the contents of a `.npy` file of little-endian 32-bit floats in row-major order.
    ///
    /// # Errors
    /// `Input` for another element type, order or version, a damaged header, and fewer or more
    /// values than its shape says.
    pub fn from_npy(bytes: &[u8]) -> Result<Self> {
        let (shape, data) = split(bytes)?;
        let expected = number_of_values(&shape)?;
        let (values, rest) = data.as_chunks::<4>();
        if values.len() != expected || !rest.is_empty() {
            return Err(Error::input(format!(
                "expected {} bytes of values in an array of shape {}, found {}",
                expected * 4,
                shown(&shape),
                data.len()
            ))
            .remedy("the file is incomplete or altered: restore it"));
        }
        let values = values.iter().map(|v| f32::from_le_bytes(*v)).collect();
        Ok(Self { shape, values })
    }
}

/// Header of a `.npy` file of an array of this shape; its values follow, little-endian.
///
/// For arrays that are written piece by piece; [`Array::to_npy`] writes whole ones.
#[must_use]
pub fn header(shape: &[usize]) -> Vec<u8> {
    let mut text = format!(
        "{{'descr': '{DTYPE}', 'fortran_order': False, 'shape': {}, }}",
        shown(shape)
    );
    let unpadded = MAGIC.len() + 2 + text.len() + 1;
    let padding = unpadded.next_multiple_of(ALIGNMENT) - unpadded;
    text.extend(std::iter::repeat_n(' ', padding));
    text.push('\n');
    let mut bytes = MAGIC.to_vec();
    // Far below 64 KiB for any shape that fits in memory.
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

/// A shape as Python prints a tuple.
fn shown(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => {
            let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
            format!("({})", sizes.join(", "))
        }
    }
}

fn number_of_values(shape: &[usize]) -> Result<usize> {
    let product = shape.iter().try_fold(1_usize, |n, size| {
        n.checked_mul(*size).filter(|n| *n <= MAX_VALUES)
    });
    product
        .filter(|_| shape.len() <= MAX_DIMENSIONS)
        .ok_or_else(|| {
            Error::input(format!(
                "expected at most {MAX_DIMENSIONS} dimensions and {MAX_VALUES} values, found shape {:.200}",
                shown(shape)
            ))
        })
}

/// Splits a file into its shape and the bytes of its values.
fn split(bytes: &[u8]) -> Result<(Vec<usize>, &[u8])> {
    let Some((magic, rest)) = bytes.split_at_checked(MAGIC.len()) else {
        return Err(not_npy("a file of less than 8 bytes"));
    };
    if magic[..6] != MAGIC[..6] {
        return Err(not_npy("another kind of file"));
    }
    if magic != MAGIC {
        return Err(not_npy(&format!("version {}.{}", magic[6], magic[7])));
    }
    let (length, rest) = rest
        .split_first_chunk::<2>()
        .ok_or_else(|| not_npy("an incomplete header"))?;
    let (text, data) = rest
        .split_at_checked(usize::from(u16::from_le_bytes(*length)))
        .ok_or_else(|| not_npy("an incomplete header"))?;
    let text = std::str::from_utf8(text).map_err(|_| not_npy("a damaged header"))?;
    let shape = Header(text).parse()?;
    Ok((shape, data))
}

fn not_npy(found: &str) -> Error {
    Error::input(format!(
        "expected a .npy file, version 1.0, of {DTYPE} in row-major order, found {found}"
    ))
    .remedy("write it with numpy.save(file, numpy.ascontiguousarray(array, '<f4'))")
}

/// The rest of a header: a Python dictionary with the keys `descr`, `fortran_order` and `shape`.
struct Header<'a>(&'a str);

impl<'a> Header<'a> {
    fn parse(mut self) -> Result<Vec<usize>> {
        let (mut dtype, mut order, mut shape) = (None, None, None);
        self.require("{")?;
        while !self.accept("}") {
            let key = self.quoted()?;
            self.require(":")?;
            let is_new = match key {
                "descr" => dtype.replace(self.quoted()?).is_none(),
                "fortran_order" => order.replace(self.boolean()?).is_none(),
                "shape" => shape.replace(self.tuple()?).is_none(),
                _ => false,
            };
            if !is_new {
                return Err(not_npy(&format!("the header's key {key:.40?}")));
            }
            if !self.accept(",") {
                self.require("}")?;
                break;
            }
        }
        if !self.0.trim_ascii().is_empty() {
            return Err(self.damaged());
        }
        match (dtype, order, shape) {
            (Some(DTYPE), Some(false), Some(shape)) => Ok(shape),
            (Some(DTYPE), Some(true), _) => Err(not_npy("column-major order")),
            (Some(other), _, _) if other != DTYPE => Err(not_npy(&format!("{other:.40}"))),
            _ => Err(not_npy("a header without descr, fortran_order or shape")),
        }
    }

    fn damaged(&self) -> Error {
        not_npy(&format!("a damaged header at {:.40?}", self.0))
    }

    /// Skips blanks, then `token` where it comes next.
    fn accept(&mut self, token: &str) -> bool {
        self.0 = self.0.trim_ascii_start();
        match self.0.strip_prefix(token) {
            Some(rest) => {
                self.0 = rest;
                true
            }
            None => false,
        }
    }

    fn require(&mut self, token: &str) -> Result<()> {
        if self.accept(token) {
            Ok(())
        } else {
            Err(self.damaged())
        }
    }

    fn quoted(&mut self) -> Result<&'a str> {
        let quote = if self.accept("'") { '\'' } else { '"' };
        if quote == '"' {
            self.require("\"")?;
        }
        let (text, rest) = self.0.split_once(quote).ok_or_else(|| self.damaged())?;
        self.0 = rest;
        Ok(text)
    }

    fn boolean(&mut self) -> Result<bool> {
        if self.accept("True") {
            return Ok(true);
        }
        self.require("False").map(|()| false)
    }

    fn tuple(&mut self) -> Result<Vec<usize>> {
        let mut sizes = Vec::new();
        self.require("(")?;
        while !self.accept(")") {
            if sizes.len() == MAX_DIMENSIONS {
                return Err(not_npy(&format!("more than {MAX_DIMENSIONS} dimensions")));
            }
            self.0 = self.0.trim_ascii_start();
            let digits = self.0.bytes().take_while(u8::is_ascii_digit).count();
            let (number, rest) = self.0.split_at(digits);
            sizes.push(number.parse().map_err(|_| self.damaged())?);
            self.0 = rest;
            if !self.accept(",") {
                self.require(")")?;
                break;
            }
        }
        Ok(sizes)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Bytes that `numpy.save` of NumPy 2.2 writes for `numpy.array([[1, -2.5]], '<f4')`.
    const NUMPY: &[u8] = b"\x93NUMPY\x01\x00v\x00{'descr': '<f4', 'fortran_order': False, \
        'shape': (1, 2), }                                                          \n\
        \x00\x00\x80\x3f\x00\x00\x20\xc0";

    #[test]
    fn file_is_the_one_that_numpy_writes() {
        let array = Array::new([1, 2], vec![1.0, -2.5]).unwrap();
        assert_eq!(array.to_npy(), NUMPY);
        assert_eq!(Array::from_npy(NUMPY).unwrap(), array);
        assert_eq!(array.to_le_bytes(), NUMPY[128..]);
    }

    #[test]
    fn arrays_of_any_shape_round_trip() {
        for shape in [
            vec![],
            vec![0],
            vec![3],
            vec![2, 0, 5],
            vec![4, 3, 5],
            vec![1; 8],
        ] {
            let count: usize = shape.iter().product();
            let values: Vec<f32> = (0..count).map(|i| i as f32 - 0.5).collect();
            let array = Array::new(shape, values).unwrap();
            let file = array.to_npy();
            assert_eq!((file.len() - count * 4) % ALIGNMENT, 0);
            assert_eq!(Array::from_npy(&file).unwrap(), array);
        }
        let nan = Array::new([1], vec![f32::NAN]).unwrap();
        assert!(Array::from_npy(&nan.to_npy()).unwrap().values()[0].is_nan());
        assert!(Array::new([2, 3], vec![0.0; 5]).is_err());
        assert!(Array::new([1; 9], vec![0.0]).is_err());
    }

    #[test]
    fn other_arrays_are_explained() {
        let with = |header: &str, values: usize| {
            let mut bytes = MAGIC.to_vec();
            bytes.extend((header.len() as u16).to_le_bytes());
            bytes.extend(header.as_bytes());
            bytes.extend(vec![0; values]);
            Array::from_npy(&bytes)
        };
        let good = "{\"shape\":(2,),\"descr\":\"<f4\",\"fortran_order\":False}";
        assert_eq!(with(good, 8).unwrap().shape(), [2]);
        for (header, values, expected) in [
            (good, 7, "found 7"),
            (good, 12, "found 12"),
            (
                "{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}",
                8,
                "<f8",
            ),
            (
                "{'descr': '<f4', 'fortran_order': True, 'shape': (1,)}",
                4,
                "column-major",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False}",
                4,
                "without descr",
            ),
            (
                "{'descr': '<f4', 'descr': '<f4'}",
                4,
                "the header's key \"descr\"",
            ),
            ("{'colour': 3}", 4, "colour"),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}",
                4,
                "damaged",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (1,)} x",
                4,
                "damaged",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 4294967296)}",
                4,
                "at most",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (1,1,1,1,1,1,1,1,1)}",
                4,
                "more than 8",
            ),
            ("{'descr': '<f4', ", 4, "damaged"),
            ("", 4, "damaged"),
        ] {
            let error = with(header, values).unwrap_err().to_string();
            assert!(error.contains(expected), "{header}: {error}");
        }
        let mut newer = NUMPY.to_vec();
        newer[6] = 2;
        let error = Array::from_npy(&newer).unwrap_err().to_string();
        assert!(error.contains("version 2.0"), "{error}");
        assert!(Array::from_npy(b"\x89PNG\r\n\x1a\n").is_err());
        for cut in 0..NUMPY.len() {
            assert!(Array::from_npy(&NUMPY[..cut]).is_err(), "cut at {cut}");
        }
    }

    proptest! {
        #[test]
        fn altered_files_never_panic(at in 0_usize..136, byte: u8) {
            let mut bytes = NUMPY.to_vec();
            bytes[at] = byte;
            let _ = Array::from_npy(&bytes);
        }
    }
}
