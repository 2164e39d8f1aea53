//! What a `vhs.EpisodeBuffer` says of itself: its content, what it was built from, its generator.

use std::collections::BTreeMap;

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use vhs_core::episodes as core;

use super::EpisodeBuffer;
use crate::arrays::{into_array, rng_from_state};
use crate::bytes::item_name;
use crate::error::no_pickle;
use crate::field;

#[pymethods]
impl EpisodeBuffer {
    #[doc = stub!("EpisodeBuffer.rng_state")]
    #[getter]
    fn rng_state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u64>>> {
        let state = self.rng.with(|rng| rng.state());
        into_array(py, state.to_vec(), &[4])
    }

    #[setter]
    fn set_rng_state(&self, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let state = rng_from_state("rng_state", state)?;
        self.rng.with(|rng| *rng = state);
        Ok(())
    }

    #[expect(clippy::unused_self, reason = "called on an object")]
    fn __reduce__(&self) -> PyResult<()> {
        Err(no_pickle("EpisodeBuffer"))
    }

    #[doc = stub!("EpisodeBuffer.ids")]
    #[getter]
    fn ids<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<i64>>> {
        let ids: Vec<i64> = self.with_buffer(py, |buffer| buffer.ids().collect());
        let shape = [ids.len()];
        into_array(py, ids, &shape)
    }

    #[doc = stub!("EpisodeBuffer.open")]
    #[getter]
    fn open<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        let open = self.with_buffer(py, |buffer| {
            buffer.open_episodes().map(|e| e.is_some()).collect()
        });
        into_array(py, open, &[self.config().num_streams])
    }

    #[doc = stub!("EpisodeBuffer.num_steps")]
    #[getter]
    fn num_steps(&self, py: Python<'_>) -> usize {
        self.with_buffer(py, core::EpisodeBuffer::num_steps)
    }

    #[doc = stub!("EpisodeBuffer.nbytes")]
    #[getter]
    fn nbytes(&self, py: Python<'_>) -> usize {
        self.with_buffer(py, core::EpisodeBuffer::allocated_bytes)
    }

    #[doc = stub!("EpisodeBuffer.frame_shape")]
    #[getter]
    fn frame_shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.config().frame_shape)
    }

    #[doc = stub!("EpisodeBuffer.observation_shape")]
    #[getter]
    fn observation_shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.config().observation_shape())
    }

    #[doc = stub!("EpisodeBuffer.dtype")]
    #[getter]
    fn dtype<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        py.import("numpy")?
            .call_method1("dtype", (item_name(self.config().frame_item),))
    }

    #[doc = stub!("EpisodeBuffer.fields")]
    #[getter]
    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        field::declared(py, &self.config().fields)
    }

    #[doc = stub!("EpisodeBuffer.goals")]
    #[getter]
    fn goals(&self) -> &'static str {
        self.goal_word()
    }

    #[doc = stub!("EpisodeBuffer.goal_shape")]
    #[getter]
    fn goal_shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.goal_array().0)
    }

    #[doc = stub!("EpisodeBuffer.goal_dtype")]
    #[getter]
    fn goal_dtype<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let name = item_name(self.goal_array().1);
        py.import("numpy")?.call_method1("dtype", (name,))
    }

    #[doc = stub!("EpisodeBuffer.stacking")]
    #[getter(stacking)]
    fn stacking_getter(&self) -> &'static str {
        self.stacking_word()
    }

    #[doc = stub!("EpisodeBuffer.interactions")]
    #[getter(interactions)]
    fn interactions_getter(&self) -> BTreeMap<i64, i64> {
        self.config().interactions.clone()
    }

    #[doc = stub!("EpisodeBuffer.priority_exponent")]
    #[getter]
    const fn priority_exponent(&self) -> Option<f64> {
        self.config().priority_exponent
    }

    #[doc = stub!("EpisodeBuffer.first_action")]
    #[getter]
    fn first_action(&self) -> i64 {
        self.config().first_action
    }

    #[doc = stub!("EpisodeBuffer.__len__")]
    fn __len__(&self, py: Python<'_>) -> usize {
        self.with_buffer(py, core::EpisodeBuffer::len)
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (len, steps) = self.with_buffer(py, |buffer| (buffer.len(), buffer.num_steps()));
        format!(
            "EpisodeBuffer({len} episodes, {steps} of {} steps)",
            self.config().capacity_steps
        )
    }
}
