//! `vhs.TransitionBatch` and `vhs.WindowBatch`: the arrays of what was sampled.

use numpy::{Element, PyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use vhs_core::picks::GoalIndex;
use vhs_core::transitions::TransitionIndex;
use vhs_core::windows::WindowIndex;

use crate::arrays::into_array;

/// The large arrays of a batch: observations, next observations, goals, goals reached, and those reached a step
/// before. A goal that the buffer does not have is None.
pub(crate) type Large<'py> = [Option<Bound<'py, PyAny>>; 5];

#[doc = stub!("TransitionBatch")]
#[pyclass(frozen, get_all, module = "vhs._core")]
pub(crate) struct TransitionBatch {
    #[doc = stub!("TransitionBatch.observations")]
    observations: Option<Py<PyAny>>,
    #[doc = stub!("TransitionBatch.next_observations")]
    next_observations: Option<Py<PyAny>>,
    #[doc = stub!("TransitionBatch.goals")]
    goals: Option<Py<PyAny>>,
    #[doc = stub!("TransitionBatch.achieved_goals")]
    achieved_goals: Option<Py<PyAny>>,
    #[doc = stub!("TransitionBatch.previous_achieved_goals")]
    previous_achieved_goals: Option<Py<PyAny>>,
    #[doc = stub!("TransitionBatch.fields")]
    fields: Py<PyDict>,
    #[doc = stub!("TransitionBatch.next_fields")]
    next_fields: Py<PyDict>,
    #[doc = stub!("TransitionBatch.actions")]
    actions: Py<PyAny>,
    #[doc = stub!("TransitionBatch.rewards")]
    rewards: Py<PyArrayDyn<f32>>,
    #[doc = stub!("TransitionBatch.terminated")]
    terminated: Py<PyArrayDyn<bool>>,
    #[doc = stub!("TransitionBatch.truncated")]
    truncated: Py<PyArrayDyn<bool>>,
    #[doc = stub!("TransitionBatch.lengths")]
    lengths: Option<Py<PyArrayDyn<i64>>>,
    #[doc = stub!("TransitionBatch.discounts")]
    discounts: Option<Py<PyArrayDyn<f32>>>,
    #[doc = stub!("TransitionBatch.weights")]
    weights: Option<Py<PyArrayDyn<f32>>>,
    #[doc = stub!("TransitionBatch.relabelled")]
    relabelled: Py<PyArrayDyn<bool>>,
    #[doc = stub!("TransitionBatch.ids")]
    ids: Py<PyArrayDyn<i64>>,
    #[doc = stub!("TransitionBatch.steps")]
    steps: Py<PyArrayDyn<i64>>,
    #[doc = stub!("TransitionBatch.goal_ids")]
    goal_ids: Py<PyArrayDyn<i64>>,
    #[doc = stub!("TransitionBatch.goal_steps")]
    goal_steps: Py<PyArrayDyn<i64>>,
    #[doc = stub!("TransitionBatch.labels")]
    labels: Py<PyArrayDyn<i64>>,
    #[doc = stub!("TransitionBatch.interactions")]
    interactions: Py<PyArrayDyn<i64>>,
}

#[doc = stub!("WindowBatch")]
#[pyclass(frozen, get_all, module = "vhs._core")]
pub(crate) struct WindowBatch {
    #[doc = stub!("WindowBatch.observations")]
    observations: Option<Py<PyAny>>,
    #[doc = stub!("WindowBatch.goals")]
    goals: Option<Py<PyAny>>,
    #[doc = stub!("WindowBatch.achieved_goals")]
    achieved_goals: Option<Py<PyAny>>,
    #[doc = stub!("WindowBatch.fields")]
    fields: Py<PyDict>,
    #[doc = stub!("WindowBatch.actions")]
    actions: Py<PyAny>,
    #[doc = stub!("WindowBatch.rewards")]
    rewards: Py<PyArrayDyn<f32>>,
    #[doc = stub!("WindowBatch.values")]
    values: Py<PyArrayDyn<f32>>,
    #[doc = stub!("WindowBatch.terminated")]
    terminated: Py<PyArrayDyn<bool>>,
    #[doc = stub!("WindowBatch.truncated")]
    truncated: Py<PyArrayDyn<bool>>,
    #[doc = stub!("WindowBatch.mask")]
    mask: Py<PyArrayDyn<bool>>,
    #[doc = stub!("WindowBatch.burn_in")]
    burn_in: Py<PyArrayDyn<i64>>,
    #[doc = stub!("WindowBatch.lengths")]
    lengths: Py<PyArrayDyn<i64>>,
    #[doc = stub!("WindowBatch.relabelled")]
    relabelled: Py<PyArrayDyn<bool>>,
    #[doc = stub!("WindowBatch.ids")]
    ids: Py<PyArrayDyn<i64>>,
    #[doc = stub!("WindowBatch.steps")]
    steps: Py<PyArrayDyn<i64>>,
    #[doc = stub!("WindowBatch.goal_ids")]
    goal_ids: Py<PyArrayDyn<i64>>,
    #[doc = stub!("WindowBatch.goal_steps")]
    goal_steps: Py<PyArrayDyn<i64>>,
    #[doc = stub!("WindowBatch.labels")]
    labels: Py<PyArrayDyn<i64>>,
    #[doc = stub!("WindowBatch.interactions")]
    interactions: Py<PyArrayDyn<i64>>,
}

