//! `vhs.EpisodeBatch` and `vhs.Hindsight`: the arrays of a gathered batch, and of its new goals.

use std::collections::BTreeMap;

use numpy::{PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use vhs_base::check::check_shape;
use vhs_base::error::Error;
use vhs_core::batch::BatchIndex;
use vhs_core::episodes::EpisodeConfig;
use vhs_core::relabel::{self as core, EpisodeEnd};

use crate::arrays::{checked, integer_vec, into_array};
use crate::error::to_py;
use crate::transitions::actions;

#[doc = stub!("Hindsight")]
#[pyclass(frozen, get_all, module = "vhs._core")]
pub(crate) struct Hindsight {
    #[doc = stub!("Hindsight.selected")]
    selected: Py<PyArrayDyn<bool>>,
    #[doc = stub!("Hindsight.goal_rows")]
    goal_rows: Py<PyArrayDyn<i64>>,
    #[doc = stub!("Hindsight.interactions")]
    interactions: Py<PyArrayDyn<i64>>,
    #[doc = stub!("Hindsight.lengths")]
    lengths: Py<PyArrayDyn<i64>>,
}

impl Hindsight {
    pub(crate) fn from_core(py: Python<'_>, hindsight: core::Hindsight) -> PyResult<Self> {
        let shape = [hindsight.selected.len()];
        Ok(Self {
            selected: into_array(py, hindsight.selected, &shape)?.unbind(),
            goal_rows: into_array(py, hindsight.goal_rows, &shape)?.unbind(),
            interactions: into_array(py, hindsight.interactions, &shape)?.unbind(),
            lengths: into_array(py, hindsight.lengths, &shape)?.unbind(),
        })
    }
}

#[doc = stub!("EpisodeBatch")]
#[pyclass(frozen, module = "vhs._core")]
pub(crate) struct EpisodeBatch {
    #[doc = stub!("EpisodeBatch.observations")]
    #[pyo3(get)]
    observations: Option<Py<PyAny>>,
    #[doc = stub!("EpisodeBatch.ids")]
    #[pyo3(get)]
    ids: Py<PyArrayDyn<i64>>,
    #[doc = stub!("EpisodeBatch.offsets")]
    #[pyo3(get)]
    offsets: Py<PyArrayDyn<i64>>,
    #[doc = stub!("EpisodeBatch.lengths")]
    #[pyo3(get)]
    lengths: Py<PyArrayDyn<i64>>,
    #[doc = stub!("EpisodeBatch.desired_goals")]
    #[pyo3(get)]
    desired_goals: Option<Py<PyAny>>,
    #[doc = stub!("EpisodeBatch.achieved_goals")]
    #[pyo3(get)]
    achieved_goals: Option<Py<PyAny>>,
    #[doc = stub!("EpisodeBatch.fields")]
    #[pyo3(get)]
    fields: Py<PyDict>,
    #[doc = stub!("EpisodeBatch.terminated")]
    #[pyo3(get)]
    terminated: Py<PyArrayDyn<bool>>,
    #[doc = stub!("EpisodeBatch.actions")]
    #[pyo3(get)]
    actions: Py<PyAny>,
    #[doc = stub!("EpisodeBatch.rewards")]
    #[pyo3(get)]
    rewards: Py<PyArrayDyn<f32>>,
    #[doc = stub!("EpisodeBatch.values")]
    #[pyo3(get)]
    values: Py<PyArrayDyn<f32>>,
    #[doc = stub!("EpisodeBatch.mask")]
    #[pyo3(get)]
    mask: Py<PyArrayDyn<bool>>,
    #[doc = stub!("EpisodeBatch.goals")]
    #[pyo3(get)]
    goals: Py<PyArrayDyn<i64>>,
    #[doc = stub!("EpisodeBatch.interactions")]
    #[pyo3(get)]
    interactions: Py<PyArrayDyn<i64>>,
    #[doc = stub!("EpisodeBatch.outcomes")]
    #[pyo3(get)]
    outcomes: Py<PyArrayDyn<u8>>,
    #[doc = stub!("EpisodeBatch.hindsight")]
    #[pyo3(get)]
    hindsight: Option<Py<Hindsight>>,
    /// What relabelling reads: our own copy, so that writing to the arrays cannot lead it out of
    /// bounds.
    pub(crate) ends: Vec<EpisodeEnd>,
    /// Which action does which interaction.
    doing: BTreeMap<i64, i64>,
}

impl EpisodeBatch {
    /// `large` are the observations, the goals told and those reached; a goal that the buffer does not have
    /// is None.
    pub(crate) fn from_core(
        py: Python<'_>,
        large: [Option<Bound<'_, PyAny>>; 3],
        fields: Py<PyDict>,
        index: BatchIndex,
        hindsight: Option<core::Hindsight>,
        config: &EpisodeConfig,
    ) -> PyResult<Self> {
        let (episodes, steps) = ([index.ids.len()], [index.ids.len(), index.longest]);
        let hindsight = hindsight
            .map(|hindsight| Py::new(py, Hindsight::from_core(py, hindsight)?))
            .transpose()?;
        let [observations, desired_goals, achieved_goals] =
            large.map(|part| part.map(Bound::unbind));
        Ok(Self {
            observations,
            desired_goals,
            achieved_goals,
            fields,
            terminated: into_array(py, index.terminated, &episodes)?.unbind(),
            ids: into_array(py, index.ids, &episodes)?.unbind(),
            offsets: into_array(py, index.offsets, &episodes)?.unbind(),
            lengths: into_array(py, index.lengths, &episodes)?.unbind(),
            actions: actions(py, index.actions, index.vectors, &steps, config.action_dim)?,
            rewards: into_array(py, index.rewards, &steps)?.unbind(),
            values: into_array(py, index.values, &steps)?.unbind(),
            mask: into_array(py, index.mask, &steps)?.unbind(),
            goals: into_array(py, index.goals, &episodes)?.unbind(),
            interactions: into_array(py, index.interactions, &episodes)?.unbind(),
            outcomes: into_array(py, index.outcomes, &episodes)?.unbind(),
            hindsight,
            ends: index.ends,
            doing: config.interactions.clone(),
        })
    }

    /// The ends of the episodes, each cut after the number of steps that `argument` says.
    pub(crate) fn ends_at(&self, argument: &Bound<'_, PyAny>) -> PyResult<Vec<EpisodeEnd>> {
        let steps = integer_vec("ends", argument)?;
        checked(check_shape("ends", &[self.ends.len()], &[steps.len()]))?;
        for (end, &steps) in self.ends.iter().zip(&steps) {
            if !(0..=end.steps).contains(&steps) {
                return Err(to_py(Error::Argument {
                    field: "ends",
                    expected: format!("steps of an episode, in 0..={}", end.steps),
                    got: steps.to_string(),
                }));
            }
        }
        let cut = |(at, (end, steps)): (usize, (&EpisodeEnd, i64))| {
            let done = if steps == end.steps {
                end.done
            } else {
                self.done(argument.py(), at, steps)
            };
            end.cut(steps, done)
        };
        Ok(self.ends.iter().zip(steps).enumerate().map(cut).collect())
    }

    /// The interaction done by the last of some steps of an episode; None where it is a move.
    fn done(&self, py: Python<'_>, episode: usize, steps: i64) -> Option<i64> {
        let actions = self.actions.bind(py).cast::<PyArrayDyn<i64>>().ok()?;
        let step = usize::try_from(steps - 1).ok()?;
        let action = actions
            .try_readonly()
            .ok()?
            .as_array()
            .get([episode, step])
            .copied()?;
        self.doing.get(&action).copied()
    }
}

#[pymethods]
impl EpisodeBatch {
    #[doc = stub!("EpisodeBatch.__len__")]
    fn __len__(&self) -> usize {
        self.ends.len()
    }
}
