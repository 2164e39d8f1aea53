//! Images and vectors of any element type, as bytes: the core knows sizes, numpy knows types.
//!
//! Results lie in memory of the core's pool, which goes back there when the last array that shows it is gone.
//! The `unsafe` of this crate is here and in `rollout`, but for a promise about mapped files that `load` passes on.

use numpy::ndarray::ArrayView1;
use numpy::{
    PyArray1, PyArrayDescr, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyReadwriteArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use vhs_base::check::check_shape;
use vhs_core::item::Item;
use vhs_core::pool::Bytes;

use crate::arrays::{as_array, borrow_mut, exact, readonly, type_name};
use crate::error::{dtype, layout, shape as shape_error, to_py};

/// Keeps pooled memory alive for the arrays that show it.
#[pyclass(frozen, module = "vhs._core")]
struct PooledMemory(#[expect(dead_code, reason = "held for its destructor")] Bytes);

/// The numpy name of an element type.
pub(crate) const fn item_name(item: Item) -> &'static str {
    match item {
        Item::I8 => "int8",
        Item::I32 => "int32",
        Item::I64 => "int64",
        Item::F32 => "float32",
        Item::F64 => "float64",
        Item::U16 => "uint16",
        Item::I16 => "int16",
        Item::U32 => "uint32",
        Item::U64 => "uint64",
        Item::F16 => "float16",
        Item::Bool => "bool",
        _ => "uint8",
    }
}

/// The element type that a numpy dtype, or its name, stands for.
pub(crate) fn item(field: &'static str, argument: &Bound<'_, PyAny>) -> PyResult<Item> {
    let py = argument.py();
    let descr = PyArrayDescr::new(py, argument.clone());
    let name = match descr {
        Ok(descr) => descr.getattr("name")?.extract::<String>()?,
        Err(_) => argument.str()?.to_string(),
    };
    let known = Item::ALL.into_iter().find(|&item| item_name(item) == name);
    known.ok_or_else(|| {
        let names = Item::ALL.map(item_name).join(", ");
        dtype(field, &format!("one of {names}"), &name)
    })
}

/// An array argument of exactly this type and shape, as bytes.
pub(crate) fn bytes_of<'py>(
    field: &str,
    argument: &Bound<'py, PyAny>,
    item: Item,
    shape: &[usize],
) -> PyResult<PyReadonlyArrayDyn<'py, u8>> {
    if item == Item::U8 {
        let array = exact::<u8>(field, argument)?;
        same_shape(field, shape, array.shape())?;
        return Ok(array);
    }
    let array = as_array(field, argument)?;
    check_type(field, &array, item)?;
    same_shape(field, shape, array.shape())?;
    let numpy = argument.py().import("numpy")?;
    if item == Item::Bool {
        // A byte that numpy calls a bool need not be 0 or 1: stored ones are, so that equal truths are equal bytes.
        let bytes = numpy.call_method1("ascontiguousarray", (array,))?;
        let bytes = bytes.call_method1("view", ("uint8",))?;
        let truths = numpy.call_method1("not_equal", (bytes, 0))?;
        let bytes = truths.call_method1("view", ("uint8",))?;
        return readonly(field, bytes.cast::<PyArrayDyn<u8>>()?);
    }
    // Also turns bytes of another order than the machine's, which a view would take as they are.
    let tidy = numpy.call_method1("ascontiguousarray", (array, item_name(item)))?;
    let bytes = tidy.call_method1("view", ("uint8",))?;
    readonly(field, bytes.cast::<PyArrayDyn<u8>>()?)
}

/// A caller's `out` array as bytes: this type, contiguous, writable; of this shape or, for `rows`, of so many
/// rows or more.
pub(crate) fn out_bytes<'py>(
    argument: &Bound<'py, PyAny>,
    item: Item,
    shape: &[usize],
) -> PyResult<PyReadwriteArrayDyn<'py, u8>> {
    let Ok(array) = argument.cast::<PyUntypedArray>() else {
        let expected = format!("an array of {}", item_name(item));
        return Err(dtype("out", &expected, &type_name(argument)));
    };
    let found = array.dtype();
    if found.getattr("name")?.extract::<String>()? != item_name(item)
        || !found.getattr("isnative")?.extract::<bool>()?
    {
        let expected = format!("an array of {}", item_name(item));
        return Err(dtype("out", &expected, &array.dtype().to_string()));
    }
    check_shape("out", shape, array.shape()).map_err(to_py)?;
    if !array.is_c_contiguous() {
        return Err(layout("out", "a C-contiguous array", "one with gaps"));
    }
    if let Ok(bytes) = array.cast::<PyArrayDyn<u8>>() {
        return borrow_mut(bytes);
    }
    let bytes = array.call_method1("view", ("uint8",))?;
    borrow_mut(bytes.cast::<PyArrayDyn<u8>>()?)
}

/// As `out_bytes`, for an `out` that may have more rows than needed: only the shape of a row is checked.
pub(crate) fn out_rows<'py>(
    argument: &Bound<'py, PyAny>,
    item: Item,
    row: &[usize],
) -> PyResult<PyReadwriteArrayDyn<'py, u8>> {
    let rows = argument.cast::<PyUntypedArray>().map_or(0, |array| {
        array.shape().first().copied().unwrap_or_default()
    });
    out_bytes(argument, item, &[&[rows], row].concat())
}

/// Hands pooled memory to numpy as an array of this type and shape, without a copy.
pub(crate) fn pooled<'py>(
    py: Python<'py>,
    mut bytes: Bytes,
    item: Item,
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let (start, len) = (bytes.as_mut_ptr(), bytes.len());
    let keeper = Bound::new(py, PooledMemory(bytes))?;
    // SAFETY: `start` points to `len` initialised bytes that neither move nor go as long as the keeper lives
    // (a mapping or the heap block of a vector), and nobody else reads or writes them: the keeper only waits
    // to be dropped.
    let flat = unsafe {
        let view = ArrayView1::from_shape_ptr(len, start);
        PyArray1::borrow_from_array(&view, keeper.into_any())
    };
    if item == Item::U8 {
        return flat.reshape(shape).map(Bound::into_any);
    }
    flat.call_method1("view", (item_name(item),))?
        .call_method1("reshape", (shape.to_vec(),))
}

/// A result in pooled memory: made by `fresh`, or written by `into` where there is an `out`.
///
/// Both may return something else beside the bytes.
pub(crate) fn filled_bytes<'py, X>(
    py: Python<'py>,
    out: Option<&Bound<'py, PyAny>>,
    item: Item,
    shape: &[usize],
    fresh: impl FnOnce() -> PyResult<(Bytes, X)>,
    into: impl FnOnce(&mut [u8]) -> PyResult<X>,
) -> PyResult<(Bound<'py, PyAny>, X)> {
    let Some(out) = out else {
        let (bytes, beside) = fresh()?;
        return Ok((pooled(py, bytes, item, shape)?, beside));
    };
    let mut room = out_bytes(out, item, shape)?;
    let beside = into(room.as_slice_mut()?)?;
    Ok((out.clone(), beside))
}

/// Refuses another shape than this one.
fn same_shape(field: &str, expected: &[usize], got: &[usize]) -> PyResult<()> {
    if expected == got {
        return Ok(());
    }
    Err(shape_error(field, &format!("{expected:?}"), got))
}

fn check_type(field: &str, array: &Bound<'_, PyUntypedArray>, item: Item) -> PyResult<()> {
    let found = array.dtype().getattr("name")?.extract::<String>()?;
    if found == item_name(item) {
        return Ok(());
    }
    Err(dtype(field, item_name(item), &found))
}
