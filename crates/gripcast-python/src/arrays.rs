//! Arrays of numpy: checked copies in, copies out.

use image::RgbImage;
use numpy::{
    Element, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::failure::Outcome;
use super::work::detached;
use gripcast_base::error::Error;
use gripcast_imaging::{Decoder, DepthImage};

/// Largest width or height of an image, px.
const MAX_SIDE: usize = 8192;

/// An array that Python may not change.
pub(crate) fn array<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Py<PyAny>> {
    let array = PyArray1::from_vec(py, values).reshape(shape)?;
    let flags = PyDict::new(py);
    flags.set_item("write", false)?;
    array.call_method("setflags", (), Some(&flags))?;
    Ok(array.into_any().unbind())
}

/// An array of one number per item; NaN for `None`.
pub(crate) fn column(
    py: Python<'_>,
    values: impl Iterator<Item = Option<f64>>,
) -> PyResult<Py<PyAny>> {
    let values: Vec<f64> = values.map(|value| value.unwrap_or(f64::NAN)).collect();
    let length = values.len();
    array(py, values, &[length])
}

/// Shape and type of an array, or the type of what is none, for errors.
pub(crate) fn described(value: &Bound<'_, PyAny>) -> String {
    match value.cast::<PyUntypedArray>() {
        Ok(array) => format!("{} of shape {:?}", array.dtype(), array.shape()),
        Err(_) => value
            .get_type()
            .name()
            .map_or_else(|_| "another object".to_owned(), |name| name.to_string()),
    }
}

fn refused(name: &str, expected: &str, value: &Bound<'_, PyAny>) -> Error {
    let found = described(value);
    Error::input(format!(
        "`{name}` must be a numpy array, {expected}; found {found}"
    ))
}

/// Checks width and height of an image.
fn sides(name: &str, width: usize, height: usize) -> Result<[u32; 2], Error> {
    let is_valid = |side: usize| (1..=MAX_SIDE).contains(&side);
    if is_valid(width) && is_valid(height) {
        return Ok([width as u32, height as u32]);
    }
    Err(Error::input(format!(
        "`{name}` must be from 1×1 to {MAX_SIDE}×{MAX_SIDE} pixels, found {width}×{height}"
    )))
}

/// Copies an image: height × width × 3, uint8, RGB.
pub(crate) fn image(value: &Bound<'_, PyAny>, name: &str) -> Outcome<RgbImage> {
    let wrong = || refused(name, "uint8 of shape (height, width, 3), RGB", value);
    let array = value.cast::<PyArrayDyn<u8>>().map_err(|_| wrong())?;
    let &[height, width, 3] = array.shape() else {
        return Err(wrong().into());
    };
    let [width, height] = sides(name, width, height)?;
    let pixels = array.readonly().as_array().iter().copied().collect();
    RgbImage::from_raw(width, height, pixels).ok_or_else(|| wrong().into())
}

/// Copies a depth image of counts: height × width, uint16.
pub(crate) fn depth_counts(value: &Bound<'_, PyAny>, name: &str) -> Outcome<DepthImage> {
    let wrong = || refused(name, "uint16 of shape (height, width)", value);
    let array = value.cast::<PyArrayDyn<u16>>().map_err(|_| wrong())?;
    let &[height, width] = array.shape() else {
        return Err(wrong().into());
    };
    let [width, height] = sides(name, width, height)?;
    let counts = array.readonly().as_array().iter().copied().collect();
    DepthImage::from_raw(width, height, counts).ok_or_else(|| wrong().into())
}

/// An image for Python.
pub(crate) fn image_array(py: Python<'_>, image: RgbImage) -> PyResult<Py<PyAny>> {
    let shape = [image.height() as usize, image.width() as usize, 3];
    array(py, image.into_raw(), &shape)
}

/// Decodes a JPEG, PNG or WebP file: height × width × 3, uint8, RGB.
#[pyfunction]
pub(crate) fn decode_image(py: Python<'_>, data: Vec<u8>) -> Outcome<Py<PyAny>> {
    let image = detached(py, || Decoder::new()?.stored_image(&data))?;
    Ok(image_array(py, image)?)
}

/// Copies finite numbers of any real type; `shape` has `None` where any length is right.
pub(crate) fn numbers(
    value: &Bound<'_, PyAny>,
    name: &str,
    shape: &[Option<usize>],
) -> Outcome<Vec<f64>> {
    let sides = shape.iter().map(|side| match side {
        Some(side) => side.to_string(),
        None => "n".to_owned(),
    });
    let sides: Vec<String> = sides.collect();
    let expected = format!("real numbers of shape ({})", sides.join(", "));
    let py = value.py();
    let array = py.import("numpy")?.call_method1("asarray", (value,));
    let wrong = || refused(name, &expected, value);
    let array = array.map_err(|_| wrong())?;
    let untyped = array.cast::<PyUntypedArray>().map_err(|_| wrong())?;
    let kind = untyped.dtype().kind();
    let fits = untyped.ndim() == shape.len()
        && (untyped.shape().iter().zip(shape))
            .all(|(found, side)| side.is_none_or(|side| side == *found));
    if !b"fiu".contains(&kind) || !fits {
        return Err(refused(name, &expected, &array).into());
    }
    let array = array.call_method1("astype", ("float64",))?;
    let array = array.cast::<PyArrayDyn<f64>>().map_err(|_| wrong())?;
    let values: Vec<f64> = array.readonly().as_array().iter().copied().collect();
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(values),
        Some(at) => {
            let row = shape.iter().skip(1).map(|side| side.unwrap_or(1));
            let row: usize = row.product();
            Err(Error::input(format!(
                "`{name}` must be finite numbers, found {} in row {}",
                values[at],
                at / row.max(1)
            ))
            .into())
        }
    }
}

/// Copies indices: n × 3, any integer type, each below `limit`.
pub(crate) fn indices(
    value: &Bound<'_, PyAny>,
    name: &str,
    limit: usize,
) -> Outcome<Vec<[u32; 3]>> {
    let expected = "integers of shape (n, 3)";
    let py = value.py();
    let array = py.import("numpy")?.call_method1("asarray", (value,));
    let wrong = || refused(name, expected, value);
    let array = array.map_err(|_| wrong())?;
    let untyped = array.cast::<PyUntypedArray>().map_err(|_| wrong())?;
    if !b"iu".contains(&untyped.dtype().kind()) || !matches!(untyped.shape(), &[_, 3]) {
        return Err(refused(name, expected, &array).into());
    }
    let array = array.call_method1("astype", ("int64",))?;
    let array = array.cast::<PyArrayDyn<i64>>().map_err(|_| wrong())?;
    let values: Vec<i64> = array.readonly().as_array().iter().copied().collect();
    let index = |value: &i64| usize::try_from(*value).ok().filter(|i| *i < limit);
    if let Some(at) = values.iter().position(|value| index(value).is_none()) {
        return Err(Error::input(format!(
            "`{name}` must be indices from 0 to {}, found {} in row {}",
            limit.saturating_sub(1),
            values[at],
            at / 3
        ))
        .into());
    }
    let rows = values.chunks_exact(3);
    Ok(rows
        .map(|row| [row[0] as u32, row[1] as u32, row[2] as u32])
        .collect())
}
