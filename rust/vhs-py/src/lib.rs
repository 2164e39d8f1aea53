//! The extension module `vhs._core`.

/// The compiled half of the Python package `vhs`.
#[pyo3::pymodule]
mod _core {}
