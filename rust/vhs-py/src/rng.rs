//! `vhs.Rng`: the seeded generator, as an argument of samplers.

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use vhs_base::rng as core;

use crate::arrays::{into_array, rng_from_state, seed};
use crate::shared::Shared;

#[doc = stub!("Rng")]
#[pyclass(frozen, module = "vhs._core")]
pub(crate) struct Rng {
    pub(crate) inner: Shared<core::Rng>,
}

#[pymethods]
impl Rng {
    #[new]
    #[pyo3(signature = (seed=None), text_signature = "(seed=0)")]
    fn new(seed: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let seed = seed.map_or(Ok(0), self::seed)?;
        Ok(Self {
            inner: Shared::new(core::Rng::new(seed)),
        })
    }

    #[doc = stub!("Rng.from_state")]
    #[staticmethod]
    fn from_state(state: &Bound<'_, PyAny>) -> PyResult<Self> {
        Ok(Self {
            inner: Shared::new(rng_from_state("state", state)?),
        })
    }

    #[doc = stub!("Rng.state")]
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u64>>> {
        let state = self.inner.detached(py, |rng| rng.state());
        into_array(py, state.to_vec(), &[4])
    }
}
