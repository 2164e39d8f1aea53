//! Arguments in, arrays out: what every binding function needs to borrow, check and hand over.
//!
//! Images are taken as uint8 only and never copied when contiguous and aligned. Integer and real arguments may
//! be any numpy integer or float type, or a sequence; those that are not int64 or float32 already
//! are converted. Results are handed to numpy with their memory, so nothing is copied and
//! `torch.from_numpy` shares it.
use numpy::ndarray::{ArrayD, IxDyn};
use numpy::{
    BorrowError, Element, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyReadwriteArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyOverflowError;
use pyo3::prelude::*;
use pyo3::types::PyBool;
use vhs_base::check::check_shape;
use vhs_base::error::{Error, Result};
use vhs_base::rng::Rng;

use crate::error::{dtype, layout, to_py};

/// An array of exactly this element type, copied only where it is not contiguous or not aligned.
pub(crate) fn exact<'py, T: Element>(
    field: &str,
    argument: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let array = as_array(field, argument)?;
    let Ok(typed) = array.cast::<PyArrayDyn<T>>() else {
        let expected = T::get_dtype(argument.py()).to_string();
        return Err(dtype(field, &expected, &array.dtype().to_string()));
    };
    readonly(field, typed)
}

/// A one-dimensional array of integers as int64.
pub(crate) fn integers<'py>(
    field: &'static str,
    argument: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArrayDyn<'py, i64>> {
    let array = integer_array(field, argument)?;
    check_vector(field, array.shape())?;
    Ok(array)
}

/// Integers of any shape as int64.
pub(crate) fn integer_array<'py>(
    field: &'static str,
    argument: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArrayDyn<'py, i64>> {
    converted(field, argument, "iu", "integers")
}

/// Real numbers as float32.
pub(crate) fn reals<'py>(
    field: &'static str,
    argument: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArrayDyn<'py, f32>> {
    converted(field, argument, "fiu", "real numbers")
}

/// As `integers`, where the numbers must outlive the borrow.
pub(crate) fn integer_vec(field: &'static str, argument: &Bound<'_, PyAny>) -> PyResult<Vec<i64>> {
    Ok(slice(&integers(field, argument)?).to_vec())
}

/// As `reals`, where the numbers must outlive the borrow.
pub(crate) fn real_vec(field: &'static str, argument: &Bound<'_, PyAny>) -> PyResult<Vec<f32>> {
    let array = reals(field, argument)?;
    check_vector(field, array.shape())?;
    Ok(slice(&array).to_vec())
}

/// Booleans of this shape. A byte that numpy calls a bool need not be 0 or 1 (a mask of 0 and 255, viewed as
/// one), and Rust's must be: all but 0 is true, as numpy has it.
pub(crate) fn bools(
    field: &'static str,
    argument: &Bound<'_, PyAny>,
    shape: &[usize],
) -> PyResult<Vec<bool>> {
    let array = as_array(field, argument)?;
    if array.cast::<PyArrayDyn<bool>>().is_err() {
        return Err(dtype(field, "bool", &array.dtype().to_string()));
    }
    check_shape(field, shape, array.shape()).map_err(to_py)?;
    let bytes = exact::<u8>(field, &array.call_method1("view", ("uint8",))?)?;
    Ok(slice(&bytes).iter().map(|&byte| byte != 0).collect())
}

/// Refuses what is not one-dimensional.
pub(crate) fn check_vector(field: &'static str, shape: &[usize]) -> PyResult<()> {
    check_shape(field, &[shape.first().copied().unwrap_or(1)], shape).map_err(to_py)
}

/// The elements of an array that `readonly` has made sure is contiguous and aligned.
pub(crate) fn slice<'a, T: Element>(array: &'a PyReadonlyArrayDyn<'_, T>) -> &'a [T] {
    array.as_slice().unwrap_or_default()
}

