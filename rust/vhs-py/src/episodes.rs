//! `vhs.EpisodeBuffer`.

use std::sync::{Mutex, PoisonError};

use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySlice, PyTuple};
use vhs_core::batch::Batch;
use vhs_core::episodes::{self as core, EpisodeConfig, Steps};
use vhs_core::error::{Result, check_shape};
use vhs_core::relabel::Hindsight;

use crate::arrays::{
    check_vector, checked, detached, exact, exclusive_rows, filled, integer, integer_vec, integers,
    into_array, reals, rng_from_state, rows, seed, shape, size, slice,
};
use crate::batch::EpisodeBatch;
use crate::relabel::{outcome, rule};

/// Episodes of many environments at once; see the stub for its documentation.
#[pyclass(frozen, module = "vhs._core")]
pub(crate) struct EpisodeBuffer {
    inner: Mutex<core::EpisodeBuffer>,
    /// What the buffer was built from: fixed, so reading it needs no lock.
    config: EpisodeConfig,
}

impl EpisodeBuffer {
    /// Runs `work` on the core buffer, for callers that have released the interpreter already.
    pub(crate) fn with_core<R>(&self, work: impl FnOnce(&core::EpisodeBuffer) -> R) -> R {
        work(&self.inner.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Shape of one stacked observation.
    fn row(&self) -> Vec<usize> {
        rows(self.config.frame_stack, &self.config.frame_shape)
    }

    /// A call of the core, with the interpreter released.
    fn run<R: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut core::EpisodeBuffer) -> Result<R> + Send,
    ) -> PyResult<R> {
        checked(detached(py, &self.inner, call))
    }

    /// A batch of the core as arrays.
    fn batch(
        &self,
        py: Python<'_>,
        batch: Batch,
        hindsight: Option<Hindsight>,
    ) -> PyResult<EpisodeBatch> {
        let shape = rows(batch.index.rows, &self.row());
        let observations = into_array(py, batch.observations, &shape)?.into_any();
        EpisodeBatch::from_core(
            observations,
            batch.index,
            hindsight,
            self.first_interaction_action(),
        )
    }

    fn first_interaction_action(&self) -> i64 {
        i64::try_from(self.config.first_interaction_action).unwrap_or(i64::MAX)
    }

    /// A frame argument, checked.
    fn frame<'py>(&self, frame: &Bound<'py, PyAny>) -> PyResult<PyReadonlyArrayDyn<'py, u8>> {
        let frame = exact::<u8>("frame", frame)?;
        checked(check_shape(
            "frame",
            &self.config.frame_shape,
            frame.shape(),
        ))?;
        Ok(frame)
    }

    /// The streams of an argument; None means all.
    fn all_streams(&self, streams: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<i64>> {
        let all = || Ok((0..).take(self.config.num_streams).collect());
        streams.map_or_else(all, |streams| integer_vec("streams", streams))
    }
}

