//! `vhs.GoalStore`.

use std::path::{Path, PathBuf};

use numpy::{PyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use vhs_base::check::check_shape;
use vhs_base::error::Result;
use vhs_core::config::Stacking;
use vhs_core::goals::{self as core, Balance};
use vhs_core::item::Item;

use crate::arrays::{
    checked, exact, integer, integer_vec, into_array, rng_from_state, rows, seed, shape, size,
    slice,
};
use crate::bytes::filled_bytes;
use crate::episode_buffer::{EpisodeBuffer, stacking};
use crate::error::no_pickle;
use crate::interrupt::interruptible;
use crate::shared::Shared;

type Sample<'py> = (Bound<'py, PyAny>, Bound<'py, PyArrayDyn<i64>>);

#[doc = stub!("GoalStore")]
#[pyclass(frozen, module = "vhs._core")]
pub(crate) struct GoalStore {
    inner: Shared<core::GoalStore>,
    /// Shape of one image: fixed, so reading it needs no lock.
    shape: Vec<usize>,
}

impl From<core::GoalStore> for GoalStore {
    fn from(store: core::GoalStore) -> Self {
        let shape = store.shape().to_vec();
        Self {
            inner: Shared::new(store),
            shape,
        }
    }
}

impl GoalStore {
    /// A call of the core, with the interpreter released.
    fn run<R: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut core::GoalStore) -> Result<R> + Send,
    ) -> PyResult<R> {
        checked(self.inner.detached(py, call))
    }

    /// A save that holds the store for moments only.
    fn save_to(&self, path: &Path) -> Result<()> {
        let saving = self.inner.with(core::GoalStore::begin_save)?;
        let saved = saving.write(path, |read| self.inner.with(|store| read(store)));
        self.inner.with(|store| store.end_save(&saving));
        saved
    }
}

