//! Core errors as Python exceptions: the only place that maps one to the other.
//!
//! Every class derives from `VhsError` and, where one fits, from a builtin, so that both `except
//! vhs.VhsError` and `except IndexError` work. The classes say `vhs._core` as their module: with a
//! bare `_core` they could not be pickled.

use pyo3::exceptions::{
    PyException, PyIndexError, PyLookupError, PyMemoryError, PyNotImplementedError, PyOSError,
    PyRuntimeError, PyTypeError, PyValueError,
};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyTuple, PyType};
use vhs_base::error::Error;
use vhs_raster::Error as RasterError;

/// The exception classes, in the order of `CLASSES`.
#[derive(Clone, Copy)]
enum Kind {
    Base,
    Shape,
    Dtype,
    Layout,
    Argument,
    Label,
    NonFinite,
    Empty,
    Episode,
    Protocol,
    Memory,
    DamagedFile,
    Unsupported,
}

/// Name and documentation of each class.
const CLASSES: [(&str, &str); 13] = [
    (
        "VhsError",
        "Base of everything that vhs refuses, except errors of the operating system (OSError).",
    ),
    ("ShapeError", "An array has another shape than expected."),
    (
        "DtypeError",
        "An array or a number has another type than expected.",
    ),
    (
        "LayoutError",
        "An `out` array cannot be written in place: not contiguous, read-only or in use.",
    ),
    (
        "ArgumentError",
        "A setting is out of range, or a word is not one of those known.",
    ),
    (
        "LabelError",
        "A class, goal, interaction, action or stream number is out of range.",
    ),
    (
        "NonFiniteError",
        "A reward, value or feature is NaN or infinite.",
    ),
    ("EmptyError", "Something was to be sampled from nothing."),
    (
        "EpisodeError",
        "No episode with this id is stored: it was evicted or never existed.",
    ),
    (
        "ProtocolError",
        "A call came in the wrong state of a stream, such as finishing an episode twice.",
    ),
    ("OutOfMemoryError", "The allocator refused."),
    (
        "DamagedFileError",
        "A file is not one of ours, is cut short or has been altered.",
    ),
    (
        "UnsupportedError",
        "A model or an option asks for something that the renderer does not draw.",
    ),
];

static TYPES: PyOnceLock<Vec<Py<PyType>>> = PyOnceLock::new();

/// The Python exception for a core error.
#[expect(
    clippy::needless_pass_by_value,
    reason = "the signature that `map_err` wants"
)]
pub(crate) fn to_py(error: Error) -> PyErr {
    let kind = match &error {
        Error::Shape { .. } => Kind::Shape,
        Error::Argument { .. } => Kind::Argument,
        Error::Label { .. } => Kind::Label,
        Error::NonFinite { .. } => Kind::NonFinite,
        Error::Empty { .. } => Kind::Empty,
        Error::Protocol { .. } | Error::TooManySteps { .. } => Kind::Protocol,
        Error::Evicted { .. } | Error::UnknownEpisode { .. } => Kind::Episode,
        Error::Memory { .. } => Kind::Memory,
        Error::Damaged { .. } => Kind::DamagedFile,
        Error::Io { path, source, .. } => {
            return os_error(source, path.display().to_string(), &error);
        }
        // The enum may grow; until it is mapped here, a new variant is at least a VhsError.
        _ => Kind::Base,
    };
    raise(kind, error.to_string())
}

/// The Python exception for an error of the renderer.
#[expect(
    clippy::needless_pass_by_value,
    reason = "the signature that `map_err` wants"
)]
pub(crate) fn raster_to_py(error: RasterError) -> PyErr {
    let kind = match &error {
        RasterError::Length { .. } => Kind::Shape,
        RasterError::NotFinite { .. } => Kind::NonFinite,
        RasterError::Index { .. } | RasterError::Range { .. } => Kind::Argument,
        RasterError::Unsupported { .. } => Kind::Unsupported,
        _ => Kind::Base,
    };
    raise(kind, error.to_string())
}

