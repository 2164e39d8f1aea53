//! Arrays of a model as the renderer takes them.

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use vhs_raster::Error;

use crate::error::{layout, raster_to_py as to_py, shape};

/// The error for an array that has gaps between its rows.
pub(crate) fn gaps(field: &'static str) -> impl Fn(numpy::AsSliceError) -> PyErr {
    move |_| layout(field, "a C-contiguous array", "one with strides")
}

/// Rows of `N` numbers from an array whose last axis has that length.
pub(crate) fn rows<T: numpy::Element + Copy, const N: usize>(
    field: &'static str,
    array: &PyReadonlyArray2<'_, T>,
) -> PyResult<Vec<[T; N]>> {
    let (rows, rest) = array.as_slice().map_err(gaps(field))?.as_chunks::<N>();
    if array.shape()[1] != N || !rest.is_empty() {
        return Err(shape(field, &format!("[n, {N}]"), array.shape()));
    }
    Ok(rows.to_vec())
}

/// Indices as MuJoCo stores them: i32, never negative here.
pub(crate) fn indices(
    field: &'static str,
    array: &PyReadonlyArray2<'_, i32>,
) -> PyResult<Vec<[u32; 3]>> {
    let corners = rows::<i32, 3>(field, array)?;
    if let Some(negative) = corners.iter().flatten().find(|&&i| i < 0) {
        return Err(to_py(Error::Range {
            what: field,
            expected: "indices of at least 0",
            got: negative.to_string(),
        }));
    }
    Ok(corners.iter().map(|c| c.map(i32::cast_unsigned)).collect())
}