/// A result as an array of this shape: made by `fresh`, or written by `into` where there is an `out`.
///
/// Both may return something else beside the array's elements.
pub(crate) fn filled<'py, T: Element, X>(
    py: Python<'py>,
    out: Option<&Bound<'py, PyAny>>,
    shape: &[usize],
    fresh: impl FnOnce() -> PyResult<(Vec<T>, X)>,
    into: impl FnOnce(&mut [T]) -> PyResult<X>,
) -> PyResult<(Bound<'py, PyAny>, X)> {
    let Some(out) = out else {
        let (items, beside) = fresh()?;
        return Ok((into_array(py, items, shape)?.into_any(), beside));
    };
    let mut room = exclusive(out, shape)?;
    let beside = into(room.as_slice_mut()?)?;
    Ok((out.clone(), beside))
}

/// A caller's `out` array: this type and shape, contiguous, writable.
pub(crate) fn exclusive<'py, T: Element>(
    argument: &Bound<'py, PyAny>,
    expected: &[usize],
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    let out = out_array(argument)?;
    check_shape("out", expected, out.shape()).map_err(to_py)?;
    borrow_mut(&out)
}

/// Hands a vector to numpy as an array of this shape, without a copy.
pub(crate) fn into_array<'py, T: Element>(
    py: Python<'py>,
    items: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let got = [items.len()];
    let array = ArrayD::from_shape_vec(IxDyn(shape), items).map_err(|_| {
        to_py(Error::Shape {
            field: "result",
            expected: shape.to_vec(),
            got: got.to_vec(),
        })
    })?;
    Ok(PyArrayDyn::from_owned_array(py, array))
}

/// A whole number as an i64.
pub(crate) fn integer(field: &'static str, argument: &Bound<'_, PyAny>) -> PyResult<i64> {
    if argument.is_instance_of::<PyBool>() {
        return Err(dtype(field, "an integer", "bool"));
    }
    argument.extract::<i64>().map_err(|error| {
        if error.is_instance_of::<PyOverflowError>(argument.py()) {
            return to_py(out_of_range(field, argument));
        }
        dtype(field, "an integer", &type_name(argument))
    })
}

/// A size or a count: zero or more.
pub(crate) fn size(field: &'static str, argument: &Bound<'_, PyAny>) -> PyResult<usize> {
    let number = integer(field, argument)?;
    usize::try_from(number).map_err(|_| to_py(out_of_range(field, argument)))
}

/// A seed: an integer in 0..2**64.
pub(crate) fn seed(argument: &Bound<'_, PyAny>) -> PyResult<u64> {
    argument.extract::<u64>().map_err(|error| {
        if error.is_instance_of::<PyOverflowError>(argument.py()) {
            let (expected, got) = ("an integer in 0..2**64".into(), argument.to_string());
            return to_py(Error::Argument {
                field: "seed",
                expected,
                got,
            });
        }
        dtype("seed", "an integer", &type_name(argument))
    })
}

/// A shape: a sequence of sizes.
pub(crate) fn shape(field: &'static str, argument: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
    let Ok(sizes) = argument.try_iter() else {
        return Err(dtype(field, "a sequence of sizes", &type_name(argument)));
    };
    sizes.map(|item| size(field, &item?)).collect()
}

/// A generator from the four words of its saved state.
pub(crate) fn rng_from_state(field: &'static str, argument: &Bound<'_, PyAny>) -> PyResult<Rng> {
    let words = exact::<u64>(field, argument)?;
    check_shape(field, &[4], words.shape()).map_err(to_py)?;
    let state = <[u64; 4]>::try_from(slice(&words)).unwrap_or_default();
    let zero = || Error::Argument {
        field,
        expected: "a state that is not all zero".into(),
        got: "zeros".into(),
    };
    Rng::from_state(state).ok_or_else(|| to_py(zero()))
}

/// The number of rows an `out` array has and rows of observations need, as a shape.
pub(crate) fn rows(count: usize, row: &[usize]) -> Vec<usize> {
    [&[count], row].concat()
}

