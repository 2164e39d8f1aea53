//! What `sample_transitions` and `sample_windows` take to relabel: the rule, and how rewards are made anew.

use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use vhs_base::check::check_shape;
use vhs_base::error::Error;
use vhs_core::reward as core;
use vhs_core::strategy::{HindsightRule, Share, Strategy};

use crate::arrays::{bools, checked, into_array, reals, size, slice, type_name};
use crate::error::{dtype, to_py};
use crate::relabel::outcomes;

#[doc = stub!("SparseReward")]
#[pyclass(frozen, get_all, eq, module = "vhs._core")]
#[derive(Clone, PartialEq)]
pub(crate) struct SparseReward {
    #[doc = stub!("SparseReward.reached")]
    reached: f32,
    #[doc = stub!("SparseReward.otherwise")]
    otherwise: f32,
    #[doc = stub!("SparseReward.tolerance")]
    tolerance: f64,
    #[doc = stub!("SparseReward.terminates")]
    terminates: bool,
}

impl SparseReward {
    const fn to_core(&self) -> core::SparseReward {
        core::SparseReward {
            reached: self.reached,
            otherwise: self.otherwise,
            tolerance: self.tolerance,
            terminates: self.terminates,
        }
    }
}

#[pymethods]
impl SparseReward {
    #[new]
    #[pyo3(signature = (reached=0.0, otherwise=-1.0, tolerance=0.0, terminates=true),
           text_signature = "(reached=0.0, otherwise=-1.0, tolerance=0.0, terminates=True)")]
    fn new(reached: f32, otherwise: f32, tolerance: f64, terminates: bool) -> PyResult<Self> {
        let rule = Self {
            reached,
            otherwise,
            tolerance,
            terminates,
        };
        checked(rule.to_core().check())?;
        Ok(rule)
    }

    fn __repr__(&self) -> String {
        let terminates = if self.terminates { "True" } else { "False" };
        format!(
            "SparseReward(reached={:?}, otherwise={:?}, tolerance={:?}, terminates={terminates})",
            self.reached, self.otherwise, self.tolerance
        )
    }
}

/// How relabelled rows are rewarded.
pub(crate) enum Reward<'py> {
    /// By the core.
    Sparse(core::SparseReward),
    /// By a Python function of the goals reached and the new goals.
    Function(Bound<'py, PyAny>),
}

/// Rewards, and whether the task ended, from a user's function.
pub(crate) type Judged = (Vec<f32>, Option<Vec<bool>>);

impl<'py> Reward<'py> {
    pub(crate) fn from_argument(argument: Option<&Bound<'py, PyAny>>) -> PyResult<Self> {
        let Some(argument) = argument else {
            return Ok(Self::Sparse(core::SparseReward::default()));
        };
        if let Ok(sparse) = argument.cast::<SparseReward>() {
            return Ok(Self::Sparse(sparse.get().to_core()));
        }
        if !argument.is_callable() {
            let expected = "a SparseReward or a function of (achieved_goals, goals)";
            return Err(dtype("reward", expected, &type_name(argument)));
        }
        Ok(Self::Function(argument.clone()))
    }

    /// The rule for the core; None where a function will be asked.
    pub(crate) const fn sparse(&self) -> Option<&core::SparseReward> {
        match self {
            Self::Sparse(rule) => Some(rule),
            Self::Function(_) => None,
        }
    }

    /// Asks the user's function, once, about all rows of a batch; `steps` are their episodes and their steps in
    /// them, which a function with a true `by_step` is told too.
    pub(crate) fn judge(
        &self,
        achieved: &Bound<'py, PyAny>,
        goals: &Bound<'py, PyAny>,
        shape: &[usize],
        steps: impl FnOnce() -> (Vec<i64>, Vec<i64>),
    ) -> PyResult<Option<Judged>> {
        let Self::Function(function) = self else {
            return Ok(None);
        };
        let by_step = function.getattr_opt("by_step")?;
        let answer = if by_step.map_or(Ok(false), |by_step| by_step.is_truthy())? {
            let (py, (ids, steps)) = (function.py(), steps());
            let steps = (into_array(py, ids, shape)?, into_array(py, steps, shape)?);
            function.call1((achieved, goals, steps.0, steps.1))?
        } else {
            function.call1((achieved, goals))?
        };
        let Ok(pair) = answer.cast::<PyTuple>() else {
            return Ok(Some((rewards(&answer, shape)?, None)));
        };
        if pair.len() != 2 {
            let got = format!("a tuple of {}", pair.len());
            return Err(dtype("reward", "rewards, or (rewards, terminated)", &got));
        }
        let terminated = pair.get_item(1)?;
        let terminated = bools("terminated", &terminated, shape)?;
        let rewards = rewards(&pair.get_item(0)?, shape)?;
        Ok(Some((rewards, Some(terminated))))
    }
}

fn rewards(answer: &Bound<'_, PyAny>, shape: &[usize]) -> PyResult<Vec<f32>> {
    let rewards = reals("reward", answer)?;
    checked(check_shape("reward", shape, rewards.shape()))?;
    Ok(slice(&rewards).to_vec())
}

/// Refuses arguments that say how to relabel where no strategy says that anything is relabelled.
pub(crate) fn refuse_without_strategy(given: &[(&'static str, bool)]) -> PyResult<()> {
    given
        .iter()
        .filter(|(_, is_given)| *is_given)
        .try_for_each(|&(field, _)| {
            Err(to_py(Error::Argument {
                field,
                expected: "a strategy beside it, such as relabel=\"final\"".into(),
                got: "relabel=None".into(),
            }))
        })
}

/// The rule that Python arguments describe; None where nothing is relabelled.
pub(crate) fn hindsight_rule(
    relabel: Option<&str>,
    probability: Option<f64>,
    ratio: Option<&Bound<'_, PyAny>>,
    on: Option<&Bound<'_, PyAny>>,
    reward: Option<&Bound<'_, PyAny>>,
) -> PyResult<Option<HindsightRule>> {
    let Some(name) = relabel else {
        refuse_without_strategy(&[
            ("probability", probability.is_some()),
            ("ratio", ratio.is_some()),
            ("on", on.is_some()),
            ("reward", reward.is_some()),
        ])?;
        return Ok(None);
    };
    let share = match (probability, ratio) {
        (Some(_), Some(_)) => {
            return Err(to_py(Error::Argument {
                field: "ratio",
                expected: "either a probability or a ratio".into(),
                got: "both".into(),
            }));
        }
        (None, Some(ratio)) => Share::Ratio(size("ratio", ratio)?),
        (probability, None) => Share::Probability(probability.unwrap_or(0.8)),
    };
    let rule = checked(HindsightRule::new(
        checked(Strategy::from_name(name))?,
        share,
    ))?;
    let rule = match on {
        Some(on) => rule.on(outcomes(on)?),
        None => rule,
    };
    Ok(Some(rule))
}