/// `GoalIndex` as arrays.
struct Goals {
    relabelled: Py<PyArrayDyn<bool>>,
    ids: Py<PyArrayDyn<i64>>,
    steps: Py<PyArrayDyn<i64>>,
    goal_ids: Py<PyArrayDyn<i64>>,
    goal_steps: Py<PyArrayDyn<i64>>,
    labels: Py<PyArrayDyn<i64>>,
    interactions: Py<PyArrayDyn<i64>>,
}

impl Goals {
    fn from_core(py: Python<'_>, index: GoalIndex) -> PyResult<Self> {
        let n = [index.ids.len()];
        Ok(Self {
            relabelled: into_array(py, index.relabelled, &n)?.unbind(),
            ids: into_array(py, index.ids, &n)?.unbind(),
            steps: into_array(py, index.steps, &n)?.unbind(),
            goal_ids: into_array(py, index.goal_ids, &n)?.unbind(),
            goal_steps: into_array(py, index.goal_steps, &n)?.unbind(),
            labels: into_array(py, index.labels, &n)?.unbind(),
            interactions: into_array(py, index.interactions, &n)?.unbind(),
        })
    }
}

impl TransitionBatch {
    pub(crate) fn from_core(
        py: Python<'_>,
        large: Large<'_>,
        [fields, next_fields]: [Py<PyDict>; 2],
        index: TransitionIndex,
        action_dim: usize,
    ) -> PyResult<Self> {
        let n = [index.rewards.len()];
        let [
            observations,
            next_observations,
            goals,
            achieved_goals,
            previous_achieved_goals,
        ] = large.map(|part| part.map(Bound::unbind));
        let index_of_goals = Goals::from_core(py, index.goals)?;
        Ok(Self {
            weights: some(py, index.weights, &n)?,
            lengths: some(py, index.lengths, &n)?,
            discounts: some(py, index.discounts, &n)?,
            observations,
            next_observations,
            goals,
            achieved_goals,
            previous_achieved_goals,
            fields,
            next_fields,
            actions: actions(py, index.actions, index.vectors, &n, action_dim)?,
            rewards: into_array(py, index.rewards, &n)?.unbind(),
            terminated: into_array(py, index.terminated, &n)?.unbind(),
            truncated: into_array(py, index.truncated, &n)?.unbind(),
            relabelled: index_of_goals.relabelled,
            ids: index_of_goals.ids,
            steps: index_of_goals.steps,
            goal_ids: index_of_goals.goal_ids,
            goal_steps: index_of_goals.goal_steps,
            labels: index_of_goals.labels,
            interactions: index_of_goals.interactions,
        })
    }
}

impl WindowBatch {
    pub(crate) fn from_core(
        py: Python<'_>,
        large: Large<'_>,
        fields: Py<PyDict>,
        index: WindowIndex,
        action_dim: usize,
    ) -> PyResult<Self> {
        let n = [index.lengths.len()];
        let cells = [n[0], index.mask.len() / n[0].max(1)];
        let [observations, _, goals, achieved_goals, _] = large.map(|part| part.map(Bound::unbind));
        let index_of_goals = Goals::from_core(py, index.goals)?;
        Ok(Self {
            observations,
            goals,
            achieved_goals,
            fields,
            actions: actions(py, index.actions, index.vectors, &cells, action_dim)?,
            rewards: into_array(py, index.rewards, &cells)?.unbind(),
            values: into_array(py, index.values, &cells)?.unbind(),
            terminated: into_array(py, index.terminated, &cells)?.unbind(),
            truncated: into_array(py, index.truncated, &cells)?.unbind(),
            mask: into_array(py, index.mask, &cells)?.unbind(),
            burn_in: into_array(py, index.burn_in, &n)?.unbind(),
            lengths: into_array(py, index.lengths, &n)?.unbind(),
            relabelled: index_of_goals.relabelled,
            ids: index_of_goals.ids,
            steps: index_of_goals.steps,
            goal_ids: index_of_goals.goal_ids,
            goal_steps: index_of_goals.goal_steps,
            labels: index_of_goals.labels,
            interactions: index_of_goals.interactions,
        })
    }
}

/// An array that a batch may be without.
fn some<T: Element>(
    py: Python<'_>,
    items: Vec<T>,
    shape: &[usize],
) -> PyResult<Option<Py<PyArrayDyn<T>>>> {
    if items.is_empty() {
        return Ok(None);
    }
    into_array(py, items, shape).map(|array| Some(array.unbind()))
}

/// Numbered actions as int64, continuous ones as float32 with one more dimension.
pub(crate) fn actions(
    py: Python<'_>,
    numbered: Vec<i64>,
    vectors: Vec<f32>,
    shape: &[usize],
    action_dim: usize,
) -> PyResult<Py<PyAny>> {
    if action_dim == 0 {
        return Ok(into_array(py, numbered, shape)?.into_any().unbind());
    }
    let shape = [shape, &[action_dim]].concat();
    Ok(into_array(py, vectors, &shape)?.into_any().unbind())
}

#[pymethods]
impl TransitionBatch {
    #[doc = stub!("TransitionBatch.__len__")]
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.ids.bind(py).len()
    }
}

#[pymethods]
impl WindowBatch {
    #[doc = stub!("WindowBatch.__len__")]
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.ids.bind(py).len()
    }
}