#[pymethods]
impl EpisodeBuffer {
    #[new]
    #[pyo3(signature = (frame_shape, *, num_streams, max_episode_steps, capacity_steps, frame_stack=None, num_goals,
                        num_interactions, first_interaction_action=None, seed=None),
           text_signature = "(frame_shape, *, num_streams, max_episode_steps, capacity_steps, frame_stack=2, \
                             num_goals, num_interactions, first_interaction_action=3, seed=0)")]
    #[expect(
        clippy::too_many_arguments,
        reason = "keyword arguments in Python; one struct from here on"
    )]
    fn new(
        frame_shape: &Bound<'_, PyAny>,
        num_streams: &Bound<'_, PyAny>,
        max_episode_steps: &Bound<'_, PyAny>,
        capacity_steps: &Bound<'_, PyAny>,
        frame_stack: Option<&Bound<'_, PyAny>>,
        num_goals: &Bound<'_, PyAny>,
        num_interactions: &Bound<'_, PyAny>,
        first_interaction_action: Option<&Bound<'_, PyAny>>,
        seed: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let config = EpisodeConfig {
            frame_shape: shape("frame_shape", frame_shape)?,
            num_streams: size("num_streams", num_streams)?,
            max_episode_steps: size("max_episode_steps", max_episode_steps)?,
            capacity_steps: size("capacity_steps", capacity_steps)?,
            frame_stack: frame_stack.map_or(Ok(2), |stack| size("frame_stack", stack))?,
            num_goals: size("num_goals", num_goals)?,
            num_interactions: size("num_interactions", num_interactions)?,
            first_interaction_action: first_interaction_action
                .map_or(Ok(3), |action| size("first_interaction_action", action))?,
            seed: seed.map_or(Ok(0), self::seed)?,
        };
        Ok(Self {
            inner: Mutex::new(checked(core::EpisodeBuffer::new(config.clone()))?),
            config,
        })
    }

    fn begin(
        &self,
        py: Python<'_>,
        stream: &Bound<'_, PyAny>,
        frame: &Bound<'_, PyAny>,
        goal: &Bound<'_, PyAny>,
        interaction: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let (stream, frame) = (integer("stream", stream)?, self.frame(frame)?);
        let (goal, interaction) = (integer("goal", goal)?, integer("interaction", interaction)?);
        let frame = slice(&frame);
        self.run(py, |buffer| buffer.begin(stream, frame, goal, interaction))
    }

    fn append(
        &self,
        py: Python<'_>,
        stream: &Bound<'_, PyAny>,
        action: &Bound<'_, PyAny>,
        reward: f32,
        value: f32,
        frame: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let (stream, action) = (integer("stream", stream)?, integer("action", action)?);
        let frame = self.frame(frame)?;
        let (streams, actions, rewards, values) = (&[stream], &[action], &[reward], &[value]);
        let steps = Steps {
            streams,
            actions,
            rewards,
            values,
            frames: slice(&frame),
        };
        self.run(py, |buffer| buffer.append(steps))
    }

    fn append_batch(
        &self,
        py: Python<'_>,
        streams: &Bound<'_, PyAny>,
        actions: &Bound<'_, PyAny>,
        rewards: &Bound<'_, PyAny>,
        values: &Bound<'_, PyAny>,
        frames: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let (streams, actions) = (integers("streams", streams)?, integers("actions", actions)?);
        let (rewards, values) = (reals("rewards", rewards)?, reals("values", values)?);
        let frames = exact::<u8>("frames", frames)?;
        // The core compares the lengths; it cannot see whether an array has more dimensions.
        check_vector("rewards", rewards.shape())?;
        check_vector("values", values.shape())?;
        let batch = rows(streams.len(), &self.config.frame_shape);
        checked(check_shape("frames", &batch, frames.shape()))?;
        let steps = Steps {
            streams: slice(&streams),
            actions: slice(&actions),
            rewards: slice(&rewards),
            values: slice(&values),
            frames: slice(&frames),
        };
        self.run(py, |buffer| buffer.append(steps))
    }

    fn finish(
        &self,
        py: Python<'_>,
        stream: &Bound<'_, PyAny>,
        outcome: &Bound<'_, PyAny>,
    ) -> PyResult<i64> {
        let (stream, outcome) = (integer("stream", stream)?, self::outcome(outcome)?);
        self.run(py, |buffer| buffer.finish(stream, outcome))
    }

    fn abort(&self, py: Python<'_>, stream: &Bound<'_, PyAny>) -> PyResult<()> {
        let stream = integer("stream", stream)?;
        self.run(py, |buffer| buffer.abort(stream))
    }

    #[pyo3(signature = (streams=None, *, out=None))]
    fn observe<'py>(
        &self,
        py: Python<'py>,
        streams: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let streams = self.all_streams(streams)?;
        let fresh = || self.run(py, |buffer| Ok((buffer.observe(&streams)?, ())));
        let into = |out: &mut [u8]| self.run(py, |buffer| buffer.observe_into(&streams, out));
        Ok(filled(py, out, &rows(streams.len(), &self.row()), fresh, into)?.0)
    }

    #[pyo3(signature = (ids, *, out=None))]
    fn gather<'py>(
        &self,
        py: Python<'py>,
        ids: &Bound<'py, PyAny>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<EpisodeBatch> {
        let ids = integer_vec("ids", ids)?;
        let Some(out) = out else {
            return self.batch(py, self.run(py, |buffer| buffer.gather(&ids))?, None);
        };
        let mut room = exclusive_rows::<u8>(out, &self.row())?;
        let room = room.as_slice_mut()?;
        let index = self.run(py, |buffer| buffer.gather_into(&ids, room))?;
        let used = out.get_item(PySlice::new(py, 0, isize::try_from(index.rows)?, 1))?;
        EpisodeBatch::from_core(used, index, None, self.first_interaction_action())
    }

    #[pyo3(signature = (n, relabel=None, probability=1.0, on=None))]
    fn sample_episodes(
        &self,
        py: Python<'_>,
        n: &Bound<'_, PyAny>,
        relabel: Option<&str>,
        probability: f64,
        on: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<EpisodeBatch> {
        let (n, first) = (size("n", n)?, self.first_interaction_action());
        let rule = relabel
            .map(|strategy| rule(strategy, on, probability, first))
            .transpose()?;
        let (batch, hindsight) = self.run(py, |buffer| buffer.sample(n, rule.as_ref()))?;
        self.batch(py, batch, hindsight)
    }

    fn state_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let state = detached(py, &self.inner, |buffer| buffer.rng_mut().state());
        let dict = PyDict::new(py);
        dict.set_item("rng", into_array(py, state.to_vec(), &[4])?)?;
        Ok(dict)
    }

    fn load_state_dict(&self, py: Python<'_>, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let rng = rng_from_state("rng", &state.get_item("rng")?)?;
        detached(py, &self.inner, |buffer| *buffer.rng_mut() = rng);
        Ok(())
    }

    #[getter]
    fn ids<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<i64>>> {
        let ids: Vec<i64> = detached(py, &self.inner, |buffer| buffer.ids().collect());
        let shape = [ids.len()];
        into_array(py, ids, &shape)
    }

    #[getter]
    fn open<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        let open = detached(py, &self.inner, |buffer| {
            buffer.open_episodes().map(|e| e.is_some()).collect()
        });
        into_array(py, open, &[self.config.num_streams])
    }

    #[getter]
    fn num_steps(&self, py: Python<'_>) -> usize {
        detached(py, &self.inner, |buffer| buffer.num_steps())
    }

    #[getter]
    fn nbytes(&self, py: Python<'_>) -> usize {
        detached(py, &self.inner, |buffer| buffer.allocated_bytes())
    }

    #[getter]
    fn frame_shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.config.frame_shape)
    }

    #[getter]
    fn observation_shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.row())
    }

    #[getter]
    fn num_streams(&self) -> usize {
        self.config.num_streams
    }

    #[getter]
    fn max_episode_steps(&self) -> usize {
        self.config.max_episode_steps
    }

    #[getter]
    fn capacity_steps(&self) -> usize {
        self.config.capacity_steps
    }

    #[getter]
    fn frame_stack(&self) -> usize {
        self.config.frame_stack
    }

    #[getter]
    fn num_goals(&self) -> usize {
        self.config.num_goals
    }

    #[getter]
    fn num_interactions(&self) -> usize {
        self.config.num_interactions
    }

    #[getter(first_interaction_action)]
    fn first_interaction_action_getter(&self) -> usize {
        self.config.first_interaction_action
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        detached(py, &self.inner, |buffer| buffer.len())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (len, steps) = detached(py, &self.inner, |buffer| (buffer.len(), buffer.num_steps()));
        format!(
            "EpisodeBuffer({len} episodes, {steps} of {} steps)",
            self.config.capacity_steps
        )
    }
}