/// A core result as a Python one.
pub(crate) fn checked<T>(result: Result<T>) -> PyResult<T> {
    result.map_err(to_py)
}

/// The name of an argument's type, for messages.
pub(crate) fn type_name(argument: &Bound<'_, PyAny>) -> String {
    argument
        .get_type()
        .name()
        .map_or_else(|_| "an unnamed type".into(), |name| name.to_string())
}

fn out_of_range(field: &'static str, argument: &Bound<'_, PyAny>) -> Error {
    Error::Argument {
        field,
        expected: format!("a number in 0..={}", i64::MAX),
        got: argument.to_string(),
    }
}

fn converted<'py, T: Element>(
    field: &'static str,
    argument: &Bound<'py, PyAny>,
    kinds: &str,
    expected: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let array = as_array(field, argument)?;
    if let Ok(typed) = array.cast::<PyArrayDyn<T>>() {
        return readonly(field, typed);
    }
    // An empty list has no integers that could say so: numpy makes it an array of floats.
    if array.len() > 0 && !kinds.contains(char::from(array.dtype().kind())) {
        return Err(dtype(field, expected, &array.dtype().to_string()));
    }
    let cast = array.call_method1("astype", (T::get_dtype(argument.py()),))?;
    readonly(field, cast.cast::<PyArrayDyn<T>>()?)
}

/// Any argument as some array.
pub(crate) fn as_array<'py>(
    field: &str,
    argument: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyUntypedArray>> {
    if let Ok(array) = argument.cast::<PyUntypedArray>() {
        return Ok(array.clone());
    }
    let made = argument
        .py()
        .import("numpy")?
        .call_method1("asarray", (argument,));
    let refused = |why: &str| dtype(field, "an array", &format!("{}{why}", type_name(argument)));
    // The reason is the argument's own, such as a tensor that has a gradient and is to be detached.
    let made = made.map_err(|error| refused(&format!(" ({})", error.value(argument.py()))))?;
    made.cast_into::<PyUntypedArray>().map_err(|_| refused(""))
}

/// A borrow of an array, copied first where it is not contiguous or not aligned (`np.frombuffer` with an offset).
pub(crate) fn readonly<'py, T: Element>(
    field: &str,
    array: &Bound<'py, PyArrayDyn<T>>,
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    if array.is_c_contiguous() && array.is_aligned() {
        return array.try_readonly().map_err(|error| in_use(field, &error));
    }
    let copy = array
        .py()
        .import("numpy")?
        .call_method1("require", (array, array.py().None(), "CA"))?;
    copy.cast::<PyArrayDyn<T>>()?
        .try_readonly()
        .map_err(|error| in_use(field, &error))
}

fn out_array<'py, T: Element>(argument: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let expected = || format!("an array of {}", T::get_dtype(argument.py()));
    let Ok(array) = argument.cast::<PyUntypedArray>() else {
        return Err(dtype("out", &expected(), &type_name(argument)));
    };
    let typed = array.cast::<PyArrayDyn<T>>();
    typed
        .cloned()
        .map_err(|_| dtype("out", &expected(), &array.dtype().to_string()))
}

/// A borrow of an array to be written in place.
pub(crate) fn borrow_mut<'py, T: Element>(
    out: &Bound<'py, PyArrayDyn<T>>,
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    if !out.is_c_contiguous() {
        return Err(layout("out", "a C-contiguous array", "one with gaps"));
    }
    if !out.is_aligned() {
        return Err(layout("out", "an aligned array", "one that is not"));
    }
    out.try_readwrite().map_err(|error| in_use("out", &error))
}

fn in_use(field: &str, error: &BorrowError) -> PyErr {
    let got = match error {
        BorrowError::NotWriteable => "a read-only one",
        _ => "one in use by another call",
    };
    layout(field, "an array free to be used", got)
}
