//! The extension module `vhs._core`.

mod raster;

/// The compiled half of the Python package `vhs`.
#[pyo3::pymodule]
mod _core {
    #[pymodule_export]
    use super::raster::{RasterCanvas, RasterScene};
}
