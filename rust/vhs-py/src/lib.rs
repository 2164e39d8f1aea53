//! The extension module `vhs._core`: borrow, check, call, map errors. No loop over data lives here.
//!
//! Documentation for users is written once, in `python/vhs/_core.pyi`, which editors read and `stubtest` checks
//! against this module; `build.rs` takes it from there, so that `help()` says the same.
#![deny(missing_docs)]
#![allow(
    clippy::doc_markdown,
    reason = "docstrings of Python have marks of their own"
)]

/// The docstring that the stub has for a class, a function or `Class.method`.
macro_rules! stub {
    ($name:literal) => {
        include_str!(concat!(env!("OUT_DIR"), "/", $name, ".txt"))
    };
}

mod arrays;
mod batch;
mod bytes;
mod egomotion;
mod episode_buffer;
mod error;
mod field;
mod goals;
mod hindsight;
mod interrupt;
mod prototypes;
mod raster;
mod raster_arrays;
mod raster_feed;
mod raster_records;
mod raster_scene;
mod raster_source;
mod relabel;
mod returns;
mod rng;
#[cfg(target_os = "linux")]
mod rollout;
mod shared;
mod transitions;

/// The compiled half of the Python package `vhs`.
///
/// It asks for the interpreter's lock, also on free-threaded builds: arrays are read where they lie, and only the lock
/// keeps other threads from writing into them meanwhile.
#[pyo3::pymodule(gil_used = true)]
mod _core {
    #[pymodule_export]
    use crate::batch::{EpisodeBatch, Hindsight};
    #[pymodule_export]
    use crate::egomotion::egomotion;
    #[pymodule_export]
    use crate::episode_buffer::EpisodeBuffer;
    #[pymodule_export]
    use crate::field::Field;
    #[pymodule_export]
    use crate::goals::GoalStore;
    #[pymodule_export]
    use crate::hindsight::SparseReward;
    #[pymodule_export]
    use crate::prototypes::Prototypes;
    #[pymodule_export]
    use crate::raster::RasterCanvas;
    #[pymodule_export]
    use crate::raster_scene::RasterScene;
    #[pymodule_export]
    use crate::raster_source::RasterSource;
    #[pymodule_export]
    use crate::relabel::relabel;
    #[pymodule_export]
    use crate::returns::discounted_returns;
    #[pymodule_export]
    use crate::rng::Rng;
    #[cfg(target_os = "linux")]
    #[pymodule_export]
    use crate::rollout::{RolloutLearner, RolloutWorker};
    #[pymodule_export]
    use crate::transitions::{TransitionBatch, WindowBatch};

    use numpy::{PyArray1, PyArrayMethods};
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        // The version is written once, in Cargo.toml. Not by `add`, which would put it into `__all__`.
        module.setattr("__version__", env!("CARGO_PKG_VERSION"))?;
        // What is looked up once must not be half looked up by a thread when this process forks: the child would wait
        // for that thread for ever.
        drop(PyArray1::<u8>::zeros(module.py(), 1, false).try_readonly());
        crate::error::register(module)
    }
}