/// A shape that cannot be written as a list of sizes, such as one with a free axis.
pub(crate) fn shape(field: &str, expected: &str, got: &[usize]) -> PyErr {
    raise(
        Kind::Shape,
        format!("`{field}`: expected shape {expected}, got {got:?}"),
    )
}

/// A call that another call must come before.
pub(crate) fn protocol(call: &str, expected: &str, found: &str) -> PyErr {
    raise(
        Kind::Protocol,
        format!("`{call}`: expected {expected}, found {found}"),
    )
}

/// What pickling says: storage may be larger than memory, and has files of its own.
pub(crate) fn no_pickle(class: &str) -> PyErr {
    PyTypeError::new_err(format!(
        "{class} is not pickled or copied: `save` and `load` keep it in a file"
    ))
}

/// A wrong dtype: Python's own matter, the core only knows typed slices.
pub(crate) fn dtype(field: &str, expected: &str, got: &str) -> PyErr {
    raise(
        Kind::Dtype,
        format!("`{field}`: expected {expected}, got {got}"),
    )
}

/// An array that cannot be used where it lies.
pub(crate) fn layout(field: &str, expected: &str, got: &str) -> PyErr {
    raise(
        Kind::Layout,
        format!("`{field}`: expected {expected}, got {got}"),
    )
}

/// Adds the exception classes to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let types = types(module.py())?;
    CLASSES
        .iter()
        .zip(types)
        .try_for_each(|((name, _), class)| module.add(*name, class))
}

fn raise(kind: Kind, message: String) -> PyErr {
    Python::attach(|py| match types(py) {
        Ok(types) => PyErr::from_type(types[kind as usize].bind(py).clone(), message),
        Err(error) => error,
    })
}

/// `OSError` picks the fitting subclass, such as `FileNotFoundError`, from the error number.
fn os_error(source: &std::io::Error, path: String, error: &Error) -> PyErr {
    match source.raw_os_error() {
        Some(number) => PyOSError::new_err((number, error.to_string(), path)),
        None => PyOSError::new_err(error.to_string()),
    }
}

fn types(py: Python<'_>) -> PyResult<&Vec<Py<PyType>>> {
    TYPES.get_or_try_init(py, || {
        let builtins = [
            py.get_type::<PyException>(),
            py.get_type::<PyValueError>(),
            py.get_type::<PyTypeError>(),
            py.get_type::<PyValueError>(),
            py.get_type::<PyValueError>(),
            py.get_type::<PyIndexError>(),
            py.get_type::<PyValueError>(),
            py.get_type::<PyLookupError>(),
            py.get_type::<PyLookupError>(),
            py.get_type::<PyRuntimeError>(),
            py.get_type::<PyMemoryError>(),
            py.get_type::<PyValueError>(),
            py.get_type::<PyNotImplementedError>(),
        ];
        let mut types: Vec<Py<PyType>> = Vec::new();
        for ((name, doc), builtin) in CLASSES.iter().zip(&builtins) {
            let base = types.first().map(|base| base.bind(py));
            types.push(new_class(name, doc, base, builtin)?);
        }
        Ok(types)
    })
}

fn new_class(
    name: &str,
    doc: &str,
    base: Option<&Bound<'_, PyType>>,
    builtin: &Bound<'_, PyType>,
) -> PyResult<Py<PyType>> {
    let py = builtin.py();
    let bases: Vec<_> = base.into_iter().chain([builtin]).collect();
    let bases = PyTuple::new(py, bases)?;
    let body = PyDict::new(py);
    body.set_item("__module__", "vhs._core")?;
    body.set_item("__doc__", doc)?;
    let class = py.get_type::<PyType>().call1((name, bases, body))?;
    Ok(class.cast_into::<PyType>()?.unbind())
}