#[pymethods]
impl GoalStore {
    #[new]
    #[pyo3(signature = (num_classes, observation_shape, capacity_per_class, seed=None),
           text_signature = "(num_classes, observation_shape, capacity_per_class, seed=0)")]
    fn new(
        num_classes: &Bound<'_, PyAny>,
        observation_shape: &Bound<'_, PyAny>,
        capacity_per_class: &Bound<'_, PyAny>,
        seed: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let shape = shape("observation_shape", observation_shape)?;
        let num_classes = size("num_classes", num_classes)?;
        let capacity = size("capacity_per_class", capacity_per_class)?;
        let seed = seed.map_or(Ok(0), self::seed)?;
        checked(core::GoalStore::new(num_classes, &shape, capacity, seed)).map(Self::from)
    }

    #[expect(clippy::unused_self, reason = "called on an object")]
    fn __reduce__(&self) -> PyResult<()> {
        Err(no_pickle("GoalStore"))
    }

    #[doc = stub!("GoalStore.push")]
    fn push(
        &self,
        py: Python<'_>,
        observation: &Bound<'_, PyAny>,
        label: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let (image, label) = (
            exact::<u8>("observation", observation)?,
            integer("label", label)?,
        );
        checked(check_shape("observation", &self.shape, image.shape()))?;
        let image = slice(&image);
        checked(self.inner.detached(py, |store| store.push(image, label)))
    }

    #[doc = stub!("GoalStore.collect")]
    fn collect(
        &self,
        py: Python<'_>,
        buffer: &EpisodeBuffer,
        ids: &Bound<'_, PyAny>,
    ) -> PyResult<usize> {
        let ids = integer_vec("ids", ids)?;
        // Always the store before the buffer: no other call holds two locks, so none can wait in a
        // circle.
        self.run(py, |store| {
            buffer.with_core(|buffer| store.collect(buffer, &ids))
        })
    }

    #[doc = stub!("GoalStore.sample")]
    #[pyo3(signature = (n, *, balanced=true, out=None))]
    fn sample<'py>(
        &self,
        py: Python<'py>,
        n: &Bound<'py, PyAny>,
        balanced: bool,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Sample<'py>> {
        let n = size("n", n)?;
        let shape = rows(n, &self.shape);
        let balance = if balanced {
            Balance::Classes
        } else {
            Balance::Images
        };
        let fresh = || self.run(py, |store| store.sample(n, balance));
        let into = |out: &mut [u8]| self.run(py, |store| store.sample_into(n, balance, out));
        let (images, labels) = filled_bytes(py, out, Item::U8, &shape, fresh, into)?;
        Ok((images, into_array(py, labels, &[n])?))
    }

    #[doc = stub!("GoalStore.sample_class")]
    #[pyo3(signature = (label, n, *, out=None))]
    fn sample_class<'py>(
        &self,
        py: Python<'py>,
        label: &Bound<'py, PyAny>,
        n: &Bound<'py, PyAny>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (label, n) = (integer("label", label)?, size("n", n)?);
        let fresh = || self.run(py, |store| Ok((store.sample_class(label, n)?, ())));
        let into = |out: &mut [u8]| self.run(py, |store| store.sample_class_into(label, n, out));
        Ok(filled_bytes(py, out, Item::U8, &rows(n, &self.shape), fresh, into)?.0)
    }

    #[doc = stub!("GoalStore.save")]
    #[expect(
        clippy::needless_pass_by_value,
        reason = "made from a Python path for this call"
    )]
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        interruptible(py, || self.save_to(&path))
    }

    #[doc = stub!("GoalStore.load")]
    #[staticmethod]
    #[pyo3(signature = (path, *, mmap=false, stacking="frames"))]
    #[expect(
        clippy::needless_pass_by_value,
        reason = "made from a Python path for this call"
    )]
    fn load(py: Python<'_>, path: PathBuf, mmap: bool, stacking: &str) -> PyResult<Self> {
        let stacking = self::stacking(stacking)?;
        let loaded = interruptible(py, || {
            if mmap {
                // SAFETY: the stub passes the condition on to the caller.
                unsafe { core::GoalStore::map(&path) }
            } else {
                core::GoalStore::load(&path)
            }
            .and_then(|store| match stacking {
                Stacking::Frames => Ok(store),
                Stacking::Channels => store.into_channels(),
            })
        });
        loaded.map(Self::from)
    }

    #[doc = stub!("GoalStore.verify")]
    #[staticmethod]
    #[expect(
        clippy::needless_pass_by_value,
        reason = "made from a Python path for this call"
    )]
    fn verify(py: Python<'_>, path: PathBuf) -> PyResult<()> {
        interruptible(py, || core::GoalStore::verify(&path))
    }

    #[doc = stub!("GoalStore.counts")]
    #[getter]
    #[expect(
        clippy::cast_possible_wrap,
        reason = "a count of images in memory is far below 2**63"
    )]
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<i64>>> {
        let counts: Vec<i64> = self.inner.detached(py, |store| {
            store.counts().map(|count| count as i64).collect()
        });
        let shape = [counts.len()];
        into_array(py, counts, &shape)
    }

    #[doc = stub!("GoalStore.rng_state")]
    #[getter]
    fn rng_state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u64>>> {
        let state = self.inner.detached(py, |store| store.rng_mut().state());
        into_array(py, state.to_vec(), &[4])
    }

    #[setter]
    fn set_rng_state(&self, py: Python<'_>, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let rng = rng_from_state("rng_state", state)?;
        self.inner.detached(py, |store| *store.rng_mut() = rng);
        Ok(())
    }

    #[doc = stub!("GoalStore.num_classes")]
    #[getter]
    fn num_classes(&self, py: Python<'_>) -> usize {
        self.inner.detached(py, |store| store.num_classes())
    }

    #[doc = stub!("GoalStore.observation_shape")]
    #[getter]
    fn observation_shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.shape)
    }

    #[doc = stub!("GoalStore.capacity_per_class")]
    #[getter]
    fn capacity_per_class(&self, py: Python<'_>) -> usize {
        self.inner.detached(py, |store| store.capacity_per_class())
    }

    #[doc = stub!("GoalStore.nbytes")]
    #[getter]
    fn nbytes(&self, py: Python<'_>) -> usize {
        self.inner.detached(py, |store| store.allocated_bytes())
    }

    #[doc = stub!("GoalStore.__len__")]
    fn __len__(&self, py: Python<'_>) -> usize {
        self.inner.detached(py, |store| store.len())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let counts: Vec<usize> = self.inner.detached(py, |store| store.counts().collect());
        format!(
            "GoalStore(observation_shape={:?}, counts={counts:?})",
            self.shape
        )
    }
}
